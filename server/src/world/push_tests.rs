//! What is pushed when: dead reckoning, the byte cap, and how fast a turn is believed.

use eyeline_protocol::{ClientHeader, LinkHeader, Prediction, Reason, Role, ServerHeader, ServerRecord};

use super::audit_tests::told;
use super::tests::{datagram, drain, join, world_of};
use super::*;
use crate::policy::{Broadcast, Visible};

const TICK_MICROS: i64 = 50_000;

/// A server and its clients, which all have avatars at chosen places; client 0 watches through a 320-pixel picture and
/// acknowledges.
struct Room {
    world: World,
    ids: Vec<SessionId>,
    seq: u32,
    tick: i64,
}

impl Room {
    fn new(config: WorldConfig, spec: WorldSpec, clients: usize) -> Room {
        let info = WorldInfo { name: "test".into(), hash: [0; 32], size_bytes: 0, two_sided: false };
        let mut world = World::new(config, spec, info, DVec3::ZERO, Box::new(Broadcast), WorldTime::ZERO).unwrap();
        let ids: Vec<SessionId> = (0..clients).map(|_| join(&mut world, Role::Avatar)).collect();
        drain(&mut world, ids[0]);
        Room { world, ids, seq: 0, tick: 0 }
    }

    /// Avatar `index` wants to be there.
    fn pose(&mut self, index: usize, x: f64, z: f64, yaw: f64) {
        self.seq += 1;
        let record = ClientRecord::Pose {
            object: ObjectId(index as u32),
            position: Position::from_metres(DVec3::new(x, 0.0, z)).unwrap(),
            orientation: Orientation::from_yaw(yaw),
        };
        self.world.handle_datagram(self.ids[index], &datagram(self.seq, &[record]), self.now());
    }

    fn put(&mut self, index: usize, x: f64, z: f64) {
        let position = Position::from_metres(DVec3::new(x, 0.0, z)).unwrap();
        assert!(self.world.teleport(ObjectId(index as u32), position));
    }

    fn now(&self) -> WorldTime {
        WorldTime::from_micros(self.tick * TICK_MICROS)
    }

    /// The next tick, and what it tells client 0, which says so if it `hears`.
    fn step(&mut self, hears: bool) -> Vec<(WorldTime, ServerRecord)> {
        self.tick += 1;
        let now = self.now();
        self.world.tick(now);
        let (records, headers) = told(&mut self.world, self.ids[0]);
        if hears && let Some(newest) = headers.last() {
            self.seq += 1;
            let link = LinkHeader { seq: self.seq, ack: newest.link.seq, ack_bits: u32::MAX, hold_micros: 0 };
            let header = ClientHeader { link, frame: now };
            let ack = codec::DatagramWriter::new(&header, 1200).finish();
            self.world.handle_datagram(self.ids[0], &ack, now);
        }
        records.into_iter().map(|record| (now, record)).collect()
    }
}

fn states_of(told: &[(WorldTime, ServerRecord)], id: u32) -> Vec<Prediction> {
    let state = |&(tick, record): &(WorldTime, ServerRecord)| match record {
        ServerRecord::State { object, position, orientation, velocity } if object.0 == id => {
            Some(Prediction { position, velocity, orientation, tick })
        }
        _ => None,
    };
    told.iter().filter_map(state).collect()
}

/// Walks avatar 1 straight for 2 s at `speed`, `distance` away, then turns it round; returns its pushes and the greatest
/// error in pixels of what the client drew at a tick.
fn walk(pixels: Option<f64>, distance: f64, hears: bool) -> (usize, f64) {
    let mut room = Room::new(WorldConfig::default().with_dead_reckoning_px(pixels), WorldSpec::default(), 2);
    room.put(0, 0.0, 0.0);
    room.put(1, 0.0, -distance);
    for _ in 0..3 {
        room.step(true);
    }
    let (mut pushes, mut worst, mut held) = (0, 0.0f64, None::<Prediction>);
    let mut x = 0.0;
    for step in 0..80 {
        x += if step < 40 { 0.06 } else { -0.06 };
        room.pose(1, x, -distance, 0.0);
        let told = room.step(hears);
        let states = states_of(&told, 1);
        pushes += states.len();
        held = states.last().copied().or(held);
        let object = &room.world.objects()[1];
        let eye = room.world.objects()[0].position.metres() + DVec3::Y * 1.6;
        if let Some(held) = held {
            let error = held.error_px(room.now(), object.position, object.orientation, 0.3, eye, 160.0);
            worst = worst.max(error);
        }
    }
    (pushes, worst)
}

