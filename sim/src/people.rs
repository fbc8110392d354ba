//! The people in front of headless clients: they walk, stand and look, or walk as somebody once did.

use std::sync::Arc;
use std::sync::atomic::Ordering;

use eyeline_client::net::{Driver, FrameReport, Pose};
use eyeline_client::session::Session;
use eyeline_client::tracking::Ahead;
use eyeline_protocol::{LocalTime, ObjectId, Orientation, Position};
use eyeline_server::spec::AvatarSpec;
use eyeline_visibility::{AllRound, AllRoundScratch, Bound, EyeRegion, Occlusion, Wedge};
use glam::DVec3;

use crate::motion::WalkerPose;
use crate::motion::walk::{SPEEDS, Walker};
use crate::motion::wander::Wanderer;
use crate::scene::plan::RoomPlan;
use crate::stage::{Crowd, Stage};

/// Somebody who moves by rule.
pub enum Mover {
    /// Walks from room to room.
    Walker(Box<Walker>),
    /// Stands and looks around.
    Wanderer(Box<Wanderer>),
}

impl Mover {
    /// The `number`th person of `seed`, who starts at `feet` (metres, in the model's space): a walker if there are rooms
    /// to walk in, else one who stands.
    ///
    /// # Errors
    /// If the plan and the start do not go together.
    pub fn new(
        plan: Option<&Arc<RoomPlan>>,
        avatar: AvatarSpec,
        seed: u64,
        number: usize,
        feet: DVec3,
    ) -> anyhow::Result<Mover> {
        // A stream of chance of each person's own.
        let own = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15).wrapping_add(number as u64);
        if let Some(plan) = plan {
            return Ok(Mover::Walker(Box::new(Walker::new(plan.clone(), avatar, own, feet, SPEEDS)?)));
        }
        let wanderer = Wanderer::new(&[feet], avatar, own, 0);
        Ok(Mover::Wanderer(Box::new(wanderer.ok_or_else(|| anyhow::anyhow!("no place to stand"))?)))
    }

    /// Moves on by `dt_s` seconds.
    pub fn step(&mut self, dt_s: f64) -> WalkerPose {
        match self {
            Mover::Walker(walker) => walker.step(dt_s),
            Mover::Wanderer(wanderer) => wanderer.step(dt_s),
        }
    }
}

/// What people must know of the world that they are in. Shared by all of a process.
#[derive(Clone)]
pub struct Ground {
    /// Rooms and doors, if the world was made; walkers need them.
    pub plan: Option<Arc<RoomPlan>>,
    /// What an avatar is like.
    pub avatar: AvatarSpec,
    /// The world's anchor in the model's space, metres.
    pub anchor: DVec3,
    /// Occluders for all-round culling.
    pub all_round: Arc<AllRound>,
}

/// Horizontal angle of everybody's view, radians.
pub const FOV: f64 = std::f64::consts::FRAC_PI_2;

/// Called after each frame with the session, the report, and the pose that the frame was seen from.
pub type FrameHook = Box<dyn FnMut(&mut Session, &FrameReport, &WalkerPose) + Send>;

/// A person with an avatar who looks around: the driver of a headless client.
pub struct Person {
    seed: u64,
    number: usize,
    plan: Option<Arc<RoomPlan>>,
    avatar: AvatarSpec,
    anchor: DVec3,
    mover: Option<Mover>,
    object: ObjectId,
    last: Option<LocalTime>,
    pose: WalkerPose,
    all_round: Arc<AllRound>,
    /// One for the region, or one for each of its sampled eyes.
    scratches: Vec<AllRoundScratch>,
    has_culled: bool,
    /// Whether an eye that stands still is culled for again.
    looks_again: bool,
    /// For how far a walk one cull does, metres.
    hold: f64,
    /// How far the eye has gone since the frame before, metres.
    gone: DVec3,
    /// Where anybody looks, if not all round.
    wedge: Option<Wedge>,
    hook: Option<FrameHook>,
}

impl Person {
    /// The `number`th person of `seed` in a world; culls on cube faces of `side` pixels.
    pub fn new(stage: &Stage, seed: u64, number: usize, side: u32, hook: Option<FrameHook>) -> Person {
        Person::on(&stage.ground(), seed, number, side, hook)
    }

