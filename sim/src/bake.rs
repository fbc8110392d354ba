//! Which cells may be seen from which? The table of the policy `pvs`, made ahead.
//!
//! In each column of cells eyes are *sampled* where an avatar could stand: above every floor that rays find, with room for its
//! cylinder. From each eye the culler draws the static world, and every cell whose cube is not certainly hidden counts as
//! seen. For one eye that misses nothing; between eyes it may, so a table is not a promise, and says how many eyes it had.
//!
//! Most eyes stand on the border of their column. What is seen from within an empty cell and lies beyond it is seen along
//! a line that leaves through the border, so the border sees what the inside sees, but for the change of height on the way.
//!
//! A cell that no eye was in has the sets of its neighbours, and everything if they have none.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Mutex, PoisonError};

use eyeline_server::policy::{CellGrid, CellSet, PvsFacts, PvsTable};
use eyeline_server::spec::AvatarSpec;
use eyeline_visibility::{Aabb, AllRoundScratch, Bound, EyeRegion, Occlusion, RayScene};
use glam::{DVec3, UVec3};
use rand::RngExt;
use rand_pcg::Pcg64;

use crate::chance;
use crate::report::Progress;
use crate::stage::Stage;

/// What a table is made by.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BakeConfig {
    /// Side of a cell, metres. Default 3. Half of it hides more, and costs eight times the cells.
    pub cell: f64,
    /// Eyes in each column of cells, on each of its floors. Default 16; more miss less and cost time in proportion.
    pub samples: u32,
    /// Decides where eyes stand. Default 7.
    pub seed: u64,
}

impl Default for BakeConfig {
    fn default() -> BakeConfig {
        BakeConfig { cell: 3.0, samples: 16, seed: 7 }
    }
}

/// Makes a table. Uses every core; the result does not depend on how many there are.
///
/// # Errors
/// If the cells are too many or the table would be too large.
pub fn bake(stage: &Stage, config: &BakeConfig) -> anyhow::Result<PvsTable> {
    let bounds = stage.model.scene.bounds().inflated(MARGIN);
    let grid = CellGrid::covering(bounds.min, bounds.max, stage.anchor(), config.cell)?;
    let columns = grid.size().x * grid.size().z;
    let baker = Baker { stage, config, grid, floors: Floors::new(stage), spawns: spawns(stage, &grid) };
    let progress = Progress::new(u64::from(columns), "baking cells");
    let rows = Mutex::new(vec![None; grid.cells() as usize]);
    let eyes = Mutex::new(0);
    let next = AtomicU32::new(0);
    let workers = std::thread::available_parallelism().map_or(1, |cores| cores.get());
    std::thread::scope(|scope| {
        for _ in 0..workers {
            scope.spawn(|| {
                let mut scratch = stage.all_round.scratch(SIDE);
                loop {
                    let column = next.fetch_add(1, Ordering::Relaxed);
                    if column >= columns {
                        break;
                    }
                    let (seen, count) = baker.column(column, &mut scratch);
                    let mut rows = rows.lock().unwrap_or_else(PoisonError::into_inner);
                    for (cell, row) in seen {
                        rows[cell as usize] = Some(row);
                    }
                    *eyes.lock().unwrap_or_else(PoisonError::into_inner) += count;
                    progress.inc(1);
                }
            });
        }
    });
    progress.finish();
    let sampled = rows.into_inner().unwrap_or_else(PoisonError::into_inner);
    let facts = PvsFacts {
        samples: config.samples,
        eyes: eyes.into_inner().unwrap_or_else(PoisonError::into_inner),
        cells_seen_from: sampled.iter().flatten().count() as u32,
    };
    Ok(PvsTable::new(stage.model.info.hash, grid, facts, |cell| inherited(&grid, &sampled, cell))?)
}

/// Pixels a side of the cube that is culled on: as fine as a client's.
const SIDE: u32 = 128;

/// How far cells reach beyond the scene at least, metres: feet on its lowest floor may be rounded below it.
const MARGIN: f64 = 0.1;

/// Share of the eyes that stand on the border of their column.
const BORDER_SHARE: f64 = 0.75;

/// Steps from the border inward until there is room to stand.
const INWARD_STEPS: u32 = 8;

/// Most floors above each other; what is more is a fence seen from above.
const FLOORS_MAX: usize = 64;

