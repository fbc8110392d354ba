//! May anything of a convex thing be seen past what was drawn?
//!
//! The thing's nearest depth and the rectangle around it are asked first: most of what is hidden is hidden by whole tiles.
//! Tiles that are open so far are then asked about the silhouette only, pixel by pixel, and about bounds of the thing's depth
//! that are linear over the image: a convex body starts, along each ray, at the farthest of the planes that face the eye.
//!
//! An edge of the silhouette is any line that the whole thing lies on one side of. Leaving edges or planes out is right too.

use fearless_simd::f64x8;
use fearless_simd::prelude::*;
use glam::DVec3;

use super::lanes::{Plane, TILE_X, TILE_Y, columns_outward, ramp, splat};
use super::{Coverage, LOOP_MAX, MaskedDepth};
use crate::Aabb;
use crate::raster_sampled::setup::{DEPTH_SLACK, Projector, SNAP_PX, ViewPoint};

/// Relative rounding of the transform, which cancels where a far corner lies beside the eye.
const ROUNDING: f64 = 1e-12;

/// Edges that turn by more columns a row than this are left out: in f32 they would be wrong by a part of a column.
const TURN_MAX: f64 = 64.0;

/// How far edges move outward, in pixels: for their rounding in f32 where they cross the image.
const EDGE_SLACK_PX: f64 = 1.0 / 256.0;

/// Most edges of a silhouette.
const EDGES_MAX: usize = 8;

/// Where a thing is.
#[expect(clippy::large_enum_variant, reason = "lives on the stack for one question")]
pub(super) enum Asked {
    /// No pixel sees any of it.
    Outside,
    /// It touches the eye or the near plane and may be in view, or nothing is known about it.
    Touching,
    In(Silhouette),
}

/// What a thing covers at most, and how near it is at most.
pub(super) struct Silhouette {
    place: Place,
    outline: Outline,
}

#[derive(Clone, Copy)]
struct Place {
    /// First and last column and row whose pixels it may touch.
    x: [i32; 2],
    y: [i32; 2],
    /// Its nearest depth, rounded up.
    z: f32,
}

/// The rest of it, computed only if it is needed.
enum Outline {
    Box { min: [f64; 3], max: [f64; 3], columns: [f64; 8], rows: [f64; 8], reach: f64 },
    Ball { centre: ViewPoint, radius: f64, reach: f64 },
    Hull { count: usize, columns: [f64; LOOP_MAX], rows: [f64; LOOP_MAX], depths: [f64; LOOP_MAX], reach: f64 },
}

/// A depth or an edge, linear over the image.
#[derive(Clone, Copy, Default)]
struct Linear {
    x: f64,
    y: f64,
    origin: f64,
}

/// Edges and planes of a silhouette.
#[derive(Default)]
struct Detail {
    /// Columns are at least (`left`) or at most (`right`) `origin + turn · row`.
    left: [[f64; 2]; EDGES_MAX],
    right: [[f64; 2]; EDGES_MAX],
    left_count: usize,
    right_count: usize,
    planes: [Linear; 3],
    plane_count: usize,
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

impl Asked {
    #[inline(always)]
    pub(super) fn of_box<S: Simd>(
        simd: S,
        image: &MaskedDepth,
        projector: &Projector,
        aabb: &Aabb,
        ask: bool,
    ) -> Asked {
        let min = aabb.min - projector.eye();
        let max = aabb.max - projector.eye();
        if !(min.cmple(max).all() && (min + max).is_finite()) {
            return Asked::Touching;
        }
        let size = max - min;
        let (x, y, w) = (
            along(simd, projector.axes[0], min, size),
            along(simd, projector.axes[1], min, size),
            along(simd, projector.axes[2], min, size),
        );
        let longest = min.abs().max(max.abs());
        let slack = 3.0 * (longest.x + longest.y + longest.z) * ROUNDING;
        if simd.reduce_max_f64x8(w) < -slack {
            return Asked::Outside;
        }
        let nearest = simd.reduce_min_f64x8(w) - slack;
        if nearest <= projector.near {
            let (x, y, w): ([f64; 8], [f64; 8], [f64; 8]) = (x.into(), y.into(), w.into());
            let points: [ViewPoint; 8] = std::array::from_fn(|i| ViewPoint { x: x[i], y: y[i], w: w[i] });
            return if projector.outside(&points, slack) { Asked::Outside } else { Asked::Touching };
        }
        let per_metre = f64x8::splat(simd, projector.focal_px) / w;
        let columns = x * per_metre + (projector.middle[0] - 0.5);
        let rows = (projector.middle[1] - 0.5) - y * per_metre;
        let reach = image.reach() + slack / nearest * projector.focal_px;
        let ranges = [range(simd, columns, reach), range(simd, rows, reach)];
        let Some(place) = place(simd, image, projector, ranges, nearest, ask) else { return Asked::Outside };
        let (min, max) = (min.to_array(), max.to_array());
        let outline = Outline::Box { min, max, columns: columns.into(), rows: rows.into(), reach };
        Asked::In(Silhouette { place, outline })
    }

