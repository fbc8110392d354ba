//! How tracked objects move: like the paper's chairs, at random, and as unkindly as their bounds allow.
//!
//! Each motion keeps the promises that TBVs are made from: a greatest speed, for some a greatest acceleration, for preset ones
//! the whole trajectory. A tracker is told no more than these.

use std::f64::consts::TAU;
use std::sync::Arc;

use eyeline_client::tracking::Trajectory;
use eyeline_protocol::WorldTime;
use eyeline_server::path::Path;
use glam::{DVec2, DVec3};
use rand::RngExt;
use rand_pcg::Pcg64;

use crate::scene::plan::Rect;

/// A way to move.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum MotionKind {
    /// To and from a table on a known trajectory (S&G §6.1, Fig. 4).
    Preset,
    /// To random points, at random speeds.
    Random,
    /// Smoothly: the acceleration is bounded too.
    Smooth,
    /// Stands still and dashes at full speed, at random.
    StopAndDash,
    /// At full speed all the time, back and forth on a line of random direction.
    AtLimit,
    /// Back and forth past one side of a door's opening.
    DoorFrame,
    /// Spins in its place.
    Spin,
}

impl MotionKind {
    /// All of them.
    pub const ALL: [MotionKind; 7] = [
        MotionKind::Preset,
        MotionKind::Random,
        MotionKind::Smooth,
        MotionKind::StopAndDash,
        MotionKind::AtLimit,
        MotionKind::DoorFrame,
        MotionKind::Spin,
    ];

    /// The name in rows and on command lines.
    pub const fn name(self) -> &'static str {
        match self {
            MotionKind::Preset => "preset",
            MotionKind::Random => "random",
            MotionKind::Smooth => "smooth",
            MotionKind::StopAndDash => "stop-and-dash",
            MotionKind::AtLimit => "at-limit",
            MotionKind::DoorFrame => "door-frame",
            MotionKind::Spin => "spin",
        }
    }
}

/// Where a mover is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Place {
    /// Its reference point on the floor, metres.
    pub position: DVec3,
    /// Velocity, m/s, from now on.
    pub velocity: DVec3,
    /// Turn about +Y, radians.
    pub yaw: f64,
}

/// Something that moves.
#[derive(Clone, Debug)]
pub struct Mover {
    place: Place,
    way: Way,
    speed_max: f64,
    acceleration_max: f64,
}

#[derive(Clone, Debug)]
enum Way {
    Preset {
        path: Arc<Path>,
        lift: f64,
        time_s: f64,
    },
    /// To `target`, then to another point of `within`.
    Targets {
        within: Rect,
        target: DVec2,
        speed: f64,
        chance: Pcg64,
        dashes: bool,
        rest_s: f64,
    },
    /// Along a line between two points.
    Line {
        ends: [DVec2; 2],
        toward: usize,
    },
    /// A sum of sines along each axis.
    Sines {
        centre: DVec2,
        terms: [[(f64, f64, f64); 2]; 2],
        time_s: f64,
    },
    Spin {
        rate: f64,
    },
}

impl Mover {
    /// On a preset path, `lift` above it.
    pub fn preset(path: Path, lift: f64) -> Mover {
        let speed_max = path.speed_bound();
        let (at, yaw) = path.pose_at(0.0);
        let place = Place { position: at + DVec3::Y * lift, velocity: DVec3::ZERO, yaw };
        let way = Way::Preset { path: Arc::new(path), lift, time_s: 0.0 };
        Mover { place, way, speed_max, acceleration_max: f64::INFINITY }
    }

