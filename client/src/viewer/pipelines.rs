//! How triangles are drawn: layouts of what shaders are given, and a pipeline for each kind of triangle.

use super::model::{Kind, SkinCorner, Vertex};
use super::renderer::{DEPTH, Instance};

/// Pipelines come in this order: two-sided or not, blended or not, carried by bones or not.
pub fn pipeline_index(kind: Kind, is_carried: bool) -> usize {
    usize::from(kind.is_two_sided) + 2 * usize::from(kind.is_blended) + 4 * usize::from(is_carried)
}

/// Group 2 of the scene's shader: three rows for each bone.
pub fn bones_layout(device: &wgpu::Device) -> wgpu::BindGroupLayout {
    device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
        label: Some("bones"),
        entries: &[wgpu::BindGroupLayoutEntry {
            binding: 0,
            visibility: wgpu::ShaderStages::VERTEX,
            ty: wgpu::BindingType::Buffer {
                ty: wgpu::BufferBindingType::Storage { read_only: true },
                has_dynamic_offset: false,
                min_binding_size: None,
            },
            count: None,
        }],
    })
}

/// Bones in a buffer.
pub fn bones_group(device: &wgpu::Device, layout: &wgpu::BindGroupLayout, bones: &wgpu::Buffer) -> wgpu::BindGroup {
    device.create_bind_group(&wgpu::BindGroupDescriptor {
        label: Some("bones"),
        layout,
        entries: &[wgpu::BindGroupEntry { binding: 0, resource: bones.as_entire_binding() }],
    })
}

/// Group 1 of the scene's shader: a texture and its sampler.
pub fn texture_layout(device: &wgpu::Device) -> wgpu::BindGroupLayout {
    device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
        label: Some("texture"),
        entries: &[
            wgpu::BindGroupLayoutEntry {
                binding: 0,
                visibility: wgpu::ShaderStages::FRAGMENT,
                ty: wgpu::BindingType::Texture {
                    sample_type: wgpu::TextureSampleType::Float { filterable: true },
                    view_dimension: wgpu::TextureViewDimension::D2,
                    multisampled: false,
                },
                count: None,
            },
            wgpu::BindGroupLayoutEntry {
                binding: 1,
                visibility: wgpu::ShaderStages::FRAGMENT,
                ty: wgpu::BindingType::Sampler(wgpu::SamplerBindingType::Filtering),
                count: None,
            },
        ],
    })
}

/// All of them, by [`pipeline_index`], over groups of a camera, a texture, and bones.
pub fn pipelines(
    device: &wgpu::Device,
    [camera, texture, bones]: [&wgpu::BindGroupLayout; 3],
    format: wgpu::TextureFormat,
) -> Vec<wgpu::RenderPipeline> {
    let shader = device.create_shader_module(wgpu::include_wgsl!("scene.wgsl"));
    let layout = |groups: &[Option<&wgpu::BindGroupLayout>]| {
        device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some("scene"),
            bind_group_layouts: groups,
            immediate_size: 0,
        })
    };
    let plain = layout(&[Some(camera), Some(texture)]);
    let carried = layout(&[Some(camera), Some(texture), Some(bones)]);
    let corner = wgpu::vertex_attr_array![0 => Float32x3, 1 => Snorm8x4, 2 => Float32x2, 3 => Unorm16x4];
    let place =
        wgpu::vertex_attr_array![4 => Float32x4, 5 => Float32x4, 6 => Float32x4, 7 => Float32x4, 10 => Uint32x4];
    let carrying = wgpu::vertex_attr_array![8 => Uint8x4, 9 => Unorm16x4];
    let buffers = [
        Some(wgpu::VertexBufferLayout {
            array_stride: size_of::<Vertex>() as u64,
            step_mode: wgpu::VertexStepMode::Vertex,
            attributes: &corner,
        }),
        Some(wgpu::VertexBufferLayout {
            array_stride: size_of::<Instance>() as u64,
            step_mode: wgpu::VertexStepMode::Instance,
            attributes: &place,
        }),
        Some(wgpu::VertexBufferLayout {
            array_stride: size_of::<SkinCorner>() as u64,
            step_mode: wgpu::VertexStepMode::Vertex,
            attributes: &carrying,
        }),
    ];
    let pipeline = |index: usize| {
        let [is_two_sided, is_blended, is_carried] = [1, 2, 4].map(|bit| index & bit != 0);
        device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
            label: Some("scene"),
            layout: Some(if is_carried { &carried } else { &plain }),
            vertex: wgpu::VertexState {
                module: &shader,
                entry_point: Some(if is_carried { "carried" } else { "vertex" }),
                compilation_options: wgpu::PipelineCompilationOptions::default(),
                buffers: if is_carried { &buffers } else { &buffers[..2] },
            },
            primitive: wgpu::PrimitiveState {
                cull_mode: (!is_two_sided).then_some(wgpu::Face::Back),
                ..wgpu::PrimitiveState::default()
            },
            depth_stencil: Some(wgpu::DepthStencilState {
                format: DEPTH,
                depth_write_enabled: Some(!is_blended),
                // Greater is nearer; of equally near ones the first stays.
                depth_compare: Some(wgpu::CompareFunction::Greater),
                stencil: wgpu::StencilState::default(),
                bias: wgpu::DepthBiasState::default(),
            }),
            multisample: wgpu::MultisampleState::default(),
            fragment: Some(wgpu::FragmentState {
                module: &shader,
                entry_point: Some(if is_blended { "blended" } else { "opaque" }),
                compilation_options: wgpu::PipelineCompilationOptions::default(),
                targets: &[Some(wgpu::ColorTargetState {
                    format,
                    blend: is_blended.then_some(wgpu::BlendState::ALPHA_BLENDING),
                    write_mask: wgpu::ColorWrites::ALL,
                })],
            }),
            multiview_mask: None,
            cache: None,
        })
    };
    (0..8).map(pipeline).collect()
}
