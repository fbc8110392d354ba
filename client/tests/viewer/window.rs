//! The viewer as a person has it: a window on a virtual screen, keys pressed, and the picture that comes of it.
//!
//! Needs Xvfb and xdotool. Who walks does not arrive at the same place twice, but who walks against something does: so the walk ends
//! at a crate. A test may take 90 s, most of which is waiting on a busy machine.

use std::path::Path;
use std::process::Command;

use eyeline_visibility::CameraPath;

use crate::screen::{Screen, Session};
use crate::{golden, made};

/// A window onto the two rooms with so many boxes hidden, from the west room through the door; the model lies in the folder.
fn look_through_the_door(screen: Screen, folder: &Path, hidden: usize, options: impl FnOnce(&mut Command)) -> Session {
    let world = folder.join("rooms.glb");
    std::fs::write(&world, made::two_rooms(hidden)).unwrap();
    screen.view(folder, |view| {
        view.arg("--world").arg(&world).args(["--size", "320x200", "--eye=-3,1.6,0.5", "--look=4,1.2,0.5"]);
        options(view);
    })
}

#[test]
fn one_walks_through_a_door_and_sees_what_is_behind_the_wall() {
    const TEST: &str = "one_walks_through_a_door_and_sees_what_is_behind_the_wall";
    let Some(screen) = Screen::open(TEST) else { return };
    let folder = tempfile::tempdir().unwrap();
    let way = folder.path().join("way.json");
    let session = look_through_the_door(screen, folder.path(), 64, |view| {
        view.arg("--record").arg(&way);
    });
    let before = session.picture();
    golden::check("window-before", &before);
    session.xdotool(&["keydown", "shift", "keydown", "w"]);
    let last = session.until_still(&before);
    session.xdotool(&["keyup", "w", "keyup", "shift"]);
    golden::check("window-behind", &last);
    // Sizes of any kind, none included as far as a window can have none, are survived.
    for size in [["1", "1"], ["500", "90"], ["320", "200"]] {
        session.xdotool(&["windowsize", "--sync", &session.window, size[0], size[1]]);
    }
    let again = session.picture();
    assert_eq!(again.dimensions(), (320, 200));
    golden::check("window-behind", &again);
    // The way that was gone is kept, and can be filmed.
    session.xdotool(&["key", "Escape"]);
    let said = session.line();
    assert!(said.contains("way.json") && said.contains("cameras"), "{said}");
    let path = CameraPath::read(&way).unwrap();
    let (first, last) = (path.cameras[0], path.cameras[path.cameras.len() - 1]);
    assert_eq!(first.eye, [-3.0, 1.6, 0.5]);
    assert!(last.eye[0] > 1.0 && (last.eye[1] - 1.6).abs() < 1e-3 && path.cameras.len() > 30, "{last:?}");
}

/// Twice the pixels for each logical one: letters and insets are twice as large, and so is the picture.
#[test]
fn a_screen_of_twice_the_pixels_has_everything_twice_as_large() {
    const TEST: &str = "a_screen_of_twice_the_pixels_has_everything_twice_as_large";
    let Some(screen) = Screen::open(TEST) else { return };
    let folder = tempfile::tempdir().unwrap();
    let session = look_through_the_door(screen, folder.path(), 0, |view| {
        view.args(["--overlay", "inset"]).env("WINIT_X11_SCALE_FACTOR", "2");
    });
    let picture = session.picture();
    assert_eq!(picture.dimensions(), (640, 400));
    golden::check("window-hidpi", &picture);
}

/// Whoever stops it from the shell loses no more than whoever closes the window.
#[cfg(unix)]
#[test]
fn ctrl_c_ends_it_and_keeps_the_way_that_was_gone() {
    const TEST: &str = "ctrl_c_ends_it_and_keeps_the_way_that_was_gone";
    let Some(screen) = Screen::open(TEST) else { return };
    let folder = tempfile::tempdir().unwrap();
    let way = folder.path().join("way.json");
    let mut session = look_through_the_door(screen, folder.path(), 0, |view| {
        view.arg("--record").arg(&way);
    });
    session.picture();
    session.viewer.interrupt();
    assert!(session.line().contains("way.json"));
    assert_eq!(session.viewer.0.wait().unwrap().code(), Some(0));
    assert_eq!(CameraPath::read(&way).unwrap().cameras[0].eye, [-3.0, 1.6, 0.5]);
}
