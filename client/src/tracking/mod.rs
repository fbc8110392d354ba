//! *Occlusion + time → requests*: the TBV algorithm of Sudarsky & Gotsman 1999, §3.3, without socket or clock.
//!
//! The paper's structures keep their names: **T** is the [`DynamicIndex`](eyeline_visibility::DynamicIndex) of bounds, **D** the entries, **Q** the queue
//! of stage ends and expiries, **V** the set of (potentially) visible objects. Beyond the paper the client chooses
//! validity *without messages*: a bound from the wire grows with time, T holds it grown to the end of a stage, and Q's
//! events put it back grown further while it stays hidden. Only an exposed bound, or one at its expiry, costs a request.

mod config;
mod stats;
mod tracker;

pub use config::{Growth, Sabotage, TrackerConfig};
pub use stats::TrackerStats;
pub use tracker::{Drawn, Tracker};
