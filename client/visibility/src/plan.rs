//! What does drawing a scene need? Counted in views, so that a plan can leave out what does not pay (DESIGN.md §8).
//!
//! Three ways to draw, each a superset of the next and all of them the same picture: everything; what is in view; what is in
//! view and not hidden. Which pays depends on how much of the scene is out of view, and on how much of the rest is hidden.
//! Both are counted in triangles and never timed, so that one scene has one plan on every machine. [`SceneCounts`] counts in a
//! few views, without making any cells; [`Planned`] follows and counts on while it runs.

mod hysteresis;
mod planned;

use std::sync::Arc;

use crate::frustum::Frustum;
use crate::{Clusters, DepthBuffer, Resolution, Scene, View};

pub use hysteresis::Hysteresis;
pub use planned::{Planned, PlannedRules, PlannedStats};

/// How much of a scene is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Drawing {
    /// All of it.
    Everything,
    /// What is in view.
    Frustum,
    /// What is in view and not hidden.
    Occlusion,
}

/// What was counted, over one view or several. All are sums.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ViewCounts {
    /// Views.
    pub views: u64,
    /// Triangles of the scene, once a view.
    pub total: u64,
    /// Of these, those in clusters whose box may be in view.
    pub in_view: u64,
    /// Of these, those in clusters whose box is hidden by what is nearer.
    pub hidden: u64,
}

/// Least share of a scene that must be out of view for frustum culling to pay: asking about the box of 64 triangles costs
/// less than a triangle, and a list of ids has to be made.
const OUTSIDE_SHARE: f64 = 0.05;
/// Scenes of fewer triangles are drawn whole: so many are drawn in the time that any culler takes to begin.
pub(crate) const SMALL: u64 = 1_000;
/// Least share of what is in view that must be hidden for occlusion culling to pay. Chosen on the scenes that `eyeline-sim plan
/// --all --cost` tells of: `seminar`, `vessels` and Fox hide at most 16 % and lose by it; from 44 % on (sponza) all gain. There is
/// none between.
const HIDDEN_SHARE: f64 = 1.0 / 3.0;
/// The share at which occlusion culling that runs is still kept.
const STILL_HIDDEN_SHARE: f64 = 0.2;
/// Least number of hidden triangles a view: what the culler itself costs.
const HIDDEN_LEAST: u64 = 500;

impl ViewCounts {
    /// Adds what was counted elsewhere.
    pub fn add(&mut self, other: &ViewCounts) {
        self.views += other.views;
        self.total += other.total;
        self.in_view += other.in_view;
        self.hidden += other.hidden;
    }

    /// Share of the scene that is out of view.
    pub fn outside_share(&self) -> f64 {
        1.0 - share(self.in_view, self.total)
    }

    /// Share of what is in view that is hidden.
    pub fn hidden_share(&self) -> f64 {
        share(self.hidden, self.in_view)
    }

    /// Whether leaving out what is out of view pays.
    pub fn frustum_pays(&self) -> bool {
        self.total >= SMALL * self.views.max(1) && self.outside_share() >= OUTSIDE_SHARE
    }

    /// Whether leaving out what is hidden pays. What `runs` already must be less worth to be stopped than to be begun.
    pub fn occlusion_pays(&self, runs: bool) -> bool {
        let least = if runs { STILL_HIDDEN_SHARE } else { HIDDEN_SHARE };
        self.hidden >= HIDDEN_LEAST * self.views.max(1) && self.hidden_share() >= least
    }

    /// The way to draw that pays.
    pub fn drawing(&self) -> Drawing {
        match (self.occlusion_pays(false), self.frustum_pays()) {
            (true, _) => Drawing::Occlusion,
            (false, true) => Drawing::Frustum,
            (false, false) => Drawing::Everything,
        }
    }
}

fn share(part: u64, whole: u64) -> f64 {
    if whole == 0 { 0.0 } else { part as f64 / whole as f64 }
}

/// An image of the same shape with at most [`COLUMNS`] columns.
fn small(resolution: Resolution) -> Resolution {
    let Resolution { width, height } = resolution;
    let columns = width.min(COLUMNS);
    let rows = (u64::from(height) * u64::from(columns)).div_ceil(u64::from(width.max(1)));
    Resolution::new(columns, rows as u32)
}

