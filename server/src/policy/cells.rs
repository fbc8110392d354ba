//! Cubes that fill a world's box, and sets of them: what a table of potential visibility is about.
//!
//! Cubes, not storeys in plan: maps have floors at any height, stairs and galleries, and nothing here needs to know where a
//! floor is. The corners lie at multiples of the cell from the model's own origin, so that a maker who sets walls on such
//! lines gets cells that no wall cuts.

use std::ops::RangeInclusive;

use glam::{DVec3, UVec3};

use super::check;
use super::radius::SETTING_METRES;
use super::table::PvsError;

/// Equal cubes in rows: x first, then z, then y.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CellGrid {
    /// Least corner relative to the world's anchor, metres; finite.
    origin: DVec3,
    /// Side of a cube, metres; finite and above 0.
    cell: f64,
    /// Cubes along each axis, at least 1 each and [`CellGrid::CELLS_MAX`] in all.
    size: UVec3,
}

impl CellGrid {
    /// Most cells of a grid: to bake a table of so many takes half a gigabyte, of four times as many eight.
    pub const CELLS_MAX: u64 = 1 << 16;

    /// Cubes of `cell` metres that fill the box from `min` to `max` (relative to `anchor`) at least.
    ///
    /// # Errors
    /// If the cell is not a length, or there would be too many.
    pub fn covering(min: DVec3, max: DVec3, anchor: DVec3, cell: f64) -> Result<CellGrid, PvsError> {
        check("cell", cell, SETTING_METRES).map_err(|_| PvsError::Cell { cell })?;
        let first = ((min + anchor) / cell).floor();
        // A face on a corner's line is inside on both sides.
        let size = ((max + anchor) / cell).floor() - first + 1.0;
        CellGrid::from_parts(first * cell - anchor, cell, size)
    }

    /// A grid of what a file says.
    pub(super) fn from_parts(origin: DVec3, cell: f64, size: DVec3) -> Result<CellGrid, PvsError> {
        let cells = size.x * size.y * size.z;
        if !origin.is_finite() || !SETTING_METRES.contains(&cell) {
            return Err(PvsError::Cell { cell });
        }
        if !(size.cmpge(DVec3::ONE).all() && cells <= CellGrid::CELLS_MAX as f64) {
            return Err(PvsError::TooManyCells { cells, cell });
        }
        Ok(CellGrid { origin, cell, size: size.as_uvec3() })
    }

    /// Least corner relative to the world's anchor, metres.
    pub fn origin(&self) -> DVec3 {
        self.origin
    }

    /// Side of a cube, metres.
    pub fn cell(&self) -> f64 {
        self.cell
    }

    /// Cubes along each axis.
    pub fn size(&self) -> UVec3 {
        self.size
    }

    /// Number of cells.
    pub fn cells(&self) -> u32 {
        self.size.x * self.size.y * self.size.z
    }

    /// The number of the cell at these coordinates, each below [`CellGrid::size`].
    pub fn index(&self, at: UVec3) -> u32 {
        (at.y * self.size.z + at.z) * self.size.x + at.x
    }

    /// The coordinates of a cell.
    pub fn coordinates(&self, cell: u32) -> UVec3 {
        let UVec3 { x, z, .. } = self.size;
        UVec3::new(cell % x, cell / x / z, cell / x % z)
    }

    /// The least and greatest corner of the cells from `low` to `high`, both included; metres relative to the anchor.
    pub fn corners(&self, low: UVec3, high: UVec3) -> (DVec3, DVec3) {
        (self.origin + low.as_dvec3() * self.cell, self.origin + (high + UVec3::ONE).as_dvec3() * self.cell)
    }

    /// The cell that a point is in; `None` if it is in none.
    pub fn at(&self, point: DVec3) -> Option<u32> {
        let at = ((point - self.origin) / self.cell).floor();
        let is_in = at.cmpge(DVec3::ZERO).all() && at.cmplt(self.size.as_dvec3()).all();
        is_in.then(|| self.index(at.as_uvec3()))
    }

    /// The numbers of the cells that a box touches; `None` if it sticks out of the grid.
    pub fn touched(&self, min: DVec3, max: DVec3) -> Option<impl Iterator<Item = u32> + '_> {
        let low = self.coordinates(self.at(min)?);
        let high = self.coordinates(self.at(max)?);
        let span = |low: u32, high: u32| -> RangeInclusive<u32> { low..=high };
        Some(span(low.y, high.y).flat_map(move |y| {
            span(low.z, high.z).flat_map(move |z| span(low.x, high.x).map(move |x| self.index(UVec3::new(x, y, z))))
        }))
    }
}

/// A set of cells by their numbers.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct CellSet {
    words: Vec<u64>,
}

impl CellSet {
    /// An empty set of cells below `cells`.
    pub fn new(cells: u32) -> CellSet {
        CellSet { words: vec![0; (cells as usize).div_ceil(64)] }
    }

    /// Adds a cell.
    pub fn insert(&mut self, cell: u32) {
        self.words[cell as usize / 64] |= 1 << (cell % 64);
    }

