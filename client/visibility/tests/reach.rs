//! No pose takes a moving mesh beyond its reach: poses are made here by a skinning of our own, which shares no code with
//! the loader, from real rigs (`EYELINE_DATA`, else `shared/data` beside the workspace) and from made ones.

use std::path::{Path, PathBuf};

use eyeline_visibility::{LoadError, LoadOptions, ObjectMesh, load_glb};
use glam::{DMat4, DQuat, DVec3, Mat4};
use gltf::animation::{Interpolation, util::ReadOutputs};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use serde_json::{Value, json};

// ---- poses ----

/// A node's transform, and the weights of its morph targets.
#[derive(Clone)]
struct Local {
    matrix: Option<DMat4>,
    translation: DVec3,
    rotation: DQuat,
    scale: DVec3,
    weights: Vec<f64>,
}

impl Local {
    fn matrix(&self) -> DMat4 {
        self.matrix.unwrap_or(DMat4::from_scale_rotation_translation(self.scale, self.rotation, self.translation))
    }

    fn mixed(&self, other: &Local, share: f64) -> Local {
        Local {
            matrix: self.matrix,
            translation: self.translation.lerp(other.translation, share),
            rotation: self.rotation.slerp(other.rotation, share),
            scale: self.scale.lerp(other.scale, share),
            weights: self.weights.iter().zip(&other.weights).map(|(a, b)| a + share * (b - a)).collect(),
        }
    }
}

struct File {
    document: gltf::Gltf,
    blob: Vec<u8>,
}

impl File {
    fn new(bytes: &[u8]) -> File {
        let mut document = gltf::Gltf::from_slice_without_validation(bytes).unwrap();
        let blob = document.blob.take().unwrap_or_default();
        File { document, blob }
    }

    fn rest(&self) -> Vec<Local> {
        let locals = self.document.nodes().map(|node| {
            let targets =
                node.mesh().map_or(0, |mesh| mesh.primitives().map(|p| p.morph_targets().count()).max().unwrap());
            let weights = node.weights().or(node.mesh().and_then(|mesh| mesh.weights())).map(<[f32]>::to_vec);
            let weights = weights.unwrap_or(vec![0.0; targets]).into_iter().map(f64::from).collect();
            let matrix = match node.transform() {
                gltf::scene::Transform::Matrix { matrix } => Some(Mat4::from_cols_array_2d(&matrix).as_dmat4()),
                gltf::scene::Transform::Decomposed { .. } => None,
            };
            let (translation, rotation, scale) = node.transform().decomposed();
            Local {
                matrix,
                translation: DVec3::from(translation.map(f64::from)),
                rotation: DQuat::from_array(rotation.map(f64::from)).normalize(),
                scale: DVec3::from(scale.map(f64::from)),
                weights,
            }
        });
        locals.collect()
    }

    /// The pose at a time of an animation.
    fn pose(&self, animation: usize, share: f64) -> Vec<Local> {
        let mut pose = self.rest();
        for channel in self.document.animations().nth(animation).unwrap().channels() {
            let reader = channel.reader(|_| Some(&self.blob));
            let times: Vec<f64> = reader.read_inputs().unwrap().map(f64::from).collect();
            let (first, last) = (times[0], times[times.len() - 1]);
            let clock =
                Clock::new(&times, first - 0.1 + share * (last - first + 0.2), channel.sampler().interpolation());
            let node = &mut pose[channel.target().node().index()];
            match reader.read_outputs().unwrap() {
                ReadOutputs::Translations(values) => {
                    let values: Vec<Vec<f64>> = values.map(|value| value.map(f64::from).to_vec()).collect();
                    node.translation = DVec3::from_slice(&clock.value(&values));
                }
                ReadOutputs::Scales(values) => {
                    let values: Vec<Vec<f64>> = values.map(|value| value.map(f64::from).to_vec()).collect();
                    node.scale = DVec3::from_slice(&clock.value(&values));
                }
                ReadOutputs::Rotations(values) => {
                    let values: Vec<Vec<f64>> = values.into_f32().map(|value| value.map(f64::from).to_vec()).collect();
                    node.rotation = clock.rotation(&values);
                }
                ReadOutputs::MorphTargetWeights(values) => {
                    let flat: Vec<f64> = values.into_f32().map(f64::from).collect();
                    let values: Vec<Vec<f64>> = flat.chunks(node.weights.len()).map(<[f64]>::to_vec).collect();
                    node.weights = clock.value(&values);
                }
            }
        }
        pose
    }

