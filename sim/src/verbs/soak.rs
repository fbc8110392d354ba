//! `soak`: thousands of towns in virtual time, and checkers that know the truth.

use std::time::Duration;

use clap::Args;
use eyeline_sim::report::Progress;
use eyeline_sim::soak::{Mutant, Outcome, SoakConfig, Summary, hunt, long, soak};

/// Options of `soak`.
#[derive(Args)]
pub struct Soak {
    /// How many towns, each made by its seed
    #[arg(long, value_name = "N", default_value_t = 300, value_parser = clap::value_parser!(u64).range(1..))]
    runs: u64,

    /// The first seed
    #[arg(long, value_name = "SEED", default_value_t = 0)]
    seed: u64,

    /// Threads
    #[arg(long, value_name = "N", default_value_t = 2, value_parser = clap::value_parser!(u16).range(1..=1024))]
    jobs: u16,

    /// Virtual seconds of a run
    #[arg(long, value_name = "SECONDS", default_value_t = 5, value_parser = clap::value_parser!(u32).range(5..=86_400))]
    seconds: u32,

    /// Break something on purpose and see how many seeds it takes to notice: a name, or all; a wrong name lists them
    #[arg(long, value_name = "NAME")]
    mutant: Option<String>,

    /// 64 avatars over 50 ms and 10 ms of jitter with a lead, for ten minutes unless --seconds says more than 5: without loss, with
    /// 5 % and 20 %, and with five seconds of darkness
    #[arg(long, conflicts_with = "mutant")]
    long: bool,
}

pub const EXAMPLES: &str = "Examples:
  eyeline-sim soak --runs 10000
  eyeline-sim soak --seed 445 --runs 1
  eyeline-sim soak --mutant all
  eyeline-sim soak --long

Exits with 1 if a promise was broken, or if a mutant was not caught. A seed that fails is printed with the command that
replays it.";

/// Runs the towns, and fails if one broke a promise.
pub fn run(options: &Soak) -> anyhow::Result<()> {
    if options.long {
        return run_long(options);
    }
    let config = SoakConfig::default()
        .with_seeds(options.seed, options.runs)
        .with_jobs(usize::from(options.jobs))
        .with_span(Duration::from_secs(u64::from(options.seconds)));
    match options.mutant.as_deref() {
        None => run_towns(options, &config),
        Some(name) => run_mutants(name, &config),
    }
}

fn run_towns(options: &Soak, config: &SoakConfig) -> anyhow::Result<()> {
    let progress = Progress::new(options.runs, "towns");
    let seconds = options.seconds;
    let summary = soak(config, |outcome| {
        progress.inc(1);
        if outcome.failures.count > 0 {
            let replay = format!("eyeline-sim soak --seed {} --runs 1 --seconds {seconds}", outcome.seed);
            eprintln!("{}", failure(outcome, &replay));
        }
    });
    progress.finish();
    super::print(&says(&summary));
    let failed = summary.bad.len();
    anyhow::ensure!(
        failed == 0,
        "{failed} of {} towns broke a promise; the first has seed {}",
        options.runs,
        summary.bad[0].seed
    );
    Ok(())
}

fn failure(outcome: &Outcome, replay: &str) -> String {
    let Outcome { seed, failures, .. } = outcome;
    format!(
        "seed {seed}: {} promises broken, first:\n  {}\nreplay: {replay}",
        failures.count,
        failures.texts.join("\n  ")
    )
}

/// The summary in a few lines.
fn says(summary: &Summary) -> String {
    let counts = &summary.counts;
    let mut text = format!(
        "{} towns, {} failed; {} messages, {} records and {} sets of places as they arrived\n\
         contained: {} bounds in frames; {} broken ones believed until their announcement came\n\
         never late: {} object-frames in sight, {} of them not drawn yet as is allowed; {} shown states\n",
        counts.runs,
        counts.failed,
        counts.messages,
        counts.records,
        counts.sets,
        counts.bounds,
        counts.broken,
        counts.visible,
        counts.not_drawn,
        counts.states,
    );
    let share = 100.0 * counts.over_disclosed as f64 / counts.poses.max(1) as f64;
    text += &format!("told: {} poses, {share:.1} % of them asked for without being entitled", counts.poses);
    if let Some((least, seed)) = summary.least_share.filter(|(least, _)| least.is_finite()) {
        text += &format!("; the least room left was {least:.3} of what is promised (seed {seed})");
    }
    text + "\n"
}

fn run_mutants(name: &str, config: &SoakConfig) -> anyhow::Result<()> {
    let mutants: Vec<Mutant> = match name {
        "all" => Mutant::ALL.to_vec(),
        name => vec![name.parse().map_err(anyhow::Error::msg)?],
    };
    let mut missed = Vec::new();
    for mutant in mutants {
        let progress = Progress::new(config.runs, mutant.name());
        let caught = hunt(&config.clone().with_mutant(Some(mutant)), |_| progress.inc(1));
        progress.finish();
        match caught {
            Some(outcome) => {
                let after = outcome.seed.wrapping_sub(config.first) + 1;
                let first = outcome.failures.texts.first().map_or("", String::as_str);
                super::print(&format!("{:22} caught after {after:3} seeds: {first}\n", mutant.name()));
            }
            None => {
                super::print(&format!("{:22} MISSED by {} seeds ({})\n", mutant.name(), config.runs, mutant.says()));
                missed.push(mutant.name());
            }
        }
    }
    anyhow::ensure!(missed.is_empty(), "not caught: {}", missed.join(", "));
    Ok(())
}

fn run_long(options: &Soak) -> anyhow::Result<()> {
    let seconds = if options.seconds > 5 { options.seconds } else { 600 };
    let cases = long::CASES;
    let progress = Progress::new(u64::from(seconds) * cases.len() as u64, "virtual seconds");
    let mut failed = Vec::new();
    for case in cases {
        let outcome = long::run(case, options.seed, seconds, || progress.inc(1));
        let counts = &outcome.counts;
        super::print(&format!(
            "{:10} {} object-frames in sight, {} not drawn yet, {} promises broken\n",
            case.name, counts.visible, counts.not_drawn, outcome.failures.count
        ));
        if outcome.failures.count > 0 {
            let replay = format!("eyeline-sim soak --long --seed {} --seconds {seconds}", options.seed);
            eprintln!("{}", failure(&outcome, &replay));
            failed.push(case.name);
        }
    }
    progress.finish();
    anyhow::ensure!(failed.is_empty(), "promises were broken: {}", failed.join(", "));
    Ok(())
}
