//! Connection ids that the seed decides.

use std::time::Duration;

use quinn_proto::{ConnectionId, ConnectionIdGenerator};
use rand::RngExt;
use rand_pcg::Pcg64;

/// Bytes of an id: as many as quinn's own generator makes by default.
const ID_BYTES: usize = 8;

/// Makes ids one after the other.
pub(super) struct SeededIds {
    chance: Pcg64,
}

impl SeededIds {
    pub fn new(seed: u64, purpose: u64) -> SeededIds {
        SeededIds { chance: crate::chance(seed, purpose) }
    }
}

impl ConnectionIdGenerator for SeededIds {
    fn generate_cid(&mut self) -> ConnectionId {
        ConnectionId::new(&self.chance.random::<[u8; ID_BYTES]>())
    }

    fn cid_len(&self) -> usize {
        ID_BYTES
    }

    fn cid_lifetime(&self) -> Option<Duration> {
        None
    }
}

/// What a client calls a server that has not named itself yet: the longest that there is, as quinn does.
pub(super) fn first_id(seed: u64, purpose: u64) -> ConnectionId {
    ConnectionId::new(&crate::chance(seed, 2 * purpose + (1 << 50)).random::<[u8; 20]>())
}
