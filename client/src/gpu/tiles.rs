//! Which parts of an item buffer must still be read back? (Klosowski & Silva 2001, §3.4 and figure 10.)
//!
//! The image is divided into fixed tiles. Within a query, a tile where a pass showed no box is empty in later passes too, since they draw fewer
//! boxes. Within a frame, a tile where a whole front showed none is finished: depths only come nearer. Neither is copied,
//! mapped or scanned again.

use std::ops::Range;

use eyeline_visibility::{ItemBuffer, PixelRect, Resolution, TILE_SIDE};

use super::buffers::ReadBack;
use super::{Gpu, GpuError};

/// The tiles of an image, or one tile that is all of it.
#[derive(Debug, Default)]
pub(super) struct Tiles {
    /// Side of a tile in pixels; the whole image if 0.
    side: u32,
    size: [u32; 2],
    columns: u32,
    state: Vec<State>,
    /// The tiles of the pass under way, and where the bytes of each begin.
    copied: Vec<(usize, usize)>,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct State {
    /// Whether the passes of this query still draw in it.
    is_active: bool,
    /// Whether a box of this query was seen in it.
    has_shown: bool,
    /// Whether nothing more can be seen in it in this frame.
    is_finished: bool,
}

impl Tiles {
    /// The paper's tiles: 64 of them for an image of 512 × 512.
    pub(super) fn of_paper() -> Tiles {
        Tiles { side: TILE_SIDE, ..Tiles::default() }
    }

    /// One tile for the whole image.
    pub(super) fn whole() -> Tiles {
        Tiles::default()
    }

    /// Starts another frame. Without pixels there are no tiles.
    pub(super) fn begin(&mut self, Resolution { width, height }: Resolution) {
        self.size = [width, height];
        let side = self.side();
        self.columns = width.div_ceil(side);
        self.state.clear();
        self.state.resize(self.columns as usize * height.div_ceil(side) as usize, State::default());
        self.copied.clear();
    }

    /// Starts another query. That of a whole front leaves out what is finished.
    pub(super) fn ask(&mut self, whole_front: bool) {
        for state in &mut self.state {
            state.is_active = !(whole_front && state.is_finished);
            state.has_shown = false;
        }
    }

    /// Whether a pass can show anything.
    pub(super) fn are_active(&self) -> bool {
        self.state.iter().any(|state| state.is_active)
    }

    /// A whole front was answered, and none of its boxes went undrawn: where it showed nothing, nothing more can be seen.
    pub(super) fn finish(&mut self) {
        self.state.iter_mut().for_each(|state| state.is_finished |= !state.has_shown);
    }

    /// Whether nothing more can be seen anywhere.
    pub(super) fn are_finished(&self) -> bool {
        !self.state.is_empty() && self.state.iter().all(|state| state.is_finished)
    }

    /// Those that are finished.
    pub(super) fn finished(&self) -> Vec<PixelRect> {
        self.of(|state| state.is_finished).map(|tile| self.rect(tile)).collect()
    }

    /// The least rectangle with all tiles that are drawn in.
    pub(super) fn drawn(&self) -> Option<PixelRect> {
        self.of(|state| state.is_active).map(|tile| self.rect(tile)).reduce(|all, rect| {
            let joined = |a: [u32; 2], b: [u32; 2]| [a[0].min(b[0]), a[1].max(b[1])];
            PixelRect { x: joined(all.x, rect.x), y: joined(all.y, rect.y) }
        })
    }

    /// Has the active tiles of an item buffer copied to where they can be read.
    pub(super) fn copy(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        items: &wgpu::Texture,
        to: &mut ReadBack,
    ) -> Result<(), GpuError> {
        let bytes = self.plan();
        let buffer = to.prepare(gpu, bytes as u64)?;
        for &(tile, offset) in &self.copied {
            let PixelRect { x, y } = self.rect(tile);
            let source = wgpu::TexelCopyTextureInfo {
                origin: wgpu::Origin3d { x: x[0], y: y[0], z: 0 },
                ..items.as_image_copy()
            };
            let layout = wgpu::TexelCopyBufferLayout {
                offset: offset as u64,
                bytes_per_row: Some(bytes_per_row(x[1] - x[0])),
                rows_per_image: None,
            };
            let size = wgpu::Extent3d { width: x[1] - x[0], height: y[1] - y[0], depth_or_array_layers: 1 };
            encoder.copy_texture_to_buffer(source, wgpu::TexelCopyBufferInfo { buffer, layout }, size);
        }
        Ok(())
    }

    /// Says where the bytes of each active tile go, and how many there are.
    fn plan(&mut self) -> usize {
        let mut bytes = 0;
        let mut copied = std::mem::take(&mut self.copied);
        copied.clear();
        for tile in self.of(|state| state.is_active) {
            copied.push((tile, bytes));
            bytes += self.bytes(tile).len();
        }
        self.copied = copied;
        bytes
    }

