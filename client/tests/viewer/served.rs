//! A real server beside a test, over QUIC on loopback.

use std::net::SocketAddr;
use std::thread::JoinHandle;

use eyeline_protocol::WorldTime;
use eyeline_server::model::Model;
use eyeline_server::net::{Identity, Server, WorldClock};
use eyeline_server::policy::PolicySettings;
use eyeline_server::spec::WorldSpec;
use eyeline_server::world::WorldConfig;

/// A server that ends with the test.
pub struct Served {
    /// Where it listens.
    pub address: SocketAddr,
    /// Its certificate's fingerprint, hexadecimal.
    pub fingerprint: String,
    stop: Option<tokio::sync::oneshot::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Served {
    /// Serves a model with what moves in it, under the policy `visible`.
    pub fn start(model: Vec<u8>, spec: WorldSpec) -> Served {
        let model = Model::from_bytes(model, "rooms.glb", Some(spec)).unwrap();
        let (told, ready) = std::sync::mpsc::channel();
        let (stop, stopped) = tokio::sync::oneshot::channel::<()>();
        let thread = std::thread::spawn(move || {
            let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
            runtime.block_on(async {
                let now = WorldTime::ZERO;
                let config = WorldConfig::default().with_grid_seed(7);
                let world = model.world(config, "visible", &PolicySettings::default(), now).unwrap();
                let identity = Identity::ephemeral().unwrap();
                let fingerprint = identity.fingerprint_hex();
                let any = "127.0.0.1:0".parse().unwrap();
                let (bytes, clock) = (model.bytes.to_vec().into(), WorldClock::starting_at(now));
                let server = Server::bind(any, identity, world, bytes, clock, None).unwrap();
                told.send((server.local_addr().unwrap(), fingerprint)).unwrap();
                server.run(async { drop(stopped.await) }).await;
            });
        });
        let (address, fingerprint) = ready.recv().expect("the server's address");
        Served { address, fingerprint, stop: Some(stop), thread: Some(thread) }
    }

    /// Options that lead a client to it.
    pub fn options(&self) -> [String; 4] {
        ["--connect".into(), self.address.to_string(), "--fingerprint".into(), self.fingerprint.clone()]
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        if let Some(stop) = self.stop.take() {
            let _ = stop.send(());
        }
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}
