//! Which piece of space holds which triangles, where walls are upright? Prisms: the floor plan, triangulated with the walls as
//! edges, between floors and ceilings.
//!
//! A box that is not parallel to the axes' walls, or a leaf of an octree, holds parts of several rooms. Here walls are
//! constraints of a Delaunay triangulation of the plan (the crate spade's), so that no cell goes through a wall. All storeys
//! have one plan, the union of their walls: then a prism has one neighbour at most behind each of its five faces.
//!
//! Walls are snapped to a grid of 1 mm, on which predicates are exact; then each corner is moved back to where the walls
//! across an axis stand exactly, since [`crate::sealed`] compares coordinates to the bit. The plan is checked after that: each
//! triangle is the right way round, and together they fill the root's rectangle. What fails is an error, and a traversal can
//! take an octree.
//!
//! In [`Cells`] a prism is the box around it, which is what queries are asked about: too large a box shows more, never
//! less. What is listed by a cell is listed by the prism itself.

mod file;

use glam::{DVec2, DVec3};
use rustc_hash::FxHashMap;
use spade::{ConstrainedDelaunayTriangulation, Point2, Triangulation};

use crate::delaunay::Polygon;
use crate::sealed::{self, Wall};
use crate::storeys::{GRID, Storeys};
use crate::tessellation::root_box;
use crate::{Aabb, CellId, Cells, Face, Neighbour, Scene, Tessellation};

/// Why there are no prisms.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum PrismsError {
    /// The scene is not made of storeys.
    #[error("no storeys: {counted}")]
    NoStoreys {
        /// What was counted.
        counted: String,
    },
    /// The plan of the walls is no triangulation.
    #[error("no triangulation of a plan of {walls} walls: {fault}")]
    Unsound {
        /// Number of walls.
        walls: usize,
        /// Which check failed.
        fault: &'static str,
    },
    /// Cells would list too much.
    #[error("{cells} prisms would list more than {references} triangles")]
    TooMany {
        /// Number of cells.
        cells: usize,
        /// The most that they may list.
        references: usize,
    },
}

/// Prisms over a scene. Made once, never changed, shared by all workers.
#[derive(Clone, Debug)]
pub struct Prisms {
    /// Corners of the plan, x and z.
    pub(crate) sites: Vec<DVec2>,
    /// Triangles of the plan, corners anticlockwise as seen from below (x to the right, z up).
    pub(crate) plan: Vec<[u32; 3]>,
    /// Heights of the horizontal faces, ascending. Cell number = layer · triangles of the plan + triangle.
    pub(crate) heights: Vec<f64>,
    pub(crate) cells: Cells,
    pub(crate) storeys: usize,
    pub(crate) sealed: usize,
    buckets: Buckets,
}

/// Metres by which a cell is grown to find its triangles: [`crate::KdRules::skin`]'s.
const SKIN: f64 = 0.01;

/// References per triangle that cells may come to, beside [`REFERENCES_FREE`].
const REFERENCES_PER_TRIANGLE: usize = 40;
const REFERENCES_FREE: usize = 1 << 20;

/// Most walls: a plan of more is no plan of storeys.
const WALLS_MAX: usize = 200_000;

