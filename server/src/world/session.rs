//! One client as the server sees it: what it is told of, what it has acknowledged, what is due.
//!
//! Nothing is queued but ids: records are built when a datagram is, from the newest committed state, so no queue can
//! hold a stale pose and each is bounded by the number of objects.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use eyeline_protocol::codec::DatagramWriter;
use eyeline_protocol::{
    Arrival, Issue, Link, LinkHeader, LocalTime, ObjectId, ServerHeader, ServerRecord, WireTbv, WorldTime,
};

use super::blur::Known;
use super::{Object, WorldStats};

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

/// What a client is told about one object.
struct Subscription {
    /// Whether updates are pushed.
    active: bool,
    /// `changed_at` of the state that was sent last; `WorldTime::MIN` if none is under way or arrived.
    sent: WorldTime,
    /// Number of the datagram that asked last: what an older one says has been overtaken.
    asked_seq: u32,
}

/// A violation that the client has not acknowledged.
pub(super) struct Violation {
    pub issue: Issue,
    at: WorldTime,
    sent_at: Option<WorldTime>,
}

/// In place of a state's version: the object was withdrawn.
const WITHDRAWN: WorldTime = WorldTime::MAX;

/// The state of a datagram that was sent: which objects' states it carried.
type Carried = Vec<(ObjectId, WorldTime)>;

pub(super) struct Session {
    pub phase: Phase,
    /// Whether it was told to go: what it says on the control stream from then on counts for nothing.
    pub is_refused: bool,
    pub avatars: Vec<ObjectId>,
    pub heard_at: WorldTime,
    pub owes_ack: bool,
    pub datagram_limit: usize,
    pub bounds_due: BTreeSet<ObjectId>,
    pub violations: BTreeMap<ObjectId, Violation>,
    link: Link<Carried>,
    /// For how long the client lets an acknowledgement wait, lately at most: it acknowledges with its next frame.
    hold_max: Duration,
    subscriptions: BTreeMap<ObjectId, Subscription>,
    /// What was told exactly, by object.
    known: BTreeMap<ObjectId, Known>,
    states_due: BTreeSet<ObjectId>,
    hidden_due: BTreeSet<ObjectId>,
}

/// What every path carries in a QUIC datagram (RFC 9000 §14: 1,200-byte packets), until the driver says better.
const DATAGRAM_LIMIT_DEFAULT: usize = 1150;

/// More than this is not waited for, whatever a client says.
const HOLD_MAX: Duration = Duration::from_millis(500);

impl Session {
    pub fn new(now: WorldTime) -> Session {
        Session {
            phase: Phase::Greeting,
            is_refused: false,
            avatars: Vec::new(),
            heard_at: now,
            owes_ack: false,
            datagram_limit: DATAGRAM_LIMIT_DEFAULT,
            bounds_due: BTreeSet::new(),
            violations: BTreeMap::new(),
            link: Link::default(),
            hold_max: Duration::ZERO,
            subscriptions: BTreeMap::new(),
            known: BTreeMap::new(),
            states_due: BTreeSet::new(),
            hidden_due: BTreeSet::new(),
        }
    }

