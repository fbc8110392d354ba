//! Which triangles can be seen from a view? The static cullers, and the item buffer of everything that checks them.

use std::sync::Arc;

use crate::occupancy_map::Worth;
use crate::raster_sampled::{Coverage, MappedTarget};
use crate::{
    Aabb, Budget, Cplp, EyeRegion, ItemBuffer, MaskedCplp, Occupancy, OctreeRules, Scene, Scratch, Traversal, View,
};

/// A static culler. Shared by workers, each of which brings its scratch.
///
/// It has no errors: what it cannot answer, such as a view that [`View::check`] refuses, gets everything and hides nothing.
pub trait Culler {
    /// The visible set of a view, for every eye of the region, and in `scratch` the occlusion that was found on the way.
    fn cull(&self, view: &View, region: EyeRegion, scratch: &mut Scratch) -> Culled;
}

/// What a culler reports.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Culled {
    /// Ids of the primitives that may be seen, ascending, each once: the visible set. To be drawn in this order.
    pub visible: Vec<u32>,
    /// What the traversal did; zeros for cullers without one.
    pub traversal: Traversal,
    /// Comparisons of depths that the culler made, drawing occluders and queries included (Klosowski & Silva 2001, §4). 0 for
    /// cullers that draw nothing: there, count those of the picture ([`ItemBuffer::z_tests`]).
    pub z_tests: u64,
}

/// Everything is visible: the baseline ZB.
#[derive(Clone, Debug)]
pub struct ZBuffer {
    scene: Arc<Scene>,
}

impl ZBuffer {
    /// The baseline over a scene.
    pub fn new(scene: Arc<Scene>) -> ZBuffer {
        ZBuffer { scene }
    }
}

impl Culler for ZBuffer {
    fn cull(&self, view: &View, region: EyeRegion, scratch: &mut Scratch) -> Culled {
        scratch.begin(view, region);
        everything(&self.scene)
    }
}

/// What is in view and not turned away: the baseline VF-BF.
///
/// Exactly the triangles that reach the rasteriser's pixels, occlusion apart, after view-frustum culling of runs of
/// primitives that follow each other. An eye region that is not the view's eye gets everything.
#[derive(Clone, Debug)]
pub struct FrustumBackface {
    scene: Arc<Scene>,
    /// The box of each run of [`RUN`] primitives.
    runs: Vec<Aabb>,
}

/// Primitives of a file that follow each other are mostly near each other.
const RUN: usize = 64;

impl FrustumBackface {
    /// The baseline over a scene.
    pub fn new(scene: Arc<Scene>) -> FrustumBackface {
        let aabb = |run: &[crate::Triangle]| run.iter().fold(Aabb::EMPTY, |aabb, t| aabb.union(&t.aabb()));
        let runs = scene.triangles().chunks(RUN).map(aabb).collect();
        FrustumBackface { scene, runs }
    }
}

impl Culler for FrustumBackface {
    fn cull(&self, view: &View, region: EyeRegion, scratch: &mut Scratch) -> Culled {
        if !scratch.begin(view, region) {
            return everything(&self.scene);
        }
        let coverage = Coverage::new(view);
        let mut visible = Vec::new();
        for ((first, aabb), run) in (0..).step_by(RUN).zip(&self.runs).zip(self.scene.triangles().chunks(RUN)) {
            if scratch.depth.in_view(aabb) {
                visible.extend((first..).zip(run).filter(|(_, t)| coverage.may_draw(t)).map(|(id, _)| id));
            }
        }
        Culled { visible, ..Culled::default() }
    }
}

/// Conservative PLP over any tessellation with the CPU's sampled depth buffer as its query back end.
///
/// An eye region that is not the view's eye gets everything, since the depth buffer speaks for one eye: see
/// [`crate::RegionCuller`].
#[derive(Clone, Debug)]
pub struct CplpCuller {
    scene: Arc<Scene>,
    cplp: Arc<Cplp>,
    budget: Budget,
    occupancy: Occupancy,
}

impl CplpCuller {
    /// Culls with cells that were made for this scene.
    pub fn new(scene: Arc<Scene>, cplp: Arc<Cplp>, budget: Budget) -> CplpCuller {
        assert_eq!(scene.triangles().len(), cplp.tessellation().primitive_total(), "the cells are another scene's");
        CplpCuller { scene, cplp, budget, occupancy: Occupancy::Off }
    }

    /// Makes octree cells by default rules.
    pub fn build(scene: Arc<Scene>) -> CplpCuller {
        let cplp = Arc::new(Cplp::build(&scene, OctreeRules::default()));
        CplpCuller::new(scene, cplp, Budget::default())
    }

    /// How an occupancy map is asked before the depth buffer. Cells are asked one by one: batches are a single map here.
    pub fn with_occupancy(self, occupancy: Occupancy) -> CplpCuller {
        CplpCuller { occupancy, ..self }
    }

    /// The traversal and its cells.
    pub fn cplp(&self) -> &Arc<Cplp> {
        &self.cplp
    }
}

impl Culler for CplpCuller {
    fn cull(&self, view: &View, region: EyeRegion, scratch: &mut Scratch) -> Culled {
        if !scratch.begin(view, region) {
            return everything(&self.scene);
        }
        let Scratch { depth, maps, cplp, .. } = scratch;
        let mut traversal = if self.occupancy != Occupancy::Off {
            maps.map.set_worth(Worth::of_short_queries(self.occupancy));
            maps.map.begin(depth, &self.cplp.tessellation().root());
            let mut target = MappedTarget { target: depth.target(&self.scene), map: &mut maps.map };
            let traversal = self.cplp.traverse(&self.scene, region, self.budget, &mut target, cplp);
            Traversal { mapped: maps.map.asked(), ..traversal }
        } else {
            self.cplp.traverse(&self.scene, region, self.budget, &mut depth.target(&self.scene), cplp)
        };
        traversal.seen_z_tests = depth.seen_z_tests();
        Culled { visible: scratch.cplp.visible().to_vec(), traversal, z_tests: scratch.depth.z_tests() }
    }
}

impl Culler for MaskedCplp {
    /// An eye region that is not the view's eye gets everything.
    fn cull(&self, view: &View, region: EyeRegion, scratch: &mut Scratch) -> Culled {
        let Some(masked) = scratch.begin_masked(view, region) else { return everything(self.scene()) };
        let traversal = self.walk(view, masked);
        Culled { visible: masked.visible().to_vec(), traversal, z_tests: 0 }
    }
}

pub(crate) fn everything(scene: &Scene) -> Culled {
    Culled { visible: (0..scene.triangles().len() as u32).collect(), ..Culled::default() }
}

/// The exact set of a view, ascending, and the item buffer of everything that proves it: the plain Z-buffer's picture. Empty
/// for a view that [`View::check`] refuses.
pub fn exact_set(scene: &Scene, view: &View) -> (Vec<u32>, ItemBuffer) {
    let mut items = ItemBuffer::new(view);
    items.draw_all(scene);
    (items.winners(), items)
}

/// Number of pixels whose winner differs from the plain Z-buffer's (`exact`, of the same view) when only `visible` is drawn.
pub fn wrong_pixels(scene: &Scene, view: &View, visible: &[u32], exact: &ItemBuffer) -> usize {
    let mut items = ItemBuffer::new(view);
    items.draw(scene, visible);
    assert_eq!(items.resolution(), exact.resolution(), "the images are of different views");
    items.ids().iter().zip(exact.ids()).filter(|(here, there)| here != there).count()
}