impl Prisms {
    /// Makes the cells of a scene.
    ///
    /// # Errors
    /// If the scene has no storeys, with what was counted, or if its plan cannot be triangulated. Take another tessellation then.
    pub fn build(scene: &Scene) -> Result<Prisms, PrismsError> {
        let storeys = Storeys::find(scene).map_err(|counted| PrismsError::NoStoreys { counted })?;
        let walls = storeys.walls.len();
        let unsound = |fault| PrismsError::Unsound { walls, fault };
        if walls > WALLS_MAX {
            return Err(unsound("more walls than a plan may have"));
        }
        let inflated = root_box(scene);
        let low = [inflated.min.x, inflated.min.z].map(|at| (at * GRID).floor() as i64);
        let high = [inflated.max.x, inflated.max.z].map(|at| (at * GRID).ceil() as i64);
        let (sites, plan) = triangulate(&storeys, low, high).map_err(unsound)?;
        let [low, high] = [low, high].map(|corner| corner.map(|step| step as f64 / GRID));
        let root = Aabb::new(DVec3::new(low[0], inflated.min.y, low[1]), DVec3::new(high[0], inflated.max.y, high[1]));
        let heights = heights(&storeys.levels, &root);
        let mut prisms = Prisms {
            buckets: Buckets::new(&sites, &plan, &root),
            cells: Cells::new(root, SKIN, scene.triangles().len()),
            storeys: storeys.count,
            sealed: 0,
            sites,
            plan,
            heights,
        };
        prisms.fill(scene)?;
        prisms.link();
        let walls: Vec<Option<Wall>> = scene.triangles().iter().map(Wall::of).collect();
        prisms.sealed = sealed::seal(scene, &walls, &mut prisms.cells);
        Ok(prisms)
    }

    /// Number of storeys that were found.
    pub fn storeys(&self) -> usize {
        self.storeys
    }

    /// Number of triangles of the plan.
    pub fn plan_triangles(&self) -> usize {
        self.plan.len()
    }

    /// Ways from a cell to a neighbour that walls seal, each direction for itself.
    pub fn sealed(&self) -> usize {
        self.sealed
    }

    /// The corners of a prism: of its floor, then above them.
    pub fn corners(&self, cell: CellId) -> [DVec3; 6] {
        let [low, high] = self.layer(cell);
        let plan = self.plan_corners(cell);
        std::array::from_fn(|i| {
            let at = plan[i % 3];
            DVec3::new(at.x, if i < 3 { low } else { high }, at.y)
        })
    }

    /// Faces of a prism with a cell behind them: that cell, the outward unit normal, and three or four corners once round.
    pub fn faces(&self, cell: CellId) -> impl Iterator<Item = (CellId, DVec3, [DVec3; 4], usize)> {
        let c = self.corners(cell);
        let of = self.plan[cell as usize % self.plan.len()];
        self.cells.neighbours(cell).iter().filter_map(move |neighbour| {
            if neighbour.face.axis() == 1 {
                let (normal, at) = if neighbour.face.is_positive() { (DVec3::Y, 3) } else { (DVec3::NEG_Y, 0) };
                // Layers lie on each other: above and below is the same triangle of the plan.
                let same = neighbour.cell as usize % self.plan.len() == cell as usize % self.plan.len();
                if same {
                    return Some((neighbour.cell, normal, [c[at], c[at + 1], c[at + 2], c[at + 2]], 3));
                }
            }
            let other = self.plan[neighbour.cell as usize % self.plan.len()];
            let edge = (0..3).find(|&i| other.contains(&of[i]) && other.contains(&of[(i + 1) % 3]))?;
            let next = (edge + 1) % 3;
            let along = c[next] - c[edge];
            let normal = DVec3::new(along.z, 0.0, -along.x).normalize_or_zero();
            Some((neighbour.cell, normal, [c[edge], c[next], c[next + 3], c[edge + 3]], 4))
        })
    }

    /// Cells with a face in the hull that an eye is in front of: every such face lies in the root box's.
    pub fn hull_facing(&self, eye: DVec3) -> impl Iterator<Item = CellId> {
        let root = self.cells.root();
        let faces = Face::ALL.into_iter().filter(move |face| face.height(&root, eye) > 0.0);
        faces.flat_map(|face| self.cells.hull(face).iter().copied())
    }

    /// Bytes that the cells and their lists take.
    pub fn memory_bytes(&self) -> usize {
        self.cells.memory_bytes()
            + size_of_val(&*self.sites)
            + size_of_val(&*self.plan)
            + size_of_val(&*self.heights)
            + self.buckets.memory_bytes()
    }

