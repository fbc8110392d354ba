//! The maker `seminar`: one room full of chairs, about 45,000 triangles (the ROOM of Klosowski & Silva 2000, §5, in spirit).
//!
//! Rows of chairs of 256 triangles with an aisle between them, a table at the front, and walls in panels that face inward. From the door
//! one sees the backs of a few chairs, from under the ceiling nearly all: the visible set varies along the path from a few hundred
//! triangles to a fifth of the room, which is what makes it hard. All materials are single-sided.
//!
//! The path of 235 views is fixed: along the aisle at the height of who sits, up to the ceiling and over the rows, and down
//! among them.

use std::f64::consts::{FRAC_PI_2, PI};

use glam::{DQuat, DVec3, Vec3};
use rand::RngExt;

use super::furniture::pieces;
use super::glb::{GlbWriter, Node, Triangles};
use super::made::{CAMERAS_MAX, MadeError, MadeModel, check};
use super::patch::push_patch;
use crate::chance;
use crate::cull::{CameraPath, Stop};

/// From chair to chair along x and z.
const DISTANCE: (f64, f64) = (0.9, 0.7);
/// Width of the aisle, free space at the sides and behind, and before the first row.
const AISLE: f64 = 1.2;
const MARGIN: f64 = 1.2;
const FRONT: f64 = 2.6;
const HEIGHT: f64 = 3.5;
/// Panels of walls, floor and ceiling, per metre.
const PANELS: f64 = 2.0;

/// What the maker `seminar` is asked for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SeminarRules {
    /// Chairs in a row, half of them on each side of the aisle. Default 12.
    pub columns: u32,
    /// Rows of chairs. Default 13: with 12 columns about 45,000 triangles.
    pub rows: u32,
    /// Views of the path, which is cut finer or coarser. Default 235.
    pub cameras: u32,
    /// Decides how chairs are left. Default 1.
    pub seed: u64,
}

impl Default for SeminarRules {
    fn default() -> SeminarRules {
        SeminarRules { columns: 12, rows: 13, cameras: 235, seed: 1 }
    }
}

impl SeminarRules {
    /// Width and depth of the room.
    fn size(&self) -> (f64, f64) {
        let width = f64::from(self.columns - 1) * DISTANCE.0 + AISLE + 2.0 * MARGIN;
        (width, f64::from(self.rows - 1) * DISTANCE.1 + FRONT + MARGIN)
    }
}

/// Makes the room. The same rules give the same bytes.
///
/// # Errors
/// Names the rule that no model can follow.
pub fn make(rules: &SeminarRules) -> Result<MadeModel, MadeError> {
    check("columns", rules.columns, 1, 200)?;
    check("rows", rules.rows, 1, 200)?;
    check("cameras", rules.cameras, 0, CAMERAS_MAX)?;
    let mut writer = GlbWriter::new();
    let mut chance = chance(rules.seed, 71);
    let plaster = writer.material("plaster", [0.7, 0.7, 0.66], false);
    let oak = writer.material("oak", [0.45, 0.28, 0.13], false);
    let (width, depth) = rules.size();
    let walls = writer.mesh("walls", &walls(width, depth), Some(plaster))?;
    let still = DQuat::IDENTITY;
    writer.node(Node { name: "walls".into(), mesh: Some(walls), translation: DVec3::ZERO, rotation: still })?;
    let pieces = pieces();
    for piece in pieces.iter().filter(|piece| ["chair", "desk"].contains(&piece.name)) {
        let mesh = writer.mesh(piece.name, &piece.mesh, Some(oak))?;
        if piece.name == "desk" {
            for number in 0..2 {
                let translation = DVec3::new(width * 0.5 - 0.6 + 1.2 * f64::from(number), 0.0, 1.0);
                writer.node(Node { name: format!("desk.{number}"), mesh: Some(mesh), translation, rotation: still })?;
            }
            continue;
        }
        for row in 0..rules.rows {
            for column in 0..rules.columns {
                let past_aisle = if column >= rules.columns.div_ceil(2) { AISLE } else { 0.0 };
                let mut off = |reach: f64| chance.random_range(-reach..reach);
                // As people leave them: a chair is 0.4 m wide and deep, so that neighbours never meet.
                let x = MARGIN + f64::from(column) * DISTANCE.0 + past_aisle + off(0.08);
                let z = FRONT + f64::from(row) * DISTANCE.1 + off(0.06);
                let rotation = DQuat::from_rotation_y(off(0.3));
                let name = format!("chair.{row}.{column}");
                writer.node(Node { name, mesh: Some(mesh), translation: DVec3::new(x, 0.0, z), rotation })?;
            }
        }
    }
    let triangles = writer.triangles();
    Ok(MadeModel { glb: writer.finish()?, triangles, cameras: path(rules) })
}

