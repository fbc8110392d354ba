//! The passes that item buffer and histogram share: colour the boxes, see whose colours appear, repeat without those.
//!
//! Klosowski & Silva 2001, §3.2: a cell may be covered by other cells of the front, though it can be seen past what was
//! drawn. So each pass leaves out the cells that appeared in one before, and the last one shows none. A tile where nothing
//! appeared is empty in later passes too, since they draw fewer boxes (§3.4).

use super::{PlacedBox, QueryCost, no_depth};
use crate::raster_sampled::{BoxImage, BoxPlace};
use crate::{Aabb, DepthBuffer, PixelRect, View};

/// How the colours of a tile come back to the host.
pub(super) trait ReadBack<C> {
    /// Calls `found` with colours that appear in these rows, of which one is the background. Returns the number of values read.
    fn read<'a>(&mut self, rows: impl Iterator<Item = &'a [C]>, found: impl FnMut(C)) -> u64
    where
        C: 'a;
}

/// A colour per pixel.
pub(super) trait Colour: Copy + PartialEq {
    /// Where no box passed.
    const BACKGROUND: Self;
    fn of_cell(index: usize) -> Self;
    fn cell(self) -> usize;
}

#[derive(Clone, Debug)]
pub(super) struct Passes<C> {
    pub(super) depth: DepthBuffer,
    /// Whether boxes hide each other by depth within a pass, instead of the last one drawn winning.
    pub(super) depth_mask: bool,
    /// Side of a tile in pixels; the whole image if 0.
    pub(super) tile_side: usize,
    colours: Vec<C>,
    /// Scene's depths and those of the boxes before them in this pass.
    nearest: Vec<f32>,
    size: [usize; 2],
    side: usize,
    columns: usize,
    /// Per tile: whether the passes of this query still draw in it.
    active: Vec<bool>,
    /// Per tile: whether nothing more can be seen in it in this frame.
    finished: Vec<bool>,
    /// Per tile: whether a box of this query was seen in it.
    shown: Vec<bool>,
    asked: Vec<Asked>,
}

/// A box that no pass has shown yet.
#[derive(Clone, Debug)]
struct Asked {
    /// Its place in the query.
    cell: u32,
    image: BoxImage,
    /// Pixels compared so far.
    z_tests: usize,
}

impl<C: Colour> Passes<C> {
    pub(super) fn new() -> Passes<C> {
        Passes {
            depth: no_depth(),
            depth_mask: true,
            tile_side: 0,
            colours: Vec::new(),
            nearest: Vec::new(),
            size: [0; 2],
            side: 1,
            columns: 0,
            active: Vec::new(),
            finished: Vec::new(),
            shown: Vec::new(),
            asked: Vec::new(),
        }
    }

    pub(super) fn begin(&mut self, view: &View) {
        self.depth.begin(view);
        let view = &view.or_without_pixels();
        self.size = [view.resolution.width as usize, view.resolution.height as usize];
        self.side = if self.tile_side == 0 { self.size[0].max(self.size[1]).max(1) } else { self.tile_side };
        self.columns = self.size[0].div_ceil(self.side);
        let tiles = self.columns * self.size[1].div_ceil(self.side);
        self.colours.resize(view.resolution.pixels(), C::BACKGROUND);
        for flags in [&mut self.active, &mut self.finished, &mut self.shown] {
            flags.clear();
            flags.resize(tiles, false);
        }
    }

    /// Answers a query by passes, of which `whole_front` allows to finish tiles for good.
    pub(super) fn query(
        &mut self,
        cells: &[Aabb],
        seen: &mut [bool],
        read_back: &mut impl ReadBack<C>,
        whole_front: bool,
    ) -> QueryCost {
        let mut touching = false;
        self.asked.clear();
        for (i, cell) in cells.iter().enumerate() {
            match self.depth.box_place(cell) {
                BoxPlace::Outside => {}
                BoxPlace::Touching => (seen[i], touching) = (true, true),
                BoxPlace::In(image) => self.asked.push(Asked { cell: i as u32, image, z_tests: 0 }),
            }
        }
        self.ask(seen, read_back, whole_front, touching)
    }

    /// The same for boxes whose places are known.
    pub(super) fn query_placed(
        &mut self,
        boxes: &[PlacedBox],
        seen: &mut [bool],
        read_back: &mut impl ReadBack<C>,
        whole_front: bool,
    ) -> QueryCost {
        self.asked.clear();
        let asked = |(cell, placed): (u32, &PlacedBox)| Asked { cell, image: placed.image, z_tests: 0 };
        self.asked.extend((0..).zip(boxes).map(asked));
        self.ask(seen, read_back, whole_front, false)
    }

