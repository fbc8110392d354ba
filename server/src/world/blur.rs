//! What do all the bounds of one object together give away? Never more than a ball of `blur`.
//!
//! A bound alone is blurred by a grid ([`blurred`]). Two of them could still be cut: just after an object has crossed from
//! one cell to the next, it is near their common edge. So bounds are *nested*: a fresh one is issued only if its ball lies
//! inside the one that was issued last, grown to now. Else the last one is issued again as it has grown. The newest bound
//! then lies inside all earlier ones, whoever got them, and what they have in common is the newest itself.
//!
//! The same holds for somebody who has learnt the grid from the centres, and so takes a fresh bound for its cell: if the
//! balls are nested then so are the cells, grown alike, since all cells are equal. A cell has an enclosing radius of `blur`.
//!
//! A client that was told an exact place knows the ball around it, too ([`Known`]).

use std::time::Duration;

use eyeline_protocol::{Issue, METRES_MAX, MotionBound, ObjectId, Position, QUANTUM_METRES, Tbv, WorldTime};
use glam::DVec3;
use rustc_hash::FxHashMap;

use super::{Object, WorldConfig};

/// Pitch of the grid in units of `blur`: a square cell of √2 has an enclosing circle of radius 1.
const PITCH: f64 = std::f64::consts::SQRT_2;

/// A place snapped to a horizontal grid with a secret offset, the same for every asker and every time, so that asking often
/// does not average the blur away; and how far from that it may be. Height is not hidden: floors are no secret.
pub(super) fn blurred(place: Position, config: &WorldConfig) -> (Position, f64) {
    if config.blur <= 0.0 {
        return (place, 0.0);
    }
    let exact = place.metres();
    let pitch = config.blur * PITCH;
    let (offset_x, offset_z) = grid_offset(config.grid_seed, pitch);
    let snap = |x: f64, offset: f64| (((x - offset) / pitch).floor() + 0.5) * pitch + offset;
    // At the edge of the world the middle of a cell may be beyond it; the nearest point of the world is nearer to all of
    // the cell that is in the world.
    let within = |x: f64| x.clamp(-METRES_MAX, METRES_MAX);
    let centre = DVec3::new(within(snap(exact.x, offset_x)), exact.y, within(snap(exact.z, offset_z)));
    // Snapped to the wire's grid on top of it.
    (Position::from_metres(centre).unwrap_or(place), config.blur + QUANTUM_METRES)
}

/// `tbv` as it has grown by `tick`, which says the same.
fn grown(tbv: &Tbv, tick: WorldTime) -> Tbv {
    Tbv { radius: tbv.radius_at(tick), issued: tick, expires: tick + tbv.validity(), ..*tbv }
}

/// The bound that was issued last, whoever got it.
#[derive(Default)]
pub(super) struct Issued(Option<Tbv>);

impl Issued {
    /// `fresh` if it lies inside the bound that was issued last, else that one as it has grown.
    ///
    /// A ball of radius r lies in one of radius s if their middles are at most s − r apart, and if it is not the one that
    /// grows faster it stays there. An object that broke its bounds begins anew, since nobody may use an old one.
    pub fn nested(&mut self, fresh: Tbv) -> Tbv {
        let last = self.0.filter(|last| last.issue == fresh.issue);
        if let Some(last) = last {
            let between = last.centre.metres().distance(fresh.centre.metres());
            let room = last.radius + last.speed * fresh.issued.seconds_since(last.issued) - fresh.radius;
            // Written so that NaN is not inside.
            let is_inside = between <= room && fresh.speed <= last.speed;
            if !is_inside {
                return grown(&last, fresh.issued);
            }
        }
        self.0 = Some(fresh);
        fresh
    }
}

/// What one client can know of an object that it was told the place of: the exact place that was told last, and when it was there.
///
/// Packed, since there is one for each object that each client sees, and memory is waited for wherever they are looked at.
#[derive(Clone, Copy)]
#[repr(Rust, packed)]
pub(super) struct Known {
    pub place: Position,
    pub at: WorldTime,
    pub issue: Issue,
}

impl Known {
    pub fn new(place: Position, at: WorldTime, issue: Issue) -> Known {
        Known { place, at, issue }
    }

