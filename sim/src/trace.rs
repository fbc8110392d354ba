//! People who really walked, to be replayed as avatars.
//!
//! A [`Trace`] holds where each person was in the recording's own ground plane (x and y in metres, seconds from the first
//! frame); [`Placement`] puts that plane into a scene. [`read`] knows the two formats of the recordings and says what it
//! does with rows that are unsorted, double or broken. Between two samples a person is on the straight line between
//! them. A person unseen for longer than [`GAP_MAX_S`] has left, and comes back as another [`Track`] with the same id.
//!
//! A server admits avatars, not people: [`Trace::slots_at`] tells which person each of a fixed number of avatars plays.
//! The number is that of the most people at once, the least that can do.

pub mod place;
pub mod read;
mod slide;

use std::f64::consts::{PI, TAU};

use glam::DVec2;

pub use place::Placement;
pub use read::{Format, TraceError};
pub use slide::Obstacles;

/// Longest time without a sample before a person counts as gone, in seconds.
pub const GAP_MAX_S: f64 = 2.0;

/// How far a person must move before the way that they face is read off, in metres. Less is noise of the recording.
const FACING_STEP: f64 = 0.1;

/// A recording.
#[derive(Clone, Debug, PartialEq)]
pub struct Trace {
    /// Everyone, in order of their first sample, then of their id.
    pub people: Vec<Track>,
    /// What kind of file it came from.
    pub format: Format,
    /// Rows that repeated the person and frame of an earlier row; the earlier one counts.
    pub duplicates: usize,
    /// For each slot, the people (indices) that take it one after another.
    slots: Vec<Vec<usize>>,
}

/// One person, without a gap.
#[derive(Clone, Debug, PartialEq)]
pub struct Track {
    /// The recording's number for the person.
    pub id: u64,
    /// At least one; times rise strictly.
    samples: Vec<Sample>,
}

/// Where a person was at a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Seconds from the recording's first frame.
    pub time_s: f64,
    /// In the recording's ground plane, in metres.
    pub position: DVec2,
    /// Direction in which the person goes, in radians from the plane's x toward its y.
    pub facing: f64,
}

impl Track {
    /// A person with at least one sample, times rising strictly; `facing` is filled in.
    fn new(id: u64, mut samples: Vec<Sample>) -> Track {
        assert!(!samples.is_empty() && samples.is_sorted_by(|a, b| a.time_s < b.time_s));
        let mut anchor = samples[0].position;
        let mut facing = None;
        for i in 0..samples.len() {
            let moved = samples[i].position - anchor;
            if moved.length() >= FACING_STEP {
                anchor = samples[i].position;
                if facing.is_none() {
                    // Until the first real step they face where that step goes.
                    samples[..i].iter_mut().for_each(|sample| sample.facing = moved.y.atan2(moved.x));
                }
                facing = Some(moved.y.atan2(moved.x));
            }
            samples[i].facing = facing.unwrap_or(0.0);
        }
        Track { id, samples }
    }

    /// When the person is first seen, in seconds from the recording's first frame.
    pub fn start_s(&self) -> f64 {
        self.samples[0].time_s
    }

    /// When the person is last seen.
    pub fn end_s(&self) -> f64 {
        self.samples[self.samples.len() - 1].time_s
    }

    /// Its samples, at least one, in order of time.
    pub fn samples(&self) -> &[Sample] {
        &self.samples
    }

    /// Position and facing at a time from start to end, both included.
    fn at(&self, time_s: f64) -> Option<(DVec2, f64)> {
        if !(self.start_s()..=self.end_s()).contains(&time_s) {
            return None;
        }
        let after = self.samples.partition_point(|sample| sample.time_s <= time_s);
        let a = self.samples[after - 1];
        let Some(b) = self.samples.get(after) else { return Some((a.position, a.facing)) };
        let share = (time_s - a.time_s) / (b.time_s - a.time_s);
        let turn = (b.facing - a.facing + PI).rem_euclid(TAU) - PI;
        Some((a.position.lerp(b.position, share), a.facing + share * turn))
    }
}

impl Trace {
    /// Orders the people and gives each a slot.
    fn new(mut people: Vec<Track>, format: Format, duplicates: usize) -> Trace {
        people.sort_by(|a, b| a.start_s().total_cmp(&b.start_s()).then(a.id.cmp(&b.id)));
        // First free slot, in order of arrival. For intervals this greedy way needs no more slots than people at once.
        let mut slots: Vec<Vec<usize>> = Vec::new();
        for (person, track) in people.iter().enumerate() {
            let free = slots.iter_mut().find(|slot| {
                let last = slot[slot.len() - 1];
                people[last].end_s() < track.start_s()
            });
            match free {
                Some(slot) => slot.push(person),
                None => slots.push(vec![person]),
            }
        }
        Trace { people, format, duplicates, slots }
    }

    /// Where a person (index into `people`) is, in the recording's plane; `None` if they are not there then.
    pub fn position_at(&self, person: usize, time_s: f64) -> Option<(f64, f64)> {
        self.people.get(person)?.at(time_s).map(|(position, _)| (position.x, position.y))
    }

    /// The direction in which a person goes, in radians from the plane's x toward its y; somebody who stands faces where
    /// they went last.
    pub fn facing_at(&self, person: usize, time_s: f64) -> Option<f64> {
        self.people.get(person)?.at(time_s).map(|(_, facing)| facing)
    }

    /// From the first frame, which is time 0, to the last, in seconds.
    pub fn span_s(&self) -> f64 {
        self.people.iter().map(Track::end_s).fold(0.0, f64::max)
    }

