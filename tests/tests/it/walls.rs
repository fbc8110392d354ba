//! The scene of the other tests is itself tested: what it hides can't be seen.

use std::sync::Arc;

use eyeline_sim::soak::{Wall, Walls, WallsFrom};
use eyeline_visibility::{Aabb, Bound, EyeRegion, Occlusion};
use glam::DVec3;
use proptest::prelude::*;

fn wall() -> impl Strategy<Value = Wall> {
    (-10.0..10.0f64, -10.0..10.0f64, 0.1..8.0f64, 0.1..8.0f64)
        .prop_map(|(x, z, width, depth)| Wall::new(x, z, x + width, z + depth))
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2_000))]

    #[test]
    fn what_walls_hide_is_never_seen(
        walls in prop::collection::vec(wall(), 1..6),
        eye in prop::array::uniform2(-15.0..15.0f64),
        centre in prop::array::uniform2(-15.0..15.0f64),
        radius in 0.0..3.0f64,
    ) {
        let walls = Arc::new(Walls { walls });
        let eye = DVec3::new(eye[0], 1.6, eye[1]);
        let centre = DVec3::new(centre[0], 0.0, centre[1]);
        let aabb = Aabb::new(centre - DVec3::new(radius, 0.0, radius), centre + DVec3::new(radius, 1.0, radius));
        if WallsFrom::new(walls.clone(), EyeRegion::point(eye)).hides(&Bound::Box(aabb)) {
            prop_assert!(!walls.sees_disc(eye, centre, radius));
        }
    }
}

#[test]
fn a_wall_hides_what_is_behind_it_and_nothing_else() {
    let walls = Arc::new(Walls { walls: vec![Wall::new(-5.0, -5.1, 5.0, -4.9)] });
    let occlusion = WallsFrom::new(walls.clone(), EyeRegion::point(DVec3::Y));
    let hides = |x: f64, z: f64| {
        let centre = DVec3::new(x, 0.0, z);
        occlusion.hides(&Bound::Box(Aabb::around(centre, DVec3::splat(0.3))))
    };
    assert!(hides(0.0, -10.0) && hides(9.0, -10.0) && !hides(10.0, -10.0) && !hides(0.0, -4.0) && !hides(0.0, 10.0));
    assert!(walls.sees_disc(DVec3::Y, DVec3::new(10.2, 0.0, -10.0), 0.3));
    assert!(!walls.sees_disc(DVec3::Y, DVec3::new(9.0, 0.0, -10.0), 0.3));
    assert!(!occlusion.hides(&Bound::Everywhere));
}
