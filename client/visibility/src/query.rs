//! Which cells of cPLP's front can be seen past what was drawn? Its query back ends, on the CPU (Klosowski & Silva 2001, §3).
//!
//! Each draws the front's boxes against the scene's depths, with coverage and depth rounded outward, and differs in how
//! it learns which boxes had a fragment that passed the depth test:
//!
//! | back end | paper | passes over the image | read back |
//! |---|---|---|---|
//! | [`ItemBufferQuery`] | §3.2, tiles §3.4 | until one shows no new cell | pixels |
//! | [`HistogramQuery`] | §3.3 | the same, at most 255 cells at a time | 256 bins |
//! | [`OneAtATimeQuery`] | §3.1, HP's occlusion test | one per cell | a flag |
//! | [`PerFragmentHistogram`] | §3.6, extrapolated there | one | a counter per cell |
//!
//! On graphics hardware a pass waits for the whole pipeline; on a CPU only the pixels cost.

mod culler;
mod histogram;
mod item_buffer;
mod one_at_a_time;
mod passes;
mod per_fragment;

pub use culler::CplpQueryCuller;
pub use histogram::HistogramQuery;
pub use item_buffer::{ItemBufferQuery, TILE_SIDE};
pub use one_at_a_time::OneAtATimeQuery;
pub(crate) use one_at_a_time::{test, test_ahead};
pub use per_fragment::PerFragmentHistogram;

use crate::raster_sampled::BoxImage;
use crate::{Aabb, DepthBuffer, Occupancy, OccupancyMap, OccupancyQuery, PixelRect, Scene, View};

/// An image of one view, sampled at pixel centres, that holds what was drawn and answers which boxes can be seen past it.
///
/// Answers round outward: a tie is seen, and so is a box that touches the eye or the near plane, without a query.
pub trait QueryBackEnd {
    /// Forgets everything and starts an image of another view.
    fn begin(&mut self, view: &View);

    /// The same, where all that will be drawn lies in the box `scene`.
    fn begin_scene(&mut self, view: &View, scene: &Aabb) {
        let _ = scene;
        self.begin(view);
    }

    /// Draws those of the primitives that occlude.
    fn draw(&mut self, scene: &Scene, primitives: &[u32]) {
        self.depth_mut().draw(scene, primitives);
    }

    /// The same, and marks in `map` where was drawn.
    fn draw_mapped(&mut self, scene: &Scene, primitives: &[u32], map: &mut OccupancyMap) {
        self.depth_mut().draw_marking(scene, primitives, map);
    }

    /// Whether [`QueryBackEnd::depth`] holds what was drawn, so that single pixels of it can be asked about. A back end that draws
    /// elsewhere keeps one there that knows the view alone.
    fn depth_is_drawn(&self) -> bool {
        true
    }

    /// Whether any pixel may show any of the box, whatever was drawn.
    fn in_view(&self, aabb: &Aabb) -> bool {
        self.depth().in_view(aabb)
    }

    /// Finds which of the boxes may be seen past what was drawn, not past each other: `seen` gets one answer per box. Says
    /// what it cost.
    fn query(&mut self, cells: &[Aabb], seen: &mut Vec<bool>) -> QueryCost;

    /// [`QueryBackEnd::query`] for a whole front: no cell that is neither drawn nor in the front can be seen before the
    /// front is projected. So where it shows no cell of the front, the image is finished, and a back end may leave that part
    /// out from then on.
    fn query_front(&mut self, cells: &[Aabb], seen: &mut Vec<bool>) -> QueryCost {
        self.query(cells, seen)
    }

    /// Whether [`QueryBackEnd::foresee`] can tell anything, so that it is worth asking about the cells of a front one by one,
    /// nearest corner first, before any query. Not where [`QueryBackEnd::batch`] is one: [`QueryBackEnd::query_left`] foresees then.
    fn foresees(&self) -> bool {
        false
    }

    /// Whether a box may be seen past what was drawn, if that is known without a query.
    fn foresee(&mut self, cell: &Aabb) -> Option<bool> {
        let _ = cell;
        None
    }

    /// Says in which batch to ask about each of the boxes of a front of which nothing was foreseen. What one batch shows is
    /// drawn before the next is asked.
    fn arrange(&mut self, cells: &[Aabb], batch_of: &mut Vec<u32>) {
        let size = self.batch().max(1);
        batch_of.clear();
        batch_of.extend((0..cells.len()).map(|at| (at / size) as u32));
    }

    /// [`QueryBackEnd::query`] for boxes of which nothing was foreseen; [`QueryBackEnd::query_front`] if that is the whole front.
    fn query_left(&mut self, cells: &[Aabb], whole_front: bool, seen: &mut Vec<bool>) -> QueryCost {
        if whole_front { self.query_front(cells, seen) } else { self.query(cells, seen) }
    }

