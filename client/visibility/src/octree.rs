//! Which piece of space holds which triangles? The octree tessellation of PLP and cPLP (Klosowski & Silva 2000, §4.3).
//!
//! Only the leaves count: they are the *cells*, closed boxes that fill the root box without overlap, each with the
//! triangles that touch it and the cells that share a face with it. An axis is halved only while it is about as long
//! as the longest, so that the cells of a flat building are nearly cubes too. Cell corners lie on one integer lattice, so
//! that neighbours agree on their shared faces to the last bit.

use glam::DVec3;

use crate::{Aabb, Scene};

/// Number of a cell in its tessellation.
pub type CellId = u32;

/// When a cell is split. Any value is legal; a zero counts as one triangle, and depth is cut to 20.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct OctreeRules {
    /// A cell with more triangles is split. Fewer: finer culling, more queries. Default 64.
    pub max_triangles_per_leaf: usize,
    /// Greatest number of splits above a cell. Default 10: cells of a 100 m scene are no smaller than 0.1 m.
    pub max_depth: u32,
}

impl Default for OctreeRules {
    fn default() -> OctreeRules {
        OctreeRules { max_triangles_per_leaf: 64, max_depth: 10 }
    }
}

impl OctreeRules {
    /// The rules with another limit of triangles.
    pub fn with_max_triangles_per_leaf(self, max_triangles_per_leaf: usize) -> OctreeRules {
        OctreeRules { max_triangles_per_leaf, ..self }
    }

    /// The rules with another limit of depth.
    pub fn with_max_depth(self, max_depth: u32) -> OctreeRules {
        OctreeRules { max_depth, ..self }
    }
}

/// One of the six faces of a box.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Face(u8);

impl Face {
    /// All six: −x, +x, −y, +y, −z, +z.
    pub const ALL: [Face; 6] = [Face(0), Face(1), Face(2), Face(3), Face(4), Face(5)];

    /// The axis that the face is perpendicular to: 0, 1 or 2.
    pub const fn axis(self) -> usize {
        (self.0 >> 1) as usize
    }

    /// Whether the face is the one with the greater coordinate.
    pub const fn is_positive(self) -> bool {
        self.0 & 1 == 1
    }

    /// How far `point` lies in front of this face of `aabb`; negative behind it.
    pub fn height(self, aabb: &Aabb, point: DVec3) -> f64 {
        let axis = self.axis();
        if self.is_positive() { point[axis] - aabb.max[axis] } else { aabb.min[axis] - point[axis] }
    }
}

/// A cell behind a face.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Neighbour {
    /// The cell on the other side.
    pub cell: CellId,
    /// The face that leads there, of the cell one comes from.
    pub face: Face,
}

/// The leaves of an octree over a scene. Made once, never changed, shared by all workers.
#[derive(Clone, Debug)]
pub struct Octree {
    root: Aabb,
    nodes: Vec<Node>,
    cells: Vec<Aabb>,
    /// `primitives[primitive_starts[c]..primitive_starts[c + 1]]` are those of cell c, ascending; likewise below.
    primitive_starts: Vec<u32>,
    primitives: Vec<u32>,
    neighbour_starts: Vec<u32>,
    neighbours: Vec<Neighbour>,
    hull_starts: [u32; 7],
    hull: Vec<CellId>,
    primitives_max: usize,
    primitive_total: usize,
}

#[derive(Clone, Copy, Debug)]
struct Node {
    lattice: Lattice,
    /// Index of the first child, or the cell number of a leaf.
    first: u32,
    /// Bit per axis that is halved; 0 for a leaf. Children count up with x fastest, over the halved axes only.
    axes: u8,
}

/// Steps of the root box per axis.
const LATTICE_STEPS: u32 = 1 << 20;

/// A box in lattice coordinates.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Lattice {
    min: [u32; 3],
    max: [u32; 3],
}

