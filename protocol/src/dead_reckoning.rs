//! Where does a client draw what it has not just been told of? Where the last state has it go on.
//!
//! Both ends compute the same prediction from the same state, so the server knows what a client shows, and tells it
//! something new only where that would be wrong by more than a stated number of pixels: far things may be wrong by more
//! metres than near ones, so dead reckoning and level of detail are one rule (DESIGN §6).

use std::time::Duration;

use glam::DVec3;
use serde::{Deserialize, Serialize};

use crate::position::nearest;
use crate::{Orientation, Position, WorldTime};

/// One step of a velocity on the wire, metres a second: 2⁻⁸. In a second of prediction that is 4 mm.
pub const VELOCITY_QUANTUM: f64 = 1.0 / 256.0;

/// A velocity in steps of [`VELOCITY_QUANTUM`]; faster than ±128 m/s along an axis is cut off, which the server knows. One
/// byte an axis below half a metre a second, else three.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Velocity {
    /// East, in steps.
    pub x: i16,
    /// Up, in steps.
    pub y: i16,
    /// South, in steps.
    pub z: i16,
}

impl Velocity {
    /// At rest.
    pub const ZERO: Velocity = Velocity { x: 0, y: 0, z: 0 };

    /// The nearest velocity, for metres a second; what is no number counts as none.
    pub fn from_metres(velocity: DVec3) -> Velocity {
        // A cast saturates, and makes NaN zero.
        let steps = (velocity / VELOCITY_QUANTUM).map(nearest);
        Velocity { x: steps.x as i16, y: steps.y as i16, z: steps.z as i16 }
    }

    /// Metres a second. Exact.
    pub fn metres(self) -> DVec3 {
        DVec3::new(f64::from(self.x), f64::from(self.y), f64::from(self.z)) * VELOCITY_QUANTUM
    }
}

/// What a state says of the time after it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Prediction {
    /// Where it was at `tick`.
    pub position: Position,
    /// How it moved on.
    pub velocity: Velocity,
    /// How it was turned, and stays.
    pub orientation: Orientation,
    /// World time of all this.
    pub tick: WorldTime,
}

/// For so long a state is thought to go on; then it stands, lest it run through walls and out of the world while nothing is
/// heard.
pub const PREDICTED_MAX: Duration = Duration::from_secs(2);

/// However far away it is, nothing is drawn wrong by more, metres. So a client that knows the rule, but not what the server
/// thought of its eye, knows how far what it draws may be from the truth.
pub const ERROR_METRES_MAX: f64 = 0.25;

/// Nothing is taken to be nearer than this to an eye, metres: pixels have an end.
const DISTANCE_MIN: f64 = 0.1;

impl Prediction {
    /// Where it is at `time`, metres relative to the anchor; before `tick` where it was then.
    pub fn place_at(&self, time: WorldTime) -> DVec3 {
        let ahead = time.since(self.tick).min(PREDICTED_MAX).as_secs_f64();
        self.position.metres() + self.velocity.metres() * ahead
    }

    /// By how many pixels this is wrong at `time`, as seen from `eye`, if in truth the object is at `position`, turned as
    /// `orientation` says. `radius` is how far its surface reaches from its axis; `focal` is in pixels a unit of tangent.
    ///
    /// An upper bound in the middle of a view; at 45° from it a pixel's angle is half as large. What is wrong by more than
    /// [`ERROR_METRES_MAX`] is infinitely wrong.
    pub fn error_px(
        &self,
        time: WorldTime,
        position: Position,
        orientation: Orientation,
        radius: f64,
        eye: DVec3,
        focal: f64,
    ) -> f64 {
        let place = position.metres();
        let moved = self.place_at(time).distance(place);
        let turned = if orientation == self.orientation {
            0.0
        } else {
            let turn = (orientation.yaw() - self.orientation.yaw()).rem_euclid(std::f64::consts::TAU);
            turn.min(std::f64::consts::TAU - turn)
        };
        let error = moved + radius * turned;
        if moved > ERROR_METRES_MAX {
            return f64::INFINITY;
        }
        pixels(error, place.distance(eye) - radius, focal)
    }
}

