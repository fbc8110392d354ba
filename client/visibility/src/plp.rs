//! What is most likely visible, within a budget? Prioritized-Layered Projection (Klosowski & Silva 2000).
//!
//! From the eye's cell on, always project the cell of the *front* that is least likely to be hidden: the one with the least
//! *solidity*. Its neighbours in view enter the front. PLP is not conservative: it stops when the budget of triangles is
//! spent, and ε_k says which share of the visible set it drew by then.
//!
//! A [`PlpTraversal`] is an iterator over projected cells: it can be stepped, stopped at a deadline by whoever has a clock,
//! and looked at in between from elsewhere. A frame begins without touching all cells; marks carry their frame's number.

use std::cmp::Reverse;
use std::collections::{BinaryHeap, VecDeque};
use std::sync::Arc;

use glam::DVec3;

use crate::front::{CellState, DONE, Entry};
use crate::plp_cells::PlpCells;
use crate::plp_coverage::CoverageImage;
use crate::plp_rules::{PlpRules, Requeue, Seeds, Solidity, SolidityMax, Transfer};
use crate::raster_sampled::Coverage;
use crate::raster_sampled::setup::Projector;
use crate::{CellId, Scene, Sides, Triangle, View};

/// PLP over the cells of a tessellation. Never changes once made, so that workers can share it.
#[derive(Clone, Debug)]
pub struct Plp {
    scene: Arc<Scene>,
    cells: PlpCells,
    rules: PlpRules,
    /// ρ_max.
    most: f32,
}

/// What one worker needs to traverse, kept from frame to frame.
#[derive(Clone, Debug)]
pub struct PlpScratch {
    /// A mark is as old as its frame: `frame` marks count, others are as if never made.
    frame: u32,
    states: Vec<CellState>,
    /// Frame in which each primitive was looked at last.
    seen: Vec<u32>,
    /// By solidity, then first in, first out. An entry counts only if the cell's state still has its `entered`.
    front: BinaryHeap<Reverse<Entry>>,
    entered: u32,
    drawn: Vec<u32>,
    projected: Vec<CellId>,
    /// Triangles of projected cells that looked covered.
    waiting: Vec<u32>,
    /// Cells that looked covered when their turn came.
    covered: VecDeque<CellId>,
    coverage: CoverageImage,
    /// Of a cell under way: triangles by distance.
    order: Vec<(f32, u32)>,
}

impl Default for PlpScratch {
    fn default() -> PlpScratch {
        PlpScratch {
            frame: 0,
            states: Vec::new(),
            seen: Vec::new(),
            front: BinaryHeap::new(),
            entered: 0,
            drawn: Vec::new(),
            projected: Vec::new(),
            waiting: Vec::new(),
            covered: VecDeque::new(),
            coverage: CoverageImage::new(),
            order: Vec::new(),
        }
    }
}

impl PlpScratch {
    /// The primitives that the last traversal drew, in the order in which it chose them, each once.
    pub fn drawn(&self) -> &[u32] {
        &self.drawn
    }

    /// The cells that it projected, in that order.
    pub fn projected(&self) -> &[CellId] {
        &self.projected
    }

    /// The cells of its front now, ascending, each once, with their solidity.
    pub fn front(&self) -> Vec<(CellId, f32)> {
        let counts = |entry: &Entry| self.states[entry.cell as usize].entered == entry.entered;
        let entries = self.front.iter().map(|Reverse(entry)| *entry).filter(counts);
        let mut front: Vec<(CellId, f32)> = entries.map(|entry| (entry.cell, entry.solidity)).collect();
        front.sort_unstable_by_key(|(cell, _)| *cell);
        front
    }

    /// How many cells the last traversal has marked: entered into the front, projected, or found out of view. All others were not
    /// touched. Counting looks at every cell.
    pub fn marked(&self) -> usize {
        self.states.iter().filter(|state| self.frame > 0 && state.frame == self.frame).count()
    }

    fn begin(&mut self, cells: &PlpCells) {
        self.frame = self.frame.wrapping_add(1);
        if self.frame == 0 {
            // Old marks would look new after 2³² frames.
            self.states.fill(CellState::default());
            self.seen.fill(0);
            self.frame = 1;
        }
        self.states.resize(cells.len(), CellState::default());
        self.seen.resize(cells.primitive_total(), 0);
        self.front.clear();
        self.entered = 0;
        self.drawn.clear();
        self.projected.clear();
        self.waiting.clear();
        self.covered.clear();
    }

    fn state(&self, cell: CellId) -> Option<CellState> {
        Some(self.states[cell as usize]).filter(|state| state.frame == self.frame)
    }

