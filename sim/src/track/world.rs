//! What is tracked: a building of rooms, chairs that move in it, and somebody who looks.

use std::sync::Arc;
use std::time::Duration;

use anyhow::Context;
use eyeline_client::tracking::{FuzzySpeeds, MotionLimits, MotionState, TbvShape, TemporalBound};
use eyeline_protocol::WorldTime;
use eyeline_server::path::paths_of;
use eyeline_visibility::{Aabb, Bound, LoadOptions, Resolution, Scene, Sides, Triangle, View, load_glb};
use glam::{DVec2, DVec3, Vec3};
use rand::RngExt;
use rand::seq::SliceRandom;

use super::mover::{MotionKind, Mover};
use crate::chance;
use crate::motion::walk::Walker;
use crate::scene::furniture;
use crate::scene::plan::{Rect, RoomPlan, RoomsRules};
use crate::scene::rooms;

/// Height of the eye, metres.
const EYE_HEIGHT: f64 = 1.6;
/// Full horizontal angle of view, radians.
const FOV: f64 = std::f64::consts::FRAC_PI_2;
/// Greatest speed of a chair that is not on a preset path, m/s: the preset ones' class says the same.
pub const SPEED_MAX: f64 = 0.85;

/// Who looks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum EyeKind {
    /// Stands in a corner of the middle room and looks across it.
    Still,
    /// Walks from room to room.
    Walking,
}

/// What to make.
#[derive(Clone, Debug, PartialEq)]
pub struct TrackRules {
    /// Rooms along +X and +Z.
    pub rooms: [u32; 2],
    /// Chairs in the room of the eye and its view, and in rooms that nothing of is seen from where it stands.
    pub chairs: Chairs,
    /// How they move; several are dealt out in turn.
    pub motion: Vec<MotionKind>,
    /// Who looks.
    pub eye: EyeKind,
    /// The hard limit on speed over what is really reached: 1, or more where a limit is as loose as limits often are.
    pub slack: f64,
    /// Decides everything else.
    pub seed: u64,
}

/// How many chairs, and where.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Chairs {
    /// So many in each room.
    PerRoom(u32),
    /// So many all in all, at random.
    Total(u32),
    /// In the room of the still eye, and in rooms of which it sees nothing.
    Split {
        /// In its room.
        visible: u32,
        /// Elsewhere.
        hidden: u32,
    },
}

/// One moving object.
#[derive(Clone, Debug)]
pub struct TrackObject {
    /// How it moves.
    pub mover: Mover,
    /// The kind of its motion.
    pub kind: MotionKind,
}

/// A world in motion. Deterministic: the same rules give the same frames.
#[derive(Clone, Debug)]
pub struct TrackWorld {
    /// The static scene, without chairs.
    pub scene: Arc<Scene>,
    /// What moves.
    pub objects: Vec<TrackObject>,
    /// The chair, about its middle.
    mesh: Vec<Triangle>,
    /// Distance of its farthest corner from there.
    reach: f64,
    slack: f64,
    eye: Eye,
    now: WorldTime,
    frame: u64,
}

#[derive(Clone, Debug)]
enum Eye {
    Still { eye: DVec3, yaw: f64 },
    Walking(Box<Walker>),
}

