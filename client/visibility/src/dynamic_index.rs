//! Which moving bounds may be seen, without touching those in hidden places.
//!
//! The dynamic half of Sudarsky & Gotsman's structure T (1999, §4): an octree in which a bound lives in the smallest
//! node that contains it, inner nodes included, so that each bound has a single reference. A bound that moves climbs from
//! its old node to the least ancestor that contains its new place (Fig. 9), and nothing above notices. Nodes are loose,
//! much wider than their cells: a small bound on the border of two large cells need not live in the root.
//!
//! Each node keeps the box of what is really below it and a ball around the same, which the occlusion is asked about.

use std::collections::{BTreeMap, BTreeSet};

use glam::DVec3;

use crate::{Aabb, Bound, DynamicIndex, Occlusion};

/// An octree of moving bounds.
#[derive(Clone, Debug)]
pub struct DynamicOctree {
    /// Node 0 is the root; `free` ones are vacant.
    nodes: Vec<OctreeNode>,
    free: Vec<u32>,
    /// Where each bounded key is. Agrees with the nodes' `bounds`.
    places: BTreeMap<u32, Place>,
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
    slot: usize,
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
            places: BTreeMap::new(),
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
        let slot = bounds.len() - 1;
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
        let taken = bounds.swap_remove(place.slot);
        if let Some(moved) = bounds.get(place.slot).map(|entry| entry.key) {
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
        if occlusion.hides(&Bound::Box(node.around)) {
            return (true, 1);
        }
        let ball = Bound::Sphere { centre: node.centre, radius: node.reach };
        // Where it sticks out of the box on every side, the box has said it all.
        let helps = node.reach < 0.5 * node.around.size().length();
        (helps && occlusion.hides(&ball), 1 + usize::from(helps))
    }

