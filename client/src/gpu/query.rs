//! Which boxes can be seen past what was drawn? The query back ends on an adapter (Klosowski & Silva 2001, §3; Greene et al. 1993).
//!
//! | kind | as in | passes | read back |
//! |---|---|---|---|
//! | [`GpuQueryKind::ItemBuffer`] | cPLP §3.2 | until one shows no new box | the image |
//! | [`GpuQueryKind::ItemBufferTiled`] | cPLP §3.4 | the same | tiles of it that are not finished |
//! | [`GpuQueryKind::Histogram`] | cPLP §3.3 | as for item buffers | a count per box |
//! | [`GpuQueryKind::OcclusionQueries`] | cPLP §3.1, Staneker §2 | one | a count per box |
//! | [`GpuQueryKind::OneAtATime`] | cPLP §3.1 | one per box | a count |
//! | [`GpuQueryKind::PerFragment`] | cPLP §3.6, proposed there | one | a count per box |
//! | [`GpuQueryKind::ZPyramid`] | Greene et al. | one, without drawing | an answer per box |
//!
//! All but the last draw the same boxes by the same shader with the same depth test, so they give the same answers. The pyramid asks
//! about the rectangle around a box, and hides less.
//!
//! A query is submitted and polled for. [`QueryBackEnd::query`] waits as long as its patience; what is not answered then counts as
//! visible. Errors of the adapter are kept for [`GpuQuery::check`], and everything counts as visible.

use std::sync::Arc;
use std::time::Duration;

use eyeline_visibility::{
    Aabb, DepthBuffer, OccupancyMap, PixelRect, QueryBackEnd, QueryCost, Resolution, Scene, View,
};

use super::boxes::{Drawable, Place};
use super::buffers::{ReadBack, wait};
use super::tiles::Tiles;
use super::ways::Way;
use super::{Gpu, GpuError, GpuImage, GpuQueryKind, GpuScene, GpuStep};

/// What a back end did since it was made.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct GpuQueryStats {
    /// Submissions.
    pub submits: u64,
    /// Boxes drawn or tested, once for each pass that they were in.
    pub boxes: u64,
    /// Boxes that counted as visible because no answer came in time.
    pub unanswered: u64,
    /// Bytes read back.
    pub bytes: u64,
}

/// A query back end on an adapter.
#[derive(Debug)]
pub struct GpuQuery {
    kind: GpuQueryKind,
    image: GpuImage,
    way: Way,
    read_back: ReadBack,
    patience: Option<Duration>,
    fault: Option<GpuError>,
    stats: GpuQueryStats,
    /// Of the query under way: one per box.
    seen: Vec<bool>,
    counts: Vec<u32>,
    /// Boxes of which nothing is known yet, with their places in the query.
    left: Vec<u32>,
    drawables: Vec<Drawable>,
    cost: QueryCost,
    /// Whether the query is about a whole front whose boxes are all drawn, so that it may finish tiles.
    finishes: bool,
    under_way: Option<wgpu::SubmissionIndex>,
}

impl GpuQuery {
    /// A back end without a view yet, that waits for each answer.
    ///
    /// # Errors
    /// If the adapter cannot do it, or has no room for it.
    pub fn new(gpu: Arc<Gpu>, scene: Arc<GpuScene>, kind: GpuQueryKind) -> Result<GpuQuery, GpuError> {
        let image = GpuImage::new(gpu, scene)?;
        let way = Way::new(&image.gpu, &image.camera, kind)?;
        image.gpu.check()?;
        Ok(GpuQuery {
            kind,
            image,
            way,
            read_back: ReadBack::default(),
            patience: None,
            fault: None,
            stats: GpuQueryStats::default(),
            seen: Vec::new(),
            counts: Vec::new(),
            left: Vec::new(),
            drawables: Vec::new(),
            cost: QueryCost::default(),
            finishes: false,
            under_way: None,
        })
    }

