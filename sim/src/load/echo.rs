//! The limit that a server is held against: QUIC and nothing else.
//!
//! [`serve`] takes datagrams of a given size and gives others, as many in all and at the same moments as a world would: one to
//! each client at each tick, and the rest as answers to what arrives. There is no world in it. [`play`] is the other end:
//! as many connections as clients, each saying so much at 20 Hz, staggered over the tick, and in as many bunches as a world's
//! clients: a server that waits for each datagram takes up to half as much time again as one that finds a handful. Both use the
//! settings of the real server and client.

use std::cell::RefCell;
use std::future::Future;
use std::net::SocketAddr;
use std::rc::Rc;
use std::sync::Arc;
use std::time::Duration;

use anyhow::Context as _;
use bytes::Bytes;
use eyeline_client::net::Fingerprint;
use eyeline_server::net::Identity;
use tokio::time::{Instant, MissedTickBehavior, interval_at};

/// What is said each way, for one client and tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Traffic {
    /// Time between ticks, and between a client's frames.
    pub period: Duration,
    /// Datagrams from a client in a tick.
    pub up: f64,
    /// Bytes of each.
    pub up_bytes: usize,
    /// Datagrams to a client in a tick; at least one.
    pub down: f64,
    /// Bytes of each.
    pub down_bytes: usize,
    /// In how many bunches a second all that clients say arrives, evenly spread; if none is given, each client's frame on its own.
    pub bunches: Option<f64>,
}

impl Traffic {
    /// When a frame that is due at `due` is said: with the next bunch.
    fn said_at(&self, due: Duration) -> Duration {
        self.bunches.map_or(due, |rate| Duration::from_secs_f64((due.as_secs_f64() * rate).ceil() / rate))
    }
}

/// Hands out whole things at a rate that is not whole.
#[derive(Clone, Copy, Debug, Default)]
struct Share(f64);

impl Share {
    fn take(&mut self, rate: f64) -> usize {
        self.0 += rate;
        let whole = self.0.floor().max(0.0);
        self.0 -= whole;
        whole as usize
    }
}

/// Serves until `shutdown` is ready; hands its address to `ready` once it listens. Needs a tokio runtime and a `LocalSet` around it.
///
/// # Errors
/// If the address is taken or the identity is of no use.
pub async fn serve(
    address: SocketAddr,
    identity: Identity,
    traffic: Traffic,
    ready: impl FnOnce(SocketAddr) -> anyhow::Result<()>,
    shutdown: impl Future<Output = ()>,
) -> anyhow::Result<()> {
    let config = eyeline_server::net::quic_config(identity)?;
    let socket = eyeline_server::net::socket(address).with_context(|| format!("cannot listen on {address}"))?;
    let runtime = Arc::new(quinn::TokioRuntime);
    let endpoint = quinn::Endpoint::new(quinn::EndpointConfig::default(), Some(config), socket, runtime)?;
    ready(endpoint.local_addr()?)?;
    let clients: Rc<RefCell<Vec<quinn::Connection>>> = Rc::default();
    let answer = Bytes::from(vec![0; traffic.down_bytes]);
    let answers = ((traffic.down - 1.0) / traffic.up).max(0.0);
    let mut ticks = interval_at(Instant::now() + traffic.period, traffic.period);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Skip);
    tokio::pin!(shutdown);
    loop {
        tokio::select! {
            () = &mut shutdown => break,
            _ = ticks.tick() => {
                for client in clients.borrow().iter() {
                    let _ = client.send_datagram(answer.clone());
                }
            }
            incoming = endpoint.accept() => {
                let Some(incoming) = incoming else { break };
                let (clients, answer) = (clients.clone(), answer.clone());
                tokio::task::spawn_local(async move {
                    let Ok(connection) = incoming.await else { return };
                    clients.borrow_mut().push(connection.clone());
                    let mut share = Share::default();
                    while connection.read_datagram().await.is_ok() {
                        for _ in 0..share.take(answers) {
                            let _ = connection.send_datagram(answer.clone());
                        }
                    }
                    let gone = connection.stable_id();
                    clients.borrow_mut().retain(|client| client.stable_id() != gone);
                });
            }
        }
    }
    endpoint.close(0u32.into(), b"the end");
    let _ = tokio::time::timeout(Duration::from_secs(2), endpoint.wait_idle()).await;
    Ok(())
}

/// What the other end saw.
#[derive(Clone, Debug, Default)]
pub struct Played {
    /// How late each frame began, once all were in.
    pub late: Vec<Duration>,
    /// Datagrams sent and received since.
    pub sent: u64,
    /// Datagrams received since.
    pub received: u64,
}

