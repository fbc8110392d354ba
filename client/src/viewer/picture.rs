//! Pictures without a window: the same passes as on a screen, read back.

use eyeline_visibility::Resolution;
use image::RgbaImage;

use super::gpu::{Gpu, GpuError};
use super::model::{Mesh, Model};
use super::overlay::{Overlay, OverlayPass};
use super::renderer::{DEPTH, DrawStats, Frame, Renderer, Shade};

/// Format of pictures.
pub const FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rgba8UnormSrgb;

/// What is where nothing is, linear.
const SKY: wgpu::Color = wgpu::Color { r: 0.30, g: 0.42, b: 0.58, a: 1.0 };

/// The scene and what is drawn over it.
pub struct Stage {
    /// The scene's pass.
    pub renderer: Renderer,
    /// What is drawn over it.
    pub overlays: OverlayPass,
    format: wgpu::TextureFormat,
    depth: Option<(Resolution, wgpu::TextureView)>,
}

impl Stage {
    /// Passes over a model and further meshes that move, into images of a format: [`FORMAT`], or a window's.
    ///
    /// # Errors
    /// If the adapter has no room for it.
    pub fn new(gpu: &Gpu, model: &Model, more: &[Mesh], format: wgpu::TextureFormat) -> Result<Stage, GpuError> {
        let renderer = Renderer::new(gpu, model, more, format)?;
        let overlays = OverlayPass::new(gpu, &renderer, format)?;
        Ok(Stage { renderer, overlays, format, depth: None })
    }

    /// Draws a frame into an image of the view's resolution, which must have pixels.
    ///
    /// # Errors
    /// What the driver says.
    pub fn draw(
        &mut self,
        gpu: &Gpu,
        image: &wgpu::TextureView,
        frame: &Frame<'_>,
        overlay: &Overlay,
    ) -> Result<DrawStats, GpuError> {
        let resolution = frame.view.resolution;
        if self.depth.as_ref().is_none_or(|(of, _)| *of != resolution) {
            let texture = gpu.texture("depth", resolution, DEPTH, wgpu::TextureUsages::RENDER_ATTACHMENT)?;
            self.depth = Some((resolution, texture.create_view(&wgpu::TextureViewDescriptor::default())));
        }
        let Some((_, depth)) = &self.depth else { unreachable!("made above") };
        // Nothing is infinitely far, and black.
        let sky = if self.renderer.shade == Shade::Depth { wgpu::Color::BLACK } else { SKY };
        let prepared = self.renderer.prepare(gpu, frame)?;
        let over = self.overlays.prepare(gpu, overlay, resolution)?;
        let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor { label: Some("frame") });
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("frame"),
            color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                view: image,
                depth_slice: None,
                resolve_target: None,
                ops: wgpu::Operations { load: wgpu::LoadOp::Clear(sky), store: wgpu::StoreOp::Store },
            })],
            depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                view: depth,
                // Reversed: nothing is farther than 0.
                depth_ops: Some(wgpu::Operations { load: wgpu::LoadOp::Clear(0.0), store: wgpu::StoreOp::Discard }),
                stencil_ops: None,
            }),
            ..wgpu::RenderPassDescriptor::default()
        });
        let stats = self.renderer.draw(&mut pass, &prepared);
        self.overlays.draw(&mut pass, self.renderer.camera().1, &over);
        drop(pass);
        gpu.queue.submit([encoder.finish()]);
        gpu.check()?;
        Ok(stats)
    }

    /// Draws a frame and reads it back.
    ///
    /// # Errors
    /// If the adapter takes no image of that size, or what its driver says.
    pub fn picture(
        &mut self,
        gpu: &Gpu,
        frame: &Frame<'_>,
        overlay: &Overlay,
    ) -> Result<(RgbaImage, DrawStats), GpuError> {
        let resolution = frame.view.resolution;
        if resolution.pixels() == 0 {
            return Ok((RgbaImage::new(resolution.width, resolution.height), DrawStats::default()));
        }
        let usage = wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::COPY_SRC;
        let image = gpu.texture("picture", resolution, self.format, usage)?;
        let stats = self.draw(gpu, &image.create_view(&wgpu::TextureViewDescriptor::default()), frame, overlay)?;
        Ok((read_back(gpu, &image)?, stats))
    }
}

fn read_back(gpu: &Gpu, image: &wgpu::Texture) -> Result<RgbaImage, GpuError> {
    let mut pixels = gpu.read_texture(image)?;
    if matches!(image.format(), wgpu::TextureFormat::Bgra8Unorm | wgpu::TextureFormat::Bgra8UnormSrgb) {
        pixels.chunks_exact_mut(4).for_each(|pixel| pixel.swap(0, 2));
    }
    Ok(RgbaImage::from_raw(image.width(), image.height(), pixels).expect("four bytes for each of the image's pixels"))
}
