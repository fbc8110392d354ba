//! Scenes from glTF files: node transforms composed in f64, triangles relative to an anchor, and refusals with reasons.
//!
//! A file may come from anyone. Every index and range in it is checked before use and every instance is counted before
//! anything is stored, so a bad file costs an error and never a panic, a hang or much memory. The crate `gltf` reads the
//! container and the description; its accessor iterators, which trust the file, are not used.
//!
//! Skinned and morphed meshes are loaded as modelled (the bind pose, no morph target), where their node stands. Of what moves
//! it is also told how far it reaches in every other pose ([`ObjectMesh::reach`]).

mod accessor;
mod buffers;
mod error;
mod look;
mod pack;
mod reach;
mod rig;
#[cfg(test)]
mod tests;

use std::{
    cell::RefCell,
    collections::{BTreeMap, BTreeSet},
    fs,
    path::Path,
};

use glam::{DMat4, DQuat, DVec3, Vec3};
use gltf::json::{
    self, Root,
    material::AlphaMode,
    mesh::{Mode, Semantic},
    validation::Checked,
};

use self::{
    accessor::{Elements, Source},
    buffers::Bytes,
    reach::Reach,
};
pub use self::{
    error::LoadError,
    look::{Alpha, EncodedImage, Looks, Material, TextureUse, TriangleLook, Wrap},
    pack::pack_glb,
    rig::{BONES_MAX, Bone, Carried, Clip, Curve, Joint, Part, Place, Rig, Track},
};
use crate::{Aabb, Node, ObjectMesh, Scene, Sides, Triangle};

/// How to read a file.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct LoadOptions {
    /// Names of nodes that move: each such node's subtree becomes an [`ObjectMesh`] instead of static triangles. One
    /// named inside another becomes its own. Default none.
    pub moving_nodes: BTreeSet<String>,
    /// Whether every face is drawn from both sides, whatever its material says. Default no. Level maps with openings to
    /// the void need it; drawing costs up to twice as much.
    pub treat_two_sided: bool,
    /// Most triangles to load, all instances counted. Default 16,777,216, which take about 0.8 GB.
    pub triangles_max: u32,
}

impl Default for LoadOptions {
    fn default() -> LoadOptions {
        LoadOptions { moving_nodes: BTreeSet::new(), treat_two_sided: false, triangles_max: 1 << 24 }
    }
}

impl LoadOptions {
    /// Also moves the nodes of these names.
    pub fn with_moving_nodes<S: Into<String>>(mut self, names: impl IntoIterator<Item = S>) -> LoadOptions {
        self.moving_nodes.extend(names.into_iter().map(Into::into));
        self
    }

    /// Sets [`LoadOptions::treat_two_sided`].
    pub fn with_two_sided(mut self, two_sided: bool) -> LoadOptions {
        self.treat_two_sided = two_sided;
        self
    }

    /// Sets [`LoadOptions::triangles_max`].
    pub fn with_triangles_max(mut self, triangles_max: u32) -> LoadOptions {
        self.triangles_max = triangles_max;
        self
    }
}

/// What was met while loading.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LoadStats {
    /// Nodes in the loaded scenes.
    pub nodes: usize,
    /// Meshes that they place, instances counted.
    pub meshes: usize,
    /// Points, lines and primitives without positions, left out; instances counted.
    pub ignored_primitives: usize,
    /// Triangles without area, kept although they own no pixel.
    pub zero_area: usize,
    /// Skinned meshes, loaded in bind pose; instances counted.
    pub skinned: usize,
    /// Primitives with morph targets, loaded without; instances counted.
    pub morphed: usize,
    /// `extras.eyeline` of each node that has one, with the node's name, in the order of the file's nodes.
    pub extras: Vec<(String, serde_json::Value)>,
}

/// Loads a binary glTF file from memory. `source_name` stands for the file in errors.
pub fn load_glb(bytes: &[u8], source_name: &str, options: &LoadOptions) -> Result<Scene, LoadError> {
    load_glb_with_stats(bytes, source_name, options).map(|(scene, _)| scene)
}

/// [`load_glb`], also saying what was met.
pub fn load_glb_with_stats(
    bytes: &[u8],
    source_name: &str,
    options: &LoadOptions,
) -> Result<(Scene, LoadStats), LoadError> {
    read_glb(bytes, source_name, options, What::Shape).map(|loaded| (loaded.scene, loaded.stats))
}

