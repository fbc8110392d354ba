//! Nodes, and which of them an entry belongs to.
//!
//! Places are whole numbers of the smallest cells, so that whether a box touches a node is exact at every depth, and
//! consistent between depths, whatever f64 rounds.

use glam::DVec3;

use super::{Reference, References, SplitOctree, SplitRules};
use crate::Aabb;

pub(super) const ROOT: u32 = 0;
pub(super) const NONE: u32 = u32::MAX;

/// Depth of the smallest cells at most: their sides stay far above what f64 rounds off.
const DEPTH_MOST: u32 = 24;

/// Half the root's side, in metres, where the world says nothing.
const REACH: f64 = 1024.0;

/// A node of the tree.
#[derive(Clone, Debug)]
pub(super) struct Node {
    /// The root's is 0.
    pub(super) depth: u32,
    /// Which cell of its depth it is along x, y and z, from 0 to 2^depth − 1.
    pub(super) cell: [u32; 3],
    /// The root is its own.
    pub(super) parent: u32,
    /// The first of eight siblings; [`NONE`] for a leaf.
    pub(super) first_child: u32,
    /// Entries that touch the node and stop deeper: here in a leaf, below in another node. What decides about splitting.
    pub(super) count: u32,
    /// Which entries it holds.
    pub(super) held: Vec<u32>,
}

impl Node {
    pub(super) fn root() -> Node {
        Node { depth: 0, cell: [0; 3], parent: ROOT, first_child: NONE, count: 0, held: Vec::new() }
    }

    pub(super) fn is_leaf(&self) -> bool {
        self.first_child == NONE
    }

    /// By octant, x fastest; none for a leaf.
    pub(super) fn children(&self) -> std::ops::Range<u32> {
        if self.is_leaf() { 0..0 } else { self.first_child..self.first_child + 8 }
    }

    /// The cell of the child in an octant.
    fn octant(&self, octant: u32) -> [u32; 3] {
        std::array::from_fn(|axis| self.cell[axis] << 1 | (octant >> axis & 1))
    }
}

/// Where an entry is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Place {
    /// First and last of the smallest cells that it touches, along x, y and z. Meaningless at level 0.
    low: [u32; 3],
    high: [u32; 3],
    /// The depth at which it stops, however many others are there.
    pub(super) level: u32,
}

/// Space as the tree divides it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Grid {
    origin: DVec3,
    /// Side of the root in metres.
    side: f64,
    depth_max: u32,
    count_max: u32,
    references: References,
    /// In metres: by how much rounding may put an entry into the cell beside its own.
    slack: f64,
}

impl Grid {
    pub(super) fn new(world: Aabb, rules: &SplitRules) -> Grid {
        let reach = world.size().max_element() * 0.5;
        let known = !world.is_empty() && world.min.is_finite() && world.max.is_finite() && reach.is_finite();
        let known = known && world.centre().is_finite();
        let (centre, reach) = if known { (world.centre(), reach.max(1e-3)) } else { (DVec3::ZERO, REACH) };
        // Faces of the world are inside, not on the border, where they would belong to no cell.
        let reach = reach * 1.01;
        let origin = centre - reach;
        Grid {
            origin,
            side: reach * 2.0,
            depth_max: rules.depth_max.min(DEPTH_MOST),
            count_max: rules.primitives_max.min(u32::MAX as usize - 1) as u32,
            references: rules.references,
            slack: (origin.abs().max_element() + reach) * 1e-14,
        }
    }

    /// Whether a node's count says that it is split.
    pub(super) fn splits(&self, node: &Node) -> bool {
        node.depth < self.depth_max && node.count > self.count_max
    }

    /// Where a finite box belongs. Cells are half-open.
    pub(super) fn place(&self, aabb: &Aabb) -> Place {
        let cells = f64::from(1_u32 << self.depth_max);
        let per_metre = cells / self.side;
        let [low, high] = [aabb.min, aabb.max].map(|corner| ((corner - self.origin) * per_metre).floor());
        if !(low.cmpge(DVec3::ZERO).all() && high.cmplt(DVec3::splat(cells)).all()) {
            return Place { low: [0; 3], high: [0; 3], level: 0 };
        }
        let [low, high] = [low, high].map(|corner| corner.to_array().map(|cell| cell as u32));
        let level = match self.references {
            // The depth down to which both corners are in the same cell.
            References::Single => {
                let differ = (0..3).fold(0, |differ, axis| differ | (low[axis] ^ high[axis]));
                self.depth_max - (u32::BITS - differ.leading_zeros())
            }
            References::Multiple => {
                let size = aabb.size().max_element();
                let mut level = 0;
                // Small compared to a node: at most as large as its octants.
                while level < self.depth_max && size <= self.side_at(level + 1) {
                    level += 1;
                }
                level
            }
        };
        Place { low, high, level }
    }

