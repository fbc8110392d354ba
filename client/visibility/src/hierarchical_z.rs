//! Is a whole octree node behind a whole part of the image? The hierarchical Z-buffer (Greene, Kass & Miller 1993).
//!
//! The octree is walked front to back. A node's box is tested against a pyramid of farthest depths, from one value for the
//! whole image down; what is hidden is left with all that it contains, and leaves that are not hidden are drawn. It is
//! Sudarsky & Gotsman's 𝒜 too (1999, §4), whose dynamic half is [`crate::DynamicOctree`] here. Greene's first drawing of what
//! was visible in the frame before is left out: cullers know nothing of other frames.
//!
//! Who has PLP may let it choose what is drawn first ([`HierarchicalZ::with_plp`]; Klosowski & Silva 2000, §6). That saves no
//! question: front to back, all that can hide a node is drawn before the node is asked about. It is here to be measured against.
//!
//! When the walk is over, the pyramid answers for moving bounds too, and moving things may be drawn into it.

use std::cell::Cell;
use std::sync::Arc;

use crate::culler::everything;
use crate::occupancy_map::{PYRAMID_CORNER_ROWS, Worth, few_pixels_pass};
use crate::raster_sampled::{BoxImage, BoxPlace, TILE};
use crate::{
    Aabb, Bound, Culled, Culler, DepthBuffer, EyeRegion, Occlusion, Occupancy, OccupancyMap, Octree, OctreeRules, Plp,
    Scene, Scratch, Tessellation, Traversal, Triangle, View,
};

/// An octree against a Z-pyramid. An eye region that is not the view's eye gets everything.
#[derive(Clone, Debug)]
pub struct HierarchicalZ {
    scene: Arc<Scene>,
    octree: Arc<Octree>,
    /// Who chooses occluders, and how many triangles.
    plp: Option<(Arc<Plp>, usize)>,
    occupancy: Occupancy,
}

impl HierarchicalZ {
    /// Culls with cells that were made for this scene.
    pub fn new(scene: Arc<Scene>, octree: Arc<Octree>) -> HierarchicalZ {
        assert_eq!(scene.triangles().len(), octree.primitive_total(), "the octree is another scene's");
        HierarchicalZ { scene, octree, plp: None, occupancy: Occupancy::Off }
    }

    /// Makes the octree by default rules.
    pub fn build(scene: Arc<Scene>) -> HierarchicalZ {
        let octree = Arc::new(Octree::build(&scene, OctreeRules::default()));
        HierarchicalZ::new(scene, octree)
    }

    /// Lets PLP choose up to `budget` triangles that are drawn before the walk. They are reported as visible too.
    ///
    /// # Panics
    /// If it is over another scene.
    pub fn with_plp(self, plp: Arc<Plp>, budget: usize) -> HierarchicalZ {
        assert_eq!(self.scene.triangles().len(), plp.scene().triangles().len(), "PLP is over another scene");
        HierarchicalZ { plp: Some((plp, budget)), ..self }
    }

    /// How an occupancy map is asked before the pyramid. Nodes are asked one by one: batches are a single map here.
    pub fn with_occupancy(self, occupancy: Occupancy) -> HierarchicalZ {
        HierarchicalZ { occupancy, ..self }
    }
}

impl Culler for HierarchicalZ {
    fn cull(&self, view: &View, region: EyeRegion, scratch: &mut Scratch) -> Culled {
        let chosen = |(plp, budget): &(Arc<Plp>, usize)| plp.occluders(view, *budget, &mut scratch.plp);
        let first = self.plp.as_ref().map_or_else(Vec::new, chosen);
        let root = self.octree.root();
        let Some((image, leaves)) = scratch.begin_pyramid(view, region, self.occupancy, &root) else {
            return everything(&self.scene);
        };
        leaves.begin(&*self.octree);
        leaves.add(&first);
        image.draw(first.iter().map(|&id| &self.scene.triangles()[id as usize]));
        let mut traversal = Traversal { plp_triangles: first.len(), ..Traversal::default() };
        self.octree.front_to_back(view.eye, |aabb, leaf| {
            traversal.queries += 1;
            let seen = image.sees(aabb);
            if let (true, Some(cell)) = (seen, leaf) {
                traversal.cells_projected += 1;
                let primitives = leaves.project(&*self.octree, cell);
                image.draw(primitives.iter().map(|&id| &self.scene.triangles()[id as usize]));
            }
            seen
        });
        traversal.seen_z_tests = image.depth.seen_z_tests();
        traversal.mapped = image.map.as_ref().map_or([0; 2], OccupancyMap::asked);
        leaves.finish(traversal, image.depth.z_tests())
    }
}