/// A stream of chance of the bake's own.
const PURPOSE: u64 = 0x7076_7300_0000_0000;

/// Eyes at the places where avatars start, by column: there they will be.
fn spawns(stage: &Stage, grid: &CellGrid) -> BTreeMap<u32, Vec<DVec3>> {
    let height = DVec3::Y * stage.model.spec.avatar.eye_height - stage.anchor();
    let mut by_column = BTreeMap::<u32, Vec<DVec3>>::new();
    for spawn in &stage.model.spec.spawns {
        let eye = DVec3::from_array(spawn.position) + height;
        if let Some(cell) = grid.at(eye) {
            let UVec3 { x, z, .. } = grid.coordinates(cell);
            by_column.entry(z * grid.size().x + x).or_default().push(eye);
        }
    }
    by_column
}

/// The set of a cell: its own if an eye was in it, else what its neighbours see and themselves.
fn inherited(grid: &CellGrid, sampled: &[Option<CellSet>], cell: u32) -> Option<CellSet> {
    if let Some(own) = &sampled[cell as usize] {
        return Some(own.clone());
    }
    let at = grid.coordinates(cell);
    let (low, high) = (at.saturating_sub(UVec3::ONE), (at + 1).min(grid.size() - 1));
    let mut set: Option<CellSet> = None;
    let mut around = CellSet::new(grid.cells());
    for y in low.y..=high.y {
        for z in low.z..=high.z {
            for x in low.x..=high.x {
                let neighbour = grid.index(UVec3::new(x, y, z));
                around.insert(neighbour);
                if let Some(row) = &sampled[neighbour as usize] {
                    set.get_or_insert_with(|| CellSet::new(grid.cells())).union(row);
                }
            }
        }
    }
    if let Some(set) = &mut set {
        set.union(&around);
    }
    set
}

struct Baker<'a> {
    stage: &'a Stage,
    config: &'a BakeConfig,
    grid: CellGrid,
    floors: Floors,
    spawns: BTreeMap<u32, Vec<DVec3>>,
}

impl Baker<'_> {
    /// What is seen from the cells of a column in which an eye could be, and the number of eyes.
    fn column(&self, column: u32, scratch: &mut AllRoundScratch) -> (BTreeMap<u32, CellSet>, u64) {
        let mut seen = BTreeMap::new();
        let eyes = self.eyes(column);
        for &eye in &eyes {
            let Some(cell) = self.grid.at(eye) else { continue };
            // A point is a region that is never refused.
            let Ok(occlusion) = self.stage.all_round.cull(EyeRegion::point(eye), scratch) else { continue };
            let row = seen.entry(cell).or_insert_with(|| CellSet::new(self.grid.cells()));
            self.look(occlusion, UVec3::ZERO, self.grid.size() - 1, row);
        }
        (seen, eyes.len() as u64)
    }

    fn eyes(&self, column: u32) -> Vec<DVec3> {
        let mut chance: Pcg64 = chance(self.config.seed, PURPOSE + u64::from(column));
        let at = UVec3::new(column % self.grid.size().x, 0, column / self.grid.size().x);
        let (low, high) = self.grid.corners(at, at);
        let middle = (low + high) * 0.5;
        let mut eyes = self.spawns.get(&column).cloned().unwrap_or_default();
        let on_border = (f64::from(self.config.samples) * BORDER_SHARE).ceil() as u32;
        for sample in 0..self.config.samples {
            let mut share = DVec3::new(chance.random(), 0.0, chance.random());
            let is_border = sample < on_border;
            if is_border {
                // Evenly around the border, each somewhere in its piece; just inside, so that the eye is in this column.
                let around = (f64::from(sample) + share.x) / f64::from(on_border) * 4.0;
                let along = around.fract().clamp(1e-6, 1.0 - 1e-6);
                (share.x, share.z) = match around as u32 {
                    0 => (along, 1e-6),
                    1 => (1.0 - 1e-6, along),
                    2 => (along, 1.0 - 1e-6),
                    _ => (1e-6, along),
                };
            }
            let place = low + (high - low) * share;
            let steps = if is_border { INWARD_STEPS } else { 1 };
            let mut inward =
                (0..steps).map(|step| self.floors.eyes(place.lerp(middle, f64::from(step) / f64::from(INWARD_STEPS))));
            eyes.extend(inward.find(|found| !found.is_empty()).into_iter().flatten());
        }
        eyes.retain(|&eye| self.grid.at(eye).is_some());
        eyes
    }

    /// Adds to `row` the cells between two corners that are not hidden. Blocks first: most of a world is hidden at once.
    fn look(&self, occlusion: &impl Occlusion, low: UVec3, high: UVec3, row: &mut CellSet) {
        let is_one = low == high;
        if is_one && row.contains(self.grid.index(low)) {
            return;
        }
        let (min, max) = self.grid.corners(low, high);
        if occlusion.hides(&Bound::Box(Aabb::new(min, max))) {
            return;
        }
        if is_one {
            return row.insert(self.grid.index(low));
        }
        let span = high - low;
        let axis = (0..3).fold(0, |longest, axis| if span[axis] > span[longest] { axis } else { longest });
        let half = low[axis] + span[axis] / 2;
        let (mut below, mut above) = (high, low);
        below[axis] = half;
        above[axis] = half + 1;
        self.look(occlusion, low, below, row);
        self.look(occlusion, above, high, row);
    }
}

