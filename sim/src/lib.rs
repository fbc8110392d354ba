//! Scenes, motion, measurement and reports.

pub mod bake;
pub mod cull;
pub mod demo;
pub mod load;
pub mod measure;
pub mod motion;
pub mod people;
pub mod places;
pub mod plan;
mod quic_net;
pub mod relay;
pub mod report;
pub mod scene;
pub mod soak;
pub mod stability;
pub mod stage;
pub mod trace;
pub mod track;
pub mod virtual_net;

/// A seeded source of chance for one purpose. Each purpose has its own stream, so that taking one draw more for chairs
/// does not move a door.
pub(crate) fn chance(seed: u64, purpose: u64) -> rand_pcg::Pcg64 {
    rand_pcg::Pcg64::new(u128::from(seed), u128::from(purpose))
}

/// A folder of given scenes or recordings, `scenes` or `motion`; `None`, and a word about it, where they are absent.
#[cfg(test)]
pub(crate) fn given_data(folder: &str) -> Option<std::path::PathBuf> {
    let beside = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data");
    let path = std::env::var_os("EYELINE_DATA").map_or(beside, Into::into).join(folder);
    if !path.is_dir() {
        eprintln!("skipped: there is no {} (EYELINE_DATA names the folder)", path.display());
        return None;
    }
    Some(path)
}