    /// The same for boxes whose places in [`QueryBackEnd::depth`]'s view were found when nothing could be foreseen of them, so that
    /// these need not be found again.
    fn query_placed(&mut self, boxes: &[PlacedBox], whole_front: bool, seen: &mut Vec<bool>) -> QueryCost {
        let cells: Vec<Aabb> = boxes.iter().map(|placed| placed.aabb).collect();
        self.query_left(&cells, whole_front, seen)
    }

    /// Whether [`QueryBackEnd::query_placed`] ends where it sees a box and looks first where most are seen, so that nobody needs to
    /// look there before.
    fn looks_ahead(&self) -> bool {
        false
    }

    /// The most boxes whose answers come together. With fewer than a front holds, what is found in one batch can be drawn
    /// before the next is asked.
    fn batch(&self) -> usize {
        usize::MAX
    }

    /// Whether nothing more can be seen anywhere.
    fn is_full(&self) -> bool;

    /// The parts of the image that are finished (paper, figure 10), for pictures. Empty for back ends without tiles.
    fn finished_tiles(&self) -> Vec<PixelRect> {
        Vec::new()
    }

    /// Comparisons of depths since [`QueryBackEnd::begin`], drawing and queries.
    fn z_tests(&self) -> u64 {
        self.depth().z_tests()
    }

    /// The part of these that queries took of boxes that turned out to be seen.
    fn seen_z_tests(&self) -> u64 {
        self.depth().seen_z_tests()
    }

    /// Cells of which an occupancy map was asked since [`QueryBackEnd::begin`], and those of which it knew: [`Traversal::mapped`](crate::Traversal).
    fn mapped(&self) -> [usize; 2] {
        [0; 2]
    }

    /// The depths drawn so far: what hides moving things.
    fn depth(&self) -> &DepthBuffer;

    /// The same, to draw into.
    fn depth_mut(&mut self) -> &mut DepthBuffer;
}

/// A box behind the near plane, and where it is in the image of one view.
#[derive(Clone, Copy, Debug)]
pub struct PlacedBox {
    pub(crate) aabb: Aabb,
    pub(crate) image: BoxImage,
}

impl PlacedBox {
    /// The box.
    pub fn aabb(&self) -> &Aabb {
        &self.aabb
    }
}

/// What queries cost.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct QueryCost {
    /// Times that boxes were drawn and the result was waited for.
    pub passes: usize,
    /// Pixels of boxes that were compared with the scene's depths.
    pub z_tests: u64,
    /// Values that a host would read back: pixels of an item buffer, bins of a histogram, flags, counters.
    pub read_back: u64,
}

impl std::ops::AddAssign for QueryCost {
    fn add_assign(&mut self, other: QueryCost) {
        self.passes += other.passes;
        self.z_tests += other.z_tests;
        self.read_back += other.read_back;
    }
}

/// The CPU's query back ends, by name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum QueryKind {
    /// [`ItemBufferQuery`] that scans the whole image.
    ItemBuffer,
    /// [`ItemBufferQuery`] with tiles of [`TILE_SIDE`] pixels.
    ItemBufferTiled,
    /// [`HistogramQuery`].
    Histogram,
    /// [`OneAtATimeQuery`].
    OneAtATime,
    /// [`PerFragmentHistogram`].
    PerFragmentHistogram,
}

impl QueryKind {
    /// All of them.
    pub const ALL: [QueryKind; 5] = [
        QueryKind::ItemBuffer,
        QueryKind::ItemBufferTiled,
        QueryKind::Histogram,
        QueryKind::OneAtATime,
        QueryKind::PerFragmentHistogram,
    ];

    /// Its name in reports and on command lines.
    pub const fn name(self) -> &'static str {
        match self {
            QueryKind::ItemBuffer => "item-buffer",
            QueryKind::ItemBufferTiled => "item-buffer-tiled",
            QueryKind::Histogram => "histogram",
            QueryKind::OneAtATime => "one-at-a-time",
            QueryKind::PerFragmentHistogram => "per-fragment-histogram",
        }
    }

    /// The kind of that name.
    pub fn from_name(name: &str) -> Option<QueryKind> {
        QueryKind::ALL.into_iter().find(|kind| kind.name() == name)
    }

    /// A back end of this kind.
    pub fn back_end(self) -> CpuQuery {
        match self {
            QueryKind::ItemBuffer => CpuQuery::ItemBuffer(ItemBufferQuery::new()),
            QueryKind::ItemBufferTiled => CpuQuery::ItemBuffer(ItemBufferQuery::new().with_tile_side(TILE_SIDE)),
            QueryKind::Histogram => CpuQuery::Histogram(HistogramQuery::new()),
            QueryKind::OneAtATime => CpuQuery::OneAtATime(OneAtATimeQuery::new()),
            QueryKind::PerFragmentHistogram => CpuQuery::PerFragmentHistogram(PerFragmentHistogram::new()),
        }
    }
}

