//! What do occlusion queries find without PLP? The baseline "HP" of Klosowski & Silva 2001, §4.

use std::sync::Arc;

use crate::culler::everything;
use crate::query::test;
use crate::{CellId, Culled, Culler, EyeRegion, Octree, OctreeRules, Scene, Scratch, Traversal, View};

/// The octree's leaves in view, sorted by distance from the eye; each is queried, and drawn at once if it is seen.
///
/// It has no front, so it cannot tell when the image is finished, and asks about every leaf in view. An eye region that is
/// not the view's eye gets everything.
#[derive(Clone, Debug)]
pub struct QueryFrontToBack {
    scene: Arc<Scene>,
    octree: Arc<Octree>,
}

impl QueryFrontToBack {
    /// Culls with cells that were made for this scene.
    pub fn new(scene: Arc<Scene>, octree: Arc<Octree>) -> QueryFrontToBack {
        assert_eq!(scene.triangles().len(), octree.primitive_total(), "the octree is another scene's");
        QueryFrontToBack { scene, octree }
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
        leaves.begin(&self.octree);
        let mut order = std::mem::take(&mut leaves.order);
        for cell in 0..self.octree.cell_count() as CellId {
            let aabb = self.octree.cell(cell);
            if depth.in_view(aabb) {
                order.push((aabb.distance(view.eye), cell));
            }
        }
        order.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let mut traversal = Traversal::default();
        for &(_, cell) in &order {
            traversal.queries += 1;
            if test(depth, self.octree.cell(cell)).0 {
                traversal.cells_projected += 1;
                depth.draw(&self.scene, leaves.project(&self.octree, cell));
            }
        }
        leaves.order = order;
        leaves.finish(traversal, depth.z_tests())
    }
}

/// The visible set of a culler that draws an octree's leaves one after the other.
#[derive(Clone, Debug, Default)]
pub(crate) struct Leaves {
    /// Distance from the eye in metres, and cell.
    order: Vec<(f64, CellId)>,
    /// Whether each primitive was drawn in this frame.
    drawn: Vec<bool>,
    visible: Vec<u32>,
}

impl Leaves {
    pub(crate) fn begin(&mut self, octree: &Octree) {
        self.order.clear();
        for &id in &self.visible {
            self.drawn[id as usize] = false;
        }
        self.visible.clear();
        self.drawn.resize(octree.primitive_total(), false);
    }

    /// The primitives of a cell that were not drawn yet.
    pub(crate) fn project(&mut self, octree: &Octree, cell: CellId) -> &[u32] {
        let from = self.visible.len();
        for &id in octree.primitives(cell) {
            if !std::mem::replace(&mut self.drawn[id as usize], true) {
                self.visible.push(id);
            }
        }
        &self.visible[from..]
    }

    /// What the culler reports. Leaves are asked about one by one: there are no rounds.
    pub(crate) fn finish(&self, traversal: Traversal, z_tests: u64) -> Culled {
        let mut visible = self.visible.clone();
        visible.sort_unstable();
        Culled { traversal: Traversal { triangles_drawn: visible.len(), ..traversal }, visible, z_tests }
    }
}
