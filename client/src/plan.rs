//! What does this client leave out, and why? The client's lines of a plan (DESIGN.md §8).
//!
//! What is drawn follows [`eyeline_visibility::Planned`], which counts triangles in views. What is tracked follows what the server
//! tells of: without an object there is no tracker, and nobody culls for one. The server's lines are its own
//! (`eyeline_server::plan`).

use std::sync::Arc;

use eyeline_protocol::{Plan, PlanLine, PlanSwitch, Stage};
use eyeline_visibility::{
    Budget, Cplp, CplpCuller, Culler, MaskedCplp, Planned, PlannedRules, Prisms, Scene, SceneCounts, ViewCounts,
};

use crate::session::Session;

/// What a switch forces of culling.
pub fn drawing_rules(switch: PlanSwitch) -> PlannedRules {
    PlannedRules { frustum: switch.asked(Stage::Frustum), occlusion: switch.asked(Stage::Occlusion) }
}

/// A culler that follows what was counted, and what a switch forces. Where prisms are forced, cPLP walks them; a scene without
/// storeys gets the usual cells.
pub fn planned(counts: SceneCounts, switch: PlanSwitch) -> Planned {
    let planned = Planned::new(counts, drawing_rules(switch));
    match switch.runs(Stage::Prisms, false) {
        true => planned.with_occlusion(of_prisms),
        false => planned,
    }
}

fn of_prisms(scene: &Arc<Scene>) -> Arc<dyn Culler + Send + Sync> {
    match Prisms::build(scene) {
        Ok(prisms) => {
            Arc::new(CplpCuller::new(scene.clone(), Arc::new(Cplp::new(Arc::new(prisms))), Budget::default()))
        }
        Err(_) => Arc::new(MaskedCplp::build(scene.clone())),
    }
}

/// The lines about what is drawn: frustum, occlusion, prisms. `storeys` are those that were found and the number of their
/// walls, or what was counted instead ([`eyeline_visibility::count_storeys`]).
pub fn drawing_lines(
    switch: PlanSwitch,
    counts: &ViewCounts,
    storeys: &Result<(usize, usize), String>,
) -> Vec<PlanLine> {
    let views = counts.views.max(1);
    let percent = |share: f64| 100.0 * share;
    let frustum = format!(
        "{} triangles, of which {:.0} % are out of view ({} views)",
        counts.total / views,
        percent(if counts.views == 0 { 0.0 } else { counts.outside_share() }),
        counts.views
    );
    let occlusion = format!(
        "{:.0} % of the {} triangles in view are hidden",
        percent(counts.hidden_share()),
        counts.in_view / views
    );
    let prisms = match storeys {
        Ok((storeys, walls)) => format!(
            "{storeys} storeys with {walls} walls; but a prism is as high as its storey, and the culler of cells asks about boxes"
        ),
        Err(counted) => format!("no storeys: {counted}; boxes of a kD-tree instead"),
    };
    vec![
        PlanLine::new(
            switch,
            Stage::Frustum,
            counts.frustum_pays() || counts.occlusion_pays(false),
            frustum,
            "the scene has 1,000 triangles of which 5 % are out of view, or fewer",
        ),
        PlanLine::new(
            switch,
            Stage::Occlusion,
            counts.occlusion_pays(false),
            occlusion,
            "a third of what is in view is hidden; what runs stops at a fifth",
        ),
        PlanLine::new(switch, Stage::Prisms, false, prisms, "it is asked for"),
    ]
}

/// The lines about what is tracked.
pub(crate) fn tracking_lines(session: &Session, still_frames: u64) -> Vec<PlanLine> {
    let switch = session.plan_switch();
    let stats = session.tracker().map(|tracker| *tracker.stats()).unwrap_or_default();
    let (shown, hidden, asked) = session.tracker().map_or((0, 0, 0), |tracker| tracker.counts());
    let is_still = stats.still_frames > 0 || still_frames > 0;
    vec![
        PlanLine::new(
            switch,
            Stage::Tracker,
            session.tracker().is_some(),
            match session.tracker() {
                Some(_) => format!("{shown} objects in sight, {hidden} held hidden, {asked} asked for"),
                None => "the server tells of no object but our own avatar".to_owned(),
            },
            "an object is told of",
        ),
        PlanLine::new(
            switch,
            Stage::LookAgain,
            false,
            format!("{still_frames} frames had the eyes of the frame before; nothing was culled for them"),
            "it is asked for; an eye that moves is culled for in any case",
        ),
        PlanLine::new(
            switch,
            Stage::Exact,
            is_still,
            format!(
                "{} of {} tracked frames had a still eye; {} of {hidden} hidden objects can never come into its view and are not \
                 looked at again",
                stats.still_frames,
                stats.frames,
                session.tracker().map_or(0, |tracker| tracker.never_seen())
            ),
            "the eye stands still, or moves",
        ),
    ]
}

/// All lines of a client.
pub fn plan(mut drawing: Vec<PlanLine>, session: Option<&Session>, still_frames: u64) -> Plan {
    drawing.extend(session.into_iter().flat_map(|session| session.plan_lines(still_frames)));
    Plan { lines: drawing }
}
