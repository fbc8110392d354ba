//! Which parts of the scene walls seal off from each other: found out by another thread, once something could be sealed
//! off.

use std::sync::Arc;

use eyeline_visibility::{Scene, SealedParts};

use crate::later::Later;
use crate::plan;
use crate::session::Session;

/// Frames between two looks at whether anything could be sealed off, which takes a look at each object.
const LOOK: u64 = 32;

/// A scene's parts, while nobody needs them, while they are being made, and after.
pub(crate) struct PartsLater {
    scene: Arc<Scene>,
    frames: u64,
    making: Option<Later<Option<Arc<SealedParts>>>>,
    is_made: bool,
}

impl PartsLater {
    /// Nobody needs them yet.
    pub fn new(scene: Arc<Scene>) -> PartsLater {
        PartsLater { scene, frames: 0, making: None, is_made: false }
    }

    /// The parts, once: when they are there, if there are several. To be called in each frame.
    pub fn poll(&mut self, session: &Session) -> Option<Arc<SealedParts>> {
        if self.is_made {
            return None;
        }
        if let Some(making) = &mut self.making {
            let made = making.poll()?;
            self.is_made = true;
            tracing::info!(parts = made.as_ref().map_or(1, |parts| parts.count()), "walls seal off parts of the scene");
            return made;
        }
        self.frames += 1;
        if self.frames.is_multiple_of(LOOK) && session.could_seal() {
            let scene = Arc::clone(&self.scene);
            self.making = Some(Later::start(move || plan::sealed_parts(&scene)));
        }
        None
    }
}
