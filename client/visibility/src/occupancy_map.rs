//! Which parts of the image has nothing been drawn into yet? Occupancy maps (Staneker, Bartz & Meißner 2003).
//!
//! A box that reaches into such a part is certainly seen, so that nobody needs to ask about its pixels (§3.1). A map is one
//! bit per tile of the image, 256 × 64 of them, 2,048 bytes that stay in the first-level cache, scaled to the scene's box on
//! screen. It answers *certainly seen* or nothing.
//!
//! The paper marks the rectangle of each drawn box and compares it with the rectangle of the box asked about, and so draws
//! some of what a query would have hidden. Cells here list triangles that reach beyond them, so that rectangles of cells would
//! say too little of what was drawn. This map marks the tiles that drawn triangles reach into, and is asked with a box's
//! silhouette: a tile without a mark has no pixel that was drawn, each of its pixels is as far as can be, and a query that
//! looked at one of them would see the box. So answers are those of the query, and the visible set does not grow.
//!
//! What the map cannot tell may still be told by the pixel in the middle of the box or one of its corners (§6.1), and else by
//! a query. Of those,
//! [`Batches`] says which can be asked together (§3.2): four more maps of the tiles that boxes of a batch take up, and a batch
//! for what is left.

mod batches;
mod query;

use std::cell::Cell;

use crate::raster_sampled::{BoxImage, BoxPlace, Marks};
use crate::{Aabb, DepthBuffer, PixelRect, Scene};

pub use batches::Batches;
pub use query::OccupancyQuery;

/// How a culler uses occupancy maps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Occupancy {
    /// Not at all.
    #[default]
    Off,
    /// One map that spares queries of what is certainly seen; the rest is asked as without it (§3.1). Where it knows too little of a
    /// frame to pay, it is left alone for the rest of that frame.
    Single,
    /// The same, asked to the end of every frame: to measure what a map spares.
    Always,
    /// In addition, the rest waits until everything that is certainly seen was drawn, and is then asked in at most five
    /// batches, nearest corners first (§3.2).
    Batched,
}

/// Boxes in a row after which a map is judged.
const TRIAL: u32 = 256;

/// When a map is given up for the rest of a frame: when it foresees fewer than one of so many boxes among [`TRIAL`] in a row, so that to
/// mark and to ask takes longer than the queries that are spared. Counted anew in each frame, so that what a frame shows hangs on no other.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Worth(u32);

impl Worth {
    /// Never given up.
    const LASTS: Worth = Worth(u32::MAX);

    /// Where a query looks at every pixel of a box, or starts anew at each level of a pyramid.
    pub(crate) fn of_long_queries(occupancy: Occupancy) -> Worth {
        Worth::unless_always(occupancy, 8)
    }

    /// Where a query ends with the first pixels in which a box passes, and of one that is seen looks at little more than a map does.
    pub(crate) fn of_short_queries(occupancy: Occupancy) -> Worth {
        Worth::unless_always(occupancy, 2)
    }

    /// Where queries are drawn elsewhere: their answers are waited for, and each that is spared counts.
    pub(crate) fn of_answers_waited_for() -> Worth {
        Worth::LASTS
    }

    fn unless_always(occupancy: Occupancy, boxes: u32) -> Worth {
        if occupancy == Occupancy::Always { Worth::LASTS } else { Worth(boxes) }
    }

    /// Whether so many foreseen boxes of a trial are too few.
    #[inline]
    fn is_missed_by(self, known: u32) -> bool {
        self != Worth::LASTS && known * self.0 < TRIAL
    }
}

/// Columns and rows of tiles of a map.
const COLUMNS: usize = 256;
const ROWS: usize = 64;
const WORDS: usize = COLUMNS / 64;

/// A bit per tile.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Bits([[u64; WORDS]; ROWS]);

impl Bits {
    const EMPTY: Bits = Bits([[0; WORDS]; ROWS]);

