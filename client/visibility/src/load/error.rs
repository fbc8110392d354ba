//! Why a file cannot be loaded: each error names the file, the thing in it, its value, and what to do about it.

use std::io;

use glam::DVec3;

/// Why a glTF file was refused.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LoadError {
    /// The file, or a buffer beside it, cannot be read.
    #[error("{file}: cannot be read: {source}")]
    Read {
        /// The file that failed.
        file: String,
        /// What the system says.
        source: io::Error,
    },
    /// Neither a binary glTF header nor a JSON object.
    #[error("{file}: not glTF: begins with {found:?}; convert it to .glb first")]
    NotGltf {
        /// The file.
        file: String,
        /// Its first bytes.
        found: Vec<u8>,
    },
    /// The binary container is cut off or contradicts itself.
    #[error("{file}: broken .glb container: {reason}")]
    Container {
        /// The file.
        file: String,
        /// What is wrong with it.
        reason: String,
    },
    /// The JSON part is not glTF's.
    #[error("{file}: broken glTF description: {source}")]
    Json {
        /// The file.
        file: String,
        /// Where and why.
        source: serde_json::Error,
    },
    /// The file says that it cannot be read without an extension that this loader lacks.
    #[error("{file}: requires the extension {extension}, which is not supported; export it without")]
    Extension {
        /// The file.
        file: String,
        /// Its name.
        extension: String,
    },
    /// Something refers to a thing that the file lacks.
    #[error("{file}: {from} refers to {kind} {index}, but there are {count}")]
    Missing {
        /// The file.
        file: String,
        /// What refers to it.
        from: String,
        /// What kind of thing is missing.
        kind: &'static str,
        /// Its index.
        index: usize,
        /// How many there are.
        count: usize,
    },
    /// A buffer has no data, or not enough.
    #[error("{file}: buffer {buffer}: {reason}")]
    Buffer {
        /// The file.
        file: String,
        /// Index of the buffer.
        buffer: usize,
        /// What is wrong with it.
        reason: String,
    },
    /// An accessor is of the wrong type or reaches past its data.
    #[error("{file}: accessor {accessor}: {reason}")]
    Accessor {
        /// The file.
        file: String,
        /// Index of the accessor.
        accessor: usize,
        /// What is wrong with it.
        reason: String,
    },
    /// A primitive, or the material that it names, makes no sense.
    #[error("{file}: mesh {mesh}, primitive {primitive}: {reason}")]
    Primitive {
        /// The file.
        file: String,
        /// Index of the mesh.
        mesh: usize,
        /// Index of the primitive in the mesh.
        primitive: usize,
        /// What is wrong with it.
        reason: String,
    },
    /// A position is NaN or infinite.
    #[error("{file}: mesh {mesh}, primitive {primitive}: position {vertex} is {position}, but must be finite")]
    Position {
        /// The file.
        file: String,
        /// Index of the mesh.
        mesh: usize,
        /// Index of the primitive in the mesh.
        primitive: usize,
        /// Index of the vertex in the primitive.
        vertex: usize,
        /// Its value.
        position: DVec3,
    },
    /// A node is its own ancestor, has two parents, is too deep, or has an impossible transform.
    #[error("{file}: node {node} ({name:?}): {reason}")]
    Node {
        /// The file.
        file: String,
        /// Index of the node.
        node: usize,
        /// Its name, or empty.
        name: String,
        /// What is wrong with it.
        reason: String,
    },
    /// A node that the caller named as moving does not occur in the loaded scenes.
    #[error("{file}: no node named {name:?} to move; the names are case-sensitive")]
    NoSuchNode {
        /// The file.
        file: String,
        /// The name.
        name: String,
    },
    /// More triangles, all instances counted, than the caller allows.
    #[error("{file}: {triangles} triangles or more, but at most {limit} are allowed; raise `triangles_max`")]
    TooManyTriangles {
        /// The file.
        file: String,
        /// How many there were when counting stopped.
        triangles: u64,
        /// The limit.
        limit: u32,
    },
    /// Poses of what moves would take too long to look at.
    #[error(
        "{file}: what moves has more vertices, morph targets and keyframes than {triangles_max} triangles allow to look at; \
         raise `triangles_max`"
    )]
    TooManyPoses {
        /// The file.
        file: String,
        /// The limit that this one follows.
        triangles_max: u32,
    },
    /// The file is no body of an avatar.
    #[error("{file} cannot be an avatar: {reason}")]
    Rig {
        /// The file.
        file: String,
        /// Why not.
        reason: String,
    },
    /// The world is too wide for positions relative to one anchor.
    #[error("{file}: the world is {width_km:.0} km wide, but at most 2000 km are allowed; split it or mend its units")]
    TooWide {
        /// The file.
        file: String,
        /// Greatest side of its box, in kilometres.
        width_km: f64,
    },
}
