//! Which piece of space holds which triangles? The Delaunay tessellation of PLP (Klosowski & Silva 2000, §4.3): tetrahedra
//! whose corners are the randomly perturbed centres of an octree's leaves, and the eight corners of the inflated scene box.
//!
//! Sites are small where the scene is dense, so cells are too. The eight corners are moved outward, each along all three
//! axes: then their hull holds the root box whatever the amounts, and no eight of them lie on a sphere. A triangle is
//! listed by every closed cell that it touches, found by a flood from the cell of a corner.
//!
//! The cells are checked after the library has made them: each site is used, each cell is the right way round, they fill
//! their hull once, and the hull holds the root box. What fails is an error, and a traversal can take the octree.

mod file;

use glam::DVec3;
use rustc_hash::FxHashMap;
use simple_delaunay_lib::delaunay_3d::delaunay_struct_3d::DelaunayStructure3D;
use simple_delaunay_lib::delaunay_3d::simplicial_struct_3d::Node;

use crate::tessellation::root_box;
use crate::{Aabb, CellId, Face, Octree, OctreeRules, Scene, Tessellation};

/// How sites are chosen.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct DelaunayRules {
    /// The octree whose leaves' centres are the sites. Default [`OctreeRules::paper`]. Smaller leaves: more cells, which
    /// follow the scene more closely and take longer to build and to walk.
    pub octree: OctreeRules,
    /// How far a centre is moved along each axis, as a share of its leaf's side: from 0 to 0.5, else cut to that. Exact
    /// centres of octree leaves lie on common spheres by the dozen. Default 0.1.
    pub jitter: f64,
    /// Whether leaves at the box's faces have a second site there, near the face. Without these (the paper's way) all that
    /// lies outside the outermost centres is in long cells that end at the eight corners: half a leaf above the ground, say.
    /// Default true.
    pub on_faces: bool,
    /// Decides the perturbation. Default 1.
    pub seed: u64,
}

impl Default for DelaunayRules {
    fn default() -> DelaunayRules {
        DelaunayRules { octree: OctreeRules::paper(), jitter: 0.1, on_faces: true, seed: 1 }
    }
}

impl DelaunayRules {
    /// The rules with another octree.
    pub fn with_octree(self, octree: OctreeRules) -> DelaunayRules {
        DelaunayRules { octree, ..self }
    }

    /// The paper's: no sites but leaves' centres and the corners of the box.
    pub fn paper() -> DelaunayRules {
        DelaunayRules { on_faces: false, ..DelaunayRules::default() }
    }

    /// The rules with another perturbation.
    pub fn with_jitter(self, jitter: f64) -> DelaunayRules {
        DelaunayRules { jitter, ..self }
    }
}

/// Why there are no tetrahedra.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum DelaunayError {
    /// The library gave up.
    #[error("no Delaunay triangulation of {sites} sites: {reason}")]
    Library {
        /// Number of sites.
        sites: usize,
        /// What it said.
        reason: String,
    },
    /// What it made is not a tessellation.
    #[error("the triangulation of {sites} sites is not sound: {fault}")]
    Unsound {
        /// Number of sites.
        sites: usize,
        /// Which check failed.
        fault: &'static str,
    },
}

/// Tetrahedra over a scene. Made once, never changed, shared by all workers.
#[derive(Clone, Debug)]
pub struct Delaunay {
    root: Aabb,
    sites: Vec<DVec3>,
    cells: Vec<Tetrahedron>,
    /// `primitives[starts[c]..starts[c + 1]]` are those of cell c, ascending.
    starts: Vec<u32>,
    primitives: Vec<u32>,
    primitive_total: usize,
    /// Cells with a face in the hull.
    hull: Vec<CellId>,
}

/// One cell. Corner i lies opposite plane i, behind which neighbour i is.
#[derive(Clone, Copy, Debug)]
struct Tetrahedron {
    corners: [u32; 4],
    neighbours: [CellId; 4],
    /// Unit normals that look outward.
    normals: [DVec3; 4],
    /// Heights of the planes along their normals.
    heights: [f64; 4],
}

