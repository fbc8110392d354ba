//! Which pixels of a tile satisfy a linear condition? Rows are lanes, columns are bits.
//!
//! Only operations that every level rounds alike: no fused multiply-add, no approximate reciprocals.

use fearless_simd::prelude::*;
use fearless_simd::{Bytes, f32x8, f64x8, u32x8};

/// Columns of a tile: the bits of a mask's row.
pub(super) const TILE_X: usize = 32;

/// Rows of a tile: the lanes of a mask.
pub(super) const TILE_Y: usize = 8;

/// Farthest column and row of a tile's pixels from its first.
pub(super) const LAST_X: f32 = TILE_X as f32 - 1.0;
pub(super) const LAST_Y: f32 = TILE_Y as f32 - 1.0;

/// Bounds the rounding of [`above`] and of evaluating a plane, relative to the sum of the plane's terms: fewer than 16
/// roundings of 2⁻²⁴.
pub(super) const ROUNDING: f32 = 1.0 / 1_048_576.0;

/// One number in all lanes.
#[inline(always)]
pub(super) fn splat<S: Simd>(simd: S, v: f32) -> f32x8<S> {
    f32x8::splat(simd, v)
}

/// Whether no pixel is set.
#[inline(always)]
pub(super) fn is_empty<S: Simd>(simd: S, mask: u32x8<S>) -> bool {
    mask.simd_eq(u32x8::splat(simd, 0)).all_true()
}

/// 0, 1 … 7.
#[inline(always)]
pub(super) fn ramp<S: Simd>(simd: S) -> f32x8<S> {
    f32x8::from_slice(simd, &[0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0])
}

/// 0, 1 … 7.
#[inline(always)]
pub(super) fn ramp_f64<S: Simd>(simd: S) -> f64x8<S> {
    f64x8::from_slice(simd, &[0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0])
}

/// The same numbers as f32.
#[inline(always)]
pub(super) fn narrow<S: Simd>(simd: S, v: f64x8<S>) -> f32x8<S> {
    let (low, high) = simd.split_f64x8(v);
    simd.narrow_f64x4(low, high)
}

/// The nearest whole numbers, ties to even, for values below 2⁵¹. Adding and subtracting is the same everywhere.
#[inline(always)]
pub(super) fn nearest<S: Simd>(v: f64x8<S>) -> f64x8<S> {
    const ROUND: f64 = 6_755_399_441_055_744.0;
    (v + ROUND) - ROUND
}

/// A whole number in 0..=32 from a value in that range, up to half a column away.
#[inline(always)]
fn count<S: Simd>(simd: S, v: f32x8<S>) -> u32x8<S> {
    // 1.5 · 2²³: the number ends up in the lowest bits.
    const ROUND: f32 = 12_582_912.0;
    let bits: u32x8<S> = u32x8::from_bytes((v + ROUND).to_bytes());
    bits & u32x8::splat(simd, 63)
}

/// Bits `from` and on.
#[inline(always)]
fn bits_from<S: Simd>(simd: S, from: u32x8<S>) -> u32x8<S> {
    let ones = u32x8::splat(simd, u32::MAX);
    // A shift by 32 differs between machines.
    let shifted = simd.shlv_u32x8(ones, simd.min_u32x8(from, u32x8::splat(simd, 31)));
    from.simd_lt(u32x8::splat(simd, 32)).select(shifted, u32x8::splat(simd, 0))
}

#[inline(always)]
fn clamp_column<S: Simd>(simd: S, v: f32x8<S>) -> f32x8<S> {
    let v = simd.max_f32x8(v, f32x8::splat(simd, 0.0));
    simd.min_f32x8(v, f32x8::splat(simd, TILE_X as f32))
}

/// Columns `left` to `right`, both whole numbers counted from the tile's first, both included.
#[inline(always)]
pub(super) fn columns<S: Simd>(simd: S, left: f32x8<S>, right: f32x8<S>) -> u32x8<S> {
    let from = count(simd, clamp_column(simd, left));
    let end = count(simd, clamp_column(simd, right + 1.0));
    bits_from(simd, from) & !bits_from(simd, end)
}

/// Columns between `left` and `right`, which need not be whole: all of those in between, at most one more at either end.
#[inline(always)]
pub(super) fn columns_outward<S: Simd>(simd: S, left: f32x8<S>, right: f32x8<S>) -> u32x8<S> {
    // Rounding up is rounding to nearest, half a column on; a little less than half makes sure that it is not more.
    columns(simd, left + (0.5 - 1.0 / 128.0), right - (0.5 - 1.0 / 128.0))
}

/// A depth, linear over a tile: `at + i · dx + j · dy` in column i and row j.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Plane {
    pub(super) at: f32,
    pub(super) dx: f32,
    pub(super) dy: f32,
}

impl Plane {
    #[inline(always)]
    pub(super) fn minus(&self, other: &Plane) -> Plane {
        Plane { at: self.at - other.at, dx: self.dx - other.dx, dy: self.dy - other.dy }
    }

    /// The greatest value over a tile.
    #[inline(always)]
    pub(super) fn greatest(&self) -> f32 {
        self.at + positive(self.dx * LAST_X) + positive(self.dy * LAST_Y)
    }

    /// The least value over a tile.
    #[inline(always)]
    pub(super) fn least(&self) -> f32 {
        self.at - positive(-self.dx * LAST_X) - positive(-self.dy * LAST_Y)
    }

    /// Bounds rounding wherever the plane is evaluated or compared in a tile.
    #[inline(always)]
    pub(super) fn rounding(&self) -> f32 {
        (self.at.abs() + LAST_X * self.dx.abs() + LAST_Y * self.dy.abs()) * ROUNDING
    }
}

#[inline(always)]
fn positive(v: f32) -> f32 {
    if v > 0.0 { v } else { 0.0 }
}

/// Pixels where `plane` is certainly above `margin`, which must include [`Plane::rounding`]. Along a row that is a
/// half-line, found by one division for the tile.
#[inline(always)]
pub(super) fn above<S: Simd>(simd: S, plane: &Plane, margin: f32) -> u32x8<S> {
    // A level row has no crossing: this small slope puts it far outside on the right side.
    let dx = if plane.dx.abs() > 1e-30 { plane.dx } else { 1e-30 };
    let crossing = (ramp(simd) * plane.dy + (plane.at - margin)) * (-1.0 / dx);
    // Rounded into the region by up to a column.
    if dx > 0.0 {
        bits_from(simd, count(simd, clamp_column(simd, crossing + 0.5)))
    } else {
        !bits_from(simd, count(simd, clamp_column(simd, crossing + 0.5)))
    }
}
