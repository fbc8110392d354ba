//! May this address begin a handshake now? Decided before anything is spent on it.
//!
//! A first packet's address may be made up. For one that is not of this machine we therefore answer with a Retry (RFC 9000
//! §8.1.2): a packet that only who really is there can give back, and that costs us no memory at all. It costs each
//! newcomer one round trip, and a stranger far less of ours than a handshake (0.4 ms, FACTS). Addresses of this machine can't
//! be made up from outside, and are asked only while more handshakes are under way than [`ArrivalLimits::retry_above`].
//!
//! An address that has proved itself is held to limits of its own: handshakes a second, connections, and connections that
//! have not been let in yet. An IPv6 address counts as its /56, which is what one home is given. All handshakes together are
//! paced, since each takes CPU from those who are already here: one that comes too early waits for its turn, one that would
//! wait too long is refused. What is kept is bounded: [`ArrivalLimits::addresses`] entries, and only of those who are here
//! or were of late.

use std::collections::HashMap;
use std::net::{IpAddr, Ipv6Addr};
use std::time::Duration;

use eyeline_protocol::WorldTime;

/// Who may begin to connect.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct ArrivalLimits {
    /// With more handshakes than this under way, addresses of this machine have to prove themselves too; default 64. All
    /// others always have to.
    pub retry_above: usize,
    /// Most connections; default 4,352: as many as avatars, and some who look. Each takes about 40 KB.
    pub connections: usize,
    /// Most connections of one address; default 128: a building behind one address.
    pub connections_per_address: usize,
    /// Most connections that have not been let in; default 1,024.
    pub half_open: usize,
    /// Most connections of one address that have not been let in; default 32.
    pub half_open_per_address: usize,
    /// Handshakes a second; default 400: about a sixth of a core. One that comes too early waits.
    pub handshakes_per_second: f64,
    /// Handshakes at once; default 32: a quarter of a tick of 50 ms.
    pub handshakes_burst: f64,
    /// Handshakes a second of one address; default 4.
    pub handshakes_per_address_per_second: f64,
    /// Handshakes at once of one address; default 64.
    pub handshakes_per_address_burst: f64,
    /// Most addresses that are remembered; default 4,096.
    pub addresses: usize,
    /// Whether an address of this machine is limited as any other; default no, since who can use it can do worse, and a swarm
    /// has but one. What holds for all together holds for it too.
    pub limits_this_machine: bool,
    /// For how long a connection may stay without being let in; default 5 s.
    pub greeting: Duration,
}

impl Default for ArrivalLimits {
    fn default() -> ArrivalLimits {
        ArrivalLimits {
            retry_above: 64,
            connections: 4_352,
            connections_per_address: 128,
            half_open: 1_024,
            half_open_per_address: 32,
            handshakes_per_second: 400.0,
            handshakes_burst: 32.0,
            handshakes_per_address_per_second: 4.0,
            handshakes_per_address_burst: 64.0,
            addresses: 4_096,
            limits_this_machine: false,
            greeting: Duration::from_secs(5),
        }
    }
}

impl ArrivalLimits {
    /// Sets with how many handshakes under way addresses of this machine have to prove themselves too.
    pub fn with_retry_above(self, retry_above: usize) -> ArrivalLimits {
        ArrivalLimits { retry_above, ..self }
    }

    /// Sets the most connections, in all and of one address.
    pub fn with_connections(self, connections: usize, connections_per_address: usize) -> ArrivalLimits {
        ArrivalLimits { connections, connections_per_address, ..self }
    }

    /// Sets the most connections that have not been let in, in all and of one address.
    pub fn with_half_open(self, half_open: usize, half_open_per_address: usize) -> ArrivalLimits {
        ArrivalLimits { half_open, half_open_per_address, ..self }
    }