    /// The longest that [`QueryBackEnd::query`] waits for a pass; what is not answered then counts as visible. `None`, the
    /// default: as long as it takes, so that the visible set does not depend on the machine's mood.
    pub fn with_patience(self, patience: Option<Duration>) -> GpuQuery {
        GpuQuery { patience, ..self }
    }

    /// How it asks.
    pub fn kind(&self) -> GpuQueryKind {
        self.kind
    }

    /// What it did so far.
    pub fn stats(&self) -> GpuQueryStats {
        self.stats
    }

    /// Fragments of each box of the last query that passed, [`u32::MAX`] of boxes that touch the eye. Of the kinds that count
    /// fragments once, [`GpuQueryKind::OcclusionQueries`] and [`GpuQueryKind::PerFragment`], it bounds the pixels of what is in
    /// the box; a pyramid counts none, and the others only those that no other box covered.
    pub fn counts(&self) -> &[u32] {
        &self.counts
    }

    /// Whether all went well since the last call.
    ///
    /// # Errors
    /// The first thing that went wrong. Everything counted as visible since.
    pub fn check(&mut self) -> Result<(), GpuError> {
        let fault = self.fault.take();
        let own = self.image.gpu.check();
        fault.map_or(own, Err)
    }

    /// Asks which of the boxes can be seen past what was drawn, and does not wait. An earlier query that was not taken is given up.
    pub fn submit(&mut self, cells: &[Aabb]) {
        self.place(cells, false);
        self.go_on();
    }

    /// Starts a query: says which boxes must be drawn.
    fn place(&mut self, cells: &[Aabb], whole_front: bool) {
        self.under_way = None;
        self.cost = QueryCost::default();
        self.seen.clear();
        self.counts.clear();
        self.left.clear();
        self.drawables.clear();
        for (at, cell) in (0..).zip(cells) {
            let place = if self.fault.is_some() { Place::Touching } else { self.image.place(cell) };
            self.seen.push(place == Place::Touching);
            self.counts.push(if place == Place::Touching { u32::MAX } else { 0 });
            if let Place::In(drawable) = place {
                self.left.push(at);
                self.drawables.push(drawable);
            }
        }
        self.way.ask(whole_front);
        // A box that touches the near plane is not drawn: it may be what can be seen in any tile.
        self.finishes = whole_front && self.fault.is_none() && !self.seen.contains(&true);
    }

    /// Makes the next pass if one can show anything; else what no pass showed is hidden.
    fn go_on(&mut self) {
        if !self.left.is_empty() && self.way.is_active() {
            self.pass();
            return;
        }
        self.left.clear();
        if self.finishes {
            self.way.finish();
        }
    }

    /// Looks whether all answers are here, without waiting. A kind that repeats its passes goes on to the next one.
    pub fn poll(&mut self) -> bool {
        if self.under_way.is_some() {
            let polled = self.image.gpu.device.poll(wgpu::PollType::Poll);
            if let Err(error) = self.image.gpu.check() {
                self.fail(error);
            } else if let Err(error) = polled {
                self.fail(self.image.gpu.diagnose(error.to_string()));
            }
            self.look();
        }
        self.under_way.is_none()
    }

    /// The answers, one per box of [`GpuQuery::submit`]: boxes of which none came yet count as visible. Says what it cost.
    pub fn take(&mut self, seen: &mut Vec<bool>) -> QueryCost {
        if self.under_way.take().is_some() {
            self.stats.unanswered += self.left.len() as u64;
            self.left.drain(..).for_each(|at| self.seen[at as usize] = true);
        }
        seen.clear();
        seen.append(&mut self.seen);
        self.cost
    }

