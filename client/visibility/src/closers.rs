//! Past which edges of a polygon does a ray run into another polygon?
//!
//! Eyes in a ball see past the edges of an occluder by up to the ball's radius, so that every edge leaks. But the foot of a
//! wall stands on a floor: whatever passes below it is under the floor. The polygon Y *closes* edge e of X if all of X's
//! plane beyond e is behind Y's plane. [`crate::under_region`] says what follows from that. Neither exactly common lines nor
//! exactly common corners are needed: a wall may stand in the middle of a floor, or run into another wall.

use glam::DVec3;

use crate::Aabb;
use crate::occluders::Occluders;

/// An edge and a polygon whose plane it reaches, for both ways in which that polygon may face.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Closer {
    /// Edge of the polygon that is closed, from corner `edge` to the next.
    pub edge: u32,
    /// The polygon that closes it.
    pub polygon: u32,
    /// Height of the edge above that polygon's plane in metres, which is parallel to the edge: 0 where they touch.
    pub height: f64,
    /// Growth of that height per metre from the edge into the polygon that is closed.
    pub slope: f64,
}

impl Closer {
    /// Whether the closed polygon's plane beyond the edge is behind the closer, as seen from its front (or back).
    pub fn closes(&self, from_behind: bool) -> bool {
        let sign = if from_behind { -1.0 } else { 1.0 };
        sign * self.slope > 0.0 && sign * self.height <= 0.0
    }
}

/// Relative error that is taken for rounding: heights and slopes are a few operations of f64 on differences of f32.
pub(crate) const EXACT: f64 = 1e-12;

/// A flatter angle between two polygons closes little, and magnifies rounding.
const SLOPE_MIN: f64 = 1e-3;

/// An edge may end this far behind the polygon that closes it: as walls do that run into each other.
const SUNK_MAX: f64 = 0.35;

/// More closers per edge are not kept. Which are best is a guess: those with the greatest common stretch, and of equals the
/// wide ones, whose own open edges are farther away.
const PER_EDGE_MAX: usize = 3;

/// The closers of each polygon in order of edge, best first.
pub(crate) fn find(occluders: &Occluders) -> Vec<Vec<Closer>> {
    let polygons = &occluders.polygons;
    let bounds = polygons.iter().fold(Aabb::EMPTY, |aabb, polygon| aabb.union(&polygon.aabb)).size();
    let axis = if bounds.x >= bounds.z { 0 } else { 2 };
    let mut order: Vec<u32> = (0..polygons.len() as u32).filter(|&polygon| polygons[polygon as usize].flat).collect();
    order.sort_by(|&a, &b| polygons[a as usize].aabb.min[axis].total_cmp(&polygons[b as usize].aabb.min[axis]));
    let mut found: Vec<Vec<(f64, Closer)>> = vec![Vec::new(); polygons.len()];
    let mut open: Vec<u32> = Vec::new();
    for &polygon in &order {
        let aabb = polygons[polygon as usize].aabb.inflated(SUNK_MAX);
        open.retain(|&other| polygons[other as usize].aabb.max[axis] >= aabb.min[axis]);
        for &other in &open {
            if polygons[other as usize].aabb.intersects(&aabb) {
                relate(occluders, polygon, other, &mut found[polygon as usize]);
                relate(occluders, other, polygon, &mut found[other as usize]);
            }
        }
        open.push(polygon);
    }
    let best = |mut found: Vec<(f64, Closer)>| {
        let key = |(rank, closer): &(f64, Closer)| (closer.edge, -*rank, closer.polygon);
        found.sort_by(|a, b| key(a).partial_cmp(&key(b)).expect("ranks are numbers"));
        let mut kept: Vec<Closer> = Vec::new();
        for (_, closer) in found {
            if kept.iter().rev().take_while(|other| other.edge == closer.edge).count() < PER_EDGE_MAX {
                kept.push(closer);
            }
        }
        kept
    };
    found.into_iter().map(best).collect()
}

/// Appends the edges of `closed` that reach the plane of `closer` near it, best first by their common stretch.
fn relate(occluders: &Occluders, closed: u32, closer: u32, found: &mut Vec<(f64, Closer)>) {
    let plane = &occluders.polygons[closer as usize];
    for edge in 0..occluders.corners(closed).len() as u32 {
        let [from, to] = ends(occluders, closed, edge);
        let common = Aabb::new(from.min(to).max(plane.aabb.min), from.max(to).min(plane.aabb.max)).size();
        if common.min_element() < -SUNK_MAX {
            continue;
        }
        let Some(relation) = relation(occluders, closed, edge, closer) else { continue };
        // Sunk on the one side is short of the plane on the other, so a closer works for one way of facing, or touches.
        if relation.height.abs() <= SUNK_MAX && (relation.closes(false) || relation.closes(true)) {
            let stretch = common.max(DVec3::ZERO).length();
            found.push((stretch + 0.1 * plane.width.min(10.0) - 1e-3 * relation.height.abs(), relation));
        }
    }
}

/// How an edge of `closed` lies to the plane of `closer`, however far away; none unless it is parallel to it. Both must be flat.
pub(crate) fn relation(occluders: &Occluders, closed: u32, edge: u32, closer: u32) -> Option<Closer> {
    let normal = occluders.polygons[closer as usize].normal;
    let [from, to] = ends(occluders, closed, edge);
    let along = to - from;
    let (rise, squared) = (normal.dot(along), along.length_squared());
    // Most pairs end here, without a root.
    if rise * rise > EXACT * EXACT * squared {
        return None;
    }
    let length = squared.sqrt();
    let slope = normal.dot(occluders.polygons[closed as usize].normal.cross(along)) / length;
    if slope.abs() < SLOPE_MIN {
        return None;
    }
    let across = from - occluders.corners(closer)[0].as_dvec3();
    let height = normal.dot(across);
    let height = if height.abs() <= EXACT * (across.abs().element_sum() + length) { 0.0 } else { height };
    Some(Closer { edge, polygon: closer, height, slope })
}

fn ends(occluders: &Occluders, polygon: u32, edge: u32) -> [DVec3; 2] {
    let corners = occluders.corners(polygon);
    [edge as usize, (edge as usize + 1) % corners.len()].map(|i| corners[i].as_dvec3())
}
