//! Which pixels may show any of a box, and how near is it there at most? Boxes drawn with everything rounded outward.
//!
//! The front cells of cPLP are drawn into images to find out which of them can be seen (Klosowski & Silva 2001, §3). A query
//! may only err towards "seen", so a box is not drawn as twelve triangles, whose snapped edges could lose a pixel, but as
//! bounds: the straight lines of its silhouette give the columns of each row, and the planes of the faces that look at the
//! eye give the depth, each moved outward by [`spread`](BoxImage::new).
//!
//! Why nothing is lost: a pixel's depth is that of a true point within [`SNAP_PX`] of its centre (see `setup`). If that
//! point q, or any point between the eye and q, lies in the box, then so does a point that is seen within `SNAP_PX` of the
//! centre. It lies behind each face that looks at the eye and inside every line that all eight corners lie inside of, so
//! the bounds, which hold everywhere within `spread` of the centre, take the pixel in, and at a depth no less than q's.

use super::setup::{DEPTH_SLACK, Projector, SNAP_PX};
use crate::{Aabb, Face};

/// What an image shows of a box.
pub(crate) enum BoxPlace<T = BoxImage> {
    /// No pixel.
    Outside,
    /// It touches the eye or the near plane and may be in view: no image of it can be drawn.
    Touching,
    /// These pixels.
    In(T),
}

/// The outward-rounded image of a box behind the near plane.
#[derive(Clone, Copy, Debug)]
pub(crate) struct BoxImage {
    /// First and last column.
    pub(crate) x: [i32; 2],
    /// First and last row.
    pub(crate) y: [i32; 2],
    /// No reversed depth of the box is greater.
    z: f32,
    lines: [Line; 6],
    planes: [Plane; 3],
    /// The pixel of each corner, in the image or not.
    corners: [[i32; 2]; 8],
}

/// The least or the greatest column of a row: `per_row` · row + `at_zero`.
#[derive(Clone, Copy, Debug)]
struct Line {
    per_row: f64,
    at_zero: f64,
    least: bool,
}

/// A bound on depth: `per_column` · column + `per_row` · row + `at_zero`.
#[derive(Clone, Copy, Debug)]
struct Plane {
    per_column: f64,
    per_row: f64,
    at_zero: f64,
}

impl BoxImage {
    /// The image of a box whose pixels lie in these columns and rows, no nearer than `z`: what [`super::DepthBuffer`] found.
    pub(super) fn new(projector: &Projector, aabb: &Aabb, x: [usize; 2], y: [usize; 2], z: f32) -> BoxImage {
        let points = aabb.corners().map(|corner| projector.view_point(corner));
        let nearest = points.iter().map(|p| p.w).fold(f64::INFINITY, f64::min);
        let size = points.iter().map(|p| p.x.abs() + p.y.abs() + p.w.abs()).fold(0.0, f64::max);
        // Rounding of the transform in metres, as for the rectangle.
        let slack = size * 1e-12;
        let spread = 2.0 * SNAP_PX + slack / (nearest - slack) * projector.focal_px;
        let image = points.map(|p| {
            let per_metre = projector.focal_px / p.w;
            [projector.middle[0] + p.x * per_metre, projector.middle[1] - p.y * per_metre]
        });
        let heights = Face::ALL.map(|face| face.height(aabb, projector.eye()));
        BoxImage {
            x: x.map(|x| x as i32),
            y: y.map(|y| y as i32),
            z,
            lines: silhouette(&image, heights.map(|height| height > 0.0), spread, f64::from(projector.height)),
            planes: planes(projector, heights, z, slack, spread, size),
            corners: image.map(|corner| corner.map(|at| at.floor() as i32)),
        }
    }

    /// The pixels of the corners that lie in the box's rectangle.
    pub(crate) fn corners(&self) -> impl Iterator<Item = [i32; 2]> {
        let within = |&[x, y]: &[i32; 2]| self.x[0] <= x && x <= self.x[1] && self.y[0] <= y && y <= self.y[1];
        self.corners.into_iter().filter(within)
    }

