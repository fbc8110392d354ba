//! Is a bound hidden from every eye of a ball by polygons that join? The second opinion of [`crate::UnderOcclusion`] for balls.
//!
//! The image of [`crate::under_region`] moves every edge that it cannot close inward by the ball's radius, whoever asks. Here one
//! bound asks, so only what lies between it and the eyes counts: the edges in its [`Shaft`], with what they join there. That
//! costs many times what the image costs, so it is asked only where the image says "open".
//!
//! **Sheets.** Let E be the ball, D the shaft's far end, which each segment from E to the bound crosses, and K the shaft. Let S be
//! flat convex polygons with all of E strictly in front. Each stretch in K of an edge f of one of S shall be *shut* by others of S:
//! f lies (a) in such a polygon, not along an edge of it, or (b) along an edge of it from the other side, so that the two edges
//! run in opposite directions as seen from E, whatever the bend between the polygons. Then for each p of D either all eyes
//! have [e, p) meet S, or none. Proof: let V be the eyes that have.
//! - V is open. Let [e, p) meet S at x, and project what is near x along it. Each of S that contains x is a sector around x: e is
//!   strictly in front of its plane and p strictly behind. Were the sectors' union not all around x, it would end at a ray r of
//!   some edge f of one of them. K has room around x, so f is shut along r near x: in case (a) r is inside another sector, in case
//!   (b) another sector lies on r's other side. Both contradict. So segments of nearby eyes to p meet S near x.
//! - V is closed. Segments of a sequence of eyes that tend to e meet one polygon of S infinitely often, at points that tend to a
//!   point of it on [e, p]. That is not p, which is strictly behind the polygon's plane.
//!
//! E is connected, so V is all of E or nothing.
//!
//! **From the centre.** Now let the eye stay in E's centre c and p move over a convex cell C of D. If no polygon of S touches C, the same
//! proof says that [c, p) meets S for all p of C or for none, and one ray decides. (Without that p might end on S.) Polygons
//! that do touch C, as floors do, are left out, and then all that is open in the cone from c to C without them. Cells that this
//! leaves undecided are split. So if all cells are met, all segments from E to the bound are.
//!
//! **Which S?** If two sets of polygons are shut, their union is, so there is a greatest one: drop polygons with an open stretch until there
//! is none. Parts of polygons are polygons too: where one runs into another (walls that overlap at a corner) it is cut off at
//! the other's plane, and the new edge lies in the other, case (a).
//!
//! It is tempting to call an edge shut that something nearer hides from all of E. That is wrong: past the edge the
//! sheet is lost, and what hides the edge need not hide what is seen there. (`tests/region.rs` has such a place.)
//!
//! **Rounding.** Common lines and planes are exact up to 10⁻¹² of sizes, as in [`crate::closers`], and eyes are clear of the planes by 10⁻⁵.
//! Shafts and cones are widened, and rays must keep clear of edges, by 10⁻⁹. Polygons that are not flat never take part.

// `!(a > b)` where NaN must count as "no".
#![allow(clippy::neg_cmp_op_on_partial_ord)]

use glam::DVec3;

use crate::closers::EXACT;
use crate::occluders::{CORNERS_MAX, Occluders};
use crate::shaft::{SIDES, Shaft, clip, cone};
use crate::under::Image;
use crate::{Aabb, Bound};

/// So many polygons of one shaft are looked at, the nearest ones: the pairs of more cost time. On oa_dm2, of 1,892 balls of 2 to 4 m
/// from eyes within 0.25 m, 64, 128 and 256 left 619, 571 and 559 open, by a probe that was not kept.
const POLYGONS_MAX: usize = 128;

/// With so many polygons a first try is made: those near the eyes often close the shaft, whatever is beyond.
const FIRST_TRY: usize = 16;

/// A polygon narrower than so many radii is not looked at: legs of furniture close nothing, and there are many.
const WIDTH_MIN: f64 = 0.3;

/// A cut takes one corner more.
const CORNERS: usize = CORNERS_MAX + 4;

/// How often a cell of the far end is split in four.
const SPLITS_MAX: u32 = 3;

/// Rays keep this sine from a polygon's edges, and ends this part of the depth from its plane.
const CLEAR: f64 = 1e-9;

