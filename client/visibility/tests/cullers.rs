//! Conservative cullers have no wrong pixel and report a superset of the exact set (DESIGN.md §3, promise 1).

mod every;
mod made;

use std::sync::Arc;

use eyeline_visibility::{
    Aabb, Bound, CplpCuller, Culler, EyeRegion, ItemBuffer, Octree, OctreeRules, RayScene, Resolution, Scene, Scratch,
    Sides, Tessellation, Triangle, View, exact_set, pixel_ray,
};
use glam::{DVec3, Vec3};
use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

/// Panics unless each culler shows the plain Z-buffer's picture of each view.
fn check(scene: &Arc<Scene>, views: impl IntoIterator<Item = View>) {
    let cullers = every::all(scene);
    every::check(scene, &cullers, views, &mut Scratch::default());
}

#[test]
fn soups_are_culled_without_error() {
    let mut rng = Pcg64::seed_from_u64(11);
    for seed in 0..12 {
        let scene = Arc::new(made::soup(seed, 60 * (seed as usize + 1)));
        let views: Vec<View> = (0..25)
            .map(|i| {
                let reach = if i % 3 == 0 { 30.0 } else { 6.0 };
                let eye = DVec3::from_array(std::array::from_fn(|_| rng.random_range(-reach..reach)));
                made::any_view(&mut rng, eye, Resolution::new(64, 64))
            })
            .collect();
        check(&scene, views);
    }
}

#[test]
fn buildings_are_culled_without_error() {
    let mut rng = Pcg64::seed_from_u64(12);
    let scene = Arc::new(made::building(5, 8, 1));
    assert_eq!(every::in_prisms(&scene).len(), 6);
    check(&scene, (0..200).map(|_| made::visitor(&mut rng, 5, Resolution::new(64, 64))));
    check(&scene, (0..15).map(|_| made::visitor(&mut rng, 5, Resolution::new(320, 240))));
}

#[test]
fn eyes_on_vertices_in_walls_on_cell_faces_and_far_outside_do_no_harm() {
    let mut rng = Pcg64::seed_from_u64(13);
    let scene = Arc::new(made::building(4, 4, 2));
    let octree = Octree::build(&scene, OctreeRules::default());
    let mut views = Vec::new();
    for i in 0..150 {
        let triangle = scene.triangles()[rng.random_range(0..scene.triangles().len())];
        let cell = octree.cell(rng.random_range(0..octree.cell_count() as u32));
        let eye = match i % 6 {
            0 => triangle.corners[0].as_dvec3(),
            1 => triangle.corners.map(|corner| corner.as_dvec3()).into_iter().sum::<DVec3>() / 3.0,
            2 => cell.corners()[rng.random_range(0..8)],
            3 => DVec3::new(cell.min.x, cell.centre().y, cell.centre().z),
            4 => octree.root().corners()[rng.random_range(0..8)],
            _ => DVec3::from_array(std::array::from_fn(|_| rng.random_range(-80.0..100.0))),
        };
        let resolution =
            [Resolution::new(64, 64), Resolution::new(1, 1), Resolution::new(1, 512), Resolution::new(97, 13)]
                [rng.random_range(0..4)];
        // Along an axis rays run inside cell faces.
        let view = made::any_view(&mut rng, eye, resolution);
        views.push(if i % 4 == 0 { View::level(eye, 0.0, view.fov_x, resolution) } else { view });
    }
    check(&scene, views);
}

#[test]
fn walls_in_cell_faces_and_eyes_at_cell_corners_are_culled_without_error() {
    // A lattice of quads at whole coordinates under a root that is split at whole coordinates.
    let mut triangles = Vec::new();
    for i in -4..=4 {
        for j in -4..4 {
            let at = Vec3::new(i as f32, j as f32, ((i * 7 + j * 3) % 4) as f32);
            triangles.push(Triangle { corners: [at, at + Vec3::Y, at + Vec3::Z], sides: Sides::Both, occludes: true });
            triangles.push(Triangle { corners: [at, at + Vec3::Y, at - Vec3::X], sides: Sides::Both, occludes: true });
        }
    }
    made::add_box(&mut triangles, Vec3::splat(-4.0), Vec3::splat(4.0), Sides::Both, true);
    let scene = Arc::new(Scene::from_triangles(triangles));
    let mut views = Vec::new();
    for x in -2..=2 {
        for z in -2..=2 {
            for yaw in 0..4 {
                let eye = DVec3::new(f64::from(x), 0.0, f64::from(z));
                let yaw = f64::from(yaw) * std::f64::consts::FRAC_PI_4;
                views.push(View::level(eye, yaw, 1.5, Resolution::new(65, 65)));
            }
        }
    }
    check(&scene, views);
}

#[test]
fn poor_scenes_are_culled_without_error() {
    let mut rng = Pcg64::seed_from_u64(14);
    let [one, point, kilometre, sliver, millimetre] = made::poor();
    let far = |t: &Triangle| Triangle { corners: t.corners.map(|c| c + Vec3::splat(1e6)), ..*t };
    for triangles in [
        Vec::new(),
        vec![one],
        vec![point],
        vec![one; 300],
        vec![kilometre, sliver, millimetre, one, point],
        made::soup(5, 200).triangles().iter().map(far).collect(),
    ] {
        let scene = Arc::new(Scene::from_triangles(triangles));
        let middle = if scene.triangles().is_empty() { DVec3::ZERO } else { scene.bounds().centre() };
        let middle = if middle.length() < 1e5 { DVec3::ZERO } else { middle };
        let views: Vec<View> = (0..40)
            .map(|_| {
                let eye = middle + DVec3::from_array(std::array::from_fn(|_| rng.random_range(-4.0..4.0)));
                made::any_view(&mut rng, eye, Resolution::new(48, 48))
            })
            .collect();
        check(&scene, views);
    }
}

