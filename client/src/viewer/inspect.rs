//! What do the algorithms do? Fills an overlay with the cells, tiles and bounds of a view.
//!
//! Nothing here decides what is drawn. Traversals are made again for the picture, from the view that is looked at, so that they can
//! be stopped after any number of cells; the culler that decides knows nothing of it.

use std::collections::BTreeMap;
use std::sync::Arc;

use eyeline_visibility::{
    Aabb, Bound, Budget, Cplp, CplpScratch, CpuQuery, Occupancy, OccupancyQuery, Octree, OctreeRules, PixelRect, Plp,
    PlpCells, PlpRules, PlpScratch, QueryBackEnd as _, QueryKind, Scene, Tessellation, View, image_ray,
};
use glam::{DVec3, Vec2, Vec3Swizzles as _};

use super::font;
use super::online::HiddenBound;
use super::overlay::{Color, Overlay};

/// Something that can be shown over the scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, clap::ValueEnum)]
pub enum Show {
    /// Cells of PLP's traversal, coloured by their solidity
    Cells,
    /// Projected cells in red wire and the front in green (PLP, figure 1)
    Front,
    /// Tiles of cPLP's item buffer, by the round that finished them: blue first, yellow last (cPLP, figure 10)
    Tiles,
    /// Bounds of hidden objects; the redder, the sooner they expire
    Hidden,
    /// The region of eyes that is looked from
    Region,
    /// The view that is looked from, of use from outside
    Frustum,
    /// The surroundings from above, in a corner
    Inset,
    /// Numbers
    Numbers,
    /// Messages, visible and hidden, and what each stage takes, over half a minute
    Charts,
    /// Tiles of an occupancy map, by the round in which something was first drawn into them (Staneker): blue first, yellow
    /// last, none where nothing was
    Occupancy,
    /// Distance as luminance instead of colours, the nearer the brighter
    Depth,
}

impl Show {
    /// All of them, in the order of the keys that switch them.
    pub const ALL: [Show; 11] = [
        Show::Cells,
        Show::Front,
        Show::Tiles,
        Show::Hidden,
        Show::Region,
        Show::Frustum,
        Show::Inset,
        Show::Numbers,
        Show::Charts,
        Show::Occupancy,
        Show::Depth,
    ];
}

/// How far a traversal that is shown may go.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stop {
    /// Most triangles: PLP's budget.
    pub triangles: usize,
    /// Most cells.
    pub cells: usize,
}

impl Default for Stop {
    fn default() -> Stop {
        Stop { triangles: usize::MAX, cells: usize::MAX }
    }
}

const RED: Color = [1.0, 0.08, 0.05, 1.0];
const GREEN: Color = [0.05, 0.9, 0.1, 1.0];
const WHITE: Color = [1.0; 4];
const YELLOW: Color = [1.0, 0.8, 0.1, 1.0];

/// Makes traversals to look at. Its cells are made when they are first wanted.
pub struct Inspector {
    scene: Arc<Scene>,
    cells: Option<Cells>,
}

struct Cells {
    octree: Arc<Octree>,
    plp: Plp,
    scratch: PlpScratch,
    cplp: Cplp,
    tiles: CpuQuery,
    occupancy: OccupancyQuery<CpuQuery>,
    tiles_scratch: CplpScratch,
}

/// A traversal to look at: cells and their solidity.
#[derive(Clone, Debug, Default)]
pub struct Traversed {
    /// The projected cells, in order.
    pub projected: Vec<(Aabb, f32)>,
    /// The front as it was left.
    pub front: Vec<(Aabb, f32)>,
}

impl Inspector {
    /// For a scene.
    pub fn new(scene: Arc<Scene>) -> Inspector {
        Inspector { scene, cells: None }
    }

    fn cells(&mut self) -> &mut Cells {
        let scene = &self.scene;
        self.cells.get_or_insert_with(|| {
            let octree = Arc::new(Octree::build(scene, OctreeRules::default()));
            let boxes: Arc<dyn Tessellation> = octree.clone();
            // The paper's rules: their solidity is what its figures show.
            let plp = Plp::new(Arc::clone(scene), PlpCells::Boxes(Arc::clone(&boxes)), PlpRules::paper());
            let (cplp, tiles) = (Cplp::new(boxes), QueryKind::ItemBufferTiled.back_end());
            let (scratch, tiles_scratch) = (PlpScratch::default(), CplpScratch::default());
            let occupancy = OccupancyQuery::new(QueryKind::ItemBuffer.back_end(), Occupancy::Always);
            Cells { octree, plp, scratch, cplp, tiles, occupancy, tiles_scratch }
        })
    }

