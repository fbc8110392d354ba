//! Avatars that walk from room to room of a made building.
//!
//! A walker picks a door of its room (not the one it came by, if there is another), goes to a point in front of it, straight
//! through its middle, and on to a random clear point of the next room, where it picks again. It never stops, so its
//! average speed is the speed that it drew, cut only where one step goes round a corner. Tables are the only obstacle
//! inside a room: if one is in the way, the way leads over one or two corners of the table's rectangle, grown by the
//! avatar's radius. Two corners always suffice: from any point outside a rectangle both ends of one side are in sight.
//! Chairs and other avatars are walked through.

use std::collections::VecDeque;
use std::f64::consts::TAU;
use std::ops::RangeInclusive;
use std::sync::Arc;

use eyeline_server::spec::AvatarSpec;
use glam::{DVec2, DVec3, Vec3Swizzles};
use rand::RngExt;

use super::{WalkerPose, step_s, turn_toward};
use crate::chance;
use crate::scene::plan::{Rect, RoomPlan};

/// Speeds that walkers draw from unless told otherwise, in metres a second: the average stays above 1.2.
pub const SPEEDS: RangeInclusive<f64> = 1.25..=1.5;

/// Distance of the points before and after a door from the wall's face.
const DOOR_STEP: f64 = 0.5;
/// Air between a walker and what it passes.
const AIR: f64 = 0.05;
/// Widest avatar: its points before a door must be clear of the wall.
const RADIUS_MAX: f64 = DOOR_STEP - AIR;
/// Fastest turn of the head, in radians a second.
const TURN_RATE: f64 = 3.0;
/// How far a walker looks to the sides, in radians, and the two periods of it, in seconds.
const GLANCE: f64 = 0.7;
const GLANCE_PERIODS_S: [f64; 2] = [4.7, 13.1];

/// Why a walker cannot walk.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum WalkError {
    /// A range that is empty, or not of positive numbers.
    #[error("a walker's speeds are {from} to {to} m/s; give two positive numbers, the lesser first")]
    Speeds {
        /// Least speed.
        from: f64,
        /// Greatest speed.
        to: f64,
    },
    /// Faster than an avatar may be.
    #[error(
        "a walker's speed of {speed} m/s is above the avatar's speed_max of {speed_max} m/s; lower it or raise that"
    )]
    TooFast {
        /// Greatest speed of the walker.
        speed: f64,
        /// The avatar's bound.
        speed_max: f64,
    },
    /// Too wide for doors or tables.
    #[error("an avatar of radius {radius} m does not fit through a door {door} m wide; at most {most:.3} m does")]
    TooWide {
        /// Radius of the avatar.
        radius: f64,
        /// Width of the doors.
        door: f64,
        /// What would fit.
        most: f64,
    },
    /// In a wall, in a table, or outside.
    #[error("a walker cannot start at ({}, {}): {what}; use the world's spawn points", .at.x, .at.y)]
    Start {
        /// The place: x and z.
        at: DVec2,
        /// What is wrong with it.
        what: &'static str,
    },
}

/// An avatar that walks for ever.
#[derive(Clone, Debug)]
pub struct Walker {
    plan: Arc<RoomPlan>,
    avatar: AvatarSpec,
    speeds: RangeInclusive<f64>,
    chance: rand_pcg::Pcg64,
    position: DVec2,
    height: f64,
    /// Corners still to come; the last is a clear point of `room`.
    route: VecDeque<DVec2>,
    /// The room where the route ends.
    room: usize,
    /// The door that the route took.
    door: Option<usize>,
    /// Metres a second on this route.
    speed: f64,
    yaw: f64,
    glance_phases: [f64; 2],
    walked_s: f64,
}

