//! What a server of many people costs: people who are cheap to play, and the bare transport to hold the server against.

pub mod churn;
pub mod echo;
pub mod feed;
pub mod process;
pub mod throng;
pub mod ways;
