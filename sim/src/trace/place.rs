//! Puts a recording's ground plane into a scene.
//!
//! Seen from above with −Z up the page, the plane lies as it was recorded: its x is the world's +X and its y the world's −Z,
//! turned about +Y by `heading`. A scale other than 1 scales everybody's speed with it.

use std::f64::consts::FRAC_PI_2;

use glam::{DQuat, DVec2, DVec3};

use super::Trace;

/// Where a recording's plane lies in the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placement {
    /// Where the plane's origin is, in metres; its y is the height of all feet.
    pub origin: DVec3,
    /// Turn about +Y, in radians.
    pub heading: f64,
    /// World metres a recorded metre.
    pub scale: f64,
}

/// π·(3 − √5), radians.
const GOLDEN_ANGLE: f64 = 2.399_963_229_728_653;

impl Default for Placement {
    fn default() -> Placement {
        Placement { origin: DVec3::ZERO, heading: 0.0, scale: 1.0 }
    }
}

impl Placement {
    /// Feet in the world of somebody at a place of the plane.
    pub fn feet(&self, (x, y): (f64, f64)) -> DVec3 {
        self.origin + DQuat::from_rotation_y(self.heading) * (DVec3::new(x, 0.0, -y) * self.scale)
    }

    /// Turn about +Y (0 looks along −Z) of somebody who faces a direction of the plane ([`Trace::facing_at`]).
    pub fn yaw(&self, facing: f64) -> f64 {
        facing - FRAC_PI_2 + self.heading
    }

    /// Greatest speed in the world of a recording's people, in metres a second.
    pub fn speed_max(&self, trace: &Trace) -> f64 {
        trace.speed_max() * self.scale.abs()
    }

    /// Puts the middle of the ground that a recording covers onto the most central of a scene's places (the one with the
    /// least sum of distances to the others), at scale 1. A place is used rather than the middle of them all because
    /// that may be in a wall, in the void or between two storeys. `None` without a place.
    pub fn fit(trace: &Trace, places: &[DVec3]) -> Option<Placement> {
        Placement::spread(trace, places, 1).pop()
    }

    /// `count` such placements (fewer where there are fewer places): each further one at the place that is farthest from all
    /// before it, turned by the golden angle, so that no two look alike.
    pub fn spread(trace: &Trace, places: &[DVec3], count: usize) -> Vec<Placement> {
        let sum = |from: &DVec3| places.iter().map(|place| place.distance(*from)).sum::<f64>();
        let central = places.iter().map(|place| (sum(place), *place)).min_by(|a, b| a.0.total_cmp(&b.0));
        let mut taken: Vec<DVec3> = central.into_iter().map(|(_, place)| place).collect();
        while taken.len() < count.min(places.len()) {
            let apart = |place: &DVec3| taken.iter().map(|other| other.distance(*place)).fold(f64::INFINITY, f64::min);
            match places.iter().max_by(|a, b| apart(a).total_cmp(&apart(b))) {
                Some(&place) if !taken.contains(&place) => taken.push(place),
                _ => break,
            }
        }
        taken.truncate(count);
        let (min, max) = trace.ground();
        let DVec2 { x, y } = (min + max) * 0.5;
        let placed = |(i, place): (usize, &DVec3)| {
            let heading = GOLDEN_ANGLE * i as f64;
            let origin = *place - DQuat::from_rotation_y(heading) * DVec3::new(x, 0.0, -y);
            Placement { origin, heading, scale: 1.0 }
        };
        taken.iter().enumerate().map(placed).collect()
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    fn close(a: DVec3, b: DVec3) -> bool {
        a.distance(b) < 1e-12
    }

    #[test]
    fn the_plane_lies_as_seen_from_above() {
        let flat = Placement { origin: DVec3::new(10.0, 2.0, 20.0), ..Placement::default() };
        assert!(close(flat.feet((1.0, 3.0)), DVec3::new(11.0, 2.0, 17.0)));
        // A quarter turn about +Y takes +X to −Z.
        let turned = Placement { heading: FRAC_PI_2, scale: 2.0, ..flat };
        assert!(close(turned.feet((1.0, 0.0)), DVec3::new(10.0, 2.0, 18.0)));
    }

    #[test]
    fn people_look_where_they_go() {
        for heading in [0.0, 0.7, -2.0] {
            let placement = Placement { heading, ..Placement::default() };
            for facing in [0.0_f64, 1.0, 2.0, -2.5] {
                let step = placement.feet((facing.cos(), facing.sin())) - placement.origin;
                let yaw = placement.yaw(facing);
                assert!(close(step, DVec3::new(-yaw.sin(), 0.0, -yaw.cos())));
            }
        }
    }

    #[test]
    fn fit_centres_the_ground_on_the_most_central_place() {
        let text = b"1 0 100 200 0\n1 16 200 400 0\n1 32 300 400 0\n";
        let trace = Trace::parse(Path::new("walk.txt"), text).unwrap();
        let places = [DVec3::ZERO, DVec3::new(5.0, 1.0, 5.0), DVec3::new(9.0, 0.0, 4.0)];
        let placement = Placement::fit(&trace, &places).unwrap();
        assert!(close(placement.feet((2.0, 3.0)), places[1]));
        assert_eq!(Placement::fit(&trace, &[]), None);
        assert_eq!(Placement { scale: 2.0, ..placement }.speed_max(&trace), 2.0 * trace.speed_max());
    }
}
