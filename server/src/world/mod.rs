//! Who is where, and what each client is told: the heart of the server, a pure state machine.
//!
//! A [`World`] does no I/O and reads no clock. Feed it what arrived through `handle_*`, call [`World::tick`] when
//! [`World::poll_timeout`] says so, and drain [`World::poll_transmit`]. The same code runs over real QUIC and in virtual
//! time.
//!
//! Time advances in ticks. What clients and paths want is *committed* once a tick, snapped to the wire's grid, and held
//! to each object's motion bound; every record that leaves speaks of the newest committed state. Requests are answered
//! on arrival, or with the tick if the world is set to ([`Answers`]).

mod admission;
mod blur;
mod census;
mod config;
mod due;
mod lens;
mod limits;
mod object;
mod people;
mod session;
mod stats;
mod validity;

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;
use std::time::Duration;

use eyeline_protocol::{
    CLASSES_MAX, Class, ClassId, ClientControl, ClientRecord, Extent, LocalTime, MotionBound, NAME_BYTES_MAX, ObjectId,
    Orientation, Plan, Position, QUANTUM_METRES, Refusal, Stage, Want, WireTbv, WorldInfo, WorldTime, codec,
};
use glam::DVec3;

use admission::{Announcements, Hello};
use blur::Known;
pub use census::Census;
pub use config::{Answers, WorldConfig, WorldError};
pub use limits::{LimitCounts, Limited, Limits, Rate};
pub use object::Object;
pub(crate) use object::present;
use people::Events;
pub use people::WorldEvent;
use session::{Moment, OwnEye, Phase, Session};
pub use stats::{MessageCounts, WorldStats};
pub use validity::Validity;

use crate::audit::Audit;
use crate::gate::{Gate, OpenGate};
use crate::path::paths_of;
use crate::plan::{self, Running};
use crate::policy::Policy;
use crate::spec::WorldSpec;

/// A connection, as the driver and the world name it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct SessionId(pub u32);

/// Something to send, or to do to a connection.
#[derive(Clone, Debug, PartialEq)]
pub enum Transmit {
    /// Bytes for the control stream, prefix included; what all are told is shared.
    Control(Arc<[u8]>),
    /// An unreliable datagram.
    Datagram(Vec<u8>),
    /// The model's bytes are wanted, on a stream of their own.
    WorldBytes,
    /// End the connection once what came before is sent. The reason is for people.
    Close(String),
}

/// A path or peer that carries less can't carry a header and a record: 38 and 41 bytes at most.
const DATAGRAM_LIMIT_LEAST: usize = 128;

/// The class of avatars.
pub const AVATAR_CLASS: ClassId = ClassId(0);

/// The shared world.
pub struct World {
    config: WorldConfig,
    info: WorldInfo,
    anchor: DVec3,
    spec: WorldSpec,
    classes: Vec<Class>,
    policy: Box<dyn Policy>,
    audit: Option<Box<dyn Audit>>,
    gate: Box<dyn Gate>,
    /// Index = object id. Ids of avatars that left are free, and used again with a later issue number.
    objects: Vec<Object>,
    free: Vec<ObjectId>,
    spawned: usize,
    avatars_alive: usize,
    announcements: Announcements,
    events: Events,
    sessions: BTreeMap<SessionId, Session>,
    next_session: u32,
    /// Slots of the holders' bit sets, reused.
    free_slots: Vec<usize>,
    slots: usize,
    out: VecDeque<(SessionId, Transmit)>,
    /// Sessions whose datagrams are to be built.
    awake: VecDeque<SessionId>,
    tick: WorldTime,
    next_tick: WorldTime,
    stats: WorldStats,
    validity: Validity,
    /// What is left out by now.
    running: Running,
    /// Scratch of [`World::tick`].
    told: Vec<ObjectId>,
    /// Scratch of [`Session::mark_changes`].
    marked: Vec<ObjectId>,
    /// Scratch of [`Session::build`].
    records: Vec<u8>,
}

