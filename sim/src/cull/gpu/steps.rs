//! Where does the time of a query's pass go? cPLP's Table 2: transfer and scan of images of 64² and 512² pixels, and drawing beside them.
//!
//! The paper gives transfer and scan of the item buffer, and in the text one time for the histogram, which is counted while it is
//! transferred. Each step is waited for here before the next begins; a query that is not taken apart waits once, so the sum is
//! more than [`super::costs`] says.

// This is a driver: it may read the clock.
#![expect(clippy::disallowed_methods)]

use std::sync::Arc;
use std::time::Instant;

use eyeline_client::gpu::{Gpu, GpuError, GpuQuery, GpuQueryKind, GpuScene, GpuStep};
use eyeline_visibility::{Aabb, QueryBackEnd, Resolution, Scene, View};
use glam::DVec3;

use super::SOFTWARE;
use super::costs::{IMAGES, REPEATS, WARM};
use crate::report::{Axis, Plot, PlotKind, Point, Report, Series};

/// Kinds that are taken apart: those of the table, and the two that read little back.
const KINDS: [GpuQueryKind; 4] =
    [GpuQueryKind::ItemBuffer, GpuQueryKind::Histogram, GpuQueryKind::OcclusionQueries, GpuQueryKind::PerFragment];

const STEPS: [&str; 3] = ["drawing", "transfer", "scan"];

/// Boxes along a side of the front that is asked about.
const FRONT: u32 = 8;

/// Microseconds of each of [`STEPS`], in an image of so many pixels a side.
struct Split {
    kind: GpuQueryKind,
    side: u32,
    micros: [f64; 3],
}

/// Measures the steps and puts them into a report. Returns the lines that it adds, for the terminal.
///
/// # Errors
/// If the adapter fails.
pub(super) fn add(gpu: &Arc<Gpu>, wall: &Scene, report: &mut Report) -> anyhow::Result<Vec<String>> {
    let scene = Arc::new(GpuScene::new(gpu, wall)?);
    let mut splits = Vec::new();
    for kind in KINDS {
        let mut query = match GpuQuery::new(gpu.clone(), scene.clone(), kind) {
            Ok(query) => query,
            // Said beside the whole queries.
            Err(GpuError::Lacks { .. }) => continue,
            Err(error) => return Err(error.into()),
        };
        for side in IMAGES {
            splits.push(Split { kind, side, micros: split(&mut query, wall, side)? });
        }
    }
    let software = if gpu.is_software() { format!(" ({SOFTWARE})") } else { String::new() };
    let mut plot = Plot::new(
        format!("Steps of a query by the size of its image{software}"),
        PlotKind::StackedBars,
        Axis::linear(""),
        Axis::linear("time (µs), each step waited for"),
    );
    for (at, step) in STEPS.into_iter().enumerate() {
        let bar = |split: &Split| Point::bar(format!("{} {1}x{1}", split.kind, split.side), split.micros[at]);
        plot = plot.with_series(Series::new(step, splits.iter().map(bar).collect()));
    }
    report.plots.push(plot.with_note(
        "Klosowski & Silva 2001, table 2; SGI Octane: transfer 217 and scan 30 µs at 64x64, 4,483 and 2,300 at 512x512",
    ));
    Ok(splits.chunks(IMAGES.len()).map(|of_kind| line(of_kind) + &software).collect())
}

fn line(splits: &[Split]) -> String {
    let parts = splits.iter().map(|Split { side, micros, .. }| {
        let steps = STEPS.iter().zip(micros).map(|(step, micros)| format!("{step} {micros:.0}"));
        format!("{side}x{side} {}, total {:.0}", steps.collect::<Vec<_>>().join(", "), micros.iter().sum::<f64>())
    });
    let kind = splits.first().map_or("", |split| split.kind.name());
    format!("{kind}, cPLP's table 2 (µs): {}", parts.collect::<Vec<_>>().join("; "))
}

/// The median of each step of a pass about a front before a wall, in an image of `side` pixels a side.
fn split(query: &mut GpuQuery, wall: &Scene, side: u32) -> Result<[f64; 3], GpuError> {
    let view = View::level(DVec3::ZERO, 0.0, std::f64::consts::FRAC_PI_2, Resolution::new(side, side));
    query.begin(&view);
    query.draw(wall, &[0, 1]);
    let front = front();
    let mut times: [Vec<f64>; 3] = Default::default();
    for repeat in 0..WARM + REPEATS {
        let mut before = Instant::now();
        query.step_by_step(&front, |step| {
            let took = before.elapsed().as_secs_f64() * 1e6;
            if repeat >= WARM {
                times[at(step)].push(took);
            }
            before = Instant::now();
        })?;
    }
    Ok(times.map(|mut times| {
        times.sort_by(f64::total_cmp);
        times[times.len() / 2]
    }))
}

fn at(step: GpuStep) -> usize {
    match step {
        GpuStep::Draw => 0,
        GpuStep::Transfer => 1,
        GpuStep::Scan => 2,
    }
}

/// Boxes all over the image, five metres away, each as wide as the gap beside it.
fn front() -> Vec<Aabb> {
    let pitch = 10.0 / f64::from(FRONT);
    let place = |at: u32| (f64::from(at) + 0.5) * pitch - 5.0;
    let boxes = (0..FRONT * FRONT).map(|at| DVec3::new(place(at % FRONT), place(at / FRONT), -5.0));
    boxes.map(|centre| Aabb::around(centre, DVec3::new(pitch / 4.0, pitch / 4.0, 0.01))).collect()
}
