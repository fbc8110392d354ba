//! One client's side of a connection, pure: bytes and time in, bytes and beliefs out.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::time::Duration;

use eyeline_protocol::codec::{self, DatagramWriter, DecodeError};
use eyeline_protocol::{
    Arrival, ClientControl, ClientEntry, ClientHeader, ClientRecord, Command, Continuity, Hold, Interest, Link,
    LinkHeader, LocalTime, ObjectId, Orientation, PAYLOAD_BYTES_MAX, PlanLine, PlanSwitch, Position, Prediction,
    Refusal, Resume, Role, ServerControl, ServerRecord, Stage, VERSION, Welcome, WorldTime,
};
use eyeline_visibility::{DynamicIndex, NothingHidden, Occlusion};

mod names;
mod watch;

pub use names::Named;
use names::Names;
use watch::Watch;

use crate::clock::{Clock, DRIFT, Monotonic};
use crate::tracking::{Ahead, Past, Sabotage, Tracker, TrackerConfig, TrackerStats};

/// Settings of a [`Session`].
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct SessionConfig {
    /// Greatest resolution that will be drawn at, pixels; default 320×240.
    pub resolution: (u16, u16),
    /// Which directions to hear of; default all.
    pub interest: Interest,
    /// Who to be; default one avatar.
    pub role: Role,
    /// A name for people.
    pub name: String,
    /// What the server is to let us in by; empty for none.
    pub token: Vec<u8>,
    /// Whether there are [`Event::Revealed`], `Hidden`, `Stopped` and `Left`; default false. Who sets it must poll them.
    pub watch: bool,
    /// Whether names, classes and nodes of objects are kept for [`Session::named`]. Default no: a swarm has no use for them.
    pub names: bool,
    /// The tracker's settings.
    pub tracker: TrackerConfig,
    /// Whether [`Session::take_states_received`] has something to take; default false. Who sets it must take.
    pub record_states: bool,
    /// What is asked of the client's plan; default as counted.
    pub plan: PlanSwitch,
}

impl Default for SessionConfig {
    fn default() -> SessionConfig {
        SessionConfig {
            resolution: (320, 240),
            interest: Interest::Around,
            role: Role::Avatar,
            name: String::new(),
            token: Vec::new(),
            watch: false,
            names: false,
            tracker: TrackerConfig::default(),
            record_states: false,
            plan: PlanSwitch::AUTO,
        }
    }
}

impl SessionConfig {
    /// Sets the greatest resolution.
    pub fn with_resolution(self, width: u16, height: u16) -> SessionConfig {
        SessionConfig { resolution: (width, height), ..self }
    }

    /// Sets which directions to hear of.
    pub fn with_interest(self, interest: Interest) -> SessionConfig {
        SessionConfig { interest, ..self }
    }

    /// Sets who to be.
    pub fn with_role(self, role: Role) -> SessionConfig {
        SessionConfig { role, ..self }
    }

    /// Sets the name.
    pub fn with_name(self, name: impl Into<String>) -> SessionConfig {
        SessionConfig { name: name.into(), ..self }
    }

    /// Sets what the server is to let us in by.
    pub fn with_token(self, token: Vec<u8>) -> SessionConfig {
        SessionConfig { token, ..self }
    }

    /// Asks for events of what comes into view, stops, and goes.
    pub fn with_watch(self) -> SessionConfig {
        SessionConfig { watch: true, ..self }
    }

    /// Keeps what the roster says of objects, for [`Session::named`].
    pub fn with_names(self) -> SessionConfig {
        SessionConfig { names: true, ..self }
    }

    /// Keeps which states arrive, for [`Session::take_states_received`].
    pub fn with_record_states(self) -> SessionConfig {
        SessionConfig { record_states: true, ..self }
    }

    /// Sets what is asked of the client's plan.
    pub fn with_plan(self, plan: PlanSwitch) -> SessionConfig {
        SessionConfig { plan, ..self }
    }

    /// Sets the tracker's settings.
    pub fn with_tracker(self, tracker: TrackerConfig) -> SessionConfig {
        SessionConfig { tracker, ..self }
    }
}

fn wish(object: ObjectId, is_taken: bool) -> ClientControl {
    if is_taken { ClientControl::Take { object } } else { ClientControl::LetGo { object } }
}

fn micros(micros: u32) -> Duration {
    Duration::from_micros(u64::from(micros))
}

fn hello(config: &SessionConfig, resume: Option<Resume>) -> ClientControl {
    ClientControl::Hello {
        version: VERSION,
        token: config.token.clone(),
        resolution: config.resolution,
        interest: config.interest,
        role: config.role,
        name: config.name.clone(),
        resume,
    }
}

