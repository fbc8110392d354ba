//! The maker `tower`: 54 modules on top of each other, for depth complexity (Klosowski & Silva 2001, §5: a skyscraper of 54
//! copies of a module, each of almost 20 thousand triangles, seen from inside).
//!
//! A module is a storey of 60 × 60 m: twelve rooms of 15 × 15 m around a gallery, and in the middle an atrium of 20 × 20 m that
//! goes through all storeys. Modules differ by a quarter turn and by which furniture stands where.
//!
//! Depth complexity comes from looking up and down: each storey below fills the picture once more. So the cameras at the rail
//! look steeply down or up, past the rails of many galleries, and those in rooms down or up a little.

use std::f64::consts::{FRAC_PI_2, PI};

use glam::{DQuat, DVec2, DVec3};
use rand::RngExt;
use rand_pcg::Pcg64;

use super::furniture::pieces;
use super::glb::{GlbWriter, MeshId, Node, Triangles};
use super::made::{CAMERAS_MAX, MadeError, MadeModel, check, solid};
use crate::chance;
use crate::cull::{Camera, CameraPath};

/// Height of a module and thickness of its floor.
const STOREY: f64 = 3.4;
const SLAB: f64 = 0.3;
const WALL: f64 = 0.2;
const SUNK: f64 = 0.1;
const DOOR: (f64, f64) = (1.2, 2.2);
/// Half sides: of the tower, of the gallery with the atrium, of the atrium. The origin is the atrium's middle.
const HALF: f64 = 30.0;
const INNER: f64 = 15.0;
const ATRIUM: f64 = 10.0;
/// Pieces of furniture in each of a module's rooms.
const PIECES: u32 = 5;
/// From baluster to baluster of the rail, its height, half a baluster's side.
const BALUSTER: (f64, f64, f64) = (0.4, 1.0, 0.02);
const EYE_HEIGHT: f64 = 1.6;

/// What the maker `tower` is asked for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TowerRules {
    /// Modules on top of each other. Default 54: about a million triangles.
    pub modules: u32,
    /// Cameras on galleries and in rooms. Default 200.
    pub cameras: u32,
    /// Decides doors, furniture, turns and cameras. Default 1.
    pub seed: u64,
}

impl Default for TowerRules {
    fn default() -> TowerRules {
        TowerRules { modules: 54, cameras: 200, seed: 1 }
    }
}

/// Makes the tower. The same rules give the same bytes.
///
/// # Errors
/// Names the rule that no model can follow.
pub fn make(rules: &TowerRules) -> Result<MadeModel, MadeError> {
    check("modules", rules.modules, 1, 500)?;
    check("cameras", rules.cameras, 0, CAMERAS_MAX)?;
    let mut writer = GlbWriter::new();
    let mut places = chance(rules.seed, 41);
    let concrete = writer.material("concrete", [0.6, 0.6, 0.6], false);
    let steel = writer.material("steel", [0.35, 0.4, 0.45], false);
    let oak = writer.material("oak", [0.45, 0.28, 0.13], false);
    let parts = [
        ("shell", writer.mesh("shell", &shell(&mut places), Some(concrete))?),
        ("rail", writer.mesh("rail", &rail(), Some(steel))?),
    ];
    let furniture: Vec<MeshId> =
        pieces().iter().map(|piece| writer.mesh(piece.name, &piece.mesh, Some(oak))).collect::<Result<_, _>>()?;
    for module in 0..rules.modules {
        let turn = DQuat::from_rotation_y(f64::from(places.random_range(0..4_u32)) * FRAC_PI_2);
        let base = DVec3::Y * (f64::from(module) * STOREY);
        for (name, mesh) in parts {
            let name = format!("{name}.{module}");
            writer.node(Node { name, mesh: Some(mesh), translation: base, rotation: turn })?;
        }
        for (number, (mesh, at, heading)) in furnish(&furniture, &mut places).into_iter().enumerate() {
            writer.node(Node {
                name: format!("object.{module}.{number}"),
                mesh: Some(mesh),
                translation: base + turn * DVec3::new(at.x, 0.0, at.y),
                rotation: (turn * DQuat::from_rotation_y(heading)).normalize(),
            })?;
        }
    }
    let roof = f64::from(rules.modules) * STOREY;
    writer.boxes("roof".into(), concrete, &[solid(DVec2::splat(-HALF), DVec2::splat(HALF), roof - SLAB, roof)])?;
    writer.boxes("ground".into(), concrete, &[solid(DVec2::splat(-ATRIUM), DVec2::splat(ATRIUM), -SLAB, 0.0)])?;
    let cameras = look_around(rules);
    let triangles = writer.triangles();
    Ok(MadeModel { glb: writer.finish()?, triangles, cameras })
}

/// The middle of each room, around the gallery.
fn rooms() -> impl Iterator<Item = DVec2> {
    let cells = (0..16).map(|cell| DVec2::new(f64::from(cell % 4) - 1.5, f64::from(cell / 4) - 1.5) * INNER);
    cells.filter(|middle| middle.abs().max_element() > INNER)
}

