//! How much may a culler draw? A number of triangles, a share of the scene's, a multiple of the visible set, what is worth while, or what
//! a deadline leaves time for: `5000`, `10%`, `2x`, `auto`, `4ms`.

use std::str::FromStr;
use std::time::Duration;

/// A budget as it was given. Rows and reports keep the text.
#[derive(Clone, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct AskedBudget {
    /// Legal: [`AskedBudget::from_str`] made it.
    text: String,
}

/// What a budget's text says.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum BudgetKind {
    /// `5000`: triangles.
    Triangles(usize),
    /// `10%`: a share of the scene's triangles, from 0 to 1.
    Share(f64),
    /// `2x`: so many times the static triangles that own a pixel of the view: each view has a budget of its own.
    Visible(f64),
    /// `auto`: what [`eyeline_visibility::AutoBudget`] makes of the views before.
    Auto,
    /// `4ms`: cells are projected until so much time is over. Not the same in any two runs.
    Deadline(Duration),
}

/// Why a text is no budget.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "`{0}` is no budget: give a number of triangles, as 5000, a share of the scene's from 0 to 100, as 2.5%, a multiple \
    of each view's visible set up to 1000, as 2x, a deadline up to 60000, as 4ms, or auto"
)]
pub struct BudgetError(String);

/// Largest multiple of the visible set, and longest deadline in milliseconds.
const TIMES_MAX: f64 = 1e3;
const DEADLINE_MAX: f64 = 6e4;

impl AskedBudget {
    /// The text given.
    pub fn text(&self) -> &str {
        &self.text
    }

    /// What it says.
    pub fn kind(&self) -> BudgetKind {
        parse(&self.text).unwrap_or(BudgetKind::Triangles(0))
    }

    /// Triangles of a scene of `total`, rounded down; `None` if that depends on the view.
    pub fn triangles(&self, total: usize) -> Option<usize> {
        match self.kind() {
            BudgetKind::Triangles(triangles) => Some(triangles),
            BudgetKind::Share(share) => Some((share * total as f64) as usize),
            BudgetKind::Visible(_) | BudgetKind::Auto | BudgetKind::Deadline(_) => None,
        }
    }
}

fn parse(text: &str) -> Option<BudgetKind> {
    // `parse` takes infinities and NaN too; those are in no range.
    let within = |number: &str, most: f64| number.parse::<f64>().ok().filter(|number| (0.0..=most).contains(number));
    if text == "auto" {
        return Some(BudgetKind::Auto);
    }
    if let Some(percent) = text.strip_suffix('%') {
        return within(percent, 100.0).map(|percent| BudgetKind::Share(percent / 100.0));
    }
    if let Some(times) = text.strip_suffix('x') {
        return within(times, TIMES_MAX).map(BudgetKind::Visible);
    }
    if let Some(millis) = text.strip_suffix("ms") {
        return within(millis, DEADLINE_MAX).map(|millis| BudgetKind::Deadline(Duration::from_secs_f64(millis * 1e-3)));
    }
    text.parse().ok().map(BudgetKind::Triangles)
}

impl From<usize> for AskedBudget {
    fn from(triangles: usize) -> AskedBudget {
        AskedBudget { text: triangles.to_string() }
    }
}

impl FromStr for AskedBudget {
    type Err = BudgetError;

    fn from_str(text: &str) -> Result<AskedBudget, BudgetError> {
        parse(text).map(|_| AskedBudget { text: text.to_owned() }).ok_or_else(|| BudgetError(text.to_owned()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn budgets_are_counts_shares_multiples_deadlines_or_found_out() {
        let triangles = |text: &str| text.parse::<AskedBudget>().map(|budget| budget.triangles(1_234));
        assert_eq!(triangles("70"), Ok(Some(70)));
        assert_eq!(triangles("10%"), Ok(Some(123)));
        assert_eq!(triangles("0.5%"), Ok(Some(6)));
        assert_eq!(triangles("100%"), Ok(Some(1_234)));
        assert_eq!(triangles("2x"), Ok(None));
        let kind = |text: &str| text.parse::<AskedBudget>().unwrap().kind();
        assert_eq!(kind("1.5x"), BudgetKind::Visible(1.5));
        assert_eq!(kind("auto"), BudgetKind::Auto);
        assert_eq!(kind("0.5ms"), BudgetKind::Deadline(Duration::from_micros(500)));
        let bad = [
            "", "%", "-1", "-1%", "101%", "NaN%", "inf%", "5 %", "ten", "1.5", "x", "-1x", "NaNx", "1001x", "ms",
            "-1ms", "infms", "60001ms", "4s", "Auto",
        ];
        for bad in bad {
            assert_eq!(triangles(bad), Err(BudgetError(bad.to_owned())));
        }
        assert_eq!(AskedBudget::from(9).text(), "9");
    }
}