/// Events that nobody polls go once there are more.
const EVENTS_MAX: usize = 4096;

/// Most messages that are kept while there is no connection.
const UNSAID_MAX: usize = 1024;

/// After so many frames in a row in which a tracker knows of nothing it is let go of. Who comes and goes by a door
/// would else have one made each time.
const IDLE_FRAMES: u32 = 100;

/// No client is silent for longer.
const SAY_SOMETHING: Duration = Duration::from_millis(500);

/// What an application may want to know.
#[derive(Clone, Debug, PartialEq)]
pub enum Event {
    /// The server let us in.
    Welcomed(Box<Welcome>),
    /// The server did not, or sends us away.
    Refused {
        /// Why, for programs.
        refusal: Refusal,
        /// Why, for people.
        reason: String,
    },
    /// The server said something that makes no sense; the connection is of no more use.
    ServerFault(DecodeError),
    /// An object is shown from this frame on.
    Revealed(ObjectId),
    /// It is not shown any more: it is out of sight, which says nothing of whether it moves.
    Hidden(ObjectId),
    /// It is in sight, and stands still.
    Stopped(ObjectId),
    /// It exists no more.
    Left(ObjectId),
    /// Whose a thing is that was taken or let go.
    Held(ObjectId, Hold),
    /// Something of the application's, about an object that is in sight, or of the server's own.
    Payload(Option<ObjectId>, Vec<u8>),
    /// Something that was to be said when the connection was lost, and is not: the server does not remember us, or we had not
    /// heard all that was here.
    Unsaid(Box<ClientControl>),
    /// Somebody says something to everybody.
    Said(String),
    /// Who is here, for operators; a [`Event::Done`] ends the list.
    Clients(Vec<ClientEntry>),
    /// What came of a command, and whether it was done.
    Done(bool, String),
}

impl Event {
    /// What happened, for people. Names and texts of others come escaped.
    pub fn describe(&self) -> String {
        match self {
            Event::Welcomed(welcome) => format!("welcome, client {}: {:?}", welcome.client.0, welcome.continuity),
            Event::Refused { reason, .. } => format!("refused: {reason}"),
            Event::ServerFault(error) => format!("the server makes no sense: {error}"),
            Event::Revealed(object) => format!("object {} comes into view", object.0),
            Event::Hidden(object) => format!("object {} is out of sight", object.0),
            Event::Stopped(object) => format!("object {} stands still", object.0),
            Event::Left(object) => format!("object {} has left", object.0),
            Event::Held(object, hold) => format!("object {} is {hold:?}", object.0),
            Event::Payload(Some(object), bytes) => format!("object {} sends {} bytes", object.0, bytes.len()),
            Event::Payload(None, bytes) => format!("the server sends {} bytes", bytes.len()),
            Event::Unsaid(message) => format!("not said, since we were forgotten: {message:?}"),
            Event::Said(text) => format!("said: {}", text.escape_debug()),
            Event::Clients(entries) => format!("{} clients are here", entries.len()),
            Event::Done(ok, text) => format!("{}: {}", if *ok { "done" } else { "not done" }, text.escape_debug()),
        }
    }
}

/// Counters of a session.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SessionStats {
    /// Datagrams received.
    pub datagrams_in: u64,
    /// Datagrams sent.
    pub datagrams_out: u64,
    /// Records received.
    pub records_in: u64,
    /// Records sent.
    pub records_out: u64,
    /// Datagrams that made no sense.
    pub rejected: u64,
    /// Duplicates, and datagrams too old to tell.
    pub stale: u64,
    /// How often our own clock went back.
    pub clock_jumps: u64,
}

/// What a frame was made with.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrameTime {
    /// Latest possible server time: what bounds were grown to.
    pub latest: WorldTime,
    /// Probable server time: what the frame shows.
    pub shown: WorldTime,
}

/// Makes the structure T for a world; see [`Session::new`].
pub type IndexMaker = Box<dyn Fn() -> Box<dyn DynamicIndex + Send> + Send>;

