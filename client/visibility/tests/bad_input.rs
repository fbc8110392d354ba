//! What no careful caller would ask: each has a defined answer or a clear error, and never a panic, a hang or a giant image.

mod every;
mod made;

use std::f64::consts::PI;
use std::sync::Arc;

use every::{check, cullers};
use eyeline_visibility::{
    Aabb, Bound, Budget, Coverage, Cplp, CplpScratch, DepthBuffer, EyeRegion, Face, ItemBuffer, MaskedCplp,
    MaskedCplpScratch, MaskedDepth, Occlusion, QueryBackEnd, QueryKind, Resolution, Scene, SceneError, Scratch,
    SealedFace, Sides, Triangle, View, ViewError, exact_set,
};
use glam::{DQuat, DVec3, Vec3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

fn triangle(corners: [[f32; 3]; 3]) -> Triangle {
    Triangle { corners: corners.map(Vec3::from_array), sides: Sides::Both, occludes: true }
}

fn good() -> View {
    View::level(DVec3::new(2.0, 1.6, 2.0), 0.5, 1.4, Resolution::new(32, 24))
}

/// Views that are none, one wrong number each.
fn no_views() -> Vec<View> {
    let mut views = Vec::new();
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        for axis in 0..3 {
            let mut view = good();
            view.eye[axis] = bad;
            views.push(view);
        }
        views.push(View { fov_x: bad, ..good() });
        views.push(View { near: bad, ..good() });
        views.push(View { orientation: DQuat::from_xyzw(0.0, bad, 0.0, 1.0), ..good() });
    }
    views.extend([0.0, -1.0, PI, 4.0, -0.0].map(|fov_x| View { fov_x, ..good() }));
    views.extend([0.0, -0.1, -0.0, 1e-300, 9e-7].map(|near| View { near, ..good() }));
    let turns = [DQuat::from_xyzw(0.0, 0.0, 0.0, 0.0), DQuat::from_xyzw(0.0, 0.0, 0.0, 2.0)];
    views.extend(turns.map(|orientation| View { orientation, ..good() }));
    let sizes = [(u32::MAX, u32::MAX), (u32::MAX, 1), (1, 65_537), (65_536, 65_536), (8193, 8192), (1 << 31, 0)];
    views.extend(sizes.map(|(width, height)| View { resolution: Resolution::new(width, height), ..good() }));
    views
}

#[test]
fn a_view_says_what_is_wrong_with_it() {
    assert_eq!(good().check(), Ok(()));
    for view in no_views() {
        let error = view.check().expect_err("no view");
        let right = match error {
            ViewError::Eye(eye) => !eye.is_finite(),
            ViewError::Orientation(_) => view.orientation != good().orientation,
            ViewError::FovX(_) => view.fov_x.to_bits() != good().fov_x.to_bits(),
            ViewError::Near(_) => view.near.to_bits() != good().near.to_bits(),
            _ => view.resolution != good().resolution,
        };
        assert!(right, "{error} for {view:?}");
        assert!(!error.to_string().is_empty());
    }
    for (width, height) in [(0, 0), (0, 9), (1, 1), (8192, 8192), (65_536, 1)] {
        assert_eq!(View { resolution: Resolution::new(width, height), ..good() }.check(), Ok(()));
    }
    assert_eq!(View { near: View::NEAR_MIN, fov_x: 1e-9, ..good() }.check(), Ok(()));
}

#[test]
fn a_view_that_is_none_gets_everything_and_hides_nothing() {
    let scene = Arc::new(made::building(2, 3, 1));
    let all: Vec<u32> = (0..scene.triangles().len() as u32).collect();
    let cullers = every::all(&scene);
    let mut scratch = Scratch::default();
    let far = Bound::Sphere { centre: DVec3::new(1.0, -500.0, 1.0), radius: 0.1 };
    for view in no_views() {
        for (name, culler) in &cullers {
            // Something legal before, so that an old image would speak.
            culler.cull(&good(), EyeRegion::point(good().eye), &mut scratch);
            assert!(name == "ZB" || scratch.occlusion().hides(&far), "{name}");
            for region in [EyeRegion::point(view.eye), EyeRegion::point(good().eye)] {
                let culled = culler.cull(&view, region, &mut scratch);
                assert_eq!(culled.visible, all, "{name} from {view:?}");
                assert!(!scratch.occlusion().hides(&far), "{name} from {view:?}");
            }
        }
        let (exact, items) = exact_set(&scene, &view);
        assert!(exact.is_empty() && items.ids().is_empty());
    }
}

