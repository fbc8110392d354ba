//! Runs cullers over the views of a world and holds each against the exact set.
//!
//! The exact set of a view is an item buffer of everything, computed once for all cullers. For a ball of eyes it is the
//! union over sampled eyes, all with the view's orientation. Times are taken with a max pass of f32 over one image between
//! the culled frames: the speed of a shared machine drifts, and the ratio of the two does not.

// This is a driver: it may read the clock.
#![expect(clippy::disallowed_methods)]

use std::cell::OnceCell;
use std::hint::black_box;
use std::time::Instant;

use eyeline_visibility::{
    Bound, Culled, DepthBuffer, DynamicIndex, DynamicOctree, EyeRegion, ItemBuffer, Occlusion, RayScene, Resolution,
    Target, View, image_ray,
};
use glam::DVec3;
use rand::RngExt;

use super::fragments::Fragments;
use super::max_pass::MaxPass;
use super::path::CameraPath;
use super::picture::Picture;
use super::registry::{Candidate, Entry, Registry, Setting, Shop};
use super::row::CullRow;
use super::world::World;
use crate::chance;

/// What is run.
#[derive(Clone, Debug, PartialEq)]
pub struct CullConfig {
    /// Cullers and their settings.
    pub settings: Vec<Setting>,
    /// Sizes of the images. Each takes all settings once more.
    pub resolutions: Vec<Resolution>,
    /// Radii of the eye ball in metres; 0 is a point. Each takes all settings once more.
    pub eye_radii: Vec<f64>,
    /// Eyes of a ball for which the exact set is computed, the middle included. Cost grows with it.
    pub eyes: usize,
    /// Times that each view is culled against the clock; its time is their median. 0: not timed, the times are 0.
    pub repeats: usize,
    /// Decides the eyes of a ball.
    pub seed: u64,
}

/// A view's pictures under one setting.
#[derive(Clone, Debug)]
pub struct Pictures {
    /// What the picture is called: `wrong pixels`.
    pub name: String,
    /// Which culler; `None` for what all share.
    pub setting: Option<Setting>,
    /// Which view, by its place in the path.
    pub view: usize,
    /// The picture.
    pub picture: Picture,
}

/// What came out.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// A row for each resolution, radius and setting.
    pub rows: Vec<CullRow>,
    /// For the first resolution and radius: the first view's truth, and what each culler made of its worst view.
    pub pictures: Vec<Pictures>,
}

/// Runs every setting over every view. `each_view` is called after each view of each resolution and radius.
pub fn run(
    world: &World,
    path: &CameraPath,
    config: &CullConfig,
    registry: &Registry,
    mut each_view: impl FnMut(),
) -> Outcome {
    let shop = Shop::new(world.scene.clone());
    let mut shop = match &world.tessellation {
        Some(made) => shop.with_tessellation(made.clone()),
        None => shop,
    };
    let mut made: Vec<(&Setting, &Entry, f64, Box<dyn Candidate>)> = Vec::new();
    for setting in &config.settings {
        let Some(entry) = registry.entry(setting.culler) else { continue };
        let began = Instant::now();
        let candidate = (entry.make)(&mut shop, setting);
        made.push((setting, entry, millis(began), candidate));
    }
    let rays = OnceCell::new();
    let mut outcome = Outcome { rows: Vec::new(), pictures: Vec::new() };
    for &resolution in &config.resolutions {
        let mut max_pass = MaxPass::new(resolution);
        for &radius in &config.eye_radii {
            let mut tallies: Vec<Tally> = made.iter().map(|_| Tally::default()).collect();
            let views = path.views(world.scene.anchor(), resolution);
            for (number, view) in views.iter().enumerate() {
                let truth = Truth::new(world, view, radius, config, number as u64);
                for ((_, entry, _, candidate), tally) in made.iter_mut().zip(&mut tallies) {
                    let try_ = Try { world, view, radius, truth: &truth, rays: entry.by_rays.then_some(&rays) };
                    try_.one(number, candidate.as_mut(), tally);
                }
                for _ in 0..config.repeats {
                    for ((.., candidate), tally) in made.iter_mut().zip(&mut tallies) {
                        tally.timed(world, view, radius, candidate.as_mut(), &mut max_pass);
                    }
                }
                tallies.iter_mut().for_each(Tally::close_view);
                each_view();
            }
            let first = outcome.rows.is_empty();
            for ((setting, entry, build_ms, candidate), tally) in made.iter_mut().zip(tallies) {
                if first {
                    let number = tally.worst.map_or(0, |(_, view)| view);
                    if let Some(view) = views.get(number) {
                        let pictures = pictures_of(world, view, radius, candidate.as_mut());
                        let named =
                            |(name, picture)| Pictures { name, setting: Some(setting.clone()), view: number, picture };
                        outcome.pictures.extend(pictures.into_iter().map(named));
                    }
                }
                let instead = shop.instead(setting);
                let about =
                    About { world, setting, instead, conservative: entry.conservative, build_ms: *build_ms, config };
                outcome.rows.push(tally.row(&about, resolution, radius));
            }
            if let Some(view) = views.first().filter(|_| first) {
                let items = exact_items(world, view);
                let shared =
                    [("correct", Picture::of_items(world, &items, view)), ("depth", Picture::of_depth(&items, view))];
                let shared =
                    shared.map(|(name, picture)| Pictures { name: name.into(), setting: None, view: 0, picture });
                outcome.pictures.splice(0..0, shared);
            }
        }
    }
    outcome
}

