//! A world ready to be run and measured: the model, its occluders, and how people move in it. Shared by every client of a
//! process.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicU64;

use anyhow::Context;
use eyeline_protocol::{Class, WorldTime};
use eyeline_server::model::Model;
use eyeline_server::policy::{Meshes, PolicySettings};
use eyeline_server::spec::SpawnSpec;
use eyeline_server::world::{World, WorldConfig};
use eyeline_visibility::AllRound;
use glam::DVec3;

use crate::people::Ground;
use crate::places;
use crate::scene::plan::{RoomPlan, RoomsRules};
use crate::scene::rooms;
use crate::trace::{Obstacles, Placement, Trace};

/// A world ready to be run.
#[derive(Clone)]
pub struct Stage {
    /// The model and what moves in it.
    pub model: Model,
    /// Rooms and doors, if the world was made; walkers need them.
    pub plan: Option<Arc<RoomPlan>>,
    /// Occluders for all-round culling.
    pub all_round: Arc<AllRound>,
    /// What a reader of a report should know about how the world was loaded.
    pub notes: Vec<String>,
}

/// A recorded crowd, placed in a world.
#[derive(Clone)]
pub struct Crowd {
    /// Who walked where.
    pub trace: Arc<Trace>,
    /// Where that is in the world.
    pub placement: Placement,
    /// The same people again, elsewhere and shifted in time by so many seconds.
    pub copies: Vec<(Placement, f64)>,
    /// What they slide along, if the world's triangles are at hand.
    pub obstacles: Option<Arc<Obstacles>>,
    /// Steps that led into a wall, counted.
    pub slid: Arc<AtomicU64>,
}

impl Crowd {
    /// The people of a recording, once, with nothing in their way.
    pub fn new(trace: Arc<Trace>, placement: Placement) -> Crowd {
        Crowd { trace, placement, copies: Vec::new(), obstacles: None, slid: Arc::default() }
    }
}

/// The interest policies that can be run.
pub use eyeline_server::model::POLICIES;

impl Stage {
    /// A made world of rooms.
    ///
    /// # Errors
    /// If the rules make no building.
    pub fn made(rules: &RoomsRules) -> anyhow::Result<Stage> {
        let made = rooms::make(rules)?;
        let model = Model::from_bytes(made.glb, "rooms.glb", Some(made.world))?;
        Ok(Stage::of(model, Some(Arc::new(made.plan)), Vec::new()))
    }

    /// The world of a file. A scene that says nothing of avatars gets its `NAME.places.json` as places to stand, and two
    /// sides to every face: it is then one of the game maps, whose faces have one.
    ///
    /// # Errors
    /// Names the file, the value and the remedy.
    pub fn load(path: &Path, world_file: Option<&Path>) -> anyhow::Result<Stage> {
        let (model, plan, notes) = load_model(path, world_file)?;
        Ok(Stage::of(model, plan, notes))
    }

    fn of(model: Model, plan: Option<Arc<RoomPlan>>, notes: Vec<String>) -> Stage {
        let all_round = Arc::new(AllRound::new(&model.scene));
        Stage { model, plan, all_round, notes }
    }

    /// The same for people who look through doors where there are rooms ([`AllRound::look_around`]).
    pub fn with_rooms(self) -> Stage {
        Stage { all_round: Arc::new(AllRound::among_rooms(&self.model.scene)), ..self }
    }

