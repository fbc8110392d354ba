//! Where do rooms end? A kD-tree that is cut at large walls (Teller 1992; Coorg & Teller 1997 use one for its fit to them).
//!
//! Octree leaves straddle thin walls, so that what one room sees leaks into the next. Here a cell is first cut where opaque
//! axis-aligned triangles lie in one plane and cover much of the cell's cross-section (Teller's *obscuration*). A wall of
//! some thickness has two such planes, so it becomes a thin cell of its own; in that cell the jambs and the lintel of a
//! door cover the whole cross-section, so it falls into solid pieces and the opening. What is left, and any soup without
//! such walls, is cut by the surface-area heuristic while a cell holds too many triangles and a cut saves something.
//!
//! A plane is one f64 that is stored once, so neighbours agree on faces bit for bit, and one that came from a wall is that
//! wall's own coordinate: [`crate::sealed`] compares them exactly.

mod file;

use glam::DVec3;

use crate::sealed::{self, Wall};
use crate::tessellation::{root_box, rounding_slack, touches};
use crate::{Aabb, CellId, Cells, Face, Neighbour, Scene, Tessellation};

/// When and where a cell is cut. Any value is legal; a zero counts as one triangle, and depth is cut to 60.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct KdRules {
    /// A cell with more triangles is cut even where no wall is. Fewer: finer culling, more queries, and furniture splits
    /// rooms. Default 256.
    pub max_triangles_per_leaf: usize,
    /// Greatest number of cuts above a cell. Default 40: a storey of 22 × 22 rooms needs about 20.
    pub max_depth: u32,
    /// The least share of a cell's cross-section that a wall must cover for a cut, from 0 to 1. Lower: smaller walls cut
    /// whole rooms apart. Default 0.4.
    pub min_obscuration: f64,
    /// Metres by which a cell is grown to find its triangles, cut to 0.0004 of the scene's size. Sampled images believe a sealed
    /// face only while its depth moves less than this over a hundredth of a pixel, so more lets seals work at lower
    /// resolutions, steeper and farther away; it lists more triangles twice. Default 0.01. No cell is thinner than twice this.
    pub skin: f64,
}

impl Default for KdRules {
    fn default() -> KdRules {
        KdRules { max_triangles_per_leaf: 256, max_depth: 40, min_obscuration: 0.4, skin: 0.01 }
    }
}

impl KdRules {
    /// The rules with another limit of triangles.
    pub fn with_max_triangles_per_leaf(self, max_triangles_per_leaf: usize) -> KdRules {
        KdRules { max_triangles_per_leaf, ..self }
    }

    /// The rules with another limit of depth.
    pub fn with_max_depth(self, max_depth: u32) -> KdRules {
        KdRules { max_depth, ..self }
    }

    /// The rules with another least obscuration.
    pub fn with_min_obscuration(self, min_obscuration: f64) -> KdRules {
        KdRules { min_obscuration, ..self }
    }

    /// The rules with another skin.
    pub fn with_skin(self, skin: f64) -> KdRules {
        KdRules { skin, ..self }
    }
}

/// What a build came to.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct KdStats {
    /// Cuts at walls.
    pub wall_cuts: usize,
    /// Cuts for the number of triangles.
    pub size_cuts: usize,
    /// The most cuts above one cell.
    pub depth: u32,
    /// Ways from a cell to a neighbour that are sealed, each direction for itself.
    pub sealed: usize,
}

/// The leaves of a kD-tree over a scene. Made once, never changed, shared by all workers.
#[derive(Clone, Debug)]
pub struct KdTree {
    nodes: Vec<Node>,
    cells: Cells,
    stats: KdStats,
}

#[derive(Clone, Copy, Debug)]
struct Node {
    aabb: Aabb,
    /// Index of the lower child (the upper follows), or the cell number of a leaf.
    first: u32,
    /// Axis of the cut, or [`LEAF`].
    axis: u8,
    plane: f64,
}

const LEAF: u8 = 3;

/// What a node of the tree is, for whoever walks it from the root.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum KdNode {
    /// A cell.
    Leaf(CellId),
    /// Its two children.
    Inner([u32; 2]),
}

