//! Where are the rooms, walls, doors and tables of a made building? In plan, without a triangle.
//!
//! Rooms lie on a grid: column c spans x from c·room to (c+1)·room, row r likewise in z, the floor's top is y = 0, and walls
//! stand on the grid lines. Every wall between two rooms has one door at a seeded place. A plan follows from its
//! [`RoomsRules`] alone: a swarm in another process rebuilds it from the rules' file, `NAME.rooms.json`.

use std::path::{Path, PathBuf};

use glam::{DVec2, Vec2Swizzles};
use rand::RngExt;
use serde::{Deserialize, Serialize};

use crate::chance;

/// Least wall left between a door and the corner of a room.
const JAMB: f64 = 0.4;
/// Most rooms of a building: 4 chairs in each are still fewer objects than a world may have.
const ROOMS_MAX: u64 = 100_000;
/// Half of the table top, long side first.
pub(super) const TABLE_HALF: DVec2 = DVec2::new(0.6, 0.4);
/// A chair's place at the table: from the table's edge to the chair's reference point.
pub(super) const CHAIR_GAP: f64 = 0.4;
/// Radius of a chair around its reference point.
pub(super) const CHAIR_RADIUS: f64 = 0.35;
/// Least and greatest way of a chair from its table.
pub(super) const CHAIR_WAY: (f64, f64) = (1.0, 1.5);
/// What stays free between a chair and a wall.
pub(super) const CHAIR_CLEAR: f64 = 0.02;
/// How far a table may stand from the middle of its room, along each axis.
const TABLE_SHIFT: f64 = 0.3;

/// What the maker `rooms` is asked for. All lengths in metres.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RoomsRules {
    /// Rooms along +X. Default 10.
    pub columns: u32,
    /// Rooms along +Z. Default 10.
    pub rows: u32,
    /// From wall to wall, middle to middle. Default 6.
    pub room: f64,
    /// From the floor to the ceiling. Default 3.
    pub height: f64,
    /// Thickness of a wall. Default 0.2.
    pub wall: f64,
    /// Width of a door. Default 1.
    pub door_width: f64,
    /// Height of a door. Default 2.1.
    pub door_height: f64,
    /// A table and four chairs in each room. Default true.
    pub furnished: bool,
    /// Share of the chairs that have a path, 0 to 1; the others stand still. Default 0.5.
    pub moving_share: f64,
    /// Decides doors, furniture, paths and spawn points. Default 7.
    pub seed: u64,
}

impl Default for RoomsRules {
    fn default() -> RoomsRules {
        RoomsRules {
            columns: 10,
            rows: 10,
            room: 6.0,
            height: 3.0,
            wall: 0.2,
            door_width: 1.0,
            door_height: 2.1,
            furnished: true,
            moving_share: 0.5,
            seed: 7,
        }
    }
}

/// Why there is no plan.
#[derive(Debug, thiserror::Error)]
pub enum PlanError {
    /// A rule that no building can follow.
    #[error("rooms: {rule} = {value}: {remedy}")]
    Rule {
        /// Field of [`RoomsRules`].
        rule: &'static str,
        /// What was asked for.
        value: f64,
        /// What would be right.
        remedy: String,
    },
    /// The rules' file cannot be read.
    #[error("cannot read the rules of a made building, {path}: {source}")]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The rules' file is not what it should be.
    #[error("{path} is not a file of rules for `rooms` ({source}); make the scene again, or delete the file")]
    Parse {
        /// The file.
        path: PathBuf,
        /// What is wrong and where.
        source: serde_json::Error,
    },
}

/// A rectangle in plan: x and z.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rect {
    /// Least x and z.
    pub min: DVec2,
    /// Greatest x and z.
    pub max: DVec2,
}

impl Rect {
    /// The rectangle of given half size around a point.
    pub fn around(center: DVec2, half: DVec2) -> Rect {
        Rect { min: center - half, max: center + half }
    }

    /// Larger by `by` on each side, or smaller if negative.
    pub fn grown(self, by: f64) -> Rect {
        Rect { min: self.min - by, max: self.max + by }
    }

    /// Its middle.
    pub fn center(self) -> DVec2 {
        (self.min + self.max) * 0.5
    }

    /// The four corners, around it.
    pub fn corners(self) -> [DVec2; 4] {
        let Rect { min, max } = self;
        [min, DVec2::new(max.x, min.y), max, DVec2::new(min.x, max.y)]
    }

