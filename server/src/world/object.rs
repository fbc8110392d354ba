//! One thing that may move: what it is committed to, what it wants, who may hold a bound of it.

use std::f64::consts::{PI, TAU};

use eyeline_protocol::{
    Class, ClassId, Issue, MotionBound, ObjectId, Orientation, Position, QUANTUM_METRES, ServerRecord, Tbv, Velocity,
    WorldTime, codec,
};
use fixedbitset::FixedBitSet;
use glam::DVec3;

use super::{SessionId, WorldConfig, blur};
use crate::path::Path;
use crate::spring::Motion;

/// An object of the world. Everything public is the committed state.
// What is looked at for each client that is told of it, and for each pose, comes first, in two lines of the cache that are fetched together.
#[repr(C, align(128))]
pub struct Object {
    /// Tick of the last change of position or orientation.
    pub changed_at: WorldTime,
    /// Reference point.
    pub position: Position,
    /// How often it has broken its bound.
    pub issue: Issue,
    /// Whether it is in the world.
    pub present: bool,
    /// Whether its id is in use.
    pub alive: bool,
    /// The record of its state: all who are told of it in a tick are told the same bytes.
    state_record: StateRecord,
    /// How it is turned.
    pub orientation: Orientation,
    /// How it moved of late.
    pub velocity: Velocity,
    /// Its kind.
    pub class: ClassId,
    /// Who moves it; nobody but its path if `None`.
    pub(super) owner: Option<SessionId>,
    /// The newest pose that its owner asked for, and that datagram's number.
    pub(super) wanted: Option<(Position, Orientation)>,
    pub(super) wanted_seq: u32,
    /// Name for people.
    pub name: String,
    /// Node of the model with its mesh; empty for an avatar.
    pub node: String,
    pub(super) path: Option<Path>,
    /// The turn that its path had it make last, radians, and the same as it is on the wire.
    heading: f64,
    headed: Orientation,
    /// How it moves on its path's spring, since the first tick.
    swing: Option<Motion>,
    /// Whether people may move it.
    pub(super) takeable: bool,
    /// Whether somebody has just taken it: what was said of how it moves holds no longer.
    pub(super) is_freed: bool,
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
    /// Radians that it may still turn, likewise.
    turn_allowance: f64,
    /// Metres a second of the last tick.
    moved: DVec3,
}

const _: () = assert!(std::mem::offset_of!(Object, name) <= 128);

/// A state as a datagram carries it.
struct StateRecord {
    tick: WorldTime,
    len: u8,
    bytes: [u8; STATE_BYTES_MAX],
}

/// A kind, an id of at most five bytes, twelve of a place, four of a turn, and nine of a velocity are fewer.
const STATE_BYTES_MAX: usize = 32;

