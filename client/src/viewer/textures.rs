//! Textures on the GPU, each with its smaller copies so that far floors do not shimmer.

use eyeline_visibility::Wrap;

use super::gpu::Gpu;
use super::model::Texture;

/// A texture and its sampler, for group 1 of the scene's shader. One that is larger than the adapter takes is made smaller.
pub fn upload(gpu: &Gpu, layout: &wgpu::BindGroupLayout, texture: &Texture) -> wgpu::BindGroup {
    let limit = gpu.device.limits().max_texture_dimension_2d;
    let (mut width, mut height) = (texture.width, texture.height);
    let mut copy: Option<Vec<u8>> = None;
    while width.max(height) > limit {
        copy = Some(halved(copy.as_deref().unwrap_or(&texture.rgba), width, height));
        (width, height) = ((width / 2).max(1), (height / 2).max(1));
    }
    if copy.is_some() {
        let (of, takes) = ((texture.width, texture.height), (width, height));
        tracing::warn!("a texture of {of:?} pixels is drawn as one of {takes:?}: {} takes {limit} a side", gpu.name());
    }
    let size = wgpu::Extent3d { width, height, depth_or_array_layers: 1 };
    let levels = size.max_mips(wgpu::TextureDimension::D2);
    let image = gpu.device.create_texture(&wgpu::TextureDescriptor {
        label: Some("texture"),
        size,
        mip_level_count: levels,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format: wgpu::TextureFormat::Rgba8UnormSrgb,
        usage: wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST,
        view_formats: &[],
    });
    for level in 0..levels {
        let pixels = copy.as_deref().unwrap_or(&texture.rgba);
        let place = wgpu::TexelCopyTextureInfo { mip_level: level, ..image.as_image_copy() };
        let layout = wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(4 * width), rows_per_image: None };
        let size = wgpu::Extent3d { width, height, depth_or_array_layers: 1 };
        gpu.queue.write_texture(place, pixels, layout, size);
        if level + 1 < levels {
            copy = Some(halved(pixels, width, height));
            (width, height) = ((width / 2).max(1), (height / 2).max(1));
        }
    }
    let sampler = gpu.device.create_sampler(&sampler(texture));
    gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
        label: Some("texture"),
        layout,
        entries: &[
            wgpu::BindGroupEntry {
                binding: 0,
                resource: wgpu::BindingResource::TextureView(
                    &image.create_view(&wgpu::TextureViewDescriptor::default()),
                ),
            },
            wgpu::BindGroupEntry { binding: 1, resource: wgpu::BindingResource::Sampler(&sampler) },
        ],
    })
}

fn sampler(texture: &Texture) -> wgpu::SamplerDescriptor<'static> {
    let mode = |wrap| match wrap {
        Wrap::Repeat => wgpu::AddressMode::Repeat,
        Wrap::Mirror => wgpu::AddressMode::MirrorRepeat,
        Wrap::Clamp => wgpu::AddressMode::ClampToEdge,
    };
    let [u, v] = texture.use_.map_or([Wrap::Repeat; 2], |use_| use_.wrap).map(mode);
    let is_nearest = texture.use_.is_some_and(|use_| use_.is_nearest);
    wgpu::SamplerDescriptor {
        label: Some("texture"),
        address_mode_u: u,
        address_mode_v: v,
        mag_filter: if is_nearest { wgpu::FilterMode::Nearest } else { wgpu::FilterMode::Linear },
        min_filter: wgpu::FilterMode::Linear,
        mipmap_filter: wgpu::MipmapFilterMode::Linear,
        ..wgpu::SamplerDescriptor::default()
    }
}

/// Half as wide and high, each pixel the mean of the four that it covers (fewer at an odd edge, which is left out). Means are
/// taken of light and not of its code, else fine black and white patterns would darken with distance.
fn halved(pixels: &[u8], width: u32, height: u32) -> Vec<u8> {
    let linear: Vec<f32> = (0..=255u8).map(|code| to_linear(f32::from(code) / 255.0)).collect();
    let (w, h) = ((width / 2).max(1), (height / 2).max(1));
    let mut out = Vec::with_capacity(4 * (w * h) as usize);
    let at = |x: u32, y: u32| 4 * (y.min(height - 1) as usize * width as usize + x.min(width - 1) as usize);
    for y in 0..h {
        for x in 0..w {
            let four = [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(dx, dy)| at(2 * x + dx, 2 * y + dy));
            for axis in 0..3 {
                let mean = four.iter().map(|&at| linear[usize::from(pixels[at + axis])]).sum::<f32>() * 0.25;
                out.push((from_linear(mean) * 255.0).round() as u8);
            }
            out.push((four.iter().map(|&at| u32::from(pixels[at + 3])).sum::<u32>() / 4) as u8);
        }
    }
    out
}

/// sRGB's code to light (IEC 61966-2-1).
fn to_linear(code: f32) -> f32 {
    if code <= 0.040_45 { code / 12.92 } else { ((code + 0.055) / 1.055).powf(2.4) }
}

/// Light to sRGB's code.
fn from_linear(light: f32) -> f32 {
    if light <= 0.003_130_8 { light * 12.92 } else { 1.055 * light.powf(1.0 / 2.4) - 0.055 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn halving_averages_light_and_keeps_a_last_pixel() {
        let checks = [[0u8, 0, 0, 255], [255, 255, 255, 255], [255, 255, 255, 255], [0, 0, 0, 255]].concat();
        // Half the light is code 188, not 128.
        assert_eq!(halved(&checks, 2, 2), [188, 188, 188, 255]);
        let even = [7u8, 8, 9, 10].repeat(5 * 3);
        assert_eq!(halved(&even, 5, 3), [7, 8, 9, 10].repeat(2));
        assert_eq!(halved(&[1, 2, 3, 4], 1, 1), [1, 2, 3, 4]);
    }
}
