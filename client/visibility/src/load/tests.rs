use std::path::PathBuf;

use serde_json::{Value, json};

use super::*;

/// Writes small files: a buffer with a view and an accessor per array, and a description to change at will.
pub(super) struct Glb {
    pub(super) json: Value,
    pub(super) bin: Vec<u8>,
}

impl Glb {
    /// Nothing but the version.
    fn new() -> Glb {
        Glb {
            json: json!({"asset": {"version": "2.0"}, "accessors": [], "bufferViews": [], "meshes": [], "nodes": [],
                         "scenes": [{"nodes": []}], "scene": 0, "buffers": [{"byteLength": 0}]}),
            bin: Vec::new(),
        }
    }

    /// One node with one triangle, (0,0,0) (1,0,0) (0,1,0), anticlockwise from +Z.
    pub(super) fn triangle() -> Glb {
        let mut glb = Glb::new();
        let positions = glb.positions(&TRIANGLE);
        let mesh = glb.mesh(json!([{"attributes": {"POSITION": positions}}]));
        glb.root(json!({"name": "t", "mesh": mesh}));
        glb
    }

    pub(super) fn push(&mut self, list: &str, value: Value) -> usize {
        let list = self.json[list].as_array_mut().unwrap();
        list.push(value);
        list.len() - 1
    }

    pub(super) fn view(&mut self, bytes: &[u8]) -> usize {
        let offset = self.bin.len();
        self.bin.extend_from_slice(bytes);
        self.bin.resize(self.bin.len().next_multiple_of(4), 0);
        self.push("bufferViews", json!({"buffer": 0, "byteOffset": offset, "byteLength": bytes.len()}))
    }

    pub(super) fn positions(&mut self, positions: &[[f32; 3]]) -> usize {
        let bytes: Vec<u8> = positions.iter().flatten().flat_map(|x| x.to_le_bytes()).collect();
        let view = self.view(&bytes);
        self.push(
            "accessors",
            json!({"bufferView": view, "componentType": 5126, "type": "VEC3", "count": positions.len()}),
        )
    }

    fn scalars(&mut self, bytes: &[u8], component: u32, count: usize) -> usize {
        let view = self.view(bytes);
        self.push(
            "accessors",
            json!({"bufferView": view, "componentType": component, "type": "SCALAR", "count": count}),
        )
    }

    pub(super) fn mesh(&mut self, primitives: Value) -> usize {
        self.push("meshes", json!({"primitives": primitives}))
    }

    fn node(&mut self, node: Value) -> usize {
        self.push("nodes", node)
    }

    pub(super) fn root(&mut self, node: Value) -> usize {
        let node = self.node(node);
        self.json["scenes"][0]["nodes"].as_array_mut().unwrap().push(json!(node));
        node
    }

    pub(super) fn bytes(&self) -> Vec<u8> {
        let mut description = self.json.clone();
        if description["buffers"][0]["byteLength"] == 0 {
            description["buffers"][0]["byteLength"] = json!(self.bin.len());
        }
        let mut text = description.to_string().into_bytes();
        text.resize(text.len().next_multiple_of(4), b' ');
        let mut out = b"glTF".to_vec();
        out.extend(2u32.to_le_bytes());
        out.extend((12 + 8 + text.len() as u32 + 8 + self.bin.len() as u32).to_le_bytes());
        out.extend((text.len() as u32).to_le_bytes());
        out.extend(b"JSON");
        out.extend(text);
        out.extend((self.bin.len() as u32).to_le_bytes());
        out.extend(b"BIN\0");
        out.extend(&self.bin);
        out
    }

    fn load(&self) -> Result<(Scene, LoadStats), LoadError> {
        self.load_with(&LoadOptions::default())
    }

    fn load_with(&self, options: &LoadOptions) -> Result<(Scene, LoadStats), LoadError> {
        load_glb_with_stats(&self.bytes(), "test.glb", options)
    }

    #[track_caller]
    fn refused(&self, words: &[&str]) {
        let message = self.load().expect_err("must be refused").to_string();
        for word in words.iter().chain(&["test.glb"]) {
            assert!(message.contains(word), "{message:?} does not say {word:?}");
        }
    }
}

