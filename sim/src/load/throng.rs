//! A thousand clients in one task: quinn's state machines without a task, a channel and a timer for each connection.
//!
//! What a client costs is mostly its packets, and around each packet quinn's own shell wakes tasks: the endpoint's, the
//! connection's and the application's. A server has to live with that, since its connections come and go; who plays a crowd
//! need not. Here one loop reads what has arrived, hands each packet to its connection, plays the frames whose time has
//! come and sends what comes of it. Everything that the server sees is as before: [`quinn_proto`]'s connections with the
//! settings of [`eyeline_client::net`], and real sessions with trackers of their own. All share one socket.

// This is a driver: it may read the clock and own sockets.
#![expect(clippy::disallowed_methods)]

mod link;

use std::cmp::Reverse;
use std::collections::{BinaryHeap, VecDeque};
use std::io::{self, IoSliceMut};
use std::net::{Ipv4Addr, Ipv6Addr, SocketAddr};
use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::Context as _;
use bytes::BytesMut;
use eyeline_client::net::{Driver, FrameReport, LocalClock, Trust};
use eyeline_client::session::Session;
use eyeline_client::tracking::Ahead;
use eyeline_protocol::LocalTime;
use quinn::udp::{BATCH_SIZE, RecvMeta, UdpSocketState};
use quinn_proto::{ConnectionHandle, DatagramEvent, Endpoint, EndpointConfig};
use tokio::io::Interest;

use super::churn::{Change, Churn};
use link::{Heard, Link};

/// What a member's newest frame looked for: nothing, while nothing is tracked.
#[derive(Clone, Copy, Debug, Default)]
struct Looked {
    at_all: bool,
    has_frame: bool,
    ahead: Ahead,
}

impl Looked {
    /// Culls as the newest frame would have if there is something to track since.
    fn at_news(&mut self, session: &Session, player: &mut dyn Driver) {
        if self.has_frame && !self.at_all && session.tracks() {
            player.cull(self.ahead);
            self.at_all = true;
        }
    }
}

/// What becomes a member: a session before its hello, and whoever is in front of it.
pub struct Recruit {
    /// Its session.
    pub session: Session,
    /// Who moves and looks.
    pub player: Box<dyn Driver>,
}

/// Makes the member of a number, for the so manieth time.
pub type Recruiter = Box<dyn FnMut(usize, usize) -> Recruit>;

/// How a throng is to behave.
pub struct ThrongRules {
    /// Where the server is.
    pub address: SocketAddr,
    /// Why it is believed.
    pub trust: Trust,
    /// Number of the first member: those before it play elsewhere.
    pub first: usize,
    /// Number after the last member's.
    pub end: usize,
    /// Time between frames.
    pub period: Duration,
    /// When the first period begins; members' frames lie in it as [`super::phase_of`] says.
    pub begin: LocalTime,
    /// Changes of each kind a second.
    pub churn: f64,
    /// Number of the first who changes at all.
    pub steady: usize,
    /// Decides who changes when.
    pub seed: u64,
}

/// What became of one member.
#[derive(Clone, Copy, Debug, Default)]
pub struct Outcome {
    /// Smoothed round trip.
    pub round_trip: Option<Duration>,
    /// Visible, hidden and asked for at the end.
    pub counts: (usize, usize, usize),
}

struct Member {
    session: Session,
    player: Box<dyn Driver>,
    /// Its connection, unless it is between two.
    link: Option<ConnectionHandle>,
    /// Frames so far, and frames left out because the process came late.
    frames: u64,
    skipped: u64,
    looked: Looked,
    churn: Option<Churn>,
    /// What it does next, and when.
    change: Option<(LocalTime, Change)>,
    /// How often it was made.
    turn: usize,
    is_in: bool,
    /// When it is given up, unless it is in by then.
    deadline: LocalTime,
}

/// A crowd.
pub struct Throng {
    rules: ThrongRules,
    recruiter: Recruiter,
    clock: LocalClock,
    endpoint: Endpoint,
    config: quinn_proto::ClientConfig,
    server_name: String,
    socket: tokio::net::UdpSocket,
    udp: UdpSocketState,
    members: Vec<Member>,
    /// By handle.
    links: Vec<Option<Link>>,
    /// Whether who has left is not to be replaced.
    is_ending: bool,
    /// When it is looked next whether somebody has not been let in.
    looks_next: LocalTime,
    /// Links that something has happened to.
    touched: VecDeque<usize>,
    /// When links want to be woken. Those that want it later by now are put back.
    timers: BinaryHeap<Reverse<(Instant, usize)>>,
    /// Members' next frames.
    due: BinaryHeap<Reverse<(LocalTime, usize)>>,
    /// Scratch for what arrives and for what leaves.
    arrived: Vec<u8>,
    packet: Vec<u8>,
}

