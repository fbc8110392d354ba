//! Is a bound *certainly* hidden by the static scene, for every orientation of the camera and every resolution?
//!
//! A tracker stays silent about what is hidden, so a wrong "hidden" is a missed avatar, while a wrong "visible" is only
//! a message. A Z-buffer asks at pixel centres and can be wrong both ways. Here a pixel counts as covered at depth z only
//! if one occluder covers its **whole square** and is nowhere in it farther than z, so a coarser image is less tight and
//! never wrong. A bound is hidden if every pixel that it may touch is covered nearer than its nearest point: each ray
//! from the eye to a point of the bound passes some pixel's square and meets that pixel's occluder first.
//!
//! Drawing needs no clipping. The half-space of the directions on the inner side of an edge (v₀, v₁) is bounded by the
//! plane through the eye with normal v₁ × v₀, and is linear in pixel coordinates of any image, also for corners behind
//! the eye (Olano and Greer, "Triangle scan conversion using 2D homogeneous coordinates", 1997). Neither the sides of an
//! image nor its near plane create an edge that would have to be inset.
//!
//! **Joints** close the line at which two polygons meet. Let P and Q have edges on one line e through space and lie on
//! opposite sides of it in the image. Let R be the pixels wholly inside all edges of P but e and all edges of Q but e. A
//! point of R is either on P's side of e, then it is inside all edges of P, or on Q's side, then it is inside all of Q's,
//! or on e, then on the border of both, which belongs to them. So each point of R is covered, at the farther of both
//! planes' depths at worst, and no other border of either can touch these pixels. [`crate::Occluders`] lists such pairs; only edges
//! that lie on *exactly* one line are paired.
//!
//! Eyes in a ball see past edges, so for a region with a radius edges and joints are others: [`crate::under_region`].

use std::sync::Arc;

use glam::{DVec3, Vec3};

use crate::occluders::Occluders;
use crate::portals::{LOOKS_MAX, Portals};
use crate::under_extent::{Extent, Reach, Seen};
use crate::under_face::{Face, Region};
use crate::under_region::NARROW;
use crate::{
    Aabb, Bound, EyeRegion, Occlusion, PartsInSight, SealedFace, SealedParts, Target, Tessellation, View, sheets,
};

/// Occluders count from this many near distances on, along the image's axis. A camera that is turned by θ against it
/// still has them beyond its own near plane if cos θ ≥ 1/2: true up to 120° of diagonal angle of view.
pub(crate) const OCCLUDER_NEAR: f64 = 2.0;

/// Unit roundoff of f64 with room: errors below are a handful of roundings each.
pub(crate) const ROUNDING: f64 = 64.0 * f64::EPSILON;

/// How far a rectangle of a bound is rounded outward, in pixels: projecting it takes a few roundings of f64.
const OUTWARD_PX: f64 = 1e-6;

/// A single view from a ball of radius ρ is widened by the share ρ / `MARGIN_DEPTH`, at most by [`MARGIN_MAX`]: then no eye
/// of the ball sees past the margin at more than about this depth in metres.
const MARGIN_DEPTH: f64 = 1.5;

/// The widest margin. Each share of the image that it takes makes the rest coarser.
const MARGIN_MAX: f64 = 0.5;

/// Why an occlusion cannot be made.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum RegionError {
    /// The radius of the eye region is negative, infinite or no number.
    #[error("an eye region of radius {0} m is no ball")]
    NotABall(f64),
    /// The eye is not a finite point.
    #[error("the eye is not a finite point")]
    NotFinite,
}

/// What drawing took. Counters since [`UnderOcclusion::start`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct UnderStats {
    /// Polygons that face the eye and were drawn.
    pub polygons: u64,
    /// Joints between them that were drawn.
    pub joints: u64,
}