/// Floor, outer walls, walls between rooms, walls to the gallery with their doors. Corner rooms open into a neighbour.
fn shell(chance: &mut Pcg64) -> Triangles {
    let (bottom, top) = (-SUNK, STOREY - SLAB + SUNK);
    let half = 0.5 * WALL;
    let mut boxes = Vec::new();
    // A ring of four plates around the atrium.
    for [min, max] in [
        [DVec2::new(-HALF, -HALF), DVec2::new(HALF, -ATRIUM)],
        [DVec2::new(-HALF, ATRIUM), DVec2::new(HALF, HALF)],
        [DVec2::new(-HALF, -ATRIUM), DVec2::new(-ATRIUM, ATRIUM)],
        [DVec2::new(ATRIUM, -ATRIUM), DVec2::new(HALF, ATRIUM)],
    ] {
        boxes.push(solid(min, max, -SLAB, 0.0));
    }
    for quarter in 0..4 {
        // Each side of the tower is the first one turned: walls along x at negative z.
        let turn = DVec2::from_angle(f64::from(quarter) * FRAC_PI_2);
        let mut add = |from: DVec2, to: DVec2, bottom: f64| {
            let exact = |point: DVec2| (turn.rotate(point) * 1e6).round() / 1e6;
            let (a, b) = (exact(from), exact(to));
            boxes.push(solid(a.min(b), a.max(b), bottom, top));
        };
        add(DVec2::new(-HALF, -HALF), DVec2::new(HALF, -HALF + WALL), bottom);
        // Two rooms to the gallery, and the corner room to the first of them.
        for from in [-INNER, 0.0] {
            let door = from + chance.random_range(1.0..INNER - 1.0);
            let opening = (door - 0.5 * DOOR.0, door + 0.5 * DOOR.0);
            add(DVec2::new(from - half, -INNER - half), DVec2::new(opening.0, -INNER + half), bottom);
            add(DVec2::new(opening.1, -INNER - half), DVec2::new(from + INNER + half, -INNER + half), bottom);
            add(DVec2::new(opening.0, -INNER - half), DVec2::new(opening.1, -INNER + half), DOOR.1);
        }
        let door = -HALF + chance.random_range(1.2..INNER - 1.2);
        let opening = (door - 0.5 * DOOR.0, door + 0.5 * DOOR.0);
        add(DVec2::new(-INNER - half, -HALF), DVec2::new(-INNER + half, opening.0), bottom);
        add(DVec2::new(-INNER - half, opening.1), DVec2::new(-INNER + half, -INNER), bottom);
        add(DVec2::new(-INNER - half, opening.0), DVec2::new(-INNER + half, opening.1), DOOR.1);
        for x in [0.0, INNER] {
            add(DVec2::new(x - half, -HALF), DVec2::new(x + half, -INNER), bottom);
        }
    }
    let mut mesh = Triangles::default();
    for (min, max) in boxes {
        mesh.push_box(min.as_vec3(), max.as_vec3());
    }
    mesh
}

/// Balusters and a handrail around the atrium.
fn rail() -> Triangles {
    let (step, height, half) = BALUSTER;
    let mut mesh = Triangles::default();
    let line = ATRIUM + 0.05;
    let mut post = |at: DVec2, half: DVec2, bottom: f64, top: f64| {
        let (min, max) = solid(at - half, at + half, bottom, top);
        mesh.push_box(min.as_vec3(), max.as_vec3());
    };
    let count = (2.0 * line / step).round() as i32;
    for i in 0..count {
        let along = -line + (f64::from(i) + 0.5) * 2.0 * line / f64::from(count);
        for at in [DVec2::new(along, -line), DVec2::new(along, line), DVec2::new(-line, along), DVec2::new(line, along)]
        {
            post(at, DVec2::splat(half), 0.005, height);
        }
    }
    for (at, half) in [
        (DVec2::new(0.0, -line), DVec2::new(line, 0.03)),
        (DVec2::new(0.0, line), DVec2::new(line, 0.03)),
        (DVec2::new(-line, 0.0), DVec2::new(0.03, line)),
        (DVec2::new(line, 0.0), DVec2::new(0.03, line)),
    ] {
        post(at, half, height - 0.02, height + 0.04);
    }
    mesh
}

/// Furniture of a module before its turn: mesh, place and heading. On a circle in each room, clear of walls and doors.
fn furnish(meshes: &[MeshId], chance: &mut Pcg64) -> Vec<(MeshId, DVec2, f64)> {
    let mut placed = Vec::new();
    for middle in rooms() {
        let start = chance.random_range(0.0..1.0);
        for piece in 0..PIECES {
            let angle = (start + f64::from(piece) / f64::from(PIECES)) * 2.0 * PI;
            let at = middle + DVec2::from_angle(angle) * chance.random_range(1.5..5.5);
            placed.push((meshes[chance.random_range(0..meshes.len())], at, chance.random_range(-PI..PI)));
        }
    }
    placed
}

