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

use std::sync::Arc;

use glam::DVec3;

use crate::occluders::Occluders;
use crate::under_face::{Face, Region};
use crate::{Aabb, Bound, EyeRegion, Occlusion, SealedFace, Target, View};

/// Occluders count from this many near distances on, along the image's axis. A camera that is turned by θ against it
/// still has them beyond its own near plane if cos θ ≥ 1/2: true up to 120° of diagonal angle of view.
const OCCLUDER_NEAR: f64 = 2.0;

/// Unit roundoff of f64 with room: errors below are a handful of roundings each.
const ROUNDING: f64 = 64.0 * f64::EPSILON;

/// How far a rectangle of a bound is rounded outward, in pixels: projecting it takes a few roundings of f64.
const OUTWARD_PX: f64 = 1e-6;

/// Why an occlusion cannot be made.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum RegionError {
    /// Visibility from a ball is not the visibility of inflated bounds from its centre, so it is refused, not faked.
    #[error("an eye region of radius {0} m is not supported by this culler, only points are")]
    NotAPoint(f64),
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

/// Depths at which the view from a point is certainly closed, by under-estimating coverage.
pub struct UnderOcclusion {
    occluders: Arc<Occluders>,
    image: Image,
}

/// All of it but the occluders, so that drawing can borrow those.
struct Image {
    eye: DVec3,
    near: f64,
    /// Six cube faces with axes along the world's, or one image of any orientation.
    faces: Vec<Face>,
    aligned: bool,
    frame: u32,
    /// Frame in which each polygon was last drawn, and its index in `setups` (or `NONE` if it turned its back).
    drawn: Vec<(u32, u32)>,
    setups: Vec<Setup>,
    edges: Vec<EdgePlane>,
    stats: UnderStats,
}

/// A polygon seen from this frame's eye.
#[derive(Clone, Copy)]
struct Setup {
    edges: [u32; 2],
    from_behind: bool,
    /// `far·d` is 1/z where direction d meets the farther plane around the polygon.
    far: DVec3,
    /// The same for the nearer plane, if the near limit may cut the polygon.
    near: Option<DVec3>,
}

#[derive(Clone, Copy)]
struct EdgePlane {
    /// Normal of the plane through the eye and the edge, inward.
    normal: DVec3,
    /// How far `normal·d` may be wrong, per length of d.
    error: f64,
}

