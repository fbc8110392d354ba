//! One thing that may move: what it is committed to, what it wants, who may hold a bound of it.

use eyeline_protocol::{ClassId, Issue, MotionBound, ObjectId, Orientation, Position, QUANTUM_METRES, Tbv, WorldTime};
use fixedbitset::FixedBitSet;
use glam::DVec3;

use super::{SessionId, WorldConfig, blur};
use crate::path::Path;

/// An object of the world. Everything public is the committed state.
pub struct Object {
    /// Name for people.
    pub name: String,
    /// Node of the model with its mesh; empty for an avatar.
    pub node: String,
    /// Its kind.
    pub class: ClassId,
    /// Reference point.
    pub position: Position,
    /// How it is turned.
    pub orientation: Orientation,
    /// Tick of the last change of position or orientation.
    pub changed_at: WorldTime,
    /// How often it has broken its bound.
    pub issue: Issue,
    /// Whether it is in the world.
    pub present: bool,
    /// Whether its id is in use.
    pub alive: bool,
    /// Who moves it; nobody but its path if `None`.
    pub(super) owner: Option<SessionId>,
    pub(super) path: Option<Path>,
    /// The newest pose that its owner asked for, and that datagram's number.
    pub(super) wanted: Option<(Position, Orientation)>,
    pub(super) wanted_seq: u32,
    /// A place to go to at once, and whether it is in the world then.
    pub(super) placed: Option<(Position, bool)>,
    /// Slots of the sessions that may hold a bound or a state.
    pub(super) holders: FixedBitSet,
    /// Of those, the ones that were told something since the last violation.
    pub(super) told_since_violation: FixedBitSet,
    /// The bound that was told last.
    issued: blur::Issued,
    /// Metres that it may still move, beyond what each tick adds: the token bucket of its motion bound.
    allowance: f64,
}

/// What came of a commit.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Outcome {
    /// The pose was beyond the motion bound and was held back.
    pub clamped: bool,
    /// The bound was broken on purpose.
    pub violated: bool,
    /// It came into the world or left it.
    pub entered_or_left: bool,
}

impl Object {
    pub(super) fn new(name: String, class: ClassId, position: Position, now: WorldTime) -> Object {
        Object {
            name,
            node: String::new(),
            class,
            position,
            orientation: Orientation::default(),
            changed_at: now,
            issue: Issue(0),
            present: true,
            alive: true,
            owner: None,
            path: None,
            wanted: None,
            wanted_seq: 0,
            placed: None,
            holders: FixedBitSet::new(),
            told_since_violation: FixedBitSet::new(),
            issued: blur::Issued::default(),
            allowance: 0.0,
        }
    }

    /// Moves to what is wanted, as far as `motion` allows in `elapsed` seconds since the last tick.
    ///
    /// The allowance gains speed·elapsed and is capped at the slack before that, so that over any run of ticks the
    /// distance is at most speed·time + slack: [`MotionBound`]'s promise.
    pub(super) fn commit(&mut self, tick: WorldTime, elapsed: f64, motion: MotionBound, anchor: DVec3) -> Outcome {
        let mut outcome = Outcome::default();
        self.allowance = self.allowance.min(motion.slack) + motion.speed_max * elapsed;
        if let Some((position, present)) = self.placed.take() {
            outcome.violated = position != self.position || present != self.present;
            outcome.entered_or_left = present != self.present;
            if outcome.violated {
                self.position = position;
                self.present = present;
                // Somebody took it: it no longer follows its path, and a bound by the path would be wrong.
                self.path = None;
                self.issue = Issue(self.issue.0 + 1);
                self.changed_at = tick;
                self.allowance = motion.slack;
            }
            return outcome;
        }
        let wanted = match &self.path {
            Some(path) => {
                let (place, heading) = path.pose_at(tick.seconds());
                Position::from_metres(place - anchor).ok().map(|position| (position, Orientation::from_yaw(heading)))
            }
            // What stands upright turns about the vertical only: its extent holds for no other turn.
            None => self.wanted.take().map(|(position, turn)| (position, Orientation::from_yaw(turn.yaw()))),
        };
        let Some((position, orientation)) = wanted else { return outcome };
        let position = self.reachable(position, &mut outcome);
        if position != self.position || orientation != self.orientation {
            self.allowance -= position.metres().distance(self.position.metres());
            self.position = position;
            self.orientation = orientation;
            self.changed_at = tick;
        }
        outcome
    }

    /// `wanted`, or the farthest grid point towards it within the allowance.
    fn reachable(&self, wanted: Position, outcome: &mut Outcome) -> Position {
        let (from, to) = (self.position.metres(), wanted.metres());
        let distance = from.distance(to);
        if distance <= self.allowance {
            return wanted;
        }
        outcome.clamped = true;
        // One step less, since snapping to the grid may add up to √3/2 steps.
        let reach = (self.allowance - QUANTUM_METRES).max(0.0);
        if reach == 0.0 {
            return self.position;
        }
        Position::from_metres(from + (to - from) * (reach / distance)).unwrap_or(self.position)
    }

    /// The bound to tell at this tick; the same for all who ask.
    ///
    /// What follows a preset path is bounded by the ball around the whole path, which does not grow; what nobody moves
    /// does not grow either. Everything else grows by its class's speed.
    pub(super) fn fresh_tbv(
        &mut self,
        tick: WorldTime,
        motion: MotionBound,
        config: &WorldConfig,
        anchor: DVec3,
    ) -> Tbv {
        let (centre, radius, speed) = match (&self.path, self.owner) {
            (Some(path), _) if config.swept => {
                let (middle, reach) = path.ball();
                // However short the path, where it is on it is not to be known better than the blur.
                let radius = blur::beside(reach + QUANTUM_METRES, config.blur);
                (Position::from_metres(middle - anchor).unwrap_or(self.position), radius, 0.0)
            }
            (None, None) if config.swept => {
                let (centre, reach) = blur::blurred(self.position, config);
                (centre, blur::beside(reach, config.blur), 0.0)
            }
            _ => {
                let (centre, radius) = blur::blurred(self.position, config);
                (centre, radius, motion.speed_max)
            }
        };
        let tbv = Tbv {
            centre,
            radius: radius + motion.slack,
            speed,
            issued: tick,
            expires: tick + config.validity_max,
            issue: self.issue,
        };
        // Without blur there is nothing to keep, and the freshest is best.
        let tbv = if config.blur > 0.0 { self.issued.nested(tbv) } else { tbv };
        debug_assert!(tbv.contains(self.position.metres(), tick), "a bound must contain its object when it is issued");
        tbv
    }

    /// How it is told of to a holder from now on.
    pub(super) fn note_holder(&mut self, slot: usize) {
        self.holders.grow_and_insert(slot);
        self.told_since_violation.grow_and_insert(slot);
    }

    /// The session in this slot holds nothing of it. The sets are only as long as their last holder needs.
    pub(super) fn forget_holder(&mut self, slot: usize) {
        for set in [&mut self.holders, &mut self.told_since_violation] {
            if slot < set.len() {
                set.set(slot, false);
            }
        }
    }
}

/// Ids of the objects that are in the world.
pub(crate) fn present(objects: &[Object]) -> impl Iterator<Item = (ObjectId, &Object)> {
    objects
        .iter()
        .enumerate()
        .filter(|(_, object)| object.alive && object.present)
        .map(|(index, object)| (ObjectId(index as u32), object))
}
