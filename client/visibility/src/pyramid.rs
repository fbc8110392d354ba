//! Which part of a flat face is in a view? Faces of near cells reach behind the eye, where no image can be asked about them.

use glam::DVec3;

use crate::{Aabb, View};

/// The four sides of a view's pyramid, grown by a pixel, without near plane.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pyramid {
    eye: DVec3,
    forward: DVec3,
    /// Inward normals.
    sides: [DVec3; 4],
    near: f64,
}

/// A rectangle cut by four planes has at most this many corners.
const CORNERS_MAX: usize = 8;

/// What an image may be asked about a face.
pub(crate) enum Part {
    /// No pixel sees any of it.
    Outside,
    /// Some of it is nearer than the near plane, so that nothing can hide it.
    Near,
    /// The part in the pyramid, once round.
    In([DVec3; CORNERS_MAX], usize),
}

impl Pyramid {
    pub(crate) fn new(view: &View) -> Pyramid {
        let [right, up, forward] = view.axes();
        let focal = view.focal_px();
        let [x, y] = [view.resolution.width, view.resolution.height].map(|size| (f64::from(size) * 0.5 + 1.0) / focal);
        let sides = [forward * x - right, forward * x + right, forward * y - up, forward * y + up];
        Pyramid { eye: view.eye, forward, sides, near: view.near }
    }

    /// The part of a flat box across `axis` that is in view.
    pub(crate) fn part(&self, rectangle: &Aabb, axis: usize) -> Part {
        let (min, max) = (rectangle.min - self.eye, rectangle.max - self.eye);
        // Beyond rounding only: what is kept wrongly is asked about.
        let slack = 1e-12 * (min.abs().max(max.abs())).element_sum();
        let greatest = |normal: DVec3| (normal * min).max(normal * max).element_sum();
        if self.sides.iter().any(|&side| greatest(side) < -slack * (1.0 + side.length())) {
            return Part::Outside;
        }
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        let corner = |at_u: f64, at_v: f64| {
            let mut corner = min;
            corner[u] = at_u;
            corner[v] = at_v;
            corner
        };
        let near = self.near * (1.0 + 1e-6) + slack;
        let whole = [corner(min[u], min[v]), corner(max[u], min[v]), corner(max[u], max[v]), corner(min[u], max[v])];
        let mut polygon = [DVec3::ZERO; CORNERS_MAX];
        polygon[..4].copy_from_slice(&whole);
        let mut count = 4;
        if whole.iter().any(|corner| self.forward.dot(*corner) <= near) {
            for side in self.sides {
                count = clip(&mut polygon, count, side);
            }
            if count == 0 {
                return Part::Outside;
            }
            if polygon[..count].iter().any(|corner| self.forward.dot(*corner) <= near) {
                return Part::Near;
            }
        }
        polygon[..count].iter_mut().for_each(|corner| *corner += self.eye);
        Part::In(polygon, count)
    }
}

/// Cuts a convex polygon to where a normal looks; returns the number of corners left.
fn clip(polygon: &mut [DVec3; CORNERS_MAX], count: usize, normal: DVec3) -> usize {
    let whole = *polygon;
    let mut kept = 0;
    let mut push = |corner: DVec3| {
        // Rounding may make a polygon dent and gain more corners than it can; the last one then gives way to one beyond it,
        // which only makes the polygon larger.
        kept = (kept + 1).min(CORNERS_MAX);
        polygon[kept - 1] = corner;
    };
    for (i, here) in whole[..count].iter().enumerate() {
        let next = &whole[(i + 1) % count];
        let (h, n) = (normal.dot(*here), normal.dot(*next));
        if h >= 0.0 {
            push(*here);
        }
        if (h >= 0.0) != (n >= 0.0) {
            push(*here + (*next - *here) * (h / (h - n)));
        }
    }
    kept
}

#[cfg(test)]
mod tests {
    use glam::DQuat;
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64;

    use super::*;
    use crate::Resolution;

    #[test]
    fn points_in_view_are_in_the_part() {
        let mut rng = Pcg64::seed_from_u64(5);
        let (mut inside, mut cut) = (0, 0);
        for i in 0..4000 {
            let mut any = |reach: f64| DVec3::from_array(std::array::from_fn(|_| rng.random_range(-reach..reach)));
            let eye = any(3.0);
            let orientation = DQuat::from_euler(glam::EulerRot::YXZ, any(3.0).x, any(1.5).y, any(3.0).z);
            let (a, b) = (any(6.0), any(6.0));
            let resolution = Resolution::new(64, 48);
            let view = View { orientation, near: 0.1, ..View::level(eye, 0.0, 1.3, resolution) };
            let axis = i % 3;
            let (mut min, mut max) = (a.min(b), a.max(b));
            max[axis] = min[axis];
            if i % 7 == 0 {
                // The eye's own plane.
                (min[axis], max[axis]) = (eye[axis], eye[axis]);
            }
            let part = Pyramid::new(&view).part(&Aabb::new(min, max), axis);
            let focal = view.focal_px();
            for _ in 0..20 {
                let share = DVec3::from_array(std::array::from_fn(|_| rng.random::<f64>()));
                let point = min + (max - min) * share;
                let seen = view.orientation.inverse() * (point - eye);
                let w = -seen.z;
                if w <= 0.0 || (seen.x * focal).abs() > 32.0 * w || (seen.y * focal).abs() > 24.0 * w {
                    continue;
                }
                inside += 1;
                match &part {
                    Part::Outside => panic!("{point} of {min} to {max} is in view of {view:?}"),
                    Part::Near => {}
                    Part::In(corners, count) => {
                        assert!(w > view.near);
                        cut += usize::from(*count != 4);
                        // Inside each edge, whichever way round the polygon runs.
                        let corners = &corners[..*count];
                        let sides = (0..*count).map(|k| {
                            let (from, to) = (corners[k], corners[(k + 1) % count]);
                            (to - from).cross(point - from)[axis]
                        });
                        let (low, high) = sides.fold((f64::MAX, f64::MIN), |(l, h), s| (l.min(s), h.max(s)));
                        assert!(low > -1e-9 || high < 1e-9);
                    }
                }
            }
        }
        assert!(inside > 5000 && cut > 500, "{inside} {cut}");
    }
}
