//! What does a scene need, and what does leaving it in cost? The library part of `eyeline-sim plan` (DESIGN.md §8).
//!
//! A plan has two halves. What is drawn is counted in the scene's own views ([`eyeline_visibility::SceneCounts`]); what is tracked
//! and told is counted in a run of server and client in virtual time ([`live`]). [`cost`] holds each stage on against off, and
//! the planned culler against each fixed one; [`report`] shows it.

pub mod cost;
pub mod live;
pub mod report;

use std::sync::Arc;
use std::time::Duration;

use eyeline_client::plan::drawing_lines;
use eyeline_protocol::{Plan, PlanSwitch, Stage as PlanStage};
use eyeline_visibility::{Resolution, SceneCounts, View, count_storeys};
use serde::Serialize;

use crate::cull::{World, WorldRules};
use crate::scene::plan::RoomsRules;
use crate::stage::Stage;
use live::{Live, LiveRules};

/// A scene with what its plan is made from.
pub struct Planner {
    /// What is drawn.
    pub world: World,
    /// What is served.
    pub live: Live,
    /// From where one looks.
    pub views: Vec<View>,
}

impl Planner {
    /// Opens a made world or a file, with so many views.
    ///
    /// # Errors
    /// Names the file or the maker, and the remedy.
    pub fn open(name: &str, views: u32, seed: u64, resolution: Resolution) -> anyhow::Result<Planner> {
        let world = World::open(name, &WorldRules { views: Some(views), ..WorldRules::default() })?;
        let path = world.cameras(Some(views), seed);
        let views = path.views(world.scene.anchor(), resolution);
        let live = match name {
            "rooms" => Live::of_stage(Stage::made(&RoomsRules::default())?),
            "room" => Live::of_stage(Stage::made(&RoomsRules { columns: 1, rows: 1, ..RoomsRules::default() })?),
            _ if crate::cull::world::MADE.contains(&name) => {
                let eye = views.first().map_or(world.scene.bounds().centre(), |view| view.eye);
                Live::of_scene(Arc::clone(&world.scene), &world.name, eye)
            }
            file => Live::of_stage(Stage::load(file.as_ref(), None)?),
        };
        Ok(Planner { world, live, views })
    }

    /// What is counted in the views.
    pub fn counts(&self) -> SceneCounts {
        SceneCounts::of(self.world.scene.clone(), &self.views)
    }

    /// The whole plan: what is drawn, what a client tracks, what a server tells.
    ///
    /// # Errors
    /// If the world contradicts itself.
    pub fn plan(&self, switch: PlanSwitch, seed: u64) -> anyhow::Result<Plan> {
        let mut plan = Plan { lines: drawing_lines(switch, &self.counts().counts, &count_storeys(&self.world.scene)) };
        let rules = LiveRules { seconds: 2.0, switch, seed, ..LiveRules::default() };
        plan.lines.extend(self.live.run(&rules)?.plan.lines);
        Ok(plan)
    }
}

/// A line of a plan as a row.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[expect(missing_docs, reason = "each column's meaning is in `report::plan_columns`")]
pub struct PlanRow {
    pub world: String,
    pub stage: &'static str,
    pub verdict: &'static str,
    pub evidence: String,
    pub change: String,
}

impl PlanRow {
    /// The rows of a world's plan.
    pub fn all(world: &str, plan: &Plan) -> Vec<PlanRow> {
        let row = |line: &eyeline_protocol::PlanLine| PlanRow {
            world: world.to_owned(),
            stage: line.stage.name(),
            verdict: line.verdict(),
            evidence: line.evidence.clone(),
            change: line.change.clone(),
        };
        plan.lines.iter().map(row).collect()
    }
}

/// A stage whose cost is told by runs of server and client.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LiveStage {
    /// Which.
    pub stage: PlanStage,
    /// Whether the eye walks in them.
    pub walks: bool,
    /// The server's policy in them, by its name.
    pub policy: &'static str,
}

impl LiveStage {
    const fn new(stage: PlanStage, walks: bool) -> LiveStage {
        LiveStage { stage, walks, policy: "visible" }
    }
}

/// All of them. Only policies that look for what is near have an index to share.
pub const LIVE_STAGES: [LiveStage; 7] = [
    LiveStage::new(PlanStage::Tracker, false),
    LiveStage::new(PlanStage::LookAgain, false),
    LiveStage::new(PlanStage::Exact, false),
    LiveStage::new(PlanStage::Sealed, true),
    LiveStage::new(PlanStage::Swept, true),
    LiveStage::new(PlanStage::States, false),
    LiveStage { policy: "radius", ..LiveStage::new(PlanStage::Sharing, true) },
];

/// Time between frames and ticks of such runs.
pub const FRAME: Duration = Duration::from_millis(50);

#[cfg(test)]
mod tests;
