//! The maker `engine`: five copies of a machine of dense parts under bonnets, about 810,000 triangles (the 5CBEM of Klosowski
//! & Silva 2000, §5, in spirit).
//!
//! Each machine is a body of curved panels, open at grille and wheel arches, with an engine of cylinders, pipes, belts' wheels
//! and bolts packed inside, and seats behind. Parts are finely cut everywhere, so that triangles are small and most of them hide
//! each other: a culler that takes cells whole draws much for little. All materials are single-sided.
//!
//! The path of 200 views is fixed: past the row of machines, over them, then close along bonnets and through a grille.

use std::f32::consts::TAU;
use std::f64::consts::{FRAC_PI_2, PI};

use glam::{DQuat, DVec3, Vec3};
use rand::RngExt;
use rand_pcg::Pcg64;

use super::furniture::push_grid_box;
use super::glb::{GlbWriter, Node, Triangles};
use super::made::{CAMERAS_MAX, MadeError, MadeModel, check};
use super::patch::{push_patch, push_surface};
use crate::chance;
use crate::cull::{CameraPath, Stop};

/// From machine to machine along x.
const DISTANCE: f64 = 3.2;
/// Half width, half length of the body, height of its floor, of its bonnet and of its top.
const BODY: (f32, f32, f32, f32, f32) = (0.9, 2.2, 0.3, 0.95, 1.45);
/// Where the engine's space ends, from the front at −Z.
const FIREWALL: f32 = -0.7;

/// What the maker `engine` is asked for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct EngineRules {
    /// Machines side by side. Default 5: about 810,000 triangles.
    pub copies: u32,
    /// Views of the path, which is cut finer or coarser. Default 200.
    pub cameras: u32,
    /// Decides where pipes and bolts are. Default 1.
    pub seed: u64,
}

impl Default for EngineRules {
    fn default() -> EngineRules {
        EngineRules { copies: 5, cameras: 200, seed: 1 }
    }
}

/// Makes the machines. The same rules give the same bytes.
///
/// # Errors
/// Names the rule that no model can follow.
pub fn make(rules: &EngineRules) -> Result<MadeModel, MadeError> {
    check("copies", rules.copies, 1, 50)?;
    check("cameras", rules.cameras, 0, CAMERAS_MAX)?;
    let mut writer = GlbWriter::new();
    let mut chance = chance(rules.seed, 61);
    let paint = writer.material("paint", [0.5, 0.08, 0.06], false);
    let metal = writer.material("metal", [0.5, 0.5, 0.53], false);
    let rubber = writer.material("rubber", [0.1, 0.1, 0.1], false);
    let floor = writer.material("floor", [0.4, 0.4, 0.4], false);
    let parts = [
        ("body", writer.mesh("body", &body(), Some(paint))?),
        ("block", writer.mesh("block", &block(), Some(metal))?),
        ("pipes", writer.mesh("pipes", &pipes(&mut chance), Some(metal))?),
        ("bolts", writer.mesh("bolts", &bolts(&mut chance), Some(metal))?),
        ("wheels", writer.mesh("wheels", &wheels(), Some(rubber))?),
        ("seats", writer.mesh("seats", &seats(), Some(rubber))?),
    ];
    for copy in 0..rules.copies {
        for (name, mesh) in parts {
            let translation = DVec3::X * (f64::from(copy) * DISTANCE);
            let name = format!("{name}.{copy}");
            writer.node(Node { name, mesh: Some(mesh), translation, rotation: DQuat::IDENTITY })?;
        }
    }
    let mut hall = Triangles::default();
    let wide = (f64::from(rules.copies) * DISTANCE) as f32 + 12.0;
    push_patch(&mut hall, Vec3::new(-8.0, 0.0, -8.0), Vec3::Z * 16.0, Vec3::X * wide, [16, wide as u32]);
    let hall = writer.mesh("hall", &hall, Some(floor))?;
    writer.node(Node { name: "hall".into(), mesh: Some(hall), translation: DVec3::ZERO, rotation: DQuat::IDENTITY })?;
    let triangles = writer.triangles();
    Ok(MadeModel { glb: writer.finish()?, triangles, cameras: path(rules) })
}

