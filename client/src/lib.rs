//! The client: what it believes about the world, and what it asks.
