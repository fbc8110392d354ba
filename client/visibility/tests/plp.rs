//! PLP within a budget: what it draws, in which order, and that hardly-scenes and hardly-views do no harm.

use std::sync::Arc;

use eyeline_visibility::{
    CentroidOrder, Culler, Delaunay, DelaunayRules, EyeRegion, FrustumBackface, HierarchicalZ, Octree, OctreeRules,
    Plp, PlpCells, PlpCuller, PlpRules, PlpScratch, Requeue, Resolution, Scene, Scratch, Seeds, Sides, Solidity,
    SolidityMax, Transfer, Triangle, View, exact_set, wrong_pixels,
};
use glam::{DVec3, Vec3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

fn triangle(corners: [Vec3; 3]) -> Triangle {
    Triangle { corners, sides: Sides::Both, occludes: true }
}

/// Triangles of about `size` within 10 m of the origin.
fn soup(seed: u64, count: usize, size: f32) -> Vec<Triangle> {
    let mut chance = Pcg64::seed_from_u64(seed);
    let mut within = |reach: f32| Vec3::from_array(std::array::from_fn(|_| chance.random_range(-reach..reach)));
    (0..count)
        .map(|_| {
            let at = within(10.0);
            triangle([at + within(size), at + within(size), at + within(size)])
        })
        .collect()
}

/// A wall of 20 × 20 panels at z = 0, and a crowd of small triangles behind it.
fn wall_and_crowd(crowd: usize) -> Arc<Scene> {
    let mut triangles = Vec::new();
    for (x, y) in (-10..10).flat_map(|x| (-10..10).map(move |y| (x as f32, y as f32))) {
        let corner = |dx: f32, dy: f32| Vec3::new(x + dx, y + dy, 0.0);
        triangles.push(triangle([corner(0.0, 0.0), corner(1.0, 0.0), corner(1.0, 1.0)]));
        triangles.push(triangle([corner(0.0, 0.0), corner(1.0, 1.0), corner(0.0, 1.0)]));
    }
    let behind = soup(3, crowd, 0.3).into_iter().map(|mut t| {
        t.corners.iter_mut().for_each(|corner| *corner = *corner * 0.9 - Vec3::Z * 10.5);
        t
    });
    triangles.extend(behind);
    Arc::new(Scene::from_triangles(triangles))
}

/// From `eye` along −Z.
fn view(eye: DVec3) -> View {
    View::level(eye, 0.0, 1.4, Resolution::new(96, 96))
}

fn boxes(scene: &Scene) -> PlpCells {
    PlpCells::Boxes(Arc::new(Octree::build(scene, OctreeRules::paper().with_leaf_side(0.2))))
}

fn tetrahedra(scene: &Scene) -> PlpCells {
    let octree = OctreeRules::paper().with_leaf_side(0.2);
    PlpCells::Tetrahedra(Arc::new(Delaunay::build(scene, DelaunayRules::default().with_octree(octree)).unwrap()))
}

fn both(scene: &Scene) -> [PlpCells; 2] {
    [boxes(scene), tetrahedra(scene)]
}

fn all_rules() -> Vec<PlpRules> {
    let paper = PlpRules::paper();
    vec![
        PlpRules::default(),
        paper,
        paper.with_transfer(Transfer::Cell).with_penalty_factor(10.0),
        paper.with_requeue(Requeue::Always).with_seeds(Seeds::Hull),
        paper.with_requeue(Requeue::Never).with_solidity_max(SolidityMax::Percentile(0.5)),
        paper.with_solidity(Solidity::Coverage { columns: 0 }),
    ]
}

fn cull(culler: &dyn Culler, view: &View) -> Vec<u32> {
    culler.cull(view, EyeRegion::point(view.eye), &mut Scratch::default()).visible
}

fn share(found: &[u32], exact: &[u32]) -> f64 {
    exact.iter().filter(|id| found.binary_search(id).is_ok()).count() as f64 / exact.len() as f64
}

#[test]
fn with_budget_enough_nothing_in_view_is_missed() {
    let scene = Arc::new(Scene::from_triangles(soup(1, 600, 1.5)));
    // Inside, outside before a face, and outside beside an edge.
    for eye in [DVec3::new(0.3, 0.2, 1.0), DVec3::new(0.0, 1.0, 25.0), DVec3::new(9.0, 12.5, 20.0)] {
        let view = view(eye);
        let (exact, items) = exact_set(&scene, &view);
        assert!(exact.len() > 50);
        for cells in both(&scene) {
            for rules in all_rules() {
                let plp = Arc::new(Plp::new(scene.clone(), cells.clone(), rules));
                let drawn = cull(&PlpCuller::new(plp, usize::MAX), &view);
                assert_eq!(share(&drawn, &exact), 1.0, "{rules:?}");
                assert_eq!(wrong_pixels(&scene, &view, &drawn, &items), 0);
            }
        }
    }
}

#[test]
fn budgets_are_kept_to_the_triangle_and_the_last_cell_is_partial() {
    let scene = Arc::new(Scene::from_triangles(soup(2, 600, 1.0)));
    let view = view(DVec3::new(0.0, 0.0, 9.0));
    for cells in both(&scene) {
        for rules in all_rules() {
            let plp = Plp::new(scene.clone(), cells.clone(), rules);
            let mut scratch = PlpScratch::default();
            let steps: Vec<_> = plp.traverse(&view, usize::MAX, &mut scratch).collect();
            let all = scratch.drawn().to_vec();
            assert!(all.len() > 200 && steps.iter().all(|step| !step.is_partial));
            assert_eq!(steps.iter().map(|step| step.triangles).sum::<usize>(), all.len());
            for budget in [0, 1, 17, 100] {
                let steps: Vec<_> = plp.traverse(&view, budget, &mut scratch).collect();
                // A smaller budget draws the beginning of what a larger one draws.
                assert_eq!(scratch.drawn(), &all[..budget], "{rules:?}");
                let (last, before) = steps.split_last().map_or((None, &[][..]), |(last, before)| (Some(last), before));
                assert!(before.iter().all(|step| !step.is_partial));
                assert_eq!(
                    last.map_or(0, |last| last.triangles),
                    budget - before.iter().map(|s| s.triangles).sum::<usize>()
                );
            }
        }
    }
}

#[test]
fn a_traversal_is_deterministic_steppable_and_can_be_looked_at() {
    let scene = Arc::new(Scene::from_triangles(soup(4, 400, 1.0)));
    let view = view(DVec3::new(0.0, 0.0, 9.0));
    for cells in both(&scene) {
        let plp = Plp::new(scene.clone(), cells, PlpRules::paper());
        let (mut scratch, mut fresh) = (PlpScratch::default(), PlpScratch::default());
        let mut traversal = plp.traverse(&view, 100, &mut scratch);
        assert_eq!(traversal.front().len(), 1);
        let first = traversal.next().unwrap();
        assert!(first.cell.is_some() && first.solidity == 0.0);
        let front = traversal.front();
        assert!(!front.is_empty() && front.iter().all(|&(cell, solidity)| Some(cell) != first.cell && solidity >= 0.0));
        traversal.by_ref().take(3).for_each(drop);
        let frozen = traversal.drawn().to_vec();
        assert!(!frozen.is_empty());
        // Another frame in the same scratch knows nothing of the one that was left.
        plp.traverse(&view, 100, &mut scratch).for_each(drop);
        plp.traverse(&view, 100, &mut fresh).for_each(drop);
        assert_eq!(scratch.drawn(), fresh.drawn());
        assert_eq!(scratch.projected(), fresh.projected());
        assert!(scratch.drawn().starts_with(&frozen));
    }
}

#[test]
fn a_frame_begins_without_touching_all_cells() {
    let scene = Arc::new(Scene::from_triangles(soup(5, 3_000, 0.3)));
    for (cells, rules) in
        both(&scene).into_iter().flat_map(|cells| all_rules().into_iter().map(move |r| (cells.clone(), r)))
    {
        let plp = Plp::new(scene.clone(), cells.clone(), rules);
        let mut scratch = PlpScratch::default();
        plp.traverse(&view(DVec3::ZERO), 20, &mut scratch).for_each(drop);
        let touched = scratch.projected().len() + scratch.front().len();
        assert!(touched * 4 < cells.len(), "{touched} of {}", cells.len());
        // Marks are projected cells, the front, and cells found out of view on the way; a traversal without budget marks its seed.
        assert!((touched..cells.len() / 2).contains(&scratch.marked()), "{} of {}", scratch.marked(), cells.len());
        plp.traverse(&view(DVec3::ZERO), 0, &mut scratch).for_each(drop);
        assert_eq!(scratch.marked(), 1);
        // From outside it begins at the hull, in one cell of it or in all that face the eye and are in view.
        plp.traverse(&view(DVec3::new(0.0, 0.0, 30.0)), 0, &mut scratch).for_each(drop);
        let seeds = scratch.marked();
        assert!(seeds > 0 && (rules.seeds == Seeds::Hull || seeds == 1) && seeds * 2 < cells.len(), "{seeds}");
        plp.traverse(&view(DVec3::ZERO), usize::MAX, &mut scratch).for_each(drop);
        assert!(scratch.marked() > touched);
        assert_eq!(PlpScratch::default().marked(), 0);
    }
    // Cells a fraction as large are many times as many, and a frame marks a smaller share of them: its way to the triangles.
    let marked = |leaf_side: f64| {
        let octree = Octree::build(&scene, OctreeRules::paper().with_leaf_side(leaf_side));
        let cells = PlpCells::Boxes(Arc::new(octree));
        let plp = Plp::new(scene.clone(), cells.clone(), PlpRules::paper());
        let mut scratch = PlpScratch::default();
        plp.traverse(&view(DVec3::ZERO), 5, &mut scratch).for_each(drop);
        (scratch.marked(), cells.len())
    };
    let [(few, coarse), (many, fine)] = [0.1, 0.025].map(marked);
    assert!(
        fine > 8 * coarse && many * coarse < few * fine && many * 100 < fine,
        "{few} of {coarse}, {many} of {fine}"
    );
}

/// With budget enough the order is all that is left: what is drawn is what view-frustum and back-face culling draw.
#[test]
fn without_a_limit_the_triangles_are_those_of_frustum_and_back_face_culling() {
    let scene = Arc::new(Scene::from_triangles(soup(8, 800, 0.4)));
    let frustum = FrustumBackface::new(scene.clone());
    for eye in [DVec3::new(0.3, 0.2, 1.0), DVec3::new(0.0, 1.0, 25.0)] {
        let view = view(eye);
        let all = cull(&frustum, &view);
        assert!(all.len() > 50);
        for cells in both(&scene) {
            for rules in all_rules() {
                let plp = Arc::new(Plp::new(scene.clone(), cells.clone(), rules));
                let mut drawn = cull(&PlpCuller::new(plp, usize::MAX), &view);
                if rules.solidity == Solidity::Count {
                    // The paper's rule draws what holds no pixel centre too.
                    assert!(all.iter().all(|id| drawn.binary_search(id).is_ok()), "{rules:?}");
                    drawn.retain(|id| all.binary_search(id).is_ok());
                }
                assert_eq!(drawn, all, "{rules:?}");
            }
        }
    }
}

#[test]
fn counts_are_divided_by_the_most_or_by_a_percentile_of_the_cells_with_triangles() {
    let scene = wall_and_crowd(300);
    for cells in both(&scene) {
        let mut counts: Vec<usize> = (0..cells.len() as u32).map(|cell| cells.primitives(cell).len()).collect();
        counts.retain(|count| *count > 0);
        counts.sort_unstable();
        let most = |solidity_max| {
            let rules = PlpRules::paper().with_solidity_max(solidity_max);
            Plp::new(scene.clone(), cells.clone(), rules).solidity_max() as usize
        };
        let greatest = counts[counts.len() - 1];
        assert_eq!(most(SolidityMax::Maximum), greatest);
        for share in [0.5, 0.9, 0.99] {
            let percentile = most(SolidityMax::Percentile(share));
            let within = counts.iter().filter(|count| **count <= percentile).count();
            let below = counts.iter().filter(|count| **count < percentile).count();
            assert!(within as f64 >= share * counts.len() as f64 && (below as f64) < share * counts.len() as f64);
        }
        assert!(most(SolidityMax::Percentile(0.5)) < greatest);
        assert_eq!((most(SolidityMax::Percentile(0.0)), most(SolidityMax::Percentile(1.0))), (counts[0], greatest));
        // What is no share is the maximum.
        assert_eq!([f64::NAN, -1.0, 7.0].map(|share| most(SolidityMax::Percentile(share))), [greatest; 3]);
    }
    let nothing = Arc::new(Scene::from_triangles(Vec::new()));
    assert_eq!(Plp::new(nothing.clone(), boxes(&nothing), PlpRules::paper()).solidity_max(), 1.0);
}

#[test]
fn coverage_finds_the_wall_before_the_crowd_behind_it() {
    let scene = wall_and_crowd(4_000);
    let view = view(DVec3::new(0.3, 0.4, 6.0));
    let (exact, items) = exact_set(&scene, &view);
    assert!(exact.iter().all(|&id| id < 800) && exact.len() > 200);
    for cells in both(&scene) {
        let plp = Arc::new(Plp::new(scene.clone(), cells, PlpRules::default()));
        let drawn = cull(&PlpCuller::new(plp, exact.len() + 60), &view);
        assert_eq!(share(&drawn, &exact), 1.0);
        assert_eq!(wrong_pixels(&scene, &view, &drawn, &items), 0);
    }
}

#[test]
fn occluders_chosen_by_plp_cost_a_z_pyramid_no_question_and_change_no_picture() {
    let scene = wall_and_crowd(4_000);
    let view = view(DVec3::new(0.3, 0.4, 6.0));
    let (exact, items) = exact_set(&scene, &view);
    let plp = Arc::new(Plp::new(scene.clone(), boxes(&scene), PlpRules::default()));
    let chosen = plp.occluders(&view, 10_000, &mut PlpScratch::default());
    assert_eq!(chosen[..10], plp.occluders(&view, 10, &mut PlpScratch::default()));
    let plain = HierarchicalZ::build(scene.clone());
    let cull = |culler: &HierarchicalZ| culler.cull(&view, EyeRegion::point(view.eye), &mut Scratch::default());
    let before = cull(&plain);
    for budget in [0, 50, 600] {
        let culled = cull(&plain.clone().with_plp(plp.clone(), budget));
        assert_eq!(share(&culled.visible, &exact), 1.0);
        assert_eq!(wrong_pixels(&scene, &view, &culled.visible, &items), 0);
        assert!(culled.visible.is_sorted_by(|a, b| a < b) && culled.traversal.plp_triangles == budget);
        assert!(culled.traversal.queries <= before.traversal.queries, "{budget}");
    }
    let blind = View { eye: DVec3::NAN, ..view };
    assert!(plp.occluders(&blind, 100, &mut PlpScratch::default()).is_empty());
    let culled = plain.with_plp(plp, 100).cull(&blind, EyeRegion::point(view.eye), &mut Scratch::default());
    assert_eq!(culled.visible.len(), scene.triangles().len());
}

#[test]
fn centroid_order_takes_the_nearest() {
    let behind = [Vec3::new(-1.0, 0.0, 8.0), Vec3::new(1.0, 0.0, 8.0), Vec3::new(0.0, 1.0, 8.0)];
    let at = |z: f32| triangle([Vec3::new(-1.0, 0.0, -z), Vec3::new(1.0, 0.0, -z), Vec3::new(0.0, 1.0, -z)]);
    let scene = Arc::new(Scene::from_triangles(vec![at(9.0), at(5.0), triangle(behind), at(7.0)]));
    let view = view(DVec3::new(0.0, 0.3, 1.0));
    let drawn = |budget, culls_first| cull(&CentroidOrder::new(scene.clone(), budget, culls_first), &view);
    assert_eq!(drawn(2, true), [1, 3]);
    assert_eq!(drawn(9, true), [0, 1, 3]);
    // The nearest but one is behind the eye: it uses up budget if culling comes second.
    assert_eq!(drawn(2, false), [1]);
    assert_eq!(drawn(9, false), [0, 1, 3]);
    assert!(drawn(0, true).is_empty());
}

#[test]
fn hardly_scenes_and_hardly_views_do_no_harm() {
    let point = triangle([Vec3::new(1.0, 2.0, 3.0); 3]);
    let mut flat = soup(6, 200, 1.0);
    flat.iter_mut().flat_map(|t| &mut t.corners).for_each(|corner| corner.z = 4.0);
    let far = Vec3::splat(1e6);
    let huge = triangle([Vec3::new(-1e30, 0.0, 0.0), Vec3::new(1e30, 0.0, 0.0), Vec3::new(0.0, 1e30, 1.0)]);
    // Corners of a cubic grid: centres of leaves on common spheres by the dozen.
    let grid = (0..1_000).map(|i| Vec3::new((i % 10) as f32, (i / 10 % 10) as f32, (i / 100) as f32));
    let grid = grid.map(|at| triangle([at, at + Vec3::X * 0.1, at + Vec3::Y * 0.1])).collect();
    let scenes: Vec<Vec<Triangle>> = vec![
        Vec::new(),
        vec![point],
        vec![triangle([Vec3::ZERO, Vec3::X, Vec3::Y]); 200],
        flat,
        vec![triangle([far, far + Vec3::X, far + Vec3::Y]); 9],
        vec![huge; 9],
        grid,
    ];
    for triangles in scenes {
        let scene = Arc::new(Scene::from_triangles(triangles));
        let middle = scene.bounds().centre();
        let middle = if middle.is_finite() { middle } else { DVec3::ZERO };
        for cells in both(&scene) {
            for rules in all_rules() {
                let plp = Arc::new(Plp::new(scene.clone(), cells.clone(), rules));
                let culler = PlpCuller::new(plp.clone(), 1_000);
                for eye in [middle, middle + DVec3::Z * 5.0, DVec3::splat(-1e9)] {
                    let (exact, _) = exact_set(&scene, &view(eye));
                    let drawn = cull(&culler, &view(eye));
                    assert!(exact.iter().all(|id| drawn.binary_search(id).is_ok()), "{rules:?} {eye}");
                }
                let blind = View { eye: DVec3::NAN, ..view(middle) };
                assert_eq!(cull(&culler, &blind).len(), scene.triangles().len());
                assert_eq!(plp.traverse(&blind, 100, &mut PlpScratch::default()).count(), 0);
                let nothing = View { resolution: Resolution::new(0, 0), ..view(middle) };
                assert!(cull(&culler, &nothing).is_empty());
            }
        }
    }
}

#[test]
fn an_eye_region_gets_everything() {
    let scene = Arc::new(Scene::from_triangles(soup(7, 50, 1.0)));
    let plp = Arc::new(Plp::new(scene.clone(), boxes(&scene), PlpRules::default()));
    let (view, region) = (view(DVec3::ZERO), EyeRegion { centre: DVec3::ZERO, radius: 0.5 });
    let cullers: [&dyn Culler; 2] = [&PlpCuller::new(plp, 1), &CentroidOrder::new(scene, 1, true)];
    for culler in cullers {
        assert_eq!(culler.cull(&view, region, &mut Scratch::default()).visible.len(), 50);
    }
}
