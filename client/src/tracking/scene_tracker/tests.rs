use std::collections::BTreeMap;
use std::sync::Arc;

use eyeline_visibility::{Aabb, DynamicOctree};
use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use super::*;
use crate::tracking::{MotionLimits, MotionState, TbvShape, Trajectory};

const FRAME: Duration = Duration::from_millis(50);
const SPEED: f64 = 2.0;
const REACH: f64 = 0.5;

/// Hides what lies wholly beyond a wall at some x.
struct Wall(f64);

impl Occlusion for Wall {
    fn hides(&self, bound: &Bound) -> bool {
        bound.aabb().is_some_and(|aabb| aabb.min.x > self.0)
    }
}

/// Shows, and hides nothing by what is shown.
struct Screen {
    wall: Wall,
    drawn: Vec<u32>,
}

impl Image for Screen {
    fn occlusion(&self) -> &dyn Occlusion {
        &self.wall
    }

    fn draw(&mut self, object: u32) -> bool {
        self.drawn.push(object);
        false
    }
}

/// Objects by their place on the x axis.
#[derive(Default)]
struct Line {
    places: BTreeMap<u32, f64>,
    now: WorldTime,
    asked: u64,
    shape: Option<TbvShape>,
}

impl Line {
    fn bound(&self, object: u32) -> Bound {
        Bound::Box(Aabb::around(self.at(object), DVec3::splat(REACH)))
    }

    fn at(&self, object: u32) -> DVec3 {
        DVec3::new(self.places[&object], 0.0, 0.0)
    }
}

impl Agents for Line {
    fn configuration(&mut self, object: u32) -> Bound {
        self.asked += 1;
        self.bound(object)
    }

    fn temporal_bound(&mut self, object: u32, expires: WorldTime) -> TemporalBound {
        self.asked += 1;
        let state = MotionState { position: self.at(object), velocity: DVec3::ZERO };
        let limits = MotionLimits {
            speed_max: SPEED,
            acceleration_max: f64::INFINITY,
            axis_speed_max: DVec3::splat(SPEED),
            reach: REACH * 3.0_f64.sqrt() * 1.001,
        };
        let shape = self.shape.unwrap_or(TbvShape::SpeedSphere);
        TemporalBound::new(shape, state, limits, None, self.now, expires)
    }
}

fn tracker(variant: Variant, validity: Validity) -> SceneTracker {
    let index = DynamicOctree::new(Aabb::around(DVec3::ZERO, DVec3::splat(64.0)));
    SceneTracker::new(variant, validity, FRAME, Box::new(index))
}

fn frame(tracker: &mut SceneTracker, line: &mut Line, now: WorldTime, wall: f64) -> (Vec<u32>, FrameStats) {
    line.now = now;
    let mut screen = Screen { wall: Wall(wall), drawn: Vec::new() };
    let input = FrameInput { now, eye: DVec3::NEG_X * 100.0, eye_moves: true };
    let stats = tracker.frame(input, line, &mut screen);
    tracker.check();
    screen.drawn.sort_unstable();
    assert!(tracker.shown().eq(screen.drawn.iter().copied()));
    assert_eq!(stats.shown, screen.drawn.len() as u64);
    (screen.drawn, stats)
}

#[derive(Clone, Debug)]
enum Event {
    /// Everybody moves by their share of what the speed allows, and the wall by so many metres.
    Frame(f64, f64),
    Join(u32, f64),
    Leave(u32),
    /// Teleports, and says so.
    Violate(u32, f64),
    /// The clock jumps by so many frames, forth or back.
    Jump(i64),
}

fn event() -> impl Strategy<Value = Event> {
    prop_oneof![
        12 => (-1.0..1.0f64, -0.5..0.5f64).prop_map(|(moved, wall)| Event::Frame(moved, wall)),
        2 => (0..12u32, -20.0..40.0f64).prop_map(|(object, x)| Event::Join(object, x)),
        1 => (0..12u32).prop_map(Event::Leave),
        1 => (0..12u32, -20.0..40.0f64).prop_map(|(object, x)| Event::Violate(object, x)),
        1 => (-100..100i64).prop_map(Event::Jump),
    ]
}

