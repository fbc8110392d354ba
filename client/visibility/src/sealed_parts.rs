//! Which parts of a scene can never be seen from where an eye is, wherever it goes? Those that sealed faces close off.
//!
//! The cells of a tessellation, joined across every face that is not sealed ([`crate::sealed`]) in both directions,
//! fall into *parts*: rooms without doors, and the insides of what is solid. Let the eyes be in some closed cells, all
//! of whose parts make the set P. All that lies outside of the cells is one part with the cells at their hull.
//!
//! **Nothing in P sees out of P.** Let an eye in a cell of P see p. By the argument of [`crate::portals`] the segment,
//! moved by next to nothing, runs through a chain of cells none of whose faces is sealed in the direction in which it
//! is passed, so all of them are of one part, and p is in a closed cell of it, or outside, as the chain's end at the
//! hull is then. So a bound that touches no closed cell of P is hidden from *every* eye in P: however the eyes move,
//! nothing need be asked about it before they come to a cell of another part. It does not matter whether walls stop
//! whoever has the eyes; who walks through one is in another part then.
//!
//! A camera's near plane cuts walls open that are nearer than it. So the eyes' ball is taken larger by as much as
//! occluders must keep from the eye: a wall within it has what is behind it among the eyes' own cells.
//!
//! Cells touch closed boxes, and boxes and balls are grown by what rounding may take. A face that is sealed in one
//! direction only joins what it parts: that makes fewer parts, which is never wrong.

use std::sync::Arc;

use glam::DVec3;

use crate::under::OCCLUDER_NEAR;
use crate::{Aabb, Bound, CellId, EyeRegion, Face, Tessellation};

/// The parts of a scene that walls seal off from each other. Made once, never changed, shared by all who look.
#[derive(Clone, Debug)]
pub struct SealedParts {
    cells: Arc<dyn Tessellation>,
    /// Part of each cell: [`OUTSIDE`], and then by the order of their first cells.
    part_of: Vec<u32>,
    parts: u32,
}

/// The part of what lies outside of all cells.
const OUTSIDE: u32 = 0;

/// No part yet.
const NONE: u32 = u32::MAX;

/// Everything is moved outward by this part of the scene's coordinates, as in [`crate::portals`].
const OUTWARD: f64 = 1e-9;

impl SealedParts {
    /// The parts of a tessellation. A kD-tree cut at walls has most seals; where no face is sealed all is one part.
    pub fn new(cells: Arc<dyn Tessellation>) -> SealedParts {
        let count = cells.cell_count();
        let mut part_of = vec![NONE; count];
        let mut stack: Vec<CellId> = Face::ALL.iter().flat_map(|&face| cells.hull(face)).copied().collect();
        stack.iter().for_each(|&cell| part_of[cell as usize] = OUTSIDE);
        let mut parts = OUTSIDE;
        // Sealed both ways, or it is no wall for one of them.
        let is_closed = |from: CellId, to: CellId| {
            let way = |from, to| cells.neighbours(from).iter().find(move |way| way.cell == to);
            [way(from, to), way(to, from)].into_iter().all(|way| way.is_some_and(|way| way.is_sealed()))
        };
        for first in 0..count as CellId {
            while let Some(cell) = stack.pop() {
                for neighbour in cells.neighbours(cell) {
                    let known = &mut part_of[neighbour.cell as usize];
                    if *known == NONE && !(neighbour.is_sealed() && is_closed(cell, neighbour.cell)) {
                        *known = parts;
                        stack.push(neighbour.cell);
                    }
                }
            }
            if part_of[first as usize] == NONE {
                parts += 1;
                part_of[first as usize] = parts;
                stack.push(first);
            }
        }
        SealedParts { cells, part_of, parts: parts + 1 }
    }

    /// Number of parts, the outside included; 1 where nothing is sealed off from anything.
    pub fn count(&self) -> usize {
        self.parts as usize
    }

    /// Bytes that parts and cells take.
    pub fn memory_bytes(&self) -> usize {
        size_of_val(&*self.part_of) + self.cells.cells().memory_bytes()
    }

    fn slack(&self, at: DVec3) -> f64 {
        let root = self.cells.root();
        OUTWARD * (root.min.abs().max(root.max.abs()).element_sum() + at.abs().element_sum())
    }

    /// The parts that a ball of eyes is in, ascending; false if it is no ball. Walls nearer than `near` metres close
    /// nothing.
    fn find(&self, region: EyeRegion, near: f64, parts: &mut Vec<u32>) -> bool {
        parts.clear();
        let radius = region.radius + near;
        if !(region.centre.is_finite() && radius >= 0.0 && radius.is_finite()) {
            return false;
        }
        let radius = radius + self.slack(region.centre);
        if !self.cells.root().contains_box(&Aabb::around(region.centre, DVec3::splat(radius))) {
            parts.push(OUTSIDE);
        }
        self.cells.cells_within(region.centre, radius, &mut |cell| parts.push(self.part_of[cell as usize]));
        parts.sort_unstable();
        parts.dedup();
        true
    }

    /// Whether no cell that the bound touches is of one of these parts (ascending).
    fn misses(&self, bound: &Bound, parts: &[u32]) -> bool {
        let Some(aabb) = bound.outer_box() else { return false };
        let aabb = aabb.inflated(self.slack(aabb.centre()));
        let mut misses = self.cells.root().contains_box(&aabb) || parts.binary_search(&OUTSIDE).is_err();
        // Cells around the box's ball are a superset, and most of it is no cell's business.
        self.cells.cells_within(aabb.centre(), aabb.size().length() * 0.5, &mut |cell| {
            misses &=
                !self.cells.cell(cell).intersects(&aabb) || parts.binary_search(&self.part_of[cell as usize]).is_err();
        });
        misses
    }
}

/// In which parts of a scene some eyes are: a worker's own.
#[derive(Clone, Debug)]
pub struct PartsInSight {
    sealed: Arc<SealedParts>,
    parts: Vec<u32>,
    is_known: bool,
    found: Vec<u32>,
}

impl PartsInSight {
    /// Nothing is known yet.
    pub fn new(sealed: Arc<SealedParts>) -> PartsInSight {
        PartsInSight { sealed, parts: Vec::new(), is_known: false, found: Vec::new() }
    }

    /// The eyes are here now, and their picture's near plane at `near` metres. While they are in no part that they were
    /// not in before, the parts stay as they were: who walks along a wall would else have other ones in every other
    /// frame.
    pub fn look(&mut self, region: EyeRegion, near: f64) {
        let is_known = self.sealed.find(region, OCCLUDER_NEAR * near, &mut self.found);
        let is_within = self.found.iter().all(|part| self.parts.binary_search(part).is_ok());
        if !(is_known && self.is_known && is_within) {
            std::mem::swap(&mut self.parts, &mut self.found);
        }
        self.is_known = is_known;
    }

    /// The parts that the eyes can see into at all, ascending; none if that is not known.
    pub fn parts(&self) -> Option<&[u32]> {
        self.is_known.then_some(&self.parts)
    }

    /// Whether walls seal a bound off from all of them.
    pub fn seal_off(&self, bound: &Bound) -> bool {
        self.is_known && self.sealed.misses(bound, &self.parts)
    }
}
