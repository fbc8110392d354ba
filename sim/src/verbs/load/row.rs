//! What `load` reports.

use eyeline_sim::load::echo::Traffic;
use eyeline_sim::report::Column;
use serde::Serialize;

use super::children::{Echoed, Measured};

/// One run.
#[derive(Serialize)]
pub struct LoadRow {
    pub clients: u32,
    pub tick_p50_ms: f64,
    pub tick_p99_ms: f64,
    pub tick_max_ms: f64,
    pub half_tick_ms: f64,
    pub sent_p99_ms: f64,
    pub ticks_missed: u64,
    pub server_cpu_percent: f64,
    pub cpu_micros_a_client_tick: f64,
    pub rss_empty_kb: f64,
    pub rss_full_kb: f64,
    pub memory_kb_a_client: f64,
    pub datagrams_in_a_client_tick: f64,
    pub datagrams_out_a_client_tick: f64,
    pub swarm_cpu_percent: Option<f64>,
    pub swarm_late_p99_ms: f64,
    pub visible_mean: f64,
    pub rtt_ms: f64,
    pub stolen_percent: Option<f64>,
    pub void: bool,
}

impl LoadRow {
    pub fn of(clients: u32, measured: &Measured) -> LoadRow {
        let Measured { empty, span, told, seen } = measured;
        let traffic = measured.traffic(clients);
        LoadRow {
            clients,
            tick_p50_ms: told.tick_p50_ms,
            tick_p99_ms: told.tick_p99_ms,
            tick_max_ms: told.tick_max_ms,
            half_tick_ms: told.tick_ms / 2.0,
            sent_p99_ms: told.sent_p99_ms,
            ticks_missed: told.missed,
            server_cpu_percent: 100.0 * span.cpu_share(),
            cpu_micros_a_client_tick: 1e6 * span.cpu_share() * told.tick_ms * 1e-3 / f64::from(clients),
            rss_empty_kb: empty.rss_kb(),
            rss_full_kb: span.after.rss_kb(),
            memory_kb_a_client: span.kb_more_than(empty) / f64::from(clients),
            datagrams_in_a_client_tick: traffic.up,
            datagrams_out_a_client_tick: traffic.down,
            swarm_cpu_percent: seen.cpu_percent,
            swarm_late_p99_ms: seen.late_p99_ms,
            visible_mean: seen.visible_mean,
            rtt_ms: seen.rtt_ms,
            stolen_percent: span.stolen_percent(),
            void: seen.is_void(),
        }
    }

    pub fn columns() -> Vec<Column> {
        vec![
            Column::new("clients", "", "people, each with a connection of their own"),
            Column::new("tick_p50_ms", "ms", "work of a tick: the world's, and handing its output to QUIC; median"),
            Column::new("tick_p99_ms", "ms", "the same; one tick of a hundred took longer"),
            Column::new("tick_max_ms", "ms", "the same; the longest"),
            Column::new("half_tick_ms", "ms", "what the p99 is to stay below"),
            Column::new(
                "sent_p99_ms",
                "ms",
                "from when a tick was due until QUIC had sent all of it; one of a hundred took longer",
            ),
            Column::new("ticks_missed", "", "ticks left out because the server came late"),
            Column::new("server_cpu_percent", "%", "of the server's core"),
            Column::new(
                "cpu_micros_a_client_tick",
                "µs",
                "the server's processor time for a client and tick, QUIC included",
            ),
            Column::new("rss_empty_kb", "KB", "the server's memory without clients"),
            Column::new("rss_full_kb", "KB", "with all of them, at the end"),
            Column::new("memory_kb_a_client", "KB", "the difference for each"),
            Column::new("datagrams_in_a_client_tick", "", "from a client in a tick"),
            Column::new("datagrams_out_a_client_tick", "", "to a client in a tick"),
            Column::new("swarm_cpu_percent", "%", "of the swarm's core"),
            Column::new("swarm_late_p99_ms", "ms", "how late the swarm's frames began; one of a hundred was later"),
            Column::new("visible_mean", "", "objects in V at the end, mean"),
            Column::new("rtt_ms", "ms", "round trip as clients saw it, mean"),
            stolen_column(),
            Column::new("void", "", "whether the swarm was too late for the row to mean anything"),
        ]
    }
}

/// One pair of runs.
#[derive(Serialize)]
pub struct EchoRow {
    clients: u32,
    up: f64,
    up_bytes: usize,
    down: f64,
    down_bytes: usize,
    world_cpu_percent: f64,
    echo_cpu_percent: f64,
    pub ratio: f64,
    world_waits: f64,
    echo_waits: f64,
    world_swarm_late_p99_ms: f64,
    echo_swarm_late_p99_ms: f64,
    pub void: bool,
}

