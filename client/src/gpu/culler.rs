//! Cullers whose depths and queries are on an adapter: conservative PLP by rounds, and Greene's octree walk by rounds.

use std::sync::Arc;

use eyeline_visibility::{
    Aabb, Bound, Budget, Cplp, CplpScratch, Culled, EyeRegion, Occlusion, Occupancy, OccupancyQuery, Octree,
    OctreeRounds, QueryBackEnd, RoundsTraversal, Scene, View,
};
use glam::DVec3;

use super::{GpuError, GpuQuery};

/// A culler over a query back end on an adapter.
///
/// Unlike [`eyeline_visibility::Culler`] it can fail, and it keeps its image for itself: adapters are not shared by workers.
#[derive(Debug)]
pub struct GpuCuller {
    scene: Arc<Scene>,
    walk: Walk,
    back_end: BackEnd,
    rounds: RoundsTraversal,
    /// Whether the back end's view is that of the last cull.
    speaks: bool,
}

#[derive(Debug)]
enum Walk {
    Cplp { cplp: Arc<Cplp>, budget: Budget, scratch: Box<CplpScratch> },
    Octree { octree: Arc<Octree>, nodes: usize, rounds: Box<OctreeRounds> },
}

#[derive(Debug)]
enum BackEnd {
    Plain(Box<GpuQuery>),
    Mapped(Box<OccupancyQuery<GpuQuery>>),
}

impl BackEnd {
    fn new(query: GpuQuery, occupancy: Occupancy) -> BackEnd {
        match occupancy {
            Occupancy::Off => BackEnd::Plain(Box::new(query)),
            _ => BackEnd::Mapped(Box::new(OccupancyQuery::new(query, occupancy))),
        }
    }

    fn any(&mut self) -> &mut dyn QueryBackEnd {
        match self {
            BackEnd::Plain(query) => &mut **query,
            BackEnd::Mapped(query) => &mut **query,
        }
    }

    fn query(&self) -> &GpuQuery {
        match self {
            BackEnd::Plain(query) => query,
            BackEnd::Mapped(query) => query.inner(),
        }
    }

    fn query_mut(&mut self) -> &mut GpuQuery {
        match self {
            BackEnd::Plain(query) => query,
            BackEnd::Mapped(query) => query.inner_mut(),
        }
    }
}

impl GpuCuller {
    /// cPLP by rounds (Klosowski & Silva 2001, §2.2), with cells that were made for the scene, as was what the back end holds.
    /// Occupancy maps spare and arrange queries as they do for the CPU's back ends (Staneker et al. 2003).
    ///
    /// # Panics
    /// If the cells are another scene's.
    pub fn cplp(
        scene: Arc<Scene>,
        cplp: Arc<Cplp>,
        budget: Budget,
        query: GpuQuery,
        occupancy: Occupancy,
    ) -> GpuCuller {
        assert_eq!(scene.triangles().len(), cplp.tessellation().primitive_total(), "the cells are another scene's");
        let walk = Walk::Cplp { cplp, budget, scratch: Box::default() };
        GpuCuller {
            scene,
            walk,
            back_end: BackEnd::new(query, occupancy),
            rounds: RoundsTraversal::default(),
            speaks: false,
        }
    }

    /// Greene's octree walk (1993), asking about up to `nodes` nodes at a time.
    ///
    /// # Panics
    /// At the first view, if the octree is another scene's.
    pub fn hierarchical_z(scene: Arc<Scene>, octree: Arc<Octree>, nodes: usize, query: GpuQuery) -> GpuCuller {
        let walk = Walk::Octree { octree, nodes, rounds: Box::default() };
        GpuCuller {
            scene,
            walk,
            back_end: BackEnd::new(query, Occupancy::Off),
            rounds: RoundsTraversal::default(),
            speaks: false,
        }
    }

    /// Culls a view. An eye region that is not the view's eye gets everything, since the image speaks for one eye, and so does a
    /// view that [`View::check`] refuses.
    ///
    /// # Errors
    /// What is wrong with the adapter. Nothing is known to be hidden then.
    pub fn cull(&mut self, view: &View, region: EyeRegion) -> Result<Culled, GpuError> {
        self.rounds = RoundsTraversal::default();
        self.speaks = false;
        if region != EyeRegion::point(view.eye) || view.check().is_err() {
            let visible = (0..self.scene.triangles().len() as u32).collect();
            return Ok(Culled { visible, ..Culled::default() });
        }
        let back_end = self.back_end.any();
        let (visible, rounds) = match &mut self.walk {
            Walk::Cplp { cplp, budget, scratch } => {
                let rounds = cplp.traverse_rounds(&self.scene, view, *budget, back_end, scratch);
                (scratch.visible().to_vec(), rounds)
            }
            Walk::Octree { octree, nodes, rounds } => rounds.traverse(&self.scene, octree, view, *nodes, back_end),
        };
        self.back_end.query_mut().check()?;
        self.rounds = rounds;
        self.speaks = true;
        Ok(Culled { visible, traversal: rounds.traversal, z_tests: 0 })
    }

    /// What the last cull took.
    pub fn rounds(&self) -> &RoundsTraversal {
        &self.rounds
    }

    /// The back end.
    pub fn query(&self) -> &GpuQuery {
        self.back_end.query()
    }

    /// Which of these bounds the depths of the last cull hide on the adapter, all asked at once: one answer per bound. A bound is asked
    /// about as a box around it; where nothing is known of it, or of the view, it is not hidden.
    ///
    /// A tracker does not ask here: it walks a tree of bounds, each answer deciding what it asks next, for a ball of eyes and not for one.
    ///
    /// # Errors
    /// What is wrong with the adapter. Nothing is known to be hidden then.
    pub fn hidden(&mut self, bounds: &[Bound], hidden: &mut Vec<bool>) -> Result<(), GpuError> {
        hidden.clear();
        hidden.resize(bounds.len(), false);
        if !self.speaks {
            return Ok(());
        }
        // What has no box is asked about as one without numbers, which counts as seen.
        let nowhere = Aabb { min: DVec3::NAN, max: DVec3::NAN };
        let boxes: Vec<Aabb> = bounds.iter().map(|bound| bound.outer_box().unwrap_or(nowhere)).collect();
        let query = self.back_end.query_mut();
        let mut seen = Vec::new();
        query.query(&boxes, &mut seen);
        query.check()?;
        hidden.iter_mut().zip(seen).for_each(|(hidden, seen)| *hidden = !seen);
        Ok(())
    }

    /// What the last view knows of moving bounds without asking the adapter: depths are on the adapter, so only what is out of view is hidden.
    pub fn occlusion(&self) -> &dyn Occlusion {
        if self.speaks { self.back_end.query().depth() } else { &NothingHidden }
    }
}

/// What is known of a view that was not looked at.
struct NothingHidden;

impl Occlusion for NothingHidden {
    fn hides(&self, _: &Bound) -> bool {
        false
    }
}
