//! How does a thing move that hangs on its path by a spring and a damper?
//!
//! A cart does not jump to where its path says; it is drawn there. With y = x − p, its place relative to the path's,
//! the motion is y″ + 2ζω·y′ + ω²·y = −p″. Within a step the path is taken as straight and evenly walked (p″ = 0), so y
//! follows the free equation, whose solution is known: one step is that solution, whatever its length. So the
//! integrator is **exact for the linear part and unconditionally stable**: a time constant of a microsecond is as safe
//! at steps of a second as one of an hour. What is left is an error of second order in the path's own curvature, which
//! does not grow with stiffness. Explicit methods blow up as soon as ω·step passes about 2; `eyeline-sim stability` shows
//! both.
//!
//! **A wall** is a half-space that the thing's reference point does not enter. The free solution says when it would:
//! that moment is found by bisection, the speed into the wall turns round (times the restitution, at most 1), and the
//! rest of the step goes on from there. What bounces more than [`BOUNCES_MAX`] times in a step, as a ball that comes to
//! rest does without end, lies on the wall from then on, until the spring draws it away.
//!
//! **Energy.** ½|y′|² + ½ω²|y|² never grows while the path stands still: the free solution loses it, and so does a bounce
//! from a wall. What is left is rounding: of the speed, and of the place, which is kept in the world and not beside its path.

use glam::DVec3;

use crate::spec::{SpringSpec, WallSpec};

/// Most bounces in one step. Eight turn a bounce of restitution 0.5 into 0.4 % of its speed.
pub const BOUNCES_MAX: usize = 8;

/// Looks a step for a wall that is reached and left again within it. A swing of ω·step ≤ π/8 a look cannot hide half of
/// itself between two; faster swings are looked at as often as this, which only a spring without damping can outdo.
const LOOKS_MAX: usize = 256;

/// Halvings on the way to the moment of a bounce: a step of a second to 10⁻¹⁵ s.
const HALVINGS: usize = 50;

/// A spring and a damper between a thing and its path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spring {
    /// ω = 1 / time constant, in 1/s.
    omega: f64,
    /// ζ: 1 comes to rest soonest without a swing, less swings, 0 swings for ever.
    damping: f64,
    wall: Option<Wall>,
}

/// A half-space that is not entered: normal · x ≥ offset.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wall {
    /// Unit vector that points away from the wall's inside.
    pub normal: DVec3,
    /// normal · any point of its face, in metres.
    pub offset: f64,
    /// Speed after a bounce over speed before it, 0 to 1.
    pub restitution: f64,
}

/// Where a thing is, and how it moves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    /// Metres.
    pub position: DVec3,
    /// Metres a second.
    pub velocity: DVec3,
}

/// Why a spring cannot be used: the field, what the file says, and what would be right.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{field} = {value}; {remedy}")]
pub struct SpringError {
    /// Field of [`SpringSpec`] or [`WallSpec`].
    pub field: &'static str,
    /// What the file says.
    pub value: f64,
    /// What would be right.
    pub remedy: &'static str,
}

/// What a free swing does in a given time: y and y′ after it are linear in y and y′ before it.
#[derive(Clone, Copy, Debug)]
struct Flow {
    place_of_place: f64,
    place_of_speed: f64,
    speed_of_place: f64,
    speed_of_speed: f64,
}

impl Spring {
    /// A spring as `world.toml` describes it.
    pub fn new(spec: &SpringSpec) -> Result<Spring, SpringError> {
        let bad = |field, value, remedy| Err(SpringError { field, value, remedy });
        let omega = spec.time_constant.recip();
        if !(spec.time_constant > 0.0 && (1e-9..=1e9).contains(&omega)) {
            return bad("time_constant", spec.time_constant, "give seconds from 1e-9 to 1e9, or leave `spring` out");
        }
        if !(0.0..=1e6).contains(&spec.damping) {
            return bad("damping", spec.damping, "give a damping ratio from 0 to 1e6; 1 comes to rest soonest");
        }
        let wall = spec.wall.as_ref().map(Wall::new).transpose()?;
        Ok(Spring { omega, damping: spec.damping, wall })
    }

    /// The wall that it stops at, if there is one.
    pub fn wall(&self) -> Option<Wall> {
        self.wall
    }

