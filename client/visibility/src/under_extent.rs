//! Where in an image of [`crate::UnderOcclusion`] is a polygon, and where may a bound be?

use glam::DVec3;

use crate::Aabb;
use crate::under::ROUNDING;
use crate::under_face::Face;

/// Which rows of an image a convex hull of points can touch.
pub(crate) struct Extent {
    /// Sides of the frustum that all points so far are outside of: left, right, bottom, top, behind.
    outside: u8,
    /// Whether all points are in front of the eye.
    in_front: bool,
    x: [f64; 2],
    y: [f64; 2],
    half: [f64; 2],
}

impl Extent {
    pub fn new(face: &Face) -> Extent {
        let half = [face.centre_x() / face.focal, face.centre_y() / face.focal];
        let none = [f64::INFINITY, f64::NEG_INFINITY];
        Extent { outside: 0b11111, in_front: true, x: none, y: none, half }
    }

    #[inline]
    pub fn add(&mut self, v: DVec3) {
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
    pub fn shorter(&self) -> f64 {
        (self.x[1] - self.x[0]).min(self.y[1] - self.y[0])
    }

    /// The greater extent.
    pub fn longer(&self) -> f64 {
        (self.x[1] - self.x[0]).max(self.y[1] - self.y[0])
    }

    /// Columns and rows whose pixels may be touched, with one more around them; none if it is out of the image.
    pub fn pixels(&self, face: &Face) -> Option<[[f64; 2]; 2]> {
        if self.outside != 0 {
            return None;
        }
        if !self.in_front {
            return Some([[0.0, f64::INFINITY]; 2]);
        }
        let (column, row) = (|x: f64| face.centre_x() + face.focal * x, |y: f64| face.centre_y() - face.focal * y);
        let outward = |low: f64, high: f64| [low.floor() - 1.0, high.floor() + 1.0];
        Some([outward(column(self.x[0]), column(self.x[1])), outward(row(self.y[1]), row(self.y[0]))])
    }

    /// First and last row whose pixels may be touched, or none: also if `extent` is below `least_px` pixels, where the
    /// work is not worth it. Leaving something out is always right.
    pub fn rows(&self, face: &Face, extent: fn(&Extent) -> f64, least_px: f64) -> Option<[f64; 2]> {
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

/// How far a box reaches, once for all faces of a cube: most of these see nothing of it, which one comparison tells then.
pub(crate) struct Reach {
    /// Depth of its nearest point that a face could see: in a face's image, z is at least |x| and |y| (90°).
    nearest: f64,
    /// How far it goes along +x, −x, +y, −y, +z and −z, by [`Face::side`].
    far: [f64; 6],
}

impl Reach {
    pub fn of(relative: &Aabb) -> Reach {
        let Aabb { min, max } = *relative;
        let nearest = min.max(-max).max(DVec3::ZERO).max_element();
        Reach { nearest, far: [max.x, -min.x, max.y, -min.y, max.z, -min.z] }
    }
}

pub(crate) enum Seen {
    /// No point is in the image.
    Outside,
    /// It touches the eye or the near plane.
    Near,
    At(Rectangle),
}

/// Tangents that a bound may take in an image, and its least depth there.
pub(crate) struct Rectangle {
    pub x: [f64; 2],
    pub y: [f64; 2],
    pub z: f64,
}

impl Face {
    /// Whether no point of the box is in this face of a cube: then [`Face::rectangle_aligned`] is outside.
    #[inline]
    pub fn misses(&self, reach: &Reach) -> bool {
        reach.far[self.side] < reach.nearest
    }

    /// A box with sides along the image's axes, exact up to rounding.
    ///
    /// In the image, z is at least |x| and |y| (90°), so the nearest point of the box there has
    /// z = max(least z, least |x|, least |y|), and x/z is extreme at that z or at the greatest one.
    #[inline]
    pub fn rectangle_aligned(&self, relative: &Aabb) -> Seen {
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

    /// Any box in any image: by its corners if all are beyond the near plane. `half` are the tangents of half the view; for
    /// eyes in a ball of `radius` metres the sides of its frustum are moved outward by that much.
    pub fn rectangle(&self, relative: &Aabb, near: f64, half: [f64; 2], radius: f64) -> Seen {
        let corners = relative.corners().map(|corner| self.local(corner));
        let size = relative.min.abs().max(relative.max.abs()).element_sum();
        let slack = ROUNDING * size;
        let outside = |distance: fn(DVec3, [f64; 2]) -> f64, half_tangent: f64| {
            // The length of the side's normal, of which the forward part is this tangent.
            let reach = radius * (1.0 + half_tangent * half_tangent).sqrt() * (1.0 + 1e-9);
            corners.iter().all(|&c| distance(c, half) > 4.0 * slack + reach)
        };
        if outside(|c, _| -c.z, 0.0)
            || outside(|c, [h, _]| c.x - c.z * h, half[0])
            || outside(|c, [h, _]| -c.x - c.z * h, half[0])
            || outside(|c, [_, h]| c.y - c.z * h, half[1])
            || outside(|c, [_, h]| -c.y - c.z * h, half[1])
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
    pub fn tighten(&mut self, centre: DVec3, radius: f64) {
        self.tighten_across(centre, radius);
        if let Some([low, high]) = touch(centre.y, centre.z, radius) {
            self.y = [self.y[0].max(low), self.y[1].min(high)];
        }
    }

    /// The same across the image only: for an upright cylinder in an upright image.
    pub fn tighten_across(&mut self, centre: DVec3, radius: f64) {
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