#[test]
fn what_goes_on_as_it_did_is_not_told_again_and_never_drawn_wrong_by_more_than_was_allowed() {
    let (all, _) = walk(None, 8.0, true);
    let (near, near_px) = walk(Some(1.0), 8.0, true);
    let (far, far_px) = walk(Some(1.0), 60.0, true);
    assert_eq!(all, 80);
    assert!((2..30).contains(&near), "{near}");
    assert!(far < near, "level of detail: {far} pushes from afar, {near} near by");
    assert!(near_px <= 1.0 && far_px <= 1.0, "{near_px} {far_px}");
    assert!(near_px > 0.1, "the prediction is used at all: {near_px}");
}

/// What was sent and may not have arrived counts for what the client may draw, and so does what it had before.
#[test]
fn whatever_state_a_client_may_draw_from_must_be_right() {
    let mut room = Room::new(WorldConfig::default().with_dead_reckoning_px(Some(1.0)), WorldSpec::default(), 2);
    room.put(0, 0.0, 0.0);
    room.put(1, 0.0, -8.0);
    for _ in 0..3 {
        room.step(true);
    }
    // 0.15 m aside is 3 px. It stands there, and is told again until the client has said that it heard.
    room.pose(1, 0.075, -8.0, 0.0);
    room.step(false);
    for _ in 0..5 {
        room.pose(1, 0.15, -8.0, 0.0);
        assert_eq!(states_of(&room.step(false), 1).len(), 1);
    }
    room.step(true);
    assert!(states_of(&room.step(true), 1).is_empty());
    // It is told that it is elsewhere, unheard, and comes back to what was heard last.
    for x in [0.25, 0.25, 0.25, 0.25] {
        room.pose(1, x, -8.0, 0.0);
        room.step(false);
    }
    room.pose(1, 0.15, -8.0, 0.0);
    room.step(false);
    let object = &room.world.objects()[1];
    assert_eq!(object.position, Position::from_metres(DVec3::new(0.15, 0.0, -8.0)).unwrap());
    assert_eq!(states_of(&room.step(false), 1).len(), 1, "right by what was heard, wrong by what is under way");
}

#[test]
fn who_comes_nearer_is_told_what_was_right_enough_from_afar() {
    let mut room = Room::new(WorldConfig::default().with_dead_reckoning_px(Some(2.0)), WorldSpec::default(), 2);
    room.put(0, 0.0, 30.0);
    room.put(1, 0.0, -10.0);
    for _ in 0..3 {
        room.step(true);
    }
    // 0.2 m at 40 m is less than a pixel.
    for x in [0.05, 0.1, 0.15, 0.2, 0.2, 0.2] {
        room.pose(1, x, -10.0, 0.0);
        let told = room.step(true);
        assert!(states_of(&told, 1).is_empty(), "{told:?}");
    }
    let mut told = Vec::new();
    for step in 1..=360 {
        room.pose(0, 0.0, 30.0 - 0.1 * f64::from(step), 0.0);
        told.extend(room.step(true));
    }
    let told = states_of(&told, 1);
    assert_eq!(told.len(), 1, "{told:?}");
    assert_eq!(told[0].position, room.world.objects()[1].position);
}

