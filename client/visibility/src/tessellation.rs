//! What is a tessellation? Closed boxes (cells) that fill a root box without overlap, each with the triangles that touch it
//! and the cells that share a face with it (Klosowski & Silva 2000, §3.1).
//!
//! How the boxes are found is the affair of [`crate::Octree`] and [`crate::KdTree`]; both leave a [`Cells`] behind, which
//! is all that a traversal reads beside "which cells are here". Neighbours agree on their shared faces to the last bit.

mod file;

use std::fmt::Debug;

use glam::DVec3;

use crate::{Aabb, Scene, SealedFace};

/// Number of a cell in its tessellation.
pub type CellId = u32;

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

    /// The face on the other side of the box, through which one comes back.
    pub const fn opposite(self) -> Face {
        Face(self.0 ^ 1)
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
    /// Number of the seal that closes the way there, or `NONE`. The way back has its own.
    pub(crate) seal: u32,
}

impl Neighbour {
    pub(crate) const UNSEALED: u32 = u32::MAX;

    pub(crate) const fn open(cell: CellId, face: Face) -> Neighbour {
        Neighbour { cell, face, seal: Neighbour::UNSEALED }
    }

    /// Whether opaque triangles cover all that the two cells share, for whoever looks in this direction.
    pub const fn is_sealed(self) -> bool {
        self.seal != Neighbour::UNSEALED
    }
}

/// The closed boxes of a tessellation. Made once, never changed, shared by all workers.
#[derive(Clone, Debug)]
pub struct Cells {
    root: Aabb,
    boxes: Vec<Aabb>,
    /// How far outside a cell a triangle may be and still be listed.
    skin: f64,
    /// `primitives[primitive_starts[c]..primitive_starts[c + 1]]` are those of cell c, ascending; likewise below.
    primitive_starts: Vec<u32>,
    primitives: Vec<u32>,
    neighbour_starts: Vec<u32>,
    neighbours: Vec<Neighbour>,
    /// Where cells are not boxes: around what a cell shares with each of its neighbours.
    shared: Option<Vec<Aabb>>,
    crack_starts: Vec<u32>,
    cracks: Vec<[DVec3; 2]>,
    hull_starts: [u32; 7],
    hull: Vec<CellId>,
    primitives_max: usize,
    primitive_total: usize,
}

impl Cells {
    /// No cells yet, in a root box around `primitive_total` triangles.
    pub(crate) fn new(root: Aabb, skin: f64, primitive_total: usize) -> Cells {
        Cells {
            root,
            boxes: Vec::new(),
            skin,
            primitive_starts: vec![0],
            primitives: Vec::new(),
            neighbour_starts: vec![0],
            neighbours: Vec::new(),
            shared: None,
            crack_starts: vec![0],
            cracks: Vec::new(),
            hull_starts: [0; 7],
            hull: Vec::new(),
            primitives_max: 0,
            primitive_total,
        }
    }

    /// Adds a cell with the triangles that touch it, ascending.
    pub(crate) fn push(&mut self, aabb: Aabb, primitives: &[u32]) -> CellId {
        self.boxes.push(aabb);
        self.primitives_max = self.primitives_max.max(primitives.len());
        self.primitives.extend_from_slice(primitives);
        self.primitive_starts.push(self.primitives.len() as u32);
        self.boxes.len() as u32 - 1
    }

    /// Gives the cells their neighbours, to be called for each cell in order.
    pub(crate) fn push_neighbours(&mut self, neighbours: impl IntoIterator<Item = Neighbour>) {
        self.neighbours.extend(neighbours);
        self.neighbour_starts.push(self.neighbours.len() as u32);
    }

    /// The same for cells that are not boxes, with a box around what is shared with each.
    pub(crate) fn push_neighbours_sharing(&mut self, neighbours: impl IntoIterator<Item = (Neighbour, Aabb)>) {
        let boxes = self.shared.get_or_insert_default();
        for (neighbour, shared) in neighbours {
            self.neighbours.push(neighbour);
            boxes.push(shared);
        }
        self.neighbour_starts.push(self.neighbours.len() as u32);
    }

    /// Whether the cells are boxes. Else [`Cells::aabb`] is the box around one, and [`Cells::shared`] that around a face.
    pub fn are_boxes(&self) -> bool {
        self.shared.is_none()
    }