    /// Every vertex of what stands at `top` and below, in the file's space.
    fn vertices(&self, top: usize, pose: &[Local]) -> Vec<DVec3> {
        let mut globals = vec![DMat4::IDENTITY; pose.len()];
        let mut stack: Vec<(gltf::Node, DMat4)> =
            self.document.scenes().next().unwrap().nodes().map(|node| (node, DMat4::IDENTITY)).collect();
        let mut below = vec![false; pose.len()];
        while let Some((node, parent)) = stack.pop() {
            globals[node.index()] = parent * pose[node.index()].matrix();
            below[node.index()] |= node.index() == top;
            for child in node.children() {
                below[child.index()] = below[node.index()];
                stack.push((child, globals[node.index()]));
            }
        }
        let mut vertices = Vec::new();
        for node in self.document.nodes().filter(|node| below[node.index()]) {
            for primitive in node.mesh().iter().flat_map(|mesh| mesh.primitives()) {
                let reader = primitive.reader(|_| Some(&self.blob));
                let mut positions: Vec<DVec3> =
                    reader.read_positions().unwrap().map(|p| DVec3::from(p.map(f64::from))).collect();
                for ((moves, ..), weight) in reader.read_morph_targets().zip(&pose[node.index()].weights) {
                    for (position, by) in positions.iter_mut().zip(moves.into_iter().flatten()) {
                        *position += weight * DVec3::from(by.map(f64::from));
                    }
                }
                let Some(skin) = node.skin() else {
                    vertices.extend(positions.iter().map(|&p| globals[node.index()].transform_point3(p)));
                    continue;
                };
                let binds: Vec<DMat4> = skin
                    .reader(|_| Some(&self.blob))
                    .read_inverse_bind_matrices()
                    .unwrap()
                    .map(|bind| Mat4::from_cols_array_2d(&bind).as_dmat4())
                    .collect();
                let joints: Vec<DMat4> =
                    skin.joints().zip(binds).map(|(joint, bind)| globals[joint.index()] * bind).collect();
                let influences =
                    reader.read_joints(0).unwrap().into_u16().zip(reader.read_weights(0).unwrap().into_f32());
                for (&position, (indices, weights)) in positions.iter().zip(influences) {
                    let sum: f32 = weights.iter().sum();
                    let at = indices.iter().zip(weights).fold(DVec3::ZERO, |at, (&joint, weight)| {
                        at + joints[usize::from(joint)].transform_point3(position) * f64::from(weight / sum)
                    });
                    vertices.push(at);
                }
            }
        }
        vertices
    }

    /// Greatest distance from `origin` in many poses: of each animation, and of mixtures of two.
    fn farthest(&self, top: usize, origin: DVec3, poses: usize, rng: &mut Pcg64) -> f64 {
        let animations = self.document.animations().count();
        let any = |rng: &mut Pcg64| match animations {
            0 => self.rest(),
            _ => self.pose(rng.random_range(0..animations), rng.random()),
        };
        let mut farthest = 0.0f64;
        for i in 0..poses {
            let mut pose = any(rng);
            if i % 2 == 1 {
                let (other, share) = (any(rng), rng.random());
                pose = pose.iter().zip(&other).map(|(a, b)| a.mixed(b, share)).collect();
            }
            farthest = self.vertices(top, &pose).iter().map(|at| at.distance(origin)).fold(farthest, f64::max);
        }
        farthest
    }
}

