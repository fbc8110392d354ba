//! Everything that is said, in both directions.
//!
//! Two ways: the *control stream* (reliable, in order, one bidirectional QUIC stream, each message behind a u32
//! length) and *datagrams* (a header and as many records as fit; newest wins). A **message** in every count is one
//! record about one object.
//!
//! ```text
//! datagram, client to server      bytes          datagram, server to client      bytes
//! seq ack ack_bits hold           4..20          seq ack ack_bits hold           4..20
//! frame                           1..9           sent                            1..9
//! record*                                        tick                            1..9
//!                                                record*
//!
//! record                          bytes          record                          bytes
//! 0 Pose                          20             0 State                         23..29
//!   object position orientation   3 12 4           object position orientation   3 12 4
//!                                                  velocity                      3..9
//! 1 Request                       6              1 Bound                         21..41
//!   object want reason            3 1 1            object centre                 3 12
//! 2 Release                       5                radius speed age valid issue  1..5 each
//!   object want_bound             3 1            2 Violation                     7..19
//! 3 ViolationAck                  5..9             object issue age present      3 1..5 1..9 1
//!   object issue                  3 1..5         3 Hidden                        4
//! 4 Eye                           17               object                        3
//!   position orientation          12 4
//!
//! control, client to server       bytes          control, server to client       bytes
//! 0 Hello                         at most 1,321  0 Welcome                       19 an avatar, 50..315 a class
//! 1 WorldWanted                   1              1 Refused                       the reason's length and 3 or more
//! 2 Place                         17             2 Roster                        9..566 an entry
//!   object position present       3 12 1         3 Left                          3 an object
//! 3 Goodbye                       1              4 Held                          5
//! 4 Take                          4                object hold                   3 1
//! 5 LetGo                         4              5 Payload                       its length and 5 or more
//! 6 Payload                       5..1,031         object bytes                  3 1..1,027
//!   object bytes                  3 1..1,027     6 Said                          the text's length and 2 or more
//! 7 Command                       2..1,037       7 Clients                       10..537 an entry
//!                                                8 Done                          the text's length and 3 or more
//! ```
//!
//! The first byte of a record or control message is its number in this table. Integers are bincode's variable-length
//! ones (1 byte up to 250, then a marker and 2, 4 or 8 bytes; signed ones in zigzag), except within ids, positions and
//! orientations, which are fixed little-endian bytes. `tests/wire/golden.rs` spells out the bytes of each.

use serde::{Deserialize, Serialize};

use crate::{
    ClassId, ClientEntry, ClientId, Command, Continuity, Extent, Hold, Issue, LinkHeader, MotionBound, ObjectId,
    Orientation, Position, Rank, Resume, Tbv, Velocity, WorldTime,
};
use crate::{QUANTUM_METRES, untrusted};

/// Who the client wants to be.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Role {
    /// Looks, and has one avatar that others see.
    Avatar,
    /// Only moves this many avatars and looks at nothing: a replay.
    Actor {
        /// Number of avatars to drive.
        avatars: u16,
    },
    /// Looks, from wherever it says that its eye is, and has no avatar.
    Viewer,
}

/// Which directions a client wants to hear of.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Interest {
    /// All, since a turn of the head beats any lead.
    Around,
    /// Its view's frustum only (the paper's).
    Frustum,
}

impl std::fmt::Display for Interest {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Interest::Around => "around",
            Interest::Frustum => "frustum",
        })
    }
}

/// Client to server, on the control stream.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum ClientControl {
    /// The first message.
    Hello {
        /// [`crate::VERSION`] of the client.
        version: u16,
        /// Admission token; empty for anonymous.
        #[serde(deserialize_with = "untrusted::list")]
        token: Vec<u8>,
        /// Greatest resolution that it will draw at, pixels.
        resolution: (u16, u16),
        /// Which directions it wants to hear of.
        interest: Interest,
        /// Who it wants to be.
        role: Role,
        /// A name for people.
        #[serde(deserialize_with = "untrusted::string")]
        name: String,
        /// Whether it was here before, and comes back. Role and name are then those it had.
        resume: Option<Resume>,
    },
    /// Asks for the world's bytes, on a stream of their own.
    WorldWanted,
    /// Puts one of its own avatars somewhere, breaking its bound: a teleport, or leaving and entering the world.
    Place {
        /// Which avatar.
        object: ObjectId,
        /// Where to.
        position: Position,
        /// Whether it is in the world from now on.
        present: bool,
    },
    /// The last message.
    Goodbye,
    /// Wants to move a thing: [`ServerControl::Held`] answers. Whose it is moves it with poses, held to its class's bound.
    Take {
        /// Which.
        object: ObjectId,
    },
    /// Has put it down.
    LetGo {
        /// Which.
        object: ObjectId,
    },
    /// Something of the application's, about one of its own avatars or things, for those who are told of that.
    Payload {
        /// About which.
        object: ObjectId,
        /// At most [`crate::PAYLOAD_BYTES_MAX`].
        #[serde(deserialize_with = "untrusted::list")]
        bytes: Vec<u8>,
    },
    /// Keeps order, as an operator may: [`ServerControl::Done`] answers.
    Command(Command),
}