    /// PLP's traversal of a view, stopped.
    pub fn traverse(&mut self, view: &View, stop: Stop) -> Traversed {
        let Cells { octree, plp, scratch, .. } = self.cells();
        let boxed = |cell: u32, solidity: f32| (*octree.cells().aabb(cell), solidity);
        let mut traversal = plp.traverse(view, stop.triangles, scratch);
        let steps = traversal.by_ref().take(stop.cells);
        let projected = steps.filter_map(|step| step.cell.map(|cell| boxed(cell, step.solidity))).collect();
        let front = traversal.front().into_iter().map(|(cell, solidity)| boxed(cell, solidity)).collect();
        Traversed { projected, front }
    }

    /// Draws the cells of a traversal by their solidity.
    pub fn show_cells(overlay: &mut Overlay, traversed: &Traversed) {
        // Solidity has no greatest value; half of the greatest met is yellow.
        let all = traversed.projected.iter().chain(&traversed.front);
        let most =
            all.clone().map(|(_, solidity)| *solidity).filter(|solidity| solidity.is_finite()).fold(0.0, f32::max);
        for (aabb, solidity) in all {
            let share = if most > 0.0 { (solidity / most).clamp(0.0, 1.0) } else { 0.0 };
            overlay.solid_box(aabb, [share.sqrt(), (1.0 - share).sqrt(), 0.1, 0.06]);
            overlay.wire_box(aabb, [share.sqrt(), (1.0 - share).sqrt(), 0.1, 0.5], false);
        }
    }

    /// Draws projected cells in red and the front in green.
    pub fn show_front(overlay: &mut Overlay, traversed: &Traversed) {
        traversed.projected.iter().for_each(|(aabb, _)| overlay.wire_box(aabb, [RED[0], RED[1], RED[2], 0.7], true));
        traversed.front.iter().for_each(|(aabb, _)| overlay.wire_box(aabb, GREEN, true));
    }

    /// Draws in which round cPLP's queries finished each tile of the image: blue ones first, yellow ones last.
    pub fn show_tiles(&mut self, overlay: &mut Overlay, view: &View) {
        let scene = Arc::clone(&self.scene);
        let Cells { cplp, tiles, tiles_scratch, .. } = self.cells();
        let mut finished: BTreeMap<[u32; 2], (PixelRect, usize)> = BTreeMap::new();
        cplp.watch_rounds(&scene, view, Budget::default(), tiles, tiles_scratch, |round, back_end| {
            for tile in back_end.finished_tiles() {
                finished.entry([tile.x[0], tile.y[0]]).or_insert((tile, round.number));
            }
        });
        show_by_round(overlay, &finished);
    }

    /// Draws in which round of cPLP each tile of an occupancy map was first drawn into.
    pub fn show_occupancy(&mut self, overlay: &mut Overlay, view: &View) {
        let scene = Arc::clone(&self.scene);
        let Cells { cplp, occupancy, tiles_scratch, .. } = self.cells();
        let mut drawn: BTreeMap<[u32; 2], (PixelRect, usize)> = BTreeMap::new();
        cplp.watch_rounds(&scene, view, Budget::default(), occupancy, tiles_scratch, |round, back_end| {
            for (tile, _) in back_end.map().tiles().filter(|(_, is_drawn)| *is_drawn) {
                drawn.entry([tile.x[0], tile.y[0]]).or_insert((tile, round.number));
            }
        });
        show_by_round(overlay, &drawn);
    }
}

/// Draws tiles, blue those of the first round and yellow those of the last.
fn show_by_round(overlay: &mut Overlay, tiles: &BTreeMap<[u32; 2], (PixelRect, usize)>) {
    let most = tiles.values().map(|(_, round)| *round).max().unwrap_or(1);
    for (tile, round) in tiles.values() {
        let [min, max] = [0, 1].map(|end| Vec2::new(tile.x[end] as f32, tile.y[end] as f32));
        // A gap between tiles that are large enough for one.
        let gap = ((max - min).min_element() * 0.1).clamp(0.0, 1.0);
        let late = (*round as f32 - 1.0) / (most as f32 - 1.0).max(1.0);
        overlay.rectangle(min + gap, max - gap, [late, 0.25 + 0.4 * late, 1.0 - late, 0.3]);
    }
}

