//! What hides a box, fast? Tiles of 32 × 8 pixels with coverage masks and planes of depth, drawn with SIMD.
//!
//! A [`MaskedDepth`] is one image of one view. Occluders are convex polygons. It answers whether a box, a ball or a polygon may
//! be seen past them, and errs only towards "seen". After Hasselgren, Andersson and Akenine-Möller, "Masked Software
//! Occlusion Culling" (2016), with three differences: coverage is exact at pixel centres (see `polygon`), layers have planes as
//! depths (`tiles`), and queries use silhouettes and front planes instead of rectangles and one depth (`query`, `outline`).
//!
//! There are two kinds of [`Coverage`]. All levels of SIMD give the same bits.

// `!(a > b)` where NaN must count as "no".
#![allow(clippy::neg_cmp_op_on_partial_ord)]

mod lanes;
mod layers;
mod merge;
mod outline;
mod pixels;
mod polygon;
mod query;
mod tiles;

use std::cell::Cell;

use fearless_simd::{Simd, dispatch};
use glam::{DVec3, Vec3};

pub use fearless_simd::Level as SimdLevel;

use crate::raster_sampled::seal::holds;
use crate::raster_sampled::setup::{Corner, DEPTH_SLACK, GUARD_PX, Projector, SNAP_PX, ViewPoint};
use crate::{Aabb, Bound, Occlusion, SealedFace, Sides, View};
use polygon::{CORNERS_MAX, draw_loop};
use query::{Asked, SidePlanes};
use tiles::Tiles;

/// Most corners of a polygon.
const LOOP_MAX: usize = 8;

/// When does a polygon cover a pixel?
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Coverage {
    /// If it covers the pixel's centre, as an [`crate::ItemBuffer`] of the same view draws it. What is hidden wins no pixel there.
    Sampled,
    /// If it covers the pixel's whole square. What is hidden wins no pixel of any image of the same view that is a whole
    /// number of times finer. Polygons that meet leave an open line of pixels.
    Under,
}

/// Work done since [`MaskedDepth::begin`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MaskedStats {
    /// Polygons that were in view and not turned away.
    pub polygons: u64,
    /// Tiles whose depths are kept pixel by pixel.
    pub tiles_detailed: u64,
    /// Questions asked about boxes, balls and polygons.
    pub queries: u64,
    /// Tiles whose masks and planes a question had to read.
    pub tiles_read: u64,
}

/// The occluders of one view, as tiles with coverage masks. Reused from frame to frame.
///
/// As an [`Occlusion`] it speaks for its view: what lies outside counts as hidden. For a view that [`View::check`] refuses it has
/// no pixels and hides nothing.
#[derive(Clone, Debug)]
pub struct MaskedDepth {
    level: SimdLevel,
    coverage: Coverage,
    /// `None` before the first view, and for one that makes no sense: an image without pixels.
    projector: Option<Projector>,
    sides: SidePlanes,
    /// Whether the view makes no sense, so that nothing is known.
    blind: bool,
    tiles: Tiles,
    polygons: u64,
    queries: Cell<u64>,
    tiles_read: Cell<u64>,
}

impl MaskedDepth {
    /// An image without pixels, by the best level of SIMD that this machine has.
    pub fn new(coverage: Coverage) -> MaskedDepth {
        MaskedDepth::with_level(coverage, SimdLevel::new())
    }

    /// The same at a given level.
    pub fn with_level(coverage: Coverage, level: SimdLevel) -> MaskedDepth {
        MaskedDepth {
            level,
            coverage,
            projector: None,
            sides: SidePlanes::default(),
            blind: false,
            tiles: Tiles::default(),
            polygons: 0,
            queries: Cell::new(0),
            tiles_read: Cell::new(0),
        }
    }

    /// Forgets everything and starts an image of another view. Writes some 20 bytes a tile.
    pub fn begin(&mut self, view: &View) {
        self.blind = view.check().is_err();
        self.projector = (!self.blind).then(|| Projector::new(view));
        self.sides = self.projector.as_ref().map_or_else(SidePlanes::default, SidePlanes::new);
        let resolution = view.or_without_pixels().resolution;
        self.tiles.clear(resolution.width, resolution.height);
        self.polygons = 0;
        self.queries.set(0);
        self.tiles_read.set(0);
    }

    /// Which pixels count as covered.
    pub fn coverage(&self) -> Coverage {
        self.coverage
    }

    /// Work done since the view began.
    pub fn stats(&self) -> MaskedStats {
        MaskedStats {
            polygons: self.polygons,
            tiles_detailed: self.tiles.detailed() as u64,
            queries: self.queries.get(),
            tiles_read: self.tiles_read.get(),
        }
    }

