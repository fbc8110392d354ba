//! The report of a measurement: error against run time first, then traffic.

use std::collections::BTreeSet;

use super::{MeasureConfig, MeasureRow, SweepKey, columns};
use crate::report::{Axis, Comparison, Plot, PlotKind, Point, Report, RowError, Run, Series};
use crate::stage::Stage;

/// The columns of the table on the terminal.
pub const SHORT: [&str; 11] = [
    "policy",
    "setting",
    "messages_per_client_s",
    "pushed_per_client_s",
    "hidden_caused_per_client_s",
    "udp_bytes_per_client_s",
    "missed_percent",
    "late_over_bound",
    "reveal_p99_ms",
    "overdisclosed_per_client_s",
    "client_frame_ms",
];

/// Puts rows into a report with its plots and headline.
///
/// # Errors
/// If a row is not flat; a fault of this program.
pub fn report(
    run: Run,
    stage: &Stage,
    rows: &[MeasureRow],
    config: &MeasureConfig,
    swept: Option<SweepKey>,
) -> Result<Report, RowError> {
    let mut report = Report::new(run, columns());
    report.run.notes.extend(stage.notes.iter().cloned());
    report.run.notes.push(format!(
        "world '{}': {} static triangles; {} clients; truth in bursts of {} consecutive frames, {:.0} % asked for",
        stage.model.info.name,
        stage.model.scene.triangles().len(),
        config.clients,
        config.burst_frames,
        config.truth_share * 100.0
    ));
    report.run.notes.push(format!(
        "blur {} m, bounds {}, let go after {} hidden frames, exposed bounds {} first, culling on a cube of {} px a side",
        config.blur,
        match config.growth {
            eyeline_client::tracking::Growth::AtClient => "grown at the client".to_owned(),
            eyeline_client::tracking::Growth::FixedPeriod(period) => format!("of a fixed {} ms", period.as_millis()),
        },
        config.linger_frames,
        if config.staged { "made fresh" } else { "not made fresh" },
        config.side
    ));
    if let Some(sabotage) = config.sabotage {
        report.run.notes.push(format!("SABOTAGED on purpose: {sabotage:?}; expect misses"));
    }
    for row in rows {
        report.push(row)?;
        if row.net == "quic" && row.bound_ms > 1e3 / f64::from(row.tick_hz) {
            report.run.notes.push(format!(
                "LENIENT for {}: over loopback the promise's bound came to {:.0} ms and a frame, since this machine was busy; \
                 lateness below that is not counted",
                row.policy, row.bound_ms
            ));
        }
        let frames = row.clients as f64 * row.seconds * f64::from(row.tick_hz);
        if row.frames_skipped as f64 > frames * 0.01 {
            report.run.notes.push(format!(
                "VOID for {}: this machine left out {} of {frames:.0} frames, so that it measured itself; take fewer \
                 --clients or a smaller --side",
                row.policy, row.frames_skipped
            ));
        }
    }
    report.headline = match swept {
        None => headline(rows),
        Some(key) => {
            let policies = rows.iter().map(|row| row.policy.as_str()).collect::<BTreeSet<_>>().len();
            let late: u64 = rows.iter().map(|row| row.late_over_bound).sum();
            format!(
                "{} values of {}, {policies} policies; {late} objects were drawn later than promised. {}",
                rows.len() / policies.max(1),
                key.name(),
                key.exponents(rows).unwrap_or_default()
            )
        }
    };
    report.compare(Comparison::new(&["policy"], "client_frame_ms", "missed_percent").by_series("policy"));
    let mut traffic = Plot::new(
        "Picture error against traffic",
        PlotKind::Scatter,
        Axis::log("messages per client and second"),
        Axis::linear("time that visible objects were not drawn, %"),
    );
    let mut bytes = Plot::new(
        "Disclosure against traffic",
        PlotKind::Scatter,
        Axis::log("UDP bytes per client and second"),
        Axis::linear("states of objects out of sight, per client and second"),
    );
    for row in rows {
        let name = row.policy.as_str();
        let point = Point::labelled(row.messages_per_client_s, row.missed_percent, name);
        traffic = traffic.with_series(Series::new(name, vec![point]));
        let point = Point::labelled(row.udp_bytes_per_client_s, row.overdisclosed_per_client_s, name);
        bytes = bytes.with_series(Series::new(name, vec![point]));
    }
    let bars = |name: &str, f: &dyn Fn(&MeasureRow) -> f64| {
        Series::new(name, rows.iter().map(|row| Point::bar(row.policy.as_str(), f(row))).collect())
    };
    let messages = Plot::new(
        "Messages by what they are for",
        PlotKind::StackedBars,
        Axis::linear("policy"),
        Axis::linear("messages per client and second"),
    )
    .with_series(bars("own poses", &|row| row.poses_per_client_s))
    .with_series(bars("states of shown objects", &|row| row.pushed_per_client_s))
    .with_series(bars("caused by hidden objects", &|row| row.hidden_caused_per_client_s));
    report.plots.extend(swept.into_iter().flat_map(|key| key.plots(rows)));
    report.plots.extend([messages, traffic, bytes]);
    Ok(report)
}

/// What the rows say, in words.
fn headline(rows: &[MeasureRow]) -> String {
    let of = |policy: &str| rows.iter().find(|row| row.policy == policy);
    let Some(visible) = of("visible") else { return String::new() };
    let mut text = format!("With visible a client exchanges {:.0} messages a second", visible.messages_per_client_s);
    if let Some(broadcast) = of("broadcast") {
        let ratio = broadcast.messages_per_client_s / visible.messages_per_client_s.max(1e-9);
        text += &format!(", 1/{ratio:.1} of broadcast's");
    }
    if let Some(oracle) = of("oracle") {
        let ratio = visible.messages_per_client_s / oracle.messages_per_client_s.max(1e-9);
        text += &format!(", {ratio:.2} times the oracle's");
    }
    if rows
        .iter()
        .any(|row| row.frames_skipped as f64 > row.clients as f64 * row.seconds * f64::from(row.tick_hz) * 0.01)
    {
        text = format!("VOID: this machine was too slow for so many clients (see the notes). {text}");
    }
    text += &format!(
        "; in {} frames whose truth was computed, {} objects came into view and {} were drawn later than promised.",
        visible.truth_frames, visible.reveals, visible.late_over_bound
    );
    text
}
