//! How far does an object get in a given time, nearly always?
//!
//! A hard limit may be unknown, or so loose that bounds made from it are of little use. Sudarsky & Gotsman 1999, §3.5: a *fuzzy*
//! bound holds with a stated probability, and whoever moves the object says so when it is broken ([`broken`]). The
//! probability is calibrated on observed motion: for a ladder of validity periods, each a quarter octave above the one
//! before, [`FuzzySpeeds`] keeps the distance that the stated share of objects exceeded *at some time* of the period. One
//! greatest speed "with probability 99 percent", the paper's example, would not do: who walks at 1.5 m/s for one second
//! seldom keeps to it for ten, so such a bound is much too large after ten seconds.

use std::sync::Arc;
use std::time::Duration;

use eyeline_protocol::WorldTime;
use eyeline_visibility::Bound;
use glam::DVec3;

use super::shape::{self, MotionLimits, MotionState, TemporalBound};

/// Distances that objects seldom exceed, learned from motion. Cheap to clone.
#[derive(Clone, Debug, PartialEq)]
pub struct FuzzySpeeds {
    probability: f64,
    /// By strictly rising period, distances not falling. Empty: never exceed anything but the hard limits.
    rungs: Arc<[Rung]>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Rung {
    seconds: f64,
    travel: f64,
}

/// Why nothing can be learned.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum FuzzyError {
    /// No probability.
    #[error("a bound broken with probability {0}; it must be from 0 to 1")]
    Probability(f64),
    /// No ladder.
    #[error("periods from {shortest:?} to {longest:?}; the shortest must be above 0, the longest not below it")]
    Periods {
        /// The shortest period.
        shortest: Duration,
        /// The longest period.
        longest: Duration,
    },
    /// A place or a time makes no sense.
    #[error("track {track}, sample {sample}: places must be finite and times rise strictly")]
    Sample {
        /// Index of the track.
        track: usize,
        /// Index of the sample in it.
        sample: usize,
    },
    /// So rare an event was not observed often enough.
    #[error("{windows} windows of {shortest:?} were observed, but at least {needed} are needed; record more motion")]
    TooFew {
        /// How many.
        windows: usize,
        /// The shortest period.
        shortest: Duration,
        /// How many would do.
        needed: usize,
    },
}

/// Ratio of a rung's period to that of the one before: 2^¼.
const RUNG_RATIO: f64 = 1.189_207_115_002_721;

/// Distance grows with time to a power from ½ (wandering about) to 1 (straight on). Over a quarter octave such a curve is at most
/// 0.1 % above its chord.
const ABOVE_CHORD: f64 = 1.001;

/// How often what is to be seldom must have been observed. Fewer, and chance moves the learned distance.
const BROKEN_MIN: f64 = 10.0;