/// Behind a face of the hull.
const NONE: CellId = CellId::MAX;

impl Delaunay {
    /// Makes the cells of a scene.
    ///
    /// # Errors
    /// If the library gives up or what it makes is not a tessellation; take the octree then.
    pub fn build(scene: &Scene, rules: DelaunayRules) -> Result<Delaunay, DelaunayError> {
        let root = root_box(scene);
        let octree = Octree::build(scene, rules.octree);
        let jitter = if rules.jitter > 0.0 { rules.jitter.min(0.5) } else { 0.0 };
        let mut chance = Chance(rules.seed);
        let mut within = |reach: DVec3| DVec3::from_array(std::array::from_fn(|axis| reach[axis] * chance.signed()));
        let centres = (0..octree.cell_count() as CellId).map(|cell| octree.cell(cell)).map(|aabb| {
            let moved = aabb.centre() + within(aabb.size() * jitter);
            moved.clamp(aabb.min, aabb.max)
        });
        let mut sites: Vec<DVec3> = centres.collect();
        if rules.on_faces {
            for face in Face::ALL {
                for cell in octree.hull(face).iter().map(|&cell| octree.cell(cell)) {
                    let mut site = cell.centre() + within(cell.size() * jitter);
                    let axis = face.axis();
                    let depth = cell.size()[axis] * 0.02 + (site[axis] - cell.centre()[axis]).abs() * 0.2;
                    site[axis] = if face.is_positive() { cell.max[axis] - depth } else { cell.min[axis] + depth };
                    sites.push(site);
                }
            }
        }
        Delaunay::of_sites(scene, root, sites, rules.seed)
    }

    /// Makes the cells of a scene over given sites within its root box.
    fn of_sites(scene: &Scene, root: Aabb, mut sites: Vec<DVec3>, seed: u64) -> Result<Delaunay, DelaunayError> {
        let longest = root.size().max_element();
        let mut chance = Chance(seed ^ 0xC0);
        for corner in root.corners() {
            let outward = (corner - root.centre()).signum();
            let by: [f64; 3] = std::array::from_fn(|_| longest * (0.02 + 0.005 * chance.signed()));
            sites.push(corner + outward * DVec3::from_array(by));
        }
        let mut delaunay = triangulate(root, sites)?;
        delaunay.assign(scene);
        Ok(delaunay)
    }

    /// Lists each triangle in each cell that it touches.
    fn assign(&mut self, scene: &Scene) {
        let slack = 1e-9 * self.root.size().max_element();
        let mut pairs: Vec<(CellId, u32)> = Vec::with_capacity(scene.triangles().len() * 2);
        let mut start = 0;
        let (mut open, mut seen) = (Vec::new(), vec![u32::MAX; self.cells.len()]);
        let mut polygon = Polygon::default();
        for (id, triangle) in (0..).zip(scene.triangles()) {
            let corners = triangle.corners.map(|corner| corner.as_dvec3());
            start = self.walk(start, corners[0]);
            open.push(start);
            seen[start as usize] = id;
            while let Some(cell) = open.pop() {
                if cell != start && !self.touches(cell, &corners, slack, &mut polygon) {
                    continue;
                }
                pairs.push((cell, id));
                let Tetrahedron { neighbours, normals, heights, .. } = &self.cells[cell as usize];
                for face in 0..4 {
                    let next = neighbours[face];
                    let reaches = || corners.iter().any(|&p| normals[face].dot(p) - heights[face] > -slack);
                    if next != NONE && seen[next as usize] != id && reaches() {
                        seen[next as usize] = id;
                        open.push(next);
                    }
                }
            }
        }
        pairs.sort_unstable();
        self.starts = vec![0; self.cells.len() + 1];
        pairs.iter().for_each(|&(cell, _)| self.starts[cell as usize + 1] += 1);
        for cell in 0..self.cells.len() {
            self.starts[cell + 1] += self.starts[cell];
        }
        self.primitives = pairs.into_iter().map(|(_, id)| id).collect();
        self.primitive_total = scene.triangles().len();
    }

