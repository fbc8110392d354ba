//! How a client of a town culls: by images as people's clients do, or by geometry in plan, which is quick.

use std::sync::Arc;

use eyeline_visibility::{AllRound, AllRoundScratch, EyeRegion, Occlusion};
use glam::DVec3;

use super::walls::{Walls, WallsFrom};

/// The scene of a town, ready to be looked at. One for all clients.
#[derive(Clone)]
pub struct Ground {
    /// The walls, for the truth.
    pub walls: Arc<Walls>,
    /// The same as occluders, and how many pixels a side the cubes' faces have that clients draw them on; `None` to cull by
    /// geometry in plan.
    images: Option<(Arc<AllRound>, u32)>,
}

impl Ground {
    /// Clients cull by geometry in plan.
    pub fn in_plan(walls: Arc<Walls>) -> Ground {
        Ground { walls, images: None }
    }

    /// Clients cull on cubes whose faces have `side` pixels a side.
    pub fn with_images(walls: Arc<Walls>, side: u32) -> Ground {
        let all_round = Arc::new(AllRound::new(&walls.scene()));
        Ground { walls, images: Some((all_round, side)) }
    }

    /// What one client needs to look at it.
    pub fn sight(&self) -> Sight {
        let images = self.images.as_ref().map(|(all_round, side)| (Arc::clone(all_round), all_round.scratch(*side)));
        Sight { walls: Arc::clone(&self.walls), images, in_plan: None, has_culled: false }
    }
}

/// One client's culler and its newest result.
pub struct Sight {
    walls: Arc<Walls>,
    images: Option<(Arc<AllRound>, AllRoundScratch)>,
    in_plan: Option<WallsFrom>,
    has_culled: bool,
}

impl Sight {
    /// Looks from every eye within `radius` metres of `eye`.
    pub fn cull(&mut self, eye: DVec3, radius: f64) {
        let region = EyeRegion { centre: eye, radius };
        match &mut self.images {
            Some((all_round, scratch)) => self.has_culled = all_round.cull(region, scratch).is_ok(),
            None => self.in_plan = Some(WallsFrom::new(Arc::clone(&self.walls), region)),
        }
    }

    /// What hides things from there; `None` before the first look.
    pub fn occlusion(&self) -> Option<&dyn Occlusion> {
        match &self.images {
            Some((_, scratch)) => self.has_culled.then(|| scratch.occlusion() as &dyn Occlusion),
            None => self.in_plan.as_ref().map(|in_plan| in_plan as &dyn Occlusion),
        }
    }
}
