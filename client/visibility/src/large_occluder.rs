//! What do a few large polygons hide? (Coorg & Teller, "Real-Time Occlusion Culling for Models with Large Occluders", 1997.)
//!
//! No image is drawn. Per cell of a kD-tree and viewing direction, the polygons that subtend most are chosen beforehand
//! ([`choose`]). A frame walks the tree from the root and compares each node's box with them ([`relation`]): a node that one of
//! them hides, or several together ([`joint`]), is left; children are compared only with what partially occludes their
//! parent; nodes that nothing occludes are taken with all that is in them and in view. Relations are kept from frame to frame,
//! those of nodes outside the frustum too, until an ancestor is wholly hidden or wholly visible. In leaves that may be
//! seen, objects and clusters are tested against what is large near them (§3.2).
//!
//! # Why no pixel is wrong
//! Let a primitive q own a pixel. Some true point p of q is seen within 1/256 px of the pixel's centre, at its depth (`setup`).
//! p lies in a leaf's box, and in those of q's cluster and object. Were one of these boxes hidden, then in
//! truth its whole image, widened by 2/256 px, would lie inside the outlines of polygons that are nearer than all of it by more
//! than depths can be wrong ([`relation::is_nearer`]). Snapping moves outlines by less than 1/256 px. So the loop of *snapped* corners,
//! all of which a facet keeps, winds around the pixel's centre as the true one does, the triangles that the loop is made of
//! cover it, and one of them is in front of q. Welded edges cancel in that count, cracks are looked for, and edges that are covered
//! by another polygon are so by the same margin. A polygon that the near plane might cut in view is not used.
//!
//! Every test is of planes, eyes and boxes in f64 with room for rounding, and gives way by the radius of the eye region. So the same
//! holds for the picture of every eye of a ball, with the view's orientation and resolution. T-junctions are then left open,
//! since each of these pictures has its own cracks.

mod choose;
mod joint;
mod polygons;
mod relation;
mod rules;
mod scratch;
mod silhouette;
mod walk;

use std::sync::Arc;

use glam::DVec3;

use crate::culler::everything;
use crate::kd_tree::KdNode;
use crate::raster_sampled::setup::{Projector, SNAP_PX};
use crate::{Aabb, CellClusters, Clusters, Culled, Culler, EyeRegion, KdTree, Scene, Scratch, Tessellation, View};
use choose::Choice;
use joint::{Active, MEMBERS_MAX};
use polygons::Polygons;
use relation::Margins;

pub use rules::{LargeOccluderRules, LargeOccluderStats};
pub use scratch::LargeOccluderScratch;
pub(crate) use scratch::is_ball;

/// The culler of Coorg & Teller over one scene. Made once, never changed, shared by all workers.
#[derive(Clone, Debug)]
pub struct LargeOccluder {
    prepared: Arc<Prepared>,
}

/// What is made once per scene.
#[derive(Debug)]
struct Prepared {
    scene: Arc<Scene>,
    rules: LargeOccluderRules,
    tree: KdTree,
    /// The least box around what each node's cells hold; [`Aabb::EMPTY`] around nothing.
    boxes: Vec<Aabb>,
    clusters: Clusters,
    cell_clusters: CellClusters,
    polygons: Polygons,
    choice: Choice,
}

impl LargeOccluder {
    /// Prepares a scene: merges polygons, cuts cells and chooses occluders for them.
    pub fn new(scene: Arc<Scene>, rules: LargeOccluderRules) -> LargeOccluder {
        let occluders = rules.occluders.min(MEMBERS_MAX);
        let area_min = if rules.area_min > 0.0 { rules.area_min } else { 0.0 };
        let polygons_max = if occluders > 0 { rules.polygons_max } else { 0 };
        let tree = KdTree::build(&scene, rules.cells);
        let boxes = boxes(&scene, &tree);
        let polygons = Polygons::build(&scene, polygons_max, area_min);
        let choice = Choice::build(&tree, &boxes, &polygons, occluders);
        let clusters = Clusters::build(&scene, Clusters::TRIANGLES_MAX);
        let cell_clusters = CellClusters::build(&tree, &clusters);
        let prepared = Prepared { scene, rules, tree, boxes, clusters, cell_clusters, polygons, choice };
        LargeOccluder { prepared: Arc::new(prepared) }
    }

    /// Prepares a scene by default rules.
    pub fn build(scene: Arc<Scene>) -> LargeOccluder {
        LargeOccluder::new(scene, LargeOccluderRules::default())
    }

    /// The scene.
    pub fn scene(&self) -> &Arc<Scene> {
        &self.prepared.scene
    }

    /// The rules that it was made by.
    pub fn rules(&self) -> LargeOccluderRules {
        self.prepared.rules
    }

    /// Number of polygons that can be chosen as occluders.
    pub fn polygon_count(&self) -> usize {
        self.prepared.polygons.len()
    }

    /// Pairs of their edges that run between the same two corners, and pairs that share a stretch of a line: T-junctions.
    pub fn joint_counts(&self) -> [usize; 2] {
        self.prepared.polygons.partner_counts()
    }

    /// The cells.
    pub fn tree(&self) -> &KdTree {
        &self.prepared.tree
    }

