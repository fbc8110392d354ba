//! Which cells can be seen? Conservative Prioritized-Layered Projection (Klosowski & Silva 2001) over any tessellation.
//!
//! First PLP (Klosowski & Silva 2000, §3.2): from the eye's cell on, always project (draw the triangles of) the cell of
//! the front with the least accumulated solidity, until a budget of triangles is spent. Then the conservative phase: ask
//! the target which cells of the front can be seen past what was drawn, project those, and repeat until the front is
//! empty. The order is a guess and only costs time; completeness rests on the queries.
//!
//! Why nothing visible is missed: take a pixel, its winner's point q and the segment from the eye to q. Each closed cell on
//! the segment is at most as far as q, so it is *seen* whatever was drawn before (a tie is seen, (d) of DESIGN.md §4). The
//! cells on it form a chain over shared faces, also where it runs along an edge, since every cell around the edge touches
//! it and is seen too. The chain begins at a seed: a cell that touches the eye, or, where the segment enters the root
//! box from outside, a cell with a hull face that faces the eye (b). So each of them is projected, the last of them with q's
//! triangle (a). Nothing nearer than the near plane is drawn, but chains run through it: a target's cells have no near
//! plane (c, e). A sealed face (f) that the target believes ends a chain: the target then says that q is next to where the
//! chain meets it, so that the cell in front of the first such face, which was projected, lists q's triangle.

use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::sync::Arc;

use glam::DVec3;

use crate::front::{CellState, DONE, Entry};
use crate::{Aabb, CellId, Cells, EyeRegion, Face, Neighbour, Octree, OctreeRules, Scene, Target, Tessellation};

/// How much PLP may draw by guess before queries begin.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Budget {
    /// The PLP phase ends with the cell that reaches this number of triangles. 0: everything but the eye's cells is
    /// queried. Default 100: a query costs a CPU less than a wrong guess, so that a larger budget only draws more (0: 475
    /// triangles in 8 rounds per frame of the bench building; 100: 487 in 6; 500: 691 in 3). Back ends that wait for
    /// each round want more.
    pub triangles: usize,
}

impl Default for Budget {
    fn default() -> Budget {
        Budget { triangles: 100 }
    }
}

/// What a traversal did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Traversal {
    /// Cells whose triangles were drawn.
    pub cells_projected: usize,
    /// Times that a whole front was queried, as the paper counts: what a batched back end would wait for. 0 for cullers without
    /// fronts.
    pub rounds: usize,
    /// Images that queries drew, where a back end draws them: several a round for the item buffer, one for the per-fragment
    /// histogram.
    pub passes: usize,
    /// Cells asked about; of [`crate::MaskedCplp`] faces between cells.
    pub queries: usize,
    /// Depths compared, pixels or tiles, by queries about boxes that turned out to be seen: what an occupancy map spares. 0 for
    /// cullers that do not count them.
    pub seen_z_tests: u64,
    /// Cells of which an occupancy map was asked, and of which it, or a few pixels beside it, knew that they are seen. 0 for cullers without
    /// maps.
    pub mapped: [usize; 2],
    /// Values that answers to queries brought back to the host: pixels of an item buffer, bins, flags, counters. 0 for cullers that ask
    /// no query back end.
    pub read_back: u64,
    /// Sealed faces that were believed, so that they did not lead on.
    pub sealed: usize,
    /// Sealed faces that were not: at this resolution, from this eye, they count as open.
    pub doubted: usize,
    /// The size of the visible set: triangles drawn, each once, where the traversal draws those.
    pub triangles_drawn: usize,
    /// How many of these PLP drew within its budget, before any query, the eye's own cells included.
    pub plp_triangles: usize,
    /// Polygons drawn as occluders, where these are not the triangles of the visible set.
    pub polygons_drawn: usize,
    /// Boxes of objects and clusters asked about.
    pub bounds_tested: usize,
}

