//! Coming back, taking things, payloads, operators, eyes of one's own.

use std::sync::atomic::{AtomicBool, Ordering};

use eyeline_protocol::{
    ClientId, Command, Continuity, Hold, Interest, Rank, Reason, Resume, Role, RosterEntry, ServerControl,
    ServerRecord, VERSION, Welcome,
};

use super::audit_tests::told;
use super::tests::{datagram, drain, world};
use super::*;
use crate::gate::{Caller, Denial, Permit};
use crate::policy::{Broadcast, Policy, Visible};
use crate::spec::{ClassSpec, ObjectSpec};

/// A token's first byte is its bearer's rank; bans are remembered by subject.
#[derive(Default)]
struct Ranks {
    banned: Vec<String>,
}

impl Gate for Ranks {
    fn admit(&mut self, token: &[u8], _: Caller, _: WorldTime) -> Result<Permit, Denial> {
        let (Some(&rank), subject) = (token.first(), String::from_utf8_lossy(token.get(1..).unwrap_or_default()))
        else {
            return Err(Denial { refusal: Refusal::Token, reason: "a token is needed".into() });
        };
        if self.banned.iter().any(|banned| *banned == subject) {
            return Err(Denial { refusal: Refusal::Banned, reason: "banned".into() });
        }
        Ok(Permit { rank: Rank::ALL[usize::from(rank)], avatars_max: 2, subject: subject.into_owned(), token: None })
    }

    fn ban(&mut self, subject: &str, _: Caller, _: WorldTime) {
        self.banned.push(subject.to_owned());
    }
}

const ACTOR: &[u8] = b"\x01somebody";
const OPERATOR: &[u8] = b"\x02chief";

struct Client {
    id: SessionId,
    seq: u32,
}

/// What a hello brought: the welcome, if there was one, and what followed.
fn hello(
    world: &mut World,
    number: u8,
    token: &[u8],
    role: Role,
    resume: Option<Resume>,
) -> (Client, Vec<ServerControl>) {
    let caller = Caller { address: None, resume: [number; 16] };
    let id = world.connect_from(world.committed_at(), caller);
    let hello = ClientControl::Hello {
        version: VERSION,
        token: token.to_vec(),
        resolution: (320, 240),
        interest: Interest::Around,
        role,
        name: format!("client {number}"),
        resume,
    };
    let mut client = Client { id, seq: 0 };
    say(world, &mut client, &hello);
    let heard = heard(world, id);
    (client, heard)
}

fn say(world: &mut World, client: &mut Client, message: &ClientControl) {
    world.handle_control(client.id, &codec::encode_control(message)[4..], world.committed_at());
}

fn tell(world: &mut World, client: &mut Client, records: &[ClientRecord]) {
    client.seq += 1;
    world.handle_datagram(client.id, &datagram(client.seq, records), world.committed_at());
}

/// The control messages that are sent to a client; datagrams and what others get is lost.
fn heard(world: &mut World, id: SessionId) -> Vec<ServerControl> {
    let control = |transmit| match transmit {
        Transmit::Control(bytes) => Some(codec::decode_server_control(&bytes[4..]).unwrap()),
        _ => None,
    };
    drain(world, id).into_iter().filter_map(control).collect()
}

fn welcome_of(heard: &[ServerControl]) -> &Welcome {
    match heard.first() {
        Some(ServerControl::Welcome(welcome)) => welcome,
        other => panic!("no welcome but {other:?}"),
    }
}

fn named(heard: &[ServerControl]) -> Vec<ObjectId> {
    let entries = heard.iter().filter_map(|message| match message {
        ServerControl::Roster { entries, .. } => Some(entries),
        _ => None,
    });
    entries.flatten().map(|entry: &RosterEntry| entry.object).collect()
}

fn tick(world: &mut World) {
    let due = world.poll_timeout();
    world.tick(due);
}

