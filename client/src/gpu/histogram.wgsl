// How often does each colour occur in an item buffer? (Klosowski & Silva 2001, §3.3.)

@group(0) @binding(0) var items: texture_2d<u32>;
@group(0) @binding(1) var<storage, read_write> bins: array<atomic<u32>>;

@compute
@workgroup_size(8, 8)
fn histogram(@builtin(global_invocation_id) at: vec3u) {
    if any(at.xy >= textureDimensions(items)) {
        return;
    }
    let colour = textureLoad(items, at.xy, 0).x;
    // The background's colour has no bin.
    if colour < arrayLength(&bins) {
        atomicAdd(&bins[colour], 1u);
    }
}
