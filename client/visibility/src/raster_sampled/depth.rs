//! Can a box be seen past what was drawn? Depths of occluders, with the farthest one of each tile.

use std::cell::Cell;

use super::PixelRect;
use super::boxes::{BoxImage, BoxPlace};
use super::seal;
use super::setup::{DEPTH_SLACK, Projector, SNAP_PX, ViewPoint};
use crate::{Aabb, Bound, Occlusion, OccupancyMap, Scene, SealedFace, Target, Triangle, View};

/// Side of a tile in pixels.
pub(crate) const TILE: usize = 8;

/// Depths of the occluders of one view, and the farthest of each tile.
///
/// As an [`Occlusion`] it speaks for the view it was made for and its pixel centres only: what it hides, drawn by
/// [`crate::ItemBuffer`] in this very view, wins no pixel. Out of view counts as hidden. Other resolutions and eyes may see it.
/// For a view that [`View::check`] refuses it has no pixels and hides nothing.
#[derive(Clone, Debug)]
pub struct DepthBuffer {
    projector: Projector,
    /// Whether the view makes no sense, so that nothing is known.
    blind: bool,
    /// Rows of `tiles_x` · 8 pixels. Those beyond the image are infinitely near and never seen through.
    depths: Vec<f32>,
    tiles_x: usize,
    /// At most the least (farthest) depth of each tile's pixels. Equal to it unless `stale`.
    farthest: Vec<Cell<f32>>,
    stale: Vec<Cell<bool>>,
    /// Tiles that may have changed since they were asked for: first and last column, first and last row.
    drawn: [usize; 4],
    z_tests: Cell<u64>,
    /// Those that queries took whose answer was "seen".
    seen_z_tests: Cell<u64>,
}

/// Is told where something is drawn.
pub(crate) trait Marks {
    /// A piece of a triangle is drawn, within these columns and rows, first and last. Whether its spans are wanted.
    fn piece(&mut self, x: [i32; 2], y: [i32; 2]) -> bool;
    /// The columns of a row, first to last. Rows come from the top down.
    fn span(&mut self, y: i32, first: i32, last: i32);
    /// Those were all spans of the piece.
    fn end(&mut self);
}

impl Marks for () {
    fn piece(&mut self, _: [i32; 2], _: [i32; 2]) -> bool {
        false
    }

    fn span(&mut self, _: i32, _: i32, _: i32) {}

    fn end(&mut self) {}
}

/// Radius of a disc that holds the centre of the pixel in which its middle is, with room for rounding.
const MIDDLE_PX: f64 = 0.75;

/// No tile.
const NO_TILES: [usize; 4] = [usize::MAX, 0, usize::MAX, 0];

impl DepthBuffer {
    /// An empty image of a view.
    pub fn new(view: &View) -> DepthBuffer {
        let mut buffer = DepthBuffer {
            projector: Projector::new(&view.or_without_pixels()),
            blind: false,
            depths: Vec::new(),
            tiles_x: 0,
            farthest: Vec::new(),
            stale: Vec::new(),
            drawn: NO_TILES,
            z_tests: Cell::new(0),
            seen_z_tests: Cell::new(0),
        };
        buffer.begin(view);
        buffer
    }

    /// Forgets everything and starts an image of another view.
    pub fn begin(&mut self, view: &View) {
        self.blind = view.check().is_err();
        let view = &view.or_without_pixels();
        self.projector = Projector::new(view);
        let (width, height) = (view.resolution.width as usize, view.resolution.height as usize);
        self.tiles_x = width.div_ceil(TILE);
        let tiles_y = height.div_ceil(TILE);
        let stride = self.tiles_x * TILE;
        self.depths.clear();
        self.depths.resize(stride * height, 0.0);
        if stride != width {
            for row in self.depths.chunks_exact_mut(stride) {
                row[width..].fill(f32::INFINITY);
            }
        }
        self.depths.resize(stride * tiles_y * TILE, f32::INFINITY);
        self.farthest.clear();
        self.farthest.resize(self.tiles_x * tiles_y, Cell::new(0.0));
        self.stale.clear();
        self.stale.resize(self.tiles_x * tiles_y, Cell::new(false));
        self.drawn = NO_TILES;
        self.z_tests.set(0);
        self.seen_z_tests.set(0);
    }

