//! Does a triangle look covered by what was drawn so far? A small image of depths, asked at points.
//!
//! It is a guess in both directions: a point is compared with the farthest of the nine pixels around it, so that slopes and
//! edges do not count as covered, and what shows between two points is not seen. PLP only orders by it.

use glam::DVec3;

use crate::raster_sampled::setup::Projector;
use crate::{DepthBuffer, Resolution, Triangle, View};

/// The image of what was projected.
#[derive(Clone, Debug)]
pub(crate) struct CoverageImage {
    depth: DepthBuffer,
    projector: Projector,
    columns: i32,
    rows: i32,
}

/// Nearer by this share still counts as covered by the same surface: the image's own rounding, and a pixel of slope.
const SLACK: f32 = 2e-3;

impl CoverageImage {
    pub(crate) fn new() -> CoverageImage {
        let nowhere = View::level(DVec3::ZERO, 0.0, 1.0, Resolution::new(0, 0));
        CoverageImage { depth: DepthBuffer::new(&nowhere), projector: Projector::new(&nowhere), columns: 0, rows: 0 }
    }

    /// Starts an empty image of a view, `columns` across, but no finer than the view's own.
    pub(crate) fn begin(&mut self, view: &View, columns: u32) {
        let view = view.or_without_pixels();
        let Resolution { width, height } = view.resolution;
        let columns = columns.clamp(1, width.max(1));
        let rows = (f64::from(columns) * f64::from(height) / f64::from(width.max(1))).round().max(1.0) as u32;
        let resolution = if width == 0 || height == 0 { Resolution::new(0, 0) } else { Resolution::new(columns, rows) };
        let small = View { resolution, ..view };
        self.depth.begin(&small);
        self.projector = Projector::new(&small);
        (self.columns, self.rows) = (resolution.width as i32, resolution.height as i32);
    }

    /// Draws a triangle if it occludes.
    pub(crate) fn draw(&mut self, triangle: &Triangle) {
        self.depth.draw_triangles([triangle]);
    }

    /// Whether a point looks covered; `None` out of view.
    pub(crate) fn covers(&self, point: DVec3) -> Option<bool> {
        let at = self.projector.view_point(point);
        if at.w < self.projector.near {
            return None;
        }
        let per_metre = self.projector.focal_px / at.w;
        let x = (self.projector.middle[0] + at.x * per_metre).floor();
        let y = (self.projector.middle[1] - at.y * per_metre).floor();
        if !(x >= 0.0 && x < f64::from(self.columns) && y >= 0.0 && y < f64::from(self.rows)) {
            return None;
        }
        let (x, y) = (x as i32, y as i32);
        let z = (self.projector.near / at.w) as f32 * (1.0 + SLACK);
        let columns = (x - 1).max(0) as usize..=(x + 1).min(self.columns - 1) as usize;
        let rows = (y - 1).max(0) as usize..=(y + 1).min(self.rows - 1) as usize;
        Some(rows.into_iter().all(|row| self.depth.row(row)[columns.clone()].iter().all(|&depth| depth > z)))
    }

    /// Whether all points of a triangle that are in view look covered: its middle and three near its corners. With none in
    /// view it does not.
    pub(crate) fn covers_triangle(&self, triangle: &Triangle) -> bool {
        let corners = triangle.corners.map(|corner| corner.as_dvec3());
        let middle = corners.into_iter().sum::<DVec3>() / 3.0;
        let mut any = false;
        let mut shows = |point| {
            let covered = self.covers(point);
            any |= covered.is_some();
            covered == Some(false)
        };
        let visible = shows(middle) || corners.iter().any(|&corner| shows(corner.lerp(middle, 0.15)));
        any && !visible
    }
}
