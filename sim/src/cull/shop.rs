//! What are cullers of one scene made from? Tessellations, occluders and budgets, each made once.

use std::sync::Arc;

use eyeline_protocol::PlanSwitch;
use eyeline_visibility::{
    AnyTessellation, AutoBudget, AutoBudgetRules, Budget, Cplp, Delaunay, DelaunayError, DelaunayRules, KdRules,
    KdTree, Occluders, Octree, OctreeRules, Plp, PlpCells, PlpRules, Prisms, PrismsError, Scene, Tessellation,
};

use super::budget::{AskedBudget, BudgetKind};
use super::plp::Plan;
use super::registry::Setting;

/// Names of tessellations.
pub(super) const DELAUNAY: &str = "delaunay";
pub(super) const OCTREE: &str = "octree";
pub(super) const FINE_OCTREE: &str = "fine-octree";
pub(super) const KD_TREE: &str = "kd-tree";
pub(super) const PRISMS: &str = "prisms";

/// Longest side of the fine octree's leaves, as a share of the scene's: a quarter of the paper's, about as many cells as its tetrahedra.
const FINE_LEAF: f64 = 0.0125;

/// What cullers of one scene are made from; parts are made once.
pub struct Shop {
    scene: Arc<Scene>,
    octree: Option<Arc<Octree>>,
    kd_tree: Option<Arc<KdTree>>,
    occluders: Option<Arc<Occluders>>,
    plp_octree: Option<PlpCells>,
    fine_octree: Option<PlpCells>,
    delaunay: Option<Result<Arc<Delaunay>, DelaunayError>>,
    prisms: Option<Result<Arc<Prisms>, PrismsError>>,
    switch: PlanSwitch,
    #[cfg(feature = "gpu")]
    gpu: Option<Result<super::gpu::Uploaded, String>>,
}

impl Shop {
    /// A shop for a scene.
    pub fn new(scene: Arc<Scene>) -> Shop {
        Shop {
            scene,
            octree: None,
            kd_tree: None,
            occluders: None,
            plp_octree: None,
            fine_octree: None,
            delaunay: None,
            prisms: None,
            switch: PlanSwitch::AUTO,
            #[cfg(feature = "gpu")]
            gpu: None,
        }
    }

    /// The scene on a graphics adapter, or why it is not there.
    #[cfg(feature = "gpu")]
    pub(super) fn gpu(&mut self) -> Result<super::gpu::Uploaded, String> {
        let scene = &self.scene;
        self.gpu.get_or_insert_with(|| super::gpu::Uploaded::new(scene).map_err(|error| error.to_string())).clone()
    }

    /// The same with a tessellation that was made before, in place of the one of its kind.
    pub fn with_tessellation(mut self, made: AnyTessellation) -> Shop {
        match made {
            AnyTessellation::Octree(octree) => {
                self.plp_octree = Some(PlpCells::Boxes(octree.clone()));
                self.octree = Some(octree);
            }
            AnyTessellation::KdTree(kd_tree) => self.kd_tree = Some(kd_tree),
            AnyTessellation::Delaunay(delaunay) => self.delaunay = Some(Ok(delaunay)),
            AnyTessellation::Prisms(prisms) => self.prisms = Some(Ok(prisms)),
        }
        self
    }

    /// The same with what is asked of the plan.
    pub fn with_switch(self, switch: PlanSwitch) -> Shop {
        Shop { switch, ..self }
    }

    /// What is asked of the plan.
    pub fn switch(&self) -> PlanSwitch {
        self.switch
    }

    /// Which tessellation stands in for the one that a setting names, and why, if that could not be made.
    pub fn instead(&self, setting: &Setting) -> Option<(&'static str, String)> {
        let why = match setting.tessellation? {
            PRISMS => self.prisms.as_ref()?.as_ref().err()?.to_string(),
            DELAUNAY => self.delaunay.as_ref()?.as_ref().err()?.to_string(),
            _ => return None,
        };
        Some((OCTREE, why))
    }

    /// Prisms, or why there are none.
    fn prisms(&mut self) -> Option<Arc<Prisms>> {
        let scene = &self.scene;
        self.prisms.get_or_insert_with(|| Prisms::build(scene).map(Arc::new)).clone().ok()
    }

    /// The scene.
    pub fn scene(&self) -> Arc<Scene> {
        self.scene.clone()
    }

    /// The octree.
    pub fn octree(&mut self) -> Arc<Octree> {
        self.octree.get_or_insert_with(|| Arc::new(Octree::build(&self.scene, OctreeRules::default()))).clone()
    }

