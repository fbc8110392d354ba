//! A virtual screen with a viewer's window on it, and hands on its keys and mouse: Xvfb and xdotool.

// It drives programs, and waits for them.
#![expect(clippy::disallowed_methods)]

use std::io::{BufRead as _, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

use crate::{golden, gpu_or_skip, skip};

/// For so long a program may say nothing that we wait for.
pub const PATIENCE: Duration = Duration::from_secs(30);

/// A program that ends with the test.
pub struct Running(pub Child);

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

impl Running {
    /// Starts a program; what it says comes line by line.
    pub fn start(command: &mut Command) -> std::io::Result<(Running, Receiver<String>)> {
        let mut child = command.stdout(Stdio::piped()).stdin(Stdio::null()).spawn()?;
        let out = child.stdout.take().expect("it is piped");
        let (lines, receiver) = channel();
        std::thread::spawn(move || {
            BufReader::new(out).lines().map_while(Result::ok).try_for_each(|line| lines.send(line))
        });
        Ok((Running(child), receiver))
    }

    /// Ctrl-C.
    #[cfg(unix)]
    #[track_caller]
    pub fn interrupt(&self) {
        let id = self.0.id().to_string();
        assert!(Command::new("kill").args(["-INT", &id]).status().unwrap().success());
    }
}

/// The client's program.
pub fn client() -> Command {
    Command::new(env!("CARGO_BIN_EXE_eyeline-client"))
}

/// Whether a program can be started at all.
fn exists(program: &str) -> bool {
    let version = Command::new(program).arg("-version").stdout(Stdio::null()).stderr(Stdio::null()).spawn();
    version.map(|child| drop(Running(child))).is_ok()
}

/// A screen without a window yet.
pub struct Screen {
    display: String,
    _screen: Running,
}

impl Screen {
    /// A screen of its own; `None` and a line about it if there is no such thing here.
    pub fn open(test: &str) -> Option<Screen> {
        gpu_or_skip(test)?;
        for program in ["Xvfb", "xdotool"] {
            if !exists(program) {
                let is_required = std::env::var_os("REQUIRE_GPU").is_some_and(|value| value == "1");
                assert!(!is_required, "{test} needs {program}");
                skip(test, &format!("{program} is not installed"));
                return None;
            }
        }
        // It chooses a free number itself and says which.
        let mut screen = Command::new("Xvfb");
        screen.args(["-displayfd", "1", "-screen", "0", "800x600x24", "-nolisten", "tcp"]).stderr(Stdio::null());
        let (screen, number) = Running::start(&mut screen).unwrap();
        let display = format!(":{}", number.recv_timeout(PATIENCE).expect("the screen's number"));
        Some(Screen { display, _screen: screen })
    }

    /// Opens a window with these options of `view`; its pictures go into a folder.
    pub fn view(self, pictures: &Path, options: impl FnOnce(&mut Command)) -> Session {
        let mut viewer = client();
        viewer.args(["view", "--software", "--seconds", "90"]).arg("--pictures").arg(pictures);
        options(&mut viewer);
        viewer.env("DISPLAY", &self.display).env_remove("WAYLAND_DISPLAY");
        let (viewer, lines) = Running::start(&mut viewer).unwrap();
        assert_eq!(lines.recv_timeout(PATIENCE).as_deref(), Ok("the window is open"));
        let mut session = Session { window: String::new(), lines, viewer, screen: self };
        session.window = session.xdotool(&["search", "--sync", "--name", "Eyeline"]);
        session.xdotool(&["windowfocus", "--sync", &session.window]);
        session
    }
}

/// A window that is open.
pub struct Session {
    pub window: String,
    pub viewer: Running,
    lines: Receiver<String>,
    screen: Screen,
}

impl Session {
    /// Runs xdotool on the screen and returns the first line of what it says.
    pub fn xdotool(&self, args: &[&str]) -> String {
        let out = Command::new("xdotool").args(args).env("DISPLAY", &self.screen.display).output().unwrap();
        assert!(out.status.success(), "xdotool {args:?}: {}", String::from_utf8_lossy(&out.stderr));
        String::from_utf8_lossy(&out.stdout).lines().next().unwrap_or_default().to_owned()
    }

    /// The next line of what the viewer says.
    #[track_caller]
    pub fn line(&self) -> String {
        self.lines.recv_timeout(PATIENCE).expect("a line")
    }

    /// Presses P and waits for the picture.
    #[track_caller]
    pub fn picture(&self) -> image::RgbaImage {
        self.xdotool(&["key", "p"]);
        let path = self.line();
        image::open(path).unwrap().into_rgba8()
    }

    /// Takes pictures until two are the same that differ from `before`, and returns the last. Who walks against something not quite
    /// straight slides along it, less than a pixel in the time between, and a name may jump by one.
    #[track_caller]
    pub fn until_still(&self, before: &image::RgbaImage) -> image::RgbaImage {
        let began = Instant::now();
        let mut last = self.picture();
        loop {
            std::thread::sleep(Duration::from_millis(400));
            let now = self.picture();
            // On a slow machine it may not have begun yet.
            if golden::differing_share(&now, &last) < 2.5e-3 && golden::differing_share(&now, before) > 0.05 {
                return now;
            }
            if began.elapsed() > Duration::from_secs(40) {
                let path = std::env::temp_dir().join("eyeline-never-still.png");
                let _ = now.save(&path);
                let [moved, from] = [&last, before].map(|other| 100.0 * golden::differing_share(&now, other));
                panic!("still {moved:.2} % change, {from:.2} % since the start; see {}", path.display());
            }
            last = now;
        }
    }
}
