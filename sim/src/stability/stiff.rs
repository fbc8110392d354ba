//! Springs and dampers whose time constants range from a microsecond to twenty minutes, at ticks of a millisecond to a second.

use eyeline_protocol::{WorldInfo, WorldTime};
use eyeline_server::policy::Visible;
use eyeline_server::spec::{ClassSpec, ObjectSpec, PathSpec, SpringSpec, WallSpec, WorldSpec};
use eyeline_server::spring::{Motion, Spring};
use eyeline_server::world::{World, WorldConfig};
use glam::DVec3;

use super::integrators::{Method, Problem, Target};
use super::{Case, Finding, Oracle};

/// Damping ratios: undamped, swinging, critical, slow, very slow.
const DAMPINGS: [f64; 5] = [0.0, 0.05, 1.0, 3.0, 1e3];

/// All cases.
pub fn cases() -> Vec<Case> {
    let mut cases = Vec::new();
    for decade in -6..=3 {
        let time_constant = 10_f64.powi(decade);
        for step_s in [1e-3, 0.05, 1.0] {
            let name = format!("undriven, time constant 1e{decade} s, step {step_s} s");
            let asked = "distance from the solution, over the first amplitude";
            cases.push(Case::new("stiff", name, asked, Oracle::Analytic, move || undriven(time_constant, step_s)));
        }
        let name = format!("driven, time constant 1e{decade} s, step 0.05 s");
        let asked = "metres from the same at a hundredth of the step";
        cases.push(Case::new("stiff", name, asked, Oracle::Reference, move || driven(time_constant, 0.05)));
    }
    for (damping, restitution) in [(0.0, 1.0), (0.0, 0.5), (0.2, 0.9), (0.2, 0.0)] {
        let name = format!("bouncing on a wall, damping {damping}, restitution {restitution}");
        let asked = "metres from the solution, event by event";
        cases.push(Case::new("stiff", name, asked, Oracle::Analytic, move || bounces(damping, restitution)));
    }
    let asked = "greatest growth of energy, over the first";
    cases.push(Case::new("stiff", "energy, undriven", asked, Oracle::Exact, || energy(None)));
    cases.push(Case::new("stiff", "energy, undriven, against a wall", asked, Oracle::Exact, || energy(Some(0.7))));
    for time_constant in [1e-6, 1e-2, 1.0] {
        let name = format!("bounds contain a sprung cart, time constant {time_constant} s");
        let asked = "metres beyond what its class promised, over all spans of ticks";
        cases.push(Case::new("stiff", name, asked, Oracle::Exact, move || contained(time_constant)));
    }
    for (field, value) in [("time_constant", 0.0), ("time_constant", f64::NAN), ("damping", -1.0)] {
        let asked = "a refusal that names the field";
        cases.push(Case::new("stiff", format!("{field} = {value}"), asked, Oracle::Refusal, move || {
            let mut spec = SpringSpec { time_constant: 1.0, damping: 1.0, wall: None };
            *(if field == "damping" { &mut spec.damping } else { &mut spec.time_constant }) = value;
            Finding::refusal(Spring::new(&spec), &[field, "give"])
        }));
    }
    cases
}

/// The free swing by its formula from time 0, in one go.
///
/// With damping above 1 by its two decays, of which the slow one is 1/(fast) · ω²: no formula of the server's is used.
fn solution(problem: &Problem, time_s: f64) -> f64 {
    let omega = problem.time_constant.recip();
    let (zeta, y, v) = (problem.damping, problem.place, problem.speed);
    if zeta < 1.0 {
        let swing = omega * (1.0 - zeta * zeta).sqrt();
        let b = (v + zeta * omega * y) / swing;
        (-zeta * omega * time_s).exp() * (y * (swing * time_s).cos() + b * (swing * time_s).sin())
    } else if zeta == 1.0 {
        (y + (v + omega * y) * time_s) * (-omega * time_s).exp()
    } else {
        let fast = omega * (zeta + (zeta * zeta - 1.0).sqrt());
        let slow = omega * omega / fast;
        let of_slow = (v + fast * y) / (fast - slow);
        of_slow * (-slow * time_s).exp() + (y - of_slow) * (-fast * time_s).exp()
    }
}

