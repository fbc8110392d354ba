//! What a server of many people costs: people who are cheap to play, and the bare transport to hold the server against.

pub mod feed;
pub mod ways;
