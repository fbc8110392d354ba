//! What does this client leave out, and why? The client's lines of a plan (DESIGN.md §8).
//!
//! What is drawn follows [`eyeline_visibility::Planned`], which counts triangles in views. What is tracked follows what the server
//! tells of: without an object there is no tracker, and nobody culls for one. The server's lines are its own
//! (`eyeline_server::plan`).

use std::sync::Arc;

use eyeline_protocol::{Plan, PlanLine, PlanSwitch, Stage, how_many};
use eyeline_visibility::{
    Budget, Cplp, CplpCuller, Culler, KdRules, KdTree, MaskedCplp, Planned, PlannedRules, Prisms, Scene, SceneCounts,
    SealedParts, ViewCounts,
};

use crate::session::Session;

/// What a switch forces of culling.
pub fn drawing_rules(switch: PlanSwitch) -> PlannedRules {
    PlannedRules { frustum: switch.asked(Stage::Frustum), occlusion: switch.asked(Stage::Occlusion) }
}

/// A culler that follows what was counted, and what a switch forces. Where prisms are forced, cPLP walks them; a scene without
/// storeys gets the usual cells.
pub fn planned(counts: SceneCounts, switch: PlanSwitch) -> Planned {
    Planned::new(counts, drawing_rules(switch)).with_occlusion(occlusion_maker(switch))
}

/// Makes the culler of what is hidden that a switch asks for, which may take seconds for a large scene.
pub fn occlusion_maker(switch: PlanSwitch) -> fn(&Arc<Scene>) -> Arc<dyn Culler + Send + Sync> {
    if switch.runs(Stage::Prisms, false) { of_prisms } else { of_cells }
}

/// The parts of a scene that walls seal off from each other, which may take seconds for a large scene; `None` if there
/// is but one.
pub fn sealed_parts(scene: &Scene) -> Option<Arc<SealedParts>> {
    let parts = SealedParts::new(Arc::new(KdTree::build(scene, KdRules::default())));
    (parts.count() > 1).then(|| Arc::new(parts))
}

fn of_cells(scene: &Arc<Scene>) -> Arc<dyn Culler + Send + Sync> {
    Arc::new(MaskedCplp::build(scene.clone()))
}

fn of_prisms(scene: &Arc<Scene>) -> Arc<dyn Culler + Send + Sync> {
    match Prisms::build(scene) {
        Ok(prisms) => {
            Arc::new(CplpCuller::new(scene.clone(), Arc::new(Cplp::new(Arc::new(prisms))), Budget::default()))
        }
        Err(_) => of_cells(scene),
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
        "Of {}, {:.0} % are out of view on average over {}.",
        how_many((counts.total / views) as usize, "triangle"),
        percent(if counts.views == 0 { 0.0 } else { counts.outside_share() }),
        how_many(counts.views as usize, "view")
    );
    let occlusion = format!(
        "Of {} in view, {:.0} % are hidden by what is nearer.",
        how_many((counts.in_view / views) as usize, "triangle"),
        percent(counts.hidden_share())
    );
    let prisms = match storeys {
        Ok((storeys, walls)) => format!(
            "There are {} with {}, but a prism is as high as its storey, and the culler of cells asks about boxes.",
            how_many(*storeys, "storey"),
            how_many(*walls, "wall")
        ),
        Err(counted) => format!("The scene has no storeys ({counted}), so its cells are boxes."),
    };
    vec![
        PlanLine::new(
            switch,
            Stage::Frustum,
            counts.frustum_pays() || counts.occlusion_pays(false),
            frustum,
            "It pays from 1,000 triangles on, if at least 5 % of them are out of view.",
        ),
        PlanLine::new(
            switch,
            Stage::Occlusion,
            counts.occlusion_pays(false),
            occlusion,
            "It begins to pay where a third is hidden, and stops where less than a fifth is.",
        ),
        PlanLine::new(switch, Stage::Prisms, false, prisms, "Prisms are used only if they are asked for."),
    ]
}

/// The lines about what is tracked.
pub(crate) fn tracking_lines(session: &Session, still_frames: u64) -> Vec<PlanLine> {
    let switch = session.plan_switch();
    let stats = session.tracker_stats();
    let (shown, hidden, asked) = session.tracker().map_or((0, 0, 0), |tracker| tracker.counts());
    let sealed = session.tracker().map_or(0, |tracker| tracker.sealed_off());
    let is_still = stats.still_frames > 0 || still_frames > 0;
    vec![
        PlanLine::new(
            switch,
            Stage::Tracker,
            session.tracker().is_some(),
            match session.tracker() {
                Some(_) => format!(
                    "Of others {} in sight, {hidden} are held hidden, and {asked} are asked for.",
                    if shown == 1 { "1 is".to_owned() } else { format!("{shown} are") }
                ),
                None => "The server tells of nobody and nothing but our own avatar.".to_owned(),
            },
            "It is made when an object is told of, and let go of when none has been there for 100 frames.",
        ),
        PlanLine::new(
            switch,
            Stage::LookAgain,
            false,
            format!(
                "In {} the eyes were where they had been, and nothing was culled again.",
                how_many(still_frames as usize, "frame")
            ),
            "It is done only if it is asked for; eyes that move are culled for in any case.",
        ),
        PlanLine::new(
            switch,
            Stage::Exact,
            is_still,
            format!(
                "In {} of {} the eye stood still; of {} {} can never come into its view, and nobody looks at them again.",
                stats.still_frames,
                how_many(stats.frames as usize, "frame"),
                how_many(hidden, "hidden object"),
                session.tracker().map_or(0, |tracker| tracker.never_seen())
            ),
            "It runs in each frame in which the eye stands still.",
        ),
        PlanLine::new(
            switch,
            Stage::Sealed,
            sealed > 0,
            format!("Walls seal {sealed} of {} off from wherever the eye can go.", how_many(hidden, "hidden object")),
            "It runs where walls close a part of the scene off, and something in it stays in a bound that does not grow.",
        ),
    ]
}

/// All lines of a client.
pub fn plan(mut drawing: Vec<PlanLine>, session: Option<&Session>, still_frames: u64) -> Plan {
    drawing.extend(session.into_iter().flat_map(|session| session.plan_lines(still_frames)));
    Plan { lines: drawing }
}
