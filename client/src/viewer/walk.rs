//! Walking: where does a person come to who wants to go there, past walls and up steps?
//!
//! The body is an upright capsule that begins a step above the feet, so that stairs do not stop it. It moves in pieces of at most
//! half its radius, and after each piece what it sinks into pushes it out sideways; a piece that ends inside something all the
//! same is not made. So it cannot get through a wall, however thin and from whichever side, unless it begins inside one. The
//! feet follow what is below them. All triangles count from both sides, whatever they look like.

use eyeline_visibility::{Aabb, Scene};
use glam::{DVec2, DVec3};

/// The static triangles, to be asked what is near. A tree of boxes; never changes once made.
pub struct Ground {
    triangles: Vec<[DVec3; 3]>,
    /// Children of node i are 2i + 1 and 2i + 2; leaves follow the order of `triangles`.
    boxes: Vec<Aabb>,
    leaves: usize,
}

/// Triangles in a leaf.
const LEAF: usize = 8;

impl Ground {
    /// Prepares a scene.
    pub fn new(scene: &Scene) -> Ground {
        let mut triangles: Vec<[DVec3; 3]> =
            scene.triangles().iter().map(|triangle| triangle.corners.map(|corner| corner.as_dvec3())).collect();
        let leaves = triangles.len().div_ceil(LEAF).max(1).next_power_of_two();
        let mut boxes = vec![Aabb::EMPTY; 2 * leaves - 1];
        // Halves by the longest axis of the middles, so that the tree is full and needs no links.
        let mut open = vec![(0, 0, triangles.len())];
        while let Some((node, from, to)) = open.pop() {
            let part = &mut triangles[from..to];
            boxes[node] = part.iter().flatten().fold(Aabb::EMPTY, |aabb, corner| aabb.with_point(*corner));
            if node >= leaves - 1 {
                continue;
            }
            // The left half fills its leaves before the right one has any, so that a leaf's triangles are known by its number.
            let depth = (node + 1).ilog2();
            let below = leaves >> (depth + 1);
            let middle = (below * LEAF).min(part.len());
            if middle < part.len() {
                let middles = part.iter().fold(Aabb::EMPTY, |aabb, triangle| aabb.with_point(centroid(triangle)));
                let axis = middles.size().max_position();
                part.select_nth_unstable_by(middle, |a, b| centroid(a)[axis].total_cmp(&centroid(b)[axis]));
            }
            open.extend([(2 * node + 1, from, from + middle), (2 * node + 2, from + middle, to)]);
        }
        Ground { triangles, boxes, leaves }
    }

    /// Calls `meet` with every triangle whose leaf's box meets `aabb`.
    fn near(&self, aabb: &Aabb, mut meet: impl FnMut(&[DVec3; 3])) {
        let mut open = vec![0];
        while let Some(node) = open.pop() {
            if self.boxes[node].is_empty() || !self.boxes[node].intersects(aabb) {
                continue;
            }
            if node < self.leaves - 1 {
                open.extend([2 * node + 1, 2 * node + 2]);
                continue;
            }
            let first = (node - (self.leaves - 1)) * LEAF;
            let end = (first + LEAF).min(self.triangles.len());
            self.triangles[first.min(end)..end].iter().for_each(&mut meet);
        }
    }

    /// Height of the highest triangle over or under a point of the plan, between two heights.
    fn height_at(&self, plan: DVec2, low: f64, high: f64) -> Option<f64> {
        let column = Aabb::new(DVec3::new(plan.x, low, plan.y), DVec3::new(plan.x, high, plan.y));
        let mut found: Option<f64> = None;
        self.near(&column, |triangle| {
            if let Some(y) = height_in(triangle, plan).filter(|y| (low..=high).contains(y)) {
                found = Some(found.map_or(y, |highest| highest.max(y)));
            }
        });
        found
    }
}

fn centroid([a, b, c]: &[DVec3; 3]) -> DVec3 {
    (a + b + c) / 3.0
}

