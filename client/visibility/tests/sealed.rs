//! Sealed faces save work and no pixel: rooms of paper-thin walls whose triangles meet in T-junctions, with things right
//! behind the walls.

mod made;

use eyeline_visibility::{
    Aabb, Budget, Cplp, CplpScratch, DepthBuffer, EyeRegion, KdRules, KdTree, Resolution, SampledTarget, Scene,
    SealedFace, Sides, Target, Traversal, Triangle, View, exact_set,
};
use glam::{DVec3, Vec3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use std::sync::Arc;

const ROOM: f32 = 4.0;
const HEIGHT: f32 = 2.5;

/// Cuts a rectangle of a plane across `axis` at random into rectangles that meet in T-junctions, and those into triangles.
fn add_wall(
    rng: &mut Pcg64,
    triangles: &mut Vec<Triangle>,
    axis: usize,
    at: f32,
    low: [f32; 2],
    high: [f32; 2],
    cuts: u32,
) {
    if cuts > 0 {
        let side = rng.random_range(0..2);
        let cut = low[side] + (high[side] - low[side]) * rng.random_range(0.2..0.8_f32);
        let (mut middle_high, mut middle_low) = (high, low);
        (middle_high[side], middle_low[side]) = (cut, cut);
        let fewer = rng.random_range(0..cuts);
        add_wall(rng, triangles, axis, at, low, middle_high, fewer);
        add_wall(rng, triangles, axis, at, middle_low, high, cuts - 1 - fewer);
        return;
    }
    made::add_plate(triangles, axis, at, low, high, Sides::Both);
}

/// `side` × `side` closed rooms with walls without thickness, and boxes in them, many a millimetre or less from a wall.
fn paper_rooms(seed: u64, side: u32, boxes: u32) -> Scene {
    let mut rng = Pcg64::seed_from_u64(seed);
    let mut triangles = Vec::new();
    for line in 0..=side {
        for room in 0..side {
            let at = line as f32 * ROOM;
            let [from, to] = [room as f32 * ROOM, (room + 1) as f32 * ROOM];
            for (axis, low, high) in [(0, [0.0, from], [HEIGHT, to]), (2, [from, 0.0], [to, HEIGHT])] {
                let cuts = rng.random_range(0..6);
                let first = triangles.len();
                add_wall(&mut rng, &mut triangles, axis, at, low, high, cuts);
                match rng.random_range(0..8) {
                    // A single-sided wall, or one of glass.
                    0 => triangles[first..].iter_mut().for_each(|triangle| triangle.sides = Sides::Front),
                    1 => triangles[first..].iter_mut().for_each(|triangle| triangle.occludes = false),
                    _ => {}
                }
            }
        }
    }
    for x in 0..side {
        for z in 0..side {
            let [x, z] = [x, z].map(|i| i as f32 * ROOM);
            for y in [0.0, HEIGHT] {
                let cuts = rng.random_range(0..4);
                add_wall(&mut rng, &mut triangles, 1, y, [z, x], [z + ROOM, x + ROOM], cuts);
            }
            for _ in 0..boxes {
                let size = Vec3::from_array(std::array::from_fn(|_| rng.random_range(0.05..1.0)));
                let room = Vec3::new(ROOM, HEIGHT, ROOM);
                let mut at = (room - size) * Vec3::from_array(std::array::from_fn(|_| rng.random::<f32>()));
                let gap = 10.0_f32.powf(rng.random_range(-4.0..-1.0));
                let axis = rng.random_range(0..3);
                at[axis] = if rng.random() { gap } else { room[axis] - size[axis] - gap };
                let at = at + Vec3::new(x, 0.0, z);
                made::add_box(&mut triangles, at, at + size, Sides::Both, rng.random_bool(0.8));
            }
        }
    }
    Scene::from_triangles(triangles)
}

/// Believes every seal, as if pixels were rays.
struct Credulous<'a>(SampledTarget<'a>);

impl Target for Credulous<'_> {
    fn draw(&mut self, primitives: &[u32]) {
        self.0.draw(primitives);
    }
    fn sees(&self, aabb: &Aabb) -> bool {
        self.0.sees(aabb)
    }
    fn in_view(&self, aabb: &Aabb) -> bool {
        self.0.in_view(aabb)
    }
    fn believes(&self, _: &SealedFace<'_>) -> bool {
        true
    }
    fn is_full(&self) -> bool {
        self.0.is_full()
    }
}

