//! Hundreds of towns, each made by its seed.

use std::time::Duration;

use eyeline_sim::soak::{Town, TownRules};

/// Five seconds and more of a town, with a client that leaves and two that come late.
fn live(rules: TownRules) -> Town {
    let mut town = Town::new(rules);
    town.run_for(Duration::from_millis(2_400));
    town.leave(1);
    town.run_for(Duration::from_millis(300));
    town.join();
    town.run_for(Duration::from_millis(800));
    town.join();
    town.run_for(Duration::from_millis(1_700));
    town
}

#[test]
fn three_hundred_towns_keep_every_promise() {
    // `EYELINE_SEEDS=445+1` looks at one seed.
    let range = std::env::var("EYELINE_SEEDS").ok().and_then(|range| {
        let (first, count) = range.split_once('+')?;
        Some((first.parse().ok()?, count.parse().ok()?))
    });
    let (first, count) = range.unwrap_or((0u64, 300u64));
    let mut bad = Vec::new();
    let (mut bounds, mut visible, mut states, mut broken) = (0, 0, 0, 0);
    for seed in first..first + count {
        let town = live(TownRules::seeded(seed));
        if town.truth.failed > 0 {
            bad.push(format!(
                "seed {seed} ({:?}): {}\n{}",
                TownRules::seeded(seed),
                town.truth.failed,
                town.truth.failures.join("\n")
            ));
        }
        bounds += town.truth.bounds_checked;
        visible += town.truth.visible_checked;
        states += town.truth.states_checked;
        broken += town.truth.broken_believed;
    }
    eprintln!("{count} seeds: {bounds} bounds, {visible} visible, {states} states, {broken} broken bounds believed");
    assert!(
        bad.is_empty(),
        "{} of {count} seeds fail, first:\n{}",
        bad.len(),
        bad.iter().take(6).cloned().collect::<Vec<_>>().join("\n")
    );
    assert!(bounds > 1_000 * count && visible > 500 * count && states > 500 * count, "the truth is not empty");
}

#[test]
fn the_same_seed_gives_the_same_messages_at_the_same_microsecond() {
    for seed in [2, 7, 11] {
        let [first, second] = [live(TownRules::seeded(seed)), live(TownRules::seeded(seed))];
        assert!(first.run.messages() > 1_000);
        assert_eq!(
            (first.run.messages(), first.run.digest()),
            (second.run.messages(), second.run.digest()),
            "seed {seed}"
        );
    }
    let other = live(TownRules { seed: 3, ..TownRules::seeded(2) });
    assert_ne!(live(TownRules::seeded(2)).run.digest(), other.run.digest());
}