/// One client's side of a connection.
///
/// Feed it through `handle_*` and [`Session::frame`], then drain [`Session::poll_control`] and
/// [`Session::poll_datagram`].
pub struct Session {
    config: SessionConfig,
    make_index: IndexMaker,
    /// What a datagram carried: questions, by their numbers.
    link: Link<Vec<(ObjectId, u64)>>,
    clock: Clock,
    monotonic: Monotonic,
    /// The first of our datagrams that left after the newest jump of our clock: only these tell a round trip.
    probes_from: u32,
    /// None while there is nothing to track (DESIGN.md §8), unless the plan is forced.
    tracker: Option<Tracker>,
    /// T of the world's size, while there is no tracker to take it.
    index: Option<Box<dyn DynamicIndex + Send>>,
    /// Frames made without a tracker, and what those before it left behind.
    past: Past,
    /// Frames in a row in which the tracker has known of nothing.
    idle_frames: u32,
    welcome: Option<Box<Welcome>>,
    /// Whether we come back, and have not been welcomed yet.
    returns: bool,
    /// Roster entries of the welcome that have not arrived.
    objects_due: u32,
    moving_nodes: BTreeSet<String>,
    /// Messages of roster and leaving since everything was told.
    heard: u32,
    watch: Watch,
    names: Names,
    /// Our own eye, where it is not our avatar's, until it is said.
    eye_due: Option<(Position, Orientation)>,
    poses: BTreeMap<ObjectId, (Position, Orientation)>,
    /// Avatars whose newest pose has not been said, by id; emptied in turn so that none is starved.
    poses_due: VecDeque<ObjectId>,
    owes_ack: bool,
    /// When the newest datagram left.
    said_at: Option<LocalTime>,
    /// A record that did not fit into the last datagram.
    held_back: Option<ClientRecord>,
    control: VecDeque<ClientControl>,
    /// Things that were asked for, or put down, and no answer came yet; true for asked for.
    wishes: BTreeMap<ObjectId, bool>,
    /// What was to be said when the connection was lost: it is said once the server is heard to remember us.
    unsaid: VecDeque<ClientControl>,
    events: VecDeque<Event>,
    /// Probable server time at the newest frame; never goes back.
    shown: WorldTime,
    states_received: Vec<ObjectId>,
    stats: SessionStats,
}

impl Session {
    /// A session that says hello first. `make_index` makes T once the server has let it in.
    pub fn new(config: SessionConfig, make_index: IndexMaker) -> Session {
        let hello = hello(&config, None);
        Session {
            config,
            make_index,
            link: Link::default(),
            clock: Clock::default(),
            monotonic: Monotonic::default(),
            probes_from: 0,
            tracker: None,
            index: None,
            past: Past::default(),
            idle_frames: 0,
            welcome: None,
            returns: false,
            objects_due: 0,
            moving_nodes: BTreeSet::new(),
            heard: 0,
            watch: Watch::default(),
            names: Names::default(),
            eye_due: None,
            poses: BTreeMap::new(),
            poses_due: VecDeque::new(),
            owes_ack: false,
            said_at: None,
            held_back: None,
            control: VecDeque::from([hello]),
            wishes: BTreeMap::new(),
            unsaid: VecDeque::new(),
            events: VecDeque::new(),
            shown: WorldTime::ZERO,
            states_received: Vec::new(),
            stats: SessionStats::default(),
        }
    }

    /// Our own time, which goes on though our clock goes back.
    fn own_time(&mut self, now: LocalTime) -> LocalTime {
        let (now, is_jump) = self.monotonic.now(now);
        if is_jump {
            self.stats.clock_jumps += 1;
            self.probes_from = self.link.next_seq();
            self.clock.doubt();
        }
        now
    }

