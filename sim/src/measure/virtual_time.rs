//! The same run in virtual time: a seed decides every delay and loss, and the same seed gives the same messages at the
//! same virtual microsecond.

// This is a driver: it may read the clock, to say what culling cost. Nothing else depends on it.
#![expect(clippy::disallowed_methods)]

use std::cell::RefCell;
use std::rc::Rc;
use std::time::{Duration, Instant};

use eyeline_client::net::Driver;
use eyeline_client::session::{FrameTime, Session, SessionConfig};
use eyeline_client::tracking::{Ahead, TrackerStats};
use eyeline_protocol::{LocalTime, ObjectId, Role, WorldTime, codec};
use eyeline_server::world::World;
use eyeline_visibility::{DynamicOctree, Occlusion};
use glam::DVec3;

use super::{Bursts, ClientLog, Commit, FrameLog, MeasureConfig, ObjectInfo, RunLog, known_of};
use crate::people::{Extras, Person};
use crate::report::Progress;
use crate::stage::{Crowd, Stage};
use crate::virtual_net::{
    ClientDriver, ClientPlan, Direction, Framed, Kind, LinkRules, Observer, Passing, Pose, VirtualRun,
};

/// The virtual microsecond at which a run begins; true time and a driver's clock are the same.
pub(super) const BEGIN: WorldTime = WorldTime::from_micros(1_000_000);

/// A run with everybody in it, before anything has happened.
pub(super) struct Begun {
    pub run: VirtualRun,
    /// Watching clients, by their numbers in the run.
    pub numbers: Vec<usize>,
    costs: Vec<Rc<RefCell<Cost>>>,
    /// Connections that only move avatars.
    actors: Vec<usize>,
}

/// Connects everybody.
pub(super) fn begin(
    stage: &Stage,
    crowd: Option<&Crowd>,
    config: &MeasureConfig,
    link: &LinkRules,
    is_quic: bool,
    policy: &str,
) -> anyhow::Result<Begun> {
    let world = config.start(stage, policy, BEGIN)?;
    let mut run = match is_quic {
        true => VirtualRun::over_quic(world, config.seed, BEGIN)?,
        false => VirtualRun::new(world, config.seed, BEGIN),
    };
    let bounds = stage.model.scene.bounds();
    let index = || Box::new(move || Box::new(DynamicOctree::new(bounds)) as Box<_>);
    let mut actors = Vec::new();
    for extras in Extras::all(stage, crowd, config.residents, config.seed, config.clients) {
        let session = SessionConfig::default()
            .with_tracker(config.tracker())
            .with_role(Role::Actor { avatars: extras.avatars() })
            .with_name(extras.name());
        // Residents walk inside the server; a replay comes over the network like anybody else.
        let link = if extras.is_local() { LinkRules::default() } else { *link };
        let plan = ClientPlan::new(session, link).with_phase(Duration::ZERO);
        actors.push(run.join(plan, Box::new(Acting(extras)), index()));
    }
    let costs: Vec<_> = (0..config.clients).map(|_| Rc::new(RefCell::new(Cost::default()))).collect();
    let mut numbers = Vec::new();
    for (number, cost) in costs.iter().enumerate() {
        let person = config.person(stage, number, None);
        let session = config.session(number);
        let phase = config.frame() * number as u32 / config.clients.max(1) as u32;
        let plan = ClientPlan::new(session, *link).with_phase(phase);
        let watching = Watching { person, cost: cost.clone(), anchor: stage.anchor() };
        numbers.push(run.join(plan, Box::new(watching), index()));
    }
    Ok(Begun { run, numbers, costs, actors })
}

pub(super) fn run(
    stage: &Stage,
    crowd: Option<&Crowd>,
    config: &MeasureConfig,
    link: &LinkRules,
    is_quic: bool,
    policy: &str,
) -> anyhow::Result<RunLog> {
    let Begun { mut run, numbers, costs, actors } = begin(stage, crowd, config, link, is_quic, policy)?;
    let mut recorder = Recorder {
        config,
        start: BEGIN + config.warm_up,
        numbers,
        costs,
        commits: Vec::new(),
        clients: vec![ClientLog::default(); config.clients],
        trackers: Vec::new(),
        actor_poses: 0,
        actors,
        is_quic,
    };
    let progress =
        Progress::new((config.warm_up + config.window).as_millis() as u64, &format!("{policy}: virtual time"));
    let step = Duration::from_millis(250);
    let mut before = *run.world().stats();
    let end = recorder.start + config.window;
    while run.now() < end {
        let next = (run.now() + step).min(if run.now() < recorder.start { recorder.start } else { end });
        let passed = next.since(run.now());
        run.run_until(next, &mut recorder);
        if next == recorder.start {
            before = *run.world().stats();
            for (log, number) in recorder.clients.iter_mut().zip(&recorder.numbers) {
                let session = &run.clients()[*number].session;
                recorder.trackers.push(session.tracker_stats());
                log.sent = session.stats().records_out;
                if let Some(udp) = run.udp(*number) {
                    log.udp = udp;
                }
            }
        }
        progress.inc(passed.as_millis() as u64);
    }
    progress.finish();
    for ((log, number), before) in recorder.clients.iter_mut().zip(&recorder.numbers).zip(&recorder.trackers) {
        let client = &run.clients()[*number];
        anyhow::ensure!(client.is_connected(), "client {number} lost its connection: {:?}", client.closed());
        if let Some(udp) = run.udp(*number) {
            log.udp = std::array::from_fn(|index| udp[index] - log.udp[index]);
        }
        log.avatar = client.avatar().unwrap_or_default();
        let stats = client.session.tracker_stats();
        log.note(before, &stats);
        log.sent = client.session.stats().records_out.saturating_sub(log.sent);
    }
    let after = *run.world().stats();
    let mut up = after.messages_in.since(&before.messages_in);
    up.poses = up.poses.saturating_sub(recorder.actor_poses);
    Ok(RunLog {
        policy: policy.to_owned(),
        net: if is_quic { "sim-quic" } else { "sim" },
        window: config.window,
        commits: recorder.commits,
        classes: run.world().classes().to_vec(),
        objects: ObjectInfo::all(run.world()),
        clients: recorder.clients,
        up,
        down: after.out.since(&before.out),
        server_work: Duration::ZERO,
        turnaround: run.world().answer_wait(),
        tick_micros: Vec::new(),
        poses_clamped: after.poses_clamped - before.poses_clamped,
        violations: after.violations - before.violations,
        digest: Some(run.digest()),
    })
}