impl Lattice {
    fn corner(root: &Aabb, at: [u32; 3]) -> DVec3 {
        DVec3::from_array(std::array::from_fn(|axis| match at[axis] {
            0 => root.min[axis],
            LATTICE_STEPS => root.max[axis],
            step => root.min[axis] + (root.max[axis] - root.min[axis]) * (f64::from(step) / f64::from(LATTICE_STEPS)),
        }))
    }

    fn aabb(&self, root: &Aabb) -> Aabb {
        Aabb::new(Lattice::corner(root, self.min), Lattice::corner(root, self.max))
    }

    fn middle(&self, axis: usize) -> u32 {
        self.min[axis].midpoint(self.max[axis])
    }

    fn child(&self, axes: u8, mut index: u32) -> Lattice {
        let mut child = *self;
        for axis in (0..3).filter(|axis| axes >> axis & 1 == 1) {
            let middle = self.middle(axis);
            if index & 1 == 1 {
                child.min[axis] = middle;
            } else {
                child.max[axis] = middle;
            }
            index >>= 1;
        }
        child
    }

    /// Whether the two boxes lie on different sides of one plane along `axis` and share some area of it.
    fn shares_face(&self, other: &Lattice, face: Face) -> bool {
        let touches = if face.is_positive() {
            self.max[face.axis()] == other.min[face.axis()]
        } else {
            self.min[face.axis()] == other.max[face.axis()]
        };
        touches && (0..3).all(|axis| axis == face.axis() || self.overlaps(other, axis))
    }

    /// Whether the open intervals along `axis` overlap.
    fn overlaps(&self, other: &Lattice, axis: usize) -> bool {
        self.min[axis] < other.max[axis] && other.min[axis] < self.max[axis]
    }
}

impl Octree {
    /// Splits the scene's box into cells.
    pub fn build(scene: &Scene, rules: OctreeRules) -> Octree {
        let root = root_box(scene);
        // SAT compares products of coordinates; this swallows their rounding. Too many triangles in a cell are harmless.
        let slack = 1e-12 * root.min.abs().max(root.max.abs()).max_element();
        let whole = Lattice { min: [0; 3], max: [LATTICE_STEPS; 3] };
        let mut octree = Octree {
            root,
            nodes: vec![Node { lattice: whole, first: 0, axes: 0 }],
            cells: Vec::new(),
            primitive_starts: vec![0],
            primitives: Vec::new(),
            neighbour_starts: vec![0],
            neighbours: Vec::new(),
            hull_starts: [0; 7],
            hull: Vec::new(),
            primitives_max: 0,
            primitive_total: scene.triangles().len(),
        };
        let mut open = vec![(0, 0, (0..scene.triangles().len() as u32).collect::<Vec<u32>>())];
        while let Some((node, depth, primitives)) = open.pop() {
            if let Some((axes, parts)) = octree.split(scene, rules, node, depth, &primitives, slack) {
                let first = octree.nodes.len();
                octree.nodes[node].axes = axes;
                octree.nodes[node].first = first as u32;
                for index in 0..parts.len() {
                    let lattice = octree.nodes[node].lattice.child(axes, index as u32);
                    octree.nodes.push(Node { lattice, first: 0, axes: 0 });
                }
                open.extend(parts.into_iter().enumerate().rev().map(|(i, part)| (first + i, depth + 1, part)));
            } else {
                octree.nodes[node].first = octree.cells.len() as u32;
                octree.cells.push(octree.nodes[node].lattice.aabb(&root));
                octree.primitives_max = octree.primitives_max.max(primitives.len());
                octree.primitives.extend(primitives);
                octree.primitive_starts.push(octree.primitives.len() as u32);
            }
        }
        octree.link();
        octree
    }

