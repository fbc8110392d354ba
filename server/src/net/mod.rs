//! The QUIC shell: sockets and clocks around a [`World`].
//!
//! One thread is enough: FACTS measured that a current-thread runtime beats two threads on two cores. Each connection
//! has one task that waits for what arrives; whatever does is handed to the world at once, and what the world has to
//! say in return leaves before the task waits again.

// This is a driver: it may read the clock and own sockets.
#![expect(clippy::disallowed_methods, clippy::disallowed_types)]

mod identity;

use std::collections::BTreeMap;
use std::future::Future;
use std::net::SocketAddr;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use bytes::Bytes;
use eyeline_protocol::codec::ControlReader;
use eyeline_protocol::{ALPN, WorldTime};
pub use identity::{Identity, IdentityError};
use quinn::crypto::rustls::QuicServerConfig;
use tokio::sync::mpsc;

use crate::gate::Caller;
use crate::world::{PathState, SessionId, Transmit, World, room};

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

/// The world's time as a driver tells it: `base` at `epoch`.
#[derive(Clone, Copy, Debug)]
pub struct WorldClock {
    epoch: Instant,
    base: WorldTime,
}

impl WorldClock {
    /// A clock that shows `base` now.
    pub fn starting_at(base: WorldTime) -> WorldClock {
        WorldClock { epoch: Instant::now(), base }
    }

    /// The time now.
    pub fn now(&self) -> WorldTime {
        self.base + self.epoch.elapsed()
    }

    /// The time that the clock shows at `instant`; its base before it started.
    pub fn at(&self, instant: Instant) -> WorldTime {
        self.base + instant.saturating_duration_since(self.epoch)
    }

    /// When the clock will show `time`.
    pub fn instant(&self, time: WorldTime) -> Instant {
        self.epoch + time.since(self.base)
    }
}

/// What the shell itself counts.
#[derive(Clone, Debug, Default)]
pub struct ShellStats {
    /// Time spent in the world and in handing its output to QUIC.
    pub work: Duration,
    /// Longest piece of work: how long an answer may have waited for its turn.
    pub work_longest: Duration,
    /// Work of each tick, the newest last; at most [`TICKS_KEPT`].
    pub tick_micros: Vec<u32>,
    /// Connections that were closed because they did not read what they were told.
    pub slow_readers: u64,
    /// Datagrams that did not fit the path or its buffer.
    pub datagrams_dropped: u64,
}

/// Room in QUIC for one client's datagrams of a tick, bytes.
const DATAGRAM_BUFFER: usize = 64 * 1024;

/// How many ticks' work is remembered: an hour at 20 Hz.
pub const TICKS_KEPT: usize = 72_000;

/// Most control messages that wait for one client. A joining client of a full world is told of 16 M objects in 65,536.
const CONTROL_QUEUE: usize = 4096;

/// Called after each commit.
pub type CommitHook = Box<dyn FnMut(&World) + Send>;

struct Peer {
    connection: quinn::Connection,
    control: mpsc::Sender<Outgoing>,
    /// When the oldest datagram was handed to QUIC that may still wait there.
    queued_at: Option<WorldTime>,
    /// The room in QUIC's buffer when nothing waits: quinn keeps some of it for itself.
    empty_space: usize,
}

impl Peer {
    /// How many bytes of datagrams QUIC will have sent a tick from now if it gets them now.
    fn room(&mut self, now: WorldTime, tick: Duration) -> usize {
        let queued_bytes = self.empty_space.saturating_sub(self.connection.datagram_send_buffer_space());
        if queued_bytes == 0 {
            self.queued_at = None;
        }
        let path = self.connection.stats().path;
        let waited = self.queued_at.map(|at| now.since(at));
        room(PathState { waited, queued_bytes, window_bytes: path.cwnd, round_trip: path.rtt }, tick)
    }
}

