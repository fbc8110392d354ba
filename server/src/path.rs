//! Where is a thing on its preset path at a given time, and how fast can it ever be?
//!
//! A [`PathSpec`] is a polyline walked there and back for ever, with a rest at each end and, if wished, a sideways swing
//! (S&G Fig. 4: chairs to and from a table, one of which wobbles). [`Path::pose_at`] is a pure function of time, so the
//! server, a truth checker and a test agree without sharing state, and a clock that jumps breaks nothing.
//!
//! **The bound of the speed.** On segment i of length lᵢ the sideways offset is A·sin(π·hᵢ·u/lᵢ), with u the way along the
//! segment and hᵢ a whole number of half swings, the nearest to what the file asks for. So the offset is 0 at both ends
//! of every segment (the path stays continuous at corners and at its turning points), and since it is perpendicular to
//! the segment, the speed is v·√(1 + (A·π·hᵢ/lᵢ·cos)²) ≤ v·√(1 + (A·π·hᵢ/lᵢ)²). The greatest of these over the segments
//! is [`Path::speed_bound`]; rests are slower. A curve is at least as long as its chord, hence
//! |p(t₁) − p(t₂)| ≤ bound·|t₁ − t₂|, up to the rounding of f64: a few ulp of the coordinates, and what the speed
//! covers in a few ulp of the time (10⁻¹¹ s after a day).

use std::f64::consts::PI;

use glam::DVec3;

use crate::spec::{ObjectSpec, PathSpec, WorldSpec};
use crate::spring::{Spring, SpringError};

/// How far a wobbling thing turns with its swing: radians a metre of offset.
const TURN_PER_OFFSET: f64 = 2.0;

/// The speed bound is raised by this share, so that its own rounding cannot put it below the truth.
const ROUND_UP: f64 = 1.0 + 1e-12;

/// A preset path, ready to be asked for poses.
#[derive(Clone, Debug, PartialEq)]
pub struct Path {
    /// Never empty; segments of length 0 are left out unless there is no other.
    segments: Vec<Segment>,
    /// Way from end to end, in metres.
    length: f64,
    /// Metres a second along the polyline; above 0.
    speed: f64,
    /// Seconds of rest at each end.
    pause_s: f64,
    /// Seconds from start to start; 0 for a path that goes nowhere.
    cycle_s: f64,
    /// Share of the cycle that has passed at time 0, in 0..1.
    phase: f64,
    /// Amplitude of the swing.
    wobble: f64,
    /// Turn about +Y at rest.
    heading: f64,
    speed_bound: f64,
    /// What draws the thing to where the path has it, if it is not there itself.
    spring: Option<Spring>,
}

#[derive(Clone, Debug, PartialEq)]
struct Segment {
    from: DVec3,
    to: DVec3,
    /// Unit vector of the swing, perpendicular to the segment.
    sideways: DVec3,
    /// Way along the path at `from`.
    start: f64,
    length: f64,
    /// A whole number, so that the offset is 0 at both ends.
    half_swings: f64,
}

/// Why a world's paths cannot be used.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum PathError {
    /// The object's class is not in the file.
    #[error("object `{object}` is of class `{class}`, which no [[class]] defines; add it or correct the name")]
    UnknownClass {
        /// Name of the object.
        object: String,
        /// Name that was not found.
        class: String,
    },
    /// Fewer than two corners.
    #[error("the path of object `{object}` has {count} points; give at least 2, or leave `path` out")]
    TooFewPoints {
        /// Name of the object.
        object: String,
        /// Corners given.
        count: usize,
    },
    /// A value that is not finite or out of its range.
    #[error("the path of object `{object}` has {field} = {value}; {remedy}")]
    Value {
        /// Name of the object.
        object: String,
        /// Field of [`PathSpec`].
        field: &'static str,
        /// What the file says.
        value: f64,
        /// What would be right.
        remedy: &'static str,
    },
    /// A spring that cannot be.
    #[error("the path of object `{object}` has spring.{error}")]
    Spring {
        /// Name of the object.
        object: String,
        /// What is wrong with it.
        #[source]
        error: SpringError,
    },
    /// The path is faster than its class allows.
    #[error(
        "object `{object}` can reach {bound:.4} m/s on its path (speed {speed} m/s, wobble {wobble} m), more than \
         speed_max = {speed_max} m/s of its class `{class}`; raise speed_max, or lower the path's speed or wobble"
    )]
    TooFast {
        /// Name of the object.
        object: String,
        /// Name of its class.
        class: String,
        /// Greatest speed on the path, in metres a second.
        bound: f64,
        /// The path's speed, wobble apart.
        speed: f64,
        /// The path's wobble.
        wobble: f64,
        /// The class's bound.
        speed_max: f64,
    },
}