    /// The same, for who has no whole stage.
    pub fn on(ground: &Ground, seed: u64, number: usize, side: u32, hook: Option<FrameHook>) -> Person {
        Person {
            seed,
            number,
            plan: ground.plan.clone(),
            avatar: ground.avatar,
            anchor: ground.anchor,
            mover: None,
            object: ObjectId(0),
            last: None,
            pose: WalkerPose { feet: DVec3::ZERO, yaw: 0.0, eye: DVec3::ZERO },
            all_round: ground.all_round.clone(),
            scratches: vec![ground.all_round.scratch(side)],
            has_culled: false,
            looks_again: false,
            hold: 0.0,
            gone: DVec3::ZERO,
            wedge: None,
            hook,
        }
    }

    /// Culls for a walk of twice `hold` metres at once. Farther than it keeps off walls it would see through them. 0, as without
    /// this, culls for each place anew.
    pub fn with_hold(self, hold: f64) -> Person {
        Person { hold, ..self }
    }

    /// Looks from nine eyes of the lead's region instead of the whole: a heuristic that misses some of it.
    pub fn with_sampled_lead(mut self, side: u32) -> Person {
        self.scratches.resize_with(9, || self.all_round.scratch(side));
        self
    }

    /// Moves on to `now` and says where the avatar is.
    pub fn advance(&mut self, session: &Session, now: LocalTime) -> Option<Pose> {
        self.looks_again = session.plan_switch().runs(eyeline_protocol::Stage::LookAgain, false);
        if self.mover.is_none() {
            let (object, position, _) = *session.welcome()?.avatars.first()?;
            let feet = self.anchor + position.metres();
            let mover = Mover::new(self.plan.as_ref(), self.avatar, self.seed, self.number, feet)
                .or_else(|_| Mover::new(None, self.avatar, self.seed, self.number, feet));
            self.object = object;
            self.mover = mover.ok();
        }
        let dt_s = self.last.map_or(0.0, |last| now.seconds_since(last));
        self.last = Some(now);
        let before = self.pose.eye;
        self.pose = self.mover.as_mut()?.step(dt_s);
        self.gone = self.pose.eye - before;
        let position = Position::from_metres(self.pose.feet - self.anchor).ok()?;
        Some(Pose { object: self.object, position, orientation: Orientation::from_yaw(self.pose.yaw) })
    }

    /// Bytes that its images take.
    pub fn memory_bytes(&self) -> usize {
        self.scratches.iter().map(AllRoundScratch::memory_bytes).sum()
    }

    /// Where the person is and looks, in the model's space.
    pub fn pose(&self) -> WalkerPose {
        self.pose
    }
}

impl Occlusion for Person {
    fn hides(&self, bound: &Bound) -> bool {
        self.wedge.is_some_and(|wedge| wedge.excludes(bound))
            || self.scratches.iter().all(|scratch| scratch.occlusion().hides(bound))
    }

    fn hides_group(&self, around: &Bound) -> bool {
        self.wedge.is_some_and(|wedge| wedge.excludes(around))
            || self.scratches.iter().all(|scratch| scratch.occlusion().hides_group(around))
    }

    fn version(&self) -> Option<u64> {
        match (&self.scratches[..], self.wedge) {
            ([one], None) => one.occlusion().version(),
            _ => None,
        }
    }

    fn stays(&self) -> bool {
        self.gone == DVec3::ZERO
    }

    fn parts(&self) -> Option<&[u32]> {
        // Nine eyes may be in nine parts.
        let [one] = &self.scratches[..] else { return None };
        one.occlusion().parts()
    }

    fn seals_off(&self, bound: &Bound) -> bool {
        self.scratches.iter().all(|scratch| scratch.occlusion().seals_off(bound))
    }
}

impl Driver for Person {
    fn poses(&mut self, session: &Session, now: LocalTime) -> Vec<Pose> {
        self.advance(session, now).into_iter().collect()
    }

    fn cull(&mut self, ahead: Ahead) {
        let centre = self.pose.eye - self.anchor;
        let count = self.scratches.len();
        for (i, scratch) in self.scratches.iter_mut().enumerate() {
            let turn = std::f64::consts::TAU * i as f64 / (count - 1).max(1) as f64;
            let region = match (count, i) {
                (1, _) => EyeRegion { centre, radius: ahead.eye_radius },
                (_, 0) => EyeRegion::point(centre),
                _ => EyeRegion::point(centre + DVec3::new(turn.cos(), 0.0, turn.sin()) * ahead.eye_radius),
            };
            // Only an eye or radius that is no number is refused.
            self.has_culled = match self.looks_again {
                true => self.all_round.cull(region, scratch).is_ok(),
                false => self.all_round.look_around(region, (self.hold, self.gone), scratch).is_ok(),
            };
        }
        let region = EyeRegion { centre, radius: ahead.eye_radius };
        self.wedge = ahead.turn.map(|turn| Wedge::new(region, self.pose.yaw, 0.5 * FOV + turn));
    }

