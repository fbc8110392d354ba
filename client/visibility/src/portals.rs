//! What can be seen from a ball of eyes through the openings that a tessellation leaves between its cells?
//!
//! Where walls are sealed faces ([`crate::sealed`]) and cells are rooms, the faces that are left are doors, and most of what walls
//! hide is known without drawing anything: a few planes per door (Teller 1992; Coorg & Teller 1997, §2, for the planes). What stands in a
//! room hides nothing here. [`crate::RegionCuller`] asks this first, and an image where it leaves much.
//!
//! **A window** W is the part of a shared face through which a cell may be seen from the ball E. Let H = {x : n·x ≤ o} contain W, and
//! n·e ≥ o hold for all of E: a *separating* plane. If the segment from e to p meets W at r, then p = r + s·(r − e) with s ≥ 0,
//! so n·p = n·r + s·(n·r − n·e) ≤ o, and p is in H too. For each side of the rectangle W the plane through it and tangent to the ball is
//! such a plane, unless the ball touches it.
//!
//! **Nothing visible is missed.** Let e of E see p, in the root box. Moved by next to nothing, so that it meets no edge of a cell, the
//! segment runs through cells A₀ … Aₖ, each entered once, through faces that the segment itself touches in this order (they are
//! closed). None of them is sealed: a segment that meets a sealed face from its front is cut there, before p or at p, and then p is in the
//! closed cell before it. (A segment in the very plane of a seal has room on one side of it, where the moved one runs, or it is in
//! a gap of no width, which is not counted as seeing.) By induction it meets each face in that face's window: the next face, where the
//! segment meets it, is in all half-spaces of the window before. So p is in the *piece* of Aₖ that its last window shows.
//! Cells within reach of the ball are all piece.
//!
//! **Beyond the root box** nothing is seen unless a piece reaches its surface: before the segment leaves the box it is in a cell, and there
//! by the same argument in a piece.
//!
//! Windows that lead from one cell to one neighbour are kept as one, the least rectangle around them, which is right for any
//! superset. One that grows is looked through again; one that keeps growing becomes the whole face, so the walk ends.

// `!(a > b)` where NaN must count as "no".
#![allow(clippy::neg_cmp_op_on_partial_ord)]

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use glam::DVec3;

use crate::{Aabb, Bound, CellId, Cells, EyeRegion, Neighbour, SealedFace, Tessellation, View};

/// So many windows are looked through for a view; where there are more, cells are no rooms, and an image says more for its time.
pub(crate) const LOOKS_MAX: usize = 96;

/// A window that grew so often becomes the whole face.
const GROWTHS_MAX: u8 = 3;

/// Everything is moved outward by this part of the scene's coordinates. Far more than rounding takes.
const OUTWARD: f64 = 1e-9;

const NONE: u32 = u32::MAX;

/// Inside is where `normal·x` is at most `offset`, relative to the ball's centre.
#[derive(Clone, Copy, Debug)]
struct HalfSpace {
    normal: DVec3,
    offset: f64,
}

/// Half-spaces around what is seen through a window.
type Sides = [HalfSpace; 4];

/// No limit.
const ALL: HalfSpace = HalfSpace { normal: DVec3::ZERO, offset: 0.0 };

/// The part of a cell that one window shows.
#[derive(Clone, Copy, Debug)]
struct Piece {
    cell: CellId,
    /// The cell that one looks from; `NONE` where the ball is.
    from: CellId,
    /// The next piece of this cell, or `NONE`.
    next: u32,
    growths: u8,
    is_waiting: bool,
    /// Relative to the ball's centre.
    window: Aabb,
    sides: Sides,
    /// Box around the piece.
    around: Aabb,
}

