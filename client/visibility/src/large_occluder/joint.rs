//! Do several polygons hide a box together that none of them hides alone? Joint occluders (Coorg & Teller 1997, §2).
//!
//! The paper drops the supporting planes of edges that two partial occluders share, if the two lie on opposite sides of the edge
//! as seen from the eye, and asks that all other planes be satisfied. What makes this right is a walk. Let all polygons of a set
//! be nearer than the box and turned so that the eye is in front. Take a direction in which one of them is seen, and turn towards
//! another direction, both into the box. What is ahead stops being a polygon of the set only at an edge. So if none of the
//! directions into the box crosses an edge at a place where nothing of the set lies beyond, either all of the box is behind the
//! set or nothing is, and one direction tells which. An edge is no matter where
//! 1. all of the box is on its inner side: the plane that the paper asks for;
//! 2. no direction into the box meets this piece of it: all of the piece is beyond an edge of the box's silhouette. The paper's figure
//!    5-(b), a silhouette that is not convex, need not be given up;
//! 3. a polygon of the set continues on its other side: a partner, on exactly that stretch. A picture draws welded edges
//!    without a gap; at a T-junction it may leave a crack, which is looked for in this picture (`crack_is_open`);
//! 4. another polygon of the set is seen all along it, as where walls run into each other: the piece is on the inner side of
//!    each edge of that polygon that does not have the whole box on its inner side anyway.
//!
//! Polygons with an edge that matters are left out until none has; the order does not.

use super::Eye;
use super::polygons::{Partner, Polygons};
use super::relation::{all_edges, edges_around, segment_is_clear};
use crate::Aabb;
use crate::raster_sampled::setup::Projector;

/// A polygon that may hide something from an eye.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Active {
    pub polygon: u32,
    /// Whether the eye is behind it.
    pub from_behind: bool,
}

/// A polygon that partially occludes a box and is nearer than it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Member {
    /// Its number among the active polygons.
    pub active: u8,
    pub of: Active,
    /// Bit of each edge that has the whole box on its inner side.
    pub inside: u8,
}

/// The most polygons of a set.
pub(crate) const MEMBERS_MAX: usize = 64;

/// Which edges are seen on the inner side of which other edges by the eye of a frame, as far as it was asked: bits as in
/// [`edges_around`], and [`KNOWN`].
#[derive(Clone, Debug, Default)]
pub(crate) struct Continued {
    known: Vec<u16>,
    count: usize,
}

const KNOWN: u16 = 1 << 8;

impl Continued {
    pub fn begin(&mut self, active: usize) {
        self.known.clear();
        self.known.resize(active * active * 8, 0);
        self.count = active;
    }
}

/// Whether the members hide the box together. `continued` is kept for the whole frame, where there is one to keep.
pub(crate) fn hide(
    polygons: &Polygons,
    members: &[Member],
    aabb: &Aabb,
    eye: &Eye,
    mut continued: Option<&mut Continued>,
) -> bool {
    let members = &members[..members.len().min(MEMBERS_MAX)];
    let mut set = if members.len() == 64 { u64::MAX } else { (1_u64 << members.len()) - 1 };
    loop {
        let before = set;
        for (index, member) in members.iter().enumerate() {
            if set >> index & 1 == 0 {
                continue;
            }
            let others = || members.iter().enumerate().filter(|&(i, _)| i != index && set >> i & 1 == 1);
            let count = polygons.corners(member.of.polygon).len();
            let mut is_no_matter = |edge: usize| {
                if member.inside >> edge & 1 == 1 {
                    return true;
                }
                let [from, to] = polygons.edge(member.of.polygon, edge);
                let mut open = Pieces::whole();
                for partner in polygons.partners(member.of.polygon, edge) {
                    let continues = |other: &Member| {
                        partner.polygon == other.of.polygon
                            && partner.opposite == (member.of.from_behind == other.of.from_behind)
                    };
                    if others().any(|(_, other)| continues(other))
                        && (partner.welded || !eye.crack_is_open(polygons, member.of.polygon, edge, partner))
                    {
                        open.remove(partner.span);
                    }
                }
                open.iter().all(|[s, t]| {
                    let piece = [from.lerp(to, s), from.lerp(to, t)];
                    segment_is_clear(piece, aabb, eye.position, eye.margins)
                        || others().any(|(_, other)| {
                            let Active { polygon, from_behind } = other.of;
                            let asked = || {
                                let around = |point| {
                                    edges_around(polygons, polygon, from_behind, point, eye.position, eye.margins)
                                };
                                around(piece[0]) & around(piece[1])
                            };
                            let around = match &mut continued {
                                Some(kept) if [s, t] == [0.0, 1.0] => {
                                    let pair = usize::from(member.active) * kept.count + usize::from(other.active);
                                    let known = &mut kept.known[pair * 8 + edge];
                                    if *known == 0 {
                                        *known = KNOWN | u16::from(asked());
                                    }
                                    (*known & !KNOWN) as u8
                                }
                                _ => asked(),
                            };
                            around | other.inside == all_edges(polygons, polygon)
                        })
                })
            };
            if !(0..count).all(&mut is_no_matter) {
                set &= !(1 << index);
            }
        }
        if set == before {
            break;
        }
    }
    // Any direction into the box will do; several, since one may lie on an edge.
    let half = aabb.size() * 0.5;
    let samples = SAMPLES.map(|[x, y, z]| aabb.centre() + half * glam::DVec3::new(x, y, z));
    members.iter().enumerate().filter(|&(index, _)| set >> index & 1 == 1).any(|(_, member)| {
        let Active { polygon, from_behind } = member.of;
        let around = |sample| edges_around(polygons, polygon, from_behind, sample, eye.position, eye.margins);
        samples.iter().any(|&sample| around(sample) | member.inside == all_edges(polygons, polygon))
    })
}