const TRIANGLE: [[f32; 3]; 3] = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
const SQUARE: [[f32; 3]; 4] = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 1.0, 0.0]];

fn normal(triangle: &Triangle) -> DVec3 {
    let [a, b, c] = triangle.corners.map(|corner| corner.as_dvec3());
    (b - a).cross(c - a)
}

#[test]
fn lone_triangle_is_two_sided_opaque_and_where_it_was() {
    let (scene, stats) = Glb::triangle().load().unwrap();
    let expected = Triangle { corners: TRIANGLE.map(Vec3::from), sides: Sides::Both, occludes: true };
    assert_eq!(scene.triangles(), [expected]);
    assert_eq!(scene.nodes(), [Node { name: "t".into(), primitives: 0..1 }]);
    assert_eq!(scene.anchor(), DVec3::ZERO);
    assert_eq!(stats, LoadStats { nodes: 1, meshes: 1, ..LoadStats::default() });
}

#[test]
fn every_index_type_and_mode_gives_the_same_square() {
    let wide16: Vec<u8> = [0u16, 1, 2, 2, 1, 3].iter().flat_map(|i| i.to_le_bytes()).collect();
    let wide32: Vec<u8> = [0u32, 1, 2, 2, 1, 3].iter().flat_map(|i| i.to_le_bytes()).collect();
    let ways: [(u32, &[u8], u32, usize); 5] = [
        (4, &[0, 1, 2, 2, 1, 3], 5121, 6),
        (4, &wide16, 5123, 6),
        (4, &wide32, 5125, 6),
        (5, &[0, 1, 2, 3], 5121, 4),
        (6, &[0, 1, 3, 2], 5121, 4),
    ];
    for (mode, bytes, component, count) in ways {
        let mut glb = Glb::new();
        let positions = glb.positions(&SQUARE);
        let indices = glb.scalars(bytes, component, count);
        let mesh = glb.mesh(json!([{"attributes": {"POSITION": positions}, "indices": indices, "mode": mode}]));
        glb.root(json!({"mesh": mesh}));
        let (scene, _) = glb.load().unwrap();
        assert_eq!(scene.triangles().len(), 2, "mode {mode}");
        for triangle in scene.triangles() {
            assert_eq!(normal(triangle), DVec3::Z, "mode {mode}: {triangle:?}");
        }
    }
}

#[test]
fn strip_without_indices_turns_every_other_triangle() {
    let mut glb = Glb::new();
    let positions = glb.positions(&SQUARE);
    let mesh = glb.mesh(json!([{"attributes": {"POSITION": positions}, "mode": 5}]));
    glb.root(json!({"mesh": mesh}));
    let (scene, _) = glb.load().unwrap();
    assert!(scene.triangles().iter().all(|triangle| normal(triangle) == DVec3::Z));
}

#[test]
fn points_lines_and_primitives_without_positions_are_counted() {
    let mut glb = Glb::new();
    let positions = glb.positions(&TRIANGLE);
    let attributes = json!({"POSITION": positions});
    let mesh = glb.mesh(json!([
        {"attributes": attributes, "mode": 0}, {"attributes": attributes, "mode": 1},
        {"attributes": attributes, "mode": 2}, {"attributes": attributes, "mode": 3}, {"attributes": {}}
    ]));
    glb.root(json!({"mesh": mesh}));
    let (scene, stats) = glb.load().unwrap();
    assert!(scene.triangles().is_empty() && scene.nodes().is_empty());
    assert_eq!(stats.ignored_primitives, 5);
}

