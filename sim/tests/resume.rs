//! Over real QUIC: a client that is cut off comes back to its avatar and what it held, and one whose address changes goes on.

use std::net::{Ipv4Addr, SocketAddr};
use std::sync::Arc;
use std::time::Duration;

use eyeline_client::net::{Connection, Endpoint, Fingerprint, LocalClock, ModelSource, Onlooker, run_headless};
use eyeline_client::session::{Session, SessionConfig};
use eyeline_protocol::{ClientId, Continuity, ObjectId, WorldTime};
use eyeline_server::model::Model;
use eyeline_server::net::{Handle, Identity, Server, WorldClock};
use eyeline_server::policy::PolicySettings;
use eyeline_server::world::WorldConfig;
use eyeline_sim::scene::plan::RoomsRules;
use eyeline_sim::scene::rooms;
use eyeline_visibility::{Aabb, DynamicOctree, Scene};

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
