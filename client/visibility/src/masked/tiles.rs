//! The image as tiles of two layers, and how a polygon's part of a tile changes them.
//!
//! The *reference* closes the whole tile with a plane of reversed depth; depth 0 is open. The *working* layer closes the
//! pixels of a mask with another plane, nearer than the reference somewhere. A pixel is closed at the nearer of both. Every
//! change keeps this: **no pixel is closed nearer than something that was drawn over it.** (Hasselgren, Andersson and
//! Akenine-Möller, "Masked Software Occlusion Culling", 2016, with planes where they keep one depth.)
//!
//! References lie in blocks of eight tiles along a row, since the inside of a wall is nothing else.

use fearless_simd::prelude::*;
use fearless_simd::{f32x8, u32x8};

use super::lanes::{LAST_X, LAST_Y, Plane, TILE_X, TILE_Y, above, is_empty, ramp, splat};

/// Tiles of a block: lanes.
pub(super) const BLOCK: usize = 8;

/// The references of eight tiles. In force where their least depth is above 0.
#[derive(Clone, Copy, Debug, Default)]
struct Block {
    at: [f32; BLOCK],
    dx: [f32; BLOCK],
    dy: [f32; BLOCK],
}

/// Pixels that are closed nearer than the reference, perhaps. In force only if its `top` says so.
#[derive(Clone, Copy, Debug, Default)]
struct Working {
    mask: [u32; TILE_Y],
    plane: Plane,
}

/// The tiles of an image.
#[derive(Clone, Debug, Default)]
pub(super) struct Tiles {
    /// Pixels.
    pub(super) width: i32,
    pub(super) height: i32,
    pub(super) tiles_x: usize,
    pub(super) tiles_y: usize,
    blocks_x: usize,
    /// The reference's least (farthest) depth over each tile's pixels in the image. Lanes beyond the image are infinitely near.
    least: Vec<[f32; BLOCK]>,
    /// The nearest depth of each tile's working layer; at most the reference's least where there is none.
    top: Vec<[f32; BLOCK]>,
    blocks: Vec<Block>,
    working: Vec<Working>,
}

/// A polygon's plane, cut to one row of tiles.
#[derive(Clone, Copy, Debug)]
pub(super) struct RowPlane {
    /// In the tile at column `first`.
    pub(super) plane: Plane,
    pub(super) first: usize,
}

impl RowPlane {
    #[inline(always)]
    fn in_tile(&self, tile_x: usize) -> Plane {
        let columns = (tile_x as i32 - self.first as i32) as f32;
        Plane { at: self.plane.at + columns * (self.plane.dx * TILE_X as f32), ..self.plane }
    }
}

impl Tiles {
    /// Opens every pixel of an image of this size.
    pub(super) fn clear(&mut self, width: u32, height: u32) {
        let tiles = [(width as usize).div_ceil(TILE_X), (height as usize).div_ceil(TILE_Y)];
        let blocks_x = tiles[0].div_ceil(BLOCK);
        let blocks = blocks_x * tiles[1];
        (self.width, self.height) = (width as i32, height as i32);
        [self.tiles_x, self.tiles_y] = tiles;
        self.blocks_x = blocks_x;
        // Planes and masks need no clearing: `least` and `top` say that there are none.
        self.working.resize(blocks * BLOCK, Working::default());
        self.blocks.resize(blocks, Block::default());
        self.top.clear();
        self.top.resize(blocks, [0.0; BLOCK]);
        self.least.clear();
        self.least.resize(blocks, [0.0; BLOCK]);
        let used = self.tiles_x % BLOCK;
        if used != 0 {
            for last in self.least.iter_mut().skip(blocks_x - 1).step_by(blocks_x) {
                last[used..].fill(f32::INFINITY);
            }
        }
    }

    /// Least depth of a tile's reference.
    #[inline(always)]
    pub(super) fn least_at(&self, tile_x: usize, tile_y: usize) -> f32 {
        self.least[tile_y * self.blocks_x + tile_x / BLOCK][tile_x % BLOCK]
    }