#[test]
fn images_of_a_view_that_is_none_hide_nothing() {
    let scene = Arc::new(made::building(2, 3, 1));
    let cplp = Cplp::build(&scene, Default::default());
    let walker = MaskedCplp::build(scene.clone());
    let aabb = Aabb::around(DVec3::new(1.0, -500.0, 1.0), DVec3::ONE);
    for view in no_views() {
        let mut depth = DepthBuffer::new(&view);
        depth.draw(&scene, &[0, 1, 2]);
        assert!(!depth.hides(&Bound::Box(aabb)), "{view:?}");
        let mut items = ItemBuffer::new(&good());
        items.begin(&view);
        items.draw_all(&scene);
        assert!(items.winners().is_empty());
        for coverage in [Coverage::Sampled, Coverage::Under] {
            let mut masks = MaskedDepth::new(coverage);
            masks.begin(&view);
            masks.draw_polygon_f32(&scene.triangles()[0].corners, Sides::Both);
            assert!(masks.sees_box(&aabb) && masks.in_view(&aabb) && masks.sees_ball(DVec3::ZERO, 1.0));
            assert!(!masks.is_closed_before(1.0) && masks.farthest() == 0.0);
            let rectangle = Aabb::new(DVec3::new(0.0, 0.0, 1.0), DVec3::ONE);
            assert!(!masks.believes(&SealedFace { rectangle, face: Face::ALL[5], cracks: &[], skin: 0.01 }));
        }
        for kind in QueryKind::ALL {
            let mut back_end = kind.back_end();
            back_end.begin(&view);
            let mut seen = Vec::new();
            back_end.query_front(&[aabb, aabb], &mut seen);
            assert_eq!(seen, [true, true]);
            assert!(!back_end.is_full());
            let mut scratch = CplpScratch::default();
            cplp.traverse_rounds(&scene, &view, Budget::default(), &mut back_end, &mut scratch);
        }
        let mut scratch = MaskedCplpScratch::default();
        walker.walk(&view, &mut scratch);
        assert_eq!(scratch.visible().len(), scene.triangles().len(), "{view:?}");
    }
}

/// A plate 5 mm before a wall: depths that are wrong by as much as the orientation's length would put it behind.
#[test]
fn an_orientation_of_almost_unit_length_loses_nothing() {
    let square = |half: f32, z: f32| {
        let corner = |x: f32, y: f32| [x * half, y * half, z];
        let [a, b, c, d] = [corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)];
        [triangle([a, b, c]), triangle([a, c, d])]
    };
    let (wall, plate) = (square(30.0, -10.0), square(0.5, -9.995));
    let scene = Arc::new(Scene::from_triangles([wall, plate].concat()));
    let cullers = every::all(&scene);
    for length_squared in [0.9991_f64, 1.0, 1.0009] {
        let orientation = DQuat::from_rotation_y(0.1) * length_squared.sqrt();
        let view = View { orientation, ..View::level(DVec3::ZERO, 0.0, 1.4, Resolution::new(64, 48)) };
        assert_eq!(view.check(), Ok(()));
        let checked = check(&scene, &cullers, [view], &mut Scratch::default());
        assert_eq!(checked.exact, 4);
        let mut masks = MaskedDepth::new(Coverage::Sampled);
        masks.begin(&view);
        wall.iter().for_each(|triangle| masks.draw_polygon_f32(&triangle.corners, triangle.sides));
        assert!(masks.sees_box(&plate[0].aabb()), "{length_squared}");
        assert!(!masks.sees_box(&Aabb::around(DVec3::new(0.0, 0.0, -10.01), DVec3::new(0.5, 0.5, 5e-3))));
    }
}

