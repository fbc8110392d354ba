//! The people in front of headless clients: they walk, stand and look, or walk as somebody once did.

use std::sync::Arc;

use eyeline_client::net::{Driver, FrameReport, Pose};
use eyeline_client::session::Session;
use eyeline_client::tracking::Ahead;
use eyeline_protocol::{LocalTime, ObjectId, Orientation, Position};
use eyeline_server::spec::AvatarSpec;
use eyeline_visibility::{AllRound, AllRoundScratch, EyeRegion, Occlusion};
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
    scratch: AllRoundScratch,
    has_culled: bool,
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
            scratch: ground.all_round.scratch(side),
            has_culled: false,
            hook,
        }
    }

    /// Moves on to `now` and says where the avatar is.
    pub fn advance(&mut self, session: &Session, now: LocalTime) -> Option<Pose> {
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
        self.pose = self.mover.as_mut()?.step(dt_s);
        let position = Position::from_metres(self.pose.feet - self.anchor).ok()?;
        Some(Pose { object: self.object, position, orientation: Orientation::from_yaw(self.pose.yaw) })
    }

    /// Where the person is and looks, in the model's space.
    pub fn pose(&self) -> WalkerPose {
        self.pose
    }
}

impl Driver for Person {
    fn poses(&mut self, session: &Session, now: LocalTime) -> Vec<Pose> {
        self.advance(session, now).into_iter().collect()
    }

    fn cull(&mut self, ahead: Ahead) {
        let region = EyeRegion { centre: self.pose.eye - self.anchor, radius: ahead.eye_radius };
        // Only an eye or radius that is no number is refused.
        self.has_culled = self.all_round.cull(region, &mut self.scratch).is_ok();
    }

    fn occlusion(&self) -> Option<&dyn Occlusion> {
        self.has_culled.then(|| self.scratch.occlusion() as &dyn Occlusion)
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
}

impl Replay {
    /// A crowd from `start_s` seconds into its trace; it begins again when the trace ends.
    pub fn new(crowd: Crowd, anchor: DVec3, start_s: f64) -> Replay {
        let slots = vec![None; crowd.trace.people_at_once()];
        Replay { crowd, anchor, began: None, start_s, slots, moves: 0, placing: Vec::new() }
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
            let place = person.and_then(|(_, person)| {
                let at = self.crowd.trace.position_at(person, time_s)?;
                let facing = self.crowd.trace.facing_at(person, time_s).unwrap_or(0.0);
                let feet = self.crowd.placement.feet(at) - self.anchor;
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
        let replay = crowd.map(|crowd| Extras::Replay(Replay::new(crowd.clone(), stage.anchor(), 0.0)));
        let of_one = |from: usize| {
            let count = (residents - from).min(RESIDENTS_MAX) as u16;
            Extras::Residents(Residents::new(stage.ground(), seed, first + from, count))
        };
        replay.into_iter().chain((0..residents).step_by(RESIDENTS_MAX).map(of_one)).collect()
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
