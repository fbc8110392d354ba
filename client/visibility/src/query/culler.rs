//! cPLP with a chosen query back end, as a culler.

use std::sync::Arc;

use super::QueryKind;
use crate::culler::everything;
use crate::{Budget, Cplp, Culled, Culler, EyeRegion, Occupancy, OctreeRules, RoundsTraversal, Scene, Scratch, View};

/// Conservative PLP by rounds over one of the CPU's query back ends: the paper's cPLP-IB, cPLP-HG, cPLP-HP and cPLP-EXT.
///
/// An eye region that is not the view's eye gets everything, since the images speak for one eye.
#[derive(Clone, Debug)]
pub struct CplpQueryCuller {
    scene: Arc<Scene>,
    cplp: Arc<Cplp>,
    budget: Budget,
    query: QueryKind,
    occupancy: Occupancy,
}

impl CplpQueryCuller {
    /// Culls with cells that were made for this scene.
    pub fn new(scene: Arc<Scene>, cplp: Arc<Cplp>, budget: Budget, query: QueryKind) -> CplpQueryCuller {
        CplpQueryCuller { scene, cplp, budget, query, occupancy: Occupancy::Off }
    }

    /// Makes the cells by default rules.
    pub fn build(scene: Arc<Scene>, query: QueryKind) -> CplpQueryCuller {
        let cplp = Arc::new(Cplp::build(&scene, OctreeRules::default()));
        CplpQueryCuller::new(scene, cplp, Budget::default(), query)
    }

    /// The same with occupancy maps before the back end.
    pub fn with_occupancy(self, occupancy: Occupancy) -> CplpQueryCuller {
        CplpQueryCuller { occupancy, ..self }
    }

    /// The traversal and its cells.
    pub fn cplp(&self) -> &Arc<Cplp> {
        &self.cplp
    }

    /// Culls, and says what each step did; `None` for an eye region that is not the view's eye, which gets everything.
    pub fn cull_rounds(
        &self,
        view: &View,
        region: EyeRegion,
        scratch: &mut Scratch,
    ) -> (Culled, Option<RoundsTraversal>) {
        let Some((back_end, cplp_scratch)) = scratch.begin_query(view, region, self.query, self.occupancy) else {
            return (everything(&self.scene), None);
        };
        let rounds = self.cplp.traverse_rounds(&self.scene, view, self.budget, back_end, cplp_scratch);
        let visible = cplp_scratch.visible().to_vec();
        (Culled { visible, traversal: rounds.traversal, z_tests: rounds.z_tests }, Some(rounds))
    }
}

impl Culler for CplpQueryCuller {
    fn cull(&self, view: &View, region: EyeRegion, scratch: &mut Scratch) -> Culled {
        self.cull_rounds(view, region, scratch).0
    }
}