    fn side_at(&self, depth: u32) -> f64 {
        self.side / f64::from(1_u32 << depth)
    }

    /// Whether an entry at this place touches the node, whose depth is at most the entry's level.
    pub(super) fn touches(&self, node: &Node, place: &Place) -> bool {
        node.depth <= place.level && self.touches_cell(node.depth, node.cell, place)
    }

    fn touches_cell(&self, depth: u32, cell: [u32; 3], place: &Place) -> bool {
        let shift = self.depth_max - depth;
        let within = |axis: usize| (place.low[axis] >> shift..=place.high[axis] >> shift).contains(&cell[axis]);
        depth == 0 || (0..3).all(within)
    }

    /// Whether all of the entry lies in the node, so that nothing above the node can tell where.
    pub(super) fn contains(&self, node: &Node, place: &Place) -> bool {
        let shift = self.depth_max - node.depth;
        let within = |axis: usize| [place.low, place.high].iter().all(|end| end[axis] >> shift == node.cell[axis]);
        node.depth == 0 || (node.depth <= place.level && (0..3).all(within))
    }

    /// A box that contains what of its entries lies in the node, rounding included.
    pub(super) fn cell_box(&self, node: &Node) -> Aabb {
        let side = self.side_at(node.depth);
        let min = self.origin + DVec3::from_array(node.cell.map(f64::from)) * side;
        Aabb::new(min, min + side).inflated(self.slack)
    }
}

impl SplitOctree {
    pub(super) fn node_mut(&mut self, node: u32) -> &mut Node {
        &mut self.nodes[node as usize]
    }

    pub(super) fn holds(&self, node: u32, entry: u32) -> bool {
        self.entries[entry as usize].references.iter().any(|reference| reference.node == node)
    }

    /// Associates an entry with a node that does not hold it.
    pub(super) fn associate(&mut self, node: u32, entry: u32) {
        debug_assert!(!self.holds(node, entry), "a node holds an entry once");
        let held = &mut self.node_mut(node).held;
        held.push(entry);
        let slot = (held.len() - 1) as u32;
        self.entries[entry as usize].references.push(Reference { node, slot });
        self.stats.references += 1;
    }

    /// Dissociates an entry from a node that holds it.
    pub(super) fn dissociate(&mut self, node: u32, entry: u32) {
        let references = &mut self.entries[entry as usize].references;
        let at = references.iter().position(|reference| reference.node == node).expect("the node holds the entry");
        let slot = references.swap_remove(at).slot;
        let held = &mut self.node_mut(node).held;
        held.swap_remove(slot as usize);
        if let Some(&moved) = held.get(slot as usize) {
            let references = self.entries[moved as usize].references.iter_mut();
            let pointer = references.into_iter().find(|reference| reference.node == node);
            pointer.expect("an entry knows its nodes").slot = slot;
        }
    }

    /// Splits a leaf, and its children where they count too many.
    pub(super) fn split(&mut self, node: u32) {
        let first = match self.free_blocks.pop() {
            Some(first) => first,
            None => {
                let first = self.nodes.len() as u32;
                self.nodes.resize(self.nodes.len() + 8, Node::root());
                first
            }
        };
        let depth = self.node(node).depth + 1;
        for octant in 0..8 {
            let cell = self.node(node).octant(octant);
            let child = self.node_mut(first + octant);
            debug_assert!(child.held.is_empty(), "vacant nodes are empty");
            (child.depth, child.cell, child.parent, child.first_child, child.count) = (depth, cell, node, NONE, 0);
        }
        self.node_mut(node).first_child = first;
        self.stats.node_visits += 8;
        self.stats.nodes_made += 8;
        for at in (0..self.node(node).held.len()).rev() {
            let entry = self.node(node).held[at];
            let place = self.entries[entry as usize].place;
            if place.level < depth {
                continue;
            }
            self.dissociate(node, entry);
            for child in first..first + 8 {
                if self.grid.touches(self.node(child), &place) {
                    self.associate(child, entry);
                    self.node_mut(child).count += u32::from(place.level > depth);
                }
            }
        }
        for child in first..first + 8 {
            if self.grid.splits(self.node(child)) {
                self.split(child);
            }
        }
    }

    /// Takes a node's children away; the node holds what they held. They count no more than the node, so they are leaves.
    pub(super) fn collapse(&mut self, node: u32) {
        let children = self.node(node).children();
        self.stats.node_visits += 8;
        self.stats.nodes_deleted += 8;
        self.free_blocks.push(children.start);
        self.node_mut(node).first_child = NONE;
        for child in children {
            debug_assert!(self.node(child).is_leaf(), "only leaves are taken away");
            while let Some(&entry) = self.node(child).held.last() {
                self.dissociate(child, entry);
                if !self.holds(node, entry) {
                    self.associate(node, entry);
                }
            }
        }
    }
}