    /// Sets the handshakes of one address, a second and at once.
    pub fn with_handshakes_per_address(self, per_second: f64, burst: f64) -> ArrivalLimits {
        let (handshakes_per_address_per_second, handshakes_per_address_burst) = (per_second, burst);
        ArrivalLimits { handshakes_per_address_per_second, handshakes_per_address_burst, ..self }
    }

    /// Sets all handshakes, a second and at once.
    pub fn with_handshakes(self, per_second: f64, burst: f64) -> ArrivalLimits {
        ArrivalLimits { handshakes_per_second: per_second, handshakes_burst: burst, ..self }
    }

    /// Sets whether an address of this machine is limited as any other.
    pub fn with_limits_this_machine(self, limits_this_machine: bool) -> ArrivalLimits {
        ArrivalLimits { limits_this_machine, ..self }
    }

    /// Sets for how long a connection may stay without being let in.
    pub fn with_greeting(self, greeting: Duration) -> ArrivalLimits {
        ArrivalLimits { greeting, ..self }
    }
}

/// Why an address may not connect now.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Declined {
    /// There are as many connections as there may be.
    Connections,
    /// As many of this address.
    AddressConnections,
    /// Too many have not been let in yet.
    HalfOpen,
    /// Too many of this address.
    AddressHalfOpen,
    /// It would wait too long for its turn.
    Rate,
    /// This address began too many.
    AddressRate,
    /// No more addresses can be remembered.
    Addresses,
}

impl Declined {
    /// All of them.
    pub const ALL: [Declined; 7] = [
        Declined::Connections,
        Declined::AddressConnections,
        Declined::HalfOpen,
        Declined::AddressHalfOpen,
        Declined::Rate,
        Declined::AddressRate,
        Declined::Addresses,
    ];

    /// Its name in metrics and logs.
    pub fn name(self) -> &'static str {
        match self {
            Declined::Connections => "connections",
            Declined::AddressConnections => "connections_per_address",
            Declined::HalfOpen => "half_open",
            Declined::AddressHalfOpen => "half_open_per_address",
            Declined::Rate => "handshakes",
            Declined::AddressRate => "handshakes_per_address",
            Declined::Addresses => "addresses",
        }
    }
}

/// What became of first packets.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ArrivalCounts {
    /// Handshakes begun.
    pub begun: u64,
    /// Those that had to prove their address first.
    pub retried: u64,
    /// Handshakes that came to nothing.
    pub failed: u64,
    /// Connections that did not get in in time.
    pub never_in: u64,
    /// Those that were declined; by [`Declined`].
    declined: [u64; Declined::ALL.len()],
}

impl ArrivalCounts {
    /// Those that were declined for this.
    pub fn declined(&self, why: Declined) -> u64 {
        self.declined[why as usize]
    }

    /// All that were declined.
    pub fn declined_in_all(&self) -> u64 {
        self.declined.iter().sum()
    }
}

/// What to do with a first packet.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Verdict {
    /// Begin the handshake, after so long.
    Begin(Duration),
    /// Let it prove its address.
    Retry,
    /// Not now.
    Decline(Declined),
}

/// Nobody waits longer for its turn: a client gives up after 5 s.
const WAIT_MAX: Duration = Duration::from_secs(3);

/// For how long who was sent away for asking too much may not come back.
const PENALTY_S: f64 = 10.0;

/// Time between two looks for addresses to forget, so that a full table costs little.
const SWEEP_EVERY: Duration = Duration::from_millis(200);

/// What one address has.
#[derive(Clone, Copy, Debug, Default)]
struct Address {
    connections: usize,
    half_open: usize,
    /// Handshakes that were begun and do not count as past yet.
    begun: f64,
    at: WorldTime,
}

impl Address {
    fn settle(&mut self, per_second: f64, now: WorldTime) {
        self.begun = (self.begun - per_second * now.seconds_since(self.at).max(0.0)).max(0.0);
        self.at = self.at.max(now);
    }
}

