//! Whole-system tests: worlds, clients and links in virtual time, and checkers that know the truth.
//!
//! [`Pair`] is one server, one client, one link. Towns of many clients, and the checkers, are the simulator's
//! ([`eyeline_sim::soak`]). The scenarios are in `tests/it`.

pub mod fuzz;
mod pair;

pub use pair::{HIDDEN, Log, OPEN, Pair, PairBuilder};