fn undriven(time_constant: f64, step_s: f64) -> Finding {
    const STEPS: usize = 200;
    let mut worst = 0.0_f64;
    let mut share = 0.0_f64;
    for damping in DAMPINGS {
        // As much in speed as in place.
        let problem = Problem { time_constant, damping, target: Target::STILL, place: 0.8, speed: 0.6 / time_constant };
        problem.run(Method::Exact, step_s, STEPS, |time_s, x, _| {
            let error = (x - solution(&problem, time_s)).abs();
            let error = if error.is_nan() { f64::INFINITY } else { error };
            // A swing of many radians cannot be known better than its angle: an ulp of it a step, and the formula's own.
            let swing = if damping < 1.0 { time_s / time_constant } else { 0.0 };
            let left = (-damping * time_s / time_constant).exp().max(if damping < 1.0 { 0.0 } else { 1.0 });
            let may = 1e-12 + STEPS as f64 * f64::EPSILON * swing * left;
            worst = worst.max(error);
            share = share.max(error / may);
        });
    }
    Finding::new(share, 1.0, format!("in units of 1e-12 and 200 ulp of the angle swung; {worst:.1e} of the amplitude"))
}

fn driven(time_constant: f64, step_s: f64) -> Finding {
    let target = Target { amplitude: 1.0, rate: std::f64::consts::FRAC_PI_2 };
    // The target is off its chord by at most |p″|·step²/8; what that drives is at most ∫|2ζω·h′ + ω²·h| times as much,
    // with h the answer to a kick: 1.28 for critical damping.
    let bound = 1.28 * target.amplitude * target.rate * target.rate * step_s * step_s / 8.0;
    let problem = Problem { time_constant, damping: 1.0, target, place: 0.0, speed: target.speed(0.0) };
    let error = problem.error(Method::Exact, step_s, 200);
    Finding::new(error, bound, "critical damping, a swing of 1 m in 4 s; the bound is the chord's")
}

/// From rest at 1 m from a wall that the path lies in: a bounce every half swing, each with its share of the speed.
fn bounces(damping: f64, restitution: f64) -> Finding {
    let omega: f64 = 2.0;
    let wall = WallSpec { point: [0.0; 3], normal: [1.0, 0.0, 0.0], restitution };
    let spring = Spring::new(&SpringSpec { time_constant: omega.recip(), damping, wall: Some(wall) });
    let spring = spring.expect("a legal spring");
    let swing = omega * (1.0 - damping * damping).sqrt();
    let fall = damping * omega;
    // The first time at the wall, where cos + (fall/swing)·sin = 0, and the speed then.
    let first_s = (std::f64::consts::PI - (swing / fall).atan()) / swing;
    let half_s = std::f64::consts::PI / swing;
    let free = Problem { time_constant: omega.recip(), damping, target: Target::STILL, place: 1.0, speed: 0.0 };
    // y′ = −e^(−st)·(ω²/w)·sin wt from rest at 1.
    let hit = (-fall * first_s).exp() * (omega * omega / swing) * (swing * first_s).sin();
    let truth = |time_s: f64| {
        if time_s <= first_s {
            return solution(&free, time_s);
        }
        let bounce = ((time_s - first_s) / half_s).floor();
        let since = time_s - first_s - bounce * half_s;
        let speed = hit * restitution * (restitution * (-fall * half_s).exp()).powf(bounce);
        (-fall * since).exp() * speed / swing * (swing * since).sin()
    };
    let mut worst = 0.0_f64;
    for step_s in [1e-3, 0.05, 1.0] {
        let mut motion = Motion { position: DVec3::X, velocity: DVec3::ZERO };
        for step in 0..(8.0 / step_s) as usize {
            motion = spring.step(motion, DVec3::ZERO, DVec3::ZERO, step_s);
            worst = worst.max((motion.position.x - truth((step + 1) as f64 * step_s)).abs());
        }
    }
    Finding::new(worst, 1e-9, "steps of 0.001, 0.05 and 1 s, five bounces")
}

