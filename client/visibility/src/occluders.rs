//! Which polygons of a scene are worth drawing as occluders, and which of them join without a gap?
//!
//! A pixel counts as covered only if one occluder covers all of it, so every line at which two triangles meet would
//! leak. Two remedies, both prepared here once per scene:
//! - **merging**: coplanar triangles that share an edge become one convex polygon, so a wall's diagonal is gone;
//! - **joints**: pairs of polygons whose borders run along the same line (the corner of a room, a lintel between two
//!   pieces of wall). [`crate::UnderOcclusion`] draws the strip along a joint once both its polygons are drawn.
//!
//! # Why no tolerance can make an occluder too large
//! A polygon is a triangulated disc: triangles glued along exactly shared edges (bitwise equal corners), bounded by one
//! closed loop of original corners. Seen from the eye, let a direction d lie on the inner side of every edge of the
//! loop, where "inner" is the side det(next, this, d) > 0. Then every edge turns around the axis d by an angle in
//! (0, π), so the loop winds around d at least once, and a disc that is bounded by it must be pierced at least once from
//! its front side (the sum of the signs of all piercings is the winding number). This needs neither planarity nor
//! convexity: a loop that is not quite convex merely yields a smaller intersection of half-planes. Depth is taken from
//! the farther of two parallel planes that enclose all corners. So both tolerances below only cost tightness. The one
//! step that could enlarge a polygon, dropping a corner in the middle of a straight edge, is taken only where the
//! cross product is exactly 0.

use glam::{DVec3, Vec3};
use rustc_hash::FxHashMap;

use crate::closers::{self, Closer, EXACT};
use crate::occluder_tree::OccluderTree;
use crate::{Aabb, Scene, Sides};

/// One occluder: a loop of corners, anticlockwise from its front.
#[derive(Clone, Debug)]
pub(crate) struct Polygon {
    /// Range in [`Occluders::corners`].
    pub first: u32,
    /// Number of corners, at least 3.
    pub count: u32,
    /// Range in [`Occluders::joint_lists`].
    pub joints: std::ops::Range<u32>,
    /// Whether it hides from behind too.
    pub two_sided: bool,
    /// The box of the closed shell that it belongs to: an eye outside need not draw it from behind.
    pub shell: Option<Aabb>,
    /// Range in [`Occluders::closers`].
    pub closers: std::ops::Range<u32>,
    /// Unit normal of the loop (Newell).
    pub normal: DVec3,
    /// Whether all corners lie in one plane, rounding in f64 apart.
    pub flat: bool,
    /// Greatest sine between an edge and the plane.
    pub tilt: f64,
    /// Least extent across.
    pub width: f64,
    pub aabb: Aabb,
}

/// Two polygons whose borders share a stretch of one line.
#[derive(Clone, Debug)]
pub(crate) struct Joint {
    pub polygons: [u32; 2],
    /// Which edge of each polygon (from corner i to i + 1) lies on the line.
    pub edges: [u32; 2],
    /// Whether the two edges run in opposite directions, as they do when two fronts meet.
    pub opposite: bool,
    /// The shared stretch.
    pub ends: [DVec3; 2],
}

/// What of a scene can hide something, prepared for [`crate::UnderOcclusion`]. Never changes once made.
#[derive(Clone, Debug)]
pub struct Occluders {
    pub(crate) corners: Vec<Vec3>,
    pub(crate) polygons: Vec<Polygon>,
    pub(crate) joints: Vec<Joint>,
    /// The other polygon and the index in `joints`, polygon by polygon.
    pub(crate) joint_lists: Vec<[u32; 2]>,
    pub(crate) closers: Vec<Closer>,
    /// Boxes over the polygons.
    pub(crate) tree: OccluderTree,
    /// Polygon of each primitive, or `NONE`.
    polygon_of: Vec<u32>,
}

pub(crate) const NONE: u32 = u32::MAX;

/// A strip narrower than this covers a whole pixel of a 128 px cube face only within 2.5 m (its pixel is z/64 wide), where
/// something larger nearly always does too.
const DEFAULT_WIDTH_MIN: f64 = 0.04;

/// Corners may be this far from the polygon's plane, as a share of its size. Costs tightness of depth only.
const FLATNESS: f64 = 1e-5;

