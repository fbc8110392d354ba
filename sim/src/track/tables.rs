//! The sweeps `occluders`, `drawing` and `observer`: Coorg & Teller's tables 1, 2 and 3 (1997, §4) on the made offices.
//!
//! An observer walks through the offices ([`office::walk`]), and [`LargeOccluder`] culls each frame, beside the same tree
//! with no occluders: view-frustum culling, the paper's baseline. The paper averages over a whole walk. Here a walk is looked at
//! in stretches spread evenly over it, so that an observer of any speed comes by the same places in the same number of frames; a
//! fast one sees more around them.

// This is a driver: it may read the clock.
#![expect(clippy::disallowed_methods)]

use std::sync::Arc;
use std::time::Instant;

use eyeline_visibility::{
    EyeRegion, ItemBuffer, LargeOccluder, LargeOccluderRules, LargeOccluderScratch, LoadOptions, Resolution, Scene,
    View, exact_set, load_glb, wrong_pixels,
};

use super::observer::Observer;
use super::row::TrackRow;
use super::sweep::{Finding, SweepOptions};
use crate::scene::office::{self, OfficeRules};

/// The sweeps.
pub const SWEEPS: [&str; 3] = ["occluders", "drawing", "observer"];

/// Metres that the observer walks in a frame: 1.5 m/s at 30 Hz, about the rate that the paper drew at.
const WALK: f64 = 0.05;
/// Numbers k of occluders per cell and direction. The paper has 32. Each takes seconds to prepare.
const OCCLUDERS: [usize; 5] = [1, 4, 16, 32, 64];
/// Speeds of table 3, in walking speeds.
const SPEEDS: [f64; 7] = [0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0];
/// Floors of the offices: the paper's building is one floor, `office` has three.
const FLOORS: [u32; 2] = [1, 3];

/// Frames that count in each run where none are asked for.
const FRAMES: u64 = 160;
/// Stretches of a walk. Frames that count are shared among them. What is drawn differs much from place to place, so many short
/// stretches say more than a few long ones.
const STRETCHES: u64 = 32;
/// Frames before each stretch. It begins without relations, since those of other stretches would pile up. After these frames,
/// what is near the observer is known, as in a long walk.
const SETTLE: u64 = 5;
/// The paper does not limit what is kept. By default all relations are forgotten beyond 65,536, and here some views come to that
/// alone, so that each of their frames would begin without any.
const RELATIONS_MAX: usize = 1 << 20;

/// A scene and a way through it.
#[derive(Clone, Debug)]
pub struct Place {
    /// The scene; nothing in it moves.
    pub scene: Arc<Scene>,
    /// Who looks at it.
    pub observer: Observer,
}

impl Place {
    /// The made offices.
    ///
    /// # Errors
    /// Names the rule that no office can follow.
    pub fn office(floors: u32, seed: u64) -> anyhow::Result<Place> {
        let rules = OfficeRules { floors, cameras: 0, seed };
        let scene = load_glb(&office::make(&rules)?.glb, "office", &LoadOptions::default())?;
        Ok(Place { scene: Arc::new(scene), observer: Observer::by(&office::walk(&rules)?) })
    }
}

/// How long and how closely to look.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TableRules {
    /// Frames that count, shared among the stretches.
    pub frames: u64,
    /// Size of the images.
    pub resolution: Resolution,
    /// Whether what is left is drawn, against the clock.
    pub drawn: bool,
}

/// A culler that goes along.
#[derive(Clone, Debug)]
pub struct Setting {
    /// In rows.
    pub variant: &'static str,
    /// What is swept.
    pub x: f64,
    /// How the culler is made. No occluders: the frustum alone.
    pub rules: LargeOccluderRules,
    /// In walking speeds.
    pub speed: f64,
    /// Whether it begins each frame without relations.
    pub forgets: bool,
}

impl Setting {
    fn new(variant: &'static str, x: f64, rules: LargeOccluderRules) -> Setting {
        Setting { variant, x, rules, speed: 1.0, forgets: false }
    }
}

