//! Where somebody walks in a town: at random, or so as to be as hard to follow as a body can.

use std::cell::RefCell;
use std::rc::Rc;
use std::sync::Arc;

use eyeline_protocol::WorldTime;
use glam::{DVec2, DVec3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use super::walls::{Walls, plan};

/// The greatest speed of an avatar, m/s: the specification's default.
pub(super) const SPEED_MAX: f64 = 2.0;

/// Where the clients' eyes are, for those who mean to be hard to follow. `None` for who has not looked yet.
#[derive(Clone, Default)]
pub struct Board(Rc<RefCell<Vec<Option<DVec2>>>>);

impl Board {
    /// A place on the board for one more pair of eyes.
    pub fn enter(&self) -> usize {
        self.0.borrow_mut().push(None);
        self.0.borrow().len() - 1
    }

    /// The eyes of this entry are at `eye` now.
    pub fn note(&self, entry: usize, eye: DVec3) {
        self.0.borrow_mut()[entry] = Some(plan(eye));
    }

    /// One of the eyes, by any number, but not those of `own`.
    fn pick(&self, number: usize, own: Option<usize>) -> Option<DVec2> {
        let eyes = self.0.borrow();
        let count = eyes.len();
        (0..count).map(|i| (number + i) % count).filter(|&i| Some(i) != own).find_map(|i| eyes[i])
    }
}

/// What an adversarial walker has in mind.
#[derive(Clone)]
struct Plot {
    board: Board,
    own: Option<usize>,
    /// Whom it plays with.
    watched: usize,
    was_hidden: bool,
    pause_s: f64,
    /// Until it looks for another way.
    keep_s: f64,
}

/// A walk that keeps out of walls and within a square around the origin.
#[derive(Clone)]
pub struct Walk {
    walls: Arc<Walls>,
    chance: Pcg64,
    position: DVec3,
    heading: f64,
    speed: f64,
    half: f64,
    at: Option<WorldTime>,
    plot: Option<Plot>,
}

impl Walk {
    /// Walks from `position` at `speed` m/s, within `half` metres of the origin along each axis.
    pub fn new(walls: Arc<Walls>, seed: u64, position: DVec3, speed: f64, half: f64) -> Walk {
        let mut chance = Pcg64::seed_from_u64(seed);
        let heading = chance.random_range(0.0..std::f64::consts::TAU);
        Walk { walls, chance, position, heading, speed, half, at: None, plot: None }
    }

    /// Lets it cross the lines of sight of those on the `board`, back and forth: it peeks round corners, turns back, stops where it
    /// has just come into view, and sprints at the speed limit where it has just gone out of it. `own` are its own eyes.
    pub fn adversarial(mut self, board: Board, own: Option<usize>) -> Walk {
        let watched = self.chance.random_range(0..1024);
        self.plot = Some(Plot { board, own, watched, was_hidden: false, pause_s: 0.0, keep_s: 0.0 });
        self
    }

    /// Where it is.
    pub fn position(&self) -> DVec3 {
        self.position
    }

    /// When it was stepped last.
    pub fn at(&self) -> Option<WorldTime> {
        self.at
    }

    /// Where it is at `at`, which must not go back.
    pub fn step(&mut self, at: WorldTime) -> DVec3 {
        let seconds = self.at.map_or(0.0, |before| at.seconds_since(before));
        self.at = Some(at);
        let speed = match self.plot.take() {
            Some(mut plot) => {
                let speed = self.scheme(&mut plot, seconds);
                self.plot = Some(plot);
                speed
            }
            None => {
                if self.chance.random_bool(0.03) {
                    self.turn();
                }
                self.speed
            }
        };
        for _ in 0..8 {
            let to = self.position + direction(self.heading) * speed * seconds;
            if self.is_free(to) {
                self.position = to;
                break;
            }
            self.turn();
        }
        self.position
    }

    /// Chooses heading and speed, m/s.
    fn scheme(&mut self, plot: &mut Plot, seconds: f64) -> f64 {
        if self.chance.random_bool(0.01) {
            plot.watched = self.chance.random_range(0..1024);
        }
        let Some(eye) = plot.board.pick(plot.watched, plot.own) else { return self.speed };
        let is_hidden = !self.walls.is_clear(eye, plan(self.position));
        if is_hidden != std::mem::replace(&mut plot.was_hidden, is_hidden) {
            // Across the line of sight: back again, or stop at the edge, or on.
            let mood: f64 = self.chance.random();
            if mood < 0.4 {
                self.heading += std::f64::consts::PI;
                plot.keep_s = self.chance.random_range(0.05..0.5);
            } else if mood < 0.7 {
                plot.pause_s = self.chance.random_range(0.05..0.6);
            }
        }
        plot.pause_s -= seconds;
        if plot.pause_s > 0.0 {
            return 0.0;
        }
        plot.keep_s -= seconds;
        if plot.keep_s <= 0.0 {
            plot.keep_s = self.chance.random_range(0.1..0.6);
            self.seek(eye, is_hidden);
        }
        if is_hidden { SPEED_MAX } else { SPEED_MAX * 0.6 }
    }

    /// Heads for where the line of sight to `eye` opens or closes soon, else for the nearest corner of a wall.
    fn seek(&mut self, eye: DVec2, is_hidden: bool) {
        let first = self.chance.random_range(0.0..std::f64::consts::TAU);
        let ways = (0..8).map(|i| first + f64::from(i) * std::f64::consts::TAU / 8.0);
        for heading in ways {
            let ahead = self.position + direction(heading) * 0.7;
            if self.is_free(ahead) && self.walls.is_clear(eye, plan(ahead)) == is_hidden {
                self.heading = heading;
                return;
            }
        }
        let place = plan(self.position);
        let corners = self.walls.walls.iter().flat_map(|wall| wall.corners());
        if let Some(corner) = corners.min_by(|a, b| a.distance(place).total_cmp(&b.distance(place))) {
            let way = corner - place;
            self.heading = way.y.atan2(way.x);
        }
    }

    fn turn(&mut self) {
        self.heading = self.chance.random_range(0.0..std::f64::consts::TAU);
    }

    fn is_free(&self, place: DVec3) -> bool {
        place.abs().max_element() < self.half && !self.walls.blocks(place, 0.1)
    }

    /// Jumps to a random free place, and says where that is.
    pub fn jump(&mut self) -> DVec3 {
        self.position = free_place(&self.walls, &mut self.chance, self.half);
        self.position
    }

    /// Whether something with this probability happens now.
    pub fn happens(&mut self, probability: f64) -> bool {
        self.chance.random_bool(probability)
    }
}

fn direction(heading: f64) -> DVec3 {
    DVec3::new(heading.cos(), 0.0, heading.sin())
}

/// A random place on the ground that is not in or at a wall.
pub fn free_place(walls: &Walls, chance: &mut Pcg64, half: f64) -> DVec3 {
    loop {
        let place = DVec3::new(chance.random_range(-half..half), 0.0, chance.random_range(-half..half)) * 0.98;
        if !walls.blocks(place, 0.2) {
            return place;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::walls::Wall;
    use super::*;

    #[test]
    fn an_adversarial_walker_crosses_sight_lines_more_often_and_keeps_its_speed() {
        let walls = Arc::new(Walls { walls: vec![Wall::new(-3.0, -2.1, 3.0, -1.9)] });
        let crossings = |adversarial: bool| {
            let mut crossed = 0;
            for seed in 0..8 {
                let board = Board::default();
                let entry = board.enter();
                board.note(entry, DVec3::new(0.0, 1.6, 4.0));
                let walk = Walk::new(walls.clone(), seed, DVec3::new(0.0, 0.0, -6.0), SPEED_MAX, 18.0);
                let mut walk = if adversarial { walk.adversarial(board, None) } else { walk };
                let mut before = walk.position();
                let mut was_clear = false;
                for tick in 0..1_200 {
                    let place = walk.step(WorldTime::from_micros(tick * 50_000));
                    assert!(place.distance(before) <= SPEED_MAX * 0.05 + 1e-9);
                    before = place;
                    let is_clear = walls.is_clear(DVec2::new(0.0, 4.0), plan(place));
                    crossed += u32::from(is_clear != std::mem::replace(&mut was_clear, is_clear));
                }
            }
            crossed
        };
        let (adversarial, random) = (crossings(true), crossings(false));
        assert!(adversarial > 3 * random, "{adversarial} and {random}");
    }
}