    /// Whether every tile's reference is nearer than `z`.
    #[inline(always)]
    pub(super) fn all_nearer<S: Simd>(&self, simd: S, z: f32) -> bool {
        let limit = splat(simd, z);
        for least in &self.least {
            if !f32x8::from_slice(simd, least).simd_gt(limit).all_true() {
                return false;
            }
        }
        true
    }

    /// Whether every tile's reference in these columns and rows of tiles (first and last) is nearer than `z`.
    #[inline(always)]
    pub(super) fn nearer_in<S: Simd>(&self, simd: S, x: [usize; 2], y: [usize; 2], z: f32) -> bool {
        let limit = splat(simd, z);
        let (from, to) = (x[0] / BLOCK, x[1] / BLOCK);
        // Lanes that do not count.
        let before = (1_u64 << (x[0] % BLOCK)) - 1;
        let after = !((2_u64 << (x[1] % BLOCK)) - 1);
        for tile_y in y[0]..=y[1] {
            let row = &self.least[tile_y * self.blocks_x + from..=tile_y * self.blocks_x + to];
            let mut ignored = before;
            for (i, least) in row.iter().enumerate() {
                ignored |= if i == to - from { after } else { 0 };
                let nearer = f32x8::from_slice(simd, least).simd_gt(limit).to_bitmask() | ignored;
                if nearer & 0xff != 0xff {
                    return false;
                }
                ignored = 0;
            }
        }
        true
    }

    /// The least depth of all references; infinite for an image without pixels.
    pub(super) fn farthest(&self) -> f32 {
        self.least.iter().flatten().fold(f32::INFINITY, |least, &z| if z < least { z } else { least })
    }

    /// How much a plane may fall from a tile's first pixel to its farthest one in the image.
    #[inline(always)]
    fn fall(&self, plane: &Plane, last_column: bool, tile_y: usize) -> f32 {
        let x = if last_column { ((self.width - 1) % TILE_X as i32) as f32 } else { LAST_X };
        let y = if tile_y + 1 == self.tiles_y { ((self.height - 1) % TILE_Y as i32) as f32 } else { LAST_Y };
        let (x, y) = (plane.dx * x, plane.dy * y);
        (if x < 0.0 { x } else { 0.0 }) + (if y < 0.0 { y } else { 0.0 })
    }

    /// Closes whole tiles of a row, `from` to `to`.
    #[inline(always)]
    pub(super) fn close_whole<S: Simd>(&mut self, simd: S, tile_y: usize, from: usize, to: usize, row: &RowPlane) {
        let p = row.plane;
        let zero = splat(simd, 0.0);
        let step = splat(simd, p.dx * TILE_X as f32);
        let fall = self.fall(&p, false, tile_y);
        let fall_at_edge = self.fall(&p, true, tile_y);
        for block_x in from / BLOCK..=to / BLOCK {
            let index = tile_y * self.blocks_x + block_x;
            let (block, least) = (&mut self.blocks[index], &mut self.least[index]);
            let columns = ramp(simd) + (block_x * BLOCK) as f32;
            let at = (columns - row.first as f32) * step + p.at;
            let at_edge = columns.simd_eq(splat(simd, (self.tiles_x - 1) as f32));
            let p_least = at + at_edge.select(splat(simd, fall_at_edge), splat(simd, fall));
            let old_least = f32x8::from_slice(simd, least);
            // What it has over the old reference at the corners.
            let d_at = at - f32x8::from_slice(simd, &block.at);
            let d_x = (splat(simd, p.dx) - f32x8::from_slice(simd, &block.dx)) * LAST_X;
            let d_y = (splat(simd, p.dy) - f32x8::from_slice(simd, &block.dy)) * LAST_Y;
            let worst = d_at + simd.min_f32x8(d_x, zero) + simd.min_f32x8(d_y, zero);
            // Nearer everywhere, or else by its farthest pixel.
            let better = (worst.simd_ge(zero) & old_least.simd_gt(zero)) | p_least.simd_gt(old_least);
            let inside = columns.simd_ge(splat(simd, from as f32)) & columns.simd_le(splat(simd, to as f32));
            let take = better & inside;
            take.select(at, f32x8::from_slice(simd, &block.at)).store_slice(&mut block.at);
            take.select(splat(simd, p.dx), f32x8::from_slice(simd, &block.dx)).store_slice(&mut block.dx);
            take.select(splat(simd, p.dy), f32x8::from_slice(simd, &block.dy)).store_slice(&mut block.dy);
            take.select(p_least, old_least).store_slice(least);
        }
    }

