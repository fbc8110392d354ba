//! What does QUIC itself cost and lose? quinn's own state machines in virtual time.
//!
//! A [`QuicNet`] is one server and its clients, each with a [`quinn_proto::Endpoint`] of its own; handshakes, packet
//! numbers, loss recovery, congestion control, pacing and idle time-outs are quinn's, and the settings are those of
//! `eyeline_server::net` and `eyeline_client::net`. Its clock is the run's: `Instant`s are made from virtual
//! microseconds, and only their differences matter.
//!
//! The same seed gives the same decoded datagrams and control messages at the same virtual microsecond. Endpoints take
//! their randomness from the seed, connection ids too, and the server's Ed25519 identity is fixed. What TLS draws from the
//! system (key shares, randoms, session tickets) has a fixed size and ends up in ciphertext only.
//!
//! What is left out: segmentation offload (each packet goes alone), ECN, and the model's bytes.

// Instants have no other beginning than now; nothing depends on when that was.
#![expect(clippy::disallowed_methods)]

mod end;
mod ids;

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::net::{Ipv6Addr, SocketAddr};
use std::sync::Arc;
use std::time::{Duration, Instant};

use bytes::BytesMut;
use eyeline_client::net::Fingerprint;
use eyeline_protocol::WorldTime;
use eyeline_server::net::Identity;
use eyeline_server::world::PathState;
use quinn_proto::{ConnectionEvent, DatagramEvent, Endpoint, EndpointConfig, Transmit};
use rand::RngExt;

use crate::virtual_net::transport::{Output, Transport};
use crate::virtual_net::{ClientPlan, Direction};
use end::End;
use ids::{SeededIds, first_id};

/// One server and its clients over QUIC.
pub(crate) struct QuicNet {
    clock: Clock,
    seed: u64,
    fingerprint: Fingerprint,
    server: Endpoint,
    peers: Vec<Peer>,
    /// Which client the server's connections belong to.
    handles: BTreeMap<usize, usize>,
    /// Ends that something has happened to.
    dirty: BTreeSet<(usize, Direction)>,
    out: VecDeque<Output>,
    /// Scratch for packets.
    packet: Vec<u8>,
}

/// One client's endpoint, and both ends of its connection while there is one.
struct Peer {
    endpoint: Endpoint,
    client: Option<End>,
    server: Option<End>,
}

/// Virtual time and quinn's.
#[derive(Clone, Copy)]
struct Clock {
    epoch: Instant,
    begin: WorldTime,
}

impl Clock {
    fn instant(&self, at: WorldTime) -> Instant {
        self.epoch + at.since(self.begin)
    }

    /// The first microsecond that is not before `instant`.
    fn time(&self, instant: Instant) -> WorldTime {
        let nanos = instant.saturating_duration_since(self.epoch).as_nanos();
        self.begin.offset_micros(i64::try_from(nanos.div_ceil(1_000)).unwrap_or(i64::MAX))
    }
}

/// Streams of chance, apart from those of links.
const SERVER_CHANCE: u64 = 1 << 40;

impl QuicNet {
    /// A server without clients.
    ///
    /// # Errors
    /// If TLS can't be set up.
    pub fn new(seed: u64, now: WorldTime) -> anyhow::Result<QuicNet> {
        let identity = Identity::simulated()?;
        let fingerprint = Fingerprint(identity.fingerprint());
        let config = eyeline_server::net::quic_config(identity)?;
        let server = Endpoint::new(Arc::new(endpoint(seed, SERVER_CHANCE)), Some(Arc::new(config)), true, None);
        // Proved here once, so that a client's own can't fail later.
        eyeline_client::net::quic_config(fingerprint)?;
        Ok(QuicNet {
            clock: Clock { epoch: Instant::now(), begin: now },
            seed,
            fingerprint,
            server,
            peers: Vec::new(),
            handles: BTreeMap::new(),
            dirty: BTreeSet::new(),
            out: VecDeque::new(),
            packet: Vec::new(),
        })
    }

    fn end(&mut self, client: usize, direction: Direction) -> Option<&mut End> {
        let peer = self.peers.get_mut(client)?;
        match direction {
            Direction::Up => peer.client.as_mut(),
            Direction::Down => peer.server.as_mut(),
        }
    }

