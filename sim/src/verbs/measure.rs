//! `measure`: policies side by side, with the truth beside them.

// This is a driver: it may read the clock.
#![expect(clippy::disallowed_methods)]

use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::Context;
use clap::{Args, ValueEnum};
use eyeline_client::tracking::{Growth, Lead, Sabotage};
use eyeline_protocol::Interest;
use eyeline_server::app::number;
use eyeline_server::policy::{PolicySettings, PvsTable};
use eyeline_server::world::Answers;
use eyeline_sim::bake::{BakeConfig, bake};
use eyeline_sim::demo::{self, Case};
use eyeline_sim::measure::{self, MeasureConfig, Net, Sweep, SweepKey, fit};
use eyeline_sim::scene::plan::RoomsRules;
use eyeline_sim::stage::{Crowd, POLICIES, Stage};
use eyeline_sim::trace::Trace;
use eyeline_sim::virtual_net::LinkRules;
use eyeline_visibility::{EyeRegion, Resolution};
use glam::DVec3;

use super::place::Place;
use super::{pair, resolution};

/// Options of `measure`.
#[derive(Args, Clone)]
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

    /// So many copies of that crowd, apart in the world and shifted in time, to fill it
    #[arg(long, value_name = "N", default_value_t = 1, requires = "trace", value_parser = clap::value_parser!(u32).range(1..=64))]
    trace_copies: u32,

    #[command(flatten)]
    place: Place,

    /// Policies to compare, in this order: visible, broadcast, oracle, radius, grid, pvs
    #[arg(long, value_name = "NAMES", value_delimiter = ',', default_value = "visible,broadcast,oracle",
        value_parser = POLICIES)]
    policies: Vec<String>,

    /// For the policy radius: how far from the eye an object is told of, metres. auto: the least that misses nobody here, found
    /// by a run in virtual time
    #[arg(long, value_name = "METRES|auto", default_value = "auto", value_parser = setting)]
    radius: Setting,

    /// For the policy radius: how much farther what is told of may go, as a share of the radius
    #[arg(long, value_name = "SHARE", default_value_t = PolicySettings::default().hysteresis, value_parser = number(0.0..=10.0, ""))]
    hysteresis: f64,

    /// For the policy grid: side of a square, metres. auto: the least that misses nobody here
    #[arg(long, value_name = "METRES|auto", default_value = "auto", value_parser = setting)]
    grid_cell: Setting,

    /// For the policy pvs: the table that `bake` made [default: one is baked and written to the --out folder]
    #[arg(long, value_name = "FILE")]
    pvs: Option<PathBuf>,

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

    /// quic: real QUIC over loopback in real time, through a relay if a path is described. sim: a simulated network in virtual
    /// time. sim-quic: the same with QUIC's own handshakes, loss recovery and congestion control
    #[arg(long, value_enum, default_value_t = NetName::Quic)]
    net: NetName,

    /// Round trip of the simulated network or the relay, milliseconds [default: 0.5 in virtual time]
    #[arg(long, value_name = "MS", value_parser = number(0.0..=10_000.0, "ms"))]
    rtt: Option<f64>,

    /// Jitter of the simulated network or the relay, milliseconds, each way
    #[arg(long, value_name = "MS", default_value_t = 0.0, value_parser = number(0.0..=10_000.0, "ms"))]
    jitter: f64,

    /// Share of datagrams that the simulated network or the relay loses, 0 to 1, each way
    #[arg(long, value_name = "SHARE", default_value_t = 0.0, value_parser = number(0.0..=0.9, ""))]
    loss: f64,

    /// When the server answers requests: on arrival, or with the tick
    #[arg(long, value_name = "WHEN", default_value_t = Answers::default())]
    answers: Answers,

    /// Least radius within which a hidden object's place stays uncertain, metres
    #[arg(long, value_name = "METRES", default_value_t = 1.0, value_parser = number(0.0..=1000.0, "m"))]
    blur: f64,

    /// Bound what follows a preset path, and what nobody moves, by its class's speed only
    #[arg(long)]
    no_swept: bool,

    /// Let the server look for itself whether a client may see what it asks the place of
    #[arg(long)]
    audit: bool,

    /// Tell states only when what is drawn would be wrong by more than so many pixels [default: at each change]
    #[arg(long, value_name = "PX", value_parser = number(0.0..=1000.0, "px"))]
    dead_reckoning: Option<f64>,

    /// Most bytes a second to one client [default: no limit]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1000..))]
    bytes_per_second: Option<u32>,

    /// A fixed validity period, as in the paper, milliseconds [default: bounds grow at the client]
    #[arg(long, value_name = "MS", value_parser = number(1.0..=3.6e6, "ms"))]
    fixed_validity: Option<f64>,

    /// Ask for states at once where a fresh bound might do
    #[arg(long)]
    no_staged: bool,

    /// How far ahead clients ask about what they could see: auto, a round trip, its jitter and a frame; none; or milliseconds
    #[arg(long, value_name = "LEAD", default_value = "none")]
    lead: Lead,

    /// Which directions clients hear of: around, since a turn of the head beats any lead, or frustum, the paper's
    #[arg(long, value_name = "DIRECTIONS", default_value = "around", value_parser = interest)]
    interest: Interest,

    /// Frames that something must be hidden before updates are declined
    #[arg(long, value_name = "N", default_value_t = 2, value_parser = clap::value_parser!(u32).range(1..=1000))]
    linger_frames: u32,

    /// Pixels a side of the six images that decide what is hidden
    #[arg(long, value_name = "PIXELS", default_value_t = 128, value_parser = clap::value_parser!(u32).range(8..=1024))]
    side: u32,

    /// Share of frames that the truth is computed for, 0 to 1
    #[arg(long, value_name = "SHARE", default_value_t = 0.1, value_parser = number(0.0..=1.0, ""))]
    truth_share: f64,

    /// Break the trackers on purpose: drop-exposures, late-one-tick, freeze-clock, point-lead or sampled-lead. The report must show misses
    #[arg(long, value_name = "HOW")]
    sabotage: Option<Sabotage>,

    /// Try several values of one setting, as in rtt=0,50,100: rooms (a side, at constant density), avatars, clients, rtt, loss,
    /// lead or blur
    #[arg(long, value_name = "NAME=VALUES")]
    sweep: Option<Sweep>,

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
    /// The same with QUIC's own handshakes, loss recovery and congestion control
    SimQuic,
}

