//! A world as it is being looked at: who is where, what is frozen, what is shown over it. No window and no GPU: in go seconds and
//! keys, out comes what is to be drawn.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use eyeline_protocol::{Class, Extent, ObjectId, PlanSwitch, Welcome};
use eyeline_visibility::{Resolution, View};
use glam::{DQuat, DVec3, Vec2};

use super::avatar::{Avatar, Bones, Motion};
use super::charts::{Charts, Sample};
use super::font;
use super::inspect::{self, Inspector, Plan, Show, Stop, pixel};
use super::model::{Mesh, Model, ModelError, capsule};
use super::online::{News, Online, Seen};
use super::overlay::Overlay;
use super::player::{Held, Player};
use super::renderer::{Moving, Shade};
use super::sight::{CullerKind, Sight};
use super::walk::{Body, Ground};

/// What is to be drawn.
pub struct Composed {
    /// From where.
    pub view: View,
    /// Ids of the static triangles, ascending.
    pub visible: Vec<u32>,
    /// What moves.
    pub moving: Vec<Moving>,
    /// The bones of people.
    pub bones: Bones,
    /// What surfaces are drawn as.
    pub shade: Shade,
    /// What is drawn over it.
    pub overlay: Overlay,
}

/// Where an object is drawn, which glides to where it is.
#[derive(Clone, Copy, Debug)]
struct Shown {
    position: DVec3,
    orientation: DQuat,
    motion: Motion,
}

/// For so long a wrong place is glided out of, seconds: to a third of it.
const GLIDE: f64 = 0.1;
/// Who was wrong by more jumps, metres: a glide through a room is no smoother.
const JUMP: f64 = 2.0;

/// A world that is looked at.
pub struct Viewing {
    model: Model,
    ground: Ground,
    sight: Sight,
    inspector: Inspector,
    online: Option<(Online, Welcome)>,
    news: News,
    shown: BTreeMap<ObjectId, Shown>,
    /// What people look like, if not like capsules.
    avatar: Option<Avatar>,
    bones: Bones,
    charts: Charts,
    drew: Duration,
    /// Who looks.
    pub player: Player,
    /// Whether one may fly.
    pub may_fly: bool,
    /// Angle of view from left to right, radians.
    pub fov_x: f64,
    /// What is shown over the scene.
    pub shows: BTreeSet<Show>,
    /// Where traversals that are shown stop.
    pub stop: Stop,
    /// The view that is culled for while one looks from elsewhere, and what it saw.
    frozen: Option<(View, Vec<u32>)>,
    frame: Seconds,
}

/// Means over about a second.
#[derive(Clone, Copy, Debug, Default)]
struct Seconds {
    frame: f64,
    cull: f64,
}

impl Seconds {
    fn add(&mut self, frame: f64, cull: f64) {
        let share = (frame / 0.5).clamp(0.0, 1.0);
        self.frame += (frame - self.frame) * share;
        self.cull += (cull - self.cull) * share;
    }
}

impl Viewing {
    /// Looks at a model, connected or not.
    pub fn new(
        model: Model,
        culler: CullerKind,
        plan: PlanSwitch,
        player: Player,
        online: Option<(Online, Welcome)>,
    ) -> Viewing {
        Viewing {
            ground: Ground::new(&model.scene),
            sight: Sight::with_plan(culler, &model.scene, plan).in_background(),
            inspector: Inspector::new(Arc::clone(&model.scene)),
            may_fly: online.is_none(),
            model,
            online,
            news: News::default(),
            shown: BTreeMap::new(),
            avatar: None,
            bones: Bones::default(),
            charts: Charts::default(),
            drew: Duration::ZERO,
            player,
            fov_x: 1.4,
            shows: BTreeSet::new(),
            stop: Stop::default(),
            frozen: None,
            frame: Seconds::default(),
        }
    }

    /// The model.
    pub fn model(&self) -> &Model {
        &self.model
    }

