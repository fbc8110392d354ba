//! What does each kind of query encode, and how is what comes back read?

use eyeline_visibility::{PixelRect, Resolution, Sides};

use super::boxes::Drawable;
use super::buffers::{Growing, ReadBack};
use super::image::{BOX_CORNERS, Camera, Drawing, Ends, GpuImage, ITEMS};
use super::picture::cleared;
use super::pyramid::Pyramid;
use super::tiles::Tiles;
use super::{Gpu, GpuError, GpuQueryKind};

/// A kind of query with what it needs on the adapter.
#[derive(Debug)]
pub(super) struct Way {
    boxes: Growing,
    how: How,
}

#[derive(Debug)]
enum How {
    Items { pipeline: wgpu::RenderPipeline, items: Items, tiles: Tiles },
    Histogram { pipeline: wgpu::RenderPipeline, items: Items, count: wgpu::ComputePipeline, bins: Growing },
    Occlusion { pipeline: wgpu::RenderPipeline, queries: wgpu::QuerySet, counts: Growing },
    PerFragment { pipeline: wgpu::RenderPipeline, layout: wgpu::BindGroupLayout, counts: Growing },
    Pyramid(Pyramid),
}

/// An item buffer of boxes, of the image's size.
#[derive(Debug, Default)]
struct Items(Option<(Resolution, wgpu::Texture, wgpu::TextureView)>);

impl Items {
    fn get(&mut self, gpu: &Gpu, resolution: Resolution) -> Result<(&wgpu::Texture, &wgpu::TextureView), GpuError> {
        if self.0.as_ref().is_none_or(|(of, ..)| *of != resolution) {
            let usage = wgpu::TextureUsages::RENDER_ATTACHMENT
                | wgpu::TextureUsages::COPY_SRC
                | wgpu::TextureUsages::TEXTURE_BINDING;
            let items = gpu.texture("boxes", resolution, ITEMS, usage)?;
            let view = items.create_view(&wgpu::TextureViewDescriptor::default());
            self.0 = Some((resolution, items, view));
        }
        let Some((_, items, view)) = &self.0 else { unreachable!("made above") };
        Ok((items, view))
    }
}

/// Bytes of a resolved occlusion query.
const QUERY_BYTES: u64 = wgpu::QUERY_SIZE as u64;

/// Bytes of a count.
const WORD: u64 = 4;