impl World {
    /// A world whose first tick is at `now`.
    ///
    /// # Errors
    /// If the specification contradicts itself; names the entry, the value and the remedy.
    pub fn new(
        config: WorldConfig,
        spec: WorldSpec,
        info: WorldInfo,
        anchor: DVec3,
        mut policy: Box<dyn Policy>,
        now: WorldTime,
    ) -> Result<World, WorldError> {
        config.check()?;
        if info.name.len() > NAME_BYTES_MAX {
            return Err(WorldError::Name { name: info.name });
        }
        let classes = classes(&config, &spec)?;
        policy.start(&classes);
        let mut objects = Vec::with_capacity(spec.objects.len());
        let paths = paths_of(&spec)?;
        for ((index, entry), path) in spec.objects.iter().enumerate().zip(paths) {
            let class = classes
                .iter()
                .position(|class| class.name == entry.class)
                .ok_or_else(|| WorldError::UnknownClass { object: entry.name.clone(), class: entry.class.clone() })?;
            let out_of_range = |error| WorldError::Position { object: entry.name.clone(), error };
            // Where its path has it now: it could not get there from its place of rest at once.
            let start = path.as_ref().map_or(DVec3::from_array(entry.position), |path| path.pose_at(now.seconds()).0);
            let position = Position::from_metres(start - anchor).map_err(out_of_range)?;
            let id = ObjectId(u32::try_from(index).unwrap_or(u32::MAX));
            if id > ObjectId::MAX {
                return Err(WorldError::TooManyObjects { objects: spec.objects.len() });
            }
            let mut object = Object::new(entry.name.clone(), ClassId(class as u16), position, now);
            if let Some(path) = &path {
                // Where it would leave the world it could not be told of, and would seem to stand.
                let (middle, reach) = path.ball();
                for corner in [middle - DVec3::splat(reach), middle + DVec3::splat(reach)] {
                    Position::from_metres(corner - anchor).map_err(out_of_range)?;
                }
            }
            object.node = entry.node.clone().unwrap_or_else(|| entry.name.clone());
            object.orientation = Orientation::from_yaw(entry.heading);
            object.path = path;
            object.takeable = entry.takeable;
            objects.push(object);
        }
        let mut world = World {
            config,
            info,
            anchor,
            spec,
            classes,
            policy,
            audit: None,
            gate: Box::new(OpenGate::default()),
            objects,
            free: Vec::new(),
            spawned: 0,
            avatars_alive: 0,
            announcements: Announcements::default(),
            events: Events::default(),
            sessions: BTreeMap::new(),
            next_session: 1,
            free_slots: Vec::new(),
            slots: 0,
            out: VecDeque::new(),
            awake: VecDeque::new(),
            marked: Vec::new(),
            tick: now,
            next_tick: now,
            stats: WorldStats::default(),
            validity: Validity::default(),
            running: Running::default(),
            told: Vec::new(),
            records: Vec::new(),
        };
        world.tick(now);
        // What it begins with is no revision.
        world.running.take_revised();
        Ok(world)
    }

    /// Checks from now on that clients are told no place that they are not entitled to. Only where clients ask: a policy
    /// that decides at the server answers for itself.
    pub fn set_audit(&mut self, mut audit: Box<dyn Audit>) {
        audit.begin_tick(&self.objects);
        self.audit = Some(audit);
    }

    /// Asks this gate from now on who may come in. Without one everybody may, as an actor.
    pub fn set_gate(&mut self, gate: Box<dyn Gate>) {
        self.gate = gate;
    }

    /// The greatest datagram that the path to this client carries, in bytes.
    pub fn handle_datagram_limit(&mut self, id: SessionId, limit: usize) {
        if limit < DATAGRAM_LIMIT_LEAST {
            let reason =
                format!("datagrams of {limit} bytes carry nothing; at least {DATAGRAM_LIMIT_LEAST} are needed");
            return self.refuse(id, Refusal::Protocol, &reason);
        }
        if let Some(session) = self.sessions.get_mut(&id) {
            session.datagram_limit = limit;
        }
    }

    /// One control message, without its length prefix. What makes no sense closes the connection.
    pub fn handle_control(&mut self, id: SessionId, bytes: &[u8], now: WorldTime) {
        let Some(session) = self.sessions.get_mut(&id) else { return };
        if session.is_refused {
            return;
        }
        let live = matches!(session.phase, Phase::Live { .. });
        let (limits, size) = (&self.config.limits, session.size(self.objects.len()));
        let wanted = [(Limited::Control, 1), (Limited::Bytes, bytes.len())];
        if !session.meter.admit(&wanted, limits, size, now, &mut self.stats.limited) {
            return self.send_away_if_spent(id);
        }
        let message = codec::decode_client_control(bytes);
        if let Some(kind) = message.as_ref().ok().and_then(Limited::of_control)
            && !session.meter.admit(&[(kind, 1)], limits, size, now, &mut self.stats.limited)
        {
            return self.send_away_if_spent(id);
        }
        match message {
            Err(error) => {
                self.stats.rejected_control += 1;
                self.refuse(id, Refusal::Protocol, &format!("control message: {error}"));
            }
            Ok(ClientControl::Hello { version, token, resolution, interest, role, name, resume }) if !live => {
                self.admit(id, Hello { version, token, resolution, interest, role, name, resume }, now);
            }
            Ok(ClientControl::WorldWanted) if live => self.out.push_back((id, Transmit::WorldBytes)),
            Ok(ClientControl::Place { object, position, present }) if live => self.place(id, object, position, present),
            Ok(ClientControl::Take { object }) if live => self.take(id, object),
            Ok(ClientControl::LetGo { object }) if live => self.let_go(id, object),
            Ok(ClientControl::Payload { object, bytes }) if live => self.pass_payload(id, object, bytes),
            Ok(ClientControl::Command(command)) if live => self.handle_command(id, command),
            Ok(ClientControl::Goodbye) => {
                // Who leaves on purpose does not come back.
                if let Some(session) = self.sessions.get_mut(&id) {
                    session.is_refused = true;
                }
                self.out.push_back((id, Transmit::Close("goodbye".into())));
            }
            Ok(_) => {
                self.stats.rejected_control += 1;
                let reason = if live { "hello was said already" } else { "the first message must be hello" };
                self.refuse(id, Refusal::Protocol, reason);
            }
        }
    }

