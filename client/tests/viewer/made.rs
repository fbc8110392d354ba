//! A small scene as a file that a given one would be: two rooms with a door between them, a textured floor, a sheet of glass and a
//! grating with holes, and a thing that can be moved.

use std::io::Cursor;

/// Writes a binary glTF file; one buffer, one mesh a node.
struct Writer {
    binary: Vec<u8>,
    views: Vec<String>,
    accessors: Vec<String>,
    meshes: Vec<String>,
    nodes: Vec<String>,
}

/// Two triangles.
type Quad = [[f32; 3]; 4];

impl Writer {
    fn view(&mut self, bytes: &[u8]) -> usize {
        let start = self.binary.len();
        self.binary.extend_from_slice(bytes);
        self.binary.resize(self.binary.len().next_multiple_of(4), 0);
        self.views.push(format!(r#"{{"buffer":0,"byteOffset":{start},"byteLength":{}}}"#, bytes.len()));
        self.views.len() - 1
    }

    fn floats<const N: usize>(&mut self, shape: &str, numbers: &[[f32; N]]) -> usize {
        let bytes: Vec<u8> = numbers.iter().flatten().flat_map(|number| number.to_le_bytes()).collect();
        let view = self.view(&bytes);
        self.accessors.push(format!(
            r#"{{"bufferView":{view},"componentType":5126,"type":"{shape}","count":{}}}"#,
            numbers.len()
        ));
        self.accessors.len() - 1
    }

    /// A node of quads, whose textures repeat once a metre.
    fn node(&mut self, name: &str, material: usize, quads: &[Quad]) {
        let corners = |quad: &Quad| [0, 1, 2, 0, 2, 3].map(|corner| quad[corner]);
        let positions: Vec<_> = quads.iter().flat_map(corners).collect();
        let uvs: Vec<[f32; 2]> = positions.iter().map(|[x, y, z]| [x + y, z + y]).collect();
        let (positions, uvs) = (self.floats("VEC3", &positions), self.floats("VEC2", &uvs));
        self.meshes.push(format!(
            r#"{{"primitives":[{{"attributes":{{"POSITION":{positions},"TEXCOORD_0":{uvs}}},"material":{material}}}]}}"#
        ));
        self.nodes.push(format!(r#"{{"name":"{name}","mesh":{}}}"#, self.meshes.len() - 1));
    }
}

/// Faces of a box, anticlockwise from outside.
pub fn faces([x0, y0, z0]: [f32; 3], [x1, y1, z1]: [f32; 3]) -> Vec<Quad> {
    vec![
        [[x0, y0, z1], [x1, y0, z1], [x1, y1, z1], [x0, y1, z1]],
        [[x1, y0, z0], [x0, y0, z0], [x0, y1, z0], [x1, y1, z0]],
        [[x1, y0, z1], [x1, y0, z0], [x1, y1, z0], [x1, y1, z1]],
        [[x0, y0, z0], [x0, y0, z1], [x0, y1, z1], [x0, y1, z0]],
        [[x0, y1, z1], [x1, y1, z1], [x1, y1, z0], [x0, y1, z0]],
        [[x0, y0, z0], [x1, y0, z0], [x1, y0, z1], [x0, y0, z1]],
    ]
}

/// A PNG of squares, alternately of two colours.
fn squares(colors: [[u8; 4]; 2], side: u32) -> Vec<u8> {
    let image =
        image::RgbaImage::from_fn(side, side, |x, y| image::Rgba(colors[((x * 2 / side + y * 2 / side) % 2) as usize]));
    let mut bytes = Cursor::new(Vec::new());
    image.write_to(&mut bytes, image::ImageFormat::Png).unwrap();
    bytes.into_inner()
}

/// Where one of so many small boxes stands: its node's origin, a lower corner of it.
pub fn hidden_at(number: usize, hidden: usize) -> [f32; 3] {
    let side = (hidden as f32).cbrt().ceil().max(1.0);
    let number = number as f32;
    let [x, y, z] =
        [number % side, (number / side).floor() % side, (number / side / side).floor()].map(|at| (at + 0.25) / side);
    [2.0 + 1.5 * x, 0.1 + y, -1.8 + z]
}

/// The file. Rooms of 4 m by 4 m by 3 m lie along x from −4 to 4, with a wall at x = 0 and a door in it from z = 0 to 1. Behind the
/// wall, at x > 0 and z < −0.5, `hidden` small boxes stand in a block that nobody sees from (−3, 1.6, −1.2).
pub fn two_rooms(hidden: usize) -> Vec<u8> {
    let mut writer = Writer { binary: vec![], views: vec![], accessors: vec![], meshes: vec![], nodes: vec![] };
    let (floor, grating) =
        (squares([[200, 60, 40, 255], [240, 220, 180, 255]], 32), squares([[30, 30, 30, 255], [0; 4]], 16));
    let images = [writer.view(&floor), writer.view(&grating)];
    let wall = 0.1;
    writer.node("floor", 0, &faces([-4.0, -0.1, -2.0], [4.0, 0.0, 2.0]));
    writer.node("ceiling", 1, &faces([-4.0, 3.0, -2.0], [4.0, 3.1, 2.0]));
    for (name, [x0, z0], [x1, z1]) in [
        ("west", [-4.0 - wall, -2.0], [-4.0, 2.0]),
        ("east", [4.0, -2.0], [4.0 + wall, 2.0]),
        ("north", [-4.0, -2.0 - wall], [4.0, -2.0]),
        ("south", [-4.0, 2.0], [4.0, 2.0 + wall]),
        ("between, north", [0.0, -2.0], [wall, 0.0]),
        ("between, south", [0.0, 1.0], [wall, 2.0]),
    ] {
        writer.node(name, 1, &faces([x0, 0.0, z0], [x1, 3.0, z1]));
    }
    writer.node("lintel", 1, &faces([0.0, 2.1, 0.0], [wall, 3.0, 1.0]));
    writer.node("crate", 2, &faces([1.5, 0.0, 0.2], [2.1, 0.6, 0.8]));
    writer.node("grating", 3, &[[[-2.0, 0.0, -0.5], [-1.0, 0.0, -0.5], [-1.0, 1.0, -0.5], [-2.0, 1.0, -0.5]]]);
    writer.node("glass", 4, &[[[-1.5, 0.0, 1.3], [-0.7, 0.0, 1.3], [-0.7, 1.6, 1.3], [-1.5, 1.6, 1.3]]]);
    let side = (hidden as f32).cbrt().ceil().max(1.0);
    let half = 0.2 / side;
    for number in 0..hidden {
        if number == 0 {
            writer.node("hidden 0", 2, &faces([0.0; 3], [half; 3]));
            writer.nodes.pop();
        }
        let [x, y, z] = hidden_at(number, hidden);
        let mesh = writer.meshes.len() - 1;
        writer.nodes.push(format!(r#"{{"name":"hidden {number}","mesh":{mesh},"translation":[{x},{y},{z}]}}"#));
    }
    let materials = r#"[
        {"pbrMetallicRoughness":{"baseColorTexture":{"index":0}}},
        {"pbrMetallicRoughness":{"baseColorFactor":[0.7,0.75,0.8,1]}},
        {"pbrMetallicRoughness":{"baseColorFactor":[0.1,0.5,0.2,1]}},
        {"pbrMetallicRoughness":{"baseColorTexture":{"index":1}},"alphaMode":"MASK","doubleSided":true},
        {"pbrMetallicRoughness":{"baseColorFactor":[0.2,0.4,0.9,0.4]},"alphaMode":"BLEND","doubleSided":true}]"#;
    let roots: Vec<String> = (0..writer.nodes.len()).map(|node| node.to_string()).collect();
    let json = format!(
        r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[{}]}}],"nodes":[{}],"meshes":[{}],
        "materials":{materials},"textures":[{{"source":0}},{{"source":1,"sampler":0}}],"samplers":[{{"magFilter":9728}}],
        "images":[{{"bufferView":{},"mimeType":"image/png"}},{{"bufferView":{},"mimeType":"image/png"}}],
        "accessors":[{}],"bufferViews":[{}],"buffers":[{{"byteLength":{}}}]}}"#,
        roots.join(","),
        writer.nodes.join(","),
        writer.meshes.join(","),
        images[0],
        images[1],
        writer.accessors.join(","),
        writer.views.join(","),
        writer.binary.len(),
    );
    glb(json, writer.binary)
}

