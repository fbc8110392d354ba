//! The sweep `lca`: updates under the least common ancestor against updates from the root, in nodes and in time.

// This is a driver: it may read the clock.
#![expect(clippy::disallowed_methods)]

use std::time::Instant;

use eyeline_visibility::{References, SplitOctree, Update};

use super::lca::{LcaRow, LcaScene, cubes, table};
use super::row::TrackRow;
use super::run::IndexKind;
use super::sweep::Finding;

/// Ratios of the cubes' sides.
const RATIOS: [f64; 4] = [10.0, 100.0, 1_000.0, 10_000.0];
/// Steps that are timed at least, both updates in turn.
const STEPS: usize = 3_000;

/// Both scenes, both kinds of references, both updates: one row each.
pub fn run(mut progress: impl FnMut()) -> Vec<TrackRow> {
    let scenes: Vec<LcaScene> = RATIOS.into_iter().map(cubes).chain([table()]).collect();
    let mut rows = Vec::new();
    for (references, index) in [(References::Multiple, IndexKind::Multiple), (References::Single, IndexKind::Single)] {
        for scene in &scenes {
            let counted = scene.compare(references);
            let ms = step_ms(scene, references);
            for (update, ms) in [Update::Whole, Update::UnderLca].into_iter().zip(ms) {
                rows.push(row(&counted, update, index, ms));
            }
            progress();
        }
    }
    rows
}

/// Settings that [`run`] goes through.
pub const RUNS: u64 = 2 * (RATIOS.len() as u64 + 1);

fn row(counted: &LcaRow, update: Update, index: IndexKind, ms: f64) -> TrackRow {
    let (variant, visits) = match update {
        Update::Whole => ("update-whole", counted.visits_whole),
        Update::UnderLca => ("update-under-lca", counted.visits_lca),
    };
    let steps = counted.updates / 6;
    let work = visits as f64 / steps.max(1) as f64;
    TrackRow {
        sweep: "lca".into(),
        paper: "S&G §6.1.1".into(),
        x: counted.ratio,
        variant: variant.into(),
        motion: counted.scene.into(),
        index: index.name().into(),
        static_triangles: counted.still,
        objects: 6,
        visible: 6.0,
        frames: steps,
        work,
        work_tracking: work,
        frame_ms: ms,
        total_ms: ms,
        updates_per_frame: 6.0,
        ok: true,
        ..TrackRow::default()
    }
}

/// Milliseconds a step, whole and under the ancestor: the least of several stretches, run in turn.
fn step_ms(scene: &LcaScene, references: References) -> [f64; 2] {
    let mut trees: [SplitOctree; 2] = [Update::Whole, Update::UnderLca].map(|update| scene.tree(references, update));
    let (mut least, stretch) = ([f64::INFINITY; 2], STEPS / 10);
    for number in 0..10 {
        for (tree, least) in trees.iter_mut().zip(&mut least) {
            let began = Instant::now();
            (number * stretch..(number + 1) * stretch).for_each(|step| scene.step(tree, step));
            *least = least.min(began.elapsed().as_secs_f64() * 1e3 / stretch as f64);
        }
    }
    least
}

/// What the rows say.
pub fn findings(rows: &[TrackRow]) -> Vec<Finding> {
    let pairs = rows.chunks_exact(2).map(|pair| (&pair[0], &pair[1]));
    pairs
        .map(|(whole, lca)| {
            let visits = whole.work / lca.work;
            let has_bar = lca.motion == "table" && lca.index == IndexKind::Multiple.name();
            Finding {
                text: format!(
                    "{}, ratio {:.0}, {}: {visits:.2} times fewer nodes visited under the ancestor ({:.1} against {:.1} a \
                     step), {:.2} times less time{}",
                    lca.motion,
                    lca.x,
                    lca.index,
                    lca.work,
                    whole.work,
                    whole.frame_ms / lca.frame_ms,
                    if has_bar { "; the bar is 2.7 for nodes" } else { "" }
                ),
                met: has_bar.then_some(visits >= 2.7),
            }
        })
        .collect()
}
