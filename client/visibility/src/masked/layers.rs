//! What closes pixels of a tile nearer than its reference? A few layers, each a mask and a plane.
//!
//! A pixel is closed at the nearest of the planes whose masks have it. Layers lose nothing, however they are ordered. Both
//! drawing into and asking about a few of them cost much less than depths pixel by pixel, which remain for tiles where many
//! things meet.

use fearless_simd::prelude::*;
use fearless_simd::u32x8;

use super::lanes::{Plane, TILE_X, TILE_Y, above, is_empty};
use super::merge::SAME;

/// Most layers of a tile. A door frame in the corner of a room needs as many.
pub(super) const LAYERS: usize = 4;

/// Pixels that are closed by a plane.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Layer {
    pub(super) mask: [u32; TILE_Y],
    pub(super) plane: Plane,
}

/// Pixels that are closed nearer than the reference, perhaps. In force only if the tile's `top` says so.
///
/// What is always read lies in one line of the cache, since a frame finds few of them there.
#[derive(Clone, Copy, Debug, Default)]
#[repr(C, align(64))]
pub(super) struct Working {
    /// Layers in use, at least one; exactly one in a detailed tile.
    count: u32,
    /// Place of the tile's pixels, one on, which stand for the planes; 0 in a plain tile. Pixels in the mask of the only layer
    /// may be open still then, at a depth of 0.
    pub(super) detail: u32,
    layers: [Layer; LAYERS],
}

impl Working {
    #[inline(always)]
    pub(super) fn layers(&self) -> &[Layer] {
        // At most `LAYERS`; said so that no check is left.
        &self.layers[..(self.count as usize).min(LAYERS)]
    }

    /// Keeps a single layer.
    #[inline(always)]
    pub(super) fn set<S: Simd>(&mut self, mask: u32x8<S>, plane: &Plane) {
        mask.store_slice(&mut self.layers[0].mask);
        self.layers[0].plane = *plane;
        self.count = 1;
        self.detail = 0;
    }

    /// Gives the tile pixels, in which `covered` may be closed.
    #[inline(always)]
    pub(super) fn set_detailed<S: Simd>(&mut self, covered: u32x8<S>, detail: u32) {
        covered.store_slice(&mut self.layers[0].mask);
        self.count = 1;
        self.detail = detail;
    }

    /// Pixels that are in any mask.
    #[inline(always)]
    pub(super) fn covered<S: Simd>(&self, simd: S) -> u32x8<S> {
        let mut covered = u32x8::splat(simd, 0);
        for layer in self.layers() {
            covered |= u32x8::from_slice(simd, &layer.mask);
        }
        covered
    }

    /// Adds a layer to a plain tile whose reference is nowhere farther than `least`. Whether there was room for it, if it closes
    /// anything.
    #[inline(always)]
    pub(super) fn add<S: Simd>(&mut self, simd: S, mask: u32x8<S>, plane: &Plane, same: f32, least: f32) -> bool {
        for layer in &mut self.layers[..(self.count as usize).min(LAYERS)] {
            let own = u32x8::from_slice(simd, &layer.mask);
            if plane.minus(&layer.plane).greatest() > same {
                continue;
            }
            if is_empty(simd, mask & !own) {
                return true;
            }
            let over = layer.plane.minus(plane).greatest();
            if over <= same {
                // Neighbours in one plane.
                let slack = 2.0 * (plane.rounding() + layer.plane.rounding());
                layer.plane.at -= (if over > 0.0 { over } else { 0.0 }) + slack;
                (own | mask).store_slice(&mut layer.mask);
                return true;
            }
        }
        if self.count as usize >= LAYERS {
            let mut kept = 0;
            for i in 0..LAYERS {
                if self.layers[i].plane.greatest() > least {
                    self.layers[kept] = self.layers[i];
                    kept += 1;
                }
            }
            self.count = kept as u32;
            if kept == LAYERS {
                return false;
            }
        }
        let layer = &mut self.layers[self.count as usize];
        mask.store_slice(&mut layer.mask);
        layer.plane = *plane;
        self.count += 1;
        true
    }

    /// A depth at which every pixel of some mask is closed.
    #[inline(always)]
    pub(super) fn least(&self) -> f32 {
        let mut least = f32::INFINITY;
        for layer in self.layers() {
            let here = layer.least();
            least = if here < least { here } else { least };
        }
        least
    }

    /// Pixels among `asked` of a plain tile that the layers do not close nearer than the farthest of `limits`.
    #[inline(always)]
    pub(super) fn open<S: Simd>(&self, simd: S, asked: u32x8<S>, limits: &[Plane]) -> u32x8<S> {
        let mut open = asked;
        for layer in self.layers() {
            let mask = u32x8::from_slice(simd, &layer.mask) & open;
            // Most layers of a tile have nothing to do with a question's part of it.
            if is_empty(simd, mask) {
                continue;
            }
            if limits.iter().any(|limit| nearer_everywhere(&layer.plane, limit)) {
                open &= !mask;
            } else {
                let mut hidden = u32x8::splat(simd, 0);
                for limit in limits {
                    hidden |= nearer(simd, &layer.plane, limit);
                }
                open &= !(mask & hidden);
            }
        }
        open
    }