/// A kind of object.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Class {
    /// Name for people, and of the world file.
    #[serde(deserialize_with = "untrusted::string")]
    pub name: String,
    /// How it moves.
    pub motion: MotionBound,
    /// How far it reaches.
    pub extent: Extent,
    /// Height of the eye above the reference point, metres; 0 for things without one.
    pub eye_height: f64,
    /// How fast it turns about +Y at most, radians a second, enforced by the server; `None` if that is not bounded.
    pub turn_max: Option<f64>,
}

/// Names the static world.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct WorldInfo {
    /// Name for people.
    #[serde(deserialize_with = "untrusted::string")]
    pub name: String,
    /// SHA-256 of the model's bytes.
    pub hash: [u8; 32],
    /// Size of the model.
    pub size_bytes: u64,
    /// Whether every face counts as having two sides, whatever its material says.
    pub two_sided: bool,
}

/// What an admitted client must know.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Welcome {
    /// [`crate::VERSION`] of the server.
    pub version: u16,
    /// The client's own number.
    pub client: ClientId,
    /// Its avatars, and where they stand.
    #[serde(deserialize_with = "untrusted::list")]
    pub avatars: Vec<(ObjectId, Position, Orientation)>,
    /// Point of the model's space that all positions are relative to, metres.
    pub anchor: [f64; 3],
    /// World time between ticks, microseconds.
    pub tick_micros: u32,
    /// How long an answer waits at the server at most, microseconds: a lead has to cover it. 0 if requests are answered on arrival.
    pub answer_micros: u32,
    /// The interest policy's name.
    #[serde(deserialize_with = "untrusted::string")]
    pub policy: String,
    /// Whether the client decides what to ask for (the policy `visible`), or is told.
    pub tracking: bool,
    /// Least radius within which a hidden object's place is kept uncertain, metres.
    pub blur: f64,
    /// States are told only when what was told before would be drawn wrong by more than so many pixels; `None` if at each
    /// change.
    pub dead_reckoning_px: Option<f64>,
    /// The static world.
    pub world: WorldInfo,
    /// Kinds of objects; a [`ClassId`] is an index.
    #[serde(deserialize_with = "untrusted::list")]
    pub classes: Vec<Class>,
    /// Roster entries that follow at once. Who has them all knows which nodes of the model move, and so what stands.
    pub objects: u32,
    /// What this client may do.
    pub rank: Rank,
    /// What to come back with if the connection is lost.
    pub resume: [u8; 16],
    /// For how long its avatars then wait for it, milliseconds; 0 if they don't.
    pub grace_millis: u32,
    /// Whether it has come back.
    pub continuity: Continuity,
}

/// One object that exists. Says nothing of where it is beyond `bound`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RosterEntry {
    /// Its id.
    pub object: ObjectId,
    /// Its kind.
    pub class: ClassId,
    /// A name for people.
    #[serde(deserialize_with = "untrusted::string")]
    pub name: String,
    /// Node of the model with its mesh; empty for an avatar.
    #[serde(deserialize_with = "untrusted::string")]
    pub node: String,
    /// A first bound, so that it need not be asked for; `None` if it is not in the world or the policy needs none.
    pub bound: Option<WireTbv>,
    /// Its issue number.
    pub issue: Issue,
    /// Whether it is in the world.
    pub present: bool,
}

