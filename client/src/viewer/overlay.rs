//! What is drawn over the scene: lines, faces that shine through, and text in pixels.
//!
//! An [`Overlay`] is a list of shapes and knows of no algorithm; `inspect` fills it with what cullers and trackers do.

use eyeline_visibility::{Aabb, Resolution};
use glam::{DVec3, Vec2};

use super::font;
use super::gpu::{Gpu, GpuError};
use super::renderer::{DEPTH, Renderer};

/// Linear red, green, blue and opacity.
pub type Color = [f32; 4];

/// A point of a shape, 16 bytes.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
struct Point {
    place: [f32; 3],
    color: [u8; 4],
}

/// Shapes over a frame. Positions are relative to the scene's anchor, or in pixels from the upper left corner.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Overlay {
    /// Pairs of points; hidden by the scene.
    lines: Vec<Point>,
    /// Pairs of points; seen through everything.
    lines_through: Vec<Point>,
    /// Triples of points; hidden by the scene.
    faces: Vec<Point>,
    /// Triples of points, in pixels.
    flat: Vec<Point>,
}

fn point(place: DVec3, color: Color) -> Point {
    Point { place: place.as_vec3().to_array(), color: bytes(color) }
}

fn bytes(color: Color) -> [u8; 4] {
    // A cast saturates.
    color.map(|part| (part * 255.0).round() as u8)
}

/// Corners of a box as bits: 1 is x, 2 is y, 4 is z.
fn corner(aabb: &Aabb, bits: usize) -> DVec3 {
    DVec3::from_array(std::array::from_fn(|axis| if bits >> axis & 1 == 1 { aabb.max[axis] } else { aabb.min[axis] }))
}

impl Overlay {
    /// Whether there is nothing to draw.
    pub fn is_empty(&self) -> bool {
        [&self.lines, &self.lines_through, &self.faces, &self.flat].iter().all(|points| points.is_empty())
    }

    /// A line that the scene hides, or one that nothing does.
    pub fn line(&mut self, from: DVec3, to: DVec3, color: Color, is_through: bool) {
        let lines = if is_through { &mut self.lines_through } else { &mut self.lines };
        lines.extend([point(from, color), point(to, color)]);
    }

    /// The edges of a box.
    pub fn wire_box(&mut self, aabb: &Aabb, color: Color, is_through: bool) {
        for from in 0..8 {
            for axis in [1, 2, 4].into_iter().filter(|axis| from & axis == 0) {
                self.line(corner(aabb, from), corner(aabb, from | axis), color, is_through);
            }
        }
    }

    /// The faces of a box. Their order is not that of depth: with little opacity that does not matter.
    pub fn solid_box(&mut self, aabb: &Aabb, color: Color) {
        for [a, b] in [[1, 2], [2, 4], [4, 1]] {
            for side in [0, 7 & !(a | b)] {
                let [p, q, r, s] =
                    [side, side | a, side | a | b, side | b].map(|bits| point(corner(aabb, bits), color));
                self.faces.extend([p, q, r, p, r, s]);
            }
        }
    }

    /// Three great circles of a sphere.
    pub fn wire_sphere(&mut self, centre: DVec3, radius: f64, color: Color, is_through: bool) {
        const STEPS: usize = 32;
        for [x, y] in [[DVec3::X, DVec3::Y], [DVec3::Y, DVec3::Z], [DVec3::Z, DVec3::X]] {
            let at = |step: usize| {
                let (sin, cos) = (step as f64 / STEPS as f64 * std::f64::consts::TAU).sin_cos();
                centre + radius * (cos * x + sin * y)
            };
            (0..STEPS).for_each(|step| self.line(at(step), at(step + 1), color, is_through));
        }
    }

    /// A rectangle in the image, in pixels.
    pub fn rectangle(&mut self, min: Vec2, max: Vec2, color: Color) {
        let [p, q, r, s] = [min, Vec2::new(max.x, min.y), max, Vec2::new(min.x, max.y)]
            .map(|place| Point { place: [place.x, place.y, 0.0], color: bytes(color) });
        self.flat.extend([p, q, r, p, r, s]);
    }

