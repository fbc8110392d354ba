//! When does a decision that is counted anew all the time turn?

/// A decision that is not taken back at once: it turns only after the count has spoken for the other side so many times
/// running. So something that flickers around a limit is not switched on and off in each frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Hysteresis {
    runs: bool,
    /// Counts in a row that spoke for the other side.
    against: u32,
    to_on: u32,
    to_off: u32,
    /// How often it turned.
    turns: u64,
}

impl Hysteresis {
    /// Begins as `runs`. Turns on after `to_on` counts in a row that say on, off after `to_off` that say off; 0 counts as 1.
    pub const fn new(runs: bool, to_on: u32, to_off: u32) -> Hysteresis {
        Hysteresis { runs, against: 0, to_on, to_off, turns: 0 }
    }

    /// What holds now.
    pub const fn runs(&self) -> bool {
        self.runs
    }

    /// How often it turned.
    pub const fn turns(&self) -> u64 {
        self.turns
    }

    /// One more count; `None` says nothing for either side. Returns what holds from now on.
    pub fn count(&mut self, says: Option<bool>) -> bool {
        self.against = match says {
            Some(says) if says != self.runs => self.against + 1,
            Some(_) => 0,
            None => self.against,
        };
        if self.against >= if self.runs { self.to_off } else { self.to_on }.max(1) {
            self.runs = !self.runs;
            self.against = 0;
            self.turns += 1;
        }
        self.runs
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_decision_turns_only_after_as_many_counts_in_a_row() {
        let mut decision = Hysteresis::new(false, 3, 2);
        assert!(!decision.count(Some(true)) && !decision.count(Some(true)));
        // One count for what holds starts it anew; silence does not.
        assert!(!decision.count(Some(false)) && !decision.count(Some(true)) && !decision.count(None));
        assert!(!decision.count(Some(true)) && decision.count(Some(true)));
        assert!(decision.count(Some(false)) && !decision.count(Some(false)));
        assert_eq!(decision.turns(), 2);
        // What alternates never turns.
        for _ in 0..50 {
            decision.count(Some(true));
            decision.count(Some(false));
        }
        assert_eq!(decision.turns(), 2);
    }
}
