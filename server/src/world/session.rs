//! One client as the server sees it: what it is told of, what it has acknowledged, what is due.
//!
//! Nothing is queued but ids: records are built when a datagram is, from the newest committed state, so no queue can
//! hold a stale pose and each is bounded by the number of objects.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use eyeline_protocol::codec::DatagramWriter;
use eyeline_protocol::{
    Arrival, Class, ClientId, EYE_REACH, Interest, Issue, Link, LinkHeader, LocalTime, ObjectId, Position, Prediction,
    Rank, Role, ServerHeader, ServerRecord, Velocity, WireTbv, WorldTime,
};
use glam::DVec3;
use rustc_hash::{FxHashMap, FxHashSet};

use super::admission::RosterMark;
use super::blur::{Known, Places};
use super::due::Due;
use super::lens::Lens;
use super::limits::{Meter, Size};
use super::{AVATAR_CLASS, Object, SessionId, WorldStats};
use crate::gate::{Caller, Permit};
use crate::policy::Watcher;

/// How far a connection has got.
pub(super) enum Phase {
    /// Connected, no hello yet.
    Greeting,
    /// Admitted.
    Live {
        /// Its bit in the holders' sets.
        slot: usize,
        /// Whether it looks at the world.
        watches: bool,
    },
}

impl Phase {
    /// Its bit in the holders' sets, once it is admitted.
    pub fn slot(&self) -> Option<usize> {
        match *self {
            Phase::Greeting => None,
            Phase::Live { slot, .. } => Some(slot),
        }
    }
}

/// Where a client says that its own eye is.
#[derive(Clone, Copy)]
pub(super) struct OwnEye {
    pub position: Position,
    /// Turn about +Y, radians.
    pub yaw: f64,
    /// Number of the datagram that said it.
    pub seq: u32,
}

/// What a client is told about one object.
struct Subscription {
    /// What it was told exactly since it asked first. It is among the object's holders of that issue then.
    told: Option<Known>,
    /// Whether the state of `told` is under way or arrived.
    is_sent: bool,
    /// Whether updates are pushed.
    active: bool,
    /// Whether a bound was told in place of the state that is due, since the client is not entitled to it.
    withheld: bool,
    /// Number of the datagram that asked last: what an older one says has been overtaken.
    asked_seq: u32,
}

/// A client that is in a crowd has hundreds of them, and each is looked at once a tick.
const _: () = assert!(size_of::<(ObjectId, Subscription)>() <= 36);

/// A state that a client may hold.
struct Held {
    prediction: Prediction,
    issue: Issue,
}

impl Subscription {
    fn new(active: bool, asked_seq: u32) -> Subscription {
        Subscription { told: None, is_sent: false, active, withheld: false, asked_seq }
    }

    /// It is asked for anew, and what was told stays known.
    fn renew(&mut self, active: bool, asked_seq: u32) {
        *self = Subscription { told: self.told, ..Subscription::new(active, asked_seq) };
    }

    /// Tick of the state that was sent last; `WorldTime::MIN` if none is under way or arrived.
    fn sent(&self) -> WorldTime {
        self.told.as_ref().filter(|_| self.is_sent).map_or(WorldTime::MIN, |told| told.at)
    }
}

/// What a client may draw an object from, where states say how they go on: the state that it acknowledged last, and those that are
/// under way. Ascending.
#[derive(Default)]
struct Drawn(Vec<Held>);

impl Drawn {
    /// One more state is under way. Of most objects a client holds one, and vectors begin with room for four.
    fn hold(&mut self, held: Held) {
        if self.0.len() == self.0.capacity() {
            self.0.reserve_exact(1 + self.0.len() / 2);
        }
        self.0.push(held);
    }

    /// Whether what the client may draw is wrong by more than `pixels`.
    fn is_wrong(&self, object: &Object, tick: WorldTime, pixels: f64, lens: &Lens<'_>) -> bool {
        // One state that is void, or none that may arrive, is as good as nothing.
        self.0.is_empty()
            || self.0.iter().any(|held| {
                let stands = held.prediction.velocity == Velocity::ZERO && object.changed_at <= held.prediction.tick;
                held.issue != object.issue || !stands && lens.error_px(&held.prediction, object, tick) > pixels
            })
    }
}

