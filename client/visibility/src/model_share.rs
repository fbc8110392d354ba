//! How much of each model is visible? A hint for its level of detail (Klosowski & Silva 2000, §6, extension 2).
//!
//! "The PLP traversal algorithm can estimate the proportion of a model that is currently visible": of the triangles of a node that are
//! in view and turned to the eye, the share that a traversal drew. A model of which a tenth shows past a wall needs less detail than its
//! size on the screen says.

use crate::plp::in_view_and_facing;
use crate::raster_sampled::setup::Projector;
use crate::{Scene, View};

/// What of one node is visible.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ModelShare {
    /// Index in [`Scene::nodes`].
    pub node: usize,
    /// Its triangles in view and turned to the eye that are visible.
    pub visible: usize,
    /// All its triangles in view and turned to the eye; at least `visible`.
    pub facing: usize,
}

impl ModelShare {
    /// Share of the model that is visible, above 0 and up to 1.
    pub fn share(&self) -> f64 {
        self.visible as f64 / self.facing.max(1) as f64
    }
}

/// The nodes of which something is visible, ascending. `visible` are ids in any order: what a PLP traversal drew
/// ([`crate::PlpScratch::drawn`]), or any culler's visible set. Nodes of which nothing is visible are not looked at, and ids of no triangle
/// do not count; a view that [`View::check`] refuses shows nothing.
pub fn model_shares(scene: &Scene, view: &View, visible: &[u32]) -> Vec<ModelShare> {
    if view.check().is_err() || view.resolution.pixels() == 0 {
        return Vec::new();
    }
    let projector = Projector::new(view);
    let shows = |id: u32| in_view_and_facing(&projector, view.eye, &scene.triangles()[id as usize]);
    let mut visible: Vec<u32> = visible.iter().copied().filter(|id| (*id as usize) < scene.triangles().len()).collect();
    visible.sort_unstable();
    visible.dedup();
    let (nodes, mut shares) = (scene.nodes(), Vec::new());
    let mut rest = &visible[..];
    while let Some(&first) = rest.first() {
        let node = nodes.partition_point(|node| node.primitives.end <= first);
        let range = nodes[node].primitives.clone();
        let (own, others) = rest.split_at(rest.partition_point(|id| *id < range.end));
        rest = others;
        let seen = own.iter().filter(|id| shows(**id)).count();
        if seen > 0 {
            let facing = range.filter(|id| shows(*id)).count();
            shares.push(ModelShare { node, visible: seen, facing });
        }
    }
    shares
}

#[cfg(test)]
mod tests {
    use glam::{DVec3, Vec3};

    use super::*;
    use crate::{Node, Resolution, Sides, Triangle, exact_set};

    /// Upright squares of two triangles at x, turned to +Z or away from it.
    fn square(x: f32, z: f32, turned: bool) -> [Triangle; 2] {
        let corner = |dx: f32, dy: f32| Vec3::new(x + dx, dy, z);
        let halves = [
            [corner(0.0, 0.0), corner(1.0, 0.0), corner(1.0, 1.0)],
            [corner(0.0, 0.0), corner(1.0, 1.0), corner(0.0, 1.0)],
        ];
        halves.map(|[a, b, c]| {
            let corners = if turned { [a, c, b] } else { [a, b, c] };
            Triangle { corners, sides: Sides::Front, occludes: true }
        })
    }

    #[test]
    fn shares_are_of_what_is_in_view_and_faces_the_eye() {
        let quarter_hidden =
            [square(-2.0, 0.0, false), square(-1.0, 0.0, false), square(0.0, 0.0, false), square(1.0, 0.0, false)];
        let turned_away = [square(-2.0, 0.5, true), square(-1.0, 0.5, true)];
        let out_of_view = [square(1e4, 0.0, false)];
        let screen = [square(-2.0, 1.0, false)];
        let groups: [&[[Triangle; 2]]; 4] = [&quarter_hidden, &turned_away, &screen, &[]];
        let mut triangles: Vec<Triangle> = Vec::new();
        let mut nodes = Vec::new();
        for (number, group) in groups.into_iter().enumerate() {
            let first = triangles.len() as u32;
            triangles.extend(group.iter().flatten().chain(out_of_view.iter().flatten().filter(|_| number == 0)));
            nodes.push(Node { name: String::new(), primitives: first..triangles.len() as u32 });
        }
        let scene = Scene::from_parts(DVec3::ZERO, triangles, nodes, Vec::new());
        // From so far away that the screen hides the first square and no part of the second.
        let view =
            View { fov_x: 0.1, ..View::level(DVec3::new(-1.5, 0.5, 200.0), 0.0, 0.1, Resolution::new(400, 400)) };
        let exact = exact_set(&scene, &view).0;
        let shares = model_shares(&scene, &view, &exact);
        assert_eq!(shares.iter().map(|share| (share.node, share.facing)).collect::<Vec<_>>(), [(0, 8), (2, 2)]);
        assert_eq!((shares[1].visible, shares[1].share()), (2, 1.0));
        assert!((6..=7).contains(&shares[0].visible) && shares[0].share() < 1.0, "{shares:?}");
        // Order, repetition and what is no triangle are no matter; what is turned away or out of view does not count.
        let again: Vec<u32> = exact.iter().rev().chain(&exact).copied().chain([8, 9, 10, u32::MAX]).collect();
        assert_eq!(model_shares(&scene, &view, &again), shares);
        assert!(model_shares(&scene, &view, &[]).is_empty());
        let blind = View { eye: DVec3::NAN, ..view };
        assert!(model_shares(&scene, &blind, &exact).is_empty());
        let nothing = View { resolution: Resolution::new(0, 9), ..view };
        assert!(model_shares(&scene, &nothing, &exact).is_empty());
    }
}
