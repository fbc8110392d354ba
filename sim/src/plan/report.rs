//! What `plan` leaves behind: the plans, the cost of each stage on and off, and how far each plan is from the best.

use crate::report::{Axis, Column, Plot, PlotKind, Point, Report, RowError, Run, Series};

use super::PlanRow;
use super::cost::{CostRow, DRAWING, PLANNED};

/// Columns of the table of plans.
pub fn plan_columns() -> Vec<Column> {
    vec![
        Column::new("world", "", "which scene"),
        Column::new("stage", "", "a part of the work that a scene may not need"),
        Column::new("verdict", "", "runs, left out, or forced"),
        Column::new("evidence", "", "what was counted"),
        Column::new("change", "", "what would change it"),
    ]
}

/// Columns of the table of costs.
pub fn cost_columns() -> Vec<Column> {
    vec![
        Column::new("world", "", "which scene"),
        Column::new("stage", "", "which stage; `drawing` are whole ways to draw"),
        Column::new("setting", "", "forced on or off (states are told where there are any); of drawing, which way"),
        Column::new("planned", "", "whether the plan chooses this"),
        Column::new("frame_ms", "ms", "time of a frame: culling and drawing on the CPU, or both ends of a run; median"),
        Column::new("frame_ms_mean", "ms", "the same, mean: counting views beside culling shows here"),
        Column::new("over_best_percent", "%", "median frame over that of the best fixed way to draw"),
        Column::new("over_frustum_percent", "%", "over that of plain frustum culling"),
        Column::new("over_everything_percent", "%", "over that of drawing everything"),
        Column::new("build_ms", "ms", "time to make what it needs"),
        Column::new(
            "memory_mb",
            "MB",
            "memory of its cells; of runs the most of tracker, image and parts, and the server's objects and sessions",
        ),
        Column::new("triangles", "", "triangles drawn a view"),
        Column::new("messages", "", "records in both directions, poses apart"),
        Column::new("bytes", "B", "bytes of datagrams, both directions"),
        Column::new("culls", "", "frames in which the client looked for what hides things"),
        Column::new("work", "", "bounds tested and nodes visited by the tracker"),
        Column::new("same", "", "whether the picture is that of everything, or of the other setting"),
    ]
}

/// Columns that a terminal has room for.
pub const SHORT: [&str; 12] = [
    "world",
    "stage",
    "setting",
    "planned",
    "frame_ms",
    "over_best_percent",
    "build_ms",
    "memory_mb",
    "messages",
    "culls",
    "work",
    "same",
];

/// Plans of one or several scenes.
///
/// # Errors
/// If a row is not flat, which is our own mistake.
pub fn plans(run: Run, rows: &[PlanRow]) -> Result<Report, RowError> {
    let mut report = Report::new(run, plan_columns());
    for row in rows {
        report.push(row)?;
    }
    let left = rows.iter().filter(|row| row.verdict.contains("out")).count();
    report.headline = format!("{left} of {} stages are left out.", rows.len());
    Ok(report)
}

/// Costs of one or several scenes.
///
/// # Errors
/// If a row is not flat, which is our own mistake.
pub fn costs(run: Run, rows: &[CostRow]) -> Result<Report, RowError> {
    let mut report = Report::new(run, cost_columns());
    for row in rows {
        report.push(row)?;
    }
    let planned = || rows.iter().filter(|row| row.setting == PLANNED);
    let worst = planned().filter_map(|row| Some((row.over_best_percent?, row))).max_by(|a, b| a.0.total_cmp(&b.0));
    report.headline = match worst {
        Some((percent, row)) => format!(
            "The plan's frame is at most {percent:.1} % over the best fixed way to draw ({}), over {} scenes; {} pictures differ.",
            row.world,
            planned().count(),
            rows.iter().filter(|row| !row.same && row.stage == DRAWING).count()
        ),
        None => String::new(),
    };
    report.plots.push(drawing_plot(rows));
    report.plots.extend(live_plots(rows));
    Ok(report)
}

fn drawing_plot(rows: &[CostRow]) -> Plot {
    let mut settings: Vec<&str> =
        rows.iter().filter(|row| row.stage == DRAWING).map(|row| row.setting.as_str()).collect();
    settings.sort_unstable();
    settings.dedup();
    let series = settings.iter().map(|&setting| {
        let own = rows.iter().filter(|row| row.stage == DRAWING && row.setting == setting);
        let point =
            |row: &CostRow| Point::labelled(0.0, 100.0 + row.over_best_percent.unwrap_or(f64::NAN), row.world.clone());
        Series::new(setting, own.map(point).collect())
    });
    Plot {
        title: "A frame by each way to draw, in percent of the best fixed one".to_owned(),
        x: Axis::linear("scene"),
        y: Axis::linear("culling and drawing (% of the best)"),
        kind: PlotKind::Bars,
        series: series.collect(),
        note: "Medians, interleaved in one process in a random order. `planned` is to stay below 110.".to_owned(),
    }
}

/// Of each live stage what on costs beyond off.
fn live_plots(rows: &[CostRow]) -> Option<Plot> {
    let of = |setting: &str| {
        let own = rows.iter().filter(|row| row.stage != DRAWING && row.setting == setting);
        let points = own.map(|row| Point::labelled(0.0, row.frame_ms, format!("{} · {}", row.world, row.stage)));
        Series::new(setting, points.collect())
    };
    let series = vec![of("on"), of("off")];
    series.iter().any(|series| !series.points.is_empty()).then(|| Plot {
        title: "Both ends of a run with a stage forced on and off".to_owned(),
        x: Axis::linear("scene and stage"),
        y: Axis::linear("server and client a frame (ms)"),
        kind: PlotKind::Bars,
        series,
        note: String::new(),
    })
}
