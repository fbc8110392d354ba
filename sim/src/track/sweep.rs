//! The paper's experiments, and those that go past them: what is swept, what the paper found, and what was found here.

use std::time::Duration;

use eyeline_client::tracking::{TbvShape, Validity, Variant};
use eyeline_visibility::Resolution;

use super::mover::MotionKind;
use super::row::TrackRow;
use super::run::{ADAPTIVE, IndexKind, LEARNED, RunRules, TrackSetting};
use super::world::{Chairs, EyeKind, TrackRules};

/// Runs of some settings over one world.
#[derive(Clone, Debug)]
pub struct SweepPoint {
    /// What is swept.
    pub x: f64,
    /// The world.
    pub world: TrackRules,
    /// How to track.
    pub settings: Vec<TrackSetting>,
    /// How long.
    pub run: RunRules,
}

/// A sweep.
#[derive(Clone, Copy, Debug)]
pub struct SweepInfo {
    /// Its name on the command line.
    pub name: &'static str,
    /// Where the paper shows the like.
    pub paper: &'static str,
    /// What is swept.
    pub x: &'static str,
    /// Whether a logarithmic axis suits it.
    pub log: bool,
    /// What the paper found, or why it is looked at.
    pub said: &'static str,
}

/// What was found, beside a bar if there is one.
#[derive(Clone, Debug, PartialEq)]
pub struct Finding {
    /// In words, with figures.
    pub text: String,
    /// Whether the bar is met; `None` where there is none.
    pub met: Option<bool>,
}

/// All sweeps.
pub const SWEEPS: [SweepInfo; 16] = [
    SweepInfo {
        name: "static",
        paper: "S&G Fig. 12a",
        x: "static triangles",
        log: true,
        said: "ZB's run time is linear in the size of the model; HZB, TBVe and TBVi are nearly constant, the TBVs slightly \
               better because only half of the moving objects are visible.",
    },
    SweepInfo {
        name: "ratio",
        paper: "S&G Fig. 12b",
        x: "moving objects, four in each room",
        log: true,
        said: "ZB and HZB are linear in the size of the model, HZB far worse for keeping the octree up to date; TBVe and \
               TBVi avoid most of these updates.",
    },
    SweepInfo {
        name: "dynamic",
        paper: "S&G Fig. 12c",
        x: "moving objects in 125 rooms",
        log: true,
        said: "The gain of TBVe and TBVi grows with the share of the model that moves.",
    },
    SweepInfo {
        name: "hidden",
        paper: "S&G Fig. 13b",
        x: "hidden moving objects",
        log: true,
        said: "With static and visible objects fixed, ZB is linear in the hidden ones, HZB worse, and TBVi almost constant.",
    },
    SweepInfo {
        name: "fuzzy",
        paper: "S&G Fig. 14",
        x: "share of the TBVs broken in each frame",
        log: false,
        said: "The penalty is small even if a fifth of the TBVs is broken in every frame, and at 100 % only slightly worse \
               than HZB.",
    },
    SweepInfo {
        name: "calibrated",
        paper: "S&G §3.5",
        x: "hard limit on speed over what is reached",
        log: false,
        said: "Hard limits may be very loose; a volume that is only assumed to hold, with some probability, is smaller, and \
               whoever moves the object reports when it does not.",
    },
    SweepInfo {
        name: "messages",
        paper: "S&G Fig. 15b",
        x: "hidden moving objects, over 26 frames",
        log: false,
        said: "Updating every object is linear in their number; updates under TBVs, with the TBVs' own messages, are again \
               almost constant.",
    },
    SweepInfo {
        name: "growth",
        paper: "past S&G §3.3",
        x: "moving objects, four in each room",
        log: true,
        said: "Theory: in a world that grows at constant density, hidden objects cause messages like its square root, since \
               one twice as far away is asked about half as often.",
    },
    SweepInfo {
        name: "lca",
        paper: "S&G §6.1.1",
        x: "side of the large thing over the small cube's",
        log: true,
        said: "Two cubes: the speedup of updates under the least common ancestor grows like the logarithm of their ratio, \
               0.145 + 0.385·log₁₀ r. A table for four, a cube round a candlestick: 2.7 times.",
    },
    SweepInfo {
        name: "index",
        paper: "S&G §4, Figs. 9 and 10",
        x: "hidden moving objects",
        log: true,
        said: "An octree may refer to an object from one node that contains it, or from all nodes that it meets; the paper's \
               experiments used many references.",
    },
    SweepInfo {
        name: "shapes",
        paper: "S&G §6.1.2",
        x: "shape",
        log: false,
        said: "Sweep surfaces were tried and found to give lower performance than spheres, because their more complex \
               geometry takes longer to update the octree with.",
    },
    SweepInfo {
        name: "validity",
        paper: "S&G §3.4",
        x: "validity",
        log: false,
        said: "Periods too short cost expiries and too long ones exposures; adaptive periods find their place; for a still \
               eye the exact moment can be found, and for a moving one about half of that is better.",
    },
    SweepInfo {
        name: "occluders",
        paper: "C&T Table 1",
        x: "occluders per cell and direction",
        log: true,
        said: "With 32 occluders, occlusion culling leaves 2.6 % of the 134,832 polygons of a furnished floor (Soda Hall) to \
               draw where frustum culling leaves 19.7 %, 7.6 times fewer; 5.6 % against 36.9 % of a city, for which there is \
               no model here. 27 to 35 nodes are maintained per frame, 30 to 40 % of those in the frustum (§4.1).",
    },
    SweepInfo {
        name: "drawing",
        paper: "C&T Table 2",
        x: "floors of offices",
        log: false,
        said: "Soda Hall on an Onyx: frustum culling takes 12 ms to cull and 83 ms to draw, 95 together, occlusion culling 27 \
               and 10, 37 together. With an Elan's slower graphics, 13 and 435, 448 together, against 32 and 57, 89 together. \
               Occlusion culling takes longer to cull; what it saves depends on how slow drawing is.",
    },
    SweepInfo {
        name: "observer",
        paper: "C&T Table 3",
        x: "speed of the observer, in walking speeds",
        log: true,
        said: "Culling Soda Hall, without the frustum's part, takes 17, 18, 21, 25, 32, 45 and 56 ms at 0.25, 0.5, 1, 2, 4, 8 \
               and 16 times walking speed: a slow observer costs less, since the relations of its last frames still hold.",
    },
    SweepInfo {
        name: "promise",
        paper: "S&G §3.3 and §3.6",
        x: "variant",
        log: false,
        said: "TBVe shows what updating every object shows. TBVi may omit a visible object for at most one frame.",
    },
];

