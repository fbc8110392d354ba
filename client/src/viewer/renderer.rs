//! How does a visible set become pixels?
//!
//! Triangles are drawn in the order of their ids, whatever order a culler found them in; of equally near ones the first stays, so
//! the picture does not depend on the culler. Each frame the visible set is written as indices, and triangles of one kind that
//! follow each other are one draw call: work grows with what is visible, not with the scene. What moves is drawn after the
//! static scene, and what light shines through after both.

use std::ops::Range;

use eyeline_visibility::{Resolution, View};
use glam::{DMat4, DQuat, DVec3, DVec4, Mat4};

use super::avatar::Bones;
use super::gpu::{Gpu, GpuError};
use super::model::{Kind, Mesh, Model, Texture, Vertex};
use super::pipelines::{bones_group, bones_layout, pipeline_index, pipelines, texture_layout};
use super::textures;

/// What is drawn in a frame, besides overlays.
#[derive(Clone, Copy, Debug)]
pub struct Frame<'a> {
    /// From where, and how large.
    pub view: View,
    /// Ids of the static triangles to draw, ascending.
    pub visible: &'a [u32],
    /// What moves.
    pub moving: &'a [Moving],
}

/// Something that moves, in its place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Moving {
    /// Which of the renderer's meshes.
    pub mesh: usize,
    /// Its origin, relative to the scene's anchor.
    pub position: DVec3,
    /// How it is turned.
    pub orientation: DQuat,
    /// Linear colour that its own is multiplied by, 0 to 1.
    pub tint: [f32; 3],
    /// The first of its bones in [`Renderer::bones`], if bones carry its mesh.
    pub first_bone: Option<u32>,
}

/// What surfaces are drawn as.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Shade {
    /// In their colours, lit.
    #[default]
    Lit,
    /// By their distance d: the nearer the brighter, h²/(h + d)² of the light with h = [`HALF_BRIGHT`].
    Depth,
}

/// Metres at which depth as luminance looks about half as bright as before one's eyes: a quarter of the light.
pub const HALF_BRIGHT: f64 = 2.5;

/// What a frame took.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DrawStats {
    /// Triangles of the static scene that were drawn.
    pub primitives: usize,
    /// Triangles of what moves.
    pub moving: usize,
    /// Draw calls.
    pub draws: usize,
}

/// The camera as the shader gets it.
#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Camera {
    clip_from_eye: [[f32; 4]; 4],
    eye: [f32; 4],
    eye_rest: [f32; 4],
    sun: [f32; 4],
}

/// Where a mesh stands as the shader gets it: three rows, and the tint.
#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
pub(super) struct Instance {
    rows: [[f32; 4]; 3],
    tint: [f32; 4],
    /// The first bone, and three that are nothing.
    first_bone: [u32; 4],
}

/// Format of all depth images: reversed, so that precision is spread evenly over distances.
pub const DEPTH: wgpu::TextureFormat = wgpu::TextureFormat::Depth32Float;

/// A scene on the GPU.
pub struct Renderer {
    camera: wgpu::Buffer,
    camera_group: wgpu::BindGroup,
    camera_layout: wgpu::BindGroupLayout,
    /// By [`pipeline_index`], first those of meshes that nothing carries.
    pipelines: Vec<wgpu::RenderPipeline>,
    bones_layout: wgpu::BindGroupLayout,
    bones_buffer: Growing,
    bones_group: wgpu::BindGroup,
    /// Bones of everybody in the next frame.
    pub bones: Bones,
    /// What surfaces are drawn as.
    pub shade: Shade,
    textures: Vec<wgpu::BindGroup>,
    fixed: wgpu::Buffer,
    kinds: Vec<Kind>,
    indices: Growing,
    instances: Growing,
    meshes: Vec<GpuMesh>,
}

/// A mesh that moves.
struct GpuMesh {
    vertices: wgpu::Buffer,
    /// Which bones carry each.
    skin: Option<wgpu::Buffer>,
    /// Ranges of vertices of one kind.
    parts: Vec<(Kind, Range<u32>)>,
}

/// A buffer that is made larger when it has to be.
struct Growing {
    label: &'static str,
    usage: wgpu::BufferUsages,
    buffer: wgpu::Buffer,
}

