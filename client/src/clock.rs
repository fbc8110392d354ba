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
        if self.latest(now).is_none_or(|known| latest < known || sent > known) && !self.frozen {
            self.latest = Some((now, latest));
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
