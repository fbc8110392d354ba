//! Issue 8's bar with things that move: what is drawn follows what is in sight, however many others a server has.

// It waits for a server.
#![expect(clippy::disallowed_methods)]

use std::f64::consts::FRAC_PI_2;
use std::time::{Duration, Instant};

use eyeline_client::app::Target;
use eyeline_client::net::ModelSource;
use eyeline_client::viewer::online::{Joined, Online, OnlineOptions};
use eyeline_client::viewer::picture::{FORMAT, Stage};
use eyeline_client::viewer::player::{Held, Player};
use eyeline_client::viewer::renderer::{DrawStats, Frame};
use eyeline_client::viewer::sight::CullerKind;
use eyeline_client::viewer::viewing::Viewing;
use eyeline_protocol::PlanSwitch;
use eyeline_server::spec::{ClassSpec, ObjectSpec, SpawnSpec, WorldSpec};
use eyeline_visibility::Resolution;

use crate::screen::PATIENCE;
use crate::served::Served;
use crate::{gpu_or_skip, made};

/// A world with a grating that somebody may push, in the west room, and `hidden` boxes behind the wall, which nobody there sees.
fn spec(hidden: usize) -> WorldSpec {
    let object = |name: String, class: &str, position: [f64; 3]| ObjectSpec {
        name,
        class: class.into(),
        node: None,
        position,
        heading: 0.0,
        takeable: true,
        path: None,
    };
    let class = |name: &str, radius, top| ClassSpec { name: name.into(), radius, bottom: 0.0, top, speed_max: 0.0 };
    let boxes = (0..hidden).map(|number| {
        let position = made::hidden_at(number, hidden).map(f64::from);
        object(format!("hidden {number}"), "box", position)
    });
    WorldSpec {
        spawns: vec![SpawnSpec { position: [-3.0, 0.0, -1.2], heading: -FRAC_PI_2 }],
        classes: vec![class("box", 0.1, 0.1), class("grating", 2.1, 1.0)],
        objects: boxes.chain([object("grating".into(), "grating", [0.0; 3])]).collect(),
        ..WorldSpec::default()
    }
}

/// What is drawn once the tracker holds so many things hidden.
fn drawn(gpu: &eyeline_client::viewer::gpu::Gpu, hidden: usize) -> DrawStats {
    let served = Served::start(made::two_rooms(hidden), spec(hidden));
    let folder = tempfile::tempdir().unwrap();
    let target = Target {
        connect: Some(served.address.to_string()),
        fingerprint: Some(served.fingerprint.parse().unwrap()),
        ca: None,
        server_name: None,
        server_file: None,
        token: None,
    };
    let source = ModelSource::Cache(folder.path().to_owned());
    let options = OnlineOptions {
        target,
        source,
        name: "Ben".into(),
        fly: None,
        frame_hz: 10.0,
        side: 64,
        plan: PlanSwitch::AUTO,
    };
    let Joined { online, model, welcome, eye, yaw } = Online::join(options).unwrap();
    let player = Player::new(eye, yaw, Viewing::body(&welcome));
    let mut viewing = Viewing::new(model, CullerKind::Masked, PlanSwitch::AUTO, player, Some((online, welcome)));
    let mut stage = Stage::new(gpu, viewing.model(), &viewing.bodies(), FORMAT).unwrap();
    let began = Instant::now();
    loop {
        let clocked = |work: &mut dyn FnMut()| {
            work();
            Duration::ZERO
        };
        let composed = viewing.frame(Held::default(), 0.02, Resolution::new(160, 90), 1.0, clocked);
        assert_eq!(viewing.ended(), None);
        if viewing.counts() == (1, hidden, 0) {
            let frame = Frame { view: composed.view, visible: &composed.visible, moving: &composed.moving };
            return stage.picture(gpu, &frame, &composed.overlay).unwrap().1;
        }
        assert!(began.elapsed() < 4 * PATIENCE, "{hidden}: {:?}", viewing.counts());
        std::thread::sleep(Duration::from_millis(100));
    }
}

#[test]
fn primitives_are_flat_while_hidden_objects_grow() {
    let Some(gpu) = gpu_or_skip("primitives_are_flat_while_hidden_objects_grow") else { return };
    let [few, some, many] = [100, 1_000, 10_000].map(|hidden| drawn(&gpu, hidden));
    assert_eq!((few, some), (some, many));
    // The grating alone, and the rooms.
    assert!(few.moving == 2 && few.primitives > 20, "{few:?}");
}
