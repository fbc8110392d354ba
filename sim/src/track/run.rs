//! Runs trackers over a world in motion, frame by frame side by side, and holds their pictures against the truth.

// This is a driver: it may read the clock.
#![expect(clippy::disallowed_methods)]

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use anyhow::Context;
use eyeline_client::tracking::{
    Agents, FrameInput, FrameStats, FuzzySpeeds, Image, SceneTracker, TbvShape, TemporalBound, Validity, Variant,
    broken,
};
use eyeline_protocol::WorldTime;
use eyeline_visibility::{
    Bound, Culled, DynamicIndex, DynamicOctree, EyeRegion, ItemBuffer, Occlusion, References, Resolution, SplitOctree,
    SplitRules, Triangle, Update,
};
use glam::DVec3;
use rand::RngExt;

use super::row::TrackRow;
use super::world::TrackWorld;
use crate::chance;
use crate::cull::{Candidate, Registry, Setting, Shop, Sweep};

/// Which structure T is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum IndexKind {
    /// Loose octree, one reference each, never split by numbers.
    Loose,
    /// The paper's, that splits and collapses, updated under the LCA: one reference each (Fig. 9).
    Single,
    /// The same with a reference in every node that is met (Fig. 10).
    Multiple,
}

impl IndexKind {
    /// The name in rows.
    pub const fn name(self) -> &'static str {
        match self {
            IndexKind::Loose => "loose",
            IndexKind::Single => "split-single",
            IndexKind::Multiple => "split-multiple",
        }
    }

    fn make(self, world: &TrackWorld) -> Box<dyn DynamicIndex + Send> {
        let split = |references| -> Box<dyn DynamicIndex + Send> {
            let rules = SplitRules { primitives_max: 8, depth_max: 10, references, update: Update::UnderLca };
            Box::new(SplitOctree::new(world.scene.bounds(), rules))
        };
        match self {
            IndexKind::Loose => Box::new(DynamicOctree::new(world.scene.bounds())),
            IndexKind::Single => split(References::Single),
            IndexKind::Multiple => split(References::Multiple),
        }
    }
}

/// One way to track.
#[derive(Clone, Debug)]
pub struct TrackSetting {
    /// Name of a culler in [`Registry::standard`].
    pub culler: String,
    /// How T is kept.
    pub variant: Variant,
    /// Shape of TBVs.
    pub shape: TbvShape,
    /// Who chooses validity periods.
    pub validity: Validity,
    /// Structure of T.
    pub index: IndexKind,
    /// Share of the valid TBVs that is broken in each frame, as Fig. 14 simulates fuzzy TBVs.
    pub violated: f64,
    /// Fuzzy TBVs that may be broken with this probability, made from how far objects were seen to go. 0: hard ones.
    pub fuzzy: f64,
    /// Whether displayed objects hide what lies behind them.
    pub moving_occluders: bool,
}

impl TrackSetting {
    /// Adaptive spheres from speed.
    pub fn new(culler: &str, variant: Variant) -> TrackSetting {
        TrackSetting {
            culler: culler.to_owned(),
            variant,
            shape: TbvShape::SpeedSphere,
            validity: ADAPTIVE,
            index: IndexKind::Loose,
            violated: 0.0,
            fuzzy: 0.0,
            moving_occluders: true,
        }
    }
}

/// Adaptive validity as most sweeps use it.
pub const ADAPTIVE: Validity = Validity::Adaptive {
    first: Duration::from_millis(200),
    shortest: Duration::from_millis(50),
    longest: Duration::from_secs(120),
};

/// Longest period for which fuzzy bounds are learned.
pub const LEARNED: Duration = Duration::from_secs(30);

/// Frames between bounds that are made for trial.
const TRIAL_FRAMES: u64 = 20;

/// For how long they are valid, in turn.
const TRIAL_PERIODS_S: [f64; 5] = [0.2, 1.0, 3.0, 10.0, 25.0];

/// How long and how closely to look.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RunRules {
    /// Frames that count.
    pub frames: u64,
    /// Frames before, in which everything is new.
    pub settle: u64,
    /// Time between frames.
    pub frame_time: Duration,
    /// Size of the images.
    pub resolution: Resolution,
    /// One frame of so many is compared with the truth; 0 for none.
    pub truth_every: u64,
    /// Decides which bounds are broken.
    pub seed: u64,
}

impl Default for RunRules {
    fn default() -> RunRules {
        RunRules {
            frames: 200,
            settle: 100,
            frame_time: Duration::from_millis(50),
            resolution: Resolution::new(256, 256),
            truth_every: 10,
            seed: 7,
        }
    }
}

