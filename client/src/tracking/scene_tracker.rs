//! The algorithm of S&G §3.3 whole, over any static culler, without a network: one viewer's frames.
//!
//! The names are the paper's: **T** is a [`DynamicIndex`], **D** the entries, **Q** the [`ExpiryQueue`], **V** the
//! set of (potentially) visible objects. 𝒜 is split in two (DESIGN §4): a static culler has drawn the static scene before, and
//! its image says what it hides; T, which holds what moves, is walked against it. What moves and is drawn joins the image, so
//! that it hides what lies behind it in the same frame.
//!
//! Step 3 changes T while it walks it. The changes are buffered as §3.3 discusses: the walk first lists what is exposed, then
//! each exposed bound gives way to its object's present configuration, which is tested at once. So nothing has to be walked
//! twice, and no object waits for the next frame. What expired is looked at in the same way, and enters T when it is known as
//! what: as itself if it is in sight, else as its next bound.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use eyeline_protocol::WorldTime;
use eyeline_visibility::{Bound, DynamicIndex, Occlusion};
use glam::DVec3;

use super::{ExpiryQueue, Period, TemporalBound, Validity};

mod terms;

pub use terms::{Agents, FrameInput, FrameStats, Image, Variant};

#[derive(Clone, Debug)]
enum State {
    /// In V.
    Visible,
    /// In Q and, by its volume, in T.
    Hidden(TemporalBound),
}

/// One object's place in D.
#[derive(Clone, Debug)]
struct Entry {
    state: State,
    /// What stands for it in T: its node pointers, by way of T's keys.
    keys: Vec<u32>,
    /// Number of the frame that displayed it last; 0 for never.
    observed: u64,
    /// The volumes in T, one for each key.
    volume: Vec<Bound>,
    period: Period,
}

/// T, D, Q and V of one viewer.
pub struct SceneTracker {
    variant: Variant,
    validity: Validity,
    frame_time: Duration,
    index: Box<dyn DynamicIndex + Send>,
    /// Which object a key of T stands for; `None` for keys that are free.
    owners: Vec<Option<u32>>,
    free: Vec<u32>,
    entries: BTreeMap<u32, Entry>,
    queue: ExpiryQueue<u32>,
    visible: BTreeSet<u32>,
    /// Hidden objects that were reported to have broken their bounds since the last frame.
    violated: BTreeSet<u32>,
    frames: u64,
    now: WorldTime,
    /// Kept to spare allocations.
    keys: Vec<u32>,
    pieces: Vec<Bound>,
}

impl SceneTracker {
    /// A tracker of nothing yet. `index` becomes T; frames are `frame_time` apart, which is also what expiries are rounded
    /// down to, so that many fall together.
    pub fn new(
        variant: Variant,
        validity: Validity,
        frame_time: Duration,
        index: Box<dyn DynamicIndex + Send>,
    ) -> SceneTracker {
        SceneTracker {
            variant,
            validity,
            frame_time,
            index,
            owners: Vec::new(),
            free: Vec::new(),
            entries: BTreeMap::new(),
            queue: ExpiryQueue::new(frame_time),
            visible: BTreeSet::new(),
            violated: BTreeSet::new(),
            frames: 0,
            now: WorldTime::MIN,
            keys: Vec::new(),
            pieces: Vec::new(),
        }
    }

    /// An object exists: potentially visible until a frame shows that it is not. An id that is in use is a new object.
    pub fn insert(&mut self, object: u32) {
        self.remove(object);
        let entry = Entry {
            state: State::Visible,
            keys: Vec::new(),
            volume: Vec::new(),
            observed: 0,
            period: self.validity.first(),
        };
        self.entries.insert(object, entry);
        self.visible.insert(object);
        self.debug_check(object);
        self.debug_check_sums();
    }

    /// An object exists no more. Returns whether it did.
    pub fn remove(&mut self, object: u32) -> bool {
        self.leave_t(object);
        self.queue.cancel(object);
        self.visible.remove(&object);
        self.violated.remove(&object);
        let was_there = self.entries.remove(&object).is_some();
        self.debug_check(object);
        self.debug_check_sums();
        was_there
    }

    /// An object has broken its bound, or will have by the next frame (§3.5). Whoever moves it says so.
    pub fn handle_violation(&mut self, object: u32) {
        if matches!(self.entries.get(&object), Some(Entry { state: State::Hidden(_), .. })) {
            self.violated.insert(object);
        }
    }

