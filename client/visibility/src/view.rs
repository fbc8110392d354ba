//! From where and how one looks.

use glam::{DQuat, DVec3};

/// Size of an image in pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Resolution {
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
}

impl Resolution {
    /// `width` × `height` pixels.
    pub const fn new(width: u32, height: u32) -> Resolution {
        Resolution { width, height }
    }

    /// Number of pixels.
    pub const fn pixels(self) -> usize {
        self.width as usize * self.height as usize
    }
}

impl std::fmt::Display for Resolution {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}x{}", self.width, self.height)
    }
}

/// Eye position, orientation, perspective projection and resolution. Pixels are square; row 0 is at the top.
///
/// The fields are public, so anything may stand in them: [`View::check`] says whether it makes sense. Whoever is given a view
/// that does not errs on the safe side. A [`crate::Culler`] reports everything as visible and nothing as hidden; an image of
/// it has no pixels, so that its exact set is empty.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    /// Eye, in scene coordinates (relative to the scene's anchor).
    pub eye: DVec3,
    /// Rotation from view space (−Z forward, +Y up) to world space. A unit quaternion.
    pub orientation: DQuat,
    /// Full horizontal angle of view in radians, between 0 and π exclusive.
    pub fov_x: f64,
    /// Image size.
    pub resolution: Resolution,
    /// Distance of the near plane in metres, above 0. Nothing nearer is drawn.
    pub near: f64,
}

impl View {
    /// The nearest that the near plane may be, in metres. Depths are near / distance in f32, which must not run out of digits.
    pub const NEAR_MIN: f64 = 1e-6;

    /// The most columns or rows of an image.
    pub const SIDE_MAX: u32 = 1 << 16;

    /// The most pixels of an image: 8192 × 8192, half a gigabyte in an item buffer.
    pub const PIXELS_MAX: usize = 1 << 26;

    /// A level view from `eye` towards `yaw` radians (0 looks along −Z, positive turns left, towards −X).
    pub fn level(eye: DVec3, yaw: f64, fov_x: f64, resolution: Resolution) -> View {
        View { eye, orientation: DQuat::from_rotation_y(yaw), fov_x, resolution, near: 0.01 }
    }

    /// Whether this is a view at all. A view without pixels is one; it shows nothing.
    ///
    /// # Errors
    /// What is wrong with it.
    pub fn check(&self) -> Result<(), ViewError> {
        let View { eye, orientation, fov_x, resolution, near } = *self;
        if !eye.is_finite() {
            return Err(ViewError::Eye(eye));
        }
        // Each says what must hold, so that NaN is refused.
        let is_unit = (orientation.length_squared() - 1.0).abs() <= UNIT_SLACK;
        if !is_unit {
            return Err(ViewError::Orientation(orientation));
        }
        if !(fov_x > 0.0 && fov_x < std::f64::consts::PI) {
            return Err(ViewError::FovX(fov_x));
        }
        if !(near >= View::NEAR_MIN && near.is_finite()) {
            return Err(ViewError::Near(near));
        }
        if resolution.width.max(resolution.height) > View::SIDE_MAX || resolution.pixels() > View::PIXELS_MAX {
            return Err(ViewError::Resolution(resolution));
        }
        Ok(())
    }

    /// The view itself, or one without pixels in place of one that is none.
    pub(crate) fn or_without_pixels(&self) -> View {
        match self.check() {
            Ok(()) => *self,
            Err(_) => View::level(DVec3::ZERO, 0.0, 1.0, Resolution::new(0, 0)),
        }
    }

    /// Axes of view space in the scene, of unit length: right, up, forward.
    ///
    /// [`View::check`] lets an orientation be of unit length to a few digits only. Its axes would be longer or shorter by as
    /// much, and depths that are found by distance and those found by a plane's normal would part by twice that.
    pub(crate) fn axes(&self) -> [DVec3; 3] {
        let orientation = self.orientation.normalize();
        [DVec3::X, DVec3::Y, DVec3::NEG_Z].map(|axis| orientation * axis)
    }

    /// Pixels per unit of tangent: half the width over tan(fov_x / 2).
    pub fn focal_px(&self) -> f64 {
        f64::from(self.resolution.width) * 0.5 / (self.fov_x * 0.5).tan()
    }

