//! Objects moved in every legal way stay inside; what makes no sense is everywhere.

use std::time::Duration;

use proptest::prelude::*;

use super::*;

/// One stretch of motion: towards a direction, at a share of the limit, for some microseconds.
#[derive(Clone, Debug)]
struct Leg {
    heading: DVec3,
    share: f64,
    micros: i64,
}

fn heading() -> impl Strategy<Value = DVec3> {
    let any = prop::array::uniform3(-1.0..1.0f64)
        .prop_map(|axes| DVec3::from_array(axes).try_normalize().unwrap_or(DVec3::X));
    // Along an axis boxes and spheres are reached exactly; there and back reverses.
    prop_oneof![2 => any, 1 => Just(DVec3::X), 1 => Just(DVec3::NEG_X), 1 => Just(DVec3::NEG_Z)]
}

fn legs() -> impl Strategy<Value = Vec<Leg>> {
    // At the limit, standing, or between.
    let share = prop_oneof![3 => Just(1.0), 1 => Just(0.0), 2 => 0.0..1.0f64];
    let micros = prop_oneof![1i64..100, 1000i64..5_000_000, Just(1_000_000i64)];
    let leg = (heading(), share, micros).prop_map(|(heading, share, micros)| Leg { heading, share, micros });
    prop::collection::vec(leg, 1..12)
}

fn place() -> impl Strategy<Value = DVec3> {
    let coordinate = prop_oneof![-1e6..1e6f64, -10.0..10.0f64, Just(1e6), Just(0.0)];
    [coordinate.clone(), coordinate.clone(), coordinate].prop_map(DVec3::from_array)
}

fn speed() -> impl Strategy<Value = f64> {
    prop_oneof![0.01..30.0f64, Just(0.0), Just(1e-9), Just(2.0), 1e3..1e4f64]
}

fn issued() -> impl Strategy<Value = WorldTime> {
    prop_oneof![Just(0), -1_000_000i64..1_000_000_000_000].prop_map(WorldTime::from_micros)
}

fn limits(speed_max: f64, acceleration_max: f64, reach: f64) -> MotionLimits {
    // Its box limits are those of motion at `speed_max` in any direction.
    MotionLimits { speed_max, acceleration_max, axis_speed_max: DVec3::splat(speed_max), reach }
}

fn volume(bound: &TemporalBound, until: WorldTime) -> Vec<Bound> {
    let mut pieces = Vec::new();
    bound.volume(until, &mut pieces);
    assert!(!pieces.is_empty());
    pieces
}

/// Whether the object, its farthest parts included, is in one piece.
fn holds(pieces: &[Bound], position: DVec3, reach: f64) -> bool {
    let parts: Vec<DVec3> =
        [DVec3::X, DVec3::Y, DVec3::Z, DVec3::ONE.normalize()].iter().flat_map(|&d| [d * reach, -d * reach]).collect();
    pieces.iter().any(|piece| parts.iter().all(|&part| contains(piece, position + part)))
}

/// Whether everything in one volume is in the other, to a micrometre.
fn is_within(inner: &[Bound], outer: &[Bound]) -> bool {
    const SLACK: f64 = 1e-6;
    inner.iter().all(|inner| {
        outer.iter().any(|outer| match (inner, outer) {
            (Bound::Sphere { centre, radius }, Bound::Sphere { centre: outer_centre, radius: outer_radius }) => {
                centre.distance(*outer_centre) + radius <= outer_radius + SLACK
            }
            (Bound::Box(inner), Bound::Box(outer)) => outer.inflated(SLACK).contains_box(inner),
            _ => false,
        })
    })
}

/// Moves an object and looks at every instant given by the legs' quarters.
fn check_moves(
    bounds: &[TemporalBound],
    mut state: MotionState,
    legs: &[Leg],
    reach: f64,
    mut advance: impl FnMut(&mut MotionState, &Leg, f64),
) -> Result<(), TestCaseError> {
    let mut now = bounds[0].issued();
    let end = bounds[0].expires();
    for leg in legs {
        for quarter in 0..4 {
            let micros = leg.micros * (quarter + 1) / 4 - leg.micros * quarter / 4;
            advance(&mut state, leg, micros as f64 * 1e-6);
            now = now.offset_micros(micros);
            for bound in bounds {
                prop_assert!(
                    holds(&volume(bound, now), state.position, reach),
                    "{bound:?} lost {} at {now:?}: {:?}",
                    state.position,
                    volume(bound, now)
                );
                prop_assert!(holds(&volume(bound, end), state.position, reach), "{bound:?} lost it before its end");
            }
        }
    }
    Ok(())
}