    fn enqueue(&mut self, cell: CellId, solidity: f32) {
        self.states[cell as usize] = CellState { frame: self.frame, entered: self.entered, solidity };
        self.front.push(Reverse(Entry { solidity, entered: self.entered, cell }));
        self.entered += 1;
    }

    fn close(&mut self, cell: CellId, solidity: f32) {
        self.states[cell as usize] = CellState { frame: self.frame, entered: DONE, solidity };
    }
}

/// A cell that was projected.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlpStep {
    /// The cell; `None` for a step that only draws triangles that had waited.
    pub cell: Option<CellId>,
    /// Its solidity then.
    pub solidity: f32,
    /// How many triangles the step drew: the last ones of [`PlpTraversal::drawn`].
    pub triangles: usize,
    /// Whether the budget ran out within the cell.
    pub is_partial: bool,
}

impl Plp {
    /// PLP over cells that were made for this scene.
    ///
    /// # Panics
    /// If the cells are another scene's.
    pub fn new(scene: Arc<Scene>, cells: PlpCells, rules: PlpRules) -> Plp {
        assert_eq!(scene.triangles().len(), cells.primitive_total(), "the cells are another scene's");
        let mut counts: Vec<usize> = (0..cells.len() as CellId).map(|cell| cells.primitives(cell).len()).collect();
        counts.retain(|count| *count > 0);
        counts.sort_unstable();
        let share = match rules.solidity_max {
            SolidityMax::Percentile(share) if share >= 0.0 => share.min(1.0),
            _ => 1.0,
        };
        let rank = (counts.len() as f64 * share).ceil() as usize;
        let most = counts.get(rank.max(1) - 1).copied().unwrap_or(1) as f32;
        Plp { scene, cells, rules, most }
    }

    /// The cells.
    pub fn cells(&self) -> &PlpCells {
        &self.cells
    }

    /// The rules.
    pub fn rules(&self) -> &PlpRules {
        &self.rules
    }

    /// ρ_max, by which counts of triangles are divided: the most in a cell, or the percentile that the rules name (§3.1). 1 where no cell
    /// has any.
    pub fn solidity_max(&self) -> f32 {
        self.most
    }

    /// The scene.
    pub fn scene(&self) -> &Arc<Scene> {
        &self.scene
    }

    /// The occluders to draw first for a culler that asks its own image (§6, extension 1): of what a traversal draws within
    /// `budget` triangles, those that occlude, in its order. None for a view that [`View::check`] refuses.
    pub fn occluders(&self, view: &View, budget: usize, scratch: &mut PlpScratch) -> Vec<u32> {
        self.traverse(view, budget, scratch).for_each(drop);
        let occludes = |id: &u32| self.scene.triangles()[*id as usize].occludes;
        scratch.drawn().iter().copied().filter(occludes).collect()
    }

    /// Begins a traversal that draws at most `budget` triangles. Only triangles in view and not turned away are drawn and
    /// counted (§5: view-frustum and back-face culling come first). A view that [`View::check`] refuses has none.
    pub fn traverse<'a>(&'a self, view: &View, budget: usize, scratch: &'a mut PlpScratch) -> PlpTraversal<'a> {
        scratch.begin(&self.cells);
        let view = view.or_without_pixels();
        let by_coverage = if let Solidity::Coverage { columns } = self.rules.solidity {
            scratch.coverage.begin(&view, columns);
            true
        } else {
            false
        };
        let forward = view.axes()[2];
        let mut traversal = PlpTraversal {
            plp: self,
            projector: Projector::new(&view),
            drawable: Drawable::new(&view, by_coverage),
            eye: view.eye,
            forward,
            budget,
            scratch,
            batch: Vec::new(),
        };
        if view.resolution.pixels() > 0 {
            traversal.seed();
        }
        traversal
    }
}

/// A traversal under way: an iterator over the cells that it projects.
pub struct PlpTraversal<'a> {
    plp: &'a Plp,
    projector: Projector,
    drawable: Drawable,
    eye: DVec3,
    forward: DVec3,
    budget: usize,
    scratch: &'a mut PlpScratch,
    batch: Vec<(CellId, f32)>,
}