    /// The control stream can't be cut into messages: it is of no more use, and the connection closes.
    pub fn handle_broken_control(&mut self, id: SessionId, error: &codec::DecodeError) {
        self.stats.rejected_control += 1;
        self.refuse(id, Refusal::Protocol, &format!("control stream: {error}"));
    }

    /// Whether this connection has said hello and was let in.
    pub fn is_admitted(&self, id: SessionId) -> bool {
        self.sessions.get(&id).is_some_and(|session| matches!(session.phase, Phase::Live { .. }))
    }

    /// Whether this client is sent away because it went on and on beyond its limits.
    pub fn is_spent(&self, id: SessionId) -> bool {
        self.sessions.get(&id).is_some_and(|session| session.meter.is_spent)
    }

    /// Tells everybody that the server ends, and why.
    pub fn shut_down(&mut self, reason: &str) {
        let ids: Vec<SessionId> = self.sessions.keys().copied().collect();
        for id in ids {
            self.refuse(id, Refusal::ShuttingDown, reason);
        }
    }

    /// One datagram of a client. Requests in it are answered at once, or with the next tick.
    pub fn handle_datagram(&mut self, id: SessionId, bytes: &[u8], now: WorldTime) {
        self.stats.datagrams_in += 1;
        self.stats.datagram_bytes_in += bytes.len() as u64;
        let Some(session) = self.sessions.get_mut(&id).filter(|session| !session.is_refused) else { return };
        let (limits, size) = (&self.config.limits, session.size(self.objects.len()));
        let wanted = [(Limited::Datagrams, 1), (Limited::Bytes, bytes.len())];
        if !session.meter.admit(&wanted, limits, size, now, &mut self.stats.limited) {
            return self.send_away_if_spent(id);
        }
        let Phase::Live { slot, watches } = session.phase else {
            self.stats.rejected_datagrams += 1;
            return;
        };
        let (header, records) = match codec::decode_client_datagram(bytes) {
            Ok(datagram) => datagram,
            Err(_) => {
                self.stats.rejected_datagrams += 1;
                return;
            }
        };
        let due = session.states_due();
        if !session.receive(&header.link, LocalTime::from_micros(now.micros())) {
            self.stats.stale_datagrams += 1;
            return;
        }
        // Who says that everything got lost, again and again, is told again no sooner than at the next tick.
        let lost = session.states_due().saturating_sub(due);
        session.waits_for_tick |=
            lost > 0 && !session.meter.take((Limited::Resends, lost), limits, size, now, &mut self.stats.limited);
        let mut over = false;
        session.heard_at = now;
        // It has its welcome.
        session.resume_before = None;
        session.owes_ack = true;
        let seq = header.link.seq;
        let mut answer = false;
        for record in records {
            if !session.meter.take((Limited::of_record(&record), 1), limits, size, now, &mut self.stats.limited) {
                over = true;
                continue;
            }
            self.stats.messages_in.count_client(&record);
            match record {
                ClientRecord::Pose { object, position, orientation } => {
                    let entry = self.objects.get_mut(object.index());
                    match entry.filter(|entry| entry.owner == Some(id)) {
                        Some(entry) if seq >= entry.wanted_seq => {
                            entry.wanted_seq = seq;
                            entry.wanted = Some((position, orientation));
                        }
                        Some(_) => {} // overtaken by a newer one
                        None => self.stats.forbidden += 1,
                    }
                }
                ClientRecord::Request { object, .. } | ClientRecord::Release { object, .. }
                    if !self.objects.get(object.index()).is_some_and(|entry| entry.alive)
                        || !watches
                        || !self.policy.tracking()
                        || session.avatars.contains(&object) =>
                {
                    self.stats.forbidden += 1;
                }
                ClientRecord::Request { object, .. } | ClientRecord::Release { object, .. }
                    if session.is_overtaken(object, seq) => {}
                ClientRecord::Request { object, want, .. } => {
                    answer = true;
                    self.validity.note(id, &record, speed_of(&self.objects, &self.classes, object), now);
                    match want {
                        Want::State => session.subscribe(object, seq),
                        Want::Place => session.tell_once(object, seq),
                        Want::Bound => {
                            session.unsubscribe(object, seq);
                            session.bounds_due.insert(object);
                        }
                    }
                }
                ClientRecord::Release { object, want_bound } => {
                    self.validity.note(id, &record, speed_of(&self.objects, &self.classes, object), now);
                    session.unsubscribe(object, seq);
                    if want_bound {
                        answer = true;
                        session.bounds_due.insert(object);
                    }
                }
                ClientRecord::Eye { position, orientation } => {
                    if seq >= session.own_eye.map_or(0, |eye| eye.seq) {
                        session.own_eye = Some(OwnEye { position, yaw: orientation.yaw(), seq });
                    }
                }
                ClientRecord::ViolationAck { object, issue } => {
                    if session.violations.get(&object).is_some_and(|violation| violation.issue <= issue) {
                        session.violations.remove(&object);
                        if let Some(entry) = self.objects.get_mut(object.index()) {
                            // Unless something has been told since, it holds nothing of the old issue any more.
                            if !session.is_subscribed(object) && !entry.told_since_violation.contains(slot) {
                                entry.forget_holder(slot);
                            }
                        }
                    }
                }
            }
        }
        if over {
            session.meter.bear(limits, now);
        }
        if answer && !session.waits_for_tick && self.config.answers == Answers::Arrival {
            self.awake.push_back(id);
        }
        self.send_away_if_spent(id);
    }

