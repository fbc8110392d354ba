//! What the network may do to datagrams, one literal misfortune each.

use std::cell::Cell;
use std::rc::Rc;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use eyeline_client::session::SessionConfig;
use eyeline_protocol::Want;
use eyeline_protocol::{ClientRecord, ObjectId, ServerRecord, codec};
use eyeline_sim::soak::{IndexView, Standing, Walls};
use eyeline_sim::virtual_net::ClientPlan;
use eyeline_sim::virtual_net::{Direction, Fate, LinkRules, Passing, Verdict};
use eyeline_tests::{HIDDEN, OPEN, Pair};
use glam::DVec3;

const fn ms(millis: u64) -> Duration {
    Duration::from_millis(millis)
}

/// Where the client sees [`HIDDEN`] from.
const AROUND_THE_CORNER: DVec3 = DVec3::new(12.0, 0.0, -10.0);

fn client_says(message: &Passing<'_>, test: impl Fn(&ClientRecord) -> bool) -> bool {
    message.direction == Direction::Up
        && codec::decode_client_datagram(message.bytes).is_ok_and(|(_, records)| records.iter().any(test))
}

fn server_says(message: &Passing<'_>, test: impl Fn(&ServerRecord) -> bool) -> bool {
    message.direction == Direction::Down
        && codec::decode_server_datagram(message.bytes).is_ok_and(|(_, records)| records.iter().any(test))
}

fn is_request(record: &ClientRecord, object: ObjectId) -> bool {
    matches!(record, ClientRecord::Request { object: o, .. } if *o == object)
}

fn is_state(record: &ServerRecord, object: ObjectId) -> bool {
    matches!(record, ServerRecord::State { object: o, .. } if *o == object)
}