    /// A line in the image, in pixels, `width` wide.
    pub fn flat_line(&mut self, from: Vec2, to: Vec2, width: f32, color: Color) {
        let across = (to - from).perp().normalize_or_zero() * width * 0.5;
        let [p, q, r, s] = [from - across, from + across, to + across, to - across]
            .map(|place| Point { place: [place.x, place.y, 0.0], color: bytes(color) });
        self.flat.extend([p, q, r, p, r, s]);
    }

    /// Text in the image, its upper left corner in pixels; a pixel of the font is `scale` pixels.
    pub fn text(&mut self, text: &str, at: Vec2, scale: f32, color: Color) {
        for (place, size) in font::rectangles(text) {
            self.rectangle(at + place * scale, at + (place + size) * scale, color);
        }
    }

    /// Text on a dark ground.
    pub fn label(&mut self, text: &str, at: Vec2, scale: f32, color: Color) {
        let size = font::size(text) * scale;
        self.rectangle(at - 2.0 * scale, at + size + 2.0 * scale, [0.0, 0.0, 0.0, 0.6]);
        self.text(text, at, scale, color);
    }
}

/// The pass that draws overlays.
pub struct OverlayPass {
    lines: wgpu::RenderPipeline,
    lines_through: wgpu::RenderPipeline,
    faces: wgpu::RenderPipeline,
    flat: wgpu::RenderPipeline,
    buffer: wgpu::Buffer,
}

/// An overlay whose data is on the GPU: where its four lists begin and end.
pub struct PreparedOverlay {
    ends: [u32; 4],
}

impl OverlayPass {
    /// A pass over pictures of a renderer.
    ///
    /// # Errors
    /// If there is no room for it.
    pub fn new(gpu: &Gpu, renderer: &Renderer, format: wgpu::TextureFormat) -> Result<OverlayPass, GpuError> {
        let shader = gpu.device.create_shader_module(wgpu::include_wgsl!("overlay.wgsl"));
        let layout = gpu.device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some("overlay"),
            bind_group_layouts: &[Some(renderer.camera().0)],
            immediate_size: 0,
        });
        let pipeline = |entry: &str, topology, compare| {
            gpu.device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
                label: Some("overlay"),
                layout: Some(&layout),
                vertex: wgpu::VertexState {
                    module: &shader,
                    entry_point: Some(entry),
                    compilation_options: wgpu::PipelineCompilationOptions::default(),
                    buffers: &[Some(wgpu::VertexBufferLayout {
                        array_stride: size_of::<Point>() as u64,
                        step_mode: wgpu::VertexStepMode::Vertex,
                        attributes: &wgpu::vertex_attr_array![0 => Float32x3, 1 => Unorm8x4],
                    })],
                },
                primitive: wgpu::PrimitiveState { topology, ..wgpu::PrimitiveState::default() },
                depth_stencil: Some(wgpu::DepthStencilState {
                    format: DEPTH,
                    depth_write_enabled: Some(false),
                    depth_compare: Some(compare),
                    stencil: wgpu::StencilState::default(),
                    bias: wgpu::DepthBiasState::default(),
                }),
                multisample: wgpu::MultisampleState::default(),
                fragment: Some(wgpu::FragmentState {
                    module: &shader,
                    entry_point: Some("fragment"),
                    compilation_options: wgpu::PipelineCompilationOptions::default(),
                    targets: &[Some(wgpu::ColorTargetState {
                        format,
                        blend: Some(wgpu::BlendState::ALPHA_BLENDING),
                        write_mask: wgpu::ColorWrites::ALL,
                    })],
                }),
                multiview_mask: None,
                cache: None,
            })
        };
        use wgpu::CompareFunction::{Always, GreaterEqual};
        use wgpu::PrimitiveTopology::{LineList, TriangleList};
        Ok(OverlayPass {
            lines: pipeline("in_scene", LineList, GreaterEqual),
            lines_through: pipeline("in_scene", LineList, Always),
            faces: pipeline("in_scene", TriangleList, GreaterEqual),
            flat: pipeline("in_image", TriangleList, Always),
            buffer: empty(gpu, 1 << 12)?,
        })
    }

    /// Writes an overlay's data, ahead of [`OverlayPass::draw`].
    ///
    /// # Errors
    /// If there is no room for it.
    pub fn prepare(
        &mut self,
        gpu: &Gpu,
        overlay: &Overlay,
        resolution: Resolution,
    ) -> Result<PreparedOverlay, GpuError> {
        let (width, height) = (resolution.width.max(1) as f32, resolution.height.max(1) as f32);
        let mut points = Vec::new();
        let mut ends = [0; 4];
        for (end, list) in ends.iter_mut().zip([&overlay.faces, &overlay.lines, &overlay.lines_through, &overlay.flat])
        {
            points.extend_from_slice(list);
            *end = points.len() as u32;
        }
        for point in &mut points[ends[2] as usize..] {
            point.place = [point.place[0] / width, point.place[1] / height, 0.0];
        }
        let bytes = bytemuck::cast_slice::<Point, u8>(&points);
        if bytes.len() as u64 > self.buffer.size() {
            self.buffer = empty(gpu, bytes.len() as u64 * 3 / 2)?;
        }
        gpu.queue.write_buffer(&self.buffer, 0, bytes);
        Ok(PreparedOverlay { ends })
    }

    /// Draws what was prepared last, with the camera of the renderer.
    pub fn draw(&self, pass: &mut wgpu::RenderPass<'_>, camera: &wgpu::BindGroup, prepared: &PreparedOverlay) {
        pass.set_bind_group(0, camera, &[]);
        pass.set_vertex_buffer(0, self.buffer.slice(..));
        let mut start = 0;
        for (pipeline, end) in
            [&self.faces, &self.lines, &self.lines_through, &self.flat].into_iter().zip(prepared.ends)
        {
            if end > start {
                pass.set_pipeline(pipeline);
                pass.draw(start..end, 0..1);
            }
            start = end;
        }
    }
}

