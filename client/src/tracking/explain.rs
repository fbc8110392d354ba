//! Why does a client show an object, or not? What its tracker decided last about it, and what happens next.

use eyeline_protocol::{Reason, Tbv, Want, WorldTime};
use eyeline_visibility::Bound;

/// What a tracker decided about an object.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Decision {
    /// The roster, or a message that overtook it, named it.
    Named,
    /// Its bound is hidden to the end of a stage of so many frames.
    Hidden {
        /// Length of the stage.
        frames: u32,
    },
    /// Walls seal its bound off from wherever the eye can go without leaving its part of the scene.
    SealedOff,
    /// Its bound is hidden now, but may not be in the next frame.
    HiddenForNow,
    /// It was asked about.
    Asked {
        /// For what.
        want: Want,
        /// Why.
        reason: Reason,
    },
    /// It came into V: its state is known and shown.
    Revealed,
    /// It was hidden for long enough: updates were declined.
    Released,
    /// It broke its bounds and left the world.
    Left,
}

impl std::fmt::Display for Decision {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Decision::Named => f.write_str("named by the roster"),
            Decision::Hidden { frames } => write!(f, "its bound is hidden to the end of a stage of {frames} frames"),
            Decision::SealedOff => f.write_str("walls seal its bound off from wherever the eye can go"),
            Decision::HiddenForNow => f.write_str("its bound is hidden now, but may not be in the next frame"),
            Decision::Asked { want, reason } => {
                let want = match want {
                    Want::Bound => "a fresh bound",
                    Want::State => "its state, and updates",
                    Want::Place => "its place, once",
                };
                let reason = match reason {
                    Reason::Unknown => "nothing is known of where it is",
                    Reason::Exposed => "its bound can be seen",
                    Reason::Expired => "its bound's time is up",
                    Reason::Violated => "it broke its bound",
                };
                write!(f, "asked for {want}, since {reason}")
            }
            Decision::Revealed => f.write_str("revealed: it is shown, and the server tells of it"),
            Decision::Released => f.write_str("released: it has been out of sight, and updates were declined"),
            Decision::Left => f.write_str("it left the world"),
        }
    }
}

/// What a client believes of an object.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BeliefKind {
    /// It may be everywhere.
    Unknown,
    /// It is in a bound that was hidden.
    Hidden,
    /// It is in V.
    Visible,
    /// It is not in the world.
    Absent,
}

/// Everything that a tracker can say about an object.
#[derive(Clone, Copy, Debug)]
pub struct Explanation {
    /// What is believed.
    pub belief: BeliefKind,
    /// The bound that stands for it, if it is held hidden.
    pub tbv: Option<Tbv>,
    /// What of it is tested: the volume as large as it will be when its stage ends, or at the newest frame's horizon.
    pub tested: Option<Bound>,
    /// The last decision, and the latest possible server time of the frame in which it fell.
    pub decision: (Decision, WorldTime),
    /// The question that awaits an answer, and whether the server is known to have heard it.
    pub asked: Option<(Want, Reason, bool)>,
    /// When Q looks at it again.
    pub due: Option<WorldTime>,
    /// World time of its last known state.
    pub state_of: Option<WorldTime>,
    /// For how many frames in a row it has been in V and out of sight.
    pub hidden_frames: u32,
}
