//! The scene of a town: upright walls, as rectangles in plan for the truth and as boxes of triangles for clients that cull.
//!
//! The truth takes walls to go up and down for ever, so that hiding is a question in plan. It shares no code with cullers.

use std::sync::Arc;

use eyeline_visibility::{Aabb, Bound, EyeRegion, Occlusion, Scene, Sides, Triangle};
use glam::{DVec2, DVec3};

/// A wall's rectangle in plan: x and z.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wall {
    /// Least corner.
    pub min: DVec2,
    /// Greatest corner.
    pub max: DVec2,
}

/// How far outward the truth moves each face, and inward the occlusion: what is visible or hidden by less is left open.
const MARGIN: f64 = 1e-6;

/// How far the boxes go up and down, metres. A bound is hidden only if all of it is behind them, and bounds grow upwards
/// too: after ten seconds by 20 m.
const HALF_HEIGHT: f64 = 64.0;

impl Wall {
    /// The wall with these corners.
    pub fn new(x0: f64, z0: f64, x1: f64, z1: f64) -> Wall {
        Wall { min: DVec2::new(x0, z0), max: DVec2::new(x1, z1) }
    }

    fn grown(&self, margin: f64) -> Wall {
        Wall { min: self.min - margin, max: self.max + margin }
    }

    /// Whether `point` lies in the wall, or within `margin` of it along an axis.
    pub fn contains(&self, point: DVec2, margin: f64) -> bool {
        let wall = self.grown(margin);
        point.cmpge(wall.min).all() && point.cmple(wall.max).all()
    }

    /// The four corners, around it.
    pub fn corners(&self) -> [DVec2; 4] {
        [self.min, DVec2::new(self.max.x, self.min.y), self.max, DVec2::new(self.min.x, self.max.y)]
    }

    /// Whether the segment meets the closed rectangle (slabs, Kay & Kajiya 1986).
    fn meets(&self, from: DVec2, to: DVec2) -> bool {
        let (mut enter, mut leave) = (0.0f64, 1.0f64);
        for axis in 0..2 {
            let (start, step) = (from[axis], to[axis] - from[axis]);
            if step == 0.0 {
                if start < self.min[axis] || start > self.max[axis] {
                    return false;
                }
                continue;
            }
            let (near, far) = ((self.min[axis] - start) / step, (self.max[axis] - start) / step);
            enter = enter.max(near.min(far));
            leave = leave.min(near.max(far));
            if enter > leave {
                return false;
            }
        }
        true
    }

    /// Its four sides as triangles, two each. Nobody gets above or below it.
    fn triangles(&self) -> impl Iterator<Item = Triangle> {
        let corners = self.corners();
        (0..4).flat_map(move |side| {
            let at = |corner: usize, y: f64| {
                let corner = corners[corner % 4];
                DVec3::new(corner.x, y, corner.y).as_vec3()
            };
            let (low, high) = (-HALF_HEIGHT, HALF_HEIGHT);
            let quad = [at(side, low), at(side + 1, low), at(side + 1, high), at(side, high)];
            let triangle = |corners| Triangle { corners, sides: Sides::Both, occludes: true };
            [triangle([quad[0], quad[1], quad[2]]), triangle([quad[0], quad[2], quad[3]])]
        })
    }
}

/// A scene of walls.
#[derive(Clone, Debug, Default)]
pub struct Walls {
    /// The walls.
    pub walls: Vec<Wall>,
}

impl Walls {
    /// The truth, by dense sampling: whether some point of the disc (an upright cylinder in plan) is clear of every wall by a
    /// margin, as seen from `eye`. Never says yes wrongly; may miss a sliver.
    pub fn sees_disc(&self, eye: DVec3, centre: DVec3, radius: f64) -> bool {
        let (eye, centre) = (plan(eye), plan(centre));
        let to = centre - eye;
        let distance = to.length();
        if distance <= radius {
            return true;
        }
        let clear = |point: DVec2| self.is_clear(eye, point);
        // The points where the disc's outline is touched by lines from the eye: what comes into view first.
        let along = to / distance;
        let cosine = radius / distance;
        let sine = (1.0 - cosine * cosine).sqrt();
        let across = along.perp();
        for side in [1.0, -1.0] {
            if clear(centre + radius * (1.0 - 1e-9) * (across * (side * sine) - along * cosine)) {
                return true;
            }
        }
        if clear(centre) {
            return true;
        }
        (0..10).any(|i| clear(centre + 0.95 * radius * DVec2::from_angle(f64::from(i) * std::f64::consts::TAU / 10.0)))
    }

    /// Whether no wall, made larger by a margin, is between these places in plan.
    pub fn is_clear(&self, from: DVec2, to: DVec2) -> bool {
        !self.walls.iter().any(|wall| wall.grown(MARGIN).meets(from, to))
    }

    /// Whether `point` is in a wall or nearer to one than `margin`.
    pub fn blocks(&self, point: DVec3, margin: f64) -> bool {
        self.walls.iter().any(|wall| wall.contains(plan(point), margin))
    }

    /// The walls as boxes of triangles. What these hide, the truth takes for hidden only if corners are exact in `f32`.
    pub fn scene(&self) -> Scene {
        Scene::from_triangles(self.walls.iter().flat_map(Wall::triangles).collect())
    }
}

/// x and z.
pub(super) fn plan(point: DVec3) -> DVec2 {
    DVec2::new(point.x, point.z)
}

/// What walls hide from one eye, or from every eye of a ball: a box is hidden if it lies in the shadow of a *single* wall.
///
/// The shadow of a convex thing is convex, and so is the set of eyes from which it hides a point. So the corners of the box
/// and those of a square around the ball decide. Conservative: what only two walls together hide counts as visible.
#[derive(Clone, Debug)]
pub struct WallsFrom {
    walls: Arc<Walls>,
    eye: DVec2,
    radius: f64,
}

impl WallsFrom {
    /// The walls as seen from `region`.
    pub fn new(walls: Arc<Walls>, region: EyeRegion) -> WallsFrom {
        WallsFrom { walls, eye: plan(region.centre), radius: region.radius }
    }

    fn hides_box(&self, aabb: &Aabb) -> bool {
        let (min, max) = (plan(aabb.min), plan(aabb.max));
        let corners = Wall { min, max }.corners();
        let eyes = Wall { min: self.eye, max: self.eye }.grown(self.radius).corners();
        let eyes = if self.radius > 0.0 { &eyes[..] } else { &eyes[..1] };
        self.walls.walls.iter().any(|wall| {
            // Seen from within, a wall hides nothing.
            let shrunk = wall.grown(-MARGIN);
            !wall.contains(self.eye, MARGIN + self.radius)
                && corners.iter().all(|&corner| eyes.iter().all(|&eye| shrunk.meets(eye, corner)))
        })
    }
}

impl Occlusion for WallsFrom {
    fn hides(&self, bound: &Bound) -> bool {
        bound.aabb().is_some_and(|aabb| self.hides_box(&aabb))
    }
}