fn variant() -> impl Strategy<Value = Variant> {
    prop::sample::select(Variant::ALL.to_vec())
}

fn validity() -> impl Strategy<Value = Validity> {
    let ms = Duration::from_millis;
    prop_oneof![
        (0..3_000u64).prop_map(move |period| Validity::Fixed(ms(period))),
        Just(Validity::Adaptive { first: ms(100), shortest: ms(50), longest: ms(60_000) }),
        Just(Validity::Exact { longest: ms(60_000) }),
    ]
}

fn shape() -> impl Strategy<Value = TbvShape> {
    prop_oneof![
        4 => Just(TbvShape::SpeedSphere),
        2 => Just(TbvShape::Box),
        1 => Just(TbvShape::Swept { pieces: 3 }),
        1 => Just(TbvShape::Everywhere),
    ]
}

proptest! {
    #[test]
    fn shows_what_is_in_sight_whatever_happens(
        events in prop::collection::vec(event(), 1..150), variant in variant(), validity in validity(), shape in shape()
    ) {
        let (mut tracker, mut line) = (tracker(variant, validity), Line { shape: Some(shape), ..Line::default() });
        let (mut now, mut wall) = (WorldTime::ZERO, 3.0);
        let mut absent: BTreeMap<u32, u32> = BTreeMap::new();
        for (number, event) in (0u32..).zip(events) {
            match event {
                Event::Join(object, x) => {
                    line.places.insert(object, x);
                    tracker.insert(object);
                    absent.remove(&object);
                }
                Event::Leave(object) => {
                    prop_assert_eq!(tracker.remove(object), line.places.remove(&object).is_some());
                    absent.remove(&object);
                }
                Event::Violate(object, x) => {
                    if let Some(place) = line.places.get_mut(&object) {
                        *place = x;
                    }
                    tracker.handle_violation(object);
                }
                Event::Jump(frames) => now = now.offset_micros(frames * FRAME.as_micros() as i64),
                Event::Frame(moved, wall_moved) => {
                    now = now + FRAME;
                    wall += wall_moved;
                    for (object, x) in &mut line.places {
                        // Not all the same way.
                        let sign = if (object + number) % 3 == 0 { -1.0 } else { 1.0 };
                        *x += sign * moved * SPEED * FRAME.as_secs_f64();
                    }
                }
            }
            tracker.check();
            let (shown, _) = frame(&mut tracker, &mut line, now, wall);
            let in_sight: Vec<u32> =
                line.places.keys().copied().filter(|&object| !Wall(wall).hides(&line.bound(object))).collect();
            match variant {
                Variant::Implicit => {
                    let missing: Vec<u32> = in_sight.iter().copied().filter(|object| !shown.contains(object)).collect();
                    absent.retain(|object, _| missing.contains(object));
                    for object in missing {
                        let running = absent.entry(object).or_insert(0);
                        *running += 1;
                        prop_assert!(*running <= 1, "object {} absent twice running", object);
                    }
                }
                Variant::NoHierarchy => prop_assert!(shown.iter().eq(line.places.keys())),
                Variant::Explicit | Variant::EveryObject => prop_assert_eq!(shown, in_sight),
            }
        }
        for object in line.places.keys() {
            tracker.remove(*object);
        }
        tracker.check();
        prop_assert_eq!(tracker.counts(), (0, 0));
        prop_assert_eq!((tracker.index.len(), tracker.queue.len()), (0, 0));
    }
}

fn still_line(count: u32, from: f64) -> Line {
    Line { places: (0..count).map(|object| (object, from + f64::from(object) * 0.01)).collect(), ..Line::default() }
}

