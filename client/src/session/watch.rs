//! What comes into view, stops, and goes: the difference between frames, told as events. "Hidden" and "stopped" look alike in
//! what a server sends, which is nothing; here they are told apart.

use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;

use eyeline_protocol::{ObjectId, Velocity, WorldTime};

use super::Event;
use crate::tracking::Tracker;

/// An object in sight of which so many ticks bring nothing stands still: one may be late, and one lost.
const STILL_TICKS: u32 = 3;

/// What was shown in the newest frame.
#[derive(Default)]
pub(super) struct Watch {
    shown: BTreeMap<ObjectId, Shown>,
    frame: u64,
    /// The newest tick that the server has told of.
    tick: WorldTime,
}

struct Shown {
    frame: u64,
    is_still: bool,
}

impl Watch {
    /// The server has told of this tick.
    pub fn hear(&mut self, tick: WorldTime) {
        self.tick = self.tick.max(tick);
    }

    /// The object exists no more.
    pub fn leave(&mut self, object: ObjectId) {
        self.shown.remove(&object);
    }

    /// A frame has been decided on.
    pub fn frame(&mut self, tracker: &Tracker, tick_period: Duration, events: &mut VecDeque<Event>) {
        self.frame += 1;
        let frame = self.frame;
        for drawn in tracker.drawn() {
            let shown = self.shown.entry(drawn.object).or_insert_with(|| {
                events.push_back(Event::Revealed(drawn.object));
                Shown { frame, is_still: false }
            });
            shown.frame = frame;
            let is_silent = self.tick.since(drawn.tick) >= STILL_TICKS * tick_period;
            let is_still = is_silent && drawn.velocity == Velocity::ZERO;
            if is_still && !shown.is_still {
                events.push_back(Event::Stopped(drawn.object));
            }
            shown.is_still = is_still;
        }
        self.shown.retain(|&object, shown| {
            let is_shown = shown.frame == frame;
            if !is_shown {
                events.push_back(Event::Hidden(object));
            }
            is_shown
        });
    }
}