/// Why a client was not admitted or is sent away.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Refusal {
    /// Another [`crate::VERSION`].
    Version,
    /// No avatar or session is free.
    Full,
    /// It said something that makes no sense.
    Protocol,
    /// The server ends.
    ShuttingDown,
    /// Its token is missing, wrong, revoked or too old, or does not let it be what it wants to be.
    Token,
    /// It is not to come back.
    Banned,
    /// An operator sent it away.
    Kicked,
    /// It asks for more than the server's limits allow.
    Busy,
    /// It has come back over another connection.
    Replaced,
}

/// Server to client, on the control stream.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum ServerControl {
    /// The client is in.
    Welcome(Box<Welcome>),
    /// It is not, or no longer.
    Refused {
        /// Why, for programs.
        refusal: Refusal,
        /// Why, for people, with the remedy.
        #[serde(deserialize_with = "untrusted::string")]
        reason: String,
    },
    /// Objects that exist, in pieces.
    Roster {
        /// World time of the state that the bounds were made from.
        tick: WorldTime,
        /// At most [`ServerControl::ROSTER_MAX`].
        #[serde(deserialize_with = "untrusted::list")]
        entries: Vec<RosterEntry>,
    },
    /// These objects exist no more.
    Left {
        /// Their ids.
        #[serde(deserialize_with = "untrusted::list")]
        objects: Vec<ObjectId>,
    },
    /// Whose a thing is now: the answer to [`ClientControl::Take`] and [`ClientControl::LetGo`].
    Held {
        /// Which.
        object: ObjectId,
        /// Whose.
        hold: Hold,
    },
    /// Something of the application's.
    Payload {
        /// About which object, that this client is told of; `None` if it is the server's own.
        object: Option<ObjectId>,
        /// At most [`crate::PAYLOAD_BYTES_MAX`].
        #[serde(deserialize_with = "untrusted::list")]
        bytes: Vec<u8>,
    },
    /// An operator or the server says something to people.
    Said {
        /// What.
        #[serde(deserialize_with = "untrusted::string")]
        text: String,
    },
    /// Who is here, in pieces; [`ServerControl::Done`] ends them.
    Clients {
        /// At most [`ServerControl::ROSTER_MAX`].
        #[serde(deserialize_with = "untrusted::list")]
        entries: Vec<ClientEntry>,
    },
    /// What came of a [`Command`].
    Done {
        /// Whether it was done.
        ok: bool,
        /// What was done, or why not, for people.
        #[serde(deserialize_with = "untrusted::string")]
        text: String,
    },
}

impl ServerControl {
    /// Most entries in one piece of roster, or of a list of clients.
    pub const ROSTER_MAX: usize = 256;
}

/// Head of a client's datagram.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ClientHeader {
    /// Delivery.
    pub link: LinkHeader,
    /// The client's idea of the world's time at its newest frame.
    pub frame: WorldTime,
}

/// Head of a server's datagram.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ServerHeader {
    /// Delivery.
    pub link: LinkHeader,
    /// The server's clock when the datagram was made.
    pub sent: WorldTime,
    /// World time of the committed state that every record speaks of.
    pub tick: WorldTime,
}

impl ServerHeader {
    /// The most bytes that it takes: four numbers of 32 bits and two times, each with a byte that says how long it is.
    pub const BYTES_MAX: usize = 4 * 5 + 2 * 9;
}

/// What the client asks an answer for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Want {
    /// A fresh bound.
    Bound,
    /// The state, and updates from now on.
    State,
    /// The state, once: to find out whether the object itself is in sight, without a release if it is not.
    Place,
}

/// Why a client asks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Reason {
    /// It holds no bound yet.
    Unknown,
    /// The bound became visible.
    Exposed,
    /// The bound's time is up.
    Expired,
    /// The object broke its bound.
    Violated,
}

/// Client to server, in a datagram.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum ClientRecord {
    /// Where one of its avatars is. 20 bytes.
    Pose {
        /// Which avatar.
        object: ObjectId,
        /// Its reference point.
        position: Position,
        /// How it is turned.
        orientation: Orientation,
    },
    /// Asks about an object. Idempotent; sent again until answered.
    Request {
        /// About which.
        object: ObjectId,
        /// For what.
        want: Want,
        /// Why, for the counters.
        reason: Reason,
    },
    /// The object can't be seen any more: no more updates. Sent again while updates come.
    Release {
        /// Which.
        object: ObjectId,
        /// Whether to answer with a fresh bound.
        want_bound: bool,
    },
    /// Has heard of a violation.
    ViolationAck {
        /// Of which object.
        object: ObjectId,
        /// The issue number heard of.
        issue: Issue,
    },
    /// Where its own eye is, if not at its avatar's. 17 bytes.
    Eye {
        /// The eye itself.
        position: Position,
        /// How it looks.
        orientation: Orientation,
    },
}

