//! What the protocol promises, one claim each, over one link.

use std::time::Duration;

use eyeline_client::session::Event;
use eyeline_client::tracking::{Growth, Sabotage, TrackerConfig};
use eyeline_protocol::{ClientControl, ClientRecord, Interest, Refusal, Role, ServerRecord, Want, codec};
use eyeline_sim::soak::{Town, TownRules};
use eyeline_sim::virtual_net::{Ignore, Kind, LinkRules};
use eyeline_tests::{HIDDEN, OPEN, Pair};
use glam::DVec3;

const fn ms(millis: u64) -> Duration {
    Duration::from_millis(millis)
}

#[test]
fn hidden_object_is_silent_until_its_bound_is_exposed() {
    let mut pair = Pair::builder().seed(7).latency(ms(50)).build();
    let object = pair.spawn_hidden();
    assert_eq!(pair.drawn(object), None);

    // Its bound grows by 2 m/s from when it was seen last, 0.8 s ago; at 4.6 m it reaches out of the wall's shadow.
    pair.run_for(ms(1_200));
    assert_eq!((pair.log.requests(object), pair.log.states(object)), (0, 0));
    assert!(pair.stats().stages > 0, "the client lengthens stages without a message");

    pair.run_for(ms(2_500));
    assert!(pair.log.requests(object) >= 1, "an exposed bound is asked about");
    assert!(pair.log.requests(object) <= 2);
    assert_eq!(pair.drawn(object), None, "it never came out");
    pair.truth.assert_kept("a hidden object");
}

#[test]
fn a_request_is_answered_on_arrival() {
    let mut pair = Pair::builder().latency(ms(40)).build();
    let object = pair.spawn_hidden();
    pair.stand_at(DVec3::new(12.0, 0.0, -10.0));
    pair.run_for(ms(300));
    let asked = pair.log.up.iter().find_map(|(at, record)| {
        matches!(record, ClientRecord::Request { object: o, want, .. } if *o == object && *want != Want::Bound)
            .then_some(*at)
    });
    let answered = pair.log.down.iter().find_map(|(at, record)| {
        matches!(record, ServerRecord::State { object: o, .. } if *o == object).then_some(*at)
    });
    assert_eq!(asked.map(|at| at + ms(40)), answered);
    assert!(answered.is_some());
}

#[test]
fn an_exposed_object_is_drawn_by_the_next_frame_when_the_network_is_fast() {
    let mut pair = Pair::builder().latency(ms(2)).build();
    let object = pair.spawn_hidden();
    pair.stand_at(DVec3::new(12.0, 0.0, -10.0));
    // Frames are at 30, 80, … ms: one in which it is exposed, one in which it is drawn.
    pair.run_for(ms(101));
    assert_eq!(pair.drawn(object), Some(HIDDEN));
    pair.truth.assert_kept("a fast network");
    assert!(pair.truth.not_drawn <= 2, "{}", pair.truth.not_drawn);
}

#[test]
fn a_client_never_hears_a_state_of_an_object_it_did_not_ask_for() {
    let mut town = Town::new(TownRules { teleports: 0.0, away: 0.0, ..TownRules::seeded(4) });
    town.run_for(ms(3_000));
    let stats = town.run.world().stats();
    assert_eq!(stats.forbidden, 0);
    assert!(stats.messages_in.requests_for_state > 0);
    let mut pair = Pair::builder().latency(ms(20)).build();
    let object = pair.spawn_hidden();
    pair.walk(object, HIDDEN + DVec3::X, 1.0);
    pair.run_for(ms(1_000));
    assert_eq!((pair.log.requests(object), pair.log.states(object)), (0, 0));
}

#[test]
fn broadcast_tells_everything() {
    let mut pair = Pair::builder().broadcast().latency(ms(20)).build();
    let objects = [pair.spawn(HIDDEN), pair.spawn(OPEN)];
    pair.run_for(ms(500));
    for object in objects {
        assert!(pair.log.states(object) >= 1);
        let tracker = pair.session().tracker().unwrap();
        assert!(tracker.known().any(|(known, _)| known.object == object));
    }
    assert!(pair.log.up.iter().all(|(_, record)| !matches!(record, ClientRecord::Request { .. })));
    let others: usize = pair.session().tracker().unwrap().known().count();
    assert_eq!(others, objects.len());
}

