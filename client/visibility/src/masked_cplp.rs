//! Which primitives can be seen? cPLP with the cheapest queries: each shared face of the front is asked about just before the
//! walk would go through it, in an image of coverage masks.
//!
//! It is cPLP (Klosowski & Silva 2001, §3) with three differences, since here a query costs less than a triangle:
//! - the **front holds faces**, not cells, and gives out the nearest first. A face is a smaller box than its cell, and only
//!   faces that look away from the eye are passed, since along a segment from the eye each coordinate runs one way. So a
//!   cell is not reached backwards, and a wall that lies in a face hides it (see [`Walk::pushed`]). **Sealed faces** (DESIGN.md §4,
//!   condition (f)) that the image believes are not asked about: that takes a few pixels along their borders;
//! - **not everything seen is drawn**: only facets that look large enough to hide something. What is seen is decided by
//!   queries alone, so leaving out an occluder is never wrong;
//! - what a seen cell holds is **asked about once more at the end**, object by object and cluster by cluster, when all
//!   occluders are there.
//!
//! Nothing of a frame is proportional to the scene: marks are numbers of frames, and only what is reached is touched.
//!
//! Why nothing visible is missed: take a pixel's winner, its point q and the segment from the eye to it. The cells on the
//! segment form a chain over shared faces (see [`crate::Cplp`]), each crossed in the direction away from the eye. The point where
//! it is crossed is no farther than q, and the image holds no more than a part of what hides things in the plain Z-buffer, at
//! depths that are never nearer; so the face is seen, and so are the box of q's cluster and that of its object.
//! Where the chain comes to a seal that is believed, q is within the skin of the seal (`raster_sampled/seal.rs`), so that the
//! cell before it lists q's cluster, and the rest of the chain is not needed. That argument is about the plain Z-buffer, in
//! which all triangles are drawn as they are; of this image it takes only depths, which are never nearer than there.

use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::sync::Arc;

use glam::DVec3;

use crate::facets::Facets;
use crate::pyramid::{Part, Pyramid};
use crate::{
    Aabb, CellClusters, CellId, Clusters, Coverage, Face, KdRules, KdTree, MaskedDepth, Scene, Sides, SimdLevel,
    Tessellation, Traversal, View,
};

/// cPLP over the cells of a tessellation by queries of faces. Never changes once made, so that workers can share it.
#[derive(Debug)]
pub struct MaskedCplp {
    scene: Arc<Scene>,
    tessellation: Arc<dyn Tessellation>,
    facets: Facets,
    /// `cell_facets[facet_starts[c]..facet_starts[c + 1]]` are the facets that touch cell c, the largest first.
    facet_starts: Vec<u32>,
    cell_facets: Vec<CellFacet>,
    clusters: Clusters,
    cell_clusters: CellClusters,
    occluder_px: f64,
}

/// A facet as a cell lists it.
#[derive(Clone, Copy, Debug)]
struct CellFacet {
    /// Area in square metres, rounded up: what most facets need not be looked up for.
    area: f32,
    facet: u32,
}

/// What one worker needs, kept from frame to frame. A mark counts if it is the present frame's.
#[derive(Clone, Debug)]
pub struct MaskedCplpScratch {
    image: MaskedDepth,
    frame: u32,
    cells: Vec<u32>,
    facets: Vec<u32>,
    clusters: Vec<u32>,
    /// Squared distance as bits, then the face: cell and place in its list of neighbours.
    front: BinaryHeap<Reverse<(u32, u32, u32)>>,
    candidates: Vec<u32>,
    seeds: Vec<CellId>,
    visible: VisibleSet,
}

/// Default of [`MaskedCplp::with_occluder_px`].
const OCCLUDER_PX: f64 = 64.0;

impl MaskedCplp {
    /// Cuts the scene at its walls and walks those cells.
    pub fn build(scene: Arc<Scene>) -> MaskedCplp {
        let tessellation = Arc::new(KdTree::build(&scene, KdRules::default()));
        MaskedCplp::new(scene, tessellation)
    }

