//! What both ends of Eyeline agree on: ids, time, motion bounds, temporal bounding volumes, messages and their bytes.
//!
//! # The idea
//! A client is told only about what it could see. For what is hidden from it, it holds a **temporal bounding volume**
//! (TBV; Sudarsky & Gotsman 1999): a volume that contains the object from `issued` until `expires`, because nothing
//! moves faster than its [`MotionBound`]. As long as walls hide the volume they hide the object, wherever in it that
//! is, and nobody need say anything. Only when the volume comes into view, or its time is up, does the client ask; the
//! answer is a fresh volume, or the object's state from now on.
//!
//! Ours grow: at a time t the object's reference point is in the ball of `radius + speed·(t − issued)`. So a client
//! picks a moment, tests the ball as large as it will be then, and is silent until that moment; the shorter the time,
//! the smaller the ball. A validity period costs no message.
//!
//! ```
//! use std::time::Duration;
//! use eyeline_protocol::{Issue, Position, Tbv, WireTbv, WorldTime};
//!
//! // The server knows where somebody is at this tick, and that nobody walks faster than 2 m/s.
//! let tick = WorldTime::from_micros(5_000_000);
//! let tbv = Tbv {
//!     centre: Position::from_metres(glam::DVec3::new(3.0, 0.0, -7.5))?,
//!     radius: 1.0,
//!     speed: 2.0,
//!     issued: tick,
//!     expires: tick + Duration::from_secs(60),
//!     issue: Issue(0),
//! };
//! // It crosses the wire rounded outward, relative to the tick of the datagram that carries it.
//! let held = WireTbv::new(&tbv, tick).expect("neither too wide nor expired").tbv(tick);
//!
//! // Half a second later somebody is at most 2 m from there. If a ball of 2 m is hidden, so are they.
//! let later = tick + Duration::from_millis(500);
//! assert!(held.holds_at(later));
//! assert!((2.0..2.001).contains(&held.radius_at(later)));
//! assert!(held.contains(glam::DVec3::new(4.0, 0.0, -7.5), later));
//! # Ok::<(), eyeline_protocol::OutOfRange>(())
//! ```
//!
//! An object that must break its bound (it teleports) gets a new [`Issue`] number, and every volume of an older one is
//! void.
//!
//! # What is here
//! Messages are listed, with their sizes, in the source of `message.rs`: [`ClientControl`] and [`ServerControl`] on a
//! reliable stream, [`ClientRecord`] and [`ServerRecord`] packed into datagrams. [`codec`] alone knows the wire format
//! and fears no bytes; [`Message::check`] says what is legal. [`Link`] numbers datagrams and learns what arrived. Peers
//! compare [`VERSION`] when they connect.
//!
//! Nothing here does I/O or reads a clock. Positions on the wire are fixed point ([`Position`]) relative to the world's
//! anchor, so that both ends compute with exactly the same numbers; whatever bounds an object rounds outward.

mod check;
pub mod codec;
mod dead_reckoning;
mod ids;
mod link;
mod message;
mod motion;
mod people;
mod plan;
mod position;
mod tbv;
mod time;
mod untrusted;

pub use check::{AVATARS_MAX, CLASSES_MAX, Message, NAME_BYTES_MAX, TOKEN_BYTES_MAX};
pub use dead_reckoning::{ERROR_METRES_MAX, PREDICTED_MAX, Prediction, VELOCITY_QUANTUM, Velocity, pixels};
pub use ids::{ClassId, ClientId, Issue, ObjectId};
pub use link::{Arrival, Link, LinkHeader, RoundTrip};
pub use message::{
    Class, ClientControl, ClientHeader, ClientRecord, Interest, Reason, Refusal, Role, RosterEntry, ServerControl,
    ServerHeader, ServerRecord, Want, Welcome, WireTbv, WorldInfo,
};
pub use motion::{Extent, MotionBound};
pub use people::{ClientEntry, Command, Continuity, Hold, PAYLOAD_BYTES_MAX, Rank, Resume, TEXT_BYTES_MAX};
pub use plan::{Plan, PlanLine, PlanSwitch, PlanSwitchError, Stage, how_many};
pub use position::{METRES_MAX, Orientation, OutOfRange, Position, QUANTUM_METRES};
pub use tbv::Tbv;
pub use time::{LocalTime, WorldTime};

/// Version of everything in this crate. Peers with different versions part at hello.
pub const VERSION: u16 = 4;

/// How far an actor's eye may be from its avatar's, metres.
pub const EYE_REACH: f64 = 2.0;

/// How far a thing that is taken may be from the avatar that takes it, metres, as their edges go.
pub const TAKE_REACH: f64 = 1.5;

/// ALPN protocol name offered in the TLS handshake. It names no version: a peer of another one is to hear so in words.
pub const ALPN: &[u8] = b"eyeline";
