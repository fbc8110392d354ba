//! Where do all segments from a ball of eyes to a bound run?
//!
//! In the convex hull of both, of which only the part before the bound matters: each segment ends for us where it crosses the
//! plane at the bound's least depth, in the shaft's *far end*. Sides are a few planes that touch the ball and the bound,
//! so that a shaft is a little wider than the hull. All is relative to the ball's centre. See [`crate::sheets`] for its use.

use glam::DVec3;

use crate::{Aabb, Bound};

/// Planes around a shaft. The octagon around a disc reaches 8 % farther than the disc.
pub(crate) const SIDES: usize = 8;

/// Everything is moved outward by this part of the distances. More than rounding takes; see [`Shaft::clip`].
const OUTWARD: f64 = 1e-9;

/// The space between the eyes of a ball and a bound.
pub(crate) struct Shaft {
    /// Inside is where `normal·v` is at most `offset`: the sides, the far end, behind the ball.
    spaces: [(DVec3, f64); SIDES + 2],
    /// The normals' absolute coordinates.
    reaches: [DVec3; SIDES + 2],
    /// From the ball's centre to the bound's, a unit vector.
    pub axis: DVec3,
    /// Depth of the far end along `axis`, metres.
    pub far: f64,
    /// The far end's corners in order, anticlockwise as seen along the axis from its tip.
    pub end: [DVec3; SIDES],
}

impl Shaft {
    /// From the ball of `radius` metres around `eye` to the bound; none if they nearly touch or the bound makes no sense.
    pub fn new(eye: DVec3, radius: f64, bound: &Bound) -> Option<Shaft> {
        let aabb = bound.outer_box()?;
        let relative = Aabb::new(aabb.min - eye, aabb.max - eye);
        let middle = relative.centre();
        let distance = middle.length();
        let outward = OUTWARD * (distance + relative.size().length());
        let radius = radius + outward;
        let axis = middle.try_normalize()?;
        let ball = match *bound {
            Bound::Sphere { radius, .. } => Some(radius + outward),
            _ => None,
        };
        let mut corners = [middle; SIDES * 2];
        match *bound {
            // A prism of eight sides around the cylinder.
            Bound::Upright { radius, half_height, .. } => {
                let reach = radius / (std::f64::consts::PI / SIDES as f64).cos();
                for (i, corner) in corners.iter_mut().enumerate() {
                    let turn = std::f64::consts::TAU * i as f64 / SIDES as f64;
                    let up = if i < SIDES { half_height } else { -half_height };
                    *corner += DVec3::new(turn.cos() * reach, up, turn.sin() * reach);
                }
            }
            _ => corners[..8].copy_from_slice(&relative.corners()),
        }
        let depth = |corner: &DVec3| axis.dot(*corner) - outward;
        let far = ball.map_or_else(
            || corners.iter().map(depth).fold(f64::INFINITY, f64::min),
            |ball| (distance - ball) * (1.0 - OUTWARD),
        );
        if !(far.is_finite() && far > 2.0 * radius) {
            return None;
        }
        let (right, up) = axis.any_orthonormal_pair();
        let across: [DVec3; SIDES] = std::array::from_fn(|side| {
            let turn = std::f64::consts::TAU * side as f64 / SIDES as f64;
            right * turn.cos() + up * turn.sin()
        });
        // In the plane of the axis and a direction across, the line w = slope·depth + r·√(1 + slope²) touches the ball, and its
        // height grows with the slope, so the steepest to any corner has all of them below it.
        let slopes = across.map(|across| match ball {
            Some(ball) => {
                let sine = (ball - radius) / distance;
                sine / (1.0 - sine * sine).sqrt()
            }
            None => (corners.iter().map(|corner| {
                let (t, w) = (axis.dot(*corner), across.dot(*corner) + outward);
                let squared = t * t - radius * radius;
                (w * t - radius * (w * w + squared).max(0.0).sqrt()) / squared
            }))
            .fold(f64::NEG_INFINITY, f64::max),
        });
        let mut spaces = [(axis, far); SIDES + 2];
        for (space, (across, slope)) in spaces.iter_mut().zip(across.iter().zip(slopes)) {
            *space = ((*across - axis * slope) / (1.0 + slope * slope).sqrt(), radius);
        }
        spaces[SIDES + 1] = (-axis, radius);
        let reach = slopes.map(|slope| slope * far + radius * (1.0 + slope * slope).sqrt());
        let end = std::array::from_fn(|side| {
            let next = (side + 1) % SIDES;
            let cosine = across[side].dot(across[next]);
            let corner = across[side] * (reach[side] - reach[next] * cosine)
                + across[next] * (reach[next] - reach[side] * cosine);
            corner / (1.0 - cosine * cosine) + axis * far
        });
        let reaches = spaces.map(|(normal, _)| normal.abs());
        Some(Shaft { spaces, reaches, axis, far, end })
    }

    /// Whether no point of the box is in the shaft. Doubt is `false`.
    pub fn misses_box(&self, relative: &Aabb) -> bool {
        let (centre, half) = (relative.centre(), relative.size() * 0.5);
        let misses =
            |(&(normal, offset), reach): (&(DVec3, f64), &DVec3)| normal.dot(centre) - reach.dot(half) > offset;
        self.spaces.iter().zip(&self.reaches).any(misses)
    }

    /// Whether all points, and so what is between them, are outside one and the same side.
    pub fn misses(&self, points: &[DVec3]) -> bool {
        self.spaces.iter().any(|&(normal, offset)| points.iter().all(|point| normal.dot(*point) > offset))
    }

    /// Which stretch of an edge is in the shaft, as shares of its length. Rounding is far less than the shaft is widened by,
    /// whatever the angle: along the edge that makes as much or more.
    pub fn clip(&self, edge: [DVec3; 2]) -> Option<[f64; 2]> {
        clip(&self.spaces, edge, [0.0, 1.0])
    }
}

/// The part of a stretch of an edge that is inside all of some half-spaces.
pub(crate) fn clip(spaces: &[(DVec3, f64)], [from, to]: [DVec3; 2], [mut low, mut high]: [f64; 2]) -> Option<[f64; 2]> {
    for &(normal, offset) in spaces {
        let (a, b) = (normal.dot(from) - offset, normal.dot(to) - offset);
        if a > 0.0 && b > 0.0 {
            return None;
        }
        if a > 0.0 {
            low = low.max(a / (a - b));
        } else if b > 0.0 {
            high = high.min(a / (a - b));
        }
    }
    (low <= high).then_some([low, high])
}

/// The half-spaces of the cone from the origin over a convex cell of an end, a little widened. Corners are anticlockwise as
/// seen along `axis` from its tip.
pub(crate) fn cone(cell: &[DVec3], spaces: &mut Vec<(DVec3, f64)>) {
    spaces.clear();
    for (i, &corner) in cell.iter().enumerate() {
        let next = cell[(i + 1) % cell.len()];
        if let Some(normal) = next.cross(corner).try_normalize() {
            spaces.push((normal, OUTWARD * corner.length()));
        }
    }
}
