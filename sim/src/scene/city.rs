//! The maker `city`: thirty furnished houses along streets, about half a million triangles, nearly all of them hidden
//! (the CITY of Klosowski & Silva 2000, §5, in spirit).
//!
//! Each house has two to four storeys of two rooms with a bookcase and four pieces of furniture each, walls with open windows and an
//! open front door, and a gable roof. Outside, walls and roofs are cut into panels of about a metre and a half, so that what is seen of
//! a street has triangles to lose too. Houses stand in blocks of two rows back to back. All materials are single-sided.
//!
//! The path is fixed but for the seed's houses: over the roofs round two sides of the city, down into a street and along it,
//! up between the roofs again, and down through a front door into a room; 200 views in steps small enough that one frame
//! tells something of the next.

use std::f64::consts::{FRAC_PI_2, PI};

use glam::{DQuat, DVec2, DVec3, Vec3};
use rand::RngExt;
use rand_pcg::Pcg64;

use super::furniture::{Piece, bookcase, pieces};
use super::glb::{GlbWriter, MaterialId, MeshId, Node, Triangles};
use super::made::{CAMERAS_MAX, MadeError, MadeModel, check};
use super::patch::{push_patch, push_prism};
use crate::chance;
use crate::cull::{CameraPath, Stop};

/// Width and depth of a plot, and the width of a street.
const PLOT: (f64, f64) = (14.0, 15.0);
const STREET: f64 = 8.0;
/// From floor to floor, and thickness of floors and walls.
const STOREY: f64 = 2.8;
const SLAB: f64 = 0.25;
const WALL: f64 = 0.25;
/// Sill, head, width and distance of windows.
const WINDOW: (f64, f64, f64, f64) = (0.9, 2.1, 1.2, 2.4);
const DOOR: (f64, f64) = (1.1, 2.1);
/// About the side of a panel of walls and roofs, and how far panels stand before their wall.
const PANEL: f64 = 1.5;
const PROUD: f64 = 0.01;
/// Rise of a roof over its half depth, and how far it reaches over the walls.
const PITCH: f64 = 0.7;
const EAVES: f64 = 0.4;
/// Different houses; more would only make the file longer.
const MODELS: u32 = 12;
const EYE_HEIGHT: f64 = 1.6;

/// What the maker `city` is asked for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CityRules {
    /// Houses along +X. Default 5.
    pub columns: u32,
    /// Blocks of two rows each along +Z. Default 3: with 5 columns about half a million triangles.
    pub blocks: u32,
    /// Views of the path, which is cut finer or coarser. Default 200.
    pub cameras: u32,
    /// Decides sizes and furniture of the houses. Default 1.
    pub seed: u64,
}

impl Default for CityRules {
    fn default() -> CityRules {
        CityRules { columns: 5, blocks: 3, cameras: 200, seed: 1 }
    }
}

/// One model of a house. Its origin is the middle of its footprint on the ground; its front faces −Z.
#[derive(Clone, Copy, Debug)]
struct House {
    /// Width along x and depth along z, walls included.
    size: DVec2,
    storeys: u32,
}

