//! Does a wall in a cell face hide what is behind it, at the pixel centres of this very image?
//!
//! Let F be a [`SealedFace`] out of a cell A that has been drawn, and S = [`SNAP_PX`]. Suppose that a primitive wins the pixel
//! with centre p in the plain Z-buffer's picture, as its point q says: q lies within S of p in the image and at the pixel's
//! depth (`setup` says why there is such a q). Suppose that the segment from the eye to q crosses F, at r. Then, if
//! [`holds`], q is within `skin` of r, so that A lists the primitive, and A is drawn. The traversal needs no more: it follows
//! the segment up to the first seal that it believes.
//!
//! 1. *p is covered, and no deeper than F's plane about there.* Where p is farther than 2S from the border of F's image and
//!    from its cracks, the seal's edges do not come within 2S of p, apart from those that cancel. Snapping moves an edge
//!    by at most S, so it carries none over p, and the number of times that the snapped triangles wind round p stays what it
//!    was, at least 1. Edges that cancel have the same corners, which snap to the same places. So some snapped triangle
//!    covers p and is still turned to the eye, at the depth of a point of F's plane within S of p. (The fill rule decides
//!    ties as if p were moved by next to nothing.) The remaining pixels, those within 2S of border and cracks, are few:
//!    they are visited, and must have a depth of F's plane within 2S, or a nearer one.
//! 2. *q is near r.* Reversed depth is linear over the image, with gradient g. By 1 the winner's depth is at most 2S·|g| less
//!    than the plane's at p, so at most 3S·|g| less than at r's place, which is q's. q is on r's ray and no nearer than r. So
//!    the ray goes on for a length that is bounded over all of F, and that must be at most `skin`. Here it is bounded with 4S.
//! 3. *Near plane, and what is out of view.* Only the part of F in the image's pyramid (grown by a pixel) can hold r. That
//!    part must lie beyond the near plane by a margin of the same kind, or the wall would be cut open there.

use glam::DVec3;

use super::setup::{DEPTH_SLACK, Projector, SNAP_PX, ViewPoint};
use crate::{Aabb, SealedFace};

/// Whether the argument above holds for a face in the image of `projector`, whose pixels have at least depth `depth_at`.
pub(crate) fn holds(projector: &Projector, seal: &SealedFace<'_>, depth_at: impl Fn(usize, usize) -> f32) -> bool {
    let axis = seal.face.axis();
    let plane = seal.rectangle.min[axis];
    let corners = rectangle_corners(&seal.rectangle, axis).map(|corner| projector.view_point(corner));
    let seen = in_pyramid(projector, &corners);
    if seen.count == 0 {
        return true;
    }
    let height = plane - projector.eye()[axis];
    let sign = if seal.face.is_positive() { 1.0 } else { -1.0 };
    if height * sign <= 0.0 {
        // From behind, or from within the plane, no segment crosses the face in its direction.
        return true;
    }
    // 1/w of the plane along the ray of pixel (x, y) is a sum over the ray's own x, y and 1.
    let per_ray = projector.axes().map(|direction| direction[axis] / height);
    let z = |x: f64, y: f64| {
        let right = (x - projector.middle[0]) / projector.focal_px;
        let up = (projector.middle[1] - y) / projector.focal_px;
        projector.near * (right * per_ray[0] + up * per_ray[1] + per_ray[2])
    };
    let gradient = projector.near * (per_ray[0].abs() + per_ray[1].abs()) / projector.focal_px;
    let (mut nearest, mut farthest, mut slant) = (f64::INFINITY, 0.0_f64, 0.0_f64);
    for p in seen.corners() {
        nearest = nearest.min(p.w);
        farthest = farthest.max(p.w);
        slant = slant.max((p.x / p.w).abs() + (p.y / p.w).abs());
    }
    let beyond_near = projector.near / nearest + 4.0 * SNAP_PX * gradient < 0.999;
    let share = 4.0 * SNAP_PX * gradient / projector.near * farthest + 8.0 * DEPTH_SLACK;
    let near_r = share < 0.5 && farthest * (1.0 + slant) * share / (1.0 - share) <= seal.skin;
    if !beyond_near || !near_r {
        return false;
    }
    let (width, height) = (projector.width, projector.height);
    let closed = |x: i32, y: i32| {
        if x < 0 || y < 0 || x >= width || y >= height {
            return true;
        }
        let needed = z(f64::from(x) + 0.5, f64::from(y) + 0.5) - 2.0 * SNAP_PX * gradient;
        f64::from(depth_at(x as usize, y as usize)) >= needed * (1.0 - 2.0 * DEPTH_SLACK)
    };
    let border = (0..4).map(|i| [corners[i], corners[(i + 1) % 4]]);
    let cracks = seal.cracks.iter().map(|crack| crack.map(|end| projector.view_point(end)));
    border.chain(cracks).all(|ends| centres_along(projector, &ends, closed))
}