impl Path {
    /// Prepares the path of one object, whose turn at rest is `heading`. `object` is its name, for errors.
    pub fn new(spec: &PathSpec, heading: f64, object: &str) -> Result<Path, PathError> {
        check(spec, heading, object)?;
        let in_spring = |error| PathError::Spring { object: object.into(), error };
        let mut segments = Vec::with_capacity(spec.points.len() - 1);
        let mut length = 0.0;
        let mut slope_max = 0.0_f64;
        for pair in spec.points.windows(2) {
            let (from, to) = (DVec3::from(pair[0]), DVec3::from(pair[1]));
            let along = from.distance(to);
            if along == 0.0 {
                continue;
            }
            let half_swings = (2.0 * spec.wobble_per_metre * along).round();
            let sideways = (to - from).cross(DVec3::Y).try_normalize().unwrap_or(DVec3::X);
            segments.push(Segment { from, to, sideways, start: length, length: along, half_swings });
            length += along;
            slope_max = slope_max.max(spec.wobble * PI * half_swings / along);
        }
        if segments.is_empty() {
            let from = DVec3::from(spec.points[0]);
            let segment = Segment { from, to: from, sideways: DVec3::X, start: 0.0, length: 0.0, half_swings: 0.0 };
            segments.push(segment);
        }
        let (cycle_s, speed_bound) = if length > 0.0 {
            (2.0 * (length / spec.speed + spec.pause), spec.speed * 1.0_f64.hypot(slope_max) * ROUND_UP)
        } else {
            (0.0, 0.0)
        };
        if !cycle_s.is_finite() || !speed_bound.is_finite() {
            let remedy = "its cycle or its greatest speed overflows; give lengths, speed and pause of a usual size";
            return Err(PathError::Value { object: object.into(), field: "speed", value: spec.speed, remedy });
        }
        Ok(Path {
            segments,
            length,
            speed: spec.speed,
            pause_s: spec.pause,
            cycle_s,
            phase: spec.phase,
            wobble: spec.wobble,
            heading,
            speed_bound,
            spring: spec.spring.as_ref().map(Spring::new).transpose().map_err(in_spring)?,
        })
    }

    /// Reference point and turn about +Y at `time_s` seconds of world time, any finite number.
    pub fn pose_at(&self, time_s: f64) -> (DVec3, f64) {
        let way = self.way_at(time_s);
        let segment = &self.segments[self.segments.partition_point(|s| s.start <= way).saturating_sub(1)];
        if segment.length == 0.0 {
            return (segment.from, self.heading);
        }
        let share = ((way - segment.start) / segment.length).clamp(0.0, 1.0);
        let offset =
            if share == 0.0 || share == 1.0 { 0.0 } else { self.wobble * (PI * segment.half_swings * share).sin() };
        let position = segment.from.lerp(segment.to, share) + segment.sideways * offset;
        (position, self.heading + TURN_PER_OFFSET * offset)
    }

    /// What draws the thing to where the path has it; without one it is there.
    pub fn spring(&self) -> Option<&Spring> {
        self.spring.as_ref()
    }

    /// Greatest speed of the reference point, in metres a second: never exceeded, and reached if the path has a wobble.
    pub fn speed_bound(&self) -> f64 {
        self.speed_bound
    }

    /// A ball that contains the reference point at every time: centre and radius in metres (S&G 1999, Fig. 4: the volume
    /// that the motion sweeps, as a sphere).
    pub fn ball(&self) -> (DVec3, f64) {
        let corners = || self.segments.iter().flat_map(|segment| [segment.from, segment.to]);
        let (min, max) =
            corners().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(min, max), p| (min.min(p), max.max(p)));
        let centre = (min + max) * 0.5;
        let reach = corners().map(|corner| corner.distance(centre)).fold(0.0, f64::max);
        (centre, (reach + self.wobble) * ROUND_UP + 1e-9)
    }

    /// Share of the time in which it is not at rest, 0 to 1.
    pub fn moving_share(&self) -> f64 {
        if self.cycle_s > 0.0 { 2.0 * self.length / self.speed / self.cycle_s } else { 0.0 }
    }

    /// Metres from the path's start, measured along the polyline.
    fn way_at(&self, time_s: f64) -> f64 {
        if self.cycle_s <= 0.0 || !time_s.is_finite() {
            return 0.0;
        }
        let into = (time_s.rem_euclid(self.cycle_s) + self.phase * self.cycle_s).rem_euclid(self.cycle_s);
        let half = 0.5 * self.cycle_s;
        let gone = self.speed * if into < half { into } else { into - half };
        let gone = gone.min(self.length);
        if into < half { gone } else { self.length - gone }
    }
}

