//! The person at the keyboard: where they are, where they look, and where the keys take them.

use std::f64::consts::{FRAC_PI_2, TAU};

use glam::{DQuat, DVec2, DVec3};

use super::walk::{Body, Ground, Walker};

/// Keys that are held down.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Held {
    /// Forward and back.
    pub along: [bool; 2],
    /// Right and left.
    pub across: [bool; 2],
    /// Up and down, in flight.
    pub upright: [bool; 2],
    /// Run.
    pub fast: bool,
}

fn axis([more, less]: [bool; 2]) -> f64 {
    f64::from(u8::from(more)) - f64::from(u8::from(less))
}

/// Somebody who walks or flies.
#[derive(Clone, Copy, Debug)]
pub struct Player {
    walker: Walker,
    /// 0 looks along −Z, positive turns left.
    pub yaw: f64,
    /// Positive looks up.
    pub pitch: f64,
    /// Whether walls and floors do not count.
    pub is_flying: bool,
    /// Metres a second at a walk, and at most.
    pub speeds: [f64; 2],
}

/// Nobody looks further up or down: there is no telling left from right at the pole.
const PITCH_MAX: f64 = FRAC_PI_2 - 1e-3;

impl Player {
    /// Somebody with the eyes at a point.
    pub fn new(eye: DVec3, yaw: f64, body: Body) -> Player {
        Player { walker: Walker::with_eye(eye, body), yaw, pitch: 0.0, is_flying: false, speeds: [1.5, 4.0] }
    }

    /// Where the eyes are.
    pub fn eye(&self) -> DVec3 {
        self.walker.eye()
    }

    /// The way that is looked.
    pub fn orientation(&self) -> DQuat {
        DQuat::from_rotation_y(self.yaw) * DQuat::from_rotation_x(self.pitch)
    }

    /// Turns the head, radians to the left and up.
    pub fn turn(&mut self, left: f64, up: f64) {
        if left.is_finite() && up.is_finite() {
            self.yaw = (self.yaw + left).rem_euclid(TAU);
            self.pitch = (self.pitch + up).clamp(-PITCH_MAX, PITCH_MAX);
        }
    }

    /// Looks along a direction; one that is none changes nothing.
    pub fn look_along(&mut self, direction: DVec3) {
        if let Some(direction) = direction.try_normalize() {
            self.yaw = (-direction.x).atan2(-direction.z).rem_euclid(TAU);
            self.pitch = direction.y.clamp(-1.0, 1.0).asin().clamp(-PITCH_MAX, PITCH_MAX);
        }
    }

    /// Goes where the keys say for so many seconds.
    pub fn go(&mut self, held: Held, ground: &Ground, seconds: f64) {
        let speed = self.speeds[usize::from(held.fast)];
        let wish = DVec2::new(axis(held.across), axis(held.along)).clamp_length_max(1.0) * speed;
        if self.is_flying {
            let way = self.orientation() * DVec3::new(wish.x, 0.0, -wish.y) + DVec3::Y * axis(held.upright) * speed;
            // Flight is for looking round: faster than one walks.
            self.walker.feet += way * 2.0 * seconds;
            return;
        }
        let (sin, cos) = self.yaw.sin_cos();
        let velocity = DVec2::new(wish.x * cos - wish.y * sin, -wish.x * sin - wish.y * cos);
        self.walker.walk(ground, velocity, seconds);
    }
}

#[cfg(test)]
mod tests {
    use eyeline_visibility::Scene;

    use super::*;

    #[test]
    fn forward_is_where_one_looks() {
        let ground = Ground::new(&Scene::from_triangles(Vec::new()));
        let held = Held { along: [true, false], ..Held::default() };
        for is_flying in [false, true] {
            for yaw in [0.0, 1.0, 4.0] {
                let mut player = Player { is_flying, ..Player::new(DVec3::new(5.0, 1.6, 5.0), yaw, Body::default()) };
                let before = player.eye();
                player.go(held, &ground, 0.5);
                let way = player.eye() - before;
                assert!(way.normalize().abs_diff_eq(player.orientation() * DVec3::NEG_Z, 1e-9), "{way}");
                let right = Held { across: [true, false], ..Held::default() };
                let before = player.eye();
                player.go(right, &ground, 0.5);
                let way = player.eye() - before;
                assert!(way.normalize().abs_diff_eq(player.orientation() * DVec3::X, 1e-9), "{way}");
            }
        }
    }

    #[test]
    fn looks_are_kept_off_the_poles_and_numbers_sane() {
        let mut player = Player::new(DVec3::ZERO, 0.0, Body::default());
        player.turn(0.0, 9.0);
        assert_eq!(player.pitch, PITCH_MAX);
        player.turn(f64::NAN, f64::INFINITY);
        assert_eq!((player.yaw, player.pitch), (0.0, PITCH_MAX));
        let direction = DVec3::new(1.0, -0.5, 2.0).normalize();
        player.look_along(direction);
        assert!((player.orientation() * DVec3::NEG_Z).abs_diff_eq(direction, 1e-9));
        player.look_along(DVec3::ZERO);
        assert!((player.orientation() * DVec3::NEG_Z).abs_diff_eq(direction, 1e-9));
    }
}
