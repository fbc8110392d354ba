//! Tessellations kept in files: what takes seconds to make of a large scene takes a moment to read.
//!
//! ```text
//! bytes  what, little-endian
//!     8  "EYE-TES\n"
//!     4  version, 1
//!     4  what it is: 1 octree, 2 kD-tree, 3 Delaunay, 4 prisms
//!    16  hash of the scene that it was made for: anchor, and every triangle to the bit
//!     8  number of bytes that follow, without the last four
//!        the tessellation: see `encode` of each
//!     4  CRC-32 of all before
//! ```
//! A file is read whole or refused. The hash tells scenes apart; like the CRC it is no protection against malice, but bytes
//! that were made up are refused too where a traversal would fail on them.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use glam::{DVec2, DVec3};

use crate::{
    Aabb, Delaunay, DelaunayError, DelaunayRules, KdRules, KdTree, Octree, OctreeRules, PlpCells, Prisms, PrismsError,
    Scene, Sides, Tessellation,
};

/// A tessellation of any kind. Cheap to clone.
#[derive(Clone, Debug)]
pub enum AnyTessellation {
    /// Leaves of an octree.
    Octree(Arc<Octree>),
    /// Leaves of a kD-tree, with seals.
    KdTree(Arc<KdTree>),
    /// Tetrahedra.
    Delaunay(Arc<Delaunay>),
    /// The plan of a scene with storeys, between floors and ceilings.
    Prisms(Arc<Prisms>),
}

/// Why a tessellation cannot be made.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum TessellationError {
    /// No kind has this name.
    #[error("there is no tessellation `{0}`; known: {known}", known = AnyTessellation::NAMES.join(", "))]
    Unknown(String),
    /// See there.
    #[error(transparent)]
    Delaunay(#[from] DelaunayError),
    /// See there.
    #[error(transparent)]
    Prisms(#[from] PrismsError),
}

/// Why a file holds no tessellation of a scene.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TessellationFileError {
    /// The file can't be read or written.
    #[error("cannot {verb} the tessellation {}: {source}", path.display())]
    File {
        /// `read` or `write`.
        verb: &'static str,
        /// Which file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// What it says is of no use here.
    #[error("the tessellation {} {fault}", path.display())]
    In {
        /// Which file.
        path: PathBuf,
        /// What is wrong with it.
        fault: TessellationFault,
    },
}

/// What is wrong with the bytes of a tessellation.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum TessellationFault {
    /// It begins with something else.
    #[error("is something else; `eyeline-sim tessellate` makes one")]
    NotATessellation,
    /// It is of another version.
    #[error("is of version {found}, and only {VERSION} is understood; make it again with `eyeline-sim tessellate`")]
    Version {
        /// What it says.
        found: u32,
    },
    /// Its length is not what its header says.
    #[error(
        "has {found} bytes where its header speaks of {needed}; it was cut short or added to, make it again with `eyeline-sim tessellate`"
    )]
    Length {
        /// Bytes there are.
        found: u64,
        /// Bytes there should be.
        needed: u64,
    },
    /// Its check sum is another.
    #[error("is damaged: its check sum does not fit; make it again with `eyeline-sim tessellate`")]
    CheckSum,
    /// It was made for another scene.
    #[error(
        "was made for another scene, {made_for:032x} and not {scene:032x}; make one for this scene with `eyeline-sim tessellate`"
    )]
    OtherScene {
        /// Hash of the scene that it was made for.
        made_for: u128,
        /// Hash of the scene that it was read for.
        scene: u128,
    },
    /// Its parts contradict each other.
    #[error("contradicts itself; make it again with `eyeline-sim tessellate`")]
    Contradiction,
}

const MAGIC: [u8; 8] = *b"EYE-TES\n";
const VERSION: u32 = 1;
const HEADER_BYTES: usize = 40;
const CHECK_SUM_BYTES: usize = 4;

impl AnyTessellation {
    /// Names of the kinds, for [`AnyTessellation::build`].
    pub const NAMES: [&str; 4] = ["octree", "kd-tree", "delaunay", "prisms"];

    /// Makes a tessellation of the kind of that name, by default rules.
    ///
    /// # Errors
    /// If there is no such kind, or it cannot be made of this scene.
    pub fn build(name: &str, scene: &Scene) -> Result<AnyTessellation, TessellationError> {
        Ok(match name {
            "octree" => AnyTessellation::Octree(Arc::new(Octree::build(scene, OctreeRules::default()))),
            "kd-tree" => AnyTessellation::KdTree(Arc::new(KdTree::build(scene, KdRules::default()))),
            "delaunay" => AnyTessellation::Delaunay(Arc::new(Delaunay::build(scene, DelaunayRules::default())?)),
            "prisms" => AnyTessellation::Prisms(Arc::new(Prisms::build(scene)?)),
            _ => return Err(TessellationError::Unknown(name.to_owned())),
        })
    }

