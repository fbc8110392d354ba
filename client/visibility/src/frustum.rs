//! Which triangles are in view, found as cheaply as can be? View-frustum culling alone, by boxes of what a file lists together.
//!
//! Triangles that follow each other in a file are mostly near each other, so a *run* of [`RUN`] of them has a box worth asking
//! about, and so has a *stretch* of [`STRETCH`] runs. What is reported comes in the order of ids with nothing to sort, and no
//! triangle is looked at by itself: who draws does that anyway. [`crate::FrustumBackface`] looks at each, and pays for it twice.

use std::sync::Arc;

use crate::{Aabb, Culled, Culler, DepthBuffer, EyeRegion, Scene, Scratch, View};

/// Triangles of a run.
const RUN: usize = 64;
/// Runs of a stretch.
const STRETCH: usize = 32;

/// View-frustum culling of runs of triangles. Conservative for one eye; a ball of eyes gets everything.
#[derive(Clone, Debug)]
pub struct Frustum {
    scene: Arc<Scene>,
    runs: Vec<Aabb>,
    stretches: Vec<Aabb>,
}

impl Frustum {
    /// Boxes around the scene's runs.
    pub fn new(scene: Arc<Scene>) -> Frustum {
        let around = |boxes: &[Aabb]| boxes.iter().fold(Aabb::EMPTY, |all, aabb| all.union(aabb));
        let run = |run: &[crate::Triangle]| run.iter().fold(Aabb::EMPTY, |all, triangle| all.union(&triangle.aabb()));
        let runs: Vec<Aabb> = scene.triangles().chunks(RUN).map(run).collect();
        let stretches = runs.chunks(STRETCH).map(around).collect();
        Frustum { scene, runs, stretches }
    }

    /// The scene.
    pub fn scene(&self) -> &Arc<Scene> {
        &self.scene
    }

    /// Calls `each` with the number of every run that may be in view of `depth`.
    fn in_view(&self, depth: &DepthBuffer, mut each: impl FnMut(usize)) {
        for ((first, stretch), runs) in (0..).step_by(STRETCH).zip(&self.stretches).zip(self.runs.chunks(STRETCH)) {
            if depth.in_view(stretch) {
                (first..).zip(runs).filter(|(_, run)| depth.in_view(run)).for_each(|(number, _)| each(number));
            }
        }
    }

    /// Ids of a run.
    fn ids(&self, run: usize) -> std::ops::Range<u32> {
        (run * RUN) as u32..((run + 1) * RUN).min(self.scene.triangles().len()) as u32
    }
}

impl Culler for Frustum {
    fn cull(&self, view: &View, region: EyeRegion, scratch: &mut Scratch) -> Culled {
        if !scratch.begin(view, region) {
            return crate::culler::everything(&self.scene);
        }
        let mut visible = Vec::new();
        self.in_view(&scratch.depth, |run| visible.extend(self.ids(run)));
        Culled { visible, ..Culled::default() }
    }
}
