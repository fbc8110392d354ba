//! The run itself: takes the next event, feeds a core, and puts what the core says on its way.

use std::time::Duration;

use eyeline_client::session::{Event as SessionEvent, FrameTime, IndexMaker, Session};
use eyeline_protocol::WorldTime;
use eyeline_server::world::{SessionId, Transmit, World};
use glam::DVec3;
use rand::RngExt;
use rand_pcg::Pcg64;

use super::client::{Client, ClientDriver, ClientPlan, OwnClock, Pose};
use super::link::{Direction, Fate, Kind, VirtualLink};
use super::queue::Queue;

/// Something on its way, or at its end.
#[derive(Clone, Copy, Debug)]
pub struct Passing<'a> {
    /// The client at one end, by its number in the run.
    pub client: usize,
    /// Which way it goes.
    pub direction: Direction,
    /// How it goes.
    pub kind: Kind,
    /// A datagram, or a control message without its length prefix.
    pub bytes: &'a [u8],
    /// True world time: of sending for an interceptor, of arrival or loss for an observer.
    pub at: WorldTime,
}

/// What an interceptor decides about a datagram.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// The link's rules decide.
    AsRuled,
    /// This happens instead.
    Instead(Fate),
    /// It arrives twice, after these times.
    Twice(Duration, Duration),
    /// It says this instead, and the link's rules decide about that: for ends that lie.
    Rewrite(Vec<u8>),
}

/// A client's frame, after its session took it.
pub struct Framed<'a> {
    /// Which client, by its number in the run.
    pub client: usize,
    /// Its session.
    pub session: &'a Session,
    /// What the frame was made with; `None` until the client knows the server's time.
    pub time: Option<FrameTime>,
    /// Its eye, if it looks at anything.
    pub eye: Option<DVec3>,
    /// True world time.
    pub at: WorldTime,
    /// The world: the truth.
    pub world: &'a World,
}

/// Watches a run. Knows everything, changes nothing.
pub trait Observer {
    /// The world has committed a tick. `at` is true world time, later than the tick if that came late.
    fn committed(&mut self, world: &World, at: WorldTime) {
        let _ = (world, at);
    }

    /// A client has made a frame.
    fn framed(&mut self, frame: &Framed<'_>) {
        let _ = frame;
    }

    /// A message arrives; its receiver has not seen it yet.
    fn arrives(&mut self, message: &Passing<'_>) {
        let _ = message;
    }

    /// A datagram gets lost for good, or a packet of a control message, which only delays that.
    fn lost(&mut self, message: &Passing<'_>) {
        let _ = message;
    }
}

/// Watches nothing.
#[derive(Clone, Copy, Debug, Default)]
pub struct Ignore;

impl Observer for Ignore {}

enum Event {
    Tick,
    Frame(usize),
    Arrives {
        client: usize,
        direction: Direction,
        kind: Kind,
        bytes: Vec<u8>,
    },
    /// The server's end of the connection is closed, and the client learns of it.
    Closed {
        client: usize,
        reason: String,
    },
    /// The client's end is closed, and the server learns of it.
    Gone {
        client: usize,
    },
}