#[test]
fn without_dead_reckoning_no_velocity_is_told() {
    let mut room = Room::new(WorldConfig::default(), WorldSpec::default(), 2);
    room.pose(1, 0.06, 0.0, 0.0);
    room.step(true);
    room.pose(1, 0.12, 0.0, 0.0);
    let told = room.step(true);
    assert!(states_of(&told, 1).iter().all(|state| state.velocity == eyeline_protocol::Velocity::ZERO));
    assert!(room.world.objects()[1].velocity.metres().x > 1.0);
}

/// 40 avatars that all move; returns the room and what client 0 was told in each tick.
fn crowd(bytes_per_second: Option<u32>, ticks: usize) -> (Room, Vec<Vec<(WorldTime, ServerRecord)>>) {
    let mut room = Room::new(WorldConfig::default().with_bytes_per_second(bytes_per_second), WorldSpec::default(), 41);
    for index in 1..=40 {
        room.put(index, 0.0, -(2.0 + index as f64));
    }
    for _ in 0..3 {
        room.step(true);
    }
    let mut told = Vec::new();
    for tick in 1..=ticks {
        for index in 1..=40 {
            room.pose(index, 0.05 * tick as f64, -(2.0 + index as f64), 0.0);
        }
        told.push(room.step(true));
    }
    (room, told)
}

#[test]
fn a_byte_cap_takes_the_largest_and_oldest_first_and_starves_nobody() {
    // 40 states of 23 bytes at 20 Hz are 18,400 bytes a second.
    let (room, told) = crowd(Some(6_000), 60);
    let records: Vec<(WorldTime, ServerRecord)> = told.into_iter().flatten().collect();
    let bytes = records.len() * 23;
    assert!((9_000..=21_000).contains(&bytes), "{bytes} bytes in 3 s");
    let counts: Vec<usize> = (1..=40).map(|id| states_of(&records, id).len()).collect();
    assert!(counts[0] > 3 * counts[39], "near ones more often: {counts:?}");
    assert!(counts.iter().all(|&count| count >= 2), "far ones too: {counts:?}");
    let stats = room.world.stats();
    assert!(stats.capped > 100 && stats.capped_late > 100, "{stats:?}");
    let (room, told) = crowd(None, 5);
    assert!(told.iter().all(|told| told.len() == 40));
    assert_eq!(room.world.stats().capped, 0);
}

/// However long a state waits, what goes out is the newest: nothing that is queued grows old.
#[test]
fn our_own_queue_holds_no_pose() {
    let (mut room, _) = crowd(Some(3_000), 10);
    for tick in 11..40 {
        for index in 1..=40 {
            room.pose(index, 0.05 * f64::from(tick), -(2.0 + index as f64), 0.0);
        }
        for (at, record) in room.step(true) {
            let ServerRecord::State { object, position, .. } = record else { continue };
            assert_eq!(position, room.world.objects()[object.index()].position, "{object} at {at:?}");
        }
    }
    // A driver that does not ask for datagrams for a second gets one tick's news, of that tick.
    for _ in 0..20 {
        room.tick += 1;
        let now = room.now();
        room.world.tick(now);
    }
    let (records, headers) = told(&mut room.world, room.ids[0]);
    assert!(headers.iter().all(|header: &ServerHeader| header.tick == room.now()));
    let ids: std::collections::BTreeSet<u32> = records
        .iter()
        .filter_map(|record| if let ServerRecord::State { object, .. } = record { Some(object.0) } else { None })
        .collect();
    assert_eq!(ids.len(), records.len(), "no object twice");
}

#[test]
fn a_byte_cap_never_holds_back_a_violation() {
    let (mut room, _) = crowd(Some(1_000), 10);
    for index in 1..=40 {
        room.put(index, 5.0, -(3.0 + index as f64));
    }
    let told = room.step(true);
    let violations = told.iter().filter(|(_, record)| matches!(record, ServerRecord::Violation { .. })).count();
    assert_eq!(violations, 40);
}

