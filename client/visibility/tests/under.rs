//! [`UnderOcclusion`] against rays: what it calls hidden must be hidden along every one of them.

mod under_support;

use std::sync::Arc;

use eyeline_visibility::{
    Aabb, AllRound, AllRoundCells, Bound, Cplp, EyeRegion, KdRules, KdTree, Occluders, Occlusion, OctreeRules,
    RegionError, Resolution, Scene, Sides, Target, Triangle, UnderOcclusion, View,
};
use glam::{DQuat, DVec3, Vec3};
use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use under_support::{Corners, Rays, add_box, entry, random_eye, rooms};

fn point_in(aabb: &Aabb, rng: &mut Pcg64) -> DVec3 {
    aabb.min + aabb.size() * DVec3::from_array(std::array::from_fn(|_| rng.random_range(0.0..=1.0)))
}

fn direction(rng: &mut Pcg64) -> DVec3 {
    loop {
        let v = DVec3::from_array(std::array::from_fn(|_| rng.random_range(-1.0..=1.0)));
        if (0.1..1.0).contains(&v.length()) {
            return v.normalize();
        }
    }
}

/// A random point in or on the bound.
fn sample(bound: &Bound, rng: &mut Pcg64) -> DVec3 {
    match *bound {
        Bound::Box(aabb) => {
            let mut point = point_in(&aabb, rng);
            for axis in 0..rng.random_range(0..=3) {
                point[axis] = if rng.random_bool(0.5) { aabb.min[axis] } else { aabb.max[axis] };
            }
            point
        }
        Bound::Sphere { centre, radius } => {
            let part = if rng.random_bool(0.7) { 1.0 } else { rng.random_range(0.0..1.0) };
            centre + direction(rng) * (radius * part * (1.0 - 1e-12))
        }
        Bound::Upright { centre, radius, half_height } => {
            let turn = rng.random_range(0.0..std::f64::consts::TAU);
            let part = if rng.random_bool(0.7) { 1.0 } else { rng.random_range(0.0..1.0) };
            let reach = radius * part * (1.0 - 1e-12);
            let height = if rng.random_bool(0.3) { 1.0 } else { rng.random_range(-1.0..1.0) };
            centre + DVec3::new(reach * turn.cos(), half_height * height, reach * turn.sin())
        }
        Bound::Everywhere => unreachable!("never hidden"),
    }
}

/// Where the ray through `through` first meets the bound.
fn first_point(bound: &Bound, eye: DVec3, through: DVec3) -> Option<DVec3> {
    let along = through - eye;
    match *bound {
        Bound::Box(aabb) => entry(&aabb, eye, along).map(|t| eye + along * t),
        Bound::Sphere { centre, radius } => {
            let along = along.try_normalize()?;
            let middle = along.dot(centre - eye);
            let off = (centre - eye - along * middle).length_squared();
            (middle > 0.0 && off < radius * radius * (1.0 - 1e-9))
                .then(|| eye + along * (middle - (radius * radius * (1.0 - 1e-9) - off).max(0.0).sqrt()))
        }
        Bound::Upright { centre, radius, half_height } => {
            // Where the ray, seen from above, meets the circle; if it is not above or below the cylinder there.
            let plan = |v: DVec3| glam::DVec2::new(v.x, v.z);
            let to_axis = plan(centre - eye);
            let square = plan(along).length_squared();
            let middle = to_axis.dot(plan(along)) / square;
            let off = (to_axis - plan(along) * middle).length_squared();
            let inside = radius * radius * (1.0 - 1e-9) - off;
            let t = middle - (inside.max(0.0) / square).sqrt();
            let point = eye + along * t;
            (inside > 0.0 && t > 0.0 && (point.y - centre.y).abs() < half_height).then_some(point)
        }
        Bound::Everywhere => None,
    }
}

