//! `measure`: policies side by side, with the truth beside them.

// This is a driver: it may read the clock.
#![expect(clippy::disallowed_methods)]

use std::path::PathBuf;
use std::time::{Duration, Instant};

use anyhow::Context;
use clap::{Args, ValueEnum};
use eyeline_client::tracking::{Growth, Lead, Sabotage};
use eyeline_server::app::number;
use eyeline_sim::demo;
use eyeline_sim::measure::{MeasureConfig, Net};
use eyeline_sim::scene::plan::RoomsRules;
use eyeline_sim::stage::{POLICIES, Stage};
use eyeline_sim::trace::Trace;
use eyeline_sim::virtual_net::LinkRules;
use eyeline_visibility::{EyeRegion, Resolution};
use glam::DVec3;

use super::place::Place;
use super::{pair, resolution};

/// Options of `measure`.
#[derive(Args)]
pub struct Measure {
    /// The model: a .glb or .gltf. What moves in it is said by NAME.world.toml beside it; avatars stand at the places of
    /// NAME.places.json, or walk if NAME.rooms.json is there
    #[arg(long, value_name = "FILE", conflicts_with = "rooms")]
    world: Option<PathBuf>,

    /// What moves, if not in NAME.world.toml
    #[arg(long, value_name = "FILE", requires = "world")]
    world_file: Option<PathBuf>,

    /// Instead of a file, a made building of so many furnished rooms
    #[arg(long, value_name = "COLUMNSxROWS", default_value = "10x10", value_parser = columns_by_rows)]
    rooms: (u32, u32),

    /// A recorded crowd that walks through the world besides
    #[arg(long, value_name = "FILE")]
    trace: Option<PathBuf>,

    #[command(flatten)]
    place: Place,

    /// Policies to compare, in this order: visible, broadcast, oracle
    #[arg(long, value_name = "NAMES", value_delimiter = ',', default_value = "visible,broadcast,oracle",
        value_parser = POLICIES)]
    policies: Vec<String>,

    /// Watching clients [default: 32, or as many as the world has places or this machine can cull for in real time, if that
    /// is less]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=4096))]
    clients: Option<u32>,

    /// Avatars in all; those without a watching client walk inside the server [default: one for each client]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=65_536))]
    avatars: Option<u32>,

    /// Decides motion, starts, the network in virtual time and the choice of frames
    #[arg(long, value_name = "N", default_value_t = 7)]
    seed: u64,

    /// Measured time, seconds
    #[arg(long, value_name = "SECONDS", default_value_t = 10.0, value_parser = number(0.5..=86_400.0, "s"))]
    seconds: f64,

    /// Time that is run first and not measured, seconds
    #[arg(long, value_name = "SECONDS", default_value_t = 2.0, value_parser = number(0.1..=3600.0, "s"))]
    warm_up: f64,

    /// Ticks and frames a second, Hz
    #[arg(long, value_name = "HZ", default_value_t = 20, value_parser = clap::value_parser!(u32).range(1..=240))]
    tick_hz: u32,

    /// Size of the frames, pixels; they are 90° across
    #[arg(long, value_name = "WIDTHxHEIGHT", default_value = "320x240", value_parser = resolution)]
    resolution: Resolution,

    /// quic: real QUIC over loopback in real time. sim: a simulated network in virtual time
    #[arg(long, value_enum, default_value_t = NetName::Quic)]
    net: NetName,

    /// Round trip of the simulated network, milliseconds
    #[arg(long, value_name = "MS", default_value_t = 0.5, value_parser = number(0.0..=10_000.0, "ms"))]
    rtt: f64,

    /// Jitter of the simulated network, milliseconds, each way
    #[arg(long, value_name = "MS", default_value_t = 0.0, value_parser = number(0.0..=10_000.0, "ms"))]
    jitter: f64,

    /// Share of datagrams that the simulated network loses, 0 to 1, each way
    #[arg(long, value_name = "SHARE", default_value_t = 0.0, value_parser = number(0.0..=0.9, ""))]
    loss: f64,

    /// Least radius within which a hidden object's place stays uncertain, metres
    #[arg(long, value_name = "METRES", default_value_t = 1.0, value_parser = number(0.0..=1000.0, "m"))]
    blur: f64,

    /// Bound what follows a preset path, and what nobody moves, by its class's speed only
    #[arg(long)]
    no_swept: bool,

    /// A fixed validity period, as in the paper, milliseconds [default: bounds grow at the client]
    #[arg(long, value_name = "MS", value_parser = number(1.0..=3.6e6, "ms"))]
    fixed_validity: Option<f64>,

    /// Ask for states at once where a fresh bound might do
    #[arg(long)]
    no_staged: bool,

    /// How far ahead clients ask about what they could see: auto, a round trip, its jitter and a frame; none; or milliseconds
    #[arg(long, value_name = "LEAD", default_value = "none")]
    lead: Lead,

    /// Frames that something must be hidden before updates are declined
    #[arg(long, value_name = "N", default_value_t = 2, value_parser = clap::value_parser!(u32).range(1..=1000))]
    linger_frames: u32,

    /// Pixels a side of the six images that decide what is hidden
    #[arg(long, value_name = "PIXELS", default_value_t = 128, value_parser = clap::value_parser!(u32).range(8..=1024))]
    side: u32,

    /// Share of frames that the truth is computed for, 0 to 1
    #[arg(long, value_name = "SHARE", default_value_t = 0.1, value_parser = number(0.0..=1.0, ""))]
    truth_share: f64,

    /// Break the trackers on purpose: drop-exposures, late-one-tick or freeze-clock. The report must show misses
    #[arg(long, value_name = "HOW")]
    sabotage: Option<Sabotage>,

    /// Folder for report.html, report.json and report.csv
    #[arg(long, value_name = "DIR", default_value = "out/measure")]
    out: PathBuf,
}

