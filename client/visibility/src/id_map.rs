//! What belongs to a number, where numbers are small and most of them are in use?
//!
//! Objects of a world are numbered from 0. So a value lies in a list at its number: a look-up is one access to memory, where a
//! hash map takes two that depend on each other, and who asks about neighbours finds them side by side. Of the beliefs of a
//! thousand clients none is in a cache, and such accesses are most of what a tracker waits for.
//!
//! Numbers come from a peer. The list never has more than [`SPREAD`] places for each value that is held (and [`SPARE`] more);
//! what lies beyond goes into a hash map.

use rustc_hash::FxHashMap;

/// A map by small numbers.
#[derive(Clone, Debug)]
pub struct IdMap<V> {
    near: Vec<Option<V>>,
    /// What came while it lay too far out. Disjoint from `near`, and empty mostly.
    far: FxHashMap<u32, V>,
    len: usize,
}

/// Places in the list for each value.
const SPREAD: usize = 4;

/// Places in the list beside these.
const SPARE: usize = 16;

impl<V> Default for IdMap<V> {
    fn default() -> IdMap<V> {
        IdMap { near: Vec::new(), far: FxHashMap::default(), len: 0 }
    }
}

impl<V> IdMap<V> {
    /// The value of `id`, if it has one.
    #[inline]
    pub fn get(&self, id: u32) -> Option<&V> {
        match self.near.get(id as usize) {
            Some(Some(value)) => Some(value),
            _ if self.far.is_empty() => None,
            _ => self.far.get(&id),
        }
    }

    /// The same, to be changed.
    #[inline]
    pub fn get_mut(&mut self, id: u32) -> Option<&mut V> {
        match self.near.get_mut(id as usize) {
            Some(Some(value)) => Some(value),
            _ if self.far.is_empty() => None,
            _ => self.far.get_mut(&id),
        }
    }

    /// Sets the value of `id`; the one that it had.
    pub fn insert(&mut self, id: u32, value: V) -> Option<V> {
        if let Some(old) = self.get_mut(id) {
            return Some(std::mem::replace(old, value));
        }
        self.len += 1;
        let index = id as usize;
        if index >= self.near.len() && index < SPREAD * self.len + SPARE {
            self.near.resize_with(index + 1, || None);
        }
        match self.near.get_mut(index) {
            Some(place) => *place = Some(value),
            None => drop(self.far.insert(id, value)),
        }
        None
    }

    /// Takes out the value of `id`.
    pub fn remove(&mut self, id: u32) -> Option<V> {
        let near = self.near.get_mut(id as usize).and_then(Option::take);
        let removed = near.or_else(|| self.far.remove(&id));
        self.len -= usize::from(removed.is_some());
        removed
    }

    /// How many have a value.
    pub fn len(&self) -> usize {
        self.len
    }

    /// Whether none has one.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Bytes that it takes, by the capacity of its lists.
    pub fn memory_bytes(&self) -> usize {
        self.near.capacity() * size_of::<Option<V>>() + self.far.capacity() * (size_of::<(u32, V)>() + 1)
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use proptest::prelude::*;

    use super::*;

    #[test]
    fn a_number_from_far_out_costs_no_list() {
        let mut map = IdMap::default();
        for id in [u32::MAX, 1 << 24, 100_000] {
            assert_eq!(map.insert(id, id), None);
        }
        assert!(map.memory_bytes() < 1024, "{} bytes", map.memory_bytes());
        assert_eq!((map.get(1 << 24), map.get(5), map.len()), (Some(&(1 << 24)), None, 3));
    }

    proptest! {
        /// It says what an ordered map says, for numbers near, far, and near only once there are many.
        #[test]
        fn it_agrees_with_an_ordered_map(
            steps in prop::collection::vec((prop_oneof![0u32..40, 40u32..400, any::<u32>()], any::<u8>(), any::<bool>()), 0..200),
        ) {
            let (mut map, mut model) = (IdMap::default(), BTreeMap::new());
            for (id, value, is_insert) in steps {
                if is_insert {
                    prop_assert_eq!(map.insert(id, value), model.insert(id, value));
                } else {
                    prop_assert_eq!(map.remove(id), model.remove(&id));
                }
                prop_assert_eq!(map.len(), model.len());
                prop_assert_eq!(map.is_empty(), model.is_empty());
                prop_assert!(map.near.len() <= SPREAD * 200 + SPARE);
                for (id, value) in &mut model {
                    prop_assert_eq!(map.get(*id), Some(&*value));
                    prop_assert_eq!(map.get_mut(*id), Some(value));
                }
            }
        }
    }
}