impl TrackWorld {
    /// Makes a world.
    ///
    /// # Errors
    /// Names the rule that no building can follow.
    pub fn make(rules: &TrackRules) -> anyhow::Result<TrackWorld> {
        let rooms_rules = RoomsRules {
            columns: rules.rooms[0],
            rows: rules.rooms[1],
            moving_share: 1.0,
            seed: rules.seed,
            ..RoomsRules::default()
        };
        let made = rooms::make(&rooms_rules)?;
        let names = made.world.objects.iter().map(|object| object.name.clone());
        let scene = load_glb(&made.glb, "rooms", &LoadOptions::default().with_moving_nodes(names))?;
        // The same chair as the maker's in size, of as many triangles as the furniture of `building`.
        let chair = furniture::pieces().into_iter().find(|piece| piece.name == "chair").context("there is no chair")?;
        let middle = Vec3::new(0.0, 0.5 * chair.height as f32, 0.0);
        let corner = |index: &u32| chair.mesh.positions[*index as usize] - middle;
        let mesh: Vec<Triangle> = chair
            .mesh
            .indices
            .chunks_exact(3)
            .map(|three| Triangle {
                corners: [corner(&three[0]), corner(&three[1]), corner(&three[2])],
                sides: Sides::Front,
                occludes: true,
            })
            .collect();
        let reach =
            mesh.iter().flat_map(|triangle| triangle.corners).map(|c| c.as_dvec3().length()).fold(0.0, f64::max);
        let plan = Arc::new(made.plan);
        let middle_room =
            plan.rooms.len() / 2 + if rules.rooms[1].is_multiple_of(2) { rules.rooms[0] as usize / 2 } else { 0 };
        let eye = match rules.eye {
            EyeKind::Still => still_eye(&plan, middle_room.min(plan.rooms.len() - 1)),
            EyeKind::Walking => {
                let start = made.world.spawns.first().context("the building has no place to start")?.position;
                let speeds = crate::motion::walk::SPEEDS;
                Eye::Walking(Box::new(Walker::new(plan.clone(), made.world.avatar, rules.seed, start.into(), speeds)?))
            }
        };
        let lift = f64::from(middle.y);
        let mut paths: Vec<Vec<Mover>> = vec![Vec::new(); plan.rooms.len()];
        for (number, path) in paths_of(&made.world)?.into_iter().enumerate() {
            if let Some(path) = path {
                paths[number / 4].push(Mover::preset(path, lift));
            }
        }
        let mut world = TrackWorld {
            scene: Arc::new(scene),
            objects: Vec::new(),
            mesh,
            reach: reach + 1e-4,
            slack: rules.slack,
            eye,
            now: WorldTime::ZERO,
            frame: 0,
        };
        let rooms = world.rooms_of(rules, &plan, middle_room);
        let mut used = vec![0; plan.rooms.len()];
        for (number, room) in rooms.into_iter().enumerate() {
            let kind = rules.motion[number % rules.motion.len()];
            let chance = chance(rules.seed, 1_000 + number as u64);
            let clear = plan.rooms[room].clear.grown(-world.reach - 0.02);
            let mover = match kind {
                MotionKind::Preset => {
                    let paths = &paths[room];
                    let path = paths.get(used[room] % paths.len().max(1)).context("a room has no chair's path")?;
                    used[room] += 1;
                    path.clone()
                }
                MotionKind::DoorFrame => {
                    let door = plan.rooms[room].doors.first().map(|&door| &plan.doors[door]);
                    let (centre, across) = door.map_or((clear.center(), DVec2::X), |door| (door.center, door.across));
                    let side = DVec2::new(across.y.abs(), across.x.abs()) * 0.01;
                    Mover::within(kind, Rect::around(centre, across.abs() * 1.2 + side), lift, SPEED_MAX, chance)
                }
                _ => Mover::within(kind, clear, lift, SPEED_MAX, chance),
            };
            world.objects.push(TrackObject { mover, kind });
        }
        Ok(world)
    }

    /// In which room each chair is.
    fn rooms_of(&self, rules: &TrackRules, plan: &RoomPlan, middle: usize) -> Vec<usize> {
        let count = plan.rooms.len();
        let mut chance = chance(rules.seed, 999);
        match rules.chairs {
            Chairs::PerRoom(each) => (0..count).flat_map(|room| (0..each).map(move |_| room)).collect(),
            Chairs::Total(total) => {
                let mut rooms: Vec<usize> = (0..count).collect();
                rooms.shuffle(&mut chance);
                (0..total as usize).map(|number| rooms[number % count]).collect()
            }
            Chairs::Split { visible, hidden } => {
                let seen = self.rooms_in_sight(plan);
                let unseen: Vec<usize> = (0..count).filter(|room| !seen[*room]).collect();
                let elsewhere = |chance: &mut rand_pcg::Pcg64| match unseen.len() {
                    0 => middle,
                    rooms => unseen[chance.random_range(0..rooms)],
                };
                let mut rooms = vec![middle; visible as usize];
                rooms.extend((0..hidden).map(|_| elsewhere(&mut chance)));
                rooms
            }
        }
    }

    /// Of which rooms something is in sight from where the eye stands now.
    fn rooms_in_sight(&self, plan: &RoomPlan) -> Vec<bool> {
        use eyeline_visibility::{Culler, EyeRegion, HierarchicalZ, Scratch};
        let view = self.view(Resolution::new(512, 512));
        let mut scratch = Scratch::default();
        HierarchicalZ::build(self.scene.clone()).cull(&view, EyeRegion::point(view.eye), &mut scratch);
        let height = plan.rules.height;
        let seen = |rect: &Rect| {
            let aabb =
                Aabb::new(DVec3::new(rect.min.x, 0.1, rect.min.y), DVec3::new(rect.max.x, height - 0.1, rect.max.y));
            !scratch.occlusion().hides(&Bound::Box(aabb))
        };
        plan.rooms.iter().map(|room| seen(&room.clear)).collect()
    }

    /// Goes on by a frame.
    pub fn step(&mut self, frame_s: f64) {
        self.frame += 1;
        self.now = WorldTime::from_micros((self.frame as f64 * frame_s * 1e6).round() as i64);
        for object in &mut self.objects {
            object.mover.step(frame_s);
        }
        if let Eye::Walking(walker) = &mut self.eye {
            walker.step(frame_s);
        }
    }

