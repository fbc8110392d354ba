//! A kD-tree's bytes: of each node its first child or cell, the axis of its cut and the plane; then cells and counts.

use super::{KdStats, KdTree, LEAF, Node};
use crate::Cells;
use crate::tessellation_file::{Reader, Writer};

/// Most cuts above a cell: [`super::KdRules`] go no deeper.
const DEPTH_MAX: u32 = 60;

impl KdTree {
    /// Bytes that nodes, cells and their lists take.
    pub fn memory_bytes(&self) -> usize {
        size_of_val(&*self.nodes) + self.cells.memory_bytes()
    }

    pub(crate) fn encode(&self, to: &mut Writer) {
        to.list(&self.nodes, |to, node| {
            to.u32(node.first);
            to.u32(u32::from(node.axis));
            to.f64(node.plane);
        });
        self.cells.encode(to);
        let KdStats { wall_cuts, size_cuts, depth, sealed } = self.stats;
        [wall_cuts, size_cuts, depth as usize, sealed].into_iter().for_each(|count| to.u64(count as u64));
    }

    pub(crate) fn decode(from: &mut Reader<'_>, primitive_total: usize) -> Option<KdTree> {
        let parts = from.list(|from| Some((from.u32()?, from.u32()?, from.f64()?)))?;
        let cells = Cells::decode(from, primitive_total)?;
        let mut count = || usize::try_from(from.u64()?).ok();
        let (wall_cuts, size_cuts) = (count()?, count()?);
        let (depth, sealed) = (u32::try_from(count()?).ok()?, count()?);
        // Children come after their parent, each of one parent: that makes a tree.
        let mut nodes: Vec<Option<(Node, u32)>> = vec![None; parts.len()];
        *nodes.first_mut()? = Some((Node { aabb: cells.root(), first: 0, axis: LEAF, plane: 0.0 }, 0));
        for (index, &(first, axis, plane)) in parts.iter().enumerate() {
            let (node, above) = nodes[index].as_mut()?;
            (node.first, node.plane) = (first, plane);
            node.axis = u8::try_from(axis).ok().filter(|axis| *axis <= LEAF)?;
            let (node, above) = (*node, *above);
            if node.axis == LEAF {
                if first as usize >= cells.len() || *cells.aabb(first) != node.aabb {
                    return None;
                }
                continue;
            }
            let axis = axis as usize;
            let cuts = node.aabb.min[axis] < plane && plane < node.aabb.max[axis];
            if !cuts || above >= DEPTH_MAX || first as usize <= index || first as usize + 2 > parts.len() {
                return None;
            }
            let (mut lower, mut upper) = (node.aabb, node.aabb);
            (lower.max[axis], upper.min[axis]) = (plane, plane);
            for (child, aabb) in [lower, upper].into_iter().enumerate() {
                let node = Node { aabb, first: 0, axis: LEAF, plane: 0.0 };
                if nodes[first as usize + child].replace((node, above + 1)).is_some() {
                    return None;
                }
            }
        }
        let nodes = nodes.into_iter().map(|node| node.map(|node| node.0)).collect::<Option<_>>()?;
        Some(KdTree { nodes, cells, stats: KdStats { wall_cuts, size_cuts, depth, sealed } })
    }
}