/// A corner may turn inward by this sine. Costs the sliver outside the longer edge's line only.
const CONVEXITY: f64 = 1e-7;

/// More corners than this are not merged: each costs a half-plane per row of pixels.
/// [`crate::under_face::Region`] has room for this many.
pub(crate) const CORNERS_MAX: usize = 8;

/// A joint shorter than this is not kept, for the reason of [`DEFAULT_WIDTH_MIN`].
const JOINT_MIN: f64 = 0.1;

impl Occluders {
    /// The occluders of `scene`, without strips narrower than 4 cm.
    pub fn build(scene: &Scene) -> Occluders {
        Occluders::build_with(scene, DEFAULT_WIDTH_MIN)
    }

    /// The occluders of `scene` that are at least `width_min` metres wide.
    pub fn build_with(scene: &Scene, width_min: f64) -> Occluders {
        let mut loops = Loops::new(scene);
        loops.close_shells();
        loops.merge();
        loops.finish(scene.triangles().len(), width_min)
    }

    /// Number of polygons.
    pub fn len(&self) -> usize {
        self.polygons.len()
    }

    /// Whether nothing can hide anything.
    pub fn is_empty(&self) -> bool {
        self.polygons.is_empty()
    }

    /// Number of pairs of polygons that join along a line.
    pub fn joint_count(&self) -> usize {
        self.joints.len()
    }

    /// The polygon that contains a primitive, if it is an occluder.
    pub fn polygon_of(&self, primitive: u32) -> Option<u32> {
        self.polygon_of.get(primitive as usize).copied().filter(|&polygon| polygon != NONE)
    }

    /// The corners of a polygon, anticlockwise from its front.
    pub fn corners(&self, polygon: u32) -> &[Vec3] {
        let Polygon { first, count, .. } = self.polygons[polygon as usize];
        &self.corners[first as usize..(first + count) as usize]
    }
}

/// The polygons while they are being merged.
pub(crate) struct Loops {
    pub positions: Vec<Vec3>,
    /// Those that were merged into others have no corners.
    pub loops: Vec<Loop>,
    /// Whether corners in the middle of a straight edge count towards [`CORNERS_MAX`], since they will be kept.
    keeps_straight_corners: bool,
}

pub(crate) struct Loop {
    pub corners: Vec<u32>,
    pub primitives: Vec<u32>,
    pub sides: Sides,
    pub shell: Option<Aabb>,
    pub normal: DVec3,
}

impl Loops {
    /// The merged loops of a scene, for users that drop no corner.
    pub(crate) fn with_all_corners(scene: &Scene) -> Loops {
        let mut loops = Loops::new(scene);
        loops.keeps_straight_corners = true;
        loops.merge();
        loops
    }

    /// One loop per occluding triangle of non-zero area.
    fn new(scene: &Scene) -> Loops {
        let mut ids = FxHashMap::default();
        let mut positions = Vec::new();
        let mut loops = Vec::new();
        for (primitive, triangle) in scene.triangles().iter().enumerate() {
            if !triangle.occludes {
                continue;
            }
            let corners = triangle.corners.map(|corner| {
                // Adding 0 turns −0 into 0, so that equal corners have equal bits.
                let corner = corner + Vec3::ZERO;
                *ids.entry(corner.to_array().map(f32::to_bits)).or_insert_with(|| {
                    positions.push(corner);
                    positions.len() as u32 - 1
                })
            });
            let Some(normal) = newell(&positions, &corners).try_normalize() else { continue };
            loops.push(Loop {
                corners: corners.to_vec(),
                primitives: vec![primitive as u32],
                sides: triangle.sides,
                shell: None,
                normal,
            });
        }
        Loops { positions, loops, keeps_straight_corners: false }
    }

    fn at(&self, corner: u32) -> DVec3 {
        self.positions[corner as usize].as_dvec3()
    }

