//! How did a culler do over all views? One culler on one view, against truth and the clock, and the row that sums it up.

// This is a driver: it may read the clock.
#![expect(clippy::disallowed_methods)]

use std::cell::OnceCell;
use std::hint::black_box;
use std::time::Instant;

use eyeline_visibility::{
    Bound, Culled, DynamicIndex, DynamicOctree, EyeRegion, ItemBuffer, RayScene, Resolution, View, image_ray,
};
use glam::DVec3;

use super::candidate::Candidate;
use super::fragments::Fragments;
use super::frames::{Frame, FrameRow, frame_rows};
use super::max_pass::MaxPass;
use super::registry::Setting;
use super::row::CullRow;
use super::run::{CullConfig, millis};
use super::truth::{Truth, draw_objects};
use super::world::World;

/// The rasteriser moves corners by half of this at most, along each axis.
const SNAP_PX: f64 = 1.0 / 256.0;

/// One culler on one view.
pub(super) struct Try<'a> {
    pub(super) world: &'a World,
    pub(super) view: &'a View,
    pub(super) radius: f64,
    pub(super) truth: &'a Truth,
    /// For a culler that promises rays; made when first needed.
    pub(super) rays: Option<&'a OnceCell<RayScene>>,
}

impl Try<'_> {
    /// Whether a primitive owns pixels only where no ray through them, or just beside their centres, meets it first.
    fn shows_in_cracks_only(&self, id: u32) -> bool {
        let Some(rays) = self.rays else { return false };
        if id as usize >= self.world.scene.triangles().len() {
            return false;
        }
        let rays = rays.get_or_init(|| RayScene::new(&self.world.scene));
        let width = self.view.resolution.width as usize;
        let mut hits = Vec::new();
        for (items, &eye) in self.truth.items.iter().zip(&self.truth.eyes) {
            for (pixel, _) in items.ids().iter().enumerate().filter(|(_, winner)| **winner == id) {
                let (x, y) = ((pixel % width) as f64 + 0.5, (pixel / width) as f64 + 0.5);
                for (right, down) in [(0.0, 0.0), (-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)] {
                    let ray = image_ray(self.view, x + right * SNAP_PX, y + down * SNAP_PX);
                    hits.clear();
                    rays.near_hits(eye, ray, self.view.near, f64::INFINITY, 1e-5, &mut hits);
                    if hits.iter().any(|hit| hit.primitive == id) {
                        return false;
                    }
                }
            }
        }
        true
    }

    pub(super) fn one(&self, number: usize, candidate: &mut dyn Candidate, tally: &mut Tally) {
        let Try { world, view, radius, truth, .. } = *self;
        let static_count = world.scene.triangles().len() as u32;
        if tally.index.is_none() && !world.object_boxes.is_empty() {
            tally.index = Some(index_of(world));
        }
        let region = EyeRegion { centre: view.eye, radius };
        let culled = candidate.cull(view, region);
        let mut exposed = Vec::new();
        if let Some(index) = &tally.index {
            index.exposed(candidate.occlusion(), &mut exposed);
        }
        // Drawn, not only compared by set: what is reported must make the picture.
        let mut items = ItemBuffer::new(view);
        let began = Instant::now();
        items.draw(&world.scene, &culled.visible);
        draw_objects(world, &mut items, exposed.iter().copied());
        tally.draw_ms += millis(began);
        let mut wrong =
            items.ids().iter().zip(truth.items[0].ids()).filter(|(here, there)| here != there).count() as u64;

        let is_lost = |id: u32| match id.checked_sub(static_count) {
            None => culled.visible.binary_search(&id).is_err(),
            Some(object) => exposed.binary_search(&object).is_err(),
        };
        let mut lost: Vec<u32> = truth.winners.iter().copied().filter(|&id| is_lost(id)).collect();
        if let Some([whole, drawn]) = candidate.own_pictures(view, &culled.visible) {
            let mut own_lost: Vec<u32> =
                whole.iter().copied().filter(|id| *id < static_count && is_lost(*id)).collect();
            own_lost.sort_unstable();
            own_lost.dedup();
            own_lost.extend(lost.iter().copied().filter(|id| *id >= static_count));
            tally.cracks += lost.iter().filter(|id| own_lost.binary_search(id).is_err()).count() as u64;
            lost = own_lost;
            wrong = whole.iter().zip(&drawn).filter(|(whole, drawn)| whole != drawn).count() as u64;
        } else {
            let cracks: Vec<u32> = lost.iter().copied().filter(|&id| self.shows_in_cracks_only(id)).collect();
            lost.retain(|id| !cracks.contains(id));
            wrong -= truth.items[0].ids().iter().filter(|id| cracks.contains(id)).count() as u64;
            tally.cracks += cracks.len() as u64;
        }
        if !lost.is_empty() {
            // From the other eyes of a ball a pixel is wrong if its winner was lost: drawing less changes no other winner.
            for other in &truth.items[1..] {
                let red = other.ids().iter().filter(|id| lost.binary_search(id).is_ok()).count() as u64;
                wrong = wrong.max(red);
            }
        }
        let fragments = Fragments::new(view);
        let own = candidate.z_tests();
        let triangles = world.scene.triangles();
        let drawn = || culled.visible.iter().map(|&id| fragments.of(&triangles[id as usize], DVec3::ZERO)).sum();
        let mut z_tests: u64 = own.unwrap_or_else(drawn);
        for &object in &exposed {
            let mesh = &world.scene.objects()[object as usize];
            z_tests += mesh.triangles.iter().map(|triangle| fragments.of(triangle, mesh.origin)).sum::<u64>();
        }
        // A view without triangles takes no tests either way.
        tally.query_z_tests_counted |= own.is_some();

        if tally.worst.is_none_or(|(most, _)| wrong > most) {
            tally.worst = Some((wrong, number));
        }
        let shown: Vec<u32> = truth.winners.iter().copied().filter(|id| lost.binary_search(id).is_err()).collect();
        let lost_share = lost.len() as f64 / truth.winners.len().max(1) as f64;
        tally.found_share += 1.0 - lost_share;
        tally.lost_share_most = tally.lost_share_most.max(lost_share);
        let drawn_churn = (!tally.views.is_empty()).then(|| new_share(&culled.visible, &tally.drawn));
        if let Some(drawn_churn) = drawn_churn {
            tally.churn += new_share(&shown, &tally.shown);
            tally.drawn_churn.push(drawn_churn);
        }
        tally.views.push(Frame {
            exact: truth.winners.len(),
            found: shown.len(),
            wrong_pixels: wrong,
            kept: culled.visible.len(),
            drawn_churn,
        });
        tally.shown = shown;
        tally.drawn.clone_from(&culled.visible);
        if let Some(budget) = candidate.budget() {
            tally.budget += budget as u64;
            tally.budgets += 1;
        }
        tally.pixels += view.resolution.pixels() as u64;
        tally.wrong_max = tally.wrong_max.max(wrong);
        tally.wrong += wrong;
        tally.lost += lost.len() as u64;
        tally.objects_lost += lost.iter().filter(|id| **id >= static_count).count() as u64;
        tally.winners += truth.winners.len() as u64;
        let objects_exact = truth.winners.iter().filter(|id| **id >= static_count).count() as u64;
        tally.exact += truth.winners.len() as u64 - objects_exact;
        tally.objects_exact += objects_exact;
        tally.objects_kept += exposed.len() as u64;
        tally.objects_rectangle = truth.rectangle.map(|kept| tally.objects_rectangle.unwrap_or(0) + kept);
        tally.z_tests += z_tests;
        tally.count(&culled);
        tally.read_back_bytes = candidate.read_back_bytes().map(|bytes| tally.read_back_bytes.unwrap_or(0) + bytes);
    }
}

