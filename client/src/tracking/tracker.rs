//! The tracker: S&G's algorithm over one client's beliefs.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::time::Duration;

use eyeline_protocol::{
    Class, ClientRecord, Issue, LocalTime, ObjectId, Orientation, Position, Prediction as State, Reason, RosterEntry,
    Tbv, Velocity, Want, WorldTime,
};
use eyeline_visibility::{Bound, DynamicIndex, Occlusion};
use glam::DVec3;

use super::dead_reckoning;
use super::entries::Entries;
use super::{
    Ahead, BeliefKind, Decision, ExpiryQueue, Explanation, Growth, Past, Sabotage, TrackerConfig, TrackerStats,
};

/// Something that the client shows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Drawn {
    /// Which object.
    pub object: ObjectId,
    /// Where its last state has it by now.
    pub position: Position,
    /// How it was turned.
    pub orientation: Orientation,
    /// World time of that state.
    pub tick: WorldTime,
    /// How it moved by that state; zero without dead reckoning.
    pub velocity: Velocity,
}

/// What the client believes about an object.
#[derive(Clone, Copy, Debug)]
enum Belief {
    /// Nothing: it may be everywhere. Asked for.
    Unknown,
    /// It is inside, and that was hidden when it was last tested. In T and Q unless asked for.
    Hidden(Tbv),
    /// Shown, and told of by the server. In V.
    Visible,
    /// Not in the world.
    Absent,
}

#[derive(Clone, Copy, Debug)]
struct Ask {
    want: Want,
    reason: Reason,
    sent_at: Option<LocalTime>,
    not_before: Option<u64>,
    /// Whether it waits in the queue of what is to be said.
    is_unsaid: bool,
    /// Frame in which it was asked first.
    since: u64,
    /// Tells this question from an earlier one about the same object.
    number: u64,
    /// Whether the server is known to have got it.
    heard: bool,
}

/// One object's place in D.
#[derive(Debug)]
struct Entry {
    class: usize,
    belief: Belief,
    issue: Issue,
    /// Knowledge from before this time is void.
    valid_from: WorldTime,
    state: Option<State>,
    ask: Option<Ask>,
    /// When the end of its stage is due in Q.
    due: Option<WorldTime>,
    /// Present length of a stage, in frames.
    stage_frames: u32,
    /// For how many frames in a row it has been in V and hidden.
    hidden_frames: u32,
    /// When updates were declined, as long as that has not been answered or repeated.
    released_at: Option<LocalTime>,
    /// Whether a bound is awaited in answer to a release.
    releasing: bool,
    /// After which frame its bound was made fresh last.
    freshened_in: Option<u64>,
    /// Whether the server has said that it no longer tells of it, though it is in V.
    is_withheld: bool,
    /// What was decided last, and when.
    decision: (Decision, WorldTime),
}

/// What was heard last of an object's breaking its bounds.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Violated {
    issue: Issue,
    at: WorldTime,
    present: bool,
}

/// What is shown must have been true within this time (DESIGN §5; a bound that holds is never stale). From a server that is silent for longer
/// nothing is shown, and nothing that was asked for in vain for longer.
pub const STALENESS_MAX: Duration = Duration::from_secs(5);

/// Most objects whose states are kept although no roster has named them yet.
const EARLY_MAX: usize = 65_536;

/// Beliefs about every object, and what to ask about them.
pub struct Tracker {
    config: TrackerConfig,
    /// Whether the client asks (`visible`) or is told.
    tracking: bool,
    blur: f64,
    /// How far what is drawn may be from the truth without a word from the server, metres.
    tolerance: f64,
    classes: Vec<Class>,
    /// D.
    entries: Entries<Entry>,
    /// T.
    index: Box<dyn DynamicIndex + Send>,
    /// Q. Exact, since a stage that ends earlier than was said would be tested earlier than was said.
    queue: ExpiryQueue<ObjectId>,
    /// V.
    visible: BTreeSet<ObjectId>,
    /// Objects that are held hidden, in Q until they expire, and not in T: walls seal them off from all `parts`.
    sealed: BTreeSet<ObjectId>,
    /// The parts of the scene that the eyes can see into at all, as of the newest frame. None if that is not known.
    parts: Option<Vec<u32>>,
    /// Objects that an answer is awaited for.
    asked: BTreeSet<ObjectId>,
    /// Questions asked so far.
    asks: u64,
    /// The newest violation of each object. Datagrams overtake the control stream, so that one may be heard of before the
    /// roster that names its object, or that names it with a bound from before.
    violations: BTreeMap<ObjectId, Violated>,
    /// States that overtook the roster that names their object, where the server decides what is told.
    early: BTreeMap<ObjectId, State>,
    out: VecDeque<ClientRecord>,
    /// Objects with a question that is to be said next, in order. Those whose question has gone are passed over.
    unsaid: VecDeque<ObjectId>,
    exposed: Vec<u32>,
    expired: Vec<ObjectId>,
    /// Latest possible server time at the newest frame.
    latest: WorldTime,
    /// What the newest frame's occlusion says that it is, and whether it is that of the frame before and is to stay so.
    version: Option<u64>,
    is_still: bool,
    /// Until when what is held hidden must be: that and the lead.
    horizon: WorldTime,
    /// The newest frame's lead.
    ahead: Ahead,
    /// When the server was heard of last.
    heard_at: Option<LocalTime>,
    /// Whether that is too long ago for anything to be shown.
    is_cut_off: bool,
    /// Time between the server's ticks.
    tick: Duration,
    /// How long the server lets an answer wait at most.
    answer_wait: Duration,
    /// Greatest round trip lately, for the decision whether two fit in a frame and for what silence means.
    round_trip: Option<Duration>,
    timeout: Duration,
    stats: TrackerStats,
}

