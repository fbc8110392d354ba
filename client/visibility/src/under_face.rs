//! One square or rectangular image of [`crate::UnderOcclusion`]: for each pixel, how near is it certainly closed?
//!
//! A pixel holds w = 1/z (z along the image's axis), a lower bound over its whole square; 0 is "open". Pixels come in
//! tiles of 8×8. A tile that one polygon covers alone keeps only that polygon's plane, which is most of a wall; only
//! tiles at borders keep 64 numbers. Each tile knows its least w, so that most of a query looks at one number per tile.

// `!(a <= b)` where NaN must count as "no".
#![allow(clippy::neg_cmp_op_on_partial_ord)]

use glam::DVec3;

/// Pixels along a tile's side.
pub(crate) const TILE: usize = 8;

/// Each edge moves inward by this much more than the pixel's own half extent, along x and along y: a bound x = k0 + k1·y
/// by `(1 + |k1|)` times this. It pays for rounding in [`Face::fill`], where a row's bound is `start + k1·j` in f32 with
/// j < 8: where that falls into an image of w pixels, |start| ≤ w + 8·|k1|, and three roundings of 2⁻²⁴ come to less
/// than 2·10⁻⁷·w + 3·10⁻⁶·|k1|, that is a part of this for w ≤ [`SIDE_MAX`].
const INSET_PX: f64 = 1e-3;

/// Images are at most this wide and high.
pub(crate) const SIDE_MAX: usize = 4096;

/// How far a bound between rows is rounded to the nearest one: a part of [`INSET_PX`].
const ROW_SLACK_PX: f64 = 1e-5;

/// Relative slack downward on w, above the rounding of f32 in [`Plane::at`] (under 2.5·10⁻⁷ of the sum of its terms).
const SLACK_W: f64 = 1e-6;

/// A pinhole image: directions `right·x + up·y + forward` meet pixel coordinates `centre + focal·(x, −y)`.
#[derive(Clone, Debug)]
pub(crate) struct Face {
    pub right: DVec3,
    pub up: DVec3,
    pub forward: DVec3,
    /// Which way `forward` points most: 0 to 5 for +x, −x, +y, −y, +z and −z. Only faces of a cube use it.
    pub side: usize,
    /// Pixels per unit of tangent.
    pub focal: f64,
    pub width: usize,
    pub height: usize,
    /// Length of the longest direction (with forward part 1) in the image.
    pub reach: f64,
    tiles_x: usize,
    /// Least w of each tile.
    least: Vec<f32>,
    tiles: Vec<Tile>,
    pixels: Vec<[[f32; TILE]; TILE]>,
    open_tiles: usize,
}

#[derive(Clone, Copy, Debug)]
struct Tile {
    plane: Plane,
    /// An upper bound of w in the tile.
    greatest: f32,
    /// Whether `pixels` is in force, rather than `plane`.
    detailed: bool,
}

/// w at the pixel in column i and row j of a tile is `at + i·dx + j·dy`.
#[derive(Clone, Copy, Debug)]
struct Plane {
    at: f32,
    dx: f32,
    dy: f32,
}

const OPEN: Tile = Tile { plane: Plane { at: 0.0, dx: 0.0, dy: 0.0 }, greatest: 0.0, detailed: false };

impl Plane {
    fn at(&self, i: f32, j: f32) -> f32 {
        self.at + i * self.dx + j * self.dy
    }

    /// The least value at pixels `i0..=i1`, `j0..=j1`: rounding is monotone, so it is at a corner.
    fn least(&self, [i0, i1]: [f32; 2], [j0, j1]: [f32; 2]) -> f32 {
        self.at(if self.dx > 0.0 { i0 } else { i1 }, if self.dy > 0.0 { j0 } else { j1 })
    }

    fn greatest(&self) -> f32 {
        self.at(if self.dx > 0.0 { 7.0 } else { 0.0 }, if self.dy > 0.0 { 7.0 } else { 0.0 })
    }

