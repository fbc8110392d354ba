//! `swarm`: many people in one process, each with a client of their own.

// This is a driver: it may read the clock.
#![expect(clippy::disallowed_methods)]

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use anyhow::Context;
use clap::{Args, ValueEnum};
use eyeline_client::app::{Target, WorldOptions, number};
use eyeline_client::net::{Driver, Endpoint, FrameReport, LocalClock, run_headless};
use eyeline_client::session::{IndexMaker, Session, SessionConfig, SessionStats};
use eyeline_client::tracking::{Sabotage, TrackerConfig};
use eyeline_protocol::Welcome;
use eyeline_server::app::shutdown_signal;
use eyeline_server::spec::AvatarSpec;
use eyeline_sim::load::phase_of;
use eyeline_sim::load::process::pin_to;
use eyeline_sim::load::throng::{Outcome, Recruit, Throng, ThrongRules};
use eyeline_sim::load::ways::{Replayer, WayRules, Ways};
use eyeline_sim::motion::WalkerPose;
use eyeline_sim::people::{FrameHook, Ground, Person};
use eyeline_sim::report::{Column, Progress, Row, table};
use eyeline_sim::scene::plan::RoomPlan;
use eyeline_visibility::{Aabb, AllRound, DynamicOctree, FlatIndex};
use glam::DVec3;
use serde::Serialize;
use tokio::sync::watch;
use tokio::task::{JoinSet, LocalSet};

/// Options of `swarm`.
#[derive(Args)]
pub struct Swarm {
    #[command(flatten)]
    target: Target,

    #[command(flatten)]
    world: WorldOptions,

    /// How many of them cull for themselves; the others replay ways and exposures that are recorded before they come in,
    /// through trackers of their own. Needs rooms to walk in [default: all]
    #[arg(long, value_name = "N")]
    culling: Option<u32>,

    /// How many people, each with a client of their own. With --world FILE and NAME.rooms.json beside it they walk from
    /// room to room; else they stand and look around
    #[arg(long, value_name = "N", default_value_t = 32, value_parser = clap::value_parser!(u32).range(1..=4096))]
    clients: u32,

    /// How long to wait once all are in, seconds: who joins makes work for everybody, and that is not what is measured
    #[arg(long, value_name = "SECONDS", default_value_t = 2.0, value_parser = number(0.0..=1e6, "s"))]
    settle: f64,

    /// How long to stay and measure then, seconds
    #[arg(long, value_name = "SECONDS", default_value_t = 20.0, value_parser = number(0.1..=1e6, "s"))]
    seconds: f64,

    /// Decides who walks and looks where
    #[arg(long, value_name = "N", default_value_t = 7)]
    seed: u64,

    /// Pixels a side of the six images that decide what is hidden; more hides more and costs time
    #[arg(long, value_name = "PIXELS", default_value_t = 128, value_parser = clap::value_parser!(u32).range(8..=1024))]
    side: u32,

    /// How those who cull find out what is hidden: by six images that hold all that hides, or through the doors between cells that
    /// are cut at walls, which costs a fraction but where there are rooms alone tells as much. auto asks doors where
    /// NAME.rooms.json is beside the world
    #[arg(long, value_name = "HOW", default_value = "auto")]
    culler: CullerChoice,

    /// Half of the walk that one look through doors does for, metres: it is for all eyes in a ball with this radius. A larger one
    /// looks less often and hides less; what reaches farther than people keep off walls shows what is behind them. 0 looks anew
    /// for each frame
    #[arg(long, value_name = "METRES", default_value_t = HOLD, value_parser = number(0.0..=100.0, "m"))]
    hold: f64,

    /// Frames a second of each client, Hz
    #[arg(long, value_name = "HZ", default_value_t = 20.0, value_parser = number(0.1..=240.0, "Hz"))]
    frame_hz: f64,

    /// Every second so many of those who replay leave and join anew, so many come back over another connection, and so many are
    /// put elsewhere
    #[arg(long, value_name = "N", default_value_t = 0.0, value_parser = number(0.0..=1000.0, "1/s"))]
    churn: f64,

    /// Keep to this core, counted from 0 [default: any]
    #[arg(long, value_name = "CORE")]
    core: Option<usize>,

