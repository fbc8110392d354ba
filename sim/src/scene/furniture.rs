//! Furniture of exactly [`TRIANGLES`] triangles a piece: what stands in made buildings for a culler to find or to skip.
//!
//! Each piece is a few closed boxes whose faces are cut into grids, n × m × k cells on a box: 4·(nm + nk + mk) triangles.
//! The grids are chosen to make 256, the size of the objects in FACTS.md's `building`. The cuts have no other use than
//! weight, as the curves of real furniture would have.

use glam::Vec3;

use super::glb::Triangles;

/// Triangles of every piece.
pub const TRIANGLES: usize = 256;

/// Height of a piece above the floor it stands on, so that no face lies in the floor's plane.
const LIFT: f32 = 0.005;

/// A piece of furniture: origin on the floor under its middle, looking along −Z.
#[derive(Clone, Debug, PartialEq)]
pub struct Piece {
    /// What it is.
    pub name: &'static str,
    /// Its triangles, in metres.
    pub mesh: Triangles,
    /// Radius of the circle around its footprint, in metres.
    pub radius: f64,
    /// From the floor to its top, in metres.
    pub height: f64,
}

/// All pieces, smallest footprint first.
pub fn pieces() -> Vec<Piece> {
    vec![
        cabinet("pedestal", 0.4, 0.4, 0.6),
        cabinet("cabinet", 0.4, 0.4, 1.2),
        table("stool", 0.4, 0.4, 0.45),
        chair(),
        cabinet("cupboard", 0.9, 0.4, 1.1),
        table("desk", 1.2, 0.7, 0.75),
    ]
}

/// A desk with what is on it, and its chair: five times [`TRIANGLES`]. Origin on the floor under the desk's middle; the chair
/// stands toward +Z, 1.1 m deep in all.
pub fn workplace() -> Triangles {
    let mut mesh = table("desk", 1.2, 0.7, 0.75).mesh;
    for (min, max) in [
        // Screen, keyboard, lamp.
        (Vec3::new(-0.3, 0.76, -0.25), Vec3::new(0.3, 1.15, -0.2)),
        (Vec3::new(-0.22, 0.755, 0.05), Vec3::new(0.22, 0.78, 0.2)),
        (Vec3::new(0.45, 0.76, -0.28), Vec3::new(0.52, 1.2, -0.21)),
    ] {
        push_grid_box(&mut mesh, min, max, [4, 6, 4]);
    }
    let (first, chair) = (mesh.positions.len() as u32, chair().mesh);
    // It faces the desk as it is made, toward −Z.
    mesh.positions.extend(chair.positions.iter().map(|corner| *corner + Vec3::new(0.0, 0.0, 0.55)));
    mesh.indices.extend(chair.indices.iter().map(|index| index + first));
    mesh
}

/// A bookcase of five boards of books in front of its back: six times [`TRIANGLES`]. Origin on the floor under its middle,
/// 1.0 × 0.3 m, 2.0 m high.
pub fn bookcase() -> Triangles {
    let mut mesh = Triangles::default();
    push_grid_box(&mut mesh, Vec3::new(-0.5, LIFT, -0.15), Vec3::new(0.5, 2.0, -0.12), [4, 6, 4]);
    for board in 0..5 {
        let bottom = 0.05 + 0.39 * board as f32;
        // Books of one board end at different places, so that one sees between them.
        let reach = 0.48 - 0.07 * ((board * 2) % 5) as f32;
        push_grid_box(&mut mesh, Vec3::new(-0.48, bottom, -0.11), Vec3::new(reach, bottom + 0.28, 0.15), [4, 6, 4]);
    }
    mesh
}

/// Boxes, each with its grid.
fn piece(name: &'static str, boxes: &[(Vec3, Vec3, [u32; 3])]) -> Piece {
    let mut mesh = Triangles::default();
    for &(min, max, cells) in boxes {
        push_grid_box(&mut mesh, min, max, cells);
    }
    debug_assert_eq!(mesh.len(), TRIANGLES, "{name}");
    let radius = mesh.positions.iter().map(|p| f64::from(p.x).hypot(f64::from(p.z))).fold(0.0, f64::max);
    let height = mesh.positions.iter().map(|p| f64::from(p.y)).fold(0.0, f64::max);
    Piece { name, mesh, radius, height }
}

/// 4·(4·4 + 4·6 + 4·6).
fn cabinet(name: &'static str, width: f32, depth: f32, height: f32) -> Piece {
    let (x, z) = (0.5 * width, 0.5 * depth);
    piece(name, &[(Vec3::new(-x, LIFT, -z), Vec3::new(x, height, z), [4, 6, 4])])
}

/// A top of 4·(8·4 + 8 + 4) and four legs of 4·(1 + 2 + 2).
fn table(name: &'static str, width: f32, depth: f32, height: f32) -> Piece {
    let (x, z) = (0.5 * width, 0.5 * depth);
    let top = (Vec3::new(-x, height - 0.04, -z), Vec3::new(x, height, z), [8, 1, 4]);
    let [a, b, c, d] = legs(x - 0.04, z - 0.04, height - 0.03);
    piece(name, &[top, a, b, c, d])
}