impl Walker {
    /// An avatar at `start` (its feet), with speeds in metres a second, [`SPEEDS`] unless there is a reason.
    pub fn new(
        plan: Arc<RoomPlan>,
        avatar: AvatarSpec,
        seed: u64,
        start: DVec3,
        speeds: RangeInclusive<f64>,
    ) -> Result<Walker, WalkError> {
        let (&from, &to) = (speeds.start(), speeds.end());
        if !(from > 0.0 && from <= to && to.is_finite()) {
            return Err(WalkError::Speeds { from, to });
        }
        if to > avatar.speed_max || avatar.speed_max.is_nan() {
            return Err(WalkError::TooFast { speed: to, speed_max: avatar.speed_max });
        }
        let most = RADIUS_MAX.min(0.5 * plan.rules.door_width - AIR);
        if !(0.0..=most).contains(&avatar.radius) {
            return Err(WalkError::TooWide { radius: avatar.radius, door: plan.rules.door_width, most });
        }
        let at = start.xz();
        let bad = |what| Err(WalkError::Start { at, what });
        let Some(room) = plan.room_at(at) else { return bad("it is outside the building") };
        if !plan.rooms[room].clear.grown(-avatar.radius).contains(at) {
            return bad("it is too near a wall");
        }
        if plan.rooms[room].table.is_some_and(|table| table.grown(avatar.radius + AIR).contains(at)) {
            return bad("it is in a table");
        }
        let mut chance = chance(seed, 5);
        let glance_phases = [(); 2].map(|()| chance.random());
        let yaw = chance.random_range(-0.5 * TAU..0.5 * TAU);
        let mut walker = Walker {
            plan,
            avatar,
            speeds,
            chance,
            position: at,
            height: start.y,
            route: VecDeque::new(),
            room,
            door: None,
            speed: 0.0,
            yaw,
            glance_phases,
            walked_s: 0.0,
        };
        walker.choose_route();
        walker.yaw = walker.wanted_yaw();
        Ok(walker)
    }

    /// Walks for `dt_s` seconds. Not a positive number: stays; more than 10: walks for 10.
    pub fn step(&mut self, dt_s: f64) -> WalkerPose {
        let dt_s = step_s(dt_s);
        let mut left_s = dt_s;
        while left_s > 0.0 {
            let Some(&corner) = self.route.front() else {
                self.choose_route();
                continue;
            };
            let distance = self.position.distance(corner);
            let reach = self.speed * left_s;
            if reach < distance {
                self.position += (corner - self.position) * (reach / distance);
                break;
            }
            self.position = corner;
            self.route.pop_front();
            left_s -= distance / self.speed;
        }
        self.walked_s += dt_s;
        self.yaw = turn_toward(self.yaw, self.wanted_yaw(), TURN_RATE.min(self.avatar.turn_max) * dt_s);
        self.pose()
    }

    /// Where it is and looks now.
    pub fn pose(&self) -> WalkerPose {
        let feet = DVec3::new(self.position.x, self.height, self.position.y);
        WalkerPose { feet, yaw: self.yaw, eye: feet + DVec3::Y * self.avatar.eye_height }
    }

    /// Where it goes, and a bit to the sides.
    fn wanted_yaw(&self) -> f64 {
        let ahead = self.route.front().map_or(DVec2::ZERO, |corner| corner - self.position);
        let course = if ahead.length_squared() > 1e-6 { (-ahead.x).atan2(-ahead.y) } else { self.yaw };
        let [fast, slow] = [0, 1].map(|i| (TAU * (self.walked_s / GLANCE_PERIODS_S[i] + self.glance_phases[i])).sin());
        course + GLANCE * fast * slow
    }

    /// Lays the way to a clear point of a neighbouring room, or of this one if it has no door.
    fn choose_route(&mut self) {
        self.speed = self.chance.random_range(self.speeds.clone());
        let plan = Arc::clone(&self.plan);
        let mut doors = plan.rooms[self.room].doors.clone();
        if doors.len() > 1 {
            doors.retain(|&door| Some(door) != self.door);
        }
        let mut from = self.position;
        if !doors.is_empty() {
            let number = doors[self.chance.random_range(0..doors.len())];
            let door = &plan.doors[number];
            let forward = door.rooms[0] == self.room;
            let across = if forward { door.across } else { -door.across };
            let step = across * (0.5 * plan.rules.wall + DOOR_STEP);
            self.go(from, door.center - step);
            self.route.push_back(door.center + step);
            from = door.center + step;
            self.room = door.rooms[usize::from(forward)];
            self.door = Some(number);
        }
        let target = self.clear_point();
        self.go(from, target);
    }