/// A cell under way.
struct Open {
    node: usize,
    depth: u32,
    primitives: Vec<u32>,
    /// The faces that lie in walls: a bit for each of [`Face::ALL`].
    walls: u8,
    /// The cell as the last cut at a wall left it, if that closed it with walls on [`ROOM_FACES`] sides.
    room: Option<Aabb>,
    /// The most triangles that its leaves may list together: bounds the memory of any soup.
    references_max: usize,
}

/// A cut, and whether a wall is in it.
struct Cut {
    axis: usize,
    plane: f64,
    wall: bool,
}

/// References per triangle that a tree may come to, beside [`REFERENCES_FREE`]. Cells share it by what they hold, so it has
/// to be a good deal more than the 1 to 3 that a building ends with.
const REFERENCES_PER_TRIANGLE: usize = 40;

/// References that are no matter: small scenes of large walls have many per triangle.
const REFERENCES_FREE: usize = 1 << 16;

/// Cuts for the number of triangles leave this share of the references to walls.
const SHARE_OF_WALLS: f64 = 0.7;

/// The root box goes beyond the scene by a thousandth, and the outermost walls must be far enough inside it to be cut at.
const SKIN_SHARE: f64 = 4e-4;

/// In a part of a room, made by cuts for size, furniture looks as large as walls. A wall reaches along this share of
/// the whole room in some direction.
const SPAN_MIN: f64 = 0.6;

/// Faces in walls that make a room of a cell. A yard or a storey has fewer, until its rooms are cut.
const ROOM_FACES: u32 = 4;

/// Cuts tried per axis by the surface-area heuristic.
const BINS: usize = 16;

/// A cut must leave less than this share of the work (area × triangles) of the whole cell.
const WORK_MAX: f64 = 0.85;

struct Builder<'a> {
    scene: &'a Scene,
    walls: Vec<Option<Wall>>,
    rules: KdRules,
    /// Least distance of a cut from the faces of its cell.
    thickness: f64,
    /// Reused for the walls of a cell.
    candidates: Vec<Candidate>,
}

/// What one wall covers of a cell.
struct Candidate {
    axis: usize,
    coordinate: f64,
    area: f64,
    aabb: Aabb,
}

impl KdTree {
    /// Cuts the scene's box into cells.
    pub fn build(scene: &Scene, rules: KdRules) -> KdTree {
        let root = root_box(scene);
        let skin = rules.skin.max(0.0).min(SKIN_SHARE * root.size().max_element());
        let grown = skin + rounding_slack(&root);
        let mut builder = Builder {
            scene,
            walls: scene.triangles().iter().map(Wall::of).collect(),
            rules,
            thickness: 2.0 * grown,
            candidates: Vec::new(),
        };
        let mut nodes = vec![Node { aabb: root, first: 0, axis: LEAF, plane: 0.0 }];
        let mut cells = Cells::new(root, skin, scene.triangles().len());
        let mut stats = KdStats::default();
        let primitives: Vec<u32> = (0..scene.triangles().len() as u32).collect();
        let references_max = REFERENCES_PER_TRIANGLE * primitives.len() + REFERENCES_FREE;
        let mut open = vec![Open { node: 0, depth: 0, primitives, walls: 0, room: None, references_max }];
        while let Some(Open { node, depth, primitives, walls, room, references_max }) = open.pop() {
            let aabb = nodes[node].aabb;
            stats.depth = stats.depth.max(depth);
            let split = builder.cut(&aabb, room.as_ref(), depth, &primitives).and_then(|cut| {
                let (mut lower, mut upper) = (aabb, aabb);
                lower.max[cut.axis] = cut.plane;
                upper.min[cut.axis] = cut.plane;
                let parts = [lower, upper].map(|part| builder.inside(&primitives, &part.inflated(grown)));
                let count = parts[0].len() + parts[1].len();
                let useful = cut.wall || parts.iter().any(|part| part.len() < primitives.len());
                let share = if cut.wall { 1.0 } else { 1.0 - SHARE_OF_WALLS };
                (useful && count as f64 <= references_max as f64 * share).then_some((cut, [lower, upper], parts))
            });
            let Some((cut, boxes, parts)) = split else {
                nodes[node].first = cells.push(aabb, &primitives);
                continue;
            };
            let first = nodes.len();
            nodes[node] = Node { aabb, first: first as u32, axis: cut.axis as u8, plane: cut.plane };
            nodes.extend(boxes.map(|aabb| Node { aabb, first: 0, axis: LEAF, plane: 0.0 }));
            *if cut.wall { &mut stats.wall_cuts } else { &mut stats.size_cuts } += 1;
            let count = (parts[0].len() + parts[1].len()).max(1) as f64;
            for (i, primitives) in parts.into_iter().enumerate().rev() {
                let share = (references_max as f64 * primitives.len() as f64 / count) as usize;
                let references_max = share.max(primitives.len());
                // The lower part gets its greater face from the cut, the upper one its lesser.
                let face = 1 << (2 * cut.axis + 1 - i);
                let walls = if cut.wall { walls | face } else { walls & !face };
                let room = if cut.wall { (walls.count_ones() >= ROOM_FACES).then_some(boxes[i]) } else { room };
                open.push(Open { node: first + i, depth: depth + 1, primitives, walls, room, references_max });
            }
        }
        link(&nodes, &mut cells);
        stats.sealed = sealed::seal(scene, &builder.walls, &mut cells);
        KdTree { nodes, cells, stats }
    }

