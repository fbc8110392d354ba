//! Surfaces in pieces: what houses and machines are covered with, so that what is seen of them has triangles to lose.

use glam::{DVec2, Vec3};

use super::glb::Triangles;

/// Adds a parallelogram with corner `origin` and sides `u` and `v`, cut into `cells` along each; it faces u × v.
pub fn push_patch(mesh: &mut Triangles, origin: Vec3, u: Vec3, v: Vec3, cells: [u32; 2]) {
    push_surface(mesh, cells, |s, t| origin + u * s + v * t);
}

/// Adds the surface that `at` spans over the unit square, cut into `cells` along each side; it faces ∂s × ∂t. Corners with
/// equal arguments are equal to the last bit.
pub fn push_surface(mesh: &mut Triangles, cells: [u32; 2], at: impl Fn(f32, f32) -> Vec3) {
    let first = mesh.positions.len() as u32;
    let share = |step: u32, of: u32| if step == of { 1.0 } else { step as f32 / of as f32 };
    for j in 0..=cells[1] {
        for i in 0..=cells[0] {
            mesh.positions.push(at(share(i, cells[0]), share(j, cells[1])));
        }
    }
    let row = cells[0] + 1;
    for j in 0..cells[1] {
        for i in 0..cells[0] {
            let [a, b, c, d] = [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)].map(|(i, j)| first + j * row + i);
            mesh.indices.extend([a, b, c, a, c, d]);
        }
    }
}

/// Adds a closed gable roof: half extents in plan, heights of eaves and ridge (along x), panels along and up each slope.
pub fn push_prism(mesh: &mut Triangles, half: DVec2, eaves: f64, ridge: f64, cells: [u32; 2]) {
    let [x, z, low, high] = [half.x, half.y, eaves, ridge].map(|metres| metres as f32);
    let up = Vec3::new(0.0, high - low, z);
    // The front slope faces −Z and up, the back slope +Z and up.
    push_patch(mesh, Vec3::new(x, low, -z), Vec3::X * (-2.0 * x), up, cells);
    push_patch(mesh, Vec3::new(-x, low, z), Vec3::X * (2.0 * x), Vec3::new(up.x, up.y, -up.z), cells);
    push_patch(mesh, Vec3::new(-x, low, -z), Vec3::X * (2.0 * x), Vec3::Z * (2.0 * z), [1, 1]);
    let first = mesh.positions.len() as u32;
    for x in [-x, x] {
        mesh.positions.extend([Vec3::new(x, low, -z), Vec3::new(x, low, z), Vec3::new(x, high, 0.0)]);
    }
    mesh.indices.extend([0, 1, 2, 3, 5, 4].map(|corner: u32| first + corner));
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Six times the volume that a closed mesh encloses; positive if it faces outward.
    fn volume(mesh: &Triangles) -> f32 {
        let corner = |index: &u32| mesh.positions[*index as usize];
        mesh.indices.chunks_exact(3).map(|t| corner(&t[0]).dot(corner(&t[1]).cross(corner(&t[2])))).sum::<f32>() / 6.0
    }

    #[test]
    fn a_gable_roof_is_closed_and_faces_outward() {
        let mut mesh = Triangles::default();
        push_prism(&mut mesh, DVec2::new(5.0, 4.0), 1.0, 3.0, [7, 3]);
        assert!((volume(&mesh) - 10.0 * 8.0 * 2.0 * 0.5).abs() < 1e-2, "{}", volume(&mesh));
        assert_eq!(mesh.len(), 2 * 2 * 21 + 2 + 2);
    }

    #[test]
    fn a_patch_faces_u_cross_v() {
        let mut mesh = Triangles::default();
        push_patch(&mut mesh, Vec3::ZERO, Vec3::X, Vec3::Y, [2, 3]);
        assert_eq!(mesh.len(), 12);
        for t in mesh.indices.chunks_exact(3) {
            let [a, b, c] = [0, 1, 2].map(|i| mesh.positions[t[i] as usize]);
            assert!((b - a).cross(c - a).z > 0.0);
        }
    }
}