    /// Greatest speed between two samples of anybody, in metres a second: the bound of an avatar that replays it at scale 1.
    pub fn speed_max(&self) -> f64 {
        let steps = self.people.iter().flat_map(|track| track.samples.windows(2));
        let speeds = steps.map(|pair| pair[0].position.distance(pair[1].position) / (pair[1].time_s - pair[0].time_s));
        speeds.fold(0.0, f64::max)
    }

    /// Most people at one moment, which is the number of slots.
    pub fn people_at_once(&self) -> usize {
        self.slots.len()
    }

    /// Who is in each slot at a time: an index into `people`, or nobody. A slot is taken again, at the earliest, after its
    /// last person's last sample; the first free slot is taken, so the same trace always gives the same slots. Whoever
    /// takes a slot over may be far from who left it: an avatar that plays a slot must leave and join anew.
    pub fn slots_at(&self, time_s: f64) -> Vec<Option<usize>> {
        let there = |slot: &Vec<usize>| {
            let arrived = slot.partition_point(|&person| self.people[person].start_s() <= time_s);
            let person = slot[..arrived].last().copied()?;
            (time_s <= self.people[person].end_s()).then_some(person)
        };
        self.slots.iter().map(there).collect()
    }

    /// Least and greatest corner of the ground that anybody walked on, in the recording's plane.
    pub fn ground(&self) -> (DVec2, DVec2) {
        let places = self.people.iter().flat_map(|track| &track.samples).map(|sample| sample.position);
        places.fold((DVec2::INFINITY, DVec2::NEG_INFINITY), |(min, max), place| (min.min(place), max.max(place)))
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    fn parsed(text: &str) -> Trace {
        Trace::parse(Path::new("test.txt"), text.as_bytes()).unwrap()
    }

    /// Three people at 16 frames a second; 1 leaves before 3 comes.
    const THREE: &str = "1 0 0 0 170\n1 16 100 0 170\n1 32 100 200 170\n2 8 -50 0 160\n2 64 500 0 160\n3 33 0 0 180\n";

    #[test]
    fn people_are_where_the_line_between_samples_says() {
        let trace = parsed("1 0 0 0 170\n1 16 100 0 170\n1 32 100 200 170\n");
        assert_eq!(trace.position_at(0, 0.5), Some((0.5, 0.0)));
        assert_eq!(trace.position_at(0, 1.5), Some((1.0, 1.0)));
        assert_eq!(trace.position_at(0, 2.0), Some((1.0, 2.0)));
        for (person, time_s) in [(0, -0.01), (0, 2.01), (0, f64::NAN), (1, 0.0)] {
            assert_eq!(trace.position_at(person, time_s), None);
        }
        assert_eq!((trace.span_s(), trace.speed_max()), (2.0, 2.0));
        assert_eq!(trace.ground(), (DVec2::ZERO, DVec2::new(1.0, 2.0)));
        assert_eq!(trace.facing_at(0, 0.0), Some(0.0));
        assert!((trace.facing_at(0, 1.5).unwrap() - PI / 4.0).abs() < 1e-12);
        assert_eq!(trace.facing_at(0, 2.0), Some(PI / 2.0));
    }

    #[test]
    fn a_slot_is_taken_again_when_somebody_leaves() {
        let text = THREE.replace("2 64 500 0 160", "2 40 500 0 160");
        let trace = parsed(&text);
        assert_eq!(trace.people_at_once(), 2);
        assert_eq!(trace.slots_at(0.0), [Some(0), None]);
        assert_eq!(trace.slots_at(1.0), [Some(0), Some(1)]);
        assert_eq!(trace.slots_at(2.0 + 1.0 / 16.0), [Some(2), Some(1)]);
        assert_eq!(trace.slots_at(100.0), [None, None]);
    }

    #[test]
    fn who_is_unseen_for_long_has_left() {
        // Person 2's two samples are 56 frames, 3.5 s, apart.
        let trace = parsed(THREE);
        assert_eq!(trace.people.iter().map(|track| track.id).collect::<Vec<_>>(), [1, 2, 3, 2]);
        assert_eq!(trace.position_at(1, 1.0), None);
    }

    #[test]
    fn real_recordings_give_the_published_counts() {
        let Some(folder) = crate::given_data("motion") else { return };
        for (name, rows, people, at_once, format) in [
            ("students03_obsmat.txt", 21_846, 428, 62, Format::Obsmat),
            ("zara01_obsmat.txt", 5_024, 148, 20, Format::Obsmat),
            ("juelich_uo-180-180-070.txt", 75_336, 148, 76, Format::Juelich),
        ] {
            let trace = Trace::read(&folder.join(name)).unwrap();
            let samples: usize = trace.people.iter().map(|track| track.samples().len()).sum();
            assert_eq!((samples, trace.people.len(), trace.people_at_once()), (rows, people, at_once), "{name}");
            assert_eq!((trace.format, trace.duplicates), (format, 0));
            println!(
                "{name}: {:.1} s, at most {:.3} m/s, ground {:?}",
                trace.span_s(),
                trace.speed_max(),
                trace.ground()
            );
            assert!((1.9..2.85).contains(&trace.speed_max()));

            // Slots hold everybody who is there, once, and nobody changes slot.
            let mut slot_of = std::collections::BTreeMap::new();
            for tick in 0..(trace.span_s() * 5.0) as u32 {
                let time_s = f64::from(tick) * 0.2;
                let slots = trace.slots_at(time_s);
                for (slot, person) in slots.iter().enumerate().filter_map(|(slot, person)| Some((slot, (*person)?))) {
                    assert_eq!(*slot_of.entry(person).or_insert(slot), slot);
                }
                let there = (0..people).filter(|&person| trace.position_at(person, time_s).is_some()).count();
                assert_eq!(slots.iter().flatten().count(), there);
            }
        }
    }
}
