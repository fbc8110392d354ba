//! PLP and its baseline as cullers: what each draws of a view within a budget of triangles.

use std::sync::Arc;

use crate::culler::{Culled, Culler, everything};
use crate::plp::{Plp, in_view_and_facing};
use crate::raster_sampled::setup::Projector;
use crate::{EyeRegion, Scene, Scratch, Traversal, Triangle, View};

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

/// The paper's baseline (§4.5): triangles by the distance of their centroids, up to a budget; of these, those in view and not
/// turned away are drawn.
///
/// The paper sorts "all of the triangles" and renders "in that order up to the specified budget". Whether a triangle that is then
/// culled uses up budget it does not say, so that both are here.
#[derive(Clone, Debug)]
pub struct CentroidOrder {
    scene: Arc<Scene>,
    budget: usize,
    culls_first: bool,
}

impl CentroidOrder {
    /// Takes the `budget` nearest triangles: of all, or if `culls_first` of those in view and not turned away.
    pub fn new(scene: Arc<Scene>, budget: usize, culls_first: bool) -> CentroidOrder {
        CentroidOrder { scene, budget, culls_first }
    }
}

impl Culler for CentroidOrder {
    fn cull(&self, view: &View, region: EyeRegion, scratch: &mut Scratch) -> Culled {
        scratch.forget();
        if view.check().is_err() || region != EyeRegion::point(view.eye) {
            return everything(&self.scene);
        }
        let projector = Projector::new(view);
        let drawable = |triangle: &Triangle| in_view_and_facing(&projector, view.eye, triangle);
        let mut order: Vec<(f64, u32)> = (0..)
            .zip(self.scene.triangles())
            .filter(|(_, triangle)| !self.culls_first || drawable(triangle))
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
        visible.retain(|&id| self.culls_first || drawable(&self.scene.triangles()[id as usize]));
        visible.sort_unstable();
        let drawn = visible.len();
        let traversal = Traversal { triangles_drawn: drawn, plp_triangles: drawn, ..Traversal::default() };
        Culled { visible, traversal, z_tests: 0 }
    }
}
