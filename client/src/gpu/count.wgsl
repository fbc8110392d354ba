// The per-fragment histogram: how many fragments of each box pass the depth test? (Klosowski & Silva 2001, §3.6.) The test must come
// before the shader, else every fragment would count.

@group(1) @binding(0) var<storage, read_write> counts: array<atomic<u32>>;

@fragment
@early_depth_test(force)
fn count(@location(0) @interpolate(flat) id: u32) {
    atomicAdd(&counts[id], 1u);
}
