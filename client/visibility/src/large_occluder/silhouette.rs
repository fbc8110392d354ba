//! Which vertices and edges of an axis-aligned box are its silhouette from a point? By table look-up (Coorg & Teller 1997, §2.1,
//! figure 7).
//!
//! Along each axis the point is below the box, within it, or above it, so there are 27 cases, coded in 6 bits. An edge of the box
//! is in the silhouette if one of its two faces is turned to the point and the other is not; so are the edge's ends.

use glam::DVec3;

use crate::Aabb;

/// The faces of a box that are turned to a point: bit 2·axis for the lesser face, bit 2·axis + 1 for the greater one. 0 for
/// a point in the box.
pub(crate) fn code(aabb: &Aabb, point: DVec3) -> usize {
    let mut code = 0;
    for axis in 0..3 {
        code |= usize::from(point[axis] < aabb.min[axis]) << (2 * axis);
        code |= usize::from(point[axis] > aabb.max[axis]) << (2 * axis + 1);
    }
    code
}

/// Silhouette vertices by code, as bits; vertex i has bit `axis` of i set if it is on the greater side.
pub(crate) const VERTICES: [u8; 64] = {
    let mut table = [0; 64];
    let mut code = 0;
    while code < 64 {
        let mut vertex = 0;
        while vertex < 8 {
            let mut turned = 0;
            let mut axis = 0;
            while axis < 3 {
                turned += code >> (2 * axis + (vertex >> axis & 1)) & 1;
                axis += 1;
            }
            if turned != 0 && turned != 3 {
                table[code] |= 1 << vertex;
            }
            vertex += 1;
        }
        code += 1;
    }
    table
};

/// Silhouette edges by code: up to 6 pairs of vertices, the rest [`NO_EDGE`].
pub(crate) const EDGES: [[[u8; 2]; 6]; 64] = {
    let mut table = [[NO_EDGE; 6]; 64];
    let mut code = 0;
    while code < 64 {
        let mut count = 0;
        let mut axis = 0;
        while axis < 3 {
            let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
            let mut corner = 0;
            while corner < 4 {
                let (at_u, at_v) = (corner & 1, corner >> 1);
                let (face_u, face_v) = (code >> (2 * u + at_u) & 1, code >> (2 * v + at_v) & 1);
                // Codes that say "below and above" mean nothing, and would have more than 6.
                if face_u != face_v && count < 6 {
                    let from = (at_u << u | at_v << v) as u8;
                    table[code][count] = [from, from | 1 << axis];
                    count += 1;
                }
                corner += 1;
            }
            axis += 1;
        }
        code += 1;
    }
    table
};

/// No edge: both ends are one vertex.
pub(crate) const NO_EDGE: [u8; 2] = [0, 0];

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64;

    use super::*;

    #[test]
    fn the_tables_are_the_convex_hull_of_the_image() {
        let mut rng = Pcg64::seed_from_u64(5);
        for _ in 0..2000 {
            let mut point = || DVec3::from_array(std::array::from_fn(|_| rng.random_range(-2.0..2.0)));
            let (a, b, eye) = (point(), point(), point());
            let aabb = Aabb::new(a.min(b), a.max(b));
            let (code, corners) = (code(&aabb, eye), aabb.corners());
            assert_eq!(code == 0, aabb.contains(eye));
            let mut found = 0_u8;
            for from in 0..8_usize {
                for to in (from + 1..8).filter(|to| (from ^ to).count_ones() == 1) {
                    let normal = (corners[from] - eye).cross(corners[to] - eye);
                    let sides = corners.map(|corner| normal.dot(corner - eye));
                    let slack = 1e-12;
                    let hull = sides.iter().all(|&s| s < slack) || sides.iter().all(|&s| s > -slack);
                    let listed = EDGES[code].contains(&[from as u8, to as u8]);
                    assert_eq!(hull && code != 0, listed, "{aabb:?} from {eye}");
                    if listed {
                        found |= 1 << from | 1 << to;
                    }
                }
            }
            assert_eq!(found, VERTICES[code]);
        }
    }
}
