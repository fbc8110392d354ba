//! Over real QUIC, what people do besides walking: a client that is cut off comes back to its avatar and what it held, one whose
//! address changes goes on, one looks from above, and one moves a chair.

use std::net::{Ipv4Addr, SocketAddr};
use std::sync::Arc;
use std::time::Duration;

use eyeline_client::net::{
    Connection, Endpoint, Fingerprint, LocalClock, ModelSource, NetError, Onlooker, run_headless,
};
use eyeline_client::session::{Event, Session, SessionConfig};
use eyeline_protocol::{ClientId, Continuity, Hold, ObjectId, Orientation, Position, Rank, Refusal, Role, WorldTime};
use eyeline_server::gate::OpenGate;
use eyeline_server::model::Model;
use eyeline_server::net::{Handle, Identity, Server, WorldClock};
use eyeline_server::policy::PolicySettings;
use eyeline_server::world::WorldConfig;
use eyeline_sim::scene::plan::RoomsRules;
use eyeline_sim::scene::rooms;
use eyeline_visibility::{Aabb, DynamicOctree, Scene};
use glam::DVec3;

const GRACE: Duration = Duration::from_secs(2);
const FRAME: Duration = Duration::from_millis(50);

/// A server of 2×2 rooms on a port of its own, in this thread's runtime.
async fn serve() -> (Handle, SocketAddr, Fingerprint) {
    let made = rooms::make(&RoomsRules { columns: 2, rows: 2, ..RoomsRules::default() }).unwrap();
    let model = Model::from_bytes(made.glb.clone(), "rooms.glb", Some(made.world.clone())).unwrap();
    let clock = WorldClock::starting_at(WorldTime::ZERO);
    let config = WorldConfig::default().with_resume_grace(GRACE);
    let world = model.world(config, "visible", &PolicySettings::default(), clock.now()).unwrap();
    let identity = Identity::ephemeral().unwrap();
    let fingerprint = Fingerprint(identity.fingerprint());
    let bytes = model.bytes.to_vec().into();
    let server = Server::bind((Ipv4Addr::LOCALHOST, 0).into(), identity, world, bytes, clock, None).unwrap();
    let (handle, address) = (server.handle(), server.local_addr().unwrap());
    tokio::spawn(server.run(std::future::pending()));
    (handle, address, fingerprint)
}

/// Stands and looks for this long.
async fn look(connection: &mut Connection, scene: &Scene, time: Duration) {
    let welcome = connection.session.welcome().unwrap();
    let mut onlooker = Onlooker::new(scene, welcome, 64, Box::new(|_, _| ())).unwrap();
    let first = connection.clock().now();
    run_headless(connection, &mut onlooker, FRAME, first, tokio::time::sleep(time)).await.unwrap();
}

fn avatar(connection: &Connection) -> (ClientId, ObjectId) {
    let welcome = connection.session.welcome().unwrap();
    (welcome.client, welcome.avatars[0].0)
}

#[test]
fn who_is_cut_off_comes_back_and_who_moves_house_goes_on() {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(async {
        let (handle, address, fingerprint) = serve().await;
        let endpoint = Endpoint::new(fingerprint, address).unwrap();
        let session = || Session::new(SessionConfig::default(), Box::new(|| Box::new(DynamicOctree::new(Aabb::EMPTY))));
        let mut connection = endpoint.connect(address, session(), LocalClock::default()).await.unwrap();
        let scene: Arc<Scene> = connection.scene(&ModelSource::Fetch).await.unwrap();
        look(&mut connection, &scene, Duration::from_secs(1)).await;
        let who = avatar(&connection);
        let tracker = connection.session.tracker().unwrap();
        let (visible, hidden, _) = tracker.counts();
        assert!(visible + hidden >= 16, "{visible} and {hidden} of the chairs are known");
        let stats = || handle.with_world(|world| *world.stats());
        let before = stats();

        // Another connection, the same client.
        endpoint.resume(address, &mut connection).await.unwrap();
        assert_eq!(connection.session.welcome().unwrap().continuity, Continuity::Kept);
        assert_eq!(avatar(&connection), who);
        look(&mut connection, &scene, Duration::from_millis(500)).await;
        let tracker = connection.session.tracker().unwrap();
        let (visible_now, hidden_now, _) = tracker.counts();
        assert_eq!(visible_now + hidden_now, visible + hidden);
        assert_eq!(tracker.stats().broken_bounds, 0);
        let after = stats();
        let asked = after.messages_in.since(&before.messages_in).requests_unknown;
        let told = after.out.since(&before.out);
        assert_eq!((asked, told.roster, after.resumed), (0, 0, 1), "{told:?}");
        assert!(told.bounds <= hidden as u64, "{} bounds", told.bounds);

        // Another address, the same connection.
        endpoint.rebind().unwrap();
        look(&mut connection, &scene, Duration::from_secs(1)).await;
        let sessions = handle.with_world(|world| world.sessions());
        let heard = stats().datagrams_in - after.datagrams_in;
        assert_eq!((stats().resumed, stats().admitted, sessions), (1, 1, 1));
        assert!(heard > 5, "{heard} datagrams from the new address");

        // Who never comes back leaves its place.
        drop(connection);
        let waiting = tokio::time::timeout(3 * GRACE, async {
            while handle.with_world(|world| world.avatars()) > 0 {
                tokio::time::sleep(FRAME).await;
            }
        });
        waiting.await.unwrap();
        let mut connection = endpoint.connect(address, session(), LocalClock::default()).await.unwrap();
        assert_ne!(avatar(&connection).0, who.0);
        // Whom the server has forgotten is somebody new.
        drop(endpoint.resume(address, &mut connection).await);
        assert_eq!(connection.session.welcome().unwrap().continuity, Continuity::Kept);
    });
}

