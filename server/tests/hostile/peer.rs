//! Clients that say what they like, and a server for them to say it to.

use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::mpsc;
use std::time::{Duration, Instant};

use eyeline_protocol::codec::{self, ControlReader, DatagramWriter};
use eyeline_protocol::{
    ALPN, ClientControl, ClientHeader, ClientRecord, Interest, LinkHeader, ObjectId, Reason, Refusal, Role,
    ServerControl, VERSION, Want, WorldInfo, WorldTime,
};
use eyeline_server::net::{Handle, Identity, Server, ShellConfig, WorldClock};
use eyeline_server::policy::Visible;
use eyeline_server::spec::{ClassSpec, ObjectSpec, WorldSpec};
use eyeline_server::world::{World, WorldConfig};
use glam::DVec3;
use rustls::client::danger::{HandshakeSignatureValid, ServerCertVerified, ServerCertVerifier};
use rustls::pki_types::{CertificateDer, ServerName, UnixTime};
use rustls::{DigitallySignedStruct, Error, SignatureScheme};

/// Objects in the world that nobody moves.
pub const CHAIRS: u32 = 200;

/// A server in a thread of its own, in this process.
pub struct Served {
    pub address: SocketAddr,
    pub handle: Handle,
    stop: Option<tokio::sync::oneshot::Sender<()>>,
    thread: Option<std::thread::JoinHandle<()>>,
}

impl Served {
    pub fn new(config: ShellConfig) -> Served {
        Served::of(WorldConfig::default(), config)
    }

    pub fn of(world_config: WorldConfig, config: ShellConfig) -> Served {
        let (ready, told) = mpsc::channel();
        let (stop, stopped) = tokio::sync::oneshot::channel::<()>();
        let thread = std::thread::spawn(move || {
            runtime().block_on(async {
                let clock = WorldClock::starting_at(WorldTime::ZERO);
                let identity = Identity::ephemeral().unwrap();
                let address = "127.0.0.1:0".parse().unwrap();
                let model = vec![7; 300_000].into();
                let world = world(world_config, clock.now());
                let server = Server::bind(address, identity, world, model, clock, None).unwrap();
                let server = server.with_config(config);
                ready.send((server.local_addr().unwrap(), server.handle())).unwrap();
                server.run(async { drop(stopped.await) }).await;
            });
        });
        let (address, handle) = told.recv().unwrap();
        Served { address, handle, stop: Some(stop), thread: Some(thread) }
    }

    /// Asks it to end, and does not wait.
    pub fn ask_to_end(&mut self) {
        drop(self.stop.take());
    }

    /// Waits until it has ended.
    pub fn wait(&mut self) {
        if let Some(thread) = self.thread.take() {
            thread.join().unwrap();
        }
    }

    /// Waits until `is_so`, and fails if that does not come about.
    #[track_caller]
    pub fn until(&self, what: &str, is_so: impl Fn(&Handle) -> bool) {
        let started = Instant::now();
        while !is_so(&self.handle) {
            assert!(started.elapsed() < PATIENCE, "it did not come about that {what}");
            std::thread::sleep(Duration::from_millis(5));
        }
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        self.ask_to_end();
        self.wait();
    }
}

pub fn runtime() -> tokio::runtime::Runtime {
    tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap()
}

fn world(config: WorldConfig, now: WorldTime) -> World {
    let class = ClassSpec { name: "chair".into(), radius: 0.3, bottom: 0.0, top: 1.0, speed_max: 1.0 };
    let chair = |index: u32| ObjectSpec {
        name: format!("chair {index}"),
        class: "chair".into(),
        node: None,
        position: [f64::from(index), 0.0, 3.0],
        heading: 0.0,
        takeable: false,
        path: None,
    };
    let spec = WorldSpec { classes: vec![class], objects: (0..CHAIRS).map(chair).collect(), ..WorldSpec::default() };
    let info = WorldInfo { name: "test".into(), hash: [0; 32], size_bytes: 300_000, two_sided: false };
    World::new(config, spec, info, DVec3::ZERO, Box::new(Visible), now).unwrap()
}

/// Longest wait for something that must happen.
pub const PATIENCE: Duration = Duration::from_secs(10);

