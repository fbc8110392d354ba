//! How can one core play a thousand people? Most of them see what somebody else saw before.
//!
//! A client's culling by images costs many times its tracking, and a server never notices who culls. So a few people walk a *way*
//! each before the run begins, and of every frame it is recorded where they stood and which places they could see into:
//! the plan of the building is cut into square columns, and a real cull from that eye says of each whether it is hidden.
//! Those who *replay* a way stand in turn where it was recorded, and ask the record instead of an image of their own.
//! Everything else about them is real: connection, session, tracker, requests.
//!
//! A bound is hidden if every column that it touches was. So what the record hides a cull has proved to be hidden, piece by
//! piece. It shows more than a cull at edges, by the width of a column, and hides more where a bound is so large that a cull,
//! asked once about all of it, would have been in doubt. `world_cost record` plays both side by side and tells how much each is told.

use std::sync::Arc;
use std::time::Duration;

use eyeline_client::net::{Driver, FrameReport, Pose};
use eyeline_client::session::Session;
use eyeline_client::tracking::Ahead;
use eyeline_protocol::{LocalTime, ObjectId, Orientation, Position};
use eyeline_visibility::{Aabb, Bound, EyeRegion, Occlusion, Open};
use glam::{DVec2, DVec3};

use crate::motion::WalkerPose;
use crate::people::{FrameHook, Ground, Mover};
use crate::scene::plan::RoomPlan;

/// Side of a column, metres: half of an avatar. With columns of 1 m clients asked and were told far more than those who
/// cull.
const COLUMN: f64 = 0.25;

/// Most columns along a side; a larger world has wider ones.
const COLUMNS_MAX: f64 = 1024.0;

/// By how much bounds are taken to be wider than they are, columns: more than rounding comes to within [`COLUMNS_MAX`].
const HAIR: f64 = 1e-9;

/// How far columns reach beyond the scene, to the sides and up and down, metres: bounds grow through walls and floors, where they
/// are as hidden as behind them.
const BEYOND: DVec3 = DVec3::new(16.0, 64.0, 16.0);

/// Distance of the ways' beginnings from the walls of a room's corner, metres; tables keep clear of it.
const START_INSET: f64 = 0.6;

/// The square columns that a building is cut into. Relative to the world's anchor.
#[derive(Clone, Copy, Debug)]
struct Columns {
    bounds: Aabb,
    side: f64,
    /// Columns in a metre.
    per_metre: f64,
    /// Columns along x.
    width: usize,
    /// Columns along z.
    depth: usize,
}

/// Which columns were in sight: a bit for each in the least rectangle around all that were.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
struct Exposed {
    /// First column of the rectangle along x and z.
    first: (usize, usize),
    /// Columns of the rectangle along x, and rows along z.
    columns: usize,
    rows: usize,
    /// Words of bits of a row along x.
    words: usize,
    bits: Box<[u64]>,
    /// The same of [`BAND`] rows together: whether any of them has the bit. A large bound is told by these alone.
    bands: Box<[u64]>,
}

/// Rows in a band.
const BAND: usize = 8;

impl Exposed {
    fn of(columns: &[(usize, usize)]) -> Exposed {
        let least = |axis: fn(&(usize, usize)) -> usize| columns.iter().map(axis).min().unwrap_or(0);
        let most = |axis: fn(&(usize, usize)) -> usize| columns.iter().map(axis).max().map_or(0, |most| most + 1);
        let first = (least(|c| c.0), least(|c| c.1));
        let rows = most(|c| c.1) - first.1;
        let width = most(|c| c.0) - first.0;
        let words = width.div_ceil(64);
        let mut bits = vec![0; words * rows].into_boxed_slice();
        for &(x, z) in columns {
            bits[(z - first.1) * words + (x - first.0) / 64] |= 1 << ((x - first.0) % 64);
        }
        let mut bands = vec![0; words * rows.div_ceil(BAND)].into_boxed_slice();
        for (at, word) in bits.iter().enumerate() {
            bands[at / words / BAND * words + at % words] |= word;
        }
        Exposed { first, columns: width, rows, words, bits, bands }
    }

    /// Whether any column of the ranges (ends included) was in sight.
    #[cfg(test)]
    fn any(&self, x: (usize, usize), z: (usize, usize)) -> bool {
        (0..self.rows).filter(|row| (z.0..=z.1).contains(&(self.first.1 + row))).any(|row| self.any_in_row(row, x))
    }