    /// Comparisons of depths since the last `begin`, as the papers count depth complexity (Klosowski & Silva 2001, §4): one
    /// for each pixel centre that a triangle covers, whether it wins or not, and one for each pixel or tile that a query
    /// looks at.
    pub fn z_tests(&self) -> u64 {
        self.z_tests.get()
    }

    /// The part of [`DepthBuffer::z_tests`] that queries took of boxes that turned out to be seen: what an occupancy map is to
    /// spare (Staneker et al. 2003, table 2). Tiles that were looked at count like pixels.
    pub fn seen_z_tests(&self) -> u64 {
        self.seen_z_tests.get()
    }

    /// The target that draws primitives of `scene` into this image.
    pub fn target<'a>(&'a mut self, scene: &'a Scene) -> SampledTarget<'a> {
        SampledTarget { scene, buffer: self }
    }

    /// Draws those of the primitives that occlude.
    pub fn draw(&mut self, scene: &Scene, primitives: &[u32]) {
        self.draw_marking(scene, primitives, &mut ());
    }

    /// The same, and `marks` is told where.
    pub(crate) fn draw_marking(&mut self, scene: &Scene, primitives: &[u32], marks: &mut impl Marks) {
        self.draw_triangles_marking(primitives.iter().map(|&id| &scene.triangles()[id as usize]), marks);
    }

