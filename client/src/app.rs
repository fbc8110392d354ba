//! The `eyeline-client` command: options, what it prints, and how it ends.

use std::io::{IsTerminal as _, Write as _};
use std::ops::RangeInclusive;
use std::path::PathBuf;
#[cfg(feature = "viewer")]
use std::sync::{
    Arc,
    atomic::{AtomicBool, Ordering},
};
use std::time::Duration;

use anyhow::Context;
use clap::{Args, Subcommand};
use eyeline_protocol::{PlanSwitch, Position, Role};
use eyeline_visibility::{Aabb, DynamicOctree};
use glam::DVec3;

use crate::net::{LocalClock, ModelSource, Onlooker, run_resuming};
use crate::session::{Session, SessionConfig, SessionStats};
pub use crate::target::Target;
use crate::tracking::TrackerConfig;

/// What the client can do.
#[derive(Subcommand)]
pub enum Command {
    /// Join a world without a window: stand, turn, track, and print a line a second
    #[command(after_long_help = HEADLESS_EXAMPLES)]
    Headless(Headless),
    /// Keep order on a server: see who is there, send somebody away, tell everybody something
    #[command(after_long_help = crate::operate::EXAMPLES)]
    Operate(crate::operate::Operate),
    /// Make a picture of a world, without a window
    #[cfg(feature = "viewer")]
    #[command(after_long_help = crate::viewer::shot::EXAMPLES)]
    Shot(Box<crate::viewer::shot::Shot>),
    /// Make pictures of a world along a recorded path, without a window
    #[cfg(feature = "viewer")]
    #[command(after_long_help = crate::viewer::film::EXAMPLES)]
    Film(Box<crate::viewer::film::Film>),
    /// Look at a world in a window, with a server or without
    #[cfg(feature = "viewer")]
    #[command(after_long_help = crate::viewer::view::EXAMPLES)]
    View(Box<crate::viewer::view::ViewOptions>),
}

/// Where the model comes from.
#[derive(Args, Clone, Debug)]
pub struct WorldOptions {
    /// The model, if it is here; must be the one that the server serves [default: fetched from the server]
    #[arg(long, value_name = "FILE")]
    pub world: Option<PathBuf>,

    /// Folder for fetched models, by their hash [default: eyeline in the user's cache folder]
    #[arg(long, value_name = "DIR", conflicts_with = "world")]
    pub cache: Option<PathBuf>,
}

impl WorldOptions {
    /// The source that the options mean.
    pub fn source(&self) -> ModelSource {
        if let Some(file) = &self.world {
            return ModelSource::File(file.clone());
        }
        let folder = |name| std::env::var_os(name).filter(|value| !value.is_empty()).map(PathBuf::from);
        let usual = || folder("XDG_CACHE_HOME").or_else(|| folder("HOME").map(|home| home.join(".cache")));
        match self.cache.clone().or_else(|| usual().map(|cache| cache.join("eyeline"))) {
            Some(folder) => ModelSource::Cache(folder),
            None => ModelSource::Fetch,
        }
    }
}

/// Options of `headless`.
#[derive(Args, Clone, Debug)]
pub struct Headless {
    #[command(flatten)]
    target: Target,

    #[command(flatten)]
    world: WorldOptions,

    /// How long to stay, seconds [default: until Ctrl-C]
    #[arg(long, value_name = "SECONDS", value_parser = number(0.1..=1e6, "s"))]
    seconds: Option<f64>,

    /// Frames a second, Hz
    #[arg(long, value_name = "HZ", default_value_t = 20.0, value_parser = number(0.1..=240.0, "Hz"))]
    frame_hz: f64,

    /// Pixels a side of the six images that decide what is hidden; more hides more and costs time
    #[arg(long, value_name = "PIXELS", default_value_t = 128, value_parser = clap::value_parser!(u32).range(8..=1024))]
    side: u32,

    /// A name for people
    #[arg(long, default_value = "headless")]
    name: String,

    /// Have no avatar and look from this point of the model, metres; needs a token that lets one fly, or a server that lets
    /// anybody
    #[arg(long, value_name = "X,Y,Z", value_parser = point, allow_hyphen_values = true)]
    fly: Option<DVec3>,

    /// What is left out: as counted (auto), nothing (full), or single stages on or off, as in full,look-again=off. Stages of a
    /// client without a picture: tracker, look-again, exact, sealed
    #[arg(long, value_name = "auto|full|STAGE=on,…", default_value_t)]
    plan: PlanSwitch,