#[test]
fn an_eye_region_that_is_none_gets_everything() {
    let scene = Arc::new(made::building(2, 3, 1));
    let mut scratch = Scratch::default();
    let eye = good().eye;
    for (name, culler) in cullers(&scene) {
        for radius in [f64::NAN, f64::INFINITY, -1.0] {
            let culled = culler.cull(&good(), EyeRegion { centre: eye, radius }, &mut scratch);
            assert_eq!(culled.visible.len(), scene.triangles().len(), "{name} for a radius of {radius}");
        }
        let nowhere = EyeRegion::point(DVec3::new(0.0, f64::NAN, 0.0));
        assert_eq!(culler.cull(&good(), nowhere, &mut scratch).visible.len(), scene.triangles().len(), "{name}");
    }
}

#[test]
fn triangles_that_are_not_finite_are_refused_by_name() {
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        let triangles = vec![triangle([[0.0; 3]; 3]), triangle([[0.0; 3], [1.0, bad, 0.0], [0.0; 3]])];
        let error = Scene::try_from_triangles(triangles).unwrap_err();
        assert!(matches!(error, SceneError::NotFinite { triangle: 1, .. }));
        assert!(error.to_string().contains("triangle 1"));
    }
}

#[test]
fn bounds_that_are_not_finite_are_not_hidden() {
    let scene = Arc::new(made::building(2, 3, 1));
    let mut scratch = Scratch::default();
    let nan = DVec3::new(f64::NAN, 0.0, 0.0);
    let bounds = [
        Bound::Everywhere,
        Bound::Box(Aabb::new(nan, nan)),
        Bound::Box(Aabb::new(DVec3::NEG_INFINITY, DVec3::INFINITY)),
        Bound::Sphere { centre: nan, radius: 1.0 },
        Bound::Sphere { centre: DVec3::ZERO, radius: f64::NAN },
        Bound::Sphere { centre: DVec3::ZERO, radius: f64::INFINITY },
        Bound::Upright { centre: nan, radius: 1.0, half_height: 1.0 },
    ];
    for (name, culler) in cullers(&scene) {
        culler.cull(&good(), EyeRegion::point(good().eye), &mut scratch);
        for bound in &bounds {
            assert!(!scratch.occlusion().hides(bound), "{name} hides {bound:?}");
        }
    }
}