/// How many pixels `metres` across look like at a distance, for `focal` pixels a unit of tangent.
pub fn pixels(metres: f64, distance: f64, focal: f64) -> f64 {
    metres * focal / distance.max(DISTANCE_MIN)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn walking() -> Prediction {
        Prediction {
            position: Position::from_metres(DVec3::new(1.0, 0.0, -2.0)).unwrap(),
            velocity: Velocity::from_metres(DVec3::new(1.5, 0.0, -0.5)),
            orientation: Orientation::from_yaw(0.0),
            tick: WorldTime::from_micros(1_000_000),
        }
    }

    #[test]
    fn goes_on_straight_for_a_while_and_then_stands() {
        let prediction = walking();
        let at = |millis: i64| prediction.place_at(WorldTime::from_micros(1_000_000 + millis * 1000));
        assert_eq!(at(-500), DVec3::new(1.0, 0.0, -2.0));
        assert_eq!(at(1000), DVec3::new(2.5, 0.0, -2.5));
        assert_eq!(at(2000), at(3_600_000));
        assert_eq!(prediction.place_at(WorldTime::MAX), at(2000));
    }

    #[test]
    fn an_error_is_smaller_from_afar_until_it_is_too_large_for_any_distance() {
        let prediction = walking();
        let error = |off: f64, yaw: f64, distance: f64| {
            let truth = Position::from_metres(prediction.position.metres() + DVec3::X * off).unwrap();
            let eye = truth.metres() + DVec3::Z * distance;
            prediction.error_px(prediction.tick, truth, Orientation::from_yaw(yaw), 0.5, eye, 160.0)
        };
        assert_eq!(error(0.0, 0.0, 4.5), 0.0);
        assert!((error(0.1, 0.0, 4.5) - 4.0).abs() < 0.05, "0.1 m at 4 m");
        assert!((error(0.0, 0.2, 4.5) - 4.0).abs() < 0.2, "a turn of 0.2 rad moves the rim by 0.1 m");
        assert!((error(0.0, 0.1 - std::f64::consts::TAU, 4.5) - 2.0).abs() < 0.2);
        assert!(error(0.2, 0.0, 1e5) < 0.001);
        assert_eq!(error(0.3, 0.0, 1e5), f64::INFINITY);
        assert!(error(0.1, 0.0, 0.0).is_finite(), "an eye inside it");
    }

    proptest! {
        #[test]
        fn a_velocity_is_off_by_at_most_half_a_step(x in -127.0..127.0f64, y in -127.0..127.0f64, z in -127.0..127.0f64) {
            let velocity = DVec3::new(x, y, z);
            let back = Velocity::from_metres(velocity).metres();
            prop_assert!((back - velocity).abs().max_element() <= VELOCITY_QUANTUM / 2.0);
        }

        /// Hostile states draw something somewhere finite.
        #[test]
        fn any_prediction_is_a_place(x: i32, y: i16, tick: i64, time: i64) {
            let prediction = Prediction {
                position: Position { x, y: x, z: x },
                velocity: Velocity { x: y, y, z: i16::MIN },
                orientation: Orientation::default(),
                tick: WorldTime::from_micros(tick),
            };
            prop_assert!(prediction.place_at(WorldTime::from_micros(time)).is_finite());
        }
    }

    #[test]
    fn what_is_no_velocity_is_none_and_what_is_too_fast_is_cut_off() {
        let velocity = Velocity::from_metres(DVec3::new(f64::NAN, f64::INFINITY, -1e9));
        assert_eq!(velocity, Velocity { x: 0, y: i16::MAX, z: i16::MIN });
    }
}