impl Tracker {
    /// A tracker of nothing yet. `tracking`, `blur` and `classes` are the welcome's; `index` becomes T.
    pub fn new(
        config: TrackerConfig,
        tracking: bool,
        blur: f64,
        classes: Vec<Class>,
        index: Box<dyn DynamicIndex + Send>,
    ) -> Tracker {
        Tracker {
            config,
            tracking,
            blur,
            tolerance: 0.0,
            classes,
            entries: Entries::default(),
            index,
            queue: ExpiryQueue::new(Duration::ZERO),
            visible: BTreeSet::new(),
            sealed: BTreeSet::new(),
            parts: None,
            asked: BTreeSet::new(),
            asks: 0,
            violations: BTreeMap::new(),
            early: BTreeMap::new(),
            out: VecDeque::new(),
            unsaid: VecDeque::new(),
            exposed: Vec::new(),
            expired: Vec::new(),
            latest: WorldTime::MIN,
            version: None,
            is_still: false,
            horizon: WorldTime::MIN,
            ahead: Ahead::default(),
            heard_at: None,
            tick: Duration::ZERO,
            answer_wait: Duration::ZERO,
            is_cut_off: false,
            round_trip: None,
            timeout: Duration::from_secs(1),
            stats: TrackerStats::default(),
        }
    }

    /// Takes the welcome's word for how wrong what is drawn may be.
    pub fn with_dead_reckoning(self, allowed_px: Option<f64>) -> Tracker {
        Tracker { tolerance: dead_reckoning::tolerance(allowed_px), ..self }
    }

    /// Goes on from frames that were made without it.
    pub(crate) fn with_past(self, past: Past) -> Tracker {
        let Past { latest, horizon, ahead, heard_at, asks, violations, stats } = past;
        Tracker { latest, horizon, ahead, heard_at, asks, violations, stats, ..self }
    }

    /// Whether nothing is left that it knows of or has to say, so that one that is made later can take its place.
    pub(crate) fn is_idle(&self) -> bool {
        self.is_empty() && self.out.is_empty() && self.unsaid.is_empty() && self.queue.is_empty()
    }

    /// What one that is made later must know, and T, which is empty.
    pub(crate) fn into_past(self) -> (Past, Box<dyn DynamicIndex + Send>) {
        debug_assert!(self.is_idle() && self.index.is_empty(), "what it knows of would be forgotten");
        let Tracker { latest, horizon, ahead, heard_at, asks, violations, stats, index, .. } = self;
        (Past { latest, horizon, ahead, heard_at, asks, violations, stats }, index)
    }

    /// How many of the objects that are held hidden can never come into view of the present eye while it stands still: what
    /// bounds them is hidden for longer than any bound holds.
    pub fn never_seen(&self) -> usize {
        let never = Decision::Hidden { frames: EXACT_FRAMES_MAX };
        self.entries.values().filter(|entry| entry.due.is_some() && entry.decision.0 == never).count()
    }

    /// How many of the objects that are held hidden walls seal off from wherever the eye can go without leaving its
    /// part of the scene.
    pub fn sealed_off(&self) -> usize {
        self.sealed.len()
    }

    /// Whether something is held hidden by a bound that does not grow: what walls might seal off for good.
    pub fn could_be_sealed(&self) -> bool {
        self.config.sealed
            && self.entries.values().any(|entry| matches!(entry.belief, Belief::Hidden(tbv) if tbv.speed == 0.0))
    }

    /// Bytes that D, T, Q, V and what waits to be said take, by their capacity; an estimate where a map does not tell.
    pub fn memory_bytes(&self) -> usize {
        fn list<T>(capacity: usize) -> usize {
            capacity * size_of::<T>()
        }
        // Ordered maps and sets keep their entries in blocks that are two thirds full on average.
        let in_order = (self.visible.len() + self.asked.len() + self.sealed.len()) * size_of::<ObjectId>()
            + self.violations.len() * size_of::<(ObjectId, Violated)>()
            + self.early.len() * size_of::<(ObjectId, State)>();
        size_of::<Tracker>()
            + self.entries.memory_bytes()
            + self.index.memory_bytes()
            + self.queue.memory_bytes()
            + in_order * 3 / 2
            + list::<ClientRecord>(self.out.capacity())
            + list::<ObjectId>(self.unsaid.capacity() + self.expired.capacity())
            + list::<u32>(self.exposed.capacity())
    }

    /// Whether it knows of no object.
    pub fn is_empty(&self) -> bool {
        self.entries.is_empty() && self.early.is_empty()
    }

    /// Sets the welcome's time between ticks, before which no change is told.
    pub fn with_tick(self, tick: Duration) -> Tracker {
        Tracker { tick, ..self }
    }

    /// Sets the welcome's time for which an answer may wait at the server.
    pub fn with_answer_wait(self, answer_wait: Duration) -> Tracker {
        Tracker { answer_wait, ..self }
    }

    /// Replaces T by an empty `index`, for instance one that knows how large the world is. What was in it is settled anew
    /// at the next frame.
    pub fn use_index(&mut self, index: Box<dyn DynamicIndex + Send>) {
        self.index = index;
        let mut held: Vec<(ObjectId, Tbv)> = self
            .entries
            .iter()
            .filter_map(|(&object, entry)| match entry.belief {
                Belief::Hidden(tbv) if entry.due.is_some() => Some((object, tbv)),
                _ => None,
            })
            .collect();
        held.sort_unstable_by_key(|&(object, _)| object);
        for (object, tbv) in held {
            self.hold(object, tbv);
        }
        self.debug_check();
    }

    /// A datagram came at `now`. What the path is like: its greatest round trip lately, if known, and when to ask again.
    pub fn handle_path(&mut self, round_trip: Option<Duration>, timeout: Duration, now: LocalTime) {
        self.round_trip = round_trip;
        self.timeout = timeout + self.answer_wait;
        self.heard_at = Some(now);
    }

