//! Which pixels does a convex polygon cover, and how near does it close them at least?
//!
//! Corners are moved to the image and snapped as [`crate::ItemBuffer`] does it, by the same code. From there on coverage is
//! exact: the pixels on the inner side of every edge, by integers. A pixel on the inner side of all edges of a loop lies in
//! one of the triangles that the loop is a fan of, whether the loop is convex or not: the loop winds around it once at
//! least, and its winding number is the sum of theirs. So what is covered here is covered there.
//!
//! A row is bounded by the edges that reach into it, or into the square of one of its pixels. That is enough, for the same
//! reason: of these edges those on the left of a pixel make up its winding number.
//!
//! An edge bounds the columns of a row by ⌊n/k⌋ with n linear in the row. Quotient and remainder are carried from tile row to
//! tile row; within one, eight rows are lanes, and all numbers are whole and below 2⁵³, where f64 is exact.

use fearless_simd::prelude::*;
use fearless_simd::{f32x8, f64x8};

use super::Coverage;
use super::lanes::{Plane, ROUNDING};
use super::lanes::{TILE_X, TILE_Y, columns, narrow, nearest, ramp_f64, splat};
use super::tiles::{RowPlane, Tiles};
use crate::Sides;
use crate::raster_sampled::setup::{Corner, DEPTH_SLACK, SNAP_PX};

/// Most corners of a loop after clipping: eight, and one for each of five planes.
pub(super) const CORNERS_MAX: usize = 13;

/// In 1/256 px, by how much more than half a pixel edges move inward for under-estimating coverage: each end of an edge
/// is snapped by at most √2/2 here and half of that in an image at least twice as fine.
const SNAP_INSET: i64 = 2;

/// One edge's bound on the columns of the rows from a tile row's first on.
#[derive(Clone, Copy, Debug, Default)]
struct Edge {
    /// ⌊n/k⌋ and the remainder in the first row.
    quotient: f64,
    remainder: f64,
    k: f64,
    inverse_k: f64,
    /// Steps to the next row and to the next tile row.
    row: [f64; 2],
    tile: [f64; 2],
    /// What takes it out of the bounds on the left, or of those on the right: [`NEVER`] or 0.
    not_left: f64,
    not_right: f64,
    /// First and last row of tiles that it reaches into; `quotient` begins with the first.
    tiles: [i64; 2],
}

/// Farther than any column.
const NEVER: f64 = 1e18;

/// From 1/256 px to rows of tiles.
const TILE_SHIFT: u32 = 8 + TILE_Y.trailing_zeros();

/// ⌊n/k⌋ and the remainder, exact for |n| < 2⁶² and 0 < k < 2⁵².
#[inline(always)]
fn divide(n: i64, k: i64, inverse_k: f64) -> [f64; 2] {
    const EXACT: u64 = 1 << 51;
    if n.unsigned_abs() < EXACT {
        const ROUND: f64 = 6_755_399_441_055_744.0;
        let (n, k) = (n as f64, k as f64);
        let quotient = (n * inverse_k + ROUND) - ROUND;
        let remainder = n - quotient * k;
        // By arithmetic: a branch would be guessed wrong half of the time, here and below.
        let less = f64::from(u8::from(remainder < 0.0));
        [quotient - less, remainder + less * k]
    } else {
        [n.div_euclid(k) as f64, n.rem_euclid(k) as f64]
    }
}

impl Edge {
    /// From n in the first row, the change of n a row by 256, and k/256.
    #[inline(always)]
    fn new(n: i64, dx: i64, height: i64) -> Edge {
        let inverse = 1.0 / height as f64;
        let (k, inverse_k) = ((height << 8) as f64, inverse * (1.0 / 256.0));
        let [quotient, remainder] = divide(n, height << 8, inverse_k);
        let [row, row_rest] = divide(dx, height, inverse);
        let [tile, tile_rest] = divide(dx * TILE_Y as i64, height, inverse);
        Edge {
            quotient,
            remainder,
            k,
            inverse_k,
            row: [row, row_rest * 256.0],
            tile: [tile, tile_rest * 256.0],
            not_left: 0.0,
            not_right: 0.0,
            tiles: [0, 0],
        }
    }

    /// ⌊n/k⌋ in each row of the tile row.
    #[inline(always)]
    fn quotients<S: Simd>(&self, simd: S) -> f64x8<S> {
        let rows = ramp_f64(simd);
        let rest = rows * self.row[1] + self.remainder;
        let whole = nearest(rest * self.inverse_k);
        let over = rest - whole * self.k;
        let less = over.simd_lt(f64x8::splat(simd, 0.0)).select(f64x8::splat(simd, 1.0), f64x8::splat(simd, 0.0));
        rows * self.row[0] + self.quotient + (whole - less)
    }

