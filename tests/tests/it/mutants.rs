//! Whatever is broken on purpose is noticed: a promise that no mutant breaks would be one that nobody checks.

use std::time::Duration;

use eyeline_sim::soak::{Mutant, SoakConfig, TownRules, hunt, live};

#[test]
fn every_mutant_is_caught() {
    let mut missed = Vec::new();
    for &mutant in Mutant::ALL {
        let config = SoakConfig::default().with_mutant(Some(mutant));
        match hunt(&config, |_| ()) {
            Some(caught) => {
                let first = caught.failures.texts.first().map_or("", String::as_str);
                eprintln!("{:22} by seed {:3}: {first}", mutant.name(), caught.seed);
            }
            None => missed.push(mutant.name()),
        }
    }
    assert!(missed.is_empty(), "not caught: {missed:?}");
    assert!(Mutant::ALL.len() >= 12);
}

#[test]
fn names_of_mutants_are_read() {
    for &mutant in Mutant::ALL {
        assert_eq!(mutant.name().parse(), Ok(mutant));
        assert!(mutant.says().contains(':'));
    }
    assert!("none-of-them".parse::<Mutant>().unwrap_err().contains("fresh-jitter"));
}

#[test]
fn broadcast_leaves_hidden_objects_no_room() {
    let town = live(TownRules { broadcast: true, ..TownRules::seeded(0) }, Duration::from_secs(5));
    assert!(town.heard.failures.count > 100, "{:?}", town.heard.failures);
    assert!(town.heard.failures.texts.iter().any(|text| text.contains("known to within")));
}