impl FuzzySpeeds {
    /// Learns the distance that is exceeded with `probability` at some time of a validity period, for periods from `shortest`
    /// to `longest`. A track holds one object's places (metres) by strictly rising time; between two samples it is on
    /// the straight line. Every sample begins a window for every period that the track still covers, so long tracks count for
    /// more, as long-lived objects do. Tracks sampled less often than `shortest` make the first rungs too small.
    ///
    /// Probability 0 leaves the hard limits. With 1 every bound of something that moves is broken.
    ///
    /// # Errors
    /// If an argument makes no sense, or the tracks hold fewer than 10/`probability` windows of the `shortest` period.
    /// The ladder ends where that many windows do.
    pub fn calibrate<'a>(
        tracks: impl IntoIterator<Item = &'a [(WorldTime, DVec3)]>,
        probability: f64,
        shortest: Duration,
        longest: Duration,
    ) -> Result<FuzzySpeeds, FuzzyError> {
        if !(0.0..=1.0).contains(&probability) {
            return Err(FuzzyError::Probability(probability));
        }
        if shortest < Duration::from_micros(1) || longest < shortest {
            return Err(FuzzyError::Periods { shortest, longest });
        }
        let periods = ladder(shortest.as_secs_f64(), longest.as_secs_f64());
        let mut observed: Vec<Vec<f64>> = vec![Vec::new(); periods.len()];
        for (track, samples) in tracks.into_iter().enumerate() {
            let is_bad = |sample: &usize| {
                let (at, position) = samples[*sample];
                !position.is_finite() || *sample > 0 && at <= samples[*sample - 1].0
            };
            if let Some(sample) = (0..samples.len()).find(is_bad) {
                return Err(FuzzyError::Sample { track, sample });
            }
            for first in 0..samples.len() {
                observe(&samples[first..], &periods, &mut observed);
            }
        }
        if probability == 0.0 {
            return Ok(FuzzySpeeds { probability, rungs: Arc::new([]) });
        }
        let needed = (BROKEN_MIN / probability).ceil() as usize;
        if observed[0].len() < needed {
            return Err(FuzzyError::TooFew { windows: observed[0].len(), shortest, needed });
        }
        let mut rungs: Vec<Rung> = Vec::new();
        for (&seconds, distances) in periods.iter().zip(&mut observed) {
            if distances.len() < needed {
                break;
            }
            // Those who were observed for longer need not be those who go far.
            let least = rungs.last().map_or(0.0, |rung| rung.travel);
            rungs.push(Rung { seconds, travel: exceeded(distances, probability).max(least) });
        }
        Ok(FuzzySpeeds { probability, rungs: rungs.into() })
    }

    /// How often a bound is to be broken.
    pub fn probability(&self) -> f64 {
        self.probability
    }

    /// The longest period that something was learned about.
    pub fn longest(&self) -> Option<Duration> {
        self.rungs.last().map(|rung| Duration::from_secs_f64(rung.seconds))
    }

    /// Whether nothing was learned, so that bounds are the hard ones.
    pub fn is_empty(&self) -> bool {
        self.rungs.is_empty()
    }

    /// Metres that are exceeded within `seconds` with the stated probability. Between rungs on their chord, raised by what
    /// such a curve may be above it; below the first that one's. `None` beyond the last: then only a hard limit holds.
    pub fn travel(&self, seconds: f64) -> Option<f64> {
        let above = self.rungs.partition_point(|rung| rung.seconds < seconds);
        let next = self.rungs.get(above).filter(|_| !seconds.is_nan())?;
        if above == 0 || next.seconds == seconds {
            return Some(next.travel);
        }
        let below = self.rungs[above - 1];
        let share = (seconds - below.seconds) / (next.seconds - below.seconds);
        let chord = below.travel + share * (next.travel - below.travel);
        Some((chord * ABOVE_CHORD).min(next.travel))
    }

    /// A fuzzy bound: the learned distance about the place at `issued`, but never larger than the sphere from `limits.speed_max`. That
    /// limit may be infinite, that is, unknown; then beyond [`FuzzySpeeds::longest`] the object may be everywhere.
    ///
    /// It is broken with the stated probability if its volume is taken until `expires`; until an earlier time it is
    /// smaller, as if it expired then. Bad input is treated as by [`TemporalBound::new`].
    pub fn bound(
        &self,
        state: MotionState,
        limits: MotionLimits,
        issued: WorldTime,
        expires: WorldTime,
    ) -> TemporalBound {
        TemporalBound::fuzzy(self.clone(), state, limits, issued, expires)
    }
}

/// Whether an object at `position` at a time `at` shows that its bound is broken: for whoever moves the object. A fuzzy bound speaks of
/// its whole validity period, any other of `at`. Before it was issued and after it expired it promises nothing. A place
/// that is not finite is in no bound.
pub fn broken(bound: &TemporalBound, position: DVec3, at: WorldTime) -> bool {
    if at < bound.issued() || at > bound.expires() {
        return false;
    }
    let until = if bound.is_fuzzy() { bound.expires() } else { at };
    let mut pieces: Vec<Bound> = Vec::new();
    bound.of_point().volume(until, &mut pieces);
    !position.is_finite() || !pieces.iter().any(|piece| shape::contains(piece, position))
}

/// Periods in seconds, a quarter octave apart, both ends included.
fn ladder(shortest: f64, longest: f64) -> Vec<f64> {
    let mut periods = vec![shortest];
    loop {
        let next = shortest * RUNG_RATIO.powi(periods.len() as i32);
        if next >= longest {
            break;
        }
        periods.push(next);
    }
    if longest > shortest {
        periods.push(longest);
    }
    periods
}

/// Greatest distance from the first sample within each period that the samples cover.
fn observe(samples: &[(WorldTime, DVec3)], periods: &[f64], observed: &mut [Vec<f64>]) {
    let (start, origin) = samples[0];
    let mut farthest = 0.0f64;
    let mut next = 1;
    for (&seconds, observed) in periods.iter().zip(observed) {
        while let Some((_, position)) = samples.get(next).filter(|(at, _)| at.seconds_since(start) <= seconds) {
            farthest = farthest.max(origin.distance(*position));
            next += 1;
        }
        let (before, from) = samples[next - 1];
        let Some(&(after, to)) = samples.get(next) else {
            if before.seconds_since(start) < seconds {
                return;
            }
            observed.push(farthest);
            continue;
        };
        // On a straight line the distance is greatest at an end.
        let share = (seconds - before.seconds_since(start)) / after.seconds_since(before);
        observed.push(farthest.max(origin.distance(from.lerp(to, share))));
    }
}