/// What may be chosen for sweeps.
#[derive(Clone, Debug)]
pub struct SweepOptions {
    /// Cullers under TBVs and HZB.
    pub cullers: Vec<String>,
    /// Decides worlds and motion.
    pub seed: u64,
    /// Frames that count; `None`: each sweep's own.
    pub frames: Option<u64>,
    /// Size of images; `None`: each sweep's own.
    pub resolution: Option<Resolution>,
}

impl Default for SweepOptions {
    fn default() -> SweepOptions {
        let cullers = ["hierarchical-z", "cplp"].map(String::from).to_vec();
        SweepOptions { cullers, seed: 5, frames: None, resolution: None }
    }
}

/// The baseline that draws everything.
fn zb() -> TrackSetting {
    TrackSetting { moving_occluders: false, ..TrackSetting::new("zbuffer", Variant::NoHierarchy) }
}

/// ZB, and each culler with every object updated, TBVe and TBVi.
fn four(options: &SweepOptions) -> Vec<TrackSetting> {
    let variants = [Variant::EveryObject, Variant::Explicit, Variant::Implicit];
    let each = options.cullers.iter().flat_map(|culler| variants.map(|variant| TrackSetting::new(culler, variant)));
    std::iter::once(zb()).chain(each).collect()
}

/// The runs of a sweep.
///
/// # Panics
/// If the sweep is not one of [`SWEEPS`]: names are checked where they come in.
pub fn points(name: &str, options: &SweepOptions) -> Vec<SweepPoint> {
    let seed = options.seed;
    let rules = |rooms: [u32; 2], chairs: Chairs| TrackRules {
        rooms,
        chairs,
        motion: vec![MotionKind::Preset],
        eye: EyeKind::Still,
        slack: 1.0,
        seed,
    };
    let run = RunRules { seed, ..RunRules::default() };
    let with = |x: f64, world: TrackRules, settings: Vec<TrackSetting>, run: RunRules| SweepPoint {
        x,
        world,
        settings,
        run: RunRules {
            frames: options.frames.unwrap_or(run.frames),
            resolution: options.resolution.unwrap_or(run.resolution),
            ..run
        },
    };
    let random = |rules: TrackRules| TrackRules { motion: vec![MotionKind::Random], ..rules };
    match name {
        "static" => [4, 6, 8, 12, 16, 24]
            .map(|side| {
                let world = rules([side, side], Chairs::Split { visible: 4, hidden: 4 });
                with(f64::from(side * side), world, four(options), run)
            })
            .to_vec(),
        "ratio" => [3, 4, 6, 8, 12, 16]
            .map(|side| with(f64::from(4 * side * side), rules([side, side], Chairs::PerRoom(4)), four(options), run))
            .to_vec(),
        "dynamic" => [25, 50, 100, 200, 400, 800]
            .map(|total| with(f64::from(total), random(rules([25, 5], Chairs::Total(total))), four(options), run))
            .to_vec(),
        "hidden" => [100, 300, 1_000, 3_000, 10_000]
            .map(|hidden| {
                // 14,848 visible moving polygons; the paper's had 14,946.
                let world = random(rules([30, 30], Chairs::Split { visible: 58, hidden }));
                let run = RunRules { settle: 400, frames: 60, truth_every: 50, ..run };
                with(f64::from(hidden), world, four(options), run)
            })
            .to_vec(),
        "fuzzy" => {
            // One world, one run: all shares side by side.
            let culler = &options.cullers[0];
            let shares = [0.0, 0.01, 0.05, 0.1, 0.2, 0.5, 1.0];
            let fuzzy = |violated| TrackSetting { violated, ..TrackSetting::new(culler, Variant::Explicit) };
            let settings = shares.map(fuzzy).into_iter().chain([TrackSetting::new(culler, Variant::EveryObject)]);
            vec![with(500.0, random(rules([25, 5], Chairs::Total(500))), settings.collect(), run)]
        }
        "calibrated" => {
            let shares = [0.0, 0.001, 0.01, 0.05, 0.2, 0.5];
            // No longer than what is learned of: beyond, only the hard limit holds.
            let validity = match ADAPTIVE {
                Validity::Adaptive { first, shortest, .. } => Validity::Adaptive { first, shortest, longest: LEARNED },
                other => other,
            };
            let explicit = TrackSetting::new(&options.cullers[0], Variant::Explicit);
            let settings = shares.map(|fuzzy| TrackSetting { fuzzy, validity, ..explicit.clone() });
            // A walker's hard limit must let it run.
            let world = TrackRules { slack: 6.0, ..random(rules([10, 10], Chairs::PerRoom(4))) };
            let run = RunRules { settle: 400, frames: 2_000, truth_every: 20, ..run };
            vec![with(6.0, world, settings.to_vec(), run)]
        }
        "messages" => [0, 20, 40, 80, 160, 320]
            .map(|hidden| {
                let world = random(rules([12, 12], Chairs::Split { visible: 2, hidden }));
                let run = RunRules { settle: 400, frames: 26, ..run };
                with(f64::from(hidden), world, four(options), run)
            })
            .to_vec(),
        "index" => [100, 1_000, 10_000]
            .map(|hidden| {
                let world = random(rules([30, 30], Chairs::Split { visible: 58, hidden }));
                let run = RunRules { settle: 400, frames: 60, truth_every: 100, ..run };
                let settings = [IndexKind::Loose, IndexKind::Single, IndexKind::Multiple]
                    .map(|index| TrackSetting { index, ..TrackSetting::new(&options.cullers[0], Variant::Explicit) });
                with(f64::from(hidden), world, settings.to_vec(), run)
            })
            .to_vec(),
        "growth" => [6, 8, 12, 16, 24, 32]
            .map(|side| {
                let world = random(rules([side, side], Chairs::PerRoom(4)));
                let longest = Duration::from_secs(600);
                let settings = [
                    TrackSetting {
                        validity: Validity::Exact { longest },
                        ..TrackSetting::new(&options.cullers[0], Variant::Explicit)
                    },
                    TrackSetting {
                        validity: Validity::Adaptive {
                            first: Duration::from_millis(200),
                            shortest: Duration::from_millis(100),
                            longest,
                        },
                        ..TrackSetting::new(&options.cullers[0], Variant::Explicit)
                    },
                ];
                // Two of the longest periods: from the farthest corner at full speed.
                let frame_time = Duration::from_millis(100);
                let period_s = 6.0 * f64::from(side) * std::f64::consts::FRAC_1_SQRT_2 / super::world::SPEED_MAX;
                let period = (period_s / frame_time.as_secs_f64()).ceil() as u64;
                let run = RunRules {
                    settle: 2 * period,
                    frames: period.max(400),
                    frame_time,
                    resolution: Resolution::new(128, 128),
                    truth_every: 0,
                    ..run
                };
                with(f64::from(4 * side * side), world, settings.to_vec(), run)
            })
            .to_vec(),
        "shapes" => {
            let shapes = [
                TbvShape::SpeedSphere,
                TbvShape::AccelerationSphere,
                TbvShape::Box,
                TbvShape::Swept { pieces: 1 },
                TbvShape::Swept { pieces: 4 },
                TbvShape::Swept { pieces: 16 },
                TbvShape::Everywhere,
            ];
            let settings = shapes
                .map(|shape| TrackSetting { shape, ..TrackSetting::new(&options.cullers[0], Variant::Explicit) })
                .to_vec();
            [MotionKind::Preset, MotionKind::Smooth, MotionKind::Random]
                .into_iter()
                .enumerate()
                .map(|(number, kind)| {
                    let world = TrackRules { motion: vec![kind], ..rules([10, 10], Chairs::PerRoom(4)) };
                    with(number as f64, world, settings.clone(), run)
                })
                .collect()
        }
        "validity" => {
            let fixed = [0.05, 0.2, 0.5, 1.0, 2.0, 5.0, 20.0].map(|s| Validity::Fixed(Duration::from_secs_f64(s)));
            let more = [ADAPTIVE, Validity::Exact { longest: Duration::from_secs(120) }];
            let settings: Vec<TrackSetting> = fixed
                .into_iter()
                .chain(more)
                .map(|validity| TrackSetting { validity, ..TrackSetting::new(&options.cullers[0], Variant::Explicit) })
                .collect();
            [EyeKind::Still, EyeKind::Walking]
                .into_iter()
                .enumerate()
                .map(|(number, eye)| {
                    let world = TrackRules { eye, ..random(rules([10, 10], Chairs::PerRoom(4))) };
                    let run = RunRules { settle: 600, frames: 600, truth_every: 50, ..run };
                    with(number as f64, world, settings.clone(), run)
                })
                .collect()
        }
        "promise" => [EyeKind::Still, EyeKind::Walking]
            .into_iter()
            .enumerate()
            .map(|(number, eye)| {
                let world = TrackRules { eye, motion: MotionKind::ALL.to_vec(), ..rules([3, 3], Chairs::PerRoom(3)) };
                let run =
                    RunRules { settle: 0, frames: 20_000, resolution: Resolution::new(64, 64), truth_every: 1, ..run };
                with(number as f64, world, four(options), run)
            })
            .collect(),
        // Without worlds: see `lca_sweep` and `tables`.
        "lca" | "occluders" | "drawing" | "observer" => Vec::new(),
        other => unreachable!("sweep {other} is not in SWEEPS"),
    }
}

