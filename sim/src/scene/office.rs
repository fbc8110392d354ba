//! The maker `office`: floors of offices along corridors, in the spirit of cPLP's test model (Klosowski & Silva 2001, §5:
//! three copies of a floor of Soda Hall, each room with furniture, over a million triangles).
//!
//! ```text
//! z 24 ┌──┬──┬──┬── … ──┬──┐   offices of 4 × 5 m
//!   19 ├──┴──┴──┴── … ──┴──┤   corridor, 2 m
//!   17 │  ┌──┬──┬─ … ─┬──┐ │   core: two rows of offices, a stairwell in the middle,
//!   12 │  ├──┼──┼─ … ─┼──┤ │   a lobby of 4 m at both ends
//!    7 │  └──┴──┴─ … ─┴──┘ │
//!    5 ├──┬──┬──┬── … ──┬──┤   corridor, 2 m
//!    0 └──┴──┴──┴── … ──┴──┘   offices of 4 × 5 m
//!      x 0                60
//! ```
//! The paper's copies lie side by side; ours are stacked and joined by the stairwell, so that one also sees up and down. Every
//! office has a door to its corridor, two workplaces, two bookcases, a stool and a pedestal. Walls cross in the corners and
//! stand in the slabs, as in [`super::building`].

mod walk;

use std::f64::consts::{FRAC_PI_2, PI};

use glam::{DQuat, DVec2, DVec3, Vec2Swizzles};
use rand::RngExt;
use rand_pcg::Pcg64;

use super::furniture::{bookcase, pieces, workplace};
use super::glb::{GlbWriter, MeshId, Node};
use super::made::{CAMERAS_MAX, MadeError, MadeModel, check, solid};
use super::plan::Rect;
use crate::chance;
use crate::cull::{Camera, CameraPath};

pub use walk::walk;

/// Height of a storey, floor to floor, and thickness of a slab.
const STOREY: f64 = 3.2;
const SLAB: f64 = 0.25;
const WALL: f64 = 0.15;
const DOOR: (f64, f64) = (1.0, 2.1);
/// How far walls go into the slabs.
const SUNK: f64 = 0.1;
/// Width of an office along the corridor, offices along it, and where in z the rows begin and end.
const WIDTH: f64 = 4.0;
const ALONG: u32 = 15;
const ROWS: [(f64, f64); 4] = [(0.0, 5.0), (7.0, 12.0), (12.0, 17.0), (19.0, 24.0)];
/// Columns of the core, and the one that is the stairwell.
const CORE: std::ops::Range<u32> = 1..14;
const STAIRS: u32 = 7;
/// The hole in the slabs, in z: what is left on both sides is landing.
const HOLE: (f64, f64) = (9.0, 15.0);
const STEPS: u32 = 18;
const EYE_HEIGHT: f64 = 1.6;
/// From an office's side walls to the lane between its furniture, less what cameras keep from walls.
const LANE: f64 = 1.0;

/// What the maker `office` is asked for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct OfficeRules {
    /// Floors on top of each other. Default 3: about a million triangles.
    pub floors: u32,
    /// Cameras in offices, corridors and lobbies. Default 200.
    pub cameras: u32,
    /// Decides doors, furniture and cameras. Default 1.
    pub seed: u64,
}

impl Default for OfficeRules {
    fn default() -> OfficeRules {
        OfficeRules { floors: 3, cameras: 200, seed: 1 }
    }
}

/// An office and which way its door is.
struct Office {
    /// Between its walls' middles.
    cell: Rect,
    /// Whether its door is in the wall of greater z.
    door_up: bool,
    /// Middle of its door along x.
    door: f64,
}

/// Makes the offices. The same rules give the same bytes.
///
/// # Errors
/// Names the rule that no model can follow.
pub fn make(rules: &OfficeRules) -> Result<MadeModel, MadeError> {
    let (writer, offices) = build(rules)?;
    let cameras = look_around(rules, &offices);
    let triangles = writer.triangles();
    Ok(MadeModel { glb: writer.finish()?, triangles, cameras })
}

