//! `measure`: server and clients, and the truth beside them.
//!
//! A run records every committed position and what every client believed in bursts of consecutive frames; afterwards
//! the truth is computed for those and compared. *Late* is judged by the promise (DESIGN §3.3): an object is drawn at most
//! one path round trip, one server turnaround and one frame after it first owned a pixel.

mod log;
mod quic;
pub mod report;
mod row;
mod truth;

use std::time::Duration;

use eyeline_client::tracking::{Growth, Sabotage};
use eyeline_visibility::Resolution;

pub use log::{Bursts, ClientLog, Commit, FrameLog, Known, ObjectInfo, RunLog};
pub use row::{MeasureRow, columns};
pub use truth::{Truth, judge};

use crate::report::Progress;
use crate::stage::{Crowd, Stage};

/// How the parts are connected.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Net {
    /// Real QUIC over loopback, in real time.
    Quic,
}

/// Settings of a measurement. Everything that a result depends on.
#[derive(Clone, Debug)]
pub struct MeasureConfig {
    /// Number of watching clients.
    pub clients: usize,
    /// Decides motion, starts and the choice of frames.
    pub seed: u64,
    /// Time that is run but not measured, for joining to settle.
    pub warm_up: Duration,
    /// Time that is measured.
    pub window: Duration,
    /// Ticks and frames a second.
    pub tick_hz: u32,
    /// The frames' resolution, with 90° across.
    pub resolution: Resolution,
    /// Pixels a side of the cube that trackers cull on.
    pub side: u32,
    /// Share of frames that truth is computed for.
    pub truth_share: f64,
    /// Consecutive frames in a burst of truth.
    pub burst_frames: u64,
    /// Least radius within which a hidden object's place is uncertain, metres.
    pub blur: f64,
    /// Who chooses validity periods.
    pub growth: Growth,
    /// Frames that something must be hidden before updates are declined.
    pub linger_frames: u32,
    /// Whether exposed bounds are first made fresh.
    pub staged: bool,
    /// Deliberate damage to the trackers.
    pub sabotage: Option<Sabotage>,
}

impl Default for MeasureConfig {
    fn default() -> MeasureConfig {
        MeasureConfig {
            clients: 32,
            seed: 7,
            warm_up: Duration::from_secs(2),
            window: Duration::from_secs(10),
            tick_hz: 20,
            resolution: Resolution::new(320, 240),
            side: 128,
            truth_share: 0.1,
            burst_frames: 20,
            blur: 1.0,
            growth: Growth::AtClient,
            linger_frames: 2,
            staged: true,
            sabotage: None,
        }
    }
}

impl MeasureConfig {
    /// Time between ticks, and between frames.
    pub fn frame(&self) -> Duration {
        Duration::from_micros(1_000_000 / u64::from(self.tick_hz.max(1)))
    }
}

/// Runs one policy and judges it.
///
/// # Errors
/// If the world can't be served, or a client loses its connection.
pub fn measure(
    stage: &Stage,
    crowd: Option<&Crowd>,
    config: &MeasureConfig,
    net: Net,
    policy: &str,
) -> anyhow::Result<MeasureRow> {
    let log = match net {
        Net::Quic => quic::run(stage, crowd, config, policy)?,
    };
    let frames = log.clients.iter().flat_map(|client| &client.frames).filter(|frame| frame.known.is_some()).count();
    let progress = Progress::new(frames as u64, &format!("{policy}: computing the truth"));
    let truth = judge(stage, &log, config, &progress);
    progress.finish();
    Ok(row::row(&log, &truth, config))
}