/// A setting that can be found.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Setting {
    /// The least that misses nobody.
    Auto,
    /// A given one.
    Metres(f64),
}

fn setting(text: &str) -> Result<Setting, String> {
    if text == "auto" {
        return Ok(Setting::Auto);
    }
    number(0.01..=1e7, "m")(text).map(Setting::Metres).map_err(|error| format!("{error}, or auto"))
}

/// The settings of the policies that are measured. What is to be found is found here, and noted.
fn policy_settings(
    options: &Measure,
    stage: &mut Stage,
    crowd: Option<&Crowd>,
    config: &MeasureConfig,
    net: &Net,
) -> anyhow::Result<PolicySettings> {
    let mut settings = PolicySettings::default().with_hysteresis(options.hysteresis);
    let is_measured = |name: &str| options.policies.iter().any(|policy| policy == name);
    let autos = [("radius", options.radius), ("grid", options.grid_cell)];
    let found = if autos.iter().any(|&(name, setting)| is_measured(name) && setting == Setting::Auto) {
        let found = fit(stage, crowd, config, net)?;
        stage.notes.push(format!(
            "radius and grid are set to the least that misses nobody, all round, in {} frames of this motion under broadcast in \
             virtual time: {:.2} m and squares of {:.2} m. An object must have been told of up to {} ms \
             before it is seen, and either may be {:.2} m from where it was then",
            found.frames,
            found.radius,
            found.cell,
            found.wait.as_millis(),
            found.margin
        ));
        Some(found)
    } else {
        None
    };
    match (options.radius, &found) {
        (Setting::Metres(radius), _) => settings = settings.with_radius(radius),
        (Setting::Auto, Some(found)) => settings = settings.with_radius(found.radius),
        (Setting::Auto, None) => {}
    }
    match (options.grid_cell, &found) {
        (Setting::Metres(cell), _) => settings = settings.with_cell(cell),
        (Setting::Auto, Some(found)) => settings = settings.with_cell(found.cell),
        (Setting::Auto, None) => {}
    }
    if is_measured("pvs") {
        let table = match &options.pvs {
            Some(path) => PvsTable::read(path)?,
            None => {
                let table = bake(stage, &BakeConfig { seed: options.seed, ..BakeConfig::default() })?;
                let path = options.out.join("world.pvs");
                table.write(&path)?;
                stage.notes.push(format!("the table of pvs was baked into {}", path.display()));
                table
            }
        };
        table.check_world(&stage.model.info)?;
        let facts = table.facts();
        stage.notes.push(format!(
            "pvs: {} cells of {} m, from {} sampled eyes in {} of them; a cell sees {:.1} % of all, mean. Sampled: it may miss, and \
             missed_percent says how much",
            table.grid().cells(),
            table.grid().cell(),
            facts.eyes,
            facts.cells_seen_from,
            table.share_seen() * 100.0
        ));
        settings = settings.with_pvs(Arc::new(table));
    }
    Ok(settings)
}