    /// Whether this column was in sight.
    fn has(&self, x: usize, z: usize) -> bool {
        let (x, row) = (x.wrapping_sub(self.first.0), z.wrapping_sub(self.first.1));
        x < self.columns && row < self.rows && self.bits[row * self.words + x / 64] >> (x % 64) & 1 == 1
    }

    /// Whether any column of the range (ends included) was in sight, in this row of the rectangle.
    fn any_in_row(&self, row: usize, x: (usize, usize)) -> bool {
        self.any_in(&self.bits[row * self.words..][..self.words], x)
    }

    /// The same of all rows of a band.
    fn any_in_band(&self, band: usize, x: (usize, usize)) -> bool {
        self.any_in(&self.bands[band * self.words..][..self.words], x)
    }

    fn any_in(&self, bits: &[u64], x: (usize, usize)) -> bool {
        let end = self.first.0 + self.columns;
        if x.1 < self.first.0 || x.0 >= end {
            return false;
        }
        let (left, right) = (x.0.saturating_sub(self.first.0), x.1.min(end - 1) - self.first.0);
        (left / 64..=right / 64).any(|word| {
            let low = if word == left / 64 { left % 64 } else { 0 };
            let high = if word == right / 64 { right % 64 } else { 63 };
            bits[word] & (u64::MAX << low) & (u64::MAX >> (63 - high)) != 0
        })
    }
}

impl Columns {
    fn around(scene: Aabb) -> Columns {
        let bounds = Aabb::new(scene.min - BEYOND, scene.max + BEYOND);
        let size = bounds.size();
        let side = COLUMN.max(size.x.max(size.z) / COLUMNS_MAX);
        let count = |length: f64| (length / side).ceil().max(1.0) as usize;
        let (width, depth) = (count(size.x), count(size.z));
        Columns { bounds, side, per_metre: side.recip(), width, depth }
    }

    /// The box around columns `x` and `z` (half-open ranges).
    fn aabb(&self, x: (usize, usize), z: (usize, usize)) -> Aabb {
        let Aabb { min, max } = self.bounds;
        let at = |x: usize, z: usize| DVec2::new(min.x + self.side * x as f64, min.z + self.side * z as f64);
        let (low, high) = (at(x.0, z.0), at(x.1, z.1));
        Aabb::new(DVec3::new(low.x, min.y, low.y), DVec3::new(high.x, max.y, high.y))
    }

    /// Which columns `occlusion` does not hide whole.
    fn exposed(&self, occlusion: &dyn Occlusion) -> Exposed {
        let mut exposed = Vec::new();
        // Most of a building is out of sight, so halves are asked about first, then their halves.
        let mut open = vec![((0, self.width), (0, self.depth))];
        while let Some((x, z)) = open.pop() {
            if occlusion.hides(&Bound::Box(self.aabb(x, z))) {
                continue;
            }
            match (x.1 - x.0, z.1 - z.0) {
                (1, 1) => exposed.push((x.0, z.0)),
                (width, depth) if width >= depth => {
                    let middle = x.0 + width / 2;
                    open.extend([((x.0, middle), z), ((middle, x.1), z)]);
                }
                (_, depth) => {
                    let middle = z.0 + depth / 2;
                    open.extend([(x, (z.0, middle)), (x, (middle, z.1))]);
                }
            }
        }
        Exposed::of(&exposed)
    }

