//! How avatars move that nobody steers.
//!
//! A mover is a state machine without a clock: `step(dt)` yields the next pose, and a seed decides every choice, so a swarm
//! over real QUIC and one in virtual time walk the same way. [`walk`] goes from room to room of a made building;
//! [`wander`] stands at a place of a given scene and looks around. Preset paths of things are the server's
//! (`eyeline_server::path`), and people who really walked are in [`crate::trace`].

pub mod walk;
pub mod wander;

use std::f64::consts::{PI, TAU};

use glam::DVec3;

/// Where an avatar is and looks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WalkerPose {
    /// The point between its feet, in metres.
    pub feet: DVec3,
    /// Turn about +Y, in radians from −π to π; 0 looks along −Z.
    pub yaw: f64,
    /// Its eye, in metres.
    pub eye: DVec3,
}

/// Turns `yaw` toward `wanted` the short way, by at most `most` radians. The result is in −π..π, and exactly `wanted` once
/// it is reached, if that is.
fn turn_toward(yaw: f64, wanted: f64, most: f64) -> f64 {
    let wrapped = |angle: f64| (angle + PI).rem_euclid(TAU) - PI;
    let difference = wrapped(wanted - yaw);
    if difference.abs() > most {
        wrapped(yaw + most.copysign(difference))
    } else if wanted.abs() <= PI {
        wanted
    } else {
        wrapped(wanted)
    }
}

/// The seconds that a step counts: a step that is not a positive number moves nothing, and one longer than 10 s (a clock
/// that jumped) counts as 10 s.
fn step_s(dt_s: f64) -> f64 {
    if dt_s > 0.0 { dt_s.min(10.0) } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn turns_the_short_way_and_no_faster_than_allowed() {
        assert!((turn_toward(3.0, -3.0, 0.1) - 3.1).abs() < 1e-12);
        assert!((turn_toward(3.1, -3.1, 1.0) + 3.1).abs() < 1e-12);
        assert!((turn_toward(0.0, 1.0, 0.25) - 0.25).abs() < 1e-12);
        assert_eq!([step_s(f64::NAN), step_s(-1.0), step_s(f64::INFINITY)], [0.0, 0.0, 10.0]);
    }
}