/// A ray from `eye` that reaches the bound, if one of `count` random ones or of those past the scene's edges does.
fn witness(scene: &Scene, rays: &Rays, eye: DVec3, bound: &Bound, count: usize, rng: &mut Pcg64) -> Option<DVec3> {
    for _ in 0..count {
        let point = sample(bound, rng);
        if !rays.blocked(eye, point) {
            return Some(point);
        }
    }
    // Adversarial: just past the edges of occluders, where coverage ends.
    if scene.triangles().is_empty() {
        return None;
    }
    for _ in 0..count * 4 {
        let corners = scene.triangles()[rng.random_range(0..scene.triangles().len())].corners.map(|c| c.as_dvec3());
        let i = rng.random_range(0..3);
        let on_edge = corners[i].lerp(corners[(i + 1) % 3], rng.random_range(-0.01..1.01));
        let off = 10.0_f64.powf(rng.random_range(-7.0..-1.0));
        let through = on_edge + direction(rng) * off;
        if let Some(point) = first_point(bound, eye, through)
            && !rays.blocked(eye, point)
        {
            return Some(point);
        }
    }
    None
}

fn assert_hidden(scene: &Scene, rays: &Rays, eye: DVec3, bound: &Bound, count: usize, rng: &mut Pcg64) {
    if let Some(point) = witness(scene, rays, eye, bound, count, rng) {
        panic!("{bound:?} is called hidden from {eye:?} but {point:?} is seen");
    }
}

fn random_bound(scene: &Scene, rng: &mut Pcg64) -> Bound {
    let centre = point_in(&scene.bounds().inflated(2.0), rng);
    match rng.random_range(0..5) {
        0 => Bound::Box(Aabb::around(DVec3::new(centre.x, 0.9, centre.z), DVec3::new(0.3, 0.9, 0.3))),
        3 => Bound::Upright {
            centre,
            radius: 10.0_f64.powf(rng.random_range(-3.0..0.7)),
            half_height: 10.0_f64.powf(rng.random_range(-2.0..0.5)),
        },
        1 => Bound::Sphere { centre, radius: 10.0_f64.powf(rng.random_range(-3.0..0.7)) },
        2 => Bound::Box(Aabb::around(centre, DVec3::splat(10.0_f64.powf(rng.random_range(-4.0..0.7))))),
        _ => {
            let half = DVec3::from_array(std::array::from_fn(|_| 10.0_f64.powf(rng.random_range(-2.0..0.8))));
            Bound::Box(Aabb::around(centre, half))
        }
    }
}

#[test]
fn what_is_hidden_in_a_building_is_hidden_from_every_ray() {
    let mut rng = Pcg64::seed_from_u64(1);
    let (mut hidden, mut asked) = (0, 0);
    for (corners, sides, turn) in [
        (Corners::Abut, Sides::Both, 0.0),
        (Corners::Abut, Sides::Front, 0.0),
        (Corners::Overlap, Sides::Front, 0.0),
        (Corners::Abut, Sides::Both, 0.3),
        (Corners::Overlap, Sides::Both, 1.1),
    ] {
        let scene = rooms(4, corners, sides, turn, &mut rng);
        let rays = Rays::new(&scene);
        let all_round = AllRound::new(&scene);
        for side in [16, 64, 128, 200] {
            let mut scratch = all_round.scratch(side);
            for round in 0..6 {
                let mut eye = random_eye(4, turn, &mut rng);
                match round {
                    // 1 cm from a wall's face, on it, inside the wall (before turning).
                    1 => eye.x = (eye.x / 6.0).round() * 6.0 + 0.11,
                    2 => eye.x = (eye.x / 6.0).round() * 6.0 + f64::from(0.1_f32),
                    3 => eye.z = (eye.z / 6.0).round() * 6.0 + 0.05,
                    4 => eye += direction(&mut rng) * 1000.0,
                    _ => {}
                }
                let occlusion = all_round.cull(EyeRegion::point(eye), &mut scratch).unwrap();
                for _ in 0..60 {
                    let bound = random_bound(&scene, &mut rng);
                    asked += 1;
                    if occlusion.hides(&bound) {
                        hidden += 1;
                        assert_hidden(&scene, &rays, eye, &bound, 150, &mut rng);
                    }
                }
            }
        }
    }
    println!("{hidden} of {asked} hidden");
    assert!(hidden > asked / 6, "only {hidden} of {asked} hidden: the test says little");
}