    #[inline(always)]
    fn next_tile_row(&mut self) {
        self.quotient += self.tile[0];
        self.remainder += self.tile[1];
        let carry = f64::from(u8::from(self.remainder >= self.k));
        self.remainder -= carry * self.k;
        self.quotient += carry;
    }
}

/// The first pixel of the image whose centre is at or after a place in 1/256 px.
#[inline(always)]
fn first_centre(least: i64) -> i32 {
    ((least + 255) >> 8).max(0) as i32
}

/// The last one of so many whose centre is at or before it.
#[inline(always)]
fn last_centre(greatest: i64, size: i32) -> i32 {
    (greatest >> 8).min(i64::from(size) - 1) as i32
}

/// A whole number from 0 to 2²² as an integer. Conversions by `as` also look after those outside.
#[inline(always)]
fn whole(v: f32) -> usize {
    ((v + 8_388_608.0).to_bits() & 0x7f_ffff) as usize
}

/// Draws the loop, at depths of points up to `spread` px away; returns whether it may cover a pixel.
pub(super) fn draw_loop<S: Simd>(
    simd: S,
    tiles: &mut Tiles,
    corners: &[Corner],
    sides: Sides,
    coverage: Coverage,
    spread: f64,
) -> bool {
    // One copy of this for each level, whoever calls.
    simd.vectorize(
        #[inline(always)]
        || draw_inlined(simd, tiles, corners, sides, coverage, spread),
    )
}