enum Outgoing {
    Control(Arc<[u8]>),
    WorldBytes,
    Close(String),
}

struct Core {
    world: World,
    peers: BTreeMap<SessionId, Peer>,
    hook: Option<CommitHook>,
    stats: ShellStats,
}

/// A handle on a running server. Cheap to clone.
#[derive(Clone)]
pub struct Handle {
    core: Arc<Mutex<Core>>,
    clock: WorldClock,
    model: Bytes,
}

impl Handle {
    fn lock(&self) -> MutexGuard<'_, Core> {
        // A panic elsewhere has been reported; the world's own state is consistent between calls.
        self.core.lock().unwrap_or_else(PoisonError::into_inner)
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

    /// Runs `f` on the world and sends what comes of it.
    fn drive(&self, f: impl FnOnce(&mut World, WorldTime)) {
        let started = Instant::now();
        let mut core = self.lock();
        f(&mut core.world, self.clock.now());
        core.flush(self.clock.now());
        let work = started.elapsed();
        core.stats.work += work;
        core.stats.work_longest = core.stats.work_longest.max(work);
    }
}

impl Core {
    fn flush(&mut self, now: WorldTime) {
        let tick = self.world.tick_period();
        loop {
            let peers = &mut self.peers;
            let room = |id| peers.get_mut(&id).map_or(usize::MAX, |peer| peer.room(now, tick));
            let Some((id, transmit)) = self.world.poll_transmit_where(now, room) else { break };
            let Some(peer) = self.peers.get_mut(&id) else { continue };
            let outgoing = match transmit {
                Transmit::Datagram(bytes) => {
                    peer.queued_at.get_or_insert(now);
                    if peer.connection.send_datagram(Bytes::from(bytes)).is_err() {
                        self.stats.datagrams_dropped += 1;
                    }
                    continue;
                }
                Transmit::Control(bytes) => Outgoing::Control(bytes),
                Transmit::WorldBytes => Outgoing::WorldBytes,
                Transmit::Close(reason) => Outgoing::Close(reason),
            };
            if peer.control.try_send(outgoing).is_err() {
                self.stats.slow_readers += 1;
                peer.connection.close(1u32.into(), b"does not read its control stream");
            }
        }
    }
}

/// A server that listens, and runs when told to.
pub struct Server {
    endpoint: quinn::Endpoint,
    handle: Handle,
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
        let core = Core { world, peers: BTreeMap::new(), hook, stats: ShellStats::default() };
        Ok(Server { endpoint, handle: Handle { core: Arc::new(Mutex::new(core)), clock, model } })
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

    /// Serves until `shutdown` is ready, then tells the clients and waits for them to hear it, at most two seconds.
    pub async fn run(self, shutdown: impl Future<Output = ()>) {
        let Server { endpoint, handle } = self;
        tokio::pin!(shutdown);
        let ticker = tick(handle.clone());
        tokio::pin!(ticker);
        loop {
            tokio::select! {
                () = &mut shutdown => break,
                () = &mut ticker => {}
                incoming = endpoint.accept() => match incoming {
                    Some(incoming) => { tokio::spawn(serve(handle.clone(), incoming)); }
                    None => break,
                },
            }
        }
        endpoint.set_server_config(None);
        handle.drive(|world, _| world.shut_down("the server ends"));
        // The tasks flush and close their connections; a peer that does not answer is not waited for.
        let idle = tokio::time::timeout(Duration::from_secs(2), endpoint.wait_idle()).await;
        if idle.is_err() {
            endpoint.close(0u32.into(), b"the server ends");
        }
    }
}

async fn tick(handle: Handle) {
    loop {
        let due = handle.lock().world.poll_timeout();
        tokio::time::sleep_until(handle.clock.instant(due).into()).await;
        let started = Instant::now();
        handle.drive(|world, now| world.tick(now));
        let mut guard = handle.lock();
        let core = &mut *guard;
        if core.stats.tick_micros.len() < TICKS_KEPT {
            core.stats.tick_micros.push(started.elapsed().as_micros() as u32);
        }
        if let Some(hook) = &mut core.hook {
            hook(&core.world);
        }
    }
}

