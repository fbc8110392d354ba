//! A whole frame of a made building of 10 × 10 rooms at 320 × 240: cull, then draw the item buffer in id order.
//!
//! Each iteration takes the next of 64 visitors' views. Every culler's picture is first checked against the plain Z-buffer's.

#[path = "../tests/made/mod.rs"]
mod made;

use std::sync::Arc;

use divan::{Bencher, counter::ItemsCount};
use eyeline_visibility::{
    CplpCuller, Culler, DepthBuffer, EyeRegion, FrustumBackface, ItemBuffer, Resolution, Scene, Scratch, Sides,
    Triangle, View, ZBuffer, exact_set, wrong_pixels,
};
use glam::{DVec3, Vec3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

const SIDE: u32 = 10;
const RESOLUTION: Resolution = Resolution::new(320, 240);

fn main() {
    divan::main();
}

fn building() -> Arc<Scene> {
    Arc::new(made::building(SIDE, 20, 1))
}

fn views() -> Vec<View> {
    made::visitors(64, SIDE, RESOLUTION)
}

/// Benchmarks culling and drawing, or culling alone.
fn frame(bencher: Bencher, scene: &Arc<Scene>, culler: &dyn Culler, draws: bool) {
    let views = views();
    let mut scratch = Scratch::default();
    for view in &views[..4] {
        let visible = culler.cull(view, EyeRegion::point(view.eye), &mut scratch).visible;
        assert_eq!(wrong_pixels(scene, view, &visible, &exact_set(scene, view).1), 0);
    }
    let mut items = ItemBuffer::new(&views[0]);
    let mut next = 0;
    bencher.bench_local(|| {
        let view = &views[next % views.len()];
        next += 1;
        let culled = culler.cull(view, EyeRegion::point(view.eye), &mut scratch);
        if draws {
            items.begin(view);
            items.draw(scene, &culled.visible);
        }
        culled.visible.len()
    });
}

#[divan::bench]
fn z_buffer(bencher: Bencher) {
    let scene = building();
    frame(bencher, &scene, &ZBuffer::new(scene.clone()), true);
}

#[divan::bench]
fn frustum_backface(bencher: Bencher) {
    let scene = building();
    frame(bencher, &scene, &FrustumBackface::new(scene.clone()), true);
}

#[divan::bench]
fn cplp(bencher: Bencher) {
    let scene = building();
    frame(bencher, &scene, &CplpCuller::build(scene.clone()), true);
}

#[divan::bench]
fn cplp_cull_only(bencher: Bencher) {
    let scene = building();
    frame(bencher, &scene, &CplpCuller::build(scene.clone()), false);
}

/// Small triangles, some 5 px wide, that fill the image.
fn small_triangles() -> (Scene, View) {
    let mut rng = Pcg64::seed_from_u64(3);
    let view = View::level(DVec3::ZERO, 0.0, 1.5, RESOLUTION);
    let any = |_| {
        let mut within = |reach: f32| rng.random_range(-reach..reach);
        let at = Vec3::new(within(0.9), within(0.65), -1.0) * (3.0 + within(1.0));
        let corners = std::array::from_fn(|_| at + Vec3::new(within(0.05), within(0.05), within(0.05)));
        Triangle { corners, sides: Sides::Both, occludes: true }
    };
    (Scene::from_triangles((0..100_000).map(any).collect()), view)
}

#[divan::bench]
fn small_triangles_item_buffer(bencher: Bencher) {
    let (scene, view) = small_triangles();
    let mut items = ItemBuffer::new(&view);
    bencher.counter(ItemsCount::new(scene.triangles().len())).bench_local(|| {
        items.begin(&view);
        items.draw_all(&scene);
    });
}

#[divan::bench]
fn small_triangles_depth_buffer(bencher: Bencher) {
    let (scene, view) = small_triangles();
    let all: Vec<u32> = (0..scene.triangles().len() as u32).collect();
    let mut depth = DepthBuffer::new(&view);
    bencher.counter(ItemsCount::new(scene.triangles().len())).bench_local(|| {
        depth.begin(&view);
        depth.draw(&scene, &all);
    });
}