    /// A client that goes on and on beyond its limits is of no more use to anybody.
    fn send_away_if_spent(&mut self, id: SessionId) {
        if self.sessions.get(&id).is_some_and(|session| session.meter.is_spent && !session.is_refused) {
            self.stats.busy += 1;
            let reason = "far more was asked for than the server's limits allow; come back later, and ask for less";
            self.refuse(id, Refusal::Busy, reason);
        }
    }

    fn place(&mut self, id: SessionId, object: ObjectId, position: Position, present: bool) {
        // Avatars only: a thing that is held moves as its class may.
        let is_own = self.sessions.get(&id).is_some_and(|session| session.avatars.contains(&object));
        match self.objects.get_mut(object.index()).filter(|_| is_own) {
            Some(entry) => {
                entry.placed = Some((position, present));
                entry.wanted = None;
            }
            None => self.stats.forbidden += 1,
        }
    }

    /// Puts an object of the world somewhere at the next tick, breaking its bound: for embedding applications.
    /// Returns whether there is such an object.
    pub fn teleport(&mut self, object: ObjectId, position: Position) -> bool {
        match self.objects.get_mut(object.index()).filter(|entry| entry.alive) {
            Some(entry) => {
                entry.placed = Some((position, true));
                true
            }
            None => false,
        }
    }

    /// When [`World::tick`] is due.
    pub fn poll_timeout(&self) -> WorldTime {
        self.next_tick
    }

    /// Commits what was wanted since the last tick, and wakes every client that has to hear of it. A late call skips
    /// the ticks that were missed.
    pub fn tick(&mut self, now: WorldTime) {
        if now < self.next_tick {
            return;
        }
        let period = self.config.tick.as_micros() as i64;
        let missed = now.micros().saturating_sub(self.next_tick.micros()) / period;
        self.stats.ticks += 1;
        self.stats.ticks_missed += missed as u64;
        let tick = self.next_tick.offset_micros(missed.saturating_mul(period));
        let elapsed = tick.since(self.tick).as_secs_f64();
        self.tick = tick;
        self.next_tick = tick.offset_micros(period);
        for index in 0..self.objects.len() {
            let object = &mut self.objects[index];
            if !object.alive {
                continue;
            }
            let class = &self.classes[usize::from(object.class.0)];
            let outcome = object.commit(tick, elapsed, class, self.anchor);
            self.stats.poses_clamped += u64::from(outcome.clamped);
            self.stats.turns_clamped += u64::from(outcome.turn_clamped);
            if outcome.violated {
                self.stats.violations += 1;
                self.spread_violation(ObjectId(index as u32), outcome.entered_or_left);
            }
        }
        self.heed_gate(now);
        self.end_graces();
        self.announce();
        self.revise_plan();
        if let Some(audit) = &mut self.audit {
            audit.begin_tick(&self.objects);
        }
        // With nothing to see besides one's own avatar nobody is told of anything, and nothing can be due.
        let tells = self.tells();
        if tells {
            self.retell();
        }
        let quiet = self.config.lease;
        for (&id, session) in &mut self.sessions {
            let (Phase::Live { .. }, None) = (&session.phase, session.away_since) else { continue };
            // A client that has not been heard of for a lease gets nothing until it is.
            if now.since(session.heard_at) <= quiet {
                if let Some(bytes_per_second) = self.config.bytes_per_second {
                    session.refill(bytes_per_second, elapsed, self.config.tick, &mut self.stats);
                }
                debug_assert!(tells || session.is_told_nothing(), "what it is told of would be left out");
                if !std::mem::replace(&mut session.is_to_mark, true) {
                    self.awake.push_back(id);
                }
            }
        }
    }