    /// Whether this is at least `other` everywhere in the tile, rounding between the corners included.
    fn dominates(&self, other: &Plane) -> bool {
        let slack = 1e-6 * (self.at.abs() + 7.0 * (self.dx.abs() + self.dy.abs()));
        [(0.0, 0.0), (7.0, 0.0), (0.0, 7.0), (7.0, 7.0)].iter().all(|&(i, j)| self.at(i, j) >= other.at(i, j) + slack)
    }
}

/// `a·x + b·y + c` at the centre of pixel (x, y).
#[derive(Clone, Copy, Debug)]
pub(crate) struct Linear {
    pub a: f64,
    pub b: f64,
    pub c: f64,
}

impl Linear {
    /// How much it can differ between a pixel's centre and any point of its square.
    pub fn half_pixel(&self) -> f64 {
        (self.a.abs() + self.b.abs()) * 0.5
    }
}

/// The pixels that satisfy a set of linear conditions, as bounds per row.
pub(crate) struct Region {
    width: f64,
    rows: [f64; 2],
    /// Set if a region is known to lie in these columns: then conditions that hold in all of it are left out.
    columns: Option<[f64; 2]>,
    /// Bounds from the left from the front on, bounds from the right from the back on.
    bounds: [(f64, f64); Region::CONDITIONS_MAX],
    left_count: usize,
    right_count: usize,
}

impl Region {
    /// A joint of two polygons of 8 corners: 7 edges and a near limit of each, and two for the band. For eyes in a ball
    /// [`crate::under_region`] joins more, and gives up beyond this.
    const CONDITIONS_MAX: usize = 32;

    /// Every pixel in these rows (inclusive).
    pub fn rows(face: &Face, first: f64, last: f64) -> Region {
        Region {
            // To the end of the last tiles, or these could never be full.
            width: (face.width.div_ceil(TILE) * TILE) as f64,
            rows: [first.max(0.0), last.min((face.height.div_ceil(TILE) * TILE) as f64 - 1.0)],
            columns: None,
            bounds: [(0.0, 0.0); Region::CONDITIONS_MAX],
            left_count: 0,
            right_count: 0,
        }
    }

    /// Every pixel in these columns and rows (inclusive).
    pub fn within(face: &Face, columns: [f64; 2], rows: [f64; 2]) -> Region {
        let mut region = Region::rows(face, rows[0], rows[1]);
        let columns = [columns[0].max(0.0), columns[1].min(region.width - 1.0)];
        region.columns = Some(columns);
        if !(columns[0] <= columns[1]) {
            region.rows[1] = -1.0;
        }
        region.bounds[0] = (columns[0], 0.0);
        region.left_count = 1;
        region.bounds[Region::CONDITIONS_MAX - 1] = (columns[1], 0.0);
        region.right_count = 1;
        region
    }

    /// Like [`Region::add`], for a region made by [`Region::within`].
    pub fn cut(&mut self, linear: Linear, error: f64) {
        self.cut_raw(Linear { c: linear.c - linear.half_pixel() * (1.0 + 2.0 * INSET_PX) - error, ..linear });
    }

    /// Keeps the pixels whose square may reach outside `linear ≥ 0`, give or take a pixel: no more than a saving.
    pub fn cut_to_border(&mut self, linear: Linear, error: f64) {
        self.cut_raw(Linear { a: -linear.a, b: -linear.b, c: linear.half_pixel() * 3.0 + error - linear.c });
    }

    /// Keeps the pixels whose square may reach into `linear ≥ 0`, give or take a pixel: no more than a saving.
    pub fn cut_to_touching(&mut self, linear: Linear, error: f64) {
        self.cut_raw(Linear { c: linear.c + linear.half_pixel() * 3.0 + error, ..linear });
    }

    fn cut_raw(&mut self, linear: Linear) {
        let columns = self.columns.expect("only a region with columns is cut");
        let Linear { a, b, c } = linear;
        let extreme = |least: bool| {
            let x = columns[usize::from((a > 0.0) != least)];
            let y = self.rows[usize::from((b > 0.0) != least)];
            a * x + b * y + c
        };
        if self.is_empty() || extreme(true) >= 0.0 {
            return;
        }
        if !(extreme(false) >= 0.0) || self.left_count + self.right_count == Region::CONDITIONS_MAX {
            self.rows[1] = -1.0;
        } else {
            self.add_raw(linear);
        }
    }

