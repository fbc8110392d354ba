//! What is closed for *every* eye of a ball? The part of [`crate::UnderOcclusion`] for eye regions with a radius.
//!
//! Eyes are the points e of a ball with centre c and radius ρ. Depths and directions are measured from c. Testing bounds
//! that are inflated by ρ from c alone would be wrong: an eye 0.3 m from a jamb that moves by 0.15 m uncovers 15 m at 30 m.
//!
//! **One polygon.** A polygon X counts only if the whole ball is strictly on the side that hides, its front. For each edge
//! with a corner v take the *supporting plane* (Coorg and Teller 1997, §2): through the edge, tangent to the ball, ball
//! and polygon on one side, unit normal n inward, so that n·(c − v) = ρ and n·(e − v) ≥ 0. Let p = c + t·d be beyond
//! X's plane with n·d ≥ 0 for each edge. Then n·(p − v) = ρ + t·n·d ≥ 0, so the segment from e to p, which crosses X's plane,
//! stays on the inner side of each edge and crosses X. So p is hidden from every eye, and since n·d ≥ 0 speaks of directions
//! from c alone, the image is drawn as for a point, with other edges. For loops that are not quite flat the same holds
//! with e's own plane through the edge (the disc argument of [`crate::Occluders`]): by the cross-section along the edge, where
//! e is in front of the edge's own normal and p behind it. That normal differs from X's by the sine between the edge and X's
//! plane, so depth gives way by that much.
//!
//! **Fusion.** Eroded by ρ, polygons would leak at every line where they meet. Let S be a set of polygons with the ball
//! strictly in front of all their planes. Edge f of X is *closed* by Y of S if X's whole plane beyond f is behind Y's plane
//! (a wall's foot on a floor, in the corner of a room, or run into another wall: [`crate::closers`]), else it is *open*. Let n·d ≥ 0
//! for the supporting planes of all open edges of all of S. Then each p beyond the plane of *any* X of S is hidden from every
//! eye. Proof: let K be what is in front of all planes of S, which is convex and contains e but not p. The segment leaves K at
//! a point x, in the plane of some Y of S and behind no other. Were x beyond an edge of Y, then not beyond an open one, since
//! both e and p are on the inner side of its supporting plane; nor beyond a closed one, since it would be behind the plane
//! that closes it. So x is a point of Y, and it is before p. No shape of corner is special: three walls in a vertex, a wall on
//! a continuing floor, a jamb on a sill are all sets S. Rounding: planes and edges are exact to 10⁻¹² of sizes, and p
//! is farther than it needs by 10⁻⁶ of its depth ([`crate::under_face`] rounds 1/z down), which at an eye that is clear of the
//! plane by 10⁻⁵ of the polygon's size is more.
//!
//! **Near targets.** n·d ≥ 0 serves every depth. For p no farther than T along the image's axis n·d ≥ −ρ/T is enough, in both
//! proofs, since n·(p − v) = ρ + t·n·d is all that they use. Images for several T were measured and are not here: what is kept
//! for nothing is mostly far away, where little is gained, and drawing costs more with each. (`eyeline-sim`'s `building`, 30 eyes,
//! ρ = 0.3 m, all round: with images up to 6 m, 18 m and without end 90 boxes of furniture were kept instead of 100, at 1.3 times the
//! cost; with six images 74, at more than twice the cost.) Nor are joints drawn, as from a point: for balls they took half of
//! the time and closed next to nothing.
//!
//! The image is quick and, at open edges, loose. Bounds that it leaves open are asked about once more: [`crate::sheets`].

// `!(a > b)` where NaN must count as "no".
#![allow(clippy::neg_cmp_op_on_partial_ord)]

use glam::Vec3;

use crate::Aabb;
use crate::closers::{self, Closer};
use crate::occluders::Occluders;
use crate::under::{EdgePlane, Heights, Image, NONE, OCCLUDER_NEAR, ROUNDING, Setup};
use crate::under_extent::{Extent, Reach};
use crate::under_face::{Face, Linear, Region};

/// A ball that is nearer to a polygon's plane than this part of its size does not fuse it, because of rounding.
const CLEARANCE: f64 = 1e-5;