    /// The bits of word `word` that lie in these columns.
    #[inline]
    fn mask(word: usize, first: u8, last: u8) -> u64 {
        let (low, high) = (usize::from(first).max(word * 64) % 64, usize::from(last).min(word * 64 + 63) % 64);
        u64::MAX << low & u64::MAX >> (63 - high)
    }

    /// Sets the columns `first` to `last` of a row.
    #[inline]
    fn set(&mut self, row: u8, first: u8, last: u8) {
        for word in usize::from(first) / 64..=usize::from(last) / 64 {
            self.0[usize::from(row)][word] |= Bits::mask(word, first, last);
        }
    }

    /// Sets the columns `first` to `last` of a row. Returns whether any was not set.
    #[inline]
    fn take(&mut self, row: u8, first: u8, last: u8) -> bool {
        let mut free = 0;
        for word in usize::from(first) / 64..=usize::from(last) / 64 {
            let (mask, bits) = (Bits::mask(word, first, last), &mut self.0[usize::from(row)][word]);
            free |= !*bits & mask;
            *bits |= mask;
        }
        free != 0
    }

    /// The first column of `first` to `last` of a row that is not set.
    #[inline]
    fn first_clear(&self, row: u8, first: u8, last: u8) -> Option<usize> {
        (usize::from(first) / 64..=usize::from(last) / 64).find_map(|word| {
            let clear = !self.0[usize::from(row)][word] & Bits::mask(word, first, last);
            (clear != 0).then(|| word * 64 + clear.trailing_zeros() as usize)
        })
    }

    /// Whether the columns `first` to `last` of a row are all set.
    #[inline]
    fn are_set(&self, row: u8, first: u8, last: u8) -> bool {
        (usize::from(first) / 64..=usize::from(last) / 64).all(|word| {
            let mask = Bits::mask(word, first, last);
            self.0[usize::from(row)][word] & mask == mask
        })
    }
}

/// Which tile holds which pixel. Each tile holds at least one: a map of a part of fewer pixels has fewer tiles.
#[derive(Clone, Debug, Default)]
pub(crate) struct Scale {
    /// First column and row of pixels, and the first ones beyond: the part of the image that has tiles.
    part: [[usize; 2]; 2],
    size: [usize; 2],
    /// For each column of pixels of the image its tile's column, likewise rows. Pixels outside the part have that of the
    /// nearest one in it.
    tiles: [Vec<u8>; 2],
}

impl Scale {
    /// Spreads tiles over a part of an image of `size` pixels.
    fn begin(&mut self, size: [usize; 2], part: [[usize; 2]; 2]) {
        if self.size == size && self.part == part {
            return;
        }
        (self.size, self.part) = (size, part);
        for (axis, most) in [COLUMNS, ROWS].into_iter().enumerate() {
            let [from, end] = part[axis];
            let pixels = end - from;
            let count = most.min(pixels).max(1);
            let tiles = &mut self.tiles[axis];
            tiles.clear();
            tiles.resize(size[axis], 0);
            for tile in 0..count {
                tiles[from + first_of(tile, pixels, count)..from + first_of(tile + 1, pixels, count)].fill(tile as u8);
            }
            tiles[end..].fill((count - 1) as u8);
        }
    }

    /// The part of a range of columns (`axis` 0) or rows, first to last, that has tiles.
    #[inline]
    fn clip(&self, axis: usize, [first, last]: [i32; 2]) -> Option<[usize; 2]> {
        let [from, end] = self.part[axis];
        let [first, last] = [first.max(from as i32), last.min(end as i32 - 1)];
        (first <= last).then_some([first as usize, last as usize])
    }

    /// Whether no tile is there, for want of pixels.
    #[inline]
    fn is_empty(&self) -> bool {
        self.part.iter().any(|[from, end]| from == end)
    }

    /// The tiles of a range of columns or rows of the image, or those nearest to it.
    #[inline]
    fn nearest(&self, axis: usize, range: [i32; 2]) -> [u8; 2] {
        range.map(|at| self.tiles[axis][at as usize])
    }

