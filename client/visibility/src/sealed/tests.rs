use glam::Vec3;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use super::*;

/// A triangle at x = 0 with these (y, z) corners, which run anticlockwise as seen from +x.
fn wall(corners: [[f32; 2]; 3], sides: Sides) -> Triangle {
    Triangle { corners: corners.map(|[y, z]| Vec3::new(0.0, y, z)), sides, occludes: true }
}

fn quad([y0, z0]: [f32; 2], [y1, z1]: [f32; 2], sides: Sides) -> [Triangle; 2] {
    [wall([[y0, z0], [y1, z0], [y1, z1]], sides), wall([[y0, z0], [y1, z1], [y0, z1]], sides)]
}

fn cracks_of(triangles: &[Triangle], face: Face) -> Option<Vec<[DVec3; 2]>> {
    let walls: Vec<Wall> = triangles.iter().filter_map(Wall::of).collect();
    covered(&walls, &Aabb::new(DVec3::ZERO, DVec3::new(0.0, 1.0, 1.0)), face)
}

const TOWARDS: Face = Face::ALL[0];
const AWAY: Face = Face::ALL[1];

#[test]
fn a_wall_seals_both_ways_and_a_single_sided_one_only_from_its_front() {
    let both = quad([0.0, 0.0], [1.0, 1.0], Sides::Both);
    assert_eq!(cracks_of(&both, TOWARDS), Some(Vec::new()));
    assert_eq!(cracks_of(&both, AWAY), Some(Vec::new()));
    // Its front looks to +x, so that it is seen by who looks towards −x.
    let front = quad([-1.0, -2.0], [3.0, 2.0], Sides::Front);
    assert!(cracks_of(&front, TOWARDS).is_some());
    assert!(cracks_of(&front, AWAY).is_none());
}

#[test]
fn glass_half_walls_and_walls_beside_the_face_seal_nothing() {
    let glass = quad([0.0, 0.0], [1.0, 1.0], Sides::Both).map(|t| Triangle { occludes: false, ..t });
    assert!(cracks_of(&glass, AWAY).is_none());
    assert!(cracks_of(&quad([0.0, 0.0], [1.0, 1.0], Sides::Both)[..1], AWAY).is_none());
    let beside = quad([0.0, 0.0], [1.0, 1.0], Sides::Both)
        .map(|t| Triangle { corners: t.corners.map(|c| c + Vec3::X * 1e-6), ..t });
    assert!(cracks_of(&beside, AWAY).is_none());
    assert!(cracks_of(&[], AWAY).is_none());
}

#[test]
fn the_thinnest_gap_is_a_gap() {
    let most = 1.0 - f32::EPSILON;
    assert!(cracks_of(&quad([0.0, 0.0], [most, 1.0], Sides::Both), AWAY).is_none());
    let mut two = quad([0.0, 0.0], [0.5, 1.0], Sides::Both).to_vec();
    two.extend(quad([0.5, 0.0], [1.0, 1.0], Sides::Both));
    assert!(cracks_of(&two, AWAY).is_some());
    two.truncate(2);
    two.extend(quad([0.5 + f32::EPSILON, 0.0], [1.0, 1.0], Sides::Both));
    assert!(cracks_of(&two, AWAY).is_none());
}

#[test]
fn things_that_stand_against_a_wall_do_not_open_it() {
    let mut triangles = quad([0.0, 0.0], [1.0, 1.0], Sides::Both).to_vec();
    triangles.extend(quad([0.2, 0.1], [0.4, 0.9], Sides::Both));
    assert_eq!(cracks_of(&triangles, AWAY), Some(Vec::new()));
    // A patch that fills a hole counts.
    let ring = [
        ([0.0, 0.0], [1.0, 0.25]),
        ([0.0, 0.75], [1.0, 1.0]),
        ([0.0, 0.25], [0.25, 0.75]),
        ([0.75, 0.25], [1.0, 0.75]),
    ];
    let mut ring: Vec<Triangle> = ring.into_iter().flat_map(|(from, to)| quad(from, to, Sides::Both)).collect();
    assert!(cracks_of(&ring, AWAY).is_none());
    ring.extend(quad([0.25, 0.25], [0.75, 0.75], Sides::Both));
    assert!(cracks_of(&ring, AWAY).is_some());
}

#[test]
fn a_t_junction_along_an_axis_is_a_crack_and_an_oblique_one_is_a_gap() {
    let mut triangles = quad([0.0, 0.0], [0.5, 1.0], Sides::Both).to_vec();
    triangles.extend(quad([0.5, 0.0], [1.0, 0.25], Sides::Both));
    triangles.extend(quad([0.5, 0.25], [1.0, 1.0], Sides::Both));
    let cracks = cracks_of(&triangles, AWAY).unwrap();
    assert!(cracks.iter().flatten().all(|end| end.x == 0.0 && end.y == 0.5), "{cracks:?}");
    let length: f64 = cracks.iter().map(|[from, to]| from.distance(*to)).sum();
    assert_eq!(length, 2.0);

    let middle = [0.5_f32, 0.5];
    let oblique = [
        wall([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]], Sides::Both),
        wall([[0.0, 0.0], middle, [0.0, 1.0]], Sides::Both),
        wall([middle, [1.0, 1.0], [0.0, 1.0]], Sides::Both),
    ];
    assert!(cracks_of(&oblique, AWAY).is_none());
}

#[test]
fn what_is_sealed_lets_no_ray_through() {
    // Rectangles on a coarse lattice, so that they often abut, overlap and nearly cover the face.
    let mut rng = Pcg64::seed_from_u64(1);
    let (mut sealed, mut open) = (0, 0);
    for _ in 0..3000 {
        let mut triangles = Vec::new();
        for _ in 0..rng.random_range(1..14) {
            let mut at = || rng.random_range(-1..=5) as f32 * 0.25;
            let (from, to) = ([at(), at()], [at(), at()]);
            let sides = if rng.random_bool(0.9) { Sides::Both } else { Sides::Front };
            triangles.extend(quad(from, to, sides));
            if rng.random_bool(0.1) {
                triangles.pop();
            }
        }
        let hit = |y: f64, z: f64| {
            triangles.iter().any(|triangle| {
                let Some(wall) = Wall::of(triangle) else { return false };
                let inside = wall.edges().into_iter().all(|[from, to]| turn([from, to, DVec2::new(y, z)]) >= 0.0);
                wall.faces(TOWARDS) && inside
            })
        };
        let points: Vec<[f64; 2]> = (0..40).map(|_| [rng.random(), rng.random()]).collect();
        if cracks_of(&triangles, TOWARDS).is_some() {
            sealed += 1;
            assert!(points.iter().all(|&[y, z]| hit(y, z)), "{triangles:?}");
        } else {
            open += u32::from(points.iter().any(|&[y, z]| !hit(y, z)));
        }
    }
    assert!(sealed > 50 && open > 500, "{sealed} sealed, {open} open");
}
