//! An octree that splits where much is and collapses where little is left: which nodes does an update have to touch?
//!
//! Sudarsky & Gotsman's structure T as they describe it (1999, §4): a node is split into eight octants if too many entries
//! would go down to them, and octants are merged when few enough are left. Entries have one reference each, from the
//! smallest node that contains them (Fig. 9), or several, from all nodes that they touch (Fig. 10). An update deletes and
//! inserts from the root (Fig. 5) or touches only what lies under the least common ancestor of the old and the new place.
//! [`crate::DynamicOctree`] is the one to track with: its nodes come and go with what they hold, so that it has nothing to
//! split or to collapse. This one is for comparing with the paper, and for many static things beside few moving ones.
//!
//! **The tree is a function of what it holds.** Each entry has a *level*: the depth at which it stops, whatever else is
//! there. A node's count is of the entries that touch it and have a deeper level; the node is split if and only if that is
//! more than the rules allow. A child never counts more than its parent, so this fits together at all depths, and since it
//! says nothing of the past, trees with the same contents are equal.
//!
//! `tree` has the nodes, `update` the paper's algorithms.

mod tree;
mod update;

use std::collections::BTreeSet;

use rustc_hash::FxHashMap;

use crate::{Aabb, Bound, DynamicIndex, Occlusion};
use tree::{Grid, Node, Place, ROOT};

/// Which nodes know of an entry.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum References {
    /// The smallest node that contains it (Sudarsky & Gotsman 1999, Fig. 9).
    Single,
    /// All nodes that it touches, at the depth where it is no longer small compared to them, and all leaves that it touches
    /// above that depth (Fig. 10). Small means: at most half as large.
    Multiple,
}

/// How an entry that moves is updated. The tree is the same.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Update {
    /// Under the least common ancestor of its old and its new place (Figs. 7 to 10).
    UnderLca,
    /// Deleted from the root, which merges nodes on the way, and inserted from the root (Fig. 5).
    Whole,
}

/// The shape of a [`SplitOctree`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SplitRules {
    /// A node that more entries than this would leave for its octants is split. Default 8. More make fewer nodes, each
    /// with more to test.
    pub primitives_max: usize,
    /// Depth of the smallest nodes, the root's being 0. Default 16; more than 24 count as 24.
    pub depth_max: u32,
    /// Default [`References::Single`].
    pub references: References,
    /// Default [`Update::UnderLca`].
    pub update: Update,
}

impl Default for SplitRules {
    fn default() -> SplitRules {
        SplitRules { primitives_max: 8, depth_max: 16, references: References::Single, update: Update::UnderLca }
    }
}

/// Work of insertions, removals and moves since [`SplitOctree::reset_stats`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SplitStats {
    /// Nodes that were looked at. A split and a collapse look at eight each.
    pub node_visits: u64,
    /// Nodes that splits made.
    pub nodes_made: u64,
    /// Nodes that collapses deleted.
    pub nodes_deleted: u64,
    /// Entries that were associated with a node, those that a split or a collapse passed on included.
    pub references: u64,
}

/// An octree of bounds, static or moving, that splits and collapses.
///
/// What is outside the world's box is legal, but all of it lives in the root.
#[derive(Clone, Debug)]
pub struct SplitOctree {
    rules: SplitRules,
    grid: Grid,
    /// Node 0 is the root. The others are in blocks of eight siblings, by octant, x fastest.
    nodes: Vec<Node>,
    /// First nodes of vacant blocks.
    free_blocks: Vec<u32>,
    /// The paper's D: what is known of each entry, with pointers to the nodes that hold it. They agree with the nodes' lists.
    entries: Vec<Entry>,
    free_entries: Vec<u32>,
    /// Where in `entries` each bounded key is.
    slots: FxHashMap<u32, u32>,
    /// Keys that may be anywhere, and so are always exposed. Disjoint from `slots`.
    unbounded: BTreeSet<u32>,
    stats: SplitStats,
    /// Nodes visited before the last reset of `stats`.
    visits_before: u64,
    buffers: update::Buffers,
}

