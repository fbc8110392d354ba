//! The maker `rooms`: a building of rooms joined by doors, with a table and four chairs in each (S&G §6).
//!
//! **Made to be culled conservatively.** Walls, lintels, floor and ceiling are convex boxes that overlap; none merely
//! touches another edge to edge. A rasteriser that counts a pixel as covered only where one convex polygon covers all of
//! it loses the pixels on the seam of two polygons; here one of the two goes on behind the other:
//! - a wall is one box from door to door, *through* the walls that it crosses;
//! - above the doors a lintel as long as the whole wall line runs through its pieces, 2 cm thinner on each side so that no
//!   face lies in the plane of another (no tie, no z-fighting);
//! - walls reach 0.3 m below the floor's top and into the ceiling, to a different depth in each direction;
//! - floor and ceiling are one slab each, larger than the building; there are no windows.
//!
//! **Walls are double-sided** for the same reason: at a convex edge (a door jamb) the two faces in front share the pixel,
//! and only the wall's far face, seen from inside, covers it whole. Furniture is single-sided: its boxes are closed, so
//! nobody sees the difference, and back-face culling has something to do.
//!
//! Chairs are instances of one mesh, nodes `chair.N` with their origin on the floor under the middle of the seat, looking
//! along −Z at heading 0. Chairs that move leave their table straight outward by 1 to 1.5 m and return; one in each room
//! wobbles (S&G Fig. 4). They keep clear of walls and table, not of avatars.

use std::f64::consts::{FRAC_PI_2, PI};
use std::path::Path;

use anyhow::Context;
use eyeline_server::path::{PathError, paths_of};
use eyeline_server::spec::{AvatarSpec, ClassSpec, ObjectSpec, PathSpec, SpawnSpec, WorldSpec};
use glam::{DQuat, DVec2, DVec3, Vec3};
use rand::RngExt;
use rand::seq::SliceRandom;

use super::glb::{GlbError, GlbWriter, Node, Triangles};
use super::plan::{
    CHAIR_CLEAR, CHAIR_GAP, CHAIR_RADIUS, CHAIR_WAY, PlanError, Rect, Room, RoomPlan, RoomsRules, TABLE_HALF,
};
use crate::chance;

/// How far walls go below the floor's top, at least.
const FOUNDATION: f64 = 0.3;
/// Thickness of the floor and of the ceiling.
const SLAB: f64 = 0.5;
/// How far the slabs reach over the outer walls' middle.
const EAVES: f64 = 0.5;
/// How much thinner a lintel is than its wall, on each side.
const RECESS: f64 = 0.02;
/// Class of the chairs.
const CHAIR: &str = "chair";
/// Greatest speed of a chair. The fastest path stays below: at 0.6 m/s over 1.25 m, where a wobble of 2.5 half swings is
/// rounded to 3, it reaches 0.6·√(1 + (0.12·π·3/1.25)²) = 0.809 m/s.
const CHAIR_SPEED_MAX: f64 = 0.85;
/// Least and greatest speed along a chair's path.
const CHAIR_SPEED: (f64, f64) = (0.3, 0.6);
/// Longest rest of a chair at one end, as a share of the time that its way takes: it moves at least 1/1.3 of the time.
const CHAIR_PAUSE: f64 = 0.3;
/// Amplitude of a wobbling chair, and its swings a metre.
const WOBBLE: (f64, f64) = (0.12, 1.0);
/// Distance of a spawn point from the two walls of its corner.
const SPAWN_INSET: f64 = 0.6;

/// A scene in memory, ready to be served or written.
#[derive(Clone, Debug)]
pub struct MadeScene {
    /// The model.
    pub glb: Vec<u8>,
    /// What moves in it and where avatars start.
    pub world: WorldSpec,
    /// Rooms, doors and obstacles, for walkers.
    pub plan: RoomPlan,
    /// Triangles of the model, instances counted each time.
    pub triangles: usize,
}

