//! The bytes of cells: root, skin, boxes, triangles, neighbours with what is shared and the seals between, hull.

use super::{Cells, Face, Neighbour};
use crate::tessellation_file::{Reader, Writer};

impl Cells {
    pub(crate) fn encode(&self, to: &mut Writer) {
        to.aabb(&self.root);
        to.f64(self.skin);
        to.list(&self.boxes, |to, aabb| to.aabb(aabb));
        to.list(&self.primitives, |to, &id| to.u32(id));
        to.list(&self.primitive_starts, |to, &start| to.u32(start));
        to.list(&self.neighbours, |to, neighbour| {
            to.u32(neighbour.cell);
            to.u32(u32::from(neighbour.face.0));
            to.u32(neighbour.seal);
        });
        to.list(&self.neighbour_starts, |to, &start| to.u32(start));
        to.u32(u32::from(self.shared.is_some()));
        if let Some(shared) = &self.shared {
            to.list(shared, |to, aabb| to.aabb(aabb));
        }
        to.list(&self.cracks, |to, crack| crack.iter().for_each(|&end| to.dvec3(end)));
        to.list(&self.crack_starts, |to, &start| to.u32(start));
        to.list(&self.hull, |to, &cell| to.u32(cell));
        to.list(&self.hull_starts, |to, &start| to.u32(start));
    }

    pub(crate) fn decode(from: &mut Reader<'_>, primitive_total: usize) -> Option<Cells> {
        let root = from.aabb()?;
        let skin = from.f64().filter(|skin| skin.is_finite() && *skin >= 0.0)?;
        let boxes = from.list(Reader::aabb)?;
        let primitives = from.list(Reader::u32)?;
        let primitive_starts = from.starts(boxes.len(), primitives.len())?;
        let neighbours = from.list(|from| {
            let (cell, face, seal) = (from.u32()?, u8::try_from(from.u32()?).ok()?, from.u32()?);
            Some(Neighbour { cell, face: Face(face), seal })
        })?;
        let neighbour_starts = from.starts(boxes.len(), neighbours.len())?;
        let shared = match from.u32()? {
            0 => None,
            _ => Some(from.list(Reader::aabb)?),
        };
        let cracks = from.list(|from| Some([from.dvec3()?, from.dvec3()?]))?;
        let crack_starts = from.list(Reader::u32)?;
        let hull = from.list(Reader::u32)?;
        let hull_starts: [u32; 7] = from.starts(6, hull.len())?.try_into().ok()?;
        let is_cell = |cell: u32| (cell as usize) < boxes.len();
        let sound = !boxes.is_empty()
            && primitives.iter().all(|&id| (id as usize) < primitive_total)
            && neighbours.iter().all(|neighbour| {
                let sealed = !neighbour.is_sealed() || (neighbour.seal as usize) + 1 < crack_starts.len();
                is_cell(neighbour.cell) && neighbour.face.0 < 6 && sealed
            })
            && shared.as_ref().is_none_or(|shared| shared.len() == neighbours.len())
            && crack_starts.is_sorted()
            && crack_starts.first() == Some(&0)
            && crack_starts.last().is_some_and(|&end| end as usize == cracks.len())
            && hull.iter().all(|&cell| is_cell(cell));
        let primitives_max = primitive_starts.windows(2).map(|pair| (pair[1] - pair[0]) as usize).max().unwrap_or(0);
        sound.then_some(Cells {
            root,
            boxes,
            skin,
            primitive_starts,
            primitives,
            neighbour_starts,
            neighbours,
            shared,
            crack_starts,
            cracks,
            hull_starts,
            hull,
            primitives_max,
            primitive_total,
        })
    }
}