/// What a datagram is built from, besides the objects.
#[derive(Clone, Copy)]
pub(super) struct Moment<'a> {
    pub now: WorldTime,
    pub tick: WorldTime,
    /// The client's bit in the holders' sets.
    pub slot: usize,
    /// Most bytes that the datagram may have.
    pub room: usize,
    /// Whether states say how they go on.
    pub reckons: bool,
    /// What weighs states against each other where a byte cap binds.
    pub lens: Option<Lens<'a>>,
}

/// A violation that the client has not acknowledged.
pub(super) struct Violation {
    pub issue: Issue,
    at: WorldTime,
    sent_at: Option<WorldTime>,
}

/// In place of a state's version: the object was withdrawn.
const WITHDRAWN: WorldTime = WorldTime::MAX;

/// In place of a state's version: a bound was told since the state was withheld.
const WITHHELD: WorldTime = WorldTime::MIN;

/// The state of a datagram that was sent: which objects' states it carried.
type Carried = Vec<(ObjectId, WorldTime)>;

pub(super) struct Session {
    pub phase: Phase,
    /// Its number for people, which it keeps when it comes back.
    pub client: ClientId,
    pub caller: Caller,
    pub permit: Permit,
    pub role: Role,
    /// What it calls itself.
    pub name: String,
    pub came_at: WorldTime,
    /// Since when its connection has been lost, if it is.
    pub away_since: Option<WorldTime>,
    pub roster: RosterMark,
    /// The token that it came back with last, until it is heard to have the new one's welcome.
    pub resume_before: Option<[u8; 16]>,
    /// Things of the world that it moves.
    pub things: Vec<ObjectId>,
    pub own_eye: Option<OwnEye>,
    /// Whether it was told to go: what it says on the control stream from then on counts for nothing.
    pub is_refused: bool,
    pub avatars: Vec<ObjectId>,
    /// Which directions it wants to hear of.
    pub interest: Interest,
    /// Pixels a unit of tangent in its picture.
    pub focal: f64,
    pub heard_at: WorldTime,
    pub owes_ack: bool,
    pub datagram_limit: usize,
    /// What it asked for of late.
    pub meter: Meter,
    /// Whether its requests are answered with the next tick only, since too much is said to have got lost.
    pub waits_for_tick: bool,
    pub bounds_due: BTreeSet<ObjectId>,
    pub violations: BTreeMap<ObjectId, Violation>,
    link: Link<Carried>,
    /// For how long the client lets an acknowledgement wait, lately at most: it acknowledges with its next frame.
    hold_max: Duration,
    /// What datagrams carried that were given up for lost because too many were under way; due again at the next tick.
    given_up: Carried,
    /// Looked up for each state that is told, and of a thousand clients' maps none is in a cache: a search through a tree would wait for
    /// memory at each of its levels. Nothing may depend on its order.
    subscriptions: FxHashMap<ObjectId, Subscription>,
    /// Of those that it was told how they go on.
    drawn: FxHashMap<ObjectId, Drawn>,
    /// Whether what has changed with the last tick is still to be made due: when a datagram is built, so that memory is waited for once.
    pub is_to_mark: bool,
    /// Bytes that may still go out; `None` without a cap.
    budget: Option<f64>,
    /// States that were held back at the last tick.
    held_back: FxHashSet<ObjectId>,
    /// What was told exactly, by object, of those of which no subscription knows it.
    known: Places,
    states_due: Due,
    hidden_due: BTreeSet<ObjectId>,
}

/// What every path carries in a QUIC datagram (RFC 9000 §14: 1,200-byte packets), until the driver says better.
const DATAGRAM_LIMIT_DEFAULT: usize = 1150;

/// More than this is not waited for, whatever a client says.
const HOLD_MAX: Duration = Duration::from_millis(500);

