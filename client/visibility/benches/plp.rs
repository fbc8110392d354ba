//! What does guessing cost beyond culling by the frustum? PLP that may draw all that is in view, beside the frustum alone (Klosowski &
//! Silva 2000, §1: "negligible overhead on top of view-frustum culling").
//!
//! Without a limit PLP draws the very triangles that view-frustum and back-face culling draw, in another order: that is checked before
//! a bench is timed, so the difference is its overhead at equal triangles. Frames are those of 16 visitors of 10 × 10 rooms at
//! 320 × 240, all of them in each iteration. `begin` is a frame that may draw nothing: what is left is what a frame takes before its first
//! cell, which must not grow with the number of cells.

#[path = "../tests/made/mod.rs"]
mod made;

use std::sync::Arc;

use divan::{Bencher, counter::ItemsCount};
use eyeline_visibility::{
    Culler, Delaunay, DelaunayRules, EyeRegion, FrustumBackface, Octree, OctreeRules, Plp, PlpCells, PlpCuller,
    PlpRules, PlpScratch, Resolution, Scene, Scratch, View,
};

const SIDE: u32 = 10;

fn main() {
    divan::main();
}

fn building() -> Arc<Scene> {
    Arc::new(made::building(SIDE, 20, 1))
}

fn views() -> Vec<View> {
    made::visitors(16, SIDE, Resolution::new(320, 240))
}

fn octree(scene: &Scene, leaf_side: f64) -> PlpCells {
    PlpCells::Boxes(Arc::new(Octree::build(scene, OctreeRules::paper().with_leaf_side(leaf_side))))
}

fn cells(scene: &Scene, kind: &str) -> PlpCells {
    match kind {
        "octree" => octree(scene, 0.05),
        _ => PlpCells::Tetrahedra(Arc::new(Delaunay::build(scene, DelaunayRules::default()).unwrap())),
    }
}

fn frames(bencher: Bencher, scene: &Arc<Scene>, culler: &dyn Culler, draws_more: bool) {
    let views = views();
    let mut scratch = Scratch::default();
    let cull = |culler: &dyn Culler, view: &View, scratch: &mut Scratch| {
        culler.cull(view, EyeRegion::point(view.eye), scratch).visible
    };
    let frustum = FrustumBackface::new(scene.clone());
    for view in &views {
        let (own, all) = (cull(culler, view, &mut scratch), cull(&frustum, view, &mut scratch));
        assert!(own == all || (draws_more && all.iter().all(|id| own.binary_search(id).is_ok())));
    }
    bencher
        .counter(ItemsCount::new(views.len()))
        .bench_local(|| views.iter().map(|view| cull(culler, view, &mut scratch).len()).sum::<usize>());
}

#[divan::bench]
fn frustum_backface(bencher: Bencher) {
    let scene = building();
    frames(bencher, &scene, &FrustumBackface::new(scene.clone()), false);
}

/// By the paper's rule. What holds no pixel centre is drawn too, which the frustum leaves out here.
#[divan::bench(args = ["octree", "delaunay"])]
fn paper(bencher: Bencher, kind: &str) {
    let scene = building();
    let plp = Arc::new(Plp::new(scene.clone(), cells(&scene, kind), PlpRules::paper()));
    frames(bencher, &scene, &PlpCuller::new(plp, usize::MAX), true);
}

/// By the default rule, which asks an image what is covered.
#[divan::bench(args = ["octree", "delaunay"])]
fn default_rule(bencher: Bencher, kind: &str) {
    let scene = building();
    let plp = Arc::new(Plp::new(scene.clone(), cells(&scene, kind), PlpRules::default()));
    frames(bencher, &scene, &PlpCuller::new(plp, usize::MAX), false);
}

/// Over octree leaves of this share of the scene's side.
#[divan::bench(args = [0.05, 0.0125, 0.006])]
fn begin(bencher: Bencher, leaf_side: f64) {
    let scene = building();
    let plp = Plp::new(scene.clone(), octree(&scene, leaf_side), PlpRules::paper());
    let (views, mut scratch) = (views(), PlpScratch::default());
    for view in &views {
        assert_eq!(plp.traverse(view, 0, &mut scratch).count(), 0);
        // Visitors stand in a cell, and that is all that was marked.
        assert_eq!(scratch.marked(), 1, "of {} cells", plp.cells().len());
    }
    bencher
        .counter(ItemsCount::new(views.len()))
        .bench_local(|| views.iter().map(|view| plp.traverse(view, 0, &mut scratch).count()).sum::<usize>());
}
