//! Many avatars for a long time over one kind of path: nobody late at all without loss, and no later than the promise allows
//! with it.

use std::time::Duration;

use eyeline_client::tracking::{Growth, Lead};
use eyeline_protocol::WorldTime;

use super::run::{Outcome, outcome_of};
use super::town::{Town, TownRules};
use crate::virtual_net::{Fate, LinkRules, Verdict};

/// What goes wrong on the path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Case {
    /// Name in reports.
    pub name: &'static str,
    /// Share of datagrams lost, each way.
    pub loss: f64,
    /// Whether the path goes dark for five seconds once a minute.
    pub is_dark: bool,
}

/// The cases that `soak --long` runs.
pub const CASES: [Case; 4] = [
    Case { name: "no loss", loss: 0.0, is_dark: false },
    Case { name: "5 % loss", loss: 0.05, is_dark: false },
    Case { name: "20 % loss", loss: 0.2, is_dark: false },
    Case { name: "blackout", loss: 0.0, is_dark: true },
];

/// Clients that look; the other avatars of the 64 are a crowd's.
const CLIENTS: usize = 16;

/// A town of 64 avatars, a third of them adversarial, over a round trip of 50 ms with 10 ms of jitter, with a lead.
pub fn rules(case: Case, seed: u64) -> TownRules {
    let millis = Duration::from_millis;
    TownRules {
        link: LinkRules::default().with_delay(millis(25)).with_jitter(millis(5)).with_loss(case.loss),
        clients: CLIENTS,
        crowd: 64 - CLIENTS as u16,
        carts: 24,
        drift: 0.0,
        teleports: 0.0,
        away: 0.0,
        validity_max: Duration::from_secs(3600),
        growth: Growth::AtClient,
        walk_speed: 1.6,
        lead: Lead::Auto,
        ..TownRules::seeded(seed)
    }
}

/// One case for so many virtual seconds; `second` is called after each.
pub fn run(case: Case, seed: u64, seconds: u32, second: impl Fn()) -> Outcome {
    let rules = rules(case, seed);
    let mut town = Town::new(rules);
    if case.is_dark {
        town.run.intercept(|message| if is_dark(message.at) { Verdict::Instead(Fate::Drop) } else { Verdict::AsRuled });
    }
    for _ in 0..seconds {
        town.run_for(Duration::from_secs(1));
        second();
    }
    outcome_of(seed, &town)
}

/// Five seconds a minute, from the tenth on.
fn is_dark(at: WorldTime) -> bool {
    (10.0..15.0).contains(&at.seconds().rem_euclid(60.0))
}
