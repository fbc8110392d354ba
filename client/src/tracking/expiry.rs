//! Q: which bounds' time is up?
//!
//! A calendar: buckets by time in an ordered map, and in each bucket a list, in the order in which its keys came. The lists
//! run through one slab, and a map by number finds a key's place there. So an insertion or a cancellation costs one search
//! among the *buckets*, O(log n) at the worst, and an expiry O(1): the bucket is cut off whole and its list walked. Nothing is
//! ever scanned. Sudarsky & Gotsman 1999, §3.3, ask for the same of their skip list.
//!
//! What it costs beside an ordered set of (time, key): an expiry more, since its keys lie all over the slab and the map while the
//! set's lie together. What it gains is a key's time by the key alone, and, with few buckets, cheap insertions and
//! cancellations, of which there is one for every bound (`cargo bench -p eyeline-client --bench expiry`).
//!
//! Expiries are rounded down to a multiple of a quantum, so that many fall together: then there are few buckets, and
//! what expires is dealt with in one go. Rounded *down*, since a bound believed for longer than it holds would be a lie.

use std::collections::BTreeMap;
use std::time::Duration;

use eyeline_protocol::WorldTime;
use eyeline_visibility::IdMap;

/// A queue of expiries: at most one per key. O(log n) to insert and to cancel, in the number of different times; O(1) for each key that expires.
///
/// Every time is legal. What is already due when it comes expires at the next [`ExpiryQueue::expire`]; if `now` jumps
/// back, what expired stays expired and the rest waits.
#[derive(Clone, Debug)]
pub struct ExpiryQueue<K> {
    /// Microseconds, at least 1.
    quantum: i64,
    /// No bucket is empty.
    buckets: BTreeMap<WorldTime, Bucket>,
    /// The entries of all lists, and those that are free.
    slots: Vec<Slot<K>>,
    /// First free slot.
    free: u32,
    /// Where each key's entry is.
    places: IdMap<u32>,
}

/// Ends of a bucket's list.
#[derive(Clone, Copy, Debug)]
struct Bucket {
    first: u32,
    last: u32,
}

#[derive(Clone, Copy, Debug)]
struct Slot<K> {
    key: K,
    due: WorldTime,
    previous: u32,
    /// Of a free slot: the next one that is free.
    next: u32,
}

/// No slot.
const NONE: u32 = u32::MAX;

impl<K: Copy + Into<u32>> ExpiryQueue<K> {
    /// An empty queue whose expiries are rounded down to multiples of `quantum` in world time. Less than a microsecond, or
    /// zero, rounds nothing.
    pub fn new(quantum: Duration) -> ExpiryQueue<K> {
        let quantum = i64::try_from(quantum.as_micros()).unwrap_or(i64::MAX).max(1);
        ExpiryQueue { quantum, buckets: BTreeMap::new(), slots: Vec::new(), free: NONE, places: IdMap::default() }
    }

    /// Lets `key` expire at `expires`, rounded down, and no more at the time that it had before.
    pub fn insert(&mut self, key: K, expires: WorldTime) {
        let due = self.round_down(expires);
        let slot = match self.places.get(key.into()).copied() {
            Some(slot) => {
                if self.slots[slot as usize].due == due {
                    return;
                }
                self.unlink(slot);
                slot
            }
            None => {
                let entry = Slot { key, due, previous: NONE, next: NONE };
                let slot = if self.free == NONE {
                    self.slots.push(entry);
                    u32::try_from(self.slots.len() - 1)
                        .ok()
                        .filter(|&slot| slot != NONE)
                        .expect("under 2³² − 1 entries")
                } else {
                    let slot = self.free;
                    self.free = self.slots[slot as usize].next;
                    self.slots[slot as usize] = entry;
                    slot
                };
                self.places.insert(key.into(), slot);
                slot
            }
        };
        self.link(slot, due);
        self.debug_check();
    }

    /// Takes `key` out; whether it was in.
    pub fn cancel(&mut self, key: K) -> bool {
        let Some(slot) = self.places.remove(key.into()) else { return false };
        self.unlink(slot);
        self.release(slot);
        self.debug_check();
        true
    }

    /// When something expires next.
    pub fn next_due(&self) -> Option<WorldTime> {
        self.buckets.first_key_value().map(|(&due, _)| due)
    }

    /// Takes out all that is due at or before `now` and appends it to `expired`: the earliest bucket first, within a bucket
    /// in the order of insertion.
    pub fn expire(&mut self, now: WorldTime, expired: &mut Vec<K>) {
        while let Some(bucket) = self.buckets.first_entry().filter(|bucket| *bucket.key() <= now) {
            let mut slot = bucket.remove().first;
            while slot != NONE {
                let Slot { key, next, .. } = self.slots[slot as usize];
                self.places.remove(key.into());
                self.release(slot);
                expired.push(key);
                slot = next;
            }
        }
        self.debug_check();
    }