/// Loads a `.glb` file, or a `.gltf` file with its buffers in it or in its folder.
pub fn load_file(path: impl AsRef<Path>, options: &LoadOptions) -> Result<Scene, LoadError> {
    load_file_with_stats(path, options).map(|(scene, _)| scene)
}

/// [`load_file`], also saying what was met.
pub fn load_file_with_stats(path: impl AsRef<Path>, options: &LoadOptions) -> Result<(Scene, LoadStats), LoadError> {
    read_file(path.as_ref(), options, What::Shape).map(|loaded| (loaded.scene, loaded.stats))
}

/// [`load_file`], also saying how its triangles look.
pub fn load_file_with_looks(path: impl AsRef<Path>, options: &LoadOptions) -> Result<(Scene, Looks), LoadError> {
    read_file(path.as_ref(), options, What::Looks).map(|loaded| (loaded.scene, loaded.looks))
}

/// [`load_glb`], also saying how its triangles look.
pub fn load_glb_with_looks(
    bytes: &[u8],
    source_name: &str,
    options: &LoadOptions,
) -> Result<(Scene, Looks), LoadError> {
    read_glb(bytes, source_name, options, What::Looks).map(|loaded| (loaded.scene, loaded.looks))
}

/// Loads the body of an avatar from a file of either kind: a mesh, what it hangs on, and how that moves.
pub fn load_rig_file(path: impl AsRef<Path>, options: &LoadOptions) -> Result<Rig, LoadError> {
    let loaded = read_file(path.as_ref(), options, What::Rig)?;
    Ok(loaded.rig.expect("it was asked for"))
}

/// The same from a binary file's bytes; `source_name` stands for the file in errors.
pub fn load_rig_glb(bytes: &[u8], source_name: &str, options: &LoadOptions) -> Result<Rig, LoadError> {
    let loaded = read_glb(bytes, source_name, options, What::Rig)?;
    Ok(loaded.rig.expect("it was asked for"))
}

/// What is wanted of a file besides its shape.
#[derive(Clone, Copy, PartialEq)]
enum What {
    Shape,
    Looks,
    Rig,
}

fn read_glb(bytes: &[u8], source_name: &str, options: &LoadOptions, what: What) -> Result<Loaded, LoadError> {
    if !bytes.starts_with(b"glTF") {
        return Err(LoadError::NotGltf { file: source_name.into(), found: bytes.iter().copied().take(8).collect() });
    }
    let (description, binary) = split_glb(bytes, source_name)?;
    load(description, binary, source_name, None, options, what)
}

fn read_file(path: &Path, options: &LoadOptions, what: What) -> Result<Loaded, LoadError> {
    let file = path.display().to_string();
    let bytes = fs::read(path).map_err(|source| LoadError::Read { file: file.clone(), source })?;
    // The parent of a bare file name is the empty path, which `canonicalize` refuses.
    let folder = path.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
    if bytes.starts_with(b"glTF") {
        let (description, binary) = split_glb(&bytes, &file)?;
        return load(description, binary, &file, Some(folder), options, what);
    }
    let text = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(&bytes);
    if text.trim_ascii_start().first() != Some(&b'{') {
        return Err(LoadError::NotGltf { file, found: bytes.iter().copied().take(8).collect() });
    }
    load(text, None, &file, Some(folder), options, what)
}

/// All that comes of a file.
struct Loaded {
    scene: Scene,
    stats: LoadStats,
    /// Empty unless asked for.
    looks: Looks,
    rig: Option<Rig>,
}

/// The JSON and binary chunks of a .glb file.
fn split_glb<'a>(bytes: &'a [u8], file: &str) -> Result<(&'a [u8], Option<&'a [u8]>), LoadError> {
    let broken = |reason: String| LoadError::Container { file: file.into(), reason };
    // `Glb::from_slice` subtracts the header from the claimed length unchecked, and reads past that length.
    let claimed = bytes.get(8..12).map_or(0, |length| u32::from_le_bytes(length.try_into().expect("four bytes")));
    let Some(bytes) = bytes.get(..claimed as usize).filter(|bytes| bytes.len() >= 12) else {
        return Err(broken(format!("says {claimed} bytes, but has {}; the file is cut off", bytes.len())));
    };
    let glb = gltf::Glb::from_slice(bytes).map_err(|e| broken(e.to_string()))?;
    match (glb.json, glb.bin) {
        (std::borrow::Cow::Borrowed(json), None) => Ok((json, None)),
        (std::borrow::Cow::Borrowed(json), Some(std::borrow::Cow::Borrowed(bin))) => Ok((json, Some(bin))),
        _ => unreachable!("Glb::from_slice borrows"),
    }
}