/// Makes the city. The same rules give the same bytes.
///
/// # Errors
/// Names the rule that no model can follow.
pub fn make(rules: &CityRules) -> Result<MadeModel, MadeError> {
    check("columns", rules.columns, 1, 100)?;
    check("blocks", rules.blocks, 1, 100)?;
    check("cameras", rules.cameras, 0, CAMERAS_MAX)?;
    let mut writer = GlbWriter::new();
    let mut chance = chance(rules.seed, 51);
    let plaster = writer.material("plaster", [0.7, 0.65, 0.55], false);
    let tiles = writer.material("tiles", [0.5, 0.2, 0.14], false);
    let oak = writer.material("oak", [0.45, 0.28, 0.13], false);
    let earth = writer.material("earth", [0.25, 0.3, 0.2], false);
    let pieces = pieces();
    let furniture: Vec<MeshId> =
        pieces.iter().map(|piece| writer.mesh(piece.name, &piece.mesh, Some(oak))).collect::<Result<_, _>>()?;
    let bookcase = writer.mesh("bookcase", &bookcase(), Some(oak))?;
    let models: Vec<(House, [MeshId; 2])> = (0..MODELS)
        .map(|model| {
            let house = House {
                size: DVec2::new(chance.random_range(9.0..11.0), chance.random_range(7.5..9.0)),
                storeys: [3, 3, 4, 2, 3, 4][model as usize % 6],
            };
            let shell = writer.mesh(&format!("walls.{model}"), &walls(&house), Some(plaster))?;
            let roof = writer.mesh(&format!("roof.{model}"), &roof(&house), Some(tiles))?;
            Ok((house, [shell, roof]))
        })
        .collect::<Result<_, MadeError>>()?;
    ground(&mut writer, earth, rules)?;
    for row in 0..2 * rules.blocks {
        for column in 0..rules.columns {
            let (at, turn) = plot(row, column);
            // Models by a pattern, so that the path knows which house stands where whatever the seed.
            let (house, parts) = models[((row * 5 + column * 7) % MODELS) as usize];
            for (name, mesh) in ["walls", "roof"].into_iter().zip(parts) {
                let name = format!("{name}.{row}.{column}");
                writer.node(Node { name, mesh: Some(mesh), translation: at, rotation: turn })?;
            }
            for (number, (piece, place, heading)) in furnish(&house, &pieces, &mut chance).into_iter().enumerate() {
                writer.node(Node {
                    name: format!("object.{row}.{column}.{number}"),
                    mesh: Some(piece.map_or(bookcase, |piece| furniture[piece])),
                    translation: at + turn * place,
                    rotation: (turn * DQuat::from_rotation_y(heading)).normalize(),
                })?;
            }
        }
    }
    let cameras = path(rules, &models);
    let triangles = writer.triangles();
    Ok(MadeModel { glb: writer.finish()?, triangles, cameras })
}

/// The middle of a plot, and which way its house looks: rows of a block look away from each other.
fn plot(row: u32, column: u32) -> (DVec3, DQuat) {
    let (block, second) = (f64::from(row / 2), row % 2 == 1);
    let z = block * (2.0 * PLOT.1 + STREET) + STREET + PLOT.1 * if second { 1.5 } else { 0.5 };
    let turn = if second { DQuat::from_rotation_y(PI) } else { DQuat::IDENTITY };
    (DVec3::new(cross_street(column) + PLOT.0 * (f64::from(column) + 0.5), 0.0, z), turn)
}

/// How far a column is moved by the cross streets before it: one after every fourth house.
fn cross_street(column: u32) -> f64 {
    STREET * f64::from(column / 4)
}

/// Ground in squares, so that a far one is not drawn for a near one.
fn ground(writer: &mut GlbWriter, material: MaterialId, rules: &CityRules) -> Result<(), MadeError> {
    let (last, _) = plot(2 * rules.blocks - 1, rules.columns - 1);
    let margin = 6.0;
    let size = DVec2::new(last.x + PLOT.0 * 0.5, last.z + PLOT.1 * 0.5 + STREET) + 2.0 * margin;
    let mut mesh = Triangles::default();
    let [x, z] = size.to_array().map(|side| (side / 6.0).ceil() as u32);
    push_patch(&mut mesh, Vec3::ZERO, Vec3::Z * size.y as f32, Vec3::X * size.x as f32, [z, x]);
    let mesh = writer.mesh("ground", &mesh, Some(material))?;
    let translation = DVec3::new(-margin, 0.0, -margin);
    writer.node(Node { name: "ground".into(), mesh: Some(mesh), translation, rotation: DQuat::IDENTITY })?;
    Ok(())
}