/// A tube of `radius` from `from` to `to`, closed by flat ends: 2·around·(along + 1) triangles.
fn push_tube(mesh: &mut Triangles, from: Vec3, to: Vec3, radius: f32, [around, along]: [u32; 2]) {
    let axis = (to - from).normalize();
    let u = axis.any_orthonormal_vector();
    let v = axis.cross(u);
    let rim = move |s: f32| {
        let (sin, cos) = (s * TAU).sin_cos();
        (u * cos + v * sin) * radius
    };
    push_surface(mesh, [around, along], |s, t| from.lerp(to, t) + rim(s));
    push_surface(mesh, [around, 1], |s, t| from + rim(s) * t);
    push_surface(mesh, [around, 1], |s, t| to + rim(s) * (1.0 - t));
}

/// A ring around `axis`, outer radius `ring` + `tube`.
fn push_ring(mesh: &mut Triangles, middle: Vec3, axis: Vec3, [ring, tube]: [f32; 2], cells: [u32; 2]) {
    let u = axis.any_orthonormal_vector();
    let v = axis.cross(u);
    push_surface(mesh, cells, |s, t| {
        let ((sin, cos), (sin_t, cos_t)) = ((s * TAU).sin_cos(), (t * TAU).sin_cos());
        middle + (u * cos + v * sin) * (ring + tube * cos_t) + axis * (tube * sin_t)
    });
}

/// Panels of a body, 2 cm thick, curved, with a grille, open wheel arches and windows.
fn body() -> Triangles {
    let (wide, long, low, bonnet, top) = BODY;
    let mut mesh = Triangles::default();
    // Outer and inner face of a panel; `at` spans it so that it faces outward.
    let mut panel = |cells: [u32; 2], at: &dyn Fn(f32, f32) -> Vec3, inward: Vec3| {
        push_surface(&mut mesh, cells, at);
        push_surface(&mut mesh, cells, |s, t| at(1.0 - s, t) + inward);
    };
    let bulge = |share: f32| 0.06 * (share * TAU * 0.5).sin();
    let mix = |from: f32, to: f32, share: f32| from + (to - from) * share;
    // Bonnet, roof and boot: along z, across x, facing up.
    for (from, to, height) in [(-long, FIREWALL, bonnet), (-0.3, 1.1, top), (1.5, long, bonnet)] {
        let at = move |s: f32, t: f32| Vec3::new(mix(-wide, wide, t), height + bulge(t) + bulge(s), mix(from, to, s));
        panel([16, 16], &at, Vec3::NEG_Y * 0.02);
    }
    // Sides, below the windows: in three lengths that leave the wheel arches open.
    for side in [-1.0_f32, 1.0] {
        for (from, to, bottom) in
            [(-long, -1.75, low), (-1.75, -1.05, 0.72), (-1.05, 1.05, low), (1.05, 1.75, 0.72), (1.75, long, low)]
        {
            let at = move |s: f32, t: f32| {
                // Up × along: towards +X with z rising, towards −X with z falling.
                let z = if side > 0.0 { mix(from, to, t) } else { mix(to, from, t) };
                Vec3::new(side * (wide + bulge(s)), mix(bottom, bonnet, s), z)
            };
            panel([8, 8], &at, Vec3::X * (-side * 0.02));
        }
    }
    // Front: a grille of bars, and a bumper; back: closed.
    for bar in 0..14 {
        let y = mix(0.45, bonnet - 0.05, bar as f32 / 13.0);
        push_grid_box(&mut mesh, Vec3::new(-wide, y, -long), Vec3::new(wide, y + 0.033, -long + 0.03), [16, 1, 1]);
    }
    push_grid_box(&mut mesh, Vec3::new(-wide, low, -long - 0.1), Vec3::new(wide, 0.45, -long), [16, 3, 2]);
    push_grid_box(&mut mesh, Vec3::new(-wide, low, long), Vec3::new(wide, bonnet, long + 0.1), [16, 6, 2]);
    push_grid_box(&mut mesh, Vec3::new(-wide, low, FIREWALL), Vec3::new(wide, bonnet, FIREWALL + 0.03), [20, 10, 1]);
    push_grid_box(&mut mesh, Vec3::new(-wide, low, FIREWALL), Vec3::new(wide, low + 0.03, long), [20, 1, 30]);
    for (x, z) in [(-wide, -0.3), (wide - 0.06, -0.3), (-wide, 1.04), (wide - 0.06, 1.04)] {
        push_grid_box(&mut mesh, Vec3::new(x, bonnet, z), Vec3::new(x + 0.06, top, z + 0.06), [2, 12, 2]);
    }
    mesh
}

