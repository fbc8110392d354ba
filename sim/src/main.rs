//! `eyeline-sim`: makes worlds, runs them, and measures.

fn main() {}
