//! Writes a binary glTF file: meshes shared by many nodes, materials with base colours, nothing else.
//!
//! The file is one JSON chunk and one binary chunk, each padded to 4 bytes (glTF 2.0, section 4.4). Positions have no
//! normals; indices are 16-bit where they fit. Translations and rotations are printed as the shortest decimal that reads
//! back to the same f64, so a scene far from the origin loses nothing on its way through the file.

use glam::{DQuat, DVec3, Vec3};
use serde_json::{Value, json};

const ARRAY_BUFFER: u32 = 34_962;
const ELEMENT_ARRAY_BUFFER: u32 = 34_963;
const UNSIGNED_SHORT: u32 = 5_123;
const UNSIGNED_INT: u32 = 5_125;
const FLOAT: u32 = 5_126;

/// Index value that glTF reserves in a 16-bit accessor (primitive restart).
const RESERVED_U16: usize = 0xFFFF;

/// A material of a [`GlbWriter`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MaterialId(usize);

/// A mesh of a [`GlbWriter`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MeshId(usize);

/// Triangles of one material, in the frame of the nodes that show them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Triangles {
    /// Corners, in metres.
    pub positions: Vec<Vec3>,
    /// Three corners a triangle, counter-clockwise seen from its front.
    pub indices: Vec<u32>,
}

impl Triangles {
    /// Adds a closed box with its faces outward: 8 corners, 12 triangles.
    pub fn push_box(&mut self, min: Vec3, max: Vec3) {
        let first = self.positions.len() as u32;
        for corner in 0..8 {
            let pick = |bit: u32, low: f32, high: f32| if corner & bit == 0 { low } else { high };
            self.positions.push(Vec3::new(pick(1, min.x, max.x), pick(2, min.y, max.y), pick(4, min.z, max.z)));
        }
        // −X, +X, −Y, +Y, −Z, +Z, each counter-clockwise from outside; bit 0 of a corner is x, bit 1 y, bit 2 z.
        for [a, b, c, d] in [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]] {
            self.indices.extend([a, b, c, a, c, d].map(|corner: u32| first + corner));
        }
    }

    /// How many triangles.
    pub fn len(&self) -> usize {
        self.indices.len() / 3
    }

    /// True if there is none.
    pub fn is_empty(&self) -> bool {
        self.indices.is_empty()
    }
}

/// A node at the top of the scene that shows a mesh.
#[derive(Clone, Debug, PartialEq)]
pub struct Node {
    /// Name in the file.
    pub name: String,
    /// What it shows, if anything.
    pub mesh: Option<MeshId>,
    /// Its origin in the world, in metres.
    pub translation: DVec3,
    /// Its turn.
    pub rotation: DQuat,
}

/// Why a scene cannot be written.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum GlbError {
    /// A mesh that is not a list of triangles over finite corners.
    #[error("mesh `{mesh}` {what}")]
    Mesh {
        /// Name of the mesh.
        mesh: String,
        /// What is wrong with it.
        what: &'static str,
    },
    /// A node with a translation or rotation that is not finite, or not a rotation.
    #[error("node `{0}` has a translation or rotation that is not finite, or a rotation that is not of length 1")]
    Node(String),
    /// The format counts bytes in 32 bits.
    #[error("the scene needs {bytes} bytes and a .glb file holds at most 4294967295; make it smaller")]
    TooLarge {
        /// Bytes that it would have.
        bytes: usize,
    },
}

/// Collects a scene and writes it.
#[derive(Clone, Debug, Default)]
pub struct GlbWriter {
    materials: Vec<Value>,
    meshes: Vec<Value>,
    accessors: Vec<Value>,
    views: Vec<Value>,
    nodes: Vec<Value>,
    binary: Vec<u8>,
    triangles_of_mesh: Vec<usize>,
    triangles: usize,
}

impl GlbWriter {
    /// An empty scene.
    pub fn new() -> GlbWriter {
        GlbWriter::default()
    }

