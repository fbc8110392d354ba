//! Where the process stands, for those who watch it. Read without any lock, so that a world that hangs can be seen to.

use std::sync::atomic::{AtomicI64, AtomicU8, Ordering};
use std::time::Duration;

use eyeline_protocol::WorldTime;

/// How far a server has got.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Stage {
    /// It listens, and does not serve yet.
    Starting,
    /// It serves.
    Serving,
    /// It has been told to end: whoever is here is told, whoever comes is turned away.
    Draining,
    /// It has ended.
    Ended,
}

impl Stage {
    const ALL: [Stage; 4] = [Stage::Starting, Stage::Serving, Stage::Draining, Stage::Ended];

    /// Its name for people.
    pub fn name(self) -> &'static str {
        match self {
            Stage::Starting => "starting",
            Stage::Serving => "serving",
            Stage::Draining => "draining",
            Stage::Ended => "ended",
        }
    }
}

/// Ticks go on if the last one is no older than this and ten periods.
const TICK_AGE_MAX: Duration = Duration::from_secs(2);

#[derive(Debug)]
pub(super) struct Life {
    stage: AtomicU8,
    /// World time of the end of the last tick, microseconds.
    ticked_micros: AtomicI64,
    period: Duration,
}

impl Life {
    pub fn new(period: Duration, now: WorldTime) -> Life {
        Life { stage: AtomicU8::new(0), ticked_micros: AtomicI64::new(now.micros()), period }
    }

    pub fn stage(&self) -> Stage {
        let stage = usize::from(self.stage.load(Ordering::Acquire));
        Stage::ALL.get(stage).copied().unwrap_or(Stage::Ended)
    }

    pub fn enter(&self, stage: Stage) {
        self.stage.store(stage as u8, Ordering::Release);
    }

    pub fn ticked(&self, now: WorldTime) {
        self.ticked_micros.store(now.micros(), Ordering::Release);
    }

    /// How long ago the last tick ended, and whether that is too long for a server that serves.
    pub fn tick_age(&self, now: WorldTime) -> (Duration, bool) {
        let age = now.since(WorldTime::from_micros(self.ticked_micros.load(Ordering::Acquire)));
        let is_stuck = self.stage() == Stage::Serving && age > TICK_AGE_MAX.max(10 * self.period);
        (age, is_stuck)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_server_that_serves_and_does_not_tick_is_stuck() {
        let at = |seconds| WorldTime::ZERO + Duration::from_secs(seconds);
        let life = Life::new(Duration::from_millis(50), at(0));
        assert_eq!((life.stage(), life.tick_age(at(60)).1), (Stage::Starting, false));
        life.enter(Stage::Serving);
        life.ticked(at(60));
        assert_eq!(life.tick_age(at(62)), (Duration::from_secs(2), false));
        assert_eq!(life.tick_age(at(63)), (Duration::from_secs(3), true));
        life.enter(Stage::Draining);
        assert_eq!(life.tick_age(at(90)), (Duration::from_secs(30), false), "there is nothing to tick for any more");
        let slow = Life::new(Duration::from_secs(10), at(0));
        slow.enter(Stage::Serving);
        assert!(!slow.tick_age(at(99)).1 && slow.tick_age(at(101)).1);
    }
}