/// One setting while it runs.
struct Contender {
    setting: TrackSetting,
    fuzzy: Option<FuzzySpeeds>,
    /// Fuzzy bounds on trial, whose time is not up.
    pending: Vec<(u32, TemporalBound)>,
    /// Those whose time was up and that held, and those that were broken.
    promises: [u64; 2],
    /// Frames so far in which bounds were on trial.
    trials: u64,
    candidate: Box<dyn Candidate>,
    tracker: SceneTracker,
    culled: Culled,
    shown: Vec<u32>,
    total: FrameStats,
    static_work: u64,
    drawn: u64,
    frame_ms: Vec<f64>,
    draw_ms: Vec<f64>,
    /// In how many compared frames running an object has been absent.
    absent: BTreeMap<u32, u64>,
    row: TrackRow,
}

/// Runs all settings over the same frames.
///
/// # Errors
/// Names a culler that does not exist.
pub fn run(
    world: &mut TrackWorld,
    settings: &[TrackSetting],
    rules: &RunRules,
    registry: &Registry,
    mut progress: impl FnMut(),
) -> anyhow::Result<Vec<TrackRow>> {
    let mut shop = Shop::new(world.scene.clone());
    let mut contenders = Vec::with_capacity(settings.len());
    for setting in settings {
        contenders.push(Contender::new(world, setting, rules, registry, &mut shop)?);
    }
    let frame_s = rules.frame_time.as_secs_f64();
    let view = world.view(rules.resolution);
    let mut truth = Truth { exact: ItemBuffer::new(&view), picture: ItemBuffer::new(&view), placed: Vec::new() };
    let mut chances: Vec<_> = settings.iter().map(|_| chance(rules.seed, 31)).collect();
    for frame in 0..rules.settle + rules.frames {
        let counts = frame >= rules.settle;
        if frame > 0 {
            world.step(frame_s);
        }
        let is_compared = rules.truth_every > 0 && frame.is_multiple_of(rules.truth_every);
        if is_compared {
            truth.draw_exact(world, rules.resolution);
        }
        for (contender, chance) in contenders.iter_mut().zip(&mut chances) {
            if contender.setting.violated > 0.0 {
                for object in 0..world.objects.len() as u32 {
                    if contender.tracker.bound(object).is_some() && chance.random::<f64>() < contender.setting.violated
                    {
                        contender.tracker.handle_violation(object);
                    }
                }
            }
            contender.report_broken(world);
            contender.frame(world, rules, [counts, counts || is_compared], &mut truth);
            if is_compared {
                contender.compare(world, &truth);
            }
        }
        progress();
    }
    Ok(contenders.into_iter().map(|contender| contender.finish(world, rules)).collect())
}

/// The picture of everything, and the one that is held against it.
struct Truth {
    exact: ItemBuffer,
    picture: ItemBuffer,
    placed: Vec<Triangle>,
}

impl Truth {
    fn draw_exact(&mut self, world: &TrackWorld, resolution: Resolution) {
        self.exact.begin(&world.view(resolution));
        self.exact.draw_all(&world.scene);
        for object in 0..world.objects.len() as u32 {
            draw_object(&mut self.exact, world, object, &mut self.placed);
        }
    }
}

fn draw_object(image: &mut ItemBuffer, world: &TrackWorld, object: u32, placed: &mut Vec<Triangle>) {
    world.place(object, placed);
    let first = world.scene.triangles().len() as u32 + object * placed.len() as u32;
    for (id, triangle) in (first..).zip(placed.iter()) {
        image.draw_triangle(id, triangle, DVec3::ZERO);
    }
}

impl Contender {
    fn new(
        world: &TrackWorld,
        setting: &TrackSetting,
        rules: &RunRules,
        registry: &Registry,
        shop: &mut Shop,
    ) -> anyhow::Result<Contender> {
        let chosen: Vec<Setting> =
            registry.settings(&Sweep { cullers: vec![setting.culler.clone()], ..Sweep::default() })?;
        let entry = registry.entry(&setting.culler).context("settings were found for a culler that is not there")?;
        let candidate = (entry.make)(shop, &chosen[0]);
        let index = setting.index.make(world);
        let mut tracker = SceneTracker::new(setting.variant, setting.validity, rules.frame_time, index);
        (0..world.objects.len() as u32).for_each(|object| tracker.insert(object));
        let learn = |probability| world.learn(probability, rules.settle + rules.frames, rules.frame_time, LEARNED);
        let fuzzy = (setting.fuzzy > 0.0).then_some(setting.fuzzy).map(learn).transpose()?;
        Ok(Contender {
            setting: setting.clone(),
            fuzzy,
            pending: Vec::new(),
            promises: [0; 2],
            trials: 0,
            candidate,
            tracker,
            culled: Culled::default(),
            shown: Vec::new(),
            total: FrameStats::default(),
            static_work: 0,
            drawn: 0,
            frame_ms: Vec::new(),
            draw_ms: Vec::new(),
            absent: BTreeMap::new(),
            row: TrackRow::default(),
        })
    }