    /// The depth at which a pixel of a plain tile is closed; 0 if it is open.
    pub(super) fn depth_at(&self, i: usize, j: usize) -> f32 {
        let closing = self.layers().iter().filter(|layer| layer.mask[j] >> i & 1 == 1);
        closing.fold(0.0, |depth, Layer { plane, .. }| depth.max(plane.at + i as f32 * plane.dx + j as f32 * plane.dy))
    }
}

impl Layer {
    /// The least depth of its pixels, or less.
    #[inline(always)]
    fn least(&self) -> f32 {
        let (mut used, mut first, mut last) = (0, TILE_Y, 0);
        for (j, row) in self.mask.iter().enumerate() {
            used |= row;
            first = if *row != 0 && first == TILE_Y { j } else { first };
            last = if *row != 0 { j } else { last };
        }
        if used == 0 {
            return f32::INFINITY;
        }
        let Plane { at, dx, dy } = self.plane;
        let i = if dx < 0.0 { TILE_X as u32 - 1 - used.leading_zeros() } else { used.trailing_zeros() };
        let j = if dy < 0.0 { last } else { first };
        at + dx * i as f32 + dy * j as f32 - self.plane.rounding()
    }
}

/// Whether `plane` is certainly above `limit` in all of a tile: the face of a cell is often just behind a wall.
#[inline(always)]
fn nearer_everywhere(plane: &Plane, limit: &Plane) -> bool {
    plane.minus(limit).least() > plane.rounding() + limit.rounding()
}

/// Pixels of a tile where `plane` is certainly above `limit`.
#[inline(always)]
pub(super) fn nearer<S: Simd>(simd: S, plane: &Plane, limit: &Plane) -> u32x8<S> {
    above(simd, &plane.minus(limit), plane.rounding() + limit.rounding())
}

/// What counts as no difference to depths up to `top`.
#[inline(always)]
pub(super) fn same_at(top: f32) -> f32 {
    top * SAME
}

#[cfg(test)]
mod tests {
    use fearless_simd::{Level, dispatch};
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64;

    use super::*;

    #[inline(always)]
    fn check<S: Simd>(simd: S) -> (usize, usize, usize) {
        let mut rng = Pcg64::seed_from_u64(3);
        let (mut refused, mut merged, mut questions) = (0, 0, 0);
        for round in 0..300 {
            let mut any_layer = |round: usize| {
                let (from, to) = (rng.random_range(0..TILE_X as u32), rng.random_range(0..TILE_X as u32));
                let row = (u32::MAX << from.min(to)) & (u32::MAX >> (31 - from.max(to)));
                let (first, last) = (rng.random_range(0..TILE_Y), rng.random_range(0..TILE_Y));
                let mask = std::array::from_fn(|j| if (first..=last).contains(&j) { row } else { 0 });
                // In every other round all lie nearly in one plane.
                let spread = if usize::is_multiple_of(round, 2) { 1.0 } else { 1e-6 };
                let mut about = |middle: f32, reach: f32| middle + spread * rng.random_range(-reach..reach);
                let plane = Plane { at: about(0.5, 0.3), dx: about(0.0, 0.005), dy: about(0.0, 0.01) };
                Layer { mask, plane }
            };
            let mut working = Working::default();
            let mut drawn = vec![any_layer(round)];
            working.set(u32x8::from_slice(simd, &drawn[0].mask), &drawn[0].plane);
            for _ in 0..6 {
                let layer = any_layer(round);
                let before = working;
                if working.add(simd, u32x8::from_slice(simd, &layer.mask), &layer.plane, same_at(1.0), 0.0) {
                    merged += usize::from(working.count == before.count);
                    drawn.push(layer);
                } else {
                    refused += 1;
                }
            }
            let exact = |i: usize, j: usize| {
                let here = drawn.iter().filter(|layer| layer.mask[j] >> i & 1 == 1);
                here.fold(0.0_f32, |z, Layer { plane: p, .. }| z.max(p.at + i as f32 * p.dx + j as f32 * p.dy))
            };
            let limit = any_layer(0).plane;
            let open: [u32; TILE_Y] = working.open(simd, u32x8::splat(simd, u32::MAX), &[limit]).into();
            for (i, j) in (0..TILE_X).flat_map(|i| (0..TILE_Y).map(move |j| (i, j))) {
                let (is, closed) = (exact(i, j), working.depth_at(i, j));
                assert!(closed <= is + 1e-6 && closed >= is - 2.0 * same_at(1.0), "{i} {j}: {closed} for {is}");
                assert!(closed == 0.0 || closed >= working.least());
                let asked = limit.at + i as f32 * limit.dx + j as f32 * limit.dy;
                if open[j] >> i & 1 == 0 {
                    assert!(closed > asked);
                } else {
                    assert!(closed < asked + 0.02);
                    questions += 1;
                }
            }
        }
        (refused, merged, questions)
    }

    #[test]
    fn layers_close_what_was_drawn_and_never_nearer() {
        let (refused, merged, questions) = dispatch!(Level::baseline(), simd => check(simd));
        assert!(refused > 50 && merged > 300 && questions > 1000, "{refused} {merged} {questions}");
    }
}