/// Places in a box, as shares of its half size.
const SAMPLES: [[f64; 3]; 3] = [[0.0, 0.0, 0.0], [0.31, 0.23, -0.27], [-0.43, -0.19, 0.37]];

/// Disjoint parts of an edge, ascending.
struct Pieces {
    list: [[f64; 2]; PIECES_MAX],
    count: usize,
}

/// More pieces than this are not told apart: the last stays open.
const PIECES_MAX: usize = 6;

impl Pieces {
    fn whole() -> Pieces {
        Pieces { list: [[0.0, 1.0]; PIECES_MAX], count: 1 }
    }

    fn iter(&self) -> impl Iterator<Item = [f64; 2]> {
        self.list[..self.count].iter().copied()
    }

    fn remove(&mut self, [from, to]: [f64; 2]) {
        let old = Pieces { list: self.list, count: self.count };
        let parts = |[s, t]: [f64; 2]| [[s, t.min(from)], [s.max(to), t]].into_iter().filter(|[s, t]| s < t);
        if old.iter().map(|piece| parts(piece).count()).sum::<usize>() > PIECES_MAX {
            return;
        }
        self.count = 0;
        for part in old.iter().flat_map(parts) {
            self.list[self.count] = part;
            self.count += 1;
        }
    }
}

impl Eye {
    /// Whether some pixel of the picture may show what is behind the stretch of a line along which two polygons meet without
    /// sharing corners: whether a pixel's centre lies between the two edges as the picture snaps them. A ball of eyes has as many
    /// pictures as eyes: there, one may.
    fn crack_is_open(&self, polygons: &Polygons, polygon: u32, edge: usize, partner: &Partner) -> bool {
        let Some(projector) = &self.picture else { return true };
        let own = snapped(projector, polygons.edge(polygon, edge));
        let other = snapped(projector, polygons.edge(partner.polygon, partner.edge as usize));
        let (Some(own), Some(other)) = (own, other) else { return true };
        // Centres of pixels are the multiples of 256 in snapped coordinates. Walk along the axis that the line runs along.
        let [from, to] = own;
        let along = usize::from((to[1] - from[1]).abs() > (to[0] - from[0]).abs());
        let pixels = [projector.width, projector.height];
        let reach = |[a, b]: [[f64; 2]; 2]| [a[along].min(b[along]), a[along].max(b[along])];
        let ([a, b], [c, d]) = (reach(own), reach(other));
        if a == b || c == d {
            return true;
        }
        // Past the end of the shorter one its next edge begins, which is looked at by itself; half a pixel more does no harm.
        let first = (a.max(c) / 256.0 - 0.5).floor().max(0.0) as i64;
        let last = (b.min(d) / 256.0 + 0.5).ceil().min(f64::from(pixels[along] - 1)) as i64;
        (first..=last).any(|pixel| {
            let at = pixel as f64 * 256.0;
            let [u, v] = [own, other].map(|[from, to]| {
                let share = (at - from[along]) / (to[along] - from[along]);
                from[1 - along] + (to[1 - along] - from[1 - along]) * share
            });
            // Rounding of coordinates up to 2²⁸ is far below this.
            let (low, high) = (u.min(v) - 1e-3, u.max(v) + 1e-3);
            (low / 256.0).ceil() * 256.0 <= high
        })
    }
}

/// Both ends of an edge as the picture snaps them, unless they are cut off first.
fn snapped(projector: &Projector, ends: [glam::DVec3; 2]) -> Option<[[f64; 2]; 2]> {
    let points = ends.map(|end| projector.view_point(end));
    let reach = crate::raster_sampled::setup::GUARD_PX / projector.focal_px;
    let plain = points.iter().all(|p| p.w >= projector.near && p.x.abs().max(p.y.abs()) <= reach * p.w);
    plain.then(|| {
        points.map(|point| {
            let corner = projector.snap(point);
            [corner.x as f64, corner.y as f64]
        })
    })
}