    /// Draws a convex loop of 3 to 8 corners, anticlockwise as seen from its front. Of another loop it draws what is inside all
    /// edges; loops with fewer or more corners, or corners that are not finite, are not drawn.
    pub fn draw_polygon(&mut self, corners: &[DVec3], sides: Sides) {
        let level = self.level;
        dispatch!(level, simd => self.draw_with(simd, corners, sides));
    }

    /// Draws a convex loop of corners in f32.
    pub fn draw_polygon_f32(&mut self, corners: &[Vec3], sides: Sides) {
        let mut wide = [DVec3::ZERO; LOOP_MAX];
        if corners.len() <= LOOP_MAX {
            wide.iter_mut().zip(corners).for_each(|(wide, corner)| *wide = corner.as_dvec3());
            self.draw_polygon(&wide[..corners.len()], sides);
        }
    }

    /// Whether any point of the box may be seen: in the view, and not behind what was drawn. Rounds outward: doubt is `true`,
    /// also for boxes that touch the eye or the near plane, are empty or not finite.
    pub fn sees_box(&self, aabb: &Aabb) -> bool {
        let Some(projector) = &self.projector else { return self.blind };
        let level = self.level;
        dispatch!(level, simd => self.answer(simd, Asked::of_box(simd, self, projector, aabb, true)))
    }

    /// The same for a ball.
    pub fn sees_ball(&self, centre: DVec3, radius: f64) -> bool {
        let Some(projector) = &self.projector else { return self.blind };
        let level = self.level;
        dispatch!(level, simd => self.answer(simd, Asked::of_ball(simd, self, projector, centre, radius)))
    }

    /// The same for the convex hull of 1 to 8 points: a face between two cells, say.
    pub fn sees_polygon(&self, corners: &[DVec3]) -> bool {
        let Some(projector) = &self.projector else { return self.blind };
        let level = self.level;
        dispatch!(level, simd => self.answer(simd, Asked::of_hull(simd, self, projector, corners)))
    }

    /// The same for any bound. [`Bound::Everywhere`] is seen.
    pub fn sees(&self, bound: &Bound) -> bool {
        match *bound {
            Bound::Sphere { centre, radius } => self.sees_ball(centre, radius),
            _ => bound.aabb().is_none_or(|aabb| self.sees_box(&aabb)),
        }
    }

    /// Whether any point of the box may be in the view at all, whatever was drawn.
    pub fn in_view(&self, aabb: &Aabb) -> bool {
        let Some(projector) = &self.projector else { return self.blind };
        let level = self.level;
        !matches!(dispatch!(level, simd => Asked::of_box(simd, self, projector, aabb, false)), Asked::Outside)
    }

    /// The farthest reversed depth (near / distance) at which whole tiles are closed: 0 if a tile has an open pixel, infinite
    /// if the image has no pixels.
    pub fn farthest(&self) -> f32 {
        if self.blind { 0.0 } else { self.tiles.farthest() }
    }

    /// Whether every pixel is closed nearer than `distance` metres along the view's axis: whatever lies beyond is hidden.
    pub fn is_closed_before(&self, distance: f64) -> bool {
        let Some(projector) = &self.projector else { return !self.blind };
        let level = self.level;
        let z = projector.near / distance * (1.0 + 1e-6);
        // NaN closes nothing.
        z >= 0.0 && dispatch!(level, simd => self.tiles.all_nearer(simd, z as f32))
    }

    /// Whether a sealed face hides what is beyond it, at the pixel centres of this view: `raster_sampled/seal.rs` has the
    /// argument, which is about an [`crate::ItemBuffer`] of the view. It needs [`Coverage::Sampled`], and that nothing was drawn
    /// here that would not be drawn there.
    pub fn believes(&self, seal: &SealedFace<'_>) -> bool {
        let Some(projector) = &self.projector else { return !self.blind };
        let depth_at = |x: usize, y: usize| self.tiles.depth_at(x as u32, y as u32);
        self.coverage == Coverage::Sampled && holds(projector, seal, depth_at)
    }

    #[inline(always)]
    fn draw_with<S: Simd>(&mut self, simd: S, corners: &[DVec3], sides: Sides) {
        let Some(projector) = &self.projector else { return };
        let count = corners.len();
        if !(3..=LOOP_MAX).contains(&count) {
            return;
        }
        let mut points = [ViewPoint { x: 0.0, y: 0.0, w: 0.0 }; LOOP_MAX];
        let (mut sum, mut plain) = (0.0, true);
        let reach = GUARD_PX / projector.focal_px;
        for (point, corner) in points.iter_mut().zip(corners) {
            *point = projector.view_point(*corner);
            sum += point.x + point.y + point.w;
            plain &= point.w >= projector.near && point.x.abs().max(point.y.abs()) <= reach * point.w;
        }
        let points = &points[..count];
        if !plain {
            if f64::is_finite(sum) && !projector.outside(points, 0.0) && points.iter().any(|p| p.w >= projector.near) {
                self.polygons +=
                    u64::from(draw_clipped(simd, &mut self.tiles, projector, points, sides, self.coverage));
            }
            return;
        }
        let mut snapped = [Corner { x: 0, y: 0, z: 0.0 }; LOOP_MAX];
        for (corner, point) in snapped.iter_mut().zip(points) {
            *corner = projector.snap(*point);
        }
        self.polygons += u64::from(draw_loop(simd, &mut self.tiles, &snapped[..count], sides, self.coverage, 0.0));
    }
}

