//! What are the smallest settings of `radius` and `grid` that miss nobody? Any two policies can be compared only where both
//! show the same.
//!
//! Motion does not depend on the policy. So one run under `broadcast`, in virtual time, tells which objects owned a pixel
//! from which eye, and the settings follow: the greatest distance, and the smallest squares that have eye and object
//! within one of each other. *All round* counts, on the six sides of a cube, since these policies do not know which way
//! anybody looks; in the frames that are judged, the frame's own picture counts as well, since its pixels lie elsewhere.
//!
//! A policy must have told of an object before it is seen: for as long as telling takes (a round trip, the wait for a tick
//! and a frame, and as many resends as the loss asks for) it is held against each committed state up to the frame.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use eyeline_protocol::{Extent, ObjectId};
use eyeline_server::policy::{Grid, Radius};
use eyeline_server::world::AVATAR_CLASS;
use eyeline_visibility::{Aabb, AllRoundScratch, Bound, EyeRegion, ItemBuffer, Occlusion, View};
use glam::DVec3;

use super::truth::{Painter, may_be_in};
use super::{Commit, FrameLog, MeasureConfig, Net, RunLog, virtual_time};
use crate::report::Progress;
use crate::stage::{Crowd, Stage};
use crate::virtual_net::LinkRules;

/// The smallest settings that missed nobody in a run, with their margin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fit {
    /// For `radius`, metres.
    pub radius: f64,
    /// For `grid`: side of a square, metres.
    pub cell: f64,
    /// How far eye and object may each be from where they were in that run, metres: what they walk in a tick.
    pub margin: f64,
    /// How long before a frame its objects were to be told of, at most.
    pub wait: Duration,
    /// Frames that were looked at.
    pub frames: u64,
}

/// Frames looked at besides those that are judged, at most: over QUIC frames fall at other moments.
const EXTRA_FRAMES: usize = 2_000;

/// Which losses in a row are not waited for: one record in a million.
const LOST_IN_A_ROW: f64 = 1e-6;

/// No setting is smaller, metres.
const LEAST: f64 = 0.01;

/// Steps from half of the cell that is surely enough to all of it.
const CELL_STEPS: f64 = 500.0;

/// Runs `broadcast` in virtual time, over the link of `net` or a short one, and finds the settings.
///
/// # Errors
/// If the world can't be run.
pub fn fit(stage: &Stage, crowd: Option<&Crowd>, config: &MeasureConfig, net: &Net) -> anyhow::Result<Fit> {
    let link = match net {
        Net::Sim(link) | Net::SimQuic(link) | Net::QuicOver(link) => *link,
        Net::Quic => LinkRules::default().with_delay(Duration::from_micros(250)),
    };
    let log = virtual_time::run(stage, crowd, config, &link, false, "broadcast")?;
    Ok(Fit::of(stage, &log, config, resending(&link, config.frame())))
}

/// What lost datagrams may add to the time that telling takes.
fn resending(link: &LinkRules, frame: Duration) -> Duration {
    if link.loss <= 0.0 {
        return Duration::ZERO;
    }
    let losses = (LOST_IN_A_ROW.ln() / link.loss.ln()).ceil().clamp(1.0, 32.0);
    // A timeout is SRTT + 4·RTTVAR; jitter varies a round trip by both its ways.
    (2 * link.one_way_max() + 8 * link.jitter + 2 * frame).mul_f64(losses)
}

/// An eye and what it sees, in one committed state.
#[derive(Clone, Copy, Debug)]
struct Pair {
    eye: DVec3,
    place: DVec3,
    /// From the eye to the object's extent.
    distance: f64,
}

impl Pair {
    /// The greater of the distances along x and along z: squares of this side are surely enough.
    fn apart(&self) -> f64 {
        (self.eye.x - self.place.x).abs().max((self.eye.z - self.place.z).abs())
    }
}

/// What was found so far.
#[derive(Default)]
struct Found {
    /// Those that may decide.
    pairs: Vec<Pair>,
    distance: f64,
    apart: f64,
    frames: u64,
    wait: Duration,
}

impl Found {
    /// Whether a pair may decide: what is nearer than others is told of at any setting that tells of those.
    fn may_decide(distance: f64, apart: f64, pair: &Pair, margin: f64) -> bool {
        pair.distance > distance || pair.apart() + 2.0 * margin > (apart + 2.0 * margin) * 0.5
    }
}