    /// First and last column of a row; descending if it shows nothing of the box.
    #[inline]
    pub(crate) fn columns(&self, row: i32) -> [i32; 2] {
        let (mut low, mut high) = (f64::from(self.x[0]), f64::from(self.x[1]));
        for line in &self.lines {
            let at = line.per_row * f64::from(row) + line.at_zero;
            if line.least {
                low = low.max(at);
            } else {
                high = high.min(at);
            }
        }
        // A nearly level line ends far outside, farther than an i32 reaches: a column beyond the box's says as much.
        let (low, high) = (low.min(f64::from(self.x[1]) + 1.0), high.max(f64::from(self.x[0]) - 1.0));
        // Conversions go towards zero, so that a high below zero needs the correction too.
        let [first, last] = [low as i32, high as i32];
        [first + i32::from(f64::from(first) < low), last - i32::from(f64::from(last) > high)]
    }

    /// The rows that may show the box, with their first and last column.
    #[inline]
    pub(crate) fn rows(&self) -> impl Iterator<Item = (usize, [usize; 2])> {
        (self.y[0]..=self.y[1]).filter_map(|row| {
            let [first, last] = self.columns(row);
            (first <= last).then_some((row as usize, [first as usize, last as usize]))
        })
    }

    /// The depths along some columns of a row.
    #[inline]
    pub(crate) fn front(&self, row: usize, [first, last]: [usize; 2]) -> Front {
        let length = (last - first) as f64;
        let ramps = self.planes.map(|plane| {
            let start = plane.per_column * first as f64 + plane.per_row * row as f64 + plane.at_zero;
            let greatest = start.abs() + plane.per_column.abs() * length;
            // Each of the f32 operations is within 2⁻²⁴ of the greatest value on the way.
            let start = start + greatest * (1.0 / 2_097_152.0);
            if greatest < 1e30 { [start as f32, plane.per_column as f32] } else { [self.z, 0.0] }
        });
        Front { start: ramps.map(|ramp| ramp[0]), slope: ramps.map(|ramp| ramp[1]), most: self.z }
    }

    /// No reversed depth of the box is greater in a rectangle of columns and rows, first to last.
    pub(crate) fn nearest_in(&self, x: [usize; 2], y: [usize; 2]) -> f32 {
        self.planes.iter().fold(self.z, |z, plane| {
            let greatest = |slope: f64, [low, high]: [usize; 2]| slope * (if slope > 0.0 { high } else { low }) as f64;
            let parts = [greatest(plane.per_column, x), greatest(plane.per_row, y), plane.at_zero];
            let size: f64 = parts.iter().map(|part| part.abs()).sum();
            z.min((parts.iter().sum::<f64>() + size * 1e-6) as f32)
        })
    }
}

/// Bounds by the image's outer edges: those between a face that looks at the eye and one that does not.
///
/// Which edges are taken, and which side they bound, decides only how tight a line is: it is moved out to the outermost
/// corner, so that any slope would do.
fn silhouette(image: &[[f64; 2]; 8], faces_eye: [bool; 6], spread: f64, rows: f64) -> [Line; 6] {
    const NO_BOUND: Line = Line { per_row: 0.0, at_zero: f64::NEG_INFINITY, least: true };
    let reach = |axis: usize| image.iter().map(|p| p[axis].abs()).fold(0.0, f64::max);
    let (reach_x, reach_y) = (reach(0), reach(1) + rows);
    let mut lines = [NO_BOUND; 6];
    let mut count = 0;
    for axis in 0..3 {
        let [u, v] = [(axis + 1) % 3, (axis + 2) % 3];
        for (at_u, at_v) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
            if faces_eye[2 * u + at_u] == faces_eye[2 * v + at_v] || count == lines.len() {
                continue;
            }
            let from = at_u << u | at_v << v;
            let [p, q] = [image[from], image[from | 1 << axis]];
            let per_row = (q[0] - p[0]) / (q[1] - p[1]);
            if !per_row.is_finite() {
                continue;
            }
            let offsets = image.map(|p| p[0] - per_row * p[1]);
            let low = offsets.iter().copied().fold(f64::INFINITY, f64::min);
            let high = offsets.iter().copied().fold(f64::NEG_INFINITY, f64::max);
            let own = p[0] - per_row * p[1];
            let least = own - low < high - own;
            let rounding = 1e-14 * (reach_x + per_row.abs() * reach_y);
            let out = spread * (1.0 + per_row.abs()) + rounding;
            // Centres of pixels lie half a pixel right of and below their columns and rows.
            let at_zero = if least { low - out } else { high + out } + 0.5 * per_row - 0.5;
            lines[count] = Line { per_row, at_zero, least };
            count += 1;
        }
    }
    lines
}