#[derive(Clone, Debug)]
struct Entry {
    key: u32,
    bound: Bound,
    place: Place,
    /// In which nodes it is, and where in their lists. At most 8, but for rounding.
    references: Vec<Reference>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Reference {
    node: u32,
    slot: u32,
}

impl SplitOctree {
    /// An empty octree whose root is the cube around this box, 1 % wider. A box that makes no sense gets a root of 2 km
    /// around the origin.
    pub fn new(world: Aabb, rules: SplitRules) -> SplitOctree {
        let grid = Grid::new(world, &rules);
        SplitOctree {
            rules,
            grid,
            nodes: vec![Node::root()],
            free_blocks: Vec::new(),
            entries: Vec::new(),
            free_entries: Vec::new(),
            slots: FxHashMap::default(),
            unbounded: BTreeSet::new(),
            stats: SplitStats::default(),
            visits_before: 0,
            buffers: update::Buffers::default(),
        }
    }

    /// The rules it was made with.
    pub fn rules(&self) -> SplitRules {
        self.rules
    }

    /// Work done since it was made or [reset](SplitOctree::reset_stats).
    pub fn stats(&self) -> SplitStats {
        self.stats
    }

    /// Counts from 0 again, but for [`DynamicIndex::update_visits`].
    pub fn reset_stats(&mut self) {
        self.visits_before += self.stats.node_visits;
        self.stats = SplitStats::default();
    }

    /// Nodes in use, the root included.
    pub fn node_count(&self) -> usize {
        self.nodes.len() - 8 * self.free_blocks.len()
    }

    /// Depth of the deepest nodes; 0 if there is only the root.
    pub fn depth(&self) -> u32 {
        self.walk().map(|node| self.node(node).depth).max().unwrap_or(0)
    }

    /// References that nodes hold: at least one for each bounded key.
    pub fn reference_count(&self) -> usize {
        self.walk().map(|node| self.node(node).held.len()).sum()
    }

    /// Whether both have the same nodes with the same keys in each, whatever happened before. How they are updated does not
    /// count; grids and the other rules must agree.
    pub fn same_structure(&self, other: &SplitOctree) -> bool {
        let held = |tree: &SplitOctree, node: u32| {
            let mut keys: Vec<u32> =
                tree.node(node).held.iter().map(|&entry| tree.entries[entry as usize].key).collect();
            keys.sort_unstable();
            keys
        };
        let rules = |tree: &SplitOctree| SplitRules { update: Update::Whole, ..tree.rules };
        if self.grid != other.grid || rules(self) != rules(other) || self.unbounded != other.unbounded {
            return false;
        }
        let mut stack = vec![(ROOT, ROOT)];
        while let Some((here, there)) = stack.pop() {
            let (a, b) = (self.node(here), other.node(there));
            let alike = a.depth == b.depth && a.cell == b.cell && a.count == b.count && a.is_leaf() == b.is_leaf();
            if !alike || held(self, here) != held(other, there) {
                return false;
            }
            stack.extend(a.children().zip(b.children()));
        }
        true
    }

    fn node(&self, node: u32) -> &Node {
        &self.nodes[node as usize]
    }

    /// All nodes.
    fn walk(&self) -> impl Iterator<Item = u32> {
        let mut stack = vec![ROOT];
        std::iter::from_fn(move || {
            let at = stack.pop()?;
            stack.extend(self.node(at).children());
            Some(at)
        })
    }

    /// Checks, in debug builds, what a mutation of this key may have broken: its pointers and the nodes above them. The whole
    /// tree would make every mutation linear.
    fn check(&self, key: u32) {
        if !cfg!(debug_assertions) {
            return;
        }
        let Some(&slot) = self.slots.get(&key) else { return };
        assert!(!self.unbounded.contains(&key), "a key is bounded or not");
        let Entry { key: own, place, references, .. } = &self.entries[slot as usize];
        assert_eq!(*own, key, "a slot is its key's");
        assert!(!references.is_empty(), "a bounded key is somewhere");
        for (i, reference) in references.iter().enumerate() {
            let node = self.node(reference.node);
            assert_eq!(node.held[reference.slot as usize], slot, "a node holds what points to it");
            assert!(references[..i].iter().all(|other| other.node != reference.node), "a node holds a key once");
            assert!(self.grid.touches(node, place), "an entry lies where it is held");
            let stops = node.depth == place.level || (node.is_leaf() && node.depth < place.level);
            assert!(stops, "an entry goes as deep as it can");
            self.check_split(reference.node);
            let mut at = reference.node;
            while at != ROOT {
                let parent = self.node(at).parent;
                assert!(self.node(parent).children().any(|child| child == at), "a parent knows its child");
                assert!(self.node(at).count <= self.node(parent).count, "a child counts no more than its parent");
                self.check_split(parent);
                at = parent;
            }
        }
    }