/// What a ball of eyes sees through doors. Kept from frame to frame for its memory.
#[derive(Clone, Debug, Default)]
pub(crate) struct Portals {
    centre: DVec3,
    radius: f64,
    /// How far everything is moved outward, metres.
    slack: f64,
    /// The view's sides, moved outward for the eyes beside the middle one.
    view: [HalfSpace; 5],
    /// What the cells fill, once a walk came to its end.
    known: Option<Aabb>,
    /// Whether what lies beyond that may be seen.
    sees_out: bool,
    pieces: Vec<Piece>,
    waiting: BinaryHeap<Reverse<(u64, u32)>>,
    /// In which frame a cell was reached, and its first piece then.
    cells: Vec<(u32, u32)>,
    frame: u32,
    reached: Vec<CellId>,
    looks: usize,
}

impl Default for HalfSpace {
    fn default() -> HalfSpace {
        ALL
    }
}

impl HalfSpace {
    /// Cuts a box to the least one around its part inside. Returns whether there is any.
    fn cut(&self, aabb: &mut Aabb) -> bool {
        let HalfSpace { normal, offset } = *self;
        let nearest = DVec3::select(normal.cmpgt(DVec3::ZERO), aabb.min, aabb.max) * normal;
        let room = offset - nearest.element_sum();
        if room < 0.0 {
            return false;
        }
        for axis in 0..3 {
            let n = normal[axis];
            // As far as the other coordinates allow at most.
            if n > 0.0 {
                aabb.max[axis] = aabb.max[axis].min((room + nearest[axis]) / n);
            } else if n < 0.0 {
                aabb.min[axis] = aabb.min[axis].max((room + nearest[axis]) / n);
            }
        }
        true
    }

    fn misses(&self, aabb: &Aabb) -> bool {
        let nearest = DVec3::select(self.normal.cmpgt(DVec3::ZERO), aabb.min, aabb.max);
        self.normal.dot(nearest) > self.offset
    }
}

impl Portals {
    /// Nothing is known.
    pub fn forget(&mut self) {
        self.known = None;
    }

    /// Whether the last walk came to its end, so that what it did not reach is hidden.
    pub fn speak(&self) -> bool {
        self.known.is_some()
    }

    /// The cells that can be seen into.
    pub fn reached(&self) -> &[CellId] {
        &self.reached
    }

    /// Windows looked through by the last walk.
    pub fn looks(&self) -> usize {
        self.looks
    }

