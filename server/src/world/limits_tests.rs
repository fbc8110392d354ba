//! The table of `limits.rs`, held to: what each hostile packet makes the world do, counted.

use eyeline_protocol::codec::{DatagramWriter, encode_control};
use eyeline_protocol::{ClientHeader, LinkHeader, Reason, Role};

use super::tests::{datagram, join};
use super::*;
use crate::policy::Visible;
use crate::spec::{ClassSpec, ObjectSpec};

const NONE: WorldTime = WorldTime::ZERO;

fn at(millis: u64) -> WorldTime {
    NONE + Duration::from_millis(millis)
}

/// A world of so many chairs.
fn world(chairs: usize) -> World {
    let class = ClassSpec { name: "chair".into(), radius: 0.3, bottom: 0.0, top: 1.0, speed_max: 1.0 };
    let chair = |index: usize| ObjectSpec {
        name: format!("chair {index}"),
        class: "chair".into(),
        position: [(index % 50) as f64, 0.0, (index / 50) as f64],
        node: None,
        heading: 0.0,
        takeable: false,
        path: None,
    };
    let spec = WorldSpec { classes: vec![class], objects: (0..chairs).map(chair).collect(), ..WorldSpec::default() };
    let info = WorldInfo { name: "test".into(), hash: [0; 32], size_bytes: 0, two_sided: false };
    World::new(WorldConfig::default(), spec, info, DVec3::ZERO, Box::new(Visible), NONE).unwrap()
}

/// All that the world has to say now: datagrams to `to` and their bytes, messages to others, and whether `to` is told to go.
#[derive(Debug, Default, PartialEq)]
struct Said {
    datagrams: usize,
    bytes: usize,
    to_others: usize,
    closed: bool,
}

fn said(world: &mut World, to: SessionId, now: WorldTime) -> Said {
    let mut said = Said::default();
    while let Some((id, transmit)) = world.poll_transmit(now) {
        match transmit {
            Transmit::Datagram(bytes) if id == to => {
                said.datagrams += 1;
                said.bytes += bytes.len();
            }
            Transmit::Close(_) if id == to => said.closed = true,
            _ if id == to => {}
            _ => said.to_others += 1,
        }
    }
    said
}

fn request(object: u32, want: Want) -> ClientRecord {
    ClientRecord::Request { object: ObjectId(object), want, reason: Reason::Exposed }
}

/// As many different requests as a datagram of 1,150 bytes holds.
fn full(seq: u32, want: Want) -> (Vec<u8>, usize) {
    let link = LinkHeader { seq, ..LinkHeader::default() };
    let mut writer = DatagramWriter::new(&ClientHeader { link, frame: NONE }, 1_150);
    let records = (0..).take_while(|&object| writer.push(&request(object, want))).count();
    (writer.finish(), records)
}

#[test]
fn what_was_asked_about_once_takes_no_memory_for_ever() {
    let chairs = 400;
    let mut world = world(chairs);
    let asker = join(&mut world, Role::Avatar);
    said(&mut world, asker, NONE);
    let before = world.memory_bytes();
    let all: Vec<ClientRecord> = (0..chairs as u32).map(|chair| request(chair, Want::Place)).collect();
    for (seq, asked) in (1..).zip(all.chunks(100)) {
        world.handle_datagram(asker, &datagram(seq, asked), at(10));
    }
    while said(&mut world, asker, at(10)).datagrams > 0 {}
    assert_eq!(world.stats().out.places, chairs as u64);
    let asked = world.memory_bytes();
    // By then no question of these can arrive any more, and each chair may be anywhere in its bound.
    for tick in 1..=80 {
        world.handle_datagram(asker, &datagram(10 + tick as u32, &[request(0, Want::Bound)]), at(50 * tick));
        world.tick(at(50 * tick));
        said(&mut world, asker, at(50 * tick));
    }
    let after = world.memory_bytes();
    assert!(asked - before > 10_000 && after < before + 2_000, "{before}, {asked}, then {after} bytes");
}