    /// Whether all that `bound` touches was hidden in `exposed`. What reaches beyond all columns is not.
    fn hides(&self, exposed: &Exposed, bound: &Bound) -> bool {
        // From above what is round fills its square to four fifths.
        let (centre, half, is_round) = match *bound {
            Bound::Upright { centre, radius, half_height } => (centre, DVec3::new(radius, half_height, radius), true),
            Bound::Sphere { centre, radius } => (centre, DVec3::splat(radius), true),
            Bound::Box(aabb) => (aabb.centre(), 0.5 * aabb.size(), false),
            Bound::Everywhere => return false,
        };
        // In columns from here on, and a hair wider, so that rounding leaves out no column that is touched.
        let (middle, half) = ((centre - self.bounds.min) * self.per_metre, half * self.per_metre);
        let (from, to) = (middle - half - HAIR, middle + half + HAIR);
        let is_known = from.cmpge(DVec3::ZERO).all() && to.cmple(self.bounds.size() * self.per_metre).all();
        if !(is_known && half.cmpge(DVec3::ZERO).all()) {
            return false;
        }
        // Half of all questions are about what is in sight, and its middle mostly is too.
        if exposed.has(middle.x as usize, middle.z as usize) {
            return false;
        }
        let column = |at: f64| (at.max(0.0) as usize).min(self.width - 1);
        let (near, far) = (from.z as usize, to.z as usize);
        let end = exposed.first.1 + exposed.rows;
        if exposed.rows == 0 || far < exposed.first.1 || near >= end {
            return true;
        }
        let rows = near.max(exposed.first.1) - exposed.first.1..(far + 1).min(end) - exposed.first.1;
        let square = (column(from.x), column(to.x));
        // Columns that it touches in rows `first` to `end` of the rectangle, at most: of what is round its widest chord there.
        let chord = |first: usize, end: usize| {
            if !is_round {
                return square;
            }
            let (z, radius) = (middle.z - exposed.first.1 as f64, half.x * (1.0 + 1e-9) + HAIR);
            let off = (first as f64 - z).max(z - end as f64).max(0.0);
            let across = (radius * radius - off * off).max(0.0).sqrt() + HAIR;
            (column((middle.x - across).max(from.x)), column((middle.x + across).min(to.x)))
        };
        !(rows.start / BAND..rows.end.div_ceil(BAND)).any(|band| {
            let mut own = rows.start.max(band * BAND)..rows.end.min((band + 1) * BAND);
            exposed.any_in_band(band, square)
                && exposed.any_in_band(band, chord(own.start, own.end))
                && own.any(|row| exposed.any_in_row(row, chord(row, row + 1)))
        })
    }

    /// The box around all that was in sight, a hair wider.
    fn open(&self, exposed: &Exposed) -> Aabb {
        if exposed.columns == 0 {
            return Aabb::EMPTY;
        }
        let Exposed { first, columns, rows, .. } = *exposed;
        self.aabb((first.0, first.0 + columns), (first.1, first.1 + rows)).inflated(1e-6)
    }
}

/// One recorded frame: where somebody was, and by which of the record's culls which columns were in sight.
struct Seen {
    pose: WalkerPose,
    cull: usize,
}

/// Recorded ways, shared by all who replay them.
pub struct Ways {
    columns: Columns,
    anchor: DVec3,
    period: Duration,
    ways: Vec<Vec<Seen>>,
    /// What was in sight by each cull.
    culls: Vec<Exposed>,
}

/// How to record.
#[derive(Clone, Copy, Debug)]
pub struct WayRules {
    /// How many ways.
    pub ways: usize,
    /// Frames of each.
    pub frames: usize,
    /// Time between frames.
    pub period: Duration,
    /// Pixels a side of the images of the culls.
    pub side: u32,
    /// Half of the walk that one cull does for, metres ([`Person::with_hold`](crate::people::Person::with_hold)).
    pub hold: f64,
    /// Decides who walks where.
    pub seed: u64,
}

impl Ways {
    /// Walks and looks. `bounds` is the box around the static scene, relative to the anchor. Each way is a cull a frame:
    /// where a cull takes 0.5 ms, 64 ways of 400 frames take 13 s.
    ///
    /// # Errors
    /// If there are no rooms to walk in, or nobody can walk there.
    pub fn record(ground: &Ground, bounds: Aabb, rules: &WayRules) -> anyhow::Result<Ways> {
        let Some(plan) = &ground.plan else {
            anyhow::bail!("recorded ways need rooms to walk in: give --world FILE with NAME.rooms.json beside it")
        };
        let columns = Columns::around(bounds);
        let mut scratch = ground.all_round.scratch(rules.side);
        let mut ways = Vec::with_capacity(rules.ways);
        let mut culls = Vec::new();
        for number in 0..rules.ways {
            // Of a world of storeys the lowest; made rooms stand at 0.
            let start = start_of(plan, number, rules.ways);
            let mut mover = Mover::new(Some(plan), ground.avatar, rules.seed, number, start)?;
            let mut way = Vec::with_capacity(rules.frames);
            let mut version = None;
            let mut before: Option<DVec3> = None;
            for frame in 0..rules.frames {
                let pose = mover.step(if frame == 0 { 0.0 } else { rules.period.as_secs_f64() });
                let gone = before.replace(pose.eye).map_or(DVec3::ZERO, |before| pose.eye - before);
                let eye = EyeRegion::point(pose.eye - ground.anchor);
                let occlusion = ground.all_round.look_around(eye, (rules.hold, gone), &mut scratch)?;
                if version.replace(occlusion.version()) != Some(occlusion.version()) {
                    culls.push(columns.exposed(occlusion));
                }
                way.push(Seen { pose, cull: culls.len() - 1 });
            }
            ways.push(way);
        }
        Ok(Ways { columns, anchor: ground.anchor, period: rules.period, ways, culls })
    }

