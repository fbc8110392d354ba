//! The world's own part of a server's work: what recorded crowds say to it is said again, without sockets and without clients.
//! An item is one session in one tick.

use std::time::Duration;

use divan::{Bencher, counter::ItemsCount};
use eyeline_sim::load::feed::{Feed, FeedRules, world};
use eyeline_sim::load::ways::WayRules;
use eyeline_sim::scene::plan::RoomsRules;
use eyeline_sim::stage::Stage;

fn main() {
    divan::main();
}

const TICKS: u32 = 20;

#[divan::bench(args = [32, 128], sample_count = 10, sample_size = 1)]
fn session_tick(bencher: Bencher, clients: u32) {
    let ways = WayRules { ways: 16, frames: 100, period: Duration::from_millis(50), side: 64, hold: 0.0, seed: 7 };
    let rules = FeedRules { clients, culling: 0, joins_a_tick: 8, settle_ticks: 40, ticks: TICKS, ways };
    let stage = Stage::made(&RoomsRules { columns: 16, rows: 16, ..RoomsRules::default() });
    let made = stage.and_then(|stage| Ok((Feed::record(&stage, &rules)?.0, stage)));
    let (feed, stage) = made.expect("16×16 rooms are a world");
    bencher
        .counter(ItemsCount::new(clients * TICKS))
        .with_inputs(|| feed.prepare(world(&stage).expect("made above")))
        .bench_local_refs(|prepared| prepared.replay());
}
