//! Rooms with doors, and a ray caster that shares no code with the crate's.
#![allow(dead_code)]

use eyeline_visibility::{Aabb, Scene, Sides, Triangle};
use glam::{DMat3, DVec3, Vec3};
use rand::RngExt;
use rand_pcg::Pcg64;

/// How walls meet at the corners of rooms.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Corners {
    /// Walls end where they touch, with a pillar between, as in carefully made models and game maps.
    Abut,
    /// Walls run into each other.
    Overlap,
}

pub const ROOM: f64 = 6.0;
pub const HEIGHT: f64 = 3.0;

/// A building of `n` × `n` rooms of 6×6×3 m with walls of 0.2 m, a door of 1.0×2.1 m at a random place of every inner
/// wall, and in every room a table (a top and four legs). Turned by `turn` radians.
pub fn rooms(n: u32, corners: Corners, sides: Sides, turn: f64, rng: &mut Pcg64) -> Scene {
    let mut triangles = Vec::new();
    let mut add = |min: [f64; 3], max: [f64; 3]| add_box(&mut triangles, min, max, sides, turn);
    let side = f64::from(n) * ROOM;
    add([-0.1, -0.2, -0.1], [side + 0.1, 0.0, side + 0.1]);
    add([-0.1, HEIGHT, -0.1], [side + 0.1, HEIGHT + 0.2, side + 0.1]);
    let inset = if corners == Corners::Abut { 0.1 } else { -0.1 };
    for line in 0..=n {
        for cell in 0..n {
            for along_x in [true, false] {
                let (across, from) = (f64::from(line) * ROOM, f64::from(cell) * ROOM);
                let mut piece = |a: f64, b: f64, y0: f64, y1: f64| {
                    let (u, v) = ([a, across - 0.1], [b, across + 0.1]);
                    if along_x {
                        add([u[0], y0, u[1]], [v[0], y1, v[1]]);
                    } else {
                        add([u[1], y0, u[0]], [v[1], y1, v[0]]);
                    }
                };
                let (a, b) = (from + inset, from + ROOM - inset);
                if line == 0 || line == n {
                    piece(a, b, 0.0, HEIGHT);
                } else {
                    let door = from + rng.random_range(0.4..4.6);
                    piece(a, door, 0.0, HEIGHT);
                    piece(door, door + 1.0, 2.1, HEIGHT);
                    piece(door + 1.0, b, 0.0, HEIGHT);
                }
            }
        }
        if corners == Corners::Abut {
            for other in 0..=n {
                let (x, z) = (f64::from(line) * ROOM, f64::from(other) * ROOM);
                add([x - 0.1, 0.0, z - 0.1], [x + 0.1, HEIGHT, z + 0.1]);
            }
        }
    }
    for i in 0..n * n {
        let x = f64::from(i % n) * ROOM + rng.random_range(1.0..4.0);
        let z = f64::from(i / n) * ROOM + rng.random_range(1.0..4.0);
        add([x, 0.70, z], [x + 1.2, 0.74, z + 0.8]);
        for (dx, dz) in [(0.0, 0.0), (1.14, 0.0), (0.0, 0.74), (1.14, 0.74)] {
            add([x + dx, 0.0, z + dz], [x + dx + 0.06, 0.70, z + dz + 0.06]);
        }
    }
    Scene::from_triangles(triangles)
}

/// The twelve triangles of a box, turned around the y axis.
pub fn add_box(triangles: &mut Vec<Triangle>, min: [f64; 3], max: [f64; 3], sides: Sides, turn: f64) {
    let turn = DMat3::from_rotation_y(turn);
    let corner = |i: usize| -> Vec3 {
        let pick = |axis: usize| if i >> axis & 1 == 0 { min[axis] } else { max[axis] };
        (turn * DVec3::new(pick(0), pick(1), pick(2))).as_vec3()
    };
    for [a, b, c, d] in [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]] {
        for corners in [[a, b, c], [a, c, d]] {
            triangles.push(Triangle { corners: corners.map(corner), sides, occludes: true });
        }
    }
}

/// An eye at a height of 1.7 m in a random room.
pub fn random_eye(n: u32, turn: f64, rng: &mut Pcg64) -> DVec3 {
    let cell = |rng: &mut Pcg64| f64::from(rng.random_range(0..n)) * ROOM + rng.random_range(0.4..ROOM - 0.4);
    DMat3::from_rotation_y(turn) * DVec3::new(cell(rng), 1.7, cell(rng))
}

