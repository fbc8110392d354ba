//! What do occlusion queries find without PLP? The baseline "HP" of Klosowski & Silva 2001, §4.

use std::sync::Arc;

use glam::DVec3;

use crate::culler::everything;
use crate::occupancy_map::{Batches, Occupancy, OccupancyMap, Worth};
use crate::query::{test, test_ahead};
use crate::raster_sampled::{BoxImage, BoxPlace, BoxRectangle, Marks};
use crate::{
    Aabb, CellId, Culled, Culler, DepthBuffer, EyeRegion, Octree, OctreeRules, Scene, Scratch, Tessellation, Traversal,
    View,
};

/// The cells in view, sorted by distance from the eye; each is queried, and drawn at once if it is seen.
///
/// It has no front, so it cannot tell when the image is finished, and asks about every cell in view. An eye region that is
/// not the view's eye gets everything.
#[derive(Clone, Debug)]
pub struct QueryFrontToBack {
    scene: Arc<Scene>,
    tessellation: Arc<dyn Tessellation>,
    occupancy: Occupancy,
}

impl QueryFrontToBack {
    /// Culls with cells that were made for this scene.
    pub fn new(scene: Arc<Scene>, tessellation: Arc<dyn Tessellation>) -> QueryFrontToBack {
        assert_eq!(scene.triangles().len(), tessellation.primitive_total(), "the tessellation is another scene's");
        QueryFrontToBack { scene, tessellation, occupancy: Occupancy::Off }
    }

    /// Makes the cells by default rules.
    pub fn build(scene: Arc<Scene>) -> QueryFrontToBack {
        let octree = Arc::new(Octree::build(&scene, OctreeRules::default()));
        QueryFrontToBack::new(scene, octree)
    }

    /// The same with occupancy maps. Batches are asked at the end, as in Staneker et al. 2003, §4.2, and
    /// whenever the last one has become large.
    pub fn with_occupancy(self, occupancy: Occupancy) -> QueryFrontToBack {
        QueryFrontToBack { occupancy, ..self }
    }
}

impl Culler for QueryFrontToBack {
    fn cull(&self, view: &View, region: EyeRegion, scratch: &mut Scratch) -> Culled {
        if !scratch.begin(view, region) {
            return everything(&self.scene);
        }
        let Scratch { depth, leaves, maps, .. } = scratch;
        leaves.begin(&*self.tessellation);
        let batched = self.occupancy == Occupancy::Batched;
        let mut order = std::mem::take(&mut leaves.order);
        maps.rectangles.clear();
        for cell in 0..self.tessellation.cell_count() as CellId {
            let aabb = self.tessellation.cell(cell);
            let rectangle = match depth.rectangle(aabb) {
                BoxPlace::Outside => continue,
                BoxPlace::Touching => None,
                BoxPlace::In(rectangle) => Some(rectangle),
            };
            let distance = if batched { nearest_corner(aabb, view.eye) } else { aabb.distance(view.eye) };
            let number = if self.occupancy == Occupancy::Off {
                cell
            } else {
                maps.rectangles.push((cell, rectangle));
                maps.rectangles.len() as u32 - 1
            };
            order.push((distance, number));
        }
        order.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        maps.map.set_worth(Worth::of_short_queries(self.occupancy));
        let mut walk = Walk { culler: self, depth, leaves, done: Traversal::default() };
        match self.occupancy {
            Occupancy::Off => walk.ask_all(&order),
            Occupancy::Single | Occupancy::Always => walk.ask_what_is_not_foreseen(&order, maps),
            Occupancy::Batched => walk.ask_in_batches(&order, maps),
        }
        let Walk { done, .. } = walk;
        leaves.order = order;
        let mapped = if self.occupancy == Occupancy::Off { [0; 2] } else { maps.map.asked() };
        let done = Traversal { seen_z_tests: depth.seen_z_tests(), mapped, ..done };
        leaves.finish(done, depth.z_tests())
    }
}

/// One frame under way.
struct Walk<'a> {
    culler: &'a QueryFrontToBack,
    depth: &'a mut DepthBuffer,
    leaves: &'a mut Leaves,
    done: Traversal,
}