#[test]
fn sparse_values_replace_the_base_or_zeros() {
    for with_base in [true, false] {
        let mut glb = Glb::new();
        let base = glb.positions(&[[0.0; 3], [1.0, 0.0, 0.0], [0.0; 3]]);
        let indices = glb.view(&[0, 2]);
        let values: Vec<u8> = [7f32, 8.0, 9.0, 0.0, 1.0, 0.0].iter().flat_map(|x| x.to_le_bytes()).collect();
        let values = glb.view(&values);
        let accessor = &mut glb.json["accessors"][base];
        accessor["sparse"] = json!({"count": 2, "indices": {"bufferView": indices, "componentType": 5121},
                                    "values": {"bufferView": values}});
        if !with_base {
            accessor.as_object_mut().unwrap().remove("bufferView");
        }
        let mesh = glb.mesh(json!([{"attributes": {"POSITION": base}}]));
        glb.root(json!({"mesh": mesh}));
        let (scene, _) = glb.load().unwrap();
        let middle = if with_base { Vec3::X } else { Vec3::ZERO };
        assert_eq!(scene.triangles()[0].corners, [Vec3::new(7.0, 8.0, 9.0), middle, Vec3::Y]);

        let start = glb.json["bufferViews"][indices]["byteOffset"].as_u64().unwrap() as usize;
        glb.bin[start] = 2;
        glb.refused(&["accessor 0", "sort"]);
        glb.bin[start + 1] = 9;
        glb.refused(&["accessor 0", "sparse index 1 is 9"]);
    }
}

#[test]
fn transforms_nest_and_a_mirror_keeps_the_front() {
    let mut glb = Glb::triangle();
    glb.json["materials"] = json!([{}]);
    glb.json["meshes"][0]["primitives"][0]["material"] = json!(0);
    let child = glb.node(json!({"mesh": 0, "translation": [1, 0, 0]}));
    let quarter = std::f64::consts::FRAC_1_SQRT_2;
    // A rotation that is not of unit length is meant as the one of unit length.
    glb.root(json!({"children": [child], "rotation": [0, quarter * 2.0, 0, quarter * 2.0], "scale": [2, 2, 2]}));
    glb.root(json!({"mesh": 0, "scale": [-1, 1, 1]}));
    glb.root(json!({"mesh": 0, "matrix": [1,0,0,0, 0,1,0,0, 0,0,-1,0, 5,6,7,1]}));
    let (scene, _) = glb.load().unwrap();
    let [_, nested, mirrored, flipped] = scene.triangles() else { panic!("four triangles") };
    // +Y turns X to −Z and +Z to X; the child's own X comes before the scale.
    assert!(nested.corners[0].abs_diff_eq(Vec3::new(0.0, 0.0, -2.0), 1e-5));
    assert!(normal(nested).normalize().abs_diff_eq(DVec3::X, 1e-6));
    // Mirrored in x the front still faces +Z; mirrored in z it faces −Z.
    assert_eq!(normal(mirrored), DVec3::Z);
    assert_eq!(normal(flipped), DVec3::NEG_Z);
    assert_eq!(flipped.corners[0], Vec3::new(5.0, 6.0, 7.0));
    assert!(scene.triangles().iter().all(|triangle| triangle.sides == Sides::Front));
}

#[test]
fn materials_say_sides_and_whether_they_occlude() {
    let mut glb = Glb::triangle();
    glb.json["extensionsUsed"] = json!(["KHR_materials_transmission"]);
    glb.json["materials"] = json!([
        {}, {"doubleSided": true}, {"alphaMode": "MASK"}, {"alphaMode": "BLEND", "doubleSided": true},
        {"extensions": {"KHR_materials_transmission": {"transmissionFactor": 0.9}}}
    ]);
    for material in 0..5 {
        let mesh = glb.mesh(json!([{"attributes": {"POSITION": 0}, "material": material}]));
        glb.root(json!({"mesh": mesh}));
    }
    let found = |options: &LoadOptions| -> Vec<_> {
        glb.load_with(options).unwrap().0.triangles().iter().map(|t| (t.sides, t.occludes)).collect()
    };
    use Sides::{Both, Front};
    let expected = [(Both, true), (Front, true), (Both, true), (Front, false), (Both, false), (Front, false)];
    assert_eq!(found(&LoadOptions::default()), expected);
    let two_sided = found(&LoadOptions::default().with_two_sided(true));
    assert_eq!(two_sided, expected.map(|(_, occludes)| (Both, occludes)));
}