/// Scenes that are hardly scenes.
fn poor_scenes() -> Vec<(&'static str, Vec<Triangle>)> {
    let one = triangle([[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]);
    let point = triangle([[1.0, 1.0, 1.0]; 3]);
    let segment = triangle([[-1.0, 0.5, 0.0], [1.0, 0.5, 0.0], [0.0, 0.5, 0.0]]);
    let sliver = triangle([[-1e3, 0.0, 0.0], [1e3, 0.0, 1e-3], [0.0, 1e-4, 0.0]]);
    let flat = |t: &Triangle| Triangle { corners: t.corners.map(|c| Vec3::new(c.x, 0.25, c.z)), ..*t };
    let on_axis = |t: &Triangle| Triangle { corners: t.corners.map(|c| Vec3::new(c.x, 0.0, 0.0)), ..*t };
    let times = |by: f32| made::soup(3, 100).triangles().iter().map(|t| scaled(t, by)).collect::<Vec<_>>();
    let glass = |t: &Triangle| Triangle { occludes: false, ..*t };
    let soup = made::soup(4, 200).triangles().to_vec();
    vec![
        ("empty", Vec::new()),
        ("one", vec![one]),
        ("a point", vec![point]),
        ("a segment", vec![segment]),
        ("all in one point", vec![point; 500]),
        ("all the same", vec![one; 500]),
        ("points, segments, slivers", [[point, segment], [sliver, one]].concat()),
        ("all in a plane", soup.iter().map(flat).collect()),
        ("all on a line", soup.iter().map(on_axis).collect()),
        ("all glass", soup.iter().map(glass).collect()),
        ("micrometres", times(1e-6)),
        ("thousand kilometres", times(1e5)),
        ("light years", times(1e16)),
        ("1e30 m", times(1e29)),
        ("denormal numbers", times(1e-40)),
    ]
}

fn scaled(t: &Triangle, by: f32) -> Triangle {
    Triangle { corners: t.corners.map(|corner| corner * by), ..*t }
}

#[test]
fn poor_scenes_are_culled_without_error_at_any_resolution_and_budget() {
    let mut rng = Pcg64::seed_from_u64(51);
    for (name, triangles) in poor_scenes() {
        eprintln!("{name}");
        let scene = Arc::new(Scene::from_triangles(triangles));
        let cullers = every::all(&scene);
        let (middle, size) = if scene.triangles().is_empty() {
            (DVec3::ZERO, 1.0)
        } else {
            (scene.bounds().centre(), scene.bounds().size().max_element().max(1e-3))
        };
        let resolutions = [(40, 40), (1, 1), (1, 8192), (8192, 1), (0, 0), (0, 7), (7, 0), (3, 100)];
        let views: Vec<View> = (0..48)
            .map(|i| {
                let offset = DVec3::from_array(std::array::from_fn(|_| rng.random_range(-1.0..1.0)));
                let reach = [1.0, 4.0, 0.0, 100.0][i / 8 % 4];
                let (width, height) = resolutions[i % 8];
                let eye = middle + offset * size * reach;
                made::any_view(&mut rng, eye, Resolution::new(width, height))
            })
            .collect();
        check(&scene, &cullers, views, &mut Scratch::default());
    }
}

#[test]
fn eyes_outside_far_away_and_at_the_end_of_numbers() {
    let mut rng = Pcg64::seed_from_u64(52);
    let scene = Arc::new(made::building(3, 6, 9));
    let cullers = every::all(&scene);
    let middle = scene.bounds().centre();
    let mut views = Vec::new();
    for distance in [8.0, 30.0, 1e3, 1e6, 1e9, 1e15, 1e100, 1e300] {
        for i in 0..8 {
            let towards = DVec3::from_array(std::array::from_fn(|_| rng.random_range(-1.0..1.0_f64))).normalize();
            let towards = if i % 4 == 0 { DVec3::X } else { towards };
            let eye = middle - towards * distance;
            let turn = DQuat::from_rotation_arc(DVec3::NEG_Z, towards);
            // From a million metres the building is a pixel or, through a long lens, an image.
            let fov_x = if i % 2 == 0 { 1.2 } else { (40.0 / distance).clamp(1e-9, 2.0) };
            let resolution = Resolution::new(64, 64);
            views.push(View { eye, orientation: turn.normalize(), fov_x, resolution, near: [0.01, 1e-6][i % 2] });
        }
    }
    let checked = check(&scene, &cullers, views, &mut Scratch::default());
    assert!(checked.exact > 200, "{}", checked.exact);
}

/// Units mistaken by powers of ten: from micrometres to light years, where depths are still whole f32s.
#[test]
fn buildings_of_any_scale_are_culled_without_error() {
    for scale in [1e-5, 1e-3, 1e5, 1e10, 1e15_f32] {
        let building = made::building(4, 8, 10);
        let scene = Arc::new(Scene::from_triangles(building.triangles().iter().map(|t| scaled(t, scale)).collect()));
        let cullers = every::all(&scene);
        let mut rng = Pcg64::seed_from_u64(53);
        let scale = f64::from(scale);
        let nears = [View::NEAR_MIN, (0.01 * scale).max(View::NEAR_MIN)];
        let views: Vec<View> = (0..30)
            .map(|i| (nears[i % 2], made::visitor(&mut rng, 4, Resolution::new(100, 64))))
            .map(|(near, view)| View { eye: view.eye * scale, near, ..view })
            .collect();
        let checked = check(&scene, &cullers, views, &mut Scratch::default());
        assert!(checked.exact > 100, "{scale}: {}", checked.exact);
    }
}
