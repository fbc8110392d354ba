use std::net::Ipv4Addr;

use super::*;
use crate::virtual_net::{Capacity, LinkRules};

/// A server that sends everything back, a relay before it, and what the relay did in the end.
async fn with_echo<T>(
    change: impl FnOnce(RelayConfig) -> RelayConfig,
    act: impl AsyncFnOnce(SocketAddr) -> T,
) -> (T, RelayStats) {
    let any = SocketAddr::from((Ipv4Addr::LOCALHOST, 0));
    let echo = UdpSocket::bind(any).await.unwrap();
    let relay = Relay::bind(change(RelayConfig::new(any, echo.local_addr().unwrap()))).unwrap();
    let address = relay.local_addr().unwrap();
    let (stop, stopped) = tokio::sync::oneshot::channel::<()>();
    let echoing = async {
        let mut buffer = [0; 2048];
        loop {
            let (size, from) = echo.recv_from(&mut buffer).await.unwrap();
            echo.send_to(&buffer[..size], from).await.unwrap();
        }
    };
    let acting = async {
        let done = act(address).await;
        let _ = stop.send(());
        done
    };
    let running = relay.run(async { stopped.await.unwrap_or(()) }, |_| ());
    tokio::select! {
        () = echoing => unreachable!("it has no end"),
        both = async { tokio::join!(acting, running) } => both,
    }
}

async fn client(relay: SocketAddr) -> UdpSocket {
    let socket = UdpSocket::bind(SocketAddr::from((Ipv4Addr::LOCALHOST, 0))).await.unwrap();
    socket.connect(relay).await.unwrap();
    socket
}

/// What comes back within `patience` of the last thing that did.
async fn heard(socket: &UdpSocket, patience: Duration) -> Vec<Vec<u8>> {
    let mut heard = Vec::new();
    let mut buffer = [0; 2048];
    while let Ok(size) = tokio::time::timeout(patience, socket.recv(&mut buffer)).await {
        heard.push(buffer[..size.unwrap()].to_vec());
    }
    heard
}

const LONG: Duration = Duration::from_millis(300);

fn block_on<T>(future: impl Future<Output = T>) -> T {
    tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap().block_on(future)
}

#[test]
fn answers_come_back_to_who_asked_and_never_before_both_delays() {
    let delay = Duration::from_millis(30);
    let link = LinkRules::default().with_delay(delay);
    let ((), stats) = block_on(with_echo(
        |config| config.with_link(link),
        async |relay| {
            let (one, other) = (client(relay).await, client(relay).await);
            let began = Instant::now();
            one.send(b"one").await.unwrap();
            other.send(b"other").await.unwrap();
            let mut buffer = [0; 9];
            let size = one.recv(&mut buffer).await.unwrap();
            assert!(began.elapsed() >= 2 * delay);
            assert_eq!(&buffer[..size], b"one");
            assert_eq!(heard(&other, LONG).await, [b"other"]);
        },
    ));
    assert_eq!((stats.clients_ever, stats.up.sent, stats.down.sent, stats.down.sent_bytes), (2, 2, 2, 8));
    assert_eq!(stats.queued_bytes, 0);
}

#[test]
fn what_is_lost_doubled_or_in_the_dark_is_counted() {
    let link = LinkRules::default().with_loss(1.0);
    let ((), stats) = block_on(with_echo(
        |config| RelayConfig { up: link, ..config },
        async |relay| {
            let one = client(relay).await;
            one.send(b"lost").await.unwrap();
            assert!(heard(&one, LONG).await.is_empty());
        },
    ));
    assert_eq!((stats.up.received, stats.up.link.lost, stats.up.sent, stats.down.received), (1, 1, 0, 0));

    let (dark, rules) = (Duration::from_millis(500), LinkRules::default().with_duplicate(1.0));
    let capacity = Capacity::default().with_blackout(Duration::ZERO, dark);
    let ((), stats) = block_on(with_echo(
        |config| RelayConfig { down: rules, up_capacity: capacity, ..config },
        async |relay| {
            let one = client(relay).await;
            one.send(b"dark").await.unwrap();
            assert!(heard(&one, dark).await.is_empty());
            one.send(b"light").await.unwrap();
            assert_eq!(heard(&one, LONG).await, [b"light", b"light"]);
        },
    ));
    assert_eq!((stats.up.link.dark, stats.up.sent), (1, 1));
    assert_eq!((stats.down.link.twice, stats.down.received, stats.down.sent), (1, 1, 2));
}

#[test]
fn clients_are_limited_and_the_silent_let_go() {
    let ((), stats) = block_on(with_echo(
        |config| config.with_clients_max(1).with_idle(Duration::from_millis(200)),
        async |relay| {
            let (one, other) = (client(relay).await, client(relay).await);
            one.send(b"one").await.unwrap();
            other.send(b"other").await.unwrap();
            assert_eq!((heard(&one, LONG).await.len(), heard(&other, LONG).await.len()), (1, 0));
            // Silence is looked for once a second.
            tokio::time::sleep(Duration::from_millis(900)).await;
            other.send(b"again").await.unwrap();
            assert_eq!(heard(&other, LONG).await, [b"again"]);
        },
    ));
    assert_eq!((stats.refused, stats.idled, stats.clients, stats.clients_ever), (1, 1, 1, 2));
}

#[test]
fn a_relay_to_itself_or_on_a_taken_port_is_refused() {
    block_on(async {
        let taken = UdpSocket::bind(SocketAddr::from((Ipv4Addr::LOCALHOST, 0))).await.unwrap();
        let address = taken.local_addr().unwrap();
        let to = SocketAddr::from((Ipv4Addr::LOCALHOST, 9));
        let said = Relay::bind(RelayConfig::new(address, to)).map(|_| ()).unwrap_err().to_string();
        assert!(said.contains(&address.to_string()) && said.contains("--listen"), "{said}");
        let said = Relay::bind(RelayConfig::new(to, to)).map(|_| ()).unwrap_err().to_string();
        assert!(said.contains("itself"), "{said}");
    });
}