    /// Makes due what a client has to hear since the last tick, unless that was done. Says whether it has to hear anything.
    fn mark(&mut self, id: SessionId, now: WorldTime) -> bool {
        let tells = self.tells();
        let Some(session) = self.sessions.get_mut(&id) else { return false };
        if std::mem::take(&mut session.is_to_mark) {
            if tells {
                let reckoning = self.config.dead_reckoning_px;
                let reckoning = reckoning.and_then(|px| Some((px, session.lens(id, &self.objects, &self.classes)?)));
                let (tick, blur, classes) = (self.tick, self.config.blur, &self.classes);
                let is_spent = |object: &Object, known: &Known| {
                    let motion = classes[usize::from(object.class.0)].motion;
                    known.is_spent(object, tick, motion, blur)
                };
                session.mark_changes(&self.objects, tick, reckoning, is_spent, &mut self.marked);
            }
            session.expire(LocalTime::from_micros(now.max(self.tick).micros()));
        }
        session.has_something()
    }

    /// Policies that decide at the server say whom each client is told about.
    fn retell(&mut self) {
        // Without anybody who looks there is nobody to sort objects for.
        if self.policy.tracking() || self.watching() == 0 {
            return;
        }
        let avatar_class = &self.classes[usize::from(AVATAR_CLASS.0)];
        self.policy.begin_tick(&self.objects);
        for (&id, session) in &mut self.sessions {
            let Some(watcher) = session.watcher(id, &self.objects, avatar_class) else { continue };
            self.told.clear();
            self.policy.interest(&self.objects, &watcher, &mut self.told);
            session.tell_exactly(&self.told);
        }
    }

    /// Counts what the plan is made from, and leaves out or puts back what that decides about.
    fn revise_plan(&mut self) {
        let (now, watching, has_others) = (self.tick, self.watching(), self.has_others());
        if self.running.is_recount_due(now) {
            let counts = self.plan_counts();
            self.running.recount(&counts, now);
        }
        self.running.count(watching, has_others, now);
        self.policy.share(self.config.plan.runs(Stage::Sharing, self.running.shares()));
    }

    /// Whether there is anything in the world that somebody could see besides their own avatar.
    fn has_others(&self) -> bool {
        let is_alone = self.sessions.len() <= 1 && self.avatars_alive <= 1;
        !self.spec.objects.is_empty() || self.avatars_alive > 0 && !is_alone
    }

    fn tells(&self) -> bool {
        self.running.tells() || self.config.plan.asked(Stage::States) == Some(true)
    }

    /// Lines of the plan that have been revised since the last call, if any: something was left out or put back, or
    /// counters changed that decide about it. [`crate::plan::plan`] says the whole plan.
    pub fn poll_plan(&mut self) -> Option<Plan> {
        let stages = self.running.take_revised();
        (!stages.is_empty()).then(|| Plan { lines: plan::lines(self, &stages) })
    }

    /// Announces that `object` broke its bound to everyone who may hold one; entering and leaving the world to all.
    fn spread_violation(&mut self, object: ObjectId, to_all: bool) {
        let entry = &mut self.objects[object.index()];
        entry.told_since_violation.clear();
        for session in self.sessions.values_mut() {
            let Phase::Live { slot, watches: true } = session.phase else { continue };
            // Who was told of it is not told of its return, wherever that is, unless it asks.
            if !entry.present && self.policy.tracking() {
                session.stop_telling(object);
            }
            if to_all || entry.holders.contains(slot) {
                session.violate(object, entry.issue, self.tick);
            }
        }
    }

    /// A fresh bound of a present object, the same for all who ask within a tick.
    fn wire_bound(&mut self, id: ObjectId) -> Option<WireTbv> {
        let object = &mut self.objects[id.index()];
        let motion = self.classes[usize::from(object.class.0)].motion;
        let tbv = object.fresh_tbv(self.tick, motion, &self.config, self.anchor);
        WireTbv::new(&tbv, self.tick)
    }

    /// The next thing to send. Datagrams are built here, late, from the newest state.
    pub fn poll_transmit(&mut self, now: WorldTime) -> Option<(SessionId, Transmit)> {
        self.poll_transmit_where(now, |_| usize::MAX)
    }