    pub fn is_empty(&self) -> bool {
        // Also true of NaN.
        !(self.rows[0] <= self.rows[1])
    }

    /// Keeps the pixels on whose whole square `n·d` is at least 0 although it may be wrong by `error`.
    pub fn add(&mut self, linear: Linear, error: f64) {
        self.add_raw(Linear { c: linear.c - linear.half_pixel() * (1.0 + 2.0 * INSET_PX) - error, ..linear });
    }

    /// Keeps the pixels whose square may touch the line `linear = 0`: no more than a saving.
    pub fn add_band(&mut self, linear: Linear, error: f64) {
        let reach = linear.half_pixel() * 1.01 + error;
        self.add_raw(Linear { c: linear.c + reach, ..linear });
        self.add_raw(Linear { a: -linear.a, b: -linear.b, c: reach - linear.c });
    }

    /// Keeps the pixels where `a·x + b·y + c ≥ 0`.
    ///
    /// Bounds are x = k0 + k1·y with |k1| ≤ 10⁶. Where such a bound falls into the image |k0| is at most 10⁶·height, so
    /// its rounding is below 10⁻⁵ pixel for up to 4,096 rows; elsewhere it only has to stay outside.
    fn add_raw(&mut self, Linear { a, b, c }: Linear) {
        if a.abs() <= b.abs() * 1e-6 || a == 0.0 {
            // Nearly a row: take its worst column.
            let c = c - a.abs() * self.width;
            if b == 0.0 {
                if !(c >= 0.0) {
                    self.rows[1] = -1.0;
                }
            } else if b > 0.0 {
                self.rows[0] = self.rows[0].max((-c / b - ROW_SLACK_PX).ceil());
            } else {
                self.rows[1] = self.rows[1].min((-c / b + ROW_SLACK_PX).floor());
            }
            return;
        }
        let inverse = 1.0 / a;
        let bound = (-c * inverse, -b * inverse);
        if !(bound.0.is_finite() && bound.1.is_finite()) {
            self.rows[1] = -1.0;
        } else if a > 0.0 {
            self.bounds[self.left_count] = bound;
            self.left_count += 1;
        } else {
            self.right_count += 1;
            self.bounds[Region::CONDITIONS_MAX - self.right_count] = bound;
        }
        debug_assert!(self.left_count + self.right_count <= Region::CONDITIONS_MAX);
    }
}

impl Face {
    /// Bytes that its tiles take.
    pub fn memory_bytes(&self) -> usize {
        self.least.capacity() * size_of::<f32>()
            + self.tiles.capacity() * size_of::<Tile>()
            + self.pixels.capacity() * size_of::<[[f32; TILE]; TILE]>()
    }

    /// An open image. Sizes are rounded up to whole tiles; only `width` × `height` pixels are ever asked about.
    pub fn new([right, up, forward]: [DVec3; 3], focal: f64, width: usize, height: usize) -> Face {
        assert!(width.max(height) <= SIDE_MAX, "an image of {width}x{height} pixels is larger than {SIDE_MAX} a side");
        let (tiles_x, tiles_y) = (width.div_ceil(TILE), height.div_ceil(TILE));
        let axis = forward.abs().max_position();
        let mut face = Face {
            right,
            up,
            forward,
            side: 2 * axis + usize::from(forward[axis] < 0.0),
            focal,
            width,
            height,
            reach: 1.0,
            tiles_x,
            least: vec![0.0; tiles_x * tiles_y],
            tiles: vec![OPEN; tiles_x * tiles_y],
            pixels: vec![[[0.0; TILE]; TILE]; tiles_x * tiles_y],
            open_tiles: tiles_x * tiles_y,
        };
        face.set_focal(focal);
        face
    }

    /// Looks at more or less with as many pixels. What was drawn must be cleared.
    pub fn set_focal(&mut self, focal: f64) {
        let (x, y) = (self.tiles_x as f64 * 4.0 / focal, (self.least.len() / self.tiles_x.max(1)) as f64 * 4.0 / focal);
        self.focal = focal;
        self.reach = (1.0 + 4.0 * (x * x + y * y)).sqrt();
    }