    /// The bound to tell this client instead of `fresh`, which [`Issued::nested`] has made: `fresh` itself, or what it
    /// knows already, the ball of ρ.
    ///
    /// Kept: what the client can know has an enclosing radius of at least min(`blur`, ρ), where ρ = speed·age is what the
    /// object may have moved since its place was told. All bounds from before that moment that grow contain the ball of ρ around
    /// the place, and so do those of all earlier places, slack included; those that do not grow are made so wide that
    /// they leave room beside every place in them. Bounds since then are nested. So what can be
    /// known is the common part of that ball and the newest bound, which is what is looked at here. Later both grow by
    /// the same length, and their common part by at least that.
    ///
    /// A bound that does not grow must have room for what is promised later. Let d be the distance of the two middles. If
    /// ρ is at least `blur` then a larger ρ only adds to the common part. If it is less, then for ρ = `blur` the common
    /// part is large enough only if d² + blur² is at most the bound's radius squared, and then for any smaller ρ, too.
    pub fn answer(&self, fresh: Tbv, motion: MotionBound, blur: f64) -> Tbv {
        let Known { place, at, issue } = *self;
        if issue != fresh.issue || blur <= 0.0 {
            return fresh;
        }
        let tick = fresh.issued;
        let growth = motion.speed_max * tick.seconds_since(at).max(0.0);
        let judged = if fresh.speed > 0.0 { growth } else { growth.max(blur) };
        let distance = place.metres().distance(fresh.centre.metres());
        if common_radius(distance, judged, fresh.radius) >= judged.min(blur) {
            return fresh;
        }
        let radius = (motion.slack + growth) * (1.0 + 1e-12);
        Tbv { centre: place, radius, speed: motion.speed_max, ..fresh }
    }

    /// Whether every later answer is the fresh bound, so that this may be forgotten.
    ///
    /// A fresh bound has its object in it and a radius of `blur` or more, so it has a ball of `blur` in it that has the object in
    /// it, too. Let d be how far the middle of that ball is from the place that was told, at most `blur` more than the object.
    /// If d² + blur² ≤ ρ² then the ball of ρ has in it the disc that halves the other across the line of the middles, and so the
    /// common part is as wide as [`Known::answer`] asks for. The object gets on by speed · time + slack at most, and ρ by
    /// speed · time, so with room for the slack that stays so.
    pub fn is_spent(&self, object: &Object, tick: WorldTime, motion: MotionBound, blur: f64) -> bool {
        let Known { place, at, issue } = *self;
        let growth = motion.speed_max * tick.seconds_since(at).max(0.0);
        // More by a quantum than asked for: rounding may take away less.
        let wide = blur + QUANTUM_METRES;
        let apart = place.metres().distance(object.position.metres()) + motion.slack + wide;
        // Written so that NaN is not spent.
        issue != object.issue || blur <= 0.0 || apart.hypot(wide) <= growth
    }
}

/// What one client can know of objects that it is told of no more, by object. Nothing may depend on their order.
#[derive(Default)]
pub(super) struct Places {
    places: FxHashMap<ObjectId, Known>,
    /// When it was looked last for what is spent.
    swept_at: WorldTime,
}

impl Places {
    /// How long what is spent is kept at most: so each place is looked at every few dozen ticks.
    const SWEEP_PERIOD: Duration = Duration::from_secs(2);

    pub fn insert(&mut self, object: ObjectId, known: Known) {
        self.places.insert(object, known);
    }

    pub fn remove(&mut self, object: ObjectId) {
        self.places.remove(&object);
    }

    pub fn get(&self, object: ObjectId) -> Option<&Known> {
        self.places.get(&object)
    }

    /// Forgets what is spent, now and then.
    pub fn sweep(&mut self, tick: WorldTime, is_spent: impl Fn(ObjectId, &Known) -> bool) {
        if tick.since(self.swept_at) < Self::SWEEP_PERIOD {
            return;
        }
        self.swept_at = tick;
        self.places.retain(|&object, known| !is_spent(object, known));
        self.places.shrink_to(self.places.len() * 3 / 2);
    }

