//! A table of potential visibility: for each cell of a world, the cells that may be seen from it. Baked ahead by
//! `eyeline-sim bake`; here are its file and its checks.
//!
//! After Funkhouser, "RING: A Client-Server System for Multi-User Virtual Environments", 1995. RING's cells and portals make
//! its sets conservative; ours are made from *sampled* eyes, since a given model has neither, and may miss.
//!
//! ```text
//! bytes  what, little-endian
//!     8  "EYE-PVS\n"
//!     4  version, 1
//!    32  SHA-256 of the model that it was baked for
//!    24  least corner relative to the anchor, 3 × f64, metres
//!     8  side of a cell, f64, metres
//!    12  cells along x, y and z, 3 × u32
//!     4  samples asked for in each column of cells, u32
//!     8  eyes that were looked from, u64
//!     4  cells that an eye was in, u32
//!     4  number of runs, u32
//!     4  of each cell: how many runs are its own
//!     8  of each run: first cell and number of cells, 2 × u32; ascending and apart within a cell
//! ```

use std::io::Read as _;
use std::path::{Path, PathBuf};

use eyeline_protocol::WorldInfo;
use glam::{DVec3, UVec3};

use super::cells::{CellGrid, CellSet};

/// For each cell, the cells that may be seen from it.
#[derive(Clone, Debug, PartialEq)]
pub struct PvsTable {
    world: [u8; 32],
    grid: CellGrid,
    facts: PvsFacts,
    /// Where each cell's runs start in `runs`, and where the last ones end.
    starts: Vec<u32>,
    /// First cell and number of cells; ascending and apart within a cell, and below the number of cells.
    runs: Vec<(u32, u32)>,
}

/// How a table was made.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PvsFacts {
    /// Samples asked for in each column of cells.
    pub samples: u32,
    /// Eyes that were looked from.
    pub eyes: u64,
    /// Cells that at least one eye was in; the others have their neighbours' sets, or everything.
    pub cells_seen_from: u32,
}

/// Why there is no table.
#[derive(Debug, thiserror::Error)]
pub enum PvsError {
    /// The file can't be read or written.
    #[error("cannot {verb} the table {}: {source}", path.display())]
    File {
        /// `read` or `write`.
        verb: &'static str,
        /// Which file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The file is not a table.
    #[error("the table {}: {source}", path.display())]
    In {
        /// Which file.
        path: PathBuf,
        /// What is wrong with it.
        source: Box<PvsError>,
    },
    /// It begins with something else.
    #[error("is not a table of potential visibility; `eyeline-sim bake` makes one")]
    NotATable,
    /// It is of another version.
    #[error("is a table of version {found}, and only {VERSION} is understood; bake it again")]
    Version {
        /// What it says.
        found: u32,
    },
    /// It is larger than any table.
    #[error("is larger than the {BYTES_MAX} bytes that a table may have")]
    TooLarge,
    /// Its length is not what its header says.
    #[error("has {found} bytes where its header speaks of {needed}; it is damaged, bake it again")]
    Length {
        /// Bytes there are.
        found: u64,
        /// Bytes there should be.
        needed: u64,
    },
    /// Its runs contradict themselves.
    #[error("contradicts itself at cell {cell}; it is damaged, bake it again")]
    Damaged {
        /// The cell whose runs make no sense.
        cell: u32,
    },
    /// The side of a cell is no length.
    #[error("cells of {cell} m; give a length from 0.01 to 1e7 m")]
    Cell {
        /// What was given, metres.
        cell: f64,
    },
    /// More cells than a table may have.
    #[error("{cells} cells of {cell} m, and there may be 1 to {}; choose another --cell", CellGrid::CELLS_MAX)]
    TooManyCells {
        /// How many.
        cells: f64,
        /// Their side, metres.
        cell: f64,
    },
    /// More runs than a table may have.
    #[error("the table would be larger than {BYTES_MAX} bytes; choose a larger --cell")]
    TooManyRuns,
    /// It is of another world.
    #[error(
        "the table was baked for the model with SHA-256 {}…, and '{name}' has {}…; bake one for it with `eyeline-sim bake`",
        hex(table),
        hex(world)
    )]
    OtherWorld {
        /// The table's model.
        table: [u8; 32],
        /// The model that is served.
        world: [u8; 32],
        /// Its name.
        name: String,
    },
}

/// The first bytes of a hash, for people.
fn hex(hash: &[u8; 32]) -> String {
    hash.iter().take(4).map(|byte| format!("{byte:02x}")).collect()
}

const MAGIC: [u8; 8] = *b"EYE-PVS\n";
const VERSION: u32 = 1;
const HEADER_BYTES: usize = 108;
const RUN_BYTES: u64 = 8;