    /// One control message, without its length prefix.
    pub fn handle_control(&mut self, bytes: &[u8]) {
        while self.events.len() > EVENTS_MAX {
            self.events.pop_front();
        }
        match codec::decode_server_control(bytes) {
            Err(error) => self.events.push_back(Event::ServerFault(error)),
            Ok(ServerControl::Welcome(welcome)) => {
                let was_in = self.welcome.is_some();
                if was_in && !std::mem::take(&mut self.returns) {
                    return;
                }
                self.returns = false;
                // Without a frame yet, say something: the clock needs a probe.
                self.owes_ack = true;
                if welcome.continuity == Continuity::Kept && was_in {
                    // All that we hold goes on to hold; where we are is said again.
                    self.poses_due = welcome.avatars.iter().map(|own| own.0).collect();
                    self.welcome = Some(welcome.clone());
                    self.events.push_back(Event::Welcomed(welcome));
                    return;
                }
                // Ids may mean others by now: what was to be said about them is for the application to say again.
                self.wishes.clear();
                let unsaid = std::mem::take(&mut self.unsaid);
                self.events.extend(unsaid.into_iter().map(|message| Event::Unsaid(Box::new(message))));
                (self.heard, self.moving_nodes) = (0, BTreeSet::new());
                (self.tracker, self.index, self.past, self.idle_frames) = (None, None, Past::default(), 0);
                self.poses = welcome.avatars.iter().map(|&(id, at, turn)| (id, (at, turn))).collect();
                self.poses_due.clear();
                self.objects_due = welcome.objects;
                self.welcome = Some(welcome.clone());
                if self.config.plan.asked(Stage::Tracker) == Some(true) {
                    self.need_tracker();
                }
                self.events.push_back(Event::Welcomed(welcome));
            }
            Ok(ServerControl::Refused { refusal, reason }) => self.events.push_back(Event::Refused { refusal, reason }),
            Ok(ServerControl::Roster { tick, entries }) => {
                self.heard = self.heard.saturating_add(1);
                if self.objects_due > 0 {
                    self.objects_due = self.objects_due.saturating_sub(entries.len() as u32);
                    let nodes = entries.iter().filter(|entry| !entry.node.is_empty());
                    self.moving_nodes.extend(nodes.map(|entry| entry.node.clone()));
                }
                if self.config.names {
                    entries.iter().for_each(|entry| self.names.hear(entry));
                }
                // Everybody is told of everybody who comes, us included.
                for entry in &entries {
                    if !self.is_own_avatar(entry.object)
                        && let Some(tracker) = self.need_tracker()
                    {
                        tracker.handle_roster(entry, tick);
                    }
                }
            }
            Ok(ServerControl::Left { objects }) => {
                self.heard = self.heard.saturating_add(1);
                let own = self.welcome.as_ref().map_or(&[][..], |welcome| &welcome.avatars);
                objects.iter().for_each(|object| self.names.leave(*object));
                if let Some(tracker) = &mut self.tracker {
                    for object in objects {
                        tracker.handle_left(object);
                        let is_own = own.iter().any(|own| own.0 == object);
                        if self.config.watch && !is_own {
                            self.watch.leave(object);
                            self.events.push_back(Event::Left(object));
                        }
                    }
                }
            }
            Ok(ServerControl::Held { object, hold }) => {
                self.wishes.remove(&object);
                if hold == Hold::Yours {
                    // Not said before it is set: where it is now the server knows.
                    let shown = self.tracker.as_ref().and_then(|tracker| tracker.shown(object));
                    let pose = shown.map_or(Default::default(), |drawn| (drawn.position, drawn.orientation));
                    self.poses.entry(object).or_insert(pose);
                } else if !self.is_own_avatar(object) {
                    self.poses.remove(&object);
                    self.poses_due.retain(|&due| due != object);
                }
                self.events.push_back(Event::Held(object, hold));
            }
            Ok(ServerControl::Payload { object, bytes }) => self.events.push_back(Event::Payload(object, bytes)),
            Ok(ServerControl::Said { text }) => self.events.push_back(Event::Said(text)),
            Ok(ServerControl::Clients { entries }) => self.events.push_back(Event::Clients(entries)),
            Ok(ServerControl::Done { ok, text }) => self.events.push_back(Event::Done(ok, text)),
        }
    }

    /// The tracker, which is made now if there is none: there is something to track. None before the welcome, and where the plan
    /// is forced to do without.
    fn need_tracker(&mut self) -> Option<&mut Tracker> {
        let welcome = self.welcome.as_deref()?;
        if self.tracker.is_none() && self.config.plan.runs(Stage::Tracker, true) {
            let index = self.index.take().unwrap_or_else(|| (self.make_index)());
            let mut config = self.config.tracker.clone();
            config.exact &= self.config.plan.runs(Stage::Exact, true);
            config.sealed &= self.config.plan.runs(Stage::Sealed, true);
            let past = std::mem::take(&mut self.past);
            let heard_at = past.heard_at;
            let mut tracker = Tracker::new(config, welcome.tracking, welcome.blur, welcome.classes.clone(), index)
                .with_dead_reckoning(welcome.dead_reckoning_px)
                .with_tick(Duration::from_micros(u64::from(welcome.tick_micros)))
                .with_answer_wait(micros(welcome.answer_micros))
                .with_past(past);
            if let Some(heard_at) = heard_at {
                tracker.handle_path(self.link.round_trip_max(), self.link.timeout(), heard_at);
            }
            self.tracker = Some(tracker);
        }
        self.tracker.as_mut()
    }

    /// Lets go of the tracker: nothing has been there to track for a while. T is kept for its size, empty.
    fn dismiss_tracker(&mut self) {
        let Some(tracker) = self.tracker.take() else { return };
        let (past, mut index) = tracker.into_past();
        index.shrink();
        (self.past, self.index, self.idle_frames) = (past, Some(index), 0);
    }

