//! `film` as a program: frames, what is said, and how it ends.

// It drives programs, and waits for them.
#![expect(clippy::disallowed_methods)]

use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

use eyeline_visibility::{Camera, CameraPath};
use tempfile::TempDir;

use crate::screen::{PATIENCE, Running, client};
use crate::{gpu_or_skip, made};

/// A folder with a world and a path of so many cameras, ten a second, through its door.
fn folder(cameras: u32) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("rooms.glb"), made::two_rooms(8)).unwrap();
    let camera = |number: u32| {
        let eye = [-3.0 + 4.0 * f64::from(number) / f64::from(cameras), 1.6, 0.5];
        Camera { eye, yaw_degrees: -90.0, pitch_degrees: 0.0 }
    };
    let path = CameraPath { hz: Some(10.0), ..CameraPath::new((0..cameras).map(camera).collect()) };
    path.write(&folder.path().join("way.json")).unwrap();
    folder
}

fn command(verb: &str, folder: &Path, options: &[&str]) -> Command {
    let mut command = client();
    command.current_dir(folder).args([verb, "--software", "--world", "rooms.glb", "--size", "96x60"]).args(options);
    command
}

fn film(folder: &Path, options: &[&str]) -> Output {
    let mut film = command("film", folder, &["--path", "way.json", "--out", "frames"]);
    film.args(options).output().unwrap()
}

fn frames(folder: &Path) -> Vec<String> {
    let Ok(entries) = std::fs::read_dir(folder.join("frames")) else { return Vec::new() };
    let mut names: Vec<_> = entries.map(|entry| entry.unwrap().file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    names
}

#[test]
fn a_path_becomes_numbered_frames_which_are_those_of_shot() {
    if gpu_or_skip("a_path_becomes_numbered_frames_which_are_those_of_shot").is_none() {
        return;
    }
    let folder = folder(9);
    // Cameras 2 to 6 are 0.4 s: three frames of five a second, the last of camera 6.
    let filmed = film(folder.path(), &["--from", "2", "--to", "6", "--fps", "5", "--overlay", "inset,front"]);
    assert!(filmed.status.success(), "{}", String::from_utf8_lossy(&filmed.stderr));
    assert!(String::from_utf8_lossy(&filmed.stdout).contains("3 frames for 5 a second"));
    assert_eq!(frames(folder.path()), ["frame-00000.png", "frame-00001.png", "frame-00002.png"]);
    let eye = -3.0 + 4.0 * 6.0 / 9.0;
    let (eye, look) = (format!("--eye={eye},1.6,0.5"), "--look=9,1.6,0.5");
    let shot = command("shot", folder.path(), &[&eye, look, "--overlay", "inset,front", "--out", "shot.png"]).output();
    assert!(shot.unwrap().status.success());
    let picture = |name: &str| image::open(folder.path().join(name)).unwrap().into_rgba8();
    let (frame, shot) = (picture("frames/frame-00002.png"), picture("shot.png"));
    // The near planes differ, and the last bits of the eye.
    assert!(crate::golden::differing_share(&frame, &shot) < 0.005);
    assert!(crate::golden::differing_share(&picture("frames/frame-00000.png"), &shot) > 0.05);
    // Every fourth camera of all.
    let again = film(folder.path(), &["--every", "4", "--overwrite"]);
    assert!(again.status.success() && frames(folder.path()).len() == 3);
}

#[test]
fn what_is_wrong_is_named() {
    if gpu_or_skip("what_is_wrong_is_named").is_none() {
        return;
    }
    let folder = folder(4);
    let wrong = |options: &[&str], words: &[&str]| {
        let said = film(folder.path(), options);
        let text = String::from_utf8_lossy(&said.stderr).into_owned();
        assert!(!said.status.success(), "{options:?}");
        words.iter().for_each(|word| assert!(text.contains(word), "{text:?} does not say {word:?}"));
    };
    wrong(&["--to", "4"], &["--to 4", "way.json", "0 to 3"]);
    wrong(&["--from", "3", "--to", "2"], &["--from 3"]);
    wrong(&["--every", "0"], &["--every"]);
    wrong(&["--every", "2", "--fps", "5"], &["--fps"]);
    wrong(&["--fps", "0"], &["240"]);
    // A picture has no connection and no past: said by name, before anything is drawn.
    wrong(&["--overlay", "inset,hidden"], &["--overlay hidden", "view --connect"]);
    wrong(&["--overlay", "charts"], &["--overlay charts", "view --connect"]);
    wrong(&["--avatar", "nobody.glb"], &["nobody.glb"]);
    wrong(&["--avatar", "way.json"], &["way.json"]);
    std::fs::write(folder.path().join("way.json"), "{\"cameras\": []}").unwrap();
    wrong(&[], &["way.json", "0 entries"]);
    std::fs::remove_file(folder.path().join("way.json")).unwrap();
    wrong(&[], &["way.json", "cannot read"]);
    assert_eq!(frames(folder.path()), [""; 0]);
}

#[cfg(unix)]
#[test]
fn ctrl_c_ends_a_film_between_two_frames() {
    if gpu_or_skip("ctrl_c_ends_a_film_between_two_frames").is_none() {
        return;
    }
    let folder = folder(100_000);
    let mut film = command("film", folder.path(), &["--path", "way.json", "--out", "frames"]);
    let mut running = Running(film.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap());
    let began = Instant::now();
    while frames(folder.path()).len() < 3 {
        assert!(began.elapsed() < PATIENCE, "no frames");
        std::thread::sleep(Duration::from_millis(20));
    }
    running.interrupt();
    let ended = running.0.wait().unwrap();
    let mut said = String::new();
    std::io::Read::read_to_string(&mut running.0.stderr.take().unwrap(), &mut said).unwrap();
    assert_eq!(ended.code(), Some(1), "{said}");
    assert!(said.contains("stopped after") && said.contains("100000 frames"), "{said}");
    let names = frames(folder.path());
    assert!(names.len() < 50_000 && names.iter().all(|name| name.starts_with("frame-")), "{names:?}");
    let last = folder.path().join("frames").join(names.last().unwrap());
    assert_eq!(image::open(last).unwrap().into_rgba8().dimensions(), (96, 60));
}