/// Largest file of a table: what a server takes up without a second thought.
const BYTES_MAX: u64 = 256 << 20;

impl PvsTable {
    /// A table of `world` (the model's SHA-256). `row` says which cells may be seen from a cell; all if it says `None`. It is
    /// asked for one cell after the other, so that not all sets need be in memory at once.
    ///
    /// # Errors
    /// If it would be too large.
    pub fn new(
        world: [u8; 32],
        grid: CellGrid,
        facts: PvsFacts,
        mut row: impl FnMut(u32) -> Option<CellSet>,
    ) -> Result<PvsTable, PvsError> {
        let (mut starts, mut runs) = (vec![0], Vec::new());
        for cell in 0..grid.cells() {
            match row(cell) {
                Some(row) => runs.extend(row.runs()),
                None => runs.push((0, grid.cells())),
            }
            // Now, and not once memory is full.
            if runs.len() as u64 * RUN_BYTES > BYTES_MAX {
                return Err(PvsError::TooManyRuns);
            }
            starts.push(runs.len() as u32);
        }
        let table = PvsTable { world, grid, facts, starts, runs };
        if table.bytes() > BYTES_MAX { Err(PvsError::TooManyRuns) } else { Ok(table) }
    }

    /// The cells.
    pub fn grid(&self) -> &CellGrid {
        &self.grid
    }

    /// How it was made.
    pub fn facts(&self) -> PvsFacts {
        self.facts
    }

    /// The cells that may be seen from a cell of the grid, as runs: first and number, ascending and apart.
    pub fn row(&self, cell: u32) -> &[(u32, u32)] {
        let cell = cell as usize;
        &self.runs[self.starts[cell] as usize..self.starts[cell + 1] as usize]
    }

    /// Whether something in cell `to` may be seen from cell `from`.
    pub fn sees(&self, from: u32, to: u32) -> bool {
        let row = self.row(from);
        let after = row.partition_point(|&(first, _)| first <= to);
        after > 0 && to - row[after - 1].0 < row[after - 1].1
    }

    /// Mean share of all cells that a cell sees, 0 to 1, of those that do not see everything.
    pub fn share_seen(&self) -> f64 {
        let cells = self.grid.cells();
        let seen = (0..cells).map(|cell| self.row(cell).iter().map(|run| run.1).sum::<u32>());
        let known: Vec<u32> = seen.filter(|&seen| seen < cells).collect();
        known.iter().map(|&seen| f64::from(seen)).sum::<f64>() / known.len().max(1) as f64 / f64::from(cells)
    }

    /// Whether it was baked for this world.
    ///
    /// # Errors
    /// Names both if not: in another world it would hide what is in sight.
    pub fn check_world(&self, info: &WorldInfo) -> Result<(), PvsError> {
        if self.world == info.hash {
            return Ok(());
        }
        Err(PvsError::OtherWorld { table: self.world, world: info.hash, name: info.name.clone() })
    }

    fn bytes(&self) -> u64 {
        HEADER_BYTES as u64 + u64::from(self.grid.cells()) * 4 + self.runs.len() as u64 * RUN_BYTES
    }

