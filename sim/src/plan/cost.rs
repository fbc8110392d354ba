//! What would leaving it in cost? Each stage on against off, and the planned culler against every fixed one.
//!
//! Everything of one scene is timed in one process and interleaved, round by round, since the speed of a shared machine
//! drifts. In which order is left to chance (seeded), anew for each view and round, since a way that follows a like one
//! finds its triangles in the cache.
//! A frame is culling and drawing on the CPU: what a culler spares is drawing.

// This is a driver: it may read the clock.
#![expect(clippy::disallowed_methods)]

use std::hint::black_box;
use std::sync::Arc;
use std::time::Instant;

use eyeline_client::plan::planned;
use eyeline_protocol::{PlanSwitch, Stage};
use eyeline_visibility::{
    AnyTessellation, Culled, Culler, EyeRegion, Frustum, FrustumBackface, ItemBuffer, MaskedCplp, Planned, Scratch,
    View, ZBuffer,
};
use rand::seq::SliceRandom as _;
use serde::Serialize;

use super::live::{LiveRules, Lived};
use super::{LIVE_STAGES, LiveStage, Planner};

/// Settings of a comparison.
#[derive(Clone, Debug, PartialEq)]
pub struct CostConfig {
    /// Rounds over all views.
    pub repeats: usize,
    /// Seconds of virtual time of runs with server and client.
    pub seconds: f64,
    /// Decides everything that is left to chance.
    pub seed: u64,
    /// What is asked of the plan that is compared.
    pub switch: PlanSwitch,
}

/// One stage forced, on or off, or one way to draw.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[expect(missing_docs, reason = "each column's meaning is in `report::cost_columns`")]
pub struct CostRow {
    pub world: String,
    pub stage: String,
    pub setting: String,
    pub planned: bool,
    pub frame_ms: f64,
    pub frame_ms_mean: f64,
    pub over_best_percent: Option<f64>,
    pub over_frustum_percent: Option<f64>,
    pub over_everything_percent: Option<f64>,
    pub build_ms: f64,
    pub memory_mb: f64,
    pub triangles: f64,
    pub messages: Option<u64>,
    pub bytes: Option<u64>,
    pub culls: Option<u64>,
    pub work: Option<u64>,
    pub same: bool,
}

/// The stage that all ways to draw are rows of.
pub const DRAWING: &str = "drawing";
/// The way to draw that follows the plan.
pub const PLANNED: &str = "planned";

/// A way to draw under test.
struct Way {
    name: &'static str,
    cull: Box<dyn FnMut(&View) -> Culled>,
    build_ms: f64,
    memory_bytes: usize,
    /// Milliseconds by view, a column a round.
    times: Vec<Vec<f64>>,
    triangles: u64,
    same: bool,
}

impl Way {
    fn new(name: &'static str, build_ms: f64, memory_bytes: usize, cull: impl FnMut(&View) -> Culled + 'static) -> Way {
        Way { name, cull: Box::new(cull), build_ms, memory_bytes, times: Vec::new(), triangles: 0, same: true }
    }

    fn of(name: &'static str, build_ms: f64, memory_bytes: usize, culler: Arc<dyn Culler + Send + Sync>) -> Way {
        let mut scratch = Scratch::default();
        Way::new(name, build_ms, memory_bytes, move |view| culler.cull(view, EyeRegion::point(view.eye), &mut scratch))
    }
}

