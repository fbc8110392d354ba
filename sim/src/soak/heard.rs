//! Is what clients are told true, and is it no more than they may know?
//!
//! Reads every byte that arrives. What is said of an object must hold at the tick that it speaks of, and what a client can make
//! of everything that it was ever told must leave a hidden object the room that it was promised (DESIGN §3.4, [`Feasible`]).
//!
//! **Entitled** is who could see the object from some eye of the lead region. A pose that was told without that counts as
//! over-disclosure, and is allowed if the client had asked: its bound had come into view, and nothing else can tell
//! it that the object had not. From then on the room grows again. A pose that nobody asked for leaves none.
//! Room grows from when a pose is *sent* to who may have it: whether it arrives is chance, and promised is room since
//! somebody was last entitled. Who never gets it knows less than the server must suppose.

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;
use std::time::Duration;

use eyeline_protocol::{
    ClientRecord, Issue, MotionBound, ObjectId, Position, ServerControl, ServerHeader, ServerRecord, Tbv, Want,
    WorldTime, codec,
};
use eyeline_server::world::World;
use glam::DVec3;

use super::failures::Failures;
use super::feasible::{Disc, Feasible};
use super::walls::{Walls, plan};
use crate::virtual_net::{Direction, Framed, Kind, Observer, Passing};

/// What the server promises about hidden places.
#[derive(Clone, Copy, Debug)]
pub struct Secrecy {
    /// The least radius that a hidden place is kept uncertain within, metres.
    pub blur: f64,
    /// For how long a bound holds at most.
    pub validity_max: Duration,
    /// Most bytes in a datagram.
    pub datagram_limit: usize,
}

/// What was counted.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct HeardCounts {
    /// Records that were compared with the truth.
    pub records: u64,
    /// Sets of places that were measured.
    pub sets: u64,
    /// Poses that were told.
    pub poses: u64,
    /// Of those, the ones that were told without entitlement, in answer to a question.
    pub over_disclosed: u64,
}

/// One object as it truly is and was.
struct Being {
    motion: MotionBound,
    extent: f64,
    issue: Issue,
    is_there: bool,
    /// What was told of an earlier time is void.
    void_before: WorldTime,
    /// Newest places and the ticks from which on they were true.
    places: VecDeque<(WorldTime, Position)>,
}

/// What a client said last about an object.
#[derive(Clone, Copy)]
struct Said {
    at: WorldTime,
    seq: u32,
    want: Option<Want>,
}

/// What one client knows of one object.
#[derive(Default)]
struct Knowledge {
    feasible: Feasible,
    said: VecDeque<Said>,
    /// From when on the room grows: it was told what it had asked for, or entitled.
    grows_from: Option<WorldTime>,
    /// The newest pose that it was told for no reason.
    unasked: Option<WorldTime>,
    /// Whether the set has grown to what is promised, which it stays until more is told.
    is_settled: bool,
}

/// A message that nobody has looked into.
struct Unread {
    client: usize,
    step: Step,
    bytes: Vec<u8>,
    at: WorldTime,
}

/// What has become of a message.
#[derive(Clone, Copy)]
enum Step {
    /// A datagram that the server has sent.
    Sent,
    /// It is there.
    Arrived(Direction, Kind),
}

#[derive(Default)]
struct Client {
    knows: BTreeMap<ObjectId, Knowledge>,
    /// Newest eyes, and how far around them the lead reaches.
    eyes: VecDeque<(DVec3, f64)>,
}

/// Watches what arrives.
pub struct Heard {
    walls: Arc<Walls>,
    secrecy: Secrecy,
    /// Share of the promised room that must be left; 1 in earnest.
    share: f64,
    beings: Vec<Being>,
    clients: BTreeMap<usize, Client>,
    /// What has been sent or has arrived and was not read.
    unread: Vec<Unread>,
    /// How much later than its tick a state was committed at most.
    lateness: Duration,
    tick: Duration,
    /// What was wrong.
    pub failures: Failures,
    /// What was counted.
    pub counts: HeardCounts,
    /// The least share of the promised room that any set left.
    pub least_share: f64,
}

/// What the sets' radii are measured to: points of circles, in shares of what is promised.
const TOLERANCE: f64 = 0.002;

/// So many places of an object are remembered: 20 s at 20 Hz. A datagram of an older tick is not compared.
const PLACES_MAX: usize = 400;

/// So many things that a client said about an object are remembered, in case they overtake one another.
const SAID_MAX: usize = 16;

/// Eyes of so many frames count for entitlement: an answer to the first of them may be under way.
const EYES_MAX: usize = 4;