/// A world with a gate, and its first two clients after a tick: an actor and an operator.
fn two(policy: Box<dyn Policy>) -> (World, Client, Client) {
    let mut world = world(policy);
    world.set_gate(Box::new(Ranks::default()));
    let (actor, _) = hello(&mut world, 1, ACTOR, Role::Avatar, None);
    let (operator, _) = hello(&mut world, 2, OPERATOR, Role::Avatar, None);
    tick(&mut world);
    heard(&mut world, actor.id);
    (world, actor, operator)
}

fn back(heard: Option<u32>) -> Option<Resume> {
    Some(Resume { token: [1; 16], heard })
}

#[test]
fn a_lost_client_comes_back_to_its_avatar_and_is_told_only_what_it_missed() {
    let (mut world, actor, operator) = two(Box::new(Visible));
    let avatar = ObjectId(0);
    world.disconnect(actor.id);
    tick(&mut world);
    assert!(world.objects()[avatar.index()].present, "its avatar waits");
    assert!(heard(&mut world, operator.id).is_empty(), "nobody need hear of it");
    // Somebody comes meanwhile, and its neighbour breaks its bound.
    let (_third, _) = hello(&mut world, 3, b"\x01third", Role::Avatar, None);
    world.teleport(ObjectId(1), Position { x: 5000, y: 0, z: 0 });
    tick(&mut world);
    // It had one message of roster: that it and the operator came.
    let (mut again, news) = hello(&mut world, 4, ACTOR, Role::Avatar, back(Some(1)));
    let welcome = welcome_of(&news);
    assert_eq!((welcome.continuity, welcome.client, welcome.objects), (Continuity::Kept, ClientId(1), 0));
    assert_eq!((welcome.avatars[0].0, welcome.resume), (avatar, [4; 16]));
    assert_eq!(named(&news[1..]), [ObjectId(2)], "only who came is news");
    let (records, _) = told(&mut world, again.id);
    assert!(records.is_empty(), "{records:?}");
    tick(&mut world);
    let (records, _) = told(&mut world, again.id);
    assert!(matches!(records[..], [ServerRecord::Violation { object: ObjectId(1), .. }]), "{records:?}");
    // The avatar is its own again, whatever its datagrams' numbers were before.
    let at = world.objects()[avatar.index()].position;
    let position = Position { x: at.x + 10, ..at };
    tell(
        &mut world,
        &mut again,
        &[ClientRecord::Pose { object: avatar, position, orientation: Orientation::default() }],
    );
    tick(&mut world);
    assert_eq!(world.objects()[avatar.index()].position, position);
    assert_eq!((world.stats().resumed, world.avatars()), (1, 3));
}

#[test]
fn who_kept_nothing_or_missed_too_much_is_told_everything() {
    for (number, kept) in [(5, None), (6, Some(77)), (7, Some(u32::MAX))] {
        let (mut world, actor, _) = two(Box::new(Visible));
        world.disconnect(actor.id);
        let (_, news) = hello(&mut world, number, ACTOR, Role::Avatar, back(kept));
        let welcome = welcome_of(&news);
        assert_eq!((welcome.continuity, welcome.avatars[0].0), (Continuity::Returned, ObjectId(0)), "{kept:?}");
        assert_eq!(named(&news[1..]), [ObjectId(1)], "{kept:?}");
    }
}

#[test]
fn who_stays_away_too_long_has_left_and_begins_anew() {
    let (mut world, actor, operator) = two(Box::new(Visible));
    world.disconnect(actor.id);
    let grace = world.config.resume_grace;
    while world.committed_at() < WorldTime::ZERO + grace + 4 * world.tick_period() {
        tick(&mut world);
    }
    let left = ServerControl::Left { objects: vec![ObjectId(0)] };
    assert_eq!(heard(&mut world, operator.id), [left]);
    let (_, news) = hello(&mut world, 9, ACTOR, Role::Avatar, back(Some(1)));
    assert_eq!((welcome_of(&news).continuity, world.avatars()), (Continuity::New, 2));
}

