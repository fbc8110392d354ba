//! What walls seal off is seen from nowhere in the eyes' parts: held against rays, which share no code with it.

mod made;

use std::sync::Arc;

use eyeline_visibility::{
    Aabb, AllRound, Bound, EyeRegion, KdRules, KdTree, Occlusion, PartsInSight, RayScene, Scene, SealedParts, Sides,
};
use glam::DVec3;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

const ROOM: f32 = 6.0;
const HEIGHT: f32 = 3.0;

/// Rooms in a row along x with walls of paper. `doors[i]` says whether there is a hole in the wall between rooms i and
/// i + 1.
fn row(doors: &[bool]) -> Arc<Scene> {
    let mut triangles = Vec::new();
    let both = Sides::Both;
    for room in 0..=doors.len() {
        let [x, end] = [room as f32 * ROOM, (room + 1) as f32 * ROOM];
        for y in [0.0, HEIGHT] {
            made::add_plate(&mut triangles, 1, y, [0.0, x], [ROOM, end], both);
        }
        for z in [0.0, ROOM] {
            made::add_plate(&mut triangles, 2, z, [x, 0.0], [end, HEIGHT], both);
        }
        match doors.get(room) {
            Some(true) => {
                made::add_plate(&mut triangles, 0, end, [0.0, 0.0], [HEIGHT, 2.0], both);
                made::add_plate(&mut triangles, 0, end, [0.0, 3.0], [HEIGHT, ROOM], both);
                made::add_plate(&mut triangles, 0, end, [2.1, 2.0], [HEIGHT, 3.0], both);
            }
            _ => made::add_plate(&mut triangles, 0, end, [0.0, 0.0], [HEIGHT, ROOM], both),
        }
    }
    made::add_plate(&mut triangles, 0, 0.0, [0.0, 0.0], [HEIGHT, ROOM], both);
    Arc::new(Scene::from_triangles(triangles))
}

fn parts_of(scene: &Scene) -> Arc<SealedParts> {
    Arc::new(SealedParts::new(Arc::new(KdTree::build(scene, KdRules::default()))))
}

fn at(x: f64, y: f64, z: f64) -> DVec3 {
    DVec3::new(x, y, z)
}

fn ball(centre: DVec3, radius: f64) -> Bound {
    Bound::Sphere { centre, radius }
}

#[test]
fn a_room_without_a_door_is_sealed_off_and_one_with_a_door_is_not() {
    let scene = row(&[false, true]);
    let parts = parts_of(&scene);
    let sight = PartsInSight::new(parts.clone());
    assert!(sight.parts().is_none() && !sight.seal_off(&ball(at(3.0, 1.5, 3.0), 0.1)), "nothing is known yet");
    // Anew each time: who was in a part before keeps it for a while.
    let look = |eye: DVec3, radius: f64, bound: Bound| {
        let mut sight = PartsInSight::new(parts.clone());
        sight.look(EyeRegion { centre: eye, radius }, 0.05);
        sight.seal_off(&bound)
    };
    let [first, second, third] = [3.0, 9.0, 15.0].map(|x| at(x, 1.5, 3.0));
    assert!(look(second, 0.3, ball(first, 1.2)) && look(third, 0.3, ball(first, 1.2)));
    assert!(!look(second, 0.3, ball(third, 0.1)), "through the door");
    assert!(look(first, 0.3, ball(third, 1.2)) && !look(first, 0.3, ball(first + DVec3::X, 0.1)));
    // A bound that reaches through the wall, and eyes that do.
    assert!(!look(second, 0.3, ball(first, 3.2)) && !look(second, 3.2, ball(first, 1.0)));
    // Eyes so near to a wall that a picture's near plane cuts it open.
    assert!(!look(at(6.09, 1.5, 3.0), 0.0, ball(first, 1.0)) && look(at(6.2, 1.5, 3.0), 0.0, ball(first, 1.0)));
    // From outside nothing in the rooms is seen, and nothing outside from within.
    let [above, away] = [at(9.0, 3.5, 3.0), at(900.0, 3.0, 0.0)];
    assert!(
        look(above, 0.2, ball(first, 1.0)) && look(away, 0.2, ball(third, 1.0)) && look(first, 0.1, ball(away, 9.0))
    );
    assert!(!look(above, 0.2, ball(away, 1.0)));
    // What makes no sense says nothing.
    assert!(!look(DVec3::NAN, 0.0, ball(first, 1.0)) && !look(second, f64::INFINITY, ball(first, 1.0)));
    assert!(!look(second, 0.3, Bound::Everywhere) && !look(second, 0.3, ball(first, f64::NAN)));
    assert!(!look(second, 0.3, ball(DVec3::NAN, 1.0)) && !look(second, 0.3, Bound::Box(Aabb::EMPTY)));
    assert!(parts.memory_bytes() > 0);
}

