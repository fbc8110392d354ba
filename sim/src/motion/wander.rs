//! Avatars for worlds that we have no plan of: each stands at a place where one may stand, and looks around.
//!
//! Walking there would need to know the floor; standing is always right. The head turns to a random direction at a random
//! rate, rests, and turns on, so that a frustum sees everything in the course of time.

use std::f64::consts::PI;

use eyeline_server::spec::AvatarSpec;
use glam::DVec3;
use rand::RngExt;

use super::{WalkerPose, step_s, turn_toward};
use crate::chance;

/// Least and greatest rate of a turn, in radians a second.
const TURN_RATES: (f64, f64) = (0.5, 2.0);
/// Least and greatest rest between two turns, in seconds.
const RESTS_S: (f64, f64) = (0.2, 1.5);

/// An avatar that stands and looks around.
#[derive(Clone, Debug)]
pub struct Wanderer {
    feet: DVec3,
    eye_height: f64,
    /// No faster than an avatar may, radians a second.
    turn_max: f64,
    chance: rand_pcg::Pcg64,
    yaw: f64,
    wanted: f64,
    /// Radians a second of the turn under way.
    rate: f64,
    rest_s: f64,
}

impl Wanderer {
    /// The `number`th wanderer, at that one of the `places` (feet; from the first again when they run out); `None` if
    /// there is no place.
    pub fn new(places: &[DVec3], avatar: AvatarSpec, seed: u64, number: usize) -> Option<Wanderer> {
        let feet = *places.get(number.checked_rem(places.len())?)?;
        let mut chance = chance(seed, 6 + number as u64);
        let yaw = chance.random_range(-PI..PI);
        let rest_s = chance.random_range(0.0..RESTS_S.1);
        let turn_max = avatar.turn_max;
        Some(Wanderer { feet, eye_height: avatar.eye_height, turn_max, chance, yaw, wanted: yaw, rate: 0.0, rest_s })
    }

    /// Looks around for `dt_s` seconds. Not a positive number: nothing happens; more than 10 counts as 10.
    pub fn step(&mut self, dt_s: f64) -> WalkerPose {
        let dt_s = step_s(dt_s);
        if self.yaw != self.wanted {
            self.yaw = turn_toward(self.yaw, self.wanted, self.rate * dt_s);
        } else if self.rest_s > 0.0 {
            self.rest_s -= dt_s;
        } else if dt_s > 0.0 {
            self.wanted = self.chance.random_range(-PI..PI);
            self.rate = self.chance.random_range(TURN_RATES.0..TURN_RATES.1).min(self.turn_max);
            self.rest_s = self.chance.random_range(RESTS_S.0..RESTS_S.1);
        }
        self.pose()
    }

    /// Where it is and looks now.
    pub fn pose(&self) -> WalkerPose {
        WalkerPose { feet: self.feet, yaw: self.yaw, eye: self.feet + DVec3::Y * self.eye_height }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stands_and_sees_every_direction_in_the_course_of_time() {
        let places = [DVec3::new(1.0, 2.0, 3.0), DVec3::ZERO];
        let mut wanderer = Wanderer::new(&places, AvatarSpec::default(), 7, 2).unwrap();
        let mut again = wanderer.clone();
        let (mut seen, mut before) = ([false; 8], wanderer.pose().yaw);
        for _ in 0..6_000 {
            let pose = wanderer.step(0.05);
            assert_eq!(pose, again.step(0.05));
            assert_eq!((pose.feet, pose.eye), (places[0], DVec3::new(1.0, 3.6, 3.0)));
            assert!((-PI..=PI).contains(&pose.yaw));
            let turn = (pose.yaw - before + PI).rem_euclid(2.0 * PI) - PI;
            assert!(turn.abs() <= TURN_RATES.1 * 0.05 + 1e-9);
            seen[((pose.yaw + PI) / PI * 4.0).min(7.0) as usize] = true;
            before = pose.yaw;
        }
        assert_eq!(seen, [true; 8]);
    }

    #[test]
    fn without_a_place_there_is_none() {
        assert!(Wanderer::new(&[], AvatarSpec::default(), 7, 0).is_none());
    }
}
