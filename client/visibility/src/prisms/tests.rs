use glam::Vec3;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use super::*;
use crate::tessellation::laws::{poor_scenes, soup};
use crate::{Sides, Triangle};

/// The sides of an upright or level box.
fn solid(triangles: &mut Vec<Triangle>, min: [f32; 3], max: [f32; 3], turned: f32) {
    let turn = glam::Quat::from_rotation_y(turned);
    let corner = |i: usize| {
        turn * Vec3::from_array(std::array::from_fn(|axis| if i >> axis & 1 == 0 { min[axis] } else { max[axis] }))
    };
    for [a, b, c, d] in [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]] {
        for corners in [[a, b, c], [a, c, d]] {
            triangles.push(Triangle { corners: corners.map(corner), sides: Sides::Front, occludes: true });
        }
    }
}

/// Two storeys of 2 × 2 rooms of 4 m with a door each in walls that cross, all turned about the vertical axis.
fn house(turned: f32) -> Scene {
    let mut triangles = Vec::new();
    for floor in [0.0, 3.0] {
        let mut add = |min, max| solid(&mut triangles, min, max, turned);
        add([-0.2, floor - 0.2, -0.2], [8.2, floor, 8.2]);
        for at in [0.0, 4.0, 8.0] {
            for [from, to] in [[-0.1, 1.5], [2.5, 5.5], [6.5, 8.1]] {
                add([at - 0.1, floor, from], [at + 0.1, floor + 2.8, to]);
                add([from, floor, at - 0.1], [to, floor + 2.8, at + 0.1]);
            }
        }
    }
    solid(&mut triangles, [-0.2, 5.8, -0.2], [8.2, 6.0, 8.2], turned);
    // A table is no wall.
    solid(&mut triangles, [1.0, 0.0, 1.0], [2.0, 0.8, 2.0], turned);
    Scene::from_triangles(triangles)
}

#[test]
fn prisms_fill_the_root_and_know_their_neighbours() {
    for turned in [0.0, 0.4] {
        let scene = house(turned);
        let prisms = Prisms::build(&scene).unwrap();
        assert_eq!(prisms.storeys(), 2);
        assert!(prisms.plan_triangles() > 50, "{}", prisms.plan_triangles());
        let root = prisms.root();
        assert!(root.contains_box(&root_box(&scene)));
        let ids = || 0..prisms.cell_count() as CellId;
        let volume = |cell| {
            let [a, b, c, above, ..] = prisms.corners(cell);
            (b - a).cross(c - a).length() * 0.5 * (above.y - a.y)
        };
        let filled: f64 = ids().map(volume).sum();
        assert!((filled / root.size().element_product() - 1.0).abs() < 1e-9);
        for cell in ids() {
            let middle = prisms.corners(cell).into_iter().sum::<DVec3>() / 6.0;
            assert_eq!(prisms.cell_at(middle), Some(cell));
            assert!(prisms.cell(cell).contains(middle) && root.contains_box(prisms.cell(cell)));
            assert_eq!(prisms.faces(cell).count(), prisms.neighbours(cell).len());
            for (neighbour, (other, normal, corners, count)) in prisms.neighbours(cell).iter().zip(prisms.faces(cell)) {
                assert_eq!(neighbour.cell, other);
                let back = prisms.neighbours(other).iter().find(|n| n.cell == cell).unwrap();
                assert_eq!(back.face, neighbour.face.opposite());
                // The face is one of both, between their middles, within the box that they share.
                let there = prisms.corners(other).into_iter().sum::<DVec3>() / 6.0;
                let shared = prisms.cells().shared(cell, neighbour);
                assert_eq!(shared, prisms.cells().shared(other, back));
                for corner in &corners[..count] {
                    assert!(normal.dot(middle) < normal.dot(*corner) && normal.dot(*corner) < normal.dot(there));
                    assert!(shared.contains(*corner));
                }
            }
            // What has no neighbour lies in the hull.
            let in_hull = Face::ALL.into_iter().filter(|&face| prisms.hull(face).contains(&cell)).count();
            assert!(prisms.neighbours(cell).len() + in_hull >= 5);
        }
    }
}

