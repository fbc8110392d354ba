//! What would this world do over that network? A simulated network in virtual time, where one seed decides every loss,
//! delay, duplicate and reorder.
//!
//! [`VirtualRun`] drives the same pure cores as the QUIC shells do: one [`eyeline_server::world::World`] and any number of
//! [`eyeline_client::session::Session`]s. Virtual time is the server's clock, in whole microseconds; each client has a clock
//! of its own, with its own zero and, if wanted, its own pace. Nothing waits: an event queue jumps from one thing that
//! happens to the next, so that an hour costs what its messages cost.
//!
//! What is between cores and links is nothing ([`VirtualRun::new`]: each datagram is a packet) or QUIC itself
//! ([`VirtualRun::over_quic`]).
//!
//! Links follow turmoil's rules: a datagram's [`Fate`] is `Deliver(delay)` or `Drop`. Without QUIC the
//! control stream is reliable and ordered all the same: a loss costs it a retransmission's delay.

mod capacity;
mod client;
mod link;
mod observer;
pub(crate) mod queue;
mod run;
pub(crate) mod transport;

pub use capacity::{Blackout, Capacity};
pub use client::{Client, ClientDriver, ClientPlan, Pose};
pub use link::{Direction, Fate, Kind, LinkRules, LinkStats, VirtualLink};
pub use observer::{Framed, Ignore, Observer, Passing, Verdict};
pub use run::VirtualRun;
