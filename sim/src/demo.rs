//! What `cargo run --release` does: a furnished building of 10×10 rooms, 32 people who walk through it, 400 chairs, and
//! the three policies side by side over loopback QUIC.

// This is a driver: it may read the clock.
#![expect(clippy::disallowed_methods)]

use std::path::Path;
use std::time::{Instant, SystemTime};

use crate::measure::{self, MeasureConfig, Net, SweepKey, report};
use crate::report::{Run, rfc3339, table};
use crate::scene::plan::RoomsRules;
use crate::stage::{Crowd, Stage};

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
    let case = Case { stage, crowd: None, config, net: Net::Quic };
    measure_all(&case, &POLICIES, out, "Eyeline demo")
}

/// One setting of a measurement, ready to be run.
pub struct Case {
    /// The world.
    pub stage: Stage,
    /// A recorded crowd besides.
    pub crowd: Option<Crowd>,
    /// The settings.
    pub config: MeasureConfig,
    /// How the parts are connected.
    pub net: Net,
}

/// Measures each policy in turn and writes one report; returns the table, the headline and where the report is.
///
/// # Errors
/// If the network or the disk does not let it.
pub fn measure_all(case: &Case, policies: &[&str], out: &Path, title: &str) -> anyhow::Result<String> {
    measure_sweep(policies, None, case, std::iter::empty(), out, title)
}

/// The same for each value of a sweep: the `first`, and the `rest` one after the other.
///
/// # Errors
/// If the network or the disk does not let it.
pub fn measure_sweep(
    policies: &[&str],
    key: Option<SweepKey>,
    first: &Case,
    rest: impl Iterator<Item = anyhow::Result<Case>>,
    out: &Path,
    title: &str,
) -> anyhow::Result<String> {
    let (began, started) = (Instant::now(), rfc3339(SystemTime::now()));
    let mut rows = Vec::new();
    let mut measure = |case: &Case| -> anyhow::Result<()> {
        for policy in policies {
            rows.push(measure::measure(&case.stage, case.crowd.as_ref(), &case.config, &case.net, policy)?);
        }
        Ok(())
    };
    measure(first)?;
    for case in rest {
        measure(&case?)?;
    }
    let mut run = Run::here(title, Some(first.config.seed), started);
    run.wall_seconds = began.elapsed().as_secs_f64();
    let report = report::report(run, &first.stage, &rows, &first.config, key)?;
    let written = report.write(out)?;
    let columns: Vec<_> = measure::columns()
        .into_iter()
        .filter(|column| {
            report::SHORT.contains(&column.key.as_str()) || key.is_some() && SWEPT.contains(&column.key.as_str())
        })
        .collect();
    Ok(format!("{}\n{}\nreport: {}\n", table(report.rows(), &columns), report.headline, written.html.display()))
}

/// Columns of the table on the terminal that only a sweep needs.
const SWEPT: [&str; 6] = ["clients", "avatars", "hidden_mean", "rtt_ms", "loss", "lead_ms"];