    /// Puts together what was loaded. `None` if it is no tessellation.
    pub(crate) fn from_parts(
        sites: Vec<DVec2>,
        plan: Vec<[u32; 3]>,
        heights: Vec<f64>,
        cells: Cells,
        storeys: usize,
        sealed: usize,
    ) -> Option<Prisms> {
        let plane = cells.root().size();
        let sound = heights.len() >= 2
            && heights.is_sorted_by(|a, b| a < b)
            && heights.iter().all(|height| height.is_finite())
            && sites.iter().all(|site| site.is_finite())
            && plan.iter().flatten().all(|&site| (site as usize) < sites.len())
            && is_sound(&sites, &plan, plane.x * plane.z)
            && cells.len() == plan.len() * (heights.len() - 1);
        let buckets = if sound { Buckets::new(&sites, &plan, &cells.root()) } else { return None };
        Some(Prisms { sites, plan, heights, cells, storeys, sealed, buckets })
    }

    /// Floor and ceiling of a cell.
    fn layer(&self, cell: CellId) -> [f64; 2] {
        let layer = cell as usize / self.plan.len();
        [self.heights[layer], self.heights[layer + 1]]
    }

    fn plan_corners(&self, cell: CellId) -> [DVec2; 3] {
        self.plan[cell as usize % self.plan.len()].map(|site| self.sites[site as usize])
    }

    /// Outward unit normals of the upright faces and how high these lie along them.
    fn upright(&self, cell: CellId) -> [(DVec2, f64); 3] {
        let corners = self.plan_corners(cell);
        std::array::from_fn(|i| {
            let along = corners[(i + 1) % 3] - corners[i];
            let normal = DVec2::new(along.y, -along.x).normalize_or_zero();
            (normal, normal.dot(corners[i]))
        })
    }

    /// How far outside a prism a point is at least; up to `rounding` inside it.
    fn outside(&self, cell: CellId, point: DVec3) -> f64 {
        let [low, high] = self.layer(cell);
        let plan = DVec2::new(point.x, point.z);
        let sides = self.upright(cell).map(|(normal, height)| normal.dot(plan) - height);
        sides.into_iter().fold((low - point.y).max(point.y - high), f64::max)
    }

    /// Lists each triangle in each cell that it touches.
    fn fill(&mut self, scene: &Scene) -> Result<(), PrismsError> {
        let (count, layers) = (self.plan.len(), self.heights.len() - 1);
        let references = REFERENCES_PER_TRIANGLE * scene.triangles().len() + REFERENCES_FREE;
        let grown = SKIN + rounding(&self.cells.root());
        let mut pairs: Vec<(CellId, u32)> = Vec::new();
        let (mut seen, mut near) = (vec![u32::MAX; count], Vec::new());
        let mut polygon = Polygon::default();
        for (id, triangle) in (0..).zip(scene.triangles()) {
            let corners = triangle.corners.map(|corner| corner.as_dvec3());
            let aabb = triangle.aabb().inflated(grown);
            near.clear();
            self.buckets.visit(&aabb, |of_plan| {
                if std::mem::replace(&mut seen[of_plan as usize], id) != id {
                    near.push(of_plan);
                }
            });
            let first = self.heights[1..layers].partition_point(|&height| height < aabb.min.y);
            for layer in first..layers {
                if self.heights[layer] > aabb.max.y {
                    break;
                }
                let touched = near.iter().map(|of_plan| (layer * count) as u32 + of_plan);
                pairs.extend(
                    touched.filter(|&cell| self.touches(cell, &corners, grown, &mut polygon)).map(|cell| (cell, id)),
                );
            }
            if pairs.len() > references {
                return Err(PrismsError::TooMany { cells: count * layers, references });
            }
        }
        pairs.sort_unstable();
        let mut pairs = pairs.into_iter().peekable();
        let mut of_cell = Vec::new();
        for cell in 0..(count * layers) as CellId {
            of_cell.clear();
            while let Some((_, id)) = pairs.next_if(|pair| pair.0 == cell) {
                of_cell.push(id);
            }
            let aabb = self.corners(cell).into_iter().fold(Aabb::EMPTY, |aabb, corner| aabb.with_point(corner));
            self.cells.push(aabb, &of_cell);
        }
        Ok(())
    }

