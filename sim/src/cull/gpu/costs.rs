//! What does a query cost, by its size and by its image's? And do the papers' ratios hold on a real adapter?

// This is a driver: it may read the clock.
#![expect(clippy::disallowed_methods)]

use std::sync::Arc;
use std::time::Instant;

use eyeline_client::gpu::{Gpu, GpuError, GpuQuery, GpuQueryKind, GpuScene};
use eyeline_visibility::{Aabb, QueryBackEnd, QueryKind, Resolution, Scene, Sides, Triangle, View};
use glam::{DVec3, Vec3};

use super::{SOFTWARE, steps};
use crate::cull::row::CullRow;
use crate::cull::run::Outcome;
use crate::report::{Axis, Plot, PlotKind, Point, Report, Series};

/// Sides of the box that is asked about, pixels, in an image of [`SIDE`] pixels.
const BOXES_PX: [u32; 6] = [4, 16, 64, 128, 256, 500];
const SIDE: u32 = 512;

/// The images of cPLP's table 2.
pub(super) const IMAGES: [u32; 2] = [64, 512];

/// Queries of which the median is told, and those before them that warm caches.
pub(super) const REPEATS: usize = 15;
pub(super) const WARM: usize = 3;

/// Kinds whose costs are told: of a single box, a set of queries and one at a time are the same.
const KINDS: [GpuQueryKind; 6] = [
    GpuQueryKind::ItemBuffer,
    GpuQueryKind::ItemBufferTiled,
    GpuQueryKind::Histogram,
    GpuQueryKind::OcclusionQueries,
    GpuQueryKind::PerFragment,
    GpuQueryKind::ZPyramid,
];

/// What was measured of one back end: microseconds from submission to answer.
struct Cost {
    name: String,
    /// By [`BOXES_PX`].
    by_box: Vec<f64>,
    /// By [`IMAGES`], with values read back; a box of half the image's side.
    by_image: Vec<(f64, u64)>,
}

/// See [`super::GpuSide::measure`].
pub(super) fn add(gpu: &Arc<Gpu>, report: &mut Report, outcome: &Outcome) -> anyhow::Result<Vec<String>> {
    let wall = wall();
    let scene = Arc::new(GpuScene::new(gpu, &wall)?);
    let mut costs = Vec::new();
    for kind in KINDS {
        let mut query = match GpuQuery::new(gpu.clone(), scene.clone(), kind) {
            Ok(query) => query,
            Err(error @ GpuError::Lacks { .. }) => {
                report.run.notes.push(format!("{kind} was not measured: {error}"));
                continue;
            }
            Err(error) => return Err(error.into()),
        };
        costs.push(cost(kind.name().to_owned(), &wall, &mut query));
        query.check()?;
    }
    for kind in [QueryKind::ItemBuffer, QueryKind::PerFragmentHistogram] {
        costs.push(cost(format!("cpu {kind}"), &wall, &mut kind.back_end()));
    }
    let software = if gpu.is_software() { format!(" ({SOFTWARE})") } else { String::new() };
    let micros = "time from submission to answer (µs)";
    let mut plot = Plot::new(
        format!("Time per query over the size of its box{software}"),
        PlotKind::Line,
        Axis::log(format!("side of the box (px, image {SIDE}x{SIDE})")),
        Axis::log(micros),
    );
    let mut images = Plot::new(
        format!("Time per query over the size of the image{software}"),
        PlotKind::Line,
        Axis::log("side of the image (px, a box of half of it)"),
        Axis::log(micros),
    );
    let mut lines = Vec::new();
    for Cost { name, by_box, by_image } in &costs {
        let points = BOXES_PX.iter().zip(by_box).map(|(&side, &micros)| Point::new(f64::from(side), micros));
        plot = plot.with_series(Series::new(name, points.collect()));
        let points = IMAGES.iter().zip(by_image).map(|(&side, &(micros, _))| Point::new(f64::from(side), micros));
        images = images.with_series(Series::new(name, points.collect()));
        let sizes = BOXES_PX.iter().zip(by_box).map(|(side, micros)| format!("{side} px {micros:.0}"));
        let image = |at: usize| {
            let (micros, values) = by_image[at];
            format!("{0}x{0} {micros:.0} µs, {values} values", IMAGES[at])
        };
        lines.push(format!(
            "{name}: µs by side of the box {}; by image {}; {}",
            sizes.collect::<Vec<String>>().join(", "),
            image(0),
            image(1)
        ));
    }
    report.plots.push(plot.with_note("Staneker et al. 2003, figure 1"));
    report
        .plots
        .push(images.with_note("Klosowski & Silva 2001, table 2, all of a query: what is read back and scanned"));
    lines.extend(steps::add(gpu, &wall, report)?);
    if gpu.is_software() {
        lines.push(format!("{SOFTWARE}; the papers' ratios are checked on a real adapter"));
    } else {
        lines.extend(ratios(outcome));
    }
    report.run.notes.extend(lines.iter().cloned());
    Ok(lines)
}