/// A depth buffer and the pyramid over it.
///
/// As an [`Occlusion`] it speaks for the view it was made for and its pixel centres only, as a [`DepthBuffer`] does, and
/// hides no less: a box is asked about by its silhouette and the planes of its faces, other bounds by the box around them.
#[derive(Clone, Debug)]
pub(crate) struct PyramidImage {
    depth: DepthBuffer,
    pyramid: ZPyramid,
    /// Of where was drawn, unless nobody wants one.
    map: Option<OccupancyMap>,
}

impl PyramidImage {
    /// An empty image of a view.
    pub(crate) fn new(view: &View) -> PyramidImage {
        let mut image = PyramidImage { depth: DepthBuffer::new(view), pyramid: ZPyramid::default(), map: None };
        image.pyramid.begin(&image.depth);
        image
    }

    /// Forgets everything and starts an image of another view.
    pub(crate) fn begin(&mut self, view: &View, occupancy: Occupancy, scene: &Aabb) {
        self.depth.begin(view);
        self.pyramid.begin(&self.depth);
        self.map = (occupancy != Occupancy::Off).then(|| {
            let mut map = self.map.take().unwrap_or_default();
            map.set_worth(Worth::of_long_queries(occupancy));
            map.begin(&self.depth, scene);
            map
        });
    }

    /// Draws those of the triangles that occlude.
    pub(crate) fn draw<'a>(&mut self, triangles: impl IntoIterator<Item = &'a Triangle>) {
        match &mut self.map {
            Some(map) if !map.is_given_up() => self.depth.draw_triangles_marking(triangles, map),
            _ => self.depth.draw_triangles(triangles),
        }
        self.pyramid.mark_drawn(&mut self.depth);
    }

    fn sees(&self, aabb: &Aabb) -> bool {
        match self.depth.box_place(aabb) {
            BoxPlace::Outside => false,
            BoxPlace::Touching => true,
            BoxPlace::In(image) => {
                let foreseen = self.map.as_ref().filter(|map| !map.is_given_up()).is_some_and(|map| {
                    map.count(map.shows(&image) || few_pixels_pass(&self.depth, &image, PYRAMID_CORNER_ROWS))
                });
                foreseen || self.pyramid.sees_image(&self.depth, &image)
            }
        }
    }
}

impl Occlusion for PyramidImage {
    fn hides(&self, bound: &Bound) -> bool {
        bound.aabb().is_some_and(|aabb| !self.sees(&aabb))
    }
}

/// The farthest depths of ever larger squares of the image, down to the depth buffer's tiles. Below a tile's 64 pixels a
/// pyramid does not pay: they are eight vectors.
///
/// Values are lazy. Drawing only marks what may have become nearer; a value is found again when a query cannot do with the
/// old one, which is never too near.
#[derive(Clone, Debug, Default)]
pub(crate) struct ZPyramid {
    /// From 2 × 2 tiles up to one value for the whole image.
    levels: Vec<Level>,
}

#[derive(Clone, Debug)]
struct Level {
    columns: usize,
    rows: usize,
    farthest: Vec<Cell<f32>>,
    stale: Vec<Cell<bool>>,
}

impl ZPyramid {
    /// Starts over an empty depth buffer.
    pub(crate) fn begin(&mut self, depth: &DepthBuffer) {
        let [mut columns, mut rows] = depth.tiles();
        let mut level = 0;
        while columns > 1 || rows > 1 {
            [columns, rows] = [columns.div_ceil(2), rows.div_ceil(2)];
            if level == self.levels.len() {
                self.levels.push(Level { columns, rows, farthest: Vec::new(), stale: Vec::new() });
            }
            let Level { columns: c, rows: r, farthest, stale } = &mut self.levels[level];
            (*c, *r) = (columns, rows);
            farthest.clear();
            farthest.resize(columns * rows, Cell::new(0.0));
            stale.clear();
            stale.resize(columns * rows, Cell::new(false));
            level += 1;
        }
        self.levels.truncate(level);
    }

    /// Takes note of what was drawn into the depth buffer since the last call.
    pub(crate) fn mark_drawn(&mut self, depth: &mut DepthBuffer) {
        let Some(mut drawn) = depth.take_drawn_tiles() else { return };
        for level in &mut self.levels {
            drawn = drawn.map(|at| at / 2);
            let [left, right, top, bottom] = drawn;
            for row in top..=bottom {
                let stale = &level.stale[row * level.columns + left..=row * level.columns + right];
                stale.iter().for_each(|stale| stale.set(true));
            }
        }
    }

    /// Whether any of a box may be seen past what was drawn. Rounds outward.
    fn sees_image(&self, depth: &DepthBuffer, image: &BoxImage) -> bool {
        let before = depth.z_tests();
        let seen = self.sees_below(depth, image, self.levels.len(), 0, 0);
        depth.count_seen(before, seen);
        seen
    }