/// A polygon that is narrower than so many radii is not worth drawing: hardly any of it is left even beside its closers.
pub(crate) const NARROW: f64 = 1.0;

/// Polygons in one set are at most this many. More edges are open then than close.
const MEMBERS_MAX: usize = 12;

/// Polygons that hide together.
#[derive(Clone, Copy, Debug)]
struct Fusion {
    members: [u32; MEMBERS_MAX],
    count: usize,
}

impl Fusion {
    fn of(polygon: u32) -> Fusion {
        let mut members = [NONE; MEMBERS_MAX];
        members[0] = polygon;
        Fusion { members, count: 1 }
    }

    /// Adds a polygon, if there is room and it is not there yet.
    fn add(&mut self, polygon: u32) {
        if self.count < MEMBERS_MAX && !self.members[..self.count].contains(&polygon) {
            self.members[self.count] = polygon;
            self.count += 1;
        }
    }
}

/// A fusion's members as seen from this frame's eyes.
struct Closure {
    setups: [Option<Setup>; MEMBERS_MAX],
    /// `closed[i][j]`: edges of member i that member j closes.
    closed: [[u32; MEMBERS_MAX]; MEMBERS_MAX],
}

impl Closure {
    /// Edges of a member that a member of `mask` closes.
    fn shut(&self, mask: u32, member: usize) -> u32 {
        let closers = self.closed[member].iter().enumerate().filter(|(at, _)| mask >> at & 1 == 1);
        closers.fold(0, |shut, (_, closed)| shut | closed)
    }
}

/// A polygon before a ball of eyes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Front {
    /// Whether the eyes are behind it, and it hides from there too.
    pub from_behind: bool,
    /// The ball's radius with room for rounding, metres.
    radius: f64,
    /// Greatest distance of the polygon from the plane through the ball's centre, metres.
    farthest: f64,
    /// The polygon's tilt, rounded up.
    tilt: f64,
    /// Whether it is flat, and so far from all eyes that rounding cannot matter where it joins others.
    pub joins: bool,
}

/// Which part of a fusion's region is worth drawing.
#[derive(Clone, Copy)]
enum Part {
    /// The image of its first polygon.
    Whole,
    /// Only outside the supporting plane of this edge (by index): what the polygon does not cover alone.
    Outside(u32),
}

impl Image {
    /// How the whole ball stands before a polygon; none unless it is strictly on a side that hides, whatever the near plane.
    pub fn front(&self, occluders: &Occluders, index: u32) -> Option<Front> {
        let polygon = &occluders.polygons[index as usize];
        let Heights { low, high, longest } = self.heights(polygon.normal, occluders.corners(index));
        let from_behind = low > 0.0;
        if from_behind && !self.hides_from_behind(occluders, index) {
            return None;
        }
        let error = ROUNDING * (longest + self.eye.abs().element_sum());
        let radius = self.radius + error;
        let tilt = polygon.tilt * (1.0 + 1e-9) + ROUNDING;
        let (clear, farthest) = if from_behind { (low, high) } else { (-high, -low) };
        if !(clear > radius + error + tilt * (longest + radius)) {
            return None;
        }
        // A camera's near plane must not cut the polygon before any eye: its points are at least `near` away along any axis
        // that looks at them.
        let near = OCCLUDER_NEAR * self.near * if self.aligned { 1.0 } else { self.faces[0].reach };
        if clear < radius + near && polygon.aabb.distance(self.eye) < (radius + near) * (1.0 + 1e-9) {
            return None;
        }
        let joins = polygon.flat && clear - radius > CLEARANCE * longest;
        Some(Front { from_behind, radius, farthest: farthest + error + tilt * longest, tilt, joins })
    }