#[test]
fn who_says_goodbye_is_not_waited_for() {
    let (mut world, mut actor, _) = two(Box::new(Visible));
    say(&mut world, &mut actor, &ClientControl::Goodbye);
    world.disconnect(actor.id);
    assert_eq!((world.avatars(), world.sessions()), (1, 1));
}

#[test]
fn a_token_to_come_back_with_is_good_once_and_for_its_owner_only() {
    let (mut world, actor, _) = two(Box::new(Visible));
    world.disconnect(actor.id);
    let (_, news) = hello(&mut world, 5, b"\x01thief", Role::Avatar, back(Some(1)));
    assert_eq!(welcome_of(&news).continuity, Continuity::New, "another's token");
    let (_, news) = hello(&mut world, 6, ACTOR, Role::Avatar, Some(Resume { token: [0; 16], heard: Some(1) }));
    assert_eq!(welcome_of(&news).continuity, Continuity::New, "no token at all");
    let (mut again, news) = hello(&mut world, 7, ACTOR, Role::Avatar, back(Some(1)));
    assert_eq!(welcome_of(&news).continuity, Continuity::Kept);
    tell(&mut world, &mut again, &[]);
    let (_, news) = hello(&mut world, 8, ACTOR, Role::Avatar, back(Some(1)));
    assert_eq!(welcome_of(&news).continuity, Continuity::New, "used up");
}

#[test]
fn a_connection_that_still_stands_is_replaced() {
    let (mut world, actor, _) = two(Box::new(Visible));
    let old = actor.id;
    let caller = Caller { address: None, resume: [5; 16] };
    let id = world.connect_from(world.committed_at(), caller);
    let (version, token, role) = (VERSION, ACTOR.to_vec(), Role::Avatar);
    let (resolution, interest, name, resume) = ((1, 1), Interest::Around, String::new(), back(Some(1)));
    let hello = ClientControl::Hello { version, token, resolution, interest, role, name, resume };
    world.handle_control(id, &codec::encode_control(&hello)[4..], WorldTime::ZERO);
    let news = heard(&mut world, old);
    assert!(matches!(news[..], [ServerControl::Refused { refusal: Refusal::Replaced, .. }]), "{news:?}");
    // That the old one ends changes nothing.
    world.disconnect(old);
    assert_eq!((world.sessions(), world.avatars(), world.is_admitted(id)), (2, 2, true));
}

const CHAIR: ObjectId = ObjectId(0);

/// A world with a chair that people may move, half a metre from where they start, and another that they may not.
fn furnished() -> (World, Client, Client) {
    let class = ClassSpec { name: "chair".into(), radius: 0.4, bottom: 0.0, top: 1.0, speed_max: 1.0 };
    let chair = |takeable, x| ObjectSpec {
        name: format!("chair {x}"),
        class: "chair".into(),
        node: None,
        position: [x, 0.0, 0.0],
        heading: 0.0,
        takeable,
        path: None,
    };
    let objects = vec![chair(true, 0.5), chair(false, 0.6), chair(true, 9.0)];
    let spec = WorldSpec { classes: vec![class], objects, ..WorldSpec::default() };
    let info = WorldInfo { name: "test".into(), hash: [0; 32], size_bytes: 0, two_sided: false };
    let mut world =
        World::new(WorldConfig::default(), spec, info, DVec3::ZERO, Box::new(Visible), WorldTime::ZERO).unwrap();
    world.set_gate(Box::new(Ranks::default()));
    let (a, _) = hello(&mut world, 1, ACTOR, Role::Avatar, None);
    let (b, _) = hello(&mut world, 2, b"\x01other", Role::Avatar, None);
    tick(&mut world);
    (world, a, b)
}

fn wants(object: ObjectId) -> ClientRecord {
    ClientRecord::Request { object, want: Want::State, reason: Reason::Exposed }
}

