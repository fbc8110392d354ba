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
//!    they are visited, and must have a depth of F's plane within 2S, or a nearer one; or one that is farther by no more
//!    than the skin has to spare after 2, since images lower their depths.
//! 2. *q is near r.* Reversed depth is linear over the image, with gradient g. By 1 the winner's depth is at most 2S·|g| less
//!    than the plane's at p, so at most 3S·|g| less than at r's place, which is q's. q is on r's ray and no nearer than r. So
//!    the ray goes on for a length that is bounded over all of F, and that must be at most `skin`. Here it is bounded with 4S,
//!    and what is left of the skin is a share of the depth that 1 may forgive.
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
    let sides = Sides::new(projector);
    let heights = corners.each_ref().map(|corner| sides.heights(corner));
    if (0..4).any(|side| heights.iter().all(|heights| heights[side] < 0.0)) {
        return true;
    }
    let height = plane - projector.eye()[axis];
    let sign = if seal.face.is_positive() { 1.0 } else { -1.0 };
    if height * sign <= 0.0 {
        // From behind, or from within the plane, no segment crosses the face in its direction.
        return true;
    }
    // What is nearer than the near plane is mostly out of view. The part in view is not needed otherwise: all of the face
    // bounds it.
    let mut seen = Polygon { corners: [corners[0]; 8], count: 4 };
    seen.corners[..4].copy_from_slice(&corners);
    if corners.iter().any(|corner| corner.w <= 2.0 * projector.near) {
        sides.clip(&mut seen);
        if seen.count == 0 {
            return true;
        }
    }
    // 1/w of the plane along the ray of pixel (x, y) is a sum over the ray's own x, y and 1.
    let per_ray = projector.axes().map(|direction| direction[axis] / height);
    let gradient = projector.near * (per_ray[0].abs() + per_ray[1].abs()) / projector.focal_px;
    let (mut nearest, mut farthest, mut slant) = (f64::INFINITY, 0.0_f64, 0.0_f64);
    for p in seen.corners() {
        nearest = nearest.min(p.w);
        farthest = farthest.max(p.w);
        slant = slant.max((p.x.abs() + p.y.abs()) / p.w);
    }
    let slant = slant.min((sides.x + sides.y) / projector.focal_px);
    let beyond_near = projector.near / nearest + 4.0 * SNAP_PX * gradient < 0.999;
    // The share of its depth that the winner may lack: as the skin allows, less what places in the image take.
    let most = seal.skin / (farthest * (1.0 + slant) + seal.skin);
    let spare = most - 4.0 * SNAP_PX * gradient / projector.near * farthest - 8.0 * DEPTH_SLACK;
    if !(beyond_near && spare >= 0.0) {
        return false;
    }
    let slope = [per_ray[0], -per_ray[1]].map(|per_pixel| projector.near * per_pixel / projector.focal_px);
    let [column, row] = projector.middle.map(|middle| middle - 0.5);
    let origin = projector.near * per_ray[2] - slope[0] * column - slope[1] * row - 2.0 * SNAP_PX * gradient;
    let closed = |x: i32, y: i32| {
        let needed = origin + slope[0] * f64::from(x) + slope[1] * f64::from(y);
        f64::from(depth_at(x as usize, y as usize)) >= needed * (1.0 - 2.0 * DEPTH_SLACK - spare)
    };
    let next = [1, 2, 3, 0];
    (0..4).all(|i| centres_along(projector, [corners[i], corners[next[i]]], [heights[i], heights[next[i]]], closed))
        && seal.cracks.iter().all(|crack| {
            let ends = crack.map(|end| projector.view_point(end));
            centres_along(projector, ends, ends.each_ref().map(|end| sides.heights(end)), closed)
        })
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

/// The sides of the image's pyramid, grown by a pixel.
struct Sides {
    /// Pixels from the image's middle.
    x: f64,
    y: f64,
    focal: f64,
}

impl Sides {
    fn new(projector: &Projector) -> Sides {
        let [x, y] = projector.middle.map(|half| half + 1.0);
        Sides { x, y, focal: projector.focal_px }
    }

