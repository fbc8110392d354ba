//! How much should PLP draw? A budget that follows what the tails of the last frames gained (Klosowski & Silva 2000, §6,
//! extension 3, leaves open how).
//!
//! PLP draws first what is likeliest to be visible. While the last triangles of a frame still gain pixels, the budget was too small;
//! once they gain next to none, it was too large. Frames follow each other closely, so the last one tells what the next one needs.
//! Nothing here reads a clock: the same frames give the same budgets.

use rustc_hash::FxHashMap;

use crate::ItemBuffer;

/// When a budget is enough. Any value is legal; what is out of range is cut to it, and NaN counts as the default.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct AutoBudgetRules {
    /// The last triangles of a frame, as a share of its budget, that must be shown to be superfluous: from 0 to 0.9. More: the
    /// budget stays farther above what is needed, and follows faster. Default 0.2.
    pub tail: f64,
    /// Share of the pixels with a winner that the tail may own for the budget to be enough, from 0 to 1. Default 0.002: 524 of
    /// 512 × 512.
    pub gain: f64,
    /// What the budget is multiplied with when it was not enough, from 1.01 to 100. Default 1.5.
    pub growth: f64,
    /// Least budget and the first one, in triangles; 0 counts as 1. Default 1,000.
    pub least: usize,
    /// Greatest budget, in triangles. Default [`usize::MAX`].
    pub most: usize,
}

impl Default for AutoBudgetRules {
    fn default() -> AutoBudgetRules {
        AutoBudgetRules { tail: 0.2, gain: 0.002, growth: 1.5, least: 1_000, most: usize::MAX }
    }
}

impl AutoBudgetRules {
    /// The rules with another share of pixels that the tail may own.
    pub fn with_gain(self, gain: f64) -> AutoBudgetRules {
        AutoBudgetRules { gain, ..self }
    }

    /// The rules with another range.
    pub fn with_range(self, least: usize, most: usize) -> AutoBudgetRules {
        AutoBudgetRules { least, most, ..self }
    }
}

/// A budget that is found out while frames go by.
#[derive(Clone, Debug)]
pub struct AutoBudget {
    rules: AutoBudgetRules,
    budget: usize,
}

impl AutoBudget {
    /// Begins with the least budget.
    pub fn new(rules: AutoBudgetRules) -> AutoBudget {
        let default = AutoBudgetRules::default();
        let cut = |value: f64, least: f64, most: f64, default: f64| {
            if value.is_nan() { default } else { value.clamp(least, most) }
        };
        let least = rules.least.max(1);
        let rules = AutoBudgetRules {
            tail: cut(rules.tail, 0.0, 0.9, default.tail),
            gain: cut(rules.gain, 0.0, 1.0, default.gain),
            growth: cut(rules.growth, 1.01, 100.0, default.growth),
            least,
            most: rules.most.max(least),
        };
        AutoBudget { rules, budget: least }
    }

    /// What the next frame may draw, in triangles.
    pub fn budget(&self) -> usize {
        self.budget
    }

    /// Learns from a frame: the triangles drawn under [`AutoBudget::budget`], in PLP's order ([`crate::PlpScratch::drawn`]), and the
    /// winners of a picture of them ([`ItemBuffer::ids`]), at any resolution.
    pub fn handle_frame(&mut self, drawn: &[u32], winners: &[u32]) {
        let mut pixels: FxHashMap<u32, usize> = FxHashMap::default();
        winners.iter().filter(|id| **id != ItemBuffer::NONE).for_each(|&id| *pixels.entry(id).or_default() += 1);
        let owned: usize = pixels.values().sum();
        let spare = (owned as f64 * self.rules.gain) as usize;
        let mut gained = 0;
        let needed = drawn.iter().rposition(|id| {
            gained += pixels.get(id).copied().unwrap_or(0);
            gained > spare
        });
        // How many it took until what was left gained no more than that.
        let needed = needed.map_or(0, |last| last + 1);
        let head = 1.0 - self.rules.tail;
        let next = if drawn.len() >= self.budget && needed as f64 > self.budget as f64 * head {
            self.budget as f64 * self.rules.growth + 1.0
        } else {
            needed as f64 / head
        };
        // Saturates.
        self.budget = (next.ceil() as usize).clamp(self.rules.least, self.rules.most);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A frame in which of all triangles the first `useful` own ten pixels each.
    fn frame(auto: &mut AutoBudget, useful: u32, all: u32) {
        let drawn: Vec<u32> = (0..all.min(auto.budget() as u32)).collect();
        let winners = (0..10).flat_map(|_| 0..useful.min(drawn.len() as u32)).chain([ItemBuffer::NONE; 7]);
        auto.handle_frame(&drawn, &winners.collect::<Vec<u32>>());
    }

    #[test]
    fn it_grows_until_the_tail_gains_nothing_and_shrinks_when_less_is_seen() {
        let mut auto = AutoBudget::new(AutoBudgetRules::default().with_range(100, 1_000_000));
        assert_eq!(auto.budget(), 100);
        for _ in 0..20 {
            frame(&mut auto, 3_000, 50_000);
        }
        assert!((3_000..=4_700).contains(&auto.budget()), "{}", auto.budget());
        let settled = auto.budget();
        frame(&mut auto, 3_000, 50_000);
        assert_eq!(auto.budget(), settled);
        frame(&mut auto, 40, 50_000);
        assert_eq!(auto.budget(), 100);
        for _ in 0..30 {
            frame(&mut auto, 900_000, 900_000);
        }
        assert_eq!(auto.budget(), 1_000_000);
    }

    #[test]
    fn a_tail_that_owns_few_pixels_is_not_worth_a_larger_budget() {
        let rules = AutoBudgetRules::default().with_range(10, 10_000);
        let needed = |gain: f64| {
            let mut auto = AutoBudget { budget: 1_000, ..AutoBudget::new(rules.with_gain(gain)) };
            // One pixel each: 999 of them, and 9,000 of the first.
            let winners: Vec<u32> = (0..1_000).chain([0; 9_000]).collect();
            auto.handle_frame(&(0..1_000).collect::<Vec<u32>>(), &winners);
            auto.budget()
        };
        assert_eq!(needed(0.0), 1_501);
        // 5 % of 10,000 pixels: the last 500 triangles are not needed.
        assert_eq!(needed(0.05), 625);
        assert_eq!(needed(1.0), 10);
    }

    #[test]
    fn hardly_rules_and_frames_do_no_harm() {
        let odd = AutoBudgetRules { tail: f64::NAN, gain: f64::INFINITY, growth: -3.0, least: 0, most: 0 };
        let mut auto = AutoBudget::new(odd);
        assert_eq!(auto.budget(), 1);
        auto.handle_frame(&[], &[]);
        auto.handle_frame(&[5, 6], &[ItemBuffer::NONE, 77]);
        assert_eq!(auto.budget(), 1);
        let mut auto = AutoBudget::new(AutoBudgetRules { most: usize::MAX, growth: 100.0, ..odd });
        auto.budget = usize::MAX;
        auto.handle_frame(&[1], &[1]);
        assert!(auto.budget() >= 1);
    }
}
