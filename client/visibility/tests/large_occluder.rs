//! Coorg & Teller's culler: nothing that can be seen is lost, joint occluders hide what none of them hides alone, and what is
//! kept between frames changes nothing but the cost.

mod made;
mod under_support;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use eyeline_visibility::{
    Aabb, Bound, Culler, EyeRegion, KdRules, LargeOccluder, LargeOccluderRules, LargeOccluderScratch, LoadOptions,
    Occlusion, Resolution, Scene, Scratch, Sides, Triangle, View, exact_set, load_file, wrong_pixels,
};
use glam::{DQuat, DVec3, Vec3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use under_support::{Corners, Rays, random_eye, rooms};

const SMALL: Resolution = Resolution::new(64, 64);

/// Checks views against the exact set; returns primitives kept and primitives visible.
fn check(culler: &LargeOccluder, views: impl IntoIterator<Item = View>) -> [usize; 2] {
    let (scene, mut scratch) = (culler.scene(), Scratch::default());
    let mut sums = [0; 2];
    for view in views {
        let (exact, items) = exact_set(scene, &view);
        let visible = culler.cull(&view, EyeRegion::point(view.eye), &mut scratch).visible;
        assert!(visible.is_sorted_by(|a, b| a < b));
        let lost: Vec<u32> = exact.iter().copied().filter(|id| visible.binary_search(id).is_err()).collect();
        assert!(lost.is_empty(), "{lost:?} of {} are lost from {view:?}", exact.len());
        assert_eq!(wrong_pixels(scene, &view, &visible, &items), 0);
        sums = [sums[0] + visible.len(), sums[1] + exact.len()];
    }
    sums
}

/// Rules that leave nothing out: every polygon may be chosen, cells are small.
fn thorough() -> LargeOccluderRules {
    let cells = KdRules::default().with_max_triangles_per_leaf(32);
    LargeOccluderRules::default().with_area_min(0.0).with_occluders(64).with_cells(cells)
}

#[test]
fn nothing_is_lost_in_made_rooms() {
    let scene = Arc::new(made::with_nodes(&made::building(5, 10, 3), 1));
    for rules in [LargeOccluderRules::default(), thorough()] {
        let culler = LargeOccluder::new(scene.clone(), rules);
        let mut rng = Pcg64::seed_from_u64(4);
        let views: Vec<View> = (0..50).map(|_| made::visitor(&mut rng, 5, SMALL)).collect();
        let [kept, exact] = check(&culler, views.iter().copied());
        let [in_frustum, _] = check(&LargeOccluder::new(scene.clone(), rules.with_occluders(0)), views);
        println!("{kept} kept of {in_frustum} in the frustum, {exact} visible");
        assert!(2 * kept < in_frustum, "{kept} of {in_frustum}: the test says little");
        check(
            &culler,
            (0..50).map(|_| {
                let eye = made::visitor(&mut rng, 5, SMALL).eye;
                made::any_view(&mut rng, eye, SMALL)
            }),
        );
    }
}

#[test]
fn nothing_is_lost_in_rooms_however_their_walls_meet() {
    let mut rng = Pcg64::seed_from_u64(5);
    for (corners, sides, turn) in [
        (Corners::Abut, Sides::Both, 0.0),
        (Corners::Abut, Sides::Front, 0.0),
        (Corners::Overlap, Sides::Front, 0.0),
        (Corners::Abut, Sides::Front, 0.3),
        (Corners::Overlap, Sides::Both, 1.1),
    ] {
        let scene = Arc::new(rooms(3, corners, sides, turn, &mut rng));
        let culler = LargeOccluder::new(scene.clone(), thorough());
        let views: Vec<View> = (0..50)
            .map(|_| {
                let eye = random_eye(3, turn, &mut rng);
                View { eye, ..made::visitor(&mut rng, 4, SMALL) }
            })
            .collect();
        let [kept, exact] = check(&culler, views);
        println!("{corners:?} {sides:?} {turn}: {kept} kept, {exact} visible, {:?} joints", culler.joint_counts());
    }
}

#[test]
fn nothing_is_lost_from_any_eye_of_a_ball() {
    let mut rng = Pcg64::seed_from_u64(11);
    for (corners, sides) in [(Corners::Abut, Sides::Front), (Corners::Overlap, Sides::Both)] {
        let scene = Arc::new(rooms(3, corners, sides, 0.0, &mut rng));
        let culler = LargeOccluder::new(scene.clone(), thorough());
        let mut scratch = Scratch::default();
        let mut kept = 0;
        for radius in [0.05, 0.2, 0.5] {
            for _ in 0..3 {
                let centre = random_eye(3, 0.0, &mut rng);
                let view = View { eye: centre, ..made::visitor(&mut rng, 3, SMALL) };
                let visible = culler.cull(&view, EyeRegion { centre, radius }, &mut scratch).visible;
                kept += visible.len();
                for _ in 0..8 {
                    let mut unit = || rng.random_range(-1.0..1.0);
                    let eye = centre + DVec3::new(unit(), unit(), unit()).normalize() * radius;
                    let (exact, _) = exact_set(&scene, &View { eye, ..view });
                    let lost = exact.iter().find(|id| visible.binary_search(id).is_err());
                    assert_eq!(lost, None, "{radius} m around {centre}, seen from {eye}");
                }
            }
        }
        assert!(kept < 9 * scene.triangles().len() * 9 / 10, "{kept}: the test says little");
    }
}

#[test]
fn nothing_is_lost_in_soups() {
    for seed in 0..6 {
        let scene = Arc::new(made::soup(seed, 150));
        let mut rng = Pcg64::seed_from_u64(seed);
        for rules in [LargeOccluderRules::default(), thorough()] {
            let views: Vec<View> = (0..25)
                .map(|_| {
                    let eye = DVec3::from_array(std::array::from_fn(|_| rng.random_range(-8.0..8.0)));
                    made::any_view(&mut rng, eye, SMALL)
                })
                .collect();
            check(&LargeOccluder::new(scene.clone(), rules), views);
        }
    }
}

#[test]
fn nothing_is_lost_on_maps() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let data = std::env::var_os("EYELINE_DATA").map_or(root.join("../shared/data"), PathBuf::from);
    for name in ["oa_dm2", "oa_koth1", "ctf_compromise"] {
        let file = data.join("scenes").join(name).with_extension("glb");
        if !file.exists() {
            eprintln!("skipped: no {} (set EYELINE_DATA)", file.display());
            continue;
        }
        let scene = Arc::new(load_file(&file, &LoadOptions::default()).unwrap());
        let text = std::fs::read(file.with_extension("places.json")).unwrap();
        let json: serde_json::Value = serde_json::from_slice(&text).unwrap();
        let places = json["places"].as_array().unwrap();
        let mut rng = Pcg64::seed_from_u64(6);
        let views: Vec<View> = (0..50)
            .map(|_| {
                let place = &places[rng.random_range(0..places.len())]["position"];
                let feet = DVec3::from_array([0, 1, 2].map(|i| place[i].as_f64().unwrap())) - scene.anchor();
                View::level(feet + DVec3::Y * 1.4375, rng.random_range(0.0..6.3), 1.5, SMALL)
            })
            .collect();
        let culler = LargeOccluder::build(scene.clone());
        let [kept, exact] = check(&culler, views.iter().copied());
        let frustum = LargeOccluder::new(scene.clone(), LargeOccluderRules::default().with_occluders(0));
        let in_frustum: usize = {
            let mut scratch = LargeOccluderScratch::default();
            views.iter().map(|v| frustum.walk(v, EyeRegion::point(v.eye), &mut scratch).primitives).sum()
        };
        println!("{name}: {kept} kept of {in_frustum}, {exact} visible; {:?} joints", culler.joint_counts());
        assert!(kept < in_frustum);
    }
}

