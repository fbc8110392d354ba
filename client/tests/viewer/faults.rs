//! What a driver, a file or a size can do to the viewer is told, and does not end it in the middle.

use eyeline_client::viewer::gpu::GpuError;
use eyeline_client::viewer::model::{Model, Texture};
use eyeline_client::viewer::overlay::Overlay;
use eyeline_client::viewer::picture::{FORMAT, Stage};
use eyeline_client::viewer::renderer::Frame;
use eyeline_visibility::{LoadOptions, Resolution, View};
use glam::DVec3;

use crate::{gpu_or_skip, made, stage};

fn rooms() -> Model {
    Model::load_glb(&made::two_rooms(0), "two rooms", &LoadOptions::default()).unwrap()
}

fn view(width: u32, height: u32) -> View {
    View::level(DVec3::new(-3.0, 1.6, 1.8), -1.1, 1.4, Resolution::new(width, height))
}

#[test]
fn a_lost_device_is_named_and_said_to_be_lost() {
    let Some(gpu) = gpu_or_skip("a_lost_device_is_named_and_said_to_be_lost") else { return };
    let model = rooms();
    let mut stage = stage(&gpu, &model);
    let visible: Vec<u32> = (0..model.scene.triangles().len() as u32).collect();
    let frame = Frame { view: view(64, 48), visible: &visible, moving: &[] };
    stage.picture(&gpu, &frame, &Overlay::default()).unwrap();
    gpu.device.destroy();
    let error = stage.picture(&gpu, &frame, &Overlay::default()).unwrap_err();
    assert!(matches!(error, GpuError::Lost { .. }), "{error:?}");
    let text = error.to_string();
    assert!(text.contains(gpu.name()) && text.contains("start the viewer again"), "{text}");
    // And whoever tries all the same hears of it again.
    assert!(stage.picture(&gpu, &frame, &Overlay::default()).is_err());
    assert!(Stage::new(&gpu, &model, &[], FORMAT).is_err());
}

#[test]
fn a_picture_without_pixels_is_one() {
    let Some(gpu) = gpu_or_skip("a_picture_without_pixels_is_one") else { return };
    let mut stage = stage(&gpu, &rooms());
    for (width, height) in [(0, 0), (0, 48), (64, 0), (1, 1)] {
        let frame = Frame { view: view(width, height), visible: &[0, 1], moving: &[] };
        let (picture, _) = stage.picture(&gpu, &frame, &Overlay::default()).unwrap();
        assert_eq!(picture.dimensions(), (width, height));
    }
}

#[test]
fn what_is_larger_than_the_adapter_takes_is_refused_with_a_remedy() {
    let Some(gpu) = gpu_or_skip("what_is_larger_than_the_adapter_takes_is_refused_with_a_remedy") else { return };
    let limits = gpu.device.limits();
    let refused = |error: GpuError, words: &[&str]| {
        let text = error.to_string();
        words.iter().for_each(|word| assert!(text.contains(word), "{text:?} does not say {word:?}"));
        assert!(text.contains(gpu.name()), "{text}");
    };
    let bytes = limits.max_buffer_size.saturating_add(1);
    if bytes > limits.max_buffer_size {
        let error = gpu.empty_buffer("triangles", wgpu::BufferUsages::VERTEX, bytes).unwrap_err();
        refused(error, &["triangles", "max_buffer_size", "smaller scene"]);
    }
    let mut stage = stage(&gpu, &rooms());
    let frame = Frame { view: view(limits.max_texture_dimension_2d + 1, 8), visible: &[], moving: &[] };
    refused(
        stage.picture(&gpu, &frame, &Overlay::default()).unwrap_err(),
        &["picture", "max_texture_dimension_2d", "smaller"],
    );
    // Nothing of it is left behind.
    gpu.check().unwrap();
}

/// A texture that no adapter takes is drawn from a smaller copy.
#[test]
fn a_texture_beyond_limits_is_made_smaller() {
    let Some(gpu) = gpu_or_skip("a_texture_beyond_limits_is_made_smaller") else { return };
    let limit = gpu.device.limits().max_texture_dimension_2d;
    let mut model = rooms();
    let width = 2 * limit + 2;
    model.textures[1] = Texture { width, height: 2, rgba: vec![90; 8 * width as usize].into(), use_: None };
    let mut stage = Stage::new(&gpu, &model, &[], FORMAT).unwrap();
    let visible: Vec<u32> = (0..model.scene.triangles().len() as u32).collect();
    stage.picture(&gpu, &Frame { view: view(64, 48), visible: &visible, moving: &[] }, &Overlay::default()).unwrap();
}