impl Growing {
    fn new(gpu: &Gpu, label: &'static str, usage: wgpu::BufferUsages) -> Result<Growing, GpuError> {
        let usage = usage | wgpu::BufferUsages::COPY_DST;
        Ok(Growing { label, usage, buffer: gpu.empty_buffer(label, usage, 1 << 12)? })
    }

    /// Writes and says whether it is another buffer now.
    fn write(&mut self, gpu: &Gpu, bytes: &[u8]) -> Result<bool, GpuError> {
        let is_too_small = bytes.len() as u64 > self.buffer.size();
        if is_too_small {
            // By half more, lest a set that grows slowly be allocated anew each frame.
            self.buffer = gpu.empty_buffer(self.label, self.usage, bytes.len() as u64 * 3 / 2)?;
        }
        gpu.queue.write_buffer(&self.buffer, 0, bytes);
        Ok(is_too_small)
    }
}

/// What is drawn together: indices or vertices of one kind.
type Run = (Kind, Range<u32>);

impl Renderer {
    /// A model on the GPU, to be drawn in a format; `more` are further meshes that move, behind the model's own.
    ///
    /// # Errors
    /// If the adapter has no room for it.
    pub fn new(gpu: &Gpu, model: &Model, more: &[Mesh], format: wgpu::TextureFormat) -> Result<Renderer, GpuError> {
        let device = &gpu.device;
        let camera = gpu.empty_buffer(
            "camera",
            wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
            size_of::<Camera>() as u64,
        )?;
        let camera_layout = device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some("camera"),
            entries: &[wgpu::BindGroupLayoutEntry {
                binding: 0,
                visibility: wgpu::ShaderStages::VERTEX_FRAGMENT,
                ty: wgpu::BindingType::Buffer {
                    ty: wgpu::BufferBindingType::Uniform,
                    has_dynamic_offset: false,
                    min_binding_size: None,
                },
                count: None,
            }],
        });
        let camera_group = device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("camera"),
            layout: &camera_layout,
            entries: &[wgpu::BindGroupEntry { binding: 0, resource: camera.as_entire_binding() }],
        });
        let texture_layout = texture_layout(device);
        let bones_layout = bones_layout(device);
        let pipelines = pipelines(device, [&camera_layout, &texture_layout, &bones_layout], format);
        let bones_buffer = Growing::new(gpu, "bones", wgpu::BufferUsages::STORAGE)?;
        let bones_group = bones_group(device, &bones_layout, &bones_buffer.buffer);
        let upload = |texture: &Texture| textures::upload(gpu, &texture_layout, texture);
        let textures = model.textures.iter().map(upload).collect();
        let vertices = |mesh: &Mesh| {
            gpu.buffer("triangles", wgpu::BufferUsages::VERTEX, bytemuck::cast_slice::<Vertex, u8>(&mesh.vertices))
        };
        let mesh = |mesh: &Mesh| {
            let parts = runs((0..).zip(mesh.kinds.iter().copied()));
            let skin = (!mesh.skin.is_empty())
                .then(|| gpu.buffer("skin", wgpu::BufferUsages::VERTEX, bytemuck::cast_slice(&mesh.skin)))
                .transpose()?;
            Ok(GpuMesh { vertices: vertices(mesh)?, skin, parts })
        };
        let fixed = vertices(&model.fixed)?;
        let meshes = model.objects.iter().chain(more).map(mesh).collect::<Result<_, GpuError>>()?;
        gpu.check()?;
        Ok(Renderer {
            camera,
            camera_group,
            camera_layout,
            pipelines,
            bones_layout,
            bones_buffer,
            bones_group,
            bones: Bones::default(),
            shade: Shade::Lit,
            textures,
            fixed,
            kinds: model.fixed.kinds.clone(),
            indices: Growing::new(gpu, "indices", wgpu::BufferUsages::INDEX)?,
            instances: Growing::new(gpu, "instances", wgpu::BufferUsages::VERTEX)?,
            meshes,
        })
    }

    /// The camera of the newest frame, for other passes over the same picture.
    pub fn camera(&self) -> (&wgpu::BindGroupLayout, &wgpu::BindGroup) {
        (&self.camera_layout, &self.camera_group)
    }

    /// Writes a frame's data, ahead of [`Renderer::draw`].
    ///
    /// # Panics
    /// If an id or a mesh does not exist: they come from a culler of the same scene, and from the caller.
    ///
    /// # Errors
    /// If there is no room for it.
    pub fn prepare(&mut self, gpu: &Gpu, frame: &Frame<'_>) -> Result<Prepared, GpuError> {
        gpu.queue.write_buffer(&self.camera, 0, bytemuck::bytes_of(&camera(&frame.view, self.shade)));
        let mut indices: Vec<u32> = Vec::with_capacity(3 * frame.visible.len());
        indices.extend(frame.visible.iter().flat_map(|&id| 3 * id..3 * id + 3));
        self.indices.write(gpu, bytemuck::cast_slice(&indices))?;
        self.write_bones(gpu)?;
        let kinds = frame.visible.iter().map(|&id| self.kinds[id as usize]);
        let mut instances = vec![Instance { rows: rows(&DMat4::IDENTITY), tint: [1.0; 4], first_bone: [0; 4] }];
        instances.extend(frame.moving.iter().map(|moving| {
            let [r, g, b] = moving.tint;
            let place = DMat4::from_rotation_translation(moving.orientation, moving.position);
            let first_bone = [moving.first_bone.unwrap_or(0), 0, 0, 0];
            Instance { rows: rows(&place), tint: [r, g, b, 1.0], first_bone }
        }));
        self.instances.write(gpu, bytemuck::cast_slice(&instances))?;
        Ok(Prepared {
            runs: runs((0..).zip(kinds)),
            meshes: frame.moving.iter().map(|moving| (moving.mesh, moving.first_bone.is_some())).collect(),
            stats: DrawStats { primitives: frame.visible.len(), ..DrawStats::default() },
        })
    }

    fn write_bones(&mut self, gpu: &Gpu) -> Result<(), GpuError> {
        let bytes = bytemuck::cast_slice::<[[f32; 4]; 3], u8>(&self.bones.0);
        let limit = gpu.device.limits().max_storage_buffer_binding_size;
        // As large as the buffer may become.
        if bytes.len() as u64 * 3 / 2 > limit {
            return Err(GpuError::TooLarge {
                what: "the bones of all people".into(),
                size: format!("{} MiB", bytes.len() >> 20),
                adapter: gpu.name().to_owned(),
                limit: format!("{} MiB", (limit * 2 / 3) >> 20),
                remedy: "take an avatar with fewer, or none",
            });
        }
        if !bytes.is_empty() && self.bones_buffer.write(gpu, bytes)? {
            self.bones_group = bones_group(&gpu.device, &self.bones_layout, &self.bones_buffer.buffer);
        }
        Ok(())
    }

    /// Draws what was prepared last.
    pub fn draw(&self, pass: &mut wgpu::RenderPass<'_>, prepared: &Prepared) -> DrawStats {
        let mut stats = prepared.stats;
        pass.set_bind_group(0, &self.camera_group, &[]);
        pass.set_vertex_buffer(1, self.instances.buffer.slice(..));
        pass.set_index_buffer(self.indices.buffer.slice(..), wgpu::IndexFormat::Uint32);
        for is_blended in [false, true] {
            pass.set_vertex_buffer(0, self.fixed.slice(..));
            for (kind, range) in prepared.runs.iter().filter(|(kind, _)| kind.is_blended == is_blended) {
                self.set(pass, *kind, false);
                pass.draw_indexed(range.clone(), 0, 0..1);
                stats.draws += 1;
            }
            for (instance, &(mesh, has_bones)) in (1..).zip(&prepared.meshes) {
                let mesh = &self.meshes[mesh];
                pass.set_vertex_buffer(0, mesh.vertices.slice(..));
                let skin = mesh.skin.as_ref().filter(|_| has_bones);
                if let Some(skin) = skin {
                    pass.set_vertex_buffer(2, skin.slice(..));
                    pass.set_bind_group(2, &self.bones_group, &[]);
                }
                for (kind, range) in mesh.parts.iter().filter(|(kind, _)| kind.is_blended == is_blended) {
                    self.set(pass, *kind, skin.is_some());
                    pass.draw(range.clone(), instance..instance + 1);
                    stats.moving += range.len() / 3;
                    stats.draws += 1;
                }
            }
        }
        stats
    }

    fn set(&self, pass: &mut wgpu::RenderPass<'_>, kind: Kind, is_carried: bool) {
        pass.set_pipeline(&self.pipelines[pipeline_index(kind, is_carried)]);
        pass.set_bind_group(1, &self.textures[kind.texture as usize], &[]);
    }
}