    /// Submits and waits, within the patience.
    fn answer(&mut self, cells: &[Aabb], whole_front: bool, seen: &mut Vec<bool>) -> QueryCost {
        if self.kind == GpuQueryKind::OneAtATime && cells.len() > 1 {
            let mut total = QueryCost::default();
            let (mut all, mut counts) = (Vec::with_capacity(cells.len()), Vec::with_capacity(cells.len()));
            for cell in cells {
                total += self.query(std::slice::from_ref(cell), seen);
                all.append(seen);
                counts.append(&mut self.counts);
            }
            (*seen, self.counts) = (all, counts);
            return total;
        }
        self.place(cells, whole_front);
        self.go_on();
        while let Some(submission) = self.under_way.clone() {
            if let Err(error) = wait(&self.image.gpu, &submission, self.patience) {
                self.fail(error);
            }
            let passes = self.cost.passes;
            self.look();
            if self.under_way.is_some() && self.cost.passes == passes {
                break;
            }
        }
        self.take(seen)
    }

    /// Makes one pass about boxes, waits for each part of it before the next, and calls `done` after each, so that a driver can clock
    /// them. Nothing is told of the boxes.
    ///
    /// # Errors
    /// What is wrong with the adapter, or that there is nothing to draw: no box is before the eye.
    pub fn step_by_step(&mut self, cells: &[Aabb], mut done: impl FnMut(GpuStep)) -> Result<QueryCost, GpuError> {
        self.check()?;
        self.place(cells, false);
        let gpu = Arc::clone(&self.image.gpu);
        let (total, label) = (self.drawables.len(), Some(self.kind.name()));
        let refused = |reason: &str| GpuError::Refused { adapter: gpu.name().to_owned(), reason: reason.to_owned() };
        if total == 0 {
            return Err(refused("no box can be drawn"));
        }
        let encoder = || gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor { label });
        let mut drawing = encoder();
        let changed = self.image.encode(&mut drawing)?;
        self.way.draw(&mut drawing, &self.image, changed, &self.drawables)?;
        wait(&gpu, &gpu.queue.submit([drawing.finish()]), None)?;
        done(GpuStep::Draw);
        let mut copying = encoder();
        self.way.collect(&mut copying, &self.image, total, &mut self.read_back)?;
        let submission = gpu.queue.submit([copying.finish()]);
        self.read_back.request();
        wait(&gpu, &submission, None)?;
        let bytes = self.read_back.read(&gpu, <[u8]>::to_vec)?;
        let bytes = bytes.ok_or_else(|| refused("a finished pass could not be read back"))?;
        done(GpuStep::Transfer);
        let mut shown = 0_u64;
        let read_back = self.way.read(&bytes, total, |_, count| shown += u64::from(count));
        std::hint::black_box(shown);
        done(GpuStep::Scan);
        self.left.clear();
        self.stats.submits += 2;
        self.stats.boxes += total as u64;
        self.stats.bytes += bytes.len() as u64;
        Ok(QueryCost { passes: 1, read_back, ..QueryCost::default() })
    }

    /// Everything that is open counts as visible from now on.
    fn fail(&mut self, error: GpuError) {
        // The first says most.
        self.fault.get_or_insert(error);
        self.under_way = None;
        self.finishes = false;
        self.left.clear();
        self.seen.fill(true);
        self.counts.fill(u32::MAX);
    }

    /// Submits what waits to be drawn, and one pass over the boxes that are left.
    fn pass(&mut self) {
        match self.encode() {
            Ok(submission) => {
                self.read_back.request();
                self.under_way = Some(submission);
                self.stats.submits += 1;
                self.stats.boxes += self.left.len() as u64;
                self.cost.passes += 1;
            }
            Err(error) => self.fail(error),
        }
        if let Err(error) = self.image.gpu.check() {
            self.fail(error);
        }
    }

    fn encode(&mut self) -> Result<wgpu::SubmissionIndex, GpuError> {
        let gpu = Arc::clone(&self.image.gpu);
        let descriptor = wgpu::CommandEncoderDescriptor { label: Some(self.kind.name()) };
        let mut encoder = gpu.device.create_command_encoder(&descriptor);
        let changed = self.image.encode(&mut encoder)?;
        self.way.draw(&mut encoder, &self.image, changed, &self.drawables)?;
        self.way.collect(&mut encoder, &self.image, self.drawables.len(), &mut self.read_back)?;
        Ok(gpu.queue.submit([encoder.finish()]))
    }

    /// Takes what was read back, if it is here.
    fn look(&mut self) {
        if self.under_way.is_none() {
            return;
        }
        let (counts, left) = (&mut self.counts, &self.left);
        let add = |at: u32, count: u32| {
            let sum = &mut counts[left[at as usize] as usize];
            *sum = sum.saturating_add(count);
        };
        let way = &mut self.way;
        let read = self.read_back.read(&self.image.gpu, |bytes| (way.read(bytes, left.len(), add), bytes.len()));
        match read {
            Ok(None) => {}
            Err(error) => self.fail(error),
            Ok(Some((values, bytes))) => {
                self.under_way = None;
                self.cost.read_back += values;
                self.stats.bytes += bytes as u64;
                let before = self.left.len();
                let (seen, counts) = (&mut self.seen, &self.counts);
                let mut keep = Vec::with_capacity(before);
                for &at in &self.left {
                    seen[at as usize] |= counts[at as usize] > 0;
                    keep.push(!seen[at as usize]);
                }
                let mut kept = keep.iter();
                self.left.retain(|_| *kept.next().expect("one each"));
                let mut kept = keep.iter();
                self.drawables.retain(|_| *kept.next().expect("one each"));
                if !self.kind.repeats() || self.left.len() == before {
                    self.left.clear();
                }
                self.go_on();
            }
        }
    }
}

