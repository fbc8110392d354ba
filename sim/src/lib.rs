//! Scenes, motion, measurement and reports.

pub mod motion;
pub mod places;
pub mod report;
pub mod scene;

/// A seeded source of chance for one purpose. Each purpose has its own stream, so that taking one draw more for chairs
/// does not move a door.
pub(crate) fn chance(seed: u64, purpose: u64) -> rand_pcg::Pcg64 {
    rand_pcg::Pcg64::new(u128::from(seed), u128::from(purpose))
}