/// The paths of a world's objects, in the file's order, each checked against its class's `speed_max`.
pub fn paths_of(world: &WorldSpec) -> Result<Vec<Option<Path>>, PathError> {
    let classes: std::collections::BTreeMap<&str, f64> =
        world.classes.iter().map(|class| (class.name.as_str(), class.speed_max)).collect();
    world.objects.iter().map(|object| path_of(object, &classes)).collect()
}

fn path_of(
    object: &ObjectSpec,
    speed_max_of: &std::collections::BTreeMap<&str, f64>,
) -> Result<Option<Path>, PathError> {
    let Some(&speed_max) = speed_max_of.get(object.class.as_str()) else {
        return Err(PathError::UnknownClass { object: object.name.clone(), class: object.class.clone() });
    };
    let Some(spec) = &object.path else { return Ok(None) };
    let path = Path::new(spec, object.heading, &object.name)?;
    // Written so that a speed_max of NaN fails too.
    if path.speed_bound() <= speed_max {
        return Ok(Some(path));
    }
    Err(PathError::TooFast {
        object: object.name.clone(),
        class: object.class.clone(),
        bound: path.speed_bound(),
        speed: spec.speed,
        wobble: spec.wobble,
        speed_max,
    })
}

fn check(spec: &PathSpec, heading: f64, object: &str) -> Result<(), PathError> {
    if spec.points.len() < 2 {
        return Err(PathError::TooFewPoints { object: object.into(), count: spec.points.len() });
    }
    let bad = |field, value, remedy| Err(PathError::Value { object: object.into(), field, value, remedy });
    if let Some(&value) = spec.points.iter().flatten().find(|value| !value.is_finite()) {
        return bad("points", value, "every coordinate must be a finite number of metres");
    }
    if !(spec.speed.is_finite() && spec.speed > 0.0) {
        return bad("speed", spec.speed, "give metres a second above 0, or leave `path` out");
    }
    if !(spec.pause.is_finite() && spec.pause >= 0.0) {
        return bad("pause", spec.pause, "give seconds, 0 or more");
    }
    if !(0.0..=1.0).contains(&spec.phase) {
        return bad("phase", spec.phase, "give a share of the cycle from 0 to 1");
    }
    if !(spec.wobble.is_finite() && spec.wobble >= 0.0) {
        return bad("wobble", spec.wobble, "give metres, 0 or more");
    }
    if !(spec.wobble_per_metre.is_finite() && spec.wobble_per_metre >= 0.0) {
        return bad("wobble_per_metre", spec.wobble_per_metre, "give swings a metre, 0 or more");
    }
    if !heading.is_finite() {
        return bad("heading", heading, "the object's heading must be a finite number of radians");
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::spec::ClassSpec;

    fn straight(speed: f64, pause: f64) -> PathSpec {
        let points = vec![[1.0, 0.0, 0.0], [3.0, 0.0, 0.0]];
        PathSpec { points, speed, pause, phase: 0.0, wobble: 0.0, wobble_per_metre: 0.0, spring: None }
    }

    #[test]
    fn goes_there_rests_and_comes_back() {
        // 2 m at 1 m/s with 1 s of rest at each end: a cycle of 6 s.
        let path = Path::new(&straight(1.0, 1.0), 0.25, "chair.0").unwrap();
        let x_at = |time_s| path.pose_at(time_s).0.x;
        for (time_s, x) in [
            (0.0, 1.0),
            (1.0, 2.0),
            (2.0, 3.0),
            (2.9, 3.0),
            (4.0, 2.0),
            (5.0, 1.0),
            (5.9, 1.0),
            (7.0, 2.0),
            (-1.5, 1.5),
        ] {
            assert!((x_at(time_s) - x).abs() < 1e-12, "x({time_s}) = {}, not {x}", x_at(time_s));
        }
        assert_eq!(path.pose_at(1.0).1, 0.25);
        assert!((path.moving_share() - 4.0 / 6.0).abs() < 1e-12);
        assert!((path.speed_bound() - 1.0).abs() < 1e-9);
    }

    #[test]
    fn its_ball_contains_it_at_every_time() {
        let spec = PathSpec {
            points: vec![[0.0, 0.0, 0.0], [2.0, 0.0, 1.0], [2.0, 1.0, 4.0]],
            speed: 0.7,
            pause: 0.5,
            phase: 0.3,
            wobble: 0.4,
            wobble_per_metre: 1.3,
            spring: None,
        };
        let path = Path::new(&spec, 0.0, "cart").unwrap();
        let (centre, radius) = path.ball();
        assert!((0..5000).all(|i| path.pose_at(f64::from(i) * 0.01).0.distance(centre) <= radius));
        assert!(radius < 3.0, "{radius} m is not tight");
    }

    #[test]
    fn phase_is_a_share_of_the_cycle() {
        let mut spec = straight(1.0, 1.0);
        spec.phase = 0.5;
        let path = Path::new(&spec, 0.0, "chair.0").unwrap();
        assert!((path.pose_at(0.0).0.x - 3.0).abs() < 1e-12);
        assert!((path.pose_at(1.0).0.x - 2.0).abs() < 1e-12);
    }

    #[test]
    fn wobble_swings_sideways_and_reaches_its_bound() {
        let mut spec = straight(1.0, 0.0);
        (spec.wobble, spec.wobble_per_metre) = (0.1, 1.0);
        let path = Path::new(&spec, 0.0, "chair.0").unwrap();
        // 2 m at 1 swing a metre: 4 half swings; the first crest after a quarter of a metre.
        assert!((path.pose_at(0.25).0.z.abs() - 0.1).abs() < 1e-12);
        assert!(path.pose_at(1.0).0.z.abs() < 1e-12);
        let step_s = 1e-6;
        let measured = path.pose_at(1.0).0.distance(path.pose_at(1.0 + step_s).0) / step_s;
        assert!(measured <= path.speed_bound() && measured > 0.999 * path.speed_bound(), "{measured}");
    }

    #[test]
    fn a_path_that_goes_nowhere_stays() {
        let mut spec = straight(1.0, 0.0);
        spec.points = vec![[1.0, 2.0, 3.0]; 3];
        let path = Path::new(&spec, 0.0, "chair.0").unwrap();
        assert_eq!(path.pose_at(5.0).0, DVec3::new(1.0, 2.0, 3.0));
        assert_eq!((path.speed_bound(), path.moving_share()), (0.0, 0.0));
    }

    #[test]
    fn bad_values_are_named() {
        let message = |change: fn(&mut PathSpec)| {
            let mut spec = straight(1.0, 0.0);
            change(&mut spec);
            Path::new(&spec, 0.0, "chair.7").unwrap_err().to_string()
        };
        assert!(message(|s| s.points.truncate(1)).contains("`chair.7` has 1 points"));
        assert!(message(|s| s.points[1][2] = f64::NAN).contains("points = NaN"));
        assert!(message(|s| s.speed = 0.0).contains("speed = 0"));
        assert!(message(|s| s.speed = f64::INFINITY).contains("speed = inf"));
        assert!(message(|s| s.speed = f64::MIN_POSITIVE).contains("overflows"));
        assert!(message(|s| s.pause = -1.0).contains("pause = -1"));
        assert!(message(|s| s.phase = 1.5).contains("phase = 1.5"));
        assert!(message(|s| s.wobble = f64::NAN).contains("wobble = NaN"));
        assert!(message(|s| s.wobble_per_metre = -2.0).contains("wobble_per_metre = -2"));
    }

    #[test]
    fn a_world_with_a_path_over_its_class_speed_is_refused_by_name() {
        let mut path = straight(0.6, 0.0);
        (path.wobble, path.wobble_per_metre) = (0.1, 1.0);
        let class = ClassSpec { name: "chair".into(), radius: 0.35, bottom: 0.0, top: 0.95, speed_max: 0.62 };
        let object = ObjectSpec {
            name: "chair.3".into(),
            class: "chair".into(),
            node: None,
            position: [1.0, 0.0, 0.0],
            heading: 0.0,
            takeable: false,
            path: Some(path),
        };
        let mut world = WorldSpec { classes: vec![class], objects: vec![object], ..WorldSpec::default() };
        let error = paths_of(&world).unwrap_err().to_string();
        for part in ["`chair.3`", "0.7086", "0.62", "`chair`", "raise speed_max"] {
            assert!(error.contains(part), "{part} is not in: {error}");
        }
        world.classes[0].speed_max = 0.71;
        assert!(paths_of(&world).unwrap()[0].is_some());
        world.objects[0].class = "stool".into();
        assert!(paths_of(&world).unwrap_err().to_string().contains("`stool`"));
    }

    proptest! {
        #[test]
        fn never_faster_than_its_bound(
            points in prop::collection::vec(prop::array::uniform3(-50.0..50.0_f64), 2..6),
            speed in 0.01..20.0_f64,
            pause in 0.0..5.0_f64,
            phase in 0.0..1.0_f64,
            wobble in 0.0..2.0_f64,
            wobble_per_metre in 0.0..4.0_f64,
            time_s in -1e4..1e5_f64,
            later_s in prop_oneof![1e-6..1e-3_f64, 1e-3..1.0_f64, 1.0..1e4_f64],
        ) {
            let spec = PathSpec { points, speed, pause, phase, wobble, wobble_per_metre, spring: None };
            let path = Path::new(&spec, 0.0, "any").unwrap();
            let moved = path.pose_at(time_s).0.distance(path.pose_at(time_s + later_s).0);
            let gone_s = (time_s + later_s) - time_s;
            prop_assert!(moved <= path.speed_bound() * gone_s + 1e-8, "{moved} m in {gone_s} s");
        }
    }
}