/// A socket of its own, at this address of this machine.
pub fn endpoint(from: &str, narrow: bool) -> quinn::Endpoint {
    let provider = Arc::new(rustls::crypto::ring::default_provider());
    let mut tls = rustls::ClientConfig::builder_with_provider(provider.clone())
        .with_protocol_versions(&[&rustls::version::TLS13])
        .unwrap()
        .dangerous()
        .with_custom_certificate_verifier(Arc::new(Trusting(provider)))
        .with_no_client_auth();
    tls.alpn_protocols = vec![ALPN.to_vec()];
    let quic = quinn::crypto::rustls::QuicClientConfig::try_from(tls).unwrap();
    let mut config = quinn::ClientConfig::new(Arc::new(quic));
    let mut transport = quinn::TransportConfig::default();
    transport.keep_alive_interval(Some(Duration::from_secs(1))).datagram_send_buffer_size(256 * 1024);
    if narrow {
        transport.stream_receive_window(10u32.into()).receive_window(10u32.into());
    }
    config.transport_config(Arc::new(transport));
    let address: std::net::IpAddr = from.parse().unwrap();
    let mut endpoint = quinn::Endpoint::client((address, 0).into()).unwrap();
    endpoint.set_default_client_config(config);
    endpoint
}

/// A connection, and its control stream.
pub struct Peer {
    pub connection: quinn::Connection,
    send: quinn::SendStream,
    receive: Option<quinn::RecvStream>,
    reader: ControlReader,
    seq: u32,
    _endpoint: quinn::Endpoint,
}

impl Peer {
    /// Connects to whoever is there, and says nothing.
    pub async fn connect(address: SocketAddr) -> Peer {
        Peer::connect_by(endpoint("127.0.0.1", false), address).await
    }

    pub async fn connect_by(endpoint: quinn::Endpoint, address: SocketAddr) -> Peer {
        let connection = endpoint.connect(address, "eyeline").unwrap().await.unwrap();
        let (send, receive) = connection.open_bi().await.unwrap();
        Peer { connection, send, receive: Some(receive), reader: ControlReader::default(), seq: 0, _endpoint: endpoint }
    }

    /// Connects and is let in.
    pub async fn join(address: SocketAddr) -> Peer {
        let mut peer = Peer::connect(address).await;
        peer.say(&hello()).await;
        assert!(matches!(peer.hear().await, Some(ServerControl::Welcome(_))));
        peer
    }

    /// Writes to the control stream; whether that is still possible.
    pub async fn say(&mut self, bytes: &[u8]) -> bool {
        self.send.write_all(bytes).await.is_ok()
    }

    /// The next control message; `None` if the server has closed.
    pub async fn hear(&mut self) -> Option<ServerControl> {
        loop {
            if let Some(message) = self.reader.next_message().unwrap() {
                return Some(codec::decode_server_control(&message).unwrap());
            }
            let receive = self.receive.as_mut()?;
            let chunk = tokio::time::timeout(PATIENCE, receive.read_chunk(65_536, true)).await.expect("silence");
            self.reader.push(&chunk.ok()??.bytes);
        }
    }

    /// Reads the control stream from now on, and forgets what it says.
    pub fn read_on(&mut self) {
        if let Some(mut receive) = self.receive.take() {
            tokio::spawn(async move { while let Ok(Some(_)) = receive.read_chunk(65_536, true).await {} });
        }
    }

    /// Why it was sent away.
    pub async fn refusal(&mut self) -> Option<Refusal> {
        loop {
            if let ServerControl::Refused { refusal, .. } = self.hear().await? {
                return Some(refusal);
            }
        }
    }

    /// A datagram with these records.
    pub fn datagram(&mut self, records: impl IntoIterator<Item = ClientRecord>) -> Vec<u8> {
        self.seq += 1;
        let link = LinkHeader { seq: self.seq, ..LinkHeader::default() };
        let limit = self.connection.max_datagram_size().unwrap_or(1_150);
        let mut writer = DatagramWriter::new(&ClientHeader { link, frame: WorldTime::ZERO }, limit);
        let _fits = records.into_iter().all(|record| writer.push(&record));
        writer.finish()
    }

    /// Sends datagrams that `make` makes, as fast as QUIC takes them, until the server has had enough; how many.
    pub async fn flood(&mut self, make: impl Fn(u32) -> Option<ClientRecord>) -> usize {
        let mut sent = 0;
        let started = Instant::now();
        while started.elapsed() < PATIENCE {
            let bytes = self.datagram((0..).map_while(&make));
            // Waits for room in QUIC: what it drops floods nobody.
            if self.connection.send_datagram_wait(bytes.into()).await.is_err() {
                return sent;
            }
            sent += 1;
        }
        panic!("{sent} datagrams were borne");
    }
}