    /// Bytes that the cells and their lists take.
    pub fn memory_bytes(&self) -> usize {
        size_of_val(&*self.boxes)
            + size_of_val(&*self.primitive_starts)
            + size_of_val(&*self.primitives)
            + size_of_val(&*self.neighbour_starts)
            + size_of_val(&*self.neighbours)
            + self.shared.as_ref().map_or(0, |shared| size_of_val(&**shared))
            + size_of_val(&*self.crack_starts)
            + size_of_val(&*self.cracks)
            + size_of_val(&*self.hull)
    }

    /// Finds the cells of each hull face, once all cells are there.
    pub(crate) fn find_hull(&mut self) {
        for face in Face::ALL {
            let axis = face.axis();
            let outer = |aabb: &Aabb| {
                if face.is_positive() {
                    aabb.max[axis] == self.root.max[axis]
                } else {
                    aabb.min[axis] == self.root.min[axis]
                }
            };
            self.hull.extend((0..).zip(&self.boxes).filter_map(|(cell, aabb)| outer(aabb).then_some(cell)));
            self.hull_starts[face.0 as usize + 1] = self.hull.len() as u32;
        }
    }

    /// Seals the way to a neighbour of a cell, with the cracks of the seal.
    pub(crate) fn set_seal(&mut self, cell: CellId, nth_neighbour: usize, cracks: &[[DVec3; 2]]) {
        let neighbour = self.neighbour_starts[cell as usize] as usize + nth_neighbour;
        self.neighbours[neighbour].seal = self.crack_starts.len() as u32 - 1;
        self.cracks.extend_from_slice(cracks);
        self.crack_starts.push(self.cracks.len() as u32);
    }

