//! Occupancy maps in front of any query back end (Staneker et al. 2003, figure 6).

use super::{Batches, Occupancy, OccupancyMap, Worth, is_foreseen};
use crate::raster_sampled::BoxPlace;
use crate::{Aabb, DepthBuffer, PixelRect, PlacedBox, QueryBackEnd, QueryCost, Scene, View};

/// A back end that is asked only about boxes of which a map, and the pixels of their corners, know nothing.
///
/// What is drawn otherwise than through [`QueryBackEnd::draw`] is not in the map: boxes behind it count as seen.
#[derive(Clone, Debug)]
pub struct OccupancyQuery<B> {
    inner: B,
    map: OccupancyMap,
    /// Unless what is left is asked all at once.
    batches: Option<Box<Batches>>,
    /// Boxes of which nothing was foreseen, in that order, and once arranged by batch: to find a box in the image takes as long as to
    /// ask about a small one, and is done once. Those before `asked` were asked about.
    placed: Vec<PlacedBox>,
    asked: usize,
    spare: Vec<PlacedBox>,
    left_at: Vec<usize>,
    left_seen: Vec<bool>,
}

impl<B: QueryBackEnd> OccupancyQuery<B> {
    /// Puts maps before a back end. [`Occupancy::Off`] is as [`Occupancy::Single`].
    pub fn new(inner: B, occupancy: Occupancy) -> OccupancyQuery<B> {
        let batches = (occupancy == Occupancy::Batched).then(Box::default);
        let mut map = OccupancyMap::new();
        map.set_worth(match (inner.depth_is_drawn(), inner.looks_ahead()) {
            (false, _) => Worth::of_answers_waited_for(),
            (true, true) => Worth::of_short_queries(occupancy),
            (true, false) => Worth::of_long_queries(occupancy),
        });
        OccupancyQuery {
            inner,
            map,
            batches,
            placed: Vec::new(),
            asked: 0,
            spare: Vec::new(),
            left_at: Vec::new(),
            left_seen: Vec::new(),
        }
    }

    /// Forgets boxes that were foreseen nothing of.
    fn forget(&mut self) {
        self.placed.clear();
        self.asked = 0;
    }

    /// Puts what was placed into the order in which batches are asked, each as it was within itself.
    fn sort_placed(&mut self, batch_of: &[u32]) {
        if self.placed.len() != batch_of.len() || batch_of.is_sorted() {
            return;
        }
        self.spare.clear();
        for batch in 0..=batch_of.iter().copied().max().unwrap_or(0) {
            let of_batch = batch_of.iter().zip(&self.placed).filter(|(of, _)| **of == batch);
            self.spare.extend(of_batch.map(|(_, placed)| *placed));
        }
        std::mem::swap(&mut self.placed, &mut self.spare);
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
        self.forget();
    }

    fn draw(&mut self, scene: &Scene, primitives: &[u32]) {
        if self.map.is_given_up() {
            self.inner.draw(scene, primitives);
        } else {
            self.inner.draw_mapped(scene, primitives, &mut self.map);
        }
    }

    fn depth_is_drawn(&self) -> bool {
        self.inner.depth_is_drawn()
    }

    fn in_view(&self, aabb: &Aabb) -> bool {
        self.inner.in_view(aabb)
    }

    fn query(&mut self, cells: &[Aabb], seen: &mut Vec<bool>) -> QueryCost {
        if self.map.is_given_up() {
            return self.inner.query(cells, seen);
        }
        seen.clear();
        self.forget();
        self.left_at.clear();
        for (at, cell) in cells.iter().enumerate() {
            let foreseen = self.foresee(cell);
            seen.push(foreseen == Some(true));
            if foreseen.is_none() {
                self.left_at.push(at);
            }
        }
        if self.placed.is_empty() {
            return QueryCost::default();
        }
        let cost = self.inner.query_placed(&self.placed, false, &mut self.left_seen);
        self.left_at.iter().zip(&self.left_seen).for_each(|(&at, &answer)| seen[at] = answer);
        self.forget();
        cost
    }