fn end_of(issued: WorldTime, legs: &[Leg]) -> WorldTime {
    issued.offset_micros(legs.iter().map(|leg| leg.micros).sum())
}

proptest! {
    /// Stop and dash, reversing, straight on at the limit: whatever the speed allows.
    #[test]
    fn what_keeps_its_speed_stays_inside(
        position in place(), speed in speed(), reach in 0.0..5.0f64, issued in issued(), legs in legs(),
    ) {
        let state = MotionState { position, velocity: DVec3::ZERO };
        let expires = end_of(issued, &legs);
        let limits = limits(speed, f64::INFINITY, reach);
        let bounds = [TbvShape::SpeedSphere, TbvShape::Box]
            .map(|shape| TemporalBound::new(shape, state, limits, None, issued, expires));
        check_moves(&bounds, state, &legs, reach, |state, leg, seconds| {
            state.position += leg.heading * leg.share * speed * seconds;
        })?;
    }

    /// Each axis at its own limit at once: the corners of the box.
    #[test]
    fn what_keeps_its_speed_along_each_axis_stays_in_the_box(
        position in place(), speeds in prop::array::uniform3(speed()), issued in issued(), legs in legs(),
    ) {
        let state = MotionState { position, velocity: DVec3::ZERO };
        let axis_speed_max = DVec3::from_array(speeds);
        let limits = MotionLimits { axis_speed_max, ..limits(f64::INFINITY, f64::INFINITY, 0.25) };
        let bound = TemporalBound::new(TbvShape::Box, state, limits, None, issued, end_of(issued, &legs));
        check_moves(&[bound], state, &legs, 0.25, |state, leg, seconds| {
            state.position += leg.heading.map(f64::signum) * axis_speed_max * leg.share * seconds;
        })?;
    }

    /// Any present velocity, any acceleration up to the limit, speed capped.
    #[test]
    fn what_keeps_its_speed_and_acceleration_stays_inside(
        position in place(), speed in speed(), present in (heading(), prop_oneof![Just(1.0), Just(0.0), 0.0..1.0f64]),
        acceleration in prop_oneof![0.1..20.0f64, Just(0.0), 1e-6..1e-3f64, 1e3..1e6f64],
        reach in 0.0..5.0f64, issued in issued(), legs in legs(),
    ) {
        let state = MotionState { position, velocity: present.0 * present.1 * speed };
        let expires = end_of(issued, &legs);
        let limits = limits(speed, acceleration, reach);
        let bound = TemporalBound::new(TbvShape::AccelerationSphere, state, limits, None, issued, expires);
        check_moves(std::slice::from_ref(&bound), state, &legs, reach, |state, leg, seconds| {
            // In steps as short as the speed needs to change in: then what is capped is capped smoothly.
            const STEPS: i32 = 24;
            for _ in 0..STEPS {
                let seconds = seconds / f64::from(STEPS);
                let wanted = state.velocity + leg.heading * leg.share * acceleration * seconds;
                // A projection onto a ball brings nothing farther apart, so this too accelerates by no more.
                let velocity = wanted.clamp_length_max(speed);
                state.position += (state.velocity + velocity) * 0.5 * seconds;
                state.velocity = velocity;
            }
        })?;
        // Never larger than what the speed alone says.
        let plain = TemporalBound::new(TbvShape::SpeedSphere, state, limits, None, issued, expires);
        let radius = |bound: &TemporalBound| match volume(bound, expires)[..] {
            [Bound::Sphere { radius, .. }] => radius,
            _ => f64::NAN,
        };
        prop_assert!(radius(&bound) <= radius(&plain) * (1.0 + 1e-8) + 1e-9, "{} > {}", radius(&bound), radius(&plain));
    }

    /// The volume for a longer validity contains that for a shorter.
    #[test]
    fn volumes_grow(
        position in -1e3..1e3f64, speed in 0.0..50.0f64, share in 0.0..=1.0f64, acceleration in 0.0..100.0f64,
        pieces in 0usize..20, micros in prop::array::uniform2(0i64..20_000_000),
    ) {
        let state = MotionState { position: DVec3::splat(position), velocity: DVec3::Z * speed * share };
        let path: Path = Arc::new(Lissajous { centre: state.position, size: 3.0, rate: speed / 10.0, tilt: share });
        let [shorter, longer] = { let [a, b] = micros; [a.min(b), a.max(b)] };
        for shape in [
            TbvShape::SpeedSphere, TbvShape::AccelerationSphere, TbvShape::Box, TbvShape::Swept { pieces },
        ] {
            let limits = limits(speed, acceleration, 0.5);
            let bound =
                TemporalBound::new(shape, state, limits, Some(path.clone()), WorldTime::ZERO, WorldTime::MAX);
            let [inner, outer] = [shorter, longer].map(|until| volume(&bound, WorldTime::from_micros(until)));
            prop_assert!(is_within(&inner, &outer), "{shape:?}: {inner:?} not in {outer:?}");
        }
    }

    #[test]
    fn what_follows_its_path_stays_in_a_piece_of_the_sweep(
        centre in place(), size in 0.0..50.0f64, rate in 0.0..3.0f64, tilt in 0.0..1.0f64, pieces in 0usize..40,
        issued in issued(), micros in prop_oneof![0i64..100, 0i64..60_000_000], reach in 0.0..2.0f64,
    ) {
        let path: Path = Arc::new(Lissajous { centre, size, rate, tilt });
        let state = MotionState { position: DVec3::NAN, velocity: DVec3::NAN };
        let expires = issued.offset_micros(micros);
        let limits = limits(f64::INFINITY, f64::INFINITY, reach);
        let bound =
            TemporalBound::new(TbvShape::Swept { pieces }, state, limits, Some(path.clone()), issued, expires);
        let swept = volume(&bound, expires);
        prop_assert!(swept.len() <= pieces.max(1));
        for i in 0..=100 {
            let at = issued.offset_micros(micros * i / 100);
            prop_assert!(holds(&swept, path.position(at), reach), "lost at {at:?}");
            prop_assert!(holds(&volume(&bound, at), path.position(at), reach), "lost at {at:?}, its own end");
        }
    }
}

