//! A tile's depths pixel by pixel, where two layers of planes would lose too much.

use fearless_simd::prelude::*;
use fearless_simd::{f32x8, u32x8};

use super::lanes::{Plane, TILE_X, TILE_Y, ramp, splat};

/// The depth at which each pixel is closed, row by row; infinite beyond the image.
pub(super) type Pixels = [f32; TILE_X * TILE_Y];

/// Lanes of a vector, and vectors of a row.
const LANES: usize = 8;
const PARTS: usize = TILE_X / LANES;

/// Opens all pixels in the first columns and rows, and closes the others for good; returns the mask of these.
pub(super) fn open_all(pixels: &mut Pixels, columns: usize, rows: usize) -> [u32; TILE_Y] {
    if columns == TILE_X && rows == TILE_Y {
        pixels.fill(0.0);
        return [0; TILE_Y];
    }
    pixels.fill(f32::INFINITY);
    pixels.chunks_exact_mut(TILE_X).take(rows).for_each(|row| row[..columns].fill(0.0));
    std::array::from_fn(|row| if row < rows { (u64::from(u32::MAX) << columns) as u32 } else { u32::MAX })
}

/// The bits of each lane in a row's mask.
#[inline(always)]
fn lane_bits<S: Simd>(simd: S) -> [u32x8<S>; PARTS] {
    let first = u32x8::from_slice(simd, &[1, 2, 4, 8, 16, 32, 64, 128]);
    [first, first << 8_u32, first << 16_u32, first << 24_u32]
}

/// A plane's depths in the first row.
#[inline(always)]
fn first_row<S: Simd>(simd: S, plane: &Plane) -> [f32x8<S>; PARTS] {
    // No closures: they would be compiled without the level's instructions.
    let ramp = ramp(simd);
    let mut row = [splat(simd, 0.0); PARTS];
    for (part, z) in row.iter_mut().enumerate() {
        *z = (ramp + (part * LANES) as f32) * plane.dx + plane.at;
    }
    row
}

/// Moves the pixels of `mask` to `plane` where that is nearer.
#[inline(always)]
pub(super) fn raise<S: Simd>(simd: S, pixels: &mut Pixels, mask: u32x8<S>, plane: &Plane) {
    let rows: [u32; TILE_Y] = mask.into();
    let (bits, start) = (lane_bits(simd), first_row(simd, plane));
    let zero = u32x8::splat(simd, 0);
    let mut used = 0;
    for row in rows {
        used |= row;
    }
    for part in 0..PARTS {
        // Small polygons are in one or two of them.
        if used >> (part * LANES) & 0xff == 0 {
            continue;
        }
        for (j, (row, pixels)) in rows.iter().zip(pixels.chunks_exact_mut(TILE_X)).enumerate() {
            let pixels = &mut pixels[part * LANES..][..LANES];
            let old = f32x8::from_slice(simd, pixels);
            let z = start[part] + plane.dy * j as f32;
            let outside = (u32x8::splat(simd, *row) & bits[part]).simd_eq(zero);
            // Adding 0 leaves one zero only, since a maximum may give either. A maximum, because a choice becomes a masked
            // store, which later loads have to wait for.
            let z = outside.select(splat(simd, 0.0), z) + 0.0;
            simd.max_f32x8(z, old).store_slice(pixels);
        }
    }
}

/// The least depth of all pixels.
#[inline(always)]
pub(super) fn least<S: Simd>(simd: S, pixels: &Pixels) -> f32 {
    let mut least = [splat(simd, f32::INFINITY); PARTS];
    for row in pixels.chunks_exact(TILE_X) {
        for part in 0..PARTS {
            least[part] = simd.min_f32x8(least[part], f32x8::from_slice(simd, &row[part * LANES..][..LANES]));
        }
    }
    let [a, b, c, d] = least;
    simd.reduce_min_f32x8(simd.min_f32x8(simd.min_f32x8(a, b), simd.min_f32x8(c, d)))
}

/// Whether any pixel of `asked` is not certainly nearer than the farthest of `limits`.
#[inline(always)]
pub(super) fn any_open<S: Simd>(simd: S, pixels: &Pixels, asked: u32x8<S>, limits: &[Plane]) -> bool {
    let rows: [u32; TILE_Y] = asked.into();
    let bits = lane_bits(simd);
    let zero = u32x8::splat(simd, 0);
    let mut starts = [[splat(simd, 0.0); PARTS]; LIMITS_MAX];
    let limits = &limits[..limits.len().min(LIMITS_MAX)];
    let mut used = 0;
    for row in rows {
        used |= row;
    }
    for (start, limit) in starts.iter_mut().zip(limits) {
        *start = first_row(simd, &Plane { at: limit.at + limit.rounding(), ..*limit });
    }
    for part in 0..PARTS {
        // Small things are in one or two of them.
        if used >> (part * LANES) & 0xff == 0 {
            continue;
        }
        for j in 0..TILE_Y {
            let inside = u32x8::splat(simd, rows[j]) & bits[part];
            let pixels = f32x8::from_slice(simd, &pixels[j * TILE_X + part * LANES..][..LANES]);
            let mut open = !inside.simd_eq(zero);
            for (start, limit) in starts.iter().zip(limits) {
                open &= pixels.simd_le(start[part] + limit.dy * j as f32);
            }
            if open.any_true() {
                return true;
            }
        }
    }
    false
}

/// A nearest depth and three planes.
pub(super) const LIMITS_MAX: usize = 4;