fn session(config: SessionConfig) -> Session {
    Session::new(config, Box::new(|| Box::new(DynamicOctree::new(Aabb::EMPTY))))
}

#[test]
fn who_flies_has_no_avatar_and_sees_what_is_there() {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(async {
        let (handle, address, fingerprint) = serve().await;
        let endpoint = Endpoint::new(fingerprint, address).unwrap();
        let viewer = || session(SessionConfig::default().with_role(Role::Viewer));
        // An actor's eye stays by its avatar.
        let refused = endpoint.connect(address, viewer(), LocalClock::default()).await.err();
        assert!(matches!(refused, Some(NetError::Refused { refusal: Refusal::Token, .. })), "{refused:?}");
        handle.with_world(|world| world.set_gate(Box::new(OpenGate { rank: Rank::Viewer })));
        let mut connection = endpoint.connect(address, viewer(), LocalClock::default()).await.unwrap();
        let scene = connection.scene(&ModelSource::Fetch).await.unwrap();
        // At eye height beside the first chair.
        let chair = handle.with_world(|world| world.objects()[0].position.metres());
        let eye = Position::from_metres(chair + DVec3::new(0.3, 1.6, 0.0)).unwrap();
        let mut flying = Onlooker::flying(&scene, eye, 64, Box::new(|_, _| ()));
        let first = connection.clock().now();
        let second = tokio::time::sleep(Duration::from_secs(1));
        run_headless(&mut connection, &mut flying, FRAME, first, second).await.unwrap();
        let tracker = connection.session.tracker().unwrap();
        let (visible, hidden, _) = tracker.counts();
        assert!(visible > 0 && hidden > 0, "{visible} visible, {hidden} hidden");
        assert!(tracker.drawn().any(|drawn| drawn.object == ObjectId(0)), "what is before its eye");
        assert_eq!((tracker.stats().broken_bounds, handle.with_world(|world| world.avatars())), (0, 0));
    });
}

#[test]
fn somebody_moves_a_chair_and_somebody_else_sees_it_and_hears_what_is_said_of_it() {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(async {
        let (handle, address, fingerprint) = serve().await;
        let endpoint = Endpoint::new(fingerprint, address).unwrap();
        let config = || SessionConfig::default().with_watch();
        let mut mover = endpoint.connect(address, session(config()), LocalClock::default()).await.unwrap();
        let mut other = endpoint.connect(address, session(config()), LocalClock::default()).await.unwrap();
        let scene = mover.scene(&ModelSource::Fetch).await.unwrap();
        other.scene(&ModelSource::Fetch).await.unwrap();
        // A chair that stands; both are put beside it.
        let chair = handle.with_world(|world| {
            let chairs = world.objects().iter().enumerate().filter(|(_, object)| !object.node.is_empty());
            let (chair, _) = chairs.min_by_key(|(_, object)| object.changed_at).expect("there are chairs");
            let at = world.objects()[chair].position;
            for (connection, dx) in [(&mover, -800), (&other, 800)] {
                world.teleport(avatar(connection).1, Position { x: at.x + dx, ..at });
            }
            ObjectId(chair as u32)
        });
        let from = handle.with_world(|world| world.objects()[chair.index()].position);
        let goal = Position { z: from.z + 300, ..from };

        let mut taken = false;
        let on_frame = Box::new(|session: &mut Session, report: &eyeline_client::net::FrameReport| {
            if report.frame % 5 == 4 && !taken {
                session.take(chair);
            }
            while let Some(event) = session.poll_event() {
                taken |= event == Event::Held(chair, Hold::Yours);
            }
            if taken {
                session.set_pose(chair, goal, Orientation::default());
                if report.frame.is_multiple_of(10) {
                    session.send_payload(chair, b"mine".to_vec());
                }
            }
        });
        let at = |connection: &Connection| {
            let avatar = avatar(connection).1;
            handle.with_world(|world| world.objects()[avatar.index()].position)
        };
        tokio::time::sleep(2 * FRAME).await;
        let eye_height = DVec3::Y * mover.session.welcome().unwrap().classes[0].eye_height;
        let mut heard = Vec::new();
        let listen = Box::new(|session: &mut Session, _: &eyeline_client::net::FrameReport| {
            while let Some(event) = session.poll_event() {
                heard.push(event);
            }
        });
        let [eye, other_eye] =
            [&mover, &other].map(|connection| Position::from_metres(at(connection).metres() + eye_height).unwrap());
        // They stand where they were put, which a welcome does not know: so they look from there and send no pose.
        let mut moves = Onlooker::flying(&scene, eye, 64, on_frame);
        let mut looks = Onlooker::flying(&scene, other_eye, 64, listen);
        let (first, end) = (mover.clock().now(), || tokio::time::sleep(Duration::from_secs(3)));
        let other_first = other.clock().now();
        let (a, b) = tokio::join!(
            run_headless(&mut mover, &mut moves, FRAME, first, end()),
            run_headless(&mut other, &mut looks, FRAME, other_first, end()),
        );
        a.unwrap();
        b.unwrap();
        drop((moves, looks));
        assert!(taken, "it was not given the chair");
        let now_at = handle.with_world(|world| world.objects()[chair.index()].position);
        assert_eq!(now_at, goal);
        let drawn = other.session.tracker().unwrap().shown(chair).expect("it stands before it");
        assert_eq!(drawn.position, goal);
        let payload = Event::Payload(Some(chair), b"mine".to_vec());
        assert!(heard.contains(&payload), "{heard:?}");
        assert!(heard.contains(&Event::Stopped(chair)), "{heard:?}");
        for connection in [&mover, &other] {
            assert_eq!(connection.session.tracker().unwrap().stats().broken_bounds, 0);
        }
    });
}
