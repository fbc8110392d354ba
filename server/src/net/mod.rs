//! The QUIC shell: sockets and clocks around a [`World`].
//!
//! One thread is enough: FACTS measured that a current-thread runtime beats two threads on two cores. Each connection
//! has one task that waits for what arrives; whatever does is handed to the world at once, and what the world has to
//! say in return leaves before the task waits again.

// This is a driver: it may read the clock and own sockets.
#![expect(clippy::disallowed_methods, clippy::disallowed_types)]

mod arrivals;
mod bans;
mod checks;
mod clock;
mod connection;
mod dates;
mod endpoint;
mod flush;
mod gate;
mod identity;
mod life;
mod metrics;
mod watch;
mod watched;

use std::collections::BTreeMap;
use std::future::Future;
use std::net::{IpAddr, SocketAddr};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

pub use arrivals::{ArrivalCounts, ArrivalLimits, Declined};
use arrivals::{Arrivals, Verdict};
pub use bans::BANS_MAX;
use bytes::Bytes;
pub use checks::TokenChecks;
pub use clock::WorldClock;
pub use dates::{Complaint, RENEW_WITHIN};
pub use endpoint::{quic_config, socket};
use eyeline_protocol::{ClientControl, WorldTime, codec};
use flush::Core;
pub use gate::{Anonymous, GateError, KEYS_MAX, TokenGate};
pub(crate) use identity::write_private;
pub use identity::{Identity, IdentityError, Reloader};
use life::Life;
pub use life::Stage;
pub use watch::{Watch, WatchError};

use crate::histogram::{Histogram, SECONDS};
use crate::world::World;

/// Why a server can't start.
#[derive(Debug, thiserror::Error)]
pub enum ServeError {
    /// The address can't be listened on.
    #[error("cannot listen on {address}: {source}; is another server running there? choose another with --listen")]
    Bind {
        /// Which.
        address: SocketAddr,
        /// Why.
        source: std::io::Error,
    },
    /// The certificate can't be used.
    #[error("cannot use the certificate: {0}")]
    Tls(#[from] rustls::Error),
    /// The certificate has a kind of key that QUIC can't use.
    #[error("cannot use the certificate for QUIC: {0}")]
    Quic(#[from] quinn::crypto::rustls::NoInitialCipherSuite),
}

/// What the shell itself counts.
#[derive(Clone, Debug)]
pub struct ShellStats {
    /// Time spent in the world and in handing its output to QUIC.
    pub work: Duration,
    /// Longest piece of work: how long an answer may have waited for its turn.
    pub work_longest: Duration,
    /// Work of each tick, the newest last; at most [`TICKS_KEPT`].
    pub tick_micros: Vec<u32>,
    /// Work of all ticks, seconds: the world's, and handing what comes of it to QUIC.
    pub tick_work: Histogram,
    /// How late all ticks began, seconds.
    pub tick_lateness: Histogram,
    /// Packets that were sent to those who have gone.
    pub packets_sent: u64,
    /// Of those, the ones that QUIC gave up for lost.
    pub packets_lost: u64,
    /// Connections that were closed because they did not read what they were told.
    pub slow_readers: u64,
    /// Datagrams that did not fit the path or its buffer.
    pub datagrams_dropped: u64,
}

impl Default for ShellStats {
    fn default() -> ShellStats {
        ShellStats {
            work: Duration::ZERO,
            work_longest: Duration::ZERO,
            tick_micros: Vec::new(),
            tick_work: Histogram::new(SECONDS),
            tick_lateness: Histogram::new(SECONDS),
            packets_sent: 0,
            packets_lost: 0,
            slow_readers: 0,
            datagrams_dropped: 0,
        }
    }
}

impl ShellStats {
    /// Adds up what was sent on a connection that has ended.
    fn note_path(&mut self, connection: &quinn::Connection) {
        let path = connection.stats().path;
        self.packets_sent += path.sent_packets;
        self.packets_lost += path.lost_packets;
    }
}

/// Settings of the shell.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct ShellConfig {
    /// Who may begin to connect.
    pub arrivals: ArrivalLimits,
    /// For how long a server that has been told to end waits at most until its clients have heard it; default 2 s.
    pub drain: Duration,
}

impl Default for ShellConfig {
    fn default() -> ShellConfig {
        ShellConfig { arrivals: ArrivalLimits::default(), drain: Duration::from_secs(2) }
    }
}

impl ShellConfig {
    /// Sets who may begin to connect.
    pub fn with_arrivals(self, arrivals: ArrivalLimits) -> ShellConfig {
        ShellConfig { arrivals, ..self }
    }

