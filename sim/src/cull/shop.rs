//! What are cullers of one scene made from? Tessellations, occluders and budgets, each made once.

use std::sync::Arc;

use eyeline_visibility::{
    AutoBudget, AutoBudgetRules, Budget, Cplp, Delaunay, DelaunayRules, KdRules, KdTree, Occluders, Octree,
    OctreeRules, Plp, PlpCells, PlpRules, Scene, Tessellation,
};

use super::budget::{AskedBudget, BudgetKind};
use super::plp::Plan;
use super::registry::Setting;

/// Names of tessellations.
pub(super) const DELAUNAY: &str = "delaunay";
pub(super) const OCTREE: &str = "octree";
pub(super) const FINE_OCTREE: &str = "fine-octree";
pub(super) const KD_TREE: &str = "kd-tree";

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
    /// The inner one is `None` if none could be made.
    delaunay: Option<Option<PlpCells>>,
    notes: Vec<String>,
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
            notes: Vec::new(),
        }
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
            _ => self.octree(),
        }
    }

    /// cPLP over the tessellation that a setting names.
    pub fn cplp(&mut self, setting: &Setting) -> Arc<Cplp> {
        Arc::new(Cplp::new(self.tessellation(setting)))
    }

    /// The cells that PLP walks: octree leaves by the paper's rules or a quarter as long, or tetrahedra over the former. Where no
    /// tetrahedra can be made, the octree stands in for them, and [`Shop::notes`] says why.
    pub fn plp_cells(&mut self, setting: &Setting) -> PlpCells {
        let Shop { scene, plp_octree, fine_octree, delaunay, notes, .. } = self;
        let octree = |rules: OctreeRules| PlpCells::Boxes(Arc::new(Octree::build(scene, rules)));
        let mut coarse = || plp_octree.get_or_insert_with(|| octree(OctreeRules::paper())).clone();
        match setting.tessellation {
            Some(FINE_OCTREE) => {
                let rules = OctreeRules::paper().with_leaf_side(FINE_LEAF);
                fine_octree.get_or_insert_with(|| octree(rules)).clone()
            }
            Some(OCTREE) => coarse(),
            _ => {
                let made = delaunay.get_or_insert_with(|| match Delaunay::build(scene, DelaunayRules::default()) {
                    Ok(delaunay) => Some(PlpCells::Tetrahedra(Arc::new(delaunay))),
                    Err(error) => {
                        notes.push(format!("the octree stands in for the Delaunay tessellation: {error}"));
                        None
                    }
                });
                made.clone().unwrap_or_else(coarse)
            }
        }
    }

    /// The name of the tessellation that a setting runs with: what was asked for, unless another had to stand in.
    pub fn used_tessellation(&self, setting: &Setting) -> Option<&'static str> {
        match setting.tessellation {
            Some(DELAUNAY) if self.delaunay.as_ref().is_some_and(Option::is_none) => Some(OCTREE),
            asked => asked,
        }
    }

    /// What a reader of the report should know about how parts were made.
    pub fn notes(&self) -> &[String] {
        &self.notes
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
        assert_eq!((shop.used_tessellation(&setting), shop.notes().len()), (Some(DELAUNAY), 0));
        // As a failed build leaves it.
        shop.delaunay = Some(None);
        assert!(matches!(shop.plp_cells(&setting), PlpCells::Boxes(_)));
        assert_eq!(shop.used_tessellation(&setting), Some(OCTREE));
        let other = Setting { tessellation: Some(FINE_OCTREE), ..setting };
        assert_eq!(shop.used_tessellation(&other), Some(FINE_OCTREE));
    }
}
