//! Where can an object be until a given time, by what is known of its motion?
//!
//! Sudarsky & Gotsman 1999, §3.2: a sphere if only a greatest speed or acceleration is known, a sweep of the trajectory if that
//! is preset. A [`TemporalBound`] is made once, when its object is hidden, and asked for its volume for one validity
//! period after another while somebody looks for a good one. Everything rounds outward: by a part in 10⁹, a micrometre and a
//! few ulp of the coordinates, which covers the rounding here and in the motion itself many times over.
//!
//! **The sphere from a greatest acceleration *and* speed** keeps, for each instant τ, a ball around the velocities possible by then:
//! those within a·τ of the present v and within s of rest. As long as that lens is more than half of the ball around v, the
//! ball itself is best; once it is more than half of the ball around rest, that one is; in between it is the ball over the circle in
//! which the two meet, which contains their common part since its power function is a convex combination of theirs. A
//! displacement is the integral of a velocity, so it lies in the ball around the integral of the centres whose radius is the integral of the
//! radii. All these balls sit on one axis, so the least ball around those of all instants up to the end is the ball over the
//! stretch of that axis that they cover. It grows with time, and is never larger than the sphere from the speed alone.
//!
//! **A swept path** is cut into short stretches. Whatever gets from p₀ to p₁ in time t at no more than speed s stays in the
//! ellipsoid of foci p₀ and p₁ whose points' distances to them sum to s·t; the box around it is exact for something that
//! moves straight at full speed. The stretches are a power of two of microseconds long, counted from `issued`, so that
//! those for a longer validity contain those for a shorter.

use std::fmt;
use std::sync::Arc;

use eyeline_protocol::WorldTime;
use eyeline_visibility::{Aabb, Bound};
use glam::DVec3;

use super::fuzzy::FuzzySpeeds;

#[cfg(test)]
mod tests;

/// Kinds of volume. Which one is tight depends on what is known of the motion.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TbvShape {
    /// A ball that grows with the greatest speed. Turning and stopping are free.
    SpeedSphere,
    /// A ball from the present velocity and the greatest acceleration and speed: tighter as long as the object could not yet
    /// turn round.
    AccelerationSphere,
    /// A box from the greatest speed along each axis: for what stays on a floor, or on rails.
    Box,
    /// At most this many boxes along a preset path; 0 counts as 1, and more than [`PIECES_MAX`] as that.
    Swept {
        /// How many boxes; the more, the tighter.
        pieces: usize,
    },
    /// Nothing is known. Never hidden.
    Everywhere,
}

/// Most boxes along a path.
pub const PIECES_MAX: usize = 4096;

/// An object's motion at one time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotionState {
    /// Reference point, metres.
    pub position: DVec3,
    /// Metres a second.
    pub velocity: DVec3,
}

/// What an object's motion never exceeds. A limit that a shape uses must be finite; one that it does not use may be
/// infinite. Any that is NaN or negative makes the bound [`TbvShape::Everywhere`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotionLimits {
    /// Greatest speed, metres a second.
    pub speed_max: f64,
    /// Greatest acceleration in any direction, metres a second².
    pub acceleration_max: f64,
    /// Greatest speed along each axis, metres a second.
    pub axis_speed_max: DVec3,
    /// Radius in metres about the reference point that holds the object in every pose.
    pub reach: f64,
}

/// Motion that is known in advance, as a pure function of time.
pub trait Trajectory {
    /// Reference point at a world time, metres; right to a few ulp.
    fn position(&self, at: WorldTime) -> DVec3;
    /// A speed that the motion never exceeds, metres a second.
    fn speed_max(&self) -> f64;
}

/// A shared [`Trajectory`].
pub type Path = Arc<dyn Trajectory + Send + Sync>;

/// A volume for every time from `issued` until `expires` that has contained the object since `issued`.
#[derive(Clone)]
pub struct TemporalBound {
    shape: TbvShape,
    known: Known,
    position: DVec3,
    reach: f64,
    issued: WorldTime,
    expires: WorldTime,
}

