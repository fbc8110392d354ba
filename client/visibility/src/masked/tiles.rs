//! The image as tiles of two layers, and how a polygon's part of a tile changes them.
//!
//! The *reference* closes the whole tile with a plane of reversed depth; depth 0 is open. *Working* layers (`layers`) close the
//! pixels of masks with other planes, nearer than the reference somewhere. A pixel is closed at the nearer of both. Every
//! change keeps this: **no pixel is closed nearer than something that was drawn over it.** (Hasselgren, Andersson and
//! Akenine-Möller, "Masked Software Occlusion Culling", 2016, with planes where they keep one depth.)
//!
//! Where a third plane comes to a tile, their heuristics drop or flatten one. Here it gets a layer of its own, and where there
//! are too many the tile becomes *detailed*: its working layer is a depth for each pixel, and nothing is lost however things
//! are ordered. It is plain again once a reference is nearer than all of them. Few tiles are like this at a time.
//!
//! References lie in blocks of eight tiles along a row, since the inside of a wall is nothing else.

use fearless_simd::prelude::*;
use fearless_simd::{f32x8, mask32x8, u32x8};

use super::lanes::{LAST_X, LAST_Y, Plane, ROUNDING, TILE_X, TILE_Y, above, is_empty, ramp, splat};
use super::layers::{Working, nearer, same_at};
use super::merge::{Fits, SAME};
use super::pixels::{self, Pixels};

/// Tiles of a block: lanes.
pub(super) const BLOCK: usize = 8;

/// Blocks that can be asked about at once: a bit a tile.
pub(super) const BLOCKS_ASKED: usize = 64 / BLOCK;

/// The references of eight tiles. In force where their least depth is above 0.
#[derive(Clone, Copy, Debug, Default)]
struct Block {
    at: [f32; BLOCK],
    dx: [f32; BLOCK],
    dy: [f32; BLOCK],
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
    /// Of detailed tiles, the first so many of them in use. Kept from frame to frame.
    pixels: Vec<Pixels>,
    detailed: usize,
}

/// A polygon's plane, cut to one row of tiles.
#[derive(Clone, Copy, Debug)]
pub(super) struct RowPlane {
    /// In the tile at column `first`.
    pub(super) plane: Plane,
    pub(super) first: usize,
    /// No pixel that the polygon covers is nearer.
    pub(super) nearest: f32,
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
        self.detailed = 0;
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

    /// Number of tiles that keep their depths pixel by pixel.
    pub(super) fn detailed(&self) -> usize {
        self.detailed
    }

