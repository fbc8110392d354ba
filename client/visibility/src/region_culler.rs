//! Which primitives can be seen from some eye of a ball, with the view's orientation and angle of view, at any resolution?
//!
//! cPLP over cells with an under-estimating image as its target (proofs: [`crate::Cplp`] for the chain of cells that leads
//! to whatever an eye sees, `under_region` for "hidden"). Afterwards each primitive's own box is asked about, which is
//! much tighter than its cell's, and primitives that turn their one side away from the whole ball are dropped.
//!
//! A ball first looks through doors ([`crate::portals`]). Where they show little, that is the answer, and nothing is drawn:
//! [`crate::sheets`] has the last word about bounds. Else doors speak beside the image, which is drawn as if there were none: an image
//! that leaves out what doors hide hides less.
//!
//! The promise is about rays. A rasteriser that snaps corners can open a crack where walls meet without sharing corners, or
//! turn a triangle that is seen nearly edge-on; what a picture shows there, no ray meets. (5 pixels of 450 million on oa_koth1:
//! `eyeline-sim cull --cullers region --views 500 --resolution 1000x900`, column `cracks`.)

use std::sync::Arc;

use glam::DVec3;

use crate::culler::everything;
use crate::{
    Bound, Budget, Cplp, Culled, Culler, EyeRegion, KdRules, KdTree, Occluders, Resolution, Scene, Scratch, Sides,
    Traversal, Triangle, UnderOcclusion, View,
};

/// Conservative PLP for every eye of a ball and every resolution. A region that is no ball gets everything.
#[derive(Clone, Debug)]
pub struct RegionCuller {
    scene: Arc<Scene>,
    cplp: Arc<Cplp>,
    occluders: Arc<Occluders>,
    pixels: u32,
}

/// Pixels of the image by default: those of 256×128.
const PIXELS: u32 = 256 * 128;

/// Where doors show no more primitives than this, no image is drawn: it costs more than it can take away.
const SHOWN_MAX: usize = 500;

/// Nor is one drawn only if that is at most one primitive in so many of the scene. Else it has no rooms, and what hides is no wall.
const SHOWN_SHARE: usize = 8;

/// An image is at most so many times wider than high, or higher than wide; else it shows more than the view.
const ASPECT_MAX: f64 = 16.0;

/// An eye may be this sine behind a one-sided primitive's plane and still count as before it: the rasteriser's 24.8
/// coordinates may turn what is seen edge-on.
const TURNED_AWAY: f64 = 1e-3;

impl RegionCuller {
    /// Culls with cells and occluders that were made for this scene, in images of about `pixels` pixels. More are tighter
    /// and slower.
    pub fn new(scene: Arc<Scene>, cplp: Arc<Cplp>, occluders: Arc<Occluders>, pixels: u32) -> RegionCuller {
        assert_eq!(scene.triangles().len(), cplp.tessellation().primitive_total(), "the cells are another scene's");
        RegionCuller { scene, cplp, occluders, pixels: pixels.clamp(1, 1 << 20) }
    }

    /// Makes cells and occluders by default rules. Cells that are cut at walls have doors between them; an octree's have not.
    pub fn build(scene: Arc<Scene>) -> RegionCuller {
        let cells = Arc::new(KdTree::build(&scene, KdRules::default()));
        let occluders = Arc::new(Occluders::build(&scene));
        RegionCuller::new(scene, Arc::new(Cplp::new(cells)), occluders, PIXELS)
    }

    /// The view as this culler draws it: from the region's centre, at least as wide and high, in its own resolution.
    /// None for a view that [`View::check`] refuses.
    fn image(&self, view: &View, region: EyeRegion) -> Option<View> {
        view.check().ok()?;
        let Resolution { width, height } = view.resolution;
        let x = (view.fov_x * 0.5).tan();
        let y = x * f64::from(height.max(1)) / f64::from(width.max(1));
        let (x, y) = (x.max(y / ASPECT_MAX), y.max(x / ASPECT_MAX));
        let columns = (f64::from(self.pixels) * x / y).sqrt().ceil();
        let resolution = Resolution::new(columns as u32, (columns * y / x).ceil() as u32);
        let fov_x = 2.0 * (x * (1.0 + 1e-9)).atan();
        Some(View { eye: region.centre, fov_x, resolution, ..*view })
    }
}

impl RegionCuller {
    /// The visible set as doors show it, if that is small enough to be the answer.
    fn through_doors(&self, region: EyeRegion, image: &View, under: &mut UnderOcclusion) -> Option<Culled> {
        let tessellation = &**self.cplp.tessellation();
        under.look_through_doors(tessellation, region, image);
        let portals = &under.portals;
        if !portals.speak() {
            return None;
        }
        let triangles = self.scene.triangles();
        let skin = tessellation.cells().skin();
        let mut visible = Vec::new();
        for &cell in portals.reached() {
            visible.extend(tessellation.primitives(cell).iter().copied().filter(|&id| {
                let triangle = &triangles[id as usize];
                !turned_away(triangle, region) && !portals.hides_in_cell(cell, &triangle.aabb().inflated(skin))
            }));
        }
        visible.sort_unstable();
        visible.dedup();
        let few = visible.len() <= SHOWN_MAX.min(triangles.len() / SHOWN_SHARE);
        let traversal = Traversal {
            cells_projected: portals.reached().len(),
            rounds: 1,
            queries: portals.looks(),
            triangles_drawn: visible.len(),
            ..Traversal::default()
        };
        few.then_some(Culled { visible, traversal, z_tests: 0 })
    }
}

impl Culler for RegionCuller {
    fn cull(&self, view: &View, region: EyeRegion, scratch: &mut Scratch) -> Culled {
        let Some(image) = self.image(view, region) else {
            scratch.forget();
            return everything(&self.scene);
        };
        let (under, cplp) = scratch.under(&self.occluders, &image);
        if under.start(region).is_err() {
            scratch.forget();
            return everything(&self.scene);
        }
        let triangles = self.scene.triangles();
        if region.radius > 0.0
            && let Some(culled) = self.through_doors(region, &image, under)
        {
            return culled;
        }
        let traversal = self.cplp.traverse(&self.scene, region, Budget { triangles: 0 }, under, cplp);
        let seen = |&id: &u32| {
            let triangle = &triangles[id as usize];
            !turned_away(triangle, region) && !under.covers(&Bound::Box(triangle.aabb()))
        };
        Culled { visible: cplp.visible().iter().copied().filter(seen).collect(), traversal, z_tests: 0 }
    }
}

/// Whether every eye of the region is behind the plane of a one-sided triangle.
fn turned_away(triangle: &Triangle, region: EyeRegion) -> bool {
    let [a, b, c] = triangle.corners.map(|corner| corner.as_dvec3());
    let normal: DVec3 = (b - a).cross(c - a);
    let reach = [a, b, c].iter().map(|corner| corner.distance(region.centre)).fold(region.radius, f64::max);
    triangle.sides == Sides::Front
        && normal.dot(region.centre - a) < -normal.length() * (region.radius + TURNED_AWAY * reach)
}