/// Rays against triangles in f64: Möller and Trumbore under a median-split tree.
pub struct Rays {
    triangles: Vec<[DVec3; 3]>,
    one_sided: Vec<bool>,
    nodes: Vec<(Aabb, usize, usize)>,
}

impl Rays {
    pub fn new(scene: &Scene) -> Rays {
        let mut all: Vec<([DVec3; 3], bool)> = scene
            .triangles()
            .iter()
            .filter(|t| t.occludes)
            .map(|t| (t.corners.map(|c| c.as_dvec3()), t.sides == Sides::Front))
            .collect();
        let mut nodes = Vec::new();
        if !all.is_empty() {
            split(&mut all, 0, &mut nodes);
        }
        let (triangles, one_sided) = all.into_iter().unzip();
        Rays { triangles, one_sided, nodes }
    }

    /// Whether something lies between `eye` and `point`.
    pub fn blocked(&self, eye: DVec3, point: DVec3) -> bool {
        let along = point - eye;
        let mut stack = if self.nodes.is_empty() { vec![] } else { vec![0] };
        while let Some(index) = stack.pop() {
            let (aabb, first, count) = self.nodes[index];
            if !segment_meets(&aabb.inflated(1e-9), eye, along) {
                continue;
            }
            if count == 0 {
                stack.extend([index + 1, first]);
            } else if (first..first + count).any(|i| self.hits(i, eye, along)) {
                return true;
            }
        }
        false
    }

    fn hits(&self, index: usize, eye: DVec3, along: DVec3) -> bool {
        let [a, b, c] = self.triangles[index];
        let (u, v) = (b - a, c - a);
        let p = along.cross(v);
        let det = u.dot(p);
        if det == 0.0 || (det < 0.0 && self.one_sided[index]) {
            return false;
        }
        let s = eye - a;
        let q = s.cross(u);
        let (beta, gamma, t) = (s.dot(p) / det, along.dot(q) / det, v.dot(q) / det);
        // A ray along a shared edge must not slip between two roundings.
        let slack = 1e-9;
        beta >= -slack && gamma >= -slack && beta + gamma <= 1.0 + slack && t > 0.0 && t < 1.0
    }
}

fn split(all: &mut [([DVec3; 3], bool)], first: usize, nodes: &mut Vec<(Aabb, usize, usize)>) {
    let box_of = |t: &[DVec3; 3]| t.iter().fold(Aabb::EMPTY, |aabb, c| aabb.with_point(*c));
    let aabb = all.iter().fold(Aabb::EMPTY, |aabb, (t, _)| aabb.union(&box_of(t)));
    let index = nodes.len();
    nodes.push((aabb, first, all.len()));
    if all.len() <= 4 {
        return;
    }
    let middles = all.iter().fold(Aabb::EMPTY, |aabb, (t, _)| aabb.with_point(box_of(t).centre()));
    let size = middles.size();
    let axis = if size.x >= size.y && size.x >= size.z {
        0
    } else if size.y >= size.z {
        1
    } else {
        2
    };
    all.sort_by(|(a, _), (b, _)| box_of(a).centre()[axis].total_cmp(&box_of(b).centre()[axis]));
    let half = all.len() / 2;
    let (left, right) = all.split_at_mut(half);
    split(left, first, nodes);
    nodes[index] = (aabb, nodes.len(), 0);
    split(right, first + half, nodes);
}

/// Whether the segment from `eye` by `along` meets the box.
pub fn segment_meets(aabb: &Aabb, eye: DVec3, along: DVec3) -> bool {
    entry(aabb, eye, along).is_some_and(|t| t <= 1.0)
}

/// Parameter at which the ray enters the box (0 if it starts inside).
pub fn entry(aabb: &Aabb, eye: DVec3, along: DVec3) -> Option<f64> {
    let (mut from, mut to) = (0.0_f64, f64::INFINITY);
    for axis in 0..3 {
        let (a, b) = (aabb.min[axis] - eye[axis], aabb.max[axis] - eye[axis]);
        if along[axis] == 0.0 {
            if a > 0.0 || b < 0.0 {
                return None;
            }
            continue;
        }
        let (t, u) = (a / along[axis], b / along[axis]);
        from = from.max(t.min(u));
        to = to.min(t.max(u));
    }
    (from <= to).then_some(from)
}