    /// The tiles of a clipped range.
    #[inline]
    fn tiles(&self, axis: usize, range: [usize; 2]) -> [u8; 2] {
        range.map(|at| self.tiles[axis][at])
    }

    /// The pixels of a row of tiles, first to last.
    fn rows(&self, tile: usize) -> [usize; 2] {
        self.pixels(1, ROWS, tile)
    }

    /// The pixels of a column of tiles, first to last.
    fn columns(&self, tile: usize) -> [usize; 2] {
        self.pixels(0, COLUMNS, tile)
    }

    fn pixels(&self, axis: usize, most: usize, tile: usize) -> [usize; 2] {
        let [from, end] = self.part[axis];
        let count = most.min(end - from);
        [from + first_of(tile, end - from, count), from + first_of(tile + 1, end - from, count) - 1]
    }
}

/// The first of `pixels` pixels that belongs to a tile of `count`: pixel p is in tile ⌊p · count / pixels⌋.
fn first_of(tile: usize, pixels: usize, count: usize) -> usize {
    (tile * pixels).div_ceil(count)
}

/// Where something was drawn. See the module.
#[derive(Clone, Debug)]
pub struct OccupancyMap {
    scale: Scale,
    bits: Bits,
    waiting: Waiting,
    /// Boxes asked about in this frame, and those that were known to be seen.
    asked: [Cell<u32>; 2],
    /// Of these, how many were known when the trial under way began.
    known: Cell<u32>,
    worth: Worth,
    given_up: Cell<bool>,
}

/// Columns of tiles, first to last, that a piece under way was drawn into in a row of tiles: a row of tiles holds several rows of
/// pixels, whose spans overlap or touch, and is set once. Descending if there are none.
#[derive(Clone, Copy, Debug)]
struct Waiting {
    row: u8,
    first: u8,
    last: u8,
}

const NOTHING_WAITS: Waiting = Waiting { row: 0, first: u8::MAX, last: 0 };

impl OccupancyMap {
    /// Bytes of one map's bits.
    pub const BYTES: usize = size_of::<Bits>();

    /// A map of no image yet, that is never given up.
    pub fn new() -> OccupancyMap {
        OccupancyMap {
            scale: Scale::default(),
            bits: Bits::EMPTY,
            waiting: NOTHING_WAITS,
            asked: Default::default(),
            known: Cell::new(0),
            worth: Worth::LASTS,
            given_up: Cell::new(false),
        }
    }

    /// When the map is to be given up, from the next frame on.
    pub(crate) fn set_worth(&mut self, worth: Worth) {
        self.worth = worth;
    }

    /// Whether nobody is to mark it any more, and so nobody may ask it, until it is begun again.
    #[inline]
    pub fn is_given_up(&self) -> bool {
        self.given_up.get()
    }

    /// Forgets everything and starts a map of an image that nothing was drawn into. `scene` is a box around all that will be
    /// drawn: the tiles are spread over the part of the image that it may cover.
    pub fn begin(&mut self, depth: &DepthBuffer, scene: &Aabb) {
        let size = depth.size();
        let part = match depth.rectangle(scene) {
            BoxPlace::Outside => [[0; 2]; 2],
            BoxPlace::Touching => size.map(|size| [0, size]),
            BoxPlace::In(rectangle) => [rectangle.x(), rectangle.y()].map(|[first, last]| [first, last + 1]),
        };
        self.scale.begin(size, part);
        self.bits = Bits::EMPTY;
        self.asked.iter().chain([&self.known]).for_each(|count| count.set(0));
        self.given_up.set(false);
    }

    /// How many boxes the map was asked about since it was begun, and of how many it was known that they are seen.
    pub fn asked(&self) -> [usize; 2] {
        [&self.asked[0], &self.asked[1]].map(|count| count.get() as usize)
    }

