//! The maker `vessels`: a tree of tubes, about 420,000 triangles, in front of each other nearly nowhere.
//!
//! Each vessel bends, narrows and ends in two, eleven times over. What faces the eye is seen, so that guessing what is hidden can gain
//! next to nothing: the scene on which a culler shows what it costs. All materials are single-sided, and tubes are open
//! at their ends.
//!
//! The path of 200 views is fixed: once around the tree, then up through its crown.

use std::f32::consts::TAU;
use std::f64::consts::PI;

use glam::{DQuat, DVec3, Vec3};
use rand::RngExt;
use rand_pcg::Pcg64;

use super::glb::{GlbWriter, Node, Triangles};
use super::made::{CAMERAS_MAX, MadeError, MadeModel, check};
use super::patch::push_surface;
use crate::chance;
use crate::cull::{CameraPath, Stop};

/// Panels around a vessel and along it.
const CELLS: [u32; 2] = [8, 13];
/// Length and radius of the trunk in metres, and what both shrink by at each fork.
const TRUNK: (f32, f32) = (2.4, 0.06);
const SHRINK: (f32, f32) = (0.84, 0.78);
/// Forks above which vessels are one node; each subtree from there on is one.
const NODE_LEVELS: u32 = 5;

/// What the maker `vessels` is asked for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct VesselsRules {
    /// Generations of vessels, each of twice as many. Default 11: 2,047 vessels of 208 triangles.
    pub levels: u32,
    /// Views of the path, which is cut finer or coarser. Default 200.
    pub cameras: u32,
    /// Decides bends and forks. Default 1.
    pub seed: u64,
}

impl Default for VesselsRules {
    fn default() -> VesselsRules {
        VesselsRules { levels: 11, cameras: 200, seed: 1 }
    }
}

/// Where a vessel begins, which way, and how many forks are below it.
#[derive(Clone, Copy, Debug)]
struct Bud {
    at: Vec3,
    way: Vec3,
    length: f32,
    radius: f32,
    level: u32,
}

/// Makes the tree. The same rules give the same bytes.
///
/// # Errors
/// Names the rule that no model can follow.
pub fn make(rules: &VesselsRules) -> Result<MadeModel, MadeError> {
    check("levels", rules.levels, 1, 16)?;
    check("cameras", rules.cameras, 0, CAMERAS_MAX)?;
    let mut writer = GlbWriter::new();
    let mut chance = chance(rules.seed, 81);
    let red = writer.material("vessel", [0.6, 0.1, 0.1], false);
    let trunk = Bud { at: Vec3::ZERO, way: Vec3::Y, length: TRUNK.0, radius: TRUNK.1, level: 0 };
    let mut roots = vec![(Triangles::default(), vec![trunk], NODE_LEVELS.min(rules.levels))];
    let mut number = 0;
    while let Some((mut mesh, mut open, until)) = roots.pop() {
        while let Some(bud) = open.pop() {
            if bud.level >= until {
                roots.push((Triangles::default(), vec![bud], rules.levels));
                continue;
            }
            let [one, two] = push_vessel(&mut mesh, &bud, &mut chance);
            // The last generation has no fork.
            if bud.level + 1 < rules.levels {
                open.extend([one, two]);
            }
        }
        let mesh = writer.mesh(&format!("vessels.{number}"), &mesh, Some(red))?;
        let name = format!("vessels.{number}");
        writer.node(Node { name, mesh: Some(mesh), translation: DVec3::ZERO, rotation: DQuat::IDENTITY })?;
        number += 1;
    }
    let triangles = writer.triangles();
    Ok(MadeModel { glb: writer.finish()?, triangles, cameras: path(rules) })
}