impl PlpTraversal<'_> {
    /// The primitives drawn so far, in order.
    pub fn drawn(&self) -> &[u32] {
        self.scratch.drawn()
    }

    /// The front as it stands: see [`PlpScratch::front`].
    pub fn front(&self) -> Vec<(CellId, f32)> {
        self.scratch.front()
    }

    fn seed(&mut self) {
        let cells = &self.plp.cells;
        if let Some(cell) = cells.cell_at(self.eye) {
            self.scratch.enqueue(cell, 0.0);
            return;
        }
        let mut facing = cells.hull_facing(self.eye);
        facing.retain(|&cell| self.in_view(cell));
        match self.plp.rules.seeds {
            Seeds::Hull => facing.iter().for_each(|&cell| self.scratch.enqueue(cell, 0.0)),
            Seeds::Nearest => {
                // Distance to the middle of a box would prefer small cells; to its nearest corner is near enough.
                let distance = |cell: CellId| {
                    cells.corners(cell).iter().map(|corner| corner.distance(self.eye)).fold(f64::INFINITY, f64::min)
                };
                let nearest = facing.into_iter().min_by(|&a, &b| distance(a).total_cmp(&distance(b)));
                nearest.into_iter().for_each(|cell| self.scratch.enqueue(cell, 0.0));
            }
        }
    }

    /// Whether any of a cell may be in view.
    fn in_view(&self, cell: CellId) -> bool {
        let corners = self.plp.cells.corners(cell);
        let mut points = [self.projector.view_point(self.eye); 8];
        let count = corners.len();
        points[..count].iter_mut().zip(corners.iter()).for_each(|(p, corner)| *p = self.projector.view_point(*corner));
        let points = &points[..count];
        points.iter().any(|p| p.w >= 0.0) && !self.projector.outside(points, 0.0)
    }

    /// Takes the least solid cell out of the front.
    fn pop(&mut self) -> Option<(CellId, f32)> {
        while let Some(Reverse(entry)) = self.scratch.front.pop() {
            let state = self.scratch.states[entry.cell as usize];
            if state.entered != entry.entered {
                continue;
            }
            if self.by_coverage() {
                let solidity = self.covered_share(entry.cell);
                if solidity >= 1.0 {
                    self.scratch.close(entry.cell, solidity);
                    self.scratch.covered.push_back(entry.cell);
                    continue;
                }
                return Some((entry.cell, solidity));
            }
            return Some((entry.cell, entry.solidity));
        }
        self.scratch.covered.pop_front().map(|cell| (cell, 1.0))
    }

    fn by_coverage(&self) -> bool {
        matches!(self.plp.rules.solidity, Solidity::Coverage { .. })
    }

    /// Solidity by coverage: of a cell's triangles, or of its middle and corners if it has none.
    fn covered_share(&self, cell: CellId) -> f32 {
        let PlpScratch { coverage, seen, frame, .. } = &*self.scratch;
        let primitives = self.plp.cells.primitives(cell);
        let (mut asked, mut covered) = (0, 0);
        let stride = primitives.len().div_ceil(SAMPLES).max(1);
        for &id in primitives.iter().step_by(stride).filter(|id| seen[**id as usize] != *frame) {
            let triangle = &self.plp.scene.triangles()[id as usize];
            if self.drawable.holds(triangle) {
                asked += 1;
                covered += u32::from(coverage.covers_triangle(triangle));
            }
        }
        if asked == 0 {
            let middle = self.plp.cells.centre(cell);
            let corners = self.plp.cells.corners(cell);
            for point in corners.iter().map(|corner| corner.lerp(middle, 0.1)).chain([middle]) {
                if let Some(is_covered) = coverage.covers(point) {
                    asked += 1;
                    covered += u32::from(is_covered);
                }
            }
        }
        if asked == 0 { 0.0 } else { covered as f32 / asked as f32 }
    }

    /// Draws the triangles of a cell that were not drawn yet, as far as the budget goes.
    fn project(&mut self, cell: CellId, solidity: f32) -> PlpStep {
        self.scratch.projected.push(cell);
        let by_coverage = self.by_coverage();
        let before = self.scratch.drawn.len();
        let mut is_partial = false;
        let mut order = std::mem::take(&mut self.scratch.order);
        order.clear();
        let triangles = self.plp.scene.triangles();
        for &id in self.plp.cells.primitives(cell) {
            let triangle = &triangles[id as usize];
            if self.scratch.seen[id as usize] != self.scratch.frame && self.drawable.holds(triangle) {
                let [a, b, c] = triangle.corners;
                order.push((((a + b + c) / 3.0).distance_squared(self.eye.as_vec3()), id));
            }
        }
        if by_coverage {
            order.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        }
        for &(_, id) in &order {
            let scratch = &mut *self.scratch;
            let triangle = &triangles[id as usize];
            if scratch.drawn.len() >= self.budget {
                is_partial = true;
                break;
            }
            scratch.seen[id as usize] = scratch.frame;
            if by_coverage {
                if scratch.coverage.covers_triangle(triangle) {
                    scratch.waiting.push(id);
                    continue;
                }
                scratch.coverage.draw(triangle);
            }
            scratch.drawn.push(id);
        }
        self.scratch.order = order;
        PlpStep { cell: Some(cell), solidity, triangles: self.scratch.drawn.len() - before, is_partial }
    }

    /// Puts the neighbours of a projected cell into the front (figure 4, lines 6 to 10).
    fn spread(&mut self, cell: CellId, solidity: f32) {
        let rules = &self.plp.rules;
        let own = (self.plp.cells.primitives(cell).len() as f32 / self.plp.most).min(1.0);
        let mut batch = std::mem::take(&mut self.batch);
        batch.clear();
        self.plp.cells.portals(cell, |portal| {
            let known = self.scratch.state(portal.cell);
            let is_done = known.is_some_and(|state| state.entered == DONE);
            if is_done || (known.is_some() && rules.requeue == Requeue::Never) {
                return;
            }
            let accumulated = match rules.solidity {
                // What covers it does not depend on the way to it, and is looked at when its turn comes.
                Solidity::Coverage { .. } => {
                    if known.is_none() {
                        batch.push((portal.cell, self.plp.cells.centre(portal.cell).distance(self.eye) as f32));
                    }
                    return;
                }
                Solidity::Count => {
                    let middle = self.plp.cells.centre(portal.cell);
                    let direction = match rules.transfer {
                        Transfer::View => self.forward,
                        Transfer::Cell => (middle - self.eye).normalize_or_zero(),
                    };
                    // Figure 5. "How orthogonal the face is to the view direction" has no sign: a way back transfers as much as
                    // the way there, or else every cell could be reached from behind with nothing accumulated.
                    let transfer = direction.dot(portal.normal).abs() as f32;
                    let accumulated = own + transfer * solidity;
                    let is_star_shaped = portal.is_passed(self.eye, middle);
                    if is_star_shaped { accumulated } else { accumulated * rules.penalty_factor }
                }
            };
            if rules.requeue != Requeue::IfLess || known.is_none_or(|state| accumulated < state.solidity) {
                batch.push((portal.cell, accumulated));
            }
        });
        for &(cell, accumulated) in &batch {
            let is_known = self.scratch.state(cell).is_some();
            if !is_known && !self.in_view(cell) {
                self.scratch.close(cell, f32::INFINITY);
                continue;
            }
            self.scratch.enqueue(cell, accumulated);
        }
        self.batch = batch;
    }
}

