//! Which colours are left in the image? The item-buffer technique (Klosowski & Silva 2001, §3.2 and §3.4).

use super::passes::{Colour, Passes, ReadBack};
use super::{PlacedBox, QueryBackEnd, QueryCost};
use crate::{Aabb, DepthBuffer, PixelRect, View};

/// Side of a tile in pixels: the paper's 64 tiles of an image of 512 × 512.
pub const TILE_SIDE: u32 = 64;

/// Draws each box in a colour of its own, reads the image back and scans it; repeats without the boxes that appeared until
/// none does.
///
/// With tiles, a pass clears, draws and scans only those where the pass before showed a box, and a frame leaves out those
/// where the whole front showed none.
#[derive(Clone, Debug)]
pub struct ItemBufferQuery {
    passes: Passes<u32>,
}

impl Colour for u32 {
    const BACKGROUND: u32 = u32::MAX;

    fn of_cell(index: usize) -> u32 {
        index as u32
    }

    fn cell(self) -> usize {
        self as usize
    }
}

/// Scans pixels.
struct Scan;

impl ReadBack<u32> for Scan {
    fn read<'a>(&mut self, rows: impl Iterator<Item = &'a [u32]>, mut found: impl FnMut(u32)) -> u64 {
        let mut pixels = 0;
        let mut last = u32::BACKGROUND;
        for row in rows {
            pixels += row.len() as u64;
            for &colour in row {
                // Neighbours mostly have the same colour.
                if colour != last {
                    last = colour;
                    found(colour);
                }
            }
        }
        pixels
    }
}

impl ItemBufferQuery {
    /// Without tiles, boxes hiding each other by depth.
    pub fn new() -> ItemBufferQuery {
        ItemBufferQuery { passes: Passes::new() }
    }

    /// With tiles of `side` × `side` pixels from the next frame on; one for the whole image if `side` is 0.
    pub fn with_tile_side(mut self, side: u32) -> ItemBufferQuery {
        self.passes.tile_side = side as usize;
        self
    }

    /// Whether boxes write depth within a pass. If so (the default), a pass shows the front's "top layer" as in the paper's
    /// §3.6. If not, as in its listing in §3.2, the box that is drawn last wins a pixel. Both end with the same answers.
    pub fn with_depth_mask(mut self, depth_mask: bool) -> ItemBufferQuery {
        self.passes.depth_mask = depth_mask;
        self
    }
}

impl Default for ItemBufferQuery {
    fn default() -> ItemBufferQuery {
        ItemBufferQuery::new()
    }
}

impl QueryBackEnd for ItemBufferQuery {
    fn begin(&mut self, view: &View) {
        self.passes.begin(view);
    }

    fn query(&mut self, cells: &[Aabb], seen: &mut Vec<bool>) -> QueryCost {
        seen.clear();
        seen.resize(cells.len(), false);
        self.passes.query(cells, seen, &mut Scan, false)
    }

    fn query_front(&mut self, cells: &[Aabb], seen: &mut Vec<bool>) -> QueryCost {
        seen.clear();
        seen.resize(cells.len(), false);
        self.passes.query(cells, seen, &mut Scan, true)
    }

    fn query_placed(&mut self, boxes: &[PlacedBox], whole_front: bool, seen: &mut Vec<bool>) -> QueryCost {
        seen.clear();
        seen.resize(boxes.len(), false);
        self.passes.query_placed(boxes, seen, &mut Scan, whole_front)
    }

    fn is_full(&self) -> bool {
        self.passes.is_full()
    }

    fn finished_tiles(&self) -> Vec<PixelRect> {
        self.passes.finished_tiles()
    }

    fn depth(&self) -> &DepthBuffer {
        &self.passes.depth
    }

    fn depth_mut(&mut self) -> &mut DepthBuffer {
        &mut self.passes.depth
    }
}
