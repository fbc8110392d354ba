//! One row of a comparison of trackers, and what its columns mean.

use serde::Serialize;

use crate::report::Column;

/// One setting over a run of frames.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
#[expect(missing_docs, reason = "each column's meaning is in `columns`, where the report takes it from")]
pub struct TrackRow {
    pub sweep: String,
    pub paper: String,
    pub x: f64,
    pub culler: String,
    pub variant: String,
    pub shape: String,
    pub validity: String,
    pub index: String,
    pub motion: String,
    pub eye: String,
    pub resolution: String,
    pub static_triangles: usize,
    pub objects: usize,
    pub visible: f64,
    pub hidden: f64,
    pub violated: f64,
    pub fuzzy: f64,
    pub violated_per_frame: f64,
    pub tried_bounds: u64,
    pub broken_share: f64,
    pub frames: u64,
    pub work: f64,
    pub work_static: f64,
    pub work_tracking: f64,
    pub work_drawing: f64,
    pub nodes_in_frustum: f64,
    pub relations_per_frame: f64,
    pub relations_made_per_frame: f64,
    pub frame_ms: f64,
    pub frame_ms_p95: f64,
    pub draw_ms: f64,
    pub total_ms: f64,
    pub updates_per_frame: f64,
    pub bounds_per_frame: f64,
    pub hidden_caused_per_frame: f64,
    pub exposed_per_frame: f64,
    pub expired_per_frame: f64,
    pub truth_frames: u64,
    pub wrong_pixels_max: u64,
    pub other_wrong_pixels_max: u64,
    pub absences: u64,
    pub absent_frames_max: u64,
    pub broken_bounds: u64,
    pub ok: bool,
}

/// Columns that hold measured times, which no two runs share.
pub const TIMES: [&str; 4] = ["frame_ms", "frame_ms_p95", "draw_ms", "total_ms"];

/// The columns of the table on the terminal.
pub const SHORT: [&str; 14] = [
    "x",
    "culler",
    "variant",
    "shape",
    "validity",
    "visible",
    "hidden",
    "work",
    "total_ms",
    "updates_per_frame",
    "bounds_per_frame",
    "hidden_caused_per_frame",
    "wrong_pixels_max",
    "absent_frames_max",
];

/// The same for sweeps in which nothing moves but the eye.
pub const SHORT_STILL: [&str; 12] = [
    "x",
    "culler",
    "variant",
    "work_static",
    "work_drawing",
    "nodes_in_frustum",
    "relations_per_frame",
    "relations_made_per_frame",
    "frame_ms",
    "draw_ms",
    "total_ms",
    "wrong_pixels_max",
];

/// What the columns mean.
pub fn columns() -> Vec<Column> {
    let column = |key: &str, unit: &str, meaning: &str| Column::new(key, unit, meaning);
    vec![
        column("sweep", "", "which sweep"),
        column("paper", "", "where the papers show the like"),
        column("x", "", "what is swept: the sweep says what it is"),
        column("culler", "", "what culls the static scene (𝒜)"),
        column(
            "variant",
            "",
            "how T is kept: tbv-e (§3.3), tbv-i (§3.6), every-object (HZB with hierarchical-z), no-hierarchy (ZB with z-buffer); \
             in Coorg & Teller's tables, what the culler does without, or whether it keeps relations between frames",
        ),
        column("shape", "", "shape of the TBVs"),
        column("validity", "", "who chooses validity periods (§3.4)"),
        column(
            "index",
            "",
            "structure of T: a loose octree, or the paper's with one or many references each (Figs. 9 and 10)",
        ),
        column("motion", "", "how the objects move"),
        column("eye", "", "whether the viewer stands or walks"),
        column("resolution", "px", "size of the images"),
        column("static_triangles", "", "triangles of the static scene"),
        column("objects", "", "moving objects"),
        column("visible", "", "objects displayed in a frame, mean"),
        column("hidden", "", "objects not displayed in a frame, mean"),
        column("violated", "", "share of the valid TBVs that is broken in each frame (Fig. 14)"),
        column("fuzzy", "", "probability with which a TBV may be broken, learned from motion (§3.5); 0 for hard ones"),
        column("violated_per_frame", "1/frame", "TBVs in use that their objects broke"),
        column("tried_bounds", "", "fuzzy TBVs of 0.2 to 25 s, made at regular times and followed until they expired"),
        column("broken_share", "", "share of them that their objects broke"),
        column("frames", "", "frames counted, after the first ones in which everything is new"),
        column("work", "", "nodes visited + bounds tested + primitives drawn, per frame"),
        column("work_static", "", "of it, the static culler's nodes and bounds, and relations looked at"),
        column("work_tracking", "", "of it, nodes of T visited and updated, and bounds tested"),
        column("work_drawing", "", "of it, primitives drawn: the visible set's and the displayed objects'"),
        column(
            "nodes_in_frustum",
            "1/frame",
            "nodes of the kD-tree in the frustum that large occluders were held against",
        ),
        column(
            "relations_per_frame",
            "1/frame",
            "pairs of a large occluder and a box whose planes were looked at: the others' answers still held",
        ),
        column("relations_made_per_frame", "1/frame", "of them, pairs whose planes were computed"),
        column(
            "frame_ms",
            "ms",
            "culling and tracking, mean; all settings of a sweep's point run interleaved, frame by frame",
        ),
        column("frame_ms_p95", "ms", "95th percentile of that"),
        column("draw_ms", "ms", "drawing what is displayed into the item buffer, mean"),
        column("total_ms", "ms", "frame_ms + draw_ms"),
        column("updates_per_frame", "1/frame", "configurations obtained: a message each (DSVC Upd of Fig. 15b)"),
        column("bounds_per_frame", "1/frame", "TBVs obtained: a message each (DSVC TBV of Fig. 15b)"),
        column(
            "hidden_caused_per_frame",
            "1/frame",
            "of these messages, the ones about objects that the frame did not display",
        ),
        column("exposed_per_frame", "1/frame", "TBVs that became visible"),
        column("expired_per_frame", "1/frame", "TBVs whose time was up"),
        column("truth_frames", "", "frames compared with the picture of everything"),
        column(
            "wrong_pixels_max",
            "px",
            "most pixels of a frame whose winner is another than when every object is updated and drawn",
        ),
        column("other_wrong_pixels_max", "px", "the same without the pixels of objects that were absent"),
        column("absences", "", "objects that owned a pixel and were not displayed, summed over frames"),
        column("absent_frames_max", "", "most compared frames running in which one object was absent"),
        column("broken_bounds", "", "TBVs found not to contain their object, in frames compared: a fault"),
        column(
            "ok",
            "",
            "whether the variant kept its promise: TBVe and the baselines no wrong pixel, TBVi no absence of two frames",
        ),
    ]
}
