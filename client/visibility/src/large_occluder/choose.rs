//! Which polygons are worth testing from a place, looking one way? (Coorg & Teller 1997, §3.1.)
//!
//! The area-angle −A·(N·V)/|D|², with V the direction towards the polygon's centre: what it subtends there, more or less. Only
//! polygons with a part in the sector of the viewing direction count. The paper's V could also be read as the viewing direction
//! itself; that would give the walls along a corridor, which hide all rooms beside it, no worth at all.
//!
//! Chosen once per cell of the kD-tree and direction. The tree is walked from the root, and each node hands down only what
//! may be large from it, so the work grows with cells and not with cells × polygons.

use std::f64::consts::TAU;

use glam::DVec3;

use super::polygons::{Polygon, Polygons};
use super::relation::heights;
use crate::kd_tree::{KdNode, KdTree};
use crate::{Aabb, Tessellation, View};

/// Horizontal viewing directions that occluders are chosen for. The paper has 8 too.
pub(crate) const DIRECTIONS: usize = 8;

/// Cosine of the half angle of a sector: 22.5° to the next direction's, and half of a view of 90°.
const SECTOR: f64 = 0.383;

/// A node hands down no fewer polygons than this many per occluder that a cell keeps.
const HANDED_DOWN: usize = 16;

/// The chosen polygons of each cell and direction, best first.
#[derive(Clone, Debug)]
pub(crate) struct Choice {
    /// `polygons[starts[k]..starts[k + 1]]`, k = cell · 8 + direction.
    starts: Vec<u32>,
    polygons: Vec<u32>,
}

impl Choice {
    pub fn build(tree: &KdTree, boxes: &[Aabb], polygons: &Polygons, most: usize) -> Choice {
        let mut lists = vec![Vec::new(); tree.cell_count() * DIRECTIONS];
        let all: Vec<u32> = (0..polygons.len() as u32).collect();
        let mut open = vec![(0, all)];
        while let Some((node, mut candidates)) = open.pop() {
            match tree.node(node) {
                KdNode::Leaf(cell) => {
                    let directions = std::array::from_fn(|direction| direction);
                    let chosen: [Vec<u32>; DIRECTIONS] =
                        choose(tree.cell(cell), polygons, candidates.iter().copied(), most, directions);
                    lists[cell as usize * DIRECTIONS..][..DIRECTIONS].clone_from_slice(&chosen);
                }
                KdNode::Inner(children) => {
                    let aabb = &boxes[node as usize];
                    let kept = (candidates.len() * 3 / 4).max(HANDED_DOWN * most);
                    if kept < candidates.len() && !aabb.is_empty() {
                        let worth = |polygon: u32| {
                            let polygon = polygons.get(polygon);
                            let half = aabb.size() * 0.5;
                            let apart = (polygon.centre - aabb.centre()).abs() - half;
                            polygon.area / apart.max(DVec3::ZERO).length_squared().max(1e-6 * polygon.area)
                        };
                        let mut order: Vec<(f64, u32)> = candidates.iter().map(|&p| (worth(p), p)).collect();
                        order.select_nth_unstable_by(kept, |a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
                        candidates = order[..kept].iter().map(|&(_, polygon)| polygon).collect();
                    }
                    open.push((children[1], candidates.clone()));
                    open.push((children[0], candidates));
                }
            }
        }
        let mut choice = Choice { starts: vec![0], polygons: Vec::new() };
        for list in lists {
            choice.polygons.extend(list);
            choice.starts.push(choice.polygons.len() as u32);
        }
        choice
    }

    /// The polygons for a place, looking along a direction.
    pub fn of(&self, cell: u32, direction: usize) -> &[u32] {
        let at = cell as usize * DIRECTIONS + direction;
        &self.polygons[self.starts[at] as usize..self.starts[at + 1] as usize]
    }
}

/// The viewing direction that is nearest to a vector; 0 is +X, and they turn towards +Z.
pub(crate) fn direction_of(along: DVec3) -> usize {
    let turns = along.z.atan2(along.x) / TAU;
    ((turns * DIRECTIONS as f64).round() as isize).rem_euclid(DIRECTIONS as isize) as usize
}

/// The directions that a view covers, best first.
pub(crate) fn directions_of(view: &View) -> impl Iterator<Item = usize> {
    let middle = direction_of(view.axes()[2]);
    // Sectors are made for 90°.
    let reach = ((view.fov_x - std::f64::consts::FRAC_PI_2).max(0.0) / 2.0 / (TAU / DIRECTIONS as f64)).ceil() as usize;
    (0..=reach).flat_map(move |step| {
        let turned = |by: usize| (middle + by) % DIRECTIONS;
        let other = (step > 0).then(|| turned(DIRECTIONS - step));
        std::iter::once(turned(step)).chain(other)
    })
}

/// A polygon of a cell is rated as if it were at least this share of the cell's size away: the eye will be elsewhere in the
/// cell. For the same reason, what is seen edge-on from the cell's middle is rated as if it were turned by [`TURNED`].
const AWAY: f64 = 0.25;
const TURNED: f64 = 0.05;

/// What a polygon is worth to eyes in a box, by the paper's metric at its middle; 0 if none is in front of it.
fn worth(polygon: &Polygon, eyes: &Aabb) -> f64 {
    let to_centre = polygon.centre - eyes.centre();
    let distance = to_centre.length().max(AWAY * eyes.size().length());
    let [low, high] = heights(eyes, polygon.normal);
    let seen = high > polygon.heights[1] || (polygon.two_sided && low < polygon.heights[0]);
    let facing = -polygon.normal.dot(to_centre) / distance;
    let facing = if polygon.two_sided { facing.abs() } else { facing };
    if seen && distance > 0.0 { polygon.area * facing.max(TURNED) / (distance * distance) } else { 0.0 }
}

/// Whether some part of a polygon is in the sector of a direction.
fn in_sector(polygons: &Polygons, index: u32, eye: DVec3, direction: usize) -> bool {
    let (z, x) = (direction as f64 * TAU / DIRECTIONS as f64).sin_cos();
    let along = DVec3::new(x, 0.0, z);
    let within = |point: &DVec3| along.dot(*point - eye) >= SECTOR * point.distance(eye);
    polygons.corners(index).iter().chain([&polygons.get(index).centre]).any(within)
}

/// The best of the candidates for each of some directions.
fn choose<const N: usize>(
    eyes: &Aabb,
    polygons: &Polygons,
    candidates: impl Iterator<Item = u32>,
    most: usize,
    directions: [usize; N],
) -> [Vec<u32>; N] {
    let mut rated = [const { Vec::new() }; N];
    for index in candidates {
        let worth = worth(polygons.get(index), eyes);
        if worth > 0.0 {
            for (direction, rated) in directions.into_iter().zip(&mut rated) {
                if in_sector(polygons, index, eyes.centre(), direction) {
                    rated.push((worth, index));
                }
            }
        }
    }
    rated.map(|mut rated| {
        rated.sort_unstable_by(|a: &(f64, u32), b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        rated.iter().take(most).map(|&(_, polygon)| polygon).collect()
    })
}

/// The best polygons for an eye outside the scene, where there are no cells to choose for.
pub(crate) fn from_outside(eye: DVec3, polygons: &Polygons, most: usize, direction: usize) -> Vec<u32> {
    let [list] = choose(&Aabb::new(eye, eye), polygons, 0..polygons.len() as u32, most, [direction]);
    list
}