pub const EXAMPLES: &str = "Examples:
  eyeline-sim measure --world oa_dm2.glb --trace students03_obsmat.txt --seconds 20 --out out/dm2
  eyeline-sim measure --rooms 16x16 --clients 64 --net sim --rtt 50 --jitter 10 --loss 0.02
  eyeline-sim measure --net sim --rooms 4x4 --avatars 64 --clients 16 --sweep rooms=4,8,16 --policies visible,broadcast
  eyeline-sim measure --rooms 16x16 --clients 64 --net sim --policies visible,broadcast,radius,grid,pvs
  eyeline-sim measure --net sim --rtt 50 --jitter 10 --sweep lead=none,40,80,auto --policies visible
  eyeline-sim measure --policies visible --sabotage drop-exposures      (must show misses)";

pub const WHY_EXAMPLES: &str = "Examples:
  eyeline-sim why 3 12 --rooms 4x4 --clients 8 --at 2.5
  eyeline-sim why 0 chair.17 --rtt 50 --lead auto --seed 9";

fn interest(text: &str) -> Result<Interest, String> {
    match text {
        "around" => Ok(Interest::Around),
        "frustum" => Ok(Interest::Frustum),
        other => Err(format!("'{other}' is not around or frustum")),
    }
}

/// The value of `--rooms`.
pub fn columns_by_rows(text: &str) -> Result<(u32, u32), String> {
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

/// The measurement that the options ask for.
fn prepare(options: &Measure) -> anyhow::Result<Case> {
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
        let (with_crowd, placed) = stage
            .with_crowd(trace, options.place.placement(), options.trace_copies as usize)
            .with_context(|| file.display().to_string())?;
        stage = with_crowd;
        crowd = Some(placed);
    }
    let clients = match options.clients {
        Some(clients) => clients as usize,
        None => {
            let places = stage.model.spec.spawns.len().clamp(1, 32);
            match options.net {
                NetName::Sim | NetName::SimQuic => places,
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
        answers: options.answers,
        resolution: options.resolution,
        side: options.side,
        truth_share: options.truth_share,
        blur: options.blur,
        swept: !options.no_swept,
        audit: options.audit,
        dead_reckoning_px: options.dead_reckoning,
        bytes_per_second: options.bytes_per_second,
        growth: options
            .fixed_validity
            .map_or(Growth::AtClient, |millis| Growth::FixedPeriod(Duration::from_secs_f64(millis * 1e-3))),
        linger_frames: options.linger_frames,
        staged: !options.no_staged,
        lead: options.lead,
        interest: options.interest,
        sabotage: options.sabotage,
        ..MeasureConfig::default()
    };
    let millis = |value: f64| Duration::from_secs_f64(value * 1e-3);
    let is_virtual = options.net != NetName::Quic;
    let link = LinkRules::default()
        .with_delay(millis(options.rtt.unwrap_or(if is_virtual { 0.5 } else { 0.0 }) / 2.0))
        .with_jitter(millis(options.jitter))
        .with_loss(options.loss);
    let net = match options.net {
        NetName::Quic if link == LinkRules::default() => Net::Quic,
        NetName::Quic => Net::QuicOver(link),
        NetName::Sim => Net::Sim(link),
        NetName::SimQuic => Net::SimQuic(link),
    };
    let policy = policy_settings(options, &mut stage, crowd.as_ref(), &config, &net)?;
    let config = MeasureConfig { policy, ..config };
    Ok(Case { stage, crowd, config, net })
}

/// The options with one value of a sweep.
fn swept(options: &Measure, key: SweepKey, value: &str) -> anyhow::Result<Measure> {
    let mut options = options.clone();
    let whole = || value.parse::<u32>().ok().filter(|&value| value > 0);
    let real = |most: f64| value.parse::<f64>().ok().filter(|value| (0.0..=most).contains(value));
    let bad = || format!("--sweep: '{value}' is no value of {key:?}");
    match key {
        SweepKey::Rooms => {
            let side = whole().filter(|&side| side <= 200).with_context(bad)?;
            // As many to a room as before.
            let before = f64::from(options.rooms.0 * options.rooms.1);
            let avatars = options.avatars.or(options.clients).unwrap_or(32);
            let avatars = f64::from(avatars) * f64::from(side * side) / before;
            options.avatars = Some((avatars.round() as u32).max(1));
            options.rooms = (side, side);
        }
        SweepKey::Avatars => options.avatars = Some(whole().with_context(bad)?),
        SweepKey::Clients => options.clients = Some(whole().with_context(bad)?),
        SweepKey::Rtt => options.rtt = Some(real(10_000.0).with_context(bad)?),
        SweepKey::Loss => options.loss = real(0.9).with_context(bad)?,
        SweepKey::Lead => options.lead = value.parse().map_err(anyhow::Error::msg).with_context(bad)?,
        SweepKey::Blur => options.blur = real(1000.0).with_context(bad)?,
    }
    Ok(options)
}

/// Measures.
pub fn run(options: &Measure) -> anyhow::Result<()> {
    let policies: Vec<&str> = options.policies.iter().map(String::as_str).collect();
    let text = match &options.sweep {
        None => demo::measure_all(&prepare(options)?, &policies, &options.out, "Eyeline measure")?,
        Some(Sweep { key, values }) => {
            // Each value is looked at before hours go into the first.
            let all: Vec<Measure> = values.iter().map(|value| swept(options, *key, value)).collect::<Result<_, _>>()?;
            let first = prepare(&all[0])?;
            let rest = all[1..].iter().map(prepare);
            let title = "Eyeline measure: a sweep";
            demo::measure_sweep(&policies, Some(*key), &first, rest, &options.out, title)?
        }
    };
    super::print(&text);
    Ok(())
}

/// Options of `why`.
#[derive(Args)]
pub struct Why {
    /// The watching client, from 0
    viewer: usize,

    /// The object, by its id or name
    object: String,

    /// When, seconds into the measured time
    #[arg(long, value_name = "SECONDS", default_value_t = 5.0, value_parser = number(0.0..=86_400.0, "s"))]
    at: f64,

    #[command(flatten)]
    run: Measure,
}

/// Explains.
pub fn explain(options: &Why) -> anyhow::Result<()> {
    // Virtual time whatever --net says: it can be gone through again.
    let run = Measure { net: NetName::Sim, ..options.run.clone() };
    let Case { stage, crowd, config, net } = prepare(&run)?;
    let Net::Sim(link) = net else { anyhow::bail!("why runs in virtual time") };
    let policy = options.run.policies.first().map_or("visible", String::as_str);
    let at = Duration::from_secs_f64(options.at);
    let text = measure::why(&stage, crowd.as_ref(), &config, &link, policy, options.viewer, &options.object, at)?;
    super::print(&text);
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_setting_is_a_length_or_auto() {
        assert_eq!(setting("auto"), Ok(Setting::Auto));
        assert_eq!(setting("12.5"), Ok(Setting::Metres(12.5)));
        for bad in ["", "0", "-1", "nan", "inf", "Auto", "1e8"] {
            assert!(setting(bad).unwrap_err().ends_with("or auto"), "{bad}");
        }
    }
}
