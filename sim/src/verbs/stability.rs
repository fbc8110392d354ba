//! `stability`: every case in which numbers can go wrong, against an oracle.

// This is a driver: it may read the clock.
#![expect(clippy::disallowed_methods)]

use std::path::PathBuf;
use std::time::{Instant, SystemTime};

use clap::Args;
use eyeline_sim::report::{Progress, Run, rfc3339, table};
use eyeline_sim::stability::integrators::{Method, STEPS, TIME_CONSTANTS, compare};
use eyeline_sim::stability::report::{SHORT, columns, integrators, report};
use eyeline_sim::stability::{CaseRow, cases};

/// Options of `stability`.
#[derive(Args)]
pub struct Stability {
    /// Only these groups; a wrong name lists them
    #[arg(long, value_name = "NAMES", value_delimiter = ',', default_value = "all")]
    groups: Vec<String>,

    /// Folder for report.html, report.json and report.csv, and the integrators' own in `integrators`
    #[arg(long, value_name = "DIR", default_value = "out/stability")]
    out: PathBuf,
}

pub const EXAMPLES: &str = "Examples:
  eyeline-sim stability --out out/stability
  eyeline-sim stability --groups stiff,clock

Each case asks one thing of hard numbers, measures one error and states its bound; what it is held against is said in the column
`oracle`. Beside the cases stands error against run time of the server's integrator for springs and of three from textbooks.

Exits with 1, after writing the report, if a case is beyond its bound, panics, or is not refused where it should be.";

/// Runs the cases, writes the reports, and fails if one failed.
pub fn run(options: &Stability) -> anyhow::Result<()> {
    let (began, started) = (Instant::now(), rfc3339(SystemTime::now()));
    let mut cases = cases();
    let mut groups: Vec<&str> = cases.iter().map(|case| case.group).collect();
    groups.dedup();
    if options.groups != ["all"] {
        if let Some(unknown) = options.groups.iter().find(|group| !groups.contains(&group.as_str())) {
            anyhow::bail!("there is no group `{unknown}`; there are all, {}", groups.join(", "));
        }
        cases.retain(|case| options.groups.iter().any(|group| group == case.group));
    }
    let points = TIME_CONSTANTS.len() * STEPS.len() * Method::ALL.len();
    let progress = Progress::new((cases.len() + points) as u64, "cases");
    let mut rows = Vec::with_capacity(cases.len());
    // A panic is a failed case and told of as one.
    let hook = std::panic::take_hook();
    std::panic::set_hook(Box::new(|_| {}));
    for case in &cases {
        let start = Instant::now();
        let finding = case.find();
        rows.push(CaseRow::new(case, finding, start.elapsed().as_secs_f64() * 1e3));
        progress.inc(1);
    }
    std::panic::set_hook(hook);
    let mut compared = Vec::with_capacity(points);
    for method in Method::ALL {
        for time_constant in TIME_CONSTANTS {
            for step_s in STEPS {
                compared.push(compare(method, time_constant, step_s, || began.elapsed().as_secs_f64()));
                progress.inc(1);
            }
        }
    }
    progress.finish();
    let named = |title: &str| {
        let mut run = Run::here(title, None, started.clone());
        run.wall_seconds = began.elapsed().as_secs_f64();
        run
    };
    let beside = integrators(named("Eyeline integrators"), &compared)?;
    beside.write(&options.out.join("integrators"))?;
    let report = report(named("Eyeline stability"), &rows, &compared)?;
    let written = report.write(&options.out)?;
    let short: Vec<_> = columns().into_iter().filter(|column| SHORT.contains(&column.key.as_str())).collect();
    super::print(&table(report.rows(), &short));
    let failed: Vec<&CaseRow> = rows.iter().filter(|row| !row.ok).collect();
    for row in &failed {
        super::print(&format!(
            "FAILED {}: {}: {} where {} is allowed; {}\n",
            row.group, row.case, row.error, row.bound, row.said
        ));
    }
    super::print(&format!("\n{}\n{}\nreport: {}\n", report.headline, beside.headline, written.html.display()));
    anyhow::ensure!(
        failed.is_empty(),
        "{} of {} cases failed; the first is {}",
        failed.len(),
        rows.len(),
        failed[0].case
    );
    Ok(())
}
