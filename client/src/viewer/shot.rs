//! `eyeline-client shot`: one picture of a world, without a window.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Instant;

use anyhow::Context;
use clap::Args;
use eyeline_visibility::{LoadOptions, Resolution, View};
use glam::{DMat3, DQuat, DVec3, Vec2};

use super::gpu::{AdapterChoice, Gpu};
use super::inspect::{self, Inspector, Plan, Show, Stop};
use super::model::Model;
use super::overlay::Overlay;
use super::picture::{FORMAT, Stage};
use super::renderer::Frame;
use super::sight::{CullerKind, Sight};
use crate::app::{number, point, print};

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

/// Options of `shot`.
#[derive(Args, Clone, Debug)]
pub struct Shot {
    #[command(flatten)]
    scenery: Scenery,

    /// Where the eye is, in the model's metres
    #[arg(long, value_name = "X,Y,Z", value_parser = point, allow_hyphen_values = true)]
    eye: DVec3,

    /// A point that it looks at
    #[arg(long, value_name = "X,Y,Z", value_parser = point, allow_hyphen_values = true)]
    look: DVec3,

    /// Width and height in pixels
    #[arg(long, value_name = "WxH", value_parser = resolution, default_value = "1280x720")]
    size: Resolution,

    /// Angle of view from left to right, degrees
    #[arg(long, value_name = "DEGREES", default_value_t = 90.0, value_parser = number(0.1..=179.0, "degrees"))]
    fov: f64,

    /// What is drawn over the scene
    #[arg(long, value_enum, value_name = "WHAT", value_delimiter = ',')]
    overlay: Vec<Show>,

    /// With cells or front: stop PLP's traversal after so many cells
    #[arg(long, value_name = "COUNT")]
    cells: Option<usize>,

    /// With cells or front: PLP's budget, the most triangles that it may project
    #[arg(long, value_name = "TRIANGLES")]
    budget: Option<usize>,

    /// With region: how far the eye may be from --eye, metres
    #[arg(long, value_name = "METRES", default_value_t = 0.25, value_parser = number(0.0..=1e3, "m"))]
    radius: f64,

    /// Look at what was found for --eye from another place
    #[arg(long, value_name = "X,Y,Z", value_parser = point, allow_hyphen_values = true)]
    from: Option<DVec3>,

    /// The point that --from looks at [default: --eye]
    #[arg(long, value_name = "X,Y,Z", value_parser = point, allow_hyphen_values = true, requires = "from")]
    from_look: Option<DVec3>,

    /// The picture, a PNG
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
}

/// Shown by `shot --help`.
pub const EXAMPLES: &str = "Examples:
  eyeline-client shot --world rooms.glb --eye 3,1.6,3 --look 9,1.5,3 --out room.png
  eyeline-client shot --world map.glb --two-sided --eye 3,1.6,3 --look 9,1.5,3 --size 640x360 --out map.png
  eyeline-client shot --world rooms.glb --eye 3,1.6,3 --look 9,1.5,3 --overlay front,inset --budget 2000 --out plp.png
  eyeline-client shot --world rooms.glb --eye 3,1.6,3 --look 9,1.5,3 --overlay frustum --from 3,30,20 --out above.png";

/// Width and height on the command line.
pub fn resolution(text: &str) -> Result<Resolution, String> {
    let parsed =
        text.split_once(['x', 'X']).and_then(|(width, height)| Some((width.parse().ok()?, height.parse().ok()?)));
    match parsed {
        Some((width @ 1..=16_384, height @ 1..=16_384)) => Ok(Resolution::new(width, height)),
        _ => Err("give width and height in pixels, each from 1 to 16384, as in 1280x720".to_owned()),
    }
}

/// The orientation of somebody who looks along `direction` with the head up; `None` if that is no direction.
pub fn looking_along(direction: DVec3) -> Option<DQuat> {
    let back = -direction.try_normalize()?;
    // Straight up or down, any side will do.
    let right = DVec3::Y.cross(back).try_normalize().unwrap_or(DVec3::X);
    Some(DQuat::from_mat3(&DMat3::from_cols(right, back.cross(right), back)))
}