/// A disc that is greater by so much than the object counts as it for entitlement, metres: it moves between frames.
const ENTITLED_MORE: f64 = 0.1;

impl Heard {
    /// A checker for a scene. `share` of the promised room must be left: 1 in earnest.
    pub fn new(walls: Arc<Walls>, secrecy: Secrecy, share: f64) -> Heard {
        Heard {
            walls,
            secrecy,
            share,
            beings: Vec::new(),
            clients: BTreeMap::new(),
            unread: Vec::new(),
            lateness: Duration::ZERO,
            tick: Duration::ZERO,
            failures: Failures::default(),
            counts: HeardCounts::default(),
            least_share: f64::INFINITY,
        }
    }

    /// Listens to what this client is told from now on.
    pub fn watch(&mut self, client: usize) {
        self.clients.insert(client, Client::default());
    }

    fn learn(&mut self, world: &World) {
        self.tick = world.tick_period();
        for (index, object) in world.objects().iter().enumerate() {
            let class = &world.classes()[usize::from(object.class.0)];
            if index == self.beings.len() {
                self.beings.push(Being {
                    motion: class.motion,
                    extent: class.extent.radius,
                    issue: object.issue,
                    is_there: false,
                    void_before: WorldTime::MIN,
                    places: VecDeque::new(),
                });
            }
            let being = &mut self.beings[index];
            let is_there = object.alive && object.present;
            if being.issue != object.issue {
                being.void_before = object.changed_at.max(being.void_before);
                being.issue = object.issue;
                for client in self.clients.values_mut() {
                    if let Some(knowledge) = client.knows.get_mut(&ObjectId(index as u32)) {
                        knowledge.feasible.forget_before(being.void_before);
                        knowledge.is_settled = false;
                    }
                }
            }
            if being.is_there && !is_there {
                for client in self.clients.values_mut() {
                    if let Some(knowledge) = client.knows.get_mut(&ObjectId(index as u32)) {
                        knowledge.feasible.clear();
                        knowledge.is_settled = true;
                    }
                }
            }
            being.is_there = is_there;
            if being.places.back().is_none_or(|&(_, place)| place != object.position) {
                being.places.push_back((object.changed_at, object.position));
                if being.places.len() > PLACES_MAX {
                    being.places.pop_front();
                }
            }
        }
    }

    /// Keeps a message until the world has been looked at.
    fn keep(&mut self, message: &Passing<'_>, step: Step) {
        if self.clients.contains_key(&message.client) {
            self.unread.push(Unread { client: message.client, step, bytes: message.bytes.to_vec(), at: message.at });
        }
    }

    /// Reads what has arrived since the world was looked at last: only now is it known who has come since.
    fn read(&mut self) {
        let mut unread = std::mem::take(&mut self.unread);
        for Unread { client, step, bytes, at } in unread.drain(..) {
            match step {
                Step::Sent => self.note_sent(client, &bytes),
                Step::Arrived(Direction::Up, Kind::Datagram) => self.hear_up(client, &bytes, at),
                Step::Arrived(Direction::Down, Kind::Datagram) => self.hear_datagram(client, &bytes, at),
                Step::Arrived(Direction::Down, Kind::Control) => self.hear_control(client, &bytes, at),
                Step::Arrived(Direction::Up, Kind::Control) => {}
            }
        }
        self.unread = unread;
    }

    fn hear_up(&mut self, number: usize, bytes: &[u8], at: WorldTime) {
        let Some(client) = self.clients.get_mut(&number) else { return };
        let Ok((header, records)) = codec::decode_client_datagram(bytes) else { return };
        for record in records {
            let (object, want) = match record {
                ClientRecord::Request { object, want, .. } => (object, Some(want)),
                ClientRecord::Release { object, .. } => (object, None),
                ClientRecord::Pose { .. } | ClientRecord::Eye { .. } | ClientRecord::ViolationAck { .. } => continue,
            };
            let said = &mut client.knows.entry(object).or_default().said;
            said.push_back(Said { at, seq: header.link.seq, want });
            if said.len() > SAID_MAX {
                said.pop_front();
            }
        }
    }

    /// Who is sent a pose that it may have is as one that can see the object.
    fn note_sent(&mut self, number: usize, bytes: &[u8]) {
        let Ok((header, records)) = codec::decode_server_datagram(bytes) else { return };
        for record in records {
            if let ServerRecord::State { object, position, .. } = record
                && self.may_have(number, object, position, &header).is_some()
                && let Some(knowledge) = self.clients.get_mut(&number).and_then(|client| client.knows.get_mut(&object))
            {
                knowledge.grows_from = knowledge.grows_from.max(Some(header.tick));
            }
        }
    }

