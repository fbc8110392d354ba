//! A client in a few lines: `cargo run --example watch -- 127.0.0.1:4433 FINGERPRINT`, beside the server's example.

use std::time::Duration;

use anyhow::Context;
use eyeline_client::net::{Endpoint, Fingerprint, LocalClock, ModelSource, Onlooker, run_headless};
use eyeline_client::session::{Session, SessionConfig};
use eyeline_visibility::{Aabb, DynamicOctree};

#[tokio::main(flavor = "current_thread")]
async fn main() -> anyhow::Result<()> {
    let mut args = std::env::args().skip(1);
    let (address, fingerprint) = args.next().zip(args.next()).context("say where, and the server's fingerprint")?;

    // The session is a state machine; the endpoint puts a socket and a clock around it.
    let address = address.parse()?;
    let endpoint = Endpoint::new(fingerprint.parse::<Fingerprint>()?, address)?;
    let session = Session::new(SessionConfig::default(), Box::new(|| Box::new(DynamicOctree::new(Aabb::EMPTY))));
    let mut connection = endpoint.connect(address, session, LocalClock::default()).await?;
    let scene = connection.scene(&ModelSource::Fetch).await?;

    // Somebody stands there, turns, and says every two seconds what can be seen.
    let welcome = connection.session.welcome().context("not welcome")?;
    let look = Box::new(|session: &mut Session, report: &eyeline_client::net::FrameReport| {
        if let Some(tracker) = session.tracker().filter(|_| report.frame % 40 == 39) {
            let seen: Vec<u32> = tracker.drawn().map(|drawn| drawn.object.0).collect();
            println!("of {} hidden things nothing is known but a bound; seen: {seen:?}", tracker.counts().1);
        }
    });
    let mut onlooker = Onlooker::new(&scene, welcome, 128, look).context("no avatar")?;
    let end = tokio::time::sleep(Duration::from_secs(10));
    let first = connection.clock().now();
    run_headless(&mut connection, &mut onlooker, Duration::from_millis(50), first, end).await?;
    connection.close().await;
    endpoint.wait_idle().await;
    Ok(())
}