    /// Whether a triangle has a point within `grown` of each of a prism's planes, on the inner side: it is cut at the five.
    fn touches(&self, cell: CellId, corners: &[DVec3; 3], grown: f64, polygon: &mut Polygon) -> bool {
        let [low, high] = self.layer(cell);
        polygon.points.clear();
        polygon.points.extend_from_slice(corners);
        polygon.keep_below(DVec3::Y, high + grown)
            && polygon.keep_below(DVec3::NEG_Y, -low + grown)
            && self
                .upright(cell)
                .into_iter()
                .all(|(normal, height)| polygon.keep_below(DVec3::new(normal.x, 0.0, normal.y), height + grown))
    }

    /// Finds the neighbours of each cell, and the hull.
    fn link(&mut self) {
        let count = self.plan.len();
        let mut sides: FxHashMap<[u32; 2], u32> = FxHashMap::default();
        for (of_plan, corners) in (0..).zip(&self.plan) {
            sides.extend((0..3).map(|i| ([corners[i], corners[(i + 1) % 3]], of_plan)));
        }
        for cell in 0..self.cells.len() as CellId {
            let (layer, of_plan) = (cell as usize / count, cell as usize % count);
            let corners = self.plan[of_plan];
            let [low, high] = self.layer(cell);
            let around = *self.cells.aabb(cell);
            let mut neighbours = Vec::with_capacity(5);
            for i in 0..3 {
                let [from, to] = [corners[i], corners[(i + 1) % 3]];
                let Some(&other) = sides.get(&[to, from]) else { continue };
                let [a, b] = [from, to].map(|site| self.sites[site as usize]);
                let shared = Aabb::new(
                    DVec3::new(a.x.min(b.x), low, a.y.min(b.y)),
                    DVec3::new(a.x.max(b.x), high, a.y.max(b.y)),
                );
                // The axis that the face lies across most; to both cells the same.
                let (along, size) = (b - a, shared.size());
                let face = match (size.x < size.z, along.x > 0.0, along.y > 0.0) {
                    (true, _, false) => Face::ALL[0],
                    (true, _, true) => Face::ALL[1],
                    (false, true, _) => Face::ALL[4],
                    (false, false, _) => Face::ALL[5],
                };
                neighbours.push((Neighbour::open((layer * count) as u32 + other, face), shared));
            }
            if layer > 0 {
                let shared = Aabb { max: DVec3 { y: low, ..around.max }, ..around };
                neighbours.push((Neighbour::open(cell - count as u32, Face::ALL[2]), shared));
            }
            if layer + 2 < self.heights.len() {
                let shared = Aabb { min: DVec3 { y: high, ..around.min }, ..around };
                neighbours.push((Neighbour::open(cell + count as u32, Face::ALL[3]), shared));
            }
            self.cells.push_neighbours_sharing(neighbours);
        }
        self.cells.find_hull();
    }
}

impl Tessellation for Prisms {
    fn cells(&self) -> &Cells {
        &self.cells
    }

    fn cell_at(&self, point: DVec3) -> Option<CellId> {
        if !self.cells.root().contains(point) {
            return None;
        }
        let layers = self.heights.len() - 1;
        let layer = self.heights[1..layers].partition_point(|&height| height <= point.y);
        let mut best = (f64::INFINITY, None);
        self.buckets.visit(&Aabb::new(point, point), |of_plan| {
            let cell = (layer * self.plan.len()) as u32 + of_plan;
            let outside = self.outside(cell, point);
            if outside < best.0 {
                best = (outside, Some(cell));
            }
        });
        best.1
    }

    /// Finds cells a little farther away too, as rounding has it, and such as only their planes are within reach of.
    fn cells_within(&self, point: DVec3, radius: f64, found: &mut dyn FnMut(CellId)) {
        let reach = radius + rounding(&self.cells.root());
        let mut near = Vec::new();
        self.buckets.visit(&Aabb::around(point, DVec3::splat(reach)), |of_plan| near.push(of_plan));
        near.sort_unstable();
        near.dedup();
        for layer in 0..self.heights.len() - 1 {
            if self.heights[layer] - point.y <= reach && point.y - self.heights[layer + 1] <= reach {
                let cells = near.iter().map(|of_plan| (layer * self.plan.len()) as u32 + of_plan);
                cells.filter(|&cell| self.outside(cell, point) <= reach).for_each(&mut *found);
            }
        }
    }
}