    /// Moves on for `step_s` seconds while the path goes evenly from `from` to `to`, in metres.
    ///
    /// Anything that is not finite, or a step that is not above 0, leaves it where it is.
    pub fn step(&self, motion: Motion, from: DVec3, to: DVec3, step_s: f64) -> Motion {
        let is_usable = step_s > 0.0 && step_s.is_finite() && from.is_finite() && to.is_finite();
        let drive = (to - from) / step_s;
        if !(is_usable && drive.is_finite() && motion.position.is_finite() && motion.velocity.is_finite()) {
            return motion;
        }
        let Some(wall) = self.wall else { return self.free(motion, from, drive, step_s) };
        let mut now = wall.out_of(motion);
        let (mut at, mut left_s) = (from, step_s);
        for _ in 0..BOUNCES_MAX {
            // Lying on the wall and drawn into it: there it stays until the path draws it away.
            if wall.touches(now) {
                let lies_s = self.lies_for(wall, at, drive, left_s);
                if lies_s > 0.0 {
                    now = wall.along(self.free(now, at, drive, lies_s));
                    at += drive * lies_s;
                    left_s -= lies_s;
                }
            }
            if left_s <= 0.0 {
                return now;
            }
            let Some(hit_s) = self.hit(now, wall, at, drive, left_s) else {
                return wall.out_of(self.free(now, at, drive, left_s));
            };
            now = wall.bounced(self.free(now, at, drive, hit_s));
            at += drive * hit_s;
            left_s -= hit_s;
        }
        wall.along(self.free(now, at, drive, left_s))
    }

    /// ½|v|² + ½ω²|x − p|², per kilogram: what does not grow while the path stands at `path`.
    pub fn energy(&self, motion: Motion, path: DVec3) -> f64 {
        0.5 * motion.velocity.length_squared() + 0.5 * (self.omega * (motion.position - path)).length_squared()
    }

    /// The motion after `elapsed_s` with no wall: the solution itself.
    fn free(&self, motion: Motion, from: DVec3, drive: DVec3, elapsed_s: f64) -> Motion {
        let flow = self.flow(elapsed_s);
        let (place, speed) = (motion.position - from, motion.velocity - drive);
        Motion {
            position: from + drive * elapsed_s + place * flow.place_of_place + speed * flow.place_of_speed,
            velocity: drive + place * flow.speed_of_place + speed * flow.speed_of_speed,
        }
    }

    /// The free swing's map over `elapsed_s`.
    ///
    /// With s = ζω and w = ω·√|1 − ζ²| it is e^(−st)·(cos wt ± s·sin(wt)/w) and so on, or the hyperbolic functions. Each
    /// branch avoids what the others would lose: e^(−st)·cosh(wt) overflows, and a great ζ loses the slow root −s + w.
    fn flow(&self, elapsed_s: f64) -> Flow {
        let (omega, zeta) = (self.omega, self.damping);
        let fall = zeta * omega;
        let swing = omega * ((1.0 - zeta).abs() * (1.0 + zeta)).sqrt();
        if zeta > 2.0 {
            // Two roots, of which the slow one is ω²/(s + w).
            let fast = fall + swing;
            let slow = omega * (omega / fast);
            let (slow_left, fast_left) = ((-slow * elapsed_s).exp(), (-fast * elapsed_s).exp());
            let apart = 2.0 * swing;
            return Flow {
                place_of_place: (fast * slow_left - slow * fast_left) / apart,
                place_of_speed: (slow_left - fast_left) / apart,
                speed_of_place: -omega * (omega * ((slow_left - fast_left) / apart)),
                speed_of_speed: (fast * fast_left - slow * slow_left) / apart,
            };
        }
        // `even` is e^(−st)·cos wt, `odd` is e^(−st)·sin(wt)/w, or their hyperbolic kin.
        let (even, odd) = if zeta <= 1.0 {
            let left = (-fall * elapsed_s).exp();
            let angle = swing * elapsed_s;
            (left * angle.cos(), left * elapsed_s * sinc(angle))
        } else {
            let slow = omega * (omega / (fall + swing));
            let slow_left = (-slow * elapsed_s).exp();
            let apart = -2.0 * swing * elapsed_s;
            let share = if apart == 0.0 { 1.0 } else { apart.exp_m1() / apart };
            (slow_left * 0.5 * (1.0 + apart.exp()), slow_left * elapsed_s * share)
        };
        Flow {
            place_of_place: even + fall * odd,
            place_of_speed: odd,
            speed_of_place: -omega * (omega * odd),
            speed_of_speed: even - fall * odd,
        }
    }