/// A rectangle by a corner and two sides.
fn quad(triangles: &mut Vec<Triangle>, corner: [f32; 3], u: [f32; 3], v: [f32; 3], sides: Sides) {
    let [corner, u, v] = [corner, u, v].map(Vec3::from);
    for corners in [[corner, corner + u, corner + u + v], [corner, corner + u + v, corner + v]] {
        triangles.push(Triangle { corners, sides, occludes: true });
    }
}

/// Whether walls hide a box from an eye that looks along −Z.
fn hides(walls: &[Vec<Triangle>], region: EyeRegion, aabb: Aabb, rules: LargeOccluderRules) -> bool {
    let scene = Arc::new(Scene::from_triangles(walls.concat()));
    let culler = LargeOccluder::new(scene, rules);
    let view = View::level(region.centre, 0.0, 1.5, Resolution::new(512, 512));
    let mut scratch = Scratch::default();
    culler.cull(&view, region, &mut scratch);
    scratch.occlusion().hides(&Bound::Box(aabb))
}

/// Asserts that the walls hide the box together, and no smaller set of them does.
fn assert_only_jointly(walls: &[Vec<Triangle>], aabb: Aabb, what: &str) {
    let eye = EyeRegion::point(DVec3::ZERO);
    assert!(hides(walls, eye, aabb, thorough()), "{what}: not hidden together");
    assert!(!hides(walls, eye, aabb, thorough().with_joint(false)), "{what}: hidden without joint occluders");
    for left_out in 0..walls.len() {
        let fewer: Vec<_> = walls.iter().enumerate().filter(|(i, _)| *i != left_out).map(|(_, w)| w.clone()).collect();
        assert!(!hides(&fewer, eye, aabb, thorough()), "{what}: hidden without wall {left_out}");
    }
}

