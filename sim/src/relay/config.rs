//! What a relay is told, and what it says that it did.

use std::net::SocketAddr;
use std::time::Duration;

use crate::virtual_net::{Capacity, Direction, LinkRules, LinkStats};

/// What a relay does.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct RelayConfig {
    /// Where clients send to; port 0 takes a free one.
    pub listen: SocketAddr,
    /// The server.
    pub to: SocketAddr,
    /// The way to the server.
    pub up: LinkRules,
    /// The way from the server.
    pub down: LinkRules,
    /// How much the way to the server carries, for each client; blackouts count from the relay's start.
    pub up_capacity: Capacity,
    /// How much the way from the server carries.
    pub down_capacity: Capacity,
    /// Decides what is left to chance. With real sockets that does not make two runs alike.
    pub seed: u64,
    /// Most clients at a time; default 4096. Each costs a socket.
    pub clients_max: usize,
    /// After what time of silence, both ways, a client's socket is closed; default a minute.
    pub idle: Duration,
    /// Most bytes under way of all clients; default 64 MiB. What would be more is dropped and counted.
    pub queued_bytes_max: usize,
}

impl RelayConfig {
    /// A relay from `listen` to `to` that changes nothing.
    pub fn new(listen: SocketAddr, to: SocketAddr) -> RelayConfig {
        RelayConfig {
            listen,
            to,
            up: LinkRules::default(),
            down: LinkRules::default(),
            up_capacity: Capacity::default(),
            down_capacity: Capacity::default(),
            seed: 7,
            clients_max: 4096,
            idle: Duration::from_secs(60),
            queued_bytes_max: 64 << 20,
        }
    }

    /// Sets the rules of both directions.
    pub fn with_link(self, link: LinkRules) -> RelayConfig {
        RelayConfig { up: link, down: link, ..self }
    }

    /// Sets how much each direction carries.
    pub fn with_capacity(self, capacity: Capacity) -> RelayConfig {
        RelayConfig { up_capacity: capacity.clone(), down_capacity: capacity, ..self }
    }

    /// Sets the seed.
    pub fn with_seed(self, seed: u64) -> RelayConfig {
        RelayConfig { seed, ..self }
    }

    /// Sets the most clients at a time.
    pub fn with_clients_max(self, clients_max: usize) -> RelayConfig {
        RelayConfig { clients_max, ..self }
    }

    /// Sets after what time of silence a client's socket is closed.
    pub fn with_idle(self, idle: Duration) -> RelayConfig {
        RelayConfig { idle, ..self }
    }
}

/// Why there is no relay.
#[derive(Debug, thiserror::Error)]
pub enum RelayError {
    /// The address can't be listened on.
    #[error("cannot listen on {address}: {source}; choose another with --listen, port 0 for any that is free")]
    Bind {
        /// Which.
        address: SocketAddr,
        /// Why.
        source: std::io::Error,
    },
    /// It would send to itself.
    #[error("the relay would send to itself: {address} is both --listen and --to")]
    Loop {
        /// Which address.
        address: SocketAddr,
    },
}

/// One direction's counters, in datagrams unless they say otherwise.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct WayStats {
    /// That came.
    pub received: u64,
    /// Their bytes.
    pub received_bytes: u64,
    /// That were sent on; doubled ones twice.
    pub sent: u64,
    /// Their bytes.
    pub sent_bytes: u64,
    /// What links did.
    pub link: LinkStats,
    /// That the relay had no room for, or no more time to send: its own fault.
    pub dropped: u64,
}

/// What a relay did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RelayStats {
    /// To the server.
    pub up: WayStats,
    /// From the server.
    pub down: WayStats,
    /// Clients with a socket at present.
    pub clients: usize,
    /// Clients that ever had one.
    pub clients_ever: u64,
    /// Datagrams of clients that could not have a socket.
    pub refused: u64,
    /// Clients whose socket was closed for silence.
    pub idled: u64,
    /// Bytes under way at present.
    pub queued_bytes: usize,
}

impl std::fmt::Display for RelayStats {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} clients", self.clients)?;
        for (name, way) in [("up", &self.up), ("down", &self.down)] {
            let WayStats { received, sent, sent_bytes, link, dropped, .. } = way;
            let LinkStats { lost, overflowed, dark, twice } = link;
            write!(f, "; {name}: {received} in, {sent} out ({sent_bytes} B), {lost} lost, {twice} doubled, ")?;
            write!(f, "{overflowed} over the rate, {dark} in the dark, {dropped} dropped here")?;
        }
        write!(f, "; {} refused, {} gone idle", self.refused, self.idled)
    }
}

impl RelayStats {
    pub(super) fn way(&mut self, direction: Direction) -> &mut WayStats {
        match direction {
            Direction::Up => &mut self.up,
            Direction::Down => &mut self.down,
        }
    }
}
