//! Has a scene storeys, and where do their walls stand? What [`crate::Prisms`] are made from.
//!
//! A *level* is a height at which much lies level: at least [`LEVEL_SHARE`] of what the largest level has, facing up (a floor)
//! or down (a ceiling). A storey is a floor with the nearest ceiling at least [`HEIGHT_MIN`] above it. A scene of stairs,
//! arches or terraces has such pairs by chance, so floors of storeys must also be at least half of all that faces up below the
//! highest ceiling; between a floor and its ceiling less may lie level than half of the floor (a gallery, a stair and a crate are
//! not furniture); and at most a quarter of all area may be neither level nor upright (vaults, slopes). Walls are upright triangles that reach over most of a storey's height: furniture is lower.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use glam::{DVec2, DVec3};

use crate::{Scene, Sides};

/// Share of the largest level's area that makes a level a floor or a ceiling.
const LEVEL_SHARE: f64 = 0.25;
/// Share of the largest level's area that makes it count as something that faces up: less is furniture.
const COUNTED_SHARE: f64 = 0.05;
/// Least height of a storey in metres.
const HEIGHT_MIN: f64 = 1.8;
/// Share of all that faces up, below the highest ceiling, that storeys' floors must be.
const FLOORS_SHARE: f64 = 0.5;
/// Share of a floor that may lie level between it and its ceiling. Counted: `rooms`, `building` and `tower` have at most 0.09, a
/// real building 0.25, each of three game maps a storey with 0.7 or more.
const BETWEEN_SHARE: f64 = 0.5;
/// Share of all area that may be neither level nor upright. Counted: those buildings have none, sponza 0.39.
const SLANTED_SHARE: f64 = 0.25;
/// Share of a storey's height that a wall reaches over.
const WALL_SHARE: f64 = 0.75;
/// Steps per metre of the grid that walls are snapped to.
pub(crate) const GRID: f64 = 1000.0;
/// Metres that a coordinate may reach: on the grid, products of two then are exact in f64.
const REACH_MAX: f64 = 60_000.0;

/// Levels and walls of a scene.
#[derive(Clone, Debug)]
pub(crate) struct Storeys {
    /// Heights of floors and ceilings, ascending, as their triangles have them.
    pub(crate) levels: Vec<f64>,
    /// Ends of walls in plan, x and z, in steps of the grid, each once.
    pub(crate) walls: Vec<[[i64; 2]; 2]>,
    /// By x and by z: where walls across that axis stand exactly, by their step of the grid.
    pub(crate) exact: [BTreeMap<i64, f64>; 2],
    /// Number of storeys.
    pub(crate) count: usize,
}

/// Area that faces up and down at a height, in square metres, and the height itself.
#[derive(Clone, Copy, Debug, Default)]
struct Level {
    up: f64,
    down: f64,
    height: f64,
}

/// Number of storeys and of walls of a scene, or what was counted instead: what a plan says of prisms, without making them.
///
/// # Errors
/// Says what was counted, where the scene is not made of storeys.
pub fn count_storeys(scene: &Scene) -> Result<(usize, usize), String> {
    Storeys::find(scene).map(|found| (found.count, found.walls.len()))
}

impl Storeys {
    /// Finds storeys, or says what was counted instead.
    pub(crate) fn find(scene: &Scene) -> Result<Storeys, String> {
        let bounds = scene.bounds();
        if bounds.is_empty() {
            return Err("the scene has no triangles".to_owned());
        }
        let reach = bounds.min.abs().max(bounds.max.abs()).max_element();
        if reach > REACH_MAX {
            return Err(format!(
                "the scene reaches {reach:.0} m from its anchor, and plans are made up to {REACH_MAX:.0} m"
            ));
        }
        let levels = levels(scene);
        let largest = levels.iter().map(|level| level.up.max(level.down)).fold(0.0, f64::max);
        let floors: Vec<&Level> = levels.iter().filter(|level| level.up > LEVEL_SHARE * largest).collect();
        let ceilings: Vec<&Level> = levels.iter().filter(|level| level.down > LEVEL_SHARE * largest).collect();
        let mut storeys: Vec<[f64; 2]> = Vec::new();
        let mut area = 0.0;
        for floor in &floors {
            let above = ceilings.iter().find(|ceiling| ceiling.height >= floor.height + HEIGHT_MIN);
            if let Some(ceiling) = above {
                storeys.push([floor.height, ceiling.height]);
                area += floor.up;
            }
        }
        let mut counted = format!(
            "{} levels face up and {} down with more than {largest_share:.1} m², a quarter of the largest",
            floors.len(),
            ceilings.len(),
            largest_share = LEVEL_SHARE * largest,
        );
        let Some(top) = storeys.iter().map(|storey| storey[1]).reduce(f64::max) else {
            let _ = write!(counted, "; none has a ceiling at least {HEIGHT_MIN} m above it");
            return Err(counted);
        };
        let counts = |level: &&Level| level.height < top && level.up > COUNTED_SHARE * largest;
        let all: f64 = levels.iter().filter(counts).map(|level| level.up).sum();
        if area < FLOORS_SHARE * all {
            let _ = write!(
                counted,
                "; those with a ceiling hold {area:.0} m² of the {all:.0} m² that face up below {top:.1} m, less than half"
            );
            return Err(counted);
        }
        for &[floor, ceiling] in &storeys {
            // A slab has two levels; what is above its upper one counts.
            if storeys.iter().any(|&[other, above]| above == ceiling && other > floor) {
                continue;
            }
            let up = |from: f64, to: f64| -> f64 {
                let here = levels.iter().filter(|level| level.height >= from && level.height <= to);
                here.map(|level| level.up).sum()
            };
            let (own, between) = (up(floor, floor), up(floor + LEVEL_APART, ceiling - LEVEL_APART));
            if between > BETWEEN_SHARE * own {
                let _ = write!(
                    counted,
                    "; between {floor:.1} and {ceiling:.1} m {between:.0} m² lie level, more than half of the {own:.0} m² of \
                     that floor"
                );
                return Err(counted);
            }
        }
        let slanted = slanted_share(scene);
        if slanted > SLANTED_SHARE {
            let percent = 100.0 * slanted;
            let _ = write!(counted, "; {percent:.0} % of all area is neither level nor upright, more than a quarter");
            return Err(counted);
        }
        let (walls, exact) = walls(scene, &storeys);
        if walls.is_empty() {
            let _ = write!(
                counted,
                "; {} storeys, but no upright triangle reaches over three quarters of one",
                storeys.len()
            );
            return Err(counted);
        }
        let count = storeys.len();
        let mut levels: Vec<f64> = storeys.into_iter().flatten().collect();
        levels.sort_unstable_by(f64::total_cmp);
        levels.dedup();
        Ok(Storeys { levels, walls, exact, count })
    }
}

