//! `eyeline-client film`: a recorded path as numbered pictures, for whatever makes films of them.

use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;

use anyhow::Context;
use clap::Args;
use eyeline_visibility::{CameraPath, Resolution, View};
use glam::DVec3;
use indicatif::{ProgressBar, ProgressStyle};

use super::gpu::Gpu;
use super::inspect::Show;
use super::picture::{FORMAT, Stage};
use super::renderer::{Frame, Shade};
use super::shot::resolution;
use super::sight::Sight;
use super::staging::{Found, Over, Scenery, Staffage, inspector};
use crate::app::{interrupted, number, print};

/// Options of `film`.
#[derive(Args, Clone, Debug)]
pub struct Film {
    #[command(flatten)]
    scenery: Scenery,

    /// The way: a camera path as `view --record` and `eyeline-sim cull --record` write it
    #[arg(long, value_name = "FILE")]
    path: PathBuf,

    /// Folder for the frames, frame-00000.png and so on; made if it is not there
    #[arg(long, value_name = "DIR")]
    out: PathBuf,

    /// Width and height in pixels [default: the path's, else 1280x720]
    #[arg(long, value_name = "WxH", value_parser = resolution)]
    size: Option<Resolution>,

    /// The first camera of the path that is filmed, counted from 0
    #[arg(long, value_name = "CAMERA", default_value_t = 0)]
    from: usize,

    /// The last one [default: the path's last]
    #[arg(long, value_name = "CAMERA")]
    to: Option<usize>,

    /// One frame for every so many cameras
    #[arg(long, value_name = "COUNT", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..))]
    every: u32,

    /// Frames a second, between the cameras where need be; the path must say how many of them there are to a second, or
    /// they are taken for 30 [default: a frame for each camera]
    #[arg(long, value_name = "HZ", conflicts_with = "every", value_parser = number(0.1..=240.0, "Hz"))]
    fps: Option<f64>,

    /// Frames that are in the folder already are in the way, unless this is given: then they are removed
    #[arg(long)]
    overwrite: bool,

    #[command(flatten)]
    over: Over,

    #[command(flatten)]
    staffage: Staffage,
}

/// Shown by `film --help`.
pub const EXAMPLES: &str = "Examples:
  eyeline-client view --world rooms.glb --record walk.json
  eyeline-client film --world rooms.glb --path walk.json --out frames --fps 25 --overlay inset,numbers
  eyeline-client film --world rooms.glb --path cameras.json --out frames --every 10 --from 100 --to 500 --size 640x360";

/// Cameras a second of a path that does not say.
const HZ: f64 = 30.0;

/// Runs `film`.
///
/// # Errors
/// If the path or the world can't be had, there is no adapter, a frame can't be written, or Ctrl-C ends it.
pub fn film(options: &Film) -> anyhow::Result<()> {
    options.over.check()?;
    let path = CameraPath::read(&options.path)?;
    let hz = path.hz.unwrap_or(HZ);
    let size = options.size.or(path.resolution.map(|[width, height]| Resolution::new(width, height)));
    let mut model = options.scenery.model()?;
    let views = path.views(model.scene.anchor(), size.unwrap_or(Resolution::new(1280, 720)));
    let part = part(&views, options)?;
    let (views, rate) = match options.fps {
        Some(fps) => (resampled(part, hz, fps), fps),
        None => (part.iter().step_by(options.every as usize).copied().collect(), hz / f64::from(options.every)),
    };
    views.iter().try_for_each(View::check)?;
    prepare(&options.out, options.overwrite)?;
    let interrupted = interrupted()?;
    let cast = options.staffage.cast(&mut model)?;
    let gpu = Gpu::offscreen(options.scenery.adapter())?;
    let mut stage = Stage::new(&gpu, &model, &cast.meshes, FORMAT)?;
    stage.renderer.shade = if options.over.shows(Show::Depth) { Shade::Depth } else { Shade::Lit };
    let mut sight = Sight::new(options.scenery.culler, &model.scene);
    let mut inspector = inspector(&model);
    // Hidden where standard error is no terminal.
    let bar = ProgressBar::new(views.len() as u64);
    let style = ProgressStyle::with_template("{msg} {wide_bar} {pos}/{len}  {elapsed}, {eta} left");
    bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
    bar.set_message("filming");
    for (number, view) in views.iter().enumerate() {
        if interrupted.load(Ordering::Relaxed) {
            bar.abandon();
            anyhow::bail!("stopped after {number} of {} frames, which are in {}", views.len(), options.out.display());
        }
        let visible = &sight.look(view).visible[..];
        let overlay = options.over.draw(&mut inspector, &Found { model: &model, view, visible, is_from_there: true });
        stage.renderer.bones.clear();
        let moving = cast.at(number as f64 / rate, &model, &mut stage.renderer.bones);
        let (picture, _) = stage.picture(&gpu, &Frame { view: *view, visible, moving: &moving }, &overlay)?;
        write(&options.out, number, &picture)?;
        bar.inc(1);
    }
    bar.finish_and_clear();
    let out = options.out.display();
    let count = views.len();
    print(&format!("{out}: {count} frames for {rate} a second, on {}\n", gpu.describe()));
    Ok(())
}