async fn serve(handle: Handle, incoming: quinn::Incoming) {
    let connection = match incoming.await {
        Ok(connection) => connection,
        Err(error) => return tracing::debug!(%error, "handshake failed"),
    };
    let (control, outgoing) = mpsc::channel(CONTROL_QUEUE);
    let mut id = SessionId(0);
    let caller = Caller { address: Some(connection.remote_address().ip()), resume: resume_token() };
    handle.drive(|world, now| id = world.connect_from(now, caller));
    let empty_space = connection.datagram_send_buffer_space();
    let peer = Peer { connection: connection.clone(), control, queued_at: None, empty_space };
    handle.lock().peers.insert(id, peer);
    if let Some(limit) = connection.max_datagram_size() {
        handle.with_world(|world| world.handle_datagram_limit(id, limit));
    }
    tracing::debug!(session = id.0, address = %connection.remote_address(), "connected");
    let reason = tokio::select! {
        reason = receive_datagrams(&handle, id, &connection) => reason,
        reason = converse(&handle, id, &connection, outgoing) => reason,
        reason = wait_for_hello(&handle, id) => reason,
    };
    tracing::debug!(session = id.0, %reason, "disconnected");
    connection.close(0u32.into(), reason.as_bytes());
    handle.drive(|world, _| world.disconnect(id));
    handle.lock().peers.remove(&id);
}

/// What a client may come back with. All zero, so that it can't, if the system has no chance to give.
fn resume_token() -> [u8; 16] {
    use ring::rand::SecureRandom;
    let mut token = [0; 16];
    match ring::rand::SystemRandom::new().fill(&mut token) {
        Ok(()) => token,
        Err(_) => [0; 16],
    }
}

async fn receive_datagrams(handle: &Handle, id: SessionId, connection: &quinn::Connection) -> String {
    loop {
        match connection.read_datagram().await {
            Ok(datagram) => handle.drive(|world, now| world.handle_datagram(id, &datagram, now)),
            Err(error) => return error.to_string(),
        }
    }
}

/// For how long a connection may stay without being let in.
const GREETING_TIMEOUT: Duration = Duration::from_secs(5);

/// Ready when a client has not said hello in time; never for one that has.
async fn wait_for_hello(handle: &Handle, id: SessionId) -> String {
    tokio::time::sleep(GREETING_TIMEOUT).await;
    if handle.with_world(|world| world.is_admitted(id)) {
        std::future::pending::<()>().await;
    }
    "no hello".into()
}

async fn converse(
    handle: &Handle,
    id: SessionId,
    connection: &quinn::Connection,
    mut outgoing: mpsc::Receiver<Outgoing>,
) -> String {
    let (mut send, mut receive) = match connection.accept_bi().await {
        Ok(stream) => stream,
        Err(error) => return error.to_string(),
    };
    let reading = async {
        let mut reader = ControlReader::of_client();
        loop {
            match receive.read_chunk(16 * 1024, true).await {
                Ok(Some(chunk)) => reader.push(&chunk.bytes),
                // The client has said all it will; it may still listen.
                Ok(None) => return std::future::pending::<String>().await,
                Err(error) => return error.to_string(),
            }
            loop {
                match reader.next_message() {
                    Ok(Some(message)) => handle.drive(|world, now| world.handle_control(id, &message, now)),
                    Ok(None) => break,
                    Err(error) => {
                        // Counted and told; writing closes the connection once the client has it.
                        handle.drive(|world, _| world.handle_broken_control(id, &error));
                        return std::future::pending::<String>().await;
                    }
                }
            }
        }
    };
    let writing = async {
        let mut sending: Option<tokio::task::JoinHandle<()>> = None;
        while let Some(message) = outgoing.recv().await {
            match message {
                Outgoing::Control(bytes) => {
                    if let Err(error) = send.write_all(&bytes).await {
                        return error.to_string();
                    }
                }
                Outgoing::WorldBytes => {
                    // One at a time: who asks again while it is under way gets no second copy.
                    if sending.as_ref().is_none_or(|sending| sending.is_finished()) {
                        let (connection, model) = (connection.clone(), handle.model.clone());
                        sending = Some(tokio::spawn(async move { send_world(&connection, model).await }));
                    }
                }
                Outgoing::Close(reason) => {
                    // Wait until the peer has it all, or has gone.
                    let _ = send.finish();
                    let _ = tokio::time::timeout(Duration::from_secs(1), send.stopped()).await;
                    return reason;
                }
            }
        }
        "closed".into()
    };
    tokio::select! {
        reason = reading => reason,
        reason = writing => reason,
    }
}

