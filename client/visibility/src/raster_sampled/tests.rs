use glam::{DQuat, DVec3, Vec3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use super::*;
use crate::{Aabb, Target};

fn view(width: u32, height: u32) -> View {
    View::level(DVec3::ZERO, 0.0, 1.5, Resolution::new(width, height))
}

fn triangle(corners: [[f32; 3]; 3]) -> Triangle {
    Triangle { corners: corners.map(Vec3::from_array), sides: Sides::Both, occludes: true }
}

fn any_view(rng: &mut Pcg64, resolution: Resolution) -> View {
    let mut unit = || rng.random_range(-1.0..1.0);
    let orientation = DQuat::from_xyzw(unit(), unit(), unit(), unit()).normalize();
    let eye = DVec3::new(unit(), unit(), unit()) * 6.0;
    View { eye, orientation, fov_x: 1.6 + unit() * 1.4, resolution, near: 0.01 }
}

fn soup(rng: &mut Pcg64, count: usize) -> Scene {
    let any = |_| {
        let at = Vec3::from_array(std::array::from_fn(|_| rng.random_range(-5.0..5.0_f32)));
        let size = 10.0_f32.powf(rng.random_range(-2.0..2.0));
        Triangle {
            corners: std::array::from_fn(|_| {
                at + size * Vec3::from_array(std::array::from_fn(|_| rng.random_range(-1.0..1.0)))
            }),
            sides: if rng.random() { Sides::Both } else { Sides::Front },
            occludes: rng.random_bool(0.8),
        }
    };
    Scene::from_triangles((0..count).map(any).collect())
}

/// A square grid of quads in front of the eye, bent in depth, split along alternating diagonals.
fn sheet(rng: &mut Pcg64, side: usize, reach: f32) -> Vec<Triangle> {
    let corners: Vec<Vec3> = (0..=side)
        .flat_map(|row| (0..=side).map(move |column| (row, column)))
        .map(|(row, column)| {
            let inner = row % side != 0 && column % side != 0;
            let mut jitter = || if inner { rng.random_range(-0.2..0.2) } else { 0.0 };
            let at = |i: usize, jitter: f32| ((i as f32 + jitter) / side as f32 * 2.0 - 1.0) * reach;
            Vec3::new(at(column, jitter()), at(row, jitter()), -3.0 - 0.1 * jitter() / side as f32)
        })
        .collect();
    let at = |row: usize, column: usize| corners[row * (side + 1) + column];
    (0..side * side)
        .flat_map(|i| {
            let (row, column) = (i / side, i % side);
            let [a, b, c, d] = [at(row, column), at(row, column + 1), at(row + 1, column + 1), at(row + 1, column)];
            if i % 2 == 0 { [[a, b, c], [a, c, d]] } else { [[a, b, d], [b, c, d]] }
        })
        .map(|corners| Triangle { corners, sides: Sides::Both, occludes: true })
        .collect()
}

#[test]
fn a_sheet_covers_each_pixel_exactly_once() {
    let mut rng = Pcg64::seed_from_u64(1);
    for (side, reach) in [(1, 5.0), (7, 5.0), (40, 5.0), (5, 1e4), (40, 2.9)] {
        let scene = Scene::from_triangles(sheet(&mut rng, side, reach));
        for resolution in
            [Resolution::new(64, 64), Resolution::new(320, 240), Resolution::new(1, 1), Resolution::new(1, 512)]
        {
            let view = View { resolution, ..view(1, 1) };
            let mut covered = vec![0; resolution.pixels()];
            for id in 0..scene.triangles().len() as u32 {
                let mut items = ItemBuffer::new(&view);
                items.draw(&scene, &[id]);
                items.ids().iter().zip(&mut covered).for_each(|(&found, count)| *count += u32::from(found == id));
            }
            if reach > 2.9 && resolution.width >= resolution.height {
                assert!(covered.iter().all(|&count| count == 1), "{side} {reach} {resolution}");
            } else {
                assert!(covered.iter().all(|&count| count <= 1));
            }
        }
    }
}

#[test]
fn the_order_of_drawing_does_not_matter() {
    let mut rng = Pcg64::seed_from_u64(2);
    for _ in 0..20 {
        let scene = soup(&mut rng, 200);
        let view = any_view(&mut rng, Resolution::new(64, 48));
        let mut forward = ItemBuffer::new(&view);
        forward.draw_all(&scene);
        let mut backward = ItemBuffer::new(&view);
        backward.draw(&scene, &(0..200).rev().collect::<Vec<u32>>());
        assert_eq!(forward.ids(), backward.ids());
        assert_eq!(forward.depths(), backward.depths());
    }
}

#[test]
fn of_equal_triangles_the_lowest_id_wins() {
    let one = triangle([[-9.0, -9.0, -2.0], [9.0, -9.0, -2.0], [0.0, 9.0, -2.0]]);
    let scene = Scene::from_triangles(vec![one; 5]);
    let mut items = ItemBuffer::new(&view(32, 32));
    items.draw(&scene, &[3, 1, 4, 2]);
    assert_eq!(items.winners(), [1]);
}

#[test]
fn the_scissor_changes_no_pixel_inside_it_and_touches_none_outside() {
    let mut rng = Pcg64::seed_from_u64(3);
    for _ in 0..50 {
        let scene = soup(&mut rng, 100);
        let view = any_view(&mut rng, Resolution::new(80, 60));
        let mut whole = ItemBuffer::new(&view);
        whole.draw_all(&scene);
        let mut corner = || [rng.random_range(0..80), rng.random_range(0..90)];
        let rect = PixelRect { x: corner(), y: corner() };
        let mut part = ItemBuffer::new(&view);
        part.set_scissor(rect);
        part.draw_all(&scene);
        for y in 0..60 {
            for x in 0..80 {
                let inside = (rect.x[0]..rect.x[1]).contains(&x) && (rect.y[0]..rect.y[1]).contains(&y);
                let at = (y * 80 + x) as usize;
                assert_eq!(part.id_at(x, y), if inside { whole.id_at(x, y) } else { None });
                assert_eq!(part.depths()[at].to_bits(), if inside { whole.depths()[at].to_bits() } else { 0 });
            }
        }
    }
}

#[test]
fn depths_are_those_of_a_point_of_the_triangle_within_a_snap() {
    let mut rng = Pcg64::seed_from_u64(4);
    let mut tested = 0;
    for _ in 0..3000 {
        let scene = soup(&mut rng, 1);
        let view = any_view(&mut rng, Resolution::new(40, 30));
        let mut items = ItemBuffer::new(&view);
        items.draw_all(&scene);
        let corners = scene.triangles()[0].corners.map(|c| c.as_dvec3());
        let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
        let [right, up, forward] = [DVec3::X, DVec3::Y, DVec3::NEG_Z].map(|axis| view.orientation * axis);
        for y in 0..30_u32 {
            for x in 0..40_u32 {
                if items.id_at(x, y).is_none() {
                    continue;
                }
                tested += 1;
                // The ray through each corner of a square of a snap around the pixel's centre: the depth lies between.
                let mut reach = [f64::INFINITY, f64::NEG_INFINITY];
                for (dx, dy) in [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)] {
                    let along = forward + right * ((f64::from(x) + 0.5 + dx / 256.0 - 20.0) / view.focal_px())
                        - up * ((f64::from(y) + 0.5 + dy / 256.0 - 15.0) / view.focal_px());
                    let z = view.near * normal.dot(along) / normal.dot(corners[0] - view.eye);
                    reach = [reach[0].min(z), reach[1].max(z)];
                }
                let z = f64::from(items.depths()[(y * 40 + x) as usize]);
                assert!(z >= reach[0] * (1.0 - 1e-5) && z <= reach[1] * (1.0 + 1e-5), "{z} not in {reach:?}");
            }
        }
    }
    assert!(tested > 10_000, "{tested}");
}