    /// The halved axes of a node and the triangles of each child, or `None` if it stays whole.
    fn split(
        &self,
        scene: &Scene,
        rules: OctreeRules,
        node: usize,
        depth: u32,
        primitives: &[u32],
        slack: f64,
    ) -> Option<(u8, Vec<Vec<u32>>)> {
        if primitives.len() <= rules.max_triangles_per_leaf.max(1) || depth >= rules.max_depth.min(20) {
            return None;
        }
        let lattice = self.nodes[node].lattice;
        let size = lattice.aabb(&self.root).size();
        let axes = (0..3).fold(0, |axes, axis| axes | u8::from(size[axis] > 0.6 * size.max_element()) << axis);
        let parts: Vec<Vec<u32>> = (0..1_u32 << axes.count_ones())
            .map(|index| {
                let aabb = lattice.child(axes, index).aabb(&self.root).inflated(slack);
                let touches = |id: &u32| touches(&scene.triangles()[*id as usize].corners.map(|c| c.as_dvec3()), &aabb);
                primitives.iter().copied().filter(touches).collect()
            })
            .collect();
        // Where every child would hold everything (duplicates, a common vertex in the middle), depth buys nothing.
        parts.iter().any(|part| part.len() < primitives.len()).then_some((axes, parts))
    }

    /// Finds the neighbours of each cell, and the cells of each hull face.
    fn link(&mut self) {
        let mut lattices = vec![self.nodes[0].lattice; self.cells.len()];
        for node in self.nodes.iter().filter(|node| node.axes == 0) {
            lattices[node.first as usize] = node.lattice;
        }
        for lattice in &lattices {
            for face in Face::ALL {
                let mut open = vec![0];
                while let Some(index) = open.pop() {
                    let node = self.nodes[index as usize];
                    // A node may hold a neighbour if it reaches across the face.
                    let axis = face.axis();
                    let reaches = if face.is_positive() {
                        node.lattice.min[axis] <= lattice.max[axis] && lattice.max[axis] < node.lattice.max[axis]
                    } else {
                        node.lattice.min[axis] < lattice.min[axis] && lattice.min[axis] <= node.lattice.max[axis]
                    };
                    if !reaches || (0..3).any(|other| other != axis && !lattice.overlaps(&node.lattice, other)) {
                        continue;
                    }
                    if node.axes != 0 {
                        open.extend((node.first..node.first + (1 << node.axes.count_ones())).rev());
                    } else if lattice.shares_face(&node.lattice, face) {
                        self.neighbours.push(Neighbour { cell: node.first, face });
                    }
                }
            }
            self.neighbour_starts.push(self.neighbours.len() as u32);
        }
        for face in Face::ALL {
            let axis = face.axis();
            self.hull.extend((0..).zip(&lattices).filter_map(|(cell, lattice)| {
                let outer =
                    if face.is_positive() { lattice.max[axis] == LATTICE_STEPS } else { lattice.min[axis] == 0 };
                outer.then_some(cell)
            }));
            self.hull_starts[face.0 as usize + 1] = self.hull.len() as u32;
        }
    }

    /// The box that the cells fill: the scene's box, inflated a little so that no triangle lies on the hull (condition (a) of
    /// DESIGN.md §4).
    pub fn root(&self) -> Aabb {
        self.root
    }

    /// Number of cells, at least 1.
    pub fn cell_count(&self) -> usize {
        self.cells.len()
    }

    /// The closed box of a cell.
    pub fn cell(&self, cell: CellId) -> &Aabb {
        &self.cells[cell as usize]
    }

    /// The triangles that touch a cell, ascending.
    pub fn primitives(&self, cell: CellId) -> &[u32] {
        let cell = cell as usize;
        &self.primitives[self.primitive_starts[cell] as usize..self.primitive_starts[cell + 1] as usize]
    }

    /// The cells that share some area of a face with a cell.
    pub fn neighbours(&self, cell: CellId) -> &[Neighbour] {
        let cell = cell as usize;
        &self.neighbours[self.neighbour_starts[cell] as usize..self.neighbour_starts[cell + 1] as usize]
    }

    /// The cells with a face in this face of the root box.
    pub fn hull(&self, face: Face) -> &[CellId] {
        let face = face.0 as usize;
        &self.hull[self.hull_starts[face] as usize..self.hull_starts[face + 1] as usize]
    }

