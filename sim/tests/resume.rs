//! Over real QUIC: a client that is cut off comes back to its avatar and what it held, and one whose address changes goes on.

#![expect(clippy::disallowed_methods, reason = "a test is a driver")]

use std::net::{Ipv4Addr, SocketAddr};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use eyeline_client::net::{Connection, Endpoint, LocalClock, ModelSource, Onlooker, run_headless};
use eyeline_client::session::{Session, SessionConfig};
use eyeline_protocol::{Continuity, ObjectId, Role, WorldTime};
use eyeline_server::model::Model;
use eyeline_server::net::{Handle, Identity, Server, WorldClock};
use eyeline_server::policy::PolicySettings;
use eyeline_server::world::{WorldConfig, WorldEvent};
use eyeline_sim::scene::rooms::{RoomRules, RoomScene};
use eyeline_visibility::{Aabb, DynamicOctree, Scene};

/// A server of 2×2 rooms on a port of its own, in this thread's runtime.
async fn serve(grace: Duration) -> (Handle, SocketAddr, [u8; 32], tokio::task::JoinHandle<()>) {
    let made = RoomScene::make(&RoomRules::default().with_size(2, 2)).unwrap();
    let model = Model::from_bytes(made.glb.clone(), "rooms.glb", Some(made.world.clone())).unwrap();
    let clock = WorldClock::starting_at(WorldTime::ZERO);
    let config = WorldConfig::default().with_resume_grace(grace);
    let world = model.world(config, "visible", &PolicySettings::default(), clock.now()).unwrap();
    let identity = Identity::ephemeral().unwrap();
    let fingerprint = identity.fingerprint();
    let bytes = model.bytes.to_vec().into();
    let server = Server::bind((Ipv4Addr::LOCALHOST, 0).into(), identity, world, bytes, clock, None).unwrap();
    let (handle, address) = (server.handle(), server.local_addr().unwrap());
    (handle, address, fingerprint, tokio::spawn(server.run(std::future::pending())))
}