    /// Counts a question and what it came to, which is handed back.
    #[inline]
    pub(crate) fn count(&self, foreseen: bool) -> bool {
        let [asked, known] = [self.asked[0].get() + 1, self.asked[1].get() + u32::from(foreseen)];
        self.asked[0].set(asked);
        self.asked[1].set(known);
        if asked % TRIAL == 0 {
            self.given_up.set(self.worth.is_missed_by(known - self.known.get()));
            self.known.set(known);
        }
        foreseen
    }

    /// Marks where those of the primitives that occlude are drawn, without drawing them: for who draws elsewhere than into `depth`,
    /// which is of the same view.
    pub fn mark(&mut self, depth: &DepthBuffer, scene: &Scene, primitives: &[u32]) {
        depth.mark(primitives.iter().map(|&id| &scene.triangles()[id as usize]), self);
    }

    /// Number of tiles that nothing was drawn into and number of tiles, for reports.
    pub fn empty_tiles(&self) -> [usize; 2] {
        let [columns, rows] = [COLUMNS, ROWS];
        let [width, height] = self.scale.part.map(|[from, end]| end - from);
        let tiles = columns.min(width) * rows.min(height);
        let set: u32 = self.bits.0.as_flattened().iter().map(|word| word.count_ones()).sum();
        [tiles - set as usize, tiles]
    }

    /// The tiles, and whether something was drawn into each, for pictures.
    pub fn tiles(&self) -> impl Iterator<Item = (PixelRect, bool)> + '_ {
        let [width, height] = self.scale.part.map(|[from, end]| end - from);
        let [columns, rows] = [COLUMNS.min(width), ROWS.min(height)];
        let range = |[first, last]: [usize; 2]| [first as u32, last as u32 + 1];
        (0..rows).flat_map(move |row| {
            (0..columns).map(move |column| {
                let tile = PixelRect { x: range(self.scale.columns(column)), y: range(self.scale.rows(row)) };
                (tile, self.bits.0[row][column / 64] >> (column % 64) & 1 == 1)
            })
        })
    }

    /// Whether a box is certainly seen, because nothing was drawn yet in some pixel that it covers.
    pub(crate) fn shows(&self, image: &BoxImage) -> bool {
        let (Some(x), Some(y)) = (self.scale.clip(0, image.x), self.scale.clip(1, image.y)) else { return false };
        let [left, right] = self.scale.tiles(0, x);
        let [top, bottom] = self.scale.tiles(1, y);
        (top..=bottom).any(|row| {
            if self.bits.are_set(row, left, right) {
                return false;
            }
            // One row of pixels speaks for its tiles: what another would add costs as much again.
            let [first, last] = self.scale.rows(usize::from(row));
            let middle = (first.max(y[0]) + last.min(y[1])) / 2;
            let Some(columns) = self.scale.clip(0, image.columns(middle as i32)) else { return false };
            let [first, last] = self.scale.tiles(0, columns);
            // Images of boxes are rounded outward, and a pixel beyond the box itself may show nothing of it: no depth at all.
            self.bits.first_clear(row, first, last).is_some_and(|tile| {
                let column = self.scale.columns(tile)[0].max(columns[0]);
                let [begin, end] = image.columns(middle as i32).map(|at| at as usize);
                image.front(middle, [begin, end]).passing(column - begin, &[0.0]) > 0
            })
        })
    }

    /// Whether a box is certainly seen in its middle: no more than one point of it is looked for in the image.
    #[inline]
    pub(crate) fn shows_middle(&self, depth: &DepthBuffer, aabb: &Aabb) -> bool {
        depth.middle_pixel(aabb).is_some_and(|[x, y]| self.shows_rectangle([[x, x], [y, y]]))
    }

    /// The same for a rectangle: columns and rows, first and last.
    pub(crate) fn shows_rectangle(&self, [x, y]: [[usize; 2]; 2]) -> bool {
        let clip = |axis, range: [usize; 2]| self.scale.clip(axis, range.map(|at| at as i32));
        let (Some(x), Some(y)) = (clip(0, x), clip(1, y)) else { return false };
        let [left, right] = self.scale.tiles(0, x);
        let [top, bottom] = self.scale.tiles(1, y);
        (top..=bottom).any(|row| !self.bits.are_set(row, left, right))
    }

    pub(crate) fn scale(&self) -> &Scale {
        &self.scale
    }

    /// Sets the tiles of the spans that wait.
    #[inline]
    fn set_waiting(&mut self) {
        let Waiting { row, first, last } = self.waiting;
        if first <= last {
            self.bits.set(row, first, last);
        }
    }
}