    /// Bytes that they take.
    pub fn memory_bytes(&self) -> usize {
        self.places.capacity() * (size_of::<(ObjectId, Known)>() + 1)
    }
}

/// Radius of the smallest ball around what balls of radii `a` and `b` have in common, their middles `distance` apart.
fn common_radius(distance: f64, a: f64, b: f64) -> f64 {
    if distance <= 0.0 {
        return a.min(b);
    }
    // How far from a's middle, towards b's, the circle is in which their surfaces meet. If it is not between the middles,
    // then one ball has more than a half in the other, or all.
    let along = (distance * distance + a * a - b * b) / (2.0 * distance);
    match along {
        x if x <= 0.0 => a,
        x if x >= distance => b,
        x => (a * a - x * x).max(0.0).sqrt(),
    }
}

/// Offsets of the blur grid along x and z, in [0, pitch).
fn grid_offset(seed: u64, pitch: f64) -> (f64, f64) {
    // SplitMix64 (Steele, Lea & Flood 2014): two well-mixed words of one seed.
    let mix = |mut z: u64| {
        z = (z ^ z >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ z >> 31
    };
    let unit = |word: u64| (word >> 11) as f64 / (1u64 << 53) as f64;
    let first = seed.wrapping_add(0x9e37_79b9_7f4a_7c15);
    (unit(mix(first)) * pitch, unit(mix(first.wrapping_add(0x9e37_79b9_7f4a_7c15))) * pitch)
}

#[cfg(test)]
mod tests {
    use eyeline_protocol::ClassId;
    use proptest::prelude::*;
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64;

    use super::super::SessionId;
    use super::*;

    const SPEED: f64 = 2.0;
    const MOTION: MotionBound = MotionBound { speed_max: SPEED, slack: 0.12 };
    const TICK: Duration = Duration::from_millis(50);

    /// Half the greatest distance between two points that all balls contain, in the plane y = 0: no smaller ball holds
    /// them. Looked for on the balls' edges and where these meet.
    fn common_reach(balls: &[(DVec3, f64)]) -> f64 {
        let mut points = Vec::new();
        for (i, &(centre, radius)) in balls.iter().enumerate() {
            points.extend((0..64).map(|step| {
                let angle = std::f64::consts::TAU * f64::from(step) / 64.0;
                centre + DVec3::new(angle.cos(), 0.0, angle.sin()) * radius
            }));
            for &(other, other_radius) in &balls[..i] {
                let between = other - centre;
                let distance = between.length();
                let along = (distance * distance + radius * radius - other_radius * other_radius) / (2.0 * distance);
                let across = (radius * radius - along * along).sqrt();
                let unit = between / distance;
                let side = DVec3::new(-unit.z, 0.0, unit.x);
                points.extend([across, -across].map(|across| centre + unit * along + side * across));
            }
        }
        points.retain(|point| balls.iter().all(|&(centre, radius)| centre.distance(*point) <= radius + 1e-9));
        let mut greatest = 0.0f64;
        for (i, a) in points.iter().enumerate() {
            greatest = points[..i].iter().fold(greatest, |greatest, b| greatest.max(a.distance(*b)));
        }
        0.5 * greatest
    }

    /// A walker that several clients ask about now and then, one of which is now and then told its place.
    struct Walk {
        object: Object,
        config: WorldConfig,
        rng: Pcg64,
        tick: WorldTime,
        heading: f64,
        motion: MotionBound,
        /// How probable a turn is at a step.
        turns: f64,
        /// Share of the top speed that it walks at.
        share: f64,
        /// Every ball that the client may hold: middle, radius and time. Bounds of others count for it too.
        balls: Vec<(DVec3, f64, WorldTime)>,
        known: Option<Known>,
        told_at: WorldTime,
    }

    impl Walk {
        fn new(seed: u64, owner: Option<SessionId>) -> Walk {
            let mut object = Object::new("walker".into(), ClassId(0), Position::default(), WorldTime::ZERO);
            object.owner = owner;
            let config = WorldConfig::default().with_grid_seed(seed);
            let tick = WorldTime::ZERO;
            let rng = Pcg64::seed_from_u64(seed);
            let (motion, turns, share) = (MOTION, 0.1, 1.0);
            let (balls, told_at) = (Vec::new(), WorldTime::MIN);
            Walk { object, config, rng, tick, heading: 0.0, motion, turns, share, balls, known: None, told_at }
        }

        /// Goes on for a tick, turning now and then, or dithers about one place.
        fn step(&mut self, dithers: bool) {
            self.tick = self.tick + TICK;
            if dithers || self.rng.random_bool(self.turns) {
                self.heading = self.rng.random_range(0.0..std::f64::consts::TAU);
            }
            let step = DVec3::new(self.heading.cos(), 0.0, self.heading.sin())
                * (self.share * SPEED * TICK.as_secs_f64() - 1e-3);
            self.object.position = Position::from_metres(self.object.position.metres() + step).unwrap();
        }

        fn fresh(&mut self) -> Tbv {
            self.object.fresh_tbv(self.tick, self.motion, &self.config, DVec3::ZERO)
        }

        fn ask(&mut self) -> Tbv {
            let fresh = self.fresh();
            let tbv = self.known.map_or(fresh, |known| known.answer(fresh, self.motion, self.config.blur));
            assert!(tbv.contains(self.object.position.metres(), self.tick), "{tbv:?}");
            self.balls.push((tbv.centre.metres(), tbv.radius, self.tick));
            tbv
        }

        fn tell_place(&mut self) {
            self.known = Some(Known::new(self.object.position, self.tick, self.object.issue));
            // What an exact place says is less by the slack than what its ball would.
            self.balls.push((self.object.position.metres(), self.motion.slack, self.tick));
            self.told_at = self.tick;
        }

        /// The promise, from everything that was told.
        fn assert_kept(&self, speed: f64) {
            let balls: Vec<(DVec3, f64)> = self
                .balls
                .iter()
                .map(|&(centre, radius, at)| (centre, radius + speed * self.tick.seconds_since(at)))
                .collect();
            let growth = SPEED * self.tick.seconds_since(self.told_at).max(0.0);
            let (kept, least) = (common_reach(&balls), growth.min(self.config.blur));
            assert!(kept >= least - 2e-3, "{kept} m are left where {least} m were promised, at {:?}", self.tick);
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(48))]

        /// DESIGN §3.4: whatever is asked and told when, all of it together leaves room for the blur.
        #[test]
        fn all_that_is_told_together_keeps_its_blur(seed: u64, ask in 0.02..1.0f64, tell in 0.0..0.1f64, dithers: bool) {
            let mut walk = Walk::new(seed, Some(SessionId(1)));
            for _ in 0..100 {
                walk.step(dithers);
                if walk.rng.random_bool(tell) {
                    walk.tell_place();
                }
                if walk.rng.random_bool(ask) {
                    walk.ask();
                    walk.assert_kept(SPEED);
                    // The others' bounds are as nested; only their number would slow the check down.
                    let excess = walk.balls.len().saturating_sub(20);
                    walk.balls.drain(..excess);
                }
            }
        }

        /// A place is forgotten only when it decides nothing any more.
        #[test]
        fn once_a_place_is_spent_each_bound_is_fresh(seed: u64, turns in 0.0..1.0f64, share in 0.5..1.0f64) {
            let mut walk = Walk::new(seed, Some(SessionId(1)));
            let motion = MotionBound { slack: 0.01, ..MOTION };
            (walk.motion, walk.turns, walk.share) = (motion, turns.powi(4), share);
            walk.tell_place();
            let mut is_spent = false;
            for tick in 0..400 {
                walk.step(false);
                let fresh = walk.fresh();
                let (known, blur) = (walk.known.unwrap(), walk.config.blur);
                is_spent |= known.is_spent(&walk.object, walk.tick, motion, blur);
                prop_assert!(!is_spent || known.answer(fresh, motion, blur) == fresh, "after {} ticks", tick);
            }
            // Who does not go straight on at top speed is caught up with.
            prop_assert!(is_spent || share > 0.9, "never spent");
        }

        /// What stands or follows a path is bounded by a ball that does not grow, which keeps its blur beside any place in it
        /// that was told, at all times to come.
        #[test]
        fn a_bound_that_does_not_grow_keeps_its_blur(radius in 1.0..4.0f64, share in 0.0..1.0f64, asked in 1..40i64) {
            let place = Position::from_metres(DVec3::X * (radius * share)).unwrap();
            let known = Known::new(place, WorldTime::ZERO, Issue(0));
            let at = |ticks: i64| WorldTime::from_micros(ticks * 50_000);
            let fresh = Tbv {
                centre: Position::default(),
                radius: radius + MOTION.slack,
                speed: 0.0,
                issued: at(asked),
                expires: WorldTime::MAX,
                issue: Issue(0),
            };
            let told = known.answer(fresh, MOTION, 1.0);
            for ticks in asked..asked + 40 {
                let growth = SPEED * at(ticks).seconds();
                let bound = told.radius + told.speed * at(ticks).seconds_since(told.issued);
                let kept = common_reach(&[(place.metres(), growth), (told.centre.metres(), bound)]);
                prop_assert!(kept >= growth.min(1.0) - 2e-3, "{} m are left after {} m", kept, growth);
            }
            // In the end it is told.
            let fresh = Tbv { issued: at(200), ..fresh };
            prop_assert_eq!(known.answer(fresh, MOTION, 1.0), fresh);
        }

        /// The ball around what two balls have in common, against points that both contain.
        #[test]
        fn what_two_balls_have_in_common_is_as_large_as_said(distance in 0.0..4.0f64, a in 0.1..3.0f64, b in 0.1..3.0f64) {
            prop_assume!(distance < a + b - 1e-3);
            let said = common_radius(distance, a, b);
            let found = common_reach(&[(DVec3::ZERO, a), (DVec3::X * distance, b)]);
            prop_assert!((said - found).abs() <= 5e-3 * a.max(b), "{said} {found}");
        }
    }

    #[test]
    fn what_is_spent_is_forgotten_and_its_memory_given_back() {
        let mut places = Places::default();
        let step = Duration::from_millis(100);
        let at = |i: u32| WorldTime::ZERO + step * i;
        for i in 0..1000 {
            places.insert(ObjectId(i), Known::new(Position::default(), at(i), Issue(0)));
            // Of all that was told only the last ten count.
            places.sweep(at(i), |_, known| known.at + 10 * step <= at(i));
            assert!((0..=i).rev().take(10).all(|last| places.get(ObjectId(last)).is_some()));
        }
        assert!(places.places.len() < 32 && places.memory_bytes() < 64 * 48, "{} bytes", places.memory_bytes());
    }

    #[test]
    fn who_crosses_an_edge_again_and_again_gains_no_tighter_bound_at_once() {
        let mut walk = Walk::new(1, Some(SessionId(1)));
        let first = walk.ask();
        let mut seen = 0;
        for _ in 0..200 {
            walk.step(false);
            let tbv = walk.ask();
            seen += u32::from(tbv.centre != first.centre);
            let room = first.radius + SPEED * walk.tick.seconds_since(first.issued) - tbv.radius;
            assert!(tbv.centre.metres().distance(first.centre.metres()) <= room + 1e-6);
        }
        assert!(seen > 20, "a bound must follow its object: {seen}");
    }

    #[test]
    fn after_a_violation_bounds_begin_anew() {
        let mut walk = Walk::new(1, Some(SessionId(1)));
        walk.ask();
        walk.tell_place();
        walk.object.position = Position::from_metres(DVec3::X * 500.0).unwrap();
        walk.object.issue = Issue(1);
        let tbv = walk.ask();
        assert!(tbv.radius < 1.5 && tbv.centre.metres().distance(DVec3::X * 500.0) < 1.5, "{tbv:?}");
    }

    #[test]
    fn at_the_edge_of_the_world_a_place_is_blurred_too() {
        let mut walk = Walk::new(3, Some(SessionId(1)));
        for corner in [METRES_MAX, -METRES_MAX] {
            walk.object.position = Position::from_metres(DVec3::new(corner, 0.0, corner)).unwrap();
            walk.object.issue = Issue(walk.object.issue.0 + 1);
            assert!(walk.ask().radius > 1.0);
        }
    }
}