/// What a shape is made from. All numbers are finite and at least 0 unless said otherwise.
#[derive(Clone)]
enum Known {
    Nothing,
    Speed(f64),
    Acceleration {
        velocity: DVec3,
        speed_max: f64,
        acceleration_max: f64,
    },
    AxisSpeeds(DVec3),
    Path {
        path: Path,
        speed_max: f64,
        pieces: usize,
    },
    /// The speed may be infinite.
    Probably {
        speeds: FuzzySpeeds,
        speed_max: f64,
    },
}

impl TemporalBound {
    /// A bound of an object whose `state` is that at `issued`. What is not as it should be (a limit that is NaN, negative, or
    /// infinite where the shape needs it, a position that is not finite, a swept shape without `path`, `expires` before `issued`)
    /// makes it [`TbvShape::Everywhere`]. A velocity beyond `speed_max` says nothing.
    pub fn new(
        shape: TbvShape,
        state: MotionState,
        limits: MotionLimits,
        path: Option<Path>,
        issued: WorldTime,
        expires: WorldTime,
    ) -> TemporalBound {
        let known = Known::new(shape, &state, &limits, path).unwrap_or(Known::Nothing);
        let shape = if matches!(known, Known::Nothing) { TbvShape::Everywhere } else { shape };
        TemporalBound { shape, known, position: state.position, reach: limits.reach, issued, expires }
    }

    /// A fuzzy bound: see [`FuzzySpeeds::bound`].
    pub(super) fn fuzzy(
        speeds: FuzzySpeeds,
        state: MotionState,
        limits: MotionLimits,
        issued: WorldTime,
        expires: WorldTime,
    ) -> TemporalBound {
        let hard = TemporalBound::new(TbvShape::SpeedSphere, state, limits, None, issued, expires);
        let is_sound = state.position.is_finite() && limits.are_numbers() && limits.reach.is_finite();
        if !is_sound || speeds.is_empty() {
            return hard;
        }
        let known = Known::Probably { speeds, speed_max: limits.speed_max };
        TemporalBound { shape: TbvShape::SpeedSphere, known, ..hard }
    }

    /// When it was made: from then on it holds.
    pub fn issued(&self) -> WorldTime {
        self.issued
    }

    /// Until when it holds, inclusive.
    pub fn expires(&self) -> WorldTime {
        self.expires
    }

    /// What kind of volume it is; [`TbvShape::Everywhere`] if what it was to be made from was no good.
    pub fn shape(&self) -> TbvShape {
        self.shape
    }

    /// Whether it may be broken, as fuzzy bounds may (§3.5).
    pub fn is_fuzzy(&self) -> bool {
        matches!(self.known, Known::Probably { .. })
    }

    /// The same with another end.
    pub fn with_expiry(&self, expires: WorldTime) -> TemporalBound {
        TemporalBound { expires, ..self.clone() }
    }

    /// The same for the reference point alone.
    pub(super) fn of_point(&self) -> TemporalBound {
        TemporalBound { reach: 0.0, ..self.clone() }
    }

    /// The volume that contains the object at every instant from `issued` until `until`: appended to `pieces`, as one bound or, for
    /// a swept path, as several of which each instant's object is in one. Rounds outward. A later `until` gives a volume
    /// that contains that of an earlier one, to within a micrometre of rounding.
    ///
    /// Before `issued` it is the volume of `issued`. After `expires` the bound says nothing: [`Bound::Everywhere`]. So do
    /// numbers that are too large for f64, and times more than `i64::MAX` microseconds apart.
    pub fn volume(&self, until: WorldTime, pieces: &mut Vec<Bound>) {
        let start = pieces.len();
        let micros = until.max(self.issued).micros().checked_sub(self.issued.micros());
        let is_known = match micros {
            Some(micros) if self.issued <= self.expires && until <= self.expires => self.known_volume(micros, pieces),
            _ => false,
        };
        if !is_known || !pieces[start..].iter().all(is_finite) {
            pieces.truncate(start);
            pieces.push(Bound::Everywhere);
        }
    }

