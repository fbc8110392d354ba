//! The report of a comparison of cullers: wrong pixels and ε_k against time first, then what was drawn, then pictures.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::Context;

use super::frames;
use super::gpu;
use super::row::columns;
use super::run::{CullConfig, Outcome};
use super::world::World;
use crate::report::{Axis, Comparison, Picture, Plot, PlotKind, Point, Report, Run, Series};

/// More pictures than these would make the page slow; the others are in the folder.
const PICTURES_MAX: usize = 48;

/// Puts rows and pictures into a report.
///
/// # Errors
/// If a row is not flat; a fault of this program.
pub fn report(run: Run, world: &World, outcome: &Outcome, config: &CullConfig) -> anyhow::Result<Report> {
    let mut report = Report::new(run, columns());
    report.run.notes.push(format!(
        "world '{}': {} static triangles, {} objects asked about as boxes",
        world.name,
        world.scene.triangles().len(),
        world.object_boxes.len()
    ));
    report.run.notes.extend(world.notes.iter().chain(&outcome.notes).cloned());
    report.run.notes.push(format!(
        "frame_ms is the mean over views of the median of {} repeats; a max pass ran after each culled frame",
        config.repeats
    ));
    if config.eye_radii.iter().any(|radius| *radius > 0.0) {
        report.run.notes.push(format!(
            "for an eye radius above 0 the exact set is the union over the middle and {} sampled eyes of the ball",
            config.eyes.max(1) - 1
        ));
    }
    report.run.notes.push("each view by itself: frames.csv beside this report".into());
    for row in &outcome.rows {
        report.push(row)?;
    }
    let guesses = outcome.rows.iter().any(|row| row.budget.is_some() && !row.conservative);
    if guesses && outcome.rows.iter().all(|row| row.over_frustum.is_none()) {
        report.run.notes.push(
            "what guessing costs over culling by the frustum is told if frustum-backface runs too, and views are timed"
                .into(),
        );
    }
    report.headline = headline(outcome, world.notes.iter().any(|note| note == gpu::SOFTWARE));
    let labels = ["culler", "tessellation", "query", "budget", "resolution", "eye_radius"];
    report.compare(Comparison::new(&labels, "frame_ms", "wrong_pixels_mean").by_series("culler"));
    let scatter = |title: &str, x: Axis, y: Axis, of: &dyn Fn(&super::CullRow) -> (f64, f64)| {
        let mut plot = Plot::new(title, PlotKind::Scatter, x, y);
        let mut names: Vec<&str> = outcome.rows.iter().map(|row| row.culler.as_str()).collect();
        names.dedup();
        names.sort_unstable();
        names.dedup();
        for name in names {
            let rows = outcome.rows.iter().filter(|row| row.culler == name);
            let point = |row: &super::CullRow| {
                let (x, y) = of(row);
                Point::labelled(x, y, label(row))
            };
            plot = plot.with_series(Series::new(name, rows.map(point).collect()));
        }
        plot
    };
    report.plots.push(scatter(
        "Visible primitives found (ε_k) against run time",
        Axis::log("frame_ms (ms)"),
        Axis::linear("share of the exact set that was reported"),
        &|row| (row.frame_ms, row.visible_found),
    ));
    report.plots.push(scatter(
        "z-tests against time to cull and draw",
        Axis::log("cull and draw (ms)"),
        Axis::log("z-tests per pixel"),
        &|row| (row.total_ms, row.z_tests_per_pixel),
    ));
    let mut budgets: Vec<usize> = outcome.rows.iter().filter_map(|row| row.budget_triangles).collect();
    budgets.sort_unstable();
    budgets.dedup();
    if budgets.len() > 1 {
        // cPLP's figure 6 and table 3. A logarithm has no 0: a budget of 0 stands at 1. A deadline stands at what it drew.
        let budget = || Axis::log("PLP budget (triangles)");
        let at = |row: &super::CullRow| row.budget_triangles.map_or(row.plp_triangles, |budget| budget as f64).max(1.0);
        report.plots.push(by_budget(outcome, "Time to cull and draw over PLP's budget", budget(), "ms", &|row| {
            (at(row), row.total_ms)
        }));
        // PLP's table 1 and figure 12.
        report.plots.push(by_budget(
            outcome,
            "Visible primitives found (ε_k) over PLP's budget",
            budget(),
            "ε_k",
            &|row| (at(row), row.visible_found_mean),
        ));
        let worst = "Wrong pixels of the worst view over PLP's budget";
        report
            .plots
            .push(by_budget(outcome, worst, budget(), "wrong pixels (%)", &|row| (at(row), row.wrong_percent_max)));
        report.plots.push(by_budget(outcome, "Rounds of queries over PLP's budget", budget(), "rounds", &|row| {
            (at(row), row.rounds)
        }));
    }
    report.plots.extend(frames::plots(&outcome.frames, &outcome.rows));
    if config.eye_radii.len() > 1 {
        report.plots.push(scatter(
            "What a ball of eyes costs",
            Axis::linear("eye radius (m)"),
            Axis::log("frame_ms (ms)"),
            &|row| (row.eye_radius, row.frame_ms),
        ));
    }
    Ok(report)
}