    /// Heights over each.
    #[inline(always)]
    fn heights(&self, p: &ViewPoint) -> [f64; 4] {
        let (x, y) = (self.focal * p.x, self.focal * p.y);
        let (reach_x, reach_y) = (self.x * p.w, self.y * p.w);
        [reach_x - x, reach_x + x, reach_y - y, reach_y + y]
    }

    /// Cuts a polygon to the part inside.
    fn clip(&self, polygon: &mut Polygon) {
        for side in 0..4 {
            polygon.clip(|p| self.heights(p)[side]);
        }
    }

    /// The ends of a segment's part inside, given the heights of the whole segment's.
    #[inline(always)]
    fn clip_segment([a, b]: [ViewPoint; 2], [from, to]: [[f64; 4]; 2]) -> Option<[ViewPoint; 2]> {
        let (mut first, mut last) = (0.0_f64, 1.0_f64);
        for (from, to) in from.into_iter().zip(to) {
            if from < 0.0 && to < 0.0 {
                return None;
            }
            if from < 0.0 {
                first = first.max(from / (from - to));
            } else if to < 0.0 {
                last = last.min(from / (from - to));
            }
        }
        let at = |t: f64| ViewPoint { x: a.x + (b.x - a.x) * t, y: a.y + (b.y - a.y) * t, w: a.w + (b.w - a.w) * t };
        (first <= last).then(|| [if first > 0.0 { at(first) } else { a }, if last < 1.0 { at(last) } else { b }])
    }
}

/// The greatest whole number that is not above a place in an image. Rounding functions are calls where SIMD is not asked for.
#[inline(always)]
fn floor(v: f64) -> i32 {
    let whole = v as i32;
    whole - i32::from(f64::from(whole) > v)
}

/// The least one that is not below.
#[inline(always)]
fn ceil(v: f64) -> i32 {
    let whole = v as i32;
    whole + i32::from(f64::from(whole) < v)
}