    /// Bodies for classes without a mesh, in the order of classes, behind the model's own objects.
    pub fn bodies(&self) -> Vec<Mesh> {
        let classes = self.online.as_ref().map_or(&[][..], |(_, welcome)| &welcome.classes);
        let body = |(class, of): (usize, &Class)| match self.avatar.as_ref().filter(|_| class == 0) {
            Some(avatar) => avatar.mesh().clone(),
            None => capsule(of.extent.radius, of.extent.bottom, of.extent.top),
        };
        classes.iter().enumerate().map(body).collect()
    }

    /// Has people look like a model with a skin. Ahead of [`Viewing::bodies`].
    ///
    /// # Errors
    /// If it can't be had.
    pub fn dress(&mut self, file: &Path) -> Result<(), ModelError> {
        // Avatars are the first class.
        let class = self.online.as_ref().and_then(|(_, welcome)| welcome.classes.first());
        let Extent { radius, bottom, top } = class.map_or_else(usual_extent, |class| class.extent);
        self.avatar = Some(Avatar::load_file(file, &mut self.model, radius, bottom, top)?);
        Ok(())
    }

    /// What drawing the last frame took, for the charts.
    pub fn drew(&mut self, took: Duration) {
        self.drew = took;
    }

    /// Puts a frame into the charts.
    fn measure(&mut self, seconds: f64, visible: usize, cull: Duration) {
        let ms = |took: Duration| took.as_secs_f64() * 1e3;
        let numbers = &self.news.numbers;
        let (counts, stages) = match &self.online {
            Some(_) => {
                let (seen, hidden, _) = numbers.counts;
                ([seen, hidden], [ms(cull) + ms(numbers.took.0), ms(numbers.took.1), ms(self.drew)])
            }
            None => ([visible, self.model.scene.triangles().len() - visible], [ms(cull), 0.0, ms(self.drew)]),
        };
        let messages = [numbers.messages.1, numbers.messages.0];
        let sample = Sample { messages, counts: counts.map(|count| count as f64), stages };
        self.charts.add(seconds, &sample);
    }

    /// The measures of one's own body, as the server has them.
    pub fn body(welcome: &Welcome) -> Body {
        let usual = Body::default();
        let Some(class) = welcome.classes.first() else { return usual };
        let height = class.extent.top - class.extent.bottom;
        let eye = class.eye_height - class.extent.bottom;
        let is_sane = height > 0.2 && height < 100.0 && eye > 0.0 && eye <= height && class.extent.radius > 0.01;
        if !is_sane {
            return usual;
        }
        // A body as wide as its bound would get through few doors.
        let radius = class.extent.radius.min(usual.radius);
        Body { radius, height, eye, step: (0.26 * height).min(usual.step) }
    }

    /// Freezes what is culled for, or looks through one's own eyes again.
    pub fn freeze(&mut self, resolution: Resolution) {
        self.frozen = match self.frozen.take() {
            Some(_) => None,
            None => {
                let view = self.view(resolution);
                Some((view, self.sight.look(&view).visible.clone()))
            }
        };
    }

    /// Whether what is culled for is frozen.
    pub fn is_frozen(&self) -> bool {
        self.frozen.is_some()
    }

    /// Objects in sight, held hidden, and asked about, as of the tracker's newest frame.
    pub fn counts(&self) -> (usize, usize, usize) {
        self.news.numbers.counts
    }

    /// Why the connection is over, if it is.
    pub fn ended(&self) -> Option<&str> {
        self.news.ended.as_deref()
    }

    fn view(&self, resolution: Resolution) -> View {
        View {
            eye: self.player.eye(),
            orientation: self.player.orientation(),
            fov_x: self.fov_x,
            resolution,
            near: 0.05,
        }
    }