pub(super) fn index_of(world: &World) -> DynamicOctree {
    let mut index = DynamicOctree::new(world.scene.bounds());
    for (key, aabb) in (0..).zip(&world.object_boxes) {
        index.insert(key, Bound::Box(*aabb));
    }
    index
}

/// What a culler did, summed over views.
#[derive(Default)]
pub(super) struct Tally {
    index: Option<DynamicOctree>,
    views: Vec<Frame>,
    pixels: u64,
    wrong: u64,
    wrong_max: u64,
    /// Most wrong pixels, and the first view that had them.
    pub(super) worst: Option<(u64, usize)>,
    lost: u64,
    objects_lost: u64,
    cracks: u64,
    winners: u64,
    /// ε_k of the views, summed, and the most that a view lost.
    found_share: f64,
    lost_share_most: f64,
    /// What the last view showed of its exact set, and the shares of it that were new, summed.
    shown: Vec<u32>,
    churn: f64,
    /// What the last view drew, and the shares of it that were new, view by view.
    drawn: Vec<u32>,
    drawn_churn: Vec<f64>,
    /// Budgets of the views, summed, and how many views had one.
    budget: u64,
    budgets: u64,
    exact: u64,
    kept: u64,
    objects_exact: u64,
    objects_kept: u64,
    objects_rectangle: Option<u64>,
    rounds: u64,
    rounds_max: usize,
    passes: u64,
    read_back: u64,
    read_back_bytes: Option<u64>,
    cells: u64,
    queries: u64,
    visible_query_pixels: u64,
    mapped: [u64; 2],
    plp: u64,
    occluders: u64,
    bounds: u64,
    z_tests: u64,
    query_z_tests_counted: bool,
    draw_ms: f64,
    /// Of the view under way.
    repeats: Vec<(f64, f64)>,
    /// Of each view: culling, and the max pass.
    frame_ms: Vec<f64>,
    max_pass_ms: Vec<f64>,
    exposed: Vec<u32>,
}