const NONE: u32 = u32::MAX;

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
        let axes = [DVec3::X, DVec3::Y, DVec3::NEG_Z].map(|axis| view.orientation * axis);
        let face = Face::new(axes, view.focal_px(), view.resolution.width as usize, view.resolution.height as usize);
        let mut occlusion = UnderOcclusion::new(occluders, vec![face], view.near, false);
        occlusion.image.eye = view.eye;
        occlusion
    }

    fn new(occluders: Arc<Occluders>, faces: Vec<Face>, near: f64, aligned: bool) -> UnderOcclusion {
        let drawn = vec![(0, NONE); occluders.len()];
        let image = Image {
            eye: DVec3::ZERO,
            near,
            faces,
            aligned,
            frame: 1,
            drawn,
            setups: Vec::new(),
            edges: Vec::new(),
            stats: UnderStats::default(),
        };
        UnderOcclusion { occluders, image }
    }

    /// Forgets what was drawn and looks from `region`, which must be a point.
    pub fn start(&mut self, region: EyeRegion) -> Result<(), RegionError> {
        if region.radius != 0.0 {
            return Err(RegionError::NotAPoint(region.radius));
        }
        if !region.centre.is_finite() {
            return Err(RegionError::NotFinite);
        }
        let image = &mut self.image;
        image.eye = region.centre;
        image.faces.iter_mut().for_each(Face::clear);
        image.setups.clear();
        image.edges.clear();
        image.stats = UnderStats::default();
        image.frame = image.frame.wrapping_add(1);
        if image.frame == 0 {
            image.drawn.fill((0, NONE));
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

    /// Draws one polygon of the occluders, once per frame, and its joints with polygons drawn before.
    pub fn draw_polygon(&mut self, polygon: u32) {
        self.image.draw_polygon(&self.occluders, polygon);
    }

    /// Pixels per unit of tangent.
    pub(crate) fn focal(&self) -> f64 {
        self.image.faces[0].focal
    }
}

impl Image {
    fn draw_polygon(&mut self, occluders: &Occluders, polygon: u32) {
        let frame = self.frame;
        if std::mem::replace(&mut self.drawn[polygon as usize].0, frame) == frame {
            return;
        }
        self.drawn[polygon as usize].1 = NONE;
        let Some(setup) = self.set_up(occluders, polygon) else { return };
        self.drawn[polygon as usize].1 = self.setups.len() as u32;
        self.setups.push(setup);
        self.stats.polygons += 1;
        let corners = occluders.corners(polygon);
        let planes = &self.edges[setup.edges[0] as usize..setup.edges[1] as usize];
        let aabb = &occluders.polygons[polygon as usize].aabb;
        let relative = Aabb::new(aabb.min - self.eye, aabb.max - self.eye);
        for face in &mut self.faces {
            if self.aligned && matches!(face.rectangle_aligned(&relative), Seen::Outside) {
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
            let (frame, slot) = self.drawn[other as usize];
            if frame == self.frame && slot != NONE {
                self.draw_joint(occluders, joint);
            }
        }
    }

    /// The polygon's planes as seen from the eye; `None` if it is seen edge-on or from a side that hides nothing.
    fn set_up(&mut self, occluders: &Occluders, index: u32) -> Option<Setup> {
        let polygon = &occluders.polygons[index as usize];
        let from_behind_too = polygon.two_sided && polygon.shell.is_none_or(|shell| shell.contains(self.eye));
        let corners = occluders.corners(index);
        let corner = |i: usize| corners[i % corners.len()].as_dvec3();
        let normal = polygon.normal;
        let (mut low, mut high, mut longest) = (f64::INFINITY, f64::NEG_INFINITY, 0.0_f64);
        for i in 0..corners.len() {
            let v = corner(i) - self.eye;
            let height = normal.dot(v);
            low = low.min(height);
            high = high.max(height);
            longest = longest.max(v.abs().element_sum());
        }
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
        Some(Setup { edges: [first, self.edges.len() as u32], from_behind, far: normal / far, near })
    }

    /// Draws the strip along the common line of two polygons that are both drawn.
    fn draw_joint(&mut self, occluders: &Occluders, index: u32) {
        let joint = &occluders.joints[index as usize];
        let [p, q] = joint.polygons.map(|polygon| self.setups[self.drawn[polygon as usize].1 as usize]);
        // Each runs anticlockwise as seen from the eye, so they lie on opposite sides iff the edges run opposite.
        if !(joint.opposite ^ p.from_behind ^ q.from_behind) {
            return;
        }
        let ends = joint.ends.map(|end| end - self.eye);
        let shared = self.edges[(p.edges[0] + joint.edges[0]) as usize];
        let relative = Aabb::new(ends[0].min(ends[1]), ends[0].max(ends[1]));
        let mut drawn = false;
        for face in &mut self.faces {
            if self.aligned && matches!(face.rectangle_aligned(&relative), Seen::Outside) {
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

    /// Whether no point of the bound can be seen in one face.
    fn hides_in(&self, face: &Face, bound: &Bound, relative: &Aabb) -> bool {
        let seen = if self.aligned { face.rectangle_aligned(relative) } else { face.rectangle(relative, self.near) };
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

impl Occlusion for UnderOcclusion {
    fn hides(&self, bound: &Bound) -> bool {
        let Some(aabb) = bound.aabb() else { return false };
        let relative = Aabb::new(aabb.min - self.image.eye, aabb.max - self.image.eye);
        if !(relative.min.is_finite() && relative.max.is_finite()) || relative.is_empty() {
            return false;
        }
        self.image.faces.iter().all(|face| self.image.hides_in(face, bound, &relative))
    }
}

impl Target for UnderOcclusion {
    fn draw(&mut self, primitives: &[u32]) {
        for &primitive in primitives {
            if let Some(polygon) = self.occluders.polygon_of(primitive) {
                self.draw_polygon(polygon);
            }
        }
    }

    fn sees(&self, aabb: &Aabb) -> bool {
        !self.hides(&Bound::Box(*aabb))
    }

    /// Rays decide here, and no ray passes a sealed face but where a camera's near plane cuts it open.
    fn believes(&self, seal: &SealedFace<'_>) -> bool {
        seal.rectangle.distance(self.image.eye) >= OCCLUDER_NEAR * self.image.near
    }

    fn is_full(&self) -> bool {
        self.image.faces.iter().all(Face::is_full)
    }
}

fn joints_of(occluders: &Occluders, polygon: u32) -> std::ops::Range<usize> {
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

/// Which rows of an image a convex hull of points can touch.
struct Extent {
    /// Sides of the frustum that all points so far are outside of: left, right, bottom, top, behind.
    outside: u8,
    /// Whether all points are in front of the eye.
    in_front: bool,
    x: [f64; 2],
    y: [f64; 2],
    half: [f64; 2],
}

impl Extent {
    fn new(face: &Face) -> Extent {
        let half = [face.centre_x() / face.focal, face.centre_y() / face.focal];
        let none = [f64::INFINITY, f64::NEG_INFINITY];
        Extent { outside: 0b11111, in_front: true, x: none, y: none, half }
    }

    #[inline]
    fn add(&mut self, v: DVec3) {
        let code = u8::from(v.x < -v.z * self.half[0])
            | u8::from(v.x > v.z * self.half[0]) << 1
            | u8::from(v.y < -v.z * self.half[1]) << 2
            | u8::from(v.y > v.z * self.half[1]) << 3
            | u8::from(v.z <= 0.0) << 4;
        self.outside &= code;
        if v.z > 1e-9 {
            let inverse = 1.0 / v.z;
            let (x, y) = (v.x * inverse, v.y * inverse);
            self.x = [self.x[0].min(x), self.x[1].max(x)];
            self.y = [self.y[0].min(y), self.y[1].max(y)];
        } else {
            self.in_front = false;
        }
    }

    /// The lesser extent of the two axes, in tangents.
    fn shorter(&self) -> f64 {
        (self.x[1] - self.x[0]).min(self.y[1] - self.y[0])
    }

    /// The greater extent.
    fn longer(&self) -> f64 {
        (self.x[1] - self.x[0]).max(self.y[1] - self.y[0])
    }

    /// First and last row whose pixels may be touched, or none: also if `extent` is below `least_px` pixels, where the
    /// work is not worth it. Leaving something out is always right.
    fn rows(&self, face: &Face, extent: fn(&Extent) -> f64, least_px: f64) -> Option<[f64; 2]> {
        if self.outside != 0 {
            return None;
        }
        if !self.in_front {
            return Some([0.0, f64::INFINITY]);
        }
        if extent(self) * face.focal < least_px {
            return None;
        }
        let row = |y: f64| face.centre_y() - face.focal * y;
        Some([row(self.y[1]).floor(), row(self.y[0]).floor()])
    }
}

enum Seen {
    /// No point is in the image.
    Outside,
    /// It touches the eye or the near plane.
    Near,
    At(Rectangle),
}

/// Tangents that a bound may take in an image, and its least depth there.
struct Rectangle {
    x: [f64; 2],
    y: [f64; 2],
    z: f64,
}

impl Face {
    /// A box with sides along the image's axes, exact up to rounding.
    ///
    /// In the image, z is at least |x| and |y| (90°), so the nearest point of the box there has
    /// z = max(least z, least |x|, least |y|), and x/z is extreme at that z or at the greatest one.
    #[inline]
    fn rectangle_aligned(&self, relative: &Aabb) -> Seen {
        let along = |axis: DVec3| {
            let (a, b) = (axis.dot(relative.min), axis.dot(relative.max));
            if a < b { [a, b] } else { [b, a] }
        };
        let z = along(self.forward);
        // Most faces are done here. A box that touches the eye has z[1] = 0 at least.
        if z[1] < 0.0 {
            return Seen::Outside;
        }
        let (x, y) = (along(self.right), along(self.up));
        let least = |[low, high]: [f64; 2]| low.max(-high).max(0.0);
        let nearest = z[0].max(least(x)).max(least(y));
        if z[1] < nearest {
            return Seen::Outside;
        }
        if nearest <= 0.0 {
            return Seen::Near;
        }
        let (inverse_near, inverse_far) = (1.0 / nearest, 1.0 / z[1]);
        let tangents = |[low, high]: [f64; 2]| {
            let low = low * if low < 0.0 { inverse_near } else { inverse_far };
            let high = high * if high > 0.0 { inverse_near } else { inverse_far };
            [low.max(-1.0), high.min(1.0)]
        };
        Seen::At(Rectangle { x: tangents(x), y: tangents(y), z: nearest })
    }

    /// Any box in any image: by its corners if all are beyond the near plane.
    fn rectangle(&self, relative: &Aabb, near: f64) -> Seen {
        let corners = relative.corners().map(|corner| self.local(corner));
        let size = relative.min.abs().max(relative.max.abs()).element_sum();
        let slack = ROUNDING * size;
        let half = [self.centre_x() / self.focal, self.centre_y() / self.focal];
        let outside = |distance: fn(DVec3, [f64; 2]) -> f64| corners.iter().all(|&c| distance(c, half) > 4.0 * slack);
        if outside(|c, _| -c.z)
            || outside(|c, [h, _]| c.x - c.z * h)
            || outside(|c, [h, _]| -c.x - c.z * h)
            || outside(|c, [_, h]| c.y - c.z * h)
            || outside(|c, [_, h]| -c.y - c.z * h)
        {
            return Seen::Outside;
        }
        let z = corners.iter().map(|c| c.z).fold(f64::INFINITY, f64::min) - slack;
        if z < near {
            return Seen::Near;
        }
        let range = |tangent: &dyn Fn(&DVec3) -> f64| {
            let values = || corners.iter().map(tangent);
            [values().fold(f64::INFINITY, f64::min), values().fold(f64::NEG_INFINITY, f64::max)]
        };
        // A corner's tangent is wrong by at most 3·slack/z; the rest is OUTWARD_PX's.
        let [x, y] = [range(&|c| c.x / c.z), range(&|c| c.y / c.z)].map(|[low, high]| {
            let error = 3.0 * slack / z * (1.0 + low.abs().max(high.abs()));
            [low - error, high + error]
        });
        Seen::At(Rectangle { x, y, z })
    }
}

impl Rectangle {
    /// Intersects with the silhouette of a ball, where it lies wholly in front.
    fn tighten(&mut self, centre: DVec3, radius: f64) {
        self.tighten_across(centre, radius);
        if let Some([low, high]) = touch(centre.y, centre.z, radius) {
            self.y = [self.y[0].max(low), self.y[1].min(high)];
        }
    }

    /// The same across the image only: for an upright cylinder in an upright image.
    fn tighten_across(&mut self, centre: DVec3, radius: f64) {
        if let Some([low, high]) = touch(centre.x, centre.z, radius) {
            self.z = self.z.max((centre.z - radius) * (1.0 - 1e-9));
            self.x = [self.x[0].max(low), self.x[1].min(high)];
        }
    }
}

/// Tangents of the lines x = m·z that touch a circle in the x-z plane: (x − m·z)² = r²(1 + m²). `None` unless it lies
/// wholly in front: rounding grows without limit as the eye nears the circle, and a box will do there.
fn touch(x: f64, z: f64, radius: f64) -> Option<[f64; 2]> {
    if z - radius < 0.01 * z {
        return None;
    }
    let scale = 1.0 / (z * z - radius * radius);
    let root = radius * (x * x + z * z - radius * radius).max(0.0).sqrt();
    let (low, high) = ((x * z - root) * scale, (x * z + root) * scale);
    let slack = 1e-9 * (1.0 + low.abs().max(high.abs()));
    Some([low - slack, high + slack])
}
