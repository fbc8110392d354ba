//! What both ends of Eyeline agree on: ids, time, motion bounds, temporal bounding volumes, messages and their bytes.
//!
//! Nothing here does I/O or reads a clock. Only [`codec`] knows the wire format; peers compare [`VERSION`] when they
//! connect. Positions on the wire are fixed point ([`Position`]) relative to the world's anchor, so that both ends
//! compute with exactly the same numbers; whatever bounds an object rounds outward.

mod check;
pub mod codec;
mod ids;
mod link;
mod message;
mod motion;
mod position;
mod tbv;
mod time;
mod untrusted;

pub use check::{AVATARS_MAX, CLASSES_MAX, Message, NAME_BYTES_MAX, TOKEN_BYTES_MAX};
pub use ids::{ClassId, ClientId, Issue, ObjectId};
pub use link::{Arrival, Link, LinkHeader, RoundTrip};
pub use message::{
    Class, ClientControl, ClientHeader, ClientRecord, Interest, Reason, Refusal, Role, RosterEntry, ServerControl,
    ServerHeader, ServerRecord, Want, Welcome, WireTbv, WorldInfo,
};
pub use motion::{Extent, MotionBound};
pub use position::{METRES_MAX, Orientation, OutOfRange, Position, QUANTUM_METRES};
pub use tbv::Tbv;
pub use time::{LocalTime, WorldTime};

/// Version of everything in this crate. Peers with different versions part at hello.
pub const VERSION: u16 = 1;

/// ALPN protocol name offered in the TLS handshake.
pub const ALPN: &[u8] = b"eyeline/1";
