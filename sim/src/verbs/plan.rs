//! `plan`: what a scene needs, and what leaving it in would cost.

// This is a driver: it may read the clock.
#![expect(clippy::disallowed_methods)]

use std::fmt::Write as _;
use std::path::PathBuf;
use std::time::{Instant, SystemTime};

use clap::Args;
use eyeline_protocol::PlanSwitch;
use eyeline_sim::cull::world::MADE;
use eyeline_sim::plan::cost::{self, CostConfig, CostRow, DRAWING};
use eyeline_sim::plan::report::{SHORT, cost_columns, costs, plans};
use eyeline_sim::plan::{LIVE_STAGES, PlanRow, Planner};
use eyeline_sim::report::{Progress, Run, rfc3339, table};
use eyeline_visibility::Resolution;

use super::resolution;

/// Options of `plan`.
#[derive(Args)]
pub struct PlanVerb {
    /// Scenes: .glb or .gltf files, or made worlds: building, city, engine, office, seminar, tower, vessels, rooms or room
    #[arg(value_name = "FILE|NAME", required_unless_present = "all")]
    scenes: Vec<String>,

    /// All made worlds, and the files that are named
    #[arg(long)]
    all: bool,

    /// What is forced: auto, full, or single stages on or off, as in occlusion=off,tracker=on
    #[arg(long, value_name = "auto|full|STAGE=on,…", default_value_t)]
    plan: PlanSwitch,

    /// Run each stage on and off as well, and the plan against each fixed way to draw
    #[arg(long)]
    cost: bool,

    /// Print the plans as JSON instead of tables
    #[arg(long)]
    json: bool,

    /// Views that are counted and timed
    #[arg(long, value_name = "N", default_value_t = 8, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    views: u32,

    /// Size of the image
    #[arg(long, value_name = "WIDTHxHEIGHT", default_value = "512x512", value_parser = resolution)]
    resolution: Resolution,

    /// With --cost: times that each view is drawn by each way; its time is their median
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    repeats: u32,

    /// With --cost: virtual time of each run of server and client, seconds
    #[arg(long, value_name = "SECONDS", default_value_t = 10.0, value_parser = eyeline_server::app::number(0.1..=3600.0, "s"))]
    seconds: f64,

    /// Decides where cameras stand, and who moves where
    #[arg(long, value_name = "N", default_value_t = 7)]
    seed: u64,

    /// Folder for report.html, report.json and report.csv; the costs' own in `cost`
    #[arg(long, value_name = "DIR", default_value = "out/plan")]
    out: PathBuf,
}

pub const EXAMPLES: &str = "Examples:
  eyeline-sim plan rooms
  eyeline-sim plan oa_dm2.glb --json
  eyeline-sim plan vessels --plan occlusion=on

  What leaving it in costs, stage by stage, and how far the plan is from the best fixed choice:
  eyeline-sim plan rooms --cost --out out/plan
  eyeline-sim plan --all --cost oa_dm2.glb sponza.glb

Evidence is counted, never timed: one scene has one plan on every machine. Times are medians, interleaved in one process. Exits
with 1, after writing the report, if a picture is not the same with a stage and without it.";

/// Prints plans, and what leaving it in costs.
pub fn run(options: &PlanVerb) -> anyhow::Result<()> {
    let (began, started) = (Instant::now(), rfc3339(SystemTime::now()));
    let made = MADE.iter().filter(|_| options.all).map(|name| (*name).to_owned());
    let scenes: Vec<String> = made.chain(options.scenes.iter().cloned()).collect();
    let config = CostConfig {
        repeats: options.repeats as usize,
        seconds: options.seconds,
        seed: options.seed,
        switch: options.plan,
    };
    let rounds = if options.cost { options.repeats as usize + 1 + LIVE_STAGES.len() } else { 0 } + 1;
    let progress = Progress::new((scenes.len() * rounds) as u64, "planning");
    let (mut rows, mut costed, mut text) = (Vec::new(), Vec::new(), String::new());
    for scene in &scenes {
        let planner = Planner::open(scene, options.views, options.seed, options.resolution)?;
        let plan = planner.plan(options.plan, options.seed)?;
        progress.inc(1);
        let _ = writeln!(text, "{}\n{plan}", planner.world.name);
        rows.extend(PlanRow::all(&planner.world.name, &plan));
        if options.cost {
            costed.extend(cost::drawing(&planner, &config, || progress.inc(1))?);
            costed.extend(cost::live(&planner, &config, || progress.inc(1))?);
        }
    }
    progress.finish();
    let named = |title: &str| {
        let mut run = Run::here(title, Some(options.seed), started.clone());
        run.wall_seconds = began.elapsed().as_secs_f64();
        run
    };
    let report = plans(named("Eyeline plans"), &rows)?;
    let mut written = report.write(&options.out)?;
    if options.json {
        super::print(&format!("{}\n", serde_json::to_string_pretty(&rows)?));
    } else {
        super::print(&text);
    }
    if options.cost {
        let report = costs(named("Eyeline: the cost of leaving in"), &costed)?;
        written = report.write(&options.out.join("cost"))?;
        if !options.json {
            let short: Vec<_> =
                cost_columns().into_iter().filter(|column| SHORT.contains(&column.key.as_str())).collect();
            super::print(&format!("{}\n{}\n", table(report.rows(), &short), report.headline));
        }
    }
    if !options.json {
        super::print(&format!("report: {}\n", written.html.display()));
    }
    // Where a plan runs a stage because it is needed, to force it off loses something by its nature.
    let broken = |row: &&CostRow| !row.same && (row.stage == DRAWING || row.planned && row.setting == "off");
    let name = |row: &CostRow| format!("{} {}={}", row.world, row.stage, row.setting);
    let differ: Vec<String> = costed.iter().filter(broken).map(name).collect();
    anyhow::ensure!(differ.is_empty(), "the picture is another one: {}", differ.join(", "));
    Ok(())
}