    fn occlusion(&self) -> Option<&dyn Occlusion> {
        self.has_culled.then_some(self as &dyn Occlusion)
    }

    fn frame_done(&mut self, session: &mut Session, report: &FrameReport) {
        if let Some(hook) = &mut self.hook {
            hook(session, report, &self.pose);
        }
    }
}

/// A recorded crowd, all of it, behind one connection: looks at nothing.
pub struct Replay {
    crowd: Crowd,
    anchor: DVec3,
    /// When the trace began, and by how much it is shifted, in seconds.
    began: Option<LocalTime>,
    start_s: f64,
    /// Who is in each slot, and since which time around: who begins anew is somebody else.
    slots: Vec<Option<(i64, usize)>>,
    /// Places to announce: (slot, where, whether present).
    pub moves: u64,
    placing: Vec<(ObjectId, Position, bool)>,
    /// Of each slot, where the recording had them last and where they got to, relative to the anchor.
    feet: Vec<(DVec3, DVec3)>,
}

impl Replay {
    /// A crowd from `start_s` seconds into its trace; it begins again when the trace ends.
    pub fn new(crowd: Crowd, anchor: DVec3, start_s: f64) -> Replay {
        let slots = vec![None; crowd.trace.people_at_once()];
        let feet = vec![(DVec3::ZERO, DVec3::ZERO); slots.len()];
        Replay { crowd, anchor, began: None, start_s, slots, moves: 0, placing: Vec::new(), feet }
    }

    /// How many avatars it drives.
    pub fn avatars(&self) -> u16 {
        u16::try_from(self.slots.len()).unwrap_or(u16::MAX)
    }

    /// Says who came and who went in the newest frame.
    pub fn announce(&mut self, session: &mut Session) {
        for (object, position, present) in self.placing.drain(..) {
            session.place(object, position, present);
            self.moves += 1;
        }
    }

    /// Who is where at `now`: poses of those who stay, and a place for each who came or went.
    fn advance(&mut self, avatars: &[ObjectId], now: LocalTime) -> Vec<Pose> {
        let began = *self.began.get_or_insert(now);
        let span = self.crowd.trace.span_s().max(1e-3);
        let gone_s = self.start_s + now.seconds_since(began);
        let (lap, time_s) = (gone_s.div_euclid(span) as i64, gone_s.rem_euclid(span));
        let wanted = self.crowd.trace.slots_at(time_s);
        let mut poses = Vec::new();
        for (slot, &object) in avatars.iter().enumerate().take(self.slots.len()) {
            let person = wanted.get(slot).copied().flatten().map(|person| (lap, person));
            let place = person.and_then(|(lap, number)| {
                let at = self.crowd.trace.position_at(number, time_s)?;
                let facing = self.crowd.trace.facing_at(number, time_s).unwrap_or(0.0);
                let recorded = self.crowd.placement.feet(at) - self.anchor;
                let feet = match (&self.crowd.obstacles, self.slots[slot] == Some((lap, number))) {
                    (Some(obstacles), true) => {
                        let (before, feet) = self.feet[slot];
                        let (feet, slid) = obstacles.step(feet, recorded - before);
                        self.crowd.slid.fetch_add(u64::from(slid), Ordering::Relaxed);
                        feet
                    }
                    // Who has just come, or nothing to slide along.
                    _ => recorded,
                };
                self.feet[slot] = (recorded, feet);
                Some((Position::from_metres(feet).ok()?, self.crowd.placement.yaw(facing)))
            });
            match (place, self.slots[slot] == person) {
                (Some((position, yaw)), true) => {
                    poses.push(Pose { object, position, orientation: Orientation::from_yaw(yaw) });
                }
                (Some((position, _)), false) => {
                    self.placing.push((object, position, true));
                    self.slots[slot] = person;
                }
                (None, _) if self.slots[slot].is_some() => {
                    self.placing.push((object, Position::default(), false));
                    self.slots[slot] = None;
                }
                (None, _) => {}
            }
        }
        poses
    }
}

impl Driver for Replay {
    fn poses(&mut self, session: &Session, now: LocalTime) -> Vec<Pose> {
        let avatars: Vec<ObjectId> = session
            .welcome()
            .map(|welcome| welcome.avatars.iter().map(|avatar| avatar.0).collect())
            .unwrap_or_default();
        self.advance(&avatars, now)
    }

    fn cull(&mut self, _: Ahead) {}

    fn occlusion(&self) -> Option<&dyn Occlusion> {
        None
    }

    fn frame_done(&mut self, session: &mut Session, _: &FrameReport) {
        self.announce(session);
    }
}

