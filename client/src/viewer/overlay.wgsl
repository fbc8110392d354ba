// Lines and faces over the scene, in the scene's space or in pixels.

struct Camera {
    clip_from_eye: mat4x4<f32>,
    eye: vec4<f32>,
    eye_rest: vec4<f32>,
    sun: vec4<f32>,
}

@group(0) @binding(0) var<uniform> camera: Camera;

struct Fragment {
    @builtin(position) clip: vec4<f32>,
    @location(0) color: vec4<f32>,
}

@vertex
fn in_scene(@location(0) place: vec3<f32>, @location(1) color: vec4<f32>) -> Fragment {
    let from_eye = (place - camera.eye.xyz) - camera.eye_rest.xyz;
    return Fragment(camera.clip_from_eye * vec4<f32>(from_eye, 1.0), color);
}

// Places were divided by the image's size already: 0 to 1 from its upper left corner.
@vertex
fn in_image(@location(0) place: vec3<f32>, @location(1) color: vec4<f32>) -> Fragment {
    return Fragment(vec4<f32>(2.0 * place.x - 1.0, 1.0 - 2.0 * place.y, 0.5, 1.0), color);
}

@fragment
fn fragment(in: Fragment) -> @location(0) vec4<f32> {
    return in.color;
}