/// The model, and the offices of each floor.
fn build(rules: &OfficeRules) -> Result<(GlbWriter, Vec<Vec<Office>>), MadeError> {
    check("floors", rules.floors, 1, 30)?;
    check("cameras", rules.cameras, 0, CAMERAS_MAX)?;
    let mut writer = GlbWriter::new();
    let mut places = chance(rules.seed, 31);
    let mut all = Vec::new();
    let set = Furniture::new(&mut writer)?;
    for floor in 0..rules.floors {
        let offices = offices(&mut places);
        build_floor(floor, rules.floors, &offices, &mut writer)?;
        for (number, office) in offices.iter().enumerate() {
            set.furnish(floor, number, office, &mut places, &mut writer)?;
        }
        all.push(offices);
    }
    build_roof(rules.floors, &mut writer)?;
    Ok((writer, all))
}

/// The offices of a floor, row after row.
fn offices(chance: &mut Pcg64) -> Vec<Office> {
    let mut offices = Vec::new();
    for (row, &(from, to)) in ROWS.iter().enumerate() {
        let core = row == 1 || row == 2;
        for column in 0..ALONG {
            if core && (!CORE.contains(&column) || column == STAIRS) {
                continue;
            }
            let x = f64::from(column) * WIDTH;
            let margin = 0.5 * (WALL + DOOR.0) + 0.2;
            let door = x + chance.random_range(margin..WIDTH - margin);
            let cell = Rect { min: DVec2::new(x, from), max: DVec2::new(x + WIDTH, to) };
            offices.push(Office { cell, door_up: row % 2 == 0, door });
        }
    }
    offices
}

/// A wall along x (or z) with doors: the pieces beside and above them.
fn wall(along_x: bool, at: f64, span: (f64, f64), doors: &[f64], floor: f64) -> Vec<(DVec3, DVec3)> {
    let turn = |point: DVec2| if along_x { point } else { point.yx() };
    let piece = |from: f64, to: f64, bottom: f64| {
        let (min, max) = (DVec2::new(from, at - 0.5 * WALL), DVec2::new(to, at + 0.5 * WALL));
        solid(turn(min), turn(max), floor + bottom, floor + STOREY - SLAB + SUNK)
    };
    let (mut boxes, mut from) = (Vec::new(), span.0);
    for door in doors {
        let opening = (door - 0.5 * DOOR.0, door + 0.5 * DOOR.0);
        boxes.push(piece(from, opening.0, -SUNK));
        boxes.push(piece(opening.0, opening.1, DOOR.1));
        from = opening.1;
    }
    boxes.push(piece(from, span.1, -SUNK));
    boxes
}

fn build_floor(floor: u32, floors: u32, offices: &[Office], writer: &mut GlbWriter) -> Result<(), MadeError> {
    let slab = writer.material("slab", [0.5, 0.5, 0.52], false);
    let plaster = writer.material("plaster", [0.8, 0.78, 0.72], false);
    let base = f64::from(floor) * STOREY;
    let (length, depth) = (f64::from(ALONG) * WIDTH, ROWS[3].1);
    let half = 0.5 * WALL;
    let stairs = (f64::from(STAIRS) * WIDTH, f64::from(STAIRS + 1) * WIDTH);
    let plate = |min: DVec2, max: DVec2| solid(min, max, base - SLAB, base);
    let mut plates = vec![
        plate(DVec2::new(-half, -half), DVec2::new(stairs.0, depth + half)),
        plate(DVec2::new(stairs.1, -half), DVec2::new(length + half, depth + half)),
        plate(DVec2::new(stairs.0, -half), DVec2::new(stairs.1, HOLE.0)),
        plate(DVec2::new(stairs.0, HOLE.1), DVec2::new(stairs.1, depth + half)),
    ];
    if floor == 0 {
        plates.push(plate(DVec2::new(stairs.0, HOLE.0), DVec2::new(stairs.1, HOLE.1)));
    }
    writer.boxes(format!("slab.{floor}"), slab, &plates)?;

    let mut lines: Vec<Vec<(DVec3, DVec3)>> = Vec::new();
    let doors_at = |z: f64| -> Vec<f64> {
        let has = |office: &&Office| if office.door_up { office.cell.max.y == z } else { office.cell.min.y == z };
        offices.iter().filter(has).map(|office| office.door).collect()
    };
    let core = (f64::from(CORE.start) * WIDTH, f64::from(CORE.end) * WIDTH);
    let stair_door = 0.5 * (stairs.0 + stairs.1);
    for z in [0.0, depth] {
        lines.push(wall(true, z, (-half, length + half), &[], base));
    }
    for z in [ROWS[0].1, ROWS[3].0] {
        lines.push(wall(true, z, (0.0, length), &doors_at(z), base));
    }
    for z in [ROWS[1].0, ROWS[2].1] {
        // Core offices open to their corridor, and so does the stairwell.
        let mut doors = doors_at(z);
        doors.push(stair_door);
        doors.sort_by(f64::total_cmp);
        lines.push(wall(true, z, core, &doors, base));
    }
    lines.push(wall(true, ROWS[1].1, (core.0, stairs.0), &[], base));
    lines.push(wall(true, ROWS[1].1, (stairs.1, core.1), &[], base));
    for x in [0.0, length] {
        lines.push(wall(false, x, (-half, depth + half), &[], base));
    }
    for column in 1..ALONG {
        let x = f64::from(column) * WIDTH;
        lines.push(wall(false, x, ROWS[0], &[], base));
        lines.push(wall(false, x, ROWS[3], &[], base));
        if (CORE.start..=CORE.end).contains(&column) {
            lines.push(wall(false, x, (ROWS[1].0, ROWS[2].1), &[], base));
        }
    }
    for (number, line) in lines.iter().enumerate() {
        writer.boxes(format!("wall.{floor}.{number}"), plaster, line)?;
    }
    if floor + 1 < floors {
        writer.boxes(format!("stairs.{floor}"), slab, &flight(floor, stairs))?;
    }
    Ok(())
}