    /// The file's bytes.
    pub fn encode(&self) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(self.bytes() as usize);
        bytes.extend(MAGIC);
        bytes.extend(VERSION.to_le_bytes());
        bytes.extend(self.world);
        for metres in self.grid.origin().to_array().into_iter().chain([self.grid.cell()]) {
            bytes.extend(metres.to_le_bytes());
        }
        let UVec3 { x, y, z } = self.grid.size();
        for number in [x, y, z, self.facts.samples] {
            bytes.extend(number.to_le_bytes());
        }
        bytes.extend(self.facts.eyes.to_le_bytes());
        bytes.extend(self.facts.cells_seen_from.to_le_bytes());
        bytes.extend((self.runs.len() as u32).to_le_bytes());
        debug_assert_eq!(bytes.len(), HEADER_BYTES);
        for pair in self.starts.windows(2) {
            bytes.extend((pair[1] - pair[0]).to_le_bytes());
        }
        for &(first, count) in &self.runs {
            bytes.extend(first.to_le_bytes());
            bytes.extend(count.to_le_bytes());
        }
        bytes
    }

    /// A table from a file's bytes, which may be anything. Takes memory in proportion to them.
    ///
    /// # Errors
    /// Says what is wrong.
    pub fn decode(bytes: &[u8]) -> Result<PvsTable, PvsError> {
        if !bytes.starts_with(&MAGIC) {
            return Err(PvsError::NotATable);
        }
        if bytes.len() as u64 > BYTES_MAX {
            return Err(PvsError::TooLarge);
        }
        let mut reader = Reader { bytes, at: MAGIC.len() };
        // Before its length: another version may be shorter.
        let found = reader.u32()?;
        if found != VERSION {
            return Err(PvsError::Version { found });
        }
        let world = reader.take()?;
        let origin = DVec3::new(reader.f64()?, reader.f64()?, reader.f64()?);
        let cell = reader.f64()?;
        let size = UVec3::new(reader.u32()?, reader.u32()?, reader.u32()?);
        let grid = CellGrid::from_parts(origin, cell, size.as_dvec3())?;
        let samples = reader.u32()?;
        let eyes = u64::from_le_bytes(reader.take()?);
        let facts = PvsFacts { samples, eyes, cells_seen_from: reader.u32()? };
        let run_count = reader.u32()?;
        let needed = HEADER_BYTES as u64 + u64::from(grid.cells()) * 4 + u64::from(run_count) * RUN_BYTES;
        if bytes.len() as u64 != needed {
            return Err(PvsError::Length { found: bytes.len() as u64, needed });
        }
        let mut starts = Vec::with_capacity(grid.cells() as usize + 1);
        starts.push(0u32);
        for cell in 0..grid.cells() {
            let end = starts[cell as usize].checked_add(reader.u32()?).filter(|&end| end <= run_count);
            starts.push(end.ok_or(PvsError::Damaged { cell })?);
        }
        if starts.last() != Some(&run_count) {
            return Err(PvsError::Damaged { cell: grid.cells() - 1 });
        }
        let mut runs = Vec::with_capacity(run_count as usize);
        for cell in 0..grid.cells() {
            let mut free = 0;
            for _ in starts[cell as usize]..starts[cell as usize + 1] {
                let (first, count) = (reader.u32()?, reader.u32()?);
                let end = first.checked_add(count).filter(|&end| end <= grid.cells());
                let end = end.filter(|_| first >= free && count > 0);
                free = end.ok_or(PvsError::Damaged { cell })?;
                runs.push((first, count));
            }
        }
        Ok(PvsTable { world, grid, facts, starts, runs })
    }

    /// Reads a file.
    ///
    /// # Errors
    /// Names the file and what is wrong with it.
    pub fn read(path: &Path) -> Result<PvsTable, PvsError> {
        let mut bytes = Vec::new();
        // One byte more than there may be, and no more, whatever is behind the name.
        std::fs::File::open(path)
            .and_then(|file| file.take(BYTES_MAX + 1).read_to_end(&mut bytes))
            .map_err(|source| PvsError::File { verb: "read", path: path.into(), source })?;
        PvsTable::decode(&bytes).map_err(|source| PvsError::In { path: path.into(), source: Box::new(source) })
    }

    /// Writes a file that [`PvsTable::read`] reads; makes its folder.
    ///
    /// # Errors
    /// Names the file.
    pub fn write(&self, path: &Path) -> Result<(), PvsError> {
        let file = |source| PvsError::File { verb: "write", path: path.into(), source };
        if let Some(folder) = path.parent().filter(|folder| !folder.as_os_str().is_empty()) {
            std::fs::create_dir_all(folder).map_err(file)?;
        }
        std::fs::write(path, self.encode()).map_err(file)
    }
}