/// Floors and settings of a sweep's runs, and whether they draw.
///
/// # Panics
/// If the sweep is not one of [`SWEEPS`].
pub fn runs(name: &str) -> (Vec<(u32, Vec<Setting>)>, bool) {
    let rules = LargeOccluderRules::default().with_relations_max(RELATIONS_MAX);
    let frustum = |x: f64| Setting::new("frustum-alone", x, rules.with_occluders(0));
    match name {
        "occluders" => {
            let each = OCCLUDERS.map(|k| Setting::new("joint", k as f64, rules.with_occluders(k)));
            let k = rules.occluders as f64;
            let without = [
                Setting::new("no-joints", k, rules.with_joint(false)),
                Setting::new("no-details", k, rules.with_details(false)),
            ];
            (vec![(FLOORS[1], [frustum(0.0)].into_iter().chain(each).chain(without).collect())], false)
        }
        "drawing" => {
            let both = |floors: u32| {
                let x = f64::from(floors);
                (floors, vec![frustum(x), Setting::new("joint", x, rules)])
            };
            (FLOORS.map(both).to_vec(), true)
        }
        "observer" => {
            let at = |variant, speed: f64, forgets| Setting { speed, forgets, ..Setting::new(variant, speed, rules) };
            let kept = SPEEDS.map(|speed| at("kept", speed, false));
            // The same at all speeds, but for chance.
            let forgotten = [SPEEDS[0], SPEEDS[SPEEDS.len() - 1]].map(|speed| at("forgotten", speed, true));
            let each = kept.into_iter().chain(forgotten);
            (vec![(FLOORS[1], each.collect())], false)
        }
        other => unreachable!("sweep {other} is not in SWEEPS"),
    }
}

/// Frames that [`run`] goes through, those before stretches included.
pub fn frames(name: &str, options: &SweepOptions) -> u64 {
    let (runs, _) = runs(name);
    let frames = options.frames.unwrap_or(FRAMES);
    runs.len() as u64 * (frames + SETTLE * frames.min(STRETCHES))
}

/// Runs a sweep on the offices.
///
/// # Errors
/// If the offices cannot be made.
pub fn run(name: &str, options: &SweepOptions, mut progress: impl FnMut()) -> anyhow::Result<Vec<TrackRow>> {
    let (runs, drawn) = runs(name);
    let rules = TableRules {
        frames: options.frames.unwrap_or(FRAMES),
        resolution: options.resolution.unwrap_or(Resolution::new(512, 512)),
        drawn,
    };
    let mut rows = Vec::new();
    for (floors, settings) in runs {
        rows.extend(walk(&Place::office(floors, options.seed)?, &settings, &rules, &mut progress));
    }
    for row in &mut rows {
        row.sweep = name.to_owned();
        row.paper = match name {
            "occluders" => "C&T Table 1",
            "drawing" => "C&T Table 2",
            _ => "C&T Table 3",
        }
        .to_owned();
    }
    Ok(rows)
}

/// Takes all settings through the same stretches of a walk, frame by frame in turn.
pub fn walk(place: &Place, settings: &[Setting], rules: &TableRules, mut progress: impl FnMut()) -> Vec<TrackRow> {
    let cullers = prepare(&place.scene, settings);
    let mut contenders: Vec<Contender> =
        settings.iter().zip(cullers).map(|(setting, culler)| Contender::new(setting.clone(), culler)).collect();
    let stretches = rules.frames.min(STRETCHES);
    let mut truth = None;
    for stretch in 0..stretches {
        // The first stretches take what is left over.
        let counted = rules.frames / stretches + u64::from(stretch < rules.frames % stretches);
        let middle = (stretch as f64 + 0.5) / stretches as f64 * place.observer.length();
        for frame in 0..SETTLE + counted {
            let from_middle = frame as f64 - (SETTLE + counted / 2) as f64;
            for contender in &mut contenders {
                let metres = middle + from_middle * WALK * contender.setting.speed;
                let view = place.observer.view(metres, place.scene.anchor(), rules.resolution);
                if frame == 0 || contender.setting.forgets {
                    contender.scratch.forget_relations();
                }
                contender.frame(&view, rules.drawn, frame >= SETTLE);
                // In the middle, where all speeds are at the same place. Every other stretch: it takes long.
                if frame == SETTLE + counted / 2 && stretch % 2 == 0 {
                    let exact = truth.take().filter(|(of, _)| *of == view);
                    let exact = exact.unwrap_or_else(|| (view, exact_set(&place.scene, &view).1));
                    contender.compare(&view, &exact.1);
                    truth = Some(exact);
                }
            }
            progress();
        }
    }
    contenders.into_iter().map(|contender| contender.finish(rules)).collect()
}