#[test]
fn cplp_draws_a_small_part_of_a_building() {
    let mut rng = Pcg64::seed_from_u64(15);
    let scene = Arc::new(made::building(10, 10, 3));
    let culler = CplpCuller::build(scene.clone());
    let mut scratch = Scratch::default();
    let mut drawn = 0;
    for _ in 0..50 {
        let view = made::visitor(&mut rng, 10, Resolution::new(320, 240));
        drawn += culler.cull(&view, EyeRegion::point(view.eye), &mut scratch).visible.len();
    }
    assert!(drawn / 50 < scene.triangles().len() / 5, "{} of {}", drawn / 50, scene.triangles().len());
}

#[test]
fn an_object_that_is_hidden_owns_no_pixel() {
    let mut rng = Pcg64::seed_from_u64(16);
    let scene = Arc::new(made::building(5, 5, 4));
    let mut scratch = Scratch::default();
    let culler = CplpCuller::build(scene.clone());
    let (mut hidden, mut shown) = (0, 0);
    for _ in 0..30 {
        let view = made::visitor(&mut rng, 5, Resolution::new(160, 120));
        culler.cull(&view, EyeRegion::point(view.eye), &mut scratch);
        let (_, items) = exact_set(&scene, &view);
        for _ in 0..30 {
            let mut along = || rng.random_range(-2.0..27.0);
            let object = Aabb::around(DVec3::new(along(), 1.0, along()), DVec3::new(0.3, 0.9, 0.3));
            let mut triangles = Vec::new();
            made::add_box(&mut triangles, object.min.as_vec3(), object.max.as_vec3(), Sides::Both, true);
            let bound = Bound::Box(triangles.iter().fold(Aabb::EMPTY, |aabb, t| aabb.union(&t.aabb())));
            let mut with: ItemBuffer = items.clone();
            let id = scene.triangles().len() as u32;
            triangles.iter().for_each(|t| with.draw_triangle(id, t, DVec3::ZERO));
            if scratch.occlusion().hides(&bound) {
                hidden += 1;
                assert!(!with.ids().contains(&id));
            } else {
                shown += 1;
            }
        }
        assert!(!scratch.occlusion().hides(&Bound::Everywhere));
    }
    assert!(hidden > 300 && shown > 10, "{hidden} hidden, {shown} shown");
}

#[test]
fn the_item_buffer_shows_what_rays_hit() {
    let mut rng = Pcg64::seed_from_u64(17);
    let scene = made::building(4, 10, 6);
    let rays = RayScene::new(&scene);
    let (mut pixels, mut different) = (0, 0);
    for _ in 0..30 {
        let view = made::visitor(&mut rng, 4, Resolution::new(64, 48));
        let (_, items) = exact_set(&scene, &view);
        for y in 0..48 {
            for x in 0..64 {
                let hit = rays.first_hit(view.eye, pixel_ray(&view, x, y), view.near, f64::INFINITY);
                pixels += 1;
                different += u32::from(hit.map(|hit| hit.primitive) != items.id_at(x, y));
            }
        }
    }
    // Snapping to 1/256 px moves edges across the centres of a few pixels, and coplanar faces tie only up to rounding.
    assert!(different * 500 < pixels, "{different} of {pixels}");
}

#[test]
fn a_region_that_is_not_the_eye_gets_everything() {
    let scene = Arc::new(made::building(2, 2, 5));
    let view = View::level(DVec3::new(2.0, 1.6, 2.0), 0.0, 1.0, Resolution::new(64, 64));
    let region = EyeRegion { centre: view.eye, radius: 0.1 };
    let mut scratch = Scratch::default();
    for (name, culler) in every::all(&scene).into_iter().filter(|(name, _)| !every::answers_for_balls(name)) {
        assert_eq!(culler.cull(&view, region, &mut scratch).visible.len(), scene.triangles().len(), "{name}");
        assert!(!scratch.occlusion().hides(&Bound::Sphere { centre: DVec3::splat(500.0), radius: 1.0 }));
    }
}

fn any_triangle() -> impl Strategy<Value = Triangle> {
    // Whole coordinates as often as any: shared edges, coplanar and degenerate triangles, eyes on them.
    let coordinate = prop_oneof![(-4..=4_i32).prop_map(|c| c as f32), -4.0..4.0_f32];
    (proptest::array::uniform9(coordinate), any::<bool>(), proptest::bool::weighted(0.8)).prop_map(
        |(c, both, occludes)| Triangle {
            corners: [Vec3::new(c[0], c[1], c[2]), Vec3::new(c[3], c[4], c[5]), Vec3::new(c[6], c[7], c[8])],
            sides: if both { Sides::Both } else { Sides::Front },
            occludes,
        },
    )
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn any_soup_is_culled_without_error(
        triangles in prop::collection::vec(any_triangle(), 0..60),
        eye in proptest::array::uniform3(prop_oneof![(-5..=5_i32).prop_map(f64::from), -5.0..5.0_f64]),
        seed in any::<u64>(),
    ) {
        let scene = Arc::new(Scene::from_triangles(triangles));
        let mut rng = Pcg64::seed_from_u64(seed);
        check(&scene, [made::any_view(&mut rng, DVec3::from_array(eye), Resolution::new(40, 30))]);
    }
}
