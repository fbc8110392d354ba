//! The static world as a server holds it: its bytes, what moves in it, and its triangles for the audit.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use eyeline_protocol::{Class, WorldInfo, WorldTime};
use eyeline_visibility::{AllRound, LoadError, LoadOptions, LoadStats, Scene, load_glb_with_stats, pack_glb};
use glam::DVec3;
use serde::Deserialize;

use crate::audit::{Audit, RegionAudit};
use crate::hash::sha256;
use crate::policy::{ExactSight, Meshes, Oracle, Policy, PolicyError, PolicySettings, Visible};
use crate::spec::{ClassSpec, ObjectSpec, PathSpec, SpawnSpec, WorldSpec};
use crate::world::{World, WorldConfig, WorldError};

/// A model and what moves in it.
#[derive(Clone)]
pub struct Model {
    /// The .glb that clients fetch; a .gltf is packed into one.
    pub bytes: Arc<[u8]>,
    /// Its name and hash.
    pub info: WorldInfo,
    /// What moves in it, and where avatars start.
    pub spec: WorldSpec,
    /// Its static triangles and the meshes of what moves.
    pub scene: Arc<Scene>,
    /// What was met while loading.
    pub stats: LoadStats,
}

/// Why there is no such world.
#[derive(Debug, thiserror::Error)]
pub enum ModelError {
    /// The model can't be loaded.
    #[error(transparent)]
    Load(#[from] LoadError),
    /// The world file can't be read.
    #[error("{}: {source}", path.display())]
    Read {
        /// Which file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The world file does not say what it should.
    #[error("{}: {source}", path.display())]
    Spec {
        /// Which file.
        path: PathBuf,
        /// Where, and why.
        source: Box<toml::de::Error>,
    },
    /// A mesh sticks out of its class's cylinder.
    #[error(
        "{file}: the mesh of node '{node}' reaches {what} = {mesh:.4} m, beyond {given} m of class '{class}'; give the class \
         what its meshes need"
    )]
    Extent {
        /// The model.
        file: String,
        /// The node.
        node: String,
        /// Its class.
        class: String,
        /// Which of the class's values.
        what: &'static str,
        /// What the mesh needs, metres.
        mesh: f64,
        /// What the class gives, metres.
        given: f64,
    },
    /// A node's extras do not say what they should.
    #[error("{file}: extras.eyeline of node '{node}': {reason}")]
    Extras {
        /// The model.
        file: String,
        /// The node.
        node: String,
        /// What is wrong.
        reason: String,
    },
}

/// `extras.eyeline` of a node that moves. Units as in [`WorldSpec`].
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Extras {
    /// Avatars may start at the node.
    #[serde(default)]
    spawn: bool,
    radius: Option<f64>,
    #[serde(default)]
    bottom: f64,
    top: Option<f64>,
    speed_max: Option<f64>,
    /// People may move it.
    #[serde(default)]
    takeable: bool,
    path: Option<PathSpec>,
}

impl Model {
    /// Loads `model`. What moves is said by `world_file`, else by `NAME.world.toml` beside the model, else by the extras
    /// of its nodes.
    ///
    /// # Errors
    /// Names the file, the value and the remedy.
    pub fn load(model: &Path, world_file: Option<&Path>) -> Result<Model, ModelError> {
        let bytes = pack_glb(model)?;
        let beside = model.with_extension("world.toml");
        let world_file = world_file.map(Path::to_owned).or_else(|| beside.exists().then_some(beside));
        let spec = match world_file {
            Some(path) => {
                let text =
                    std::fs::read_to_string(&path).map_err(|source| ModelError::Read { path: path.clone(), source })?;
                let spec =
                    toml::from_str(&text).map_err(|source| ModelError::Spec { path, source: Box::new(source) })?;
                Some(spec)
            }
            None => None,
        };
        Model::from_bytes(bytes, &model.display().to_string(), spec)
    }

