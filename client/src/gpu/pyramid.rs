//! Greene's pyramid of farthest depths, made and asked by compute shaders.

use eyeline_visibility::Resolution;

use super::boxes::Drawable;
use super::buffers::Growing;
use super::{Gpu, GpuError};

/// A pyramid over the depths of an image.
#[derive(Debug)]
pub(super) struct Pyramid {
    reduce: wgpu::ComputePipeline,
    test: wgpu::ComputePipeline,
    boxes: Growing,
    seen: Growing,
    asked: wgpu::Buffer,
    levels: Option<Levels>,
}

/// What belongs to an image of one size.
#[derive(Debug)]
struct Levels {
    resolution: Resolution,
    /// The image and its pyramid, for either shader: `[reduce, test]`.
    groups: [wgpu::BindGroup; 2],
    /// Columns, rows and number of each level above the image.
    steps: Vec<(u32, u32, wgpu::BindGroup)>,
}

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct AskedBox {
    rect: [u32; 4],
    z: [f32; 4],
}

fn group(gpu: &Gpu, layout: &wgpu::BindGroupLayout, entries: &[wgpu::BindGroupEntry<'_>]) -> wgpu::BindGroup {
    gpu.device.create_bind_group(&wgpu::BindGroupDescriptor { label: Some("pyramid"), layout, entries })
}

fn bound(binding: u32, buffer: &wgpu::Buffer) -> wgpu::BindGroupEntry<'_> {
    wgpu::BindGroupEntry { binding, resource: buffer.as_entire_binding() }
}

impl Pyramid {
    pub(super) fn new(gpu: &Gpu) -> Result<Pyramid, GpuError> {
        let module = gpu.device.create_shader_module(wgpu::include_wgsl!("pyramid.wgsl"));
        let pipeline = |entry_point| {
            gpu.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
                label: Some(entry_point),
                layout: None,
                module: &module,
                entry_point: Some(entry_point),
                compilation_options: wgpu::PipelineCompilationOptions::default(),
                cache: None,
            })
        };
        let storage = wgpu::BufferUsages::STORAGE;
        let uniform = wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST;
        Ok(Pyramid {
            reduce: pipeline("reduce"),
            test: pipeline("test"),
            boxes: Growing::new("boxes", storage),
            seen: Growing::new("answers", storage | wgpu::BufferUsages::COPY_SRC),
            asked: gpu.empty_buffer("number of boxes", uniform, 16)?,
            levels: None,
        })
    }

    /// Forgets the image that it is over.
    pub(super) fn forget(&mut self) {
        self.levels = None;
    }

    fn levels(&mut self, gpu: &Gpu, resolution: Resolution, depths: &wgpu::TextureView) -> Result<&Levels, GpuError> {
        if self.levels.as_ref().is_none_or(|levels| levels.resolution != resolution) {
            let (mut width, mut height) = (resolution.width, resolution.height);
            let mut table = vec![[0, width, height, 0]];
            let mut values = 0;
            while width > 1 || height > 1 {
                (width, height) = (width.div_ceil(2), height.div_ceil(2));
                table.push([values, width, height, 0]);
                values += width * height;
            }
            let storage = wgpu::BufferUsages::STORAGE;
            let levels = gpu.buffer("levels", storage, bytemuck::cast_slice(&table))?;
            let farthest = gpu.empty_buffer("pyramid", storage, 4 * u64::from(values))?;
            let image = |pipeline: &wgpu::ComputePipeline| {
                let view = wgpu::BindGroupEntry { binding: 0, resource: wgpu::BindingResource::TextureView(depths) };
                group(gpu, &pipeline.get_bind_group_layout(0), &[view, bound(1, &levels), bound(2, &farthest)])
            };
            let step = |(number, &[_, width, height, _]): (u32, &[u32; 4])| {
                let which = gpu.buffer("level", wgpu::BufferUsages::UNIFORM, bytemuck::bytes_of(&[number, 0, 0, 0]))?;
                Ok((width, height, group(gpu, &self.reduce.get_bind_group_layout(1), &[bound(0, &which)])))
            };
            let steps = (0..).zip(&table).skip(1).map(step).collect::<Result<_, GpuError>>()?;
            self.levels = Some(Levels { resolution, groups: [image(&self.reduce), image(&self.test)], steps });
        }
        let Some(levels) = &self.levels else { unreachable!("made above") };
        Ok(levels)
    }

    /// Has the pyramid made anew, if the image has `changed`, and boxes asked about.
    pub(super) fn encode(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        (resolution, depths): (Resolution, &wgpu::TextureView),
        changed: bool,
        asked: &[Drawable],
    ) -> Result<(), GpuError> {
        let count = asked.len() as u32;
        let boxes: Vec<AskedBox> = asked
            .iter()
            .map(|asked| {
                let [x, y] = [asked.rect.x, asked.rect.y];
                AskedBox { rect: [x[0], x[1] - 1, y[0], y[1] - 1], z: [asked.z; 4] }
            })
            .collect();
        self.boxes.write(gpu, bytemuck::cast_slice(&boxes))?;
        self.seen.reserve(gpu, 4 * u64::from(count))?;
        gpu.queue.write_buffer(&self.asked, 0, bytemuck::bytes_of(&[0, count, 0, 0]));
        let answers = group(
            gpu,
            &self.test.get_bind_group_layout(1),
            &[bound(0, &self.asked), bound(1, self.boxes.get()), bound(2, self.seen.get())],
        );
        self.levels(gpu, resolution, depths)?;
        let Some(levels) = &self.levels else { unreachable!("made above") };
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
        if changed {
            pass.set_pipeline(&self.reduce);
            pass.set_bind_group(0, &levels.groups[0], &[]);
            for (width, height, level) in &levels.steps {
                pass.set_bind_group(1, level, &[]);
                pass.dispatch_workgroups(width.div_ceil(8), height.div_ceil(8), 1);
            }
        }
        pass.set_pipeline(&self.test);
        pass.set_bind_group(0, &levels.groups[1], &[]);
        pass.set_bind_group(1, &answers, &[]);
        pass.dispatch_workgroups(count.div_ceil(64), 1, 1);
        Ok(())
    }

    /// The answers, a word for each box.
    pub(super) fn answers(&self) -> &wgpu::Buffer {
        self.seen.get()
    }
}
