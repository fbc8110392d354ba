//! How large is something, or an error, to one client? What dead reckoning and the byte cap weigh by.

use eyeline_protocol::{Class, Prediction, WorldTime, pixels};
use glam::DVec3;

use super::Object;

/// A client's committed eye, and how fine its picture is.
#[derive(Clone, Copy)]
pub(super) struct Lens<'a> {
    /// Metres, relative to the anchor.
    pub eye: DVec3,
    /// Pixels a unit of tangent.
    pub focal: f64,
    pub classes: &'a [Class],
}

/// Pixels a unit of tangent in a picture of so many columns and 90° across.
pub(super) fn focal(columns: u16) -> f64 {
    0.5 * f64::from(columns.max(1))
}

impl Lens<'_> {
    fn radius(&self, object: &Object) -> f64 {
        self.classes[usize::from(object.class.0)].extent.radius
    }

    /// By how many pixels `held` is wrong about `object` at `tick`.
    pub fn error_px(&self, held: &Prediction, object: &Object, tick: WorldTime) -> f64 {
        held.error_px(tick, object.position, object.orientation, self.radius(object), self.eye, self.focal)
    }

    /// How many pixels `object` is across.
    pub fn size_px(&self, object: &Object) -> f64 {
        let extent = self.classes[usize::from(object.class.0)].extent;
        let across = (2.0 * extent.radius).max(extent.top - extent.bottom);
        pixels(across, object.position.metres().distance(self.eye) - extent.radius, self.focal)
    }
}
