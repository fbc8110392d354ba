//! The shared world: who is where, and who may be told.
//!
//! [`world::World`] is a pure state machine that runs over real QUIC and in virtual time alike; a [`policy::Policy`]
//! decides what each client is told.

#[cfg(all(feature = "net", feature = "audit"))]
pub mod app;
pub mod audit;
pub mod gate;
#[cfg(any(feature = "net", feature = "audit"))]
mod hash;
#[cfg(feature = "audit")]
pub mod model;
#[cfg(feature = "net")]
pub mod net;
pub mod path;
pub mod policy;
pub mod spec;
pub mod world;