    /// The present frame's time.
    pub fn now(&self) -> WorldTime {
        self.now
    }

    /// Whether the eye ever moves.
    pub fn eye_moves(&self) -> bool {
        matches!(self.eye, Eye::Walking(_))
    }

    /// The view of the present frame.
    pub fn view(&self, resolution: Resolution) -> View {
        let (eye, yaw) = match &self.eye {
            Eye::Still { eye, yaw } => (*eye, *yaw),
            Eye::Walking(walker) => (walker.pose().eye, walker.pose().yaw),
        };
        View::level(eye - self.scene.anchor(), yaw, FOV, resolution)
    }

    /// Triangles of each object.
    pub fn triangles_each(&self) -> usize {
        self.mesh.len()
    }

    /// Writes where the object's triangles are now, in the scene's coordinates. They are f32 as a scene's are, so that
    /// everybody who draws them draws the same.
    pub fn place(&self, object: u32, placed: &mut Vec<Triangle>) {
        let place = self.objects[object as usize].mover.place();
        let (sin, cos) = place.yaw.sin_cos();
        let offset = place.position - self.scene.anchor();
        placed.clear();
        placed.extend(self.mesh.iter().map(|triangle| {
            let corners = triangle.corners.map(|corner| {
                let corner = corner.as_dvec3();
                let turned = DVec3::new(cos * corner.x + sin * corner.z, corner.y, cos * corner.z - sin * corner.x);
                (turned + offset).as_vec3()
            });
            Triangle { corners, ..*triangle }
        }));
    }

    /// A box around the object as it is now.
    pub fn configuration(&self, object: u32, placed: &mut Vec<Triangle>) -> Bound {
        self.place(object, placed);
        Bound::Box(placed.iter().fold(Aabb::EMPTY, |aabb, triangle| aabb.union(&triangle.aabb())))
    }

    /// A TBV of a given shape, from now until `expires`. A shape that needs what is not known of the object's motion (a
    /// trajectory, an acceleration) falls back to a sphere from speed. With `fuzzy` speeds the sphere is one that may be
    /// broken.
    pub fn temporal_bound(
        &self,
        object: u32,
        shape: TbvShape,
        fuzzy: Option<&FuzzySpeeds>,
        expires: WorldTime,
    ) -> TemporalBound {
        let mover = &self.objects[object as usize].mover;
        let speed_max = mover.speed_max() * self.slack;
        let limits = MotionLimits {
            speed_max,
            acceleration_max: mover.acceleration_max(),
            axis_speed_max: DVec3::new(speed_max, 0.0, speed_max),
            reach: self.reach,
        };
        let state = MotionState { position: self.position(object), velocity: mover.place().velocity };
        if let Some(fuzzy) = fuzzy {
            return fuzzy.bound(state, limits, self.now, expires);
        }
        let path = mover.trajectory(self.scene.anchor());
        let shape = match shape {
            TbvShape::Swept { .. } if path.is_none() => TbvShape::SpeedSphere,
            TbvShape::AccelerationSphere if !mover.acceleration_max().is_finite() => TbvShape::SpeedSphere,
            shape => shape,
        };
        TemporalBound::new(shape, state, limits, path, self.now, expires)
    }

    /// Where an object's reference point is now, in the scene's coordinates.
    pub fn position(&self, object: u32) -> DVec3 {
        self.objects[object as usize].mover.place().position - self.scene.anchor()
    }

    /// Learns how far its objects go, from frames that come after the next `skip`.
    ///
    /// # Errors
    /// If too little is seen of them for the probability.
    pub fn learn(
        &self,
        probability: f64,
        skip: u64,
        frame_time: Duration,
        longest: Duration,
    ) -> anyhow::Result<FuzzySpeeds> {
        let mut later = self.clone();
        let step_s = frame_time.as_secs_f64();
        for _ in 0..skip {
            later.step(step_s);
        }
        let frames = 2 * (longest.as_secs_f64() / step_s).ceil() as u64;
        let mut tracks: Vec<Vec<(WorldTime, DVec3)>> = vec![Vec::new(); self.objects.len()];
        for _ in 0..frames {
            later.step(step_s);
            for (object, track) in (0..).zip(&mut tracks) {
                track.push((later.now, later.position(object)));
            }
        }
        Ok(FuzzySpeeds::calibrate(tracks.iter().map(Vec::as_slice), probability, frame_time, longest)?)
    }
}

/// In a corner of a room, from where all of it is in view.
fn still_eye(plan: &RoomPlan, room: usize) -> Eye {
    let clear = plan.rooms[room].clear;
    let at = clear.min + DVec2::splat(0.3);
    let way = clear.center() - at;
    Eye::Still { eye: DVec3::new(at.x, EYE_HEIGHT, at.y), yaw: f64::atan2(-way.x, -way.y) }
}