    /// Finds closed shells: seen from outside, their back sides need not be drawn, which halves the work.
    ///
    /// If each edge runs both ways equally often and the shell faces outward, its front is nearer wherever its
    /// back could hide something, as long as the eye is outside; its box tells that well enough. (Not drawing something
    /// is never wrong.)
    fn close_shells(&mut self) {
        let mut owners: FxHashMap<(u32, u32), Vec<u32>> = FxHashMap::default();
        for (index, polygon) in self.loops.iter().enumerate() {
            for edge in edges(&polygon.corners) {
                owners.entry(edge).or_default().push(index as u32);
            }
        }
        let mut seen = vec![false; self.loops.len()];
        for start in 0..self.loops.len() {
            if std::mem::replace(&mut seen[start], true) {
                continue;
            }
            let (mut shell, mut next, mut closed, mut volume) = (vec![start as u32], 0, true, 0.0);
            let origin = self.at(self.loops[start].corners[0]);
            while let Some(&index) = shell.get(next) {
                next += 1;
                let corners = &self.loops[index as usize].corners;
                let [a, b, c] = [0, 1, 2].map(|i| self.at(corners[i]) - origin);
                volume += a.cross(b).dot(c);
                for (a, b) in edges(corners) {
                    let neighbours = owners.get(&(b, a)).map_or(&[][..], Vec::as_slice);
                    closed &= neighbours.len() == owners[&(a, b)].len();
                    // Where solids touch along an edge it is shared by four, and does not tell whose sides are whose.
                    if let [neighbour] = *neighbours
                        && !std::mem::replace(&mut seen[neighbour as usize], true)
                    {
                        shell.push(neighbour);
                    }
                }
            }
            if closed && volume > 0.0 {
                let corners = shell.iter().flat_map(|&index| &self.loops[index as usize].corners);
                let aabb = corners.fold(Aabb::EMPTY, |aabb, &corner| aabb.with_point(self.at(corner)));
                for index in shell {
                    self.loops[index as usize].shell = Some(aabb);
                }
            }
        }
    }

    /// Merges greedily across the longest edges first: those are the diagonals of quads.
    fn merge(&mut self) {
        let mut owner: FxHashMap<(u32, u32), u32> = FxHashMap::default();
        for (index, polygon) in self.loops.iter().enumerate() {
            for edge in edges(&polygon.corners) {
                owner.entry(edge).or_insert(index as u32);
            }
        }
        let mut shared: Vec<(u32, u32)> = self
            .loops
            .iter()
            .flat_map(|polygon| edges(&polygon.corners).collect::<Vec<_>>())
            .filter(|&(a, b)| a < b && owner.contains_key(&(b, a)))
            .collect();
        shared.sort_by(|&(a, b), &(c, d)| {
            let length = |a, b| self.at(a).distance_squared(self.at(b));
            length(c, d).total_cmp(&length(a, b)).then((a, b).cmp(&(c, d)))
        });
        shared.dedup();
        // A merge can make another one possible (two halves of a square, then two squares): a few rounds settle it.
        for _round in 0..6 {
            let before = shared.len();
            shared.retain(|&(a, b)| {
                let (Some(&p), Some(&q)) = (owner.get(&(a, b)), owner.get(&(b, a))) else { return false };
                let Some(joined) = self.joined(p, q, (a, b)) else { return p != q };
                for edge in edges(&self.loops[p as usize].corners).chain(edges(&self.loops[q as usize].corners)) {
                    if owner.get(&edge).is_some_and(|&index| index == p || index == q) {
                        owner.remove(&edge);
                    }
                }
                for edge in edges(&joined) {
                    owner.entry(edge).or_insert(p);
                }
                let primitives = std::mem::take(&mut self.loops[q as usize].primitives);
                self.loops[q as usize].corners.clear();
                // Outside the union of two shells' boxes is outside both.
                let shell = self.loops[p as usize].shell.zip(self.loops[q as usize].shell);
                let normal = newell(&self.positions, &joined).normalize();
                let polygon = &mut self.loops[p as usize];
                polygon.primitives.extend(primitives);
                polygon.corners = joined;
                polygon.shell = shell.map(|(p, q)| p.union(&q));
                polygon.normal = normal;
                false
            });
            if shared.len() == before {
                break;
            }
        }
    }