    /// Sets for how long the end may take.
    pub fn with_drain(self, drain: Duration) -> ShellConfig {
        ShellConfig { drain, ..self }
    }
}

/// What clients are told when the server ends.
const ENDS: &str = "the server ends";

/// How many ticks' work is remembered: an hour at 20 Hz.
pub const TICKS_KEPT: usize = 72_000;

/// Called after each commit.
pub type CommitHook = Box<dyn FnMut(&World) + Send>;

/// A handle on a running server. Cheap to clone.
#[derive(Clone)]
pub struct Handle {
    core: Arc<Mutex<Core>>,
    arrivals: Arc<Mutex<Arrivals>>,
    life: Arc<Life>,
    clock: WorldClock,
    model: Bytes,
    /// What checks tokens before the world is asked, one at a time.
    checks: Option<(TokenChecks, Arc<tokio::sync::Semaphore>)>,
}

/// A connection's place among the [`Arrivals`]; free again when it is dropped.
struct Place {
    arrivals: Arc<Mutex<Arrivals>>,
    address: IpAddr,
    is_in: bool,
    clock: WorldClock,
}

impl Place {
    fn lock(&self) -> MutexGuard<'_, Arrivals> {
        self.arrivals.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Its client was let in.
    fn let_in(&mut self) {
        if !std::mem::replace(&mut self.is_in, true) {
            self.lock().let_in(self.address);
        }
    }

    /// Its client went on and on beyond its limits.
    fn penalise(&mut self) {
        self.lock().penalise(self.address, self.clock.now());
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        self.lock().leave(self.address, self.is_in);
    }
}

impl Handle {
    fn lock(&self) -> MutexGuard<'_, Core> {
        // A panic elsewhere has been reported; the world's own state is consistent between calls.
        self.core.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn arrivals(&self) -> MutexGuard<'_, Arrivals> {
        self.arrivals.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn greeting(&self) -> Duration {
        self.arrivals().limits().greeting
    }

    /// A first packet of somebody: decides what becomes of it.
    fn arrive(&self, incoming: quinn::Incoming) {
        let address = incoming.remote_address().ip();
        let verdict = self.arrivals().arrive(address, incoming.remote_address_validated(), self.clock.now());
        match verdict {
            Verdict::Begin(turn) => {
                let place = Place { arrivals: self.arrivals.clone(), address, is_in: false, clock: self.clock };
                tokio::spawn(connection::serve(self.clone(), incoming, turn, place));
            }
            // One that may not retry has done so already.
            Verdict::Retry => drop(incoming.retry()),
            Verdict::Decline(why) => {
                tracing::debug!(%address, why = why.name(), "declined");
                incoming.refuse();
            }
        }
    }

    /// How far the server has got.
    pub fn stage(&self) -> Stage {
        self.life.stage()
    }

    /// What became of first packets.
    pub fn arrival_counts(&self) -> ArrivalCounts {
        self.arrivals().counts
    }

    /// Addresses that have limits of their own now.
    pub fn remembered_addresses(&self) -> usize {
        self.arrivals().remembered()
    }

    /// Connections that have not been let in, and all; handshakes included.
    pub fn open_connections(&self) -> (usize, usize) {
        self.arrivals().open()
    }

    /// Looks at the world, or changes it. Keep it short: nothing else happens meanwhile.
    pub fn with_world<T>(&self, f: impl FnOnce(&mut World) -> T) -> T {
        f(&mut self.lock().world)
    }

    /// The world's clock.
    pub fn clock(&self) -> WorldClock {
        self.clock
    }

    /// What the shell counted so far.
    pub fn stats(&self) -> ShellStats {
        self.lock().stats.clone()
    }

    /// Forgets what the shell counted so far.
    pub fn reset_stats(&self) {
        self.lock().stats = ShellStats::default();
    }

    /// Checks the token of a hello, while everything else goes on.
    async fn check_token(&self, message: &[u8]) {
        let Some((checks, turn)) = &self.checks else { return };
        let Ok(ClientControl::Hello { token, .. }) = codec::decode_client_control(message) else { return };
        if token.is_empty() {
            return;
        }
        // Who asks for many checks has them one after the other.
        let Ok(_turn) = turn.acquire().await else { return };
        let (checks, now) = (checks.clone(), self.clock.now());
        let _ = tokio::task::spawn_blocking(move || checks.check(&token, now)).await;
    }