    /// The same for the box itself.
    #[cfg(test)]
    pub(crate) fn sees(&self, depth: &DepthBuffer, aabb: &Aabb) -> bool {
        match depth.box_place(aabb) {
            BoxPlace::Outside => false,
            BoxPlace::Touching => true,
            BoxPlace::In(image) => self.sees_image(depth, &image),
        }
    }

    /// Whether any of the box may be seen within a square: a tile at level 0, else one of `levels[level - 1]`.
    fn sees_below(&self, depth: &DepthBuffer, image: &BoxImage, level: usize, column: usize, row: usize) -> bool {
        // The part of the square that the box's rectangle covers, in pixels.
        let side = TILE << level;
        let within = |range: [i32; 2], at: usize| {
            let [first, last] = [(range[0] as usize).max(at * side), (range[1] as usize).min((at + 1) * side - 1)];
            (first <= last).then_some([first, last])
        };
        let (Some(x), Some(y)) = (within(image.x, column), within(image.y, row)) else { return false };
        let z = image.nearest_in(x, y);
        depth.count_z_tests(1);
        if level == 0 {
            return depth.tile_farthest(column, row) <= z && (y[0]..=y[1]).any(|y| sees_in_row(depth, image, x, y));
        }
        let at = row * self.levels[level - 1].columns + column;
        let Level { farthest, stale, .. } = &self.levels[level - 1];
        if farthest[at].get() > z || (stale[at].get() && self.refresh(depth, level, column, row) > z) {
            return false;
        }
        let [columns, rows] = self.size(depth, level - 1);
        (2 * row..(2 * row + 2).min(rows)).any(|row| {
            (2 * column..(2 * column + 2).min(columns))
                .any(|column| self.sees_below(depth, image, level - 1, column, row))
        })
    }

    /// Finds a value again.
    fn refresh(&self, depth: &DepthBuffer, level: usize, column: usize, row: usize) -> f32 {
        if level == 0 {
            return depth.tile_farthest(column, row);
        }
        let at = row * self.levels[level - 1].columns + column;
        let Level { farthest: known, stale, .. } = &self.levels[level - 1];
        if stale[at].replace(false) {
            let [columns, rows] = self.size(depth, level - 1);
            let mut farthest = f32::INFINITY;
            for row in 2 * row..(2 * row + 2).min(rows) {
                for column in 2 * column..(2 * column + 2).min(columns) {
                    farthest = farthest.min(self.refresh(depth, level - 1, column, row));
                }
            }
            known[at].set(farthest);
        }
        known[at].get()
    }

    /// Columns and rows of a level; of tiles at level 0.
    fn size(&self, depth: &DepthBuffer, level: usize) -> [usize; 2] {
        match level.checked_sub(1) {
            None => depth.tiles(),
            Some(level) => [self.levels[level].columns, self.levels[level].rows],
        }
    }
}

/// Whether any of the box may be seen in some columns of a row.
fn sees_in_row(depth: &DepthBuffer, image: &BoxImage, x: [usize; 2], row: usize) -> bool {
    let [first, last] = image.columns(row as i32);
    let (first, last) = (first.max(x[0] as i32), last.min(x[1] as i32));
    if first > last {
        return false;
    }
    let columns = [first as usize, last as usize];
    depth.count_z_tests(columns[1] + 1 - columns[0]);
    image.front(row, columns).passing(0, &depth.row(row)[columns[0]..=columns[1]]) > 0
}

#[cfg(test)]
mod tests {
    use glam::{DVec3, Vec3};
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64;

    use super::*;
    use crate::query::test;
    use crate::{ItemBuffer, Resolution, Sides};