/// Draws bounds of hidden objects: as large as they are now, fainter as large as they will grow, and how long they hold yet.
pub fn show_hidden(overlay: &mut Overlay, hidden: &[HiddenBound], view: &View, scale: f32) {
    /// Who has so many seconds left is as far from red as can be.
    const LONG: f64 = 10.0;
    /// More labels than this would hide each other.
    const LABELS_MAX: usize = 40;
    for bound in hidden {
        let color = urgency(bound.left / LONG);
        overlay.wire_sphere(bound.centre, bound.radius, color, true);
        if bound.radius_in_the_end > bound.radius && bound.left.is_finite() {
            let [r, g, b, _] = color;
            overlay.wire_sphere(bound.centre, bound.radius_in_the_end, [r, g, b, 0.2], true);
        }
        if let Some(tested) = bound.tested.as_ref().and_then(Bound::outer_box) {
            overlay.wire_box(&tested, [color[0], color[1], color[2], 0.35], true);
        }
    }
    let mut nearest: Vec<&HiddenBound> = hidden.iter().collect();
    nearest.sort_by(|a, b| a.centre.distance_squared(view.eye).total_cmp(&b.centre.distance_squared(view.eye)));
    for bound in nearest.into_iter().take(LABELS_MAX) {
        let Some(at) = pixel(view, bound.centre) else { continue };
        let text = time_and_growth(bound);
        let scale = (scale * 0.5).floor().max(1.0);
        overlay.label(&text, (at - font::size(&text) * scale * 0.5).floor(), scale, urgency(bound.left / LONG));
    }
}

/// How long a bound holds and by how much it grows until then. One that never expires, as the client makes them itself of the
/// last place that it saw, ends only by being seen.
fn time_and_growth(bound: &HiddenBound) -> String {
    if bound.left.is_infinite() {
        return "until seen".to_owned();
    }
    let growth = bound.radius_in_the_end - bound.radius;
    format!("{:.1} s, +{:.1} m", bound.left.max(0.0), growth.max(0.0))
}

/// Red for what is due, pale for what has long to go.
fn urgency(left: f64) -> Color {
    let share = left.clamp(0.0, 1.0) as f32;
    [1.0, share, 0.1 + 0.5 * share, 0.9]
}

/// Where a point is in the image, in pixels; `None` behind the eye.
pub fn pixel(view: &View, point: DVec3) -> Option<Vec2> {
    let local = view.orientation.conjugate() * (point - view.eye);
    let (focal, depth) = (view.focal_px(), -local.z);
    let centre = Vec2::new(view.resolution.width as f32, view.resolution.height as f32) * 0.5;
    let at = Vec2::new((local.x / depth * focal) as f32, (-local.y / depth * focal) as f32);
    (depth > view.near).then_some(centre + at)
}

/// Draws the region of eyes.
pub fn show_region(overlay: &mut Overlay, eye: DVec3, radius: f64) {
    overlay.wire_sphere(eye, radius.max(0.02), YELLOW, true);
}

/// Draws the edges of a view, `far` metres long.
pub fn show_frustum(overlay: &mut Overlay, view: &View, far: f64) {
    let (width, height) = (f64::from(view.resolution.width), f64::from(view.resolution.height));
    let corners = [(0.0, 0.0), (width, 0.0), (width, height), (0.0, height)];
    let ends = corners.map(|(x, y)| view.eye + image_ray(view, x, y) * far);
    for at in 0..4 {
        overlay.line(view.eye, ends[at], YELLOW, true);
        overlay.line(ends[at], ends[(at + 1) % 4], YELLOW, true);
    }
}

/// What the inset shows.
pub struct Plan<'a> {
    /// The scene, of which upright triangles are drawn.
    pub scene: &'a Scene,
    /// Ids of those that are visible, which are bright.
    pub visible: &'a [u32],
    /// The view.
    pub view: &'a View,
    /// Others in sight.
    pub seen: &'a [DVec3],
    /// Bounds of what is hidden.
    pub hidden: &'a [HiddenBound],
    /// Cells of a traversal.
    pub traversed: Option<&'a Traversed>,
}