/// Everything drawn: the scene's primitives under their ids, then each object under the id that follows.
fn exact_items(world: &World, view: &View) -> ItemBuffer {
    let mut items = ItemBuffer::new(view);
    items.draw_all(&world.scene);
    draw_objects(world, &mut items, 0..world.object_boxes.len() as u32);
    items
}

fn draw_objects(world: &World, items: &mut ItemBuffer, objects: impl IntoIterator<Item = u32>) {
    let first = world.scene.triangles().len() as u32;
    for object in objects {
        let mesh = &world.scene.objects()[object as usize];
        for triangle in &mesh.triangles {
            items.draw_triangle(first + object, triangle, mesh.origin);
        }
    }
}

/// What can be seen in a view, from every eye of the ball.
struct Truth {
    /// The middle's picture, then those of the other eyes.
    items: Vec<ItemBuffer>,
    eyes: Vec<DVec3>,
    /// Primitives and objects that own a pixel in any of them, ascending.
    winners: Vec<u32>,
    /// Objects that a screen rectangle against everything drawn keeps; `None` for a ball, where it is no bound.
    rectangle: Option<u64>,
}

impl Truth {
    fn new(world: &World, view: &View, radius: f64, config: &CullConfig, number: u64) -> Truth {
        let mut chance = chance(config.seed ^ 0xE7E, number);
        let (mut items, mut eyes) = (vec![exact_items(world, view)], vec![view.eye]);
        let mut winners = items[0].winners();
        if radius > 0.0 {
            while items.len() < config.eyes.max(1) {
                let offset = DVec3::from_array(std::array::from_fn(|_| chance.random_range(-1.0..=1.0)));
                if offset.length() <= 1.0 {
                    let eye = view.eye + offset * radius;
                    let other = exact_items(world, &View { eye, ..*view });
                    eyes.push(eye);
                    winners.extend(other.winners());
                    items.push(other);
                }
            }
            winners.sort_unstable();
            winners.dedup();
        }
        let rectangle = (radius == 0.0 && !world.object_boxes.is_empty()).then(|| {
            let mut depth = DepthBuffer::new(view);
            let everything: Vec<u32> = (0..world.scene.triangles().len() as u32).collect();
            depth.target(&world.scene).draw(&everything);
            world.object_boxes.iter().filter(|aabb| !depth.hides(&Bound::Box(**aabb))).count() as u64
        });
        Truth { items, eyes, winners, rectangle }
    }
}

/// The rasteriser moves corners by half of this at most, along each axis.
const SNAP_PX: f64 = 1.0 / 256.0;

/// One culler on one view.
struct Try<'a> {
    world: &'a World,
    view: &'a View,
    radius: f64,
    truth: &'a Truth,
    /// For a culler that promises rays; made when first needed.
    rays: Option<&'a OnceCell<RayScene>>,
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

    fn one(&self, number: usize, candidate: &mut dyn Candidate, tally: &mut Tally) {
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
        let cracks: Vec<u32> = lost.iter().copied().filter(|&id| self.shows_in_cracks_only(id)).collect();
        lost.retain(|id| !cracks.contains(id));
        wrong -= truth.items[0].ids().iter().filter(|id| cracks.contains(id)).count() as u64;
        tally.cracks += cracks.len() as u64;
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
        if tally.frames > 0 {
            let new = shown.iter().filter(|id| tally.shown.binary_search(id).is_err()).count();
            tally.churn += new as f64 / shown.len().max(1) as f64;
        }
        tally.shown = shown;
        tally.frames += 1;
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
    }
}

fn index_of(world: &World) -> DynamicOctree {
    let mut index = DynamicOctree::new(world.scene.bounds());
    for (key, aabb) in (0..).zip(&world.object_boxes) {
        index.insert(key, Bound::Box(*aabb));
    }
    index
}

