//! The client's two ideas of the server's time: the latest that it can possibly be, which decides when bounds expire,
//! and a smoothed one, which is for drawing only (DESIGN §6).

use std::time::Duration;

use eyeline_protocol::{LocalTime, WorldTime};

/// How much faster than ours the server's clock may run: 10⁻³, far beyond what quartz does.
pub(crate) const DRIFT: f64 = 1e-3;

/// Estimates the server's time from probes: a datagram of ours, and the server's stamp on its acknowledgement.
#[derive(Clone, Debug, Default)]
pub struct Clock {
    /// At this local time the server's was at most this.
    latest: Option<(LocalTime, WorldTime)>,
    /// At this local time the server's was probably this.
    smoothed: Option<(LocalTime, WorldTime)>,
    /// Round trip of the best probe so far, growing slowly so that a better path is noticed.
    best_round: Duration,
    /// Whether our clock may have stood still since the latest time was learned: any probe then is better.
    doubtful: bool,
    frozen: bool,
}

impl Clock {
    /// The server stamped `sent` on a datagram that arrived at `now`; at most `round` had passed since (the time since
    /// our acknowledged datagram left, less what the server held it).
    pub fn observe(&mut self, sent: WorldTime, round: Duration, now: LocalTime) {
        // At the stamp our clock was at most `round` ago, so the server's time is at most sent + round, had its clock
        // run at our pace; the drift of so short a time is covered by rounding up.
        let latest = sent + round.mul_f64(1.0 + DRIFT) + Duration::from_micros(1);
        // A stamp beyond the latest proves that wrong: our clock stood still, in a suspended machine say.
        let is_better = self.latest(now).is_none_or(|known| latest < known || sent > known);
        if (is_better || self.doubtful) && !self.frozen {
            self.latest = Some((now, latest));
            self.doubtful = false;
        }
        let middle = sent + round / 2;
        self.best_round += Duration::from_micros(10);
        match self.smoothed(now) {
            Some(known) if round > self.best_round.mul_f64(1.5) => {
                // A slow probe says little; use it only against gross error.
                let error = middle.micros().saturating_sub(known.micros());
                if error.unsigned_abs() > round.as_micros() as u64 {
                    self.smoothed = Some((now, middle));
                }
            }
            Some(known) => {
                let error = middle.micros().saturating_sub(known.micros());
                self.smoothed = Some((now, known.offset_micros(error / 8)));
            }
            None => self.smoothed = Some((now, middle)),
        }
        if self.best_round < Duration::from_micros(20) || round < self.best_round {
            self.best_round = round;
        }
    }

    /// Our clock has jumped, and nobody knows how much time that hid: what is known may be early until the next probe.
    pub fn doubt(&mut self) {
        self.doubtful = true;
    }

    /// A probe whose round trip can't be told. Its stamp still says that the server's time is no earlier.
    pub fn observe_stamp(&mut self, sent: WorldTime, now: LocalTime) {
        if self.latest(now).is_none_or(|known| sent > known) && !self.frozen {
            self.latest = Some((now, sent));
        }
        if self.smoothed(now).is_none_or(|known| sent > known) {
            self.smoothed = Some((now, sent));
        }
    }

    /// The latest that the server's time can be; `None` before the first probe.
    pub fn latest(&self, now: LocalTime) -> Option<WorldTime> {
        let (local, world) = self.latest?;
        if self.frozen {
            return Some(world);
        }
        Some(world + now.since(local).mul_f64(1.0 + DRIFT))
    }

    /// What the server's time probably is; for drawing, never for expiry.
    pub fn smoothed(&self, now: LocalTime) -> Option<WorldTime> {
        let (local, world) = self.smoothed?;
        Some(world + now.since(local))
    }

    /// Stops the clock that expiry goes by: sabotage, to see that the measurement notices.
    pub fn freeze(&mut self, now: LocalTime) {
        if let Some(latest) = self.latest(now) {
            self.latest = Some((now, latest));
            self.frozen = true;
        }
    }
}

/// Our own clock, made to never go back. What a jump back hides is taken for nothing, and the session is told.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Monotonic {
    newest: Option<LocalTime>,
    /// What all jumps back come to, microseconds.
    back: i64,
}

impl Monotonic {
    /// The time that goes on, and whether the clock has just jumped back.
    pub fn now(&mut self, raw: LocalTime) -> (LocalTime, bool) {
        let newest = self.newest.replace(raw).unwrap_or(raw);
        self.back = self.back.saturating_add(newest.since(raw).as_micros() as i64);
        (raw.offset_micros(self.back), raw < newest)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn a_clock_that_stood_still_is_put_right_by_the_next_probe() {
        let mut clock = Clock::default();
        let round = Duration::from_millis(1);
        clock.observe(WorldTime::from_micros(1_000_000), round, LocalTime::from_micros(0));
        // The machine slept for five seconds, and its clock with it.
        let now = LocalTime::from_micros(10_000);
        clock.observe(WorldTime::from_micros(6_010_000), round, now);
        assert!(clock.latest(now).unwrap() >= WorldTime::from_micros(6_010_000));
    }

    #[test]
    fn what_is_doubted_gives_way_to_the_next_probe_and_stamps_help_until_then() {
        let at = LocalTime::from_micros;
        let mut clock = Clock::default();
        clock.observe(WorldTime::from_micros(1_000_000), Duration::from_millis(1), at(0));
        clock.doubt();
        clock.observe_stamp(WorldTime::from_micros(2_000_000), at(10));
        assert_eq!(clock.latest(at(10)), Some(WorldTime::from_micros(2_000_000)));
        clock.observe_stamp(WorldTime::from_micros(1_500_000), at(10));
        assert_eq!(clock.latest(at(10)), Some(WorldTime::from_micros(2_000_000)), "an older one says nothing");
        clock.observe(WorldTime::from_micros(2_000_000), Duration::from_millis(60), at(20));
        let latest = clock.latest(at(20)).unwrap();
        assert!(latest >= WorldTime::from_micros(2_060_000), "{latest:?}");
    }

    #[test]
    fn a_monotonic_clock_goes_on_from_where_the_other_went_back() {
        let mut clock = Monotonic::default();
        let times: Vec<_> = [5, 9, 2, 4, 4, 1, 3]
            .map(|micros| clock.now(LocalTime::from_micros(micros)))
            .map(|(now, is_jump)| (now.micros(), is_jump))
            .into();
        assert_eq!(times, [(5, false), (9, false), (9, true), (11, false), (11, false), (11, true), (13, false)]);
    }

    proptest! {
        /// Whatever the delays, and however the server's clock drifts within the limit, the latest time is never
        /// behind the server's.
        #[test]
        fn latest_is_never_early(
            drift in -1e-3..1e-3f64,
            probes in prop::collection::vec((0i64..200_000, 0i64..200_000, 0i64..100_000, 0i64..1_000_000), 1..50),
        ) {
            let mut clock = Clock::default();
            let mut now = 1_000_000i64;
            let server = |local: i64| WorldTime::from_micros(77_000_000 + local + (local as f64 * drift) as i64);
            for (forth, back, hold, pause) in probes {
                let sent = now;
                let stamped = sent + forth + hold;
                let arrived = stamped + back;
                let round = Duration::from_micros((arrived - sent - hold) as u64);
                clock.observe(server(stamped), round, LocalTime::from_micros(arrived));
                now = arrived + pause;
                let latest = clock.latest(LocalTime::from_micros(now)).unwrap();
                // Two microseconds for the integer times of this test itself.
                prop_assert!(latest.offset_micros(2) >= server(now));
            }
        }
    }
}