    pub fn clear(&mut self) {
        self.least.fill(0.0);
        self.tiles.fill(OPEN);
        self.open_tiles = self.tiles.len();
    }

    pub fn is_full(&self) -> bool {
        self.open_tiles == 0
    }

    /// The vector in the image's axes.
    pub fn local(&self, v: DVec3) -> DVec3 {
        DVec3::new(self.right.dot(v), self.up.dot(v), self.forward.dot(v))
    }

    pub fn centre_x(&self) -> f64 {
        self.width as f64 * 0.5
    }

    pub fn centre_y(&self) -> f64 {
        self.height as f64 * 0.5
    }

    /// `n·d` over the image, for n in the image's axes and d the direction through a pixel's centre.
    pub fn linear(&self, n: DVec3) -> Linear {
        let (a, b) = (n.x / self.focal, -n.y / self.focal);
        Linear { a, b, c: n.z - a * (self.centre_x() - 0.5) - b * (self.centre_y() - 0.5) }
    }

    /// Covers the pixels of `region` as near as the farthest of these planes (w at pixel centres) over each square.
    pub fn fill<const N: usize>(&mut self, region: &Region, planes: [Linear; N]) {
        if region.is_empty() {
            return;
        }
        let rows = [region.rows[0] as usize, region.rows[1] as usize];
        let planes = planes.map(|w| Linear { c: w.c - w.half_pixel() * (1.0 + 2.0 * INSET_PX), ..w });
        for tile_y in rows[0] / TILE..=rows[1] / TILE {
            // Pixels count from `from` up to and including `to`. Neither becomes a whole number: comparing columns with
            // them does the same, in vectors.
            let top = (tile_y * TILE) as f64;
            let mut from = [0.0_f32; TILE];
            let mut to = [region.width as f32 - 1.0; TILE];
            for &(k0, k1) in &region.bounds[..region.left_count] {
                let (start, step) = ((k0 + k1 * top) as f32, k1 as f32);
                for (j, bound) in from.iter_mut().enumerate() {
                    let x = start + step * j as f32;
                    *bound = if x > *bound { x } else { *bound };
                }
            }
            for &(k0, k1) in &region.bounds[Region::CONDITIONS_MAX - region.right_count..] {
                let (start, step) = ((k0 + k1 * top) as f32, k1 as f32);
                for (j, bound) in to.iter_mut().enumerate() {
                    let x = start + step * j as f32;
                    *bound = if x < *bound { x } else { *bound };
                }
            }
            let (first, last) = ((region.rows[0] - top) as f32, (region.rows[1] - top) as f32);
            for (j, to) in to.iter_mut().enumerate() {
                let row = j as f32;
                *to = if (row >= first) & (row <= last) { *to } else { -1.0 };
            }
            let (mut outer, mut inner) = ([f32::INFINITY, -1.0], [0.0, f32::INFINITY]);
            for (&from, &to) in from.iter().zip(&to) {
                let (first, last) = if from <= to { (from, to) } else { (f32::INFINITY, -1.0) };
                outer = [f32::min(outer[0], first), f32::max(outer[1], last)];
                inner = [f32::max(inner[0], from), f32::min(inner[1], to)];
            }
            if !(outer[0] <= outer[1]) {
                continue;
            }
            for tile_x in outer[0] as usize / TILE..=outer[1] as usize / TILE {
                let column = tile_x * TILE;
                let whole = inner[0] <= column as f32 && inner[1] >= (column + TILE - 1) as f32;
                let planes = planes.map(|w| w.in_tile(column, tile_y * TILE));
                self.fill_tile(tile_y * self.tiles_x + tile_x, column, &from, &to, whole, planes);
            }
        }
    }

