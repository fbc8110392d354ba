//! What the world has to say, handed to QUIC: datagrams as long as they leave, control messages to each connection's task.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use bytes::Bytes;
use eyeline_protocol::WorldTime;
use tokio::sync::mpsc;

use super::connection::HEARING;
use super::{CommitHook, ShellStats};
use crate::world::{PathState, SessionId, Transmit, World, room};

/// Room in QUIC for one client's datagrams of a tick, bytes.
pub(super) const DATAGRAM_BUFFER: usize = 64 * 1024;

/// Most control messages that wait for one client. A joining client of a full world is told of 16 M objects in 65,536.
pub(super) const CONTROL_QUEUE: usize = 4096;

/// Most bytes of control messages that wait for one client, and more for each object: who joins is told of all of them at
/// once, in entries of at most 566 bytes. Who does not read does not make us keep more.
const CONTROL_BYTES: usize = 1 << 20;
const CONTROL_BYTES_PER_OBJECT: usize = 600;

/// A connection as it is sent to.
pub(super) struct Peer {
    pub connection: quinn::Connection,
    control: mpsc::Sender<Outgoing>,
    /// Datagrams that the world has not heard yet, and when they arrived: where nothing comes of them before the next tick, those of all
    /// are handled together then, while the code is at hand. Fewer than [`INBOX`].
    inbox: Vec<(WorldTime, Bytes)>,
    /// Bytes of control messages that wait to be taken by QUIC.
    pub waiting: Arc<AtomicUsize>,
    /// When the oldest datagram was handed to QUIC that may still wait there.
    queued_at: Option<WorldTime>,
    /// The room in QUIC's buffer when nothing waits: quinn keeps some of it for itself.
    empty_space: usize,
    /// Congestion window and round trip, and when QUIC said so: it copies all its counters to say anything.
    path: Option<(WorldTime, u64, Duration)>,
    /// Whether it was closed since it does not read; its task will notice.
    is_closed: bool,
}

impl Peer {
    pub fn new(connection: quinn::Connection, control: mpsc::Sender<Outgoing>) -> Peer {
        let empty_space = connection.datagram_send_buffer_space();
        Peer {
            connection,
            control,
            inbox: Vec::new(),
            waiting: Arc::default(),
            queued_at: None,
            empty_space,
            path: None,
            is_closed: false,
        }
    }

    fn hear(&mut self, id: SessionId, world: &mut World) {
        for (at, datagram) in self.inbox.drain(..) {
            world.handle_datagram(id, &datagram, at);
        }
    }

    /// How many bytes of datagrams QUIC will have sent a tick from now if it gets them now.
    fn room(&mut self, now: WorldTime, tick: Duration) -> usize {
        let queued_bytes = self.empty_space.saturating_sub(self.connection.datagram_send_buffer_space());
        if queued_bytes == 0 {
            self.queued_at = None;
        }
        let (_, window_bytes, round_trip) = match self.path.filter(|&(at, ..)| now.since(at) < tick / 2) {
            Some(path) => path,
            None => {
                let path = self.connection.stats().path;
                *self.path.insert((now, path.cwnd, path.rtt))
            }
        };
        let waited = self.queued_at.map(|at| now.since(at));
        room(PathState { waited, queued_bytes, window_bytes, round_trip }, tick)
    }
}

/// So many datagrams of one client do not wait for the tick.
const INBOX: usize = 64;

/// What a connection's task is to write.
pub(super) enum Outgoing {
    Control(Arc<[u8]>),
    WorldBytes,
    Close(String),
}

/// The world and those who are connected to it, under one lock.
pub(super) struct Core {
    pub world: World,
    pub peers: BTreeMap<SessionId, Peer>,
    pub hook: Option<CommitHook>,
    pub stats: ShellStats,
}

impl Core {
    /// Keeps a datagram for the tick, or has the world hear it at once if answers do not wait, or if too much waits.
    pub fn take_in(&mut self, id: SessionId, datagram: Bytes, now: WorldTime) {
        let Some(peer) = self.peers.get_mut(&id).filter(|_| self.world.answers_with_tick()) else {
            return self.world.handle_datagram(id, &datagram, now);
        };
        peer.inbox.push((now, datagram));
        if peer.inbox.len() >= INBOX {
            peer.hear(id, &mut self.world);
        }
    }

    /// Has the world hear what waits of one client, in the order in which it arrived: before anything else that it says.
    pub fn hear(&mut self, id: SessionId) {
        if let Some(peer) = self.peers.get_mut(&id) {
            peer.hear(id, &mut self.world);
        }
    }

    /// The same of all.
    pub fn hear_all(&mut self) {
        for (&id, peer) in &mut self.peers {
            peer.hear(id, &mut self.world);
        }
    }

    /// Sends everything that the world has to say and that leaves at once.
    pub fn flush(&mut self, now: WorldTime) {
        let tick = self.world.tick_period();
        loop {
            let peers = &mut self.peers;
            let room = |id| peers.get_mut(&id).map_or(usize::MAX, |peer| peer.room(now, tick));
            let Some((id, transmit)) = self.world.poll_transmit_where(now, room) else { break };
            let Some(peer) = self.peers.get_mut(&id).filter(|peer| !peer.is_closed) else { continue };
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
                Transmit::Close(reason) => {
                    // Who does not read what comes before does not put it off.
                    let connection = peer.connection.clone();
                    let last = reason.clone().into_bytes();
                    tokio::spawn(async move {
                        tokio::time::sleep(2 * HEARING).await;
                        connection.close(0u32.into(), &last);
                    });
                    Outgoing::Close(reason)
                }
            };
            let waiting = match &outgoing {
                Outgoing::Control(bytes) => peer.waiting.fetch_add(bytes.len(), Ordering::Relaxed),
                _ => 0,
            };
            let most = CONTROL_BYTES + CONTROL_BYTES_PER_OBJECT * self.world.objects().len();
            if waiting > most || peer.control.try_send(outgoing).is_err() {
                self.stats.slow_readers += 1;
                peer.is_closed = true;
                peer.connection.close(1u32.into(), b"does not read its control stream");
            }
        }
    }
}