/// Metres within which places in a root box are as one.
fn rounding(root: &Aabb) -> f64 {
    1e-9 * root.min.abs().max(root.max.abs()).max_element()
}

/// Floors and ceilings between the root's, none so near another that no cell would fit between.
fn heights(levels: &[f64], root: &Aabb) -> Vec<f64> {
    let mut heights = vec![root.min.y];
    for &level in levels {
        if level - heights[heights.len() - 1] > 4.0 * SKIN && root.max.y - level > 4.0 * SKIN {
            heights.push(level);
        }
    }
    // The root goes a little beyond the lowest floor: a layer as thin as that is none.
    heights.push(root.max.y);
    heights
}

/// Corners of the plan and its triangles.
type Plan = (Vec<DVec2>, Vec<[u32; 3]>);

/// Triangulates the rectangle from `low` to `high` with walls as edges.
fn triangulate(storeys: &Storeys, low: [i64; 2], high: [i64; 2]) -> Result<Plan, &'static str> {
    let mut made: ConstrainedDelaunayTriangulation<Point2<f64>> = ConstrainedDelaunayTriangulation::new();
    let mut insert = |at: [i64; 2]| {
        made.insert(Point2::new(at[0] as f64, at[1] as f64))
            .map_err(|_| "a corner is no number")
            .map(|vertex| (vertex, at))
    };
    let outline = [low, [high[0], low[1]], high, [low[0], high[1]]];
    for corner in outline {
        insert(corner)?;
    }
    let mut ends = Vec::with_capacity(storeys.walls.len());
    for wall in &storeys.walls {
        let inside = |end: &[i64; 2]| (0..2).all(|axis| low[axis] < end[axis] && end[axis] < high[axis]);
        if !wall.iter().all(inside) {
            return Err("a wall reaches out of the scene");
        }
        ends.push((insert(wall[0])?.0, insert(wall[1])?.0));
    }
    for (from, to) in ends {
        // Walls cross; where they do the crossing becomes a corner.
        made.add_constraint_and_split(from, to, |crossing| crossing);
    }
    let place = |at: f64, axis: usize| {
        let exact = if at.fract() == 0.0 { storeys.exact[axis].get(&(at as i64)).copied() } else { None };
        exact.unwrap_or(at / GRID)
    };
    let by_step = |exactly: bool| -> Vec<DVec2> {
        let at = |point: Point2<f64>| {
            if exactly { [place(point.x, 0), place(point.y, 1)] } else { [point.x / GRID, point.y / GRID] }
        };
        made.vertices().map(|vertex| DVec2::from_array(at(vertex.position()))).collect()
    };
    let plan: Vec<[u32; 3]> =
        made.inner_faces().map(|face| face.vertices().map(|vertex| vertex.fix().index() as u32)).collect();
    let size = [0, 1].map(|axis| (high[axis] - low[axis]) as f64 / GRID);
    // Moving corners back by up to half a millimetre could turn a sliver; without it walls are not sealed, but all is sound.
    [true, false]
        .into_iter()
        .map(by_step)
        .find(|sites| is_sound(sites, &plan, size[0] * size[1]))
        .map(|sites| (sites, plan))
        .ok_or("its triangles do not fill the rectangle once")
}

/// Whether triangles are the right way round and fill a convex rectangle of this area.
fn is_sound(sites: &[DVec2], plan: &[[u32; 3]], area: f64) -> bool {
    let mut filled = 0.0;
    let each = plan.iter().all(|corners| {
        let [a, b, c] = corners.map(|site| sites[site as usize]);
        let twice = (b - a).perp_dot(c - a);
        filled += twice * 0.5;
        twice > 0.0
    });
    each && (filled / area - 1.0).abs() < 1e-9
}