/// Extensions that may be required because they change nothing about shape, or are read.
fn is_known_extension(name: &str) -> bool {
    name == "KHR_mesh_quantization"
        || name == "KHR_lights_punctual"
        || name.starts_with("KHR_materials_")
        || name.contains("_texture_")
}

fn load(
    description: &[u8],
    binary: Option<&[u8]>,
    file: &str,
    folder: Option<&Path>,
    options: &LoadOptions,
    what: What,
) -> Result<Loaded, LoadError> {
    let unreadable = |source| LoadError::Json { file: file.into(), source };
    let root: Root = json::deserialize::from_slice(description).map_err(unreadable)?;
    if let Some(extension) = root.extensions_required.iter().find(|name| !is_known_extension(name)) {
        return Err(LoadError::Extension { file: file.into(), extension: extension.clone() });
    }
    let transparent = transparent_materials(&root, description).map_err(unreadable)?;
    let buffers: Vec<Bytes<'_>> = buffers::resolve(&root, binary, file, folder)?;
    let source = Source { file, root: &root, buffers: &buffers, ordered: RefCell::default() };
    let mut loader = Loader { source, options, transparent, meshes: BTreeMap::new(), stats: LoadStats::default() };
    let instances = loader.instances()?;
    let (anchor, triangles) = loader.anchor(&instances)?;
    let reaches = loader.reaches(&instances)?;
    let looks = if what == What::Looks { loader.looks(&instances, folder)? } else { Looks::default() };
    let rig = if what == What::Rig { Some(loader.rig(&instances, folder)?) } else { None };
    let scene = loader.build(&instances, &reaches, anchor, triangles);
    Ok(Loaded { scene, stats: loader.stats, looks, rig })
}

/// Materials that light passes through although their alpha mode is OPAQUE. The crate `gltf` does not tell, so the
/// description is read again if the file uses the extension.
fn transparent_materials(root: &Root, description: &[u8]) -> Result<BTreeSet<usize>, serde_json::Error> {
    const TRANSMISSION: &str = "KHR_materials_transmission";
    if !root.extensions_used.iter().any(|name| name == TRANSMISSION) {
        return Ok(BTreeSet::new());
    }
    let value: serde_json::Value = serde_json::from_slice(description)?;
    let materials = value["materials"].as_array().map_or(&[][..], Vec::as_slice);
    Ok((0..materials.len()).filter(|&i| materials[i]["extensions"].get(TRANSMISSION).is_some()).collect())
}

/// Deepest chain of nodes; a rig has some tens.
const DEPTH_MAX: usize = 1024;
/// Widest world in metres: positions on the wire are 32 bits of 2⁻¹⁰ m around one anchor.
const WIDTH_MAX: f64 = 2e6;
/// Farthest coordinate in metres that f32 still holds to a millimetre, and so needs no anchor.
const ANCHORLESS_MAX: f64 = 10e3;

struct Loader<'a> {
    source: Source<'a>,
    options: &'a LoadOptions,
    transparent: BTreeSet<usize>,
    meshes: BTreeMap<usize, Mesh<'a>>,
    stats: LoadStats,
}

/// A mesh whose primitives were all checked: their triangles can be read without an error.
struct Mesh<'a> {
    primitives: Vec<Primitive<'a>>,
    triangles: u64,
    ignored: usize,
    morphed: usize,
}

struct Primitive<'a> {
    /// Its index in the file's mesh.
    at: usize,
    positions: Elements<'a>,
    indices: Option<Elements<'a>>,
    mode: Mode,
    triangles: usize,
    sides: Sides,
    occludes: bool,
}

/// A node of the loaded scenes, placed in the file's space.
struct Instance {
    node: usize,
    world_from_local: DMat4,
    mesh: Option<usize>,
    /// The node whose [`ObjectMesh`] this is part of, if it moves.
    mover: Option<usize>,
}

