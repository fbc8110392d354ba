//! What would this world be like over a bad path? A relay of UDP datagrams in user space, to put in front of any server.
//!
//! Clients send to the relay instead of to the server. Each client address gets a socket of its own towards the server,
//! so that the server tells clients apart as it would without a relay. Each direction of each client's path is a
//! [`VirtualLink`], the same as in virtual time. What is inside datagrams is no matter. Timers are tokio's: a datagram
//! leaves at most about a millisecond later than its link says, and never earlier.

// This is a driver: it may read the clock.
#![expect(clippy::disallowed_methods)]

mod config;

use std::collections::BTreeMap;
use std::future::{Future, poll_fn};
use std::net::SocketAddr;
use std::pin::Pin;
use std::task::{Context, Poll};
use std::time::{Duration, Instant};

pub use config::{RelayConfig, RelayError, RelayStats, WayStats};
use eyeline_protocol::WorldTime;
use eyeline_server::net::socket;
use tokio::io::ReadBuf;
use tokio::net::UdpSocket;
use tokio::time::Sleep;

use crate::virtual_net::queue::Queue;
use crate::virtual_net::{Direction, Fate, VirtualLink};

/// What a datagram under way costs besides its bytes, so that empty ones have a limit, too.
const ENTRY_BYTES: usize = 128;

/// One client.
struct Peer {
    /// Towards the server.
    socket: UdpSocket,
    up: VirtualLink,
    down: VirtualLink,
    heard_at: WorldTime,
}

/// A datagram under way.
struct UnderWay {
    client: SocketAddr,
    direction: Direction,
    bytes: Vec<u8>,
    /// How often the socket would not take it.
    tries: u32,
}

/// A relay that listens, and runs when told to.
pub struct Relay {
    config: RelayConfig,
    socket: UdpSocket,
    peers: BTreeMap<SocketAddr, Peer>,
    queue: Queue<UnderWay>,
    stats: RelayStats,
    epoch: Instant,
    buffer: Vec<u8>,
}

/// Rounds of receiving before the task lets others run.
const ROUNDS: usize = 16;

/// Datagrams that are received from one socket before the next one's turn.
const BATCH: usize = 64;

/// Largest UDP datagram.
const DATAGRAM_BYTES: usize = 65_536;

/// How often, and after what time, a datagram is offered again to a socket that would not take it.
const TRIES: u32 = 20;
const RETRY: Duration = Duration::from_millis(1);

/// How often silence is looked for, and progress told.
const PULSE: Duration = Duration::from_secs(1);

impl Relay {
    /// Listens. Needs a tokio runtime around it.
    ///
    /// # Errors
    /// If the address is taken, or is the server's own.
    pub fn bind(config: RelayConfig) -> Result<Relay, RelayError> {
        let address = config.listen;
        if address == config.to {
            return Err(RelayError::Loop { address });
        }
        let bound = socket(address).and_then(UdpSocket::from_std);
        let socket = bound.map_err(|source| RelayError::Bind { address, source })?;
        Ok(Relay {
            config,
            socket,
            peers: BTreeMap::new(),
            queue: Queue::new(),
            stats: RelayStats::default(),
            epoch: Instant::now(),
            buffer: vec![0; DATAGRAM_BYTES],
        })
    }

    /// Where it listens.
    ///
    /// # Errors
    /// If the system has forgotten.
    pub fn local_addr(&self) -> std::io::Result<SocketAddr> {
        self.socket.local_addr()
    }

    /// Relays until `shutdown` is ready; returns what it did. `pulse` is told every second.
    pub async fn run(mut self, shutdown: impl Future<Output = ()>, mut pulse: impl FnMut(&RelayStats)) -> RelayStats {
        tokio::pin!(shutdown);
        let timer = tokio::time::sleep_until(self.epoch.into());
        tokio::pin!(timer);
        let mut pulse_at = WorldTime::ZERO + PULSE;
        // Many sockets are polled at once, which is no reason for tokio to think that this task takes too long.
        let all = poll_fn(|cx| {
            if shutdown.as_mut().poll(cx).is_ready() {
                return Poll::Ready(());
            }
            if self.now() >= pulse_at {
                pulse_at = self.now() + PULSE;
                self.close_idle();
                pulse(&self.snapshot());
            }
            self.work(cx, timer.as_mut(), pulse_at);
            Poll::Pending
        });
        tokio::task::coop::unconstrained(all).await;
        self.snapshot()
    }

    fn now(&self) -> WorldTime {
        WorldTime::ZERO + self.epoch.elapsed()
    }

    /// Receives and sends all that there is, and has the task woken when there is more.
    fn work(&mut self, cx: &mut Context<'_>, mut timer: Pin<&mut Sleep>, pulse_at: WorldTime) {
        for _ in 0..ROUNDS {
            self.send_due();
            let is_busy = self.receive_from_clients(cx) | self.receive_from_server(cx);
            if is_busy {
                continue;
            }
            let due = self.queue.next_at().unwrap_or(pulse_at).min(pulse_at);
            timer.as_mut().reset((self.epoch + due.since(WorldTime::ZERO)).into());
            if timer.as_mut().poll(cx).is_pending() {
                return;
            }
        }
        cx.waker().wake_by_ref();
    }

