//! `visible`: ours. Clients hold bounds of what is hidden from them and ask when one is exposed or expires.

use eyeline_protocol::ObjectId;

use super::{Policy, Watcher};
use crate::world::Object;

/// A client is told about what it asks for, and asks only for what it could see.
#[derive(Clone, Copy, Debug, Default)]
pub struct Visible;

impl Policy for Visible {
    fn name(&self) -> &'static str {
        "visible"
    }

    fn tracking(&self) -> bool {
        true
    }

    fn interest(&mut self, _: &[Object], _: &Watcher, _: &mut Vec<ObjectId>) {}
}