#[inline(always)]
fn draw_inlined<S: Simd>(
    simd: S,
    tiles: &mut Tiles,
    corners: &[Corner],
    sides: Sides,
    coverage: Coverage,
    spread: f64,
) -> bool {
    let count = corners.len();
    let origin = corners[0];
    // Twice the area, and the normal of the loop in columns, rows and depth.
    let (mut area, mut normal) = (0_i64, [0.0_f64; 2]);
    let mut bounds = [origin.x, origin.x, origin.y, origin.y];
    let mut depths = [origin.z, origin.z];
    for i in 1..count {
        let (a, b) = (corners[i - 1], corners[i]);
        let ([ax, ay], [bx, by]) = ([a.x - origin.x, a.y - origin.y], [b.x - origin.x, b.y - origin.y]);
        area += ax * by - ay * bx;
        let (az, bz) = (a.z - origin.z, b.z - origin.z);
        normal[0] += ay as f64 * bz - az * by as f64;
        normal[1] += az * bx as f64 - ax as f64 * bz;
        bounds = [bounds[0].min(b.x), bounds[1].max(b.x), bounds[2].min(b.y), bounds[3].max(b.y)];
        depths = [depths[0].min(b.z), depths[1].max(b.z)];
    }
    // Rows grow downward, so that an anticlockwise loop has a negative area.
    if area == 0 || (area > 0 && sides == Sides::Front) {
        return false;
    }
    let inset = match coverage {
        Coverage::Sampled => 0,
        Coverage::Under => 128 + SNAP_INSET,
    };
    let x = [first_centre(bounds[0] + inset), last_centre(bounds[1] - inset, tiles.width)];
    let mut y = [first_centre(bounds[2] + inset), last_centre(bounds[3] - inset, tiles.height)];
    if x[0] > x[1] || y[0] > y[1] {
        return false;
    }

    // What lies behind whole tiles is left out before it costs anything: all of it here, a row of tiles below.
    let nearest = depths[1] as f32 * (1.0 + DEPTH_SLACK as f32);
    let tiles_x = [x[0] as usize / TILE_X, x[1] as usize / TILE_X];
    let tiles_y = [y[0] as usize / TILE_Y, y[1] as usize / TILE_Y];
    if tiles.nearer_in(simd, tiles_x, tiles_y, nearest) {
        return true;
    }

    let mut edges = [Edge::default(); CORNERS_MAX];
    let mut edge_count = 0;
    let right_of_image = i64::from(tiles.width) << 8;
    let tile_rows = [i64::from(y[0]) / TILE_Y as i64, i64::from(y[1]) / TILE_Y as i64];
    let mut from = corners[count - 1];
    for &corner in corners {
        let to = corner;
        // Turned so that the inside has positive values of dx · (y − from.y) − dy · (x − from.x).
        let (a, b) = if area > 0 { (from, to) } else { (to, from) };
        from = corner;
        let (dx, dy) = (b.x - a.x, b.y - a.y);
        // The top-left rule: centres on left edges and on upper horizontal ones are covered, on others not.
        if dy == 0 {
            if dx > 0 {
                y[0] = y[0].max(first_centre(a.y + inset));
            } else if dx < 0 {
                let outside = i64::from(coverage == Coverage::Sampled);
                y[1] = y[1].min(last_centre(a.y - outside - inset, tiles.height));
            }
            continue;
        }
        // An edge bounds the rows that it reaches into, and a pixel's square around them. The others it may be left out
        // of: a pixel's winding number follows from the edges that cross its row.
        let reached = [(a.y.min(b.y) - 256) >> TILE_SHIFT, (a.y.max(b.y) + 256) >> TILE_SHIFT];
        let reached = [reached[0].max(tile_rows[0]), reached[1].min(tile_rows[1])];
        // What lies beside the image bounds nothing in it.
        let beside = if dy > 0 { a.x.min(b.x) > right_of_image } else { a.x.max(b.x) < -256 };
        if reached[0] > reached[1] || beside {
            continue;
        }
        let strict = match coverage {
            Coverage::Sampled => i64::from(dy > 0),
            Coverage::Under => (dx.abs() + dy.abs()) * inset,
        };
        let n = dx * ((reached[0] << TILE_SHIFT) - a.y) + dy * a.x - strict;
        let right = f64::from(u8::from(dy > 0));
        let (not_left, not_right) = (right * NEVER, (1.0 - right) * NEVER);
        edges[edge_count] = Edge { not_left, not_right, tiles: reached, ..Edge::new(n, dx, dy.abs()) };
        edge_count += 1;
    }
    let edges = &mut edges[..edge_count];
    if y[0] > y[1] {
        return false;
    }
    // Under-estimating: the farthest point of the pixel's square, and corners that a finer image snaps to other places.
    let spread = spread + if coverage == Coverage::Under { 0.5 + 2.0 * SNAP_PX } else { 0.0 };
    let depth = LoopDepth::new(corners, area, normal, depths, spread, x, y, nearest);

    // `y[0]` may have grown; the edges start where it was.
    let first_tile_y = y[0] as usize / TILE_Y;
    for tile_y in tile_rows[0] as usize..=y[1] as usize / TILE_Y {
        let hidden = tile_y < first_tile_y || tiles.nearer_in(simd, tiles_x, [tile_y, tile_y], nearest);
        let (mut from, mut to) = (f64x8::splat(simd, f64::from(x[0])), f64x8::splat(simd, f64::from(x[1])));
        for edge in &mut *edges {
            if (tile_y as i64) < edge.tiles[0] || tile_y as i64 > edge.tiles[1] {
                continue;
            }
            if !hidden {
                let bound = edge.quotients(simd);
                from = simd.max_f64x8(from, -(bound + edge.not_left));
                to = simd.min_f64x8(to, bound + edge.not_right);
            }
            edge.next_tile_row();
        }
        if !hidden {
            fill_row(simd, tiles, tile_y, y, narrow(simd, from), narrow(simd, to), &depth);
        }
    }
    true
}

/// Closes the pixels of a tile row between `from` and `to`, both included, in the rows `y[0]` to `y[1]`.
#[inline(always)]
fn fill_row<S: Simd>(
    simd: S,
    tiles: &mut Tiles,
    tile_y: usize,
    y: [i32; 2],
    mut from: f32x8<S>,
    mut to: f32x8<S>,
    depth: &LoopDepth,
) {
    let top = (tile_y * TILE_Y) as i32;
    let rows = super::lanes::ramp(simd) + top as f32;
    if y[0] > top || y[1] < top + TILE_Y as i32 - 1 {
        let outside = rows.simd_lt(splat(simd, y[0] as f32)) | rows.simd_gt(splat(simd, y[1] as f32));
        to = outside.select(splat(simd, -1.0), to);
    }
    let some = from.simd_le(to);
    if !some.any_true() {
        return;
    }
    let least = simd.reduce_min_f32x8(some.select(from, splat(simd, f32::MAX)));
    let greatest = simd.reduce_max_f32x8(some.select(to, splat(simd, -1.0)));
    let (first, last) = (whole(least) / TILE_X, whole(greatest) / TILE_X);
    // Pixels beyond the image's right and lower edges count as covered with those before them.
    let image_last = splat(simd, (tiles.width - 1) as f32);
    to = (to.simd_ge(image_last) & some).select(splat(simd, (tiles.tiles_x * TILE_X - 1) as f32), to);
    if y[1] == tiles.height - 1 && y[1] < top + TILE_Y as i32 - 1 {
        let beyond = rows.simd_gt(splat(simd, y[1] as f32));
        from = beyond.select(splat(simd, (first * TILE_X) as f32), from);
        to = beyond.select(splat(simd, (last * TILE_X + TILE_X - 1) as f32), to);
    }
    let inner_from = simd.reduce_max_f32x8(from);
    let inner_to = simd.reduce_min_f32x8(to);
    let row = depth.in_row(first, tile_y);
    let (mut whole_first, mut whole_end) = (usize::MAX, usize::MAX);
    if inner_to - inner_from >= LAST_INNER {
        let (from, end) = (whole(inner_from).div_ceil(TILE_X), (whole(inner_to) + 1) / TILE_X);
        if from < end {
            (whole_first, whole_end) = (from, end);
            tiles.close_whole(simd, tile_y, from, end - 1, &row);
        }
    }
    let mut tile_x = first;
    while tile_x <= last {
        if tile_x == whole_first {
            tile_x = whole_end;
            continue;
        }
        let column = (tile_x * TILE_X) as f32;
        let mask = columns(simd, from - column, to - column);
        tiles.close_part(simd, tile_x, tile_y, mask, &row);
        tile_x += 1;
    }
}

