//! What do occlusion queries find without PLP? The baseline "HP" of Klosowski & Silva 2001, §4.

use std::sync::Arc;

use crate::culler::everything;
use crate::query::test;
use crate::{CellId, Culled, Culler, EyeRegion, Octree, OctreeRules, Scene, Scratch, Tessellation, Traversal, View};

/// The cells in view, sorted by distance from the eye; each is queried, and drawn at once if it is seen.
///
/// It has no front, so it cannot tell when the image is finished, and asks about every cell in view. An eye region that is
/// not the view's eye gets everything.
#[derive(Clone, Debug)]
pub struct QueryFrontToBack {
    scene: Arc<Scene>,
    tessellation: Arc<dyn Tessellation>,
}

impl QueryFrontToBack {
    /// Culls with cells that were made for this scene.
    pub fn new(scene: Arc<Scene>, tessellation: Arc<dyn Tessellation>) -> QueryFrontToBack {
        assert_eq!(scene.triangles().len(), tessellation.primitive_total(), "the tessellation is another scene's");
        QueryFrontToBack { scene, tessellation }
    }

    /// Makes the cells by default rules.
    pub fn build(scene: Arc<Scene>) -> QueryFrontToBack {
        let octree = Arc::new(Octree::build(&scene, OctreeRules::default()));
        QueryFrontToBack::new(scene, octree)
    }
}

impl Culler for QueryFrontToBack {
    fn cull(&self, view: &View, region: EyeRegion, scratch: &mut Scratch) -> Culled {
        if !scratch.begin(view, region) {
            return everything(&self.scene);
        }
        let Scratch { depth, leaves, .. } = scratch;
        leaves.begin(&*self.tessellation);
        let mut order = std::mem::take(&mut leaves.order);
        for cell in 0..self.tessellation.cell_count() as CellId {
            let aabb = self.tessellation.cell(cell);
            if depth.in_view(aabb) {
                order.push((aabb.distance(view.eye), cell));
            }
        }
        order.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let mut traversal = Traversal::default();
        for &(_, cell) in &order {
            traversal.queries += 1;
            if test(depth, self.tessellation.cell(cell)).0 {
                traversal.cells_projected += 1;
                depth.draw(&self.scene, leaves.project(&*self.tessellation, cell));
            }
        }
        leaves.order = order;
        leaves.finish(traversal, depth.z_tests())
    }
}

/// The visible set of a culler that draws cells one after the other.
#[derive(Clone, Debug, Default)]
pub(crate) struct Leaves {
    /// Distance from the eye in metres, and cell.
    order: Vec<(f64, CellId)>,
    /// Whether each primitive was drawn in this frame.
    drawn: Vec<bool>,
    visible: Vec<u32>,
}

impl Leaves {
    pub(crate) fn begin(&mut self, tessellation: &dyn Tessellation) {
        self.order.clear();
        for &id in &self.visible {
            self.drawn[id as usize] = false;
        }
        self.visible.clear();
        self.drawn.resize(tessellation.primitive_total(), false);
    }

    /// Counts primitives as drawn that were drawn before any cell.
    pub(crate) fn add(&mut self, primitives: &[u32]) {
        for &id in primitives {
            if !std::mem::replace(&mut self.drawn[id as usize], true) {
                self.visible.push(id);
            }
        }
    }

    /// The primitives of a cell that were not drawn yet.
    pub(crate) fn project(&mut self, tessellation: &dyn Tessellation, cell: CellId) -> &[u32] {
        let from = self.visible.len();
        self.add(tessellation.primitives(cell));
        &self.visible[from..]
    }

    /// What the culler reports. Leaves are asked about one by one: there are no rounds.
    pub(crate) fn finish(&self, traversal: Traversal, z_tests: u64) -> Culled {
        let mut visible = self.visible.clone();
        visible.sort_unstable();
        Culled { traversal: Traversal { triangles_drawn: visible.len(), ..traversal }, visible, z_tests }
    }
}