    /// The same, but builds no larger datagram for a client than `room` says, in bytes, and none where that is too little:
    /// its path would not carry it in a tick, or has not carried older ones yet ([`room`]). What is due stays so until the
    /// next tick, and is then told as it is then: no queue fills with the past.
    pub fn poll_transmit_where(
        &mut self,
        now: WorldTime,
        mut room: impl FnMut(SessionId) -> usize,
    ) -> Option<(SessionId, Transmit)> {
        if let Some(control) = self.out.pop_front() {
            if matches!(control.1, Transmit::Control(_)) {
                self.stats.control_out += 1;
            }
            return Some(control);
        }
        while let Some(&id) = self.awake.front() {
            if !self.mark(id, now) {
                self.awake.pop_front();
                continue;
            }
            let room = room(id);
            let is_free = room >= DATAGRAM_LIMIT_LEAST;
            self.stats.held_back += u64::from(!is_free);
            if is_free && let Some(datagram) = self.build_datagram(id, room, now) {
                self.stats.datagrams_out += 1;
                self.stats.datagram_bytes_out += datagram.len() as u64;
                // Most have said all: to find that out by building once more would take its path's lock once more.
                if self.sessions.get(&id).is_none_or(|session| !session.has_something()) {
                    self.awake.pop_front();
                }
                return Some((id, Transmit::Datagram(datagram)));
            }
            self.awake.pop_front();
        }
        None
    }

    fn build_datagram(&mut self, id: SessionId, room: usize, now: WorldTime) -> Option<Vec<u8>> {
        let session = self.sessions.get_mut(&id)?;
        let Phase::Live { slot, .. } = session.phase else { return None };
        let (tick, config, anchor) = (self.tick, &self.config, self.anchor);
        let classes = &self.classes;
        let avatar_class = &classes[usize::from(AVATAR_CLASS.0)];
        // Asked for only where they decide something: a turn's angle is dear.
        let watcher = self.audit.as_ref().and_then(|_| session.watcher(id, &self.objects, avatar_class));
        let round_trip = session.round_trip_max();
        let mut audit = self.audit.as_mut().filter(|_| self.policy.tracking());
        let entitled = |objects: &[Object], object: ObjectId| match (&mut audit, &watcher) {
            (Some(audit), Some(watcher)) => {
                let region = eye_region(config, avatar_class.motion, round_trip);
                audit.entitled(objects, watcher, region, object)
            }
            _ => true,
        };
        let lens = config.bytes_per_second.and_then(|_| session.lens(id, &self.objects, classes));
        let moment = Moment { now, tick, slot, room, reckons: config.dead_reckoning_px.is_some(), lens };
        session.build(moment, &mut self.objects, &mut self.stats, &mut self.records, entitled, |object, known| {
            let motion = classes[usize::from(object.class.0)].motion;
            let fresh = object.fresh_tbv(tick, motion, config, anchor);
            let tbv = known.map_or(fresh, |known| known.answer(fresh, motion, config.blur));
            debug_assert!(tbv.contains(object.position.metres(), tick), "a bound must contain its object");
            WireTbv::new(&tbv, tick)
        })
    }

    /// World time of the newest committed state.
    pub fn committed_at(&self) -> WorldTime {
        self.tick
    }

    /// Every object, by id; those with `alive` false are free ids.
    pub fn objects(&self) -> &[Object] {
        &self.objects
    }

    /// Kinds of objects.
    pub fn classes(&self) -> &[Class] {
        &self.classes
    }

    /// Counters since the start.
    pub fn stats(&self) -> &WorldStats {
        &self.stats
    }

    /// For how long clients make do with a bound.
    pub fn validity(&self) -> &Validity {
        &self.validity
    }

    /// How long an answer waits at most: the server's part of the promise's bound (DESIGN §3.3), its work apart.
    pub fn answer_wait(&self) -> Duration {
        self.config.answer_wait()
    }

    /// Whether nothing comes of a datagram before the next tick, so that a driver may hand it in just before that, with the time
    /// when it arrived.
    pub fn answers_with_tick(&self) -> bool {
        self.config.answers == Answers::Tick
    }

    /// World time between ticks.
    pub fn tick_period(&self) -> Duration {
        self.config.tick
    }

    /// Number of connections, admitted or not.
    pub fn sessions(&self) -> usize {
        self.sessions.len()
    }

    /// Number of avatars in the world, or waiting to enter it.
    pub fn avatars(&self) -> usize {
        self.avatars_alive
    }
}