/// Runs `shot`.
///
/// # Errors
/// If there is no adapter, the world can't be loaded, or the picture can't be written.
pub fn shot(options: &Shot) -> anyhow::Result<()> {
    let model = options.scenery.model()?;
    let orientation = looking_along(options.look - options.eye).context("--look is where --eye is")?;
    let view = View {
        eye: options.eye - model.scene.anchor(),
        orientation,
        fov_x: options.fov.to_radians(),
        resolution: options.size,
        near: 0.05,
    };
    view.check()?;
    let gpu = Gpu::offscreen(options.scenery.adapter())?;
    let mut stage = Stage::new(&gpu, &model, &[], FORMAT)?;
    let mut sight = Sight::new(options.scenery.culler, &model.scene);
    let began = Instant::now();
    let culled = sight.look(&view);
    let cull = began.elapsed();
    let overlay = overlay(options, &model, &view, &culled.visible);
    let frame = Frame { view: seen_from(options, &model, view)?, visible: &culled.visible, moving: &[] };
    let began = Instant::now();
    let (picture, stats) = stage.picture(&gpu, &frame, &overlay)?;
    let draw = began.elapsed();
    picture.save(&options.out).with_context(|| format!("cannot write {}", options.out.display()))?;
    print(&format!(
        "{}: {} of {} triangles in {} draw calls on {}; culling {:.2} ms, drawing {:.1} ms\n",
        options.out.display(),
        stats.primitives,
        model.scene.triangles().len(),
        stats.draws,
        gpu.describe(),
        cull.as_secs_f64() * 1e3,
        draw.as_secs_f64() * 1e3,
    ));
    Ok(())
}

/// The view that the picture is taken from.
fn seen_from(options: &Shot, model: &Model, view: View) -> anyhow::Result<View> {
    let Some(from) = options.from else { return Ok(view) };
    let look = options.from_look.unwrap_or(options.eye);
    let orientation = looking_along(look - from).context("--from is where it looks at")?;
    let seen_from = View { eye: from - model.scene.anchor(), orientation, ..view };
    seen_from.check()?;
    Ok(seen_from)
}

/// What is drawn over the scene for `view`.
fn overlay(options: &Shot, model: &Model, view: &View, visible: &[u32]) -> Overlay {
    let mut overlay = Overlay::default();
    let shows = |show| options.overlay.contains(&show);
    let mut inspector = Inspector::new(Arc::clone(&model.scene));
    let stop = Stop { triangles: options.budget.unwrap_or(usize::MAX), cells: options.cells.unwrap_or(usize::MAX) };
    let traversed = (shows(Show::Cells) || shows(Show::Front)).then(|| inspector.traverse(view, stop));
    if let Some(traversed) = traversed.as_ref().filter(|_| shows(Show::Cells)) {
        Inspector::show_cells(&mut overlay, traversed);
    }
    if let Some(traversed) = traversed.as_ref().filter(|_| shows(Show::Front)) {
        Inspector::show_front(&mut overlay, traversed);
    }
    // Tiles lie in the image of the eye that was culled for.
    if shows(Show::Tiles) && options.from.is_none() {
        inspector.show_tiles(&mut overlay, view);
    }
    if shows(Show::Region) {
        inspect::show_region(&mut overlay, view.eye, options.radius);
    }
    if shows(Show::Frustum) {
        inspect::show_frustum(&mut overlay, view, 4.0);
    }
    let scale = f32::max(1.0, (view.resolution.height as f32 / 360.0).floor());
    if shows(Show::Inset) {
        let traversed = traversed.as_ref();
        let plan = Plan { scene: &model.scene, visible, view, seen: &[], hidden: &[], traversed };
        inspect::show_inset(&mut overlay, &plan, scale);
    }
    if shows(Show::Numbers) {
        let total = model.scene.triangles().len();
        let share = 100.0 * visible.len() as f64 / total.max(1) as f64;
        let text = format!("{} of {total} triangles ({share:.1} %)", visible.len());
        overlay.label(&text, Vec2::splat(4.0 * scale), scale, [1.0; 4]);
    }
    overlay
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_look_points_where_it_should_with_the_head_up() {
        for direction in [DVec3::X, DVec3::new(1.0, 2.0, -3.0), DVec3::Y, DVec3::NEG_Y, DVec3::new(0.0, 0.5, 1.0)] {
            let orientation = looking_along(direction).unwrap();
            assert!((orientation * DVec3::NEG_Z).abs_diff_eq(direction.normalize(), 1e-12));
            assert!((orientation * DVec3::X).y.abs() < 1e-12);
            assert!((orientation * DVec3::Y).y > -1e-12);
        }
        assert_eq!(looking_along(DVec3::ZERO), None);
        assert_eq!(looking_along(DVec3::NAN), None);
    }

    #[test]
    fn sizes_are_read() {
        assert_eq!(resolution("640x360"), Ok(Resolution::new(640, 360)));
        for bad in ["", "640", "0x5", "640x", "-1x2", "99999x2"] {
            assert!(resolution(bad).is_err(), "{bad}");
        }
    }
}
