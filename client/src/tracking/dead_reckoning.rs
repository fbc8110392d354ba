//! Where is an object that the server says nothing new of?
//!
//! Nothing new means: what is drawn is right enough ([`Prediction`]). So it is drawn where its last state has it go on,
//! and may truly be near that, or, since word of a change takes its time, wherever it can have got from there meanwhile.

use eyeline_protocol::{ERROR_METRES_MAX, MotionBound, Position, Prediction, WorldTime};
use glam::DVec3;

/// How far what is drawn may be from the truth without a word from the server, metres; `allowed` is the welcome's. The
/// server weighs errors by what it knows of our eye, which is not quite what we know: its limit for all eyes holds.
pub(super) fn tolerance(allowed: Option<f64>) -> f64 {
    if allowed.is_some() { ERROR_METRES_MAX } else { 0.0 }
}

/// Where an object is drawn at `time`: on the wire's grid, and where it was told if that is beyond the world.
pub(super) fn drawn(state: &Prediction, time: WorldTime) -> Position {
    Position::from_metres(state.place_at(time)).unwrap_or(state.position)
}

/// Middle and radius of the ball that its reference point is in at `time`, if word of a wrong prediction takes at most
/// `silence` seconds.
///
/// Until then, or at the state itself if that is newer, it was within `tolerance` of where it was drawn; since then it has
/// moved as far as it can. Without dead reckoning that says: what has not been heard of for longer has not moved.
pub(super) fn ball(
    state: &Prediction,
    motion: MotionBound,
    time: WorldTime,
    silence: f64,
    tolerance: f64,
) -> (DVec3, f64) {
    let age = time.seconds_since(state.tick).max(0.0);
    if age <= silence {
        return (state.position.metres(), motion.reach(age));
    }
    let heard = time.offset_micros((silence * -1e6) as i64);
    (state.place_at(heard), motion.reach(silence) + tolerance)
}

#[cfg(test)]
mod tests {
    use eyeline_protocol::{Orientation, Velocity};

    use super::*;

    const MOTION: MotionBound = MotionBound { speed_max: 2.0, slack: 0.1 };

    fn state(velocity: f64) -> Prediction {
        Prediction {
            position: Position::default(),
            velocity: Velocity::from_metres(DVec3::X * velocity),
            orientation: Orientation::default(),
            tick: WorldTime::ZERO,
        }
    }

    #[test]
    fn a_fresh_state_is_where_it_was_and_an_old_one_where_it_went() {
        let at = |millis: i64| ball(&state(1.0), MOTION, WorldTime::from_micros(millis * 1000), 0.2, 0.25);
        let close = |(middle, radius): (DVec3, f64), x: f64, wanted: f64| {
            assert!((middle.x - x).abs() < 1e-5 && (radius - wanted).abs() < 1e-5, "{middle} {radius}");
        };
        close(at(-10), 0.0, 0.1);
        close(at(100), 0.0, 0.3);
        close(at(1200), 1.0, 0.75);
    }

    /// Whatever it does between the last word and now, as long as the server would have spoken before.
    #[test]
    fn who_turns_round_unheard_is_in_the_ball() {
        let state = state(2.0);
        for silent_since in [0, 300, 900, 1500] {
            for later in [0, 100, 200] {
                let turned = WorldTime::from_micros(silent_since * 1000);
                let now = turned.offset_micros(later * 1000);
                // On its predicted way, a tolerance off, until it turned round at its top speed.
                let place = state.place_at(turned) + DVec3::X * (if silent_since > 0 { 0.25 } else { 0.0 })
                    - DVec3::X * (2.0 * later as f64 * 1e-3);
                let (middle, radius) = ball(&state, MOTION, now, 0.2, 0.25);
                assert!(middle.distance(place) <= radius + 1e-9, "{silent_since} {later}: {middle} {radius} {place}");
            }
        }
    }

    #[test]
    fn what_runs_out_of_the_world_is_drawn_where_it_was() {
        let edge = Position { x: i32::MAX, y: 0, z: 0 };
        assert_eq!(drawn(&Prediction { position: edge, ..state(2.0) }, WorldTime::from_micros(1_000_000)), edge);
    }
}