/// Depths at which the view from a point, or from every point of a ball, is certainly closed.
#[derive(Clone, Debug)]
pub struct UnderOcclusion {
    occluders: Arc<Occluders>,
    image: Image,
    /// What is seen through doors, where [`crate::RegionCuller`] asked.
    pub(crate) portals: Portals,
    /// Whether doors are all that is asked, and no image was drawn.
    is_all_doors: bool,
    /// In which parts of the scene the eyes are, where somebody knows of parts.
    parts: Option<PartsInSight>,
}

/// All of it but the occluders, so that drawing can borrow those.
#[derive(Clone, Debug)]
pub(crate) struct Image {
    /// Centre of the eyes' ball.
    pub eye: DVec3,
    /// Its radius, rounded up.
    pub radius: f64,
    pub near: f64,
    /// Six cube faces with axes along the world's, or one image of any orientation.
    pub faces: Vec<Face>,
    pub aligned: bool,
    /// For one image the tangents of half its view, which is all of it for a point; pixels per unit of tangent then.
    half: [f64; 2],
    focal: f64,
    pub frame: u32,
    /// Frame in which each polygon was last drawn.
    drawn: Vec<u32>,
    /// Frame in which each polygon was last set up, and its index in `setups` (or `NONE` if it turned its back).
    slots: Vec<(u32, u32)>,
    pub setups: Vec<Setup>,
    pub edges: Vec<EdgePlane>,
    /// For a ball, the planes through its centre and each edge, beside the supporting planes in `edges`.
    pub sights: Vec<DVec3>,
    pub stats: UnderStats,
}

/// A polygon seen from this frame's eyes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Setup {
    pub edges: [u32; 2],
    pub from_behind: bool,
    /// Whether it may be fused with others: flat, and the eyes well clear of its plane.
    pub fuses: bool,
    /// `far·d` is 1/z where direction d meets the farther plane around the polygon.
    pub far: DVec3,
    /// So much less for eyes in a ball.
    pub far_less: f64,
    /// The same for the nearer plane, if the near limit may cut the polygon.
    pub near: Option<DVec3>,
}

#[derive(Clone, Copy, Debug)]
pub(crate) struct EdgePlane {
    /// Normal of the plane through the eye and the edge, inward; for eyes in a ball of the supporting plane.
    pub normal: DVec3,
    /// How far `normal·d` may be wrong, per length of d.
    pub error: f64,
}

pub(crate) const NONE: u32 = u32::MAX;

impl UnderOcclusion {
    /// All directions, in six faces of `side` × `side` pixels. Nothing is drawn yet: the eye is the origin.
    pub fn all_round(occluders: Arc<Occluders>, side: u32) -> UnderOcclusion {
        let faces = View::cube(DVec3::ZERO, side).map(|view| {
            // Quarter turns: their matrices are whole numbers, so that faces agree on their common borders.
            let axes = [DVec3::X, DVec3::Y, DVec3::NEG_Z].map(|axis| (view.orientation * axis).round());
            Face::new(axes, f64::from(side) * 0.5, side as usize, side as usize)
        });
        UnderOcclusion::new(occluders, faces.to_vec(), View::cube(DVec3::ZERO, side)[0].near, true)
    }

    /// One view: what lies outside it counts as hidden.
    pub fn single(occluders: Arc<Occluders>, view: &View) -> UnderOcclusion {
        let axes = view.axes();
        let face = Face::new(axes, view.focal_px(), view.resolution.width as usize, view.resolution.height as usize);
        let mut occlusion = UnderOcclusion::new(occluders, vec![face], view.near, false);
        occlusion.image.eye = view.eye;
        occlusion
    }

    /// This single view's memory for another view of as many pixels, to be started; none if it does not fit.
    pub(crate) fn aimed(mut self, occluders: &Arc<Occluders>, view: &View) -> Option<UnderOcclusion> {
        let face = self.image.faces.first_mut()?;
        let same = [face.width, face.height] == [view.resolution.width as usize, view.resolution.height as usize];
        if !same || self.image.aligned || !Arc::ptr_eq(occluders, &self.occluders) {
            return None;
        }
        [face.right, face.up, face.forward] = view.axes();
        let focal = view.focal_px();
        self.image.focal = focal;
        self.image.half = [face.centre_x() / focal, face.centre_y() / focal];
        self.image.near = view.near;
        Some(self)
    }

