//! Query back ends of cPLP: one query of a front of boxes, and a whole culled frame of a made building, per back end.
//!
//! The front is made of boxes of a grid behind a wall with holes, some of them seen, at 512 × 512. Frames are those of 16
//! visitors of 10 × 10 rooms at 320 × 240, all of them in each iteration, so that the fastest sample is no easy view; every
//! culler's picture is first checked against the plain Z-buffer's.

#[path = "../tests/made/mod.rs"]
mod made;

use std::sync::Arc;

use divan::{Bencher, counter::ItemsCount};
use eyeline_visibility::{
    Aabb, Budget, Cplp, CplpCuller, CplpQueryCuller, Culler, EyeRegion, HierarchicalZ, OctreeRules, QueryBackEnd,
    QueryFrontToBack, QueryKind, Resolution, Scene, Scratch, Sides, Triangle, View, exact_set, wrong_pixels,
};
use glam::{DVec3, Vec3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

fn main() {
    divan::main();
}

/// Panels with gaps between them across the view.
fn panels() -> Scene {
    let mut rng = Pcg64::seed_from_u64(1);
    let mut triangles: Vec<Triangle> = Vec::new();
    for _ in 0..200 {
        let mut within = |reach: f32| rng.random_range(-reach..reach);
        let at = Vec3::new(within(5.0), within(5.0), -5.0 + within(1.0));
        made::add_box(&mut triangles, at - Vec3::splat(0.4), at + Vec3::splat(0.4), Sides::Both, true);
    }
    Scene::from_triangles(triangles)
}

/// Boxes that touch each other in four layers behind the panels.
fn front(count: usize) -> Vec<Aabb> {
    let side = ((count / 4) as f64).sqrt() as usize;
    let size = 20.0 / side as f64;
    let mut boxes = Vec::new();
    for layer in 0..4 {
        for i in 0..side * side {
            let at = DVec3::new((i % side) as f64, (i / side) as f64, 0.0) * size - DVec3::new(10.0, 10.0, 10.0);
            let min = at - DVec3::Z * f64::from(layer) * size;
            boxes.push(Aabb::new(min - DVec3::Z * size, min + DVec3::new(size, size, 0.0)));
        }
    }
    boxes
}

fn query(bencher: Bencher, kind: QueryKind, count: usize) {
    let (scene, boxes) = (panels(), front(count));
    assert_eq!(boxes.len(), count);
    let view = View::level(DVec3::ZERO, 0.0, 1.4, Resolution::new(512, 512));
    let all: Vec<u32> = (0..scene.triangles().len() as u32).collect();
    let answers = |kind: QueryKind| {
        let mut back_end = kind.back_end();
        back_end.begin(&view);
        back_end.draw(&scene, &all);
        let mut seen = Vec::new();
        back_end.query(&boxes, &mut seen);
        (back_end, seen)
    };
    let (mut back_end, mut seen) = answers(kind);
    assert_eq!(seen, answers(QueryKind::OneAtATime).1);
    bencher.counter(ItemsCount::new(count)).bench_local(|| back_end.query(&boxes, &mut seen));
}

fn frame(bencher: Bencher, make: impl FnOnce(&Arc<Scene>) -> Box<dyn Culler>) {
    let scene = Arc::new(made::building(10, 20, 1));
    let culler = make(&scene);
    let mut rng = Pcg64::seed_from_u64(2);
    let views: Vec<View> = (0..16).map(|_| made::visitor(&mut rng, 10, Resolution::new(320, 240))).collect();
    let mut scratch = Scratch::default();
    for view in &views[..4] {
        let visible = culler.cull(view, EyeRegion::point(view.eye), &mut scratch).visible;
        assert_eq!(wrong_pixels(&scene, view, &visible, &exact_set(&scene, view).1), 0);
    }
    bencher.counter(ItemsCount::new(views.len())).bench_local(|| {
        views.iter().map(|v| culler.cull(v, EyeRegion::point(v.eye), &mut scratch).visible.len()).sum::<usize>()
    });
}

fn query_frame(bencher: Bencher, kind: QueryKind, triangles: usize) {
    frame(bencher, |scene| {
        let cplp = Arc::new(Cplp::build(scene, OctreeRules::default()));
        Box::new(CplpQueryCuller::new(scene.clone(), cplp, Budget { triangles }, kind))
    });
}

const COUNTS: [usize; 2] = [64, 1024];
const BUDGETS: [usize; 3] = [100, 500, 2000];

#[divan::bench(args = COUNTS)]
fn item_buffer_query(bencher: Bencher, count: usize) {
    query(bencher, QueryKind::ItemBuffer, count);
}

#[divan::bench(args = COUNTS)]
fn item_buffer_tiled_query(bencher: Bencher, count: usize) {
    query(bencher, QueryKind::ItemBufferTiled, count);
}

#[divan::bench(args = COUNTS)]
fn histogram_query(bencher: Bencher, count: usize) {
    query(bencher, QueryKind::Histogram, count);
}

#[divan::bench(args = COUNTS)]
fn one_at_a_time_query(bencher: Bencher, count: usize) {
    query(bencher, QueryKind::OneAtATime, count);
}

#[divan::bench(args = COUNTS)]
fn per_fragment_histogram_query(bencher: Bencher, count: usize) {
    query(bencher, QueryKind::PerFragmentHistogram, count);
}

#[divan::bench(args = BUDGETS)]
fn item_buffer_frame(bencher: Bencher, triangles: usize) {
    query_frame(bencher, QueryKind::ItemBuffer, triangles);
}

#[divan::bench(args = BUDGETS)]
fn item_buffer_tiled_frame(bencher: Bencher, triangles: usize) {
    query_frame(bencher, QueryKind::ItemBufferTiled, triangles);
}

#[divan::bench(args = BUDGETS)]
fn histogram_frame(bencher: Bencher, triangles: usize) {
    query_frame(bencher, QueryKind::Histogram, triangles);
}

#[divan::bench(args = BUDGETS)]
fn one_at_a_time_frame(bencher: Bencher, triangles: usize) {
    query_frame(bencher, QueryKind::OneAtATime, triangles);
}

#[divan::bench(args = BUDGETS)]
fn per_fragment_histogram_frame(bencher: Bencher, triangles: usize) {
    query_frame(bencher, QueryKind::PerFragmentHistogram, triangles);
}

#[divan::bench]
fn front_to_back_frame(bencher: Bencher) {
    frame(bencher, |scene| Box::new(QueryFrontToBack::build(scene.clone())));
}

#[divan::bench]
fn hierarchical_z_frame(bencher: Bencher) {
    frame(bencher, |scene| Box::new(HierarchicalZ::build(scene.clone())));
}

/// The traversal that asks a depth buffer about one rectangle at a time.
#[divan::bench]
fn cplp_frame(bencher: Bencher) {
    frame(bencher, |scene| Box::new(CplpCuller::build(scene.clone())));
}