    /// When `key` expires, if it is in.
    pub fn due(&self, key: K) -> Option<WorldTime> {
        self.places.get(key.into()).map(|&slot| self.slots[slot as usize].due)
    }

    /// Bytes that it takes, by the capacity of its lists; an estimate where a map does not tell.
    pub fn memory_bytes(&self) -> usize {
        self.slots.capacity() * size_of::<Slot<K>>()
            + self.places.memory_bytes()
            + self.buckets.len() * size_of::<(WorldTime, Bucket)>() * 3 / 2
    }

    /// How many keys are in.
    pub fn len(&self) -> usize {
        self.places.len()
    }

    /// Whether no key is in.
    pub fn is_empty(&self) -> bool {
        self.places.is_empty()
    }

    fn round_down(&self, time: WorldTime) -> WorldTime {
        WorldTime::from_micros(time.micros().div_euclid(self.quantum).saturating_mul(self.quantum))
    }

    /// Puts an entry at the end of its bucket's list.
    fn link(&mut self, slot: u32, due: WorldTime) {
        let mut previous = NONE;
        self.buckets
            .entry(due)
            .and_modify(|bucket| {
                previous = bucket.last;
                bucket.last = slot;
            })
            .or_insert(Bucket { first: slot, last: slot });
        if previous != NONE {
            self.slots[previous as usize].next = slot;
        }
        let entry = &mut self.slots[slot as usize];
        entry.due = due;
        entry.previous = previous;
        entry.next = NONE;
    }

    /// Takes an entry out of its bucket's list. Only at an end of the list need the bucket be looked up.
    fn unlink(&mut self, slot: u32) {
        let Slot { due, previous, next, .. } = self.slots[slot as usize];
        if previous != NONE {
            self.slots[previous as usize].next = next;
        }
        if next != NONE {
            self.slots[next as usize].previous = previous;
        }
        if previous == NONE && next == NONE {
            self.buckets.remove(&due);
        } else if previous == NONE || next == NONE {
            let bucket = self.buckets.get_mut(&due).expect("an entry's bucket exists");
            if previous == NONE {
                bucket.first = next;
            } else {
                bucket.last = previous;
            }
        }
    }

    fn release(&mut self, slot: u32) {
        self.slots[slot as usize].next = self.free;
        self.free = slot;
    }

    /// Lists, buckets and places agree. Called after each mutation in debug builds, while it is cheap.
    fn debug_check(&self) {
        if !cfg!(debug_assertions) || self.slots.len() > CHECKED_MAX {
            return;
        }
        let mut found = 0;
        for (&due, bucket) in &self.buckets {
            let (mut slot, mut previous) = (bucket.first, NONE);
            while slot != NONE {
                let entry = &self.slots[slot as usize];
                assert_eq!((entry.due, entry.previous), (due, previous), "an entry is in the wrong bucket");
                assert_eq!(self.places.get(entry.key.into()), Some(&slot), "a key's place is not its entry");
                found += 1;
                previous = slot;
                slot = entry.next;
            }
            assert_eq!(bucket.last, previous, "a bucket does not end where its list does");
            assert!(previous != NONE, "an empty bucket was kept");
        }
        assert_eq!(found, self.places.len(), "a key is in no bucket");
        let (mut slot, mut free) = (self.free, 0);
        while slot != NONE {
            free += 1;
            slot = self.slots[slot as usize].next;
        }
        assert_eq!(found + free, self.slots.len(), "a slot leaked");
    }
}