/// Counts views of a scene: its clusters in view are taken front to back, and each is hidden or drawn.
///
/// They are the clusters that the fastest culler asks about, since what is near each other in space can be hidden together.
/// What is near each other in a file need not be: of oa_dm2, one mesh, runs of 64 triangles in the file's order hid 16 % of
/// what was in view.
#[derive(Clone, Debug)]
pub struct SceneCounts {
    frustum: Arc<Frustum>,
    clusters: Clusters,
    depth: DepthBuffer,
    order: Vec<(u32, u32)>,
    /// What was counted so far.
    pub counts: ViewCounts,
}

/// Columns of the image that is counted in. Fewer cost less and hide a little less at silhouettes.
const COLUMNS: u32 = 256;

impl SceneCounts {
    /// Nothing counted yet.
    pub fn new(frustum: Arc<Frustum>) -> SceneCounts {
        let nowhere = View::level(glam::DVec3::ZERO, 0.0, 1.0, Resolution::new(0, 0));
        let clusters = Clusters::build(frustum.scene(), Clusters::TRIANGLES_MAX);
        let depth = DepthBuffer::new(&nowhere);
        SceneCounts { frustum, clusters, depth, order: Vec::new(), counts: ViewCounts::default() }
    }

    /// Counts these views of a scene.
    pub fn of(scene: Arc<Scene>, views: &[View]) -> SceneCounts {
        let mut counts = SceneCounts::new(Arc::new(Frustum::new(scene)));
        for view in views {
            counts.view(view);
        }
        counts
    }

    /// Counts the four level views around an eye, of 90° each: what is known where nobody has looked yet.
    pub fn around(scene: Arc<Scene>, eye: glam::DVec3) -> SceneCounts {
        let views = [0.0, 0.5, 1.0, 1.5].map(|turns: f64| {
            let side = Resolution::new(COLUMNS, COLUMNS);
            View::level(eye, turns * std::f64::consts::PI, std::f64::consts::FRAC_PI_2, side)
        });
        SceneCounts::of(scene, &views)
    }

    /// The boxes of the scene's runs.
    pub fn frustum(&self) -> &Arc<Frustum> {
        &self.frustum
    }

    fn clusters_in_view(&self, mut each: impl FnMut(&Clusters, u32)) {
        let clusters = &self.clusters;
        for object in 0..clusters.object_count() as u32 {
            let own = clusters.clusters_of(object);
            if own.is_empty() || own.len() > 1 && !self.depth.in_view(clusters.object_aabb(object)) {
                continue;
            }
            own.filter(|&cluster| self.depth.in_view(clusters.aabb(cluster)))
                .for_each(|cluster| each(clusters, cluster));
        }
    }

    /// Triangles in clusters that may be in view, without counting what is hidden.
    pub(crate) fn in_view(&mut self, view: &View) -> u64 {
        self.depth.begin(&View { resolution: small(view.resolution), ..*view });
        let mut in_view = 0;
        self.clusters_in_view(|clusters, cluster| in_view += clusters.primitives(cluster).len() as u64);
        in_view
    }

    /// Counts one view more; returns what it adds. A view that is none adds nothing.
    pub fn view(&mut self, view: &View) -> ViewCounts {
        let Resolution { width, height } = view.resolution;
        if view.check().is_err() || width == 0 || height == 0 {
            return ViewCounts::default();
        }
        self.depth.begin(&View { resolution: small(view.resolution), ..*view });
        let total = self.frustum.scene().triangles().len() as u64;
        let mut counts = ViewCounts { views: 1, total, ..ViewCounts::default() };
        let mut order = std::mem::take(&mut self.order);
        order.clear();
        self.clusters_in_view(|clusters, cluster| {
            let aabb = clusters.aabb(cluster);
            let distance2 = view.eye.clamp(aabb.min, aabb.max).distance_squared(view.eye) as f32;
            // Bits of floats that are not negative are in the order of their values.
            order.push((distance2.to_bits(), cluster));
        });
        order.sort_unstable();
        for &(_, cluster) in &order {
            let primitives = self.clusters.primitives(cluster);
            counts.in_view += primitives.len() as u64;
            if self.depth.sees(self.clusters.aabb(cluster)) {
                self.depth.draw(self.frustum.scene(), primitives);
            } else {
                counts.hidden += primitives.len() as u64;
            }
        }
        self.order = order;
        self.counts.add(&counts);
        counts
    }
}

#[cfg(test)]
mod tests;