impl Fit {
    /// The smallest settings that would have missed nobody in a run that logged every position. `resending` is added to the
    /// time that telling takes.
    pub fn of(stage: &Stage, log: &RunLog, config: &MeasureConfig, resending: Duration) -> Fit {
        let meshes = stage.meshes(&log.classes[usize::from(AVATAR_CLASS.0)]);
        let margin = stage.model.spec.avatar.speed_max * config.frame().as_secs_f64();
        let total: usize = log.clients.iter().map(|client| client.frames.len()).sum();
        let fitter =
            Fitter { stage, log, config, painter: Painter::new(stage, log, &meshes, config), margin, resending };
        let stride = total.div_ceil(EXTRA_FRAMES).max(1);
        let progress = Progress::new(log.clients.len() as u64, "finding settings that miss nobody");
        let found = Mutex::new(Found::default());
        let next = AtomicUsize::new(0);
        let workers = std::thread::available_parallelism().map_or(1, |cores| cores.get());
        std::thread::scope(|scope| {
            for _ in 0..workers {
                scope.spawn(|| {
                    let mut image = ItemBuffer::new(&fitter.painter.view(DVec3::ZERO, 0.0));
                    let mut scratch = stage.all_round.scratch(config.side);
                    loop {
                        let client = next.fetch_add(1, Ordering::Relaxed);
                        let Some(client_log) = log.clients.get(client) else { break };
                        for (number, frame) in client_log.frames.iter().enumerate() {
                            if frame.known.is_some() || number.is_multiple_of(stride) {
                                fitter.look(frame, client_log.avatar, &found, &mut image, &mut scratch);
                            }
                        }
                        progress.inc(1);
                    }
                });
            }
        });
        progress.finish();
        let Found { pairs, frames, wait, .. } = found.into_inner().unwrap_or_else(PoisonError::into_inner);
        Fit { radius: smallest_radius(&pairs, margin), cell: smallest_cell(&pairs, margin), margin, wait, frames }
    }
}

struct Fitter<'a> {
    stage: &'a Stage,
    log: &'a RunLog,
    config: &'a MeasureConfig,
    painter: Painter<'a>,
    margin: f64,
    resending: Duration,
}

impl Fitter<'_> {
    /// Adds what a frame shows and may decide.
    ///
    /// To draw a world in all directions is slow, so it is done only for objects that are farther than what was found so far
    /// and not certainly hidden by the clients' culler. (The truth of the runs that follow shares no code with that.)
    fn look(
        &self,
        frame: &FrameLog,
        own: ObjectId,
        found: &Mutex<Found>,
        image: &mut ItemBuffer,
        scratch: &mut AllRoundScratch,
    ) {
        let commit = self.log.commit_at(frame.at);
        let wait = frame.round_trip_max + 2 * self.config.frame() + self.resending;
        let end = self.log.commits.partition_point(|commit| commit.at <= frame.at);
        let commits = &self.log.commits[..end];
        let begin = commits.partition_point(|commit| frame.at.since(commit.at) > wait);
        let lock = || found.lock().unwrap_or_else(PoisonError::into_inner);
        let (distance, apart) = {
            let mut found = lock();
            found.frames += 1;
            found.wait = found.wait.max(wait);
            (found.distance, found.apart)
        };
        let mut candidates = Vec::new();
        for (index, place) in commit.places.iter().enumerate() {
            let object = ObjectId(index as u32);
            let (Some((place, _)), Some(info)) = (place, self.log.objects.get(index)) else { continue };
            if object == own {
                continue;
            }
            let extent = self.log.classes[usize::from(info.class.0)].extent;
            let pairs = self.pairs(&commits[begin..], own, object, extent);
            if pairs.iter().any(|pair| Found::may_decide(distance, apart, pair, self.margin)) {
                let place = place.metres();
                let low = place + DVec3::new(-extent.radius, extent.bottom, -extent.radius);
                let high = place + DVec3::new(extent.radius, extent.top, extent.radius);
                candidates.push((object, Aabb::new(low, high), pairs));
            }
        }
        if candidates.is_empty() {
            return;
        }
        if let Ok(occlusion) = self.stage.all_round.cull(EyeRegion::point(frame.eye), scratch) {
            candidates.retain(|(_, aabb, _)| !occlusion.hides(&Bound::Box(*aabb)));
        }
        let side = self.config.resolution.width.max(self.config.resolution.height);
        let own_view = frame.known.is_some().then(|| self.painter.view(frame.eye, frame.yaw));
        for view in View::cube(frame.eye, side).into_iter().chain(own_view) {
            if !candidates.iter().any(|(_, aabb, _)| may_be_in(&view, aabb)) {
                continue;
            }
            let owned = self.painter.draw(image, &view, commit, own);
            candidates.retain(|(object, _, pairs)| {
                let is_seen = owned.contains_key(object);
                if is_seen {
                    let mut found = lock();
                    for pair in pairs {
                        found.distance = found.distance.max(pair.distance);
                        found.apart = found.apart.max(pair.apart());
                    }
                    found.pairs.extend(pairs);
                }
                !is_seen
            });
        }
    }

    /// Where an eye and an object were in each of some committed states, from the newest back to where one was not there: who
    /// had not come yet could not be told of.
    fn pairs(&self, commits: &[Commit], own: ObjectId, object: ObjectId, extent: Extent) -> Vec<Pair> {
        let up = DVec3::Y * self.log.classes[usize::from(AVATAR_CLASS.0)].eye_height;
        let pair = |commit: &Commit| {
            let place = |id: ObjectId| Some(commit.places.get(id.index()).copied().flatten()?.0.metres());
            let (eye, place) = (place(own)? + up, place(object)?);
            Some(Pair { eye, place, distance: Radius::distance(eye, place, extent) })
        };
        commits.iter().rev().map_while(pair).collect()
    }
}

