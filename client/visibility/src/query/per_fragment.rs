//! How many fragments of each box pass? The per-fragment histogram that the paper proposed for hardware
//! (Klosowski & Silva 2001, §3.6).

use super::{PlacedBox, QueryBackEnd, QueryCost, no_depth};
use crate::raster_sampled::{BoxImage, BoxPlace};
use crate::{Aabb, DepthBuffer, View};

/// Draws all boxes with depth test and without depth write, and counts the fragments of each that pass. No box hides
/// another, so that one pass finds all that can be seen, and there is no image to clear, fill or scan.
#[derive(Clone, Debug)]
pub struct PerFragmentHistogram {
    depth: DepthBuffer,
    counts: Vec<u32>,
}

impl PerFragmentHistogram {
    /// A back end without a view yet.
    pub fn new() -> PerFragmentHistogram {
        PerFragmentHistogram { depth: no_depth(), counts: Vec::new() }
    }

    /// The histogram of the last query: per box, the number of fragments that passed, which bounds the number of pixels that
    /// show it or what it contains. [`u32::MAX`] for a box that touches the eye or the near plane.
    pub fn counts(&self) -> &[u32] {
        &self.counts
    }

    /// Fragments of a box that pass, of all that are added to `z_tests`.
    fn fragments(&self, image: &BoxImage, z_tests: &mut usize) -> u32 {
        let mut pixels = 0;
        let count: u32 = image
            .rows()
            .map(|(y, columns)| {
                let [first, last] = columns;
                pixels += last + 1 - first;
                image.front(y, columns).passing(0, &self.depth.row(y)[first..=last])
            })
            .sum();
        *z_tests += pixels;
        self.depth.count_query(pixels, count > 0);
        count
    }

    fn answer(&self, drawn: usize, z_tests: usize, seen: &mut Vec<bool>) -> QueryCost {
        seen.clear();
        seen.extend(self.counts.iter().map(|&count| count > 0));
        QueryCost { passes: usize::from(drawn > 0), z_tests: z_tests as u64, read_back: drawn as u64 }
    }
}

impl Default for PerFragmentHistogram {
    fn default() -> PerFragmentHistogram {
        PerFragmentHistogram::new()
    }
}

impl QueryBackEnd for PerFragmentHistogram {
    fn begin(&mut self, view: &View) {
        self.depth.begin(view);
    }

    fn query(&mut self, cells: &[Aabb], seen: &mut Vec<bool>) -> QueryCost {
        self.counts.clear();
        let (mut z_tests, mut drawn) = (0, 0);
        for cell in cells {
            let count = match self.depth.box_place(cell) {
                BoxPlace::Outside => 0,
                BoxPlace::Touching => u32::MAX,
                BoxPlace::In(image) => {
                    drawn += 1;
                    self.fragments(&image, &mut z_tests)
                }
            };
            self.counts.push(count);
        }
        self.answer(drawn, z_tests, seen)
    }

    fn query_placed(&mut self, boxes: &[PlacedBox], _: bool, seen: &mut Vec<bool>) -> QueryCost {
        self.counts.clear();
        let mut z_tests = 0;
        for placed in boxes {
            let count = self.fragments(&placed.image, &mut z_tests);
            self.counts.push(count);
        }
        self.answer(boxes.len(), z_tests, seen)
    }

    fn is_full(&self) -> bool {
        self.depth.has_no_pixels()
    }

    fn depth(&self) -> &DepthBuffer {
        &self.depth
    }

    fn depth_mut(&mut self) -> &mut DepthBuffer {
        &mut self.depth
    }
}