/// Swings along each axis at another rate.
struct Lissajous {
    centre: DVec3,
    size: f64,
    rate: f64,
    tilt: f64,
}

impl Trajectory for Lissajous {
    fn position(&self, at: WorldTime) -> DVec3 {
        let angle = self.rate * at.seconds();
        self.centre + self.size * DVec3::new(angle.sin(), self.tilt * (2.0 * angle).sin(), (angle * 0.5).cos())
    }

    fn speed_max(&self) -> f64 {
        // At 10⁶ s the angle's own rounding moves it.
        self.size * self.rate * DVec3::new(1.0, 2.0 * self.tilt, 0.5).length() * (1.0 + 1e-9)
    }
}

/// Straight on along x at 2 m/s.
struct Straight;

impl Trajectory for Straight {
    fn position(&self, at: WorldTime) -> DVec3 {
        DVec3::X * 2.0 * at.seconds()
    }

    fn speed_max(&self) -> f64 {
        2.0
    }
}

const SECOND: WorldTime = WorldTime::from_micros(1_000_000);

fn at_rest(position: DVec3) -> MotionState {
    MotionState { position, velocity: DVec3::ZERO }
}

#[test]
fn the_sphere_from_acceleration_is_as_tight_as_it_can_be_while_nothing_turned() {
    let (speed, acceleration, seconds) = (2.0, 1.0, 1.0);
    let state = MotionState { position: DVec3::ZERO, velocity: DVec3::X };
    let limits = limits(speed, acceleration, 0.0);
    let bound = TemporalBound::new(TbvShape::AccelerationSphere, state, limits, None, WorldTime::ZERO, SECOND);
    // From where it stands to as far as it gets: v·t + a·t²/2.
    let [Bound::Sphere { centre, radius }] = volume(&bound, SECOND)[..] else { panic!() };
    let front = 1.0 * seconds + 0.5 * acceleration * seconds * seconds;
    assert!((radius - 0.5 * front).abs() < 1e-5 && centre.distance(DVec3::X * 0.5 * front) < 1e-9, "{centre} {radius}");

    // Once it could have turned round it is nearly what the speed says, about a place ahead.
    let late = WorldTime::from_micros(20_000_000);
    let [Bound::Sphere { centre, radius }] = volume(&bound.with_expiry(late), late)[..] else { panic!() };
    println!("after 20 s: {radius:.3} m instead of 40 m, {:.3} m ahead", centre.x);
    assert!(radius < 40.0 && radius > 36.0 && centre.x > 0.0);
}

#[test]
fn a_velocity_beyond_the_limit_says_nothing() {
    let state = MotionState { position: DVec3::ZERO, velocity: DVec3::X * 3.0 };
    let limits = limits(2.0, 1.0, 0.0);
    let [fast, plain] = [TbvShape::AccelerationSphere, TbvShape::SpeedSphere]
        .map(|shape| volume(&TemporalBound::new(shape, state, limits, None, WorldTime::ZERO, SECOND), SECOND));
    assert_eq!(fast, plain);
}

