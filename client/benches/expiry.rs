//! Q with a million entries: what an insertion, a cancellation and an expiry cost, beside an ordered set of (time, key).
//! `cargo bench -p eyeline-client --bench expiry`. The machine's speed drifts, so only ratios within one run hold.

use std::collections::BTreeSet;
use std::time::Duration;

use divan::{Bencher, counter::ItemsCount};
use eyeline_client::tracking::ExpiryQueue;
use eyeline_protocol::WorldTime;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

const ENTRIES: u32 = 1_000_000;
/// Entries touched per sample, so that the queue's size hardly changes.
const TOUCHED: u32 = 10_000;
/// Expiries lie within a minute.
const SPAN_MICROS: i64 = 60_000_000;
const QUANTUM: Duration = Duration::from_millis(50);

fn main() {
    divan::main();
}

/// What both queues can do.
trait Queue: Clone {
    fn new() -> Self;
    fn insert(&mut self, key: u32, expires: WorldTime);
    /// `expires` is given since the ordered set can't find a key without.
    fn cancel(&mut self, key: u32, expires: WorldTime);
    fn expire(&mut self, now: WorldTime, expired: &mut Vec<u32>);
}

#[derive(Clone)]
struct Ordered(BTreeSet<(WorldTime, u32)>);

impl Queue for Ordered {
    fn new() -> Ordered {
        Ordered(BTreeSet::new())
    }

    fn insert(&mut self, key: u32, expires: WorldTime) {
        self.0.insert((expires, key));
    }

    fn cancel(&mut self, key: u32, expires: WorldTime) {
        assert!(self.0.remove(&(expires, key)));
    }

    fn expire(&mut self, now: WorldTime, expired: &mut Vec<u32>) {
        while self.0.first().is_some_and(|&(due, _)| due <= now) {
            expired.push(self.0.pop_first().expect("there is a first").1);
        }
    }
}

/// The calendar, in milliseconds of its quantum.
#[derive(Clone)]
struct Calendar<const QUANTUM_MS: u64>(ExpiryQueue<u32>);

impl<const QUANTUM_MS: u64> Queue for Calendar<QUANTUM_MS> {
    fn new() -> Self {
        Calendar(ExpiryQueue::new(Duration::from_millis(QUANTUM_MS)))
    }

    fn insert(&mut self, key: u32, expires: WorldTime) {
        self.0.insert(key, expires);
    }

    fn cancel(&mut self, key: u32, _: WorldTime) {
        assert!(self.0.cancel(key));
    }

    fn expire(&mut self, now: WorldTime, expired: &mut Vec<u32>) {
        self.0.expire(now, expired);
    }
}

type Exact = Calendar<0>;
type Quantised = Calendar<{ QUANTUM.as_millis() as u64 }>;

/// A time for each key, the same at every call.
fn times(count: u32) -> Vec<WorldTime> {
    let mut rng = Pcg64::seed_from_u64(1);
    (0..count).map(|_| WorldTime::from_micros(rng.random_range(0..SPAN_MICROS))).collect()
}

fn filled<Q: Queue>(times: &[WorldTime]) -> Q {
    let mut queue = Q::new();
    for (key, &time) in times.iter().enumerate() {
        queue.insert(key as u32, time);
    }
    queue
}

#[divan::bench(types = [Ordered, Exact, Quantised], sample_count = 20, sample_size = 1)]
fn insert<Q: Queue>(bencher: Bencher) {
    let times = times(ENTRIES + TOUCHED);
    let (held, fresh) = times.split_at(ENTRIES as usize);
    // What is used again once needs no new memory: a copy that has to grow would measure the growth.
    let mut full: Q = filled(&times);
    for (i, &time) in fresh.iter().enumerate() {
        full.cancel(ENTRIES + i as u32, time);
    }
    assert_eq!(held.len(), ENTRIES as usize);
    bencher.counter(ItemsCount::new(TOUCHED)).with_inputs(|| full.clone()).bench_local_values(|mut queue| {
        for (i, &time) in fresh.iter().enumerate() {
            queue.insert(ENTRIES + i as u32, time);
        }
        queue
    });
}

#[divan::bench(types = [Ordered, Exact, Quantised], sample_count = 20, sample_size = 1)]
fn cancel<Q: Queue>(bencher: Bencher) {
    let times = times(ENTRIES);
    let full: Q = filled(&times);
    bencher.counter(ItemsCount::new(TOUCHED)).with_inputs(|| full.clone()).bench_local_values(|mut queue| {
        for key in (0..ENTRIES).step_by((ENTRIES / TOUCHED) as usize) {
            queue.cancel(key, times[key as usize]);
        }
        queue
    });
}

#[divan::bench(types = [Ordered, Exact, Quantised], sample_count = 20, sample_size = 1)]
fn expire<Q: Queue>(bencher: Bencher) {
    let times = times(ENTRIES);
    let full: Q = filled(&times);
    // Just before the end of a bucket, so that all three expire the same keys.
    let share = i64::from(TOUCHED) * SPAN_MICROS / i64::from(ENTRIES) - 1;
    bencher.counter(ItemsCount::new(TOUCHED)).with_inputs(|| full.clone()).bench_local_values(|mut queue| {
        let mut expired = Vec::new();
        queue.expire(WorldTime::from_micros(share), &mut expired);
        (queue, expired)
    });
}