fn takes(world: &mut World, client: &mut Client, object: ObjectId) -> Hold {
    heard(world, client.id);
    say(world, client, &ClientControl::Take { object });
    match heard(world, client.id)[..] {
        [ServerControl::Held { object: of, hold }] if of == object => hold,
        ref other => panic!("no answer but {other:?}"),
    }
}

#[test]
fn a_thing_is_taken_by_who_is_near_and_sees_it_and_by_nobody_else() {
    let (mut world, mut a, mut b) = furnished();
    assert_eq!(takes(&mut world, &mut a, CHAIR), Hold::TooFar, "it has not been told of it");
    for client in [&mut a, &mut b] {
        tell(&mut world, client, &[wants(CHAIR), wants(ObjectId(1)), wants(ObjectId(2))]);
    }
    assert_eq!(takes(&mut world, &mut a, CHAIR), Hold::Yours);
    assert_eq!(takes(&mut world, &mut a, CHAIR), Hold::Yours, "asked twice");
    assert_eq!(takes(&mut world, &mut b, CHAIR), Hold::Taken);
    assert_eq!(takes(&mut world, &mut b, ObjectId(1)), Hold::Fixed);
    assert_eq!(takes(&mut world, &mut b, ObjectId(2)), Hold::TooFar);
    assert_eq!(takes(&mut world, &mut b, ObjectId(4000)), Hold::Fixed);
    let avatar = world.sessions[&a.id].avatars[0];
    assert_eq!(takes(&mut world, &mut b, avatar), Hold::Fixed, "people are nobody's");
}

#[test]
fn who_takes_a_thing_moves_it_within_its_bound_and_those_who_held_one_hear_that_it_broke() {
    let (mut world, mut a, mut b) = furnished();
    tell(&mut world, &mut a, &[wants(CHAIR)]);
    told(&mut world, b.id);
    let issue = world.objects()[CHAIR.index()].issue;
    assert_eq!(takes(&mut world, &mut a, CHAIR), Hold::Yours);
    tick(&mut world);
    assert!(world.objects()[CHAIR.index()].issue > issue);
    let (records, _) = told(&mut world, b.id);
    let is_news =
        |record: &ServerRecord| matches!(record, ServerRecord::Violation { object: CHAIR, present: true, .. });
    assert!(records.iter().any(is_news), "it held a bound of what stands: {records:?}");
    // The bound that is told from now on grows.
    tell(&mut world, &mut b, &[ClientRecord::Request { object: CHAIR, want: Want::Bound, reason: Reason::Violated }]);
    let (records, _) = told(&mut world, b.id);
    let grows =
        |record: &ServerRecord| matches!(record, ServerRecord::Bound { object: CHAIR, tbv } if tbv.speed_steps > 0);
    assert!(records.iter().any(grows), "{records:?}");
    // A leap of 4 m takes as long as 1 m/s allow.
    let before = world.objects()[CHAIR.index()].position;
    let position = Position { x: before.x + 4096, ..before };
    tell(&mut world, &mut a, &[ClientRecord::Pose { object: CHAIR, position, orientation: Orientation::default() }]);
    tick(&mut world);
    let moved = world.objects()[CHAIR.index()].position.metres().distance(before.metres());
    assert!((0.03..=0.06).contains(&moved), "{moved} m in a tick");
    // Others' poses of it count for nothing.
    tell(
        &mut world,
        &mut b,
        &[ClientRecord::Pose { object: CHAIR, position: before, orientation: Orientation::default() }],
    );
    assert_eq!(world.stats().forbidden, 1);
    // Who leaves lets go of it.
    say(&mut world, &mut a, &ClientControl::Goodbye);
    world.disconnect(a.id);
    tick(&mut world);
    tell(&mut world, &mut b, &[wants(CHAIR)]);
    assert_eq!(takes(&mut world, &mut b, CHAIR), Hold::Yours);
    say(&mut world, &mut b, &ClientControl::LetGo { object: CHAIR });
    assert_eq!(heard(&mut world, b.id), [ServerControl::Held { object: CHAIR, hold: Hold::Free }]);
}

