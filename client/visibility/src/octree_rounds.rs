//! How does one ask about a hierarchy where each answer takes long? Greene's octree walk in rounds, over any query back end.
//!
//! [`crate::HierarchicalZ`] asks about one node, waits, and goes on, which suits a pyramid in the same memory. On graphics hardware
//! each answer waits for the whole pipeline. So the nodes that are open, nearest first, are asked about so many at a time; of those
//! that are seen leaves are drawn and inner nodes replaced by their children, before the next are asked. Nodes of one round do not
//! hide each other: the larger a round, the fewer answers to wait for and the more is drawn for nothing.

use crate::front_to_back::Leaves;
use crate::{Octree, QueryBackEnd, RoundsTraversal, Scene, Tessellation, Traversal, View};

/// What one worker keeps of such walks from frame to frame.
#[derive(Clone, Debug, Default)]
pub struct OctreeRounds {
    leaves: Leaves,
    /// Nodes not asked about yet, the nearest one last.
    open: Vec<u32>,
}

impl OctreeRounds {
    /// Draws every leaf of `octree` that may be seen from the view's eye into `back_end`, asking about up to `nodes` nodes a round
    /// (at least one). Returns the visible set, ascending, and what it took.
    ///
    /// # Panics
    /// If the octree is another scene's.
    pub fn traverse<B: QueryBackEnd + ?Sized>(
        &mut self,
        scene: &Scene,
        octree: &Octree,
        view: &View,
        nodes: usize,
        back_end: &mut B,
    ) -> (Vec<u32>, RoundsTraversal) {
        assert_eq!(scene.triangles().len(), octree.primitive_total(), "the octree is another scene's");
        back_end.begin_scene(view, &octree.root());
        self.leaves.begin(octree);
        self.open.clear();
        self.open.push(Octree::ROOT);
        let (mut boxes, mut seen) = (Vec::new(), Vec::new());
        let mut rounds = RoundsTraversal::default();
        let done = &mut rounds.traversal;
        while !self.open.is_empty() && !back_end.is_full() {
            let asked = self.open.split_off(self.open.len().saturating_sub(nodes.max(1)));
            boxes.clear();
            boxes.extend(asked.iter().map(|&node| octree.node(node).0));
            done.rounds += 1;
            done.queries += asked.len();
            rounds.queries += back_end.query(&boxes, &mut seen);
            let seen = || asked.iter().zip(&seen).filter(|(_, seen)| **seen).map(|(&node, _)| node);
            seen().for_each(|node| octree.push_children(node, view.eye, &mut self.open));
            // What comes first wins no pixel by that, but is drawn first where drawing stops early.
            for cell in seen().rev().filter_map(|node| octree.node(node).1) {
                done.cells_projected += 1;
                back_end.draw(scene, self.leaves.project(octree, cell));
            }
        }
        done.passes = rounds.queries.passes;
        done.read_back = rounds.queries.read_back;
        done.seen_z_tests = back_end.seen_z_tests();
        rounds.z_tests = back_end.z_tests();
        let culled = self.leaves.finish(Traversal { ..rounds.traversal }, rounds.z_tests);
        rounds.traversal = culled.traversal;
        (culled.visible, rounds)
    }
}

#[cfg(test)]
mod tests {
    use glam::{DVec3, Vec3};

    use super::*;
    use crate::{OctreeRules, PerFragmentHistogram, Resolution, Sides, Triangle, exact_set, wrong_pixels};

    /// Sheets behind each other, of which each but the first is hidden from the front.
    fn sheets() -> Scene {
        let sheet = |z: f32| {
            let at = |i: i32| Vec3::new((i % 2 * 8 - 4) as f32, (i / 2 * 8 - 4) as f32, z);
            let triangle =
                |corners: [i32; 3]| Triangle { corners: corners.map(at), sides: Sides::Both, occludes: true };
            [triangle([0, 1, 2]), triangle([1, 3, 2])]
        };
        Scene::from_triangles((0..40).flat_map(|i| sheet(-1.0 - i as f32 * 0.5)).collect())
    }

    #[test]
    fn rounds_lose_nothing_and_small_ones_draw_less() {
        let scene = sheets();
        let octree = Octree::build(&scene, OctreeRules::default().with_max_triangles_per_leaf(4));
        let mut walk = OctreeRounds::default();
        let mut kept = Vec::new();
        for eye in [DVec3::new(0.1, 0.2, 3.0), DVec3::new(9.0, 1.0, -4.0), DVec3::new(0.0, 0.0, -3.3)] {
            let view = View::level(eye, 0.3, 1.2, Resolution::new(64, 48));
            let (exact, items) = exact_set(&scene, &view);
            for nodes in [0, 1, 8, usize::MAX] {
                let mut back_end = PerFragmentHistogram::new();
                let (visible, rounds) = walk.traverse(&scene, &octree, &view, nodes, &mut back_end);
                assert!(exact.iter().all(|id| visible.binary_search(id).is_ok()), "{eye} {nodes}");
                assert_eq!(wrong_pixels(&scene, &view, &visible, &items), 0);
                assert_eq!(rounds.traversal.triangles_drawn, visible.len());
                kept.push((nodes, visible.len(), rounds.traversal.rounds));
            }
        }
        let sums = |nodes: usize| kept.iter().filter(|row| row.0 == nodes).fold((0, 0), |s, r| (s.0 + r.1, s.1 + r.2));
        // One node at a time is Greene's walk; all at once is the frustum.
        assert_eq!(sums(0), sums(1));
        assert!(sums(1).0 < sums(usize::MAX).0, "{kept:?}");
        assert!(sums(1).1 > 4 * sums(usize::MAX).1, "{kept:?}");
    }
}