/// A culler for each setting. Settings of the same rules share one; large scenes take seconds, so all cores take part.
fn prepare(scene: &Arc<Scene>, settings: &[Setting]) -> Vec<LargeOccluder> {
    let mut all: Vec<LargeOccluderRules> = Vec::new();
    let mut which = Vec::with_capacity(settings.len());
    for setting in settings {
        let known = all.iter().position(|rules| *rules == setting.rules);
        which.push(known.unwrap_or(all.len()));
        if known.is_none() {
            all.push(setting.rules);
        }
    }
    let cores = std::thread::available_parallelism().map_or(1, |cores| cores.get());
    let make = |rules: &[LargeOccluderRules]| -> Vec<LargeOccluder> {
        rules.iter().map(|rules| LargeOccluder::new(scene.clone(), *rules)).collect()
    };
    let made: Vec<LargeOccluder> = std::thread::scope(|scope| {
        let makers: Vec<_> =
            all.chunks(all.len().div_ceil(cores).max(1)).map(|rules| scope.spawn(|| make(rules))).collect();
        let made = makers.into_iter().map(|maker| maker.join());
        made.flat_map(|made| made.unwrap_or_else(|panic| std::panic::resume_unwind(panic))).collect()
    });
    which.into_iter().map(|number| made[number].clone()).collect()
}

/// One setting while it runs.
struct Contender {
    setting: Setting,
    culler: LargeOccluder,
    scratch: LargeOccluderScratch,
    image: Option<ItemBuffer>,
    frame_ms: Vec<f64>,
    draw_ms: f64,
    nodes: usize,
    nodes_and_bounds: usize,
    relations: usize,
    relations_made: usize,
    drawn: usize,
    truth_frames: u64,
    wrong_pixels_max: u64,
}

impl Contender {
    fn new(setting: Setting, culler: LargeOccluder) -> Contender {
        Contender {
            setting,
            culler,
            scratch: LargeOccluderScratch::default(),
            image: None,
            frame_ms: Vec::new(),
            draw_ms: 0.0,
            nodes: 0,
            nodes_and_bounds: 0,
            relations: 0,
            relations_made: 0,
            drawn: 0,
            truth_frames: 0,
            wrong_pixels_max: 0,
        }
    }

    fn frame(&mut self, view: &View, is_drawn: bool, counts: bool) {
        let began = Instant::now();
        let stats = self.culler.walk(view, EyeRegion::point(view.eye), &mut self.scratch);
        let frame_ms = began.elapsed().as_secs_f64() * 1e3;
        if !counts {
            return;
        }
        self.frame_ms.push(frame_ms);
        self.nodes += stats.nodes_in_frustum;
        self.nodes_and_bounds += stats.nodes_visited + stats.details_tested;
        self.relations += stats.relations_tested;
        self.relations_made += stats.relations_made;
        self.drawn += stats.primitives;
        if is_drawn {
            let image = self.image.get_or_insert_with(|| ItemBuffer::new(view));
            let began = Instant::now();
            image.begin(view);
            image.draw(self.culler.scene(), self.scratch.visible());
            self.draw_ms += began.elapsed().as_secs_f64() * 1e3;
        }
    }

    /// Holds what the last frame left against the picture of everything.
    fn compare(&mut self, view: &View, exact: &ItemBuffer) {
        let wrong = wrong_pixels(self.culler.scene(), view, self.scratch.visible(), exact);
        self.truth_frames += 1;
        self.wrong_pixels_max = self.wrong_pixels_max.max(wrong as u64);
    }

