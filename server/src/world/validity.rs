//! For how long do clients make do with a bound? The distribution of validity periods, of a sample.
//!
//! A server tells a bound that holds for an hour and leaves to the client how much of it to use (DESIGN §5), so what was
//! told says little. What counts is the time from a bound that a client asked for to its next question about that object,
//! since that is the validity period of Sudarsky & Gotsman (TVCG 1999, §3.4) as it came about. To note that for every client
//! and object would take more memory than all else that is known of a client; so only some pairs are noted, chosen by a hash
//! of theirs, and fewer the more there are. An answer that got lost counts as a short one.

use eyeline_protocol::{ClientRecord, ObjectId, Reason, Want, WorldTime};
use rustc_hash::FxHashMap;

use super::SessionId;
use crate::histogram::Histogram;

/// Bounds of validity periods, seconds.
const PERIODS: &[f64] = &[0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 60.0, 300.0, 3_600.0];

/// Bounds of growth, metres.
const METRES: &[f64] = &[0.01, 0.05, 0.1, 0.25, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 200.0];

/// Most pairs that are noted.
const PAIRS_MAX: usize = 4_096;

/// How long bounds last, by a sample of clients and objects.
#[derive(Clone, Debug)]
pub struct Validity {
    /// When the pair was told its bound. Nothing may depend on its order.
    told: FxHashMap<(SessionId, ObjectId), WorldTime>,
    /// Pairs whose hash has as many trailing zeros are noted.
    zeros: u32,
    /// From when a bound was asked for to the next question about its object, seconds.
    pub periods: Histogram,
    /// By how much the bound had grown then by its class's speed, metres.
    pub growth: Histogram,
}

impl Default for Validity {
    fn default() -> Validity {
        Validity {
            told: FxHashMap::default(),
            zeros: 0,
            periods: Histogram::new(PERIODS),
            growth: Histogram::new(METRES),
        }
    }
}

impl Validity {
    /// The share of pairs that is noted: 1 in so many.
    pub fn one_in(&self) -> u64 {
        1 << self.zeros
    }

    /// A client's record about an object whose class moves at `speed` metres a second at most.
    pub(super) fn note(&mut self, session: SessionId, record: &ClientRecord, speed: f64, now: WorldTime) {
        let (object, wants_bound, was_bound) = match *record {
            ClientRecord::Request { object, want, reason } => {
                (object, want == Want::Bound, matches!(reason, Reason::Exposed | Reason::Expired))
            }
            ClientRecord::Release { object, want_bound } => (object, want_bound, false),
            _ => return,
        };
        let pair = (session, object);
        if !self.is_noted(pair) {
            return;
        }
        if let Some(told) = self.told.remove(&pair)
            && was_bound
        {
            let period = now.seconds_since(told);
            self.periods.observe(period);
            self.growth.observe(speed * period);
        }
        if wants_bound {
            self.told.insert(pair, now);
            if self.told.len() > PAIRS_MAX {
                self.zeros += 1;
                let zeros = self.zeros;
                self.told.retain(|&pair, _| hash(pair).trailing_zeros() >= zeros);
            }
        }
    }

    /// A client has gone.
    pub(super) fn forget(&mut self, session: SessionId) {
        self.told.retain(|&(whose, _), _| whose != session);
    }

    fn is_noted(&self, pair: (SessionId, ObjectId)) -> bool {
        hash(pair).trailing_zeros() >= self.zeros
    }
}

/// SplitMix64's finaliser (Steele, Lea & Flood 2014): every bit of the pair counts for every bit of the hash.
fn hash((session, object): (SessionId, ObjectId)) -> u64 {
    let mut x = (u64::from(session.0) << 32 | u64::from(object.0)).wrapping_add(0x9e37_79b9_7f4a_7c15);
    x = (x ^ x >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ x >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ x >> 31
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    fn at(millis: u64) -> WorldTime {
        WorldTime::ZERO + Duration::from_millis(millis)
    }

    fn ask(object: u32, want: Want, reason: Reason) -> ClientRecord {
        ClientRecord::Request { object: ObjectId(object), want, reason }
    }

    #[test]
    fn a_period_lasts_from_the_bound_to_the_next_question() {
        let (mut validity, one) = (Validity::default(), SessionId(1));
        validity.note(one, &ask(7, Want::Bound, Reason::Unknown), 2.0, at(0));
        validity.note(one, &ask(7, Want::Bound, Reason::Expired), 2.0, at(1_000));
        validity.note(one, &ask(7, Want::State, Reason::Exposed), 2.0, at(1_250));
        assert_eq!((validity.periods.count(), validity.periods.sum()), (2, 1.25));
        assert_eq!(validity.growth.sum(), 2.5);
        // It was seen, then hidden again: no bound was held in between.
        validity.note(one, &ClientRecord::Release { object: ObjectId(7), want_bound: true }, 2.0, at(5_000));
        assert_eq!(validity.periods.count(), 2);
        validity.note(one, &ask(7, Want::Place, Reason::Exposed), 2.0, at(5_500));
        assert_eq!((validity.periods.count(), validity.periods.sum()), (3, 1.75));
        // What broke its bound did not use it up.
        validity.note(one, &ask(7, Want::Bound, Reason::Violated), 2.0, at(6_000));
        validity.note(one, &ask(7, Want::Bound, Reason::Violated), 2.0, at(6_500));
        assert_eq!(validity.periods.count(), 3);
    }

    #[test]
    fn a_million_pairs_are_sampled_evenly_within_the_bound() {
        let mut validity = Validity::default();
        for round in 0..2 {
            for session in 0..100 {
                for object in 0..1_000 {
                    let record = ask(object, Want::Bound, Reason::Expired);
                    validity.note(SessionId(session), &record, 1.0, at(1_000 * round));
                }
            }
            assert!(validity.told.len() <= PAIRS_MAX && validity.told.len() > PAIRS_MAX / 4);
        }
        assert_eq!(validity.one_in(), 32, "100,000 pairs, of which 4,096 fit");
        let seen = validity.periods.count();
        assert!((2_500..4_096).contains(&seen), "{seen}");
        assert_eq!(validity.periods.sum(), seen as f64, "each lasted a second");
        for session in 0..100 {
            validity.forget(SessionId(session));
        }
        assert!(validity.told.is_empty());
    }
}