    /// Checks the key and the nodes above it, in debug builds. The whole tree would make every mutation linear.
    fn debug_check(&self, key: u32) {
        if !cfg!(debug_assertions) {
            return;
        }
        let Some(place) = self.places.get(&key) else { return };
        let node = self.node(place.node);
        assert_eq!(node.bounds[place.slot].key, key, "a key is where its place says");
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
        let old = self.places.get(&key).copied();
        match outer_box(&bound) {
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
        match self.places.remove(&key) {
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

/// The box with each face one step of rounding farther out.
fn outward(Aabb { min, max }: Aabb) -> Aabb {
    let down = DVec3::new(min.x.next_down(), min.y.next_down(), min.z.next_down());
    let up = DVec3::new(max.x.next_up(), max.y.next_up(), max.z.next_up());
    Aabb::new(down, up)
}

/// How far a bound reaches from a point. Only of bounds that [`outer_box`] has a box for.
fn reach_from(point: DVec3, bound: &Bound) -> f64 {
    round_up(match *bound {
        Bound::Sphere { centre, radius } => point.distance(centre) + radius,
        Bound::Upright { centre, radius, half_height } => point.distance(centre) + radius.hypot(half_height),
        Bound::Box(aabb) => (aabb.centre() - point).abs().length() + 0.5 * aabb.size().length(),
        Bound::Everywhere => f64::INFINITY,
    })
}

/// A little more than the rounding of a few sums and a root can take away.
fn round_up(reach: f64) -> f64 {
    reach * (1.0 + 1e-12)
}

/// A box that contains the bound, rounding included; `None` if nothing finite does or the bound makes no sense.
pub(crate) fn outer_box(bound: &Bound) -> Option<Aabb> {
    let aabb = match *bound {
        Bound::Sphere { centre, radius } if radius >= 0.0 => outward(Aabb::around(centre, DVec3::splat(radius))),
        Bound::Upright { centre, radius, half_height } if radius >= 0.0 && half_height >= 0.0 => {
            outward(Aabb::around(centre, DVec3::new(radius, half_height, radius)))
        }
        Bound::Box(aabb) => aabb,
        Bound::Sphere { .. } | Bound::Upright { .. } | Bound::Everywhere => return None,
    };
    // The centre of a box near the greatest number would be infinite.
    let sane = aabb.min.is_finite() && aabb.max.is_finite() && aabb.centre().is_finite() && !aabb.is_empty();
    sane.then_some(aabb)
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;

    use proptest::prelude::*;

    use super::*;

    impl DynamicOctree {
        fn assert_well_formed(&self) {
            let (mut nodes, mut bounds) = (0, 0);
            let mut stack = vec![ROOT];
            while let Some(at) = stack.pop() {
                let node = self.node(at);
                nodes += 1;
                bounds += node.bounds.len();
                assert_eq!((node.around, node.reach), self.tight(at), "boxes and balls are tight");
                assert!(at == ROOT || !node.is_vacant(), "empty nodes are freed");
                for (slot, entry) in node.bounds.iter().enumerate() {
                    assert_eq!(self.places[&entry.key], Place { node: at, slot });
                    assert!(at == ROOT || node.suits(&entry.aabb), "a bound lives where it fits");
                    let child = node.child(node.octant(entry.aabb.centre()), at);
                    let smaller = child.suits(&entry.aabb) && child.half >= self.half_min;
                    assert!(!smaller, "a bound lives in the smallest node");
                }
                for child in node.present() {
                    assert_eq!(self.node(child).parent, at);
                    stack.push(child);
                }
                self.node(at).bounds.iter().for_each(|entry| self.debug_check(entry.key));
            }
            assert_eq!(nodes, self.node_count());
            assert_eq!(bounds, self.places.len());
        }
    }

    /// Hides what lies in any of some half-spaces `normal · p ≥ offset`, and nothing unbounded.
    struct Walls {
        walls: Vec<(DVec3, f64)>,
        asked: Cell<usize>,
    }

    impl Walls {
        fn new(walls: Vec<(DVec3, f64)>) -> Walls {
            Walls { walls, asked: Cell::new(0) }
        }
    }

    impl Occlusion for Walls {
        fn hides(&self, bound: &Bound) -> bool {
            self.asked.set(self.asked.get() + 1);
            let Some(aabb) = bound.aabb() else { return false };
            assert!(aabb.min.is_finite() && aabb.max.is_finite(), "only finite bounds are asked about");
            self.walls.iter().any(|&(normal, offset)| match *bound {
                Bound::Sphere { centre, radius } => normal.dot(centre) - radius * normal.length() >= offset,
                _ => aabb.corners().iter().all(|corner| normal.dot(*corner) >= offset),
            })
        }
    }

    fn point() -> impl Strategy<Value = DVec3> {
        // On the grid of cell borders, anywhere, and outside the world.
        let coordinate =
            || prop_oneof![(-70i8..70).prop_map(f64::from), -64f64..64.0, -64f64..64.0, -1e9f64..1e9, Just(f64::NAN)];
        (coordinate(), coordinate(), coordinate()).prop_map(DVec3::from)
    }

    fn size() -> impl Strategy<Value = f64> {
        prop_oneof![Just(0.0), 0f64..3.0, 0f64..3.0, 0f64..200.0, Just(f64::INFINITY), Just(-1.0)]
    }

    fn bound() -> impl Strategy<Value = Bound> {
        prop_oneof![
            (point(), size()).prop_map(|(centre, radius)| Bound::Sphere { centre, radius }),
            (point(), size(), size(), size())
                .prop_map(|(centre, x, y, z)| Bound::Box(Aabb::around(centre, DVec3::new(x, y, z)))),
            Just(Bound::Everywhere),
        ]
    }

    fn step() -> impl Strategy<Value = (u32, Option<Bound>)> {
        (0u32..40, prop::option::weighted(0.8, bound()))
    }

    fn wall() -> impl Strategy<Value = (DVec3, f64)> {
        let axis = prop_oneof![Just(DVec3::X), Just(DVec3::NEG_X), Just(DVec3::Z), Just(DVec3::new(1.0, -1.0, 0.5))];
        (axis, -60f64..60.0)
    }

    proptest! {
        #[test]
        fn octree_exposes_what_a_list_does(
            steps in prop::collection::vec(step(), 0..120), walls in prop::collection::vec(wall(), 0..3)
        ) {
            let mut octree = DynamicOctree::new(Aabb::around(DVec3::new(0.3, 0.0, 0.0), DVec3::splat(64.0)));
            let mut list: BTreeMap<u32, Bound> = BTreeMap::new();
            for (key, bound) in steps {
                match bound {
                    Some(bound) => {
                        octree.insert(key, bound);
                        list.insert(key, bound);
                    }
                    None => prop_assert_eq!(octree.remove(key), list.remove(&key).is_some()),
                }
                octree.assert_well_formed();
                prop_assert_eq!(octree.len(), list.len());
            }
            let occlusion = Walls::new(walls);
            let hidden = |bound: &Bound| outer_box(bound).is_some() && occlusion.hides(bound);
            let expected: Vec<u32> = list.iter().filter(|(_, bound)| !hidden(bound)).map(|(key, _)| *key).collect();
            let mut exposed = vec![7];
            octree.exposed(&occlusion, &mut exposed);
            prop_assert_eq!(&exposed[1..], expected);
            for key in list.keys() {
                octree.remove(*key);
            }
            octree.assert_well_formed();
            prop_assert_eq!((octree.len(), octree.node_count()), (0, 1));
        }

        #[test]
        fn order_of_updates_leaves_no_trace(bounds in prop::collection::vec(bound(), 1..40)) {
            let world = Aabb::around(DVec3::ZERO, DVec3::splat(64.0));
            let keyed: Vec<(u32, Bound)> = (0..).zip(bounds).collect();
            let (mut forward, mut backward) = (DynamicOctree::new(world), DynamicOctree::new(world));
            for &(key, bound) in &keyed {
                forward.insert(key, bound);
            }
            for &(key, bound) in keyed.iter().rev() {
                backward.insert(key, keyed[0].1);
                backward.insert(key, bound);
            }
            let occlusion = Walls::new(vec![(DVec3::X, 10.0)]);
            let (mut first, mut second) = (Vec::new(), Vec::new());
            let work = forward.exposed(&occlusion, &mut first);
            prop_assert_eq!(backward.exposed(&occlusion, &mut second), work);
            prop_assert_eq!(first, second);
            prop_assert_eq!(forward.node_count(), backward.node_count());
        }
    }

    fn crowd(count: u32, west: f64) -> DynamicOctree {
        let mut octree = DynamicOctree::new(Aabb::around(DVec3::ZERO, DVec3::splat(512.0)));
        for key in 0..count {
            // Scattered by multiples of the golden ratio, the same in every run.
            let [x, z] = [0.618_033_988_75, 0.754_877_666_25].map(|share| (f64::from(key) * share).fract() * 400.0);
            octree.insert(key, Bound::Sphere { centre: DVec3::new(x + west, 1.0, z - 200.0), radius: 1.0 });
        }
        octree
    }

    #[test]
    fn hidden_crowd_costs_nothing() {
        let occlusion = Walls::new(vec![(DVec3::X, 5.0)]);
        for count in [10, 1_000, 20_000] {
            let (mut octree, mut exposed) = (crowd(count, 10.0), Vec::new());
            assert_eq!(octree.exposed(&occlusion, &mut exposed), 1, "one look at the root");
            assert!(exposed.is_empty());

            // One that may be seen costs its own path only.
            octree.insert(u32::MAX, Bound::Sphere { centre: DVec3::new(-100.0, 1.0, 0.0), radius: 1.0 });
            let work = octree.exposed(&occlusion, &mut exposed);
            assert_eq!(exposed, [u32::MAX]);
            assert!(work < 40, "{work} for one among {count}");
        }
    }

    #[test]
    fn work_grows_with_the_border_of_what_is_hidden() {
        // A wall through the crowd: a fifth of it may be seen.
        let occlusion = Walls::new(vec![(DVec3::X, 0.0)]);
        let (octree, mut exposed) = (crowd(20_000, -80.0), Vec::new());
        let work = octree.exposed(&occlusion, &mut exposed);
        assert!((4_000..4_200).contains(&exposed.len()), "{}", exposed.len());
        assert!(work < 4 * exposed.len(), "{work} for {} exposed of 20000", exposed.len());
        assert!(occlusion.asked.get() <= work);
    }

    #[test]
    fn step_to_a_neighbour_leaves_the_rest_alone() {
        let mut octree = crowd(1_000, 0.0);
        let (nodes, visits) = (octree.node_count(), octree.update_visits());
        for step in 0..1_000 {
            let centre = DVec3::new(f64::from(step) * 0.3, 1.0, 20.0);
            octree.insert(5_000, Bound::Sphere { centre, radius: 1.0 });
        }
        octree.assert_well_formed();
        // Steps of a third of a radius seldom leave the node: five or so a step, of eleven levels.
        assert!((1_000..8_000).contains(&(octree.update_visits() - visits)), "{}", octree.update_visits() - visits);
        octree.remove(5_000);
        octree.assert_well_formed();
        assert_eq!(octree.node_count(), nodes);
    }

    #[test]
    fn worlds_without_a_sensible_box_still_work() {
        let infinite = Aabb::new(DVec3::NEG_INFINITY, DVec3::INFINITY);
        let huge = Aabb::around(DVec3::ZERO, DVec3::splat(1e300));
        let point = Aabb::around(DVec3::splat(3.0), DVec3::ZERO);
        let far = Aabb::around(DVec3::splat(1e6), DVec3::splat(1.0));
        for world in [Aabb::EMPTY, infinite, huge, point, far, Aabb::around(DVec3::NAN, DVec3::ONE)] {
            let mut octree = DynamicOctree::new(world);
            for key in 0..50 {
                let centre = DVec3::splat(f64::from(key) * 0.1);
                octree.insert(key, Bound::Box(Aabb::around(centre, DVec3::splat(0.01))));
                octree.insert(key + 50, Bound::Sphere { centre: centre + 1e6, radius: 0.1 });
            }
            octree.assert_well_formed();
            let mut exposed = Vec::new();
            octree.exposed(&Walls::new(vec![(DVec3::X, 1e5)]), &mut exposed);
            assert_eq!(exposed, (0..50).collect::<Vec<u32>>());
        }
    }
}
