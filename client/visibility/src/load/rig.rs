//! What is an avatar's body? A mesh that hangs on joints, and the clips that move them, as far as they are drawn.
//!
//! No culler needs this: what hides things does not walk. It is read by the same checked accessors as scenes, since a body may come
//! from anyone too. Skinned meshes and rigid ones come out alike: each corner is carried by up to four bones, and a bone is a joint
//! with the transform from the mesh's space to the joint's (glTF §3.7.3); a rigid mesh has one bone for all.

use std::path::Path;

use glam::{DMat4, Mat4, Quat, Vec3};
use gltf::json::{
    accessor::{ComponentType, Type},
    animation::{Interpolation, Property},
    mesh::{self, Semantic},
    validation::Checked,
};

use super::{Elements, Instance, LoadError, Loader, Looks, Primitive};
use crate::{Sides, Triangle};

/// A body as a file has it, in the file's space: its own metres, +Y up, looking along +Z.
#[derive(Clone, Debug)]
pub struct Rig {
    /// The file's nodes that are placed, each behind its parent.
    pub joints: Vec<Joint>,
    /// What carries corners.
    pub bones: Vec<Bone>,
    /// Three corners each; positions in the mesh's own space.
    pub triangles: Vec<Triangle>,
    /// Which bones carry each corner, in the order of `triangles`.
    pub carried: Vec<[Carried; 3]>,
    /// How the triangles look, [`Looks::triangles`] in their order; normals in the mesh's own space.
    pub looks: Looks,
    /// The file's animations, in its order.
    pub clips: Vec<Clip>,
}

/// A node that others may hang on.
#[derive(Clone, Debug, PartialEq)]
pub struct Joint {
    /// What it hangs on: an index below its own.
    pub parent: Option<usize>,
    /// Where it rests, relative to its parent.
    pub rest: Place,
}

/// Translation, rotation and scale.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Place {
    /// Metres of the file.
    pub translation: Vec3,
    /// Of unit length.
    pub rotation: Quat,
    /// Along the three axes, before it is turned.
    pub scale: Vec3,
}

impl Place {
    /// Parent's space from one's own.
    pub fn matrix(&self) -> Mat4 {
        Mat4::from_scale_rotation_translation(self.scale, self.rotation, self.translation)
    }
}

/// A joint as it carries corners of a mesh.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bone {
    /// Index into [`Rig::joints`].
    pub joint: usize,
    /// The joint's space from the mesh's.
    pub joint_from_mesh: Mat4,
}

/// The bones that carry a corner, and by how much each: weights are at least 0 and their sum is 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Carried {
    /// Indices into [`Rig::bones`].
    pub bones: [u8; 4],
    /// Heaviest first.
    pub weights: [f32; 4],
}

/// A motion.
#[derive(Clone, Debug, PartialEq)]
pub struct Clip {
    /// Its name in the file; may be empty.
    pub name: String,
    /// How long it takes, seconds.
    pub seconds: f32,
    /// What it moves.
    pub tracks: Vec<Track>,
}

/// One joint's translation, rotation or scale over time.
#[derive(Clone, Debug, PartialEq)]
pub struct Track {
    /// Index into [`Rig::joints`].
    pub joint: usize,
    /// What of it.
    pub part: Part,
    /// When its keys are, seconds, ascending. At least one.
    pub times: Vec<f32>,
    /// At each key x, y, z, w; of a [`Curve::Cubic`] three a key: the tangent in, the value, the tangent out.
    pub values: Vec<[f32; 4]>,
    /// What is between keys.
    pub curve: Curve,
}

/// What of a joint a track moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// Where it is.
    Translation,
    /// How it is turned: a quaternion.
    Rotation,
    /// How large it is.
    Scale,
}

/// What is between two keys.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Curve {
    /// The first one's value.
    Step,
    /// Evenly from one to the other; of rotations along the shorter way.
    Linear,
    /// A cubic spline (glTF, appendix C).
    Cubic,
}

