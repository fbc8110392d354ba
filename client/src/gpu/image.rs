//! What was drawn of a scene in a view, on an adapter: the depths that queries are asked against.

use std::sync::Arc;

use eyeline_visibility::{Aabb, DepthBuffer, Resolution, Sides, View};
use glam::DVec3;

use super::boxes::{self, NEARER, Place};
use super::buffers::Growing;
use super::{Gpu, GpuError, GpuScene};

/// Reversed, so that precision is spread evenly over distances.
pub(super) const DEPTH: wgpu::TextureFormat = wgpu::TextureFormat::Depth32Float;

/// Format of item buffers.
pub(super) const ITEMS: wgpu::TextureFormat = wgpu::TextureFormat::R32Uint;

/// A view as `draw.wgsl` gets it.
#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct ViewRows {
    right: [f32; 4],
    up: [f32; 4],
    forward: [f32; 4],
    eye: [f32; 4],
    eye_rest: [f32; 4],
}

impl ViewRows {
    fn new(view: &View) -> ViewRows {
        let Resolution { width, height } = view.resolution;
        let orientation = view.orientation.normalize();
        let focal = 2.0 * view.focal_px();
        let row = |axis: DVec3, scale: f64| (orientation * axis * scale).as_vec3();
        let eye = view.eye.as_vec3();
        ViewRows {
            right: row(DVec3::X, focal / f64::from(width.max(1))).extend(view.near as f32).to_array(),
            up: row(DVec3::Y, focal / f64::from(height.max(1))).extend((1.0 + NEARER) as f32).to_array(),
            forward: row(DVec3::NEG_Z, 1.0).extend(0.0).to_array(),
            eye: eye.extend(0.0).to_array(),
            eye_rest: (view.eye - eye.as_dvec3()).as_vec3().extend(0.0).to_array(),
        }
    }
}

/// A view on an adapter, and what shaders need to draw in it.
#[derive(Debug)]
pub(super) struct Camera {
    pub(super) module: wgpu::ShaderModule,
    pub(super) layout: wgpu::BindGroupLayout,
    pub(super) group: wgpu::BindGroup,
    rows: wgpu::Buffer,
}

/// What a pipeline of `draw.wgsl` does besides finding pixels.
pub(super) struct Drawing<'a> {
    pub(super) label: &'static str,
    /// `triangle` or `cube`.
    pub(super) vertex: &'static str,
    pub(super) sides: Sides,
    /// Whether depths are written, by what is nearer; else they are only asked, and a tie passes.
    pub(super) writes_depth: bool,
    /// What becomes of a fragment: module, entry point, and the format that it is drawn in.
    pub(super) fragment: Option<(&'a wgpu::ShaderModule, &'static str, Option<wgpu::TextureFormat>)>,
    /// What the fragment shader needs besides the camera.
    pub(super) more: Option<&'a wgpu::BindGroupLayout>,
}

