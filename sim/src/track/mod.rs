//! How do trackers fare, without a network? The library part of `eyeline-sim track`.
//!
//! [`world`] makes a building with things that move in it by [`mover`]; [`mod@run`] tracks them in several ways, frame by frame
//! side by side, and holds the pictures against the truth; [`sweep`] knows the paper's experiments and [`report`] puts what
//! came of them beside what the paper says, with the columns of [`row`]. [`lca`] and [`lca_sweep`] are its
//! §6.1.1: updates of an octree alone. [`tables`] are those of Coorg & Teller, where nothing moves but the [`observer`].

pub mod lca;
pub mod lca_sweep;
pub mod mover;
pub mod observer;
pub mod report;
pub mod row;
pub mod run;
pub mod sweep;
pub mod tables;
pub mod world;

pub use mover::MotionKind;
pub use observer::Observer;
pub use row::{TrackRow, columns};
pub use run::{IndexKind, RunRules, TrackSetting, run};
pub use sweep::{Finding, SWEEPS, SweepInfo, SweepOptions};
pub use world::{Chairs, EyeKind, TrackRules, TrackWorld};