#[test]
fn far_from_the_origin_and_from_one_another_it_still_holds() {
    let mut rng = Pcg64::seed_from_u64(2);
    let mut hidden = 0;
    for _ in 0..60 {
        // A wall of a random size and a needle, anywhere within a million metres.
        let place = DVec3::from_array(std::array::from_fn(|_| rng.random_range(-1.0..1.0))) * 1e6;
        let size = 10.0_f64.powf(rng.random_range(-1.0..4.0));
        let corner = |rng: &mut Pcg64, size: f64| (place + direction(rng) * size).as_vec3();
        let mut triangles = Vec::new();
        for _ in 0..6 {
            let corners = std::array::from_fn(|_| corner(&mut rng, size));
            triangles.push(Triangle { corners, sides: Sides::Both, occludes: true });
            let [a, b] = std::array::from_fn(|_| corner(&mut rng, size));
            let c = a + Vec3::splat(0.5);
            triangles.push(Triangle { corners: [a, b, c], sides: Sides::Both, occludes: true });
        }
        let scene = Scene::from_triangles(triangles);
        let rays = Rays::new(&scene);
        let all_round = AllRound::new(&scene);
        let mut scratch = all_round.scratch(64);
        let eye = place + direction(&mut rng) * size * rng.random_range(0.0..2.0);
        let occlusion = all_round.cull(EyeRegion::point(eye), &mut scratch).unwrap();
        for _ in 0..100 {
            let along = direction(&mut rng) * size;
            let centre = eye + along * rng.random_range(0.1..4.0);
            let bound = Bound::Sphere { centre, radius: size * 10.0_f64.powf(rng.random_range(-4.0..-0.5)) };
            if occlusion.hides(&bound) {
                hidden += 1;
                assert_hidden(&scene, &rays, eye, &bound, 100, &mut rng);
            }
        }
    }
    println!("{hidden} hidden");
    assert!(hidden > 100, "only {hidden}");
}

fn wall(triangles: &mut Vec<Triangle>, x: [f32; 2], y: [f32; 2], z: f32) {
    let at = |i: usize, j: usize| Vec3::new(x[i], y[j], z);
    for corners in [[at(0, 0), at(1, 0), at(1, 1)], [at(0, 0), at(1, 1), at(0, 1)]] {
        triangles.push(Triangle { corners, sides: Sides::Both, occludes: true });
    }
}

fn cull(triangles: Vec<Triangle>, eye: DVec3, side: u32) -> UnderOcclusion {
    let scene = Scene::from_triangles(triangles);
    let mut occlusion = UnderOcclusion::all_round(Arc::new(Occluders::build(&scene)), side);
    occlusion.start(EyeRegion::point(eye)).unwrap();
    let all: Vec<u32> = (0..scene.triangles().len() as u32).collect();
    occlusion.draw(&all);
    occlusion
}

const BEHIND: Bound = Bound::Box(Aabb::new(DVec3::new(-1.0, -1.0, -7.0), DVec3::new(1.0, 1.0, -6.0)));

#[test]
fn a_slit_far_narrower_than_a_pixel_is_seen_through() {
    for (slit, hides) in [(0.0, true), (1e-6, false), (1e-3, false)] {
        let mut triangles = Vec::new();
        wall(&mut triangles, [-4.0, 0.1], [-4.0, 4.0], -5.0);
        // The second piece ends elsewhere, so that the two are not merged.
        wall(&mut triangles, [0.1 + slit, 4.0], [-3.0, 5.0], -5.0);
        for side in [16, 64, 1024] {
            let occlusion = cull(triangles.clone(), DVec3::ZERO, side);
            assert_eq!(occlusion.hides(&BEHIND), hides, "slit {slit}, side {side}");
        }
    }
}

