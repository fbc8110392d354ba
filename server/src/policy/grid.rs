//! `grid`: a client is told of what is in its own square of the plan and the eight around it, as in Active Worlds and
//! NPSNET. Walls and heights do not count.

use eyeline_protocol::ObjectId;
use glam::DVec3;

use super::radius::SETTING_METRES;
use super::squares::{Squares, scan, square_of};
use super::{Policy, PolicyError, Watcher, check};
use crate::world::Object;

/// A client is told of every object whose reference point is in one of nine squares.
pub struct Grid {
    cell: f64,
    shares: bool,
    squares: Squares,
}

impl Grid {
    /// Squares of `cell` metres, whose corners lie at multiples of it from the world's anchor.
    ///
    /// # Errors
    /// If that is not a length.
    pub fn new(cell: f64) -> Result<Grid, PolicyError> {
        check("cell", cell, SETTING_METRES)?;
        Ok(Grid { cell, shares: true, squares: Squares::default() })
    }

    /// Whether an eye is told of what stands at `place` where squares are of `cell` metres.
    pub fn tells(cell: f64, eye: DVec3, place: DVec3) -> bool {
        let apart = |a: f64, b: f64| square_of(a, cell).saturating_sub(square_of(b, cell)).abs();
        apart(eye.x, place.x) <= 1 && apart(eye.z, place.z) <= 1
    }
}

impl Policy for Grid {
    fn name(&self) -> &'static str {
        "grid"
    }

    fn has_index(&self) -> bool {
        true
    }

    fn share(&mut self, shares: bool) {
        self.shares = shares;
    }

    fn memory_bytes(&self) -> usize {
        self.squares.memory_bytes()
    }

    fn begin_tick(&mut self, objects: &[Object]) {
        match self.shares {
            true => self.squares.fill(self.cell, objects),
            false => self.squares.clear(),
        }
    }

    fn interest(&mut self, objects: &[Object], watcher: &Watcher, told: &mut Vec<ObjectId>) {
        let first = told.len();
        // From the middle of the own square, so that rounding can't reach a fourth one.
        let span = |metres: f64| {
            let middle = (square_of(metres, self.cell) as f64 + 0.5) * self.cell;
            middle - self.cell..=middle + self.cell
        };
        let (x, z) = (span(watcher.eye.x), span(watcher.eye.z));
        match self.shares {
            true => told.extend(self.squares.within(x, z).filter(|&id| Some(id) != watcher.avatar)),
            false => told.extend(scan(self.cell, objects, x, z).filter(|&id| Some(id) != watcher.avatar)),
        }
        told[first..].sort_unstable();
    }
}

#[cfg(test)]
mod tests {
    use super::super::made::{watcher, world};
    use super::*;

    fn told(cell: f64, places: &[[f64; 3]], eye: DVec3) -> Vec<u32> {
        let mut policy = Grid::new(cell).unwrap();
        let world = world(places);
        // With the index and without it the same is told.
        let told = [true, false].map(|shares| {
            policy.share(shares);
            policy.begin_tick(world.objects());
            let mut told = Vec::new();
            policy.interest(world.objects(), &watcher(1, 0, eye), &mut told);
            told
        });
        assert_eq!(told[0], told[1]);
        told[0].iter().map(|id| id.0).collect()
    }

    #[test]
    fn the_own_square_and_its_eight_neighbours_are_told_at_any_height() {
        // A row of objects along x at −15, −5, 5, 15, 25; then along z; then a corner, and one high up.
        let places = [
            [5.0, 0.0, 5.0],
            [-15.0, 0.0, 5.0],
            [-5.0, 0.0, 5.0],
            [15.0, 0.0, 5.0],
            [25.0, 0.0, 5.0],
            [5.0, 0.0, -5.0],
            [5.0, 0.0, -15.0],
            [19.9, 0.0, 19.9],
            [20.0, 0.0, 19.9],
            [-0.1, 300.0, -9.9],
        ];
        assert_eq!(told(10.0, &places, DVec3::new(5.0, 1.6, 5.0)), [2, 3, 5, 7, 9]);
        // The same squares from anywhere within the own one.
        assert_eq!(told(10.0, &places, DVec3::new(0.0, 1.6, 9.9)), [2, 3, 5, 7, 9]);
        assert_eq!(told(10.0, &places, DVec3::new(-0.1, 1.6, 5.0)), [1, 2, 5, 9]);
    }

    #[test]
    fn the_policy_and_the_formula_agree() {
        use rand::{RngExt, SeedableRng};
        let mut chance = rand_pcg::Pcg64::seed_from_u64(6);
        for cell in [0.01, 0.3, 7.0, 1e7] {
            let places: Vec<[f64; 3]> =
                (0..100).map(|_| std::array::from_fn(|_| chance.random_range(-40.0..40.0))).collect();
            let eye = DVec3::from_array(places[0]);
            let snapped =
                |id: u32| eyeline_protocol::Position::from_metres(places[id as usize].into()).unwrap().metres();
            let expected: Vec<u32> = (1..100).filter(|&id| Grid::tells(cell, eye, snapped(id))).collect();
            assert_eq!(told(cell, &places, eye), expected, "{cell}");
        }
    }

    #[test]
    fn settings_that_are_no_lengths_are_refused() {
        for cell in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(Grid::new(cell).err().unwrap().to_string().contains("cell"));
        }
    }
}