    fn new(occluders: Arc<Occluders>, faces: Vec<Face>, near: f64, aligned: bool) -> UnderOcclusion {
        let face = &faces[0];
        let image = Image {
            eye: DVec3::ZERO,
            radius: 0.0,
            near,
            half: [face.centre_x() / face.focal, face.centre_y() / face.focal],
            focal: face.focal,
            faces,
            aligned,
            frame: 1,
            drawn: vec![0; occluders.len()],
            slots: vec![(0, NONE); occluders.len()],
            setups: Vec::new(),
            edges: Vec::new(),
            sights: Vec::new(),
            stats: UnderStats::default(),
        };
        UnderOcclusion { occluders, image, portals: Portals::default(), is_all_doors: false, parts: None }
    }

    /// Knows from the next start on which parts of the scene walls seal off from each other.
    pub(crate) fn know_parts(&mut self, sealed: &Arc<SealedParts>) {
        self.parts = Some(PartsInSight::new(Arc::clone(sealed)));
    }

    /// Whether it knows of parts.
    pub(crate) fn knows_parts(&self) -> bool {
        self.parts.is_some()
    }

    /// Bytes that the image takes, the occluders apart.
    pub fn memory_bytes(&self) -> usize {
        let Image { faces, drawn, slots, setups, edges, sights, .. } = &self.image;
        faces.iter().map(Face::memory_bytes).sum::<usize>()
            + drawn.capacity() * size_of::<u32>()
            + slots.capacity() * size_of::<(u32, u32)>()
            + setups.capacity() * size_of::<Setup>()
            + edges.capacity() * size_of::<EdgePlane>()
            + sights.capacity() * size_of::<DVec3>()
    }

    /// Forgets what was drawn and looks from every eye of `region`.
    ///
    /// A single view gets a margin for the eyes beside its middle one at the cost of resolution: what lies outside the
    /// views of all of them counts as hidden.
    pub fn start(&mut self, region: EyeRegion) -> Result<(), RegionError> {
        if !(region.radius >= 0.0 && region.radius.is_finite()) {
            return Err(RegionError::NotABall(region.radius));
        }
        if !region.centre.is_finite() {
            return Err(RegionError::NotFinite);
        }
        self.portals.forget();
        self.is_all_doors = false;
        if let Some(parts) = &mut self.parts {
            parts.look(region, self.image.near);
        }
        let image = &mut self.image;
        image.eye = region.centre;
        image.radius = region.radius * (1.0 + 1e-9);
        if !image.aligned {
            let margin = 1.0 + (image.radius / MARGIN_DEPTH).min(MARGIN_MAX);
            image.faces[0].set_focal(image.focal / margin);
        }
        image.faces.iter_mut().for_each(Face::clear);
        image.setups.clear();
        image.edges.clear();
        image.sights.clear();
        image.stats = UnderStats::default();
        image.frame = image.frame.wrapping_add(1);
        if image.frame == 0 {
            image.drawn.fill(0);
            image.slots.fill((0, NONE));
            image.frame = 1;
        }
        Ok(())
    }

    /// Where one looks from.
    pub fn eye(&self) -> DVec3 {
        self.image.eye
    }

    /// What was drawn since the start.
    pub fn stats(&self) -> UnderStats {
        self.image.stats
    }

    /// The occluders that can be drawn here.
    pub fn occluders(&self) -> &Arc<Occluders> {
        &self.occluders
    }

    /// Whether every direction ends somewhere: nothing is seen that is farther than all that was drawn.
    pub fn is_closed(&self) -> bool {
        self.image.faces.iter().all(Face::is_full)
    }

