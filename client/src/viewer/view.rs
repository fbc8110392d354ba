//! `eyeline-client view`: a window into a world, with a server or without.

use std::path::PathBuf;
use std::time::Duration;

use anyhow::Context;
use clap::Args;
use eyeline_protocol::{PlanSwitch, Welcome};
use eyeline_visibility::{LoadOptions, Resolution};
use glam::DVec3;

use super::gpu::AdapterChoice;
use super::inspect::Show;
use super::model::Model;
use super::online::{Joined, Online, OnlineOptions};
use super::player::Player;
use super::shot::resolution;
use super::sight::CullerKind;
use super::viewing::Viewing;
use super::walk::Body;
use super::window::{self, WindowOptions};
use crate::app::{WorldOptions, number, point};
use crate::target::Target;

/// Options of `view`.
#[derive(Args, Clone, Debug)]
pub struct ViewOptions {
    #[command(flatten)]
    target: Target,

    #[command(flatten)]
    world: WorldOptions,

    /// Without a server: where the eye begins, in the model's metres [default: in the middle, above the floor]
    #[arg(long, value_name = "X,Y,Z", value_parser = point, allow_hyphen_values = true)]
    eye: Option<DVec3>,

    /// Without a server: a point to look at first
    #[arg(long, value_name = "X,Y,Z", value_parser = point, allow_hyphen_values = true)]
    look: Option<DVec3>,

    /// With a server: have no avatar and look from this point; needs a token that lets one fly, or a server that lets anybody
    #[arg(long, value_name = "X,Y,Z", value_parser = point, allow_hyphen_values = true)]
    fly: Option<DVec3>,

    /// A name for people
    #[arg(long, default_value = "viewer")]
    name: String,

    /// Without a server: draw every face from both sides; a server says so itself
    #[arg(long)]
    two_sided: bool,

    /// What decides what is drawn
    #[arg(long, value_enum, default_value_t)]
    culler: CullerKind,

    /// What is left out with --culler plan and with a server: as counted (auto), nothing (full), or single stages on or off:
    /// frustum, occlusion, prisms; tracker, look-again, exact
    #[arg(long, value_name = "auto|full|STAGE=on,…", default_value_t)]
    plan: PlanSwitch,

    /// What is drawn over the scene from the start
    #[arg(long, value_enum, value_name = "WHAT", value_delimiter = ',')]
    overlay: Vec<Show>,

    /// Size of the window in logical pixels
    #[arg(long, value_name = "WxH", value_parser = resolution, default_value = "1280x720")]
    size: Resolution,

    /// Angle of view from left to right, degrees
    #[arg(long, value_name = "DEGREES", default_value_t = 80.0, value_parser = number(1.0..=170.0, "degrees"))]
    fov: f64,

    /// With a server: pixels a side of the six images that decide what is hidden
    #[arg(long, value_name = "PIXELS", default_value_t = 128, value_parser = clap::value_parser!(u32).range(8..=1024))]
    side: u32,

    /// Draw in software even if there is a GPU
    #[arg(long)]
    software: bool,

    /// Folder for pictures taken with P
    #[arg(long, value_name = "DIR", default_value = ".")]
    pictures: PathBuf,

    /// What people look like: a glTF model with a skin, whose clips named like idle, walk and run are played
    /// [default: capsules]
    #[arg(long, value_name = "FILE")]
    avatar: Option<PathBuf>,

    /// Write the way that is gone, as a camera path for `film` and `eyeline-sim cull --path`, when the window closes
    #[arg(long, value_name = "FILE")]
    record: Option<PathBuf>,

    /// End after so long
    #[arg(long, value_name = "SECONDS", value_parser = number(0.1..=1e6, "s"))]
    seconds: Option<f64>,
}

/// Shown by `view --help`.
pub const EXAMPLES: &str = "Keys:
  W A S D, arrows    walk, turn; click takes the mouse, Esc gives it back, and then ends
  Shift              run
  F, Space, C        fly where one may, up, down
  1 to 8             cells, front, tiles, hidden, region, frustum, inset, numbers
  9 0 -              charts, occupancy map, depth
  R                  freeze what is culled for, and look at it from outside
  N, B, V            one cell more, one less, all cells of the traversal that is shown
  P                  write a picture

Examples:
  eyeline-client view --world rooms.glb
  eyeline-client view --server-file ready.txt --overlay inset,numbers --name Ada
  eyeline-client view --server-file ready.txt --avatar Fox.glb --overlay charts
  eyeline-client view --world rooms.glb --record walk.json";

/// Runs `view`.
///
/// # Errors
/// If the world can't be had, no window can be opened, or the device or the connection is lost.
pub fn view(options: &ViewOptions) -> anyhow::Result<()> {
    let mut viewing = if options.target.is_given() { connected(options)? } else { alone(options)? };
    if let Some(file) = &options.avatar {
        viewing.dress(file)?;
    }
    viewing.fov_x = options.fov.to_radians();
    viewing.shows.extend(options.overlay.iter().copied());
    let name = options.world.world.as_ref().and_then(|path| path.file_name());
    let title = name.map_or("Eyeline".to_owned(), |name| format!("Eyeline: {}", name.to_string_lossy()));
    window::run(
        viewing,
        WindowOptions {
            size: options.size,
            title,
            adapter: if options.software { AdapterChoice::Software } else { AdapterChoice::Best },
            pictures: options.pictures.clone(),
            end_after: options.seconds.map(Duration::from_secs_f64),
            record: options.record.clone(),
        },
    )
}

fn warn(model: &Model) {
    model.warnings.iter().for_each(|warning| tracing::warn!("{warning}"));
}

fn alone(options: &ViewOptions) -> anyhow::Result<Viewing> {
    let path =
        options.world.world.as_ref().context("give --world FILE, or a server with --connect or --server-file")?;
    let model = Model::load_file(path, &LoadOptions::default().with_two_sided(options.two_sided))?;
    warn(&model);
    let bounds = model.scene.bounds();
    let middle = if bounds.is_empty() { DVec3::ZERO } else { bounds.centre() };
    let body = Body::default();
    let eye = match options.eye {
        Some(eye) => eye - model.scene.anchor(),
        None => middle,
    };
    let mut player = Player::new(eye, 0.0, body);
    if let Some(look) = options.look {
        player.look_along(look - model.scene.anchor() - eye);
    }
    Ok(Viewing::new(model, options.culler, options.plan, player, None))
}

fn connected(options: &ViewOptions) -> anyhow::Result<Viewing> {
    let joined = Online::join(OnlineOptions {
        target: options.target.clone(),
        source: options.world.source(),
        name: options.name.clone(),
        fly: options.fly,
        frame_hz: 30.0,
        side: options.side,
        plan: options.plan,
    })?;
    let Joined { online, model, welcome, eye, yaw } = joined;
    warn(&model);
    let mut player = Player::new(eye, yaw, Viewing::body(&welcome));
    player.speeds = speeds(&welcome, player.speeds);
    player.is_flying = options.fly.is_some();
    let mut viewing = Viewing::new(model, options.culler, options.plan, player, Some((online, welcome)));
    viewing.may_fly = options.fly.is_some();
    Ok(viewing)
}

/// As fast as one likes, but a little slower than the server lets anybody be: it believes no pose that is too fast.
fn speeds(welcome: &Welcome, usual: [f64; 2]) -> [f64; 2] {
    let most = welcome.classes.first().map_or(f64::INFINITY, |class| class.motion.speed_max * 0.95);
    usual.map(|speed| speed.min(most))
}