#[test]
fn a_joint_does_not_close_a_hole_beside_it() {
    // Two pieces meet at x = 0; the second ends at a height of 0.001, within the pixel row of the horizon.
    let mut triangles = Vec::new();
    wall(&mut triangles, [-4.0, 0.0], [-4.0, 4.0], -5.0);
    wall(&mut triangles, [0.0, 4.0], [-4.0, 0.001], -5.0);
    let occlusion = cull(triangles, DVec3::ZERO, 128);
    assert!(!occlusion.hides(&BEHIND));
    let low = Bound::Box(Aabb::new(DVec3::new(-1.0, -1.0, -7.0), DVec3::new(1.0, -0.5, -6.0)));
    assert!(occlusion.hides(&low));
}

#[test]
fn the_corner_of_a_room_does_not_leak() {
    // Walls that only touch: the corner's line lies in the middle of the image and in a cube's edge.
    for eye in [DVec3::ZERO, DVec3::new(-0.3, 0.0, 0.4), DVec3::new(1.0, 0.2, 1.0)] {
        let mut triangles = Vec::new();
        add_box(&mut triangles, [-4.0, -4.0, -6.0], [3.0, 4.0, -5.0], Sides::Front, 0.0);
        add_box(&mut triangles, [3.0, -4.0, -5.0], [4.0, 4.0, 5.0], Sides::Front, 0.0);
        let occlusion = cull(triangles, eye, 64);
        assert!(!occlusion.is_closed());
        let behind = Bound::Box(Aabb::new(DVec3::new(2.5, -1.0, -8.0), DVec3::new(5.5, 1.0, -7.0)));
        assert!(occlusion.hides(&behind), "{eye}");
    }
}

#[test]
fn what_touches_the_eye_or_has_no_limit_is_never_hidden() {
    let mut triangles = Vec::new();
    add_box(&mut triangles, [-1.0; 3], [1.0; 3], Sides::Both, 0.0);
    let occlusion = cull(triangles, DVec3::ZERO, 64);
    assert!(occlusion.hides(&Bound::Sphere { centre: DVec3::new(0.0, 0.0, -5.0), radius: 1.0 }));
    // The eight corners of a box are three polygons' business, so only a view between them is full.
    assert!(!occlusion.is_closed());
    assert!(!occlusion.hides(&Bound::Everywhere));
    assert!(!occlusion.hides(&Bound::Box(Aabb::around(DVec3::ZERO, DVec3::splat(100.0)))));
    assert!(!occlusion.hides(&Bound::Box(Aabb::new(DVec3::ZERO, DVec3::new(0.1, 0.1, 50.0)))));
    assert!(!occlusion.hides(&Bound::Sphere { centre: DVec3::new(3.0, 0.0, 0.0), radius: 3.0 }));
    assert!(!occlusion.hides(&Bound::Box(Aabb::around(DVec3::NAN, DVec3::ONE))));
}

#[test]
fn an_occluder_nearer_than_a_camera_can_draw_hides_nothing() {
    // A wall 5 mm before the eye is clipped by every camera with a near plane of 1 cm.
    let mut triangles = Vec::new();
    wall(&mut triangles, [-4.0, 4.0], [-4.0, 4.0], -0.005);
    assert!(!cull(triangles, DVec3::ZERO, 128).hides(&BEHIND));
    let mut triangles = Vec::new();
    wall(&mut triangles, [-4.0, 4.0], [-4.0, 4.0], -0.05);
    assert!(cull(triangles, DVec3::ZERO, 128).hides(&BEHIND));
}