/// A place between keyframes.
struct Clock {
    key: usize,
    /// From one to the next, 0 to 1.
    share: f64,
    step: f64,
    count: usize,
    interpolation: Interpolation,
}

impl Clock {
    fn new(times: &[f64], time: f64, interpolation: Interpolation) -> Clock {
        let time = time.clamp(times[0], times[times.len() - 1]);
        let key = times.partition_point(|&t| t <= time).clamp(1, times.len().max(2) - 1) - 1;
        let next = times[(key + 1).min(times.len() - 1)];
        let step = next - times[key];
        let share = if step > 0.0 { (time - times[key]) / step } else { 0.0 };
        Clock { key, share, step, count: times.len(), interpolation }
    }

    fn value(&self, values: &[Vec<f64>]) -> Vec<f64> {
        let next = (self.key + 1).min(self.count - 1);
        let t = self.share;
        let each = |f: &dyn Fn(usize) -> f64| (0..values[0].len()).map(f).collect();
        match self.interpolation {
            Interpolation::Step => values[if t < 1.0 { self.key } else { next }].clone(),
            Interpolation::Linear => each(&|i| values[self.key][i] + t * (values[next][i] - values[self.key][i])),
            Interpolation::CubicSpline => {
                let (t2, t3) = (t * t, t * t * t);
                each(&|i| {
                    let (a, out) = (values[3 * self.key + 1][i], values[3 * self.key + 2][i]);
                    let (into, b) = (values[3 * next][i], values[3 * next + 1][i]);
                    (2.0 * t3 - 3.0 * t2 + 1.0) * a
                        + self.step * (t3 - 2.0 * t2 + t) * out
                        + (3.0 * t2 - 2.0 * t3) * b
                        + self.step * (t3 - t2) * into
                })
            }
        }
    }

    fn rotation(&self, values: &[Vec<f64>]) -> DQuat {
        let next = (self.key + 1).min(self.count - 1);
        let at = |i: usize| DQuat::from_slice(&values[i]).normalize();
        match self.interpolation {
            Interpolation::Linear => at(self.key).slerp(at(next), self.share),
            _ => DQuat::from_slice(&self.value(values)).normalize(),
        }
    }
}

fn moving(bytes: &[u8], name: &str) -> Result<ObjectMesh, LoadError> {
    let scene = load_glb(bytes, "made.glb", &LoadOptions::default().with_moving_nodes([name]))?;
    Ok(scene.objects()[0].clone())
}

fn rest_reach(mesh: &ObjectMesh) -> f64 {
    let corners = mesh.triangles.iter().flat_map(|triangle| triangle.corners);
    corners.map(|corner| corner.as_dvec3().length()).fold(0.0, f64::max)
}

// ---- real rigs ----

#[test]
fn real_rigs_stay_within_reach() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let data = std::env::var_os("EYELINE_DATA").map_or(root.join("../shared/data"), PathBuf::from).join("scenes");
    for (name, node) in [("Fox.glb", "fox"), ("Fox.glb", "root"), ("HubsDefaultAvatar.glb", "Avatar")] {
        let Ok(bytes) = std::fs::read(data.join(name)) else {
            eprintln!("skipped: no {name} in {} (set EYELINE_DATA)", data.display());
            continue;
        };
        let mesh = moving(&bytes, node).unwrap();
        let file = File::new(&bytes);
        let index = file.document.nodes().find(|found| found.name() == Some(node)).unwrap().index();
        let farthest = file.farthest(index, mesh.origin, 60, &mut Pcg64::seed_from_u64(5));
        let rest = rest_reach(&mesh);
        println!("{name} {node}: reach {:.3}, farthest in 60 poses {farthest:.3}, at rest {rest:.3}", mesh.reach);
        assert!(mesh.reach >= farthest && mesh.reach >= rest);
        if rest > 0.0 {
            assert!(mesh.deforms && mesh.reach < 2.5 * farthest, "far too wide");
        } else {
            // The skeleton alone: its skin stands elsewhere in the file.
            assert!(!mesh.deforms && mesh.reach == 0.0);
        }
    }
}

