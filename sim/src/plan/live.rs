//! A server and a client in virtual time, to count what a plan's live half is about: who moves, who is told what, and what is
//! asked.

// This is a driver: it may read the clock, to say what a run cost. Nothing else depends on it.
#![expect(clippy::disallowed_methods)]

use std::cell::{Cell, OnceCell};
use std::hash::{DefaultHasher, Hash as _, Hasher as _};
use std::rc::Rc;
use std::sync::Arc;
use std::time::Instant;

use anyhow::Context as _;
use eyeline_client::net::Driver as _;
use eyeline_client::plan;
use eyeline_client::session::{Session, SessionConfig};
use eyeline_client::tracking::{Ahead, TrackerConfig};
use eyeline_protocol::{
    LocalTime, Orientation, Plan, PlanSwitch, Position, Stage as PlanStage, WorldInfo, WorldTime, codec,
};
use eyeline_server::policy::PolicySettings;
use eyeline_server::spec::{SpawnSpec, WorldSpec};
use eyeline_server::world::{World, WorldConfig};
use eyeline_visibility::{AllRound, AllRoundScratch, DynamicOctree, EyeRegion, Occlusion, Scene, SealedParts};
use glam::DVec3;

use super::FRAME;
use crate::people::Person;
use crate::stage::Stage;
use crate::virtual_net::{
    ClientDriver, ClientPlan, Direction, Framed, Kind, LinkRules, Observer, Passing, Pose, VirtualRun,
};

/// A world that can be served in virtual time.
pub struct Live {
    scene: Arc<Scene>,
    spec: WorldSpec,
    stage: Option<Stage>,
    /// Occluders take their time: they are made when somebody is to be looked for.
    all_round: Rc<OnceCell<Arc<AllRound>>>,
    /// So do the parts that walls seal off: they are found out if there are objects that may lie in one.
    parts: Rc<OnceCell<Option<Arc<SealedParts>>>>,
    /// How far who stands sways along x, metres.
    sway: f64,
}

/// How a world is run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LiveRules {
    /// For how long, in virtual time.
    pub seconds: f64,
    /// Whether the client walks, where the world has somewhere to walk. Else it stands where it was put.
    pub walks: bool,
    /// Other avatars, which stand; they come half way through the run.
    pub others: u16,
    /// Whether they leave again after an eighth of the run, and as many others come an eighth before its end.
    pub others_leave: bool,
    /// The server's policy, by its name.
    pub policy: &'static str,
    /// What is asked of the plan.
    pub switch: PlanSwitch,
    /// Decides everything that is left to chance.
    pub seed: u64,
}

impl Default for LiveRules {
    fn default() -> LiveRules {
        let (walks, others, others_leave, switch) = (false, 0, false, PlanSwitch::AUTO);
        LiveRules { seconds: 10.0, walks, others, others_leave, policy: "visible", switch, seed: 1 }
    }
}

/// What came of it. All but times are equal for equal rules.
#[derive(Clone, Debug)]
pub struct Lived {
    /// The plans of client and server at the end.
    pub plan: Plan,
    /// Time for the run, both ends, milliseconds.
    pub run_ms: f64,
    /// Records in both directions, poses apart.
    pub messages: u64,
    /// States among them.
    pub states: u64,
    /// Bytes of datagrams, both directions.
    pub bytes: u64,
    /// Frames for which somebody looked.
    pub culls: u64,
    /// The tracker's work: bounds tested and nodes visited.
    pub work: u64,
    /// Whether there is a tracker at the end.
    pub has_tracker: bool,
    /// Frames in which there was one.
    pub tracked_frames: u64,
    /// Bounds that were found sealed off.
    pub sealed: u64,
    /// The most bytes that the client's tracker, image and parts of the scene took, and the server's objects and
    /// sessions; at the end of a frame.
    pub memory_bytes: usize,
    /// Hash of what was drawn in each frame, and where.
    pub picture: u64,
    /// Hash of all that arrived, and when.
    pub digest: u64,
}