    /// Name of the kind.
    pub const fn name(&self) -> &'static str {
        AnyTessellation::NAMES[self.kind() as usize - 1]
    }

    const fn kind(&self) -> u32 {
        match self {
            AnyTessellation::Octree(_) => 1,
            AnyTessellation::KdTree(_) => 2,
            AnyTessellation::Delaunay(_) => 3,
            AnyTessellation::Prisms(_) => 4,
        }
    }

    /// For cPLP and other walks; `None` for tetrahedra, which only PLP walks.
    pub fn tessellation(&self) -> Option<Arc<dyn Tessellation>> {
        match self {
            AnyTessellation::Octree(cells) => Some(cells.clone()),
            AnyTessellation::KdTree(cells) => Some(cells.clone()),
            AnyTessellation::Delaunay(_) => None,
            AnyTessellation::Prisms(cells) => Some(cells.clone()),
        }
    }

    /// For PLP.
    pub fn plp_cells(&self) -> PlpCells {
        match self {
            AnyTessellation::Octree(cells) => PlpCells::Boxes(cells.clone()),
            AnyTessellation::KdTree(cells) => PlpCells::Boxes(cells.clone()),
            AnyTessellation::Delaunay(cells) => PlpCells::Tetrahedra(cells.clone()),
            AnyTessellation::Prisms(cells) => PlpCells::Prisms(cells.clone()),
        }
    }

    /// Bytes that the cells, their lists and what finds them take.
    pub fn memory_bytes(&self) -> usize {
        match self {
            AnyTessellation::Octree(cells) => cells.memory_bytes(),
            AnyTessellation::KdTree(cells) => cells.memory_bytes(),
            AnyTessellation::Delaunay(cells) => cells.memory_bytes(),
            AnyTessellation::Prisms(cells) => cells.memory_bytes(),
        }
    }

    /// A file's bytes for the scene that this was made for.
    pub fn to_bytes(&self, scene: &Scene) -> Vec<u8> {
        let mut body = Writer::default();
        match self {
            AnyTessellation::Octree(cells) => cells.encode(&mut body),
            AnyTessellation::KdTree(cells) => cells.encode(&mut body),
            AnyTessellation::Delaunay(cells) => cells.encode(&mut body),
            AnyTessellation::Prisms(cells) => cells.encode(&mut body),
        }
        let mut bytes = MAGIC.to_vec();
        bytes.extend(VERSION.to_le_bytes());
        bytes.extend(self.kind().to_le_bytes());
        bytes.extend(scene_hash(scene).to_le_bytes());
        bytes.extend((body.0.len() as u64).to_le_bytes());
        bytes.extend(body.0);
        bytes.extend(crc32fast::hash(&bytes).to_le_bytes());
        bytes
    }

    /// What such bytes hold.
    ///
    /// # Errors
    /// If they are no tessellation, not whole, damaged, or another scene's.
    pub fn from_bytes(scene: &Scene, bytes: &[u8]) -> Result<AnyTessellation, TessellationFault> {
        let mut header = Reader(bytes);
        if header.take(MAGIC.len()) != Some(&MAGIC) {
            return Err(TessellationFault::NotATessellation);
        }
        let short =
            TessellationFault::Length { found: bytes.len() as u64, needed: (HEADER_BYTES + CHECK_SUM_BYTES) as u64 };
        let found = header.u32().ok_or(short.clone())?;
        if found != VERSION {
            return Err(TessellationFault::Version { found });
        }
        let kind = header.u32().ok_or(short.clone())?;
        let made_for = header.array().map(u128::from_le_bytes).ok_or(short.clone())?;
        let length = header.u64().ok_or(short)?;
        let needed = length.saturating_add((HEADER_BYTES + CHECK_SUM_BYTES) as u64);
        if needed != bytes.len() as u64 {
            return Err(TessellationFault::Length { found: bytes.len() as u64, needed });
        }
        let (checked, sum) = bytes.split_at(bytes.len() - CHECK_SUM_BYTES);
        if crc32fast::hash(checked).to_le_bytes() != sum {
            return Err(TessellationFault::CheckSum);
        }
        let hash = scene_hash(scene);
        if hash != made_for {
            return Err(TessellationFault::OtherScene { made_for, scene: hash });
        }
        let mut body = Reader(&checked[HEADER_BYTES..]);
        let total = scene.triangles().len();
        let made = match kind {
            1 => Octree::decode(&mut body, total).map(Arc::new).map(AnyTessellation::Octree),
            2 => KdTree::decode(&mut body, total).map(Arc::new).map(AnyTessellation::KdTree),
            3 => Delaunay::decode(&mut body, total).map(Arc::new).map(AnyTessellation::Delaunay),
            4 => Prisms::decode(&mut body, total).map(Arc::new).map(AnyTessellation::Prisms),
            _ => None,
        };
        made.filter(|_| body.0.is_empty()).ok_or(TessellationFault::Contradiction)
    }

    /// Writes a file.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn write(&self, scene: &Scene, path: &Path) -> Result<u64, TessellationFileError> {
        let bytes = self.to_bytes(scene);
        let failed = |source| TessellationFileError::File { verb: "write", path: path.to_owned(), source };
        std::fs::write(path, &bytes).map_err(failed)?;
        Ok(bytes.len() as u64)
    }

    /// Reads a file for a scene.
    ///
    /// # Errors
    /// If it cannot be read, or does not hold a tessellation of this scene; the message names file and remedy.
    pub fn read(scene: &Scene, path: &Path) -> Result<AnyTessellation, TessellationFileError> {
        let failed = |source| TessellationFileError::File { verb: "read", path: path.to_owned(), source };
        let bytes = std::fs::read(path).map_err(failed)?;
        AnyTessellation::from_bytes(scene, &bytes)
            .map_err(|fault| TessellationFileError::In { path: path.to_owned(), fault })
    }
}

