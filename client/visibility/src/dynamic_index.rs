//! Which moving bounds may be seen, without touching those in hidden places.
//!
//! The dynamic half of Sudarsky & Gotsman's structure T (1999, §4): an octree in which a bound lives in the smallest
//! node that contains it, inner nodes included, so that each bound has a single reference. A bound that moves climbs from
//! its old node to the least ancestor that contains its new place (Fig. 9), and nothing above notices. Nodes are loose,
//! much wider than their cells: a small bound on the border of two large cells need not live in the root.
//!
//! Each node keeps the box of what is really below it and a ball around the same, which the occlusion is asked about.

use std::collections::BTreeSet;

use glam::DVec3;

use crate::{Aabb, Bound, DynamicIndex, IdMap, Occlusion};

/// An octree of moving bounds.
#[derive(Clone, Debug)]
pub struct DynamicOctree {
    /// Node 0 is the root; `free` ones are vacant.
    nodes: Vec<OctreeNode>,
    free: Vec<u32>,
    /// Where each bounded key is. Agrees with the nodes' `bounds`.
    places: IdMap<Place>,
    /// Keys that may be anywhere, and so are always exposed. Disjoint from `places`.
    unbounded: BTreeSet<u32>,
    /// Half the side of the smallest cells.
    half_min: f64,
    /// Nodes looked at by updates.
    visits: u64,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Place {
    node: u32,
    slot: u32,
}

#[derive(Clone, Debug)]
struct OctreeNode {
    centre: DVec3,
    /// Half the side of the cell. A power of two, so that cells share their borders exactly.
    half: f64,
    /// The root is its own.
    parent: u32,
    /// By octant, x fastest; `NONE` if nothing lives there.
    children: [u32; 8],
    bounds: Vec<Entry>,
    /// The least box around all bounds here and below; empty only in an empty root.
    around: Aabb,
    /// Radius of a ball around `centre` that holds them too; negative where there are none. The bounds of what moves are
    /// mostly balls, and the corners of a box around large ones reach into sight long before they do.
    reach: f64,
}

#[derive(Clone, Copy, Debug)]
struct Entry {
    key: u32,
    bound: Bound,
    aabb: Aabb,
}

const ROOT: u32 = 0;
const NONE: u32 = u32::MAX;
/// Smallest cell side in metres, unless the world is small: about the size of a person, whose bounds are hardly smaller.
const CELL_MIN: f64 = 1.0;
/// How many times wider than their cells nodes are. A bound that has grown for long is large, and what hides it hides little
/// more: nodes that are much smaller than their bounds hold neighbours only, which are hidden together.
const LOOSENESS: f64 = 8.0;
/// Levels below the root, whatever the world's size: few enough for cells to share their borders exactly in f64.
const LEVELS: [i32; 2] = [6, 24];

impl DynamicOctree {
    /// An empty index for a world of about this box. Bounds outside it are legal, but all live in the root.
    pub fn new(world: Aabb) -> DynamicOctree {
        let reach = world.size().max_element() * 0.5;
        let known = !world.is_empty() && world.min.is_finite() && world.max.is_finite() && reach.is_finite();
        let (centre, reach) = if known { (world.centre(), reach.max(1e-3)) } else { (DVec3::ZERO, 1024.0) };
        // A grid of 2⁻¹⁰ of the root moves its centre by less than the 1 % added here.
        let half = (reach * 1.01).log2().ceil().exp2();
        let grid = half / 1024.0;
        let centre = (centre / grid).round() * grid;
        let [most, least] = LEVELS.map(|levels| half * f64::from(-levels).exp2());
        let half_min = (CELL_MIN * 0.5).clamp(least, most);
        let root = OctreeNode::new(centre, half, ROOT);
        DynamicOctree {
            nodes: vec![root],
            free: Vec::new(),
            places: IdMap::default(),
            unbounded: BTreeSet::new(),
            half_min,
            visits: 0,
        }
    }

    /// Nodes in use, the root included.
    pub fn node_count(&self) -> usize {
        self.nodes.len() - self.free.len()
    }

    fn node(&self, node: u32) -> &OctreeNode {
        &self.nodes[node as usize]
    }

    fn node_mut(&mut self, node: u32) -> &mut OctreeNode {
        &mut self.nodes[node as usize]
    }

    /// The smallest node for `aabb`, made if need be; `start` is any node.
    fn home(&mut self, start: u32, aabb: &Aabb) -> u32 {
        let mut at = start;
        self.visits += 1;
        while at != ROOT && !self.node(at).suits(aabb) {
            at = self.node(at).parent;
            self.visits += 1;
        }
        // Outside the root's cell, octants mean nothing.
        if at == ROOT && !self.node(ROOT).suits(aabb) {
            return ROOT;
        }
        loop {
            let node = self.node(at);
            if node.half * 0.5 < self.half_min {
                return at;
            }
            let octant = node.octant(aabb.centre());
            let child = node.child(octant, at);
            if !child.suits(aabb) {
                return at;
            }
            at = match node.children[octant] {
                NONE => {
                    let index = match self.free.pop() {
                        Some(vacant) => {
                            *self.node_mut(vacant) = child;
                            vacant
                        }
                        None => {
                            self.nodes.push(child);
                            (self.nodes.len() - 1) as u32
                        }
                    };
                    self.node_mut(at).children[octant] = index;
                    index
                }
                existing => existing,
            };
            self.visits += 1;
        }
    }

