//! Which faces between cells are walls? Condition (f) of DESIGN.md §4: a face that opaque triangles cover does not lead on.
//!
//! **What is sealed.** A face is the rectangle F that a cell A shares with a neighbour B; it is looked at from A's side,
//! since a segment from an eye crosses it from A to B only if the eye is on A's side. Take opaque triangles that lie
//! exactly in F's plane and are drawn for that side: two-sided ones, and single-sided ones whose front is there. Turn them
//! all the same way round and add up their directed edges; edges that run opposite between the same two corners cancel. The
//! number of triangles over a point changes only across edges that are left. So if none is left inside F, and one point of F
//! lies inside a triangle, then every point of F is covered. That is exact, however large or many the triangles
//! are, and any subset of the triangles that passes is proof enough.
//!
//! Edges of walls that meet in a T-junction do not cancel corner by corner. Along lines parallel to an axis they are added up as
//! intervals instead: where the sum is zero no *point* is uncovered, but a rasteriser that snaps corners may open a crack
//! there, so these stretches are kept as [`SealedFace::cracks`]. Any other edge left inside F means: not sealed.
//!
//! **Why nothing is lost where rays decide.** A segment from the eye through F meets one of the triangles, which is drawn
//! (unless nearer than the near plane) and in front of all beyond. Where a segment runs inside F's plane it never has to
//! cross F: its cells on one side make a chain. What *touches* F from behind is listed by A too.
//!
//! **Why nothing is lost where pixel centres decide** is harder, since snapped walls have cracks at F's border (walls that
//! meet there need not share corners), and since far along a wall depths of neighbouring samples differ by more than a wall's
//! distance from what is behind. So an image is asked ([`crate::Target::believes`]) whether it really is closed; the
//! argument is told where that is answered, in `raster_sampled/seal.rs`.

use glam::{DVec2, DVec3};

use crate::{Aabb, CellId, Cells, Face, Scene, Sides, Triangle};

/// A face between two cells that opaque triangles cover without a gap, as seen from the cell one comes from.
#[derive(Clone, Copy, Debug)]
pub struct SealedFace<'a> {
    /// The rectangle, without thickness along the face's axis.
    pub rectangle: Aabb,
    /// The face of the cell one comes from.
    pub face: Face,
    /// Stretches inside the rectangle where triangles meet without sharing corners: snapping may part them.
    pub cracks: &'a [[DVec3; 2]],
    /// Metres: what lies no deeper than this beyond the face, and no farther beside it, is listed by the cell itself.
    pub skin: f64,
}

/// A triangle that lies exactly in a plane across an axis and occludes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Wall {
    pub(crate) axis: usize,
    pub(crate) coordinate: f64,
    /// Corners along the next two axes, cyclically, anticlockwise as seen from +axis.
    corners: [DVec2; 3],
    /// For a single-sided triangle whether its front looks to +axis.
    front_is_positive: Option<bool>,
}

impl Wall {
    pub(crate) fn of(triangle: &Triangle) -> Option<Wall> {
        let [a, b, c] = triangle.corners;
        let axis = (0..3).find(|&axis| a[axis] == b[axis] && b[axis] == c[axis])?;
        if !triangle.occludes {
            return None;
        }
        let mut corners = triangle.corners.map(|corner| flat(corner.as_dvec3(), axis));
        let area = turn(corners);
        // So thin that rounding may have turned it. To leave a triangle out is always sound.
        let [ab, ac] = [corners[1] - corners[0], corners[2] - corners[0]];
        if area.abs() <= 1e-12 * ab.abs().max(ac.abs()).max_element().powi(2) {
            return None;
        }
        if area < 0.0 {
            corners.swap(1, 2);
        }
        let front_is_positive = (triangle.sides == Sides::Front).then_some(area > 0.0);
        Some(Wall { axis, coordinate: f64::from(a[axis]), corners, front_is_positive })
    }

    /// Area of the part in a box, whatever the box's extent along the wall's axis.
    pub(crate) fn area_in(&self, aabb: &Aabb) -> f64 {
        let (min, max) = (flat(aabb.min, self.axis), flat(aabb.max, self.axis));
        let [a, b, c] = self.corners;
        if min.cmple(a.min(b).min(c)).all() && a.max(b).max(c).cmple(max).all() {
            return turn(self.corners) * 0.5;
        }
        let (mut polygon, mut cut) = (Vec::with_capacity(8), Vec::with_capacity(8));
        polygon.extend(self.corners);
        for axis in 0..2 {
            clip(&polygon, &mut cut, |corner| corner[axis] - min[axis]);
            clip(&cut, &mut polygon, |corner| max[axis] - corner[axis]);
        }
        (2..polygon.len()).map(|i| turn([polygon[0], polygon[i - 1], polygon[i]])).sum::<f64>() * 0.5
    }

    /// Whether it is drawn for an eye that looks through `face` of its cell.
    fn faces(&self, face: Face) -> bool {
        self.front_is_positive.is_none_or(|positive| positive != face.is_positive())
    }