#[test]
fn a_payload_goes_to_those_who_are_told_of_what_it_is_about() {
    let (mut world, mut actor, mut operator) = two(Box::new(Visible));
    assert_eq!(world.poll_event(), None);
    let payload = ClientControl::Payload { object: ObjectId(0), bytes: vec![1, 2, 3] };
    say(&mut world, &mut actor, &payload);
    assert_eq!(heard(&mut world, operator.id), [], "the operator does not see it");
    tell(&mut world, &mut operator, &[wants(ObjectId(0))]);
    heard(&mut world, operator.id);
    say(&mut world, &mut actor, &payload);
    let passed = ServerControl::Payload { object: Some(ObjectId(0)), bytes: vec![1, 2, 3] };
    assert_eq!(heard(&mut world, operator.id), [passed]);
    say(&mut world, &mut operator, &payload);
    assert_eq!((heard(&mut world, actor.id), world.stats().forbidden), (vec![], 1));
    let event = WorldEvent::Payload { client: ClientId(1), object: ObjectId(0), bytes: vec![1, 2, 3] };
    assert_eq!([world.poll_event(), world.poll_event(), world.poll_event()], [Some(event.clone()), Some(event), None]);
}

#[test]
fn operators_keep_order_and_nobody_else_does() {
    let (mut world, mut actor, mut operator) = two(Box::new(Visible));
    let kick = ClientControl::Command(Command::Kick { client: ClientId(2), reason: "out".into() });
    say(&mut world, &mut actor, &kick);
    assert!(matches!(heard(&mut world, actor.id)[..], [ServerControl::Done { ok: false, .. }]));
    say(&mut world, &mut operator, &ClientControl::Command(Command::List));
    match &heard(&mut world, operator.id)[..] {
        [ServerControl::Clients { entries }, ServerControl::Done { ok: true, .. }] => {
            let who: Vec<_> = entries.iter().map(|entry| (entry.client.0, &entry.subject[..], entry.rank)).collect();
            assert_eq!(who, [(1, "somebody", Rank::Actor), (2, "chief", Rank::Operator)]);
        }
        other => panic!("{other:?}"),
    }
    say(&mut world, &mut operator, &ClientControl::Command(Command::Say { text: "hello".into() }));
    assert_eq!(heard(&mut world, actor.id), [ServerControl::Said { text: "hello".into() }]);
    heard(&mut world, operator.id);
    let ban = Command::Ban { client: ClientId(1), seconds: 60, reason: "enough".into() };
    say(&mut world, &mut operator, &ClientControl::Command(ban));
    let news = heard(&mut world, actor.id);
    assert!(matches!(&news[..], [ServerControl::Refused { refusal: Refusal::Banned, reason }] if reason == "enough"));
    world.disconnect(actor.id);
    assert_eq!(world.sessions(), 1, "who is banned is not waited for");
    let (_, news) = hello(&mut world, 5, ACTOR, Role::Avatar, back(Some(1)));
    assert!(matches!(news[..], [ServerControl::Refused { refusal: Refusal::Banned, .. }]), "{news:?}");
}

#[test]
fn a_rank_lets_one_be_so_much_and_no_more() {
    let mut world = world(Box::new(Visible));
    world.set_gate(Box::new(Ranks::default()));
    let avatars = |avatars| Role::Actor { avatars };
    for (number, token, role, is_in) in [
        (1, &b""[..], Role::Viewer, false),
        (2, b"\x00v", Role::Viewer, true),
        (3, b"\x00v", Role::Avatar, false),
        (4, b"\x00v", avatars(1), false),
        (5, b"\x01a", Role::Viewer, false),
        (6, b"\x01a", avatars(2), true),
        (7, b"\x01a", avatars(3), false),
    ] {
        let (_, news) = hello(&mut world, number, token, role, None);
        let is_welcome = matches!(news.first(), Some(ServerControl::Welcome(_)));
        assert_eq!(is_welcome, is_in, "{number}: {news:?}");
        assert!(is_in || matches!(news[..], [ServerControl::Refused { refusal: Refusal::Token, .. }]), "{news:?}");
    }
}

