//! Which objects are near a place, in plan? Squares of one size over x and z, filled anew at each tick, so that a watcher
//! costs what is near it and not what there is.

use std::ops::RangeInclusive;

use eyeline_protocol::ObjectId;

use crate::world::{Object, present};

/// Present objects by the square that their reference point is in.
#[derive(Default)]
pub(super) struct Squares {
    side: f64,
    /// Ascending by square, then by id.
    entries: Vec<(i64, i64, ObjectId)>,
}

impl Squares {
    /// Sorts the present objects into squares of `side` metres.
    pub fn fill(&mut self, side: f64, objects: &[Object]) {
        self.side = side;
        self.entries.clear();
        self.entries.extend(present(objects).map(|(id, object)| {
            let place = object.position.metres();
            (square_of(place.x, side), square_of(place.z, side), id)
        }));
        self.entries.sort_unstable();
    }

    /// Empties it.
    pub fn clear(&mut self) {
        self.entries.clear();
    }

    /// Bytes that it takes.
    pub fn memory_bytes(&self) -> usize {
        self.entries.capacity() * size_of::<(i64, i64, ObjectId)>()
    }

    /// The objects in the squares that hold these x and z, metres. At most a few squares a side should be asked for: each
    /// row is a search of its own.
    pub fn within(&self, x: RangeInclusive<f64>, z: RangeInclusive<f64>) -> impl Iterator<Item = ObjectId> + '_ {
        let square = |metres: f64| square_of(metres, self.side);
        let (first, last) = (square(*z.start()), square(*z.end()));
        (square(*x.start())..=square(*x.end())).flat_map(move |row| {
            let start = self.entries.partition_point(|&(x, z, _)| (x, z) < (row, first));
            self.entries[start..].iter().take_while(move |&&(x, z, _)| x == row && z <= last).map(|&(_, _, id)| id)
        })
    }
}

/// The objects in the squares of `side` metres that hold these x and z, found by a look at each: what
/// [`Squares::within`] finds, in the order of ids.
pub(super) fn scan(
    side: f64,
    objects: &[Object],
    x: RangeInclusive<f64>,
    z: RangeInclusive<f64>,
) -> impl Iterator<Item = ObjectId> + '_ {
    let squares = |range: RangeInclusive<f64>| square_of(*range.start(), side)..=square_of(*range.end(), side);
    let (rows, columns) = (squares(x), squares(z));
    let is_near = move |object: &Object| {
        let place = object.position.metres();
        rows.contains(&square_of(place.x, side)) && columns.contains(&square_of(place.z, side))
    };
    present(objects).filter(move |(_, object)| is_near(object)).map(|(id, _)| id)
}

/// The square that a coordinate falls into: half-open, so that each place is in one.
pub(super) fn square_of(metres: f64, side: f64) -> i64 {
    // `as` saturates, and a place on the wire is within 2e6 m.
    (metres / side).floor() as i64
}
