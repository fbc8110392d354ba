//! Real processes over loopback QUIC: do server, swarm and replay work apart from each other, end as they should, and
//! say what is wrong in one line?

#![expect(clippy::disallowed_methods, clippy::disallowed_types, reason = "a test is a driver")]

mod hostile;

use std::io::{BufRead, BufReader, Read};
use std::net::{SocketAddr, UdpSocket};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::OnceLock;
use std::time::{Duration, Instant};

use eyeline_protocol::codec::{self, DatagramWriter};
use eyeline_protocol::{ClientControl, ClientHeader, Interest, Refusal, Role, ServerControl, VERSION};
use hostile::Peer;
use tempfile::TempDir;

const SIM: &str = env!("CARGO_BIN_EXE_eyeline-sim");

/// Two people, 4 s: one crosses the middle room, the other comes later and leaves earlier.
const TRACE: &str = "0 1 -2 0 -2 0 0 0\n50 1 0 0 -2 0 0 0\n100 1 2 0 -2 0 0 0\n10 2 2 0 2 0 0 0\n60 2 1 0 2 0 0 0\n";

/// A folder with a world of 3×3 rooms and a trace, made once.
fn files() -> &'static Path {
    static FILES: OnceLock<TempDir> = OnceLock::new();
    let folder = FILES.get_or_init(|| {
        let folder = TempDir::new().unwrap();
        let model = folder.path().join("rooms.glb");
        let made = sim(&["scene", "rooms", "--columns", "3", "--rows", "3", "--out", text(&model)]);
        assert!(made.status.success(), "{made:?}");
        assert!(String::from_utf8_lossy(&made.stdout).contains("9 rooms"), "{made:?}");
        std::fs::write(folder.path().join("trace.txt"), TRACE).unwrap();
        folder
    });
    folder.path()
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

fn command(args: &[&str]) -> Command {
    let mut command = Command::new(SIM);
    command.args(args).env_remove("RUST_LOG").stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    command
}

/// Runs the binary to its end.
fn sim(args: &[&str]) -> Output {
    command(args).output().unwrap()
}

/// What it says on standard error when it fails, which must be one line and exit code 1.
fn failure(args: &[&str]) -> String {
    let output = sim(args);
    let said = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{args:?}: {said}");
    assert!(said.starts_with("error: ") && said.lines().count() == 1, "{args:?}: {said}");
    said
}

/// A server process. Killed if the test fails.
struct Served {
    child: Child,
    ready: PathBuf,
    address: SocketAddr,
    fingerprint: String,
    said: String,
    _folder: TempDir,
}

impl Served {
    fn start(world: &[&str]) -> Served {
        let folder = TempDir::new().unwrap();
        let (ready, identity) = (folder.path().join("ready"), folder.path().join("identity"));
        let args = ["serve", "--listen", "127.0.0.1:0", "--seed", "7", "--ready-file", text(&ready)];
        let mut child = command(&args).args(["--identity", text(&identity)]).args(world).spawn().unwrap();
        let waiting = Instant::now();
        while !ready.exists() {
            let ended = child.try_wait().unwrap();
            assert!(ended.is_none() && waiting.elapsed() < Duration::from_secs(20), "no server: {ended:?}");
            std::thread::sleep(Duration::from_millis(10));
        }
        let written = std::fs::read_to_string(&ready).unwrap();
        let (address, fingerprint) = written.trim().split_once('\n').unwrap();
        // The lines of the beginning were all printed before the file was written.
        let mut said = String::new();
        let mut lines = BufReader::new(child.stdout.as_mut().unwrap()).lines();
        while !said.contains("fingerprint") {
            said += &(lines.next().unwrap().unwrap() + "\n");
        }
        let (address, fingerprint) = (address.parse().unwrap(), fingerprint.to_owned());
        Served { address, fingerprint, ready, said, child, _folder: folder }
    }

    fn rooms() -> Served {
        Served::start(&["--world", text(&files().join("rooms.glb"))])
    }

