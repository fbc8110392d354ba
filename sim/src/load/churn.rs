//! Who changes what and when, in a crowd that does not simply stay.

use std::time::Duration;

use rand::RngExt;

/// What somebody does who does not simply stay.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Change {
    /// Leaves, and joins anew.
    Rejoin,
    /// Comes back over another connection.
    Resume,
    /// Is put elsewhere.
    Teleport,
}

/// Who changes when, as chance has it.
pub struct Churn {
    chance: rand_pcg::Pcg64,
    /// Mean time between two changes of one client, seconds.
    mean_s: f64,
}

impl Churn {
    /// For one of `clients` that make `rate` changes of each kind a second; `None` for no changes.
    pub fn new(rate: f64, seed: u64, number: usize, clients: usize) -> Option<Churn> {
        let chance = rand_pcg::Pcg64::new(u128::from(seed), number as u128);
        (rate > 0.0 && clients > 0).then(|| Churn { chance, mean_s: clients as f64 / (3.0 * rate) })
    }

    /// For how long to stay, and what to do then.
    pub fn upcoming(&mut self) -> (Duration, Change) {
        let stay_s = self.chance.random_range(0.0..2.0 * self.mean_s);
        let change = [Change::Rejoin, Change::Resume, Change::Teleport][self.chance.random_range(0..3)];
        (Duration::from_secs_f64(stay_s), change)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn changes_come_at_the_rate_that_was_asked_for() {
        let (mut passed, mut counts) = (0.0, [0; 3]);
        let mut churn = Churn::new(2.0, 7, 3, 12).unwrap();
        for _ in 0..3000 {
            let (stay, change) = churn.upcoming();
            passed += stay.as_secs_f64();
            counts[change as usize] += 1;
        }
        // One of twelve makes a sixth of a change of each kind a second.
        for count in counts {
            let rate = f64::from(count) / passed;
            assert!((rate - 2.0 / 12.0).abs() < 0.02, "{rate} a second");
        }
        assert!(Churn::new(0.0, 7, 3, 12).is_none() && Churn::new(1.0, 7, 3, 0).is_none());
    }
}