/// Bounds by the planes of the faces that look at the eye. On such a plane reversed depth is linear over the image.
fn planes(projector: &Projector, heights: [f64; 6], z: f32, slack: f64, spread: f64, size: f64) -> [Plane; 3] {
    let mut planes = [Plane { per_column: 0.0, per_row: 0.0, at_zero: f64::from(z) }; 3];
    let normals = projector.normals();
    for (axis, plane) in planes.iter_mut().enumerate() {
        let (sign, height) =
            if heights[2 * axis] > 0.0 { (-1.0, heights[2 * axis]) } else { (1.0, heights[2 * axis + 1]) };
        // The face comes nearer by what corners may be off. A face that is seen edge-on bounds nothing.
        let height = height - 2.0 * slack;
        if height.is_nan() || height <= size * 1e-9 {
            continue;
        }
        // A point at view-space direction d, of forward part 1, is on the plane at distance −height / (n · d).
        let [right, up, forward] = normals[axis].map(|part| -sign * part * projector.near / height);
        let per_column = right / projector.focal_px;
        let per_row = -up / projector.focal_px;
        let parts = [forward, per_column * (0.5 - projector.middle[0]), per_row * (0.5 - projector.middle[1])];
        let reach: f64 = parts.iter().map(|part| part.abs()).sum();
        let out = spread * (per_column.abs() + per_row.abs()) + 1e-12 * reach;
        let nearer = 1.0 + 2.0 * DEPTH_SLACK;
        *plane = Plane {
            per_column: per_column * nearer,
            per_row: per_row * nearer,
            at_zero: (parts.iter().sum::<f64>() + out) * nearer,
        };
    }
    planes
}

/// Upper bounds of a box's depths along a row, from the first column that was asked for.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Front {
    start: [f32; 3],
    slope: [f32; 3],
    most: f32,
}

impl Front {
    #[inline(always)]
    fn at(&self, distance: i32) -> f32 {
        let distance = distance as f32;
        let least = |a: f32, b: f32| if a < b { a } else { b };
        let [a, b, c] = std::array::from_fn(|i| self.start[i] + self.slope[i] * distance);
        least(least(a, b), least(c, self.most))
    }

    /// Number of pixels, from the column `first` on, where the box is no farther than `depths`.
    #[inline]
    pub(crate) fn passing(&self, first: usize, depths: &[f32]) -> u32 {
        let mut count = 0;
        for (i, &depth) in depths.iter().enumerate() {
            count += u32::from(self.at((first + i) as i32) >= depth);
        }
        count
    }

    /// Gives `colour` to those pixels.
    #[inline]
    pub(crate) fn paint<C: Copy>(&self, first: usize, depths: &[f32], colours: &mut [C], colour: C) {
        for (i, (&depth, pixel)) in depths.iter().zip(colours).enumerate() {
            *pixel = if self.at((first + i) as i32) >= depth { colour } else { *pixel };
        }
    }

    /// Gives `colour` to those pixels, and moves their depths to the box.
    #[inline]
    pub(crate) fn paint_nearer<C: Copy>(&self, first: usize, depths: &mut [f32], colours: &mut [C], colour: C) {
        for (i, (depth, pixel)) in depths.iter_mut().zip(colours).enumerate() {
            let z = self.at((first + i) as i32);
            let passes = z >= *depth;
            *pixel = if passes { colour } else { *pixel };
            *depth = if passes { z } else { *depth };
        }
    }
}

#[cfg(test)]
mod tests {
    use glam::{DQuat, DVec3};
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64;

    use super::*;
    use crate::{DepthBuffer, ItemBuffer, Resolution, Sides, View};

    fn any_view(rng: &mut Pcg64) -> View {
        let mut unit = || rng.random_range(-1.0..1.0);
        let orientation = DQuat::from_xyzw(unit(), unit(), unit(), unit()).normalize();
        let eye = DVec3::new(unit(), unit(), unit()) * 6.0;
        View { eye, orientation, fov_x: 1.6 + unit() * 1.4, resolution: Resolution::new(61, 47), near: 0.01 }
    }

    fn any_box(rng: &mut Pcg64) -> Aabb {
        let mut unit = || rng.random_range(-1.0..1.0);
        let size = 10.0_f64.powf(unit() * 1.5);
        let half = DVec3::new(unit(), unit(), unit()).abs() * size;
        Aabb::around(DVec3::new(unit(), unit(), unit()) * 6.0, half)
    }