impl std::fmt::Display for QueryKind {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

/// One of the CPU's back ends, chosen at run time by [`QueryKind::back_end`].
#[derive(Clone, Debug)]
pub enum CpuQuery {
    /// With or without tiles.
    ItemBuffer(ItemBufferQuery),
    /// See [`HistogramQuery`].
    Histogram(HistogramQuery),
    /// See [`OneAtATimeQuery`].
    OneAtATime(OneAtATimeQuery),
    /// See [`PerFragmentHistogram`].
    PerFragmentHistogram(PerFragmentHistogram),
    /// One of these behind occupancy maps.
    Occupancy(Box<OccupancyQuery<CpuQuery>>),
}

impl CpuQuery {
    /// The back end behind occupancy maps, or as it is.
    pub fn with_occupancy(self, occupancy: Occupancy) -> CpuQuery {
        match occupancy {
            Occupancy::Off => self,
            _ => CpuQuery::Occupancy(Box::new(OccupancyQuery::new(self, occupancy))),
        }
    }

    fn chosen(&self) -> &dyn QueryBackEnd {
        match self {
            CpuQuery::ItemBuffer(query) => query,
            CpuQuery::Histogram(query) => query,
            CpuQuery::OneAtATime(query) => query,
            CpuQuery::PerFragmentHistogram(query) => query,
            CpuQuery::Occupancy(query) => &**query,
        }
    }

    fn chosen_mut(&mut self) -> &mut dyn QueryBackEnd {
        match self {
            CpuQuery::ItemBuffer(query) => query,
            CpuQuery::Histogram(query) => query,
            CpuQuery::OneAtATime(query) => query,
            CpuQuery::PerFragmentHistogram(query) => query,
            CpuQuery::Occupancy(query) => &mut **query,
        }
    }
}

impl QueryBackEnd for CpuQuery {
    fn begin(&mut self, view: &View) {
        self.chosen_mut().begin(view);
    }

    fn begin_scene(&mut self, view: &View, scene: &Aabb) {
        self.chosen_mut().begin_scene(view, scene);
    }

    fn draw(&mut self, scene: &Scene, primitives: &[u32]) {
        self.chosen_mut().draw(scene, primitives);
    }

    fn query(&mut self, cells: &[Aabb], seen: &mut Vec<bool>) -> QueryCost {
        self.chosen_mut().query(cells, seen)
    }

    fn query_front(&mut self, cells: &[Aabb], seen: &mut Vec<bool>) -> QueryCost {
        self.chosen_mut().query_front(cells, seen)
    }

    fn foresees(&self) -> bool {
        self.chosen().foresees()
    }

    fn foresee(&mut self, cell: &Aabb) -> Option<bool> {
        self.chosen_mut().foresee(cell)
    }

    fn arrange(&mut self, cells: &[Aabb], batch_of: &mut Vec<u32>) {
        self.chosen_mut().arrange(cells, batch_of);
    }

    fn query_left(&mut self, cells: &[Aabb], whole_front: bool, seen: &mut Vec<bool>) -> QueryCost {
        self.chosen_mut().query_left(cells, whole_front, seen)
    }

    fn query_placed(&mut self, boxes: &[PlacedBox], whole_front: bool, seen: &mut Vec<bool>) -> QueryCost {
        self.chosen_mut().query_placed(boxes, whole_front, seen)
    }

    fn looks_ahead(&self) -> bool {
        self.chosen().looks_ahead()
    }

    fn batch(&self) -> usize {
        self.chosen().batch()
    }

    fn is_full(&self) -> bool {
        self.chosen().is_full()
    }

    fn finished_tiles(&self) -> Vec<PixelRect> {
        self.chosen().finished_tiles()
    }

    fn mapped(&self) -> [usize; 2] {
        self.chosen().mapped()
    }

    fn depth(&self) -> &DepthBuffer {
        self.chosen().depth()
    }

    fn depth_mut(&mut self) -> &mut DepthBuffer {
        self.chosen_mut().depth_mut()
    }
}

/// A depth buffer of no view and no pixels, until `begin`.
fn no_depth() -> DepthBuffer {
    DepthBuffer::new(&View::level(glam::DVec3::ZERO, 0.0, 1.0, crate::Resolution::new(0, 0)))
}