/// Whether the bound is hidden from every eye of the image's ball, by polygons in its shaft, of which any set will do. `false`
/// is no answer.
pub(crate) fn hide(image: &Image, occluders: &Occluders, bound: &Bound) -> bool {
    let Some(shaft) = Shaft::new(image.eye, image.radius, bound) else { return false };
    let members = Vec::with_capacity(FIRST_TRY);
    let mut sheets = Sheets { shaft: &shaft, members, demands: Vec::new(), seams: Vec::new() };
    let middle = shaft.end.iter().sum::<DVec3>() / SIDES as f64;
    let mut closed = false;
    let width_min = WIDTH_MIN * image.radius;
    occluders.tree.in_shaft(&occluders.polygons, image.eye, &shaft, width_min, |polygon| {
        let Some(member) = Member::new(image, occluders, polygon, &shaft) else { return true };
        let whole = sheets.add(member);
        let count = sheets.members.len();
        // Without an edge in the shaft, one ray speaks for all.
        closed = whole && sheets.members[count - 1].crosses(middle, CLEAR) && !sheets.touches(count - 1, &shaft.end)
            || count == FIRST_TRY && sheets.close(middle, false);
        !closed && count < POLYGONS_MAX
    });
    closed || sheets.close(middle, true)
}

/// A polygon that the whole ball is in front of, relative to the ball's centre.
struct Member {
    /// Unit normal to the eyes' side.
    normal: DVec3,
    /// Anticlockwise as the eyes see it.
    corners: [DVec3; CORNERS],
    /// Unit normals, inward, of the planes through the centre and each edge.
    sides: [DVec3; CORNERS],
    count: usize,
    aabb: Aabb,
    /// Greatest depth along the shaft's axis.
    depth: f64,
}

/// A stretch of a member's edge that lies in the shaft.
struct Demand {
    of: usize,
    edge: [DVec3; 2],
    stretch: [f64; 2],
    /// Range in [`Sheets::seams`]: who continues the sheet there, by where they begin.
    seams: [usize; 2],
}

/// The polygons in a shaft, and how they join.
struct Sheets<'a> {
    shaft: &'a Shaft,
    members: Vec<Member>,
    demands: Vec<Demand>,
    seams: Vec<(usize, [f64; 2])>,
}

impl Member {
    /// None for a polygon that is not in the shaft, or cannot be believed to join others.
    fn new(image: &Image, occluders: &Occluders, polygon: u32, shaft: &Shaft) -> Option<Member> {
        let corners = occluders.corners(polygon);
        let count = corners.len();
        let mut local = [DVec3::ZERO; CORNERS];
        if count > CORNERS_MAX {
            return None;
        }
        for (local, corner) in local.iter_mut().zip(corners) {
            *local = corner.as_dvec3() - image.eye;
        }
        if shaft.misses(&local[..count]) {
            return None;
        }
        let front = image.front(occluders, polygon).filter(|front| front.joins)?;
        let mut normal = occluders.polygons[polygon as usize].normal;
        if front.from_behind {
            local[..count].reverse();
            normal = -normal;
        }
        Some(Member::with_corners(normal, local, count, shaft))
    }

    fn with_corners(normal: DVec3, corners: [DVec3; CORNERS], count: usize, shaft: &Shaft) -> Member {
        let mut member = Member { normal, corners, sides: corners, count, aabb: Aabb::EMPTY, depth: 0.0 };
        for i in 0..count {
            let (p, q) = (corners[i], corners[(i + 1) % count]);
            member.sides[i] = q.cross(p) / (p.length_squared() * q.length_squared()).sqrt();
            member.aabb = member.aabb.with_point(p);
            member.depth = member.depth.max(shaft.axis.dot(p));
        }
        member
    }

    /// Height of a point over the polygon's plane, to the eyes' side.
    fn height(&self, point: DVec3) -> f64 {
        self.normal.dot(point - self.corners[0])
    }

    /// Where `other`'s plane crosses the polygon.
    fn crossing(&self, other: &Member) -> Option<[DVec3; 2]> {
        let mut ends = [DVec3::ZERO; 2];
        let mut found = 0;
        for [p, q] in self.edges() {
            let (a, b) = (other.height(p), other.height(q));
            if (a > 0.0) != (b > 0.0) && found < 2 {
                ends[found] = p.lerp(q, a / (a - b));
                found += 1;
            }
        }
        (found == 2).then_some(ends)
    }

    /// The part of the polygon in front of `other`'s plane, if that is a polygon of few enough corners.
    fn cut(&self, other: &Member, shaft: &Shaft) -> Option<Member> {
        let mut corners = [DVec3::ZERO; CORNERS];
        let mut count = 0;
        for [p, q] in self.edges() {
            let (a, b) = (other.height(p), other.height(q));
            let crossing = (a > 0.0 && b < 0.0 || a < 0.0 && b > 0.0).then(|| p.lerp(q, a / (a - b)));
            for corner in (a >= 0.0).then_some(p).into_iter().chain(crossing) {
                *corners.get_mut(count)? = corner;
                count += 1;
            }
        }
        (count >= 3).then(|| Member::with_corners(self.normal, corners, count, shaft))
    }