    /// Adds the corners of a way inside the route's room, round its table if need be.
    fn go(&mut self, from: DVec2, to: DVec2) {
        if let Some(table) = self.plan.rooms[self.room].table {
            self.route.extend(around(table.grown(self.avatar.radius + AIR), from, to));
        }
        self.route.push_back(to);
    }

    /// A random point of the route's room, clear of walls and table.
    fn clear_point(&mut self) -> DVec2 {
        let room = &self.plan.rooms[self.room];
        let floor = room.clear.grown(-(self.avatar.radius + AIR));
        let blocked = room.table.map(|table| table.grown(self.avatar.radius + 2.0 * AIR));
        loop {
            let x = self.chance.random_range(floor.min.x..floor.max.x);
            let z = self.chance.random_range(floor.min.y..floor.max.y);
            // A table covers less than half of the floor (the plan's least room sees to it), so this soon ends.
            if blocked.is_none_or(|blocked| !blocked.contains(DVec2::new(x, z))) {
                return DVec2::new(x, z);
            }
        }
    }
}

/// The corners of the shortest way from one point to another that stays out of a rectangle; both must be outside.
fn around(blocked: Rect, from: DVec2, to: DVec2) -> Vec<DVec2> {
    if !blocked.crosses(from, to) {
        return Vec::new();
    }
    // A little outside, so that rounding does not put the way inside.
    let corners = blocked.grown(0.01).corners();
    let one = corners.iter().map(|&a| vec![a]);
    let two = corners.iter().flat_map(|&a| corners.iter().filter(move |&&b| b != a).map(move |&b| vec![a, b]));
    let length = |way: &Vec<DVec2>| {
        let points = [&[from], &way[..], &[to]].concat();
        let free = points.windows(2).all(|pair| !blocked.crosses(pair[0], pair[1]));
        free.then(|| points.windows(2).map(|pair| pair[0].distance(pair[1])).sum::<f64>())
    };
    let ways = one.chain(two).filter_map(|way| length(&way).map(|metres| (metres, way)));
    ways.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, way)| way).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::plan::RoomsRules;
    use crate::scene::rooms;

    const TICK_S: f64 = 0.05;

    fn walkers(rules: &RoomsRules, count: usize) -> Vec<Walker> {
        let scene = rooms::make(rules).unwrap();
        let plan = Arc::new(scene.plan);
        let spawns = scene.world.spawns.iter().take(count).enumerate();
        spawns
            .map(|(number, spawn)| {
                let start = DVec3::from(spawn.position);
                Walker::new(plan.clone(), scene.world.avatar, 100 + number as u64, start, SPEEDS).unwrap()
            })
            .collect()
    }

    #[test]
    fn never_enters_walls_or_tables_and_visits_many_rooms() {
        for (columns, room, seed) in [(4, 6.0, 1), (3, 4.95, 2), (2, 8.0, 3)] {
            let rules = RoomsRules { columns, rows: 3, room, seed, ..RoomsRules::default() };
            let all = walkers(&rules, 12);
            let walls: Vec<Rect> = all[0].plan.walls().collect();
            for mut walker in all {
                let mut visited = std::collections::BTreeSet::new();
                for _ in 0..12_000 {
                    let feet = walker.step(TICK_S).feet;
                    let at = feet.xz();
                    let radius = walker.avatar.radius;
                    let room = walker.plan.room_at(at).expect("inside the building");
                    visited.insert(room);
                    assert_eq!(feet.y, 0.0);
                    let wall = walls.iter().map(|wall| wall.distance(at)).fold(f64::INFINITY, f64::min);
                    assert!(wall >= radius, "{wall} m from a wall at {at}");
                    let table = walker.plan.rooms[room].table.unwrap().distance(at);
                    assert!(table >= radius, "{table} m from a table at {at}");
                }
                assert!(visited.len() * 4 >= walker.plan.rooms.len() * 3, "only rooms {visited:?} in 10 minutes");
            }
        }
    }

    #[test]
    fn walks_at_1_2_metres_a_second_or_more_and_never_above_its_speed() {
        let (mut slowest, mut fastest) = (f64::INFINITY, 0.0_f64);
        for mut walker in walkers(&RoomsRules::default(), 32) {
            let (mut before, mut walked) = (walker.pose().feet, 0.0);
            for _ in 0..1_200 {
                let feet = walker.step(TICK_S).feet;
                let step = feet.distance(before);
                assert!(step <= SPEEDS.end() * TICK_S + 1e-12 && step <= walker.avatar.speed_max * TICK_S);
                (walked, before) = (walked + step, feet);
            }
            let speed = walked / (1_200.0 * TICK_S);
            (slowest, fastest) = (slowest.min(speed), fastest.max(speed));
        }
        println!("average speeds over a minute: {slowest:.3} to {fastest:.3} m/s");
        assert!(slowest >= 1.2, "{slowest}");
    }

    #[test]
    fn looks_where_it_goes_and_round() {
        let mut walker = walkers(&RoomsRules::default(), 1).remove(0);
        let mut before = walker.pose();
        let (mut ahead, mut aside) = (0, 0);
        for _ in 0..6_000 {
            let pose = walker.step(TICK_S);
            let turn = (pose.yaw - before.yaw + 0.5 * TAU).rem_euclid(TAU) - 0.5 * TAU;
            assert!(turn.abs() <= TURN_RATE * TICK_S + 1e-9);
            assert!((pose.eye - pose.feet).distance(DVec3::Y * walker.avatar.eye_height) < 1e-12);
            let course = (pose.feet - before.feet).xz().normalize();
            let cos = DVec2::new(-pose.yaw.sin(), -pose.yaw.cos()).dot(course);
            ahead += u32::from(cos > 0.7);
            aside += u32::from(cos < 0.98);
            before = pose;
        }
        assert!(ahead > 4_500 && aside > 1_000, "{ahead} ahead, {aside} aside of 6000");
    }

    #[test]
    fn same_seed_same_walk() {
        let rules = RoomsRules { columns: 3, rows: 3, ..RoomsRules::default() };
        let (mut a, mut b) = (walkers(&rules, 4), walkers(&rules, 4));
        for _ in 0..2_000 {
            for (a, b) in a.iter_mut().zip(&mut b) {
                assert_eq!(a.step(TICK_S), b.step(TICK_S));
            }
        }
        assert_ne!(a[0].pose().feet, a[1].pose().feet);
    }

    #[test]
    fn a_lone_room_and_odd_steps_are_fine() {
        let rules = RoomsRules { columns: 1, rows: 1, ..RoomsRules::default() };
        let mut walker = walkers(&rules, 1).remove(0);
        let start = walker.pose().feet;
        for dt_s in [0.0, -1.0, f64::NAN] {
            assert_eq!(walker.step(dt_s).feet, start);
        }
        for dt_s in [f64::INFINITY, 1e9, 3.0, 1e-9] {
            let feet = walker.step(dt_s).feet;
            assert!(walker.plan.rooms[0].clear.contains(feet.xz()));
        }
        assert_ne!(walker.pose().feet, start);
    }

    #[test]
    fn what_cannot_walk_is_refused_with_a_remedy() {
        let plan = Arc::new(RoomPlan::new(&RoomsRules::default()).unwrap());
        let start = DVec3::new(0.7, 0.0, 0.7);
        let message = |avatar: AvatarSpec, start: DVec3, speeds| {
            Walker::new(plan.clone(), avatar, 1, start, speeds).unwrap_err().to_string()
        };
        let avatar = AvatarSpec::default();
        assert!(message(avatar, start, 1.0..=2.5).contains("above the avatar's speed_max of 2"));
        assert!(message(avatar, start, f64::NAN..=1.0).contains("NaN"));
        assert!(message(avatar, start, 0.0..=1.0).contains("positive"));
        assert!(message(AvatarSpec { radius: 0.5, ..avatar }, start, SPEEDS).contains("0.450"));
        assert!(message(avatar, DVec3::splat(-5.0), SPEEDS).contains("outside"));
        assert!(message(avatar, DVec3::ZERO, SPEEDS).contains("wall"));
        let table = plan.rooms[0].table.unwrap().center();
        assert!(message(avatar, DVec3::new(table.x, 0.0, table.y), SPEEDS).contains("table"));
    }
}
