//! Where does somebody get to whose recorded step leads through a wall? Recordings know nothing of the world that they are put into:
//! who meets a wall slides along it, and goes on from there by the steps that were recorded.

use std::sync::Arc;

use eyeline_visibility::{RayScene, Scene};
use glam::DVec3;

/// What stands in the way of people.
pub struct Obstacles {
    scene: Arc<Scene>,
    rays: RayScene,
    /// Half the width of a person, metres.
    radius: f64,
    /// Heights above the feet at which walls are felt for, metres.
    heights: [f64; 2],
}

/// Walls that are met at so flat an angle that the way to them is longer than so many half widths are felt later.
const OBLIQUE: f64 = 4.0;

/// What is stepped over, metres.
const STEP_OVER: f64 = 0.4;

impl Obstacles {
    /// The obstacles of a scene for people of this radius and height, metres.
    pub fn new(scene: Arc<Scene>, radius: f64, height: f64) -> Obstacles {
        let rays = RayScene::new(&scene);
        Obstacles { scene, rays, radius, heights: [STEP_OVER.min(height), 0.6 * height] }
    }

    /// Where somebody whose feet are at `from` (metres, relative to the anchor) gets to who wants to go `by`, and whether a
    /// wall was in the way.
    pub fn step(&self, from: DVec3, by: DVec3) -> (DVec3, bool) {
        let Some((free, normal)) = self.meets(from, by) else { return (from + by, false) };
        let length = by.length();
        let at = from + by * (free / length);
        // Along the wall, if that is free; else there is a corner.
        let rest = by * ((length - free) / length);
        let along = rest - normal * rest.dot(normal);
        let moved = match self.meets(at, along) {
            None => along,
            Some((free, _)) => along * (free / along.length()),
        };
        (at + moved, true)
    }

    /// How far one gets along `by` before a wall, and its horizontal normal; `None` if nothing is in the way.
    fn meets(&self, from: DVec3, by: DVec3) -> Option<(f64, DVec3)> {
        let length = by.length();
        if length.is_nan() || length <= 1e-9 {
            return None;
        }
        let direction = by / length;
        let mut nearest: Option<(f64, DVec3)> = None;
        for height in self.heights {
            let hit = self.rays.first_hit(from + DVec3::Y * height, direction, 0.0, length + OBLIQUE * self.radius);
            let Some(hit) = hit else { continue };
            let [a, b, c] = self.scene.triangles()[hit.primitive as usize].corners.map(|corner| corner.as_dvec3());
            let normal = (b - a).cross(c - a).with_y(0.0).normalize_or_zero();
            // Against the step, whichever side is met; what has no side in plan stops it.
            let normal = if normal == DVec3::ZERO { -direction } else { normal * -normal.dot(direction).signum() };
            // Half a width from the wall, not along the step.
            let free = (hit.t - self.radius / -normal.dot(direction).min(-1.0 / OBLIQUE)).max(0.0);
            if free >= length {
                continue;
            }
            if nearest.is_none_or(|(known, _)| free < known) {
                nearest = Some((free, normal));
            }
        }
        nearest
    }
}

#[cfg(test)]
mod tests {
    use eyeline_visibility::{Sides, Triangle};
    use glam::Vec3;

    use super::*;

    /// A wall across x = 2, from z = −10 to 10.
    fn wall() -> Obstacles {
        let corner = |y: f32, z: f32| Vec3::new(2.0, y, z);
        let triangle = |corners| Triangle { corners, sides: Sides::Both, occludes: true };
        let triangles = vec![
            triangle([corner(0.0, -10.0), corner(3.0, -10.0), corner(3.0, 10.0)]),
            triangle([corner(0.0, -10.0), corner(3.0, 10.0), corner(0.0, 10.0)]),
        ];
        Obstacles::new(Arc::new(Scene::from_triangles(triangles)), 0.3, 1.75)
    }

    #[test]
    fn nobody_walks_through_a_wall() {
        let wall = wall();
        let (mut at, mut slid) = (DVec3::ZERO, 0);
        for _ in 0..100 {
            let (next, hit) = wall.step(at, DVec3::new(0.07, 0.0, 0.03));
            slid += u32::from(hit);
            at = next;
        }
        assert!((at.x - 1.7).abs() < 1e-6, "{at}");
        assert!((at.z - 3.0).abs() < 1e-6, "along the wall it goes on: {at}");
        assert!(slid > 70);
    }

    #[test]
    fn a_free_step_is_taken_as_it_was_recorded() {
        let by = DVec3::new(-0.1, 0.0, 0.2);
        assert_eq!(wall().step(DVec3::ZERO, by), (by, false));
        assert_eq!(wall().step(DVec3::ZERO, DVec3::ZERO), (DVec3::ZERO, false));
        assert!(!wall().step(DVec3::ZERO, DVec3::splat(f64::NAN)).1);
    }
}