#[test]
fn hidden_objects_cost_nothing_between_their_expiries() {
    let validity = Validity::Fixed(Duration::from_secs(2));
    let mut line = still_line(500, 30.0);
    let mut tracker = tracker(Variant::Explicit, validity);
    (0..500).for_each(|object| tracker.insert(object));
    let now = |number: i64| WorldTime::from_micros(number * FRAME.as_micros() as i64);
    let (_, first) = frame(&mut tracker, &mut line, now(0), 0.0);
    assert_eq!((first.updates, first.bounds, first.shown), (500, 500, 0));
    for number in 1..40 {
        let (_, stats) = frame(&mut tracker, &mut line, now(number), 0.0);
        assert_eq!((stats.updates, stats.bounds, stats.exposed), (0, 0, 0), "frame {number}");
        assert!(stats.work < 10, "{} in frame {number}", stats.work);
    }
    let (_, expired) = frame(&mut tracker, &mut line, now(40), 0.0);
    assert_eq!((expired.expired, expired.updates, expired.bounds), (500, 500, 500), "all together");
}

#[test]
fn implicit_updates_spare_visible_objects_and_may_be_a_frame_late() {
    let validity = Validity::Fixed(Duration::from_millis(100));
    let (mut explicit, mut implicit) = (tracker(Variant::Explicit, validity), tracker(Variant::Implicit, validity));
    let mut line = still_line(1, 0.0);
    explicit.insert(0);
    implicit.insert(0);
    let (mut late, mut implicit_work, mut explicit_work) = (0, 0, 0);
    for number in 0..200 {
        let now = WorldTime::from_micros(number * FRAME.as_micros() as i64);
        // The wall follows the object so closely that T's old place for it is hidden at times.
        line.places.insert(0, -0.02 * number as f64);
        let wall = line.places[&0] + if number % 20 == 10 { -0.49 } else { 0.5 };
        let (by_explicit, explicit_stats) = frame(&mut explicit, &mut line, now, wall);
        let (by_implicit, implicit_stats) = frame(&mut implicit, &mut line, now, wall);
        assert_eq!(by_explicit, [0]);
        late += u32::from(by_implicit.is_empty());
        implicit_work += implicit_stats.work;
        explicit_work += explicit_stats.work;
    }
    assert!((1..40).contains(&late), "{late}");
    assert!(implicit_work < explicit_work, "{implicit_work} against {explicit_work}");
}

#[test]
fn adaptive_periods_find_a_length_that_neither_expires_nor_exposes_all_the_time() {
    let ms = Duration::from_millis;
    let messages = |validity| {
        let (mut line, mut tracker) = (still_line(20, 10.0), tracker(Variant::Explicit, validity));
        (0..20).for_each(|object| tracker.insert(object));
        let mut total = 0;
        for number in 0..2_000 {
            let now = WorldTime::from_micros(number * FRAME.as_micros() as i64);
            let (_, stats) = frame(&mut tracker, &mut line, now, 0.0);
            total += stats.updates + stats.bounds;
        }
        total
    };
    let adaptive = messages(Validity::Adaptive { first: ms(50), shortest: ms(50), longest: ms(600_000) });
    // 10 m at 2 m/s: a bound of 5 s is about to be seen, one of 10 s is seen at once.
    let (short, long) = (messages(Validity::Fixed(ms(200))), messages(Validity::Fixed(ms(10_000))));
    let exact = messages(Validity::Exact { longest: ms(600_000) });
    assert!(adaptive * 5 < short && adaptive * 5 < long, "{adaptive} against {short} and {long}");
    assert!(exact < adaptive, "{exact} against {adaptive}");
}

/// Answers of no sense at all, by number.
struct Liar {
    chance: Pcg64,
    now: WorldTime,
    /// Who may be anywhere by what was answered last.
    nowhere: BTreeSet<u32>,
}

const STRANGE: [f64; 8] = [0.0, -1.0, 1.0, 1e6, 1e300, f64::NAN, f64::INFINITY, f64::NEG_INFINITY];
const TIMES: [WorldTime; 5] = [
    WorldTime::MIN,
    WorldTime::MAX,
    WorldTime::ZERO,
    WorldTime::from_micros(-1),
    WorldTime::from_micros(3_600_000_000),
];

