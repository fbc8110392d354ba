//! What does each pixel show, by the adapter's own arithmetic? The item buffer that is the truth for its queries.

use std::sync::Arc;

use eyeline_visibility::{ItemBuffer, Resolution, Sides, View};

use super::buffers::Growing;
use super::image::{Camera, DEPTH, Drawing, ITEMS, draw_runs};
use super::{Gpu, GpuError, GpuScene};

/// Draws item buffers: of each pixel the nearest primitive, and of equally near ones the first.
#[derive(Debug)]
pub struct GpuPicture {
    gpu: Arc<Gpu>,
    scene: Arc<GpuScene>,
    camera: Camera,
    pipelines: [wgpu::RenderPipeline; 2],
    indices: Growing,
    images: Option<(Resolution, wgpu::Texture, wgpu::TextureView)>,
}

impl GpuPicture {
    /// Pictures of a scene.
    ///
    /// # Errors
    /// If the adapter has no room for it.
    pub fn new(gpu: Arc<Gpu>, scene: Arc<GpuScene>) -> Result<GpuPicture, GpuError> {
        let camera = Camera::new(&gpu)?;
        let pipelines = [Sides::Front, Sides::Both].map(|sides| {
            let fragment = Some((&camera.module, "item", Some(ITEMS)));
            camera.pipeline(
                &gpu,
                &Drawing { label: "items", vertex: "triangle", sides, writes_depth: true, fragment, more: None },
            )
        });
        gpu.check()?;
        let indices = Growing::new("items", wgpu::BufferUsages::INDEX);
        Ok(GpuPicture { gpu, scene, camera, pipelines, indices, images: None })
    }

    /// Draws primitives, which must ascend, and reads back the winner of each pixel, row by row from the top, or
    /// [`ItemBuffer::NONE`]. Nothing for a view that makes no sense.
    ///
    /// # Errors
    /// If the adapter takes no image of that size, or what its driver says.
    pub fn winners(&mut self, view: &View, primitives: &[u32]) -> Result<Vec<u32>, GpuError> {
        debug_assert!(primitives.is_sorted(), "of equally near primitives the lowest id wins");
        let resolution = view.resolution;
        if view.check().is_err() || resolution.pixels() == 0 {
            return Ok(Vec::new());
        }
        let gpu = &*self.gpu;
        if self.images.as_ref().is_none_or(|(of, ..)| *of != resolution) {
            let usage = wgpu::TextureUsages::RENDER_ATTACHMENT;
            let items = gpu.texture("items", resolution, ITEMS, usage | wgpu::TextureUsages::COPY_SRC)?;
            let depth = gpu.texture("depths", resolution, DEPTH, usage)?;
            self.images = Some((resolution, items, depth.create_view(&wgpu::TextureViewDescriptor::default())));
        }
        let Some((_, items, depth)) = &self.images else { unreachable!("made above") };
        self.camera.look(gpu, view);
        let (indices, runs) = self.scene.runs(primitives);
        let indices = self.indices.write(gpu, bytemuck::cast_slice(&indices))?;
        let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor { label: Some("items") });
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("items"),
            color_attachments: &[Some(cleared(&items.create_view(&wgpu::TextureViewDescriptor::default())))],
            depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                view: depth,
                depth_ops: Some(wgpu::Operations { load: wgpu::LoadOp::Clear(0.0), store: wgpu::StoreOp::Discard }),
                stencil_ops: None,
            }),
            ..wgpu::RenderPassDescriptor::default()
        });
        draw_runs(&mut pass, &self.camera, &self.scene, indices, &runs, &self.pipelines);
        drop(pass);
        gpu.queue.submit([encoder.finish()]);
        Ok(bytemuck::pod_collect_to_vec(&gpu.read_texture(items)?))
    }

    /// The ids that own a pixel, ascending, each once: of everything drawn, the exact set of this adapter.
    pub fn owners(winners: &[u32]) -> Vec<u32> {
        let mut owners: Vec<u32> = winners.iter().copied().filter(|&id| id != ItemBuffer::NONE).collect();
        owners.sort_unstable();
        owners.dedup();
        owners
    }
}

/// An item buffer without any item.
pub(super) fn cleared(view: &wgpu::TextureView) -> wgpu::RenderPassColorAttachment<'_> {
    let nothing = wgpu::Color { r: f64::from(ItemBuffer::NONE), g: 0.0, b: 0.0, a: 0.0 };
    wgpu::RenderPassColorAttachment {
        view,
        depth_slice: None,
        resolve_target: None,
        ops: wgpu::Operations { load: wgpu::LoadOp::Clear(nothing), store: wgpu::StoreOp::Store },
    }
}
