//! PLP and its baseline as cullers: what each draws of a view within a budget of triangles.

use std::sync::Arc;

use crate::culler::{Culled, Culler, everything};
use crate::plp::Plp;
use crate::raster_sampled::Coverage;
use crate::{EyeRegion, Scene, Scratch, Traversal, View};

/// PLP with a budget. Not conservative, and hides nothing: it knows no depths that speak for the view.
///
/// An eye region that is not the view's eye gets everything, as does a view that [`View::check`] refuses.
#[derive(Clone, Debug)]
pub struct PlpCuller {
    plp: Arc<Plp>,
    budget: usize,
}

impl PlpCuller {
    /// Draws at most `budget` triangles a view.
    pub fn new(plp: Arc<Plp>, budget: usize) -> PlpCuller {
        PlpCuller { plp, budget }
    }
}

impl Culler for PlpCuller {
    fn cull(&self, view: &View, region: EyeRegion, scratch: &mut Scratch) -> Culled {
        scratch.forget();
        if view.check().is_err() || region != EyeRegion::point(view.eye) {
            return everything(self.plp.scene());
        }
        self.plp.traverse(view, self.budget, &mut scratch.plp).for_each(drop);
        let mut visible = scratch.plp.drawn().to_vec();
        visible.sort_unstable();
        let traversal = Traversal {
            cells_projected: scratch.plp.projected().len(),
            triangles_drawn: visible.len(),
            plp_triangles: visible.len(),
            ..Traversal::default()
        };
        Culled { visible, traversal, z_tests: 0 }
    }
}

/// The paper's baseline (§4.5): triangles in view and not turned away by the distance of their centroids, up to a budget.
#[derive(Clone, Debug)]
pub struct CentroidOrder {
    scene: Arc<Scene>,
    budget: usize,
}

impl CentroidOrder {
    /// Draws at most `budget` triangles a view.
    pub fn new(scene: Arc<Scene>, budget: usize) -> CentroidOrder {
        CentroidOrder { scene, budget }
    }
}

impl Culler for CentroidOrder {
    fn cull(&self, view: &View, region: EyeRegion, scratch: &mut Scratch) -> Culled {
        scratch.forget();
        if view.check().is_err() || region != EyeRegion::point(view.eye) {
            return everything(&self.scene);
        }
        let coverage = Coverage::new(view);
        let mut order: Vec<(f64, u32)> = (0..)
            .zip(self.scene.triangles())
            .filter(|(_, triangle)| coverage.may_draw(triangle))
            .map(|(id, triangle)| {
                let [a, b, c] = triangle.corners.map(|corner| corner.as_dvec3());
                (((a + b + c) / 3.0).distance_squared(view.eye), id)
            })
            .collect();
        let nearer = |a: &(f64, u32), b: &(f64, u32)| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1));
        if self.budget < order.len() {
            order.select_nth_unstable_by(self.budget, nearer);
            order.truncate(self.budget);
        }
        let mut visible: Vec<u32> = order.into_iter().map(|(_, id)| id).collect();
        visible.sort_unstable();
        let drawn = visible.len();
        let traversal = Traversal { triangles_drawn: drawn, plp_triangles: drawn, ..Traversal::default() };
        Culled { visible, traversal, z_tests: 0 }
    }
}
