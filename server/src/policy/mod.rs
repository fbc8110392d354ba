//! Interest policies: whom a client is told about. Each is one file; all share this trait, the wire, the tick and the
//! packing, so that they compare fairly.

mod broadcast;
#[cfg(feature = "audit")]
mod oracle;
#[cfg(feature = "audit")]
mod sight;
mod visible;

use eyeline_protocol::{Interest, ObjectId};
use glam::DVec3;

pub use broadcast::Broadcast;
#[cfg(feature = "audit")]
pub use oracle::{Oracle, Sight};
#[cfg(feature = "audit")]
pub use sight::{ExactSight, Meshes};
pub use visible::Visible;

use crate::world::{Object, SessionId};

/// A client that looks at the world.
#[derive(Clone, Copy, Debug)]
pub struct Watcher {
    /// Its connection.
    pub session: SessionId,
    /// Its avatar.
    pub avatar: ObjectId,
    /// Its eye, metres relative to the anchor, from the committed pose.
    pub eye: DVec3,
    /// Turn of its avatar about +Y, radians, from the committed pose; 0 looks along −Z.
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

    /// A new state has been committed.
    fn begin_tick(&mut self, objects: &[Object]) {
        let _ = objects;
    }

    /// Appends to `told` the ids of the objects that `watcher` is told about, ascending, its own avatar left out.
    fn interest(&mut self, objects: &[Object], watcher: &Watcher, told: &mut Vec<ObjectId>);
}