    /// Triangles inside a box, some of them on its surface.
    fn inner(rng: &mut Pcg64, aabb: &Aabb) -> [DVec3; 3] {
        std::array::from_fn(|_| {
            let at = DVec3::from_array(std::array::from_fn(|_| match rng.random_range(0..4) {
                0 => 0.0,
                1 => 1.0,
                _ => rng.random_range(0.0..=1.0),
            }));
            (aabb.min + aabb.size() * at).clamp(aabb.min, aabb.max)
        })
    }

    #[test]
    fn what_a_box_contains_is_within_its_image_and_no_nearer() {
        let mut rng = Pcg64::seed_from_u64(1);
        let (mut pixels, mut drawn) = (0, 0);
        for _ in 0..4000 {
            let (view, mut aabb) = (any_view(&mut rng), any_box(&mut rng));
            if rng.random_bool(0.1) {
                // A face in the plane of the eye, exactly or nearly.
                aabb.min.y = view.eye.y + if rng.random() { 0.0 } else { 1e-13 };
                aabb.max.y = aabb.min.y + 1.0;
            }
            let mut items = ItemBuffer::new(&view);
            for id in 0..8 {
                items.draw_corners(id, inner(&mut rng, &aabb), Sides::Both);
            }
            let shown: Vec<(usize, f32)> =
                items.depths().iter().copied().enumerate().filter(|(_, depth)| *depth > 0.0).collect();
            match DepthBuffer::new(&view).box_place(&aabb) {
                BoxPlace::Outside => assert!(shown.is_empty(), "{view:?} {aabb:?}"),
                BoxPlace::Touching => {}
                BoxPlace::In(image) => {
                    for (at, depth) in shown {
                        let (x, y) = (at % 61, at / 61);
                        let [first, last] = image.columns(y as i32);
                        assert!((first..=last).contains(&(x as i32)), "{x} {y} {view:?} {aabb:?}");
                        assert!((image.y[0]..=image.y[1]).contains(&(y as i32)));
                        let columns = [first as usize, last as usize];
                        let front = image.front(y, columns);
                        assert!(front.at(x as i32 - first) >= depth, "{x} {y} {view:?} {aabb:?}");
                        assert!(image.nearest_in(columns, [y, y]) >= depth);
                        drawn += 1;
                    }
                    pixels += image.rows().map(|(_, [first, last])| last + 1 - first).sum::<usize>();
                }
            }
        }
        assert!(drawn > 50_000 && pixels > drawn, "{drawn} of {pixels}");
    }

    #[test]
    fn the_image_of_a_box_is_its_silhouette_and_front_not_a_rectangle() {
        let mut rng = Pcg64::seed_from_u64(2);
        let (mut exact, mut rounded, mut rectangle, mut off) = (0, 0, 0, 0);
        for _ in 0..500 {
            let (view, aabb) = (any_view(&mut rng), any_box(&mut rng));
            let BoxPlace::In(image) = DepthBuffer::new(&view).box_place(&aabb) else { continue };
            let mut items = ItemBuffer::new(&view);
            let corners = aabb.corners();
            for [a, b, c, d] in [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]] {
                items.draw_corners(0, [a, b, c].map(|i| corners[i]), Sides::Both);
                items.draw_corners(0, [a, c, d].map(|i| corners[i]), Sides::Both);
            }
            exact += items.ids().iter().filter(|&&id| id == 0).count();
            for (y, columns) in image.rows() {
                let front = image.front(y, columns);
                rounded += columns[1] + 1 - columns[0];
                for x in columns[0]..=columns[1] {
                    let depth = items.depths()[y * 61 + x];
                    off += usize::from(depth > 0.0 && front.at((x - columns[0]) as i32) > 1.05 * depth);
                }
            }
            rectangle += ((image.x[1] + 1 - image.x[0]) * (image.y[1] + 1 - image.y[0])) as usize;
        }
        assert!(exact > 10_000);
        // Outward by 1/128 px: a few pixels in a hundred at this resolution.
        assert!(rounded * 100 <= exact * 105, "{rounded} for {exact}");
        assert!(rounded * 100 < rectangle * 90, "{rounded} of {rectangle}");
        assert!(off * 100 < exact, "{off} of {exact} pixels too near");
    }
}