    #[test]
    fn the_pyramid_says_what_all_pixels_say_whatever_was_drawn_in_between() {
        let mut rng = Pcg64::seed_from_u64(1);
        let (mut asked, mut seen, mut different, mut values, mut pixels) = (0, 0, 0, 0, 0);
        for resolution in [Resolution::new(1, 1), Resolution::new(9, 200), Resolution::new(150, 97)] {
            for _ in 0..4 {
                let view = View::level(DVec3::ZERO, 0.0, 1.5, resolution);
                let mut any = |reach: f32| Vec3::from_array(std::array::from_fn(|_| rng.random_range(-reach..reach)));
                let triangles = (0..80)
                    .map(|_| {
                        let at = any(4.0) - Vec3::Z * 6.0;
                        let corners = std::array::from_fn(|_| at + any(2.5));
                        Triangle { corners, sides: Sides::Both, occludes: true }
                    })
                    .collect();
                let boxes: Vec<Aabb> = (0..20)
                    .map(|_| {
                        let centre = any(8.0) - Vec3::Z * 12.0;
                        Aabb::around(centre.as_dvec3(), any(1.0).abs().as_dvec3())
                    })
                    .collect();
                let scene = Scene::from_triangles(triangles);
                let mut depth = DepthBuffer::new(&view);
                let mut pyramid = ZPyramid::default();
                pyramid.begin(&depth);
                for id in 0..80 {
                    depth.draw(&scene, &[id]);
                    pyramid.mark_drawn(&mut depth);
                    for aabb in &boxes {
                        let before = depth.z_tests();
                        let whole = pyramid.sees(&depth, aabb);
                        values += depth.z_tests() - before;
                        let (single, cost) = test(&depth, aabb);
                        pixels += cost.z_tests;
                        asked += 1;
                        seen += u32::from(whole);
                        different += u32::from(whole != single);
                    }
                }
            }
        }
        // Depths along a row are rounded from where it begins, which is another column in a tile: ties may differ.
        assert!(different * 1000 <= asked, "{different} of {asked}");
        assert!(seen * 10 > asked && seen * 10 < asked * 9, "{seen} of {asked}");
        assert!(values * 2 < pixels, "{values} for {pixels} pixels");
    }

    #[test]
    fn the_pyramid_hides_every_bound_that_the_depth_buffer_hides_and_none_with_a_pixel() {
        let mut rng = Pcg64::seed_from_u64(2);
        let (mut by_depth, mut by_pyramid, mut asked) = (0, 0, 0);
        for resolution in
            [Resolution::new(0, 0), Resolution::new(1, 1), Resolution::new(9, 200), Resolution::new(150, 97)]
        {
            let view = View::level(DVec3::new(0.1, 0.2, 0.3), 0.2, 1.5, resolution);
            let mut any = |reach: f32| Vec3::from_array(std::array::from_fn(|_| rng.random_range(-reach..reach)));
            let triangles: Vec<Triangle> = (0..60)
                .map(|i| {
                    let at = any(5.0) - Vec3::Z * 6.0;
                    Triangle {
                        corners: std::array::from_fn(|_| at + any(3.0)),
                        sides: Sides::Both,
                        occludes: i % 7 != 0,
                    }
                })
                .collect();
            let scene = Scene::from_triangles(triangles);
            let mut image = PyramidImage::new(&view);
            let mut picture = ItemBuffer::new(&view);
            for chunk in scene.triangles().chunks(6) {
                image.draw(chunk);
                chunk.iter().for_each(|triangle| picture.draw_triangle(1, triangle, DVec3::ZERO));
                for kind in 0..90 {
                    let (centre, half) = ((any(10.0) - Vec3::Z * 12.0).as_dvec3(), any(0.8).abs().as_dvec3());
                    let bound = match kind % 3 {
                        0 => Bound::Box(Aabb::around(centre, half)),
                        1 => Bound::Sphere { centre, radius: half.x },
                        _ => Bound::Upright { centre, radius: half.x, half_height: half.y },
                    };
                    let [depth, pyramid] = [image.depth.hides(&bound), image.hides(&bound)];
                    assert!(pyramid || !depth, "{bound:?} at {resolution:?}");
                    asked += 1;
                    by_depth += u32::from(depth);
                    by_pyramid += u32::from(pyramid);
                    if pyramid {
                        // A triangle within the bound, right at its front.
                        let reach = match bound {
                            Bound::Box(_) => half,
                            Bound::Sphere { radius, .. } => DVec3::splat(radius * 0.577),
                            _ => DVec3::new(half.x * 0.7, half.y, half.x * 0.7),
                        };
                        let mut with = picture.clone();
                        for corners in [[0, 1, 2], [5, 7, 6], [4, 5, 6], [4, 6, 0], [3, 5, 1]] {
                            let corners = corners.map(|i| Aabb::around(centre, reach).corners()[i]);
                            with.draw_corners(2, corners, Sides::Both);
                        }
                        assert!(!with.ids().contains(&2), "{bound:?} at {resolution:?}");
                    }
                }
            }
            assert!(!image.hides(&Bound::Everywhere));
            assert!(!image.hides(&Bound::Sphere { centre: DVec3::NAN, radius: 1.0 }) || resolution.pixels() == 0);
            assert!(!image.hides(&Bound::Sphere { centre: view.eye, radius: 0.1 }) || resolution.pixels() == 0);
        }
        // Silhouettes and slanted fronts hide more than rectangles and one depth.
        assert!(by_pyramid > by_depth + 20 && by_depth > 200 && by_pyramid < asked, "{by_depth} {by_pyramid} {asked}");
    }
}