    fn edges(&self) -> impl Iterator<Item = [DVec3; 2]> + '_ {
        (0..self.count).map(|i| [self.corners[i], self.corners[if i + 1 == self.count { 0 } else { i + 1 }]])
    }

    /// Whether the ray from the centre to `end` crosses the polygon before it, at least so far inside its edges.
    fn crosses(&self, end: DVec3, clear: f64) -> bool {
        let rate = self.normal.dot(end);
        let height = self.normal.dot(self.corners[0]);
        // Both are negative before the front.
        rate < 0.0 && height > rate * (1.0 - CLEAR) && {
            let clear = clear * end.length();
            self.sides[..self.count].iter().all(|side| side.dot(end) > clear)
        }
    }

    /// Which stretch of an edge this polygon continues: the edge is in it, or lies along one of its own from the other side.
    fn seam(&self, edge: [DVec3; 2]) -> Option<[f64; 2]> {
        let [from, to] = edge;
        let along = to - from;
        let length = along.length();
        let snapped = |across: DVec3, height: f64| {
            if height.abs() <= EXACT * (across.abs().element_sum() + length) { 0.0 } else { height }
        };
        let height = |end: DVec3| snapped(end - self.corners[0], self.normal.dot(end - self.corners[0]));
        if height(from) != 0.0 || height(to) != 0.0 {
            return None;
        }
        let [mut low, mut high] = [0.0_f64, 1.0_f64];
        for [p, q] in self.edges() {
            let side = q - p;
            let inward = self.normal.cross(side) / side.length();
            let [a, b] = edge.map(|end| snapped(end - p, inward.dot(end - p)));
            if a == 0.0 && b == 0.0 {
                let at = |corner: DVec3| (corner - from).dot(along) / (length * length);
                return if side.dot(along) < 0.0 { stretch(at(q), at(p)) } else { None };
            }
            if a <= 0.0 && b <= 0.0 {
                return None;
            }
            if a < 0.0 {
                low = low.max(a / (a - b));
            } else if b < 0.0 {
                high = high.min(a / (a - b));
            }
        }
        stretch(low, high)
    }
}

fn stretch(low: f64, high: f64) -> Option<[f64; 2]> {
    let (low, high) = (low.max(0.0), high.min(1.0));
    (low < high).then_some([low, high])
}