impl Camera {
    pub(super) fn new(gpu: &Gpu) -> Result<Camera, GpuError> {
        let device = &gpu.device;
        let usage = wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST;
        let rows = gpu.empty_buffer("view", usage, size_of::<ViewRows>() as u64)?;
        let layout = device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some("view"),
            entries: &[wgpu::BindGroupLayoutEntry {
                binding: 0,
                visibility: wgpu::ShaderStages::VERTEX,
                ty: wgpu::BindingType::Buffer {
                    ty: wgpu::BufferBindingType::Uniform,
                    has_dynamic_offset: false,
                    min_binding_size: None,
                },
                count: None,
            }],
        });
        let group = device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("view"),
            layout: &layout,
            entries: &[wgpu::BindGroupEntry { binding: 0, resource: rows.as_entire_binding() }],
        });
        let module = device.create_shader_module(wgpu::include_wgsl!("draw.wgsl"));
        Ok(Camera { module, layout, group, rows })
    }

    pub(super) fn look(&self, gpu: &Gpu, view: &View) {
        gpu.queue.write_buffer(&self.rows, 0, bytemuck::bytes_of(&ViewRows::new(view)));
    }

    pub(super) fn pipeline(&self, gpu: &Gpu, drawing: &Drawing<'_>) -> wgpu::RenderPipeline {
        let corner = wgpu::vertex_attr_array![0 => Float32x3];
        let ends = wgpu::vertex_attr_array![1 => Float32x3, 2 => Float32x3];
        let is_box = drawing.vertex == "cube";
        let buffer = Some(wgpu::VertexBufferLayout {
            array_stride: if is_box { 24 } else { 12 },
            step_mode: if is_box { wgpu::VertexStepMode::Instance } else { wgpu::VertexStepMode::Vertex },
            attributes: if is_box { &ends } else { &corner },
        });
        let groups = [Some(&self.layout), drawing.more];
        let layout = gpu.device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some(drawing.label),
            bind_group_layouts: if drawing.more.is_some() { &groups } else { &groups[..1] },
            immediate_size: 0,
        });
        let target = drawing
            .fragment
            .and_then(|(.., format)| format)
            .map(|format| Some(wgpu::ColorTargetState { format, blend: None, write_mask: wgpu::ColorWrites::ALL }));
        let nearer =
            if drawing.writes_depth { wgpu::CompareFunction::Greater } else { wgpu::CompareFunction::GreaterEqual };
        gpu.device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
            label: Some(drawing.label),
            layout: Some(&layout),
            vertex: wgpu::VertexState {
                module: &self.module,
                entry_point: Some(drawing.vertex),
                compilation_options: wgpu::PipelineCompilationOptions::default(),
                buffers: &[buffer],
            },
            primitive: wgpu::PrimitiveState {
                cull_mode: (drawing.sides == Sides::Front).then_some(wgpu::Face::Back),
                ..wgpu::PrimitiveState::default()
            },
            depth_stencil: Some(wgpu::DepthStencilState {
                format: DEPTH,
                depth_write_enabled: Some(drawing.writes_depth),
                depth_compare: Some(nearer),
                stencil: wgpu::StencilState::default(),
                bias: wgpu::DepthBiasState::default(),
            }),
            multisample: wgpu::MultisampleState::default(),
            fragment: drawing.fragment.map(|(module, entry_point, _)| wgpu::FragmentState {
                module,
                entry_point: Some(entry_point),
                compilation_options: wgpu::PipelineCompilationOptions::default(),
                targets: target.as_slice(),
            }),
            multiview_mask: None,
            cache: None,
        })
    }
}

/// Which of a pair of pipelines draws these sides.
pub(super) fn of_sides(sides: Sides) -> usize {
    usize::from(sides == Sides::Both)
}

/// Depths of the occluders that were drawn in one view.
///
/// What is drawn is kept until it is needed, so that drawing and the query that follows are one submission.
#[derive(Debug)]
pub struct GpuImage {
    pub(super) gpu: Arc<Gpu>,
    scene: Arc<GpuScene>,
    pub(super) camera: Camera,
    /// For front sides, and for both.
    pipelines: [wgpu::RenderPipeline; 2],
    indices: Growing,
    view: View,
    /// Knows the view, and has nothing drawn into it.
    known: DepthBuffer,
    depth: Option<(Resolution, wgpu::TextureView)>,
    pending: Vec<u32>,
    is_clear: bool,
}

impl GpuImage {
    /// An image of no view yet.
    ///
    /// # Errors
    /// If the adapter has no room for it.
    pub fn new(gpu: Arc<Gpu>, scene: Arc<GpuScene>) -> Result<GpuImage, GpuError> {
        let nowhere = View::level(DVec3::ZERO, 0.0, 1.0, Resolution::new(0, 0));
        let camera = Camera::new(&gpu)?;
        let drawing = |sides| Drawing {
            label: "occluders",
            vertex: "triangle",
            sides,
            writes_depth: true,
            fragment: None,
            more: None,
        };
        let pipelines = [Sides::Front, Sides::Both].map(|sides| camera.pipeline(&gpu, &drawing(sides)));
        gpu.check()?;
        Ok(GpuImage {
            gpu,
            scene,
            camera,
            pipelines,
            indices: Growing::new("occluders", wgpu::BufferUsages::INDEX),
            view: nowhere,
            known: DepthBuffer::new(&nowhere),
            depth: None,
            pending: Vec::new(),
            is_clear: false,
        })
    }

