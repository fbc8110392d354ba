//! The bytes of tetrahedra: root, sites, of each cell its corners, neighbours and planes, lists of triangles, hull.

use super::{Delaunay, NONE, Tetrahedron};
use crate::tessellation_file::{Reader, Writer};

impl Delaunay {
    pub(crate) fn encode(&self, to: &mut Writer) {
        to.aabb(&self.root);
        to.list(&self.sites, |to, site| to.dvec3(*site));
        to.list(&self.cells, |to, cell| {
            cell.corners.iter().chain(&cell.neighbours).for_each(|&number| to.u32(number));
            cell.normals.iter().for_each(|&normal| to.dvec3(normal));
            cell.heights.iter().for_each(|&height| to.f64(height));
        });
        to.list(&self.primitives, |to, &id| to.u32(id));
        to.list(&self.starts, |to, &start| to.u32(start));
        to.list(&self.hull, |to, &cell| to.u32(cell));
    }

    pub(crate) fn decode(from: &mut Reader<'_>, primitive_total: usize) -> Option<Delaunay> {
        let root = from.aabb()?;
        let sites = from.list(Reader::dvec3)?;
        let cells = from.list(|from| {
            let mut numbers = [0; 8];
            for number in &mut numbers {
                *number = from.u32()?;
            }
            let [a, b, c, d, n @ ..] = numbers;
            let normals = [from.dvec3()?, from.dvec3()?, from.dvec3()?, from.dvec3()?];
            let heights = [from.f64()?, from.f64()?, from.f64()?, from.f64()?];
            Some(Tetrahedron { corners: [a, b, c, d], neighbours: n, normals, heights })
        })?;
        let primitives = from.list(Reader::u32)?;
        let starts = from.starts(cells.len(), primitives.len())?;
        let hull = from.list(Reader::u32)?;
        let is_cell = |&cell: &u32| (cell as usize) < cells.len();
        let sound = !cells.is_empty()
            && cells.iter().all(|cell| {
                cell.corners.iter().all(|&site| (site as usize) < sites.len())
                    && cell.neighbours.iter().all(|cell| *cell == NONE || is_cell(cell))
                    && cell.heights.iter().all(|height| height.is_finite())
            })
            && primitives.iter().all(|&id| (id as usize) < primitive_total)
            && hull.iter().all(is_cell);
        sound.then_some(Delaunay { root, sites, cells, starts, primitives, primitive_total, hull })
    }
}
