//! Sequence numbers, acknowledgements and round-trip times of one peer's datagrams: the same at both ends.
//!
//! Every datagram carries its own sequence number, the greatest one received, and 32 bits for those before it. What a
//! datagram carried is kept as `T` until it is acknowledged or given up for lost.

use std::collections::VecDeque;
use std::time::Duration;

use serde::{Deserialize, Serialize};

use crate::LocalTime;

/// The part of a datagram's header that concerns delivery.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct LinkHeader {
    /// This datagram's number; the first is 1.
    pub seq: u32,
    /// Greatest number received from the peer; 0 if none.
    pub ack: u32,
    /// Bit i: `ack − 1 − i` was received too.
    pub ack_bits: u32,
    /// How long ago `ack` arrived.
    pub hold_micros: u32,
}

/// Smoothed round-trip time as in RFC 6298.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RoundTrip {
    /// SRTT.
    pub smoothed: Duration,
    /// RTTVAR.
    pub variation: Duration,
}

impl RoundTrip {
    /// When to give up waiting: SRTT + 4·RTTVAR, at least 5 ms (timers are no finer under load).
    pub fn timeout(&self) -> Duration {
        (self.smoothed + 4 * self.variation).max(Duration::from_millis(5))
    }
}

/// What an arriving datagram is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Arrival {
    /// Not seen before.
    New,
    /// A duplicate, or so old that it can't be told from one: its records must be ignored.
    Stale,
}

struct Sent<T> {
    seq: u32,
    at: LocalTime,
    carried: T,
}

/// One end's bookkeeping of the datagrams to and from its peer.
pub struct Link<T> {
    next_seq: u32,
    /// Ascending by `seq`. At most [`IN_FLIGHT_MAX`].
    in_flight: VecDeque<Sent<T>>,
    greatest: u32,
    greatest_at: LocalTime,
    received_bits: u32,
    round_trip: Option<RoundTrip>,
    /// Samples of the last 5 s that no later one has reached: descending, so that the first is the greatest.
    samples: VecDeque<(LocalTime, Duration)>,
}

/// More datagrams than this are never awaited; the oldest then counts as lost.
const IN_FLIGHT_MAX: usize = 256;

/// A datagram is lost when this many later ones were acknowledged (QUIC's packet threshold, RFC 9002 §6.1.1).
const REORDER_MAX: u32 = 3;

/// For how long a round trip counts towards the greatest one (DESIGN §3.3).
const SAMPLE_WINDOW: Duration = Duration::from_secs(5);

impl<T> Default for Link<T> {
    fn default() -> Link<T> {
        Link {
            next_seq: 1,
            in_flight: VecDeque::new(),
            greatest: 0,
            greatest_at: LocalTime::ZERO,
            received_bits: 0,
            round_trip: None,
            samples: VecDeque::new(),
        }
    }
}

impl<T> Link<T> {
    /// Header for the next datagram, which the caller sends now; `carried` comes back when its fate is known, and at
    /// once if too many are under way.
    pub fn send(&mut self, carried: T, now: LocalTime) -> (LinkHeader, Option<T>) {
        let seq = self.next_seq;
        self.next_seq = seq.checked_add(1).expect("2^32 datagrams is years of traffic; the session ends before");
        self.in_flight.push_back(Sent { seq, at: now, carried });
        let lost = if self.in_flight.len() > IN_FLIGHT_MAX { self.in_flight.pop_front() } else { None };
        let hold = if self.greatest == 0 { Duration::ZERO } else { now.since(self.greatest_at) };
        let header = LinkHeader {
            seq,
            ack: self.greatest,
            ack_bits: self.received_bits,
            hold_micros: u32::try_from(hold.as_micros()).unwrap_or(u32::MAX),
        };
        (header, lost.map(|sent| sent.carried))
    }

