//! Whole-system scenarios in virtual time. Each name is a claim.

mod seeds;
mod walls;