/// Draws a loop that meets the near plane or the guard band.
///
/// Cutting the triangles of its fan, as [`crate::ItemBuffer`] does, gives the same corners as cutting the loop, but for those where
/// the diagonals are cut; snapping moves these by 1/512 px off the line between the others. Where that line is outside
/// the image, the loop will do, but its depths are those of other points of the polygon, each within [`SNAP_PX`] of the
/// pixel's centre: they are lowered by twice that, and as much again since the slope is rounded too.
#[inline(never)]
fn draw_clipped<S: Simd>(
    simd: S,
    tiles: &mut Tiles,
    projector: &Projector,
    points: &[ViewPoint],
    sides: Sides,
    coverage: Coverage,
) -> bool {
    if points.len() > 3 && is_planar(points) && near_cut_is_outside(projector, points) {
        return draw_cut(simd, tiles, projector, &projector.clip(points), sides, coverage, 4.0 * SNAP_PX);
    }
    let mut drawn = false;
    for i in 2..points.len() {
        let polygon = projector.clip(&[points[0], points[i - 1], points[i]]);
        drawn |= draw_cut(simd, tiles, projector, &polygon, sides, coverage, 0.0);
    }
    drawn
}

/// Whether a loop is so flat, as seen from the eye, that a point of a diagonal has the depth of the loop's plane there.
fn is_planar(points: &[ViewPoint]) -> bool {
    let [origin, next, third] = [0, 1, 2].map(|i| DVec3::new(points[i].x, points[i].y, points[i].w));
    let normal = (next - origin).cross(third - origin);
    let distance = normal.dot(origin).abs();
    points[3..].iter().all(|p| normal.dot(DVec3::new(p.x, p.y, p.w) - origin).abs() <= DEPTH_SLACK * 0.25 * distance)
}

/// Whether all points where the loop and its diagonals meet the near plane are more than a pixel outside one side of the image.
fn near_cut_is_outside(projector: &Projector, points: &[ViewPoint]) -> bool {
    let mut on_near = [ViewPoint { x: 0.0, y: 0.0, w: 0.0 }; 2 * LOOP_MAX];
    let mut count = 0;
    let mut add = |a: &ViewPoint, b: &ViewPoint| {
        let (ha, hb) = (a.w - projector.near, b.w - projector.near);
        if (ha >= 0.0) != (hb >= 0.0) {
            let t = ha / (ha - hb);
            on_near[count] = ViewPoint { x: a.x + (b.x - a.x) * t, y: a.y + (b.y - a.y) * t, w: projector.near };
            count += 1;
        }
    };
    for i in 0..points.len() {
        add(&points[i], &points[(i + 1) % points.len()]);
    }
    for diagonal in &points[2..points.len() - 1] {
        add(&points[0], diagonal);
    }
    projector.outside(&on_near[..count], 0.0)
}

fn draw_cut<S: Simd>(
    simd: S,
    tiles: &mut Tiles,
    projector: &Projector,
    polygon: &[ViewPoint],
    sides: Sides,
    coverage: Coverage,
    spread: f64,
) -> bool {
    let count = polygon.len();
    if !(3..=CORNERS_MAX).contains(&count) {
        return false;
    }
    let mut snapped = [Corner { x: 0, y: 0, z: 0.0 }; CORNERS_MAX];
    snapped.iter_mut().zip(polygon).for_each(|(corner, point)| *corner = projector.snap(*point));
    let snapped = &snapped[..count];
    // Snapping may have dented it. Then the triangles of the fan cover more than what is inside all edges.
    let turn = |a: Corner, b: Corner, c: Corner| ((b.x - a.x) * (c.y - a.y) - (c.x - a.x) * (b.y - a.y)).signum();
    let turns = |wanted: i64| {
        (0..count).all(|i| turn(snapped[i], snapped[(i + 1) % count], snapped[(i + 2) % count]) != wanted)
    };
    if turns(1) || turns(-1) {
        return draw_loop(simd, tiles, snapped, sides, coverage, spread);
    }
    let mut drawn = false;
    for i in 2..count {
        drawn |= draw_loop(simd, tiles, &[snapped[0], snapped[i - 1], snapped[i]], sides, coverage, spread);
    }
    drawn
}

impl Occlusion for MaskedDepth {
    fn hides(&self, bound: &Bound) -> bool {
        !self.sees(bound)
    }
}

#[cfg(test)]
mod tests;
