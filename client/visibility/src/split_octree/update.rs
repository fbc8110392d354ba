//! Insertion, deletion, and the two ways to move an entry.

use super::tree::{Place, ROOT};
use super::{Entry, SplitOctree, Update};

/// Lists that an update needs, kept for their memory.
#[derive(Clone, Debug, Default)]
pub(super) struct Buffers {
    /// The paper's σ: the nodes that held the entry, deepest last.
    held_by: Vec<u32>,
    /// s and t of Fig. 10: the nodes of a level, and their parents.
    level: Vec<u32>,
    parents: Vec<u32>,
}

impl SplitOctree {
    /// Moves an entry.
    pub(super) fn relocate(&mut self, entry: u32, place: Place) {
        match self.rules.update {
            Update::UnderLca => self.revise(entry, Some(place)),
            Update::Whole => {
                self.delete_below(ROOT, entry);
                self.entries[entry as usize].place = place;
                self.insert_below(ROOT, entry);
            }
        }
    }

    /// Takes an entry out of the tree.
    pub(super) fn delete(&mut self, entry: u32) {
        match self.rules.update {
            Update::UnderLca => self.revise(entry, None),
            Update::Whole => self.delete_below(ROOT, entry),
        }
    }

    /// Inserts an entry, which touches this node, at its place: the paper's `insert` and `insert_multiple`.
    pub(super) fn insert_below(&mut self, node: u32, entry: u32) {
        self.stats.node_visits += 1;
        let place = self.entries[entry as usize].place;
        let here = self.node_mut(node);
        if place.level > here.depth {
            here.count += 1;
            if !here.is_leaf() {
                for child in here.children() {
                    if self.grid.touches(self.node(child), &place) {
                        self.insert_below(child, entry);
                    }
                }
                return;
            }
        }
        self.associate(node, entry);
        if self.node(node).is_leaf() && self.grid.splits(self.node(node)) {
            self.split(node);
        }
    }

    /// Deletes an entry, which touches this node, from its place, and merges nodes on the way back (Fig. 5's `delete`).
    fn delete_below(&mut self, node: u32, entry: u32) {
        self.stats.node_visits += 1;
        let place = self.entries[entry as usize].place;
        let here = self.node_mut(node);
        let passes = place.level > here.depth;
        here.count -= u32::from(passes);
        if !passes || here.is_leaf() {
            self.dissociate(node, entry);
            return;
        }
        for child in here.children() {
            if self.grid.touches(self.node(child), &place) {
                self.delete_below(child, entry);
            }
        }
        if !self.grid.splits(self.node(node)) {
            self.collapse(node);
        }
    }

    /// Moves an entry, or takes it away, from the bottom up (Figs. 9 and 10).
    ///
    /// As in Fig. 10 the nodes that held the entry are gone through level by level, with the parents of those below, until one
    /// is left that also contains the new place: the least common ancestor. Nothing changes above it. Two things differ. The
    /// paper asks whether a node can be collapsed when the entry has left it, so that the ancestor itself may collapse and be
    /// split again at once (a step from one octant to the next, where the entry made the difference); here each node gets the
    /// count it will have in the end. And what enters at the new place does so at the first node on the way that touches
    /// both places, not from the ancestor, so that every node is visited once.
    fn revise(&mut self, entry: u32, new: Option<Place>) {
        let Entry { place, references, .. } = &mut self.entries[entry as usize];
        let old = *place;
        *place = new.unwrap_or(old);
        let Buffers { mut held_by, mut level, mut parents } = std::mem::take(&mut self.buffers);
        held_by.extend(references.iter().map(|reference| reference.node));
        held_by.sort_unstable_by_key(|&node| (self.node(node).depth, node));
        let mut depth = held_by.last().map_or(0, |&node| self.node(node).depth);
        loop {
            while let Some(&node) = held_by.last().filter(|&&node| self.node(node).depth == depth) {
                level.push(node);
                held_by.pop();
            }
            level.sort_unstable();
            level.dedup();
            let alone = held_by.is_empty() && level.len() == 1;
            for &node in &level {
                self.revise_at(node, entry, &old, new.as_ref());
                parents.push(self.node(node).parent);
            }
            // Collapsing took away nodes below this level only, so the level's nodes are still there.
            let contains = |node: u32| new.is_some_and(|new| self.grid.contains(self.node(node), &new));
            if depth == 0 || (alone && contains(level[0])) {
                break;
            }
            depth -= 1;
            level.clear();
            std::mem::swap(&mut level, &mut parents);
        }
        level.clear();
        parents.clear();
        self.buffers = Buffers { held_by, level, parents };
    }

    /// Gives a node that the old place touches what it has to have for the new one.
    fn revise_at(&mut self, node: u32, entry: u32, old: &Place, new: Option<&Place>) {
        self.stats.node_visits += 1;
        let depth = self.node(node).depth;
        let new = new.filter(|new| self.grid.touches(self.node(node), new));
        let passed = old.level > depth;
        let passes = new.is_some_and(|new| new.level > depth);
        let here = self.node_mut(node);
        here.count = here.count + u32::from(passes) - u32::from(passed);
        let splits = self.grid.splits(self.node(node));
        if !self.node(node).is_leaf() && !splits {
            self.collapse(node);
        }
        let is_leaf = self.node(node).is_leaf();
        let stops = new.is_some() && (is_leaf || !passes);
        match (self.holds(node, entry), stops) {
            (false, true) => self.associate(node, entry),
            (true, false) => self.dissociate(node, entry),
            _ => {}
        }
        if is_leaf && splits {
            self.split(node);
        } else if let Some(new) = new.filter(|_| passes) {
            for child in self.node(node).children() {
                let there = self.node(child);
                if self.grid.touches(there, new) && !(passed && self.grid.touches(there, old)) {
                    self.insert_below(child, entry);
                }
            }
        }
    }
}