    /// Walks these cells, which must be of this scene. Faces are asked about as rectangles: cells that are not boxes are left
    /// for a kD-tree's.
    pub fn new(scene: Arc<Scene>, tessellation: Arc<dyn Tessellation>) -> MaskedCplp {
        let tessellation: Arc<dyn Tessellation> = match tessellation.cells().are_boxes() {
            true => tessellation,
            false => Arc::new(KdTree::build(&scene, KdRules::default())),
        };
        assert_eq!(scene.triangles().len(), tessellation.primitive_total(), "the tessellation is another scene's");
        let facets = Facets::build(&scene);
        let (mut facet_starts, mut cell_facets) = (vec![0], Vec::new());
        let mut of_cell: Vec<u32> = Vec::new();
        for cell in 0..tessellation.cell_count() as CellId {
            of_cell.clear();
            of_cell.extend(tessellation.primitives(cell).iter().filter_map(|&primitive| facets.facet_of(primitive)));
            of_cell.sort_unstable();
            of_cell.dedup();
            let first = cell_facets.len();
            let listed = |&facet: &u32| CellFacet { area: (facets.facet(facet).area as f32).next_up(), facet };
            cell_facets.extend(of_cell.iter().map(listed));
            cell_facets[first..].sort_by(|a: &CellFacet, b| b.area.total_cmp(&a.area));
            facet_starts.push(cell_facets.len() as u32);
        }
        let clusters = Clusters::build(&scene, Clusters::TRIANGLES_MAX);
        let cell_clusters = CellClusters::build(&*tessellation, &clusters);
        MaskedCplp {
            scene,
            tessellation,
            facets,
            facet_starts,
            cell_facets,
            clusters,
            cell_clusters,
            occluder_px: OCCLUDER_PX,
        }
    }

    /// The same with another least size of occluders: facets that can look no larger than this many pixels of area are not
    /// drawn. 0 draws all. Changes the cost and what is found hidden, never what is found visible wrongly.
    pub fn with_occluder_px(self, occluder_px: f64) -> MaskedCplp {
        MaskedCplp { occluder_px: occluder_px.max(0.0), ..self }
    }

    /// The cells.
    pub fn tessellation(&self) -> &Arc<dyn Tessellation> {
        &self.tessellation
    }

    /// The clusters and objects that are asked about.
    pub fn clusters(&self) -> &Clusters {
        &self.clusters
    }

    /// The scene.
    pub fn scene(&self) -> &Arc<Scene> {
        &self.scene
    }

    /// Finds what can be seen in a view, and leaves it in `scratch`: everything for a view that [`View::check`] refuses.
    pub fn walk(&self, view: &View, scratch: &mut MaskedCplpScratch) -> Traversal {
        scratch.begin(self, view);
        if view.check().is_err() {
            scratch.visible.ids.extend(0..self.scene.triangles().len() as u32);
            return Traversal { triangles_drawn: scratch.visible.ids.len(), ..Traversal::default() };
        }
        let mut walk = Walk {
            of: self,
            cells: self.tessellation.cells(),
            eye: view.eye,
            focal2: view.focal_px() * view.focal_px(),
            pyramid: Pyramid::new(view),
            scratch,
            done: Traversal::default(),
        };
        walk.seed();
        walk.run();
        walk.finish();
        walk.done
    }
}

/// One frame under way.
struct Walk<'a> {
    of: &'a MaskedCplp,
    cells: &'a crate::Cells,
    eye: DVec3,
    focal2: f64,
    pyramid: Pyramid,
    scratch: &'a mut MaskedCplpScratch,
    done: Traversal,
}

impl Walk<'_> {
    /// Enters the cells that touch the eye; from outside, those whose hull face towards the eye is in view, nearest first.
    fn seed(&mut self) {
        let of = self.of;
        let root = self.cells.root();
        for (index, face) in (0..).zip(Face::ALL) {
            if face.height(&root, self.eye) > 0.0 {
                for &cell in self.cells.hull(face) {
                    self.push(&self.hull_rectangle(cell, face), cell, HULL | index);
                }
            }
        }
        let mut seeds = std::mem::take(&mut self.scratch.seeds);
        of.tessellation.cells_within(self.eye, self.cells.skin(), &mut |cell| seeds.push(cell));
        seeds.iter().for_each(|&cell| self.enter(cell));
        seeds.clear();
        self.scratch.seeds = seeds;
    }
}

/// How much of a cell's skin is used; the rest is for rounding.
const SKIN_SHARE: f64 = 0.5;

/// Added to a face's number where it is a face of the hull, entered from outside.
const HULL: u32 = 1 << 31;