    /// Draws those of the triangles that occlude, of a scene or not. Corners are finite, as a scene's are.
    pub(crate) fn draw_triangles<'a>(&mut self, triangles: impl IntoIterator<Item = &'a Triangle>) {
        self.draw_triangles_marking(triangles, &mut ());
    }

    /// The same, and `marks` is told where.
    pub(crate) fn draw_triangles_marking<'a>(
        &mut self,
        triangles: impl IntoIterator<Item = &'a Triangle>,
        marks: &mut impl Marks,
    ) {
        let stride = self.tiles_x * TILE;
        let (depths, stale, tiles_x) = (&mut self.depths, &self.stale, self.tiles_x);
        let last_row = self.projector.height - 1;
        let drawn = &mut self.drawn;
        let mut z_tests = 0;
        for triangle in triangles {
            if !triangle.occludes {
                continue;
            }
            self.projector.pieces(triangle.corners.map(|corner| corner.as_dvec3()), triangle.sides, |piece| {
                let [from, to] = piece.x.map(|x| x as usize / TILE);
                let [top, bottom] = piece.y.map(|y| y as usize / TILE);
                *drawn = [drawn[0].min(from), drawn[1].max(to), drawn[2].min(top), drawn[3].max(bottom)];
                for tile_y in top..=bottom {
                    stale[tile_y * tiles_x + from..=tile_y * tiles_x + to].iter().for_each(|stale| stale.set(true));
                }
                let by_span = marks.piece(piece.x, piece.y);
                piece.spans([0, last_row], |y, first, last, ramp| {
                    if by_span {
                        marks.span(y, first, last);
                    }
                    let row = y as usize * stride;
                    ramp.draw_depths(0, &mut depths[row + first as usize..=row + last as usize]);
                    z_tests += (last - first + 1) as u64;
                });
                if by_span {
                    marks.end();
                }
            });
        }
        self.z_tests.set(self.z_tests.get() + z_tests);
    }

    /// Tells `marks` where those of the triangles that occlude would be drawn.
    pub(crate) fn mark<'a>(&self, triangles: impl IntoIterator<Item = &'a Triangle>, marks: &mut impl Marks) {
        let last_row = self.projector.height - 1;
        for triangle in triangles.into_iter().filter(|triangle| triangle.occludes) {
            self.projector.pieces(triangle.corners.map(|corner| corner.as_dvec3()), triangle.sides, |piece| {
                if marks.piece(piece.x, piece.y) {
                    piece.spans([0, last_row], |y, first, last, _| marks.span(y, first, last));
                    marks.end();
                }
            });
        }
    }

    /// Where a box is in the image, whatever was drawn: what a back end that draws elsewhere may ask before it draws the box.
    pub fn box_on_image(&self, aabb: &Aabb) -> BoxOnImage {
        match self.place(aabb) {
            Place::Outside => BoxOnImage::Outside,
            Place::Touching => BoxOnImage::Touching,
            Place::In { x, y, z } => {
                let range = |[first, last]: [usize; 2]| [first as u32, last as u32 + 1];
                BoxOnImage::In { rect: PixelRect { x: range(x), y: range(y) }, z }
            }
        }
    }

    /// Whether any pixel centre may see any of the box, whatever was drawn.
    pub(crate) fn in_view(&self, aabb: &Aabb) -> bool {
        !matches!(self.place(aabb), Place::Outside)
    }

    /// What the image can say about a box before it looks at depths.
    pub(super) fn place(&self, aabb: &Aabb) -> Place {
        let projector = &self.projector;
        // Of a box that is not finite nothing is known. No cell is like this.
        let is_finite = aabb.min.is_finite() && aabb.max.is_finite();
        if self.blind || !is_finite || aabb.contains(projector.eye()) {
            return Place::Touching;
        }
        let points = aabb.corners().map(|corner| projector.view_point(corner));
        let mut w = [f64::INFINITY, f64::NEG_INFINITY];
        let mut size = 0.0_f64;
        for p in &points {
            w = [w[0].min(p.w), w[1].max(p.w)];
            size = size.max(p.x.abs() + p.y.abs() + p.w.abs());
        }
        // Rounding of the transform, which cancels where a far corner lies beside the eye.
        let slack = size * 1e-12;
        if w[1] < -slack {
            return Place::Outside;
        }
        let nearest = w[0] - slack;
        if nearest <= projector.near {
            return if projector.outside(&points, slack) { Place::Outside } else { Place::Touching };
        }
        let mut x = [f64::INFINITY, f64::NEG_INFINITY];
        let mut y = x;
        for &ViewPoint { x: right, y: up, w } in &points {
            let per_metre = projector.focal_px / w;
            let (column, row) = (projector.middle[0] + right * per_metre, projector.middle[1] - up * per_metre);
            x = [x[0].min(column), x[1].max(column)];
            y = [y[0].min(row), y[1].max(row)];
        }
        let spread = 2.0 * SNAP_PX + slack / nearest * projector.focal_px;
        let [x, y] = [(x, projector.width), (y, projector.height)].map(|(range, size)| centres(range, spread, size));
        if x[0] > x[1] || y[0] > y[1] {
            return Place::Outside;
        }
        let z = (projector.near / nearest * (1.0 + 2.0 * DEPTH_SLACK)) as f32;
        Place::In { x: x.map(|x| x as usize), y: y.map(|y| y as usize), z }
    }

    /// The pixel of the middle of a box, if its centre certainly shows the box as long as nothing was drawn there. Around the middle a disc
    /// that faces the eye lies in the box, as wide as the box is thick; the pixel's centre is at most 0.71 px from the disc's.
    pub(crate) fn middle_pixel(&self, aabb: &Aabb) -> Option<[usize; 2]> {
        let projector = &self.projector;
        let ViewPoint { x: right, y: up, w } = projector.view_point(aabb.centre());
        let per_metre = projector.focal_px / w;
        let is_wide = w > projector.near && aabb.size().min_element() * 0.5 * per_metre > MIDDLE_PX;
        let (x, y) = (projector.middle[0] + right * per_metre, projector.middle[1] - up * per_metre);
        let is_inside = x >= 0.0 && x < f64::from(projector.width) && y >= 0.0 && y < f64::from(projector.height);
        (is_wide && is_inside && !self.blind).then_some([x as usize, y as usize])
    }

    /// Whether a sealed face hides what is beyond it: see `seal.rs`.
    pub(crate) fn believes(&self, seal: &SealedFace<'_>) -> bool {
        !self.blind && seal::holds(&self.projector, seal, |x, y| self.depths[y * self.tiles_x * TILE + x])
    }

    pub(crate) fn sees(&self, aabb: &Aabb) -> bool {
        match self.place(aabb) {
            Place::Outside => false,
            Place::Touching => true,
            Place::In { x, y, z } => self.sees_rectangle(x, y, z),
        }
    }

    /// [`DepthBuffer::sees`] for a box of which a map may know that it is.
    pub(crate) fn sees_past(&self, map: &OccupancyMap, aabb: &Aabb) -> bool {
        if map.shows_middle(self, aabb) {
            return map.count(true);
        }
        match self.place(aabb) {
            Place::Outside => false,
            Place::Touching => true,
            Place::In { x, y, z } => {
                map.count(map.shows_rectangle([x, y]) || self.sees_in_few_pixels(x, y, z))
                    || self.sees_rectangle(x, y, z)
            }
        }
    }

    /// Whether the middle of a rectangle or, if it is one of several tiles, one of its corners is no nearer than `z`: a few
    /// pixels, where tiles have 64 each.
    fn sees_in_few_pixels(&self, x: [usize; 2], y: [usize; 2], z: f32) -> bool {
        let middle = [x[0].midpoint(x[1]), y[0].midpoint(y[1])];
        let pixels = [middle, [x[0], y[0]], [x[1], y[0]], [x[0], y[1]], [x[1], y[1]]];
        let large = y[1] - y[0] >= TILE && x[1] - x[0] >= TILE;
        let pixels = &pixels[..if large { pixels.len() } else { 1 }];
        let nearer = pixels.iter().take_while(|[x, y]| self.depths[y * self.tiles_x * TILE + x] > z).count();
        self.count_query(pixels.len().min(nearer + 1), nearer < pixels.len());
        nearer < pixels.len()
    }

    /// Whether any pixel of a rectangle is no nearer than `z`.
    fn sees_rectangle(&self, x: [usize; 2], y: [usize; 2], z: f32) -> bool {
        let before = self.z_tests.get();
        let seen = (y[0] / TILE..=y[1] / TILE).any(|tile_y| {
            let tiles = tile_y * self.tiles_x + x[0] / TILE..=tile_y * self.tiles_x + x[1] / TILE;
            let mut tile_x = x[0] / TILE;
            let seen = self.farthest[tiles].iter().any(|farthest| {
                let seen = farthest.get() <= z && self.sees_in_tile(tile_x, tile_y, x, y, z);
                tile_x += 1;
                seen
            });
            self.count_z_tests(tile_x - x[0] / TILE);
            seen
        });
        self.count_seen(before, seen);
        seen
    }

    /// Whether any pixel of the tile in the rectangle is no nearer than `z`.
    #[inline(never)]
    fn sees_in_tile(&self, tile_x: usize, tile_y: usize, x: [usize; 2], y: [usize; 2], z: f32) -> bool {
        let stride = self.tiles_x * TILE;
        if self.tile_farthest(tile_x, tile_y) > z {
            return false;
        }
        let [x0, x1] = [x[0].max(tile_x * TILE), x[1].min(tile_x * TILE + TILE - 1)];
        let [y0, y1] = [y[0].max(tile_y * TILE), y[1].min(tile_y * TILE + TILE - 1)];
        (y0..=y1).any(|y| {
            self.count_z_tests(x1 + 1 - x0);
            self.depths[y * stride + x0..=y * stride + x1].iter().any(|&depth| depth <= z)
        })
    }

    pub(crate) fn count_z_tests(&self, count: usize) {
        self.z_tests.set(self.z_tests.get() + count as u64);
    }

    /// Counts the pixels of a query with its answer.
    pub(crate) fn count_query(&self, z_tests: usize, seen: bool) {
        let before = self.z_tests.get();
        self.count_z_tests(z_tests);
        self.count_seen(before, seen);
    }

    /// Counts what was compared since there were `before` comparisons as a query's that said "seen", if it did.
    pub(crate) fn count_seen(&self, before: u64, seen: bool) {
        let since = if seen { self.z_tests.get() - before } else { 0 };
        self.seen_z_tests.set(self.seen_z_tests.get() + since);
    }

    /// The farthest depth of a tile, found again if it was drawn into.
    #[inline]
    pub(crate) fn tile_farthest(&self, tile_x: usize, tile_y: usize) -> f32 {
        let stride = self.tiles_x * TILE;
        let tile = tile_y * self.tiles_x + tile_x;
        let at = tile_y * TILE * stride + tile_x * TILE;
        if self.stale[tile].replace(false) {
            let mut least = [f32::INFINITY; TILE];
            for row in 0..TILE {
                let row = &self.depths[at + row * stride..][..TILE];
                for (least, &depth) in least.iter_mut().zip(row) {
                    *least = if depth < *least { depth } else { *least };
                }
            }
            self.farthest[tile].set(least.into_iter().fold(f32::INFINITY, f32::min));
        }
        self.farthest[tile].get()
    }

    /// Whether nothing can be seen in it, for want of pixels.
    pub(crate) fn has_no_pixels(&self) -> bool {
        self.depths.is_empty() && !self.blind
    }

    /// Columns and rows of tiles of [`TILE`]² pixels.
    pub(crate) fn tiles(&self) -> [usize; 2] {
        [self.tiles_x, self.farthest.len() / self.tiles_x.max(1)]
    }

    /// Tiles that may have changed since this was last asked: first and last column, first and last row.
    pub(crate) fn take_drawn_tiles(&mut self) -> Option<[usize; 4]> {
        let drawn = std::mem::replace(&mut self.drawn, NO_TILES);
        (drawn != NO_TILES).then_some(drawn)
    }

    /// The depths of a row of pixels, and some beyond the image.
    pub(crate) fn row(&self, y: usize) -> &[f32] {
        let stride = self.tiles_x * TILE;
        &self.depths[y * stride..(y + 1) * stride]
    }

    /// Columns and rows of pixels.
    pub(crate) fn size(&self) -> [usize; 2] {
        [self.projector.width, self.projector.height].map(|size| size as usize)
    }

    /// The rectangle that holds every pixel that may show any of a box.
    pub(crate) fn rectangle(&self, aabb: &Aabb) -> BoxPlace<BoxRectangle> {
        match self.place(aabb) {
            Place::Outside => BoxPlace::Outside,
            Place::Touching => BoxPlace::Touching,
            Place::In { x, y, z } => BoxPlace::In(BoxRectangle { x: x.map(|x| x as u16), y: y.map(|y| y as u16), z }),
        }
    }

    /// The image of a box whose rectangle is known.
    pub(crate) fn box_image(&self, aabb: &Aabb, rectangle: BoxRectangle) -> BoxImage {
        BoxImage::new(&self.projector, aabb, rectangle.x(), rectangle.y(), rectangle.z)
    }

    /// What an image with everything rounded outward shows of a box.
    pub(crate) fn box_place(&self, aabb: &Aabb) -> BoxPlace {
        match self.place(aabb) {
            Place::Outside => BoxPlace::Outside,
            Place::Touching => BoxPlace::Touching,
            Place::In { x, y, z } => BoxPlace::In(BoxImage::new(&self.projector, aabb, x, y, z)),
        }
    }
}

