use std::collections::{BTreeMap, BTreeSet};

use glam::DVec3;
use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use super::*;

type Path = (u32, [u32; 3]);

impl SplitOctree {
    /// Everything, not only what one mutation may have broken.
    fn assert_well_formed(&self) {
        let mut references = 0;
        for at in self.walk() {
            let node = self.node(at);
            references += node.held.len();
            self.check_split(at);
            for (slot, &entry) in (0..).zip(&node.held) {
                let known = &self.entries[entry as usize].references;
                assert!(known.contains(&Reference { node: at, slot }), "a held entry points to its node");
            }
            let below = node.children().map(|child| self.node(child));
            below.for_each(|child| assert_eq!((child.parent, child.depth), (at, node.depth + 1)));
            // What the count counts, found by asking every entry.
            let counts = |entry: &Entry| entry.place.level > node.depth && self.grid.touches(node, &entry.place);
            let live = self.slots.values().map(|&slot| &self.entries[slot as usize]);
            assert_eq!(live.filter(|entry| counts(entry)).count(), node.count as usize, "counts are true");
        }
        let known: usize = self.slots.values().map(|&slot| self.entries[slot as usize].references.len()).sum();
        assert_eq!(references, known, "no node holds what is gone");
        assert_eq!(self.walk().count(), self.node_count());
        assert_eq!(self.entries.len(), self.slots.len() + self.free_entries.len());
        self.slots.keys().for_each(|&key| self.check(key));
    }

    fn paths(&self) -> BTreeSet<Path> {
        self.walk().map(|node| (self.node(node).depth, self.node(node).cell)).collect()
    }

    /// The same contents in a tree without a past.
    fn rebuilt(&self) -> SplitOctree {
        let mut tree = SplitOctree { nodes: vec![Node::root()], ..SplitOctree::new(Aabb::EMPTY, self.rules) };
        tree.grid = self.grid;
        let mut keys: Vec<(&u32, &u32)> = self.slots.iter().collect();
        keys.sort_unstable();
        keys.iter().for_each(|&(&key, &slot)| tree.insert(key, self.entries[slot as usize].bound));
        self.unbounded.iter().for_each(|&key| tree.insert(key, Bound::Everywhere));
        tree
    }
}

fn world() -> Aabb {
    Aabb::around(DVec3::new(0.5, 0.0, 0.0), DVec3::splat(64.0))
}

fn bound() -> impl Strategy<Value = Bound> {
    // On borders of cells, within one corner, anywhere, outside, and nowhere.
    let near = || 10f64..11.0;
    let coordinate = || {
        prop_oneof![
            (-64i8..64).prop_map(|i| 0.5 + f64::from(i) * 1.01),
            near(),
            near(),
            -64f64..64.0,
            -64f64..64.0,
            -1e9f64..1e9,
            Just(f64::NAN)
        ]
    };
    let point = (coordinate(), coordinate(), coordinate()).prop_map(DVec3::from);
    let close = (near(), near(), near()).prop_map(DVec3::from);
    let point = prop_oneof![close, point];
    let size = || prop_oneof![Just(0.0), 0f64..0.1, 0f64..2.0, 0f64..2.0, 0f64..60.0, Just(-1.0)];
    prop_oneof![
        4 => (point.clone(), size(), size(), size())
            .prop_map(|(centre, x, y, z)| Bound::Box(Aabb::around(centre, DVec3::new(x, y, z)))),
        2 => (point, size()).prop_map(|(centre, radius)| Bound::Sphere { centre, radius }),
        1 => Just(Bound::Everywhere),
    ]
}

/// A new place, a step from the old one (if there is one), or removal.
#[derive(Clone, Copy, Debug)]
enum Step {
    Insert(Bound),
    Shift(DVec3),
    Remove,
}

fn step() -> impl Strategy<Value = (u32, Step)> {
    let shift = prop_oneof![-0.3f64..0.3, -3f64..3.0];
    let step = prop_oneof![
        3 => bound().prop_map(Step::Insert),
        3 => (shift, 0usize..3).prop_map(|(by, axis)| Step::Shift(DVec3::AXES[axis] * by)),
        1 => Just(Step::Remove),
    ];
    (0u32..24, step)
}

fn shifted(bound: Bound, by: DVec3) -> Bound {
    match bound {
        Bound::Box(aabb) => Bound::Box(Aabb::new(aabb.min + by, aabb.max + by)),
        Bound::Sphere { centre, radius } => Bound::Sphere { centre: centre + by, radius },
        other => other,
    }
}