struct Eyes<'a> {
    scene: &'a Scene,
    cplp: Cplp,
    scratch: CplpScratch,
}

impl Eyes<'_> {
    fn new(scene: &Scene, rules: KdRules) -> Eyes<'_> {
        Eyes { scene, cplp: Cplp::new(Arc::new(KdTree::build(scene, rules))), scratch: CplpScratch::default() }
    }

    /// The traversal, and how many exactly visible primitives it did not draw.
    fn look(&mut self, view: &View, exact: &[u32], credulous: bool) -> (Traversal, usize) {
        let mut depth = DepthBuffer::new(view);
        let target = depth.target(self.scene);
        let (eye, budget) = (EyeRegion::point(view.eye), Budget { triangles: 0 });
        let done = if credulous {
            self.cplp.traverse(self.scene, eye, budget, &mut Credulous(target), &mut self.scratch)
        } else {
            self.cplp.traverse(self.scene, eye, budget, &mut { target }, &mut self.scratch)
        };
        let visible = self.scratch.visible();
        (done, exact.iter().filter(|id| visible.binary_search(id).is_err()).count())
    }
}

/// Eyes anywhere in the rooms, next to walls, in them, at their edges, and outside.
fn any_eye(rng: &mut Pcg64, side: u32) -> DVec3 {
    let reach = DVec3::new(f64::from(side) * f64::from(ROOM), f64::from(HEIGHT), f64::from(side) * f64::from(ROOM));
    let mut eye = reach * DVec3::from_array(std::array::from_fn(|_| rng.random_range(0.0..1.0)));
    for axis in 0..3 {
        let wall = if axis == 1 { 0.0 } else { f64::from(rng.random_range(0..=side)) * f64::from(ROOM) };
        match rng.random_range(0..8) {
            0 => eye[axis] = wall,
            1 => eye[axis] = wall + 10.0_f64.powf(rng.random_range(-6.0..-0.5)) * if rng.random() { 1.0 } else { -1.0 },
            2 if rng.random_bool(0.2) => eye[axis] = -1.0 - rng.random_range(0.0..5.0),
            _ => {}
        }
    }
    eye
}

#[test]
fn sealed_faces_lose_no_pixel_among_paper_walls_and_believing_them_blindly_does() {
    let mut rng = Pcg64::seed_from_u64(31);
    let (mut believed, mut doubted, mut blind) = (0, 0, 0);
    for seed in 0..6 {
        let scene = paper_rooms(seed, 3, 5);
        let mut eyes = [
            Eyes::new(&scene, KdRules::default()),
            Eyes::new(&scene, KdRules::default().with_max_triangles_per_leaf(20).with_min_obscuration(0.2)),
        ];
        for i in 0..120 {
            let eye = any_eye(&mut rng, 3);
            let resolution = [
                Resolution::new(64, 64),
                Resolution::new(200, 150),
                Resolution::new(31, 90),
                Resolution::new(1, 300),
                Resolution::new(500, 400),
            ][if i % 20 == 0 { 4 } else { i % 4 }];
            let view = made::any_view(&mut rng, eye, resolution);
            let (exact, _) = exact_set(&scene, &view);
            for eyes in &mut eyes {
                let (done, missing) = eyes.look(&view, &exact, false);
                assert_eq!(missing, 0, "seed {seed}: {view:?}");
                believed += done.sealed;
                doubted += done.doubted;
                blind += eyes.look(&view, &exact, true).1;
            }
        }
    }
    assert!(believed > 1000, "{believed}");
    assert!(doubted > 100, "{doubted}");
    // Else these scenes would not show that anything has to be asked.
    assert!(blind > 10, "{blind}");
    eprintln!("{believed} believed, {doubted} doubted; blindly {blind} lost");
}

