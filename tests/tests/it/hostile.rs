//! One who lies, or whose clock does: nobody else notices, and counters say what happened.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::rc::Rc;
use std::time::Duration;

use eyeline_protocol::codec::DatagramWriter;
use eyeline_protocol::{
    ClientControl, ClientHeader, ClientRecord, Issue, LinkHeader, ObjectId, Orientation, Position, Reason, Want,
    WorldTime, codec,
};
use eyeline_server::world::{Limited, World};
use eyeline_sim::soak::Truth;
use eyeline_sim::virtual_net::{Direction, Framed, Kind, LinkRules, Observer, Passing, Verdict};
use glam::DVec3;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use crate::village::{PEOPLE, Rules, Village};

const fn ms(millis: u64) -> Duration {
    Duration::from_millis(millis)
}

/// Who misbehaves.
const VILLAIN: usize = 1;

/// Without chance, so that nothing of the villain's can change what links do to others.
fn link() -> LinkRules {
    LinkRules::default().with_delay(ms(30))
}

/// One thing that arrived: when, whither and what.
type Heard = (WorldTime, Direction, Vec<u8>);

/// What everybody but the villain says and hears, as it arrives.
#[derive(Default, PartialEq)]
struct Others {
    heard: BTreeMap<usize, Vec<Heard>>,
}

impl Observer for Others {
    fn arrives(&mut self, message: &Passing<'_>) {
        if message.client != VILLAIN {
            let heard = (message.at, message.direction, message.bytes.to_vec());
            self.heard.entry(message.client).or_default().push(heard);
        }
    }
}

impl Others {
    #[track_caller]
    fn assert_same(&self, quiet: &Others, what: &str) {
        assert!(self.heard.len() == 4 && self.heard.values().all(|heard| heard.len() > 100), "{what}: nothing is told");
        for (client, heard) in &self.heard {
            let quiet = &quiet.heard[client];
            let first = heard.iter().zip(quiet).position(|(one, other)| one != other);
            assert!(first.is_none() && heard.len() == quiet.len(), "{what}: client {client} notices, at {first:?}");
        }
    }
}

/// The same village without a villain, and what was heard in it.
fn quiet(span: Duration) -> (Village, Others) {
    let mut village = Village::new(&Rules::new(1, link()));
    let mut others = Others::default();
    village.run_for(span, &mut others);
    (village, others)
}

/// Everything that left, oldest first.
type Taps = Rc<RefCell<Vec<(WorldTime, usize, Direction, Vec<u8>)>>>;

fn tap(village: &mut Village) -> Taps {
    let taps = Taps::default();
    let noted = taps.clone();
    village.run.intercept(move |packet| {
        noted.borrow_mut().push((packet.at, packet.client, packet.direction, packet.bytes.to_vec()));
        Verdict::AsRuled
    });
    taps
}

/// Damages bytes in one of the ways that somebody on the path can without keys.
fn damaged(chance: &mut Pcg64, bytes: &[u8]) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    match chance.random_range(0..3) {
        0 => {}
        1 => bytes.truncate(chance.random_range(0..bytes.len())),
        _ => {
            let length = chance.random_range(0..1_200);
            bytes = (0..length).map(|_| chance.random()).collect();
            // No number begins so: a header that somebody guesses is another test.
            bytes.iter_mut().take(1).for_each(|byte| *byte = 0xff);
        }
    }
    bytes
}

#[test]
fn replayed_truncated_and_made_up_datagrams_change_nothing_and_are_counted() {
    let span = ms(4_000);
    let (calm, undisturbed) = quiet(span);
    let mut village = Village::new(&Rules::new(1, link()));
    let taps = tap(&mut village);
    let mut chance = Pcg64::seed_from_u64(11);
    let mut others = Others::default();
    village.run_for(ms(1_000), &mut others);
    let (mut up, mut down) = (0, 0);
    for _ in 0..300 {
        village.run_for(ms(10), &mut others);
        // Of what has arrived, so that a copy is a copy.
        let old: Vec<_> = taps
            .borrow()
            .iter()
            .filter(|(at, client, ..)| *client == VILLAIN && village.run.now().since(*at) > ms(100))
            .cloned()
            .collect();
        let (_, client, direction, bytes) = &old[chance.random_range(0..old.len())];
        village.run.inject(*client, *direction, damaged(&mut chance, bytes));
        *if *direction == Direction::Up { &mut up } else { &mut down } += 1;
    }
    // The last one's turn.
    village.settle(Duration::ZERO);
    others.assert_same(&undisturbed, "datagrams from elsewhere");
    let (stats, before) = (village.run.world().stats(), calm.run.world().stats());
    let rejected = stats.rejected_datagrams - before.rejected_datagrams;
    let stale = stats.stale_datagrams - before.stale_datagrams;
    assert!(rejected > 20 && stale > 20 && rejected + stale == up, "{rejected} + {stale} of {up}");
    // What is asked may be asked again a little earlier; nothing else is said.
    assert_eq!((stats.messages_in.poses, stats.forbidden), (before.messages_in.poses, before.forbidden));
    let session = village.run.clients()[VILLAIN].session.stats();
    assert!(session.rejected > 20 && session.stale > 20, "{session:?}");
    assert_eq!(session.rejected + session.stale, down);
    assert!(village.run.clients()[VILLAIN].is_connected());
}

