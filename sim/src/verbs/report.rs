//! `report`: several runs on one page.

// This is a driver: it may read the clock.
#![expect(clippy::disallowed_methods)]

use std::path::{Path, PathBuf};
use std::time::SystemTime;

use anyhow::Context as _;
use clap::Args;
use eyeline_sim::report::{Report, Run, rfc3339};

/// Options of `report`.
#[derive(Args)]
pub struct Merge {
    /// Runs: folders with a report.json, or such files; NAME=PATH gives one a name of its own
    #[arg(value_name = "RUN", required = true)]
    runs: Vec<String>,

    /// The title of the page
    #[arg(long, value_name = "TEXT", default_value = "Eyeline: several runs")]
    title: String,

    /// Folder for report.html, report.json and report.csv
    #[arg(long, value_name = "DIR", default_value = "out/report")]
    out: PathBuf,
}

pub const EXAMPLES: &str = "Examples:
  eyeline-sim report out/cull out/stability/integrators --out out/all
  eyeline-sim report before=out/monday after=out/tuesday/report.json

Rows of all runs stand in one table, with the run that each is from; what runs compare alike, error against run time say, is one
plot and one Pareto table over all of them. Machine, commit, seed and command of each run are at the end of the page.";

/// Reads the runs and writes the page.
pub fn run(options: &Merge) -> anyhow::Result<()> {
    let mut parts: Vec<(String, Report)> = Vec::with_capacity(options.runs.len());
    for run in &options.runs {
        let (name, path) = named(run);
        let path = if path.is_dir() { path.join("report.json") } else { path };
        let report =
            Report::read(&path).with_context(|| format!("run `{run}`: give the folder or report.json of a run"))?;
        let name = name.unwrap_or_else(|| report.run.title.clone());
        // Two runs of one verb have one title; they are told apart by number.
        let taken = |name: &str| parts.iter().any(|(known, _)| known == name);
        let numbered = (2..).map(|n| format!("{name} {n}"));
        let name = std::iter::once(name.clone()).chain(numbered).find(|name| !taken(name)).unwrap_or(name);
        parts.push((name, report));
    }
    let mut merged = Report::merged(Run::here(options.title.clone(), None, rfc3339(SystemTime::now())), &parts);
    let headlines = parts.iter().filter(|(_, part)| !part.headline.is_empty());
    merged.headline = headlines.map(|(name, part)| format!("{name}: {}", part.headline)).collect::<Vec<_>>().join(" ");
    let written = merged.write(&options.out)?;
    super::print(&format!(
        "{} rows of {} runs\nreport: {}\n",
        merged.rows().len(),
        parts.len(),
        written.html.display()
    ));
    Ok(())
}

/// `NAME=PATH`, or a path. What exists under its whole name is a path, whatever is in it.
fn named(run: &str) -> (Option<String>, PathBuf) {
    match run.split_once('=') {
        Some((name, path)) if !Path::new(run).exists() && !name.is_empty() => (Some(name.to_owned()), path.into()),
        _ => (None, run.into()),
    }
}