/// What the rows of a sweep say.
pub fn findings(name: &str, rows: &[TrackRow]) -> Vec<Finding> {
    let mut findings = Vec::new();
    let mut say = |text: String, met: Option<bool>| findings.push(Finding { text, met });
    let lines = lines(rows);
    match name {
        "static" | "ratio" | "dynamic" | "hidden" | "index" => {
            for (line, rows) in &lines {
                let (first, last) = (rows[0], rows[rows.len() - 1]);
                let grown = last.work / first.work.max(1e-9);
                let bounded = rows[0].variant.starts_with("tbv");
                let met = (name == "hidden" && bounded).then_some(grown < 1.3);
                say(
                    format!(
                        "{line}: from x = {} to {}, work grows {grown:.2} times ({:.0} to {:.0}) and time {:.2} times \
                         ({:.2} to {:.2} ms){}",
                        first.x,
                        last.x,
                        first.work,
                        last.work,
                        last.total_ms / first.total_ms.max(1e-9),
                        first.total_ms,
                        last.total_ms,
                        if met.is_some() { "; the bar is 1.3 for work" } else { "" }
                    ),
                    met,
                );
            }
        }
        "lca" => return super::lca_sweep::findings(rows),
        "occluders" | "drawing" | "observer" => return super::tables::findings(name, rows),
        "fuzzy" => {
            let tbv = |share: f64| rows.iter().find(|row| row.variant == "tbv-e" && row.violated == share);
            let hzb = rows.iter().find(|row| row.variant == "every-object");
            if let (Some(none), Some(fifth), Some(all), Some(hzb)) = (tbv(0.0), tbv(0.2), tbv(1.0), hzb) {
                let limit = none.work + 0.3 * (hzb.work - none.work);
                say(
                    format!(
                        "work with 20 % broken: {:.0}; with none {:.0}, every object {:.0}; the bar is {limit:.0}",
                        fifth.work, none.work, hzb.work
                    ),
                    Some(fifth.work <= limit),
                );
                let ratio = all.work / hzb.work;
                say(
                    format!("work with all broken: {:.0}, {ratio:.2} times every object's; the bar is 1.25", all.work),
                    Some(ratio <= 1.25),
                );
            }
        }
        "calibrated" => {
            let hard = rows.iter().find(|row| row.fuzzy == 0.0);
            for row in rows {
                let of_hard = hard.map_or(1.0, |hard| row.hidden_caused_per_frame / hard.hidden_caused_per_frame);
                // The one that the issue names.
                let has_bar = row.fuzzy == 0.01;
                say(
                    format!(
                        "probability {}: {:.3} % of {} TBVs made at regular times were broken, {:.2} of those in use a frame; {:.2} \
                         messages of hidden objects a frame, {of_hard:.2} times the hard bounds'{}",
                        row.fuzzy,
                        row.broken_share * 100.0,
                        row.tried_bounds,
                        row.violated_per_frame,
                        row.hidden_caused_per_frame,
                        if has_bar { "; the bar is 0.5 to 1.5 % of at least 10,000" } else { "" }
                    ),
                    has_bar.then_some(row.tried_bounds >= 10_000 && (0.005..=0.015).contains(&row.broken_share)),
                );
            }
        }
        "messages" => {
            for (line, rows) in &lines {
                let all = |row: &TrackRow| row.updates_per_frame + row.bounds_per_frame;
                let (first, last) = (rows[0], rows[rows.len() - 1]);
                say(
                    format!(
                        "{line}: {:.1} messages a frame with {} hidden, {:.1} with {}",
                        all(first),
                        first.x,
                        all(last),
                        last.x
                    ),
                    None,
                );
            }
        }
        "growth" => {
            for (line, rows) in &lines {
                let exponent = exponent(rows.iter().map(|row| (row.x, row.hidden_caused_per_frame)));
                say(
                    format!("{line}: messages that hidden objects cause grow like x^{exponent:.2}; the bar is 0.55"),
                    Some(exponent <= 0.55),
                );
            }
        }
        "shapes" => {
            for kind in ["preset", "smooth", "random"] {
                let of = |shape: &str| rows.iter().find(|row| row.motion == kind && row.shape == shape);
                let Some(sphere) = of("sphere") else { continue };
                for row in rows.iter().filter(|row| row.motion == kind && row.shape != "sphere") {
                    let times = |a: f64, b: f64| if b > 0.0 { a / b } else { f64::NAN };
                    say(
                        format!(
                            "{kind} motion, {}: {:.2} times the sphere's work, {:.2} times its time, {:.2} times its \
                             messages{}",
                            row.shape,
                            times(row.work, sphere.work),
                            times(row.frame_ms, sphere.frame_ms),
                            times(
                                row.updates_per_frame + row.bounds_per_frame,
                                sphere.updates_per_frame + sphere.bounds_per_frame
                            ),
                            if row.shape.starts_with("swept") && row.work > sphere.work {
                                ": swept volumes lose here, as the paper found"
                            } else {
                                ""
                            }
                        ),
                        None,
                    );
                }
            }
        }
        "validity" => {
            for eye in ["still", "walking"] {
                let mut of: Vec<&TrackRow> = rows.iter().filter(|row| row.eye == eye).collect();
                of.sort_by(|a, b| a.hidden_caused_per_frame.total_cmp(&b.hidden_caused_per_frame));
                let list: Vec<String> =
                    of.iter().map(|row| format!("{} {:.2}", row.validity, row.hidden_caused_per_frame)).collect();
                say(format!("{eye} eye, messages of hidden objects a frame, fewest first: {}", list.join(", ")), None);
            }
        }
        "promise" => {
            for row in rows {
                say(
                    format!(
                        "{}, {}, {} eye: {} frames, at most {} wrong pixels, {} absences, at most {} frames running, {} \
                         other wrong pixels",
                        row.culler,
                        row.variant,
                        row.eye,
                        row.truth_frames,
                        row.wrong_pixels_max,
                        row.absences,
                        row.absent_frames_max,
                        row.other_wrong_pixels_max
                    ),
                    Some(row.ok),
                );
            }
        }
        _ => {}
    }
    findings
}