    /// What the build came to.
    pub fn stats(&self) -> KdStats {
        self.stats
    }

    /// Number of nodes; node 0 is the root, and children come after their parents.
    pub(crate) fn node_count(&self) -> usize {
        self.nodes.len()
    }

    /// What a node is.
    pub(crate) fn node(&self, index: u32) -> KdNode {
        let Node { first, axis, .. } = self.nodes[index as usize];
        if axis == LEAF { KdNode::Leaf(first) } else { KdNode::Inner([first, first + 1]) }
    }

    fn visit(&self, index: u32, point: DVec3, radius: f64, found: &mut dyn FnMut(CellId)) {
        let node = &self.nodes[index as usize];
        if node.aabb.distance(point) > radius {
        } else if node.axis == LEAF {
            found(node.first);
        } else {
            self.visit(node.first, point, radius, found);
            self.visit(node.first + 1, point, radius, found);
        }
    }
}

impl Tessellation for KdTree {
    fn cells(&self) -> &Cells {
        &self.cells
    }

    fn cell_at(&self, point: DVec3) -> Option<CellId> {
        if !self.cells.root().contains(point) {
            return None;
        }
        let mut node = &self.nodes[0];
        while node.axis != LEAF {
            node = &self.nodes[node.first as usize + usize::from(point[node.axis as usize] >= node.plane)];
        }
        Some(node.first)
    }

    fn cells_within(&self, point: DVec3, radius: f64, found: &mut dyn FnMut(CellId)) {
        self.visit(0, point, radius, found);
    }
}