    /// Closes the pixels of `mask` in one tile.
    #[inline(always)]
    pub(super) fn close_part<S: Simd>(
        &mut self,
        simd: S,
        tile_x: usize,
        tile_y: usize,
        mask: u32x8<S>,
        row: &RowPlane,
    ) {
        let p = row.in_tile(tile_x);
        let index = tile_y * self.blocks_x + tile_x / BLOCK;
        let lane = tile_x % BLOCK;
        let p_top = p.greatest();
        let least = self.least[index][lane];
        if !(p_top > least) {
            return;
        }
        let block = &self.blocks[index];
        let reference = Plane { at: block.at[lane], dx: block.dx[lane], dy: block.dy[lane] };
        if least > 0.0 && p.minus(&reference).greatest() <= 0.0 {
            return;
        }
        let working = &mut self.working[index * BLOCK + lane];
        let top = self.top[index][lane];
        if !(top > least) {
            mask.store_slice(&mut working.mask);
            working.plane = p;
            self.top[index][lane] = p_top;
            return;
        }
        let old_mask = u32x8::from_slice(simd, &working.mask);
        let union = mask | old_mask;
        let both = lower(simd, &p, mask, &working.plane, old_mask);
        if union.simd_eq(u32x8::splat(simd, u32::MAX)).all_true() {
            // The tile is closed. The nearer part stays as working layer.
            if p_top > top {
                mask.store_slice(&mut working.mask);
                working.plane = p;
                self.top[index][lane] = p_top;
            }
            let both_least = both.at + self.fall(&both, tile_x + 1 == self.tiles_x, tile_y);
            let block = &mut self.blocks[index];
            if both_least > least || (least > 0.0 && both.minus(&reference).least() >= 0.0) {
                (block.at[lane], block.dx[lane], block.dy[lane]) = (both.at, both.dx, both.dy);
                self.least[index][lane] = both_least;
            }
            return;
        }
        let (mut kept, mut plane) = (union, both);
        if least > 0.0 {
            // Something closes the tile already: keep what adds most to it.
            let [merged, new, old] = [
                gain(simd, union, &both.minus(&reference)),
                gain(simd, mask, &p.minus(&reference)),
                gain(simd, old_mask, &working.plane.minus(&reference)),
            ];
            if old >= merged && old >= new {
                return;
            }
            if new > merged {
                (kept, plane) = (mask, p);
            }
        }
        kept.store_slice(&mut working.mask);
        working.plane = plane;
        self.top[index][lane] = plane.greatest();
    }

    /// Pixels among `asked` of a tile that are not certainly closed nearer than the farthest of `limits`: depths in this tile
    /// that bound the asked thing from above, each by itself.
    #[inline(always)]
    pub(super) fn open<S: Simd>(
        &self,
        simd: S,
        tile_x: usize,
        tile_y: usize,
        asked: u32x8<S>,
        limits: &[Plane],
    ) -> bool {
        let index = tile_y * self.blocks_x + tile_x / BLOCK;
        let lane = tile_x % BLOCK;
        let block = &self.blocks[index];
        let reference = Plane { at: block.at[lane], dx: block.dx[lane], dy: block.dy[lane] };
        let mut open = asked;
        if self.least[index][lane] > 0.0 {
            for limit in limits {
                open &= !nearer(simd, &reference, limit);
            }
        }
        if is_empty(simd, open) {
            return false;
        }
        if !(self.top[index][lane] > self.least[index][lane]) {
            return true;
        }
        let working = &self.working[index * BLOCK + lane];
        let mask = u32x8::from_slice(simd, &working.mask);
        if !is_empty(simd, open & !mask) {
            return true;
        }
        for limit in limits {
            open &= !nearer(simd, &working.plane, limit);
        }
        !is_empty(simd, open)
    }