/// Tells scenes apart: FNV-1a over words of 64 bits, 128 bits wide.
fn scene_hash(scene: &Scene) -> u128 {
    const BASIS: u128 = 0x6C62_272E_07BB_0142_62B8_2175_6295_C58D;
    const PRIME: u128 = 0x0000_0000_0100_0000_0000_0000_0000_013B;
    let mut hash = BASIS;
    let mut add = |word: u64| hash = (hash ^ u128::from(word)).wrapping_mul(PRIME);
    scene.anchor().to_array().map(f64::to_bits).into_iter().for_each(&mut add);
    add(scene.triangles().len() as u64);
    for triangle in scene.triangles() {
        for corner in triangle.corners {
            let [x, y, z] = corner.to_array().map(|at| u64::from(at.to_bits()));
            add(x | y << 32);
            add(z);
        }
        add(u64::from(triangle.sides == Sides::Both) | u64::from(triangle.occludes) << 1);
    }
    hash
}

/// Little-endian bytes under way.
#[derive(Default)]
pub(crate) struct Writer(Vec<u8>);

impl Writer {
    pub(crate) fn u32(&mut self, value: u32) {
        self.0.extend(value.to_le_bytes());
    }

    pub(crate) fn u64(&mut self, value: u64) {
        self.0.extend(value.to_le_bytes());
    }

    pub(crate) fn f64(&mut self, value: f64) {
        self.0.extend(value.to_le_bytes());
    }

    pub(crate) fn dvec2(&mut self, value: DVec2) {
        value.to_array().into_iter().for_each(|at| self.f64(at));
    }

    pub(crate) fn dvec3(&mut self, value: DVec3) {
        value.to_array().into_iter().for_each(|at| self.f64(at));
    }

    pub(crate) fn aabb(&mut self, value: &Aabb) {
        self.dvec3(value.min);
        self.dvec3(value.max);
    }

    /// A number of things and then each.
    pub(crate) fn list<T>(&mut self, things: &[T], mut write: impl FnMut(&mut Writer, &T)) {
        self.u64(things.len() as u64);
        things.iter().for_each(|thing| write(self, thing));
    }
}

/// Bytes that are left to read. `None` at the end.
pub(crate) struct Reader<'a>(&'a [u8]);

impl<'a> Reader<'a> {
    fn take(&mut self, count: usize) -> Option<&'a [u8]> {
        let (taken, left) = self.0.split_at_checked(count)?;
        self.0 = left;
        Some(taken)
    }

    fn array<const N: usize>(&mut self) -> Option<[u8; N]> {
        self.take(N)?.try_into().ok()
    }

    pub(crate) fn u32(&mut self) -> Option<u32> {
        self.array().map(u32::from_le_bytes)
    }

    pub(crate) fn u64(&mut self) -> Option<u64> {
        self.array().map(u64::from_le_bytes)
    }

    pub(crate) fn f64(&mut self) -> Option<f64> {
        self.array().map(f64::from_le_bytes)
    }

    /// A finite point.
    pub(crate) fn dvec2(&mut self) -> Option<DVec2> {
        Some(DVec2::new(self.f64()?, self.f64()?)).filter(|at| at.is_finite())
    }

    /// A finite point.
    pub(crate) fn dvec3(&mut self) -> Option<DVec3> {
        Some(DVec3::new(self.f64()?, self.f64()?, self.f64()?)).filter(|at| at.is_finite())
    }

    /// A box that is not empty.
    pub(crate) fn aabb(&mut self) -> Option<Aabb> {
        Some(Aabb::new(self.dvec3()?, self.dvec3()?)).filter(|aabb| !aabb.is_empty())
    }

    /// A list of things.
    pub(crate) fn list<T>(&mut self, mut read: impl FnMut(&mut Reader<'a>) -> Option<T>) -> Option<Vec<T>> {
        let count = usize::try_from(self.u64()?).ok()?;
        // A made-up count reserves no more than there are bytes.
        let mut things = Vec::with_capacity(count.min(self.0.len() / size_of::<T>().max(1)));
        for _ in 0..count {
            things.push(read(self)?);
        }
        Some(things)
    }

    /// A list of starts: from 0, ascending, up to `end`, one more than `count`.
    pub(crate) fn starts(&mut self, count: usize, end: usize) -> Option<Vec<u32>> {
        let starts = self.list(Reader::u32)?;
        let sound = starts.len() == count + 1 && starts[0] == 0 && starts[count] as usize == end && starts.is_sorted();
        sound.then_some(starts)
    }
}

#[cfg(test)]
mod tests;