#[test]
fn scenes_that_are_hardly_scenes_are_one_part() {
    for triangles in [Vec::new(), row(&[false]).triangles()[..1].to_vec()] {
        let parts = parts_of(&Scene::from_triangles(triangles));
        assert_eq!(parts.count(), 1);
        let mut sight = PartsInSight::new(parts);
        sight.look(EyeRegion::point(DVec3::ZERO), 0.05);
        assert!(!sight.seal_off(&ball(DVec3::splat(5.0), 0.1)));
    }
}

#[test]
fn parts_stay_while_the_eyes_reach_no_new_one() {
    let scene = row(&[false]);
    let mut sight = PartsInSight::new(parts_of(&scene));
    let mut look = |x: f64| {
        sight.look(EyeRegion { centre: at(x, 1.5, 3.0), radius: 0.3 }, 0.05);
        sight.parts().unwrap().to_vec()
    };
    let room = look(3.0);
    assert_eq!(room.len(), 1);
    let wall = look(5.8);
    assert_eq!(wall.len(), 2);
    // Back from the wall: the room's part was among them.
    assert_eq!(look(3.0), wall);
    // Through the wall, beyond which is another part that was among them as well; then outside.
    assert_eq!(look(9.0), wall);
    assert_ne!(look(20.0), wall);
}

#[test]
fn no_ray_reaches_what_is_sealed_off() {
    let mut chance = Pcg64::seed_from_u64(11);
    let mut sealed = 0;
    for _ in 0..12 {
        let scene = rooms(&mut chance);
        let rays = RayScene::new(&scene);
        let parts = parts_of(&scene);
        let mut sight = PartsInSight::new(parts);
        let bounds = scene.bounds().inflated(1.0);
        let mut place = || bounds.min + bounds.size() * DVec3::from_array(std::array::from_fn(|_| chance.random()));
        for _ in 0..40 {
            let eye = place();
            sight.look(EyeRegion::point(eye), 0.01);
            for _ in 0..40 {
                let there = place();
                if sight.seal_off(&ball(there, 0.0)) {
                    sealed += 1;
                    assert!(rays.first_hit(eye, there - eye, 0.0, 1.0).is_some(), "{eye} sees {there}");
                }
            }
        }
    }
    assert!(sealed > 2_000, "{sealed}");
}

/// 3 × 3 rooms of paper on two storeys, of whose walls some are missing, some have a window, and some are of one side
/// only.
fn rooms(chance: &mut Pcg64) -> Scene {
    let mut triangles = Vec::new();
    let lengths = [ROOM, HEIGHT, ROOM];
    let counts = [3u32, 2, 3];
    for axis in 0..3 {
        let [u, v] = [(axis + 1) % 3, (axis + 2) % 3];
        for line in 0..=counts[axis] {
            for i in 0..counts[u] {
                for j in 0..counts[v] {
                    let low = [i as f32 * lengths[u], j as f32 * lengths[v]];
                    let high = [low[0] + lengths[u], low[1] + lengths[v]];
                    let at = line as f32 * lengths[axis];
                    let mut add = |low, high, sides| made::add_plate(&mut triangles, axis, at, low, high, sides);
                    match chance.random_range(0..10) {
                        0 => {}
                        1 => {
                            let [from, to] = [0.3, 0.6].map(|share| low[0] + share * lengths[u]);
                            add(low, [from, high[1]], Sides::Both);
                            add([to, low[1]], high, Sides::Both);
                        }
                        2 => add(low, high, Sides::Front),
                        _ => add(low, high, Sides::Both),
                    }
                }
            }
        }
    }
    Scene::from_triangles(triangles)
}

#[test]
fn an_occlusion_that_knows_of_parts_says_so_and_hides_as_before() {
    let scene = row(&[false, true]);
    let plain = AllRound::new(&scene);
    let knows = plain.with_parts(parts_of(&scene));
    let (mut with, mut without) = (knows.scratch(32), plain.scratch(32));
    let mut chance = Pcg64::seed_from_u64(4);
    for _ in 0..20 {
        let mut place = || at(chance.random_range(0.5..17.5), 1.5, chance.random_range(0.5..5.5));
        let (eye, bound) = (place(), ball(place(), 0.2));
        let region = EyeRegion { centre: eye, radius: 0.1 };
        let with = knows.cull(region, &mut with).unwrap();
        let without = plain.cull(region, &mut without).unwrap();
        assert_eq!(with.hides(&bound), without.hides(&bound));
        assert!(without.parts().is_none() && !without.seals_off(&bound) && with.parts().is_some());
        assert!(!with.seals_off(&bound) || with.hides(&bound), "{eye} {bound:?}");
    }
}