    /// Adds an opaque material. `color` is linear RGB, 0 to 1; a single-sided one is seen from its front only.
    pub fn material(&mut self, name: &str, color: [f32; 3], double_sided: bool) -> MaterialId {
        let [red, green, blue] = color;
        self.materials.push(json!({
            "name": name,
            "doubleSided": double_sided,
            "pbrMetallicRoughness": {
                "baseColorFactor": [red, green, blue, 1.0],
                "metallicFactor": 0.0,
                "roughnessFactor": 0.9,
            },
        }));
        MaterialId(self.materials.len() - 1)
    }

    /// Adds a mesh that any number of nodes may show.
    pub fn mesh(
        &mut self,
        name: &str,
        triangles: &Triangles,
        material: Option<MaterialId>,
    ) -> Result<MeshId, GlbError> {
        let bad = |what| Err(GlbError::Mesh { mesh: name.into(), what });
        let Triangles { positions, indices } = triangles;
        if indices.is_empty() || positions.is_empty() {
            return bad("has no triangle; leave it out");
        }
        if !indices.len().is_multiple_of(3) {
            return bad("has a number of indices that is no multiple of 3");
        }
        if indices.iter().any(|&index| index as usize >= positions.len()) {
            return bad("has an index past its last corner");
        }
        if positions.iter().any(|position| !position.is_finite()) {
            return bad("has a corner that is not finite");
        }
        let min = positions.iter().copied().fold(Vec3::INFINITY, Vec3::min);
        let max = positions.iter().copied().fold(Vec3::NEG_INFINITY, Vec3::max);
        let bytes = positions.iter().flat_map(|p| p.to_array()).flat_map(f32::to_le_bytes).collect::<Vec<u8>>();
        let view = self.view(&bytes, ARRAY_BUFFER);
        let position = self.accessor(json!({
            "bufferView": view, "componentType": FLOAT, "count": positions.len(), "type": "VEC3",
            "min": min.to_array(), "max": max.to_array(),
        }));
        let (bytes, component): (Vec<u8>, u32) = if positions.len() <= RESERVED_U16 {
            (indices.iter().flat_map(|&index| (index as u16).to_le_bytes()).collect(), UNSIGNED_SHORT)
        } else {
            (indices.iter().flat_map(|index| index.to_le_bytes()).collect(), UNSIGNED_INT)
        };
        let view = self.view(&bytes, ELEMENT_ARRAY_BUFFER);
        let index = self.accessor(json!({
            "bufferView": view, "componentType": component, "count": indices.len(), "type": "SCALAR",
        }));
        let mut primitive = json!({ "attributes": { "POSITION": position }, "indices": index, "mode": 4 });
        if let Some(MaterialId(id)) = material {
            primitive["material"] = id.into();
        }
        self.meshes.push(json!({ "name": name, "primitives": [primitive] }));
        self.triangles_of_mesh.push(triangles.len());
        Ok(MeshId(self.meshes.len() - 1))
    }

    /// Adds a node.
    pub fn node(&mut self, node: Node) -> Result<(), GlbError> {
        let Node { name, mesh, translation, rotation } = node;
        if !translation.is_finite() || !rotation.is_finite() || !rotation.is_normalized() {
            return Err(GlbError::Node(name));
        }
        let mut value = json!({ "name": name });
        if let Some(MeshId(id)) = mesh {
            value["mesh"] = id.into();
            self.triangles += self.triangles_of_mesh[id];
        }
        if translation != DVec3::ZERO {
            value["translation"] = json!(translation.to_array());
        }
        if rotation != DQuat::IDENTITY {
            value["rotation"] = json!(rotation.to_array());
        }
        self.nodes.push(value);
        Ok(())
    }

    /// Adds a node of solid boxes, each from its least to its greatest corner in metres. The node carries the f64 place of
    /// the first, the mesh what is small; coordinates that boxes of one node share agree to the last bit.
    pub fn boxes(&mut self, name: String, material: MaterialId, boxes: &[(DVec3, DVec3)]) -> Result<(), GlbError> {
        let center = boxes.first().map_or(DVec3::ZERO, |(min, max)| (min + max) * 0.5);
        let mut triangles = Triangles::default();
        for &(min, max) in boxes {
            triangles.push_box((min - center).as_vec3(), (max - center).as_vec3());
        }
        let mesh = self.mesh(&name, &triangles, Some(material))?;
        self.node(Node { name, mesh: Some(mesh), translation: center, rotation: DQuat::IDENTITY })
    }

