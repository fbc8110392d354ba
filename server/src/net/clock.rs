//! What time it is in the world, by the process's own clock.

use std::time::Instant;

use eyeline_protocol::WorldTime;

/// The world's time as a driver tells it: `base` at `epoch`.
#[derive(Clone, Copy, Debug)]
pub struct WorldClock {
    epoch: Instant,
    base: WorldTime,
}

impl WorldClock {
    /// A clock that shows `base` now.
    pub fn starting_at(base: WorldTime) -> WorldClock {
        WorldClock { epoch: Instant::now(), base }
    }

    /// The time now.
    pub fn now(&self) -> WorldTime {
        self.base + self.epoch.elapsed()
    }

    /// The time that the clock shows at `instant`; its base before it started.
    pub fn at(&self, instant: Instant) -> WorldTime {
        self.base + instant.saturating_duration_since(self.epoch)
    }

    /// When the clock will show `time`.
    pub fn instant(&self, time: WorldTime) -> Instant {
        self.epoch + time.since(self.base)
    }
}