/// A frame whose data is on the GPU.
pub struct Prepared {
    runs: Vec<Run>,
    /// Which mesh, and whether it has bones.
    meshes: Vec<(usize, bool)>,
    stats: DrawStats,
}

/// Triangles of one kind that follow each other, as ranges of corners.
fn runs(triangles: impl Iterator<Item = (u32, Kind)>) -> Vec<Run> {
    let mut runs: Vec<Run> = Vec::new();
    for (triangle, kind) in triangles {
        match runs.last_mut() {
            Some((last, range)) if *last == kind => range.end = 3 * triangle + 3,
            _ => runs.push((kind, 3 * triangle..3 * triangle + 3)),
        }
    }
    runs
}

fn rows(transform: &DMat4) -> [[f32; 4]; 3] {
    [0, 1, 2].map(|row| transform.row(row).as_vec4().to_array())
}

/// Clip space from view space: as [`View`] says, reversed and without a far plane, so that depth is `near` over distance.
fn clip_from_view(view: &View) -> DMat4 {
    let Resolution { width, height } = view.resolution;
    let focal = 2.0 * view.focal_px();
    let (x, y) = (focal / f64::from(width.max(1)), focal / f64::from(height.max(1)));
    DMat4::from_cols(
        DVec4::new(x, 0.0, 0.0, 0.0),
        DVec4::new(0.0, y, 0.0, 0.0),
        DVec4::new(0.0, 0.0, 0.0, -1.0),
        DVec4::new(0.0, 0.0, view.near, 0.0),
    )
}