/// Three in four at the rail, looking steeply down or up; the others in rooms.
fn look_around(rules: &TowerRules) -> CameraPath {
    let mut chance = chance(rules.seed, 42);
    let rooms: Vec<DVec2> = rooms().collect();
    let camera = |_| {
        let height = f64::from(chance.random_range(0..rules.modules)) * STOREY + EYE_HEIGHT;
        let (at, pitch) = if chance.random_range(0..4) < 3 {
            let along = chance.random_range(-INNER + 0.4..INNER - 0.4);
            let across = chance.random_range(ATRIUM + 0.2..INNER - 0.4);
            let side = DVec2::from_angle(f64::from(chance.random_range(0..4_u32)) * FRAC_PI_2);
            (side.rotate(DVec2::new(along, across)), chance.random_range(0.8..1.5))
        } else {
            let reach = 0.5 * INNER - 0.5;
            let [x, z] = [(); 2].map(|()| chance.random_range(-reach..reach));
            (rooms[chance.random_range(0..rooms.len())] + DVec2::new(x, z), chance.random_range(0.0..0.8))
        };
        // Down where there is more below than above, else up.
        let down = height > 0.5 * f64::from(rules.modules) * STOREY;
        let pitch = if down { -pitch } else { pitch };
        Camera::rounded(DVec3::new(at.x, height, at.y), chance.random_range(-PI..PI), pitch)
    };
    CameraPath::new((0..rules.cameras).map(camera).collect())
}

#[cfg(test)]
mod tests {
    use eyeline_visibility::{LoadOptions, RayScene, load_file, load_glb};

    use super::*;

    #[test]
    fn fifty_four_modules_have_about_a_million_triangles() {
        let made = make(&TowerRules::default()).unwrap();
        assert!((950_000..1_080_000).contains(&made.triangles), "{}", made.triangles);
        let module = made.triangles / 54;
        assert!((17_000..20_000).contains(&module), "{module}");
    }

    #[test]
    fn same_rules_same_bytes() {
        let rules = TowerRules { modules: 2, ..TowerRules::default() };
        let (a, b) = (make(&rules).unwrap(), make(&rules).unwrap());
        assert!(a.glb == b.glb && a.cameras == b.cameras);
        assert!(make(&TowerRules { seed: 2, ..rules }).unwrap().glb != a.glb);
    }

    #[test]
    fn furniture_stands_in_its_room_and_apart() {
        let pieces = pieces();
        let mut writer = GlbWriter::new();
        let meshes: Vec<MeshId> =
            pieces.iter().map(|piece| writer.mesh(piece.name, &piece.mesh, None).unwrap()).collect();
        assert_eq!(rooms().count(), 12);
        let placed = furnish(&meshes, &mut chance(5, 41));
        let radius = |mesh: MeshId| pieces[meshes.iter().position(|known| *known == mesh).unwrap()].radius;
        for (number, &(mesh, at, _)) in placed.iter().enumerate() {
            let middle = rooms().nth(number / PIECES as usize).unwrap();
            let reach = (at - middle).abs().max_element() + radius(mesh);
            assert!(reach < 0.5 * INNER - 0.5, "piece {number} reaches {reach}");
            for &(other, there, _) in &placed[number + 1..] {
                assert!(at.distance(there) > radius(mesh) + radius(other), "piece {number}");
            }
        }
    }

    #[test]
    fn the_atrium_is_open_from_ground_to_roof_and_rooms_open_to_the_gallery() {
        let made = make(&TowerRules { modules: 5, cameras: 40, seed: 3 }).unwrap();
        let scene = load_glb(&made.glb, "tower", &LoadOptions::default()).unwrap();
        let rays = RayScene::new(&scene);
        let up = rays.first_hit(DVec3::new(1.0, 0.1, 2.0), DVec3::Y, 0.0, 100.0).unwrap();
        assert!((up.t - (5.0 * STOREY - SLAB - 0.1)).abs() < 1e-3);
        // Of rays along each gallery wall, some pass through a door and most do not.
        let mut through = 0;
        for step in 0..1_200 {
            let x = INNER * (f64::from(step) / 600.0 - 1.0) + 0.01;
            let hit = rays.first_hit(DVec3::new(x, 2.0, 0.5 - INNER), DVec3::NEG_Z, 0.0, 0.8);
            through += u32::from(hit.is_none());
        }
        // Two doors of 1.2 m in 30 m.
        assert!((90..=102).contains(&through), "{through} of 1200");
        for camera in &made.cameras.cameras {
            let floor = rays.first_hit(DVec3::from(camera.eye), DVec3::NEG_Y, 0.0, 10.0).unwrap();
            assert!(floor.t <= EYE_HEIGHT + 1e-3);
        }
    }

    #[test]
    fn files_load() {
        let folder = tempfile::tempdir().unwrap();
        let model = folder.path().join("tower.glb");
        let made = make(&TowerRules { modules: 1, cameras: 5, seed: 4 }).unwrap();
        made.write(&model).unwrap();
        assert_eq!(load_file(&model, &LoadOptions::default()).unwrap().triangles().len(), made.triangles);
        assert_eq!(CameraPath::beside(&model).unwrap().unwrap(), made.cameras);
        let message = make(&TowerRules { modules: 0, ..TowerRules::default() }).unwrap_err().to_string();
        assert!(message.contains("modules = 0: give 1 to 500"));
    }
}
