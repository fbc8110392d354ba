//! Time, motion and the wire: is a thing where its bound says, from a tick to a day, at rest and at a thousand kilometres a
//! second, and is what is no number refused?

use std::collections::BTreeSet;
use std::time::Duration;

use eyeline_client::clock::Clock;
use eyeline_client::tracking::{ExpiryQueue, MotionLimits, MotionState, TbvShape, TemporalBound};
use eyeline_protocol::codec::{self, DatagramWriter};
use eyeline_protocol::{
    Issue, LinkHeader, LocalTime, METRES_MAX, ObjectId, Orientation, Position, QUANTUM_METRES, ServerHeader,
    ServerRecord, Tbv, Velocity, WireTbv, WorldInfo, WorldTime,
};
use eyeline_server::path::Path;
use eyeline_server::policy::Visible;
use eyeline_server::spec::{ClassSpec, ObjectSpec, PathSpec, SpawnSpec, WorldSpec};
use eyeline_server::world::{World, WorldConfig};
use eyeline_visibility::Bound;
use glam::{DQuat, DVec3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use super::{Case, Finding, Oracle};

/// A tick, a second, a minute, an hour, a day; microseconds.
const SPANS: [i64; 5] = [50_000, 1_000_000, 60_000_000, 3_600_000_000, 86_400_000_000];

/// All cases.
pub fn cases() -> Vec<Case> {
    let mut cases = motion();
    cases.extend(times());
    cases.extend(wire());
    cases
}

fn motion() -> Vec<Case> {
    let mut cases = Vec::new();
    let asked = "metres by which a bound falls short of what the speed covers, from a tick to a day";
    for speed_steps in [0_i64, 1, 1_536, 102_400, 10_240_000, 1_024_000_000] {
        let name = format!("{} m/s on the wire", speed_steps as f64 * QUANTUM_METRES);
        cases.push(Case::new("bounds", name, asked, Oracle::Exact, move || growth(speed_steps)));
        let name = format!("{} m/s at the client", speed_steps as f64 * QUANTUM_METRES);
        cases.push(Case::new("bounds", name, asked, Oracle::Exact, move || volumes(speed_steps)));
    }
    let asked = "shapes of bounds that are not `everywhere`";
    for (name, speed) in [("infinite", f64::INFINITY), ("NaN", f64::NAN), ("negative", -1.0)] {
        cases.push(Case::new("bounds", format!("{name} speed"), asked, Oracle::Exact, move || {
            let said = "ball, box and accelerated ball";
            let shapes = [TbvShape::SpeedSphere, TbvShape::Box, TbvShape::AccelerationSphere];
            let other = shapes.iter().filter(|&&shape| volume(shape, speed, SPANS[1]) != [Bound::Everywhere]);
            Finding::new(other.count() as f64, 0.0, said)
        }));
    }
    cases.push(Case::new("bounds", "too fast or too wide for the wire", asked, Oracle::Exact, || {
        let tick = WorldTime::from_micros(1_000_000);
        let said = |radius, speed| WireTbv::new(&tbv(radius, speed, tick), tick).is_some();
        let bad = [said(1.0, 1e7), said(1e8, 1.0), said(f64::NAN, 1.0), said(1.0, f64::INFINITY)];
        Finding::new(bad.iter().filter(|&&said| said).count() as f64, 0.0, "1e7 m/s, 1e8 m, NaN and infinity")
    }));
    cases.push(Case::new("bounds", "a class of 1e7 m/s", "a refusal that names it", Oracle::Refusal, || {
        let class = ClassSpec { name: "comet".into(), radius: 1.0, bottom: 0.0, top: 1.0, speed_max: 1e7 };
        Finding::refusal(world(WorldSpec { classes: vec![class], ..WorldSpec::default() }), &["comet", "1e6"])
    }));
    cases
}

fn times() -> Vec<Case> {
    let asked = "microseconds by which the latest possible time is behind the server's";
    let mut cases = Vec::new();
    for (name, drift) in [("even", 0.0), ("a server 0.1 % fast", 1e-3), ("a server 0.1 % slow", -1e-3)] {
        cases.push(Case::new("clock", name, asked, Oracle::Exact, move || clock(drift, 0)));
    }
    cases.push(Case::new("clock", "a day of silence", asked, Oracle::Exact, || clock(1e-3, 86_400_000_000)));
    let asked = "metres from the place that integers give";
    for (name, years) in [("a path after a day", 0), ("a path after a century", 100), ("a path before time zero", -1)] {
        cases.push(Case::new("clock", name, asked, Oracle::Exact, move || path_after(years)));
    }
    let asked = "keys that came out at another place than an ordered set has them";
    cases.push(Case::new("clock", "expiries from the first to the last microsecond", asked, Oracle::Exact, expiries));
    cases
}

fn wire() -> Vec<Case> {
    let mut cases = Vec::new();
    let asked = "steps of 2^-10 m that a place moved on the wire, over half a step";
    for (name, around) in
        [("places at the anchor", 0.0), ("places 10^6 m out", 1e6), ("places at the edge", METRES_MAX)]
    {
        cases.push(Case::new("wire", name, asked, Oracle::Exact, move || {
            let mut chance = Pcg64::seed_from_u64(41);
            let mut worst = 0.0_f64;
            for _ in 0..10_000 {
                let metres = DVec3::from_array(std::array::from_fn(|_| around - chance.random_range(0.0..10.0)));
                let back = Position::from_metres(metres).map_or(DVec3::NAN, Position::metres);
                worst = worst.max(((back - metres) / QUANTUM_METRES).abs().max_element());
            }
            Finding::new(worst, 0.5, "10,000 places")
        }));
    }
    cases.push(Case::new("wire", "turns", "radians that a turn moved on the wire", Oracle::Exact, || {
        let mut chance = Pcg64::seed_from_u64(42);
        let mut worst = 0.0_f64;
        for _ in 0..10_000 {
            let mut any = || chance.random_range(-1.0..1.0);
            let turn = DQuat::from_xyzw(any(), any(), any(), any());
            if turn.length() > 1e-3 {
                worst = worst.max(turn.normalize().angle_between(Orientation::from_quat(turn).quat()));
            }
        }
        // Three components of 1/(2·511·√2) at most, each turning twice as far.
        Finding::new(worst, 0.0052, "10,000 turns")
    }));
    let asked = "metres by which a bound on the wire falls short of the one it was made from";
    cases.push(Case::new("wire", "bounds there and back", asked, Oracle::Exact, there_and_back));
    let asked = "a refusal that names the place";
    cases.push(Case::new("wire", "a place 3·10^6 m out", asked, Oracle::Refusal, || {
        Finding::refusal(Position::from_metres(DVec3::new(0.0, 3e6, 0.0)), &["3000000", "not within"])
    }));
    cases.push(Case::new("wire", "a chair 3·10^6 m out", "a refusal that names the chair", Oracle::Refusal, || {
        Finding::refusal(world(chair([3e6, 0.0, 0.0], None)), &["chair 7", "not within"])
    }));
    cases.push(Case::new(
        "wire",
        "a path that leaves the world",
        "a refusal that names the chair",
        Oracle::Refusal,
        || {
            let points = vec![[0.0; 3], [3e6, 0.0, 0.0]];
            Finding::refusal(world(chair([0.0; 3], Some(points))), &["chair 7", "not within"])
        },
    ));
    cases.push(Case::new("wire", "a spawn 3·10^6 m out", "a refusal that names it", Oracle::Refusal, || {
        let spawns = vec![SpawnSpec { position: [0.0, 0.0, 3e6], heading: 0.0 }];
        Finding::refusal(world(WorldSpec { spawns, ..WorldSpec::default() }), &["spawn", "3000000"])
    }));
    let asked = "prefixes and single flipped bits of a datagram that panicked or were taken for more than they hold";
    cases.push(Case::new("wire", "datagrams cut short or flipped", asked, Oracle::Exact, broken_datagrams));
    cases
}

fn tbv(radius: f64, speed: f64, issued: WorldTime) -> Tbv {
    Tbv { centre: Position { x: 5, y: -7, z: 9 }, radius, speed, issued, expires: WorldTime::MAX, issue: Issue(0) }
}

/// So many parts of a step of the wire's grid are told apart; a day at 10⁶ m/s still fits an i128.
const FINE_BITS: u32 = 55;
const FINE: f64 = (1_u64 << FINE_BITS) as f64;

/// How far `metres` is below (`radius_steps` + `speed_steps` a second for `micros`), exactly; in metres, at least 0.
fn short(metres: f64, radius_steps: i64, speed_steps: i64, micros: i64) -> f64 {
    if !metres.is_finite() {
        return f64::INFINITY;
    }
    // All in 2⁻⁵⁵ steps times 10⁶; the f64 is cut downward, which is against us.
    let has = (metres / QUANTUM_METRES * FINE).floor() as i128 * 1_000_000;
    let needs = (i128::from(radius_steps) * 1_000_000 + i128::from(speed_steps) * i128::from(micros)) << FINE_BITS;
    (needs - has).max(0) as f64 / FINE / 1e6 * QUANTUM_METRES
}

fn growth(speed_steps: i64) -> Finding {
    let issued = WorldTime::from_micros(123_456_789);
    let speed = speed_steps as f64 * QUANTUM_METRES;
    let (mut worst, mut loosest) = (0.0_f64, 0.0_f64);
    for span in SPANS.into_iter().flat_map(|span| [span, span - 1, span / 3]) {
        for radius_steps in [0, 1, 1024, 123_457] {
            let radius = radius_steps as f64 * QUANTUM_METRES;
            let now = tbv(radius, speed, issued).radius_at(issued.offset_micros(span));
            worst = worst.max(short(now, radius_steps, speed_steps, span));
            let exact = radius + speed * span as f64 * 1e-6;
            loosest = loosest.max((now - exact) / exact.max(f64::MIN_POSITIVE));
        }
    }
    Finding::new(worst, 0.0, format!("at most {loosest:.1e} of itself too large"))
}

/// The client's own bound of an object at a given speed, after `micros`.
fn volume(shape: TbvShape, speed: f64, micros: i64) -> Vec<Bound> {
    let state = MotionState { position: DVec3::ZERO, velocity: DVec3::ZERO };
    let limits = MotionLimits {
        speed_max: speed,
        // What reaches its greatest speed at once.
        acceleration_max: if speed.is_finite() { speed.max(1.0) * 1e6 } else { speed },
        axis_speed_max: DVec3::splat(speed),
        reach: 0.0,
    };
    let issued = WorldTime::ZERO;
    let until = issued.offset_micros(micros);
    let mut pieces = Vec::new();
    TemporalBound::new(shape, state, limits, None, issued, until).volume(until, &mut pieces);
    pieces
}

fn volumes(speed_steps: i64) -> Finding {
    let speed = speed_steps as f64 * QUANTUM_METRES;
    let mut worst = 0.0_f64;
    for span in SPANS {
        for shape in [TbvShape::SpeedSphere, TbvShape::Box] {
            for bound in volume(shape, speed, span) {
                let reach = match bound {
                    Bound::Sphere { centre, radius } => radius - centre.length(),
                    Bound::Everywhere => f64::MAX,
                    other => other.aabb().map_or(f64::MAX, |aabb| aabb.max.min_element()),
                };
                worst = worst.max(short(reach.min(1e14), 0, speed_steps, span));
            }
        }
    }
    Finding::new(worst, 0.0, "balls and boxes")
}

fn world(spec: WorldSpec) -> Result<World, eyeline_server::world::WorldError> {
    let info = WorldInfo { name: "far".into(), hash: [0; 32], size_bytes: 0, two_sided: false };
    World::new(WorldConfig::default(), spec, info, DVec3::ZERO, Box::new(Visible), WorldTime::ZERO)
}

fn chair(position: [f64; 3], points: Option<Vec<[f64; 3]>>) -> WorldSpec {
    let class = ClassSpec { name: "chair".into(), radius: 0.4, bottom: 0.0, top: 1.0, speed_max: 2.0 };
    let path = points.map(|points| PathSpec {
        points,
        speed: 1.0,
        pause: 0.0,
        phase: 0.0,
        wobble: 0.0,
        wobble_per_metre: 0.0,
        spring: None,
    });
    let name = "chair 7".to_owned();
    let object = ObjectSpec { name, class: "chair".into(), node: None, position, heading: 0.0, takeable: false, path };
    WorldSpec { classes: vec![class], objects: vec![object], ..WorldSpec::default() }
}

/// Probes of every delay while the server's clock drifts, then `silence` microseconds without any.
fn clock(drift: f64, silence: i64) -> Finding {
    let mut chance = Pcg64::seed_from_u64(43);
    let server = |local: i64| WorldTime::from_micros(77_000_000 + local + (local as f64 * drift).floor() as i64);
    let mut clock = Clock::default();
    let (mut now, mut early, mut late) = (1_000_000_i64, 0_i64, 0_i64);
    for probe in 0..2000 {
        let mut some = |most: i64| chance.random_range(0..most);
        let (forth, back, hold) = (some(200_000), some(200_000), some(100_000));
        let pause = if probe % 100 == 99 { 60_000_000 } else { some(1_000_000) };
        let stamped = now + forth + hold;
        let arrived = stamped + back;
        let round = Duration::from_micros((arrived - now - hold) as u64);
        clock.observe(server(stamped), round, LocalTime::from_micros(arrived));
        now = arrived + pause + if probe == 1999 { silence } else { 0 };
        let Some(latest) = clock.latest(LocalTime::from_micros(now)) else { continue };
        early = early.max(server(now).micros() - latest.micros());
        late = late.max(latest.micros() - server(now).micros());
    }
    Finding::new(early.max(0) as f64, 2.0, format!("2,000 probes; at most {:.3} s ahead of it", late as f64 * 1e-6))
}

/// A path of 2 m at 1 m/s with rests of half a second, against integers.
fn path_after(years: i64) -> Finding {
    let spec = chair([0.0; 3], Some(vec![[0.0; 3], [2.0, 0.0, 0.0]]));
    let mut path = spec.objects[0].path.clone().unwrap_or_else(|| unreachable!("it was given one"));
    path.pause = 0.5;
    let path = match Path::new(&path, 0.0, "chair") {
        Ok(path) => path,
        Err(error) => return Finding::new(f64::INFINITY, 0.0, error.to_string()),
    };
    const CYCLE: i64 = 5_000_000;
    let start = if years == 0 { 86_400_000_000 } else { years * 31_557_600_000_000 };
    let mut worst = 0.0_f64;
    for i in 0..2000 {
        let micros = start + i * 12_347;
        let into = micros.rem_euclid(CYCLE);
        let way = if into < CYCLE / 2 { into.min(2_000_000) } else { 2_000_000 - (into - CYCLE / 2).min(2_000_000) };
        let at = path.pose_at(WorldTime::from_micros(micros).seconds()).0.x;
        worst = worst.max((at - way as f64 * 1e-6).abs());
    }
    // Seconds in f64: two ulp of the time, at 1 m/s.
    let seconds = start.abs() as f64 * 1e-6 + 30.0;
    Finding::new(worst, 4.0 * f64::EPSILON * seconds + 1e-12, "2,000 moments")
}

fn expiries() -> Finding {
    let mut chance = Pcg64::seed_from_u64(44);
    let mut wrong = 0;
    for quantum in [Duration::ZERO, Duration::from_micros(1), Duration::from_millis(50), Duration::from_secs(86_400)] {
        let mut queue = ExpiryQueue::new(quantum);
        let mut set = BTreeSet::new();
        let far = [i64::MIN, i64::MIN + 1, -1, 0, 1, 86_400_000_000, i64::MAX - 1, i64::MAX];
        for key in 0..500_u32 {
            let at = if chance.random_bool(0.5) { far[chance.random_range(0..far.len())] } else { chance.random() };
            queue.insert(key, WorldTime::from_micros(at));
            set.insert((at, key));
        }
        let mut now = i64::MIN;
        for _ in 0..60 {
            now = if chance.random_bool(0.3) {
                far[chance.random_range(0..far.len())].max(now)
            } else {
                chance.random::<i64>().max(now)
            };
            let mut out = Vec::new();
            queue.expire(WorldTime::from_micros(now), &mut out);
            // Quantised queues may be early by their quantum, never late.
            let quantum = quantum.as_micros() as i64;
            let due: BTreeSet<u32> = set.iter().filter(|(at, _)| *at <= now).map(|(_, key)| *key).collect();
            let early = |key: &u32| set.iter().any(|(at, k)| k == key && *at > now.saturating_add(quantum));
            wrong += due.iter().filter(|key| !out.contains(key)).count() + out.iter().filter(|key| early(key)).count();
            set.retain(|(_, key)| !out.contains(key));
        }
        wrong += usize::from(now == i64::MAX && !queue.is_empty());
    }
    Finding::new(wrong as f64, 0.0, "4 quanta, 500 keys each")
}

fn there_and_back() -> Finding {
    let mut chance = Pcg64::seed_from_u64(45);
    let (mut worst, mut said) = (0.0_f64, 0);
    for _ in 0..10_000 {
        let issued = WorldTime::from_micros(chance.random_range(-1_000_000_000..1_000_000_000_000));
        let age = chance.random_range(0..4_000_000_000_i64);
        let tick = issued.offset_micros(age);
        let (radius, speed) = (chance.random_range(0.0..4e3), 10_f64.powf(chance.random_range(-6.0..6.0)));
        let from =
            Tbv { expires: tick.offset_micros(chance.random_range(0..86_400_000_000)), ..tbv(radius, speed, issued) };
        let Some(wire) = WireTbv::new(&from, tick) else { continue };
        said += 1;
        let back = wire.tbv(tick);
        let longer = back.expires > from.expires;
        for after in [0, 1_000, 50_000, 86_400_000_000] {
            let at = tick.offset_micros(after);
            worst = worst.max(from.radius_at(at) - back.radius_at(at));
        }
        worst = if longer || back.centre != from.centre { f64::INFINITY } else { worst };
    }
    if said < 5_000 {
        return Finding::new(f64::INFINITY, 0.0, format!("only {said} of 10,000 could be said"));
    }
    Finding::new(worst, 0.0, format!("{said} of 10,000 could be said"))
}

fn broken_datagrams() -> Finding {
    let header = ServerHeader {
        link: LinkHeader { seq: 9, ack: 7, ack_bits: 5, hold_micros: 3 },
        sent: WorldTime::from_micros(1_000_000),
        tick: WorldTime::from_micros(950_000),
    };
    let mut writer = DatagramWriter::new(&header, 1200);
    let mut records = 0;
    for id in 0..20 {
        let object = ObjectId(id);
        let position = Position { x: id as i32, y: -5, z: i32::MAX };
        let orientation = Orientation::from_yaw(f64::from(id));
        let velocity = Velocity::from_metres(DVec3::new(0.1, 0.0, -0.2));
        let state = ServerRecord::State { object, position, orientation, velocity };
        let wire =
            WireTbv::new(&tbv(1.0, 1.5, header.tick), header.tick).map(|tbv| ServerRecord::Bound { object, tbv });
        records += [Some(state), wire].into_iter().flatten().filter(|record| writer.push(record)).count();
    }
    let bytes = writer.finish();
    let mut bad = 0;
    match codec::decode_server_datagram(&bytes) {
        Ok((back, said)) if back == header && said.len() == records => {}
        _ => bad += 1,
    }
    // A prefix may be a shorter datagram; it may not hold more.
    for end in 0..bytes.len() {
        bad += usize::from(codec::decode_server_datagram(&bytes[..end]).is_ok_and(|(_, said)| said.len() >= records));
    }
    let mut refused = 0;
    for bit in 0..bytes.len() * 8 {
        let mut flipped = bytes.clone();
        flipped[bit / 8] ^= 1 << (bit % 8);
        match codec::decode_server_datagram(&flipped) {
            // Flips of numbers make other numbers; QUIC's own checks are what keeps them out.
            Ok((_, said)) => bad += usize::from(said.len() > bytes.len()),
            Err(_) => refused += 1,
        }
    }
    Finding::new(
        bad as f64,
        0.0,
        format!("{} prefixes, {} flips of which {refused} are refused", bytes.len(), bytes.len() * 8),
    )
}
