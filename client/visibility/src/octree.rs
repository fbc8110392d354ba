//! Which piece of space holds which triangles? The octree tessellation of PLP and cPLP (Klosowski & Silva 2000, §4.3).
//!
//! Only the leaves count: they are the *cells*, closed boxes that fill the root box without overlap, each with the
//! triangles that touch it and the cells that share a face with it. An axis is halved only while it is about as long
//! as the longest, so that the cells of a flat building are nearly cubes too. Cell corners lie on one integer lattice, so
//! that neighbours agree on their shared faces to the last bit.

mod file;

use glam::DVec3;

use crate::tessellation::{root_box, rounding_slack, touches};
use crate::{Aabb, CellId, Cells, Face, Neighbour, Scene, Tessellation};

/// When a cell is split: by counts of triangles or, as in the papers, by vertices down to a size. Any value is legal; a zero
/// counts as one triangle, and depth is cut to 20.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct OctreeRules {
    /// A cell with more triangles is split. Fewer: finer culling, more queries. Default 64.
    pub max_triangles_per_leaf: usize,
    /// Greatest number of splits above a cell. Default 10: cells of a 100 m scene are no smaller than 0.1 m.
    pub max_depth: u32,
    /// If above 0, triangles are not counted: a cell is split while it holds a triangle's corner and its longest side is at
    /// least this share of the root's. Default 0.
    pub leaf_side: f64,
}

impl Default for OctreeRules {
    fn default() -> OctreeRules {
        OctreeRules { max_triangles_per_leaf: 64, max_depth: 10, leaf_side: 0.0 }
    }
}

impl OctreeRules {
    /// "Once an octree node has a side shorter than 5 percent of the length of the bounding box, it is considered a leaf"
    /// (Klosowski & Silva 2000, §4.3).
    pub fn paper() -> OctreeRules {
        OctreeRules { max_depth: 20, leaf_side: 0.05, ..OctreeRules::default() }
    }

    /// The rules with another size of leaves.
    pub fn with_leaf_side(self, leaf_side: f64) -> OctreeRules {
        OctreeRules { leaf_side, ..self }
    }

    /// The rules with another limit of triangles.
    pub fn with_max_triangles_per_leaf(self, max_triangles_per_leaf: usize) -> OctreeRules {
        OctreeRules { max_triangles_per_leaf, ..self }
    }

    /// The rules with another limit of depth.
    pub fn with_max_depth(self, max_depth: u32) -> OctreeRules {
        OctreeRules { max_depth, ..self }
    }
}

/// The leaves of an octree over a scene. Made once, never changed, shared by all workers.
#[derive(Clone, Debug)]
pub struct Octree {
    nodes: Vec<Node>,
    cells: Cells,
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
        let slack = rounding_slack(&root);
        let whole = Lattice { min: [0; 3], max: [LATTICE_STEPS; 3] };
        let mut octree = Octree {
            nodes: vec![Node { lattice: whole, first: 0, axes: 0 }],
            cells: Cells::new(root, 0.0, scene.triangles().len()),
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
                octree.nodes[node].first = octree.cells.push(octree.nodes[node].lattice.aabb(&root), &primitives);
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
        let by_size = rules.leaf_side > 0.0;
        if depth >= rules.max_depth.min(20) || (!by_size && primitives.len() <= rules.max_triangles_per_leaf.max(1)) {
            return None;
        }
        let lattice = self.nodes[node].lattice;
        let aabb = lattice.aabb(&self.cells.root());
        let size = aabb.size();
        if by_size {
            let holds_corner = |id: &u32| {
                scene.triangles()[*id as usize].corners.iter().any(|corner| aabb.contains(corner.as_dvec3()))
            };
            let least = rules.leaf_side * self.cells.root().size().max_element();
            if size.max_element() < least || !primitives.iter().any(holds_corner) {
                return None;
            }
        }
        let axes = (0..3).fold(0, |axes, axis| axes | u8::from(size[axis] > 0.6 * size.max_element()) << axis);
        let parts: Vec<Vec<u32>> = (0..1_u32 << axes.count_ones())
            .map(|index| {
                let aabb = lattice.child(axes, index).aabb(&self.cells.root()).inflated(slack);
                let touches = |id: &u32| touches(&scene.triangles()[*id as usize].corners.map(|c| c.as_dvec3()), &aabb);
                primitives.iter().copied().filter(touches).collect()
            })
            .collect();
        // Where every child would hold everything (duplicates, a common vertex in the middle), depth buys nothing.
        (by_size || parts.iter().any(|part| part.len() < primitives.len())).then_some((axes, parts))
    }

