//! People: one who walks at random and looks, one who stands where it is put, and a crowd that is only moved.

use std::sync::Arc;

use crate::virtual_net::{ClientDriver, Pose};
use eyeline_client::session::{FrameTime, Session};
use eyeline_client::tracking::Ahead;
use eyeline_protocol::{ObjectId, Orientation, Position, WorldTime};
use eyeline_visibility::Occlusion;
use glam::DVec3;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use super::walls::{Walls, WallsFrom};

const EYE_HEIGHT: f64 = 1.6;

/// A random walk that keeps out of walls and within a square around the origin.
#[derive(Clone)]
pub struct Walk {
    walls: Arc<Walls>,
    chance: Pcg64,
    position: DVec3,
    heading: f64,
    speed: f64,
    half: f64,
    at: Option<WorldTime>,
}

impl Walk {
    /// Walks from `position` at `speed` m/s, within `half` metres of the origin along each axis.
    pub fn new(walls: Arc<Walls>, seed: u64, position: DVec3, speed: f64, half: f64) -> Walk {
        let mut chance = Pcg64::seed_from_u64(seed);
        let heading = chance.random_range(0.0..std::f64::consts::TAU);
        Walk { walls, chance, position, heading, speed, half, at: None }
    }

    /// Where it is at `at`, which must not go back.
    pub fn step(&mut self, at: WorldTime) -> DVec3 {
        let seconds = self.at.map_or(0.0, |before| at.seconds_since(before));
        self.at = Some(at);
        if self.chance.random_bool(0.03) {
            self.heading = self.chance.random_range(0.0..std::f64::consts::TAU);
        }
        for _ in 0..8 {
            let to = self.position + DVec3::new(self.heading.cos(), 0.0, self.heading.sin()) * self.speed * seconds;
            if to.abs().max_element() < self.half && !self.walls.blocks(to, 0.1) {
                self.position = to;
                break;
            }
            self.heading = self.chance.random_range(0.0..std::f64::consts::TAU);
        }
        self.position
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

/// A random place on the ground that is not in or at a wall.
pub fn free_place(walls: &Walls, chance: &mut Pcg64, half: f64) -> DVec3 {
    loop {
        let place = DVec3::new(chance.random_range(-half..half), 0.0, chance.random_range(-half..half)) * 0.98;
        if !walls.blocks(place, 0.2) {
            return place;
        }
    }
}

fn pose(object: ObjectId, place: DVec3) -> Pose {
    let position = Position::from_metres(place).expect("towns are small");
    Pose { object, position, orientation: Orientation::default() }
}

/// Walks and looks all round. Sometimes it teleports.
pub struct Walker {
    walk: Walk,
    occlusion: WallsFrom,
    eye: DVec3,
    teleport_share: f64,
}

impl Walker {
    /// A walker that teleports at this share of its frames.
    pub fn new(walls: Arc<Walls>, walk: Walk, teleport_share: f64) -> Walker {
        let eye = walk.position + DVec3::Y * EYE_HEIGHT;
        Walker { walk, occlusion: WallsFrom::new(walls, eye), eye, teleport_share }
    }
}

impl ClientDriver for Walker {
    fn poses(&mut self, session: &Session, at: WorldTime, poses: &mut Vec<Pose>) {
        let place = self.walk.step(at);
        self.eye = place + DVec3::Y * EYE_HEIGHT;
        let avatars = session.welcome().map_or(&[][..], |welcome| &welcome.avatars);
        poses.extend(avatars.iter().map(|&(avatar, ..)| pose(avatar, place)));
    }

    fn cull(&mut self, _: Ahead) {
        self.occlusion = WallsFrom::new(self.walk.walls.clone(), self.eye);
    }

    fn occlusion(&self) -> Option<&dyn Occlusion> {
        Some(&self.occlusion)
    }

    fn eye(&self) -> Option<DVec3> {
        Some(self.eye)
    }

    fn frame_done(&mut self, session: &mut Session, _: Option<FrameTime>, _: WorldTime) {
        if self.walk.happens(self.teleport_share) {
            let place = self.walk.jump();
            if let Some(&(avatar, ..)) = session.welcome().and_then(|welcome| welcome.avatars.first()) {
                session.place(avatar, pose(avatar, place).position, true);
            }
        }
    }
}

/// Stands where `place` says, and looks all round.
pub struct Standing {
    walls: Arc<Walls>,
    place: Arc<std::sync::Mutex<DVec3>>,
    occlusion: WallsFrom,
    eye: DVec3,
}

impl Standing {
    /// Stands at `place`, which may be changed from outside.
    pub fn new(walls: Arc<Walls>, place: Arc<std::sync::Mutex<DVec3>>) -> Standing {
        let eye = *place.lock().expect("nothing panics while it holds the lock") + DVec3::Y * EYE_HEIGHT;
        Standing { occlusion: WallsFrom::new(walls.clone(), eye), walls, place, eye }
    }
}

impl ClientDriver for Standing {
    fn poses(&mut self, session: &Session, _: WorldTime, poses: &mut Vec<Pose>) {
        let place = *self.place.lock().expect("nothing panics while it holds the lock");
        self.eye = place + DVec3::Y * EYE_HEIGHT;
        let avatars = session.welcome().map_or(&[][..], |welcome| &welcome.avatars);
        poses.extend(avatars.iter().map(|&(avatar, ..)| pose(avatar, place)));
    }

    fn cull(&mut self, _: Ahead) {
        self.occlusion = WallsFrom::new(self.walls.clone(), self.eye);
    }

    fn occlusion(&self) -> Option<&dyn Occlusion> {
        Some(&self.occlusion)
    }

    fn eye(&self) -> Option<DVec3> {
        Some(self.eye)
    }
}

/// Moves many avatars and looks at nothing: an actor. Now and then one teleports, leaves, or comes again.
pub struct Crowd {
    walks: Vec<Walk>,
    present: Vec<bool>,
    teleport_share: f64,
    away_share: f64,
}

impl Crowd {
    /// One avatar a walk. The shares are of frames, per avatar.
    pub fn new(walks: Vec<Walk>, teleport_share: f64, away_share: f64) -> Crowd {
        Crowd { present: vec![false; walks.len()], walks, teleport_share, away_share }
    }
}

impl ClientDriver for Crowd {
    fn poses(&mut self, session: &Session, at: WorldTime, poses: &mut Vec<Pose>) {
        let avatars = session.welcome().map_or(&[][..], |welcome| &welcome.avatars);
        for (&(avatar, ..), walk) in avatars.iter().zip(&mut self.walks) {
            poses.push(pose(avatar, walk.step(at)));
        }
    }

    fn occlusion(&self) -> Option<&dyn Occlusion> {
        None
    }

    fn frame_done(&mut self, session: &mut Session, _: Option<FrameTime>, _: WorldTime) {
        let avatars: Vec<ObjectId> = match session.welcome() {
            Some(welcome) => welcome.avatars.iter().map(|&(avatar, ..)| avatar).collect(),
            None => return,
        };
        for ((avatar, walk), present) in avatars.into_iter().zip(&mut self.walks).zip(&mut self.present) {
            if !*present {
                if walk.at.is_none_or(|at| at.micros() < 1_500_000) || walk.happens(0.05) {
                    *present = true;
                    session.place(avatar, pose(avatar, walk.position).position, true);
                }
            } else if walk.happens(self.teleport_share) {
                let place = walk.jump();
                session.place(avatar, pose(avatar, place).position, true);
            } else if walk.happens(self.away_share) {
                *present = false;
                session.place(avatar, pose(avatar, walk.position).position, false);
            }
        }
    }
}