    /// An object exists. `tick` is the time that its bound speaks of. An unknown class is ignored: a peer's mistake.
    pub fn handle_roster(&mut self, entry: &RosterEntry, tick: WorldTime) {
        let class = usize::from(entry.class.0);
        if class >= self.classes.len() {
            self.stats.stale += 1;
            return;
        }
        self.handle_left(entry.object);
        let newer = self.violations.get(&entry.object).copied().filter(|violated| violated.issue > entry.issue);
        let present = newer.map_or(entry.present, |violated| violated.present);
        let valid_from = newer.map_or(tick, |violated| violated.at);
        let early = self.early.remove(&entry.object).filter(|state| present && state.tick >= valid_from);
        let belief = match (present, early) {
            (false, _) => Belief::Absent,
            (true, None) => Belief::Unknown,
            (true, Some(_)) => Belief::Visible,
        };
        let fresh = Entry {
            class,
            belief,
            issue: newer.map_or(entry.issue, |violated| violated.issue),
            valid_from,
            state: early,
            ask: None,
            due: None,
            stage_frames: 1,
            hidden_frames: 0,
            released_at: None,
            releasing: false,
            freshened_in: None,
            is_withheld: false,
            decision: (Decision::Named, self.latest),
        };
        self.entries.insert(entry.object, fresh);
        if early.is_some() {
            self.stats.revealed += 1;
            self.visible.insert(entry.object);
        }
        if !present || !self.tracking {
            return;
        }
        match entry.bound.filter(|_| newer.is_none()) {
            // Tested at the next frame.
            Some(bound) => self.hold(entry.object, bound.tbv(tick)),
            None if newer.is_some() && !self.is_staged() => self.ask(entry.object, Want::State, Reason::Violated),
            None => self.ask(entry.object, Want::Bound, Reason::Unknown),
        }
        self.debug_check();
    }

    /// Acts on bounds that came since the newest frame, whose `occlusion` this is, instead of at the next one: what has
    /// just come into the world may be in sight.
    pub fn handle_news(&mut self, occlusion: &dyn Occlusion) {
        let mut new = self.take_due(WorldTime::MIN);
        for object in new.drain(..) {
            self.settle(object, occlusion);
        }
        self.expired = new;
        self.debug_check();
    }

    /// An object exists no more.
    pub fn handle_left(&mut self, object: ObjectId) {
        self.leave_t_and_q(object);
        self.visible.remove(&object);
        self.asked.remove(&object);
        let entry = self.entries.remove(&object);
        // Whoever has its id next may have been told of before this was: states come beside the control stream. The roster
        // leaves out what is older than it.
        if let Some(state) = entry.and_then(|entry| entry.state).filter(|_| !self.tracking)
            && self.early.len() < EARLY_MAX
        {
            self.early.insert(object, state);
        }
    }

    /// Where an object was at a tick, and how it goes on. With the newest frame's `occlusion` it is decided at once whether an object that was
    /// asked for its place is in sight.
    pub fn handle_state(&mut self, object: ObjectId, state: State, occlusion: Option<&dyn Occlusion>, now: LocalTime) {
        let State { position, tick, .. } = state;
        let Some(entry) = self.entries.get_mut(&object) else {
            self.stats.stale += 1;
            if !self.tracking && self.early.len() < EARLY_MAX {
                self.early.insert(object, state);
            }
            return;
        };
        let is_old = tick < entry.valid_from || entry.state.is_some_and(|state| state.tick > tick);
        if is_old || matches!(entry.belief, Belief::Absent) {
            self.stats.stale += 1;
            if !is_old && !self.tracking {
                // It comes back, as a violation will say that got lost or overtaken.
                entry.state = Some(state);
            }
            return;
        }
        // Both ends check the promise of containment (STYLE, "Check a promise at both ends").
        if let Belief::Hidden(tbv) = entry.belief
            && tbv.holds_at(tick)
            && !tbv.contains(position.metres(), tick)
        {
            self.stats.broken_bounds += 1;
        }
        entry.is_withheld = false;
        entry.state = Some(state);
        let awaited = entry.ask.is_some_and(|ask| ask.want != Want::Bound);
        let is_place = entry.ask.is_some_and(|ask| ask.want == Want::Place && ask.heard);
        // What was pushed before the server got the question is shown, but it is no answer: the server may have stopped
        // telling since.
        if entry.ask.is_some_and(|ask| ask.want != Want::Bound && ask.heard) {
            entry.ask = None;
            self.asked.remove(&object);
        }
        let was_visible = matches!(entry.belief, Belief::Visible);
        if was_visible {
            if is_place {
                self.ask(object, Want::State, Reason::Exposed);
            }
            return;
        }
        if is_place && let Some(occlusion) = occlusion {
            // Nobody will tell of it again: it is out of sight, and a bound stands for it, or updates are asked for.
            if let Some(local) = self.local_tbv(object) {
                self.hold(object, local);
                if self.is_hidden_for_now(object, &local, occlusion) {
                    self.settle(object, occlusion);
                    self.debug_check();
                    return;
                }
            }
        }
        let Some(entry) = self.entries.get_mut(&object) else { return };
        if awaited || !self.tracking {
            entry.belief = Belief::Visible;
            entry.hidden_frames = 0;
            entry.released_at = None;
            entry.releasing = false;
            entry.decision = (Decision::Revealed, self.latest);
            self.stats.revealed += 1;
            self.leave_t_and_q(object);
            self.visible.insert(object);
            if is_place {
                self.ask(object, Want::State, Reason::Exposed);
            }
        } else {
            // Declined already: say so again if that may have got lost. What it tells is not wasted on the bound.
            self.stats.unwanted += 1;
            if entry.released_at.is_none_or(|at| now.since(at) > self.timeout) {
                entry.released_at = Some(now);
                self.out.push_back(ClientRecord::Release { object, want_bound: false });
            }
            if let Belief::Hidden(tbv) = entry.belief
                && entry.ask.is_none()
                && tick > tbv.issued
            {
                let local = self.local_tbv(object);
                if let Some(local) = local {
                    self.hold(object, local);
                }
            }
        }
        self.debug_check();
    }