    /// Whether a triangle has a point within `slack` of a closed cell: it is cut at the four planes.
    fn touches(&self, cell: CellId, corners: &[DVec3; 3], slack: f64, polygon: &mut Polygon) -> bool {
        let Tetrahedron { normals, heights, .. } = &self.cells[cell as usize];
        polygon.points.clear();
        polygon.points.extend_from_slice(corners);
        (0..4).all(|face| polygon.keep_below(normals[face], heights[face] + slack))
    }

    /// The cell that a point lies in, or the last one on the way to a point outside the hull.
    fn walk(&self, mut cell: CellId, point: DVec3) -> CellId {
        let mut previous = NONE;
        for _ in 0..self.cells.len() {
            let Tetrahedron { neighbours, normals, heights, .. } = &self.cells[cell as usize];
            let height = |face: usize| normals[face].dot(point) - heights[face];
            // Not back: rounding could make two cells each send the walk to the other.
            let leads = |face: &usize| neighbours[*face] != previous && height(*face) > 0.0;
            let most = (0..4).filter(leads).max_by(|&a, &b| height(a).total_cmp(&height(b)));
            let Some(face) = most.filter(|&face| neighbours[face] != NONE) else { return cell };
            previous = cell;
            cell = neighbours[face];
        }
        cell
    }

    /// The cell that contains `point`, or `None` outside the hull. On a shared face, one of the two.
    pub fn cell_at(&self, point: DVec3) -> Option<CellId> {
        let cell = self.walk(0, point);
        let Tetrahedron { neighbours, normals, heights, .. } = &self.cells[cell as usize];
        // The walk ends in front of a face of the hull if the point is outside.
        let is_outside = |face: usize| neighbours[face] == NONE && normals[face].dot(point) > heights[face];
        (point.is_finite() && !(0..4).any(is_outside)).then_some(cell)
    }

    /// The box that the cells more than fill: the scene's, inflated a little.
    pub fn root(&self) -> Aabb {
        self.root
    }

    /// Number of cells.
    pub fn len(&self) -> usize {
        self.cells.len()
    }

    /// Never: the corners of the box make cells.
    pub fn is_empty(&self) -> bool {
        self.cells.is_empty()
    }

    /// The corners of a cell.
    pub fn corners(&self, cell: CellId) -> [DVec3; 4] {
        self.cells[cell as usize].corners.map(|site| self.sites[site as usize])
    }

    /// The triangles that touch a cell, ascending.
    pub fn primitives(&self, cell: CellId) -> &[u32] {
        let cell = cell as usize;
        &self.primitives[self.starts[cell] as usize..self.starts[cell + 1] as usize]
    }

    /// Faces of a cell with a cell behind them: that cell, the face's outward unit normal and its corners.
    pub fn faces(&self, cell: CellId) -> impl Iterator<Item = (CellId, DVec3, [DVec3; 3])> {
        let Tetrahedron { corners, neighbours, normals, .. } = self.cells[cell as usize];
        (0..4).filter(move |&face| neighbours[face] != NONE).map(move |face| {
            let others = std::array::from_fn(|i| self.sites[corners[(face + 1 + i) % 4] as usize]);
            (neighbours[face], normals[face], others)
        })
    }

    /// Cells with a face in the hull that an eye is in front of.
    pub fn hull_facing(&self, eye: DVec3) -> impl Iterator<Item = CellId> {
        let faces = move |cell: &CellId| {
            let Tetrahedron { neighbours, normals, heights, .. } = &self.cells[*cell as usize];
            (0..4).any(|face| neighbours[face] == NONE && normals[face].dot(eye) > heights[face])
        };
        self.hull.iter().copied().filter(faces)
    }

    /// Number of triangles of the scene that the cells were made for.
    pub fn primitive_total(&self) -> usize {
        self.primitive_total
    }

    /// Sum over the cells of the triangles listed.
    pub fn reference_count(&self) -> usize {
        self.primitives.len()
    }

    /// Bytes that the cells and their lists take.
    pub fn memory_bytes(&self) -> usize {
        self.cells.len() * size_of::<Tetrahedron>()
            + self.sites.len() * size_of::<DVec3>()
            + (self.starts.len() + self.primitives.len() + self.hull.len()) * size_of::<u32>()
    }
}

