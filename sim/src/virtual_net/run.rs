//! The run itself: takes the next event, feeds a core, and puts what the core says on its way.

mod wire;

use std::time::Duration;

use eyeline_client::session::{Event as SessionEvent, IndexMaker, Session};
use eyeline_protocol::WorldTime;
use eyeline_server::world::{SessionId, World};
use rand::RngExt;
use rand_pcg::Pcg64;

use super::client::{Client, ClientDriver, ClientPlan, OwnClock, Pose};
use super::link::{Direction, Kind, VirtualLink};
use super::observer::{Framed, Ignore, Observer, Passing, Verdict};
use super::queue::Queue;
use super::transport::{Direct, Transport};
use crate::quic_net::QuicNet;

enum Event {
    Tick,
    Frame(usize),
    /// A packet arrives.
    Packet {
        client: usize,
        direction: Direction,
        bytes: Vec<u8>,
    },
    /// A control message arrives that the link itself has carried.
    Control {
        client: usize,
        direction: Direction,
        message: Vec<u8>,
    },
    /// A transport's timer.
    Wake {
        client: usize,
        direction: Direction,
    },
    /// The end that this leads to learns that the other one is closed.
    Over {
        client: usize,
        direction: Direction,
        reason: String,
    },
}

/// Decides about packets before the rules do.
type Interceptor = Box<dyn FnMut(&Passing<'_>) -> Verdict>;

/// A world and its clients over a simulated network, in virtual time.
pub struct VirtualRun {
    world: World,
    transport: Box<dyn Transport>,
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
    /// chance. Each datagram is a packet, and the control stream costs no packets.
    pub fn new(world: World, seed: u64, now: WorldTime) -> VirtualRun {
        VirtualRun::with_transport(world, Box::new(Direct::default()), seed, now)
    }

    /// The same over QUIC: handshakes, loss recovery and congestion control included, with the settings of the real
    /// server and client.
    ///
    /// # Errors
    /// If TLS can't be set up.
    pub fn over_quic(world: World, seed: u64, now: WorldTime) -> anyhow::Result<VirtualRun> {
        let transport = QuicNet::new(seed, now)?;
        Ok(VirtualRun::with_transport(world, Box::new(transport), seed, now))
    }

    fn with_transport(world: World, transport: Box<dyn Transport>, seed: u64, now: WorldTime) -> VirtualRun {
        let mut queue = Queue::new();
        queue.push(world.poll_timeout(), Event::Tick);
        VirtualRun {
            world,
            transport,
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
        self.transport.connect(client, &plan, self.now);
        self.clients.push(Client {
            session: Session::new(plan.session, index),
            driver,
            up: VirtualLink::new(plan.up, stream(1)).with_capacity(plan.up_capacity, self.now),
            down: VirtualLink::new(plan.down, stream(2)).with_capacity(plan.down_capacity, self.now),
            // Until the server knows of it.
            id: SessionId(0),
            clock,
            frame: plan.frame,
            connected: true,
            has_looked: true,
            ahead: eyeline_client::tracking::Ahead::default(),
            events: Vec::new(),
            closed: None,
            early: Vec::new(),
        });
        self.queue.push(self.now + phase, Event::Frame(client));
        self.send_control(client);
        self.pump(&mut Ignore);
        client
    }

    /// The client's end of the connection goes; the server learns of it a delay later.
    pub fn cut(&mut self, client: usize) {
        self.hang_up(client);
        self.pump(&mut Ignore);
    }

    fn hang_up(&mut self, client: usize) {
        if std::mem::replace(&mut self.clients[client].connected, false) {
            self.transport.close(client, Direction::Up, "gone", self.now);
        }
    }

    /// Sends these bytes as if the client's session had made them; a control message without its length prefix.
    pub fn send_raw(&mut self, client: usize, kind: Kind, bytes: Vec<u8>, observer: &mut dyn Observer) {
        match kind {
            Kind::Datagram => self.transport.send_datagram(client, Direction::Up, bytes, self.now),
            Kind::Control => {
                let length = u32::try_from(bytes.len()).unwrap_or(u32::MAX).to_le_bytes();
                self.transport.send_control(client, Direction::Up, &[&length[..], &bytes].concat());
            }
        }
        self.pump(observer);
    }

    /// Has a packet arrive now that the peer never sent: somebody else's, or the peer's own of long ago.
    pub fn inject(&mut self, client: usize, direction: Direction, bytes: Vec<u8>) {
        self.queue.push(self.now, Event::Packet { client, direction, bytes });
    }

    /// Sets a client's own clock forward, or back.
    pub fn jump_clock(&mut self, client: usize, micros: i64) {
        let base = &mut self.clients[client].clock.base_micros;
        *base = base.saturating_add(micros);
    }

    /// Lets `interceptor` decide about packets before the rules do: datagrams, or over QUIC what has been made of them.
    pub fn intercept(&mut self, interceptor: impl FnMut(&Passing<'_>) -> Verdict + 'static) {
        self.interceptor = Some(Box::new(interceptor));
    }

    /// Leaves all packets to the rules again.
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
            Event::Packet { client, direction, bytes } => {
                self.transport.handle_packet(client, direction, bytes, self.now);
            }
            Event::Control { client, direction, message } => {
                self.arrives(client, direction, Kind::Control, &message, observer);
            }
            Event::Wake { client, direction } => self.transport.handle_wake(client, direction, self.now),
            Event::Over { client, direction, reason } => self.over(client, direction, reason),
        }
        self.drain_world(observer);
        self.pump(observer);
    }

    fn tick(&mut self, observer: &mut dyn Observer) {
        // A `with_world` call may have moved the tick; a stale event then finds nothing due.
        self.world.tick(self.now);
        observer.committed(&self.world, self.now);
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
        // As the client's own loop does.
        let ahead = client.session.ahead();
        client.ahead = ahead;
        client.has_looked = client.session.tracks() || !client.session.looks();
        let time = if client.has_looked {
            client.driver.cull(ahead);
            client.driver.occlusion().and_then(|occlusion| client.session.frame(ahead, occlusion, local))
        } else {
            client.session.frame_alone(ahead, local)
        };
        let eye = client.driver.eye();
        client.driver.frame_done(&mut client.session, time, now);
        let framed = Framed { client: number, session: &client.session, time, eye, at: now, world: &self.world };
        observer.framed(&framed);
        self.send_control(number);
        let Some(limit) = self.transport.datagram_limit(number) else { return };
        while let Some(bytes) = self.clients[number].session.poll_datagram(limit, local) {
            self.transport.send_datagram(number, Direction::Up, bytes, self.now);
        }
    }

    fn arrives_at_server(&mut self, client: usize, kind: Kind, bytes: &[u8]) {
        let id = self.clients[client].id;
        match kind {
            Kind::Datagram => self.world.handle_datagram(id, bytes, self.now),
            Kind::Control => self.world.handle_control(id, bytes, self.now),
        }
    }

    fn arrives_at_client(&mut self, number: usize, kind: Kind, bytes: &[u8]) {
        let client = &mut self.clients[number];
        if !client.connected {
            return;
        }
        let local = client.clock.local(self.now);
        match kind {
            // The QUIC shell leaves them in quinn's buffer until then.
            Kind::Datagram if client.session.welcome().is_none() => client.early.push(bytes.to_vec()),
            Kind::Datagram => {
                let occlusion = client.driver.occlusion().filter(|_| client.has_looked);
                client.session.handle_datagram(bytes, occlusion, local);
            }
            Kind::Control => {
                client.session.handle_control(bytes);
                if !client.has_looked && client.session.tracks() {
                    client.driver.cull(client.ahead);
                    client.has_looked = true;
                }
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
            is_over |= matches!(event, SessionEvent::Refused { .. } | SessionEvent::ServerFault(_));
            client.events.push(event);
        }
        // As the QUIC shell does: questions that an answer raised leave at once, the rest with the next frame.
        if let Some(limit) = self.transport.datagram_limit(number) {
            while let Some(bytes) = self.clients[number].session.poll_urgent(limit, local) {
                self.transport.send_datagram(number, Direction::Up, bytes, self.now);
            }
        }
        self.send_control(number);
        if is_over {
            self.hang_up(number);
        }
    }

    fn client_of(&self, id: SessionId) -> Option<usize> {
        self.clients.iter().position(|client| client.id == id)
    }

    fn send_control(&mut self, client: usize) {
        while let Some(bytes) = self.clients[client].session.poll_control() {
            self.transport.send_control(client, Direction::Up, &bytes);
        }
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
        self.pump(observer);
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

    /// A client's UDP datagrams and bytes so far: sent, sent bytes, received, received bytes. `None` without QUIC.
    pub fn udp(&self, client: usize) -> Option<[u64; 4]> {
        self.transport.udp(client)
    }

    /// Longest time for which a datagram waited in QUIC's buffer until it left, or was dropped for a newer one; zero without
    /// QUIC.
    pub fn waited_max(&self, client: usize, direction: Direction) -> Duration {
        self.transport.waited_max(client, direction)
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
