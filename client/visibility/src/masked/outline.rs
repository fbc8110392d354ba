//! What is a convex thing's silhouette, and how near is it at most at each pixel?
//!
//! An edge of the silhouette is any line that the whole thing lies on one side of, and its depth is bounded by any plane that it
//! lies behind. Leaving edges or planes out is right too.

use super::LOOP_MAX;
use crate::raster_sampled::setup::{DEPTH_SLACK, Projector, ViewPoint};

/// Edges that turn by more columns a row than this are left out: in f32 they would be wrong by a part of a column.
const TURN_MAX: f64 = 64.0;

/// How far edges move outward, in pixels: for their rounding in f32 where they cross the image.
const EDGE_SLACK_PX: f64 = 1.0 / 256.0;

/// Most edges of a silhouette.
const EDGES_MAX: usize = 8;

/// The rest of it, computed only if it is needed.
pub(super) enum Outline {
    Box { min: [f64; 3], max: [f64; 3], columns: [f64; 8], rows: [f64; 8], reach: f64 },
    Ball { centre: ViewPoint, radius: f64, reach: f64 },
    Hull { count: usize, columns: [f64; LOOP_MAX], rows: [f64; LOOP_MAX], depths: [f64; LOOP_MAX], reach: f64 },
}

/// A depth or an edge, linear over the image.
#[derive(Clone, Copy, Default)]
pub(super) struct Linear {
    pub(super) x: f64,
    pub(super) y: f64,
    pub(super) origin: f64,
}

/// Edges and planes of a silhouette.
#[derive(Default)]
pub(super) struct Detail {
    /// Columns are at least (`left`) or at most (`right`) `origin + turn · row`.
    pub(super) left: [[f64; 2]; EDGES_MAX],
    pub(super) right: [[f64; 2]; EDGES_MAX],
    pub(super) left_count: usize,
    pub(super) right_count: usize,
    pub(super) planes: [Linear; 3],
    pub(super) plane_count: usize,
}

impl Detail {
    /// Adds the line along (dx, dy) that all points lie on the same side of as `inside`, moved outward by `reach` pixels.
    #[inline(always)]
    fn add_edge(&mut self, [ax, ay]: [f64; 2], [bx, by]: [f64; 2], inside: [f64; 2], reach: f64) {
        let dy = by - ay;
        let turn = (bx - ax) / dy;
        // Also leaves out NaN, for edges of no length.
        if !(turn.abs() <= TURN_MAX) {
            return;
        }
        let origin = ax - turn * ay;
        let reach = (reach + EDGE_SLACK_PX) * (1.0 + turn.abs());
        if inside[0] - turn * inside[1] >= origin {
            self.left[self.left_count] = [origin - reach, turn];
            self.left_count += 1;
        } else {
            self.right[self.right_count] = [origin + reach, turn];
            self.right_count += 1;
        }
    }

    #[inline(always)]
    fn add_plane(&mut self, plane: Linear, reach: f64) {
        let raised = plane.origin + reach * (plane.x.abs() + plane.y.abs());
        let scale = 1.0 + 2.0 * DEPTH_SLACK;
        if (plane.x + plane.y + raised).is_finite() {
            self.planes[self.plane_count] = Linear { x: plane.x * scale, y: plane.y * scale, origin: raised * scale };
            self.plane_count += 1;
        }
    }
}

/// The 12 edges of a box as pairs of corners (x is bit 0), with the two faces that meet there: axis, and 3 more at its maximum.
const BOX_EDGES: [([usize; 2], [usize; 2]); 12] = {
    let mut edges = [([0; 2], [0; 2]); 12];
    let mut i = 0;
    while i < 12 {
        let axis = i / 4;
        let (b, c) = ((axis + 1) % 3, (axis + 2) % 3);
        let (at_b, at_c) = (i % 2, i / 2 % 2);
        let corner = at_b << b | at_c << c;
        edges[i] = ([corner, corner | 1 << axis], [b + 3 * at_b, c + 3 * at_c]);
        i += 1;
    }
    edges
};

/// Tangents of the lines x = m · z that touch a circle that lies wholly in front: (x − m·z)² = r²(1 + m²). Rounded outward.
#[inline(always)]
pub(super) fn tangents(x: f64, z: f64, radius: f64) -> [f64; 2] {
    let scale = 1.0 / (z * z - radius * radius);
    let root = radius * (x * x + z * z - radius * radius).max(0.0).sqrt();
    let (low, high) = ((x * z - root) * scale, (x * z + root) * scale);
    let slack = 1e-9 * (1.0 + low.abs().max(high.abs()));
    [low - slack, high + slack]
}