impl Liar {
    fn strange(&mut self) -> f64 {
        STRANGE[self.chance.random_range(0..STRANGE.len())]
    }

    fn strange_point(&mut self) -> DVec3 {
        DVec3::new(self.strange(), self.strange(), self.strange())
    }

    fn time(&mut self) -> WorldTime {
        match self.chance.random_range(0..4) {
            0 => TIMES[self.chance.random_range(0..TIMES.len())],
            _ => self.now.offset_micros(self.chance.random_range(-200_000..2_000_000)),
        }
    }
}

struct Nowhere;

impl Trajectory for Nowhere {
    fn position(&self, at: WorldTime) -> DVec3 {
        DVec3::splat(if at.micros() % 2 == 0 { 0.0 } else { f64::NAN })
    }

    fn speed_max(&self) -> f64 {
        1.0
    }
}

impl Agents for Liar {
    fn configuration(&mut self, object: u32) -> Bound {
        let bound = match self.chance.random_range(0..5) {
            0 => Bound::Everywhere,
            1 => Bound::Sphere { centre: self.strange_point(), radius: self.strange() },
            2 => Bound::Upright { centre: self.strange_point(), radius: self.strange(), half_height: self.strange() },
            3 => Bound::Box(Aabb::new(self.strange_point(), self.strange_point())),
            _ => Bound::Box(Aabb::around(DVec3::X * self.chance.random_range(-9.0..9.0), DVec3::ONE)),
        };
        self.nowhere.remove(&object);
        if bound.outer_box().is_none() {
            self.nowhere.insert(object);
        }
        bound
    }

    fn temporal_bound(&mut self, _object: u32, expires: WorldTime) -> TemporalBound {
        let shapes = [
            TbvShape::SpeedSphere,
            TbvShape::AccelerationSphere,
            TbvShape::Box,
            TbvShape::Swept { pieces: 3 },
            TbvShape::Everywhere,
        ];
        let shape = shapes[self.chance.random_range(0..shapes.len())];
        let state = MotionState { position: self.strange_point(), velocity: self.strange_point() };
        let limits = MotionLimits {
            speed_max: self.strange(),
            acceleration_max: self.strange(),
            axis_speed_max: self.strange_point(),
            reach: self.strange(),
        };
        let (issued, other) = (self.time(), self.time());
        let expires = if self.chance.random_bool(0.5) { expires } else { other };
        TemporalBound::new(shape, state, limits, Some(Arc::new(Nowhere)), issued, expires)
    }
}

#[test]
fn answers_of_no_sense_are_shown_and_leave_nothing_behind() {
    let validities = [
        Validity::Fixed(Duration::ZERO),
        Validity::Fixed(Duration::MAX),
        Validity::Adaptive { first: Duration::ZERO, shortest: Duration::ZERO, longest: Duration::MAX },
        Validity::Exact { longest: Duration::ZERO },
        Validity::Exact { longest: Duration::MAX },
    ];
    let frames = [Duration::ZERO, FRAME, Duration::MAX];
    let ids = [0, 1, 7, u32::MAX - 1, u32::MAX];
    let mut seed = 0;
    for variant in Variant::ALL {
        for (validity, frame_time) in validities.iter().flat_map(|&validity| frames.map(|frame| (validity, frame))) {
            seed += 1;
            let index = DynamicOctree::new(Aabb::around(DVec3::ZERO, DVec3::splat(64.0)));
            let mut tracker = SceneTracker::new(variant, validity, frame_time, Box::new(index));
            let mut liar = Liar { chance: Pcg64::seed_from_u64(seed), now: WorldTime::ZERO, nowhere: BTreeSet::new() };
            for _ in 0..60 {
                let object = ids[liar.chance.random_range(0..ids.len())];
                match liar.chance.random_range(0..4) {
                    0 => {
                        tracker.remove(object);
                    }
                    1 => tracker.handle_violation(object),
                    _ => tracker.insert(object),
                }
                tracker.check();
                liar.now = liar.time();
                let mut screen = Screen { wall: Wall(0.0), drawn: Vec::new() };
                let input = FrameInput { now: liar.now, eye: liar.strange_point(), eye_moves: liar.chance.random() };
                liar.nowhere.clear();
                let stats = tracker.frame(input, &mut liar, &mut screen);
                tracker.check();
                // Who was asked in this frame and may be anywhere is shown.
                assert!(liar.nowhere.iter().all(|object| screen.drawn.contains(object)), "seed {seed}");
                assert_eq!(stats.hidden_caused + stats.shown, stats.updates + stats.bounds, "seed {seed}");
            }
            for object in ids {
                tracker.remove(object);
            }
            tracker.check();
            assert_eq!((tracker.counts(), tracker.index.len(), tracker.queue.len()), ((0, 0), 0, 0));
            assert!(tracker.violated.is_empty());
        }
    }
}

