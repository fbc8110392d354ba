//! One frame: the visibility algorithm of the paper's figure 9, with the frustum before it and the details after it.

use super::choose::{direction_of, directions_of};
use super::joint::{Active, Member, hide};
use super::relation::{Relation, Status, is_nearer};
use super::scratch::{Frame, Kept};
use super::{Eye, LargeOccluderStats, Prepared};
use crate::kd_tree::KdNode;
use crate::{Aabb, View};

pub(super) struct Walk<'a> {
    of: &'a Prepared,
    view: &'a View,
    eye: Eye,
    kept: &'a mut Kept,
    frame: &'a mut Frame,
    stats: &'a mut LargeOccluderStats,
}

/// What occluders make of a box.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Found {
    Hidden,
    HiddenJointly,
    /// Some part may be; the partial occluders were appended to the frame's lists.
    Partial,
    /// Nothing of it is.
    None,
}

impl<'a> Walk<'a> {
    pub fn new(
        of: &'a Prepared,
        view: &'a View,
        eye: Eye,
        kept: &'a mut Kept,
        frame: &'a mut Frame,
        stats: &'a mut LargeOccluderStats,
    ) -> Walk<'a> {
        Walk { of, view, eye, kept, frame, stats }
    }

    pub fn run(&mut self) {
        let mut active = std::mem::take(&mut self.frame.active);
        self.eye.choose(self.of, self.eye.position, directions_of(self.view), &mut active);
        self.stats.occluders = active.len();
        self.frame.active = active;
        self.frame.continued.begin(self.frame.active.len());
        self.frame.lists.clear();
        self.frame.lists.extend(0..self.frame.active.len() as u8);
        self.frame.candidates.clear();
        self.node(0, 0, self.frame.active.len());
        self.details();
        self.frame.visible.sort_unstable();
    }

    /// Visits a node with the occluders in a range of the lists.
    fn node(&mut self, node: u32, from: usize, to: usize) {
        let aabb = self.of.boxes[node as usize];
        self.stats.nodes_visited += 1;
        if aabb.is_empty() || !self.eye.in_frustum(&aabb) {
            // Its relations are kept, for the frame in which the eye turns back.
            return;
        }
        self.stats.nodes_in_frustum += 1;
        let next = self.frame.lists.len();
        match self.test(node as usize, &aabb, from, to) {
            Found::Hidden => {
                self.stats.nodes_hidden += 1;
                self.release_below(node);
            }
            Found::HiddenJointly => {
                self.stats.nodes_hidden_jointly += 1;
                self.release_below(node);
            }
            found => {
                if found == Found::None && from < to {
                    self.release_below(node);
                }
                match self.of.tree.node(node) {
                    KdNode::Leaf(cell) => {
                        self.stats.leaves_visible += 1;
                        for &cluster in self.of.cell_clusters.of(cell) {
                            if !std::mem::replace(&mut self.frame.marks[cluster as usize], true) {
                                self.frame.candidates.push(cluster);
                            }
                        }
                    }
                    KdNode::Inner(children) => {
                        let end = self.frame.lists.len();
                        children.into_iter().for_each(|child| self.node(child, next, end));
                    }
                }
            }
        }
        self.frame.lists.truncate(next);
    }

    /// Compares a box with the occluders in a range of the lists, and appends those that partially occlude it.
    fn test(&mut self, index: usize, aabb: &Aabb, from: usize, to: usize) -> Found {
        if from == to {
            return Found::None;
        }
        let next = self.frame.lists.len();
        let mut members = std::mem::take(&mut self.frame.members);
        members.clear();
        let mut found = Found::None;
        for at in from..to {
            let number = self.frame.lists[at];
            let occluder = self.frame.active[usize::from(number)];
            let (status, inside) = self.relate(index, aabb, occluder);
            if status == Status::None {
                continue;
            }
            let nearer = is_nearer(&self.of.polygons, occluder.polygon, aabb, self.eye.position, self.eye.margins);
            if nearer && status == Status::Inside {
                found = Found::Hidden;
                break;
            }
            found = Found::Partial;
            self.frame.lists.push(number);
            if nearer {
                members.push(Member { active: number, of: occluder, inside });
            }
        }
        if found == Found::Partial && self.of.rules.joint && members.len() > 1 {
            self.stats.joint_tests += 1;
            // Numbers past the frame's own are other polygons for each detail.
            let kept = members.iter().all(|member| usize::from(member.active) < self.stats.occluders);
            let continued = kept.then_some(&mut self.frame.continued);
            if hide(&self.of.polygons, &members, aabb, &self.eye, continued) {
                self.stats.joint_occluders += 1;
                found = Found::HiddenJointly;
            }
        }
        if found != Found::Partial {
            self.frame.lists.truncate(next);
        }
        self.frame.members = members;
        found
    }

    /// The relation of an occluder to a box, from an earlier frame if it still holds.
    fn relate(&mut self, index: usize, aabb: &Aabb, occluder: Active) -> (Status, u8) {
        let Active { polygon, from_behind } = occluder;
        let relations = &mut self.kept.relations[index];
        self.kept.used[index] = true;
        let at = match relations.binary_search_by_key(&polygon, |relation| relation.polygon) {
            Ok(at) => at,
            Err(at) => {
                relations.insert(at, Relation::new(&self.of.polygons, polygon, aabb));
                self.kept.count += 1;
                self.stats.relations_made += 1;
                at
            }
        };
        let relation = &mut relations[at];
        if relation.holds(self.eye.position, from_behind) {
            self.stats.relations_reused += 1;
        } else {
            self.stats.relations_tested += 1;
            self.stats.planes_tested +=
                relation.answer(&self.of.polygons, aabb, self.eye.position, from_behind, self.eye.margins);
        }
        (relation.status, relation.inside)
    }

    /// Forgets the relations of the nodes below one that is wholly hidden or wholly visible.
    fn release_below(&mut self, node: u32) {
        if let KdNode::Inner(children) = self.of.tree.node(node) {
            for child in children {
                if self.release(child as usize) {
                    self.release_below(child);
                }
            }
        }
    }

    /// Forgets the relations of a box; whether there may have been any.
    fn release(&mut self, index: usize) -> bool {
        let used = std::mem::take(&mut self.kept.used[index]);
        if used {
            self.kept.count -= self.kept.relations[index].len();
            self.kept.relations[index].clear();
        }
        used
    }

    /// Tests the objects and clusters of the leaves that may be seen.
    fn details(&mut self) {
        let mut candidates = std::mem::take(&mut self.frame.candidates);
        // By number, so that the clusters of an object follow each other.
        candidates.sort_unstable();
        let clusters = &self.of.clusters;
        let nodes = self.of.tree.node_count();
        let mut last = (u32::MAX, false);
        for &cluster in &candidates {
            self.frame.marks[cluster as usize] = false;
            let object = clusters.object_of(cluster);
            if last.0 != object {
                last = (object, self.sees(nodes + object as usize, clusters.object_aabb(object)));
            }
            let only = clusters.clusters_of(object).len() == 1;
            let index = nodes + clusters.object_count() + cluster as usize;
            if last.1 && (only || self.sees(index, clusters.aabb(cluster))) {
                self.frame.visible.extend_from_slice(clusters.primitives(cluster));
            }
        }
        self.frame.candidates = candidates;
    }

    /// Whether the box of an object or a cluster may be seen, past the frame's occluders and those that are large near it.
    fn sees(&mut self, index: usize, aabb: &Aabb) -> bool {
        self.stats.details_tested += 1;
        if !self.eye.in_frustum(aabb) {
            return false;
        }
        let from = self.frame.lists.len();
        let mut hidden = self.hides(index, aabb, 0, self.frame.active.len());
        if !hidden && self.of.rules.details && self.of.rules.occluders > 0 {
            // What is large from the object towards the eye, and is not among the frame's.
            let frame_count = self.frame.active.len();
            let mut active = std::mem::take(&mut self.frame.active);
            let direction = direction_of(self.eye.position - aabb.centre());
            self.eye.choose(self.of, aabb.centre(), std::iter::once(direction), &mut active);
            self.frame.active = active;
            let count = self.frame.active.len();
            if count > frame_count {
                // Together with those of the frame that partially occlude it, which the first test left.
                self.frame.lists.extend(frame_count as u8..count as u8);
                hidden = self.hides(index, aabb, from, self.frame.lists.len());
            }
            self.frame.active.truncate(frame_count);
        }
        self.frame.lists.truncate(from);
        self.stats.details_hidden += usize::from(hidden);
        !hidden
    }

    fn hides(&mut self, index: usize, aabb: &Aabb, from: usize, to: usize) -> bool {
        matches!(self.test(index, aabb, from, to), Found::Hidden | Found::HiddenJointly)
    }
}