/// What a culler did, summed over views.
#[derive(Default)]
struct Tally {
    index: Option<DynamicOctree>,
    frames: usize,
    pixels: u64,
    wrong: u64,
    wrong_max: u64,
    /// Most wrong pixels, and the first view that had them.
    worst: Option<(u64, usize)>,
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
    exact: u64,
    kept: u64,
    objects_exact: u64,
    objects_kept: u64,
    objects_rectangle: Option<u64>,
    rounds: u64,
    rounds_max: usize,
    passes: u64,
    cells: u64,
    queries: u64,
    visible_query_pixels: u64,
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
struct About<'a> {
    world: &'a World,
    setting: &'a Setting,
    instead: Option<(&'static str, String)>,
    conservative: bool,
    build_ms: f64,
    config: &'a CullConfig,
}

impl Tally {
    fn count(&mut self, culled: &Culled) {
        self.kept += culled.visible.len() as u64;
        self.rounds += culled.traversal.rounds as u64;
        self.rounds_max = self.rounds_max.max(culled.traversal.rounds);
        self.passes += culled.traversal.passes as u64;
        self.cells += culled.traversal.cells_projected as u64;
        self.queries += culled.traversal.queries as u64;
        self.visible_query_pixels += culled.traversal.seen_z_tests;
        self.plp += culled.traversal.plp_triangles as u64;
        self.occluders += culled.traversal.polygons_drawn as u64;
        self.bounds += culled.traversal.bounds_tested as u64;
    }

    fn timed(
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

    fn close_view(&mut self) {
        let median = |of: fn(&(f64, f64)) -> f64| percentile(self.repeats.iter().map(of).collect(), 0.5);
        let (frame, max_pass) = (median(|pair| pair.0), median(|pair| pair.1));
        self.frame_ms.push(frame);
        self.max_pass_ms.push(max_pass);
        self.repeats.clear();
    }

    fn row(self, about: &About, resolution: Resolution, radius: f64) -> CullRow {
        let frames = self.frames.max(1) as f64;
        let mean = |sum: u64| sum as f64 / frames;
        let has_objects = !about.world.object_boxes.is_empty();
        let total = about.world.scene.triangles().len();
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
            budget_triangles: about.setting.budget.as_ref().map(|budget| budget.triangles(total)),
            resolution: resolution.to_string(),
            eye_radius: radius,
            eyes: if radius > 0.0 { about.config.eyes.max(1) } else { 1 },
            frames: self.frames,
            conservative: about.conservative,
            ok: !about.conservative || (self.wrong == 0 && self.lost == 0),
            wrong_pixels_max: self.wrong_max,
            wrong_pixels_mean: mean(self.wrong),
            lost_visible: self.lost,
            cracks: self.cracks,
            visible_found: if self.winners == 0 { 1.0 } else { 1.0 - self.lost as f64 / self.winners as f64 },
            visible_found_mean: if self.frames == 0 { 1.0 } else { self.found_share / frames },
            visible_found_least: 1.0 - self.lost_share_most,
            wrong_percent_max: ratio(100.0 * self.wrong_max as f64, resolution.pixels() as f64),
            churn: if self.frames < 2 { 0.0 } else { self.churn / (frames - 1.0) },
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
            cells: mean(self.cells),
            queries: mean(self.queries),
            visible_query_pixels: mean(self.visible_query_pixels),
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
            draw_ms,
            total_ms: frame_ms + draw_ms,
            build_ms: about.build_ms,
        }
    }
}

/// Culled and wrong pixels, and what the culler shows of itself.
fn pictures_of(world: &World, view: &View, radius: f64, candidate: &mut dyn Candidate) -> Vec<(String, Picture)> {
    let culled = candidate.cull(view, EyeRegion { centre: view.eye, radius });
    let mut items = ItemBuffer::new(view);
    items.draw(&world.scene, &culled.visible);
    let mut exposed = Vec::new();
    if !world.object_boxes.is_empty() {
        index_of(world).exposed(candidate.occlusion(), &mut exposed);
    }
    draw_objects(world, &mut items, exposed);
    let exact = exact_items(world, view);
    let picture = Picture::of_items(world, &items, view);
    let mut pictures = vec![
        ("culled".to_owned(), picture.clone()),
        ("wrong pixels in red".to_owned(), Picture::of_items(world, &exact, view).of_difference(&items, &exact)),
    ];
    for layer in candidate.layers(view) {
        pictures.push((layer.name.to_owned(), picture.clone().with_layer(&layer)));
    }
    pictures
}

pub(super) fn millis(since: Instant) -> f64 {
    since.elapsed().as_secs_f64() * 1e3
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
}
