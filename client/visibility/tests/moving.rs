//! Moving things among static ones: what the image that speaks for a cull says of their bounds, and what they hide in turn once
//! they are drawn into it (DESIGN.md §4).

mod every;
mod made;

use std::sync::Arc;

use eyeline_visibility::{
    Aabb, Bound, Culler, EyeRegion, HierarchicalZ, ItemBuffer, Resolution, Scene, Scratch, Sides, Triangle, View,
    exact_set,
};
use glam::{DVec3, Vec3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

fn block(min: [f32; 3], max: [f32; 3], occludes: bool) -> Vec<Triangle> {
    let mut triangles = Vec::new();
    made::add_box(&mut triangles, min.into(), max.into(), Sides::Both, occludes);
    triangles
}

/// A floor, and an eye above it that looks along −Z.
fn field() -> (Arc<Scene>, View) {
    let scene = Arc::new(Scene::from_triangles(block([-50.0, -0.2, -50.0], [50.0, 0.0, 50.0], true)));
    (scene, View::level(DVec3::new(0.0, 1.6, 0.0), 0.0, 1.4, Resolution::new(160, 120)))
}

#[test]
fn a_moving_screen_hides_what_is_behind_it_until_the_next_cull() {
    let (scene, view) = field();
    let screen = block([-2.0, 0.1, -4.2], [2.0, 3.0, -4.0], true);
    let sphere = |x: f64, z: f64| Bound::Sphere { centre: DVec3::new(x, 1.5, z), radius: 0.3 };
    let upright = |z: f64| Bound::Upright { centre: DVec3::new(0.0, 1.2, z), radius: 0.3, half_height: 0.8 };
    let cube = |z: f64| Bound::Box(Aabb::around(DVec3::new(0.5, 1.2, z), DVec3::splat(0.3)));
    let behind = [sphere(0.0, -6.0), upright(-5.5), cube(-7.0)];
    let around_it = block([-2.5, 0.1, -4.5], [2.5, 3.0, -3.5], true);
    let own = Bound::Box(around_it.iter().fold(Aabb::EMPTY, |all, triangle| all.union(&triangle.aabb())));
    let seen = [sphere(0.0, -2.0), upright(-3.0), cube(-3.2), sphere(4.5, -6.0), own, Bound::Everywhere];
    for (name, culler) in every::all(&scene) {
        let mut scratch = Scratch::default();
        assert!(!scratch.draw_moving(&screen), "nothing speaks yet");
        let hides = |scratch: &Scratch, bounds: &[Bound]| {
            bounds.iter().map(|bound| scratch.occlusion().hides(bound)).collect::<Vec<bool>>()
        };
        culler.cull(&view, EyeRegion::point(view.eye), &mut scratch);
        assert_eq!(hides(&scratch, &behind), [false; 3], "{name}: a field hides nothing above it");

        let glass = block([-2.0, 0.1, -4.2], [2.0, 3.0, -4.0], false);
        let nowhere = [Triangle { corners: [Vec3::NAN, Vec3::X, Vec3::INFINITY], ..screen[0] }];
        assert_eq!(scratch.draw_moving(&glass), scratch.draw_moving(&nowhere));
        assert_eq!(hides(&scratch, &behind), [false; 3], "{name}: nor does glass");

        let drawn = scratch.draw_moving(&screen);
        assert_eq!(drawn, every::has_an_image(&name), "{name}");
        assert_eq!(hides(&scratch, &behind), [drawn; 3], "{name}");
        assert_eq!(hides(&scratch, &seen), [false; 6], "{name}: what is before or beside it, or its own bound");

        culler.cull(&view, EyeRegion::point(view.eye), &mut scratch);
        assert_eq!(hides(&scratch, &behind), [false; 3], "{name}: another frame");
        culler.cull(&view, EyeRegion { centre: view.eye, radius: 0.2 }, &mut scratch);
        assert!(!scratch.draw_moving(&screen), "{name}: a region");
    }
}

/// A bound around a block.
fn bound(rng: &mut Pcg64, aabb: &Aabb) -> Bound {
    let (centre, half) = (aabb.centre(), aabb.size() * 0.5);
    match rng.random_range(0..3) {
        0 => Bound::Box(*aabb),
        1 => Bound::Sphere { centre, radius: half.length() * 1.000_001 },
        _ => Bound::Upright { centre, radius: half.x.hypot(half.z) * 1.000_001, half_height: half.y * 1.000_001 },
    }
}

#[test]
fn no_bound_is_hidden_that_has_a_pixel_behind_walls_or_behind_what_moves() {
    let mut rng = Pcg64::seed_from_u64(41);
    let scene = Arc::new(made::building(4, 4, 8));
    let cullers = every::all(&scene);
    let mut scratch = Scratch::default();
    let (mut hidden, mut shown, mut hidden_by_moving) = (0, 0, 0);
    for _ in 0..12 {
        let view = made::visitor(&mut rng, 4, Resolution::new(120, 90));
        let any = |rng: &mut Pcg64| {
            let mut within = |from: f32, to: f32| rng.random_range(from..to);
            let at = Vec3::new(within(-1.0, 21.0), within(0.0, 1.0), within(-1.0, 21.0));
            let size = Vec3::new(within(0.2, 1.5), within(0.2, 2.0), within(0.2, 1.5));
            block(at.to_array(), (at + size).to_array(), true)
        };
        let movers: Vec<Triangle> = (0..6).flat_map(|_| any(&mut rng)).collect();
        let (_, mut picture) = exact_set(&scene, &view);
        let first_mover = scene.triangles().len() as u32;
        movers.iter().for_each(|triangle| picture.draw_triangle(first_mover, triangle, DVec3::ZERO));
        let objects: Vec<(Bound, ItemBuffer)> = (0..12)
            .map(|_| {
                let triangles = any(&mut rng);
                let mut with = picture.clone();
                triangles.iter().for_each(|triangle| with.draw_triangle(first_mover + 1, triangle, DVec3::ZERO));
                let aabb = triangles.iter().fold(Aabb::EMPTY, |all, triangle| all.union(&triangle.aabb()));
                (bound(&mut rng, &aabb), with)
            })
            .collect();
        for (name, culler) in cullers.iter().filter(|(name, _)| every::has_an_image(name)) {
            culler.cull(&view, EyeRegion::point(view.eye), &mut scratch);
            let before: Vec<bool> = objects.iter().map(|(bound, _)| scratch.occlusion().hides(bound)).collect();
            assert!(scratch.draw_moving(&movers), "{name}");
            for ((bound, with), before) in objects.iter().zip(before) {
                let hides = scratch.occlusion().hides(bound);
                assert!(hides || !before, "{name}: drawing more hides no less");
                assert!(!hides || !with.ids().contains(&(first_mover + 1)), "{name} hides {bound:?} from {view:?}");
                hidden += usize::from(hides);
                shown += usize::from(!hides);
                hidden_by_moving += usize::from(hides && !before);
            }
        }
    }
    assert!(hidden > 500 && shown > 50 && hidden_by_moving > 20, "{hidden} {shown} {hidden_by_moving}");
}

#[test]
fn a_crowd_behind_one_of_them_is_hidden_by_the_pyramid() {
    let (scene, view) = field();
    let mut scratch = Scratch::default();
    HierarchicalZ::build(scene).cull(&view, EyeRegion::point(view.eye), &mut scratch);
    let person = |x: f64, z: f64| Bound::Upright { centre: DVec3::new(x, 0.95, z), radius: 0.25, half_height: 0.85 };
    let crowd: Vec<Bound> =
        (0..100).map(|i| person(0.08 * f64::from(i % 10) - 0.4, -3.0 - f64::from(i / 10))).collect();
    let hidden = |scratch: &Scratch| crowd.iter().filter(|bound| scratch.occlusion().hides(bound)).count();
    assert_eq!(hidden(&scratch), 0);
    // A lorry drives past.
    assert!(scratch.draw_moving(&block([-3.0, 0.0, -2.5], [3.0, 3.2, -2.3], true)));
    assert_eq!(hidden(&scratch), 100);
}

#[test]
fn a_bound_that_is_not_finite_is_never_hidden() {
    let (scene, view) = field();
    // Everything is behind this one.
    let screen = block([-9.0, -9.0, -1.2], [9.0, 9.0, -1.0], true);
    let far = DVec3::new(0.0, 1.0, -5.0);
    let cube = |min, max| Bound::Box(Aabb::new(min, max));
    let bounds = [
        Bound::Sphere { centre: DVec3::NAN, radius: 1.0 },
        Bound::Sphere { centre: far.with_y(f64::NAN), radius: 0.1 },
        Bound::Sphere { centre: far, radius: f64::NAN },
        Bound::Sphere { centre: far, radius: f64::INFINITY },
        Bound::Sphere { centre: DVec3::X * f64::NEG_INFINITY, radius: 1.0 },
        Bound::Upright { centre: far, radius: f64::NAN, half_height: 0.1 },
        Bound::Upright { centre: far, radius: 0.1, half_height: f64::INFINITY },
        cube(DVec3::NEG_INFINITY, DVec3::INFINITY),
        cube(far, far.with_x(f64::INFINITY)),
        cube(far, far.with_z(f64::NAN)),
        Bound::Everywhere,
    ];
    for (name, culler) in every::all(&scene) {
        let mut scratch = Scratch::default();
        culler.cull(&view, EyeRegion::point(view.eye), &mut scratch);
        scratch.draw_moving(&screen);
        for bound in &bounds {
            assert!(!scratch.occlusion().hides(bound), "{name}: {bound:?}");
        }
    }
}