#[test]
fn over_quic_packets_from_elsewhere_change_nothing_at_all() {
    let live = |is_attacked: bool| {
        // What endpoints answer to strangers must not use up the chance of links.
        let mut village = Village::new(&Rules::over_quic(1, link()));
        let taps = tap(&mut village);
        let mut chance = Pcg64::seed_from_u64(12);
        village.settle(ms(1_000));
        let mut injected = 0;
        for _ in 0..200 {
            village.settle(ms(10));
            if is_attacked {
                // Anybody's, to anybody, handshakes too; damaged in one bit besides.
                let taps = taps.borrow();
                let (_, client, direction, bytes) = &taps[chance.random_range(0..taps.len())];
                let mut bytes = damaged(&mut chance, bytes);
                if !bytes.is_empty() && chance.random_bool(0.5) {
                    let index = chance.random_range(0..bytes.len());
                    bytes[index] ^= 1 << chance.random_range(0..8);
                }
                let other = if chance.random_bool(0.3) { chance.random_range(PEOPLE) } else { *client };
                village.run.inject(other, *direction, bytes);
                injected += 1;
            }
        }
        assert!(village.run.clients().iter().all(|client| client.is_connected()));
        (village.run.digest(), village.run.messages(), injected)
    };
    let (quiet, attacked) = (live(false), live(true));
    assert!(quiet.1 > 500 && attacked.2 == 200);
    assert_eq!((quiet.0, quiet.1), (attacked.0, attacked.1));
}

#[test]
fn unknown_and_forbidden_ids_and_lying_headers_reach_nobody() {
    let mut village = Village::new(&Rules::new(1, link()));
    let mut truth = village.truth(PEOPLE.filter(|&person| person != VILLAIN), Duration::ZERO);
    village.run_for(ms(1_500), &mut truth);
    let before = *village.run.world().stats();
    let own = village.run.clients()[VILLAIN].avatar().unwrap();
    let theirs = village.run.clients()[2].avatar().unwrap();
    let far = Position::from_metres(DVec3::new(900.0, 0.0, 900.0)).unwrap();
    let records = |object| {
        let orientation = Orientation::default();
        [
            ClientRecord::Pose { object, position: far, orientation },
            ClientRecord::Request { object, want: Want::State, reason: Reason::Exposed },
            ClientRecord::Request { object, want: Want::Bound, reason: Reason::Unknown },
            ClientRecord::Release { object, want_bound: true },
            ClientRecord::ViolationAck { object, issue: Issue(u32::MAX) },
        ]
    };
    let mut said = 0;
    for round in 0..40u32 {
        let mut said_now: Vec<ClientRecord> = [ObjectId(5_000), ObjectId::MAX].into_iter().flat_map(records).collect();
        // Of its own it may tell poses only, of others' everything else.
        said_now.extend(records(own).into_iter().filter(|record| !matches!(record, ClientRecord::Pose { .. })));
        said_now.extend(records(theirs).into_iter().filter(|record| matches!(record, ClientRecord::Pose { .. })));
        let forbidden = said_now.iter().filter(|record| !matches!(record, ClientRecord::ViolationAck { .. })).count();
        // Acknowledges what was never sent, held for longer than the world is old.
        let link = LinkHeader { seq: 1_000_000 + round, ack: u32::MAX, ack_bits: u32::MAX, hold_micros: u32::MAX };
        let mut writer = DatagramWriter::new(&ClientHeader { link, frame: WorldTime::MAX }, 1_150);
        assert!(said_now.iter().all(|record| writer.push(record)));
        village.run.send_raw(VILLAIN, Kind::Datagram, writer.finish(), &mut truth);
        let place = codec::encode_control(&ClientControl::Place { object: theirs, position: far, present: false });
        village.run.send_raw(VILLAIN, Kind::Control, place[4..].to_vec(), &mut truth);
        said += forbidden as u64 + 1;
        village.run_for(ms(50), &mut truth);
    }
    village.run_for(ms(200), &mut truth);
    truth.assert_kept("beside a liar");
    assert!(truth.visible_checked > 500 && truth.bounds_checked > 500);
    let stats = village.run.world().stats();
    // Of its wishes to be elsewhere most are beyond the limit already, and not even looked at.
    assert_eq!(stats.forbidden - before.forbidden + stats.limited.of(Limited::Places), said);
    assert_eq!(
        (stats.rejected_datagrams, stats.rejected_control),
        (before.rejected_datagrams, before.rejected_control)
    );
    assert!(stats.stale_datagrams > before.stale_datagrams, "its own session's datagrams are older than its lies");
    let object = &village.run.world().objects()[theirs.index()];
    assert!(object.present && object.position.metres().length() < 30.0, "{:?}", object.position);
}