/// Whether a predicate holds for all pixels of the image whose centre is within 2 · [`SNAP_PX`] of a segment's image.
///
/// Goes from one row of centres to the next (or column, where the line is steep), since only a few pixels are near the line
/// in each.
#[inline(always)]
fn centres_along(
    projector: &Projector,
    ends: [ViewPoint; 2],
    heights: [[f64; 4]; 2],
    mut closed: impl FnMut(i32, i32) -> bool,
) -> bool {
    // Somewhat more than 2 · SNAP_PX along the minor axis, where the line is at most as steep as the diagonal.
    const REACH: f64 = 4.0 * SNAP_PX;
    let Some(seen) = Sides::clip_segment(ends, heights) else { return true };
    let [from, to] = seen.map(|p| {
        let per_metre = projector.focal_px / p.w;
        [projector.middle[0] + p.x * per_metre - 0.5, projector.middle[1] - p.y * per_metre - 0.5]
    });
    let major = usize::from((to[1] - from[1]).abs() > (to[0] - from[0]).abs());
    let (from, to) = if from[major] <= to[major] { (from, to) } else { (to, from) };
    let length = to[major] - from[major];
    let rise = to[1 - major] - from[1 - major];
    let slope = if length > 0.0 { rise / length } else { 0.0 };
    let size = [projector.width, projector.height];
    let (first, last) = (ceil(from[major] - REACH).max(0), floor(to[major] + REACH).min(size[major] - 1));
    let (low, high) = (from[1 - major].min(to[1 - major]), from[1 - major].max(to[1 - major]));
    let (lowest, highest) = (ceil(low - REACH).max(0), floor(high + REACH).min(size[1 - major] - 1));
    let mut is_closed = |at: i32, centre: i32| {
        let along = (f64::from(at) - from[major]).clamp(0.0, length);
        let across = from[1 - major] + along * slope;
        let (x, y) = if major == 0 { (at, centre) } else { (centre, at) };
        (across - f64::from(centre)).abs() > REACH || closed(x, y)
    };
    let per_step = 1.0 / slope;
    // By how much the place where the line meets a centre's row may be off.
    let around = REACH * per_step.abs() + REACH;
    let rises = around < 0.5;
    if !rises {
        return (lowest..=highest).all(|centre| {
            let meets = from[major] + (f64::from(centre) - from[1 - major]) * per_step;
            // Also where a level line makes this infinite or NaN.
            let near = if around < 1e6 { [ceil(meets - around), floor(meets + around)] } else { [first, last] };
            (near[0].max(first)..=near[1].min(last)).all(|at| is_closed(at, centre))
        });
    }
    // Adding and subtracting 1.5 · 2⁵² rounds to the nearest integer.
    const ROUND: f64 = 6_755_399_441_055_744.0;
    let origin = from[major] - from[1 - major] * per_step;
    for centre in lowest..=highest {
        let meets = origin + f64::from(centre) * per_step;
        let at = (meets + ROUND) - ROUND;
        if (meets - at).abs() <= around {
            let at = at as i32;
            if at >= first && at <= last && !is_closed(at, centre) {
                return false;
            }
        }
    }
    true
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64;

    use super::*;
    use crate::{Resolution, View};

    #[test]
    fn pixels_near_a_line_are_visited_and_no_others() {
        let mut rng = Pcg64::seed_from_u64(11);
        let view = View::level(DVec3::ZERO, 0.0, 1.4, Resolution::new(90, 40));
        let projector = Projector::new(&view);
        let sides = Sides::new(&projector);
        let (mut near, mut visited) = (0, 0);
        for round in 0..600 {
            let mut any = || [rng.random_range(-30.0..120.0), rng.random_range(-20.0..60.0)];
            let (a, mut b) = (any(), any());
            match round % 4 {
                // Along a row of centres and a column, and nearly so; through centres.
                0 => b = [b[0], a[1] + if b[0] > 50.0 { 0.0 } else { 0.02 }],
                1 => b = [a[0] + if b[1] > 20.0 { 0.0 } else { 0.02 }, b[1]],
                _ => {}
            }
            let [a, b] =
                if round % 8 < 6 { [a, b].map(|end| end.map(|v: f64| (v * 64.0).round() / 64.0)) } else { [a, b] };
            let [a, b] = if round % 8 < 3 { [a.map(f64::round), b.map(|v| v - a[0].fract())] } else { [a, b] };
            let ends = [a, b].map(|[column, row]| {
                let w = rng.random_range(1.0..30.0);
                let [x, y] = [column + 0.5 - projector.middle[0], projector.middle[1] - row - 0.5];
                ViewPoint { x: x * w / projector.focal_px, y: y * w / projector.focal_px, w }
            });
            let mut closed = Vec::new();
            let all = centres_along(&projector, ends, ends.each_ref().map(|end| sides.heights(end)), |x, y| {
                closed.push([x, y]);
                true
            });
            assert!(all);
            let along = [b[0] - a[0], b[1] - a[1]];
            let length2 = along[0] * along[0] + along[1] * along[1];
            for (x, y) in (0..90).flat_map(|x| (0..40).map(move |y| (x, y))) {
                let from_a = [f64::from(x) - a[0], f64::from(y) - a[1]];
                let t = ((from_a[0] * along[0] + from_a[1] * along[1]) / length2.max(1e-12)).clamp(0.0, 1.0);
                let distance = (from_a[0] - t * along[0]).hypot(from_a[1] - t * along[1]);
                let is_visited = closed.contains(&[x, y]);
                assert!(is_visited || distance > 2.0 * SNAP_PX, "{a:?} {b:?}: ({x}, {y}) is {distance} px away");
                assert!(!is_visited || distance < 6.0 * SNAP_PX, "{a:?} {b:?}: ({x}, {y}) is {distance} px away");
                near += usize::from(distance <= 2.0 * SNAP_PX);
            }
            visited += closed.len();
        }
        assert!(near > 400 && visited < 4 * near, "{near} {visited}");
    }
}