fn empty(gpu: &Gpu, bytes: u64) -> Result<wgpu::Buffer, GpuError> {
    gpu.empty_buffer("overlay", wgpu::BufferUsages::VERTEX | wgpu::BufferUsages::COPY_DST, bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_box_has_twelve_edges_and_six_faces() {
        let mut overlay = Overlay::default();
        let aabb = Aabb::new(DVec3::ZERO, DVec3::new(1.0, 2.0, 3.0));
        overlay.wire_box(&aabb, [1.0; 4], false);
        assert_eq!(overlay.lines.len(), 24);
        let lengths: f32 = overlay
            .lines
            .chunks(2)
            .map(|pair| (0..3).map(|axis| (pair[0].place[axis] - pair[1].place[axis]).abs()).sum::<f32>())
            .sum();
        assert_eq!(lengths, 4.0 * (1.0 + 2.0 + 3.0));
        overlay.solid_box(&aabb, [1.0; 4]);
        let area: f32 = overlay
            .faces
            .chunks(3)
            .map(|triangle| {
                let [a, b, c] = [0, 1, 2].map(|corner| glam::Vec3::from_array(triangle[corner].place));
                (b - a).cross(c - a).length() / 2.0
            })
            .sum();
        assert_eq!(area, 2.0 * (2.0 + 3.0 + 6.0));
    }

    #[test]
    fn the_shader_is_valid_without_a_gpu() {
        let source = include_str!("overlay.wgsl");
        let module = wgpu::naga::front::wgsl::parse_str(source)
            .unwrap_or_else(|error| panic!("{}", error.emit_to_string(source)));
        let mut validator =
            wgpu::naga::valid::Validator::new(wgpu::naga::valid::ValidationFlags::all(), Default::default());
        validator.validate(&module).unwrap();
    }
}
