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
    /// A level view from `eye` towards `yaw` radians (0 looks along −Z, positive turns left, towards −X).
    pub fn level(eye: DVec3, yaw: f64, fov_x: f64, resolution: Resolution) -> View {
        View { eye, orientation: DQuat::from_rotation_y(yaw), fov_x, resolution, near: 0.01 }
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
}
