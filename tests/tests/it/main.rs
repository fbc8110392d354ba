//! Whole-system scenarios, in virtual time but for `gate`, which needs real handshakes. Each name is a claim.

mod corpus;
mod events;
mod floods;
mod gate;
mod hostile;
mod mutants;
mod network;
mod promises;
mod quic_time;
mod seeds;
mod village;
mod walls;
