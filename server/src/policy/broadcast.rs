//! `broadcast`: everybody is told everything. The baseline.

use eyeline_protocol::ObjectId;

use super::{Policy, Watcher};
use crate::world::{Object, present};

/// A client is told about every object, walls or no walls.
#[derive(Clone, Copy, Debug, Default)]
pub struct Broadcast;

impl Policy for Broadcast {
    fn name(&self) -> &'static str {
        "broadcast"
    }

    fn interest(&mut self, objects: &[Object], watcher: &Watcher, told: &mut Vec<ObjectId>) {
        told.extend(present(objects).map(|(id, _)| id).filter(|&id| Some(id) != watcher.avatar));
    }
}
