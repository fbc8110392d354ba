//! The maker `building`: the scene that cullers are measured on (FACTS.md, "Figures to beat: culling").
//!
//! 22 × 22 rooms of 6 × 6 × 3 m on one storey, 0.2 m walls, a door of 1.0 × 2.1 m at a random place in every inner wall,
//! and 8 (or 64) pieces of furniture of 256 triangles a room. Doors come from a bare [`RoomPlan`], as those of `rooms` do.
//!
//! **What the 45,936 wall triangles are**: each of the 924 inner walls is three boxes (beside the door, beside the door,
//! above it), each of the 88 outer walls one, and each of the 484 rooms has a box for its floor and one for its ceiling:
//! (3·924 + 88 + 2·484) · 12. The figures that we compare with count 45,936 too.
//!
//! Walls stand from grid line to grid line and cross in the corners, 0.1 m into floor and ceiling, so that behind each
//! inner edge a face goes on. The three boxes of a wall touch without overlap: its two sides are planes with nothing but
//! the opening left out, which is what a tessellation cut at walls can seal. All materials are single-sided.
//!
//! Each piece of furniture is a node `object.N` of its own, turned anyhow, free of walls, of others and of doorways.

use std::f64::consts::{PI, TAU};
use std::path::Path;

use anyhow::Context;
use glam::{DQuat, DVec2, DVec3};
use rand::RngExt;
use rand::seq::SliceRandom;
use rand_pcg::Pcg64;

use super::furniture::{Piece, pieces};
use super::glb::{GlbError, GlbWriter, Node};
use super::plan::{PlanError, Rect, RoomPlan, RoomsRules};
use crate::chance;
use crate::cull::{Camera, CameraPath};

/// Thickness of floor and ceiling.
const SLAB: f64 = 0.2;
/// How far walls go into floor and ceiling.
const SUNK: f64 = 0.1;
/// What stays free before a door, into the room and beside the opening.
const DOORWAY: (f64, f64) = (0.6, 0.1);
/// What stays free between furniture and walls.
const GAP: f64 = 0.05;
/// Height of a camera above the floor: above all furniture.
const EYE_HEIGHT: f64 = 1.6;
/// Distance of a camera from the walls of its room.
const CAMERA_CLEAR: f64 = 0.3;
/// Most furniture of a building: its triangles are what one scene may hold.
const OBJECTS_MAX: u64 = 60_000;
/// Most cameras.
const CAMERAS_MAX: u32 = 100_000;

/// What the maker `building` is asked for. Rooms, walls and doors have the sizes of [`RoomsRules`]' defaults.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BuildingRules {
    /// Rooms along +X. Default 22.
    pub columns: u32,
    /// Rooms along +Z. Default 22.
    pub rows: u32,
    /// Pieces of furniture in each room. Default 8; the crowded variant has 64, about the most that fit.
    pub objects_per_room: u32,
    /// Cameras, each in a room of its own draw. Default 48; the crowded variant has 60.
    pub cameras: u32,
    /// Decides doors, furniture and cameras. Default 1.
    pub seed: u64,
}

impl Default for BuildingRules {
    fn default() -> BuildingRules {
        BuildingRules { columns: 22, rows: 22, objects_per_room: 8, cameras: 48, seed: 1 }
    }
}

/// A piece of furniture in its place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Object {
    /// Index into [`pieces`].
    pub piece: usize,
    /// The room that it stands in.
    pub room: usize,
    /// Middle of its footprint: x and z.
    pub at: DVec2,
    /// Its turn about the vertical axis, radians.
    pub turn: f64,
}

/// A building in memory.
#[derive(Clone, Debug)]
pub struct Building {
    /// The model.
    pub glb: Vec<u8>,
    /// Rooms, doors and walls.
    pub plan: RoomPlan,
    /// Furniture; object N is node `object.N`.
    pub objects: Vec<Object>,
    /// From where to look: eye height, level, 90° across, 1024 × 512 px.
    pub cameras: CameraPath,
    /// Triangles of walls, floors and ceilings.
    pub wall_triangles: usize,
    /// All triangles.
    pub triangles: usize,
}