// ---- made files ----

/// A file in the making: a view and an accessor for each array.
struct Made {
    json: Value,
    bin: Vec<u8>,
}

impl Made {
    fn new() -> Made {
        Made {
            json: json!({"asset": {"version": "2.0"}, "accessors": [], "bufferViews": [], "meshes": [], "nodes": [],
                "scenes": [{"nodes": []}], "scene": 0}),
            bin: Vec::new(),
        }
    }

    fn push(&mut self, list: &str, value: Value) -> usize {
        if self.json[list].is_null() {
            self.json[list] = json!([]);
        }
        let list = self.json[list].as_array_mut().unwrap();
        list.push(value);
        list.len() - 1
    }

    fn floats(&mut self, values: &[f64], shape: &str) -> usize {
        let width = match shape {
            "SCALAR" => 1,
            "VEC3" => 3,
            "VEC4" => 4,
            _ => 16,
        };
        let offset = self.bin.len();
        self.bin.extend(values.iter().flat_map(|&value| (value as f32).to_le_bytes()));
        let view = self.push("bufferViews", json!({"buffer": 0, "byteOffset": offset, "byteLength": 4 * values.len()}));
        let count = values.len() / width;
        self.push("accessors", json!({"bufferView": view, "componentType": 5126, "type": shape, "count": count}))
    }

    fn joints(&mut self, joints: &[[u8; 4]]) -> usize {
        let offset = self.bin.len();
        self.bin.extend(joints.iter().flatten());
        let view = self.push("bufferViews", json!({"buffer": 0, "byteOffset": offset, "byteLength": 4 * joints.len()}));
        let count = joints.len();
        self.push("accessors", json!({"bufferView": view, "componentType": 5121, "type": "VEC4", "count": count}))
    }

    fn root(&mut self, node: Value) -> usize {
        let node = self.push("nodes", node);
        self.json["scenes"][0]["nodes"].as_array_mut().unwrap().push(json!(node));
        node
    }

    fn animate(&mut self, node: usize, path: &str, interpolation: &str, times: &[f64], values: &[f64]) {
        let shape = match path {
            "rotation" => "VEC4",
            "weights" => "SCALAR",
            _ => "VEC3",
        };
        let (input, output) = (self.floats(times, "SCALAR"), self.floats(values, shape));
        self.push(
            "animations",
            json!({"channels": [{"sampler": 0, "target": {"node": node, "path": path}}],
                "samplers": [{"input": input, "output": output, "interpolation": interpolation}]}),
        );
    }

    fn bytes(&self) -> Vec<u8> {
        let mut json = self.json.clone();
        json["buffers"] = json!([{"byteLength": self.bin.len()}]);
        let mut text = json.to_string().into_bytes();
        text.resize(text.len().next_multiple_of(4), b' ');
        let mut bytes = b"glTF\x02\0\0\0".to_vec();
        bytes.extend((28 + text.len() as u32 + self.bin.len() as u32).to_le_bytes());
        for (kind, chunk) in [(b"JSON", &text), (b"BIN\0", &self.bin)] {
            bytes.extend((chunk.len() as u32).to_le_bytes());
            bytes.extend(kind);
            bytes.extend(chunk);
        }
        bytes
    }
}

fn any(rng: &mut Pcg64, count: usize, size: f64) -> Vec<f64> {
    (0..count).map(|_| rng.random_range(-size..size)).collect()
}

/// A unit quaternion.
fn turn(rng: &mut Pcg64) -> Vec<f64> {
    let quat = DQuat::from_array(std::array::from_fn(|_| rng.random_range(-1.0..1.0)));
    quat.normalize().to_array().to_vec()
}