/// A body of two metres on two joints, one at its feet and one half way up: a bar of eight rings that bends. Its clips are `Idle`,
/// upright, and `Walk`, in which it bows by 60° and back in a second. It looks along +Z, where its face is, and its weights add up to
/// two.
pub fn body() -> Vec<u8> {
    body_with("")
}

/// The same with something more about its lower joint.
pub fn body_with(feet: &str) -> Vec<u8> {
    const RINGS: usize = 8;
    let mut writer = Writer { binary: vec![], views: vec![], accessors: vec![], meshes: vec![], nodes: vec![] };
    let (mut quads, mut bends) = (Vec::new(), Vec::new());
    for ring in 0..RINGS {
        let [low, high] = [ring, ring + 1].map(|at| 2.0 * at as f32 / RINGS as f32);
        quads.extend(faces([-0.2, low, -0.12], [0.2, high, 0.12]));
        if ring == RINGS - 1 {
            quads.extend(faces([-0.08, high - 0.2, 0.12], [0.08, high - 0.1, 0.24]));
        }
    }
    let corners: Vec<[f32; 3]> = quads.iter().flat_map(|quad| [0, 1, 2, 0, 2, 3].map(|corner| quad[corner])).collect();
    for [_, y, _] in &corners {
        let upper = ((y - 0.75) / 0.5).clamp(0.0, 1.0);
        bends.push([2.0 - 2.0 * upper, 2.0 * upper, 0.0, 0.0]);
    }
    let positions = writer.floats("VEC3", &corners);
    let weights = writer.floats("VEC4", &bends);
    let bytes: Vec<u8> = corners.iter().flat_map(|_| [0, 1, 0, 0]).collect();
    let view = writer.view(&bytes);
    writer
        .accessors
        .push(format!(r#"{{"bufferView":{view},"componentType":5121,"type":"VEC4","count":{}}}"#, corners.len()));
    let joints = writer.accessors.len() - 1;
    let from_mesh = |down: f32| [1., 0., 0., 0., 0., 1., 0., 0., 0., 0., 1., 0., 0., down, 0., 1.];
    let binds = writer.floats("MAT4", &[from_mesh(0.0), from_mesh(-1.0)]);
    let times = writer.floats("SCALAR", &[[0.0], [0.5], [1.0]]);
    let (sin, cos) = 30f32.to_radians().sin_cos();
    let upright = [0.0, 0.0, 0.0, 1.0];
    let still = writer.floats("VEC4", &[upright; 3]);
    let bow = writer.floats("VEC4", &[upright, [sin, 0.0, 0.0, cos], upright]);
    let clip = |name: &str, values: usize| {
        format!(
            r#"{{"name":"{name}","samplers":[{{"input":{times},"output":{values}}}],
            "channels":[{{"sampler":0,"target":{{"node":2,"path":"rotation"}}}}]}}"#
        )
    };
    let json = format!(
        r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0,1]}}],
        "nodes":[{{"name":"body","mesh":0,"skin":0}},{{"name":"feet","children":[2]{feet}}},
        {{"name":"waist","translation":[0,1,0]}}],
        "skins":[{{"joints":[1,2],"inverseBindMatrices":{binds}}}],
        "meshes":[{{"primitives":[{{"material":0,
        "attributes":{{"POSITION":{positions},"JOINTS_0":{joints},"WEIGHTS_0":{weights}}}}}]}}],
        "materials":[{{"pbrMetallicRoughness":{{"baseColorFactor":[0.8,0.5,0.1,1]}}}}],
        "animations":[{},{}],"accessors":[{}],"bufferViews":[{}],"buffers":[{{"byteLength":{}}}]}}"#,
        clip("Idle", still),
        clip("Walk", bow),
        writer.accessors.join(","),
        writer.views.join(","),
        writer.binary.len(),
    );
    glb(json, writer.binary)
}

/// A binary file of a description and what it describes.
fn glb(json: String, binary: Vec<u8>) -> Vec<u8> {
    let mut json = json.into_bytes();
    json.resize(json.len().next_multiple_of(4), b' ');
    let mut glb = b"glTF\x02\0\0\0".to_vec();
    glb.extend((28 + json.len() as u32 + binary.len() as u32).to_le_bytes());
    glb.extend((json.len() as u32).to_le_bytes());
    glb.extend(b"JSON");
    glb.extend(json);
    glb.extend((binary.len() as u32).to_le_bytes());
    glb.extend(b"BIN\0");
    glb.extend(binary);
    glb
}