#[test]
fn nobody_turns_faster_than_it_may() {
    let avatar = crate::spec::AvatarSpec { turn_max: 2.0, ..Default::default() };
    let mut room = Room::new(WorldConfig::default(), WorldSpec { avatar, ..WorldSpec::default() }, 1);
    assert_eq!(room.world.classes()[0].turn_max, Some(2.0));
    let mut yaws = Vec::new();
    for _ in 0..40 {
        room.pose(0, 0.0, 0.0, 3.0);
        room.step(false);
        yaws.push(room.world.objects()[0].orientation.yaw());
    }
    // 2 rad/s, and the slack of 60 ms of it at first.
    for (tick, yaw) in yaws.iter().enumerate() {
        assert!(*yaw <= 0.1 * (tick + 1) as f64 + 0.121 + 0.012, "{yaw} after {tick} ticks");
    }
    assert!((yaws[39] - 3.0).abs() < 0.01, "it gets there: {yaws:?}");
    assert!(yaws[20] > 2.0);
    assert!((20..35).contains(&room.world.stats().turns_clamped), "{:?}", room.world.stats());
    // The short way, across π.
    room.pose(0, 0.0, 0.0, -3.1);
    room.step(false);
    let yaw = room.world.objects()[0].orientation.yaw();
    assert!(yaw.abs() > 3.0, "{yaw}");
}

#[test]
fn a_turn_without_a_bound_is_taken_as_it_is_and_nonsense_is_refused() {
    let of = |turn_max| {
        let avatar = crate::spec::AvatarSpec { turn_max, ..Default::default() };
        let spec = WorldSpec { avatar, ..WorldSpec::default() };
        let info = WorldInfo { name: "test".into(), hash: [0; 32], size_bytes: 0, two_sided: false };
        World::new(WorldConfig::default(), spec, info, DVec3::ZERO, Box::new(Broadcast), WorldTime::ZERO)
    };
    assert_eq!(of(f64::INFINITY).map(|world| world.classes()[0].turn_max).ok(), Some(None));
    for bad in [-1.0, f64::NAN, f64::NEG_INFINITY, 1e7] {
        assert!(matches!(of(bad), Err(WorldError::ClassValue { what: "turn_max", .. })), "{bad}");
    }
    for bad in [-1.0, f64::NAN, f64::INFINITY] {
        let info = WorldInfo { name: "test".into(), hash: [0; 32], size_bytes: 0, two_sided: false };
        let config = WorldConfig::default().with_dead_reckoning_px(Some(bad));
        let world = World::new(config, WorldSpec::default(), info, DVec3::ZERO, Box::new(Broadcast), WorldTime::ZERO);
        assert!(matches!(world.err(), Some(WorldError::DeadReckoning { .. })), "{bad}");
    }
}

#[test]
fn a_request_is_answered_on_arrival_or_with_the_tick_and_by_one_datagram_either_way() {
    for (answers, on_arrival, with_the_tick) in [(Answers::Arrival, 1, 0), (Answers::Tick, 0, 1)] {
        let mut world = world_of(WorldConfig::default().with_answers(answers), Box::new(Visible));
        let _other = join(&mut world, Role::Avatar);
        let asker = join(&mut world, Role::Avatar);
        world.tick(WorldTime::from_micros(50_000));
        drain(&mut world, asker);
        let sent = |world: &mut World| {
            let sent = drain(world, asker);
            sent.iter().filter(|transmit| matches!(transmit, Transmit::Datagram(_))).count()
        };
        let request = ClientRecord::Request { object: ObjectId(0), want: Want::Place, reason: Reason::Exposed };
        world.handle_datagram(asker, &datagram(1, &[request]), WorldTime::from_micros(60_000));
        assert_eq!(sent(&mut world), on_arrival, "{answers}");
        world.tick(WorldTime::from_micros(100_000));
        assert_eq!(sent(&mut world), with_the_tick, "{answers}");
        assert_eq!(world.stats().out.places, 1, "{answers}");
        assert_eq!(world.answer_wait() > Duration::ZERO, answers == Answers::Tick);
    }
}