impl QueryBackEnd for GpuQuery {
    fn begin(&mut self, view: &View) {
        self.under_way = None;
        let changes = self.image.view().resolution != view.resolution;
        if let Err(error) = self.image.begin(view) {
            self.fail(error);
        }
        let resolution = self.image.depths().map_or(Resolution::new(0, 0), |(resolution, _)| resolution);
        self.way.begin(resolution, changes);
    }

    fn draw(&mut self, scene: &Scene, primitives: &[u32]) {
        debug_assert_eq!(scene.triangles().len(), self.image.scene_len(), "the scene is another one");
        self.image.draw(primitives);
    }

    fn draw_mapped(&mut self, scene: &Scene, primitives: &[u32], map: &mut OccupancyMap) {
        self.draw(scene, primitives);
        map.mark(self.image.known(), scene, primitives);
    }

    fn depth_is_drawn(&self) -> bool {
        false
    }

    fn in_view(&self, aabb: &Aabb) -> bool {
        self.image.place(aabb) != Place::Outside
    }

    /// What it costs is [`QueryCost::passes`] and [`QueryCost::read_back`]: an adapter does not say how many depths it compared.
    fn query(&mut self, cells: &[Aabb], seen: &mut Vec<bool>) -> QueryCost {
        self.answer(cells, false, seen)
    }

    fn query_front(&mut self, cells: &[Aabb], seen: &mut Vec<bool>) -> QueryCost {
        self.answer(cells, true, seen)
    }

    fn finished_tiles(&self) -> Vec<PixelRect> {
        self.way.tiles().map(Tiles::finished).unwrap_or_default()
    }

    fn batch(&self) -> usize {
        if self.kind == GpuQueryKind::OneAtATime { 1 } else { usize::MAX }
    }

    fn is_full(&self) -> bool {
        let view = self.image.view();
        let has_no_pixels = view.check().is_ok() && view.resolution.pixels() == 0;
        has_no_pixels || self.way.tiles().is_some_and(Tiles::are_finished)
    }

    fn depth(&self) -> &DepthBuffer {
        self.image.known()
    }

    fn depth_mut(&mut self) -> &mut DepthBuffer {
        self.image.known_mut()
    }
}