fn camera(view: &View, shade: Shade) -> Camera {
    let turn = DMat4::from_quat(view.orientation.normalize().conjugate());
    let clip_from_eye: Mat4 = (clip_from_view(view) * turn).as_mat4();
    let eye = view.eye.as_vec3();
    let rest = (view.eye - eye.as_dvec3()).as_vec3();
    // High, and from no direction that walls usually face.
    let sun = DVec3::new(0.36, 0.8, 0.48).normalize().as_vec3();
    Camera {
        clip_from_eye: clip_from_eye.to_cols_array_2d(),
        eye: eye.extend(if shade == Shade::Depth { HALF_BRIGHT as f32 } else { 0.0 }).to_array(),
        eye_rest: rest.extend(0.0).to_array(),
        sun: sun.extend(0.35).to_array(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clip_space_is_the_view_s() {
        let view = View {
            eye: DVec3::new(3.0, 4.0, 5.0),
            orientation: DQuat::from_rotation_y(0.7),
            fov_x: 1.2,
            resolution: Resolution::new(200, 100),
            near: 0.5,
        };
        let camera = camera(&view, Shade::Lit);
        let clip = Mat4::from_cols_array_2d(&camera.clip_from_eye).as_dmat4();
        let project = |x: f64, y: f64, distance: f64| {
            let ray = eyeline_visibility::image_ray(&view, x, y);
            clip * (ray * distance).extend(1.0)
        };
        // The middle of the image, its upper left corner, and depths from the near plane on.
        let middle = project(100.0, 50.0, 0.5);
        assert!((middle.truncate() / middle.w).abs_diff_eq(DVec3::Z, 1e-6), "{middle}");
        let corner = project(0.0, 0.0, 50.0);
        assert!((corner.truncate() / corner.w).abs_diff_eq(DVec3::new(-1.0, 1.0, 0.01), 1e-6), "{corner}");
    }

    #[test]
    fn what_follows_each_other_is_drawn_together() {
        let kind = |texture| Kind { texture, is_two_sided: false, is_blended: false };
        let found = runs((0..).zip([kind(0), kind(0), kind(1), kind(0)]));
        assert_eq!(found, [(kind(0), 0..6), (kind(1), 6..9), (kind(0), 9..12)]);
        assert_eq!(runs(std::iter::empty()), []);
    }

    #[test]
    fn the_shader_is_valid_without_a_gpu() {
        let module = wgpu::naga::front::wgsl::parse_str(include_str!("scene.wgsl"))
            .unwrap_or_else(|error| panic!("{}", error.emit_to_string(include_str!("scene.wgsl"))));
        let mut validator =
            wgpu::naga::valid::Validator::new(wgpu::naga::valid::ValidationFlags::all(), Default::default());
        validator.validate(&module).unwrap();
    }
}