fn wall(corner: [f32; 3], u: [f32; 3], v: [f32; 3]) -> Vec<Triangle> {
    let mut triangles = Vec::new();
    quad(&mut triangles, corner, u, v, Sides::Both);
    triangles
}

#[test]
fn two_walls_that_share_an_edge_hide_together() {
    let aabb = Aabb::around(DVec3::new(0.0, 0.0, -8.0), DVec3::new(1.0, 0.5, 0.5));
    let up = [0.0, 4.0, 0.0];
    // They do not merge: a corner more on each would be too many, or they are not coplanar.
    let coplanar = [wall([-3.0, -2.0, -4.0], [3.0, 0.0, 0.0], up), wall([0.0, -2.0, -4.0], [3.0, 0.0, 1e-3], up)];
    assert_only_jointly(&coplanar, aabb, "almost coplanar");
    let toward = [wall([-3.0, -2.0, -2.0], [3.0, 0.0, -2.0], up), wall([0.0, -2.0, -4.0], [3.0, 0.0, 2.0], up)];
    assert_only_jointly(&toward, aabb, "a corner that points away");
    let away = [wall([-3.0, -2.0, -5.0], [3.0, 0.0, 1.0], up), wall([0.0, -2.0, -4.0], [3.0, 0.0, -1.0], up)];
    assert_only_jointly(&away, aabb, "a corner that points here");
}

#[test]
fn a_silhouette_edge_is_no_joint() {
    // Figure 4: both walls are on the same side of their common edge.
    let up = [0.0, 4.0, 0.0];
    let walls = [wall([-3.0, -2.0, -4.0], [3.0, 0.0, 0.0], up), wall([-3.0, -2.0, -6.0], [3.0, 0.0, 2.0], up)];
    let aabb = Aabb::around(DVec3::new(0.0, 0.0, -8.0), DVec3::new(1.0, 0.5, 0.5));
    assert!(!hides(&walls, EyeRegion::point(DVec3::ZERO), aabb, thorough()));
    // What one of them hides alone, it hides.
    let aabb = Aabb::around(DVec3::new(-2.0, 0.0, -8.0), DVec3::new(1.0, 0.5, 0.5));
    assert!(hides(&walls, EyeRegion::point(DVec3::ZERO), aabb, thorough()));
}

#[test]
fn t_junctions_and_walls_that_cross_are_no_gaps() {
    let aabb = Aabb::around(DVec3::new(0.0, 0.0, -8.0), DVec3::new(1.0, 0.5, 0.5));
    let left = wall([-3.0, -2.0, -4.0], [3.0, 0.0, 0.0], [0.0, 4.0, 0.0]);
    let right = |from: f32, to: f32| wall([0.0, from, -4.0], [3.0, 0.0, 0.5], [0.0, to - from, 0.0]);
    assert_only_jointly(&[left.clone(), right(-2.0, 0.125), right(0.125, 2.0)], aabb, "a T-junction");
    assert!(!hides(
        &[left.clone(), right(-2.0, 0.125), right(0.1875, 2.0)],
        EyeRegion::point(DVec3::ZERO),
        aabb,
        thorough()
    ));
    let crossing = wall([-0.2, -2.0, -4.1], [3.0, 0.0, 0.5], [0.0, 4.0, 0.0]);
    assert_only_jointly(&[left, crossing], aabb, "walls that cross");
}