impl Session {
    pub fn new(client: ClientId, caller: Caller, now: WorldTime) -> Session {
        Session {
            phase: Phase::Greeting,
            client,
            caller,
            permit: Permit { rank: Rank::Viewer, avatars_max: 0, subject: String::new(), token: None },
            role: Role::Viewer,
            name: String::new(),
            came_at: now,
            away_since: None,
            roster: RosterMark::default(),
            resume_before: None,
            things: Vec::new(),
            own_eye: None,
            is_refused: false,
            avatars: Vec::new(),
            interest: Interest::Around,
            focal: 1.0,
            heard_at: now,
            owes_ack: false,
            datagram_limit: DATAGRAM_LIMIT_DEFAULT,
            meter: Meter::default(),
            waits_for_tick: false,
            bounds_due: BTreeSet::new(),
            violations: BTreeMap::new(),
            link: Link::default(),
            hold_max: Duration::ZERO,
            given_up: Vec::new(),
            subscriptions: FxHashMap::default(),
            drawn: FxHashMap::default(),
            is_to_mark: false,
            budget: None,
            held_back: FxHashSet::default(),
            known: Places::default(),
            states_due: Due::default(),
            hidden_due: BTreeSet::new(),
        }
    }

    /// Whether it may come back after its connection was lost.
    pub fn may_return(&self, grace: Duration) -> bool {
        grace > Duration::ZERO && self.caller.resume != [0; 16]
    }

    /// Goes on over the connection of `fresh`. What was under way on the old one is lost, so what may have been is due again.
    pub fn take_over(&mut self, fresh: Session, now: WorldTime, tracking: bool) {
        self.resume_before = Some(self.caller.resume);
        self.caller = fresh.caller;
        (self.interest, self.focal) = (fresh.interest, fresh.focal);
        self.datagram_limit = fresh.datagram_limit;
        self.away_since = None;
        self.heard_at = now;
        self.owes_ack = true;
        self.own_eye = None;
        // It is to be woken under its new number.
        self.is_to_mark = false;
        (self.link, self.hold_max) = (Link::default(), Duration::ZERO);
        self.drawn.clear();
        for (&object, subscription) in &mut self.subscriptions {
            subscription.renew(subscription.active, 0);
            if subscription.active {
                self.states_due.insert(object);
            } else if !tracking {
                self.hidden_due.insert(object);
            }
        }
        for violation in self.violations.values_mut() {
            violation.sent_at = None;
        }
    }

    /// The client holds nothing any more of what it was told. What it may have learnt stays known.
    pub fn forget_all(&mut self) {
        self.drawn.clear();
        let subscriptions = std::mem::take(&mut self.subscriptions);
        for (object, before) in subscriptions {
            if let Some(told) = before.told {
                self.known.insert(object, told);
            }
        }
        self.bounds_due.clear();
        self.states_due.clear();
        self.hidden_due.clear();
        self.violations.clear();
        self.held_back.clear();
    }

    /// Round-trip time, smoothed.
    pub fn round_trip(&self) -> Option<Duration> {
        Some(self.link.round_trip()?.smoothed)
    }

    /// Takes a datagram's delivery header; says whether its records are news.
    pub fn receive(&mut self, header: &LinkHeader, now: LocalTime) -> bool {
        let mut lost = Vec::new();
        let Session { link, drawn, .. } = self;
        let acked = |carried: Carried| {
            for (object, version) in carried {
                // It draws from this or a later one.
                if let Some(drawn) = drawn.get_mut(&object)
                    && version != WITHDRAWN
                {
                    drawn.0.retain(|held| held.prediction.tick >= version);
                }
            }
        };
        let arrival = link.receive(header, now, acked, |carried| lost.push(carried));
        let hold = Duration::from_micros(u64::from(header.hold_micros)).min(HOLD_MAX);
        self.hold_max = hold.max(self.hold_max - self.hold_max / 16);
        for carried in lost {
            self.send_again(carried);
        }
        arrival == Arrival::New
    }

    /// What its limits grow with, in a world of so many objects.
    pub fn size(&self, objects: usize) -> Size {
        Size { avatars: self.avatars.len(), objects }
    }

    /// Number of objects whose states it is told of.
    pub fn visible(&self) -> usize {
        self.subscriptions.values().filter(|subscription| subscription.active).count()
    }

    /// Whether it is told of nothing, and has been told of nothing that is still there.
    pub fn is_told_nothing(&self) -> bool {
        self.subscriptions.is_empty() && self.states_due.is_empty()
    }

