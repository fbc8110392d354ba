//! What a tracker must know of the frames before it was made.
//!
//! Where nothing moves there is no tracker. One that is made later must decide as if it had been there all the time, so that
//! leaving it out changes no message.

use eyeline_protocol::{LocalTime, WorldTime};

use super::Ahead;

/// Frames that were made without a tracker.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Past {
    /// How many.
    pub frames: u64,
    /// Latest possible server time at the newest.
    pub latest: WorldTime,
    /// That and the lead.
    pub horizon: WorldTime,
    /// The newest frame's lead.
    pub ahead: Ahead,
    /// When the server was heard of last.
    pub heard_at: Option<LocalTime>,
}

impl Default for Past {
    fn default() -> Past {
        let (latest, horizon) = (WorldTime::MIN, WorldTime::MIN);
        Past { frames: 0, latest, horizon, ahead: Ahead::default(), heard_at: None }
    }
}

impl Past {
    /// One frame more.
    pub fn frame(&mut self, latest: WorldTime, ahead: Ahead) {
        self.frames += 1;
        self.latest = self.latest.max(latest);
        self.ahead = ahead;
        self.horizon = self.horizon.max(self.latest + ahead.time);
    }
}