    /// The loop around `p` and `q`, which share the edge that runs `a` → `b` in `p`, if it is flat, convex and simple.
    fn joined(&self, p: u32, q: u32, (a, b): (u32, u32)) -> Option<Vec<u32>> {
        if p == q {
            return None;
        }
        let (p, q) = (&self.loops[p as usize], &self.loops[q as usize]);
        if p.sides != q.sides || p.shell.is_some() != q.shell.is_some() || p.normal.dot(q.normal) < 0.999 {
            return None;
        }
        let start = |corners: &[u32], corner| corners.iter().position(|&c| c == corner);
        // p from b round to a, then q from after a to before b.
        let from_b = start(&p.corners, b)?;
        let from_a = start(&q.corners, a)?;
        let mut corners: Vec<u32> = p.corners[from_b..].iter().chain(&p.corners[..from_b]).copied().collect();
        corners.extend(q.corners[from_a..].iter().chain(&q.corners[..from_a]).skip(1).take(q.corners.len() - 2));
        // Further shared edges next to the first: x, y, x is out and back again, so y is inside now.
        loop {
            let n = corners.len();
            if n < 3 {
                return None;
            }
            let Some(i) = (0..n).find(|&i| corners[i] == corners[(i + 2) % n]) else { break };
            let (j, k) = ((i + 1) % n, (i + 2) % n);
            corners.remove(j.max(k));
            corners.remove(j.min(k));
        }
        let mut sorted = corners.clone();
        sorted.sort_unstable();
        if sorted.windows(2).any(|pair| pair[0] == pair[1]) {
            return None;
        }
        let normal = newell(&self.positions, &corners).try_normalize()?;
        let reach: Vec<DVec3> = corners.iter().map(|&c| self.at(c)).collect();
        let size = reach.iter().map(|c| c.distance(reach[0])).fold(0.0, f64::max);
        let coordinate = reach.iter().map(|c| c.abs().max_element()).fold(0.0, f64::max);
        let flatness = FLATNESS * size + 2.0 * f64::from(f32::EPSILON) * coordinate;
        let heights = || reach.iter().map(|c| normal.dot(*c - reach[0]));
        if heights().fold(0.0, f64::max) - heights().fold(0.0, f64::min) > flatness {
            return None;
        }
        let n = reach.len();
        let mut turns = 0;
        for i in 0..n {
            let (u, v) = (reach[(i + 1) % n] - reach[i], reach[(i + 2) % n] - reach[(i + 1) % n]);
            let cross = u.cross(v);
            let sine = cross.dot(normal) / (u.length() * v.length());
            if sine < -CONVEXITY || (sine.abs() <= CONVEXITY && u.dot(v) < 0.0) {
                return None;
            }
            turns += usize::from(self.keeps_straight_corners || cross != DVec3::ZERO);
        }
        (turns <= CORNERS_MAX).then_some(corners)
    }

    fn finish(self, primitives: usize, width_min: f64) -> Occluders {
        let mut occluders = Occluders {
            corners: Vec::new(),
            polygons: Vec::new(),
            joints: Vec::new(),
            joint_lists: Vec::new(),
            closers: Vec::new(),
            tree: OccluderTree::default(),
            polygon_of: vec![NONE; primitives],
        };
        for polygon in &self.loops {
            let corners =
                without_straight_corners(polygon.corners.iter().map(|&c| self.positions[c as usize]).collect());
            let width = width(&corners);
            if corners.len() < 3 || width < width_min {
                continue;
            }
            for &primitive in &polygon.primitives {
                occluders.polygon_of[primitive as usize] = occluders.polygons.len() as u32;
            }
            let (flat, tilt) = flatness(&corners, polygon.normal);
            occluders.polygons.push(Polygon {
                first: occluders.corners.len() as u32,
                count: corners.len() as u32,
                joints: 0..0,
                two_sided: polygon.sides == Sides::Both,
                shell: polygon.shell,
                closers: 0..0,
                normal: polygon.normal,
                flat,
                tilt,
                width,
                aabb: corners.iter().fold(Aabb::EMPTY, |aabb, corner| aabb.with_point(corner.as_dvec3())),
            });
            occluders.corners.extend(corners);
        }
        occluders.tree = OccluderTree::build(&occluders.polygons);
        occluders.find_joints();
        for (polygon, closers) in closers::find(&occluders).into_iter().enumerate() {
            let first = occluders.closers.len() as u32;
            occluders.closers.extend(closers);
            occluders.polygons[polygon].closers = first..occluders.closers.len() as u32;
        }
        occluders
    }
}