/// For how long a server may take to let somebody in.
const PATIENCE: Duration = Duration::from_secs(5);

/// For how long a goodbye may take to be heard.
const HEARING: Duration = Duration::from_secs(1);

/// Bytes for what is received at once: the system may join several packets of one sender. An odd number of cache lines, so
/// that the beginnings of all do not compete for the same few places in the caches.
const ARRIVES_MAX: usize = 64 * 1024 + 64;

impl Throng {
    /// A throng of which nobody is in yet. Needs a tokio runtime around it.
    ///
    /// # Errors
    /// If there is no socket to be had.
    pub fn new(rules: ThrongRules, clock: LocalClock, recruiter: Recruiter) -> anyhow::Result<Throng> {
        let any: SocketAddr = match (rules.address, rules.address.ip().is_loopback()) {
            (SocketAddr::V4(_), true) => (Ipv4Addr::LOCALHOST, 0).into(),
            (SocketAddr::V4(_), false) => (Ipv4Addr::UNSPECIFIED, 0).into(),
            (SocketAddr::V6(_), true) => (Ipv6Addr::LOCALHOST, 0).into(),
            (SocketAddr::V6(_), false) => (Ipv6Addr::UNSPECIFIED, 0).into(),
        };
        let socket = eyeline_server::net::socket(any).context("cannot open a socket")?;
        let udp = UdpSocketState::new((&socket).into())?;
        Ok(Throng {
            endpoint: Endpoint::new(Arc::new(EndpointConfig::default()), None, true, None),
            server_name: rules.trust.name().to_owned(),
            config: eyeline_client::net::quic_config(rules.trust.clone())?,
            socket: tokio::net::UdpSocket::from_std(socket)?,
            udp,
            clock,
            members: Vec::new(),
            links: Vec::new(),
            is_ending: false,
            looks_next: LocalTime::ZERO,
            touched: VecDeque::new(),
            timers: BinaryHeap::new(),
            due: BinaryHeap::new(),
            arrived: vec![0; ARRIVES_MAX * BATCH_SIZE],
            packet: Vec::new(),
            rules,
            recruiter,
        })
    }

    /// Lets everybody in, one after the other. Who is in plays already: who waited for the last would not read what it is told
    /// of those who join.
    ///
    /// # Errors
    /// If somebody is not let in.
    pub async fn join(&mut self) -> anyhow::Result<()> {
        let ThrongRules { first, end, churn, steady, seed, .. } = self.rules;
        while first + self.members.len() < end {
            let number = self.members.len();
            let Recruit { session, player } = (self.recruiter)(first + number, 0);
            let changing = end.saturating_sub(steady.max(first));
            let churn = (first + number >= steady).then(|| Churn::new(churn, seed, first + number, changing)).flatten();
            self.members.push(Member {
                session,
                player,
                link: None,
                frames: 0,
                skipped: 0,
                looked: Looked::default(),
                churn,
                change: None,
                turn: 0,
                is_in: false,
                deadline: self.clock.now() + PATIENCE,
            });
            self.dial(number)?;
            while !self.members[number].is_in {
                self.step().await?;
            }
        }
        Ok(())
    }

    /// Plays. Never ends by itself; safe to drop, and to call again.
    ///
    /// # Errors
    /// If a connection is lost.
    pub async fn play(&mut self) -> anyhow::Result<std::convert::Infallible> {
        loop {
            self.step().await?;
        }
    }

    /// Everybody says goodbye, and is heard unless that takes longer than a second.
    pub async fn leave(mut self) -> Vec<Outcome> {
        let outcome = |member: &Member| Outcome {
            round_trip: member.session.round_trip().map(|(smoothed, _)| smoothed),
            counts: member.session.tracker().map_or((0, 0, 0), |tracker| tracker.counts()),
        };
        let outcomes = self.members.iter().map(outcome).collect();
        self.is_ending = true;
        for number in 0..self.members.len() {
            self.say_goodbye(number);
        }
        let until = self.clock.now() + HEARING;
        while self.members.iter().any(|member| member.link.is_some()) && self.clock.now() < until {
            if self.step().await.is_err() {
                break;
            }
        }
        for number in 0..self.members.len() {
            self.part(number, b"goodbye");
        }
        outcomes
    }

