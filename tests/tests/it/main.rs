//! Whole-system scenarios in virtual time. Each name is a claim.

mod mutants;
mod network;
mod promises;
mod seeds;
mod walls;