#[test]
fn a_bent_quad_hides_only_what_is_behind_its_farthest_corner() {
    // Flat enough to be merged, but 0.02 mm deeper at one corner.
    let at = |x: f32, y: f32, z: f32| Vec3::new(x, y, z);
    let corners = [at(-0.9, -0.9, -1.0), at(0.9, -0.9, -1.0), at(0.9, 0.9, -1.00002), at(-0.9, 0.9, -1.0)];
    let triangles = [[0, 1, 2], [0, 2, 3]]
        .map(|i| Triangle { corners: i.map(|i| corners[i]), sides: Sides::Both, occludes: true })
        .to_vec();
    let scene = Scene::from_triangles(triangles.clone());
    assert_eq!(Occluders::build(&scene).len(), 1);
    let rays = Rays::new(&scene);
    let occlusion = cull(triangles, DVec3::ZERO, 256);
    let mut rng = Pcg64::seed_from_u64(9);
    let mut hidden = 0;
    for _ in 0..4000 {
        let centre =
            DVec3::new(rng.random_range(-0.8..0.8), rng.random_range(-0.8..0.8), rng.random_range(-1.0001..-0.9999));
        let bound = Bound::Box(Aabb::around(centre, DVec3::new(0.01, 0.01, 1e-6)));
        if occlusion.hides(&bound) {
            hidden += 1;
            assert_hidden(&scene, &rays, DVec3::ZERO, &bound, 20, &mut rng);
        }
    }
    assert!(hidden > 100, "only {hidden}");
}

#[test]
fn a_region_that_is_no_ball_is_refused() {
    let mut occlusion = cull(Vec::new(), DVec3::ZERO, 16);
    for radius in [-0.2, f64::INFINITY, f64::NEG_INFINITY] {
        assert_eq!(occlusion.start(EyeRegion { centre: DVec3::ZERO, radius }), Err(RegionError::NotABall(radius)));
    }
    assert!(matches!(
        occlusion.start(EyeRegion { centre: DVec3::ZERO, radius: f64::NAN }),
        Err(RegionError::NotABall(_))
    ));
    assert_eq!(occlusion.start(EyeRegion::point(DVec3::NAN)), Err(RegionError::NotFinite));
}

#[test]
fn a_single_view_hides_what_it_does_not_look_at() {
    let mut rng = Pcg64::seed_from_u64(5);
    let scene = rooms(3, Corners::Abut, Sides::Both, 0.0, &mut rng);
    let rays = Rays::new(&scene);
    let occluders = Arc::new(Occluders::build(&scene));
    let all: Vec<u32> = (0..scene.triangles().len() as u32).collect();
    let (mut hidden, mut outside) = (0, 0);
    for _ in 0..30 {
        let eye = random_eye(3, 0.0, &mut rng);
        let mut view = View::level(eye, 0.0, rng.random_range(0.2..2.5), Resolution::new(150, 99));
        view.orientation =
            DQuat::from_rotation_y(rng.random_range(0.0..6.3)) * DQuat::from_rotation_x(rng.random_range(-0.6..0.6));
        let mut occlusion = UnderOcclusion::single(Arc::clone(&occluders), &view);
        occlusion.draw(&all);
        let half = DVec3::new(75.0, 49.5, 0.0) / view.focal_px();
        for _ in 0..80 {
            let bound = random_bound(&scene, &mut rng);
            if !occlusion.hides(&bound) {
                continue;
            }
            hidden += 1;
            for _ in 0..200 {
                let point = sample(&bound, &mut rng);
                let v = view.orientation.inverse() * (point - eye);
                if -v.z > 0.01 && v.x.abs() <= -v.z * half.x && v.y.abs() <= -v.z * half.y {
                    assert!(rays.blocked(eye, point), "{bound:?} from {view:?}");
                } else {
                    outside += 1;
                }
            }
        }
    }
    assert!(hidden > 500 && outside > 1000, "{hidden} {outside}");
}

#[test]
fn a_view_of_nothing_but_wall_is_full_at_any_resolution() {
    for (width, height) in [(64, 64), (150, 99), (7, 1)] {
        let mut triangles = Vec::new();
        wall(&mut triangles, [-40.0, 40.0], [-40.0, 40.0], -5.0);
        let scene = Scene::from_triangles(triangles);
        let view = View::level(DVec3::ZERO, 0.1, 1.2, Resolution::new(width, height));
        let mut occlusion = UnderOcclusion::single(Arc::new(Occluders::build(&scene)), &view);
        assert!(!occlusion.is_closed());
        occlusion.draw(&[1]);
        assert!(occlusion.is_closed(), "{width}x{height}");
    }
}

