use glam::Vec3;

use super::*;
use crate::tessellation::laws::{check, check_cells_within, check_points_of_triangles_are_listed, poor_scenes, soup};
use crate::{Sides, Triangle};

fn small_cells() -> KdRules {
    KdRules::default().with_max_triangles_per_leaf(8)
}

/// The twelve triangles of a solid box.
fn add_box(triangles: &mut Vec<Triangle>, min: [f32; 3], max: [f32; 3]) {
    let corner = |i: usize| Vec3::from_array(std::array::from_fn(|a| if i >> a & 1 == 0 { min[a] } else { max[a] }));
    for [a, b, c, d] in [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]] {
        for corners in [[a, b, c], [a, c, d]] {
            triangles.push(Triangle { corners: corners.map(corner), sides: Sides::Both, occludes: true });
        }
    }
}

/// Two rooms of 6 × 6 × 3 m beside each other along x, with a wall of 0.2 m between, a door in it, and a cupboard.
fn two_rooms(furnished: bool) -> Scene {
    let mut triangles = Vec::new();
    let mut solid = |min, max| add_box(&mut triangles, min, max);
    solid([-0.2, -0.2, -0.2], [12.4, 0.0, 6.2]);
    solid([-0.2, 3.0, -0.2], [12.4, 3.2, 6.2]);
    for x in [-0.2, 12.2] {
        solid([x, 0.0, -0.2], [x + 0.2, 3.0, 6.2]);
    }
    for z in [-0.2, 6.0] {
        solid([0.0, 0.0, z], [12.2, 3.0, z + 0.2]);
    }
    solid([6.0, 0.0, 0.0], [6.2, 3.0, 2.0]);
    solid([6.0, 2.1, 2.0], [6.2, 3.0, 3.0]);
    solid([6.0, 0.0, 3.0], [6.2, 3.0, 6.0]);
    if furnished {
        solid([2.0, 0.0, 2.0], [2.8, 2.0, 2.5]);
    }
    Scene::from_triangles(triangles)
}

#[test]
fn cells_fill_the_root_and_know_their_neighbours() {
    for seed in 0..4 {
        let scene = soup(seed, 300);
        let tree = KdTree::build(&scene, small_cells());
        assert!(tree.cell_count() > 20);
        check(&scene, &tree);
        assert!(check_cells_within(&tree, tree.root().centre(), 3.0) > 1);
    }
}

#[test]
fn every_point_of_a_triangle_lies_in_cells_that_list_it_and_so_does_every_point_within_the_skin() {
    let scene = soup(7, 300);
    check_points_of_triangles_are_listed(&scene, &KdTree::build(&scene, small_cells()), 8);
    let rooms = two_rooms(true);
    check_points_of_triangles_are_listed(&rooms, &KdTree::build(&rooms, small_cells()), 9);
}

#[test]
fn degenerate_scenes_have_cells_too() {
    for scene in poor_scenes() {
        for rules in [
            small_cells(),
            KdRules::default().with_min_obscuration(0.0).with_skin(-1.0),
            small_cells().with_skin(f64::INFINITY),
        ] {
            let tree = KdTree::build(&scene, rules);
            check(&scene, &tree);
            assert!(tree.cells().reference_count() >= scene.triangles().len());
        }
    }
}

#[test]
fn a_room_is_a_cell_with_or_without_furniture() {
    for furnished in [false, true] {
        let scene = two_rooms(furnished);
        let tree = KdTree::build(&scene, KdRules::default());
        check(&scene, &tree);
        for x in [0.0_f64, 6.2] {
            let cell = tree.cell(tree.cell_at(DVec3::new(x + 1.0, 1.0, 1.0)).unwrap());
            // Wall coordinates are f32.
            let room = Aabb::new(DVec3::new(x, 0.0, 0.0), DVec3::new(x + 6.0, 3.0, 6.0));
            assert!((cell.min - room.min).abs().max_element() < 1e-6, "{cell:?}");
            assert!((cell.max - room.max).abs().max_element() < 1e-6, "{cell:?}");
        }
        assert!(tree.cell_count() < 80, "{}", tree.cell_count());
    }
}

#[test]
fn a_room_leads_on_through_its_door_only() {
    let tree = KdTree::build(&two_rooms(true), KdRules::default());
    let room = tree.cell_at(DVec3::new(1.0, 1.0, 1.0)).unwrap();
    let open: Vec<&Neighbour> = tree.neighbours(room).iter().filter(|n| !n.is_sealed()).collect();
    assert_eq!(open.len(), 1, "{open:?}");
    let door = tree.cells().shared(room, open[0]);
    assert!((door.min - DVec3::new(6.0, 0.0, 2.0)).abs().max_element() < 1e-6, "{door:?}");
    assert!((door.max - DVec3::new(6.0, 2.1, 3.0)).abs().max_element() < 1e-6, "{door:?}");
    // The opening leads to both rooms, and nowhere else.
    let beyond = tree.neighbours(open[0].cell).iter().filter(|n| !n.is_sealed()).count();
    assert_eq!(beyond, 2);
}

#[test]
fn soups_do_not_blow_up() {
    // Long thin triangles through everything: the worst for any cut.
    let mut triangles = soup(3, 4000).triangles().to_vec();
    for (i, triangle) in triangles.iter_mut().enumerate() {
        triangle.corners[1] = Vec3::from_array(std::array::from_fn(|axis| ((i * (axis + 7)) % 21) as f32 - 10.0));
    }
    let scene = Scene::from_triangles(triangles);
    let tree = KdTree::build(&scene, KdRules::default().with_max_triangles_per_leaf(1));
    assert!(tree.cells().reference_count() <= REFERENCES_PER_TRIANGLE * 4000 + REFERENCES_FREE);
    assert_eq!(tree.stats().wall_cuts, 0);
}

#[test]
fn walls_that_cross_everywhere_do_not_blow_up() {
    let mut triangles = Vec::new();
    for i in 0..300_u32 {
        let at = (i * 61 % 300) as f32 / 30.0;
        let axis = (i % 3) as usize;
        let corner = |u: f32, v: f32| {
            let mut corner = Vec3::splat(at);
            corner[(axis + 1) % 3] = u;
            corner[(axis + 2) % 3] = v;
            corner
        };
        for corners in
            [[corner(0., 0.), corner(10., 0.), corner(10., 9.)], [corner(0., 0.), corner(10., 9.), corner(0., 9.)]]
        {
            triangles.push(Triangle { corners, sides: Sides::Both, occludes: true });
        }
    }
    let scene = Scene::from_triangles(triangles);
    let tree = KdTree::build(&scene, KdRules::default());
    assert!(tree.stats().wall_cuts > 1000);
    assert!(tree.cells().reference_count() <= REFERENCES_PER_TRIANGLE * 600 + REFERENCES_FREE);
}