    /// The six square 90° views of a cube around `eye` with `side` pixels a side: −Z, −X, +Z, +X, +Y, −Y. Together
    /// they see every direction.
    pub fn cube(eye: DVec3, side: u32) -> [View; 6] {
        use std::f64::consts::{FRAC_PI_2, PI};
        let turns = [
            DQuat::IDENTITY,
            DQuat::from_rotation_y(FRAC_PI_2),
            DQuat::from_rotation_y(PI),
            DQuat::from_rotation_y(-FRAC_PI_2),
            DQuat::from_rotation_x(FRAC_PI_2),
            DQuat::from_rotation_x(-FRAC_PI_2),
        ];
        turns.map(|orientation| View {
            eye,
            orientation,
            fov_x: FRAC_PI_2,
            resolution: Resolution::new(side, side),
            near: 0.01,
        })
    }
}

/// How far the square of an orientation's length may be from 1: what f32 quaternions come to after many turns.
const UNIT_SLACK: f64 = 1e-3;

/// Why a [`View`] makes no sense.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ViewError {
    /// The eye is not a finite point.
    #[error("an eye at {0} is nowhere")]
    Eye(DVec3),
    /// The orientation is not finite or not of unit length.
    #[error("{0} is no rotation: its length must be 1")]
    Orientation(DQuat),
    /// The angle of view is NaN or out of range.
    #[error("an angle of view of {0} rad is not between 0 and pi")]
    FovX(f64),
    /// The near plane is too near, behind the eye, infinitely far or NaN.
    #[error("a near plane at {0} m is not finite and at least {min} m away", min = View::NEAR_MIN)]
    Near(f64),
    /// The image is too large.
    #[error("an image of {0} pixels is more than {side} a side or {pixels} in all", side = View::SIDE_MAX, pixels = View::PIXELS_MAX)]
    Resolution(Resolution),
}

/// How far the middle of a region lies ahead of who walks, of its reach: not quite at the edge, for who turns.
const ONWARD: f64 = 0.9;

/// The ball of eye positions that visibility must hold for. A point is a region of radius 0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EyeRegion {
    /// Middle of the ball.
    pub centre: DVec3,
    /// Radius in metres.
    pub radius: f64,
}

impl EyeRegion {
    /// The region that is the single point `eye`.
    pub const fn point(eye: DVec3) -> EyeRegion {
        EyeRegion { centre: eye, radius: 0.0 }
    }

    /// The region of all eyes within `reach` metres of this one's, or of where these have gone on by nearly as much `towards` some
    /// direction (metres of any length; none is zero): who walks on stays in it for twice as long.
    pub fn grown(self, reach: f64, towards: DVec3) -> EyeRegion {
        let centre = self.centre + towards.normalize_or_zero() * (reach * ONWARD);
        EyeRegion { centre, radius: self.radius + reach }
    }

    /// Whether every eye of `other` is one of this region's. Rounds outward: a tie, or doubt, is `false`, unless they are equal.
    pub fn contains(&self, other: &EyeRegion) -> bool {
        let apart = self.centre.distance(other.centre) * (1.0 + 1e-12);
        self == other || (apart + other.radius) * (1.0 + 1e-12) < self.radius
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_walks_on_stays_in_a_region_for_nearly_twice_its_radius() {
        let eye = EyeRegion::point(DVec3::new(3.0, 1.6, -2.0));
        let ahead = DVec3::new(0.0, 0.0, 0.07);
        let region = eye.grown(0.5, ahead);
        let at = |metres: f64| EyeRegion::point(eye.centre + ahead.normalize() * metres);
        assert!(region.contains(&eye) && region.contains(&at(0.94)));
        assert!(!region.contains(&at(0.951)) && !region.contains(&at(-0.051)));
        // Who stands has all of it around, and a ball must lie in it whole.
        let region = eye.grown(0.5, DVec3::ZERO);
        assert!(region.contains(&at(0.49)) && region.contains(&at(-0.49)));
        assert!(!region.contains(&EyeRegion { radius: 0.02, ..at(0.49) }));
        // Nothing is reached: it is itself.
        let ball = EyeRegion { radius: 0.3, ..eye };
        assert_eq!(ball.grown(0.0, ahead), ball);
        assert!(ball.contains(&ball) && eye.contains(&eye));
        for bad in [EyeRegion::point(DVec3::NAN), EyeRegion { radius: f64::NAN, ..eye }] {
            assert!(!region.contains(&bad) && !bad.contains(&eye));
        }
    }
}
