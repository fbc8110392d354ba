//! How does one polygon stand to one box? The supporting and separating planes of the two, and what an eye makes of them (Coorg
//! & Teller 1997, §2).
//!
//! For each edge of the polygon there are two planes through the edge that touch the box. They do not depend on the eye, so
//! they are computed once per pair and kept. An eye that is inside of both sees the whole box on the inner side of the edge,
//! and one that is outside of both sees all of it beyond the edge; so of the two, one is the paper's supporting plane and the other
//! its separating plane. A box is
//! - **not occluded** if it is beyond some edge, or wholly before the polygon's plane;
//! - **inside** if it is on the inner side of every edge, and then *fully occluded* if it is also farther than the polygon;
//! - **partially occluded** else, as far as these planes can tell. A box that the polygon's own plane cuts is of this kind,
//!   since parts of it may be occluded: the paper's "not in that half-space" would drop every occluder at the root.
//!
//! An answer stays the same while the eye stays in a ball, whose radius is kept with it. That is the temporal coherence: a slow
//! eye leaves few of these balls in a frame.

use glam::DVec3;

use super::polygons::Polygons;
use super::silhouette::{VERTICES, code};
use crate::Aabb;

/// What eyes and rounding may add to an image: every test gives way by this.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Margins {
    /// Radius of the ball of eyes, metres.
    pub radius: f64,
    /// Tangent of the angle by which directions must be clear of an edge.
    pub angle: f64,
}

/// By what share depths must differ.
pub(crate) const DEPTH_SHARE: f64 = 1.0 / 65_536.0;

/// Rounding of a plane and of an eye's distance from it, as a share of the coordinates that they are made of.
const ROUNDING: f64 = 1e-12;

/// The planes through one edge that touch a box.
#[derive(Clone, Copy, Debug)]
struct EdgePlanes {
    /// Unit normals, towards the polygon's side. Zero if the edge's line meets the box: every eye then sees it cross.
    normals: [DVec3; 2],
    /// Less than the distance of any point of the box from the edge's line.
    gap: f64,
    /// More than what rounding may add to an eye's distance from the planes, per metre of that eye's coordinates.
    rounding: f64,
}

/// What an eye knows of a polygon and a box.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Status {
    /// No part of the box is occluded.
    None,
    /// Some may be.
    Partial,
    /// The box is on the inner side of each edge: hidden if it is farther than the polygon.
    Inside,
}

/// One polygon and one box, kept from frame to frame.
#[derive(Clone, Debug)]
pub(crate) struct Relation {
    pub polygon: u32,
    edges: Vec<EdgePlanes>,
    /// Greatest length of the box's corners and the polygon's, for rounding.
    reach: f64,
    /// Heights of the box along the polygon's normal.
    heights: [f64; 2],
    /// Answer for eyes within `clear` metres of `eye`, on side `side`.
    eye: DVec3,
    clear: f64,
    from_behind: bool,
    pub status: Status,
    /// Bit of each edge that has the whole box on its inner side.
    pub inside: u8,
}

impl Relation {
    /// The planes of a polygon and a box.
    pub fn new(polygons: &Polygons, polygon: u32, aabb: &Aabb) -> Relation {
        let corners = polygons.corners(polygon);
        let normal = polygons.get(polygon).normal;
        let edges =
            (0..corners.len()).map(|edge| EdgePlanes::new(polygons.edge(polygon, edge), normal, aabb)).collect();
        let reach = corners.iter().map(|corner| corner.length()).fold(0.0, f64::max);
        Relation {
            polygon,
            edges,
            reach: reach.max(aabb.min.length()).max(aabb.max.length()),
            heights: heights(aabb, normal),
            eye: DVec3::ZERO,
            clear: -1.0,
            from_behind: false,
            status: Status::Partial,
            inside: 0,
        }
    }

    /// Whether the kept answer holds for an eye. Margins must be those of the answer.
    pub fn holds(&self, eye: DVec3, from_behind: bool) -> bool {
        self.from_behind == from_behind && eye.distance(self.eye) < self.clear
    }