    /// Takes the header of a datagram that arrived; hands what was acknowledged to `acked` and what is lost to
    /// `lost`.
    pub fn receive(
        &mut self,
        header: &LinkHeader,
        now: LocalTime,
        mut acked: impl FnMut(T),
        mut lost: impl FnMut(T),
    ) -> Arrival {
        // Acknowledgements are idempotent, so that even a stale datagram's are good. An acknowledgement of something
        // never sent is a lie and acknowledges nothing.
        if header.ack < self.next_seq {
            // Most datagrams acknowledge the oldest that is under way, so nothing moves.
            let mut index = 0;
            while let Some(sent) = self.in_flight.get(index) {
                let age = i64::from(header.ack) - i64::from(sent.seq);
                if age < 0 {
                    // All that follow are newer still.
                    break;
                }
                let is_acked = age == 0 || (1..=32).contains(&age) && header.ack_bits >> (age - 1) & 1 == 1;
                if !is_acked && age < i64::from(REORDER_MAX) {
                    index += 1;
                    continue;
                }
                let Some(sent) = self.in_flight.remove(index) else { break };
                if is_acked {
                    if age == 0 {
                        let hold = Duration::from_micros(u64::from(header.hold_micros));
                        let sample = now.since(sent.at).saturating_sub(hold);
                        self.round_trip = Some(Self::smoothed(self.round_trip, sample));
                        while self.samples.back().is_some_and(|&(_, earlier)| earlier <= sample) {
                            self.samples.pop_back();
                        }
                        self.samples.push_back((now, sample));
                    }
                    acked(sent.carried);
                } else {
                    lost(sent.carried);
                }
            }
            while self.samples.front().is_some_and(|&(at, _)| now.since(at) > SAMPLE_WINDOW) {
                self.samples.pop_front();
            }
        }
        self.note_arrival(header.seq, now)
    }

    fn smoothed(old: Option<RoundTrip>, sample: Duration) -> RoundTrip {
        match old {
            None => RoundTrip { smoothed: sample, variation: sample / 2 },
            Some(RoundTrip { smoothed, variation }) => RoundTrip {
                smoothed: (smoothed * 7 + sample) / 8,
                variation: (variation * 3 + smoothed.abs_diff(sample)) / 4,
            },
        }
    }

    fn note_arrival(&mut self, seq: u32, now: LocalTime) -> Arrival {
        if seq == 0 {
            return Arrival::Stale;
        }
        if seq > self.greatest {
            let jump = seq - self.greatest;
            // The old greatest becomes bit `jump - 1`.
            let shifted = u64::from(self.received_bits) << jump.min(33);
            let old = if self.greatest == 0 || jump > 32 { 0 } else { 1 << (jump - 1) };
            self.received_bits = if jump > 32 { 0 } else { shifted as u32 } | old;
            self.greatest = seq;
            self.greatest_at = now;
            return Arrival::New;
        }
        let age = self.greatest - seq;
        if age == 0 || age > 32 || self.received_bits >> (age - 1) & 1 == 1 {
            return Arrival::Stale;
        }
        self.received_bits |= 1 << (age - 1);
        Arrival::New
    }

    /// Gives up what has waited longer than the time-out, oldest first. Before the first round trip is known that is
    /// a second (RFC 6298's start).
    pub fn expire(&mut self, now: LocalTime, mut lost: impl FnMut(T)) {
        let timeout = self.timeout();
        while self.in_flight.front().is_some_and(|sent| now.since(sent.at) > timeout) {
            if let Some(sent) = self.in_flight.pop_front() {
                lost(sent.carried);
            }
        }
    }

    /// SRTT + 4·RTTVAR, or a second while unknown.
    pub fn timeout(&self) -> Duration {
        self.round_trip.map_or(Duration::from_secs(1), |round_trip| round_trip.timeout())
    }

    /// Smoothed round-trip time, once there is one.
    pub fn round_trip(&self) -> Option<RoundTrip> {
        self.round_trip
    }

    /// Greatest round trip of the last 5 s.
    pub fn round_trip_max(&self) -> Option<Duration> {
        self.samples.front().map(|&(_, sample)| sample)
    }

    /// When the newest datagram arrived; `None` before the first.
    pub fn heard_at(&self) -> Option<LocalTime> {
        (self.greatest > 0).then_some(self.greatest_at)
    }