impl Instance {
    /// Whether it turns triangles round.
    fn is_mirrored(&self) -> bool {
        let axes = [self.world_from_local.x_axis, self.world_from_local.y_axis, self.world_from_local.z_axis];
        // Of the directions alone, since the cube of a tiny scale would vanish.
        let [x, y, z] = axes.map(|axis| axis.truncate().normalize_or_zero());
        x.cross(y).dot(z) < 0.0
    }
}

impl<'a> Loader<'a> {
    /// Every node of the scenes in depth-first order, with its mesh checked.
    fn instances(&mut self) -> Result<Vec<Instance>, LoadError> {
        let root = self.source.root;
        self.check_forest()?;
        let scenes = match root.scene {
            Some(scene) => {
                let index = scene.value();
                let scene =
                    root.scenes.get(index).ok_or_else(|| self.missing("file", "scene", index, root.scenes.len()))?;
                std::slice::from_ref(scene)
            }
            None => &root.scenes,
        };
        let mut instances = Vec::new();
        let mut placed = vec![false; root.nodes.len()];
        let mut triangles = 0u64;
        // A node, its parent's transform, the mover that it belongs to, its depth.
        let mut stack: Vec<(usize, DMat4, Option<usize>, usize)> = Vec::new();
        for top in scenes.iter().flat_map(|scene| &scene.nodes).map(|node| node.value()) {
            // Scenes may share a root, which is then placed once.
            if !placed[top] {
                stack.push((top, DMat4::IDENTITY, None, 0));
            }
            while let Some((index, world_from_parent, mover, depth)) = stack.pop() {
                placed[index] = true;
                let node = &root.nodes[index];
                if depth > DEPTH_MAX {
                    return Err(self.node_error(index, format!("lies more than {DEPTH_MAX} nodes deep; flatten it")));
                }
                let world_from_local = world_from_parent * self.transform(index)?;
                if !world_from_local.is_finite() {
                    return Err(self.node_error(index, format!("stands at {world_from_local}, which must be finite")));
                }
                let moves = node.name.as_ref().is_some_and(|name| self.options.moving_nodes.contains(name));
                let mover = if moves { Some(index) } else { mover };
                let mesh = node.mesh.map(|mesh| mesh.value());
                if let Some(mesh) = mesh {
                    triangles += self.use_mesh(mesh, index)?;
                    self.check_count(triangles)?;
                    self.stats.skinned += usize::from(node.skin.is_some());
                }
                instances.push(Instance { node: index, world_from_local, mesh, mover });
                for child in node.children.iter().flatten().rev() {
                    stack.push((child.value(), world_from_local, mover, depth + 1));
                }
            }
        }
        self.stats.nodes = instances.len();
        for name in &self.options.moving_nodes {
            if !instances.iter().any(|instance| root.nodes[instance.node].name.as_ref() == Some(name)) {
                return Err(LoadError::NoSuchNode { file: self.source.file.into(), name: name.clone() });
            }
        }
        self.read_extras(&placed)?;
        Ok(instances)
    }

    /// Refuses nodes that are missing, have two parents, are their own ancestors, or are roots and children at once.
    fn check_forest(&self) -> Result<(), LoadError> {
        let root = self.source.root;
        let count = root.nodes.len();
        let mut parents = vec![None; count];
        for (parent, node) in root.nodes.iter().enumerate() {
            for child in node.children.iter().flatten().map(|child| child.value()) {
                if child >= count {
                    return Err(self.missing(&format!("node {parent}"), "node", child, count));
                }
                if let Some(other) = parents[child].replace(parent) {
                    let reason = format!("is a child of both node {other} and node {parent}; copy it");
                    return Err(self.node_error(child, reason));
                }
            }
        }
        // Walk up from each node until ground that an earlier walk covered; meeting this walk's own track is a cycle.
        let mut walked_by = vec![usize::MAX; count];
        for start in 0..count {
            let mut at = Some(start);
            while let Some(node) = at.filter(|&node| walked_by[node] == usize::MAX) {
                walked_by[node] = start;
                at = parents[node];
            }
            if let Some(node) = at.filter(|&node| walked_by[node] == start) {
                return Err(self.node_error(node, "is its own ancestor; remove it from the children below it".into()));
            }
        }
        for (scene, nodes) in root.scenes.iter().enumerate() {
            for node in nodes.nodes.iter().map(|node| node.value()) {
                let parent =
                    *parents.get(node).ok_or_else(|| self.missing(&format!("scene {scene}"), "node", node, count))?;
                if let Some(parent) = parent {
                    let reason = format!("is a root of scene {scene}, but also a child of node {parent}");
                    return Err(self.node_error(node, reason));
                }
            }
        }
        Ok(())
    }