/// How far the inset reaches from the eye, metres.
const INSET_REACH: f64 = 15.0;

/// Draws the surroundings from above into the upper right corner, −Z upwards.
pub fn show_inset(overlay: &mut Overlay, plan: &Plan<'_>, scale: f32) {
    let resolution = plan.view.resolution;
    let side = (resolution.width.min(resolution.height) as f32 * 0.38).max(8.0);
    let min = Vec2::new(resolution.width as f32 - side - 8.0 * scale, 8.0 * scale);
    overlay.rectangle(min, min + side, [0.02, 0.02, 0.04, 0.75]);
    let eye = plan.view.eye;
    let metre = side / (2.0 * INSET_REACH) as f32;
    let place = |point: DVec3| min + side * 0.5 + (point - eye).as_vec3().xz() * metre;
    let in_reach = |point: DVec3| (point.x - eye.x).abs().max((point.z - eye.z).abs()) <= INSET_REACH;
    // Lines are cut at the border by leaving out what ends beyond it in short pieces.
    let mut line = |from: DVec3, to: DVec3, width: f32, color: Color| {
        let Some((from, to)) = clip(from - eye, to - eye, INSET_REACH) else { return };
        overlay.flat_line(place(eye + from), place(eye + to), width, color);
    };
    if let Some(traversed) = plan.traversed {
        for (cells, color) in [(&traversed.projected, [0.7, 0.1, 0.1, 0.35]), (&traversed.front, [0.1, 0.8, 0.1, 0.6])]
        {
            for (aabb, _) in cells.iter().filter(|(aabb, _)| aabb.min.y <= eye.y && eye.y <= aabb.max.y) {
                let corners = [
                    [aabb.min.x, aabb.min.z],
                    [aabb.max.x, aabb.min.z],
                    [aabb.max.x, aabb.max.z],
                    [aabb.min.x, aabb.max.z],
                ];
                let corners = corners.map(|[x, z]| DVec3::new(x, eye.y, z));
                (0..4).for_each(|at| line(corners[at], corners[(at + 1) % 4], scale, color));
            }
        }
    }
    let mut walls = |ids: &mut dyn Iterator<Item = u32>, color: Color| {
        for triangle in ids.map(|id| &plan.scene.triangles()[id as usize]) {
            // Where a level plane at the eye's height cuts it.
            let corners = triangle.corners.map(|corner| corner.as_dvec3());
            let cut: Vec<DVec3> = (0..3).filter_map(|at| cut_at(corners[at], corners[(at + 1) % 3], eye.y)).collect();
            if let [from, to, ..] = cut[..] {
                line(from, to, scale, color);
            }
        }
    };
    walls(&mut (0..plan.scene.triangles().len() as u32), [0.35, 0.35, 0.4, 1.0]);
    walls(&mut plan.visible.iter().copied(), [0.9, 0.9, 0.95, 1.0]);
    let half = plan.view.fov_x * 0.5;
    let forward = plan.view.orientation * DVec3::NEG_Z;
    let yaw = (-forward.x).atan2(-forward.z);
    for side in [-half, half] {
        let (sin, cos) = (yaw + side).sin_cos();
        line(eye, eye + DVec3::new(-sin, 0.0, -cos) * 6.0, scale * 1.5, YELLOW);
    }
    for bound in plan.hidden.iter().filter(|bound| in_reach(bound.centre)) {
        let half = (bound.radius as f32 * metre).max(scale).min(side * 0.05);
        overlay.rectangle(place(bound.centre) - half, place(bound.centre) + half, [0.9, 0.3, 0.9, 0.35]);
    }
    for &seen in plan.seen.iter().filter(|seen| in_reach(**seen)) {
        overlay.rectangle(place(seen) - 2.0 * scale, place(seen) + 2.0 * scale, [1.0, 0.5, 0.05, 1.0]);
    }
    overlay.rectangle(place(eye) - 2.0 * scale, place(eye) + 2.0 * scale, WHITE);
}

