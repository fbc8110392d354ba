//! cPLP's query back ends and the baselines beside them: no wrong pixel, a superset of the exact set, and counters that
//! count (Klosowski & Silva 2001, §3 and §4).

mod made;

use std::sync::Arc;

use eyeline_visibility::{
    Aabb, Bound, Budget, Cplp, CplpQueryCuller, Culler, DepthBuffer, EyeRegion, HierarchicalZ, HistogramQuery,
    ItemBuffer, ItemBufferQuery, Octree, OctreeRules, OneAtATimeQuery, PerFragmentHistogram, QueryBackEnd,
    QueryFrontToBack, QueryKind, Resolution, Scene, Scratch, Sides, Tessellation, Triangle, View, exact_set,
    wrong_pixels,
};
use glam::{DVec3, Vec3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

fn fine() -> OctreeRules {
    OctreeRules::default().with_max_triangles_per_leaf(6).with_max_depth(6)
}

/// cPLP with every back end, and both baselines, over small cells.
fn cullers(scene: &Arc<Scene>) -> Vec<(String, Box<dyn Culler>)> {
    let cplp = Arc::new(Cplp::build(scene, fine()));
    let octree = Arc::new(Octree::build(scene, fine()));
    let mut cullers: Vec<(String, Box<dyn Culler>)> = vec![
        ("front to back".into(), Box::new(QueryFrontToBack::new(scene.clone(), octree.clone()))),
        ("hierarchical Z".into(), Box::new(HierarchicalZ::new(scene.clone(), octree))),
    ];
    for query in QueryKind::ALL {
        for triangles in [0, 60] {
            let culler = CplpQueryCuller::new(scene.clone(), cplp.clone(), Budget { triangles }, query);
            cullers.push((format!("{query} {triangles}"), Box::new(culler)));
        }
    }
    cullers
}

/// Panics unless each culler shows the plain Z-buffer's picture of each view.
fn check(scene: &Arc<Scene>, views: impl IntoIterator<Item = View>) {
    let cullers = cullers(scene);
    let mut scratch = Scratch::default();
    for view in views {
        let (exact, items) = exact_set(scene, &view);
        for (name, culler) in &cullers {
            let visible = culler.cull(&view, EyeRegion::point(view.eye), &mut scratch).visible;
            assert!(visible.is_sorted_by(|a, b| a < b));
            let missing: Vec<&u32> = exact.iter().filter(|id| visible.binary_search(id).is_err()).collect();
            assert!(missing.is_empty(), "{name} misses {missing:?} in {view:?}");
            assert_eq!(wrong_pixels(scene, &view, &visible, &items), 0, "{name} in {view:?}");
        }
    }
}

const RESOLUTIONS: [Resolution; 6] = [
    Resolution::new(64, 64),
    Resolution::new(128, 128),
    Resolution::new(1, 1),
    Resolution::new(1, 64),
    Resolution::new(97, 13),
    Resolution::new(130, 70),
];

#[test]
fn soups_are_culled_without_error() {
    let mut rng = Pcg64::seed_from_u64(31);
    for seed in 0..8 {
        let scene = Arc::new(made::soup(seed, 60 * (seed as usize + 1)));
        let views: Vec<View> = (0..18)
            .map(|i| {
                let reach = if i % 3 == 0 { 30.0 } else { 6.0 };
                let eye = DVec3::from_array(std::array::from_fn(|_| rng.random_range(-reach..reach)));
                made::any_view(&mut rng, eye, RESOLUTIONS[i % RESOLUTIONS.len()])
            })
            .collect();
        check(&scene, views);
    }
}

#[test]
fn buildings_are_culled_without_error() {
    let mut rng = Pcg64::seed_from_u64(32);
    let scene = Arc::new(made::building(5, 8, 1));
    check(&scene, (0..50).map(|i| made::visitor(&mut rng, 5, RESOLUTIONS[i % 2])));
    check(&scene, (0..3).map(|_| made::visitor(&mut rng, 5, Resolution::new(320, 240))));
}

#[test]
fn eyes_on_vertices_in_walls_on_cell_faces_and_far_outside_do_no_harm() {
    let mut rng = Pcg64::seed_from_u64(33);
    let scene = Arc::new(made::building(4, 4, 2));
    let octree = Octree::build(&scene, fine());
    let mut views = Vec::new();
    for i in 0..72 {
        let triangle = scene.triangles()[rng.random_range(0..scene.triangles().len())];
        let cell = octree.cell(rng.random_range(0..octree.cell_count() as u32));
        let eye = match i % 6 {
            0 => triangle.corners[0].as_dvec3(),
            1 => triangle.corners.map(|corner| corner.as_dvec3()).into_iter().sum::<DVec3>() / 3.0,
            2 => cell.corners()[rng.random_range(0..8)],
            3 => DVec3::new(cell.min.x, cell.centre().y, cell.centre().z),
            4 => octree.root().corners()[rng.random_range(0..8)],
            _ => DVec3::from_array(std::array::from_fn(|_| rng.random_range(-80.0..100.0))),
        };
        let resolution = RESOLUTIONS[rng.random_range(0..RESOLUTIONS.len())];
        // Along an axis rays run inside cell faces.
        let view = made::any_view(&mut rng, eye, resolution);
        views.push(if i % 4 == 0 { View::level(eye, 0.0, view.fov_x, resolution) } else { view });
    }
    check(&scene, views);
}

#[test]
fn poor_scenes_and_images_are_culled_without_error() {
    let mut rng = Pcg64::seed_from_u64(34);
    let [one, point, kilometre, sliver, _] = made::poor();
    for triangles in
        [Vec::new(), vec![one], vec![point], vec![one; 300], vec![kilometre, sliver, one, point, kilometre]]
    {
        let scene = Arc::new(Scene::from_triangles(triangles));
        let views: Vec<View> = (0..24)
            .map(|i| {
                let eye = DVec3::from_array(std::array::from_fn(|_| rng.random_range(-4.0..4.0)));
                let sizes = [Resolution::new(48, 48), Resolution::new(0, 0), Resolution::new(0, 5), RESOLUTIONS[3]];
                made::any_view(&mut rng, eye, sizes[i % 4])
            })
            .collect();
        check(&scene, views);
    }
}

#[test]
fn a_region_that_is_not_the_eye_gets_everything() {
    let scene = Arc::new(made::building(2, 2, 5));
    let view = View::level(DVec3::new(2.0, 1.6, 2.0), 0.0, 1.0, Resolution::new(64, 64));
    let region = EyeRegion { centre: view.eye, radius: 0.1 };
    let mut scratch = Scratch::default();
    for (name, culler) in cullers(&scene) {
        culler.cull(&view, EyeRegion::point(view.eye), &mut scratch);
        assert!(scratch.occlusion().hides(&Bound::Sphere { centre: DVec3::splat(500.0), radius: 1.0 }), "{name}");
        assert_eq!(culler.cull(&view, region, &mut scratch).visible.len(), scene.triangles().len(), "{name}");
        assert!(!scratch.occlusion().hides(&Bound::Sphere { centre: DVec3::splat(500.0), radius: 1.0 }), "{name}");
    }
}

/// Every back end, tiles and depth masks included.
fn back_ends() -> Vec<(&'static str, Box<dyn QueryBackEnd>)> {
    vec![
        ("per-fragment", Box::new(PerFragmentHistogram::new())),
        ("one at a time", Box::new(OneAtATimeQuery::new())),
        ("histogram", Box::new(HistogramQuery::new())),
        ("item buffer", Box::new(ItemBufferQuery::new())),
        ("item buffer, last wins", Box::new(ItemBufferQuery::new().with_depth_mask(false))),
        ("tiles of 16", Box::new(ItemBufferQuery::new().with_tile_side(16))),
        ("tiles of 7", Box::new(ItemBufferQuery::new().with_tile_side(7).with_depth_mask(false))),
    ]
}

#[test]
fn all_back_ends_give_the_same_answers_and_see_no_more_than_a_rectangle() {
    let mut rng = Pcg64::seed_from_u64(35);
    let (mut seen_boxes, mut hidden_boxes, mut only_by_rectangle) = (0, 0, 0);
    for round in 0..30 {
        let scene = made::soup(round, 150);
        let some: Vec<u32> = (0..scene.triangles().len() as u32).step_by(2).collect();
        let eye = DVec3::from_array(std::array::from_fn(|_| rng.random_range(-8.0..8.0)));
        let view = made::any_view(&mut rng, eye, RESOLUTIONS[round as usize % RESOLUTIONS.len()]);
        // More boxes than a histogram has bins.
        let boxes: Vec<Aabb> = (0..300)
            .map(|_| {
                let mut any = |reach: f64| DVec3::from_array(std::array::from_fn(|_| rng.random_range(-reach..reach)));
                Aabb::around(any(8.0), any(2.0).abs())
            })
            .collect();
        let mut depth = DepthBuffer::new(&view);
        depth.draw(&scene, &some);
        let mut expected = None;
        for (name, mut back_end) in back_ends() {
            back_end.begin(&view);
            back_end.draw(&scene, &some);
            let mut seen = Vec::new();
            let cost = back_end.query(&boxes, &mut seen);
            let mut again = Vec::new();
            assert_eq!(back_end.query(&boxes, &mut again), cost, "{name}");
            assert_eq!(seen, again, "{name}");
            assert_eq!(&seen, expected.get_or_insert_with(|| seen.clone()), "{name} in {view:?}");
        }
        for (aabb, seen) in boxes.iter().zip(expected.unwrap()) {
            use eyeline_visibility::Occlusion;
            let rectangle = !depth.hides(&Bound::Box(*aabb));
            assert!(rectangle || !seen, "{aabb:?} in {view:?}");
            (seen_boxes, hidden_boxes) = (seen_boxes + u32::from(seen), hidden_boxes + u32::from(!seen));
            only_by_rectangle += u32::from(rectangle && !seen);
        }
    }
    assert!(
        seen_boxes > 500 && hidden_boxes > 500 && only_by_rectangle > 20,
        "{seen_boxes} {hidden_boxes} {only_by_rectangle}"
    );
}

/// Boxes one behind the other, the nearest first, each as large in the image as the one before it or smaller.
fn row_of_boxes(count: usize) -> Vec<Aabb> {
    let at = |i: usize| DVec3::new(0.0, 0.0, -2.0 - i as f64);
    (0..count).map(|i| Aabb::around(at(i), DVec3::splat(0.4))).collect()
}

fn straight(side: u32) -> View {
    View::level(DVec3::ZERO, 0.0, 1.2, Resolution::new(side, side))
}

#[test]
fn a_per_fragment_histogram_needs_one_pass_where_an_item_buffer_needs_one_per_layer() {
    let boxes = row_of_boxes(8);
    let mut seen = Vec::new();
    for (name, mut back_end) in back_ends() {
        back_end.begin(&straight(128));
        let cost = back_end.query(&boxes, &mut seen);
        assert_eq!(seen, [true; 8], "{name}");
        let passes = match name {
            "per-fragment" => 1,
            // Drawn last, the smallest box wins its pixels, and all show at once.
            "item buffer, last wins" | "tiles of 7" => 1,
            _ => 8,
        };
        assert_eq!(cost.passes, passes, "{name}");
    }
    let mut backward = boxes;
    backward.reverse();
    let mut last_wins = ItemBufferQuery::new().with_depth_mask(false);
    last_wins.begin(&straight(128));
    assert_eq!(last_wins.query(&backward, &mut seen).passes, 8);
}

/// A wall across the view at a distance of 5 m, from column `from` of 64 to the right end.
fn wall(from: f32) -> Scene {
    let half = 5.0 * 0.6_f32.tan();
    let left = (from / 32.0 - 1.0) * half;
    let corner = |x: f32, y: f32| Vec3::new(x, y, -5.0);
    let corners = [corner(left, -9.0), corner(9.0, -9.0), corner(9.0, 9.0), corner(left, 9.0)];
    let triangle = |i: [usize; 3]| Triangle { corners: i.map(|i| corners[i]), sides: Sides::Both, occludes: true };
    Scene::from_triangles(vec![triangle([0, 1, 2]), triangle([0, 2, 3])])
}

#[test]
fn counters_count_what_was_compared_and_read() {
    let scene = wall(0.0);
    let view = straight(64);
    let pixels = 64 * 64;
    let mut items = ItemBuffer::new(&view);
    items.draw_all(&scene);
    items.draw_all(&scene);
    assert_eq!(items.z_tests(), 2 * pixels);
    let mut depth = DepthBuffer::new(&view);
    depth.draw(&scene, &[0, 1]);
    assert_eq!(depth.z_tests(), pixels);
    depth.begin(&view);
    assert_eq!(depth.z_tests(), 0);

    // One box before the wall and one behind it, as large as the image, and one that is out of view.
    let boxes = [
        Aabb::around(DVec3::new(0.0, 0.0, -4.0), DVec3::new(20.0, 20.0, 0.5)),
        Aabb::around(DVec3::new(0.0, 0.0, -8.0), DVec3::new(20.0, 20.0, 0.5)),
        Aabb::around(DVec3::new(0.0, 0.0, 8.0), DVec3::splat(1.0)),
    ];
    let mut seen = Vec::new();
    for (name, mut back_end) in back_ends() {
        back_end.begin(&view);
        back_end.draw(&scene, &[0, 1]);
        assert_eq!(back_end.z_tests(), pixels, "{name}");
        let cost = back_end.query(&boxes, &mut seen);
        assert_eq!(seen, [true, false, false], "{name}");
        assert_eq!(back_end.z_tests(), pixels + cost.z_tests, "{name}");
        let expected = match name {
            "per-fragment" => (1, 2 * pixels, 2),
            // The first row shows the box before the wall.
            "one at a time" => (2, 64 + pixels, 2),
            // The second pass draws what the first did not show.
            "histogram" => (2, 3 * pixels, 2 * 256),
            _ => (2, 3 * pixels, 2 * pixels),
        };
        assert_eq!((cost.passes, cost.z_tests, cost.read_back), expected, "{name}");
    }
}

#[test]
fn a_histogram_counts_the_fragments_that_pass() {
    let view = straight(64);
    let mut back_end = PerFragmentHistogram::new();
    back_end.begin(&view);
    back_end.draw(&wall(16.0), &[0, 1]);
    let behind = Aabb::around(DVec3::new(0.0, 0.0, -8.0), DVec3::new(20.0, 20.0, 0.5));
    let touching = Aabb::around(DVec3::ZERO, DVec3::ONE);
    let mut seen = Vec::new();
    back_end.query(&[behind, touching], &mut seen);
    assert_eq!(seen, [true, true]);
    assert_eq!(back_end.counts(), [16 * 64, u32::MAX]);
}

#[test]
fn tiles_where_no_cell_of_the_front_is_seen_are_finished() {
    let mut back_end = ItemBufferQuery::new().with_tile_side(16);
    back_end.begin(&straight(64));
    back_end.draw(&wall(16.0), &[0, 1]);
    let behind = Aabb::around(DVec3::new(0.0, 0.0, -8.0), DVec3::new(20.0, 20.0, 0.5));
    let touching = Aabb::around(DVec3::ZERO, DVec3::ONE);
    let mut seen = Vec::new();
    back_end.query(&[behind], &mut seen);
    assert!(back_end.finished_tiles().is_empty(), "not a whole front");
    back_end.query_front(&[touching, behind], &mut seen);
    assert!(back_end.finished_tiles().is_empty(), "a box at the near plane may be seen anywhere");
    let all = back_end.query(&[behind], &mut seen);
    back_end.query_front(&[behind], &mut seen);
    assert_eq!(seen, [true]);
    // The left column of tiles shows the box.
    let finished = back_end.finished_tiles();
    assert_eq!(finished.len(), 12);
    assert!(finished.iter().all(|tile| tile.x[0] >= 16));
    assert!(!back_end.is_full());
    let rest = back_end.query_front(&[behind], &mut seen);
    assert_eq!((all.read_back, rest.read_back), (64 * 64, 16 * 64));
    // Other questions than those of a traversal still see the whole image.
    assert_eq!(back_end.query(&[behind], &mut seen), all);
    back_end.query_front(&[], &mut seen);
    assert!(back_end.is_full());
    back_end.begin(&straight(64));
    assert!(!back_end.is_full());
}

#[test]
fn baselines_report_what_they_did() {
    let scene = Arc::new(made::building(6, 10, 3));
    let octree = Arc::new(Octree::build(&scene, OctreeRules::default()));
    let front_to_back = QueryFrontToBack::new(scene.clone(), octree.clone());
    let hierarchical = HierarchicalZ::new(scene.clone(), octree.clone());
    let mut rng = Pcg64::seed_from_u64(37);
    let mut scratch = Scratch::default();
    for _ in 0..10 {
        let view = made::visitor(&mut rng, 6, Resolution::new(160, 120));
        let region = EyeRegion::point(view.eye);
        let flat = front_to_back.cull(&view, region, &mut scratch);
        let pyramid = hierarchical.cull(&view, region, &mut scratch);
        for culled in [&flat, &pyramid] {
            assert_eq!(culled.traversal.triangles_drawn, culled.visible.len());
            assert!(culled.visible.len() < scene.triangles().len() / 2);
            assert!(culled.z_tests > 160 * 120);
        }
        // The pyramid answers most questions by a few values.
        assert!(pyramid.z_tests < flat.z_tests, "{} {}", pyramid.z_tests, flat.z_tests);
        assert!(pyramid.traversal.cells_projected < octree.cell_count());
    }
}