    /// [`Image::set_up`] for eyes in a ball.
    pub fn set_up_for_ball(&mut self, occluders: &Occluders, index: u32) -> Option<Setup> {
        let Front { from_behind, radius, farthest: height, tilt, joins } = self.front(occluders, index)?;
        let corners = occluders.corners(index);
        let corner = |i: usize| corners[i % corners.len()].as_dvec3();
        let normal = occluders.polygons[index as usize].normal;
        let first = self.edges.len();
        for i in 0..corners.len() {
            let v = corner(i) - self.eye;
            let along = (corner(i + 1) - corner(i)).normalize();
            let across = v - along * v.dot(along);
            let distance = across.length();
            let sine = radius / distance;
            let cosine = (1.0 - sine * sine).max(0.0).sqrt();
            if !(cosine > 1e-6) {
                self.edges.truncate(first);
                self.sights.truncate(first);
                return None;
            }
            let outward = v.cross(along) / distance;
            let sight = if from_behind { outward } else { -outward };
            let normal = sight * cosine - across * (sine / distance);
            let size = v.abs().element_sum() + self.eye.abs().element_sum();
            let error = ROUNDING * (1.0 + size / distance) * (1.0 + 1.0 / cosine);
            self.edges.push(EdgePlane { normal, error });
            self.sights.push(sight);
        }
        Some(Setup {
            edges: [first as u32, self.edges.len() as u32],
            from_behind,
            fuses: joins,
            far: normal / if from_behind { height } else { -height },
            far_less: tilt * self.faces[0].reach / height,
            near: None,
        })
    }

    /// Draws a polygon and what it hides with others.
    pub fn draw_for_ball(&mut self, occluders: &Occluders, polygon: u32) {
        let Some(setup) = self.slot(occluders, polygon) else { return };
        let mut fused = Fusion::of(polygon);
        let closed = self.close(occluders, polygon, &mut fused);
        let width = occluders.polygons[polygon as usize].width;
        let closure = self.closure(occluders, &fused);
        // Open edges of others that pass before the polygon would take parts of it away, so only one such polygon at a time.
        let all = (1_u32 << fused.count) - 1;
        let mut base = all;
        loop {
            let cut = self.cutting(occluders, &fused, &closure, base);
            if cut == 0 {
                break;
            }
            // Without one, edges that it closed may be open.
            base &= !cut;
        }
        // Each open edge takes the radius at least.
        if base != 1 || width > 2.0 * self.radius {
            self.draw_fusion(occluders, &fused, &closure, base, Part::Whole);
        }
        for i in (1..fused.count).filter(|i| (all & !base) >> i & 1 == 1) {
            let closed = closers_of(occluders, polygon)
                .map(|index| occluders.closers[index])
                .find(|closer| closer.polygon == fused.members[i] && closed >> closer.edge & 1 == 1);
            let Some(closer) = closed else { continue };
            let edge = setup.edges[0] + closer.edge;
            self.draw_fusion(occluders, &fused, &closure, base | 1 << i, Part::Outside(edge));
        }
    }

    /// Adds the best closer of each edge of `polygon`. Returns which edges have one.
    fn close(&mut self, occluders: &Occluders, polygon: u32, fusion: &mut Fusion) -> u32 {
        if !self.slot(occluders, polygon).is_some_and(|setup| setup.fuses) {
            return 0;
        }
        let mut closed = 0_u32;
        for index in closers_of(occluders, polygon) {
            let closer = occluders.closers[index];
            if closed >> closer.edge & 1 == 0 && self.closes(occluders, &closer) {
                closed |= 1 << closer.edge;
                fusion.add(closer.polygon);
            }
        }
        closed
    }

    /// Whether a closer faces these eyes so that it closes its edge.
    fn closes(&mut self, occluders: &Occluders, closer: &Closer) -> bool {
        let corner = occluders.corners(closer.polygon)[0].as_dvec3();
        let from_behind = occluders.polygons[closer.polygon as usize].normal.dot(self.eye - corner) < 0.0;
        // Most face the other way, which is cheaper to see than to set them up.
        closer.closes(from_behind) && self.slot(occluders, closer.polygon).is_some_and(|setup| setup.fuses)
    }

