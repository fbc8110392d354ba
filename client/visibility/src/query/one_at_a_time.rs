//! Would this box change the image? HP's occlusion test: one box, then its answer (Klosowski & Silva 2001, §3.1).

use super::{QueryBackEnd, QueryCost, no_depth};
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

/// The same for a box whose image is known.
pub(crate) fn test_image(depth: &DepthBuffer, image: &BoxImage) -> (bool, QueryCost) {
    let mut z_tests = 0;
    let seen = image.rows().any(|(y, columns)| {
        let [first, last] = columns;
        z_tests += last + 1 - first;
        image.front(y, columns).passing(0, &depth.row(y)[first..=last]) > 0
    });
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