    fn query_left(&mut self, cells: &[Aabb], whole_front: bool, seen: &mut Vec<bool>) -> QueryCost {
        let end = self.asked + cells.len();
        match self.placed.get(self.asked..end).filter(|placed| are_of(placed, cells)) {
            Some(placed) => {
                self.asked = end;
                self.inner.query_placed(placed, whole_front, seen)
            }
            // Nobody tried to foresee these.
            None if self.inner.batch() == 1 && self.foresees() => self.query(cells, seen),
            None => self.inner.query_left(cells, whole_front, seen),
        }
    }

    fn foresees(&self) -> bool {
        !self.map.is_given_up()
    }

    fn foresee(&mut self, cell: &Aabb) -> Option<bool> {
        if self.asked > 0 {
            // Another front begins.
            self.forget();
        }
        let depth = self.inner.depth();
        // It may be given up in the midst of a front: what was drawn since is not in it.
        if !self.map.is_given_up() && self.map.shows_middle(depth, cell) {
            return Some(self.map.count(true));
        }
        let image = match depth.box_place(cell) {
            BoxPlace::Outside => return Some(false),
            BoxPlace::Touching => return Some(true),
            BoxPlace::In(image) => image,
        };
        let few_pixels = self.inner.depth_is_drawn() && !self.inner.looks_ahead();
        if !self.map.is_given_up() && self.map.count(is_foreseen(&self.map, depth, few_pixels, &image)) {
            return Some(true);
        }
        self.placed.push(PlacedBox { aabb: *cell, image });
        None
    }

    fn arrange(&mut self, cells: &[Aabb], batch_of: &mut Vec<u32>) {
        self.asked = 0;
        if !are_of(&self.placed, cells) {
            self.placed.clear();
        }
        let Some(batches) = self.batches.as_mut().filter(|_| self.inner.batch() > 1) else {
            return self.inner.arrange(cells, batch_of);
        };
        batches.begin();
        batch_of.clear();
        let (depth, scale) = (self.inner.depth(), self.map.scale());
        let is_placed = !self.placed.is_empty();
        if is_placed {
            let place = |placed: &PlacedBox| batches.place(scale, placed.image.x, placed.image.y) as u32;
            batch_of.extend(self.placed.iter().map(place));
        } else {
            batch_of.extend(cells.iter().map(|cell| match depth.rectangle(cell) {
                BoxPlace::In(rectangle) => {
                    let [x, y] = [rectangle.x(), rectangle.y()].map(|range| range.map(|at| at as i32));
                    batches.place(scale, x, y) as u32
                }
                BoxPlace::Outside | BoxPlace::Touching => 0,
            }));
        }
        join_small(batch_of);
        if is_placed {
            self.sort_placed(batch_of);
        }
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

    fn mapped(&self) -> [usize; 2] {
        self.map.asked()
    }

    fn depth(&self) -> &DepthBuffer {
        self.inner.depth()
    }

    fn depth_mut(&mut self) -> &mut DepthBuffer {
        self.inner.depth_mut()
    }
}

/// Joins batches with the ones after them until each but the last has [`BATCH_LEAST`] boxes, and numbers them from 0.
pub(super) fn join_small(batch_of: &mut [u32]) {
    let mut boxes = [0; Batches::COUNT];
    batch_of.iter().for_each(|batch| boxes[*batch as usize] += 1);
    let (mut number, mut joined) = (0, 0);
    let numbers = boxes.map(|boxes| {
        if joined >= BATCH_LEAST {
            (number, joined) = (number + 1, 0);
        }
        joined += boxes;
        number
    });
    batch_of.iter_mut().for_each(|batch| *batch = numbers[*batch as usize]);
}

/// A batch is waited for, and takes an item buffer two images at least: fewer boxes are not worth it.
const BATCH_LEAST: usize = 64;

/// Whether these are the places of these boxes.
fn are_of(placed: &[PlacedBox], cells: &[Aabb]) -> bool {
    placed.len() == cells.len() && placed.iter().zip(cells).all(|(placed, cell)| placed.aabb == *cell)
}