    /// For how much of `left_s` the spring draws what lies on the wall into it. Its pull along the normal is linear in
    /// time, since the path is walked evenly.
    fn lies_for(&self, wall: Wall, path: DVec3, drive: DVec3, left_s: f64) -> f64 {
        let drift = wall.normal.dot(drive);
        // Pull over ω²: the path's distance from the wall, and the damper's share.
        let pull = wall.normal.dot(path) - wall.offset + 2.0 * self.damping / self.omega * drift;
        if pull > 0.0 {
            0.0
        } else if pull + drift * left_s <= 0.0 {
            left_s
        } else {
            (-pull / drift).clamp(0.0, left_s)
        }
    }

    /// When, within `left_s`, the free swing enters the wall, if it does.
    fn hit(&self, motion: Motion, wall: Wall, path: DVec3, drive: DVec3, left_s: f64) -> Option<f64> {
        let gap_at = |elapsed_s: f64| wall.gap(self.free(motion, path, drive, elapsed_s).position);
        // By its energy, which falls, it never comes farther from the path than this.
        let reach = (motion.position - path).length().hypot((motion.velocity - drive).length() / self.omega);
        let path_gap = wall.gap(path).min(wall.gap(path + drive * left_s));
        if path_gap > reach {
            return None;
        }
        let swings = self.omega * left_s / (std::f64::consts::PI / 8.0);
        let looks = if swings.is_finite() { (swings.ceil() as usize).clamp(8, LOOKS_MAX) } else { LOOKS_MAX };
        let mut before_s = 0.0;
        // What just bounced is on the face, give or take its rounding: it enters once it is farther in than that.
        let tolerance = wall.rounding(motion.position);
        for look in 1..=looks {
            let after_s = left_s * look as f64 / looks as f64;
            if gap_at(after_s) < -tolerance {
                return Some(first_inside(|elapsed_s| gap_at(elapsed_s) < -tolerance, before_s, after_s));
            }
            before_s = after_s;
        }
        None
    }
}

impl Wall {
    fn new(spec: &WallSpec) -> Result<Wall, SpringError> {
        let bad = |field, value, remedy| Err(SpringError { field, value, remedy });
        let (point, normal) = (DVec3::from(spec.point), DVec3::from(spec.normal));
        if let Some(&value) = spec.point.iter().find(|value| !value.is_finite()) {
            return bad("wall.point", value, "every coordinate must be a finite number of metres");
        }
        let Some(normal) = normal.try_normalize() else {
            return bad("wall.normal", spec.normal[0], "give a direction that is not zero, away from the wall");
        };
        if !(0.0..=1.0).contains(&spec.restitution) {
            return bad("wall.restitution", spec.restitution, "give the share of speed that a bounce keeps, 0 to 1");
        }
        Ok(Wall { normal, offset: normal.dot(point), restitution: spec.restitution })
    }

    /// Metres from the wall's face; below 0 inside.
    pub fn gap(&self, position: DVec3) -> f64 {
        self.normal.dot(position) - self.offset
    }

    /// What the coordinates' own rounding may put into the gap.
    pub fn rounding(&self, position: DVec3) -> f64 {
        8.0 * f64::EPSILON * (position.abs().max_element() + self.offset.abs()) + f64::MIN_POSITIVE
    }

    fn touches(&self, motion: Motion) -> bool {
        self.gap(motion.position) <= self.rounding(motion.position) && self.normal.dot(motion.velocity) <= 0.0
    }

    /// On the face where it was inside, and no longer on its way into it.
    fn out_of(&self, motion: Motion) -> Motion {
        if self.gap(motion.position) < 0.0 { self.along(motion) } else { motion }
    }

    /// On the face, moving along it only.
    fn along(&self, motion: Motion) -> Motion {
        Motion {
            position: motion.position - self.normal * self.gap(motion.position),
            velocity: motion.velocity - self.normal * self.normal.dot(motion.velocity),
        }
    }

    /// On the face, the speed into it turned round.
    fn bounced(&self, motion: Motion) -> Motion {
        let into = self.normal.dot(motion.velocity).min(0.0);
        Motion {
            position: motion.position - self.normal * self.gap(motion.position),
            velocity: motion.velocity - self.normal * (into * (1.0 + self.restitution)),
        }
    }
}

