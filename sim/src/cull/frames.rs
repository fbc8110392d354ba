//! How did a culler do on each view? The papers' curves over a path: what was found, what was wrong, how long it took and how much of it
//! was new, frame by frame (Klosowski & Silva 2000, §5.2 and figures 10 to 12).
//!
//! Rows of a report are means and extremes over all views. This is what they are made of, in a file of its own, `frames.csv`.

use std::path::Path;

use anyhow::Context;
use serde::Serialize;

use super::row::CullRow;
use crate::report::{Axis, Plot, PlotKind, Point, Series};

/// One culler with one setting, on one view.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FrameRow {
    /// As in [`CullRow`].
    pub culler: String,
    /// As in [`CullRow`].
    pub tessellation: Option<String>,
    /// As in [`CullRow`].
    pub query: Option<String>,
    /// As in [`CullRow`].
    pub budget: Option<String>,
    /// As in [`CullRow`].
    pub resolution: String,
    /// As in [`CullRow`], metres.
    pub eye_radius: f64,
    /// Which view of the path, from 0.
    pub view: usize,
    /// Primitives and objects that own a pixel.
    pub exact: usize,
    /// Of these, those that were reported.
    pub found: usize,
    /// ε_k: the latter over the former, 1 of none.
    pub visible_found: f64,
    /// Pixels whose winner differs from the plain Z-buffer's.
    pub wrong_pixels: u64,
    /// Primitives reported.
    pub kept: usize,
    /// Share of the primitives reported that the view before did not report; none of the first view.
    pub drawn_churn: Option<f64>,
    /// Culling, milliseconds: median of the repeats; none if there were none.
    pub frame_ms: Option<f64>,
}

/// What a view came to, before it is known under which names.
#[derive(Clone, Copy, Debug)]
pub(super) struct Frame {
    pub(super) exact: usize,
    pub(super) found: usize,
    pub(super) wrong_pixels: u64,
    pub(super) kept: usize,
    pub(super) drawn_churn: Option<f64>,
}

/// The rows of the views of `row`; times where views were timed.
pub(super) fn frame_rows(row: &CullRow, frames: &[Frame], frame_ms: Option<&[f64]>) -> Vec<FrameRow> {
    let of = |(view, frame): (usize, &Frame)| FrameRow {
        culler: row.culler.clone(),
        tessellation: row.tessellation.clone(),
        query: row.query.clone(),
        budget: row.budget.clone(),
        resolution: row.resolution.clone(),
        eye_radius: row.eye_radius,
        view,
        exact: frame.exact,
        found: frame.found,
        visible_found: if frame.exact == 0 { 1.0 } else { frame.found as f64 / frame.exact as f64 },
        wrong_pixels: frame.wrong_pixels,
        kept: frame.kept,
        drawn_churn: frame.drawn_churn,
        frame_ms: frame_ms.and_then(|times| times.get(view).copied()),
    };
    frames.iter().enumerate().map(of).collect()
}

/// Writes `frames.csv` into a folder, which is made if need be.
///
/// # Errors
/// Names the file that cannot be written.
pub fn write_frames(frames: &[FrameRow], folder: &Path) -> anyhow::Result<()> {
    let path = folder.join("frames.csv");
    let write = || -> anyhow::Result<()> {
        std::fs::create_dir_all(folder)?;
        let mut writer = csv::Writer::from_path(&path)?;
        frames.iter().try_for_each(|frame| writer.serialize(frame))?;
        Ok(writer.flush()?)
    };
    write().with_context(|| format!("cannot write {}", path.display()))
}

/// The paper's figures 10a and 12b: what each guess finds of what is visible, and what it gets wrong, view by view, of the first
/// resolution and radius. None where nothing guesses. `frames` are those of `rows`, in their order.
pub(super) fn plots(frames: &[FrameRow], rows: &[CullRow]) -> Vec<Plot> {
    let Some(first) = rows.first() else { return Vec::new() };
    let mut rest = frames;
    let mut lines: Vec<(String, &[FrameRow])> = Vec::new();
    for row in rows {
        let (own, others) = rest.split_at(row.frames.min(rest.len()));
        rest = others;
        let is_first = (&row.resolution, row.eye_radius) == (&first.resolution, first.eye_radius);
        if is_first && row.budget.is_some() && !row.conservative {
            let parts = [Some(row.culler.as_str()), row.tessellation.as_deref(), row.budget.as_deref()];
            lines.push((parts.into_iter().flatten().collect::<Vec<&str>>().join(" · "), own));
        }
    }
    let Some((_, any)) = lines.first() else { return Vec::new() };
    let series = |name: &str, frames: &[FrameRow], y: fn(&FrameRow) -> f64| {
        Series::new(name, frames.iter().map(|frame| Point::new(frame.view as f64, y(frame))).collect())
    };
    let plot = |title: &str, y: &str| Plot::new(title, PlotKind::Line, Axis::linear("view"), Axis::linear(y));
    let mut found = plot("Visible primitives found, view by view", "primitives");
    found = found.with_series(series("exact", any, |frame| frame.exact as f64));
    let mut wrong = plot("Wrong pixels, view by view", "pixels");
    for (name, frames) in &lines {
        found = found.with_series(series(name, frames, |frame| frame.found as f64));
        wrong = wrong.with_series(series(name, frames, |frame| frame.wrong_pixels as f64));
    }
    vec![found, wrong]
}
