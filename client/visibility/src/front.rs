//! PLP's front, as both traversals hold it: cells by solidity, the earlier first where it ties.

use crate::CellId;

/// What a traversal knows of a cell.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct CellState {
    /// The frame that this is of.
    pub frame: u32,
    /// Number of the entry in the front that counts; [`DONE`] once the cell is dealt with.
    pub entered: u32,
    pub solidity: f32,
}

/// In place of an entry's number: projected, or found to be of no use.
pub(crate) const DONE: u32 = u32::MAX;

/// A cell in the front, ordered by solidity and then by when it came. It counts only while the cell's state has its number.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Entry {
    pub solidity: f32,
    pub entered: u32,
    pub cell: CellId,
}

impl Ord for Entry {
    fn cmp(&self, other: &Entry) -> std::cmp::Ordering {
        self.solidity.total_cmp(&other.solidity).then(self.entered.cmp(&other.entered))
    }
}

impl PartialOrd for Entry {
    fn partial_cmp(&self, other: &Entry) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Entry {
    fn eq(&self, other: &Entry) -> bool {
        self.cmp(other).is_eq()
    }
}

impl Eq for Entry {}

#[cfg(test)]
mod tests {
    use std::cmp::Reverse;
    use std::collections::BinaryHeap;

    use super::*;

    /// Klosowski & Silva 2000, §4.2: "a first-in first-out behavior when there are ties with respect to the solidity values".
    #[test]
    fn the_least_solid_comes_first_and_of_equals_the_first_that_came() {
        let mut front = BinaryHeap::new();
        let solidities = [2.0, 0.0, 1.0, 0.0, -0.0, 1.0, f32::INFINITY, 2.0, 0.5];
        for (cell, solidity) in (0..).zip(solidities) {
            // Numbers of cells run against the order of coming, so that it is not they that decide.
            front.push(Reverse(Entry { solidity, entered: cell, cell: 100 - cell }));
        }
        let order: Vec<u32> = std::iter::from_fn(|| front.pop()).map(|Reverse(entry)| 100 - entry.cell).collect();
        assert_eq!(order, [4, 1, 3, 8, 2, 5, 0, 7, 6]);
    }
}