/// A seat of 4·(4·4 + 4 + 4), a back of 4·(2·6 + 2 + 6) and four legs of 4·(1 + 2 + 2).
fn chair() -> Piece {
    let seat = (Vec3::new(-0.2, 0.43, -0.2), Vec3::new(0.2, 0.47, 0.2), [4, 1, 4]);
    let back = (Vec3::new(-0.19, 0.45, 0.155), Vec3::new(0.19, 0.9, 0.195), [2, 6, 1]);
    let [a, b, c, d] = legs(0.17, 0.17, 0.45);
    piece("chair", &[seat, back, a, b, c, d])
}

fn legs(x: f32, z: f32, top: f32) -> [(Vec3, Vec3, [u32; 3]); 4] {
    let half = Vec3::new(0.02, 0.0, 0.02);
    [(-x, -z), (x, -z), (-x, z), (x, z)]
        .map(|(x, z)| (Vec3::new(x, LIFT, z) - half, Vec3::new(x, top, z) + half, [1, 2, 1]))
}

/// Adds a closed box, faces outward, each face a grid of `cells` along x, y and z: 4·(xy + yz + zx) triangles. Faces share
/// no corners with each other, but their edges have the same points, so the box is watertight.
pub fn push_grid_box(mesh: &mut Triangles, min: Vec3, max: Vec3, cells: [u32; 3]) {
    for axis in 0..3 {
        // u × v points along the axis.
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        for positive in [false, true] {
            let first = mesh.positions.len() as u32;
            let along = |axis: usize, step: u32| {
                // Both ends exactly, for faces that meet there.
                if step == cells[axis] {
                    max[axis]
                } else {
                    min[axis] + (max[axis] - min[axis]) * (step as f32 / cells[axis] as f32)
                }
            };
            for j in 0..=cells[v] {
                for i in 0..=cells[u] {
                    let mut corner = if positive { max } else { min };
                    (corner[u], corner[v]) = (along(u, i), along(v, j));
                    mesh.positions.push(corner);
                }
            }
            let row = cells[u] + 1;
            for j in 0..cells[v] {
                for i in 0..cells[u] {
                    let [a, b, c, d] =
                        [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)].map(|(i, j)| first + j * row + i);
                    let turns = if positive { [a, b, c, a, c, d] } else { [a, c, b, a, d, c] };
                    mesh.indices.extend(turns);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;

    #[test]
    fn every_piece_has_its_triangles_and_its_size() {
        for piece in pieces() {
            assert_eq!(piece.mesh.len(), TRIANGLES, "{}", piece.name);
            assert!((0.4..=1.2 + 1e-6).contains(&piece.height), "{}", piece.name);
            assert!((0.28..0.72).contains(&piece.radius), "{}: {}", piece.name, piece.radius);
            assert!(piece.mesh.positions.iter().all(|p| p.y > 0.0));
        }
        let sizes: Vec<f64> = pieces().iter().map(|piece| (piece.radius * 1e4).round()).collect();
        assert!(sizes.is_sorted(), "{sizes:?}");
    }

    #[test]
    fn sets_of_furniture_have_their_triangles_and_stay_in_their_footprint() {
        let reach = |mesh: &Triangles| mesh.positions.iter().fold(Vec3::ZERO, |most, corner| most.max(corner.abs()));
        assert_eq!((workplace().len(), bookcase().len()), (5 * TRIANGLES, 6 * TRIANGLES));
        assert!(reach(&workplace()).cmple(Vec3::new(0.6, 1.2, 0.751)).all(), "{}", reach(&workplace()));
        assert!(reach(&bookcase()).cmple(Vec3::new(0.5, 2.0, 0.15)).all());
    }

    #[test]
    fn a_grid_box_is_closed_and_faces_outward() {
        let mut mesh = Triangles::default();
        let (min, max) = (Vec3::new(-1.0, 0.1, 2.0), Vec3::new(0.3, 0.7, 4.0));
        push_grid_box(&mut mesh, min, max, [3, 5, 2]);
        assert_eq!(mesh.len(), 4 * (15 + 10 + 6));
        // Each directed edge has its opposite exactly once, corners told apart by place.
        let mut edges = BTreeMap::new();
        let mut volume = 0.0;
        for t in mesh.indices.chunks_exact(3) {
            let [a, b, c] = [0, 1, 2].map(|i| mesh.positions[t[i] as usize]);
            volume += a.dot(b.cross(c)) / 6.0;
            let bits = |p: Vec3| p.to_array().map(f32::to_bits);
            for (from, to) in [(a, b), (b, c), (c, a)] {
                assert!(edges.insert((bits(from), bits(to)), ()).is_none());
            }
        }
        assert!(edges.keys().all(|&(from, to)| edges.contains_key(&(to, from))));
        assert!((volume - (max - min).element_product()).abs() < 1e-4, "{volume}");
    }
}
