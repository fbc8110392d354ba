//! How often does each colour occur in the image? The OpenGL histogram technique (Klosowski & Silva 2001, §3.3).

use super::passes::{Colour, Passes, ReadBack};
use super::{PlacedBox, QueryBackEnd, QueryCost};
use crate::{Aabb, DepthBuffer, View};

/// Colours of a luminance image, one of them the background's.
const BINS: usize = 256;

/// Draws boxes in the colours 1 to 255 of an 8-bit image and counts how often each occurs; repeats without the boxes that
/// appeared until none does. A host would read back the 256 bins alone. A front of more boxes takes several batches.
#[derive(Clone, Debug)]
pub struct HistogramQuery {
    passes: Passes<u8>,
}

impl Colour for u8 {
    const BACKGROUND: u8 = 0;

    fn of_cell(index: usize) -> u8 {
        debug_assert!(index < BINS - 1);
        (index + 1) as u8
    }

    fn cell(self) -> usize {
        usize::from(self) - 1
    }
}

/// Counts colours. Four histograms, since counting one colour again and again waits for itself.
struct Bins([[u32; BINS]; 4]);

impl ReadBack<u8> for Bins {
    fn read<'a>(&mut self, rows: impl Iterator<Item = &'a [u8]>, mut found: impl FnMut(u8)) -> u64 {
        self.0 = [[0; BINS]; 4];
        for row in rows {
            for (i, &colour) in row.iter().enumerate() {
                self.0[i % 4][usize::from(colour)] += 1;
            }
        }
        for colour in 0..BINS {
            if self.0.iter().any(|bins| bins[colour] > 0) {
                found(colour as u8);
            }
        }
        BINS as u64
    }
}

impl HistogramQuery {
    /// One histogram of the whole image, boxes hiding each other by depth.
    pub fn new() -> HistogramQuery {
        HistogramQuery { passes: Passes::new() }
    }
}

impl Default for HistogramQuery {
    fn default() -> HistogramQuery {
        HistogramQuery::new()
    }
}

impl QueryBackEnd for HistogramQuery {
    fn begin(&mut self, view: &View) {
        self.passes.begin(view);
    }

    fn query(&mut self, cells: &[Aabb], seen: &mut Vec<bool>) -> QueryCost {
        seen.clear();
        seen.resize(cells.len(), false);
        let mut cost = QueryCost::default();
        let mut bins = Bins([[0; BINS]; 4]);
        for (cells, seen) in cells.chunks(self.batch()).zip(seen.chunks_mut(self.batch())) {
            cost += self.passes.query(cells, seen, &mut bins, false);
        }
        cost
    }

    fn query_placed(&mut self, boxes: &[PlacedBox], _: bool, seen: &mut Vec<bool>) -> QueryCost {
        seen.clear();
        seen.resize(boxes.len(), false);
        let mut cost = QueryCost::default();
        let mut bins = Bins([[0; BINS]; 4]);
        for (boxes, seen) in boxes.chunks(self.batch()).zip(seen.chunks_mut(self.batch())) {
            cost += self.passes.query_placed(boxes, seen, &mut bins, false);
        }
        cost
    }

    fn batch(&self) -> usize {
        BINS - 1
    }

    fn is_full(&self) -> bool {
        self.passes.is_full()
    }

    fn depth(&self) -> &DepthBuffer {
        &self.passes.depth
    }

    fn depth_mut(&mut self) -> &mut DepthBuffer {
        &mut self.passes.depth
    }
}