/// Outer walls with windows and panels, floors, and the wall between the two rooms of each storey.
fn walls(house: &House) -> Triangles {
    let mut mesh = Triangles::default();
    let half = house.size * 0.5;
    for storey in 0..house.storeys {
        let base = f64::from(storey) * STOREY;
        for side in 0..4 {
            // Each wall is built as the front and turned; only the front of the ground floor has a door.
            let turn = DQuat::from_rotation_y(f64::from(side) * FRAC_PI_2);
            let (length, out) = if side % 2 == 0 { (house.size.x, half.y) } else { (house.size.y, half.x) };
            let door = (side == 0 && storey == 0).then_some(-length * 0.25);
            let mut part = Triangles::default();
            outer_wall(&mut part, length, out, door);
            append(&mut mesh, &part, turn, DVec3::Y * base);
        }
        let inner = half - WALL;
        let slab = |mesh: &mut Triangles, top: f64| {
            let (min, max) = (DVec3::new(-inner.x, top - SLAB, -inner.y), DVec3::new(inner.x, top, inner.y));
            mesh.push_box(min.as_vec3(), max.as_vec3());
        };
        slab(&mut mesh, base + 0.02);
        if storey + 1 == house.storeys {
            slab(&mut mesh, base + STOREY);
        }
        // Between the rooms, with an opening a third of the way in.
        let opening = -inner.y * 0.3;
        let top = base + STOREY - SLAB + 0.05;
        let mut between = |from: f64, to: f64, bottom: f64| {
            let (min, max) = (DVec3::new(-0.06, bottom, from), DVec3::new(0.06, top, to));
            mesh.push_box(min.as_vec3(), max.as_vec3());
        };
        between(-inner.y, opening - 0.5, base);
        between(opening + 0.5, inner.y, base);
        between(opening - 0.5, opening + 0.5, base + DOOR.1);
    }
    mesh
}

/// The wall at z = −`out`, `length` along x, one storey high: solid pieces, and panels before them.
fn outer_wall(mesh: &mut Triangles, length: f64, out: f64, door: Option<f64>) {
    let (sill, head, width, distance) = WINDOW;
    let count = (length / distance).floor().max(1.0);
    let openings: Vec<[f64; 4]> = (0..count as u32)
        .map(|window| ((f64::from(window) + 0.5) / count - 0.5) * length)
        .filter(|middle| door.is_none_or(|door| (middle - door).abs() > 0.5 * (width + DOOR.0) + 0.2))
        .map(|middle| [middle - 0.5 * width, middle + 0.5 * width, sill, head])
        .chain(door.map(|door| [door - 0.5 * DOOR.0, door + 0.5 * DOOR.0, 0.0, DOOR.1]))
        .collect();
    let mut openings = openings;
    openings.sort_by(|a, b| a[0].total_cmp(&b[0]));
    let mut solid = |from: f64, to: f64, bottom: f64, top: f64| {
        if to - from < 1e-3 || top - bottom < 1e-3 {
            return;
        }
        let (min, max) = (DVec3::new(from, bottom, -out), DVec3::new(to, top, WALL - out));
        mesh.push_box(min.as_vec3(), max.as_vec3());
        let cells = [to - from, top - bottom].map(|side| (side / PANEL).round().max(1.0) as u32);
        // Toward −Z: up × right, as seen from outside.
        let corner = DVec3::new(from, bottom, -out - PROUD).as_vec3();
        push_patch(mesh, corner, Vec3::Y * (top - bottom) as f32, Vec3::X * (to - from) as f32, [cells[1], cells[0]]);
    };
    let mut x = -0.5 * length;
    for &[from, to, bottom, top] in &openings {
        solid(x, from, 0.0, STOREY);
        solid(from, to, 0.0, bottom);
        solid(from, to, top, STOREY);
        x = to;
    }
    solid(x, 0.5 * length, 0.0, STOREY);
    for &[from, to, bottom, top] in openings.iter().filter(|opening| opening[2] > 0.0) {
        // A bar in each window.
        let (x, z) = ((from + to) * 0.5, 0.5 * WALL - out);
        let (min, max) = (DVec3::new(x - 0.03, bottom, z - 0.03), DVec3::new(x + 0.03, top, z + 0.03));
        mesh.push_box(min.as_vec3(), max.as_vec3());
    }
}

