//! What is a convex thing's silhouette, and how near is it at most at each pixel?
//!
//! An edge of the silhouette is any line that the whole thing lies on one side of, and its depth is bounded by any plane that it
//! lies behind. Leaving edges or planes out is right too.

use fearless_simd::f64x8;
use fearless_simd::prelude::*;

use super::LOOP_MAX;
use super::lanes::Plane;
use crate::raster_sampled::setup::{DEPTH_SLACK, Projector, ViewPoint};

/// Edges that turn by more columns a row than this are left out: in f32 they would be wrong by a part of a column.
const TURN_MAX: f64 = 64.0;

/// How far edges move outward, in pixels: for their rounding in f32 where they cross the image.
const EDGE_SLACK_PX: f64 = 1.0 / 256.0;

/// Most edges of a silhouette.
pub(super) const EDGES_MAX: usize = 8;

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
pub(super) struct Detail {
    /// Columns are at least `left + turn · row` and at most `right + turn · row`. Of each edge one of them is [`NO_BOUND`] away.
    pub(super) left: [f64; EDGES_MAX],
    pub(super) right: [f64; EDGES_MAX],
    pub(super) turn: [f64; EDGES_MAX],
    pub(super) edge_count: usize,
    pub(super) planes: [Linear; 3],
    pub(super) plane_count: usize,
}

/// Farther than any column.
const NO_BOUND: f64 = 1e18;

impl Detail {
    /// Writes the planes as they are in the tile that begins with this column and row behind the first limit.
    #[inline(always)]
    pub(super) fn limits(&self, limits: &mut [Plane], column: usize, row: f64) {
        for (limit, plane) in limits[1..].iter_mut().zip(&self.planes[..self.plane_count]) {
            let at = plane.origin + plane.x * column as f64 + plane.y * row;
            *limit = Plane { at: at as f32, dx: plane.x as f32, dy: plane.y as f32 };
        }
    }

    #[inline(always)]
    fn new() -> Detail {
        Detail {
            left: [-NO_BOUND; EDGES_MAX],
            right: [NO_BOUND; EDGES_MAX],
            turn: [0.0; EDGES_MAX],
            edge_count: 0,
            planes: [Linear::default(); 3],
            plane_count: 0,
        }
    }

    /// Adds lines through pairs of points that everything lies on the same side of as `inside`, moved outward by `reach`
    /// pixels. All at once, since which edges a box shows, and on which side, is never the same twice.
    #[inline(always)]
    fn set_edges<S: Simd>(
        &mut self,
        simd: S,
        [ax, ay]: [&[f64; EDGES_MAX]; 2],
        [bx, by]: [&[f64; EDGES_MAX]; 2],
        inside: [f64; 2],
        reach: f64,
        count: usize,
    ) {
        let (ax, ay) = (f64x8::from_slice(simd, ax), f64x8::from_slice(simd, ay));
        let (bx, by) = (f64x8::from_slice(simd, bx), f64x8::from_slice(simd, by));
        let turn = (bx - ax) / (by - ay);
        // Also leaves out NaN, for edges of no length.
        let is_edge = simd.abs_f64x8(turn).simd_le(f64x8::splat(simd, TURN_MAX));
        let turn = is_edge.select(turn, f64x8::splat(simd, 0.0));
        let origin = ax - turn * ay;
        let reach = (simd.abs_f64x8(turn) + 1.0) * (reach + EDGE_SLACK_PX);
        let is_left = (f64x8::splat(simd, inside[0]) - turn * inside[1]).simd_ge(origin);
        let left = (is_edge & is_left).select(origin - reach, f64x8::splat(simd, -NO_BOUND));
        let right = (is_edge & !is_left).select(origin + reach, f64x8::splat(simd, NO_BOUND));
        left.store_slice(&mut self.left);
        right.store_slice(&mut self.right);
        turn.store_slice(&mut self.turn);
        self.edge_count = count;
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

/// Pairs of corners of a box (x is bit 0): the edges of its silhouette, of which there are at most six.
#[derive(Clone, Copy)]
struct BoxEdges {
    pairs: [[u8; 2]; EDGES_MAX],
    count: u8,
}

/// The silhouettes of a box by the faces that look at the eye: bit `axis`, and 3 more at its maximum. Opposite faces never both do.
const SILHOUETTES: [BoxEdges; 64] = {
    let mut all = [BoxEdges { pairs: [[0; 2]; EDGES_MAX], count: 0 }; 64];
    let mut facing = 0;
    while facing < 64 {
        let mut i = 0;
        while i < 12 {
            let axis = i / 4;
            let (b, c) = ((axis + 1) % 3, (axis + 2) % 3);
            let (at_b, at_c) = (i % 2, i / 2 % 2);
            let corner = at_b << b | at_c << c;
            let silhouette = (facing >> (b + 3 * at_b) ^ facing >> (c + 3 * at_c)) & 1 == 1;
            let count = all[facing].count as usize;
            if silhouette && count < EDGES_MAX {
                all[facing].pairs[count] = [corner as u8, (corner | 1 << axis) as u8];
                all[facing].count += 1;
            }
            i += 1;
        }
        facing += 1;
    }
    all
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
    pub(super) fn detail<S: Simd>(&self, simd: S, projector: &Projector) -> Detail {
        let mut detail = Detail::new();
        match self {
            Outline::Box { min, max, columns, rows, reach } => {
                // Bits of the faces that look at the eye: at the minimum, then at the maximum of each axis.
                let mut facing = 0;
                for axis in 0..3 {
                    facing |= usize::from(min[axis] > 0.0) << axis | usize::from(max[axis] < 0.0) << (axis + 3);
                }
                let edges = &SILHOUETTES[facing];
                let [mut ax, mut ay, mut bx, mut by] = [[0.0; EDGES_MAX]; 4];
                for (i, [a, b]) in edges.pairs.iter().enumerate() {
                    let (a, b) = (*a as usize & 7, *b as usize & 7);
                    (ax[i], ay[i], bx[i], by[i]) = (columns[a], rows[a], columns[b], rows[b]);
                }
                // The middle of a diagonal is inside the box; on a line of its silhouette only if the box is seen as that line.
                let inside = [(columns[0] + columns[7]) * 0.5, (rows[0] + rows[7]) * 0.5];
                detail.set_edges(simd, [&ax, &ay], [&bx, &by], inside, *reach, edges.count as usize);
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
                let (mut at, mut to, mut below) = ([row; EDGES_MAX], [row; EDGES_MAX], [row; EDGES_MAX]);
                for (i, down) in [1.0, -1.0].into_iter().enumerate() {
                    let across = tangents((centre.x - down * centre.y) * half, centre.w, *radius);
                    for (j, tangent) in across.into_iter().enumerate() {
                        // The line x + down · y = c.
                        at[2 * i + j] = column + tangent * projector.focal_px / half;
                        to[2 * i + j] = at[2 * i + j] - down;
                        below[2 * i + j] = row + 1.0;
                    }
                }
                detail.set_edges(simd, [&at, &[row; EDGES_MAX]], [&to, &below], inside, *reach, 4);
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
    if !(turn.abs() <= TURN_MAX) {
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
        detail.left[detail.edge_count] = low - reach;
    } else {
        detail.right[detail.edge_count] = high + reach;
    }
    detail.turn[detail.edge_count] = turn;
    detail.edge_count += 1;
}