    fn dial(&mut self, number: usize) -> anyhow::Result<()> {
        let now = Instant::now();
        let (handle, connection) =
            self.endpoint.connect(now, self.config.clone(), self.rules.address, &self.server_name)?;
        if self.links.len() <= handle.0 {
            self.links.resize_with(handle.0 + 1, || None);
        }
        self.links[handle.0] = Some(Link::new(handle, connection, number));
        let member = &mut self.members[number];
        member.link = Some(handle);
        member.is_in = false;
        member.deadline = self.clock.now() + PATIENCE;
        self.touch(handle.0);
        self.look_after_touched()
    }

    /// Ends a member's connection.
    fn part(&mut self, number: usize, why: &'static [u8]) {
        let Some(handle) = self.members[number].link.take() else { return };
        let Some(link) = self.links.get_mut(handle.0).and_then(Option::as_mut) else { return };
        link.part(Instant::now(), why);
        self.touch(handle.0);
        // Whatever goes wrong with a connection that is over matters no more.
        let _ = self.look_after_touched();
    }

    fn touch(&mut self, handle: usize) {
        if let Some(link) = self.links.get_mut(handle).and_then(Option::as_mut)
            && !std::mem::replace(&mut link.is_touched, true)
        {
            self.touched.push_back(handle);
        }
    }

    /// Waits until something is to be done, and does it.
    async fn step(&mut self) -> anyhow::Result<()> {
        let frame = self.due.peek().map(|Reverse((due, _))| self.clock.instant(*due));
        let timer = self.timers.peek().map(|Reverse((at, _))| *at);
        let patience = Instant::now() + Duration::from_millis(100);
        let link = (!self.touched.is_empty()).then(Instant::now);
        let next = [frame, timer, link].into_iter().flatten().fold(patience, Instant::min);
        tokio::select! {
            biased;
            ready = self.socket.readable() => {
                ready?;
                self.receive()?;
            }
            () = tokio::time::sleep_until(next.into()) => {}
        }
        self.wake();
        self.look_for_overdue()?;
        // Frames come first: all that a server says at a tick arrives at once, and they must not wait for it. Who is too slow for all
        // its frames still comes to the end of this list, and hears what has arrived meanwhile.
        for look in 0..self.touched.len() {
            if look % LOOKS_MAX == 0 {
                self.frames()?;
            }
            let Some(handle) = self.touched.pop_front() else { break };
            self.look_after(handle)?;
        }
        self.frames()?;
        // There are other tasks on this thread.
        tokio::task::yield_now().await;
        Ok(())
    }

    /// Nobody is waited for without end.
    fn look_for_overdue(&mut self) -> anyhow::Result<()> {
        let now = self.clock.now();
        if now < self.looks_next {
            return Ok(());
        }
        self.looks_next = now + PATIENCE / 50;
        let is_overdue = |member: &Member| !member.is_in && now >= member.deadline;
        if let Some(number) = self.members.iter().position(is_overdue) {
            anyhow::bail!(
                "client {}: it is not let in within {} s: {}; is the server running, and is this its address?",
                self.rules.first + number,
                PATIENCE.as_secs(),
                self.how_far(number),
            );
        }
        Ok(())
    }

