//! One who means harm, over real QUIC on this machine: what becomes of it, and whether others notice. What the world itself
//! does is counted exactly in `world/limits_tests.rs` and, in virtual time, in the package `tests`.

#![expect(clippy::disallowed_methods, clippy::disallowed_types, reason = "a test is a driver")]

mod peer;
#[cfg(unix)]
mod process;

use std::io::{Read, Write};
use std::net::{TcpStream, UdpSocket};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use eyeline_protocol::codec;
use eyeline_protocol::{ClientControl, ClientRecord, ObjectId, Orientation, Position, Refusal, ServerControl, Want};
use eyeline_server::net::{ArrivalLimits, Declined, Handle, ShellConfig, Stage, Watch, WatchError};
use eyeline_server::world::{Answers, Limited, Limits, WorldConfig};
use peer::{CHAIRS, PATIENCE, Peer, Served, Victim, endpoint, hello, join_and_read_nothing, request, runtime};

/// Two floods at once are each other's noise.
fn alone() -> MutexGuard<'static, ()> {
    static ALONE: Mutex<()> = Mutex::new(());
    ALONE.lock().unwrap_or_else(PoisonError::into_inner)
}

fn limited(arrivals: ArrivalLimits) -> ShellConfig {
    ShellConfig::default().with_arrivals(arrivals.with_limits_this_machine(true))
}

#[test]
fn who_floods_with_requests_is_sent_away_and_others_are_served() {
    let _alone = alone();
    let served = Served::new(ShellConfig::default());
    let victim = Victim::join(served.address);
    let started = Instant::now();
    runtime().block_on(async {
        for want in [Want::State, Want::Bound, Want::Place] {
            let mut hostile = Peer::join(served.address).await;
            let sent = hostile.flood(|n| Some(request(n % CHAIRS, want))).await;
            assert!(sent > 500, "{sent}");
            assert_eq!(hostile.refusal().await, Some(Refusal::Busy), "{want:?} after {sent}");
        }
    });
    let seconds = started.elapsed().as_secs_f64();
    victim.assert_served("requests");
    let stats = served.handle.with_world(|world| *world.stats());
    let limit = Limits::default().requests;
    let most = 3.0 * (limit.burst + limit.per_second * seconds) * (1.0 + limit.object * f64::from(CHAIRS + 2));
    assert!((stats.messages_in.requests() as f64) < most, "{} of at most {most}", stats.messages_in.requests());
    assert_eq!(stats.busy, 3);
    assert!(stats.limited.of(Limited::Requests) + stats.limited.of(Limited::Bytes) > 1_000, "{:?}", stats.limited);
}

#[test]
fn who_floods_with_poses_empty_or_largest_datagrams_is_sent_away() {
    let _alone = alone();
    let served = Served::new(ShellConfig::default());
    let victim = Victim::join(served.address);
    runtime().block_on(async {
        let pose = ClientRecord::Pose {
            object: ObjectId(CHAIRS + 1),
            position: Position::default(),
            orientation: Orientation::default(),
        };
        let mut hostile = Peer::join(served.address).await;
        hostile.flood(|_| Some(pose)).await;
        assert_eq!(hostile.refusal().await, Some(Refusal::Busy));

        for is_large in [false, true] {
            let mut hostile = Peer::join(served.address).await;
            let started = Instant::now();
            // The greatest size changes with the path.
            let size = || if is_large { hostile.connection.max_datagram_size().unwrap_or(0) } else { 0 };
            while hostile.connection.send_datagram_wait(vec![0xff; size()].into()).await.is_ok() {
                assert!(started.elapsed() < PATIENCE, "datagrams of {} bytes are borne", size());
            }
            assert_eq!(hostile.refusal().await, Some(Refusal::Busy), "large: {is_large}");
        }
    });
    victim.assert_served("poses and datagrams");
    let stats = served.handle.with_world(|world| *world.stats());
    assert_eq!(stats.busy, 3);
    assert!(stats.limited.of(Limited::Datagrams) > 1_000);
}