    fn finish(mut self, rules: &TableRules) -> TrackRow {
        let frames = self.frame_ms.len().max(1) as f64;
        let per_frame = |count: usize| count as f64 / frames;
        let (frame_ms, draw_ms) = (self.frame_ms.iter().sum::<f64>() / frames, self.draw_ms / frames);
        self.frame_ms.sort_by(f64::total_cmp);
        let (static_work, drawn) = (per_frame(self.nodes_and_bounds + self.relations), per_frame(self.drawn));
        let is_frustum = self.setting.rules.occluders == 0;
        TrackRow {
            x: self.setting.x,
            culler: if is_frustum { "frustum" } else { "large-occluder" }.into(),
            variant: self.setting.variant.into(),
            index: "kd-tree".into(),
            motion: "walk".into(),
            eye: "walking".into(),
            resolution: rules.resolution.to_string(),
            static_triangles: self.culler.scene().triangles().len(),
            frames: self.frame_ms.len() as u64,
            work: static_work + drawn,
            work_static: static_work,
            work_drawing: drawn,
            nodes_in_frustum: per_frame(self.nodes),
            relations_per_frame: per_frame(self.relations),
            relations_made_per_frame: per_frame(self.relations_made),
            frame_ms,
            frame_ms_p95: self.frame_ms.get(self.frame_ms.len() * 95 / 100).copied().unwrap_or(0.0),
            draw_ms,
            total_ms: frame_ms + draw_ms,
            truth_frames: self.truth_frames,
            wrong_pixels_max: self.wrong_pixels_max,
            other_wrong_pixels_max: self.wrong_pixels_max,
            ok: self.wrong_pixels_max == 0,
            ..TrackRow::default()
        }
    }
}

/// The share of the scene's polygons that is drawn, in percent.
pub fn drawn_percent(row: &TrackRow) -> f64 {
    100.0 * row.work_drawing / row.static_triangles.max(1) as f64
}

/// How many floors a row of `drawing` is about.
pub fn floors(row: &TrackRow) -> String {
    format!("{} floor{}", row.x, if row.x == 1.0 { "" } else { "s" })
}