/// Makes and checks the cells, without triangles. The library sees sites in units of the longest side, since its
/// predicates multiply five coordinates.
fn triangulate(root: Aabb, sites: Vec<DVec3>) -> Result<Delaunay, DelaunayError> {
    let count = sites.len();
    let refused = |reason: String| DelaunayError::Library { sites: count, reason };
    let unsound = |fault| DelaunayError::Unsound { sites: count, fault };
    // The library does not end on sites that it cannot tell apart.
    let longest = root.size().max_element();
    let unit: Vec<[f64; 3]> = sites.iter().map(|site| ((*site - root.min) / longest).to_array()).collect();
    let mut places = unit.clone();
    places.sort_unstable_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])).then(a[2].total_cmp(&b[2])));
    if places.windows(2).any(|pair| pair[0] == pair[1]) {
        return Err(unsound("two sites are one"));
    }
    let mut made = DelaunayStructure3D::new();
    made.insert_vertices(&unit, true).map_err(|error| refused(error.to_string()))?;
    let simplices = made.get_simplicial();
    let mut cells = Vec::with_capacity(simplices.get_nb_tetrahedra());
    // The other cell and face of each face that has one side so far.
    let mut faces: FxHashMap<[u32; 3], (CellId, usize)> = FxHashMap::default();
    let (mut used, mut volume) = (vec![false; count], 0.0);
    for index in 0..simplices.get_nb_tetrahedra() {
        let nodes = simplices.get_tetrahedron(index).map_err(|error| refused(error.to_string()))?.nodes();
        let finite = |node: &Node| if let Node::Value(site) = node { Some(*site as u32) } else { None };
        let [Some(a), Some(b), Some(c), Some(d)] = nodes.each_ref().map(finite) else { continue };
        let mut corners = [a, b, c, d];
        corners.iter().for_each(|&site| used[site as usize] = true);
        // One order of corners, so that the same sites give the same cells to the last bit.
        corners.sort_unstable();
        let at = corners.map(|site| sites[site as usize]);
        let six = (at[1] - at[0]).dot((at[2] - at[0]).cross(at[3] - at[0])).abs();
        volume += six;
        let (mut normals, mut heights) = ([DVec3::ZERO; 4], [0.0; 4]);
        for face in 0..4 {
            let [p, q, r] = std::array::from_fn(|i| at[(face + 1 + i) % 4]);
            let normal = (q - p).cross(r - p).normalize_or_zero();
            let outward = if normal.dot(at[face] - p) > 0.0 { -normal } else { normal };
            if outward == DVec3::ZERO {
                return Err(unsound("a face has no area"));
            }
            (normals[face], heights[face]) = (outward, outward.dot(p));
        }
        cells.push(Tetrahedron { corners, neighbours: [NONE; 4], normals, heights });
        let cell = cells.len() as CellId - 1;
        for face in 0..4 {
            let mut key: [u32; 3] = std::array::from_fn(|i| corners[(face + 1 + i) % 4]);
            key.sort_unstable();
            match faces.remove(&key) {
                Some((other, its)) => {
                    cells[cell as usize].neighbours[face] = other;
                    cells[other as usize].neighbours[its] = cell;
                }
                None => drop(faces.insert(key, (cell, face))),
            }
        }
    }
    if !used.iter().all(|used| *used) {
        return Err(unsound("a site is in no cell"));
    }
    // What is left are the faces of the hull: it must be convex around the root box, and filled exactly once.
    let mut hull: Vec<CellId> = Vec::new();
    let mut enclosed = 0.0;
    for &(cell, face) in faces.values() {
        let Tetrahedron { corners, normals, heights, .. } = cells[cell as usize];
        if root.corners().iter().any(|corner| normals[face].dot(*corner) > heights[face]) {
            return Err(unsound("the hull does not hold the scene's box"));
        }
        let [p, q, r] = std::array::from_fn(|i| sites[corners[(face + 1 + i) % 4] as usize]);
        enclosed += (q - p).cross(r - p).length() * (heights[face] - normals[face].dot(root.centre()));
        hull.push(cell);
    }
    hull.sort_unstable();
    hull.dedup();
    // Volumes that are not finite fail too.
    let fill_once = (volume / enclosed - 1.0).abs() < 1e-6;
    if !fill_once {
        return Err(unsound("the cells do not fill their hull once"));
    }
    let starts = vec![0; cells.len() + 1];
    Ok(Delaunay { root, sites, cells, starts, primitives: Vec::new(), primitive_total: 0, hull })
}