    /// Where an object may be. If `occlusion` of the newest frame is given, what the bound says is acted on at once
    /// instead of at the next frame.
    pub fn handle_bound(&mut self, object: ObjectId, tbv: Tbv, occlusion: Option<&dyn Occlusion>) {
        let Some(entry) = self.entries.get_mut(&object) else {
            self.stats.stale += 1;
            return;
        };
        // A server that checks may answer a question for the place with a bound: it is not for us to know.
        let is_withheld = entry.is_withheld || entry.ask.is_some_and(|ask| ask.want != Want::Bound && ask.heard);
        let awaited = entry.releasing || is_withheld || entry.ask.is_some_and(|ask| ask.want == Want::Bound);
        let is_void =
            tbv.issue < entry.issue || tbv.issued < entry.valid_from || matches!(entry.belief, Belief::Absent);
        let is_older = matches!(entry.belief, Belief::Hidden(held) if held.issued > tbv.issued);
        let is_void = is_void && self.config.sabotage != Some(Sabotage::AcceptStaleIssue);
        if is_void || is_older || !awaited {
            self.stats.stale += 1;
            return;
        }
        if tbv.issue > entry.issue {
            // It tells of a violation that has not been heard of yet: what was known from before is void.
            entry.valid_from = entry.valid_from.max(tbv.issued);
        }
        entry.issue = tbv.issue;
        if is_withheld || entry.ask.is_some_and(|ask| ask.want == Want::Bound) {
            entry.ask = None;
            self.asked.remove(&object);
        }
        if entry.releasing {
            entry.releasing = false;
            self.visible.remove(&object);
        }
        entry.freshened_in = Some(self.stats.frames);
        entry.is_withheld = false;
        self.hold(object, tbv);
        // What was withheld is looked at again with the next frame: at once would be to ask as fast as the path answers.
        if let Some(occlusion) = occlusion.filter(|_| !is_withheld) {
            self.settle(object, occlusion);
        }
        self.debug_check();
    }

    /// An object broke its bounds at `at`: whatever was known from before is void.
    pub fn handle_violation(&mut self, object: ObjectId, issue: Issue, at: WorldTime, present: bool) {
        self.out.push_back(ClientRecord::ViolationAck { object, issue });
        let may_grow = self.entries.contains_key(&object) || self.violations.len() < EARLY_MAX;
        if may_grow && self.violations.get(&object).is_none_or(|known| known.issue < issue) {
            self.violations.insert(object, Violated { issue, at, present });
        }
        let Some(entry) = self.entries.get_mut(&object) else { return };
        if issue <= entry.issue {
            return;
        }
        self.stats.violated += 1;
        if matches!(entry.belief, Belief::Hidden(_)) {
            self.stats.broken_believed_micros += self.latest.since(at).as_micros() as u64;
        }
        entry.issue = issue;
        entry.valid_from = at;
        if !present {
            entry.belief = Belief::Absent;
            entry.decision = (Decision::Left, self.latest);
            entry.ask = None;
            entry.releasing = false;
            entry.state = None;
            self.asked.remove(&object);
            self.visible.remove(&object);
            self.leave_t_and_q(object);
        } else if !(matches!(entry.belief, Belief::Visible) && entry.state.is_some_and(|state| state.tick >= at)) {
            let has_come = !self.tracking && entry.state.is_some_and(|state| state.tick >= at);
            let is_told = matches!(entry.belief, Belief::Visible) || has_come;
            entry.belief = if is_told { Belief::Visible } else { Belief::Unknown };
            self.leave_t_and_q(object);
            if has_come {
                self.stats.revealed += 1;
                self.visible.insert(object);
            }
            // What is shown is drawn where it was until its new state comes. It is asked for too: if it left the world
            // and came back, the server has stopped telling of it.
            if self.tracking {
                let want = if !is_told && self.is_staged() { Want::Bound } else { Want::State };
                self.ask(object, want, Reason::Violated);
            }
        }
        self.debug_check();
    }

    /// The server no longer tells of an object.
    pub fn handle_hidden(&mut self, object: ObjectId, tick: WorldTime) {
        if self.tracking {
            // A server that checks has found it out of sight, and says with a bound where it may be from now on.
            if let Some(entry) = self.entries.get_mut(&object)
                && matches!(entry.belief, Belief::Visible)
                && entry.state.is_none_or(|state| state.tick <= tick)
            {
                entry.is_withheld = true;
            }
            return;
        }
        if let Some(entry) = self.entries.get_mut(&object)
            && entry.state.is_none_or(|state| state.tick <= tick)
        {
            entry.belief = Belief::Unknown;
            self.visible.remove(&object);
        }
    }

    /// One frame of §3.3: `latest` is the latest time that the server may have, `ahead` the lead, and `occlusion` what hides
    /// things from every eye within the lead's radius.
    pub fn frame(&mut self, latest: WorldTime, ahead: Ahead, occlusion: &dyn Occlusion, now: LocalTime) {
        self.stats.frames += 1;
        self.latest = self.latest.max(latest);
        self.ahead = ahead;
        self.horizon = self.horizon.max(self.latest + ahead.time);
        let version = occlusion.version();
        let is_same = version.is_some() && version == self.version;
        self.is_still = is_same && occlusion.stays();
        self.version = version;
        self.look_at_parts(occlusion);
        self.stats.still_frames += u64::from(self.is_still);
        self.is_cut_off = self.heard_at.is_some_and(|at| now.since(at) > STALENESS_MAX);
        self.ask_again(now);
        if !self.tracking {
            // Every object every frame: the baseline without bounds. What is hidden is known all the same.
            self.test_visible(occlusion, now);
            return;
        }
        // Step 1: stages and bounds whose time is up, as Q tells.
        while let Some(due) = self.queue.next_due().filter(|&due| due <= self.horizon) {
            let mut expired = self.take_due(due);
            for object in expired.drain(..) {
                if let Some(entry) = self.entries.get_mut(&object) {
                    entry.stage_frames = (entry.stage_frames * 2).min(self.config.stage_frames_max);
                }
                self.stats.stages += 1;
                self.settle(object, occlusion);
            }
            self.expired = expired;
        }
        // Step 3: what of T can be seen. (Step 2, the update of visible objects, is the server's push.) What entered T was hidden
        // when it did, and so it is of who sees what was seen then.
        if is_same && self.tests_all_of_t() {
            debug_assert!(self.shows_nothing_of_t(occlusion), "something entered T that is not hidden");
        } else {
            self.look_at_t(occlusion);
        }
        // Step 4: what of V can't be seen any more.
        self.let_go(occlusion, now);
        self.debug_check();
    }

