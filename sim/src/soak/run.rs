//! Many towns, each made by its seed, on all cores; and how many it takes to catch a mutant.

use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

use super::failures::Failures;
use super::mutant::Mutant;
use super::town::{Town, TownRules};

/// Which towns, and for how long.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct SoakConfig {
    /// The first seed.
    pub first: u64,
    /// How many seeds.
    pub runs: u64,
    /// Threads.
    pub jobs: usize,
    /// Virtual time of a run; at least 5 s.
    pub span: Duration,
    /// Damage.
    pub mutant: Option<Mutant>,
}

impl Default for SoakConfig {
    fn default() -> SoakConfig {
        SoakConfig { first: 0, runs: 300, jobs: 2, span: Duration::from_secs(5), mutant: None }
    }
}

impl SoakConfig {
    /// Sets the seeds.
    pub fn with_seeds(self, first: u64, runs: u64) -> SoakConfig {
        SoakConfig { first, runs, ..self }
    }

    /// Sets the number of threads.
    pub fn with_jobs(self, jobs: usize) -> SoakConfig {
        SoakConfig { jobs, ..self }
    }

    /// Sets the virtual time of a run.
    pub fn with_span(self, span: Duration) -> SoakConfig {
        SoakConfig { span, ..self }
    }

    /// Breaks something.
    pub fn with_mutant(self, mutant: Option<Mutant>) -> SoakConfig {
        SoakConfig { mutant, ..self }
    }
}

/// What was checked, in numbers.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SoakCounts {
    /// Runs.
    pub runs: u64,
    /// Runs in which something was wrong.
    pub failed: u64,
    /// Messages that arrived.
    pub messages: u64,
    /// Bounds that were compared with the truth in a frame.
    pub bounds: u64,
    /// Object-frames in which an object was truly visible.
    pub visible: u64,
    /// Of these, the ones in which it was not drawn yet.
    pub not_drawn: u64,
    /// Shown states that were compared with the truth.
    pub states: u64,
    /// Object-frames in which a broken bound was believed.
    pub broken: u64,
    /// Records that were compared with the truth as they arrived.
    pub records: u64,
    /// Sets of places that were measured.
    pub sets: u64,
    /// Poses that were told, and of those the ones without entitlement.
    pub poses: u64,
    /// Poses that were told without entitlement.
    pub over_disclosed: u64,
}

impl SoakCounts {
    fn add(&mut self, other: &SoakCounts) {
        let SoakCounts {
            runs,
            failed,
            messages,
            bounds,
            visible,
            not_drawn,
            states,
            broken,
            records,
            sets,
            poses,
            over_disclosed,
        } = *other;
        self.runs += runs;
        self.failed += failed;
        self.messages += messages;
        self.bounds += bounds;
        self.visible += visible;
        self.not_drawn += not_drawn;
        self.states += states;
        self.broken += broken;
        self.records += records;
        self.sets += sets;
        self.poses += poses;
        self.over_disclosed += over_disclosed;
    }
}

/// What came of one seed.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// The seed.
    pub seed: u64,
    /// What it made.
    pub rules: TownRules,
    /// What was wrong.
    pub failures: Failures,
    /// What was checked.
    pub counts: SoakCounts,
    /// The least share of the promised room that a hidden object was left.
    pub least_share: f64,
}

/// What came of many.
#[derive(Clone, Debug, Default)]
pub struct Summary {
    /// Runs in which something was wrong, by seed.
    pub bad: Vec<Outcome>,
    /// What was checked in all.
    pub counts: SoakCounts,
    /// The least share of the promised room that a hidden object was left, and with which seed.
    pub least_share: Option<(f64, u64)>,
}

/// `span` of a town, at least 5 s, with a client that leaves and two that come late.
pub fn live(rules: TownRules, span: Duration) -> Town {
    let mut town = Town::new(rules);
    town.run_for(Duration::from_millis(2_400));
    town.leave(1);
    town.run_for(Duration::from_millis(300));
    town.join();
    town.run_for(Duration::from_millis(800));
    town.join();
    town.run_for(span.saturating_sub(Duration::from_millis(3_500)).max(Duration::from_millis(1_700)));
    town
}

/// One seed.
pub fn run_seed(seed: u64, config: &SoakConfig) -> Outcome {
    let rules = TownRules { mutant: config.mutant, ..TownRules::seeded(seed) };
    outcome_of(seed, &live(rules, config.span))
}

/// What came of a town so far.
pub(super) fn outcome_of(seed: u64, town: &Town) -> Outcome {
    let failures = town.failures();
    let (truth, heard) = (&town.truth, &town.heard.counts);
    let counts = SoakCounts {
        runs: 1,
        failed: u64::from(failures.count > 0),
        messages: town.run.messages(),
        bounds: truth.bounds_checked,
        visible: truth.visible_checked,
        not_drawn: truth.not_drawn,
        states: truth.states_checked,
        broken: truth.broken_believed,
        records: heard.records,
        sets: heard.sets,
        poses: heard.poses,
        over_disclosed: heard.over_disclosed,
    };
    Outcome { seed, rules: town.rules().clone(), failures, counts, least_share: town.heard.least_share }
}

/// All seeds, on `jobs` threads; `done` hears of each as it ends, in no order.
pub fn soak(config: &SoakConfig, done: impl Fn(&Outcome) + Sync) -> Summary {
    let summary = Mutex::new(Summary::default());
    each(config, |outcome| {
        done(&outcome);
        let mut summary = summary.lock().expect("nothing panics while it holds the lock");
        summary.counts.add(&outcome.counts);
        if summary.least_share.is_none_or(|(least, _)| outcome.least_share < least) {
            summary.least_share = Some((outcome.least_share, outcome.seed));
        }
        if outcome.failures.count > 0 {
            summary.bad.push(outcome);
        }
        true
    });
    let mut summary = summary.into_inner().expect("nothing panics while it holds the lock");
    summary.bad.sort_by_key(|outcome| outcome.seed);
    summary
}

/// The least seed of those that ran which catches the configured mutant. Stops at the first.
pub fn hunt(config: &SoakConfig, done: impl Fn(&Outcome) + Sync) -> Option<Outcome> {
    let caught: Mutex<Option<Outcome>> = Mutex::new(None);
    each(config, |outcome| {
        done(&outcome);
        let is_caught = outcome.failures.count > 0;
        let mut caught = caught.lock().expect("nothing panics while it holds the lock");
        if is_caught && caught.as_ref().is_none_or(|known| outcome.seed < known.seed) {
            *caught = Some(outcome);
        }
        !is_caught
    });
    caught.into_inner().expect("nothing panics while it holds the lock")
}

/// Runs seeds until `take` says no. Each town lives on one thread.
fn each(config: &SoakConfig, take: impl Fn(Outcome) -> bool + Sync) {
    let next = AtomicU64::new(0);
    let is_over = AtomicBool::new(false);
    std::thread::scope(|scope| {
        for _ in 0..config.jobs.max(1) {
            scope.spawn(|| {
                while !is_over.load(Ordering::Relaxed) {
                    let number = next.fetch_add(1, Ordering::Relaxed);
                    if number >= config.runs {
                        break;
                    }
                    if !take(run_seed(config.first.wrapping_add(number), config)) {
                        is_over.store(true, Ordering::Relaxed);
                    }
                }
            });
        }
    });
}
