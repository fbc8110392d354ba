//! What was counted: messages by kind, datagrams, refusals.

use eyeline_protocol::{ClientRecord, Reason, ServerRecord, Want};

use super::LimitCounts;

/// Messages by kind. A message is one record about one object.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MessageCounts {
    /// A client's own poses.
    pub poses: u64,
    /// States of objects that are shown: pushes and answers to who wants updates.
    pub states: u64,
    /// States told once, to find out whether an object is in sight.
    pub places: u64,
    /// Requests because no bound was held.
    pub requests_unknown: u64,
    /// Requests because a bound became visible.
    pub requests_exposed: u64,
    /// Requests because a bound's time was up.
    pub requests_expired: u64,
    /// Requests because an object broke its bound.
    pub requests_violated: u64,
    /// Of all requests, those that wanted a state.
    pub requests_for_state: u64,
    /// Bounds sent.
    pub bounds: u64,
    /// Objects that a client no longer sees.
    pub releases: u64,
    /// Violations announced.
    pub violations: u64,
    /// Violations acknowledged.
    pub violation_acks: u64,
    /// Objects that the server no longer tells of.
    pub hidden: u64,
    /// Objects that came or went.
    pub roster: u64,
}

impl MessageCounts {
    /// Counts a client's record.
    pub fn count_client(&mut self, record: &ClientRecord) {
        match record {
            ClientRecord::Pose { .. } => self.poses += 1,
            ClientRecord::Request { want, reason, .. } => {
                match reason {
                    Reason::Unknown => self.requests_unknown += 1,
                    Reason::Exposed => self.requests_exposed += 1,
                    Reason::Expired => self.requests_expired += 1,
                    Reason::Violated => self.requests_violated += 1,
                }
                self.requests_for_state += u64::from(*want == Want::State);
            }
            ClientRecord::Release { .. } => self.releases += 1,
            ClientRecord::ViolationAck { .. } => self.violation_acks += 1,
            // Where one's own eye is is a pose, as what it costs goes.
            ClientRecord::Eye { .. } => self.poses += 1,
        }
    }

    /// Counts a server's record.
    pub fn count_server(&mut self, record: &ServerRecord) {
        match record {
            ServerRecord::State { .. } => self.states += 1,
            ServerRecord::Bound { .. } => self.bounds += 1,
            ServerRecord::Violation { .. } => self.violations += 1,
            ServerRecord::Hidden { .. } => self.hidden += 1,
        }
    }

    /// All requests.
    pub fn requests(&self) -> u64 {
        self.requests_unknown + self.requests_exposed + self.requests_expired + self.requests_violated
    }

    /// Messages about objects that are shown: their states.
    pub fn pushed(&self) -> u64 {
        self.states
    }

    /// Messages that exist because objects are hidden: asking, looking, bounding, letting go, violations, objects withdrawn.
    pub fn hidden_caused(&self) -> u64 {
        self.requests()
            + self.places
            + self.bounds
            + self.releases
            + self.violations
            + self.violation_acks
            + self.hidden
    }

    /// Every message.
    pub fn total(&self) -> u64 {
        self.poses + self.pushed() + self.hidden_caused() + self.roster
    }

    /// This minus `earlier`, counter by counter.
    pub fn since(&self, earlier: &MessageCounts) -> MessageCounts {
        self.zip(earlier, u64::wrapping_sub)
    }

    /// This plus `other`, counter by counter.
    pub fn plus(&self, other: &MessageCounts) -> MessageCounts {
        self.zip(other, u64::wrapping_add)
    }

    fn zip(&self, other: &MessageCounts, f: impl Fn(u64, u64) -> u64) -> MessageCounts {
        MessageCounts {
            poses: f(self.poses, other.poses),
            states: f(self.states, other.states),
            places: f(self.places, other.places),
            requests_unknown: f(self.requests_unknown, other.requests_unknown),
            requests_exposed: f(self.requests_exposed, other.requests_exposed),
            requests_expired: f(self.requests_expired, other.requests_expired),
            requests_violated: f(self.requests_violated, other.requests_violated),
            requests_for_state: f(self.requests_for_state, other.requests_for_state),
            bounds: f(self.bounds, other.bounds),
            releases: f(self.releases, other.releases),
            violations: f(self.violations, other.violations),
            violation_acks: f(self.violation_acks, other.violation_acks),
            hidden: f(self.hidden, other.hidden),
            roster: f(self.roster, other.roster),
        }
    }
}

/// Counters of a world since its start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct WorldStats {
    /// Messages received.
    pub messages_in: MessageCounts,
    /// Messages sent.
    pub out: MessageCounts,
    /// Datagrams received.
    pub datagrams_in: u64,
    /// Their bytes.
    pub datagram_bytes_in: u64,
    /// Datagrams sent.
    pub datagrams_out: u64,
    /// Their payload, bytes, QUIC and UDP apart.
    pub datagram_bytes_out: u64,
    /// Control messages sent.
    pub control_out: u64,
    /// Clients admitted.
    pub admitted: u64,
    /// Clients sent away since the gate would let them in no longer.
    pub dismissed: u64,
    /// Clients refused.
    pub refused: u64,
    /// Clients that came back.
    pub resumed: u64,
    /// Payloads of the application passed on to clients.
    pub payloads: u64,
    /// Control messages that made no sense; each closed its connection.
    pub rejected_control: u64,
    /// Datagrams that made no sense, or came before hello.
    pub rejected_datagrams: u64,
    /// Duplicates, and datagrams too old to tell.
    pub stale_datagrams: u64,
    /// Records about objects that are not there, or not the client's.
    pub forbidden: u64,
    /// Poses beyond their motion bound, held back to it.
    pub poses_clamped: u64,
    /// Places that a client asked for, or was due, without being entitled to them; a bound was the answer.
    pub withheld: u64,
    /// Avatars that turned faster than they may, held back to it.
    pub turns_clamped: u64,
    /// States that a byte cap held back until the next tick.
    pub capped: u64,
    /// States that a byte cap held back for longer than one tick, counted at each tick more.
    pub capped_late: u64,
    /// Bounds broken: teleports, entering, leaving.
    pub violations: u64,
    /// Ticks done.
    pub ticks: u64,
    /// Ticks skipped because the driver came late.
    pub ticks_missed: u64,
    /// Datagrams given up for lost.
    pub datagrams_lost: u64,
    /// Times that nothing was built for a client, since older datagrams had not left yet.
    pub held_back: u64,
    /// What clients asked for beyond their limits, and was dropped.
    pub limited: LimitCounts,
    /// Clients sent away because they went on and on beyond their limits.
    pub busy: u64,
}
