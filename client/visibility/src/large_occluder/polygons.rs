//! Which polygons of a scene are large enough to be occluders, and which of their edges are the same line?
//!
//! Coplanar triangles that share edges are merged first ([`Facets`]): the paper merges identical vertices, since a wall's
//! diagonal would otherwise be an edge past which everything shows. Two kinds of partners are told apart:
//! - **welded** edges run between the same two corners. Any picture draws them along the same snapped line, so no pixel
//!   can show what is between;
//! - edges that share a **stretch** of one line (a T-junction). No ray passes between them, but a picture that snaps corners
//!   may leave a crack. [`super::joint`] asks in each picture whether a pixel's centre is in it.

use glam::DVec3;

use crate::facets::Facets;
use crate::occluders::{LineEdge, overlaps_on_lines};
use crate::{Aabb, Scene, Sides};

/// The occluders of a scene, largest first. Never changes once made.
#[derive(Clone, Debug)]
pub(crate) struct Polygons {
    list: Vec<Polygon>,
    corners: Vec<DVec3>,
    /// `partners[partner_starts[k]..partner_starts[k + 1]]` are those of the edge that starts at corner k.
    partner_starts: Vec<u32>,
    partners: Vec<Partner>,
}

/// One convex polygon.
#[derive(Clone, Debug)]
pub(crate) struct Polygon {
    first: u32,
    count: u32,
    /// Whether it hides from behind too.
    pub two_sided: bool,
    /// Unit normal of the loop, towards its front.
    pub normal: DVec3,
    /// Least and greatest height of a corner along the normal, from the origin.
    pub heights: [f64; 2],
    /// Area in square metres.
    pub area: f64,
    /// Mean of the corners.
    pub centre: DVec3,
    pub aabb: Aabb,
    /// Greatest extent in metres.
    pub size: f64,
}

/// An edge of another polygon along a part of an edge.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Partner {
    pub polygon: u32,
    pub edge: u32,
    /// Where it begins and ends along the edge: 0 to 1.
    pub span: [f64; 2],
    /// Whether the two edges run in opposite directions around their fronts.
    pub opposite: bool,
    /// Whether both have the same two corners.
    pub welded: bool,
}

/// An edge keeps at most so many partners, so that a thousand copies of a triangle do not have a million.
const PARTNERS_MAX: usize = 16;

impl Polygons {
    /// The `most` largest polygons of at least `area_min` square metres.
    pub fn build(scene: &Scene, most: usize, area_min: f64) -> Polygons {
        let facets = Facets::build(scene);
        let mut order: Vec<u32> =
            (0..facets.len() as u32).filter(|&facet| facets.facet(facet).area >= area_min).collect();
        order.sort_by(|&a, &b| facets.facet(b).area.total_cmp(&facets.facet(a).area).then(a.cmp(&b)));
        order.truncate(most);
        let mut built =
            Polygons { list: Vec::new(), corners: Vec::new(), partner_starts: vec![0], partners: Vec::new() };
        let mut edges = Vec::new();
        for (index, &facet) in (0..).zip(&order) {
            let (facet, corners) = (facets.facet(facet), facets.corners(facet));
            let first = built.corners.len() as u32;
            built.corners.extend(corners.iter().map(|corner| corner.as_dvec3()));
            let own = &built.corners[first as usize..];
            let aabb = own.iter().fold(Aabb::EMPTY, |aabb, &corner| aabb.with_point(corner));
            let heights = own.iter().map(|corner| facet.normal.dot(*corner));
            built.list.push(Polygon {
                first,
                count: own.len() as u32,
                two_sided: facet.sides == Sides::Both,
                normal: facet.normal,
                heights: heights.fold([f64::INFINITY, f64::NEG_INFINITY], |[a, b], h| [a.min(h), b.max(h)]),
                area: facet.area,
                centre: own.iter().sum::<DVec3>() / own.len() as f64,
                aabb,
                size: aabb.size().length(),
            });
            for (edge, &from) in (0..).zip(corners) {
                edges.push(LineEdge::new(index, edge, from, corners[(edge as usize + 1) % corners.len()]));
            }
        }
        built.join(edges);
        built
    }

    /// Finds the partners of each edge.
    fn join(&mut self, edges: Vec<LineEdge>) {
        let mut lists: Vec<Vec<Partner>> = vec![Vec::new(); self.corners.len()];
        overlaps_on_lines(edges, |a, b, low, high| {
            let welded = a.low == b.low && a.high == b.high;
            for (own, other) in [(a, b), (b, a)] {
                let [from, to] = self.edge(own.polygon, own.edge as usize);
                let along = |point: DVec3| (point - from).dot(to - from) / (to - from).length_squared();
                let [s, t] = [along(low.as_dvec3()), along(high.as_dvec3())];
                let span = if welded { [0.0, 1.0] } else { [s.min(t), s.max(t)] };
                let list = &mut lists[self.list[own.polygon as usize].first as usize + own.edge as usize];
                if list.len() < PARTNERS_MAX {
                    let opposite = a.forward != b.forward;
                    list.push(Partner { polygon: other.polygon, edge: other.edge, span, opposite, welded });
                }
            }
        });
        for list in lists {
            self.partners.extend(list);
            self.partner_starts.push(self.partners.len() as u32);
        }
    }

    pub fn len(&self) -> usize {
        self.list.len()
    }

    pub fn get(&self, polygon: u32) -> &Polygon {
        &self.list[polygon as usize]
    }

    /// The loop, anticlockwise from its front: 3 to 8 corners.
    pub fn corners(&self, polygon: u32) -> &[DVec3] {
        let Polygon { first, count, .. } = self.list[polygon as usize];
        &self.corners[first as usize..(first + count) as usize]
    }

    /// Both ends of an edge.
    pub fn edge(&self, polygon: u32, edge: usize) -> [DVec3; 2] {
        let corners = self.corners(polygon);
        [corners[edge], corners[(edge + 1) % corners.len()]]
    }

    /// Edges of other polygons on the line of an edge.
    pub fn partners(&self, polygon: u32, edge: usize) -> &[Partner] {
        let at = self.list[polygon as usize].first as usize + edge;
        &self.partners[self.partner_starts[at] as usize..self.partner_starts[at + 1] as usize]
    }

    /// How many pairs of edges are partners: welded, and along a stretch only.
    pub fn partner_counts(&self) -> [usize; 2] {
        let welded = self.partners.iter().filter(|partner| partner.welded).count();
        [welded / 2, (self.partners.len() - welded) / 2]
    }
}