    /// Finds what can be seen in a view by every eye of a region, and leaves it in `scratch`. Everything for a view that
    /// [`View::check`] refuses or a region that is no ball.
    pub fn walk(&self, view: &View, region: EyeRegion, scratch: &mut LargeOccluderScratch) -> LargeOccluderStats {
        scratch.walk(&self.prepared, view, region)
    }
}

impl Culler for LargeOccluder {
    fn cull(&self, view: &View, region: EyeRegion, scratch: &mut Scratch) -> Culled {
        let Some(large) = scratch.begin_large(view, region) else { return everything(&self.prepared.scene) };
        let stats = large.walk(&self.prepared, view, region);
        Culled { visible: large.visible().to_vec(), traversal: stats.traversal(), z_tests: 0 }
    }
}

impl LargeOccluderStats {
    /// The counts in the words that all cullers share.
    fn traversal(&self) -> crate::Traversal {
        crate::Traversal {
            cells_projected: self.leaves_visible,
            queries: self.nodes_in_frustum,
            bounds_tested: self.details_tested,
            polygons_drawn: self.occluders,
            triangles_drawn: self.primitives,
            ..crate::Traversal::default()
        }
    }
}

/// The boxes of all nodes. What a cell lists may reach far beyond it, and what is in the cell may leave much of it empty.
fn boxes(scene: &Scene, tree: &KdTree) -> Vec<Aabb> {
    let mut boxes = vec![Aabb::EMPTY; tree.node_count()];
    let skin = tree.cells().skin();
    for node in (0..tree.node_count() as u32).rev() {
        boxes[node as usize] = match tree.node(node) {
            KdNode::Leaf(cell) => {
                let aabb = tree.cell(cell).inflated(skin);
                let part = |id: &u32| {
                    let triangle = scene.triangles()[*id as usize].aabb();
                    Aabb::new(triangle.min.max(aabb.min), triangle.max.min(aabb.max))
                };
                let parts = tree.primitives(cell).iter().map(part).filter(|part| !part.is_empty());
                parts.fold(Aabb::EMPTY, |all, part| all.union(&part))
            }
            KdNode::Inner([a, b]) => boxes[a as usize].union(&boxes[b as usize]),
        };
    }
    boxes
}

/// The eye of a frame, or the ball of eyes.
#[derive(Clone, Copy, Debug)]
struct Eye {
    position: DVec3,
    margins: Margins,
    /// Occluders must be farther than this.
    near: f64,
    /// For the frustum.
    frustum: Projector,
    /// The picture that cracks matter in, if there is one.
    picture: Option<Projector>,
}

impl Eye {
    fn new(view: &View, region: EyeRegion) -> Eye {
        let frustum = Projector::new(&View { eye: region.centre, ..*view });
        // A pixel beyond the corner, as in the projector's own test.
        let [x, y] = frustum.middle.map(|half| (half + 1.0) / frustum.focal_px);
        let reach = (1.0 + x * x + y * y).sqrt();
        let is_point = region == EyeRegion::point(view.eye);
        Eye {
            position: region.centre,
            margins: Margins { radius: region.radius, angle: 2.0 * SNAP_PX / frustum.focal_px },
            near: view.near * reach * (1.0 + 1e-9) + region.radius,
            frustum,
            picture: is_point.then_some(frustum),
        }
    }

    fn in_frustum(&self, aabb: &Aabb) -> bool {
        let corners = aabb.corners().map(|corner| self.frustum.view_point(corner));
        // Rounding of a corner's place is far below a hundredth of a pixel, save very far out.
        let slack = self.margins.radius + 1e-12 * (self.position.length() + aabb.min.length() + aabb.max.length());
        !self.frustum.outside(&corners, slack) && !corners.iter().all(|corner| corner.w < -slack)
    }

    /// What a polygon is to this eye: `None` if it cannot be used.
    fn active(&self, polygons: &Polygons, polygon: u32) -> Option<Active> {
        let of = polygons.get(polygon);
        let at = of.normal.dot(self.position);
        let (above, below) = (at - of.heights[1], of.heights[0] - at);
        let from_behind = below > 0.0;
        let clear = above.max(below);
        // Seen almost edge-on, a loop that is not quite flat might be turned away in part.
        let least = GRAZING * of.size + self.margins.radius + 1e-12 * (of.aabb.max.length() + self.position.length());
        let usable =
            clear > least && (of.two_sided || !from_behind) && clear.max(of.aabb.distance(self.position)) > self.near;
        usable.then_some(Active { polygon, from_behind })
    }

    /// The polygons chosen for a place and directions that can be used, each once, best first.
    fn choose(&self, of: &Prepared, place: DVec3, directions: impl Iterator<Item = usize>, chosen: &mut Vec<Active>) {
        let cell = of.tree.cell_at(place);
        for direction in directions {
            let outside;
            let polygons = match cell {
                Some(cell) => of.choice.of(cell, direction),
                None => {
                    let most = of.rules.occluders.min(MEMBERS_MAX);
                    outside = choose::from_outside(place, &of.polygons, most, direction);
                    &outside
                }
            };
            for &polygon in polygons {
                if chosen.len() < MEMBERS_MAX && chosen.iter().all(|active| active.polygon != polygon) {
                    chosen.extend(self.active(&of.polygons, polygon));
                }
            }
        }
    }
}

/// An eye must be farther from an occluder's plane than this share of the occluder's size.
const GRAZING: f64 = 1e-4;
