//! A client's own part of a frame, without sockets: session, tracker and what it asks of an occlusion, in instructions.
//!
//! ```text
//! cargo build --release -p eyeline-sim --example tracker_cost
//! valgrind --tool=callgrind --toggle-collect='*client_part*' target/release/examples/tracker_cost 200
//! ```
//! So many people walk in 16×16 rooms with 1,024 chairs and play against a real world in virtual time; with a second number so
//! many of them cull, and with a third culls hold for a ball of that radius, metres. Instructions over the frames that it prints are those of a client and frame: all that it hears, decides and says.

use std::time::Duration;

use anyhow::Context as _;
use eyeline_sim::load::feed::{Feed, FeedRules, Played};
use eyeline_sim::load::ways::WayRules;
use eyeline_sim::scene::plan::RoomsRules;
use eyeline_sim::stage::Stage;

/// Few, since all of it runs under callgrind, the recording of the ways too.
const TICKS: u32 = 20;

fn main() -> anyhow::Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let clients = arguments.first().context("usage: tracker_cost CLIENTS [CULLING [HOLD]]")?;
    let clients = clients.parse().context("how many clients?")?;
    let culling = arguments.get(1).map_or(Ok(0), |culling| culling.parse()).context("how many cull?")?;
    let hold = arguments.get(2).map_or(Ok(0.0), |hold| hold.parse()).context("for how far a walk, metres?")?;
    let mut stage = Stage::made(&RoomsRules { columns: 16, rows: 16, ..RoomsRules::default() })?;
    if arguments.len() > 2 {
        stage = stage.with_rooms();
    }
    let ways = WayRules { ways: 16, frames: 40, period: Duration::from_millis(50), side: 64, hold, seed: 7 };
    let rules = FeedRules { clients, culling, joins_a_tick: 20, settle_ticks: 40, ticks: TICKS, ways };
    let (_, played) = Feed::record(&stage, &rules)?;
    let mean = |value: fn(&Played) -> u64| played.iter().map(value).sum::<u64>() as f64 / f64::from(clients.max(1));
    println!(
        "{} frames: {clients} clients, {TICKS} ticks; {:.1} visible at the end, {:.0} records told, {:.0} said",
        clients * TICKS,
        mean(|c| c.visible as u64),
        mean(|c| c.records_in),
        mean(|c| c.records_out),
    );
    Ok(())
}