/// Rows that differ in x alone, by what they share.
pub fn lines(rows: &[TrackRow]) -> Vec<(String, Vec<&TrackRow>)> {
    let mut lines: Vec<(String, Vec<&TrackRow>)> = Vec::new();
    for row in rows {
        let mut name = row.variant.clone();
        if !row.culler.is_empty() {
            name = format!("{} · {name}", row.culler);
        }
        let many = |of: fn(&TrackRow) -> &str| rows.iter().any(|other| of(other) != of(row) && !of(other).is_empty());
        if many(|row| &row.validity) && !row.validity.is_empty() {
            name += &format!(" · {}", row.validity);
        }
        if many(|row| &row.shape) && !row.shape.is_empty() {
            name += &format!(" · {}", row.shape);
        }
        if many(|row| &row.index) && !row.index.is_empty() {
            name += &format!(" · {}", row.index);
        }
        match lines.iter_mut().find(|(known, _)| *known == name) {
            Some((_, rows)) => rows.push(row),
            None => lines.push((name, vec![row])),
        }
    }
    lines
}

/// The slope of the least-squares line through the logarithms of some points. Points without a logarithm are left out.
pub fn exponent(points: impl Iterator<Item = (f64, f64)>) -> f64 {
    let logs: Vec<(f64, f64)> = points.filter(|(x, y)| *x > 0.0 && *y > 0.0).map(|(x, y)| (x.ln(), y.ln())).collect();
    let count = logs.len() as f64;
    let (mean_x, mean_y) =
        (logs.iter().map(|p| p.0).sum::<f64>() / count, logs.iter().map(|p| p.1).sum::<f64>() / count);
    let covariance: f64 = logs.iter().map(|p| (p.0 - mean_x) * (p.1 - mean_y)).sum();
    covariance / logs.iter().map(|p| (p.0 - mean_x).powi(2)).sum::<f64>()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_exponent_is_the_slope_of_logarithms() {
        let root = exponent([1.0, 10.0, 100.0].map(|x: f64| (x, 3.0 * x.sqrt())).into_iter());
        assert!((root - 0.5).abs() < 1e-12);
        assert!(exponent([(1.0, 2.0), (4.0, 8.0), (0.0, 1.0)].into_iter()) - 1.0 < 1e-12);
    }

    #[test]
    fn every_sweep_has_points_and_baselines() {
        for info in SWEEPS {
            let points = points(info.name, &SweepOptions::default());
            let has_world = info.name != "lca" && !crate::track::tables::SWEEPS.contains(&info.name);
            assert_eq!(has_world, !points.is_empty(), "{}", info.name);
            assert!(points.iter().all(|point| !point.settings.is_empty()), "{}", info.name);
        }
    }
}
