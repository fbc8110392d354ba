//! What Prometheus is told: the counters that are there anyway, put into words when somebody asks.
//!
//! Nothing is counted for Prometheus' sake while messages are handled: the world's counters are plain numbers under the lock
//! that every driver call holds anyway. A scrape copies them under it ([`Snapshot::take`]) and makes its text afterwards, in
//! the watching thread, so that a tick waits for the copying only; how long that took is a metric itself.

use std::fmt::Error;
use std::time::{Duration, Instant};

use prometheus_client::collector::Collector;
use prometheus_client::encoding::{DescriptorEncoder, text};
use prometheus_client::metrics::MetricType;
use prometheus_client::registry::Registry;

use super::arrivals::Declined;
use super::{ArrivalCounts, Handle, Stage};
use crate::histogram::{Histogram, NUMBERS, SECONDS};
use crate::world::{Census, Limited, MessageCounts, Validity, WorldStats};

/// Everything that is told, as of one moment.
#[derive(Debug)]
pub(super) struct Snapshot {
    stage: Stage,
    world: WorldStats,
    census: Census,
    validity_periods: Histogram,
    validity_growth: Histogram,
    validity_one_in: u64,
    arrivals: ArrivalCounts,
    open: (usize, usize),
    remembered: usize,
    tick_work: Histogram,
    tick_lateness: Histogram,
    tick_period: Duration,
    tick_age: Duration,
    work: Duration,
    slow_readers: u64,
    datagrams_dropped: u64,
    packets: (u64, u64),
    round_trips: Histogram,
    held: Duration,
}

impl Snapshot {
    /// Copies what is told. The world stands still only while it is copied, which takes longer the more clients see; the
    /// metric `scrape_hold_seconds` says how long.
    pub fn take(handle: &Handle) -> Snapshot {
        let core = handle.lock();
        let started = Instant::now();
        let (world, shell) = (&core.world, &core.stats);
        let connections: Vec<quinn::Connection> = core.peers.values().map(|peer| peer.connection.clone()).collect();
        let Validity { periods, growth, .. } = world.validity();
        let mut snapshot = Snapshot {
            stage: handle.stage(),
            world: *world.stats(),
            census: world.census(),
            validity_periods: periods.clone(),
            validity_growth: growth.clone(),
            validity_one_in: world.validity().one_in(),
            arrivals: ArrivalCounts::default(),
            open: (0, 0),
            remembered: 0,
            tick_work: shell.tick_work.clone(),
            tick_lateness: shell.tick_lateness.clone(),
            tick_period: world.tick_period(),
            tick_age: Duration::ZERO,
            work: shell.work,
            slow_readers: shell.slow_readers,
            datagrams_dropped: shell.datagrams_dropped,
            packets: (shell.packets_sent, shell.packets_lost),
            round_trips: Histogram::new(SECONDS),
            held: Duration::ZERO,
        };
        snapshot.held = started.elapsed();
        drop(core);
        {
            let arrivals = handle.arrivals();
            (snapshot.arrivals, snapshot.open, snapshot.remembered) =
                (arrivals.counts, arrivals.open(), arrivals.remembered());
        }
        snapshot.tick_age = handle.life.tick_age(handle.clock.now()).0;
        // Each connection has a lock of its own, that nobody holds for long.
        for connection in connections {
            let path = connection.stats().path;
            snapshot.packets.0 += path.sent_packets;
            snapshot.packets.1 += path.lost_packets;
            snapshot.round_trips.observe(path.rtt.as_secs_f64());
        }
        snapshot
    }

    /// For how long the world stood still.
    pub fn held(&self) -> Duration {
        self.held
    }

    /// The text of a scrape, in the OpenMetrics format that [`CONTENT_TYPE`] names.
    pub fn text(self) -> Result<String, Error> {
        let mut registry = Registry::with_prefix("eyeline");
        registry.register_collector(Box::new(self));
        let mut page = String::with_capacity(32 * 1024);
        text::encode(&mut page, &registry)?;
        Ok(page)
    }
}

/// What [`Snapshot::text`] is.
pub(super) const CONTENT_TYPE: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";

type Labels<'a> = [(&'a str, &'a str)];

/// Writes metrics of one name each.
struct Page<'a>(DescriptorEncoder<'a>);