    /// True if the point is inside or on the edge.
    pub fn contains(self, point: DVec2) -> bool {
        point.cmpge(self.min).all() && point.cmple(self.max).all()
    }

    /// True if the segment has a point strictly inside.
    pub fn crosses(self, from: DVec2, to: DVec2) -> bool {
        let (mut enter, mut leave) = (0.0_f64, 1.0_f64);
        for axis in 0..2 {
            let step = to[axis] - from[axis];
            if step == 0.0 {
                if from[axis] <= self.min[axis] || from[axis] >= self.max[axis] {
                    return false;
                }
                continue;
            }
            let (a, b) = ((self.min[axis] - from[axis]) / step, (self.max[axis] - from[axis]) / step);
            enter = enter.max(a.min(b));
            leave = leave.min(a.max(b));
        }
        enter < leave
    }

    /// Distance of a point from the rectangle; 0 inside.
    pub fn distance(self, point: DVec2) -> f64 {
        point.distance(point.clamp(self.min, self.max))
    }
}

/// A room.
#[derive(Clone, Debug, PartialEq)]
pub struct Room {
    /// The floor between its walls.
    pub clear: Rect,
    /// The table's top seen from above, if there is one.
    pub table: Option<Rect>,
    /// True if the table's long side is along x.
    pub table_along_x: bool,
    /// Indices into [`RoomPlan::doors`].
    pub doors: Vec<usize>,
}

/// A door between two neighbouring rooms.
#[derive(Clone, Debug, PartialEq)]
pub struct Door {
    /// Indices into [`RoomPlan::rooms`].
    pub rooms: [usize; 2],
    /// Middle of the opening, in the middle of the wall.
    pub center: DVec2,
    /// Unit vector across the wall, from the first room to the second.
    pub across: DVec2,
}

/// All walls on one grid line, with their doors.
#[derive(Clone, Debug, PartialEq)]
pub struct WallLine {
    /// True if it runs along x, at a fixed z; otherwise along z, at a fixed x.
    pub along_x: bool,
    /// The fixed coordinate, of the wall's middle.
    pub at: f64,
    /// Where it begins and ends along the other axis.
    pub span: (f64, f64),
    /// Middles of its doors along that axis, ascending.
    pub doors: Vec<f64>,
    /// True for the four that enclose the building.
    pub outer: bool,
}

impl WallLine {
    /// The pieces of wall between doors: each runs through the walls that cross it.
    pub fn pieces(&self, door_width: f64) -> Vec<(f64, f64)> {
        let mut from = self.span.0;
        let mut pieces = Vec::with_capacity(self.doors.len() + 1);
        for door in &self.doors {
            pieces.push((from, door - 0.5 * door_width));
            from = door + 0.5 * door_width;
        }
        pieces.push((from, self.span.1));
        pieces
    }

    /// A piece of it seen from above, `thickness` wide.
    pub fn footprint(&self, (from, to): (f64, f64), thickness: f64) -> Rect {
        let half = 0.5 * thickness;
        let (min, max) = (DVec2::new(from, self.at - half), DVec2::new(to, self.at + half));
        if self.along_x { Rect { min, max } } else { Rect { min: min.yx(), max: max.yx() } }
    }
}

/// A building in plan.
#[derive(Clone, Debug, PartialEq)]
pub struct RoomPlan {
    /// What it was made from.
    pub rules: RoomsRules,
    /// Rooms, row after row.
    pub rooms: Vec<Room>,
    /// Doors.
    pub doors: Vec<Door>,
    /// Walls.
    pub lines: Vec<WallLine>,
}