/// What lies level, by height in steps of the grid.
fn levels(scene: &Scene) -> Vec<Level> {
    let mut levels: BTreeMap<i64, Level> = BTreeMap::new();
    for triangle in scene.triangles().iter().filter(|triangle| triangle.occludes) {
        let [a, b, c] = triangle.corners.map(|corner| corner.as_dvec3());
        if a.y != b.y || b.y != c.y {
            continue;
        }
        let up = (b - a).cross(c - a).y * 0.5;
        let level = levels.entry((a.y * GRID).round() as i64).or_default();
        let both = triangle.sides == Sides::Both;
        level.up += if up > 0.0 || both { up.abs() } else { 0.0 };
        level.down += if up < 0.0 || both { up.abs() } else { 0.0 };
        level.height = a.y;
    }
    levels.into_values().collect()
}

/// Metres within which a level counts as its storey's floor or ceiling.
const LEVEL_APART: f64 = 0.01;

/// Share of all area that is neither level nor upright; 0 of nothing.
fn slanted_share(scene: &Scene) -> f64 {
    let (mut slanted, mut all) = (0.0, 0.0);
    for triangle in scene.triangles().iter().filter(|triangle| triangle.occludes) {
        let corners = triangle.corners.map(|corner| corner.as_dvec3());
        let [a, b, c] = corners;
        let area = (b - a).cross(c - a).length();
        all += area;
        let is_level = a.y == b.y && b.y == c.y;
        if !is_level && !is_upright(corners) {
            slanted += area;
        }
    }
    if all > 0.0 { slanted / all } else { 0.0 }
}

/// Walls in plan, and where those across an axis stand.
#[expect(clippy::type_complexity, reason = "two parts of `Storeys`")]
fn walls(scene: &Scene, storeys: &[[f64; 2]]) -> (Vec<[[i64; 2]; 2]>, [BTreeMap<i64, f64>; 2]) {
    let mut walls = Vec::new();
    let mut exact = [BTreeMap::new(), BTreeMap::new()];
    for triangle in scene.triangles().iter().filter(|triangle| triangle.occludes) {
        let corners = triangle.corners.map(|corner| corner.as_dvec3());
        let heights = corners.map(|corner| corner.y);
        let low = heights.into_iter().fold(f64::INFINITY, f64::min);
        let high = heights.into_iter().fold(f64::NEG_INFINITY, f64::max);
        let reaches =
            |&[floor, ceiling]: &[f64; 2]| high.min(ceiling) - low.max(floor) >= WALL_SHARE * (ceiling - floor);
        if !storeys.iter().any(reaches) || !is_upright(corners) {
            continue;
        }
        let plan = corners.map(|corner| DVec2::new(corner.x, corner.z));
        let ends = [[0, 1], [1, 2], [2, 0]].map(|[i, j]| [plan[i], plan[j]]);
        let longest = |a: &&[DVec2; 2], b: &&[DVec2; 2]| a[0].distance(a[1]).total_cmp(&b[0].distance(b[1]));
        let Some(&[from, to]) = ends.iter().max_by(longest) else { continue };
        let [from_step, to_step] = [from, to].map(|end| (end * GRID).round().to_array().map(|step| step as i64));
        if from_step == to_step {
            continue;
        }
        for axis in 0..2 {
            if plan.iter().all(|end| end[axis] == plan[0][axis]) {
                exact[axis].entry(from_step[axis]).or_insert(plan[0][axis]);
            }
        }
        walls.push([from_step.min(to_step), from_step.max(to_step)]);
    }
    walls.sort_unstable();
    walls.dedup();
    (walls, exact)
}

/// Whether a triangle stands upright: its normal is level to a thousandth.
fn is_upright([a, b, c]: [DVec3; 3]) -> bool {
    let normal = (b - a).cross(c - a);
    normal.y.abs() <= 1e-3 * normal.length()
}