    /// Whether a client may have this pose: `Some(true)` if it is entitled, `Some(false)` if it only asked.
    fn may_have(&mut self, number: usize, id: ObjectId, position: Position, header: &ServerHeader) -> Option<bool> {
        let being = self.beings.get(id.index()).filter(|being| header.tick >= being.void_before)?;
        let client = self.clients.get_mut(&number)?;
        let radius = being.extent + ENTITLED_MORE;
        let is_entitled = is_entitled(&self.walls, &client.eyes, position.metres(), radius);
        let is_asked = client.knows.entry(id).or_default().is_asked(header.sent, self.tick);
        (is_entitled || is_asked).then_some(is_entitled)
    }

    fn hear_datagram(&mut self, number: usize, bytes: &[u8], at: WorldTime) {
        let Ok((header, records)) = codec::decode_server_datagram(bytes) else { return };
        let limit = self.secrecy.datagram_limit;
        if bytes.len() > limit {
            let bytes = bytes.len();
            self.failures.note(number, at, || format!("a datagram of {bytes} bytes is more than {limit}"));
        }
        let age = header.sent.since(header.tick);
        if age > 2 * self.tick + self.lateness {
            self.failures.note(number, at, || format!("a datagram of a tick {age:?} ago is more than two ticks old"));
        }
        for record in records {
            match record {
                ServerRecord::State { object, position, .. } => self.hear_pose(number, object, position, &header, at),
                ServerRecord::Bound { object, tbv } => {
                    let tbv = tbv.tbv(header.tick);
                    if self.is_true_bound(number, object, &tbv, header.tick, at) {
                        self.told(number, object, Disc::of_bound(&tbv), at);
                    }
                }
                ServerRecord::Violation { .. } | ServerRecord::Hidden { .. } => {}
            }
        }
    }

    fn hear_pose(&mut self, number: usize, id: ObjectId, position: Position, header: &ServerHeader, at: WorldTime) {
        let Some(being) = self.beings.get(id.index()).filter(|being| header.tick >= being.void_before) else { return };
        self.counts.poses += 1;
        self.counts.records += 1;
        let then = being.places.iter().rev().find(|(since, _)| *since <= header.tick);
        if let Some(&(_, truly)) = then
            && truly != position
        {
            let (place, truly, tick) = (position.metres(), truly.metres(), header.tick.micros());
            self.failures.note(number, at, || format!("{id}: told to be at {place} at {tick} µs, and was at {truly}"));
        }
        let disc = Disc::of_pose(plan(position.metres()), header.tick, being.motion);
        let may_have = self.may_have(number, id, position, header);
        self.counts.over_disclosed += u64::from(may_have == Some(false));
        let Some(client) = self.clients.get_mut(&number) else { return };
        let knowledge = client.knows.entry(id).or_default();
        match may_have {
            Some(_) => knowledge.grows_from = knowledge.grows_from.max(Some(header.tick)),
            None => knowledge.unasked = knowledge.unasked.max(Some(header.tick)),
        }
        self.told(number, id, disc, at);
    }

    /// Whether a bound that speaks of `tick` is what a server may say.
    fn is_true_bound(&mut self, number: usize, id: ObjectId, tbv: &Tbv, tick: WorldTime, at: WorldTime) -> bool {
        let Some(being) = self.beings.get(id.index()) else { return false };
        if tbv.issue != being.issue {
            return false;
        }
        self.counts.records += 1;
        let mut wrong = Vec::new();
        if tbv.issued < being.void_before {
            wrong.push(format!("is of issue {} and from before that began", tbv.issue.0));
        }
        let over = tbv.expires.since(tbv.issued.max(tick) + self.secrecy.validity_max);
        if over > Duration::ZERO {
            wrong.push(format!("holds for {over:?} longer than any does"));
        }
        if let Some(&(_, truly)) = being.places.iter().rev().find(|(since, _)| *since <= tick) {
            let distance = tbv.centre.metres().distance(truly.metres());
            if distance > tbv.radius_at(tick) + 1e-9 {
                let radius = tbv.radius_at(tick);
                wrong.push(format!("has a radius of {radius} m as it is told, and it is {distance} m from its centre"));
            }
        }
        let is_true = wrong.is_empty();
        for what in wrong {
            self.failures.note(number, at, || format!("{id}: its bound {what}"));
        }
        is_true
    }

    fn hear_control(&mut self, number: usize, bytes: &[u8], at: WorldTime) {
        let Ok(ServerControl::Roster { tick, entries }) = codec::decode_server_control(bytes) else { return };
        for entry in entries {
            // Of who has just come nothing else is known yet, not even to the checker.
            if let Some(bound) = entry.bound
                && self.beings.get(entry.object.index()).is_some_and(|being| being.issue == entry.issue)
            {
                self.told(number, entry.object, Disc::of_bound(&bound.tbv(tick)), at);
            }
        }
    }

