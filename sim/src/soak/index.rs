//! T without a tree: a list, and a window through which a checker sees what is in it.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};

use eyeline_client::session::IndexMaker;
use eyeline_visibility::{Bound, DynamicIndex, Occlusion};

/// What a [`PlainIndex`] holds, by key.
#[derive(Clone, Default)]
pub struct IndexView {
    bounds: Arc<Mutex<BTreeMap<u32, Bound>>>,
}

impl IndexView {
    /// The bound that is in T under `key`.
    pub fn bound(&self, key: u32) -> Option<Bound> {
        self.bounds.lock().expect("nothing panics while it holds the lock").get(&key).copied()
    }

    /// Makes the index that this view looks into.
    pub fn maker(&self) -> IndexMaker {
        let view = self.clone();
        Box::new(move || Box::new(PlainIndex { view: view.clone(), updates: 0 }))
    }
}

/// Tests every bound at every walk.
pub struct PlainIndex {
    view: IndexView,
    updates: u64,
}

impl DynamicIndex for PlainIndex {
    fn insert(&mut self, key: u32, bound: Bound) {
        self.updates += 1;
        self.view.bounds.lock().expect("nothing panics while it holds the lock").insert(key, bound);
    }

    fn remove(&mut self, key: u32) -> bool {
        self.updates += 1;
        self.view.bounds.lock().expect("nothing panics while it holds the lock").remove(&key).is_some()
    }

    fn exposed(&self, occlusion: &dyn Occlusion, exposed: &mut Vec<u32>) -> usize {
        let bounds = self.view.bounds.lock().expect("nothing panics while it holds the lock");
        exposed.extend(bounds.iter().filter(|(_, bound)| !occlusion.hides(bound)).map(|(&key, _)| key));
        bounds.len()
    }

    fn len(&self) -> usize {
        self.view.bounds.lock().expect("nothing panics while it holds the lock").len()
    }

    fn memory_bytes(&self) -> usize {
        self.len() * size_of::<(u32, Bound)>() * 3 / 2
    }

    fn update_visits(&self) -> u64 {
        self.updates
    }
}
