//! A run over real QUIC: the server in a thread of its own, all clients in another, loopback between them.

// This is a driver: it may read the clock.
#![expect(clippy::disallowed_methods)]

use std::net::{Ipv4Addr, SocketAddr};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError, mpsc};
use std::time::{Duration, Instant};

use anyhow::Context;
use bytes::Bytes;
use eyeline_client::net::{Connection, Endpoint, Fingerprint, LocalClock, run_headless};
use eyeline_client::session::{Session, SessionConfig};
use eyeline_protocol::{Role, WorldTime};
use eyeline_server::net::{Handle, Identity, Server, WorldClock};
use eyeline_server::world::MessageCounts;
use eyeline_visibility::DynamicOctree;

use super::{Bursts, ClientLog, Commit, FrameLog, MeasureConfig, ObjectInfo, RunLog, known_of};
use crate::people::{Extras, FrameHook, Person};
use crate::relay::{Relay, RelayConfig};
use crate::report::Progress;
use crate::stage::{Crowd, Stage};
use crate::virtual_net::LinkRules;

/// What the server thread tells when it listens.
struct Ready {
    address: SocketAddr,
    fingerprint: [u8; 32],
    handle: Handle,
}

/// Time between the last client's welcome and the start of the warm-up.
const SETTLE: Duration = Duration::from_millis(200);

pub(super) fn run(
    stage: &Stage,
    crowd: Option<&Crowd>,
    config: &MeasureConfig,
    link: Option<&LinkRules>,
    policy: &str,
) -> anyhow::Result<RunLog> {
    let clock = WorldClock::starting_at(WorldTime::ZERO);
    let world = config.start(stage, policy, clock.now())?;
    let commits = Arc::new(Mutex::new(Vec::new()));
    let (ready_send, ready) = mpsc::channel();
    let (stop, stopped) = tokio::sync::oneshot::channel::<()>();
    let model = Bytes::copy_from_slice(&stage.model.bytes);
    let server = {
        let commits = commits.clone();
        std::thread::Builder::new().name("server".into()).spawn(move || -> anyhow::Result<()> {
            let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
            runtime.block_on(async {
                let identity = Identity::ephemeral()?;
                let fingerprint = identity.fingerprint();
                let hook = Box::new(move |world: &eyeline_server::world::World| {
                    commits.lock().unwrap_or_else(PoisonError::into_inner).push(Commit::of(world));
                });
                let address = SocketAddr::from((Ipv4Addr::LOCALHOST, 0));
                let server = Server::bind(address, identity, world, model, clock, Some(hook))?;
                let ready = Ready { address: server.local_addr()?, fingerprint, handle: server.handle() };
                // If nobody waits any more, the run has failed elsewhere.
                let _ = ready_send.send(ready);
                server
                    .run(async {
                        let _ = stopped.await;
                    })
                    .await;
                anyhow::Ok(())
            })
        })?
    };
    let mut ready = match ready.recv() {
        Ok(ready) => ready,
        Err(_) => {
            let outcome = server.join().map_err(|_| anyhow::anyhow!("the server panicked"))?;
            outcome?;
            anyhow::bail!("the server ended before it listened");
        }
    };
    let handle = ready.handle.clone();
    let relay = match link {
        Some(link) => Some(Relaying::start(ready.address, *link, config.seed)?),
        None => None,
    };
    if let Some(relay) = &relay {
        ready.address = relay.address;
    }
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let outcome =
        tokio::task::LocalSet::new().block_on(&runtime, run_clients(stage, crowd, config, policy, ready, clock));
    if let Some(relay) = relay {
        relay.end()?;
    }
    let _ = stop.send(());
    server.join().map_err(|_| anyhow::anyhow!("the server panicked"))??;
    let Measured { clients, up, down, server_work, turnaround, tick_micros, poses_clamped, violations } = outcome?;
    let (classes, objects) = handle.with_world(|world| (world.classes().to_vec(), ObjectInfo::all(world)));
    let commits = std::mem::take(&mut *commits.lock().unwrap_or_else(PoisonError::into_inner));
    Ok(RunLog {
        policy: policy.to_owned(),
        net: "quic",
        window: config.window,
        commits,
        classes,
        objects,
        clients,
        up,
        down,
        server_work,
        turnaround,
        tick_micros,
        poses_clamped,
        violations,
        digest: None,
    })
}