/// Height of a triangle where a vertical line meets it; none for an upright one, or where nothing can stand.
fn height_in(triangle: &[DVec3; 3], plan: DVec2) -> Option<f64> {
    let [a, b, c] = triangle.map(|corner| DVec2::new(corner.x, corner.z) - plan);
    let (u, v, w) = (b.perp_dot(c), c.perp_dot(a), a.perp_dot(b));
    let total = u + v + w;
    let inside = (u >= 0.0 && v >= 0.0 && w >= 0.0) || (u <= 0.0 && v <= 0.0 && w <= 0.0);
    let normal = (triangle[1] - triangle[0]).cross(triangle[2] - triangle[0]).normalize_or_zero();
    if !inside || total == 0.0 || normal.y.abs() < STEEPEST {
        return None;
    }
    Some((u * triangle[0].y + v * triangle[1].y + w * triangle[2].y) / total)
}

/// Cosine of the steepest slope that one can stand on: 60°.
const STEEPEST: f64 = 0.5;

/// The point of a triangle nearest to `p`.
fn nearest_point(p: DVec3, [a, b, c]: &[DVec3; 3]) -> DVec3 {
    let normal = (b - a).cross(c - a);
    let on_edges = || {
        let edge = |from: DVec3, to: DVec3| {
            let along = to - from;
            let length = along.length_squared();
            let t = if length > 0.0 { ((p - from).dot(along) / length).clamp(0.0, 1.0) } else { 0.0 };
            from + along * t
        };
        let points = [edge(*a, *b), edge(*b, *c), edge(*c, *a)];
        points.into_iter().min_by(|x, y| x.distance_squared(p).total_cmp(&y.distance_squared(p))).unwrap_or(*a)
    };
    let area = normal.length_squared();
    if area == 0.0 {
        return on_edges();
    }
    // Inside all three edges the foot of the perpendicular is nearest.
    let inside = [[a, b], [b, c], [c, a]].iter().all(|[from, to]| normal.cross(*to - *from).dot(p - *from) >= 0.0);
    if inside { p - normal * ((p - a).dot(normal) / area) } else { on_edges() }
}

/// A body's measures in metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Body {
    /// Radius around its axis.
    pub radius: f64,
    /// From the feet to the top of the head.
    pub height: f64,
    /// From the feet to the eyes.
    pub eye: f64,
    /// The highest step that it climbs.
    pub step: f64,
}

impl Default for Body {
    /// A grown person who can get through a narrow door.
    fn default() -> Body {
        Body { radius: 0.25, height: 1.75, eye: 1.6, step: 0.45 }
    }
}

/// Somebody who walks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Walker {
    /// Where the feet are.
    pub feet: DVec3,
    /// Speed downwards, metres a second.
    falling: f64,
    /// The measures.
    pub body: Body,
}

const GRAVITY: f64 = 9.81;
const FALL_MAX: f64 = 30.0;
/// How far below the feet a floor is looked for; beyond is the void, over which one floats.
const FLOOR_REACH: f64 = 200.0;

impl Walker {
    /// Somebody with the eyes at a point.
    pub fn with_eye(eye: DVec3, body: Body) -> Walker {
        Walker { feet: eye - DVec3::Y * body.eye, falling: 0.0, body }
    }

    /// Where the eyes are.
    pub fn eye(&self) -> DVec3 {
        self.feet + DVec3::Y * self.body.eye
    }

    /// Walks with a velocity in the plan, metres a second, for so many seconds. What is no number stands still.
    pub fn walk(&mut self, ground: &Ground, velocity: DVec2, seconds: f64) {
        if !(velocity.is_finite() && seconds > 0.0 && seconds.is_finite()) {
            return;
        }
        let way = velocity * seconds;
        let pieces = (way.length() / (0.5 * self.body.radius)).ceil().clamp(1.0, 1000.0);
        // What would take more pieces is not gone at all: nobody is that fast.
        let piece = DVec3::new(way.x, 0.0, way.y) / pieces;
        let piece = piece.clamp_length_max(0.5 * self.body.radius);
        for _ in 0..pieces as usize {
            self.go(ground, piece);
            self.stand(ground, seconds / pieces);
        }
    }

    /// Makes one piece of the way, or slides along what is there, or stays.
    fn go(&mut self, ground: &Ground, piece: DVec3) {
        const PUSHES: usize = 6;
        // What is left by which it may sink in: less than walls are thick, more than rounding.
        const SLACK: f64 = 1e-3;
        if piece == DVec3::ZERO {
            return;
        }
        let depth_before = self.depth(ground, self.feet).map_or(0.0, |(depth, _)| depth);
        let mut feet = self.feet + piece;
        for _ in 0..PUSHES {
            match self.depth(ground, feet) {
                Some((_, push)) => feet += push,
                None => break,
            }
        }
        let depth = self.depth(ground, feet).map_or(0.0, |(depth, _)| depth);
        // Whoever begins inside something may leave it.
        if depth <= SLACK.max(depth_before) && feet.distance(self.feet) <= 2.0 * piece.length() + SLACK {
            self.feet = feet;
        }
    }