/// Plays `clients` clients for `seconds` from when all are in and `settle` has passed, when it calls `all_in`. Needs a tokio
/// runtime and a `LocalSet` around it.
///
/// # Errors
/// If a connection is not to be had.
pub async fn play(
    address: SocketAddr,
    fingerprint: Fingerprint,
    clients: u32,
    traffic: Traffic,
    (settle, seconds): (Duration, Duration),
    all_in: impl FnOnce(),
) -> anyhow::Result<Played> {
    let socket = eyeline_server::net::socket((std::net::Ipv4Addr::LOCALHOST, 0).into())?;
    let runtime = Arc::new(quinn::TokioRuntime);
    let mut endpoint = quinn::Endpoint::new(quinn::EndpointConfig::default(), None, socket, runtime)?;
    endpoint.set_default_client_config(eyeline_client::net::quic_config(fingerprint)?);
    let played: Rc<RefCell<(bool, Played)>> = Rc::default();
    let mut tasks = tokio::task::JoinSet::new();
    let mut speakers = Vec::new();
    for number in 0..clients {
        let connection = endpoint.connect(address, "eyeline")?.await.with_context(|| format!("client {number}"))?;
        speakers.push((connection.clone(), Share::default()));
        let played = played.clone();
        tasks.spawn_local(async move {
            while connection.read_datagram().await.is_ok() {
                let (is_measured, played) = &mut *played.borrow_mut();
                played.received += u64::from(*is_measured);
            }
        });
    }
    let (frames, mut due) = tokio::sync::mpsc::unbounded_channel();
    let clock = std::thread::spawn(move || keep_time(clients, traffic, &frames));
    let spoken = played.clone();
    tasks.spawn_local(async move {
        let question = Bytes::from(vec![0; traffic.up_bytes]);
        while let Some((number, due)) = due.recv().await {
            let (connection, share) = &mut speakers[number];
            let (is_measured, played) = &mut *spoken.borrow_mut();
            for _ in 0..share.take(traffic.up) {
                let _ = connection.send_datagram(question.clone());
                played.sent += u64::from(*is_measured);
            }
            if *is_measured {
                played.late.push(due.elapsed());
            }
        }
    });
    tokio::time::sleep(settle).await;
    all_in();
    played.borrow_mut().0 = true;
    tokio::time::sleep(seconds).await;
    played.borrow_mut().0 = false;
    let outcome = std::mem::take(&mut played.borrow_mut().1);
    endpoint.close(0u32.into(), b"goodbye");
    let _ = tokio::time::timeout(Duration::from_secs(2), endpoint.wait_idle()).await;
    tasks.shutdown().await;
    // It ends as soon as nobody hears it any more.
    let _ = clock.join();
    Ok(outcome)
}

/// Says whose frame begins: each client's once a period, all of them evenly spread, but for their bunches. Until nobody hears it.
///
/// On a thread of its own, since tokio's timers come each millisecond: what arrives in a few large bunches is cheaper to serve than what a
/// swarm says, whose people each take their time.
fn keep_time(clients: u32, traffic: Traffic, frames: &tokio::sync::mpsc::UnboundedSender<(usize, Instant)>) {
    let begin = Instant::now() + Duration::from_millis(50);
    for frame in 0u64.. {
        let due = traffic.period.mul_f64(frame as f64 / f64::from(clients));
        std::thread::sleep((begin + traffic.said_at(due)).saturating_duration_since(Instant::now()));
        if frames.send(((frame % u64::from(clients)) as usize, begin + due)).is_err() {
            return;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_add_up() {
        let mut share = Share::default();
        let handed: usize = (0..1000).map(|_| share.take(1.46)).sum();
        assert!((1459..=1460).contains(&handed), "{handed}");
        assert_eq!([share.take(-3.0), share.take(0.0)], [0, 0]);
    }

    #[test]
    fn frames_are_said_with_the_next_bunch() {
        let period = Duration::from_millis(50);
        let each = Traffic { period, up: 1.0, up_bytes: 60, down: 1.0, down_bytes: 200, bunches: None };
        let bunched = Traffic { bunches: Some(400.0), ..each };
        for (due, said) in [(0, 0), (1, 2_500), (2_500, 2_500), (2_600, 5_000), (50_000, 50_000)] {
            let (due, said) = (Duration::from_micros(due), Duration::from_micros(said));
            assert_eq!((each.said_at(due), bunched.said_at(due)), (due, said));
        }
    }

    #[test]
    fn as_many_datagrams_as_asked_for_go_each_way() {
        let period = Duration::from_millis(50);
        let traffic = Traffic { period, up: 1.5, up_bytes: 60, down: 2.2, down_bytes: 200, bunches: Some(60.0) };
        let folder = tempfile::tempdir().unwrap();
        let identity = Identity::load_or_create(folder.path()).unwrap();
        let fingerprint: Fingerprint = identity.fingerprint_hex().parse().unwrap();
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        let played = runtime.block_on(tokio::task::LocalSet::new().run_until(async move {
            let (ready, address) = tokio::sync::oneshot::channel();
            let (stop, stopped) = tokio::sync::oneshot::channel::<()>();
            let any = (std::net::Ipv4Addr::LOCALHOST, 0).into();
            let server = tokio::task::spawn_local(serve(
                any,
                identity,
                traffic,
                |at| ready.send(at).map_err(|_| anyhow::anyhow!("nobody waits")),
                async move { drop(stopped.await) },
            ));
            let times = (Duration::from_millis(100), Duration::from_millis(1000));
            let played = play(address.await.unwrap(), fingerprint, 4, traffic, times, || ()).await.unwrap();
            drop(stop);
            server.await.unwrap().unwrap();
            played
        }));
        // 4 clients, 20 frames and ticks: 120 up and 176 down, but for what is under way at the ends.
        assert!((100..=126).contains(&played.sent), "{}", played.sent);
        assert!((145..=190).contains(&played.received), "{}", played.received);
    }
}