/// A straight flight to the next floor, on one side of the well up and on the other side for the floor above.
fn flight(floor: u32, (left, right): (f64, f64)) -> Vec<(DVec3, DVec3)> {
    let middle = 0.5 * (left + right);
    let side = if floor.is_multiple_of(2) { (left + WALL, middle - 0.1) } else { (middle + 0.1, right - WALL) };
    let (rise, tread) = (STOREY / f64::from(STEPS), (HOLE.1 - HOLE.0) / f64::from(STEPS));
    let base = f64::from(floor) * STOREY;
    let step = |step: u32| {
        let near = f64::from(step) * tread;
        let (from, to) = if floor.is_multiple_of(2) {
            (HOLE.0 + near, HOLE.0 + near + tread)
        } else {
            (HOLE.1 - near - tread, HOLE.1 - near)
        };
        let top = base + rise * f64::from(step + 1);
        solid(DVec2::new(side.0, from), DVec2::new(side.1, to), top - 0.2, top)
    };
    (0..STEPS).map(step).collect()
}

fn build_roof(floors: u32, writer: &mut GlbWriter) -> Result<(), MadeError> {
    let roof = writer.material("roof", [0.45, 0.45, 0.45], false);
    let (bottom, size) = (f64::from(floors) * STOREY - SLAB, DVec2::new(f64::from(ALONG) * WIDTH, ROWS[3].1));
    let reach = DVec2::splat(0.5 * WALL);
    Ok(writer.boxes("roof".into(), roof, &[solid(-reach, size + reach, bottom, bottom + SLAB)])?)
}

/// Meshes that all offices share.
struct Furniture {
    workplace: MeshId,
    bookcase: MeshId,
    small: [MeshId; 2],
}

impl Furniture {
    fn new(writer: &mut GlbWriter) -> Result<Furniture, MadeError> {
        let oak = writer.material("oak", [0.45, 0.28, 0.13], false);
        let [workplace, bookcase] =
            [writer.mesh("workplace", &workplace(), Some(oak))?, writer.mesh("bookcase", &bookcase(), Some(oak))?];
        let [pedestal, _, stool, ..] = &pieces()[..] else { unreachable!("furniture has six pieces") };
        let small =
            [writer.mesh("stool", &stool.mesh, Some(oak))?, writer.mesh("pedestal", &pedestal.mesh, Some(oak))?];
        Ok(Furniture { workplace, bookcase, small })
    }