    /// Write the summary's row into this file as JSON, for `load`
    #[arg(long, value_name = "FILE", hide = true)]
    row: Option<PathBuf>,

    /// Exit with 0 even if frames began too late for the numbers to mean anything
    #[arg(long)]
    late_ok: bool,

    /// Break the tracker on purpose: drop-exposures, late-one-tick or freeze-clock
    #[arg(long, value_name = "HOW")]
    sabotage: Option<Sabotage>,
}

/// How people cull.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum CullerChoice {
    /// Through doors where there are rooms.
    Auto,
    /// Through doors.
    Doors,
    /// By images.
    Image,
}

impl CullerChoice {
    /// What is said for it.
    pub fn name(self) -> &'static str {
        match self {
            CullerChoice::Auto => "auto",
            CullerChoice::Doors => "doors",
            CullerChoice::Image => "image",
        }
    }
}

/// Where walkers go it does for about three frames, at 20 a second, and they are told of hardly more.
pub const HOLD: f64 = 0.1;

pub const EXAMPLES: &str = "Examples:
  eyeline-sim swarm --server-file out/ready.txt --world out/rooms.glb
  eyeline-sim swarm --connect 127.0.0.1:4433 --fingerprint 11c4…d6b9 --clients 100 --seconds 60
  eyeline-sim swarm --server-file out/ready.txt --world out/rooms.glb --clients 1000 --culling 32 --seconds 60
  eyeline-sim swarm --server-file out/ready.txt --clients 4 --side 256 --sabotage drop-exposures

Exits with 1 if frames began too late for the numbers to mean anything.";

/// A run whose frames came later than this in one of a hundred cases measured the machine, not the clients.
pub const LATE_MAX: Duration = Duration::from_millis(5);

/// Said when the measurement begins, for `load`.
pub const ALL_IN: &str = "all are in\n";

/// What the clients' frames add up to, from the moment when all are in and have settled.
#[derive(Default)]
struct Frames {
    is_measured: bool,
    late: Vec<Duration>,
    cull: Duration,
    track: Duration,
    /// Of each client, by its number: what it had counted, and the frames that it had left out, at its first measured frame
    /// and at its newest.
    counted: BTreeMap<usize, [(SessionStats, u64); 2]>,
}

impl Frames {
    fn note(&mut self, number: usize, session: &Session, report: &FrameReport) {
        if !self.is_measured {
            return;
        }
        self.late.push(report.late);
        self.cull += report.cull;
        self.track += report.track;
        let now = (*session.stats(), report.skipped);
        let counted = self.counted.entry(number).or_insert([now, now]);
        if counted[1].0.records_out > now.0.records_out || counted[1].1 > now.1 {
            // Another session, or another run of it: what the one before counted goes with it.
            counted[0] = now;
        }
        counted[1] = now;
    }

    /// The sum of what a counter gained.
    fn gained(&self, counter: impl Fn(&(SessionStats, u64)) -> u64) -> u64 {
        self.counted.values().map(|[first, last]| counter(last) - counter(first)).sum()
    }
}

/// The summary's one row.
#[derive(Serialize)]
struct SwarmRow {
    clients: usize,
    seconds: f64,
    frames: u64,
    skipped: u64,
    late_p50_ms: f64,
    late_p99_ms: f64,
    client_frame_ms: f64,
    cull_ms: f64,
    messages_in_per_client_s: f64,
    messages_out_per_client_s: f64,
    visible_mean: f64,
    hidden_mean: f64,
    rtt_ms: Option<f64>,
}

fn columns() -> Vec<Column> {
    vec![
        Column::new("clients", "", "clients that ran to the end"),
        Column::new("seconds", "s", "for which they ran"),
        Column::new("frames", "", "frames of all clients"),
        Column::new("skipped", "", "frames left out because the process came late"),
        Column::new("late_p50_ms", "ms", "how late a frame began, median"),
        Column::new("late_p99_ms", "ms", "how late a frame began, one of a hundred was later"),
        Column::new("client_frame_ms", "ms", "culling and tracking of a frame, mean"),
        Column::new("cull_ms", "ms", "of that, culling"),
        Column::new("messages_in_per_client_s", "1/s", "records received"),
        Column::new("messages_out_per_client_s", "1/s", "records sent, poses included"),
        Column::new("visible_mean", "", "objects in V at the end, mean"),
        Column::new("hidden_mean", "", "objects known only by a bound at the end, mean"),
        Column::new("rtt_ms", "ms", "round trip, mean"),
    ]
}