    /// Whether a cell is in it.
    pub fn contains(&self, cell: u32) -> bool {
        self.words.get(cell as usize / 64).is_some_and(|word| word >> (cell % 64) & 1 == 1)
    }

    /// Adds every cell of another set for the same grid.
    pub fn union(&mut self, other: &CellSet) {
        for (word, other) in self.words.iter_mut().zip(&other.words) {
            *word |= other;
        }
    }

    /// Number of cells.
    pub fn len(&self) -> u32 {
        self.words.iter().map(|word| word.count_ones()).sum()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Runs of consecutive cells, ascending: first and number.
    pub fn runs(&self) -> Vec<(u32, u32)> {
        let mut runs: Vec<(u32, u32)> = Vec::new();
        for cell in 0..self.words.len() as u32 * 64 {
            if !self.contains(cell) {
                continue;
            }
            match runs.last_mut() {
                Some((first, count)) if *first + *count == cell => *count += 1,
                _ => runs.push((cell, 1)),
            }
        }
        runs
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_lie_at_multiples_from_the_models_origin() {
        let anchor = DVec3::new(100.5, 0.0, -7.0);
        let grid = CellGrid::covering(DVec3::new(-0.1, 0.0, -0.1), DVec3::new(6.1, 3.5, 0.1), anchor, 3.0).unwrap();
        let corner = (grid.origin() + anchor) / 3.0;
        assert_eq!(corner, corner.round());
        let (low, high) = grid.corners(UVec3::ZERO, grid.size() - 1);
        assert!(low.cmple(DVec3::new(-0.1, 0.0, -0.1)).all() && high.cmpgt(DVec3::new(6.1, 3.5, 0.1)).all());
        assert!(high.cmple(low + DVec3::new(12.0, 6.0, 6.0)).all(), "no more than needed: {low} {high}");
    }

    #[test]
    fn numbers_and_coordinates_are_inverse_and_points_are_in_their_cell() {
        let grid = CellGrid::covering(DVec3::ZERO, DVec3::new(7.9, 3.9, 5.9), DVec3::ZERO, 2.0).unwrap();
        assert_eq!((grid.size(), grid.cells()), (UVec3::new(4, 2, 3), 24));
        for cell in 0..24 {
            let at = grid.coordinates(cell);
            assert_eq!(grid.index(at), cell);
            let (low, high) = grid.corners(at, at);
            assert_eq!(grid.at((low + high) * 0.5), Some(cell));
            assert_eq!(grid.at(low), Some(cell), "the least corner is its own");
        }
        for outside in [DVec3::splat(-0.001), DVec3::new(8.0, 1.0, 1.0), DVec3::new(1.0, 4.0, 1.0), DVec3::NAN] {
            assert_eq!(grid.at(outside), None);
        }
    }

    #[test]
    fn a_box_touches_every_cell_it_has_a_point_in() {
        let grid = CellGrid::covering(DVec3::ZERO, DVec3::splat(5.9), DVec3::ZERO, 2.0).unwrap();
        let touched =
            |min: [f64; 3], max: [f64; 3]| grid.touched(min.into(), max.into()).map(|cells| cells.collect::<Vec<_>>());
        assert_eq!(touched([0.5; 3], [1.5; 3]).unwrap(), [0]);
        assert_eq!(touched([1.5, 0.5, 0.5], [2.5, 1.0, 1.0]).unwrap(), [0, 1]);
        // A face on the line between cells touches both.
        assert_eq!(touched([1.5; 3], [2.0; 3]).unwrap(), [0, 1, 3, 4, 9, 10, 12, 13]);
        assert_eq!(touched([-0.1, 1.0, 1.0], [0.1, 1.0, 1.0]), None);
        assert_eq!(touched([5.5; 3], [6.5; 3]), None);
    }

    #[test]
    fn sets_give_their_runs() {
        let mut set = CellSet::new(130);
        assert!(set.is_empty() && set.runs().is_empty());
        let mut other = CellSet::new(130);
        [0, 63, 64].into_iter().for_each(|cell| set.insert(cell));
        [65, 129].into_iter().for_each(|cell| other.insert(cell));
        set.union(&other);
        assert_eq!(set.runs(), [(0, 1), (63, 3), (129, 1)]);
        assert_eq!(set.len(), 5);
        assert!(set.contains(65) && !set.contains(66) && !set.contains(1000));
    }

    #[test]
    fn no_cells_and_too_many_are_refused() {
        let covering = |cell| CellGrid::covering(DVec3::ZERO, DVec3::splat(100.0), DVec3::ZERO, cell);
        for cell in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(matches!(covering(cell), Err(PvsError::Cell { .. })));
        }
        assert!(matches!(covering(0.05), Err(PvsError::TooManyCells { .. })));
        assert!(covering(1e6).is_ok());
        // An empty scene's box is inside out.
        let empty = CellGrid::covering(DVec3::INFINITY, DVec3::NEG_INFINITY, DVec3::ZERO, 1.0);
        assert!(empty.is_err());
    }
}