/// What came of a commit.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Outcome {
    /// The pose was beyond the motion bound and was held back.
    pub clamped: bool,
    /// It turned faster than its class may, and was held back.
    pub turn_clamped: bool,
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
            velocity: Velocity::ZERO,
            changed_at: now,
            issue: Issue(0),
            present: true,
            alive: true,
            owner: None,
            path: None,
            heading: f64::NAN,
            headed: Orientation::default(),
            swing: None,
            takeable: false,
            is_freed: false,
            wanted: None,
            wanted_seq: 0,
            placed: None,
            holders: FixedBitSet::new(),
            told_since_violation: FixedBitSet::new(),
            issued: blur::Issued::default(),
            allowance: 0.0,
            turn_allowance: 0.0,
            moved: DVec3::ZERO,
            state_record: StateRecord { tick: WorldTime::MIN, len: 0, bytes: [0; STATE_BYTES_MAX] },
        }
    }

    /// Bytes that it takes, what its path is made of apart.
    pub(super) fn memory_bytes(&self) -> usize {
        size_of::<Object>() + self.name.capacity() + self.node.capacity() + self.sharing_bytes()
    }

    /// Bytes of the sets that say who may hold something of it.
    pub(super) fn sharing_bytes(&self) -> usize {
        let bits = self.holders.len() + self.told_since_violation.len();
        bits.div_ceil(usize::BITS as usize) * size_of::<usize>()
    }

    /// Moves to what is wanted, as far as its class allows in `elapsed` seconds since the last tick.
    ///
    /// The allowance gains speed·elapsed and is capped at the slack before that, so that over any run of ticks the
    /// distance is at most speed·time + slack: [`MotionBound`]'s promise.
    pub(super) fn commit(&mut self, tick: WorldTime, elapsed: f64, class: &Class, anchor: DVec3) -> Outcome {
        let motion = class.motion;
        let before = self.position;
        let outcome = self.commit_pose(tick, elapsed, motion, class.turn_max, anchor);
        if self.position == before && self.moved == DVec3::ZERO {
            self.velocity = Velocity::ZERO;
            return outcome;
        }
        let moved = (self.position.metres() - before.metres()) / elapsed;
        // The mean of two ticks: poses come with jitter, so that one may find none in one tick and two in the next. Who
        // has not moved in either stands, and who was put elsewhere did not walk there.
        let mean = 0.5 * (moved + self.moved);
        let is_walk = elapsed > 0.0 && !outcome.violated;
        (self.velocity, self.moved) =
            if is_walk { (Velocity::from_metres(mean), moved) } else { (Velocity::ZERO, DVec3::ZERO) };
        outcome
    }

    fn commit_pose(
        &mut self,
        tick: WorldTime,
        elapsed: f64,
        motion: MotionBound,
        turn_max: Option<f64>,
        anchor: DVec3,
    ) -> Outcome {
        let mut outcome = Outcome::default();
        if let Some(turn_max) = turn_max {
            // The same jitter of poses as for walking, and a step of the wire's turns.
            let jitter_s = (motion.slack / motion.speed_max.max(f64::MIN_POSITIVE)).min(1.0);
            self.turn_allowance = self.turn_allowance.min(turn_max * jitter_s + TURN_STEP) + turn_max * elapsed;
        }
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
        if std::mem::take(&mut self.is_freed) {
            outcome.violated = true;
            self.path = None;
            self.issue = Issue(self.issue.0 + 1);
            self.changed_at = tick;
            self.allowance = motion.slack;
            return outcome;
        }
        let wanted = match &self.path {
            Some(path) => {
                let (place, heading) = path.pose_at(tick.seconds());
                let place = match path.spring() {
                    Some(spring) => {
                        let before = path.pose_at(tick.seconds() - elapsed).0;
                        let still = Motion { position: self.position.metres() + anchor, velocity: DVec3::ZERO };
                        let swing = spring.step(self.swing.unwrap_or(still), before, place, elapsed);
                        self.swing.insert(swing).position
                    }
                    None => place,
                };
                // What does not wobble keeps its turn.
                if self.heading != heading {
                    (self.heading, self.headed) = (heading, Orientation::from_yaw(heading));
                }
                Position::from_metres(place - anchor).ok().map(|position| (position, self.headed))
            }
            // What stands upright turns about the vertical only: its extent holds for no other turn.
            None => self.wanted.take().map(|(position, turn)| {
                let is_bounded = turn_max.is_some();
                let turn = turn.yaw();
                (position, if is_bounded { self.turned(turn, &mut outcome) } else { Orientation::from_yaw(turn) })
            }),
        };
        let Some((position, orientation)) = wanted else { return outcome };
        let position = self.reachable(position, &mut outcome);
        if position != self.position || orientation != self.orientation {
            self.allowance -= position.metres().distance(self.position.metres());
            self.position = position;
            self.orientation = orientation;
            self.changed_at = tick;
        }
        if let Some(swing) = &mut self.swing
            && outcome.clamped
        {
            // Its class is slower than its spring would have it: it goes on from where it came to.
            swing.position = self.position.metres() + anchor;
            swing.velocity = swing.velocity.clamp_length_max(motion.speed_max);
        }
        outcome
    }

    /// The turn `wanted` about the vertical, radians, or as far towards it, the short way, as it may.
    fn turned(&mut self, wanted: f64, outcome: &mut Outcome) -> Orientation {
        let short_way = |turn: f64| (turn + PI).rem_euclid(TAU) - PI;
        let yaw = self.orientation.yaw();
        let turn = short_way(wanted - yaw);
        let most = self.turn_allowance.max(0.0);
        outcome.turn_clamped = turn.abs() > most;
        let orientation = Orientation::from_yaw(yaw + turn.clamp(-most, most));
        // What the wire's steps made of it is what counts.
        self.turn_allowance -= short_way(orientation.yaw() - yaw).abs();
        orientation
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
    /// does not grow either. Everything else grows by its class's speed, what hangs on its path by a spring too: a spring
    /// without damping may swing as far beyond the path as its corners drive it.
    pub(super) fn fresh_tbv(
        &mut self,
        tick: WorldTime,
        motion: MotionBound,
        config: &WorldConfig,
        anchor: DVec3,
    ) -> Tbv {
        // A ball that does not grow must leave room beside any place in it that was told before or after: with a radius of
        // √(reach² + blur²) its edge is a blur away in some direction from all within reach of its middle (`blur.rs`).
        let (centre, radius, speed) = match (&self.path, self.owner) {
            (Some(path), _) if config.swept && path.spring().is_none() => {
                let (middle, reach) = path.ball();
                let reach = reach.hypot(config.blur) + QUANTUM_METRES;
                (Position::from_metres(middle - anchor).unwrap_or(self.position), reach, 0.0)
            }
            (None, None) if config.swept => {
                let (centre, radius) = blur::blurred(self.position, config);
                (centre, radius.hypot(config.blur), 0.0)
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

    /// Its state of `tick`, the newest, as a datagram carries it; `reckons` is whether states say how they go on, the same for
    /// all.
    pub(super) fn state_record(&mut self, object: ObjectId, tick: WorldTime, reckons: bool) -> &[u8] {
        if self.state_record.tick != tick {
            let velocity = if reckons { self.velocity } else { Velocity::ZERO };
            let Object { position, orientation, .. } = *self;
            let record = ServerRecord::State { object, position, orientation, velocity };
            self.state_record.len = codec::encode_record(&record, &mut self.state_record.bytes) as u8;
            self.state_record.tick = tick;
        }
        &self.state_record.bytes[..usize::from(self.state_record.len)]
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

/// Two turns on the wire of one heading differ by no more, radians: 0.0015 about each axis, of either.
const TURN_STEP: f64 = 0.006;

/// Ids of the objects that are in the world.
pub(crate) fn present(objects: &[Object]) -> impl Iterator<Item = (ObjectId, &Object)> {
    objects
        .iter()
        .enumerate()
        .filter(|(_, object)| object.alive && object.present)
        .map(|(index, object)| (ObjectId(index as u32), object))
}