impl Default for OccupancyMap {
    fn default() -> OccupancyMap {
        OccupancyMap::new()
    }
}

// What is drawn lies within the scene's part of the image, up to rounding: beyond it the nearest tile is marked, since a mark too many
// only has a query asked.
impl Marks for OccupancyMap {
    #[inline]
    fn piece(&mut self, x: [i32; 2], y: [i32; 2]) -> bool {
        if self.scale.is_empty() {
            return false;
        }
        let [left, right] = self.scale.nearest(0, x);
        let [top, bottom] = self.scale.nearest(1, y);
        // A small triangle's rectangle has hardly more tiles than the triangle, and marking takes longer by spans.
        if bottom - top <= 1 && right - left <= 4 {
            (top..=bottom).for_each(|row| self.bits.set(row, left, right));
            return false;
        }
        (top..=bottom).any(|row| !self.bits.are_set(row, left, right))
    }

    #[inline]
    fn span(&mut self, y: i32, first: i32, last: i32) {
        let [row, _] = self.scale.nearest(1, [y, y]);
        let [first, last] = self.scale.nearest(0, [first, last]);
        if row == self.waiting.row {
            self.waiting = Waiting { row, first: self.waiting.first.min(first), last: self.waiting.last.max(last) };
        } else {
            self.set_waiting();
            self.waiting = Waiting { row, first, last };
        }
    }

    #[inline]
    fn end(&mut self) {
        self.set_waiting();
        self.waiting = NOTHING_WAITS;
    }
}

/// Whether a box is seen for certain, before its pixels are asked about: by the map, or, if depths are at hand that a query does not
/// look at in this order itself, by the pixel in the middle and those of the corners (§6.1).
pub(crate) fn is_foreseen(map: &OccupancyMap, depth: &DepthBuffer, few_pixels: bool, image: &BoxImage) -> bool {
    map.shows(image) || (few_pixels && few_pixels_pass(depth, image, CORNER_ROWS))
}

/// A query of fewer rows of pixels costs no more than eight corners; one of a pyramid does.
pub(crate) const CORNER_ROWS: i32 = 16;
pub(crate) const PYRAMID_CORNER_ROWS: i32 = 4;

/// Whether the box may be seen in the pixel in its middle or, if it has so many rows, in that of one of its corners.
pub(crate) fn few_pixels_pass(depth: &DepthBuffer, image: &BoxImage, corner_rows: i32) -> bool {
    let mut z_tests = 0;
    let mut passes = |x: i32, y: i32, [first, last]: [i32; 2]| {
        if !(first..=last).contains(&x) {
            return false;
        }
        z_tests += 1;
        let [first, last, x, y] = [first, last, x, y].map(|at| at as usize);
        image.front(y, [first, last]).passing(x - first, &depth.row(y)[x..=x]) > 0
    };
    // Most of what is seen at all is seen there. The paper's corners come next: an edge may look out from behind something.
    let middle = image.y[0].midpoint(image.y[1]);
    let columns = image.columns(middle);
    let large = image.y[1] - image.y[0] >= corner_rows;
    let seen = passes(columns[0].midpoint(columns[1]), middle, columns)
        || (large && image.corners().any(|[x, y]| passes(x, y, image.columns(y))));
    depth.count_query(z_tests, seen);
    seen
}

#[cfg(test)]
mod tests;