    /// Takes a datagram's delivery header; says whether its records are news.
    pub fn receive(&mut self, header: &LinkHeader, now: LocalTime) -> bool {
        let mut lost = Vec::new();
        let arrival = self.link.receive(header, now, |_| (), |carried| lost.push(carried));
        let hold = Duration::from_micros(u64::from(header.hold_micros)).min(HOLD_MAX);
        self.hold_max = hold.max(self.hold_max - self.hold_max / 16);
        for carried in lost {
            self.send_again(carried);
        }
        arrival == Arrival::New
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
            if let Some(subscription) = self.subscriptions.get_mut(&object)
                && subscription.active
                && subscription.sent == version
            {
                subscription.sent = WorldTime::MIN;
                self.states_due.insert(object);
            }
        }
    }

    /// Gives up datagrams that were never acknowledged.
    pub fn expire(&mut self, now: LocalTime, objects: &[Object]) {
        let mut lost = Vec::new();
        // The round trip leaves out what the client held its acknowledgement for; without it all that it holds would be lost.
        self.link.expire(now - self.hold_max, |carried| lost.push(carried));
        for carried in lost {
            self.send_again(carried);
        }
        self.states_due.retain(|id| objects[id.index()].alive);
    }

    /// Whether a newer datagram has already said something about this object.
    pub fn is_overtaken(&self, object: ObjectId, seq: u32) -> bool {
        self.subscriptions.get(&object).is_some_and(|subscription| seq < subscription.asked_seq)
    }

    pub fn is_subscribed(&self, object: ObjectId) -> bool {
        self.subscriptions.get(&object).is_some_and(|subscription| subscription.active)
    }

    /// Tells of the object from now on, and now in any case: the request may be sent again because the answer got lost.
    pub fn subscribe(&mut self, object: ObjectId, seq: u32) {
        self.bounds_due.remove(&object);
        self.states_due.insert(object);
        self.subscriptions.insert(object, Subscription { active: true, sent: WorldTime::MIN, asked_seq: seq });
    }

    /// Tells of the object now, and not from now on.
    pub fn tell_once(&mut self, object: ObjectId, seq: u32) {
        self.unsubscribe(object, seq);
        self.bounds_due.remove(&object);
        self.states_due.insert(object);
    }

    pub fn unsubscribe(&mut self, object: ObjectId, seq: u32) {
        self.states_due.remove(&object);
        self.subscriptions.insert(object, Subscription { active: false, sent: WorldTime::MIN, asked_seq: seq });
    }

    /// Tells of the object no more, until it is asked for again.
    pub fn stop_telling(&mut self, object: ObjectId) {
        self.states_due.remove(&object);
        if let Some(subscription) = self.subscriptions.get_mut(&object) {
            subscription.active = false;
        }
    }

    /// Tells of exactly these objects (ascending) from now on.
    pub fn tell_exactly(&mut self, told: &[ObjectId]) {
        for (&object, subscription) in &mut self.subscriptions {
            if subscription.active && told.binary_search(&object).is_err() {
                subscription.active = false;
                self.states_due.remove(&object);
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
        self.known.remove(&object);
        self.states_due.remove(&object);
        self.hidden_due.remove(&object);
        self.bounds_due.remove(&object);
        self.violations.remove(&object);
    }

    pub fn violate(&mut self, object: ObjectId, issue: Issue, at: WorldTime) {
        self.violations.insert(object, Violation { issue, at, sent_at: None });
    }

    /// Makes due what has changed since it was sent last.
    pub fn mark_changes(&mut self, objects: &[Object]) {
        for (&id, subscription) in &self.subscriptions {
            if subscription.active && objects[id.index()].changed_at > subscription.sent {
                self.states_due.insert(id);
            }
        }
    }

    pub fn has_something(&self) -> bool {
        self.owes_ack
            || !self.states_due.is_empty()
            || !self.bounds_due.is_empty()
            || !self.hidden_due.is_empty()
            || !self.violations.is_empty()
    }

    /// The next datagram, or `None` if nothing is due. Violations first, since nothing may delay them.
    pub fn build(
        &mut self,
        now: WorldTime,
        tick: WorldTime,
        slot: usize,
        objects: &mut [Object],
        stats: &mut WorldStats,
        mut bound: impl FnMut(&mut Object, Option<&mut Known>) -> Option<WireTbv>,
    ) -> Option<Vec<u8>> {
        let timeout = self.link.timeout();
        let violations_due = self.violations.values().any(|violation| violation.is_due(now, timeout));
        if !self.owes_ack
            && !violations_due
            && self.states_due.is_empty()
            && self.bounds_due.is_empty()
            && self.hidden_due.is_empty()
        {
            return None;
        }
        let owed_ack = std::mem::take(&mut self.owes_ack);
        let local = LocalTime::from_micros(now.micros());
        let mut carried = Vec::new();
        let mut places = 0;
        let mut records = Vec::new();
        // The header's size does not depend on what it carries beyond a few bytes; records are first gathered, then
        // the link is told what goes.
        let probe = ServerHeader {
            link: LinkHeader { seq: u32::MAX, ack: u32::MAX, ack_bits: u32::MAX, hold_micros: u32::MAX },
            sent: WorldTime::MAX,
            tick: WorldTime::MAX,
        };
        let mut writer = DatagramWriter::new(&probe, self.datagram_limit);
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
                records.push(record);
            }
        }
        while let Some(&id) = self.hidden_due.first() {
            let record = ServerRecord::Hidden { object: id };
            if !writer.push(&record) {
                break;
            }
            self.hidden_due.pop_first();
            carried.push((id, WITHDRAWN));
            records.push(record);
        }
        while let Some(&id) = self.states_due.first() {
            let object = &mut objects[id.index()];
            if !object.present || !object.alive {
                self.states_due.pop_first();
                continue;
            }
            let record = ServerRecord::State { object: id, position: object.position, orientation: object.orientation };
            if !writer.push(&record) {
                break;
            }
            self.states_due.pop_first();
            object.note_holder(slot);
            self.known.insert(id, Known::new(object.position, tick, object.issue));
            places += u64::from(!self.subscriptions.get(&id).is_some_and(|subscription| subscription.active));
            if let Some(subscription) = self.subscriptions.get_mut(&id) {
                subscription.sent = object.changed_at;
                carried.push((id, object.changed_at));
            }
            records.push(record);
        }
        while let Some(&id) = self.bounds_due.first() {
            let object = &mut objects[id.index()];
            let tbv = if object.present && object.alive { bound(object, self.known.get_mut(&id)) } else { None };
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
            records.push(record);
        }
        if records.is_empty() && !owed_ack {
            // Nothing that is due fits: to go on would be to go on for ever.
            return None;
        }
        for record in &records {
            stats.out.count_server(record);
        }
        stats.out.states -= places;
        stats.out.places += places;
        let (link, lost) = self.link.send(carried, local);
        if let Some(lost) = lost {
            stats.datagrams_lost += 1;
            self.send_again(lost);
        }
        let mut writer = DatagramWriter::new(&ServerHeader { link, sent: now, tick }, self.datagram_limit);
        for record in &records {
            let fits = writer.push(record);
            debug_assert!(fits, "the probe's header is the longest there is");
        }
        Some(writer.finish())
    }
}

impl Violation {
    fn is_due(&self, now: WorldTime, timeout: Duration) -> bool {
        self.sent_at.is_none_or(|sent_at| now.since(sent_at) >= timeout)
    }
}
