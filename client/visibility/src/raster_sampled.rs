//! What does each pixel show? Images sampled at pixel centres.
//!
//! An [`ItemBuffer`] keeps the winner of each pixel: the nearest depth, then the lowest id, whatever the order of drawing.
//! A [`DepthBuffer`] keeps the depths of occluders alone, with the farthest one of each tile of 8 × 8 pixels, and answers
//! cPLP's queries. Both draw with the same arithmetic (`setup`), so that a pixel's depth depends on the view and the
//! triangle only. That is what makes "hidden in the one" mean "cannot win in the other".

mod boxes;
mod depth;
pub(crate) mod seal;
pub(crate) mod setup;

use glam::DVec3;

pub(crate) use boxes::{BoxImage, BoxPlace};
pub use depth::{BoxOnImage, DepthBuffer, SampledTarget};
pub(crate) use depth::{BoxRectangle, MappedTarget, Marks, TILE};
use setup::Projector;

use crate::{Resolution, Scene, Sides, Triangle, View};

/// A rectangle of pixels: columns from `x[0]` up to but without `x[1]`, rows likewise. Empty if they are not ascending.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PixelRect {
    /// Columns.
    pub x: [u32; 2],
    /// Rows.
    pub y: [u32; 2],
}

impl PixelRect {
    /// All pixels of an image.
    pub const fn whole(resolution: Resolution) -> PixelRect {
        PixelRect { x: [0, resolution.width], y: [0, resolution.height] }
    }
}

/// The image of a view: id and depth of each pixel's winner. Reused from frame to frame.
#[derive(Clone, Debug)]
pub struct ItemBuffer {
    projector: Projector,
    resolution: Resolution,
    scissor: PixelRect,
    ids: Vec<u32>,
    depths: Vec<f32>,
    z_tests: u64,
}

impl ItemBuffer {
    /// The id of a pixel that nothing covers. No triangle may have it.
    pub const NONE: u32 = u32::MAX;

    /// An empty image of a view. Without pixels if [`View::check`] refuses it.
    pub fn new(view: &View) -> ItemBuffer {
        let view = &view.or_without_pixels();
        let mut buffer = ItemBuffer {
            projector: Projector::new(view),
            resolution: view.resolution,
            scissor: PixelRect::whole(view.resolution),
            ids: Vec::new(),
            depths: Vec::new(),
            z_tests: 0,
        };
        buffer.begin(view);
        buffer
    }

    /// Forgets everything, scissor included, and starts an image of another view.
    pub fn begin(&mut self, view: &View) {
        let view = &view.or_without_pixels();
        self.projector = Projector::new(view);
        self.resolution = view.resolution;
        self.scissor = PixelRect::whole(view.resolution);
        self.ids.clear();
        self.ids.resize(view.resolution.pixels(), ItemBuffer::NONE);
        self.depths.clear();
        self.depths.resize(view.resolution.pixels(), 0.0);
        self.z_tests = 0;
    }

    /// Draws only in this part of the image from now on. The pixels in it get what they would get without it.
    pub fn set_scissor(&mut self, scissor: PixelRect) {
        self.scissor = scissor;
    }

    /// Draws primitives of a scene.
    pub fn draw(&mut self, scene: &Scene, primitives: &[u32]) {
        for &id in primitives {
            self.draw_triangle(id, &scene.triangles()[id as usize], DVec3::ZERO);
        }
    }

    /// Draws all primitives of a scene.
    pub fn draw_all(&mut self, scene: &Scene) {
        for (id, triangle) in (0..).zip(scene.triangles()) {
            self.draw_triangle(id, triangle, DVec3::ZERO);
        }
    }

    /// Draws a triangle that may be no part of the scene, moved by `offset`, under an id of the caller's choice.
    pub fn draw_triangle(&mut self, id: u32, triangle: &Triangle, offset: DVec3) {
        self.draw_corners(id, triangle.corners.map(|corner| corner.as_dvec3() + offset), triangle.sides);
    }

    /// Draws a triangle with these corners under an id of the caller's choice.
    #[inline]
    pub fn draw_corners(&mut self, id: u32, corners: [DVec3; 3], sides: Sides) {
        debug_assert!(id != ItemBuffer::NONE);
        let (ids, depths, z_tests) = (&mut self.ids, &mut self.depths, &mut self.z_tests);
        let width = self.resolution.width as usize;
        let [x_least, x_end] = self.scissor.x.map(|x| x.min(self.resolution.width) as i32);
        let [y_least, y_end] = self.scissor.y.map(|y| y.min(self.resolution.height) as i32);
        self.projector.pieces(corners, sides, |piece| {
            piece.spans([y_least, y_end - 1], |y, first, last, ramp| {
                let (from, end) = (first.max(x_least), (last + 1).min(x_end));
                if from < end {
                    *z_tests += (end - from) as u64;
                    let row = y as usize * width;
                    let stretch = row + from as usize..row + end as usize;
                    ramp.draw_items(from - first, &mut depths[stretch.clone()], &mut ids[stretch], id);
                }
            });
        });
    }

    /// Size of the image.
    pub fn resolution(&self) -> Resolution {
        self.resolution
    }

    /// The winner of each pixel, row by row from the top, or [`ItemBuffer::NONE`].
    pub fn ids(&self) -> &[u32] {
        &self.ids
    }

    /// The winner of a pixel.
    pub fn id_at(&self, x: u32, y: u32) -> Option<u32> {
        let id = self.ids[y as usize * self.resolution.width as usize + x as usize];
        (id != ItemBuffer::NONE).then_some(id)
    }

    /// The reversed depth of each pixel's winner, near / distance along the view direction; 0 where there is none.
    pub fn depths(&self) -> &[f32] {
        &self.depths
    }

    /// Comparisons of depths since the last `begin`: one for each pixel centre that a triangle covers, whether it wins or
    /// not. Over the number of pixels it is the depth complexity of Klosowski & Silva 2001, §4.
    pub fn z_tests(&self) -> u64 {
        self.z_tests
    }

    /// The ids that own a pixel, ascending, each once. Of everything drawn: the exact set.
    pub fn winners(&self) -> Vec<u32> {
        let mut winners = self.ids.clone();
        winners.sort_unstable();
        winners.dedup();
        if winners.last() == Some(&ItemBuffer::NONE) {
            winners.pop();
        }
        winners
    }
}

/// Whether any pixel centre may be covered by a triangle, as this rasteriser draws it: in view, and not turned away.
pub(crate) struct Coverage(Projector);

impl Coverage {
    pub(crate) fn new(view: &View) -> Coverage {
        Coverage(Projector::new(view))
    }

    pub(crate) fn may_draw(&self, triangle: &Triangle) -> bool {
        let mut found = false;
        self.0.pieces(triangle.corners.map(|corner| corner.as_dvec3()), triangle.sides, |_| found = true);
        found
    }
}

#[cfg(test)]
mod tests;