    /// How deep the body is in what it is in deepest, and the way out in the plan. `None` if it touches nothing.
    fn depth(&self, ground: &Ground, feet: DVec3) -> Option<(f64, DVec3)> {
        let Body { radius, height, step, .. } = self.body;
        let (low, high) = (feet.y + step + radius, (feet.y + height - radius).max(feet.y + step + radius));
        // Balls along the axis, near enough to each other to be as good as a capsule.
        let balls = ((high - low) / (0.5 * radius)).ceil().clamp(1.0, 64.0);
        let around = Aabb::new(
            DVec3::new(feet.x - radius, low - radius, feet.z - radius),
            DVec3::new(feet.x + radius, high + radius, feet.z + radius),
        );
        let mut deepest: Option<(f64, DVec3)> = None;
        ground.near(&around, |triangle| {
            for ball in 0..=balls as usize {
                let y = low + (high - low) * ball as f64 / balls;
                let middle = DVec3::new(feet.x, y, feet.z);
                let away = middle - nearest_point(middle, triangle);
                let sideways = DVec3::new(away.x, 0.0, away.z);
                let depth = radius - away.length();
                // What is straight above or below is no wall.
                if depth <= 0.0 || deepest.is_some_and(|(deepest, _)| deepest >= depth) {
                    continue;
                }
                let normal = (triangle[1] - triangle[0]).cross(triangle[2] - triangle[0]);
                let across = DVec3::new(normal.x, 0.0, normal.z);
                let out = if sideways.length() > 1e-6 { sideways } else { across };
                if let Some(out) = out.try_normalize() {
                    deepest = Some((depth, out * depth));
                }
            }
        });
        deepest
    }

    /// Puts the feet on what is below them, or falls.
    fn stand(&mut self, ground: &Ground, seconds: f64) {
        let (step, spread) = (self.body.step, 0.4 * self.body.radius);
        // The highest floor under any of five points, so that no crack swallows a foot.
        let offsets = [DVec2::ZERO, DVec2::X, DVec2::Y, DVec2::NEG_X, DVec2::NEG_Y];
        let plan = DVec2::new(self.feet.x, self.feet.z);
        let floors = offsets.iter().filter_map(|offset| {
            ground.height_at(plan + *offset * spread, self.feet.y - FLOOR_REACH, self.feet.y + step)
        });
        let Some(floor) = floors.max_by(f64::total_cmp) else {
            self.falling = 0.0;
            return;
        };
        if floor >= self.feet.y - step && self.falling == 0.0 {
            self.feet.y = floor;
            return;
        }
        self.falling = (self.falling + GRAVITY * seconds).min(FALL_MAX);
        self.feet.y -= self.falling * seconds;
        if self.feet.y <= floor {
            self.feet.y = floor;
            self.falling = 0.0;
        }
    }
}

#[cfg(test)]
mod tests {
    use eyeline_visibility::{Sides, Triangle};
    use rand::{RngExt as _, SeedableRng as _};

    use super::*;

    fn quad(corners: [[f32; 3]; 4]) -> [Triangle; 2] {
        let [a, b, c, d] = corners.map(glam::Vec3::from);
        [[a, b, c], [a, c, d]].map(|corners| Triangle { corners, sides: Sides::Front, occludes: true })
    }

    /// A floor of 10 m by 10 m at height 0 with a wall without thickness all round and one across at x = 2, and a step of 0.3 m
    /// from z = 3 on.
    fn room() -> Ground {
        let upright = |from: [f32; 2], to: [f32; 2]| {
            quad([[from[0], 0.0, from[1]], [to[0], 0.0, to[1]], [to[0], 3.0, to[1]], [from[0], 3.0, from[1]]])
        };
        let (low, high) = (-5.0, 5.0);
        let triangles = [
            quad([[low, 0.0, low], [low, 0.0, high], [high, 0.0, high], [high, 0.0, low]]),
            quad([[low, 0.3, 3.0], [low, 0.3, high], [high, 0.3, high], [high, 0.3, 3.0]]),
            upright([low, low], [high, low]),
            upright([high, low], [high, high]),
            upright([high, high], [low, high]),
            upright([low, high], [low, low]),
            upright([2.0, low], [2.0, high]),
        ];
        Ground::new(&Scene::from_triangles(triangles.concat()))
    }