impl RoomPlan {
    /// Plans a building; the same rules give the same plan.
    pub fn new(rules: &RoomsRules) -> Result<RoomPlan, PlanError> {
        check(rules)?;
        let (columns, rows) = (rules.columns as usize, rules.rows as usize);
        let clear_half = DVec2::splat(0.5 * (rules.room - rules.wall));
        let mut rooms: Vec<Room> = (0..columns * rows)
            .map(|index| {
                let cell = DVec2::new((index % columns) as f64, (index / columns) as f64);
                let clear = Rect::around((cell + 0.5) * rules.room, clear_half);
                Room { clear, table: None, table_along_x: true, doors: Vec::new() }
            })
            .collect();
        let mut doors = Vec::new();
        let mut lines = Vec::new();
        let mut door_places = chance(rules.seed, 1);
        let reach = 0.5 * (rules.wall + rules.door_width) + JAMB;
        for along_x in [true, false] {
            let (line_count, cells) = if along_x { (rows, columns) } else { (columns, rows) };
            for line in 0..=line_count {
                let outer = line == 0 || line == line_count;
                let at = line as f64 * rules.room;
                // Inner walls end inside the outer ones, outer ones run through each other's corner, and no two ends
                // lie in one plane with a face of another wall.
                let over = if outer { 0.5 * rules.wall + 0.05 } else { 0.25 * rules.wall };
                let span = (-over, cells as f64 * rules.room + over);
                let mut line_doors = Vec::new();
                for cell in 0..if outer { 0 } else { cells } {
                    let start = cell as f64 * rules.room;
                    let place = door_places.random_range(start + reach..=start + rules.room - reach);
                    let (column, row) = if along_x { (cell, line) } else { (line, cell) };
                    let room = row * columns + column;
                    let neighbour = if along_x { room - columns } else { room - 1 };
                    let (center, across) =
                        if along_x { (DVec2::new(place, at), DVec2::Y) } else { (DVec2::new(at, place), DVec2::X) };
                    rooms[neighbour].doors.push(doors.len());
                    rooms[room].doors.push(doors.len());
                    doors.push(Door { rooms: [neighbour, room], center, across });
                    line_doors.push(place);
                }
                lines.push(WallLine { along_x, at, span, doors: line_doors, outer });
            }
        }
        if rules.furnished {
            let mut table_places = chance(rules.seed, 2);
            let shift = (clear_half.x - furnished_half_min()).clamp(0.0, TABLE_SHIFT);
            for room in &mut rooms {
                let [x, z] = [(); 2].map(|()| table_places.random_range(-shift..=shift));
                room.table_along_x = table_places.random();
                let half = if room.table_along_x { TABLE_HALF } else { TABLE_HALF.yx() };
                room.table = Some(Rect::around(room.clear.center() + DVec2::new(x, z), half));
            }
        }
        Ok(RoomPlan { rules: rules.clone(), rooms, doors, lines })
    }

    /// The plan of a made scene, from the rules beside its model (`rooms.glb`, `rooms.rooms.json`); `None` if there are
    /// none, as with a scene that we did not make.
    pub fn beside(model: &Path) -> Result<Option<RoomPlan>, PlanError> {
        let path = model.with_extension("rooms.json");
        let text = match std::fs::read_to_string(&path) {
            Ok(text) => text,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            Err(source) => return Err(PlanError::Read { path, source }),
        };
        let rules = serde_json::from_str(&text).map_err(|source| PlanError::Parse { path, source })?;
        RoomPlan::new(&rules).map(Some)
    }

    /// The room whose cell holds a point; `None` outside the building.
    pub fn room_at(&self, point: DVec2) -> Option<usize> {
        let (columns, rows) = (f64::from(self.rules.columns), f64::from(self.rules.rows));
        let cell = (point / self.rules.room).floor();
        let inside = cell.x >= 0.0 && cell.y >= 0.0 && cell.x < columns && cell.y < rows;
        inside.then(|| cell.y as usize * self.rules.columns as usize + cell.x as usize)
    }

    /// Every wall seen from above, doors left out.
    pub fn walls(&self) -> impl Iterator<Item = Rect> + '_ {
        self.lines.iter().flat_map(|line| {
            let pieces = line.pieces(self.rules.door_width);
            pieces.into_iter().map(|piece| line.footprint(piece, self.rules.wall))
        })
    }
}

/// Half of the least clear width of a furnished room: table, chair and the chair's least way.
fn furnished_half_min() -> f64 {
    TABLE_HALF.x + CHAIR_GAP + CHAIR_WAY.0 + CHAIR_RADIUS + CHAIR_CLEAR
}