    #[inline(always)]
    pub(super) fn of_ball<S: Simd>(
        simd: S,
        image: &MaskedDepth,
        projector: &Projector,
        centre: DVec3,
        radius: f64,
    ) -> Asked {
        let p = projector.view_point(centre);
        let size = p.x.abs() + p.y.abs() + p.w.abs() + radius;
        if !(size.is_finite() && radius >= 0.0) {
            return Asked::Touching;
        }
        let slack = 4.0 * size * ROUNDING;
        let radius = radius + slack;
        let nearest = p.w - radius;
        if p.w + radius < 0.0 {
            return Asked::Outside;
        }
        // Tangents lose precision as the eye plane nears the ball.
        if nearest <= projector.near || nearest < 1e-3 * p.w {
            let around = [-radius, radius];
            let corners = std::array::from_fn::<ViewPoint, 8, _>(|i| ViewPoint {
                x: p.x + around[i & 1],
                y: p.y + around[i >> 1 & 1],
                w: p.w + around[i >> 2],
            });
            return if projector.outside(&corners, slack) { Asked::Outside } else { Asked::Touching };
        }
        let reach = image.reach();
        let [x, y] = [tangents(p.x, p.w, radius), tangents(-p.y, p.w, radius)];
        let pixels = |[low, high]: [f64; 2], middle: f64| {
            [middle - 0.5 + low * projector.focal_px - reach, middle - 0.5 + high * projector.focal_px + reach]
        };
        let (x, y) = (pixels(x, projector.middle[0]), pixels(y, projector.middle[1]));
        let Some(place) = place(simd, image, projector, [x, y], nearest, true) else { return Asked::Outside };
        Asked::In(Silhouette { place, outline: Outline::Ball { centre: p, radius, reach } })
    }