/// Bisection: inside at `inside_s`, not yet at `outside_s`.
fn first_inside(is_inside: impl Fn(f64) -> bool, mut outside_s: f64, mut inside_s: f64) -> f64 {
    for _ in 0..HALVINGS {
        let middle_s = 0.5 * (outside_s + inside_s);
        if is_inside(middle_s) {
            inside_s = middle_s;
        } else {
            outside_s = middle_s;
        }
    }
    inside_s
}

/// sin(x)/x.
fn sinc(angle: f64) -> f64 {
    if angle.abs() < 1e-4 { 1.0 - angle * angle / 6.0 } else { angle.sin() / angle }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn spring(time_constant: f64, damping: f64) -> Spring {
        Spring::new(&SpringSpec { time_constant, damping, wall: None }).unwrap()
    }

    fn at_wall(time_constant: f64, damping: f64, restitution: f64) -> Spring {
        let wall = WallSpec { point: [0.0; 3], normal: [2.0, 0.0, 0.0], restitution };
        Spring::new(&SpringSpec { time_constant, damping, wall: Some(wall) }).unwrap()
    }

    fn moving(x: f64, speed: f64) -> Motion {
        Motion { position: DVec3::X * x, velocity: DVec3::X * speed }
    }

    #[test]
    fn swings_as_the_formulas_say() {
        let (y, v, t) = (0.7, -0.3, 1.3_f64);
        // Undamped: y·cos t + v·sin t. Critical: (y + (v + y)·t)·e^(−t).
        let undamped = spring(1.0, 0.0).step(moving(y, v), DVec3::ZERO, DVec3::ZERO, t);
        assert!((undamped.position.x - (y * t.cos() + v * t.sin())).abs() < 1e-15);
        let critical = spring(1.0, 1.0).step(moving(y, v), DVec3::ZERO, DVec3::ZERO, t);
        assert!((critical.position.x - (y + (v + y) * t) * (-t).exp()).abs() < 1e-15);
        // ζ = 13/5 has the roots −1/5 and −5.
        let slow = spring(1.0, 2.6).step(moving(y, v), DVec3::ZERO, DVec3::ZERO, t);
        let (a, b) = ((5.0 * y + v) / 4.8, -(0.2 * y + v) / 4.8);
        assert!((slow.position.x - (a * (-0.2 * t).exp() + b * (-5.0 * t).exp())).abs() < 1e-15);
    }

    #[test]
    fn the_branches_meet() {
        for t in [1e-3, 1.0, 40.0] {
            for (below, above) in [(1.0 - 1e-9, 1.0 + 1e-9), (2.0 - 1e-12, 2.0 + 1e-12)] {
                let from = |damping| spring(1.0, damping).step(moving(1.0, 2.0), DVec3::ZERO, DVec3::ZERO, t);
                let apart = from(below).position.distance(from(above).position);
                assert!(apart < 1e-8, "{apart} at {t} s between {below} and {above}");
            }
        }
    }

    #[test]
    fn follows_an_even_path_without_lag_and_a_stiff_one_at_once() {
        let mut motion = moving(0.0, 0.0);
        for tick in 0..100 {
            let x = |tick: i32| DVec3::X * (f64::from(tick) * 0.05);
            motion = spring(1e-6, 1.0).step(motion, x(tick), x(tick + 1), 0.05);
        }
        assert!((motion.position.x - 5.0).abs() < 1e-12, "{motion:?}");
        assert!((motion.velocity.x - 1.0).abs() < 1e-12, "{motion:?}");
    }

    #[test]
    fn bounces_when_it_gets_there() {
        // From 1 m, undamped, ω = 1, at rest at the wall: there after π/2 s at 1 m/s, off at 0.5, and back after π s more.
        let thing = at_wall(1.0, 0.0, 0.5);
        let first = thing.step(moving(1.0, 0.0), DVec3::ZERO, DVec3::ZERO, 2.0);
        let since = 2.0 - std::f64::consts::FRAC_PI_2;
        assert!((first.position.x - 0.5 * since.sin()).abs() < 1e-12, "{first:?}");
        assert!((first.velocity.x - 0.5 * since.cos()).abs() < 1e-12, "{first:?}");
    }

    #[test]
    fn lies_on_the_wall_until_it_is_drawn_away() {
        let thing = at_wall(0.1, 1.0, 0.0);
        let mut motion = moving(1.0, 0.0);
        // The path goes 1 m into the wall, rests there for a second, and comes out again.
        let path = |tick: i32| DVec3::X * f64::from((tick - 20).abs().clamp(10, 20) - 20) * 0.2 + DVec3::X;
        for tick in 0..20 {
            motion = thing.step(motion, path(tick), path(tick + 1), 0.05);
            assert!(motion.position.x >= -1e-12, "{motion:?} in tick {tick}");
        }
        assert_eq!(motion.velocity.x, 0.0, "pressed against the wall: {motion:?}");
        for tick in 20..60 {
            motion = thing.step(motion, path(tick), path(tick + 1), 0.05);
        }
        assert!((motion.position.x - 1.0).abs() < 0.01, "{motion:?}");
    }

    #[test]
    fn what_is_wrong_is_named() {
        let message = |spec: SpringSpec| Spring::new(&spec).unwrap_err().to_string();
        let plain = SpringSpec { time_constant: 1.0, damping: 1.0, wall: None };
        for value in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e-300] {
            assert!(message(SpringSpec { time_constant: value, ..plain.clone() }).contains("time_constant = "));
        }
        assert!(message(SpringSpec { damping: -0.1, ..plain.clone() }).contains("damping = -0.1"));
        let wall = |point, normal, restitution| Some(WallSpec { point, normal, restitution });
        let with = |wall| message(SpringSpec { wall, ..plain.clone() });
        assert!(with(wall([f64::NAN, 0.0, 0.0], [1.0, 0.0, 0.0], 0.0)).contains("wall.point = NaN"));
        assert!(with(wall([0.0; 3], [0.0; 3], 0.0)).contains("wall.normal = 0"));
        assert!(with(wall([0.0; 3], [1.0, 0.0, 0.0], 1.1)).contains("restitution = 1.1"));
    }

    #[test]
    fn what_is_not_finite_moves_nothing() {
        let motion = moving(1.0, 2.0);
        for (from, to, step_s) in
            [(f64::NAN, 0.0, 1.0), (0.0, f64::INFINITY, 1.0), (0.0, 0.0, f64::NAN), (0.0, 0.0, 0.0), (0.0, 0.0, -1.0)]
        {
            assert_eq!(spring(1.0, 1.0).step(motion, DVec3::X * from, DVec3::X * to, step_s), motion);
        }
    }

    proptest! {
        #[test]
        fn energy_never_grows(
            constant in -6.0..3.0_f64,
            damping in prop_oneof![Just(0.0), Just(1.0), 0.0..3.0_f64, 10.0..1e6_f64],
            step in -3.0..0.0_f64,
            x in 0.0..10.0_f64,
            speed in -10.0..10.0_f64,
            restitution in 0.0..=1.0_f64,
            path in -1.0..1.0_f64,
            has_wall: bool,
        ) {
            let constant = 10_f64.powf(constant);
            let thing = if has_wall { at_wall(constant, damping, restitution) } else { spring(constant, damping) };
            let (path, step_s) = (DVec3::X * path, 10_f64.powf(step));
            let mut motion = moving(x, speed);
            let first = thing.energy(motion, path);
            let mut energy = first;
            for _ in 0..50 {
                motion = thing.step(motion, path, path, step_s);
                let now = thing.energy(motion, path);
                prop_assert!(now <= energy + 1e-12 * first, "{energy} J/kg, then {now}, of {first}");
                prop_assert!(!has_wall || motion.position.x >= -1e-14, "{} m inside", motion.position.x);
                energy = now;
            }
        }

        #[test]
        fn two_steps_are_one_of_both(
            constant in -3.0..3.0_f64,
            damping in 0.0..5.0_f64,
            share in 0.0..1.0_f64,
            x in -10.0..10.0_f64,
            speed in -10.0..10.0_f64,
            drive in -2.0..2.0_f64,
        ) {
            let thing = spring(10_f64.powf(constant), damping);
            let path = |s: f64| DVec3::X * (drive * s);
            let whole = thing.step(moving(x, speed), path(0.0), path(1.0), 1.0);
            let half = thing.step(moving(x, speed), path(0.0), path(share), share);
            let halves = thing.step(half, path(share), path(1.0), 1.0 - share);
            let scale = 10.0 + 10.0 * 10_f64.powf(constant);
            let error = whole.position.distance(halves.position);
            prop_assert!(error <= 1e-11 * scale, "{error} m");
        }
    }
}
