//! Whole all-round culls and single questions, in a building of 10×10 rooms with tables.
//! `cargo bench -p eyeline-visibility --bench under`

#[path = "../tests/under_support/mod.rs"]
mod under_support;

use std::sync::Arc;

use divan::{Bencher, black_box};
use eyeline_visibility::{
    Aabb, AllRound, AllRoundCells, Bound, Culler, EyeRegion, Occlusion, OctreeRules, RegionCuller, Resolution, Scratch,
    Sides, View,
};
use glam::DVec3;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use under_support::{Corners, random_eye, rooms};

fn main() {
    let mut rng = Pcg64::seed_from_u64(7);
    for corners in [Corners::Abut, Corners::Overlap] {
        let scene = rooms(10, corners, Sides::Both, 0.0, &mut rng);
        let all_round = AllRound::new(&scene);
        let mut scratch = all_round.scratch(128);
        let eyes = 1000;
        let mut sum = [0; 5];
        let cpu = on_cpu_ns();
        for _ in 0..eyes {
            all_round.cull(EyeRegion::point(random_eye(10, 0.0, &mut rng)), &mut scratch).unwrap();
            let stats = scratch.stats();
            for (sum, value) in
                sum.iter_mut().zip([stats.queries, stats.hidden, stats.leaves, stats.polygons, stats.joints])
            {
                *sum += value;
            }
        }
        // Unlike the times below, this leaves out what other processes took.
        let cpu = on_cpu_ns().zip(cpu).map_or(f64::NAN, |(end, start)| (end - start) / f64::from(eyes) / 1000.0);
        let mean = sum.map(|sum| sum as f64 / f64::from(eyes));
        println!(
            "{corners:?}: {} triangles, {} polygons, {} joints; per cull {cpu:.0} µs of CPU, {:.0} queries ({:.0} hidden), {:.0} leaves, {:.0} polygons, {:.0} joints",
            scene.triangles().len(),
            all_round.occluders().len(),
            all_round.occluders().joint_count(),
            mean[0],
            mean[1],
            mean[2],
            mean[3],
            mean[4],
        );
    }
    balls();
    divan::main();
}

/// Culls from balls against culls from their centres, one after the other, and what of 100 avatars is kept.
fn balls() {
    let mut rng = Pcg64::seed_from_u64(7);
    for corners in [Corners::Abut, Corners::Overlap] {
        let scene = rooms(22, corners, Sides::Both, 0.0, &mut rng);
        let all_round = AllRound::new(&scene);
        let mut scratch = all_round.scratch(128);
        let radii = [0.0, 0.15, 0.3, 1.0];
        let (mut time, mut kept, mut work) = ([0.0; 4], [0; 4], [[0; 3]; 4]);
        let eyes = 150;
        for _ in 0..eyes {
            let centre = random_eye(22, 0.0, &mut rng);
            let avatars: Vec<DVec3> = (0..100).map(|_| random_eye(22, 0.0, &mut rng).with_y(0.9)).collect();
            for (i, &radius) in radii.iter().enumerate() {
                let start = on_cpu_ns().unwrap_or(f64::NAN);
                let occlusion = all_round.cull(EyeRegion { centre, radius }, &mut scratch).unwrap();
                let bound = |at: DVec3| Bound::Box(Aabb::around(at, DVec3::new(0.3, 0.88, 0.3)));
                time[i] += on_cpu_ns().unwrap_or(f64::NAN) - start;
                kept[i] += avatars.iter().filter(|&&at| !occlusion.hides(&bound(at))).count();
                let stats = scratch.stats();
                for (sum, value) in work[i].iter_mut().zip([stats.queries, stats.polygons, stats.joints]) {
                    *sum += value;
                }
            }
        }
        for (i, radius) in radii.iter().enumerate() {
            println!(
                "{corners:?}, ball of {radius} m: {:.2} times the point's time, {} of {} avatars kept; per cull {:?} queries, polygons, joints",
                time[i] / time[0],
                kept[i],
                eyes * 100,
                work[i].map(|sum| sum / eyes as u64),
            );
        }
    }
}