    /// Draws one polygon of the occluders, once per frame, and its joints with polygons drawn before.
    pub fn draw_polygon(&mut self, polygon: u32) {
        self.image.draw_polygon(&self.occluders, polygon);
    }

    /// Whether the image alone hides a bound: all that a traversal asks. For a point it is all there is.
    pub(crate) fn covers(&self, bound: &Bound) -> bool {
        let Some(aabb) = bound.aabb() else { return false };
        let relative = Aabb::new(aabb.min - self.image.eye, aabb.max - self.image.eye);
        if !(relative.min.is_finite() && relative.max.is_finite()) || relative.is_empty() {
            return false;
        }
        let reach = Reach::of(&relative);
        let misses = |face: &Face| self.image.aligned && face.misses(&reach);
        self.image.faces.iter().all(|face| misses(face) || self.image.hides_in(face, bound, &relative))
    }

    /// Finds out what the region, which this was started with, sees through doors in a view.
    pub(crate) fn look_through_doors(&mut self, rooms: &dyn Tessellation, region: EyeRegion, view: &View) {
        let mut portals = std::mem::take(&mut self.portals);
        portals.walk(rooms, region, Some(view), LOOKS_MAX, |seal| self.believes(seal));
        self.portals = portals;
    }

    /// Finds out what the region, which this was started with, sees through doors all round. If that is known, it is all that
    /// will be asked, and nothing need be drawn: the second part is the number of windows looked through.
    pub(crate) fn look_through_doors_only(&mut self, rooms: &dyn Tessellation, region: EyeRegion) -> (bool, usize) {
        let mut portals = std::mem::take(&mut self.portals);
        portals.walk(rooms, region, None, LOOKS_MAX_ALL_ROUND, |seal| self.believes(seal));
        self.is_all_doors = portals.speak();
        self.portals = portals;
        (self.is_all_doors, self.portals.looks())
    }

    /// Pixels per unit of tangent.
    pub(crate) fn focal(&self) -> f64 {
        self.image.faces[0].focal
    }
}

/// Least and greatest height, and the greatest sum of a corner's coordinates from the eye, which rounding is relative to.
pub(crate) struct Heights {
    pub low: f64,
    pub high: f64,
    pub longest: f64,
}

impl Image {
    fn draw_polygon(&mut self, occluders: &Occluders, polygon: u32) {
        let frame = self.frame;
        if std::mem::replace(&mut self.drawn[polygon as usize], frame) == frame {
            return;
        }
        if occluders.polygons[polygon as usize].width < NARROW * self.radius {
            return;
        }
        let Some(setup) = self.slot(occluders, polygon) else { return };
        self.stats.polygons += 1;
        if self.radius > 0.0 {
            self.draw_for_ball(occluders, polygon);
            return;
        }
        let corners = occluders.corners(polygon);
        let planes = &self.edges[setup.edges[0] as usize..setup.edges[1] as usize];
        let aabb = &occluders.polygons[polygon as usize].aabb;
        let reach = Reach::of(&Aabb::new(aabb.min - self.eye, aabb.max - self.eye));
        for face in &mut self.faces {
            if self.aligned && face.misses(&reach) {
                continue;
            }
            let mut extent = Extent::new(face);
            for corner in corners {
                extent.add(face.local(corner.as_dvec3() - self.eye));
            }
            let Some([first, last]) = extent.rows(face, Extent::shorter, 2.0) else { continue };
            let mut region = Region::rows(face, first, last);
            for plane in planes {
                region.add(face.linear(face.local(plane.normal)), plane.error * face.reach);
            }
            limit_near(&mut region, face, &setup, self.near);
            let far = face.linear(face.local(setup.far));
            face.fill(&region, [far]);
        }
        for &[other, joint] in &occluders.joint_lists[joints_of(occluders, polygon)] {
            if self.is_drawn(other) {
                self.draw_joint(occluders, joint);
            }
        }
    }

