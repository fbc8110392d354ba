//! PLP and its baseline under test: who gives them their budget, view by view, and who holds the clock for a deadline.

// This is a driver: it may read the clock.
#![expect(clippy::disallowed_methods)]

use std::sync::Arc;
use std::time::{Duration, Instant};

use eyeline_visibility::{
    AutoBudget, CentroidOrder, Culled, Culler, EyeRegion, ItemBuffer, Occlusion, Plp, PlpCuller, PlpScratch,
    Resolution, Scene, Scratch, Traversal, View, model_shares,
};

use super::candidate::Candidate;
use super::picture::Layer;

/// How the budget of a view is found.
#[derive(Clone, Debug)]
pub enum Plan {
    /// So many triangles.
    Triangles(usize),
    /// So many times the visible set of the view, of which [`Candidate::foresee`] tells.
    Visible {
        /// How many times.
        times: f64,
        /// Triangles of the visible set.
        visible: usize,
    },
    /// By what the frames before gained from their tails.
    Auto(AutoBudget),
    /// Until this much time is over. The traversal is stepped cell by cell, so it is late by up to one cell.
    Deadline(Duration),
}

impl Plan {
    fn foresee(&mut self, now: usize) {
        if let Plan::Visible { visible, .. } = self {
            *visible = now;
        }
    }

    /// Triangles of the next view; `None` where time decides.
    fn budget(&self) -> Option<usize> {
        match self {
            Plan::Triangles(triangles) => Some(*triangles),
            Plan::Visible { times, visible } => Some((times * *visible as f64) as usize),
            Plan::Auto(auto) => Some(auto.budget()),
            Plan::Deadline(_) => None,
        }
    }
}

/// PLP under test.
pub struct PlpCandidate {
    plp: Arc<Plp>,
    plan: Plan,
    plp_scratch: PlpScratch,
    /// For views and regions that PLP leaves whole, and as the occlusion of a culler that hides nothing.
    scratch: Scratch,
    /// Where an automatic budget learns what the frame gained.
    picture: Option<ItemBuffer>,
    budget: Option<usize>,
}

/// An automatic budget looks at a picture with so many times fewer pixels each way. A quarter is a sixteenth of the drawing, and a
/// triangle without a pixel there has few in the whole one.
const PICTURE_SHARE: u32 = 4;

impl PlpCandidate {
    /// Tests PLP under a plan.
    pub fn new(plp: Arc<Plp>, plan: Plan) -> PlpCandidate {
        let (plp_scratch, scratch) = (PlpScratch::default(), Scratch::default());
        PlpCandidate { plp, plan, plp_scratch, scratch, picture: None, budget: None }
    }

    /// Lets an automatic budget learn from the frame that was just chosen. `visible` is what was drawn, ascending.
    fn learn(&mut self, view: &View, visible: &[u32]) {
        let Plan::Auto(auto) = &mut self.plan else { return };
        let Resolution { width, height } = view.resolution;
        let resolution = Resolution::new(width.div_ceil(PICTURE_SHARE), height.div_ceil(PICTURE_SHARE));
        let small = View { resolution, ..*view };
        let picture = self.picture.get_or_insert_with(|| ItemBuffer::new(&small));
        picture.begin(&small);
        picture.draw(self.plp.scene(), visible);
        auto.handle_frame(self.plp_scratch.drawn(), picture.ids());
    }
}

impl Candidate for PlpCandidate {
    fn cull(&mut self, view: &View, region: EyeRegion) -> Culled {
        if view.check().is_err() || region != EyeRegion::point(view.eye) {
            self.budget = None;
            return PlpCuller::new(self.plp.clone(), 0).cull(view, region, &mut self.scratch);
        }
        self.budget = self.plan.budget();
        let traversal = self.plp.traverse(view, self.budget.unwrap_or(usize::MAX), &mut self.plp_scratch);
        if let Plan::Deadline(deadline) = self.plan {
            let began = Instant::now();
            traversal.take_while(|_| began.elapsed() < deadline).for_each(drop);
        } else {
            traversal.for_each(drop);
        }
        let mut visible = self.plp_scratch.drawn().to_vec();
        visible.sort_unstable();
        self.learn(view, &visible);
        let traversal = Traversal {
            cells_projected: self.plp_scratch.projected().len(),
            triangles_drawn: visible.len(),
            plp_triangles: visible.len(),
            ..Traversal::default()
        };
        Culled { visible, traversal, z_tests: 0 }
    }

    fn occlusion(&self) -> &dyn Occlusion {
        self.scratch.occlusion()
    }

    fn foresee(&mut self, visible: usize) {
        self.plan.foresee(visible);
    }

    fn budget(&self) -> Option<usize> {
        self.budget
    }

    /// How much of each model was drawn, as a hint for its level of detail.
    fn layers(&mut self, view: &View) -> Vec<Layer> {
        let scene = self.plp.scene();
        let mut shares = vec![0.0; scene.nodes().len()];
        for share in model_shares(scene, view, self.plp_scratch.drawn()) {
            shares[share.node] = share.share() as f32;
        }
        let mut visible = self.plp_scratch.drawn().to_vec();
        visible.sort_unstable();
        let mut items = ItemBuffer::new(view);
        items.draw(scene, &visible);
        let strength = |id: &u32| match scene.nodes().partition_point(|node| node.primitives.end <= *id) {
            node if node < shares.len() => shares[node],
            _ => 0.0,
        };
        vec![Layer { name: "share of each model drawn", strength: items.ids().iter().map(strength).collect() }]
    }
}

/// The centroid order under test.
pub struct Centroids {
    scene: Arc<Scene>,
    plan: Plan,
    culls_first: bool,
    scratch: Scratch,
    budget: Option<usize>,
}

impl Centroids {
    /// Tests the order under a plan, which may be no deadline: it has no steps. One would draw everything.
    pub fn new(scene: Arc<Scene>, plan: Plan, culls_first: bool) -> Centroids {
        Centroids { scene, plan, culls_first, scratch: Scratch::default(), budget: None }
    }
}

impl Candidate for Centroids {
    fn cull(&mut self, view: &View, region: EyeRegion) -> Culled {
        self.budget = self.plan.budget();
        let budget = self.budget.unwrap_or(usize::MAX);
        CentroidOrder::new(self.scene.clone(), budget, self.culls_first).cull(view, region, &mut self.scratch)
    }

    fn occlusion(&self) -> &dyn Occlusion {
        self.scratch.occlusion()
    }

    fn foresee(&mut self, visible: usize) {
        self.plan.foresee(visible);
    }

    fn budget(&self) -> Option<usize> {
        self.budget
    }
}
