//! `pvs`: a client is told of what is in a cell that may be seen from the cell of its eye, by a table that was made ahead, as
//! in RING (Funkhouser 1995).

use std::sync::Arc;

use eyeline_protocol::{Class, Extent, ObjectId};
use glam::DVec3;

use super::table::PvsTable;
use super::{Policy, Watcher};
use crate::world::{Object, present};

/// A client is told of every object whose extent touches a cell that the table has for the cell of its eye.
///
/// Nothing that the table does not know is withheld: an eye outside of its cells is told of everything, and an object that
/// sticks out of them is told to everyone.
pub struct Pvs {
    table: Arc<PvsTable>,
    extents: Vec<Extent>,
    shares: bool,
    /// A cell and an object that touches it, ascending.
    touching: Vec<(u32, ObjectId)>,
    /// Objects that stick out of the table's cells.
    outside: Vec<ObjectId>,
}

/// An object that touches more cells is told to everyone: to list them all would cost more than it saves.
const CELLS_TOUCHED_MAX: usize = 512;

impl Pvs {
    /// Tells by a table, which must be of the world that is served: see [`PvsTable::check_world`].
    pub fn new(table: Arc<PvsTable>) -> Pvs {
        Pvs { table, extents: Vec::new(), shares: true, touching: Vec::new(), outside: Vec::new() }
    }
}

impl Policy for Pvs {
    fn name(&self) -> &'static str {
        "pvs"
    }

    fn start(&mut self, classes: &[Class]) {
        self.extents = classes.iter().map(|class| class.extent).collect();
    }

    fn has_index(&self) -> bool {
        true
    }

    fn share(&mut self, shares: bool) {
        self.shares = shares;
    }

    fn memory_bytes(&self) -> usize {
        self.touching.capacity() * size_of::<(u32, ObjectId)>() + self.outside.capacity() * size_of::<ObjectId>()
    }

    fn begin_tick(&mut self, objects: &[Object]) {
        self.touching.clear();
        self.outside.clear();
        if !self.shares {
            return;
        }
        for (id, object) in present(objects) {
            let first = self.touching.len();
            if let Some(cells) = touched(&self.table, &self.extents, object) {
                self.touching.extend(cells.take(CELLS_TOUCHED_MAX + 1).map(|cell| (cell, id)));
            }
            if !(1..=CELLS_TOUCHED_MAX).contains(&(self.touching.len() - first)) {
                self.touching.truncate(first);
                self.outside.push(id);
            }
        }
        self.touching.sort_unstable();
    }

    fn interest(&mut self, objects: &[Object], watcher: &Watcher, told: &mut Vec<ObjectId>) {
        let Some(cell) = self.table.grid().at(watcher.eye) else {
            told.extend(present(objects).map(|(id, _)| id).filter(|&id| Some(id) != watcher.avatar));
            return;
        };
        if !self.shares {
            let is_told = |object: &Object| {
                let (mut cells, mut sees) = (0, false);
                let touched = touched(&self.table, &self.extents, object).into_iter().flatten();
                for other in touched.take(CELLS_TOUCHED_MAX + 1) {
                    cells += 1;
                    sees |= self.table.sees(cell, other);
                }
                sees || !(1..=CELLS_TOUCHED_MAX).contains(&cells)
            };
            let now = present(objects).filter(|(_, object)| is_told(object)).map(|(id, _)| id);
            told.extend(now.filter(|&id| Some(id) != watcher.avatar));
            return;
        }
        let mut now = self.outside.clone();
        for &(first, count) in self.table.row(cell) {
            let start = self.touching.partition_point(|&(cell, _)| cell < first);
            let of_run = self.touching[start..].iter().take_while(|&&(cell, _)| cell - first < count);
            now.extend(of_run.map(|&(_, id)| id));
        }
        now.sort_unstable();
        now.dedup();
        told.extend(now.into_iter().filter(|&id| Some(id) != watcher.avatar));
    }
}

/// The cells that an object touches; `None` if it sticks out of them.
fn touched<'a>(
    table: &'a PvsTable,
    extents: &[Extent],
    object: &Object,
) -> Option<impl Iterator<Item = u32> + use<'a>> {
    let Extent { radius, bottom, top } = extents[usize::from(object.class.0)];
    let place = object.position.metres();
    let (min, max) = (place + DVec3::new(-radius, bottom, -radius), place + DVec3::new(radius, top, radius));
    table.grid().touched(min, max)
}

