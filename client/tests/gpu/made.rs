//! Rooms with doors, furniture, a picture on each wall and a sheet of glass, and where to stand in them.

use std::sync::Arc;

use eyeline_client::gpu::{Gpu, GpuScene};
use eyeline_visibility::{Aabb, Resolution, Scene, Sides, Triangle, View};
use glam::{DQuat, DVec3, Vec3};
use rand::{RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64Mcg;

/// Rooms a side, and metres a room.
const ROOMS: i32 = 4;
const SIDE: f32 = 5.0;

fn quad(corners: [Vec3; 4], sides: Sides, occludes: bool) -> [Triangle; 2] {
    [[0, 1, 2], [0, 2, 3]].map(|at| Triangle { corners: at.map(|i| corners[i]), sides, occludes })
}

/// A box from `min` to `max`, closed and seen from outside.
fn cuboid(min: Vec3, max: Vec3) -> Vec<Triangle> {
    let at = |x: usize, y: usize, z: usize| Vec3::new([min.x, max.x][x], [min.y, max.y][y], [min.z, max.z][z]);
    let faces = [
        [at(0, 0, 1), at(1, 0, 1), at(1, 1, 1), at(0, 1, 1)],
        [at(1, 0, 0), at(0, 0, 0), at(0, 1, 0), at(1, 1, 0)],
        [at(1, 0, 1), at(1, 0, 0), at(1, 1, 0), at(1, 1, 1)],
        [at(0, 0, 0), at(0, 0, 1), at(0, 1, 1), at(0, 1, 0)],
        [at(0, 1, 1), at(1, 1, 1), at(1, 1, 0), at(0, 1, 0)],
        [at(0, 0, 0), at(1, 0, 0), at(1, 0, 1), at(0, 0, 1)],
    ];
    faces.into_iter().flat_map(|face| quad(face, Sides::Front, true)).collect()
}

/// A closed box around a point.
pub fn closed_box(centre: Vec3, half: f32) -> [Triangle; 12] {
    cuboid(centre - half, centre + half).try_into().expect("six sides of two triangles")
}

/// The rooms, their furniture from a seed.
pub fn rooms(seed: u64) -> Scene {
    let mut rng = Pcg64Mcg::seed_from_u64(seed);
    let all = ROOMS as f32 * SIDE;
    let mut triangles = cuboid(Vec3::new(0.0, -0.2, 0.0), Vec3::new(all, 0.0, all));
    triangles.extend(cuboid(Vec3::new(0.0, 3.0, 0.0), Vec3::new(all, 3.2, all)));
    for axis in 0..2 {
        for line in 0..=ROOMS {
            for room in 0..ROOMS {
                let from = room as f32 * SIDE;
                let door = if line == 0 || line == ROOMS { 0.0 } else { 1.0 };
                let at = from + rng.random_range(0.5..SIDE - 1.5);
                let mut wall = |from: f32, to: f32, low: f32| {
                    let (near, far) = (line as f32 * SIDE - 0.1, line as f32 * SIDE + 0.1);
                    let place = |along: f32, across: f32, y: f32| {
                        if axis == 0 { Vec3::new(along, y, across) } else { Vec3::new(across, y, along) }
                    };
                    let (a, b) = (place(from, near, low), place(to, far, 3.0));
                    triangles.extend(cuboid(a.min(b), a.max(b)));
                };
                wall(from, at, 0.0);
                wall(at + door, from + SIDE, 0.0);
                if door > 0.0 {
                    wall(at, at + door, 2.1);
                }
            }
        }
    }
    for room in 0..ROOMS * ROOMS {
        let corner = Vec3::new((room % ROOMS) as f32, 0.0, (room / ROOMS) as f32) * SIDE;
        for _ in 0..5 {
            let mut any = |low: f32, high: f32| rng.random_range(low..high);
            let at = corner + Vec3::new(any(0.4, SIDE - 1.2), 0.0, any(0.4, SIDE - 1.2));
            triangles.extend(cuboid(at, at + Vec3::new(any(0.2, 0.8), any(0.3, 1.9), any(0.2, 0.8))));
        }
        // In the plane of a wall, from both sides, and glass in the room.
        let picture = corner + Vec3::new(1.0, 1.2, 0.1);
        let sheet = |at: Vec3| [at, at + Vec3::X, at + Vec3::X + Vec3::Y * 0.7, at + Vec3::Y * 0.7];
        triangles.extend(quad(sheet(picture), Sides::Both, true));
        triangles.extend(quad(sheet(picture + Vec3::Z * 2.0), Sides::Both, false));
    }
    Scene::from_triangles(triangles)
}

/// Views from eyes in rooms, in walls, on their faces and outside.
pub fn views(seed: u64, count: usize, resolution: Resolution) -> Vec<View> {
    let mut rng = Pcg64Mcg::seed_from_u64(seed);
    let all = f64::from(ROOMS) * f64::from(SIDE);
    (0..count)
        .map(|at| {
            let mut any = |low: f64, high: f64| rng.random_range(low..high);
            let mut eye = DVec3::new(any(0.3, all - 0.3), any(0.4, 2.6), any(0.3, all - 0.3));
            match at % 8 {
                // In the wall, on its face, outside.
                5 => eye.x = f64::from(SIDE),
                6 => eye.z = f64::from(SIDE) * 2.0 + f64::from(0.1_f32),
                7 => eye = DVec3::new(any(-8.0, -2.0), any(0.5, 6.0), any(0.0, all)),
                _ => {}
            }
            let orientation = DQuat::from_euler(glam::EulerRot::YXZ, any(-3.2, 3.2), any(-0.5, 0.5), any(-0.1, 0.1));
            View { eye, orientation, fov_x: any(0.7, 1.9), resolution, near: 0.02 }
        })
        .collect()
}

/// Boxes around an eye, most of them before it, near and far, small and large, some of them flat.
pub fn boxes(view: &View, seed: u64, count: usize) -> Vec<Aabb> {
    let mut rng = Pcg64Mcg::seed_from_u64(seed);
    (0..count)
        .map(|at| {
            let mut any = |low: f64, high: f64| rng.random_range(low..high);
            let forward =
                view.orientation * DVec3::new(any(-0.9, 0.9), any(-0.6, 0.6), if at % 5 == 0 { 1.0 } else { -1.0 });
            let centre = view.eye + forward * 10.0_f64.powf(any(-0.6, 1.3));
            let mut half = DVec3::new(any(0.01, 1.0), any(0.01, 1.0), any(0.01, 1.0)) * 10.0_f64.powf(any(-1.5, 0.3));
            if at % 9 == 0 {
                half[at % 3] = 0.0;
            }
            Aabb::around(centre, half)
        })
        .collect()
}

/// The scene on an adapter.
pub fn uploaded(gpu: &Gpu, scene: &Scene) -> Arc<GpuScene> {
    Arc::new(GpuScene::new(gpu, scene).unwrap())
}

/// All ids of a scene.
pub fn all(scene: &Scene) -> Vec<u32> {
    (0..scene.triangles().len() as u32).collect()
}
