//! The tiled coverage masks: triangles, walls, a cleared image and questions, beside one maximum over a full-screen f32 buffer.
//! `cargo bench -p eyeline-visibility --bench masked`
//!
//! Speeds drift between runs here, so that the summary first measures everything in turns with that pass and prints ratios.

use std::time::Instant;

use divan::{Bencher, black_box};
use eyeline_visibility::{Aabb, Coverage, MaskedDepth, Resolution, Sides, SimdLevel, View};
use glam::DVec3;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

const PIXELS: usize = 1024 * 512;

fn view() -> View {
    View { near: 0.1, ..View::level(DVec3::ZERO, 0.0, std::f64::consts::FRAC_PI_2, Resolution::new(1024, 512)) }
}

/// Half the width is one metre a metre away.
const FOCAL: f64 = 512.0;

fn main() {
    summary();
    divan::main();
}

fn levels() -> Vec<(&'static str, SimdLevel)> {
    let best = SimdLevel::new();
    let mut levels = vec![("portable", SimdLevel::baseline())];
    #[cfg(any(target_arch = "x86", target_arch = "x86_64"))]
    {
        levels.extend(best.as_avx2().map(|avx2| ("AVX2", SimdLevel::Avx2(avx2))));
        levels.extend(best.as_avx512().map(|avx512| ("AVX-512", SimdLevel::Avx512(avx512))));
    }
    levels
}

/// Right triangles with legs of so many pixels, anywhere in the image, at depths in any order.
fn triangles(legs: f64, count: usize) -> Vec<[DVec3; 3]> {
    let mut rng = Pcg64::seed_from_u64(1);
    (0..count)
        .map(|_| {
            let w = rng.random_range(2.0..50.0);
            let (x, y) = (rng.random_range(-512.0..512.0 - legs), rng.random_range(-256.0..256.0 - legs));
            [[0.0, 0.0], [legs, 0.0], [0.0, legs]]
                .map(|[dx, dy]| DVec3::new((x + dx) * w / FOCAL, (y + dy) * w / FOCAL, -w * rng.random_range(1.0..1.1)))
        })
        .collect()
}

/// Walls of 6 × 3 m, nearest first, as one meets them in a building.
fn walls(count: usize) -> Vec<[DVec3; 4]> {
    let mut rng = Pcg64::seed_from_u64(2);
    let mut walls: Vec<[DVec3; 4]> = (0..count)
        .map(|i| {
            let w = 1.0 + 25.0 * i as f64 / count as f64;
            let x = rng.random_range(-w..w);
            let along = if rng.random() { DVec3::X * 6.0 } else { DVec3::NEG_Z * 6.0 };
            let low = DVec3::new(x - along.x * 0.5, -1.5, -w);
            [low, low + along, low + along + DVec3::Y * 3.0, low + DVec3::Y * 3.0]
        })
        .collect();
    walls.sort_by(|a, b| b[0].z.total_cmp(&a[0].z));
    walls
}

/// Boxes of about so many pixels, from `near` to twice as far.
fn boxes(pixels: f64, near: f64, count: usize) -> Vec<Aabb> {
    let mut rng = Pcg64::seed_from_u64(3);
    (0..count)
        .map(|_| {
            let w = rng.random_range(near..2.0 * near);
            let centre = DVec3::new(rng.random_range(-0.9..0.9) * w, rng.random_range(-0.4..0.4) * w, -w);
            Aabb::around(centre, DVec3::splat(0.5 * pixels * w / FOCAL))
        })
        .collect()
}

/// A wall over the whole image, 20 m away, with a hole in the middle of each tenth of it.
fn lattice(image: &mut MaskedDepth) {
    image.begin(&view());
    for i in 0..10 {
        let x = [-22.0 + 4.4 * f64::from(i), -22.0 + 4.4 * f64::from(i) + 4.3];
        let corners = [[0, 0], [1, 0], [1, 1], [0, 1]];
        image.draw_polygon(&corners.map(|[i, j]: [usize; 2]| DVec3::new(x[i], [-12.0, 12.0][j], -20.0)), Sides::Both);
    }
}

/// What runs, how many things it does in one run, and the run.
type Run = (String, f64, Box<dyn FnMut()>);

/// Nanoseconds of the fastest of many runs of each, taken in turns, and those of the pass.
fn in_turns(runs: &mut [Run]) {
    let mut depths = vec![0.0_f32; PIXELS];
    let other: Vec<f32> = (0..PIXELS).map(|i| (i % 977) as f32).collect();
    let mut pass = f64::INFINITY;
    let mut best = vec![f64::INFINITY; runs.len()];
    for _ in 0..60 {
        pass = pass.min(time(|| {
            depths.iter_mut().zip(&other).for_each(|(a, b)| *a = if *b > *a { *b } else { *a });
            black_box(&mut depths);
        }));
        for ((_, _, run), best) in runs.iter_mut().zip(&mut best) {
            *best = best.min(time(run));
        }
    }
    println!("one full-screen f32 max pass: {:.1} µs", pass / 1e3);
    for ((name, count, _), ns) in runs.iter().zip(best) {
        println!("{name:46} {:9.1} ns each, {:8.2} M/s, all {:7.3} passes", ns / count, count / ns * 1e3, ns / pass);
    }
}

