//! Which culler decides what the viewer draws, and what it found.

use std::sync::Arc;

use eyeline_visibility::{
    CplpCuller, Culled, Culler, EyeRegion, FrustumBackface, MaskedCplp, RegionCuller, Scene, Scratch, View, ZBuffer,
};

/// A culler, by its name on the command line.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum CullerKind {
    /// Nothing: everything is drawn
    All,
    /// What is in view and not turned away
    Frustum,
    /// cPLP over octree cells with a sampled depth buffer
    Cplp,
    /// cPLP by queries of faces against coverage masks, the fastest
    #[default]
    Masked,
    /// For every eye of a ball and at every resolution
    Region,
}

/// A culler at work. The viewer draws what it says and never decides itself.
pub struct Sight {
    culler: Box<dyn Culler + Send + Sync>,
    scratch: Scratch,
    culled: Culled,
}

impl Sight {
    /// Prepares a culler for a scene, which may take seconds for a large one.
    pub fn new(kind: CullerKind, scene: &Arc<Scene>) -> Sight {
        let scene = Arc::clone(scene);
        let culler: Box<dyn Culler + Send + Sync> = match kind {
            CullerKind::All => Box::new(ZBuffer::new(scene)),
            CullerKind::Frustum => Box::new(FrustumBackface::new(scene)),
            CullerKind::Cplp => Box::new(CplpCuller::build(scene)),
            CullerKind::Masked => Box::new(MaskedCplp::build(scene)),
            CullerKind::Region => Box::new(RegionCuller::build(scene)),
        };
        Sight { culler, scratch: Scratch::default(), culled: Culled::default() }
    }

    /// Culls from a view's eye.
    pub fn look(&mut self, view: &View) -> &Culled {
        self.culled = self.culler.cull(view, EyeRegion::point(view.eye), &mut self.scratch);
        &self.culled
    }

    /// What the last look found.
    pub fn culled(&self) -> &Culled {
        &self.culled
    }
}