    /// Whether anything is tracked, so that somebody must find out what hides it. While nothing is, a frame may be made with
    /// [`Session::frame_alone`].
    pub fn tracks(&self) -> bool {
        let is_forced = self.config.plan.asked(Stage::Tracker) == Some(true);
        self.tracker.as_ref().is_some_and(|tracker| is_forced || !tracker.is_empty())
    }

    /// Whether something is held hidden that walls might seal off for good, so that it pays to find out which parts of
    /// the scene they close ([`eyeline_visibility::SealedParts`]).
    pub fn could_seal(&self) -> bool {
        self.tracker.as_ref().is_some_and(Tracker::could_be_sealed)
    }

    /// Whether this client looks at anything at all; one that only moves avatars does not.
    pub fn looks(&self) -> bool {
        !matches!(self.config.role, Role::Actor { .. })
    }

    /// What is asked of the plan.
    pub fn plan_switch(&self) -> PlanSwitch {
        self.config.plan
    }

    /// Lines of the plan that are the session's to decide: tracker, looking again, exact validity.
    pub fn plan_lines(&self, still_frames: u64) -> Vec<PlanLine> {
        crate::plan::tracking_lines(self, still_frames)
    }

    fn is_own_avatar(&self, object: ObjectId) -> bool {
        self.welcome.as_ref().is_some_and(|welcome| welcome.avatars.iter().any(|own| own.0 == object))
    }

    /// The connection was lost and there will be another: says hello there, and that we were here before. What is believed
    /// goes on to hold if the server remembers us, which its welcome says.
    pub fn reconnect(&mut self) {
        let resume = self.welcome.as_ref().map(|welcome| {
            let has_all = self.objects_due == 0;
            Resume { token: welcome.resume, heard: has_all.then_some(self.heard) }
        });
        self.returns = true;
        self.link = Link::default();
        self.probes_from = 0;
        self.held_back = None;
        self.said_at = None;
        // A wish whose answer did not come may not have been heard; to say it twice does no harm. What of the rest had left may
        // have been heard, too, and is not said again.
        let mut unsaid = std::mem::take(&mut self.unsaid);
        let is_for_later = |message: &ClientControl| {
            !matches!(message, ClientControl::Hello { .. } | ClientControl::Goodbye | ClientControl::WorldWanted)
        };
        unsaid.extend(self.control.drain(..).filter(is_for_later));
        for (&object, &is_taken) in &self.wishes {
            let is_about = |message: &ClientControl| matches!(*message, ClientControl::Take { object: of } | ClientControl::LetGo { object: of } if of == object);
            if !unsaid.iter().any(is_about) {
                unsaid.push_front(wish(object, is_taken));
            }
        }
        let excess = unsaid.len().saturating_sub(UNSAID_MAX);
        self.events.extend(unsaid.drain(..excess).map(|message| Event::Unsaid(Box::new(message))));
        self.unsaid = unsaid;
        self.control = VecDeque::from([hello(&self.config, resume)]);
    }

    /// Whether hello was said and the welcome has not come.
    pub fn is_waiting(&self) -> bool {
        self.welcome.is_none() || self.returns
    }

    /// Wants to move a thing that is near and in sight; [`Event::Held`] answers. Once it is ours, [`Session::set_pose`] moves it.
    pub fn take(&mut self, object: ObjectId) {
        self.wishes.insert(object, true);
        self.control.push_back(wish(object, true));
    }

    /// Puts a thing down.
    pub fn let_go(&mut self, object: ObjectId) {
        self.wishes.insert(object, false);
        self.control.push_back(wish(object, false));
    }