/// Everybody who is here, begins, or did of late.
#[derive(Debug)]
pub(super) struct Arrivals {
    limits: ArrivalLimits,
    addresses: HashMap<IpAddr, Address>,
    connections: usize,
    half_open: usize,
    /// When the handshakes that were begun would be past at the rate of all.
    turn: WorldTime,
    swept_at: WorldTime,
    pub counts: ArrivalCounts,
}

impl Arrivals {
    pub fn new(limits: ArrivalLimits, now: WorldTime) -> Arrivals {
        Arrivals {
            limits,
            addresses: HashMap::new(),
            connections: 0,
            half_open: 0,
            turn: WorldTime::MIN,
            swept_at: now,
            counts: ArrivalCounts::default(),
        }
    }

    pub fn limits(&self) -> &ArrivalLimits {
        &self.limits
    }

    /// Connections that have not been let in, and all.
    pub fn open(&self) -> (usize, usize) {
        (self.half_open, self.connections)
    }

    /// Addresses that are remembered.
    pub fn remembered(&self) -> usize {
        self.addresses.len()
    }

    /// A first packet. If it may begin, it counts as a connection until [`Arrivals::leave`].
    pub fn arrive(&mut self, address: IpAddr, is_proven: bool, now: WorldTime) -> Verdict {
        let verdict = self.decide(address, is_proven, now);
        match verdict {
            Verdict::Begin(_) => self.counts.begun += 1,
            Verdict::Retry => self.counts.retried += 1,
            Verdict::Decline(why) => self.counts.declined[why as usize] += 1,
        }
        verdict
    }

    fn decide(&mut self, address: IpAddr, is_proven: bool, now: WorldTime) -> Verdict {
        let limits = self.limits;
        let is_ours = address.to_canonical().is_loopback();
        if !is_proven && (!is_ours || self.half_open >= limits.retry_above) {
            return Verdict::Retry;
        }
        if self.connections >= limits.connections {
            return Verdict::Decline(Declined::Connections);
        }
        if self.half_open >= limits.half_open {
            return Verdict::Decline(Declined::HalfOpen);
        }
        let per_second = limits.handshakes_per_second.max(f64::MIN_POSITIVE);
        let burst = Duration::try_from_secs_f64(limits.handshakes_burst / per_second).unwrap_or(Duration::MAX);
        let turn = self.turn.max(now - burst);
        let after = turn.since(now);
        if after > WAIT_MAX {
            return Verdict::Decline(Declined::Rate);
        }
        if !is_ours || limits.limits_this_machine {
            let key = home(address);
            if !self.addresses.contains_key(&key) && !self.has_room(now) {
                return Verdict::Decline(Declined::Addresses);
            }
            let entry = self.addresses.entry(key).or_default();
            entry.settle(limits.handshakes_per_address_per_second, now);
            if entry.connections >= limits.connections_per_address {
                return Verdict::Decline(Declined::AddressConnections);
            }
            if entry.half_open >= limits.half_open_per_address {
                return Verdict::Decline(Declined::AddressHalfOpen);
            }
            if entry.begun + 1.0 > limits.handshakes_per_address_burst {
                return Verdict::Decline(Declined::AddressRate);
            }
            entry.begun += 1.0;
            entry.connections += 1;
            entry.half_open += 1;
        }
        self.turn = turn + Duration::try_from_secs_f64(1.0 / per_second).unwrap_or(Duration::MAX);
        self.connections += 1;
        self.half_open += 1;
        Verdict::Begin(after)
    }

    /// Whether one more address can be remembered; forgets those that have nothing to be remembered for.
    fn has_room(&mut self, now: WorldTime) -> bool {
        if self.addresses.len() < self.limits.addresses {
            return true;
        }
        if now.since(self.swept_at) >= SWEEP_EVERY {
            self.swept_at = now;
            let per_second = self.limits.handshakes_per_address_per_second;
            self.addresses.retain(|_, entry| {
                entry.settle(per_second, now);
                entry.connections > 0 || entry.begun > 0.0
            });
        }
        self.addresses.len() < self.limits.addresses
    }

