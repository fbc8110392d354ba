//! One server, one client that looks, one link: for scenarios in a few lines.
//!
//! The client stands at the origin. A wall 10 m long lies 5 m to the north; [`HIDDEN`] is behind it and [`OPEN`] is not. An
//! actor over a perfect link moves what there is to be seen.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use eyeline_client::session::{Event, Session, SessionConfig};
use eyeline_client::tracking::{TrackerConfig, TrackerStats};
use eyeline_protocol::{
    ClientRecord, ObjectId, Orientation, Position, Role, ServerRecord, WorldInfo, WorldTime, codec,
};
use eyeline_server::policy::{Broadcast, Policy, Visible};
use eyeline_server::spec::{AvatarSpec, WorldSpec};
use eyeline_server::world::{World, WorldConfig};
use eyeline_sim::virtual_net::{
    ClientDriver, ClientPlan, Direction, Framed, Kind, LinkRules, Observer, Passing, Pose, VirtualRun,
};
use eyeline_visibility::Occlusion;
use glam::DVec3;

use eyeline_sim::soak::{Allowance, IndexView, Standing, Truth, Wall, Walls};

/// A place that the wall hides from the client, with 8 m to go until it does not.
pub const HIDDEN: DVec3 = DVec3::new(0.0, 0.0, -10.0);

/// A place in sight of the client.
pub const OPEN: DVec3 = DVec3::new(0.0, 0.0, 8.0);

/// What crossed the link to the client that looks, decoded, as it arrived.
#[derive(Default)]
pub struct Log {
    /// What the server got.
    pub up: Vec<(WorldTime, ClientRecord)>,
    /// What the client got.
    pub down: Vec<(WorldTime, ServerRecord)>,
}

impl Log {
    /// The client's requests about `object` that arrived.
    pub fn requests(&self, object: ObjectId) -> usize {
        self.up.iter().filter(|(_, r)| matches!(r, ClientRecord::Request { object: o, .. } if *o == object)).count()
    }

    /// The client's releases of `object` that arrived.
    pub fn releases(&self, object: ObjectId) -> usize {
        self.up.iter().filter(|(_, r)| matches!(r, ClientRecord::Release { object: o, .. } if *o == object)).count()
    }

    /// The server's states of `object` that arrived.
    pub fn states(&self, object: ObjectId) -> usize {
        self.down.iter().filter(|(_, r)| matches!(r, ServerRecord::State { object: o, .. } if *o == object)).count()
    }

    /// The announcements of broken bounds of `object` that arrived.
    pub fn violations(&self, object: ObjectId) -> usize {
        self.down.iter().filter(|(_, r)| matches!(r, ServerRecord::Violation { object: o, .. } if *o == object)).count()
    }
}

struct Both<'a> {
    truth: &'a mut Truth,
    log: &'a mut Log,
    client: usize,
}

impl Observer for Both<'_> {
    fn committed(&mut self, world: &World, at: WorldTime) {
        self.truth.committed(world, at);
    }

    fn framed(&mut self, frame: &Framed<'_>) {
        self.truth.framed(frame);
    }

    fn arrives(&mut self, message: &Passing<'_>) {
        self.truth.arrives(message);
        if message.client != self.client || message.kind != Kind::Datagram {
            return;
        }
        match message.direction {
            Direction::Up => {
                let records = codec::decode_client_datagram(message.bytes).map_or(Vec::new(), |(_, records)| records);
                self.log.up.extend(records.into_iter().map(|record| (message.at, record)));
            }
            Direction::Down => {
                let records = codec::decode_server_datagram(message.bytes).map_or(Vec::new(), |(_, records)| records);
                self.log.down.extend(records.into_iter().map(|record| (message.at, record)));
            }
        }
    }

    fn lost(&mut self, message: &Passing<'_>) {
        self.truth.lost(message);
    }
}

struct Puppet {
    at: DVec3,
    goal: DVec3,
    speed: f64,
    /// A jump that is due, and whether it is in the world then.
    jump: Option<bool>,
}

type Puppets = Arc<Mutex<BTreeMap<ObjectId, Puppet>>>;

struct Puppeteer {
    puppets: Puppets,
    before: Option<WorldTime>,
}

