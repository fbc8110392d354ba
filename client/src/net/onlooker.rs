//! The simplest person in front of a headless client: stands where the server put it, or floats somewhere, and turns.

use std::f64::consts::TAU;
use std::sync::Arc;

use eyeline_protocol::{LocalTime, ObjectId, Orientation, Position, Stage, Welcome};
use eyeline_visibility::{AllRound, AllRoundScratch, EyeRegion, Occlusion, Scene};
use glam::DVec3;

use super::parts::PartsLater;
use super::{Driver, FrameReport, Pose};
use crate::session::Session;
use crate::tracking::Ahead;

/// Turn of an onlooker: once around in twelve seconds.
const TURN_RATE: f64 = TAU / 12.0;

/// Called after each frame.
pub type OnFrame<'a> = Box<dyn FnMut(&mut Session, &FrameReport) + 'a>;

/// Stands at its spawn point, or floats where it was told, and turns, and sees what hides things from there.
pub struct Onlooker<'a> {
    /// Its avatar; none if it only looks.
    object: Option<ObjectId>,
    position: Position,
    eye: DVec3,
    yaw: f64,
    all_round: Arc<AllRound>,
    scratch: AllRoundScratch,
    is_culled: bool,
    /// Whether an eye that stands still is culled for again.
    looks_again: bool,
    /// Which parts of the scene walls seal off, if that is to be found out.
    parts: Option<PartsLater>,
    on_frame: OnFrame<'a>,
}

impl<'a> Onlooker<'a> {
    /// Somebody who stands where `welcome` says and culls on cube faces of `side` pixels; `None` if the server gave no
    /// avatar.
    pub fn new(scene: &Scene, welcome: &Welcome, side: u32, on_frame: OnFrame<'a>) -> Option<Onlooker<'a>> {
        let &(object, position, _) = welcome.avatars.first()?;
        // Avatars are the first class.
        let eye_height = welcome.classes.first().map_or(0.0, |class| class.eye_height);
        let eye = position.metres() + DVec3::Y * eye_height;
        Some(Onlooker::with_eye(scene, Some(object), position, eye, side, on_frame))
    }

    /// Somebody who has no avatar and looks from `eye`, relative to the anchor: whose token lets it fly.
    pub fn flying(scene: &Scene, eye: Position, side: u32, on_frame: OnFrame<'a>) -> Onlooker<'a> {
        Onlooker::with_eye(scene, None, eye, eye.metres(), side, on_frame)
    }

    fn with_eye(
        scene: &Scene,
        object: Option<ObjectId>,
        position: Position,
        eye: DVec3,
        side: u32,
        on_frame: OnFrame<'a>,
    ) -> Onlooker<'a> {
        let all_round = Arc::new(AllRound::new(scene));
        let scratch = all_round.scratch(side);
        Onlooker {
            object,
            position,
            eye,
            yaw: 0.0,
            scratch,
            all_round,
            is_culled: false,
            looks_again: false,
            parts: None,
            on_frame,
        }
    }

    /// The same, and finds out which parts of `scene` walls seal off, by another thread, once something may lie in one:
    /// that is left alone then. The scene must be the same.
    pub fn with_sealed_parts(self, scene: &Arc<Scene>) -> Onlooker<'a> {
        Onlooker { parts: Some(PartsLater::new(Arc::clone(scene))), ..self }
    }
}

impl Driver for Onlooker<'_> {
    fn poses(&mut self, session: &Session, now: LocalTime) -> Vec<Pose> {
        self.looks_again = session.plan_switch().runs(Stage::LookAgain, false);
        if let Some(parts) = self.parts.as_mut().and_then(|later| later.poll(session)) {
            self.all_round = Arc::new(self.all_round.with_parts(parts));
        }
        self.yaw = (now.seconds_since(LocalTime::ZERO) * TURN_RATE).rem_euclid(TAU);
        let orientation = Orientation::from_yaw(self.yaw);
        self.object.map(|object| Pose { object, position: self.position, orientation }).into_iter().collect()
    }

    fn cull(&mut self, ahead: Ahead) {
        let region = EyeRegion { centre: self.eye, radius: ahead.eye_radius };
        // Who never moves need not look twice.
        self.is_culled = match self.looks_again {
            true => self.all_round.cull(region, &mut self.scratch).is_ok(),
            false => self.all_round.look(region, &mut self.scratch).is_ok(),
        };
    }

    fn occlusion(&self) -> Option<&dyn Occlusion> {
        self.is_culled.then(|| self.scratch.occlusion() as &dyn Occlusion)
    }

    fn frame_done(&mut self, session: &mut Session, report: &FrameReport) {
        if self.object.is_none() {
            session.set_eye(self.position, Orientation::from_yaw(self.yaw));
        }
        (self.on_frame)(session, report);
    }
}