    /// Whoever moves an object says when it has broken its bound (§3.5).
    fn report_broken(&mut self, world: &TrackWorld) {
        if self.fuzzy.is_none() {
            return;
        }
        // Bounds for trial are made at regular times. The tracker's own are made when something has happened, often to objects
        // that have just broken another, and are no fair sample.
        if self.trials.is_multiple_of(TRIAL_FRAMES) {
            for object in 0..world.objects.len() as u32 {
                let number = (self.trials / TRIAL_FRAMES + u64::from(object)) as usize % TRIAL_PERIODS_S.len();
                let expires = world.now() + Duration::from_secs_f64(TRIAL_PERIODS_S[number]);
                let bound = world.temporal_bound(object, self.setting.shape, self.fuzzy.as_ref(), expires);
                self.pending.push((object, bound));
            }
        }
        self.trials += 1;
        let promises = &mut self.promises;
        self.pending.retain(|(object, bound)| {
            let is_broken = broken(bound, world.position(*object), world.now());
            let is_over = world.now() >= bound.expires();
            promises[usize::from(is_broken)] += u64::from(is_broken || is_over);
            !is_broken && !is_over
        });
        for object in 0..world.objects.len() as u32 {
            let Some(bound) = self.tracker.bound(object) else { continue };
            if broken(bound, world.position(object), world.now()) {
                self.tracker.handle_violation(object);
            }
        }
    }

    fn frame(&mut self, world: &TrackWorld, rules: &RunRules, [counts, is_drawn]: [bool; 2], truth: &mut Truth) {
        let view = world.view(rules.resolution);
        let began = Instant::now();
        self.culled = self.candidate.cull(&view, EyeRegion::point(view.eye));
        self.shown.clear();
        let fuzzy = self.fuzzy.as_ref();
        let mut agents = Owners { world, shape: self.setting.shape, fuzzy, placed: Vec::new() };
        let mut image = Screen {
            world,
            candidate: &mut *self.candidate,
            occludes: self.setting.moving_occluders,
            shown: &mut self.shown,
            placed: Vec::new(),
        };
        let input = FrameInput { now: world.now(), eye: view.eye, eye_moves: world.eye_moves() };
        let stats = self.tracker.frame(input, &mut agents, &mut image);
        let frame_ms = began.elapsed().as_secs_f64() * 1e3;
        if !is_drawn {
            return;
        }
        let began = Instant::now();
        truth.picture.begin(&view);
        truth.picture.draw(&world.scene, &self.culled.visible);
        for &object in &self.shown {
            draw_object(&mut truth.picture, world, object, &mut truth.placed);
        }
        if counts {
            self.frame_ms.push(frame_ms);
            self.draw_ms.push(began.elapsed().as_secs_f64() * 1e3);
            self.total.add(&stats);
            let traversal = &self.culled.traversal;
            self.static_work += (traversal.queries + traversal.bounds_tested) as u64;
            self.drawn += (self.culled.visible.len() + self.shown.len() * world.triangles_each()) as u64;
        }
    }

    /// Holds the picture that was just drawn against the exact one.
    fn compare(&mut self, world: &TrackWorld, truth: &Truth) {
        self.row.truth_frames += 1;
        let statics = world.scene.triangles().len() as u32;
        let each = world.triangles_each() as u32;
        let is_shown: std::collections::BTreeSet<u32> = self.shown.iter().copied().collect();
        let (mut wrong, mut other) = (0, 0);
        let mut absent = std::collections::BTreeSet::new();
        for (&exact, &here) in truth.exact.ids().iter().zip(truth.picture.ids()) {
            let owner = (exact != ItemBuffer::NONE && exact >= statics).then(|| (exact - statics) / each);
            let missing = owner.filter(|owner| !is_shown.contains(owner));
            absent.extend(missing);
            if exact != here {
                wrong += 1;
                other += u64::from(missing.is_none());
            }
        }
        self.row.wrong_pixels_max = self.row.wrong_pixels_max.max(wrong);
        self.row.other_wrong_pixels_max = self.row.other_wrong_pixels_max.max(other);
        self.row.absences += absent.len() as u64;
        let before = std::mem::take(&mut self.absent);
        for object in absent {
            let running = before.get(&object).copied().unwrap_or(0) + 1;
            self.row.absent_frames_max = self.row.absent_frames_max.max(running);
            self.absent.insert(object, running);
        }
        // The promise that the rest stands on.
        for object in 0..world.objects.len() as u32 {
            let Some(bound) = self.tracker.bound(object) else { continue };
            self.row.broken_bounds += u64::from(broken(bound, world.position(object), world.now()));
        }
        self.tracker.check();
    }