#[test]
fn a_clock_that_is_fast_slow_or_runs_backwards_is_its_owners_trouble_only() {
    let span = ms(6_000);
    let (calm, undisturbed) = quiet(span);
    // -2 runs backwards as fast as others run forwards.
    for drift in [0.1, -0.1, -2.0] {
        let mut village = Village::new(&Rules { drift, ..Rules::new(1, link()) });
        let mut others = Others::default();
        village.run_for(span, &mut others);
        others.assert_same(&undisturbed, &format!("a drift of {drift}"));
        let (stats, before) = (village.run.world().stats(), calm.run.world().stats());
        assert_eq!(stats.rejected_datagrams, before.rejected_datagrams);
        let client = &village.run.clients()[VILLAIN];
        assert!(client.is_connected() && client.events().len() == 1, "{drift}: {:?}", client.events());
        let jumps = client.session.stats().clock_jumps;
        assert_eq!(jumps > 100, drift < -1.0, "a drift of {drift}: {jumps} jumps");
        let drawn = client.session.tracker().map_or(0, |tracker| tracker.drawn().count());
        assert!(drawn > 0, "a drift of {drift}: it draws nothing");
    }
}

#[test]
fn a_clock_that_jumps_is_its_owners_trouble_only_and_soon_right_again() {
    let (before, after) = (ms(2_000), ms(3_000));
    let (_, undisturbed) = quiet(before + ms(200) + after);
    for jump in [-1_500_000, -3_600_000_000, 1_500_000, 3_600_000_000i64] {
        let mut village = Village::new(&Rules::new(1, link()));
        let mut others = Others::default();
        village.run_for(before, &mut others);
        village.run.jump_clock(VILLAIN, jump);
        // A round trip and two frames: then its clock has been put right by a probe.
        village.run_for(ms(200), &mut others);
        let mut truth = village.truth([VILLAIN], Duration::ZERO);
        village.run_for(after, &mut Both { others: &mut others, truth: &mut truth });
        others.assert_same(&undisturbed, &format!("a jump of {jump} µs"));
        truth.assert_kept(&format!("after a jump of {jump} µs"));
        assert_eq!(village.run.clients()[VILLAIN].session.stats().clock_jumps, u64::from(jump < 0));
        let checked = (truth.visible_checked, truth.bounds_checked);
        // Who takes it to be an hour later believes no bound any more, and asks about everything.
        let hides = jump < 1_000_000_000;
        assert!(checked.0 > 30 && (checked.1 > 300 || !hides), "{checked:?}");
    }
}

/// Two observers at once.
struct Both<'a> {
    others: &'a mut Others,
    truth: &'a mut Truth,
}

impl Observer for Both<'_> {
    fn committed(&mut self, world: &World, at: WorldTime) {
        self.truth.committed(world, at);
    }

    fn framed(&mut self, frame: &Framed<'_>) {
        self.truth.framed(frame);
    }

    fn arrives(&mut self, message: &Passing<'_>) {
        self.others.arrives(message);
    }

    fn lost(&mut self, message: &Passing<'_>) {
        self.truth.lost(message);
    }
}