#[test]
fn every_point_of_a_triangle_lies_in_a_cell_that_lists_it() {
    let mut rng = Pcg64::seed_from_u64(61);
    for turned in [0.0, 0.4] {
        let scene = house(turned);
        let prisms = Prisms::build(&scene).unwrap();
        for (id, triangle) in (0..).zip(scene.triangles()) {
            let [a, b, c] = triangle.corners.map(|corner| corner.as_dvec3());
            for _ in 0..6 {
                let (u, v) = (rng.random::<f64>(), rng.random::<f64>());
                let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
                let point = a + (b - a) * u + (c - a) * v;
                assert!(prisms.primitives(prisms.cell_at(point).unwrap()).contains(&id));
                let mut around = Vec::new();
                prisms.cells_within(point, 0.0, &mut |cell| around.push(cell));
                assert!(around.iter().all(|&cell| prisms.primitives(cell).contains(&id)));
                assert!(around.contains(&prisms.cell_at(point).unwrap()));
            }
        }
    }
}

#[test]
fn no_cell_goes_through_a_wall_and_walls_across_an_axis_seal() {
    let prisms = Prisms::build(&house(0.0)).unwrap();
    let at = |x: f64, z: f64| prisms.cell_at(DVec3::new(x, 1.5, z)).unwrap();
    // Along a line through a wall there is a cell for the wall.
    let cell = at(4.0, 0.7);
    assert!(prisms.cell(cell).min.x >= 3.899 && prisms.cell(cell).max.x <= 4.101, "{:?}", prisms.cell(cell));
    assert!(prisms.sealed() > 20, "{}", prisms.sealed());
    let sealed = prisms.neighbours(cell).iter().filter(|neighbour| neighbour.face.axis() == 0 && neighbour.is_sealed());
    let ways_in = sealed.count();
    let into = |cell| prisms.neighbours(cell).iter().filter(|n| n.is_sealed()).count();
    assert!(ways_in + into(at(3.8, 0.7)) > 0);
    // Oblique walls lie in no plane across an axis: only floors may seal.
    let turned = Prisms::build(&house(0.4)).unwrap();
    assert!(
        (0..turned.cell_count() as CellId)
            .flat_map(|cell| turned.neighbours(cell))
            .all(|n| !n.is_sealed() || n.face.axis() == 1)
    );
}