/// Time that this thread has been running, from Linux.
fn on_cpu_ns() -> Option<f64> {
    std::fs::read_to_string("/proc/thread-self/schedstat").ok()?.split(' ').next()?.parse().ok()
}

/// One cull from the next of 64 eyes.
#[divan::bench(args = [64, 128, 256])]
fn cull_abut(bencher: Bencher, side: u32) {
    cull(bencher, Corners::Abut, side);
}

#[divan::bench(args = [64, 128, 256])]
fn cull_overlap(bencher: Bencher, side: u32) {
    cull(bencher, Corners::Overlap, side);
}

fn cull(bencher: Bencher, corners: Corners, side: u32) {
    let mut rng = Pcg64::seed_from_u64(7);
    let scene = rooms(10, corners, Sides::Both, 0.0, &mut rng);
    let all_round = AllRound::new(&scene);
    let eyes: Vec<DVec3> = (0..64).map(|_| random_eye(10, 0.0, &mut rng)).collect();
    let mut scratch = all_round.scratch(side);
    let mut next = 0;
    bencher.bench_local(|| {
        next = (next + 1) % eyes.len();
        all_round.cull(EyeRegion::point(black_box(eyes[next])), &mut scratch).unwrap();
    });
}

/// One view in cells that are cut at walls, from a point or a ball of this radius, metres: doors answer for the ball.
#[divan::bench(args = [0.0, 0.3])]
fn cull_view(bencher: Bencher, radius: f64) {
    let mut rng = Pcg64::seed_from_u64(7);
    let scene = Arc::new(rooms(22, Corners::Abut, Sides::Both, 0.0, &mut rng));
    let culler = RegionCuller::build(scene);
    let view = |rng: &mut Pcg64| {
        View::level(random_eye(22, 0.0, rng), rng.random_range(0.0..6.3), 1.57, Resolution::new(1024, 512))
    };
    let views: Vec<View> = (0..64).map(|_| view(&mut rng)).collect();
    let mut scratch = Scratch::default();
    let mut next = 0;
    bencher.bench_local(|| {
        next = (next + 1) % views.len();
        let view = black_box(&views[next]);
        culler.cull(view, EyeRegion { centre: view.eye, radius }, &mut scratch)
    });
}

/// The same by cPLP, which also finds the visible primitives.
#[divan::bench(args = [64, 128, 256])]
fn cull_abut_cells(bencher: Bencher, side: u32) {
    let mut rng = Pcg64::seed_from_u64(7);
    let scene = Arc::new(rooms(10, Corners::Abut, Sides::Both, 0.0, &mut rng));
    let all_round = AllRoundCells::new(scene, OctreeRules::default());
    let eyes: Vec<DVec3> = (0..64).map(|_| random_eye(10, 0.0, &mut rng)).collect();
    let mut scratch = all_round.scratch(side);
    let mut next = 0;
    bencher.bench_local(|| {
        next = (next + 1) % eyes.len();
        all_round.cull(EyeRegion::point(black_box(eyes[next])), &mut scratch).unwrap();
    });
}

/// 1,000 questions about avatars anywhere in the building.
#[divan::bench(args = ["box", "sphere"])]
fn hides_1000(bencher: Bencher, shape: &str) {
    let mut rng = Pcg64::seed_from_u64(8);
    let scene = rooms(10, Corners::Abut, Sides::Both, 0.0, &mut rng);
    let all_round = AllRound::new(&scene);
    let mut scratch = all_round.scratch(128);
    let eye = random_eye(10, 0.0, &mut rng);
    let occlusion = all_round.cull(EyeRegion::point(eye), &mut scratch).unwrap();
    let bounds: Vec<Bound> = (0..1000)
        .map(|_| {
            let centre = random_eye(10, 0.0, &mut rng).with_y(0.9);
            match shape {
                "box" => Bound::Box(Aabb::around(centre, DVec3::new(0.3, 0.88, 0.3))),
                _ => Bound::Sphere { centre, radius: 0.88 },
            }
        })
        .collect();
    bencher.bench_local(|| bounds.iter().filter(|bound| occlusion.hides(black_box(bound))).count());
}