/// Pixels a side of the cube that is culled on: the headless client's.
const SIDE: u32 = 128;
const BEGIN: WorldTime = WorldTime::from_micros(1_000_000);

impl Live {
    /// The world of a stage, with what moves in it.
    pub fn of_stage(stage: Stage) -> Live {
        let all_round = Rc::new(OnceCell::from(stage.all_round.clone()));
        let (scene, spec) = (stage.model.scene.clone(), stage.model.spec.clone());
        Live { scene, spec, all_round, stage: Some(stage), parts: Rc::default(), sway: 0.0 }
    }

    /// A scene in which nothing moves; avatars stand so that they look from `eye`, relative to the anchor.
    pub fn of_scene(scene: Arc<Scene>, name: &str, eye: DVec3) -> Live {
        let mut spec = WorldSpec { name: name.to_owned(), ..WorldSpec::default() };
        let feet = scene.anchor() + eye - DVec3::Y * spec.avatar.eye_height;
        spec.spawns = vec![SpawnSpec { position: feet.to_array(), heading: 0.0 }];
        Live::of_spec(scene, spec)
    }

    /// A scene with what moves in it.
    pub fn of_spec(scene: Arc<Scene>, spec: WorldSpec) -> Live {
        Live { scene, spec, all_round: Rc::default(), stage: None, parts: Rc::default(), sway: 0.0 }
    }

    /// Has who stands sway so far along x to either side, metres, once in five seconds: an eye that is never still.
    pub fn with_sway(self, sway: f64) -> Live {
        Live { sway, ..self }
    }