    /// Goes on by so many seconds and composes a frame. `cull_took` is what its culling takes, measured by the caller's clock.
    pub fn frame(
        &mut self,
        held: Held,
        seconds: f64,
        resolution: Resolution,
        scale: f32,
        cull_took: impl FnOnce(&mut dyn FnMut()) -> Duration,
    ) -> Composed {
        // A frame that took long is not walked through all at once.
        let step = seconds.clamp(0.0, 0.25);
        let may_walk_out = self.may_fly || self.frozen.is_some();
        self.player.is_flying &= may_walk_out;
        self.player.go(held, &self.ground, step);
        let view = self.view(resolution);
        if let Some((online, _)) = &self.online {
            // Whoever looks from elsewhere stays where they were.
            let (eye, yaw) =
                self.frozen.as_ref().map_or((view.eye, self.player.yaw), |(frozen, _)| (frozen.eye, yaw_of(frozen)));
            self.news = online.exchange(eye, yaw, self.shows.contains(&Show::Hidden));
        }
        self.glide(step);
        let mut visible = Vec::new();
        let took = match &self.frozen {
            Some((_, frozen)) => {
                visible.clone_from(frozen);
                Duration::ZERO
            }
            None => cull_took(&mut || visible.clone_from(&self.sight.look(&view).visible)),
        };
        self.frame.add(seconds, took.as_secs_f64());
        self.bones.clear();
        let shown: Vec<_> = self.shown.iter().map(|(object, shown)| (*object, *shown)).collect();
        let moving = shown.iter().filter_map(|(object, shown)| self.moving(*object, shown)).collect();
        self.measure(seconds, visible.len(), took);
        let overlay = self.overlay(&view, &visible, scale);
        let shade = if self.shows.contains(&Show::Depth) { Shade::Depth } else { Shade::Lit };
        Composed { view, visible, moving, bones: self.bones.clone(), shade, overlay }
    }

    /// Moves what is shown to where it is by now.
    fn glide(&mut self, seconds: f64) {
        let age = self.news.at.map_or(0.0, |at| at.elapsed().as_secs_f64().min(0.5));
        let stay = (-seconds / GLIDE).exp();
        let mut before = std::mem::take(&mut self.shown);
        for Seen { object, position, velocity, orientation } in &self.news.seen {
            let (position, orientation) = (*position + *velocity * age, *orientation);
            let mut shown = match before.remove(object) {
                Some(shown) if shown.position.distance(position) < JUMP => {
                    let position = position.lerp(shown.position + *velocity * seconds, stay);
                    let orientation = orientation.slerp(shown.orientation, stay).normalize();
                    Shown { position, orientation, motion: shown.motion }
                }
                _ => Shown { position, orientation, motion: Motion::default() },
            };
            if let Some(avatar) = &self.avatar {
                shown.motion.go_on(avatar, velocity.length(), seconds);
            }
            self.shown.insert(*object, shown);
        }
    }

    fn moving(&mut self, object: ObjectId, shown: &Shown) -> Option<Moving> {
        let named = self.news.names.get(&object)?;
        let of_node = self.model.objects.iter().position(|mesh| !named.node.is_empty() && mesh.name == named.node);
        let mesh = of_node.unwrap_or(self.model.objects.len() + usize::from(named.class.0));
        let body = if of_node.is_none() && named.class.0 == 0 { self.avatar.as_ref() } else { None };
        let first_bone = body.map(|avatar| self.bones.pose(avatar, &shown.motion));
        // People without a look of their own are told apart by colour.
        let tint = if of_node.is_some() || body.is_some() { [1.0; 3] } else { hue(object.0) };
        Some(Moving { mesh, position: shown.position, orientation: shown.orientation, tint, first_bone })
    }

