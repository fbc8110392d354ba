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
//! cost; with six images 74, at more than twice the cost.) What would help is not known; walls that only overlap in the image
//! do not fuse here, and both leave the radius open where one hides the other's edge from every eye.
//!
//! **Joints.** Polygons with edges on exactly one line, on opposite sides of it, hide together in their fronts' union:
//! p must be beyond both planes. If x is on the plane of the first and beyond the line, it is on the second's side of
//! it: in a common plane, and thus in the second, which satisfies all its other edges; where they bend away from the eye
//! it would be in front of the second, but there it is still in the union. So such a group may take the place of one polygon
//! of S. Coplanar neighbours of a polygon on several sides join in the same way, each with its other edges kept.
//! Other pairs join without closers: for every eye, p is on the first's or on the second's side of the line.

// `!(a > b)` where NaN must count as "no".
#![allow(clippy::neg_cmp_op_on_partial_ord)]

use glam::Vec3;

use crate::Aabb;
use crate::closers::{self, Closer};
use crate::occluders::Occluders;
use crate::under::{EdgePlane, Heights, Image, NONE, OCCLUDER_NEAR, ROUNDING, Setup, joints_of};
use crate::under_extent::{Extent, Seen};
use crate::under_face::{Face, Linear, Region};

/// A ball that is nearer to a polygon's plane than this part of its size does not fuse it, because of rounding.
const CLEARANCE: f64 = 1e-5;

/// A polygon that is narrower than so many radii is not worth drawing: hardly any of it is left even beside its closers.
pub(crate) const NARROW: f64 = 1.0;

/// A polygon that is wider than so many radii is left enough of by its joints with one neighbour each.
const STAR_WIDTH: f64 = 3.0;

/// Polygons in one set are at most this many. More edges are open then than close.
const MEMBERS_MAX: usize = 12;

/// Polygons that hide together.
#[derive(Clone, Copy, Debug)]
struct Fusion {
    members: [u32; MEMBERS_MAX],
    /// Edges of each member at which it joins another: neither open nor in need of a closer.
    joined: [u32; MEMBERS_MAX],
    count: usize,
    /// The first so many are drawn as one group.
    group: usize,
    /// Whether the group lies in one plane, so that each of it closes edges.
    coplanar: bool,
}

impl Fusion {
    fn of(polygon: u32) -> Fusion {
        let mut members = [NONE; MEMBERS_MAX];
        members[0] = polygon;
        Fusion { members, joined: [0; MEMBERS_MAX], count: 1, group: 1, coplanar: true }
    }