/// Where a client's eye is taken to be, metres along x.
fn eye_of(world: &World, client: &Client) -> Option<f64> {
    let class = &world.classes[usize::from(AVATAR_CLASS.0)];
    Some(world.sessions[&client.id].watcher(client.id, &world.objects, class)?.eye.x)
}

#[test]
fn an_actors_eye_stays_by_its_avatar_and_who_may_fly_looks_from_anywhere() {
    let (mut world, mut actor, mut operator) = two(Box::new(Broadcast));
    let (mut viewer, _) = hello(&mut world, 3, b"\x00v", Role::Viewer, None);
    assert_eq!(eye_of(&world, &viewer), None, "nothing is told to an eye that is nowhere");
    let at = |x: f64| {
        let position = Position::from_metres(DVec3::new(x, 1.6, 0.0)).unwrap();
        [ClientRecord::Eye { position, orientation: Orientation::default() }]
    };
    for (x, expected) in [(1.5, [1.5; 3]), (2.5, [0.0, 2.5, 2.5]), (500.0, [0.0, 500.0, 500.0])] {
        for (client, expected) in [&mut actor, &mut operator, &mut viewer].into_iter().zip(expected) {
            tell(&mut world, client, &at(x));
            assert_eq!(eye_of(&world, client), Some(expected), "{:?} at {x}", client.id);
        }
    }
    // A viewer is told of others, and moves nobody.
    tick(&mut world);
    let (records, _) = told(&mut world, viewer.id);
    assert_eq!(records.len(), 2, "{records:?}");
    let position = Position::default();
    let pose = ClientRecord::Pose { object: ObjectId(0), position, orientation: Orientation::default() };
    tell(&mut world, &mut viewer, &[pose]);
    assert_eq!(world.stats().forbidden, 1);
}

#[test]
fn a_thing_cannot_be_teleported_or_taken_out_of_the_world_by_who_holds_it() {
    let (mut world, mut a, _) = furnished();
    tell(&mut world, &mut a, &[wants(CHAIR)]);
    told(&mut world, a.id);
    assert_eq!(takes(&mut world, &mut a, CHAIR), Hold::Yours);
    tick(&mut world);
    let before = world.objects()[CHAIR.index()].position;
    for present in [true, false] {
        say(
            &mut world,
            &mut a,
            &ClientControl::Place { object: CHAIR, position: Position { x: 99, y: 0, z: 0 }, present },
        );
    }
    tick(&mut world);
    let chair = &world.objects()[CHAIR.index()];
    assert_eq!((chair.position, chair.present, world.stats().forbidden), (before, true, 2));
}

#[test]
fn an_avatar_that_is_nowhere_lends_its_owner_no_eye() {
    let (mut world, mut actor, mut operator) = two(Box::new(Broadcast));
    for (client, object) in [(&mut actor, ObjectId(0)), (&mut operator, ObjectId(1))] {
        say(&mut world, client, &ClientControl::Place { object, position: Position::default(), present: false });
    }
    tick(&mut world);
    assert_eq!((eye_of(&world, &actor), eye_of(&world, &operator)), (None, Some(0.0)));
}

#[test]
fn who_did_not_hear_the_welcome_may_come_back_with_the_token_before() {
    let (mut world, actor, _) = two(Box::new(Visible));
    world.disconnect(actor.id);
    let (lost, _) = hello(&mut world, 5, ACTOR, Role::Avatar, back(Some(1)));
    world.disconnect(lost.id);
    let (mut again, news) = hello(&mut world, 6, ACTOR, Role::Avatar, back(Some(1)));
    assert_eq!(welcome_of(&news).continuity, Continuity::Kept);
    // Once it is heard of, only the newest token is good.
    tell(&mut world, &mut again, &[]);
    world.disconnect(again.id);
    let (_, news) = hello(&mut world, 7, ACTOR, Role::Avatar, Some(Resume { token: [5; 16], heard: Some(1) }));
    assert_eq!(welcome_of(&news).continuity, Continuity::New);
}

