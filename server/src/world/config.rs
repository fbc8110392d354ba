//! Settings of a world, and what can be wrong with one.

use std::time::Duration;

use eyeline_protocol::{CLASSES_MAX, NAME_BYTES_MAX, OutOfRange, PlanSwitch};
use glam::DVec3;

use super::Limits;
use crate::path::PathError;

/// Settings of a [`super::World`].
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct WorldConfig {
    /// World time between commits; default 50 ms. Shorter costs CPU and messages in proportion.
    pub tick: Duration,
    /// When requests are answered; default on arrival.
    pub answers: Answers,
    /// Least radius within which a hidden object's place is kept uncertain, in metres; default 1. Greater hides more
    /// and costs messages near walls.
    pub blur: f64,
    /// Offset of the grid that hides places; secret in production, fixed under test.
    pub grid_seed: u64,
    /// For how long a bound holds at most; default 1 h. The client decides how much of it to use; each expiry costs it a
    /// question.
    pub validity_max: Duration,
    /// How late or early a pose may be; default 60 ms. Each bound of an avatar is larger by what it can walk in it.
    pub jitter: Duration,
    /// Whether what follows a preset path is bounded by the volume that the path sweeps, and what nobody moves by where it
    /// stands, instead of by its class's speed; default true (Sudarsky & Gotsman 1999, §3.2 and Fig. 4).
    pub swept: bool,
    /// What is asked of the plan (DESIGN.md §8); default as counted. `states` can't be left out, since somebody would
    /// miss them.
    pub plan: PlanSwitch,
    /// A client that has not been heard of for so long gets no more updates until it is; default 3 s.
    pub lease: Duration,
    /// Greatest eye region of an audit, metres; default 2: what an avatar of 2 m/s reaches within a round trip of 0.4 s. A
    /// greater one serves clients of longer round trips without delay, and tells a modified client more, which can
    /// pretend to any round trip.
    pub audit_radius_max: f64,
    /// Tell a state only when what a client draws from the states that it may hold would be wrong by more than so many of
    /// its pixels; default `None`: at each change. More saves messages and shows things where they are not.
    pub dead_reckoning_px: Option<f64>,
    /// Most bytes a second to one client in datagrams, QUIC and UDP apart; default `None`. Where it binds, the states that
    /// are largest × oldest go first; violations, bounds and withdrawals are never held back.
    pub bytes_per_second: Option<u32>,
    /// How much one client may ask for; the default is what no honest client meets.
    pub limits: Limits,
    /// For how long the avatars of a lost connection wait for their client to come back; default 30 s. More keeps who has
    /// gone standing about.
    pub resume_grace: Duration,
    /// Most avatars; default 4096.
    pub avatars_max: usize,
    /// Where avatars start if the world names no place, relative to the anchor.
    pub default_spawn: DVec3,
}

/// When requests are answered. A datagram costs both ends about as much as all that it carries, so that what is due together
/// had better go together; DESIGN §3.3 counts what waits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Answers {
    /// On arrival, each client's by a datagram beside the tick's: nothing waits.
    #[default]
    Arrival,
    /// With the tick, in the datagram that tells what has changed: one to each client and tick. An answer waits for up to a
    /// tick, which welcome says, and which clients' leads and patience then have room for.
    Tick,
}

impl Answers {
    /// Both.
    pub const ALL: [Answers; 2] = [Answers::Arrival, Answers::Tick];

    /// Its name in settings.
    pub fn name(self) -> &'static str {
        match self {
            Answers::Arrival => "arrival",
            Answers::Tick => "tick",
        }
    }
}

impl std::str::FromStr for Answers {
    type Err = String;

    fn from_str(text: &str) -> Result<Answers, String> {
        let known = Answers::ALL.into_iter().find(|answers| answers.name() == text);
        known.ok_or_else(|| format!("'{text}' is not arrival or tick"))
    }
}

impl std::fmt::Display for Answers {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.pad(self.name())
    }
}

impl Default for WorldConfig {
    fn default() -> WorldConfig {
        WorldConfig {
            tick: Duration::from_millis(50),
            answers: Answers::default(),
            blur: 1.0,
            grid_seed: 0,
            validity_max: Duration::from_secs(3600),
            jitter: Duration::from_millis(60),
            swept: true,
            plan: PlanSwitch::AUTO,
            lease: Duration::from_secs(3),
            audit_radius_max: 2.0,
            dead_reckoning_px: None,
            bytes_per_second: None,
            limits: Limits::default(),
            resume_grace: Duration::from_secs(30),
            avatars_max: 4096,
            default_spawn: DVec3::ZERO,
        }
    }
}

impl WorldConfig {
    /// Sets the tick.
    pub fn with_tick(self, tick: Duration) -> WorldConfig {
        WorldConfig { tick, ..self }
    }

    /// Sets when requests are answered.
    pub fn with_answers(self, answers: Answers) -> WorldConfig {
        WorldConfig { answers, ..self }
    }

    /// How long an answer waits at most.
    pub(super) fn answer_wait(&self) -> Duration {
        if self.answers == Answers::Tick { self.tick } else { Duration::ZERO }
    }

    /// Sets the blur, metres.
    pub fn with_blur(self, blur: f64) -> WorldConfig {
        WorldConfig { blur, ..self }
    }

