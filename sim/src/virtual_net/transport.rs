//! What is between the cores and the link: nothing, or QUIC.
//!
//! A [`Transport`] does no I/O and knows no chance: it is told what is to be sent and what arrived, and says which packets
//! are to be put on their way. The run puts them through the links. [`Direct`] is the lighter one: each datagram is a
//! packet, and the control stream is left to the link. QUIC is in [`crate::quic_net`].

use std::collections::VecDeque;
use std::time::Duration;

use eyeline_protocol::WorldTime;
use eyeline_protocol::codec::DecodeError;
use eyeline_server::world::PathState;

use super::client::ClientPlan;
use super::link::Direction;

/// What a transport wants done, or tells.
#[derive(Debug)]
pub(crate) enum Output {
    /// Put this packet on its way, through the link's rules. Clients have numbers, here and in what follows.
    Packet {
        client: usize,
        direction: Direction,
        bytes: Vec<u8>,
        /// The datagrams within, if they are not the packet itself.
        carried: Vec<Vec<u8>>,
    },
    /// Put a control message on its way, reliably: the link has it arrive late rather than never.
    Reliable { client: usize, direction: Direction, message: Vec<u8> },
    /// Tell the other end, reliably and after all that was said, that this one is closed.
    Goodbye { client: usize, direction: Direction, reason: String },
    /// Call [`Transport::handle_wake`] then.
    Wake { client: usize, direction: Direction, at: WorldTime },
    /// The server has a new connection.
    Connected { client: usize, datagram_limit: usize },
    /// A datagram has arrived.
    Datagram { client: usize, direction: Direction, bytes: Vec<u8> },
    /// A control message has arrived, without its length prefix.
    Control { client: usize, direction: Direction, message: Vec<u8> },
    /// The control stream can't be cut into messages.
    Broken { client: usize, direction: Direction, error: DecodeError },
    /// A datagram left the sender's buffer for a newer one.
    Dropped { client: usize, direction: Direction, bytes: Vec<u8> },
    /// The connection is over for the end that `direction` leads to.
    Over { client: usize, direction: Direction, reason: String },
}

/// Carries datagrams and control messages between one server and its clients.
///
/// Of a client's two ends, the one that sends in a direction is named by it. All that comes of a call is had by
/// [`Transport::poll`], in order.
pub(crate) trait Transport {
    /// The next client connects.
    fn connect(&mut self, client: usize, plan: &ClientPlan, now: WorldTime);

    /// Sends a datagram.
    fn send_datagram(&mut self, client: usize, direction: Direction, bytes: Vec<u8>, now: WorldTime);

    /// Sends bytes of the control stream, length prefix included.
    fn send_control(&mut self, client: usize, direction: Direction, bytes: &[u8]);

    /// Closes the end that sends in `direction`, after all that it has said.
    fn close(&mut self, client: usize, direction: Direction, reason: &str, now: WorldTime);

    /// A packet has arrived.
    fn handle_packet(&mut self, client: usize, direction: Direction, bytes: Vec<u8>, now: WorldTime);

    /// The time of an [`Output::Wake`] has come.
    fn handle_wake(&mut self, client: usize, direction: Direction, now: WorldTime) {
        let _ = (client, direction, now);
    }

    /// What is to be done next.
    fn poll(&mut self, now: WorldTime) -> Option<Output>;

    /// Most bytes in a client's datagram; `None` while it can send none.
    fn datagram_limit(&mut self, client: usize) -> Option<usize>;

    /// Whether packets are something else than datagrams.
    fn is_packed(&self) -> bool {
        true
    }

    /// Longest time for which a datagram waited at the end that sends in `direction` until it left, or was dropped.
    fn waited_max(&self, client: usize, direction: Direction) -> Duration {
        let _ = (client, direction);
        Duration::ZERO
    }

    /// What the end that sends in `direction` knows of its path; `None` where nothing ever waits.
    fn path(&self, client: usize, direction: Direction, now: WorldTime) -> Option<PathState> {
        let _ = (client, direction, now);
        None
    }

    /// A client's UDP datagrams and bytes so far: sent, sent bytes, received, received bytes. `None` without UDP.
    fn udp(&self, client: usize) -> Option<[u64; 4]> {
        let _ = client;
        None
    }
}

/// No transport: what is said is what is sent.
#[derive(Default)]
pub(super) struct Direct {
    limits: Vec<usize>,
    out: VecDeque<Output>,
}

impl Transport for Direct {
    fn connect(&mut self, client: usize, plan: &ClientPlan, _: WorldTime) {
        debug_assert_eq!(client, self.limits.len(), "clients are numbered as they come");
        self.limits.push(plan.datagram_limit);
        self.out.push_back(Output::Connected { client, datagram_limit: plan.datagram_limit });
    }

    fn send_datagram(&mut self, client: usize, direction: Direction, bytes: Vec<u8>, _: WorldTime) {
        self.out.push_back(Output::Packet { client, direction, bytes, carried: Vec::new() });
    }

    fn send_control(&mut self, client: usize, direction: Direction, bytes: &[u8]) {
        let message = bytes.get(4..).unwrap_or_default().to_vec();
        self.out.push_back(Output::Reliable { client, direction, message });
    }

    fn close(&mut self, client: usize, direction: Direction, reason: &str, _: WorldTime) {
        let reason = reason.to_owned();
        self.out.push_back(Output::Goodbye { client, direction, reason: reason.clone() });
        if direction == Direction::Down {
            self.out.push_back(Output::Over { client, direction: Direction::Up, reason });
        }
    }

    fn handle_packet(&mut self, client: usize, direction: Direction, bytes: Vec<u8>, _: WorldTime) {
        self.out.push_back(Output::Datagram { client, direction, bytes });
    }

    fn poll(&mut self, _: WorldTime) -> Option<Output> {
        self.out.pop_front()
    }

    fn is_packed(&self) -> bool {
        false
    }

    fn datagram_limit(&mut self, client: usize) -> Option<usize> {
        self.limits.get(client).copied()
    }
}