/// Entries of [`Buckets`] per triangle of the plan, beside [`LISTED_FREE`], beyond which squares are made larger.
const LISTED_PER_TRIANGLE: usize = 64;
const LISTED_FREE: usize = 1 << 16;

/// Which triangles of the plan touch which square of a grid.
#[derive(Clone, Debug)]
struct Buckets {
    min: DVec2,
    /// Squares per metre.
    scale: DVec2,
    side: usize,
    starts: Vec<u32>,
    of_plan: Vec<u32>,
}

impl Buckets {
    fn new(sites: &[DVec2], plan: &[[u32; 3]], root: &Aabb) -> Buckets {
        let min = DVec2::new(root.min.x, root.min.z);
        let size = DVec2::new(root.max.x, root.max.z) - min;
        let mut side = ((plan.len() as f64).sqrt() as usize).clamp(1, 512);
        let of =
            |side: usize| Buckets { min, scale: side as f64 / size, side, starts: Vec::new(), of_plan: Vec::new() };
        let squares = |buckets: &Buckets, corners: &[u32; 3]| {
            let [a, b, c] = corners.map(|site| sites[site as usize]);
            buckets.squares(a.min(b).min(c), a.max(b).max(c))
        };
        // Slivers across the whole plan would be in most squares: with larger squares lists stay a multiple of the plan.
        let listed = |buckets: &Buckets| -> usize {
            let of_one = |corners| {
                let [low, high] = squares(buckets, corners);
                (high[0] - low[0] + 1) * (high[1] - low[1] + 1)
            };
            plan.iter().map(of_one).sum()
        };
        while side > 1 && listed(&of(side)) > LISTED_PER_TRIANGLE * plan.len() + LISTED_FREE {
            side /= 2;
        }
        let mut buckets = of(side);
        buckets.starts = vec![0; side * side + 1];
        let mut pairs: Vec<(u32, u32)> = Vec::new();
        for (of_plan, corners) in (0..).zip(plan) {
            let [low, high] = squares(&buckets, corners);
            for y in low[1]..=high[1] {
                pairs.extend((low[0]..=high[0]).map(|x| ((y * side + x) as u32, of_plan)));
            }
        }
        pairs.sort_unstable();
        pairs.iter().for_each(|&(square, _)| buckets.starts[square as usize + 1] += 1);
        for square in 0..side * side {
            buckets.starts[square + 1] += buckets.starts[square];
        }
        buckets.of_plan = pairs.into_iter().map(|(_, of_plan)| of_plan).collect();
        buckets
    }

    /// The squares of two corners. Conversions saturate, so that what is outside goes to the nearest square.
    fn squares(&self, low: DVec2, high: DVec2) -> [[usize; 2]; 2] {
        let square = |at: DVec2| ((at - self.min) * self.scale).to_array().map(|at| (at as usize).min(self.side - 1));
        // A hair's breadth more: a corner on a line between squares belongs to both.
        let hair = DVec2::splat(1e-9) * (low.abs().max(high.abs()) + 1.0);
        [square(low - hair), square(high + hair)]
    }

    /// Calls `found` for each triangle of the plan that may touch a box's plan, some more than once.
    fn visit(&self, aabb: &Aabb, mut found: impl FnMut(u32)) {
        let [low, high] = self.squares(DVec2::new(aabb.min.x, aabb.min.z), DVec2::new(aabb.max.x, aabb.max.z));
        for y in low[1]..=high[1] {
            let squares = y * self.side + low[0]..=y * self.side + high[0];
            let of_plan = self.starts[*squares.start()] as usize..self.starts[*squares.end() + 1] as usize;
            self.of_plan[of_plan].iter().for_each(|&of_plan| found(of_plan));
        }
    }

    fn memory_bytes(&self) -> usize {
        size_of_val(&*self.starts) + size_of_val(&*self.of_plan)
    }
}

#[cfg(test)]
mod tests;
