//! What do cullers cost, and what do they get wrong? The library part of `eyeline-sim cull`.
//!
//! [`world`] says what is looked at and [`path`] from where; [`registry`] knows the cullers and what can be chosen for each;
//! [`run`] holds them against the exact set and the clock, by [`fragments`] also in z-tests; [`report`] and [`picture`] show
//! it, with the columns of [`row`].

pub mod fragments;
pub mod path;
pub mod picture;
pub mod registry;
pub mod report;
pub mod row;
pub mod run;
pub mod world;

pub use path::{Camera, CameraPath, PathError};
pub use registry::{Candidate, Entry, Registry, Setting, Shop, Sweep, SweepError, WithScratch};
pub use row::{CullRow, columns};
pub use run::{CullConfig, MaxPass, Outcome};
pub use world::{World, WorldRules};