    fn touches(&self, rectangle: &Rectangle) -> bool {
        let [a, b, c] = self.corners;
        let (min, max) = (a.min(b).min(c), a.max(b).max(c));
        min.cmple(rectangle.max).all() && rectangle.min.cmple(max).all()
    }

    fn edges(&self) -> [[DVec2; 2]; 3] {
        let [a, b, c] = self.corners;
        [[a, b], [b, c], [c, a]]
    }

    /// Whether a point lies inside, beyond the doubt of rounding.
    fn surrounds(&self, point: DVec2) -> bool {
        let reach = self.corners.iter().fold(point.abs(), |reach, corner| reach.max(corner.abs())).max_element();
        self.edges().into_iter().all(|[from, to]| turn([from, to, point]) > 1e-12 * reach * reach)
    }
}

/// The two coordinates of a plane across `axis`, in cyclic order.
fn flat(point: DVec3, axis: usize) -> DVec2 {
    DVec2::new(point[(axis + 1) % 3], point[(axis + 2) % 3])
}

/// Twice the area; positive if the corners run anticlockwise.
fn turn([a, b, c]: [DVec2; 3]) -> f64 {
    (b - a).perp_dot(c - a)
}

fn clip(polygon: &[DVec2], kept: &mut Vec<DVec2>, height: impl Fn(DVec2) -> f64) {
    kept.clear();
    for (i, &here) in polygon.iter().enumerate() {
        let next = polygon[(i + 1) % polygon.len()];
        let (h, n) = (height(here), height(next));
        if h >= 0.0 {
            kept.push(here);
        }
        if (h >= 0.0) != (n >= 0.0) {
            kept.push(here.lerp(next, h / (h - n)));
        }
    }
}

#[derive(Clone, Copy, Debug)]
struct Rectangle {
    min: DVec2,
    max: DVec2,
}

/// Seals every face of `cells` that can be sealed; `walls` are the scene's, one per triangle. Returns how many were.
pub(crate) fn seal(scene: &Scene, walls: &[Option<Wall>], cells: &mut Cells) -> usize {
    debug_assert_eq!(scene.triangles().len(), walls.len());
    let mut count = 0;
    let mut near = Vec::new();
    for cell in 0..cells.len() as CellId {
        let here = *cells.aabb(cell);
        near.clear();
        near.extend(
            cells
                .primitives(cell)
                .iter()
                .filter_map(|&id| walls[id as usize])
                .filter(|wall| wall.coordinate == here.min[wall.axis] || wall.coordinate == here.max[wall.axis]),
        );
        if near.is_empty() {
            continue;
        }
        for nth in 0..cells.neighbours(cell).len() {
            let neighbour = cells.neighbours(cell)[nth];
            let shared = cells.shared(cell, &neighbour);
            // An oblique face of a cell that is no box lies in no wall across an axis.
            let axis = neighbour.face.axis();
            if shared.min[axis] != shared.max[axis] {
                continue;
            }
            if let Some(cracks) = covered(&near, &shared, neighbour.face) {
                cells.set_seal(cell, nth, &cracks);
                count += 1;
            }
        }
    }
    count
}

/// The cracks of a rectangle that walls cover, or `None` if they may not.
fn covered(walls: &[Wall], shared: &Aabb, face: Face) -> Option<Vec<[DVec3; 2]>> {
    let axis = face.axis();
    let rectangle = Rectangle { min: flat(shared.min, axis), max: flat(shared.max, axis) };
    let here = |wall: &&Wall| {
        wall.axis == axis && wall.coordinate == shared.min[axis] && wall.faces(face) && wall.touches(&rectangle)
    };
    let walls: Vec<Wall> = walls.iter().filter(here).copied().collect();
    if walls.is_empty() {
        return None;
    }
    // Things that stand against a wall have faces in its plane, whose borders would count as gaps; a subset without
    // them is as good a proof.
    let parts = components(&walls);
    let large: Vec<Wall> = parts.iter().filter(|part| !inside(part, &rectangle)).flatten().copied().collect();
    let cracks = gaps(&walls, &rectangle)
        .or_else(|| gaps(&large, &rectangle))
        .or_else(|| parts.iter().find_map(|part| gaps(part, &rectangle)))?;
    let lift = |point: DVec2| {
        let mut lifted = shared.min;
        lifted[(axis + 1) % 3] = point.x;
        lifted[(axis + 2) % 3] = point.y;
        lifted
    };
    Some(cracks.into_iter().map(|crack| crack.map(lift)).collect())
}

/// Whether all of these lie inside the open rectangle.
fn inside(walls: &[Wall], rectangle: &Rectangle) -> bool {
    let within = |corner: DVec2| rectangle.min.cmplt(corner).all() && corner.cmplt(rectangle.max).all();
    walls.iter().flat_map(|wall| wall.corners).all(within)
}

/// An edge without direction, as a key: its corners in order, by bits.
type EdgeKey = [[u64; 2]; 2];

/// The key of a directed edge, and whether it runs against it.
fn key([from, to]: [DVec2; 2]) -> (EdgeKey, bool) {
    // −0 and 0 are one place.
    let bits = |corner: DVec2| (corner + DVec2::ZERO).to_array().map(f64::to_bits);
    let (from, to) = (bits(from), bits(to));
    if from <= to { ([from, to], false) } else { ([to, from], true) }
}

