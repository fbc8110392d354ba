//! What does a comparison ask of a culler, and what does it keep for it from frame to frame?

use std::sync::Arc;

use eyeline_client::plan;
use eyeline_protocol::PlanSwitch;
use eyeline_visibility::{
    Aabb, Budget, Cplp, CplpScratch, CpuQuery, Culled, Culler, DepthBuffer, EyeRegion, NothingHidden, Occlusion,
    Planned, QueryBackEnd, QueryKind, Round, Scene, SceneCounts, Scratch, Triangle, View,
};

use super::picture::Layer;

/// A culler under test, with all that it keeps from frame to frame.
pub trait Candidate {
    /// Culls a view, for every eye of the region.
    fn cull(&mut self, view: &View, region: EyeRegion) -> Culled;

    /// What the last cull knows to be hidden.
    fn occlusion(&self) -> &dyn Occlusion;

    /// Tells how many static triangles own a pixel of the views that follow, for budgets that are multiples of it.
    fn foresee(&mut self, _visible: usize) {}

    /// Triangles that the last cull might draw by guess, if it knew beforehand.
    fn budget(&self) -> Option<usize> {
        None
    }

    /// Draws opaque triangles that are no part of the scene, in its coordinates, so that they hide from now on what lies behind
    /// them in the view of the last cull. Returns whether the culler can.
    fn draw_moving(&mut self, _triangles: &[Triangle]) -> bool {
        false
    }

    /// Comparisons of depths of the last cull, drawing and queries, if it draws a Z-buffer of its own. Else the report counts
    /// those that drawing the visible set takes.
    fn z_tests(&self) -> Option<u64> {
        None
    }

    /// For a culler that speaks for another rasteriser's pictures than the CPU's: the winners of each pixel of everything, and of
    /// these primitives alone, ascending, by that one. Lost and wrong is then what differs between these two.
    fn own_pictures(&mut self, _view: &View, _visible: &[u32]) -> Option<[Vec<u32>; 2]> {
        None
    }

    /// Bytes that the last cull read back from an adapter's memory, if it has one.
    fn read_back_bytes(&self) -> Option<u64> {
        None
    }

    /// Why the culler cannot work, or what went wrong since it was made.
    fn fault(&self) -> Option<String> {
        None
    }

    /// What the culler can show of itself in a view: the front, finished tiles.
    fn layers(&mut self, _view: &View) -> Vec<Layer> {
        Vec::new()
    }
}

/// Any culler with a scratch of its own.
pub struct WithScratch<C> {
    culler: C,
    scratch: Scratch,
    z_tests: u64,
}

impl<C> WithScratch<C> {
    /// Gives a culler its scratch.
    pub fn new(culler: C) -> WithScratch<C> {
        WithScratch { culler, scratch: Scratch::default(), z_tests: 0 }
    }
}

impl<C: Culler> Candidate for WithScratch<C> {
    fn cull(&mut self, view: &View, region: EyeRegion) -> Culled {
        let culled = self.culler.cull(view, region, &mut self.scratch);
        self.z_tests = culled.z_tests;
        culled
    }

    fn occlusion(&self) -> &dyn Occlusion {
        self.scratch.occlusion()
    }

    fn draw_moving(&mut self, triangles: &[Triangle]) -> bool {
        self.scratch.draw_moving(triangles)
    }

    fn z_tests(&self) -> Option<u64> {
        (self.z_tests > 0).then_some(self.z_tests)
    }
}

/// The culler that follows a plan.
pub struct PlannedCandidate {
    scene: Arc<Scene>,
    switch: PlanSwitch,
    /// As soon as it is known from where one looks.
    planned: Option<Planned>,
}

impl PlannedCandidate {
    /// Counts around the first eye that it is given.
    pub fn new(scene: Arc<Scene>, switch: PlanSwitch) -> PlannedCandidate {
        PlannedCandidate { scene, switch, planned: None }
    }
}

impl Candidate for PlannedCandidate {
    fn cull(&mut self, view: &View, region: EyeRegion) -> Culled {
        let planned = self
            .planned
            .get_or_insert_with(|| plan::planned(SceneCounts::around(self.scene.clone(), view.eye), self.switch));
        planned.look(view, region)
    }

    fn occlusion(&self) -> &dyn Occlusion {
        self.planned.as_ref().map_or(&NothingHidden, |planned| planned.occlusion())
    }

    fn draw_moving(&mut self, triangles: &[Triangle]) -> bool {
        self.planned.as_mut().is_some_and(|planned| planned.draw_moving(triangles))
    }
}

/// cPLP with any query back end, which can show its front.
pub struct WithFront<C> {
    inner: WithScratch<C>,
    scene: Arc<Scene>,
    cplp: Arc<Cplp>,
    budget: Budget,
    query: QueryKind,
}

impl<C> WithFront<C> {
    /// Shows what a culler over these cells does with this budget; its pictures ask by `query`.
    pub fn new(culler: C, scene: Arc<Scene>, cplp: Arc<Cplp>, budget: Budget, query: QueryKind) -> WithFront<C> {
        WithFront { inner: WithScratch::new(culler), scene, cplp, budget, query }
    }
}

impl<C: Culler> Candidate for WithFront<C> {
    fn cull(&mut self, view: &View, region: EyeRegion) -> Culled {
        self.inner.cull(view, region)
    }

    fn occlusion(&self) -> &dyn Occlusion {
        self.inner.occlusion()
    }

    fn draw_moving(&mut self, triangles: &[Triangle]) -> bool {
        self.inner.draw_moving(triangles)
    }

    fn budget(&self) -> Option<usize> {
        Some(self.budget.triangles)
    }

    fn z_tests(&self) -> Option<u64> {
        self.inner.z_tests()
    }

    fn layers(&mut self, view: &View) -> Vec<Layer> {
        // The paper's figure 10: what each of the first rounds asks about, past what was drawn before it, and which tiles are
        // finished then.
        let mut layers = Vec::new();
        let mut query = self.query.back_end();
        let mut drawn: Vec<u32> = {
            let mut depth = DepthBuffer::new(view);
            let (mut scratch, eye) = (CplpScratch::default(), EyeRegion::point(view.eye));
            self.cplp.traverse_plp(&self.scene, eye, self.budget, &mut depth.target(&self.scene), &mut scratch);
            scratch.visible().to_vec()
        };
        let cells = self.cplp.tessellation().clone();
        let watch = |round: Round<'_>, query: &CpuQuery| {
            if let Some(name) = FRONTS.get(round.number - 1) {
                let boxes: Vec<Aabb> = round.cells.iter().map(|&cell| *cells.cell(cell)).collect();
                layers.push(Layer::of_boxes(name, &self.scene, &drawn, &boxes, view));
                let tiles = query.finished_tiles();
                if !tiles.is_empty() {
                    layers.push(Layer::of_tiles(FINISHED[round.number - 1], &tiles, view.resolution));
                }
            }
            let seen = round.cells.iter().zip(round.seen).filter(|(_, seen)| **seen);
            drawn.extend(seen.flat_map(|(&cell, _)| cells.primitives(cell)));
        };
        self.cplp.watch_rounds(&self.scene, view, self.budget, &mut query, &mut CplpScratch::default(), watch);
        layers
    }
}

/// Names of the pictures of the first rounds.
const FRONTS: [&str; 2] = ["front, round 1", "front, round 2"];
const FINISHED: [&str; 2] = ["finished tiles, round 1", "finished tiles, round 2"];