#[test]
fn moving_node_takes_its_subtree_out_of_the_scene() {
    let mut glb = Glb::triangle();
    let knob = glb.node(json!({"name": "knob", "mesh": 0, "translation": [0, 0, 1]}));
    let handle = glb.node(json!({"name": "handle", "mesh": 0, "translation": [0, 1, 0], "children": [knob]}));
    glb.root(json!({"name": "door", "mesh": 0, "translation": [10, 0, 0], "children": [handle],
                    "extras": {"eyeline": {"speed": 2}, "other": 1}}));
    let (scene, stats) = glb.load_with(&LoadOptions::default().with_moving_nodes(["door", "knob"])).unwrap();
    assert_eq!(scene.triangles().len(), 1);
    assert_eq!(stats.extras, [("door".to_owned(), json!({"speed": 2}))]);
    let [door, knob] = scene.objects() else { panic!("two objects") };
    assert_eq!((door.name.as_str(), door.origin, door.triangles.len()), ("door", DVec3::new(10.0, 0.0, 0.0), 2));
    assert_eq!(door.triangles[1].corners[0], Vec3::Y);
    assert_eq!((knob.name.as_str(), knob.origin, knob.triangles.len()), ("knob", DVec3::new(10.0, 1.0, 1.0), 1));
    assert_eq!(knob.triangles[0].corners[0], Vec3::ZERO);

    let error = glb.load_with(&LoadOptions::default().with_moving_nodes(["Door"])).unwrap_err();
    assert!(error.to_string().contains("no node named \"Door\""), "{error}");
}

#[test]
fn far_world_is_relative_to_a_whole_anchor() {
    let mut glb = Glb::triangle();
    glb.json["nodes"][0]["translation"] = json!([0.125, 0, 0]);
    let far = glb.node(json!({"children": [0], "translation": [4_000_000, 0, 0]}));
    glb.json["scenes"][0]["nodes"] = json!([far]);
    let (scene, _) = glb.load().unwrap();
    assert_eq!(scene.anchor(), DVec3::new(4_000_001.0, 1.0, 0.0).round());
    assert_eq!(scene.triangles()[0].corners[0].as_dvec3() + scene.anchor(), DVec3::new(4_000_000.125, 0.0, 0.0));

    glb.root(json!({"mesh": 0, "translation": [1_900_000, 0, 0]}));
    glb.refused(&["2100 km wide", "2000 km"]);
}

#[test]
fn infinite_products_are_refused() {
    let mut glb = Glb::triangle();
    glb.json["nodes"][0]["scale"] = json!([3e38, 3e38, 3e38]);
    let mut top = 0;
    for _ in 0..6 {
        top = glb.node(json!({"children": [top], "scale": [3e38, 3e38, 3e38]}));
    }
    glb.json["scenes"][0]["nodes"] = json!([top]);
    glb.refused(&["km wide"]);
    for _ in 0..6 {
        top = glb.node(json!({"children": [top], "scale": [3e38, 3e38, 3e38]}));
    }
    glb.json["scenes"][0]["nodes"] = json!([top]);
    glb.refused(&["must be finite"]);
}

#[test]
fn all_scenes_are_loaded_if_none_is_the_default() {
    let mut glb = Glb::triangle();
    glb.node(json!({"mesh": 0}));
    glb.push("scenes", json!({"nodes": [0, 1]}));
    assert_eq!(glb.load().unwrap().0.triangles().len(), 1);
    glb.json.as_object_mut().unwrap().remove("scene");
    assert_eq!(glb.load().unwrap().0.triangles().len(), 2);
}

#[test]
fn zero_area_skins_and_morphs_are_counted() {
    let mut glb = Glb::new();
    let positions = glb.positions(&[[1.0; 3], [1.0; 3], [2.0; 3]]);
    let mesh = glb.mesh(json!([{"attributes": {"POSITION": positions}, "targets": [{"POSITION": positions}]}]));
    glb.root(json!({"mesh": mesh, "skin": 0}));
    let (scene, stats) = glb.load().unwrap();
    assert_eq!((scene.triangles().len(), stats.zero_area, stats.skinned, stats.morphed), (1, 1, 1, 1));
}