    /// One frame of §3.3: calls [`Image::draw`] for each object that may be visible, nearest first; without hierarchy in
    /// order of ids.
    ///
    /// Any `now` will do: if time goes back, bounds issued after it are void.
    pub fn frame(&mut self, input: FrameInput, agents: &mut dyn Agents, image: &mut dyn Image) -> FrameStats {
        let mut stats = FrameStats::default();
        let visits = self.index.update_visits();
        self.frames += 1;
        let (expired, due) = self.expire(input.now, &mut stats);
        if self.variant == Variant::NoHierarchy {
            for (&object, entry) in &mut self.entries {
                agents.configuration(object);
                image.draw(object);
                entry.observed = self.frames;
            }
            stats.updates = self.entries.len() as u64;
            stats.shown = stats.updates;
            return stats;
        }
        // What is looked at directly in step 3: T has an old bound of it, or nothing.
        let mut fresh = due.clone();
        if self.variant.uses_bounds() {
            fresh.extend(self.visible.iter().filter(|object| self.entries[object].keys.is_empty()));
        }
        fresh.sort_unstable();
        fresh.dedup();
        // Step 2, which TBVi leaves out.
        if self.variant != Variant::Implicit {
            let moved: Vec<u32> =
                self.visible.iter().filter(|object| fresh.binary_search(object).is_err()).copied().collect();
            for object in moved {
                stats.updates += 1;
                let bound = agents.configuration(object);
                self.enter_t(object, &[bound]);
                self.debug_check(object);
            }
        }
        let exposed = self.display(&input, agents, image, &fresh, &mut stats);
        if self.variant.uses_bounds() {
            self.hide(&input, agents, image.occlusion(), (&expired, &due, &exposed), &mut stats);
        }
        stats.work += self.index.update_visits() - visits;
        // Each object that is shown was asked about once, and no bound is of one that is.
        stats.hidden_caused = stats.updates + stats.bounds - stats.shown;
        self.debug_check_sums();
        stats
    }

    /// Step 1. Returns whose bounds expired unbroken, and with them those whose bounds are void for another reason: both
    /// ascending.
    fn expire(&mut self, now: WorldTime, stats: &mut FrameStats) -> (Vec<u32>, Vec<u32>) {
        let mut expired = Vec::new();
        self.queue.expire(now, &mut expired);
        expired.sort_unstable();
        stats.expired += expired.len() as u64;
        let mut due = expired.clone();
        if now < self.now {
            let void = self.entries.iter().filter(|(_, entry)| match &entry.state {
                State::Hidden(bound) => bound.issued() > now,
                State::Visible => false,
            });
            due.extend(void.map(|(&object, _)| object));
        }
        self.now = now;
        stats.violated += self.violated.len() as u64;
        let violated = std::mem::take(&mut self.violated);
        expired.retain(|object| !violated.contains(object));
        due.extend(violated);
        due.sort_unstable();
        due.dedup();
        for &object in &due {
            self.delete_bound(object);
        }
        (expired, due)
    }

    /// Step 3. Returns whose bounds were exposed.
    fn display(
        &mut self,
        input: &FrameInput,
        agents: &mut dyn Agents,
        image: &mut dyn Image,
        fresh: &[u32],
        stats: &mut FrameStats,
    ) -> BTreeSet<u32> {
        let mut keys = std::mem::take(&mut self.keys);
        keys.clear();
        stats.work += self.index.exposed(image.occlusion(), &mut keys) as u64;
        let owners = keys.iter().filter_map(|&key| self.owners.get(key as usize).copied().flatten());
        let seen: BTreeSet<u32> = owners.filter(|object| fresh.binary_search(object).is_err()).collect();
        self.keys = keys;
        let mut candidates: Vec<(f64, u32, Option<Bound>)> =
            seen.iter().map(|&object| (nearest(&self.entries[&object].volume, input.eye), object, None)).collect();
        for &object in fresh {
            stats.updates += 1;
            let bound = agents.configuration(object);
            stats.work += 1;
            if !hides(image.occlusion(), &bound) {
                candidates.push((nearest(&[bound], input.eye), object, Some(bound)));
            }
        }
        candidates.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let mut exposed = BTreeSet::new();
        // What was drawn since the walk may hide more.
        let mut has_grown = false;
        for (_, object, mut present) in candidates {
            let Some(entry) = self.entries.get(&object) else { continue };
            if has_grown {
                let volume = present.as_ref().map_or(&entry.volume[..], std::slice::from_ref);
                stats.work += volume.len() as u64;
                if volume.iter().all(|bound| hides(image.occlusion(), bound)) {
                    continue;
                }
            }
            match entry.state {
                State::Hidden(_) => {
                    stats.exposed += 1;
                    exposed.insert(object);
                    self.delete_bound(object);
                    stats.updates += 1;
                    let bound = agents.configuration(object);
                    stats.work += 1;
                    if hides(image.occlusion(), &bound) {
                        continue;
                    }
                    present = Some(bound);
                }
                // Displayed as it is now, wherever T has it.
                State::Visible if self.variant == Variant::Implicit && present.is_none() => {
                    stats.updates += 1;
                    agents.configuration(object);
                }
                State::Visible => {}
            }
            if let Some(bound) = present {
                self.enter_t(object, &[bound]);
                self.debug_check(object);
            }
            has_grown |= image.draw(object);
            stats.shown += 1;
            if let Some(entry) = self.entries.get_mut(&object) {
                entry.observed = self.frames;
            }
        }
        exposed
    }