#[test]
fn a_tracker_of_nothing_does_nothing() {
    for variant in Variant::ALL {
        let mut tracker = tracker(variant, Validity::Fixed(Duration::ZERO));
        assert!(!tracker.remove(3));
        tracker.handle_violation(3);
        let (drawn, stats) = frame(&mut tracker, &mut Line::default(), WorldTime::ZERO, 0.0);
        assert!(drawn.is_empty() && stats.work <= 1, "{stats:?}");
        assert_eq!(FrameStats { work: 0, ..stats }, FrameStats::default());
    }
}

#[test]
fn objects_that_come_and_go_use_keys_again() {
    let mut tracker = tracker(Variant::Explicit, Validity::Fixed(Duration::from_secs(1)));
    let mut line = Line { shape: Some(TbvShape::Box), ..still_line(20, 30.0) };
    for round in 0..200_u32 {
        let base = round * 20;
        line.places = (base..base + 20).map(|object| (object, 30.0)).collect();
        line.places.keys().for_each(|&object| tracker.insert(object));
        frame(&mut tracker, &mut line, WorldTime::ZERO + FRAME * round, 0.0);
        line.places.keys().for_each(|&object| tracker.handle_violation(object));
        line.places.keys().for_each(|&object| assert!(tracker.remove(object)));
    }
    assert!(tracker.owners.len() <= 20, "{}", tracker.owners.len());
    assert!(tracker.violated.is_empty());
}

/// Answers with bounds that hold from `issued` until `expires`, whatever was asked for.
struct Stubborn {
    line: Line,
    issued: WorldTime,
    expires: WorldTime,
}

impl Agents for Stubborn {
    fn configuration(&mut self, object: u32) -> Bound {
        self.line.configuration(object)
    }

    fn temporal_bound(&mut self, object: u32, expires: WorldTime) -> TemporalBound {
        self.line.now = self.issued;
        self.line.temporal_bound(object, expires.min(self.expires))
    }
}

#[test]
fn a_bound_is_believed_for_no_longer_and_no_sooner_than_it_holds() {
    let millis = |millis: i64| WorldTime::from_micros(millis * 1_000);
    let second = Duration::from_secs(1);
    for (issued, expires, asked_at) in [
        // For less than a frame.
        (0, 20, 50),
        (0, 120, 100),
        // From later on.
        (700, 2_000, 50),
    ] {
        for validity in [Validity::Fixed(second), Validity::Exact { longest: second }] {
            let line = still_line(1, 30.0);
            let mut stubborn = Stubborn { line, issued: millis(issued), expires: millis(expires) };
            let mut tracker = tracker(Variant::Explicit, validity);
            tracker.insert(0);
            let mut asked = Vec::new();
            for now in [0, 50, 100] {
                let mut screen = Screen { wall: Wall(0.0), drawn: Vec::new() };
                let input = FrameInput { now: millis(now), eye: DVec3::ZERO, eye_moves: false };
                let stats = tracker.frame(input, &mut stubborn, &mut screen);
                tracker.check();
                assert!(screen.drawn.is_empty());
                asked.extend((stats.bounds > 0).then_some(now));
                let until = tracker.bound(0).map(TemporalBound::expires);
                assert!(until <= Some(stubborn.expires), "{until:?}: longer than was said");
            }
            assert_eq!(asked.get(1), Some(&asked_at), "{issued} to {expires} ms, {validity:?}: {asked:?}");
        }
    }
}