#[test]
fn drawing_more_never_reveals() {
    let mut rng = Pcg64::seed_from_u64(3);
    let scene = rooms(3, Corners::Abut, Sides::Front, 0.0, &mut rng);
    let mut occlusion = UnderOcclusion::all_round(Arc::new(Occluders::build(&scene)), 64);
    for _ in 0..4 {
        occlusion.start(EyeRegion::point(random_eye(3, 0.0, &mut rng))).unwrap();
        let bounds: Vec<Bound> = (0..200).map(|_| random_bound(&scene, &mut rng)).collect();
        let mut hidden = vec![false; bounds.len()];
        let mut order: Vec<u32> = (0..scene.triangles().len() as u32).collect();
        rand::seq::SliceRandom::shuffle(&mut order[..], &mut rng);
        for primitives in order.chunks(12) {
            occlusion.draw(primitives);
            for (hidden, bound) in hidden.iter_mut().zip(&bounds) {
                let now = occlusion.hides(bound);
                assert!(now || !*hidden, "{bound:?} came back");
                *hidden = now;
            }
        }
        assert!(hidden.iter().filter(|&&h| h).count() > 40);
    }
}

/// Share of the truly hidden avatars (as far as 600 rays tell) that are recognised, per side of the cube's faces.
fn recognised(corners: Corners, turn: f64, sides: [u32; 3]) -> [f64; 3] {
    let mut rng = Pcg64::seed_from_u64(4);
    let scene = rooms(8, corners, Sides::Both, turn, &mut rng);
    let rays = Rays::new(&scene);
    let all_round = AllRound::new(&scene);
    let mut scratches = sides.map(|side| all_round.scratch(side));
    let (mut truly, mut found) = (0, [0; 3]);
    for _ in 0..40 {
        let eye = random_eye(8, turn, &mut rng);
        for scratch in &mut scratches {
            all_round.cull(EyeRegion::point(eye), scratch).unwrap();
        }
        for _ in 0..60 {
            let feet = random_eye(8, turn, &mut rng).with_y(0.0);
            // Half of them near the eye, where it is harder.
            let feet = if rng.random_bool(0.5) { eye.with_y(0.0) + (feet - eye.with_y(0.0)) * 0.2 } else { feet };
            let bound = Bound::Box(Aabb::around(feet.with_y(0.9), DVec3::new(0.3, 0.88, 0.3)));
            if (0..600).any(|_| !rays.blocked(eye, sample(&bound, &mut rng))) {
                for scratch in &scratches {
                    assert!(!scratch.occlusion().hides(&bound), "{bound:?} from {eye}");
                }
                continue;
            }
            truly += 1;
            for (found, scratch) in found.iter_mut().zip(&scratches) {
                *found += u32::from(scratch.occlusion().hides(&bound));
            }
        }
    }
    found.map(|found| f64::from(found) / f64::from(truly))
}

#[test]
fn most_of_what_is_hidden_is_recognised() {
    for (corners, turn, floor) in [
        (Corners::Abut, 0.0, [0.80, 0.9, 0.93]),
        (Corners::Overlap, 0.0, [0.80, 0.9, 0.93]),
        (Corners::Overlap, 0.4, [0.75, 0.88, 0.92]),
    ] {
        let share = recognised(corners, turn, [64, 128, 256]);
        println!("{corners:?}, turned by {turn}: {share:.4?} at 64, 128, 256 px");
        assert!(share.iter().zip(floor).all(|(share, floor)| *share >= floor), "{corners:?} {turn} {share:?}");
    }
}

#[test]
fn cells_hide_only_what_is_hidden_and_find_every_visible_primitive() {
    let scene = Arc::new(rooms(4, Corners::Abut, Sides::Both, 0.0, &mut Pcg64::seed_from_u64(10)));
    let tree = KdTree::build(&scene, KdRules::default().with_max_triangles_per_leaf(64));
    assert!(tree.stats().sealed > 50);
    for all_round in [
        AllRoundCells::new(Arc::clone(&scene), OctreeRules::default()),
        AllRoundCells::with_cells(Arc::clone(&scene), Cplp::new(Arc::new(tree))),
    ] {
        check_cells(&scene, &all_round);
    }
}

