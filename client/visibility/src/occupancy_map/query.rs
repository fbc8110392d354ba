//! Occupancy maps in front of any query back end (Staneker et al. 2003, figure 6).

use super::{Batches, Occupancy, OccupancyMap, foresee};
use crate::raster_sampled::BoxPlace;
use crate::{Aabb, DepthBuffer, PixelRect, QueryBackEnd, QueryCost, Scene, View};

/// A back end that is asked only about boxes of which a map, and the pixels of their corners, know nothing.
///
/// What is drawn otherwise than through [`QueryBackEnd::draw`] is not in the map: boxes behind it count as seen.
#[derive(Clone, Debug)]
pub struct OccupancyQuery<B> {
    inner: B,
    map: OccupancyMap,
    /// Unless what is left is asked all at once.
    batches: Option<Box<Batches>>,
    left: Vec<Aabb>,
    left_at: Vec<usize>,
    left_seen: Vec<bool>,
}

impl<B: QueryBackEnd> OccupancyQuery<B> {
    /// Puts maps before a back end. [`Occupancy::Off`] is as [`Occupancy::Single`].
    pub fn new(inner: B, occupancy: Occupancy) -> OccupancyQuery<B> {
        let batches = (occupancy == Occupancy::Batched).then(Box::default);
        OccupancyQuery {
            inner,
            map: OccupancyMap::new(),
            batches,
            left: Vec::new(),
            left_at: Vec::new(),
            left_seen: Vec::new(),
        }
    }

    /// The back end behind the maps.
    pub fn inner(&self) -> &B {
        &self.inner
    }

    /// The same, to set it up or to ask what became of it.
    pub fn inner_mut(&mut self) -> &mut B {
        &mut self.inner
    }

    /// Where was drawn.
    pub fn map(&self) -> &OccupancyMap {
        &self.map
    }
}

impl<B: QueryBackEnd> QueryBackEnd for OccupancyQuery<B> {
    fn begin(&mut self, view: &View) {
        let everywhere = Aabb::around(view.eye, glam::DVec3::splat(1.0));
        self.begin_scene(view, &everywhere);
    }

    fn begin_scene(&mut self, view: &View, scene: &Aabb) {
        self.inner.begin_scene(view, scene);
        self.map.begin(self.inner.depth(), scene);
    }

    fn draw(&mut self, scene: &Scene, primitives: &[u32]) {
        self.inner.draw_mapped(scene, primitives, &mut self.map);
    }

    fn depth_is_drawn(&self) -> bool {
        self.inner.depth_is_drawn()
    }

    fn in_view(&self, aabb: &Aabb) -> bool {
        self.inner.in_view(aabb)
    }

    fn query(&mut self, cells: &[Aabb], seen: &mut Vec<bool>) -> QueryCost {
        seen.clear();
        self.left.clear();
        self.left_at.clear();
        for (at, cell) in cells.iter().enumerate() {
            let foreseen = self.foresee(cell);
            seen.push(foreseen == Some(true));
            if foreseen.is_none() {
                self.left.push(*cell);
                self.left_at.push(at);
            }
        }
        if self.left.is_empty() {
            return QueryCost::default();
        }
        let cost = self.inner.query(&self.left, &mut self.left_seen);
        self.left_at.iter().zip(&self.left_seen).for_each(|(&at, &answer)| seen[at] = answer);
        cost
    }

    fn query_left(&mut self, cells: &[Aabb], whole_front: bool, seen: &mut Vec<bool>) -> QueryCost {
        self.inner.query_left(cells, whole_front, seen)
    }

    fn foresees(&self) -> bool {
        true
    }

    fn foresee(&mut self, cell: &Aabb) -> Option<bool> {
        foresee(&self.map, self.inner.depth(), self.inner.depth_is_drawn(), cell)
    }

    fn arrange(&mut self, cells: &[Aabb], batch_of: &mut Vec<u32>) {
        let Some(batches) = self.batches.as_mut().filter(|_| self.inner.batch() > 1) else {
            return self.inner.arrange(cells, batch_of);
        };
        batches.begin();
        batch_of.clear();
        let depth = self.inner.depth();
        batch_of.extend(cells.iter().map(|cell| match depth.rectangle(cell) {
            BoxPlace::In(rectangle) => {
                let [x, y] = [rectangle.x, rectangle.y].map(|range| range.map(|at| at as i32));
                batches.place(self.map.scale(), x, y) as u32
            }
            BoxPlace::Outside | BoxPlace::Touching => 0,
        }));
    }

    fn batch(&self) -> usize {
        self.inner.batch()
    }

    fn is_full(&self) -> bool {
        self.inner.is_full()
    }

    fn finished_tiles(&self) -> Vec<PixelRect> {
        self.inner.finished_tiles()
    }

    fn depth(&self) -> &DepthBuffer {
        self.inner.depth()
    }

    fn depth_mut(&mut self) -> &mut DepthBuffer {
        self.inner.depth_mut()
    }
}