#[test]
fn an_exact_period_is_a_frame_at_least_whatever_the_greatest_is() {
    let mut tracker = tracker(Variant::Explicit, Validity::Exact { longest: Duration::ZERO });
    let mut line = still_line(1, 30.0);
    tracker.insert(0);
    frame(&mut tracker, &mut line, WorldTime::ZERO, 0.0);
    assert_eq!(tracker.bound(0).map(TemporalBound::expires), Some(WorldTime::ZERO + FRAME));
}

#[test]
fn messages_about_what_is_not_shown_are_counted_for_every_variant() {
    for (variant, expected) in [
        // One of ten is in sight. The nine are asked about and get a bound; then they are left alone.
        (Variant::Explicit, [18, 0]),
        (Variant::Implicit, [18, 0]),
        (Variant::EveryObject, [9, 9]),
        (Variant::NoHierarchy, [0, 0]),
    ] {
        let mut tracker = tracker(variant, Validity::Fixed(Duration::from_secs(9)));
        let mut line = still_line(9, 40.0);
        line.places.insert(9, -5.0);
        (0..10).for_each(|object| tracker.insert(object));
        let found = [0, 1].map(|number| {
            let (_, stats) = frame(&mut tracker, &mut line, WorldTime::ZERO + FRAME * number, 0.0);
            stats.hidden_caused
        });
        assert_eq!(found, expected, "{variant:?}");
    }
}

#[test]
fn a_broken_bound_says_nothing_about_its_length_even_if_it_also_expired() {
    let ms = Duration::from_millis;
    let validity = Validity::Adaptive { first: ms(50), shortest: ms(50), longest: ms(60_000) };
    let lengths = [false, true].map(|is_broken| {
        let (mut tracker, mut line) = (tracker(Variant::Explicit, validity), still_line(1, 40.0));
        tracker.insert(0);
        for number in 0..4 {
            if is_broken {
                tracker.handle_violation(0);
            }
            frame(&mut tracker, &mut line, WorldTime::ZERO + FRAME * number, 0.0);
        }
        tracker.entries[&0].period.length()
    });
    // 50 ms, and from the second frame on 100, which end in the fourth.
    assert_eq!(lengths, [ms(200), ms(50)]);
}

#[test]
fn a_clock_that_goes_back_voids_what_was_issued_later() {
    for jump_back in [false, true] {
        let mut tracker = tracker(Variant::Explicit, Validity::Fixed(Duration::from_secs(1)));
        let mut line = still_line(1, 10.0);
        tracker.insert(0);
        let hour = WorldTime::from_micros(3_600_000_000);
        frame(&mut tracker, &mut line, hour, 0.0);
        let start = if jump_back { WorldTime::ZERO } else { hour };
        // Walks into sight, no faster than it may, which takes longer than the bound was for.
        for number in 1..150 {
            let x = 10.0 - 0.1 * f64::from(number);
            line.places.insert(0, x);
            let (drawn, _) = frame(&mut tracker, &mut line, start + FRAME * number, 0.0);
            assert_eq!(drawn.is_empty(), x - REACH > 0.0, "at {x}, jump {jump_back}");
        }
    }
}

#[test]
fn the_period_of_what_has_just_gone_out_of_view_starts_anew() {
    let ms = Duration::from_millis;
    let validity = Validity::Adaptive { first: ms(50), shortest: ms(50), longest: ms(60_000) };
    let (mut tracker, mut line) = (tracker(Variant::Explicit, validity), still_line(1, 40.0));
    tracker.insert(0);
    let mut length = |x: f64, number: u32| {
        line.places.insert(0, x);
        frame(&mut tracker, &mut line, WorldTime::ZERO + FRAME * number, 0.0);
        tracker.entries[&0].period.length()
    };
    for number in 0..20 {
        length(40.0, number);
    }
    assert!(length(40.0, 20) >= ms(400));
    // In sight before its bound ends, as if it had teleported.
    for number in 200..202 {
        length(-5.0, number);
    }
    assert_eq!(length(40.0, 202), ms(50));
}