    /// Sets the secret of the grid that hides places.
    pub fn with_grid_seed(self, grid_seed: u64) -> WorldConfig {
        WorldConfig { grid_seed, ..self }
    }

    /// Sets where avatars start if the world names no place.
    pub fn with_default_spawn(self, default_spawn: DVec3) -> WorldConfig {
        WorldConfig { default_spawn, ..self }
    }

    /// Sets whether preset paths and rest make bounds.
    pub fn with_swept(self, swept: bool) -> WorldConfig {
        WorldConfig { swept, ..self }
    }

    /// Sets what is asked of the plan.
    pub fn with_plan(self, plan: PlanSwitch) -> WorldConfig {
        WorldConfig { plan, ..self }
    }

    /// Sets the greatest eye region of an audit, metres.
    pub fn with_audit_radius_max(self, audit_radius_max: f64) -> WorldConfig {
        WorldConfig { audit_radius_max, ..self }
    }

    /// Sets by how many pixels what is drawn may be wrong before a state is told.
    pub fn with_dead_reckoning_px(self, dead_reckoning_px: Option<f64>) -> WorldConfig {
        WorldConfig { dead_reckoning_px, ..self }
    }

    /// Sets the most bytes a second to one client.
    pub fn with_bytes_per_second(self, bytes_per_second: Option<u32>) -> WorldConfig {
        WorldConfig { bytes_per_second, ..self }
    }

    /// Sets how much one client may ask for.
    pub fn with_limits(self, limits: Limits) -> WorldConfig {
        WorldConfig { limits, ..self }
    }

    /// Sets for how long the avatars of a lost connection wait.
    pub fn with_resume_grace(self, resume_grace: Duration) -> WorldConfig {
        WorldConfig { resume_grace, ..self }
    }

    /// Sets the most avatars.
    pub fn with_avatars_max(self, avatars_max: usize) -> WorldConfig {
        WorldConfig { avatars_max, ..self }
    }

    pub(super) fn check(&self) -> Result<(), WorldError> {
        if !(Duration::from_millis(1)..=Duration::from_secs(10)).contains(&self.tick) {
            return Err(WorldError::Tick { tick: self.tick });
        }
        if !(0.0..=1000.0).contains(&self.blur) {
            return Err(WorldError::Blur { blur: self.blur });
        }
        if !(0.0..=1000.0).contains(&self.audit_radius_max) {
            return Err(WorldError::AuditRadius { radius: self.audit_radius_max });
        }
        if let Some(pixels) = self.dead_reckoning_px.filter(|pixels| !(0.0..=1000.0).contains(pixels)) {
            return Err(WorldError::DeadReckoning { pixels });
        }
        Ok(())
    }
}

/// Why there can be no such world.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum WorldError {
    /// The tick is out of range.
    #[error("tick of {tick:?} is not between 1 ms and 10 s; 50 ms is usual")]
    Tick {
        /// What was given.
        tick: Duration,
    },
    /// The blur is out of range.
    #[error("blur of {blur} m is not between 0 and 1000 m; 1 m is usual")]
    Blur {
        /// What was given.
        blur: f64,
    },
    /// The greatest eye region of an audit is out of range.
    #[error("eye region of {radius} m is not between 0 and 1000 m; 2 m is usual")]
    AuditRadius {
        /// What was given.
        radius: f64,
    },
    /// The error that dead reckoning allows is out of range.
    #[error("dead reckoning by {pixels} px is not between 0 and 1000 px; 1 px is usual")]
    DeadReckoning {
        /// What was given.
        pixels: f64,
    },
    /// An object of a class that is not there.
    #[error(
        "object '{object}' is of class '{class}', which the world file does not define; add a [[class]] of that name"
    )]
    UnknownClass {
        /// The object.
        object: String,
        /// Its class.
        class: String,
    },
    /// Two classes of one name.
    #[error("class '{class}' is defined twice ('avatar' is built in); rename one")]
    DuplicateClass {
        /// The name.
        class: String,
    },
    /// A class with an impossible value.
    #[error("class '{class}' has {what} = {value}, which is not a size or speed (0 to 1e6, top above bottom)")]
    ClassValue {
        /// The class.
        class: String,
        /// The key.
        what: &'static str,
        /// Its value.
        value: f64,
    },
    /// A name that is longer than the wire carries.
    #[error("the name '{name}' is of {} bytes, more than {NAME_BYTES_MAX}; shorten it", name.len())]
    Name {
        /// The name of a class, an object, its node or the world.
        name: String,
    },
    /// More classes than a welcome can name.
    #[error("{classes} classes are more than {CLASSES_MAX}")]
    TooManyClasses {
        /// How many.
        classes: usize,
    },
    /// More objects than the wire can name.
    #[error("{objects} objects are more than 16777215")]
    TooManyObjects {
        /// How many.
        objects: usize,
    },
    /// An object that is too far away.
    #[error("object '{object}': {error}")]
    Position {
        /// The object.
        object: String,
        /// What is wrong.
        error: OutOfRange,
    },
    /// A spawn point that is no place.
    #[error("spawn {index} at {position:?} is not a place within 2,000 km")]
    Spawn {
        /// Which, from 0.
        index: usize,
        /// Where.
        position: [f64; 3],
    },
    /// A path that is none, or breaks its class's bound.
    #[error(transparent)]
    Path(#[from] PathError),
}