/// PLP and cPLP over the cells of a tessellation. Never changes once made, so that workers can share it.
#[derive(Clone, Debug)]
pub struct Cplp {
    tessellation: Arc<dyn Tessellation>,
}

/// What one worker needs to traverse, kept from frame to frame. Starting a frame touches nothing of the last one.
#[derive(Clone, Debug, Default)]
pub struct CplpScratch {
    /// A mark is as old as its frame: `frame` marks count, others are as if never made.
    frame: u32,
    cells: Vec<CellState>,
    /// Frame in which each primitive was drawn last.
    drawn: Vec<u32>,
    /// By solidity, then first in, first out. An entry counts only if the cell's state still has its `entered`.
    front: BinaryHeap<Reverse<Entry>>,
    /// Cells put into the front in a round, which are candidates only in the next one.
    entered: u32,
    round: Vec<Entry>,
    seeds: Vec<CellId>,
    batch: Vec<u32>,
    visible: Vec<u32>,
    projected: Vec<CellId>,
    records_fronts: bool,
    /// Cells of the fronts one after the other, and where each front ends.
    fronts: Vec<CellId>,
    front_ends: Vec<usize>,
}

impl CplpScratch {
    /// The primitives that the last traversal drew, ascending, each once: its visible set.
    pub fn visible(&self) -> &[u32] {
        &self.visible
    }

    /// The cells that the last traversal projected, in that order.
    pub fn projected(&self) -> &[CellId] {
        &self.projected
    }

    /// Whether the next traversals keep their fronts, for pictures. Off by default: it takes time.
    pub fn record_fronts(&mut self, records: bool) {
        self.records_fronts = records;
    }

    /// The fronts of the last traversal if they were recorded: what PLP left, then what each round found; the last one is
    /// empty if the traversal ran to its end. Each in the order of projection.
    pub fn fronts(&self) -> impl ExactSizeIterator<Item = &[CellId]> {
        let begin = |i: usize| if i == 0 { 0 } else { self.front_ends[i - 1] };
        (0..self.front_ends.len()).map(move |i| &self.fronts[begin(i)..self.front_ends[i]])
    }

    fn record(&mut self, round: &[Entry]) {
        if self.records_fronts {
            self.fronts.extend(round.iter().map(|entry| entry.cell));
            self.front_ends.push(self.fronts.len());
        }
    }

    fn begin(&mut self, cells: &Cells) {
        self.frame = self.frame.wrapping_add(1);
        if self.frame == 0 {
            // Old marks would look new after 2³² frames.
            self.cells.fill(CellState::default());
            self.drawn.fill(0);
            self.frame = 1;
        }
        self.cells.resize(cells.len(), CellState::default());
        self.drawn.resize(cells.primitive_total(), 0);
        self.front.clear();
        self.entered = 0;
        self.visible.clear();
        self.projected.clear();
        self.fronts.clear();
        self.front_ends.clear();
    }

    fn is_done(&self, cell: CellId) -> bool {
        let state = self.cells[cell as usize];
        state.frame == self.frame && state.entered == DONE
    }

    fn set_done(&mut self, cell: CellId) {
        let state = &mut self.cells[cell as usize];
        state.frame = self.frame;
        state.entered = DONE;
    }

    /// Puts a cell into the front, or again with another solidity.
    fn enqueue(&mut self, cell: CellId, solidity: f32) {
        self.cells[cell as usize] = CellState { frame: self.frame, entered: self.entered, solidity };
        self.front.push(Reverse(Entry { solidity, entered: self.entered, cell }));
        self.entered += 1;
    }

    /// Takes the least solid cell out of the front.
    fn pop(&mut self) -> Option<CellId> {
        while let Some(Reverse(entry)) = self.front.pop() {
            if self.cells[entry.cell as usize].entered == entry.entered {
                return Some(entry.cell);
            }
        }
        None
    }
}

impl Cplp {
    /// Traverses these cells.
    pub fn new(tessellation: Arc<dyn Tessellation>) -> Cplp {
        Cplp { tessellation }
    }