    /// Step 3.
    fn look_at_t(&mut self, occlusion: &dyn Occlusion) {
        let mut exposed = std::mem::take(&mut self.exposed);
        exposed.clear();
        self.stats.work += self.index.exposed(occlusion, &mut exposed) as u64;
        for &key in &exposed {
            let object = ObjectId(key);
            if let Some(entry) = self.entries.get_mut(&object) {
                entry.stage_frames = (entry.stage_frames / 2).max(1);
            }
            self.settle(object, occlusion);
        }
        self.exposed = exposed;
    }

    fn shows_nothing_of_t(&self, occlusion: &dyn Occlusion) -> bool {
        let mut exposed = Vec::new();
        self.index.exposed(occlusion, &mut exposed);
        exposed.is_empty()
    }

    /// Whether nothing enters T but what is hidden as it lies there. The paper's way has bounds of a frame ahead there, too.
    fn tests_all_of_t(&self) -> bool {
        self.config.growth == Growth::AtClient && self.config.sabotage.is_none()
    }

    /// Once the eyes see into other parts of the scene, what was sealed off from them is looked at again.
    fn look_at_parts(&mut self, occlusion: &dyn Occlusion) {
        if occlusion.parts() == self.parts.as_deref() {
            return;
        }
        self.parts = occlusion.parts().map(<[u32]>::to_vec);
        for object in std::mem::take(&mut self.sealed) {
            if let Some(Belief::Hidden(tbv)) = self.entries.get(&object).map(|entry| entry.belief) {
                self.hold(object, tbv);
            }
        }
    }

    /// Takes out of Q what is due by `due`. In the order of ids, on which the order of questions depends: what falls together
    /// lies in Q as it came.
    fn take_due(&mut self, due: WorldTime) -> Vec<ObjectId> {
        let mut expired = std::mem::take(&mut self.expired);
        expired.clear();
        self.queue.expire(due, &mut expired);
        expired.sort_unstable();
        for object in &expired {
            if let Some(entry) = self.entries.get_mut(object) {
                entry.due = None;
            }
        }
        expired
    }

    /// Tests each object of V where it may be by now; those that have been hidden for long enough, or are let go of already.
    fn test_visible(&mut self, occlusion: &dyn Occlusion, now: LocalTime) -> Vec<ObjectId> {
        // A change would have been pushed: what was not heard of for longer than this is where it was thought to be then.
        let period = self.config.frame + self.config.frame.max(self.tick);
        let silence = (period + self.round_trip.unwrap_or_default()).as_secs_f64();
        let ahead = self.ahead.time.as_secs_f64();
        let linger = self.config.linger_frames.max(1);
        let mut gone = Vec::new();
        self.stats.work += self.visible.len() as u64;
        for object in &self.visible {
            let Some(entry) = self.entries.get_mut(object) else { continue };
            if let Some(state) = entry.state {
                let class = &self.classes[entry.class];
                // Where updates were declined, silence says nothing about the time since.
                let released_at = entry.released_at.filter(|_| entry.releasing);
                let declined = released_at.map_or(0.0, |at| now.since(at).as_secs_f64());
                let (latest, silence) = (self.latest, silence + declined);
                let (middle, reach) = dead_reckoning::ball(&state, class.motion, latest, silence, self.tolerance);
                // Where it may get to by the end of the lead.
                let bound = extent_bound(class, middle, reach + class.motion.speed_max * ahead);
                entry.hidden_frames = if occlusion.hides(&bound) { entry.hidden_frames + 1 } else { 0 };
            }
            if entry.releasing || entry.hidden_frames >= linger {
                gone.push(*object);
            }
        }
        gone
    }

    /// Declines updates of what has been hidden for long enough, and lets a bound stand for it.
    fn let_go(&mut self, occlusion: &dyn Occlusion, now: LocalTime) {
        for object in self.test_visible(occlusion, now) {
            let local = self.local_tbv(object);
            let Some(entry) = self.entries.get_mut(&object) else { continue };
            if entry.releasing && entry.hidden_frames == 0 {
                // In sight again before the bound came: it is shown as it was, and asked for at once, since to wait for
                // the bound first could cost a round trip more than the promise allows.
                entry.releasing = false;
                self.stats.exposed += 1;
                self.ask(object, Want::State, Reason::Exposed);
                continue;
            }
            if entry.releasing {
                // The server has stopped telling: the bound must come.
                if entry.released_at.is_some_and(|at| now.since(at) > self.timeout) {
                    entry.released_at = Some(now);
                    self.stats.resent += 1;
                    self.out.push_back(ClientRecord::Release { object, want_bound: true });
                }
                continue;
            }
            self.stats.released += 1;
            entry.ask = None;
            self.asked.remove(&object);
            entry.released_at = Some(now);
            entry.decision = (Decision::Released, self.latest);
            entry.releasing = local.is_none();
            self.out.push_back(ClientRecord::Release { object, want_bound: local.is_none() });
            if let Some(local) = local {
                self.hold(object, local);
                self.settle(object, occlusion);
            }
        }
    }

    /// Whether what `tbv` bounds is out of sight, and will be for the time that a round of questions takes.
    fn is_hidden_for_now(&mut self, object: ObjectId, tbv: &Tbv, occlusion: &dyn Occlusion) -> bool {
        let Some(entry) = self.entries.get(&object) else { return false };
        let soon = self.horizon.offset_micros(self.config.frame.as_micros() as i64);
        let bound = extent_bound(&self.classes[entry.class], tbv.centre.metres(), tbv.radius_at(soon));
        self.stats.work += 1;
        occlusion.hides(&bound)
    }