    /// Answers for an eye that is clear of the polygon's plane. Returns the number of planes looked at.
    pub fn answer(
        &mut self,
        polygons: &Polygons,
        aabb: &Aabb,
        eye: DVec3,
        from_behind: bool,
        margins: Margins,
    ) -> usize {
        (self.eye, self.from_behind, self.inside) = (eye, from_behind, 0);
        let polygon = polygons.get(self.polygon);
        let before =
            if from_behind { self.heights[1] <= polygon.heights[0] } else { self.heights[0] >= polygon.heights[1] };
        if before {
            // As long as the eye stays on its side.
            (self.status, self.clear) = (Status::None, f64::INFINITY);
            return 0;
        }
        let corners = polygons.corners(self.polygon);
        let sign = if from_behind { -1.0 } else { 1.0 };
        let scale = self.reach + eye.length();
        let farthest = eye.distance(aabb.centre()) + aabb.size().length() * 0.5 + margins.radius;
        let (mut clear, mut outside_clear) = (f64::INFINITY, None::<f64>);
        for (index, (edge, corner)) in self.edges.iter().zip(corners).enumerate() {
            if edge.normals[0] == DVec3::ZERO {
                continue;
            }
            let from = eye - *corner;
            let distances = edge.normals.map(|normal| sign * normal.dot(from));
            let (low, high) = (distances[0].min(distances[1]), distances[0].max(distances[1]));
            let rounding = edge.rounding * scale;
            let length = from.length();
            // A point at distance ρ_c from the edge's line and sine s beyond it is ρ_c·s inside of the eye's own plane
            // through the edge, and s is the eye's distance from the supporting plane over its distance from the line.
            let give = margins.angle * (length + margins.radius) * farthest / edge.gap;
            let need = margins.radius + give + rounding;
            // By how much `need` grows per metre that the eye moves, as long as it moves less than `farthest`.
            let slope = margins.angle * (2.0 * farthest + length + margins.radius) / edge.gap + edge.rounding;
            let outside = -high - margins.radius - rounding;
            if outside >= 0.0 {
                let stays = outside / (1.0 + edge.rounding);
                outside_clear = Some(outside_clear.map_or(stays, |clear| clear.max(stays)));
            } else if low >= need {
                self.inside |= 1 << index;
                clear = clear.min((low - need) / (1.0 + slope)).min(farthest);
            } else {
                clear = clear.min((need - low) / (1.0 + slope)).min(farthest);
            }
            if outside < 0.0 {
                clear = clear.min(-outside / (1.0 + edge.rounding));
            }
        }
        let all = all_edges(polygons, self.polygon);
        (self.status, self.clear) = match outside_clear {
            Some(clear) => (Status::None, clear),
            None if self.inside == all => (Status::Inside, clear),
            None => (Status::Partial, clear),
        };
        self.clear = self.clear * (1.0 - 1e-6) - 1e-9 * scale;
        2 * self.edges.len()
    }
}

impl EdgePlanes {
    fn new([from, to]: [DVec3; 2], normal: DVec3, aabb: &Aabb) -> EdgePlanes {
        let crossing = EdgePlanes { normals: [DVec3::ZERO; 2], gap: 0.0, rounding: 0.0 };
        let Some(along) = (to - from).try_normalize() else { return crossing };
        let silhouette = VERTICES[code(aabb, from)];
        let corners = aabb.corners();
        // The extreme ones around the edge's line, if all are within half a turn.
        let mut extremes: [Option<DVec3>; 2] = [None; 2];
        let mut reach = 0.0_f64;
        for vertex in (0..8).filter(|vertex| silhouette >> vertex & 1 == 1) {
            let to_vertex = corners[vertex] - from;
            reach = reach.max(to_vertex.length());
            let side = |other: DVec3| along.dot(other.cross(to_vertex));
            if extremes[0].is_none_or(|other| side(other) < 0.0) {
                extremes[0] = Some(to_vertex);
            }
            if extremes[1].is_none_or(|other| side(other) > 0.0) {
                extremes[1] = Some(to_vertex);
            }
        }
        let [Some(first), Some(last)] = extremes else { return crossing };
        let normals = [first, last].map(|to_vertex| along.cross(to_vertex).normalize_or_zero());
        let [first, last] = [first, last].map(|to_vertex| to_vertex.reject_from_normalized(along).normalize_or_zero());
        // How near the box comes to the line: the best of a few directions across it is a lower bound.
        let toward = |direction: DVec3| {
            let [low, high] = heights(aabb, direction);
            let at = direction.dot(from);
            (low - at).max(at - high)
        };
        let middle = (first + last).normalize_or_zero();
        let gap = toward(middle).max(toward(normal)).max(toward(normals[0])).max(toward(normals[1]));
        let rounding = ROUNDING * (1.0 + reach / gap);
        // Each touches the box with all of it on one side, and the box is within half a turn of the line. Rounding: a box that
        // is farther from the line than this is told apart for certain.
        let scale = from.length() + reach;
        let touches = |normal: DVec3, sign: f64| {
            let [low, high] = heights(aabb, normal);
            let at = normal.dot(from);
            if sign > 0.0 { low - at >= -rounding * scale } else { high - at <= rounding * scale }
        };
        let within = gap > 1e-9 * scale && normals.iter().all(|normal| *normal != DVec3::ZERO);
        if !(within && touches(normals[0], 1.0) && touches(normals[1], -1.0)) {
            return crossing;
        }
        EdgePlanes { normals, gap: gap * (1.0 - 1e-9), rounding }
    }
}

