use glam::{DQuat, DVec3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use super::*;
use crate::{DepthBuffer, Face, ItemBuffer, Resolution, Scene, Triangle};

const RESOLUTIONS: [(u32, u32); 6] = [(1, 1), (1, 64), (33, 17), (64, 64), (70, 3), (320, 240)];

fn levels() -> Vec<SimdLevel> {
    let best = SimdLevel::new();
    let mut levels = vec![SimdLevel::baseline()];
    #[cfg(any(target_arch = "x86", target_arch = "x86_64"))]
    {
        levels.extend(best.as_sse4_2().map(SimdLevel::Sse4_2));
        levels.extend(best.as_avx2().map(SimdLevel::Avx2));
    }
    levels.push(best);
    levels
}

fn any_view(rng: &mut Pcg64, resolution: (u32, u32)) -> View {
    let mut unit = || rng.random_range(-1.0..1.0);
    let orientation = DQuat::from_xyzw(unit(), unit(), unit(), unit()).normalize();
    let eye = DVec3::new(unit(), unit(), unit()) * 6.0;
    let resolution = Resolution::new(resolution.0, resolution.1);
    View { eye, orientation, fov_x: 1.6 + unit() * 1.4, resolution, near: 0.01 }
}

fn any_resolution(rng: &mut Pcg64) -> (u32, u32) {
    RESOLUTIONS[rng.random_range(0..RESOLUTIONS.len())]
}

fn any_point(rng: &mut Pcg64, reach: f64) -> DVec3 {
    DVec3::from_array(std::array::from_fn(|_| rng.random_range(-reach..reach)))
}

/// Triangles of all sizes, slivers and near-plane crossers among them.
fn any_triangle(rng: &mut Pcg64) -> [DVec3; 3] {
    let at = any_point(rng, 5.0);
    let size = 10.0_f64.powf(rng.random_range(-2.0..2.5));
    let mut corners: [DVec3; 3] = std::array::from_fn(|_| at + any_point(rng, 1.0) * size);
    if rng.random_bool(0.2) {
        corners[2] = corners[0].lerp(corners[1], rng.random_range(-0.5..1.5)) + any_point(rng, 1e-3);
    }
    corners
}

fn any_sides(rng: &mut Pcg64) -> Sides {
    if rng.random() { Sides::Both } else { Sides::Front }
}

/// A convex loop of 3 to 8 corners, planar up to rounding.
fn any_loop(rng: &mut Pcg64) -> Vec<DVec3> {
    let count = rng.random_range(3..=8);
    let at = any_point(rng, 6.0);
    let (u, v) = (any_point(rng, 1.0).normalize(), any_point(rng, 1.0).normalize());
    let size = 10.0_f64.powf(rng.random_range(-1.5..1.7));
    let mut angles: Vec<f64> = (0..count).map(|_| rng.random_range(0.0..std::f64::consts::TAU)).collect();
    angles.sort_by(f64::total_cmp);
    angles.into_iter().map(|angle| at + (u * angle.cos() + v * angle.sin()) * size).collect()
}

fn draw_fan(items: &mut ItemBuffer, id: u32, corners: &[DVec3], sides: Sides) {
    for i in 2..corners.len() {
        items.draw_corners(id, [corners[0], corners[i - 1], corners[i]], sides);
    }
}

/// The faces of a box as triangles, two-sided.
fn draw_box(items: &mut ItemBuffer, id: u32, aabb: &Aabb) {
    let corners = aabb.corners();
    for [a, b, c, d] in [[0, 1, 3, 2], [4, 5, 7, 6], [0, 1, 5, 4], [2, 3, 7, 6], [0, 2, 6, 4], [1, 3, 7, 5]] {
        draw_fan(items, id, &[corners[a], corners[b], corners[c], corners[d]], Sides::Both);
    }
}

/// A ball's surface, all corners on it.
fn draw_ball(items: &mut ItemBuffer, id: u32, centre: DVec3, radius: f64) {
    const RINGS: usize = 8;
    let at = |ring: usize, step: usize| {
        let (polar, turn) = (ring as f64 / RINGS as f64, step as f64 / RINGS as f64);
        let (polar, turn) = (polar * std::f64::consts::PI, turn * std::f64::consts::PI);
        centre + radius * DVec3::new(polar.sin() * turn.cos(), polar.cos(), polar.sin() * turn.sin())
    };
    for ring in 0..RINGS {
        for step in 0..2 * RINGS {
            let quad = [at(ring, step), at(ring, step + 1), at(ring + 1, step + 1), at(ring + 1, step)];
            draw_fan(items, id, &quad, Sides::Both);
        }
    }
}

fn depths(image: &MaskedDepth) -> Vec<f32> {
    let (width, height) = (image.tiles.width as u32, image.tiles.height as u32);
    (0..height).flat_map(|y| (0..width).map(move |x| (x, y))).map(|(x, y)| image.tiles.depth_at(x, y)).collect()
}

#[test]
fn a_triangle_covers_the_pixels_that_the_item_buffer_gives_it() {
    let mut rng = Pcg64::seed_from_u64(1);
    let mut image = MaskedDepth::new(Coverage::Sampled);
    let mut covered = 0;
    for _ in 0..6000 {
        let resolution = any_resolution(&mut rng);
        let view = any_view(&mut rng, resolution);
        let (corners, sides) = (any_triangle(&mut rng), any_sides(&mut rng));
        let mut items = ItemBuffer::new(&view);
        items.draw_corners(0, corners, sides);
        image.begin(&view);
        image.draw_polygon(&corners, sides);
        // A lone triangle's depth may round down to nothing, so its mask is asked.
        for y in 0..resolution.1 {
            for x in 0..resolution.0 {
                let drawn = items.id_at(x, y).is_some();
                covered += usize::from(drawn);
                assert_eq!(image.tiles.covers(x, y), drawn, "{x} {y} {view:?} {corners:?} {sides:?}");
            }
        }
    }
    assert!(covered > 100_000, "{covered}");
}

#[test]
fn no_pixel_is_closed_nearer_than_the_item_buffer_has_it() {
    let mut rng = Pcg64::seed_from_u64(2);
    let mut image = MaskedDepth::new(Coverage::Sampled);
    let (mut closed, mut drawn) = (0, 0);
    for round in 0..400 {
        let view = any_view(&mut rng, RESOLUTIONS[round % RESOLUTIONS.len()]);
        let mut items = ItemBuffer::new(&view);
        image.begin(&view);
        for _ in 0..40 {
            let sides = any_sides(&mut rng);
            let mut corners = if rng.random() { any_loop(&mut rng) } else { any_triangle(&mut rng).to_vec() };
            if rng.random_bool(0.3) {
                // Dented, twisted and crossed loops.
                corners.iter_mut().for_each(|corner| *corner += any_point(&mut rng, 0.5));
            }
            draw_fan(&mut items, 0, &corners, sides);
            image.draw_polygon(&corners, sides);
        }
        for (z, exact) in depths(&image).into_iter().zip(items.depths()) {
            assert!(z <= *exact * (1.0 + 1e-6), "{z} {exact} {view:?}");
            closed += usize::from(z > 0.0);
            drawn += usize::from(*exact > 0.0);
        }
    }
    // Most of what is covered is closed.
    assert!(closed * 10 > drawn * 8 && drawn > 100_000, "{closed} of {drawn}");
}

/// A box that may be anywhere: small, large, far, and where something else begins.
fn any_box(rng: &mut Pcg64, near: &[DVec3]) -> Aabb {
    let half = DVec3::from_array(std::array::from_fn(|_| 10.0_f64.powf(rng.random_range(-2.0..0.7))));
    let centre = match near.get(rng.random_range(0..near.len() * 2 + 1)) {
        Some(&corner) => corner + any_point(rng, 1.0) * half,
        None => {
            let reach = 10.0_f64.powf(rng.random_range(0.5..2.0));
            any_point(rng, reach)
        }
    };
    Aabb::around(centre, half)
}

#[test]
fn what_it_hides_wins_no_pixel() {
    let mut rng = Pcg64::seed_from_u64(3);
    let mut image = MaskedDepth::new(Coverage::Sampled);
    let mut hidden = [0; 3];
    for round in 0..260 {
        let view = any_view(&mut rng, RESOLUTIONS[round % RESOLUTIONS.len()]);
        let mut items = ItemBuffer::new(&view);
        image.begin(&view);
        let mut near = Vec::new();
        for _ in 0..rng.random_range(2..60) {
            let corners = any_loop(&mut rng);
            draw_fan(&mut items, 0, &corners, Sides::Both);
            image.draw_polygon(&corners, Sides::Both);
            near.extend(corners);
        }
        for _ in 0..60 {
            let aabb = any_box(&mut rng, &near);
            if !image.sees_box(&aabb) {
                let mut with = items.clone();
                draw_box(&mut with, 9, &aabb);
                assert!(!with.ids().contains(&9), "{view:?} {aabb:?}");
                hidden[0] += usize::from(image.in_view(&aabb));
            }
            let (centre, radius) = (aabb.centre(), aabb.size().x * 0.5);
            if !image.sees_ball(centre, radius) {
                let mut with = items.clone();
                draw_ball(&mut with, 9, centre, radius);
                assert!(!with.ids().contains(&9), "{view:?} {centre:?} {radius}");
                hidden[1] += usize::from(image.in_view(&aabb));
            }
            let corners = any_loop(&mut rng);
            if !image.sees_polygon(&corners) {
                let mut with = items.clone();
                draw_fan(&mut with, 9, &corners, Sides::Both);
                assert!(!with.ids().contains(&9), "{view:?} {corners:?}");
                hidden[2] += 1;
            }
        }
    }
    assert!(hidden.iter().all(|&count| count > 500), "{hidden:?}");
}

#[test]
fn under_coverage_holds_at_every_finer_resolution() {
    let mut rng = Pcg64::seed_from_u64(4);
    let mut image = MaskedDepth::new(Coverage::Under);
    let mut hidden = 0;
    for round in 0..160 {
        let view = any_view(&mut rng, [(64, 32), (33, 17), (8, 8)][round % 3]);
        image.begin(&view);
        let mut drawn = Vec::new();
        for _ in 0..rng.random_range(1..12) {
            let corners = any_loop(&mut rng);
            image.draw_polygon(&corners, Sides::Both);
            drawn.push(corners);
        }
        let near: Vec<DVec3> = drawn.iter().flatten().copied().collect();
        let boxes: Vec<Aabb> = (0..60).map(|_| any_box(&mut rng, &near)).collect();
        let boxes: Vec<&Aabb> = boxes.iter().filter(|aabb| image.in_view(aabb) && !image.sees_box(aabb)).collect();
        hidden += boxes.len();
        for finer in [1, 2, if round % 4 == 0 { 16 } else { 3 }] {
            let Resolution { width, height } = view.resolution;
            let fine = View { resolution: Resolution::new(width * finer, height * finer), ..view };
            let mut items = ItemBuffer::new(&fine);
            drawn.iter().for_each(|corners| draw_fan(&mut items, 0, corners, Sides::Both));
            boxes.iter().for_each(|aabb| draw_box(&mut items, 9, aabb));
            assert!(!items.ids().contains(&9), "{view:?} {finer}");
            // Closed pixels are closed that near in all of their square.
            for y in 0..height * finer {
                for x in 0..width * finer {
                    let z = image.tiles.depth_at(x / finer, y / finer);
                    let exact = items.depths()[(y * width * finer + x) as usize];
                    assert!(z <= exact * (1.0 + 1e-6), "{z} {exact} at {x} {y} of {fine:?}");
                }
            }
        }
    }
    assert!(hidden > 150, "{hidden}");
}

#[test]
fn all_levels_agree_bit_for_bit() {
    let mut rng = Pcg64::seed_from_u64(5);
    let images = |coverage| levels().into_iter().map(move |level| MaskedDepth::with_level(coverage, level));
    for coverage in [Coverage::Sampled, Coverage::Under] {
        let mut images: Vec<MaskedDepth> = images(coverage).collect();
        for _ in 0..60 {
            let resolution = any_resolution(&mut rng);
            let view = any_view(&mut rng, resolution);
            images.iter_mut().for_each(|image| image.begin(&view));
            for _ in 0..40 {
                let corners = any_loop(&mut rng);
                images.iter_mut().for_each(|image| image.draw_polygon(&corners, Sides::Both));
                let aabb = any_box(&mut rng, &corners);
                let bound = Bound::Sphere { centre: aabb.centre(), radius: aabb.size().y };
                let corners = any_loop(&mut rng);
                let answers = |image: &MaskedDepth| {
                    [image.sees_box(&aabb), image.sees(&bound), image.sees_polygon(&corners), image.in_view(&aabb)]
                };
                let all: Vec<[bool; 4]> = images.iter().map(answers).collect();
                for (image, answer) in images.iter().zip(&all) {
                    assert_eq!(*answer, all[0], "{:?} {view:?} {aabb:?} {corners:?}", image.level);
                }
            }
            let bits = |image: &MaskedDepth| depths(image).into_iter().map(f32::to_bits).collect::<Vec<_>>();
            let first = bits(&images[0]);
            for image in &images {
                assert_eq!(image.stats(), images[0].stats(), "{:?}", image.level);
                assert!(bits(image) == first, "{:?}", image.level);
            }
        }
    }
}

/// Rooms of 6 × 3 × 6 m with doors, as quads seen from either side: walls 0.2 m thick, floors and ceilings.
fn rooms(rng: &mut Pcg64, side: usize) -> Vec<[DVec3; 4]> {
    let mut quads = Vec::new();
    let reach = side as f64 * 6.0;
    for y in [0.0, 3.0] {
        quads.push([
            DVec3::new(0.0, y, 0.0),
            DVec3::new(reach, y, 0.0),
            DVec3::new(reach, y, reach),
            DVec3::new(0.0, y, reach),
        ]);
    }
    for line in 0..=side {
        for room in 0..side {
            for turned in [false, true] {
                let start = room as f64 * 6.0;
                let door = start + rng.random_range(0.5..4.5);
                let inner = line > 0 && line < side;
                let mut wall = |from: f64, to: f64, low: f64| {
                    for face in [-0.1, 0.1] {
                        let at = line as f64 * 6.0 + face;
                        quads.push([(from, low), (to, low), (to, 3.0), (from, 3.0)].map(|(along, y)| {
                            if turned { DVec3::new(at, y, along) } else { DVec3::new(along, y, at) }
                        }));
                    }
                };
                if inner {
                    wall(start, door, 0.0);
                    wall(door, door + 1.0, 2.1);
                    wall(door + 1.0, start + 6.0, 0.0);
                } else {
                    wall(start, start + 6.0, 0.0);
                }
            }
        }
    }
    quads
}

/// Of the boxes in view: how many a depth for each pixel hides, how many of these the masks hide, how many only they hide.
fn tightness(view: &View, order: &[[DVec3; 4]], boxes: &[Aabb]) -> [usize; 3] {
    let mut image = MaskedDepth::new(Coverage::Sampled);
    image.begin(view);
    let mut triangles = Vec::new();
    for quad in order {
        image.draw_polygon(quad, Sides::Both);
        for i in [[0, 1, 2], [0, 2, 3]] {
            let corners = i.map(|i: usize| quad[i].as_vec3());
            triangles.push(Triangle { corners, sides: Sides::Both, occludes: true });
        }
    }
    let scene = Scene::from_triangles(triangles);
    let mut depth = DepthBuffer::new(view);
    depth.draw(&scene, &(0..scene.triangles().len() as u32).collect::<Vec<_>>());
    let mut counts = [0; 3];
    for aabb in boxes.iter().filter(|aabb| image.in_view(aabb)) {
        let [by_depth, by_masks] = [depth.hides(&Bound::Box(*aabb)), !image.sees_box(aabb)];
        counts[0] += usize::from(by_depth);
        counts[1] += usize::from(by_depth && by_masks);
        counts[2] += usize::from(by_masks && !by_depth);
    }
    counts
}

fn shuffle<T>(rng: &mut Pcg64, items: &mut [T]) {
    for i in (1..items.len()).rev() {
        items.swap(i, rng.random_range(0..=i));
    }
}

/// Both hide the same but for one box in a thousand, and the silhouettes and planes of the masks hide more.
#[track_caller]
fn assert_tight(what: &str, [exact, both, more]: [usize; 3]) {
    assert!(exact > 3000 && both * 1000 >= exact * 999 && more > 0, "{what}: {both} of {exact}, {more} more");
}

#[test]
fn it_hides_nearly_all_that_exact_depths_hide_in_rooms_in_any_order() {
    let mut rng = Pcg64::seed_from_u64(6);
    let [mut nearest_first, mut any_order] = [[0; 3]; 2];
    let mut quads = rooms(&mut rng, 8);
    for _ in 0..12 {
        let eye = DVec3::new(rng.random_range(0.5..47.5), 1.7, rng.random_range(0.5..47.5));
        let view = View::level(eye, rng.random_range(0.0..6.3), 1.57, Resolution::new(512, 256));
        let boxes: Vec<Aabb> = (0..2000)
            .map(|_| {
                let half = DVec3::from_array(std::array::from_fn(|_| rng.random_range(0.1..0.6)));
                let [x, y, z] = [0.0..48.0, 0.6..2.4, 0.0..48.0].map(|range| rng.random_range(range));
                Aabb::around(DVec3::new(x, y, z), half)
            })
            .collect();
        let distance = |quad: &[DVec3; 4]| {
            let aabb = quad.iter().fold(Aabb::EMPTY, |aabb, corner| aabb.with_point(*corner));
            aabb.distance(eye)
        };
        quads.sort_by(|a, b| distance(a).total_cmp(&distance(b)));
        let counts = tightness(&view, &quads, &boxes);
        nearest_first = std::array::from_fn(|i| nearest_first[i] + counts[i]);
        shuffle(&mut rng, &mut quads);
        let counts = tightness(&view, &quads, &boxes);
        any_order = std::array::from_fn(|i| any_order[i] + counts[i]);
    }
    assert_tight("nearest first", nearest_first);
    assert_tight("in any order", any_order);
}

#[test]
fn it_hides_nearly_all_that_exact_depths_hide_in_a_soup_in_any_order() {
    let mut rng = Pcg64::seed_from_u64(8);
    let mut counts = [0; 3];
    for round in 0..12 {
        // Sizes that leave no tile open, so that most boxes are behind something.
        let size = [1.0, 3.0, 8.0][round % 3];
        let quads: Vec<[DVec3; 4]> = (0..1500)
            .map(|_| {
                let at = any_point(&mut rng, 1.0).normalize() * rng.random_range(size..30.0);
                let (u, v) = (any_point(&mut rng, 1.0) * size, any_point(&mut rng, 1.0) * size);
                [at - u - v, at + u - v, at + u + v, at - u + v]
            })
            .collect();
        let boxes: Vec<Aabb> = (0..5000)
            .map(|_| {
                let at = any_point(&mut rng, 1.0).normalize() * rng.random_range(4.0..40.0);
                Aabb::around(at, any_point(&mut rng, 0.5).abs())
            })
            .collect();
        let view = View::level(DVec3::ZERO, rng.random_range(0.0..6.3), 1.57, Resolution::new(300, 150));
        let of_view = tightness(&view, &quads, &boxes);
        counts = std::array::from_fn(|i| counts[i] + of_view[i]);
    }
    assert_tight("soup", counts);
}

#[test]
fn a_closed_image_hides_everything_beyond() {
    let view = View::level(DVec3::ZERO, 0.0, 1.5, Resolution::new(100, 50));
    let mut image = MaskedDepth::new(Coverage::Sampled);
    image.begin(&view);
    assert!(!image.is_closed_before(1e9) && image.farthest() == 0.0);
    let wall = |z: f64, x: [f64; 2]| {
        [DVec3::new(x[0], -9.0, z), DVec3::new(x[1], -9.0, z), DVec3::new(x[1], 9.0, z), DVec3::new(x[0], 9.0, z)]
    };
    image.draw_polygon(&wall(-2.0, [-9.0, 0.1]), Sides::Front);
    assert!(!image.is_closed_before(1e9));
    image.draw_polygon(&wall(-3.0, [0.3, 9.0]), Sides::Front);
    assert!(!image.is_closed_before(1e9), "one sees past the nearer wall's edge");
    image.draw_polygon(&wall(-3.0, [-0.1, 9.0]), Sides::Front);
    assert!(image.is_closed_before(3.001) && !image.is_closed_before(2.999));
    assert!(!image.sees_box(&Aabb::around(DVec3::NEG_Z * 5.0, DVec3::ONE)));
    assert!(image.sees_box(&Aabb::around(DVec3::new(3.0, 0.0, -2.0), DVec3::ONE)));
    assert!(!image.is_closed_before(f64::NAN) && !image.is_closed_before(-1.0));
}

#[test]
fn a_seal_is_believed_if_its_border_and_cracks_are_closed() {
    // Columns of pixel centres lie on the crack and on the left and right border.
    let view = View::level(DVec3::ZERO, 0.0, 1.5, Resolution::new(101, 51));
    let cracks = [[DVec3::new(0.0, -1.0, -5.0), DVec3::new(0.0, 1.0, -5.0)]];
    let side = 20.0 * 5.0 / view.focal_px();
    let rectangle = Aabb { min: DVec3::new(-side, -1.0, -5.0), max: DVec3::new(side, 1.0, -5.0) };
    let face = Face::ALL.into_iter().find(|face| face.axis() == 2 && !face.is_positive()).unwrap();
    let believed = |coverage, walls: &[[f64; 3]]| {
        let mut image = MaskedDepth::new(coverage);
        image.begin(&view);
        for [from, to, z] in walls {
            let corners = [[*from, -2.0], [*to, -2.0], [*to, 2.0], [*from, 2.0]];
            image.draw_polygon(&corners.map(|[x, y]| DVec3::new(x, y, -z)), Sides::Front);
        }
        image.believes(&SealedFace { rectangle, face, cracks: &cracks, skin: 0.1 })
    };
    let sampled = |walls: &[[f64; 3]]| believed(Coverage::Sampled, walls);
    assert!(sampled(&[[-3.0, 0.0, 5.0], [0.0, 3.0, 5.0]]));
    assert!(sampled(&[[-3.0, -0.01, 5.0], [0.01, 3.0, 5.0], [-0.5, 0.5, 3.0]]), "something nearer closes the gap");
    assert!(!sampled(&[[-3.0, -0.01, 5.0], [0.01, 3.0, 5.0]]), "a gap");
    assert!(!sampled(&[[-3.0, 3.0, 5.1]]), "farther than the face");
    assert!(!sampled(&[[-1.0, 3.0, 5.0]]), "it ends before the border");
    assert!(!believed(Coverage::Under, &[[-3.0, 3.0, 5.0]]), "the argument is about pixel centres");
}

#[test]
fn bad_input_has_a_defined_result() {
    let mut rng = Pcg64::seed_from_u64(7);
    for coverage in [Coverage::Sampled, Coverage::Under] {
        let mut image = MaskedDepth::new(coverage);
        let unit = Aabb::around(DVec3::NEG_Z * 5.0, DVec3::ONE);
        assert!(!image.sees_box(&unit), "an image without pixels shows nothing");
        image.draw_polygon(&unit.corners()[..4], Sides::Both);
        image.begin(&View::level(DVec3::ZERO, 0.0, 1.5, Resolution::new(0, 0)));
        image.draw_polygon(&unit.corners()[..4], Sides::Both);
        assert!(!image.sees_box(&unit) && image.is_closed_before(1.0));
        image.begin(&View::level(DVec3::ZERO, 0.0, 1.5, Resolution::new(64, 48)));
        let [nan, infinite] = [DVec3::NAN, DVec3::INFINITY];
        for bad in [nan, infinite, DVec3::new(f64::NAN, 0.0, -2.0), DVec3::new(1.0, f64::NEG_INFINITY, -1.0)] {
            image.draw_polygon(&[DVec3::NEG_Z, bad, DVec3::ONE], Sides::Both);
            assert!(image.sees_polygon(&[DVec3::NEG_Z, bad, DVec3::ONE]));
            assert!(image.sees_box(&Aabb { min: bad, max: DVec3::ONE }));
            assert!(image.sees_ball(bad, 1.0) && image.sees_ball(DVec3::NEG_Z, bad.x.min(f64::NAN)));
        }
        assert!(image.sees_box(&Aabb::EMPTY) && image.sees(&Bound::Everywhere) && image.sees_polygon(&[]));
        image.draw_polygon(&[], Sides::Both);
        image.draw_polygon(&[DVec3::NEG_Z; 9], Sides::Both);
        image.draw_polygon(&[DVec3::NEG_Z; 3], Sides::Both);
        for _ in 0..2000 {
            let (a, b) = (any_point(&mut rng, 4.0), any_point(&mut rng, 4.0));
            image.draw_polygon(&[a, b, a], Sides::Both);
            image.draw_polygon(&[a, b, (a + b) * 0.5, b], Sides::Both);
            image.draw_polygon(&[a * 1e30, b * 1e30, any_point(&mut rng, 1e-30)], Sides::Both);
            image.draw_polygon(&[a * 1e-3, b * 1e3, b * 1e-3, a * 1e3], Sides::Both);
            assert!(image.sees_box(&Aabb::around(DVec3::ZERO, a.abs())), "the eye is in it");
        }
        assert!(depths(&image).iter().all(|z| (0.0..=1.0001).contains(z)));
        image.begin(&View::level(DVec3::ZERO, 0.0, 1.5, Resolution::new(64, 48)));
        assert!(image.sees_box(&unit) && image.sees_ball(unit.min, 0.2) && image.sees_polygon(&unit.corners()));
        assert!(!image.sees_box(&Aabb::around(DVec3::Z * 5.0, DVec3::ONE)), "behind");
    }
}