impl Sheets<'_> {
    /// Adds a member and its edges in the shaft. Returns whether there are none.
    fn add(&mut self, member: Member) -> bool {
        let before = self.demands.len();
        self.members.push(member);
        self.demand(self.members.len() - 1);
        self.demands.len() == before
    }

    fn demand(&mut self, of: usize) {
        for edge in self.members[of].edges() {
            if let Some(stretch) = self.shaft.clip(edge) {
                self.demands.push(Demand { of, edge, stretch, seams: [0, 0] });
            }
        }
    }

    /// Whether every segment from the ball to the far end meets one of the polygons before it, as they are or cut where they run
    /// into each other.
    fn close(&mut self, middle: DVec3, cutting: bool) -> bool {
        let met = |at: DVec3| self.members.iter().any(|member| member.crosses(at, -CLEAR));
        // Most that is seen ends here.
        if !met(middle) || !self.shaft.end.iter().step_by(2).all(|&corner| met(corner.lerp(middle, 0.1))) {
            return false;
        }
        self.join();
        self.is_closed()
            || cutting && self.cut() && {
                self.join();
                self.is_closed()
            }
    }

    fn is_closed(&self) -> bool {
        let mut alive = vec![true; self.members.len()];
        self.drop_open(&mut alive, None);
        alive.contains(&true) && self.covers(&self.shaft.end, &alive, SPLITS_MAX + 1)
    }

    /// Cuts polygons off where they run into others. Returns whether there were any.
    fn cut(&mut self) -> bool {
        let alive = vec![true; self.members.len()];
        let mut cuts = Vec::new();
        for demand in self.demands.iter().filter(|demand| self.is_open(demand, demand.stretch, &alive)) {
            let ends = demand.stretch.map(|share| demand.edge[0].lerp(demand.edge[1], share));
            let member = &self.members[demand.of];
            let runs_into = |other: &Member| {
                if ends.iter().any(|&end| other.height(end) > 0.0) {
                    return false;
                }
                let Some(line) = member.crossing(other) else { return false };
                let Some(within) = self.shaft.clip(line) else { return false };
                other.seam(line).is_some_and(|seam| seam[0] <= within[0] && within[1] <= seam[1])
            };
            let into =
                self.members.iter().enumerate().position(|(index, other)| index != demand.of && runs_into(other));
            cuts.extend(into.map(|into| (demand.of, into)));
        }
        let mut any = false;
        for (of, into) in cuts {
            if let Some(member) = self.members[of].cut(&self.members[into], self.shaft) {
                self.members[of] = member;
                any = true;
            }
        }
        if any {
            self.demands.clear();
            (0..self.members.len()).for_each(|of| self.demand(of));
        }
        any
    }

    /// Finds who continues each edge.
    fn join(&mut self) {
        let Sheets { members, demands, seams, .. } = self;
        seams.clear();
        for demand in demands {
            let [from, to] = demand.edge;
            let first = seams.len();
            let around = Aabb::new(from.min(to), from.max(to));
            let around = around.inflated(EXACT * around.max.abs().max(around.min.abs()).element_sum());
            for (index, other) in members.iter().enumerate() {
                if index == demand.of || !other.aabb.intersects(&around) {
                    continue;
                }
                let within = demand.stretch;
                let seam = other.seam(demand.edge).filter(|seam| seam[0] <= within[1] && seam[1] >= within[0]);
                seams.extend(seam.map(|seam| (index, seam)));
            }
            seams[first..].sort_by(|a, b| a.1[0].total_cmp(&b.1[0]).then(a.0.cmp(&b.0)));
            demand.seams = [first, seams.len()];
        }
    }

    /// Drops members with an opening, in the shaft or in a cone within it, until none has one.
    fn drop_open(&self, alive: &mut [bool], cone: Option<&[(DVec3, f64)]>) {
        loop {
            let mut changed = false;
            for demand in &self.demands {
                if !alive[demand.of] {
                    continue;
                }
                let within = match cone {
                    Some(spaces) => clip(spaces, demand.edge, demand.stretch),
                    None => Some(demand.stretch),
                };
                if within.is_some_and(|within| self.is_open(demand, within, alive)) {
                    alive[demand.of] = false;
                    changed = true;
                }
            }
            if !changed {
                return;
            }
        }
    }

    /// Whether somewhere in the stretch no living member goes on.
    fn is_open(&self, demand: &Demand, within: [f64; 2], alive: &[bool]) -> bool {
        let mut reach = within[0];
        let mut met = false;
        for &(other, [from, to]) in &self.seams[demand.seams[0]..demand.seams[1]] {
            if alive[other] && to >= within[0] {
                if from > reach + EXACT {
                    break;
                }
                met = true;
                reach = reach.max(to);
            }
        }
        !met || reach + EXACT < within[1]
    }

    /// Whether from the centre no point of a convex cell of the far end can be seen.
    fn covers(&self, cell: &[DVec3], alive: &[bool], splits: u32) -> bool {
        let any = |alive: &[bool], test: &dyn Fn(&Member) -> bool| {
            self.members.iter().zip(alive).any(|(member, alive)| *alive && test(member))
        };
        if any(alive, &|member| cell.iter().all(|&corner| member.crosses(corner, CLEAR))) {
            return true;
        }
        let mut apart = alive.to_vec();
        let mut touched = false;
        for (index, alive) in apart.iter_mut().enumerate() {
            if *alive && self.touches(index, cell) {
                *alive = false;
                touched = true;
            }
        }
        if touched {
            let mut spaces = Vec::new();
            cone(cell, &mut spaces);
            self.drop_open(&mut apart, Some(&spaces));
        }
        // Any ray decides; one that meets a seam does not.
        let middle = cell.iter().sum::<DVec3>() / cell.len() as f64;
        let samples = [middle, middle.lerp(cell[0], 0.31), middle.lerp(cell[1], 0.43), middle.lerp(cell[2], 0.17)];
        if samples.iter().any(|&at| any(&apart, &|member| member.crosses(at, CLEAR))) {
            return true;
        }
        if splits == 0 || !touched {
            return false;
        }
        if let [a, b, c] = *cell {
            let [ab, bc, ca] = [a.midpoint(b), b.midpoint(c), c.midpoint(a)];
            let cells = [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]];
            return cells.iter().all(|cell| self.covers(cell, alive, splits - 1));
        }
        (0..cell.len()).all(|i| self.covers(&[middle, cell[i], cell[(i + 1) % cell.len()]], alive, splits - 1))
    }

    /// Whether a member may have a point in a cell of the far end.
    fn touches(&self, member: usize, cell: &[DVec3]) -> bool {
        let member = &self.members[member];
        let slack = CLEAR * self.shaft.far;
        let side = |sign: f64| cell.iter().all(|&corner| sign * member.normal.dot(corner - member.corners[0]) > slack);
        member.depth > self.shaft.far - slack && !side(1.0) && !side(-1.0)
    }
}