    /// Takes a batch of what has arrived.
    fn receive(&mut self) -> anyhow::Result<()> {
        let mut metas = [RecvMeta::default(); BATCH_SIZE];
        let mut chunks = self.arrived.chunks_exact_mut(ARRIVES_MAX);
        let mut slices: [IoSliceMut<'_>; BATCH_SIZE] =
            std::array::from_fn(|_| IoSliceMut::new(chunks.next().expect("as many as a batch has")));
        let socket = &self.socket;
        let received = socket.try_io(Interest::READABLE, || self.udp.recv(socket.into(), &mut slices, &mut metas));
        let count = match received {
            Ok(count) => count,
            Err(error) if matches!(error.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::ConnectionReset) => 0,
            Err(error) => return Err(error).context("cannot receive"),
        };
        let now = Instant::now();
        for (index, meta) in metas.iter().take(count).enumerate() {
            let ecn = meta.ecn.and_then(|ecn| quinn_proto::EcnCodepoint::from_bits(ecn as u8));
            let start = index * ARRIVES_MAX;
            let mut data = BytesMut::from(&self.arrived[start..start + meta.len]);
            while !data.is_empty() {
                let one = data.split_to(meta.stride.clamp(1, data.len()));
                self.packet.clear();
                match self.endpoint.handle(now, meta.addr, meta.dst_ip, ecn, one, &mut self.packet) {
                    Some(DatagramEvent::ConnectionEvent(handle, event)) => {
                        if let Some(link) = self.links.get_mut(handle.0).and_then(Option::as_mut) {
                            link.connection.handle_event(event);
                        }
                        self.touch(handle.0);
                    }
                    Some(DatagramEvent::Response(transmit)) => self.send(&transmit),
                    Some(DatagramEvent::NewConnection(incoming)) => self.endpoint.ignore(incoming),
                    None => {}
                }
            }
        }
        Ok(())
    }

    /// Sends what is in `packet`. What the system does not take now is lost, as on any path.
    fn send(&self, transmit: &quinn_proto::Transmit) {
        send(&self.udp, &self.socket, transmit, &self.packet);
    }

    /// Tells links whose time has come.
    fn wake(&mut self) {
        let now = Instant::now();
        while let Some(Reverse((at, handle))) = self.timers.peek().copied()
            && at <= now
        {
            self.timers.pop();
            if let Some(link) = self.links.get_mut(handle).and_then(Option::as_mut)
                && link.disarm(at)
            {
                link.connection.handle_timeout(now);
                self.touch(handle);
            }
        }
    }

    /// Lets each link that something happened to do all that it can do now.
    fn look_after_touched(&mut self) -> anyhow::Result<()> {
        while let Some(handle) = self.touched.pop_front() {
            self.look_after(handle)?;
        }
        Ok(())
    }

    fn look_after(&mut self, handle: usize) -> anyhow::Result<()> {
        let Some(link) = self.links[handle].as_mut() else { return Ok(()) };
        link.is_touched = false;
        let number = link.member;
        let member = &mut self.members[number];
        let is_own = member.link == Some(link.handle);
        let heard = match is_own {
            true => link.hear(&mut member.session, member.player.as_mut(), &mut member.looked, self.clock),
            false => link.ignore(),
        };
        let heard = heard.with_context(|| format!("client {}", self.rules.first + number))?;
        if is_own && heard == Heard::Welcome && !std::mem::replace(&mut member.is_in, true) {
            let passed = self.clock.now();
            // Frames of different clients are spread evenly, so that none waits for another.
            let share = super::phase_of(self.rules.first + number);
            let mut due = self.rules.begin + self.rules.period.mul_f64(share);
            let late = passed.since(due).as_secs_f64() / self.rules.period.as_secs_f64();
            due = due + self.rules.period.mul_f64(late.ceil());
            member.change = member.churn.as_mut().map(Churn::upcoming).map(|(stay, change)| (passed + stay, change));
            self.due.push(Reverse((due, number)));
        }
        let link = self.links[handle].as_mut().expect("looked at above");
        while let Some(event) = link.connection.poll_endpoint_events() {
            if let Some(event) = self.endpoint.handle_event(link.handle, event) {
                link.connection.handle_event(event);
            }
        }
        link.transmit(&self.udp, &self.socket, &mut self.packet);
        while let Some(event) = link.connection.poll_endpoint_events() {
            if let Some(event) = self.endpoint.handle_event(link.handle, event) {
                link.connection.handle_event(event);
            }
        }
        if link.connection.is_drained() {
            self.links[handle] = None;
        } else if let Some(at) = link.arm() {
            self.timers.push(Reverse((at, handle)));
        }
        match heard {
            Heard::Left => self.replace(number),
            Heard::Nothing | Heard::Welcome => Ok(()),
        }
    }

    /// Plays the frames that are due, and makes the changes.
    fn frames(&mut self) -> anyhow::Result<()> {
        // A batch at a time: what arrives must not wait for all of them.
        for _ in 0..FRAMES_MAX {
            let Some(Reverse((due, number))) =
                self.due.peek().copied().filter(|Reverse((due, _))| *due <= self.clock.now())
            else {
                return Ok(());
            };
            self.due.pop();
            let member = &mut self.members[number];
            if let Some((_, change)) = member.change.filter(|(at, _)| *at <= due) {
                self.change(number, change, due)?;
                continue;
            }
            let Some(handle) = member.link.filter(|_| member.is_in) else { continue };
            self.frame(number, due);
            if let Some(link) = self.links[handle.0].as_mut() {
                link.say(&mut self.members[number].session, self.clock.now());
            }
            self.look_after(handle.0)?;
        }
        Ok(())
    }

    /// How far a member has got that is not in yet.
    fn how_far(&self, number: usize) -> String {
        let link = self.members[number].link.and_then(|handle| self.links[handle.0].as_ref());
        link.map_or_else(|| "it has no connection".to_owned(), Link::how_far)
    }

    /// One frame, as `run_headless` of the client's own shell plays it.
    fn frame(&mut self, number: usize, due: LocalTime) {
        let now = self.clock.now();
        let Member { session, player, frames, skipped, looked, .. } = &mut self.members[number];
        for pose in player.poses(session, now) {
            session.set_pose(pose.object, pose.position, pose.orientation);
        }
        let started = Instant::now();
        let ahead = session.ahead();
        *looked = Looked { at_all: session.tracks() || !session.looks(), has_frame: true, ahead };
        let mut cull = Duration::ZERO;
        let time = if looked.at_all {
            player.cull(ahead);
            cull = started.elapsed();
            player.occlusion().and_then(|occlusion| session.frame(ahead, occlusion, now))
        } else {
            session.frame_alone(ahead, now)
        };
        let report = FrameReport {
            frame: *frames,
            began: now,
            time,
            cull,
            track: started.elapsed() - cull,
            late: now.since(due),
            skipped: *skipped,
        };
        player.frame_done(session, &report);
        *frames += 1;
        let mut next = due + self.rules.period;
        while next + self.rules.period < now {
            next = next + self.rules.period;
            *skipped += 1;
        }
        self.due.push(Reverse((next, number)));
    }

    fn change(&mut self, number: usize, change: Change, due: LocalTime) -> anyhow::Result<()> {
        let turn = self.members[number].turn + 1;
        self.members[number].turn = turn;
        match change {
            // Where another way begins is somewhere else.
            Change::Teleport => {
                let Recruit { player, .. } = (self.recruiter)(self.rules.first + number, turn);
                let member = &mut self.members[number];
                member.player = player;
                member.change = member.churn.as_mut().map(Churn::upcoming).map(|(stay, change)| (due + stay, change));
                self.due.push(Reverse((due, number)));
                Ok(())
            }
            Change::Resume => {
                self.part(number, b"comes back");
                self.members[number].session.reconnect();
                self.dial(number)
            }
            Change::Rejoin => {
                self.say_goodbye(number);
                self.look_after_touched()
            }
        }
    }

    /// Begins to leave. Who closes at once throws away what was just said, so a member has left when the server has heard it.
    fn say_goodbye(&mut self, number: usize) {
        let member = &mut self.members[number];
        member.session.leave();
        member.is_in = false;
        member.deadline = self.clock.now() + PATIENCE;
        if let Some(handle) = member.link
            && let Some(link) = self.links[handle.0].as_mut()
        {
            link.is_leaving = true;
            link.say(&mut member.session, self.clock.now());
            self.touch(handle.0);
        }
    }

    /// Somebody else comes in the place of one who has left, unless everybody leaves.
    fn replace(&mut self, number: usize) -> anyhow::Result<()> {
        if self.is_ending {
            self.members[number].link = None;
            return Ok(());
        }
        let Recruit { session, player } = (self.recruiter)(self.rules.first + number, self.members[number].turn);
        let member = &mut self.members[number];
        (member.session, member.player) = (session, player);
        (member.frames, member.skipped, member.looked) = (0, 0, Looked::default());
        self.dial(number)
    }
}

/// How many frames are played before what has arrived is looked at again.
const FRAMES_MAX: usize = 16;

/// How many links are looked after before frames that are due by then are played.
const LOOKS_MAX: usize = 4;

fn send(udp: &UdpSocketState, socket: &tokio::net::UdpSocket, transmit: &quinn_proto::Transmit, packet: &[u8]) {
    let transmit = quinn::udp::Transmit {
        destination: transmit.destination,
        ecn: transmit.ecn.and_then(|ecn| quinn::udp::EcnCodepoint::from_bits(ecn as u8)),
        contents: &packet[..transmit.size],
        segment_size: transmit.segment_size,
        src_ip: transmit.src_ip,
    };
    let _ = udp.send(socket.into(), &transmit);
}

#[cfg(test)]
mod tests;