    /// Triangles that the scene shows, instances counted each time.
    pub fn triangles(&self) -> usize {
        self.triangles
    }

    /// The file's bytes.
    pub fn finish(self) -> Result<Vec<u8>, GlbError> {
        let mut root = json!({
            "asset": { "version": "2.0", "generator": concat!("eyeline-sim ", env!("CARGO_PKG_VERSION")) },
        });
        // glTF forbids empty arrays.
        let mut fill = |key: &str, values: Vec<Value>| {
            if !values.is_empty() {
                root[key] = Value::Array(values);
            }
        };
        let roots: Vec<Value> = (0..self.nodes.len()).map(Value::from).collect();
        fill("materials", self.materials);
        fill("meshes", self.meshes);
        fill("accessors", self.accessors);
        fill("bufferViews", self.views);
        fill("nodes", self.nodes);
        if !self.binary.is_empty() {
            fill("buffers", vec![json!({ "byteLength": self.binary.len() })]);
        }
        if !roots.is_empty() {
            root["scene"] = 0.into();
            root["scenes"] = json!([{ "nodes": roots }]);
        }
        let json = padded(root.to_string().into_bytes(), b' ');
        let binary = padded(self.binary, 0);
        let chunks = if binary.is_empty() { vec![(b"JSON", json)] } else { vec![(b"JSON", json), (b"BIN\0", binary)] };
        let bytes = 12 + chunks.iter().map(|(_, body)| 8 + body.len()).sum::<usize>();
        let total = u32::try_from(bytes).map_err(|_| GlbError::TooLarge { bytes })?;

        let mut file = Vec::with_capacity(bytes);
        file.extend(b"glTF");
        file.extend(2_u32.to_le_bytes());
        file.extend(total.to_le_bytes());
        for (kind, body) in chunks {
            file.extend((body.len() as u32).to_le_bytes());
            file.extend(kind);
            file.extend(body);
        }
        Ok(file)
    }

    /// Appends to the binary chunk at a multiple of 4 bytes.
    fn view(&mut self, bytes: &[u8], target: u32) -> usize {
        let offset = self.binary.len();
        self.binary.extend(bytes);
        self.binary.resize(self.binary.len().next_multiple_of(4), 0);
        self.views.push(json!({ "buffer": 0, "byteOffset": offset, "byteLength": bytes.len(), "target": target }));
        self.views.len() - 1
    }

    fn accessor(&mut self, accessor: Value) -> usize {
        self.accessors.push(accessor);
        self.accessors.len() - 1
    }
}