#[test]
fn scenes_without_storeys_say_what_was_counted() {
    let mut scenes = poor_scenes();
    scenes.push(soup(3, 300));
    // Terraces: what lies level has nothing above it.
    let mut steps = Vec::new();
    (0..8).for_each(|i| solid(&mut steps, [i as f32, 0.0, 0.0], [i as f32 + 1.0, i as f32, 9.0], 0.0));
    scenes.push(Scene::from_triangles(steps));
    // A gallery: below one ceiling, over half as much of the floor again.
    let mut hall = Vec::new();
    for (min, max) in [([0.0, -0.2, 0.0], [9.0, 0.0, 9.0]), ([0.0, 6.0, 0.0], [9.0, 6.2, 9.0])] {
        solid(&mut hall, min, max, 0.0);
    }
    for (min, max) in [([-0.2, 0.0, 0.0], [0.0, 6.0, 9.0]), ([9.0, 0.0, 0.0], [9.2, 6.0, 9.0])] {
        solid(&mut hall, min, max, 0.0);
    }
    assert!(Prisms::build(&Scene::from_triangles(hall.clone())).is_ok());
    // Ground below the floor's slab makes no gallery of the slab.
    let mut on_ground = hall.clone();
    solid(&mut on_ground, [0.0, -2.0, 0.0], [9.0, -1.0, 9.0], 0.0);
    assert!(Prisms::build(&Scene::from_triangles(on_ground)).is_ok());
    let mut with_gallery = hall.clone();
    (0..6)
        .for_each(|i| solid(&mut with_gallery, [i as f32, 1.0, 0.0], [i as f32 + 1.0, 1.1 + 0.5 * i as f32, 9.0], 0.0));
    scenes.push(Scene::from_triangles(with_gallery));
    // The same hall under a vault of slopes.
    for i in 0..9 {
        let (x, z) = (i as f32, [0.0, 9.0]);
        let corners = [Vec3::new(x, 3.0, z[0]), Vec3::new(x + 1.0, 5.0, z[0]), Vec3::new(x, 3.5, z[1])];
        (0..4).for_each(|_| hall.push(Triangle { corners, sides: Sides::Both, occludes: true }));
    }
    scenes.push(Scene::from_triangles(hall));
    for scene in scenes {
        match Prisms::build(&scene) {
            Err(error @ PrismsError::NoStoreys { .. }) => assert!(error.to_string().starts_with("no storeys: ")),
            other => panic!("{other:?}"),
        }
    }
    let text = Prisms::build(&soup(3, 300)).unwrap_err().to_string();
    assert!(text.contains("0 levels face up and 0 down"), "{text}");
}

/// A floor and a ceiling, over which plans are drawn.
fn slabs() -> Vec<Triangle> {
    let mut triangles = Vec::new();
    solid(&mut triangles, [-6.0, -0.2, -6.0], [6.0, 0.0, 6.0], 0.0);
    solid(&mut triangles, [-6.0, 3.0, -6.0], [6.0, 3.2, 6.0], 0.0);
    triangles
}

/// An upright wall over the height of the storey.
fn wall(triangles: &mut Vec<Triangle>, from: [f32; 2], to: [f32; 2]) {
    let corner = |[x, z]: [f32; 2], y: f32| Vec3::new(x, y, z);
    for corners in
        [[corner(from, 0.0), corner(to, 0.0), corner(to, 3.0)], [corner(from, 0.0), corner(to, 3.0), corner(from, 3.0)]]
    {
        triangles.push(Triangle { corners, sides: Sides::Both, occludes: true });
    }
}

