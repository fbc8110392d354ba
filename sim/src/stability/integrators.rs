//! A spring, a damper and a path, stepped by the production integrator and by the textbook's.
//!
//! One thing on a line hangs on a target that swings: x″ = −ω²(x − p) − 2ζω(x′ − p′). [`Method::Exact`] is what the server
//! runs ([`eyeline_server::spring`]); the others stand beside it for the plot of error against run time. All see the
//! target only through its places at the ends of steps and its true place and speed within them where a method asks.

use std::hint::black_box;

use eyeline_server::spec::SpringSpec;
use eyeline_server::spring::{Motion, Spring};
use glam::DVec3;
use serde::Serialize;

/// A way to step.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Method {
    /// The free solution of each step, the target walking evenly: the server's.
    Exact,
    /// Explicit Euler: stable only for ω·step < 2ζ.
    ExplicitEuler,
    /// Speed first, then place with the new speed: stable for ω·step < 2 without damping.
    SemiImplicitEuler,
    /// The classical Runge–Kutta method of order 4: stable for ω·step < 2.8.
    Rk4,
}

impl Method {
    /// All, the server's first.
    pub const ALL: [Method; 4] = [Method::Exact, Method::ExplicitEuler, Method::SemiImplicitEuler, Method::Rk4];

    /// Its name in the report.
    pub fn name(self) -> &'static str {
        match self {
            Method::Exact => "exact (ours)",
            Method::ExplicitEuler => "explicit Euler",
            Method::SemiImplicitEuler => "semi-implicit Euler",
            Method::Rk4 => "RK4",
        }
    }
}

/// A target that swings along a line: amplitude · sin(rate · t), in metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Target {
    /// Metres; 0 is a target at rest.
    pub amplitude: f64,
    /// Radians a second.
    pub rate: f64,
}

impl Target {
    /// At rest at 0.
    pub const STILL: Target = Target { amplitude: 0.0, rate: 0.0 };

    /// Where it is.
    pub fn place(self, time_s: f64) -> f64 {
        self.amplitude * (self.rate * time_s).sin()
    }

    /// How it moves.
    pub fn speed(self, time_s: f64) -> f64 {
        self.amplitude * self.rate * (self.rate * time_s).cos()
    }
}

/// A thing on a spring.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Problem {
    /// 1/ω, seconds.
    pub time_constant: f64,
    /// ζ.
    pub damping: f64,
    /// What it hangs on.
    pub target: Target,
    /// Where it starts, metres.
    pub place: f64,
    /// How it starts, metres a second.
    pub speed: f64,
}

impl Problem {
    /// The server's spring for it.
    pub fn spring(&self) -> Spring {
        let spec = SpringSpec { time_constant: self.time_constant, damping: self.damping, wall: None };
        Spring::new(&spec).expect("a problem has a spring within the legal range")
    }

    /// Calls `seen` with time, place and speed after each of `steps` steps of `step_s`.
    pub fn run(&self, method: Method, step_s: f64, steps: usize, mut seen: impl FnMut(f64, f64, f64)) {
        let spring = self.spring();
        let (mut x, mut v) = (self.place, self.speed);
        let omega = self.time_constant.recip();
        let pull = |time_s: f64, x: f64, v: f64| {
            let y = x - self.target.place(time_s);
            let w = v - self.target.speed(time_s);
            -omega * (omega * y) - 2.0 * self.damping * omega * w
        };
        for step in 0..steps {
            let (from_s, to_s) = (step as f64 * step_s, (step + 1) as f64 * step_s);
            match method {
                Method::Exact => {
                    let at = |time_s| DVec3::X * self.target.place(time_s);
                    let motion = Motion { position: DVec3::X * x, velocity: DVec3::X * v };
                    let motion = spring.step(motion, at(from_s), at(to_s), step_s);
                    (x, v) = (motion.position.x, motion.velocity.x);
                }
                Method::ExplicitEuler => {
                    let a = pull(from_s, x, v);
                    (x, v) = (x + v * step_s, v + a * step_s);
                }
                Method::SemiImplicitEuler => {
                    v += pull(from_s, x, v) * step_s;
                    x += v * step_s;
                }
                Method::Rk4 => {
                    let half = 0.5 * step_s;
                    let k1 = (v, pull(from_s, x, v));
                    let k2 = (v + half * k1.1, pull(from_s + half, x + half * k1.0, v + half * k1.1));
                    let k3 = (v + half * k2.1, pull(from_s + half, x + half * k2.0, v + half * k2.1));
                    let k4 = (v + step_s * k3.1, pull(to_s, x + step_s * k3.0, v + step_s * k3.1));
                    x += step_s / 6.0 * (k1.0 + 2.0 * k2.0 + 2.0 * k3.0 + k4.0);
                    v += step_s / 6.0 * (k1.1 + 2.0 * k2.1 + 2.0 * k3.1 + k4.1);
                }
            }
            seen(to_s, x, v);
        }
        black_box((x, v));
    }