/// Why a building cannot be made.
#[derive(Debug, thiserror::Error)]
pub enum BuildingError {
    /// The rules make no plan.
    #[error(transparent)]
    Plan(#[from] PlanError),
    /// The building makes no file.
    #[error(transparent)]
    Glb(#[from] GlbError),
    /// More furniture than fits in a room.
    #[error("building: {objects} objects do not fit in room {room}; about 64 do")]
    Crowded {
        /// What was asked for.
        objects: u32,
        /// The room.
        room: usize,
    },
    /// More than a scene may hold.
    #[error("building: {what} = {value}: give at most {most}")]
    TooMany {
        /// Which number.
        what: &'static str,
        /// What was asked for.
        value: u64,
        /// What would be right.
        most: u64,
    },
}

/// Makes a building. The same rules give the same bytes.
pub fn make(rules: &BuildingRules) -> Result<Building, BuildingError> {
    let &BuildingRules { columns, rows, objects_per_room, cameras, seed } = rules;
    let most = |what, value, most| {
        if value > most { Err(BuildingError::TooMany { what, value, most }) } else { Ok(()) }
    };
    let plan = RoomPlan::new(&RoomsRules { columns, rows, furnished: false, seed, ..RoomsRules::default() })?;
    most("objects per room × rooms", u64::from(objects_per_room) * plan.rooms.len() as u64, OBJECTS_MAX)?;
    most("cameras", u64::from(cameras), u64::from(CAMERAS_MAX))?;
    let pieces = pieces();
    let objects = furnish(&plan, &pieces, objects_per_room)?;
    let mut writer = GlbWriter::new();
    build_shell(&plan, &mut writer)?;
    let wall_triangles = writer.triangles();
    place_objects(&objects, &pieces, &mut writer)?;
    let triangles = writer.triangles();
    let cameras = look_around(&plan, cameras);
    Ok(Building { glb: writer.finish()?, plan, objects, cameras, wall_triangles, triangles })
}

impl Building {
    /// Writes the model and, beside it, `.cameras.json` and `.places.json` (a place to stand in each room).
    pub fn write(&self, model: &Path) -> anyhow::Result<()> {
        if let Some(folder) = model.parent().filter(|folder| !folder.as_os_str().is_empty()) {
            std::fs::create_dir_all(folder).with_context(|| format!("cannot make the folder {}", folder.display()))?;
        }
        if !self.cameras.cameras.is_empty() {
            self.cameras.write(&model.with_extension("cameras.json"))?;
        }
        let places: Vec<_> = (0..self.plan.rooms.len())
            .map(|room| {
                let (at, clear) = (self.free_place(room), self.plan.rooms[room].clear);
                serde_json::json!({
                    "kind": "room", "position": [at.x, 0.0, at.y],
                    "min": [clear.min.x, 0.0, clear.min.y],
                    "max": [clear.max.x, self.plan.rules.height, clear.max.y],
                })
            })
            .collect();
        let places = serde_json::json!({ "unit": "metre", "position_is": "feet", "places": places });
        let files = [
            (model.to_owned(), self.glb.clone()),
            (model.with_extension("places.json"), serde_json::to_vec_pretty(&places)?),
        ];
        for (path, bytes) in files {
            std::fs::write(&path, bytes).with_context(|| format!("cannot write {}", path.display()))?;
        }
        Ok(())
    }

    /// A point of a room's floor where a person fits: before its first door, or the middle of a building of one room.
    fn free_place(&self, room: usize) -> DVec2 {
        let Room { clear, .. } = room_of(&self.plan, room);
        self.plan.rooms[room].doors.first().map_or(clear.center(), |&door| {
            let door = &self.plan.doors[door];
            let inward = if door.rooms[0] == room { -door.across } else { door.across };
            door.center + inward * (0.5 * self.plan.rules.wall + 0.5 * DOORWAY.0)
        })
    }
}

/// A room with what must stay free in it.
struct Room {
    clear: Rect,
    doorways: Vec<Rect>,
}

fn room_of(plan: &RoomPlan, room: usize) -> Room {
    let half = 0.5 * plan.rules.door_width + DOORWAY.1;
    let doorway = |&door: &usize| {
        let door = &plan.doors[door];
        let reach = 0.5 * plan.rules.wall + DOORWAY.0;
        Rect::around(door.center, door.across.abs() * reach + door.across.perp().abs() * half)
    };
    Room { clear: plan.rooms[room].clear, doorways: plan.rooms[room].doors.iter().map(doorway).collect() }
}

/// Furniture for all rooms. Each room has its own stream of chance, so that a room more does not change the others.
fn furnish(plan: &RoomPlan, pieces: &[Piece], count: u32) -> Result<Vec<Object>, BuildingError> {
    let mut objects = Vec::new();
    let mut streams = chance(plan.rules.seed, 11);
    for room in 0..plan.rooms.len() {
        let mut chance = chance(streams.random(), room as u64);
        let placed = furnish_room(&room_of(plan, room), pieces, count as usize, &mut chance)
            .ok_or(BuildingError::Crowded { objects: count, room })?;
        objects.extend(placed.into_iter().map(|(piece, at, turn)| Object { piece, room, at, turn }));
    }
    Ok(objects)
}

/// One piece to a cell of a grid, in the coarsest grid that has room for all; pieces larger than a cell stay out.
fn furnish_room(room: &Room, pieces: &[Piece], count: usize, chance: &mut Pcg64) -> Option<Vec<(usize, DVec2, f64)>> {
    if count == 0 {
        return Some(Vec::new());
    }
    let floor = room.clear.grown(-GAP);
    let side = (floor.max - floor.min).min_element();
    let mut cells_across = (count as f64).sqrt().ceil() as usize;
    loop {
        let cell = side / cells_across as f64;
        let fitting = pieces.iter().filter(|piece| 2.0 * piece.radius <= cell).count();
        if fitting == 0 {
            return None;
        }
        let mut cells: Vec<usize> = (0..cells_across * cells_across).collect();
        cells.shuffle(chance);
        let mut placed = Vec::with_capacity(count);
        for number in cells {
            let middle = floor.min
                + DVec2::new((number % cells_across) as f64 + 0.5, (number / cells_across) as f64 + 0.5) * cell;
            // A few tries: a doorway may leave room for a smaller piece, or in another part of the cell.
            for _ in 0..8 {
                let piece = chance.random_range(0..fitting);
                let spare = 0.5 * cell - pieces[piece].radius;
                let [x, z] = [(); 2].map(|()| chance.random_range(-1.0..=1.0) * spare);
                let (at, turn) = (middle + DVec2::new(x, z), chance.random_range(0.0..TAU));
                if room.doorways.iter().all(|doorway| doorway.distance(at) >= pieces[piece].radius) {
                    placed.push((piece, at, turn));
                    break;
                }
            }
            if placed.len() == count {
                return Some(placed);
            }
        }
        cells_across += 1;
    }
}

fn build_shell(plan: &RoomPlan, writer: &mut GlbWriter) -> Result<(), GlbError> {
    let rules = &plan.rules;
    let slab = writer.material("slab", [0.55, 0.5, 0.45], false);
    let wall = writer.material("wall", [0.74, 0.72, 0.66], false);
    let solid = |plan: Rect, bottom: f64, top: f64| {
        (DVec3::new(plan.min.x, bottom, plan.min.y), DVec3::new(plan.max.x, top, plan.max.y))
    };
    for room in 0..plan.rooms.len() {
        let cell = plan.rooms[room].clear.grown(0.5 * rules.wall);
        let boxes = [solid(cell, -SLAB, 0.0), solid(cell, rules.height, rules.height + SLAB)];
        writer.boxes(format!("slabs.{room}"), slab, &boxes)?;
    }
    let (bottom, top) = (-SUNK, rules.height + SUNK);
    let mut walls = 0;
    for line in &plan.lines {
        let cells = if line.along_x { rules.columns } else { rules.rows };
        for cell in 0..cells {
            let (mut from, mut to) = (f64::from(cell) * rules.room, f64::from(cell + 1) * rules.room);
            let footprint = |from, to| line.footprint((from, to), rules.wall);
            let boxes = match line.doors.get(cell as usize) {
                Some(door) => {
                    let opening = (door - 0.5 * rules.door_width, door + 0.5 * rules.door_width);
                    vec![
                        solid(footprint(from, opening.0), bottom, top),
                        solid(footprint(opening.1, to), bottom, top),
                        solid(footprint(opening.0, opening.1), rules.door_height, top),
                    ]
                }
                None => {
                    // Outer walls close the building's corners.
                    from -= if cell == 0 { 0.5 * rules.wall } else { 0.0 };
                    to += if cell + 1 == cells { 0.5 * rules.wall } else { 0.0 };
                    vec![solid(footprint(from, to), bottom, top)]
                }
            };
            writer.boxes(format!("wall.{walls}"), wall, &boxes)?;
            walls += 1;
        }
    }
    Ok(())
}

fn place_objects(objects: &[Object], pieces: &[Piece], writer: &mut GlbWriter) -> Result<(), GlbError> {
    if objects.is_empty() {
        return Ok(());
    }
    let oak = writer.material("oak", [0.45, 0.28, 0.13], false);
    let meshes: Vec<_> =
        pieces.iter().map(|piece| writer.mesh(piece.name, &piece.mesh, Some(oak))).collect::<Result<_, _>>()?;
    for (number, object) in objects.iter().enumerate() {
        writer.node(Node {
            name: format!("object.{number}"),
            mesh: Some(meshes[object.piece]),
            translation: DVec3::new(object.at.x, 0.0, object.at.y),
            rotation: DQuat::from_rotation_y(object.turn),
        })?;
    }
    Ok(())
}

fn look_around(plan: &RoomPlan, cameras: u32) -> CameraPath {
    let mut chance = chance(plan.rules.seed, 12);
    let camera = |_| {
        let room = plan.rooms[chance.random_range(0..plan.rooms.len())].clear.grown(-CAMERA_CLEAR);
        let x = chance.random_range(room.min.x..room.max.x);
        let z = chance.random_range(room.min.y..room.max.y);
        Camera::rounded(DVec3::new(x, EYE_HEIGHT, z), chance.random_range(-PI..PI), 0.0)
    };
    let cameras = (0..cameras).map(camera).collect();
    CameraPath { resolution: Some([1024, 512]), ..CameraPath::new(cameras) }
}

#[cfg(test)]
mod tests {
    use eyeline_visibility::{LoadOptions, load_file};

    use super::*;
    use crate::places;
    use crate::scene::furniture::TRIANGLES;

    fn small() -> BuildingRules {
        BuildingRules { columns: 3, rows: 2, cameras: 5, ..BuildingRules::default() }
    }

    #[test]
    fn the_default_building_has_the_counts_of_the_figures_to_beat() {
        let building = make(&BuildingRules::default()).unwrap();
        assert_eq!(building.wall_triangles, 45_936);
        assert_eq!(building.objects.len(), 3_872);
        assert_eq!(building.triangles, 45_936 + 3_872 * TRIANGLES);
        assert_eq!(building.plan.doors.len(), 924);
        assert_eq!(building.cameras.cameras.len(), 48);
        assert_eq!(building.cameras.resolution, Some([1024, 512]));
    }

    #[test]
    fn same_rules_same_bytes_and_another_seed_others() {
        let (a, b) = (make(&small()).unwrap(), make(&small()).unwrap());
        assert!(a.glb == b.glb && a.cameras == b.cameras);
        let other = make(&BuildingRules { seed: 2, ..small() }).unwrap();
        assert!(other.glb != a.glb && other.cameras != a.cameras);
    }

    #[test]
    fn furniture_stands_free_in_its_room_and_leaves_doors_open() {
        let pieces = pieces();
        for objects_per_room in [1, 8, 27, 64] {
            let rules = BuildingRules { columns: 5, rows: 5, objects_per_room, ..BuildingRules::default() };
            let building = make(&rules).unwrap();
            assert_eq!(building.objects.len() as u32, 25 * objects_per_room);
            for object in &building.objects {
                let radius = pieces[object.piece].radius;
                assert!(building.plan.rooms[object.room].clear.grown(-radius).contains(object.at));
                for other in building.objects.iter().filter(|other| other.room == object.room && *other != object) {
                    assert!(object.at.distance(other.at) > radius + pieces[other.piece].radius - 1e-9);
                }
            }
            for (room, door) in building.plan.doors.iter().flat_map(|door| door.rooms.map(|room| (room, door))) {
                // A person of 0.3 m radius walks from the opening half a metre into the room.
                let inward = if door.rooms[0] == room { -door.across } else { door.across };
                for object in building.objects.iter().filter(|object| object.room == room) {
                    for step in 0..=6 {
                        let person = door.center + inward * 0.05 * f64::from(step);
                        assert!(object.at.distance(person) > pieces[object.piece].radius + 0.3 - 1e-9);
                    }
                }
            }
        }
    }

    #[test]
    fn doors_are_passable_and_walls_are_not() {
        let building = make(&BuildingRules { objects_per_room: 0, ..small() }).unwrap();
        let scene = eyeline_visibility::load_glb(&building.glb, "building", &LoadOptions::default()).unwrap();
        let rays = eyeline_visibility::RayScene::new(&scene);
        let rules = &building.plan.rules;
        let hits = |at: DVec2, height: f64, across: DVec2| {
            let from = at - across * 0.3;
            let eye = DVec3::new(from.x, height, from.y);
            rays.first_hit(eye, DVec3::new(across.x, 0.0, across.y), 0.0, 0.6).is_some()
        };
        for door in &building.plan.doors {
            let along = door.across.perp() * 0.5 * rules.door_width;
            for (share, height) in [(0.0, 1.0), (0.98, 0.02), (-0.98, 2.08), (0.3, 2.0)] {
                assert!(!hits(door.center + along * share, height, door.across));
                assert!(!hits(door.center + along * share, height, -door.across));
            }
            for (share, height) in [(1.02, 1.0), (-1.02, 0.02), (0.0, 2.12), (0.9, 2.98)] {
                assert!(hits(door.center + along * share, height, door.across));
            }
        }
    }

    #[test]
    fn cameras_stand_in_rooms_at_eye_height() {
        let building = make(&BuildingRules { cameras: 500, ..small() }).unwrap();
        let mut rooms = std::collections::BTreeSet::new();
        for camera in &building.cameras.cameras {
            let [x, y, z] = camera.eye;
            assert_eq!((y, camera.pitch_degrees), (1.6, 0.0));
            let room = building.plan.room_at(DVec2::new(x, z)).unwrap();
            assert!(building.plan.rooms[room].clear.grown(0.001 - CAMERA_CLEAR).contains(DVec2::new(x, z)));
            rooms.insert(room);
        }
        assert_eq!(rooms.len(), 6);
    }

    #[test]
    fn files_load_with_a_node_for_each_object() {
        let folder = tempfile::tempdir().unwrap();
        let model = folder.path().join("made/building.glb");
        let building = make(&small()).unwrap();
        building.write(&model).unwrap();
        let scene = load_file(&model, &LoadOptions::default()).unwrap();
        assert_eq!(scene.triangles().len(), building.triangles);
        let objects = scene.nodes().iter().filter(|node| node.name.starts_with("object."));
        assert!(objects.clone().all(|node| node.primitives.len() == TRIANGLES));
        assert_eq!(objects.count(), building.objects.len());
        assert_eq!(CameraPath::beside(&model).unwrap().unwrap(), building.cameras);
        let places = places::beside(&model).unwrap().unwrap();
        assert_eq!(places.len(), building.plan.rooms.len());
        for (room, place) in places.iter().enumerate() {
            let at = DVec2::new(place.position.x, place.position.z);
            assert_eq!(building.plan.room_at(at), Some(room));
        }
    }

    #[test]
    fn every_size_makes_a_building_and_too_much_is_refused_by_name() {
        for (columns, rows, objects_per_room, cameras) in [(1, 1, 0, 1), (1, 1, 64, 0), (1, 4, 3, 2)] {
            let rules = BuildingRules { columns, rows, objects_per_room, cameras, seed: u64::MAX };
            gltf::Gltf::from_slice(&make(&rules).unwrap().glb).unwrap();
        }
        let message = |change: fn(&mut BuildingRules)| {
            let mut rules = small();
            change(&mut rules);
            make(&rules).unwrap_err().to_string()
        };
        assert!(message(|r| r.columns = 0).contains("columns × rows = 0"));
        assert!(message(|r| r.objects_per_room = 400).contains("400 objects do not fit in room 0"));
        assert!(message(|r| r.objects_per_room = u32::MAX).contains("at most 60000"));
        assert!(message(|r| r.cameras = u32::MAX).contains("cameras = 4294967295"));
    }
}
