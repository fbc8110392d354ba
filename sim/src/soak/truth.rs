//! Checkers that see everything: is each hidden object where its bound says, and is what can be seen drawn in time?

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::Arc;
use std::time::Duration;

use eyeline_client::session::Session;
use eyeline_protocol::{Issue, ObjectId, WorldTime};
use eyeline_server::world::{Object, World};
use eyeline_visibility::{Aabb, Bound};
use glam::DVec3;

use super::failures::Failures;
use super::index::IndexView;
use super::walls::Walls;
use crate::virtual_net::{Direction, Framed, Kind, LinkRules, Observer, Passing};

/// What a client's link is known to do: how late something may be.
#[derive(Clone, Copy, Debug)]
pub struct Allowance {
    /// Longest way to the server.
    pub up_max: Duration,
    /// Longest way from the server.
    pub down_max: Duration,
    /// How long an answer waits at the server at most.
    pub answer_wait: Duration,
    /// Whether the client looks ahead, so that what comes into view is to be there at once.
    pub lead: bool,
}

impl Allowance {
    /// What these rules allow.
    pub fn of(up: LinkRules, down: LinkRules) -> Allowance {
        Allowance { up_max: up.one_way_max(), down_max: down.one_way_max(), answer_wait: Duration::ZERO, lead: false }
    }

    /// Expects answers to wait for so long.
    pub fn with_answer_wait(self, answer_wait: Duration) -> Allowance {
        Allowance { answer_wait, ..self }
    }

    /// Expects a lead, or none.
    pub fn with_lead(self, lead: bool) -> Allowance {
        Allowance { lead, ..self }
    }

    /// The greatest time from a question to its answer: a round trip, and what the answer waits. Work takes no virtual time.
    pub fn round_trip_max(&self) -> Duration {
        self.up_max + self.answer_wait + self.down_max
    }
}

/// One object's past.
#[derive(Default)]
struct Past {
    alive: bool,
    issue: Issue,
    /// Tick of the newest violation: a bound from before it is void.
    violated_tick: Option<WorldTime>,
    /// True time of it.
    violated_at: Option<WorldTime>,
    /// True time at which this id came into use.
    appeared_at: Option<WorldTime>,
    /// Newest changes of state: tick, and true time of its commit.
    changes: VecDeque<(WorldTime, WorldTime)>,
}

struct Watcher {
    view: IndexView,
    allowance: Allowance,
    /// Since when an object has been truly visible in every frame.
    seen_since: BTreeMap<ObjectId, WorldTime>,
    /// Lost datagrams that spoke of an object.
    lost: BTreeMap<ObjectId, VecDeque<WorldTime>>,
    /// Lost packets of the control stream, which hold up what comes after.
    lost_control: VecDeque<WorldTime>,
    retry_max: Duration,
    /// When it made its first frame.
    began: Option<WorldTime>,
    /// Its eye in its newest frame, and when that last came from where nobody can walk from: a lead is no help then.
    eye: Option<(DVec3, WorldTime)>,
    leapt: WorldTime,
    /// Newest round trips that a lead could know of, with their variation.
    foreseen: VecDeque<(WorldTime, Duration)>,
    /// When it heard of the server last, and when it did so after a long silence.
    heard: WorldTime,
    silent_until: WorldTime,
    /// Since when an object that should be drawn, or drawn elsewhere, has not been.
    awaited: BTreeMap<ObjectId, WorldTime>,
}

/// Watches a run over [`Walls`] and records each promise that is broken (DESIGN §3.2 and §3.3).
pub struct Truth {
    walls: Arc<Walls>,
    objects: Vec<Past>,
    watchers: BTreeMap<usize, Watcher>,
    /// What was wrong.
    pub failures: Failures,
    /// Bounds that were compared with the truth.
    pub bounds_checked: u64,
    /// Object-frames in which an object was truly visible.
    pub visible_checked: u64,
    /// Of these, the ones in which it was not drawn (yet).
    pub not_drawn: u64,
    /// Object-frames in which a bound was believed that its object had broken on purpose.
    pub broken_believed: u64,
    /// Shown states that were compared with the truth.
    pub states_checked: u64,
}

/// How far back a loss may still matter to what is late now.
const LOSS_WINDOW: Duration = Duration::from_millis(1_500);

/// A lead is known to be as long as a path needs only once it has been so for a while.
const FORESIGHT_WINDOW: Duration = Duration::from_millis(1_000);