    /// ρ_max: the most triangles in one cell.
    pub fn primitives_max(&self) -> usize {
        self.primitives_max
    }

    /// Number of triangles of the scene that the octree was built for.
    pub fn primitive_total(&self) -> usize {
        self.primitive_total
    }

    /// The cell that contains `point`, or `None` outside the root box. On a shared face, the one with greater coordinates.
    pub fn cell_at(&self, point: DVec3) -> Option<CellId> {
        if !self.root.contains(point) {
            return None;
        }
        let mut node = self.nodes[0];
        while node.axes != 0 {
            let middle = Lattice::corner(&self.root, std::array::from_fn(|axis| node.lattice.middle(axis)));
            let mut child = node.first;
            let mut bit = 1;
            for axis in (0..3).filter(|axis| node.axes >> axis & 1 == 1) {
                if point[axis] >= middle[axis] {
                    child += bit;
                }
                bit <<= 1;
            }
            node = self.nodes[child as usize];
        }
        Some(node.first)
    }

    /// Calls `found` for each closed cell within `radius` of `point`, in order of cell number.
    pub fn cells_within(&self, point: DVec3, radius: f64, mut found: impl FnMut(CellId)) {
        self.visit(0, &mut |aabb| aabb.distance(point) <= radius, &mut found);
    }

    /// Walks the nodes from the one nearest to `eye` on, so that none comes after one that it can hide. `enter` is told a
    /// node's closed box and, for a leaf, its cell; children are visited only where it returns true.
    pub(crate) fn front_to_back(&self, eye: DVec3, mut enter: impl FnMut(&Aabb, Option<CellId>) -> bool) {
        let mut open = vec![0];
        while let Some(index) = open.pop() {
            let node = self.nodes[index as usize];
            let aabb = node.lattice.aabb(&self.root());
            if !enter(&aabb, (node.axes == 0).then_some(node.first)) || node.axes == 0 {
                continue;
            }
            // The child on the eye's side of each halved axis; others follow by the number of planes between.
            let middle = Lattice::corner(&self.root(), std::array::from_fn(|axis| node.lattice.middle(axis)));
            let halved = (0..3).filter(|axis| node.axes >> axis & 1 == 1);
            let nearest =
                halved.enumerate().fold(0, |near, (bit, axis)| near | u32::from(eye[axis] >= middle[axis]) << bit);
            let children = 1_u32 << node.axes.count_ones();
            for planes in (0..=node.axes.count_ones()).rev() {
                let behind = (0..children).filter(|child| (child ^ nearest).count_ones() == planes);
                open.extend(behind.map(|child| node.first + child));
            }
        }
    }

    fn visit(&self, index: u32, enter: &mut impl FnMut(&Aabb) -> bool, found: &mut impl FnMut(CellId)) {
        let node = self.nodes[index as usize];
        if !enter(&node.lattice.aabb(&self.root)) {
        } else if node.axes == 0 {
            found(node.first);
        } else {
            for child in node.first..node.first + (1 << node.axes.count_ones()) {
                self.visit(child, enter, found);
            }
        }
    }
}

/// The scene's box inflated by a thousandth, or a unit box where there is nothing.
fn root_box(scene: &Scene) -> Aabb {
    let bounds = scene.bounds();
    if bounds.is_empty() {
        return Aabb::around(DVec3::ZERO, DVec3::splat(0.5));
    }
    let reach = bounds.min.abs().max(bounds.max.abs()).max_element();
    bounds.inflated((bounds.size().max_element() * 1e-3).max(1e-3).max(reach * 1e-9))
}

