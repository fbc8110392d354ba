//! Cost follows what is visible, not what is there (DESIGN.md §3, promise 5): the same rooms in a building of four times as
//! many rooms, and the same views of them.

mod every;
mod made;

use std::sync::Arc;

use eyeline_visibility::{
    Budget, Cplp, CplpCuller, Culler, EyeRegion, MaskedCplp, Resolution, Scene, Scratch, Sides, Traversal, Triangle,
    View, exact_set,
};
use glam::Vec3;
use rand::SeedableRng;
use rand_pcg::Pcg64;

/// Rooms along a side of the smaller building.
const SIDE: u32 = 8;

/// `blocks` × `blocks` times the same building of 8 × 8 rooms, whose outer walls are shut: none shows anything of the others.
fn blocks(blocks: u32) -> Scene {
    let block = made::building(SIDE, 10, 31);
    let mut triangles: Vec<Triangle> = Vec::new();
    for x in 0..blocks {
        for z in 0..blocks {
            let offset = Vec3::new(x as f32, 0.0, z as f32) * (SIDE as f32 * made::ROOM + 1.0);
            let moved = |t: &Triangle| Triangle { corners: t.corners.map(|corner| corner + offset), ..*t };
            triangles.extend(block.triangles().iter().map(moved));
        }
    }
    Scene::from_triangles(triangles)
}

/// A building of `side` × `side` rooms with doors in all inner walls. The smaller one is a corner of the larger one, but for its
/// outer walls.
fn open_plan(side: u32) -> Scene {
    let mut triangles: Vec<Triangle> = Vec::new();
    let length = side as f32 * made::ROOM;
    let mut solid = |min: Vec3, max: Vec3| made::add_box(&mut triangles, min, max, Sides::Both, true);
    solid(Vec3::new(-0.1, -0.2, -0.1), Vec3::new(length + 0.1, 0.0, length + 0.1));
    solid(Vec3::new(-0.1, 3.0, -0.1), Vec3::new(length + 0.1, 3.2, length + 0.1));
    for line in 0..=side {
        for room in 0..side {
            let (at, from) = (line as f32 * made::ROOM, room as f32 * made::ROOM);
            // By the place alone, so that they are the same in buildings of all sizes.
            let door = |axis: u32| from + 0.5 + ((line * 7 + room * 13 + axis * 5) % 11) as f32 / 11.0 * 3.0;
            for axis in 0..2 {
                let pieces = if line == 0 || line == side {
                    vec![[from, from + made::ROOM, 0.0]]
                } else {
                    let door = door(axis);
                    vec![[from, door, 0.0], [door, door + 1.0, 2.1], [door + 1.0, from + made::ROOM, 0.0]]
                };
                for [begin, end, low] in pieces {
                    let (min, max) = (Vec3::new(at - 0.1, low, begin), Vec3::new(at + 0.1, 3.0, end));
                    if axis == 0 {
                        solid(min, max);
                    } else {
                        solid(Vec3::new(min.z, min.y, min.x), Vec3::new(max.z, max.y, max.x));
                    }
                }
            }
            if line < side {
                let corner = Vec3::new(at, 0.0, from);
                for i in 0..6 {
                    let place = corner + Vec3::new(0.6 + i as f32 * 0.6, 0.0, 0.6 + (i * 5 % 6) as f32 * 0.6);
                    solid(place, place + Vec3::new(0.3, 0.8, 0.4));
                }
            }
        }
    }
    Scene::from_triangles(triangles)
}

fn sum(culler: &dyn Culler, views: &[View], scratch: &mut Scratch) -> Traversal {
    let mut total = Traversal::default();
    for view in views {
        let done = culler.cull(view, EyeRegion::point(view.eye), scratch).traversal;
        total.cells_projected += done.cells_projected;
        total.queries += done.queries;
        total.triangles_drawn += done.triangles_drawn;
        total.polygons_drawn += done.polygons_drawn;
        total.bounds_tested += done.bounds_tested;
        total.sealed += done.sealed;
    }
    total
}

fn in_kd_trees(scene: &Arc<Scene>) -> [(&'static str, Box<dyn Culler>); 2] {
    let (_, kd) = every::tessellations(scene);
    let cplp = Arc::new(Cplp::new(kd.clone()));
    [
        ("masks", Box::new(MaskedCplp::new(scene.clone(), kd))),
        ("cPLP", Box::new(CplpCuller::new(scene.clone(), cplp, Budget::default()))),
    ]
}

/// Panics unless each counter of the larger scene is below 1.2 times that of the smaller one.
fn compare(small: Scene, large: Scene, views: &[View]) {
    assert!(large.triangles().len() as f64 > 3.8 * small.triangles().len() as f64);
    let (small, large) = (Arc::new(small), Arc::new(large));
    let mut exact = [0, 0];
    for view in views {
        exact[0] += exact_set(&small, view).0.len();
        exact[1] += exact_set(&large, view).0.len();
    }
    assert!(exact[1] as f64 <= 1.01 * exact[0] as f64, "the views show different things: {exact:?}");
    let mut scratch = Scratch::default();
    for ((name, in_small), (_, in_large)) in in_kd_trees(&small).iter().zip(&in_kd_trees(&large)) {
        let (few, many) = (sum(&**in_small, views, &mut scratch), sum(&**in_large, views, &mut scratch));
        eprintln!("{name}: {few:?}\n  in 4 times the rooms: {many:?}");
        for (what, few, many) in [
            ("cells visited", few.cells_projected, many.cells_projected),
            ("cells asked about", few.queries, many.queries),
            ("triangles drawn", few.triangles_drawn, many.triangles_drawn),
            ("polygons drawn", few.polygons_drawn, many.polygons_drawn),
            ("bounds tested", few.bounds_tested, many.bounds_tested),
        ] {
            assert!(many as f64 <= 1.2 * few as f64, "{name}, {what}: {few} to {many}");
        }
    }
}

/// Views from rooms of the smaller building.
fn visits(rooms: u32, count: usize) -> Vec<View> {
    let mut rng = Pcg64::seed_from_u64(32);
    (0..count).map(|_| made::visitor(&mut rng, rooms, Resolution::new(320, 240))).collect()
}

#[test]
fn four_times_the_rooms_behind_shut_walls_cost_the_same() {
    compare(blocks(1), blocks(2), &visits(SIDE, 200));
}

#[test]
fn four_times_the_rooms_behind_doors_cost_the_same() {
    // Views that do not reach where the smaller one ends.
    let mut rng = Pcg64::seed_from_u64(33);
    let small = Arc::new(open_plan(SIDE));
    let large = Arc::new(open_plan(2 * SIDE));
    let mut views = Vec::new();
    while views.len() < 40 {
        let view = made::visitor(&mut rng, SIDE / 2, Resolution::new(320, 240));
        let view = View { eye: view.eye + glam::DVec3::new(2.5, 0.0, 2.5), ..view };
        if exact_set(&small, &view).0.len() == exact_set(&large, &view).0.len() {
            views.push(view);
        }
    }
    compare(Arc::unwrap_or_clone(small), Arc::unwrap_or_clone(large), &views);
}
