//! What a tracker must know of the frames before it was made.
//!
//! Where nothing moves there is no tracker, and where nothing moves any more there is none again. One that is made
//! later must decide as if it had been there all the time, so that leaving it out changes no message.

use std::collections::BTreeMap;

use eyeline_protocol::{LocalTime, ObjectId, WorldTime};

use super::tracker::Violated;
use super::{Ahead, TrackerStats};

/// Frames that were made without a tracker, and what is left of trackers before them.
#[derive(Clone, Debug)]
pub(crate) struct Past {
    /// Latest possible server time at the newest frame.
    pub latest: WorldTime,
    /// That and the lead.
    pub horizon: WorldTime,
    /// The newest frame's lead.
    pub ahead: Ahead,
    /// When the server was heard of last.
    pub heard_at: Option<LocalTime>,
    /// Questions asked so far: what is heard of an old one must not pass for a new one about an id that is used again.
    pub asks: u64,
    /// The newest violation of each object. One may be heard of before the roster that names its object.
    pub violations: BTreeMap<ObjectId, Violated>,
    /// Counters since the start; frames without a tracker count, too.
    pub stats: TrackerStats,
}

impl Default for Past {
    fn default() -> Past {
        Past {
            latest: WorldTime::MIN,
            horizon: WorldTime::MIN,
            ahead: Ahead::default(),
            heard_at: None,
            asks: 0,
            violations: BTreeMap::new(),
            stats: TrackerStats::default(),
        }
    }
}

impl Past {
    /// One frame more.
    pub fn frame(&mut self, latest: WorldTime, ahead: Ahead) {
        self.stats.frames += 1;
        self.latest = self.latest.max(latest);
        self.ahead = ahead;
        self.horizon = self.horizon.max(self.latest + ahead.time);
    }
}