/// A [`Tbv`] as it is sent: rounded outward, and relative to the time of its carrier.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct WireTbv {
    /// Middle of the ball.
    pub centre: Position,
    /// Radius in steps of 2⁻¹⁰ m, rounded up.
    pub radius_steps: u32,
    /// Growth in steps of 2⁻¹⁰ m a second, rounded up.
    pub speed_steps: u32,
    /// How long before the carrier's tick it was issued, microseconds.
    pub age_micros: u32,
    /// How long after the carrier's tick it expires, milliseconds, rounded down.
    pub valid_millis: u32,
    /// The object's issue number.
    pub issue: Issue,
}

impl WireTbv {
    /// The bound as it is sent in a carrier of time `tick`, rounded outward in space and inward in time. `None` if the
    /// bound is too wide or too fast for the wire, or has expired: then nothing can be said ("everywhere").
    pub fn new(tbv: &Tbv, tick: WorldTime) -> Option<WireTbv> {
        let up = |metres: f64| {
            let steps = (metres / QUANTUM_METRES).ceil();
            (steps <= f64::from(u32::MAX)).then_some(steps as u32) // NaN fails
        };
        if tbv.issued > tick || tbv.expires < tick {
            return None;
        }
        let valid = tbv.expires.since(tick).as_millis();
        Some(WireTbv {
            centre: tbv.centre,
            radius_steps: up(tbv.radius)?,
            speed_steps: up(tbv.speed)?,
            age_micros: u32::try_from(tick.since(tbv.issued).as_micros()).ok()?,
            valid_millis: u32::try_from(valid).unwrap_or(u32::MAX),
            issue: tbv.issue,
        })
    }

    /// The bound that a carrier of time `tick` speaks of. Contains the one it was made from.
    pub fn tbv(&self, tick: WorldTime) -> Tbv {
        Tbv {
            centre: self.centre,
            radius: f64::from(self.radius_steps) * QUANTUM_METRES,
            speed: f64::from(self.speed_steps) * QUANTUM_METRES,
            issued: tick.offset_micros(-i64::from(self.age_micros)),
            expires: tick.offset_micros(i64::from(self.valid_millis) * 1000),
            issue: self.issue,
        }
    }
}