#[expect(clippy::disallowed_methods, reason = "a benchmark reads the clock")]
fn time(mut run: impl FnMut()) -> f64 {
    let start = Instant::now();
    run();
    start.elapsed().as_nanos() as f64
}

fn summary() {
    let mut runs: Vec<Run> = Vec::new();
    for (name, level) in levels() {
        let mut image = MaskedDepth::with_level(Coverage::Sampled, level);
        runs.push((format!("{name}: begin"), 1.0, Box::new(move || image.begin(black_box(&view())))));
        for legs in [4.0, 8.0, 32.0, 128.0] {
            let triangles = triangles(legs, 2000);
            let mut image = MaskedDepth::with_level(Coverage::Sampled, level);
            runs.push((
                format!("{name}: triangles of {legs} px"),
                triangles.len() as f64,
                Box::new(move || {
                    image.begin(&view());
                    triangles.iter().for_each(|corners| image.draw_polygon(black_box(corners), Sides::Both));
                }),
            ));
        }
        let all_walls = walls(150);
        let mut farthest_first = all_walls.clone();
        farthest_first.reverse();
        let mut image = MaskedDepth::with_level(Coverage::Sampled, level);
        runs.push((
            format!("{name}: wall quads, farthest first"),
            150.0,
            Box::new(move || {
                image.begin(&view());
                farthest_first.iter().for_each(|corners| image.draw_polygon(black_box(corners), Sides::Both));
            }),
        ));
        let mut image = MaskedDepth::with_level(Coverage::Sampled, level);
        let drawn = all_walls.clone();
        runs.push((
            format!("{name}: wall quads"),
            150.0,
            Box::new(move || {
                image.begin(&view());
                drawn.iter().for_each(|corners| image.draw_polygon(black_box(corners), Sides::Both));
            }),
        ));
        for (pixels, near, what) in [
            (8.0, 50.0, "hidden"),
            (40.0, 50.0, "hidden"),
            (300.0, 50.0, "hidden"),
            (8.0, 5.0, "seen"),
            (40.0, 5.0, "seen"),
        ] {
            let mut image = MaskedDepth::with_level(Coverage::Sampled, level);
            lattice(&mut image);
            let boxes = boxes(pixels, near, 1000);
            runs.push((
                format!("{name}: boxes of {pixels} px, mostly {what}"),
                1000.0,
                Box::new(move || {
                    black_box(boxes.iter().filter(|aabb| image.sees_box(black_box(aabb))).count());
                }),
            ));
        }
        let mut image = MaskedDepth::with_level(Coverage::Sampled, level);
        let boxes = boxes(40.0, 10.0, 150);
        runs.push((
            format!("{name}: frame of 150 walls and 150 boxes"),
            1.0,
            Box::new(move || {
                image.begin(&view());
                for (wall, aabb) in all_walls.iter().zip(&boxes) {
                    black_box(image.sees_box(aabb));
                    image.draw_polygon(wall, Sides::Both);
                }
            }),
        ));
    }
    // A name on the command line chooses, as it does below.
    if let Some(wanted) = std::env::args().skip(1).find(|arg| !arg.starts_with('-')) {
        runs.retain(|(name, ..)| name.contains(&wanted));
    }
    in_turns(&mut runs);
}

#[divan::bench(args = [4, 8, 32, 128])]
fn draw_triangle(bencher: Bencher, legs: u32) {
    let triangles = triangles(f64::from(legs), 2000);
    let mut image = MaskedDepth::new(Coverage::Sampled);
    image.begin(&view());
    let mut next = 0;
    bencher.bench_local(|| {
        next = (next + 1) % triangles.len();
        image.draw_polygon(black_box(&triangles[next]), Sides::Both);
    });
}

#[divan::bench]
fn begin(bencher: Bencher) {
    let mut image = MaskedDepth::new(Coverage::Sampled);
    bencher.bench_local(|| image.begin(black_box(&view())));
}

#[divan::bench(args = [8, 40, 300])]
fn sees_box(bencher: Bencher, pixels: u32) {
    let mut image = MaskedDepth::new(Coverage::Sampled);
    lattice(&mut image);
    let boxes = boxes(f64::from(pixels), 50.0, 1000);
    let mut next = 0;
    bencher.bench_local(|| {
        next = (next + 1) % boxes.len();
        image.sees_box(black_box(&boxes[next]))
    });
}
