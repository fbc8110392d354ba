//! What do cullers cost, and what do they get wrong? The library part of `eyeline-sim cull`.
//!
//! [`world`] says what is looked at and a [`CameraPath`] from where; [`registry`] knows the cullers and what can be chosen for each,
//! [`budget`] among it, and [`shop`] makes them, [`plp`] with a budget that may change from view to view; [`run`] holds them against
//! the exact set and the clock (with [`max_pass`] as the yardstick), by [`fragments`] also in z-tests; [`report`] and [`picture`]
//! show it, with the columns of [`row`], and [`frames`] view by view. [`gpu`] adds the cullers of a graphics adapter, if it was built in.

pub mod budget;
pub mod candidate;
mod entries;
pub mod fragments;
pub mod frames;
pub mod gpu;
pub mod max_pass;
pub mod picture;
pub mod plp;
pub mod registry;
pub mod report;
pub mod row;
pub mod run;
pub mod shop;
mod tally;
mod truth;
pub mod world;

pub use budget::{AskedBudget, BudgetError, BudgetKind};
pub use candidate::{Candidate, WithScratch};
pub use eyeline_visibility::{Camera, CameraPath, CameraPathError as PathError, CameraStop as Stop};
pub use frames::FrameRow;
pub use max_pass::MaxPass;
pub use registry::{Budgets, Entry, Registry, Setting, Sweep, SweepError};
pub use row::{CullRow, columns};
pub use run::{CullConfig, Outcome};
pub use shop::Shop;
pub use world::{World, WorldRules};