/// Decides about datagrams before the rules do.
type Interceptor = Box<dyn FnMut(&Passing<'_>) -> Verdict>;

/// A world and its clients over a simulated network, in virtual time.
pub struct VirtualRun {
    world: World,
    clients: Vec<Client>,
    queue: Queue<Event>,
    now: WorldTime,
    seed: u64,
    interceptor: Option<Interceptor>,
    /// How late the tick that is due at a time comes.
    lateness: Box<dyn FnMut(WorldTime) -> Duration>,
    digest: u64,
    messages: u64,
    poses: Vec<Pose>,
}

/// FNV-1a's offset and prime (64 bits).
const FNV: (u64, u64) = (0xcbf2_9ce4_8422_2325, 0x0000_0100_0000_01b3);

impl VirtualRun {
    /// Runs `world`, whose next tick is at its `poll_timeout`, from `now` on. `seed` decides everything that is left to
    /// chance.
    pub fn new(world: World, seed: u64, now: WorldTime) -> VirtualRun {
        let mut queue = Queue::new();
        queue.push(world.poll_timeout(), Event::Tick);
        VirtualRun {
            world,
            clients: Vec::new(),
            queue,
            now,
            seed,
            interceptor: None,
            lateness: Box::new(|_| Duration::ZERO),
            digest: FNV.0,
            messages: 0,
            poses: Vec::new(),
        }
    }

    /// Connects a client now; returns its number. `index` makes its structure T.
    pub fn join(&mut self, plan: ClientPlan, driver: Box<dyn ClientDriver>, index: IndexMaker) -> usize {
        let client = self.clients.len();
        let stream = |purpose: u64| -> Pcg64 { crate::chance(self.seed, 1_000 + client as u64 * 4 + purpose) };
        let mut own = stream(0);
        let phase = own.random_range(0..plan.frame.as_micros().max(1) as u64);
        let phase = plan.phase.unwrap_or(Duration::from_micros(phase));
        // Anything from a minute to a day: a process's clock says nothing to anybody else.
        let base_micros = own.random_range(60_000_000..86_400_000_000);
        let clock = OwnClock { zero: self.now, base_micros, drift: plan.drift };
        let id = self.world.connect(self.now);
        self.world.handle_datagram_limit(id, plan.datagram_limit);
        self.clients.push(Client {
            session: Session::new(plan.session, index),
            driver,
            up: VirtualLink::new(plan.up, stream(1)),
            down: VirtualLink::new(plan.down, stream(2)),
            id,
            clock,
            frame: plan.frame,
            datagram_limit: plan.datagram_limit,
            connected: true,
            events: Vec::new(),
            closed: None,
            early: Vec::new(),
        });
        self.queue.push(self.now + phase, Event::Frame(client));
        self.send_control(client, &mut Ignore);
        client
    }

    /// The client's end of the connection goes, without a word; the server learns of it a delay later.
    pub fn cut(&mut self, client: usize) {
        if std::mem::replace(&mut self.clients[client].connected, false) {
            let (at, _) = self.clients[client].up.control(1, self.now);
            self.queue.push(at, Event::Gone { client });
        }
    }

    /// Sends these bytes as if the client's session had made them; a control message without its length prefix.
    pub fn send_raw(&mut self, client: usize, kind: Kind, bytes: Vec<u8>, observer: &mut dyn Observer) {
        self.send(client, Direction::Up, kind, bytes, observer);
    }

    /// Lets `interceptor` decide about datagrams before the rules do.
    pub fn intercept(&mut self, interceptor: impl FnMut(&Passing<'_>) -> Verdict + 'static) {
        self.interceptor = Some(Box::new(interceptor));
    }

    /// Leaves all datagrams to the rules again.
    pub fn intercept_nothing(&mut self) {
        self.interceptor = None;
    }

    /// Makes ticks late: `lateness` says by how much, given when one is due.
    pub fn set_lateness(&mut self, lateness: impl FnMut(WorldTime) -> Duration + 'static) {
        self.lateness = Box::new(lateness);
    }

    /// Does everything that happens until `end`, inclusive.
    pub fn run_until(&mut self, end: WorldTime, observer: &mut dyn Observer) {
        while let Some((at, event)) = self.queue.pop_by(end) {
            debug_assert!(at >= self.now, "time never goes back");
            self.now = self.now.max(at);
            self.happen(event, observer);
        }
        self.now = self.now.max(end);
    }

    /// Does everything that happens in the next `span`.
    pub fn run_for(&mut self, span: Duration, observer: &mut dyn Observer) {
        self.run_until(self.now + span, observer);
    }

    fn happen(&mut self, event: Event, observer: &mut dyn Observer) {
        match event {
            Event::Tick => self.tick(observer),
            Event::Frame(client) => self.frame(client, observer),
            Event::Arrives { client, direction, kind, bytes } => {
                let passing = Passing { client, direction, kind, bytes: &bytes, at: self.now };
                self.note(&passing);
                observer.arrives(&passing);
                match direction {
                    Direction::Up => self.arrives_at_server(client, kind, &bytes),
                    Direction::Down => self.arrives_at_client(client, kind, &bytes, observer),
                }
                self.drain_world(observer);
            }
            Event::Closed { client, reason } => {
                self.clients[client].connected = false;
                self.clients[client].closed = Some(reason);
            }
            Event::Gone { client } => {
                self.world.disconnect(self.clients[client].id);
                self.drain_world(observer);
            }
        }
    }

    fn tick(&mut self, observer: &mut dyn Observer) {
        // A `with_world` call may have moved the tick; a stale event then finds nothing due.
        self.world.tick(self.now);
        observer.committed(&self.world, self.now);
        self.drain_world(observer);
        let due = self.world.poll_timeout();
        let at = (due + (self.lateness)(due)).max(self.now);
        self.queue.push(at, Event::Tick);
    }

    fn frame(&mut self, number: usize, observer: &mut dyn Observer) {
        let now = self.now;
        let client = &mut self.clients[number];
        if !client.connected {
            return;
        }
        self.queue.push(now + client.frame, Event::Frame(number));
        if client.session.welcome().is_none() {
            return;
        }
        let local = client.clock.local(now);
        self.poses.clear();
        client.driver.poses(&client.session, now, &mut self.poses);
        for pose in &self.poses {
            client.session.set_pose(pose.object, pose.position, pose.orientation);
        }
        let ahead = client.session.ahead();
        client.driver.cull(ahead);
        let time = client.driver.occlusion().and_then(|occlusion| client.session.frame(ahead, occlusion, local));
        let eye = client.driver.eye();
        client.driver.frame_done(&mut client.session, time, now);
        let framed = Framed { client: number, session: &client.session, time, eye, at: now, world: &self.world };
        observer.framed(&framed);
        self.send_control(number, observer);
        while let Some(bytes) = {
            let client = &mut self.clients[number];
            client.session.poll_datagram(client.datagram_limit, local)
        } {
            self.send(number, Direction::Up, Kind::Datagram, bytes, observer);
        }
    }

    fn arrives_at_server(&mut self, client: usize, kind: Kind, bytes: &[u8]) {
        let id = self.clients[client].id;
        match kind {
            Kind::Datagram => self.world.handle_datagram(id, bytes, self.now),
            Kind::Control => self.world.handle_control(id, bytes, self.now),
        }
    }

    fn arrives_at_client(&mut self, number: usize, kind: Kind, bytes: &[u8], observer: &mut dyn Observer) {
        let client = &mut self.clients[number];
        if !client.connected {
            return;
        }
        let local = client.clock.local(self.now);
        match kind {
            // The QUIC shell leaves them in quinn's buffer until then.
            Kind::Datagram if client.session.welcome().is_none() => client.early.push(bytes.to_vec()),
            Kind::Datagram => client.session.handle_datagram(bytes, client.driver.occlusion(), local),
            Kind::Control => {
                client.session.handle_control(bytes);
                if let Some(occlusion) = client.driver.occlusion() {
                    client.session.handle_news(occlusion);
                }
            }
        }
        if client.session.welcome().is_some() {
            for early in std::mem::take(&mut client.early) {
                client.session.handle_datagram(&early, client.driver.occlusion(), local);
            }
        }
        let mut is_over = false;
        while let Some(event) = client.session.poll_event() {
            is_over |= !matches!(event, SessionEvent::Welcomed(_));
            client.events.push(event);
        }
        // As the QUIC shell does: questions that an answer raised leave at once, the rest with the next frame.
        while let Some(bytes) = {
            let client = &mut self.clients[number];
            client.session.poll_urgent(client.datagram_limit, local)
        } {
            self.send(number, Direction::Up, Kind::Datagram, bytes, observer);
        }
        self.send_control(number, observer);
        if is_over {
            self.cut(number);
        }
    }

    fn drain_world(&mut self, observer: &mut dyn Observer) {
        while let Some((id, transmit)) = self.world.poll_transmit(self.now) {
            let Some(client) = self.client_of(id) else { continue };
            match transmit {
                Transmit::Control(bytes) => self.put_control(client, Direction::Down, &bytes, observer),
                Transmit::Datagram(bytes) => self.send(client, Direction::Down, Kind::Datagram, bytes, observer),
                // The model is not part of a virtual run: its clients have it.
                Transmit::WorldBytes => {}
                Transmit::Close(reason) => {
                    let (at, _) = self.clients[client].down.control(1, self.now);
                    self.queue.push(at, Event::Closed { client, reason });
                    self.world.disconnect(id);
                }
            }
        }
    }

    fn client_of(&self, id: SessionId) -> Option<usize> {
        self.clients.iter().position(|client| client.id == id)
    }

    fn send_control(&mut self, client: usize, observer: &mut dyn Observer) {
        while let Some(bytes) = self.clients[client].session.poll_control() {
            self.put_control(client, Direction::Up, &bytes, observer);
        }
    }

    /// Puts a control message with its prefix on its way.
    fn put_control(&mut self, client: usize, direction: Direction, bytes: &[u8], observer: &mut dyn Observer) {
        let message = bytes.get(4..).unwrap_or_default().to_vec();
        self.send(client, direction, Kind::Control, message, observer);
    }

    fn send(&mut self, client: usize, direction: Direction, kind: Kind, bytes: Vec<u8>, observer: &mut dyn Observer) {
        if kind == Kind::Control {
            let now = self.now;
            let (at, lost) = self.link(client, direction).control(bytes.len() + 4, now);
            for _ in 0..lost {
                observer.lost(&Passing { client, direction, kind, bytes: &bytes, at: now });
            }
            return self.queue.push(at, Event::Arrives { client, direction, kind, bytes });
        }
        let passing = Passing { client, direction, kind, bytes: &bytes, at: self.now };
        let verdict = self.interceptor.as_mut().map_or(Verdict::AsRuled, |interceptor| interceptor(&passing));
        let (verdict, bytes) = match verdict {
            Verdict::Rewrite(bytes) => (Verdict::AsRuled, bytes),
            verdict => (verdict, bytes),
        };
        // Drawn whatever the verdict, so that an interception changes nothing else.
        let ruled = self.link(client, direction).datagram();
        let (first, second) = match verdict {
            Verdict::AsRuled | Verdict::Rewrite(_) => ruled,
            Verdict::Instead(fate) => (fate, None),
            Verdict::Twice(first, second) => (Fate::Deliver(first), Some(Fate::Deliver(second))),
        };
        if first == Fate::Drop && !matches!(second, Some(Fate::Deliver(_))) {
            observer.lost(&Passing { client, direction, kind, bytes: &bytes, at: self.now });
        }
        for fate in [Some(first), second].into_iter().flatten() {
            if let Fate::Deliver(delay) = fate {
                self.queue.push(self.now + delay, Event::Arrives { client, direction, kind, bytes: bytes.clone() });
            }
        }
    }

    fn link(&mut self, client: usize, direction: Direction) -> &mut VirtualLink {
        match direction {
            Direction::Up => &mut self.clients[client].up,
            Direction::Down => &mut self.clients[client].down,
        }
    }

    /// Takes an arrival into the digest.
    fn note(&mut self, message: &Passing<'_>) {
        self.messages += 1;
        let mut eat = |bytes: &[u8]| {
            for &byte in bytes {
                self.digest = (self.digest ^ u64::from(byte)).wrapping_mul(FNV.1);
            }
        };
        eat(&message.at.micros().to_le_bytes());
        eat(&(message.client as u32).to_le_bytes());
        eat(&[message.direction as u8, message.kind as u8]);
        eat(message.bytes);
    }

    /// True world time.
    pub fn now(&self) -> WorldTime {
        self.now
    }

    /// The world.
    pub fn world(&self) -> &World {
        &self.world
    }

    /// Does something to the world, and sends what comes of it.
    pub fn with_world<R>(&mut self, observer: &mut dyn Observer, act: impl FnOnce(&mut World, WorldTime) -> R) -> R {
        let result = act(&mut self.world, self.now);
        self.drain_world(observer);
        result
    }

    /// Clients, in the order in which they joined; those that left too.
    pub fn clients(&self) -> &[Client] {
        &self.clients
    }

    /// One client.
    pub fn client_mut(&mut self, client: usize) -> &mut Client {
        &mut self.clients[client]
    }

    /// Hash of everything that arrived so far: time, client, direction and bytes. Equal runs have equal digests.
    pub fn digest(&self) -> u64 {
        self.digest
    }

    /// How many datagrams and control messages arrived so far.
    pub fn messages(&self) -> u64 {
        self.messages
    }
}