    /// Bytes that it keeps, by the capacity of its lists; an estimate where a map does not tell, and without what is
    /// under way.
    pub fn memory_bytes(&self) -> usize {
        let held: usize = self.drawn.values().map(|drawn| drawn.0.capacity()).sum();
        // Ordered maps and sets keep their entries in blocks that are two thirds full on average.
        let sets = [&self.bounds_due, &self.hidden_due];
        let in_order = sets.iter().map(|set| set.len()).sum::<usize>() * size_of::<ObjectId>()
            + self.violations.len() * size_of::<(ObjectId, Violation)>();
        size_of::<Session>()
            + self.subscriptions.capacity() * (size_of::<(ObjectId, Subscription)>() + 1)
            + self.drawn.capacity() * (size_of::<(ObjectId, Drawn)>() + 1)
            + held * size_of::<Held>()
            + self.known.memory_bytes()
            + in_order * 3 / 2
            + self.states_due.memory_bytes()
            + self.held_back.capacity() * (size_of::<ObjectId>() + 1)
    }

    /// Number of states that are due.
    pub fn states_due(&self) -> usize {
        self.states_due.len()
    }

    /// What a lost datagram carried is due again, unless something newer has been sent since.
    fn send_again(&mut self, carried: Carried) {
        for (object, version) in carried {
            if version == WITHDRAWN {
                if !self.is_subscribed(object) {
                    self.hidden_due.insert(object);
                }
                continue;
            }
            let Some(subscription) = self.subscriptions.get_mut(&object) else { continue };
            if let Some(drawn) = self.drawn.get_mut(&object) {
                drawn.0.retain(|held| held.prediction.tick != version);
            }
            if subscription.active && (subscription.sent() == version || version == WITHHELD) {
                subscription.is_sent = false;
                subscription.withheld = false;
                self.states_due.insert(object);
            }
        }
    }

    /// Gives up datagrams that were never acknowledged.
    pub fn expire(&mut self, now: LocalTime) {
        let mut lost = Vec::new();
        if !self.given_up.is_empty() {
            lost.push(std::mem::take(&mut self.given_up));
        }
        // The round trip leaves out what the client held its acknowledgement for; without it all that it holds would be lost.
        self.link.expire(now - self.hold_max, |carried| lost.push(carried));
        self.waits_for_tick = false;
        for carried in lost {
            self.send_again(carried);
        }
    }

    /// Its view of the world, if it looks at it. An actor's eye is its avatar's, or its own if that is near; who has no
    /// avatar, or may fly, looks from where it says.
    pub fn watcher(&self, session: SessionId, objects: &[Object], avatar_class: &Class) -> Option<Watcher> {
        let Phase::Live { watches: true, .. } = self.phase else { return None };
        let avatar = self.avatars.first().copied();
        // An avatar that is not in the world lends no eye, but to who may fly.
        let is_there = |avatar: &ObjectId| objects[avatar.index()].present || self.permit.rank >= Rank::Operator;
        if avatar.as_ref().is_some_and(|avatar| !is_there(avatar)) {
            return None;
        }
        let body = avatar.map(|avatar| {
            let object = &objects[avatar.index()];
            (object.position.metres() + DVec3::Y * avatar_class.eye_height, object.orientation.yaw())
        });
        let own = self.own_eye.map(|eye| (eye.position.metres(), eye.yaw)).filter(|(eye, _)| match body {
            Some((body, _)) if self.permit.rank < Rank::Operator => eye.distance(body) <= EYE_REACH,
            _ => true,
        });
        let (eye, yaw) = own.or(body)?;
        Some(Watcher { session, avatar, eye, yaw, interest: self.interest })
    }