    /// Whether the polygon was drawn in this frame and hides something.
    pub fn is_drawn(&self, polygon: u32) -> bool {
        let (frame, slot) = self.slots[polygon as usize];
        self.drawn[polygon as usize] == self.frame && frame == self.frame && slot != NONE
    }

    /// The polygon as seen from the eyes, set up at the first call in a frame. `None` if it hides nothing.
    pub fn slot(&mut self, occluders: &Occluders, polygon: u32) -> Option<Setup> {
        let (frame, slot) = self.slots[polygon as usize];
        if frame != self.frame {
            let setup = if self.radius > 0.0 {
                self.set_up_for_ball(occluders, polygon)
            } else {
                self.set_up(occluders, polygon)
            };
            self.slots[polygon as usize] = (self.frame, if setup.is_some() { self.setups.len() as u32 } else { NONE });
            self.setups.extend(setup);
            return setup;
        }
        self.setups.get(slot as usize).copied()
    }

    /// Whether the polygon hides from behind where the eyes are.
    pub fn hides_from_behind(&self, occluders: &Occluders, polygon: u32) -> bool {
        let polygon = &occluders.polygons[polygon as usize];
        polygon.two_sided && polygon.shell.is_none_or(|shell| shell.inflated(self.radius).contains(self.eye))
    }

    /// How high a polygon's corners stand over the eye along a normal.
    pub fn heights(&self, normal: DVec3, corners: &[Vec3]) -> Heights {
        let mut heights = Heights { low: f64::INFINITY, high: f64::NEG_INFINITY, longest: 0.0 };
        for corner in corners {
            let v = corner.as_dvec3() - self.eye;
            let height = normal.dot(v);
            heights.low = heights.low.min(height);
            heights.high = heights.high.max(height);
            heights.longest = heights.longest.max(v.abs().element_sum());
        }
        heights
    }

    /// The polygon's planes as seen from the eye; `None` if it is seen edge-on or from a side that hides nothing.
    fn set_up(&mut self, occluders: &Occluders, index: u32) -> Option<Setup> {
        let polygon = &occluders.polygons[index as usize];
        let from_behind_too = self.hides_from_behind(occluders, index);
        let corners = occluders.corners(index);
        let corner = |i: usize| corners[i % corners.len()].as_dvec3();
        let normal = polygon.normal;
        let Heights { low, high, longest } = self.heights(normal, corners);
        // The heights' own rounding widens the slab.
        let error = ROUNDING * longest;
        let (from_behind, near, far) = if high < -error {
            (false, high + error * 0.5, low - error)
        } else if low > error && from_behind_too {
            (true, low - error * 0.5, high + error)
        } else {
            return None;
        };
        let first = self.edges.len() as u32;
        for i in 0..corners.len() {
            let v = corner(i) - self.eye;
            let edge = corner(i + 1) - corner(i);
            // v₀ × v₁ = v₀ × (v₁ − v₀): the difference is exact or nearly so, which keeps short far edges accurate.
            let outward = v.cross(edge);
            let normal = if from_behind { outward } else { -outward };
            let error = ROUNDING * v.abs().element_sum() * edge.abs().element_sum();
            self.edges.push(EdgePlane { normal, error });
        }
        // Where the polygon's plane is beyond the near limit in all directions of an image, so is the polygon.
        let reach = self.faces[0].reach;
        let near = (near.abs() < 2.0 * reach * OCCLUDER_NEAR * self.near).then(|| normal / near);
        Some(Setup {
            edges: [first, self.edges.len() as u32],
            from_behind,
            fuses: false,
            far: normal / far,
            far_less: 0.0,
            near,
        })
    }