/// Least and greatest height of a box along a direction.
pub(crate) fn heights(aabb: &Aabb, direction: DVec3) -> [f64; 2] {
    let (a, b) = (direction * aabb.min, direction * aabb.max);
    [a.min(b).element_sum(), a.max(b).element_sum()]
}

/// Whether every point of a polygon is nearer to every eye than whatever a picture shows of a box at the same place: there is a
/// direction along which the box is beyond the polygon. `farthest` is more than the distance of any point of the box.
///
/// Along one ray, what is farther along any direction that the ray goes in is farther along the ray. A pixel shows points within
/// `margins.angle` of each other: with a at height h_a on direction u and p at height h_p on direction v, |u − v| ≤ angle,
/// depth(a) ≤ h_a / (n·v − angle) < depth(p) if h_a < h_p − angle·depth(p).
pub(crate) fn is_nearer(polygons: &Polygons, index: u32, aabb: &Aabb, eye: DVec3, margins: Margins) -> bool {
    let polygon = polygons.get(index);
    let farthest = eye.distance(aabb.centre()) + aabb.size().length() * 0.5 + margins.radius;
    let scale = farthest + aabb.centre().length() + polygon.aabb.min.length() + polygon.aabb.max.length();
    let slack = margins.angle * farthest + ROUNDING * scale;
    let beyond = |of_polygon: f64, of_box: f64| {
        let (near, far) = (of_polygon + margins.radius, of_box - margins.radius);
        far > slack && near <= far * (1.0 - DEPTH_SHARE) - slack
    };
    for axis in 0..3 {
        if beyond(polygon.aabb.max[axis] - eye[axis], aabb.min[axis] - eye[axis])
            || beyond(eye[axis] - polygon.aabb.min[axis], eye[axis] - aabb.max[axis])
        {
            return true;
        }
    }
    let at = polygon.normal.dot(eye);
    let [low, high] = heights(aabb, polygon.normal);
    beyond(polygon.heights[1] - at, low - at) || beyond(at - polygon.heights[0], at - high)
}

/// The edges of a polygon, as bits, that eyes see a point on the inner side of, by the margins.
pub(crate) fn edges_around(
    polygons: &Polygons,
    index: u32,
    from_behind: bool,
    point: DVec3,
    eye: DVec3,
    margins: Margins,
) -> u8 {
    let sign = if from_behind { -1.0 } else { 1.0 };
    let inside = |&edge: &usize| sign * clearance(polygons.edge(index, edge), point, eye, margins) >= 0.0;
    (0..polygons.corners(index).len()).filter(inside).fold(0, |bits, edge| bits | 1 << edge)
}

/// One bit for each edge of a polygon.
pub(crate) fn all_edges(polygons: &Polygons, index: u32) -> u8 {
    ((1_u16 << polygons.corners(index).len()) - 1) as u8
}

/// Positive if eyes are by more than the margins on the inner side of the plane through an edge and a point, negative if they
/// are so on the outer side, NaN if neither.
fn clearance([from, to]: [DVec3; 2], point: DVec3, eye: DVec3, margins: Margins) -> f64 {
    let (along, to_point, to_eye) = (to - from, point - from, eye - from);
    let normal = along.cross(to_point);
    let length = normal.length();
    let distance = normal.dot(to_eye) / length;
    // Distance of the point from the edge's line, and what rounding makes of a normal that is nearly none.
    let gap = length / along.length();
    let scale = from.length() + to.length() + point.length() + eye.length();
    let rounding = ROUNDING * scale * (1.0 + scale / gap);
    let (to_point, to_line) = (point.distance(eye) + margins.radius, to_eye.length() + margins.radius);
    let need = margins.radius + margins.angle * to_point * to_line / gap + rounding;
    if distance.abs() >= need { distance } else { f64::NAN }
}

/// Whether no eye sees a segment and a box at one place: all of the segment is beyond some edge of the box's silhouette, by the
/// margins.
pub(crate) fn segment_is_clear([a, b]: [DVec3; 2], aabb: &Aabb, eye: DVec3, margins: Margins) -> bool {
    let code = code(aabb, eye);
    let spread = DVec3::splat(margins.radius);
    // Eyes that see different silhouettes have different answers.
    if margins.radius > 0.0 && (self::code(aabb, eye - spread) != code || self::code(aabb, eye + spread) != code) {
        return false;
    }
    let corners = aabb.corners();
    let centre = aabb.centre();
    super::silhouette::EDGES[code].iter().filter(|edge| **edge != super::silhouette::NO_EDGE).any(|&[i, j]| {
        let edge = [corners[i as usize], corners[j as usize]];
        // The eye's own plane through the edge has the box on the side of its centre.
        let inner = (edge[1] - eye).cross(edge[0] - eye).dot(centre - eye);
        if inner == 0.0 {
            return false;
        }
        // A point is on the inner side of that plane if the eye is on the inner side of the plane through edge and point.
        let beyond = |point| clearance(edge, point, eye, margins) * inner.signum() < 0.0;
        beyond(a) && beyond(b)
    })
}