/// The part of the path that is filmed.
fn part<'a>(views: &'a [View], options: &Film) -> anyhow::Result<&'a [View]> {
    let last = views.len() - 1;
    let to = options.to.unwrap_or(last);
    let path = options.path.display();
    anyhow::ensure!(to <= last, "--to {to} is beyond {path}, whose cameras are 0 to {last}");
    anyhow::ensure!(options.from <= to, "--from {} is behind the last camera, {to}, of {path}", options.from);
    Ok(&views[options.from..=to])
}

/// Views at even times of which there are `fps` a second, along views of which there are `hz`. Eyes go straight from one to the
/// next, and looks turn by the shorter way.
fn resampled(views: &[View], hz: f64, fps: f64) -> Vec<View> {
    let seconds = (views.len() - 1) as f64 / hz;
    // Time that a sum of rounded parts falls short of the end is no reason to lose the last frame.
    let count = (seconds * fps + 1e-6).floor() as usize + 1;
    let view = |number: usize| {
        let at = (number as f64 / fps * hz).min((views.len() - 1) as f64);
        let (before, after) = (&views[at.floor() as usize], &views[at.ceil() as usize]);
        let share = at.fract();
        if share == 0.0 {
            return *before;
        }
        let orientation = before.orientation.slerp(after.orientation, share).normalize();
        View { eye: DVec3::lerp(before.eye, after.eye, share), orientation, ..*before }
    };
    (0..count).map(view).collect()
}

/// Makes the folder, and room in it.
fn prepare(folder: &Path, overwrites: bool) -> anyhow::Result<()> {
    let unusable = || format!("cannot use {} for frames", folder.display());
    std::fs::create_dir_all(folder).with_context(unusable)?;
    let is_frame = |name: &str| name.starts_with("frame-") && name.ends_with(".png");
    for entry in std::fs::read_dir(folder).with_context(unusable)? {
        let entry = entry.with_context(unusable)?;
        if !is_frame(&entry.file_name().to_string_lossy()) {
            continue;
        }
        let shown = folder.display();
        // A shorter film would end in a longer one's frames.
        anyhow::ensure!(overwrites, "there are frames in {shown} already; give another folder, or --overwrite");
        std::fs::remove_file(entry.path()).with_context(unusable)?;
    }
    Ok(())
}

/// Writes a frame under another name first, so that none is ever half a one.
fn write(folder: &Path, number: usize, picture: &image::RgbaImage) -> anyhow::Result<()> {
    let path = folder.join(format!("frame-{number:05}.png"));
    let unfinished = folder.join("unfinished");
    let written = picture.save_with_format(&unfinished, image::ImageFormat::Png).map_err(anyhow::Error::from);
    let named = written.and_then(|()| Ok(std::fs::rename(&unfinished, &path)?));
    if named.is_err() {
        let _ = std::fs::remove_file(&unfinished);
    }
    named.with_context(|| format!("cannot write {}", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn views(count: usize) -> Vec<View> {
        let view = |at: usize| View::level(DVec3::X * at as f64, 0.1 * at as f64, 1.2, Resolution::new(8, 8));
        (0..count).map(view).collect()
    }

    #[test]
    fn frames_come_at_even_times_between_cameras() {
        // Ten cameras a second for two seconds.
        let cameras = views(21);
        let faster = resampled(&cameras, 10.0, 25.0);
        assert_eq!(faster.len(), 51);
        for (number, view) in faster.iter().enumerate() {
            let at = number as f64 / 25.0 * 10.0;
            assert!((view.eye.x - at).abs() < 1e-9);
            let expected = View::level(view.eye, 0.1 * at, 1.2, view.resolution).orientation;
            assert!(view.orientation.abs_diff_eq(expected, 1e-9));
        }
        let slower = resampled(&cameras, 10.0, 4.0);
        assert_eq!(
            slower.iter().map(|view| view.eye.x).collect::<Vec<_>>(),
            [0., 2.5, 5., 7.5, 10., 12.5, 15., 17.5, 20.]
        );
        assert_eq!(resampled(&cameras, 10.0, 10.0), cameras);
        assert_eq!(resampled(&cameras[..1], 10.0, 60.0), cameras[..1]);
    }

    #[test]
    fn frames_of_another_film_are_not_mixed_in() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("deep/frames");
        prepare(&out, false).unwrap();
        write(&out, 7, &image::RgbaImage::new(2, 2)).unwrap();
        assert!(out.join("frame-00007.png").is_file());
        std::fs::write(out.join("notes.txt"), "mine").unwrap();
        let error = prepare(&out, false).unwrap_err().to_string();
        assert!(error.contains("already") && error.contains("--overwrite"), "{error}");
        prepare(&out, true).unwrap();
        let left: Vec<_> = std::fs::read_dir(&out).unwrap().map(|entry| entry.unwrap().file_name()).collect();
        assert_eq!(left, ["notes.txt"]);
        // A file where the folder should be.
        let error = format!("{:#}", prepare(&out.join("notes.txt"), false).unwrap_err());
        assert!(error.contains("notes.txt"), "{error}");
    }
}