    fn walker() -> Walker {
        Walker { feet: DVec3::ZERO, falling: 0.0, body: Body::default() }
    }

    #[test]
    fn nobody_gets_through_a_wall_however_fast_and_slides_along_it() {
        let ground = room();
        for speed in [0.5, 3.0, 40.0, 1e6] {
            let mut walker = walker();
            for _ in 0..200 {
                walker.walk(&ground, DVec2::new(speed, 0.0), 0.05);
            }
            assert!(walker.feet.x > 0.2 && walker.feet.x <= 2.0 - 0.249, "{speed}: {}", walker.feet);
        }
        let mut walker = walker();
        for _ in 0..40 {
            walker.walk(&ground, DVec2::new(1.5, -1.0), 0.05);
        }
        assert!(walker.feet.z < -1.5 && walker.feet.x > 1.7, "{}", walker.feet);
    }

    #[test]
    fn wherever_one_runs_one_stays_in_the_room() {
        let ground = room();
        let mut rng = rand_pcg::Pcg64Mcg::seed_from_u64(4);
        let mut walker = walker();
        for _ in 0..300 {
            let velocity =
                DVec2::from_angle(rng.random_range(0.0..std::f64::consts::TAU)) * rng.random_range(0.0..12.0);
            let seconds = rng.random_range(0.0..0.3);
            walker.walk(&ground, velocity, seconds);
            let DVec3 { x, y, z } = walker.feet;
            assert!((-4.8..=1.8).contains(&x) && z.abs() <= 4.8 && (-1e-9..=0.31).contains(&y), "{}", walker.feet);
        }
    }

    #[test]
    fn steps_are_climbed_and_falls_end_on_the_floor() {
        let ground = room();
        let mut walker = walker();
        for _ in 0..60 {
            walker.walk(&ground, DVec2::new(0.0, 1.5), 0.05);
        }
        assert_eq!(walker.feet.y, f64::from(0.3f32));
        walker.feet.y = 8.0;
        for _ in 0..100 {
            walker.walk(&ground, DVec2::ZERO, 0.05);
        }
        assert_eq!(walker.feet.y, f64::from(0.3f32));
        // Over the void one floats, and bad numbers move nobody.
        walker.feet = DVec3::new(100.0, 1.0, 0.0);
        for (velocity, seconds) in [(DVec2::ZERO, 1.0), (DVec2::NAN, 1.0), (DVec2::X, f64::NAN), (DVec2::X, -1.0)] {
            walker.walk(&ground, velocity, seconds);
            assert_eq!(walker.feet, DVec3::new(100.0, 1.0, 0.0));
        }
    }

    #[test]
    fn the_tree_finds_every_triangle_near() {
        let mut rng = rand_pcg::Pcg64Mcg::seed_from_u64(9);
        for count in [0, 1, 8, 9, 200] {
            let corner = |rng: &mut rand_pcg::Pcg64Mcg| glam::Vec3::from([0; 3].map(|_| rng.random_range(-9.0..9.0)));
            let triangles: Vec<_> = (0..count)
                .map(|_| {
                    let at = corner(&mut rng);
                    let corners = [at, at + corner(&mut rng) * 0.1, at + corner(&mut rng) * 0.1];
                    Triangle { corners, sides: Sides::Both, occludes: true }
                })
                .collect();
            let ground = Ground::new(&Scene::from_triangles(triangles.clone()));
            for _ in 0..50 {
                let aabb = Aabb::around(corner(&mut rng).as_dvec3(), DVec3::ONE);
                let mut found = 0;
                ground.near(&aabb, |triangle| {
                    let around = triangle.iter().fold(Aabb::EMPTY, |around, corner| around.with_point(*corner));
                    found += usize::from(around.intersects(&aabb));
                });
                let wanted = triangles.iter().filter(|triangle| triangle.aabb().intersects(&aabb)).count();
                assert_eq!(found, wanted);
            }
        }
    }
}
