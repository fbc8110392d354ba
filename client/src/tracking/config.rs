//! Settings of a tracker.

use std::time::Duration;

use super::Lead;

/// Who chooses validity periods.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Growth {
    /// The client, without messages: bounds are held grown to the end of a stage, and grown further while hidden.
    AtClient,
    /// The paper's way: a fixed validity period, and a request each time that one ends.
    FixedPeriod(Duration),
}

/// Ways to break a tracker on purpose, to see that a measurement notices.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sabotage {
    /// Exposed bounds are ignored.
    DropExposures,
    /// What is asked leaves one frame late.
    LateOneTick,
    /// The clock that bounds grow by stands still.
    FreezeClock,
    /// Bounds are grown for the lead, but looked at from the eye's own point.
    PointLead,
    /// Bounds are grown for the lead, and looked at from nine points of the region instead of the whole: a heuristic.
    SampledLead,
    /// A question is asked once, heard or not.
    NeverRepeat,
    /// A bound from before a violation is believed.
    AcceptStaleIssue,
    /// Bounds are held beyond their expiry.
    IgnoreExpiry,
}

impl std::str::FromStr for Sabotage {
    type Err = String;

    fn from_str(text: &str) -> Result<Sabotage, String> {
        match text {
            "drop-exposures" => Ok(Sabotage::DropExposures),
            "late-one-tick" => Ok(Sabotage::LateOneTick),
            "freeze-clock" => Ok(Sabotage::FreezeClock),
            "point-lead" => Ok(Sabotage::PointLead),
            "sampled-lead" => Ok(Sabotage::SampledLead),
            "never-repeat" => Ok(Sabotage::NeverRepeat),
            "accept-stale-issue" => Ok(Sabotage::AcceptStaleIssue),
            "ignore-expiry" => Ok(Sabotage::IgnoreExpiry),
            other => Err(format!(
                "'{other}' is not drop-exposures, late-one-tick, freeze-clock, point-lead, sampled-lead, never-repeat, \
                 accept-stale-issue or ignore-expiry"
            )),
        }
    }
}

/// Settings of a [`super::Tracker`].
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct TrackerConfig {
    /// Time between frames; default 50 ms. The shortest stage.
    pub frame: Duration,
    /// Who chooses validity periods; default the client.
    pub growth: Growth,
    /// Longest stage in frames; default 128. Longer ones make bounds that are exposed sooner, and fewer tests.
    pub stage_frames_max: u32,
    /// For how many frames an object must be hidden before updates are declined; default 2. More costs pushes, fewer
    /// costs requests where something flickers behind a door frame.
    pub linger_frames: u32,
    /// Whether an exposed bound is first made fresh before a state is asked for, when both round trips fit in one
    /// frame; default true. It costs a round trip and tells less about what is hidden.
    pub staged: bool,
    /// How far ahead visibility is asked about; default not at all. Longer costs culling and messages.
    pub lead: Lead,
    /// Whether an eye that stands still finds the exact moment until which a bound is hidden, by doubling and bisection
    /// (§3.4), instead of looking again at the end of each stage; default true. Says nothing else and nothing earlier.
    pub exact: bool,
    /// Whether a bound that does not grow, and that walls seal off from wherever the eye can go, is in neither T nor
    /// any stage until the eye leaves its part of the scene; default true. Where the occlusion knows of no parts it
    /// makes no difference.
    pub sealed: bool,
    /// Deliberate damage; default none.
    pub sabotage: Option<Sabotage>,
}

impl Default for TrackerConfig {
    fn default() -> TrackerConfig {
        TrackerConfig {
            frame: Duration::from_millis(50),
            growth: Growth::AtClient,
            stage_frames_max: 128,
            linger_frames: 2,
            staged: true,
            lead: Lead::None,
            exact: true,
            sealed: true,
            sabotage: None,
        }
    }
}

impl TrackerConfig {
    /// Sets the time between frames.
    pub fn with_frame(self, frame: Duration) -> TrackerConfig {
        TrackerConfig { frame, ..self }
    }

    /// Sets who chooses validity periods.
    pub fn with_growth(self, growth: Growth) -> TrackerConfig {
        TrackerConfig { growth, ..self }
    }

    /// Sets how long an object must be hidden before updates are declined, in frames.
    pub fn with_linger_frames(self, linger_frames: u32) -> TrackerConfig {
        TrackerConfig { linger_frames, ..self }
    }

    /// Sets whether exposed bounds are first made fresh.
    pub fn with_staged(self, staged: bool) -> TrackerConfig {
        TrackerConfig { staged, ..self }
    }

    /// Sets how far ahead visibility is asked about.
    pub fn with_lead(self, lead: Lead) -> TrackerConfig {
        TrackerConfig { lead, ..self }
    }

    /// Sets whether a still eye finds exact moments.
    pub fn with_exact(self, exact: bool) -> TrackerConfig {
        TrackerConfig { exact, ..self }
    }

    /// Sets whether what is sealed off is left alone.
    pub fn with_sealed(self, sealed: bool) -> TrackerConfig {
        TrackerConfig { sealed, ..self }
    }

    /// Damages the tracker.
    pub fn with_sabotage(self, sabotage: Option<Sabotage>) -> TrackerConfig {
        TrackerConfig { sabotage, ..self }
    }
}
