//! Which objects wait to be told of? A set in order of ids, most of which comes and goes once a tick.
//!
//! What a tick makes due is sorted once and taken from the end of a list, at a fraction of what a tree costs; what is due besides,
//! since it was asked for or got lost, is in a tree if the list is not short. Taking something out marks it: no more than [`MOVED_MAX`]
//! are ever moved up, so that no order of questions makes one of them cost more than a search (`limits.rs`).

use std::cmp::Reverse;
use std::collections::BTreeSet;

use eyeline_protocol::ObjectId;

/// A list of fewer gets what is due besides.
const MOVED_MAX: usize = 32;

/// A set of objects, first come the least ids.
#[derive(Clone, Default)]
pub(super) struct Due {
    /// Descending; with each whether it is still in the set. The last one is.
    batch: Vec<(ObjectId, bool)>,
    /// How many of `batch` are in the set.
    batch_len: usize,
    /// None of these is in `batch`, in the set or not.
    others: BTreeSet<ObjectId>,
}

impl Due {
    pub fn len(&self) -> usize {
        self.batch_len + self.others.len()
    }

    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    pub fn clear(&mut self) {
        *self = Due::default();
    }

    pub fn insert(&mut self, id: ObjectId) {
        match self.place(id) {
            Ok(place) => {
                let is_in = &mut self.batch[place].1;
                self.batch_len += usize::from(!*is_in);
                *is_in = true;
            }
            // A few that are asked for between two ticks find a place in the list, at a fraction of what a tree costs.
            Err(place) if self.others.is_empty() && self.batch.len() < MOVED_MAX => {
                self.batch.insert(place, (id, true));
                self.batch_len += 1;
            }
            Err(_) => drop(self.others.insert(id)),
        }
    }

    /// Adds many at once, each named once, in any order.
    pub fn insert_all(&mut self, ids: impl Iterator<Item = ObjectId>) {
        if !self.others.is_empty() {
            return ids.for_each(|id| self.insert(id));
        }
        self.batch.retain(|&(_, is_in)| is_in);
        self.batch.extend(ids.map(|id| (id, true)));
        self.batch.sort_unstable_by_key(|&(id, _)| Reverse(id));
        self.batch.dedup_by_key(|&mut (id, _)| id);
        self.batch_len = self.batch.len();
    }

    pub fn remove(&mut self, id: ObjectId) {
        match self.place(id) {
            Ok(place) => {
                self.batch_len -= usize::from(std::mem::take(&mut self.batch[place].1));
                self.trim();
            }
            Err(_) => drop(self.others.remove(&id)),
        }
    }

    /// Takes out the least id.
    pub fn pop_first(&mut self) -> Option<ObjectId> {
        let least = self.batch.last().map(|&(id, _)| id);
        let is_other = |&other: &ObjectId| least.is_none_or(|id| other < id);
        if self.others.first().is_some_and(is_other) {
            return self.others.pop_first();
        }
        self.batch.pop()?;
        self.batch_len -= 1;
        self.trim();
        least
    }

    /// All of them, in no order.
    pub fn iter(&self) -> impl Iterator<Item = ObjectId> {
        let batch = self.batch.iter().filter(|&&(_, is_in)| is_in).map(|&(id, _)| id);
        batch.chain(self.others.iter().copied())
    }

    /// Bytes on the heap, by the capacity of the list.
    pub fn memory_bytes(&self) -> usize {
        // A tree keeps its entries in blocks that are two thirds full on average.
        self.batch.capacity() * size_of::<(ObjectId, bool)>() + self.others.len() * size_of::<ObjectId>() * 3 / 2
    }

    /// Where it is in the list, or would be.
    fn place(&self, id: ObjectId) -> Result<usize, usize> {
        self.batch.binary_search_by_key(&Reverse(id), |&(id, _)| Reverse(id))
    }

    /// Lets go of what was taken out at the end of the list.
    fn trim(&mut self) {
        while self.batch.last().is_some_and(|&(_, is_in)| !is_in) {
            self.batch.pop();
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        /// It is a set, whatever is done to it in which order.
        #[test]
        fn is_a_set(steps in prop::collection::vec((0..4u8, 0..40u32), 0..200)) {
            let (mut due, mut model) = (Due::default(), BTreeSet::new());
            for (what, number) in steps {
                let id = ObjectId(number);
                match what {
                    0 => {
                        due.insert(id);
                        model.insert(id);
                    }
                    1 => {
                        due.remove(id);
                        model.remove(&id);
                    }
                    2 => prop_assert_eq!(due.pop_first(), model.pop_first()),
                    _ => {
                        // 7 and 41 have no divisor in common, so that all are different.
                        let ids = || (0..number).map(|i| ObjectId(i * 7 % 41));
                        due.insert_all(ids());
                        model.extend(ids());
                    }
                }
                prop_assert_eq!(due.iter().collect::<BTreeSet<_>>(), model.clone());
                prop_assert_eq!((due.len(), due.iter().count(), due.is_empty()), (model.len(), model.len(), model.is_empty()));
            }
        }
    }
}