    /// Places a recorded crowd, `copies` times in all where there are so many places, and raises the avatars' speed bound to what its people did.
    ///
    /// # Errors
    /// If the world has no place to put it.
    pub fn with_crowd(
        mut self,
        trace: Trace,
        placement: Option<Placement>,
        copies: usize,
    ) -> anyhow::Result<(Stage, Crowd)> {
        let places: Vec<DVec3> = self.model.spec.spawns.iter().map(|spawn| DVec3::from_array(spawn.position)).collect();
        let spread = Placement::spread(&trace, &places, copies.max(1));
        let placement = placement
            .or_else(|| spread.first().copied())
            .context("the world has no place to put the trace; name one with --trace-origin X,Y,Z")?;
        // A little above, since samples are rounded and the wire's grid adds its step.
        let needed = placement.speed_max(&trace) * 1.05 + 0.05;
        let avatar = &mut self.model.spec.avatar;
        if avatar.speed_max < needed {
            self.notes.push(format!("avatars may reach {needed:.2} m/s, since people in the trace did"));
            avatar.speed_max = needed;
        }
        if spread.len() < copies {
            self.notes.push(format!("{} copies of the trace instead of {copies}: no more places", spread.len()));
        }
        // Shifted evenly over the recording, so that no two copies do the same at once.
        let shift = |i: usize| trace.span_s() * i as f64 / spread.len().max(1) as f64;
        let copies = spread.iter().enumerate().skip(1).map(|(i, placement)| (*placement, shift(i))).collect();
        let avatar = self.model.spec.avatar;
        let obstacles = Obstacles::new(self.model.scene.clone(), avatar.radius, avatar.height);
        let obstacles = Some(Arc::new(obstacles));
        Ok((self, Crowd { copies, obstacles, ..Crowd::new(Arc::new(trace), placement) }))
    }

    /// The world's anchor in the model's space, metres.
    pub fn anchor(&self) -> DVec3 {
        self.model.scene.anchor()
    }

    /// What people in this world must know of it.
    pub fn ground(&self) -> Ground {
        Ground {
            plan: self.plan.clone(),
            avatar: self.model.spec.avatar,
            anchor: self.anchor(),
            all_round: self.all_round.clone(),
        }
    }

    /// A world under the policy of this name.
    ///
    /// # Errors
    /// If there is no such policy, its settings are of no use here, or the world contradicts itself.
    pub fn world(
        &self,
        config: WorldConfig,
        policy: &str,
        settings: &PolicySettings,
        now: WorldTime,
    ) -> anyhow::Result<World> {
        Ok(self.model.world(config, policy, settings, now)?)
    }

    /// The meshes of what moves; `avatar` is the class of avatars.
    pub fn meshes(&self, avatar: &Class) -> Meshes {
        self.model.meshes(avatar)
    }
}

/// The model of a file as [`Stage::load`] takes it, the plan of its rooms if it was made, and notes; without the work of
/// preparing occluders, for who only serves it or places people in it.
///
/// # Errors
/// Names the file, the value and the remedy.
pub fn load_model(
    path: &Path,
    world_file: Option<&Path>,
) -> anyhow::Result<(Model, Option<Arc<RoomPlan>>, Vec<String>)> {
    let model = Model::load(path, world_file)?;
    let plan = RoomPlan::beside(path)?.map(Arc::new);
    let mut notes = Vec::new();
    // A world file or extras that say anything, even without an object that moves, are believed.
    let has_file = world_file.is_some() || path.with_extension("world.toml").exists();
    if has_file || plan.is_some() || !model.stats.extras.is_empty() {
        return Ok((model, plan, notes));
    }
    let mut spec = model.spec.clone();
    spec.two_sided = true;
    notes.push("no world file: every face counts as two-sided, nothing moves but avatars".to_owned());
    match places::beside(path)? {
        Some(places) if !places.is_empty() => {
            notes.push(format!("avatars stand at {} places", places.len()));
            let spawn = |place: &places::Place| SpawnSpec { position: place.position.to_array(), heading: 0.0 };
            spec.spawns = places.iter().map(spawn).collect();
        }
        _ => notes.push("no places file: avatars stand in the middle of the scene, on its lowest level".to_owned()),
    }
    let name = path.display().to_string();
    let model = Model::from_bytes(model.bytes.to_vec(), &name, Some(spec)).context("loading it again two-sided")?;
    Ok((model, plan, notes))
}