/// What a row says besides what was counted.
pub(super) struct About<'a> {
    pub(super) world: &'a World,
    pub(super) setting: &'a Setting,
    /// Which cells stood in for what was asked for, and why.
    pub(super) instead: Option<(&'static str, String)>,
    pub(super) conservative: bool,
    pub(super) build_ms: f64,
    pub(super) config: &'a CullConfig,
}

impl Tally {
    fn count(&mut self, culled: &Culled) {
        self.kept += culled.visible.len() as u64;
        self.rounds += culled.traversal.rounds as u64;
        self.rounds_max = self.rounds_max.max(culled.traversal.rounds);
        self.passes += culled.traversal.passes as u64;
        self.read_back += culled.traversal.read_back;
        self.cells += culled.traversal.cells_projected as u64;
        self.queries += culled.traversal.queries as u64;
        self.visible_query_pixels += culled.traversal.seen_z_tests;
        self.mapped.iter_mut().zip(culled.traversal.mapped).for_each(|(sum, cells)| *sum += cells as u64);
        self.plp += culled.traversal.plp_triangles as u64;
        self.occluders += culled.traversal.polygons_drawn as u64;
        self.bounds += culled.traversal.bounds_tested as u64;
    }

    pub(super) fn timed(
        &mut self,
        world: &World,
        view: &View,
        radius: f64,
        candidate: &mut dyn Candidate,
        max_pass: &mut MaxPass,
    ) {
        debug_assert_eq!(self.index.is_none(), world.object_boxes.is_empty());
        let region = EyeRegion { centre: view.eye, radius };
        self.exposed.clear();
        let began = Instant::now();
        let culled = candidate.cull(view, region);
        if let Some(index) = &self.index {
            index.exposed(candidate.occlusion(), &mut self.exposed);
        }
        let frame = millis(began);
        black_box((culled, &self.exposed));
        self.repeats.push((frame, max_pass.run()));
    }

    pub(super) fn close_view(&mut self) {
        let median = |of: fn(&(f64, f64)) -> f64| percentile(self.repeats.iter().map(of).collect(), 0.5);
        let (frame, max_pass) = (median(|pair| pair.0), median(|pair| pair.1));
        self.frame_ms.push(frame);
        self.max_pass_ms.push(max_pass);
        self.repeats.clear();
    }

    /// The row of all views, and those of each.
    pub(super) fn rows(self, about: &About, resolution: Resolution, radius: f64) -> (CullRow, Vec<FrameRow>) {
        let views = self.views.clone();
        let times = (about.config.repeats > 0).then(|| self.frame_ms.clone());
        let row = self.row(about, resolution, radius);
        let frames = frame_rows(&row, &views, times.as_deref());
        (row, frames)
    }