/// Why a scene cannot be made.
#[derive(Debug, thiserror::Error)]
pub enum RoomsError {
    /// The rules make no building.
    #[error(transparent)]
    Plan(#[from] PlanError),
    /// The building makes no file.
    #[error(transparent)]
    Glb(#[from] GlbError),
    /// A chair would be faster than its class.
    #[error(transparent)]
    Path(#[from] PathError),
}

/// Makes a building. The same rules give the same bytes.
pub fn make(rules: &RoomsRules) -> Result<MadeScene, RoomsError> {
    let plan = RoomPlan::new(rules)?;
    let mut world = WorldSpec {
        two_sided: false,
        name: format!("rooms {}×{} seed {}", rules.columns, rules.rows, rules.seed),
        // Walkers keep to 1.5 m/s; a tight bound is worth messages.
        avatar: AvatarSpec { speed_max: 1.6, ..AvatarSpec::default() },
        spawns: spawns(&plan),
        classes: Vec::new(),
        objects: Vec::new(),
    };
    if rules.furnished {
        let (radius, top) = (CHAIR_RADIUS, 0.95);
        world.classes.push(ClassSpec { name: CHAIR.into(), radius, bottom: 0.0, top, speed_max: CHAIR_SPEED_MAX });
        world.objects = chairs(&plan);
        paths_of(&world)?;
    }
    let mut writer = GlbWriter::new();
    build_shell(&plan, &mut writer)?;
    if rules.furnished {
        furnish(&plan, &world.objects, &mut writer)?;
    }
    let triangles = writer.triangles();
    Ok(MadeScene { glb: writer.finish()?, world, plan, triangles })
}

impl MadeScene {
    /// Writes the model and, beside it, `.world.toml` and `.rooms.json` (the rules, for [`RoomPlan::beside`]).
    pub fn write(&self, model: &Path) -> anyhow::Result<()> {
        if let Some(folder) = model.parent().filter(|folder| !folder.as_os_str().is_empty()) {
            std::fs::create_dir_all(folder).with_context(|| format!("cannot make the folder {}", folder.display()))?;
        }
        let files = [
            (model.to_owned(), self.glb.clone()),
            (model.with_extension("world.toml"), toml::to_string(&self.world)?.into_bytes()),
            (model.with_extension("rooms.json"), serde_json::to_vec_pretty(&self.plan.rules)?),
        ];
        for (path, bytes) in files {
            std::fs::write(&path, bytes).with_context(|| format!("cannot write {}", path.display()))?;
        }
        Ok(())
    }
}

/// Every box of the building itself, with its name: floor, ceiling, walls, lintels.
fn shell(plan: &RoomPlan) -> Vec<(String, DVec3, DVec3)> {
    let rules = &plan.rules;
    let size = DVec2::new(f64::from(rules.columns), f64::from(rules.rows)) * rules.room;
    let slab = Rect { min: DVec2::splat(-EAVES), max: size + EAVES };
    let solid = |name: String, plan: Rect, bottom: f64, top: f64| {
        (name, DVec3::new(plan.min.x, bottom, plan.min.y), DVec3::new(plan.max.x, top, plan.max.y))
    };
    let mut boxes =
        vec![solid("floor".into(), slab, -SLAB, 0.0), solid("ceiling".into(), slab, rules.height, rules.height + SLAB)];
    let (mut walls, mut lintels) = (0, 0);
    for line in &plan.lines {
        // A different depth for each kind, so that crossing boxes share no plane.
        let depth = FOUNDATION + 0.04 * f64::from(u8::from(line.outer)) + 0.02 * f64::from(u8::from(line.along_x));
        for piece in line.pieces(rules.door_width) {
            let footprint = line.footprint(piece, rules.wall);
            boxes.push(solid(format!("wall.{walls}"), footprint, -depth, rules.height + depth));
            walls += 1;
        }
        if !line.doors.is_empty() {
            let thickness = rules.wall - 2.0 * RECESS.min(0.1 * rules.wall);
            let shorter = 0.05 * rules.wall;
            let span = (line.span.0 + shorter, line.span.1 - shorter);
            let top = rules.height + depth - 0.1;
            let footprint = line.footprint(span, thickness);
            boxes.push(solid(format!("lintel.{lintels}"), footprint, rules.door_height, top));
            lintels += 1;
        }
    }
    boxes
}

fn build_shell(plan: &RoomPlan, writer: &mut GlbWriter) -> Result<(), GlbError> {
    let floor = writer.material("floor", [0.42, 0.33, 0.25], true);
    let ceiling = writer.material("ceiling", [0.85, 0.85, 0.83], true);
    let wall = writer.material("wall", [0.74, 0.72, 0.66], true);
    for (name, min, max) in shell(plan) {
        let material = match name.as_str() {
            "floor" => floor,
            "ceiling" => ceiling,
            _ => wall,
        };
        // The node carries the f64 place and the mesh what is small. Each coordinate that two boxes share (the two
        // faces of a wall line) comes from the same sum, so they agree to the last bit.
        let center = (min + max) * 0.5;
        let mut triangles = Triangles::default();
        triangles.push_box((min - center).as_vec3(), (max - center).as_vec3());
        let mesh = writer.mesh(&name, &triangles, Some(material))?;
        writer.node(Node { name, mesh: Some(mesh), translation: center, rotation: DQuat::IDENTITY })?;
    }
    Ok(())
}

fn furnish(plan: &RoomPlan, chairs: &[ObjectSpec], writer: &mut GlbWriter) -> Result<(), GlbError> {
    let oak = writer.material("oak", [0.45, 0.28, 0.13], false);
    let cloth = writer.material("cloth", [0.16, 0.30, 0.42], false);
    let table = writer.mesh("table", &table_mesh(), Some(oak))?;
    let chair = writer.mesh("chair", &chair_mesh(), Some(cloth))?;
    for (number, room) in plan.rooms.iter().enumerate() {
        let Some(top) = room.table else { continue };
        let turn = if room.table_along_x { 0.0 } else { FRAC_PI_2 };
        let name = format!("table.{number}");
        let translation = on_floor(top.center());
        writer.node(Node { name, mesh: Some(table), translation, rotation: DQuat::from_rotation_y(turn) })?;
    }
    for object in chairs {
        let rotation = DQuat::from_rotation_y(object.heading);
        let translation = DVec3::from(object.position);
        writer.node(Node { name: object.name.clone(), mesh: Some(chair), translation, rotation })?;
    }
    Ok(())
}

/// 60 triangles: a top and four legs that stand a little in the floor. Origin on the floor, long side along x.
fn table_mesh() -> Triangles {
    let half = TABLE_HALF.as_vec2();
    let mut mesh = Triangles::default();
    mesh.push_box(Vec3::new(-half.x, 0.7, -half.y), Vec3::new(half.x, 0.74, half.y));
    push_legs(&mut mesh, half.x - 0.08, half.y - 0.08, 0.03, (-0.05, 0.72));
    mesh
}

/// 72 triangles: seat, back and four legs. The legs end 5 mm above the floor, so that no face lies in the floor's plane.
fn chair_mesh() -> Triangles {
    let mut mesh = Triangles::default();
    mesh.push_box(Vec3::new(-0.21, 0.43, -0.21), Vec3::new(0.21, 0.47, 0.21));
    mesh.push_box(Vec3::new(-0.2, 0.45, 0.165), Vec3::new(0.2, 0.95, 0.205));
    push_legs(&mut mesh, 0.175, 0.175, 0.02, (0.005, 0.45));
    mesh
}

fn push_legs(mesh: &mut Triangles, x: f32, z: f32, half: f32, (bottom, top): (f32, f32)) {
    for (x, z) in [(-x, -z), (x, -z), (-x, z), (x, z)] {
        mesh.push_box(Vec3::new(x - half, bottom, z - half), Vec3::new(x + half, top, z + half));
    }
}

/// Four chairs a room, of which `moving_share` have a path: the same number in every room, give or take one.
fn chairs(plan: &RoomPlan) -> Vec<ObjectSpec> {
    let mut chance = chance(plan.rules.seed, 3);
    let moving_until = |rooms: usize| (plan.rules.moving_share * 4.0 * rooms as f64).round() as usize;
    let mut objects = Vec::with_capacity(4 * plan.rooms.len());
    for (number, room) in plan.rooms.iter().enumerate() {
        let Some(table) = room.table else { continue };
        let moving = moving_until(number + 1) - moving_until(number);
        let mut sides = [DVec2::X, DVec2::Y, DVec2::NEG_X, DVec2::NEG_Y];
        // The first in this order move and the very first wobbles, so neither is always on the same side.
        sides.shuffle(&mut chance);
        for (order, side) in sides.into_iter().enumerate() {
            let path = chair_path(room, table, side, order == 0, &mut chance);
            let [start, _] = path.points[..] else { unreachable!("a chair's path has two ends") };
            let name = format!("{CHAIR}.{}", objects.len());
            objects.push(ObjectSpec {
                name,
                class: CHAIR.into(),
                node: None,
                position: start,
                // It looks along (−sin h, −cos h), which is toward the table.
                heading: side.x.atan2(side.y),
                takeable: true,
                path: (order < moving).then_some(path),
            });
        }
    }
    objects
}

fn chair_path(room: &Room, table: Rect, side: DVec2, wobbles: bool, chance: &mut rand_pcg::Pcg64) -> PathSpec {
    let table_half = (table.max - table.min) * 0.5;
    let start = table.center() + side * (table_half.dot(side.abs()) + CHAIR_GAP);
    let room_half = (room.clear.max - room.clear.min) * 0.5;
    let free = room_half.dot(side.abs()) - (start - room.clear.center()).dot(side) - CHAIR_RADIUS - CHAIR_CLEAR;
    let way = chance.random_range(CHAIR_WAY.0..CHAIR_WAY.1).min(free);
    let speed = chance.random_range(CHAIR_SPEED.0..CHAIR_SPEED.1);
    let pause = chance.random_range(0.2 * CHAIR_PAUSE..CHAIR_PAUSE) * way / speed;
    let phase = chance.random_range(0.0..1.0);
    let (wobble, wobble_per_metre) = if wobbles { WOBBLE } else { (0.0, 0.0) };
    let points = [start, start + side * way].map(|point| on_floor(point).to_array()).to_vec();
    PathSpec { points, speed, pause, phase, wobble, wobble_per_metre, spring: None }
}

/// Four spawn points a room, in its corners, away from table and chairs. The first ones are all in different rooms.
fn spawns(plan: &RoomPlan) -> Vec<SpawnSpec> {
    let mut chance = chance(plan.rules.seed, 4);
    let mut order: Vec<usize> = (0..plan.rooms.len()).collect();
    order.shuffle(&mut chance);
    let first: Vec<usize> = order.iter().map(|_| chance.random_range(0..4)).collect();
    (0..4)
        .flat_map(|turn| order.iter().zip(&first).map(move |(&room, first)| (room, (first + turn) % 4)))
        .map(|(room, corner)| {
            let clear = plan.rooms[room].clear;
            let position = clear.grown(-SPAWN_INSET).corners()[corner];
            let inward = clear.center() - position;
            let heading = (-inward.x).atan2(-inward.y) + chance.random_range(-0.25..0.25) * PI;
            SpawnSpec { position: on_floor(position).to_array(), heading }
        })
        .collect()
}

fn on_floor(point: DVec2) -> DVec3 {
    DVec3::new(point.x, 0.0, point.y)
}

#[cfg(test)]
mod tests {
    use glam::Vec3Swizzles;

    use super::*;

    fn small() -> RoomsRules {
        RoomsRules { columns: 3, rows: 3, ..RoomsRules::default() }
    }

    #[test]
    fn default_scene_loads_and_has_what_it_promises() {
        let scene = make(&RoomsRules::default()).unwrap();
        let file = gltf::Gltf::from_slice(&scene.glb).unwrap();
        assert_eq!(file.nodes().filter(|n| n.name().unwrap().starts_with("chair.")).count(), 400);
        assert_eq!(file.nodes().filter(|n| n.name().unwrap().starts_with("table.")).count(), 100);
        let walls = file.nodes().filter(|n| n.name().unwrap().starts_with("wall.")).count();
        assert_eq!(walls, 4 + 18 * 11);
        assert_eq!(scene.triangles, 12 * (2 + walls + 18) + 100 * 60 + 400 * 72);
        assert_eq!(scene.world.objects.len(), 400);
        assert_eq!(scene.world.spawns.len(), 400);
        // The nodes stand where the world file says that the chairs are.
        for object in &scene.world.objects {
            let node = file.nodes().find(|n| n.name() == Some(&object.name)).unwrap();
            let at = node.transform().decomposed().0;
            assert_eq!(at, object.position.map(|v| v as f32));
        }
    }

    #[test]
    fn same_rules_same_bytes() {
        let (a, b) = (make(&small()).unwrap(), make(&small()).unwrap());
        assert!(a.glb == b.glb && a.world == b.world);
    }

    #[test]
    fn every_size_and_switch_makes_a_valid_file() {
        for (columns, rows, furnished, moving_share) in
            [(1, 1, true, 1.0), (1, 1, false, 0.5), (1, 5, true, 0.0), (4, 2, true, 0.3), (2, 3, false, 1.0)]
        {
            let rules = RoomsRules { columns, rows, furnished, moving_share, ..RoomsRules::default() };
            let scene = make(&rules).unwrap();
            gltf::Gltf::from_slice(&scene.glb).unwrap();
            let moving = scene.world.objects.iter().filter(|o| o.path.is_some()).count();
            let chairs = if furnished { 4 * columns * rows } else { 0 };
            assert_eq!(scene.world.objects.len(), chairs as usize);
            assert_eq!(moving, (moving_share * f64::from(chairs)).round() as usize);
        }
    }

    #[test]
    fn files_read_back_as_the_same_world_and_plan() {
        let folder = tempfile::tempdir().unwrap();
        let model = folder.path().join("made/rooms.glb");
        let scene = make(&RoomsRules { seed: u64::MAX, ..small() }).unwrap();
        scene.write(&model).unwrap();
        let text = std::fs::read_to_string(model.with_extension("world.toml")).unwrap();
        assert_eq!(toml::from_str::<WorldSpec>(&text).unwrap(), scene.world);
        assert_eq!(RoomPlan::beside(&model).unwrap(), Some(scene.plan));
        assert_eq!(RoomPlan::beside(&folder.path().join("other.glb")).unwrap(), None);
        std::fs::write(model.with_extension("rooms.json"), "{\"columns\": 3,\n\"rooms\": 4}").unwrap();
        let error = RoomPlan::beside(&model).unwrap_err().to_string();
        assert!(error.contains("rooms.rooms.json") && error.contains("line 2"), "{error}");
    }

    #[test]
    fn meshes_have_the_stated_triangles_and_fit_their_class() {
        assert_eq!((table_mesh().len(), chair_mesh().len()), (60, 72));
        for corner in chair_mesh().positions {
            assert!(f64::from(corner.x).hypot(f64::from(corner.z)) <= CHAIR_RADIUS);
            assert!((0.0..=0.95).contains(&corner.y));
        }
    }

    #[test]
    fn chairs_never_enter_walls_or_tables_and_move_most_of_the_time() {
        for (room, seed) in [(4.95, 1), (6.0, 2), (6.0, 3), (9.0, 4)] {
            let rules = RoomsRules { room, seed, moving_share: 1.0, ..small() };
            let scene = make(&rules).unwrap();
            let paths = paths_of(&scene.world).unwrap();
            for (number, path) in paths.iter().enumerate() {
                let path = path.as_ref().unwrap();
                let room = &scene.plan.rooms[number / 4];
                let (mut nearest, mut farthest) = (f64::INFINITY, 0.0_f64);
                for step in 0..1_000 {
                    let position = path.pose_at(f64::from(step) * 0.05).0.xz();
                    assert!(room.clear.grown(-CHAIR_RADIUS).contains(position), "chair {number} in a wall");
                    let distance = room.table.unwrap().distance(position);
                    assert!(distance >= CHAIR_RADIUS, "chair {number} in its table");
                    (nearest, farthest) = (nearest.min(distance), farthest.max(distance));
                }
                assert!(nearest < CHAIR_GAP + 0.05 && farthest > CHAIR_GAP + 0.95);
                assert!(path.moving_share() >= 0.7, "{}", path.moving_share());
            }
            let wobbling = scene.world.objects.iter().filter(|o| o.path.as_ref().unwrap().wobble > 0.0).count();
            assert_eq!(wobbling, scene.plan.rooms.len());
        }
    }

    #[test]
    fn no_chair_of_any_building_is_faster_than_its_class() {
        // Every way that a chair may draw, in steps of a millimetre, at the greatest speed: a building of 100×100 rooms
        // once had a chair that was too fast.
        let mut fastest = 0.0_f64;
        for millimetres in 999..=1_500 {
            let points = vec![[0.0; 3], [f64::from(millimetres) * 1e-3, 0.0, 0.0]];
            let (wobble, wobble_per_metre) = WOBBLE;
            let spec = PathSpec {
                points,
                speed: CHAIR_SPEED.1,
                pause: 0.0,
                phase: 0.0,
                wobble,
                wobble_per_metre,
                spring: None,
            };
            fastest = fastest.max(eyeline_server::path::Path::new(&spec, 0.0, "chair").unwrap().speed_bound());
        }
        assert!((0.8..CHAIR_SPEED_MAX).contains(&fastest), "{fastest}");
        make(&RoomsRules { columns: 70, rows: 70, ..RoomsRules::default() }).unwrap();
    }

    #[test]
    fn chairs_look_at_their_table() {
        let scene = make(&small()).unwrap();
        for (number, object) in scene.world.objects.iter().enumerate() {
            let table = scene.plan.rooms[number / 4].table.unwrap();
            let look = DVec2::new(-object.heading.sin(), -object.heading.cos());
            let to_table = table.center() - DVec3::from(object.position).xz();
            assert!(look.dot(to_table.normalize()) > 0.999);
        }
    }

    #[test]
    fn avatars_start_clear_of_everything() {
        let scene = make(&RoomsRules::default()).unwrap();
        let avatar = scene.world.avatar;
        let paths = paths_of(&scene.world).unwrap();
        let mut first_rooms = std::collections::BTreeSet::new();
        for (number, spawn) in scene.world.spawns.iter().enumerate() {
            let position = DVec3::from(spawn.position).xz();
            let index = scene.plan.room_at(position).unwrap();
            let room = &scene.plan.rooms[index];
            assert!(room.clear.grown(-avatar.radius).contains(position));
            assert!(room.table.unwrap().distance(position) > 1.0);
            for (chair, path) in scene.world.objects.iter().zip(&paths).skip(4 * index).take(4) {
                for step in 0..200 {
                    let at = path.as_ref().map_or(DVec3::from(chair.position), |p| p.pose_at(f64::from(step) * 0.1).0);
                    assert!(at.xz().distance(position) > CHAIR_RADIUS + avatar.radius);
                }
            }
            if number < 100 {
                assert!(first_rooms.insert(index), "two of the first spawn points are in room {index}");
            }
        }
    }

    /// Distance along a ray at which it enters a box, if it does.
    fn enter(eye: DVec3, ray: DVec3, (min, max): (DVec3, DVec3)) -> Option<f64> {
        let (a, b) = ((min - eye) / ray, (max - eye) / ray);
        let (enter, leave) = (a.min(b).max_element(), a.max(b).min_element());
        (enter <= leave && enter > 0.0).then_some(enter)
    }

    /// The promise of this module's head: each pixel whose rays all end in the walls, jambs included, of the eye's own room
    /// is wholly covered by one face (of either side of a box), not far behind the nearest.
    #[test]
    fn one_face_covers_each_walled_pixel() {
        let scene = make(&RoomsRules { furnished: false, ..small() }).unwrap();
        let boxes: Vec<(DVec3, DVec3)> = shell(&scene.plan).into_iter().map(|(_, min, max)| (min, max)).collect();
        let pixel = 2.0 / 320.0;
        let mut chance = chance(11, 0);
        let (mut walled, mut seams) = (0, 0);
        while walled < 300_000 {
            let room = scene.plan.rooms[4].clear.grown(-0.3);
            let eye = DVec3::new(
                chance.random_range(room.min.x..room.max.x),
                chance.random_range(0.3..2.7),
                chance.random_range(room.min.y..room.max.y),
            );
            let turn = DQuat::from_rotation_y(chance.random_range(-PI..PI))
                * DQuat::from_rotation_x(chance.random_range(-1.0..1.0));
            let at = DVec2::new(chance.random_range(-1.0..1.0), chance.random_range(-0.75..0.75));
            let rays = Rect { min: at, max: at + pixel }.corners().map(|p| turn * DVec3::new(p.x, p.y, -1.0));
            let first = rays.map(|ray| {
                let hits = boxes.iter().enumerate().filter_map(|(i, &b)| enter(eye, ray, b).map(|t| (t, i)));
                hits.min_by(|a, b| a.0.total_cmp(&b.0)).expect("the building is closed")
            });
            let near = scene.plan.rooms[4].clear.grown(1e-6);
            if !rays.iter().zip(&first).all(|(ray, hit)| near.grown(0.19).contains((eye + ray * hit.0).xz())) {
                continue;
            }
            walled += 1;
            seams += usize::from(first.iter().any(|hit| hit.1 != first[0].1));
            let behind = |ray: &DVec3, t: f64| {
                let point = eye + *ray * t;
                near.distance(point.xz()) <= 1.0 && (-0.6..=3.6).contains(&point.y)
            };
            let covered = boxes.iter().any(|&(min, max)| {
                (0..3).any(|axis| {
                    [min[axis], max[axis]].into_iter().any(|plane| {
                        rays.iter().all(|ray| {
                            let t = (plane - eye[axis]) / ray[axis];
                            let hit = eye + *ray * t;
                            let inside = (0..3).all(|o| o == axis || (min[o]..=max[o]).contains(&hit[o]));
                            t > 0.0 && inside && behind(ray, t)
                        })
                    })
                })
            });
            assert!(covered, "eye {eye}, rays {rays:?}, first {first:?}");
        }
        assert!(seams > 2_000, "only {seams} of {walled} pixels lie on a seam");
        println!("{walled} pixels, {seams} on a seam, all covered by one face");
    }
}
