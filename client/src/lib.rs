//! The client: what it believes about the world, and what it asks.
//!
//! [`session::Session`] and [`tracking::Tracker`] are pure state machines: no socket, no clock, no thread. The feature
//! `net` adds the QUIC shell.

#[cfg(feature = "net")]
pub mod app;
pub mod clock;
#[cfg(feature = "net")]
pub mod net;
#[cfg(feature = "net")]
pub mod operate;
pub mod session;
pub mod tracking;
pub mod world;
