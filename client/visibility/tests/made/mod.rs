//! Scenes that tests and benchmarks make: soups, and buildings of rooms with doors and furniture.

#![allow(dead_code, reason = "each user takes what it needs")]

use std::f64::consts::{PI, TAU};

use eyeline_visibility::{Resolution, Scene, Sides, Triangle, View};
use glam::{DQuat, DVec3, Vec3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

/// Side of a room, height of a storey, door width and height, wall thickness, in metres.
pub const ROOM: f32 = 5.0;
const HEIGHT: f32 = 3.0;
const DOOR: [f32; 2] = [1.0, 2.1];
const WALL: f32 = 0.1;

/// Adds the twelve triangles of a box.
pub fn add_box(triangles: &mut Vec<Triangle>, min: Vec3, max: Vec3, sides: Sides, occludes: bool) {
    let corner = |i: usize| {
        Vec3::new(
            if i & 1 == 0 { min.x } else { max.x },
            if i & 2 == 0 { min.y } else { max.y },
            if i & 4 == 0 { min.z } else { max.z },
        )
    };
    for [a, b, c, d] in [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]] {
        for corners in [[a, b, c], [a, c, d]] {
            triangles.push(Triangle { corners: corners.map(corner), sides, occludes });
        }
    }
}

/// Adds the two triangles of a wall without thickness at `at` of an axis; `low` and `high` are along the two axes after it.
pub fn add_plate(triangles: &mut Vec<Triangle>, axis: usize, at: f32, low: [f32; 2], high: [f32; 2], sides: Sides) {
    let corner = |u: f32, v: f32| {
        let mut corner = Vec3::splat(at);
        corner[(axis + 1) % 3] = u;
        corner[(axis + 2) % 3] = v;
        corner
    };
    let [a, b, c, d] =
        [corner(low[0], low[1]), corner(high[0], low[1]), corner(high[0], high[1]), corner(low[0], high[1])];
    triangles.extend([[a, b, c], [a, c, d]].map(|corners| Triangle { corners, sides, occludes: true }));
}