/// Adds a bent tube that narrows, and says where its two children begin.
fn push_vessel(mesh: &mut Triangles, bud: &Bud, chance: &mut Pcg64) -> [Bud; 2] {
    let any = |chance: &mut Pcg64| Vec3::from_array(std::array::from_fn(|_| chance.random_range(-1.0..1.0_f32)));
    // Never so much that the tube turns back on itself.
    let end_way = (bud.way + any(chance) * 0.25).normalize();
    let middle = bud.at + bud.way * bud.length * 0.5;
    let end = middle + end_way * bud.length * 0.5;
    let axis = (end - bud.at).normalize();
    let (u, v) = {
        let u = axis.any_orthonormal_vector();
        (u, axis.cross(u))
    };
    let narrow = bud.radius * SHRINK.1;
    push_surface(mesh, CELLS, |s, t| {
        let centre = bud.at.lerp(middle, t).lerp(middle.lerp(end, t), t);
        let (sin, cos) = (s * TAU).sin_cos();
        centre + (u * cos + v * sin) * (bud.radius + (narrow - bud.radius) * t)
    });
    let across = end_way.cross(any(chance)).try_normalize().unwrap_or_else(|| end_way.any_orthonormal_vector());
    let spread = chance.random_range(0.45..0.75_f32);
    [1.0, -1.0].map(|side| Bud {
        at: end,
        way: (end_way + across * (side * spread)).normalize(),
        length: bud.length * SHRINK.0,
        radius: narrow,
        level: bud.level + 1,
    })
}

fn path(rules: &VesselsRules) -> CameraPath {
    // What the lengths of the generations add up to, from root to tip.
    let height = f64::from((0..rules.levels).map(|level| TRUNK.0 * SHRINK.0.powi(level as i32)).sum::<f32>());
    // From beside the crown's middle, yaw looks back at the trunk.
    let around = |turn: f64, reach: f64, y: f64| DVec3::new(turn.sin() * reach, height * y, turn.cos() * reach);
    let mut stops: Vec<Stop> = (0..=8)
        .map(|step| {
            let turn = f64::from(step) * PI / 4.0;
            (f64::from(step) * 0.085, around(turn, height * 1.1, 0.55), turn, 0.0)
        })
        .collect();
    let turn = 2.0 * PI;
    stops.push((0.80, around(turn, height * 0.75, 0.4), turn, 0.1));
    stops.push((0.92, around(turn + 0.3, height * 0.35, 0.55), turn + 0.3, 0.2));
    stops.push((1.00, around(turn + 0.6, height * 0.3, 0.7), turn + 0.9, -0.3));
    CameraPath::through(&stops, rules.cameras)
}

#[cfg(test)]
mod tests {
    use eyeline_visibility::{
        Culler, EyeRegion, FrustumBackface, ItemBuffer, LoadOptions, Resolution, Scratch, load_glb,
    };
    use std::sync::Arc;

    use super::*;

    #[test]
    fn the_tree_has_420_000_triangles() {
        let made = make(&VesselsRules::default()).unwrap();
        assert!((400_000..440_000).contains(&made.triangles), "{}", made.triangles);
        assert_eq!(made.triangles, 2_047 * 2 * 8 * 13);
        assert!(made.cameras.cameras.len() >= 160);
    }

    #[test]
    fn hardly_a_pixel_has_vessels_behind_its_own() {
        let made = make(&VesselsRules { levels: 8, cameras: 9, seed: 1 }).unwrap();
        let scene = Arc::new(load_glb(&made.glb, "vessels", &LoadOptions::default()).unwrap());
        let facing = FrustumBackface::new(scene.clone());
        let (mut covered, mut tests) = (0, 0);
        for view in made.cameras.views(scene.anchor(), Resolution::new(256, 256)) {
            let visible = facing.cull(&view, EyeRegion::point(view.eye), &mut Scratch::default()).visible;
            let mut items = ItemBuffer::new(&view);
            items.draw(&scene, &visible);
            covered += items.ids().iter().filter(|id| **id != ItemBuffer::NONE).count() as u64;
            tests += items.z_tests();
        }
        assert!(covered > 10_000 && tests * 10 < covered * 15, "{tests} tests for {covered} pixels");
    }

    #[test]
    fn same_rules_same_bytes_and_bad_rules_are_named() {
        let rules = VesselsRules { levels: 3, cameras: 3, seed: 2 };
        let (a, b) = (make(&rules).unwrap(), make(&rules).unwrap());
        assert!(a.glb == b.glb && a.cameras == b.cameras && a.triangles == 7 * 208);
        assert!(make(&VesselsRules { seed: 4, ..rules.clone() }).unwrap().glb != a.glb);
        let message = make(&VesselsRules { levels: 17, ..rules }).unwrap_err().to_string();
        assert!(message.contains("levels = 17: give 1 to 16"));
    }
}