    /// Splits the scene into octree cells by `rules` and traverses those.
    pub fn build(scene: &Scene, rules: OctreeRules) -> Cplp {
        Cplp::new(Arc::new(Octree::build(scene, rules)))
    }

    /// The cells.
    pub fn tessellation(&self) -> &Arc<dyn Tessellation> {
        &self.tessellation
    }

    /// Draws every cell of `scene` that may be seen from the eye region into `target`, which must be empty, and leaves the
    /// visible set in `scratch`. The scene must be the one that the cells were made for.
    ///
    /// With a radius the cells within reach of the ball are seeds, and so is each hull cell that some eye of it faces from
    /// outside; `target.sees` must then hold for every eye of the ball (occluders shrunk, boxes grown), as must "out of
    /// view". A target for the centre alone would miss what only the others see.
    pub fn traverse<T: Target>(
        &self,
        scene: &Scene,
        eye: EyeRegion,
        budget: Budget,
        target: &mut T,
        scratch: &mut CplpScratch,
    ) -> Traversal {
        self.run(scene, eye, budget, target, scratch, |run| run.conservative())
    }

    /// PLP alone: stops when the budget is spent, whatever is still visible. Not conservative.
    pub fn traverse_plp<T: Target>(
        &self,
        scene: &Scene,
        eye: EyeRegion,
        budget: Budget,
        target: &mut T,
        scratch: &mut CplpScratch,
    ) -> Traversal {
        self.run(scene, eye, budget, target, scratch, |_| ())
    }

    /// PLP to its budget, then what `after_plp` does with the front.
    pub(crate) fn run<T: Target>(
        &self,
        scene: &Scene,
        eye: EyeRegion,
        budget: Budget,
        target: &mut T,
        scratch: &mut CplpScratch,
        after_plp: impl FnOnce(&mut Run<'_, T>),
    ) -> Traversal {
        let cells = self.tessellation.cells();
        assert_eq!(scene.triangles().len(), cells.primitive_total(), "the cells are another scene's");
        let mut run = Run { cells, eye: eye.centre, target, scratch, done: Traversal::default() };
        run.scratch.begin(cells);
        run.seed(eye, &*self.tessellation);
        run.plp(budget);
        run.done.plp_triangles = run.scratch.visible.len();
        after_plp(&mut run);
        run.scratch.visible.sort_unstable();
        run.done.triangles_drawn = run.scratch.visible.len();
        run.done
    }
}

/// One traversal under way.
pub(crate) struct Run<'a, T> {
    cells: &'a Cells,
    eye: DVec3,
    pub(crate) target: &'a mut T,
    scratch: &'a mut CplpScratch,
    pub(crate) done: Traversal,
}

