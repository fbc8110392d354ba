//! May anything of a convex thing be seen past what was drawn?
//!
//! The thing's nearest depth and the rectangle around it are asked first: most of what is hidden is hidden by whole tiles.
//! Tiles that are open so far are then asked about the silhouette only, pixel by pixel, and about bounds of the thing's depth
//! that are linear over the image: a convex body starts, along each ray, at the farthest of the planes that face the eye.

use fearless_simd::prelude::*;
use fearless_simd::{f32x8, f64x8};
use glam::DVec3;

use super::lanes::{Plane, TILE_X, TILE_Y, columns_outward, narrow, ramp, splat};
use super::outline::{Detail, EDGES_MAX, Linear, Outline, tangents};
use super::tiles::{BLOCK, BLOCKS_ASKED};
use super::{Coverage, LOOP_MAX, MaskedDepth};
use crate::Aabb;
use crate::raster_sampled::setup::{DEPTH_SLACK, Projector, SNAP_PX, ViewPoint};

/// Relative rounding of the transform, which cancels where a far corner lies beside the eye.
const ROUNDING: f64 = 1e-12;

/// By how much of the nearest depth a plane may change over a tile, to be asked in its place.
const FLAT: f64 = 0.125;

/// Where a thing is.
#[expect(clippy::large_enum_variant, reason = "lives on the stack for one question")]
pub(super) enum Asked {
    /// No pixel sees any of it.
    Outside,
    /// It touches the eye or the near plane and may be in view, or nothing is known about it.
    Touching,
    In(Silhouette),
}

/// The image's four sides, grown by a pixel, as planes through the eye: most of what is asked about lies outside one of them.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct SidePlanes {
    /// Coordinates of the inward normals in the scene, side by side.
    normals: [[f64; 4]; 3],
    /// Bounds their length.
    length: f64,
}

impl SidePlanes {
    pub(super) fn new(projector: &Projector) -> SidePlanes {
        let [right, up, forward] = projector.axes.map(|axis| axis * projector.focal_px);
        let [x, y] = projector.middle.map(|half| (half + 1.0) / projector.focal_px);
        let sides = [forward * x - right, forward * x + right, forward * y - up, forward * y + up];
        let normals = [0, 1, 2].map(|axis| sides.map(|side| side[axis]));
        SidePlanes { normals, length: projector.focal_px * (1.0 + x + y) }
    }

