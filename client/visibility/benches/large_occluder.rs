//! Coorg & Teller's tables 2 and 3 in small: culling a made building of 10 × 10 rooms along a figure 8, at several speeds of the
//! eye, and by the frustum alone. Compare within one run.

#[path = "../tests/made/mod.rs"]
mod made;

use std::sync::Arc;

use divan::Bencher;
use eyeline_visibility::{
    EyeRegion, LargeOccluder, LargeOccluderRules, LargeOccluderScratch, Resolution, Scene, View, exact_set,
    wrong_pixels,
};
use glam::DVec3;

const SIDE: u32 = 10;
const RESOLUTION: Resolution = Resolution::new(320, 240);

/// Metres that a walker goes in a frame at 30 Hz.
const WALK: f64 = 0.05;

fn main() {
    divan::main();
}

fn scene() -> Arc<Scene> {
    Arc::new(made::with_nodes(&made::building(SIDE, 20, 1), 1))
}

/// The figure 8 at a distance along it, in metres.
fn view(along: f64) -> View {
    let half = 0.5 * f64::from(SIDE as f32 * made::ROOM);
    let at = |phase: f64| DVec3::new(half * (1.0 + 0.8 * phase.sin()), 1.6, half * (1.0 + 0.4 * (2.0 * phase).sin()));
    let phase = along / half;
    let ahead = at(phase + 1e-3) - at(phase);
    View::level(at(phase), f64::atan2(-ahead.x, -ahead.z), 1.2, RESOLUTION)
}

fn walk(bencher: Bencher, rules: LargeOccluderRules, speed: f64) {
    let culler = LargeOccluder::new(scene(), rules);
    let mut scratch = LargeOccluderScratch::default();
    for step in 0..4 {
        let view = view(f64::from(step) * 7.0);
        culler.walk(&view, EyeRegion::point(view.eye), &mut scratch);
        assert_eq!(wrong_pixels(culler.scene(), &view, scratch.visible(), &exact_set(culler.scene(), &view).1), 0);
    }
    let mut along = 0.0;
    bencher.bench_local(|| {
        along += speed * WALK;
        let view = view(along);
        culler.walk(&view, EyeRegion::point(view.eye), &mut scratch).primitives
    });
}

#[divan::bench(args = [0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0])]
fn at_times_walking_speed(bencher: Bencher, speed: f64) {
    walk(bencher, LargeOccluderRules::default(), speed);
}

#[divan::bench]
fn without_joints(bencher: Bencher) {
    walk(bencher, LargeOccluderRules::default().with_joint(false), 1.0);
}

#[divan::bench]
fn frustum_alone(bencher: Bencher) {
    walk(bencher, LargeOccluderRules::default().with_occluders(0), 1.0);
}