    /// A model in memory. `name` stands for its file in errors; without a `spec` the nodes' extras say what moves.
    ///
    /// # Errors
    /// Names the file, the value and the remedy.
    pub fn from_bytes(bytes: Vec<u8>, name: &str, spec: Option<WorldSpec>) -> Result<Model, ModelError> {
        let spec = match spec {
            Some(spec) => spec,
            None => {
                // Once to see which nodes say something, once more to know where they stand.
                let (_, stats) = load_glb_with_stats(&bytes, name, &LoadOptions::default())?;
                let nodes: BTreeSet<String> = stats.extras.iter().map(|(node, _)| node.clone()).collect();
                let options = LoadOptions::default().with_moving_nodes(nodes);
                let (scene, stats) = load_glb_with_stats(&bytes, name, &options)?;
                spec_of_extras(name, &scene, &stats)?
            }
        };
        let (scene, stats) = load_scene(&bytes, name, &spec)?;
        check_extents(name, &scene, &spec)?;
        let short = Path::new(name).file_name().map_or_else(|| name.to_owned(), |name| name.to_string_lossy().into());
        let mut spec = spec;
        if spec.spawns.is_empty() {
            spec.spawns.push(SpawnSpec { position: default_spawn(&scene).to_array(), heading: 0.0 });
        }
        let info = WorldInfo {
            name: if spec.name.is_empty() { short } else { spec.name.clone() },
            hash: sha256(&bytes),
            size_bytes: bytes.len() as u64,
            two_sided: spec.two_sided,
        };
        Ok(Model { bytes: bytes.into(), info, spec, scene: Arc::new(scene), stats })
    }

    /// A world of this model under the policy of this name, one of [`POLICIES`], whose first tick is at `now`.
    ///
    /// # Errors
    /// If there is no such policy, its settings are of no use here, or the world contradicts itself.
    pub fn world(
        &self,
        config: WorldConfig,
        policy: &str,
        settings: &PolicySettings,
        now: WorldTime,
    ) -> Result<World, StartError> {
        let under =
            |policy| World::new(config.clone(), self.spec.clone(), self.info.clone(), self.scene.anchor(), policy, now);
        let made: Box<dyn Policy> = match settings.policy(policy, &self.info)? {
            Some(made) => made,
            None if policy == "oracle" => {
                // The classes are the world's, which is made twice for them; it is cheap without an oracle.
                let classes = under(Box::new(Visible))?.classes().to_vec();
                let meshes = Arc::new(self.meshes(&classes[0]));
                Box::new(Oracle::new(Box::new(ExactSight::new(self.scene.clone(), meshes, classes))))
            }
            None => return Err(StartError::Policy(policy.to_owned())),
        };
        Ok(under(made)?)
    }

    /// An audit with this model's walls, for [`World::set_audit`]. `classes` are the world's.
    pub fn audit(&self, classes: &[Class]) -> Box<dyn Audit> {
        Box::new(RegionAudit::new(Arc::new(AllRound::new(&self.scene)), classes.to_vec()))
    }

    /// The meshes of what moves; `avatar` is the class of avatars.
    pub fn meshes(&self, avatar: &Class) -> Meshes {
        let headings = self
            .spec
            .objects
            .iter()
            .map(|object| (object.node.as_ref().unwrap_or(&object.name).as_str(), object.heading));
        Meshes::new(&self.scene, headings, avatar)
    }
}

/// The interest policies that a world can be run under.
pub const POLICIES: [&str; 6] = ["visible", "broadcast", "oracle", "radius", "grid", "pvs"];

