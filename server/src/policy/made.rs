//! Objects and watchers for tests of policies.

use eyeline_protocol::{Interest, ObjectId, WorldInfo, WorldTime};
use glam::DVec3;

use super::{Visible, Watcher};
use crate::spec::{ClassSpec, ObjectSpec, WorldSpec};
use crate::world::{SessionId, World, WorldConfig};

/// A world of cylinders of class 1 at these places, 0.5 m in radius and 1 m high.
pub(super) fn world(places: &[[f64; 3]]) -> World {
    let class = ClassSpec { name: "post".into(), radius: 0.5, bottom: 0.0, top: 1.0, speed_max: 1.0 };
    let object = |(index, position): (usize, &[f64; 3])| ObjectSpec {
        name: format!("post {index}"),
        class: "post".into(),
        node: None,
        position: *position,
        heading: 0.0,
        takeable: false,
        path: None,
    };
    let objects = places.iter().enumerate().map(object).collect();
    let spec = WorldSpec { classes: vec![class], objects, ..WorldSpec::default() };
    let info = WorldInfo { name: "posts".into(), hash: [7; 32], size_bytes: 0, two_sided: false };
    World::new(WorldConfig::default(), spec, info, DVec3::ZERO, Box::new(Visible), WorldTime::ZERO).unwrap()
}

/// A client with this avatar and eye.
pub(super) fn watcher(session: u32, avatar: u32, eye: DVec3) -> Watcher {
    Watcher { session: SessionId(session), avatar: Some(ObjectId(avatar)), eye, yaw: 0.0, interest: Interest::Around }
}