/// What a person's newest frame was like.
#[derive(Default)]
struct Cost {
    cull: Duration,
    yaw: f64,
    received: Vec<ObjectId>,
}

/// A person in virtual time.
struct Watching {
    person: Person,
    cost: Rc<RefCell<Cost>>,
    anchor: DVec3,
}

impl ClientDriver for Watching {
    fn poses(&mut self, session: &Session, at: WorldTime, poses: &mut Vec<Pose>) {
        poses.extend(self.person.advance(session, LocalTime::from_micros(at.micros())));
    }

    fn cull(&mut self, ahead: Ahead) {
        let started = Instant::now();
        self.person.cull(ahead);
        let mut cost = self.cost.borrow_mut();
        cost.cull = started.elapsed();
        cost.yaw = self.person.pose().yaw;
    }

    fn occlusion(&self) -> Option<&dyn Occlusion> {
        self.person.occlusion()
    }

    fn frame_done(&mut self, session: &mut Session, _: Option<FrameTime>, _: WorldTime) {
        self.cost.borrow_mut().received = session.take_states_received();
    }

    fn eye(&self) -> Option<DVec3> {
        Some(self.person.pose().eye - self.anchor)
    }
}

/// People whom nobody looks for, in virtual time.
struct Acting(Extras);

impl ClientDriver for Acting {
    fn poses(&mut self, session: &Session, at: WorldTime, poses: &mut Vec<Pose>) {
        poses.extend(self.0.poses(session, LocalTime::from_micros(at.micros())));
    }

    fn occlusion(&self) -> Option<&dyn Occlusion> {
        None
    }

    fn frame_done(&mut self, session: &mut Session, _: Option<FrameTime>, _: WorldTime) {
        self.0.announce(session);
    }
}

/// Notes what a real run's recorders note.
struct Recorder<'a> {
    config: &'a MeasureConfig,
    start: WorldTime,
    numbers: Vec<usize>,
    costs: Vec<Rc<RefCell<Cost>>>,
    commits: Vec<Commit>,
    clients: Vec<ClientLog>,
    /// What each tracker had counted when the measured time began.
    trackers: Vec<TrackerStats>,
    actor_poses: u64,
    actors: Vec<usize>,
    /// Whether UDP is counted by QUIC.
    is_quic: bool,
}

impl Recorder<'_> {
    fn watcher(&self, client: usize) -> Option<usize> {
        self.numbers.binary_search(&client).ok()
    }
}

impl Observer for Recorder<'_> {
    fn committed(&mut self, world: &World, _: WorldTime) {
        self.commits.push(Commit::of(world));
    }

    fn framed(&mut self, frame: &Framed<'_>) {
        let Some(watcher) = self.watcher(frame.client) else { return };
        if frame.at < self.start {
            return;
        }
        let bursts = Bursts::new(self.config.burst_frames, self.config.truth_share, watcher as u64);
        let log = &mut self.clients[watcher];
        let Cost { cull, yaw, received } = std::mem::take(&mut *self.costs[watcher].borrow_mut());
        let (round_trip, round_trip_max) = frame.session.round_trip().unwrap_or_default();
        let known = bursts.contain(log.frames.len() as u64).then(|| known_of(frame.session));
        log.frames.push(FrameLog {
            at: frame.at,
            eye: frame.eye.unwrap_or_default(),
            yaw,
            cull,
            track: Duration::ZERO,
            late: Duration::ZERO,
            round_trip_max,
            round_trip,
            ahead: frame.session.ahead(),
            retry_after: frame.session.retry_after(),
            known,
            received,
        });
    }

    fn lost(&mut self, message: &Passing<'_>) {
        if let Some(watcher) = self.watcher(message.client).filter(|_| message.kind == Kind::Datagram) {
            let objects = message.spoken_of().into_iter().map(|object| (message.at, object));
            self.clients[watcher].lost.extend(objects);
        }
    }

    fn arrives(&mut self, message: &Passing<'_>) {
        if message.at < self.start || message.kind != Kind::Datagram {
            return;
        }
        if self.actors.contains(&message.client) {
            if let Ok((_, records)) = codec::decode_client_datagram(message.bytes)
                && message.direction == Direction::Up
            {
                self.actor_poses += records.len() as u64;
            }
            return;
        }
        let Some(watcher) = self.watcher(message.client).filter(|_| !self.is_quic) else { return };
        let udp = &mut self.clients[watcher].udp;
        let first = if message.direction == Direction::Up { 0 } else { 2 };
        udp[first] += 1;
        udp[first + 1] += message.bytes.len() as u64;
    }
}