fn check(rules: &RoomsRules) -> Result<(), PlanError> {
    let bad = |rule, value, remedy: String| Err(PlanError::Rule { rule, value, remedy });
    let rooms = u64::from(rules.columns) * u64::from(rules.rows);
    if rooms == 0 || rooms > ROOMS_MAX {
        return bad("columns × rows", rooms as f64, format!("give 1 to {ROOMS_MAX} rooms"));
    }
    if !(0.05..=1.0).contains(&rules.wall) {
        return bad("wall", rules.wall, "give a thickness from 0.05 to 1 m".into());
    }
    let room_min = if rules.furnished { 2.0 * furnished_half_min() } else { 2.0 } + rules.wall;
    if !(room_min..=1_000.0).contains(&rules.room) {
        let why = if rules.furnished { " (a table, four chairs and their way need it)" } else { "" };
        return bad("room", rules.room, format!("give {room_min:.2} to 1000 m{why}"));
    }
    let width_max = rules.room - rules.wall - 2.0 * JAMB;
    if !(0.8..=width_max).contains(&rules.door_width) {
        return bad("door_width", rules.door_width, format!("give 0.8 to {width_max:.2} m"));
    }
    if !(2.0..=100.0).contains(&rules.height) {
        return bad("height", rules.height, "give 2 to 100 m".into());
    }
    let door_max = rules.height - 0.1;
    if !(1.8..=door_max).contains(&rules.door_height) {
        return bad("door_height", rules.door_height, format!("give 1.8 to {door_max:.2} m, below the ceiling"));
    }
    if !(0.0..=1.0).contains(&rules.moving_share) {
        return bad("moving_share", rules.moving_share, "give a share from 0 to 1".into());
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_inner_wall_has_one_door_and_every_room_can_be_reached() {
        let plan = RoomPlan::new(&RoomsRules::default()).unwrap();
        assert_eq!((plan.rooms.len(), plan.doors.len()), (100, 2 * 9 * 10));
        for door in &plan.doors {
            for (room, side) in door.rooms.into_iter().zip([-1.0, 1.0]) {
                assert_eq!(plan.room_at(door.center + door.across * side), Some(room));
                // The whole opening leads into the room, with a jamb on both sides.
                let along = door.across.perp() * (0.5 * plan.rules.door_width + JAMB - 1e-9);
                let before = door.center + door.across * side * (0.5 * plan.rules.wall + 1e-9);
                assert!(plan.rooms[room].clear.contains(before + along));
                assert!(plan.rooms[room].clear.contains(before - along));
            }
            assert!(plan.walls().all(|wall| !wall.contains(door.center)));
        }
    }

    #[test]
    fn same_rules_same_plan_and_furniture_does_not_move_doors() {
        let rules = RoomsRules { columns: 4, rows: 3, ..RoomsRules::default() };
        let plan = RoomPlan::new(&rules).unwrap();
        assert_eq!(plan, RoomPlan::new(&rules).unwrap());
        let bare = RoomPlan::new(&RoomsRules { furnished: false, ..rules.clone() }).unwrap();
        assert_eq!(bare.doors, plan.doors);
        assert_ne!(RoomPlan::new(&RoomsRules { seed: 8, ..rules }).unwrap().doors, plan.doors);
    }

    #[test]
    fn impossible_rules_are_refused_by_name() {
        let message = |change: fn(&mut RoomsRules)| {
            let mut rules = RoomsRules::default();
            change(&mut rules);
            RoomPlan::new(&rules).unwrap_err().to_string()
        };
        assert!(message(|r| r.columns = 0).contains("columns × rows = 0"));
        assert!(message(|r| (r.columns, r.rows) = (u32::MAX, u32::MAX)).contains("columns × rows"));
        assert!(message(|r| r.room = 4.0).contains("room = 4: give 4.94"));
        assert!(message(|r| r.room = f64::NAN).contains("room = NaN"));
        assert!(message(|r| r.door_width = 5.5).contains("door_width"));
        assert!(message(|r| r.door_height = 3.0).contains("door_height"));
        assert!(message(|r| r.moving_share = 1.1).contains("moving_share"));
        assert!(message(|r| r.wall = 0.0).contains("wall = 0"));
        assert!(message(|r| r.height = f64::INFINITY).contains("height = inf"));
    }

    #[test]
    fn segment_test_agrees_with_sampling() {
        let rect = Rect { min: DVec2::new(-1.0, -2.0), max: DVec2::new(1.0, 2.0) };
        let mut places = chance(3, 0);
        for _ in 0..2_000 {
            let [a, b] = [(); 2].map(|()| DVec2::new(places.random_range(-4.0..4.0), places.random_range(-4.0..4.0)));
            let sampled = (0..=2_000).map(|i| a.lerp(b, f64::from(i) / 2_000.0)).any(|p| rect.grown(-1e-2).contains(p));
            if sampled {
                assert!(rect.crosses(a, b));
            }
            let near = (0..=2_000).map(|i| a.lerp(b, f64::from(i) / 2_000.0)).any(|p| rect.grown(1e-2).contains(p));
            if !near {
                assert!(!rect.crosses(a, b));
            }
        }
        assert!(!rect.crosses(DVec2::new(-3.0, 2.0), DVec2::new(3.0, 2.0)), "along an edge is not inside");
    }
}