impl Page<'_> {
    fn family<V: Copy>(
        &mut self,
        name: &str,
        help: &str,
        kind: MetricType,
        rows: &[(&Labels<'_>, V)],
        mut write: impl FnMut(prometheus_client::encoding::MetricEncoder<'_>, V) -> Result<(), Error>,
    ) -> Result<(), Error> {
        let mut metric = self.0.encode_descriptor(name, help, None, kind)?;
        for &(labels, value) in rows {
            match labels {
                // Without this there would be empty braces.
                [] => return write(metric, value),
                _ => write(metric.encode_family(&labels)?, value)?,
            }
        }
        Ok(())
    }

    fn counters(&mut self, name: &str, help: &str, rows: &[(&Labels<'_>, u64)]) -> Result<(), Error> {
        self.family(name, help, MetricType::Counter, rows, |mut metric, value| {
            metric.encode_counter::<[(&str, &str); 0], u64, u64>(&value, None)
        })
    }

    fn counter(&mut self, name: &str, help: &str, value: u64) -> Result<(), Error> {
        self.counters(name, help, &[(&[], value)])
    }

    fn gauges(&mut self, name: &str, help: &str, rows: &[(&Labels<'_>, f64)]) -> Result<(), Error> {
        self.family(name, help, MetricType::Gauge, rows, |mut metric, value| metric.encode_gauge(&value))
    }

    fn gauge(&mut self, name: &str, help: &str, value: f64) -> Result<(), Error> {
        self.gauges(name, help, &[(&[], value)])
    }

    fn histogram(&mut self, name: &str, help: &str, values: &Histogram) -> Result<(), Error> {
        self.family(name, help, MetricType::Histogram, &[(&[], values)], |mut metric, values| {
            let buckets: Vec<(f64, u64)> = values.buckets().collect();
            metric.encode_histogram::<[(&str, &str); 0]>(values.sum(), values.count(), &buckets, None)
        })
    }
}

impl Collector for Snapshot {
    fn encode(&self, encoder: DescriptorEncoder<'_>) -> Result<(), Error> {
        let mut page = Page(encoder);
        self.messages(&mut page)?;
        self.clients(&mut page)?;
        self.ticks(&mut page)?;
        self.paths(&mut page)?;
        self.limits(&mut page)
    }
}

impl Snapshot {
    fn messages(&self, page: &mut Page<'_>) -> Result<(), Error> {
        let MessageCounts {
            poses,
            requests_unknown,
            requests_exposed,
            requests_expired,
            requests_violated,
            requests_for_state,
            releases,
            violation_acks,
            ..
        } = self.world.messages_in;
        let help = "Messages of clients: one is one record about one object";
        page.counters(
            "messages_in",
            help,
            &[
                (&[("kind", "pose"), ("reason", "")], poses),
                (&[("kind", "request"), ("reason", "unknown")], requests_unknown),
                (&[("kind", "request"), ("reason", "exposed")], requests_exposed),
                (&[("kind", "request"), ("reason", "expired")], requests_expired),
                (&[("kind", "request"), ("reason", "violated")], requests_violated),
                (&[("kind", "release"), ("reason", "")], releases),
                (&[("kind", "violation_ack"), ("reason", "")], violation_acks),
            ],
        )?;
        page.counter("requests_for_state", "Requests that wanted a state", requests_for_state)?;
        let MessageCounts { states, places, bounds, violations, hidden, roster, .. } = self.world.out;
        page.counters(
            "messages_out",
            "Messages to clients",
            &[
                (&[("kind", "state")], states),
                (&[("kind", "place")], places),
                (&[("kind", "bound")], bounds),
                (&[("kind", "violation")], violations),
                (&[("kind", "hidden")], hidden),
                (&[("kind", "roster")], roster),
            ],
        )?;
        let stats = &self.world;
        page.counters(
            "datagrams",
            "Datagrams",
            &[(&[("direction", "in")], stats.datagrams_in), (&[("direction", "out")], stats.datagrams_out)],
        )?;
        page.counter("datagram_out_bytes", "Payload of datagrams to clients, bytes", stats.datagram_bytes_out)?;
        page.counter("control_out", "Control messages to clients", stats.control_out)?;
        page.counter("violations", "Bounds broken: teleports, entering, leaving", stats.violations)?;
        page.counters(
            "rejected",
            "What clients said that made no sense, was too old or not theirs to say",
            &[
                (&[("what", "control")], stats.rejected_control),
                (&[("what", "datagram")], stats.rejected_datagrams),
                (&[("what", "stale_datagram")], stats.stale_datagrams),
                (&[("what", "forbidden")], stats.forbidden),
            ],
        )?;
        page.counters(
            "clamped",
            "Poses held back to what their class allows",
            &[(&[("what", "place")], stats.poses_clamped), (&[("what", "turn")], stats.turns_clamped)],
        )?;
        page.counter("withheld", "Places that clients were not entitled to; a bound was told", stats.withheld)
    }

    fn clients(&self, page: &mut Page<'_>) -> Result<(), Error> {
        let Census { greeting, watching, acting, away, leaving, objects, avatars, .. } = self.census;
        page.gauges(
            "sessions",
            "Sessions by how far they have got; those that leave count twice",
            &[
                (&[("state", "handshake")], (self.open.1.saturating_sub(greeting + watching + acting)) as f64),
                (&[("state", "greeting")], greeting as f64),
                (&[("state", "watching")], watching as f64),
                (&[("state", "acting")], acting as f64),
                (&[("state", "away")], away as f64),
                (&[("state", "leaving")], leaving as f64),
            ],
        )?;
        page.gauges(
            "objects",
            "Objects in the world",
            &[(&[("kind", "avatar")], avatars as f64), (&[("kind", "thing")], objects.saturating_sub(avatars) as f64)],
        )?;
        debug_assert_eq!(self.census.visible.buckets().count(), NUMBERS.len() + 1);
        page.histogram(
            "client_visible_objects",
            "Objects that a client is told of, by client now",
            &self.census.visible,
        )?;
        page.histogram("client_hidden_objects", "Objects that are hidden from it, by client now", &self.census.hidden)?;
        let help = "From a bound to its client's next question about the object, of a sample of both";
        page.histogram("validity_seconds", help, &self.validity_periods)?;
        page.histogram("validity_growth_metres", "By how much the bound had grown then", &self.validity_growth)?;
        page.gauge(
            "validity_sampled_one_in",
            "Pairs of client and object per one sampled",
            self.validity_one_in as f64,
        )?;
        page.counter("admitted", "Clients let in", self.world.admitted)?;
        page.counter("refused", "Clients not let in", self.world.refused)
    }

    fn ticks(&self, page: &mut Page<'_>) -> Result<(), Error> {
        page.counter("ticks", "Ticks", self.world.ticks)?;
        page.counter("ticks_missed", "Ticks skipped since the process came late", self.world.ticks_missed)?;
        page.gauge("tick_period_seconds", "World time between ticks", self.tick_period.as_secs_f64())?;
        page.gauge("tick_age_seconds", "Since the last tick ended", self.tick_age.as_secs_f64())?;
        page.histogram("tick_work_seconds", "Work of a tick, sending included", &self.tick_work)?;
        page.histogram("tick_lateness_seconds", "How late ticks began", &self.tick_lateness)?;
        page.counter(
            "work_micros",
            "Time spent in the world and in sending, microseconds",
            self.work.as_micros() as u64,
        )?;
        page.gauge("scrape_hold_seconds", "For how long this scrape held the world", self.held.as_secs_f64())?;
        let stages = [Stage::Starting, Stage::Serving, Stage::Draining, Stage::Ended];
        for stage in stages.into_iter().filter(|&stage| stage == self.stage) {
            page.gauges("stage", "How far the server has got", &[(&[("stage", stage.name())], 1.0)])?;
        }
        Ok(())
    }

    fn paths(&self, page: &mut Page<'_>) -> Result<(), Error> {
        page.histogram("rtt_seconds", "QUIC's smoothed round trip, by connection now", &self.round_trips)?;
        page.counter("packets_sent", "QUIC packets sent", self.packets.0)?;
        page.counter("packets_lost", "QUIC packets given up for lost", self.packets.1)?;
        page.counter("datagrams_lost", "Datagrams whose loss made their content due again", self.world.datagrams_lost)?;
        page.counters(
            "held_back",
            "What was not told at once",
            &[
                (&[("why", "path_full")], self.world.held_back),
                (&[("why", "byte_cap")], self.world.capped),
                (&[("why", "byte_cap_late")], self.world.capped_late),
            ],
        )?;
        page.counters(
            "dropped",
            "What was given up",
            &[(&[("what", "datagram")], self.datagrams_dropped), (&[("what", "slow_reader")], self.slow_readers)],
        )
    }

    fn limits(&self, page: &mut Page<'_>) -> Result<(), Error> {
        let kinds = Limited::ALL.map(|kind| ([("limit", kind.name())], self.world.limited.of(kind)));
        let rows = kinds.each_ref().map(|(labels, value)| (&labels[..], *value));
        page.counters("limited", "What clients asked for beyond their limits", &rows)?;
        page.counter("sent_away", "Clients that went on and on beyond their limits", self.world.busy)?;
        let ArrivalCounts { begun, retried, failed, never_in, .. } = self.arrivals;
        page.counters(
            "handshakes",
            "First packets of connections",
            &[
                (&[("what", "begun")], begun),
                (&[("what", "retried")], retried),
                (&[("what", "failed")], failed),
                (&[("what", "never_let_in")], never_in),
            ],
        )?;
        let kinds = Declined::ALL.map(|why| ([("limit", why.name())], self.arrivals.declined(why)));
        let rows = kinds.each_ref().map(|(labels, value)| (&labels[..], *value));
        page.counters("declined", "Handshakes declined", &rows)?;
        page.gauge("half_open", "Connections that have not been let in", self.open.0 as f64)?;
        page.gauge("addresses_remembered", "Addresses with limits of their own", self.remembered as f64)
    }
}
