//! Trackers, cullers and their structures without a network.

pub mod lca;