#[test]
fn single_sided_triangles_are_drawn_from_their_front_only() {
    let mut one = triangle([[-1.0, -1.0, -2.0], [1.0, -1.0, -2.0], [0.0, 1.0, -2.0]]);
    one.sides = Sides::Front;
    let winners = |corners: [Vec3; 3]| {
        let scene = Scene::from_triangles(vec![Triangle { corners, ..one }]);
        let mut items = ItemBuffer::new(&view(32, 32));
        items.draw_all(&scene);
        items.winners()
    };
    let [a, b, c] = one.corners;
    assert_eq!(winners([a, b, c]), [0]);
    assert!(winners([a, c, b]).is_empty());
}

#[test]
fn a_floor_through_the_near_plane_reaches_the_lower_edge() {
    let floor = triangle([[-1e5, -1.0, 1e5], [1e5, -1.0, 1e5], [0.0, -1.0, -1e5]]);
    let scene = Scene::from_triangles(vec![floor]);
    let mut items = ItemBuffer::new(&view(64, 64));
    items.draw_all(&scene);
    for x in 0..64 {
        assert_eq!(items.id_at(x, 63), Some(0));
        assert_eq!(items.id_at(x, 31), None);
        assert_eq!(items.id_at(x, 33), Some(0));
    }
}

#[test]
fn what_is_seen_nowhere_wins_no_pixel() {
    let mut rng = Pcg64::seed_from_u64(5);
    let (mut hidden, mut seen) = (0, 0);
    for _ in 0..60 {
        let scene = soup(&mut rng, 150);
        let resolution =
            [Resolution::new(64, 64), Resolution::new(33, 57), Resolution::new(1, 1)][rng.random_range(0..3)];
        let view = any_view(&mut rng, resolution);
        let mut depth = DepthBuffer::new(&view);
        let mut items = ItemBuffer::new(&view);
        // Query after every few triangles, so that tiles grow stale in between.
        for start in (0..150).step_by(15) {
            let batch: Vec<u32> = (start..start + 15).collect();
            let mut target = depth.target(&scene);
            target.draw(&batch);
            items.draw(&scene, &batch);
            for _ in 0..20 {
                let aabb = soup(&mut rng, 1).bounds();
                if target.sees(&aabb) {
                    seen += 1;
                    assert!(target.in_view(&aabb));
                    continue;
                }
                hidden += 1;
                // Everything in the box that could be drawn: triangles over its corners.
                let mut with = items.clone();
                let corners = aabb.corners();
                for i in 0..8 {
                    for j in 0..i {
                        for k in 0..j {
                            with.draw_corners(1000, [corners[i], corners[j], corners[k]], Sides::Both);
                        }
                    }
                }
                assert!(!with.winners().contains(&1000));
            }
        }
    }
    assert!(hidden > 500 && seen > 500, "{hidden} hidden, {seen} seen");
}