/// Whether a triangle touches a closed box: the separating-axis test over 3 box normals, the triangle's normal and 9
/// cross products (Akenine-Möller 2001), in f64. Zero-area triangles are segments or points and tested as such.
fn touches(corners: &[DVec3; 3], aabb: &Aabb) -> bool {
    let least = corners[0].min(corners[1]).min(corners[2]);
    let greatest = corners[0].max(corners[1]).max(corners[2]);
    if aabb.contains(least) && aabb.contains(greatest) {
        return true;
    }
    if !aabb.intersects(&Aabb::new(least, greatest)) {
        return false;
    }
    let (centre, half) = (aabb.centre(), aabb.size() * 0.5);
    let [a, b, c] = corners.map(|corner| corner - centre);
    let edges = [b - a, c - b, a - c];
    let separates = |axis: DVec3| {
        let along = [a.dot(axis), b.dot(axis), c.dot(axis)];
        // An axis that is rounded badly (a thin triangle's normal) gets slack in proportion to what was cancelled.
        let slack = 1e-14 * axis.abs().dot(a.abs() + b.abs() + c.abs() + half);
        let reach = half.dot(axis.abs()) + slack;
        along.iter().copied().fold(f64::INFINITY, f64::min) > reach
            || along.iter().copied().fold(f64::NEG_INFINITY, f64::max) < -reach
    };
    let normal = edges[0].cross(edges[1]);
    !(separates(normal) || edges.iter().any(|&edge| DVec3::AXES.iter().any(|axis| separates(axis.cross(edge)))))
}

#[cfg(test)]
mod tests {
    use glam::Vec3;
    use rand::{Rng, RngExt, SeedableRng};
    use rand_pcg::Pcg64;

    use super::*;
    use crate::{Sides, Triangle};

    fn triangle(corners: [[f32; 3]; 3]) -> Triangle {
        Triangle { corners: corners.map(Vec3::from_array), sides: Sides::Both, occludes: true }
    }

    fn point_in(rng: &mut impl Rng, reach: f32) -> [f32; 3] {
        std::array::from_fn(|_| rng.random_range(-reach..reach))
    }

    fn soup(seed: u64, count: usize) -> Scene {
        let mut rng = Pcg64::seed_from_u64(seed);
        Scene::from_triangles(
            (0..count)
                .map(|_| {
                    let at = point_in(&mut rng, 10.0);
                    triangle(std::array::from_fn(|_| {
                        let offset = point_in(&mut rng, 1.0);
                        std::array::from_fn(|i| at[i] + offset[i])
                    }))
                })
                .collect(),
        )
    }

    fn small_cells() -> OctreeRules {
        OctreeRules::default().with_max_triangles_per_leaf(8).with_max_depth(6)
    }

    fn check(scene: &Scene, octree: &Octree) {
        // The cells fill the root box.
        let volume = |aabb: &Aabb| aabb.size().element_product();
        let filled: f64 = (0..octree.cell_count() as u32).map(|cell| volume(octree.cell(cell))).sum();
        assert!((filled / volume(&octree.root()) - 1.0).abs() < 1e-9);
        assert_eq!(octree.primitive_total(), scene.triangles().len());
        for cell in 0..octree.cell_count() as u32 {
            assert!(octree.root().contains_box(octree.cell(cell)));
            assert_eq!(octree.cell_at(octree.cell(cell).centre()), Some(cell));
            assert!(octree.primitives(cell).is_sorted_by(|a, b| a < b));
            // Neighbourhood is mutual, exact, and has no duplicates.
            for neighbour in octree.neighbours(cell) {
                assert_eq!(octree.neighbours(cell).iter().filter(|n| n.cell == neighbour.cell).count(), 1);
                let back = octree.neighbours(neighbour.cell).iter().find(|n| n.cell == cell).unwrap();
                assert_eq!(back.face.0, neighbour.face.0 ^ 1);
                let axis = neighbour.face.axis();
                let (here, there) = (octree.cell(cell), octree.cell(neighbour.cell));
                if neighbour.face.is_positive() {
                    assert_eq!(here.max[axis].to_bits(), there.min[axis].to_bits());
                } else {
                    assert_eq!(here.min[axis].to_bits(), there.max[axis].to_bits());
                }
            }
            // Faces are covered by neighbours or lie in the hull.
            for face in Face::ALL {
                let area = |aabb: &Aabb| {
                    let size = aabb.size();
                    size[(face.axis() + 1) % 3] * size[(face.axis() + 2) % 3]
                };
                let here = octree.cell(cell);
                let shared: f64 = octree
                    .neighbours(cell)
                    .iter()
                    .filter(|n| n.face == face)
                    .map(|n| octree.cell(n.cell))
                    .map(|there| area(&Aabb::new(here.min.max(there.min), here.max.min(there.max))))
                    .sum();
                let expected = if octree.hull(face).contains(&cell) { 0.0 } else { area(here) };
                assert!((shared - expected).abs() <= 1e-9 * area(here), "{shared} of {expected}");
            }
        }
    }