async fn send_world(connection: &quinn::Connection, model: Bytes) {
    let sent = async {
        let mut stream = connection.open_uni().await?;
        stream.set_priority(-1)?;
        stream.write_all(&model).await?;
        stream.finish()?;
        anyhow::Ok(())
    };
    if let Err(error) = sent.await {
        tracing::debug!(%error, "the world was not sent");
    }
}

/// How this server speaks QUIC and TLS, wherever its packets go.
///
/// # Errors
/// If the identity is of no use.
pub fn quic_config(identity: Identity) -> Result<quinn::ServerConfig, ServeError> {
    let provider = Arc::new(rustls::crypto::ring::default_provider());
    let mut tls = rustls::ServerConfig::builder_with_provider(provider)
        .with_protocol_versions(&[&rustls::version::TLS13])?
        .with_no_client_auth()
        .with_single_cert(vec![identity.certificate], identity.key)?;
    tls.alpn_protocols = vec![ALPN.to_vec()];
    let mut config = quinn::ServerConfig::with_crypto(Arc::new(QuicServerConfig::try_from(tls)?));
    config.transport_config(Arc::new(transport()));
    Ok(config)
}

/// Few streams and small windows: a connection's memory is what limits a server of thousands (FACTS: stream limits of
/// 8 instead of 100 save a fifth, MTU discovery off halves the handshake). The datagram buffer holds two ticks of a busy
/// client, so that it can't hide seconds of stale poses.
fn transport() -> quinn::TransportConfig {
    let mut transport = quinn::TransportConfig::default();
    transport
        .max_concurrent_bidi_streams(1u32.into())
        .max_concurrent_uni_streams(0u32.into())
        .max_idle_timeout(Some(quinn::IdleTimeout::from(quinn::VarInt::from_u32(10_000))))
        .keep_alive_interval(Some(Duration::from_secs(4)))
        .datagram_receive_buffer_size(Some(64 * 1024))
        .datagram_send_buffer_size(DATAGRAM_BUFFER)
        .stream_receive_window(quinn::VarInt::from_u32(128 * 1024))
        .receive_window(quinn::VarInt::from_u32(256 * 1024))
        .send_window(1 << 20)
        .mtu_discovery_config(None);
    transport
}

/// A socket with buffers for a tick's burst: the system's default drops them (FACTS). Does not block.
///
/// # Errors
/// If the address can't be had.
pub fn socket(address: SocketAddr) -> std::io::Result<std::net::UdpSocket> {
    let socket = socket2::Socket::new(
        socket2::Domain::for_address(address),
        socket2::Type::DGRAM,
        Some(socket2::Protocol::UDP),
    )?;
    // As much as the system gives; less is no error.
    let _ = socket.set_recv_buffer_size(4 << 20);
    let _ = socket.set_send_buffer_size(4 << 20);
    socket.set_nonblocking(true)?;
    socket.bind(&address.into())?;
    Ok(socket.into())
}