/// Rounded up to centimetres, so that a report can name it.
fn centimetres_up(metres: f64) -> f64 {
    ((metres * 100.0).ceil() / 100.0).max(LEAST)
}

fn smallest_radius(pairs: &[Pair], margin: f64) -> f64 {
    let farthest = pairs.iter().map(|pair| pair.distance).fold(0.0, f64::max);
    // Both may have moved.
    centimetres_up(farthest + 2.0 * margin)
}

/// Squares as wide as the greatest distance are enough however they lie. Smaller ones may do, down to half of that, if no line
/// falls badly: more is not always enough, so each size is tried.
fn smallest_cell(pairs: &[Pair], margin: f64) -> f64 {
    let farthest = pairs.iter().map(Pair::apart).fold(0.0, f64::max);
    let enough = centimetres_up(farthest + 2.0 * margin);
    let mut far: Vec<&Pair> = pairs.iter().filter(|pair| pair.apart() + 2.0 * margin > enough * 0.5).collect();
    // The farthest rule out most sizes at once.
    far.sort_by(|a, b| b.apart().total_cmp(&a.apart()));
    let step = centimetres_up(enough * 0.5 / CELL_STEPS);
    let sizes = (0..).map(|i| centimetres_up(enough * 0.5 + f64::from(i) * step)).take_while(|&size| size < enough);
    let tells = |size: f64, pair: &Pair| {
        // Away from each other along both axes: neighbours then, and so in every place between.
        let way =
            DVec3::new(margin.copysign(pair.eye.x - pair.place.x), 0.0, margin.copysign(pair.eye.z - pair.place.z));
        Grid::tells(size, pair.eye + way, pair.place - way)
    };
    let mut sizes = sizes.filter(|&size| far.iter().all(|pair| tells(size, pair)));
    sizes.next().unwrap_or(enough)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pair(eye: [f64; 2], place: [f64; 2]) -> Pair {
        let at = |[x, z]: [f64; 2]| DVec3::new(x, 0.0, z);
        Pair { eye: at(eye), place: at(place), distance: at(eye).distance(at(place)) }
    }

    #[test]
    fn the_radius_is_the_greatest_distance_and_the_margin_of_both() {
        let pairs = [pair([0.0, 0.0], [3.0, 4.0]), pair([1.0, 0.0], [2.0, 0.0])];
        assert_eq!(smallest_radius(&pairs, 0.0), 5.0);
        assert_eq!(smallest_radius(&pairs, 0.1), 5.2);
        assert_eq!(smallest_radius(&[], 0.0), LEAST);
    }

    #[test]
    fn the_cell_tells_every_pair_wherever_the_margin_moves_it_and_a_smaller_one_does_not() {
        use rand::RngExt;
        let mut chance = crate::chance(5, 1);
        for margin in [0.0, 0.1] {
            let mut place = || [chance.random_range(-50.0..50.0), chance.random_range(-50.0..50.0)];
            let pairs: Vec<Pair> = (0..8).map(|_| pair(place(), place())).collect();
            let cell = smallest_cell(&pairs, margin);
            let farthest = pairs.iter().map(Pair::apart).fold(0.0, f64::max);
            assert!(cell > farthest * 0.5 && cell <= farthest + 2.0 * margin + 0.02, "{cell} of {farthest}");
            for pair in &pairs {
                for _ in 0..50 {
                    let mut moved =
                        || DVec3::new(chance.random_range(-1.0..=1.0), 0.0, chance.random_range(-1.0..=1.0));
                    let (eye, place) = (pair.eye + moved() * margin, pair.place + moved() * margin);
                    assert!(Grid::tells(cell, eye, place), "{cell} {pair:?}");
                }
            }
            assert!(!pairs.iter().all(|pair| Grid::tells(farthest * 0.49, pair.eye, pair.place)));
        }
        assert_eq!(smallest_cell(&[], 0.0), LEAST);
    }

    #[test]
    fn a_lucky_grid_is_found() {
        // 9.9 m apart, and with lines at −5, 0 and 5 in neighbouring squares.
        assert!(smallest_cell(&[pair([-4.95, 0.0], [4.95, 0.0])], 0.0) < 5.0);
        // Across three squares of any side below 6 m.
        assert!(smallest_cell(&[pair([-0.1, 0.0], [5.9, 0.0]), pair([0.5, 0.5], [0.6, 0.6])], 0.0) > 5.9);
    }

    #[test]
    fn losses_take_longer_to_make_good() {
        let frame = Duration::from_millis(50);
        let link = |loss| LinkRules::default().with_delay(Duration::from_millis(25)).with_loss(loss);
        assert_eq!(resending(&link(0.0), frame), Duration::ZERO);
        assert_eq!(resending(&link(0.02), frame), 4 * Duration::from_millis(150));
        assert!(resending(&link(0.2), frame) > resending(&link(0.05), frame));
    }
}