    /// Print what comes into view, stops, leaves, and what is said, a line each
    #[arg(long)]
    events: bool,
}

const HEADLESS_EXAMPLES: &str = "Examples:
  eyeline-client headless --connect 127.0.0.1:4433 --fingerprint 11c4…d6b9 --seconds 10
  eyeline-client headless --connect example.org:4433 --ca authority.pem --token anna.token --cache /tmp/models
  eyeline-client headless --server-file ready.txt --world rooms.glb --frame-hz 10

  With nothing left out, to see what that costs:
  eyeline-client headless --server-file ready.txt --plan full";

/// Runs `headless`.
///
/// # Errors
/// If there is no such server, it does not let us in, its world can't be had, or the connection is lost.
pub fn headless(options: &Headless) -> anyhow::Result<()> {
    let period = Duration::from_secs_f64(1.0 / options.frame_hz);
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    runtime.block_on(async {
        let shutdown = shutdown_signal()?;
        options.target.require();
        let (endpoint, address) = options.target.endpoint()?;
        let config = SessionConfig::default()
            .with_name(options.name.clone())
            .with_token(options.target.token()?)
            .with_plan(options.plan)
            .with_tracker(TrackerConfig::default().with_frame(period));
        let config = if options.events { config.with_watch() } else { config };
        let config = if options.fly.is_some() { config.with_role(Role::Viewer) } else { config };
        // How large the world is will be known later.
        let session = Session::new(config, Box::new(|| Box::new(DynamicOctree::new(Aabb::EMPTY))));
        let mut connection = endpoint.connect(address, session, LocalClock::default()).await?;
        let scene = connection.scene(&options.world.source()).await?;
        let welcome = connection.session.welcome().context("no welcome")?;
        print(&format!(
            "{} at {address}: policy {}, {} triangles, {} objects, tick {} ms\n",
            welcome.world.name,
            welcome.policy,
            scene.triangles().len(),
            welcome.objects,
            f64::from(welcome.tick_micros) / 1e3,
        ));
        let mut second = Second::default();
        let mut leaves_out = String::new();
        let on_frame = Box::new(|session: &mut Session, report: &crate::net::FrameReport| {
            second.add(report.cull + report.track);
            while let Some(event) = session.poll_event() {
                if options.events {
                    print(&format!("        {}\n", event.describe()));
                }
            }
            // A frame count, not a clock: a line stands for a second's frames.
            if second.frames >= options.frame_hz.ceil() as u32 {
                // What moves comes and goes: the plan is told anew when it has changed.
                let plan = crate::plan::plan(Vec::new(), Some(session), 0);
                if plan.short() != leaves_out {
                    leaves_out = plan.short();
                    tracing::info!(plan = %leaves_out);
                }
                print(&second.line(session));
            }
        });
        let mut onlooker = match options.fly {
            Some(eye) => {
                let eye = Position::from_metres(eye - DVec3::from_array(welcome.anchor)).context("--fly")?;
                Onlooker::flying(&scene, eye, options.side, on_frame)
            }
            None => Onlooker::new(&scene, welcome, options.side, on_frame).context("the server gave us no avatar")?,
        }
        .with_sealed_parts(&scene);
        let end = async {
            match options.seconds {
                Some(seconds) => tokio::time::sleep(Duration::from_secs_f64(seconds)).await,
                None => std::future::pending().await,
            }
        };
        let end = async {
            tokio::select! {
                () = end => {}
                () = shutdown => {}
            }
        };
        let first = connection.clock().now();
        let ran = run_resuming(&endpoint, address, &mut connection, &mut onlooker, period, first, end).await;
        let stats = *connection.session.stats();
        let (sent, sent_bytes, received, received_bytes) = connection.udp();
        let skipped = ran.as_ref().map_or(0, |summary| summary.skipped);
        let frames = connection.session.tracker_stats().frames;
        let rtt = connection.session.round_trip().map_or("unknown".to_owned(), |(rtt, _)| format!("{rtt:.1?}"));
        print(&format!(
            "{frames} frames, {skipped} skipped; {} messages in, {} out; UDP {received} datagrams and \
             {received_bytes} bytes in, {sent} and {sent_bytes} out; round trip {rtt}; {} datagrams refused\n",
            stats.records_in, stats.records_out, stats.rejected,
        ));
        connection.close().await;
        endpoint.wait_idle().await;
        Ok(ran.map(drop)?)
    })
}