impl ClientDriver for Puppeteer {
    fn poses(&mut self, _: &Session, at: WorldTime, poses: &mut Vec<Pose>) {
        let seconds = self.before.map_or(0.0, |before| at.seconds_since(before));
        self.before = Some(at);
        for (&object, puppet) in self.puppets.lock().expect("not poisoned").iter_mut() {
            let way = puppet.goal - puppet.at;
            puppet.at += way.clamp_length_max(puppet.speed * seconds);
            poses.push(Pose { object, position: grid(puppet.at), orientation: Orientation::default() });
        }
    }

    fn occlusion(&self) -> Option<&dyn Occlusion> {
        None
    }

    fn frame_done(&mut self, session: &mut Session, _: Option<eyeline_client::session::FrameTime>, _: WorldTime) {
        for (&object, puppet) in self.puppets.lock().expect("not poisoned").iter_mut() {
            if let Some(present) = puppet.jump.take() {
                session.place(object, grid(puppet.at), present);
            }
        }
    }
}

fn grid(place: DVec3) -> Position {
    Position::from_metres(place).expect("a pair's world is small")
}

/// Settings of a [`Pair`].
pub struct PairBuilder {
    seed: u64,
    link: LinkRules,
    drift: f64,
    broadcast: bool,
    tracker: TrackerConfig,
    config: WorldConfig,
}

impl PairBuilder {
    /// Decides what is left to chance.
    pub fn seed(self, seed: u64) -> PairBuilder {
        PairBuilder { seed, ..self }
    }

    /// Time under way, in each direction.
    pub fn latency(mut self, delay: Duration) -> PairBuilder {
        self.link.delay = delay;
        self
    }

    /// Share of datagrams lost, in each direction.
    pub fn loss(mut self, loss: f64) -> PairBuilder {
        self.link.loss = loss;
        self
    }

    /// Everything about the link.
    pub fn link(self, link: LinkRules) -> PairBuilder {
        PairBuilder { link, ..self }
    }

    /// How much faster than the server's the client's clock runs, as a share.
    pub fn drift(self, drift: f64) -> PairBuilder {
        PairBuilder { drift, ..self }
    }

    /// The policy `broadcast` instead of `visible`.
    pub fn broadcast(self) -> PairBuilder {
        PairBuilder { broadcast: true, ..self }
    }

    /// The tracker's settings.
    pub fn tracker(self, tracker: TrackerConfig) -> PairBuilder {
        PairBuilder { tracker, ..self }
    }

    /// Changes the world's settings.
    pub fn world(mut self, change: impl FnOnce(&mut WorldConfig)) -> PairBuilder {
        change(&mut self.config);
        self
    }

    /// Connects everybody, and lets them get to know each other for half a second over a link that loses nothing.
    pub fn build(self) -> Pair {
        let walls = Arc::new(Walls { walls: vec![Wall::new(-5.0, -5.1, 5.0, -4.9)] });
        let start = WorldTime::ZERO;
        let info = WorldInfo { name: "pair".into(), hash: [0; 32], size_bytes: 0, two_sided: false };
        let policy: Box<dyn Policy> = if self.broadcast { Box::new(Broadcast) } else { Box::new(Visible) };
        let spec = WorldSpec { avatar: AvatarSpec { radius: 0.3, ..AvatarSpec::default() }, ..WorldSpec::default() };
        let world =
            World::new(self.config, spec, info, DVec3::ZERO, policy, start).expect("a pair's world is well made");
        let mut run = VirtualRun::new(world, self.seed, start);
        let puppets = Puppets::default();
        let actor = SessionConfig::default().with_role(Role::Actor { avatars: PUPPETS });
        let plan = ClientPlan::new(actor, LinkRules::default()).with_phase(Duration::from_millis(10));
        let puppeteer = Puppeteer { puppets: puppets.clone(), before: None };
        run.join(plan, Box::new(puppeteer), IndexView::default().maker());
        let place = Arc::new(Mutex::new(DVec3::ZERO));
        let session = SessionConfig::default().with_tracker(self.tracker).with_watch();
        let kind_link = LinkRules { loss: 0.0, ..self.link };
        let plan = ClientPlan::new(session, kind_link).with_drift(self.drift).with_phase(Duration::from_millis(30));
        let view = IndexView::default();
        let standing = Standing::new(walls.clone(), place.clone());
        let client = run.join(plan, Box::new(standing), view.maker());
        let mut truth = Truth::new(walls);
        truth.watch(client, view, Allowance::of(self.link, self.link));
        let mut pair = Pair { run, truth, log: Log::default(), client, place, puppets, spawned: 0 };
        pair.run_for(Duration::from_millis(500));
        let client = pair.run.client_mut(client);
        client.up.set_rules(self.link);
        client.down.set_rules(self.link);
        pair
    }
}

