//! The shared world: who is where, and who may be told.

pub mod path;
pub mod spec;