impl Occluders {
    fn find_joints(&mut self) {
        let mut all = Vec::new();
        for polygon in 0..self.polygons.len() as u32 {
            let corners = self.corners(polygon);
            all.extend(
                (0..).zip(corners).map(|(edge, &from)| {
                    LineEdge::new(polygon, edge, from, corners[(edge as usize + 1) % corners.len()])
                }),
            );
        }
        let mut joints = Vec::new();
        overlaps_on_lines(all, |a, b, low, high| {
            if a.polygon == b.polygon || f64::from(high.distance(low)) < JOINT_MIN {
                return;
            }
            // Of two polygons that are only seen from the front, edges in one direction lie on one side.
            let opposite = a.forward != b.forward;
            let front_only = |polygon: u32| {
                let polygon = &self.polygons[polygon as usize];
                polygon.shell.is_some() || !polygon.two_sided
            };
            if !opposite && front_only(a.polygon) && front_only(b.polygon) {
                return;
            }
            joints.push(Joint {
                polygons: [a.polygon, b.polygon],
                edges: [a.edge, b.edge],
                opposite,
                ends: [low.as_dvec3(), high.as_dvec3()],
            });
        });
        self.joints = joints;
        let mut lists = vec![Vec::new(); self.polygons.len()];
        for (index, joint) in self.joints.iter().enumerate() {
            let [p, q] = joint.polygons;
            lists[p as usize].push([q, index as u32]);
            lists[q as usize].push([p, index as u32]);
        }
        for (polygon, list) in self.polygons.iter_mut().zip(lists) {
            let first = self.joint_lists.len() as u32;
            self.joint_lists.extend(list);
            polygon.joints = first..self.joint_lists.len() as u32;
        }
    }
}

/// An edge of a polygon as a part of its line.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LineEdge {
    pub polygon: u32,
    /// From corner `edge` to the next.
    pub edge: u32,
    /// The end with the lesser coordinates, and the other.
    pub low: Vec3,
    pub high: Vec3,
    /// Whether it runs from `low` to `high`.
    pub forward: bool,
}

impl LineEdge {
    pub(crate) fn new(polygon: u32, edge: u32, from: Vec3, to: Vec3) -> LineEdge {
        let (low, high) = if from.to_array() < to.to_array() { (from, to) } else { (to, from) };
        LineEdge { polygon, edge, low, high, forward: low == from }
    }

    /// Equal for edges on one line. Only lines that are *exactly* the same count: those through the same two corners, and
    /// those parallel to an axis with the same other two coordinates (where pieces of wall of different length meet).
    fn line(&self) -> [u32; 6] {
        let along = (self.high - self.low).abs();
        let moves: Vec<usize> = (0..3).filter(|&axis| along[axis] != 0.0).collect();
        let mut key = [0; 6];
        if let [axis] = moves[..] {
            let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
            key = [u32::MAX, u32::MAX, u32::MAX, axis as u32, self.low[u].to_bits(), self.low[v].to_bits()];
        } else {
            key[..3].copy_from_slice(&self.low.to_array().map(f32::to_bits));
            key[3..].copy_from_slice(&self.high.to_array().map(f32::to_bits));
        }
        key
    }
}

/// Calls `overlap` for each pair of edges that share a stretch of one line, with the stretch's ends.
pub(crate) fn overlaps_on_lines(edges: Vec<LineEdge>, mut overlap: impl FnMut(&LineEdge, &LineEdge, Vec3, Vec3)) {
    let mut lines: std::collections::BTreeMap<[u32; 6], Vec<LineEdge>> = std::collections::BTreeMap::new();
    for edge in edges {
        lines.entry(edge.line()).or_default().push(edge);
    }
    for edges in lines.values_mut() {
        edges.sort_by(|a, b| a.low.to_array().partial_cmp(&b.low.to_array()).expect("corners are finite"));
        for (i, a) in edges.iter().enumerate() {
            for b in &edges[i + 1..] {
                if b.low.to_array() >= a.high.to_array() {
                    break;
                }
                let high = if a.high.to_array() < b.high.to_array() { a.high } else { b.high };
                overlap(a, b, b.low, high);
            }
        }
    }
}

fn edges(corners: &[u32]) -> impl Iterator<Item = (u32, u32)> + '_ {
    corners.iter().copied().zip(corners.iter().copied().cycle().skip(1))
}