/// Most bones: corners number them by a byte.
pub const BONES_MAX: usize = 256;
/// Most joints. Whole rigs with faces and fingers have some hundred.
const JOINTS_MAX: usize = 4096;
/// Most keyframes of all clips: hours of a body's motion.
const KEYS_MAX: usize = 1 << 21;

impl Loader<'_> {
    /// The body that the scene is.
    pub(super) fn rig(&self, instances: &[Instance], folder: Option<&Path>) -> Result<Rig, LoadError> {
        if instances.len() > JOINTS_MAX {
            return Err(self.no_rig(format!("it has {} nodes, more than {JOINTS_MAX}", instances.len())));
        }
        let root = self.source.root;
        // Instances come depth first, so that parents are ahead of their children.
        let mut joint_of = vec![None; root.nodes.len()];
        let mut joints: Vec<Joint> = Vec::with_capacity(instances.len());
        let mut parent_of = vec![None; root.nodes.len()];
        for (at, instance) in instances.iter().enumerate() {
            joint_of[instance.node] = Some(at);
            let (scale, rotation, translation) =
                self.transform(instance.node)?.as_mat4().to_scale_rotation_translation();
            // A flat transform has no rotation of its own.
            let rotation = if rotation.is_finite() { rotation.normalize() } else { Quat::IDENTITY };
            joints.push(Joint { parent: parent_of[instance.node], rest: Place { translation, rotation, scale } });
            for child in root.nodes[instance.node].children.iter().flatten() {
                parent_of[child.value()] = Some(at);
            }
        }
        let mut rig = Rig {
            joints,
            bones: Vec::new(),
            triangles: Vec::new(),
            carried: Vec::new(),
            looks: self.looks(&[], folder)?,
            clips: Vec::new(),
        };
        for instance in instances.iter().filter(|instance| instance.mesh.is_some()) {
            self.add_part(instance, &joint_of, &mut rig)?;
        }
        if rig.triangles.is_empty() {
            return Err(self.no_rig("it has no triangles".into()));
        }
        self.add_clips(&joint_of, &mut rig)?;
        Ok(rig)
    }

    fn no_rig(&self, reason: String) -> LoadError {
        LoadError::Rig { file: self.source.file.into(), reason }
    }

    /// Adds a mesh and the bones that carry it.
    fn add_part(&self, instance: &Instance, joint_of: &[Option<usize>], rig: &mut Rig) -> Result<(), LoadError> {
        let root = self.source.root;
        let Some(mesh) = instance.mesh else { return Ok(()) };
        let first = rig.bones.len();
        let skin = root.nodes[instance.node].skin.map(|skin| skin.value());
        match skin {
            Some(skin) => self.add_skin(instance.node, skin, joint_of, rig)?,
            None => {
                let joint = joint_of[instance.node].expect("placed nodes have joints");
                rig.bones.push(Bone { joint, joint_from_mesh: Mat4::IDENTITY });
            }
        }
        let count = rig.bones.len() - first;
        if rig.bones.len() > BONES_MAX {
            return Err(self.no_rig(format!("its meshes hang on {} bones, more than {BONES_MAX}", rig.bones.len())));
        }
        // As modelled: where its node stands is its bones' affair.
        let still = Instance { world_from_local: DMat4::IDENTITY, mover: None, mesh: Some(mesh), node: instance.node };
        let sides = if instance.is_mirrored() { Some(Sides::Both) } else { None };
        rig.triangles.extend(self.triangles(&still, glam::DVec3::ZERO).map(|triangle| match sides {
            Some(sides) => Triangle { sides, ..triangle },
            None => triangle,
        }));
        self.add_looks(&still, &mut rig.looks.triangles)?;
        for primitive in self.primitives(&still) {
            let sets = match skin {
                Some(_) => self.joint_sets(mesh, primitive, &root.meshes[mesh].primitives[primitive.at])?,
                None => Vec::new(),
            };
            for corners in primitive.corners() {
                let mut carried = [Carried { bones: [first as u8; 4], weights: [1.0, 0.0, 0.0, 0.0] }; 3];
                for (carried, vertex) in carried.iter_mut().zip(corners) {
                    self.carry(carried, mesh, primitive.at, &sets, vertex, first, count)?;
                }
                rig.carried.push(carried);
            }
        }
        Ok(())
    }

    fn add_skin(&self, node: usize, skin: usize, joint_of: &[Option<usize>], rig: &mut Rig) -> Result<(), LoadError> {
        let root = self.source.root;
        let from = format!("node {node}");
        let described = root.skins.get(skin).ok_or_else(|| self.missing(&from, "skin", skin, root.skins.len()))?;
        let from = format!("skin {skin}");
        if described.joints.is_empty() || described.joints.len() > BONES_MAX {
            let reason = format!("{from} has {} joints; 1 to {BONES_MAX} can be drawn", described.joints.len());
            return Err(self.no_rig(reason));
        }
        let binds = self.inverse_binds(skin, described.joints.len())?;
        for (joint, bind) in described.joints.iter().zip(binds) {
            let joint = joint.value();
            let placed = joint_of.get(joint).ok_or_else(|| self.missing(&from, "node", joint, root.nodes.len()))?;
            let Some(placed) = *placed else {
                return Err(self.node_error(joint, format!("is a joint of {from}, but in no scene")));
            };
            rig.bones.push(Bone { joint: placed, joint_from_mesh: bind.as_mat4() });
        }
        Ok(())
    }

    /// The heaviest four of a vertex's bones. Their weights are made to add up to 1: files round them, or drop a fifth.
    #[expect(clippy::too_many_arguments, reason = "names the vertex in errors")]
    fn carry(
        &self,
        carried: &mut Carried,
        mesh: usize,
        primitive: usize,
        sets: &[(Elements<'_>, Elements<'_>)],
        vertex: usize,
        first: usize,
        count: usize,
    ) -> Result<(), LoadError> {
        let error = |reason: String| LoadError::Primitive { file: self.source.file.into(), mesh, primitive, reason };
        let mut pairs: Vec<(f64, usize)> = Vec::with_capacity(4 * sets.len());
        for (joints, weights) in sets {
            for axis in 0..4 {
                let (joint, weight) = (joints.whole(vertex, axis) as usize, weights.number(vertex, axis));
                if !(weight.is_finite() && weight >= 0.0) {
                    return Err(error(format!("weight {weight} of vertex {vertex}; weights must be at least 0")));
                }
                if weight > 0.0 && joint >= count {
                    return Err(error(format!("joint {joint} of vertex {vertex}, but there are {count}")));
                }
                if weight > 0.0 {
                    pairs.push((weight, joint));
                }
            }
        }
        pairs.sort_by(|a, b| b.0.total_cmp(&a.0));
        pairs.truncate(4);
        let sum: f64 = pairs.iter().map(|(weight, _)| weight).sum();
        // What nothing carries hangs on the first bone, as it was set.
        for (slot, (weight, joint)) in pairs.into_iter().enumerate() {
            carried.weights[slot] = (weight / sum) as f32;
            carried.bones[slot] = (first + joint) as u8;
        }
        Ok(())
    }

    fn add_clips(&self, joint_of: &[Option<usize>], rig: &mut Rig) -> Result<(), LoadError> {
        let root = self.source.root;
        let mut keys = 0;
        for (index, animation) in root.animations.iter().enumerate() {
            let name = animation.name.clone().unwrap_or_default();
            let mut clip = Clip { name, seconds: 0.0, tracks: Vec::new() };
            let from = format!("animation {index}");
            for channel in &animation.channels {
                let node = channel.target.node.value();
                let part = match channel.target.path {
                    Checked::Valid(Property::Translation) => Part::Translation,
                    Checked::Valid(Property::Rotation) => Part::Rotation,
                    Checked::Valid(Property::Scale) => Part::Scale,
                    _ => continue,
                };
                let placed = joint_of.get(node).ok_or_else(|| self.missing(&from, "node", node, root.nodes.len()))?;
                let Some(joint) = *placed else { continue };
                let sampler = channel.sampler.value();
                let samplers = &animation.samplers;
                let sampler =
                    samplers.get(sampler).ok_or_else(|| self.missing(&from, "sampler", sampler, samplers.len()))?;
                let curve = match sampler.interpolation {
                    Checked::Valid(Interpolation::Step) => Curve::Step,
                    Checked::Valid(Interpolation::CubicSpline) => Curve::Cubic,
                    _ => Curve::Linear,
                };
                let (input, output) = (sampler.input.value(), sampler.output.value());
                let times = self.source.numbers(input, &from, Type::Scalar)?;
                let (shape, width) = if part == Part::Rotation { (Type::Vec4, 4) } else { (Type::Vec3, 3) };
                let values = self.source.numbers(output, &from, shape)?;
                keys += values.count.max(times.count);
                if keys > KEYS_MAX {
                    return Err(self.no_rig(format!("its animations have more than {KEYS_MAX} keyframes")));
                }
                let each = if curve == Curve::Cubic { 3 } else { 1 };
                if times.count == 0 || times.count.checked_mul(each) != Some(values.count) {
                    let reason = format!("{} values of {} keyframes, {each} each", values.count, times.count);
                    return Err(self.source.error(output, reason));
                }
                let times: Vec<f32> = (0..times.count).map(|key| times.number(key, 0) as f32).collect();
                let is_ascending = times.windows(2).all(|pair| pair[0] <= pair[1]);
                if !(is_ascending && times[0] >= 0.0 && times[times.len() - 1].is_finite()) {
                    return Err(self.source.error(input, "keyframes must ascend from 0 on".into()));
                }
                let values: Vec<[f32; 4]> = (0..values.count)
                    .map(|key| {
                        std::array::from_fn(|axis| if axis < width { values.number(key, axis) as f32 } else { 0.0 })
                    })
                    .collect();
                if let Some(key) = values.iter().position(|value| value.iter().any(|part| !part.is_finite())) {
                    return Err(self.source.error(output, format!("keyframe value {key} must be finite")));
                }
                clip.seconds = clip.seconds.max(times[times.len() - 1]);
                clip.tracks.push(Track { joint, part, times, values, curve });
            }
            rig.clips.push(clip);
        }
        Ok(())
    }
}

