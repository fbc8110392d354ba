//! Scenes that are hard on numbers, each made from a few lines so that its trouble can be read off.

use std::sync::Arc;

use eyeline_visibility::{LoadError, LoadOptions, Resolution, Scene, Sides, Triangle, View, load_glb};
use glam::{DQuat, DVec3, Vec3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use crate::scene::glb::{GlbWriter, Node, Triangles};

/// A triangle that is seen from both sides and hides what is behind it.
pub fn triangle(corners: [Vec3; 3]) -> Triangle {
    Triangle { corners, sides: Sides::Both, occludes: true }
}

/// The twelve triangles of a closed box.
pub fn push_box(triangles: &mut Vec<Triangle>, min: Vec3, max: Vec3) {
    let mut mesh = Triangles::default();
    mesh.push_box(min, max);
    triangles.extend(mesh.indices.chunks(3).map(|t| triangle([0, 1, 2].map(|i| mesh.positions[t[i] as usize]))));
}

/// Rooms with doors and a box in each, on a floor of `side` × `side`, `scale` times as large as life, moved by `offset`.
pub fn rooms(side: u32, scale: f32, offset: Vec3) -> Arc<Scene> {
    let mut triangles = Vec::new();
    let mut solid = |min: [f32; 3], max: [f32; 3]| {
        let at = |corner: [f32; 3]| Vec3::from(corner) * scale + offset;
        push_box(&mut triangles, at(min), at(max));
    };
    let size = 4.0 * side as f32;
    solid([0.0, -0.2, 0.0], [size, 0.0, size]);
    for i in 0..=side {
        let at = 4.0 * i as f32;
        for j in 0..side {
            let along = 4.0 * j as f32;
            // A wall of 0.2 m with a door of 1 m, but on the outside.
            let (door, end) = if i == 0 || i == side { (along + 4.0, along + 4.0) } else { (along + 1.5, along + 2.5) };
            solid([at - 0.1, 0.0, along], [at + 0.1, 3.0, door]);
            solid([along, 0.0, at - 0.1], [door, 3.0, at + 0.1]);
            if end < along + 4.0 {
                solid([at - 0.1, 0.0, end], [at + 0.1, 3.0, along + 4.0]);
                solid([end, 0.0, at - 0.1], [along + 4.0, 3.0, at + 0.1]);
            }
        }
    }
    for i in 0..side {
        for j in 0..side {
            let (x, z) = (4.0 * i as f32 + 3.0, 4.0 * j as f32 + 0.8);
            solid([x, 0.0, z], [x + 0.4, 0.8, z + 0.4]);
        }
    }
    Arc::new(Scene::from_triangles(triangles))
}

/// Looks at rooms from eyes in them, in every direction.
pub fn visits(side: u32, scale: f64, offset: DVec3, resolution: Resolution, count: usize, seed: u64) -> Vec<View> {
    let mut chance = Pcg64::seed_from_u64(seed);
    let size = 4.0 * f64::from(side);
    (0..count)
        .map(|_| {
            let (x, z) = (chance.random_range(0.3..size - 0.3), chance.random_range(0.3..size - 0.3));
            let eye = DVec3::new(x, chance.random_range(0.5..2.0), z) * scale + offset;
            let yaw = chance.random_range(-3.1..3.1);
            let near = (0.01 * scale).max(View::NEAR_MIN);
            View { near, ..View::level(eye, yaw, 1.5, resolution) }
        })
        .collect()
}

/// The same rooms in a file whose nodes stand `offset` from the origin.
///
/// # Errors
/// As the loader refuses it.
pub fn rooms_file(offset: DVec3) -> Result<Arc<Scene>, LoadError> {
    let scene = rooms(3, 1.0, Vec3::ZERO);
    let mut mesh = Triangles::default();
    for triangle in scene.triangles() {
        for corner in triangle.corners {
            mesh.indices.push(mesh.positions.len() as u32);
            mesh.positions.push(corner);
        }
    }
    let mut writer = GlbWriter::new();
    let material = writer.material("wall", [0.5; 3], true);
    let made = writer.mesh("rooms", &mesh, Some(material)).expect("a finite mesh");
    let node = Node { name: "rooms".into(), mesh: Some(made), translation: offset, rotation: DQuat::IDENTITY };
    writer.node(node).expect("a finite node");
    let bytes = writer.finish().expect("a small file");
    load_glb(&bytes, "rooms.glb", &LoadOptions::default()).map(Arc::new)
}

/// A binary glTF file of one triangle, one of whose corners is `bad`; written by hand, since our writer refuses it.
pub fn file_with(bad: f32) -> Vec<u8> {
    let corners: [f32; 9] = [0.0, 0.0, 0.0, 1.0, bad, 0.0, 0.0, 1.0, 0.0];
    let binary: Vec<u8> = corners.iter().flat_map(|x| x.to_le_bytes()).collect();
    let json = format!(
        r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0]}}],"nodes":[{{"mesh":0}}],"meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}}}}]}}],"accessors":[{{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3","min":[0,0,0],"max":[1,1,0]}}],"bufferViews":[{{"buffer":0,"byteLength":36}}],"buffers":[{{"byteLength":{}}}]}}"#,
        binary.len()
    );
    let mut json = json.into_bytes();
    while json.len() % 4 != 0 {
        json.push(b' ');
    }
    let mut bytes = b"glTF".to_vec();
    bytes.extend(2_u32.to_le_bytes());
    bytes.extend((12 + 8 + json.len() as u32 + 8 + binary.len() as u32).to_le_bytes());
    bytes.extend((json.len() as u32).to_le_bytes());
    bytes.extend(b"JSON");
    bytes.extend(json);
    bytes.extend((binary.len() as u32).to_le_bytes());
    bytes.extend(b"BIN\0");
    bytes.extend(binary);
    bytes
}