#[test]
fn a_teleport_is_announced_to_holders_acknowledged_and_voids_old_bounds() {
    let mut pair = Pair::builder().latency(ms(30)).build();
    let object = pair.spawn_hidden();
    let old = pair.session().tracker().unwrap().held(object).expect("a bound is held");
    pair.place(object, OPEN, true);
    pair.run_for(ms(400));
    assert!(pair.log.violations(object) >= 1);
    assert!(pair.log.up.iter().any(|(_, r)| matches!(r, ClientRecord::ViolationAck { object: o, .. } if *o == object)));
    assert!(!old.contains(OPEN, pair.run.now()));
    assert_eq!(pair.drawn(object), Some(OPEN));
    let announced = pair.log.violations(object);
    pair.run_for(ms(1_000));
    assert_eq!(pair.log.violations(object), announced, "once acknowledged it is not said again");
    pair.truth.assert_kept("a teleport");
    assert!(pair.truth.broken_believed > 0, "the announcement takes a while, which is counted");
}

#[test]
fn a_teleport_is_not_announced_to_those_who_hold_nothing() {
    let mut pair = Pair::builder().broadcast().latency(ms(30)).build();
    let mut tracking = Pair::builder().latency(ms(30)).build();
    for pair in [&mut pair, &mut tracking] {
        let object = pair.spawn_hidden();
        pair.place(object, HIDDEN, false);
        pair.run_for(ms(400));
        pair.log.down.clear();
        // Outside the world it may go where it likes: nobody holds anything of it.
        pair.place(object, HIDDEN + DVec3::X, false);
        pair.run_for(ms(400));
        assert_eq!(pair.log.violations(object), 0);
    }
}

#[test]
fn an_object_that_leaves_and_enters_again_is_found_again() {
    for broadcast in [false, true] {
        let builder = Pair::builder().latency(ms(30));
        let mut pair = if broadcast { builder.broadcast() } else { builder }.build();
        let object = pair.spawn(OPEN);
        pair.run_for(ms(400));
        assert_eq!(pair.drawn(object), Some(OPEN));
        pair.place(object, OPEN, false);
        pair.run_for(ms(400));
        assert_eq!(pair.drawn(object), None);
        pair.place(object, OPEN + DVec3::X, true);
        pair.run_for(ms(400));
        assert_eq!(pair.drawn(object), Some(OPEN + DVec3::X), "broadcast: {broadcast}");
        if !broadcast {
            pair.truth.assert_kept("leaving and entering");
        }
    }
}

#[test]
fn a_pose_beyond_the_motion_bound_is_clamped_and_never_breaks_containment() {
    let mut pair = Pair::builder().latency(ms(30)).build();
    let object = pair.spawn_hidden();
    pair.walk(object, HIDDEN + DVec3::X * 9.0, 50.0);
    pair.run_for(ms(1_000));
    let gone = pair.truly(object).distance(HIDDEN);
    assert!(pair.run.world().stats().poses_clamped > 0);
    assert!(gone > 1.5 && gone <= 2.0 + 0.3, "2 m/s for a second, and the slack, not {gone} m");
    pair.run_for(ms(3_000));
    pair.truth.assert_kept("a speeder");
    assert_eq!(pair.stats().broken_bounds, 0);
}

#[test]
fn another_version_is_refused_with_the_reason_and_the_others_notice_nothing() {
    let mut pair = Pair::builder().build();
    let object = pair.spawn(OPEN);
    let hello = ClientControl::Hello {
        version: eyeline_protocol::VERSION + 1,
        token: Vec::new(),
        resolution: (320, 240),
        interest: Interest::Around,
        role: Role::Avatar,
        name: String::new(),
        resume: None,
    };
    let id = pair.run.with_world(&mut Ignore, |world, now| {
        let id = world.connect(now);
        world.handle_control(id, &codec::encode_control(&hello)[4..], now);
        world.handle_control(id, &[0xff; 9], now);
        id
    });
    assert_eq!(pair.run.world().stats().refused, 1);
    pair.run_for(ms(400));
    pair.run.with_world(&mut Ignore, |world, _| world.disconnect(id));
    assert_eq!(pair.drawn(object), Some(OPEN));
    pair.truth.assert_kept("a stranger");
}

#[test]
fn garbage_on_the_control_stream_closes_that_connection_only() {
    let mut town = Town::new(TownRules { teleports: 0.0, away: 0.0, ..TownRules::seeded(3) });
    town.run_for(ms(1_000));
    town.run.send_raw(2, Kind::Control, vec![0xee; 40], &mut Ignore);
    town.run_for(ms(1_500));
    assert_eq!(town.run.world().stats().rejected_control, 1);
    assert!(!town.run.clients()[2].is_connected());
    let refusal = |event: &Event| matches!(event, Event::Refused { refusal: Refusal::Protocol, .. });
    assert!(town.run.clients()[2].events().iter().any(refusal));
    let connected = town.run.clients().iter().filter(|client| client.is_connected()).count();
    assert_eq!(connected, town.run.clients().len() - 1);
    town.truth.assert_kept("the others");
}

