//! What PLP needs to know of a tessellation, whatever its cells are: their triangles, their corners, and the faces through
//! which one goes on (Klosowski & Silva 2000, §4.2: "it is easy to support different underlying spatial tessellations").

use std::sync::Arc;

use glam::DVec3;

use crate::{CellId, Delaunay, Face, Prisms, Tessellation};

/// Convex cells that PLP can walk. Cheap to clone.
#[derive(Clone, Debug)]
pub enum PlpCells {
    /// Boxes: an octree's or kD-tree's leaves.
    Boxes(Arc<dyn Tessellation>),
    /// Tetrahedra.
    Tetrahedra(Arc<Delaunay>),
    /// The floor plan between floors and ceilings.
    Prisms(Arc<Prisms>),
}

/// A face between two cells.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Portal {
    /// The cell behind it.
    pub cell: CellId,
    /// Unit normal towards that cell.
    pub normal: DVec3,
    corners: [DVec3; 4],
    count: usize,
}

impl Portal {
    /// Whether the segment from an eye to a point behind the face passes through it: the point is *star-shaped* with respect to
    /// eye and face.
    pub(crate) fn is_passed(&self, eye: DVec3, point: DVec3) -> bool {
        let way = point - eye;
        let (height, slope) = (self.normal.dot(self.corners[0] - eye), self.normal.dot(way));
        if !(slope > 0.0 && height >= 0.0 && height <= slope) {
            return false;
        }
        let through = eye + way * (height / slope);
        let corners = &self.corners[..self.count];
        let side = |i: usize| {
            let (from, to) = (corners[i], corners[(i + 1) % self.count]);
            self.normal.dot((to - from).cross(through - from))
        };
        // Corners may run either way round.
        (0..self.count).all(|i| side(i) >= 0.0) || (0..self.count).all(|i| side(i) <= 0.0)
    }
}

/// Corners of a cell: at most eight.
pub(crate) struct CellCorners {
    corners: [DVec3; 8],
    count: usize,
}

impl std::ops::Deref for CellCorners {
    type Target = [DVec3];

    fn deref(&self) -> &[DVec3] {
        &self.corners[..self.count]
    }
}

impl PlpCells {
    /// Number of cells.
    pub fn len(&self) -> usize {
        match self {
            PlpCells::Boxes(cells) => cells.cell_count(),
            PlpCells::Tetrahedra(cells) => cells.len(),
            PlpCells::Prisms(cells) => cells.cell_count(),
        }
    }

    /// Never: an empty scene has a cell too.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The triangles that touch a cell, ascending.
    pub fn primitives(&self, cell: CellId) -> &[u32] {
        match self {
            PlpCells::Boxes(cells) => cells.cells().primitives(cell),
            PlpCells::Tetrahedra(cells) => cells.primitives(cell),
            PlpCells::Prisms(cells) => cells.cells().primitives(cell),
        }
    }

    /// Number of triangles of the scene that the cells were made for.
    pub fn primitive_total(&self) -> usize {
        match self {
            PlpCells::Boxes(cells) => cells.primitive_total(),
            PlpCells::Tetrahedra(cells) => cells.primitive_total(),
            PlpCells::Prisms(cells) => cells.primitive_total(),
        }
    }

    /// Sum over the cells of the triangles listed.
    pub fn reference_count(&self) -> usize {
        match self {
            PlpCells::Boxes(cells) => cells.cells().reference_count(),
            PlpCells::Tetrahedra(cells) => cells.reference_count(),
            PlpCells::Prisms(cells) => cells.cells().reference_count(),
        }
    }

    pub(crate) fn corners(&self, cell: CellId) -> CellCorners {
        match self {
            PlpCells::Boxes(cells) => CellCorners { corners: cells.cell(cell).corners(), count: 8 },
            PlpCells::Tetrahedra(cells) => {
                let mut corners = [DVec3::ZERO; 8];
                corners[..4].copy_from_slice(&cells.corners(cell));
                CellCorners { corners, count: 4 }
            }
            PlpCells::Prisms(cells) => {
                let mut corners = [DVec3::ZERO; 8];
                corners[..6].copy_from_slice(&cells.corners(cell));
                CellCorners { corners, count: 6 }
            }
        }
    }

    /// A point inside a cell.
    pub(crate) fn centre(&self, cell: CellId) -> DVec3 {
        match self {
            PlpCells::Boxes(cells) => cells.cell(cell).centre(),
            PlpCells::Tetrahedra(cells) => cells.corners(cell).into_iter().sum::<DVec3>() * 0.25,
            PlpCells::Prisms(cells) => cells.corners(cell).into_iter().sum::<DVec3>() / 6.0,
        }
    }

    /// The faces that lead on from a cell.
    pub(crate) fn portals(&self, cell: CellId, mut found: impl FnMut(&Portal)) {
        match self {
            PlpCells::Boxes(cells) => {
                for neighbour in cells.neighbours(cell) {
                    let shared = cells.cells().shared(cell, neighbour);
                    let axis = neighbour.face.axis();
                    let mut normal = DVec3::ZERO;
                    normal[axis] = if neighbour.face.is_positive() { 1.0 } else { -1.0 };
                    let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
                    let corner = |at_u: f64, at_v: f64| {
                        let mut corner = shared.min;
                        (corner[u], corner[v]) = (at_u, at_v);
                        corner
                    };
                    let corners = [
                        corner(shared.min[u], shared.min[v]),
                        corner(shared.max[u], shared.min[v]),
                        corner(shared.max[u], shared.max[v]),
                        corner(shared.min[u], shared.max[v]),
                    ];
                    found(&Portal { cell: neighbour.cell, normal, corners, count: 4 });
                }
            }
            PlpCells::Tetrahedra(cells) => {
                for (cell, normal, [a, b, c]) in cells.faces(cell) {
                    found(&Portal { cell, normal, corners: [a, b, c, c], count: 3 });
                }
            }
            PlpCells::Prisms(cells) => {
                for (cell, normal, corners, count) in cells.faces(cell) {
                    found(&Portal { cell, normal, corners, count });
                }
            }
        }
    }

    /// The cell that contains a point, or `None` outside the root box.
    pub(crate) fn cell_at(&self, point: DVec3) -> Option<CellId> {
        match self {
            PlpCells::Boxes(cells) => cells.cell_at(point),
            PlpCells::Tetrahedra(cells) => cells.cell_at(point),
            PlpCells::Prisms(cells) => cells.cell_at(point),
        }
    }

    /// Cells with a face in the hull that an eye outside is in front of, ascending.
    pub(crate) fn hull_facing(&self, eye: DVec3) -> Vec<CellId> {
        let mut facing: Vec<CellId> = match self {
            PlpCells::Boxes(cells) => {
                let faces = Face::ALL.into_iter().filter(|face| face.height(&cells.root(), eye) > 0.0);
                faces.flat_map(|face| cells.hull(face).iter().copied()).collect()
            }
            PlpCells::Tetrahedra(cells) => cells.hull_facing(eye).collect(),
            PlpCells::Prisms(cells) => cells.hull_facing(eye).collect(),
        };
        facing.sort_unstable();
        facing.dedup();
        facing
    }
}
