use glam::{DQuat, DVec3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use super::*;
use crate::query::{test, test_ahead};
use crate::{ItemBuffer, QueryBackEnd, QueryKind, Resolution, Scene, Sides, Triangle, View};

const RESOLUTIONS: [Resolution; 5] = [
    Resolution::new(1, 1),
    Resolution::new(70, 300),
    Resolution::new(300, 50),
    Resolution::new(512, 128),
    Resolution::new(257, 65),
];

fn triangles(rng: &mut Pcg64, count: usize) -> Scene {
    let triangle = |_| {
        let mut any = |reach: f32| glam::Vec3::from_array(std::array::from_fn(|_| rng.random_range(-reach..reach)));
        let at = any(4.0);
        let size = 10.0_f32.powf(any(1.0).x - 0.3);
        Triangle { corners: std::array::from_fn(|_| at + any(size)), sides: Sides::Both, occludes: true }
    };
    Scene::from_triangles((0..count).map(triangle).collect())
}

/// Mostly from outside, so that the scene is a part of the image.
fn any_view(rng: &mut Pcg64, resolution: Resolution) -> View {
    let mut unit = || rng.random_range(-1.0..1.0);
    let distance = 14.0 + 13.0 * unit();
    let turn = DQuat::from_rotation_y(unit() * 0.3) * DQuat::from_rotation_x(unit() * 0.3);
    let fov_x = 1.2 + 0.8 * unit();
    View { eye: DVec3::Z * distance, orientation: turn, fov_x, resolution, near: 0.01 }
}

/// Among the triangles, or behind them.
fn any_box(rng: &mut Pcg64) -> Aabb {
    let mut unit = || rng.random_range(-1.0..1.0);
    let size = 10.0_f64.powf(unit() - 0.5);
    let half = DVec3::new(unit(), unit(), unit()).abs() * size;
    Aabb::around(DVec3::new(unit() * 5.0, unit() * 5.0, unit() * 10.0 - 8.0), half)
}

/// The tile of a pixel, by the definition.
fn tile_of(map: &OccupancyMap, [x, y]: [usize; 2]) -> Option<[usize; 2]> {
    let axis = |at: usize, [from, end]: [usize; 2], most: usize| {
        let pixels = end - from;
        (from..end).contains(&at).then(|| (at - from) * most.min(pixels) / pixels)
    };
    Some([axis(x, map.scale.part[0], COLUMNS)?, axis(y, map.scale.part[1], ROWS)?])
}

/// What a layer that looks at few pixels knows of a box.
fn foresee(map: &OccupancyMap, depth: &DepthBuffer, few_pixels: bool, aabb: &Aabb) -> Option<bool> {
    match depth.box_place(aabb) {
        BoxPlace::Outside => Some(false),
        BoxPlace::Touching => Some(true),
        BoxPlace::In(image) => is_foreseen(map, depth, few_pixels, &image).then_some(true),
    }
}

fn is_set(map: &OccupancyMap, [column, row]: [usize; 2]) -> bool {
    map.bits.0[row][column / 64] >> (column % 64) & 1 == 1
}

#[test]
fn a_map_takes_as_many_bytes_as_the_paper_s() {
    assert_eq!(OccupancyMap::BYTES, 2048);
}

#[test]
fn bits_are_set_and_asked_by_ranges() {
    let mut rng = Pcg64::seed_from_u64(1);
    let mut bits = Bits::EMPTY;
    let mut naive = [[false; COLUMNS]; ROWS];
    let mut full = 0;
    for _ in 0..4000 {
        let row = rng.random_range(0..ROWS);
        let [a, b] = std::array::from_fn(|_| rng.random_range(0..COLUMNS));
        let (first, last) = (a.min(b), a.max(b).min(a.min(b) + 9));
        let is_full = naive[row][first..=last].iter().all(|set| *set);
        assert_eq!(bits.are_set(row as u8, first as u8, last as u8), is_full);
        full += u32::from(is_full);
        bits.set(row as u8, first as u8, last as u8);
        naive[row][first..=last].fill(true);
    }
    assert!(full > 100);
}

#[test]
fn every_pixel_that_is_drawn_is_in_a_marked_tile_and_few_other_tiles_are_marked() {
    let mut rng = Pcg64::seed_from_u64(2);
    let (mut drawn, mut marked, mut tiles) = (0, 0, 0);
    for i in 0..60 {
        let view = any_view(&mut rng, RESOLUTIONS[i % RESOLUTIONS.len()]);
        let scene = triangles(&mut rng, 12);
        let (mut depth, mut map, mut items) = (DepthBuffer::new(&view), OccupancyMap::new(), ItemBuffer::new(&view));
        map.begin(&depth, &scene.bounds());
        let ids: Vec<u32> = (0..12).collect();
        depth.draw_marking(&scene, &ids, &mut map);
        items.draw(&scene, &ids);
        // Who draws elsewhere gets the same map.
        let (undrawn, mut marked_only) = (DepthBuffer::new(&view), OccupancyMap::new());
        marked_only.begin(&undrawn, &scene.bounds());
        marked_only.mark(&undrawn, &scene, &ids);
        assert_eq!(marked_only.bits, map.bits, "{view:?}");
        let mut naive = [[false; COLUMNS]; ROWS];
        let width = view.resolution.width as usize;
        for (at, _) in items.depths().iter().enumerate().filter(|(_, depth)| **depth > 0.0) {
            // What is drawn lies within the scene's box.
            let [column, row] = tile_of(&map, [at % width, at / width]).unwrap();
            naive[row][column] = true;
            assert!(is_set(&map, [column, row]), "{at} {view:?}");
        }
        let count = naive.as_flattened().iter().filter(|set| **set).count();
        let [empty, all] = map.empty_tiles();
        assert!(count <= all - empty);
        (drawn, marked, tiles) = (drawn + count, marked + all - empty, tiles + all);
    }
    assert!(drawn * 100 > marked * 85 && marked * 10 < tiles * 9, "{drawn} of {marked} of {tiles}");
}

#[test]
fn what_a_map_shows_a_query_sees() {
    let mut rng = Pcg64::seed_from_u64(3);
    let (mut shown, mut seen, mut hidden, mut by_corner, mut asked, mut in_middle) = (0, 0, 0, 0, 0, 0);
    for i in 0..40 {
        let view = any_view(&mut rng, RESOLUTIONS[i % RESOLUTIONS.len()]);
        // The first one hides most of what is behind, as a wall with holes would.
        let mut all = triangles(&mut rng, 30).triangles().to_vec();
        all[0].corners = [[-9.0, -6.0, 0.0], [9.0, -6.0, 0.0], [0.0, 12.0, 0.0]].map(glam::Vec3::from_array);
        let scene = Scene::from_triangles(all);
        let (mut depth, mut map) = (DepthBuffer::new(&view), OccupancyMap::new());
        map.begin(&depth, &scene.bounds());
        for id in 0..30 {
            depth.draw_marking(&scene, &[id], &mut map);
            for _ in 0..12 {
                let aabb = any_box(&mut rng);
                let answer = test(&depth, &aabb).0;
                let foreseen = foresee(&map, &depth, true, &aabb);
                assert!(foreseen.is_none_or(|known| known == answer), "{aabb:?} {view:?}");
                assert!(answer || !map.shows_middle(&depth, &aabb), "{aabb:?} {view:?}");
                in_middle += u32::from(map.shows_middle(&depth, &aabb));
                if let BoxPlace::In(image) = depth.box_place(&aabb) {
                    // Another order of the same pixels.
                    assert_eq!(test_ahead(&depth, &image).0, answer, "{aabb:?} {view:?}");
                    // Without depths only the map speaks.
                    assert_eq!(foresee(&map, &depth, false, &aabb), map.shows(&image).then_some(true));
                    asked += 1;
                    seen += u32::from(answer);
                    hidden += u32::from(!answer);
                    let shows = map.shows(&image);
                    shown += u32::from(shows);
                    by_corner += u32::from(!shows && foreseen.is_some());
                    if let BoxPlace::In(rectangle) = depth.rectangle(&aabb) {
                        let rectangle = [rectangle.x(), rectangle.y()];
                        assert!(map.shows_rectangle(rectangle) || !shows);
                        // A rectangle has what a silhouette has, and its nearest depth everywhere.
                        if map.shows_rectangle(rectangle) {
                            assert!(!crate::Occlusion::hides(&depth, &crate::Bound::Box(aabb)));
                        }
                    }
                }
            }
        }
    }
    assert!(in_middle >= 10, "{in_middle} of {seen}");
    assert!(shown * 8 > seen && hidden > 200 && by_corner > 20, "{shown} and {by_corner} of {seen} of {asked}");
}

#[test]
fn images_without_pixels_boxes_across_the_near_plane_and_empty_scenes_do_no_harm() {
    let one = Triangle {
        corners: [[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [0.0, 1.0, 0.0]].map(glam::Vec3::from_array),
        sides: Sides::Both,
        occludes: true,
    };
    let scene = Scene::from_triangles(vec![one]);
    let level = |z: f64, side: u32| View::level(DVec3::Z * z, 0.0, 1.0, Resolution::new(side, side));
    let broken = View { fov_x: f64::NAN, ..level(5.0, 8) };
    for view in [level(5.0, 0), level(5.0, 1), level(0.5, 1), level(0.5, 64), level(-5.0, 64), broken] {
        for bounds in [scene.bounds(), Aabb::around(view.eye, DVec3::ONE), Aabb::EMPTY] {
            let (mut depth, mut map) = (DepthBuffer::new(&view), OccupancyMap::new());
            map.begin(&depth, &bounds);
            for _ in 0..2 {
                for aabb in
                    [scene.bounds(), Aabb::around(view.eye, DVec3::splat(0.1)), Aabb::around(DVec3::NAN, DVec3::ONE)]
                {
                    match foresee(&map, &depth, true, &aabb) {
                        Some(seen) => assert_eq!(seen, test(&depth, &aabb).0, "{view:?} {aabb:?}"),
                        None => assert!(view.check().is_ok()),
                    }
                }
                depth.draw_marking(&scene, &[0], &mut map);
            }
            let [empty, all] = map.empty_tiles();
            assert!(empty <= all && all <= COLUMNS * ROWS);
        }
    }
    // One pixel: empty, then drawn.
    let view = level(2.0, 1);
    let (mut depth, mut map) = (DepthBuffer::new(&view), OccupancyMap::new());
    map.begin(&depth, &scene.bounds());
    assert_eq!(map.empty_tiles(), [1, 1]);
    depth.draw_marking(&scene, &[0], &mut map);
    assert_eq!(map.empty_tiles(), [0, 1]);
}

#[test]
fn a_map_is_given_up_where_it_knows_too_little_and_begun_again_with_the_next_frame() {
    let depth = DepthBuffer::new(&View::level(DVec3::ZERO, 0.0, 1.0, Resolution::new(64, 64)));
    let mut map = OccupancyMap::new();
    let frame = |map: &mut OccupancyMap, known: u32| {
        map.begin(&depth, &Aabb::around(DVec3::ZERO, DVec3::ONE));
        assert!(!map.is_given_up());
        // The first trial goes well, whatever the second comes to.
        (0..2 * TRIAL).find(|&i| {
            map.count(i < TRIAL || i - TRIAL < known);
            map.is_given_up()
        })
    };
    for (worth, least) in [
        (Worth::of_long_queries(Occupancy::Single), TRIAL / 8),
        (Worth::of_short_queries(Occupancy::Single), TRIAL / 2),
    ] {
        map.set_worth(worth);
        assert_eq!(frame(&mut map, least), None);
        assert_eq!(frame(&mut map, least - 1), Some(2 * TRIAL - 1));
        assert_eq!(map.asked(), [2 * TRIAL, TRIAL + least - 1].map(|count| count as usize));
    }
    for lasts in [Worth::of_long_queries(Occupancy::Always), Worth::of_answers_waited_for()] {
        map.set_worth(lasts);
        assert_eq!(frame(&mut map, 0), None);
    }
}

#[test]
fn small_batches_join_the_next() {
    let joined = |boxes: [usize; 5]| {
        let mut batch_of: Vec<u32> = (0..).zip(boxes).flat_map(|(batch, boxes)| vec![batch; boxes]).collect();
        query::join_small(&mut batch_of);
        batch_of.chunk_by(|a, b| a == b).map(|chunk| (chunk[0], chunk.len())).collect::<Vec<_>>()
    };
    assert_eq!(joined([0; 5]), []);
    assert_eq!(joined([70, 64, 100, 65, 3]), [(0, 70), (1, 64), (2, 100), (3, 65), (4, 3)]);
    assert_eq!(joined([40, 30, 100, 10, 3]), [(0, 70), (1, 100), (2, 13)]);
    assert_eq!(joined([9, 8, 7, 6, 5]), [(0, 35)]);
}

#[test]
fn boxes_of_a_batch_reach_into_tiles_of_their_own() {
    let view = View::level(DVec3::ZERO, 0.0, 1.0, Resolution::new(512, 512));
    let mut map = OccupancyMap::new();
    map.begin(&DepthBuffer::new(&view), &Aabb::around(DVec3::ZERO, DVec3::ONE));
    let mut batches = Batches::new();
    let mut place = |x, y| batches.place(map.scale(), x, y);
    assert_eq!(place([0, 99], [0, 99]), 0);
    assert_eq!(place([200, 299], [0, 99]), 0);
    // Behind the first one, again and again: what finds no free tile ends in the last batch.
    for batch in [1, 2, 3, 4, 4, 4] {
        assert_eq!(place([20, 79], [20, 79]), batch);
    }
    // Half beside it.
    assert_eq!(place([80, 120], [20, 79]), 0);
    assert_eq!(place([-50, -1], [0, 9]), 0);
}

#[test]
fn a_back_end_behind_maps_answers_as_it_does_alone_however_it_is_asked() {
    let mut rng = Pcg64::seed_from_u64(4);
    let (mut seen_in_all, mut left_in_all, mut asked) = (0, 0, 0);
    for kind in QueryKind::ALL {
        for (i, occupancy) in [Occupancy::Single, Occupancy::Batched].into_iter().enumerate() {
            let view = any_view(&mut rng, RESOLUTIONS[3 + i % 2]);
            let scene = triangles(&mut rng, 30);
            let boxes: Vec<Aabb> = (0..60).map(|_| any_box(&mut rng)).collect();
            let (mut alone, mut layer) = (kind.back_end(), OccupancyQuery::new(kind.back_end(), occupancy));
            alone.begin_scene(&view, &scene.bounds());
            layer.begin_scene(&view, &scene.bounds());
            let all: Vec<u32> = (0..30).collect();
            let (mut plain, mut seen, mut batch_of) = (Vec::new(), Vec::new(), Vec::new());
            for ids in all.chunks(10) {
                alone.draw(&scene, ids);
                layer.draw(&scene, ids);
                alone.query(&boxes, &mut plain);
                layer.query(&boxes, &mut seen);
                assert_eq!(seen, plain, "{kind} {occupancy:?}");

                // As a traversal asks: what is foreseen, then batch by batch what is left.
                let mut answers: Vec<Option<bool>> = boxes.iter().map(|aabb| layer.foresee(aabb)).collect();
                let left: Vec<usize> = (0..boxes.len()).filter(|&at| answers[at].is_none()).collect();
                let of = |numbers: &[usize]| numbers.iter().map(|&at| boxes[at]).collect::<Vec<Aabb>>();
                layer.arrange(&of(&left), &mut batch_of);
                assert_eq!(batch_of.len(), left.len());
                for batch in 0..=batch_of.iter().copied().max().unwrap_or(0) {
                    let numbers: Vec<usize> =
                        left.iter().zip(&batch_of).filter(|(_, of)| **of == batch).map(|(&at, _)| at).collect();
                    layer.query_left(&of(&numbers), false, &mut seen);
                    numbers.iter().zip(&seen).for_each(|(&at, &answer)| answers[at] = Some(answer));
                }
                assert!(answers.iter().zip(&plain).all(|(answer, plain)| *answer == Some(*plain)), "{kind}");

                // And out of turn, with other boxes than were foreseen nothing of.
                let others: Vec<Aabb> = boxes.iter().rev().copied().collect();
                boxes[..9].iter().for_each(|aabb| {
                    layer.foresee(aabb);
                });
                layer.arrange(&others, &mut batch_of);
                layer.query_left(&others, false, &mut seen);
                assert!(seen.iter().eq(plain.iter().rev()), "{kind}");
                seen_in_all += plain.iter().filter(|seen| **seen).count();
                left_in_all += left.len();
                asked += boxes.len();
            }
        }
    }
    assert!(seen_in_all * 5 > asked && left_in_all > 60, "{seen_in_all} {left_in_all} of {asked}");
}