    fn check_split(&self, node: u32) {
        let node = self.node(node);
        assert_eq!(!node.is_leaf(), self.grid.splits(node), "a node is split if and only if its count says so");
    }
}

impl DynamicIndex for SplitOctree {
    fn insert(&mut self, key: u32, bound: Bound) {
        let old = self.slots.get(&key).copied();
        let Some(aabb) = bound.outer_box() else {
            self.remove(key);
            self.unbounded.insert(key);
            return;
        };
        let place = self.grid.place(&aabb);
        match old {
            Some(entry) => {
                self.entries[entry as usize].bound = bound;
                self.relocate(entry, place);
            }
            None => {
                self.unbounded.remove(&key);
                let entry = Entry { key, bound, place, references: Vec::new() };
                let slot = match self.free_entries.pop() {
                    Some(vacant) => {
                        self.entries[vacant as usize] = entry;
                        vacant
                    }
                    None => {
                        self.entries.push(entry);
                        (self.entries.len() - 1) as u32
                    }
                };
                self.slots.insert(key, slot);
                self.insert_below(ROOT, slot);
            }
        }
        self.check(key);
    }

    fn remove(&mut self, key: u32) -> bool {
        let Some(entry) = self.slots.remove(&key) else { return self.unbounded.remove(&key) };
        self.delete(entry);
        debug_assert!(self.entries[entry as usize].references.is_empty(), "what is gone is nowhere");
        self.free_entries.push(entry);
        true
    }

    fn exposed(&self, occlusion: &dyn Occlusion, exposed: &mut Vec<u32>) -> usize {
        let start = exposed.len();
        let mut work = self.unbounded.len();
        let mut stack = vec![ROOT];
        let mut reached = Vec::new();
        while let Some(at) = stack.pop() {
            let node = self.node(at);
            work += 1;
            // The root also holds what is outside its cell, and a node with a single entry says no more than the entry.
            let asked = at != ROOT && !(node.is_leaf() && node.held.len() <= 1);
            if asked && occlusion.hides(&Bound::Box(self.grid.cell_box(node))) {
                continue;
            }
            reached.extend_from_slice(&node.held);
            stack.extend(node.children());
        }
        // Several nodes may have named an entry, which is asked about once.
        reached.sort_unstable();
        reached.dedup();
        work += reached.len();
        let seen = reached.iter().map(|&entry| &self.entries[entry as usize]);
        exposed.extend(seen.filter(|entry| !occlusion.hides(&entry.bound)).map(|entry| entry.key));
        exposed.extend(&self.unbounded);
        exposed[start..].sort_unstable();
        work
    }

    fn len(&self) -> usize {
        self.slots.len() + self.unbounded.len()
    }

    fn memory_bytes(&self) -> usize {
        let held: usize = self.nodes.iter().map(|node| node.held.capacity()).sum();
        let references: usize = self.entries.iter().map(|entry| entry.references.capacity()).sum();
        self.nodes.capacity() * size_of::<Node>()
            + self.entries.capacity() * size_of::<Entry>()
            + (held + references + self.free_blocks.capacity() + self.free_entries.capacity()) * size_of::<u32>()
            + self.slots.capacity() * (size_of::<(u32, u32)>() + 1)
            + self.unbounded.len() * size_of::<u32>() * 3 / 2
    }

    fn update_visits(&self) -> u64 {
        self.visits_before + self.stats.node_visits
    }
}

#[cfg(test)]
mod tests;