#[test]
fn degenerate_plans_make_prisms_or_say_why_not() {
    let mut plans: Vec<(&str, Vec<Triangle>)> = vec![("no walls", slabs())];
    let mut plan = |name, walls: &dyn Fn(&mut Vec<Triangle>)| {
        let mut triangles = slabs();
        walls(&mut triangles);
        plans.push((name, triangles));
    };
    plan("one wall", &|walls| wall(walls, [-5.0, 0.3], [5.0, 0.3]));
    plan("the same wall", &|walls| (0..40).for_each(|_| wall(walls, [-5.0, 0.3], [5.0, 0.3])));
    plan("there and back", &|walls| {
        wall(walls, [-5.0, 0.3], [5.0, 0.3]);
        wall(walls, [5.0, 0.3], [-5.0, 0.3]);
    });
    plan("pieces of one line", &|walls| {
        (0..9).for_each(|i| wall(walls, [i as f32 - 5.0, 1.0], [i as f32 - 3.5, 1.0]));
    });
    // Corners on common circles by the dozen.
    plan("pillars in a grid", &|walls| {
        for i in 0..36_i16 {
            let [x, z] = [i % 6, i / 6].map(|at| f32::from(at) * 2.0 - 5.0);
            solid(walls, [x - 0.2, 0.0, z - 0.2], [x + 0.2, 3.0, z + 0.2], 0.0);
        }
    });
    plan("a round hall", &|walls| {
        let at = |i: i32| (i as f32 * std::f32::consts::TAU / 48.0).sin_cos();
        (0..48).for_each(|i| wall(walls, [at(i).0 * 5.0, at(i).1 * 5.0], [at(i + 1).0 * 5.0, at(i + 1).1 * 5.0]));
    });
    plan("spokes through one point", &|walls| {
        (0..24).for_each(|i| {
            let (sin, cos) = (i as f32 * std::f32::consts::TAU / 48.0).sin_cos();
            wall(walls, [-5.0 * cos, -5.0 * sin], [5.0 * cos, 5.0 * sin]);
        });
    });
    // Shorter than a step of the grid, and of no length at all.
    plan("points", &|walls| (0..9).for_each(|i| wall(walls, [i as f32 * 0.5, 1.0], [i as f32 * 0.5 + 1e-4, 1.0])));
    plan("nothing", &|walls| (0..9).for_each(|_| wall(walls, [1.0, 1.0], [1.0, 1.0])));
    plan("nearly the same wall", &|walls| {
        (0..20).for_each(|i| wall(walls, [-5.0, 0.3], [5.0, 0.3 + i as f32 * 1e-3]));
    });
    let mut made = 0;
    for (name, triangles) in plans {
        let scene = Scene::from_triangles(triangles);
        let prisms = match Prisms::build(&scene) {
            Ok(prisms) => prisms,
            Err(error @ (PrismsError::NoStoreys { .. } | PrismsError::Unsound { .. })) => {
                assert!(error.to_string().starts_with("no "), "{name}: {error}");
                continue;
            }
            Err(error) => panic!("{name}: {error}"),
        };
        made += 1;
        let volume = |cell| {
            let [a, b, c, above, ..] = prisms.corners(cell);
            (b - a).cross(c - a).length() * 0.5 * (above.y - a.y)
        };
        let filled: f64 = (0..prisms.cell_count() as CellId).map(volume).sum();
        assert!((filled / prisms.root().size().element_product() - 1.0).abs() < 1e-9, "{name}");
        for (id, triangle) in (0..).zip(scene.triangles()) {
            let [a, b, c] = triangle.corners.map(|corner| corner.as_dvec3());
            for point in [a, b, c, (a + b + c) / 3.0] {
                assert!(prisms.primitives(prisms.cell_at(point).unwrap()).contains(&id), "{name}: {point}");
            }
        }
    }
    assert!(made >= 8, "{made}");
}

#[test]
fn a_plan_of_slivers_takes_no_more_room_than_a_multiple_of_it() {
    // A fan of 20,000 triangles from one corner: each reaches across half of the plan.
    let count = 10_000;
    let mut sites = vec![DVec2::ZERO, DVec2::new(1.0, 0.0)];
    sites.extend((1..=count).map(|i| DVec2::new(1.0, f64::from(i) / f64::from(count))));
    sites.extend((1..=count).map(|i| DVec2::new(1.0 - f64::from(i) / f64::from(count), 1.0)));
    let plan: Vec<[u32; 3]> = (1..sites.len() as u32 - 1).map(|at| [0, at, at + 1]).collect();
    let root = Aabb::new(DVec3::ZERO, DVec3::ONE);
    assert!(is_sound(&sites, &plan, 1.0));
    let buckets = Buckets::new(&sites, &plan, &root);
    assert!(buckets.memory_bytes() < 500 * plan.len(), "{}", buckets.memory_bytes());
    let mut found = Vec::new();
    let point = DVec3::new(0.5, 0.0, 0.25);
    buckets.visit(&Aabb::new(point, point), |of_plan| found.push(of_plan));
    let holds = |corners: [u32; 3]| {
        let [a, b, c] = corners.map(|site| sites[site as usize]);
        let at = DVec2::new(0.5, 0.25);
        [(a, b), (b, c), (c, a)].into_iter().all(|(from, to)| (to - from).perp_dot(at - from) >= 0.0)
    };
    assert!(found.iter().any(|&of_plan| holds(plan[of_plan as usize])));
}