/// Twice the area vector of a loop.
fn newell(positions: &[Vec3], corners: &[u32]) -> DVec3 {
    let at = |corner: u32| positions[corner as usize].as_dvec3();
    let origin = at(corners[0]);
    corners.windows(2).map(|pair| (at(pair[0]) - origin).cross(at(pair[1]) - origin)).sum()
}

/// Whether corners are in one plane up to rounding in f64, and the greatest sine between an edge and the plane.
fn flatness(corners: &[Vec3], normal: DVec3) -> (bool, f64) {
    let (mut height, mut size, mut tilt) = (0.0_f64, 0.0_f64, 0.0_f64);
    for (i, corner) in corners.iter().enumerate() {
        let corner = corner.as_dvec3();
        let (across, along) = (corner - corners[0].as_dvec3(), corners[(i + 1) % corners.len()].as_dvec3() - corner);
        height = height.max(normal.dot(across).abs());
        size = size.max(across.length());
        tilt = tilt.max(normal.dot(along).abs() / along.length());
    }
    (height <= EXACT * size, tilt)
}

/// Drops corners between two edges of exactly the same direction. Differences of f32 are exact in f64 unless their
/// exponents differ by more than 29, and products of two of them round by 2⁻⁵³ at most: far below the inset of 10⁻⁴
/// pixel that every edge gets.
fn without_straight_corners(corners: Vec<Vec3>) -> Vec<Vec3> {
    let n = corners.len();
    (0..n)
        .filter(|&i| {
            let at = |i: usize| corners[i % n].as_dvec3();
            let (u, v) = (at(i) - at(i + n - 1), at(i + 1) - at(i));
            u.cross(v) != DVec3::ZERO || u.dot(v) <= 0.0
        })
        .map(|i| corners[i])
        .collect()
}

/// Least extent of a convex loop perpendicular to one of its edges, in its plane.
fn width(corners: &[Vec3]) -> f64 {
    let n = corners.len();
    (0..n)
        .map(|i| {
            let (from, to) = (corners[i].as_dvec3(), corners[(i + 1) % n].as_dvec3());
            let Some(along) = (to - from).try_normalize() else { return 0.0 };
            corners.iter().map(|c| (c.as_dvec3() - from).reject_from_normalized(along).length()).fold(0.0, f64::max)
        })
        .fold(f64::INFINITY, f64::min)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Triangle;

    fn triangle(corners: [[f32; 3]; 3]) -> Triangle {
        Triangle { corners: corners.map(Vec3::from), sides: Sides::Both, occludes: true }
    }

    #[test]
    fn a_grid_of_squares_becomes_one_quad() {
        let mut triangles = Vec::new();
        for (x, y) in [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)] {
            let at = |dx: f32, dy: f32| [x + dx, y + dy, 0.0];
            triangles.push(triangle([at(0.0, 0.0), at(1.0, 0.0), at(1.0, 1.0)]));
            triangles.push(triangle([at(0.0, 0.0), at(1.0, 1.0), at(0.0, 1.0)]));
        }
        let occluders = Occluders::build(&Scene::from_triangles(triangles));
        assert_eq!(occluders.len(), 1);
        assert_eq!(occluders.corners(0).len(), 4);
        assert!((0..8).all(|primitive| occluders.polygon_of(primitive) == Some(0)));
    }

    #[test]
    fn an_l_shape_stays_two_convex_pieces_with_a_joint() {
        let quad = |x0: f32, x1: f32, y0: f32, y1: f32| {
            [
                triangle([[x0, y0, 0.0], [x1, y0, 0.0], [x1, y1, 0.0]]),
                triangle([[x0, y0, 0.0], [x1, y1, 0.0], [x0, y1, 0.0]]),
            ]
        };
        // The lintel's edge is a part of the wall's edge.
        let triangles = [quad(0.0, 2.0, 0.0, 3.0), quad(2.0, 3.0, 2.1, 3.0)].concat();
        let occluders = Occluders::build(&Scene::from_triangles(triangles));
        assert_eq!(occluders.len(), 2);
        assert_eq!(occluders.joint_count(), 1);
        assert!(occluders.joints[0].opposite);
    }

    #[test]
    fn what_does_not_occlude_or_has_no_area_is_left_out() {
        let mut glass = triangle([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]);
        glass.occludes = false;
        let flat = triangle([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]]);
        assert!(Occluders::build(&Scene::from_triangles(vec![glass, flat])).is_empty());
    }
}