    /// The end, which is looked after in the next [`Transport::poll`].
    fn touch(&mut self, client: usize, direction: Direction) -> Option<&mut End> {
        self.dirty.insert((client, direction));
        self.end(client, direction)
    }

    /// What an endpoint answers without a connection.
    fn respond(&mut self, client: usize, direction: Direction, transmit: &Transmit) {
        let bytes = self.packet[..transmit.size].to_vec();
        self.out.push_back(Output::Packet { client, direction, bytes, carried: Vec::new() });
    }

    fn arrives_at_client(&mut self, client: usize, bytes: &[u8], now: WorldTime) {
        let at = self.clock.instant(now);
        let Some(peer) = self.peers.get_mut(client) else { return };
        self.packet.clear();
        match peer.endpoint.handle(at, server_address(), None, None, BytesMut::from(bytes), &mut self.packet) {
            Some(DatagramEvent::ConnectionEvent(_, event)) => self.take(client, Direction::Up, event),
            Some(DatagramEvent::Response(transmit)) => self.respond(client, Direction::Up, &transmit),
            // A client accepts nobody, and quinn says so by itself.
            Some(DatagramEvent::NewConnection(incoming)) => peer.endpoint.ignore(incoming),
            None => {}
        }
    }

    fn arrives_at_server(&mut self, client: usize, bytes: &[u8], now: WorldTime) {
        let at = self.clock.instant(now);
        self.packet.clear();
        match self.server.handle(at, client_address(client), None, None, BytesMut::from(bytes), &mut self.packet) {
            Some(DatagramEvent::ConnectionEvent(handle, event)) => {
                if let Some(&owner) = self.handles.get(&handle.0) {
                    self.take(owner, Direction::Down, event);
                }
            }
            Some(DatagramEvent::Response(transmit)) => self.respond(client, Direction::Down, &transmit),
            // A client has one connection; a first packet that comes again, much later, begins no other.
            Some(DatagramEvent::NewConnection(incoming)) if self.peers[client].server.is_some() => {
                self.server.ignore(incoming);
            }
            Some(DatagramEvent::NewConnection(incoming)) => {
                match self.server.accept(incoming, at, &mut self.packet, None) {
                    Ok((handle, connection)) => {
                        self.handles.insert(handle.0, client);
                        self.peers[client].server = Some(End::new(handle, connection, Direction::Down));
                        self.dirty.insert((client, Direction::Down));
                    }
                    Err(refused) => {
                        if let Some(transmit) = refused.response {
                            self.respond(client, Direction::Down, &transmit);
                        }
                    }
                }
            }
            None => {}
        }
    }

    fn take(&mut self, client: usize, direction: Direction, event: ConnectionEvent) {
        if let Some(end) = self.touch(client, direction) {
            end.connection.handle_event(event);
        }
    }

    /// Lets one end do all that it can do now.
    fn look_after(&mut self, client: usize, direction: Direction, now: WorldTime) {
        let at = self.clock.instant(now);
        let Peer { endpoint, client: own, server } = &mut self.peers[client];
        let (endpoint, slot) = match direction {
            Direction::Up => (endpoint, own),
            Direction::Down => (&mut self.server, server),
        };
        let Some(end) = slot else { return };
        loop {
            let mut is_quiet = true;
            while let Some(event) = end.connection.poll_endpoint_events() {
                is_quiet = false;
                if let Some(event) = endpoint.handle_event(end.handle, event) {
                    end.connection.handle_event(event);
                }
            }
            is_quiet &= !end.hear(client, &mut self.out);
            end.write();
            end.close_if_due(at, now, client, &mut self.out);
            is_quiet &= !end.transmit(client, (at, now), &mut self.packet, &mut self.out);
            if is_quiet {
                break;
            }
        }
        if end.connection.is_drained() {
            if direction == Direction::Down {
                self.handles.remove(&end.handle.0);
            }
            *slot = None;
            return;
        }
        let timeout = end.connection.poll_timeout().map(|timeout| self.clock.time(timeout));
        if let Some(due) = [timeout, end.close_by()].into_iter().flatten().min()
            && end.arm(due.max(now))
        {
            self.out.push_back(Output::Wake { client, direction, at: due.max(now) });
        }
    }
}