    /// Things that are ours to move, ascending.
    pub fn things(&self) -> impl Iterator<Item = ObjectId> + '_ {
        self.poses.keys().copied().filter(|&object| !self.is_own_avatar(object))
    }

    /// Sends something of the application's to those who are told of `object`, an avatar or a thing of ours. More than
    /// [`PAYLOAD_BYTES_MAX`] bytes are cut off.
    pub fn send_payload(&mut self, object: ObjectId, mut bytes: Vec<u8>) {
        bytes.truncate(PAYLOAD_BYTES_MAX);
        self.control.push_back(ClientControl::Payload { object, bytes });
    }

    /// Keeps order, as an operator may; [`Event::Done`] answers.
    pub fn command(&mut self, command: Command) {
        self.control.push_back(ClientControl::Command(command));
    }

    /// Looks from here rather than from our avatar's eye: relative to the anchor, and within 2 m of it for who may not fly.
    pub fn set_eye(&mut self, position: Position, orientation: Orientation) {
        self.eye_due = Some((position, orientation));
    }

    /// Acts on what control messages brought, with the newest frame's `occlusion`, instead of at the next frame.
    pub fn handle_news(&mut self, occlusion: &dyn Occlusion) {
        if let Some(tracker) = self.tracker.as_mut().filter(|tracker| tracker.stats().frames > 0) {
            tracker.handle_news(occlusion);
        }
    }

    /// One datagram. With the newest frame's `occlusion` answers are acted on at once.
    pub fn handle_datagram(&mut self, bytes: &[u8], occlusion: Option<&dyn Occlusion>, now: LocalTime) {
        let now = self.own_time(now);
        if self.welcome.is_none() {
            return;
        }
        let (header, records) = match codec::decode_server_datagram(bytes) {
            Ok(datagram) => datagram,
            Err(_) => {
                self.stats.rejected += 1;
                return;
            }
        };
        self.stats.datagrams_in += 1;
        let sent_at = self.link.sent_at(header.link.ack);
        let mut tracker = self.tracker.as_mut();
        let heard = |questions| {
            for (object, number) in questions {
                if let Some(tracker) = &mut tracker {
                    tracker.handle_heard(object, number);
                }
            }
        };
        if self.link.receive(&header.link, now, heard, |_| ()) == Arrival::Stale {
            self.stats.stale += 1;
            return;
        }
        self.owes_ack = true;
        // A thing can be taken only by who is told of it: by now we are again.
        if !self.returns {
            self.control.extend(self.unsaid.drain(..));
        }
        self.watch.hear(header.tick);
        if sent_at.is_some() && header.link.ack < self.probes_from {
            self.clock.observe_stamp(header.sent, now);
        } else if let Some(sent_at) = sent_at {
            let hold = Duration::from_micros(u64::from(header.link.hold_micros));
            // The server measured the hold with its own clock, which may run faster than ours.
            let hold = hold.mul_f64(1.0 - DRIFT);
            self.clock.observe(header.sent, now.since(sent_at).saturating_sub(hold), now);
            if self.config.tracker.sabotage == Some(Sabotage::FreezeClock) {
                self.clock.freeze(now);
            }
        }
        self.past.heard_at = Some(now);
        if let Some(tracker) = &mut self.tracker {
            tracker.handle_path(self.link.round_trip_max(), self.link.timeout(), now);
        }
        self.stats.records_in += records.len() as u64;
        // Records may overtake the roster that names their object: whatever is told of is to be tracked.
        let record_states = self.config.record_states;
        for record in records {
            if let (ServerRecord::State { object, .. }, true) = (&record, record_states) {
                self.states_received.push(*object);
            }
            let Some(tracker) = self.need_tracker() else { continue };
            match record {
                ServerRecord::State { object, position, orientation, velocity } => {
                    let state = Prediction { position, velocity, orientation, tick: header.tick };
                    tracker.handle_state(object, state, occlusion, now);
                }
                ServerRecord::Bound { object, tbv } => tracker.handle_bound(object, tbv.tbv(header.tick), occlusion),
                ServerRecord::Violation { object, issue, age_micros, present } => {
                    let age = i64::try_from(age_micros).unwrap_or(i64::MAX);
                    tracker.handle_violation(object, issue, header.tick.offset_micros(age.saturating_neg()), present);
                }
                ServerRecord::Hidden { object } => tracker.handle_hidden(object, header.tick),
            }
        }
    }

    /// Puts one of our avatars somewhere; it is said with the next datagram. Positions are relative to the anchor.
    pub fn set_pose(&mut self, object: ObjectId, position: Position, orientation: Orientation) {
        if let Some(pose) = self.poses.get_mut(&object) {
            *pose = (position, orientation);
            if !self.poses_due.contains(&object) {
                self.poses_due.push_back(object);
            }
        }
    }

    /// Teleports one of our avatars, or takes it into or out of the world.
    pub fn place(&mut self, object: ObjectId, position: Position, present: bool) {
        self.control.push_back(ClientControl::Place { object, position, present });
        if let Some(pose) = self.poses.get_mut(&object) {
            pose.0 = position;
        }
    }

    /// Asks for the model's bytes.
    pub fn want_world(&mut self) {
        self.control.push_back(ClientControl::WorldWanted);
    }

    /// Says goodbye.
    pub fn leave(&mut self) {
        self.control.push_back(ClientControl::Goodbye);
    }

    /// What the next frame must look ahead for: cull from every eye within its radius, then hand both to [`Session::frame`].
    pub fn ahead(&self) -> Ahead {
        let tracker = &self.config.tracker;
        let Some(avatar) = self.welcome.as_ref().filter(|welcome| welcome.tracking).and_then(|w| w.classes.first())
        else {
            return Ahead::default();
        };
        // The greatest lately, or where round trips usually end (RFC 6298's four variations) if that is more.
        let greatest = self.link.round_trip_max().unwrap_or_default();
        let round_trip = self.link.round_trip().map(|usual| greatest.max(usual.smoothed + 4 * usual.variation));
        let answer_wait = self.welcome.as_ref().map_or(Duration::ZERO, |welcome| micros(welcome.answer_micros));
        let round_trip = round_trip.map(|round_trip| round_trip + answer_wait);
        let mut ahead = tracker.lead.ahead(round_trip, tracker.frame, avatar.motion);
        if self.config.interest == Interest::Frustum {
            // Whose head may turn as fast as it likes looks all round.
            ahead.turn = avatar.turn_max.map(|turn_max| turn_max * ahead.time.as_secs_f64());
        }
        if tracker.sabotage == Some(Sabotage::PointLead) { Ahead { eye_radius: 0.0, ..ahead } } else { ahead }
    }

    /// One frame: decides what is asked, given what hides things from every eye that `ahead` tells of. `None` until the
    /// server's time is known.
    pub fn frame(&mut self, ahead: Ahead, occlusion: &dyn Occlusion, now: LocalTime) -> Option<FrameTime> {
        let now = self.own_time(now);
        let latest = self.clock.latest(now)?;
        let shown = self.clock.smoothed(now)?.max(self.shown);
        self.shown = shown;
        // Who says nothing for long is told nothing, and hears of nothing that it could acknowledge.
        self.owes_ack |= self.said_at.is_none_or(|at| now.since(at) >= SAY_SOMETHING);
        let Some(tracker) = &mut self.tracker else {
            self.welcome.as_ref()?;
            self.past.frame(latest, ahead);
            return Some(FrameTime { latest, shown });
        };
        tracker.frame(latest, ahead, occlusion, now);
        self.idle_frames = if tracker.is_idle() { self.idle_frames + 1 } else { 0 };
        if self.config.watch {
            let tick = self.welcome.as_ref().map_or(0, |welcome| welcome.tick_micros);
            let excess = self.events.len().saturating_sub(EVENTS_MAX);
            self.events.drain(..excess);
            self.watch.frame(tracker, Duration::from_micros(u64::from(tick)), &mut self.events);
        }
        if self.idle_frames >= IDLE_FRAMES && self.config.plan.asked(Stage::Tracker) != Some(true) {
            self.dismiss_tracker();
        }
        Some(FrameTime { latest, shown })
    }

    /// A frame while nothing is tracked: time goes on, and nobody needs to know what hides things.
    pub fn frame_alone(&mut self, ahead: Ahead, now: LocalTime) -> Option<FrameTime> {
        debug_assert!(!self.tracks(), "what is tracked must be looked at");
        self.frame(ahead, &NothingHidden, now)
    }

    /// The next bytes for the control stream, prefix included.
    pub fn poll_control(&mut self) -> Option<Vec<u8>> {
        self.control.pop_front().map(|message| codec::encode_control(&message))
    }

    /// The next datagram of at most `limit` bytes, but only if there is a record that should not wait for the next frame:
    /// a question that an answer has raised. Acknowledgements alone wait.
    pub fn poll_urgent(&mut self, limit: usize, now: LocalTime) -> Option<Vec<u8>> {
        let own = self.own_time(now);
        if self.held_back.is_none() {
            self.held_back = self.tracker.as_mut()?.poll_record(own);
        }
        self.held_back.is_some().then(|| self.poll_datagram(limit, now))?
    }

    /// The next datagram of at most `limit` bytes.
    pub fn poll_datagram(&mut self, limit: usize, now: LocalTime) -> Option<Vec<u8>> {
        let now = self.own_time(now);
        self.welcome.as_ref()?;
        let poll = |tracker: &mut Option<Tracker>| tracker.as_mut()?.poll_record(now);
        let mut next = self.held_back.take().or_else(|| poll(&mut self.tracker));
        if next.is_none() && self.poses_due.is_empty() && self.eye_due.is_none() && !self.owes_ack {
            return None;
        }
        let owed_ack = std::mem::take(&mut self.owes_ack);
        self.said_at = Some(now);
        // The header's size hardly depends on what it says; records are gathered first, then the link is told what goes.
        let longest = LinkHeader { seq: u32::MAX, ack: u32::MAX, ack_bits: u32::MAX, hold_micros: u32::MAX };
        let mut probe = DatagramWriter::new(&ClientHeader { link: longest, frame: WorldTime::MAX }, limit);
        let mut records = Vec::new();
        let mut questions = Vec::new();
        if let Some((position, orientation)) = self.eye_due {
            let record = ClientRecord::Eye { position, orientation };
            if probe.push(&record) {
                records.push(record);
                self.eye_due = None;
            }
        }
        while let Some(&object) = self.poses_due.front() {
            let Some(&(position, orientation)) = self.poses.get(&object) else {
                self.poses_due.pop_front();
                continue;
            };
            let record = ClientRecord::Pose { object, position, orientation };
            if !probe.push(&record) {
                break;
            }
            records.push(record);
            self.poses_due.pop_front();
        }
        while let Some(record) = next.take() {
            if !probe.push(&record) {
                self.held_back = Some(record);
                break;
            }
            if let ClientRecord::Request { object, .. } = record
                && let Some(number) = self.tracker.as_ref().and_then(|tracker| tracker.ask_number(object))
            {
                questions.push((object, number));
            }
            records.push(record);
            next = poll(&mut self.tracker);
        }
        if records.is_empty() && !owed_ack {
            // Nothing that is to be said fits: to go on would be to go on for ever.
            return None;
        }
        // Never given up for their age: a late acknowledgement still tells the round trip, and that a question was heard.
        let (link, _) = self.link.send(questions, now);
        let mut writer = DatagramWriter::new(&ClientHeader { link, frame: self.shown }, limit);
        for record in &records {
            let fits = writer.push(record);
            debug_assert!(fits, "the probe's header is the longest there is");
        }
        self.stats.records_out += records.len() as u64;
        self.stats.datagrams_out += 1;
        Some(writer.finish())
    }

    /// The next event. More than 4,096 are not kept: the oldest go.
    pub fn poll_event(&mut self) -> Option<Event> {
        self.events.pop_front()
    }

    /// The next event after which there is nothing more to come over this connection. Leaves all others.
    pub fn poll_fault(&mut self) -> Option<Event> {
        let is_fault = |event: &Event| matches!(event, Event::Refused { .. } | Event::ServerFault(_));
        self.events.remove(self.events.iter().position(is_fault)?)
    }

    /// What the server said at the beginning.
    pub fn welcome(&self) -> Option<&Welcome> {
        self.welcome.as_deref()
    }

    /// Names of the model's nodes that move, and so are not part of the static scene; `None` until every object that
    /// existed at the welcome has been told of.
    pub fn moving_nodes(&self) -> Option<&BTreeSet<String>> {
        (self.welcome.is_some() && self.objects_due == 0).then_some(&self.moving_nodes)
    }

    /// Replaces the tracker's T, once the world's size is known. Without this bounds outside the first T's box cost more.
    pub fn use_index(&mut self, index: Box<dyn DynamicIndex + Send>) {
        match &mut self.tracker {
            Some(tracker) => tracker.use_index(index),
            None => self.index = Some(index),
        }
    }

    /// Beliefs, while there is something to believe anything of.
    pub fn tracker(&self) -> Option<&Tracker> {
        self.tracker.as_ref()
    }

    /// What trackers counted since the welcome, those that have been let go of too.
    pub fn tracker_stats(&self) -> TrackerStats {
        self.tracker.as_ref().map_or(self.past.stats, |tracker| *tracker.stats())
    }

    /// What an object is, if names are kept ([`SessionConfig::names`]) and it is in the roster.
    pub fn named(&self, object: ObjectId) -> Option<&Named> {
        self.names.of(object)
    }

    /// Every object in the roster, by id, if names are kept.
    pub fn roster(&self) -> impl Iterator<Item = (ObjectId, &Named)> {
        self.names.all()
    }

    /// Objects whose states arrived since the last call, in order of arrival, if the configuration has them kept.
    pub fn take_states_received(&mut self) -> Vec<ObjectId> {
        std::mem::take(&mut self.states_received)
    }

    /// Round-trip time and the greatest of the last 5 s.
    pub fn round_trip(&self) -> Option<(Duration, Duration)> {
        Some((self.link.round_trip()?.smoothed, self.link.round_trip_max()?))
    }

    /// After what time without an answer something is said again.
    pub fn retry_after(&self) -> Duration {
        self.link.timeout() + self.welcome.as_ref().map_or(Duration::ZERO, |welcome| micros(welcome.answer_micros))
    }

    /// Counters since the start.
    pub fn stats(&self) -> &SessionStats {
        &self.stats
    }
}
