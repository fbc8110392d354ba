//! The static scene as a client makes it: from the model's bytes and what the server said of them.
//!
//! A model alone does not say which of its nodes move (a `world.toml` at the server may), nor whether faces count
//! two-sided. The welcome and the roster do, so that both ends cull against the same triangles.

use std::collections::BTreeSet;

use eyeline_protocol::Welcome;
use eyeline_visibility::{LoadError, LoadOptions, Scene, load_glb};
use glam::DVec3;

/// Why a client has no scene.
#[derive(Debug, thiserror::Error)]
pub enum WorldError {
    /// The model can't be loaded, or lacks a node that the server says moves.
    #[error(transparent)]
    Load(#[from] LoadError),
    /// Loaded here, the model has another anchor than at the server, so no position would fit.
    #[error("{file}: its anchor is {found} here but {told} at the server; both must be of one version of Eyeline")]
    Anchor {
        /// The file.
        file: String,
        /// Ours.
        found: DVec3,
        /// The server's.
        told: DVec3,
    },
}

/// The scene of a model: `bytes` of a .glb, what the server's `welcome` says of it, and the names of the nodes that
/// move ([`crate::session::Session::moving_nodes`]). `name` stands for the file in errors.
///
/// # Errors
/// Names the file and what is wrong with it.
pub fn load(bytes: &[u8], name: &str, welcome: &Welcome, moving_nodes: &BTreeSet<String>) -> Result<Scene, WorldError> {
    let options = LoadOptions::default().with_moving_nodes(moving_nodes).with_two_sided(welcome.world.two_sided);
    let scene = load_glb(bytes, name, &options)?;
    let told = DVec3::from_array(welcome.anchor);
    if scene.anchor() != told {
        return Err(WorldError::Anchor { file: name.to_owned(), found: scene.anchor(), told });
    }
    Ok(scene)
}