    #[test]
    fn cells_fill_the_root_and_know_their_neighbours() {
        for seed in 0..4 {
            let scene = soup(seed, 300);
            let octree = Octree::build(&scene, small_cells());
            assert!(octree.cell_count() > 20);
            check(&scene, &octree);
        }
    }

    #[test]
    fn every_point_of_a_triangle_lies_in_a_cell_that_lists_it() {
        let scene = soup(7, 300);
        let octree = Octree::build(&scene, small_cells());
        let mut rng = Pcg64::seed_from_u64(8);
        for (id, triangle) in scene.triangles().iter().enumerate() {
            for _ in 0..50 {
                let (u, v) = (rng.random::<f64>(), rng.random::<f64>());
                let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
                let [a, b, c] = triangle.corners.map(|corner| corner.as_dvec3());
                let cell = octree.cell_at(a + (b - a) * u + (c - a) * v).unwrap();
                assert!(octree.primitives(cell).contains(&(id as u32)));
            }
        }
    }

    #[test]
    fn a_flat_scene_gets_nearly_cubic_cells() {
        let mut triangles = soup(3, 2000).triangles().to_vec();
        triangles.iter_mut().flat_map(|t| &mut t.corners).for_each(|corner| corner.y *= 0.05);
        let scene = Scene::from_triangles(triangles);
        let octree = Octree::build(&scene, small_cells());
        check(&scene, &octree);
        for cell in 0..octree.cell_count() as u32 {
            let size = octree.cell(cell).size();
            assert!(size.max_element() < 20.0 * size.min_element());
        }
    }

    #[test]
    fn degenerate_scenes_have_cells_too() {
        let empty = Scene::from_triangles(Vec::new());
        let point = Scene::from_triangles(vec![triangle([[1.0, 2.0, 3.0]; 3])]);
        let duplicates = Scene::from_triangles(vec![triangle([[0.; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]); 200]);
        let mut flat = soup(5, 300).triangles().to_vec();
        flat.iter_mut().flat_map(|t| &mut t.corners).for_each(|corner| corner.z = 4.0);
        let far = [[1e6, 1e6, 1e6], [1e6 + 1.0, 1e6, 1e6], [1e6, 1e6 + 1.0, 1e6]];
        let huge = [[-1e30, 0.0, 0.0], [1e30, 0.0, 0.0], [0.0, 1e30, 1.0]];
        for scene in [
            empty,
            point,
            duplicates,
            Scene::from_triangles(flat),
            Scene::from_triangles(vec![triangle(far); 9]),
            Scene::from_triangles(vec![triangle(huge); 9]),
        ] {
            let octree = Octree::build(&scene, small_cells());
            check(&scene, &octree);
            let listed = (0..octree.cell_count() as u32).flat_map(|cell| octree.primitives(cell)).count();
            assert!(listed >= scene.triangles().len());
        }
    }

    #[test]
    fn cells_within_finds_all_cells_that_touch_a_shared_corner() {
        let scene = soup(1, 300);
        let octree = Octree::build(&scene, small_cells());
        let mut found = Vec::new();
        octree.cells_within(octree.root().centre(), 0.0, |cell| found.push(cell));
        let expected: Vec<u32> = (0..octree.cell_count() as u32)
            .filter(|&cell| octree.cell(cell).contains(octree.root().centre()))
            .collect();
        assert_eq!(expected.len(), 8);
        assert_eq!(found, expected);
    }
}