/// A block with cylinders in two rows, a sump, and wheels of belts before it.
fn block() -> Triangles {
    let mut mesh = Triangles::default();
    push_grid_box(&mut mesh, Vec3::new(-0.3, 0.35, -1.7), Vec3::new(0.3, 0.6, -0.85), [24, 12, 36]);
    for row in [-1.0_f32, 1.0] {
        for number in 0..4 {
            let foot = Vec3::new(row * 0.12, 0.55, -1.6 + 0.2 * number as f32);
            push_tube(&mut mesh, foot, foot + Vec3::new(row * 0.12, 0.22, 0.0), 0.085, [24, 12]);
            for fin in 0..6 {
                let at = foot + Vec3::new(row * 0.12, 0.22, 0.0) * (0.15 + 0.14 * fin as f32);
                push_ring(&mut mesh, at, Vec3::new(row * 0.48, 0.877, 0.0), [0.09, 0.008], [24, 6]);
            }
        }
    }
    for (x, y, radius) in [(0.0, 0.5, 0.1), (0.2, 0.65, 0.07), (-0.2, 0.62, 0.08), (0.05, 0.75, 0.05)] {
        push_ring(&mut mesh, Vec3::new(x, y, -1.78), Vec3::Z, [radius, 0.025], [60, 16]);
        push_tube(&mut mesh, Vec3::new(x, y, -1.8), Vec3::new(x, y, -1.7), radius * 0.5, [40, 6]);
    }
    // A radiator of thin fins.
    for fin in 0..40 {
        let x = -0.6 + 0.03 * fin as f32;
        push_grid_box(&mut mesh, Vec3::new(x, 0.4, -2.05), Vec3::new(x + 0.004, 0.85, -1.95), [1, 20, 4]);
    }
    mesh
}

/// Bent pipes among the cylinders: chains of tubes that end at joints.
fn pipes(chance: &mut Pcg64) -> Triangles {
    let mut mesh = Triangles::default();
    let mut within = |from: f32, to: f32| chance.random_range(from..to);
    for _ in 0..68 {
        let mut at = Vec3::new(within(-0.75, 0.75), within(0.4, 0.85), within(-1.85, -0.8));
        let radius = within(0.012, 0.03);
        for _ in 0..4 {
            let next = Vec3::new(
                (at.x + within(-0.3, 0.3)).clamp(-0.8, 0.8),
                (at.y + within(-0.15, 0.15)).clamp(0.36, 0.88),
                (at.z + within(-0.3, 0.3)).clamp(-1.9, -0.75),
            );
            if next.distance(at) > 0.05 {
                push_tube(&mut mesh, at, next, radius, [12, 8]);
                at = next;
            }
        }
    }
    mesh
}

/// Hexagonal bolts on the block and along the body's floor.
fn bolts(chance: &mut Pcg64) -> Triangles {
    let mut mesh = Triangles::default();
    for _ in 0..150 {
        let at = Vec3::new(
            chance.random_range(-0.32..0.32),
            chance.random_range(0.36..0.9),
            chance.random_range(-1.7..-0.8),
        );
        let way = Vec3::new(chance.random_range(-1.0..1.0), 1.0, chance.random_range(-0.5..0.5)).normalize();
        push_tube(&mut mesh, at, at + way * 0.015, 0.012, [6, 1]);
        push_tube(&mut mesh, at + way * 0.015, at + way * 0.03, 0.006, [12, 2]);
    }
    mesh
}

fn wheels() -> Triangles {
    let (wide, ..) = BODY;
    let mut mesh = Triangles::default();
    for (x, z) in [(-wide, -1.4), (wide, -1.4), (-wide, 1.4), (wide, 1.4)] {
        let middle = Vec3::new(x * 0.9, 0.32, z);
        push_ring(&mut mesh, middle, Vec3::X, [0.24, 0.08], [32, 10]);
        push_tube(&mut mesh, middle - Vec3::X * 0.06, middle + Vec3::X * 0.06, 0.17, [48, 3]);
        for nut in 0..5 {
            let (sin, cos) = (TAU * nut as f32 / 5.0).sin_cos();
            let at = middle + Vec3::new(0.0, sin, cos) * 0.08;
            push_tube(&mut mesh, at - Vec3::X * 0.08, at + Vec3::X * 0.08, 0.015, [12, 4]);
        }
    }
    mesh
}