    /// The node's own transform.
    fn transform(&self, index: usize) -> Result<DMat4, LoadError> {
        let node = &self.source.root.nodes[index];
        let wide = |v: [f32; 3]| DVec3::from(v.map(f64::from));
        let local = match &node.matrix {
            Some(matrix) => DMat4::from_cols_array(&matrix.map(f64::from)),
            None => {
                let [x, y, z, w] = node.rotation.unwrap_or_default().0.map(f64::from);
                let rotation = DQuat::from_xyzw(x, y, z, w);
                let length = rotation.length();
                if !(length.is_finite() && length > 0.0) {
                    return Err(self.node_error(index, format!("rotation {rotation} has no direction")));
                }
                let scale = wide(node.scale.unwrap_or([1.0; 3]));
                let translation = wide(node.translation.unwrap_or([0.0; 3]));
                DMat4::from_scale_rotation_translation(scale, rotation / length, translation)
            }
        };
        let bottom = local.row(3);
        if !local.is_finite() {
            return Err(self.node_error(index, format!("transform {local} must be finite")));
        }
        if bottom.to_array() != [0.0, 0.0, 0.0, 1.0] {
            return Err(self.node_error(index, format!("matrix has the bottom row {bottom}, not 0 0 0 1")));
        }
        Ok(local)
    }

    fn read_extras(&mut self, placed: &[bool]) -> Result<(), LoadError> {
        let unreadable = |source| LoadError::Json { file: self.source.file.into(), source };
        for (node, _) in self.source.root.nodes.iter().zip(placed).filter(|(_, placed)| **placed) {
            let Some(extras) = &node.extras else { continue };
            let mut extras: serde_json::Value = serde_json::from_str(extras.get()).map_err(unreadable)?;
            if let Some(value) = extras.get_mut("eyeline") {
                self.stats.extras.push((node.name.clone().unwrap_or_default(), value.take()));
            }
        }
        Ok(())
    }

    /// Counts one more user of the mesh, checking it the first time; returns its triangles.
    fn use_mesh(&mut self, index: usize, node: usize) -> Result<u64, LoadError> {
        if !self.meshes.contains_key(&index) {
            let mesh = self.check_mesh(index, node)?;
            self.meshes.insert(index, mesh);
        }
        let mesh = &self.meshes[&index];
        self.stats.meshes += 1;
        self.stats.ignored_primitives += mesh.ignored;
        self.stats.morphed += mesh.morphed;
        Ok(mesh.triangles)
    }