    /// Forgets everything and starts an image of another view. A view that makes no sense has no pixels.
    ///
    /// # Errors
    /// If the adapter takes no image of that size.
    pub fn begin(&mut self, view: &View) -> Result<(), GpuError> {
        self.view = *view;
        self.known.begin(view);
        self.pending.clear();
        self.is_clear = false;
        let resolution = view.resolution;
        if view.check().is_err() || resolution.pixels() == 0 {
            self.depth = None;
            return Ok(());
        }
        if self.depth.as_ref().is_none_or(|(of, _)| *of != resolution) {
            let usage = wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::TEXTURE_BINDING;
            self.depth = None;
            let texture = self.gpu.texture("depths", resolution, DEPTH, usage)?;
            self.depth = Some((resolution, texture.create_view(&wgpu::TextureViewDescriptor::default())));
        }
        self.camera.look(&self.gpu, view);
        Ok(())
    }

    /// Draws those of the primitives that occlude.
    pub fn draw(&mut self, primitives: &[u32]) {
        let scene = &self.scene;
        self.pending.extend(primitives.iter().copied().filter(|&id| scene.occludes(id)));
    }

    pub(super) fn scene_len(&self) -> usize {
        self.scene.len()
    }

    /// The view.
    pub fn view(&self) -> &View {
        &self.view
    }

    /// An image of the view that nothing was drawn into.
    pub(super) fn known(&self) -> &DepthBuffer {
        &self.known
    }

    pub(super) fn known_mut(&mut self) -> &mut DepthBuffer {
        &mut self.known
    }

    /// Size and depths, if there are any.
    pub(super) fn depths(&self) -> Option<(Resolution, &wgpu::TextureView)> {
        self.depth.as_ref().map(|(resolution, view)| (*resolution, view))
    }

    /// Where a box is drawn.
    pub(super) fn place(&self, aabb: &Aabb) -> Place {
        boxes::place(&self.view, &self.known, aabb)
    }

    /// Has what waits drawn; whether anything changed.
    pub(super) fn encode(&mut self, encoder: &mut wgpu::CommandEncoder) -> Result<bool, GpuError> {
        let Some((_, depth)) = &self.depth else { return Ok(false) };
        if self.is_clear && self.pending.is_empty() {
            return Ok(false);
        }
        let (indices, runs) = self.scene.runs(&self.pending);
        let indices = self.indices.write(&self.gpu, bytemuck::cast_slice(&indices))?;
        let load = if self.is_clear { wgpu::LoadOp::Load } else { wgpu::LoadOp::Clear(0.0) };
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("occluders"),
            depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                view: depth,
                // Reversed: nothing is farther than 0.
                depth_ops: Some(wgpu::Operations { load, store: wgpu::StoreOp::Store }),
                stencil_ops: None,
            }),
            ..wgpu::RenderPassDescriptor::default()
        });
        draw_runs(&mut pass, &self.camera, &self.scene, indices, &runs, &self.pipelines);
        drop(pass);
        self.pending.clear();
        self.is_clear = true;
        Ok(true)
    }
}

/// Draws corners by their indices.
pub(super) fn draw_runs(
    pass: &mut wgpu::RenderPass<'_>,
    camera: &Camera,
    scene: &GpuScene,
    indices: &wgpu::Buffer,
    runs: &[super::scene::Run],
    pipelines: &[wgpu::RenderPipeline; 2],
) {
    pass.set_bind_group(0, &camera.group, &[]);
    pass.set_vertex_buffer(0, scene.corners.slice(..));
    pass.set_index_buffer(indices.slice(..), wgpu::IndexFormat::Uint32);
    for (sides, range) in runs {
        pass.set_pipeline(&pipelines[of_sides(*sides)]);
        pass.draw_indexed(range.clone(), 0, 0..1);
    }
}

/// Boxes as `draw.wgsl` gets them.
#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
pub(super) struct Ends {
    pub(super) min: [f32; 3],
    pub(super) max: [f32; 3],
}

/// Corners drawn for a box.
pub(super) const BOX_CORNERS: u32 = 36;

#[cfg(test)]
mod tests {
    #[test]
    fn the_shaders_are_valid_without_a_gpu() {
        for source in [
            include_str!("draw.wgsl"),
            include_str!("count.wgsl"),
            include_str!("histogram.wgsl"),
            include_str!("pyramid.wgsl"),
        ] {
            let module = wgpu::naga::front::wgsl::parse_str(source)
                .unwrap_or_else(|error| panic!("{}", error.emit_to_string(source)));
            let (flags, all) = (wgpu::naga::valid::ValidationFlags::all(), wgpu::naga::valid::Capabilities::all());
            wgpu::naga::valid::Validator::new(flags, all).validate(&module).unwrap();
        }
    }
}