#[test]
fn glass_is_drawn_but_hides_nothing() {
    let pane = triangle([[-90.0, -90.0, -2.0], [90.0, -90.0, -2.0], [0.0, 90.0, -2.0]]);
    let behind = Aabb::around(DVec3::NEG_Z * 5.0, DVec3::ONE);
    for occludes in [true, false] {
        let scene = Scene::from_triangles(vec![Triangle { occludes, ..pane }]);
        let mut depth = DepthBuffer::new(&view(64, 64));
        depth.draw(&scene, &[0]);
        assert_eq!(depth.target(&scene).sees(&behind), !occludes);
        let mut items = ItemBuffer::new(&view(64, 64));
        items.draw_all(&scene);
        assert_eq!(items.winners(), [0]);
    }
}

#[test]
fn a_box_level_with_a_wall_is_seen() {
    let wall = triangle([[-90.0, -90.0, -2.0], [90.0, -90.0, -2.0], [0.0, 90.0, -2.0]]);
    let scene = Scene::from_triangles(vec![wall]);
    let mut depth = DepthBuffer::new(&view(64, 64));
    depth.draw(&scene, &[0]);
    let target = depth.target(&scene);
    assert!(target.sees(&Aabb::new(DVec3::new(-1.0, -1.0, -3.0), DVec3::new(1.0, 1.0, -2.0))));
    assert!(!target.sees(&Aabb::new(DVec3::new(-1.0, -1.0, -3.0), DVec3::new(1.0, 1.0, -2.001))));
    assert!(!target.sees(&Aabb::new(DVec3::new(-1.0, -1.0, 0.5), DVec3::new(1.0, 1.0, 2.0))), "behind the eye");
    assert!(target.sees(&Aabb::new(DVec3::new(-1.0, -1.0, -0.005), DVec3::new(1.0, 1.0, 2.0))), "at the near plane");
    assert!(!target.is_full());
}

#[test]
fn slivers_and_points_do_no_harm() {
    let mut rng = Pcg64::seed_from_u64(6);
    let mut items = ItemBuffer::new(&view(64, 64));
    for _ in 0..2000 {
        let mut point = || DVec3::from_array(std::array::from_fn(|_| rng.random_range(-4.0..4.0)));
        let (a, b) = (point(), point());
        items.draw_corners(1, [a, a, a], Sides::Both);
        items.draw_corners(2, [a, b, a], Sides::Both);
        items.draw_corners(3, [a, b, (a + b) * 0.5 + point() * 1e-6], Sides::Both);
        items.draw_corners(4, [a * 1e30, b * 1e30, point() * 1e-30], Sides::Both);
    }
    assert!(!items.winners().contains(&1));
    assert!(items.depths().iter().all(|z| (0.0..=1.0001).contains(z)));
}
