//! `measure`: server and clients, and the truth beside them.
//!
//! A run records every committed position and what every client believed in bursts of consecutive frames; afterwards
//! the truth is computed for those and compared. *Late* is judged by the promise (DESIGN §3.3): an object is drawn at most
//! one path round trip, one server turnaround and one frame after it first owned a pixel.

mod fit;
mod log;
mod quic;
pub mod report;
mod row;
mod sweep;
mod truth;
mod virtual_time;
mod why;

use std::sync::atomic::Ordering;
use std::time::Duration;

use eyeline_client::session::{Session, SessionConfig};
use eyeline_client::tracking::{Growth, Lead, Sabotage, TrackerConfig};
use eyeline_protocol::{Interest, WorldTime};
use eyeline_server::policy::PolicySettings;
use eyeline_server::world::{Answers, World, WorldConfig};
use eyeline_visibility::Resolution;

pub use fit::{Fit, fit};
pub use log::{Bursts, ClientLog, Commit, FrameLog, Known, ObjectInfo, RunLog};
pub use row::{MeasureRow, columns};
pub use sweep::{Sweep, SweepKey};
pub use truth::{Truth, judge};
pub use why::why;

use crate::people::{FrameHook, Person};
use crate::report::Progress;
use crate::stage::{Crowd, Stage};
use crate::virtual_net::LinkRules;

/// How the parts are connected.
#[derive(Clone, Debug)]
pub enum Net {
    /// Real QUIC over loopback, in real time.
    Quic,
    /// A simulated network in virtual time; both directions of each link alike.
    Sim(LinkRules),
    /// The same, with QUIC's state machines between cores and links.
    SimQuic(LinkRules),
    /// Real QUIC over loopback, through a relay that does this to its datagrams.
    QuicOver(LinkRules),
}

/// Settings of a measurement. Everything that a result depends on.
#[derive(Clone, Debug)]
pub struct MeasureConfig {
    /// Number of watching clients.
    pub clients: usize,
    /// Avatars besides, which walk inside the server and look at nothing.
    pub residents: usize,
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
    /// When the server answers requests.
    pub answers: Answers,
    /// Least radius within which a hidden object's place is uncertain, metres.
    pub blur: f64,
    /// Whether preset paths and rest make bounds at the server.
    pub swept: bool,
    /// Whether the server looks for itself before it tells a place.
    pub audit: bool,
    /// By how many pixels what is drawn may be wrong before a state is told; `None` for at each change.
    pub dead_reckoning_px: Option<f64>,
    /// Most bytes a second to one client.
    pub bytes_per_second: Option<u32>,
    /// Who chooses validity periods.
    pub growth: Growth,
    /// Frames that something must be hidden before updates are declined.
    pub linger_frames: u32,
    /// Whether exposed bounds are first made fresh.
    pub staged: bool,
    /// How far ahead the trackers ask about visibility.
    pub lead: Lead,
    /// Which directions clients hear of.
    pub interest: Interest,
    /// Deliberate damage to the trackers.
    pub sabotage: Option<Sabotage>,
    /// Settings of the policies that have some.
    pub policy: PolicySettings,
}

impl Default for MeasureConfig {
    fn default() -> MeasureConfig {
        MeasureConfig {
            clients: 32,
            residents: 0,
            seed: 7,
            warm_up: Duration::from_secs(2),
            window: Duration::from_secs(10),
            tick_hz: 20,
            resolution: Resolution::new(320, 240),
            side: 128,
            truth_share: 0.1,
            burst_frames: 20,
            answers: Answers::default(),
            blur: 1.0,
            swept: true,
            audit: false,
            dead_reckoning_px: None,
            bytes_per_second: None,
            growth: Growth::AtClient,
            linger_frames: 2,
            staged: true,
            lead: Lead::None,
            interest: Interest::Around,
            sabotage: None,
            policy: PolicySettings::default(),
        }
    }
}

impl MeasureConfig {
    /// Time between ticks, and between frames.
    pub fn frame(&self) -> Duration {
        Duration::from_micros(1_000_000 / u64::from(self.tick_hz.max(1)))
    }

    fn world(&self, stage: &Stage) -> WorldConfig {
        WorldConfig::default()
            .with_tick(self.frame())
            .with_answers(self.answers)
            .with_blur(self.blur)
            .with_swept(self.swept)
            .with_grid_seed(self.seed)
            .with_avatars_max(2 * (self.clients + self.residents).max(2048))
            .with_dead_reckoning_px(self.dead_reckoning_px)
            .with_bytes_per_second(self.bytes_per_second)
            .with_default_spawn(stage.model.scene.bounds().centre())
    }

    /// The world of a run.
    fn start(&self, stage: &Stage, policy: &str, now: WorldTime) -> anyhow::Result<World> {
        let mut world = stage.world(self.world(stage), policy, &self.policy, now)?;
        if self.audit {
            world.set_audit(stage.model.audit(world.classes()));
        }
        Ok(world)
    }

    fn tracker(&self) -> TrackerConfig {
        TrackerConfig::default()
            .with_frame(self.frame())
            .with_growth(self.growth)
            .with_linger_frames(self.linger_frames)
            .with_staged(self.staged)
            .with_lead(self.lead)
            .with_sabotage(self.sabotage)
    }

    /// The `number`th watching person.
    fn person(&self, stage: &Stage, number: usize, hook: Option<FrameHook>) -> Person {
        let person = Person::new(stage, self.seed, number, self.side, hook);
        if self.sabotage == Some(Sabotage::SampledLead) { person.with_sampled_lead(self.side) } else { person }
    }

    fn session(&self, number: usize) -> SessionConfig {
        let pixels = |side: u32| u16::try_from(side).unwrap_or(u16::MAX);
        SessionConfig::default()
            .with_resolution(pixels(self.resolution.width), pixels(self.resolution.height))
            .with_name(format!("client {number}"))
            .with_tracker(self.tracker())
            .with_interest(self.interest)
            .with_record_states()
    }
}

/// What a client knows, for the log.
fn known_of(session: &Session) -> Vec<Known> {
    let tracker = session.tracker().into_iter().flat_map(|tracker| tracker.known());
    tracker.map(|(drawn, is_drawn)| Known { object: drawn.object, position: drawn.position, is_drawn }).collect()
}

/// Runs one policy and judges it.
///
/// # Errors
/// If the world can't be served, or a client loses its connection.
pub fn measure(
    stage: &Stage,
    crowd: Option<&Crowd>,
    config: &MeasureConfig,
    net: &Net,
    policy: &str,
) -> anyhow::Result<MeasureRow> {
    if let Some(crowd) = crowd {
        crowd.slid.store(0, Ordering::Relaxed);
    }
    let log = match net {
        Net::Quic => quic::run(stage, crowd, config, None, policy)?,
        Net::QuicOver(link) => quic::run(stage, crowd, config, Some(link), policy)?,
        Net::Sim(link) => virtual_time::run(stage, crowd, config, link, false, policy)?,
        Net::SimQuic(link) => virtual_time::run(stage, crowd, config, link, true, policy)?,
    };
    let frames = log.clients.iter().flat_map(|client| &client.frames).filter(|frame| frame.known.is_some()).count();
    let progress = Progress::new(frames as u64, &format!("{policy}: computing the truth"));
    let truth = judge(stage, &log, config, &progress);
    progress.finish();
    let mut row = row::row(&log, &truth, config, net);
    row.slid_steps = crowd.map_or(0, |crowd| crowd.slid.load(Ordering::Relaxed));
    Ok(row)
}