/// Why a model can't be run.
#[derive(Debug, thiserror::Error)]
pub enum StartError {
    /// No such policy.
    #[error("'{0}' is no policy; there are {all}", all = POLICIES.join(", "))]
    Policy(String),
    /// The policy's settings are of no use.
    #[error(transparent)]
    Settings(#[from] PolicyError),
    /// The world contradicts itself.
    #[error(transparent)]
    World(#[from] WorldError),
}

/// Whether each moving node's mesh stays within its class's cylinder at every turn about the vertical: what sticks out of
/// it would be hidden while in sight. Of one that deforms only a ball is known that holds every pose.
fn check_extents(file: &str, scene: &Scene, spec: &WorldSpec) -> Result<(), ModelError> {
    let classes: BTreeMap<&str, &ClassSpec> = spec.classes.iter().map(|class| (class.name.as_str(), class)).collect();
    let meshes: BTreeMap<&str, _> = scene.objects().iter().map(|mesh| (mesh.name.as_str(), mesh)).collect();
    for object in &spec.objects {
        let node = object.node.as_deref().unwrap_or(&object.name);
        // An unknown class is the world's to refuse.
        let (Some(class), Some(mesh)) = (classes.get(object.class.as_str()), meshes.get(node)) else { continue };
        let corners = || mesh.triangles.iter().flat_map(|triangle| triangle.corners).map(|corner| corner.as_dvec3());
        let most = |values: &mut dyn Iterator<Item = f64>| values.fold(f64::NEG_INFINITY, f64::max);
        let (radius, top, bottom) = if mesh.deforms {
            // Its triangles are one pose of many.
            (mesh.reach, mesh.reach, -mesh.reach)
        } else {
            let radius = most(&mut corners().map(|corner| corner.x.hypot(corner.z)));
            let top = most(&mut corners().map(|corner| corner.y));
            (radius, top, -most(&mut corners().map(|corner| -corner.y)))
        };
        for (what, mesh, given, fits) in [
            ("radius", radius, class.radius, radius <= class.radius + ROUNDING_METRES),
            ("top", top, class.top, top <= class.top + ROUNDING_METRES),
            ("bottom", bottom, class.bottom, bottom >= class.bottom - ROUNDING_METRES),
        ] {
            if !fits {
                let (file, node, class) = (file.to_owned(), node.to_owned(), class.name.clone());
                return Err(ModelError::Extent { file, node, class, what, mesh, given });
            }
        }
    }
    Ok(())
}

/// What f32 coordinates of a mesh may lose against what somebody wrote in a file.
const ROUNDING_METRES: f64 = 1e-5;

/// The scene of a model whose moving nodes a specification names: the same at the server and at a client that knows the
/// roster.
fn load_scene(bytes: &[u8], name: &str, spec: &WorldSpec) -> Result<(Scene, LoadStats), LoadError> {
    let nodes = spec.objects.iter().map(|object| object.node.as_ref().unwrap_or(&object.name).clone());
    let options = LoadOptions::default().with_moving_nodes(nodes).with_two_sided(spec.two_sided);
    load_glb_with_stats(bytes, name, &options)
}

/// The middle of the scene, on its floor: the best guess for a model that says nothing.
fn default_spawn(scene: &Scene) -> DVec3 {
    let bounds = scene.bounds();
    if bounds.is_empty() {
        return scene.anchor();
    }
    scene.anchor() + bounds.centre().with_y(bounds.min.y)
}

fn spec_of_extras(file: &str, scene: &Scene, stats: &LoadStats) -> Result<WorldSpec, ModelError> {
    let mut spec = WorldSpec::default();
    let mut nodes = BTreeSet::new();
    for (node, value) in &stats.extras {
        let bad = |reason: String| ModelError::Extras { file: file.to_owned(), node: node.clone(), reason };
        let extras: Extras = serde_json::from_value(value.clone()).map_err(|error| bad(error.to_string()))?;
        if !nodes.insert(node) || node.is_empty() {
            return Err(bad("a node that moves needs a name of its own".into()));
        }
        let origin = scene.objects().iter().find(|object| object.name == *node).map(|o| o.origin + scene.anchor());
        let origin = origin.ok_or_else(|| bad("the node is not in the default scene".into()))?;
        if extras.spawn {
            spec.spawns.push(SpawnSpec { position: origin.to_array(), heading: 0.0 });
            continue;
        }
        let needed = |value: Option<f64>, key: &str| value.ok_or_else(|| bad(format!("needs {key} (metres, seconds)")));
        spec.classes.push(ClassSpec {
            name: node.clone(),
            radius: needed(extras.radius, "radius")?,
            bottom: extras.bottom,
            top: needed(extras.top, "top")?,
            speed_max: needed(extras.speed_max, "speed_max")?,
        });
        spec.objects.push(ObjectSpec {
            name: node.clone(),
            class: node.clone(),
            node: None,
            position: origin.to_array(),
            heading: 0.0,
            takeable: extras.takeable,
            path: extras.path,
        });
    }
    Ok(spec)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A chair of one triangle, 1 m high; in an animation, if it has one, it goes up to `lifted` metres.
    fn chair(lifted: Option<f32>) -> Vec<u8> {
        let numbers = [
            [0.0, 0.0, 0.0],
            [0.4, 0.0, 0.0],
            [0.0, 1.0, 0.0],
            [0.0, 0.0, 0.0],
            [0.0, lifted.unwrap_or(0.0) - 1.0, 0.0],
        ];
        let mut binary: Vec<u8> = numbers.iter().flatten().flat_map(|number: &f32| number.to_le_bytes()).collect();
        binary.extend([0.0f32, 1.0].iter().flat_map(|time| time.to_le_bytes()));
        let mut json = serde_json::json!({
            "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}],
            "nodes": [{"name": "chair", "children": [1]}, {"mesh": 0}],
            "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
            "buffers": [{"byteLength": binary.len()}],
            "bufferViews": [{"buffer": 0, "byteLength": 36}, {"buffer": 0, "byteOffset": 36, "byteLength": 24},
                {"buffer": 0, "byteOffset": 60, "byteLength": 8}],
            "accessors": [{"bufferView": 0, "componentType": 5126, "type": "VEC3", "count": 3},
                {"bufferView": 1, "componentType": 5126, "type": "VEC3", "count": 2},
                {"bufferView": 2, "componentType": 5126, "type": "SCALAR", "count": 2}],
        });
        if lifted.is_some() {
            json["animations"] = serde_json::json!([{"samplers": [{"input": 2, "output": 1}],
                "channels": [{"sampler": 0, "target": {"node": 1, "path": "translation"}}]}]);
        }
        let mut text = json.to_string().into_bytes();
        text.resize(text.len().next_multiple_of(4), b' ');
        let mut bytes = b"glTF\x02\0\0\0".to_vec();
        bytes.extend((28 + text.len() as u32 + binary.len() as u32).to_le_bytes());
        for (kind, chunk) in [(b"JSON", &text), (b"BIN\0", &binary)] {
            bytes.extend((chunk.len() as u32).to_le_bytes());
            bytes.extend(kind);
            bytes.extend(chunk);
        }
        bytes
    }

    fn load(lifted: Option<f32>, class: ClassSpec) -> Result<Model, ModelError> {
        let object = ObjectSpec {
            name: "chair".into(),
            class: class.name.clone(),
            node: None,
            position: [0.0; 3],
            heading: 0.0,
            takeable: false,
            path: None,
        };
        let spec = WorldSpec { classes: vec![class], objects: vec![object], ..WorldSpec::default() };
        Model::from_bytes(chair(lifted), "w.glb", Some(spec))
    }

    #[test]
    fn a_class_must_hold_its_meshes_in_every_pose() {
        let class = |radius, bottom, top| ClassSpec { name: "chair".into(), radius, bottom, top, speed_max: 1.0 };
        assert!(load(None, class(0.4, 0.0, 1.0)).is_ok());
        let error = load(None, class(0.4, 0.0, 0.9)).err().unwrap().to_string();
        assert!(error.contains("top = 1.0000"), "{error}");
        // Lifted by 2 m it reaches 3 m up.
        let error = load(Some(3.0), class(0.4, 0.0, 1.0)).err().unwrap().to_string();
        assert!(error.contains("radius = 3.0"), "{error}");
        assert!(load(Some(3.0), class(3.1, -3.1, 3.1)).is_ok());
    }
}