    /// What seals the way from a cell to a neighbour, if anything does.
    pub fn seal(&self, cell: CellId, neighbour: &Neighbour) -> Option<SealedFace<'_>> {
        let seal = neighbour.is_sealed().then_some(neighbour.seal as usize)?;
        Some(SealedFace {
            rectangle: self.shared(cell, neighbour),
            face: neighbour.face,
            cracks: &self.cracks[self.crack_starts[seal] as usize..self.crack_starts[seal + 1] as usize],
            skin: self.skin,
        })
    }

    /// The box that the cells fill: the scene's box, inflated a little so that no triangle lies on the hull (condition (a) of
    /// DESIGN.md §4).
    pub fn root(&self) -> Aabb {
        self.root
    }

    /// Number of cells, at least 1.
    pub fn len(&self) -> usize {
        self.boxes.len()
    }

    /// Never: the root box is at least one cell.
    pub fn is_empty(&self) -> bool {
        self.boxes.is_empty()
    }

    /// The closed box of a cell.
    pub fn aabb(&self, cell: CellId) -> &Aabb {
        &self.boxes[cell as usize]
    }

    /// Metres: a cell lists each triangle that touches its box grown by this. 0 means a slack for rounding only.
    pub fn skin(&self) -> f64 {
        self.skin
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

    /// The rectangle that a cell shares with a neighbour: a box without thickness along the face's axis. Where cells are not
    /// boxes ([`Cells::are_boxes`]) it is the box around the face, which has some thickness if the face is oblique.
    pub fn shared(&self, cell: CellId, neighbour: &Neighbour) -> Aabb {
        if let Some(shared) = &self.shared {
            let nth = self.neighbours(cell).iter().position(|other| other.cell == neighbour.cell).unwrap_or(0);
            return shared[self.neighbour_starts[cell as usize] as usize + nth];
        }
        let (here, there) = (self.aabb(cell), self.aabb(neighbour.cell));
        Aabb::new(here.min.max(there.min), here.max.min(there.max))
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

    /// Number of triangles of the scene that the cells were made for.
    pub fn primitive_total(&self) -> usize {
        self.primitive_total
    }

    /// Sum over the cells of the triangles listed: what memory and drawing grow with.
    pub fn reference_count(&self) -> usize {
        self.primitives.len()
    }
}

/// Cells, and where they are. Everything but the two searches is read from [`Cells`].
pub trait Tessellation: Debug + Send + Sync {
    /// The cells.
    fn cells(&self) -> &Cells;

    /// The cell that contains `point`, or `None` outside the root box. On a shared face, the one with greater coordinates.
    fn cell_at(&self, point: DVec3) -> Option<CellId>;

    /// Calls `found` for each closed cell within `radius` of `point`, each once.
    fn cells_within(&self, point: DVec3, radius: f64, found: &mut dyn FnMut(CellId));

    /// [`Cells::root`].
    fn root(&self) -> Aabb {
        self.cells().root()
    }

    /// [`Cells::len`].
    fn cell_count(&self) -> usize {
        self.cells().len()
    }

    /// [`Cells::aabb`]: the box around a cell.
    fn cell(&self, cell: CellId) -> &Aabb {
        self.cells().aabb(cell)
    }

    /// [`Cells::primitives`].
    fn primitives(&self, cell: CellId) -> &[u32] {
        self.cells().primitives(cell)
    }

    /// [`Cells::neighbours`].
    fn neighbours(&self, cell: CellId) -> &[Neighbour] {
        self.cells().neighbours(cell)
    }

    /// [`Cells::hull`].
    fn hull(&self, face: Face) -> &[CellId] {
        self.cells().hull(face)
    }

    /// [`Cells::primitives_max`].
    fn primitives_max(&self) -> usize {
        self.cells().primitives_max()
    }

    /// [`Cells::primitive_total`].
    fn primitive_total(&self) -> usize {
        self.cells().primitive_total()
    }
}

/// The scene's box inflated by a thousandth, or a unit box where there is nothing.
pub(crate) fn root_box(scene: &Scene) -> Aabb {
    let bounds = scene.bounds();
    if bounds.is_empty() {
        return Aabb::around(DVec3::ZERO, DVec3::splat(0.5));
    }
    let reach = bounds.min.abs().max(bounds.max.abs()).max_element();
    bounds.inflated((bounds.size().max_element() * 1e-3).max(1e-3).max(reach * 1e-9))
}

/// Metres by which a cell is grown before [`touches`] is asked, so that the rounding of its products loses nothing. Too many
/// triangles in a cell are harmless.
pub(crate) fn rounding_slack(root: &Aabb) -> f64 {
    1e-12 * root.min.abs().max(root.max.abs()).max_element()
}

/// Whether a triangle touches a closed box: the separating-axis test over 3 box normals, the triangle's normal and 9
/// cross products (Akenine-Möller 2001), in f64. Zero-area triangles are segments or points and tested as such.
pub(crate) fn touches(corners: &[DVec3; 3], aabb: &Aabb) -> bool {
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

/// What every tessellation must satisfy, for the tests of each.
#[cfg(test)]
pub(crate) mod laws {
    use glam::Vec3;
    use rand::{Rng, RngExt, SeedableRng};
    use rand_pcg::Pcg64;

    use super::*;
    use crate::{Sides, Triangle};

    pub fn triangle(corners: [[f32; 3]; 3]) -> Triangle {
        Triangle { corners: corners.map(Vec3::from_array), sides: Sides::Both, occludes: true }
    }

    fn point_in(rng: &mut impl Rng, reach: f32) -> [f32; 3] {
        std::array::from_fn(|_| rng.random_range(-reach..reach))
    }

    pub fn soup(seed: u64, count: usize) -> Scene {
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

    /// Small triangles at the corners of a cubic grid of `side`³: whatever is made from their places lies on common spheres by the
    /// dozen.
    pub fn grid(side: u32) -> Scene {
        let at = |i: u32| [i % side, i / side % side, i / (side * side)].map(|at| at as f32);
        let small = |[x, y, z]: [f32; 3]| triangle([[x, y, z], [x + 0.1, y, z], [x, y + 0.1, z]]);
        Scene::from_triangles((0..side.pow(3)).map(at).map(small).collect())
    }

    /// Scenes that are hardly scenes: empty, a point, duplicates, flat in every way, in a line, on a sphere, a grid, far away, huge.
    pub fn poor_scenes() -> Vec<Scene> {
        let moved = |count: usize, by: &dyn Fn(Vec3) -> Vec3| {
            let mut triangles = soup(5, count).triangles().to_vec();
            triangles.iter_mut().flat_map(|t| &mut t.corners).for_each(|corner| *corner = by(*corner));
            Scene::from_triangles(triangles)
        };
        let far = [[1e6, 1e6, 1e6], [1e6 + 1.0, 1e6, 1e6], [1e6, 1e6 + 1.0, 1e6]];
        let huge = [[-1e30, 0.0, 0.0], [1e30, 0.0, 0.0], [0.0, 1e30, 1.0]];
        vec![
            Scene::from_triangles(Vec::new()),
            Scene::from_triangles(vec![triangle([[1.0, 2.0, 3.0]; 3])]),
            Scene::from_triangles(vec![triangle([[0.; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]); 200]),
            moved(300, &|at| Vec3 { z: 4.0, ..at }),
            moved(100, &|at| Vec3 { x: -1.0, ..at }),
            moved(100, &|at| Vec3 { y: 0.0, ..at }),
            moved(60, &|at| Vec3 { z: -at.x - at.y, ..at }),
            moved(60, &|at| Vec3::new(1.0, 2.0, -1.0) * at.x),
            moved(60, &|at| at.normalize_or(Vec3::X) * 5.0),
            grid(4),
            Scene::from_triangles(vec![triangle(far); 9]),
            Scene::from_triangles(vec![triangle(huge); 9]),
        ]
    }

    pub fn check(scene: &Scene, tessellation: &dyn Tessellation) {
        // The cells fill the root box.
        let volume = |aabb: &Aabb| aabb.size().element_product();
        let cell_ids = || 0..tessellation.cell_count() as u32;
        let filled: f64 = cell_ids().map(|cell| volume(tessellation.cell(cell))).sum();
        assert!((filled / volume(&tessellation.root()) - 1.0).abs() < 1e-9);
        assert_eq!(tessellation.primitive_total(), scene.triangles().len());
        for cell in cell_ids() {
            assert!(tessellation.root().contains_box(tessellation.cell(cell)));
            assert_eq!(tessellation.cell_at(tessellation.cell(cell).centre()), Some(cell));
            assert!(tessellation.primitives(cell).is_sorted_by(|a, b| a < b));
            // Neighbourhood is mutual, exact, and has no duplicates.
            for neighbour in tessellation.neighbours(cell) {
                let count = tessellation.neighbours(cell).iter().filter(|n| n.cell == neighbour.cell).count();
                assert_eq!(count, 1);
                let back = tessellation.neighbours(neighbour.cell).iter().find(|n| n.cell == cell).unwrap();
                assert_eq!(back.face, neighbour.face.opposite());
                let axis = neighbour.face.axis();
                let (here, there) = (tessellation.cell(cell), tessellation.cell(neighbour.cell));
                if neighbour.face.is_positive() {
                    assert_eq!(here.max[axis].to_bits(), there.min[axis].to_bits());
                } else {
                    assert_eq!(here.min[axis].to_bits(), there.max[axis].to_bits());
                }
                let shared = tessellation.cells().shared(cell, neighbour);
                assert_eq!(shared.min[axis], shared.max[axis]);
            }
            // Faces are covered by neighbours or lie in the hull.
            for face in Face::ALL {
                let area = |aabb: &Aabb| {
                    let size = aabb.size();
                    size[(face.axis() + 1) % 3] * size[(face.axis() + 2) % 3]
                };
                let here = tessellation.cell(cell);
                let neighbours = tessellation.neighbours(cell).iter().filter(|n| n.face == face);
                let shared: f64 = neighbours.map(|n| area(&tessellation.cells().shared(cell, n))).sum();
                let expected = if tessellation.hull(face).contains(&cell) { 0.0 } else { area(here) };
                assert!((shared - expected).abs() <= 1e-9 * area(here), "{shared} of {expected}");
            }
        }
    }

    pub fn check_points_of_triangles_are_listed(scene: &Scene, tessellation: &dyn Tessellation, seed: u64) {
        let mut rng = Pcg64::seed_from_u64(seed);
        for (id, triangle) in scene.triangles().iter().enumerate() {
            for _ in 0..50 {
                let (u, v) = (rng.random::<f64>(), rng.random::<f64>());
                let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
                let [a, b, c] = triangle.corners.map(|corner| corner.as_dvec3());
                let point = a + (b - a) * u + (c - a) * v;
                let cell = tessellation.cell_at(point).unwrap();
                assert!(tessellation.primitives(cell).contains(&(id as u32)));
                tessellation.cells_within(point, tessellation.cells().skin() * 0.99, &mut |cell| {
                    assert!(tessellation.primitives(cell).contains(&(id as u32)));
                });
            }
        }
    }

    pub fn check_cells_within(tessellation: &dyn Tessellation, point: DVec3, radius: f64) -> usize {
        let mut found = Vec::new();
        tessellation.cells_within(point, radius, &mut |cell| found.push(cell));
        found.sort_unstable();
        let expected: Vec<u32> = (0..tessellation.cell_count() as u32)
            .filter(|&cell| tessellation.cell(cell).distance(point) <= radius)
            .collect();
        assert_eq!(found, expected);
        found.len()
    }
}