#[cfg(test)]
mod tests {
    use glam::Vec3;
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64;

    use super::*;
    use crate::{Scene, Sides, Triangle};

    fn one_triangle(rng: &mut Pcg64) -> Polygons {
        let corners = std::array::from_fn(|_| Vec3::from_array(std::array::from_fn(|_| rng.random_range(-2.0..2.0))));
        let triangle = Triangle { corners, sides: Sides::Both, occludes: true };
        Polygons::build(&Scene::from_triangles(vec![triangle]), 1, 0.0)
    }

    fn point(rng: &mut Pcg64, reach: f64) -> DVec3 {
        DVec3::from_array(std::array::from_fn(|_| rng.random_range(-reach..reach)))
    }

    const EXACT: Margins = Margins { radius: 0.0, angle: 0.0 };

    #[test]
    fn planes_say_what_every_vertex_says() {
        let mut rng = Pcg64::seed_from_u64(1);
        let mut seen = [0; 3];
        for _ in 0..3000 {
            let polygons = one_triangle(&mut rng);
            let (a, half) = (point(&mut rng, 3.0), point(&mut rng, 1.0).abs() * 0.2);
            let (aabb, eye) = (Aabb::around(a, half), point(&mut rng, 6.0));
            let from_behind = polygons.get(0).normal.dot(eye) < polygons.get(0).heights[0];
            let mut relation = Relation::new(&polygons, 0, &aabb);
            relation.answer(&polygons, &aabb, eye, from_behind, EXACT);
            let sign = if from_behind { -1.0 } else { 1.0 };
            let corners = aabb.corners();
            let sides = (0..3).map(|edge| {
                let [from, to] = polygons.edge(0, edge);
                corners.map(|corner| sign * (to - eye).cross(from - eye).dot(corner - eye))
            });
            let sides: Vec<[f64; 8]> = sides.collect();
            let inside = sides.iter().all(|sides| sides.iter().all(|&side| side > 0.0));
            let outside = sides.iter().any(|sides| sides.iter().all(|&side| side < 0.0));
            let heights = corners.map(|corner| sign * polygons.get(0).normal.dot(corner));
            let plane = sign * polygons.get(0).normal.dot(polygons.corners(0)[0]);
            let before = heights.iter().all(|&height| height > plane);
            let beyond = heights.iter().all(|&height| height < plane);
            // In the plane's way an edge's line may meet the box: then nothing is claimed.
            match relation.status {
                Status::Inside => assert!(inside && !before),
                Status::None => assert!(outside || before),
                Status::Partial => assert!(!before && !(beyond && (inside || outside))),
            }
            seen[relation.status as usize] += 1;
        }
        assert!(seen.iter().all(|&count| count > 20), "{seen:?}: the test says little");
    }

    #[test]
    fn a_kept_answer_holds_as_far_as_it_says() {
        let mut rng = Pcg64::seed_from_u64(2);
        let mut moved = 0;
        for _ in 0..3000 {
            let polygons = one_triangle(&mut rng);
            let aabb = Aabb::around(point(&mut rng, 4.0), point(&mut rng, 1.0).abs() * 0.7);
            let margins = Margins { radius: 0.01, angle: 0.003 };
            let eye = point(&mut rng, 6.0);
            let behind = |eye: DVec3| polygons.get(0).normal.dot(eye) < polygons.get(0).heights[0];
            let mut relation = Relation::new(&polygons, 0, &aabb);
            relation.answer(&polygons, &aabb, eye, behind(eye), margins);
            for _ in 0..5 {
                let reach = relation.clear.clamp(0.0, 10.0);
                let near = eye + point(&mut rng, 1.0).normalize_or_zero() * reach * rng.random_range(0.9..1.0);
                if relation.holds(near, behind(near)) {
                    moved += 1;
                    let mut fresh = Relation::new(&polygons, 0, &aabb);
                    fresh.answer(&polygons, &aabb, near, behind(near), margins);
                    assert_eq!(relation.status, fresh.status);
                    assert!(relation.status == Status::None || relation.inside == fresh.inside);
                }
            }
        }
        assert!(moved > 5000, "{moved}");
    }
}