fn seats() -> Triangles {
    let mut mesh = Triangles::default();
    for (x, z) in [(-0.4, 0.1), (0.4, 0.1), (-0.4, 0.8), (0.4, 0.8)] {
        let at = Vec3::new(x, 0.0, z);
        let mut cushion = |min: Vec3, max: Vec3| push_grid_box(&mut mesh, at + min, at + max, [6, 6, 6]);
        cushion(Vec3::new(-0.25, 0.4, -0.25), Vec3::new(0.25, 0.55, 0.2));
        cushion(Vec3::new(-0.25, 0.5, 0.15), Vec3::new(0.25, 1.1, 0.28));
    }
    mesh
}

fn path(rules: &EngineRules) -> CameraPath {
    let eye = |x: f64, y: f64, z: f64| DVec3::new(x, y, z);
    let end = f64::from(rules.copies - 1) * DISTANCE;
    let near = (f64::from(rules.copies) * 0.5).floor() * DISTANCE;
    let east = -FRAC_PI_2;
    let stops: Vec<Stop> = vec![
        (0.0, eye(-3.5, 1.6, -4.0), PI + 0.9, -0.1),
        (0.25, eye(end * 0.6, 1.5, -4.2), PI + 0.3, -0.12),
        (0.4, eye(end + 3.5, 2.0, -3.0), FRAC_PI_2 + 0.6, -0.2),
        (0.55, eye(end + 2.5, 3.5, 0.5), FRAC_PI_2, -0.45),
        (0.7, eye(-3.0, 3.0, 2.0), east + 0.2, -0.4),
        (0.8, eye(-2.5, 1.3, -2.6), east - 0.4, -0.15),
        (0.9, eye(near, 1.2, -3.4), -PI, -0.15),
        (1.0, eye(near, 0.75, -2.6), -PI + 0.05, 0.0),
    ];
    CameraPath::through(&stops, rules.cameras)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn five_machines_have_about_810_000_triangles() {
        let made = make(&EngineRules::default()).unwrap();
        assert!((780_000..840_000).contains(&made.triangles), "{}", made.triangles);
        assert_eq!(made.cameras.cameras.len(), 200);
    }

    #[test]
    fn same_rules_same_bytes_and_bad_rules_are_named() {
        let rules = EngineRules { copies: 1, cameras: 3, seed: 2 };
        let (a, b) = (make(&rules).unwrap(), make(&rules).unwrap());
        assert!(a.glb == b.glb && a.cameras == b.cameras);
        assert!(make(&EngineRules { seed: 4, ..rules.clone() }).unwrap().glb != a.glb);
        let message = make(&EngineRules { copies: 0, ..rules }).unwrap_err().to_string();
        assert!(message.contains("copies = 0: give 1 to 50"));
    }

    #[test]
    fn tubes_and_rings_face_outward() {
        // Six times the volume that a closed mesh encloses is positive if it faces outward.
        let volume = |mesh: &Triangles| {
            let corner = |index: &u32| mesh.positions[*index as usize];
            mesh.indices.chunks_exact(3).map(|t| corner(&t[0]).dot(corner(&t[1]).cross(corner(&t[2])))).sum::<f32>()
                / 6.0
        };
        let mut tube = Triangles::default();
        push_tube(&mut tube, Vec3::new(1.0, 2.0, 0.5), Vec3::new(1.0, 3.0, 1.5), 0.5, [64, 3]);
        assert!((volume(&tube) / (2.0_f32.sqrt() * 0.25 * TAU * 0.5) - 1.0).abs() < 0.01, "{}", volume(&tube));
        let mut ring = Triangles::default();
        push_ring(&mut ring, Vec3::X, Vec3::Y, [2.0, 0.5], [64, 32]);
        assert!((volume(&ring) / (TAU * 2.0 * 0.25 * TAU * 0.5) - 1.0).abs() < 0.03, "{}", volume(&ring));
    }
}