fn check_cells(scene: &Arc<Scene>, all_round: &AllRoundCells) {
    let mut rng = Pcg64::seed_from_u64(11);
    let rays = Rays::new(scene);
    let mut scratch = all_round.scratch(64);
    let (mut hidden, mut most) = (0, 0);
    for _ in 0..10 {
        let eye = random_eye(4, 0.0, &mut rng);
        let occlusion = all_round.cull(EyeRegion::point(eye), &mut scratch).unwrap();
        for _ in 0..60 {
            let bound = random_bound(scene, &mut rng);
            if occlusion.hides(&bound) {
                hidden += 1;
                assert_hidden(scene, &rays, eye, &bound, 100, &mut rng);
            }
        }
        let visible = scratch.visible();
        most = most.max(visible.len());
        for (id, triangle) in scene.triangles().iter().enumerate() {
            if visible.binary_search(&(id as u32)).is_err() {
                let [a, b, c] = triangle.corners.map(|c| c.as_dvec3());
                for _ in 0..20 {
                    let (u, v) = (rng.random_range(0.0..1.0_f64), rng.random_range(0.0..1.0_f64));
                    let point = a.lerp(b, u).lerp(c, v);
                    let before = eye.lerp(point, 1.0 - 1e-9);
                    assert!(rays.blocked(eye, before), "primitive {id} is seen at {point} from {eye}");
                }
            }
        }
    }
    println!("{hidden} hidden, at most {most} of {} visible", scene.triangles().len());
    assert!(hidden > 200 && most < scene.triangles().len() / 2, "{hidden} hidden, at most {most} visible");
}

fn coordinate() -> impl Strategy<Value = f32> {
    prop_oneof![
        4 => -4.0..4.0_f32,
        2 => (-4..=4_i32).prop_map(|i| i as f32),
        1 => -0.01..0.01_f32,
        1 => -1000.0..1000.0_f32,
    ]
}

fn corner() -> impl Strategy<Value = Vec3> {
    [coordinate(), coordinate(), coordinate()].prop_map(Vec3::from)
}

fn triangle() -> impl Strategy<Value = Triangle> {
    ([corner(), corner(), corner()], any::<bool>(), prop::bool::weighted(0.9)).prop_map(|(corners, both, occludes)| {
        Triangle { corners, sides: if both { Sides::Both } else { Sides::Front }, occludes }
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    #[test]
    fn no_soup_hides_what_a_ray_reaches(
        triangles in prop::collection::vec(triangle(), 1..24),
        eye in corner(),
        side in prop_oneof![Just(8_u32), Just(33), Just(64), Just(256)],
        seed in any::<u64>(),
    ) {
        let scene = Scene::from_triangles(triangles);
        let rays = Rays::new(&scene);
        let mut rng = Pcg64::seed_from_u64(seed);
        let eye = eye.as_dvec3();
        let mut occlusion = UnderOcclusion::all_round(Arc::new(Occluders::build_with(&scene, 0.0)), side);
        occlusion.start(EyeRegion::point(eye)).unwrap();
        occlusion.draw(&(0..scene.triangles().len() as u32).collect::<Vec<_>>());
        for _ in 0..40 {
            let centre = eye + direction(&mut rng) * 10.0_f64.powf(rng.random_range(-1.0..2.0));
            let radius = 10.0_f64.powf(rng.random_range(-3.0..0.5));
            let bound = if rng.random_bool(0.5) {
                Bound::Sphere { centre, radius }
            } else {
                Bound::Box(Aabb::around(centre, DVec3::splat(radius)))
            };
            if occlusion.hides(&bound) {
                assert_hidden(&scene, &rays, eye, &bound, 60, &mut rng);
            }
        }
    }
}