    /// Runs `f` on the world and its connections, and sends what comes of it.
    fn drive(&self, f: impl FnOnce(&mut Core, WorldTime)) {
        let started = Instant::now();
        let mut core = self.lock();
        f(&mut core, self.clock.now());
        core.flush(self.clock.now());
        let work = started.elapsed();
        core.stats.work += work;
        core.stats.work_longest = core.stats.work_longest.max(work);
    }
}

/// A server that listens, and runs when told to.
pub struct Server {
    endpoint: quinn::Endpoint,
    handle: Handle,
    drain: Duration,
}

impl Server {
    /// Listens on `address` and serves `world`, whose static model is `model`. Needs a tokio runtime around it.
    ///
    /// # Errors
    /// If the address is taken or the identity is of no use.
    pub fn bind(
        address: SocketAddr,
        identity: Identity,
        world: World,
        model: Bytes,
        clock: WorldClock,
        hook: Option<CommitHook>,
    ) -> Result<Server, ServeError> {
        let config = quic_config(identity)?;
        let socket = socket(address).map_err(|source| ServeError::Bind { address, source })?;
        let runtime = Arc::new(quinn::TokioRuntime);
        let endpoint = quinn::Endpoint::new(quinn::EndpointConfig::default(), Some(config), socket, runtime)
            .map_err(|source| ServeError::Bind { address, source })?;
        let arrivals = Arrivals::new(ArrivalLimits::default(), clock.now());
        let life = Arc::new(Life::new(world.tick_period(), clock.now()));
        let core = Core { world, peers: BTreeMap::new(), hook, stats: ShellStats::default() };
        let (core, arrivals) = (Arc::new(Mutex::new(core)), Arc::new(Mutex::new(arrivals)));
        let drain = ShellConfig::default().drain;
        Ok(Server { endpoint, handle: Handle { core, arrivals, life, clock, model, checks: None }, drain })
    }

    /// The same with other settings of the shell.
    pub fn with_config(mut self, config: ShellConfig) -> Server {
        *self.handle.arrivals() = Arrivals::new(config.arrivals, self.handle.clock.now());
        self.drain = config.drain;
        self
    }

    /// Has tokens checked on another thread, before the world's gate, whose checks these are, is asked about them.
    pub fn with_token_checks(mut self, checks: TokenChecks) -> Server {
        self.handle.checks = Some((checks, Arc::new(tokio::sync::Semaphore::new(1))));
        self
    }

    /// Where it listens.
    ///
    /// # Errors
    /// If the system has forgotten.
    pub fn local_addr(&self) -> std::io::Result<SocketAddr> {
        self.endpoint.local_addr()
    }

    /// A handle on the world, for as long as the server runs and after.
    pub fn handle(&self) -> Handle {
        self.handle.clone()
    }

    /// Serves until `shutdown` is ready; then tells the clients, turns away who comes, and ends when everybody has heard it, or
    /// after [`ShellConfig::drain`].
    pub async fn run(self, shutdown: impl Future<Output = ()>) {
        let Server { endpoint, handle, drain } = self;
        handle.life.enter(Stage::Serving);
        tokio::pin!(shutdown);
        let ticker = tick(handle.clone());
        tokio::pin!(ticker);
        loop {
            tokio::select! {
                () = &mut shutdown => break,
                () = &mut ticker => {}
                incoming = endpoint.accept() => match incoming {
                    Some(incoming) => handle.arrive(incoming),
                    None => break,
                },
            }
        }
        handle.life.enter(Stage::Draining);
        let deadline = tokio::time::Instant::now() + drain;
        // The last word to who does not answer needs some of the time too.
        let polite = deadline - (drain / 10).min(Duration::from_millis(200));
        tracing::info!(clients = handle.lock().peers.len(), "draining");
        handle.drive(|core, _| core.world.shut_down(ENDS));
        loop {
            tokio::select! {
                () = tokio::time::sleep_until(polite) => break,
                () = endpoint.wait_idle() => break,
                incoming = endpoint.accept() => match incoming {
                    Some(incoming) => handle.arrive(incoming),
                    None => break,
                },
            }
        }
        endpoint.close(0u32.into(), ENDS.as_bytes());
        let _ = tokio::time::timeout_at(deadline, endpoint.wait_idle()).await;
        handle.life.enter(Stage::Ended);
    }
}

async fn tick(handle: Handle) {
    loop {
        let due = handle.lock().world.poll_timeout();
        tokio::time::sleep_until(handle.clock.instant(due).into()).await;
        let (started, late) = (Instant::now(), handle.clock.now().since(due));
        handle.drive(|core, now| {
            core.hear_all();
            core.world.tick(now);
        });
        if let Some(plan) = handle.with_world(|world| world.poll_plan()) {
            for line in &plan.lines {
                tracing::info!(stage = line.stage.name(), "the plan is revised, {}: {}", line.verdict(), line.evidence);
            }
        }
        handle.life.ticked(handle.clock.now());
        let mut guard = handle.lock();
        let core = &mut *guard;
        core.stats.tick_work.observe(started.elapsed().as_secs_f64());
        core.stats.tick_lateness.observe(late.as_secs_f64());
        if core.stats.tick_micros.len() < TICKS_KEPT {
            core.stats.tick_micros.push(started.elapsed().as_micros() as u32);
        }
        if let Some(hook) = &mut core.hook {
            hook(&core.world);
        }
    }
}

#[cfg(test)]
mod wrong_tests;
