//! How many z-tests does drawing take? Pixel centres that a triangle covers in a view, counted without drawing.
//!
//! cPLP §5 counts z-tests, not only those that pass. A triangle's tests are its fragments: the pixel centres inside its
//! projection, clipped at the near plane, unless it is single-sided and turned away. The count is by f64 scanlines and shares
//! no code with the rasteriser, so a centre on an edge may count for both neighbours or for none.

use eyeline_visibility::{Sides, Triangle, View};
use glam::{DVec2, DVec3};

/// Counts the fragments of triangles in one view.
pub struct Fragments {
    eye: DVec3,
    /// Right, up and forward.
    axes: [DVec3; 3],
    focal_px: f64,
    middle: DVec2,
    near: f64,
    size: DVec2,
}

impl Fragments {
    /// Counts in this view.
    pub fn new(view: &View) -> Fragments {
        let size = DVec2::new(f64::from(view.resolution.width), f64::from(view.resolution.height));
        Fragments {
            eye: view.eye,
            axes: [DVec3::X, DVec3::Y, DVec3::NEG_Z].map(|axis| view.orientation * axis),
            focal_px: view.focal_px(),
            middle: size * 0.5,
            near: view.near,
            size,
        }
    }

    /// Fragments of a triangle that stands `offset` from where it says.
    pub fn of(&self, triangle: &Triangle, offset: DVec3) -> u64 {
        let [right, up, forward] = self.axes;
        let corners = triangle.corners.map(|corner| {
            let p = corner.as_dvec3() + offset - self.eye;
            DVec3::new(p.dot(right), p.dot(up), p.dot(forward))
        });
        if triangle.sides == Sides::Front {
            // In right, up and forward, anticlockwise from the front is a normal against the line of sight.
            let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
            // The axes are left-handed (forward is −z), which turns the normal round.
            if normal.dot(corners[0]) <= 0.0 {
                return 0;
            }
        }
        let mut polygon = [DVec2::ZERO; 4];
        let mut count = 0;
        for i in 0..3 {
            let (a, b) = (corners[i], corners[(i + 1) % 3]);
            let mut push = |p: DVec3| {
                let per_metre = self.focal_px / p.z;
                polygon[count] = self.middle + DVec2::new(p.x, -p.y) * per_metre;
                count += 1;
            };
            if a.z >= self.near {
                push(a);
            }
            if (a.z >= self.near) != (b.z >= self.near) {
                let t = (self.near - a.z) / (b.z - a.z);
                push(DVec3::new(a.x + (b.x - a.x) * t, a.y + (b.y - a.y) * t, self.near));
            }
        }
        self.covered(&polygon[..count])
    }

    /// Pixel centres in a convex polygon.
    fn covered(&self, polygon: &[DVec2]) -> u64 {
        if polygon.len() < 3 {
            return 0;
        }
        let top = polygon.iter().map(|p| p.y).fold(f64::INFINITY, f64::min);
        let bottom = polygon.iter().map(|p| p.y).fold(f64::NEG_INFINITY, f64::max);
        // Centres are at half pixels.
        let first = (top - 0.5).ceil().max(0.0);
        let last = (bottom - 0.5).floor().min(self.size.y - 1.0);
        let mut fragments = 0;
        let mut row = first;
        while row <= last {
            let y = row + 0.5;
            let (mut from, mut to) = (f64::INFINITY, f64::NEG_INFINITY);
            for (i, &a) in polygon.iter().enumerate() {
                let b = polygon[(i + 1) % polygon.len()];
                if (a.y <= y) != (b.y <= y) {
                    let x = a.x + (b.x - a.x) * ((y - a.y) / (b.y - a.y));
                    (from, to) = (from.min(x), to.max(x));
                }
            }
            let from = (from - 0.5).ceil().max(0.0);
            let to = (to - 0.5).ceil().min(self.size.x);
            if to > from {
                fragments += (to - from) as u64;
            }
            row += 1.0;
        }
        fragments
    }
}

#[cfg(test)]
mod tests {
    use eyeline_visibility::{ItemBuffer, Resolution};
    use glam::{DQuat, Vec3};
    use rand::RngExt;

    use super::*;

    #[test]
    fn fragments_are_the_pixels_that_the_rasteriser_covers() {
        let mut chance = crate::chance(5, 0);
        let (mut counted, mut drawn, mut turned_away) = (0, 0, 0);
        for _ in 0..3_000 {
            let mut within = |reach: f32| chance.random_range(-reach..reach);
            let size = 3.0 + within(2.9);
            let at = Vec3::new(within(4.0), within(4.0), within(4.0));
            let corners = std::array::from_fn(|_| at + Vec3::new(within(size), within(size), within(size)));
            let turn = DQuat::from_rotation_y(f64::from(within(3.0))) * DQuat::from_rotation_x(f64::from(within(1.0)));
            let view = View { orientation: turn, ..View::level(DVec3::splat(0.3), 0.0, 1.4, Resolution::new(96, 64)) };
            let sides = if within(1.0) > 0.0 { Sides::Both } else { Sides::Front };
            let triangle = Triangle { corners, sides, occludes: true };
            let mut items = ItemBuffer::new(&view);
            items.draw_triangle(1, &triangle, DVec3::ZERO);
            let pixels = items.ids().iter().filter(|&&id| id == 1).count() as u64;
            let fragments = Fragments::new(&view).of(&triangle, DVec3::ZERO);
            // Only centres next to an edge may differ, by the rasteriser's snapping.
            assert!(fragments.abs_diff(pixels) <= 6, "{fragments} and {pixels}");
            counted += fragments;
            drawn += pixels;
            turned_away += u64::from(fragments == 0);
        }
        assert!(counted > 100_000 && turned_away > 500);
        assert!(counted.abs_diff(drawn) * 1_000 < drawn, "{counted} and {drawn}");
    }
}