/// The distance that the given share of `distances`, rounded down, exceeds.
fn exceeded(distances: &mut [f64], share: f64) -> f64 {
    let beyond = ((share * distances.len() as f64) as usize).min(distances.len());
    let Some(at) = (distances.len() - beyond).checked_sub(1) else { return 0.0 };
    *distances.select_nth_unstable_by(at, f64::total_cmp).1
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64;

    use super::super::TbvShape;
    use super::*;

    type Samples = Vec<(WorldTime, DVec3)>;

    const STEP: Duration = Duration::from_millis(100);

    /// Walks from place to place at speeds of its own, and stands between.
    fn walker(rng: &mut Pcg64, seconds: u32) -> Samples {
        let mut position = DVec3::new(rng.random_range(-1e4..1e4), 0.0, rng.random_range(-1e4..1e4));
        let (mut velocity, mut left) = (DVec3::ZERO, 0);
        (0..seconds * 10)
            .map(|i| {
                if left == 0 {
                    left = rng.random_range(5..30);
                    let angle = rng.random_range(0.0..std::f64::consts::TAU);
                    let speed = if rng.random_bool(0.3) { 0.0 } else { rng.random_range(0.4..2.0) };
                    velocity = DVec3::new(angle.cos(), 0.0, angle.sin()) * speed;
                }
                left -= 1;
                position += velocity * STEP.as_secs_f64();
                (WorldTime::ZERO + STEP * i, position)
            })
            .collect()
    }

    fn walkers(seed: u64, count: u32) -> Vec<Samples> {
        let mut rng = Pcg64::seed_from_u64(seed);
        (0..count).map(|_| walker(&mut rng, 60)).collect()
    }

    fn calibrated(tracks: &[Samples], probability: f64) -> FuzzySpeeds {
        let tracks = tracks.iter().map(Vec::as_slice);
        FuzzySpeeds::calibrate(tracks, probability, STEP, Duration::from_secs(10)).unwrap()
    }

    fn limits(speed_max: f64) -> MotionLimits {
        MotionLimits { speed_max, acceleration_max: f64::INFINITY, axis_speed_max: DVec3::INFINITY, reach: 0.3 }
    }

    /// How many bounds that begin in `track` every half second are broken, and how many there are.
    fn count_broken(speeds: &FuzzySpeeds, track: &Samples, validity: Duration) -> (u32, u32) {
        let (mut broken_count, mut count) = (0, 0);
        for (i, &(issued, position)) in track.iter().enumerate().step_by(5) {
            let expires = issued + validity;
            if track[track.len() - 1].0 < expires {
                break;
            }
            let state = MotionState { position, velocity: DVec3::ZERO };
            let bound = speeds.bound(state, limits(f64::INFINITY), issued, expires);
            count += 1;
            broken_count += u32::from(
                track[i..].iter().take_while(|&&(at, _)| at <= expires).any(|&(at, p)| broken(&bound, p, at)),
            );
        }
        (broken_count, count)
    }

    #[test]
    fn a_one_percent_bound_is_broken_by_about_one_percent_of_others_than_it_was_learned_from() {
        let tracks = walkers(1, 800);
        let (learned, tried) = tracks.split_at(400);
        let speeds = calibrated(learned, 0.01);
        // On rungs and between them.
        for millis in [100, 400, 1000, 2300, 5000, 7700] {
            let counts = tried.iter().map(|track| count_broken(&speeds, track, Duration::from_millis(millis)));
            let (broken, count) = counts.fold((0, 0), |sum, (broken, count)| (sum.0 + broken, sum.1 + count));
            let share = f64::from(broken) / f64::from(count);
            println!("{millis} ms: {broken} of {count} broken, {:.2} %", share * 100.0);
            assert!(count >= 10_000);
            assert!((0.005..=0.015).contains(&share), "{millis} ms: {broken} of {count}");
        }
    }

    #[test]
    fn distances_never_fall_with_time_and_never_pass_the_hard_limit() {
        let speeds = calibrated(&walkers(2, 40), 0.05);
        let state = MotionState { position: DVec3::ZERO, velocity: DVec3::ZERO };
        let mut travel = 0.0;
        for millis in 0..9_900 {
            let next = speeds.travel(f64::from(millis) * 1e-3).unwrap();
            assert!(next >= travel, "{millis} ms: {next} < {travel}");
            travel = next;
        }
        assert_eq!(speeds.travel(11.0), None);
        assert_eq!(speeds.travel(f64::NAN), None);
        for (millis, speed_max) in [(50, 0.1), (400, 1.0), (5000, 0.3), (9000, 50.0), (20_000, 2.0)] {
            let until = WorldTime::from_micros(millis * 1000);
            let radius = |bound: TemporalBound| {
                let mut pieces = Vec::new();
                bound.volume(until, &mut pieces);
                let [Bound::Sphere { radius, .. }] = pieces[..] else { panic!("{pieces:?}") };
                radius
            };
            let hard =
                TemporalBound::new(TbvShape::SpeedSphere, state, limits(speed_max), None, WorldTime::ZERO, until);
            assert!(radius(speeds.bound(state, limits(speed_max), WorldTime::ZERO, until)) <= radius(hard));
        }
    }

    #[test]
    fn zero_is_the_hard_bound_and_one_is_broken_by_every_step() {
        let tracks = walkers(3, 4);
        let state = MotionState { position: DVec3::ZERO, velocity: DVec3::ZERO };
        let expires = WorldTime::ZERO + Duration::from_secs(2);
        let never = calibrated(&tracks, 0.0).bound(state, limits(3.0), WorldTime::ZERO, expires);
        assert!(!never.is_fuzzy() && !broken(&never, DVec3::X * 5.9, expires));
        assert!(broken(&never, DVec3::X * 6.1, expires), "a hard bound can be found broken too");
        let always = calibrated(&tracks, 1.0).bound(state, limits(3.0), WorldTime::ZERO, expires);
        assert!(broken(&always, DVec3::X * 1e-3, WorldTime::ZERO + STEP));
        assert!(!broken(&always, DVec3::ZERO, WorldTime::ZERO + STEP), "what stands still breaks nothing");
    }

    #[test]
    fn a_bound_promises_nothing_outside_its_time_and_nothing_about_nowhere() {
        let (issued, expires) = (WorldTime::from_micros(1000), WorldTime::from_micros(9000));
        let state = MotionState { position: DVec3::ZERO, velocity: DVec3::ZERO };
        let bound = calibrated(&walkers(4, 40), 0.02).bound(state, limits(1.0), issued, expires);
        assert!(!broken(&bound, DVec3::X * 99.0, WorldTime::MIN) && !broken(&bound, DVec3::X * 99.0, WorldTime::MAX));
        assert!(broken(&bound, DVec3::X * 99.0, expires) && broken(&bound, DVec3::NAN, issued));
        // What may be everywhere breaks nothing.
        let nothing = calibrated(&walkers(4, 40), 0.02).bound(state, limits(f64::NAN), issued, expires);
        assert!(!broken(&nothing, DVec3::X * 99.0, expires));
    }

    #[test]
    fn of_a_hundred_distances_one_percent_is_the_farthest_alone() {
        let distances = || (1..=100).rev().map(f64::from).collect::<Vec<f64>>();
        for (share, expected) in [(0.0, 100.0), (0.01, 99.0), (0.019, 99.0), (0.2, 80.0), (0.99, 1.0), (1.0, 0.0)] {
            assert_eq!(exceeded(&mut distances(), share), expected, "{share}");
        }
        assert_eq!(exceeded(&mut [], 0.5), 0.0);
    }

    #[test]
    fn bad_input_is_refused() {
        let second = Duration::from_secs(1);
        let track: Samples = (0..50).map(|i| (WorldTime::ZERO + STEP * i, DVec3::X * f64::from(i))).collect();
        let calibrate = |track: &Samples, probability, shortest, longest| {
            FuzzySpeeds::calibrate([track.as_slice()], probability, shortest, longest)
        };
        for probability in [f64::NAN, -0.1, 1.1] {
            assert!(matches!(calibrate(&track, probability, STEP, second), Err(FuzzyError::Probability(_))));
        }
        for (shortest, longest) in [(Duration::ZERO, second), (second, STEP)] {
            assert!(matches!(calibrate(&track, 0.5, shortest, longest), Err(FuzzyError::Periods { .. })));
        }
        assert!(matches!(calibrate(&track, 0.01, STEP, second), Err(FuzzyError::TooFew { needed: 1000, .. })));
        assert!(matches!(calibrate(&Vec::new(), 0.5, STEP, second), Err(FuzzyError::TooFew { windows: 0, .. })));
        let mut bad = track.clone();
        bad[7].1.y = f64::NAN;
        assert_eq!(calibrate(&bad, 0.5, STEP, second), Err(FuzzyError::Sample { track: 0, sample: 7 }));
        let mut bad = track.clone();
        bad[9].0 = bad[8].0;
        assert_eq!(calibrate(&bad, 0.5, STEP, second), Err(FuzzyError::Sample { track: 0, sample: 9 }));
        // The ladder ends where the tracks do.
        assert!(calibrate(&track, 0.5, STEP, Duration::from_secs(99)).unwrap().longest().unwrap() < second * 5);
    }
}