    /// Runs server and client.
    ///
    /// # Errors
    /// If the world contradicts itself, or there is no such policy.
    pub fn run(&self, rules: &LiveRules) -> anyhow::Result<Lived> {
        let began = Instant::now();
        let config = WorldConfig::default()
            .with_tick(FRAME)
            .with_grid_seed(rules.seed)
            .with_swept(rules.switch.runs(PlanStage::Swept, true))
            .with_plan(rules.switch)
            .with_default_spawn(self.scene.bounds().centre());
        let settings = PolicySettings::default();
        let world = match &self.stage {
            Some(stage) => stage.world(config, rules.policy, &settings, BEGIN)?,
            None => {
                let info = WorldInfo { name: self.spec.name.clone(), hash: [0; 32], size_bytes: 0, two_sided: false };
                let policy = settings.policy(rules.policy, &info)?;
                let policy = policy.with_context(|| format!("{} is no policy of a server", rules.policy))?;
                World::new(config, self.spec.clone(), info, self.scene.anchor(), policy, BEGIN)?
            }
        };
        let mut run = VirtualRun::new(world, rules.seed, BEGIN);
        let bounds = self.scene.bounds();
        let index = || Box::new(move || Box::new(DynamicOctree::new(bounds)) as Box<_>);
        let session =
            SessionConfig::default().with_plan(rules.switch).with_tracker(TrackerConfig::default().with_frame(FRAME));
        let culls = Rc::new(Cell::new(0));
        let could_seal = !self.spec.objects.is_empty() && rules.switch.runs(PlanStage::Sealed, true);
        let find_parts = || plan::sealed_parts(&self.scene);
        let parts = if could_seal { self.parts.get_or_init(find_parts).clone() } else { None };
        let person = self.stage.as_ref().filter(|_| rules.walks).map(|stage| {
            let mut ground = stage.ground();
            if let Some(parts) = &parts {
                ground.all_round = Arc::new(ground.all_round.with_parts(parts.clone()));
            }
            Person::on(&ground, rules.seed, 0, SIDE, None)
        });
        let image_bytes = Rc::new(Cell::new(0));
        let watcher = Watcher {
            person,
            anchor: self.scene.anchor(),
            scene: self.scene.clone(),
            plain: self.all_round.clone(),
            parts: parts.clone(),
            all_round: None,
            scratch: None,
            stands: DVec3::ZERO,
            sway: self.sway,
            image_bytes: image_bytes.clone(),
            eye: DVec3::ZERO,
            looks_again: rules.switch.runs(PlanStage::LookAgain, false),
            culls: culls.clone(),
        };
        let link = LinkRules::default().with_delay(std::time::Duration::from_millis(15));
        run.join(ClientPlan::new(session, link).with_phase(FRAME / 2), Box::new(watcher), index());
        let parts_bytes = parts.map_or(0, |parts| parts.memory_bytes());
        let mut counter = Counter { image_bytes, parts_bytes, ..Counter::default() };
        let eighths = |count: f64| std::time::Duration::from_secs_f64(rules.seconds * 0.125 * count);
        let come = |run: &mut VirtualRun| {
            for _ in 0..rules.others {
                let plan = ClientPlan::new(SessionConfig::default().with_plan(rules.switch), LinkRules::default());
                run.join(plan.with_phase(FRAME / 3), Box::new(Bystander), index());
            }
        };
        run.run_for(eighths(4.0), &mut counter);
        come(&mut run);
        if rules.others_leave {
            run.run_for(eighths(1.0), &mut counter);
            (1..=usize::from(rules.others)).for_each(|other| run.client_mut(other).session.leave());
            run.run_for(eighths(2.0), &mut counter);
            come(&mut run);
            run.run_for(eighths(1.0), &mut counter);
        } else {
            run.run_for(eighths(4.0), &mut counter);
        }
        let session = &run.clients()[0].session;
        let stats = session.tracker_stats();
        let mut plan = Plan { lines: session.plan_lines(stats.still_frames) };
        plan.lines.extend(eyeline_server::plan::plan(run.world()).lines);
        Ok(Lived {
            plan,
            run_ms: began.elapsed().as_secs_f64() * 1e3,
            messages: counter.messages,
            states: counter.states,
            bytes: counter.bytes,
            culls: culls.get(),
            work: stats.work,
            has_tracker: session.tracker().is_some(),
            tracked_frames: counter.tracked_frames,
            sealed: stats.sealed,
            memory_bytes: counter.memory_bytes,
            picture: counter.hasher.finish(),
            digest: run.digest(),
        })
    }
}

/// Who looks: somebody who walks, or who stands where the server put it.
struct Watcher {
    person: Option<Person>,
    anchor: DVec3,
    scene: Arc<Scene>,
    /// Occluders without parts, for all runs.
    plain: Rc<OnceCell<Arc<AllRound>>>,
    parts: Option<Arc<SealedParts>>,
    all_round: Option<Arc<AllRound>>,
    scratch: Option<AllRoundScratch>,
    /// Where the server put it.
    stands: DVec3,
    sway: f64,
    image_bytes: Rc<Cell<usize>>,
    eye: DVec3,
    looks_again: bool,
    culls: Rc<Cell<u64>>,
}

impl ClientDriver for Watcher {
    fn poses(&mut self, session: &Session, at: WorldTime, poses: &mut Vec<Pose>) {
        if let Some(person) = &mut self.person {
            poses.extend(person.advance(session, LocalTime::from_micros(at.micros())));
            return;
        }
        let Some(welcome) = session.welcome() else { return };
        let Some(&(object, position, _)) = welcome.avatars.first() else { return };
        let eye_height = welcome.classes.first().map_or(0.0, |class| class.eye_height);
        if self.stands == DVec3::ZERO {
            self.stands = position.metres();
        }
        let turns = (at.micros() - BEGIN.micros()) as f64 / 5e6;
        let wanted = self.stands + DVec3::X * (self.sway * (turns * std::f64::consts::TAU).sin());
        let position = Position::from_metres(wanted).unwrap_or(position);
        self.eye = position.metres() + DVec3::Y * eye_height;
        poses.push(Pose { object, position, orientation: Orientation::default() });
    }