impl Builder<'_> {
    /// Those of the primitives that touch a box.
    fn inside(&self, primitives: &[u32], aabb: &Aabb) -> Vec<u32> {
        let touches = |id: &u32| touches(&self.scene.triangles()[*id as usize].corners.map(|c| c.as_dvec3()), aabb);
        primitives.iter().copied().filter(touches).collect()
    }

    /// Where to cut a cell, or `None` to leave it whole.
    fn cut(&mut self, aabb: &Aabb, room: Option<&Aabb>, depth: u32, primitives: &[u32]) -> Option<Cut> {
        if depth >= self.rules.max_depth.min(60) {
            return None;
        }
        self.wall_cut(aabb, room, primitives).or_else(|| self.size_cut(aabb, primitives))
    }

    /// The plane of the walls that cover most of the cell, weighted by two things. Of many like walls the middle one keeps the
    /// tree low. And a long cell is cut across first, or a storey's floor would become one cell that all rooms border on.
    fn wall_cut(&mut self, aabb: &Aabb, room: Option<&Aabb>, primitives: &[u32]) -> Option<Cut> {
        self.candidates.clear();
        for &id in primitives {
            let Some(wall) = &self.walls[id as usize] else { continue };
            let (axis, coordinate) = (wall.axis, wall.coordinate);
            let [low, high] = [aabb.min[axis] + self.thickness, aabb.max[axis] - self.thickness];
            if (low..=high).contains(&coordinate) {
                let aabb_of_wall = self.scene.triangles()[id as usize].aabb();
                self.candidates.push(Candidate { axis, coordinate, area: wall.area_in(aabb), aabb: aabb_of_wall });
            }
        }
        self.candidates.sort_unstable_by(|a, b| a.axis.cmp(&b.axis).then(a.coordinate.total_cmp(&b.coordinate)));
        let (size, longest) = (aabb.size(), aabb.size().max_element());
        let mut best = (0.0, None);
        for plane in self.candidates.chunk_by(|a, b| (a.axis, a.coordinate) == (b.axis, b.coordinate)) {
            let Candidate { axis, coordinate, .. } = plane[0];
            let covered: f64 = plane.iter().map(|candidate| candidate.area).sum();
            // Walls that lie on each other count twice; no more than everything can be covered.
            let obscuration = (covered / (size[(axis + 1) % 3] * size[(axis + 2) % 3])).min(1.0);
            let at = (coordinate - aabb.min[axis]) / size[axis];
            let score = obscuration * (1.0 + at.min(1.0 - at)) * size[axis] / longest;
            if obscuration < self.rules.min_obscuration || score <= best.0 {
                continue;
            }
            let spans = |room: &Aabb| {
                let walls = plane.iter().fold(Aabb::EMPTY, |walls, candidate| walls.union(&candidate.aabb));
                let span = walls.size() / room.size();
                span[(axis + 1) % 3].max(span[(axis + 2) % 3]) >= SPAN_MIN
            };
            if room.is_none_or(|room| room == aabb || spans(room)) {
                best = (score, Some(Cut { axis, plane: coordinate, wall: true }));
            }
        }
        best.1
    }

    /// The cut with the least sum of area × triangles, if the cell holds too many and the cut saves enough.
    fn size_cut(&self, aabb: &Aabb, primitives: &[u32]) -> Option<Cut> {
        if primitives.len() <= self.rules.max_triangles_per_leaf.max(1) {
            return None;
        }
        let size = aabb.size();
        let area = |size: DVec3| size.x * size.y + size.y * size.z + size.z * size.x;
        let mut best = (WORK_MAX * area(size) * primitives.len() as f64, None);
        for axis in 0..3 {
            let width = size[axis] / BINS as f64;
            if width < self.thickness {
                continue;
            }
            let (mut begins, mut ends) = ([0_usize; BINS], [0_usize; BINS]);
            for &id in primitives {
                let along = self.scene.triangles()[id as usize].corners.map(|corner| f64::from(corner[axis]));
                // Saturating: NaN cannot occur, and what lies outside belongs to the outermost bins.
                let bin = |at: f64| (((at - aabb.min[axis]) / width) as usize).min(BINS - 1);
                begins[bin(along.into_iter().fold(f64::INFINITY, f64::min))] += 1;
                ends[bin(along.into_iter().fold(f64::NEG_INFINITY, f64::max))] += 1;
            }
            let (mut below, mut above) = (0, primitives.len());
            for cut in 1..BINS {
                below += begins[cut - 1];
                above -= ends[cut - 1];
                let (mut lower, mut upper) = (size, size);
                lower[axis] = width * cut as f64;
                upper[axis] = size[axis] - lower[axis];
                let work = area(lower) * below as f64 + area(upper) * above as f64;
                if work < best.0 {
                    let plane = aabb.min[axis] + lower[axis];
                    best = (work, Some(Cut { axis, plane, wall: false }));
                }
            }
        }
        best.1.filter(|cut| aabb.min[cut.axis] < cut.plane && cut.plane < aabb.max[cut.axis])
    }
}

/// Finds the neighbours of each cell, and the hull.
fn link(nodes: &[Node], cells: &mut Cells) {
    let mut open = Vec::new();
    for cell in 0..cells.len() as u32 {
        let here = *cells.aabb(cell);
        let mut neighbours = Vec::new();
        for face in Face::ALL {
            let axis = face.axis();
            let plane = if face.is_positive() { here.max[axis] } else { here.min[axis] };
            open.push(0);
            while let Some(index) = open.pop() {
                let Node { aabb, first, axis: cut, .. } = nodes[index as usize];
                let (min, max) = (aabb.min[axis], aabb.max[axis]);
                let reaches =
                    if face.is_positive() { min <= plane && plane < max } else { min < plane && plane <= max };
                let overlaps = |other: usize| {
                    other == axis || (aabb.min[other] < here.max[other] && here.min[other] < aabb.max[other])
                };
                if !reaches || !(0..3).all(overlaps) {
                    continue;
                }
                if cut == LEAF {
                    neighbours.push(Neighbour::open(first, face));
                } else {
                    open.extend([first + 1, first]);
                }
            }
        }
        cells.push_neighbours(neighbours);
    }
    cells.find_hull();
}

#[cfg(test)]
mod tests;