fn transform(rng: &mut Pcg64) -> Value {
    let (turn, scale): (Vec<f64>, Vec<f64>) = (turn(rng), (0..3).map(|_| rng.random_range(0.5..1.5)).collect());
    let translation = any(rng, 3, 2.0);
    if rng.random_bool(0.2) {
        let matrix = DMat4::from_scale_rotation_translation(
            DVec3::from_slice(&scale),
            DQuat::from_slice(&turn),
            DVec3::from_slice(&translation),
        );
        // To f32 and back, bottom row exact.
        return json!({"matrix": matrix.to_cols_array().map(|x| x as f32)});
    }
    json!({"translation": translation, "rotation": turn, "scale": scale})
}

/// A chain of nodes of which some are animated, with a mesh at its end that may be skinned to all of them, or morphed. Returns
/// the moving node.
fn rig(rng: &mut Pcg64) -> (Vec<u8>, usize) {
    let mut made = Made::new();
    let vertices = 12;
    let positions = any(rng, 3 * vertices, 1.0);
    let mut primitive = json!({"attributes": {"POSITION": made.floats(&positions, "VEC3")}});
    let targets = if rng.random_bool(0.5) { rng.random_range(1..3usize) } else { 0 };
    if targets > 0 {
        let moves: Vec<Value> =
            (0..targets).map(|_| json!({"POSITION": made.floats(&any(rng, 3 * vertices, 0.5), "VEC3")})).collect();
        primitive["targets"] = json!(moves);
    }
    let depth = rng.random_range(1..6usize);
    let nodes: Vec<Value> = (0..depth).map(|_| transform(rng)).collect();
    let mut parent = None;
    for node in nodes {
        let index = match parent {
            None => made.root(node),
            Some(parent) => {
                let child = made.push("nodes", node);
                let parent: &mut Value = &mut made.json["nodes"][parent];
                parent["children"] = json!([child]);
                child
            }
        };
        parent = Some(index);
    }
    let top = rng.random_range(0..depth);
    made.json["nodes"][top]["name"] = json!("moves");
    if rng.random_bool(0.5) {
        let joints: Vec<[u8; 4]> =
            (0..vertices).map(|_| std::array::from_fn(|_| rng.random_range(0..depth) as u8)).collect();
        let weights: Vec<f64> =
            (0..4 * vertices).map(|_| if rng.random_bool(0.4) { 0.0 } else { rng.random() }).collect();
        let weights: Vec<f64> = weights.chunks(4).flat_map(|w| [w[0] + 0.01, w[1], w[2], w[3]]).collect();
        primitive["attributes"]["JOINTS_0"] = json!(made.joints(&joints));
        primitive["attributes"]["WEIGHTS_0"] = json!(made.floats(&weights, "VEC4"));
        let binds: Vec<f64> = (0..depth)
            .flat_map(|_| {
                let turn = DQuat::from_slice(&turn(rng));
                DMat4::from_rotation_translation(turn, DVec3::from_slice(&any(rng, 3, 1.0))).to_cols_array()
            })
            .collect();
        let binds = made.floats(&binds, "MAT4");
        let joints: Vec<usize> = (0..depth).collect();
        made.push("skins", json!({"joints": joints, "inverseBindMatrices": binds}));
        made.json["nodes"][depth - 1]["skin"] = json!(0);
    }
    let mesh = made.push("meshes", json!({"primitives": [primitive]}));
    made.json["nodes"][depth - 1]["mesh"] = json!(mesh);
    for node in 0..depth {
        for path in ["translation", "rotation", "scale", "weights"] {
            let fits = match path {
                "weights" => targets > 0 && node == depth - 1,
                _ => made.json["nodes"][node]["matrix"].is_null(),
            };
            if !fits || rng.random_bool(0.5) {
                continue;
            }
            let interpolation = ["LINEAR", "STEP", "CUBICSPLINE"][rng.random_range(0..3)];
            let keys = rng.random_range(2..5usize);
            let times: Vec<f64> = (0..keys).map(|key| key as f64 * 0.7).collect();
            let each = if interpolation == "CUBICSPLINE" { 3 } else { 1 };
            let values: Vec<f64> = (0..keys * each)
                .flat_map(|i| match path {
                    // A tangent may be anything.
                    "rotation" if each == 3 && i % 3 != 1 => any(rng, 4, 2.0),
                    "rotation" => turn(rng),
                    "weights" => any(rng, targets, 3.0),
                    _ => any(rng, 3, 2.0),
                })
                .collect();
            made.animate(node, path, interpolation, &times, &values);
        }
    }
    (made.bytes(), top)
}