/// Who hears of the server is told something with every tick. Who is not for so long is in the dark, and then nothing can be in time.
const SILENCE_MIN: Duration = Duration::from_millis(500);

/// Who has not heard of the server for so long shows nothing (DESIGN §5); a frame less, since its clock is another.
const SILENCE_MAX: Duration = Duration::from_millis(4_900);

/// So many changes of an object are remembered: 10 s at 20 Hz.
const CHANGES_MAX: usize = 200;

impl Truth {
    /// A checker for a scene.
    pub fn new(walls: Arc<Walls>) -> Truth {
        Truth {
            walls,
            objects: Vec::new(),
            watchers: BTreeMap::new(),
            failures: Failures::default(),
            bounds_checked: 0,
            visible_checked: 0,
            not_drawn: 0,
            broken_believed: 0,
            states_checked: 0,
        }
    }

    /// Checks this client from now on.
    pub fn watch(&mut self, client: usize, view: IndexView, allowance: Allowance) {
        let watcher = Watcher {
            view,
            allowance,
            seen_since: BTreeMap::new(),
            lost: BTreeMap::new(),
            lost_control: VecDeque::new(),
            retry_max: Duration::ZERO,
            began: None,
            eye: None,
            leapt: WorldTime::MIN,
            foreseen: VecDeque::new(),
            heard: WorldTime::MIN,
            silent_until: WorldTime::MIN,
            awaited: BTreeMap::new(),
        };
        self.watchers.insert(client, watcher);
    }

    /// Fails the test if anything was wrong.
    #[track_caller]
    pub fn assert_kept(&self, what: &str) {
        self.failures.assert_none(what);
    }

    /// Whether `client` truly saw `object` in its newest frame.
    pub fn sees(&self, client: usize, object: ObjectId) -> bool {
        self.watchers.get(&client).is_some_and(|watcher| watcher.seen_since.contains_key(&object))
    }

    fn learn(&mut self, world: &World, at: WorldTime) {
        let tick = world.committed_at();
        self.objects.resize_with(world.objects().len(), Past::default);
        for (object, past) in world.objects().iter().zip(&mut self.objects) {
            let is_new = object.alive && (!past.alive || past.issue != object.issue && past.issue == Issue(0));
            if object.alive && (!past.alive || past.issue != object.issue) {
                past.violated_tick = Some(tick);
                past.violated_at = Some(at);
            }
            if is_new {
                past.appeared_at = Some(at);
            }
            (past.alive, past.issue) = (object.alive, object.issue);
            if past.changes.back().is_none_or(|&(changed, _)| changed < object.changed_at) {
                past.changes.push_back((object.changed_at, at));
                if past.changes.len() > CHANGES_MAX {
                    past.changes.pop_front();
                }
            }
        }
    }

    fn note_lost(&mut self, message: &Passing<'_>) {
        let Some(watcher) = self.watchers.get_mut(&message.client) else { return };
        if message.kind == Kind::Control {
            return watcher.lost_control.push_back(message.at);
        }
        for object in message.spoken_of() {
            watcher.lost.entry(object).or_default().push_back(message.at);
        }
    }