    /// Those of the `wanted` tiles of up to [`BLOCKS_ASKED`] blocks of a row, by bits, that their references do not hide as a
    /// whole: nothing is known about them yet. `limits` are those of [`Tiles::open`], in the first tile of the first block.
    #[inline(always)]
    pub(super) fn undecided<S: Simd>(
        &self,
        simd: S,
        first_block: usize,
        blocks: usize,
        tile_y: usize,
        wanted: u64,
        limits: &[Plane],
    ) -> u64 {
        let index = tile_y * self.blocks_x + first_block;
        let row = &self.blocks[index..index + blocks];
        let row_least = &self.least[index..index + blocks];
        let zero = splat(simd, 0.0);
        let mut undecided = 0;
        for (i, (block, least)) in row.iter().zip(row_least).enumerate() {
            let at = f32x8::from_slice(simd, &block.at);
            let dx = f32x8::from_slice(simd, &block.dx) * LAST_X;
            let dy = f32x8::from_slice(simd, &block.dy) * LAST_Y;
            let size = (simd.abs_f32x8(at) + simd.abs_f32x8(dx) + simd.abs_f32x8(dy)) * ROUNDING;
            let columns = ramp(simd) + (i * BLOCK) as f32;
            let mut open = wanted >> (i * BLOCK) & 0xff;
            let unclosed = !f32x8::from_slice(simd, least).simd_gt(zero).to_bitmask() & open;
            // The last limits are planes, which decide more than the first, the nearest depth.
            for limit in limits.iter().rev() {
                let step = limit.dx * TILE_X as f32;
                // Over all that is asked, so that stepping along it is bounded too.
                let reach = limit.at.abs() + (blocks * BLOCK) as f32 * step.abs() + (limit.dy * LAST_Y).abs();
                let over_x = simd.min_f32x8(dx - limit.dx * LAST_X, zero);
                let over_y = simd.min_f32x8(dy - limit.dy * LAST_Y, zero);
                let over = at - (columns * step + limit.at) + over_x + over_y;
                open &= !over.simd_gt(size + reach * ROUNDING).to_bitmask();
                if open == 0 {
                    break;
                }
            }
            undecided |= (open | unclosed) << (i * BLOCK);
        }
        undecided
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
            let inside = columns.simd_ge(splat(simd, from as f32)) & columns.simd_le(splat(simd, to as f32));
            if !(inside & old_least.simd_gt(zero)).any_true() {
                // Nothing to be compared with.
                let take = inside & p_least.simd_gt(zero);
                take_reference(simd, block, least, take, at, p_least, &p);
                continue;
            }
            // What it has over the old reference at the corners.
            let d_at = at - f32x8::from_slice(simd, &block.at);
            let d_x = (splat(simd, p.dx) - f32x8::from_slice(simd, &block.dx)) * LAST_X;
            let d_y = (splat(simd, p.dy) - f32x8::from_slice(simd, &block.dy)) * LAST_Y;
            let worst = d_at + simd.min_f32x8(d_x, zero) + simd.min_f32x8(d_y, zero);
            // Nearer everywhere, or else by its farthest pixel.
            let better = (worst.simd_ge(zero) & old_least.simd_gt(zero)) | p_least.simd_gt(old_least);
            let take = better & inside;
            // Where neither is nearer everywhere, what is not taken would be lost.
            let same = simd.max_f32x8(old_least, p_least) * SAME;
            let most = d_at + simd.max_f32x8(d_x, zero) + simd.max_f32x8(d_y, zero);
            let cross = worst.simd_lt(zero - same) & most.simd_gt(same) & old_least.simd_gt(zero) & inside;
            if cross.any_true() {
                self.cross(simd, index, cross.to_bitmask(), &at.into(), row);
            }
            let take = take & !cross;
            let (block, least) = (&mut self.blocks[index], &mut self.least[index]);
            take_reference(simd, block, least, take, at, p_least, &p);
        }
    }

    /// Closes tiles with a plane that starts at the depths `at` and crosses their references: pixel by pixel.
    #[cold]
    fn cross<S: Simd>(&mut self, simd: S, index: usize, tiles: u64, at: &[f32; BLOCK], row: &RowPlane) {
        for lane in (0..BLOCK).filter(|lane| tiles >> lane & 1 == 1) {
            let plane = Plane { at: at[lane], ..row.plane };
            let top = plane.greatest();
            let top = if row.nearest < top { row.nearest } else { top };
            let all = u32x8::splat(simd, u32::MAX);
            let least = self.least[index][lane];
            if top > least {
                if self.top[index][lane] > least {
                    self.close_more(simd, index, lane, all, &plane, top);
                } else {
                    self.set_working(index, lane, all, &plane, top);
                }
            }
        }
    }

    #[inline(always)]
    fn reference(&self, index: usize, lane: usize) -> Plane {
        let block = &self.blocks[index];
        Plane { at: block.at[lane], dx: block.dx[lane], dy: block.dy[lane] }
    }

    #[inline(always)]
    fn set_reference(&mut self, index: usize, lane: usize, plane: &Plane, least: f32) {
        let block = &mut self.blocks[index];
        (block.at[lane], block.dx[lane], block.dy[lane]) = (plane.at, plane.dx, plane.dy);
        self.least[index][lane] = least;
    }

    #[inline(always)]
    fn set_working<S: Simd>(&mut self, index: usize, lane: usize, mask: u32x8<S>, plane: &Plane, top: f32) {
        self.working[index * BLOCK + lane].set(mask, plane);
        self.top[index][lane] = top;
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
        let p_top = if row.nearest < p_top { row.nearest } else { p_top };
        let least = self.least[index][lane];
        if !(p_top > least) {
            return;
        }
        let reference = self.reference(index, lane);
        if least > 0.0 && p.minus(&reference).greatest() <= 0.0 {
            return;
        }
        let top = self.top[index][lane];
        if !(top > least) {
            self.set_working(index, lane, mask, &p, p_top);
            return;
        }
        let working = &self.working[index * BLOCK + lane];
        let plain = working.detail == 0;
        if let ([q], true) = (working.layers(), plain) {
            let q_mask = u32x8::from_slice(simd, &q.mask);
            let q = q.plane;
            let fits = Fits::new(simd, &p, mask, &q, q_mask, (if p_top > top { p_top } else { top }) * SAME);
            if fits.p_adds_nothing {
                return;
            }
            if fits.q_adds_nothing {
                self.set_working(index, lane, mask, &p, p_top);
                return;
            }
            let union = mask | q_mask;
            if union.simd_eq(u32x8::splat(simd, u32::MAX)).all_true() {
                // The tile is closed. The plane that serves for both closes it, the other part stays as working layer.
                let wanted = |plane: &Plane| least <= 0.0 || plane.minus(&reference).least() >= 0.0;
                if fits.p_serves && wanted(&fits.p_lowered) {
                    let p_least = fits.p_lowered.at + self.fall(&p, tile_x + 1 == self.tiles_x, tile_y);
                    self.set_reference(index, lane, &fits.p_lowered, p_least);
                    return;
                }
                if fits.q_serves && wanted(&fits.q_lowered) {
                    let q_least = fits.q_lowered.at + self.fall(&q, tile_x + 1 == self.tiles_x, tile_y);
                    self.set_reference(index, lane, &fits.q_lowered, q_least);
                    self.set_working(index, lane, mask, &p, p_top);
                    return;
                }
            } else if fits.is_same {
                let plane = if fits.p_serves { fits.p_lowered } else { fits.q_lowered };
                self.set_working(index, lane, union, &plane, if p_top > top { p_top } else { top });
                return;
            }
        }
        if least > 0.0 && is_empty(simd, mask & !above(simd, &reference.minus(&p), 0.0)) {
            return;
        }
        self.close_more(simd, index, lane, mask, &p, p_top);
    }

    /// Closes pixels of a tile whose working layers are in force: by another layer, or else one by one.
    #[inline(always)]
    fn close_more<S: Simd>(&mut self, simd: S, index: usize, lane: usize, mask: u32x8<S>, plane: &Plane, top: f32) {
        let least = self.least[index][lane];
        let working = &mut self.working[index * BLOCK + lane];
        let old_top = self.top[index][lane];
        let top = if top > old_top { top } else { old_top };
        if working.detail != 0 || !working.add(simd, mask, plane, same_at(top), least) {
            self.close_pixels(simd, index, lane, mask, plane, top);
            return;
        }
        self.top[index][lane] = top;
        // A level reference can be replaced by a nearer one without a loss.
        let block = &self.blocks[index];
        let level = block.dx[lane] == 0.0 && block.dy[lane] == 0.0;
        if (!(least > 0.0) || level) && working.covered(simd).simd_eq(u32x8::splat(simd, u32::MAX)).all_true() {
            let closed = working.least();
            if closed > least {
                self.set_reference(index, lane, &Plane { at: closed, dx: 0.0, dy: 0.0 }, closed);
            }
        }
    }

    /// Closes pixels of a tile one by one; makes it detailed if it is not.
    #[inline(always)]
    fn close_pixels<S: Simd>(&mut self, simd: S, index: usize, lane: usize, mask: u32x8<S>, plane: &Plane, top: f32) {
        // One copy of this for each level.
        simd.vectorize(
            #[inline(always)]
            || self.close_pixels_inlined(simd, index, lane, mask, plane, top),
        )
    }

    #[inline(always)]
    fn close_pixels_inlined<S: Simd>(
        &mut self,
        simd: S,
        index: usize,
        lane: usize,
        mask: u32x8<S>,
        plane: &Plane,
        top: f32,
    ) {
        let all = u32x8::splat(simd, u32::MAX);
        let least = self.least[index][lane];
        let in_force = self.top[index][lane] > least;
        if !in_force || self.working[index * BLOCK + lane].detail == 0 {
            self.make_detailed(simd, index, lane, in_force);
        }
        if !in_force || top > self.top[index][lane] {
            self.top[index][lane] = top;
        }
        let working = &mut self.working[index * BLOCK + lane];
        let covered = working.covered(simd) | mask;
        working.set_detailed(covered, working.detail);
        let pixels = &mut self.pixels[working.detail as usize - 1];
        pixels::raise(simd, pixels, mask, plane);
        if !(least > 0.0 || covered.simd_eq(all).all_true()) {
            return;
        }
        if pixels::least(simd, pixels) > least {
            // They are a better reference, since most questions are answered by its least depth.
            if least > 0.0 {
                let block = &self.blocks[index];
                let reference = Plane { at: block.at[lane], dx: block.dx[lane], dy: block.dy[lane] };
                pixels::raise(simd, pixels, all, &reference);
            }
            let closed = pixels::least(simd, pixels);
            self.set_reference(index, lane, &Plane { at: closed, dx: 0.0, dy: 0.0 }, closed);
        }
    }

    /// Gives a tile pixels. They begin with its working layer if that is in force.
    #[inline(always)]
    fn make_detailed<S: Simd>(&mut self, simd: S, index: usize, lane: usize, in_force: bool) {
        if self.detailed == self.pixels.len() {
            self.pixels.push([0.0; TILE_X * TILE_Y]);
        }
        let (tile_x, tile_y) = (index % self.blocks_x * BLOCK + lane, index / self.blocks_x);
        let columns = (self.width as usize - tile_x * TILE_X).min(TILE_X);
        let rows = (self.height as usize - tile_y * TILE_Y).min(TILE_Y);
        let pixels = &mut self.pixels[self.detailed];
        let beyond = pixels::open_all(pixels, columns, rows);
        let working = &mut self.working[index * BLOCK + lane];
        let mut covered = u32x8::from_slice(simd, &beyond);
        if in_force {
            for layer in working.layers() {
                let mask = u32x8::from_slice(simd, &layer.mask);
                pixels::raise(simd, pixels, mask, &layer.plane);
                covered |= mask;
            }
        }
        self.detailed += 1;
        working.set_detailed(covered, self.detailed as u32);
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
        let (least, top) = (self.least[index][lane], self.top[index][lane]);
        let working = &self.working[index * BLOCK + lane];
        let (in_force, detailed) = (top > least, working.detail != 0);
        let mut open = asked;
        if in_force && !detailed {
            open = working.open(simd, open, limits);
            if is_empty(simd, open) {
                return false;
            }
        }
        if least > 0.0 {
            let reference = self.reference(index, lane);
            for limit in limits {
                open &= !nearer(simd, &reference, limit);
            }
            if is_empty(simd, open) {
                return false;
            }
        }
        !(in_force && detailed) || pixels::any_open(simd, &self.pixels[working.detail as usize - 1], open, limits)
    }

    /// Whether anything was drawn over a pixel, for tests with one polygon.
    #[cfg(test)]
    pub(super) fn covers(&self, x: u32, y: u32) -> bool {
        let (tile_x, tile_y) = (x as usize / TILE_X, y as usize / TILE_Y);
        let index = tile_y * self.blocks_x + tile_x / BLOCK;
        let lane = tile_x % BLOCK;
        let working = &self.working[index * BLOCK + lane];
        let whole = self.least[index][lane] > 0.0;
        let covered = working.layers().iter().fold(0, |rows, layer| rows | layer.mask[y as usize % TILE_Y]);
        whole || (self.top[index][lane] != 0.0 && covered >> (x % TILE_X as u32) & 1 == 1)
    }

    /// The depth at which a pixel is closed at least.
    pub(super) fn depth_at(&self, x: u32, y: u32) -> f32 {
        let (tile_x, tile_y) = (x as usize / TILE_X, y as usize / TILE_Y);
        let (i, j) = (x as usize % TILE_X, y as usize % TILE_Y);
        let index = tile_y * self.blocks_x + tile_x / BLOCK;
        let lane = tile_x % BLOCK;
        let at = |plane: Plane| plane.at + i as f32 * plane.dx + j as f32 * plane.dy;
        let reference = if self.least[index][lane] > 0.0 { at(self.reference(index, lane)) } else { 0.0 };
        if !(self.top[index][lane] > self.least[index][lane]) {
            return reference;
        }
        let working = &self.working[index * BLOCK + lane];
        let nearer = match working.detail as usize {
            0 => working.depth_at(i, j),
            place => self.pixels[place - 1][j * TILE_X + i],
        };
        reference.max(nearer)
    }
}

/// Gives the tiles of a block another reference: a plane that starts at the depths `at`.
#[inline(always)]
fn take_reference<S: Simd>(
    simd: S,
    block: &mut Block,
    least: &mut [f32; BLOCK],
    tiles: mask32x8<S>,
    at: f32x8<S>,
    at_least: f32x8<S>,
    plane: &Plane,
) {
    let old_least = f32x8::from_slice(simd, least);
    tiles.select(at, f32x8::from_slice(simd, &block.at)).store_slice(&mut block.at);
    tiles.select(splat(simd, plane.dx), f32x8::from_slice(simd, &block.dx)).store_slice(&mut block.dx);
    tiles.select(splat(simd, plane.dy), f32x8::from_slice(simd, &block.dy)).store_slice(&mut block.dy);
    tiles.select(at_least, old_least).store_slice(least);
}