/// What is collected for one line of output.
#[derive(Default)]
struct Second {
    number: u32,
    frames: u32,
    work: Duration,
    /// The session's counters at the last line.
    before: SessionStats,
}

impl Second {
    fn add(&mut self, work: Duration) {
        self.frames += 1;
        self.work += work;
    }

    fn line(&mut self, session: &Session) -> String {
        self.number += 1;
        let (visible, hidden, asked) = session.tracker().map_or((0, 0, 0), |tracker| tracker.counts());
        let stats = *session.stats();
        let line = format!(
            "{:>4} s  {visible} visible, {hidden} hidden, {asked} asked for; {} messages in, {} out; {:.2} ms a frame\n",
            self.number,
            stats.records_in - self.before.records_in,
            stats.records_out - self.before.records_out,
            self.work.as_secs_f64() * 1e3 / f64::from(self.frames.max(1)),
        );
        *self = Second { number: self.number, before: stats, ..Second::default() };
        line
    }
}

/// A point on the command line.
pub(crate) fn point(text: &str) -> Result<DVec3, String> {
    let numbers: Option<Vec<f64>> = text.split(',').map(|part| part.trim().parse().ok()).collect();
    match numbers.as_deref() {
        Some(&[x, y, z]) if x.is_finite() && y.is_finite() && z.is_finite() => Ok(DVec3::new(x, y, z)),
        _ => Err("give three numbers with commas between, metres, as in 1.5,1.6,-3".to_owned()),
    }
}

/// A number on the command line, held to a range.
pub fn number(
    range: RangeInclusive<f64>,
    unit: &'static str,
) -> impl Fn(&str) -> Result<f64, String> + Clone + Send + Sync + 'static {
    move |text| match text.parse::<f64>() {
        Ok(value) if range.contains(&value) => Ok(value),
        _ => Err(format!("give a number from {} to {} {unit}", range.start(), range.end())),
    }
}

/// Writes to standard output at once. Who has closed it does not want to read, which is no reason to end.
pub(crate) fn print(text: &str) {
    let mut out = std::io::stdout().lock();
    let _ = out.write_all(text.as_bytes()).and_then(|()| out.flush());
}

/// Ready when the process is asked to end: Ctrl-C, or SIGTERM where there is such a thing. Listens from the call on.
pub(crate) fn shutdown_signal() -> anyhow::Result<impl Future<Output = ()>> {
    #[cfg(unix)]
    {
        use tokio::signal::unix::{SignalKind, signal};
        let mut interrupt = signal(SignalKind::interrupt()).context("cannot listen for Ctrl-C")?;
        let mut terminate = signal(SignalKind::terminate()).context("cannot listen for SIGTERM")?;
        Ok(async move {
            tokio::select! {
                _ = interrupt.recv() => {}
                _ = terminate.recv() => {}
            }
        })
    }
    #[cfg(not(unix))]
    Ok(async {
        let _ = tokio::signal::ctrl_c().await;
    })
}

/// Becomes true when the process is asked to end.
#[cfg(feature = "viewer")]
pub(crate) fn interrupted() -> anyhow::Result<Arc<AtomicBool>> {
    let flag = Arc::new(AtomicBool::new(false));
    let set = Arc::clone(&flag);
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let signal = {
        let _within = runtime.enter();
        shutdown_signal()?
    };
    // It ends with the process.
    std::thread::Builder::new().name("signals".into()).spawn(move || {
        runtime.block_on(signal);
        set.store(true, Ordering::Relaxed);
    })?;
    Ok(flag)
}

/// An error and its causes in one line. Some name their cause themselves, which is then not said again.
pub fn one_line(error: &anyhow::Error) -> String {
    let mut text = String::new();
    for cause in error.chain() {
        let cause = cause.to_string().split_whitespace().collect::<Vec<_>>().join(" ");
        if text.is_empty() {
            text = cause;
        } else if !text.contains(&cause) {
            text = format!("{text}: {cause}");
        }
    }
    text
}

/// Logs to standard error what `RUST_LOG` asks for; without it, warnings, and what Eyeline itself has to tell.
pub fn init_logs() {
    use tracing_subscriber::EnvFilter;
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| "warn,eyeline_client=info".into());
    let colours = std::io::stderr().is_terminal();
    tracing_subscriber::fmt().with_env_filter(filter).with_ansi(colours).with_writer(std::io::stderr).init();
}
