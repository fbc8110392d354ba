//! A made model with its cameras, for scenes in which nothing moves and nobody walks.

use std::path::Path;

use anyhow::Context;
use glam::{DVec2, DVec3};

use super::glb::GlbError;
use crate::cull::CameraPath;

/// A model and from where to look at it.
#[derive(Clone, Debug)]
pub struct MadeModel {
    /// The model.
    pub glb: Vec<u8>,
    /// All triangles, instances counted each time.
    pub triangles: usize,
    /// From where to look.
    pub cameras: CameraPath,
}

/// Why a model cannot be made.
#[derive(Debug, thiserror::Error)]
pub enum MadeError {
    /// It makes no file.
    #[error(transparent)]
    Glb(#[from] GlbError),
    /// A rule that no model can follow.
    #[error("{what} = {value}: give {least} to {most}")]
    Rule {
        /// Which rule.
        what: &'static str,
        /// What was asked for.
        value: u32,
        /// Least value.
        least: u32,
        /// Greatest value.
        most: u32,
    },
}

/// Most cameras of a made model.
pub(super) const CAMERAS_MAX: u32 = 100_000;

/// Refuses a value outside its range, by name.
pub(super) fn check(what: &'static str, value: u32, least: u32, most: u32) -> Result<(), MadeError> {
    if (least..=most).contains(&value) { Ok(()) } else { Err(MadeError::Rule { what, value, least, most }) }
}

/// A box from two corners in plan (x and z) and two heights.
pub(super) fn solid(min: DVec2, max: DVec2, bottom: f64, top: f64) -> (DVec3, DVec3) {
    (DVec3::new(min.x, bottom, min.y), DVec3::new(max.x, top, max.y))
}

impl MadeModel {
    /// Writes the model and `NAME.cameras.json` beside it.
    ///
    /// # Errors
    /// Names the file that cannot be written.
    pub fn write(&self, model: &Path) -> anyhow::Result<()> {
        if let Some(folder) = model.parent().filter(|folder| !folder.as_os_str().is_empty()) {
            std::fs::create_dir_all(folder).with_context(|| format!("cannot make the folder {}", folder.display()))?;
        }
        std::fs::write(model, &self.glb).with_context(|| format!("cannot write {}", model.display()))?;
        if !self.cameras.cameras.is_empty() {
            self.cameras.write(&model.with_extension("cameras.json"))?;
        }
        Ok(())
    }
}