    /// Whether a datagram of the peer with this number would be stale, had it not arrived yet: so old that it can't be told from
    /// a duplicate.
    pub fn is_past(&self, seq: u32) -> bool {
        self.greatest.saturating_sub(seq) > 32
    }

    /// Number of the next datagram.
    pub fn next_seq(&self) -> u32 {
        self.next_seq
    }

    /// When the datagram with this number left, if it is still awaited.
    pub fn sent_at(&self, seq: u32) -> Option<LocalTime> {
        self.in_flight.iter().find(|sent| sent.seq == seq).map(|sent| sent.at)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn at(millis: i64) -> LocalTime {
        LocalTime::from_micros(millis * 1000)
    }

    #[test]
    fn a_round_trip_leaves_out_the_hold() {
        let (mut a, mut b) = (Link::default(), Link::<()>::default());
        let (header, _) = a.send('x', at(0));
        b.receive(&header, at(10), |()| (), |()| ());
        let (header, _) = b.send((), at(40));
        let mut acked = Vec::new();
        a.receive(&header, at(50), |x| acked.push(x), |_| ());
        assert_eq!(acked, ['x']);
        assert_eq!(a.round_trip().map(|r| r.smoothed), Some(Duration::from_millis(20)));
    }

    #[test]
    fn the_greatest_round_trip_is_of_the_last_five_seconds() {
        let (mut a, mut b) = (Link::<()>::default(), Link::<()>::default());
        let mut most = Vec::new();
        for (i, millis) in [30, 10, 20, 5, 15].into_iter().enumerate() {
            let sent = 2000 * i as i64;
            let (header, _) = a.send((), at(sent));
            b.receive(&header, at(sent), |()| (), |()| ());
            let (header, _) = b.send((), at(sent));
            a.receive(&header, at(sent + millis), |()| (), |()| ());
            most.push(a.round_trip_max().unwrap().as_millis());
        }
        assert_eq!(most, [30, 30, 30, 20, 20]);
    }

    #[test]
    fn duplicates_and_ancients_are_stale() {
        let mut link = Link::<()>::default();
        let mut arrive = |seq| link.receive(&LinkHeader { seq, ..Default::default() }, at(0), |()| (), |()| ());
        assert_eq!(arrive(40), Arrival::New);
        assert_eq!(arrive(40), Arrival::Stale);
        assert_eq!(arrive(39), Arrival::New);
        assert_eq!(arrive(39), Arrival::Stale);
        assert_eq!(arrive(7), Arrival::Stale);
        assert_eq!(arrive(0), Arrival::Stale);
        assert_eq!(arrive(u32::MAX), Arrival::New);
        assert_eq!(arrive(40), Arrival::Stale);
    }

    proptest! {
        /// Whatever the network does, each datagram's fate is told at most once, and none is acknowledged that did
        /// not arrive.
        #[test]
        fn fates_are_told_once_and_truly(seed in prop::collection::vec((any::<bool>(), any::<bool>()), 1..200)) {
            let (mut a, mut b) = (Link::<usize>::default(), Link::<()>::default());
            let mut arrived = vec![false; seed.len()];
            let mut fate = vec![0; seed.len()];
            for (i, &(forth, back)) in seed.iter().enumerate() {
                let now = at(i as i64 * 10);
                let (header, dropped) = a.send(i, now);
                if let Some(dropped) = dropped { fate[dropped] += 1; }
                if forth {
                    arrived[i] = true;
                    b.receive(&header, now, |()| (), |()| ());
                }
                let (header, _) = b.send((), now);
                if back {
                    let (mut acked, mut lost) = (Vec::new(), Vec::new());
                    a.receive(&header, now, |i| acked.push(i), |i| lost.push(i));
                    for &i in &acked { prop_assert!(arrived[i]); }
                    for i in acked.into_iter().chain(lost) { fate[i] += 1; }
                }
            }
            prop_assert!(fate.iter().all(|&times| times <= 1));
        }
    }
}