/// Most objects that [`Pair::spawn`] can give.
const PUPPETS: u16 = 4;

/// One server, one client that looks, one link.
pub struct Pair {
    /// The run.
    pub run: VirtualRun,
    /// What is known to be wrong with it.
    pub truth: Truth,
    /// What crossed the client's link.
    pub log: Log,
    client: usize,
    place: Arc<Mutex<DVec3>>,
    puppets: Puppets,
    spawned: usize,
}

impl Pair {
    /// A pair over a perfect link, unless told otherwise.
    pub fn builder() -> PairBuilder {
        PairBuilder {
            seed: 1,
            link: LinkRules::default(),
            drift: 0.0,
            broadcast: false,
            tracker: TrackerConfig::default(),
            config: WorldConfig::default(),
        }
    }

    /// Lets time pass.
    pub fn run_for(&mut self, span: Duration) {
        let mut both = Both { truth: &mut self.truth, log: &mut self.log, client: self.client };
        self.run.run_for(span, &mut both);
    }

    /// Brings an object into the world at `at`, standing there.
    pub fn spawn(&mut self, at: DVec3) -> ObjectId {
        let session = &self.run.clients()[0].session;
        let object = session.welcome().expect("the actor is in").avatars[self.spawned].0;
        self.spawned += 1;
        let puppet = Puppet { at, goal: at, speed: 0.0, jump: Some(true) };
        self.puppets.lock().expect("not poisoned").insert(object, puppet);
        object
    }

    /// Brings an object into the world behind the wall, standing, and waits until the client holds a bound of it.
    pub fn spawn_hidden(&mut self) -> ObjectId {
        let object = self.spawn(HIDDEN);
        self.run_for(Duration::from_millis(1_000));
        self.log.up.clear();
        self.log.down.clear();
        object
    }

    /// Lets an object walk from where it is.
    pub fn walk(&mut self, object: ObjectId, goal: DVec3, speed: f64) {
        if let Some(puppet) = self.puppets.lock().expect("not poisoned").get_mut(&object) {
            (puppet.goal, puppet.speed) = (goal, speed);
        }
    }

    /// Lets an object jump, or leave the world, or come into it again.
    pub fn place(&mut self, object: ObjectId, at: DVec3, present: bool) {
        if let Some(puppet) = self.puppets.lock().expect("not poisoned").get_mut(&object) {
            (puppet.at, puppet.goal, puppet.jump) = (at, at, Some(present));
        }
    }

    /// Puts the client's eye somewhere.
    pub fn stand_at(&mut self, place: DVec3) {
        *self.place.lock().expect("not poisoned") = place;
    }

    /// The client's number in the run.
    pub fn number(&self) -> usize {
        self.client
    }

    /// The client's session.
    pub fn session(&self) -> &Session {
        &self.run.clients()[self.client].session
    }

    /// The client's counters.
    pub fn stats(&self) -> TrackerStats {
        self.session().tracker_stats()
    }

    /// Where the client draws `object`, if it does.
    pub fn drawn(&self, object: ObjectId) -> Option<DVec3> {
        let tracker = self.session().tracker()?;
        tracker.drawn().find(|drawn| drawn.object == object).map(|drawn| drawn.position.metres())
    }

    /// What the client was told of `object` as events, oldest first.
    pub fn events(&self, object: ObjectId) -> Vec<Event> {
        let events = self.run.clients()[self.client].events();
        let is_it = |event: &&Event| match event {
            Event::Revealed(of) | Event::Hidden(of) | Event::Stopped(of) | Event::Left(of) => *of == object,
            _ => false,
        };
        events.iter().filter(is_it).cloned().collect()
    }

    /// Where `object` truly is.
    pub fn truly(&self, object: ObjectId) -> DVec3 {
        self.run.world().objects()[object.index()].position.metres()
    }
}