/// Where avatars could stand, by rays.
struct Floors {
    rays: RayScene,
    bounds: Aabb,
    avatar: AvatarSpec,
}

impl Floors {
    fn new(stage: &Stage) -> Floors {
        let scene = &stage.model.scene;
        Floors { rays: RayScene::new(scene), bounds: scene.bounds(), avatar: stage.model.spec.avatar }
    }

    /// The eyes of an avatar that stands at this place in plan, one for each floor with room for it.
    fn eyes(&self, place: DVec3) -> Vec<DVec3> {
        let mut eyes = Vec::new();
        if self.bounds.is_empty() {
            return eyes;
        }
        let top = place.with_y(self.bounds.max.y + 1.0);
        let mut below = 0.0;
        for _ in 0..FLOORS_MAX {
            let Some(hit) = self.rays.first_hit(top, DVec3::NEG_Y, below, f64::INFINITY) else { break };
            below = hit.t + 1e-3;
            let feet = top + DVec3::NEG_Y * hit.t;
            if self.has_room(feet) {
                eyes.push(feet + DVec3::Y * self.avatar.eye_height);
            }
        }
        eyes
    }

    /// Whether an avatar's cylinder fits above a floor, by rays up its axis and outward from it at the knee and the eye.
    fn has_room(&self, feet: DVec3) -> bool {
        let AvatarSpec { radius, height, eye_height, .. } = self.avatar;
        let is_free = |from, way, reach| self.rays.first_hit(from, way, 0.0, reach).is_none();
        // From a hair above the floor, which the ray would else start on.
        is_free(feet + DVec3::Y * 1e-3, DVec3::Y, height)
            && [0.3 * height, eye_height].iter().all(|&up| {
                (0..8).all(|eighth| {
                    let (sin, cos) = (f64::from(eighth) * std::f64::consts::FRAC_PI_4).sin_cos();
                    is_free(feet + DVec3::Y * up, DVec3::new(cos, 0.0, sin), radius)
                })
            })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::plan::RoomsRules;

    fn stage(columns: u32, rows: u32) -> Stage {
        Stage::made(&RoomsRules { columns, rows, seed: 3, ..RoomsRules::default() }).unwrap()
    }

    fn cell(table: &PvsTable, stage: &Stage, x: f64, y: f64, z: f64) -> u32 {
        table.grid().at(DVec3::new(x, y, z) - stage.anchor()).unwrap()
    }

    #[test]
    fn neighbouring_rooms_are_seen_and_most_others_are_not() {
        let stage = stage(5, 5);
        let table = bake(&stage, &BakeConfig { samples: 6, ..BakeConfig::default() }).unwrap();
        let middle = |column: u32, row: u32| {
            cell(&table, &stage, f64::from(column) * 6.0 + 1.5, 1.6, f64::from(row) * 6.0 + 1.5)
        };
        let mut pairs = 0;
        let mut seen = 0;
        for from in 0..25 {
            for to in 0..25 {
                let sees = table.sees(middle(from % 5, from / 5), middle(to % 5, to / 5));
                assert!(from != to || sees, "a cell sees itself");
                pairs += 1;
                seen += u32::from(sees);
            }
        }
        assert!((50..pairs / 2).contains(&seen), "{seen} of {pairs}");
        assert!(table.facts().eyes > 600 && table.facts().cells_seen_from >= 100, "{:?}", table.facts());
    }

    #[test]
    fn nothing_that_an_eye_of_it_sees_is_missing() {
        let stage = stage(3, 3);
        let config = BakeConfig { samples: 3, cell: 2.0, seed: 4 };
        let table = bake(&stage, &config).unwrap();
        let grid = *table.grid();
        let baker =
            Baker { stage: &stage, config: &config, grid, floors: Floors::new(&stage), spawns: BTreeMap::new() };
        let rays = RayScene::new(&stage.model.scene);
        let mut lines = 0;
        for column in 0..grid.size().x * grid.size().z {
            for eye in baker.eyes(column) {
                // A cell is seen if a ray reaches its middle.
                for to in 0..grid.cells() {
                    let (low, high) = grid.corners(grid.coordinates(to), grid.coordinates(to));
                    let way = (low + high) * 0.5 - eye;
                    if rays.first_hit(eye, way, 0.0, 1.0).is_none() {
                        lines += 1;
                        assert!(table.sees(grid.at(eye).unwrap(), to), "{eye} sees the middle of cell {to}");
                    }
                }
            }
        }
        assert!(lines > 1000, "{lines}");
    }

    #[test]
    fn the_same_seed_gives_the_same_table() {
        let stage = stage(2, 2);
        let bytes = |seed| bake(&stage, &BakeConfig { samples: 2, seed, ..BakeConfig::default() }).unwrap().encode();
        assert_eq!(bytes(1), bytes(1));
        assert_ne!(bytes(1), bytes(2));
    }

    #[test]
    fn eyes_stand_on_every_storey_and_not_within_walls() {
        use eyeline_visibility::{Scene, Sides, Triangle};
        // Floors at 0 and 4 m, and a wall at x = 0 between them.
        let quad = |corners: [[f32; 3]; 4]| {
            let [a, b, c, d] = corners.map(glam::Vec3::from);
            [[a, b, c], [a, c, d]].map(|corners| Triangle { corners, sides: Sides::Both, occludes: true })
        };
        let floor = |y: f32| quad([[-5.0, y, -5.0], [5.0, y, -5.0], [5.0, y, 5.0], [-5.0, y, 5.0]]);
        let wall = quad([[0.0, 0.0, -5.0], [0.0, 4.0, -5.0], [0.0, 4.0, 5.0], [0.0, 0.0, 5.0]]);
        let scene = Scene::from_triangles([floor(0.0), floor(4.0), wall].concat());
        let avatar = AvatarSpec::default();
        let floors = Floors { rays: RayScene::new(&scene), bounds: scene.bounds(), avatar };
        let heights = |x: f64| -> Vec<f64> { floors.eyes(DVec3::new(x, 0.0, 1.0)).iter().map(|eye| eye.y).collect() };
        assert_eq!(heights(2.0), [4.0 + avatar.eye_height, avatar.eye_height]);
        assert_eq!(heights(0.2), [4.0 + avatar.eye_height], "no room beside the wall");
        assert_eq!(heights(9.0), [0.0; 0], "no floor");
    }

    #[test]
    fn a_cell_without_eyes_has_its_neighbours_sets_or_everything() {
        let grid = CellGrid::covering(DVec3::ZERO, DVec3::new(9.5, 0.5, 0.5), DVec3::ZERO, 1.0).unwrap();
        let mut sampled = vec![None; 10];
        let mut row = CellSet::new(10);
        [2, 7].into_iter().for_each(|cell| row.insert(cell));
        sampled[2] = Some(row);
        let runs = |cell| inherited(&grid, &sampled, cell).map(|set| set.runs());
        assert_eq!(runs(2), Some(vec![(2, 1), (7, 1)]));
        assert_eq!(runs(1), Some(vec![(0, 3), (7, 1)]));
        assert_eq!(runs(4), None);
    }

    #[test]
    fn a_scene_without_triangles_is_refused() {
        let mut stage = stage(1, 1);
        stage.model.scene = std::sync::Arc::new(eyeline_visibility::Scene::from_triangles(Vec::new()));
        assert!(bake(&stage, &BakeConfig::default()).unwrap_err().to_string().contains("cells"));
    }
}