    fn send_due(&mut self) {
        let now = self.now();
        while let Some((_, mut under_way)) = self.queue.pop_by(now) {
            let UnderWay { client, direction, ref bytes, tries } = under_way;
            let sent = match (direction, self.peers.get(&client)) {
                (Direction::Down, _) => self.socket.try_send_to(bytes, client),
                (Direction::Up, Some(peer)) => peer.socket.try_send(bytes),
                (Direction::Up, None) => Err(std::io::ErrorKind::NotConnected.into()),
            };
            // A socket's buffer may be full, and a new socket is not known to be ready until tokio has looked.
            if sent.as_ref().is_err_and(|error| error.kind() == std::io::ErrorKind::WouldBlock) && tries < TRIES {
                under_way.tries += 1;
                self.queue.push(now + RETRY, under_way);
                continue;
            }
            self.stats.queued_bytes -= bytes.len() + ENTRY_BYTES;
            let bytes = bytes.len() as u64;
            let way = self.stats.way(direction);
            match sent {
                Ok(_) => {
                    way.sent += 1;
                    way.sent_bytes += bytes;
                }
                Err(_) => way.dropped += 1,
            }
        }
    }

    fn receive_from_clients(&mut self, cx: &mut Context<'_>) -> bool {
        let mut buffer = std::mem::take(&mut self.buffer);
        let mut is_any = false;
        for _ in 0..BATCH {
            let mut read = ReadBuf::new(&mut buffer);
            match self.socket.poll_recv_from(cx, &mut read) {
                Poll::Pending => break,
                Poll::Ready(from) => {
                    is_any = true;
                    // An error is an earlier datagram's: its client has gone.
                    if let Ok(client) = from
                        && self.admit(client)
                    {
                        self.put(client, Direction::Up, read.filled().to_vec());
                    }
                }
            }
        }
        self.buffer = buffer;
        is_any
    }

    fn receive_from_server(&mut self, cx: &mut Context<'_>) -> bool {
        let mut buffer = std::mem::take(&mut self.buffer);
        let mut arrived = Vec::new();
        let mut is_any = false;
        for (&client, peer) in &self.peers {
            for _ in 0..BATCH {
                let mut read = ReadBuf::new(&mut buffer);
                match peer.socket.poll_recv(cx, &mut read) {
                    Poll::Pending => break,
                    Poll::Ready(received) => {
                        is_any = true;
                        // An error says that no server listens; clients find out by its silence, as without a relay.
                        if received.is_ok() {
                            arrived.push((client, read.filled().to_vec()));
                        }
                    }
                }
            }
        }
        self.buffer = buffer;
        for (client, bytes) in arrived {
            self.put(client, Direction::Down, bytes);
        }
        is_any
    }

    /// Whether this client has a socket; gives it one if it can.
    fn admit(&mut self, client: SocketAddr) -> bool {
        if self.peers.contains_key(&client) {
            return true;
        }
        let socket = if self.peers.len() < self.config.clients_max { upstream(self.config.to) } else { None };
        let Some(socket) = socket else {
            self.stats.refused += 1;
            return false;
        };
        let chance = |way| crate::chance(self.config.seed, 2 * self.stats.clients_ever + way);
        let up = VirtualLink::new(self.config.up, chance(0));
        let down = VirtualLink::new(self.config.down, chance(1));
        let peer = Peer {
            socket,
            up: up.with_capacity(self.config.up_capacity.clone(), WorldTime::ZERO),
            down: down.with_capacity(self.config.down_capacity.clone(), WorldTime::ZERO),
            heard_at: self.now(),
        };
        self.stats.clients_ever += 1;
        self.peers.insert(client, peer);
        true
    }

    /// Puts a datagram on its way, as its link decides.
    fn put(&mut self, client: SocketAddr, direction: Direction, bytes: Vec<u8>) {
        let now = self.now();
        let Some(peer) = self.peers.get_mut(&client) else { return };
        peer.heard_at = now;
        let link = if direction == Direction::Up { &mut peer.up } else { &mut peer.down };
        let (first, second) = link.datagram(bytes.len(), now);
        let way = self.stats.way(direction);
        way.received += 1;
        way.received_bytes += bytes.len() as u64;
        for fate in [Some(first), second].into_iter().flatten() {
            let Fate::Deliver(delay) = fate else { continue };
            if self.stats.queued_bytes + bytes.len() + ENTRY_BYTES > self.config.queued_bytes_max {
                self.stats.way(direction).dropped += 1;
                continue;
            }
            self.stats.queued_bytes += bytes.len() + ENTRY_BYTES;
            self.queue.push(now + delay, UnderWay { client, direction, bytes: bytes.clone(), tries: 0 });
        }
    }

    fn close_idle(&mut self) {
        let (now, idle) = (self.now(), self.config.idle);
        let stats = &mut self.stats;
        self.peers.retain(|_, peer| {
            let is_idle = now.since(peer.heard_at) > idle;
            if is_idle {
                stats.idled += 1;
                stats.up.link += *peer.up.stats();
                stats.down.link += *peer.down.stats();
            }
            !is_idle
        });
    }

    fn snapshot(&self) -> RelayStats {
        let mut stats = RelayStats { clients: self.peers.len(), ..self.stats };
        for peer in self.peers.values() {
            stats.up.link += *peer.up.stats();
            stats.down.link += *peer.down.stats();
        }
        stats
    }
}

/// A socket of one client's own towards the server; `None` if the system has no more.
fn upstream(to: SocketAddr) -> Option<UdpSocket> {
    let any: SocketAddr = match (to, to.ip().is_loopback()) {
        (SocketAddr::V4(_), true) => (std::net::Ipv4Addr::LOCALHOST, 0).into(),
        (SocketAddr::V4(_), false) => (std::net::Ipv4Addr::UNSPECIFIED, 0).into(),
        (SocketAddr::V6(_), true) => (std::net::Ipv6Addr::LOCALHOST, 0).into(),
        (SocketAddr::V6(_), false) => (std::net::Ipv6Addr::UNSPECIFIED, 0).into(),
    };
    let socket = socket(any).ok()?;
    socket.connect(to).ok()?;
    UdpSocket::from_std(socket).ok()
}

#[cfg(test)]
mod tests;
