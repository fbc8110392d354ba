//! One direction of a link: rules, and the chance that applies them.

use std::time::Duration;

use eyeline_protocol::WorldTime;
use rand::RngExt;
use rand_pcg::Pcg64;

use super::capacity::{Blocked, Capacity, Line};

/// Which way something goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Direction {
    /// From a client to the server.
    Up,
    /// From the server to a client.
    Down,
}

/// How something goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Kind {
    /// An unreliable datagram.
    Datagram,
    /// One message of the control stream, length prefix apart.
    Control,
}

/// What becomes of a datagram.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fate {
    /// It arrives after this time.
    Deliver(Duration),
    /// It never does.
    Drop,
}

/// What one direction of a link does to datagrams. The default is a perfect link without delay.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LinkRules {
    /// Least time under way.
    pub delay: Duration,
    /// Up to so much more, evenly spread; by itself this reorders datagrams that are sent closer together.
    pub jitter: Duration,
    /// Share of datagrams that are lost, 0 to 1.
    pub loss: f64,
    /// Share of datagrams that arrive twice.
    pub duplicate: f64,
    /// Share of datagrams that are held up on the way and overtaken: by as long again as [`LinkRules::unhindered_max`],
    /// evenly spread.
    pub reorder: f64,
}

impl LinkRules {
    /// A link that does nothing but take `delay`.
    pub fn with_delay(self, delay: Duration) -> LinkRules {
        LinkRules { delay, ..self }
    }

    /// Sets the greatest additional delay.
    pub fn with_jitter(self, jitter: Duration) -> LinkRules {
        LinkRules { jitter, ..self }
    }

    /// Sets the share of datagrams lost.
    pub fn with_loss(self, loss: f64) -> LinkRules {
        LinkRules { loss, ..self }
    }

    /// Sets the share of datagrams that arrive twice.
    pub fn with_duplicate(self, duplicate: f64) -> LinkRules {
        LinkRules { duplicate, ..self }
    }

    /// Sets the share of datagrams that are held up.
    pub fn with_reorder(self, reorder: f64) -> LinkRules {
        LinkRules { reorder, ..self }
    }

    /// Longest time under way of a datagram that is not held up.
    pub fn unhindered_max(&self) -> Duration {
        self.delay + self.jitter
    }

    /// Longest time under way of any datagram.
    pub fn one_way_max(&self) -> Duration {
        if self.reorder > 0.0 { 2 * self.unhindered_max() } else { self.unhindered_max() }
    }
}

/// What became of datagrams, those apart that simply arrived once.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LinkStats {
    /// Lost by chance.
    pub lost: u64,
    /// Lost because the queue was full.
    pub overflowed: u64,
    /// Lost in a blackout.
    pub dark: u64,
    /// That chance doubled.
    pub twice: u64,
}

impl std::ops::AddAssign for LinkStats {
    fn add_assign(&mut self, other: LinkStats) {
        self.lost += other.lost;
        self.overflowed += other.overflowed;
        self.dark += other.dark;
        self.twice += other.twice;
    }
}

/// One direction of one client's link.
pub struct VirtualLink {
    rules: LinkRules,
    chance: Pcg64,
    line: Line,
    stats: LinkStats,
    /// When the newest control message arrives: none overtakes it.
    control_at: WorldTime,
}

/// Bytes of the control stream that one packet carries.
const PACKET_BYTES: usize = 1100;

/// What a lost packet costs a stream beyond a round trip: QUIC's timer granularity and longest acknowledgement delay
/// (RFC 9002 §6.2.1, 25 ms and some).
const RETRANSMISSION_EXTRA: Duration = Duration::from_millis(30);

impl VirtualLink {
    /// A link with these rules, which `chance` applies.
    pub fn new(rules: LinkRules, chance: Pcg64) -> VirtualLink {
        VirtualLink { rules, chance, line: Line::default(), stats: LinkStats::default(), control_at: WorldTime::MIN }
    }

    /// Limits what it carries; blackouts count from `begin`.
    pub fn with_capacity(self, capacity: Capacity, begin: WorldTime) -> VirtualLink {
        VirtualLink { line: Line::new(capacity, begin), ..self }
    }

    /// The rules.
    pub fn rules(&self) -> LinkRules {
        self.rules
    }

    /// What became of datagrams so far.
    pub fn stats(&self) -> &LinkStats {
        &self.stats
    }

    /// Changes the rules for what is sent from now on.
    pub fn set_rules(&mut self, rules: LinkRules) {
        self.rules = rules;
    }

