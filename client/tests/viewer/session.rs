//! Two people in a world that a real server has: one of them walks, looks round a corner, and sees the other.
//!
//! Tolerance of the pictures: that of [`golden`]. The walk ends against a crate and the mouse turns by whole steps, so that place and
//! look are the same each time; the other stands where the server put them.

use std::f64::consts::FRAC_PI_2;

use eyeline_server::spec::{SpawnSpec, WorldSpec};

use crate::screen::{PATIENCE, Running, Screen, client};
use crate::served::Served;
use crate::{golden, made};

#[test]
fn one_looks_round_a_corner_and_sees_somebody_come_into_view() {
    const TEST: &str = "one_looks_round_a_corner_and_sees_somebody_come_into_view";
    let Some(screen) = Screen::open(TEST) else { return };
    let folder = tempfile::tempdir().unwrap();
    // Ada stands in the east room behind the wall; whoever comes next stands in the west room and looks through the door.
    let spawns = vec![
        SpawnSpec { position: [3.0, 0.0, -1.3], heading: 0.0 },
        SpawnSpec { position: [-3.0, 0.0, 0.5], heading: -FRAC_PI_2 },
    ];
    let served = Served::start(made::two_rooms(0), WorldSpec { spawns, ..WorldSpec::default() });
    let mut ada = client();
    ada.args(["headless", "--name", "Ada"]).args(served.options()).arg("--cache").arg(folder.path());
    let (_ada, lines) = Running::start(&mut ada).unwrap();
    assert!(lines.recv_timeout(PATIENCE).expect("Ada is in").starts_with("rooms.glb"));
    let session = screen.view(folder.path(), |view| {
        view.args(["--size", "480x300", "--name", "Ben"]).args(served.options()).arg("--cache").arg(folder.path());
    });
    let before = session.picture();
    golden::check("session-before", &before);
    session.xdotool(&["keydown", "w"]);
    let at_the_crate = session.until_still(&before);
    session.xdotool(&["keyup", "w"]);
    // A click takes the mouse; then it turns the head to the left. The screen's server doubles what it is told.
    session.xdotool(&["mousemove", "--window", &session.window, "240", "150", "click", "1"]);
    for _ in 0..4 {
        session.xdotool(&["mousemove_relative", "--", "-35", "0"]);
    }
    let found = session.until_still(&at_the_crate);
    golden::check("session-avatar", &found);
    // That it can fail: Ada and her name are more than the tolerance.
    assert!(golden::differing_share(&found, &at_the_crate) > 0.05);
}