/// Triangles that scenes are poor in: an ordinary one, one that is a point, one of a kilometre, a sliver, one of a
/// millimetre.
pub fn poor() -> [Triangle; 5] {
    let triangle = |corners: [[f32; 3]; 3]| Triangle {
        corners: corners.map(Vec3::from_array),
        sides: Sides::Both,
        occludes: true,
    };
    [
        triangle([[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]),
        triangle([[1.0, 1.0, 1.0]; 3]),
        triangle([[-1e3, -0.5, -1e3], [1e3, -0.5, -1e3], [0.0, -0.5, 1e3]]),
        triangle([[-1e3, 0.0, 0.0], [1e3, 0.0, 1e-3], [0.0, 1e-4, 0.0]]),
        triangle([[0.0, 0.0, 0.0], [1e-3, 0.0, 0.0], [0.0, 1e-3, 0.0]]),
    ]
}

/// A storey of `side` × `side` rooms from the origin to +x and +z, a door in each inner wall, `furniture` small boxes per
/// room, of which some are single-sided and some are glass.
pub fn building(side: u32, furniture: u32, seed: u64) -> Scene {
    let mut rng = Pcg64::seed_from_u64(seed);
    let mut triangles = Vec::new();
    let length = side as f32 * ROOM;
    let mut solid = |min: Vec3, max: Vec3| add_box(&mut triangles, min, max, Sides::Both, true);
    solid(Vec3::new(-WALL, -0.2, -WALL), Vec3::new(length + WALL, 0.0, length + WALL));
    solid(Vec3::new(-WALL, HEIGHT, -WALL), Vec3::new(length + WALL, HEIGHT + 0.2, length + WALL));
    for line in 0..=side {
        for room in 0..side {
            let at = line as f32 * ROOM;
            let [from, to] = [room as f32 * ROOM, (room + 1) as f32 * ROOM];
            let door = from + rng.random_range(0.5..ROOM - DOOR[0] - 0.5);
            // Stretches along the wall and their heights: beside the door, and above it.
            let pieces: &[[f32; 3]] = if line == 0 || line == side {
                &[[from, to, 0.0]]
            } else {
                &[[from, door, 0.0], [door, door + DOOR[0], DOOR[1]], [door + DOOR[0], to, 0.0]]
            };
            for &[begin, end, low] in pieces {
                solid(Vec3::new(at - WALL, low, begin), Vec3::new(at + WALL, HEIGHT, end));
                solid(Vec3::new(begin, low, at - WALL), Vec3::new(end, HEIGHT, at + WALL));
            }
        }
    }
    for room in 0..side * side {
        let corner = Vec3::new((room % side) as f32 * ROOM, 0.0, (room / side) as f32 * ROOM);
        for _ in 0..furniture {
            let mut within = |from: f32, to: f32| rng.random_range(from..to);
            let size = Vec3::new(within(0.1, 0.8), within(0.1, 1.2), within(0.1, 0.8));
            let at = corner + Vec3::new(within(0.3, ROOM - 1.2), within(0.0, 0.5), within(0.3, ROOM - 1.2));
            let sides = if rng.random() { Sides::Both } else { Sides::Front };
            add_box(&mut triangles, at, at + size, sides, rng.random_bool(0.9));
        }
    }
    Scene::from_triangles(triangles)
}

/// Triangles of all sizes around the origin: one-sided and two-sided, glass, duplicates, coplanar and zero-area ones.
pub fn soup(seed: u64, count: usize) -> Scene {
    let mut rng = Pcg64::seed_from_u64(seed);
    let mut triangles: Vec<Triangle> = Vec::new();
    while triangles.len() < count {
        let at = Vec3::from_array(std::array::from_fn(|_| rng.random_range(-5.0..5.0_f32)));
        let size = 10.0_f32.powf(rng.random_range(-2.0..1.2));
        let mut corners: [Vec3; 3] =
            std::array::from_fn(|_| at + size * Vec3::from_array(std::array::from_fn(|_| rng.random_range(-1.0..1.0))));
        match rng.random_range(0..12) {
            0 => corners[2] = corners[1],
            1 => corners[2] = (corners[0] + corners[1]) * 0.5,
            2 => corners.iter_mut().for_each(|corner| corner.y = 1.0),
            3 if !triangles.is_empty() => corners = triangles[rng.random_range(0..triangles.len())].corners,
            _ => {}
        }
        let sides = if rng.random() { Sides::Both } else { Sides::Front };
        triangles.push(Triangle { corners, sides, occludes: rng.random_bool(0.85) });
    }
    Scene::from_triangles(triangles)
}

/// A view in any direction, with an angle of view from 0.1° to 179°.
pub fn any_view(rng: &mut Pcg64, eye: DVec3, resolution: Resolution) -> View {
    let mut unit = || rng.random_range(-1.0..1.0);
    let orientation = DQuat::from_xyzw(unit(), unit(), unit(), unit() + 1e-3).normalize();
    let fov_x = match rng.random_range(0..10) {
        0 => 0.1_f64.to_radians(),
        1 => 179.0_f64.to_radians(),
        _ => rng.random_range(0.3..PI - 0.3),
    };
    let near = if rng.random_bool(0.2) { 1.0 } else { 0.01 };
    View { eye, orientation, fov_x, resolution, near }
}

/// A level view from eye height in a building of `side` × `side` rooms, with 80° across.
pub fn visitor(rng: &mut Pcg64, side: u32, resolution: Resolution) -> View {
    let length = f64::from(side as f32 * ROOM);
    let mut along = || rng.random_range(0.2..length - 0.2);
    let eye = DVec3::new(along(), 1.6, along());
    View::level(eye, rng.random_range(0.0..TAU), 80.0_f64.to_radians(), resolution)
}

/// So many of them, always the same.
pub fn visitors(count: usize, side: u32, resolution: Resolution) -> Vec<View> {
    let mut rng = Pcg64::seed_from_u64(2);
    (0..count).map(|_| visitor(&mut rng, side, resolution)).collect()
}

/// The same triangles as a .glb file of nodes with `boxes` boxes of twelve triangles each, loaded: what does not occlude
/// blends, and each node's mesh has one primitive per kind of triangle.
pub fn with_nodes(scene: &Scene, boxes: usize) -> Scene {
    use serde_json::{Value, json};
    let kinds = [(Sides::Front, true), (Sides::Front, false), (Sides::Both, true), (Sides::Both, false)];
    let material = |(sides, occludes): (Sides, bool)| json!({"doubleSided": sides == Sides::Both, "alphaMode": if occludes { "OPAQUE" } else { "BLEND" }});
    let (mut bytes, mut views, mut accessors, mut meshes, mut nodes) = (vec![], vec![], vec![], vec![], vec![]);
    for chunk in scene.triangles().chunks(12 * boxes) {
        let mut primitives: Vec<Value> = Vec::new();
        for (index, kind) in kinds.iter().enumerate() {
            let of_kind: Vec<&Triangle> = chunk.iter().filter(|t| (t.sides, t.occludes) == *kind).collect();
            if of_kind.is_empty() {
                continue;
            }
            let corners: Vec<Vec3> = of_kind.iter().flat_map(|t| t.corners).collect();
            let least = corners.iter().copied().reduce(Vec3::min).unwrap();
            let greatest = corners.iter().copied().reduce(Vec3::max).unwrap();
            views.push(json!({"buffer": 0, "byteOffset": bytes.len(), "byteLength": corners.len() * 12}));
            accessors.push(json!({
                "bufferView": views.len() - 1, "componentType": 5126, "count": corners.len(), "type": "VEC3",
                "min": least.to_array(), "max": greatest.to_array(),
            }));
            primitives.push(json!({"attributes": {"POSITION": accessors.len() - 1}, "material": index}));
            bytes.extend(corners.iter().flat_map(|c| c.to_array()).flat_map(f32::to_le_bytes));
        }
        meshes.push(json!({"primitives": primitives}));
        nodes.push(json!({"mesh": meshes.len() - 1, "name": format!("part {}", nodes.len())}));
    }
    let all: Vec<usize> = (0..nodes.len()).collect();
    let mut description = json!({
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": all}], "nodes": nodes, "meshes": meshes,
        "materials": kinds.map(material), "accessors": accessors, "bufferViews": views,
        "buffers": [{"byteLength": bytes.len()}],
    })
    .to_string()
    .into_bytes();
    description.resize(description.len().next_multiple_of(4), b' ');
    let word = |n: usize| (n as u32).to_le_bytes();
    let glb = [
        &b"glTF"[..],
        &word(2),
        &word(12 + 8 + description.len() + 8 + bytes.len()),
        &word(description.len()),
        b"JSON",
        &description,
        &word(bytes.len()),
        b"BIN\0",
        &bytes,
    ]
    .concat();
    eyeline_visibility::load_glb(&glb, "made", &eyeline_visibility::LoadOptions::default()).unwrap()
}