    /// The volume `micros` after `issued`; whether there is one.
    fn known_volume(&self, micros: i64, pieces: &mut Vec<Bound>) -> bool {
        let seconds = micros as f64 * 1e-6;
        let ball = |centre: DVec3, travel: f64| Bound::Sphere { centre, radius: outward(travel + self.reach, centre) };
        pieces.push(match &self.known {
            Known::Nothing => return false,
            Known::Speed(speed_max) => ball(self.position, speed_max * seconds),
            &Known::Acceleration { velocity, speed_max, acceleration_max } => {
                let (back, front) = accelerated_span(velocity.length(), speed_max, acceleration_max, seconds);
                let centre = self.position + velocity.normalize_or_zero() * (0.5 * (back + front));
                ball(centre, 0.5 * (front - back))
            }
            Known::AxisSpeeds(speeds) => {
                let half = *speeds * seconds + DVec3::splat(self.reach);
                Bound::Box(Aabb::around(self.position, half.map(|half| outward(half, self.position))))
            }
            Known::Path { path, speed_max, pieces: count } => {
                return self.sweep(path, *speed_max, *count, micros, pieces);
            }
            Known::Probably { speeds, speed_max } => {
                // An infinite speed in no time is NaN, which `min` passes over.
                let travel = speeds.travel(seconds).unwrap_or(f64::INFINITY).min(speed_max * seconds);
                ball(self.position, travel)
            }
        });
        true
    }

    /// Boxes along the path, from `issued` until `micros` later; false if it leads to no place.
    fn sweep(&self, path: &Path, speed_max: f64, count: usize, micros: i64, pieces: &mut Vec<Bound>) -> bool {
        let stretches_max = count * STRETCHES_PER_PIECE;
        let stretch = (micros as u64).div_ceil(stretches_max as u64).max(1).next_power_of_two() as i64;
        let mut from = 0;
        let mut place = path.position(self.issued);
        let mut piece = Aabb::EMPTY;
        let mut in_piece = 0;
        loop {
            let to = micros.min(from + stretch.min(micros - from));
            let next = path.position(self.issued.offset_micros(to));
            if !(place.is_finite() && next.is_finite()) {
                return false;
            }
            let half_chord = 0.5 * (next - place);
            let middle = place + half_chord;
            let far = place.abs().max_element().max(next.abs().max_element());
            // A path is right to a few ulp of its coordinates and of its time.
            let length = speed_max * ((to - from) as f64 * 1e-6 + 1e-10) + 8.0 * f64::EPSILON * far;
            let (half_length, half_foci) = (0.5 * length, half_chord.length());
            // Squared half width of the ellipsoid; a path that is faster than it says still contains its samples.
            let width = ((half_length - half_foci) * (half_length + half_foci)).max(0.0);
            let half = half_chord.map(|half| outward((width + half * half).sqrt() + self.reach, middle));
            piece = piece.union(&Aabb::around(middle, half));
            in_piece += 1;
            if in_piece == STRETCHES_PER_PIECE || to == micros {
                pieces.push(Bound::Box(piece));
                if to == micros {
                    return true;
                }
                piece = Aabb::EMPTY;
                in_piece = 0;
            }
            from = to;
            place = next;
        }
    }
}

/// A box around eight stretches of a path is wider than the path by little more than around a hundred.
const STRETCHES_PER_PIECE: usize = 8;

impl Known {
    /// What the shape needs, if it is all there.
    fn new(shape: TbvShape, state: &MotionState, limits: &MotionLimits, path: Option<Path>) -> Option<Known> {
        if !limits.are_numbers() || !limits.reach.is_finite() {
            return None;
        }
        let known = match shape {
            TbvShape::Everywhere => None,
            TbvShape::SpeedSphere => Some(Known::Speed(finite(limits.speed_max)?)),
            TbvShape::AccelerationSphere => Some(Known::Acceleration {
                velocity: Some(state.velocity).filter(|velocity| velocity.is_finite())?,
                speed_max: finite(limits.speed_max)?,
                acceleration_max: finite(limits.acceleration_max)?,
            }),
            TbvShape::Box => Some(Known::AxisSpeeds(Some(limits.axis_speed_max).filter(|speed| speed.is_finite())?)),
            TbvShape::Swept { pieces } => {
                let path = path?;
                let speed_max = finite(path.speed_max()).filter(|&speed| speed >= 0.0)?;
                // Where the path is at `issued` counts, not the state.
                return Some(Known::Path { path, speed_max, pieces: pieces.clamp(1, PIECES_MAX) });
            }
        };
        known.filter(|_| state.position.is_finite())
    }
}

