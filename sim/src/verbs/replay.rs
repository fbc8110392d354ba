//! `replay`: a recorded crowd, all of it, behind one connection.

use std::path::PathBuf;
use std::time::Duration;

use super::place::Place;
use anyhow::Context;
use clap::Args;
use eyeline_client::app::{Target, number};
use eyeline_client::net::{Endpoint, LocalClock, run_headless};
use eyeline_client::session::{Session, SessionConfig};
use eyeline_protocol::{AVATARS_MAX, Role};
use eyeline_server::app::shutdown_signal;
use eyeline_sim::people;
use eyeline_sim::report::Progress;
use eyeline_sim::stage::{Crowd, load_model};
use eyeline_sim::trace::{Placement, Trace};
use eyeline_visibility::{Aabb, DynamicOctree};
use glam::DVec3;

/// Options of `replay`.
#[derive(Args)]
pub struct Replay {
    #[command(flatten)]
    target: Target,

    /// The recording: rows of `frame id x z y vx vz vy` (metres, 25 Hz) or `id frame x y z` (centimetres, 16 Hz)
    #[arg(long, value_name = "FILE")]
    trace: PathBuf,

    /// The model that the server serves, for a place to put the crowd: the middle of their ground comes onto the most
    /// central place where avatars start
    #[arg(long, value_name = "FILE", required_unless_present = "trace_origin")]
    world: Option<PathBuf>,

    #[command(flatten)]
    place: Place,

    /// Where in the recording to begin, seconds; it begins again when it ends
    #[arg(long, value_name = "SECONDS", default_value_t = 0.0, value_parser = number(0.0..=1e6, "s"))]
    trace_start: f64,

    /// How long to replay, seconds
    #[arg(long, value_name = "SECONDS", default_value_t = 20.0, value_parser = number(0.1..=1e6, "s"))]
    seconds: f64,

    /// Poses of each person a second, Hz
    #[arg(long, value_name = "HZ", default_value_t = 20.0, value_parser = number(0.1..=240.0, "Hz"))]
    frame_hz: f64,
}

pub const EXAMPLES: &str = "Examples:
  eyeline-sim replay --server-file out/ready.txt --trace zara01_obsmat.txt --world oa_dm2.glb
  eyeline-sim replay --server-file out/ready.txt --trace crowd.txt --trace-origin 12,0,-3 --trace-heading 1.57
  eyeline-sim replay --connect 127.0.0.1:4433 --fingerprint 11c4…d6b9 --trace crowd.txt --world rooms.glb --seconds 60";

/// Replays a crowd.
pub fn run(options: &Replay) -> anyhow::Result<()> {
    options.target.require();
    let trace = Trace::read(&options.trace)?;
    let people = trace.people_at_once();
    let avatars = u16::try_from(people).ok().filter(|_| people <= AVATARS_MAX);
    let file = options.trace.display();
    let avatars = avatars.with_context(|| format!("{file}: {people} people at once are more than {AVATARS_MAX}"))?;
    let placement = place(options, &trace)?;
    let crowd = Crowd::new(trace.into(), placement);
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    runtime.block_on(play(options, crowd, avatars))
}

/// Where the crowd goes.
fn place(options: &Replay, trace: &Trace) -> anyhow::Result<Placement> {
    if let Some(placement) = options.place.placement() {
        return Ok(placement);
    }
    let world =
        options.world.as_deref().context("where does the crowd go? give --world FILE or --trace-origin X,Y,Z")?;
    let (model, ..) = load_model(world, None)?;
    let places: Vec<DVec3> = model.spec.spawns.iter().map(|spawn| DVec3::from_array(spawn.position)).collect();
    Placement::fit(trace, &places)
        .with_context(|| format!("{}: no place for the crowd; name one with --trace-origin X,Y,Z", world.display()))
}

async fn play(options: &Replay, crowd: Crowd, avatars: u16) -> anyhow::Result<()> {
    let shutdown = shutdown_signal()?;
    let (address, trust) = options.target.resolve()?;
    let period = Duration::from_secs_f64(1.0 / options.frame_hz);
    let endpoint = Endpoint::new(trust, address)?;
    let name: String = options.trace.file_name().map_or_else(String::new, |name| name.to_string_lossy().into());
    let config = SessionConfig::default()
        .with_name(name.chars().take(60).collect::<String>())
        .with_token(options.target.token()?)
        .with_role(Role::Actor { avatars });
    let session = Session::new(config, Box::new(|| Box::new(DynamicOctree::new(Aabb::EMPTY))));
    let mut connection = endpoint.connect(address, session, LocalClock::default()).await?;
    let welcome = connection.session.welcome().context("no welcome")?;
    let (people, span) = (crowd.trace.people.len(), crowd.trace.span_s());
    super::print(&format!(
        "{} at {address}: {people} people, at most {avatars} at once, of a recording of {span:.1} s\n",
        welcome.world.name
    ));
    let (fastest, allowed) = (
        crowd.placement.speed_max(&crowd.trace),
        welcome.classes.first().map_or(f64::INFINITY, |class| class.motion.speed_max),
    );
    if fastest > allowed {
        // Rounding to the wire's grid adds its step.
        let needed = (fastest * 1.05 + 0.05) * 10.0;
        tracing::warn!(
            "people in the recording reach {fastest:.2} m/s but avatars here only {allowed} m/s: the server holds them \
             back; start it with --avatar-speed {:.1}",
            needed.ceil() / 10.0
        );
    }
    let anchor = DVec3::from_array(welcome.anchor);
    let mut replay = people::Replay::new(crowd, anchor, options.trace_start);
    let mut to_come = options.seconds.ceil() as u64;
    let progress = Progress::new(to_come, "seconds");
    let end = async {
        let over = tokio::time::sleep(Duration::from_secs_f64(options.seconds));
        let mut seconds = tokio::time::interval(Duration::from_secs(1));
        seconds.tick().await;
        tokio::pin!(over, shutdown);
        loop {
            tokio::select! {
                () = &mut shutdown => break,
                () = &mut over => {
                    progress.inc(to_come);
                    break;
                }
                _ = seconds.tick() => {
                    progress.inc(1);
                    to_come = to_come.saturating_sub(1);
                }
            }
        }
    };
    let first = connection.clock().now();
    let ran = run_headless(&mut connection, &mut replay, period, first, end).await;
    progress.finish();
    let rtt = connection.session.round_trip().map_or("unknown".to_owned(), |(rtt, _)| format!("{rtt:.1?}"));
    let (sent, bytes, ..) = connection.udp();
    super::print(&format!(
        "{} messages out; {} times somebody came or went; UDP {sent} datagrams and {bytes} bytes out; \
         round trip {rtt}\n",
        connection.session.stats().records_out,
        replay.moves,
    ));
    connection.close().await;
    endpoint.wait_idle().await;
    Ok(ran.map(drop)?)
}