impl<'a> Loader<'a> {
    /// Inverse bind matrices of a skin's joints; without an accessor they are identities.
    pub(super) fn inverse_binds(&self, skin: usize, count: usize) -> Result<Vec<DMat4>, LoadError> {
        let source = &self.source;
        let Some(accessor) = source.root.skins[skin].inverse_bind_matrices else {
            return Ok(vec![DMat4::IDENTITY; count]);
        };
        let accessor = accessor.value();
        let matrices = source.numbers(accessor, &format!("skin {skin}"), Type::Mat4)?;
        if matrices.count < count {
            return Err(source.error(accessor, format!("{} matrices for {count} joints", matrices.count)));
        }
        let read = |i: usize| {
            let matrix = DMat4::from_cols_array(&std::array::from_fn(|k| matrices.number(i, k)));
            let is_affine = matrix.row(3).abs_diff_eq(glam::DVec4::W, 1e-5);
            if matrix.is_finite() && is_affine {
                Ok(matrix)
            } else {
                Err(source.error(accessor, format!("matrix {i} is {matrix}, which is no affine transform")))
            }
        };
        (0..count).map(read).collect()
    }

    /// Joints and weights of a primitive, four each.
    pub(super) fn joint_sets(
        &self,
        mesh: usize,
        primitive: &Primitive<'a>,
        described: &mesh::Primitive,
    ) -> Result<Vec<(Elements<'a>, Elements<'a>)>, LoadError> {
        let source = &self.source;
        let from = format!("mesh {mesh}, primitive {}", primitive.at);
        let attribute = |semantic| described.attributes.get(&Checked::Valid(semantic)).map(|index| index.value());
        let mut sets = Vec::new();
        for set in 0.. {
            let (joints, weights) = (attribute(Semantic::Joints(set)), attribute(Semantic::Weights(set)));
            let (Some(joints), Some(weights)) = (joints, weights) else { break };
            let (joints_at, weights_at) = (joints, weights);
            let joints = source.numbers(joints, &from, Type::Vec4)?;
            if !matches!(joints.component_type(), ComponentType::U8 | ComponentType::U16) {
                return Err(source.error(joints_at, "joints of a type other than u8 and u16".into()));
            }
            let weights = source.numbers(weights, &from, Type::Vec4)?;
            for (index, elements) in [(joints_at, &joints), (weights_at, &weights)] {
                if elements.count < primitive.positions.count {
                    let reason = format!("{} elements for {} vertices", elements.count, primitive.positions.count);
                    return Err(source.error(index, reason));
                }
            }
            sets.push((joints, weights));
        }
        Ok(sets)
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::super::{LoadOptions, load_rig_glb, tests::Glb};
    use super::*;

    fn load(glb: &Glb) -> Result<Rig, LoadError> {
        load_rig_glb(&glb.bytes(), "body.glb", &LoadOptions::default())
    }

    fn floats(numbers: &[f32]) -> Vec<u8> {
        numbers.iter().flat_map(|number| number.to_le_bytes()).collect()
    }

    fn accessor(glb: &mut Glb, bytes: &[u8], component: u32, shape: &str, count: usize) -> usize {
        let view = glb.view(bytes);
        let described = json!({"bufferView": view, "componentType": component, "type": shape, "count": count});
        glb.push("accessors", described)
    }

    /// A triangle on two joints, an upper one on a lower, and a clip that turns the upper one.
    fn body() -> Glb {
        let mut glb = Glb::triangle();
        let lower = glb.root(json!({"name": "lower", "translation": [0, 1, 0], "children": [2]}));
        glb.push("nodes", json!({"name": "upper", "translation": [0, 2, 0]}));
        assert_eq!(lower, 1);
        let joints = accessor(&mut glb, &[0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 1, 0], 5121, "VEC4", 3);
        let weights = [0.5, 0.0, 0.0, 0.0, 0.25, 0.0, 0.0, 0.0, 0.25, 0.25, 0.5, 0.0];
        let weights = accessor(&mut glb, &floats(&weights), 5126, "VEC4", 3);
        glb.json["meshes"][0]["primitives"][0]["attributes"]["JOINTS_0"] = json!(joints);
        glb.json["meshes"][0]["primitives"][0]["attributes"]["WEIGHTS_0"] = json!(weights);
        glb.json["nodes"][0]["skin"] = json!(0);
        glb.json["skins"] = json!([{"joints": [1, 2]}]);
        let times = accessor(&mut glb, &floats(&[0.0, 1.5]), 5126, "SCALAR", 2);
        let turns = accessor(&mut glb, &floats(&[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 0.0]), 5126, "VEC4", 2);
        glb.json["animations"] = json!([{"name": "wave",
            "samplers": [{"input": times, "output": turns}],
            "channels": [{"sampler": 0, "target": {"node": 2, "path": "rotation"}}]}]);
        glb
    }

    #[test]
    fn a_skin_a_rigid_part_and_a_clip_become_one_rig() {
        let mut glb = body();
        // A hat that is no part of the skin.
        let hat = glb.mesh(json!([{"attributes": {"POSITION": 0}}]));
        glb.json["nodes"][2]["mesh"] = json!(hat);
        let rig = load(&glb).unwrap();
        assert_eq!(rig.joints.iter().map(|joint| joint.parent).collect::<Vec<_>>(), [None, None, Some(1)]);
        assert_eq!(rig.joints[2].rest.translation, Vec3::new(0.0, 2.0, 0.0));
        assert_eq!(rig.bones.iter().map(|bone| bone.joint).collect::<Vec<_>>(), [1, 2, 2]);
        assert_eq!((rig.triangles.len(), rig.looks.triangles.len(), rig.carried.len()), (2, 2, 2));
        // Weights add up to 1 whatever the file says.
        let of = |bone: u8| Carried { bones: [bone, 0, 0, 0], weights: [1.0, 0.0, 0.0, 0.0] };
        assert_eq!(rig.carried[0][..2], [of(0), of(1)]);
        assert_eq!(rig.carried[0][2].weights, [0.5, 0.25, 0.25, 0.0]);
        assert_eq!(rig.carried[1][0].bones[0], 2, "the hat has a bone of its own");
        let [clip] = &rig.clips[..] else { panic!("one clip") };
        assert_eq!((clip.name.as_str(), clip.seconds, clip.tracks[0].joint), ("wave", 1.5, 2));
        assert_eq!(clip.tracks[0].values, [[0.0, 0.0, 0.0, 1.0], [0.0, 0.0, 1.0, 0.0]]);
    }

    #[test]
    fn bad_bodies_are_refused_by_name() {
        let refused = |change: &dyn Fn(&mut Glb), words: &[&str]| {
            let mut glb = body();
            change(&mut glb);
            let error = load(&glb).expect_err(words[0]).to_string();
            for word in words.iter().chain(&["body.glb"]) {
                assert!(error.contains(word), "{error:?} does not say {word:?}");
            }
        };
        refused(&|glb| glb.json["nodes"][0]["skin"] = json!(4), &["skin"]);
        refused(&|glb| glb.json["skins"][0]["joints"] = json!([1]), &["joint 1", "there are 1"]);
        refused(&|glb| glb.json["skins"][0]["joints"] = json!([]), &["0 joints"]);
        refused(&|glb| glb.json["skins"][0]["joints"] = json!(vec![1; 257]), &["257 joints", "256"]);
        refused(&|glb| glb.json["skins"][0]["joints"] = json!([1, 99]), &["node"]);
        refused(&|glb| glb.json["scenes"][0]["nodes"] = json!([0]), &["in no scene"]);
        refused(&|glb| glb.json["accessors"][3]["count"] = json!(1), &["values of"]);
        refused(&|glb| glb.json["animations"][0]["channels"][0]["sampler"] = json!(9), &["sampler"]);
        refused(&|glb| glb.json["scenes"][0]["nodes"] = json!([1]), &["no triangles"]);
        // Four bytes of the second weight, and of the last keyframe's time.
        let place = |glb: &Glb, view: usize| glb.json["bufferViews"][view]["byteOffset"].as_u64().unwrap() as usize;
        let nan = f32::NAN.to_le_bytes();
        let write = |view: usize, at: usize| {
            move |glb: &mut Glb| {
                let at = place(glb, view) + at;
                glb.bin[at..at + 4].copy_from_slice(&nan);
            }
        };
        refused(&write(2, 16), &["weight", "vertex 1"]);
        refused(&write(3, 4), &["ascend"]);
        refused(&write(4, 4), &["finite"]);
    }

    #[test]
    fn changed_bytes_never_panic() {
        let mut bytes = body().bytes();
        let options = LoadOptions::default().with_triangles_max(1_000);
        for at in 0..bytes.len() {
            let before = bytes[at];
            for changed in [!before, 0, 255, b'9', before ^ 1] {
                bytes[at] = changed;
                let _ = load_rig_glb(&bytes, "changed", &options);
            }
            bytes[at] = before;
        }
    }
}