/// How the parts are connected.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum NetName {
    /// Real QUIC over loopback, in real time
    Quic,
    /// A simulated network in virtual time: the same seed gives the same messages
    Sim,
}

pub const EXAMPLES: &str = "Examples:
  eyeline-sim measure --world oa_dm2.glb --trace students03_obsmat.txt --seconds 20 --out out/dm2
  eyeline-sim measure --rooms 16x16 --clients 64 --net sim --rtt 50 --jitter 10 --loss 0.02
  eyeline-sim measure --policies visible --sabotage drop-exposures      (must show misses)";

fn columns_by_rows(text: &str) -> Result<(u32, u32), String> {
    let rooms = pair(text).filter(|&(columns, rows)| (1..=200).contains(&columns) && (1..=200).contains(&rows));
    rooms.ok_or_else(|| "give columns and rows from 1 to 200, as in 10x10".to_owned())
}

/// As many clients as one core can cull for in real time, and `most` at the most: more would measure the machine.
fn fitting_clients(stage: &mut Stage, options: &Measure, most: usize) -> anyhow::Result<usize> {
    let spec = &stage.model.spec;
    let height = DVec3::Y * spec.avatar.eye_height - stage.anchor();
    let eyes: Vec<DVec3> =
        spec.spawns.iter().take(64).map(|spawn| DVec3::from_array(spawn.position) + height).collect();
    let mut scratch = stage.all_round.scratch(options.side);
    let mut cull_s = 0.0;
    // Twice, to warm up.
    for _ in 0..2 {
        let started = Instant::now();
        for &eye in &eyes {
            stage.all_round.cull(EyeRegion::point(eye), &mut scratch)?;
        }
        cull_s = started.elapsed().as_secs_f64() / eyes.len().max(1) as f64;
    }
    let fitting = BUSY / (f64::from(options.tick_hz) * (cull_s + CLIENT_S));
    if fitting >= most as f64 {
        return Ok(most);
    }
    let clients = (fitting as usize).max(1);
    stage.notes.push(format!(
        "{clients} clients instead of {most}, since culling takes {:.2} ms a frame here; --clients or --side choose otherwise",
        cull_s * 1e3
    ));
    Ok(clients)
}

/// Share of a core that culling and tracking may take.
const BUSY: f64 = 0.6;

/// What a client's frame costs besides culling, seconds: tracking and QUIC, with room for what the demo shows.
const CLIENT_S: f64 = 0.3e-3;

/// Measures.
pub fn run(options: &Measure) -> anyhow::Result<()> {
    let mut stage = match &options.world {
        Some(world) => Stage::load(world, options.world_file.as_deref())?,
        None => {
            let (columns, rows) = options.rooms;
            Stage::made(&RoomsRules { columns, rows, seed: options.seed, ..RoomsRules::default() })?
        }
    };
    let mut crowd = None;
    if let Some(file) = &options.trace {
        let trace = Trace::read(file)?;
        let (with_crowd, placed) =
            stage.with_crowd(trace, options.place.placement()).with_context(|| file.display().to_string())?;
        stage = with_crowd;
        crowd = Some(placed);
    }
    let clients = match options.clients {
        Some(clients) => clients as usize,
        None => {
            let places = stage.model.spec.spawns.len().clamp(1, 32);
            match options.net {
                NetName::Sim => places,
                NetName::Quic => fitting_clients(&mut stage, options, places)?,
            }
        }
    };
    let config = MeasureConfig {
        clients,
        residents: options.avatars.map_or(0, |avatars| (avatars as usize).saturating_sub(clients)),
        seed: options.seed,
        warm_up: Duration::from_secs_f64(options.warm_up),
        window: Duration::from_secs_f64(options.seconds),
        tick_hz: options.tick_hz,
        resolution: options.resolution,
        side: options.side,
        truth_share: options.truth_share,
        blur: options.blur,
        swept: !options.no_swept,
        growth: options
            .fixed_validity
            .map_or(Growth::AtClient, |millis| Growth::FixedPeriod(Duration::from_secs_f64(millis * 1e-3))),
        linger_frames: options.linger_frames,
        staged: !options.no_staged,
        lead: options.lead,
        sabotage: options.sabotage,
        ..MeasureConfig::default()
    };
    let millis = |value: f64| Duration::from_secs_f64(value * 1e-3);
    let net = match options.net {
        NetName::Quic => Net::Quic,
        NetName::Sim => Net::Sim(
            LinkRules::default()
                .with_delay(millis(options.rtt / 2.0))
                .with_jitter(millis(options.jitter))
                .with_loss(options.loss),
        ),
    };
    let policies: Vec<&str> = options.policies.iter().map(String::as_str).collect();
    let text = demo::measure_all(&stage, crowd.as_ref(), &config, &net, &policies, &options.out, "Eyeline measure")?;
    super::print(&text);
    Ok(())
}