    /// Places along the side walls, away from the door: workplaces at the far end, bookcases before them, small things at the far wall.
    fn furnish(
        &self,
        floor: u32,
        number: usize,
        office: &Office,
        chance: &mut Pcg64,
        writer: &mut GlbWriter,
    ) -> Result<(), MadeError> {
        let Rect { min, max } = office.cell.grown(-0.5 * WALL);
        // How far from the far wall, as a place in z.
        let from_far = |distance: f64| if office.door_up { min.y + distance } else { max.y - distance };
        let mut jitter = |reach: f64| chance.random_range(-reach..=reach);
        let mut put = |name: &str, mesh: MeshId, at: DVec2, turn: f64| {
            writer.node(Node {
                name: format!("object.{floor}.{number}.{name}"),
                mesh: Some(mesh),
                translation: DVec3::new(at.x, f64::from(floor) * STOREY, at.y),
                rotation: DQuat::from_rotation_y(turn),
            })
        };
        for (side, turn) in [(min.x, FRAC_PI_2), (max.x, -FRAC_PI_2)] {
            let inward = turn.signum();
            let name = if inward > 0.0 { "left" } else { "right" };
            // Turned so that −Z looks at the wall; the desk is 0.7 m deep.
            let at = DVec2::new(side + inward * (0.42 + jitter(0.04)), from_far(1.6 + jitter(0.2)));
            put(&format!("workplace.{name}"), self.workplace, at, turn)?;
            let at = DVec2::new(side + inward * 0.2, from_far(3.0 + jitter(0.2)));
            put(&format!("bookcase.{name}"), self.bookcase, at, turn)?;
        }
        let middle = 0.5 * (min.x + max.x);
        for (mesh, name, x) in [(self.small[0], "stool", middle - 0.4), (self.small[1], "pedestal", middle + 0.4)] {
            let at = DVec2::new(x + jitter(0.1), from_far(0.45 + jitter(0.1)));
            put(name, mesh, at, jitter(PI))?;
        }
        Ok(())
    }
}

fn look_around(rules: &OfficeRules, floors: &[Vec<Office>]) -> CameraPath {
    let mut chance = chance(rules.seed, 32);
    let length = f64::from(ALONG) * WIDTH;
    let corridors = [(ROWS[0].1, ROWS[1].0), (ROWS[2].1, ROWS[3].0)]
        .map(|(from, to)| Rect { min: DVec2::new(0.0, from), max: DVec2::new(length, to) });
    let lobbies =
        [0.0, length - WIDTH].map(|x| Rect { min: DVec2::new(x, ROWS[1].0), max: DVec2::new(x + WIDTH, ROWS[2].1) });
    let camera = |_| {
        let floor = chance.random_range(0..floors.len());
        let offices = &floors[floor];
        // Half of the time in an office, as one is.
        let place = match chance.random_range(0..8) {
            0..4 => {
                // In the middle lane: bookcases are higher than an eye.
                let Rect { min, max } = offices[chance.random_range(0..offices.len())].cell;
                Rect { min: min + DVec2::X * LANE, max: max - DVec2::X * LANE }
            }
            4..7 => corridors[chance.random_range(0..2)],
            _ => lobbies[chance.random_range(0..2)],
        };
        let place = place.grown(-0.5 * WALL - 0.3);
        let at = place.min + (place.max - place.min) * DVec2::new(chance.random(), chance.random());
        let eye = DVec3::new(at.x, f64::from(floor as u32) * STOREY + EYE_HEIGHT, at.y);
        Camera::rounded(eye, chance.random_range(-PI..PI), chance.random_range(-0.1..0.1))
    };
    CameraPath::new((0..rules.cameras).map(camera).collect())
}

#[cfg(test)]
mod tests {
    use eyeline_visibility::{LoadOptions, RayScene, load_file, load_glb};

    use super::*;

    #[test]
    fn three_floors_have_about_a_million_triangles() {
        let made = make(&OfficeRules::default()).unwrap();
        assert!((950_000..1_100_000).contains(&made.triangles), "{}", made.triangles);
        assert_eq!(made.cameras.cameras.len(), 200);
    }

    #[test]
    fn same_rules_same_bytes() {
        let rules = OfficeRules { floors: 1, ..OfficeRules::default() };
        let (a, b) = (make(&rules).unwrap(), make(&rules).unwrap());
        assert!(a.glb == b.glb && a.cameras == b.cameras);
        assert!(make(&OfficeRules { seed: 2, ..rules }).unwrap().glb != a.glb);
    }