    fn overlay(&mut self, view: &View, visible: &[u32], scale: f32) -> Overlay {
        let mut overlay = Overlay::default();
        let shows = |show| self.shows.contains(&show);
        let looked = self.frozen.as_ref().map_or(*view, |(frozen, _)| *frozen);
        let wants_cells = shows(Show::Cells) || shows(Show::Front);
        let traversed = if wants_cells { Some(self.inspector.traverse(&looked, self.stop)) } else { None };
        if let Some(traversed) = traversed.as_ref().filter(|_| self.shows.contains(&Show::Cells)) {
            Inspector::show_cells(&mut overlay, traversed);
        }
        if let Some(traversed) = traversed.as_ref().filter(|_| self.shows.contains(&Show::Front)) {
            Inspector::show_front(&mut overlay, traversed);
        }
        if self.shows.contains(&Show::Tiles) && self.frozen.is_none() {
            self.inspector.show_tiles(&mut overlay, view);
        }
        if self.shows.contains(&Show::Occupancy) && self.frozen.is_none() {
            self.inspector.show_occupancy(&mut overlay, view);
        }
        let shows = |show| self.shows.contains(&show);
        if shows(Show::Hidden) {
            inspect::show_hidden(&mut overlay, &self.news.hidden, view, scale);
        }
        // From inside, these are nothing but lines before one's eyes.
        if self.frozen.is_some() && shows(Show::Region) {
            inspect::show_region(&mut overlay, looked.eye, self.news.numbers.eye_radius);
        }
        if self.frozen.is_some() && shows(Show::Frustum) {
            inspect::show_frustum(&mut overlay, &looked, 4.0);
        }
        self.names(&mut overlay, view, scale);
        if shows(Show::Inset) {
            let seen: Vec<_> = self.shown.values().map(|shown| shown.position).collect();
            let (scene, hidden) = (&self.model.scene, &self.news.hidden[..]);
            let plan = Plan { scene, visible, view: &looked, seen: &seen, hidden, traversed: traversed.as_ref() };
            inspect::show_inset(&mut overlay, &plan, scale);
        }
        if shows(Show::Charts) {
            let counted = if self.online.is_some() { "objects" } else { "triangles" };
            self.charts.draw(&mut overlay, view.resolution, (scale * 0.5).max(1.0), counted);
        }
        if shows(Show::Numbers) {
            overlay.label(&self.numbers(visible.len()), Vec2::splat(4.0 * scale), scale, [1.0; 4]);
        }
        overlay
    }

    /// Names over heads.
    fn names(&self, overlay: &mut Overlay, view: &View, scale: f32) {
        for (object, shown) in &self.shown {
            let Some(named) = self.news.names.get(object).filter(|named| !named.name.is_empty()) else { continue };
            let class = self.online.as_ref().and_then(|(_, welcome)| welcome.classes.get(usize::from(named.class.0)));
            let top = class.map_or(2.0, |class| class.extent.top);
            let Some(at) = pixel(view, shown.position + DVec3::Y * (top + 0.15)) else { continue };
            let name: String = named.name.chars().filter(|letter| !letter.is_control()).take(24).collect();
            // People before things, which are many.
            let scale = if named.node.is_empty() { scale } else { (scale * 0.5).floor().max(1.0) };
            let half = font::size(&name) * scale * 0.5;
            overlay.label(&name, (at - half).floor(), scale, [1.0; 4]);
        }
    }

    fn numbers(&self, visible: usize) -> String {
        let total = self.model.scene.triangles().len();
        let Seconds { frame, cull } = self.frame;
        let mut text =
            format!("{:.1} ms a frame, culling {:.2} ms\n{visible} of {total} triangles", frame * 1e3, cull * 1e3);
        if self.frozen.is_some() {
            text += "\nfrozen";
        }
        if self.player.is_flying {
            text += "\nflying";
        }
        if self.online.is_some() {
            let numbers = &self.news.numbers;
            let (seen, hidden, asked) = numbers.counts;
            let (cull, track) = numbers.took;
            text += &format!(
                "\n{seen} in sight, {hidden} hidden, {asked} asked for\n{} messages in, {} out\nall round {:.2} ms, tracking {:.2} ms",
                numbers.messages.0,
                numbers.messages.1,
                cull.as_secs_f64() * 1e3,
                track.as_secs_f64() * 1e3,
            );
            if let Some(round_trip) = numbers.round_trip {
                text += &format!("\nround trip {:.1} ms", round_trip.as_secs_f64() * 1e3);
            }
        }
        text
    }
}

fn usual_extent() -> Extent {
    let Body { radius, height, .. } = Body::default();
    Extent { radius, bottom: 0.0, top: height }
}

fn yaw_of(view: &View) -> f64 {
    let forward = view.orientation * DVec3::NEG_Z;
    (-forward.x).atan2(-forward.z)
}

/// A colour that tells one person from the next: hues a golden section apart.
pub fn hue(number: u32) -> [f32; 3] {
    let hue = f64::from(number) * 0.618_034 * std::f64::consts::TAU;
    [0.0, 2.1, 4.2].map(|shift: f64| (0.55 + 0.4 * (hue + shift).cos()) as f32)
}
