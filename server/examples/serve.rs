//! A server in a few lines: `cargo run --example serve -- rooms.glb`.

use std::path::Path;

use anyhow::Context;
use eyeline_protocol::WorldTime;
use eyeline_server::model::Model;
use eyeline_server::net::{Identity, Server, WorldClock};
use eyeline_server::policy::PolicySettings;
use eyeline_server::world::WorldConfig;

#[tokio::main(flavor = "current_thread")]
async fn main() -> anyhow::Result<()> {
    let file = std::env::args().nth(1).context("say which .glb to serve")?;
    let model = Model::load(Path::new(&file), None)?;

    // The world is a state machine; a policy decides what each client is told.
    let clock = WorldClock::starting_at(WorldTime::ZERO);
    let config = WorldConfig::default().with_blur(2.0);
    let world = model.world(config, "visible", &PolicySettings::default(), clock.now())?;

    // The server puts sockets and a clock around it.
    let identity = Identity::ephemeral()?;
    println!("fingerprint {}", identity.fingerprint_hex());
    let server = Server::bind("127.0.0.1:4433".parse()?, identity, world, model.bytes.to_vec().into(), clock, None)?;
    println!("serving {} at {}; Ctrl-C ends it", model.info.name, server.local_addr()?);

    // A handle looks at the world, and changes it, while it runs.
    let handle = server.handle();
    server.run(async { tokio::signal::ctrl_c().await.unwrap_or_default() }).await;
    println!("{} clients came", handle.with_world(|world| world.stats().admitted));
    Ok(())
}