/// Every way to draw a scene: frames of the planned culler beside each fixed one.
///
/// # Errors
/// If cells can't be made.
pub fn drawing(planner: &Planner, config: &CostConfig, mut each_round: impl FnMut()) -> anyhow::Result<Vec<CostRow>> {
    let scene = &planner.world.scene;
    let mut ways = vec![Way::of("everything", 0.0, 0, Arc::new(ZBuffer::new(scene.clone())))];
    let (frustum, build_ms) = timed(|| Arc::new(Frustum::new(scene.clone())));
    ways.push(Way::of("frustum", build_ms, 0, frustum));
    let (backface, build_ms) = timed(|| Arc::new(FrustumBackface::new(scene.clone())));
    ways.push(Way::of("frustum-backface", build_ms, 0, backface));
    let (cells, cells_ms) = timed(|| AnyTessellation::build("kd-tree", scene));
    let cells = cells?;
    let memory = cells.memory_bytes();
    let tessellation = cells.tessellation().ok_or_else(|| anyhow::anyhow!("a kD-tree is a tessellation"))?;
    let (masked, masked_ms) = timed(|| Arc::new(MaskedCplp::new(scene.clone(), tessellation)));
    let occlusion_ms = cells_ms + masked_ms;
    ways.push(Way::of("occlusion", occlusion_ms, memory, masked.clone()));
    let (counts, counts_ms) = timed(|| planner.counts());
    let needs_cells = counts.counts.occlusion_pays(false);
    let follows: Planned = planned(counts, config.switch);
    let mut follows = match config.switch.asked(Stage::Prisms) {
        Some(true) => follows,
        // Cells that are there already are not made twice.
        _ => follows.with_occlusion(move |_| masked.clone() as Arc<dyn Culler + Send + Sync>),
    };
    let build_ms = counts_ms + if needs_cells { occlusion_ms } else { 0.0 };
    let memory = if needs_cells { memory } else { 0 };
    ways.push(Way::new(PLANNED, build_ms, memory, move |view| follows.look(view, EyeRegion::point(view.eye))));

    let mut items: Vec<ItemBuffer> = planner.views.iter().take(1).map(ItemBuffer::new).collect();
    let Some(items) = items.first_mut() else { return Ok(Vec::new()) };
    ways.iter_mut().for_each(|way| way.times = vec![Vec::new(); planner.views.len()]);
    let mut order: Vec<usize> = (0..ways.len()).collect();
    let mut chance = crate::chance(config.seed, 9);
    // The first round is for warming up and for pictures.
    for round in 0..config.repeats.max(1) + 1 {
        for (number, view) in planner.views.iter().enumerate() {
            let mut truth: Option<Vec<u32>> = None;
            if round > 0 {
                // Whoever comes right after a like way finds its triangles in the cache. By chance no way always does.
                order.shuffle(&mut chance);
            }
            // The first round holds pictures against that of everything.
            for &turn in &order {
                let way = &mut ways[turn];
                let began = Instant::now();
                let culled = (way.cull)(view);
                items.begin(view);
                items.draw(scene, &culled.visible);
                let took = began.elapsed().as_secs_f64() * 1e3;
                black_box(items.ids());
                if round == 0 {
                    match &truth {
                        None => truth = Some(items.ids().to_vec()),
                        Some(truth) => way.same &= items.ids() == &truth[..],
                    }
                    way.triangles += culled.visible.len() as u64;
                } else {
                    way.times[number].push(took);
                }
            }
        }
        each_round();
    }
    let views = planner.views.len() as f64;
    let frame = |way: &Way| way.times.iter().map(|times| median(times.clone())).sum::<f64>() / views;
    let fixed = ways.iter().filter(|way| way.name != PLANNED);
    let best = fixed.map(frame).fold(f64::INFINITY, f64::min);
    let of = |name: &str| ways.iter().find(|way| way.name == name).map_or(f64::NAN, frame);
    let (frustum, everything) = (of("frustum"), of("everything"));
    let over = |ms: f64, other: f64| Some(100.0 * (ms / other - 1.0)).filter(|share| share.is_finite());
    let rows = ways.iter().map(|way| {
        let all = way.times.iter().flatten();
        let mean = all.clone().sum::<f64>() / all.count().max(1) as f64;
        CostRow {
            world: planner.world.name.clone(),
            stage: DRAWING.to_owned(),
            setting: way.name.to_owned(),
            planned: way.name == PLANNED,
            frame_ms: frame(way),
            frame_ms_mean: mean,
            over_best_percent: over(frame(way), best),
            over_frustum_percent: over(frame(way), frustum),
            over_everything_percent: over(frame(way), everything),
            build_ms: way.build_ms,
            memory_mb: way.memory_bytes as f64 / 1e6,
            triangles: way.triangles as f64 / views,
            messages: None,
            bytes: None,
            culls: None,
            work: None,
            same: way.same,
        }
    });
    Ok(rows.collect())
}

/// Each live stage forced on and off: the same run of server and client otherwise.
///
/// # Errors
/// If the world contradicts itself.
pub fn live(planner: &Planner, config: &CostConfig, mut each: impl FnMut()) -> anyhow::Result<Vec<CostRow>> {
    let mut rows = Vec::new();
    for LiveStage { stage, walks, policy } in LIVE_STAGES {
        let rules = |runs| LiveRules {
            seconds: config.seconds,
            walks,
            policy,
            switch: config.switch.with(stage, runs),
            seed: config.seed,
            ..LiveRules::default()
        };
        let auto = planner.live.run(&LiveRules { switch: config.switch, ..rules(true) })?;
        let planned = auto.plan.runs(stage);
        let mut sides: [(bool, Vec<f64>, Option<Lived>); 2] = [(true, Vec::new(), None), (false, Vec::new(), None)];
        for round in 0..config.repeats.clamp(1, 5) {
            // Each is first in its turn.
            let order = if round % 2 == 0 { [0, 1] } else { [1, 0] };
            for side in order {
                let (runs, times, lived) = &mut sides[side];
                let done = planner.live.run(&rules(*runs))?;
                times.push(done.run_ms);
                *lived = Some(done);
            }
        }
        let pictures: Vec<u64> = sides.iter().flat_map(|side| &side.2).map(|lived| lived.picture).collect();
        let same = pictures.windows(2).all(|pair| pair[0] == pair[1]);
        let frames = config.seconds / super::FRAME.as_secs_f64();
        for (runs, times, lived) in sides {
            let Some(lived) = lived else { continue };
            rows.push(CostRow {
                world: planner.world.name.clone(),
                stage: stage.name().to_owned(),
                setting: if runs { "on" } else { "off" }.to_owned(),
                planned: planned == runs,
                frame_ms: median(times.clone()) / frames,
                frame_ms_mean: times.iter().sum::<f64>() / times.len().max(1) as f64 / frames,
                over_best_percent: None,
                over_frustum_percent: None,
                over_everything_percent: None,
                build_ms: 0.0,
                memory_mb: lived.memory_bytes as f64 / 1e6,
                triangles: 0.0,
                messages: Some(lived.messages),
                bytes: Some(lived.bytes),
                culls: Some(lived.culls),
                work: Some(lived.work),
                same,
            });
        }
        each();
    }
    Ok(rows)
}

fn timed<T>(make: impl FnOnce() -> T) -> (T, f64) {
    let began = Instant::now();
    let made = make();
    (made, began.elapsed().as_secs_f64() * 1e3)
}

/// The middle of some times; 0 of none.
fn median(mut times: Vec<f64>) -> f64 {
    times.sort_by(f64::total_cmp);
    times.get(times.len() / 2).copied().unwrap_or(0.0)
}
