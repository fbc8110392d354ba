//! `oracle`: a client is told exactly what it sees, as only a server with triangles can know. The lower limit.

use eyeline_protocol::ObjectId;
use glam::DVec3;

use super::{Policy, Watcher};
use crate::world::Object;

/// Knows what can be seen from a point, all round. A server with triangles has one; so has the simulator.
pub trait Sight: Send {
    /// A new state has been committed.
    fn begin_tick(&mut self, objects: &[Object]);

    /// Appends the ids of the present objects that own a pixel in a view from `eye` in any direction, ascending;
    /// `own`, if there is one, is left out and hides nothing.
    fn visible_from(&mut self, objects: &[Object], eye: DVec3, own: Option<ObjectId>, visible: &mut Vec<ObjectId>);
}

/// A client is told about what owns a pixel.
pub struct Oracle {
    sight: Box<dyn Sight>,
}

impl Oracle {
    /// An oracle that sees through `sight`.
    pub fn new(sight: Box<dyn Sight>) -> Oracle {
        Oracle { sight }
    }
}

impl Policy for Oracle {
    fn name(&self) -> &'static str {
        "oracle"
    }

    fn begin_tick(&mut self, objects: &[Object]) {
        self.sight.begin_tick(objects);
    }

    fn interest(&mut self, objects: &[Object], watcher: &Watcher, told: &mut Vec<ObjectId>) {
        self.sight.visible_from(objects, watcher.eye, watcher.avatar, told);
    }
}