/// Where answers go with the tick, datagrams wait for it in the shell: in order before what is said on the stream, and never many.
#[test]
fn datagrams_that_wait_for_the_tick_are_heard_before_what_is_said_after_them_and_do_not_pile_up() {
    let _alone = alone();
    let config = WorldConfig::default().with_tick(Duration::from_secs(4)).with_answers(Answers::Tick);
    let served = Served::of(config, ShellConfig::default());
    let heard = || served.handle.with_world(|world| world.stats().datagrams_in);
    runtime().block_on(async {
        let mut peer = Peer::join(served.address).await;
        // Just after a tick there is time enough until the next.
        let ticks = || served.handle.with_world(|world| world.stats().ticks);
        let before = ticks();
        while ticks() == before {
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
        let before = ticks();
        let send = async |peer: &mut Peer, count: u32| {
            for n in 0..count {
                let bytes = peer.datagram([request(n, Want::Place)]);
                peer.connection.send_datagram_wait(bytes.into()).await.unwrap();
            }
            tokio::time::sleep(Duration::from_millis(200)).await;
        };
        send(&mut peer, 10).await;
        assert_eq!(heard(), 0);
        peer.say(&codec::encode_control(&ClientControl::WorldWanted)).await;
        tokio::time::sleep(Duration::from_millis(200)).await;
        assert_eq!(heard(), 10);
        send(&mut peer, 70).await;
        assert_eq!(heard(), 10 + 64, "as many as may wait are heard at once");
        assert_eq!(ticks(), before, "this machine is too slow for this test");
        while ticks() == before {
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
        assert_eq!(heard(), 80);
        // Who goes was listened to until the end.
        send(&mut peer, 5).await;
        let before = ticks();
        assert_eq!(heard(), 80);
        peer.connection.close(0u32.into(), b"");
        tokio::time::sleep(Duration::from_millis(200)).await;
        assert_eq!((heard(), ticks()), (85, before));
    });
}

#[test]
fn garbage_after_the_handshake_ends_its_own_connection_only() {
    let _alone = alone();
    let served = Served::new(ShellConfig::default());
    let victim = Victim::join(served.address);
    runtime().block_on(async {
        let world_wanted = codec::encode_control(&ClientControl::WorldWanted);
        let many = world_wanted.repeat(4_000);
        // A length beyond all limits, one that nothing follows, noise, and what makes sense far too often.
        for (bytes, refusal) in [
            (&[0xff; 64][..], Refusal::Protocol),
            (&[8, 0, 0, 0, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff], Refusal::Protocol),
            (&[3, 0, 0, 0, 0, 3, 0xfe], Refusal::Protocol),
            (&many, Refusal::Busy),
        ] {
            let mut hostile = Peer::join(served.address).await;
            hostile.say(bytes).await;
            assert_eq!(hostile.refusal().await, Some(refusal), "{:?}", &bytes[..7]);
        }
        // Lists that promise to be longer than what carries them; no stream but the first may be opened.
        let mut hostile = Peer::connect(served.address).await;
        let mut bomb = hello();
        bomb.truncate(6);
        bomb.extend([0xfd, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0x7f]);
        let length = (bomb.len() - 4) as u32;
        bomb[..4].copy_from_slice(&length.to_le_bytes());
        hostile.say(&bomb).await;
        assert_eq!(hostile.refusal().await, Some(Refusal::Protocol));
        let hostile = Peer::join(served.address).await;
        let another = tokio::time::timeout(Duration::from_millis(100), hostile.connection.open_bi()).await;
        let a_way = tokio::time::timeout(Duration::from_millis(100), hostile.connection.open_uni()).await;
        assert!(another.is_err() && a_way.is_err());
    });
    victim.assert_served("garbage");
    let stats = served.handle.with_world(|world| *world.stats());
    assert_eq!((stats.rejected_control, stats.busy), (4, 1));
    assert!(stats.limited.of(Limited::Worlds) > 0, "{:?}", stats.limited);
}

#[test]
fn who_does_not_read_is_let_go_and_costs_no_more_than_the_bound() {
    let _alone = alone();
    let served = Served::new(ShellConfig::default());
    let victim = Victim::join(served.address);
    let hostile = join_and_read_nothing(served.address);
    served.until("it is let in", |handle| handle.with_world(|world| world.census().watching == 2));
    // 4 MB of talk, which others read.
    let text = "x".repeat(1_000);
    for _ in 0..200 {
        served.handle.with_world(|world| (0..20).for_each(|_| world.say_to_all(&text)));
        if served.handle.stats().slow_readers > 0 {
            break;
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    served.until("it is let go", |handle| handle.stats().slow_readers == 1);
    hostile.join().unwrap();
    victim.assert_served("a slow reader");
    assert_eq!(served.handle.stats().slow_readers, 1);
}

/// First packets of so many clients, each for a connection of its own.
fn first_packets(number: usize) -> Vec<Vec<u8>> {
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    socket.set_read_timeout(Some(PATIENCE)).unwrap();
    let address = socket.local_addr().unwrap();
    runtime().block_on(async {
        let endpoint = endpoint("127.0.0.1", false);
        let mut packets = Vec::new();
        for _ in 0..number {
            let connecting = endpoint.connect(address, "eyeline").unwrap();
            // Lets it send.
            let _ = tokio::time::timeout(Duration::from_millis(2), connecting).await;
            let mut bytes = vec![0; 2_000];
            let (length, _) = socket.recv_from(&mut bytes).unwrap();
            bytes.truncate(length);
            packets.push(bytes);
        }
        packets
    })
}

#[test]
fn first_packets_that_may_be_forged_cost_no_state() {
    let _alone = alone();
    // As if none of these addresses were of this machine.
    let served = Served::new(limited(ArrivalLimits::default().with_retry_above(0)));
    let packets = first_packets(32);
    let mut answer = [0; 2_000];
    for (n, packet) in packets.iter().enumerate() {
        assert_eq!(packet.len(), 1_200, "RFC 9000 §14.1");
        let socket = UdpSocket::bind(format!("127.0.0.{}:0", n + 2)).expect("Linux has 127/8");
        socket.set_read_timeout(Some(PATIENCE)).unwrap();
        for _ in 0..10 {
            socket.send_to(packet, served.address).unwrap();
            let (length, _) = socket.recv_from(&mut answer).unwrap();
            // A Retry: long header, type 3 (RFC 9000 §17.2.5), a tenth of what was sent.
            assert_eq!(answer[0] & 0xf0, 0xf0);
            assert!(length < 200, "{length}");
        }
    }
    assert_eq!(served.handle.arrival_counts().retried, 320);
    assert_eq!(served.handle.open_connections(), (0, 0));
    assert_eq!(served.handle.remembered_addresses(), 0);
    assert_eq!(served.handle.with_world(|world| world.sessions()), 0);
    // Who really is there comes in all the same.
    runtime().block_on(async { drop(Peer::join(served.address).await) });
    assert!(served.handle.arrival_counts().retried > 320 && served.handle.arrival_counts().begun == 1);
}

#[test]
fn handshakes_from_many_addresses_are_held_to_their_limits() {
    let _alone = alone();
    let arrivals = ArrivalLimits::default()
        .with_handshakes_per_address(2.0, 3.0)
        .with_half_open(64, 64)
        .with_greeting(Duration::from_millis(700));
    let served = Served::new(limited(arrivals));
    let victim = Victim::join(served.address);
    let started = Instant::now();
    runtime().block_on(async {
        let endpoints: Vec<_> = (2..18).map(|n| endpoint(&format!("127.0.0.{n}"), false)).collect();
        let mut tries = Vec::new();
        for _ in 0..20 {
            for endpoint in &endpoints {
                let connecting = endpoint.connect(served.address, "eyeline").unwrap();
                tries.push(tokio::spawn(async { connecting.await.is_ok() }));
            }
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
        for one in tries {
            let _ = one.await;
        }
    });
    let seconds = started.elapsed().as_secs_f64();
    victim.assert_served("handshakes");
    let counts = served.handle.arrival_counts();
    let most = 1.0 + 16.0 * (3.0 + 2.0 * seconds);
    assert!((48..=most as u64).contains(&counts.begun), "{counts:?}, at most {most}");
    assert_eq!(counts.begun - 1 + counts.declined_in_all(), 320, "{counts:?}");
    assert!(counts.declined(Declined::AddressRate) > 200);
    served.until("their places are free again", |handle| handle.open_connections().0 == 0);
}

#[test]
fn who_never_says_hello_is_let_go_and_takes_places_of_its_own_address_only() {
    let _alone = alone();
    let arrivals = ArrivalLimits::default().with_half_open(100, 4).with_greeting(Duration::from_millis(800));
    let served = Served::new(limited(arrivals));
    runtime().block_on(async {
        let hostile = endpoint("127.0.0.2", false);
        let mut silent = Vec::new();
        for _ in 0..10 {
            silent.push(hostile.connect(served.address, "eyeline").unwrap().await);
        }
        let connected = silent.iter().filter(|connection| connection.is_ok()).count();
        assert_eq!(connected, 4);
        assert_eq!(served.handle.arrival_counts().declined(Declined::AddressHalfOpen), 6);
        // Others come in meanwhile.
        let _other = Peer::join(served.address).await;
        assert_eq!(served.handle.open_connections(), (4, 5));
    });
    served.until("they are let go", |handle| handle.open_connections().0 == 0);
    assert_eq!(served.handle.arrival_counts().never_in, 4);
}

fn get(watch: &Watch, target: &str) -> (u16, String) {
    ask(watch, format!("GET {target} HTTP/1.1\r\nHost: x\r\n\r\n").as_bytes())
}

fn ask(watch: &Watch, question: &[u8]) -> (u16, String) {
    let mut stream = TcpStream::connect(watch.local_addr()).unwrap();
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    stream.write_all(question).unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    let status = answer.split(' ').nth(1).and_then(|status| status.parse().ok()).unwrap_or(0);
    (status, answer.split_once("\r\n\r\n").map_or(String::new(), |(_, body)| body.to_owned()))
}

#[test]
fn a_server_is_watched_from_its_start_to_its_end() {
    let _alone = alone();
    let at = "127.0.0.1:0".parse().unwrap();
    let everywhere = Watch::start("0.0.0.0:0".parse().unwrap(), false);
    assert!(matches!(everywhere, Err(WatchError::Anywhere { .. })));
    let watch = Watch::start(at, false).unwrap();
    assert_eq!((get(&watch, "/healthz").0, get(&watch, "/readyz").0, get(&watch, "/metrics").0), (200, 503, 503));

    let mut served = Served::new(ShellConfig::default().with_drain(Duration::from_secs(1)));
    watch.attach(&served.handle);
    served.until("it serves", |handle| handle.stage() == Stage::Serving);
    assert_eq!(get(&watch, "/readyz"), (200, "ready\n".into()));
    let runtime = runtime();
    let mut peer = runtime.block_on(async {
        let mut peer = Peer::join(served.address).await;
        let bytes = peer.datagram((0..7).map(|object| request(object, Want::State)));
        peer.connection.send_datagram(bytes.into()).unwrap();
        let bytes = peer.datagram([request(9, Want::Bound)]);
        peer.connection.send_datagram(bytes.into()).unwrap();
        peer.connection.read_datagram().await.unwrap();
        peer
    });
    served.until("it has heard", |handle| handle.with_world(|world| world.stats().messages_in.requests() == 8));
    let (status, page) = get(&watch, "/metrics");
    assert_eq!(status, 200);
    let line =
        |start: &str| page.lines().find(|line| line.starts_with(start)).unwrap_or_else(|| panic!("{start}\n{page}"));
    assert_eq!(
        line("eyeline_messages_in_total{kind=\"request\",reason=\"exposed\"}"),
        "eyeline_messages_in_total{kind=\"request\",reason=\"exposed\"} 8"
    );
    assert_eq!(line("eyeline_sessions{state=\"watching\"}"), "eyeline_sessions{state=\"watching\"} 1.0");
    assert_eq!(
        line("eyeline_client_visible_objects_bucket{le=\"8.0\"}"),
        "eyeline_client_visible_objects_bucket{le=\"8.0\"} 1"
    );
    assert_eq!(line("eyeline_client_visible_objects_sum"), "eyeline_client_visible_objects_sum 7.0");
    assert_eq!(
        line("eyeline_client_hidden_objects_sum"),
        format!("eyeline_client_hidden_objects_sum {}.0", CHAIRS - 7)
    );
    assert_eq!(line("eyeline_client_visible_objects_bucket{le=\"+Inf\"}").split(' ').nth(1), Some("1"));
    assert_eq!(line("eyeline_limited_total{limit=\"requests\"}"), "eyeline_limited_total{limit=\"requests\"} 0");
    for family in ["tick_work_seconds_count", "tick_lateness_seconds_sum", "rtt_seconds_bucket", "packets_lost_total"] {
        line(&format!("eyeline_{family}"));
    }
    assert!(page.ends_with("# EOF\n"));

    assert_eq!((get(&watch, "/nothing").0, ask(&watch, b"POST /metrics HTTP/1.1\r\n\r\n").0), (404, 405));
    assert_eq!(ask(&watch, &[b'x'; 5_000]).0, 400);

    served.ask_to_end();
    served.until("it drains", |handle| handle.stage() != Stage::Serving);
    assert_eq!(get(&watch, "/readyz").0, 503);
    runtime.block_on(async {
        assert_eq!(peer.refusal().await, Some(Refusal::ShuttingDown));
    });
    served.wait();
    assert_eq!(get(&watch, "/healthz"), (200, "ok: ended\n".into()));
}

#[test]
fn a_server_that_ends_turns_away_who_comes_says_why_and_is_done_in_time() {
    let _alone = alone();
    let mut served = Served::new(ShellConfig::default().with_drain(Duration::from_millis(1_200)));
    let runtime = runtime();
    // One that is deaf: it reads nothing, so that its goodbye is waited for.
    let deaf = join_and_read_nothing(served.address);
    served.until("it is in", |handle| handle.with_world(|world| world.census().watching == 1));
    let asked = Instant::now();
    served.ask_to_end();
    served.until("it drains", |handle: &Handle| handle.stage() == Stage::Draining);
    runtime.block_on(async {
        let mut late = Peer::connect(served.address).await;
        late.say(&hello()).await;
        match late.hear().await {
            Some(ServerControl::Refused { refusal: Refusal::ShuttingDown, reason }) => {
                assert!(reason.contains("ends"), "{reason}");
            }
            other => panic!("{other:?}"),
        }
    });
    served.wait();
    let took = asked.elapsed();
    assert!(took < Duration::from_millis(1_200 + 500), "{took:?}");
    assert_eq!(served.handle.stage(), Stage::Ended);
    deaf.join().unwrap();
}