/// Server to client, in a datagram. All are true at the header's `tick`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum ServerRecord {
    /// Where a visible object is. 23 bytes, or up to 29 while it moves.
    State {
        /// Which.
        object: ObjectId,
        /// Its reference point.
        position: Position,
        /// How it is turned.
        orientation: Orientation,
        /// How it goes on until the next state; zero without dead reckoning.
        velocity: Velocity,
    },
    /// Where a hidden object may be.
    Bound {
        /// Which.
        object: ObjectId,
        /// The volume.
        tbv: WireTbv,
    },
    /// The object broke every bound of an older issue. Sent again until acknowledged.
    Violation {
        /// Which.
        object: ObjectId,
        /// The issue number from now on.
        issue: Issue,
        /// How long before the header's tick it happened, microseconds. What is known from before that is void.
        age_micros: u64,
        /// Whether the object is in the world now.
        present: bool,
    },
    /// The server no longer tells of this object (policies that decide at the server).
    Hidden {
        /// Which.
        object: ObjectId,
    },
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::METRES_MAX;

    const STEPS_MAX: f64 = u32::MAX as f64 * QUANTUM_METRES;

    fn tbv(radius: f64, speed: f64, issued: i64, expires: i64) -> Tbv {
        Tbv {
            centre: Position { x: i32::MIN, y: 0, z: i32::MAX },
            radius,
            speed,
            issued: WorldTime::from_micros(issued),
            expires: WorldTime::from_micros(expires),
            issue: Issue(3),
        }
    }

    /// Wherever and whenever the sent bound says something, it says no more than the one it was made from.
    fn assert_contains(wire: &Tbv, tbv: &Tbv, time: WorldTime) {
        assert_eq!((wire.centre, wire.issue, wire.issued), (tbv.centre, tbv.issue, tbv.issued));
        assert!(
            wire.radius >= tbv.radius && wire.speed >= tbv.speed && wire.expires <= tbv.expires,
            "{wire:?} {tbv:?}"
        );
        assert!(wire.radius.is_finite() && wire.speed.is_finite());
        if wire.holds_at(time) {
            assert!(tbv.holds_at(time));
            assert!(wire.radius_at(time) >= tbv.radius_at(time), "{wire:?} {tbv:?} at {time:?}");
        }
    }

    #[test]
    fn what_the_wire_cannot_carry_is_not_sent() {
        let tick = WorldTime::from_micros(50);
        let sent = |radius, speed, issued, expires| WireTbv::new(&tbv(radius, speed, issued, expires), tick).is_some();
        assert!(sent(1.0, 1.0, 50, 50));
        for bad in [f64::NAN, f64::INFINITY, STEPS_MAX + 1e-6, f64::MAX, 4.0 * METRES_MAX] {
            assert!(!sent(bad, 1.0, 50, 50), "radius {bad}");
            assert!(!sent(1.0, bad, 50, 50), "speed {bad}");
        }
        assert!(sent(STEPS_MAX, STEPS_MAX, 50, 50));
        assert!(!sent(1.0, 1.0, 51, 90), "issued after the tick");
        assert!(!sent(1.0, 1.0, 10, 49), "expired");
        assert!(sent(1.0, 1.0, 50 - i64::from(u32::MAX), 50));
        assert!(!sent(1.0, 1.0, 49 - i64::from(u32::MAX), 50), "too old");
        assert!(!sent(1.0, 1.0, i64::MIN, i64::MAX), "too old");
        assert!(sent(1.0, 1.0, 50, i64::MAX), "a bound that never expires is sent with a shorter life");
    }

    fn sizes() -> impl Strategy<Value = f64> {
        prop_oneof![
            Just(0.0),
            Just(f64::MIN_POSITIVE),
            Just(5e-324),
            Just(QUANTUM_METRES),
            Just(STEPS_MAX),
            0.0..1e-3f64,
            0.0..1e3f64,
            0.0..STEPS_MAX,
            any::<f64>(),
        ]
    }

    fn times() -> impl Strategy<Value = i64> {
        prop_oneof![Just(i64::MIN), Just(i64::MAX), Just(0), -100_000_000..100_000_000i64, any::<i64>()]
    }

    proptest! {
        #[test]
        fn a_sent_bound_contains_the_one_it_was_made_from(
            radius in sizes(),
            speed in sizes(),
            tick in times(),
            age in prop_oneof![Just(0), Just(i64::from(u32::MAX)), 0..i64::from(u32::MAX), any::<i64>()],
            valid in prop_oneof![Just(0), 0..2000i64, 0..86_400_000_000i64, any::<i64>()],
            later in prop_oneof![Just(0), 0..100_000_000i64, any::<i64>()],
        ) {
            let tick = WorldTime::from_micros(tick);
            let time = tick.offset_micros(later);
            let tbv = tbv(radius, speed, tick.offset_micros(age.saturating_neg()).micros(), tick.offset_micros(valid).micros());
            match WireTbv::new(&tbv, tick) {
                Some(wire) => assert_contains(&wire.tbv(tick), &tbv, time),
                None => prop_assert!(
                    !(radius <= STEPS_MAX && speed <= STEPS_MAX)
                        || tbv.issued > tick
                        || tbv.expires < tick
                        || tick.since(tbv.issued).as_micros() > u128::from(u32::MAX)
                ),
            }
        }

        /// A hostile bound is as harmless as any: finite, with an expiry that saturates.
        #[test]
        fn any_wire_bound_is_a_bound(
            radius_steps: u32, speed_steps: u32, age_micros: u32, valid_millis: u32, tick in times(), time in times(),
        ) {
            let wire = WireTbv {
                centre: Position::default(), radius_steps, speed_steps, age_micros, valid_millis, issue: Issue(0),
            };
            let tbv = wire.tbv(WorldTime::from_micros(tick));
            prop_assert!(tbv.issued <= tbv.expires);
            prop_assert!(tbv.radius_at(WorldTime::from_micros(time)).is_finite());
        }
    }
}