/// The first and last pixel of `size` whose centre lies in `range` widened by `spread`; descending if there is none.
fn centres(range: [f64; 2], spread: f64, size: i32) -> [i32; 2] {
    let size = f64::from(size);
    // Relative rounding of coordinates far outside the image does not matter after clamping.
    let low = (range[0] - spread - 0.5).clamp(0.0, size);
    let high = (range[1] + spread - 0.5).clamp(-1.0, size - 1.0);
    let [from, to] = [low as i32, high as i32];
    [from + i32::from(f64::from(from) < low), to - i32::from(f64::from(to) > high)]
}

/// Columns and rows of pixels, first and last, that may show a box, which is no nearer than a reversed depth.
#[derive(Clone, Copy, Debug)]
pub(crate) struct BoxRectangle {
    /// Images are at most 65,536 pixels wide and high ([`View::check`]): many rectangles are kept, and looked up out of order.
    x: [u16; 2],
    y: [u16; 2],
    z: f32,
}

impl BoxRectangle {
    pub(crate) fn x(&self) -> [usize; 2] {
        self.x.map(usize::from)
    }

    pub(crate) fn y(&self) -> [usize; 2] {
        self.y.map(usize::from)
    }
}

/// Where a box is in an image, rounded outward: see [`DepthBuffer::box_on_image`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum BoxOnImage {
    /// No pixel centre sees any of it.
    Outside,
    /// It touches the eye or the near plane and may be in view, or nothing is known of it: it counts as seen without a query.
    Touching,
    /// It is behind the near plane.
    In {
        /// The pixels that may show it; at least one.
        rect: PixelRect,
        /// No reversed depth (near / distance) of it is greater.
        z: f32,
    },
}