    /// Whether anything was drawn over a pixel, for tests with one polygon.
    #[cfg(test)]
    pub(super) fn covers(&self, x: u32, y: u32) -> bool {
        let (tile_x, tile_y) = (x as usize / TILE_X, y as usize / TILE_Y);
        let index = tile_y * self.blocks_x + tile_x / BLOCK;
        let lane = tile_x % BLOCK;
        let working = &self.working[index * BLOCK + lane];
        let whole = self.least[index][lane] > 0.0;
        whole || (self.top[index][lane] != 0.0 && working.mask[y as usize % TILE_Y] >> (x % TILE_X as u32) & 1 == 1)
    }

    /// What closes a pixel, for tests: the nearer of both layers.
    #[cfg(test)]
    pub(super) fn depth_at(&self, x: u32, y: u32) -> f32 {
        let (tile_x, tile_y) = (x as usize / TILE_X, y as usize / TILE_Y);
        let (i, j) = (x as usize % TILE_X, y as usize % TILE_Y);
        let index = tile_y * self.blocks_x + tile_x / BLOCK;
        let lane = tile_x % BLOCK;
        let block = &self.blocks[index];
        let at = |plane: Plane| plane.at + i as f32 * plane.dx + j as f32 * plane.dy;
        let mut depth = 0.0_f32;
        if self.least[index][lane] > 0.0 {
            depth = depth.max(at(Plane { at: block.at[lane], dx: block.dx[lane], dy: block.dy[lane] }));
        }
        let working = &self.working[index * BLOCK + lane];
        if self.top[index][lane] > self.least[index][lane] && working.mask[j] >> i & 1 == 1 {
            depth = depth.max(at(working.plane));
        }
        depth
    }
}

/// Pixels of a tile where `plane` is certainly above `limit`.
#[inline(always)]
fn nearer<S: Simd>(simd: S, plane: &Plane, limit: &Plane) -> u32x8<S> {
    above(simd, &plane.minus(limit), plane.rounding() + limit.rounding())
}

/// What pixels at these depths over the reference are worth.
#[inline(always)]
fn gain<S: Simd>(simd: S, mask: u32x8<S>, over: &Plane) -> f32 {
    simd.reduce_sum_u32x8(simd.count_ones_u32x8(mask)) as f32 * over.middle()
}

/// A plane that lies nowhere above `p` within its mask, and nowhere above `q` within its own.
#[inline(always)]
fn lower<S: Simd>(simd: S, p: &Plane, p_mask: u32x8<S>, q: &Plane, q_mask: u32x8<S>) -> Plane {
    let slack = p.rounding() + q.rounding();
    // Each, a little lower, where it serves for the other too: two walls that meet in a far corner, or parts of one wall.
    let p_lowered = Plane { at: p.at - 2.0 * slack, ..*p };
    let q_lowered = Plane { at: q.at - 2.0 * slack, ..*q };
    let p_serves = is_empty(simd, q_mask & !above(simd, &q.minus(&p_lowered), slack));
    let q_serves = is_empty(simd, p_mask & !above(simd, &p.minus(&q_lowered), slack));
    match (p_serves, q_serves) {
        (true, true) if p_lowered.middle() >= q_lowered.middle() => p_lowered,
        (true, false) => p_lowered,
        (_, true) => q_lowered,
        (false, false) => {
            // Moved down until it is below the other in the whole tile.
            let p_over = p_lowered.minus(q).greatest().max(0.0);
            let q_over = q_lowered.minus(p).greatest().max(0.0);
            let p_below = Plane { at: p_lowered.at - p_over, ..*p };
            let q_below = Plane { at: q_lowered.at - q_over, ..*q };
            let level = Plane { at: p_lowered.least().min(q_lowered.least()), dx: 0.0, dy: 0.0 };
            let better = if p_below.middle() >= q_below.middle() { p_below } else { q_below };
            if better.middle() >= level.middle() { better } else { level }
        }
    }
}
