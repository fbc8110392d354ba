//! The analytic scene: upright walls that go up and down for ever, so that hiding is a question in plan.

use std::sync::Arc;

use eyeline_visibility::{Aabb, Bound, Occlusion};
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
        let clear = |point: DVec2| !self.walls.iter().any(|wall| wall.grown(MARGIN).meets(eye, point));
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

    /// Whether `point` is in a wall or nearer to one than `margin`.
    pub fn blocks(&self, point: DVec3, margin: f64) -> bool {
        self.walls.iter().any(|wall| wall.contains(plan(point), margin))
    }
}

fn plan(point: DVec3) -> DVec2 {
    DVec2::new(point.x, point.z)
}

/// What walls hide from one eye: a box is hidden if it lies in the shadow of a *single* wall. The shadow of a convex thing is
/// convex, so the box's corners decide. Conservative: what only two walls together hide counts as visible.
#[derive(Clone, Debug)]
pub struct WallsFrom {
    walls: Arc<Walls>,
    eye: DVec2,
}

impl WallsFrom {
    /// The walls as seen from `eye`.
    pub fn new(walls: Arc<Walls>, eye: DVec3) -> WallsFrom {
        WallsFrom { walls, eye: plan(eye) }
    }

    fn hides_box(&self, aabb: &Aabb) -> bool {
        let (min, max) = (plan(aabb.min), plan(aabb.max));
        let corners = [min, DVec2::new(max.x, min.y), max, DVec2::new(min.x, max.y)];
        self.walls.walls.iter().any(|wall| {
            // Seen from within, a wall hides nothing.
            let shrunk = wall.grown(-MARGIN);
            !wall.contains(self.eye, MARGIN) && corners.iter().all(|&corner| shrunk.meets(self.eye, corner))
        })
    }
}

impl Occlusion for WallsFrom {
    fn hides(&self, bound: &Bound) -> bool {
        bound.aabb().is_some_and(|aabb| self.hides_box(&aabb))
    }
}