    /// Adds a polygon, if there is room and it is not there yet.
    fn add(&mut self, polygon: u32, joined: u32) {
        if self.count < MEMBERS_MAX && !self.members[..self.count].contains(&polygon) {
            self.members[self.count] = polygon;
            self.joined[self.count] = joined;
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
    /// Edges of a member that are joined, or closed by a member of `mask`.
    fn shut(&self, fusion: &Fusion, mask: u32, member: usize) -> u32 {
        let closers = self.closed[member].iter().enumerate().filter(|(at, _)| mask >> at & 1 == 1);
        closers.fold(fusion.joined[member], |shut, (_, closed)| shut | closed)
    }
}

/// Which part of a fusion's region is worth drawing.
#[derive(Clone, Copy)]
enum Part {
    /// The image of its first polygon.
    Whole,
    /// Only outside these supporting planes (of edges by index): what the polygons do not cover alone.
    Outside([u32; 2]),
}

impl Image {
    /// [`Image::set_up`] for eyes in a ball.
    pub fn set_up_for_ball(&mut self, occluders: &Occluders, index: u32) -> Option<Setup> {
        let polygon = &occluders.polygons[index as usize];
        let corners = occluders.corners(index);
        let corner = |i: usize| corners[i % corners.len()].as_dvec3();
        let normal = polygon.normal;
        let Heights { low, high, longest } = self.heights(normal, corners);
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
        let height = farthest + error + tilt * longest;
        Some(Setup {
            edges: [first as u32, self.edges.len() as u32],
            from_behind,
            fuses: polygon.flat && clear - radius > CLEARANCE * longest,
            far: normal / if from_behind { height } else { -height },
            far_less: tilt * self.faces[0].reach / height,
            near: None,
        })
    }

    /// Draws a polygon, what it hides with others, and its joints with polygons drawn before.
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
            self.draw_fusion(occluders, &fused, &closure, base | 1 << i, Part::Outside([edge, edge]));
        }
        if width < STAR_WIDTH * self.radius {
            self.draw_star(occluders, polygon, &fused);
        }
        for &[other, joint] in &occluders.joint_lists[joints_of(occluders, polygon)] {
            if self.is_drawn(other) {
                self.join(occluders, joint);
            }
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
                fusion.add(closer.polygon, 0);
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

    /// Whether `other` closes an edge of `polygon` for these eyes.
    fn closing(&mut self, occluders: &Occluders, polygon: u32, other: u32, edge: u32) -> bool {
        let found = closers_of(occluders, polygon)
            .map(|index| occluders.closers[index])
            .find(|found| found.polygon == other && found.edge == edge);
        found.is_some_and(|closer| {
            self.slot(occluders, polygon).is_some_and(|setup| setup.fuses) && self.closes(occluders, &closer)
        })
    }

    /// Draws the polygon's image once more, joined with all its coplanar neighbours: a lintel between two pieces of wall.
    fn draw_star(&mut self, occluders: &Occluders, polygon: u32, fused: &Fusion) {
        let mut star = Fusion::of(polygon);
        for &[other, index] in &occluders.joint_lists[joints_of(occluders, polygon)] {
            let joint = &occluders.joints[index as usize];
            let edges = if joint.polygons[0] == polygon { joint.edges } else { [joint.edges[1], joint.edges[0]] };
            if joint.fold == Some(0.0) && star.joined[0] >> edges[0] & 1 == 0 && self.joins(occluders, index) {
                let before = star.count;
                star.add(other, 1 << edges[1]);
                if star.count > before {
                    star.joined[0] |= 1 << edges[0];
                }
            }
        }
        star.group = star.count;
        if star.group < 2 {
            return;
        }
        for &closer in &fused.members[1..fused.count] {
            star.add(closer, 0);
        }
        for member in 1..star.group {
            self.close(occluders, star.members[member], &mut star);
        }
        self.draw_whole(occluders, &star, Part::Whole);
    }

    /// Whether both polygons of a joint hide something and lie on opposite sides of the line, seen from every eye.
    fn joins(&mut self, occluders: &Occluders, index: u32) -> bool {
        let joint = &occluders.joints[index as usize];
        let [p, q] = joint.polygons.map(|polygon| self.slot(occluders, polygon));
        p.zip(q).is_some_and(|(p, q)| joint.opposite ^ p.from_behind ^ q.from_behind)
    }

    /// Draws the strip along the common line of two polygons that are both drawn.
    fn join(&mut self, occluders: &Occluders, index: u32) {
        if !self.joins(occluders, index) {
            return;
        }
        let joint = &occluders.joints[index as usize];
        let [p, q] = joint.polygons;
        let Some([p_setup, q_setup]) = self.slot(occluders, p).zip(self.slot(occluders, q)).map(|(p, q)| [p, q]) else {
            return;
        };
        if self.closing(occluders, p, q, joint.edges[0]) && self.closing(occluders, q, p, joint.edges[1]) {
            return;
        }
        let mut pair = Fusion::of(p);
        pair.joined[0] = 1 << joint.edges[0];
        pair.add(q, 1 << joint.edges[1]);
        pair.group = 2;
        pair.coplanar = joint.fold == Some(0.0);
        let sign = if q_setup.from_behind { -1.0 } else { 1.0 };
        if p_setup.fuses && q_setup.fuses && joint.fold.is_some_and(|fold| sign * fold <= 0.0) {
            self.close(occluders, p, &mut pair);
            self.close(occluders, q, &mut pair);
        }
        let edges = [p_setup.edges[0] + joint.edges[0], q_setup.edges[0] + joint.edges[1]];
        self.draw_whole(occluders, &pair, Part::Outside(edges));
        self.stats.joints += 1;
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
                if at >= fusion.group || fusion.coplanar && i >= fusion.group {
                    closure.closed[i][at] = (0..edges)
                        .filter(|edge| fusion.joined[i] >> edge & 1 == 0)
                        .filter_map(|edge| closers::relation(occluders, polygon, edge, other))
                        .filter(|closed| closed.closes(closer.from_behind))
                        .fold(0, |mask, closed| mask | 1 << closed.edge);
                }
            }
        }
        closure
    }