    /// Decides on a datagram of `bytes` bytes that is sent at `now`, and on its second copy if there is one.
    pub fn datagram(&mut self, bytes: usize, now: WorldTime) -> (Fate, Option<Fate>) {
        // Drawn even if the line is blocked, so that a blackout leaves the decisions after it as they were.
        let first = self.fate();
        let is_twice = self.is(self.rules.duplicate);
        let second = is_twice.then(|| self.fate());
        let wait = match self.line.take(bytes, now) {
            Ok(wait) => wait,
            Err(Blocked::Dark) => {
                self.stats.dark += 1;
                return (Fate::Drop, None);
            }
            Err(Blocked::Full) => {
                self.stats.overflowed += 1;
                return (Fate::Drop, None);
            }
        };
        self.stats.lost += u64::from(first == Fate::Drop);
        self.stats.twice += u64::from(is_twice);
        let later = |fate| match fate {
            Fate::Deliver(delay) => Fate::Deliver(wait + delay),
            Fate::Drop => Fate::Drop,
        };
        (later(first), second.map(later))
    }

    fn fate(&mut self) -> Fate {
        // Drawn even where it does not matter, so that a change of one rule leaves the other decisions as they were.
        let is_lost = self.is(self.rules.loss);
        let delay = self.delay();
        let is_held_up = self.is(self.rules.reorder);
        let hold: f64 = self.chance.random();
        if is_lost {
            return Fate::Drop;
        }
        Fate::Deliver(if is_held_up { delay + self.rules.unhindered_max().mul_f64(hold) } else { delay })
    }

    /// When a control message of `bytes` bytes that is sent at `now` arrives, and how many of its packets get lost on the
    /// way. Never before an earlier one.
    pub fn control(&mut self, bytes: usize, now: WorldTime) -> (WorldTime, u32) {
        let mut lost = 0;
        let retransmission = 2 * self.rules.unhindered_max() + RETRANSMISSION_EXTRA;
        for packet in 0..bytes.div_ceil(PACKET_BYTES).max(1) {
            let mut sent = now;
            while let Some(end) = self.line.dark_until(sent) {
                sent = end + retransmission;
                lost += 1;
            }
            let size = (bytes - packet * PACKET_BYTES).min(PACKET_BYTES);
            let mut arrives = sent + self.line.wait(size, sent) + self.delay();
            while self.is(self.rules.loss.min(LOSS_MAX)) {
                arrives = arrives + retransmission;
                lost += 1;
            }
            self.control_at = self.control_at.max(arrives);
        }
        (self.control_at, lost)
    }

    fn delay(&mut self) -> Duration {
        let share: f64 = self.chance.random();
        self.rules.delay + self.rules.jitter.mul_f64(share)
    }

    fn is(&mut self, share: f64) -> bool {
        let draw: f64 = self.chance.random();
        draw < share
    }
}

/// A stream over a link that loses more than this would hardly ever end.
const LOSS_MAX: f64 = 0.9;

#[cfg(test)]
mod tests {
    use super::*;

    fn link(rules: LinkRules) -> VirtualLink {
        VirtualLink::new(rules, crate::chance(3, 1))
    }

    #[test]
    fn shares_are_kept() {
        let rules = LinkRules::default().with_loss(0.2).with_duplicate(0.1).with_delay(Duration::from_millis(5));
        let mut link = link(rules);
        let (mut lost, mut twice) = (0, 0);
        for _ in 0..10_000 {
            let (first, second) = link.datagram(100, WorldTime::ZERO);
            lost += i32::from(first == Fate::Drop);
            twice += i32::from(second.is_some());
        }
        assert!((1_800..2_200).contains(&lost), "{lost}");
        assert!((850..1_150).contains(&twice), "{twice}");
    }

    #[test]
    fn delays_stay_within_the_stated_greatest() {
        let rules =
            LinkRules { delay: Duration::from_millis(10), jitter: Duration::from_millis(4), ..Default::default() };
        for rules in [rules, rules.with_reorder(0.5)] {
            let mut link = link(rules);
            let mut longest = Duration::ZERO;
            for _ in 0..1_000 {
                let (Fate::Deliver(delay), None) = link.datagram(100, WorldTime::ZERO) else {
                    panic!("nothing is lost or doubled here")
                };
                assert!((rules.delay..=rules.one_way_max()).contains(&delay), "{delay:?}");
                longest = longest.max(delay);
            }
            assert!(longest > rules.one_way_max().mul_f64(0.95), "{longest:?}");
        }
    }

    #[test]
    fn the_control_stream_is_in_order_and_loss_only_delays_it() {
        let mut link = link(LinkRules::default().with_loss(0.5).with_jitter(Duration::from_millis(20)));
        let mut newest = WorldTime::MIN;
        let mut delayed = 0;
        for millis in 0..500 {
            let now = WorldTime::from_micros(millis * 1_000);
            let (arrives, lost) = link.control(100, now);
            assert!(lost == 0 || arrives > now + Duration::from_millis(20) * lost);
            assert!(arrives >= newest && arrives >= now);
            delayed += i32::from(arrives > now + Duration::from_millis(20));
            newest = arrives;
        }
        assert!(delayed > 100);
    }
}