    fn check(&mut self, frame: &Framed<'_>) {
        let Truth { walls, objects, watchers, failures, .. } = self;
        let Some(watcher) = watchers.get_mut(&frame.client) else { return };
        let (Some(eye), Some(tracker), Some(time)) = (frame.eye, frame.session.tracker(), frame.time) else { return };
        let Some(welcome) = frame.session.welcome() else { return };
        let at = frame.at;
        let mut fail = |text: String| failures.note(frame.client, at, || text);
        if time.latest < at {
            fail(format!("its latest possible server time is {} µs early", at.micros() - time.latest.micros()));
        }
        watcher.retry_max = watcher.retry_max.max(frame.session.retry_after());
        let drawn: BTreeMap<ObjectId, WorldTime> = tracker.drawn().map(|drawn| (drawn.object, drawn.tick)).collect();
        let own: BTreeSet<ObjectId> = welcome.avatars.iter().map(|avatar| avatar.0).collect();
        let frame_period = Duration::from_millis(50);
        let recent = |past: WorldTime| at.since(past) <= LOSS_WINDOW;
        watcher.lost_control.retain(|&past| recent(past));
        let lost_control = watcher.lost_control.len() as u32;
        let began = *watcher.began.get_or_insert(at);
        watcher.look(eye, frame.session, at);
        let round_trip_max = watcher.allowance.round_trip_max();
        let unforeseen = watcher.unforeseen();
        let silent = watcher.silent(at);
        let is_cut_off = at.since(watcher.heard) > SILENCE_MAX;
        for (index, (object, past)) in frame.world.objects().iter().zip(objects.iter()).enumerate() {
            let id = ObjectId(index as u32);
            if !object.alive || !object.present || own.contains(&id) {
                watcher.seen_since.remove(&id);
                watcher.awaited.remove(&id);
                continue;
            }
            let place = object.position.metres();
            let radius = frame.world.classes()[usize::from(object.class.0)].extent.radius;
            let is_seen = walls.sees_disc(eye, place, radius);
            let drawn_of = drawn.get(&id).copied();
            // Two rounds where the place was asked for first, and updates after it.
            let push_max = 2 * round_trip_max + 2 * frame_period;
            let is_awaited = is_seen && drawn_of.is_none()
                || drawn_of.is_some_and(|tick| past.is_behind(tick, at, push_max).is_some());
            if !is_awaited {
                watcher.awaited.remove(&id);
            }
            let awaited = if is_awaited { *watcher.awaited.entry(id).or_insert(at) } else { at };
            let lost = watcher.lost.entry(id).or_default();
            // What is awaited for longer may have been lost more often.
            lost.retain(|&past| awaited.since(past) <= LOSS_WINDOW);
            let losses = lost.len() as u32;
            // Only who has come lately waits for the control stream, or is waited for.
            let is_new = past.appeared_at.is_some_and(recent) || recent(began);
            let losses = losses + if is_new { lost_control } else { 0 };
            let down_max = watcher.allowance.down_max;
            let for_losses = losses * (watcher.retry_max + frame_period);
            // Contained.
            if let Some(tbv) = tracker.held(id) {
                let is_broken =
                    tbv.issue < object.issue && past.violated_tick.is_some_and(|violated| tbv.issued < violated);
                if is_broken {
                    self.broken_believed += 1;
                    let since = past.violated_at.unwrap_or(at);
                    if at > (since + down_max).max(silent) && losses == 0 {
                        fail(format!("{id}: believes a bound that was broken {} µs ago", at.since(since).as_micros()));
                    }
                } else if tbv.holds_at(at) {
                    self.bounds_checked += 1;
                    if !tbv.contains(place, at) {
                        let distance = tbv.centre.metres().distance(place);
                        let radius = tbv.radius_at(at);
                        fail(format!("{id}: is {distance} m from its bound's centre, whose radius is {radius} m"));
                    }
                    if let Some(inserted) = watcher.view.bound(id.0)
                        && !holds(&inserted, frame.world, object, place)
                    {
                        fail(format!("{id}: at {place} is not in the bound that T holds, {inserted:?}"));
                    }
                } else if watcher.view.bound(id.0).is_some() {
                    fail(format!("{id}: T holds a bound that expired {:?} ago", at.since(tbv.expires)));
                }
            }
            // Never late.
            if is_seen {
                self.visible_checked += 1;
                let since = *watcher.seen_since.entry(id).or_insert(at);
                // A broken bound has to be announced first; who has just appeared, even to be asked for twice, and so has
                // everybody for who has just joined.
                let heard = past.violated_at.map_or(WorldTime::MIN, |violated| violated + down_max);
                let known = past.appeared_at.map_or(WorldTime::MIN, |appeared| appeared + down_max + round_trip_max);
                let unforeseen_by =
                    heard.max(known).max(watcher.leapt).max(began + round_trip_max) + (round_trip_max + frame_period);
                let bound = (since + unforeseen).max(unforeseen_by) + for_losses;
                let bound = bound.max(silent);
                if drawn_of.is_none() {
                    self.not_drawn += 1;
                    // With a lead it is to be there in the very frame.
                    if !is_cut_off && (at > bound || watcher.allowance.lead && bound == since) {
                        let late = at.since(since);
                        fail(format!(
                            "{id}: visible for {late:?} and not drawn, {losses} losses, held {:?}, knows {}",
                            tracker.held(id),
                            tracker.knows(id)
                        ));
                    }
                }
            } else {
                watcher.seen_since.remove(&id);
            }
            // What is drawn is not older than what a push takes.
            if let Some(tick) = drawn_of {
                self.states_checked += 1;
                let allowed = push_max + for_losses;
                if let Some((changed, committed)) = past.is_behind(tick, at, allowed)
                    && at > silent
                {
                    let age = at.since(committed);
                    let behind = changed.since(tick);
                    fail(format!("{id}: drawn from a state {behind:?} before one of {age:?} ago, {losses} losses"));
                }
            }
        }
    }
}