pub fn hello() -> Vec<u8> {
    codec::encode_control(&ClientControl::Hello {
        version: VERSION,
        token: Vec::new(),
        resolution: (320, 240),
        interest: Interest::Around,
        role: Role::Avatar,
        name: "somebody".into(),
        resume: None,
    })
}

pub fn request(object: u32, want: Want) -> ClientRecord {
    ClientRecord::Request { object: ObjectId(object), want, reason: Reason::Exposed }
}

/// Joins, and then reads nothing until its connection has ended. QUIC itself goes on, so that it does not count as gone.
pub fn join_and_read_nothing(address: SocketAddr) -> std::thread::JoinHandle<()> {
    std::thread::spawn(move || {
        runtime().block_on(async {
            let mut peer = Peer::connect_by(endpoint("127.0.0.1", true), address).await;
            assert!(peer.say(&hello()).await);
            peer.connection.closed().await;
        });
    })
}

/// Somebody who asks now and then, and waits for the answers, in a thread of its own.
pub struct Victim {
    thread: std::thread::JoinHandle<Vec<Duration>>,
    stop: mpsc::Sender<()>,
}

impl Victim {
    /// Joins, and begins to ask.
    pub fn join(address: SocketAddr) -> Victim {
        let (stop, stopped) = mpsc::channel();
        let (ready, is_ready) = mpsc::channel();
        let thread = std::thread::spawn(move || {
            runtime().block_on(async {
                let mut peer = Peer::join(address).await;
                peer.read_on();
                ready.send(()).unwrap();
                let mut waits = Vec::new();
                // A few in any case: some floods end at once.
                while waits.len() < 5 || stopped.try_recv() == Err(mpsc::TryRecvError::Empty) {
                    let bytes = peer.datagram([request(waits.len() as u32 % CHAIRS, Want::State)]);
                    let asked = Instant::now();
                    peer.connection.send_datagram(bytes.into()).unwrap();
                    loop {
                        let answer = tokio::time::timeout(PATIENCE, peer.connection.read_datagram());
                        let answer = answer.await.expect("an answer").expect("a connection");
                        let (header, _) = codec::decode_server_datagram(&answer).unwrap();
                        if header.link.ack == peer.seq {
                            break;
                        }
                    }
                    waits.push(asked.elapsed());
                    tokio::time::sleep(Duration::from_millis(13)).await;
                }
                waits
            })
        });
        is_ready.recv().unwrap();
        Victim { thread, stop }
    }

    /// Stops asking. The median answer must have come within a tick: others use these cores too, so that single ones may
    /// be late for reasons of their own.
    #[track_caller]
    pub fn assert_served(self, what: &str) {
        drop(self.stop);
        let mut waits = self.thread.join().expect("the victim lives");
        waits.sort_unstable();
        let median = waits[waits.len() / 2];
        println!("{what}: {} answers, median {median:?}, longest {:?}", waits.len(), waits[waits.len() - 1]);
        assert!(median < Duration::from_millis(50), "{what}: {waits:?}");
    }
}

/// Trusts every server.
#[derive(Debug)]
struct Trusting(Arc<rustls::crypto::CryptoProvider>);

impl ServerCertVerifier for Trusting {
    fn verify_server_cert(
        &self,
        _: &CertificateDer<'_>,
        _: &[CertificateDer<'_>],
        _: &ServerName<'_>,
        _: &[u8],
        _: UnixTime,
    ) -> Result<ServerCertVerified, Error> {
        Ok(ServerCertVerified::assertion())
    }

    fn verify_tls12_signature(
        &self,
        _: &[u8],
        _: &CertificateDer<'_>,
        _: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, Error> {
        Err(Error::General("QUIC has no TLS 1.2".into()))
    }

    fn verify_tls13_signature(
        &self,
        message: &[u8],
        certificate: &CertificateDer<'_>,
        signed: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, Error> {
        rustls::crypto::verify_tls13_signature(message, certificate, signed, &self.0.signature_verification_algorithms)
    }

    fn supported_verify_schemes(&self) -> Vec<SignatureScheme> {
        self.0.signature_verification_algorithms.supported_schemes()
    }
}