/// Closed rooms in a row, solid walls between, a thousand triangles in each.
fn closed_rooms(side: u32) -> Scene {
    let mut triangles = Vec::new();
    let length = side as f32 * 6.0;
    let mut solid = |min: [f32; 3], max: [f32; 3]| {
        made::add_box(&mut triangles, Vec3::from_array(min), Vec3::from_array(max), Sides::Both, true);
    };
    solid([0.0, -0.2, 0.0], [length + 0.25, 0.0, length + 0.25]);
    solid([0.0, 3.0, 0.0], [length + 0.25, 3.25, length + 0.25]);
    for line in 0..=side {
        let at = line as f32 * 6.0;
        for room in 0..side {
            let from = room as f32 * 6.0;
            solid([at, 0.0, from], [at + 0.25, 3.0, from + 6.25]);
            solid([from, 0.0, at], [from + 6.25, 3.0, at + 0.25]);
        }
    }
    for room in 0..side * side {
        let [x, z] = [room % side, room / side].map(|i| i as f32 * 6.0 + 0.25);
        for i in 0..12 {
            let at = [x + 0.3 + (i % 4) as f32 * 1.4, 0.01 + (i / 8) as f32, z + 0.4 + (i / 4) as f32 * 1.7];
            solid(at, [at[0] + 0.7, at[1] + 0.6, at[2] + 0.8]);
        }
    }
    Scene::from_triangles(triangles)
}

#[test]
fn a_closed_room_costs_the_same_among_four_times_the_rooms() {
    let work = |side: u32| {
        let scene = closed_rooms(side);
        let mut eyes = Eyes::new(&scene, KdRules::default());
        let mut total = Traversal::default();
        for i in 0..24 {
            let eye = DVec3::new(8.0 + f64::from(i % 5) * 0.8, 1.7, 8.3 + f64::from(i % 7) * 0.5);
            let view = View::level(eye, f64::from(i) * 0.7, 1.5, Resolution::new(512, 256));
            let (exact, _) = exact_set(&scene, &view);
            let (done, missing) = eyes.look(&view, &exact, false);
            assert_eq!(missing, 0);
            total.cells_projected += done.cells_projected;
            total.queries += done.queries;
            total.triangles_drawn += done.triangles_drawn;
            total.sealed += done.sealed;
            total.doubted += done.doubted;
        }
        total
    };
    let (few, many) = (work(3), work(6));
    for work in [few, many] {
        assert_eq!((work.cells_projected, work.queries, work.doubted), (24, 0, 0), "{few:?} {many:?}");
    }
    // The floor and a few walls more lie along a larger building.
    assert!(many.triangles_drawn <= few.triangles_drawn + 24 * 12, "{few:?} {many:?}");
}

/// A closed room in front of z = 0 and one behind it, `depth` deep each, and what the wall between them is.
fn two_closed_rooms(depth: f32, half: [f32; 2], wall: impl FnOnce(&mut Vec<Triangle>)) -> Vec<Triangle> {
    let mut triangles = Vec::new();
    wall(&mut triangles);
    let mut rng = Pcg64::seed_from_u64(0);
    for [from, to] in [[0.0, depth], [-depth, 0.0]] {
        for sign in [-1.0, 1.0] {
            add_wall(&mut rng, &mut triangles, 0, sign * half[0], [-half[1], from], [half[1], to], 0);
            add_wall(&mut rng, &mut triangles, 1, sign * half[1], [from, -half[0]], [to, half[0]], 0);
        }
        let end = if from == 0.0 { to } else { from };
        add_wall(&mut rng, &mut triangles, 2, end, [-half[0], -half[1]], [half[0], half[1]], 0);
    }
    triangles
}

#[test]
fn what_shows_through_a_crack_of_a_t_junction_is_not_lost() {
    let mut rng = Pcg64::seed_from_u64(5);
    let (mut through, mut sealed) = (0, 0);
    for seed in 0..6 {
        let mut cuts = Pcg64::seed_from_u64(seed);
        let mut triangles = two_closed_rooms(6.0, [5.0, 5.0], |triangles| {
            add_wall(&mut cuts, triangles, 2, 0.0, [-5.0, -5.0], [5.0, 5.0], 30);
        });
        let behind = triangles.len() as u32;
        made::add_box(&mut triangles, Vec3::new(-4.5, -4.5, -3.0), Vec3::new(4.5, 4.5, -2.0), Sides::Both, true);
        let scene = Scene::from_triangles(triangles);
        let mut eyes = Eyes::new(&scene, KdRules::default());
        for _ in 0..60 {
            let eye = DVec3::new(rng.random_range(-2.0..2.0), rng.random_range(-2.0..2.0), rng.random_range(3.0..5.0));
            let mut view = View::level(eye, rng.random_range(-0.2..0.2), 1.2, Resolution::new(256, 256));
            view.orientation *= glam::DQuat::from_rotation_z(rng.random_range(0.0..3.0));
            let (exact, _) = exact_set(&scene, &view);
            let (done, missing) = eyes.look(&view, &exact, false);
            assert_eq!(missing, 0, "{view:?}");
            through += usize::from(exact.iter().any(|&id| id >= behind));
            sealed += usize::from(eyes.scratch.visible().iter().all(|&id| id < behind));
            assert!(done.sealed > 0);
        }
    }
    // Both happen: a crack over a pixel's centre, and a wall that is closed in spite of its junctions.
    assert!(through > 10 && sealed > 10, "{through} see through a crack, {sealed} are closed");
}