/// A convex polygon that is being cut.
#[derive(Default)]
pub(crate) struct Polygon {
    pub(crate) points: Vec<DVec3>,
    spare: Vec<DVec3>,
}

impl Polygon {
    /// Cuts off what is higher along a normal; whether anything is left.
    pub(crate) fn keep_below(&mut self, normal: DVec3, height: f64) -> bool {
        let above = |point: DVec3| normal.dot(point) - height;
        if self.points.iter().all(|&point| above(point) <= 0.0) {
            return true;
        }
        self.spare.clear();
        for (i, &here) in self.points.iter().enumerate() {
            let next = self.points[(i + 1) % self.points.len()];
            let (h, n) = (above(here), above(next));
            if h <= 0.0 {
                self.spare.push(here);
            }
            if (h <= 0.0) != (n <= 0.0) {
                self.spare.push(here + (next - here) * (h / (h - n)));
            }
        }
        std::mem::swap(&mut self.points, &mut self.spare);
        !self.points.is_empty()
    }
}

/// A sequence that a seed decides: SplitMix64, so that no generator is needed outside tests.
struct Chance(u64);

impl Chance {
    /// From −1 to 1.
    fn signed(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut mixed = self.0;
        mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        mixed ^= mixed >> 31;
        (mixed >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64;

    use super::*;
    use crate::tessellation::laws::{grid, poor_scenes, soup};

    fn small() -> DelaunayRules {
        DelaunayRules::default().with_octree(OctreeRules::paper().with_leaf_side(0.3))
    }

    fn holds(delaunay: &Delaunay, cell: CellId, point: DVec3, slack: f64) -> bool {
        let Tetrahedron { normals, heights, .. } = &delaunay.cells[cell as usize];
        (0..4).all(|face| normals[face].dot(point) <= heights[face] + slack)
    }

    #[test]
    fn every_point_of_a_triangle_lies_in_a_cell_that_lists_it() {
        let scene = soup(7, 150);
        for rules in [small(), DelaunayRules { on_faces: false, ..small() }] {
            let delaunay = Delaunay::build(&scene, rules).unwrap();
            assert!(delaunay.len() > 100, "{}", delaunay.len());
            let mut chance = Pcg64::seed_from_u64(8);
            let mut held = 0;
            for (id, triangle) in (0..).zip(scene.triangles()) {
                let [a, b, c] = triangle.corners.map(|corner| corner.as_dvec3());
                for _ in 0..5 {
                    let (u, v) = (chance.random::<f64>(), chance.random::<f64>());
                    let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
                    let point = a + (b - a) * u + (c - a) * v;
                    let cell = delaunay.cell_at(point).unwrap();
                    assert!(holds(&delaunay, cell, point, 1e-9));
                    assert!(delaunay.primitives(cell).contains(&id));
                    held += 1;
                }
            }
            assert_eq!(held, 750);
            let listed = |cell: CellId| delaunay.primitives(cell).is_sorted_by(|a, b| a < b);
            assert!((0..delaunay.len() as CellId).all(listed));
            // Cells far from all triangles list none: assignment is not everything to everyone.
            assert!(delaunay.reference_count() < 150 * 40, "{}", delaunay.reference_count());
        }
    }

    #[test]
    fn neighbours_are_mutual_and_no_site_is_inside_a_circumscribed_sphere() {
        let delaunay = Delaunay::build(&soup(2, 100), small()).unwrap();
        for cell in 0..delaunay.len() as CellId {
            for (neighbour, normal, _) in delaunay.faces(cell) {
                let back = delaunay.faces(neighbour).find(|(other, ..)| *other == cell).unwrap();
                assert!((back.1 + normal).length() < 1e-9);
            }
            let [a, b, c, d] = delaunay.corners(cell);
            let (b, c, d) = (b - a, c - a, d - a);
            let twice = 2.0 * b.dot(c.cross(d));
            let centre =
                (c.cross(d) * b.length_squared() + d.cross(b) * c.length_squared() + b.cross(c) * d.length_squared())
                    / twice;
            let radius = centre.length();
            assert!(delaunay.sites.iter().all(|site| (site - a).distance(centre) > radius * (1.0 - 1e-6)));
        }
    }

    #[test]
    fn the_same_seed_gives_the_same_cells() {
        let scene = soup(3, 100);
        let corners = |seed| {
            let delaunay = Delaunay::build(&scene, DelaunayRules { seed, ..small() }).unwrap();
            (0..delaunay.len() as CellId).map(|cell| delaunay.corners(cell)).collect::<Vec<_>>()
        };
        assert_eq!(corners(1), corners(1));
        assert_ne!(corners(1), corners(2));
    }

    #[test]
    fn degenerate_scenes_have_cells_or_an_error() {
        for scene in poor_scenes() {
            let delaunay = Delaunay::build(&scene, small()).unwrap();
            assert!(delaunay.reference_count() >= scene.triangles().len());
            let middle = delaunay.root().centre();
            assert!(holds(&delaunay, delaunay.cell_at(middle).unwrap(), middle, 1e-9 * middle.length().max(1e3)));
            assert_eq!(delaunay.cell_at(delaunay.root().max + delaunay.root().size()), None);
            assert_eq!(delaunay.cell_at(DVec3::NAN), None);
        }
    }

    /// No perturbation at all: centres of leaves lie on common spheres by the dozen, and on faces in planes.
    #[test]
    fn sites_on_common_spheres_and_planes_make_cells_or_are_refused_by_name() {
        let mut made = 0;
        for scene in [soup(5, 100), grid(4)] {
            for on_faces in [false, true] {
                match Delaunay::build(&scene, DelaunayRules { on_faces, ..small().with_jitter(0.0) }) {
                    Ok(delaunay) => {
                        made += 1;
                        assert!(delaunay.reference_count() >= scene.triangles().len());
                        for triangle in scene.triangles() {
                            let corner = triangle.corners[0].as_dvec3();
                            assert!(holds(&delaunay, delaunay.cell_at(corner).unwrap(), corner, 1e-9));
                        }
                    }
                    Err(error) => assert!(error.to_string().contains("sites"), "{error}"),
                }
            }
        }
        assert!(made > 0);
    }

    #[test]
    fn one_site_and_the_same_site_twice_are_used_or_refused_by_name() {
        let (root, scene) = (Aabb::around(DVec3::ZERO, DVec3::ONE), soup(1, 0));
        let one = Delaunay::of_sites(&scene, root, vec![DVec3::new(0.1, 0.2, 0.3)], 1).unwrap();
        assert!(one.len() >= 8 && one.cell_at(DVec3::ZERO).is_some());
        let none = Delaunay::of_sites(&scene, root, Vec::new(), 1).unwrap();
        assert!(none.len() >= 5 && none.cell_at(DVec3::ZERO).is_some());
        let twice = Delaunay::of_sites(&scene, root, vec![DVec3::X * 0.5; 2], 1).unwrap_err();
        assert_eq!(twice, DelaunayError::Unsound { sites: 10, fault: "two sites are one" });
    }

    #[test]
    fn four_points_in_a_plane_and_duplicates_are_refused_or_used() {
        let root = Aabb::around(DVec3::ZERO, DVec3::ONE);
        let scene = soup(1, 0);
        for sites in
            [vec![DVec3::ZERO; 5], vec![DVec3::ZERO, DVec3::X * 0.5, DVec3::Y * 0.5, DVec3::new(0.5, 0.5, 0.0)]]
        {
            match Delaunay::of_sites(&scene, root, sites, 1) {
                Ok(delaunay) => assert!(delaunay.len() >= 5),
                Err(error) => assert!(error.to_string().contains("sites")),
            }
        }
    }
}