    /// A bound made of the last exact state, which costs no message; `None` if that is so old that a fresh bound from
    /// the server would be tighter.
    fn local_tbv(&self, object: ObjectId) -> Option<Tbv> {
        let entry = self.entries.get(&object)?;
        let state = entry.state?;
        if state.tick < entry.valid_from {
            return None;
        }
        let motion = self.classes[entry.class].motion;
        let age = self.latest.seconds_since(state.tick).max(0.0);
        if motion.speed_max * age > 0.5 * self.blur.max(0.1) {
            return None;
        }
        Some(Tbv {
            centre: state.position,
            radius: motion.slack,
            speed: motion.speed_max,
            issued: state.tick,
            expires: WorldTime::MAX,
            issue: entry.issue,
        })
    }

    /// Step 4 c–e: from now on `tbv` stands for the object. It is due in Q at once, so that the next frame (or
    /// [`Tracker::settle`]) finds its stage.
    fn hold(&mut self, object: ObjectId, tbv: Tbv) {
        self.leave_t_and_q(object);
        self.visible.remove(&object);
        let Some(entry) = self.entries.get_mut(&object) else { return };
        entry.belief = Belief::Hidden(tbv);
        entry.stage_frames = entry.stage_frames.clamp(1, 8);
        entry.due = Some(WorldTime::MIN);
        self.queue.insert(object, WorldTime::MIN);
    }

    /// Finds the longest stage for which a held bound is hidden and puts it into T and Q so; asks if it is exposed
    /// even as it is now, or has expired.
    fn settle(&mut self, object: ObjectId, occlusion: &dyn Occlusion) {
        // It stays in T and Q until it moves there, or is asked for: T then moves it under the least common ancestor only.
        self.sealed.remove(&object);
        let Some(entry) = self.entries.get_mut(&object) else { return };
        let tbv = match entry.belief {
            Belief::Hidden(tbv) if entry.ask.is_none() => tbv,
            _ => return self.leave_t_and_q(object),
        };
        let horizon = self.horizon;
        let class = &self.classes[entry.class];
        let frame_micros = self.config.frame.as_micros() as i64;
        let bound_at = |time: WorldTime| extent_bound(class, tbv.centre.metres(), tbv.radius_at(time));
        let fixed_expiry = match self.config.growth {
            Growth::AtClient => tbv.expires,
            Growth::FixedPeriod(period) => tbv.expires.min(tbv.issued + period),
        };
        let fixed_expiry =
            if self.config.sabotage == Some(Sabotage::IgnoreExpiry) { WorldTime::MAX } else { fixed_expiry };
        if horizon >= fixed_expiry {
            self.stats.expired += 1;
            let want = if self.is_staged() { Want::Bound } else { Want::State };
            return self.ask(object, want, Reason::Expired);
        }
        let mut tested = 0;
        let mut hidden = |bound: Bound| {
            tested += 1;
            occlusion.hides(&bound)
        };
        if let Growth::FixedPeriod(_) = self.config.growth {
            // The paper's way: the bound for the whole period is hidden, or it is exposed.
            let grown = bound_at(fixed_expiry);
            if hidden(grown) || hidden(bound_at(horizon)) {
                let is_whole = hidden(grown);
                let bound = if is_whole { grown } else { bound_at(horizon.offset_micros(frame_micros)) };
                let due = if is_whole { fixed_expiry } else { horizon.offset_micros(1) };
                self.stats.work += tested;
                return self.keep(object, bound, due);
            }
            self.stats.work += tested;
            return self.expose(object, tbv);
        }
        // The parts that were asked about must be those that the next frame is held against.
        let knows_parts =
            self.config.sealed && occlusion.parts().is_some_and(|parts| self.parts.as_deref() == Some(parts));
        if knows_parts && tbv.speed == 0.0 && occlusion.seals_off(&bound_at(horizon)) {
            entry.decision = (Decision::SealedOff, self.latest);
            entry.due = Some(fixed_expiry);
            self.stats.work += 1;
            self.stats.sealed += 1;
            self.index.remove(object.0);
            self.queue.insert(object, fixed_expiry);
            self.sealed.insert(object);
            return;
        }
        let end_of =
            |frames: u32| horizon.offset_micros(frame_micros.saturating_mul(i64::from(frames))).min(fixed_expiry);
        let is_exact = self.is_still && self.config.exact;
        let mut frames = entry.stage_frames;
        // What is hidden as it will have grown is hidden now, which it mostly is.
        let mut is_hidden = !is_exact && hidden(bound_at(end_of(frames)));
        if !is_hidden && !hidden(bound_at(horizon)) {
            self.stats.work += tested;
            return self.expose(object, tbv);
        }
        if is_exact {
            // What does not grow is hidden for as long as it is now.
            let exact = match tbv.speed > 0.0 {
                true => longest_hidden(frames, |frames| hidden(bound_at(end_of(frames)))),
                false => EXACT_FRAMES_MAX,
            };
            if exact > 0 {
                let end = end_of(exact);
                entry.stage_frames = exact.min(self.config.stage_frames_max);
                entry.decision = (Decision::Hidden { frames: exact }, self.latest);
                self.stats.work += tested;
                return self.keep(object, bound_at(end), end);
            }
            frames = 0;
        }
        while frames > 0 {
            if is_hidden {
                let end = end_of(frames);
                entry.stage_frames = frames;
                entry.decision = (Decision::Hidden { frames }, self.latest);
                self.stats.work += tested;
                return self.keep(object, bound_at(end), end);
            }
            frames /= 2;
            is_hidden = frames > 0 && hidden(bound_at(end_of(frames)));
        }
        // Hidden now, but perhaps not by the next frame: look again then.
        entry.stage_frames = 1;
        entry.decision = (Decision::HiddenForNow, self.latest);
        self.stats.work += tested;
        let bound_now = bound_at(horizon);
        self.keep(object, bound_now, horizon.offset_micros(1));
    }

    fn keep(&mut self, object: ObjectId, bound: Bound, due: WorldTime) {
        self.index.insert(object.0, bound);
        self.queue.insert(object, due);
        if let Some(entry) = self.entries.get_mut(&object) {
            entry.due = Some(due);
        }
    }