impl<T: Target> Run<'_, T> {
    /// Projects the cells that touch the eye region, and puts hull cells that face it from outside into the front.
    fn seed(&mut self, eye: EyeRegion, tessellation: &dyn Tessellation) {
        let root = self.cells.root();
        let mut seeds = std::mem::take(&mut self.scratch.seeds);
        for face in Face::ALL {
            if face.height(&root, eye.centre) > -eye.radius {
                seeds.extend_from_slice(self.cells.hull(face));
            }
        }
        // Nearest first: PLP's own seed, and a good order for occlusion.
        seeds.sort_by(|&a, &b| {
            let distance = |cell| self.cells.aabb(cell).distance(eye.centre);
            distance(a).total_cmp(&distance(b)).then(a.cmp(&b))
        });
        seeds.dedup();
        for &cell in &seeds {
            self.scratch.enqueue(cell, 0.0);
        }
        seeds.clear();
        tessellation.cells_within(eye.centre, eye.radius, &mut |cell| seeds.push(cell));
        for &cell in &seeds {
            self.scratch.enqueue(cell, 0.0);
            self.project(cell);
        }
        seeds.clear();
        self.scratch.seeds = seeds;
    }

    /// Projects by solidity alone until the budget is spent, and leaves the rest to [`Run::conservative`].
    fn plp(&mut self, budget: Budget) {
        while self.scratch.visible.len() < budget.triangles {
            let Some(cell) = self.scratch.pop() else { break };
            if self.target.in_view(self.cells.aabb(cell)) {
                self.project(cell);
            } else {
                self.scratch.set_done(cell);
            }
        }
    }

    /// Queries whole fronts until one is empty. What is found hidden is so for good, since drawing only hides more.
    fn conservative(&mut self) {
        let mut round = std::mem::take(&mut self.scratch.round);
        while !self.target.is_full() {
            round.clear();
            while let Some(cell) = self.scratch.pop() {
                let CellState { solidity, entered, .. } = self.scratch.cells[cell as usize];
                round.push(Entry { solidity, entered, cell });
            }
            self.scratch.record(&round);
            if round.is_empty() {
                break;
            }
            self.done.rounds += 1;
            for &Entry { cell, .. } in &round {
                // Asking just before drawing, not all before all, lets a round's cells hide each other.
                self.done.queries += 1;
                if self.target.sees(self.cells.aabb(cell)) {
                    self.project(cell);
                } else {
                    self.scratch.set_done(cell);
                }
            }
        }
        self.scratch.round = round;
    }

    /// Takes all cells out of the front, the least solid one first.
    pub(crate) fn take_front(&mut self, cells: &mut Vec<CellId>) {
        cells.clear();
        while let Some(cell) = self.scratch.pop() {
            cells.push(cell);
        }
    }

    /// Gives up a cell that was found hidden.
    pub(crate) fn hide(&mut self, cell: CellId) {
        self.scratch.set_done(cell);
    }

    /// The box of a cell.
    pub(crate) fn aabb(&self, cell: CellId) -> &Aabb {
        self.cells.aabb(cell)
    }

    /// Draws what a cell holds, and puts its neighbours into the front.
    pub(crate) fn project(&mut self, cell: CellId) {
        self.scratch.set_done(cell);
        self.scratch.projected.push(cell);
        self.done.cells_projected += 1;
        let scratch = &mut *self.scratch;
        scratch.batch.clear();
        for &id in self.cells.primitives(cell) {
            let drawn = &mut scratch.drawn[id as usize];
            if *drawn != scratch.frame {
                *drawn = scratch.frame;
                scratch.batch.push(id);
            }
        }
        if !scratch.batch.is_empty() {
            scratch.visible.extend_from_slice(&scratch.batch);
            self.target.draw(&scratch.batch);
        }
        for neighbour in self.cells.neighbours(cell) {
            if self.scratch.is_done(neighbour.cell) {
                continue;
            }
            if let Some(seal) = self.cells.seal(cell, neighbour) {
                let believed = self.target.believes(&seal);
                *if believed { &mut self.done.sealed } else { &mut self.done.doubted } += 1;
                if believed {
                    continue;
                }
            }
            let solidity = self.solidity(neighbour, cell);
            self.scratch.enqueue(neighbour.cell, solidity);
        }
    }

    /// PLP's `update_solidity(b, a)`, figure 5, for the face of `a` that leads to `b`.
    ///
    /// The view direction is the one from the eye to the middle of the shared face, not the camera's, so that it means
    /// the same for a target that looks all round. A face that looks back at the eye transfers nothing.
    fn solidity(&self, b: &Neighbour, a: CellId) -> f32 {
        let shared = self.cells.shared(a, b);
        let axis = b.face.axis();
        let sign = if b.face.is_positive() { 1.0 } else { -1.0 };
        let towards = (shared.centre() - self.eye).normalize_or_zero();
        let alignment = (towards[axis] * sign).max(0.0) as f32;
        let own = self.cells.primitives(a).len() as f32 / self.cells.primitives_max().max(1) as f32;
        let solidity = own + alignment * self.scratch.cells[a as usize].solidity;
        if star_shaped(self.eye, self.cells.aabb(b.cell), &shared, axis) { solidity } else { solidity * STAR_PENALTY }
    }
}