    /// Whether a box, given from the eye, is outside one side by more than `slack` metres. Holds behind the eye too.
    #[inline(always)]
    fn leave_out(&self, min: DVec3, max: DVec3, slack: f64) -> bool {
        let (middle, size) = ((min + max).to_array(), (max - min).to_array());
        // Twice the greatest height over each side.
        let mut greatest = [0.0_f64; 4];
        for axis in 0..3 {
            for (greatest, normal) in greatest.iter_mut().zip(&self.normals[axis]) {
                *greatest += normal * middle[axis] + normal.abs() * size[axis];
            }
        }
        let doubt = -2.0 * slack * self.length;
        (greatest[0] < doubt) | (greatest[1] < doubt) | (greatest[2] < doubt) | (greatest[3] < doubt)
    }
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
        let longest = min.abs().max(max.abs());
        let slack = 3.0 * (longest.x + longest.y + longest.z) * ROUNDING;
        if image.sides.leave_out(min, max, slack) {
            return Asked::Outside;
        }
        let size = max - min;
        let (x, y, w) = (
            along(simd, projector.axes[0], min, size),
            along(simd, projector.axes[1], min, size),
            along(simd, projector.axes[2], min, size),
        );
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

/// Where edges are in a row, given what they turn up to it; cut to where f32 still tells columns apart.
#[inline(always)]
fn offsets<S: Simd>(simd: S, origin: &[f64; EDGES_MAX], turned: f64x8<S>) -> [f32; EDGES_MAX] {
    let at = simd.max_f64x8(f64x8::from_slice(simd, origin) + turned, f64x8::splat(simd, -1e5));
    narrow(simd, simd.min_f64x8(at, f64x8::splat(simd, 1e5))).into()
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

/// The columns that a silhouette begins and ends with in each row of a row of tiles, and the first and last tile that these are
/// in; descending if there are none.
#[inline(always)]
fn row_of<S: Simd>(simd: S, asked: &Place, detail: &Detail, top: f64) -> (f32x8<S>, f32x8<S>, usize, usize) {
    let rows = ramp(simd);
    let (mut from, mut to) = (splat(simd, asked.x[0] as f32), splat(simd, asked.x[1] as f32));
    let turned = f64x8::from_slice(simd, &detail.turn) * top;
    let left = offsets(simd, &detail.left, turned);
    let right = offsets(simd, &detail.right, turned);
    for i in 0..detail.edge_count {
        let across = rows * (detail.turn[i] as f32);
        from = simd.max_f32x8(from, across + left[i]);
        to = simd.min_f32x8(to, across + right[i]);
    }
    let (first, last) = (asked.y[0] as f32 - top as f32, asked.y[1] as f32 - top as f32);
    let inside = rows.simd_ge(splat(simd, first)) & rows.simd_le(splat(simd, last)) & from.simd_le(to + 1.0);
    if !inside.any_true() {
        return (from, to, 1, 0);
    }
    to = inside.select(to, splat(simd, -2.0));
    let least = simd.reduce_min_f32x8(inside.select(from, splat(simd, f32::MAX)));
    let greatest = simd.reduce_max_f32x8(to);
    let first = (least as usize / TILE_X).max(asked.x[0] as usize / TILE_X);
    let last = (greatest.max(0.0) as usize / TILE_X).min(asked.x[1] as usize / TILE_X);
    (from, to, first, last)
}

/// The first and last of `size` pixels whose centres lie between `low` and `high`; descending if there is none.
#[inline(always)]
fn centres([low, high]: [f64; 2], size: i32) -> [i32; 2] {
    let size = f64::from(size);
    let (low, high) = (low.max(0.0).min(size), high.max(-1.0).min(size - 1.0));
    let [from, to] = [low as i32, high as i32];
    [from + i32::from(f64::from(from) < low), to - i32::from(f64::from(to) > high)]
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
        let detail = outline.detail(simd, projector);
        let tiles_x = [asked.x[0] as usize / TILE_X, asked.x[1] as usize / TILE_X];
        let tiles_y = [asked.y[0] as usize / TILE_Y, asked.y[1] as usize / TILE_Y];
        // A plane that hardly changes over a tile tells as much as the nearest depth.
        let flat =
            |plane: &Linear| plane.x.abs() * TILE_X as f64 + plane.y.abs() * TILE_Y as f64 <= f64::from(asked.z) * FLAT;
        let skipped = usize::from(detail.planes[..detail.plane_count].iter().any(flat));
        let mut read = 0;
        let mut seen = false;
        let [block_first, block_last] = tiles_x.map(|tile_x| tile_x / BLOCK);
        'rows: for tile_y in tiles_y[0]..=tiles_y[1] {
            let top = (tile_y * TILE_Y) as f64;
            let mut edges = None;
            for block_x in (block_first..=block_last).step_by(BLOCKS_ASKED) {
                let blocks = (block_last + 1 - block_x).min(BLOCKS_ASKED);
                let mut limits = [Plane { at: asked.z, dx: 0.0, dy: 0.0 }; 4];
                detail.limits(&mut limits, block_x * BLOCK * TILE_X, top);
                // Most tiles are decided here, eight at a time, whatever part of them is asked about.
                let (from_tile, to_tile) = (tiles_x[0].max(block_x * BLOCK), tiles_x[1] - block_x * BLOCK);
                let wanted = (u64::MAX << (from_tile - block_x * BLOCK)) & (u64::MAX >> (63 - to_tile.min(63)));
                let useful = &limits[skipped..=detail.plane_count];
                let mut undecided = self.tiles.undecided(simd, block_x, blocks, tile_y, wanted, useful);
                if undecided == 0 {
                    continue;
                }
                let (from, to, first, last) = match edges {
                    Some(edges) => edges,
                    None => *edges.insert(row_of(simd, asked, &detail, top)),
                };
                while undecided != 0 {
                    let tile_x = block_x * BLOCK + undecided.trailing_zeros() as usize;
                    undecided &= undecided - 1;
                    if tile_x < first || tile_x > last {
                        continue;
                    }
                    let column = tile_x * TILE_X;
                    let mask = columns_outward(simd, from - column as f32, to - column as f32);
                    read += 1;
                    detail.limits(&mut limits, column, top);
                    let useful = &limits[skipped..=detail.plane_count];
                    if self.tiles.open(simd, tile_x, tile_y, mask, useful) {
                        seen = true;
                        break 'rows;
                    }
                }
            }
        }
        self.tiles_read.set(self.tiles_read.get() + read);
        seen
    }
}