    /// Bytes of the record.
    pub fn bytes(&self) -> usize {
        let frames: usize = self.ways.iter().map(Vec::len).sum();
        let of = |exposed: &Exposed| size_of::<Exposed>() + 8 * (exposed.bits.len() + exposed.bands.len());
        frames * size_of::<Seen>() + self.culls.iter().map(of).sum::<usize>()
    }
}

/// Where a way begins: the rooms are shared out evenly.
fn start_of(plan: &RoomPlan, number: usize, ways: usize) -> DVec3 {
    let room = &plan.rooms[number * plan.rooms.len() / ways.max(1) % plan.rooms.len()];
    let corner = room.clear.grown(-START_INSET).corners()[number % 4];
    DVec3::new(corner.x, 0.0, corner.y)
}

/// Somebody who walks a recorded way to its end and back, again and again.
pub struct Replayer {
    ways: Arc<Ways>,
    way: usize,
    /// Frame of the way and back at which to begin.
    offset: usize,
    began: Option<LocalTime>,
    /// Frame of the way whose record holds.
    frame: usize,
    /// Whether the avatar stands where its owner says.
    has_placed: bool,
    object: ObjectId,
    hook: Option<FrameHook>,
}

impl Replayer {
    /// The `number`th of `count` people, who are shared out evenly over the ways and along each.
    pub fn new(ways: Arc<Ways>, number: usize, count: usize, hook: Option<FrameHook>) -> Replayer {
        let of_a_way = count.div_ceil(ways.ways.len().max(1)).max(1);
        let way = number % ways.ways.len();
        let offset = number / ways.ways.len() * 2 * ways.ways[way].len() / of_a_way;
        let object = ObjectId(0);
        Replayer { ways, way, offset, began: None, frame: 0, has_placed: false, object, hook }
    }

    fn seen(&self) -> &Seen {
        &self.ways.ways[self.way][self.frame]
    }

    fn exposed(&self) -> &Exposed {
        &self.ways.culls[self.seen().cull]
    }
}

impl Occlusion for Replayer {
    fn hides(&self, bound: &Bound) -> bool {
        self.ways.columns.hides(self.exposed(), bound)
    }

    fn version(&self) -> Option<u64> {
        Some(self.seen().cull as u64)
    }

    /// Who walked.
    fn stays(&self) -> bool {
        false
    }

    fn open(&self) -> Option<Open> {
        let columns = &self.ways.columns;
        Some(Open { open: columns.open(self.exposed()), within: columns.bounds })
    }
}

impl Driver for Replayer {
    fn poses(&mut self, session: &Session, now: LocalTime) -> Vec<Pose> {
        let began = *self.began.get_or_insert(now);
        let passed = (now.since(began).as_secs_f64() / self.ways.period.as_secs_f64()).round() as usize;
        self.frame = there_and_back(self.offset + passed, self.ways.ways[self.way].len());
        let Some(&(object, ..)) = session.welcome().and_then(|welcome| welcome.avatars.first()) else {
            return Vec::new();
        };
        self.object = object;
        let pose = self.seen().pose;
        let Ok(position) = Position::from_metres(pose.feet - self.ways.anchor) else { return Vec::new() };
        vec![Pose { object, position, orientation: Orientation::from_yaw(pose.yaw) }]
    }

    fn cull(&mut self, ahead: Ahead) {
        debug_assert_eq!(ahead.eye_radius, 0.0, "the record is of points, not of regions");
    }

    fn occlusion(&self) -> Option<&dyn Occlusion> {
        Some(self)
    }

    fn frame_done(&mut self, session: &mut Session, report: &FrameReport) {
        let pose = self.seen().pose;
        if !std::mem::replace(&mut self.has_placed, true)
            && let Ok(position) = Position::from_metres(pose.feet - self.ways.anchor)
        {
            // It came in at a place of the world's choosing.
            session.place(self.object, position, true);
        }
        if let Some(hook) = &mut self.hook {
            hook(session, report, &pose);
        }
    }
}

