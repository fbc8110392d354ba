//! Temporal bounding volumes that grow.
//!
//! At a world time t from `issued` until `expires` the object's reference point lies in the ball of
//! `radius + speed·(t − issued)` around `centre` (Sudarsky & Gotsman 1999, §3.2, a sphere from a speed bound). Holding
//! the growing form lets the *client* choose a validity period without a message.

use std::time::Duration;

use glam::DVec3;

use crate::{Issue, Position, WorldTime};

/// A volume that contains an object's reference point from `issued` until `expires`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tbv {
    /// Middle of the ball.
    pub centre: Position,
    /// Radius at `issued`, metres, finite and at least 0.
    pub radius: f64,
    /// Growth, metres a second, finite and at least 0.
    pub speed: f64,
    /// From when on it holds.
    pub issued: WorldTime,
    /// Until when it holds, inclusive.
    pub expires: WorldTime,
    /// The object's issue number when the bound was made; void once a later violation is known.
    pub issue: Issue,
}

impl Tbv {
    /// Validity period: expires − issued.
    pub fn validity(&self) -> Duration {
        self.expires.since(self.issued)
    }

    /// Radius of the ball at `time`, rounded up; before `issued` it is that of `issued`.
    ///
    /// The sum is rounded outward by a part in 10¹²: the f64 operations err by less than 4·2⁻⁵³.
    pub fn radius_at(&self, time: WorldTime) -> f64 {
        (self.radius + self.speed * time.seconds_since(self.issued).max(0.0)) * (1.0 + 1e-12)
    }

    /// Whether `point` (metres, relative to the anchor) is where the object may be at `time`. Boundary included.
    pub fn contains(&self, point: DVec3, time: WorldTime) -> bool {
        self.centre.metres().distance(point) <= self.radius_at(time)
    }

    /// Whether the bound says anything at `time`.
    pub fn holds_at(&self, time: WorldTime) -> bool {
        self.issued <= time && time <= self.expires
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        /// S&G's requirement: a TBV contains its object until it expires, rounding at its worst.
        #[test]
        fn an_object_within_its_speed_stays_inside(
            start in prop::array::uniform3(-2_000_000_000i32..2_000_000_000),
            radius in 0.0..10.0f64,
            speed in 0.0..1e6f64,
            heading in prop::array::uniform3(-1.0..1.0f64),
            micros in 0i64..86_400_000_000,
        ) {
            let centre = Position { x: start[0], y: start[1], z: start[2] };
            let issued = WorldTime::from_micros(1_000_000);
            let tbv = Tbv { centre, radius, speed, issued, expires: WorldTime::MAX, issue: Issue(0) };
            let heading = DVec3::from_array(heading);
            prop_assume!(heading.length() > 1e-3);
            let time = issued.offset_micros(micros);
            let travelled = radius + speed * (micros as f64 * 1e-6);
            let point = centre.metres() + heading.normalize() * travelled;
            // What f64 itself loses at this distance from the anchor is not the bound's to give.
            let ulp = 4.0 * f64::EPSILON * point.length();
            let slack = Tbv { radius: radius + ulp, ..tbv };
            prop_assert!(slack.contains(point, time));
        }
    }
}