/// A relay in a thread of its own, since it must be on time.
struct Relaying {
    address: SocketAddr,
    stop: tokio::sync::oneshot::Sender<()>,
    thread: std::thread::JoinHandle<anyhow::Result<()>>,
}

impl Relaying {
    fn start(to: SocketAddr, link: LinkRules, seed: u64) -> anyhow::Result<Relaying> {
        let (stop, stopped) = tokio::sync::oneshot::channel::<()>();
        let (ready_send, ready) = mpsc::channel();
        let thread = std::thread::Builder::new().name("relay".into()).spawn(move || -> anyhow::Result<()> {
            let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
            runtime.block_on(async {
                let listen = SocketAddr::from((Ipv4Addr::LOCALHOST, 0));
                let relay = Relay::bind(RelayConfig::new(listen, to).with_link(link).with_seed(seed))?;
                // If nobody waits any more, the run has failed elsewhere.
                let _ = ready_send.send(relay.local_addr()?);
                let stats = relay
                    .run(
                        async {
                            let _ = stopped.await;
                        },
                        |_| (),
                    )
                    .await;
                tracing::info!(%stats, "relayed");
                anyhow::Ok(())
            })
        })?;
        match ready.recv() {
            Ok(address) => Ok(Relaying { address, stop, thread }),
            Err(_) => {
                thread.join().map_err(|_| anyhow::anyhow!("the relay panicked"))??;
                anyhow::bail!("the relay ended before it listened")
            }
        }
    }

    fn end(self) -> anyhow::Result<()> {
        let _ = self.stop.send(());
        self.thread.join().map_err(|_| anyhow::anyhow!("the relay panicked"))?
    }
}

struct Measured {
    clients: Vec<ClientLog>,
    up: MessageCounts,
    down: MessageCounts,
    server_work: Duration,
    turnaround: Duration,
    tick_micros: Vec<u32>,
    poses_clamped: u64,
    violations: u64,
}

fn session(stage: &Stage, config: SessionConfig) -> Session {
    let bounds = stage.model.scene.bounds();
    Session::new(config, Box::new(move || Box::new(DynamicOctree::new(bounds))))
}

async fn run_clients(
    stage: &Stage,
    crowd: Option<&Crowd>,
    config: &MeasureConfig,
    policy: &str,
    ready: Ready,
    world_clock: WorldClock,
) -> anyhow::Result<Measured> {
    let clock = LocalClock::default();
    let endpoint = Endpoint::new(Fingerprint(ready.fingerprint), ready.address)?;
    let progress = Progress::new(config.clients as u64, &format!("{policy}: clients join"));
    let mut actors = Vec::new();
    for extras in Extras::all(stage, crowd, config.residents, config.seed, config.clients) {
        let role = Role::Actor { avatars: extras.avatars() };
        let session = session(stage, SessionConfig::default().with_role(role).with_name(extras.name()));
        actors.push((endpoint.connect(ready.address, session, clock).await?, extras));
    }
    let mut watchers = Vec::new();
    for number in 0..config.clients {
        let connection = endpoint
            .connect(ready.address, session(stage, config.session(number)), clock)
            .await
            .with_context(|| format!("client {number} of {}", config.clients))?;
        watchers.push(connection);
        progress.inc(1);
    }
    progress.finish();

    let start = Instant::now() + SETTLE + config.warm_up;
    let end = start + config.window;
    let is_measuring = Arc::new(AtomicBool::new(false));
    let mut tasks = Vec::new();
    let count = config.clients.max(1) as u32;
    for (number, connection) in watchers.into_iter().enumerate() {
        let log = Arc::new(Mutex::new(ClientLog::default()));
        let bursts = Bursts::new(config.burst_frames, config.truth_share, number as u64);
        let hook = recorder(log.clone(), is_measuring.clone(), bursts, clock, world_clock, stage.anchor());
        let person = config.person(stage, number, Some(hook));
        let phase = config.frame() * number as u32 / count;
        let task = watch(connection, person, log, config.frame(), phase, start, end);
        tasks.push(tokio::task::spawn_local(task));
    }
    let act = |(connection, extras)| tokio::task::spawn_local(act(connection, extras, config.frame(), start, end));
    let actors: Vec<_> = actors.into_iter().map(act).collect();

    tokio::time::sleep_until(start.into()).await;
    is_measuring.store(true, Ordering::Relaxed);
    ready.handle.reset_stats();
    let before = ready.handle.with_world(|world| *world.stats());
    let progress = Progress::new(config.window.as_millis() as u64, &format!("{policy}: measuring"));
    let step = Duration::from_millis(250);
    while Instant::now() + step < end {
        tokio::time::sleep(step).await;
        progress.inc(step.as_millis() as u64);
    }
    tokio::time::sleep_until(end.into()).await;
    progress.finish();
    let after = ready.handle.with_world(|world| *world.stats());
    let shell = ready.handle.stats();
    let answer_wait = ready.handle.with_world(|world| world.answer_wait());

    let mut clients = Vec::new();
    for task in tasks {
        clients.push(task.await??);
    }
    let mut up = after.messages_in.since(&before.messages_in);
    for actor in actors {
        // The crowd's own poses are the world's motion, not the watchers' traffic.
        up.poses = up.poses.saturating_sub(actor.await??);
    }
    endpoint.wait_idle().await;
    let mut tick_micros = shell.tick_micros;
    tick_micros.sort_unstable();
    Ok(Measured {
        clients,
        up,
        down: after.out.since(&before.out),
        server_work: shell.work,
        turnaround: shell.work_longest + answer_wait,
        tick_micros,
        poses_clamped: after.poses_clamped - before.poses_clamped,
        violations: after.violations - before.violations,
    })
}

