//! One row of a comparison of cullers, and what its columns mean.

use serde::Serialize;

use crate::report::Column;

/// One culler with one setting, over all views.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[expect(missing_docs, reason = "each column's meaning is in `columns`, where the report takes it from")]
pub struct CullRow {
    pub world: String,
    pub culler: String,
    pub tessellation: Option<String>,
    pub tessellation_why: Option<String>,
    pub query: Option<String>,
    pub budget: Option<String>,
    pub budget_triangles: Option<usize>,
    pub resolution: String,
    pub eye_radius: f64,
    pub eyes: usize,
    pub frames: usize,
    pub conservative: bool,
    pub ok: bool,
    pub wrong_pixels_max: u64,
    pub wrong_pixels_mean: f64,
    pub lost_visible: u64,
    pub cracks: u64,
    pub visible_found: f64,
    pub visible_found_mean: f64,
    pub visible_found_least: f64,
    pub wrong_percent_max: f64,
    pub churn: f64,
    pub kept: f64,
    pub exact: f64,
    pub kept_over_exact: Option<f64>,
    pub objects_kept: Option<f64>,
    pub objects_exact: Option<f64>,
    pub objects_rectangle: Option<f64>,
    pub objects_lost: u64,
    pub rounds: f64,
    pub rounds_max: usize,
    pub passes: f64,
    pub cells: f64,
    pub queries: f64,
    pub visible_query_pixels: f64,
    pub bounds: f64,
    pub occluders: f64,
    pub plp_triangles: f64,
    pub extra_triangles: f64,
    pub z_tests_per_pixel: f64,
    pub query_z_tests_counted: bool,
    pub frame_ms: f64,
    pub frame_ms_median: f64,
    pub frame_ms_p95: f64,
    pub max_pass_ms: f64,
    pub per_max_pass: f64,
    pub draw_ms: f64,
    pub total_ms: f64,
    pub build_ms: f64,
}

/// Columns that hold measured times, which no two runs share.
pub const TIMES: [&str; 8] =
    ["frame_ms", "frame_ms_median", "frame_ms_p95", "max_pass_ms", "per_max_pass", "draw_ms", "total_ms", "build_ms"];

/// The columns of the table on the terminal.
pub const SHORT: [&str; 17] = [
    "culler",
    "tessellation",
    "query",
    "budget",
    "resolution",
    "eye_radius",
    "wrong_pixels_max",
    "wrong_percent_max",
    "visible_found_mean",
    "visible_found_least",
    "lost_visible",
    "kept",
    "exact",
    "rounds",
    "z_tests_per_pixel",
    "frame_ms",
    "per_max_pass",
];

/// What the columns mean.
pub fn columns() -> Vec<Column> {
    let column = |key: &str, unit: &str, meaning: &str| Column::new(key, unit, meaning);
    vec![
        column("world", "", "what was looked at"),
        column("culler", "", "which culler"),
        column("tessellation", "", "what its cells are, if it has any"),
        column("tessellation_why", "", "why these cells and not those that were asked for, if so"),
        column("query", "", "what answers its queries, if it asks any"),
        column("budget", "", "what PLP may draw by guess, as it was given: triangles, or a share of the scene's"),
        column("budget_triangles", "", "the same in triangles"),
        column("resolution", "px", "size of the images"),
        column("eye_radius", "m", "radius of the ball of eyes that the visible set must hold for"),
        column("eyes", "", "eyes of the ball that the exact set was computed for, its middle included"),
        column("frames", "", "views"),
        column("conservative", "", "whether the culler promises to lose nothing"),
        column("ok", "", "no wrong pixel and nothing lost, or nothing promised"),
        column(
            "wrong_pixels_max",
            "px",
            "most pixels of a picture whose winner differs from the plain Z-buffer's; with a ball, from its worst eye",
        ),
        column("wrong_pixels_mean", "px", "mean of that over all views"),
        column(
            "cracks",
            "",
            "primitives not counted as lost: they show in pixels that no ray meets them in (for `region`)",
        ),
        column("lost_visible", "", "exact-visible primitives and objects that were not reported, summed over views"),
        column("visible_found", "", "ε_k: share of the exact set that was reported, all views together"),
        column("visible_found_mean", "", "mean over views of ε_k, the share of a view's exact set that was reported"),
        column("visible_found_least", "", "least ε_k of a view"),
        column("wrong_percent_max", "%", "wrong_pixels_max of all pixels"),
        column(
            "churn",
            "",
            "share of what a view shows of its exact set that the view before did not show, mean: popping",
        ),
        column("kept", "", "primitives reported per view, mean"),
        column("exact", "", "primitives of the exact set per view, mean"),
        column("kept_over_exact", "", "kept / exact"),
        column("objects_kept", "", "objects per view whose box was not hidden, mean"),
        column("objects_exact", "", "objects per view that own a pixel, mean"),
        column(
            "objects_rectangle",
            "",
            "objects per view that a screen rectangle against the finished depth buffer keeps, mean: the least that any rectangle can do",
        ),
        column(
            "objects_lost",
            "",
            "objects that own a pixel and whose box was hidden, summed over views; part of lost_visible",
        ),
        column("rounds", "", "times that a whole front was queried, per view, mean"),
        column("rounds_max", "", "most of these in one view"),
        column(
            "passes",
            "",
            "images that queries drew, per view: one a round where fragments are counted, else several",
        ),
        column("cells", "", "cells projected per view, mean"),
        column("queries", "", "cells asked about per view, mean"),
        column(
            "visible_query_pixels",
            "",
            "depths compared by queries about cells that turned out to be seen, per view: what an occupancy map spares",
        ),
        column("bounds", "", "boxes of objects and clusters asked about, per view, where the culler asks them itself"),
        column(
            "occluders",
            "",
            "polygons drawn as occluders, per view, where these are not the visible set's triangles",
        ),
        column("plp_triangles", "", "triangles that PLP drew by guess, per view"),
        column("extra_triangles", "", "triangles that queries added to PLP's, per view (cPLP's Table 3)"),
        column(
            "z_tests_per_pixel",
            "",
            "the culler's own z-tests, drawing and queries, where it counts them; else those of drawing the visible set once",
        ),
        column("query_z_tests_counted", "", "whether z_tests_per_pixel are the culler's own, queries included"),
        column(
            "frame_ms",
            "ms",
            "culling a view and asking about its objects, nothing else: mean over views of the median of its repeats",
        ),
        column("frame_ms_median", "ms", "median over views of that"),
        column("frame_ms_p95", "ms", "95th percentile over views of that"),
        column(
            "max_pass_ms",
            "ms",
            "one f32 max over a buffer of so many pixels, run after each culled frame; mean as frame_ms",
        ),
        column("per_max_pass", "", "frame_ms / max_pass_ms: compares across machines and their moods"),
        column("draw_ms", "ms", "drawing the visible set into the item buffer, mean"),
        column("total_ms", "ms", "frame_ms + draw_ms"),
        column("build_ms", "ms", "making the culler, cells included; what settings share is paid by the first"),
    ]
}
