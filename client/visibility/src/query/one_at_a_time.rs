//! Would this box change the image? HP's occlusion test: one box, then its answer (Klosowski & Silva 2001, §3.1).

use super::{PlacedBox, QueryBackEnd, QueryCost, no_depth};
use crate::occupancy_map::{CORNER_ROWS, few_pixels_pass};
use crate::raster_sampled::{BoxImage, BoxPlace};
use crate::{Aabb, DepthBuffer, View};

/// Tests one box after the other, so that each answer is there before the next box is asked, and what is seen can be drawn
/// first. A test ends with the first row of pixels in which the box passes.
#[derive(Clone, Debug)]
pub struct OneAtATimeQuery {
    depth: DepthBuffer,
}

impl OneAtATimeQuery {
    /// A back end without a view yet.
    pub fn new() -> OneAtATimeQuery {
        OneAtATimeQuery { depth: no_depth() }
    }
}

impl Default for OneAtATimeQuery {
    fn default() -> OneAtATimeQuery {
        OneAtATimeQuery::new()
    }
}

/// Whether a box may be seen past what was drawn, and what it cost to know.
pub(crate) fn test(depth: &DepthBuffer, aabb: &Aabb) -> (bool, QueryCost) {
    match depth.box_place(aabb) {
        BoxPlace::Outside => (false, QueryCost::default()),
        BoxPlace::Touching => (true, QueryCost::default()),
        BoxPlace::In(image) => test_image(depth, &image),
    }
}

/// The same for a box whose image is known: row by row from the top.
fn test_image(depth: &DepthBuffer, image: &BoxImage) -> (bool, QueryCost) {
    let mut z_tests = 0;
    let seen = image.rows().any(|(y, columns)| {
        let [first, last] = columns;
        z_tests += last + 1 - first;
        image.front(y, columns).passing(0, &depth.row(y)[first..=last]) > 0
    });
    depth.count_query(z_tests, seen);
    (seen, QueryCost { passes: 1, z_tests: z_tests as u64, read_back: 1 })
}

/// The same after a look at the pixel in the middle and those of the corners (Staneker et al. 2003, §6.1), where there are so many rows that
/// these are next to nothing beside them. Most of what is seen at all is seen there.
pub(crate) fn test_ahead(depth: &DepthBuffer, image: &BoxImage) -> (bool, QueryCost) {
    let before = depth.z_tests();
    if image.y[1] - image.y[0] >= AHEAD_ROWS && few_pixels_pass(depth, image, CORNER_ROWS) {
        return (true, QueryCost { passes: 1, z_tests: depth.z_tests() - before, read_back: 1 });
    }
    let (seen, cost) = test_image(depth, image);
    (seen, QueryCost { z_tests: depth.z_tests() - before, ..cost })
}

/// Boxes of fewer rows are as soon looked at from the top.
const AHEAD_ROWS: i32 = 8;

impl QueryBackEnd for OneAtATimeQuery {
    fn begin(&mut self, view: &View) {
        self.depth.begin(view);
    }

    fn query(&mut self, cells: &[Aabb], seen: &mut Vec<bool>) -> QueryCost {
        seen.clear();
        let mut total = QueryCost::default();
        for cell in cells {
            let (visible, cost) = test(&self.depth, cell);
            seen.push(visible);
            total += cost;
        }
        total
    }

    fn query_placed(&mut self, boxes: &[PlacedBox], _: bool, seen: &mut Vec<bool>) -> QueryCost {
        seen.clear();
        let mut total = QueryCost::default();
        for placed in boxes {
            let (visible, cost) = test_ahead(&self.depth, &placed.image);
            seen.push(visible);
            total += cost;
        }
        total
    }

    fn looks_ahead(&self) -> bool {
        true
    }

    fn batch(&self) -> usize {
        1
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
