//! What `shot` and `film` have in common: the world that is looked at, the people in it, and what is drawn over it.

use std::path::PathBuf;
use std::sync::Arc;

use clap::{Args, ValueEnum as _};
use eyeline_visibility::{LoadOptions, View};
use glam::{DQuat, DVec3, Vec2};

use super::avatar::{Avatar, Bones, Motion};
use super::gpu::AdapterChoice;
use super::inspect::{self, Inspector, Plan, Show, Stop};
use super::model::{Mesh, Model, capsule};
use super::overlay::Overlay;
use super::renderer::Moving;
use super::sight::CullerKind;
use super::walk::Body;
use crate::app::number;

/// The world that is looked at, and how.
#[derive(Args, Clone, Debug)]
pub struct Scenery {
    /// The model: a .glb, or a .gltf with its buffers and images in its folder
    #[arg(long, value_name = "FILE")]
    pub world: PathBuf,

    /// Draw every face from both sides, whatever its material says; maps with openings to the void need it
    #[arg(long)]
    pub two_sided: bool,

    /// What decides what is drawn
    #[arg(long, value_enum, default_value_t)]
    pub culler: CullerKind,

    /// Draw in software even if there is a GPU: the same picture on every machine
    #[arg(long)]
    pub software: bool,
}

impl Scenery {
    /// Loads the model, saying on the way what it lacks.
    ///
    /// # Errors
    /// If it can't be loaded.
    pub fn model(&self) -> anyhow::Result<Model> {
        let model = Model::load_file(&self.world, &LoadOptions::default().with_two_sided(self.two_sided))?;
        model.warnings.iter().for_each(|warning| tracing::warn!("{warning}"));
        Ok(model)
    }

    /// Which adapters will do.
    pub fn adapter(&self) -> AdapterChoice {
        if self.software { AdapterChoice::Software } else { AdapterChoice::Best }
    }
}

/// Somebody who stands in a picture: the feet in the model's metres, and degrees to the left of −Z.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Person {
    /// Where the feet are.
    pub feet: DVec3,
    /// How they are turned, degrees.
    pub yaw: f64,
}

fn person(text: &str) -> Result<Person, String> {
    let numbers: Option<Vec<f64>> =
        text.split(',').map(|part| part.trim().parse().ok().filter(|number: &f64| number.is_finite())).collect();
    match numbers.as_deref() {
        Some(&[x, y, z]) => Ok(Person { feet: DVec3::new(x, y, z), yaw: 0.0 }),
        Some(&[x, y, z, yaw]) => Ok(Person { feet: DVec3::new(x, y, z), yaw }),
        _ => Err("give X,Y,Z or X,Y,Z,DEGREES, as in 1.5,0,-3,90".to_owned()),
    }
}

/// People who are put into a picture.
#[derive(Args, Clone, Debug)]
pub struct Staffage {
    /// Somebody who stands there: the feet in the model's metres, and degrees to the left of -Z. May be given more than once
    #[arg(long, value_name = "X,Y,Z[,DEGREES]", value_parser = person, allow_hyphen_values = true)]
    person: Vec<Person>,

    /// What people look like: a glTF model with a skin, whose clips named like idle, walk and run are played
    /// [default: capsules]
    #[arg(long, value_name = "FILE")]
    avatar: Option<PathBuf>,

    /// How fast people walk on the spot, metres a second
    #[arg(long, value_name = "SPEED", default_value_t = 0.0, value_parser = number(0.0..=20.0, "m/s"))]
    pace: f64,
}

/// People, ready to be drawn.
pub struct Cast {
    persons: Vec<Person>,
    pace: f64,
    avatar: Option<Avatar>,
    /// Their meshes, behind the model's own.
    pub meshes: Vec<Mesh>,
}

impl Staffage {
    /// Loads what people look like; its textures join the model's.
    ///
    /// # Errors
    /// If there is an avatar and it can't be had.
    pub fn cast(&self, model: &mut Model) -> anyhow::Result<Cast> {
        let Body { radius, height, .. } = Body::default();
        let avatar =
            self.avatar.as_ref().map(|path| Avatar::load_file(path, model, radius, 0.0, height)).transpose()?;
        let mesh = avatar.as_ref().map_or_else(|| capsule(radius, 0.0, height), |avatar| avatar.mesh().clone());
        Ok(Cast { persons: self.person.clone(), pace: self.pace, avatar, meshes: vec![mesh] })
    }
}

