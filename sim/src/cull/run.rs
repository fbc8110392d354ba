//! Runs cullers over the views of a world and holds each against the exact set.
//!
//! The exact set of a view is computed once for all cullers. Times are taken with a max pass of f32 over one image between
//! the culled frames: the speed of a shared machine drifts, and the ratio of the two does not.

// This is a driver: it may read the clock.
#![expect(clippy::disallowed_methods)]

use std::cell::OnceCell;
use std::time::Instant;

use eyeline_visibility::{CameraPath, DynamicIndex, EyeRegion, ItemBuffer, Resolution, View};

use super::candidate::Candidate;
use super::frames::FrameRow;
use super::max_pass::MaxPass;
use super::picture::Picture;
use super::registry::{Entry, Registry, Setting};
use super::row::CullRow;
use super::shop::Shop;
use super::tally::{About, Tally, Try, index_of};
use super::truth::{Truth, draw_objects, exact_items};
use super::world::World;

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
    /// The same view by view, in the order of the rows.
    pub frames: Vec<FrameRow>,
    /// For the first resolution and radius: the first view's truth, and what each culler made of its worst view.
    pub pictures: Vec<Pictures>,
    /// What a reader of the report should know about how cullers were made.
    pub notes: Vec<String>,
}

/// Runs every setting over every view. `each_view` is called after each view of each resolution and radius.
pub fn run(
    world: &World,
    path: &CameraPath,
    config: &CullConfig,
    registry: &Registry,
    mut each_view: impl FnMut(),
) -> Outcome {
    let shop = Shop::new(world.scene.clone()).with_switch(world.plan);
    let mut shop = match &world.tessellation {
        Some(made) => shop.with_tessellation(made.clone()),
        None => shop,
    };
    let mut made: Vec<(&Setting, &Entry, f64, Box<dyn Candidate>)> = Vec::new();
    let mut faults = Vec::new();
    for setting in &config.settings {
        let Some(entry) = registry.entry(setting.culler) else { continue };
        let began = Instant::now();
        let candidate = (entry.make)(&mut shop, setting);
        if let Some(fault) = candidate.fault() {
            faults.push(format!("left out, {}: {fault}", setting.label()));
            continue;
        }
        made.push((setting, entry, millis(began), candidate));
    }
    let rays = OnceCell::new();
    let stand_in = |setting: &Setting| {
        let (instead, why) = shop.instead(setting)?;
        Some(format!("{instead} stands in for {}: {why}", setting.tessellation.unwrap_or_default()))
    };
    let mut notes: Vec<String> = made.iter().filter_map(|(setting, ..)| stand_in(setting)).collect();
    notes.dedup();
    notes.append(&mut faults);
    let mut outcome = Outcome { rows: Vec::new(), frames: Vec::new(), pictures: Vec::new(), notes };
    for &resolution in &config.resolutions {
        let mut max_pass = MaxPass::new(resolution);
        for &radius in &config.eye_radii {
            let mut tallies: Vec<Tally> = made.iter().map(|_| Tally::default()).collect();
            let views = path.views(world.scene.anchor(), resolution);
            for (number, view) in views.iter().enumerate() {
                let truth = Truth::new(world, view, radius, config, number as u64);
                for ((_, entry, _, candidate), tally) in made.iter_mut().zip(&mut tallies) {
                    candidate.foresee(truth.visible(world));
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
            let begin = outcome.rows.len();
            let first = begin == 0;
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
                let about = About {
                    world,
                    setting,
                    instead: shop.instead(setting),
                    conservative: entry.conservative,
                    build_ms: *build_ms,
                    config,
                };
                let (row, frames) = tally.rows(&about, resolution, radius);
                outcome.rows.push(row);
                outcome.frames.extend(frames);
            }
            tell_overhead(&mut outcome.rows[begin..]);
            tell_over_unmapped(&mut outcome.rows[begin..]);
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
    let failed = made.iter().filter_map(|(setting, .., candidate)| Some((setting.label(), candidate.fault()?)));
    outcome.notes.extend(failed.map(|(label, fault)| format!("{label} reported everything after a fault: {fault}")));
    outcome
}

/// What guessing costs beyond culling by the frustum, at equal triangles: the latter's time for a triangle that it keeps is set against
/// the time for each triangle that a culler with a budget keeps. Within 100 % both keep the same triangles.
fn tell_overhead(rows: &mut [CullRow]) {
    let frustum = rows.iter().find(|row| row.culler == FRUSTUM && row.kept > 0.0 && row.frame_ms > 0.0);
    let Some(per_triangle) = frustum.map(|row| row.frame_ms / row.kept) else { return };
    for row in rows.iter_mut().filter(|row| row.budget.is_some() && !row.conservative) {
        let plain = per_triangle * row.kept;
        row.overhead_ms = Some(row.frame_ms - plain);
        row.over_frustum = (plain > 0.0).then(|| row.frame_ms / plain);
    }
}

/// The baseline that overhead is told over.
const FRUSTUM: &str = "frustum-backface";

/// What occupancy maps cost or spare: the time of each culler with them over that of the same one without.
fn tell_over_unmapped(rows: &mut [CullRow]) {
    for at in 0..rows.len() {
        let row = &rows[at];
        let plain = MAPPED.iter().find_map(|suffix| row.culler.strip_suffix(suffix));
        let is_plain = |other: &&CullRow| {
            Some(other.culler.as_str()) == plain
                && (&other.tessellation, &other.query, &other.budget) == (&row.tessellation, &row.query, &row.budget)
        };
        let plain_ms = rows.iter().find(is_plain).map(|other| other.frame_ms).filter(|ms| *ms > 0.0);
        rows[at].over_unmapped = plain_ms.map(|ms| row.frame_ms / ms);
    }
}

/// How the names of cullers end that have occupancy maps and are otherwise the one without.
const MAPPED: [&str; 3] = ["-occupancy", "-occupancy-always", "-batches"];

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
