//! An octree's bytes: of each node its first child or cell and the halved axes; then the cells.

use super::{LATTICE_STEPS, Lattice, Node, Octree};
use crate::Cells;
use crate::tessellation_file::{Reader, Writer};

/// Most splits above a cell: [`super::OctreeRules`] go no deeper.
const DEPTH_MAX: u32 = 20;

impl Octree {
    /// Bytes that nodes, cells and their lists take.
    pub fn memory_bytes(&self) -> usize {
        size_of_val(&*self.nodes) + self.cells.memory_bytes()
    }

    pub(crate) fn encode(&self, to: &mut Writer) {
        to.list(&self.nodes, |to, node| {
            to.u32(node.first);
            to.u32(u32::from(node.axes));
        });
        self.cells.encode(to);
    }

    pub(crate) fn decode(from: &mut Reader<'_>, primitive_total: usize) -> Option<Octree> {
        let parts = from.list(|from| Some((from.u32()?, u8::try_from(from.u32()?).ok().filter(|axes| *axes < 8)?)))?;
        let cells = Cells::decode(from, primitive_total)?;
        let whole = Lattice { min: [0; 3], max: [LATTICE_STEPS; 3] };
        // Children come after their parent, each of one parent: that makes a tree.
        let mut nodes: Vec<Option<(Node, u32)>> = vec![None; parts.len()];
        *nodes.first_mut()? = Some((Node { lattice: whole, first: 0, axes: 0 }, 0));
        for (index, &(first, axes)) in parts.iter().enumerate() {
            let (node, depth) = nodes[index].as_mut()?;
            (node.first, node.axes) = (first, axes);
            let (lattice, depth) = (node.lattice, *depth);
            if axes == 0 {
                if first as usize >= cells.len() || *cells.aabb(first) != lattice.aabb(&cells.root()) {
                    return None;
                }
                continue;
            }
            let children = 1 << axes.count_ones();
            if depth >= DEPTH_MAX || first as usize <= index || first as usize + children > parts.len() {
                return None;
            }
            for child in 0..children {
                let lattice = lattice.child(axes, child as u32);
                let node = &mut nodes[first as usize + child];
                if node.replace((Node { lattice, first: 0, axes: 0 }, depth + 1)).is_some() {
                    return None;
                }
            }
        }
        Some(Octree { nodes: nodes.into_iter().map(|node| node.map(|node| node.0)).collect::<Option<_>>()?, cells })
    }
}
