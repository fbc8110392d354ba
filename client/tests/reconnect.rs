//! What was to be said when a connection was lost is said over the next one, or the application hears that it was not.

use eyeline_client::session::{Event, Session, SessionConfig};
use eyeline_protocol::codec::{DatagramWriter, decode_client_control, encode_control};
use eyeline_protocol::{
    Class, ClientControl, ClientId, Continuity, Extent, Hold, LinkHeader, LocalTime, MotionBound, ObjectId,
    Orientation, Position, Rank, ServerControl, ServerHeader, VERSION, Welcome, WorldInfo, WorldTime,
};
use eyeline_visibility::FlatIndex;

const OWN: ObjectId = ObjectId(0);
const CHAIR: ObjectId = ObjectId(7);
const LAMP: ObjectId = ObjectId(8);

fn hear(session: &mut Session, message: &ServerControl) {
    session.handle_control(&encode_control(message)[4..]);
}

fn welcome(session: &mut Session, continuity: Continuity) {
    let avatar = Class {
        name: "avatar".into(),
        motion: MotionBound { speed_max: 2.0, slack: 0.1 },
        extent: Extent { radius: 0.3, bottom: 0.0, top: 1.8 },
        eye_height: 1.6,
        turn_max: None,
    };
    let welcome = Welcome {
        version: VERSION,
        client: ClientId(1),
        avatars: vec![(OWN, Position::default(), Orientation::default())],
        anchor: [0.0; 3],
        tick_micros: 50_000,
        answer_micros: 0,
        policy: "visible".into(),
        tracking: true,
        blur: 1.0,
        dead_reckoning_px: None,
        world: WorldInfo { name: "test".into(), hash: [0; 32], size_bytes: 0, two_sided: false },
        classes: vec![avatar],
        objects: 0,
        rank: Rank::Actor,
        resume: [1; 16],
        grace_millis: 30_000,
        continuity,
    };
    hear(session, &ServerControl::Welcome(Box::new(welcome)));
}

/// All that it says on the control stream now.
fn said(session: &mut Session) -> Vec<ClientControl> {
    std::iter::from_fn(|| session.poll_control()).map(|bytes| decode_client_control(&bytes[4..]).unwrap()).collect()
}

/// The server's first datagram on a connection.
fn told(session: &mut Session) {
    let link = LinkHeader { seq: 1, ..LinkHeader::default() };
    let tick = WorldTime::from_micros(50_000);
    let datagram = DatagramWriter::new(&ServerHeader { link, sent: tick, tick }, 1200).finish();
    session.handle_datagram(&datagram, None, LocalTime::from_micros(1_000));
}

fn unsaid(session: &mut Session) -> Vec<ClientControl> {
    let events = std::iter::from_fn(|| session.poll_event());
    let unsaid = events.filter_map(|event| if let Event::Unsaid(message) = event { Some(*message) } else { None });
    unsaid.collect()
}

fn is_hello(said: &[ClientControl]) -> bool {
    matches!(said, [ClientControl::Hello { .. }])
}

#[test]
fn what_the_server_may_not_have_heard_is_said_again_once_it_tells_again() {
    let mut session = Session::new(SessionConfig::default(), Box::new(|| Box::new(FlatIndex::default())));
    assert!(is_hello(&said(&mut session)));
    welcome(&mut session, Continuity::New);
    session.let_go(LAMP);
    assert_eq!(said(&mut session), [ClientControl::LetGo { object: LAMP }]);
    // The lamp's answer has not come, and the rest has not left.
    session.take(CHAIR);
    session.send_payload(OWN, vec![1, 2]);
    session.want_world();
    session.reconnect();
    assert!(is_hello(&said(&mut session)), "first hello alone");
    welcome(&mut session, Continuity::Kept);
    assert_eq!(said(&mut session), [], "a thing can be taken only by who is told of it");
    told(&mut session);
    let (take, let_go) = (ClientControl::Take { object: CHAIR }, ClientControl::LetGo { object: LAMP });
    let payload = ClientControl::Payload { object: OWN, bytes: vec![1, 2] };
    assert_eq!(said(&mut session), [let_go.clone(), take, payload]);
    // What is answered is settled. Payloads are not answered, and not said twice.
    hear(&mut session, &ServerControl::Held { object: CHAIR, hold: Hold::Yours });
    session.reconnect();
    assert!(is_hello(&said(&mut session)));
    welcome(&mut session, Continuity::Kept);
    told(&mut session);
    assert_eq!(said(&mut session), std::slice::from_ref(&let_go));
    assert_eq!(unsaid(&mut session), []);

    // Whom the server has forgotten has nothing to put down.
    session.reconnect();
    assert!(is_hello(&said(&mut session)));
    welcome(&mut session, Continuity::New);
    told(&mut session);
    assert_eq!(said(&mut session), []);
    assert_eq!(unsaid(&mut session), [let_go]);
}

#[test]
fn what_is_wanted_last_counts_and_what_waits_is_bounded() {
    let mut session = Session::new(SessionConfig::default(), Box::new(|| Box::new(FlatIndex::default())));
    welcome(&mut session, Continuity::New);
    session.take(CHAIR);
    said(&mut session);
    session.let_go(CHAIR);
    for _ in 0..3_000 {
        session.send_payload(OWN, vec![0]);
    }
    session.reconnect();
    said(&mut session);
    assert_eq!(unsaid(&mut session).len(), 3_001 - 1_024);
    welcome(&mut session, Continuity::Kept);
    told(&mut session);
    assert_eq!(said(&mut session).len(), 1_024);
}