    #[inline(always)]
    pub(super) fn of_hull<S: Simd>(simd: S, image: &MaskedDepth, projector: &Projector, corners: &[DVec3]) -> Asked {
        let count = corners.len();
        if !(1..=LOOP_MAX).contains(&count) {
            return Asked::Touching;
        }
        let mut points = [ViewPoint { x: 0.0, y: 0.0, w: 0.0 }; LOOP_MAX];
        let (mut size, mut sum, mut w) = (0.0_f64, 0.0, [f64::INFINITY, f64::NEG_INFINITY]);
        for (point, corner) in points.iter_mut().zip(corners) {
            *point = projector.view_point(*corner);
            let length = point.x.abs() + point.y.abs() + point.w.abs();
            sum += length;
            size = size.max(length);
            w = [w[0].min(point.w), w[1].max(point.w)];
        }
        if !f64::is_finite(sum) {
            return Asked::Touching;
        }
        let slack = size * ROUNDING;
        if w[1] < -slack {
            return Asked::Outside;
        }
        let nearest = w[0] - slack;
        if nearest <= projector.near {
            return if projector.outside(&points[..count], slack) { Asked::Outside } else { Asked::Touching };
        }
        let mut columns = [0.0; LOOP_MAX];
        let (mut rows, mut depths) = (columns, columns);
        let mut x = [f64::INFINITY, f64::NEG_INFINITY];
        let mut y = x;
        for (i, point) in points[..count].iter().enumerate() {
            let per_metre = projector.focal_px / point.w;
            columns[i] = projector.middle[0] - 0.5 + point.x * per_metre;
            rows[i] = projector.middle[1] - 0.5 - point.y * per_metre;
            depths[i] = projector.near / point.w;
            x = [x[0].min(columns[i]), x[1].max(columns[i])];
            y = [y[0].min(rows[i]), y[1].max(rows[i])];
        }
        let reach = image.reach() + slack / nearest * projector.focal_px;
        let [x, y] = [x, y].map(|[low, high]| [low - reach, high + reach]);
        let Some(place) = place(simd, image, projector, [x, y], nearest, true) else { return Asked::Outside };
        Asked::In(Silhouette { place, outline: Outline::Hull { count, columns, rows, depths, reach } })
    }
}

/// The rectangle of a thing and its nearest depth. `None` if no pixel sees it or, where it is to `ask`, all tiles hide it.
#[inline(always)]
fn place<S: Simd>(
    simd: S,
    image: &MaskedDepth,
    projector: &Projector,
    [x, y]: [[f64; 2]; 2],
    nearest: f64,
    ask: bool,
) -> Option<Place> {
    let (x, y) = (centres(x, projector.width), centres(y, projector.height));
    if x[0] > x[1] || y[0] > y[1] {
        return None;
    }
    let z = (projector.near / nearest * (1.0 + 2.0 * DEPTH_SLACK)) as f32;
    let (tiles_x, tiles_y) =
        ([x[0] as usize / TILE_X, x[1] as usize / TILE_X], [y[0] as usize / TILE_Y, y[1] as usize / TILE_Y]);
    if ask && image.tiles.nearer_in(simd, tiles_x, tiles_y, z) {
        return None;
    }
    Some(Place { x, y, z })
}

/// The eight corners of a box along an axis, x fastest.
#[inline(always)]
fn along<S: Simd>(simd: S, axis: DVec3, min: DVec3, size: DVec3) -> f64x8<S> {
    let in_x = f64x8::from_slice(simd, &[0.0, 1.0, 0.0, 1.0, 0.0, 1.0, 0.0, 1.0]);
    let in_y = f64x8::from_slice(simd, &[0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 1.0, 1.0]);
    let in_z = f64x8::from_slice(simd, &[0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0]);
    let base = min.x * axis.x + min.y * axis.y + min.z * axis.z;
    in_x * (size.x * axis.x) + in_y * (size.y * axis.y) + (in_z * (size.z * axis.z) + base)
}

/// Least and greatest, moved outward.
#[inline(always)]
fn range<S: Simd>(simd: S, v: f64x8<S>, reach: f64) -> [f64; 2] {
    [simd.reduce_min_f64x8(v) - reach, simd.reduce_max_f64x8(v) + reach]
}

/// The first and last of `size` pixels whose centres lie between `low` and `high`; descending if there is none.
#[inline(always)]
fn centres([low, high]: [f64; 2], size: i32) -> [i32; 2] {
    let size = f64::from(size);
    let (low, high) = (low.max(0.0).min(size), high.max(-1.0).min(size - 1.0));
    let [from, to] = [low as i32, high as i32];
    [from + i32::from(f64::from(from) < low), to - i32::from(f64::from(to) > high)]
}

/// Tangents of the lines x = m · z that touch a circle that lies wholly in front: (x − m·z)² = r²(1 + m²). Rounded outward.
#[inline(always)]
fn tangents(x: f64, z: f64, radius: f64) -> [f64; 2] {
    let scale = 1.0 / (z * z - radius * radius);
    let root = radius * (x * x + z * z - radius * radius).max(0.0).sqrt();
    let (low, high) = ((x * z - root) * scale, (x * z + root) * scale);
    let slack = 1e-9 * (1.0 + low.abs().max(high.abs()));
    [low - slack, high + slack]
}

impl Outline {
    #[inline(always)]
    fn detail(&self, projector: &Projector) -> Detail {
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

impl MaskedDepth {
    /// How far from a pixel's centre a thing may be that is drawn there.
    #[inline(always)]
    fn reach(&self) -> f64 {
        match self.coverage {
            Coverage::Sampled => 2.0 * SNAP_PX,
            Coverage::Under => 0.5 + 2.0 * SNAP_PX,
        }
    }

    #[inline(always)]
    pub(super) fn answer<S: Simd>(&self, simd: S, asked: Asked) -> bool {
        self.queries.set(self.queries.get() + 1);
        match asked {
            Asked::Outside => false,
            Asked::Touching => true,
            Asked::In(silhouette) => {
                // One copy of this for each level, whoever asks.
                simd.vectorize(
                    #[inline(always)]
                    || self.sees_in_detail(simd, &silhouette.place, &silhouette.outline),
                )
            }
        }
    }

    #[inline(always)]
    fn sees_in_detail<S: Simd>(&self, simd: S, asked: &Place, outline: &Outline) -> bool {
        let Some(projector) = &self.projector else { return true };
        let detail = outline.detail(projector);
        let tiles_x = [asked.x[0] as usize / TILE_X, asked.x[1] as usize / TILE_X];
        let tiles_y = [asked.y[0] as usize / TILE_Y, asked.y[1] as usize / TILE_Y];
        let mut read = 0;
        let mut seen = false;
        'rows: for tile_y in tiles_y[0]..=tiles_y[1] {
            if self.tiles.nearer_in(simd, tiles_x, [tile_y, tile_y], asked.z) {
                continue;
            }
            let top = (tile_y * TILE_Y) as f64;
            let rows = ramp(simd);
            let (mut from, mut to) = (splat(simd, asked.x[0] as f32), splat(simd, asked.x[1] as f32));
            for [origin, turn] in &detail.left[..detail.left_count] {
                from = simd.max_f32x8(from, rows * (*turn as f32) + (origin + turn * top).clamp(-1e5, 1e5) as f32);
            }
            for [origin, turn] in &detail.right[..detail.right_count] {
                to = simd.min_f32x8(to, rows * (*turn as f32) + (origin + turn * top).clamp(-1e5, 1e5) as f32);
            }
            let (first, last) = (asked.y[0] as f32 - top as f32, asked.y[1] as f32 - top as f32);
            let inside = rows.simd_ge(splat(simd, first)) & rows.simd_le(splat(simd, last)) & from.simd_le(to + 1.0);
            if !inside.any_true() {
                continue;
            }
            to = inside.select(to, splat(simd, -2.0));
            let least = simd.reduce_min_f32x8(inside.select(from, splat(simd, f32::MAX)));
            let greatest = simd.reduce_max_f32x8(to);
            let first = (least as usize / TILE_X).max(tiles_x[0]);
            let last = (greatest.max(0.0) as usize / TILE_X).min(tiles_x[1]);
            for tile_x in first..=last {
                if self.tiles.least_at(tile_x, tile_y) > asked.z {
                    continue;
                }
                let column = (tile_x * TILE_X) as f32;
                let mask = columns_outward(simd, from - column, to - column);
                read += 1;
                let mut limits = [Plane { at: asked.z, dx: 0.0, dy: 0.0 }; 4];
                for (limit, plane) in limits[1..].iter_mut().zip(&detail.planes[..detail.plane_count]) {
                    let at = plane.origin + plane.x * f64::from(column) + plane.y * top;
                    *limit = Plane { at: at as f32, dx: plane.x as f32, dy: plane.y as f32 };
                }
                if self.tiles.open(simd, tile_x, tile_y, mask, &limits[..1 + detail.plane_count]) {
                    seen = true;
                    break 'rows;
                }
            }
        }
        self.tiles_read.set(self.tiles_read.get() + read);
        seen
    }
}
