//! The QUIC shell: a socket and a clock around a [`Session`], and the headless client.

// This is a driver: it may read the clock and own sockets.
#![expect(clippy::disallowed_methods, clippy::disallowed_types)]

mod again;
mod headless;
mod onlooker;
pub(crate) mod parts;
mod pin;
mod scene;
mod trust;

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::{Duration, Instant};

pub use again::run_resuming;
use bytes::Bytes;
use eyeline_protocol::codec::ControlReader;
use eyeline_protocol::{ALPN, LocalTime};
pub use headless::{Driver, FrameReport, Pose, Summary, run_headless};
pub use onlooker::{OnFrame, Onlooker};
pub use pin::{Fingerprint, FingerprintError};
use quinn::crypto::rustls::QuicClientConfig;
pub use scene::{ModelSource, SceneError, ServedModel};
pub use trust::{Trust, TrustError};

use crate::session::{Event, Session};

/// Why there is no connection, or no longer.
#[derive(Debug, thiserror::Error)]
pub enum NetError {
    /// No socket.
    #[error("cannot open a socket: {0}")]
    Socket(#[from] std::io::Error),
    /// The address is no address.
    #[error("cannot connect to {address}: {source}")]
    Connect {
        /// Where.
        address: SocketAddr,
        /// Why.
        source: quinn::ConnectError,
    },
    /// The handshake failed.
    #[error("no connection to {address}: {reason}")]
    Handshake {
        /// Where.
        address: SocketAddr,
        /// Why, with the remedy where there is one.
        reason: String,
    },
    /// The connection ended.
    #[error("connection lost: {0}")]
    Lost(String),
    /// The server ends, and said so.
    #[error("the server has ended: {0}")]
    Ended(String),
    /// The server said no.
    #[error("the server refused us ({refusal:?}): {reason}")]
    Refused {
        /// Why, for programs.
        refusal: eyeline_protocol::Refusal,
        /// Why, for people.
        reason: String,
    },
    /// The server said something that makes no sense.
    #[error("the server said something that makes no sense: {0}")]
    ServerFault(#[from] eyeline_protocol::codec::DecodeError),
    /// The model is not the one that was announced.
    #[error("the world that arrived is not the one that was announced (its hash differs); try again")]
    WrongWorld,
    /// TLS can't be set up.
    #[error("cannot set up TLS: {0}")]
    Tls(#[from] rustls::Error),
}

/// A process's own clock.
#[derive(Clone, Copy, Debug)]
pub struct LocalClock {
    epoch: Instant,
}

impl Default for LocalClock {
    fn default() -> LocalClock {
        LocalClock { epoch: Instant::now() }
    }
}

impl LocalClock {
    /// The time now.
    pub fn now(&self) -> LocalTime {
        LocalTime::ZERO + self.epoch.elapsed()
    }

    /// When the clock will show `time`.
    pub fn instant(&self, time: LocalTime) -> Instant {
        self.epoch + time.since(LocalTime::ZERO)
    }
}

/// A socket that any number of connections share, to servers that one trusts alike.
pub struct Endpoint {
    endpoint: quinn::Endpoint,
    server_name: String,
}

impl Endpoint {
    /// A socket for connections to servers that are trusted so: by a [`Fingerprint`], or otherwise. Needs a tokio runtime
    /// around it.
    ///
    /// # Errors
    /// If there is no socket to be had.
    pub fn new(trust: impl Into<Trust>, remote: SocketAddr) -> Result<Endpoint, NetError> {
        let trust = trust.into();
        let server_name = trust.name().to_owned();
        let config = quic_config(trust)?;
        let any: SocketAddr = match (remote, remote.ip().is_loopback()) {
            (SocketAddr::V4(_), true) => (std::net::Ipv4Addr::LOCALHOST, 0).into(),
            (SocketAddr::V4(_), false) => (std::net::Ipv4Addr::UNSPECIFIED, 0).into(),
            (SocketAddr::V6(_), true) => (std::net::Ipv6Addr::LOCALHOST, 0).into(),
            (SocketAddr::V6(_), false) => (std::net::Ipv6Addr::UNSPECIFIED, 0).into(),
        };
        let socket = socket(any)?;
        let runtime = Arc::new(quinn::TokioRuntime);
        let mut endpoint = quinn::Endpoint::new(quinn::EndpointConfig::default(), None, socket, runtime)?;
        endpoint.set_default_client_config(config);
        Ok(Endpoint { endpoint, server_name })
    }

    /// Connects `session` to the server at `address` and waits until it is welcome.
    ///
    /// # Errors
    /// If there is no server, it is another one than was pinned, or it does not let us in.
    pub async fn connect(
        &self,
        address: SocketAddr,
        session: Session,
        clock: LocalClock,
    ) -> Result<Connection, NetError> {
        let (quic, send, receive) = self.dial(address).await?;
        let reader = ControlReader::default();
        let mut connection = Connection { quic, send, receive, reader, session, clock, dropped: 0 };
        connection.greet(address).await?;
        Ok(connection)
    }

    /// Connects again what was lost. If the server remembers us then what we hold goes on to hold; its welcome says so
    /// ([`eyeline_protocol::Continuity`]). May be tried again after an error.
    ///
    /// # Errors
    /// As [`Endpoint::connect`].
    pub async fn resume(&self, address: SocketAddr, connection: &mut Connection) -> Result<(), NetError> {
        connection.quic.close(0u32.into(), b"comes back");
        (connection.quic, connection.send, connection.receive) = self.dial(address).await?;
        connection.reader = ControlReader::default();
        connection.session.reconnect();
        connection.greet(address).await
    }

    async fn dial(
        &self,
        address: SocketAddr,
    ) -> Result<(quinn::Connection, quinn::SendStream, quinn::RecvStream), NetError> {
        let connecting = self
            .endpoint
            .connect(address, &self.server_name)
            .map_err(|source| NetError::Connect { address, source })?;
        let connection = match tokio::time::timeout(CONNECT_TIMEOUT, connecting).await {
            Err(_) | Ok(Err(quinn::ConnectionError::TimedOut)) => {
                return Err(silent(address, "nothing answers there"));
            }
            Ok(Err(error)) => return Err(NetError::Handshake { address, reason: handshake_reason(&error) }),
            Ok(Ok(connection)) => connection,
        };
        let (send, receive) = connection.open_bi().await.map_err(|error| NetError::Lost(error.to_string()))?;
        Ok((connection, send, receive))
    }

    /// Goes on over another socket, as a client does whose address changes; connections go with it.
    ///
    /// # Errors
    /// If there is no socket to be had.
    pub fn rebind(&self) -> Result<(), NetError> {
        let mut address = self.endpoint.local_addr()?;
        address.set_port(0);
        Ok(self.endpoint.rebind(socket(address)?)?)
    }

    /// Waits until every connection has said goodbye.
    pub async fn wait_idle(&self) {
        let _ = tokio::time::timeout(Duration::from_secs(2), self.endpoint.wait_idle()).await;
    }
}

/// For how long a server may take to answer, first the handshake, then hello.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(5);

fn silent(address: SocketAddr, what: &str) -> NetError {
    let waited = CONNECT_TIMEOUT.as_secs();
    let reason = format!("{what} within {waited} s; is the server running, and is this its address?");
    NetError::Handshake { address, reason }
}

/// Why there was no handshake, for people.
fn handshake_reason(error: &quinn::ConnectionError) -> String {
    match error {
        quinn::ConnectionError::TransportError(error) => {
            // 0x178 is TLS's "no application protocol" (RFC 9001 §4.8, RFC 8446 §6).
            if u64::from(error.code) == 0x178 {
                let ours = String::from_utf8_lossy(ALPN);
                return format!("the server does not speak {ours}; update the older side");
            }
            format!("{}{}", error.reason, trust::remedy(&error.reason))
        }
        other => other.to_string(),
    }
}

/// One client's connection and its session.
pub struct Connection {
    quic: quinn::Connection,
    send: quinn::SendStream,
    receive: quinn::RecvStream,
    reader: ControlReader,
    /// What the client believes, and what it has to say.
    pub session: Session,
    clock: LocalClock,
    dropped: u64,
}

/// Something arrived.
pub enum Arrival {
    /// A datagram; hand it to [`Session::handle_datagram`].
    Datagram(Bytes),
    /// Control bytes, handled already.
    Control,
}

impl Connection {
    /// The process's clock.
    pub fn clock(&self) -> LocalClock {
        self.clock
    }

    /// Says hello and waits until it is answered.
    async fn greet(&mut self, address: SocketAddr) -> Result<(), NetError> {
        self.flush().await?;
        let welcomed = async {
            while self.session.is_waiting() {
                self.wait_control().await?;
            }
            Ok(())
        };
        match tokio::time::timeout(CONNECT_TIMEOUT, welcomed).await {
            Err(_) => Err(silent(address, "it does not answer our hello")),
            Ok(answer) => answer,
        }
    }

    /// Sends whatever the session has to say.
    ///
    /// # Errors
    /// If the connection is gone.
    pub async fn flush(&mut self) -> Result<(), NetError> {
        while let Some(bytes) = self.session.poll_control() {
            self.send.write_all(&bytes).await.map_err(|error| NetError::Lost(error.to_string()))?;
        }
        self.flush_datagrams();
        Ok(())
    }

    /// Sends the datagrams that the session has to say; never waits.
    pub fn flush_datagrams(&mut self) {
        let Some(limit) = self.quic.max_datagram_size() else { return };
        while let Some(bytes) = self.session.poll_datagram(limit, self.clock.now()) {
            if self.quic.send_datagram(Bytes::from(bytes)).is_err() {
                self.dropped += 1;
            }
        }
    }

    /// Sends what an answer has raised and should not wait for the next frame; never waits.
    pub fn flush_urgent(&mut self) {
        let Some(limit) = self.quic.max_datagram_size() else { return };
        while let Some(bytes) = self.session.poll_urgent(limit, self.clock.now()) {
            if self.quic.send_datagram(Bytes::from(bytes)).is_err() {
                self.dropped += 1;
            }
        }
    }

    /// Waits for something to arrive. Safe to drop and call again.
    ///
    /// # Errors
    /// If the connection is gone, or the server says so.
    pub async fn arrive(&mut self) -> Result<Arrival, NetError> {
        tokio::select! {
            // Control first: when the server goes, why it went is worth more than that it went.
            biased;
            chunk = self.receive.read_chunk(16 * 1024, true) => {
                let chunk = chunk.map_err(|error| NetError::Lost(error.to_string()))?;
                let Some(chunk) = chunk else { return Err(NetError::Lost("the server closed its stream".into())) };
                self.reader.push(&chunk.bytes);
                self.take_control()?;
                Ok(Arrival::Control)
            }
            datagram = self.quic.read_datagram() => {
                datagram.map(Arrival::Datagram).map_err(|error| NetError::Lost(error.to_string()))
            }
        }
    }

    async fn wait_control(&mut self) -> Result<(), NetError> {
        // Datagrams can't be of use before the welcome; they stay in quinn's buffer.
        let chunk =
            self.receive.read_chunk(16 * 1024, true).await.map_err(|error| NetError::Lost(error.to_string()))?;
        let Some(chunk) = chunk else { return Err(NetError::Lost("the server closed its stream".into())) };
        self.reader.push(&chunk.bytes);
        self.take_control()
    }

    fn take_control(&mut self) -> Result<(), NetError> {
        while let Some(message) = self.reader.next_message()? {
            self.session.handle_control(&message);
        }
        match self.session.poll_fault() {
            Some(Event::Refused { refusal: eyeline_protocol::Refusal::ShuttingDown, reason }) => {
                Err(NetError::Ended(reason))
            }
            Some(Event::Refused { refusal, reason }) => Err(NetError::Refused { refusal, reason }),
            Some(Event::ServerFault(error)) => Err(error.into()),
            _ => Ok(()),
        }
    }

    /// Fetches the model's bytes, checked against the hash in the welcome.
    ///
    /// # Errors
    /// If they do not arrive, or are others.
    pub async fn fetch_world(&mut self) -> Result<Vec<u8>, NetError> {
        let info = match self.session.welcome() {
            Some(welcome) => welcome.world.clone(),
            None => return Err(NetError::Lost("no welcome yet".into())),
        };
        self.session.want_world();
        self.flush().await?;
        let limit = usize::try_from(info.size_bytes).unwrap_or(usize::MAX).min(WORLD_BYTES_MAX);
        let lost = |error: &dyn std::fmt::Display| NetError::Lost(error.to_string());
        let mut stream = self.quic.accept_uni().await.map_err(|error| lost(&error))?;
        let bytes = stream.read_to_end(limit).await.map_err(|error| lost(&error))?;
        if scene::digest(&bytes) == info.hash { Ok(bytes) } else { Err(NetError::WrongWorld) }
    }

    /// UDP datagrams and bytes sent and received: (sent, sent bytes, received, received bytes).
    pub fn udp(&self) -> (u64, u64, u64, u64) {
        let stats = self.quic.stats();
        (stats.udp_tx.datagrams, stats.udp_tx.bytes, stats.udp_rx.datagrams, stats.udp_rx.bytes)
    }

    /// Says goodbye and closes, once the server has heard it or a second has passed.
    pub async fn close(mut self) {
        self.session.leave();
        // Who closes at once throws away what was just said: the server would take it for lost, and keep its avatars for
        // as long as it may come back. A server that has heard closes.
        let heard = async {
            if self.flush().await.is_ok() {
                self.quic.closed().await;
            }
        };
        let _ = tokio::time::timeout(HEARING, heard).await;
        self.quic.close(0u32.into(), b"goodbye");
    }
}

/// For how long a goodbye may take to be heard.
const HEARING: Duration = Duration::from_secs(1);

/// Largest model that is fetched: 1 GiB.
const WORLD_BYTES_MAX: usize = 1 << 30;

/// How a client speaks QUIC and TLS with servers that are trusted so, wherever its packets go.
///
/// # Errors
/// If TLS can't be set up.
pub fn quic_config(trust: impl Into<Trust>) -> Result<quinn::ClientConfig, NetError> {
    let provider = Arc::new(rustls::crypto::ring::default_provider());
    let tls = rustls::ClientConfig::builder_with_provider(provider.clone())
        .with_protocol_versions(&[&rustls::version::TLS13])?;
    let mut tls = match trust.into() {
        Trust::Pinned(fingerprint) => tls
            .dangerous()
            .with_custom_certificate_verifier(Arc::new(pin::Pinned::new(fingerprint, provider)))
            .with_no_client_auth(),
        Trust::Signed { authorities, .. } => tls.with_root_certificates(authorities).with_no_client_auth(),
    };
    tls.alpn_protocols = vec![ALPN.to_vec()];
    let quic = QuicClientConfig::try_from(tls).map_err(|error| NetError::Lost(error.to_string()))?;
    let mut config = quinn::ClientConfig::new(Arc::new(quic));
    config.transport_config(Arc::new(transport()));
    Ok(config)
}

/// After how many packets at the latest the server acknowledges them, unless it has something to send.
const ACKS_AFTER: u32 = 9;

fn transport() -> quinn::TransportConfig {
    let mut transport = quinn::TransportConfig::default();
    // Each packet costs its ends as much as what it carries. By default every second one is acknowledged by another at once,
    // though one that goes anyway will do: frames and ticks come sooner than anything here is given up for lost.
    let mut acks = quinn::AckFrequencyConfig::default();
    acks.ack_eliciting_threshold(ACKS_AFTER.into());
    transport
        .max_concurrent_bidi_streams(0u32.into())
        .max_concurrent_uni_streams(2u32.into())
        .max_idle_timeout(Some(quinn::IdleTimeout::from(quinn::VarInt::from_u32(10_000))))
        .keep_alive_interval(Some(Duration::from_secs(4)))
        .datagram_receive_buffer_size(Some(256 * 1024))
        .datagram_send_buffer_size(16 * 1024)
        .ack_frequency_config(Some(acks))
        .mtu_discovery_config(None);
    transport
}

fn socket(address: SocketAddr) -> std::io::Result<std::net::UdpSocket> {
    let socket = socket2::Socket::new(
        socket2::Domain::for_address(address),
        socket2::Type::DGRAM,
        Some(socket2::Protocol::UDP),
    )?;
    let _ = socket.set_recv_buffer_size(4 << 20);
    let _ = socket.set_send_buffer_size(1 << 20);
    socket.set_nonblocking(true)?;
    socket.bind(&address.into())?;
    Ok(socket.into())
}