    /// The greatest distance from the reference at the ends of steps: RK4 at a hundredth of the step where that is well
    /// within its stability, so that no code is shared; else the server's integrator at a hundredth. Infinite where a method
    /// blows up.
    pub fn error(&self, method: Method, step_s: f64, steps: usize) -> f64 {
        const FINER: usize = 100;
        let mut truth = Vec::with_capacity(steps);
        let mut count = 0;
        let fine_s = step_s / FINER as f64;
        let reference = if fine_s < 0.2 * self.time_constant { Method::Rk4 } else { Method::Exact };
        self.run(reference, fine_s, steps * FINER, |_, x, _| {
            count += 1;
            if count % FINER == 0 {
                truth.push(x);
            }
        });
        self.error_against(method, step_s, &truth)
    }

    /// The greatest distance from `truth`, one place a step.
    pub fn error_against(&self, method: Method, step_s: f64, truth: &[f64]) -> f64 {
        let (mut worst, mut step) = (0.0_f64, 0);
        self.run(method, step_s, truth.len(), |_, x, _| {
            let apart = (x - truth[step]).abs();
            worst = if apart.is_nan() { f64::INFINITY } else { worst.max(apart) };
            step += 1;
        });
        worst
    }
}

/// A point of the comparison.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct IntegratorRow {
    /// How it was stepped.
    pub integrator: &'static str,
    /// 1/ω.
    pub time_constant_s: f64,
    /// The step.
    pub step_s: f64,
    /// Greatest distance from the reference at the ends of steps, over the amplitude of the target; none if it blew up.
    pub error: Option<f64>,
    /// Time for ten seconds of motion.
    pub run_ms: f64,
    /// Whether it stayed within a thousand amplitudes.
    pub bounded: bool,
}

/// Seconds of motion that a point of the comparison steps through.
pub const SPAN_S: f64 = 10.0;

/// Time constants of the comparison, in seconds.
pub const TIME_CONSTANTS: [f64; 6] = [1e-6, 1e-4, 1e-2, 1e-1, 1.0, 1e3];

/// Steps of the comparison, in seconds.
pub const STEPS: [f64; 7] = [1e-3, 2e-3, 5e-3, 1e-2, 5e-2, 0.2, 1.0];

/// The problem of the comparison: critically damped on a target that swings by a metre in 4 s, as a chair to a table.
pub fn compared(time_constant: f64) -> Problem {
    let target = Target { amplitude: 1.0, rate: std::f64::consts::FRAC_PI_2 };
    Problem { time_constant, damping: 1.0, target, place: 0.0, speed: target.speed(0.0) }
}

/// How far from the reference one method comes with one step; `clock_s` tells the time, for `run_ms` alone.
pub fn compare(method: Method, time_constant: f64, step_s: f64, clock_s: impl Fn() -> f64) -> IntegratorRow {
    let problem = compared(time_constant);
    let steps = (SPAN_S / step_s).round() as usize;
    let error = problem.error(method, step_s, steps);
    // The least of several runs: noise only adds.
    let mut run_ms = f64::INFINITY;
    for _ in 0..5 {
        let began = clock_s();
        problem.run(method, step_s, steps, |_, x, _| {
            black_box(x);
        });
        run_ms = run_ms.min((clock_s() - began) * 1e3);
    }
    let bounded = error < 1e3;
    let error = bounded.then_some(error);
    IntegratorRow { integrator: method.name(), time_constant_s: time_constant, step_s, error, run_ms, bounded }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_method_has_its_order_where_it_is_stable() {
        // Soft against the step, so that all are stable: halving the step divides the error by 2^order.
        let problem = compared(0.5);
        for (method, order) in
            [(Method::Exact, 2), (Method::ExplicitEuler, 1), (Method::SemiImplicitEuler, 1), (Method::Rk4, 4)]
        {
            let error = |step_s: f64| problem.error(method, step_s, (4.0 / step_s) as usize);
            let ratio = error(0.02) / error(0.01);
            let wanted = f64::from(1 << order);
            assert!((ratio / wanted - 1.0).abs() < 0.2, "{}: {ratio}, not {wanted}", method.name());
        }
    }

    #[test]
    fn only_ours_survives_stiffness() {
        for method in Method::ALL {
            let row = compare(method, 1e-4, 1e-2, || 0.0);
            assert_eq!(row.bounded, method == Method::Exact, "{}", method.name());
        }
    }
}