/// Two slopes in panels, closed below and at the gables, and a chimney.
fn roof(house: &House) -> Triangles {
    let mut mesh = Triangles::default();
    let half = house.size * 0.5 + EAVES;
    let eaves = f64::from(house.storeys) * STOREY + 0.02;
    let ridge = eaves + half.y * PITCH;
    let cells = [half.x * 2.0, half.y.hypot(ridge - eaves)].map(|side| (side / PANEL).round().max(1.0) as u32);
    push_prism(&mut mesh, half, eaves, ridge, cells);
    let at = DVec3::new(half.x * 0.5, 0.0, half.y * 0.4);
    let (min, max) = (DVec3::new(-0.3, eaves, -0.3), DVec3::new(0.3, ridge + 0.5, 0.3));
    mesh.push_box((at + min).as_vec3(), (at + max).as_vec3());
    mesh
}

fn append(mesh: &mut Triangles, part: &Triangles, turn: DQuat, offset: DVec3) {
    let first = mesh.positions.len() as u32;
    let moved = |corner: &Vec3| (turn * corner.as_dvec3() + offset).as_vec3();
    mesh.positions.extend(part.positions.iter().map(moved));
    mesh.indices.extend(part.indices.iter().map(|index| index + first));
}

/// Furniture of a house: piece (`None` is a bookcase), place and heading. It stands along the walls, clear of doors and of
/// each other; the middle of each room stays free to walk in.
fn furnish(house: &House, pieces: &[Piece], chance: &mut Pcg64) -> Vec<(Option<usize>, DVec3, f64)> {
    let half = house.size * 0.5 - WALL;
    let mut placed = Vec::new();
    for storey in 0..house.storeys {
        let base = f64::from(storey) * STOREY + 0.02;
        for side in [-1.0, 1.0] {
            // In the middle of the outer side wall, its back to it.
            let back = half.x - 0.2;
            placed.push((None, DVec3::new(side * back, base, 0.0), -side * FRAC_PI_2));
            for number in 0..4 {
                let piece = chance.random_range(0..pieces.len());
                let radius = pieces[piece].radius + 0.05;
                // Beside the bookcase, then at the wall between the rooms, in the far corner and before it.
                let (x, z) = match number {
                    0 => (half.x - radius, -half.y * 0.5),
                    1 => (half.x - radius, half.y * 0.5),
                    2 => (0.06 + radius, half.y - radius),
                    _ => (0.06 + radius, half.y * 0.25),
                };
                placed.push((Some(piece), DVec3::new(side * x, base, z), chance.random_range(-PI..PI)));
            }
        }
    }
    placed
}

fn path(rules: &CityRules, models: &[(House, [MeshId; 2])]) -> CameraPath {
    let block = 2.0 * PLOT.1 + STREET;
    // The street before the middle block, and the house whose door the path goes through.
    let row = 2 * (rules.blocks / 2);
    let street = f64::from(rules.blocks / 2) * block + 0.5 * STREET;
    let column = (rules.columns / 2).min(4).min(rules.columns - 1);
    let cross = if rules.columns > 4 { 4.0 * PLOT.0 + 0.5 * STREET } else { -0.5 * STREET };
    let door_row = row;
    let (at, _) = plot(door_row, column);
    let (house, _) = models[((door_row * 5 + column * 7) % MODELS) as usize];
    let door = DVec3::new(at.x - house.size.x * 0.25, EYE_HEIGHT, at.z - 0.5 * house.size.y);
    let eye = |x: f64, y: f64, z: f64| DVec3::new(x, y, z);
    let far_x = plot(0, rules.columns - 1).0.x + 0.5 * PLOT.0;
    let far_z = f64::from(rules.blocks) * block;
    // Yaw turns right all the way: −3π/4 looks along +x and +z, −π along +z, −3π/2 along −x.
    let stops: Vec<Stop> = vec![
        (0.00, eye(-40.0, 26.0, -30.0), -0.75 * PI, -0.3),
        (0.14, eye(far_x * 0.3, 24.0, -32.0), -PI, -0.25),
        (0.28, eye(far_x + 25.0, 22.0, -20.0), -1.25 * PI, -0.25),
        (0.40, eye(far_x + 28.0, 16.0, far_z * 0.3), -1.45 * PI, -0.2),
        (0.48, eye(far_x + 12.0, 1.8, street), -1.5 * PI, 0.0),
        (0.60, eye(cross + 3.0, 1.7, street + 1.0), -1.52 * PI, 0.0),
        (0.68, eye(cross, 9.0, street - 0.6 * block), -1.1 * PI, -0.1),
        (0.78, eye(cross - 4.0, 14.0, street - block), -0.8 * PI, -0.2),
        (0.85, eye(door.x, 3.0, street - 1.0), -PI, -0.1),
        (0.88, eye(door.x, EYE_HEIGHT, street + 1.5), -PI, 0.0),
        (0.92, eye(door.x, EYE_HEIGHT, door.z + 1.2), -PI, 0.0),
        (0.96, eye(door.x, EYE_HEIGHT, at.z + 0.5), -PI - 1.4, 0.0),
        (1.00, eye(door.x, EYE_HEIGHT, at.z), -PI - 3.3, -0.05),
    ];
    CameraPath::through(&stops, rules.cameras)
}

