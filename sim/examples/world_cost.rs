//! The world's own part of a server's work, per session and tick: in instructions, or by the clock.
//!
//! ```text
//! cargo build --release -p eyeline-sim --example world_cost
//! target/release/examples/world_cost record out/feed.bin
//! target/release/examples/world_cost replay out/feed.bin
//! valgrind --tool=callgrind --toggle-collect='*measured*' target/release/examples/world_cost replay out/feed.bin
//! ```
//! The world is 16×16 rooms with 1,024 chairs; 1,000 people are in it unless a number follows `record FILE`. A second number says how many
//! of them cull, a third how many ticks pass once all are in.

#![expect(clippy::disallowed_methods, reason = "it measures")]

use std::hint::black_box;
use std::time::{Duration, Instant};

use anyhow::{Context as _, bail};
use eyeline_sim::load::feed::{Feed, FeedRules, Played, Prepared, Replayed, world};
use eyeline_sim::load::ways::WayRules;
use eyeline_sim::scene::plan::RoomsRules;
use eyeline_sim::stage::Stage;

fn main() -> anyhow::Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    match arguments[..] {
        ["record", file, ref numbers @ ..] if numbers.len() <= 3 => {
            let numbers: Result<Vec<u32>, _> = numbers.iter().map(|number| number.parse()).collect();
            let numbers = numbers.context("how many clients, how many that cull, how many ticks after all are in?")?;
            let number = |index: usize, default| numbers.get(index).copied().unwrap_or(default);
            record(file, number(0, 1000), number(1, 0), number(2, 60))
        }
        ["replay", file] => replay(file),
        _ => bail!("usage: world_cost record FILE [CLIENTS [CULLING [SETTLE_TICKS]]] | replay FILE"),
    }
}

fn stage() -> anyhow::Result<Stage> {
    Stage::made(&RoomsRules { columns: 16, rows: 16, ..RoomsRules::default() })
}

fn record(file: &str, clients: u32, culling: u32, settle_ticks: u32) -> anyhow::Result<()> {
    let ways = WayRules { ways: 64, frames: 400, period: Duration::from_millis(50), side: 64, hold: 0.0, seed: 7 };
    let rules = FeedRules { clients, culling, joins_a_tick: 20, settle_ticks, ticks: 40, ways };
    let (feed, played) = Feed::record(&stage()?, &rules)?;
    std::fs::write(file, feed.to_bytes()).with_context(|| format!("cannot write {file}"))?;
    for (how, of) in ["cull", "replay"].iter().zip(<[_; 2]>::from(played.split_at(culling as usize))) {
        let mean = |value: fn(&Played) -> u64| of.iter().map(value).sum::<u64>() as f64 / of.len().max(1) as f64;
        let (visible, told, said) = (mean(|c| c.visible as u64), mean(|c| c.records_in), mean(|c| c.records_out));
        println!("{} {how}: {visible:.1} visible at the end, {told:.0} records told, {said:.0} said", of.len());
    }
    println!("{clients} clients, {settle_ticks} ticks after the last has joined: 40 ticks to be measured in {file}");
    Ok(())
}

fn replay(file: &str) -> anyhow::Result<()> {
    let feed = Feed::from_bytes(&std::fs::read(file).with_context(|| format!("cannot read {file}"))?)?;
    let mut prepared = feed.prepare(world(&stage()?)?);
    let began = Instant::now();
    let replayed = measured(&mut prepared);
    let elapsed = began.elapsed();
    let rounds = replayed.ticks as f64 * f64::from(feed.clients());
    let each = |number: u64| number as f64 / rounds;
    println!(
        "{} sessions, {} ticks: {:.2} µs a session and tick; {:.2} datagrams of {:.0} bytes in, {:.2} of {:.0} out",
        feed.clients(),
        replayed.ticks,
        elapsed.as_secs_f64() * 1e6 / rounds,
        each(replayed.datagrams_in),
        replayed.bytes_in as f64 / replayed.datagrams_in.max(1) as f64,
        each(replayed.datagrams_out),
        replayed.bytes_out as f64 / replayed.datagrams_out.max(1) as f64,
    );
    let kept = prepared.world().memory_bytes() as f64 / 1024.0;
    println!("the world keeps {:.1} KB a session, objects and all", kept / f64::from(feed.clients()));
    Ok(())
}

/// What callgrind is told to collect.
#[inline(never)]
fn measured(prepared: &mut Prepared<'_>) -> Replayed {
    black_box(black_box(prepared).replay())
}