impl Transport for QuicNet {
    fn connect(&mut self, client: usize, _: &ClientPlan, now: WorldTime) {
        debug_assert_eq!(client, self.peers.len(), "clients are numbered as they come");
        let purpose = SERVER_CHANCE + 1 + client as u64;
        let mut endpoint = Endpoint::new(Arc::new(endpoint(self.seed, purpose)), None, true, None);
        // A configuration of its own: people at different machines share no tickets.
        let end = eyeline_client::net::quic_config(self.fingerprint).ok().and_then(|mut config| {
            let seed = self.seed;
            config.initial_dst_cid_provider(Arc::new(move || first_id(seed, purpose)));
            endpoint.connect(self.clock.instant(now), config, server_address(), "eyeline").ok()
        });
        debug_assert!(end.is_some(), "the same settings were good enough when the run began");
        let client_end = end.map(|(handle, connection)| End::new(handle, connection, Direction::Up));
        self.peers.push(Peer { endpoint, client: client_end, server: None });
        self.dirty.insert((client, Direction::Up));
    }

    fn send_datagram(&mut self, client: usize, direction: Direction, bytes: Vec<u8>, now: WorldTime) {
        let mut dropped = Vec::new();
        if let Some(end) = self.touch(client, direction) {
            end.send_datagram(bytes, now, &mut dropped);
        }
        self.out.extend(dropped.into_iter().map(|bytes| Output::Dropped { client, direction, bytes }));
    }

    fn send_control(&mut self, client: usize, direction: Direction, bytes: &[u8]) {
        if let Some(end) = self.touch(client, direction) {
            end.unwritten.extend(bytes);
        }
    }

    fn close(&mut self, client: usize, direction: Direction, reason: &str, now: WorldTime) {
        if let Some(end) = self.touch(client, direction) {
            end.close(reason, now);
        }
    }

    fn handle_packet(&mut self, client: usize, direction: Direction, bytes: Vec<u8>, now: WorldTime) {
        match direction {
            Direction::Up => self.arrives_at_server(client, &bytes, now),
            Direction::Down => self.arrives_at_client(client, &bytes, now),
        }
    }

    fn handle_wake(&mut self, client: usize, direction: Direction, now: WorldTime) {
        let at = self.clock.instant(now);
        if let Some(end) = self.end(client, direction)
            && end.disarm(now)
        {
            end.connection.handle_timeout(at);
            self.dirty.insert((client, direction));
        }
    }

    fn poll(&mut self, now: WorldTime) -> Option<Output> {
        loop {
            if let Some(output) = self.out.pop_front() {
                return Some(output);
            }
            let (client, direction) = self.dirty.pop_first()?;
            self.look_after(client, direction, now);
        }
    }

    fn datagram_limit(&mut self, client: usize) -> Option<usize> {
        let end = self.end(client, Direction::Up)?;
        if end.is_open() { end.connection.datagrams().max_size() } else { None }
    }

    fn waited_max(&self, client: usize, direction: Direction) -> Duration {
        let Some(peer) = self.peers.get(client) else { return Duration::ZERO };
        let end = if direction == Direction::Up { &peer.client } else { &peer.server };
        end.as_ref().map_or(Duration::ZERO, End::waited_max)
    }

    fn path(&self, client: usize, direction: Direction, now: WorldTime) -> Option<PathState> {
        let peer = self.peers.get(client)?;
        let end = if direction == Direction::Up { &peer.client } else { &peer.server };
        Some(end.as_ref()?.path(now))
    }

    fn udp(&self, client: usize) -> Option<[u64; 4]> {
        let stats = self.peers.get(client)?.client.as_ref()?.connection.stats();
        Some([stats.udp_tx.datagrams, stats.udp_tx.bytes, stats.udp_rx.datagrams, stats.udp_rx.bytes])
    }
}

/// What an endpoint leaves to chance comes from the seed.
fn endpoint(seed: u64, purpose: u64) -> EndpointConfig {
    let mut config = EndpointConfig::default();
    config.rng_seed(Some(crate::chance(seed, 2 * purpose).random()));
    config.cid_generator(move || Box::new(SeededIds::new(seed, 2 * purpose + 1)));
    config
}

fn server_address() -> SocketAddr {
    (Ipv6Addr::LOCALHOST, 4433).into()
}

/// An address for each client, as if each had a machine of its own.
fn client_address(client: usize) -> SocketAddr {
    (Ipv6Addr::from(0xfd00 << 112 | client as u128), 50_000).into()
}
