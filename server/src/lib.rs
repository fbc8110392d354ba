//! The shared world: who is where, and who may be told.
//!
//! [`world::World`] is a pure state machine that runs over real QUIC and in virtual time alike; a [`policy::Policy`]
//! decides what each client is told.

#[cfg(all(feature = "net", feature = "audit"))]
pub mod app;
pub mod audit;
#[cfg(all(feature = "net", feature = "audit"))]
pub mod config;
pub mod gate;
#[cfg(any(feature = "net", feature = "audit"))]
mod hash;
pub mod histogram;
#[cfg(feature = "audit")]
pub mod model;
#[cfg(feature = "net")]
pub mod net;
pub mod path;
pub mod policy;
pub mod spec;
#[cfg(feature = "net")]
pub mod stop;
#[cfg(feature = "net")]
pub mod token;
pub mod world;