/// Largest queue that is checked after each mutation: the check is linear.
const CHECKED_MAX: usize = 256;

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use proptest::prelude::*;

    use super::*;

    fn micros(micros: i64) -> WorldTime {
        WorldTime::from_micros(micros)
    }

    fn expired(queue: &mut ExpiryQueue<u32>, now: i64) -> Vec<u32> {
        let mut expired = Vec::new();
        queue.expire(micros(now), &mut expired);
        expired
    }

    #[test]
    fn expiries_round_down_and_fall_together() {
        let mut queue = ExpiryQueue::new(Duration::from_micros(100));
        for (key, time) in [(1, 299), (2, 200), (3, 300), (4, -1)] {
            queue.insert(key, micros(time));
        }
        assert_eq!(
            (queue.due(1), queue.due(3), queue.due(4)),
            (Some(micros(200)), Some(micros(300)), Some(micros(-100)))
        );
        assert_eq!(expired(&mut queue, 199), [4]);
        assert_eq!(queue.next_due(), Some(micros(200)));
        assert_eq!(expired(&mut queue, 200), [1, 2]);
        assert_eq!(queue.len(), 1);
        assert_eq!(queue.due(1), None);
    }

    #[test]
    fn inserting_again_moves_and_a_cancelled_key_is_free_to_come_back() {
        let mut queue = ExpiryQueue::new(Duration::ZERO);
        queue.insert(7, micros(5));
        queue.insert(8, micros(5));
        queue.insert(7, micros(9));
        assert_eq!(expired(&mut queue, 5), [8]);
        assert!(queue.cancel(7) && !queue.cancel(7));
        assert!(queue.is_empty() && queue.next_due().is_none());
        queue.insert(7, micros(6));
        assert_eq!(expired(&mut queue, 6), [7]);
        assert_eq!(queue.slots.len(), 2, "slots are used again");
    }

    #[test]
    fn every_time_is_legal() {
        for quantum in [Duration::ZERO, Duration::from_nanos(3), Duration::from_millis(7), Duration::MAX] {
            let mut queue = ExpiryQueue::new(quantum);
            for (key, time) in [(1, WorldTime::MIN), (2, WorldTime::MAX), (3, WorldTime::ZERO), (4, micros(-1))] {
                queue.insert(key, time);
                assert!(queue.due(key).unwrap() <= time, "{quantum:?}: rounded up");
            }
            assert_eq!(queue.next_due(), Some(WorldTime::MIN));
            assert_eq!(expired(&mut queue, i64::MIN)[0], 1);
            assert_eq!(expired(&mut queue, i64::MAX), [4, 3, 2], "{quantum:?}");
            assert!(queue.is_empty());
        }
    }

    #[test]
    fn time_that_jumps_back_expires_nothing_twice() {
        let mut queue = ExpiryQueue::new(Duration::from_micros(10));
        queue.insert(1, micros(100));
        queue.insert(2, micros(200));
        assert_eq!(expired(&mut queue, 150), [1]);
        assert!(expired(&mut queue, 50).is_empty());
        // Already past when it comes: due at once, however far back the clock stands by then.
        queue.insert(1, micros(20));
        assert_eq!(expired(&mut queue, 50), [1]);
        assert_eq!(expired(&mut queue, 200), [2]);
    }

    #[derive(Clone, Debug)]
    enum Step {
        Insert(u32, i64),
        Cancel(u32),
        Expire(i64),
    }

    fn step() -> impl Strategy<Value = Step> {
        let time = prop_oneof![8 => -1000i64..1000, 1 => Just(i64::MIN), 1 => Just(i64::MAX)];
        prop_oneof![
            4 => (0u32..40, time.clone()).prop_map(|(key, time)| Step::Insert(key, time)),
            2 => (0u32..40).prop_map(Step::Cancel),
            1 => time.prop_map(Step::Expire),
        ]
    }

    proptest! {
        /// It says what a plain ordered set of rounded times says.
        #[test]
        fn it_agrees_with_an_ordered_set(quantum in 1i64..300, steps in prop::collection::vec(step(), 0..120)) {
            let mut queue = ExpiryQueue::new(Duration::from_micros(quantum as u64));
            let mut model: BTreeSet<(i64, u32)> = BTreeSet::new();
            for step in steps {
                match step {
                    Step::Insert(key, time) => {
                        model.retain(|&(_, other)| other != key);
                        model.insert((time.div_euclid(quantum).saturating_mul(quantum), key));
                        queue.insert(key, micros(time));
                    }
                    Step::Cancel(key) => {
                        let before = model.len();
                        model.retain(|&(_, other)| other != key);
                        prop_assert_eq!(queue.cancel(key), before > model.len());
                    }
                    Step::Expire(now) => {
                        let mut times = Vec::new();
                        let found = expired(&mut queue, now);
                        for &key in &found {
                            let &entry = model.iter().find(|&&(_, other)| other == key).unwrap();
                            times.push(entry.0);
                            model.remove(&entry);
                        }
                        prop_assert!(times.is_sorted() && times.iter().all(|&time| time <= now));
                        prop_assert!(model.first().is_none_or(|&(time, _)| time > now));
                    }
                }
                prop_assert_eq!(queue.len(), model.len());
                prop_assert_eq!(queue.next_due().map(WorldTime::micros), model.first().map(|&(time, _)| time));
                for &(time, key) in &model {
                    prop_assert_eq!(queue.due(key), Some(micros(time)));
                }
            }
        }
    }
}