/// Columns from first to last that a whole tile needs.
const LAST_INNER: f32 = TILE_X as f32 - 1.0;

/// A depth that is nowhere nearer than the loop, linear over the image.
struct LoopDepth {
    /// Change a column and a row.
    slope: [f64; 2],
    /// At the centre of pixel (0, 0).
    origin: f64,
    nearest: f32,
}

impl LoopDepth {
    /// `normal` is that of the loop in 1/256 px; `x` and `y` are the pixels that may be covered. Each depth
    /// is to bound those within `spread` px from below; none is nearer than `nearest`.
    #[inline(always)]
    #[expect(clippy::too_many_arguments, reason = "what the caller knows already, inlined there")]
    fn new(
        corners: &[Corner],
        area: i64,
        normal: [f64; 2],
        depths: [f64; 2],
        spread: f64,
        x: [i32; 2],
        y: [i32; 2],
        nearest: f32,
    ) -> LoopDepth {
        let [mut slope_x, mut slope_y] = normal.map(|n| n * -256.0 / area as f64);
        // Where a tile's planes would differ by more than the polygon's depths, as on slivers, one depth is as good.
        let steep = slope_x.abs() * TILE_X as f64 + slope_y.abs() * TILE_Y as f64;
        if !(steep <= 4.0 * depths[1]) {
            (slope_x, slope_y) = (0.0, 0.0);
        }
        // Lowered so that no corner lies below: at each pixel a triangle's depth is a positive combination of its corners'.
        let mut origin = f64::INFINITY;
        for corner in corners {
            let here = corner.z - (slope_x * corner.x as f64 + slope_y * corner.y as f64) * (1.0 / 256.0);
            origin = origin.min(here);
        }
        origin -= (slope_x.abs() + slope_y.abs()) * spread;
        let mut depth = LoopDepth { slope: [slope_x, slope_y], origin, nearest };
        // Rounding in f32, over all tiles that are touched.
        let reach = |[first, last]: [i32; 2], side: usize| {
            let side = side as i32;
            [first / side * side, last / side * side + side].map(f64::from)
        };
        let ([x0, x1], [y0, y1]) = (reach(x, TILE_X), reach(y, TILE_Y));
        let greatest = depth.at(x0, y0).abs().max(depth.at(x1, y0).abs());
        let greatest = greatest.max(depth.at(x0, y1).abs()).max(depth.at(x1, y1).abs());
        depth.origin -= (greatest + steep) * f64::from(ROUNDING);
        // The other rasteriser's rounding is relative.
        let scale = 1.0 - DEPTH_SLACK;
        depth.origin *= scale;
        depth.slope = depth.slope.map(|slope| slope * scale);
        depth
    }

    #[inline(always)]
    fn at(&self, x: f64, y: f64) -> f64 {
        self.origin + self.slope[0] * x + self.slope[1] * y
    }

    #[inline(always)]
    fn in_row(&self, first: usize, tile_y: usize) -> RowPlane {
        let at = self.at((first * TILE_X) as f64, (tile_y * TILE_Y) as f64);
        RowPlane {
            plane: Plane { at: at as f32, dx: self.slope[0] as f32, dy: self.slope[1] as f32 },
            first,
            nearest: self.nearest,
        }
    }
}