    /// Scans what was copied: calls `add` with colours that appear and how many neighbours have them, and leaves tiles without any out of
    /// later passes. Returns the number of pixels.
    pub(super) fn read(&mut self, bytes: &[u8], mut add: impl FnMut(u32, u32)) -> u64 {
        let mut pixels = 0;
        let copied = std::mem::take(&mut self.copied);
        for &(tile, offset) in &copied {
            let PixelRect { x, .. } = self.rect(tile);
            let width = (x[1] - x[0]) as usize;
            let mut shows = false;
            let rows = bytes[offset..][self.bytes(tile)].chunks_exact(bytes_per_row(x[1] - x[0]) as usize);
            for row in rows {
                let row = &bytemuck::cast_slice::<u8, u32>(row)[..width];
                pixels += row.len() as u64;
                // Neighbours mostly have the same colour.
                for same in row.chunk_by(|a, b| a == b).filter(|same| same[0] != ItemBuffer::NONE) {
                    shows = true;
                    add(same[0], same.len() as u32);
                }
            }
            let state = &mut self.state[tile];
            state.is_active = shows;
            state.has_shown |= shows;
        }
        self.copied = copied;
        pixels
    }

    fn side(&self) -> u32 {
        if self.side == 0 { self.size[0].max(self.size[1]).max(1) } else { self.side }
    }

    fn of(&self, is_one: impl Fn(&State) -> bool) -> impl Iterator<Item = usize> {
        self.state.iter().enumerate().filter(move |(_, state)| is_one(state)).map(|(tile, _)| tile)
    }

    fn rect(&self, tile: usize) -> PixelRect {
        let (side, tile) = (self.side(), tile as u32);
        let ends = |at: u32, size: u32| [at * side, size.min((at + 1) * side)];
        PixelRect { x: ends(tile % self.columns, self.size[0]), y: ends(tile / self.columns, self.size[1]) }
    }

    /// What a tile takes where it is copied to, from its own first byte on.
    fn bytes(&self, tile: usize) -> Range<usize> {
        let PixelRect { x, y } = self.rect(tile);
        0..bytes_per_row(x[1] - x[0]) as usize * (y[1] - y[0]) as usize
    }
}

/// What a row of so many pixels takes where it is copied to. A whole tile's is as wide as a copy's rows are aligned.
fn bytes_per_row(width: u32) -> u32 {
    (4 * width).next_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The bytes of an image of item numbers, as the active tiles of `tiles` are copied.
    fn copied(tiles: &mut Tiles, image: &[u32], width: usize) -> Vec<u8> {
        let mut bytes = vec![0; tiles.plan()];
        for &(tile, offset) in &tiles.copied {
            let PixelRect { x, y } = tiles.rect(tile);
            for (row, y) in (y[0]..y[1]).enumerate() {
                let pixels = &image[y as usize * width..][x[0] as usize..x[1] as usize];
                let at = offset + row * bytes_per_row(x[1] - x[0]) as usize;
                bytes[at..][..4 * pixels.len()].copy_from_slice(bytemuck::cast_slice(pixels));
            }
        }
        bytes
    }

    fn scan(tiles: &mut Tiles, image: &[u32], width: usize) -> (u64, Vec<(u32, u32)>) {
        let bytes = copied(tiles, image, width);
        let mut found = std::collections::BTreeMap::new();
        let pixels = tiles.read(&bytes, |item, count| *found.entry(item).or_insert(0) += count);
        (pixels, found.into_iter().collect())
    }

    #[test]
    fn a_tile_that_shows_nothing_is_not_read_again() {
        // Two columns and two rows of tiles, of which the right and lower ones are cut off.
        let (width, height) = (100, 70);
        let mut image = vec![ItemBuffer::NONE; width * height];
        (image[3], image[66 * width + 90]) = (7, 9);
        for (mut tiles, again) in [(Tiles::of_paper(), 64 * 64 + 36 * 6), (Tiles::whole(), 7_000)] {
            tiles.begin(Resolution::new(width as u32, height as u32));
            tiles.ask(false);
            assert_eq!(scan(&mut tiles, &image, width), (7_000, vec![(7, 1), (9, 1)]));
            assert_eq!(scan(&mut tiles, &image, width), (again, vec![(7, 1), (9, 1)]));
            // The next query does not know what the last one found, unless a whole front was asked about.
            tiles.ask(true);
            assert_eq!(scan(&mut tiles, &image, width).0, 7_000);
        }
    }

    #[test]
    fn where_a_whole_front_shows_nothing_the_frame_is_finished() {
        let (width, height) = (128, 128);
        let mut image = vec![ItemBuffer::NONE; width * height];
        image[127] = 0;
        let mut tiles = Tiles::of_paper();
        tiles.begin(Resolution::new(128, 128));
        tiles.ask(true);
        scan(&mut tiles, &image, width);
        tiles.finish();
        assert_eq!(tiles.finished().len(), 3);
        assert!(!tiles.are_finished());
        tiles.ask(true);
        assert_eq!(tiles.drawn(), Some(PixelRect { x: [64, 128], y: [0, 64] }));
        image[127] = ItemBuffer::NONE;
        assert_eq!(scan(&mut tiles, &image, width), (64 * 64, Vec::new()));
        assert!(!tiles.are_active());
        tiles.finish();
        assert!(tiles.are_finished());
        // A query of other boxes looks everywhere, and so does the next frame.
        tiles.ask(false);
        assert_eq!(tiles.drawn(), Some(PixelRect { x: [0, 128], y: [0, 128] }));
        tiles.begin(Resolution::new(128, 128));
        assert!(!tiles.are_finished());
        // Without pixels there is nothing to draw in, and nothing that could be finished.
        tiles.begin(Resolution::new(0, 9));
        assert!(!tiles.are_finished() && !tiles.are_active() && tiles.drawn().is_none());
    }
}