    /// Draws the strip along the common line of two polygons that are both drawn.
    fn draw_joint(&mut self, occluders: &Occluders, index: u32) {
        let joint = &occluders.joints[index as usize];
        let [p, q] = joint.polygons.map(|polygon| self.setups[self.slots[polygon as usize].1 as usize]);
        // Each runs anticlockwise as seen from the eye, so they lie on opposite sides iff the edges run opposite.
        if !(joint.opposite ^ p.from_behind ^ q.from_behind) {
            return;
        }
        let ends = joint.ends.map(|end| end - self.eye);
        let shared = self.edges[(p.edges[0] + joint.edges[0]) as usize];
        let reach = Reach::of(&Aabb::new(ends[0].min(ends[1]), ends[0].max(ends[1])));
        let mut drawn = false;
        for face in &mut self.faces {
            if self.aligned && face.misses(&reach) {
                continue;
            }
            let mut extent = Extent::new(face);
            for end in ends {
                extent.add(face.local(end));
            }
            let Some([first, last]) = extent.rows(face, Extent::longer, 3.0) else { continue };
            let mut region = Region::rows(face, first - 1.0, last + 1.0);
            region.add_band(face.linear(face.local(shared.normal)), shared.error * face.reach);
            for (setup, skipped) in [p, q].iter().zip(joint.edges) {
                let planes = &self.edges[setup.edges[0] as usize..setup.edges[1] as usize];
                for (edge, plane) in planes.iter().enumerate() {
                    if edge != skipped as usize {
                        region.add(face.linear(face.local(plane.normal)), plane.error * face.reach);
                    }
                }
                limit_near(&mut region, face, setup, self.near);
            }
            let far = [p, q].map(|setup| face.linear(face.local(setup.far)));
            face.fill(&region, far);
            drawn = true;
        }
        self.stats.joints += u64::from(drawn);
    }

    /// Where the bound may be in a single view, as far as any eye's view reaches. From a ball its part beside the margin
    /// counts as seen.
    ///
    /// With h the tangent of half the view, an eye e sees a point p only if p.x − e.x ≤ h·(p.z − e.z), so if
    /// p.x/p.z ≤ h + ρ·√(1 + h²)/p.z; likewise on the other sides. Without this a large box that crosses a side of the view
    /// would count as seen whatever is before it, and a traversal would follow the sides for ever.
    fn rectangle(&self, face: &Face, relative: &Aabb) -> Seen {
        let mut seen = face.rectangle(relative, self.near, self.half, self.radius);
        if let Seen::At(rectangle) = &mut seen
            && self.radius > 0.0
        {
            let reach = self.half.map(|h| h + self.radius * (1.0 + h * h).sqrt() * (1.0 + 1e-9) / rectangle.z);
            let clipped = |[low, high]: [f64; 2], reach: f64| [low.max(-reach), high.min(reach)];
            rectangle.x = clipped(rectangle.x, reach[0]);
            rectangle.y = clipped(rectangle.y, reach[1]);
            let [x, y] = [face.centre_x() / face.focal, face.centre_y() / face.focal];
            let [across, along] = [rectangle.x, rectangle.y];
            if !(-x <= across[0] && across[1] <= x && -y <= along[0] && along[1] <= y) {
                return Seen::Near;
            }
        }
        seen
    }

    /// Whether no point of the bound can be seen in one face.
    fn hides_in(&self, face: &Face, bound: &Bound, relative: &Aabb) -> bool {
        let seen = if self.aligned { face.rectangle_aligned(relative) } else { self.rectangle(face, relative) };
        let mut rectangle = match seen {
            Seen::Outside => return true,
            Seen::Near => return false,
            Seen::At(rectangle) => rectangle,
        };
        match *bound {
            Bound::Sphere { centre, radius } => rectangle.tighten(face.local(centre - self.eye), radius),
            // Where the image's vertical is the world's, the cylinder's circle lies in the x-z plane of the image.
            Bound::Upright { centre, radius, .. } if self.aligned && face.up.y == 1.0 => {
                rectangle.tighten_across(face.local(centre - self.eye), radius);
            }
            _ => {}
        }
        if rectangle.z < self.near {
            return false;
        }
        let pixels = |low: f64, high: f64, size: usize| {
            let (low, high) = ((low - OUTWARD_PX).max(0.0), (high + OUTWARD_PX).min(size as f64 - 1.0));
            // Truncation rounds the low end outward; the pixel that contains the high end is the last.
            (low < size as f64 && high >= 0.0 && low <= high + 1.0).then_some([low as usize, high as usize])
        };
        let (f, cx, cy) = (face.focal, face.centre_x(), face.centre_y());
        let [Some(x), Some(y)] = [
            pixels(cx + f * rectangle.x[0], cx + f * rectangle.x[1], face.width),
            pixels(cy - f * rectangle.y[1], cy - f * rectangle.y[0], face.height),
        ] else {
            return true;
        };
        let (x, y) = ([x[0].min(x[1]), x[1]], [y[0].min(y[1]), y[1]]);
        face.covers(x, y, (1.000_001 / rectangle.z) as f32)
    }
}