#[test]
fn a_garbage_datagram_is_counted_and_changes_nothing() {
    let mut town = Town::new(TownRules { teleports: 0.0, away: 0.0, ..TownRules::seeded(3) });
    town.run_for(ms(1_000));
    for length in 0..60usize {
        town.run.send_raw(2, Kind::Datagram, vec![0xf7; length * 20], &mut Ignore);
    }
    town.run_for(ms(1_500));
    let stats = town.run.world().stats();
    assert!(stats.rejected_datagrams >= 50, "{}", stats.rejected_datagrams);
    assert!(town.run.clients().iter().all(|client| client.is_connected()));
    town.truth.assert_kept("everybody");
}

#[test]
fn ids_are_used_again_after_leaving_and_nobody_is_taken_for_another() {
    let mut town = Town::new(TownRules { teleports: 0.0, ..TownRules::seeded(5) });
    town.run_for(ms(800));
    let gone = town.run.clients()[1].avatar().unwrap();
    town.leave(1);
    town.run_for(ms(400));
    let came = town.join();
    town.run_for(ms(1_500));
    assert_eq!(town.run.clients()[came].avatar(), Some(gone));
    town.truth.assert_kept("an id used twice");
}

#[test]
fn missed_ticks_keep_containment() {
    for seed in 0..12 {
        let rules = TownRules { lateness: ms(400), ..TownRules::seeded(seed) };
        let mut town = Town::new(rules);
        town.run_for(ms(4_000));
        assert!(town.run.world().stats().ticks_missed > 5);
        let broken: Vec<&String> = town.truth.failures.texts.iter().filter(|text| is_containment(text)).collect();
        assert!(broken.is_empty(), "seed {seed}: {broken:?}");
    }
}

#[test]
fn clock_drift_keeps_containment() {
    for drift in [-5e-4, 5e-4] {
        let mut pair = Pair::builder().drift(drift).latency(ms(1)).build();
        let object = pair.spawn_hidden();
        pair.walk(object, HIDDEN + DVec3::X * 4.0, 2.0);
        pair.run_for(Duration::from_secs(120));
        pair.truth.assert_kept("a clock that drifts");
        assert!(pair.truth.bounds_checked > 1_000);
    }
}

#[test]
fn a_frozen_clock_breaks_containment_so_the_checker_can_fail() {
    let mut town = Town::new(TownRules {
        sabotage: Some(Sabotage::FreezeClock),
        teleports: 0.0,
        away: 0.0,
        ..TownRules::seeded(0)
    });
    town.run_for(ms(4_000));
    assert!(town.truth.failures.texts.iter().any(|text| is_containment(text)), "{:?}", town.truth.failures.texts);
}

#[test]
fn dropped_exposures_make_objects_late_so_the_checker_can_fail() {
    let mut pair = Pair::builder()
        .latency(ms(10))
        .tracker(TrackerConfig::default().with_sabotage(Some(Sabotage::DropExposures)))
        .build();
    pair.spawn_hidden();
    pair.stand_at(DVec3::new(12.0, 0.0, -10.0));
    pair.run_for(ms(1_000));
    assert!(pair.truth.failures.texts.iter().any(|text| text.contains("not drawn")));
}

fn is_containment(text: &str) -> bool {
    text.contains("from its bound's centre") || text.contains("that T holds") || text.contains("µs early")
}

#[test]
fn what_follows_a_path_in_sight_is_drawn_without_asking_for_ever() {
    // The bound of a path does not grow: to ask for a fresh one gets the same again. Found by seed 3 over a fast link.
    let rules = TownRules { link: LinkRules::default().with_delay(ms(2)), ..TownRules::seeded(3) };
    let mut town = Town::new(TownRules { crowd: 0, teleports: 0.0, away: 0.0, growth: Growth::AtClient, ..rules });
    town.run_for(ms(5_000));
    town.truth.assert_kept("carts");
    let (clients, carts, frames) = (town.rules().clients as u64, town.rules().carts as u64, 104);
    let requests = town.run.world().stats().messages_in.requests();
    assert!(requests < clients * carts * frames / 2, "{requests} requests");
}
