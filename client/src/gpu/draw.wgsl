// Triangles of a scene, and boxes, as a view shows them.

struct View {
    // Rows of clip space from scene axes at the eye; `right.w` is the near plane's distance, `up.w` what boxes' depths are multiplied by.
    right: vec4f,
    up: vec4f,
    forward: vec4f,
    // The eye as a sum of two, so that the difference from a corner is right to the last bits.
    eye: vec4f,
    eye_rest: vec4f,
}

@group(0) @binding(0) var<uniform> view: View;

struct Item {
    @invariant @builtin(position) position: vec4f,
    @location(0) @interpolate(flat) id: u32,
}

// Reversed depth: near / distance, without a far plane.
fn clip(from_eye: vec3f, near: f32) -> vec4f {
    return vec4f(dot(view.right.xyz, from_eye), dot(view.up.xyz, from_eye), near, dot(view.forward.xyz, from_eye));
}

@vertex
fn triangle(@builtin(vertex_index) index: u32, @location(0) corner: vec3f) -> Item {
    return Item(clip((corner - view.eye.xyz) - view.eye_rest.xyz, view.right.w), index / 3u);
}

@vertex
fn cube(
    @builtin(vertex_index) index: u32,
    @builtin(instance_index) id: u32,
    @location(1) least: vec3f,
    @location(2) greatest: vec3f,
) -> Item {
    // Two triangles a face, anticlockwise from outside; bits of a corner say which of x, y and z is the greatest.
    var corners = array<u32, 36>(
        4u, 5u, 7u, 4u, 7u, 6u, 1u, 0u, 2u, 1u, 2u, 3u, 5u, 1u, 3u, 5u, 3u, 7u,
        0u, 4u, 6u, 0u, 6u, 2u, 6u, 7u, 3u, 6u, 3u, 2u, 0u, 1u, 5u, 0u, 5u, 4u,
    );
    let corner = corners[index];
    let far = vec3<bool>((corner & 1u) != 0u, (corner & 2u) != 0u, (corner & 4u) != 0u);
    return Item(clip(select(least, greatest, far), view.right.w * view.up.w), id);
}

@fragment
fn item(@location(0) @interpolate(flat) id: u32) -> @location(0) u32 {
    return id;
}