/// What the rows of a sweep say.
pub fn findings(name: &str, rows: &[TrackRow]) -> Vec<Finding> {
    let of = |variant: &'static str| rows.iter().filter(move |row| row.variant == variant);
    let list = |variant: &'static str, tell: &dyn Fn(&TrackRow) -> String| {
        of(variant).map(tell).collect::<Vec<String>>().join(", ")
    };
    let mut findings = Vec::new();
    let mut say = |text: String, met: Option<bool>| findings.push(Finding { text, met });
    match name {
        "occluders" => {
            let paper_k = LargeOccluderRules::default().occluders as f64;
            let (Some(frustum), Some(chosen)) = (of("frustum-alone").next(), of("joint").find(|row| row.x == paper_k))
            else {
                return findings;
            };
            let less = frustum.work_drawing / chosen.work_drawing;
            say(
                format!(
                    "of {} polygons, frustum culling draws {:.1} % and occlusion culling with k = {paper_k} {:.2} %: 1/{less:.1} of \
                     it; the bar is 1/6",
                    frustum.static_triangles,
                    drawn_percent(frustum),
                    drawn_percent(chosen)
                ),
                Some(less >= 6.0),
            );
            let by_k = list("joint", &|row| format!("k = {} {:.2} %", row.x, drawn_percent(row)));
            say(format!("drawn with k occluders: {by_k}"), None);
            for (variant, what) in [("no-joints", "joint occluders"), ("no-details", "tests of details (§3.2)")] {
                if let Some(without) = of(variant).next() {
                    let [without, with] = [without, chosen].map(|row| row.work_drawing);
                    say(format!("{without:.0} polygons drawn without {what}, {with:.0} with them"), None);
                }
            }
            say(
                format!(
                    "{:.0} nodes of the kD-tree maintained a frame, {:.0} % of those in the frustum; the paper's 27 to 35, 30 to \
                     40 %",
                    chosen.nodes_in_frustum,
                    100.0 * chosen.nodes_in_frustum / frustum.nodes_in_frustum
                ),
                None,
            );
        }
        "drawing" => {
            for (frustum, occlusion) in of("frustum-alone").zip(of("joint")) {
                let times = |row: &TrackRow| {
                    format!("cull {:.2} + draw {:.2} = {:.2} ms", row.frame_ms, row.draw_ms, row.total_ms)
                };
                say(
                    format!(
                        "{} of office, {} polygons: frustum draws {:.1} % ({}), occlusion {:.2} % ({}): {:.1} times fewer \
                         polygons, {:.1} times less time",
                        floors(frustum),
                        frustum.static_triangles,
                        drawn_percent(frustum),
                        times(frustum),
                        drawn_percent(occlusion),
                        times(occlusion),
                        frustum.work_drawing / occlusion.work_drawing,
                        frustum.total_ms / occlusion.total_ms
                    ),
                    None,
                );
            }
        }
        _ => {
            for variant in ["kept", "forgotten"] {
                let rows: Vec<&TrackRow> = of(variant).collect();
                let [slow, .., fast] = &rows[..] else { continue };
                let by_speed = list(variant, &|row| {
                    format!("{}× {:.0} relations in {:.2} ms", row.x, row.relations_per_frame, row.frame_ms)
                });
                let is_kept = variant == "kept";
                let bar = if is_kept { "; the bar is that the slow one costs less, in both" } else { "" };
                say(
                    format!(
                        "relations {variant}: {by_speed}; {:.2} times the relations and {:.2} times the time from slowest to \
                         fastest{bar}",
                        fast.relations_per_frame / slow.relations_per_frame,
                        fast.frame_ms / slow.frame_ms
                    ),
                    is_kept.then_some(
                        slow.relations_per_frame < fast.relations_per_frame && slow.frame_ms < fast.frame_ms,
                    ),
                );
            }
        }
    }
    findings
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::track::{Chairs, EyeKind, MotionKind, TrackRules, TrackWorld};

    /// Rooms that somebody walks through; small, since nothing is fast here.
    fn rooms() -> Place {
        let rules = TrackRules {
            rooms: [5, 5],
            chairs: Chairs::PerRoom(0),
            motion: vec![MotionKind::Random],
            eye: EyeKind::Walking,
            slack: 1.0,
            seed: 5,
        };
        let mut world = TrackWorld::make(&rules).unwrap();
        let mut eye = || {
            world.step(0.4);
            world.view(Resolution::new(1, 1)).eye + world.scene.anchor()
        };
        let way: Vec<_> = (0..300).map(|_| eye()).collect();
        Place { scene: world.scene, observer: Observer::by(&way) }
    }

    #[test]
    fn more_occluders_draw_less_and_a_slow_observer_looks_at_fewer_relations() {
        let place = rooms();
        let rules = TableRules { frames: 100, resolution: Resolution::new(64, 64), drawn: false };
        let default = LargeOccluderRules::default();
        let by_k = [0, 2, 32].map(|k| Setting::new("joint", k as f64, default.with_occluders(k)));
        let by_speed = [0.25, 16.0].map(|speed| Setting { speed, ..Setting::new("kept", speed, default) });
        let forgets = Setting { forgets: true, ..Setting::new("forgotten", 1.0, default) };
        let mut settings = by_k.to_vec();
        settings.extend(by_speed);
        settings.push(forgets);
        let rows = walk(&place, &settings, &rules, || ());
        assert!(rows.iter().all(|row| row.ok && row.truth_frames == STRETCHES / 2 && row.frames == 100));
        let [frustum, two, thirty_two, slow, fast, forgotten] = &rows[..] else { unreachable!() };
        assert_eq!((frustum.culler.as_str(), two.culler.as_str()), ("frustum", "large-occluder"));
        assert!(two.work_drawing < frustum.work_drawing && thirty_two.work_drawing < two.work_drawing);
        assert!(slow.relations_per_frame < fast.relations_per_frame);
        assert!(slow.relations_made_per_frame < fast.relations_made_per_frame);
        assert!(thirty_two.relations_per_frame < forgotten.relations_per_frame);
        assert_eq!(thirty_two.work_drawing, forgotten.work_drawing);
        // The bar sees which of two rows is the slow one. Times are told apart by hand: these are short.
        let timed = |row: &TrackRow, frame_ms: f64| TrackRow { frame_ms, ..row.clone() };
        let (slow, fast) = (timed(slow, 1.0), timed(fast, 2.0));
        let met = |rows: [TrackRow; 2]| findings("observer", &rows)[0].met;
        assert_eq!(met([slow.clone(), fast.clone()]), Some(true));
        assert_eq!(met([fast, slow]), Some(false));
    }
}