    /// The members as seen from the eyes, and which edges of each the others close.
    fn closure(&mut self, occluders: &Occluders, fusion: &Fusion) -> Closure {
        let members = &fusion.members[..fusion.count];
        let mut closure = Closure { setups: [None; MEMBERS_MAX], closed: [[0; MEMBERS_MAX]; MEMBERS_MAX] };
        for (setup, &polygon) in closure.setups.iter_mut().zip(members) {
            *setup = self.slot(occluders, polygon);
        }
        let fuses = |i: usize| closure.setups[i].filter(|setup| setup.fuses);
        for (i, &polygon) in members.iter().enumerate().filter(|&(i, _)| fuses(i).is_some()) {
            let edges = occluders.corners(polygon).len() as u32;
            for (at, &other) in members.iter().enumerate().filter(|&(at, _)| at != i) {
                let Some(closer) = fuses(at) else { continue };
                closure.closed[i][at] = (0..edges)
                    .filter_map(|edge| closers::relation(occluders, polygon, edge, other))
                    .filter(|closed| closed.closes(closer.from_behind))
                    .fold(0, |mask, closed| mask | 1 << closed.edge);
            }
        }
        closure
    }

    /// Which members' open edges leave out some corner of the first polygon, if only those of `mask` fuse.
    fn cutting(&mut self, occluders: &Occluders, fusion: &Fusion, closure: &Closure, mask: u32) -> u32 {
        let cuts = |i: &usize| {
            let Some(setup) = closure.setups[*i] else { return true };
            let shut = closure.shut(mask, *i);
            (setup.edges[0]..setup.edges[1]).enumerate().any(|(bit, edge)| {
                let normal = self.edges[edge as usize].normal;
                let inside = |corner: &Vec3| normal.dot(corner.as_dvec3() - self.eye) >= 0.0;
                shut >> bit & 1 == 0 && !occluders.corners(fusion.members[0]).iter().all(inside)
            })
        };
        (1..fusion.count).filter(|i| mask >> i & 1 == 1).filter(cuts).fold(0, |mask, i| mask | 1 << i)
    }

    /// Draws what those members of a fusion hide that are in `mask`, within the image of its first polygon.
    fn draw_fusion(&mut self, occluders: &Occluders, fusion: &Fusion, closure: &Closure, mask: u32, part: Part) {
        let setups = &closure.setups;
        let shut: [u32; MEMBERS_MAX] =
            std::array::from_fn(|i| if mask >> i & 1 == 1 { closure.shut(mask, i) } else { 0 });
        let shown = fusion.members[0];
        let Some(far) = setups[0] else { return };
        let aabb = occluders.polygons[shown as usize].aabb;
        let reach = Reach::of(&Aabb::new(aabb.min - self.eye, aabb.max - self.eye));
        for face in &mut self.faces {
            if self.aligned && face.misses(&reach) {
                continue;
            }
            let mut extent = Extent::new(face);
            for corner in occluders.corners(shown) {
                extent.add(face.local(corner.as_dvec3() - self.eye));
            }
            let Some([columns, rows]) = extent.pixels(face) else { continue };
            let mut region = Region::within(face, columns, rows);
            let linear =
                |face: &Face, plane: &EdgePlane| (face.linear(face.local(plane.normal)), plane.error * face.reach);
            if let Part::Outside(edge) = part {
                let (linear, error) = linear(face, &self.edges[edge as usize]);
                region.cut_to_border(linear, error);
            }
            for (i, (setup, &shut)) in setups.iter().zip(&shut).enumerate().filter(|(i, _)| mask >> i & 1 == 1) {
                let Some(setup) = setup else { continue };
                for (bit, edge) in (setup.edges[0]..setup.edges[1]).enumerate() {
                    if shut >> bit & 1 == 0 {
                        let (linear, error) = linear(face, &self.edges[edge as usize]);
                        region.cut(linear, error);
                    } else if i == 0 {
                        let error = self.edges[edge as usize].error * face.reach;
                        region.cut_to_touching(face.linear(face.local(self.sights[edge as usize])), error);
                    }
                }
                if region.is_empty() {
                    break;
                }
            }
            let plane = face.linear(face.local(far.far));
            face.fill(&region, [Linear { c: plane.c - far.far_less, ..plane }]);
        }
    }
}

fn closers_of(occluders: &Occluders, polygon: u32) -> std::ops::Range<usize> {
    let closers = &occluders.polygons[polygon as usize].closers;
    closers.start as usize..closers.end as usize
}
