//! What `cargo run --release` does: a furnished building of 10×10 rooms, 32 people who walk through it, 400 chairs, and
//! the three policies side by side over loopback QUIC.

// This is a driver: it may read the clock.
#![expect(clippy::disallowed_methods)]

use std::path::Path;
use std::time::{Instant, SystemTime};

use crate::measure::{self, MeasureConfig, Net, report};
use crate::report::{Run, rfc3339, table};
use crate::scene::plan::RoomsRules;
use crate::stage::Stage;

/// Ours, the baseline and the lower limit. What distance and tables do takes longer to tell than a demo should.
const POLICIES: [&str; 3] = ["visible", "broadcast", "oracle"];

/// Runs the demo and writes its report into `out`; returns what to print.
///
/// # Errors
/// If the network or the disk does not let it.
pub fn run(out: &Path) -> anyhow::Result<String> {
    let config = MeasureConfig::default();
    let rules = RoomsRules { columns: 10, rows: 10, seed: config.seed, ..RoomsRules::default() };
    let stage = Stage::made(&rules)?;
    measure_all(&stage, None, &config, &Net::Quic, &POLICIES, out, "Eyeline demo")
}

/// Measures each policy in turn and writes one report; returns the table, the headline and where the report is.
///
/// # Errors
/// If the network or the disk does not let it.
pub fn measure_all(
    stage: &Stage,
    crowd: Option<&crate::stage::Crowd>,
    config: &MeasureConfig,
    net: &Net,
    policies: &[&str],
    out: &Path,
    title: &str,
) -> anyhow::Result<String> {
    let (began, started) = (Instant::now(), rfc3339(SystemTime::now()));
    let mut rows = Vec::new();
    for policy in policies {
        rows.push(measure::measure(stage, crowd, config, net, policy)?);
    }
    let mut run = Run::here(title, Some(config.seed), started);
    run.wall_seconds = began.elapsed().as_secs_f64();
    let report = report::report(run, stage, &rows, config)?;
    let written = report.write(out)?;
    let columns: Vec<_> =
        measure::columns().into_iter().filter(|column| report::SHORT.contains(&column.key.as_str())).collect();
    Ok(format!("{}\n{}\nreport: {}\n", table(report.rows(), &columns), report.headline, written.html.display()))
}