impl MotionLimits {
    /// Whether no limit is NaN or negative.
    fn are_numbers(&self) -> bool {
        let least = self.speed_max.min(self.acceleration_max).min(self.axis_speed_max.min_element()).min(self.reach);
        let has_nan = self.speed_max.is_nan()
            || self.acceleration_max.is_nan()
            || self.axis_speed_max.is_nan()
            || self.reach.is_nan();
        !has_nan && least >= 0.0
    }
}

impl fmt::Debug for TemporalBound {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("TemporalBound")
            .field("shape", &self.shape)
            .field("is_fuzzy", &self.is_fuzzy())
            .field("position", &self.position)
            .field("reach", &self.reach)
            .field("issued", &self.issued)
            .field("expires", &self.expires)
            .finish_non_exhaustive()
    }
}

fn finite(value: f64) -> Option<f64> {
    Some(value).filter(|value| value.is_finite())
}

/// A length rounded outward, for a volume about `centre`.
fn outward(length: f64, centre: DVec3) -> f64 {
    length * (1.0 + 1e-9) + 1e-6 + 4.0 * f64::EPSILON * centre.abs().max_element()
}

fn is_finite(bound: &Bound) -> bool {
    match *bound {
        Bound::Sphere { centre, radius } => centre.is_finite() && radius.is_finite(),
        Bound::Box(aabb) => aabb.min.is_finite() && aabb.max.is_finite(),
        Bound::Upright { .. } | Bound::Everywhere => true,
    }
}

/// Whether a point lies in a volume or on its surface.
pub(super) fn contains(bound: &Bound, point: DVec3) -> bool {
    match *bound {
        Bound::Sphere { centre, radius } => centre.distance(point) <= radius,
        Bound::Box(aabb) => aabb.contains(point),
        Bound::Upright { centre, radius, half_height } => {
            let offset = point - centre;
            offset.x.hypot(offset.z) <= radius && offset.y.abs() <= half_height
        }
        Bound::Everywhere => true,
    }
}

/// The stretch of the axis along the present velocity, relative to the present place, over which there is a ball that contains every
/// place within reach in `seconds`: of something that goes at `speed` now, never faster than `speed_max`, never accelerates by
/// more than `acceleration_max`. See the [module](self).
fn accelerated_span(speed: f64, speed_max: f64, acceleration_max: f64, seconds: f64) -> (f64, f64) {
    // In units of the greatest speed nothing overflows.
    let rate = acceleration_max / speed_max;
    // What a speed at its limit may lose in rounding.
    let is_possible = speed <= speed_max * (1.0 + 1e-9);
    if !(is_possible && rate.is_finite()) {
        return (-speed_max * seconds, speed_max * seconds);
    }
    let v = (speed / speed_max).min(1.0);
    // Until when the ball around the present velocity is best, and from when on that around rest.
    let (around_present, around_rest) = if rate > 0.0 {
        (((1.0 - v) * (1.0 + v)).sqrt() / rate, (1.0 + v * v).sqrt() / rate)
    } else {
        (f64::INFINITY, f64::INFINITY)
    };
    let first = seconds.min(around_present);
    let mut centre = v * first;
    let mut radius = 0.5 * rate * first * first;
    let step = (around_rest - around_present) / f64::from(LENS_STEPS);
    if seconds > first && step > 0.0 {
        for i in 0..LENS_STEPS {
            let from = around_present + step * f64::from(i);
            if from >= seconds {
                break;
            }
            // That of the step's end holds all of those before.
            let reached = rate * (from + step);
            let c = ((1.0 + v * v - reached * reached) / (2.0 * v)).clamp(0.0, v);
            let span = step.min(seconds - from);
            centre += c * span;
            radius += ((1.0 - c) * (1.0 + c)).sqrt() * span;
        }
    }
    radius += (seconds - around_rest.max(first)).max(0.0);
    // The back first goes forward, then backward, so it is farthest back at one of the two ends; the front never turns.
    ((centre - radius).min(0.0) * speed_max, (centre + radius) * speed_max)
}

/// Steps in which the ball passes from the present velocity to rest. Each is rounded outward to its end.
const LENS_STEPS: u32 = 16;
