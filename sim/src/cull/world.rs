//! What is culled: a scene, objects that are asked about as boxes, and from where to look.

use std::path::Path;
use std::sync::Arc;

use anyhow::Context;
use eyeline_protocol::PlanSwitch;
use eyeline_server::spec::WorldSpec;
use eyeline_visibility::{
    Aabb, AnyTessellation, Camera, CameraPath, LoadOptions, RayScene, Scene, load_file, load_glb,
};
use glam::{DVec2, DVec3};
use rand::RngExt;
use rand_pcg::Pcg64;

use crate::chance;
use crate::places;
use crate::scene::building::{self, BuildingRules};
use crate::scene::city::{self, CityRules};
use crate::scene::engine::{self, EngineRules};
use crate::scene::office::{self, OfficeRules};
use crate::scene::plan::{Rect, RoomPlan, RoomsRules};
use crate::scene::rooms;
use crate::scene::seminar::{self, SeminarRules};
use crate::scene::tower::{self, TowerRules};
use crate::scene::vessels::{self, VesselsRules};

/// Eye height above a place that names the feet, metres: FACTS.md's for the maps.
const MAP_EYE_HEIGHT: f64 = 1.4375;
/// Eye height above a floor that was found, metres.
const EYE_HEIGHT: f64 = 1.6;
/// What must be free around a sampled eye, metres.
const EYE_CLEAR: f64 = 0.25;
/// Tries to find a place to stand, per camera.
const TRIES: u32 = 2_000;
/// Greatest turn up or down of a sampled camera, radians.
const PITCH_MAX: f64 = 0.2;

/// A scene to be culled.
#[derive(Clone, Debug)]
pub struct World {
    /// Its name in reports.
    pub name: String,
    /// What is culled. Its [`Scene::objects`] are asked about as boxes.
    pub scene: Arc<Scene>,
    /// The box of each object, in scene coordinates.
    pub object_boxes: Vec<Aabb>,
    /// What a reader of a report should know about how it was loaded.
    pub notes: Vec<String>,
    /// A tessellation of the scene that was made before, in place of the one of its kind.
    pub tessellation: Option<AnyTessellation>,
    /// What is asked of the plan that `planned` follows.
    pub plan: PlanSwitch,
    standing: Standing,
}

/// Where one can stand.
#[derive(Clone, Debug)]
enum Standing {
    /// The scene's own cameras.
    Cameras(CameraPath),
    /// Eyes in the file's space.
    Places(Vec<DVec3>),
    /// Floors of rooms, walls left out, at y = 0.
    Rooms(Vec<Rect>),
    /// Nothing is known: floors are searched with rays.
    Anywhere,
}

/// What is asked for of a world.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct WorldRules {
    /// Nodes whose name begins so are no part of the static scene but objects that are asked about as boxes.
    pub query_objects: Option<String>,
    /// Draw both sides of every face, whatever the materials say. `None`: as the world says.
    pub two_sided: Option<bool>,
    /// Seed of a made world; `None`: the maker's own.
    pub scene_seed: Option<u64>,
    /// Pieces of furniture a room, for `building`.
    pub objects_per_room: Option<u32>,
    /// Views, if the number is known beforehand: made worlds with cameras make as many.
    pub views: Option<u32>,
}

/// Worlds that can be made instead of read.
pub const MADE: [&str; 9] = ["building", "city", "engine", "office", "seminar", "tower", "vessels", "rooms", "room"];

impl World {
    /// A scene as it is, without places to stand.
    pub fn of(scene: Arc<Scene>, name: &str) -> World {
        World::with(scene, name.to_owned(), Standing::Anywhere, Vec::new())
    }

    fn with(scene: Arc<Scene>, name: String, standing: Standing, notes: Vec<String>) -> World {
        let boxes = scene.objects().iter().map(|object| {
            let corners = object.triangles.iter().flat_map(|triangle| triangle.corners);
            corners.fold(Aabb::EMPTY, |aabb, corner| aabb.with_point(corner.as_dvec3() + object.origin))
        });
        World {
            object_boxes: boxes.collect(),
            name,
            scene,
            notes,
            tessellation: None,
            plan: PlanSwitch::AUTO,
            standing,
        }
    }