    /// How large things are to it, if it looks at them.
    pub fn lens<'a>(&self, id: SessionId, objects: &[Object], classes: &'a [Class]) -> Option<Lens<'a>> {
        let watcher = self.watcher(id, objects, classes.get(usize::from(AVATAR_CLASS.0))?)?;
        Some(Lens { eye: watcher.eye, focal: self.focal, classes })
    }

    /// Greatest round trip of the last 5 s, without what the client held its acknowledgements for.
    pub fn round_trip_max(&self) -> Option<Duration> {
        self.link.round_trip_max()
    }

    /// Whether a newer datagram has already said something about this object.
    pub fn is_overtaken(&self, object: ObjectId, seq: u32) -> bool {
        self.subscriptions.get(&object).is_some_and(|subscription| seq < subscription.asked_seq)
    }

    pub fn is_subscribed(&self, object: ObjectId) -> bool {
        self.subscriptions.get(&object).is_some_and(|subscription| subscription.active)
    }

    /// Whether it is told of the object, and has been since it asked: not only that it wants to be.
    pub fn is_told(&self, object: ObjectId) -> bool {
        let is_told = |told: &Subscription| told.active && !told.withheld && told.is_sent;
        self.subscriptions.get(&object).is_some_and(is_told)
    }

    /// Tells of the object from now on, and now in any case: the request may be sent again because the answer got lost.
    pub fn subscribe(&mut self, object: ObjectId, seq: u32) {
        self.bounds_due.remove(&object);
        self.states_due.insert(object);
        self.put(object, true, seq);
    }

    /// Tells of the object now, and not from now on.
    pub fn tell_once(&mut self, object: ObjectId, seq: u32) {
        self.unsubscribe(object, seq);
        self.bounds_due.remove(&object);
        self.states_due.insert(object);
    }

    pub fn unsubscribe(&mut self, object: ObjectId, seq: u32) {
        self.states_due.remove(object);
        self.put(object, false, seq);
    }

    fn put(&mut self, object: ObjectId, active: bool, seq: u32) {
        if !self.drawn.is_empty() {
            self.drawn.remove(&object);
        }
        let before = self.subscriptions.entry(object).and_modify(|before| before.renew(active, seq));
        before.or_insert_with(|| Subscription::new(active, seq));
    }

    /// Tells of the object no more, until it is asked for again.
    pub fn stop_telling(&mut self, object: ObjectId) {
        self.states_due.remove(object);
        if let Some(subscription) = self.subscriptions.get_mut(&object) {
            subscription.active = false;
        }
    }

    /// Tells of exactly these objects (ascending) from now on.
    pub fn tell_exactly(&mut self, told: &[ObjectId]) {
        for (&object, subscription) in &mut self.subscriptions {
            if subscription.active && told.binary_search(&object).is_err() {
                subscription.active = false;
                self.states_due.remove(object);
                self.hidden_due.insert(object);
            }
        }
        for &object in told {
            if !self.is_subscribed(object) {
                self.hidden_due.remove(&object);
                self.subscribe(object, 0);
            }
        }
    }

    /// The object exists no more.
    pub fn forget(&mut self, object: ObjectId) {
        self.subscriptions.remove(&object);
        self.drawn.remove(&object);
        self.known.remove(object);
        self.states_due.remove(object);
        self.hidden_due.remove(&object);
        self.bounds_due.remove(&object);
        self.violations.remove(&object);
    }

    pub fn violate(&mut self, object: ObjectId, issue: Issue, at: WorldTime) {
        self.violations.insert(object, Violation { issue, at, sent_at: None });
    }

    /// Makes due what has changed since it was sent last, or, by dead reckoning, what is drawn wrong by more than `pixels`.
    /// They are gathered in the memory of `due`. Forgets places of which `is_spent` says that they decide nothing any more.
    pub fn mark_changes(
        &mut self,
        objects: &[Object],
        tick: WorldTime,
        reckoning: Option<(f64, Lens<'_>)>,
        is_spent: impl Fn(&Object, &Known) -> bool,
        due: &mut Vec<ObjectId>,
    ) {
        let Session { subscriptions, drawn, known, states_due, link, .. } = self;
        // Together: they are sorted once.
        due.clear();
        subscriptions.retain(|&id, subscription| {
            if !subscription.active {
                // What was declined is remembered until no older question about it can arrive any more.
                let stays = subscription.asked_seq == 0 || !link.is_past(subscription.asked_seq - 1);
                if !stays {
                    drawn.remove(&id);
                    if let Some(told) = subscription.told.take() {
                        known.insert(id, told);
                    }
                }
                return stays;
            }
            let object = &objects[id.index()];
            let is_due = match &reckoning {
                // In place of what it drew from a bound was told; it is to be seen again even if that was right.
                _ if subscription.withheld => true,
                // What was never sent, or got lost, is due in any case.
                Some((pixels, lens)) if subscription.is_sent => {
                    drawn.get(&id).is_none_or(|drawn| drawn.is_wrong(object, tick, *pixels, lens))
                }
                _ => object.changed_at > subscription.sent(),
            };
            if is_due {
                due.push(id);
            }
            true
        });
        states_due.insert_all(due.iter().copied());
        // Who comes asks about everything at once, and never again.
        if subscriptions.len() < subscriptions.capacity() / 4 {
            subscriptions.shrink_to(2 * subscriptions.len());
        }
        known.sweep(tick, |id, known| is_spent(&objects[id.index()], known));
    }

    /// Lets another `elapsed` seconds' bytes go out, and counts what had to wait for them.
    pub fn refill(&mut self, bytes_per_second: u32, elapsed: f64, tick: Duration, stats: &mut WorldStats) {
        let rate = f64::from(bytes_per_second);
        // Two ticks' worth, or a datagram, may be saved up; as much may have been borrowed for what can't wait.
        let most = (2.0 * rate * tick.as_secs_f64()).max(self.datagram_limit as f64);
        self.budget = Some((self.budget.unwrap_or(most) + rate * elapsed).clamp(-most, most));
        for id in self.states_due.iter() {
            let counter = if self.held_back.contains(&id) { &mut stats.capped_late } else { &mut stats.capped };
            *counter += 1;
        }
        self.held_back.clear();
        self.held_back.extend(self.states_due.iter());
    }

    /// What is due by how urgent it is, the most urgent last: pixels × age since it was sent. What was never sent comes before
    /// all that was, since somebody waits for it.
    fn by_urgency(&self, objects: &[Object], moment: &Moment<'_>) -> Vec<ObjectId> {
        let weigh = |id: ObjectId| {
            let size = moment.lens.map_or(1.0, |lens| lens.size_px(&objects[id.index()]));
            let sent = self.subscriptions.get(&id).map_or(WorldTime::MIN, Subscription::sent);
            let is_new = sent == WorldTime::MIN;
            let age = if is_new { 1.0 } else { moment.tick.seconds_since(sent) };
            (is_new, size * age, id)
        };
        let mut due: Vec<(bool, f64, ObjectId)> = self.states_due.iter().map(weigh).collect();
        due.sort_unstable_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)).then(b.2.cmp(&a.2)));
        due.into_iter().map(|(_, _, id)| id).collect()
    }

    pub fn has_something(&self) -> bool {
        self.owes_ack
            || !self.states_due.is_empty()
            || !self.bounds_due.is_empty()
            || !self.hidden_due.is_empty()
            || !self.violations.is_empty()
    }

    /// The next datagram, or `None` if nothing is due. Violations first, since nothing may delay them. Records are gathered in the
    /// memory of `scratch`.
    pub fn build(
        &mut self,
        moment: Moment<'_>,
        objects: &mut [Object],
        stats: &mut WorldStats,
        scratch: &mut Vec<u8>,
        mut entitled: impl FnMut(&[Object], ObjectId) -> bool,
        mut bound: impl FnMut(&mut Object, Option<&Known>) -> Option<WireTbv>,
    ) -> Option<Vec<u8>> {
        let Moment { now, tick, slot, .. } = moment;
        let limit = self.datagram_limit.min(moment.room);
        let timeout = self.link.timeout();
        let may_tell = self.budget.is_none_or(|budget| budget > 0.0);
        let violations_due = self.violations.values().any(|violation| violation.is_due(now, timeout));
        if !self.owes_ack
            && !violations_due
            && (self.states_due.is_empty() || !may_tell)
            && self.bounds_due.is_empty()
            && self.hidden_due.is_empty()
        {
            return None;
        }
        let owed_ack = std::mem::take(&mut self.owes_ack);
        let local = LocalTime::from_micros(now.micros());
        let mut carried = Vec::with_capacity(self.states_due.len() + self.hidden_due.len());
        let mut records = 0;
        // Records are gathered first, then the link is told what goes, then the header is known.
        let mut writer = DatagramWriter::before_header(ServerHeader::BYTES_MAX, limit, std::mem::take(scratch));
        let mut full = false;
        for (&object, violation) in &mut self.violations {
            if full || !violation.is_due(now, timeout) {
                continue;
            }
            let age = tick.since(violation.at).as_micros() as u64;
            let present = objects[object.index()].present;
            let record = ServerRecord::Violation { object, issue: violation.issue, age_micros: age, present };
            full = !writer.push(&record);
            if !full {
                violation.sent_at = Some(now);
                stats.out.violations += 1;
                records += 1;
            }
        }
        while let Some(&id) = self.hidden_due.first() {
            let record = ServerRecord::Hidden { object: id };
            if !writer.push(&record) {
                break;
            }
            self.hidden_due.pop_first();
            carried.push((id, WITHDRAWN));
            stats.out.hidden += 1;
            records += 1;
        }
        // Without a cap all goes, in any order.
        let mut order = if self.budget.is_some() { Some(self.by_urgency(objects, &moment)) } else { None };
        while let Some(id) = match &mut order {
            Some(order) if self.budget.is_some_and(|budget| budget > writer.bytes() as f64) => order.pop(),
            Some(_) => None,
            None => self.states_due.pop_first(),
        } {
            if order.is_some() {
                self.states_due.remove(id);
            }
            if !objects[id.index()].present || !objects[id.index()].alive {
                continue;
            }
            if !entitled(objects, id) {
                // It stays due, so that it is told as soon as it is in sight; of its absence one bound speaks.
                let is_told = self.subscriptions.get_mut(&id).is_some_and(|subscription| {
                    subscription.active && std::mem::replace(&mut subscription.withheld, true)
                });
                if !is_told {
                    stats.withheld += 1;
                    // Who draws it must not take silence for rest.
                    if self.is_subscribed(id) {
                        let record = ServerRecord::Hidden { object: id };
                        match writer.push(&record) {
                            true => {
                                stats.out.hidden += 1;
                                records += 1;
                            }
                            false => drop(self.hidden_due.insert(id)),
                        }
                    }
                    self.bounds_due.insert(id);
                    carried.push((id, WITHHELD));
                }
                continue;
            }
            let object = &mut objects[id.index()];
            if !writer.push_encoded(object.state_record(id, tick, moment.reckons)) {
                self.states_due.insert(id);
                break;
            }
            let told = Known::new(object.position, tick, object.issue);
            let mut is_told_on = false;
            if let Some(subscription) = self.subscriptions.get_mut(&id) {
                is_told_on = subscription.active;
                // To say so again would be to look for two more bits in memory.
                let before = subscription.told.replace(told);
                if before.is_none() {
                    self.known.remove(id);
                }
                if before.is_none_or(|Known { issue, .. }| issue != object.issue) {
                    object.note_holder(slot);
                }
                subscription.is_sent = true;
                subscription.withheld = false;
                if moment.reckons {
                    let Object { position, orientation, velocity, .. } = *object;
                    let prediction = Prediction { position, velocity, orientation, tick };
                    self.drawn.entry(id).or_default().hold(Held { prediction, issue: object.issue });
                }
                carried.push((id, tick));
            } else {
                object.note_holder(slot);
                self.known.insert(id, told);
            }
            *(if is_told_on { &mut stats.out.states } else { &mut stats.out.places }) += 1;
            records += 1;
        }
        while let Some(&id) = self.bounds_due.first() {
            let object = &mut objects[id.index()];
            let known = match self.subscriptions.get(&id) {
                Some(Subscription { told: Some(told), .. }) => Some(told),
                _ => self.known.get(id),
            };
            let tbv = if object.present && object.alive { bound(object, known) } else { None };
            let Some(tbv) = tbv else {
                self.bounds_due.pop_first();
                continue;
            };
            let record = ServerRecord::Bound { object: id, tbv };
            if !writer.push(&record) {
                break;
            }
            self.bounds_due.pop_first();
            object.note_holder(slot);
            stats.out.bounds += 1;
            records += 1;
        }
        if records == 0 && !owed_ack {
            // Nothing that is due fits: to go on would be to go on for ever.
            *scratch = writer.give_up();
            return None;
        }
        let (link, lost) = self.link.send(carried, local);
        if let Some(lost) = lost {
            stats.datagrams_lost += 1;
            // Not at once: who acknowledges nothing would have us build without end.
            self.given_up.extend(lost);
        }
        let datagram;
        (datagram, *scratch) = writer.finish_with(&ServerHeader { link, sent: now, tick });
        if let Some(budget) = &mut self.budget {
            *budget -= datagram.len() as f64;
        }
        Some(datagram)
    }
}

impl Violation {
    fn is_due(&self, now: WorldTime, timeout: Duration) -> bool {
        self.sent_at.is_none_or(|sent_at| now.since(sent_at) >= timeout)
    }
}
