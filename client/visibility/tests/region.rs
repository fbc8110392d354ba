//! Visibility from a ball of eyes: what is called hidden must be hidden from each of them, along every ray.

mod under_support;

use std::sync::Arc;

use eyeline_visibility::{
    Aabb, AllRound, AllRoundCells, Bound, EyeRegion, Occlusion, OctreeRules, RayScene, Scene, Sides, Triangle,
};
use glam::{DVec3, Vec3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use under_support::{Corners, ROOM, Rays, add_box, entry, random_eye, rooms};

const RADII: [f64; 6] = [0.0, 0.05, 0.15, 0.3, 0.6, 1.0];

fn direction(rng: &mut Pcg64) -> DVec3 {
    loop {
        let v = DVec3::from_array(std::array::from_fn(|_| rng.random_range(-1.0..=1.0)));
        if (0.1..1.0).contains(&v.length()) {
            return v.normalize();
        }
    }
}

/// An eye of the ball, mostly on its surface.
fn eye_in(region: EyeRegion, rng: &mut Pcg64) -> DVec3 {
    let part = if rng.random_bool(0.7) { 1.0 } else { rng.random_range(0.0..1.0) };
    region.centre + direction(rng) * (region.radius * part)
}

fn point_in(aabb: &Aabb, rng: &mut Pcg64) -> DVec3 {
    aabb.min + aabb.size() * DVec3::from_array(std::array::from_fn(|_| rng.random_range(0.0..=1.0)))
}

/// An eye of the ball and a point of the box that it sees, if random rays and rays past the edges of occluders find any.
fn witness(
    scene: &Scene,
    rays: &Rays,
    region: EyeRegion,
    aabb: &Aabb,
    count: usize,
    rng: &mut Pcg64,
) -> Option<[DVec3; 2]> {
    for _ in 0..count {
        let (eye, point) = (eye_in(region, rng), point_in(aabb, rng));
        if !rays.blocked(eye, point) {
            return Some([eye, point]);
        }
        let eye = eye_in(region, rng);
        let corners = scene.triangles()[rng.random_range(0..scene.triangles().len())].corners.map(|c| c.as_dvec3());
        let i = rng.random_range(0..3);
        let on_edge = corners[i].lerp(corners[(i + 1) % 3], rng.random_range(-0.01..1.01));
        let through = on_edge + direction(rng) * 10.0_f64.powf(rng.random_range(-6.0..-1.0));
        let along = through - eye;
        if let Some(t) = entry(aabb, eye, along)
            && !rays.blocked(eye, eye + along * t)
        {
            return Some([eye, eye + along * t]);
        }
    }
    None
}

fn random_box(around: DVec3, reach: f64, rng: &mut Pcg64) -> Aabb {
    let centre = around + direction(rng) * DVec3::new(1.0, 0.2, 1.0) * rng.random_range(0.3..reach);
    match rng.random_range(0..3) {
        0 => Aabb::around(centre.with_y(0.9), DVec3::new(0.3, 0.88, 0.3)),
        1 => Aabb::around(centre, DVec3::splat(10.0_f64.powf(rng.random_range(-3.0..0.3)))),
        _ => {
            Aabb::around(centre, DVec3::from_array(std::array::from_fn(|_| 10.0_f64.powf(rng.random_range(-2.0..0.5)))))
        }
    }
}

/// Asks about `bounds` random boxes from a region and checks each that is called hidden by `count` rays of each kind.
fn check(
    scene: &Scene,
    rays: &Rays,
    all_round: &AllRound,
    region: EyeRegion,
    side: u32,
    bounds: usize,
    count: usize,
    rng: &mut Pcg64,
) -> usize {
    let mut scratch = all_round.scratch(side);
    let occlusion = all_round.cull(region, &mut scratch).unwrap();
    let mut hidden = 0;
    for _ in 0..bounds {
        let aabb = random_box(region.centre, 12.0, rng);
        if occlusion.hides(&Bound::Box(aabb)) {
            hidden += 1;
            if let Some([eye, point]) = witness(scene, rays, region, &aabb, count, rng) {
                panic!("{aabb:?} is called hidden from {region:?} at {side} px, but {eye} sees {point}");
            }
        }
    }
    hidden
}

#[test]
fn what_is_hidden_from_a_ball_is_hidden_from_every_eye_of_it() {
    let mut rng = Pcg64::seed_from_u64(1);
    for (corners, sides, turn) in [
        (Corners::Abut, Sides::Both, 0.0),
        (Corners::Overlap, Sides::Front, 0.0),
        (Corners::Abut, Sides::Front, 0.3),
        (Corners::Overlap, Sides::Both, 1.1),
    ] {
        let scene = rooms(4, corners, sides, turn, &mut rng);
        let (rays, all_round) = (Rays::new(&scene), AllRound::new(&scene));
        let mut hidden = [0; RADII.len()];
        for (hidden, radius) in hidden.iter_mut().zip(RADII) {
            for side in [64, 128] {
                for round in 0..5 {
                    let mut centre = random_eye(4, turn, &mut rng);
                    match round {
                        // The ball touches a wall, straddles it, or is around a wall's edge (before turning).
                        1 => centre.x = (centre.x / ROOM).round() * ROOM + 0.1 + radius,
                        2 => centre.x = (centre.x / ROOM).round() * ROOM + 0.1 + radius * 0.5,
                        3 => centre = (centre / ROOM).round() * ROOM + DVec3::new(0.3, 1.7, 0.2),
                        _ => {}
                    }
                    let region = EyeRegion { centre, radius };
                    *hidden += check(&scene, &rays, &all_round, region, side, 60, 60, &mut rng);
                }
            }
        }
        println!("{corners:?} {sides:?} {turn}: {hidden:?} hidden of 600 at {RADII:?}");
        assert!(hidden.iter().all(|&hidden| hidden > 30), "{hidden:?}: the test says little");
    }
}