    #[inline]
    fn fill_tile<const N: usize>(
        &mut self,
        index: usize,
        column: usize,
        from: &[f32; TILE],
        to: &[f32; TILE],
        whole: bool,
        planes: [Plane; N],
    ) {
        let greatest = planes.iter().map(Plane::greatest).fold(f32::INFINITY, f32::min);
        if !(greatest > self.least[index]) {
            return;
        }
        let tile = &mut self.tiles[index];
        if whole && N == 1 {
            let least = planes[0].least([0.0, 7.0], [0.0, 7.0]);
            let dominates = if tile.detailed { least >= tile.greatest } else { planes[0].dominates(&tile.plane) };
            if dominates {
                *tile = Tile { plane: planes[0], greatest, detailed: false };
                self.raise_least(index, least);
                return;
            }
            if !tile.detailed && tile.plane.dominates(&planes[0]) {
                return;
            }
        }
        let pixels = &mut self.pixels[index];
        if !tile.detailed {
            let plane = tile.plane;
            for (j, row) in pixels.iter_mut().enumerate() {
                for (i, pixel) in row.iter_mut().enumerate() {
                    *pixel = plane.at(i as f32, j as f32);
                }
            }
            tile.detailed = true;
        }
        tile.greatest = tile.greatest.max(greatest);
        let column = column as f32;
        for (j, row) in pixels.iter_mut().enumerate() {
            let (from, to) = (from[j] - column, to[j] - column);
            if !(from <= 7.0 && to >= 0.0 && from <= to) {
                continue;
            }
            for (i, pixel) in row.iter_mut().enumerate() {
                let i = i as f32;
                let mut w = f32::INFINITY;
                for plane in &planes {
                    let other = plane.at(i, j as f32);
                    w = if other < w { other } else { w };
                }
                w = if (i >= from) & (i <= to) { w } else { 0.0 };
                *pixel = if w > *pixel { w } else { *pixel };
            }
        }
        let least = least_of(pixels);
        self.raise_least(index, least);
    }

    fn raise_least(&mut self, index: usize, least: f32) {
        let old = &mut self.least[index];
        self.open_tiles -= usize::from(*old <= 0.0 && least > 0.0);
        *old = old.max(least);
    }

    /// Whether every pixel in columns `x[0]..=x[1]` and rows `y[0]..=y[1]` is closed nearer than 1/w.
    pub fn covers(&self, x: [usize; 2], y: [usize; 2], w: f32) -> bool {
        for tile_y in y[0] / TILE..=y[1] / TILE {
            let rows = tile_y * self.tiles_x;
            for tile_x in x[0] / TILE..=x[1] / TILE {
                if self.least[rows + tile_x] > w {
                    continue;
                }
                let clip = |range: [usize; 2], tile: usize| {
                    [range[0].max(tile * TILE) - tile * TILE, range[1].min(tile * TILE + TILE - 1) - tile * TILE]
                };
                if !self.tile_covers(rows + tile_x, clip(x, tile_x), clip(y, tile_y), w) {
                    return false;
                }
            }
        }
        true
    }

    fn tile_covers(&self, index: usize, i: [usize; 2], j: [usize; 2], w: f32) -> bool {
        let tile = &self.tiles[index];
        if tile.greatest <= w {
            return false;
        }
        if tile.detailed {
            let pixels = &self.pixels[index];
            (j[0]..=j[1]).all(|j| pixels[j][i[0]..=i[1]].iter().all(|&pixel| pixel > w))
        } else {
            tile.plane.least(i.map(|i| i as f32), j.map(|j| j as f32)) > w
        }
    }
}

/// Halves the rows, then the columns: written so that the compiler keeps whole rows in registers.
fn least_of(pixels: &[[f32; TILE]; TILE]) -> f32 {
    let lesser = |a: [f32; TILE], b: [f32; TILE]| -> [f32; TILE] {
        std::array::from_fn(|i| if a[i] < b[i] { a[i] } else { b[i] })
    };
    let [a, b, c, d, e, f, g, h] = *pixels;
    let row = lesser(lesser(lesser(a, b), lesser(c, d)), lesser(lesser(e, f), lesser(g, h)));
    row.into_iter().fold(f32::INFINITY, |least, w| if w < least { w } else { least })
}

impl Linear {
    /// Rounded down so far that evaluating it in f32 cannot exceed it.
    fn in_tile(&self, column: usize, row: usize) -> Plane {
        let at = self.a * column as f64 + self.b * row as f64 + self.c;
        let size = at.abs() + 7.0 * (self.a.abs() + self.b.abs());
        Plane { at: (at - SLACK_W * size) as f32, dx: self.a as f32, dy: self.b as f32 }
    }
}