#[test]
fn who_comes_back_with_nothing_holds_nothing_and_who_kept_all_hears_what_it_holds() {
    for (kept, hold) in [(Some(1), Some(Hold::Yours)), (None, None)] {
        let (mut world, mut a, mut b) = furnished();
        for client in [&mut a, &mut b] {
            tell(&mut world, client, &[wants(CHAIR)]);
        }
        told(&mut world, a.id);
        assert_eq!(takes(&mut world, &mut a, CHAIR), Hold::Yours);
        tick(&mut world);
        world.disconnect(a.id);
        // The roster came in one piece, and its own coming was announced.
        let heard_before = kept.map(|count: u32| count + 1);
        let (_, news) = hello(&mut world, 9, ACTOR, Role::Avatar, back(heard_before));
        let held = news.iter().find_map(|message| match message {
            ServerControl::Held { object: CHAIR, hold } => Some(*hold),
            _ => None,
        });
        assert_eq!(held, hold, "{:?}", welcome_of(&news).continuity);
        assert_eq!(world.objects()[CHAIR.index()].owner.is_some(), hold.is_some());
    }
}

/// Thinks better of it when told to: `anna` may stay no longer.
struct Fickle(Arc<AtomicBool>);

impl Gate for Fickle {
    fn admit(&mut self, token: &[u8], _: Caller, _: WorldTime) -> Result<Permit, Denial> {
        let subject = String::from_utf8_lossy(token).into_owned();
        Ok(Permit { rank: Rank::Actor, avatars_max: 1, subject, token: None })
    }

    fn ban(&mut self, _: &str, _: Caller, _: WorldTime) {}

    fn look(&mut self, _: WorldTime) -> bool {
        self.0.load(Ordering::Relaxed)
    }

    fn dismisses(&self, permit: &Permit, _: Caller, _: WorldTime) -> Option<Denial> {
        (permit.subject == "anna").then(|| Denial { refusal: Refusal::Token, reason: "your token was revoked".into() })
    }
}

#[test]
fn who_may_stay_no_longer_is_told_why_and_leaves_within_a_tick() {
    let news = Arc::new(AtomicBool::new(false));
    let mut world = world(Box::new(Visible));
    world.set_gate(Box::new(Fickle(news.clone())));
    let (anna, _) = hello(&mut world, 1, b"anna", Role::Avatar, None);
    let (bob, _) = hello(&mut world, 2, b"bob", Role::Avatar, None);
    let (away, _) = hello(&mut world, 3, b"anna", Role::Avatar, None);
    tick(&mut world);
    world.disconnect(away.id);
    tick(&mut world);
    heard(&mut world, anna.id);
    assert_eq!(world.avatars(), 3, "who is away has an avatar that waits");
    news.store(true, Ordering::Relaxed);
    tick(&mut world);
    let sent = drain(&mut world, anna.id);
    let refused = sent.iter().find_map(|transmit| match transmit {
        Transmit::Control(bytes) => match codec::decode_server_control(&bytes[4..]).unwrap() {
            ServerControl::Refused { refusal, reason } => Some((refusal, reason)),
            _ => None,
        },
        _ => None,
    });
    assert_eq!(refused, Some((Refusal::Token, "your token was revoked".into())));
    assert!(sent.iter().any(|transmit| matches!(transmit, Transmit::Close(_))), "{sent:?}");
    // Said once, though the news stands; who waited for nothing is gone at once, and comes back to nothing.
    tick(&mut world);
    assert!(heard(&mut world, anna.id).iter().all(|message| !matches!(message, ServerControl::Refused { .. })));
    assert_eq!((world.stats().dismissed, world.avatars()), (2, 2));
    world.disconnect(anna.id);
    tick(&mut world);
    assert_eq!(world.avatars(), 1);
    assert!(world.is_admitted(bob.id));
}
