//! What is known of an object's motion in advance, and of its size.

use serde::{Deserialize, Serialize};

/// A limit that an object keeps: between any two world times t₀ ≤ t₁ its committed reference point moves at most
/// `speed_max · (t₁ − t₀) + slack` metres. The server enforces it (a token bucket); a break is a violation.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct MotionBound {
    /// Metres a second, finite and at least 0.
    pub speed_max: f64,
    /// Metres: jitter of pose messages, quantisation.
    pub slack: f64,
}

impl MotionBound {
    /// Greatest distance moved in `seconds`, rounded up. A negative or unknown time counts as none.
    pub fn reach(&self, seconds: f64) -> f64 {
        // One part in 10¹² covers the rounding of the two operations many times over.
        (self.slack + self.speed_max * seconds.max(0.0)) * (1.0 + 1e-12)
    }
}

/// How far an object's surface reaches from its reference point, at any turn about the vertical axis: an upright
/// cylinder. Metres.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Extent {
    /// Radius around the vertical axis through the reference point.
    pub radius: f64,
    /// Lowest point relative to the reference point.
    pub bottom: f64,
    /// Highest point relative to the reference point.
    pub top: f64,
}
