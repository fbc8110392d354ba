//! The command as a process: how it is watched, and how it ends.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::path::Path;
use std::process::{Child, ChildStdout, Command, Stdio};
use std::time::{Duration, Instant};

use tempfile::TempDir;

use super::peer::{PATIENCE, join_and_read_nothing};

/// A triangle to stand on, as a .gltf with its buffer beside it.
fn model(folder: &Path) -> String {
    let corners: [[f32; 3]; 3] = [[-9.0, 0.0, -9.0], [0.0, 0.0, 9.0], [9.0, 0.0, -9.0]];
    let bytes: Vec<u8> = corners.iter().flatten().flat_map(|x| x.to_le_bytes()).collect();
    std::fs::write(folder.join("floor.bin"), bytes).unwrap();
    let text = r#"{"asset":{"version":"2.0"},"scene":0,"scenes":[{"nodes":[0]}],"nodes":[{"mesh":0}],
        "meshes":[{"primitives":[{"attributes":{"POSITION":0}}]}],
        "accessors":[{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3","min":[-9,0,-9],"max":[9,0,9]}],
        "bufferViews":[{"buffer":0,"byteLength":36}],"buffers":[{"byteLength":36,"uri":"floor.bin"}]}"#;
    let path = folder.join("floor.gltf");
    std::fs::write(&path, text).unwrap();
    path.to_str().unwrap().to_owned()
}

struct Running {
    child: Child,
    stdout: BufReader<ChildStdout>,
    address: SocketAddr,
    watched: Option<SocketAddr>,
    folder: TempDir,
}

fn command(folder: &Path, options: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_eyeline-server"));
    let identity = folder.join("identity");
    command.args(["--world", &model(folder), "--listen", "127.0.0.1:0", "--identity", identity.to_str().unwrap()]);
    command.args(["--ready-file", folder.join("ready").to_str().unwrap()]).args(options);
    command.current_dir(folder).env_remove("RUST_LOG");
    command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    command
}

impl Running {
    fn start(options: &[&str]) -> Running {
        let folder = TempDir::new().unwrap();
        let mut child = command(folder.path(), options).spawn().unwrap();
        let mut stdout = BufReader::new(child.stdout.take().unwrap());
        let (mut address, mut watched) = (None, None);
        let mut line = String::new();
        while stdout.read_line(&mut line).unwrap() > 0 {
            let mut words = line.split_whitespace();
            match (words.next(), words.next()) {
                (Some("listening"), Some(at)) => address = at.parse().ok(),
                (Some("watched"), Some(at)) => {
                    watched = at.trim_start_matches("http://").split('/').next().and_then(|at| at.parse().ok());
                }
                _ => {}
            }
            // The last of the lines that it begins with.
            let is_last = line.starts_with("fingerprint") && !options.contains(&"--metrics") || watched.is_some();
            line.clear();
            if is_last {
                break;
            }
        }
        Running { child, stdout, address: address.expect("it listens"), watched, folder }
    }

    fn signal(&self, name: &str) {
        let sent = Command::new("kill").args([name, &self.child.id().to_string()]).status().unwrap();
        assert!(sent.success());
    }

    /// Its exit code, what it said at the end, its log, and how long it took.
    fn end(mut self) -> (Option<i32>, String, String, Duration) {
        let started = Instant::now();
        let status = loop {
            if let Some(status) = self.child.try_wait().unwrap() {
                break status;
            }
            if started.elapsed() > PATIENCE {
                self.child.kill().unwrap();
                panic!("it does not end");
            }
            std::thread::sleep(Duration::from_millis(5));
        };
        let took = started.elapsed();
        let (mut said, mut log) = (String::new(), String::new());
        self.stdout.read_to_string(&mut said).unwrap();
        self.child.stderr.take().unwrap().read_to_string(&mut log).unwrap();
        assert!(!self.folder.path().join("ready").exists(), "its ready file is still there");
        (status.code(), said, log, took)
    }

    fn get(&self, target: &str) -> String {
        let mut stream = TcpStream::connect(self.watched.expect("it is watched")).unwrap();
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        write!(stream, "GET {target} HTTP/1.1\r\n\r\n").unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).unwrap();
        answer
    }
}

#[test]
fn sigterm_drains_and_ends_well_in_the_stated_time() {
    let _alone = super::alone();
    let server = Running::start(&["--metrics", "127.0.0.1:0", "--log", "json", "--drain-seconds", "0.5"]);
    let started = Instant::now();
    while !server.get("/readyz").starts_with("HTTP/1.1 200 ") {
        assert!(started.elapsed() < PATIENCE, "{}", server.get("/readyz"));
    }
    assert!(server.get("/metrics").contains("\neyeline_ticks_total "));
    // One that does not read its goodbye is waited for as long as was said, and no longer.
    let deaf = join_and_read_nothing(server.address);
    while !server.get("/metrics").contains("eyeline_sessions{state=\"watching\"} 1.0") {
        std::thread::sleep(Duration::from_millis(110));
    }
    server.signal("-TERM");
    let (code, said, log, took) = server.end();
    assert_eq!(code, Some(0), "{said}{log}");
    assert!(said.contains("1 clients admitted"), "{said}");
    assert!(took < Duration::from_millis(500 + 1_000), "{took:?}");
    assert!(log.contains("draining") && log.lines().all(|line| line.starts_with('{') && line.ends_with('}')), "{log}");
    deaf.join().unwrap();
}

#[test]
fn a_second_ctrl_c_does_not_wait() {
    let _alone = super::alone();
    let server = Running::start(&["--drain-seconds", "60"]);
    let deaf = join_and_read_nothing(server.address);
    std::thread::sleep(Duration::from_millis(300));
    server.signal("-INT");
    std::thread::sleep(Duration::from_millis(200));
    server.signal("-INT");
    let (code, _, log, took) = server.end();
    assert_eq!(code, Some(130), "{log}");
    assert!(took < Duration::from_secs(2), "{took:?}");
    assert!(log.contains("ending at once"), "{log}");
    drop(deaf);
}

#[test]
fn metrics_for_everybody_are_refused_unless_they_are_wanted() {
    let folder = TempDir::new().unwrap();
    let output = command(folder.path(), &["--metrics", "0.0.0.0:0"]).output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{said}");
    assert!(said.lines().count() == 1 && said.contains("--metrics-anywhere"), "{said}");
}