#[test]
fn a_datagram_of_requests_costs_an_answer_a_record_and_five_times_its_bytes() {
    let mut world = world(1_000);
    let hostile = join(&mut world, Role::Avatar);
    said(&mut world, hostile, NONE);
    for (seq, want) in [(1, Want::State), (2, Want::Bound), (3, Want::Place)] {
        let before = *world.stats();
        let (bytes, records) = full(seq, want);
        assert!((150..=240).contains(&records), "{records}");
        world.handle_datagram(hostile, &bytes, NONE);
        let told = said(&mut world, hostile, NONE);
        let out = world.stats().out.since(&before.out);
        assert_eq!((out.total() as usize, told.to_others), (records, 0), "{want:?}");
        assert!(told.bytes <= 5 * bytes.len(), "{want:?}: {} bytes for {}", told.bytes, bytes.len());
    }
}

#[test]
fn a_flood_of_requests_is_answered_as_far_as_the_limit_and_ends() {
    let mut world = world(100);
    let hostile = join(&mut world, Role::Avatar);
    said(&mut world, hostile, NONE);
    let (mut sent, mut answered, mut ended) = (0, 0, None);
    // Ten datagrams a millisecond, a hundred requests in each.
    for seq in 1..20_000u32 {
        let now = at(u64::from(seq / 10));
        let records: Vec<ClientRecord> = (0..100).map(|object| request(object, Want::State)).collect();
        world.handle_datagram(hostile, &datagram(seq, &records), now);
        sent += records.len() as u64;
        let before = world.stats().out.total();
        let told = said(&mut world, hostile, now);
        answered += world.stats().out.total() - before;
        if told.closed {
            ended = Some(now);
            break;
        }
    }
    let ended = ended.expect("a flood ends").since(NONE).as_secs_f64();
    let limit = Limits::default().requests;
    let share = 1.0 + limit.object * 101.0;
    let most = (limit.burst + limit.per_second * ended) * share;
    assert!(ended < 0.5 && sent > 200_000, "{ended} s, {sent} requests");
    assert!((answered as f64) <= most && answered > 4_000, "{answered} of {sent} were answered, {most} may be");
    assert_eq!((world.stats().busy, world.is_spent(hostile)), (1, true));
    // From then on it says nothing that counts.
    let before = *world.stats();
    world.handle_datagram(hostile, &datagram(30_000, &[request(1, Want::State)]), at(9_000));
    assert_eq!(said(&mut world, hostile, at(9_000)), Said::default());
    assert_eq!(world.stats().messages_in, before.messages_in);
}

#[test]
fn who_acknowledges_nothing_does_not_have_the_world_build_without_end() {
    let mut world = world(0);
    let hostile = join(&mut world, Role::Avatar);
    let _other = join(&mut world, Role::Avatar);
    said(&mut world, hostile, NONE);
    // One more than are awaited, all within a tick.
    for seq in 1..=600 {
        world.handle_datagram(hostile, &datagram(seq, &[request(1, Want::State)]), NONE);
        assert_eq!(said(&mut world, hostile, NONE).datagrams, 1);
    }
    assert!(world.stats().datagrams_lost > 300);
    world.tick(at(50));
    assert_eq!(said(&mut world, hostile, at(50)).datagrams, 1, "what was given up is due again");
}

#[test]
fn what_is_over_the_limit_is_not_even_decoded() {
    let mut world = world(0);
    let hostile = join(&mut world, Role::Avatar);
    for _ in 0..2_000 {
        world.handle_datagram(hostile, &[0xff; 64], NONE);
    }
    let stats = world.stats();
    let decoded = Limits::default().datagrams.burst as u64;
    assert_eq!((stats.rejected_datagrams, stats.limited.of(Limited::Datagrams)), (decoded, 2_000 - decoded));
    // Of the largest there are, bytes come first.
    let mut world = self::world(0);
    let hostile = join(&mut world, Role::Avatar);
    for _ in 0..900 {
        world.handle_datagram(hostile, &[0xff; 1_452], NONE);
    }
    assert_eq!(world.stats().rejected_datagrams, 524_288 / 1_452);
}

#[test]
fn before_hello_a_connection_is_limited_too() {
    let mut world = world(0);
    let hostile = world.connect(NONE);
    for _ in 0..10_000 {
        world.handle_datagram(hostile, &[0; 20], NONE);
    }
    assert!(world.stats().rejected_datagrams <= 960 && said(&mut world, hostile, NONE).closed);
}

