//! What happens next: events in order of time, and of their making where times are equal.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use eyeline_protocol::WorldTime;

struct Entry<T> {
    at: WorldTime,
    number: u64,
    event: T,
}

/// Events, earliest first; those of one instant in the order in which they were pushed.
pub(crate) struct Queue<T> {
    entries: BinaryHeap<Reverse<Entry<T>>>,
    pushed: u64,
}

impl<T> Queue<T> {
    pub fn new() -> Queue<T> {
        Queue { entries: BinaryHeap::new(), pushed: 0 }
    }

    pub fn push(&mut self, at: WorldTime, event: T) {
        self.entries.push(Reverse(Entry { at, number: self.pushed, event }));
        self.pushed += 1;
    }

    /// When the earliest event is due.
    pub fn next_at(&self) -> Option<WorldTime> {
        self.entries.peek().map(|Reverse(entry)| entry.at)
    }

    /// The earliest event, if it is due by `end`.
    pub fn pop_by(&mut self, end: WorldTime) -> Option<(WorldTime, T)> {
        if self.entries.peek()?.0.at > end {
            return None;
        }
        self.entries.pop().map(|Reverse(entry)| (entry.at, entry.event))
    }
}

impl<T> PartialEq for Entry<T> {
    fn eq(&self, other: &Entry<T>) -> bool {
        (self.at, self.number) == (other.at, other.number)
    }
}

impl<T> Eq for Entry<T> {}

impl<T> PartialOrd for Entry<T> {
    fn partial_cmp(&self, other: &Entry<T>) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl<T> Ord for Entry<T> {
    fn cmp(&self, other: &Entry<T>) -> std::cmp::Ordering {
        (self.at, self.number).cmp(&(other.at, other.number))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ties_keep_their_order() {
        let mut queue = Queue::new();
        let at = WorldTime::from_micros;
        for (micros, name) in [(5, 'c'), (1, 'a'), (5, 'd'), (2, 'b')] {
            queue.push(at(micros), name);
        }
        assert_eq!(queue.pop_by(at(0)), None);
        let order: String = std::iter::from_fn(|| queue.pop_by(at(9)).map(|(_, name)| name)).collect();
        assert_eq!(order, "abcd");
    }
}