    /// In some way within a rectangle of the floor, `height` above it, no faster than `speed_max`.
    ///
    /// [`MotionKind::DoorFrame`] goes along the rectangle's middle line, which should lie across a door; [`MotionKind::Preset`]
    /// needs a path and is taken as [`MotionKind::Random`].
    pub fn within(kind: MotionKind, within: Rect, height: f64, speed_max: f64, mut chance: Pcg64) -> Mover {
        let random_point =
            |chance: &mut Pcg64| within.min + (within.max - within.min) * DVec2::new(chance.random(), chance.random());
        let start = random_point(&mut chance);
        let yaw = chance.random_range(0.0..TAU);
        let mut at = start;
        let mut acceleration_max = f64::INFINITY;
        let way = match kind {
            MotionKind::Preset | MotionKind::Random | MotionKind::StopAndDash => {
                let dashes = kind == MotionKind::StopAndDash;
                let target = random_point(&mut chance);
                let speed = if dashes { speed_max } else { speed_max * chance.random_range(0.2..1.0) };
                Way::Targets { within, target, speed, chance, dashes, rest_s: 0.0 }
            }
            MotionKind::AtLimit => {
                // The chord through the start in a random direction.
                let way = DVec2::from_angle(chance.random_range(0.0..TAU));
                let to_edge = |way: DVec2| {
                    let edge = DVec2::select(way.cmpgt(DVec2::ZERO), within.max, within.min);
                    let steps = (edge - start) / way;
                    steps.x.min(steps.y).max(0.0)
                };
                Way::Line { ends: [start + way * to_edge(way), start - way * to_edge(-way)], toward: 0 }
            }
            MotionKind::DoorFrame => {
                let (centre, half) = (within.center(), (within.max - within.min) * 0.5);
                let along = if half.x > half.y { DVec2::X * half.x } else { DVec2::Y * half.y };
                at = centre;
                Way::Line { ends: [centre - along, centre + along], toward: 0 }
            }
            MotionKind::Smooth => {
                let (centre, half) = (within.center(), (within.max - within.min) * 0.5);
                // Speeds of all terms add up to at most speed_max / √2 on each axis.
                let mut terms = [[(0.0, 0.0, 0.0); 2]; 2];
                acceleration_max = 0.0;
                for (axis, terms) in terms.iter_mut().enumerate() {
                    let mut acceleration = 0.0;
                    for (term, share) in terms.iter_mut().zip([0.7, 0.3]) {
                        let amplitude = half[axis] * share * chance.random_range(0.5..1.0);
                        let rate = share * speed_max / std::f64::consts::SQRT_2 / amplitude.max(1e-3);
                        *term = (amplitude, rate, chance.random_range(0.0..TAU));
                        acceleration += amplitude * rate * rate;
                    }
                    acceleration_max = f64::hypot(acceleration_max, acceleration);
                }
                acceleration_max *= 1.0 + 1e-9;
                Way::Sines { centre, terms, time_s: 0.0 }
            }
            MotionKind::Spin => Way::Spin { rate: chance.random_range(1.0..20.0) },
        };
        let position = DVec3::new(at.x, height, at.y);
        let place = Place { position, velocity: DVec3::ZERO, yaw };
        let mut mover = Mover { place, way, speed_max, acceleration_max };
        mover.step(0.0);
        mover
    }

    /// Goes on for `dt_s` seconds.
    pub fn step(&mut self, dt_s: f64) {
        let height = self.place.position.y;
        match &mut self.way {
            Way::Preset { path, lift, time_s } => {
                *time_s += dt_s;
                let (at, yaw) = path.pose_at(*time_s);
                self.place.velocity = DVec3::ZERO;
                (self.place.position, self.place.yaw) = (at + DVec3::Y * *lift, yaw);
            }
            Way::Targets { within, target, speed, chance, dashes, rest_s } => {
                let mut left_s = dt_s;
                let mut at = DVec2::new(self.place.position.x, self.place.position.z);
                while left_s > 0.0 {
                    if *rest_s > 0.0 {
                        let rested = rest_s.min(left_s);
                        *rest_s -= rested;
                        left_s -= rested;
                        continue;
                    }
                    let way = *target - at;
                    let needs_s = way.length() / *speed;
                    if needs_s > left_s {
                        at += way.normalize() * (*speed * left_s);
                        break;
                    }
                    at = *target;
                    // A target that is reached at once costs a little time all the same.
                    left_s -= needs_s.max(1e-6);
                    *target = within.min + (within.max - within.min) * DVec2::new(chance.random(), chance.random());
                    if *dashes {
                        *rest_s = chance.random_range(0.0..4.0);
                    } else {
                        *speed = self.speed_max * chance.random_range(0.2..1.0);
                    }
                }
                let course = (*target - at).normalize_or_zero() * if *rest_s > 0.0 { 0.0 } else { *speed };
                self.place.position = DVec3::new(at.x, height, at.y);
                self.place.velocity = DVec3::new(course.x, 0.0, course.y);
                if course != DVec2::ZERO {
                    self.place.yaw = f64::atan2(-course.x, -course.y);
                }
            }
            Way::Line { ends, toward } => {
                let mut left = self.speed_max * dt_s;
                let mut at = DVec2::new(self.place.position.x, self.place.position.z);
                // A short line is walked a few times at most: nobody sees the difference.
                for _ in 0..16 {
                    let way = ends[*toward] - at;
                    if way.length() > left {
                        at += way.normalize() * left;
                        break;
                    }
                    left -= way.length();
                    at = ends[*toward];
                    *toward = 1 - *toward;
                }
                let course = (ends[*toward] - at).normalize_or_zero() * self.speed_max;
                self.place.position = DVec3::new(at.x, height, at.y);
                self.place.velocity = DVec3::new(course.x, 0.0, course.y);
            }
            Way::Sines { centre, terms, time_s } => {
                *time_s += dt_s;
                let (mut at, mut velocity) = (*centre, DVec2::ZERO);
                for axis in 0..2 {
                    for (amplitude, rate, phase) in terms[axis] {
                        at[axis] += amplitude * (rate * *time_s + phase).sin();
                        velocity[axis] += amplitude * rate * (rate * *time_s + phase).cos();
                    }
                }
                self.place.position = DVec3::new(at.x, height, at.y);
                self.place.velocity = DVec3::new(velocity.x, 0.0, velocity.y);
            }
            Way::Spin { rate } => self.place.yaw = (self.place.yaw + *rate * dt_s).rem_euclid(TAU),
        }
    }