    /// A world by the name of its maker or of its file.
    ///
    /// # Errors
    /// Names the file or the rule, and the remedy.
    pub fn open(name: &str, rules: &WorldRules) -> anyhow::Result<World> {
        let path = Path::new(name);
        if rules.objects_per_room.is_some() && name != "building" {
            anyhow::bail!("--objects-per-room is for `building` alone; leave it out for `{name}`");
        }
        if rules.scene_seed.is_some() && !MADE.contains(&name) {
            anyhow::bail!("--scene-seed is for made worlds ({}); leave it out for `{name}`", MADE.join(", "));
        }
        match name {
            "building" => World::building(rules),
            "office" => {
                let default = OfficeRules::default();
                let (seed, cameras) =
                    (rules.scene_seed.unwrap_or(default.seed), rules.views.unwrap_or(default.cameras));
                let made = office::make(&OfficeRules { seed, cameras, ..default })?;
                World::made(&made.glb, format!("office seed {seed}"), Standing::Cameras(made.cameras), rules)
            }
            "tower" => {
                let default = TowerRules::default();
                let (seed, cameras) =
                    (rules.scene_seed.unwrap_or(default.seed), rules.views.unwrap_or(default.cameras));
                let made = tower::make(&TowerRules { seed, cameras, ..default })?;
                World::made(&made.glb, format!("tower seed {seed}"), Standing::Cameras(made.cameras), rules)
            }
            "city" => {
                let default = CityRules::default();
                let (seed, cameras) =
                    (rules.scene_seed.unwrap_or(default.seed), rules.views.unwrap_or(default.cameras));
                let made = city::make(&CityRules { seed, cameras, ..default })?;
                World::made(&made.glb, format!("city seed {seed}"), Standing::Cameras(made.cameras), rules)
            }
            "engine" => {
                let default = EngineRules::default();
                let (seed, cameras) =
                    (rules.scene_seed.unwrap_or(default.seed), rules.views.unwrap_or(default.cameras));
                let made = engine::make(&EngineRules { seed, cameras, ..default })?;
                World::made(&made.glb, format!("engine seed {seed}"), Standing::Cameras(made.cameras), rules)
            }
            "seminar" => {
                let default = SeminarRules::default();
                let (seed, cameras) =
                    (rules.scene_seed.unwrap_or(default.seed), rules.views.unwrap_or(default.cameras));
                let made = seminar::make(&SeminarRules { seed, cameras, ..default })?;
                World::made(&made.glb, format!("seminar seed {seed}"), Standing::Cameras(made.cameras), rules)
            }
            "vessels" => {
                let default = VesselsRules::default();
                let (seed, cameras) =
                    (rules.scene_seed.unwrap_or(default.seed), rules.views.unwrap_or(default.cameras));
                let made = vessels::make(&VesselsRules { seed, cameras, ..default })?;
                World::made(&made.glb, format!("vessels seed {seed}"), Standing::Cameras(made.cameras), rules)
            }
            "rooms" => World::rooms(RoomsRules::default(), rules),
            // A scene so small that nothing pays.
            "room" => World::rooms(RoomsRules { columns: 1, rows: 1, ..RoomsRules::default() }, rules),
            _ if path.extension().is_none() && !path.exists() => {
                anyhow::bail!("there is no file `{name}`, nor a maker of that name; makers: {}", MADE.join(", "))
            }
            _ => World::load(path, rules),
        }
    }

    fn building(rules: &WorldRules) -> anyhow::Result<World> {
        let default = BuildingRules::default();
        let rules_of_building = BuildingRules {
            objects_per_room: rules.objects_per_room.unwrap_or(default.objects_per_room),
            cameras: rules.views.unwrap_or(default.cameras),
            seed: rules.scene_seed.unwrap_or(default.seed),
            ..default
        };
        let made = building::make(&rules_of_building)?;
        let name = format!("building seed {}", rules_of_building.seed);
        World::made(&made.glb, name, Standing::Cameras(made.cameras), rules)
    }

    fn rooms(default: RoomsRules, rules: &WorldRules) -> anyhow::Result<World> {
        let name = if default.columns == 1 { "room" } else { "rooms" };
        let made = rooms::make(&RoomsRules { seed: rules.scene_seed.unwrap_or(default.seed), ..default })?;
        let standing = standing_in(&made.plan);
        World::made(&made.glb, format!("{name} seed {}", made.plan.rules.seed), standing, rules)
    }

    fn made(glb: &[u8], name: String, standing: Standing, rules: &WorldRules) -> anyhow::Result<World> {
        let options = LoadOptions::default().with_two_sided(rules.two_sided == Some(true));
        let load = |options: &LoadOptions| Ok(load_glb(glb, &name, options)?);
        let (scene, notes) = with_objects(options, rules, load)?;
        Ok(World::with(Arc::new(scene), name, standing, notes))
    }

    fn load(path: &Path, rules: &WorldRules) -> anyhow::Result<World> {
        let (mut notes, name) = (Vec::new(), path.display().to_string());
        let spec_file = path.with_extension("world.toml");
        let spec: Option<WorldSpec> = match std::fs::read_to_string(&spec_file) {
            Ok(text) => Some(toml::from_str(&text).with_context(|| spec_file.display().to_string())?),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => None,
            Err(error) => return Err(error).with_context(|| spec_file.display().to_string()),
        };
        let (cameras, plan) = (CameraPath::beside(path)?, RoomPlan::beside(path)?);
        let places = places::beside(path)?;
        let two_sided = rules.two_sided.unwrap_or_else(|| match &spec {
            Some(spec) => spec.two_sided,
            // As `serve` and `measure` take it: a scene of which nothing is known is a game map.
            None => cameras.is_none() && plan.is_none(),
        });
        if two_sided {
            notes.push("every face counts as two-sided".to_owned());
        }
        let standing = match (cameras, plan, places) {
            (Some(cameras), ..) => Standing::Cameras(cameras),
            (None, Some(plan), _) => standing_in(&plan),
            (None, None, Some(places)) => {
                Standing::Places(places.iter().map(|place| place.position + DVec3::Y * MAP_EYE_HEIGHT).collect())
            }
            (None, None, None) => Standing::Anywhere,
        };
        let options = LoadOptions::default().with_two_sided(two_sided);
        let (scene, more) = with_objects(options, rules, |options| Ok(load_file(path, options)?))?;
        notes.extend(more);
        let short = std::env::current_dir().map_or(name.clone(), |here| crate::report::short_path(path, &here));
        Ok(World::with(Arc::new(scene), short, standing, notes))
    }