fn energy(restitution: Option<f64>) -> Finding {
    let wall = restitution.map(|restitution| WallSpec { point: [0.2, 0.0, 0.0], normal: [1.0, 0.0, 0.0], restitution });
    let mut worst = 0.0_f64;
    for decade in -6..=3 {
        for damping in DAMPINGS {
            for step_s in [1e-3, 0.03, 1.0] {
                let time_constant = 10_f64.powi(decade);
                let spring = Spring::new(&SpringSpec { time_constant, damping, wall: wall.clone() });
                let spring = spring.expect("a legal spring");
                let speed = DVec3::new(-0.6, 0.3, 0.1) / time_constant;
                let mut motion = Motion { position: DVec3::new(0.8, 0.1, -0.3), velocity: speed };
                let first = spring.energy(motion, DVec3::ZERO);
                let mut least = first;
                for _ in 0..1000 {
                    motion = spring.step(motion, DVec3::ZERO, DVec3::ZERO, step_s);
                    let now = spring.energy(motion, DVec3::ZERO);
                    let growth = (now - least) / first;
                    worst = if growth.is_nan() { f64::INFINITY } else { worst.max(growth) };
                    least = least.min(now);
                }
            }
        }
    }
    Finding::new(worst, 1e-12, "10 time constants, 5 dampings, 3 steps, 1,000 steps each, against the least before")
}

/// A cart on a path with corners, in a world of its own: between any two ticks it moves no farther than its class says.
fn contained(time_constant: f64) -> Finding {
    let class = ClassSpec { name: "cart".into(), radius: 0.4, bottom: 0.0, top: 1.0, speed_max: 1.5 };
    let wall = WallSpec { point: [4.0, 0.0, 0.0], normal: [-1.0, 0.0, 0.0], restitution: 0.8 };
    let path = PathSpec {
        points: vec![[0.0, 0.0, 0.0], [5.0, 0.0, 0.0], [5.0, 0.0, 3.0]],
        speed: 1.0,
        pause: 0.3,
        phase: 0.0,
        wobble: 0.0,
        wobble_per_metre: 0.0,
        spring: Some(SpringSpec { time_constant, damping: 0.05, wall: Some(wall) }),
    };
    let object = ObjectSpec {
        name: "cart".into(),
        class: "cart".into(),
        node: None,
        position: [0.0; 3],
        heading: 0.0,
        takeable: false,
        path: Some(path),
    };
    let spec = WorldSpec { classes: vec![class], objects: vec![object], ..WorldSpec::default() };
    let info = WorldInfo { name: "springs".into(), hash: [0; 32], size_bytes: 0, two_sided: false };
    let config = WorldConfig::default();
    let made = World::new(config, spec, info, DVec3::ZERO, Box::new(Visible), WorldTime::ZERO);
    let mut world = match made {
        Ok(world) => world,
        Err(error) => return Finding::new(f64::INFINITY, 0.0, error.to_string()),
    };
    let motion = world.classes()[1].motion;
    let mut places = Vec::new();
    for _ in 0..800 {
        let now = world.poll_timeout();
        world.tick(now);
        places.push((now.seconds(), world.objects()[0].position.metres()));
    }
    let mut beyond = 0.0_f64;
    let mut travelled = 0.0_f64;
    for (i, (from_s, from)) in places.iter().enumerate() {
        for (to_s, to) in &places[i + 1..] {
            beyond = beyond.max(from.distance(*to) - motion.reach(to_s - from_s));
            travelled = travelled.max(from.distance(*to));
        }
    }
    if travelled < 1.0 {
        return Finding::new(f64::INFINITY, 0.0, format!("it moved {travelled} m only, so nothing was tried"));
    }
    Finding::new(beyond.max(0.0), 0.0, format!("damping 0.05, a wall, 800 ticks; it came {travelled:.2} m far"))
}
