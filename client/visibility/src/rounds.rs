//! How many times must a query be waited for? cPLP by rounds, as the paper runs it on graphics hardware.
//!
//! Klosowski & Silva 2001, §2.2: run PLP with a small budget; then, while the front is not empty, (a) find which cells of the
//! front are occluded and remove them, (b) project the others, whose neighbours are candidates only in the next round. Step
//! (a) is one [`QueryBackEnd::query_front`] per batch, so that its cost is that of the back end and not of the traversal.
//!
//! What [`Cplp::traverse`] says about completeness holds here: asking a whole front at once shows more, never less.

use crate::front_to_back::{nearest_corner, nearest_corner_first};
use crate::{
    Aabb, Budget, CellId, Cplp, CplpScratch, EyeRegion, QueryBackEnd, QueryCost, Resolution, Scene, Target, Traversal,
    View,
};

/// What a traversal by rounds did: the columns of the paper's Table 3, and what its Fig. 6 is about.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RoundsTraversal {
    /// Cells, rounds, queries and triangles, as for any traversal.
    pub traversal: Traversal,
    /// Cells that PLP projected.
    pub plp_cells: usize,
    /// What the queries cost, all rounds together.
    pub queries: QueryCost,
    /// Comparisons of depths, drawing and queries.
    pub z_tests: u64,
}

impl RoundsTraversal {
    /// Triangles drawn in addition to PLP's, because a query said so.
    pub fn extra_triangles(&self) -> usize {
        self.traversal.triangles_drawn - self.traversal.plp_triangles
    }

    /// PLP's share of the triangles drawn, 0 to 1; 1 if none was.
    pub fn plp_share(&self) -> f64 {
        match self.traversal.triangles_drawn {
            0 => 1.0,
            drawn => self.traversal.plp_triangles as f64 / drawn as f64,
        }
    }

    /// Depth complexity: comparisons of depths per pixel; 0 for an image without pixels.
    pub fn z_tests_per_pixel(&self, resolution: Resolution) -> f64 {
        match resolution.pixels() {
            0 => 0.0,
            pixels => self.z_tests as f64 / pixels as f64,
        }
    }
}

/// A front that was queried, before what is seen of it is projected: what the paper's Fig. 10 shows.
#[derive(Clone, Copy, Debug)]
pub struct Round<'a> {
    /// Counts from 1.
    pub number: usize,
    /// The cells asked about, least solid first. A back end that answers in batches is asked about a part of the front.
    pub cells: &'a [CellId],
    /// Whether each may be seen.
    pub seen: &'a [bool],
}

/// Draws into a back end.
struct Drawn<'a, B: ?Sized> {
    scene: &'a Scene,
    back_end: &'a mut B,
}

impl<B: QueryBackEnd + ?Sized> Target for Drawn<'_, B> {
    fn draw(&mut self, primitives: &[u32]) {
        self.back_end.draw(self.scene, primitives);
    }

    /// The cheap half of an answer: fronts are queried whole.
    fn sees(&self, aabb: &Aabb) -> bool {
        self.back_end.in_view(aabb)
    }

    fn in_view(&self, aabb: &Aabb) -> bool {
        self.back_end.in_view(aabb)
    }

    fn is_full(&self) -> bool {
        self.back_end.is_full()
    }
}

impl Cplp {
    /// Draws every cell of `scene` that may be seen from the view's eye into `back_end`, by rounds, and leaves the visible
    /// set in `scratch`.
    pub fn traverse_rounds<B: QueryBackEnd + ?Sized>(
        &self,
        scene: &Scene,
        view: &View,
        budget: Budget,
        back_end: &mut B,
        scratch: &mut CplpScratch,
    ) -> RoundsTraversal {
        self.watch_rounds(scene, view, budget, back_end, scratch, |_, _| ())
    }

    /// [`Cplp::traverse_rounds`] that shows each query's answers, and the back end with its finished tiles, to `watch`.
    pub fn watch_rounds<B: QueryBackEnd + ?Sized>(
        &self,
        scene: &Scene,
        view: &View,
        budget: Budget,
        back_end: &mut B,
        scratch: &mut CplpScratch,
        mut watch: impl FnMut(Round<'_>, &B),
    ) -> RoundsTraversal {
        back_end.begin_scene(view, &self.tessellation().root());
        let mut rounds = RoundsTraversal::default();
        let mut target = Drawn { scene, back_end: &mut *back_end };
        // Where cells are asked about one by one, what is seen of each is drawn before the next: there is nothing to foresee.
        let many = target.back_end.batch() > 1;
        rounds.traversal = self.run(scene, EyeRegion::point(view.eye), budget, &mut target, scratch, |run| {
            rounds.plp_cells = run.done.cells_projected;
            let (mut front, mut batch, mut boxes) = (Vec::new(), Vec::new(), Vec::new());
            let (mut batch_of, mut seen) = (Vec::new(), Vec::new());
            while !run.target.is_full() {
                run.take_front(&mut front);
                if front.is_empty() {
                    break;
                }
                run.done.rounds += 1;
                let front_len = front.len();
                if many && run.target.back_end.foresees() {
                    // What is certainly seen is drawn at once, so that it hides what has to be asked about.
                    nearest_corner_first(&mut front, |cell| nearest_corner(run.aabb(cell), view.eye));
                    front.retain(|&cell| {
                        match run.target.back_end.foresee(&run.aabb(cell).clone()) {
                            Some(true) => run.project(cell),
                            Some(false) => run.hide(cell),
                            None => return true,
                        }
                        false
                    });
                }
                boxes.clear();
                boxes.extend(front.iter().map(|&cell| *run.aabb(cell)));
                run.target.back_end.arrange(&boxes, &mut batch_of);
                batch.clear();
                batch.extend(batch_of.iter().copied().zip(front.iter().copied()));
                batch.sort_by_key(|&(number, _)| number);
                for together in batch.chunk_by(|a, b| a.0 == b.0) {
                    boxes.clear();
                    boxes.extend(together.iter().map(|&(_, cell)| *run.aabb(cell)));
                    front.clear();
                    front.extend(together.iter().map(|&(_, cell)| cell));
                    run.done.queries += front.len();
                    let whole_front = front.len() == front_len;
                    rounds.queries += run.target.back_end.query_left(&boxes, whole_front, &mut seen);
                    watch(Round { number: run.done.rounds, cells: &front, seen: &seen }, run.target.back_end);
                    for (&cell, &seen) in front.iter().zip(&seen) {
                        if seen {
                            run.project(cell);
                        } else {
                            run.hide(cell);
                        }
                    }
                }
            }
        });
        rounds.traversal.passes = rounds.queries.passes;
        rounds.traversal.read_back = rounds.queries.read_back;
        rounds.traversal.seen_z_tests = back_end.seen_z_tests();
        rounds.traversal.mapped = back_end.mapped();
        rounds.z_tests = back_end.z_tests();
        rounds
    }
}
