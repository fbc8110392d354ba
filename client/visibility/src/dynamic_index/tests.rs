use std::cell::Cell;
use std::collections::BTreeMap;

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
                assert_eq!(self.places.get(entry.key), Some(&Place { node: at, slot: slot as u32 }));
                assert!(at == ROOT || node.suits(&entry.aabb), "a bound lives where it fits");
                let loose = Aabb::around(node.centre, DVec3::splat(node.half * LOOSENESS));
                assert!(at == ROOT || loose.contains_box(&entry.aabb), "a node is no larger than it may be");
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
        (point(), size(), size()).prop_map(|(centre, radius, half_height)| Bound::Upright {
            centre,
            radius,
            half_height
        }),
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
        let hidden = |bound: &Bound| bound.outer_box().is_some() && occlusion.hides(bound);
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
    // Steps of a third of a radius seldom leave the node, but change how far it reaches, and so those above it, more often
    // than their boxes: fifteen or so a step, up and down eleven levels.
    assert!((1_000..16_000).contains(&(octree.update_visits() - visits)), "{}", octree.update_visits() - visits);
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

#[test]
fn a_ball_around_a_box_far_from_the_origin_holds_its_corners() {
    for far in [0.0, 1e5, 1e9] {
        for step in 0..1_000 {
            let at = DVec3::new(far + f64::from(step) * 0.013, 1.0, -far);
            let aabb = Aabb::new(at, at + DVec3::new(0.011, 0.3, 0.007));
            let point = DVec3::new(far + 0.5, 0.5, -far);
            let reach = reach_from(point, &Bound::Box(aabb));
            let farthest = aabb.corners().iter().map(|corner| corner.distance(point)).fold(0.0, f64::max);
            assert!(reach >= farthest && reach < farthest * 1.001, "{aabb:?}: {reach} for {farthest}");
        }
    }
}

#[test]
fn a_ball_shrinks_with_what_reached_farthest_into_it_from_inside_the_box() {
    let mut octree = DynamicOctree::new(Aabb::around(DVec3::ZERO, DVec3::splat(64.0)));
    // Three rods that the box is due to, and a cube whose corners reach past their ends.
    for (key, half) in [(0, DVec3::X), (1, DVec3::Y), (2, DVec3::Z)] {
        octree.insert(key, Bound::Box(Aabb::around(DVec3::splat(0.3), half * 3.0 + 0.1)));
    }
    octree.insert(3, Bound::Box(Aabb::around(DVec3::splat(0.3), DVec3::splat(2.5))));
    let node_of = |key| octree.places.get(key).map(|place| place.node);
    assert!((0..4).all(|key| node_of(key).is_some() && node_of(key) == node_of(0)), "all in one node");
    octree.assert_well_formed();
    octree.remove(3);
    octree.assert_well_formed();
}

#[test]
fn a_ball_holds_every_kind_of_bound() {
    let point = DVec3::new(0.5, -1.0, 2.0);
    let centre = DVec3::new(4.0, 3.0, 2.0);
    for (bound, reach) in [
        (Bound::Sphere { centre, radius: 2.0 }, centre.distance(point) + 2.0),
        (Bound::Upright { centre, radius: 3.0, half_height: 4.0 }, centre.distance(point) + 5.0),
        (Bound::Box(Aabb::around(centre, DVec3::ONE)), (centre + 1.0 - point).abs().max(point - centre + 1.0).length()),
    ] {
        let found = reach_from(point, &bound);
        assert!((reach..reach * 1.000_001).contains(&found), "{bound:?}: {found}, not {reach}");
    }
}
