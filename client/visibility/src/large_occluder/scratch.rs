//! What one worker keeps of a [`super::LargeOccluder`]'s frames: relations, the last visible set, and the occlusion that it stands for.

use std::sync::Arc;

use super::joint::{Active, Continued, Member, hide};
use super::relation::{Margins, Relation, Status, is_nearer};
use super::walk::Walk;
use super::{Eye, LargeOccluderStats, Prepared};
use crate::{Aabb, Bound, EyeRegion, Occlusion, View};

/// What one worker needs, kept from frame to frame.
#[derive(Clone, Debug, Default)]
pub struct LargeOccluderScratch {
    of: Option<Arc<Prepared>>,
    pub(super) kept: Kept,
    pub(super) frame: Frame,
    stats: LargeOccluderStats,
}

/// Relations by node, then by object, then by cluster.
#[derive(Clone, Debug, Default)]
pub(super) struct Kept {
    pub relations: Vec<Vec<Relation>>,
    /// Whether a box may have relations, or a node below it.
    pub used: Vec<bool>,
    pub count: usize,
    margins: Option<Margins>,
}

/// What holds for the present frame alone.
#[derive(Clone, Debug, Default)]
pub(super) struct Frame {
    pub eye: Option<Eye>,
    /// The occluders, best first.
    pub active: Vec<Active>,
    pub continued: Continued,
    /// Lists of active occluders by number, those of a node on top of its ancestors'.
    pub lists: Vec<u8>,
    pub members: Vec<Member>,
    /// Clusters in leaves that may be seen, each with the node.
    pub candidates: Vec<u32>,
    pub marks: Vec<bool>,
    pub visible: Vec<u32>,
}

impl LargeOccluderScratch {
    /// The primitives that may be seen, ascending, each once: the last walk's visible set.
    pub fn visible(&self) -> &[u32] {
        &self.frame.visible
    }

    /// What the last walk came to.
    pub fn stats(&self) -> LargeOccluderStats {
        self.stats
    }

    /// Relations that are kept at present.
    pub fn relation_count(&self) -> usize {
        self.kept.count
    }

    /// Forgets all relations, as if no frame had been before. What is found is the same; it costs more.
    pub fn forget_relations(&mut self) {
        self.kept = Kept::default();
    }

    pub(super) fn walk(&mut self, of: &Arc<Prepared>, view: &View, region: EyeRegion) -> LargeOccluderStats {
        if self.of.as_ref().is_none_or(|known| !Arc::ptr_eq(known, of)) {
            self.kept = Kept::default();
            self.frame = Frame::default();
            self.of = Some(of.clone());
        }
        self.stats = LargeOccluderStats::default();
        self.frame.visible.clear();
        self.frame.active.clear();
        let makes_sense = view.check().is_ok() && is_ball(region);
        self.frame.eye = makes_sense.then(|| Eye::new(view, region));
        match self.frame.eye {
            None => self.frame.visible.extend(0..of.scene.triangles().len() as u32),
            Some(eye) => {
                let boxes = of.tree.node_count() + of.clusters.object_count() + of.clusters.len();
                let full = self.kept.count > of.rules.relations_max;
                if self.kept.margins != Some(eye.margins) || full {
                    self.kept = Kept { margins: Some(eye.margins), ..Kept::default() };
                }
                self.kept.relations.resize(boxes, Vec::new());
                self.kept.used.resize(boxes, false);
                self.frame.marks.resize(of.clusters.len(), false);
                Walk::new(of, view, eye, &mut self.kept, &mut self.frame, &mut self.stats).run();
            }
        }
        self.stats.primitives = self.frame.visible.len();
        self.stats
    }
}

/// Whether a region is a ball of finite places.
pub(crate) fn is_ball(region: EyeRegion) -> bool {
    region.centre.is_finite() && region.radius.is_finite() && region.radius >= 0.0
}

impl Occlusion for LargeOccluderScratch {
    /// Tests the bound's box against the occluders of the last walk, and against those that are large near it. Hidden in that view, at
    /// that resolution, from every eye of the region.
    fn hides(&self, bound: &Bound) -> bool {
        let (Some(of), Some(eye), Some(aabb)) = (&self.of, &self.frame.eye, bound.aabb()) else { return false };
        // NaN is no box.
        if !(aabb.min.is_finite() && aabb.max.is_finite()) || aabb.is_empty() {
            return false;
        }
        if !eye.in_frustum(&aabb) {
            return true;
        }
        if hides_box(of, eye, &self.frame.active, &aabb) {
            return true;
        }
        if !of.rules.details {
            return false;
        }
        let mut near = Vec::new();
        let direction = super::choose::direction_of(eye.position - aabb.centre());
        eye.choose(of, aabb.centre(), std::iter::once(direction), &mut near);
        hides_box(of, eye, &near, &aabb)
    }
}

/// Whether these occluders hide a box, alone or together.
fn hides_box(of: &Prepared, eye: &Eye, active: &[Active], aabb: &Aabb) -> bool {
    let mut members = Vec::new();
    for (number, &occluder) in (0..).zip(active) {
        let mut relation = Relation::new(&of.polygons, occluder.polygon, aabb);
        relation.answer(&of.polygons, aabb, eye.position, occluder.from_behind, eye.margins);
        if relation.status == Status::None
            || !is_nearer(&of.polygons, occluder.polygon, aabb, eye.position, eye.margins)
        {
            continue;
        }
        if relation.status == Status::Inside {
            return true;
        }
        members.push(Member { active: number, of: occluder, inside: relation.inside });
    }
    of.rules.joint && members.len() > 1 && hide(&of.polygons, &members, aabb, eye, None)
}