#[test]
fn a_lying_acknowledgement_has_what_is_in_sight_told_again_and_then_only_at_ticks() {
    let mut world = world(200);
    let hostile = join(&mut world, Role::Avatar);
    let all: Vec<ClientRecord> = (0..150).map(|object| request(object, Want::State)).collect();
    world.handle_datagram(hostile, &datagram(1, &all), NONE);
    let mut datagrams = said(&mut world, hostile, NONE).datagrams as u32;
    let mut told_at_once = 0;
    for seq in 2..300 {
        // It got the newest and nothing else, and asks about one more object.
        let link = LinkHeader { seq, ack: datagrams, ..LinkHeader::default() };
        let mut writer = DatagramWriter::new(&ClientHeader { link, frame: NONE }, 1_150);
        assert!(writer.push(&request(199, Want::State)));
        let before = world.stats().out.total();
        world.handle_datagram(hostile, &writer.finish(), NONE);
        datagrams += said(&mut world, hostile, NONE).datagrams as u32;
        let told = world.stats().out.total() - before;
        assert!(told <= 151, "{told} states for one datagram");
        told_at_once += told;
    }
    let limit = Limits::default().resends;
    let most = limit.burst * (1.0 + limit.object * 201.0);
    assert!(told_at_once as f64 <= most + 300.0, "{told_at_once}, at most {most}");
    assert!(world.stats().limited.of(Limited::Resends) >= 1);
    // At the tick it is all told, once.
    world.tick(at(50));
    let before = world.stats().out.total();
    said(&mut world, hostile, at(50));
    assert!(world.stats().out.total() - before <= 151);
}

#[test]
fn however_often_somebody_jumps_others_hear_of_it_once_a_tick_and_not_for_long() {
    let mut world = world(0);
    let hostile = join(&mut world, Role::Avatar);
    let others = [join(&mut world, Role::Avatar), join(&mut world, Role::Avatar)];
    said(&mut world, hostile, NONE);
    let mut violations = 0;
    for millis in 0..2_000 {
        let now = at(millis);
        let place = ClientControl::Place {
            object: ObjectId(0),
            position: Position::from_metres(DVec3::new(millis as f64, 0.0, 0.0)).unwrap(),
            present: true,
        };
        world.handle_control(hostile, &encode_control(&place)[4..], now);
        let before = world.stats().out.violations;
        world.tick(now);
        said(&mut world, hostile, now);
        violations += world.stats().out.violations - before;
    }
    let limit = Limits::default().places;
    // Unacknowledged ones are said again with every tick.
    let jumps = world.stats().violations;
    assert!(jumps as f64 <= limit.burst + 2.0 * limit.per_second, "{jumps} jumps");
    assert!(violations <= 40 * (others.len() as u64 + 1), "{violations} violations");
    assert!(world.stats().limited.of(Limited::Places) > 100);
}

#[test]
fn nothing_that_a_hostile_client_says_grows_without_bound() {
    let mut world = world(50);
    let hostile = join(&mut world, Role::Avatar);
    said(&mut world, hostile, NONE);
    let wants = [Want::State, Want::Bound, Want::Place];
    // Slowly enough to be within its limits, and for as long as it likes. Half of it is about what is not there.
    for seq in 1..3_000u32 {
        let now = at(20 * u64::from(seq));
        let records: Vec<ClientRecord> =
            (0..20).map(|n| request((seq * 7 + n * 13) % 100, wants[(seq + n) as usize % 3])).collect();
        world.handle_datagram(hostile, &datagram(seq, &records), now);
        world.tick(now);
        // Nothing is fetched: a path that carries nothing.
    }
    assert_eq!(world.stats().limited.total(), 0);
    let session = &world.sessions[&hostile];
    assert!(session.states_due() <= 51 && session.bounds_due.len() <= 51 && session.visible() <= 51);
    let before = world.stats().out.total();
    said(&mut world, hostile, at(60_000));
    assert!(world.stats().out.total() - before <= 102, "one thing an object is due, however often it was asked for");
}