impl Past {
    /// The newest change, by tick and true time, that has been known for `allowed` at `at` and that a state of `tick` does not
    /// have.
    fn is_behind(&self, tick: WorldTime, at: WorldTime, allowed: Duration) -> Option<(WorldTime, WorldTime)> {
        let due = self.changes.iter().rev().find(|&&(_, committed)| committed + allowed < at);
        due.copied()
            .filter(|&(changed, _)| tick < changed && self.appeared_at.is_none_or(|appeared| appeared + allowed < at))
    }
}

impl Watcher {
    /// A frame is made from `eye`.
    fn look(&mut self, eye: DVec3, session: &Session, at: WorldTime) {
        if let Some((before, then)) = self.eye
            && let Some(motion) =
                session.welcome().and_then(|welcome| welcome.classes.first()).map(|class| class.motion)
            && eye.distance(before) > motion.reach(at.seconds_since(then))
        {
            self.leapt = at;
        }
        self.eye = Some((eye, at));
        // What the session knows of the path: the greatest round trip lately, and four variations.
        let known = session
            .round_trip()
            .map_or(Duration::ZERO, |(smoothed, greatest)| greatest + session.retry_after().saturating_sub(smoothed));
        self.foreseen.push_back((at, known));
        while self.foreseen.front().is_some_and(|&(then, _)| at.since(then) > FORESIGHT_WINDOW) {
            self.foreseen.pop_front();
        }
    }

    /// By how much a question may take longer than was foreseen: all of it, without a lead.
    fn unforeseen(&self) -> Duration {
        let foreseen = self.foreseen.iter().map(|&(_, known)| known).min().filter(|_| self.allowance.lead);
        self.allowance.round_trip_max().saturating_sub(foreseen.unwrap_or_default())
    }

    /// Until when nobody can be blamed: the path was dark until lately, or is.
    fn silent(&self, at: WorldTime) -> WorldTime {
        let recovery = 2 * self.allowance.round_trip_max() + 2 * self.retry_max + Duration::from_millis(100);
        let is_dark = self.heard > WorldTime::MIN && at.since(self.heard) > SILENCE_MIN;
        if is_dark { at } else { self.silent_until + recovery }
    }
}

/// Whether the object's upright cylinder lies in `bound` when its reference point is at `place`.
fn holds(bound: &Bound, world: &World, object: &Object, place: DVec3) -> bool {
    let extent = world.classes()[usize::from(object.class.0)].extent;
    let side = extent.radius;
    let min = place + DVec3::new(-side, extent.bottom, -side);
    let max = place + DVec3::new(side, extent.top, side);
    let across = |centre: DVec3| (place - centre).with_y(0.0).length() + side;
    match *bound {
        Bound::Box(aabb) => aabb.contains_box(&Aabb::new(min, max)),
        Bound::Sphere { centre, radius } => {
            let up = (max.y - centre.y).abs().max((min.y - centre.y).abs());
            across(centre).hypot(up) <= radius
        }
        Bound::Upright { centre, radius, half_height } => {
            across(centre) <= radius && min.y >= centre.y - half_height && max.y <= centre.y + half_height
        }
        Bound::Everywhere => true,
    }
}

impl Observer for Truth {
    fn committed(&mut self, world: &World, at: WorldTime) {
        self.learn(world, at);
    }

    fn framed(&mut self, frame: &Framed<'_>) {
        // Who joined or left since the tick is known too.
        self.learn(frame.world, frame.at);
        self.check(frame);
    }

    fn arrives(&mut self, message: &Passing<'_>) {
        if message.direction == Direction::Down
            && let Some(watcher) = self.watchers.get_mut(&message.client)
        {
            if watcher.heard > WorldTime::MIN && message.at.since(watcher.heard) > SILENCE_MIN {
                watcher.silent_until = message.at;
            }
            watcher.heard = message.at;
        }
    }

    fn lost(&mut self, message: &Passing<'_>) {
        self.note_lost(message);
    }
}
