//! Interest policies: whom a client is told about. Each is one file; all share this trait, the wire, the tick and the
//! packing, so that they compare fairly.

mod broadcast;
mod cells;
mod grid;
#[cfg(test)]
mod made;
#[cfg(feature = "audit")]
mod oracle;
mod pvs;
mod radius;
mod settings;
#[cfg(feature = "audit")]
mod sight;
mod squares;
mod table;
mod visible;

use eyeline_protocol::{Class, Interest, ObjectId};
use glam::DVec3;

pub use broadcast::Broadcast;
pub use cells::{CellGrid, CellSet};
pub use grid::Grid;
#[cfg(feature = "audit")]
pub use oracle::{Oracle, Sight};
pub use pvs::Pvs;
pub use radius::Radius;
use settings::check;
pub use settings::{PolicyError, PolicySettings};
#[cfg(feature = "audit")]
pub use sight::{ExactSight, Meshes};
pub use table::{PvsError, PvsFacts, PvsTable};
pub use visible::Visible;

use crate::world::{Object, SessionId};

/// A client that looks at the world.
#[derive(Clone, Copy, Debug)]
pub struct Watcher {
    /// Its connection.
    pub session: SessionId,
    /// Its avatar, if it has one.
    pub avatar: Option<ObjectId>,
    /// Its eye, metres relative to the anchor: from its avatar's committed pose, or as it said itself.
    pub eye: DVec3,
    /// How it is turned about +Y, radians; 0 looks along −Z.
    pub yaw: f64,
    /// Which directions it wants to hear of.
    pub interest: Interest,
}

/// Decides whom each client is told about.
pub trait Policy: Send {
    /// Name on the command line and in reports.
    fn name(&self) -> &'static str;

    /// Whether clients decide by asking. Then [`Policy::interest`] is not called.
    fn tracking(&self) -> bool {
        false
    }

    /// The world begins, with objects of these kinds.
    fn start(&mut self, classes: &[Class]) {
        let _ = classes;
    }

    /// Whether there is an index over all objects, which [`Policy::begin_tick`] fills and all watchers share.
    fn has_index(&self) -> bool {
        false
    }

    /// Sets whether that index is filled from the next tick on. Without it each watcher has every object looked at, and
    /// is told the same.
    fn share(&mut self, shares: bool) {
        let _ = shares;
    }

    /// Bytes that it keeps, by the capacity of its lists.
    fn memory_bytes(&self) -> usize {
        0
    }

    /// A new state has been committed. [`Policy::interest`] is then called once for each watcher there is.
    fn begin_tick(&mut self, objects: &[Object]) {
        let _ = objects;
    }

    /// Appends to `told` the ids of the objects that `watcher` is told about, ascending, its own avatar left out.
    fn interest(&mut self, objects: &[Object], watcher: &Watcher, told: &mut Vec<ObjectId>);
}