    fn finish(mut self, world: &TrackWorld, rules: &RunRules) -> TrackRow {
        let frames = rules.frames.max(1) as f64;
        let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len().max(1) as f64;
        let (frame_ms, draw_ms) = (mean(&self.frame_ms), mean(&self.draw_ms));
        self.frame_ms.sort_by(f64::total_cmp);
        let p95 = self.frame_ms.get(self.frame_ms.len() * 95 / 100).copied().unwrap_or(0.0);
        let per_frame = |count: u64| count as f64 / frames;
        let (statics, tracking, drawing) =
            (per_frame(self.static_work), per_frame(self.total.work), per_frame(self.drawn));
        let visible = per_frame(self.total.shown);
        let mut kinds: Vec<&str> = world.objects.iter().map(|object| object.kind.name()).collect();
        kinds.sort_unstable();
        kinds.dedup();
        let setting = &self.setting;
        let uses_bounds = setting.variant.uses_bounds();
        let mut row = self.row;
        row.ok = row.broken_bounds == 0
            && row.other_wrong_pixels_max == 0
            && match setting.variant {
                Variant::Implicit => rules.truth_every != 1 || row.absent_frames_max <= 1,
                _ => row.wrong_pixels_max == 0,
            };
        TrackRow {
            culler: setting.culler.clone(),
            variant: setting.variant.name().to_owned(),
            shape: if uses_bounds { shape_name(setting.shape) } else { String::new() },
            validity: if uses_bounds { validity_name(&setting.validity) } else { String::new() },
            index: if setting.variant == Variant::NoHierarchy { "" } else { setting.index.name() }.to_owned(),
            motion: kinds.join(" "),
            eye: if world.eye_moves() { "walking" } else { "still" }.to_owned(),
            resolution: rules.resolution.to_string(),
            static_triangles: world.scene.triangles().len(),
            objects: world.objects.len(),
            visible,
            hidden: world.objects.len() as f64 - visible,
            violated: setting.violated,
            fuzzy: setting.fuzzy,
            violated_per_frame: per_frame(self.total.violated),
            tried_bounds: self.promises[0] + self.promises[1],
            broken_share: self.promises[1] as f64 / (self.promises[0] + self.promises[1]).max(1) as f64,
            frames: rules.frames,
            work: statics + tracking + drawing,
            work_static: statics,
            work_tracking: tracking,
            work_drawing: drawing,
            frame_ms,
            frame_ms_p95: p95,
            draw_ms,
            total_ms: frame_ms + draw_ms,
            updates_per_frame: per_frame(self.total.updates),
            bounds_per_frame: per_frame(self.total.bounds),
            hidden_caused_per_frame: per_frame(self.total.hidden_caused),
            exposed_per_frame: per_frame(self.total.exposed),
            expired_per_frame: per_frame(self.total.expired),
            ..row
        }
    }
}

/// The name of a shape in rows.
pub fn shape_name(shape: TbvShape) -> String {
    match shape {
        TbvShape::SpeedSphere => "sphere".into(),
        TbvShape::AccelerationSphere => "sphere-acceleration".into(),
        TbvShape::Box => "box".into(),
        TbvShape::Swept { pieces } => format!("swept-{pieces}"),
        TbvShape::Everywhere => "everywhere".into(),
    }
}

/// The name of a validity in rows.
pub fn validity_name(validity: &Validity) -> String {
    match validity {
        Validity::Fixed(period) => format!("fixed {} s", period.as_secs_f64()),
        Validity::Adaptive { .. } => "adaptive".into(),
        Validity::Exact { .. } => "exact".into(),
    }
}

/// Whoever moves the objects: here, the world itself.
struct Owners<'a> {
    world: &'a TrackWorld,
    shape: TbvShape,
    fuzzy: Option<&'a FuzzySpeeds>,
    placed: Vec<Triangle>,
}

impl Agents for Owners<'_> {
    fn configuration(&mut self, object: u32) -> Bound {
        self.world.configuration(object, &mut self.placed)
    }

    fn temporal_bound(&mut self, object: u32, expires: WorldTime) -> TemporalBound {
        self.world.temporal_bound(object, self.shape, self.fuzzy, expires)
    }
}

/// The image of a frame: the culler's, with what is displayed drawn into it.
struct Screen<'a> {
    world: &'a TrackWorld,
    candidate: &'a mut dyn Candidate,
    occludes: bool,
    shown: &'a mut Vec<u32>,
    placed: Vec<Triangle>,
}

impl Image for Screen<'_> {
    fn occlusion(&self) -> &dyn Occlusion {
        self.candidate.occlusion()
    }

    fn draw(&mut self, object: u32) -> bool {
        self.shown.push(object);
        if !self.occludes {
            return false;
        }
        self.world.place(object, &mut self.placed);
        self.candidate.draw_moving(&self.placed)
    }
}
