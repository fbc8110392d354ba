//! What a scene tracker is told, whom it asks, and what it counts.

use eyeline_protocol::WorldTime;
use eyeline_visibility::{Bound, Occlusion};
use glam::DVec3;

use super::TemporalBound;

/// How T is kept up to date.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Variant {
    /// TBVe: visible objects are moved in T in every frame (§3.3). Exact.
    Explicit,
    /// TBVi: visible objects stay in T where they came into view (§3.6). One that comes into sight past the place where T has
    /// it may be absent for one frame, and never for two running.
    Implicit,
    /// Every object is moved in T in every frame, hidden or not: the paper's HZB.
    EveryObject,
    /// Every object is shown in every frame, without T: the paper's ZB.
    NoHierarchy,
}

impl Variant {
    /// All variants.
    pub const ALL: [Variant; 4] = [Variant::Explicit, Variant::Implicit, Variant::EveryObject, Variant::NoHierarchy];

    /// The name in reports and on command lines.
    pub const fn name(self) -> &'static str {
        match self {
            Variant::Explicit => "tbv-e",
            Variant::Implicit => "tbv-i",
            Variant::EveryObject => "every-object",
            Variant::NoHierarchy => "no-hierarchy",
        }
    }

    /// Whether hidden objects are left alone.
    pub const fn uses_bounds(self) -> bool {
        matches!(self, Variant::Explicit | Variant::Implicit)
    }
}

impl std::str::FromStr for Variant {
    type Err = String;

    fn from_str(text: &str) -> Result<Variant, String> {
        Variant::ALL
            .into_iter()
            .find(|variant| variant.name() == text)
            .ok_or_else(|| format!("'{text}' is not {}", Variant::ALL.map(Variant::name).join(", ")))
    }
}

/// Whoever moves the objects: what would be asked over a network. Each call is a message.
pub trait Agents {
    /// A volume that contains the object as it is now, as tight as its culling should be (`upd_vis`, step 1).
    fn configuration(&mut self, object: u32) -> Bound;
    /// A TBV from now until `expires` (step 4 c).
    fn temporal_bound(&mut self, object: u32, expires: WorldTime) -> TemporalBound;
}

/// The image of the frame, with the static scene in it.
pub trait Image {
    /// What is hidden by all that was drawn so far.
    fn occlusion(&self) -> &dyn Occlusion;
    /// Displays an object in its present configuration. Returns whether it hides what is behind it from now on.
    fn draw(&mut self, object: u32) -> bool;
}

/// What a frame is about.
#[derive(Clone, Copy, Debug)]
pub struct FrameInput {
    /// Its time.
    pub now: WorldTime,
    /// From where it is seen: nearer objects are drawn first.
    pub eye: DVec3,
    /// Whether the viewpoint moves, which halves validity periods (§3.4).
    pub eye_moves: bool,
}

/// What a frame took.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FrameStats {
    /// Nodes of T visited, walking and updating, and bounds tested.
    pub work: u64,
    /// Configurations obtained: messages.
    pub updates: u64,
    /// TBVs obtained: messages.
    pub bounds: u64,
    /// Of both, those that were about objects that this frame does not show.
    pub hidden_caused: u64,
    /// TBVs that became visible.
    pub exposed: u64,
    /// TBVs whose time was up.
    pub expired: u64,
    /// TBVs that their objects had broken.
    pub violated: u64,
    /// Objects displayed.
    pub shown: u64,
}

impl FrameStats {
    /// Adds what another frame took.
    pub fn add(&mut self, other: &FrameStats) {
        self.work += other.work;
        self.updates += other.updates;
        self.bounds += other.bounds;
        self.hidden_caused += other.hidden_caused;
        self.exposed += other.exposed;
        self.expired += other.expired;
        self.violated += other.violated;
        self.shown += other.shown;
    }
}
