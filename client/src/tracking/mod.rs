//! *Occlusion + time → requests*: the TBV algorithm of Sudarsky & Gotsman 1999, §3.3, without socket or clock.
//!
//! The paper's structures keep their names: **T** is the [`DynamicIndex`](eyeline_visibility::DynamicIndex) of bounds, **D** the entries, **Q** the queue
//! of stage ends and expiries, **V** the set of (potentially) visible objects. Beyond the paper the client chooses
//! validity *without messages*: a bound from the wire grows with time, T holds it grown to the end of a stage, and Q's
//! events put it back grown further while it stays hidden. Only an exposed bound, or one at its expiry, costs a request.
//!
//! Where objects are at hand instead of behind a wire, a [`SceneTracker`] is the paper's algorithm in all its variants. A [`TemporalBound`] is made from what is known of their motion, for as long
//! as a [`Validity`] says; [`FuzzySpeeds`] stand in for limits that are unknown or loose (§3.2, §3.4, §3.5).

mod config;
mod dead_reckoning;
mod entries;
mod expiry;
mod explain;
mod fuzzy;
mod lead;
mod past;
mod scene_tracker;
mod shape;
mod stats;
mod tracker;
mod validity;

#[cfg(test)]
mod sealed_tests;

pub use config::{Growth, Sabotage, TrackerConfig};
pub use expiry::ExpiryQueue;
pub use explain::{BeliefKind, Decision, Explanation};
pub use fuzzy::{FuzzyError, FuzzySpeeds, broken};
pub use lead::{Ahead, LEAD_MAX, Lead};
pub(crate) use past::Past;
pub use scene_tracker::{Agents, FrameInput, FrameStats, Image, SceneTracker, Variant};
pub use shape::{MotionLimits, MotionState, PIECES_MAX, Path, TbvShape, TemporalBound, Trajectory};
pub use stats::TrackerStats;
pub use tracker::{Drawn, STALENESS_MAX, Tracker};
pub use validity::{Period, Validity};
