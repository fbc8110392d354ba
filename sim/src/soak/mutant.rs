//! Do the checkers notice? Ways to break a server, a client, the codec or a clock, each with a name.
//!
//! A mutant that no seed catches would be a promise that nobody checks. Most are *liars* between the ends: what the server or
//! the client said is decoded, changed and sent on, so that no product code knows of them. The rest are settings and the
//! tracker's [`Sabotage`].

use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet};
use std::rc::Rc;
use std::time::Duration;

use eyeline_client::tracking::{Lead, Sabotage};
use eyeline_protocol::codec::{self, DATAGRAM_BYTES_MAX, DatagramWriter};
use eyeline_protocol::{
    ClientRecord, Issue, ObjectId, Position, QUANTUM_METRES, ServerHeader, ServerRecord, Want, WorldTime,
};
use eyeline_server::world::World;
use glam::DVec3;
use rand::RngExt;
use rand_pcg::Pcg64;

use super::town::TownRules;
use crate::virtual_net::{Direction, Passing, Verdict};

macro_rules! mutants {
    ($($(#[doc = $doc:literal])+ $variant:ident = $name:literal,)+) => {
        /// A way to break the system.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
        pub enum Mutant {
            $($(#[doc = $doc])+ $variant,)+
        }

        impl Mutant {
            /// All of them.
            pub const ALL: &'static [Mutant] = &[$(Mutant::$variant,)+];

            /// Its name on the command line.
            pub fn name(self) -> &'static str {
                match self {
                    $(Mutant::$variant => $name,)+
                }
            }

            /// What is broken, in words.
            pub fn says(self) -> &'static str {
                match self {
                    $(Mutant::$variant => concat!($($doc),+).trim_ascii(),)+
                }
            }
        }
    };
}

mutants! {
    /// Tracker: what it asks leaves a frame late.
    LateOneTick = "late-one-tick",
    /// Tracker: exposed bounds are ignored.
    DropExposures = "drop-exposures",
    /// Tracker: a question is asked once, heard or not.
    NeverRepeat = "never-repeat",
    /// Tracker: a bound from before a violation is believed. (The server's bounds from before are sent again after one.)
    AcceptStaleIssue = "accept-stale-issue",
    /// Tracker: bounds are held beyond their expiry.
    IgnoreExpiry = "ignore-expiry",
    /// Lead: none, where one is expected.
    LeadForgotten = "lead-forgotten",
    /// Lead: bounds are grown for it, but looked at from the eye's own point.
    PointLead = "point-lead",
    /// Clock: that of expiry stands still.
    FreezeClock = "freeze-clock",
    /// Clock: a tenth slow or fast.
    WrongClock = "wrong-clock",
    /// Codec: a bound's radius is rounded inward, to sixteenths of a metre.
    RadiusInward = "radius-inward",
    /// Codec: a bound's expiry is rounded outward, by a millisecond.
    ExpiryOutward = "expiry-outward",
    /// Codec: places are rounded to two steps.
    PlaceRounded = "place-rounded",
    /// Link: the client acknowledges what got lost.
    AcknowledgeLost = "acknowledge-lost",
    /// Link: every eighth datagram of the server has its predecessor's number.
    NumberTwice = "number-twice",
    /// Server: every fourth violation is never announced.
    ViolationForgotten = "violation-forgotten",
    /// Server: a violation counts as acknowledged once it is sent.
    ViolationAckedEarly = "violation-acked-early",
    /// Server: bounds leave no room for the slack of motion.
    NoSlack = "no-slack",
    /// Server: bounds do not grow.
    NoGrowth = "no-growth",
    /// Server: the centre of each bound is shaken afresh, so that asking often averages it out.
    FreshJitter = "fresh-jitter",
    /// Server: a state is of the tick before the one that it claims.
    AnotherTick = "another-tick",
    /// Server: updates end after the first.
    SubscriptionLost = "subscription-lost",
    /// Server: updates go on after they were declined.
    ReleaseForgotten = "release-forgotten",
    /// Server: who asks for a bound is told the place.
    PoseForBound = "pose-for-bound",
}

impl std::str::FromStr for Mutant {
    type Err = String;

    fn from_str(text: &str) -> Result<Mutant, String> {
        Mutant::ALL.iter().copied().find(|mutant| mutant.name() == text).ok_or_else(|| {
            let names: Vec<&str> = Mutant::ALL.iter().map(|mutant| mutant.name()).collect();
            format!("there is no mutant '{text}'; there are {}", names.join(", "))
        })
    }
}

impl Mutant {
    /// Changes a town's settings before it is built.
    pub(super) fn prepare(self, rules: &mut TownRules) {
        let sabotage = match self {
            Mutant::LateOneTick => Some(Sabotage::LateOneTick),
            Mutant::DropExposures => Some(Sabotage::DropExposures),
            Mutant::NeverRepeat => Some(Sabotage::NeverRepeat),
            Mutant::AcceptStaleIssue => Some(Sabotage::AcceptStaleIssue),
            Mutant::IgnoreExpiry => Some(Sabotage::IgnoreExpiry),
            Mutant::FreezeClock => Some(Sabotage::FreezeClock),
            Mutant::PointLead => Some(Sabotage::PointLead),
            _ => None,
        };
        rules.sabotage = sabotage.or(rules.sabotage);
        match self {
            Mutant::LeadForgotten => rules.lead = Lead::None,
            Mutant::WrongClock => rules.drift = 0.1,
            _ => {}
        }
    }

    /// What lies between the ends, if this mutant is of that kind.
    pub(super) fn liar(self, seed: u64, places: Places) -> impl FnMut(&Passing<'_>) -> Verdict + 'static {
        let mut liar = Liar {
            mutant: self,
            chance: crate::chance(seed, 0x11e5),
            places,
            clients: BTreeMap::new(),
            poses: BTreeMap::new(),
        };
        move |message| liar.pass(message)
    }
}

/// Where everything truly is, and was a tick ago: what a server knows that lies.
#[derive(Clone, Default)]
pub(super) struct Places(Rc<RefCell<Vec<(Position, Position)>>>);

impl Places {
    /// A tick was committed.
    pub fn note(&self, world: &World) {
        let mut places = self.0.borrow_mut();
        let now = world.objects().iter().map(|object| object.position);
        let before: Vec<Position> = places.iter().map(|&(now, _)| now).collect();
        *places = now.enumerate().map(|(i, now)| (now, before.get(i).copied().unwrap_or(now))).collect();
    }

    fn now(&self, object: ObjectId) -> Option<Position> {
        self.0.borrow().get(object.index()).map(|&(now, _)| now)
    }

    fn before(&self, object: ObjectId) -> Option<Position> {
        self.0.borrow().get(object.index()).map(|&(_, before)| before)
    }
}

#[derive(Default)]
struct Victim {
    /// Datagrams to it.
    sent: u64,
    /// Violations that are under way.
    violations: Vec<(ObjectId, Issue)>,
    /// What it asked last, and how often it was told since.
    asked: BTreeMap<ObjectId, (Want, u32)>,
    released: BTreeSet<ObjectId>,
    /// The newest bound of each object and its time; and how often more it is sent.
    bounds: BTreeMap<ObjectId, (ServerRecord, WorldTime)>,
    again: BTreeMap<ObjectId, (ServerRecord, WorldTime, u32)>,
}

struct Liar {
    mutant: Mutant,
    chance: Pcg64,
    places: Places,
    clients: BTreeMap<usize, Victim>,
    /// A pose record of each object, to make others of.
    poses: BTreeMap<ObjectId, ServerRecord>,
}

/// Objects that a client is told of too much with one datagram.
const EXTRA_MAX: usize = 4;

/// A bound from before a violation is sent again so often.
const AGAIN: u32 = 12;

impl Liar {
    fn pass(&mut self, message: &Passing<'_>) -> Verdict {
        match message.direction {
            Direction::Up => self.pass_up(message),
            Direction::Down => self.pass_down(message),
        }
    }

    fn pass_up(&mut self, message: &Passing<'_>) -> Verdict {
        let Ok((mut header, mut records)) = codec::decode_client_datagram(message.bytes) else {
            return Verdict::AsRuled;
        };
        let victim = self.clients.entry(message.client).or_default();
        for record in &records {
            match *record {
                ClientRecord::Request { object, want, .. } => {
                    victim.asked.insert(object, (want, 0));
                    victim.released.remove(&object);
                }
                ClientRecord::Release { object, .. } => {
                    victim.released.insert(object);
                }
                ClientRecord::Pose { .. } | ClientRecord::Eye { .. } | ClientRecord::ViolationAck { .. } => {}
            }
        }
        match self.mutant {
            Mutant::AcknowledgeLost => header.link.ack_bits = u32::MAX,
            Mutant::ViolationAckedEarly => {
                let sent = victim.violations.drain(..);
                records.extend(sent.map(|(object, issue)| ClientRecord::ViolationAck { object, issue }));
            }
            _ => return Verdict::AsRuled,
        }
        let mut writer = DatagramWriter::new(&header, DATAGRAM_BYTES_MAX);
        records.iter().for_each(|record| {
            writer.push(record);
        });
        Verdict::Rewrite(writer.finish())
    }

    fn pass_down(&mut self, message: &Passing<'_>) -> Verdict {
        let Ok((mut header, mut records)) = codec::decode_server_datagram(message.bytes) else {
            return Verdict::AsRuled;
        };
        let victim = self.clients.entry(message.client).or_default();
        victim.sent += 1;
        for record in &records {
            match *record {
                ServerRecord::State { object, .. } => {
                    self.poses.insert(object, *record);
                }
                ServerRecord::Violation { object, issue, .. } => {
                    victim.violations.push((object, issue));
                    if let Some((bound, tick)) = victim.bounds.remove(&object) {
                        victim.again.insert(object, (bound, tick, AGAIN));
                    }
                }
                ServerRecord::Bound { object, .. } => {
                    victim.bounds.insert(object, (*record, header.tick));
                }
                ServerRecord::Hidden { .. } => {}
            }
        }
        if self.mutant == Mutant::NumberTwice && victim.sent.is_multiple_of(8) {
            header.link.seq = header.link.seq.saturating_sub(1).max(1);
        }
        self.lie(message.client, &header, &mut records);
        let mut writer = DatagramWriter::new(&header, message.bytes.len().max(1100));
        records.iter().for_each(|record| {
            writer.push(record);
        });
        let bytes = writer.finish();
        if bytes == message.bytes { Verdict::AsRuled } else { Verdict::Rewrite(bytes) }
    }

    fn lie(&mut self, client: usize, header: &ServerHeader, records: &mut Vec<ServerRecord>) {
        let victim = self.clients.entry(client).or_default();
        let steps = |metres: f64| (metres / QUANTUM_METRES) as u32;
        if self.mutant == Mutant::ViolationForgotten {
            let is_forgotten = |object: ObjectId, issue: Issue| (object.0 + issue.0).is_multiple_of(4);
            records.retain(|record| {
                !matches!(*record, ServerRecord::Violation { object, issue, .. } if is_forgotten(object, issue))
            });
        }
        if self.mutant == Mutant::SubscriptionLost {
            records.retain(|record| match record {
                ServerRecord::State { object, .. } => match victim.asked.get_mut(object) {
                    Some((Want::State, told)) => {
                        *told += 1;
                        *told == 1
                    }
                    _ => true,
                },
                _ => true,
            });
        }
        for record in records.iter_mut() {
            match record {
                ServerRecord::Bound { object, tbv } => match self.mutant {
                    Mutant::RadiusInward => tbv.radius_steps -= tbv.radius_steps % steps(1.0 / 16.0),
                    Mutant::ExpiryOutward => tbv.valid_millis = tbv.valid_millis.saturating_add(1),
                    Mutant::NoSlack if tbv.speed_steps > 0 => {
                        tbv.radius_steps = tbv.radius_steps.saturating_sub(steps(0.12));
                    }
                    Mutant::NoGrowth => tbv.speed_steps = 0,
                    Mutant::FreshJitter if tbv.speed_steps > 0 => {
                        let angle = self.chance.random_range(0.0..std::f64::consts::TAU);
                        let reach = self.chance.random_range(0.0..1.0f64).sqrt();
                        let way = DVec3::new(angle.cos(), 0.0, angle.sin()) * reach;
                        let truly = self.places.now(*object).map(|place| place.metres());
                        if let Some(Ok(centre)) = truly.map(|truly| Position::from_metres(truly + way)) {
                            tbv.centre = centre;
                        }
                    }
                    Mutant::PoseForBound => {
                        if let Some(pose) =
                            self.poses.get(object).and_then(|pose| moved(pose, self.places.now(*object)?))
                        {
                            *record = pose;
                        }
                    }
                    _ => {}
                },
                ServerRecord::State { object, position, .. } => match self.mutant {
                    Mutant::PlaceRounded => position.x &= !1,
                    Mutant::AnotherTick => *position = self.places.before(*object).unwrap_or(*position),
                    _ => {}
                },
                ServerRecord::Violation { .. } | ServerRecord::Hidden { .. } => {}
            }
        }
        if self.mutant == Mutant::ReleaseForgotten {
            let extra =
                victim.released.iter().filter_map(|object| moved(self.poses.get(object)?, self.places.now(*object)?));
            records.extend(extra.take(EXTRA_MAX));
        }
        if self.mutant == Mutant::AcceptStaleIssue {
            records.extend(victim.again.values().filter_map(|(bound, tick, _)| aged(bound, header.tick.since(*tick))));
            victim.again.retain(|_, (.., times)| {
                *times -= 1;
                *times > 0
            });
        }
    }
}

/// The same pose record of another place.
fn moved(pose: &ServerRecord, place: Position) -> Option<ServerRecord> {
    let mut pose = *pose;
    let ServerRecord::State { position, .. } = &mut pose else { return None };
    *position = place;
    Some(pose)
}

/// The same bound in a datagram of a later tick.
fn aged(bound: &ServerRecord, by: Duration) -> Option<ServerRecord> {
    let mut bound = *bound;
    let ServerRecord::Bound { tbv, .. } = &mut bound else { return None };
    tbv.age_micros = tbv.age_micros.checked_add(u32::try_from(by.as_micros()).ok()?)?;
    tbv.valid_millis = tbv.valid_millis.checked_sub(u32::try_from(by.as_millis()).ok()?)?;
    Some(bound)
}
