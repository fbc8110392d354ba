//! Pictures that were looked at once and kept.
//!
//! Tolerance: at most 0.5 % of the pixels may differ by more than 12 of 255 in a channel. Edges, filtered textures and the last bit
//! of light differ between versions of a software adapter and between SIMD widths; a wrong triangle, light or texture is more. With
//! `BLESS_GOLDENS=1` the pictures are written anew: look at them before they are kept.

use std::path::PathBuf;

use eyeline_client::viewer::model::{Model, capsule};
use eyeline_client::viewer::overlay::Overlay;
use eyeline_client::viewer::picture::{FORMAT, Stage};
use eyeline_client::viewer::renderer::{Frame, Moving};
use eyeline_client::viewer::shot::looking_along;
use eyeline_client::viewer::sight::{CullerKind, Sight};
use eyeline_visibility::{Aabb, LoadOptions, Resolution, View};
use glam::{DQuat, DVec3, Vec2};
use image::RgbaImage;

use crate::{gpu_or_skip, made};

const SHARE_MAX: f64 = 0.005;
const CHANNEL_MAX: u8 = 12;

/// Share of the pixels that differ by more than [`CHANNEL_MAX`].
pub fn differing_share(a: &RgbaImage, b: &RgbaImage) -> f64 {
    assert_eq!(a.dimensions(), b.dimensions());
    let differs =
        |(a, b): &(&image::Rgba<u8>, &image::Rgba<u8>)| a.0.iter().zip(b.0).any(|(a, b)| a.abs_diff(b) > CHANNEL_MAX);
    a.pixels().zip(b.pixels()).filter(differs).count() as f64 / f64::from(a.width() * a.height())
}

/// Compares a picture with the one that is kept.
#[track_caller]
pub fn check(name: &str, picture: &RgbaImage) {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/golden").join(format!("{name}.png"));
    if std::env::var_os("BLESS_GOLDENS").is_some_and(|value| value == "1") {
        picture.save(&path).unwrap();
    }
    let golden = image::open(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display())).into_rgba8();
    let share = differing_share(picture, &golden);
    if share > SHARE_MAX {
        let found = std::env::temp_dir().join(format!("eyeline-{name}.png"));
        let _ = picture.save(&found);
        panic!("{name}: {:.2} % of the pixels differ; what was drawn is in {}", share * 100.0, found.display());
    }
}

/// The made rooms from a corner of the west room, with somebody in the door.
#[test]
fn two_rooms_look_as_they_did() {
    let Some(gpu) = gpu_or_skip("two_rooms_look_as_they_did") else { return };
    let model = Model::load_glb(&made::two_rooms(8), "two rooms", &LoadOptions::default()).unwrap();
    let mut stage = Stage::new(&gpu, &model, &[capsule(0.25, 0.0, 1.75)], FORMAT).unwrap();
    let eye = DVec3::new(-3.6, 1.7, 1.7);
    let orientation = looking_along(DVec3::new(1.0, -0.3, -0.42)).unwrap();
    let view = View { eye, orientation, fov_x: 1.5, resolution: Resolution::new(256, 160), near: 0.05 };
    let mut sight = Sight::new(CullerKind::Masked, &model.scene);
    let visible = &sight.look(&view).visible;
    let moving = Moving {
        mesh: model.objects.len(),
        position: DVec3::new(0.3, 0.0, 0.5),
        orientation: DQuat::IDENTITY,
        tint: [0.9, 0.5, 0.1],
        first_bone: None,
    };
    let plain = Frame { view, visible, moving: &[] };
    let (empty, _) = stage.picture(&gpu, &plain, &Overlay::default()).unwrap();
    check("rooms", &empty);
    let mut overlay = Overlay::default();
    overlay.wire_box(&Aabb::new(DVec3::new(1.5, 0.0, 0.2), DVec3::new(2.1, 0.6, 0.8)), [1.0, 0.0, 0.0, 1.0], true);
    overlay.solid_box(&Aabb::new(DVec3::new(-3.0, 0.0, -1.9), DVec3::new(-2.4, 1.0, -1.3)), [0.0, 1.0, 0.0, 0.3]);
    overlay.label("Ada 12.5 m", Vec2::new(8.0, 8.0), 1.0, [1.0; 4]);
    let frame = Frame { moving: &[moving], ..plain };
    let (full, stats) = stage.picture(&gpu, &frame, &overlay).unwrap();
    check("rooms-overlay", &full);
    assert_eq!(stats.primitives, visible.len());
    assert!(stats.moving > 100);
    // That the comparison can fail: a person in the door and a few lines are more than the tolerance.
    assert!(differing_share(&empty, &full) > 2.0 * SHARE_MAX);
}
