//! What `stability` leaves behind: the table of cases, and the integrators' error against run time.

use crate::report::{Axis, Column, Comparison, Plot, PlotKind, Point, Report, RowError, Run, Series};

use super::CaseRow;
use super::integrators::{IntegratorRow, Method, SPAN_S, TIME_CONSTANTS};

/// What the columns of the cases mean.
pub fn columns() -> Vec<Column> {
    vec![
        Column::new("group", "", "what kind of trouble"),
        Column::new("case", "", "which"),
        Column::new("asked", "", "what is measured"),
        Column::new(
            "oracle",
            "",
            "what it is held against: exact arithmetic, a formula, a slow f64 reference, a refusal",
        ),
        Column::new("error", "", "how wrong, in the unit of `asked`"),
        Column::new("bound", "", "how wrong it may be"),
        Column::new("run_ms", "ms", "time, oracle included"),
        Column::new("ok", "", "whether error ≤ bound"),
        Column::new("said", "", "what was counted, or how it was refused"),
    ]
}

/// The columns that a terminal has room for.
pub const SHORT: [&str; 6] = ["group", "case", "error", "bound", "run_ms", "ok"];

/// One table of all cases, with the integrators' plots.
///
/// # Errors
/// If a row is not flat, which is our own mistake.
pub fn report(run: Run, rows: &[CaseRow], integrators: &[IntegratorRow]) -> Result<Report, RowError> {
    let mut report = Report::new(run, columns());
    for row in rows {
        report.push(row)?;
    }
    let failed = rows.iter().filter(|row| !row.ok).count();
    report.headline = match failed {
        0 => format!("{} cases, all within their bounds.", rows.len()),
        _ => format!("{failed} of {} cases are beyond their bounds.", rows.len()),
    };
    report.plots.extend(plots(integrators));
    Ok(report)
}

/// The integrators side by side, as a report of their own: one row a method, time constant and step.
///
/// # Errors
/// If a row is not flat, which is our own mistake.
pub fn integrators(run: Run, rows: &[IntegratorRow]) -> Result<Report, RowError> {
    let mut report = Report::new(
        run,
        vec![
            Column::new("integrator", "", "how a spring with a damper is stepped"),
            Column::new("time_constant_s", "s", "1/ω: the shorter, the stiffer"),
            Column::new("step_s", "s", "the step"),
            Column::new("error", "m", "greatest distance from the reference; none where the method blows up"),
            Column::new("run_ms", "ms", format!("time for {SPAN_S} s of motion")),
            Column::new("bounded", "", "whether it stayed within a thousand amplitudes"),
        ],
    );
    for row in rows {
        report.push(row)?;
    }
    report.compare(
        Comparison::new(&["integrator", "time_constant_s", "step_s"], "run_ms", "error").by_series("integrator"),
    );
    report.plots.extend(plots(rows));
    let ours = rows.iter().filter(|row| row.integrator == Method::Exact.name());
    let lost = |method: Method| rows.iter().filter(|row| row.integrator == method.name() && !row.bounded).count();
    report.headline = format!(
        "Of {} settings ours blows up in {}, explicit Euler in {}, semi-implicit Euler in {}, RK4 in {}.",
        ours.count(),
        lost(Method::Exact),
        lost(Method::ExplicitEuler),
        lost(Method::SemiImplicitEuler),
        lost(Method::Rk4),
    );
    Ok(report)
}

/// Error against run time, and error against stiffness at the usual tick.
fn plots(rows: &[IntegratorRow]) -> Vec<Plot> {
    const TICK_S: f64 = 0.05;
    let series = |keep: &dyn Fn(&IntegratorRow) -> bool, point: &dyn Fn(&IntegratorRow) -> Point| -> Vec<Series> {
        let of = |method: Method| {
            let own = rows.iter().filter(|row| row.integrator == method.name() && keep(row));
            Series::new(method.name(), own.map(point).collect())
        };
        Method::ALL.into_iter().map(of).collect()
    };
    let mut plots = vec![Plot {
        title: format!("Stiffness at a tick of {TICK_S} s: only what is exact for the linear part stays on the page"),
        x: Axis::log("time constant (s)"),
        y: Axis::log("greatest error (m)"),
        kind: PlotKind::Line,
        series: series(&|row| row.step_s == TICK_S, &|row| Point::new(row.time_constant_s, row.error.unwrap_or(f64::NAN))),
        note: "A spring with critical damping on a target that swings by 1 m in 4 s; the reference has a hundredth of the step. \
               Points that are missing blew up."
            .to_owned(),
    }];
    for time_constant in TIME_CONSTANTS.into_iter().filter(|constant| (1e-2..=1.0).contains(constant)) {
        let labelled = |row: &IntegratorRow| {
            Point::labelled(row.run_ms, row.error.unwrap_or(f64::NAN), format!("{} s", row.step_s))
        };
        plots.push(Plot {
            title: format!("Error against run time, time constant {time_constant} s"),
            x: Axis::log(format!("time for {SPAN_S} s of motion (ms)")),
            y: Axis::log("greatest error (m)"),
            kind: PlotKind::Line,
            series: series(&|row| row.time_constant_s == time_constant && row.bounded, &labelled),
            note: "Labels are steps. Steps at which a method blows up are left out.".to_owned(),
        });
    }
    plots
}