#[test]
fn what_stands_closer_behind_a_long_wall_than_depths_tell_apart_is_not_lost() {
    let mut rng = Pcg64::seed_from_u64(6);
    let mut through = 0;
    for _ in 0..200 {
        // Along a wall of 60 m at low resolution; snapping moves depths there by more than what is behind is away.
        let mut triangles = two_closed_rooms(6.0, [30.0, 5.0], |triangles| {
            add_wall(&mut Pcg64::seed_from_u64(0), triangles, 2, 0.0, [-30.0, -5.0], [30.0, 5.0], 0);
        });
        let behind = triangles.len() as u32;
        let gap = rng.random_range(0.0006..0.003_f32);
        for i in -28..28 {
            let at = Vec3::new(i as f32, -4.0, -1.0);
            made::add_box(&mut triangles, at, at + Vec3::new(0.9, 8.0, 1.0 - gap), Sides::Both, true);
        }
        let scene = Scene::from_triangles(triangles);
        let mut eyes = Eyes::new(&scene, KdRules::default().with_skin(5e-4));
        let eye = DVec3::new(-29.0, rng.random_range(-2.0..2.0), rng.random_range(0.05..5.0));
        let side = rng.random_range(12..300);
        let mut view = View::level(eye, -1.5, 1.3, Resolution::new(side, side));
        view.orientation *= glam::DQuat::from_rotation_z(rng.random_range(0.0..3.0));
        let (exact, _) = exact_set(&scene, &view);
        assert_eq!(eyes.look(&view, &exact, false).1, 0, "{view:?}");
        through += usize::from(exact.iter().any(|&id| id >= behind));
    }
    assert!(through > 10, "{through}");
}

#[test]
fn a_wall_nearer_than_the_near_plane_hides_nothing() {
    let mut triangles = Vec::new();
    let mut rng = Pcg64::seed_from_u64(3);
    add_wall(&mut rng, &mut triangles, 2, 0.0, [-5.0, -5.0], [5.0, 5.0], 0);
    add_wall(&mut rng, &mut triangles, 2, -4.0, [-5.0, -5.0], [5.0, 5.0], 0);
    // Sides, so that the cell behind is no wider than the wall in front.
    for at in [-4.5, 4.5] {
        add_wall(&mut rng, &mut triangles, 0, at, [-5.0, -4.0], [5.0, 0.0], 0);
        add_wall(&mut rng, &mut triangles, 1, at, [-4.0, -5.0], [0.0, 5.0], 0);
    }
    let scene = Scene::from_triangles(triangles);
    let mut eyes = Eyes::new(&scene, KdRules::default());
    assert!(eyes.cplp.tessellation().cell_count() > 1);
    for height in [1e-9, 1e-4, 1e-3, 9e-3, 0.0099, 0.01, 0.0101, 0.02, 0.1, 1.0] {
        for pitch in [0.0, 0.3, -0.8, 1.2] {
            let mut view = View::level(DVec3::new(0.3, 0.2, height), 0.4, 1.5, Resolution::new(160, 120));
            view.orientation *= glam::DQuat::from_rotation_x(pitch);
            let (exact, _) = exact_set(&scene, &view);
            assert_eq!(eyes.look(&view, &exact, false).1, 0, "{view:?}");
        }
    }
    // Far enough away the wall is believed.
    let view = View::level(DVec3::new(0.3, 0.2, 1.0), 0.0, 1.5, Resolution::new(160, 120));
    let (done, _) = eyes.look(&view, &[], false);
    assert!(done.sealed > 0 && done.doubted == 0, "{done:?}");
    // The far wall was not drawn.
    assert!(eyes.scratch.visible().iter().all(|&id| !(2..4).contains(&id)), "{done:?}");
}