fn padded(mut bytes: Vec<u8>, with: u8) -> Vec<u8> {
    bytes.resize(bytes.len().next_multiple_of(4), with);
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    fn unit_box() -> Triangles {
        let mut triangles = Triangles::default();
        triangles.push_box(Vec3::ZERO, Vec3::ONE);
        triangles
    }

    fn node(name: &str, mesh: MeshId, translation: DVec3) -> Node {
        Node { name: name.into(), mesh: Some(mesh), translation, rotation: DQuat::from_rotation_y(0.7) }
    }

    #[test]
    fn file_loads_with_instances_names_and_colours() {
        let mut writer = GlbWriter::new();
        let red = writer.material("red", [1.0, 0.0, 0.0], false);
        let mesh = writer.mesh("box", &unit_box(), Some(red)).unwrap();
        writer.node(node("a", mesh, DVec3::ZERO)).unwrap();
        writer.node(node("b", mesh, DVec3::new(2.0, 0.0, 0.0))).unwrap();
        assert_eq!(writer.triangles(), 24);
        let bytes = writer.finish().unwrap();

        let file = gltf::Gltf::from_slice(&bytes).unwrap();
        let names: Vec<_> = file.nodes().map(|n| n.name().unwrap().to_owned()).collect();
        assert_eq!(names, ["a", "b"]);
        assert_eq!(file.meshes().count(), 1);
        assert!(file.nodes().all(|n| n.mesh().unwrap().index() == 0));
        let primitive = file.meshes().next().unwrap().primitives().next().unwrap();
        assert!(!primitive.material().double_sided());
        assert_eq!(primitive.material().pbr_metallic_roughness().base_color_factor(), [1.0, 0.0, 0.0, 1.0]);
        let blob = file.blob.clone().unwrap();
        let reader = primitive.reader(|_| Some(&blob));
        let positions: Vec<_> = reader.read_positions().unwrap().map(Vec3::from).collect();
        let indices: Vec<_> = reader.read_indices().unwrap().into_u32().collect();
        assert_eq!(Triangles { positions, indices }, unit_box());
    }

    #[test]
    fn box_is_closed_and_faces_outward() {
        let Triangles { positions, indices } = unit_box();
        let volume: f32 = indices
            .chunks_exact(3)
            .map(|t| [0, 1, 2].map(|i| positions[t[i] as usize]))
            .map(|[a, b, c]| a.dot(b.cross(c)) / 6.0)
            .sum();
        assert!((volume - 1.0).abs() < 1e-6);
        // Closed and consistently wound: each directed edge has its opposite exactly once.
        let mut edges = std::collections::BTreeMap::new();
        for t in indices.chunks_exact(3) {
            for (from, to) in [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])] {
                assert!(edges.insert((from, to), ()).is_none());
            }
        }
        assert!(edges.keys().all(|&(from, to)| edges.contains_key(&(to, from))));
    }

    #[test]
    fn translations_keep_every_bit() {
        let mut writer = GlbWriter::new();
        let mesh = writer.mesh("box", &unit_box(), None).unwrap();
        let far = DVec3::new(4_321_098.765_432_1, 0.1 + 0.2, -1e-300);
        writer.node(node("far", mesh, far)).unwrap();
        let bytes = writer.finish().unwrap();
        let json_bytes = u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize;
        let json: Value = serde_json::from_slice(&bytes[20..20 + json_bytes]).unwrap();
        let read: [f64; 3] = serde_json::from_value(json["nodes"][0]["translation"].clone()).unwrap();
        assert_eq!(read.map(f64::to_bits), far.to_array().map(f64::to_bits));
    }

    #[test]
    fn many_corners_take_32_bit_indices() {
        let mut triangles = Triangles::default();
        for i in 0..8_192 {
            triangles.push_box(Vec3::splat(i as f32), Vec3::splat(i as f32 + 0.5));
        }
        let mut writer = GlbWriter::new();
        let mesh = writer.mesh("boxes", &triangles, None).unwrap();
        writer.node(node("boxes", mesh, DVec3::ZERO)).unwrap();
        let file = gltf::Gltf::from_slice(&writer.finish().unwrap()).unwrap();
        let primitive = file.meshes().next().unwrap().primitives().next().unwrap();
        assert_eq!(primitive.indices().unwrap().data_type(), gltf::accessor::DataType::U32);
        let blob = file.blob.clone().unwrap();
        let read: Vec<_> = primitive.reader(|_| Some(&blob)).read_indices().unwrap().into_u32().collect();
        assert_eq!(read, triangles.indices);
    }

    #[test]
    fn an_empty_scene_is_a_valid_file() {
        let file = gltf::Gltf::from_slice(&GlbWriter::new().finish().unwrap()).unwrap();
        assert_eq!(file.nodes().count(), 0);
    }

    #[test]
    fn broken_meshes_and_nodes_are_refused_by_name() {
        let mut writer = GlbWriter::new();
        let mut refuse = |change: fn(&mut Triangles)| {
            let mut triangles = unit_box();
            change(&mut triangles);
            writer.mesh("crate", &triangles, None).unwrap_err().to_string()
        };
        assert!(refuse(|t| t.indices.clear()).contains("`crate` has no triangle"));
        assert!(refuse(|t| t.indices[0] = 8).contains("index past"));
        assert!(refuse(|t| t.indices.truncate(4)).contains("multiple of 3"));
        assert!(refuse(|t| t.positions[0].x = f32::NAN).contains("not finite"));
        let mesh = writer.mesh("box", &unit_box(), None).unwrap();
        assert!(writer.node(node("lost", mesh, DVec3::NAN)).unwrap_err().to_string().contains("`lost`"));
    }
}