/// Index into `count` frames after `passed` of them, to the end and back.
fn there_and_back(passed: usize, count: usize) -> usize {
    let cycle = (2 * count).saturating_sub(2).max(1);
    let at = passed % cycle;
    if at < count { at } else { cycle - at }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::plan::RoomsRules;
    use crate::stage::Stage;
    use rand::RngExt;

    const RULES: WayRules =
        WayRules { ways: 3, frames: 20, period: Duration::from_millis(200), side: 64, hold: 0.0, seed: 7 };

    fn ways() -> (Stage, Ways) {
        let stage = Stage::made(&RoomsRules { columns: 3, rows: 2, ..RoomsRules::default() }).unwrap();
        let ways = Ways::record(&stage.ground(), stage.model.scene.bounds(), &RULES).unwrap();
        (stage, ways)
    }

    #[test]
    fn no_point_of_what_the_record_hides_is_seen_by_a_cull() {
        let (stage, ways) = ways();
        let ground = stage.ground();
        let mut scratch = ground.all_round.scratch(RULES.side);
        let mut chance = crate::chance(7, 99);
        let (mut hidden, mut asked) = (0, 0);
        for seen in ways.ways.iter().flatten() {
            let eye = EyeRegion::point(seen.pose.eye - ground.anchor);
            let occlusion = ground.all_round.cull(eye, &mut scratch).unwrap();
            for _ in 0..50 {
                let Aabb { min, max } = ways.columns.bounds;
                let mut along = |low: f64, high: f64| chance.random_range(low..high);
                let centre = DVec3::new(along(min.x, max.x), 0.9 - ground.anchor.y, along(min.z, max.z));
                let (radius, half_height) = (along(0.1, 3.0), along(0.8, 3.0));
                let bound = Bound::Upright { centre, radius, half_height };
                asked += 1;
                if !ways.columns.hides(&ways.culls[seen.cull], &bound) {
                    continue;
                }
                hidden += 1;
                // All of it at once may be too much for a cull to be sure of; any point of it is not.
                for _ in 0..20 {
                    let (turn, out, up) = (along(0.0, 6.3), along(0.0, radius), along(-half_height, half_height));
                    let point = Bound::Sphere {
                        centre: centre + DVec3::new(out * turn.cos(), up, out * turn.sin()),
                        radius: 0.001,
                    };
                    assert!(occlusion.hides(&point), "{point:?} of {bound:?} from {:?}", seen.pose.eye);
                }
            }
        }
        assert!(4 * hidden > asked, "a record that hides {hidden} of {asked} is of no use");
    }

    #[test]
    fn what_reaches_beyond_all_columns_is_never_hidden() {
        let (_, ways) = ways();
        let nothing = Exposed::default();
        let middle = ways.columns.bounds.centre();
        assert!(ways.columns.hides(&nothing, &Bound::Sphere { centre: middle, radius: 0.5 }));
        for bad in [
            Bound::Everywhere,
            Bound::Sphere { centre: middle, radius: 100.0 },
            Bound::Sphere { centre: middle, radius: f64::NAN },
            Bound::Sphere { centre: middle + DVec3::X * 1e6, radius: 0.5 },
        ] {
            assert!(!ways.columns.hides(&nothing, &bad), "{bad:?}");
        }
    }

    #[test]
    fn who_replays_walks_no_faster_than_who_was_recorded() {
        let (stage, ways) = ways();
        let most = stage.model.spec.avatar.speed_max * RULES.period.as_secs_f64() + 1e-9;
        for way in &ways.ways {
            for passed in 0..5 * way.len() {
                let at = |passed| way[there_and_back(passed, way.len())].pose.feet;
                assert!(at(passed).distance(at(passed + 1)) <= most);
            }
        }
    }

    #[test]
    fn a_rectangle_of_columns_knows_each_of_them() {
        let columns = [(70, 3), (71, 3), (200, 5), (135, 4)];
        let exposed = Exposed::of(&columns);
        for x in 60..210 {
            for z in 0..8 {
                assert_eq!(exposed.any((x, x), (z, z)), columns.contains(&(x, z)), "{x} {z}");
            }
        }
        for (x, z, any) in [((0, 69), (0, 9), false), ((0, 70), (0, 3), true), ((72, 300), (3, 3), false)] {
            assert_eq!(exposed.any(x, z), any, "{x:?} {z:?}");
        }
        assert!(exposed.any((0, 500), (0, 500)) && !Exposed::of(&[]).any((0, 500), (0, 500)));
    }

    #[test]
    fn one_frame_is_a_way_too() {
        assert_eq!([0, 1, 2].map(|passed| there_and_back(passed, 1)), [0, 0, 0]);
        assert_eq!([0, 1, 2, 3, 4].map(|passed| there_and_back(passed, 3)), [0, 1, 2, 1, 0]);
    }
}