/// Reads numbers one after the other.
struct Reader<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl Reader<'_> {
    fn take<const N: usize>(&mut self) -> Result<[u8; N], PvsError> {
        let found = self.bytes.get(self.at..self.at + N).and_then(|bytes| bytes.try_into().ok());
        self.at += N;
        found.ok_or(PvsError::Length { found: self.bytes.len() as u64, needed: HEADER_BYTES.max(self.at) as u64 })
    }

    fn u32(&mut self) -> Result<u32, PvsError> {
        self.take().map(u32::from_le_bytes)
    }

    fn f64(&mut self) -> Result<f64, PvsError> {
        self.take().map(f64::from_le_bytes)
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// Cells of 2 m over 8 × 4 × 6 m, in two storeys; each sees what `sees` says, and everything if that is empty.
    pub fn table(sees: impl Fn(u32) -> Vec<u32>) -> PvsTable {
        let grid = CellGrid::covering(DVec3::ZERO, DVec3::new(7.9, 3.9, 5.9), DVec3::ZERO, 2.0).unwrap();
        let row = |cell| {
            let mut row = CellSet::new(grid.cells());
            sees(cell).into_iter().for_each(|to| row.insert(to));
            (!row.is_empty()).then_some(row)
        };
        let facts = PvsFacts { samples: 16, eyes: 100, cells_seen_from: 20 };
        PvsTable::new([7; 32], grid, facts, row).unwrap()
    }

    #[test]
    fn a_table_reads_back_and_sees_what_it_was_made_of() {
        let sees = |cell: u32| if cell == 5 { Vec::new() } else { vec![cell, (cell + 7) % 24, 23] };
        let table = table(sees);
        let again = PvsTable::decode(&table.encode()).unwrap();
        assert_eq!(again, table);
        for from in 0..24 {
            for to in 0..24 {
                assert_eq!(again.sees(from, to), from == 5 || sees(from).contains(&to), "{from} {to}");
            }
        }
    }

    #[test]
    fn every_truncation_and_extra_bytes_are_refused() {
        let bytes = table(|cell| vec![cell, 23 - cell]).encode();
        for length in 0..bytes.len() {
            assert!(PvsTable::decode(&bytes[..length]).is_err(), "{length}");
        }
        let longer = [bytes.as_slice(), &[0]].concat();
        assert!(matches!(PvsTable::decode(&longer), Err(PvsError::Length { .. })));
    }

    #[test]
    fn damaged_fields_are_refused_by_name() {
        let bytes = table(|cell| vec![cell, 23 - cell]).encode();
        let with = |at: usize, new: &[u8]| {
            let mut bytes = bytes.clone();
            bytes[at..at + new.len()].copy_from_slice(new);
            PvsTable::decode(&bytes).err().map(|error| error.to_string()).unwrap_or_default()
        };
        let large = u32::MAX.to_le_bytes();
        let runs = HEADER_BYTES + 24 * 4;
        for (at, new, part) in [
            (0, &b"x"[..], "is not a table"),
            (8, &2u32.to_le_bytes(), "version 2"),
            (44, &f64::NAN.to_le_bytes(), "cells of 2 m"),
            (68, &f64::INFINITY.to_le_bytes(), "cells of inf m"),
            (68, &0f64.to_le_bytes(), "cells of 0 m"),
            (76, &large, "there may be"),
            (76, &0u32.to_le_bytes(), "there may be"),
            (104, &large, "its header speaks of"),
            (HEADER_BYTES, &large, "contradicts itself at cell 0"),
            (HEADER_BYTES + 4, &0u32.to_le_bytes(), "contradicts itself"),
            (runs, &24u32.to_le_bytes(), "contradicts itself at cell 0"),
            (runs + 4, &0u32.to_le_bytes(), "contradicts itself at cell 0"),
            (runs + 4, &large, "contradicts itself at cell 0"),
        ] {
            let error = with(at, new);
            assert!(error.contains(part), "{at}: '{error}' should say '{part}'");
        }
    }

    #[test]
    fn noise_is_refused_or_read_but_never_panics() {
        use rand::{RngExt, SeedableRng};
        let mut chance = rand_pcg::Pcg64::seed_from_u64(9);
        let bytes = table(|cell| vec![cell, 23 - cell]).encode();
        for _ in 0..3_000 {
            let mut bytes = bytes.clone();
            for _ in 0..chance.random_range(1..4) {
                let at = chance.random_range(0..bytes.len());
                bytes[at] = chance.random();
            }
            if let Ok(table) = PvsTable::decode(&bytes) {
                assert!((0..table.grid().cells()).all(|cell| table.row(cell).len() <= 24));
            }
        }
    }

    #[test]
    fn a_table_of_another_world_is_refused_by_name() {
        let table = table(|cell| vec![cell]);
        let info = |byte| WorldInfo { name: "hall.glb".into(), hash: [byte; 32], size_bytes: 0, two_sided: false };
        assert!(table.check_world(&info(7)).is_ok());
        let error = table.check_world(&info(8)).unwrap_err().to_string();
        assert!(["hall.glb", "07070707", "08080808"].iter().all(|part| error.contains(part)), "{error}");
    }

    #[test]
    fn files_are_named_in_errors() {
        let error = PvsTable::read(Path::new("no/such.pvs")).unwrap_err().to_string();
        assert!(error.contains("no/such.pvs"), "{error}");
        let path = std::env::temp_dir().join(format!("eyeline-{}.pvs", std::process::id()));
        std::fs::write(&path, "hello").unwrap();
        let error = PvsTable::read(&path).unwrap_err().to_string();
        assert!(error.contains("is not a table") && error.contains(".pvs"), "{error}");
        let table = table(|cell| vec![cell]);
        table.write(&path).unwrap();
        assert_eq!(PvsTable::read(&path).unwrap(), table);
        std::fs::remove_file(&path).unwrap();
    }
}
