//! A tree of boxes over a scene's occluders, for whoever walks from near to far or looks into one place.

use glam::DVec3;

use crate::Aabb;
use crate::occluders::Polygon;
use crate::shaft::Shaft;

/// Boxes over polygons. Node 0 is the root, if there is one.
#[derive(Clone, Debug, Default)]
pub(crate) struct OccluderTree {
    pub nodes: Vec<Node>,
    /// Polygons, leaf by leaf.
    order: Vec<u32>,
}

#[derive(Clone, Copy, Debug)]
pub(crate) struct Node {
    pub aabb: Aabb,
    /// The greatest width of a polygon below: what is narrower than a pixel covers none.
    pub width: f64,
    /// For a leaf its range in `order`; else the index of the second child (the first follows at once) and 0.
    first: u32,
    count: u32,
}

/// A query costs about a quarter of drawing a polygon, so a leaf holds a few.
const LEAF_MAX: usize = 4;

impl OccluderTree {
    pub fn build(polygons: &[Polygon]) -> OccluderTree {
        let mut tree = OccluderTree { nodes: Vec::new(), order: (0..polygons.len() as u32).collect() };
        if !polygons.is_empty() {
            split(polygons, &mut tree.order, 0, &mut tree.nodes);
        }
        tree
    }

    /// The polygons of a leaf; none if the node has children.
    pub fn leaf(&self, node: &Node) -> Option<&[u32]> {
        (node.count > 0).then(|| &self.order[node.first as usize..(node.first + node.count) as usize])
    }

    /// The children of the node at `index`.
    pub fn children(&self, index: u32) -> [u32; 2] {
        [index + 1, self.nodes[index as usize].first]
    }

    /// Calls `visit` for polygons of that width whose box may reach into the shaft until it returns `false`, roughly from near to far: the first
    /// few often hide all.
    pub fn in_shaft(
        &self,
        polygons: &[Polygon],
        eye: DVec3,
        shaft: &Shaft,
        width_min: f64,
        mut visit: impl FnMut(u32) -> bool,
    ) {
        let misses = |aabb: &Aabb| shaft.misses_box(&Aabb::new(aabb.min - eye, aabb.max - eye));
        let mut stack = Vec::with_capacity(32);
        if !self.nodes.is_empty() {
            stack.push(0);
        }
        while let Some(index) = stack.pop() {
            let node = &self.nodes[index as usize];
            if node.width < width_min || misses(&node.aabb) {
                continue;
            }
            let Some(leaf) = self.leaf(node) else {
                let [first, second] = self.children(index);
                let distance = |child: u32| {
                    let aabb = &self.nodes[child as usize].aabb;
                    (eye.clamp(aabb.min, aabb.max).distance_squared(eye), aabb.centre().distance_squared(eye))
                };
                stack.extend(if distance(first) <= distance(second) { [second, first] } else { [first, second] });
                continue;
            };
            for &polygon in leaf {
                let Polygon { width, aabb, .. } = &polygons[polygon as usize];
                if *width >= width_min && !misses(aabb) && !visit(polygon) {
                    return;
                }
            }
        }
    }
}

/// Splits `order` (which starts at `first` of the whole) at the median of the longest axis of the boxes' middles.
fn split(polygons: &[Polygon], order: &mut [u32], first: usize, nodes: &mut Vec<Node>) {
    let aabb_of = |polygon: u32| polygons[polygon as usize].aabb;
    let aabb = order.iter().fold(Aabb::EMPTY, |aabb, &polygon| aabb.union(&aabb_of(polygon)));
    let width = order.iter().map(|&polygon| polygons[polygon as usize].width).fold(0.0, f64::max);
    let index = nodes.len();
    nodes.push(Node { aabb, width, first: first as u32, count: order.len() as u32 });
    if order.len() <= LEAF_MAX {
        return;
    }
    let middles = order.iter().fold(Aabb::EMPTY, |aabb, &polygon| aabb.with_point(aabb_of(polygon).centre()));
    let size = middles.size();
    let axis = (0..3).fold(0, |best, axis| if size[axis] > size[best] { axis } else { best });
    let key = |polygon: u32| aabb_of(polygon).centre()[axis];
    order.sort_by(|&a, &b| key(a).total_cmp(&key(b)).then(a.cmp(&b)));
    let half = order.len() / 2;
    let (left, right) = order.split_at_mut(half);
    split(polygons, left, first, nodes);
    nodes[index] = Node { aabb, width, first: nodes.len() as u32, count: 0 };
    split(polygons, right, first + half, nodes);
}