impl Walk<'_> {
    /// Puts a face that leads into `cell` into the front.
    fn push(&mut self, rectangle: &Aabb, cell: CellId, way: u32) {
        let distance2 = self.eye.clamp(rectangle.min, rectangle.max).distance_squared(self.eye) as f32;
        // Bits of floats that are not negative are in the order of their values.
        self.scratch.front.push(Reverse((distance2.to_bits(), cell, way)));
    }

    /// Passes through the nearest face that can be seen until none is left.
    fn run(&mut self) {
        while let Some(Reverse((_, cell, way))) = self.scratch.front.pop() {
            let (to, rectangle) = if way & HULL != 0 {
                (cell, self.hull_rectangle(cell, Face::ALL[(way & !HULL) as usize]))
            } else {
                let neighbour = &self.cells.neighbours(cell)[way as usize];
                (neighbour.cell, self.cells.shared(cell, neighbour))
            };
            if self.scratch.cells[to as usize] == self.scratch.frame {
                continue;
            }
            if self.sees(&rectangle, way) {
                self.enter(to);
            }
        }
    }

    fn sees(&mut self, rectangle: &Aabb, way: u32) -> bool {
        let (asked, axis) = if way & HULL != 0 {
            (*rectangle, Face::ALL[(way & !HULL) as usize].axis())
        } else {
            let flat = rectangle.max - rectangle.min;
            (
                self.pushed(rectangle),
                if flat.x == 0.0 {
                    0
                } else if flat.y == 0.0 {
                    1
                } else {
                    2
                },
            )
        };
        match self.pyramid.part(&asked, axis) {
            Part::Outside => false,
            Part::Near => true,
            Part::In(corners, count) => {
                self.done.queries += 1;
                self.scratch.image.sees_polygon(&corners[..count])
            }
        }
    }

    /// A face as far behind itself as the skin of the cell before it allows: the same part of the image, but farther.
    ///
    /// So a wall in the face hides it. What a segment from the eye meets between the two is within the skin of the place
    /// where the segment passes the face, so the cell before it lists it.
    fn pushed(&self, rectangle: &Aabb) -> Aabb {
        let reach = (rectangle.min - self.eye).abs().max((rectangle.max - self.eye).abs()).length();
        let scale = 1.0 + self.cells.skin() * SKIN_SHARE / reach;
        Aabb::new(self.eye + (rectangle.min - self.eye) * scale, self.eye + (rectangle.max - self.eye) * scale)
    }

    /// The face of a hull cell that lies in a face of the root box.
    fn hull_rectangle(&self, cell: CellId, face: Face) -> Aabb {
        let mut rectangle = *self.cells.aabb(cell);
        let axis = face.axis();
        if face.is_positive() {
            rectangle.min[axis] = rectangle.max[axis];
        } else {
            rectangle.max[axis] = rectangle.min[axis];
        }
        rectangle
    }

    /// Draws what a seen cell holds that may hide much, remembers its clusters, and puts the faces that lead on into the front.
    fn enter(&mut self, cell: CellId) {
        let of = self.of;
        let scratch = &mut *self.scratch;
        if std::mem::replace(&mut scratch.cells[cell as usize], scratch.frame) == scratch.frame {
            return;
        }
        self.done.cells_projected += 1;
        let aabb = self.cells.aabb(cell);
        let facets = of.facet_starts[cell as usize] as usize..of.facet_starts[cell as usize + 1] as usize;
        // A facet's part in this cell is no nearer than the cell; its part in another cell is drawn from there.
        let distance2 = self.eye.clamp(aabb.min, aabb.max).distance_squared(self.eye);
        let area_min = (of.occluder_px * distance2 / self.focal2) as f32;
        for &CellFacet { area, facet: index } in &of.cell_facets[facets] {
            if area < area_min {
                break;
            }
            if std::mem::replace(&mut scratch.facets[index as usize], scratch.frame) == scratch.frame {
                continue;
            }
            let facet = of.facets.facet(index);
            let in_front = facet.normal.dot(self.eye) > facet.height;
            if in_front || facet.sides == Sides::Both {
                scratch.image.draw_polygon_f32(of.facets.corners(index), facet.sides);
                self.done.polygons_drawn += 1;
            }
        }
        for &cluster in of.cell_clusters.of(cell) {
            if std::mem::replace(&mut scratch.clusters[cluster as usize], scratch.frame) != scratch.frame {
                scratch.candidates.push(cluster);
            }
        }
        for (way, neighbour) in (0..).zip(self.cells.neighbours(cell)) {
            let leads_away = neighbour.face.height(aabb, self.eye) <= 0.0;
            if leads_away && self.scratch.cells[neighbour.cell as usize] != self.scratch.frame {
                // Asked now that the cell's own walls are drawn: what is believed need not be asked about later.
                if let Some(seal) = self.cells.seal(cell, neighbour) {
                    let believed = self.scratch.image.believes(&seal);
                    *if believed { &mut self.done.sealed } else { &mut self.done.doubted } += 1;
                    if believed {
                        continue;
                    }
                }
                let rectangle = self.cells.shared(cell, neighbour);
                self.push(&rectangle, cell, way);
            }
        }
    }

    /// Asks about the objects and clusters of the cells that were seen.
    fn finish(&mut self) {
        let of = self.of;
        let scratch = &mut *self.scratch;
        // By number, so that the clusters of an object follow each other.
        scratch.candidates.sort_unstable();
        let mut last_object = (u32::MAX, false);
        for &cluster in &scratch.candidates {
            let object = of.clusters.object_of(cluster);
            if last_object.0 != object {
                self.done.bounds_tested += 1;
                let seen = scratch.image.sees_box(of.clusters.object_aabb(object));
                last_object = (object, seen);
            }
            if !last_object.1 {
                continue;
            }
            if of.clusters.clusters_of(object).len() == 1 {
                scratch.visible.add(of.clusters.primitives(cluster));
                continue;
            }
            self.done.bounds_tested += 1;
            if scratch.image.sees_box(of.clusters.aabb(cluster)) {
                scratch.visible.add(of.clusters.primitives(cluster));
            }
        }
        scratch.visible.finish();
        self.done.triangles_drawn = scratch.visible.ids.len();
    }
}