#[test]
fn a_sweep_is_as_tight_as_asked() {
    let bound = |pieces| {
        let shape = TbvShape::Swept { pieces };
        let limits = limits(0.0, 0.0, 0.1);
        TemporalBound::new(
            shape,
            at_rest(DVec3::ZERO),
            limits,
            Some(Arc::new(Straight)),
            WorldTime::ZERO,
            WorldTime::MAX,
        )
    };
    // What goes straight at full speed is not widened at all.
    for pieces in [1, 4, 64] {
        let boxes = volume(&bound(pieces), SECOND);
        let all = boxes.iter().fold(Aabb::EMPTY, |all, piece| all.union(&piece.aabb().unwrap()));
        assert!(all.size().abs_diff_eq(DVec3::new(2.2, 0.2, 0.2), 1e-4), "{pieces}: {}", all.size());
        assert!(boxes.len() <= pieces && 2 * boxes.len() >= pieces, "{} of {pieces}", boxes.len());
        let longest = boxes.iter().map(|piece| piece.aabb().unwrap().size().x).fold(0.0, f64::max);
        assert!(longest <= 0.2 + 2.0 * 2.0 / pieces as f64 + 1e-4);
    }
    assert_eq!(volume(&bound(0), SECOND), volume(&bound(1), SECOND));
    assert!(volume(&bound(usize::MAX), SECOND).len() <= PIECES_MAX);

    // More pieces leave less room.
    let path: Path = Arc::new(Lissajous { centre: DVec3::ZERO, size: 3.0, rate: 1.0, tilt: 0.5 });
    let room = |pieces: usize| {
        let shape = TbvShape::Swept { pieces };
        let limits = limits(0.0, 0.0, 0.0);
        let path = Some(path.clone());
        let bound = TemporalBound::new(shape, at_rest(DVec3::ZERO), limits, path, WorldTime::ZERO, WorldTime::MAX);
        let boxes = volume(&bound, WorldTime::from_micros(4_096_000));
        boxes.iter().map(|piece| piece.aabb().unwrap().size().element_product()).sum::<f64>()
    };
    assert!(room(4) < 0.7 * room(1) && room(64) < 0.1 * room(4), "{} {} {}", room(1), room(4), room(64));
}

#[test]
fn without_speed_it_rests() {
    for shape in [TbvShape::SpeedSphere, TbvShape::AccelerationSphere, TbvShape::Box] {
        let limits = limits(0.0, 5.0, 0.4);
        let bound = TemporalBound::new(shape, at_rest(DVec3::ONE), limits, None, WorldTime::ZERO, WorldTime::MAX);
        let resting = volume(&bound, WorldTime::ZERO);
        assert_eq!(volume(&bound, WorldTime::MAX), resting);
        let aabb = resting[0].aabb().unwrap();
        assert!(aabb.size().abs_diff_eq(DVec3::splat(0.8), 1e-5), "{shape:?}: {aabb:?}");
    }
}

#[test]
fn what_makes_no_sense_is_everywhere() {
    let good = (at_rest(DVec3::ZERO), limits(2.0, 1.0, 0.5));
    let path: Path = Arc::new(Straight);
    let everywhere = |shape, state, limits, path: Option<&Path>| {
        let bound = TemporalBound::new(shape, state, limits, path.cloned(), WorldTime::ZERO, SECOND);
        assert_eq!(volume(&bound, SECOND), [Bound::Everywhere], "{shape:?} {state:?} {limits:?}");
        assert_eq!(bound.shape(), TbvShape::Everywhere);
    };
    let shapes = [TbvShape::SpeedSphere, TbvShape::AccelerationSphere, TbvShape::Box, TbvShape::Swept { pieces: 3 }];
    for shape in shapes {
        let bound = TemporalBound::new(shape, good.0, good.1, Some(path.clone()), WorldTime::ZERO, SECOND);
        assert_ne!(volume(&bound, SECOND), [Bound::Everywhere], "{shape:?}");
        for bad in [f64::NAN, -1.0, f64::NEG_INFINITY] {
            everywhere(shape, good.0, MotionLimits { speed_max: bad, ..good.1 }, Some(&path));
            everywhere(shape, good.0, MotionLimits { acceleration_max: bad, ..good.1 }, Some(&path));
            everywhere(
                shape,
                good.0,
                MotionLimits { axis_speed_max: DVec3::new(1.0, bad, 1.0), ..good.1 },
                Some(&path),
            );
            everywhere(shape, good.0, MotionLimits { reach: bad, ..good.1 }, Some(&path));
        }
        everywhere(shape, good.0, MotionLimits { reach: f64::INFINITY, ..good.1 }, Some(&path));
    }
    everywhere(TbvShape::Everywhere, good.0, good.1, None);
    everywhere(TbvShape::Swept { pieces: 3 }, good.0, good.1, None);
    // Infinite where it counts.
    everywhere(TbvShape::SpeedSphere, good.0, limits(f64::INFINITY, 1.0, 0.5), None);
    everywhere(TbvShape::AccelerationSphere, good.0, limits(f64::INFINITY, 1.0, 0.5), None);
    everywhere(TbvShape::AccelerationSphere, good.0, limits(1.0, f64::INFINITY, 0.5), None);
    everywhere(TbvShape::Box, good.0, limits(f64::INFINITY, 1.0, 0.5), None);
    for bad in [DVec3::NAN, DVec3::INFINITY] {
        for shape in &shapes[..3] {
            everywhere(*shape, at_rest(bad), good.1, None);
        }
        everywhere(TbvShape::AccelerationSphere, MotionState { velocity: bad, ..good.0 }, good.1, None);
    }
    for speed in [f64::NAN, -1.0, f64::INFINITY] {
        let path: Path = Arc::new(Odd { speed, position: DVec3::ZERO });
        everywhere(TbvShape::Swept { pieces: 2 }, good.0, good.1, Some(&path));
    }
}

