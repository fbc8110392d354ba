//! `eyeline-client shot`: one picture of a world, without a window.

use std::path::PathBuf;
use std::time::Instant;

use anyhow::Context;
use clap::Args;
use eyeline_visibility::{Resolution, View};
use glam::{DMat3, DQuat, DVec3};

use super::gpu::Gpu;
use super::inspect::Show;
use super::model::Model;
use super::picture::{FORMAT, Stage};
use super::renderer::{Frame, Shade};
use super::sight::Sight;
use super::staging::{Found, Over, Scenery, Staffage, inspector};
use crate::app::{number, point, print};

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

    #[command(flatten)]
    over: Over,

    #[command(flatten)]
    staffage: Staffage,

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
  eyeline-client shot --world rooms.glb --eye 3,1.6,3 --look 9,1.5,3 --overlay frustum --from 3,30,20 --out above.png
  eyeline-client shot --world rooms.glb --eye 3,1.6,3 --look 9,1.5,3 --person 7,0,3,90 --avatar Fox.glb --out fox.png";

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
    options.over.check()?;
    let mut model = options.scenery.model()?;
    let cast = options.staffage.cast(&mut model)?;
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
    let mut stage = Stage::new(&gpu, &model, &cast.meshes, FORMAT)?;
    let mut sight = Sight::new(options.scenery.culler, &model.scene);
    let began = Instant::now();
    let culled = sight.look(&view);
    let cull = began.elapsed();
    let visible = &culled.visible[..];
    let found = Found { model: &model, view: &view, visible, is_from_there: options.from.is_none() };
    let overlay = options.over.draw(&mut inspector(&model), &found);
    let moving = cast.at(0.0, &model, &mut stage.renderer.bones);
    stage.renderer.shade = if options.over.shows(Show::Depth) { Shade::Depth } else { Shade::Lit };
    let frame = Frame { view: seen_from(options, &model, view)?, visible, moving: &moving };
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
