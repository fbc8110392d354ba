//! Whole-system scenarios in virtual time. Each name is a claim.

mod corpus;
mod events;
mod hostile;
mod mutants;
mod network;
mod promises;
mod quic_time;
mod seeds;
mod village;
mod walls;