    /// Walks from a ball through what `believes` does not close, through `looks_max` windows at most; within the view, if there is
    /// one, whose eye is not looked at.
    pub fn walk(
        &mut self,
        tessellation: &dyn Tessellation,
        region: EyeRegion,
        view: Option<&View>,
        looks_max: usize,
        mut believes: impl FnMut(&SealedFace<'_>) -> bool,
    ) {
        let cells = tessellation.cells();
        self.begin(cells, region, view);
        if !cells.root().contains_box(&Aabb::around(self.centre, DVec3::splat(self.radius))) {
            return;
        }
        let mut seeds = std::mem::take(&mut self.reached);
        tessellation.cells_within(self.centre, self.radius, &mut |cell| seeds.push(cell));
        self.reached = seeds;
        for at in 0..self.reached.len() {
            let cell = self.reached[at];
            let around = self.relative(cells.aabb(cell));
            self.cells[cell as usize] = (self.frame, self.pieces.len() as u32);
            self.waiting.push(Reverse((0, self.pieces.len() as u32)));
            self.pieces.push(Piece {
                cell,
                from: NONE,
                next: NONE,
                growths: 0,
                is_waiting: true,
                window: around,
                sides: [ALL; 4],
                around,
            });
        }
        while let Some(Reverse((_, index))) = self.waiting.pop() {
            let piece = &mut self.pieces[index as usize];
            piece.is_waiting = false;
            let piece = *piece;
            if self.looks == looks_max {
                return;
            }
            self.looks += 1;
            for neighbour in cells.neighbours(piece.cell) {
                if neighbour.cell == piece.from || self.is_seed(neighbour.cell) {
                    continue;
                }
                let shared = self.relative(&cells.shared(piece.cell, neighbour));
                let Some(window) = self.through(&piece, neighbour, shared) else { continue };
                if cells.seal(piece.cell, neighbour).is_some_and(|seal| believes(&seal)) {
                    continue;
                }
                self.enter(piece.cell, neighbour, window, &shared, self.relative(cells.aabb(neighbour.cell)));
            }
        }
        let root = self.relative(&cells.root());
        let inner = root.inflated(-self.slack);
        let Portals { pieces, view, sees_out, .. } = self;
        *sees_out = false;
        // A piece that sees nothing in view is empty, and a box that is empty meets no other.
        for piece in pieces {
            if !piece.sides.iter().chain(view.iter()).all(|side| side.cut(&mut piece.around)) {
                piece.around = Aabb::EMPTY;
            }
            *sees_out |= !piece.around.is_empty() && !inner.contains_box(&piece.around);
        }
        self.known = Some(cells.root());
    }

    fn begin(&mut self, cells: &Cells, region: EyeRegion, view: Option<&View>) {
        self.known = None;
        self.looks = 0;
        self.pieces.clear();
        self.waiting.clear();
        self.reached.clear();
        self.frame = self.frame.wrapping_add(1);
        if self.frame == 0 {
            self.cells.clear();
            self.frame = 1;
        }
        self.cells.resize(cells.len(), (0, NONE));
        self.centre = region.centre;
        let root = cells.root();
        let reach = root.min.abs().max(root.max.abs()).element_sum() + self.centre.abs().element_sum();
        self.slack = OUTWARD * reach;
        self.radius = region.radius + self.slack;
        let Some(view) = view else {
            self.view = [ALL; 5];
            return;
        };
        let [right, up, forward] = view.axes();
        let x = (view.fov_x * 0.5).tan();
        let y = x * f64::from(view.resolution.height.max(1)) / f64::from(view.resolution.width.max(1));
        // An eye e looks no farther to the right than n·p = n·e.
        let side = |across: DVec3, tangent: f64| {
            let normal = (across - forward * tangent * (1.0 + OUTWARD)).normalize();
            HalfSpace { normal, offset: self.radius + self.slack }
        };
        self.view = [side(right, x), side(-right, x), side(up, y), side(-up, y), side(-forward, 0.0)];
    }

    fn relative(&self, aabb: &Aabb) -> Aabb {
        Aabb::new(aabb.min - self.centre, aabb.max - self.centre)
    }

    fn is_seed(&self, cell: CellId) -> bool {
        let (frame, first) = self.cells[cell as usize];
        frame == self.frame && self.pieces[first as usize].from == NONE
    }

    /// The part of a shared face that can be seen through a piece.
    fn through(&self, piece: &Piece, neighbour: &Neighbour, shared: Aabb) -> Option<Aabb> {
        let axis = neighbour.face.axis();
        let plane = if neighbour.face.is_positive() { shared.max[axis] } else { -shared.min[axis] };
        if plane < -self.radius - self.slack {
            return None;
        }
        let mut window = shared.inflated(self.slack);
        let cut = piece.sides.iter().chain(&self.view).all(|side| side.cut(&mut window));
        (cut && !window.is_empty()).then_some(window)
    }

    /// Looks into the cell behind a window, or again if it is larger than it was.
    fn enter(&mut self, from: CellId, neighbour: &Neighbour, window: Aabb, whole: &Aabb, around: Aabb) {
        let cell = neighbour.cell;
        let axis = neighbour.face.axis();
        let (frame, first) = self.cells[cell as usize];
        let first = if frame == self.frame { first } else { NONE };
        let mut at = first;
        while at != NONE && self.pieces[at as usize].from != from {
            at = self.pieces[at as usize].next;
        }
        if at == NONE {
            if first == NONE {
                self.reached.push(cell);
            }
            at = self.pieces.len() as u32;
            self.cells[cell as usize] = (self.frame, at);
            let sides = self.separate(&window, axis);
            let piece = Piece { cell, from, next: first, growths: 0, is_waiting: true, window, sides, around };
            self.pieces.push(piece);
        } else {
            let piece = &self.pieces[at as usize];
            if piece.window.contains_box(&window) {
                return;
            }
            let mut window = piece.window.union(&window);
            if piece.growths == GROWTHS_MAX {
                window = window.union(whole);
            }
            let sides = self.separate(&window, axis);
            let piece = &mut self.pieces[at as usize];
            piece.window = window;
            piece.sides = sides;
            piece.growths = piece.growths.saturating_add(1);
            if std::mem::replace(&mut piece.is_waiting, true) {
                return;
            }
        }
        // Nearest first, so that most windows into a cell are known before one looks through it. Squares of finite numbers sort as bits.
        let distance = DVec3::ZERO.clamp(window.min, window.max).length_squared();
        self.waiting.push(Reverse((distance.to_bits(), at)));
    }

    /// The planes through the sides of a window across an axis that separate it from the ball.
    fn separate(&self, window: &Aabb, axis: usize) -> Sides {
        let mut sides = [ALL; 4];
        for (i, side) in sides.iter_mut().enumerate() {
            let across = (axis + 1 + i / 2) % 3;
            let (at, other) = if i % 2 == 0 { (window.max, window.min) } else { (window.min, window.max) };
            // In the plane of the two axes the side is a point v, and n with n·v = −ρ is one of two. The window has some thickness
            // along the axis from rounding: its nearer end counts.
            let depth = if window.min[axis] > 0.0 { window.min[axis] } else { window.max[axis] };
            let (v, w) = ([depth, at[across]], [depth, other[across]]);
            let square = v[0] * v[0] + v[1] * v[1];
            let root = square - self.radius * self.radius;
            if !(root > 0.0) {
                continue;
            }
            let root = root.sqrt();
            for sign in [1.0, -1.0] {
                let n = [
                    (-self.radius * v[0] - sign * root * v[1]) / square,
                    (-self.radius * v[1] + sign * root * v[0]) / square,
                ];
                if n[0] * w[0] + n[1] * w[1] <= -self.radius {
                    let mut normal = DVec3::ZERO;
                    normal[axis] = n[0];
                    normal[across] = n[1];
                    *side = HalfSpace { normal, offset: -self.radius + 4.0 * self.slack };
                }
            }
        }
        sides
    }

    /// Whether no point of a box in a cell can be seen. The box is relative to the scene's anchor.
    pub fn hides_in_cell(&self, cell: CellId, aabb: &Aabb) -> bool {
        let (frame, mut at) = self.cells[cell as usize];
        if frame != self.frame {
            return true;
        }
        let relative = self.relative(aabb);
        while at != NONE {
            let piece = &self.pieces[at as usize];
            if self.shows(piece, &relative) {
                return false;
            }
            at = piece.next;
        }
        true
    }

    /// Whether no point of the bound can be seen.
    pub fn hides(&self, bound: &Bound) -> bool {
        let Some(root) = &self.known else { return false };
        let Some(aabb) = bound.outer_box() else { return false };
        if !(root.contains_box(&aabb) || !self.sees_out && aabb.min.cmple(aabb.max).all()) {
            return false;
        }
        let relative = self.relative(&aabb);
        !self.pieces.iter().any(|piece| self.shows(piece, &relative))
    }

    fn shows(&self, piece: &Piece, relative: &Aabb) -> bool {
        let slack = DVec3::splat(self.slack);
        let within = Aabb::new(relative.min.max(piece.around.min - slack), relative.max.min(piece.around.max + slack));
        !within.is_empty() && !piece.sides.iter().chain(&self.view).any(|side| side.misses(&within))
    }
}
