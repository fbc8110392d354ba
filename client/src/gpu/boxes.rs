//! How much larger is a box drawn than it is, so that a GPU's own arithmetic hides nothing that is in it?
//!
//! A GPU moves corners to view space in f32 and snaps them to a fraction of a pixel (1/256 on most, 1/16 is the least that Vulkan
//! allows), and interpolates depth from a plane in f32. So a triangle in the box may own a pixel that the box itself, drawn by the
//! same hardware, just misses, or lie a little before the box's face. Against the first the box is grown in the scene, by what a few
//! snaps of a pixel are at its farthest corner; against the second its depths are moved nearer by a part of 2⁻¹⁰, a
//! centimetre at ten metres. The error of an interpolated depth grows with the ratio of depths on the face; boxes that reach nearer than
//! 1/256 of their farthest distance are not drawn but count as seen.

use eyeline_visibility::{Aabb, BoxOnImage, DepthBuffer, PixelRect, View};
use glam::{DVec3, Vec3};

/// What a box is grown by at its farthest corner, in pixels: the least snap that Vulkan allows, at three corners, and as much again.
pub const GROWTH_PX: f64 = 1.0 / 4.0;

/// The same as a part of the distance: f32 carries 2⁻²³, and transforming and clipping lose a few bits.
pub const GROWTH_SHARE: f64 = 1.0 / 4096.0;

/// By what part of themselves depths (near / distance) of boxes are moved nearer.
pub const NEARER: f64 = 1.0 / 1024.0;

/// The least distance of a box that is drawn, as a part of its farthest.
const NEAREST_SHARE: f64 = 1.0 / 256.0;

/// Where a grown box is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Place {
    /// No pixel sees any of it: it is not seen, and not drawn.
    Outside,
    /// It is at the eye or the near plane, or nothing is known of it: it is seen, and not drawn.
    Touching,
    /// It can be drawn.
    In(Drawable),
}

/// A grown box as it is drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Drawable {
    /// Least corner relative to the eye, metres along the scene's axes.
    pub min: Vec3,
    /// Greatest corner, likewise.
    pub max: Vec3,
    /// The pixels that may show it.
    pub rect: PixelRect,
    /// No reversed depth of it is greater.
    pub z: f32,
}

/// The box that is drawn in place of `aabb`.
pub fn grown(view: &View, aabb: &Aabb) -> Aabb {
    let far = aabb.corners().map(|corner| (corner - view.eye).length()).into_iter().fold(0.0, f64::max);
    // Along two axes of the image at once, and measured along axes of the scene.
    let by = far * (2.0 * GROWTH_PX / view.focal_px() + GROWTH_SHARE);
    Aabb { min: aabb.min - DVec3::splat(by), max: aabb.max + DVec3::splat(by) }
}

/// Where a box is drawn; `depth` is of the same view.
pub fn place(view: &View, depth: &DepthBuffer, aabb: &Aabb) -> Place {
    let is_finite = aabb.min.is_finite() && aabb.max.is_finite();
    if !is_finite || view.check().is_err() {
        return Place::Touching;
    }
    let grown = grown(view, aabb);
    let (rect, z) = match depth.box_on_image(&grown) {
        BoxOnImage::Outside => return Place::Outside,
        BoxOnImage::Touching => return Place::Touching,
        BoxOnImage::In { rect, z } => (rect, z),
    };
    let forward = view.orientation.normalize() * DVec3::NEG_Z;
    let corners = grown.corners().map(|corner| corner - view.eye);
    let far = corners.iter().map(|corner| corner.length()).fold(0.0, f64::max);
    let near = corners.iter().map(|corner| corner.dot(forward)).fold(f64::INFINITY, f64::min);
    // Moved nearer by its part, no corner may come before the near plane.
    if near <= (far * NEAREST_SHARE).max(view.near * (1.0 + 2.0 * NEARER)) || far > f64::from(f32::MAX) / 1e6 {
        return Place::Touching;
    }
    let [min, max] = [grown.min, grown.max].map(|corner| (corner - view.eye).as_vec3());
    Place::In(Drawable { min, max, rect, z: (f64::from(z) * (1.0 + NEARER)) as f32 })
}

#[cfg(test)]
mod tests {
    use eyeline_visibility::Resolution;

    use super::*;

    fn view() -> View {
        View::level(DVec3::new(1.0, 2.0, 3.0), 0.0, 1.5, Resolution::new(64, 48))
    }

    #[test]
    fn a_box_grows_by_less_than_a_pixel_and_more_than_a_snap() {
        let view = view();
        let aabb = Aabb::around(view.eye + DVec3::new(0.0, 0.0, -10.0), DVec3::splat(0.5));
        let by = aabb.min.x - grown(&view, &aabb).min.x;
        let px = 10.5 / view.focal_px();
        assert!(by > px / 16.0 && by < px, "{by} of {px}");
    }

    #[test]
    fn what_cannot_be_drawn_counts_as_seen() {
        let view = view();
        let depth = DepthBuffer::new(&view);
        let at = |z: f64, half: f64| {
            place(&view, &depth, &Aabb::around(view.eye + DVec3::new(0.0, 0.0, z), DVec3::splat(half)))
        };
        assert!(matches!(at(-10.0, 1.0), Place::In(_)));
        assert_eq!(at(10.0, 1.0), Place::Outside);
        assert_eq!(at(0.0, 1.0), Place::Touching);
        // A hand's breadth from the eye and tens of metres long.
        assert_eq!(at(-20.0, 19.95), Place::Touching);
        assert_eq!(at(f64::NAN, 1.0), Place::Touching);
        assert_eq!(at(-1e300, 1.0), Place::Touching);
        let blind = View { fov_x: f64::NAN, ..view };
        assert_eq!(place(&blind, &DepthBuffer::new(&blind), &Aabb::around(DVec3::ZERO, DVec3::ONE)), Place::Touching);
    }
}