    /// A client was told something: what does that leave?
    fn told(&mut self, number: usize, id: ObjectId, disc: Disc, at: WorldTime) {
        let Some(being) = self.beings.get(id.index()).filter(|being| being.is_there) else { return };
        if disc.since < being.void_before {
            return;
        }
        let Some(client) = self.clients.get_mut(&number) else { return };
        let knowledge = client.knows.entry(id).or_default();
        knowledge.feasible.add(disc);
        knowledge.is_settled = false;
        self.measure(number, id, at);
    }

    /// Compares the room that a client's knowledge leaves with what is promised.
    fn measure(&mut self, number: usize, id: ObjectId, at: WorldTime) {
        let being = &self.beings[id.index()];
        let Some(knowledge) = self.clients.get_mut(&number).and_then(|client| client.knows.get_mut(&id)) else {
            return;
        };
        if knowledge.is_settled || !being.is_there {
            return;
        }
        self.counts.sets += 1;
        let radius = knowledge.feasible.enclosing_radius(at, being.motion);
        knowledge.is_settled = radius >= self.secrecy.blur;
        let grown =
            knowledge.grows_from.map_or(f64::INFINITY, |from| being.motion.speed_max * at.seconds_since(from).max(0.0));
        let promised = self.secrecy.blur.min(grown);
        if promised <= 0.0 {
            return;
        }
        self.least_share = self.least_share.min(radius / promised);
        if radius < promised * (self.share - TOLERANCE) {
            let unasked = knowledge.unasked.filter(|&tick| Some(tick) > knowledge.grows_from);
            let told = unasked.map_or(String::new(), |tick| format!(", told unasked of {} µs", tick.micros()));
            let text =
                || format!("{id}: known to within {radius:.3} m, which should be {promised:.3} m at least{told}");
            self.failures.note(number, at, text);
            // Once is enough: it is told again when more is.
            knowledge.is_settled = true;
        }
    }
}

impl Knowledge {
    /// Whether a pose that the server sent at `sent` was asked for: by who wants updates, or once, lately.
    fn is_asked(&self, sent: WorldTime, tick: Duration) -> bool {
        let by = |time: WorldTime| {
            let newest = self.said.iter().filter(|said| said.at <= time).max_by_key(|said| said.seq);
            newest.is_some_and(|said| match said.want {
                Some(Want::State) => true,
                Some(Want::Place) => sent.since(said.at) <= tick,
                Some(Want::Bound) | None => false,
            })
        };
        // What came in the very microsecond may have come before or after it.
        by(sent) || by(sent.offset_micros(-1))
    }
}

/// Whether a disc at `place` can be seen from any of these eyes or from around the newest, in doubt yes.
fn is_entitled(walls: &Walls, eyes: &VecDeque<(DVec3, f64)>, place: DVec3, radius: f64) -> bool {
    if eyes.iter().rev().any(|&(eye, _)| walls.sees_disc(eye, place, radius)) {
        return true;
    }
    let Some(&(eye, reach)) = eyes.back().filter(|(_, reach)| *reach > 0.0) else { return false };
    (0..8).any(|i| {
        let (sine, cosine) = (f64::from(i) * std::f64::consts::TAU / 8.0).sin_cos();
        walls.sees_disc(eye + DVec3::new(cosine, 0.0, sine) * reach, place, radius)
    })
}

impl Observer for Heard {
    fn committed(&mut self, world: &World, at: WorldTime) {
        self.lateness = self.lateness.max(at.since(world.committed_at()));
        self.learn(world);
        self.read();
    }

    fn framed(&mut self, frame: &Framed<'_>) {
        self.learn(frame.world);
        self.read();
        let Some(client) = self.clients.get_mut(&frame.client) else { return };
        if let Some(eye) = frame.eye {
            client.eyes.push_back((eye, frame.session.ahead().eye_radius));
            if client.eyes.len() > EYES_MAX {
                client.eyes.pop_front();
            }
        }
        let unsettled: Vec<ObjectId> =
            client.knows.iter().filter(|(_, knowledge)| !knowledge.is_settled).map(|(&id, _)| id).collect();
        for id in unsettled {
            if id.index() < self.beings.len() {
                self.measure(frame.client, id, frame.at);
            }
        }
    }

    fn sent(&mut self, message: &Passing<'_>) {
        self.keep(message, Step::Sent);
    }

    fn arrives(&mut self, message: &Passing<'_>) {
        self.keep(message, Step::Arrived(message.direction, message.kind));
    }
}