impl Outline {
    #[inline(always)]
    pub(super) fn detail(&self, projector: &Projector) -> Detail {
        let mut detail = Detail::default();
        match self {
            Outline::Box { min, max, columns, rows, reach } => {
                let inside = [columns.iter().sum::<f64>() * 0.125, rows.iter().sum::<f64>() * 0.125];
                // Bits of the faces that look at the eye: at the minimum, then at the maximum of each axis.
                let mut facing = 0_u32;
                for axis in 0..3 {
                    facing |= u32::from(min[axis] > 0.0) << axis | u32::from(max[axis] < 0.0) << (axis + 3);
                }
                for ([a, b], [face, other]) in BOX_EDGES {
                    if (facing >> face ^ facing >> other) & 1 == 1 {
                        detail.add_edge([columns[a], rows[a]], [columns[b], rows[b]], inside, *reach);
                    }
                }
                for axis in 0..3 {
                    // 1/w is (n·d)/(n·c) where the direction d with forward part 1 meets the face's plane.
                    let distance = if min[axis] > 0.0 {
                        min[axis]
                    } else if max[axis] < 0.0 {
                        max[axis]
                    } else {
                        continue;
                    };
                    let [right, up, forward] =
                        [projector.axes[0][axis], projector.axes[1][axis], projector.axes[2][axis]];
                    let scale = projector.near / distance;
                    let (x, y) = (right / projector.focal_px * scale, -up / projector.focal_px * scale);
                    let [column, row] = [projector.middle[0] - 0.5, projector.middle[1] - 0.5];
                    detail.add_plane(Linear { x, y, origin: forward * scale - x * column - y * row }, *reach);
                }
            }
            Outline::Ball { centre, radius, reach } => {
                // With the upright rectangle an octagon: tangents along the diagonals.
                let half = std::f64::consts::FRAC_1_SQRT_2;
                let [column, row] = [projector.middle[0] - 0.5, projector.middle[1] - 0.5];
                let inside =
                    [column + centre.x / centre.w * projector.focal_px, row - centre.y / centre.w * projector.focal_px];
                for down in [1.0, -1.0] {
                    let across = tangents((centre.x - down * centre.y) * half, centre.w, *radius);
                    for tangent in across {
                        // The line x + down · y = c.
                        let at = column + tangent * projector.focal_px / half;
                        detail.add_edge([at, row], [at - down, row + 1.0], inside, *reach);
                    }
                }
                // All of the ball lies beyond the plane that touches it before its centre.
                let length = (centre.x * centre.x + centre.y * centre.y + centre.w * centre.w).sqrt();
                let scale = projector.near / (length * (length - radius));
                let (x, y) = (centre.x / projector.focal_px * scale, -centre.y / projector.focal_px * scale);
                detail.add_plane(Linear { x, y, origin: centre.w * scale - x * column - y * row }, *reach);
            }
            Outline::Hull { count, columns, rows, depths, reach } => {
                let (columns, rows, depths) = (&columns[..*count], &rows[..*count], &depths[..*count]);
                let mut normal = [0.0; 3];
                for i in 0..*count {
                    let j = if i + 1 == *count { 0 } else { i + 1 };
                    hull_edge(&mut detail, columns, rows, i, j, *reach);
                    let [a, b] = [i, j].map(|i| [columns[i] - columns[0], rows[i] - rows[0], depths[i] - depths[0]]);
                    for (k, normal) in normal.iter_mut().enumerate() {
                        let (l, m) = ((k + 1) % 3, (k + 2) % 3);
                        *normal += a[l] * b[m] - a[m] * b[l];
                    }
                }
                let (x, y) = (-normal[0] / normal[2], -normal[1] / normal[2]);
                let mut origin = f64::NEG_INFINITY;
                for ((column, row), depth) in columns.iter().zip(rows).zip(depths) {
                    origin = origin.max(depth - x * column - y * row);
                }
                detail.add_plane(Linear { x, y, origin }, *reach);
            }
        }
        detail
    }
}

/// Adds the line along an edge that all points lie on one side of, if they nearly do anyway.
#[inline(always)]
fn hull_edge(detail: &mut Detail, columns: &[f64], rows: &[f64], i: usize, j: usize, reach: f64) {
    let turn = (columns[j] - columns[i]) / (rows[j] - rows[i]);
    if !(turn.abs() <= TURN_MAX) || detail.left_count.max(detail.right_count) == EDGES_MAX {
        return;
    }
    let [mut low, mut high] = [f64::INFINITY, f64::NEG_INFINITY];
    for (column, row) in columns.iter().zip(rows) {
        let at = column - turn * row;
        (low, high) = (low.min(at), high.max(at));
    }
    let reach = (reach + EDGE_SLACK_PX) * (1.0 + turn.abs());
    let here = columns[i] - turn * rows[i];
    if here - low <= high - here {
        detail.left[detail.left_count] = [low - reach, turn];
        detail.left_count += 1;
    } else {
        detail.right[detail.right_count] = [high + reach, turn];
        detail.right_count += 1;
    }
}