    fn row(self, about: &About, resolution: Resolution, radius: f64) -> CullRow {
        let frames = self.views.len().max(1) as f64;
        let mean = |sum: u64| sum as f64 / frames;
        let has_objects = !about.world.object_boxes.is_empty();
        let frame_ms = self.frame_ms.iter().sum::<f64>() / frames;
        let max_pass_ms = self.max_pass_ms.iter().sum::<f64>() / frames;
        let draw_ms = self.draw_ms / frames;
        let ratio = |a: f64, b: f64| if b > 0.0 { a / b } else { 0.0 };
        CullRow {
            world: about.world.name.clone(),
            culler: about.setting.culler.to_owned(),
            tessellation: about.instead.as_ref().map(|(name, _)| *name).or(about.setting.tessellation).map(Into::into),
            tessellation_why: about.instead.as_ref().map(|(_, why)| why.clone()),
            query: about.setting.query.map(Into::into),
            budget: about.setting.budget.as_ref().map(|budget| budget.text().to_owned()),
            budget_triangles: (self.budgets > 0).then(|| (self.budget as f64 / self.budgets as f64).round() as usize),
            resolution: resolution.to_string(),
            eye_radius: radius,
            eyes: if radius > 0.0 { about.config.eyes.max(1) } else { 1 },
            frames: self.views.len(),
            conservative: about.conservative,
            ok: !about.conservative || (self.wrong == 0 && self.lost == 0),
            wrong_pixels_max: self.wrong_max,
            wrong_pixels_mean: mean(self.wrong),
            lost_visible: self.lost,
            cracks: self.cracks,
            visible_found: if self.winners == 0 { 1.0 } else { 1.0 - self.lost as f64 / self.winners as f64 },
            visible_found_mean: if self.views.is_empty() { 1.0 } else { self.found_share / frames },
            visible_found_least: 1.0 - self.lost_share_most,
            wrong_percent_max: ratio(100.0 * self.wrong_max as f64, resolution.pixels() as f64),
            churn: if self.views.len() < 2 { 0.0 } else { self.churn / (frames - 1.0) },
            drawn_churn: ratio(self.drawn_churn.iter().sum(), self.drawn_churn.len() as f64),
            drawn_churn_p95: percentile(self.drawn_churn, 0.95),
            kept: mean(self.kept),
            exact: mean(self.exact),
            kept_over_exact: (self.exact > 0).then(|| self.kept as f64 / self.exact as f64),
            objects_kept: has_objects.then(|| mean(self.objects_kept)),
            objects_exact: has_objects.then(|| mean(self.objects_exact)),
            objects_rectangle: self.objects_rectangle.map(mean),
            objects_lost: self.objects_lost,
            rounds: mean(self.rounds),
            rounds_max: self.rounds_max,
            passes: mean(self.passes),
            read_back: mean(self.read_back),
            read_back_bytes: self.read_back_bytes.map(mean),
            cells: mean(self.cells),
            queries: mean(self.queries),
            visible_query_pixels: mean(self.visible_query_pixels),
            mapped: mean(self.mapped[0]),
            foreseen: mean(self.mapped[1]),
            over_unmapped: None,
            bounds: mean(self.bounds),
            occluders: mean(self.occluders),
            plp_triangles: mean(self.plp),
            extra_triangles: about.setting.budget.as_ref().map_or(0.0, |_| mean(self.kept) - mean(self.plp)),
            z_tests_per_pixel: ratio(self.z_tests as f64, self.pixels as f64),
            query_z_tests_counted: self.query_z_tests_counted,
            frame_ms,
            frame_ms_median: percentile(self.frame_ms.clone(), 0.5),
            frame_ms_p95: percentile(self.frame_ms, 0.95),
            max_pass_ms,
            per_max_pass: ratio(frame_ms, max_pass_ms),
            overhead_ms: None,
            over_frustum: None,
            draw_ms,
            total_ms: frame_ms + draw_ms,
            build_ms: about.build_ms,
        }
    }
}

/// Share of what is there now that was not there before; both ascending. 0 of nothing.
fn new_share(now: &[u32], before: &[u32]) -> f64 {
    let (mut rest, mut new) = (before, 0);
    for id in now {
        while rest.first().is_some_and(|first| first < id) {
            rest = &rest[1..];
        }
        new += usize::from(rest.first() != Some(id));
    }
    new as f64 / now.len().max(1) as f64
}

/// The value below which a share of the values lies, by nearest rank; 0 if there is none.
fn percentile(mut values: Vec<f64>, share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    let rank = (values.len() as f64 * share).ceil() as usize;
    values.get(rank.max(1) - 1).copied().unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_by_nearest_rank() {
        assert_eq!(percentile(Vec::new(), 0.5), 0.0);
        assert_eq!(percentile(vec![3.0], 0.95), 3.0);
        assert_eq!(percentile(vec![4.0, 1.0, 3.0, 2.0], 0.5), 2.0);
        assert_eq!(percentile((1..=100).map(f64::from).collect(), 0.95), 95.0);
    }

    #[test]
    fn new_is_what_was_not_there() {
        assert_eq!(new_share(&[], &[1]), 0.0);
        assert_eq!(new_share(&[1, 4], &[]), 1.0);
        assert_eq!(new_share(&[1, 4, 7, 9], &[0, 4, 5, 9, 10]), 0.5);
        assert_eq!(new_share(&[1, 4], &[1, 2, 4]), 0.0);
    }
}
