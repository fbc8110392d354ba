//! The bytes of prisms: corners and triangles of the plan, heights, counts, and the cells.

use super::Prisms;
use crate::Cells;
use crate::tessellation_file::{Reader, Writer};

impl Prisms {
    pub(crate) fn encode(&self, to: &mut Writer) {
        to.list(&self.sites, |to, site| to.dvec2(*site));
        to.list(&self.plan, |to, corners| corners.iter().for_each(|&site| to.u32(site)));
        to.list(&self.heights, |to, height| to.f64(*height));
        to.u64(self.storeys as u64);
        to.u64(self.sealed as u64);
        self.cells.encode(to);
    }

    pub(crate) fn decode(from: &mut Reader<'_>, primitive_total: usize) -> Option<Prisms> {
        let sites = from.list(Reader::dvec2)?;
        let plan = from.list(|from| Some([from.u32()?, from.u32()?, from.u32()?]))?;
        let heights = from.list(Reader::f64)?;
        let (storeys, sealed) = (usize::try_from(from.u64()?).ok()?, usize::try_from(from.u64()?).ok()?);
        let cells = Cells::decode(from, primitive_total)?;
        Prisms::from_parts(sites, plan, heights, cells, storeys, sealed).filter(|prisms| !prisms.cells.are_boxes())
    }
}