    fn add(&mut self, node: u32, entry: Entry) {
        let bounds = &mut self.node_mut(node).bounds;
        bounds.push(entry);
        let slot = (bounds.len() - 1) as u32;
        self.places.insert(entry.key, Place { node, slot });
        let mut at = node;
        let mut reach = reach_from(self.node(at).centre, &entry.bound);
        // An ancestor that contains both has ancestors that do.
        while !self.node(at).around.contains_box(&entry.aabb) || self.node(at).reach < reach {
            self.visits += 1;
            let node = self.node_mut(at);
            node.around = node.around.union(&entry.aabb);
            node.reach = node.reach.max(reach);
            if at == ROOT {
                break;
            }
            let parent = node.parent;
            reach = self.node(at).reach_in(self.node(parent));
            at = parent;
        }
    }

    /// Takes out what lies at `place`, without its mark in `places`.
    fn take(&mut self, place: Place) {
        let bounds = &mut self.node_mut(place.node).bounds;
        let taken = bounds.swap_remove(place.slot as usize);
        if let Some(moved) = bounds.get(place.slot as usize).map(|entry| entry.key) {
            self.places.insert(moved, place);
        }
        let mut at = place.node;
        let mut reach = reach_from(self.node(at).centre, &taken.bound);
        loop {
            self.visits += 1;
            let node = self.node(at);
            let parent = node.parent;
            // What it counted for above, before it changes.
            let parents_reach = node.reach_in(self.node(parent));
            if at != ROOT && node.is_vacant() {
                let link = self.node_mut(parent).children.iter_mut().find(|child| **child == at);
                *link.expect("a parent knows its child") = NONE;
                self.free.push(at);
            } else if node.around.has_inside(&taken.aabb) && reach < node.reach {
                // Other bounds reach farther on every side, here and so above.
                break;
            } else {
                let (around, reach) = self.tight(at);
                if around == node.around && reach == node.reach {
                    break;
                }
                let node = self.node_mut(at);
                (node.around, node.reach) = (around, reach);
            }
            if at == ROOT {
                break;
            }
            reach = parents_reach;
            at = parent;
        }
    }

    /// The least box around what is in and below a node, and how far it reaches from the node's centre.
    fn tight(&self, node: u32) -> (Aabb, f64) {
        let node = self.node(node);
        let here = node.bounds.iter().map(|entry| (entry.aabb, reach_from(node.centre, &entry.bound)));
        let below = node.present().map(|child| self.node(child)).map(|child| (child.around, child.reach_in(node)));
        here.chain(below).fold((Aabb::EMPTY, -1.0), |(all, most), (aabb, reach)| (all.union(&aabb), most.max(reach)))
    }

    /// Whether all that is in and below a node is hidden, and how many tests that took.
    fn is_hidden(&self, node: &OctreeNode, occlusion: &dyn Occlusion) -> (bool, usize) {
        if occlusion.hides_group(&Bound::Box(node.around)) {
            return (true, 1);
        }
        let ball = Bound::Sphere { centre: node.centre, radius: node.reach };
        // Where it sticks out of the box on every side, the box has said it all.
        let helps = node.reach < 0.5 * node.around.size().length();
        (helps && occlusion.hides_group(&ball), 1 + usize::from(helps))
    }

    /// Checks the key and the nodes above it, in debug builds. The whole tree would make every mutation linear.
    fn debug_check(&self, key: u32) {
        if !cfg!(debug_assertions) {
            return;
        }
        let Some(place) = self.places.get(key) else { return };
        let node = self.node(place.node);
        assert_eq!(node.bounds[place.slot as usize].key, key, "a key is where its place says");
        assert!(!self.unbounded.contains(&key), "a key is bounded or not");
        let mut at = place.node;
        while at != ROOT {
            let node = self.node(at);
            let parent = self.node(node.parent);
            assert!(parent.children.contains(&at), "a parent knows its child");
            assert!(parent.around.contains_box(&node.around), "a node contains its children");
            at = node.parent;
        }
    }
}

impl DynamicIndex for DynamicOctree {
    fn insert(&mut self, key: u32, bound: Bound) {
        let old = self.places.get(key).copied();
        match bound.outer_box() {
            Some(aabb) => {
                self.unbounded.remove(&key);
                let node = self.home(old.map_or(ROOT, |place| place.node), &aabb);
                // Before the old one goes, so that shrinking stops at the least common ancestor.
                self.add(node, Entry { key, bound, aabb });
                if let Some(old) = old {
                    self.take(old);
                }
            }
            None => {
                self.remove(key);
                self.unbounded.insert(key);
            }
        }
        self.debug_check(key);
    }

