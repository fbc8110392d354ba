//! Which polygons may be drawn in place of the triangles they are made of, and still cover no pixel that those do not?
//!
//! A facet is a triangulated disc whose loop keeps *every* corner of the triangles on its border, also those in the middle
//! of a straight edge. All of them are snapped to the same 1/256 px as in the Z-buffer's own picture, so that the argument
//! of [`crate::Occluders`] holds for the snapped image too: a pixel centre on the inner side of every snapped edge is wound
//! around at least once, hence covered by at least one of the snapped triangles that the plain Z-buffer draws from their
//! front. Flatness and convexity only cost coverage, never add any.

use glam::{DVec3, Vec3};

use crate::occluders::Loops;
use crate::{Scene, Sides};

/// The facets of a scene, in the order of their first primitives, so that neighbours are near in memory too. Never changes
/// once made.
#[derive(Clone, Debug)]
pub(crate) struct Facets {
    corners: Vec<Vec3>,
    facets: Vec<Facet>,
    /// Facet of each primitive, or `NONE` where it hides nothing.
    facet_of: Vec<u32>,
}

/// One facet.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Facet {
    first: u32,
    count: u32,
    /// Which sides are drawn.
    pub sides: Sides,
    /// Area in square metres.
    pub area: f64,
    /// Unit normal of the loop (Newell), towards its front.
    pub normal: DVec3,
    /// Greatest height of a corner along the normal: an eye at or below it cannot be in front of all of the facet.
    pub height: f64,
}

const NONE: u32 = u32::MAX;

impl Facets {
    /// The facets of a scene's occluding triangles.
    pub(crate) fn build(scene: &Scene) -> Facets {
        let loops = Loops::with_all_corners(scene);
        let order = || loops.loops.iter().filter(|polygon| !polygon.corners.is_empty());
        let mut facets = Facets {
            corners: Vec::new(),
            facets: Vec::with_capacity(order().count()),
            facet_of: vec![NONE; scene.triangles().len()],
        };
        for polygon in order() {
            for &primitive in &polygon.primitives {
                facets.facet_of[primitive as usize] = facets.facets.len() as u32;
            }
            let first = facets.corners.len() as u32;
            facets.corners.extend(polygon.corners.iter().map(|&corner| loops.positions[corner as usize]));
            let own = &facets.corners[first as usize..];
            let height = own.iter().map(|c| polygon.normal.dot(c.as_dvec3())).fold(f64::NEG_INFINITY, f64::max);
            facets.facets.push(Facet {
                first,
                count: own.len() as u32,
                sides: polygon.sides,
                area: area(&loops.positions, &polygon.corners),
                normal: polygon.normal,
                height,
            });
        }
        facets
    }

    /// Number of facets.
    pub(crate) fn len(&self) -> usize {
        self.facets.len()
    }

    /// One facet.
    pub(crate) fn facet(&self, facet: u32) -> &Facet {
        &self.facets[facet as usize]
    }

    /// The loop of a facet, anticlockwise from its front: 3 to 8 corners.
    pub(crate) fn corners(&self, facet: u32) -> &[Vec3] {
        let Facet { first, count, .. } = self.facets[facet as usize];
        &self.corners[first as usize..(first + count) as usize]
    }

    /// The facet that a primitive is part of, if it hides anything.
    pub(crate) fn facet_of(&self, primitive: u32) -> Option<u32> {
        let facet = self.facet_of[primitive as usize];
        (facet != NONE).then_some(facet)
    }
}

fn area(positions: &[Vec3], corners: &[u32]) -> f64 {
    let at = |corner: u32| positions[corner as usize].as_dvec3();
    let origin = at(corners[0]);
    let twice: DVec3 = corners.windows(2).map(|pair| (at(pair[0]) - origin).cross(at(pair[1]) - origin)).sum();
    twice.length() * 0.5
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Triangle;

    fn triangle(corners: [[f32; 3]; 3]) -> Triangle {
        Triangle { corners: corners.map(Vec3::from), sides: Sides::Front, occludes: true }
    }

    #[test]
    fn corners_on_straight_edges_are_kept() {
        // Two squares side by side share an edge; a third triangle elsewhere is larger.
        let triangles = vec![
            triangle([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0]]),
            triangle([[0.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]]),
            triangle([[1.0, 0.0, 0.0], [2.0, 0.0, 0.0], [2.0, 1.0, 0.0]]),
            triangle([[1.0, 0.0, 0.0], [2.0, 1.0, 0.0], [1.0, 1.0, 0.0]]),
            triangle([[0.0, 0.0, 9.0], [4.0, 0.0, 9.0], [0.0, 4.0, 9.0]]),
        ];
        let facets = Facets::build(&Scene::from_triangles(triangles));
        assert_eq!(facets.len(), 2);
        let (merged, single) = (facets.facet_of(0).unwrap(), facets.facet_of(4).unwrap());
        assert_eq!(facets.facet(single).area, 8.0);
        assert_eq!(facets.corners(merged).len(), 6);
        assert_eq!(facets.facet(merged).area, 2.0);
        assert_eq!(facets.facet(merged).normal, DVec3::Z);
        assert_eq!(facets.facet(merged).height, 0.0);
        assert!((0..4).all(|primitive| facets.facet_of(primitive) == Some(merged)));
    }
}