    /// Where it is.
    pub fn place(&self) -> Place {
        self.place
    }

    /// Greatest speed, m/s.
    pub fn speed_max(&self) -> f64 {
        if matches!(self.way, Way::Spin { .. }) { 0.0 } else { self.speed_max }
    }

    /// Greatest acceleration, m/s²; infinite if it is not known.
    pub fn acceleration_max(&self) -> f64 {
        self.acceleration_max
    }

    /// The whole motion relative to `anchor`, if it is preset.
    pub fn trajectory(&self, anchor: DVec3) -> Option<Arc<dyn Trajectory + Send + Sync>> {
        match &self.way {
            Way::Preset { path, lift, .. } => {
                Some(Arc::new(OnPath { path: path.clone(), offset: DVec3::Y * *lift - anchor }))
            }
            _ => None,
        }
    }
}

/// A preset path as a trajectory of world time; the frames of a run begin at [`WorldTime::ZERO`].
struct OnPath {
    path: Arc<Path>,
    offset: DVec3,
}

impl Trajectory for OnPath {
    fn position(&self, at: WorldTime) -> DVec3 {
        self.path.pose_at(at.seconds()).0 + self.offset
    }

    fn speed_max(&self) -> f64 {
        self.path.speed_bound()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chance;

    #[test]
    fn keeps_its_rectangle_and_its_limits_and_moves() {
        let within = Rect { min: DVec2::new(1.0, 2.0), max: DVec2::new(6.0, 4.5) };
        for kind in MotionKind::ALL {
            for seed in 0..5 {
                let mut mover = Mover::within(kind, within, 0.5, 0.9, chance(seed, 1));
                let (mut before, mut walked, mut turned) = (mover.place(), 0.0, 0.0);
                for _ in 0..2_000 {
                    mover.step(0.05);
                    let place = mover.place();
                    let at = DVec2::new(place.position.x, place.position.z);
                    assert!(within.grown(1e-9).contains(at), "{kind:?} at {at}");
                    assert_eq!(place.position.y, 0.5);
                    let step = place.position.distance(before.position);
                    assert!(step <= mover.speed_max() * 0.05 + 1e-9, "{kind:?} steps {step} m");
                    let foreseen = before.position + before.velocity * 0.05;
                    let strayed = place.position.distance(foreseen);
                    assert!(
                        strayed <= 0.5 * mover.acceleration_max() * 0.05 * 0.05 + 1e-9,
                        "{kind:?} strays {strayed}"
                    );
                    walked += step;
                    turned += (place.yaw - before.yaw).abs();
                    before = place;
                }
                assert!(walked > 10.0 || (kind == MotionKind::Spin && turned > 10.0), "{kind:?}: {walked} m");
            }
        }
    }
}
