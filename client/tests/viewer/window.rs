//! The viewer as a person has it: a window on a virtual screen, keys pressed, and the picture that comes of it.
//!
//! Needs Xvfb and xdotool. Who walks does not arrive at the same place twice, but who walks against something does: so the walk ends
//! at a crate. The whole test may take 90 s, most of which is waiting on a busy machine.

// It drives programs, and waits for them.
#![expect(clippy::disallowed_methods)]

use std::io::{BufRead as _, BufReader};
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

use crate::{golden, gpu_or_skip, made, skip};

/// For so long a program may say nothing that we wait for.
const PATIENCE: Duration = Duration::from_secs(30);

/// A program that ends with the test.
struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

impl Running {
    /// Starts a program; what it says comes line by line.
    fn start(command: &mut Command) -> std::io::Result<(Running, Receiver<String>)> {
        let mut child = command.stdout(Stdio::piped()).stdin(Stdio::null()).spawn()?;
        let out = child.stdout.take().expect("it is piped");
        let (lines, receiver) = channel();
        std::thread::spawn(move || {
            BufReader::new(out).lines().map_while(Result::ok).try_for_each(|line| lines.send(line))
        });
        Ok((Running(child), receiver))
    }
}

/// Whether a program can be started at all.
fn exists(program: &str) -> bool {
    let version = Command::new(program).arg("-version").stdout(Stdio::null()).stderr(Stdio::null()).spawn();
    version.map(|child| drop(Running(child))).is_ok()
}

struct Session {
    folder: PathBuf,
    display: String,
    window: String,
    lines: Receiver<String>,
    _viewer: Running,
    _screen: Running,
}

impl Drop for Session {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.folder);
    }
}

impl Session {
    /// Opens a window on a screen of its own; `None` and a line about it if there is no such thing here.
    fn open(test: &str, options: &[&str]) -> Option<Session> {
        gpu_or_skip(test)?;
        for program in ["Xvfb", "xdotool"] {
            if !exists(program) {
                let is_required = std::env::var_os("REQUIRE_GPU").is_some_and(|value| value == "1");
                assert!(!is_required, "{test} needs {program}");
                skip(test, &format!("{program} is not installed"));
                return None;
            }
        }
        let folder = std::env::temp_dir().join(format!("eyeline-window-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let world = folder.join("rooms.glb");
        std::fs::write(&world, made::two_rooms(64)).unwrap();
        // It chooses a free number itself and says which.
        let mut screen = Command::new("Xvfb");
        screen.args(["-displayfd", "1", "-screen", "0", "640x480x24", "-nolisten", "tcp"]).stderr(Stdio::null());
        let (screen, number) = Running::start(&mut screen).unwrap();
        let display = format!(":{}", number.recv_timeout(PATIENCE).expect("the screen's number"));
        let mut viewer = Command::new(env!("CARGO_BIN_EXE_eyeline-client"));
        viewer.args(["view", "--software", "--size", "320x200", "--seconds", "90"]).args(options);
        viewer.arg("--world").arg(&world).arg("--pictures").arg(&folder);
        viewer.env("DISPLAY", &display).env_remove("WAYLAND_DISPLAY");
        let (viewer, lines) = Running::start(&mut viewer).unwrap();
        assert_eq!(lines.recv_timeout(PATIENCE).as_deref(), Ok("the window is open"));
        let mut session = Session { folder, display, window: String::new(), lines, _viewer: viewer, _screen: screen };
        session.window = session.xdotool(&["search", "--sync", "--name", "Eyeline"]);
        session.xdotool(&["windowfocus", "--sync", &session.window]);
        Some(session)
    }

    fn xdotool(&self, args: &[&str]) -> String {
        let out = Command::new("xdotool").args(args).env("DISPLAY", &self.display).output().unwrap();
        assert!(out.status.success(), "xdotool {args:?}: {}", String::from_utf8_lossy(&out.stderr));
        String::from_utf8_lossy(&out.stdout).lines().next().unwrap_or_default().to_owned()
    }

    /// Presses P and waits for the picture.
    fn picture(&self) -> image::RgbaImage {
        self.xdotool(&["key", "p"]);
        let path = self.lines.recv_timeout(PATIENCE).expect("a picture");
        image::open(path).unwrap().into_rgba8()
    }
}

#[test]
fn one_walks_through_a_door_and_sees_what_is_behind_the_wall() {
    const TEST: &str = "one_walks_through_a_door_and_sees_what_is_behind_the_wall";
    let options = ["--eye=-3,1.6,0.5", "--look=4,1.2,0.5"];
    let Some(session) = Session::open(TEST, &options) else { return };
    let began = Instant::now();
    let before = session.picture();
    golden::check("window-before", &before);
    session.xdotool(&["keydown", "shift", "keydown", "w"]);
    // Until the picture does not change any more: a crate is in the way.
    let mut last = session.picture();
    loop {
        std::thread::sleep(Duration::from_millis(500));
        let now = session.picture();
        // On a slow machine it may not have begun yet.
        if now == last && golden::differing_share(&now, &before) > 0.05 {
            break;
        }
        assert!(began.elapsed() < Duration::from_secs(60), "one walks for ever");
        last = now;
    }
    session.xdotool(&["keyup", "w", "keyup", "shift"]);
    golden::check("window-behind", &last);
    // Sizes of any kind, none included as far as a window can have none, are survived.
    for size in [["1", "1"], ["500", "90"], ["320", "200"]] {
        session.xdotool(&["windowsize", "--sync", &session.window, size[0], size[1]]);
    }
    let again = session.picture();
    assert_eq!(again.dimensions(), (320, 200));
    golden::check("window-behind", &again);
}