fn rules() -> impl Strategy<Value = SplitRules> {
    let references = prop_oneof![Just(References::Single), Just(References::Multiple)];
    let update = prop_oneof![Just(Update::UnderLca), Just(Update::Whole)];
    (0usize..5, 0u32..8, references, update).prop_map(|(primitives_max, depth_max, references, update)| SplitRules {
        primitives_max,
        depth_max,
        references,
        update,
    })
}

/// Hides what lies in any of some half-spaces `normal · p ≥ offset`.
struct Walls(Vec<(DVec3, f64)>);

impl Occlusion for Walls {
    fn hides(&self, bound: &Bound) -> bool {
        let Some(aabb) = bound.aabb() else { return false };
        self.0.iter().any(|&(normal, offset)| aabb.corners().iter().all(|corner| normal.dot(*corner) >= offset))
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    #[test]
    fn the_tree_equals_one_built_anew_and_no_node_is_deleted_and_made_again(
        rules in rules(), steps in prop::collection::vec(step(), 0..60)
    ) {
        let mut tree = SplitOctree::new(world(), rules);
        let mut list: BTreeMap<u32, Bound> = BTreeMap::new();
        for (key, step) in steps {
            let before = tree.paths();
            tree.reset_stats();
            let bound = match step {
                Step::Insert(bound) => Some(bound),
                Step::Shift(by) => list.get(&key).map(|old| shifted(*old, by)),
                Step::Remove => None,
            };
            match bound {
                Some(bound) => {
                    tree.insert(key, bound);
                    list.insert(key, bound);
                }
                None => prop_assert_eq!(tree.remove(key), list.remove(&key).is_some()),
            }
            tree.assert_well_formed();
            prop_assert_eq!(tree.len(), list.len());
            prop_assert!(tree.same_structure(&tree.rebuilt()));
            if rules.update == Update::UnderLca {
                // A path that was deleted and made in one update would be in neither difference, but counted twice.
                let after = tree.paths();
                let SplitStats { nodes_made, nodes_deleted, .. } = tree.stats();
                prop_assert_eq!(nodes_made, after.difference(&before).count() as u64);
                prop_assert_eq!(nodes_deleted, before.difference(&after).count() as u64);
            }
        }
        for key in list.keys() {
            tree.remove(*key);
        }
        tree.assert_well_formed();
        prop_assert_eq!((tree.len(), tree.node_count(), tree.reference_count()), (0, 1, 0));
    }

    #[test]
    fn a_walk_exposes_what_a_list_does(
        rules in rules(), bounds in prop::collection::vec(bound(), 1..60), west in -60f64..60.0, up in -60f64..60.0
    ) {
        let mut tree = SplitOctree::new(world(), rules);
        (0..).zip(&bounds).for_each(|(key, bound)| tree.insert(key, *bound));
        let mut exposed = vec![7];
        tree.exposed(&Walls(vec![(DVec3::X, west)]), &mut exposed);
        let wall = Walls(vec![(DVec3::X, west)]);
        let hidden = |bound: &Bound| bound.outer_box().is_some() && wall.hides(bound);
        let expected: Vec<u32> = (0..).zip(&bounds).filter(|(_, bound)| !hidden(bound)).map(|(key, _)| key).collect();
        prop_assert_eq!(&exposed[1..], expected);

        // Behind two walls, parts of a bound may be hidden that are not hidden as one. Then all of it must be hidden.
        let walls = Walls(vec![(DVec3::X, west), (DVec3::Y, up)]);
        let mut exposed = Vec::new();
        tree.exposed(&walls, &mut exposed);
        prop_assert!(exposed.is_sorted_by(|a, b| a < b));
        for (key, bound) in (0..).zip(&bounds) {
            let Some(aabb) = bound.outer_box() else { continue };
            let listed = exposed.binary_search(&key).is_ok();
            prop_assert!(!(listed && walls.hides(bound)));
            let corners_hidden = aabb.corners().iter().all(|corner| corner.x >= west || corner.y >= up);
            prop_assert!(listed || corners_hidden);
        }
    }
}

fn rules_of(references: References, update: Update) -> SplitRules {
    SplitRules { primitives_max: 4, depth_max: 12, references, update }
}

#[test]
fn both_updates_make_the_same_tree_and_the_ancestor_is_nearer_than_the_root() {
    for references in [References::Single, References::Multiple] {
        let mut rng = Pcg64::seed_from_u64(5);
        let [mut under, mut whole] =
            [Update::UnderLca, Update::Whole].map(|update| SplitOctree::new(world(), rules_of(references, update)));
        let mut centres: Vec<DVec3> =
            (0..600).map(|_| DVec3::from_array(std::array::from_fn(|_| rng.random_range(-60.0..60.0)))).collect();
        let cube = |centre: DVec3| Bound::Box(Aabb::around(centre, DVec3::splat(0.2)));
        for (key, centre) in (0..).zip(&centres) {
            under.insert(key, cube(*centre));
            whole.insert(key, cube(*centre));
        }
        under.reset_stats();
        whole.reset_stats();
        for step in 0..3_000 {
            let key = step % 20;
            centres[key] += DVec3::new(rng.random_range(-0.2..0.2), 0.0, rng.random_range(-0.2..0.2));
            under.insert(key as u32, cube(centres[key]));
            whole.insert(key as u32, cube(centres[key]));
        }
        assert!(under.same_structure(&whole));
        let (under, whole) = (under.stats(), whole.stats());
        assert!(under.node_visits * 2 < whole.node_visits, "{references:?}: {under:?} {whole:?}");
        assert!(under.nodes_deleted <= whole.nodes_deleted && under.nodes_deleted > 0);
    }
}

#[test]
fn a_step_to_the_next_octant_keeps_the_ancestor_split() {
    for references in [References::Single, References::Multiple] {
        // Five, so that the root is split only as long as all are there.
        let trees = [Update::UnderLca, Update::Whole].map(|update| {
            let mut tree = SplitOctree::new(Aabb::around(DVec3::ZERO, DVec3::splat(8.0)), rules_of(references, update));
            for key in 0..4 {
                let centre = DVec3::new(-4.0, 4.0, 8.0 * f64::from(key % 2) - 4.0);
                tree.insert(key, Bound::Sphere { centre, radius: 0.01 });
            }
            tree.insert(4, Bound::Sphere { centre: DVec3::new(-0.1, 1.0, 1.0), radius: 0.01 });
            tree.reset_stats();
            tree.insert(4, Bound::Sphere { centre: DVec3::new(0.1, 1.0, 1.0), radius: 0.01 });
            tree
        });
        let [under, whole] = trees.each_ref().map(SplitOctree::stats);
        assert!(trees[0].same_structure(&trees[1]));
        assert_eq!((under.nodes_made, under.nodes_deleted), (0, 0), "{references:?}");
        assert!(whole.nodes_made > 0 && whole.nodes_deleted == whole.nodes_made, "{references:?}: {whole:?}");
        assert!(trees[0].update_visits() > under.node_visits, "a reset does not forget visits");
        trees[0].assert_well_formed();
    }
}

#[test]
fn hidden_places_are_not_entered() {
    for references in [References::Single, References::Multiple] {
        let mut rng = Pcg64::seed_from_u64(9);
        let mut tree = SplitOctree::new(world(), rules_of(references, Update::UnderLca));
        for key in 0..20_000 {
            let centre = DVec3::from_array(std::array::from_fn(|_| rng.random_range(-60.0..60.0)));
            tree.insert(key, Bound::Sphere { centre, radius: 0.1 });
        }
        let mut exposed = Vec::new();
        let work = tree.exposed(&Walls(vec![(DVec3::X, -59.0)]), &mut exposed);
        assert!(exposed.len() > 50, "{}", exposed.len());
        assert!(work < 3_000, "{references:?}: {work} for {} of 20000", exposed.len());
    }
}

#[test]
fn worlds_and_rules_that_make_little_sense_still_work() {
    let infinite = Aabb::new(DVec3::NEG_INFINITY, DVec3::INFINITY);
    let huge = Aabb::around(DVec3::ZERO, DVec3::splat(1e300));
    let point = Aabb::around(DVec3::splat(3.0), DVec3::ZERO);
    for world in [Aabb::EMPTY, infinite, huge, point, Aabb::around(DVec3::NAN, DVec3::ONE)] {
        for (primitives_max, depth_max) in [(0, u32::MAX), (usize::MAX, 5), (3, 0)] {
            for references in [References::Single, References::Multiple] {
                let rules = SplitRules { primitives_max, depth_max, references, update: Update::UnderLca };
                let mut tree = SplitOctree::new(world, rules);
                for key in 0..30 {
                    let centre = DVec3::splat(f64::from(key) * 0.1);
                    tree.insert(key, Bound::Box(Aabb::around(centre, DVec3::splat(0.01))));
                    tree.insert(key + 30, Bound::Sphere { centre: centre + 1e6, radius: 0.1 });
                }
                tree.insert(3, Bound::Sphere { centre: DVec3::NAN, radius: 1.0 });
                tree.assert_well_formed();
                let mut exposed = Vec::new();
                tree.exposed(&Walls(vec![(DVec3::X, 1e5)]), &mut exposed);
                assert_eq!(exposed, (0..30).collect::<Vec<u32>>());
            }
        }
    }
}