/// Walls that hang together by edges with the same corners.
fn components(walls: &[Wall]) -> Vec<Vec<Wall>> {
    let mut edges: Vec<(EdgeKey, usize)> =
        (0..).zip(walls).flat_map(|(i, wall)| wall.edges().map(|edge| (key(edge).0, i))).collect();
    edges.sort_unstable();
    let mut group: Vec<usize> = (0..walls.len()).collect();
    fn root(group: &mut [usize], mut i: usize) -> usize {
        while group[i] != i {
            group[i] = group[group[i]];
            i = group[i];
        }
        i
    }
    for pair in edges.windows(2).filter(|pair| pair[0].0 == pair[1].0) {
        let [a, b] = [pair[0].1, pair[1].1].map(|i| root(&mut group, i));
        group[a.max(b)] = a.min(b);
    }
    let mut members: Vec<(usize, usize)> = (0..walls.len()).map(|i| (root(&mut group, i), i)).collect();
    members.sort_unstable();
    members.chunk_by(|a, b| a.0 == b.0).map(|part| part.iter().map(|&(_, i)| walls[i]).collect()).collect()
}

/// The cracks of a rectangle that these walls cover, or `None` if they leave a gap, or rounding leaves doubt.
fn gaps(walls: &[Wall], rectangle: &Rectangle) -> Option<Vec<[DVec2; 2]>> {
    // Points that no regular subdivision of the rectangle hits, so that one of them lies off all edges.
    let samples = [[0.5137, 0.4861], [0.2871, 0.6529], [0.7319, 0.2683], [0.4211, 0.8437], [0.6143, 0.1379]];
    let size = rectangle.max - rectangle.min;
    let inner = |at: [f64; 2]| rectangle.min + size * DVec2::from_array(at);
    if !samples.into_iter().any(|at| walls.iter().any(|wall| wall.surrounds(inner(at)))) {
        return None;
    }
    let mut edges: Vec<(EdgeKey, bool, [DVec2; 2])> = walls
        .iter()
        .flat_map(Wall::edges)
        .map(|edge| {
            let (key, against) = key(edge);
            (key, against, if against { [edge[1], edge[0]] } else { edge })
        })
        .collect();
    edges.sort_unstable_by(|a, b| a.0.cmp(&b.0).then(a.1.cmp(&b.1)));
    // Left over, as (axis that the line is parallel to, its coordinate, from, to, how often more one way than the other).
    let mut lines: Vec<(usize, f64, f64, f64, i64)> = Vec::new();
    for same in edges.chunk_by(|a, b| a.0 == b.0) {
        let sum: i64 = same.iter().map(|edge| if edge.1 { -1 } else { 1 }).sum();
        let [from, to] = same[0].2;
        if sum == 0 || outside(from, to, rectangle) {
            continue;
        }
        if let Some(axis) = (0..2).find(|&axis| from[1 - axis] == to[1 - axis]) {
            let sum = if from[axis] <= to[axis] { sum } else { -sum };
            lines.push((axis, from[1 - axis], from[axis].min(to[axis]), from[axis].max(to[axis]), sum));
        } else {
            return None;
        }
    }
    lines.sort_unstable_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)).then(a.2.total_cmp(&b.2)));
    let mut cracks = Vec::new();
    for line in lines.chunk_by(|a, b| (a.0, a.1) == (b.0, b.1)) {
        let (axis, across, ..) = line[0];
        let [begin, end] = [rectangle.min[axis], rectangle.max[axis]];
        let mut steps: Vec<(f64, i64)> =
            line.iter().flat_map(|&(_, _, from, to, sum)| [(from, sum), (to, -sum)]).collect();
        steps.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
        let mut sum = 0;
        for pair in steps.windows(2) {
            sum += pair[0].1;
            if sum != 0 && pair[0].0.max(begin) < pair[1].0.min(end) {
                return None;
            }
        }
        let place = |along: f64| if axis == 0 { DVec2::new(along, across) } else { DVec2::new(across, along) };
        for &(_, _, from, to, _) in line {
            cracks.push([place(from.max(begin)), place(to.min(end))]);
        }
    }
    Some(cracks)
}

/// Whether a segment certainly misses the open rectangle.
fn outside(from: DVec2, to: DVec2, rectangle: &Rectangle) -> bool {
    let (low, high) = (from.min(to), from.max(to));
    if high.cmple(rectangle.min).any() || low.cmpge(rectangle.max).any() {
        return true;
    }
    let reach = from.abs().max(to.abs()).max(rectangle.min.abs()).max(rectangle.max.abs()).max_element();
    let Rectangle { min, max } = *rectangle;
    let sides = [min, max, DVec2::new(min.x, max.y), DVec2::new(max.x, min.y)].map(|corner| turn([from, to, corner]));
    let doubt = 1e-12 * reach * reach;
    sides.iter().all(|&side| side > doubt) || sides.iter().all(|&side| side < -doubt)
}

#[cfg(test)]
mod tests;