    /// Which members' open edges leave out some corner of the first polygon, if only those of `mask` fuse.
    fn cutting(&mut self, occluders: &Occluders, fusion: &Fusion, closure: &Closure, mask: u32) -> u32 {
        let cuts = |i: &usize| {
            let Some(setup) = closure.setups[*i] else { return true };
            let shut = closure.shut(fusion, mask, *i);
            (setup.edges[0]..setup.edges[1]).enumerate().any(|(bit, edge)| {
                let normal = self.edges[edge as usize].normal;
                let inside = |corner: &Vec3| normal.dot(corner.as_dvec3() - self.eye) >= 0.0;
                shut >> bit & 1 == 0 && !occluders.corners(fusion.members[0]).iter().all(inside)
            })
        };
        (1..fusion.count).filter(|i| mask >> i & 1 == 1).filter(cuts).fold(0, |mask, i| mask | 1 << i)
    }

    /// Draws a fusion of which all members count.
    fn draw_whole(&mut self, occluders: &Occluders, fusion: &Fusion, part: Part) {
        let closure = self.closure(occluders, fusion);
        self.draw_fusion(occluders, fusion, &closure, (1 << fusion.count) - 1, part);
    }

    /// Draws what those members of a fusion hide that are in `mask`, within the image of its first polygon (of both, for a
    /// joint's strip).
    fn draw_fusion(&mut self, occluders: &Occluders, fusion: &Fusion, closure: &Closure, mask: u32, part: Part) {
        let members = &fusion.members[..fusion.count];
        let setups = &closure.setups;
        let shut: [u32; MEMBERS_MAX] =
            std::array::from_fn(|i| if mask >> i & 1 == 1 { closure.shut(fusion, mask, i) } else { 0 });
        let strip = matches!(part, Part::Outside(_)) && fusion.group == 2;
        let shown = if strip { &members[..2] } else { &members[..1] };
        let aabb =
            shown.iter().fold(Aabb::EMPTY, |aabb, &polygon| aabb.union(&occluders.polygons[polygon as usize].aabb));
        let relative = Aabb::new(aabb.min - self.eye, aabb.max - self.eye);
        for face in &mut self.faces {
            if self.aligned && matches!(face.rectangle_aligned(&relative), Seen::Outside) {
                continue;
            }
            let mut extent = Extent::new(face);
            for &polygon in shown {
                for corner in occluders.corners(polygon) {
                    extent.add(face.local(corner.as_dvec3() - self.eye));
                }
            }
            let Some([columns, rows]) = extent.pixels(face) else { continue };
            let mut region = Region::within(face, columns, rows);
            let linear =
                |face: &Face, plane: &EdgePlane| (face.linear(face.local(plane.normal)), plane.error * face.reach);
            if let Part::Outside(edges) = part {
                let both = if edges[0] == edges[1] { &edges[..1] } else { &edges[..] };
                for &edge in both {
                    let (linear, error) = linear(face, &self.edges[edge as usize]);
                    region.cut_to_border(linear, error);
                }
            }
            for (i, (setup, &shut)) in setups.iter().zip(&shut).enumerate().filter(|(i, _)| mask >> i & 1 == 1) {
                let Some(setup) = setup else { continue };
                for (bit, edge) in (setup.edges[0]..setup.edges[1]).enumerate() {
                    if shut >> bit & 1 == 0 {
                        let (linear, error) = linear(face, &self.edges[edge as usize]);
                        region.cut(linear, error);
                    } else if i == 0 && !strip {
                        let error = self.edges[edge as usize].error * face.reach;
                        region.cut_to_touching(face.linear(face.local(self.sights[edge as usize])), error);
                    }
                }
                if region.is_empty() {
                    break;
                }
            }
            let far = |setup: &Setup| {
                let linear = face.linear(face.local(setup.far));
                Linear { c: linear.c - setup.far_less, ..linear }
            };
            match [&setups[0], &setups[1]] {
                [Some(p), Some(q)] if strip => face.fill(&region, [far(p), far(q)]),
                [Some(p), _] => face.fill(&region, [far(p)]),
                _ => {}
            }
        }
    }
}

fn closers_of(occluders: &Occluders, polygon: u32) -> std::ops::Range<usize> {
    let closers = &occluders.polygons[polygon as usize].closers;
    closers.start as usize..closers.end as usize
}