/// Where an edge meets a level plane.
fn cut_at(from: DVec3, to: DVec3, y: f64) -> Option<DVec3> {
    let ((low, high), rise) = ((from.y.min(to.y), from.y.max(to.y)), to.y - from.y);
    (low <= y && y < high).then(|| from.lerp(to, (y - from.y) / rise))
}

/// The part of a line that lies within a square around the origin in the plan.
fn clip(from: DVec3, to: DVec3, reach: f64) -> Option<(DVec3, DVec3)> {
    let way = to - from;
    let (mut first, mut last) = (0.0f64, 1.0f64);
    for (start, along) in [(from.x, way.x), (from.z, way.z)] {
        if along == 0.0 {
            if start.abs() > reach {
                return None;
            }
            continue;
        }
        let (a, b) = ((-reach - start) / along, (reach - start) / along);
        (first, last) = (first.max(a.min(b)), last.min(a.max(b)));
    }
    (first < last).then(|| (from + way * first, from + way * last))
}

#[cfg(test)]
mod tests {
    use eyeline_visibility::{Resolution, Sides, Triangle};

    use super::*;

    #[test]
    fn a_ray_through_a_pixel_comes_back_to_it() {
        let view = View::level(DVec3::new(1.0, 2.0, 3.0), 0.8, 1.3, Resolution::new(320, 200));
        for (x, y) in [(0.0, 0.0), (160.0, 100.0), (300.0, 20.0)] {
            let point = view.eye + image_ray(&view, x, y) * 7.0;
            let found = pixel(&view, point).unwrap();
            assert!(found.abs_diff_eq(Vec2::new(x as f32, y as f32), 1e-3), "{found}");
        }
        assert_eq!(pixel(&view, view.eye - image_ray(&view, 160.0, 100.0)), None);
    }

    #[test]
    fn lines_end_at_the_border() {
        let at = |x: f64, z: f64| DVec3::new(x, 1.0, z);
        assert_eq!(clip(at(-20.0, 0.0), at(20.0, 0.0), 10.0), Some((at(-10.0, 0.0), at(10.0, 0.0))));
        assert_eq!(clip(at(-1.0, 2.0), at(3.0, 4.0), 10.0), Some((at(-1.0, 2.0), at(3.0, 4.0))));
        assert_eq!(clip(at(11.0, -20.0), at(11.0, 20.0), 10.0), None);
        assert_eq!(clip(at(11.0, 0.0), at(20.0, 0.0), 10.0), None);
    }

    #[test]
    fn a_traversal_stops_after_a_cell_and_leaves_its_front() {
        // Small triangles all over a cube of 80 m, so that there are cells to walk.
        let at = |n: u32| 5.0 * glam::Vec3::new((n % 16) as f32, (n / 16 % 16) as f32, (n / 256) as f32);
        let triangle = |n| {
            let corners = [glam::Vec3::ZERO, glam::Vec3::X, glam::Vec3::Y].map(|corner| at(n) + corner * 0.5);
            Triangle { corners, sides: Sides::Both, occludes: true }
        };
        let scene = Arc::new(Scene::from_triangles((0..4096).map(triangle).collect()));
        let mut inspector = Inspector::new(scene);
        let view = View::level(DVec3::splat(42.0), 0.3, 1.2, Resolution::new(64, 64));
        let one = inspector.traverse(&view, Stop { cells: 1, ..Stop::default() });
        assert_eq!(one.projected.len(), 1);
        assert!(one.projected[0].0.contains(view.eye) && !one.front.is_empty());
        let whole = inspector.traverse(&view, Stop::default());
        assert!(whole.projected.len() > 5 && whole.front.is_empty(), "{whole:?}");
        assert!(inspector.traverse(&view, Stop { triangles: 0, ..Stop::default() }).projected.is_empty());
        let mut overlay = Overlay::default();
        Inspector::show_cells(&mut overlay, &whole);
        Inspector::show_front(&mut overlay, &one);
        assert!(!overlay.is_empty());
    }

    #[test]
    fn what_never_expires_has_no_numbers() {
        let bound = |left| HiddenBound {
            centre: DVec3::ZERO,
            radius: 0.5,
            radius_in_the_end: 0.5 + 3.0 * left,
            tested: None,
            left,
        };
        assert_eq!(time_and_growth(&bound(2.0)), "2.0 s, +6.0 m");
        assert_eq!(time_and_growth(&bound(f64::INFINITY)), "until seen");
    }
}