impl Cast {
    /// Everybody, `seconds` after they began to move. Bones are added to `bones`.
    pub fn at(&self, seconds: f64, model: &Model, bones: &mut Bones) -> Vec<Moving> {
        let person = |(number, person): (usize, &Person)| {
            let first_bone = self.avatar.as_ref().map(|avatar| {
                // Nobody moves in step with their neighbour.
                let at = seconds + 0.37 * number as f64;
                bones.pose(avatar, &Motion::at(avatar, self.pace, at))
            });
            Moving {
                mesh: model.objects.len(),
                position: person.feet - model.scene.anchor(),
                orientation: DQuat::from_rotation_y(person.yaw.to_radians()),
                tint: if first_bone.is_some() { [1.0; 3] } else { super::viewing::hue(number as u32) },
                first_bone,
            }
        };
        self.persons.iter().enumerate().map(person).collect()
    }
}

/// What is drawn over a picture.
#[derive(Args, Clone, Debug)]
pub struct Over {
    /// What is drawn over the scene
    #[arg(long, value_enum, value_name = "WHAT", value_delimiter = ',')]
    overlay: Vec<Show>,

    /// With cells or front: stop PLP's traversal after so many cells
    #[arg(long, value_name = "COUNT")]
    cells: Option<usize>,

    /// With cells or front: PLP's budget, the most triangles that it may project
    #[arg(long, value_name = "TRIANGLES")]
    budget: Option<usize>,

    /// With region: how far the eye may be from where it is, metres
    #[arg(long, value_name = "METRES", default_value_t = 0.25, value_parser = number(0.0..=1e3, "m"))]
    radius: f64,
}

/// What is looked at: a view and what was found for it.
pub struct Found<'a> {
    /// The world.
    pub model: &'a Model,
    /// The view that was culled for.
    pub view: &'a View,
    /// What it sees.
    pub visible: &'a [u32],
    /// Whether the picture is taken from that view.
    pub is_from_there: bool,
}

impl Over {
    /// Whether something is shown.
    pub fn shows(&self, show: Show) -> bool {
        self.overlay.contains(&show)
    }

    /// Whether all of it can be shown without a window: a picture has no connection and no past.
    ///
    /// # Errors
    /// If not, with the overlay's name and where it can be seen.
    pub fn check(&self) -> anyhow::Result<()> {
        let needs = |show| match show {
            Show::Hidden => Some("shows what a connected client holds hidden"),
            Show::Charts => Some("shows the seconds before, which a picture has not"),
            _ => None,
        };
        for &show in &self.overlay {
            if let (Some(why), Some(value)) = (needs(show), show.to_possible_value()) {
                anyhow::bail!(
                    "--overlay {0} {why}; see it with: eyeline-client view --connect HOST:PORT --overlay {0}",
                    value.get_name()
                );
            }
        }
        Ok(())
    }

    /// What is drawn over the scene.
    pub fn draw(&self, inspector: &mut Inspector, found: &Found<'_>) -> Overlay {
        let Found { model, view, visible, is_from_there } = *found;
        let mut overlay = Overlay::default();
        let stop = Stop { triangles: self.budget.unwrap_or(usize::MAX), cells: self.cells.unwrap_or(usize::MAX) };
        let wants_cells = self.shows(Show::Cells) || self.shows(Show::Front);
        let traversed = wants_cells.then(|| inspector.traverse(view, stop));
        if let Some(traversed) = traversed.as_ref().filter(|_| self.shows(Show::Cells)) {
            Inspector::show_cells(&mut overlay, traversed);
        }
        if let Some(traversed) = traversed.as_ref().filter(|_| self.shows(Show::Front)) {
            Inspector::show_front(&mut overlay, traversed);
        }
        // Both lie in the image of the eye that was culled for.
        if self.shows(Show::Tiles) && is_from_there {
            inspector.show_tiles(&mut overlay, view);
        }
        if self.shows(Show::Occupancy) && is_from_there {
            inspector.show_occupancy(&mut overlay, view);
        }
        if self.shows(Show::Region) {
            inspect::show_region(&mut overlay, view.eye, self.radius);
        }
        if self.shows(Show::Frustum) {
            inspect::show_frustum(&mut overlay, view, 4.0);
        }
        let scale = f32::max(1.0, (view.resolution.height as f32 / 360.0).floor());
        if self.shows(Show::Inset) {
            let traversed = traversed.as_ref();
            let plan = Plan { scene: &model.scene, visible, view, seen: &[], hidden: &[], traversed };
            inspect::show_inset(&mut overlay, &plan, scale);
        }
        if self.shows(Show::Numbers) {
            let total = model.scene.triangles().len();
            let share = 100.0 * visible.len() as f64 / total.max(1) as f64;
            let text = format!("{} of {total} triangles ({share:.1} %)", visible.len());
            overlay.label(&text, Vec2::splat(4.0 * scale), scale, [1.0; 4]);
        }
        overlay
    }
}

/// An inspector for a model.
pub fn inspector(model: &Model) -> Inspector {
    Inspector::new(Arc::clone(&model.scene))
}
