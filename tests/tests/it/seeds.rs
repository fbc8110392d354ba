//! Hundreds of towns, each made by its seed.

use std::time::Duration;

use eyeline_client::tracking::Lead;
use eyeline_server::world::Answers;
use eyeline_sim::soak::{SoakConfig, TownRules, live, long, soak};

const SPAN: Duration = Duration::from_secs(5);

#[test]
fn three_hundred_towns_keep_every_promise() {
    // `EYELINE_SEEDS=445+1` looks at one seed.
    let range = std::env::var("EYELINE_SEEDS").ok().and_then(|range| {
        let (first, count) = range.split_once('+')?;
        Some((first.parse().ok()?, count.parse().ok()?))
    });
    let (first, count) = range.unwrap_or((0u64, 300u64));
    let summary = soak(&SoakConfig::default().with_seeds(first, count), |_| ());
    eprintln!("{:?}, least room {:?}", summary.counts, summary.least_share);
    let told: Vec<String> = summary
        .bad
        .iter()
        .take(6)
        .map(|bad| {
            format!("seed {} ({:?}): {}\n{}", bad.seed, bad.rules, bad.failures.count, bad.failures.texts.join("\n"))
        })
        .collect();
    assert!(told.is_empty(), "{} of {count} seeds fail, first:\n{}", summary.bad.len(), told.join("\n"));
    let counts = summary.counts;
    assert!(
        counts.bounds > 1_000 * count && counts.visible > 500 * count && counts.states > 500 * count,
        "the truth is not empty: {counts:?}"
    );
}

#[test]
fn the_same_seed_gives_the_same_messages_at_the_same_microsecond() {
    for seed in [2, 7, 11] {
        let [first, second] = [live(TownRules::seeded(seed), SPAN), live(TownRules::seeded(seed), SPAN)];
        assert!(first.run.messages() > 1_000);
        assert_eq!(
            (first.run.messages(), first.run.digest()),
            (second.run.messages(), second.run.digest()),
            "seed {seed}"
        );
    }
    let other = live(TownRules { seed: 3, ..TownRules::seeded(2) }, SPAN);
    assert_ne!(live(TownRules::seeded(2), SPAN).run.digest(), other.run.digest());
}

#[test]
#[ignore = "ten virtual minutes, four times over, take many real ones; `eyeline-sim soak --long` does the same"]
fn nobody_is_late_in_ten_minutes_of_sixty_four_avatars() {
    for case in long::CASES {
        let outcome = long::run(case, 0, 600, || ());
        outcome.failures.assert_none(case.name);
        assert!(outcome.counts.visible > 1_000_000);
    }
}

#[test]
fn towns_that_answer_with_the_tick_keep_every_promise_and_are_sent_a_datagram_a_tick() {
    for (seed, lead) in [(1, Lead::Auto), (5, Lead::None), (9, Lead::Auto)] {
        let run = |answers| live(TownRules { answers, lead, broadcast: false, ..TownRules::seeded(seed) }, SPAN);
        let (town, apart) = (run(Answers::Tick), run(Answers::Arrival));
        town.failures().assert_none(&format!("seed {seed}"));
        let [together, apart] = [&town, &apart].map(|town| *town.run.world().stats());
        assert!(together.datagrams_out < apart.datagrams_out, "{} {}", together.datagrams_out, apart.datagrams_out);
        // One in each tick and for each client; more only where one does not hold all that is due.
        let rounds = together.ticks * 9;
        assert!(together.datagrams_out <= rounds, "{} in {rounds}", together.datagrams_out);
    }
}
