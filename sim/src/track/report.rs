//! The report of sweeps of trackers: each beside what the paper says.

use super::row::{TrackRow, columns};
use super::sweep::{Finding, SweepInfo, lines};
use super::tables;
use crate::report::{Axis, Comparison, Plot, PlotKind, Point, Report, Run, Series};

/// A sweep that was run.
#[derive(Clone, Debug)]
pub struct Swept {
    /// Which.
    pub info: SweepInfo,
    /// What was measured.
    pub rows: Vec<TrackRow>,
    /// What that says.
    pub findings: Vec<Finding>,
}

/// Puts sweeps into a report.
///
/// # Errors
/// If a row is not flat; a fault of this program.
pub fn report(run: Run, sweeps: &[Swept]) -> anyhow::Result<Report> {
    let mut report = Report::new(run, columns());
    let (mut met, mut missed, mut broken) = (0, Vec::new(), 0);
    for swept in sweeps {
        let SweepInfo { name, paper, said, .. } = swept.info;
        report.run.notes.push(format!("{name} ({paper}). The paper: {said}"));
        for finding in &swept.findings {
            let mark = match finding.met {
                Some(true) => {
                    met += 1;
                    " [met]"
                }
                Some(false) => {
                    missed.push(name);
                    " [MISSED]"
                }
                None => "",
            };
            report.run.notes.push(format!("{name}, here: {}{mark}", finding.text));
        }
        for row in &swept.rows {
            broken += usize::from(!row.ok);
            report.push(row)?;
        }
        report.plots.extend(with_words(plots(swept), swept));
    }
    missed.dedup();
    report.headline = match broken {
        0 => "No tracker broke its promise in any frame that was compared.".to_owned(),
        _ => format!("BROKEN: {broken} rows show wrong pixels or bounds that did not hold."),
    };
    if met + missed.len() > 0 {
        report.headline += &format!(" {met} bars met");
        report.headline += &match missed.len() {
            0 => ".".to_owned(),
            _ => format!("; missed in {}.", missed.join(", ")),
        };
    }
    let labels = ["sweep", "x", "culler", "variant", "shape", "validity"];
    report.compare(Comparison::new(&labels, "total_ms", "absences").by_series("variant"));
    Ok(report)
}

/// Puts what the paper says, and what was found here, under the first plot of a sweep.
fn with_words(mut plots: Vec<Plot>, swept: &Swept) -> Vec<Plot> {
    if !plots.is_empty() {
        let found: Vec<&str> = swept.findings.iter().map(|finding| finding.text.as_str()).collect();
        let first = plots.remove(0).with_note(format!("The paper: {} Here: {}.", swept.info.said, found.join(". ")));
        plots.insert(0, first);
    }
    plots
}