    /// A bound has become visible as it is now.
    fn expose(&mut self, object: ObjectId, tbv: Tbv) {
        if self.config.sabotage == Some(Sabotage::DropExposures) {
            let nowhere = Bound::Sphere { centre: DVec3::splat(1e9), radius: 0.0 };
            self.keep(object, nowhere, WorldTime::MAX);
            return;
        }
        self.stats.exposed += 1;
        // A fresh bound helps only if it is a good deal tighter than this one has become.
        let Some(entry) = self.entries.get(&object) else { return };
        // The server's bounds are nested, so that it may not have a tighter one before this one has grown: to ask again at
        // once would be to ask for ever.
        let fresh = (self.blur + self.classes[entry.class].motion.slack).max(tbv.radius);
        // One that does not grow would come back the same, again and again; so may one that has just been asked for.
        let is_new = entry.freshened_in == Some(self.stats.frames);
        let gains = !is_new && tbv.speed > 0.0 && tbv.radius_at(self.latest) > 1.25 * fresh + 0.05;
        // A place comes as soon as a state would, so that it is never later; updates follow if it is in sight.
        let want = if gains && self.is_staged_for(entry) { Want::Bound } else { Want::Place };
        self.ask(object, want, Reason::Exposed);
    }

    /// Whether to ask for a bound before a state: only if both round trips fit in one frame, so that the promise's
    /// bound on lateness holds.
    fn is_staged(&self) -> bool {
        // A quarter of the frame each, since the next may be slower still and the answer needs time at both ends.
        self.config.staged
            && self.round_trip.is_some_and(|round_trip| (round_trip + self.answer_wait) * 4 < self.config.frame)
    }

    /// Whether to ask for a bound first of an object that has been found hidden before: the lead may have time for both
    /// round trips, too. For who has just come there was no lead.
    fn is_staged_for(&self, entry: &Entry) -> bool {
        let was_hidden =
            matches!(entry.decision.0, Decision::Hidden { .. } | Decision::HiddenForNow | Decision::SealedOff);
        let fits = |round_trip: Duration| (round_trip + self.answer_wait) * 2 + self.config.frame <= self.ahead.time;
        self.is_staged() || self.config.staged && was_hidden && self.round_trip.is_some_and(fits)
    }

    fn ask(&mut self, object: ObjectId, want: Want, reason: Reason) {
        self.leave_t_and_q(object);
        let late = self.config.sabotage == Some(Sabotage::LateOneTick);
        if let Some(entry) = self.entries.get_mut(&object) {
            let not_before = late.then_some(self.stats.frames + 1);
            entry.decision = (Decision::Asked { want, reason }, self.latest);
            self.asks += 1;
            let is_unsaid = !late;
            let since = self.stats.frames;
            entry.ask = Some(Ask {
                want,
                reason,
                sent_at: None,
                not_before,
                is_unsaid,
                since,
                number: self.asks,
                heard: false,
            });
            self.asked.insert(object);
            if is_unsaid {
                self.unsaid.push_back(object);
            }
        }
    }

    fn leave_t_and_q(&mut self, object: ObjectId) {
        self.index.remove(object.0);
        self.sealed.remove(&object);
        if let Some(entry) = self.entries.get_mut(&object)
            && entry.due.take().is_some()
        {
            self.queue.cancel(object);
        }
    }

    /// The number of the question that is being asked about `object`, for [`Tracker::handle_heard`].
    pub fn ask_number(&self, object: ObjectId) -> Option<u64> {
        Some(self.entries.get(&object)?.ask?.number)
    }

    /// The server has got the question of this number.
    pub fn handle_heard(&mut self, object: ObjectId, number: u64) {
        if let Some(ask) = self.entries.get_mut(&object).and_then(|entry| entry.ask.as_mut())
            && ask.number == number
        {
            ask.heard = true;
        }
    }

    /// The next thing to say. Requests are repeated until answered.
    pub fn poll_record(&mut self, now: LocalTime) -> Option<ClientRecord> {
        if let Some(record) = self.out.pop_front() {
            return Some(record);
        }
        while let Some(object) = self.unsaid.pop_front() {
            // Answered meanwhile, or asked for something else, which stands further back.
            let ask = self.entries.get_mut(&object).and_then(|entry| entry.ask.as_mut());
            let Some(ask) = ask.filter(|ask| ask.is_unsaid) else { continue };
            ask.is_unsaid = false;
            ask.sent_at = Some(now);
            return Some(ClientRecord::Request { object, want: ask.want, reason: ask.reason });
        }
        None
    }

    /// Puts questions that have waited too long for an answer, or were held back, where they are said next.
    fn ask_again(&mut self, now: LocalTime) {
        let frames = self.stats.frames;
        for &object in &self.asked {
            let Some(ask) = self.entries.get_mut(&object).and_then(|entry| entry.ask.as_mut()) else { continue };
            let is_lost = ask.sent_at.is_some_and(|at| now.since(at) > self.timeout);
            let is_lost = is_lost && self.config.sabotage != Some(Sabotage::NeverRepeat);
            let is_late = ask.sent_at.is_none() && ask.not_before.is_some_and(|frame| frames >= frame);
            if !ask.is_unsaid && (is_lost || is_late) {
                self.stats.resent += u64::from(is_lost);
                ask.is_unsaid = true;
                self.unsaid.push_back(object);
            }
        }
    }

    /// Whether an object's place has been asked for in vain for so long that what is known of it is not to be shown.
    fn is_stale(&self, entry: &Entry) -> bool {
        let frames = STALENESS_MAX.as_micros() / self.config.frame.as_micros().max(1);
        entry.ask.is_some_and(|ask| u128::from(self.stats.frames - ask.since) > frames)
    }