/// The papers' two ratios, from the rows that were run: frames drawn and culled a second.
fn ratios(outcome: &Outcome) -> Vec<String> {
    // cPLP §4: 23 Hz for the extension against 18 Hz for single queries. Staneker's table 5: several maps over single queries.
    let single = GpuQueryKind::OneAtATime.name();
    [
        ("gpu-cplp", GpuQueryKind::PerFragment, "the extension", "28 %"),
        ("gpu-cplp-batches", GpuQueryKind::OcclusionQueries, "several maps", "33 to 66 %"),
    ]
    .into_iter()
    .map(|(culler, kind, what, paper)| {
        let faster = row(outcome, culler, kind.name()).zip(row(outcome, "gpu-cplp", single));
        match faster.map(|(new, old)| (old.total_ms / new.total_ms - 1.0) * 100.0).filter(|gain| gain.is_finite()) {
            Some(gain) => format!("checked: {what} gains {gain:+.0} % over single queries; the paper says {paper}"),
            None => format!("not checked: {what} over single queries needs {culler} and gpu-cplp with {single}"),
        }
    })
    .collect()
}

fn row<'a>(outcome: &'a Outcome, culler: &str, query: &str) -> Option<&'a CullRow> {
    outcome.rows.iter().find(|row| row.culler == culler && row.query.as_deref() == Some(query))
}

/// A wall that fills the image, ten metres before the eye.
fn wall() -> Scene {
    let at = |x: f32, y: f32| Vec3::new(x, y, -10.0);
    let triangle = |corners| Triangle { corners, sides: Sides::Both, occludes: true };
    let [a, b, c, d] = [at(-90.0, -90.0), at(90.0, -90.0), at(90.0, 90.0), at(-90.0, 90.0)];
    Scene::from_triangles(vec![triangle([a, b, c]), triangle([a, c, d])])
}

fn cost(name: String, wall: &Scene, query: &mut dyn QueryBackEnd) -> Cost {
    let mut of = |image: u32, box_px: f64| {
        let view = View::level(DVec3::ZERO, 0.0, std::f64::consts::FRAC_PI_2, Resolution::new(image, image));
        // Before the wall: every fragment passes, as with Staneker's test volume. Flat, five metres away.
        let half = 2.5 * box_px / view.focal_px();
        let cell = Aabb::around(DVec3::new(0.0, 0.0, -5.0), DVec3::new(half, half, 0.01));
        query.begin(&view);
        query.draw(wall, &[0, 1]);
        let mut seen = Vec::new();
        let mut values = 0;
        let mut times: Vec<f64> = (0..WARM + REPEATS)
            .map(|_| {
                let began = Instant::now();
                values = query.query(&[cell], &mut seen).read_back;
                began.elapsed().as_secs_f64() * 1e6
            })
            .skip(WARM)
            .collect();
        times.sort_by(f64::total_cmp);
        (times[times.len() / 2], values)
    };
    Cost {
        name,
        by_box: BOXES_PX.iter().map(|&side| of(SIDE, f64::from(side)).0).collect(),
        by_image: IMAGES.iter().map(|&side| of(side, f64::from(side) * 0.5)).collect(),
    }
}