    fn remove(&mut self, key: u32) -> bool {
        match self.places.remove(key) {
            Some(place) => {
                self.take(place);
                true
            }
            None => self.unbounded.remove(&key),
        }
    }

    fn exposed(&self, occlusion: &dyn Occlusion, exposed: &mut Vec<u32>) -> usize {
        let start = exposed.len();
        exposed.extend(&self.unbounded);
        let mut work = self.unbounded.len();
        let mut stack = vec![ROOT];
        while let Some(at) = stack.pop() {
            work += 1;
            let node = self.node(at);
            // With a single thing below, asking it is asking the node.
            let things = node.bounds.len() + node.present().count();
            if things == 0 {
                continue;
            }
            if things > 1 {
                let (hidden, tests) = self.is_hidden(node, occlusion);
                // The first counts as the visit.
                work += tests - 1;
                if hidden {
                    continue;
                }
            }
            work += node.bounds.len();
            exposed.extend(node.bounds.iter().filter(|entry| !occlusion.hides(&entry.bound)).map(|entry| entry.key));
            stack.extend(node.present());
        }
        exposed[start..].sort_unstable();
        work
    }

    fn len(&self) -> usize {
        self.places.len() + self.unbounded.len()
    }

    fn shrink(&mut self) {
        if self.is_empty() {
            let OctreeNode { centre, half, .. } = *self.node(ROOT);
            (self.nodes, self.free) = (vec![OctreeNode::new(centre, half, ROOT)], Vec::new());
        }
    }

    fn memory_bytes(&self) -> usize {
        // Sets keep their entries in blocks that are two thirds full on average.
        let in_maps = self.places.memory_bytes() + self.unbounded.len() * size_of::<u32>() * 3 / 2;
        let held: usize = self.nodes.iter().map(|node| node.bounds.capacity()).sum();
        self.nodes.capacity() * size_of::<OctreeNode>()
            + held * size_of::<Entry>()
            + self.free.capacity() * size_of::<u32>()
            + in_maps
    }

    fn update_visits(&self) -> u64 {
        self.visits
    }
}

impl OctreeNode {
    fn new(centre: DVec3, half: f64, parent: u32) -> OctreeNode {
        OctreeNode { centre, half, parent, children: [NONE; 8], bounds: Vec::new(), around: Aabb::EMPTY, reach: -1.0 }
    }

    /// Whether the centre lies in the half-open cell and all of the box in the loose one.
    fn suits(&self, aabb: &Aabb) -> bool {
        let (centre, half) = (aabb.centre(), DVec3::splat(self.half));
        let in_cell = centre.cmpge(self.centre - half).all() && centre.cmplt(self.centre + half).all();
        in_cell && Aabb::around(self.centre, half * LOOSENESS).contains_box(aabb)
    }

    fn octant(&self, point: DVec3) -> usize {
        let upper = point.cmpge(self.centre);
        usize::from(upper.x) | usize::from(upper.y) << 1 | usize::from(upper.z) << 2
    }

    /// What the child in that octant would be, this node being `parent`.
    fn child(&self, octant: usize, parent: u32) -> OctreeNode {
        let half = self.half * 0.5;
        let shift = |bit: usize| if octant >> bit & 1 == 0 { -half } else { half };
        OctreeNode::new(self.centre + DVec3::new(shift(0), shift(1), shift(2)), half, parent)
    }

    /// How far from the parent's centre what is in and below this node reaches.
    fn reach_in(&self, parent: &OctreeNode) -> f64 {
        if self.reach < 0.0 { -1.0 } else { round_up(self.centre.distance(parent.centre) + self.reach) }
    }

    fn present(&self) -> impl Iterator<Item = u32> {
        self.children.iter().copied().filter(|&child| child != NONE)
    }

    fn is_vacant(&self) -> bool {
        self.bounds.is_empty() && self.present().next().is_none()
    }
}

impl Aabb {
    /// Whether `other` touches none of this box's faces from within.
    fn has_inside(&self, other: &Aabb) -> bool {
        self.min.cmplt(other.min).all() && other.max.cmplt(self.max).all()
    }
}

/// How far a bound reaches from a point. Only of bounds that [`Bound::outer_box`] has a box for.
fn reach_from(point: DVec3, bound: &Bound) -> f64 {
    round_up(match *bound {
        Bound::Sphere { centre, radius } => point.distance(centre) + radius,
        Bound::Upright { centre, radius, half_height } => point.distance(centre) + radius.hypot(half_height),
        // Its farthest corner. By way of its centre, what that loses in rounding far from the origin would be missing.
        Bound::Box(aabb) => (aabb.max - point).abs().max((point - aabb.min).abs()).length(),
        Bound::Everywhere => f64::INFINITY,
    })
}

/// A little more than the rounding of a few sums and a root can take away.
fn round_up(reach: f64) -> f64 {
    reach * (1.0 + 1e-12)
}

#[cfg(test)]
mod tests;