/// A path that may make no sense.
struct Odd {
    speed: f64,
    position: DVec3,
}

impl Trajectory for Odd {
    fn position(&self, _: WorldTime) -> DVec3 {
        self.position
    }

    fn speed_max(&self) -> f64 {
        self.speed
    }
}

#[test]
fn a_path_to_nowhere_is_everywhere() {
    let path: Path = Arc::new(Odd { speed: 1.0, position: DVec3::new(0.0, f64::NAN, 0.0) });
    let shape = TbvShape::Swept { pieces: 2 };
    let limits = limits(1.0, 1.0, 0.0);
    let bound = TemporalBound::new(shape, at_rest(DVec3::ZERO), limits, Some(path), WorldTime::ZERO, SECOND);
    assert_eq!(volume(&bound, SECOND), [Bound::Everywhere]);
}

#[test]
fn odd_times_are_defined() {
    let new = |issued, expires| {
        TemporalBound::new(TbvShape::SpeedSphere, at_rest(DVec3::ZERO), limits(2.0, 1.0, 0.5), None, issued, expires)
    };
    // Expired before it was made.
    let backwards = new(SECOND, WorldTime::ZERO);
    for until in [WorldTime::MIN, WorldTime::ZERO, SECOND, WorldTime::MAX] {
        assert_eq!(volume(&backwards, until), [Bound::Everywhere]);
    }
    assert_ne!(volume(&backwards.with_expiry(SECOND), SECOND), [Bound::Everywhere]);
    // Before it was made it says what it says then; after its end nothing.
    let bound = new(WorldTime::ZERO, SECOND);
    assert_eq!(volume(&bound, WorldTime::MIN), volume(&bound, WorldTime::ZERO));
    assert_eq!(volume(&bound, SECOND.offset_micros(1)), [Bound::Everywhere]);
    // Longer than time can count.
    let endless = new(WorldTime::MIN, WorldTime::MAX);
    assert_eq!(volume(&endless, WorldTime::MAX), [Bound::Everywhere]);
    assert_ne!(volume(&endless, WorldTime::MIN), [Bound::Everywhere]);
    assert_ne!(volume(&new(WorldTime::from_micros(-5), WorldTime::MAX), SECOND), [Bound::Everywhere]);
    // Too large for f64.
    let huge = TemporalBound::new(
        TbvShape::SpeedSphere,
        at_rest(DVec3::ZERO),
        limits(f64::MAX, 1.0, 0.5),
        None,
        WorldTime::ZERO,
        WorldTime::MAX,
    );
    assert_eq!(volume(&huge, WorldTime::ZERO + Duration::from_secs(9)), [Bound::Everywhere]);
}

#[test]
fn what_is_in_pieces_already_stays() {
    let mut pieces = vec![Bound::Sphere { centre: DVec3::ZERO, radius: 1.0 }];
    let nothing =
        TemporalBound::new(TbvShape::Everywhere, at_rest(DVec3::ZERO), limits(1.0, 1.0, 1.0), None, SECOND, SECOND);
    nothing.volume(SECOND, &mut pieces);
    assert_eq!(pieces, [Bound::Sphere { centre: DVec3::ZERO, radius: 1.0 }, Bound::Everywhere]);
}
