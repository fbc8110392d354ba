//! `track`: the paper's experiments with trackers and cullers, without a network.

// This is a driver: it may read the clock.
#![expect(clippy::disallowed_methods)]

use std::path::PathBuf;
use std::time::{Instant, SystemTime};

use clap::Args;
use eyeline_sim::cull::Registry;
use eyeline_sim::report::{Progress, Run, rfc3339, table};
use eyeline_sim::track::report::{Swept, report};
use eyeline_sim::track::{
    SWEEPS, SweepInfo, SweepOptions, TrackWorld, columns, lca_sweep, row, run as run_trackers, sweep, tables,
};
use eyeline_visibility::Resolution;

use super::resolution;

/// Options of `track`.
#[derive(Args)]
pub struct Track {
    /// Which sweeps: all, or names; a wrong name lists them. All take some minutes, most of them `promise`
    #[arg(long, value_name = "NAMES", value_delimiter = ',', default_value = "all")]
    sweep: Vec<String>,

    /// Cullers under the trackers; the first alone where a sweep compares something else
    #[arg(long, value_name = "NAMES", value_delimiter = ',', default_value = "hierarchical-z,cplp")]
    cullers: Vec<String>,

    /// Decides worlds and motion
    #[arg(long, value_name = "N", default_value_t = 5)]
    seed: u64,

    /// Frames that count in each run [default: each sweep's own]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=10_000_000))]
    frames: Option<u64>,

    /// Size of the images, pixels [default: each sweep's own]
    #[arg(long, value_name = "WIDTHxHEIGHT", value_parser = resolution)]
    resolution: Option<Resolution>,

    /// Folder for report.html, report.json and report.csv
    #[arg(long, value_name = "DIR", default_value = "out/track")]
    out: PathBuf,
}

pub const EXAMPLES: &str = "Examples:
  One of the paper's figures, with its own words beside what is measured here:
  eyeline-sim track --sweep hidden --seed 5 --out out/hidden

  What a world that grows costs in messages, and how long a bound should be valid:
  eyeline-sim track --sweep growth,validity

  Coorg & Teller's tables 1 to 3 on the made offices:
  eyeline-sim track --sweep occluders,drawing,observer

  No wrong pixel in 20,000 frames of unkind motion, over other cullers too:
  eyeline-sim track --sweep promise --cullers hierarchical-z,cplp,masked

Exits with 1, after writing the report, if a tracker broke its promise. A bar that is missed is told of in the report.";

/// Runs the sweeps, writes the report, and fails if a promise was broken.
pub fn run(options: &Track) -> anyhow::Result<()> {
    let (began, started) = (Instant::now(), rfc3339(SystemTime::now()));
    let registry = Registry::standard();
    for name in &options.cullers {
        if registry.entry(name).is_none() {
            anyhow::bail!("there is no culler `{name}`; there are {}", registry.names());
        }
    }
    let chosen = chosen(&options.sweep)?;
    let sweep_options = SweepOptions {
        cullers: options.cullers.clone(),
        seed: options.seed,
        frames: options.frames,
        resolution: options.resolution,
    };
    let planned: Vec<_> = chosen.iter().map(|info| (*info, sweep::points(info.name, &sweep_options))).collect();
    let frames: u64 =
        planned.iter().flat_map(|(_, points)| points).map(|point| point.run.settle + point.run.frames).sum();
    let without_world = chosen.iter().map(|info| match info.name {
        "lca" => lca_sweep::RUNS,
        name if tables::SWEEPS.contains(&name) => tables::frames(name, &sweep_options),
        _ => 0,
    });
    let runs: u64 = without_world.sum();
    let progress = Progress::new(frames + runs, "frames");
    let mut sweeps = Vec::with_capacity(planned.len());
    for (info, points) in planned {
        let mut rows = Vec::new();
        if info.name == "lca" {
            rows = lca_sweep::run(|| progress.inc(1));
        } else if tables::SWEEPS.contains(&info.name) {
            rows = tables::run(info.name, &sweep_options, || progress.inc(1))?;
        }
        for point in points {
            let mut world = TrackWorld::make(&point.world)?;
            for mut row in run_trackers(&mut world, &point.settings, &point.run, &registry, || progress.inc(1))? {
                row.sweep = info.name.to_owned();
                row.paper = info.paper.to_owned();
                row.x = point.x;
                rows.push(row);
            }
        }
        let findings = sweep::findings(info.name, &rows);
        sweeps.push(Swept { info, rows, findings });
    }
    progress.finish();
    let mut run = Run::here("Eyeline track", Some(options.seed), started);
    run.wall_seconds = began.elapsed().as_secs_f64();
    let report = report(run, &sweeps)?;
    let written = report.write(&options.out)?;
    for swept in &sweeps {
        let is_still = tables::SWEEPS.contains(&swept.info.name);
        let short: &[&str] = if is_still { &row::SHORT_STILL } else { &row::SHORT };
        let short: Vec<_> = columns().into_iter().filter(|column| short.contains(&column.key.as_str())).collect();
        let rows: Vec<_> = report.rows().iter().filter(|row| row.text("sweep") == swept.info.name).cloned().collect();
        super::print(&format!(
            "\n{} ({}): x is {}\n{}",
            swept.info.name,
            swept.info.paper,
            swept.info.x,
            table(&rows, &short)
        ));
        super::print(&format!("paper: {}\n", swept.info.said));
        for finding in &swept.findings {
            let mark = match finding.met {
                Some(true) => "met    ",
                Some(false) => "MISSED ",
                None => "",
            };
            super::print(&format!("here:  {mark}{}\n", finding.text));
        }
    }
    super::print(&format!("\n{}\nreport: {}\n", report.headline, written.html.display()));
    let broken: Vec<String> = sweeps
        .iter()
        .flat_map(|swept| &swept.rows)
        .filter(|row| !row.ok)
        .map(|row| format!("{} {} over {}", row.sweep, row.variant, row.culler))
        .collect();
    if !broken.is_empty() {
        anyhow::bail!(
            "{} broke a promise; see wrong_pixels_max, absent_frames_max and broken_bounds in the report",
            broken.join(", ")
        );
    }
    Ok(())
}

/// The sweeps of these names.
fn chosen(names: &[String]) -> anyhow::Result<Vec<SweepInfo>> {
    if names.iter().any(|name| name == "all") {
        return Ok(SWEEPS.to_vec());
    }
    let known = SWEEPS.map(|info| info.name).join(", ");
    names
        .iter()
        .map(|name| {
            let found = SWEEPS.iter().find(|info| info.name == name);
            found.copied().ok_or_else(|| anyhow::anyhow!("there is no sweep `{name}`; give all, or some of: {known}"))
        })
        .collect()
}