/// Factor for a cell whose middle is not seen from the eye through the shared face. The papers give no value.
const STAR_PENALTY: f32 = 2.0;

/// Whether the segment from the eye to the middle of `cell` passes through `shared`, a face perpendicular to `axis`.
fn star_shaped(eye: DVec3, cell: &Aabb, shared: &Aabb, axis: usize) -> bool {
    let along = cell.centre() - eye;
    let t = (shared.min[axis] - eye[axis]) / along[axis];
    let at = eye + along * t;
    (0.0..=1.0).contains(&t)
        && (0..3).all(|other| other == axis || (shared.min[other]..=shared.max[other]).contains(&at[other]))
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;
    use crate::{Sides, Triangle};

    /// Sees boxes whose middle a predicate likes, and remembers what was drawn.
    struct Probe<F> {
        sees: F,
        drawn: Vec<u32>,
        full: bool,
    }

    impl<F: Fn(&Aabb) -> bool> Target for Probe<F> {
        fn draw(&mut self, primitives: &[u32]) {
            self.drawn.extend_from_slice(primitives);
        }
        fn sees(&self, aabb: &Aabb) -> bool {
            (self.sees)(aabb)
        }
        fn is_full(&self) -> bool {
            self.full
        }
    }

    fn probe<F: Fn(&Aabb) -> bool>(sees: F) -> Probe<F> {
        Probe { sees, drawn: Vec::new(), full: false }
    }

    /// A field of small triangles, one per metre of a square.
    fn field(side: u32) -> Scene {
        let triangle = |i: u32| {
            let at = Vec3::new((i % side) as f32, 0.0, (i / side) as f32);
            Triangle { corners: [at, at + Vec3::X * 0.3, at + Vec3::Y * 0.3], sides: Sides::Both, occludes: true }
        };
        Scene::from_triangles((0..side * side).map(triangle).collect())
    }

    fn cplp(scene: &Scene) -> Cplp {
        Cplp::build(scene, OctreeRules::default().with_max_triangles_per_leaf(4))
    }

    const NO_GUESS: Budget = Budget { triangles: 0 };

    #[test]
    fn where_nothing_is_hidden_everything_is_drawn_once() {
        let scene = field(20);
        let cplp = cplp(&scene);
        let mut scratch = CplpScratch::default();
        for (eye, budget) in [
            (DVec3::new(5.0, 0.1, 5.0), NO_GUESS),
            (DVec3::new(-50.0, 3.0, 5.0), NO_GUESS),
            (DVec3::new(5.0, 0.1, 5.0), Budget { triangles: 100 }),
            (cplp.tessellation().root().max, NO_GUESS),
            (DVec3::new(5.0, 0.1, 5.0), Budget { triangles: usize::MAX }),
        ] {
            let mut target = probe(|_| true);
            let done = cplp.traverse(&scene, EyeRegion::point(eye), budget, &mut target, &mut scratch);
            assert_eq!(scratch.visible(), (0..400).collect::<Vec<u32>>());
            assert_eq!(done.triangles_drawn, 400);
            assert_eq!(done.cells_projected, cplp.tessellation().cell_count());
            target.drawn.sort_unstable();
            assert_eq!(target.drawn, scratch.visible());
        }
    }

    #[test]
    fn where_everything_is_hidden_only_the_cells_at_the_eye_are_drawn() {
        let scene = field(20);
        let cplp = cplp(&scene);
        let mut scratch = CplpScratch::default();
        let eye = EyeRegion::point(DVec3::new(5.123, 0.1, 5.123));
        let mut target = probe(|_| false);
        let done = cplp.traverse(&scene, eye, NO_GUESS, &mut target, &mut scratch);
        let cell = cplp.tessellation().cell_at(eye.centre).unwrap();
        assert_eq!(scratch.visible(), cplp.tessellation().primitives(cell));
        assert_eq!((done.cells_projected, done.rounds), (1, 1));
        assert_eq!(done.queries, cplp.tessellation().neighbours(cell).len());

        let far = EyeRegion::point(DVec3::new(-50.0, 0.1, 5.0));
        let done = cplp.traverse(&scene, far, NO_GUESS, &mut probe(|_| false), &mut scratch);
        assert!(scratch.visible().is_empty());
        assert_eq!(done.queries, cplp.tessellation().hull(Face::ALL[0]).len());
    }

    #[test]
    fn a_traversal_crosses_only_cells_that_are_seen() {
        let scene = field(20);
        let cplp = cplp(&scene);
        let mut scratch = CplpScratch::default();
        let eye = EyeRegion::point(DVec3::new(2.1, 0.1, 2.1));
        // A wall at x = 10 with a door near z = 15.
        let open =
            |aabb: &Aabb| !(aabb.min.x <= 10.0 && aabb.max.x >= 10.0) || (aabb.min.z <= 15.0 && aabb.max.z >= 15.0);
        cplp.traverse(&scene, eye, NO_GUESS, &mut probe(open), &mut scratch);
        assert!(scratch.visible().contains(&399));
        let shut = |aabb: &Aabb| !(aabb.min.x <= 10.0 && aabb.max.x >= 10.0);
        cplp.traverse(&scene, eye, NO_GUESS, &mut probe(shut), &mut scratch);
        assert!(!scratch.visible().contains(&399));
        assert!(scratch.visible().len() > 100);
    }

    #[test]
    fn plp_alone_keeps_to_its_budget() {
        let scene = field(20);
        let cplp = cplp(&scene);
        let mut scratch = CplpScratch::default();
        let eye = EyeRegion::point(DVec3::new(2.1, 0.1, 2.1));
        let done = cplp.traverse_plp(&scene, eye, Budget { triangles: 50 }, &mut probe(|_| true), &mut scratch);
        assert!((50..50 + cplp.tessellation().primitives_max()).contains(&done.triangles_drawn));
        assert_eq!((done.queries, done.rounds), (0, 0));
    }

    #[test]
    fn recorded_fronts_are_those_that_were_asked_about() {
        let scene = field(20);
        let cplp = cplp(&scene);
        let mut scratch = CplpScratch::default();
        let eye = EyeRegion::point(DVec3::new(2.1, 0.1, 2.1));
        let near = |aabb: &Aabb| aabb.distance(eye.centre) < 6.0;
        let done = cplp.traverse(&scene, eye, NO_GUESS, &mut probe(near), &mut scratch);
        assert_eq!(scratch.fronts().len(), 0);
        assert_eq!(scratch.projected().len(), done.cells_projected);
        scratch.record_fronts(true);
        for _ in 0..2 {
            assert_eq!(cplp.traverse(&scene, eye, NO_GUESS, &mut probe(near), &mut scratch), done);
            assert_eq!(scratch.fronts().len(), done.rounds + 1);
            assert_eq!(scratch.fronts().map(<[CellId]>::len).sum::<usize>(), done.queries);
            let mut asked: Vec<CellId> = scratch.fronts().flatten().copied().collect();
            // What is projected was asked about first, or is where the eye is.
            asked.push(cplp.tessellation().cell_at(eye.centre).unwrap());
            assert!(scratch.projected().iter().all(|cell| asked.contains(cell)));
        }
    }

    #[test]
    fn a_ball_of_eyes_seeds_all_cells_in_reach() {
        let scene = field(20);
        let cplp = cplp(&scene);
        let mut scratch = CplpScratch::default();
        let eye = EyeRegion { centre: DVec3::new(10.0, 0.1, 10.0), radius: 3.0 };
        cplp.traverse(&scene, eye, NO_GUESS, &mut probe(|_| false), &mut scratch);
        for (id, triangle) in (0..).zip(scene.triangles()) {
            if triangle.aabb().distance(eye.centre) < 3.0 {
                assert!(scratch.visible().contains(&id));
            }
        }
    }
}