impl Iterator for PlpTraversal<'_> {
    type Item = PlpStep;

    /// Projects the next cell. `None` once the budget is spent or everything in view is drawn.
    fn next(&mut self) -> Option<PlpStep> {
        if self.scratch.drawn.len() >= self.budget {
            return None;
        }
        let Some((cell, solidity)) = self.pop() else {
            let scratch = &mut *self.scratch;
            let room = (self.budget - scratch.drawn.len()).min(scratch.waiting.len());
            let is_partial = room < scratch.waiting.len();
            scratch.drawn.extend(scratch.waiting.drain(..room));
            return (room > 0).then_some(PlpStep { cell: None, solidity: 1.0, triangles: room, is_partial });
        };
        let step = self.project(cell, solidity);
        self.scratch.close(cell, solidity);
        if !step.is_partial {
            self.spread(cell, solidity);
        }
        Some(step)
    }
}

/// Which triangles are drawn and counted: those in view and not turned away (§5), by the rule of coverage without those
/// that hold no pixel centre.
struct Drawable {
    projector: Projector,
    eye: DVec3,
    centres: Option<Coverage>,
}

impl Drawable {
    fn new(view: &View, only_with_centres: bool) -> Drawable {
        let centres = only_with_centres.then(|| Coverage::new(view));
        Drawable { projector: Projector::new(view), eye: view.eye, centres }
    }

    fn holds(&self, triangle: &Triangle) -> bool {
        match &self.centres {
            Some(centres) => centres.may_draw(triangle),
            None => in_view_and_facing(&self.projector, self.eye, triangle),
        }
    }
}

/// View-frustum and back-face culling of one triangle.
pub(crate) fn in_view_and_facing(projector: &Projector, eye: DVec3, triangle: &Triangle) -> bool {
    let corners = triangle.corners.map(|corner| corner.as_dvec3());
    let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
    if triangle.sides == Sides::Front && normal.dot(eye - corners[0]) <= 0.0 {
        return false;
    }
    let points = corners.map(|corner| projector.view_point(corner));
    points.iter().any(|p| p.w >= projector.near) && !projector.outside(&points, 0.0)
}

/// The most triangles of a cell that are asked about before it is projected.
const SAMPLES: usize = 16;
