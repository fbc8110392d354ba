//! Which boxes can be asked about together? Those that reach into different parts of the image (Staneker et al. 2003, §3.2).
//!
//! Boxes of one batch do not hide each other, so that two that lie behind one another should not be in the same. Boxes come
//! nearest first. Each goes into the first batch in whose map it reaches into a tile that no box of the batch took, and takes
//! its tiles in every map that was looked at.

use super::{Bits, Scale};

/// Four maps of taken tiles, and a batch for what finds no free tile in any.
#[derive(Clone, Debug)]
pub struct Batches([Bits; Batches::COUNT - 1]);

impl Batches {
    /// Number of batches: "we have found that five multiple occlusion queries are sufficient".
    pub const COUNT: usize = 5;

    /// No tile is taken.
    pub fn new() -> Batches {
        Batches([Bits::EMPTY; Batches::COUNT - 1])
    }

    /// Forgets all boxes.
    pub(crate) fn begin(&mut self) {
        self.0.fill(Bits::EMPTY);
    }

    /// Puts a box, nearest boxes first, into a batch: its number. The box covers columns `x` and rows `y`, first to last.
    pub(crate) fn place(&mut self, scale: &Scale, x: [i32; 2], y: [i32; 2]) -> usize {
        // What lies outside the scene's part of the image hides nothing and is hidden by nothing.
        let (Some(x), Some(y)) = (scale.clip(0, x), scale.clip(1, y)) else { return 0 };
        let [left, right] = scale.tiles(0, x);
        let [top, bottom] = scale.tiles(1, y);
        self.0
            .iter_mut()
            .position(|taken| (top..=bottom).fold(false, |free, row| taken.take(row, left, right) | free))
            .unwrap_or(Batches::COUNT - 1)
    }
}

impl Default for Batches {
    fn default() -> Batches {
        Batches::new()
    }
}