    fn file(&self) -> &str {
        text(&self.ready)
    }

    /// Sends it a signal, waits, and returns what it said last.
    fn end(mut self, signal: &str) -> String {
        let sent = Command::new("kill").args([signal, &self.child.id().to_string()]).status().unwrap();
        assert!(sent.success());
        let began = Instant::now();
        let status = self.child.wait().unwrap();
        assert!(began.elapsed() < Duration::from_secs(4), "it took {:?}", began.elapsed());
        let (mut said, mut errors) = (String::new(), String::new());
        self.child.stdout.take().unwrap().read_to_string(&mut said).unwrap();
        self.child.stderr.take().unwrap().read_to_string(&mut errors).unwrap();
        // That it drains is said, and nothing else.
        let worries: Vec<&str> = errors.lines().filter(|line| !line.contains(" INFO ")).collect();
        assert_eq!((status.code(), worries), (Some(0), vec![]), "{said}");
        assert!(!self.ready.exists(), "the ready file stays");
        said
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// The number before the first of these words.
fn number_before(said: &str, words: &str) -> u64 {
    let (before, _) = said.split_once(words).unwrap_or_else(|| panic!("'{words}' is not in: {said}"));
    let digits = before.rsplit(|c: char| !c.is_ascii_digit()).next().unwrap();
    digits.parse().unwrap_or_else(|_| panic!("no number before '{words}' in: {said}"))
}

#[test]
fn server_swarm_and_replay_are_three_processes() {
    let server = Served::rooms();
    assert!(server.said.contains("rooms 3×3 seed 7") && server.said.contains("36, of which 18 have a path"));
    assert!(server.said.contains(&server.fingerprint) && server.said.contains(&server.address.to_string()));
    let (world, trace) = (files().join("rooms.glb"), files().join("trace.txt"));
    let replay = command(&["replay", "--server-file", server.file(), "--trace", text(&trace), "--world", text(&world)])
        .args(["--seconds", "6"])
        .spawn()
        .unwrap();
    let swarm = [
        "swarm",
        "--late-ok",
        "--server-file",
        server.file(),
        "--world",
        text(&world),
        "--clients",
        "4",
        "--seconds",
        "3",
    ];
    let swarm = sim(&swarm);
    let said = String::from_utf8_lossy(&swarm.stdout);
    assert!(swarm.status.success(), "{swarm:?}");
    assert!(said.contains("4 people walk from room to room"), "{said}");
    for column in ["late_p99_ms", "hidden_mean", "rtt_ms"] {
        assert!(said.contains(column), "{said}");
    }

    // Once more with the world that the server sends, and the server named in words.
    let cache = TempDir::new().unwrap();
    let (address, fingerprint) = (server.address.to_string(), server.fingerprint.clone());
    let swarm =
        ["swarm", "--late-ok", "--connect", &address, "--fingerprint", &fingerprint, "--cache", text(cache.path())];
    let swarm = command(&swarm).args(["--clients", "2", "--seconds", "1"]).output().unwrap();
    assert!(swarm.status.success(), "{swarm:?}");
    assert!(String::from_utf8_lossy(&swarm.stdout).contains("2 people stand and look around"));
    let kept: Vec<_> = std::fs::read_dir(cache.path()).unwrap().map(|entry| entry.unwrap().path()).collect();
    assert_eq!(kept.len(), 1);
    assert_eq!(std::fs::read(&kept[0]).unwrap(), std::fs::read(&world).unwrap());

    let replay = replay.wait_with_output().unwrap();
    let said = String::from_utf8_lossy(&replay.stdout);
    assert!(replay.status.success(), "{replay:?}");
    assert!(number_before(&said, " messages out") > 50, "{said}");
    // Both come, the second leaves; at 4 s the first begins again, and the second comes again.
    assert_eq!(number_before(&said, " times somebody came or went"), 5, "{said}");

    let said = server.end("-INT");
    assert_eq!(number_before(&said, " clients admitted"), 7, "{said}");
    assert!(number_before(&said, " messages in") > 300 && number_before(&said, " out; ") > 300, "{said}");
    assert_eq!(number_before(&said, " datagrams; "), 0, "{said}");
}

#[test]
fn a_swarm_lives_on_through_delay_loss_and_a_second_of_darkness() {
    let server = Served::start(&["--rooms", "2x2"]);
    let to = server.address.to_string();
    let mut link = command(&["link", "--to", &to, "--delay", "20ms", "--jitter", "4ms", "--loss", "0.02"])
        .args(["--down-delay", "25ms", "--blackout", "3s+1s", "--duplicate", "0.01", "--rate", "20Mbit"])
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(link.stdout.as_mut().unwrap()).lines();
    let first = lines.next().unwrap().unwrap();
    let relay: SocketAddr = first.strip_prefix("listening ").unwrap_or_else(|| panic!("{first}")).parse().unwrap();
    let (relay, cache) = (relay.to_string(), TempDir::new().unwrap());
    let swarm =
        command(&["swarm", "--late-ok", "--connect", &relay, "--fingerprint", &server.fingerprint, "--clients", "3"])
            .args(["--seconds", "5", "--cache", text(cache.path())])
            .output()
            .unwrap();
    assert!(swarm.status.success(), "{swarm:?}");
    let said = String::from_utf8_lossy(&swarm.stdout).into_owned();
    assert!(said.contains("rtt_ms"), "{said}");
    // The last column of the one row, whose first is the number of clients.
    let row = said.lines().rfind(|line| line.trim_start().starts_with("3 ")).unwrap_or_else(|| panic!("{said}"));
    let rtt = row.split_whitespace().last().and_then(|cell| cell.parse::<f64>().ok());
    assert!(rtt.is_some_and(|rtt| (45.0..500.0).contains(&rtt)), "{said}");

    let sent = Command::new("kill").args(["-INT", &link.id().to_string()]).status().unwrap();
    assert!(sent.success());
    let link = link.wait_with_output().unwrap();
    let said = String::from_utf8_lossy(&link.stdout).into_owned();
    assert_eq!(link.status.code(), Some(0), "{link:?}");
    assert!(number_before(&said, " clients") == 2, "the first has a socket, and all others have one: {said}");
    assert!(number_before(&said, " lost") > 0 && number_before(&said, " in the dark") > 10, "{said}");
    server.end("-INT");
}

#[test]
fn a_server_that_ends_tells_its_clients() {
    let server = Served::start(&["--rooms", "2x1", "--policy", "broadcast"]);
    let cache = TempDir::new().unwrap();
    let mut swarm =
        command(&["swarm", "--late-ok", "--server-file", server.file(), "--clients", "2", "--seconds", "30"])
            .args(["--cache", text(cache.path())])
            .spawn()
            .unwrap();
    // Its first line comes when its first client is in.
    let mut line = String::new();
    BufReader::new(swarm.stdout.as_mut().unwrap()).read_line(&mut line).unwrap();
    assert!(line.contains("policy broadcast, 8 objects"), "{line}");
    server.end("-TERM");
    let swarm = swarm.wait_with_output().unwrap();
    let said = String::from_utf8_lossy(&swarm.stderr);
    assert_eq!(swarm.status.code(), Some(1), "{said}");
    assert!(said.contains("the server has ended"), "{said}");
}

#[test]
fn wrong_servers_and_ports_are_named() {
    let server = Served::rooms();
    let address = server.address.to_string();
    let wrong = "00".repeat(32);
    let said = failure(&["swarm", "--late-ok", "--connect", &address, "--fingerprint", &wrong, "--clients", "1"]);
    assert!(said.contains(&server.fingerprint) && said.contains(&wrong) && said.contains("pinned"), "{said}");

    let said = failure(&["serve", "--rooms", "1x1", "--listen", &address, "--identity", text(&files().join("taken"))]);
    assert!(said.contains(&address) && said.contains("--listen"), "{said}");

    // Bound and silent, so that nobody else answers there.
    let silent = UdpSocket::bind("127.0.0.1:0").unwrap();
    let nobody = silent.local_addr().unwrap().to_string();
    let said = failure(&["swarm", "--late-ok", "--connect", &nobody, "--fingerprint", &wrong, "--clients", "1"]);
    assert!(said.contains(&nobody) && said.contains("nothing answers"), "{said}");

    let other = files().join("other.glb");
    sim(&["scene", "rooms", "--columns", "1", "--rows", "1", "--out", text(&other)]);
    let said = failure(&["swarm", "--late-ok", "--server-file", server.file(), "--world", text(&other)]);
    assert!(said.contains("other.glb") && said.contains("rooms 3×3"), "{said}");
    server.end("-INT");
}

#[test]
fn bad_files_are_named() {
    let folder = TempDir::new().unwrap();
    let file = |name: &str, bytes: &[u8]| {
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        text(&path).to_owned()
    };
    let whole = std::fs::read(files().join("rooms.glb")).unwrap();
    let identity = text(&folder.path().join("identity")).to_owned();
    let serve = |world: &str| failure(&["serve", "--world", world, "--listen", "127.0.0.1:0", "--identity", &identity]);

    let said = serve(text(&folder.path().join("none.glb")));
    assert!(said.contains("none.glb") && said.matches("No such file").count() == 1, "{said}");
    assert!(serve(&file("cut.glb", &whole[..whole.len() / 2])).contains("cut.glb: broken .glb container"));
    assert!(serve(&file("text.glb", b"hello, world")).contains("text.glb: not glTF"));
    assert!(serve(&file("empty.glb", b"")).contains("empty.glb"));
    let model = file("odd.glb", &whole);
    file("odd.world.toml", b"[avatar]\nspeed = 3\n");
    let said = serve(&model);
    assert!(said.contains("odd.world.toml") && said.contains("line 2") && said.contains("speed"), "{said}");

    let wrong = "00".repeat(32);
    let replay = |trace: &str| {
        let target = ["replay", "--connect", "127.0.0.1:9", "--fingerprint", &wrong];
        failure(&[&target[..], &["--trace", trace, "--trace-origin", "0,0,0"]].concat())
    };
    let said = replay(&file("broken.txt", b"0 1 0 0 0 0 0 0\n5 1 0 zero 0 0 0 0\n"));
    assert!(said.contains("broken.txt:2:"), "{said}");
    assert!(replay(text(&folder.path().join("none.txt"))).contains("none.txt"));
}

#[test]
fn bad_numbers_are_usage_errors() {
    for (args, part) in [
        (&["serve", "--rooms", "3x3", "--tick-hz", "0"][..], "0.1 to 1000 Hz"),
        (&["serve", "--rooms", "3by3"], "10x10"),
        (&["serve", "--rooms", "3x3", "--policy", "all"], "all"),
        (&["serve"], "--world"),
        (&["swarm", "--clients", "3"], "--connect"),
        (&["swarm", "--late-ok", "--server-file", "x", "--clients", "0"], "1..=4096"),
        (&["swarm", "--late-ok", "--server-file", "x", "--seconds", "nan"], "0.1 to"),
        (&["swarm", "--late-ok", "--server-file", "x", "--sabotage", "all"], "drop-exposures"),
        (&["link", "--to", "127.0.0.1:9", "--delay", "25"], "25ms"),
        (&["link", "--to", "127.0.0.1:9", "--up-loss", "2"], "0 to 1"),
        (&["link", "--to", "127.0.0.1:9", "--rate", "0bit"], "2Mbit"),
        (&["link", "--to", "127.0.0.1:9", "--down-blackout", "1s"], "10s+500ms"),
        (&["link"], "--to"),
        (&["swarm", "--late-ok", "--connect", "localhost:1", "--fingerprint", "abc"], "64 hexadecimal digits"),
        (&["replay", "--server-file", "x", "--trace", "x", "--trace-origin", "1,2"], "three numbers"),
    ] {
        let output = sim(args);
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{args:?}: {said}");
        assert!(said.contains(part), "{args:?}: {said}");
    }
    for (args, part) in [
        (&["serve", "--rooms", "0x3"][..], "columns × rows = 0"),
        (&["scene", "rooms", "--wall", "9", "--out", "x.glb"], "wall = 9"),
        (&["scene", "rooms", "--out", "x.obj"], ".glb"),
    ] {
        assert!(failure(args).contains(part), "{args:?}");
    }
    for verb in [&["scene", "rooms"][..], &["scene"], &["serve"], &["swarm"], &["replay"], &["link"], &[]] {
        let output = sim(&[verb, &["--help"]].concat());
        assert!(output.status.success() && output.stdout.len() > 500, "{verb:?}");
    }
}

#[test]
fn hostile_peers_harm_nobody_but_themselves() {
    let server = Served::rooms();
    let swarm = command(&["swarm", "--late-ok", "--server-file", server.file(), "--clients", "2", "--seconds", "4"])
        .args(["--world", text(&files().join("rooms.glb"))])
        .spawn()
        .unwrap();
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(async {
        let hello = |version| {
            let (token, name) = (Vec::new(), "hostile".to_owned());
            let (resolution, interest, role) = ((320, 240), Interest::Around, Role::Avatar);
            codec::encode_control(&ClientControl::Hello {
                version,
                token,
                resolution,
                interest,
                role,
                name,
                resume: None,
            })
        };
        // Another version is refused, and told why.
        let mut peer = Peer::connect(server.address).await;
        peer.say(&hello(VERSION + 1)).await;
        match peer.hear().await {
            Some(ServerControl::Refused { refusal: Refusal::Version, reason }) => {
                assert!(reason.contains(&(VERSION + 1).to_string()) && reason.contains("update"), "{reason}");
            }
            other => panic!("{other:?}"),
        }
        peer.is_closed().await;

        // A message of garbage, a length beyond all limits, a message before hello: each is told and closed.
        let garbage = [&8u32.to_le_bytes()[..], &[0xff; 8]].concat();
        let endless = [0xff; 64];
        for bytes in [&garbage[..], &endless, &codec::encode_control(&ClientControl::WorldWanted)] {
            let mut peer = Peer::connect(server.address).await;
            peer.say(bytes).await;
            let heard = peer.hear().await;
            let told = matches!(heard, Some(ServerControl::Refused { refusal: Refusal::Protocol, .. }));
            assert!(told, "{heard:?}");
            peer.is_closed().await;
        }

        // Garbage datagrams: before hello, after it, cut off, with a bad end. They are counted, the connection stays.
        let mut peer = Peer::connect(server.address).await;
        peer.datagram(&[0xff; 40]).await;
        peer.say(&hello(VERSION)).await;
        assert!(matches!(peer.hear().await, Some(ServerControl::Welcome(_))));
        let header = DatagramWriter::new(&ClientHeader::default(), 1200).finish();
        for bytes in [&[][..], &[0xff; 1100], &header[..header.len() - 1], &[&header[..], &[9; 30]].concat()] {
            peer.datagram(bytes).await;
        }
        peer.say(&codec::encode_control(&ClientControl::Goodbye)).await;
        peer.is_closed().await;

        // Who never says hello is let go.
        let silent = Peer::connect(server.address).await;
        silent.is_closed().await;
    });
    let swarm = swarm.wait_with_output().unwrap();
    assert!(swarm.status.success(), "{swarm:?}");
    let said = server.end("-INT");
    assert_eq!(number_before(&said, " clients admitted"), 3, "{said}");
    assert_eq!(number_before(&said, " refused"), 1, "{said}");
    assert_eq!(number_before(&said, " control messages"), 3, "{said}");
    assert_eq!(number_before(&said, " datagrams"), 5, "{said}");
}