    /// What the client knows the place of, by id: V. The second part says whether it is drawn in the newest frame, that
    /// is, not hidden in it.
    pub fn known(&self) -> impl Iterator<Item = (Drawn, bool)> + '_ {
        self.visible.iter().filter(|_| !self.is_cut_off).filter_map(|&object| {
            let entry = self.entries.get(&object).filter(|entry| !self.is_stale(entry))?;
            let state = entry.state?;
            let position = dead_reckoning::drawn(&state, self.latest);
            let State { orientation, tick, velocity, .. } = state;
            Some((Drawn { object, position, orientation, tick, velocity }, entry.hidden_frames == 0))
        })
    }

    /// Where one object is shown, if it is.
    pub fn shown(&self, object: ObjectId) -> Option<Drawn> {
        self.drawn().find(|drawn| drawn.object == object)
    }

    /// What the client shows in the newest frame, by id.
    pub fn drawn(&self) -> impl Iterator<Item = Drawn> + '_ {
        self.known().filter(|&(_, is_drawn)| is_drawn).map(|(drawn, _)| drawn)
    }

    /// Whether anything at all is known of where `object` is (a bound, or a state).
    pub fn knows(&self, object: ObjectId) -> bool {
        self.entries.get(&object).is_some_and(|entry| !matches!(entry.belief, Belief::Unknown))
    }

    /// The bound that stands for `object`, if it is held hidden or was until it was asked for.
    pub fn held(&self, object: ObjectId) -> Option<Tbv> {
        match self.entries.get(&object)?.belief {
            Belief::Hidden(tbv) => Some(tbv),
            Belief::Unknown | Belief::Visible | Belief::Absent => None,
        }
    }

    /// Why an object is shown, or not; `None` if nobody has named it.
    pub fn explain(&self, object: ObjectId) -> Option<Explanation> {
        let entry = self.entries.get(&object)?;
        let (belief, tbv) = match entry.belief {
            Belief::Unknown => (BeliefKind::Unknown, None),
            Belief::Hidden(tbv) => (BeliefKind::Hidden, Some(tbv)),
            Belief::Visible => (BeliefKind::Visible, None),
            Belief::Absent => (BeliefKind::Absent, None),
        };
        let class = &self.classes[entry.class];
        let until = entry.due.unwrap_or(self.horizon).max(self.horizon);
        Some(Explanation {
            belief,
            tbv,
            tested: tbv.map(|tbv| extent_bound(class, tbv.centre.metres(), tbv.radius_at(until))),
            decision: entry.decision,
            asked: entry.ask.map(|ask| (ask.want, ask.reason, ask.heard)),
            due: entry.due,
            state_of: entry.state.map(|state| state.tick),
            hidden_frames: entry.hidden_frames,
        })
    }

    /// Number of objects in V, held hidden, and awaiting an answer.
    pub fn counts(&self) -> (usize, usize, usize) {
        (self.visible.len(), self.index.len() + self.sealed.len(), self.asked.len())
    }

    /// Counters since the start.
    pub fn stats(&self) -> &TrackerStats {
        &self.stats
    }

    /// T, D, Q and V agree. Called after each mutation in debug builds.
    fn debug_check(&self) {
        if !cfg!(debug_assertions) {
            return;
        }
        let mut in_queue = 0;
        for (object, entry) in self.entries.iter() {
            assert_eq!(self.asked.contains(object), entry.ask.is_some(), "{object}: asked set and entry disagree");
            assert_eq!(
                self.visible.contains(object),
                matches!(entry.belief, Belief::Visible),
                "{object}: V and entry disagree"
            );
            if let Some(due) = entry.due {
                in_queue += 1;
                assert_eq!(self.queue.due(*object), Some(due), "{object}: not in Q");
                assert!(matches!(entry.belief, Belief::Hidden(_)), "{object}: in Q but not hidden");
                assert!(entry.ask.is_none(), "{object}: in Q though asked for");
            } else if matches!(entry.belief, Belief::Hidden(_) | Belief::Unknown) && self.tracking {
                assert!(entry.ask.is_some(), "{object}: forgotten: neither in Q nor asked for");
            }
        }
        assert_eq!(self.queue.len(), in_queue, "Q holds what no entry does");
        assert!(
            self.index.len() + self.sealed.len() <= self.queue.len(),
            "T holds what Q does not, or what is sealed off"
        );
        assert!(self.sealed.iter().all(|object| self.queue.due(*object).is_some()), "sealed off and not in Q");
    }
}

/// The most frames that a still eye looks ahead: an hour at 20 a second, for which bounds hold.
const EXACT_FRAMES_MAX: u32 = 1 << 16;

/// For how many frames from now a bound stays hidden, found by doubling from a guess and bisection (§3.4); 0 if not for one.
fn longest_hidden(guess: u32, mut hidden: impl FnMut(u32) -> bool) -> u32 {
    let (mut unseen, mut next) = (0, guess.clamp(1, EXACT_FRAMES_MAX));
    let mut seen = loop {
        if !hidden(next) {
            break next;
        }
        if next >= EXACT_FRAMES_MAX {
            return next;
        }
        unseen = next;
        next *= 2;
    };
    while seen - unseen > 1 {
        let middle = unseen + (seen - unseen) / 2;
        if hidden(middle) { unseen = middle } else { seen = middle }
    }
    unseen
}

/// The upright cylinder of an object whose reference point is within `reach` of `centre`. One part in 10⁹ and a micrometre
/// larger, which covers the rounding of coordinates up to the edge of the world.
fn extent_bound(class: &Class, centre: DVec3, reach: f64) -> Bound {
    let reach = reach * (1.0 + 1e-9) + 1e-6;
    let (low, high) = (class.extent.bottom - reach, class.extent.top + reach);
    Bound::Upright {
        centre: centre + DVec3::Y * (0.5 * (low + high)),
        radius: class.extent.radius + reach,
        half_height: 0.5 * (high - low),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_exact_moment_is_found_from_any_guess() {
        for last in [0, 1, 2, 3, 7, 100, 5_000, EXACT_FRAMES_MAX, u32::MAX] {
            for guess in [0, 1, 5, 128] {
                let mut asked = 0;
                let found = longest_hidden(guess, |frames| {
                    asked += 1;
                    frames <= last
                });
                // A guess that is no power of two ends a little beyond the most.
                assert!(found >= last.min(EXACT_FRAMES_MAX) && found <= last, "{last} from {guess}: {found}");
                assert!(asked <= 2 * 17 + 1, "{asked}");
            }
        }
    }
}