fn plots(swept: &Swept) -> Vec<Plot> {
    let SweepInfo { name, paper, x, log, .. } = swept.info;
    let axis = || if log { Axis::log(x) } else { Axis::linear(x) };
    let line = |what: &str, y: Axis, of: &dyn Fn(&TrackRow) -> (f64, f64)| {
        let mut plot = Plot::new(format!("{name} ({paper}): {what}"), PlotKind::Line, axis(), y);
        for (name, rows) in lines(&swept.rows) {
            let points = rows.iter().map(|row| of(row)).map(|(x, y)| Point::new(x, y)).collect();
            plot = plot.with_series(Series::new(name, points));
        }
        plot
    };
    let scatter = |what: &str, y: &str, of: &dyn Fn(&TrackRow) -> (f64, f64, String)| {
        let mut plot = Plot::new(
            format!("{name} ({paper}): {what}"),
            PlotKind::Scatter,
            Axis::log("work per frame"),
            Axis::linear(y),
        );
        for row in &swept.rows {
            let (x, y, label) = of(row);
            plot = plot.with_series(Series::new(label.clone(), vec![Point::labelled(x, y, label)]));
        }
        plot
    };
    match name {
        "static" => vec![
            line("time", Axis::log("cull, track and draw (ms)"), &|row| (row.static_triangles as f64, row.total_ms)),
            line("work", Axis::log("work per frame"), &|row| (row.static_triangles as f64, row.work)),
        ],
        "ratio" | "dynamic" | "hidden" | "index" => vec![
            line("time", Axis::log("cull, track and draw (ms)"), &|row| (row.x, row.total_ms)),
            line("work", Axis::log("work per frame"), &|row| (row.x, row.work)),
        ],
        "fuzzy" => vec![
            line("work", Axis::linear("work per frame"), &|row| (row.violated, row.work)),
            line("time", Axis::linear("cull and track (ms)"), &|row| (row.violated, row.frame_ms)),
        ],
        "calibrated" => vec![line("messages", Axis::linear("messages of hidden objects per frame"), &|row| {
            (row.fuzzy, row.hidden_caused_per_frame)
        })],
        "messages" => vec![line("messages", Axis::linear("updates + TBVs per frame"), &|row| {
            (row.x, row.updates_per_frame + row.bounds_per_frame)
        })],
        "lca" => {
            let cubes = |rows: &[&TrackRow]| -> Vec<Point> {
                rows.iter().filter(|row| row.motion == "cubes").map(|row| Point::new(row.x, row.work)).collect()
            };
            let mut plot = Plot::new(
                format!("{name} ({paper}): nodes visited, two cubes"),
                PlotKind::Line,
                axis(),
                Axis::log("nodes visited a step"),
            );
            for (name, rows) in lines(&swept.rows) {
                plot = plot.with_series(Series::new(name, cubes(&rows)));
            }
            vec![plot]
        }
        "occluders" => {
            let mut plot =
                line("polygons", Axis::log("polygons drawn (% of all)"), &|row| (row.x, tables::drawn_percent(row)));
            // The frustum alone has no k: a line to compare with, from the first to the last.
            let ends = [f64::min, f64::max].map(|least: fn(f64, f64) -> f64| {
                swept.rows.iter().map(|row| row.x).filter(|x| *x > 0.0).reduce(least).unwrap_or(1.0)
            });
            for series in &mut plot.series {
                if let [Point { x: 0.0, y, .. }] = series.points[..] {
                    series.points = ends.map(|x| Point::new(x, y)).to_vec();
                }
            }
            vec![plot]
        }
        "drawing" => {
            let mut plot = Plot::new(
                format!("{name} ({paper}): time"),
                PlotKind::StackedBars,
                axis(),
                Axis::linear("milliseconds per frame"),
            );
            let label = |row: &TrackRow| format!("{}, {}", tables::floors(row), row.culler);
            for (part, of) in [("cull", (|row| row.frame_ms) as fn(&TrackRow) -> f64), ("draw", |row| row.draw_ms)] {
                let bars = swept.rows.iter().map(|row| Point::bar(label(row), of(row))).collect();
                plot = plot.with_series(Series::new(part, bars));
            }
            vec![plot]
        }
        "observer" => vec![
            line("time", Axis::linear("cull (ms)"), &|row| (row.x, row.frame_ms)),
            line("relations", Axis::log("relations looked at per frame"), &|row| (row.x, row.relations_per_frame)),
        ],
        "growth" => vec![line("messages", Axis::log("messages that hidden objects cause, per frame"), &|row| {
            (row.x, row.hidden_caused_per_frame)
        })],
        "shapes" => vec![scatter("messages against work", "updates + TBVs per frame", &|row| {
            (row.work, row.updates_per_frame + row.bounds_per_frame, format!("{} · {}", row.shape, row.motion))
        })],
        "validity" => vec![scatter("messages against work", "messages that hidden objects cause, per frame", &|row| {
            (row.work, row.hidden_caused_per_frame, format!("{} · {} eye", row.validity, row.eye))
        })],
        _ => Vec::new(),
    }
}