/// Millimetres beside ten kilometres: small boxes on and before plates that reach to the horizon.
pub fn small_beside_large() -> Arc<Scene> {
    let mut triangles = Vec::new();
    let plate = |y: f32| [Vec3::new(-1e4, y, -1e4), Vec3::new(1e4, y, -1e4), Vec3::new(0.0, y, 1e4)];
    triangles.push(triangle(plate(0.0)));
    triangles.push(triangle(plate(-1e-3)));
    triangles.push(triangle([Vec3::new(-1e4, -1e4, -50.0), Vec3::new(1e4, -1e4, -50.0), Vec3::new(0.0, 1e4, -50.0)]));
    for i in 0..12 {
        for j in 0..12 {
            let at = Vec3::new(0.05 * i as f32 - 0.3, 0.0, -0.05 * j as f32);
            push_box(&mut triangles, at, at + Vec3::splat(1e-3));
        }
    }
    Arc::new(Scene::from_triangles(triangles))
}

/// Needles: a hundred metres long and from a millimetre down to a nanometre wide, among ordinary boxes.
pub fn slivers(seed: u64) -> Arc<Scene> {
    let mut chance = Pcg64::seed_from_u64(seed);
    let mut triangles = Vec::new();
    for i in 0..200 {
        let mut at = || Vec3::from_array(std::array::from_fn(|_| chance.random_range(-5.0..5.0_f32)));
        let (from, along, side) = (at(), at().normalize_or(Vec3::X) * 100.0, at().normalize_or(Vec3::Y));
        let width = 10_f32.powi(-3 - i % 7);
        triangles.push(triangle([from - along, from + along, from + side * width]));
    }
    for _ in 0..20 {
        let at = Vec3::from_array(std::array::from_fn(|_| chance.random_range(-5.0..5.0_f32)));
        push_box(&mut triangles, at, at + Vec3::splat(0.8));
    }
    Arc::new(Scene::from_triangles(triangles))
}

/// Every face of a lattice of boxes three times over, and neighbours that share their faces.
pub fn coplanar() -> Arc<Scene> {
    let mut triangles = Vec::new();
    for _ in 0..3 {
        for i in 0..4 {
            for j in 0..4 {
                let at = Vec3::new(i as f32, 0.0, j as f32) * 2.0;
                if (i + j) % 3 != 0 {
                    push_box(&mut triangles, at, at + Vec3::new(2.0, 1.5, 2.0));
                }
            }
        }
    }
    Arc::new(Scene::from_triangles(triangles))
}

/// Triangles without area, points, and one good triangle behind them.
pub fn without_area() -> Arc<Scene> {
    let mut triangles: Vec<Triangle> =
        (0..60).map(|i| triangle([Vec3::splat(i as f32 * 0.1), Vec3::ZERO, Vec3::splat(i as f32 * -0.1)])).collect();
    triangles.extend((0..40).map(|i| triangle([Vec3::splat(0.05 * i as f32); 3])));
    triangles.push(triangle([Vec3::new(-2.0, -2.0, -3.0), Vec3::new(2.0, -2.0, -3.0), Vec3::new(0.0, 2.0, -3.0)]));
    Arc::new(Scene::from_triangles(triangles))
}

/// A lattice of small boxes on whole coordinates: all centres of octree cells are cospherical eight by eight.
pub fn lattice() -> Arc<Scene> {
    let mut triangles = Vec::new();
    for i in 0..27 {
        let at = Vec3::new((i % 3) as f32, (i / 3 % 3) as f32, (i / 9) as f32) * 4.0;
        push_box(&mut triangles, at, at + Vec3::splat(1.0));
    }
    Arc::new(Scene::from_triangles(triangles))
}
