//! The simplest person in front of a headless client: stands where the server put it, and turns.

use std::f64::consts::TAU;
use std::sync::Arc;

use eyeline_protocol::{LocalTime, ObjectId, Orientation, Position, Welcome};
use eyeline_visibility::{AllRound, AllRoundScratch, EyeRegion, Occlusion, Scene};
use glam::DVec3;

use super::{Driver, FrameReport, Pose};
use crate::session::Session;
use crate::tracking::Ahead;

/// Turn of an onlooker: once around in twelve seconds.
const TURN_RATE: f64 = TAU / 12.0;

/// Called after each frame.
pub type OnFrame<'a> = Box<dyn FnMut(&mut Session, &FrameReport) + 'a>;

/// Stands at its spawn point and turns, and sees what hides things from there.
pub struct Onlooker<'a> {
    object: ObjectId,
    position: Position,
    eye: DVec3,
    all_round: Arc<AllRound>,
    scratch: AllRoundScratch,
    /// Radius of the region that was culled from.
    culled: Option<f64>,
    on_frame: OnFrame<'a>,
}

impl<'a> Onlooker<'a> {
    /// Somebody who stands where `welcome` says and culls on cube faces of `side` pixels; `None` if the server gave no
    /// avatar.
    pub fn new(scene: &Scene, welcome: &Welcome, side: u32, on_frame: OnFrame<'a>) -> Option<Onlooker<'a>> {
        let &(object, position, _) = welcome.avatars.first()?;
        // Avatars are the first class.
        let eye_height = welcome.classes.first().map_or(0.0, |class| class.eye_height);
        let all_round = Arc::new(AllRound::new(scene));
        Some(Onlooker {
            object,
            position,
            eye: position.metres() + DVec3::Y * eye_height,
            scratch: all_round.scratch(side),
            all_round,
            culled: None,
            on_frame,
        })
    }
}

impl Driver for Onlooker<'_> {
    fn poses(&mut self, _: &Session, now: LocalTime) -> Vec<Pose> {
        let yaw = (now.seconds_since(LocalTime::ZERO) * TURN_RATE).rem_euclid(TAU);
        vec![Pose { object: self.object, position: self.position, orientation: Orientation::from_yaw(yaw) }]
    }

    fn cull(&mut self, ahead: Ahead) {
        // Who never moves need not look twice.
        if self.culled != Some(ahead.eye_radius) {
            let region = EyeRegion { centre: self.eye, radius: ahead.eye_radius };
            self.culled = self.all_round.cull(region, &mut self.scratch).is_ok().then_some(ahead.eye_radius);
        }
    }

    fn occlusion(&self) -> Option<&dyn Occlusion> {
        self.culled.map(|_| self.scratch.occlusion() as &dyn Occlusion)
    }

    fn frame_done(&mut self, session: &mut Session, report: &FrameReport) {
        (self.on_frame)(session, report);
    }
}