    fn check_mesh(&self, index: usize, node: usize) -> Result<Mesh<'a>, LoadError> {
        let root = self.source.root;
        let described = root
            .meshes
            .get(index)
            .ok_or_else(|| self.missing(&format!("node {node}"), "mesh", index, root.meshes.len()))?;
        let mut mesh = Mesh { primitives: Vec::new(), triangles: 0, ignored: 0, morphed: 0 };
        for (at, described) in described.primitives.iter().enumerate() {
            let Some(primitive) = self.check_primitive(index, at, described)? else {
                mesh.ignored += 1;
                continue;
            };
            mesh.morphed += usize::from(described.targets.as_ref().is_some_and(|targets| !targets.is_empty()));
            mesh.triangles += primitive.triangles as u64;
            // Before its corners are read: a small file may claim very many.
            self.check_count(mesh.triangles)?;
            self.check_corners(index, at, &primitive)?;
            if primitive.triangles > 0 {
                mesh.primitives.push(primitive);
            }
        }
        Ok(mesh)
    }

    /// The primitive, or `None` if it has no triangles by its nature.
    fn check_primitive(
        &self,
        mesh: usize,
        at: usize,
        described: &json::mesh::Primitive,
    ) -> Result<Option<Primitive<'a>>, LoadError> {
        let root = self.source.root;
        let error = |reason: &str| LoadError::Primitive {
            file: self.source.file.into(),
            mesh,
            primitive: at,
            reason: reason.into(),
        };
        let Checked::Valid(mode) = described.mode else {
            return Err(error("unknown mode; 0 to 6 are points, lines and triangles"));
        };
        let positions = described.attributes.get(&Checked::Valid(Semantic::Positions));
        let Some(positions) =
            positions.filter(|_| matches!(mode, Mode::Triangles | Mode::TriangleStrip | Mode::TriangleFan))
        else {
            return Ok(None);
        };
        let from = format!("mesh {mesh}, primitive {at}");
        let positions = self.source.positions(positions.value(), &from)?;
        let indices = described.indices.map(|i| self.source.indices(i.value(), &from)).transpose()?;
        let corners = indices.as_ref().map_or(positions.count, |indices| indices.count);
        let triangles = match mode {
            Mode::Triangles => corners / 3,
            _ => corners.saturating_sub(2),
        };
        let (mut sides, mut occludes) = (Sides::Both, true);
        if let Some(material) = described.material {
            let index = material.value();
            let material = root
                .materials
                .get(index)
                .ok_or_else(|| self.missing(&from, "material", index, root.materials.len()))?;
            if !material.double_sided && !self.options.treat_two_sided {
                sides = Sides::Front;
            }
            let Checked::Valid(mode) = material.alpha_mode else {
                return Err(error(&format!("material {index} has an unknown alpha mode; use OPAQUE, MASK or BLEND")));
            };
            occludes = mode == AlphaMode::Opaque && !self.transparent.contains(&index);
        }
        Ok(Some(Primitive { at, positions, indices, mode, triangles, sides, occludes }))
    }

    /// Refuses corners that are out of range or not finite.
    fn check_corners(&self, mesh: usize, at: usize, primitive: &Primitive<'a>) -> Result<(), LoadError> {
        let file = || self.source.file.into();
        for corners in primitive.corners() {
            for vertex in corners {
                if vertex >= primitive.positions.count {
                    let reason = format!("index {vertex}, but there are {} positions", primitive.positions.count);
                    return Err(LoadError::Primitive { file: file(), mesh, primitive: at, reason });
                }
                let position = DVec3::from(primitive.positions.position(vertex));
                if !position.is_finite() {
                    return Err(LoadError::Position { file: file(), mesh, primitive: at, vertex, position });
                }
            }
        }
        Ok(())
    }

    fn check_count(&self, triangles: u64) -> Result<(), LoadError> {
        let limit = self.options.triangles_max;
        if triangles > u64::from(limit) {
            return Err(LoadError::TooManyTriangles { file: self.source.file.into(), triangles, limit });
        }
        Ok(())
    }

    /// The point that positions become relative to, and the number of static triangles.
    fn anchor(&self, instances: &[Instance]) -> Result<(DVec3, usize), LoadError> {
        let too_wide = |width: f64| LoadError::TooWide { file: self.source.file.into(), width_km: width / 1e3 };
        let mut aabb = Aabb::EMPTY;
        let mut triangles = 0;
        for instance in instances {
            // An object's origin is a position too.
            if instance.mover == Some(instance.node) {
                aabb = aabb.with_point(instance.world_from_local.w_axis.truncate());
            }
            for corners in self.world_corners(instance) {
                // The product of a finite transform and a finite position may be infinite, or NaN.
                if !corners.iter().all(|corner| corner.is_finite()) {
                    return Err(too_wide(f64::INFINITY));
                }
                aabb = corners.into_iter().fold(aabb, |aabb, corner| aabb.with_point(corner));
                triangles += usize::from(instance.mover.is_none());
            }
        }
        if aabb.is_empty() {
            return Ok((DVec3::ZERO, 0));
        }
        let width = aabb.size().max_element();
        if width > WIDTH_MAX {
            return Err(too_wide(width));
        }
        let farthest = aabb.min.abs().max(aabb.max.abs()).max_element();
        let anchor = if farthest > ANCHORLESS_MAX { aabb.centre().round() } else { DVec3::ZERO };
        Ok((anchor, triangles))
    }

    /// The scene, all checks done.
    fn build(
        &mut self,
        instances: &[Instance],
        reaches: &BTreeMap<usize, Reach>,
        anchor: DVec3,
        static_triangles: usize,
    ) -> Scene {
        let name = |node: usize| self.source.root.nodes[node].name.clone().unwrap_or_default();
        let mut triangles: Vec<Triangle> = Vec::with_capacity(static_triangles);
        let mut nodes = Vec::new();
        let mut objects: Vec<ObjectMesh> = Vec::new();
        let mut object_of = BTreeMap::new();
        for instance in instances {
            if instance.mover == Some(instance.node) {
                object_of.insert(instance.node, objects.len());
                let origin = instance.world_from_local.w_axis.truncate() - anchor;
                let Reach { radius: reach, deforms } = reaches.get(&instance.node).copied().unwrap_or_default();
                objects.push(ObjectMesh { name: name(instance.node), origin, triangles: Vec::new(), reach, deforms });
            }
            match instance.mover {
                Some(mover) => {
                    let object = &mut objects[object_of[&mover]];
                    let relative_to = anchor + object.origin;
                    object.triangles.extend(self.triangles(instance, relative_to));
                }
                None => {
                    let first = triangles.len() as u32;
                    triangles.extend(self.triangles(instance, anchor));
                    let end = triangles.len() as u32;
                    if end > first {
                        nodes.push(Node { name: name(instance.node), primitives: first..end });
                    }
                }
            }
        }
        for object in &mut objects {
            // Corners were rounded to f32.
            let corners = object.triangles.iter().flat_map(|triangle| triangle.corners);
            object.reach = corners.map(|corner| corner.as_dvec3().length()).fold(object.reach, f64::max);
        }
        let all = triangles.iter().chain(objects.iter().flat_map(|object| &object.triangles));
        self.stats.zero_area = all.filter(|triangle| has_zero_area(triangle)).count();
        Scene::from_parts(anchor, triangles, nodes, objects)
    }

    /// The instance's triangles relative to a point.
    fn triangles(&self, instance: &Instance, relative_to: DVec3) -> impl Iterator<Item = Triangle> {
        let sided = self
            .primitives(instance)
            .flat_map(|primitive| std::iter::repeat_n((primitive.sides, primitive.occludes), primitive.triangles));
        self.world_corners(instance).zip(sided).map(move |(corners, (sides, occludes))| Triangle {
            corners: corners.map(|corner| -> Vec3 { (corner - relative_to).as_vec3() }),
            sides,
            occludes,
        })
    }

    /// Corners in the file's space, anticlockwise seen from the front: a mirror would turn them round.
    fn world_corners(&self, instance: &Instance) -> impl Iterator<Item = [DVec3; 3]> {
        let world_from_local = instance.world_from_local;
        let mirrored = instance.is_mirrored();
        self.primitives(instance).flat_map(move |primitive| {
            primitive.corners().map(move |[a, b, c]| {
                let corners = if mirrored { [a, c, b] } else { [a, b, c] };
                corners.map(|vertex| world_from_local.transform_point3(primitive.positions.position(vertex).into()))
            })
        })
    }

    fn primitives(&self, instance: &Instance) -> std::slice::Iter<'_, Primitive<'a>> {
        instance.mesh.map_or(&[][..], |mesh| &self.meshes[&mesh].primitives).iter()
    }

    fn missing(&self, from: &str, kind: &'static str, index: usize, count: usize) -> LoadError {
        LoadError::Missing { file: self.source.file.into(), from: from.into(), kind, index, count }
    }

    fn node_error(&self, node: usize, reason: String) -> LoadError {
        let name = self.source.root.nodes[node].name.clone().unwrap_or_default();
        LoadError::Node { file: self.source.file.into(), node, name, reason }
    }
}

impl Primitive<'_> {
    /// Vertices of each triangle, in the order of the specification (§3.7.2.1).
    fn corners(&self) -> impl Iterator<Item = [usize; 3]> {
        (0..self.triangles).map(|i| {
            let places = match self.mode {
                Mode::TriangleStrip => [i, i + 1 + i % 2, i + 2 - i % 2],
                Mode::TriangleFan => [i + 1, i + 2, 0],
                _ => [3 * i, 3 * i + 1, 3 * i + 2],
            };
            places.map(|place| self.indices.as_ref().map_or(place, |indices| indices.index(place) as usize))
        })
    }
}

fn has_zero_area(triangle: &Triangle) -> bool {
    let [a, b, c] = triangle.corners.map(|corner| corner.as_dvec3());
    (b - a).cross(c - a) == DVec3::ZERO
}
