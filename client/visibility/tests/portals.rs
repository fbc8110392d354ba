//! What a ball of eyes sees through doors: whatever a ray shows is not called hidden, and little else is kept.

mod made;
mod under_support;

use std::sync::Arc;

use eyeline_visibility::{
    Aabb, AllRound, Bound, Cplp, Culler, EyeRegion, KdRules, KdTree, Occluders, Occlusion, Octree, OctreeRules,
    RayScene, RegionCuller, Resolution, Scene, Scratch, Sides, Tessellation, View, exact_set,
};
use glam::{DQuat, DVec3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use under_support::{Corners, ROOM, add_box, random_eye, rooms};

fn in_kd_cells(scene: &Arc<Scene>) -> RegionCuller {
    in_cells(scene, Arc::new(KdTree::build(scene, KdRules::default())))
}

fn in_cells(scene: &Arc<Scene>, cells: Arc<dyn Tessellation>) -> RegionCuller {
    let occluders = Arc::new(Occluders::build(scene));
    RegionCuller::new(Arc::clone(scene), Arc::new(Cplp::new(cells)), occluders, 64 * 64)
}

fn direction(rng: &mut Pcg64) -> DVec3 {
    loop {
        let v = DVec3::from_array(std::array::from_fn(|_| rng.random_range(-1.0..=1.0)));
        if (0.1..1.0).contains(&v.length()) {
            return v.normalize();
        }
    }
}

fn eye_in(region: EyeRegion, rng: &mut Pcg64) -> DVec3 {
    let part = if rng.random_bool(0.7) { 1.0 } else { rng.random_range(0.0..1.0) };
    region.centre + direction(rng) * (region.radius * part)
}

/// A direction of the view, often one that passes an edge of the scene closely.
fn direction_in(view: &View, eye: DVec3, scene: &Scene, rng: &mut Pcg64) -> DVec3 {
    let tangent = (view.fov_x * 0.5).tan();
    let Resolution { width, height } = view.resolution;
    let half = [tangent, tangent * f64::from(height) / f64::from(width)];
    for _ in 0..20 {
        let corners = scene.triangles()[rng.random_range(0..scene.triangles().len())].corners.map(|c| c.as_dvec3());
        let i = rng.random_range(0..3);
        let on_edge = corners[i].lerp(corners[(i + 1) % 3], rng.random_range(0.0..1.0));
        let along = on_edge + direction(rng) * 10.0_f64.powf(rng.random_range(-6.0..0.0)) - eye;
        let local = view.orientation.conjugate() * along;
        if local.z < 0.0 && (local.x / local.z).abs() < half[0] && (local.y / local.z).abs() < half[1] {
            return along.normalize();
        }
    }
    let local = DVec3::new(rng.random_range(-half[0]..half[0]), rng.random_range(-half[1]..half[1]), -1.0);
    view.orientation * local.normalize()
}

/// A bound that contains the point, sometimes on its very surface.
fn bound_with(point: DVec3, rng: &mut Pcg64) -> Bound {
    let half = DVec3::from_array(std::array::from_fn(|_| 10.0_f64.powf(rng.random_range(-4.0..0.5))));
    let away = DVec3::from_array(std::array::from_fn(|_| rng.random_range(-1.0..=1.0)));
    match rng.random_range(0..4) {
        0 => Bound::Sphere { centre: point + direction(rng) * half.x * 0.999_999, radius: half.x },
        1 => {
            let across = DVec3::new(away.x, 0.0, away.z).normalize_or_zero() * half.x * 0.999_999;
            Bound::Upright { centre: point + across + DVec3::Y * away.y * half.y, radius: half.x, half_height: half.y }
        }
        2 => Bound::Box(Aabb::new(point, point)),
        _ => Bound::Box(Aabb::around(point + half * away, half).inflated(1e-12)),
    }
}

/// Looks from balls along rays and asks about bounds on the way, and about the primitive at its end. Returns how many bounds
/// at random places were called hidden, of as many as rays.
fn check(
    scene: Scene,
    culler: &dyn Fn(&Arc<Scene>) -> RegionCuller,
    regions: &[EyeRegion],
    rays: usize,
    rng: &mut Pcg64,
) -> f64 {
    let scene = Arc::new(scene);
    let (culler, caster) = (culler(&scene), RayScene::new(&scene));
    let mut scratch = Scratch::default();
    let mut hidden = 0;
    for &region in regions {
        let resolution = Resolution::new(64, 48);
        let mut view = View::level(region.centre, rng.random_range(0.0..6.3), rng.random_range(0.6..2.2), resolution);
        view.orientation *= DQuat::from_rotation_x(rng.random_range(-0.5..0.5));
        let visible = culler.cull(&view, region, &mut scratch).visible;
        let occlusion = scratch.occlusion();
        for _ in 0..rays {
            let eye = eye_in(region, rng);
            let along = direction_in(&view, eye, &scene, rng);
            let hit = caster.first_hit(eye, along, view.near, f64::INFINITY);
            if let Some(hit) = &hit {
                assert!(
                    visible.binary_search(&hit.primitive).is_ok(),
                    "{hit:?} from {eye} along {along} in {region:?}"
                );
            }
            let share = if rng.random_bool(0.5) { 1.0 - 1e-9 } else { rng.random_range(0.0..1.0) };
            let point = eye + along * hit.map_or(30.0, |hit| hit.t).min(60.0) * share;
            let bound = bound_with(point, rng);
            assert!(!occlusion.hides(&bound), "{bound:?} with {point} seen from {eye} in {region:?}, {view:?}");
            assert!(!occlusion.hides_group(&bound), "{bound:?} in {region:?}");
            let elsewhere = scene.bounds().min + scene.bounds().size() * rng.random_range(0.0..1.0);
            hidden += usize::from(occlusion.hides(&bound_with(elsewhere, rng)));
        }
    }
    hidden as f64 / (rays * regions.len()) as f64
}

/// Balls in rooms, at and in walls, in corners, on floors and before the building.
fn regions(n: u32, count: usize, rng: &mut Pcg64) -> Vec<EyeRegion> {
    let radii = [0.05, 0.15, 0.3, 0.6, 1.0];
    let region = |i: usize| {
        let radius = radii[i % radii.len()];
        let mut centre = random_eye(n, 0.0, rng);
        match i % 7 {
            1 => centre.x = (centre.x / ROOM).round() * ROOM + 0.1 + radius,
            2 => centre = (centre / ROOM).round() * ROOM + DVec3::new(0.3, 1.7, 0.2),
            3 => centre.z = (centre.z / ROOM).round() * ROOM + 0.05,
            4 => centre.y = radius,
            5 => centre.x = -0.1 - radius * 0.5,
            _ => {}
        }
        EyeRegion { centre, radius }
    };
    (0..count).map(region).collect()
}

#[test]
fn what_a_ray_from_a_ball_meets_is_not_hidden() {
    let mut rng = Pcg64::seed_from_u64(5);
    for corners in [Corners::Abut, Corners::Overlap] {
        for sides in [Sides::Both, Sides::Front] {
            let scene = rooms(4, corners, sides, 0.0, &mut rng);
            let hidden = check(scene, &in_kd_cells, &regions(4, 14, &mut rng), 300, &mut rng);
            assert!(hidden > 0.3, "{corners:?}, {sides:?}: {hidden}");
        }
    }
}

#[test]
fn nor_is_it_where_rooms_are_full_or_are_no_rooms() {
    let mut rng = Pcg64::seed_from_u64(6);
    let crowded = made::building(3, 40, 3);
    let balls = |rng: &mut Pcg64| regions(2, 6, rng);
    check(crowded.clone(), &in_kd_cells, &balls(&mut rng), 150, &mut rng);
    let in_octree = |scene: &Arc<Scene>| in_cells(scene, Arc::new(Octree::build(scene, OctreeRules::default())));
    check(crowded, &in_octree, &balls(&mut rng), 150, &mut rng);
    for seed in 0..2 {
        let region = |rng: &mut Pcg64| EyeRegion { centre: direction(rng) * 4.0, radius: rng.random_range(0.01..1.0) };
        let regions: Vec<EyeRegion> = (0..4).map(|_| region(&mut rng)).collect();
        check(made::soup(seed, 300), &in_kd_cells, &regions, 150, &mut rng);
    }
}

/// Two rooms of 6×6×3 m, one beyond the other along −Z, and a door of 1.0×2.1 m in the wall of 0.2 m between them, at the origin.
fn two_rooms() -> Scene {
    let mut triangles = Vec::new();
    let mut add = |min: [f64; 3], max: [f64; 3]| add_box(&mut triangles, min, max, Sides::Front, 0.0);
    add([-3.2, -0.2, -6.3], [3.2, 0.0, 6.3]);
    add([-3.2, 3.0, -6.3], [3.2, 3.2, 6.3]);
    add([-3.2, -0.1, -6.3], [-3.0, 3.1, 6.3]);
    add([3.0, -0.1, -6.3], [3.2, 3.1, 6.3]);
    add([-3.2, -0.1, -6.3], [3.2, 3.1, -6.1]);
    add([-3.2, -0.1, 6.1], [3.2, 3.1, 6.3]);
    add([-3.1, -0.1, -0.1], [-0.5, 3.1, 0.1]);
    add([0.5, -0.1, -0.1], [3.1, 3.1, 0.1]);
    add([-0.5, 2.1, -0.1], [0.5, 3.1, 0.1]);
    Scene::from_triangles(triangles)
}

#[test]
fn a_door_shows_what_its_separating_planes_leave() {
    let scene = Arc::new(two_rooms());
    let culler = in_kd_cells(&scene);
    let view = View::level(DVec3::new(0.0, 1.6, 3.0), 0.0, 1.6, Resolution::new(256, 128));
    let region = EyeRegion { centre: view.eye, radius: 0.3 };
    let mut scratch = Scratch::default();
    culler.cull(&view, region, &mut scratch);
    let beside = |from: f64, to: f64| Bound::Box(Aabb::new(DVec3::new(from, 1.0, -2.0), DVec3::new(to, 1.1, -1.9)));
    let hides = |from: f64, to: f64| scratch.occlusion().hides(&beside(from, to));
    // The tangent to the ball through the farther edge of the jamb (0.5 m aside at 3.1 m) is at 0.996 m when 5 m away.
    assert!(hides(1.0, 1.1) && hides(-1.1, -1.0) && hides(1.5, 2.9));
    assert!(!hides(0.9, 0.99) && !hides(-0.99, -0.9) && !hides(0.0, 0.1));
    // From the centre alone it would be 0.81 m.
    culler.cull(&view, EyeRegion { radius: 1e-6, ..region }, &mut scratch);
    let hides = |from: f64, to: f64| scratch.occlusion().hides(&beside(from, to));
    assert!(hides(0.82, 0.9) && !hides(0.7, 0.78));
    // In the wall, beside the view and outside all cells.
    assert!(scratch.occlusion().hides(&Bound::Box(Aabb::around(DVec3::new(1.0, 1.0, 0.0), DVec3::splat(0.05)))));
    assert!(scratch.occlusion().hides(&Bound::Box(Aabb::around(DVec3::new(0.0, 1.0, 4.0), DVec3::splat(0.5)))));
    assert!(!scratch.occlusion().hides(&Bound::Box(Aabb::around(DVec3::new(0.0, 1.0, -2.0), DVec3::splat(50.0)))));
    assert!(!scratch.occlusion().hides(&Bound::Everywhere));
}

#[test]
fn beyond_all_cells_nothing_is_hidden_that_an_opening_shows() {
    let closed = two_rooms();
    // Without the wall at the end of the farther room, of which nothing but its edges in other walls is left.
    let is_left = |triangle: &&eyeline_visibility::Triangle| !triangle.corners.iter().all(|corner| corner.z < -6.0);
    let open = Scene::from_triangles(closed.triangles().iter().filter(is_left).copied().collect());
    let eye = EyeRegion { centre: DVec3::new(0.0, 1.6, 3.0), radius: 0.1 };
    let beyond = Bound::Box(Aabb::around(DVec3::new(0.0, 1.5, -12.0), DVec3::splat(0.3)));
    for (scene, is_closed) in [(closed, true), (open, false)] {
        let all_round = AllRound::among_rooms(&scene);
        let mut scratch = all_round.scratch(32);
        let occlusion = all_round.look_around(eye, (0.0, DVec3::ZERO), &mut scratch).unwrap();
        assert_eq!(occlusion.hides(&beyond), is_closed);
        assert!(!occlusion.hides(&Bound::Everywhere));
        assert!(scratch.stats().looks > 0, "doors are not asked");
    }
}

#[test]
fn from_outside_all_cells_there_are_no_doors() {
    let scene = Arc::new(two_rooms());
    let culler = in_kd_cells(&scene);
    let mut scratch = Scratch::default();
    // Wholly and partly before the outer wall, which ends at 6.3 m.
    for z in [8.0, 6.5] {
        let view = View::level(DVec3::new(0.0, 1.6, z), 0.0, 1.6, Resolution::new(64, 48));
        let visible = culler.cull(&view, EyeRegion { centre: view.eye, radius: 0.3 }, &mut scratch).visible;
        let seen = exact_set(&scene, &view).0;
        assert!(!seen.is_empty() && seen.iter().all(|id| visible.binary_search(id).is_ok()), "{visible:?} at {z}");
        assert!(!scratch.occlusion().hides(&Bound::Box(Aabb::around(view.eye, DVec3::splat(0.1)))));
    }
}

#[test]
fn what_was_asked_before_changes_nothing() {
    let mut rng = Pcg64::seed_from_u64(8);
    let scene = Arc::new(rooms(3, Corners::Overlap, Sides::Both, 0.0, &mut rng));
    let culler = in_kd_cells(&scene);
    let mut used = Scratch::default();
    for region in regions(3, 10, &mut rng) {
        let view = View::level(region.centre, rng.random_range(0.0..6.3), 1.5, Resolution::new(64, 48));
        let mut fresh = Scratch::default();
        let culled = culler.cull(&view, region, &mut used);
        assert_eq!(culled, culler.cull(&view, region, &mut fresh));
        for _ in 0..100 {
            let bound = bound_with(random_eye(3, 0.0, &mut rng), &mut rng);
            assert_eq!(used.occlusion().hides(&bound), fresh.occlusion().hides(&bound));
        }
        // A point's own image forgets the doors of the ball before.
        let point = EyeRegion::point(region.centre);
        assert_eq!(culler.cull(&view, point, &mut used), culler.cull(&view, point, &mut fresh));
    }
}

#[test]
fn pictures_from_a_ball_show_only_what_doors_show() {
    let mut rng = Pcg64::seed_from_u64(9);
    for corners in [Corners::Abut, Corners::Overlap] {
        let scene = Arc::new(rooms(4, corners, Sides::Both, 0.0, &mut rng));
        let culler = in_kd_cells(&scene);
        let mut scratch = Scratch::default();
        let (mut kept, mut count) = (0, 0);
        for region in regions(4, 10, &mut rng) {
            let yaw = rng.random_range(0.0..6.3);
            let view = View::level(region.centre, yaw, rng.random_range(0.6..2.2), Resolution::new(64, 48));
            let visible = culler.cull(&view, region, &mut scratch).visible;
            for _ in 0..15 {
                let eye = eye_in(region, &mut rng);
                for id in exact_set(&scene, &View { eye, ..view }).0 {
                    assert!(visible.binary_search(&id).is_ok(), "{id} is seen from {eye} in {region:?}");
                }
            }
            kept += visible.len();
            count += scene.triangles().len();
        }
        assert!(kept * 4 < count, "{corners:?}: {kept} of {count} kept");
    }
}