#[test]
fn quantised_positions_are_read() {
    let mut glb = Glb::triangle();
    glb.json["extensionsRequired"] = json!(["KHR_mesh_quantization"]);
    let bytes: Vec<u8> = [0i16, 0, 0, 32767, 0, 0, 0, -32768, 0].iter().flat_map(|x| x.to_le_bytes()).collect();
    let view = glb.view(&bytes);
    glb.json["accessors"][0] =
        json!({"bufferView": view, "componentType": 5122, "type": "VEC3", "count": 3, "normalized": true});
    assert_eq!(glb.load().unwrap().0.triangles()[0].corners, [Vec3::ZERO, Vec3::X, Vec3::NEG_Y]);
}

#[test]
fn hostile_accessors_are_refused() {
    type Change = fn(&mut Value);
    let cases: [(Change, &[&str]); 14] = [
        (|j| j["accessors"][0]["count"] = json!(1u64 << 31), &["accessor 0", "2147483648 elements"]),
        (|j| j["accessors"][0]["count"] = json!(u64::MAX), &["accessor 0", "18446744073709551615"]),
        (|j| j["accessors"][0]["byteOffset"] = json!(u64::MAX), &["accessor 0", "from byte 18446744073709551615"]),
        (|j| j["accessors"][0]["type"] = json!("VEC2"), &["accessor 0", "Vec2"]),
        (|j| j["accessors"][0]["type"] = json!("VEC9"), &["accessor 0", "unknown"]),
        (|j| j["accessors"][0]["componentType"] = json!(5125), &["accessor 0", "u32"]),
        (|j| j["accessors"][0]["bufferView"] = json!(7), &["accessor 0", "buffer view 7", "there are 1"]),
        (|j| j["accessors"][0].as_object_mut().unwrap().remove("bufferView").map_or((), drop), &["accessor 0"]),
        (|j| j["bufferViews"][0]["byteLength"] = json!(1000), &["buffer view 0 is 1000 bytes", "has 36"]),
        (|j| j["bufferViews"][0]["byteOffset"] = json!(u64::MAX), &["buffer view 0"]),
        (|j| j["bufferViews"][0]["byteStride"] = json!(0), &["stride of 0"]),
        (|j| j["bufferViews"][0]["buffer"] = json!(3), &["buffer 3", "there are 1"]),
        (|j| j["buffers"][0]["byteLength"] = json!(1u64 << 40), &["buffer 0", "1099511627776"]),
        (|j| j["buffers"][0]["uri"] = json!("beside.bin"), &["buffer 0", "load this one by path"]),
    ];
    for (change, words) in cases {
        let mut glb = Glb::triangle();
        change(&mut glb.json);
        glb.refused(words);
    }
}

#[test]
fn zeros_without_data_are_not_stored_to_be_counted() {
    let mut glb = Glb::triangle();
    let indices = glb.view(&[0]);
    glb.json["accessors"][0] = json!({"componentType": 5126, "type": "VEC3", "count": 1u64 << 31, "sparse": {
        "count": 1, "indices": {"bufferView": indices, "componentType": 5121}, "values": {"bufferView": 0}}});
    glb.refused(&["715827882 triangles", "16777216"]);
}

#[test]
fn instances_count_against_the_limit() {
    let mut glb = Glb::triangle();
    for _ in 0..10 {
        glb.root(json!({"mesh": 0}));
    }
    assert_eq!(glb.load().unwrap().0.triangles().len(), 11);
    let error = glb.load_with(&LoadOptions::default().with_triangles_max(10)).unwrap_err();
    assert!(error.to_string().contains("11 triangles or more, but at most 10"), "{error}");
}

#[test]
fn bad_numbers_are_refused() {
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        let mut glb = Glb::triangle();
        glb.bin[16..20].copy_from_slice(&bad.to_le_bytes());
        glb.refused(&["mesh 0", "primitive 0", "position 1"]);
    }
    let mut glb = Glb::triangle();
    glb.json["nodes"][0]["translation"] = json!([1e39, 0, 0]);
    glb.refused(&["node 0", "\"t\"", "finite"]);
    let mut glb = Glb::triangle();
    glb.json["nodes"][0]["rotation"] = json!([0, 0, 0, 0]);
    glb.refused(&["node 0", "rotation"]);
    let mut glb = Glb::triangle();
    glb.json["nodes"][0]["matrix"] = json!([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 2]);
    glb.refused(&["node 0", "bottom row"]);
}