    fn cull(&mut self, ahead: Ahead) {
        self.culls.set(self.culls.get() + 1);
        if let Some(person) = &mut self.person {
            person.cull(ahead);
            return self.image_bytes.set(person.memory_bytes());
        }
        let all_round = self.all_round.get_or_insert_with(|| {
            let plain = self.plain.get_or_init(|| Arc::new(AllRound::new(&self.scene)));
            self.parts.as_ref().map_or(Arc::clone(plain), |parts| Arc::new(plain.with_parts(Arc::clone(parts))))
        });
        let scratch = self.scratch.get_or_insert_with(|| all_round.scratch(SIDE));
        let region = EyeRegion { centre: self.eye, radius: ahead.eye_radius };
        // An eye from the server is a number, and so is a lead.
        let _ = if self.looks_again { all_round.cull(region, scratch) } else { all_round.look(region, scratch) };
        self.image_bytes.set(scratch.memory_bytes());
    }

    fn occlusion(&self) -> Option<&dyn Occlusion> {
        match &self.person {
            Some(person) => person.occlusion(),
            None => self.scratch.as_ref().map(|scratch| scratch.occlusion() as &dyn Occlusion),
        }
    }

    fn eye(&self) -> Option<DVec3> {
        Some(self.person.as_ref().map_or(self.eye, |person| person.pose().eye - self.anchor))
    }
}

/// Somebody who stands about and looks at nothing.
struct Bystander;

impl ClientDriver for Bystander {
    fn poses(&mut self, session: &Session, _: WorldTime, poses: &mut Vec<Pose>) {
        let own = session.welcome().and_then(|welcome| welcome.avatars.first().copied());
        poses.extend(own.map(|(object, position, orientation)| Pose { object, position, orientation }));
    }

    fn occlusion(&self) -> Option<&dyn Occlusion> {
        None
    }
}

/// Counts what the first client hears, says and draws.
#[derive(Default)]
struct Counter {
    messages: u64,
    states: u64,
    bytes: u64,
    hasher: DefaultHasher,
    tracked_frames: u64,
    /// What the client's image takes now, and parts of the scene.
    image_bytes: Rc<Cell<usize>>,
    parts_bytes: usize,
    memory_bytes: usize,
}

impl Observer for Counter {
    fn framed(&mut self, frame: &Framed<'_>) {
        if frame.client != 0 {
            return;
        }
        // An image that is not looked at could be let go of, too, but nobody does.
        let server = frame.world.memory_bytes();
        let tracker = frame.session.tracker();
        let client = tracker.map_or(0, |tracker| tracker.memory_bytes()) + self.image_bytes.get() + self.parts_bytes;
        self.memory_bytes = self.memory_bytes.max(server + client);
        let Some(tracker) = tracker else { return };
        self.tracked_frames += 1;
        for drawn in tracker.drawn() {
            (frame.at, drawn.object, drawn.position.metres().to_array().map(f64::to_bits)).hash(&mut self.hasher);
        }
    }

    fn arrives(&mut self, message: &Passing<'_>) {
        if message.client != 0 || message.kind != Kind::Datagram {
            return;
        }
        self.bytes += message.bytes.len() as u64;
        match message.direction {
            Direction::Up => {
                let records = codec::decode_client_datagram(message.bytes).map_or(Vec::new(), |(_, records)| records);
                let poses = |record: &&_| !matches!(record, eyeline_protocol::ClientRecord::Pose { .. });
                self.messages += records.iter().filter(poses).count() as u64;
            }
            Direction::Down => {
                let records = codec::decode_server_datagram(message.bytes).map_or(Vec::new(), |(_, records)| records);
                self.messages += records.len() as u64;
                let states = |record: &&_| matches!(record, eyeline_protocol::ServerRecord::State { .. });
                self.states += records.iter().filter(states).count() as u64;
            }
        }
    }
}