/// Floor, ceiling and walls, seen from inside.
fn walls(width: f64, depth: f64) -> Triangles {
    let mut mesh = Triangles::default();
    let [x, y, z] = [width, HEIGHT, depth].map(|side| side as f32);
    let [nx, ny, nz] = [width, HEIGHT, depth].map(|side| (side * PANELS).round().max(1.0) as u32);
    let [along_x, up, along_z] = [Vec3::X * x, Vec3::Y * y, Vec3::Z * z];
    push_patch(&mut mesh, Vec3::ZERO, along_z, along_x, [nz, nx]);
    push_patch(&mut mesh, up, along_x, along_z, [nx, nz]);
    push_patch(&mut mesh, Vec3::ZERO, along_x, up, [nx, ny]);
    push_patch(&mut mesh, along_z, up, along_x, [ny, nx]);
    push_patch(&mut mesh, Vec3::ZERO, up, along_z, [ny, nz]);
    push_patch(&mut mesh, along_x, along_z, up, [nz, ny]);
    mesh
}

fn path(rules: &SeminarRules) -> CameraPath {
    let (width, depth) = rules.size();
    // The middle of the aisle.
    let aisle = MARGIN + f64::from(rules.columns.div_ceil(2)) * DISTANCE.0 - 0.5 * DISTANCE.0 + 0.5 * AISLE;
    let eye = |x: f64, y: f64, z: f64| DVec3::new(x, y, z);
    let stops: Vec<Stop> = vec![
        (0.00, eye(aisle, 1.6, depth - 0.5), 0.0, -0.1),
        (0.20, eye(aisle, 1.15, FRONT + 0.5), 0.3, -0.05),
        (0.30, eye(aisle, 1.6, FRONT - 0.8), PI, -0.1),
        (0.45, eye(0.4, 3.2, 0.4), PI + 0.7, -0.45),
        (0.60, eye(width - 0.4, 3.2, 0.5), PI - 0.7, -0.4),
        (0.75, eye(width - 0.4, 2.4, depth - 0.5), FRAC_PI_2 - 0.6, -0.35),
        (0.88, eye(width * 0.75, 1.2, depth - 0.5), 0.2, -0.1),
        (1.00, eye(aisle, 1.1, depth * 0.5), 0.8, -0.3),
    ];
    CameraPath::through(&stops, rules.cameras)
}

#[cfg(test)]
mod tests {
    use eyeline_visibility::{LoadOptions, RayScene, Resolution, exact_set, load_glb};

    use super::*;

    #[test]
    fn a_room_of_45_000_triangles_whose_visible_set_varies() {
        let made = make(&SeminarRules { cameras: 24, ..SeminarRules::default() }).unwrap();
        assert!((43_000..47_000).contains(&made.triangles), "{}", made.triangles);
        assert!(SeminarRules::default().cameras >= 160);
        let scene = load_glb(&made.glb, "seminar", &LoadOptions::default()).unwrap();
        let (rays, mut shares) = (RayScene::new(&scene), Vec::new());
        for view in made.cameras.views(scene.anchor(), Resolution::new(256, 256)) {
            let free = |way: DVec3| rays.first_hit(view.eye, way, 0.0, 0.1).is_none();
            assert!([DVec3::X, DVec3::NEG_X, DVec3::Z, DVec3::NEG_Z, DVec3::NEG_Y].into_iter().all(free));
            shares.push(exact_set(&scene, &view).0.len() as f64 / made.triangles as f64);
        }
        // The paper's room: 1 to 20 % along its path.
        let (least, most) = shares.iter().fold((1.0_f64, 0.0_f64), |(a, b), &share| (a.min(share), b.max(share)));
        assert!(least < 0.04 && most > 3.0 * least && most < 0.3, "{least} {most}");
    }

    #[test]
    fn same_rules_same_bytes_and_bad_rules_are_named() {
        let rules = SeminarRules { columns: 2, rows: 2, cameras: 3, seed: 2 };
        let (a, b) = (make(&rules).unwrap(), make(&rules).unwrap());
        assert!(a.glb == b.glb && a.cameras == b.cameras);
        assert!(make(&SeminarRules { seed: 4, ..rules.clone() }).unwrap().glb != a.glb);
        let message = make(&SeminarRules { rows: 0, ..rules }).unwrap_err().to_string();
        assert!(message.contains("rows = 0: give 1 to 200"));
    }
}