#[test]
fn bad_references_are_refused() {
    let mut glb = Glb::triangle();
    let indices = glb.scalars(&[0, 1, 3], 5121, 3);
    glb.json["meshes"][0]["primitives"][0]["indices"] = json!(indices);
    glb.refused(&["mesh 0", "index 3", "3 positions"]);
    let mut glb = Glb::triangle();
    glb.json["meshes"][0]["primitives"][0]["indices"] = json!(99);
    glb.refused(&["mesh 0, primitive 0", "accessor 99"]);
    let mut glb = Glb::triangle();
    glb.json["meshes"][0]["primitives"][0]["material"] = json!(4);
    glb.refused(&["material 4"]);
    let mut glb = Glb::triangle();
    glb.json["meshes"][0]["primitives"][0]["mode"] = json!(9);
    glb.refused(&["mesh 0", "mode"]);
    let mut glb = Glb::triangle();
    glb.json["nodes"][0]["mesh"] = json!(5);
    glb.refused(&["node 0", "mesh 5"]);
    let mut glb = Glb::triangle();
    glb.json["nodes"][0]["children"] = json!([8]);
    glb.refused(&["node 0", "node 8"]);
    let mut glb = Glb::triangle();
    glb.json["scenes"][0]["nodes"] = json!([8]);
    glb.refused(&["scene 0", "node 8"]);
    let mut glb = Glb::triangle();
    glb.json["scene"] = json!(8);
    glb.refused(&["scene 8"]);
    let mut glb = Glb::triangle();
    glb.json["extensionsRequired"] = json!(["KHR_draco_mesh_compression"]);
    glb.refused(&["KHR_draco_mesh_compression", "export it without"]);
}

#[test]
fn broken_node_trees_are_refused() {
    let mut glb = Glb::triangle();
    glb.json["nodes"][0]["children"] = json!([0]);
    glb.refused(&["node 0", "own ancestor"]);
    let mut glb = Glb::triangle();
    glb.node(json!({"children": [2]}));
    glb.node(json!({"children": [1]}));
    glb.refused(&["own ancestor"]);
    let mut glb = Glb::triangle();
    let child = glb.node(json!({}));
    glb.root(json!({"children": [child]}));
    glb.root(json!({"children": [child]}));
    glb.refused(&["child of both"]);
    let mut glb = Glb::triangle();
    glb.root(json!({"children": [0]}));
    glb.refused(&["root of scene 0", "child of node 1"]);

    let mut glb = Glb::new();
    glb.json["nodes"] = (1..=100_000).map(|child| json!({"children": [child]})).chain([json!({})]).collect();
    glb.json["scenes"][0]["nodes"] = json!([0]);
    glb.refused(&["node 1025", "deep"]);
}

#[test]
fn truncated_and_foreign_files_are_refused() {
    let bytes = Glb::triangle().bytes();
    for length in 0..bytes.len() {
        load_glb(&bytes[..length], "cut", &LoadOptions::default()).expect_err("a prefix");
    }
    // What follows the claimed length is not the file's.
    let trailing = [&bytes[..], b"more"].concat();
    load_glb(&trailing, "long", &LoadOptions::default()).expect("complete");
    let error = load_glb(b"\x89PNG\r\n\x1a\n....", "a.png", &LoadOptions::default()).unwrap_err();
    assert!(matches!(error, LoadError::NotGltf { .. }), "{error}");
}

#[test]
fn changed_bytes_never_panic() {
    let mut glb = Glb::triangle();
    let sparse = glb.view(&[1]);
    glb.json["accessors"][0]["sparse"] = json!({"count": 1, "indices": {"bufferView": sparse, "componentType": 5121},
                                                "values": {"bufferView": 0}});
    let indices = glb.scalars(&[0, 1, 2], 5121, 3);
    glb.json["meshes"][0]["primitives"][0]["indices"] = json!(indices);
    let child = glb.node(json!({"mesh": 0, "rotation": [0, 0, 0, 1], "scale": [1, 2, 3]}));
    glb.root(json!({"children": [child]}));
    let mut bytes = glb.bytes();
    load_glb(&bytes, "whole", &LoadOptions::default()).unwrap();
    let options = LoadOptions::default().with_triangles_max(1_000);
    for at in 0..bytes.len() {
        let before = bytes[at];
        let flips = (0..8).map(|bit| before ^ 1 << bit);
        for changed in flips.chain([!before, 0, 255, b'9', b'-', b'e', b'"', b'}']) {
            bytes[at] = changed;
            let _ = load_glb(&bytes, "changed", &options);
        }
        bytes[at] = before;
    }
}