    /// Step 4: what V has and this frame did not display gets a TBV.
    fn hide(
        &mut self,
        input: &FrameInput,
        agents: &mut dyn Agents,
        occlusion: &dyn Occlusion,
        (expired, due, exposed): (&[u32], &[u32], &BTreeSet<u32>),
        stats: &mut FrameStats,
    ) {
        let is_unseen = |object: &&u32| self.entries.get(object).is_some_and(|entry| entry.observed < self.frames);
        let unseen: Vec<u32> = self.visible.iter().filter(is_unseen).copied().collect();
        for object in unseen {
            let Some(entry) = self.entries.get_mut(&object) else { continue };
            // §3.4: hidden when its time was up, so it could have been longer; hidden when its bound came into view, so it was
            // too long. A broken bound says nothing about its length. What has just gone out of view starts anew.
            let is_due = due.binary_search(&object).is_ok();
            if expired.binary_search(&object).is_ok() {
                self.validity.lengthen(&mut entry.period);
            } else if exposed.contains(&object) {
                self.validity.shorten(&mut entry.period);
            } else if !is_due {
                entry.period = self.validity.first();
            }
            let period = entry.period;
            stats.bounds += 1;
            let bound = match self.validity {
                // Chosen here, from one bound, without further messages.
                Validity::Exact { longest } => {
                    let bound = agents.temporal_bound(object, input.now + longest.max(self.frame_time));
                    let pieces = &mut self.pieces;
                    let mut tested = 0;
                    let chosen = self.validity.choose(&period, input.eye_moves, self.frame_time, &mut |validity| {
                        pieces.clear();
                        bound.volume(input.now + validity, pieces);
                        tested += pieces.len() as u64;
                        pieces.iter().all(|piece| hides(occlusion, piece))
                    });
                    stats.work += tested;
                    // It may be good for less than was asked.
                    bound.with_expiry((input.now + chosen).min(bound.expires()))
                }
                Validity::Fixed(_) | Validity::Adaptive { .. } => {
                    let chosen = self.validity.choose(&period, input.eye_moves, self.frame_time, &mut |_| true);
                    agents.temporal_bound(object, input.now + chosen)
                }
            };
            // A bound that holds from some later time on says nothing of now.
            let bound = if bound.issued() > input.now { bound.with_expiry(input.now) } else { bound };
            self.visible.remove(&object);
            let mut pieces = std::mem::take(&mut self.pieces);
            pieces.clear();
            bound.volume(bound.expires(), &mut pieces);
            self.enter_t(object, &pieces);
            self.pieces = pieces;
            self.queue.insert(object, bound.expires());
            if let Some(entry) = self.entries.get_mut(&object) {
                entry.state = State::Hidden(bound);
            }
            self.debug_check(object);
        }
    }

    /// The paper's `del_TBV`: the object is potentially visible again. T keeps the volume until the next one takes its place:
    /// to move it under a least common ancestor costs less than to delete it and to insert another.
    fn delete_bound(&mut self, object: u32) {
        self.queue.cancel(object);
        if let Some(entry) = self.entries.get_mut(&object) {
            entry.state = State::Visible;
            self.visible.insert(object);
        }
        self.debug_check(object);
    }

