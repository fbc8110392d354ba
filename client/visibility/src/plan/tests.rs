use glam::{DVec3, Vec3};

use super::planned::{CHECK, PROBE};
use super::*;
use crate::{Culler, EyeRegion, Sides, Triangle, exact_set, wrong_pixels};

/// A rectangle across the z axis, of `cells` × `cells` squares.
fn sheet(triangles: &mut Vec<Triangle>, z: f32, half: f32, cells: u32) {
    let at = |i: u32| -half + 2.0 * half * i as f32 / cells as f32;
    for i in 0..cells {
        for j in 0..cells {
            let corner = |di: u32, dj: u32| Vec3::new(at(i + di), at(j + dj), z);
            for corners in [[(0, 0), (1, 0), (1, 1)], [(0, 0), (1, 1), (0, 1)]] {
                let corners = corners.map(|(di, dj)| corner(di, dj));
                triangles.push(Triangle { corners, sides: Sides::Both, occludes: true });
            }
        }
    }
}

/// Behind the eye, 2,048 triangles one behind the other that hide nothing of each other; before it a wall with as many behind it.
fn two_sides() -> Arc<Scene> {
    let mut triangles = Vec::new();
    sheet(&mut triangles, -5.0, 20.0, 2);
    (0..4).for_each(|i| sheet(&mut triangles, -10.0 - i as f32, 3.0, 16));
    sheet(&mut triangles, 10.0, 3.0, 32);
    Arc::new(Scene::from_triangles(triangles))
}

fn view(yaw_turns: f64) -> View {
    View::level(DVec3::ZERO, yaw_turns * std::f64::consts::TAU, 1.2, Resolution::new(96, 64))
}

#[test]
fn what_is_hidden_and_what_is_out_of_view_is_counted() {
    let scene = two_sides();
    let total = scene.triangles().len() as u64;
    let wall = SceneCounts::of(scene.clone(), &[view(0.0)]).counts;
    assert_eq!(wall.total, total);
    assert!(wall.in_view < total / 2 + 200 && wall.hidden > 1_500, "{wall:?}");
    assert_eq!(wall.drawing(), Drawing::Occlusion);
    let open = SceneCounts::of(scene.clone(), &[view(0.5)]).counts;
    assert_eq!((open.hidden, open.drawing()), (0, Drawing::Frustum), "{open:?}");
    // Both together: the sum decides.
    let both = SceneCounts::of(scene.clone(), &[view(0.0), view(0.5)]).counts;
    assert_eq!(both.in_view, wall.in_view + open.in_view);
    // A handful is drawn as it is, and what is no view counts for nothing.
    let few = Arc::new(Scene::from_triangles(scene.triangles()[..100].to_vec()));
    assert_eq!(SceneCounts::of(few, &[view(0.0)]).counts.drawing(), Drawing::Everything);
    let nan = View { eye: DVec3::NAN, ..view(0.0) };
    let none = View { resolution: Resolution::new(0, 5), ..view(0.0) };
    assert_eq!(SceneCounts::of(scene, &[nan, none]).counts, ViewCounts::default());
    assert_eq!(ViewCounts::default().drawing(), Drawing::Everything);
    let empty = Arc::new(Scene::from_triangles(Vec::new()));
    assert_eq!(SceneCounts::around(empty, DVec3::ZERO).counts.drawing(), Drawing::Everything);
}

#[test]
fn every_way_to_draw_makes_the_same_picture() {
    let scene = two_sides();
    for forced in [[Some(false), Some(false)], [Some(true), Some(false)], [Some(false), Some(true)], [None, None]] {
        let rules = PlannedRules { frustum: forced[0], occlusion: forced[1] };
        let mut planned = Planned::new(SceneCounts::around(scene.clone(), DVec3::ZERO), rules);
        for turns in [0.0, 0.2, 0.5, 0.9] {
            let view = view(turns);
            let culled = planned.look(&view, EyeRegion::point(view.eye));
            let (_, exact) = exact_set(&scene, &view);
            assert_eq!(wrong_pixels(&scene, &view, &culled.visible, &exact), 0, "{forced:?} {turns}");
        }
        let nowhere = View { eye: DVec3::NAN, ..view(0.0) };
        assert_eq!(planned.look(&nowhere, EyeRegion::point(nowhere.eye)).visible.len(), scene.triangles().len());
    }
}

