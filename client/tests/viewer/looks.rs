//! What is drawn over the scene, or instead of its colours: pictures that were looked at once and kept.

use std::sync::Arc;

use eyeline_client::viewer::charts::{Charts, Sample};
use eyeline_client::viewer::gpu::Gpu;
use eyeline_client::viewer::inspect::{Inspector, show_hidden};
use eyeline_client::viewer::model::Model;
use eyeline_client::viewer::online::HiddenBound;
use eyeline_client::viewer::overlay::Overlay;
use eyeline_client::viewer::renderer::{Frame, Shade};
use eyeline_client::viewer::sight::{CullerKind, Sight};
use eyeline_visibility::{LoadOptions, Resolution, View};
use glam::DVec3;
use image::RgbaImage;

use crate::{golden, gpu_or_skip, made, stage};

fn rooms() -> Model {
    Model::load_glb(&made::two_rooms(8), "two rooms", &LoadOptions::default()).unwrap()
}

/// From the west room through the door.
fn view() -> View {
    View::level(DVec3::new(-3.6, 1.6, 1.2), -1.35, 1.5, Resolution::new(320, 200))
}

fn picture(gpu: &Gpu, model: &Model, overlay: &Overlay, shade: Shade) -> RgbaImage {
    let mut stage = stage(gpu, model);
    stage.renderer.shade = shade;
    let mut sight = Sight::new(CullerKind::Masked, &model.scene);
    let frame = Frame { view: view(), visible: &sight.look(&view()).visible, moving: &[] };
    stage.picture(gpu, &frame, overlay).unwrap().0
}

#[test]
fn depth_is_grey_and_the_nearer_the_brighter() {
    let Some(gpu) = gpu_or_skip("depth_is_grey_and_the_nearer_the_brighter") else { return };
    let picture = picture(&gpu, &rooms(), &Overlay::default(), Shade::Depth);
    golden::check("depth", &picture);
    // The floor comes nearer towards the lower edge of the picture.
    let column: Vec<[u8; 4]> = (186..200).map(|y| picture.get_pixel(120, y).0).collect();
    assert!(column.iter().all(|[r, g, b, _]| r == g && g == b));
    assert!(column.windows(2).all(|pair| pair[0][0] <= pair[1][0]) && column[0][0] < column[13][0], "{column:?}");
}

#[test]
fn an_occupancy_map_says_when_something_was_first_drawn() {
    let Some(gpu) = gpu_or_skip("an_occupancy_map_says_when_something_was_first_drawn") else { return };
    // Enough triangles for a few cells.
    let model = Model::load_glb(&made::two_rooms(1_000), "two rooms", &LoadOptions::default()).unwrap();
    let mut overlay = Overlay::default();
    Inspector::new(Arc::clone(&model.scene)).show_occupancy(&mut overlay, &view());
    golden::check("occupancy", &picture(&gpu, &model, &overlay, Shade::Lit));
}

#[test]
fn charts_show_half_a_minute_with_a_legend() {
    let Some(gpu) = gpu_or_skip("charts_show_half_a_minute_with_a_legend") else { return };
    let mut charts = Charts::default();
    for frame in 0..400u64 {
        let wave = (frame as f64 * 0.05).sin();
        let stages = [2.0 + wave, 0.4, 7.0 - 2.0 * wave];
        let messages = [frame * 2, frame * frame / 40];
        charts.add(0.05, &Sample { messages, counts: [12.0 + 6.0 * wave, 400.0], stages });
    }
    let mut overlay = Overlay::default();
    charts.draw(&mut overlay, view().resolution, 1.0, "objects");
    golden::check("charts", &picture(&gpu, &rooms(), &overlay, Shade::Lit));
}

#[test]
fn hidden_bounds_tell_their_growth_and_time_left() {
    let Some(gpu) = gpu_or_skip("hidden_bounds_tell_their_growth_and_time_left") else { return };
    let bound = |[x, z]: [f64; 2], radius: f64, left: f64| HiddenBound {
        centre: DVec3::new(x, 1.0, z),
        radius,
        radius_in_the_end: radius + 1.5 * left.max(0.0),
        tested: None,
        left,
    };
    let mut overlay = Overlay::default();
    let hidden = [bound([2.0, 1.6], 0.5, 0.4), bound([-1.0, -1.0], 0.3, 0.9), bound([0.0, -1.7], 0.4, -0.1)];
    show_hidden(&mut overlay, &hidden, &view(), 2.0);
    golden::check("hidden", &picture(&gpu, &rooms(), &overlay, Shade::Lit));
}