/// So many windows are looked through all round, where doors are to do instead of an image: each costs about a microsecond.
const LOOKS_MAX_ALL_ROUND: usize = 1024;

impl Occlusion for UnderOcclusion {
    fn hides(&self, bound: &Bound) -> bool {
        self.portals.hides(bound)
            || !self.is_all_doors
                && (self.covers(bound) || self.image.radius > 0.0 && sheets::hide(&self.image, &self.occluders, bound))
    }

    fn hides_group(&self, around: &Bound) -> bool {
        self.portals.hides(around) || !self.is_all_doors && self.covers(around)
    }

    fn version(&self) -> Option<u64> {
        // Within a frame it changes with each polygon that is drawn.
        Some(u64::from(self.image.frame) << 32 | self.image.stats.polygons)
    }

    fn parts(&self) -> Option<&[u32]> {
        self.parts.as_ref()?.parts()
    }

    fn seals_off(&self, bound: &Bound) -> bool {
        self.parts.as_ref().is_some_and(|parts| parts.seal_off(bound))
    }
}

impl Target for UnderOcclusion {
    fn draw(&mut self, primitives: &[u32]) {
        for &primitive in primitives {
            let Some(polygon) = self.occluders.polygon_of(primitive) else { continue };
            // From a ball, drawing costs many times what asking costs, and much of a cell is hidden by the rest of it.
            let is_new = self.image.radius > 0.0 && !self.image.is_drawn(polygon);
            if is_new && self.covers(&Bound::Box(self.occluders.polygons[polygon as usize].aabb)) {
                continue;
            }
            self.draw_polygon(polygon);
        }
    }

    fn sees(&self, aabb: &Aabb) -> bool {
        !self.covers(&Bound::Box(*aabb))
    }

    /// Rays decide here, and no ray passes a sealed face but where a camera's near plane cuts it open.
    fn believes(&self, seal: &SealedFace<'_>) -> bool {
        let image = &self.image;
        // A near plane cuts by the distance along the axis, which `reach` makes one along the ray; see `OCCLUDER_NEAR`.
        let reach = if image.aligned { 1.0 } else { image.faces[0].reach };
        seal.rectangle.distance(image.eye) - image.radius >= OCCLUDER_NEAR * image.near * reach
    }

    /// Never: what is closed may still be closed by something nearer. See [`UnderOcclusion::is_closed`].
    fn is_full(&self) -> bool {
        false
    }
}

pub(crate) fn joints_of(occluders: &Occluders, polygon: u32) -> std::ops::Range<usize> {
    let joints = &occluders.polygons[polygon as usize].joints;
    joints.start as usize..joints.end as usize
}

/// Leaves out pixels in which the polygon comes nearer than the limit. 1/z is linear too, so this is one more edge.
fn limit_near(region: &mut Region, face: &Face, setup: &Setup, near: f64) {
    if let Some(plane) = setup.near {
        let w_max = 1.0 / (OCCLUDER_NEAR * near);
        let n = DVec3::new(0.0, 0.0, w_max) - face.local(plane);
        region.add(face.linear(n), ROUNDING * (w_max + plane.length()) * face.reach);
    }
}
