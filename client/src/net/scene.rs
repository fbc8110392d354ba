//! How a connected client comes to its scene: from a file, from a cache of models by their hash, or from the server.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use eyeline_protocol::Welcome;
use eyeline_visibility::{DynamicOctree, LoadError, Scene, pack_glb};

use super::{Connection, NetError};
use crate::world::{self, WorldError};

/// Where the model's bytes come from.
#[derive(Clone, Debug)]
pub enum ModelSource {
    /// The server.
    Fetch,
    /// This folder if it has the model, else the server; then it is kept in the folder.
    Cache(PathBuf),
    /// This file, which must be what the server serves.
    File(PathBuf),
}

/// Why a client has no scene.
#[derive(Debug, thiserror::Error)]
pub enum SceneError {
    /// The connection failed.
    #[error(transparent)]
    Net(#[from] NetError),
    /// The file can't be read.
    #[error(transparent)]
    File(#[from] LoadError),
    /// The file is another model than the server's.
    #[error("{}: not the world that the server serves ('{served}', other SHA-256); give that, or leave --world out to fetch it", path.display())]
    OtherModel {
        /// The file.
        path: PathBuf,
        /// Name of the server's world.
        served: String,
    },
    /// No scene can be made of the model.
    #[error(transparent)]
    World(#[from] WorldError),
    /// The model can't be kept.
    #[error("cannot keep the world in the cache, {}: {source}; choose another folder with --cache", path.display())]
    Cache {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
}

/// A model as the server serves it, not loaded yet.
#[derive(Clone, Debug)]
pub struct ServedModel {
    /// A .glb.
    pub bytes: Vec<u8>,
    /// What stands for the file in errors.
    pub name: String,
    /// What the server said of it.
    pub welcome: Welcome,
    /// Nodes that move.
    pub moving_nodes: BTreeSet<String>,
}

impl Connection {
    /// The model that the server's world is, from wherever it can be had.
    ///
    /// # Errors
    /// If it can't be had or is not the server's, or the connection is lost meanwhile.
    pub async fn model(&mut self, source: &ModelSource) -> Result<ServedModel, SceneError> {
        while self.session.moving_nodes().is_none() {
            self.wait_control().await?;
        }
        let (Some(welcome), Some(moving_nodes)) =
            (self.session.welcome().cloned(), self.session.moving_nodes().cloned())
        else {
            return Err(NetError::Lost("no welcome yet".into()).into());
        };
        let hash = welcome.world.hash;
        let (bytes, name) = match source {
            ModelSource::Fetch => (self.fetch_world().await?, welcome.world.name.clone()),
            ModelSource::File(path) => {
                let bytes = pack_glb(path)?;
                if digest(&bytes) != hash {
                    return Err(SceneError::OtherModel { path: path.clone(), served: welcome.world.name });
                }
                (bytes, path.display().to_string())
            }
            ModelSource::Cache(folder) => {
                let path = folder.join(hash.iter().map(|byte| format!("{byte:02x}")).collect::<String>() + ".glb");
                // What was cut off or changed meanwhile is fetched again.
                let kept = std::fs::read(&path).ok().filter(|bytes| digest(bytes) == hash);
                let bytes = match kept {
                    Some(bytes) => bytes,
                    None => {
                        let bytes = self.fetch_world().await?;
                        keep(&path, &bytes).map_err(|source| SceneError::Cache { path: path.clone(), source })?;
                        bytes
                    }
                };
                (bytes, path.display().to_string())
            }
        };
        Ok(ServedModel { bytes, name, welcome, moving_nodes })
    }

    /// The scene that the server's world is, and T made as large as it.
    ///
    /// # Errors
    /// If the model can't be had or is not the server's, or the connection is lost meanwhile.
    pub async fn scene(&mut self, source: &ModelSource) -> Result<Arc<Scene>, SceneError> {
        let ServedModel { bytes, name, welcome, moving_nodes } = self.model(source).await?;
        // Off this thread, which has the connection to keep alive.
        let load = move || world::load(&bytes, &name, &welcome, &moving_nodes);
        let loaded = tokio::task::spawn_blocking(load).await;
        let scene = loaded.map_err(|error| NetError::Lost(format!("loading the scene failed: {error}")))??;
        self.session.use_index(Box::new(DynamicOctree::new(scene.bounds())));
        Ok(Arc::new(scene))
    }
}

/// Written beside and renamed: another client that looks meanwhile finds all or nothing.
fn keep(path: &Path, bytes: &[u8]) -> std::io::Result<()> {
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder)?;
    }
    let new = path.with_extension(format!("{}.new", std::process::id()));
    std::fs::write(&new, bytes)?;
    std::fs::rename(&new, path)
}

/// SHA-256 of some bytes.
pub(super) fn digest(bytes: &[u8]) -> [u8; 32] {
    let digest = ring::digest::digest(&ring::digest::SHA256, bytes);
    let mut hash = [0; 32];
    hash.copy_from_slice(digest.as_ref());
    hash
}