/// Radius of the ball around a watcher's committed eye in which its own eye may be when it draws what is told now, metres.
///
/// Its pose was `one way + wait for the tick` old when it was committed, and the answer takes another way and a frame; a round
/// trip each covers jitter, and a frame is taken to be as long as a tick, since clients don't say.
fn eye_region(config: &WorldConfig, motion: MotionBound, round_trip: Option<Duration>) -> f64 {
    // Of a client that has not been measured yet the most is believed.
    let Some(round_trip) = round_trip else { return config.audit_radius_max };
    motion.reach((2 * round_trip + config.answer_wait() + 3 * config.tick).as_secs_f64()).min(config.audit_radius_max)
}

/// The greatest speed of an object's class, m/s.
fn speed_of(objects: &[Object], classes: &[Class], object: ObjectId) -> f64 {
    objects.get(object.index()).map_or(0.0, |object| classes[usize::from(object.class.0)].motion.speed_max)
}

/// How many bytes may be handed to a transport now so that they leave within a tick: what its congestion window lets go in that
/// time, less what waits there already. A small datagram is let through in any case, or nothing ever would be; but none where
/// something has waited for half a tick.
pub fn room(path: PathState, tick: Duration) -> usize {
    if path.waited.is_some_and(|waited| waited >= tick / 2) {
        return 0;
    }
    let ticks = tick.as_secs_f64() / path.round_trip.as_secs_f64().max(1e-6);
    // More than fits saturates.
    let leaves = (path.window_bytes as f64 * ticks) as usize;
    leaves.max(DATAGRAM_LIMIT_LEAST).saturating_sub(path.queued_bytes)
}

/// What a transport knows of the path to a client.
#[derive(Clone, Copy, Debug)]
pub struct PathState {
    /// For how long the oldest datagram has waited to leave; `None` if none waits.
    pub waited: Option<Duration>,
    /// Bytes of datagrams that wait.
    pub queued_bytes: usize,
    /// The congestion window, bytes.
    pub window_bytes: u64,
    /// Round-trip time as the transport measures it.
    pub round_trip: Duration,
}

fn classes(config: &WorldConfig, spec: &WorldSpec) -> Result<Vec<Class>, WorldError> {
    let avatar = spec.avatar;
    let mut classes = vec![Class {
        name: "avatar".into(),
        motion: MotionBound {
            speed_max: avatar.speed_max,
            slack: avatar.speed_max * config.jitter.as_secs_f64() + QUANTUM_METRES,
        },
        extent: Extent { radius: avatar.radius, bottom: 0.0, top: avatar.height },
        eye_height: avatar.eye_height,
        turn_max: Some(avatar.turn_max).filter(|&turn| turn != f64::INFINITY),
    }];
    for class in &spec.classes {
        if classes.iter().any(|known| known.name == class.name) {
            return Err(WorldError::DuplicateClass { class: class.name.clone() });
        }
        classes.push(Class {
            name: class.name.clone(),
            // Paths are followed exactly; both ends of a step are snapped to the grid. What people move has no room for the
            // jitter of their poses, and comes after them instead.
            motion: MotionBound { speed_max: class.speed_max, slack: 2.0 * QUANTUM_METRES },
            extent: Extent { radius: class.radius, bottom: class.bottom, top: class.top },
            eye_height: 0.0,
            // What follows a path turns with it.
            turn_max: None,
        });
    }
    for class in &classes {
        let Class { name, motion, extent, eye_height, turn_max } = class;
        let turn_max = turn_max.unwrap_or_default();
        for (what, value, legal) in [
            ("speed_max", motion.speed_max, (0.0..=1e6).contains(&motion.speed_max)),
            ("radius", extent.radius, (0.0..=1e6).contains(&extent.radius)),
            ("bottom", extent.bottom, (-1e6..=1e6).contains(&extent.bottom)),
            ("top", extent.top, (extent.bottom..=1e6).contains(&extent.top)),
            ("eye_height", *eye_height, (0.0..=1e6).contains(eye_height)),
            ("turn_max", turn_max, (0.0..=1e6).contains(&turn_max)),
        ] {
            if !legal {
                return Err(WorldError::ClassValue { class: name.clone(), what, value });
            }
        }
    }
    for (index, spawn) in spec.spawns.iter().enumerate() {
        if !spawn.position.iter().all(|x| x.abs() < eyeline_protocol::METRES_MAX) || !spawn.heading.is_finite() {
            return Err(WorldError::Spawn { index, position: spawn.position });
        }
    }
    let names = spec.objects.iter().flat_map(|object| [Some(&object.name), object.node.as_ref()]).flatten();
    if let Some(name) = names.chain(classes.iter().map(|class| &class.name)).find(|name| name.len() > NAME_BYTES_MAX) {
        return Err(WorldError::Name { name: name.clone() });
    }
    if classes.len() > CLASSES_MAX {
        return Err(WorldError::TooManyClasses { classes: classes.len() });
    }
    Ok(classes)
}