    /// The tessellation that a setting names.
    pub fn tessellation(&mut self, setting: &Setting) -> Arc<dyn Tessellation> {
        match setting.tessellation {
            Some(KD_TREE) => {
                let kd_tree = &mut self.kd_tree;
                kd_tree.get_or_insert_with(|| Arc::new(KdTree::build(&self.scene, KdRules::default()))).clone()
            }
            // Where there are no storeys the octree stands in for prisms.
            Some(PRISMS) => match self.prisms() {
                Some(prisms) => prisms,
                None => self.octree(),
            },
            _ => self.octree(),
        }
    }

    /// cPLP over the tessellation that a setting names.
    pub fn cplp(&mut self, setting: &Setting) -> Arc<Cplp> {
        Arc::new(Cplp::new(self.tessellation(setting)))
    }

    /// The cells that PLP walks: octree leaves by the paper's rules or a quarter as long, tetrahedra over the former, or prisms.
    /// Where these cannot be made, the octree stands in for them, and [`Shop::instead`] says why.
    pub fn plp_cells(&mut self, setting: &Setting) -> PlpCells {
        let octree = |scene: &Scene, rules: OctreeRules| PlpCells::Boxes(Arc::new(Octree::build(scene, rules)));
        let made = match setting.tessellation {
            Some(FINE_OCTREE) => {
                let rules = OctreeRules::paper().with_leaf_side(FINE_LEAF);
                Some(self.fine_octree.get_or_insert_with(|| octree(&self.scene, rules)).clone())
            }
            Some(PRISMS) => self.prisms().map(PlpCells::Prisms),
            Some(DELAUNAY) => {
                let made = || Delaunay::build(&self.scene, DelaunayRules::default()).map(Arc::new);
                self.delaunay.get_or_insert_with(made).clone().ok().map(PlpCells::Tetrahedra)
            }
            _ => None,
        };
        made.unwrap_or_else(|| self.plp_octree.get_or_insert_with(|| octree(&self.scene, OctreeRules::paper())).clone())
    }

    /// PLP over the cells that a setting names.
    pub fn plp(&mut self, setting: &Setting, rules: PlpRules) -> Arc<Plp> {
        Arc::new(Plp::new(self.scene(), self.plp_cells(setting), rules))
    }

    /// The budget that a setting names, in triangles; [`Budget::default`] if it names none that is known beforehand.
    pub fn budget(&self, setting: &Setting) -> usize {
        let total = self.scene.triangles().len();
        let given = setting.budget.as_ref().and_then(|budget| budget.triangles(total));
        given.unwrap_or(Budget::default().triangles)
    }

    /// How a setting's budget is found, view by view.
    pub fn plan(&self, setting: &Setting) -> Plan {
        match setting.budget.as_ref().map(AskedBudget::kind) {
            Some(BudgetKind::Visible(times)) => Plan::Visible { times, visible: 0 },
            Some(BudgetKind::Auto) => Plan::Auto(AutoBudget::new(AutoBudgetRules::default())),
            Some(BudgetKind::Deadline(deadline)) => Plan::Deadline(deadline),
            _ => Plan::Triangles(self.budget(setting)),
        }
    }

    /// The polygons that under-estimating coverage draws.
    pub fn occluders(&mut self) -> Arc<Occluders> {
        self.occluders.get_or_insert_with(|| Arc::new(Occluders::build(&self.scene))).clone()
    }
}

#[cfg(test)]
mod tests {
    use eyeline_visibility::{Sides, Triangle};
    use glam::Vec3;

    use super::*;
    use crate::cull::Registry;

    #[test]
    fn what_stands_in_is_named() {
        let triangle = Triangle { corners: [Vec3::ZERO, Vec3::X, Vec3::Y], sides: Sides::Both, occludes: true };
        let mut shop = Shop::new(Arc::new(Scene::from_triangles(vec![triangle])));
        let sweep = super::super::registry::Sweep { cullers: vec!["plp".into()], ..Default::default() };
        let setting = Registry::standard().settings(&sweep).unwrap().remove(0);
        assert!(matches!(shop.plp_cells(&setting), PlpCells::Tetrahedra(_)));
        assert_eq!(shop.instead(&setting), None);
        // One triangle has no storeys.
        let prisms = Setting { tessellation: Some(PRISMS), ..setting.clone() };
        assert!(matches!(shop.plp_cells(&prisms), PlpCells::Boxes(_)));
        let (instead, why) = shop.instead(&prisms).unwrap();
        assert_eq!(instead, OCTREE);
        assert!(why.contains("storeys"), "{why}");
        let other = Setting { tessellation: Some(FINE_OCTREE), ..setting };
        assert_eq!(shop.instead(&other), None);
    }
}