impl Way {
    pub(super) fn new(gpu: &Gpu, camera: &Camera, kind: GpuQueryKind) -> Result<Way, GpuError> {
        let device = &gpu.device;
        let boxes = |fragment, more| {
            let label = kind.name();
            // Of a closed box in front of the eye the sides that face it are all that is needed: half the fragments.
            let sides = Sides::Front;
            camera.pipeline(gpu, &Drawing { label, vertex: "cube", sides, writes_depth: false, fragment, more })
        };
        let coloured = || boxes(Some((&camera.module, "item", Some(ITEMS))), None);
        let storage = wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC;
        let how = match kind {
            GpuQueryKind::ItemBuffer => {
                How::Items { pipeline: coloured(), items: Items::default(), tiles: Tiles::whole() }
            }
            GpuQueryKind::ItemBufferTiled => {
                How::Items { pipeline: coloured(), items: Items::default(), tiles: Tiles::of_paper() }
            }
            GpuQueryKind::Histogram => How::Histogram {
                pipeline: coloured(),
                items: Items::default(),
                count: device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
                    label: Some("histogram"),
                    layout: None,
                    module: &device.create_shader_module(wgpu::include_wgsl!("histogram.wgsl")),
                    entry_point: Some("histogram"),
                    compilation_options: wgpu::PipelineCompilationOptions::default(),
                    cache: None,
                }),
                bins: Growing::new("bins", storage),
            },
            GpuQueryKind::OcclusionQueries | GpuQueryKind::OneAtATime => How::Occlusion {
                pipeline: boxes(None, None),
                queries: device.create_query_set(&wgpu::QuerySetDescriptor {
                    label: Some("boxes"),
                    ty: wgpu::QueryType::Occlusion,
                    count: wgpu::QUERY_SET_MAX_QUERIES,
                }),
                counts: Growing::new("counts", wgpu::BufferUsages::QUERY_RESOLVE | wgpu::BufferUsages::COPY_SRC),
            },
            GpuQueryKind::PerFragment => {
                if !device.features().contains(wgpu::Features::SHADER_EARLY_DEPTH_TEST) {
                    let what = "depth test before a shader that counts (SHADER_EARLY_DEPTH_TEST)";
                    return Err(GpuError::Lacks { adapter: gpu.name().to_owned(), what });
                }
                let layout = device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
                    label: Some("counts"),
                    entries: &[wgpu::BindGroupLayoutEntry {
                        binding: 0,
                        visibility: wgpu::ShaderStages::FRAGMENT,
                        ty: wgpu::BindingType::Buffer {
                            ty: wgpu::BufferBindingType::Storage { read_only: false },
                            has_dynamic_offset: false,
                            min_binding_size: None,
                        },
                        count: None,
                    }],
                });
                let module = device.create_shader_module(wgpu::include_wgsl!("count.wgsl"));
                // No image is drawn, and the depths stay attached: what Mesa's software needs to count right.
                let pipeline = boxes(Some((&module, "count", None)), Some(&layout));
                How::PerFragment { pipeline, layout, counts: Growing::new("counts", storage) }
            }
            GpuQueryKind::ZPyramid => How::Pyramid(Pyramid::new(gpu)?),
        };
        Ok(Way { boxes: Growing::new("boxes", wgpu::BufferUsages::VERTEX), how })
    }

    /// Starts another frame; what belongs to one size of image is forgotten if that `changes`.
    pub(super) fn begin(&mut self, resolution: Resolution, changes: bool) {
        match &mut self.how {
            How::Pyramid(pyramid) if changes => pyramid.forget(),
            How::Items { tiles, .. } => tiles.begin(resolution),
            _ => {}
        }
    }

    /// Starts another query.
    pub(super) fn ask(&mut self, whole_front: bool) {
        if let How::Items { tiles, .. } = &mut self.how {
            tiles.ask(whole_front);
        }
    }

    /// Whether a pass can show anything.
    pub(super) fn is_active(&self) -> bool {
        self.tiles().is_none_or(Tiles::are_active)
    }

    /// A whole front was answered, and none of its boxes went undrawn.
    pub(super) fn finish(&mut self) {
        if let How::Items { tiles, .. } = &mut self.how {
            tiles.finish();
        }
    }

    /// The parts of the image that are kept apart, if any.
    pub(super) fn tiles(&self) -> Option<&Tiles> {
        if let How::Items { tiles, .. } = &self.how { Some(tiles) } else { None }
    }

    /// Has boxes asked about.
    pub(super) fn draw(
        &mut self,
        encoder: &mut wgpu::CommandEncoder,
        image: &GpuImage,
        changed: bool,
        asked: &[Drawable],
    ) -> Result<(), GpuError> {
        let gpu = &*image.gpu;
        let (resolution, depths) = depths(image)?;
        let total = asked.len() as u32;
        if let How::Pyramid(pyramid) = &mut self.how {
            return pyramid.encode(gpu, encoder, (resolution, depths), changed, asked);
        }
        let ends: Vec<Ends> = asked.iter().map(|b| Ends { min: b.min.to_array(), max: b.max.to_array() }).collect();
        let boxes = self.boxes.write(gpu, bytemuck::cast_slice(&ends))?;
        // Depths are asked and not written, so that boxes do not hide each other.
        let depth = Some(wgpu::RenderPassDepthStencilAttachment { view: depths, depth_ops: None, stencil_ops: None });
        let start = |pass: &mut wgpu::RenderPass<'_>, pipeline: &wgpu::RenderPipeline| {
            pass.set_pipeline(pipeline);
            pass.set_bind_group(0, &image.camera.group, &[]);
            pass.set_vertex_buffer(0, boxes.slice(..));
        };
        let coloured = |encoder: &mut wgpu::CommandEncoder, view: &wgpu::TextureView, pipeline, within: PixelRect| {
            let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                label: Some("boxes"),
                color_attachments: &[Some(cleared(view))],
                depth_stencil_attachment: depth.clone(),
                ..wgpu::RenderPassDescriptor::default()
            });
            start(&mut pass, pipeline);
            let PixelRect { x, y } = within;
            pass.set_scissor_rect(x[0], y[0], x[1] - x[0], y[1] - y[0]);
            pass.draw(0..BOX_CORNERS, 0..total);
        };
        let whole = PixelRect { x: [0, resolution.width], y: [0, resolution.height] };
        match &mut self.how {
            How::Items { pipeline, items, tiles } => {
                let (_, view) = items.get(gpu, resolution)?;
                coloured(encoder, view, pipeline, tiles.drawn().unwrap_or(whole));
            }
            How::Histogram { pipeline, items, .. } => {
                let (_, view) = items.get(gpu, resolution)?;
                coloured(encoder, view, pipeline, whole);
            }
            How::Occlusion { pipeline, queries, counts } => {
                let bytes = QUERY_BYTES * u64::from(total);
                counts.reserve(gpu, bytes.next_multiple_of(wgpu::QUERY_RESOLVE_BUFFER_ALIGNMENT))?;
                let most = queries.count();
                for first in (0..total).step_by(most as usize) {
                    let count = most.min(total - first);
                    let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                        label: Some("boxes"),
                        depth_stencil_attachment: depth.clone(),
                        occlusion_query_set: Some(queries),
                        ..wgpu::RenderPassDescriptor::default()
                    });
                    start(&mut pass, pipeline);
                    for query in 0..count {
                        pass.begin_occlusion_query(query);
                        pass.draw(0..BOX_CORNERS, first + query..first + query + 1);
                        pass.end_occlusion_query();
                    }
                    drop(pass);
                    // A full set's results end where the next one's may begin: 4,096 of 8 bytes each.
                    encoder.resolve_query_set(queries, 0..count, counts.get(), QUERY_BYTES * u64::from(first));
                }
            }
            How::PerFragment { pipeline, layout, counts } => {
                counts.reserve(gpu, WORD * u64::from(total))?;
                encoder.clear_buffer(counts.get(), 0, None);
                let group = gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
                    label: Some("counts"),
                    layout,
                    entries: &[wgpu::BindGroupEntry { binding: 0, resource: counts.get().as_entire_binding() }],
                });
                let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                    label: Some("boxes"),
                    depth_stencil_attachment: depth.clone(),
                    ..wgpu::RenderPassDescriptor::default()
                });
                start(&mut pass, pipeline);
                pass.set_bind_group(1, &group, &[]);
                pass.draw(0..BOX_CORNERS, 0..total);
            }
            How::Pyramid(_) => unreachable!("encoded above"),
        }
        Ok(())
    }

    /// Has what says the answers about so many boxes copied to `to`; an item buffer's colours are counted before that, if they are.
    pub(super) fn collect(
        &mut self,
        encoder: &mut wgpu::CommandEncoder,
        image: &GpuImage,
        total: usize,
        to: &mut ReadBack,
    ) -> Result<(), GpuError> {
        let gpu = &*image.gpu;
        let (resolution, _) = depths(image)?;
        let words = WORD * total as u64;
        let (counts, bytes) = match &mut self.how {
            How::Items { items, tiles, .. } => return tiles.copy(gpu, encoder, items.get(gpu, resolution)?.0, to),
            How::Histogram { items, count, bins, .. } => {
                bins.reserve(gpu, words)?;
                encoder.clear_buffer(bins.get(), 0, None);
                let (_, view) = items.get(gpu, resolution)?;
                let group = gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
                    label: Some("histogram"),
                    layout: &count.get_bind_group_layout(0),
                    entries: &[
                        wgpu::BindGroupEntry { binding: 0, resource: wgpu::BindingResource::TextureView(view) },
                        wgpu::BindGroupEntry { binding: 1, resource: bins.get().as_entire_binding() },
                    ],
                });
                let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
                pass.set_pipeline(count);
                pass.set_bind_group(0, &group, &[]);
                pass.dispatch_workgroups(resolution.width.div_ceil(8), resolution.height.div_ceil(8), 1);
                drop(pass);
                (bins.get(), words)
            }
            How::Occlusion { counts, .. } => (counts.get(), QUERY_BYTES * total as u64),
            How::PerFragment { counts, .. } => (counts.get(), words),
            How::Pyramid(pyramid) => (pyramid.answers(), words),
        };
        encoder.copy_buffer_to_buffer(counts, 0, to.prepare(gpu, bytes)?, 0, bytes);
        Ok(())
    }

    /// Calls `add` with boxes, by their place among those asked, and what counts for them being seen. Returns the number of values
    /// looked at.
    pub(super) fn read(&mut self, bytes: &[u8], total: usize, mut add: impl FnMut(u32, u32)) -> u64 {
        match &mut self.how {
            How::Items { tiles, .. } => tiles.read(bytes, add),
            How::Occlusion { .. } => {
                let counts = bytes.chunks_exact(QUERY_BYTES as usize).take(total);
                let count = |bytes: &[u8]| u64::from_le_bytes(bytes.try_into().expect("8 bytes"));
                (0..).zip(counts).for_each(|(at, bytes)| add(at, count(bytes).min(u64::from(u32::MAX)) as u32));
                total as u64
            }
            How::Histogram { .. } | How::PerFragment { .. } | How::Pyramid(_) => {
                let counts: &[u32] = bytemuck::cast_slice(bytes);
                (0..).zip(&counts[..total]).for_each(|(at, &count)| add(at, count));
                total as u64
            }
        }
    }
}

/// The depths of an image that boxes are asked about in.
fn depths(image: &GpuImage) -> Result<(Resolution, &wgpu::TextureView), GpuError> {
    image.depths().ok_or_else(|| GpuError::Refused {
        adapter: image.gpu.name().to_owned(),
        reason: "boxes are asked about without an image".into(),
    })
}