#[test]
fn made_rigs_stay_within_reach() {
    let mut rng = Pcg64::seed_from_u64(11);
    let (mut tightest, mut deforming) = (f64::INFINITY, 0);
    for _ in 0..300 {
        let (bytes, top) = rig(&mut rng);
        let mesh = moving(&bytes, "moves").unwrap();
        let farthest = File::new(&bytes).farthest(top, mesh.origin, 60, &mut rng);
        assert!(
            mesh.reach >= farthest - 1e-6,
            "{} < {farthest}: {}",
            mesh.reach,
            File::new(&bytes).document.as_json().nodes.len()
        );
        deforming += u32::from(mesh.deforms);
        tightest = tightest.min(mesh.reach / farthest);
    }
    println!("{deforming} of 300 deform; reach is {tightest:.3} times the farthest at best");
    assert!(deforming > 200 && tightest < 1.05);
}

#[test]
fn a_rigid_mesh_reaches_as_far_as_its_farthest_corner() {
    let mut made = Made::new();
    let positions = made.floats(&[3.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0], "VEC3");
    let mesh = made.push("meshes", json!({"primitives": [{"attributes": {"POSITION": positions}}]}));
    made.root(json!({"name": "moves", "mesh": mesh, "translation": [50.0, 0.0, 0.0], "scale": [2.0, 1.0, 1.0]}));
    // Turned by an animation it is as far from its origin; so is it if something else moves.
    let other = made.root(json!({"name": "other"}));
    made.animate(other, "translation", "LINEAR", &[0.0, 1.0], &[0.0; 6]);
    let mesh = moving(&made.bytes(), "moves").unwrap();
    assert!((mesh.reach - 6.0).abs() < 1e-3 && !mesh.deforms, "{}", mesh.reach);
    made.animate(0, "rotation", "LINEAR", &[0.0, 1.0], &[0.0, 0.0, 0.0, 1.0, 0.0, 1.0, 0.0, 0.0]);
    let mesh = moving(&made.bytes(), "moves").unwrap();
    assert!((mesh.reach - 6.0).abs() < 1e-3 && mesh.deforms, "{}", mesh.reach);
}

#[test]
fn a_spline_overshoots_its_keyframes() {
    let mut made = Made::new();
    let positions = made.floats(&[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0], "VEC3");
    let mesh = made.push("meshes", json!({"primitives": [{"attributes": {"POSITION": positions}}]}));
    made.root(json!({"name": "moves", "children": [1]}));
    made.push("nodes", json!({"mesh": mesh}));
    // Both keyframes at the origin, but it leaves at 12 m/s and comes back at 12 m/s.
    let values = [[0.0; 3], [0.0; 3], [12.0, 0.0, 0.0], [-12.0, 0.0, 0.0], [0.0; 3], [0.0; 3]].concat();
    made.animate(1, "translation", "CUBICSPLINE", &[0.0, 1.0], &values);
    let bytes = made.bytes();
    let mesh = moving(&bytes, "moves").unwrap();
    let farthest = File::new(&bytes).farthest(0, DVec3::ZERO, 400, &mut Pcg64::seed_from_u64(1));
    assert!(farthest > 2.9, "half way it is 3 m away: {farthest}");
    assert!(mesh.reach >= 3.0 && mesh.reach < 4.01, "{}", mesh.reach);
}