#[cfg(test)]
mod audit_tests;

#[cfg(test)]
mod churn_tests;

#[cfg(test)]
mod limits_tests;

#[cfg(test)]
mod people_tests;

#[cfg(test)]
mod push_tests;

#[cfg(test)]
mod tests {
    use eyeline_protocol::codec::{DatagramWriter, encode_control};
    use eyeline_protocol::{ClientHeader, Interest, LinkHeader, Reason, Role, VERSION};
    use glam::DQuat;

    use super::*;
    use crate::policy::{Broadcast, Visible};

    pub(super) fn world(policy: Box<dyn Policy>) -> World {
        world_of(WorldConfig::default(), policy)
    }

    pub(super) fn world_of(config: WorldConfig, policy: Box<dyn Policy>) -> World {
        let info = WorldInfo { name: "test".into(), hash: [0; 32], size_bytes: 0, two_sided: false };
        let spec = WorldSpec::default();
        World::new(config, spec, info, DVec3::ZERO, policy, WorldTime::ZERO).unwrap()
    }

    pub(super) fn join(world: &mut World, role: Role) -> SessionId {
        let id = world.connect(WorldTime::ZERO);
        let hello = ClientControl::Hello {
            version: VERSION,
            token: Vec::new(),
            resolution: (320, 240),
            interest: Interest::Around,
            role,
            name: String::new(),
            resume: None,
        };
        world.handle_control(id, &encode_control(&hello)[4..], WorldTime::ZERO);
        id
    }

    /// What is to be sent to a client; more than a thousand would be without end.
    pub(super) fn drain(world: &mut World, to: SessionId) -> Vec<Transmit> {
        let mut sent = Vec::new();
        for _ in 0..1000 {
            match world.poll_transmit(WorldTime::ZERO) {
                Some((id, transmit)) if id == to => sent.push(transmit),
                Some(_) => {}
                None => return sent,
            }
        }
        panic!("the world has no end of things to say");
    }

    pub(super) fn datagram(seq: u32, records: &[ClientRecord]) -> Vec<u8> {
        let link = LinkHeader { seq, ..LinkHeader::default() };
        let mut writer = DatagramWriter::new(&ClientHeader { link, frame: WorldTime::ZERO }, 1200);
        assert!(records.iter().all(|record| writer.push(record)));
        writer.finish()
    }

    #[test]
    fn a_peer_whose_datagrams_carry_nothing_is_refused_and_does_not_stop_the_world() {
        let mut world = world(Box::new(Broadcast));
        let _other = join(&mut world, Role::Avatar);
        let id = join(&mut world, Role::Avatar);
        world.handle_datagram_limit(id, 11);
        world.tick(WorldTime::from_micros(50_000));
        let sent = drain(&mut world, id);
        assert!(sent.iter().any(|transmit| matches!(transmit, Transmit::Close(_))), "{sent:?}");
    }

    #[test]
    fn an_actor_of_nobody_is_refused() {
        let mut world = world(Box::new(Visible));
        let id = join(&mut world, Role::Actor { avatars: 0 });
        assert!(drain(&mut world, id).iter().any(|transmit| matches!(transmit, Transmit::Close(_))));
        assert_eq!(world.stats().refused, 1);
    }

    #[test]
    fn an_actor_hears_nothing_of_others_whatever_it_asks() {
        let mut world = world(Box::new(Visible));
        let _somebody = join(&mut world, Role::Avatar);
        let actor = join(&mut world, Role::Actor { avatars: 1 });
        drain(&mut world, actor);
        let object = ObjectId(0);
        let records = [
            ClientRecord::Request { object, want: Want::State, reason: Reason::Exposed },
            ClientRecord::Release { object, want_bound: true },
        ];
        world.handle_datagram(actor, &datagram(1, &records), WorldTime::ZERO);
        let sent = drain(&mut world, actor);
        assert!(sent.is_empty(), "{sent:?}");
        assert_eq!(world.stats().forbidden, 2);
    }

    #[test]
    fn an_avatar_cannot_lie_down_out_of_its_extent() {
        let mut world = world(Box::new(Visible));
        let id = join(&mut world, Role::Avatar);
        let object = ObjectId(0);
        let position = world.objects()[0].position;
        let orientation = Orientation::from_quat(DQuat::from_rotation_x(1.5) * DQuat::from_rotation_y(0.7));
        world.handle_datagram(
            id,
            &datagram(1, &[ClientRecord::Pose { object, position, orientation }]),
            WorldTime::ZERO,
        );
        world.tick(WorldTime::from_micros(50_000));
        let up = world.objects()[0].orientation.quat() * DVec3::Y;
        assert!(up.y > 0.9999, "{up}");
    }
}