    /// Puts these volumes into T in place of what stands for the object there. Keys that are kept move, so that T can update
    /// itself under a least common ancestor.
    fn enter_t(&mut self, object: u32, volume: &[Bound]) {
        let Some(entry) = self.entries.get_mut(&object) else { return };
        for key in entry.keys.split_off(entry.keys.len().min(volume.len())) {
            self.index.remove(key);
            self.owners[key as usize] = None;
            self.free.push(key);
        }
        while entry.keys.len() < volume.len() {
            let key = self.free.pop().unwrap_or_else(|| {
                self.owners.push(None);
                (self.owners.len() - 1) as u32
            });
            self.owners[key as usize] = Some(object);
            entry.keys.push(key);
        }
        for (&key, &bound) in entry.keys.iter().zip(volume) {
            self.index.insert(key, bound);
        }
        entry.volume.clear();
        entry.volume.extend_from_slice(volume);
    }

    fn leave_t(&mut self, object: u32) {
        self.enter_t(object, &[]);
    }

    /// Objects of V, ascending.
    pub fn visible(&self) -> impl Iterator<Item = u32> + '_ {
        self.visible.iter().copied()
    }

    /// The objects that the newest frame displayed, ascending.
    pub fn shown(&self) -> impl Iterator<Item = u32> + '_ {
        let is_shown = |&object: &u32| self.entries.get(&object).is_some_and(|entry| entry.observed == self.frames);
        self.visible().filter(is_shown)
    }

    /// The bound that stands for a hidden object.
    pub fn bound(&self, object: u32) -> Option<&TemporalBound> {
        match &self.entries.get(&object)?.state {
            State::Hidden(bound) => Some(bound),
            State::Visible => None,
        }
    }

    /// Objects, of which this many are in V.
    pub fn counts(&self) -> (usize, usize) {
        (self.entries.len(), self.visible.len())
    }

    /// Checks one object after each of its mutations, in debug builds: all of them would make every mutation linear.
    fn debug_check(&self, object: u32) {
        if cfg!(debug_assertions) {
            self.check_object(object);
        }
    }

    /// The sums, after each call from outside: while bounds expire, Q has lost all of them and V gets one after the other.
    fn debug_check_sums(&self) {
        debug_assert_eq!(self.queue.len() + self.visible.len(), self.entries.len(), "an object is in Q or in V");
        debug_assert_eq!(self.owners.len() - self.free.len(), self.index.len(), "T has the keys in use");
    }

    fn check_object(&self, object: u32) {
        let in_queue = self.queue.due(object).is_some();
        let in_visible = self.visible.contains(&object);
        let Some(entry) = self.entries.get(&object) else {
            assert!(
                !in_queue && !in_visible && !self.violated.contains(&object),
                "object {object} left something behind"
            );
            return;
        };
        match entry.state {
            State::Visible => assert!(in_visible && !in_queue, "object {object} is in V alone"),
            State::Hidden(_) => {
                assert!(in_queue && !in_visible, "hidden object {object} is in Q and not in V");
                assert!(!entry.keys.is_empty(), "hidden object {object} is in T");
            }
        }
        assert_eq!(entry.keys.len(), entry.volume.len());
        for &key in &entry.keys {
            assert_eq!(self.owners[key as usize], Some(object), "key {key} is object {object}'s");
        }
    }

    /// Checks T, D, Q and V against each other, whole.
    ///
    /// # Panics
    /// If they disagree: an invariant of this module is broken.
    pub fn check(&self) {
        let keys: usize = self.entries.values().map(|entry| entry.keys.len()).sum();
        assert_eq!(keys, self.index.len(), "T holds what D points to");
        assert_eq!(keys + self.free.len(), self.owners.len(), "keys are used or free");
        assert!(self.visible.iter().all(|object| self.entries.contains_key(object)), "V has what D has");
        assert_eq!(self.queue.len() + self.visible.len(), self.entries.len());
        self.entries.keys().for_each(|&object| self.check_object(object));
    }
}

/// Whether a bound is hidden. One that makes no sense may be anywhere, as T takes it too.
fn hides(occlusion: &dyn Occlusion, bound: &Bound) -> bool {
    bound.outer_box().is_some() && occlusion.hides(bound)
}

/// Distance from the eye to the nearest of some volumes; 0 for what has no bounds.
fn nearest(volume: &[Bound], eye: DVec3) -> f64 {
    let distance = |bound: &Bound| bound.aabb().map_or(0.0, |aabb| aabb.distance(eye));
    volume.iter().map(distance).min_by(f64::total_cmp).unwrap_or(0.0)
}

#[cfg(test)]
mod tests;