/// Notes each frame while the measurement lasts.
fn recorder(
    log: Arc<Mutex<ClientLog>>,
    is_measuring: Arc<AtomicBool>,
    bursts: Bursts,
    clock: LocalClock,
    world_clock: WorldClock,
    anchor: glam::DVec3,
) -> FrameHook {
    Box::new(move |session, report, pose| {
        let received = session.take_states_received();
        if !is_measuring.load(Ordering::Relaxed) {
            return;
        }
        let mut log = log.lock().unwrap_or_else(PoisonError::into_inner);
        let known = bursts.contain(log.frames.len() as u64).then(|| known_of(session));
        let (round_trip, round_trip_max) = session.round_trip().unwrap_or_default();
        log.frames.push(FrameLog {
            at: world_clock.at(clock.instant(report.began)),
            eye: pose.eye - anchor,
            yaw: pose.yaw,
            cull: report.cull,
            track: report.track,
            late: report.late,
            round_trip_max,
            round_trip,
            ahead: session.ahead(),
            retry_after: session.retry_after(),
            known,
            received,
        });
    })
}

async fn watch(
    mut connection: Connection,
    mut person: Person,
    log: Arc<Mutex<ClientLog>>,
    frame: Duration,
    phase: Duration,
    start: Instant,
    end: Instant,
) -> anyhow::Result<ClientLog> {
    let first = connection.clock().now() + phase;
    let warm_up =
        run_headless(&mut connection, &mut person, frame, first, tokio::time::sleep_until(start.into())).await?;
    let before = connection.udp();
    let before_stats = connection.session.tracker_stats();
    let sent = connection.session.stats().records_out;
    let summary =
        run_headless(&mut connection, &mut person, frame, warm_up.next, tokio::time::sleep_until(end.into())).await?;
    let after = connection.udp();
    let avatar = connection.session.welcome().and_then(|welcome| welcome.avatars.first()).map(|avatar| avatar.0);
    let stats = connection.session.tracker_stats();
    let sent = connection.session.stats().records_out - sent;
    connection.close().await;
    drop(person);
    let mut log = std::mem::take(&mut *log.lock().unwrap_or_else(PoisonError::into_inner));
    log.avatar = avatar.unwrap_or_default();
    log.udp = [after.0 - before.0, after.1 - before.1, after.2 - before.2, after.3 - before.3];
    log.skipped = summary.skipped;
    log.note(&before_stats, &stats);
    log.sent = sent;
    Ok(log)
}

/// Moves people whom nobody looks for; returns how many records it sent within the window.
async fn act(
    mut connection: Connection,
    mut extras: Extras,
    frame: Duration,
    start: Instant,
    end: Instant,
) -> anyhow::Result<u64> {
    let first = connection.clock().now();
    let warm_up =
        run_headless(&mut connection, &mut extras, frame, first, tokio::time::sleep_until(start.into())).await?;
    let before = connection.session.stats().records_out;
    run_headless(&mut connection, &mut extras, frame, warm_up.next, tokio::time::sleep_until(end.into())).await?;
    let sent = connection.session.stats().records_out - before;
    connection.close().await;
    Ok(sent)
}