#[test]
fn gltf_reads_buffers_in_it_or_in_its_folder_only() {
    let folder = tempfile::tempdir().unwrap();
    let inside = folder.path().join("world");
    fs::create_dir(&inside).unwrap();
    let glb = Glb::triangle();
    let write = |uri: &str| {
        let mut description = glb.json.clone();
        description["buffers"][0] = json!({"byteLength": 36, "uri": uri});
        let path = inside.join("world.gltf");
        fs::write(&path, description.to_string()).unwrap();
        load_file(&path, &LoadOptions::default())
    };
    fs::write(inside.join("a buffer.bin"), &glb.bin).unwrap();
    fs::write(folder.path().join("outside.bin"), &glb.bin).unwrap();
    let mut text = String::new();
    for three in glb.bin.chunks(3) {
        let bits = u32::from_be_bytes([0, three[0], three[1], three[2]]);
        let digits = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
        text.extend((0..4).map(|i| digits[(bits >> (18 - 6 * i) & 63) as usize] as char));
    }
    let expected = glb.load().unwrap().0;
    for uri in ["a%20buffer.bin", "a buffer.bin", &format!("data:application/octet-stream;base64,{text}")] {
        assert_eq!(write(uri).unwrap().triangles(), expected.triangles(), "{uri}");
    }
    let absolute = folder.path().join("outside.bin").display().to_string();
    for uri in ["../outside.bin", "%2e%2e/outside.bin", "..%5coutside.bin", "", ".", &absolute, "file:///etc/passwd"] {
        let error = write(uri).unwrap_err().to_string();
        assert!(error.contains("buffer 0"), "{error}");
    }
    for uri in ["absent.bin", "data:;base64,????", "data:text/plain,abc", "data:;base64,AAAA"] {
        let error = write(uri).unwrap_err().to_string();
        assert!(error.contains("buffer 0"), "{error}");
    }
    #[cfg(unix)]
    {
        std::os::unix::fs::symlink(folder.path().join("outside.bin"), inside.join("link.bin")).unwrap();
        let error = write("link.bin").unwrap_err().to_string();
        assert!(error.contains("folder"), "{error}");
    }
    let error = load_file(inside.join("none.glb"), &LoadOptions::default()).unwrap_err().to_string();
    assert!(error.contains("none.glb"), "{error}");
}

#[test]
fn real_files_have_their_known_numbers_of_triangles() {
    let beside = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/data");
    let data = std::env::var_os("EYELINE_DATA").map_or_else(|| PathBuf::from(beside), PathBuf::from);
    let folder = data.join("scenes");
    if !folder.is_dir() {
        eprintln!("skipped: no {}; set EYELINE_DATA to the folder that holds `scenes`", folder.display());
        return;
    }
    let known = [
        ("oa_dm2.glb", 11_900, 50),
        ("oa_koth1.glb", 11_500, 50),
        ("ctf_compromise.glb", 21_900, 50),
        ("large_building.glb", 35_500, 50),
        ("sponza.glb", 262_000, 500),
        ("Fox.glb", 576, 0),
        ("HubsDefaultAvatar.glb", 184, 0),
    ];
    for (name, expected, tolerance) in known {
        let (scene, stats) = load_file_with_stats(folder.join(name), &LoadOptions::default()).unwrap();
        let triangles = scene.triangles().len();
        eprintln!("{name}: {triangles} triangles, {:?}, {stats:?}", scene.bounds());
        assert!(triangles.abs_diff(expected) <= tolerance, "{name}: {triangles} triangles, about {expected} expected");
    }
}