impl Walk<'_> {
    fn ask_all(&mut self, order: &[(f64, u32)]) {
        for &(_, cell) in order {
            self.done.queries += 1;
            if test(self.depth, self.culler.tessellation.cell(cell)).0 {
                self.draw(cell, &mut ());
            }
        }
    }

    fn ask_what_is_not_foreseen(&mut self, order: &[(f64, u32)], Maps { map, rectangles, .. }: &mut Maps) {
        map.begin(self.depth, &self.culler.tessellation.root());
        self.ask_one_by_one(order, map, rectangles);
    }

    /// Asks about cells that are not waiting, and draws each at once if it is seen.
    fn ask_one_by_one(&mut self, order: &[(f64, u32)], map: &mut OccupancyMap, rectangles: &[Place]) {
        for &(_, number) in order {
            let (cell, rectangle) = rectangles[number as usize];
            let seen = rectangle.is_none_or(|rectangle| {
                let image = self.depth.box_image(self.culler.tessellation.cell(cell), rectangle);
                (!map.is_given_up() && map.count(map.shows(&image))) || {
                    self.done.queries += 1;
                    test_ahead(self.depth, &image).0
                }
            });
            if seen {
                self.draw_mapped(cell, map);
            }
        }
    }

    fn ask_in_batches(&mut self, order: &[(f64, u32)], Maps { map, batches, rectangles }: &mut Maps) {
        map.begin(self.depth, &self.culler.tessellation.root());
        batches.begin();
        let mut waiting: [Vec<(CellId, BoxImage)>; Batches::COUNT] = Default::default();
        for (at, &(_, number)) in order.iter().enumerate() {
            if map.is_given_up() {
                // There is no set-up cost here that batches would save.
                self.ask_waiting(&mut waiting, map);
                return self.ask_one_by_one(&order[at..], map, rectangles);
            }
            let (cell, rectangle) = rectangles[number as usize];
            let image = rectangle.map(|rectangle| self.depth.box_image(self.culler.tessellation.cell(cell), rectangle));
            match image {
                Some(image) if !map.count(map.shows(&image)) => {
                    waiting[batches.place(map.scale(), image.x, image.y)].push((cell, image));
                }
                _ => self.draw_mapped(cell, map),
            }
            if waiting[Batches::COUNT - 1].len() >= LAST_BATCH_MAX {
                self.ask_waiting(&mut waiting, map);
                batches.begin();
            }
        }
        self.ask_waiting(&mut waiting, map);
    }

    /// Asks batch after batch, and draws what each shows before the next.
    fn ask_waiting(&mut self, waiting: &mut [Vec<(CellId, BoxImage)>], map: &mut OccupancyMap) {
        for batch in waiting {
            self.done.queries += batch.len();
            self.done.passes += usize::from(!batch.is_empty());
            batch.retain(|(_, image)| test_ahead(self.depth, image).0);
            batch.drain(..).for_each(|(cell, _)| self.draw_mapped(cell, map));
        }
    }

    fn draw_mapped(&mut self, cell: CellId, map: &mut OccupancyMap) {
        if map.is_given_up() { self.draw(cell, &mut ()) } else { self.draw(cell, map) }
    }

    fn draw(&mut self, cell: CellId, marks: &mut impl Marks) {
        let QueryFrontToBack { scene, tessellation, .. } = self.culler;
        self.done.cells_projected += 1;
        self.depth.draw_marking(scene, self.leaves.project(&**tessellation, cell), marks);
    }
}

/// Boxes of the last batch lie behind others of it, and are asked without knowing these: the paper's models have 177 to 1,900
/// shapes, and a city here has 50,000 cells. So all batches are asked when the last one has grown to this.
const LAST_BATCH_MAX: usize = 16;

/// A map and its batches, kept from frame to frame.
#[derive(Clone, Debug, Default)]
pub(crate) struct Maps {
    pub(crate) map: OccupancyMap,
    batches: Batches,
    /// Cells in view with their rectangles, so that these are not found twice; none of what touches the near plane.
    rectangles: Vec<Place>,
}

/// A cell and its rectangle.
type Place = (CellId, Option<BoxRectangle>);

/// Distance from an eye to the nearest corner of a box, squared: the order of Staneker et al. 2003, §4.2.
pub(crate) fn nearest_corner(aabb: &Aabb, eye: DVec3) -> f64 {
    (aabb.min - eye).abs().min((aabb.max - eye).abs()).length_squared()
}

/// Sorts cells by a distance; what is equally far stays as it was.
pub(crate) fn nearest_corner_first(cells: &mut [CellId], distance: impl Fn(CellId) -> f64) {
    // Bits of floats that are not negative are in the order of their values.
    cells.sort_by_cached_key(|&cell| distance(cell).to_bits());
}

/// The visible set of a culler that draws cells one after the other.
#[derive(Clone, Debug, Default)]
pub(crate) struct Leaves {
    /// Distance from the eye, and cell or its place in a list.
    order: Vec<(f64, u32)>,
    /// Whether each primitive was drawn in this frame.
    drawn: Vec<bool>,
    visible: Vec<u32>,
}

impl Leaves {
    pub(crate) fn begin(&mut self, tessellation: &dyn Tessellation) {
        self.order.clear();
        for &id in &self.visible {
            self.drawn[id as usize] = false;
        }
        self.visible.clear();
        self.drawn.resize(tessellation.primitive_total(), false);
    }

    /// Counts primitives as drawn that were drawn before any cell.
    pub(crate) fn add(&mut self, primitives: &[u32]) {
        for &id in primitives {
            if !std::mem::replace(&mut self.drawn[id as usize], true) {
                self.visible.push(id);
            }
        }
    }

    /// The primitives of a cell that were not drawn yet.
    pub(crate) fn project(&mut self, tessellation: &dyn Tessellation, cell: CellId) -> &[u32] {
        let from = self.visible.len();
        self.add(tessellation.primitives(cell));
        &self.visible[from..]
    }

    /// What the culler reports. Leaves are asked about one by one: there are no rounds.
    pub(crate) fn finish(&self, traversal: Traversal, z_tests: u64) -> Culled {
        let mut visible = self.visible.clone();
        visible.sort_unstable();
        Culled { traversal: Traversal { triangles_drawn: visible.len(), ..traversal }, visible, z_tests }
    }
}