/// Drops the first `count` datagrams of client 1 that `is_it` picks; returns how many it has dropped.
fn drop_first(pair: &mut Pair, count: u32, is_it: impl Fn(&Passing<'_>) -> bool + 'static) -> Rc<Cell<u32>> {
    let dropped = Rc::new(Cell::new(0));
    let counter = dropped.clone();
    pair.run.intercept(move |message| {
        if message.client == 1 && counter.get() < count && is_it(message) {
            counter.set(counter.get() + 1);
            return Verdict::Instead(Fate::Drop);
        }
        Verdict::AsRuled
    });
    dropped
}

#[test]
fn lost_requests_are_repeated_until_answered() {
    let mut pair = Pair::builder().latency(ms(30)).build();
    let object = pair.spawn_hidden();
    let dropped = drop_first(&mut pair, 5, move |message| client_says(message, |record| is_request(record, object)));
    pair.stand_at(AROUND_THE_CORNER);
    pair.run_for(ms(1_500));
    assert_eq!(dropped.get(), 5);
    assert_eq!(pair.drawn(object), Some(HIDDEN));
    assert!(pair.stats().resent >= 5);
    pair.truth.assert_kept("lost requests");
}

#[test]
fn lost_answers_are_repeated_until_they_arrive() {
    let mut pair = Pair::builder().latency(ms(30)).build();
    let object = pair.spawn_hidden();
    let dropped = drop_first(&mut pair, 5, move |message| server_says(message, |record| is_state(record, object)));
    pair.stand_at(AROUND_THE_CORNER);
    pair.run_for(ms(1_500));
    assert_eq!(dropped.get(), 5);
    assert_eq!(pair.drawn(object), Some(HIDDEN));
    pair.truth.assert_kept("lost answers");
}

#[test]
fn a_lost_push_is_sent_again_though_nothing_changes_any_more() {
    let mut pair = Pair::builder().latency(ms(30)).build();
    let object = pair.spawn(OPEN);
    pair.run_for(ms(500));
    let dropped = drop_first(&mut pair, 1, move |message| {
        server_says(
            message,
            |record| matches!(record, ServerRecord::State { position, .. } if position.metres().x > 0.09),
        )
    });
    pair.walk(object, OPEN + DVec3::X * 0.1, 2.0);
    pair.run_for(ms(1_000));
    assert_eq!(dropped.get(), 1);
    assert_eq!(pair.drawn(object), Some(pair.truly(object)));
    assert_eq!(pair.truly(object).x, (0.1f64 * 1024.0).round() / 1024.0);
    pair.truth.assert_kept("a lost push");
}

#[test]
fn a_duplicate_or_reordered_datagram_changes_nothing() {
    // Each datagram twice, the second copy after the next few have passed; the same scenario without is the yardstick.
    let run = |twice: bool| {
        let mut pair = Pair::builder().latency(ms(30)).build();
        let object = pair.spawn_hidden();
        if twice {
            pair.run.intercept(|message| match message.client {
                1 => Verdict::Twice(ms(30), ms(190)),
                _ => Verdict::AsRuled,
            });
        }
        pair.stand_at(AROUND_THE_CORNER);
        pair.walk(object, HIDDEN + DVec3::X, 1.0);
        pair.run_for(ms(800));
        pair.stand_at(DVec3::ZERO);
        pair.run_for(ms(1_500));
        pair.truth.assert_kept("duplicates");
        let stats = pair.stats();
        (stats.revealed, stats.released, stats.exposed, pair.drawn(object), pair.run.world().stats().messages_in)
    };
    assert_eq!(run(true), run(false));
}

#[test]
fn a_release_that_is_overtaken_by_a_newer_request_does_not_unsubscribe() {
    let mut pair = Pair::builder().latency(ms(30)).build();
    let object = pair.spawn(HIDDEN);
    pair.stand_at(AROUND_THE_CORNER);
    pair.run_for(ms(500));
    assert!(pair.drawn(object).is_some());
    // The release travels for 400 ms; a request follows it and is faster.
    pair.run.intercept(move |message| {
        let is_release =
            |record: &ClientRecord| matches!(record, ClientRecord::Release { object: o, .. } if *o == object);
        if message.client == 1 && client_says(message, is_release) {
            return Verdict::Instead(Fate::Deliver(ms(400)));
        }
        Verdict::AsRuled
    });
    pair.stand_at(DVec3::ZERO);
    pair.run_for(ms(150));
    pair.stand_at(AROUND_THE_CORNER);
    pair.run_for(ms(600));
    assert_eq!(pair.log.releases(object), 1, "it arrived, late");
    pair.walk(object, HIDDEN + DVec3::X, 1.0);
    pair.run_for(ms(1_500));
    assert_eq!(pair.drawn(object), Some(pair.truly(object)));
    assert!(pair.truly(object).x > 0.9);
}

#[test]
fn a_state_from_before_a_release_is_no_answer_to_a_later_request() {
    let mut pair = Pair::builder().latency(ms(100)).build();
    let object = pair.spawn(HIDDEN);
    pair.stand_at(AROUND_THE_CORNER);
    pair.run_for(ms(800));
    pair.walk(object, HIDDEN + DVec3::X * 2.0, 1.0);
    pair.run_for(ms(400));
    // Out of sight and back at once: the server gets the release; of the request that follows it loses the first.
    pair.stand_at(DVec3::ZERO);
    pair.run_for(ms(150));
    let dropped = drop_first(&mut pair, 1, move |message| client_says(message, |record| is_request(record, object)));
    pair.stand_at(AROUND_THE_CORNER);
    pair.run_for(ms(3_000));
    assert_eq!(dropped.get(), 1);
    assert_eq!(pair.drawn(object), Some(pair.truly(object)));
    pair.truth.assert_kept("an old state");
}

#[test]
fn late_states_of_a_released_object_repeat_the_release() {
    let mut pair = Pair::builder().latency(ms(30)).build();
    let object = pair.spawn(HIDDEN);
    pair.stand_at(AROUND_THE_CORNER);
    pair.run_for(ms(500));
    pair.walk(object, HIDDEN + DVec3::X, 0.3);
    pair.run_for(ms(200));
    let dropped = drop_first(&mut pair, 2, move |message| {
        client_says(message, |record| matches!(record, ClientRecord::Release { object: o, .. } if *o == object))
    });
    pair.stand_at(DVec3::ZERO);
    pair.run_for(ms(1_200));
    assert_eq!(dropped.get(), 2);
    assert_eq!(pair.log.releases(object), 1);
    assert!(pair.stats().unwanted >= 1);
    let states = pair.log.states(object);
    pair.run_for(ms(500));
    assert_eq!(pair.log.states(object), states, "the server has stopped telling");
    pair.truth.assert_kept("a lost release");
}

#[test]
fn a_teleport_is_heard_of_even_if_its_record_is_lost_five_times() {
    let mut pair = Pair::builder().latency(ms(30)).build();
    let object = pair.spawn_hidden();
    let dropped = drop_first(&mut pair, 5, move |message| {
        server_says(message, |record| matches!(record, ServerRecord::Violation { object: o, .. } if *o == object))
    });
    pair.place(object, OPEN, true);
    pair.run_for(ms(1_500));
    assert_eq!(dropped.get(), 5);
    assert_eq!(pair.drawn(object), Some(OPEN));
    pair.truth.assert_kept("a teleport that is hard to hear of");
}

#[test]
fn a_state_that_overtakes_the_return_of_its_object_is_not_forgotten() {
    // Under `broadcast` nobody asks: what is dropped once is never told again while the object stands still.
    let mut pair = Pair::builder().broadcast().latency(ms(30)).build();
    let object = pair.spawn(OPEN);
    pair.run_for(ms(400));
    pair.place(object, OPEN, false);
    pair.run_for(ms(400));
    let dropped = drop_first(&mut pair, 1, move |message| {
        server_says(message, |record| matches!(record, ServerRecord::Violation { object: o, .. } if *o == object))
    });
    pair.place(object, OPEN + DVec3::X, true);
    pair.run_for(ms(1_500));
    assert_eq!(dropped.get(), 1);
    assert_eq!(pair.drawn(object), Some(OPEN + DVec3::X));
}

#[test]
fn broadcast_over_a_bad_link_tells_everything_in_the_end() {
    for seed in 0..30 {
        let link = LinkRules { delay: ms(40), jitter: ms(30), loss: 0.2, duplicate: 0.05, reorder: 0.1 };
        let mut pair = Pair::builder().broadcast().seed(seed).link(link).build();
        let objects = [pair.spawn(OPEN), pair.spawn(HIDDEN), pair.spawn(OPEN + DVec3::X)];
        pair.run_for(ms(1_500));
        pair.place(objects[0], OPEN, false);
        pair.run_for(ms(300));
        pair.place(objects[0], OPEN + DVec3::Z, true);
        pair.run_for(ms(3_000));
        let tracker = pair.session().tracker().unwrap();
        for object in objects {
            let known =
                tracker.known().find(|(known, _)| known.object == object).map(|(known, _)| known.position.metres());
            assert_eq!(known, Some(pair.truly(object)), "seed {seed}, {object}");
        }
    }
}

#[test]
fn a_state_that_overtakes_the_roster_is_not_forgotten() {
    // A newcomer that never moves; the control stream that names it is held up, the datagrams that tell of it are not.
    let mut pair = Pair::builder().broadcast().latency(ms(30)).build();
    pair.run.client_mut(1).down.set_rules(LinkRules::default().with_delay(ms(1_000)));
    pair.run.intercept(|message| match message.client {
        1 => Verdict::Instead(Fate::Deliver(ms(30))),
        _ => Verdict::AsRuled,
    });
    let place = Arc::new(Mutex::new(DVec3::ZERO));
    let newcomer = Standing::new(Arc::new(Walls::default()), place);
    let plan = ClientPlan::new(SessionConfig::default(), LinkRules::default());
    let number = pair.run.join(plan, Box::new(newcomer), IndexView::default().maker());
    pair.run_for(ms(20));
    let object = pair.run.clients()[number].avatar().unwrap();
    // It turns to where it looks, no faster than it may.
    pair.run_for(ms(600));
    let knows = |pair: &Pair| pair.session().tracker().unwrap().knows(object);
    let told = pair.log.states(object);
    assert!(!knows(&pair) && told > 0, "the state has come, the roster has not");
    pair.run_for(ms(3_000));
    assert_eq!(pair.log.states(object), told, "nobody tells it again");
    assert_eq!(pair.drawn(object), Some(DVec3::ZERO));
}

#[test]
fn what_is_in_sight_again_before_its_bound_has_come_stays_drawn() {
    let mut pair = Pair::builder().latency(ms(150)).build();
    let object = pair.spawn(HIDDEN);
    pair.stand_at(AROUND_THE_CORNER);
    // It stands so long that a bound of its last state would be wide: the server is asked for one.
    pair.run_for(ms(2_000));
    pair.stand_at(DVec3::ZERO);
    pair.run_for(ms(100));
    pair.stand_at(AROUND_THE_CORNER);
    for _ in 0..20 {
        pair.run_for(ms(50));
        assert_eq!(pair.drawn(object), Some(HIDDEN));
    }
    assert_eq!(pair.log.releases(object), 1);
    pair.truth.assert_kept("out of sight for two frames");
}

#[test]
fn two_round_trips_are_not_tried_in_a_frame_soon_after_a_slow_one() {
    for (slow, wanted) in [(false, Want::Bound), (true, Want::Place)] {
        let mut pair = Pair::builder().latency(ms(2)).build();
        let object = pair.spawn_hidden();
        let once = Rc::new(Cell::new(slow));
        pair.run.intercept(move |message| {
            if message.client == 1 && message.direction == Direction::Down && once.replace(false) {
                return Verdict::Instead(Fate::Deliver(ms(40)));
            }
            Verdict::AsRuled
        });
        pair.run_for(ms(1_000));
        pair.stand_at(AROUND_THE_CORNER);
        pair.run_for(ms(200));
        let first = pair.log.up.iter().find_map(|(_, record)| match record {
            ClientRecord::Request { object: o, want, .. } if *o == object => Some(*want),
            _ => None,
        });
        assert_eq!(first, Some(wanted));
        assert_eq!(pair.drawn(object), Some(HIDDEN));
    }
}

#[test]
fn what_stands_in_sight_is_not_told_again_and_again() {
    // An acknowledgement waits for the client's next frame; that alone is no loss.
    for latency in [1, 10, 24, 30, 55, 90, 140] {
        let mut pair = Pair::builder().latency(ms(latency)).build();
        let object = pair.spawn(OPEN);
        pair.run_for(ms(1_500));
        let told = pair.log.states(object);
        pair.run_for(ms(3_000));
        assert_eq!(pair.drawn(object), Some(OPEN));
        assert_eq!(pair.log.states(object), told, "latency {latency} ms");
        assert!(told <= 6, "latency {latency} ms: {told}");
    }
}