/// A line for each culler, tessellation, query and resolution that has a budget.
fn by_budget(outcome: &Outcome, title: &str, x: Axis, y: &str, of: &dyn Fn(&super::CullRow) -> (f64, f64)) -> Plot {
    let mut plot = Plot::new(title, PlotKind::Line, x, Axis::linear(y));
    let mut lines: BTreeMap<String, Vec<Point>> = BTreeMap::new();
    for row in outcome.rows.iter().filter(|row| row.budget.is_some()) {
        let (x, y) = of(row);
        let name = label(&super::CullRow { budget: None, ..row.clone() });
        lines.entry(name).or_default().push(Point::labelled(x, y, label(row)));
    }
    for (name, mut points) in lines {
        points.sort_by(|a, b| a.x.total_cmp(&b.x));
        plot = plot.with_series(Series::new(name, points));
    }
    plot
}

/// What names a row in a plot.
fn label(row: &super::CullRow) -> String {
    let parts = [Some(row.culler.clone()), row.tessellation.clone(), row.query.clone(), row.budget.clone()];
    let mut label = parts.into_iter().flatten().collect::<Vec<String>>().join(" · ");
    label += &format!(" · {}", row.resolution);
    if row.eye_radius > 0.0 {
        label += &format!(" · {} m", row.eye_radius);
    }
    label
}

/// Writes the pictures as PNG files into a folder and puts them into the report.
///
/// # Errors
/// Names the file that cannot be written.
pub fn write_pictures(report: &mut Report, outcome: &Outcome, folder: &Path) -> anyhow::Result<()> {
    std::fs::create_dir_all(folder).with_context(|| format!("cannot create folder {}", folder.display()))?;
    for shown in &outcome.pictures {
        let png = shown.picture.png();
        if png.is_empty() {
            continue;
        }
        let title = match &shown.setting {
            Some(setting) => format!("{}: {}, view {}", setting.label(), shown.name, shown.view),
            None => format!("{}, view {}", shown.name, shown.view),
        };
        // Names of settings are letters, digits and what separates them.
        let plain: String = title.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '-' }).collect();
        let parts: Vec<&str> = plain.split('-').filter(|part| !part.is_empty()).collect();
        let path = folder.join(format!("{}.png", parts.join("-")));
        std::fs::write(&path, &png).with_context(|| format!("cannot write {}", path.display()))?;
        if report.pictures.len() < PICTURES_MAX {
            report.pictures.push(Picture::new(title, &png));
        }
    }
    Ok(())
}

/// What the rows say, in words. Of an adapter in `software` no speed is told.
fn headline(outcome: &Outcome, software: bool) -> String {
    let broken: Vec<String> = outcome.rows.iter().filter(|row| !row.ok).map(label).collect();
    let mut text = if broken.is_empty() {
        "No conservative culler has a wrong pixel or lost a visible primitive.".to_owned()
    } else {
        format!(
            "BROKEN: {} of {} rows promise to lose nothing and do: {}.",
            broken.len(),
            outcome.rows.len(),
            broken.join("; ")
        )
    };
    let is_timed = |row: &&super::CullRow| row.ok && !(software && row.culler.starts_with(gpu::PREFIX));
    let fastest = outcome.rows.iter().filter(is_timed).min_by(|a, b| a.total_ms.total_cmp(&b.total_ms));
    if let Some(row) = fastest {
        text += &format!(
            " Fastest to cull and draw: {} with {:.3} + {:.3} ms a frame; culling takes {:.2} max passes.",
            label(row),
            row.frame_ms,
            row.draw_ms,
            row.per_max_pass
        );
    }
    let over: Vec<f64> = outcome.rows.iter().filter_map(|row| row.over_frustum).collect();
    if let (Some(least), Some(most)) = (over.iter().copied().reduce(f64::min), over.iter().copied().reduce(f64::max)) {
        text += &format!(
            " Guessing takes {least:.2} to {most:.2} times what frustum-backface takes for as many triangles (over_frustum)."
        );
    }
    text
}