#[cfg(test)]
mod tests {
    use super::super::made::{watcher, world};
    use super::super::table::tests::table;
    use super::*;

    /// What a client is told; posts have a radius of 0.5 m and are 1 m high. Cells are of 2 m, 4 along x, 3 along z, in two
    /// storeys: 0 to 11 below, 12 to 23 above.
    fn told(sees: impl Fn(u32) -> Vec<u32>, places: &[[f64; 3]], eye: [f64; 3]) -> Vec<u32> {
        let world = world(places);
        let mut policy = Pvs::new(Arc::new(table(sees)));
        policy.start(world.classes());
        // With the index and without it the same is told.
        let told = [true, false].map(|shares| {
            policy.share(shares);
            policy.begin_tick(world.objects());
            let mut told = Vec::new();
            policy.interest(world.objects(), &watcher(1, 0, eye.into()), &mut told);
            told
        });
        assert_eq!(told[0], told[1]);
        told[0].iter().map(|id| id.0).collect()
    }

    /// The watcher's own avatar and one post in the middle of each cell of the lower storey, but its own.
    const LOWER: [[f64; 3]; 12] = [
        [1.0, 0.1, 1.0],
        [3.0, 0.1, 1.0],
        [5.0, 0.1, 1.0],
        [7.0, 0.1, 1.0],
        [1.0, 0.1, 3.0],
        [3.0, 0.1, 3.0],
        [5.0, 0.1, 3.0],
        [7.0, 0.1, 3.0],
        [1.0, 0.1, 5.0],
        [3.0, 0.1, 5.0],
        [5.0, 0.1, 5.0],
        [7.0, 0.1, 5.0],
    ];

    #[test]
    fn what_is_in_a_cell_of_the_own_cells_set_is_told_and_no_more() {
        let eye = [1.0, 1.6, 1.0];
        assert_eq!(told(|cell| vec![cell, 1, 2, 9], &LOWER, eye), [1, 2, 9]);
        // A set that is not its own cell's counts for nothing.
        assert_eq!(told(|cell| if cell == 0 { vec![0] } else { vec![cell, 1, 2] }, &LOWER, eye), [0u32; 0]);
        // A cell that nothing is known of sees everything.
        assert_eq!(told(|_| Vec::new(), &LOWER, eye).len(), 11);
    }

    #[test]
    fn an_extent_that_touches_a_cell_is_told_and_once_only() {
        // Across the lines between cells 1 and 2; then between storeys, in cells 3 and 15.
        let places = [[1.0, 0.1, 1.0], [3.6, 0.1, 1.0], [3.4, 0.1, 1.0], [7.0, 1.5, 1.0]];
        let eye = [1.0, 1.6, 1.0];
        assert_eq!(told(|_| vec![2], &places, eye), [1]);
        assert_eq!(told(|_| vec![1, 2], &places, eye), [1, 2]);
        assert_eq!(told(|_| vec![15], &places, eye), [3]);
        assert_eq!(told(|_| vec![3], &places, eye), [3]);
    }

    #[test]
    fn storeys_are_apart() {
        let places = [[1.0, 0.1, 1.0], [1.0, 0.1, 3.0], [1.0, 2.1, 3.0]];
        // Cell 4 is below, 16 above it.
        let sees = |cell: u32| if cell < 12 { vec![4] } else { vec![16] };
        assert_eq!(told(sees, &places, [1.0, 1.6, 1.0]), [1]);
        assert_eq!(told(sees, &places, [1.0, 3.6, 1.0]), [2]);
    }

    #[test]
    fn what_the_table_does_not_know_is_told() {
        let places = [[1.0, 0.1, 1.0], [7.0, 0.1, 5.0], [7.8, 0.1, 5.0], [1.0, -0.5, 5.0], [900.0, 0.0, 0.0]];
        assert_eq!(told(|_| vec![0], &places, [1.0, 1.6, 1.0]), [2, 3, 4], "what sticks out");
        assert_eq!(told(|_| vec![0], &places, [-1.0, 1.6, 1.0]), [1, 2, 3, 4], "an eye outside");
    }
}
