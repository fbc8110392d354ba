//! Visibility from a ball of eyes: what is called hidden must be hidden from each of them, along every ray.

mod made;
mod under_support;

use std::sync::Arc;

use eyeline_visibility::{
    Aabb, AllRound, AllRoundCells, Bound, Cplp, Culler, EyeRegion, Occluders, Occlusion, OctreeRules, RayScene,
    RegionCuller, Resolution, Scene, Scratch, Sides, Triangle, UnderOcclusion, View, exact_set,
};
use glam::{DVec3, Vec3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use under_support::{Corners, ROOM, Rays, add_box, entry, random_eye, rooms};

const RADII: [f64; 6] = [0.0, 0.05, 0.15, 0.3, 0.6, 1.0];

fn direction(rng: &mut Pcg64) -> DVec3 {
    loop {
        let v = DVec3::from_array(std::array::from_fn(|_| rng.random_range(-1.0..=1.0)));
        if (0.1..1.0).contains(&v.length()) {
            return v.normalize();
        }
    }
}

/// An eye of the ball, mostly on its surface.
fn eye_in(region: EyeRegion, rng: &mut Pcg64) -> DVec3 {
    let part = if rng.random_bool(0.7) { 1.0 } else { rng.random_range(0.0..1.0) };
    region.centre + direction(rng) * (region.radius * part)
}

fn point_in(aabb: &Aabb, rng: &mut Pcg64) -> DVec3 {
    aabb.min + aabb.size() * DVec3::from_array(std::array::from_fn(|_| rng.random_range(0.0..=1.0)))
}

/// Where along a ray the bound begins, as far as this is easy to say.
fn entry_into(bound: &Bound, eye: DVec3, along: DVec3) -> Option<f64> {
    match *bound {
        Bound::Box(aabb) => entry(&aabb, eye, along),
        Bound::Sphere { centre, radius } => {
            let (squared, to) = (along.length_squared(), centre - eye);
            let nearest = to.dot(along) / squared;
            let half = (radius * radius - to.distance_squared(along * nearest)) / squared;
            (half >= 0.0).then(|| nearest - half.sqrt()).filter(|&t| t > 0.0)
        }
        _ => None,
    }
}

fn point_of(bound: &Bound, rng: &mut Pcg64) -> DVec3 {
    match *bound {
        Bound::Sphere { centre, radius } => centre + direction(rng) * radius,
        Bound::Upright { centre, radius, half_height } => {
            let around = direction(rng).with_y(0.0).normalize_or_zero() * radius;
            centre + around + DVec3::Y * rng.random_range(-half_height..=half_height)
        }
        _ => point_in(&bound.aabb().unwrap(), rng),
    }
}

/// An eye of the ball and a point of the bound that it sees, if random rays and rays past the edges of occluders find any.
fn witness(
    scene: &Scene,
    rays: &Rays,
    region: EyeRegion,
    bound: &Bound,
    count: usize,
    rng: &mut Pcg64,
) -> Option<[DVec3; 2]> {
    for _ in 0..count {
        let (eye, point) = (eye_in(region, rng), point_of(bound, rng));
        if !rays.blocked(eye, point) {
            return Some([eye, point]);
        }
        let eye = eye_in(region, rng);
        let corners = scene.triangles()[rng.random_range(0..scene.triangles().len())].corners.map(|c| c.as_dvec3());
        let i = rng.random_range(0..3);
        let on_edge = corners[i].lerp(corners[(i + 1) % 3], rng.random_range(-0.01..1.01));
        let through = on_edge + direction(rng) * 10.0_f64.powf(rng.random_range(-6.0..-1.0));
        let along = through - eye;
        if let Some(t) = entry_into(bound, eye, along)
            && !rays.blocked(eye, eye + along * t)
        {
            return Some([eye, eye + along * t]);
        }
    }
    None
}

fn random_box(around: DVec3, reach: f64, rng: &mut Pcg64) -> Aabb {
    let centre = around + direction(rng) * DVec3::new(1.0, 0.2, 1.0) * rng.random_range(0.3..reach);
    match rng.random_range(0..3) {
        0 => Aabb::around(centre.with_y(0.9), DVec3::new(0.3, 0.88, 0.3)),
        1 => Aabb::around(centre, DVec3::splat(10.0_f64.powf(rng.random_range(-3.0..0.3)))),
        _ => {
            Aabb::around(centre, DVec3::from_array(std::array::from_fn(|_| 10.0_f64.powf(rng.random_range(-2.0..0.5)))))
        }
    }
}

/// A random box, or a ball or cylinder in its place.
fn random_bound(around: DVec3, reach: f64, rng: &mut Pcg64) -> Bound {
    let aabb = random_box(around, reach, rng);
    let (centre, half) = (aabb.centre(), aabb.size() * 0.5);
    match rng.random_range(0..4) {
        0 => Bound::Sphere { centre, radius: half.max_element() },
        1 => Bound::Upright { centre, radius: half.x, half_height: half.y },
        _ => Bound::Box(aabb),
    }
}

/// Asks about `bounds` random bounds from a region and checks each that is called hidden by `count` rays of each kind.
#[expect(clippy::too_many_arguments, reason = "a test's setting is many numbers")]
fn check(
    scene: &Scene,
    rays: &Rays,
    all_round: &AllRound,
    region: EyeRegion,
    side: u32,
    bounds: usize,
    count: usize,
    rng: &mut Pcg64,
) -> usize {
    let mut scratch = all_round.scratch(side);
    let occlusion = all_round.cull(region, &mut scratch).unwrap();
    let mut hidden = 0;
    for _ in 0..bounds {
        let bound = random_bound(region.centre, 12.0, rng);
        if occlusion.hides(&bound) {
            hidden += 1;
            if let Some([eye, point]) = witness(scene, rays, region, &bound, count, rng) {
                panic!("{bound:?} is called hidden from {region:?} at {side} px, but {eye} sees {point}");
            }
        }
    }
    hidden
}

#[test]
fn what_is_hidden_from_a_ball_is_hidden_from_every_eye_of_it() {
    let mut rng = Pcg64::seed_from_u64(1);
    for (corners, sides, turn) in [
        (Corners::Abut, Sides::Both, 0.0),
        (Corners::Overlap, Sides::Front, 0.0),
        (Corners::Abut, Sides::Front, 0.3),
        (Corners::Overlap, Sides::Both, 1.1),
    ] {
        let scene = rooms(4, corners, sides, turn, &mut rng);
        let (rays, all_round) = (Rays::new(&scene), AllRound::new(&scene));
        let mut hidden = [0; RADII.len()];
        for (hidden, radius) in hidden.iter_mut().zip(RADII) {
            for side in [64, 128] {
                for round in 0..5 {
                    let mut centre = random_eye(4, turn, &mut rng);
                    match round {
                        // The ball touches a wall, straddles it, or is around a wall's edge (before turning).
                        1 => centre.x = (centre.x / ROOM).round() * ROOM + 0.1 + radius,
                        2 => centre.x = (centre.x / ROOM).round() * ROOM + 0.1 + radius * 0.5,
                        3 => centre = (centre / ROOM).round() * ROOM + DVec3::new(0.3, 1.7, 0.2),
                        _ => {}
                    }
                    let region = EyeRegion { centre, radius };
                    *hidden += check(&scene, &rays, &all_round, region, side, 60, 60, &mut rng);
                }
            }
        }
        println!("{corners:?} {sides:?} {turn}: {hidden:?} hidden of 600 at {RADII:?}");
        assert!(hidden.iter().all(|&hidden| hidden > 20), "{hidden:?}: the test says little");
    }
}

/// An eye that walks straight through what it looked around in, from `eye` towards a direction, and what is hidden all the way.
#[test]
fn who_walks_sees_nothing_that_was_hidden_before_the_walk() {
    let mut rng = Pcg64::seed_from_u64(12);
    for (corners, sides, turn) in [(Corners::Abut, Sides::Both, 0.0), (Corners::Overlap, Sides::Front, 0.0)] {
        let scene = rooms(4, corners, sides, turn, &mut rng);
        let (rays, all_round) = (Rays::new(&scene), AllRound::among_rooms(&scene));
        let (mut asked, mut hidden, mut steps, mut beyond) = (0, 0, 0, 0);
        for round in 0..60 {
            let mut scratch = all_round.scratch(32);
            let (reach, towards) = (rng.random_range(0.0..0.3), direction(&mut rng).with_y(0.0));
            let mut eye = random_eye(4, turn, &mut rng);
            if round % 3 == 0 {
                // Beside a wall, so that the ball may reach through it.
                eye.x = (eye.x / ROOM).round() * ROOM + 0.12;
            }
            let look = |eye: DVec3, scratch: &mut _| {
                all_round.look_around(EyeRegion::point(eye), (reach, towards), scratch).unwrap().version()
            };
            let version = look(eye, &mut scratch);
            if scratch.stats().looks == 0 {
                // The ball is not in the building whole.
                continue;
            }
            assert_eq!(scratch.stats().polygons, 0, "an image is drawn");
            asked += 1;
            let bounds: Vec<Bound> = (0..40)
                .map(|i| match i % 4 {
                    // Grown through floor and ceiling, and beyond all walls.
                    0 => Bound::Upright { centre: random_eye(4, turn, &mut rng), radius: 3.0, half_height: 4.0 },
                    _ => random_bound(eye, 12.0, &mut rng),
                })
                .filter(|bound| scratch.occlusion().hides(bound))
                .collect();
            hidden += bounds.len();
            beyond += bounds.iter().filter(|bound| !scene.bounds().contains_box(&bound.outer_box().unwrap())).count();
            for step in 0..8 {
                let at = eye + towards.normalize() * (0.25 * reach * f64::from(step));
                if look(at, &mut scratch) != version {
                    break;
                }
                steps += 1;
                for bound in &bounds {
                    if let Some([from, point]) = witness(&scene, &rays, EyeRegion::point(at), bound, 15, &mut rng) {
                        panic!("{bound:?} was called hidden for a walk {reach} m round {eye}, but {from} sees {point}");
                    }
                }
            }
        }
        println!(
            "{corners:?}: {asked} looks, {hidden} of 2400 hidden, {beyond} of them beyond all walls, {steps} steps of 480"
        );
        assert!(asked > 40 && hidden > 800 && beyond > 50 && steps > 160, "{asked}, {hidden}, {beyond}, {steps}");
    }
}

#[test]
fn from_outside_all_rooms_an_image_is_drawn_and_inside_doors_are_asked_again() {
    let mut rng = Pcg64::seed_from_u64(13);
    let scene = rooms(3, Corners::Abut, Sides::Both, 0.0, &mut rng);
    let (all_round, image) = (AllRound::among_rooms(&scene), AllRound::new(&scene));
    let (mut scratch, mut other) = (all_round.scratch(64), image.scratch(64));
    let mut hidden = 0;
    for i in 0..70 {
        let eye = EyeRegion::point(DVec3::new(-5.0 - 0.1 * f64::from(i), 1.6, 4.0));
        all_round.look_around(eye, (0.1, DVec3::X), &mut scratch).unwrap();
        image.cull(eye, &mut other).unwrap();
        assert_eq!(scratch.stats(), other.stats());
        for _ in 0..50 {
            let bound = random_bound(DVec3::new(7.0, 1.5, 7.0), 8.0, &mut rng);
            assert_eq!(scratch.occlusion().hides(&bound), other.occlusion().hides(&bound), "{bound:?}");
            hidden += u32::from(other.occlusion().hides(&bound));
        }
    }
    assert!(hidden > 100, "{hidden}: the test says little");
    let looks = |i: u32, scratch: &mut _| {
        let eye = EyeRegion::point(DVec3::new(2.5 + 0.001 * f64::from(i), 1.6, 2.5));
        all_round.look_around(eye, (0.0, DVec3::ZERO), scratch).unwrap();
    };
    let asked = (0..65).any(|i| {
        looks(i, &mut scratch);
        scratch.stats().looks > 0
    });
    assert!(asked, "doors are never asked again");
}

fn wall(triangles: &mut Vec<Triangle>, x: [f32; 2], y: [f32; 2], z: f32) {
    let at = |i: usize, j: usize| Vec3::new(x[i], y[j], z);
    for corners in [[at(0, 0), at(1, 0), at(1, 1)], [at(0, 0), at(1, 1), at(0, 1)]] {
        triangles.push(Triangle { corners, sides: Sides::Both, occludes: true });
    }
}

fn hides(triangles: Vec<Triangle>, region: EyeRegion, bound: &Bound) -> bool {
    let all_round = AllRound::new(&Scene::from_triangles(triangles));
    let mut scratch = all_round.scratch(128);
    all_round.cull(region, &mut scratch).unwrap().hides(bound)
}

#[test]
fn a_jamb_uncovers_more_than_the_eye_moves() {
    // The eye stands 0.3 m before a jamb at x = 0. Moving by 0.15 m it sees 15 m more at 30 m.
    let mut triangles = Vec::new();
    wall(&mut triangles, [-200.0, 0.0], [-50.0, 50.0], -0.3);
    let ball = |radius: f64| EyeRegion { centre: DVec3::ZERO, radius };
    let far = |x: f64| Bound::Box(Aabb::around(DVec3::new(x, 0.0, -30.0), DVec3::splat(0.1)));
    assert!(hides(triangles.clone(), ball(0.0), &far(-2.0)));
    assert!(!hides(triangles.clone(), ball(0.15), &far(-2.0)));
    assert!(!hides(triangles.clone(), ball(0.15), &far(-14.0)));
    assert!(hides(triangles.clone(), ball(0.15), &far(-21.0)));
    // A ball that touches the wall, or straddles it, has eyes before which nothing stands.
    assert!(!hides(triangles.clone(), ball(0.3), &far(-100.0)));
    assert!(!hides(triangles, ball(0.4), &far(-100.0)));
}

#[test]
fn a_slit_is_seen_through_and_touching_pieces_are_not() {
    for slit in [0.0, 1e-4, 0.01, 0.05] {
        let mut triangles = Vec::new();
        wall(&mut triangles, [-8.0, 0.1], [-8.0, 8.0], -3.0);
        wall(&mut triangles, [0.1 + slit, 8.0], [-7.0, 9.0], -3.0);
        let behind = Bound::Box(Aabb::around(DVec3::new(0.0, 0.0, -5.0), DVec3::splat(0.3)));
        for radius in RADII {
            let region = EyeRegion { centre: DVec3::ZERO, radius };
            assert_eq!(hides(triangles.clone(), region, &behind), slit == 0.0, "{slit} {radius}");
        }
    }
}

/// A wall of upright strips of 0.4 m, bent to and fro: none is as wide as a ball of 0.5 m, and each is needed.
fn screen(bend: f32, left_out: Option<usize>, twisted: bool) -> Vec<Triangle> {
    let mut triangles = Vec::new();
    let corner =
        |i: usize, y: f32| Vec3::new(i as f32 * 0.4 - 8.0, y, -3.0 - if i.is_multiple_of(2) { bend } else { 0.0 });
    for i in (0..40).filter(|&i| left_out != Some(i)) {
        // Pieces of different height next to each other, so that corners lie in the middle of edges.
        let heights: &[f32] = if i.is_multiple_of(3) { &[-8.0, 0.25, 8.0] } else { &[-8.0, -1.5, 1.0, 8.0] };
        for y in heights.windows(2) {
            let lift = if twisted && i == 19 { 1e-4 } else { 0.0 };
            let [a, b, c, d] = [corner(i, y[0]), corner(i + 1, y[0]), corner(i + 1, y[1]), corner(i, y[1])];
            let (b, c) = (b - Vec3::Z * lift, c - Vec3::Z * lift);
            for corners in [[a, b, c], [a, c, d]] {
                triangles.push(Triangle { corners, sides: Sides::Both, occludes: true });
            }
        }
    }
    triangles
}

#[test]
fn a_bent_sheet_hides_as_one_and_a_crack_in_it_does_not() {
    for radius in [0.15, 0.3, 0.5] {
        let region = EyeRegion { centre: DVec3::new(0.1, 0.1, 0.0), radius };
        for bound in [
            Bound::Sphere { centre: DVec3::new(0.2, 0.0, -9.0), radius: 1.0 },
            Bound::Box(Aabb::around(DVec3::new(0.2, 0.0, -9.0), DVec3::splat(0.8))),
            Bound::Upright { centre: DVec3::new(0.2, 0.0, -9.0), radius: 0.5, half_height: 0.9 },
        ] {
            for bend in [0.0, 0.01, 0.05] {
                assert!(hides(screen(bend, None, false), region, &bound), "{bend} {region:?} {bound:?}");
                assert!(!hides(screen(bend, Some(20), false), region, &bound), "{bend} {region:?} {bound:?}");
                assert!(!hides(screen(bend, None, true), region, &bound), "{bend} {region:?} {bound:?}");
            }
        }
        // Beside the crack nothing is lost.
        let beside = Bound::Sphere { centre: DVec3::new(-9.0, 0.0, -9.0), radius: 0.5 };
        assert!(hides(screen(0.05, Some(20), false), region, &beside));
    }
}

#[test]
fn walls_that_run_into_each_other_hide_what_is_behind_their_corner() {
    // Two walls that cross in a line, seen from inside the corner: behind it is hidden, beyond a wall's top is not.
    let corner = |top: f32| {
        let mut triangles = Vec::new();
        for turned in [false, true] {
            let ends = [-6.0, 1.0_f32].map(|u| {
                [-1.0, top].map(|y| if turned { Vec3::new(-1.0, y, -3.0 - u) } else { Vec3::new(-u - 1.0, y, -3.0) })
            });
            let [[a, d], [b, c]] = ends;
            for corners in [[a, b, c], [a, c, d]] {
                triangles.push(Triangle { corners, sides: Sides::Both, occludes: true });
            }
        }
        triangles
    };
    let region = EyeRegion { centre: DVec3::new(1.5, 0.3, -0.5), radius: 0.3 };
    let behind = Bound::Sphere { centre: DVec3::new(-3.0, 0.3, -5.0), radius: 0.8 };
    assert!(hides(corner(4.0), region, &behind));
    assert!(!hides(corner(0.6), region, &behind));
}

#[test]
fn an_edge_that_something_hides_is_an_edge_all_the_same() {
    // A strip before the wall's end hides that end from every eye, and little of what is seen past it.
    let mut triangles = Vec::new();
    wall(&mut triangles, [-50.0, 0.0], [-50.0, 50.0], -10.0);
    wall(&mut triangles, [-0.1, 0.1], [-50.0, 50.0], -9.0);
    let bound = Bound::Sphere { centre: DVec3::new(-0.9, 0.0, -30.0), radius: 0.01 };
    let ball = |radius: f64| EyeRegion { centre: DVec3::ZERO, radius };
    assert!(hides(triangles.clone(), ball(0.0), &bound));
    let mut rng = Pcg64::seed_from_u64(11);
    let scene = Scene::from_triangles(triangles.clone());
    assert!(witness(&scene, &Rays::new(&scene), ball(0.7), &bound, 1000, &mut rng).is_some());
    assert!(!hides(triangles, ball(0.7), &bound));
}

#[test]
fn a_room_without_a_door_hides_all_that_is_outside() {
    // Walls that stand on, run into and abut a floor and a ceiling that go on outside.
    let mut triangles = Vec::new();
    for y in [-0.2, 3.0] {
        add_box(&mut triangles, [-9.0, y, -9.0], [9.0, y + 0.2, 9.0], Sides::Both, 0.4);
    }
    for x in [-3.1, 2.9] {
        add_box(&mut triangles, [x, 0.0, -4.0], [x + 0.2, 3.0, 4.0], Sides::Both, 0.4);
    }
    for z in [-2.1, 1.9] {
        add_box(&mut triangles, [-3.0, -0.1, z], [3.0, 3.1, z + 0.2], Sides::Front, 0.4);
    }
    let all_round = AllRound::new(&Scene::from_triangles(triangles));
    let mut scratch = all_round.scratch(64);
    let mut rng = Pcg64::seed_from_u64(4);
    // At 1 m the side walls' far ends, which are outside the room, begin to count.
    for (radius, least) in [(0.05, 490), (0.3, 490), (0.6, 490), (1.0, 350)] {
        let region = EyeRegion { centre: DVec3::new(0.3, 1.5, -0.2), radius };
        let occlusion = all_round.cull(region, &mut scratch).unwrap();
        let mut hidden = 0;
        for _ in 0..500 {
            let along = direction(&mut rng);
            let at = region.centre + along / along.abs().max_element() * 12.0;
            hidden += usize::from(occlusion.hides(&Bound::Sphere { centre: at, radius: 1.0 }));
        }
        assert!(hidden > least, "{hidden} of 500 at {radius}");
    }
}

#[test]
fn a_ball_of_no_size_is_a_point() {
    let mut rng = Pcg64::seed_from_u64(5);
    let scene = rooms(3, Corners::Abut, Sides::Both, 0.0, &mut rng);
    let all_round = AllRound::new(&scene);
    let [mut point, mut ball] = [all_round.scratch(64), all_round.scratch(64)];
    let (mut more, mut less) = (0, 0);
    for _ in 0..20 {
        let centre = random_eye(3, 0.0, &mut rng);
        let point = all_round.cull(EyeRegion::point(centre), &mut point).unwrap();
        let ball = all_round.cull(EyeRegion { centre, radius: 1e-9 }, &mut ball).unwrap();
        for _ in 0..100 {
            let bound = Bound::Box(random_box(centre, 10.0, &mut rng));
            let hidden = [point.hides(&bound), ball.hides(&bound)];
            more += usize::from(hidden == [false, true]);
            less += usize::from(hidden == [true, false]);
        }
    }
    // Fusion closes corners that joints leave open.
    println!("{less} less and {more} more hidden");
    assert!(less <= 10, "{less} less and {more} more hidden");
}

/// Checks that what `eyes` eyes of each ball see is in the visible sets of both cullers.
fn check_sets(scene: Scene, regions: &[EyeRegion], eyes: usize, rays: usize, side: u32, rng: &mut Pcg64) -> [f64; 2] {
    let scene = Arc::new(scene);
    let ray_scene = RayScene::new(&scene);
    let culler = RegionCuller::build(Arc::clone(&scene));
    // Without doors an image is all there is.
    let octree = Arc::new(Cplp::build(&scene, OctreeRules::default()));
    let drawing = RegionCuller::new(Arc::clone(&scene), octree, Arc::new(Occluders::build(&scene)), 128 * 64);
    let cells = AllRoundCells::new(Arc::clone(&scene), OctreeRules::default());
    let (mut scratch, mut cells_scratch) = (Scratch::default(), cells.scratch(64));
    let (mut kept, mut seen_total) = (0, 0);
    for &region in regions {
        let resolution = Resolution::new(side, side * 3 / 4);
        let mut view = View::level(region.centre, rng.random_range(0.0..6.3), rng.random_range(0.6..2.2), resolution);
        view.orientation *= glam::DQuat::from_rotation_x(rng.random_range(-0.5..0.5));
        let visible = culler.cull(&view, region, &mut scratch).visible;
        let drawn = drawing.cull(&view, region, &mut scratch).visible;
        cells.cull(region, &mut cells_scratch).unwrap();
        let mut seen = vec![false; scene.triangles().len()];
        for _ in 0..eyes {
            let eye = eye_in(region, rng);
            let from = View { eye, ..view };
            for id in exact_set(&scene, &from).0 {
                assert!(visible.binary_search(&id).is_ok(), "{id} is seen from {eye} in {region:?}, {view:?}");
                assert!(drawn.binary_search(&id).is_ok(), "{id} is seen from {eye} in {region:?}, {view:?}");
                assert!(cells_scratch.visible().binary_search(&id).is_ok(), "{id} is seen from {eye} in {region:?}");
                seen[id as usize] = true;
            }
            for _ in 0..rays {
                let along = direction(rng);
                let hit = ray_scene.first_hit(eye, along, 0.01, f64::INFINITY);
                if let Some(id) = hit.map(|hit| hit.primitive) {
                    assert!(cells_scratch.visible().binary_search(&id).is_ok(), "{id} is hit from {eye} in {region:?}");
                }
            }
        }
        kept += visible.len();
        seen_total += seen.iter().filter(|&&seen| seen).count();
    }
    [kept, seen_total].map(|sum| sum as f64 / regions.len() as f64)
}

#[test]
fn a_box_that_crosses_the_side_of_a_view_is_hidden_by_a_wall_before_it() {
    let mut triangles = Vec::new();
    wall(&mut triangles, [-9.0, 9.0], [-9.0, 9.0], -3.0);
    let occluders = Arc::new(Occluders::build(&Scene::from_triangles(triangles)));
    // 90°, so the right side of the centre's view is x = −z. An eye at x = 0.3 sees up to x = −z + 0.3.
    let view = View::level(DVec3::ZERO, 0.0, std::f64::consts::FRAC_PI_2, Resolution::new(128, 128));
    let mut image = UnderOcclusion::single(Arc::clone(&occluders), &view);
    image.start(EyeRegion { centre: DVec3::ZERO, radius: 0.3 }).unwrap();
    let beside = |x: [f64; 2], z: f64| Bound::Box(Aabb::new(DVec3::new(x[0], -1.0, z - 1.0), DVec3::new(x[1], 1.0, z)));
    let across = beside([15.0, 90.0], -20.0);
    assert!(!image.hides(&across));
    (0..occluders.len() as u32).for_each(|polygon| image.draw_polygon(polygon));
    assert!(image.hides(&across));
    // Before the wall and up to where the outermost eye looks.
    assert!(!image.hides(&beside([2.15, 9.0], -2.0)));
    assert!(!image.hides(&beside([3.1, 90.0], -2.0)));
}

fn regions_in(n: u32, count: usize, rng: &mut Pcg64) -> Vec<EyeRegion> {
    (0..count)
        .map(|i| {
            let radius = RADII[i % RADII.len()];
            let mut centre = random_eye(n, 0.0, rng);
            match i % 5 {
                1 => centre.x = (centre.x / ROOM).round() * ROOM + 0.1 + radius,
                2 => centre = (centre / ROOM).round() * ROOM + DVec3::new(0.3, 1.7, 0.2),
                _ => {}
            }
            EyeRegion { centre, radius }
        })
        .collect()
}

#[test]
fn what_any_eye_of_a_ball_sees_is_in_the_visible_set() {
    let mut rng = Pcg64::seed_from_u64(2);
    for corners in [Corners::Abut, Corners::Overlap] {
        let scene = rooms(4, corners, Sides::Both, 0.0, &mut rng);
        let triangles = scene.triangles().len() as f64;
        let regions = regions_in(4, 12, &mut rng);
        let [kept, seen] = check_sets(scene, &regions, 25, 40, 48, &mut rng);
        println!("{corners:?}: {kept} of {triangles} kept, {seen} seen");
        assert!(kept < triangles * 0.4, "{kept} of {triangles} kept");
    }
    for seed in 0..3 {
        let mut balls = || EyeRegion { centre: direction(&mut rng) * 4.0, radius: RADII[seed as usize * 2 + 1] };
        let regions: Vec<EyeRegion> = (0..4).map(|_| balls()).collect();
        check_sets(made::soup(seed, 300), &regions, 15, 40, 48, &mut rng);
    }
    let scene = made::building(3, 8, 3);
    let regions: Vec<EyeRegion> = (0..6)
        .map(|i| EyeRegion {
            centre: DVec3::new(rng.random_range(0.3..14.7), 1.6, rng.random_range(0.3..14.7)),
            radius: RADII[i],
        })
        .collect();
    check_sets(scene, &regions, 20, 40, 48, &mut rng);
}

#[test]
fn a_region_that_is_no_ball_and_a_view_of_nothing_have_a_defined_result() {
    let mut rng = Pcg64::seed_from_u64(6);
    let scene = Arc::new(rooms(2, Corners::Abut, Sides::Both, 0.0, &mut rng));
    let culler = RegionCuller::build(Arc::clone(&scene));
    let mut scratch = Scratch::default();
    let view = View::level(DVec3::new(3.0, 1.7, 3.0), 0.0, 1.4, Resolution::new(64, 48));
    for radius in [-1.0, f64::NAN, f64::INFINITY] {
        let region = EyeRegion { centre: view.eye, radius };
        assert_eq!(culler.cull(&view, region, &mut scratch).visible.len(), scene.triangles().len());
        assert!(!scratch.occlusion().hides(&Bound::Box(Aabb::around(DVec3::splat(99.0), DVec3::ONE))));
    }
    let ball = EyeRegion { centre: view.eye, radius: 0.3 };
    for (width, height) in [(0, 0), (1, 1), (1, 8192), (8192, 1), (7, 0)] {
        let view = View { resolution: Resolution::new(width, height), ..view };
        assert!(!culler.cull(&view, ball, &mut scratch).visible.is_empty());
    }
    for fov_x in [0.0, f64::NAN, 1e-6, 179.9_f64.to_radians()] {
        culler.cull(&View { fov_x, ..view }, ball, &mut scratch);
    }
    for centre in [DVec3::new(6.0, 1.7, 3.0), DVec3::new(0.0, 0.0, 0.0), DVec3::splat(1e9), DVec3::new(0.1, 1.7, 3.0)] {
        culler.cull(&view, EyeRegion { centre, radius: 0.3 }, &mut scratch);
    }
    let empty = RegionCuller::build(Arc::new(Scene::from_triangles(Vec::new())));
    assert!(empty.cull(&view, ball, &mut Scratch::default()).visible.is_empty());
}

/// `cargo test --release -p eyeline-visibility --test region -- --ignored --nocapture`
#[test]
#[ignore = "two hundred thousand eyes"]
fn what_any_of_a_thousand_eyes_sees_is_in_the_visible_set() {
    let mut rng = Pcg64::seed_from_u64(3);
    for corners in [Corners::Abut, Corners::Overlap] {
        let scene = rooms(5, corners, Sides::Both, 0.0, &mut rng);
        for radius in RADII {
            let mut regions = regions_in(5, 17, &mut rng);
            regions.iter_mut().for_each(|region| region.radius = radius);
            let [kept, seen] = check_sets(scene.clone(), &regions, 1000, 30, 64, &mut rng);
            println!("{corners:?}, {radius} m: {kept:.1} primitives kept, {seen:.1} seen");
        }
    }
}

/// Avatars kept against those that some eye was found to see.
#[test]
#[ignore = "a measurement"]
fn how_many_avatars_are_kept_for_nothing() {
    let mut rng = Pcg64::seed_from_u64(9);
    for corners in [Corners::Abut, Corners::Overlap] {
        let scene = rooms(8, corners, Sides::Both, 0.0, &mut rng);
        let (rays, all_round) = (Rays::new(&scene), AllRound::new(&scene));
        let mut scratch = all_round.scratch(128);
        let (mut kept, mut seen) = ([0; RADII.len()], [0; RADII.len()]);
        for _ in 0..60 {
            let centre = random_eye(8, 0.0, &mut rng);
            let avatars: Vec<Aabb> = (0..60)
                .map(|i| {
                    let at = random_eye(8, 0.0, &mut rng);
                    let at = if i % 2 == 0 { centre + (at - centre) * 0.25 } else { at };
                    Aabb::around(at.with_y(0.9), DVec3::new(0.3, 0.88, 0.3))
                })
                .collect();
            for (i, radius) in RADII.into_iter().enumerate() {
                let region = EyeRegion { centre, radius };
                let occlusion = all_round.cull(region, &mut scratch).unwrap();
                for aabb in &avatars {
                    kept[i] += u32::from(!occlusion.hides(&Bound::Box(*aabb)));
                    seen[i] += u32::from(witness(&scene, &rays, region, &Bound::Box(*aabb), 1500, &mut rng).is_some());
                }
            }
        }
        println!("{corners:?}: of 3600 {kept:?} kept, {seen:?} seen at {RADII:?} m");
    }
}