/// Runs a swarm.
pub fn run(options: &Swarm) -> anyhow::Result<()> {
    options.target.require();
    if let Some(core) = options.core {
        pin_to(core)?;
    }
    let plan = match &options.world.world {
        Some(path) => RoomPlan::beside(path)?.map(Arc::new),
        None => None,
    };
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    runtime.block_on(LocalSet::new().run_until(all(options, plan)))
}

async fn all(options: &Swarm, plan: Option<Arc<RoomPlan>>) -> anyhow::Result<()> {
    let shutdown = shutdown_signal()?;
    tokio::pin!(shutdown);
    let (address, trust) = options.target.resolve()?;
    let token = options.target.token()?;
    let period = Duration::from_secs_f64(1.0 / options.frame_hz);
    let endpoint = Endpoint::new(trust.clone(), address)?;
    let clock = LocalClock::default();
    let sabotage = options.sabotage;
    let session = move |number: usize, index: IndexMaker| {
        let tracker = TrackerConfig::default().with_frame(period).with_sabotage(sabotage);
        let config = SessionConfig::default()
            .with_name(format!("swarm {number}"))
            .with_token(token.clone())
            .with_tracker(tracker);
        Session::new(config, index)
    };
    let octree = |bounds: Aabb| -> IndexMaker { Box::new(move || Box::new(DynamicOctree::new(bounds))) };

    // The first client fetches the scene for all.
    let mut first = endpoint.connect(address, session(0, octree(Aabb::EMPTY)), clock).await?;
    let scene = first.scene(&options.world.source()).await?;
    let welcome = first.session.welcome().context("no welcome")?.clone();
    let bounds = scene.bounds();
    let asks_doors = match options.culler {
        CullerChoice::Auto => plan.is_some(),
        CullerChoice::Doors => true,
        CullerChoice::Image => false,
    };
    let all_round = tokio::task::spawn_blocking(move || match asks_doors {
        true => AllRound::among_rooms(&scene),
        false => AllRound::new(&scene),
    });
    let all_round = all_round.await?;
    let ground = ground(&welcome, plan, all_round);
    let how = if ground.plan.is_some() { "walk from room to room" } else { "stand and look around" };
    super::print(&format!(
        "{} at {address}: policy {}, {} objects; {} people {how}\n",
        welcome.world.name, welcome.policy, welcome.objects, options.clients
    ));
    let culling = options.culling.map_or(options.clients, |culling| culling.min(options.clients)) as usize;
    let replaying = options.clients as usize - culling;
    let ways = match replaying {
        0 => None,
        _ => Some(Arc::new(record(&ground, bounds, options, period).await?)),
    };
    let frames = Arc::new(Mutex::new(Frames::default()));
    let (stop, stopped) = watch::channel(false);
    let mut clients: JoinSet<anyhow::Result<Vec<Outcome>>> = JoinSet::new();
    let begin = clock.now() + Duration::from_millis(50);
    let hook = {
        let frames = frames.clone();
        move |number: usize| -> FrameHook {
            let frames = frames.clone();
            Box::new(move |session: &mut Session, report: &FrameReport, _: &WalkerPose| {
                frames.lock().unwrap_or_else(PoisonError::into_inner).note(number, session, report);
            })
        }
    };
    let Swarm { seed, side, hold, .. } = *options;
    // The first plays through a shell like any client's, and from the moment when it is in: who waited for the last would not
    // read what it is told of those who join.
    let player = move |number: usize, turn: usize| -> Box<dyn Driver> {
        match &ways {
            Some(ways) if number >= culling => {
                let walker = number - culling + 37 * turn;
                Box::new(Replayer::new(ways.clone(), walker, replaying, Some(hook(number))))
            }
            _ => Box::new(Person::on(&ground, seed, number, side, Some(hook(number))).with_hold(hold)),
        }
    };
    {
        let mut connection = first;
        let phase = begin + period.mul_f64(phase_of(0));
        let mut stopped = stopped.clone();
        let mut player = player(0, 0);
        clients.spawn_local(async move {
            let passed = clock.now().since(phase).as_secs_f64() / period.as_secs_f64();
            let due = phase + period.mul_f64(passed.ceil());
            // The sender outlives every client.
            let end = async { drop(stopped.wait_for(|&stop| stop).await) };
            let ran = run_headless(&mut connection, player.as_mut(), period, due, end).await;
            ran.context("client 0")?;
            let outcome = Outcome {
                round_trip: connection.session.round_trip().map(|(smoothed, _)| smoothed),
                counts: connection.session.tracker().map_or((0, 0, 0), |tracker| tracker.counts()),
            };
            connection.close().await;
            Ok(vec![outcome])
        });
    }
    if options.clients > 1 {
        let rules = ThrongRules {
            address,
            trust,
            first: 1,
            end: options.clients as usize,
            period,
            begin,
            churn: options.churn,
            steady: culling,
            seed,
        };
        let recruiter = move |number: usize, turn: usize| {
            let index: IndexMaker = match number >= culling {
                true => Box::new(|| Box::new(FlatIndex::default())),
                false => octree(bounds),
            };
            Recruit { session: session(number, index), player: player(number, turn) }
        };
        let mut throng = Throng::new(rules, clock, Box::new(recruiter))?;
        let (tell, mut told) = tokio::sync::oneshot::channel::<()>();
        let mut stopped = stopped.clone();
        clients.spawn_local(async move {
            tokio::select! {
                joined = throng.join() => joined?,
                _ = stopped.wait_for(|&stop| stop) => return Ok(throng.leave().await),
            }
            drop(tell);
            tokio::select! {
                played = throng.play() => match played? {},
                _ = stopped.wait_for(|&stop| stop) => Ok(throng.leave().await),
            }
        });
        tokio::select! {
            _ = &mut told => {}
            Some(outcome) = clients.join_next() => {
                outcome??;
                anyhow::bail!("a client left before all were in");
            }
            () = &mut shutdown => anyhow::bail!("ended before all clients were in"),
        }
    }
    tokio::time::sleep(Duration::from_secs_f64(options.settle)).await;
    let began = Instant::now();
    frames.lock().unwrap_or_else(PoisonError::into_inner).is_measured = true;
    super::print(ALL_IN);

    let end = Duration::from_secs_f64(options.seconds);
    let mut to_come = options.seconds.ceil() as u64;
    let progress = Progress::new(to_come, "seconds");
    let mut outcomes = Vec::new();
    let mut failed: Option<anyhow::Error> = None;
    let mut seconds = tokio::time::interval(Duration::from_secs(1));
    seconds.tick().await;
    let over = tokio::time::sleep(end);
    tokio::pin!(over);
    loop {
        tokio::select! {
            () = &mut over => {
                progress.inc(to_come);
                break;
            }
            () = &mut shutdown => break,
            _ = seconds.tick() => {
                progress.inc(1);
                to_come = to_come.saturating_sub(1);
            }
            // None ends by itself unless something went wrong.
            Some(outcome) = clients.join_next() => {
                failed = outcome?.err();
                break;
            }
        }
    }
    let elapsed = began.elapsed().as_secs_f64();
    let measured = std::mem::take(&mut *frames.lock().unwrap_or_else(PoisonError::into_inner));
    progress.finish();
    let _ = stop.send(true);
    while let Some(outcome) = clients.join_next().await {
        match outcome? {
            Ok(outcome) => outcomes.extend(outcome),
            Err(error) => failed = failed.or(Some(error)),
        }
    }
    endpoint.wait_idle().await;
    let (text, void) = summary(&outcomes, measured, elapsed, options.row.as_deref())?;
    super::print(&text);
    match (failed, void) {
        (Some(error), _) => Err(error),
        (None, Some(void)) if !options.late_ok => anyhow::bail!(void),
        (None, Some(void)) => {
            super::print(&format!("{void}\n"));
            Ok(())
        }
        (None, None) => Ok(()),
    }
}

