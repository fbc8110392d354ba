//! People: one who walks and looks, one who stands where it is put, and a crowd that is only moved.

use std::sync::Arc;

use eyeline_client::session::{FrameTime, Session};
use eyeline_client::tracking::Ahead;
use eyeline_protocol::{ObjectId, Orientation, Position, WorldTime};
use eyeline_visibility::Occlusion;
use glam::DVec3;

use super::sight::{Ground, Sight};
use super::walk::{Board, Walk};
use super::walls::Walls;
use crate::virtual_net::{ClientDriver, Pose};

const EYE_HEIGHT: f64 = 1.6;

fn pose(object: ObjectId, place: DVec3) -> Pose {
    let position = Position::from_metres(place).expect("towns are small");
    Pose { object, position, orientation: Orientation::default() }
}

/// Walks and looks all round. Sometimes it teleports.
pub struct Walker {
    walk: Walk,
    sight: Sight,
    eye: DVec3,
    teleport_share: f64,
    board: Board,
    entry: usize,
}

impl Walker {
    /// A walker that teleports at this share of its frames, and tells the `board` under `entry` where its eyes are.
    pub fn new(ground: &Ground, walk: Walk, teleport_share: f64, board: Board, entry: usize) -> Walker {
        let eye = walk.position() + DVec3::Y * EYE_HEIGHT;
        Walker { walk, sight: ground.sight(), eye, teleport_share, board, entry }
    }
}

impl ClientDriver for Walker {
    fn poses(&mut self, session: &Session, at: WorldTime, poses: &mut Vec<Pose>) {
        let place = self.walk.step(at);
        self.eye = place + DVec3::Y * EYE_HEIGHT;
        self.board.note(self.entry, self.eye);
        let avatars = session.welcome().map_or(&[][..], |welcome| &welcome.avatars);
        poses.extend(avatars.iter().map(|&(avatar, ..)| pose(avatar, place)));
    }

    fn cull(&mut self, ahead: Ahead) {
        self.sight.cull(self.eye, ahead.eye_radius);
    }

    fn occlusion(&self) -> Option<&dyn Occlusion> {
        self.sight.occlusion()
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
    place: Arc<std::sync::Mutex<DVec3>>,
    sight: Sight,
    eye: DVec3,
}

impl Standing {
    /// Stands at `place`, which may be changed from outside, and culls by geometry in plan.
    pub fn new(walls: Arc<Walls>, place: Arc<std::sync::Mutex<DVec3>>) -> Standing {
        let eye = *place.lock().expect("nothing panics while it holds the lock") + DVec3::Y * EYE_HEIGHT;
        Standing { sight: Ground::in_plan(walls).sight(), place, eye }
    }
}

impl ClientDriver for Standing {
    fn poses(&mut self, session: &Session, _: WorldTime, poses: &mut Vec<Pose>) {
        let place = *self.place.lock().expect("nothing panics while it holds the lock");
        self.eye = place + DVec3::Y * EYE_HEIGHT;
        let avatars = session.welcome().map_or(&[][..], |welcome| &welcome.avatars);
        poses.extend(avatars.iter().map(|&(avatar, ..)| pose(avatar, place)));
    }

    fn cull(&mut self, ahead: Ahead) {
        self.sight.cull(self.eye, ahead.eye_radius);
    }

    fn occlusion(&self) -> Option<&dyn Occlusion> {
        self.sight.occlusion()
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
                if walk.at().is_none_or(|at| at.micros() < 1_500_000) || walk.happens(0.05) {
                    *present = true;
                    session.place(avatar, pose(avatar, walk.position()).position, true);
                }
            } else if walk.happens(self.teleport_share) {
                let place = walk.jump();
                session.place(avatar, pose(avatar, place).position, true);
            } else if walk.happens(self.away_share) {
                *present = false;
                session.place(avatar, pose(avatar, walk.position()).position, false);
            }
        }
    }
}