impl Default for MaskedCplpScratch {
    fn default() -> MaskedCplpScratch {
        MaskedCplpScratch::with_level(SimdLevel::new())
    }
}

impl MaskedCplpScratch {
    /// A scratch whose image is drawn and asked at a given level of SIMD; all give the same answers, bit for bit.
    pub fn with_level(level: SimdLevel) -> MaskedCplpScratch {
        MaskedCplpScratch {
            image: MaskedDepth::with_level(Coverage::Sampled, level),
            frame: 0,
            cells: Vec::new(),
            facets: Vec::new(),
            clusters: Vec::new(),
            front: BinaryHeap::new(),
            candidates: Vec::new(),
            seeds: Vec::new(),
            visible: VisibleSet::default(),
        }
    }

    /// The primitives that may be seen, ascending, each once: the last walk's visible set.
    pub fn visible(&self) -> &[u32] {
        &self.visible.ids
    }

    /// The image of the last walk: says what that view cannot see.
    pub fn image(&self) -> &MaskedDepth {
        &self.image
    }

    /// The same, to draw what moves into it once the walk is over.
    pub(crate) fn image_mut(&mut self) -> &mut MaskedDepth {
        &mut self.image
    }

    fn begin(&mut self, of: &MaskedCplp, view: &View) {
        self.image.begin(view);
        self.frame = self.frame.wrapping_add(1);
        if self.frame == 0 {
            // Old marks would look new after 2³² frames.
            self.cells.fill(0);
            self.facets.fill(0);
            self.clusters.fill(0);
            self.frame = 1;
        }
        self.cells.resize(of.tessellation.cell_count(), 0);
        self.facets.resize(of.facets.len(), 0);
        self.clusters.resize(of.clusters.len(), 0);
        self.front.clear();
        self.candidates.clear();
        self.visible.begin(of.scene.triangles().len());
    }
}

/// Ids gathered out of order and given out in order, at a cost that follows their number.
#[derive(Clone, Debug, Default)]
struct VisibleSet {
    bits: Vec<u64>,
    /// Words that are not 0.
    touched: Vec<u32>,
    ids: Vec<u32>,
}

impl VisibleSet {
    fn begin(&mut self, total: usize) {
        for &word in &self.touched {
            self.bits[word as usize] = 0;
        }
        self.touched.clear();
        self.ids.clear();
        self.bits.resize(total.div_ceil(64), 0);
    }

    fn add(&mut self, ids: &[u32]) {
        for &id in ids {
            let word = &mut self.bits[id as usize / 64];
            if *word == 0 {
                self.touched.push(id / 64);
            }
            *word |= 1 << (id % 64);
        }
    }

    fn finish(&mut self) {
        self.touched.sort_unstable();
        for &index in &self.touched {
            let mut word = self.bits[index as usize];
            while word != 0 {
                self.ids.push(index * 64 + word.trailing_zeros());
                word &= word - 1;
            }
        }
    }
}