    /// Draws what is asked until a pass shows nothing new. `touching`: whether something touches the near plane.
    fn ask(
        &mut self,
        seen: &mut [bool],
        read_back: &mut impl ReadBack<C>,
        whole_front: bool,
        touching: bool,
    ) -> QueryCost {
        let mut cost = QueryCost::default();
        self.shown.fill(false);
        self.active.iter_mut().zip(&self.finished).for_each(|(active, finished)| *active = !(whole_front && *finished));
        while !self.asked.is_empty() && self.active.contains(&true) {
            cost.passes += 1;
            self.clear();
            cost.z_tests += self.draw();
            cost.read_back += self.read(seen, read_back);
            let depth = &self.depth;
            self.asked.retain(|asked| {
                let seen = seen[asked.cell as usize];
                if seen {
                    depth.count_query(asked.z_tests, true);
                }
                !seen
            });
        }
        self.asked.iter().for_each(|asked| self.depth.count_query(asked.z_tests, false));
        // A box that touches the near plane has no image: it may be what can be seen in any tile.
        if whole_front && !touching {
            self.finished.iter_mut().zip(&self.shown).for_each(|(finished, shown)| *finished |= !shown);
        }
        cost
    }

    pub(super) fn is_full(&self) -> bool {
        if self.finished.is_empty() {
            self.depth.has_no_pixels()
        } else {
            self.finished.iter().all(|&finished| finished)
        }
    }

    pub(super) fn finished_tiles(&self) -> Vec<PixelRect> {
        let finished = (0..self.finished.len()).filter(|&tile| self.finished[tile]);
        let rect = |tile| {
            let [x, y] = self.tile(tile).map(|range| [range.start as u32, range.end as u32]);
            PixelRect { x, y }
        };
        finished.map(rect).collect()
    }

    /// Columns and rows of a tile.
    fn tile(&self, tile: usize) -> [std::ops::Range<usize>; 2] {
        [(tile % self.columns, self.size[0]), (tile / self.columns, self.size[1])]
            .map(|(at, size)| at * self.side..size.min((at + 1) * self.side))
    }

    fn clear(&mut self) {
        let width = self.size[0];
        if self.depth_mask {
            self.nearest.resize(self.colours.len(), 0.0);
        }
        for tile in 0..self.active.len() {
            if self.active[tile] {
                let [columns, rows] = self.tile(tile);
                for y in rows {
                    let row = y * width + columns.start..y * width + columns.end;
                    self.colours[row.clone()].fill(C::BACKGROUND);
                    if self.depth_mask {
                        self.nearest[row].copy_from_slice(&self.depth.row(y)[columns.clone()]);
                    }
                }
            }
        }
    }

    /// Draws the boxes asked for into the active tiles. Returns the number of z-tests.
    fn draw(&mut self) -> u64 {
        let (width, side) = (self.size[0], self.side);
        let mut z_tests = 0;
        for Asked { cell, image, z_tests: own } in &mut self.asked {
            let before = z_tests;
            let colour = C::of_cell(*cell as usize);
            for (y, [first, last]) in image.rows() {
                let tiles = y / side * self.columns;
                let front = image.front(y, [first, last]);
                for tile in first / side..=last / side {
                    if !self.active[tiles + tile] {
                        continue;
                    }
                    let [from, end] = [first.max(tile * side), (last + 1).min((tile + 1) * side)];
                    let row = y * width + from..y * width + end;
                    z_tests += (end - from) as u64;
                    let colours = &mut self.colours[row.clone()];
                    if self.depth_mask {
                        front.paint_nearer(from - first, &mut self.nearest[row], colours, colour);
                    } else {
                        front.paint(from - first, &self.depth.row(y)[from..end], colours, colour);
                    }
                }
            }
            *own += (z_tests - before) as usize;
        }
        z_tests
    }

    /// Marks the cells that appear, and the tiles where none does as not active. Returns the number of values read back.
    fn read(&mut self, seen: &mut [bool], read_back: &mut impl ReadBack<C>) -> u64 {
        let width = self.size[0];
        let mut values = 0;
        for tile in 0..self.active.len() {
            if !self.active[tile] {
                continue;
            }
            let [columns, rows] = self.tile(tile);
            let mut shows = false;
            let rows = rows.map(|y| &self.colours[y * width + columns.start..y * width + columns.end]);
            values += read_back.read(rows, |colour| {
                if colour != C::BACKGROUND {
                    shows = true;
                    seen[colour.cell()] = true;
                }
            });
            self.active[tile] = shows;
            self.shown[tile] |= shows;
        }
        values
    }
}