#[test]
fn frustum_culling_leaves_out_what_no_pixel_sees() {
    let scene = two_sides();
    let frustum = Frustum::new(scene.clone());
    for turns in [0.0, 0.3, 0.5] {
        let view = view(turns);
        let culled = frustum.cull(&view, EyeRegion::point(view.eye), &mut crate::Scratch::default());
        let (exact, _) = exact_set(&scene, &view);
        assert!(exact.iter().all(|id| culled.visible.binary_search(id).is_ok()));
        assert!(culled.visible.len() < scene.triangles().len());
        assert!(culled.visible.is_sorted());
    }
}

#[test]
fn until_the_occlusion_culler_is_there_views_are_drawn_by_the_frustum() {
    let scene = two_sides();
    let counts = SceneCounts::of(scene.clone(), &[view(0.0)]);
    let mut asked = 0;
    // It is there when it is asked for the third time.
    let mut planned = Planned::new(counts, PlannedRules::default()).with_occlusion_when(move |scene| {
        asked += 1;
        (asked >= 3).then(|| Arc::new(crate::MaskedCplp::build(scene.clone())) as Arc<dyn Culler + Send + Sync>)
    });
    let (_, exact) = exact_set(&scene, &view(0.0));
    let mut look = || {
        let culled = planned.look(&view(0.0), EyeRegion::point(DVec3::ZERO));
        assert_eq!(wrong_pixels(&scene, &view(0.0), &culled.visible, &exact), 0);
        (culled.visible.len(), planned.stats().views)
    };
    let (waiting, _) = look();
    assert_eq!(look(), (waiting, [0, 2, 0]));
    let (there, views) = look();
    assert!(there < waiting && views == [0, 2, 1], "{there} {waiting} {views:?}");
    assert_eq!(planned.drawing(), Drawing::Occlusion);
}

#[test]
fn a_plan_is_revised_after_several_counts_and_not_by_a_glance() {
    let scene = two_sides();
    let counted = |turns| SceneCounts::of(scene.clone(), &[view(turns)]);
    let mut planned = Planned::new(counted(0.5), PlannedRules::default());
    let look = |planned: &mut Planned, turns: f64, views: u64| {
        (0..views).for_each(|_| drop(planned.look(&view(turns), EyeRegion::point(DVec3::ZERO))));
        planned.drawing()
    };
    assert_eq!(planned.drawing(), Drawing::Frustum);
    // The first count that speaks for occlusion changes nothing yet, nor does one between others.
    assert_eq!(look(&mut planned, 0.0, PROBE), Drawing::Frustum);
    assert_eq!(look(&mut planned, 0.5, PROBE), Drawing::Frustum);
    assert_eq!(look(&mut planned, 0.0, PROBE), Drawing::Frustum);
    assert_eq!(look(&mut planned, 0.0, PROBE), Drawing::Occlusion);
    assert_eq!(planned.stats().turns, 1);
    // Three glances away are not four.
    assert_eq!(look(&mut planned, 0.5, 3 * CHECK), Drawing::Occlusion);
    assert_eq!(look(&mut planned, 0.0, CHECK), Drawing::Occlusion);
    assert_eq!(look(&mut planned, 0.5, 4 * CHECK), Drawing::Frustum);
    assert_eq!(planned.stats().turns, 2);
    assert_eq!(planned.stats().probes, 4 + 8);
    // What is forced stays.
    let forced = PlannedRules { occlusion: Some(true), frustum: Some(true) };
    let mut planned = Planned::new(counted(0.5), forced);
    assert_eq!(look(&mut planned, 0.5, 8 * CHECK), Drawing::Occlusion);
    assert_eq!(planned.stats().probes, 0);
}