/// Where a box is.
pub(super) enum Place {
    /// No pixel centre sees any of it.
    Outside,
    /// It touches the eye or the near plane and may be in view.
    Touching,
    /// It is behind the near plane, and meets these columns and rows (first and last) no nearer than this reversed depth.
    In { x: [usize; 2], y: [usize; 2], z: f32 },
}

impl Occlusion for DepthBuffer {
    fn hides(&self, bound: &Bound) -> bool {
        bound.aabb().is_some_and(|aabb| !self.sees(&aabb))
    }
}

/// A [`DepthBuffer`] with the scene whose primitives are drawn into it.
#[derive(Debug)]
pub struct SampledTarget<'a> {
    scene: &'a Scene,
    buffer: &'a mut DepthBuffer,
}

impl Target for SampledTarget<'_> {
    fn draw(&mut self, primitives: &[u32]) {
        self.buffer.draw(self.scene, primitives);
    }

    fn sees(&self, aabb: &Aabb) -> bool {
        self.buffer.sees(aabb)
    }

    fn in_view(&self, aabb: &Aabb) -> bool {
        self.buffer.in_view(aabb)
    }

    fn believes(&self, seal: &SealedFace<'_>) -> bool {
        self.buffer.believes(seal)
    }

    /// Only an image without pixels is: what is covered may still be covered by something nearer.
    fn is_full(&self) -> bool {
        self.buffer.has_no_pixels()
    }
}

/// A [`SampledTarget`] with a map of where it drew.
pub(crate) struct MappedTarget<'a> {
    pub(crate) target: SampledTarget<'a>,
    pub(crate) map: &'a mut OccupancyMap,
}

impl Target for MappedTarget<'_> {
    fn draw(&mut self, primitives: &[u32]) {
        if self.map.is_given_up() {
            self.target.draw(primitives);
        } else {
            self.target.buffer.draw_marking(self.target.scene, primitives, self.map);
        }
    }

    fn sees(&self, aabb: &Aabb) -> bool {
        if self.map.is_given_up() { self.target.sees(aabb) } else { self.target.buffer.sees_past(self.map, aabb) }
    }

    fn in_view(&self, aabb: &Aabb) -> bool {
        self.target.in_view(aabb)
    }

    fn believes(&self, seal: &SealedFace<'_>) -> bool {
        self.target.believes(seal)
    }

    fn is_full(&self) -> bool {
        self.target.is_full()
    }
}