/// Avatars that walk and look at nothing, all behind one connection: those who fill a large world.
pub struct Residents {
    ground: Ground,
    seed: u64,
    /// The number of the first of them, for chance of their own.
    first: usize,
    movers: Vec<Mover>,
    count: u16,
    last: Option<LocalTime>,
    placing: Vec<(ObjectId, Position, bool)>,
}

impl Residents {
    /// `count` people of `seed`, numbered from `first`.
    pub fn new(ground: Ground, seed: u64, first: usize, count: u16) -> Residents {
        Residents { ground, seed, first, movers: Vec::new(), count, last: None, placing: Vec::new() }
    }

    fn advance(&mut self, session: &Session, now: LocalTime) -> Vec<Pose> {
        let Some(welcome) = session.welcome() else { return Vec::new() };
        if self.movers.is_empty() {
            let Ground { plan, avatar, anchor, .. } = &self.ground;
            for (number, &(object, position, _)) in welcome.avatars.iter().enumerate() {
                let (feet, number) = (*anchor + position.metres(), self.first + number);
                let mover = Mover::new(plan.as_ref(), *avatar, self.seed, number, feet)
                    .or_else(|_| Mover::new(None, *avatar, self.seed, number, feet));
                self.movers.extend(mover);
                self.placing.push((object, position, true));
            }
        }
        let dt_s = self.last.map_or(0.0, |last| now.seconds_since(last));
        self.last = Some(now);
        let pose = |(mover, &(object, ..)): (&mut Mover, &(ObjectId, Position, Orientation))| {
            let pose = mover.step(dt_s);
            let position = Position::from_metres(pose.feet - self.ground.anchor).ok()?;
            Some(Pose { object, position, orientation: Orientation::from_yaw(pose.yaw) })
        };
        self.movers.iter_mut().zip(&welcome.avatars).filter_map(pose).collect()
    }
}

/// People whom a measurement needs but whose clients it does not: a recorded crowd, or residents.
pub enum Extras {
    /// People who once walked.
    Replay(Replay),
    /// People who walk by rule.
    Residents(Residents),
}

impl Extras {
    /// The crowd, if there is one, and `residents` people besides, numbered from `first`: one connection each for as many as
    /// it may drive.
    pub fn all(stage: &Stage, crowd: Option<&Crowd>, residents: usize, seed: u64, first: usize) -> Vec<Extras> {
        let replays = crowd.into_iter().flat_map(|crowd| {
            let copies = std::iter::once((crowd.placement, 0.0)).chain(crowd.copies.iter().copied());
            copies.map(|(placement, start_s)| {
                let crowd = Crowd { placement, ..crowd.clone() };
                Extras::Replay(Replay::new(crowd, stage.anchor(), start_s))
            })
        });
        let of_one = |from: usize| {
            let count = (residents - from).min(RESIDENTS_MAX) as u16;
            Extras::Residents(Residents::new(stage.ground(), seed, first + from, count))
        };
        replays.chain((0..residents).step_by(RESIDENTS_MAX).map(of_one)).collect()
    }

    /// How many avatars it drives.
    pub fn avatars(&self) -> u16 {
        match self {
            Extras::Replay(replay) => replay.avatars(),
            Extras::Residents(residents) => residents.count,
        }
    }

    /// A name for people.
    pub fn name(&self) -> &'static str {
        match self {
            Extras::Replay(_) => "replay",
            Extras::Residents(_) => "residents",
        }
    }

    /// Whether no network lies between them and the server.
    pub fn is_local(&self) -> bool {
        matches!(self, Extras::Residents(_))
    }

    /// Says who came and who went in the newest frame.
    pub fn announce(&mut self, session: &mut Session) {
        match self {
            Extras::Replay(replay) => replay.announce(session),
            Extras::Residents(residents) => {
                for (object, position, present) in residents.placing.drain(..) {
                    session.place(object, position, present);
                }
            }
        }
    }
}

/// Most avatars of one connection of residents.
const RESIDENTS_MAX: usize = eyeline_protocol::AVATARS_MAX;

impl Driver for Extras {
    fn poses(&mut self, session: &Session, now: LocalTime) -> Vec<Pose> {
        match self {
            Extras::Replay(replay) => replay.poses(session, now),
            Extras::Residents(residents) => residents.advance(session, now),
        }
    }

    fn cull(&mut self, _: Ahead) {}

    fn occlusion(&self) -> Option<&dyn Occlusion> {
        None
    }

    fn frame_done(&mut self, session: &mut Session, _: &FrameReport) {
        self.announce(session);
    }
}
