//! D: what is believed of each object, side by side.
//!
//! Every step of a frame looks things up here, and of a thousand clients' beliefs none is in a cache. So entries lie in one list in
//! the order in which objects were named, which is nearly that of their ids, and an id's place in it is found by one access.

use eyeline_protocol::ObjectId;
use eyeline_visibility::IdMap;

/// A list of entries, found by their objects' ids. Nothing may depend on its order.
#[derive(Debug)]
pub(super) struct Entries<E> {
    places: IdMap<u32>,
    all: Vec<(ObjectId, E)>,
}

impl<E> Default for Entries<E> {
    fn default() -> Entries<E> {
        Entries { places: IdMap::default(), all: Vec::new() }
    }
}

impl<E> Entries<E> {
    #[inline]
    pub fn get(&self, object: &ObjectId) -> Option<&E> {
        self.places.get(object.0).map(|&place| &self.all[place as usize].1)
    }

    #[inline]
    pub fn get_mut(&mut self, object: &ObjectId) -> Option<&mut E> {
        self.places.get(object.0).map(|&place| &mut self.all[place as usize].1)
    }

    pub fn contains_key(&self, object: &ObjectId) -> bool {
        self.places.get(object.0).is_some()
    }

    /// Puts an entry in, in place of an older one.
    pub fn insert(&mut self, object: ObjectId, entry: E) {
        match self.get_mut(&object) {
            Some(old) => *old = entry,
            None => {
                self.places.insert(object.0, self.all.len() as u32);
                self.all.push((object, entry));
            }
        }
    }

    pub fn remove(&mut self, object: &ObjectId) -> Option<E> {
        let place = self.places.remove(object.0)?;
        let (_, entry) = self.all.swap_remove(place as usize);
        if let Some((moved, _)) = self.all.get(place as usize) {
            self.places.insert(moved.0, place);
        }
        Some(entry)
    }

    pub fn is_empty(&self) -> bool {
        self.all.is_empty()
    }

    pub fn iter(&self) -> impl Iterator<Item = (&ObjectId, &E)> {
        self.all.iter().map(|(object, entry)| (object, entry))
    }

    pub fn values(&self) -> impl Iterator<Item = &E> {
        self.all.iter().map(|(_, entry)| entry)
    }

    /// Bytes that it takes, by the capacity of its lists.
    pub fn memory_bytes(&self) -> usize {
        self.places.memory_bytes() + self.all.capacity() * size_of::<(ObjectId, E)>()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_is_found_whoever_has_left_before() {
        let mut entries = Entries::default();
        for id in [0, 1, 2, 9_000_000] {
            entries.insert(ObjectId(id), id);
        }
        assert_eq!(entries.remove(&ObjectId(1)), Some(1));
        assert_eq!(entries.remove(&ObjectId(1)), None);
        entries.insert(ObjectId(2), 20);
        for (id, entry) in [(0, Some(0)), (1, None), (2, Some(20)), (9_000_000, Some(9_000_000))] {
            assert_eq!(entries.get(&ObjectId(id)).copied(), entry, "{id}");
            assert_eq!(entries.contains_key(&ObjectId(id)), entry.is_some(), "{id}");
        }
        assert_eq!((entries.values().count(), entries.iter().count()), (3, 3));
    }
}