    /// Finds the neighbours of each cell, and the cells of each hull face.
    fn link(&mut self) {
        let mut lattices = vec![self.nodes[0].lattice; self.cells.len()];
        for node in self.nodes.iter().filter(|node| node.axes == 0) {
            lattices[node.first as usize] = node.lattice;
        }
        for lattice in &lattices {
            let mut neighbours = Vec::new();
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
                        neighbours.push(Neighbour::open(node.first, face));
                    }
                }
            }
            self.cells.push_neighbours(neighbours);
        }
        self.cells.find_hull();
    }

    fn visit(&self, index: u32, enter: &impl Fn(&Aabb) -> bool, found: &mut dyn FnMut(CellId)) {
        let node = self.nodes[index as usize];
        if !enter(&node.lattice.aabb(&self.cells.root())) {
        } else if node.axes == 0 {
            found(node.first);
        } else {
            for child in node.first..node.first + (1 << node.axes.count_ones()) {
                self.visit(child, enter, found);
            }
        }
    }
}

impl Tessellation for Octree {
    fn cells(&self) -> &Cells {
        &self.cells
    }

    fn cell_at(&self, point: DVec3) -> Option<CellId> {
        let root = self.cells.root();
        if !root.contains(point) {
            return None;
        }
        let mut node = self.nodes[0];
        while node.axes != 0 {
            let middle = Lattice::corner(&root, std::array::from_fn(|axis| node.lattice.middle(axis)));
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

    fn cells_within(&self, point: DVec3, radius: f64, found: &mut dyn FnMut(CellId)) {
        self.visit(0, &|aabb| aabb.distance(point) <= radius, found);
    }
}

impl Octree {
    /// Walks the nodes from the one nearest to `eye` on, so that none comes after one that it can hide. `enter` is told a
    /// node's closed box and, for a leaf, its cell; children are visited only where it returns true.
    pub(crate) fn front_to_back(&self, eye: DVec3, mut enter: impl FnMut(&Aabb, Option<CellId>) -> bool) {
        let mut open = vec![Octree::ROOT];
        while let Some(node) = open.pop() {
            let (aabb, leaf) = self.node(node);
            if enter(&aabb, leaf) {
                self.push_children(node, eye, &mut open);
            }
        }
    }

    /// The node of everything.
    pub(crate) const ROOT: u32 = 0;

    /// A node's closed box and, for a leaf, its cell.
    pub(crate) fn node(&self, node: u32) -> (Aabb, Option<CellId>) {
        let Node { lattice, first, axes } = self.nodes[node as usize];
        (lattice.aabb(&self.cells.root()), (axes == 0).then_some(first))
    }

    /// Appends a node's children, the one nearest to `eye` last.
    pub(crate) fn push_children(&self, node: u32, eye: DVec3, open: &mut Vec<u32>) {
        let Node { lattice, first, axes } = self.nodes[node as usize];
        if axes == 0 {
            return;
        }
        // The child on the eye's side of each halved axis; others follow by the number of planes between.
        let middle = Lattice::corner(&self.cells.root(), std::array::from_fn(|axis| lattice.middle(axis)));
        let halved = (0..3).filter(|axis| axes >> axis & 1 == 1);
        let nearest =
            halved.enumerate().fold(0, |near, (bit, axis)| near | u32::from(eye[axis] >= middle[axis]) << bit);
        let children = 1_u32 << axes.count_ones();
        for planes in (0..=axes.count_ones()).rev() {
            let behind = (0..children).filter(|child| (child ^ nearest).count_ones() == planes);
            open.extend(behind.map(|child| first + child));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tessellation::laws::{
        check, check_cells_within, check_points_of_triangles_are_listed, poor_scenes, soup,
    };

    fn small_cells() -> OctreeRules {
        OctreeRules::default().with_max_triangles_per_leaf(8).with_max_depth(6)
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
        check_points_of_triangles_are_listed(&scene, &Octree::build(&scene, small_cells()), 8);
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
        for scene in poor_scenes() {
            for rules in [small_cells(), OctreeRules::paper()] {
                let octree = Octree::build(&scene, rules);
                check(&scene, &octree);
                assert!(octree.cells().reference_count() >= scene.triangles().len());
            }
        }
    }

    #[test]
    fn by_size_cells_with_corners_are_small_and_others_are_not_split() {
        let scene = soup(9, 12);
        let octree = Octree::build(&scene, OctreeRules::paper().with_leaf_side(0.1));
        check(&scene, &octree);
        let least = 0.1 * octree.root().size().max_element();
        let mut large = 0;
        for cell in 0..octree.cell_count() as u32 {
            let (aabb, side) = (octree.cell(cell), octree.cell(cell).size().max_element());
            let holds = scene.triangles().iter().flat_map(|t| t.corners).any(|corner| aabb.contains(corner.as_dvec3()));
            assert!(side > 0.5 * least && (!holds || side < least), "{side}");
            large += u32::from(side >= least);
        }
        assert!(large > 10);
    }

    #[test]
    fn cells_within_finds_all_cells_that_touch_a_shared_corner() {
        let scene = soup(1, 300);
        let octree = Octree::build(&scene, small_cells());
        assert_eq!(check_cells_within(&octree, octree.root().centre(), 0.0), 8);
        check_cells_within(&octree, octree.root().centre(), 2.5);
    }
}