#[test]
fn broken_poses_are_refused_only_where_they_matter() {
    let base = || {
        let mut made = Made::new();
        let positions = made.floats(&[3.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0], "VEC3");
        let joints = made.joints(&[[0; 4]; 3]);
        let weights = made.floats(&[1.0, 0.0, 0.0, 0.0].repeat(3), "VEC4");
        let binds = made.floats(&DMat4::IDENTITY.to_cols_array(), "MAT4");
        let attributes = json!({"POSITION": positions, "JOINTS_0": joints, "WEIGHTS_0": weights});
        let mesh = made.push("meshes", json!({"primitives": [{"attributes": attributes}]}));
        made.root(json!({"name": "moves", "mesh": mesh, "skin": 0}));
        made.root(json!({"name": "joint"}));
        made.push("skins", json!({"joints": [1], "inverseBindMatrices": binds}));
        made.animate(1, "translation", "LINEAR", &[0.0, 1.0], &[0.0; 6]);
        made
    };
    assert!((moving(&base().bytes(), "moves").unwrap().reach - 3.0).abs() < 1e-3);
    type Break = fn(&mut Made);
    let breaks: [(&str, Break); 12] = [
        ("skin 9", |made| made.json["nodes"][0]["skin"] = json!(9)),
        ("node 7", |made| made.json["skins"][0]["joints"] = json!([7])),
        ("matrices for", |made| made.json["skins"][0]["joints"] = json!([1, 1])),
        ("accessor 77", |made| made.json["skins"][0]["inverseBindMatrices"] = json!(77)),
        ("affine", |made| made.bin[96..][..64].fill(0x7f)),
        ("joint 5", |made| made.bin[36] = 5),
        ("weight -1", |made| made.bin[48..][..4].copy_from_slice(&(-1f32).to_le_bytes())),
        ("weight NaN", |made| made.bin[48..][..4].copy_from_slice(&f32::NAN.to_le_bytes())),
        ("sampler 3", |made| made.json["animations"][0]["channels"][0]["sampler"] = json!(3)),
        ("finite", |made| {
            let end = made.bin.len();
            made.bin[end - 4..].copy_from_slice(&f32::INFINITY.to_le_bytes());
        }),
        ("cubic spline", |made| made.json["animations"][0]["samplers"][0]["interpolation"] = json!("CUBICSPLINE")),
        ("elements for 3 vertices", |made| {
            let joints = made.json["meshes"][0]["primitives"][0]["attributes"]["JOINTS_0"].as_u64().unwrap();
            made.json["accessors"][joints as usize]["count"] = json!(2);
        }),
    ];
    for (says, break_it) in breaks {
        let mut made = base();
        break_it(&mut made);
        let error = moving(&made.bytes(), "moves").expect_err(says).to_string();
        assert!(error.contains("made.glb") && error.contains(says), "{says}: {error}");
        // What does not move is loaded as before.
        assert!(load_glb(&made.bytes(), "made.glb", &LoadOptions::default()).is_ok(), "{says}");
    }
}

#[test]
fn a_small_file_cannot_ask_for_much_work() {
    let mut made = Made::new();
    let positions = made.floats(&[3.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0], "VEC3");
    let mesh = made.push("meshes", json!({"primitives": [{"attributes": {"POSITION": positions}}]}));
    made.root(json!({"name": "moves", "mesh": mesh}));
    made.animate(0, "translation", "LINEAR", &[0.0, 1.0], &[0.0; 6]);
    // Four billion keyframes that are all zero, as a sparse accessor without a base may say in a few bytes.
    let last = made.json["accessors"].as_array().unwrap().len() - 1;
    made.json["accessors"][last] = json!({"componentType": 5126, "type": "VEC3", "count": 4_000_000_000u32,
        "sparse": {"count": 1, "indices": {"bufferView": 0, "byteOffset": 4, "componentType": 5125},
            "values": {"bufferView": 0}}});
    let error = moving(&made.bytes(), "moves").unwrap_err();
    assert!(matches!(error, LoadError::TooManyPoses { .. }), "{error}");
}
