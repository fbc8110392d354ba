//! Would this box change the image? HP's occlusion test: one box, then its answer (Klosowski & Silva 2001, §3.1).

use super::{PlacedBox, QueryBackEnd, QueryCost, no_depth};
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
    let seen = image.rows().any(|(y, columns)| row_passes(depth, image, y, columns, &mut z_tests));
    answer(depth, z_tests, seen)
}

/// The same from the middle on: the pixel in the middle first, then its row, then the others.
///
/// Most of what is seen at all is seen in the middle (Staneker et al. 2003, §6.1, has corners for the same purpose). To look there by
/// itself before the whole box would cost a row more of each box that is hidden; what is looked at in another order costs nothing.
pub(crate) fn test_ahead(depth: &DepthBuffer, image: &BoxImage) -> (bool, QueryCost) {
    let middle = image.y[0].midpoint(image.y[1]);
    let mut z_tests = 0;
    let [first, last] = image.columns(middle);
    let seen_in_middle = first <= last && {
        let (y, columns) = (middle as usize, [first as usize, last as usize]);
        let (front, row) = (image.front(y, columns), depth.row(y));
        let at = columns[0].midpoint(columns[1]);
        z_tests = 1;
        front.passing(at - columns[0], &row[at..=at]) > 0 || {
            z_tests = columns[1] + 1 - columns[0];
            front.passing(0, &row[columns[0]..=columns[1]]) > 0
        }
    };
    let seen = seen_in_middle
        || image.rows().any(|(y, columns)| y as i32 != middle && row_passes(depth, image, y, columns, &mut z_tests));
    answer(depth, z_tests, seen)
}

#[inline]
fn row_passes(depth: &DepthBuffer, image: &BoxImage, y: usize, [first, last]: [usize; 2], z_tests: &mut usize) -> bool {
    *z_tests += last + 1 - first;
    image.front(y, [first, last]).passing(0, &depth.row(y)[first..=last]) > 0
}

fn answer(depth: &DepthBuffer, z_tests: usize, seen: bool) -> (bool, QueryCost) {
    depth.count_query(z_tests, seen);
    (seen, QueryCost { passes: 1, z_tests: z_tests as u64, read_back: 1 })
}

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