impl EchoRow {
    pub fn of(clients: u32, measured: &Measured, traffic: Traffic, echoed: &Echoed) -> EchoRow {
        let (world, echo) = (measured.span.cpu_share(), echoed.span.cpu_share());
        EchoRow {
            clients,
            up: traffic.up,
            up_bytes: traffic.up_bytes,
            down: traffic.down,
            down_bytes: traffic.down_bytes,
            world_cpu_percent: 100.0 * world,
            echo_cpu_percent: 100.0 * echo,
            ratio: world / echo,
            world_waits: measured.span.waits(),
            echo_waits: echoed.span.waits(),
            world_swarm_late_p99_ms: measured.seen.late_p99_ms,
            echo_swarm_late_p99_ms: echoed.seen.late_p99_ms,
            void: measured.seen.is_void() || echoed.seen.is_void(),
        }
    }

    pub fn columns() -> Vec<Column> {
        vec![
            Column::new("clients", "", "connections"),
            Column::new("up", "", "datagrams from a client in a tick"),
            Column::new("up_bytes", "B", "mean size of these"),
            Column::new("down", "", "datagrams to a client in a tick"),
            Column::new("down_bytes", "B", "mean size of these"),
            Column::new("world_cpu_percent", "%", "of its core that the world's server took"),
            Column::new("echo_cpu_percent", "%", "of its core that the echo took"),
            Column::new("ratio", "", "the one over the other"),
            Column::new(
                "world_waits",
                "1/s",
                "how often the world's server waited: the fewer, the more came in bunches",
            ),
            Column::new("echo_waits", "1/s", "the same for the echo"),
            Column::new(
                "world_swarm_late_p99_ms",
                "ms",
                "how late the swarm's frames began; one of a hundred was later",
            ),
            Column::new("echo_swarm_late_p99_ms", "ms", "the same for the echo's clients"),
            Column::new("void", "", "whether one of these makes the row mean nothing"),
        ]
    }
}

/// One run of an echo alone.
#[derive(Serialize)]
pub struct EchoAloneRow {
    clients: u32,
    pub echo_cpu_percent: f64,
    pub swarm_cpu_percent: Option<f64>,
    rss_empty_kb: f64,
    rss_full_kb: f64,
    pub memory_kb_a_client: f64,
    echo_swarm_late_p99_ms: f64,
    stolen_percent: Option<f64>,
    pub void: bool,
}

impl EchoAloneRow {
    pub fn of(clients: u32, echoed: &Echoed) -> EchoAloneRow {
        let Echoed { empty, span, seen } = echoed;
        EchoAloneRow {
            clients,
            echo_cpu_percent: 100.0 * span.cpu_share(),
            swarm_cpu_percent: seen.cpu_percent,
            rss_empty_kb: empty.rss_kb(),
            rss_full_kb: span.after.rss_kb(),
            memory_kb_a_client: span.kb_more_than(empty) / f64::from(clients),
            echo_swarm_late_p99_ms: seen.late_p99_ms,
            stolen_percent: span.stolen_percent(),
            void: seen.is_void(),
        }
    }

    pub fn columns() -> Vec<Column> {
        vec![
            Column::new("clients", "", "connections"),
            Column::new("echo_cpu_percent", "%", "of its core that the echo took"),
            Column::new("swarm_cpu_percent", "%", "of theirs that its clients took"),
            Column::new("rss_empty_kb", "KB", "the echo's memory without clients"),
            Column::new("rss_full_kb", "KB", "with all of them, at the end"),
            Column::new("memory_kb_a_client", "KB", "the difference for each"),
            Column::new(
                "echo_swarm_late_p99_ms",
                "ms",
                "how late the frames of its clients began; one of a hundred was later",
            ),
            stolen_column(),
            Column::new("void", "", "whether they were too late for the row to mean anything"),
        ]
    }
}

fn stolen_column() -> Column {
    let what = "of one core, taken from this machine by its host meanwhile: why a swarm may be late";
    Column::new("stolen_percent", "%", what)
}

/// One moment of a soak.
#[derive(Serialize)]
pub struct SoakRow {
    pub second: f64,
    pub rss_kb: f64,
}

impl SoakRow {
    pub fn columns() -> Vec<Column> {
        vec![Column::new("second", "s", "since all were in"), Column::new("rss_kb", "KB", "the server's memory")]
    }
}