    /// A connection of this address was let in.
    pub fn let_in(&mut self, address: IpAddr) {
        self.half_open = self.half_open.saturating_sub(1);
        if let Some(entry) = self.addresses.get_mut(&home(address)) {
            entry.half_open = entry.half_open.saturating_sub(1);
        }
    }

    /// A connection of this address has ended.
    pub fn leave(&mut self, address: IpAddr, was_let_in: bool) {
        if !was_let_in {
            self.let_in(address);
        }
        self.connections = self.connections.saturating_sub(1);
        if let Some(entry) = self.addresses.get_mut(&home(address)) {
            entry.connections = entry.connections.saturating_sub(1);
        }
    }

    /// This address was sent away for asking too much: it may not come back for a while.
    pub fn penalise(&mut self, address: IpAddr, now: WorldTime) {
        let limits = &self.limits;
        if let Some(entry) = self.addresses.get_mut(&home(address)) {
            entry.settle(limits.handshakes_per_address_per_second, now);
            entry.begun =
                limits.handshakes_per_address_burst + PENALTY_S * limits.handshakes_per_address_per_second - 1.0;
        }
    }
}

/// Whose address it is: of IPv6, the /56 that a home is given.
fn home(address: IpAddr) -> IpAddr {
    match address.to_canonical() {
        IpAddr::V6(address) => IpAddr::V6(Ipv6Addr::from_bits(address.to_bits() & (u128::MAX << 72))),
        v4 => v4,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const NOW: WorldTime = WorldTime::ZERO;

    fn at(millis: u64) -> WorldTime {
        NOW + Duration::from_millis(millis)
    }

    fn arrivals(limits: ArrivalLimits) -> Arrivals {
        Arrivals::new(limits, NOW)
    }

    fn stranger(n: u32) -> IpAddr {
        IpAddr::from((0x0a00_0000 + n).to_be_bytes())
    }

    fn begins(verdict: Verdict) -> bool {
        matches!(verdict, Verdict::Begin(_))
    }

    #[test]
    fn an_address_that_has_not_proved_itself_costs_no_memory() {
        let mut arrivals = arrivals(ArrivalLimits::default());
        for n in 0..100_000 {
            assert_eq!(arrivals.arrive(stranger(n), false, at(0)), Verdict::Retry);
        }
        assert_eq!((arrivals.remembered(), arrivals.open()), (0, (0, 0)));
        assert_eq!(arrivals.counts.retried, 100_000);
    }

    #[test]
    fn this_machine_has_to_prove_itself_only_in_a_crowd() {
        let mut arrivals = arrivals(ArrivalLimits::default().with_retry_above(3));
        let ours = IpAddr::from([127, 0, 0, 9]);
        assert!((0..3).all(|_| begins(arrivals.arrive(ours, false, at(0)))));
        assert_eq!(arrivals.arrive(ours, false, at(0)), Verdict::Retry);
        assert!(begins(arrivals.arrive(ours, true, at(0))));
        arrivals.let_in(ours);
        arrivals.let_in(ours);
        assert!(begins(arrivals.arrive(ours, false, at(0))));
        assert_eq!(arrivals.arrive("::ffff:127.0.0.1".parse().unwrap(), false, at(0)), Verdict::Retry);
    }

    #[test]
    fn one_address_is_held_to_its_limits_and_others_are_not() {
        let limits = ArrivalLimits::default().with_connections(100, 5).with_half_open(100, 3);
        let mut arrivals = arrivals(limits);
        let one = stranger(1);
        assert!((0..3).all(|_| begins(arrivals.arrive(one, true, at(0)))));
        assert_eq!(arrivals.arrive(one, true, at(0)), Verdict::Decline(Declined::AddressHalfOpen));
        arrivals.let_in(one);
        arrivals.let_in(one);
        assert!((0..2).all(|_| begins(arrivals.arrive(one, true, at(0)))));
        assert_eq!(arrivals.arrive(one, true, at(0)), Verdict::Decline(Declined::AddressConnections));
        assert!(begins(arrivals.arrive(stranger(2), true, at(0))));
        arrivals.leave(one, true);
        assert_eq!(arrivals.open(), (4, 5));
        assert!(!begins(arrivals.arrive(one, true, at(0))), "three are still half open");
        arrivals.leave(one, false);
        assert!(begins(arrivals.arrive(one, true, at(0))));
    }

    #[test]
    fn handshakes_of_an_address_have_a_rate() {
        let limits = ArrivalLimits::default().with_handshakes_per_address(2.0, 4.0).with_handshakes(1e6, 1e6);
        let mut arrivals = arrivals(limits);
        let mut try_ten = |now| {
            (0..10)
                .filter(|_| {
                    let begun = begins(arrivals.arrive(stranger(1), true, now));
                    if begun {
                        arrivals.leave(stranger(1), false);
                    }
                    begun
                })
                .count()
        };
        assert_eq!((try_ten(at(0)), try_ten(at(0)), try_ten(at(1_000)), try_ten(at(60_000))), (4, 0, 2, 4));
        arrivals.penalise(stranger(1), at(60_000));
        assert!(!begins(arrivals.arrive(stranger(1), true, at(69_000))));
        assert!(begins(arrivals.arrive(stranger(1), true, at(70_001))));
    }

    #[test]
    fn all_together_take_turns_and_nobody_waits_in_vain() {
        let limits = ArrivalLimits::default().with_handshakes(100.0, 10.0);
        let mut arrivals = arrivals(limits);
        let mut turns = Vec::new();
        for n in 0..1_000 {
            match arrivals.arrive(stranger(n), true, at(0)) {
                Verdict::Begin(after) => turns.push(after.as_millis()),
                verdict => assert_eq!(verdict, Verdict::Decline(Declined::Rate)),
            }
        }
        assert_eq!(turns.iter().filter(|&&after| after == 0).count(), 11, "ten in advance, and one now");
        assert_eq!((turns.len(), turns[20], turns.last()), (311, 100, Some(&3_000)));
        assert_eq!(arrivals.counts.declined(Declined::Rate), 1_000 - 311);
        assert!(begins(arrivals.arrive(stranger(5_000), true, at(1_000))));
    }

    #[test]
    fn what_is_remembered_is_bounded_and_forgotten() {
        let limits = ArrivalLimits { addresses: 50, handshakes_per_second: 1e6, ..ArrivalLimits::default() };
        let mut arrivals = arrivals(limits);
        for n in 0..50 {
            assert!(begins(arrivals.arrive(stranger(n), true, at(0))));
            if n > 0 {
                arrivals.leave(stranger(n), false);
            }
        }
        assert_eq!(arrivals.arrive(stranger(50), true, at(10)), Verdict::Decline(Declined::Addresses));
        assert_eq!(arrivals.remembered(), 50);
        // A second later their handshakes are past; who is still here is still known.
        assert!(begins(arrivals.arrive(stranger(50), true, at(1_000))));
        assert_eq!(arrivals.remembered(), 2);
    }

    #[test]
    fn a_home_of_ipv6_is_one_address() {
        let limits = ArrivalLimits::default().with_half_open(100, 1);
        let mut arrivals = arrivals(limits);
        assert!(begins(arrivals.arrive("2001:db8:1:2::1".parse().unwrap(), true, at(0))));
        assert!(!begins(arrivals.arrive("2001:db8:1:ff:9::9".parse().unwrap(), true, at(0))));
        assert!(begins(arrivals.arrive("2001:db8:1:102::1".parse().unwrap(), true, at(0))));
    }
}