/// Records the ways of those who do not cull. Takes a while, in which the first client must be heard of.
async fn record(ground: &Ground, bounds: Aabb, options: &Swarm, period: Duration) -> anyhow::Result<Ways> {
    let ways = WAYS.min(options.clients as usize);
    let Swarm { side, hold, seed, .. } = *options;
    let rules = WayRules { ways, frames: WAY_FRAMES, period, side, hold, seed };
    let (ground, began) = (ground.clone(), Instant::now());
    let ways = tokio::task::spawn_blocking(move || Ways::record(&ground, bounds, &rules)).await??;
    super::print(&format!(
        "recorded {} ways of {WAY_FRAMES} frames in {:.1} s, {} MB\n",
        rules.ways,
        began.elapsed().as_secs_f64(),
        ways.bytes() >> 20
    ));
    Ok(ways)
}

/// Ways that are recorded, and frames of each: 32 times 10 s at 20 Hz, which takes some ten seconds.
const WAYS: usize = 32;
const WAY_FRAMES: usize = 200;

/// What people must know, from what the server says of avatars.
fn ground(welcome: &Welcome, plan: Option<Arc<RoomPlan>>, all_round: AllRound) -> Ground {
    let avatar = welcome.classes.first().map_or_else(AvatarSpec::default, |class| AvatarSpec {
        radius: class.extent.radius,
        height: class.extent.top,
        eye_height: class.eye_height,
        turn_max: class.turn_max.unwrap_or(f64::INFINITY),
        speed_max: class.motion.speed_max,
    });
    Ground { plan, avatar, anchor: DVec3::from_array(welcome.anchor), all_round: Arc::new(all_round) }
}