#[cfg(test)]
mod tests {
    use eyeline_visibility::{LoadOptions, RayScene, Resolution, exact_set, load_glb};

    use super::*;

    fn small() -> CityRules {
        CityRules { columns: 2, blocks: 1, cameras: 60, seed: 3 }
    }

    #[test]
    fn the_city_has_about_half_a_million_triangles() {
        let made = make(&CityRules { cameras: 160, ..CityRules::default() }).unwrap();
        assert!((500_000..600_000).contains(&made.triangles), "{}", made.triangles);
        assert_eq!(made.cameras.cameras.len(), 160);
    }

    #[test]
    fn same_rules_same_bytes_and_bad_rules_are_named() {
        let (a, b) = (make(&small()).unwrap(), make(&small()).unwrap());
        assert!(a.glb == b.glb && a.cameras == b.cameras);
        assert!(make(&CityRules { seed: 4, ..small() }).unwrap().glb != a.glb);
        let message = make(&CityRules { blocks: 0, ..small() }).unwrap_err().to_string();
        assert!(message.contains("blocks = 0: give 1 to 100"));
    }

    #[test]
    fn furniture_stands_in_its_room_and_apart() {
        let pieces = pieces();
        for number in 0..20 {
            let mut chance = chance(number, 51);
            let size = DVec2::new(chance.random_range(9.0..11.0), chance.random_range(7.5..9.0));
            let placed = furnish(&House { size, storeys: 1 }, &pieces, &mut chance);
            assert_eq!(placed.len(), 10);
            // A bookcase is 1.0 × 0.3 m, its long side along the wall.
            let reach =
                |piece: Option<usize>| piece.map_or(DVec2::new(0.15, 0.5), |piece| DVec2::splat(pieces[piece].radius));
            for (i, &(piece, at, _)) in placed.iter().enumerate() {
                let (at, half) = (DVec2::new(at.x, at.z), reach(piece));
                assert!((at.abs() + half).cmple(size * 0.5 - WALL + 1e-6).all(), "{number}.{i}");
                assert!(at.x.abs() - half.x > 0.06, "{number}.{i}");
                for &(other, there, _) in &placed[i + 1..] {
                    let apart = (at - DVec2::new(there.x, there.z)).abs() - half - reach(other);
                    let distance = at.distance(DVec2::new(there.x, there.z));
                    assert!(apart.max_element() > 0.0 || distance > half.x + reach(other).x, "{number}.{i}");
                }
            }
        }
    }

    #[test]
    fn the_path_ends_in_a_room_and_no_eye_is_in_a_wall() {
        let made = make(&small()).unwrap();
        let scene = load_glb(&made.glb, "city", &LoadOptions::default()).unwrap();
        let rays = RayScene::new(&scene);
        let views = made.cameras.views(scene.anchor(), Resolution::new(64, 64));
        for (number, view) in views.iter().enumerate() {
            let free = |way: DVec3| rays.first_hit(view.eye, way, 0.0, 0.1).is_none();
            assert!([DVec3::X, DVec3::NEG_X, DVec3::Z, DVec3::NEG_Z].into_iter().all(free), "view {number}");
            assert!(!exact_set(&scene, view).0.is_empty(), "view {number}");
        }
        let roofed = |eye: DVec3| rays.first_hit(eye, DVec3::Y, 0.0, 2.0).is_some();
        assert!(roofed(views[59].eye) && !roofed(views[0].eye));
    }
}