    #[test]
    fn furniture_stands_in_its_office() {
        let mut writer = GlbWriter::new();
        let set = Furniture::new(&mut writer).unwrap();
        let offices = offices(&mut chance(3, 31));
        assert_eq!(offices.len(), 2 * 15 + 2 * 12);
        for (number, office) in offices.iter().enumerate() {
            set.furnish(0, number, office, &mut chance(number as u64, 0), &mut writer).unwrap();
        }
        let scene = load_glb(&writer.finish().unwrap(), "furniture", &LoadOptions::default()).unwrap();
        for node in scene.nodes() {
            let number: usize = node.name.split('.').nth(2).unwrap().parse().unwrap();
            let clear = offices[number].cell.grown(-0.5 * WALL);
            let door =
                DVec2::new(offices[number].door, if offices[number].door_up { clear.max.y } else { clear.min.y });
            for triangle in &scene.triangles()[node.primitives.start as usize..node.primitives.end as usize] {
                for corner in triangle.corners {
                    let at = DVec2::new(corner.x.into(), corner.z.into());
                    assert!(clear.contains(at), "{} at {at}", node.name);
                    assert!(at.distance(door) > 0.7, "{} in its door", node.name);
                }
            }
        }
    }

    #[test]
    fn one_gets_from_every_office_to_its_corridor_and_up_the_stairs() {
        let made = make(&OfficeRules { floors: 2, ..OfficeRules::default() }).unwrap();
        let scene = load_glb(&made.glb, "office", &LoadOptions::default()).unwrap();
        let rays = RayScene::new(&scene);
        let mut draws = chance(1, 31);
        for floor in 0..2 {
            let offices = offices(&mut draws);
            for office in &offices {
                let z = if office.door_up { office.cell.max.y } else { office.cell.min.y };
                for (shift, height, open) in
                    [(0.0, 1.0, true), (0.45, 2.0, true), (0.55, 1.0, false), (0.0, 2.2, false)]
                {
                    let eye = DVec3::new(office.door + shift, height + f64::from(floor) * STOREY, z - 0.5);
                    assert_eq!(rays.first_hit(eye, DVec3::Z, 0.0, 1.0).is_none(), open, "{eye}");
                }
            }
            // The furniture's draws come between the floors.
            let mut writer = GlbWriter::new();
            let set = Furniture::new(&mut writer).unwrap();
            for (number, office) in offices.iter().enumerate() {
                set.furnish(floor, number, office, &mut draws, &mut writer).unwrap();
            }
        }
        // Each step is a little above the last, and nothing hangs at head height above it.
        let x = f64::from(STAIRS) * WIDTH + 1.0;
        let mut last = 0.0;
        for step in 0..STEPS {
            let z = HOLE.0 + (f64::from(step) + 0.5) * (HOLE.1 - HOLE.0) / f64::from(STEPS);
            let from = DVec3::new(x, last + 1.0, z);
            let top = from.y - rays.first_hit(from, DVec3::NEG_Y, 0.0, 2.0).unwrap().t;
            assert!((0.1..0.2).contains(&(top - last)), "step {step} at {top}");
            assert!(rays.first_hit(DVec3::new(x, top + 0.01, z), DVec3::Y, 0.0, 1.9).is_none(), "step {step}");
            last = top;
        }
        assert!((last - STOREY).abs() < 1e-3);
    }

    #[test]
    fn files_load_and_cameras_are_inside() {
        let folder = tempfile::tempdir().unwrap();
        let model = folder.path().join("made/office.glb");
        let made = make(&OfficeRules { floors: 1, cameras: 50, seed: 4 }).unwrap();
        made.write(&model).unwrap();
        let scene = load_file(&model, &LoadOptions::default()).unwrap();
        assert_eq!(scene.triangles().len(), made.triangles);
        let path = CameraPath::beside(&model).unwrap().unwrap();
        assert_eq!(path, made.cameras);
        let rays = RayScene::new(&scene);
        for camera in &path.cameras {
            let floor = rays.first_hit(DVec3::from(camera.eye), DVec3::NEG_Y, 0.0, 10.0).unwrap();
            // Above the floor, a stool or a pedestal, and in nothing that is higher.
            assert!((0.99..EYE_HEIGHT + 1e-3).contains(&floor.t), "{camera:?}");
        }
        let message = make(&OfficeRules { floors: 0, ..OfficeRules::default() }).unwrap_err().to_string();
        assert!(message.contains("floors = 0: give 1 to 30"));
    }
}