/// The run's row for people, and why it is void, if it is.
fn summary(
    outcomes: &[Outcome],
    mut frames: Frames,
    seconds: f64,
    file: Option<&Path>,
) -> anyhow::Result<(String, Option<String>)> {
    frames.late.sort_unstable();
    let ms = |duration: Duration| duration.as_secs_f64() * 1e3;
    let count = frames.late.len();
    let late = |share: f64| {
        let index = ((count as f64 * share).ceil() as usize).clamp(1, count.max(1)) - 1;
        frames.late.get(index).copied().unwrap_or_default()
    };
    let clients = outcomes.len();
    let sum = |f: &dyn Fn(&Outcome) -> usize| outcomes.iter().map(f).sum::<usize>() as u64;
    let each = |total: u64| total as f64 / clients.max(1) as f64;
    let rtts: Vec<Duration> = outcomes.iter().filter_map(|outcome| outcome.round_trip).collect();
    let row = SwarmRow {
        clients,
        seconds,
        frames: count as u64,
        skipped: frames.gained(|(_, skipped)| *skipped),
        late_p50_ms: ms(late(0.5)),
        late_p99_ms: ms(late(0.99)),
        client_frame_ms: ms(frames.cull + frames.track) / count.max(1) as f64,
        cull_ms: ms(frames.cull) / count.max(1) as f64,
        messages_in_per_client_s: each(frames.gained(|(stats, _)| stats.records_in)) / seconds,
        messages_out_per_client_s: each(frames.gained(|(stats, _)| stats.records_out)) / seconds,
        visible_mean: each(sum(&|outcome| outcome.counts.0)),
        hidden_mean: each(sum(&|outcome| outcome.counts.1)),
        rtt_ms: (!rtts.is_empty()).then(|| ms(rtts.iter().sum::<Duration>()) / rtts.len() as f64),
    };
    if let Some(file) = file {
        std::fs::write(file, serde_json::to_string(&row)?)
            .with_context(|| format!("cannot write {}", file.display()))?;
    }
    let text = table(&[Row::of(&row)?], &columns());
    let void = (late(0.99) > LATE_MAX).then(|| {
        let (is, most) = (ms(late(0.99)), ms(LATE_MAX));
        format!(
            "void: one frame of a hundred began {is:.1} ms late or more, above {most} ms: the machine was too busy for \
             these numbers to mean anything; run fewer clients, or a release build"
        )
    });
    Ok((text, void))
}