#[test]
fn the_wall_around_a_door_hides_what_is_not_behind_the_door() {
    let up = |height: f32| [0.0, height, 0.0];
    let door = [
        wall([-3.0, -1.5, -4.0], [2.5, 0.0, 0.0], up(3.0)),
        wall([-0.5, 0.5, -4.0], [1.0, 0.0, 0.0], up(1.0)),
        wall([0.5, -1.5, -4.0], [2.5, 0.0, 0.0], up(3.0)),
    ];
    let eye = EyeRegion::point(DVec3::ZERO);
    let lamp = |y: f64| Aabb::around(DVec3::new(0.0, y, -5.0), DVec3::new(1.5, 0.2, 0.3));
    assert!(hides(&door, eye, lamp(1.2), thorough()));
    assert!(!hides(&door, eye, lamp(1.2), thorough().with_joint(false)));
    assert!(!hides(&door, eye, lamp(0.7), thorough()));
}

#[test]
fn what_touches_the_outline_is_seen() {
    let wall = wall([-1.0, -1.0, -2.0], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0]);
    let behind = |x: f64| Aabb::new(DVec3::new(-x, -x, -4.0), DVec3::new(x, x, -3.9));
    let eye = EyeRegion::point(DVec3::ZERO);
    let hidden = |aabb| hides(std::slice::from_ref(&wall), eye, aabb, thorough());
    assert!(hidden(behind(1.94)));
    // The line of sight past the edge meets it at 1.95.
    assert!(!hidden(behind(1.95)));
    assert!(!hidden(Aabb::new(DVec3::new(-0.5, -0.5, -3.0), DVec3::new(0.5, 0.5, -2.0))));
    assert!(!hidden(Aabb::new(DVec3::new(-0.5, -0.5, -1.9), DVec3::new(0.5, 0.5, -1.8))));
    // An eye that may move by 0.1 m sees 0.1 m more at twice the distance.
    let ball = EyeRegion { centre: DVec3::ZERO, radius: 0.1 };
    assert!(hides(std::slice::from_ref(&wall), ball, behind(1.8), thorough()));
    assert!(!hides(std::slice::from_ref(&wall), ball, behind(1.86), thorough()));
}

#[test]
fn what_is_hidden_no_ray_meets() {
    let mut rng = Pcg64::seed_from_u64(8);
    for (corners, sides, turn, radius) in [
        (Corners::Abut, Sides::Both, 0.0, 0.0),
        (Corners::Overlap, Sides::Front, 0.0, 0.0),
        (Corners::Abut, Sides::Front, 0.4, 0.0),
        (Corners::Overlap, Sides::Both, 0.0, 0.2),
        (Corners::Abut, Sides::Both, 0.0, 0.3),
    ] {
        let scene = Arc::new(rooms(4, corners, sides, turn, &mut rng));
        let (rays, culler) = (Rays::new(&scene), LargeOccluder::new(scene, thorough()));
        let mut scratch = LargeOccluderScratch::default();
        let (mut hidden, mut cast) = (0, 0);
        for _ in 0..40 {
            let centre = random_eye(4, turn, &mut rng);
            let view = View { eye: centre, ..made::visitor(&mut rng, 4, Resolution::new(512, 512)) };
            culler.walk(&view, EyeRegion { centre, radius }, &mut scratch);
            for _ in 0..40 {
                let mut unit = || DVec3::from_array(std::array::from_fn(|_| rng.random_range(-1.0..1.0)));
                let aabb = Aabb::around(centre + unit() * DVec3::new(10.0, 2.0, 10.0), unit().abs());
                if !scratch.hides(&Bound::Box(aabb)) {
                    continue;
                }
                for _ in 0..30 {
                    let point = aabb.centre() + aabb.size() * 0.5 * unit();
                    let eye = centre + unit().normalize() * radius;
                    let local = view.orientation.inverse() * (point - eye);
                    let tangent = (view.fov_x * 0.5).tan();
                    if local.z < 0.0 && local.x.abs().max(local.y.abs()) < -local.z * tangent {
                        cast += 1;
                        assert!(rays.blocked(eye, point), "{eye} sees {point} of {aabb:?}, {corners:?} {sides:?}");
                    }
                }
                hidden += 1;
            }
        }
        println!("{corners:?} {sides:?} {turn} {radius}: {hidden} hidden, {cast} rays");
        assert!(cast > 1000, "{cast}: the test says little");
    }
}

