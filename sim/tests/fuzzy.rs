//! A fuzzy bound keeps its probability for people who really walked: learned from every other person, tried on the rest.
//! `EYELINE_DATA`, else `shared/data` beside the workspace.

use std::path::{Path, PathBuf};
use std::time::Duration;

use eyeline_client::tracking::{FuzzySpeeds, MotionLimits, MotionState, broken};
use eyeline_protocol::WorldTime;
use eyeline_sim::trace::Trace;
use glam::DVec3;

type Samples = Vec<(WorldTime, DVec3)>;

/// The people of every recording, or none if the data is not there.
fn people() -> Vec<Samples> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let data = std::env::var_os("EYELINE_DATA").map_or(root.join("../shared/data"), PathBuf::from).join("motion");
    let mut people = Vec::new();
    for name in ["students03_obsmat.txt", "zara01_obsmat.txt", "juelich_uo-180-180-070.txt"] {
        if !data.join(name).exists() {
            eprintln!("skipped: no {name} in {} (set EYELINE_DATA)", data.display());
            continue;
        }
        let trace = Trace::read(&data.join(name)).unwrap();
        people.extend(trace.people.iter().map(|track| -> Samples {
            let sample = |sample: &eyeline_sim::trace::Sample| {
                let at = WorldTime::from_micros((sample.time_s * 1e6).round() as i64);
                (at, DVec3::new(sample.position.x, 0.0, sample.position.y))
            };
            track.samples().iter().map(sample).collect()
        }));
    }
    people
}

/// Where a person is: on the straight line between two samples.
fn position(samples: &Samples, at: WorldTime) -> DVec3 {
    let after = samples.partition_point(|sample| sample.0 <= at);
    let (before, from) = samples[after - 1];
    let Some(&(next, to)) = samples.get(after) else { return from };
    from.lerp(to, at.seconds_since(before) / next.seconds_since(before))
}

/// Bounds made at every sample that are broken, and all of them.
fn count_broken(speeds: &FuzzySpeeds, samples: &Samples, validity: Duration) -> (u32, u32) {
    let limits =
        MotionLimits { speed_max: 50.0, acceleration_max: f64::INFINITY, axis_speed_max: DVec3::INFINITY, reach: 0.3 };
    let (mut broken_count, mut count) = (0, 0);
    for (i, &(issued, at)) in samples.iter().enumerate() {
        let expires = issued + validity;
        if samples[samples.len() - 1].0 < expires {
            break;
        }
        let bound = speeds.bound(MotionState { position: at, velocity: DVec3::ZERO }, limits, issued, expires);
        let seen = samples[i..].iter().copied().take_while(|&(at, _)| at <= expires);
        let mut seen = seen.chain([(expires, position(samples, expires))]);
        count += 1;
        broken_count += u32::from(seen.any(|(at, position)| broken(&bound, position, at)));
    }
    (broken_count, count)
}

#[test]
fn one_bound_in_a_hundred_is_broken_by_people_who_really_walked() {
    let people = people();
    if people.is_empty() {
        return;
    }
    for first in [0, 1] {
        let learned = people.iter().skip(first).step_by(2).map(Vec::as_slice);
        let shortest = Duration::from_millis(100);
        let speeds = FuzzySpeeds::calibrate(learned, 0.01, shortest, Duration::from_secs(10)).unwrap();
        let (mut all_broken, mut all) = (0, 0);
        for millis in [100, 400, 1000, 1600, 2500, 4000, 6300] {
            let validity = Duration::from_millis(millis);
            let counts = people.iter().skip(1 - first).step_by(2).map(|track| count_broken(&speeds, track, validity));
            let (broken, count) = counts.fold((0, 0), |sum, (broken, count)| (sum.0 + broken, sum.1 + count));
            let travel = speeds.travel(validity.as_secs_f64()).unwrap_or(f64::NAN);
            println!(
                "{millis} ms, {travel:.3} m: {broken} of {count} broken, {:.2} %",
                100.0 * f64::from(broken) / f64::from(count)
            );
            all_broken += broken;
            all += count;
        }
        let share = f64::from(all_broken) / f64::from(all);
        println!("in all {all_broken} of {all}: {:.2} %", share * 100.0);
        assert!(all >= 10_000 && (0.005..=0.015).contains(&share), "{all_broken} of {all}");
    }
}
