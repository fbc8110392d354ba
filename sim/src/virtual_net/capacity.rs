//! How much does one direction of a link carry, and when does it carry nothing?
//!
//! A link with a rate sends one datagram after the other; what comes faster waits in a queue, and what finds the queue
//! full is lost, as at the slowest hop of a real path (its "tail drop"). During a blackout everything that is sent is lost.

use std::num::NonZeroU64;
use std::time::Duration;

use eyeline_protocol::WorldTime;

/// A time in which nothing gets through.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Blackout {
    /// When it begins, from the link's own beginning.
    pub from: Duration,
    /// How long it lasts.
    pub length: Duration,
}

/// How much one direction of a link carries. The default carries everything, always.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct Capacity {
    /// Bits a second of payload; `None` is without limit.
    pub rate: Option<NonZeroU64>,
    /// Most bytes that wait for their turn; default 64 KiB. A datagram that finds the link idle never waits.
    pub queue_bytes: usize,
    /// When nothing gets through.
    pub blackouts: Vec<Blackout>,
}

impl Default for Capacity {
    fn default() -> Capacity {
        Capacity { rate: None, queue_bytes: 64 * 1024, blackouts: Vec::new() }
    }
}

impl Capacity {
    /// Sets the rate, bits a second.
    pub fn with_rate(self, rate: NonZeroU64) -> Capacity {
        Capacity { rate: Some(rate), ..self }
    }

    /// Sets the most bytes that wait.
    pub fn with_queue_bytes(self, queue_bytes: usize) -> Capacity {
        Capacity { queue_bytes, ..self }
    }

    /// Adds a blackout.
    pub fn with_blackout(mut self, from: Duration, length: Duration) -> Capacity {
        self.blackouts.push(Blackout { from, length });
        self
    }
}

/// Why a line takes nothing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Blocked {
    /// A blackout lasts.
    Dark,
    /// The queue is full.
    Full,
}

/// A [`Capacity`] at work.
#[derive(Clone, Debug)]
pub(super) struct Line {
    capacity: Capacity,
    begin: WorldTime,
    /// When what was taken so far has left.
    free_at: WorldTime,
}

impl Default for Line {
    fn default() -> Line {
        Line::new(Capacity::default(), WorldTime::ZERO)
    }
}

impl Line {
    pub fn new(capacity: Capacity, begin: WorldTime) -> Line {
        Line { capacity, begin, free_at: WorldTime::MIN }
    }

    /// When the blackout ends that lasts at `at`, if one does.
    pub fn dark_until(&self, at: WorldTime) -> Option<WorldTime> {
        let passed = at.since(self.begin);
        let ends = self.capacity.blackouts.iter().filter_map(|blackout| {
            let end = blackout.from.saturating_add(blackout.length);
            (at >= self.begin && blackout.from <= passed && passed < end).then_some(end)
        });
        ends.max().map(|end| self.begin + end)
    }

    /// Takes a datagram: for how long it waits and is being sent, or why it is lost.
    pub fn take(&mut self, bytes: usize, now: WorldTime) -> Result<Duration, Blocked> {
        if self.dark_until(now).is_some() {
            return Err(Blocked::Dark);
        }
        let rate = self.capacity.rate.map_or(0, NonZeroU64::get);
        let waiting_bytes = self.free_at.since(now).as_micros() * u128::from(rate) / 8_000_000;
        let is_idle = self.free_at <= now;
        if !is_idle && waiting_bytes + bytes as u128 > self.capacity.queue_bytes as u128 {
            return Err(Blocked::Full);
        }
        Ok(self.wait(bytes, now))
    }

    /// Takes so many bytes whatever waits already.
    pub fn wait(&mut self, bytes: usize, now: WorldTime) -> Duration {
        let Some(rate) = self.capacity.rate else { return Duration::ZERO };
        let micros = (bytes as u128 * 8_000_000).div_ceil(u128::from(rate.get()));
        self.free_at = self.free_at.max(now) + Duration::from_micros(u64::try_from(micros).unwrap_or(u64::MAX));
        self.free_at.since(now)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(millis: i64) -> WorldTime {
        WorldTime::from_micros(millis * 1_000)
    }

    fn line(capacity: Capacity) -> Line {
        Line::new(capacity, at(1_000))
    }

    #[test]
    fn a_rate_spreads_a_burst_and_a_full_queue_loses_the_rest() {
        // 1,000 bytes take 10 ms.
        let rate = NonZeroU64::new(800_000).unwrap();
        let mut line = line(Capacity::default().with_rate(rate).with_queue_bytes(2_500));
        let taken: Vec<_> = (0..5).map(|_| line.take(1_000, at(2_000)).map(|wait| wait.as_millis())).collect();
        assert_eq!(taken, [Ok(10), Ok(20), Err(Blocked::Full), Err(Blocked::Full), Err(Blocked::Full)]);
        assert_eq!(line.take(1_000, at(2_020)), Ok(Duration::from_millis(10)), "idle again");
        assert_eq!(line.take(9_000, at(2_040)), Ok(Duration::from_millis(90)), "larger than the queue, but it is idle");
    }

    #[test]
    fn a_blackout_loses_what_is_sent_while_it_lasts() {
        let capacity = Capacity::default()
            .with_blackout(Duration::from_millis(500), Duration::from_millis(100))
            .with_blackout(Duration::from_millis(550), Duration::from_millis(200));
        let mut line = line(capacity);
        for (millis, passes) in [(0, true), (1_499, true), (1_500, false), (1_749, false), (1_750, true)] {
            assert_eq!(line.take(10, at(millis)).is_ok(), passes, "{millis} ms");
        }
        assert_eq!(line.dark_until(at(1_510)), Some(at(1_600)));
        assert_eq!(line.dark_until(at(1_599)), Some(at(1_750)));
    }
}