/// Rooms of 3 × 3 with furniture, each box a node of its own.
fn flat() -> Arc<Scene> {
    Arc::new(made::with_nodes(&made::building(3, 6, 3), 1))
}

/// Places along a figure 8 over [`flat`], `speed` metres a step, with a jump now and then.
fn figure_8(steps: usize, speed: f64, jumps: bool) -> impl Iterator<Item = View> {
    let mut rng = Pcg64::seed_from_u64(9);
    let mut phase = 0.0_f64;
    (0..steps).map(move |step| {
        let at = |phase: f64| DVec3::new(7.5 + 6.0 * phase.sin(), 1.6, 7.5 + 3.0 * (2.0 * phase).sin());
        if jumps && step % 97 == 96 {
            phase = rng.random_range(0.0..6.0);
        }
        phase += speed / 7.0;
        let along = at(phase + 1e-3) - at(phase);
        let yaw = f64::atan2(-along.x, -along.z);
        let turn = if jumps && step % 50 > 40 { 0.5 * (step as f64).sin() } else { 0.0 };
        View::level(at(phase), yaw + turn, 1.2, Resolution::new(256, 256))
    })
}

#[test]
fn what_is_kept_between_frames_changes_nothing_but_the_cost() {
    let scene = flat();
    let culler = LargeOccluder::build(scene);
    let (mut warm, mut cold) = (LargeOccluderScratch::default(), LargeOccluderScratch::default());
    let (mut reused, mut tested) = (0, 0);
    for (step, view) in figure_8(1000, 0.04, true).enumerate() {
        let region = EyeRegion::point(view.eye);
        let kept = culler.walk(&view, region, &mut warm);
        cold.forget_relations();
        let fresh = culler.walk(&view, region, &mut cold);
        assert_eq!(warm.visible(), cold.visible(), "at step {step}");
        assert_eq!(kept.nodes_visited, fresh.nodes_visited);
        assert!(kept.relations_made <= fresh.relations_made);
        (reused, tested) = (reused + kept.relations_reused, tested + kept.relations_tested);
    }
    println!("{reused} reused, {tested} tested");
    assert!(reused > 2 * tested, "{reused} reused, {tested} tested");
}

#[test]
fn a_slow_observer_costs_less_than_a_fast_one() {
    let scene = flat();
    let culler = LargeOccluder::build(scene);
    let work = [0.01, 0.02, 0.04, 0.08, 0.16].map(|speed| {
        let mut scratch = LargeOccluderScratch::default();
        // The first frame is cold at any speed.
        let frames = figure_8(200, speed, false).map(|v| culler.walk(&v, EyeRegion::point(v.eye), &mut scratch).work());
        frames.skip(1).sum::<usize>() / 199
    });
    println!("work per frame at 0.25, 0.5, 1, 2 and 4 times 0.04 m a step: {work:?}");
    assert!(work.is_sorted_by(|a, b| a < b), "{work:?}");
    assert!(3 * work[0] < 2 * work[4], "{work:?}");
}

#[test]
fn kept_relations_are_bounded_and_forgotten_with_their_scene() {
    let scene = flat();
    let rules = LargeOccluderRules::default().with_relations_max(500);
    let (small, large) = (LargeOccluder::new(scene.clone(), rules), LargeOccluder::build(scene));
    let (mut here, mut there) = (LargeOccluderScratch::default(), LargeOccluderScratch::default());
    let mut most = 0;
    for view in figure_8(60, 0.2, true) {
        let region = EyeRegion::point(view.eye);
        let before = here.relation_count();
        let stats = small.walk(&view, region, &mut here);
        assert!(here.relation_count() <= before.min(500) + stats.relations_made);
        large.walk(&view, region, &mut there);
        assert_eq!(here.visible(), there.visible());
        most = most.max(there.relation_count());
        // The other's relations are of other boxes, as far as it knows.
        let mut of_other = here.clone();
        large.walk(&view, region, &mut of_other);
        assert_eq!(of_other.visible(), there.visible());
    }
    assert!(most > 1000, "{most}: the limit is never met");
}