/// The corners of a flat box, once round.
fn rectangle_corners(aabb: &Aabb, axis: usize) -> [DVec3; 4] {
    let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
    let corner = |at_u: f64, at_v: f64| {
        let mut corner = aabb.min;
        corner[u] = at_u;
        corner[v] = at_v;
        corner
    };
    [
        corner(aabb.min[u], aabb.min[v]),
        corner(aabb.max[u], aabb.min[v]),
        corner(aabb.max[u], aabb.max[v]),
        corner(aabb.min[u], aabb.max[v]),
    ]
}

/// A convex polygon of at most eight corners: a rectangle cut by four planes. Kept off the heap, since there is one per
/// seal and edge.
#[derive(Clone, Copy)]
struct Polygon {
    corners: [ViewPoint; 8],
    count: usize,
}

impl Polygon {
    fn corners(&self) -> &[ViewPoint] {
        &self.corners[..self.count]
    }

    /// The part where `height` is at least 0.
    fn clip(&mut self, height: impl Fn(&ViewPoint) -> f64) {
        if self.corners().iter().all(|corner| height(corner) >= 0.0) {
            return;
        }
        let whole = *self;
        self.count = 0;
        for (i, here) in whole.corners().iter().enumerate() {
            let next = &whole.corners()[(i + 1) % whole.count];
            let (h, n) = (height(here), height(next));
            if h >= 0.0 {
                self.push(*here);
            }
            if (h >= 0.0) != (n >= 0.0) {
                let mix = |from: f64, to: f64| from + (to - from) * (h / (h - n));
                self.push(ViewPoint { x: mix(here.x, next.x), y: mix(here.y, next.y), w: mix(here.w, next.w) });
            }
        }
    }

    fn push(&mut self, corner: ViewPoint) {
        // A convex polygon gains a corner per cut; rounding may make it dent and gain more, and the last one then gives way.
        self.count = (self.count + 1).min(8);
        self.corners[self.count - 1] = corner;
    }
}

/// The part of a polygon, or of a segment, in the pyramid of the image grown by a pixel.
fn in_pyramid<const N: usize>(projector: &Projector, points: &[ViewPoint; N]) -> Polygon {
    let mut polygon = Polygon { corners: [points[0]; 8], count: N };
    polygon.corners[..N].copy_from_slice(points);
    let f = projector.focal_px;
    let [kx, ky] = projector.middle.map(|half| half + 1.0);
    polygon.clip(|p| kx * p.w - f * p.x);
    polygon.clip(|p| kx * p.w + f * p.x);
    polygon.clip(|p| ky * p.w - f * p.y);
    polygon.clip(|p| ky * p.w + f * p.y);
    polygon
}

/// Whether a predicate holds for all pixels whose centre is within 2 · [`SNAP_PX`] of a segment's image.
fn centres_along(projector: &Projector, ends: &[ViewPoint; 2], mut closed: impl FnMut(i32, i32) -> bool) -> bool {
    // Somewhat more than 2 · SNAP_PX along the minor axis, where the line is at most as steep as the diagonal.
    const REACH: f64 = 4.0 * SNAP_PX;
    let seen = in_pyramid(projector, ends);
    if seen.count == 0 {
        return true;
    }
    let place = |p: &ViewPoint| {
        let per_metre = projector.focal_px / p.w;
        [projector.middle[0] + p.x * per_metre - 0.5, projector.middle[1] - p.y * per_metre - 0.5]
    };
    let from = place(&seen.corners[0]);
    // A clipped segment may come back as its ends in any number; the farthest from the first is the other one.
    let distance = |to: &[f64; 2]| (to[0] - from[0]).abs() + (to[1] - from[1]).abs();
    let to = seen.corners().iter().map(place).max_by(|a, b| distance(a).total_cmp(&distance(b))).unwrap_or(from);
    let major = usize::from((to[1] - from[1]).abs() > (to[0] - from[0]).abs());
    let (from, to) = if from[major] <= to[major] { (from, to) } else { (to, from) };
    let length = to[major] - from[major];
    let slope = if length > 0.0 { (to[1 - major] - from[1 - major]) / length } else { 0.0 };
    let first = (from[major] - REACH).ceil();
    let last = (to[major] + REACH).floor();
    let mut at = first;
    while at <= last {
        let along = (at - from[major]).clamp(0.0, length);
        let across = from[1 - major] + along * slope;
        let centre = across.round();
        if (across - centre).abs() <= REACH {
            let pixel = if major == 0 { [at, centre] } else { [centre, at] };
            if !closed(pixel[0] as i32, pixel[1] as i32) {
                return false;
            }
        }
        at += 1.0;
    }
    true
}