/// A wall that whoever is displayed brings nearer: to two metres behind them.
struct Growing {
    wall: Wall,
    places: BTreeMap<u32, f64>,
    drawn: Vec<u32>,
}

impl Image for Growing {
    fn occlusion(&self) -> &dyn Occlusion {
        &self.wall
    }

    fn draw(&mut self, object: u32) -> bool {
        self.drawn.push(object);
        self.wall.0 = self.wall.0.min(self.places[&object] + 2.0);
        true
    }
}

#[test]
fn the_nearest_is_displayed_first_and_hides_who_is_behind() {
    for variant in [Variant::Explicit, Variant::Implicit, Variant::EveryObject] {
        let mut tracker = tracker(variant, Validity::Fixed(Duration::from_secs(1)));
        // The nearest has the last id.
        let mut line = Line { places: (0..6).map(|id| (id, -5.0 * f64::from(id))).collect(), ..Line::default() };
        (0..6).for_each(|object| tracker.insert(object));
        for number in 0..4 {
            let mut image = Growing { wall: Wall(9.0), places: line.places.clone(), drawn: Vec::new() };
            line.now = WorldTime::ZERO + FRAME * number;
            let input = FrameInput { now: line.now, eye: DVec3::NEG_X * 100.0, eye_moves: false };
            tracker.frame(input, &mut line, &mut image);
            tracker.check();
            assert_eq!(image.drawn, [5], "{variant:?}, frame {number}");
        }
    }
}

/// From x = 5 towards −X, 5 m/s.
struct Rail;

impl Trajectory for Rail {
    fn position(&self, at: WorldTime) -> DVec3 {
        DVec3::X * (5.0 - 5.0 * at.seconds())
    }

    fn speed_max(&self) -> f64 {
        5.0
    }
}

/// Object 0 stands; object 1 is on the rail.
struct OnRail(Line);

impl Agents for OnRail {
    fn configuration(&mut self, object: u32) -> Bound {
        self.0.configuration(object)
    }

    fn temporal_bound(&mut self, object: u32, expires: WorldTime) -> TemporalBound {
        let bound = self.0.temporal_bound(object, expires);
        let limits = MotionLimits { speed_max: 5.0, acceleration_max: 0.0, axis_speed_max: DVec3::ZERO, reach: REACH };
        let state = MotionState { position: DVec3::ZERO, velocity: DVec3::ZERO };
        let path: Option<crate::tracking::Path> = Some(Arc::new(Rail));
        TemporalBound::new(TbvShape::Swept { pieces: 8 }, state, limits, path, bound.issued(), expires)
    }
}

#[test]
fn a_swept_bound_is_exposed_by_any_piece_past_what_was_displayed() {
    let mut tracker = tracker(Variant::Explicit, Validity::Fixed(Duration::from_secs(2)));
    let places = BTreeMap::from([(0, -6.0), (1, 5.0)]);
    let mut agents = OnRail(Line { places, ..Line::default() });
    (0..2).for_each(|object| tracker.insert(object));
    let exposed = [0, 1].map(|number| {
        agents.0.now = WorldTime::ZERO + FRAME * number;
        agents.0.places.insert(1, Rail.position(agents.0.now).x);
        let mut image = Growing { wall: Wall(0.0), places: agents.0.places.clone(), drawn: Vec::new() };
        let input = FrameInput { now: agents.0.now, eye: DVec3::NEG_X * 100.0, eye_moves: false };
        let stats = tracker.frame(input, &mut agents, &mut image);
        tracker.check();
        assert_eq!(image.drawn, [0]);
        stats.exposed
    });
    // Its path ends at −5, in front of the wall that object 0 has brought to −4; the object is behind it.
    assert_eq!(exposed, [0, 1]);
}