    /// Cameras where one can stand: the scene's own first, or else as many as asked for, drawn from the seed.
    pub fn cameras(&self, views: Option<u32>, seed: u64) -> CameraPath {
        let count = views.unwrap_or(200) as usize;
        let mut chance = chance(seed, 21);
        let yaw = |chance: &mut Pcg64| chance.random_range(-std::f64::consts::PI..std::f64::consts::PI);
        let cameras = match &self.standing {
            Standing::Cameras(path) => {
                let mut path = path.clone();
                path.cameras.truncate(views.map_or(usize::MAX, |views| views as usize));
                return path;
            }
            Standing::Places(eyes) => (0..count)
                .map(|_| {
                    let eye = eyes[chance.random_range(0..eyes.len())];
                    let yaw = yaw(&mut chance);
                    Camera::rounded(eye, yaw, chance.random_range(-PITCH_MAX..PITCH_MAX))
                })
                .collect(),
            Standing::Rooms(rooms) => (0..count)
                .map(|_| {
                    let room = rooms[chance.random_range(0..rooms.len())].grown(-EYE_CLEAR);
                    let share = DVec2::new(chance.random(), chance.random());
                    let at = room.min + (room.max - room.min) * share;
                    let yaw = yaw(&mut chance);
                    Camera::rounded(DVec3::new(at.x, EYE_HEIGHT, at.y), yaw, chance.random_range(-PITCH_MAX..PITCH_MAX))
                })
                .collect(),
            Standing::Anywhere => {
                let floors = Floors::new(&self.scene);
                (0..count)
                    .map(|_| {
                        let eye = floors.eye(&mut chance) + self.scene.anchor();
                        let yaw = yaw(&mut chance);
                        Camera::rounded(eye, yaw, chance.random_range(-PITCH_MAX..PITCH_MAX))
                    })
                    .collect()
            }
        };
        CameraPath::new(cameras)
    }
}

fn standing_in(plan: &RoomPlan) -> Standing {
    Standing::Rooms(plan.rooms.iter().map(|room| room.clear).collect())
}

/// Loads a scene, and again with its objects taken out if that is asked for: only the first tells their names.
fn with_objects(
    options: LoadOptions,
    rules: &WorldRules,
    load: impl Fn(&LoadOptions) -> anyhow::Result<Scene>,
) -> anyhow::Result<(Scene, Vec<String>)> {
    let scene = load(&options)?;
    let Some(prefix) = &rules.query_objects else { return Ok((scene, Vec::new())) };
    let names = scene.nodes().iter().filter(|node| node.name.starts_with(prefix.as_str()));
    let names: Vec<String> = names.map(|node| node.name.clone()).collect();
    if names.is_empty() {
        anyhow::bail!("no node has a name that begins with `{prefix}`; --query-objects names the nodes to ask about");
    }
    let note = format!("{} nodes `{prefix}…` are not in the static scene but asked about as boxes", names.len());
    Ok((load(&options.with_moving_nodes(names))?, vec![note]))
}

/// Searches a scene for floors.
struct Floors {
    bounds: Aabb,
    rays: RayScene,
}

impl Floors {
    fn new(scene: &Scene) -> Floors {
        Floors { bounds: scene.bounds(), rays: RayScene::new(scene) }
    }

    /// An eye above a floor with some room around it; if none is found, the middle of the scene.
    fn eye(&self, chance: &mut Pcg64) -> DVec3 {
        if self.bounds.is_empty() {
            return DVec3::ZERO;
        }
        let free = |from: DVec3, way: DVec3, reach: f64| self.rays.first_hit(from, way, 1e-6, reach).is_none();
        for _ in 0..TRIES {
            let share = DVec3::new(chance.random(), chance.random(), chance.random());
            let from = self.bounds.min + self.bounds.size() * share;
            let Some(floor) = self.rays.first_hit(from, DVec3::NEG_Y, 0.0, f64::INFINITY) else { continue };
            let foot = from + DVec3::NEG_Y * floor.t;
            let eye = foot + DVec3::Y * EYE_HEIGHT;
            let around = [DVec3::X, DVec3::NEG_X, DVec3::Z, DVec3::NEG_Z, DVec3::Y];
            // From a hair above the floor, which the ray starts on.
            if free(foot + DVec3::Y * 1e-3, DVec3::Y, EYE_HEIGHT) && around.iter().all(|&way| free(eye, way, EYE_CLEAR))
            {
                return eye;
            }
        }
        self.bounds.centre()
    }
}
