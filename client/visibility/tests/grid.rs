//! Every culler on every made scene: no wrong pixel and nothing lost, from wherever one may look (DESIGN.md §3, promise 1).

mod every;
mod made;

use std::sync::Arc;

use every::{check, cullers, odd_cullers};
use eyeline_visibility::{Face, KdRules, KdTree, Resolution, Scene, Scratch, Sides, Tessellation, Triangle, View};
use glam::{DVec3, Vec3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

/// Half of the views stand upright in the scene, the others look anywhere from in or about it.
fn any_views(scene: &Scene, seed: u64, count: usize, resolution: Resolution) -> Vec<View> {
    let mut rng = Pcg64::seed_from_u64(seed);
    let bounds = scene.bounds();
    let view = |i: usize| {
        let mut share = |reach: f64| DVec3::from_array(std::array::from_fn(|_| rng.random_range(-reach..1.0 + reach)));
        if i.is_multiple_of(2) {
            let eye = bounds.min + bounds.size() * share(0.0);
            View::level(eye, rng.random_range(0.0..std::f64::consts::TAU), 1.4, resolution)
        } else {
            let eye = bounds.min + bounds.size() * share(if i % 4 == 1 { 0.0 } else { 0.3 });
            made::any_view(&mut rng, eye, resolution)
        }
    };
    (0..count).map(view).collect()
}

/// The views: 50 at 64² and at 128², one at 1000×900.
fn check_everywhere(scene: Scene, seed: u64) -> every::Checked {
    let scene = Arc::new(scene);
    let mut scratch = Scratch::default();
    let cullers = cullers(&scene);
    check(&scene, &cullers, any_views(&scene, seed, 50, Resolution::new(64, 64)), &mut scratch);
    check(&scene, &cullers, any_views(&scene, seed + 1, 1, Resolution::new(1000, 900)), &mut scratch);
    let checked = check(&scene, &cullers, any_views(&scene, seed + 2, 50, Resolution::new(128, 128)), &mut scratch);
    check(&scene, &odd_cullers(&scene), any_views(&scene, seed + 3, 12, Resolution::new(96, 64)), &mut scratch);
    checked
}

#[test]
fn soups() {
    for seed in 0..4 {
        check_everywhere(made::soup(seed, 40 + 300 * seed as usize), 100 + seed);
    }
}

#[test]
fn buildings() {
    let checked = check_everywhere(made::building(6, 12, 1), 200);
    // A test that draws everything would pass too.
    let kept = |name: &str| checked.kept.iter().find(|(of, _)| of == name).unwrap().1;
    let masks = |px: &str| kept(&format!("masks in a kD-tree, occluders above {px} px"));
    let all = kept("ZB");
    assert!(masks("64") * 3 < all && kept("cPLP in a kD-tree") * 5 < all, "{checked:?}");
    assert!(masks("1000000000") > masks("64") && masks("64") >= masks("0"), "{checked:?}");
}

#[test]
fn a_building_far_from_the_origin() {
    let offset = Vec3::new(5000.0, -3000.0, 5000.0);
    let moved = |t: &Triangle| Triangle { corners: t.corners.map(|corner| corner + offset), ..*t };
    check_everywhere(Scene::from_triangles(made::building(5, 10, 2).triangles().iter().map(moved).collect()), 300);
}

#[test]
fn one_sided_walls_and_glass() {
    let sides = |i: usize| if i.is_multiple_of(3) { Sides::Both } else { Sides::Front };
    let change = |(i, t): (usize, &Triangle)| {
        let mut t = Triangle { sides: sides(i / 12), occludes: i / 12 % 4 != 1, ..*t };
        if i / 12 % 5 == 2 {
            // Inside out: seen from within only.
            t.corners.swap(1, 2);
        }
        t
    };
    let building = made::building(5, 10, 3);
    check_everywhere(Scene::from_triangles(building.triangles().iter().enumerate().map(change).collect()), 400);
}

#[test]
fn a_building_of_many_nodes() {
    let building = made::building(4, 20, 4);
    let scene = made::with_nodes(&building, 15);
    assert!(scene.nodes().len() > 20 && scene.triangles().len() > 3000, "{} nodes", scene.nodes().len());
    check_everywhere(scene, 500);
    // Few nodes of several clusters each.
    check_everywhere(made::with_nodes(&building, 1000), 550);
}

/// Cells believe walls in their faces to hide what is behind, but for a skin: posters before and behind walls, within the
/// skin, at its edge and beyond, with lower and higher ids than the wall, and some that stick out through a door.
#[test]
fn posters_on_both_sides_of_walls() {
    let building = made::building(4, 0, 11);
    let mut rng = Pcg64::seed_from_u64(650);
    let mut posters = Vec::new();
    for _ in 0..160 {
        let line = rng.random_range(0..=4) as f32 * made::ROOM;
        let side = if rng.random() { 0.1 } else { -0.1 };
        let gap = [0.0, 1e-6, 1e-5, 1e-4, 1e-3, 4e-3, 6e-3, 9e-3, 0.011, 0.05][rng.random_range(0..10)];
        let at = line + side + if rng.random() { gap } else { -gap };
        let (along, low) = (rng.random_range(0.0..18.0_f32), rng.random_range(-0.1..2.5_f32));
        let (wide, high) = (rng.random_range(0.05..3.0_f32), rng.random_range(0.05..1.0_f32));
        let corner = |u: f32, v: f32| Vec3::new(at, low + v * high, along + u * wide);
        let quad = [[(0.0, 0.0), (1.0, 0.0), (1.0, 1.0)], [(0.0, 0.0), (1.0, 1.0), (0.0, 1.0)]];
        let turned = rng.random::<bool>();
        for corners in quad {
            let corners = corners.map(|(u, v)| corner(u, v)).map(|c| if turned { Vec3::new(c.z, c.y, c.x) } else { c });
            posters.push(Triangle { corners, sides: Sides::Both, occludes: rng.random_bool(0.7) });
        }
    }
    let (before, after) = posters.split_at(160);
    let scene = Arc::new(Scene::from_triangles([before, building.triangles(), after].concat()));
    let cullers = every::all(&scene);
    let mut scratch = Scratch::default();
    for (count, side) in [(100, 64), (40, 200)] {
        let views: Vec<View> = (0..count)
            .map(|i| {
                let view = made::visitor(&mut rng, 4, Resolution::new(side, side));
                let mut eye = view.eye;
                if i % 4 == 0 {
                    // Close along a wall, where depths change most.
                    eye.x = (eye.x / 5.0).round() * 5.0 + [0.101, 0.13, -0.11, 0.2][i / 4 % 4];
                }
                View { eye, near: [0.01, 0.3][i % 2], ..view }
            })
            .collect();
        check(&scene, &cullers, views, &mut scratch);
    }
}

fn quad(corners: [[f32; 3]; 4]) -> [Triangle; 2] {
    let triangle = |at: [usize; 3]| Triangle {
        corners: at.map(|i| Vec3::from_array(corners[i])),
        sides: Sides::Both,
        occludes: true,
    };
    [triangle([0, 1, 2]), triangle([0, 2, 3])]
}

/// Half a wall makes the face of a cell, and what closes its other half slants through that face: it is drawn with the cell
/// before the face, and stands a centimetre behind it elsewhere. What hangs in that wedge is beyond the face and in view.
#[test]
fn what_hangs_in_a_wedge_behind_a_face_is_not_lost() {
    let mut triangles = Vec::new();
    made::add_box(&mut triangles, Vec3::ZERO, Vec3::new(10.0, 3.0, 10.0), Sides::Both, true);
    triangles.extend(quad([[5.0, 0.0, 0.0], [5.0, 0.0, 6.0], [5.0, 3.0, 6.0], [5.0, 3.0, 0.0]]));
    triangles.extend(quad([[5.012, -0.1, 5.95], [4.99, -0.1, 10.1], [4.99, 3.1, 10.1], [5.012, 3.1, 5.95]]));
    for i in 0..24 {
        // The skin is 4 mm here.
        let (z, low, x) = (6.04 + (i % 12) as f32 * 0.04, 0.3 + (i / 12) as f32, 5.0 + [0.002, 0.005, 0.006][i % 3]);
        let at = |u: f32, v: f32| [x, low + v * 0.4, z + u * 0.03];
        triangles.extend(quad([at(0.0, 0.0), at(1.0, 0.0), at(1.0, 1.0), at(0.0, 1.0)]));
    }
    let scene = Arc::new(Scene::from_triangles(triangles));
    let mut rng = Pcg64::seed_from_u64(660);
    let views: Vec<View> = (0..60)
        .map(|i| {
            let eye = DVec3::new(rng.random_range(0.3..4.7), 1.5, rng.random_range(3.0..9.0));
            let to = DVec3::new(5.0, 1.5, 6.3) - eye;
            View::level(eye, (-to.x).atan2(-to.z), 0.6, [Resolution::new(64, 64), Resolution::new(300, 200)][i % 2])
        })
        .collect();
    let checked = check(&scene, &every::all(&scene), views, &mut Scratch::default());
    assert!(checked.exact > 1000, "{}", checked.exact);
}

/// The plain Z-buffer draws glass like anything else, so no exact set says that it hides nothing.
#[test]
fn what_stands_behind_glass_is_kept_and_what_stands_behind_a_wall_is_not() {
    for (occludes, sides) in [(true, Sides::Both), (false, Sides::Both), (true, Sides::Front), (false, Sides::Front)] {
        for turned in [false, true] {
            let mut triangles = Vec::new();
            made::add_box(&mut triangles, Vec3::new(-1.0, -1.0, -9.0), Vec3::new(1.0, 1.0, -8.0), Sides::Both, true);
            let mut pane = quad([[-9.0, -9.0, -4.0], [9.0, -9.0, -4.0], [9.0, 9.0, -4.0], [-9.0, 9.0, -4.0]]);
            if turned {
                pane.iter_mut().for_each(|t| t.corners.swap(1, 2));
            }
            triangles.extend(pane.map(|t| Triangle { occludes, sides, ..t }));
            let scene = Arc::new(Scene::from_triangles(triangles));
            let view = View::level(DVec3::ZERO, 0.0, 1.2, Resolution::new(80, 60));
            let hides = occludes && (sides == Sides::Both || !turned);
            let region = eyeline_visibility::EyeRegion::point(view.eye);
            let behind = eyeline_visibility::Bound::Sphere { centre: DVec3::new(3.0, 0.0, -8.5), radius: 0.3 };
            let mut scratch = Scratch::default();
            for (name, culler) in every::all(&scene) {
                let visible = culler.cull(&view, region, &mut scratch).visible;
                let kept = visible.first().is_some_and(|&first| first < 12);
                assert!(kept || hides, "{name} looks not through {sides:?}, {occludes}, {turned}");
                let hidden = scratch.occlusion().hides(&behind);
                assert!(!hidden || hides, "{name} hides behind {sides:?}, {occludes}, {turned}");
                // Baselines without depths, facets left out, and one cell with the box and the pane keep it; masks do not.
                assert!(!hides || hidden || !name.ends_with("above 0 px"), "{name} sees through a wall");
            }
        }
    }
}

#[test]
fn kilometres_beside_millimetres() {
    let mut triangles = made::soup(9, 150).triangles().to_vec();
    let scale = |t: &Triangle, by: f32| Triangle { corners: t.corners.map(|corner| corner * by), ..*t };
    let others: Vec<Triangle> = triangles.iter().flat_map(|t| [scale(t, 1e-3), scale(t, 200.0)]).collect();
    triangles.extend(others);
    let scene = Arc::new(Scene::from_triangles(triangles));
    let cullers = every::all(&scene);
    let mut rng = Pcg64::seed_from_u64(600);
    let views = (0..60).map(|i| {
        let reach = [0.005, 5.0, 1000.0][i % 3];
        let eye = DVec3::from_array(std::array::from_fn(|_| rng.random_range(-reach..reach)));
        let view = made::any_view(&mut rng, eye, Resolution::new(64, 64));
        View { near: [1e-4, 0.01, 0.5][i / 3 % 3], ..view }
    });
    check(&scene, &cullers, views.collect::<Vec<_>>(), &mut Scratch::default());
}

/// Eyes where numbers tie: on corners and edges of triangles, in their planes, a millimetre and less off walls, on faces,
/// edges and corners of cells, and along axes, so that rays run inside cell faces.
#[test]
fn eyes_on_walls_vertices_and_faces_of_cells() {
    let scene = Arc::new(made::building(4, 6, 5));
    let cullers = every::all(&scene);
    let trees = every::tessellations(&scene);
    let cells: [&dyn Tessellation; 2] = [&*trees.0, &*trees.1];
    let mut rng = Pcg64::seed_from_u64(700);
    let mut views = Vec::new();
    for i in 0..160 {
        let triangle = scene.triangles()[rng.random_range(0..scene.triangles().len())];
        let [a, b, c] = triangle.corners.map(|corner| corner.as_dvec3());
        let normal = (b - a).cross(c - a).normalize();
        let cells = cells[i % 2];
        let cell = *cells.cell(rng.random_range(0..cells.cell_count() as u32));
        let within = cell.min + cell.size() * DVec3::from_array(std::array::from_fn(|_| rng.random_range(0.1..0.9)));
        let on_face = |face: Face| {
            let mut at = within;
            at[face.axis()] = if face.is_positive() { cell.max[face.axis()] } else { cell.min[face.axis()] };
            at
        };
        let off = |distance: f64| (a + b + c) / 3.0 + normal * distance;
        let eye = match i / 2 % 10 {
            0 => a,
            1 => (a + b) * 0.5,
            2 => off(0.0),
            3 => off([1e-3, -1e-3][i % 2]),
            4 => off([1e-9, -1e-9][i % 2]),
            5 => cell.corners()[rng.random_range(0..8)],
            6 => on_face(Face::ALL[rng.random_range(0..6)]),
            7 => cells.root().corners()[rng.random_range(0..8)],
            8 => {
                let mut edge = on_face(Face::ALL[i % 6]);
                edge[(i % 6 / 2 + 1) % 3] = cell.min[(i % 6 / 2 + 1) % 3];
                edge
            }
            _ => off(0.1),
        };
        let resolution = [Resolution::new(64, 64), Resolution::new(65, 33), Resolution::new(1, 300)][i % 3];
        let yaw = rng.random_range(0..8) as f64 * std::f64::consts::FRAC_PI_4;
        let view = View::level(eye, yaw, std::f64::consts::FRAC_PI_2, resolution);
        let view = if i % 2 == 0 { view } else { made::any_view(&mut rng, eye, resolution) };
        views.push(View { near: [0.01, 0.5, 1e-5][i % 3], ..view });
    }
    check(&scene, &cullers, views, &mut Scratch::default());
}

#[test]
fn narrow_and_wide_views() {
    let scene = Arc::new(made::building(5, 8, 6));
    let cullers = cullers(&scene);
    let mut rng = Pcg64::seed_from_u64(800);
    let mut views = Vec::new();
    for i in 0..80 {
        let fov_x = [0.1_f64.to_radians(), 179.0_f64.to_radians(), 1e-9, std::f64::consts::PI - 1e-9][i % 4];
        let resolution = [Resolution::new(64, 64), Resolution::new(8192, 1), Resolution::new(1, 8192)][i / 4 % 3];
        let view = made::visitor(&mut rng, 5, resolution);
        let tilted = made::any_view(&mut rng, view.eye, resolution);
        let orientation = if i / 12 % 2 == 0 { view.orientation } else { tilted.orientation };
        views.push(View { fov_x, orientation, near: [0.01, 0.5][i / 24 % 2], ..view });
    }
    check(&scene, &cullers, views, &mut Scratch::default());
}

/// Marks and images that are left from a larger scene, a smaller one, another image or another culler count for nothing.
#[test]
fn one_scratch_serves_cullers_scenes_and_images_of_all_sizes() {
    let scenes = [
        made::building(5, 10, 7),
        made::soup(7, 30),
        Scene::from_triangles(Vec::new()),
        made::building(2, 2, 8),
        made::soup(8, 700),
    ]
    .map(Arc::new);
    let culled: Vec<_> = scenes.iter().map(|scene| (scene, cullers(scene), odd_cullers(scene))).collect();
    let mut rng = Pcg64::seed_from_u64(900);
    let mut scratch = Scratch::default();
    let resolutions = [(200, 150), (16, 16), (1, 1), (0, 5), (333, 40), (64, 64)];
    for round in 0..250 {
        let (scene, cullers, odd) = &culled[rng.random_range(0..culled.len())];
        let (width, height) = resolutions[rng.random_range(0..resolutions.len())];
        let eye = if scene.triangles().is_empty() {
            DVec3::ZERO
        } else {
            let share = DVec3::from_array(std::array::from_fn(|_| rng.random_range(-0.1..1.1)));
            scene.bounds().min + scene.bounds().size() * share
        };
        let view = made::any_view(&mut rng, eye, Resolution::new(width, height));
        let of = if round % 2 == 0 { cullers } else { odd };
        let from = rng.random_range(0..of.len());
        check(scene, &of[from..(from + 4).min(of.len())], [view], &mut scratch);
        // The same from a scratch that has seen nothing.
        let (name, culler) = &of[from];
        let region = eyeline_visibility::EyeRegion::point(eye);
        let used = culler.cull(&view, region, &mut scratch);
        assert_eq!(used, culler.cull(&view, region, &mut Scratch::default()), "{name} from {view:?}");
    }
}

#[test]
fn walls_are_cut_at_so_that_seals_are_tested() {
    assert!(KdTree::build(&made::building(6, 12, 1), KdRules::default()).stats().sealed > 20);
}