#[test]
fn odd_scenes_and_views_have_defined_results() {
    let triangle =
        |corners: [[f32; 3]; 3]| Triangle { corners: corners.map(Vec3::from), sides: Sides::Both, occludes: true };
    let scenes = [
        vec![],
        vec![triangle([[-1.0, -1.0, -3.0], [1.0, -1.0, -3.0], [0.0, 1.0, -3.0]])],
        vec![triangle([[0.0, 0.0, -3.0], [1.0, 0.0, -3.0], [2.0, 0.0, -3.0]]); 5],
        vec![triangle([[1.0, 2.0, 3.0]; 3]); 9],
        vec![triangle([[-1e30, 0.0, -1.0], [1e30, 0.0, -1.0], [0.0, 1e30, -1.0]]); 3],
        vec![triangle([[-1.0, -1.0, -3.0], [1.0, -1.0, -3.0], [0.0, 1.0, -3.0]]); 300],
    ];
    let boxes = [
        Aabb::EMPTY,
        Aabb::around(DVec3::new(0.0, 0.0, -5.0), DVec3::splat(0.1)),
        Aabb::around(DVec3::ZERO, DVec3::splat(f64::INFINITY)),
        Aabb::around(DVec3::splat(f64::NAN), DVec3::ONE),
    ];
    for triangles in scenes {
        let scene = Arc::new(Scene::from_triangles(triangles));
        let total = scene.triangles().len();
        for rules in [thorough(), LargeOccluderRules::default().with_area_min(f64::NAN).with_polygons_max(1)] {
            let culler = LargeOccluder::new(scene.clone(), rules);
            let good = View::level(DVec3::ZERO, 0.0, 1.5, SMALL);
            let in_plane = View { eye: DVec3::new(0.0, 0.0, -3.0), ..good };
            let empty = View { resolution: Resolution::new(0, 0), ..good };
            check(&culler, [good, in_plane, View { eye: DVec3::splat(1e12), ..good }, empty]);
            let mut scratch = Scratch::default();
            for bad in [
                View { eye: DVec3::NAN, ..good },
                View { orientation: DQuat::from_xyzw(0.0, 0.0, 0.0, 0.0), ..good },
                View { fov_x: f64::NAN, ..good },
                View { near: 0.0, ..good },
            ] {
                let visible = culler.cull(&bad, EyeRegion::point(bad.eye), &mut scratch).visible;
                assert_eq!(visible.len(), total);
                assert!(boxes.iter().all(|aabb| !scratch.occlusion().hides(&Bound::Box(*aabb))));
            }
            for radius in [-1.0, f64::NAN, f64::INFINITY] {
                let region = EyeRegion { centre: DVec3::ZERO, radius };
                assert_eq!(culler.cull(&good, region, &mut scratch).visible.len(), total);
                assert!(!scratch.occlusion().hides(&Bound::Box(boxes[1])));
            }
            culler.cull(&good, EyeRegion::point(good.eye), &mut scratch);
            for (aabb, may_hide) in boxes.iter().zip([false, true, false, false]) {
                assert!(!scratch.occlusion().hides(&Bound::Box(*aabb)) || may_hide, "{aabb:?}");
            }
            assert!(!scratch.occlusion().hides(&Bound::Everywhere));
        }
    }
}

#[test]
fn an_eye_inside_a_wall_loses_nothing() {
    let scene = Arc::new(made::building(3, 4, 1));
    let culler = LargeOccluder::new(scene, thorough());
    let yaws = (0..8).map(|i| f64::from(i) * 0.8);
    for eye in
        [DVec3::new(5.0, 1.6, 2.0), DVec3::new(5.0, 1.6, 5.0), DVec3::new(5.1, 1.6, 2.0), DVec3::new(2.0, 0.0, 2.0)]
    {
        check(&culler, yaws.clone().map(|yaw| View::level(eye, yaw, 1.5, SMALL)));
    }
}
