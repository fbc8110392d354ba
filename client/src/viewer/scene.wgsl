// The scene: base colour times texture, lit simply. Positions are taken relative to the eye before they are turned, with the
// eye in two parts, so that a world a few kilometres wide does not shake.

struct Camera {
    // View space to clip space and the turn into view space, in one.
    clip_from_eye: mat4x4<f32>,
    // The eye, rounded to f32, and what was lost by that. The eye's w is above 0 if depth is shown: the distance of half brightness.
    eye: vec4<f32>,
    eye_rest: vec4<f32>,
    // Towards the sun, and the share of light from the sky.
    sun: vec4<f32>,
}

@group(0) @binding(0) var<uniform> camera: Camera;
@group(1) @binding(0) var base: texture_2d<f32>;
@group(1) @binding(1) var base_sampler: sampler;

struct Corner {
    @location(0) position: vec3<f32>,
    @location(1) normal: vec4<f32>,
    @location(2) uv: vec2<f32>,
    @location(3) color: vec4<f32>,
    // Rows of the transform that places the mesh, and a colour to multiply by.
    @location(4) row_x: vec4<f32>,
    @location(5) row_y: vec4<f32>,
    @location(6) row_z: vec4<f32>,
    @location(7) tint: vec4<f32>,
}

struct Fragment {
    @builtin(position) clip: vec4<f32>,
    @location(0) normal: vec3<f32>,
    @location(1) uv: vec2<f32>,
    @location(2) color: vec4<f32>,
    @location(3) from_eye: vec3<f32>,
    @location(4) @interpolate(flat) cutoff: f32,
}

// Three rows for each bone.
@group(2) @binding(0) var<storage, read> bones: array<vec4<f32>>;

@vertex
fn vertex(corner: Corner) -> Fragment {
    return placed(corner, corner.position, corner.normal.xyz);
}

// A corner that bones carry: the mean of where they take it.
@vertex
fn carried(
    corner: Corner,
    @location(8) numbers: vec4<u32>,
    @location(9) weights: vec4<f32>,
    @location(10) first_bone: vec4<u32>,
) -> Fragment {
    let local = vec4<f32>(corner.position, 1.0);
    var position = vec3<f32>(0.0);
    var normal = vec3<f32>(0.0);
    for (var i = 0; i < 4; i++) {
        let at = 3u * (first_bone.x + numbers[i]);
        let x = bones[at];
        let y = bones[at + 1u];
        let z = bones[at + 2u];
        position += weights[i] * vec3<f32>(dot(x, local), dot(y, local), dot(z, local));
        // Bones hardly stretch, so that normals go as directions do.
        let along = corner.normal.xyz;
        normal += weights[i] * vec3<f32>(dot(x.xyz, along), dot(y.xyz, along), dot(z.xyz, along));
    }
    // A body may be scaled as a whole; what has no length stays so.
    let length_squared = dot(normal, normal);
    normal *= select(0.0, inverseSqrt(max(length_squared, 1e-30)), length_squared > 1e-30);
    return placed(corner, position, normal);
}

fn placed(corner: Corner, position: vec3<f32>, normal: vec3<f32>) -> Fragment {
    let local = vec4<f32>(position, 1.0);
    let place = vec3<f32>(dot(corner.row_x, local), dot(corner.row_y, local), dot(corner.row_z, local));
    let from_eye = (place - camera.eye.xyz) - camera.eye_rest.xyz;
    var out: Fragment;
    out.clip = camera.clip_from_eye * vec4<f32>(from_eye, 1.0);
    out.normal = vec3<f32>(dot(corner.row_x.xyz, normal), dot(corner.row_y.xyz, normal), dot(corner.row_z.xyz, normal));
    out.uv = corner.uv;
    out.color = corner.color * corner.tint;
    out.from_eye = from_eye;
    out.cutoff = corner.normal.w;
    return out;
}

fn lit(in: Fragment, base_color: vec4<f32>) -> vec4<f32> {
    if camera.eye.w > 0.0 {
        let share = camera.eye.w / (camera.eye.w + length(in.from_eye));
        return vec4<f32>(vec3<f32>(share * share), base_color.a);
    }
    // A face that is seen from behind is lit as if it had another one there; a normal without length is lit evenly.
    let length_squared = dot(in.normal, in.normal);
    var normal = in.normal * inverseSqrt(max(length_squared, 1e-6));
    if dot(normal, in.from_eye) > 0.0 {
        normal = -normal;
    }
    let towards = -normalize(in.from_eye);
    let sun = max(dot(normal, camera.sun.xyz), 0.0);
    let sky = 0.5 + 0.5 * normal.y;
    // A little light from the eye tells walls apart that neither sun nor sky reaches differently.
    let head = max(dot(normal, towards), 0.0);
    let light = camera.sun.w * (0.4 + 0.6 * sky) + 0.5 * sun + 0.12 * head + 0.08 * abs(normal.x);
    return vec4<f32>(base_color.rgb * light, base_color.a);
}

@fragment
fn opaque(in: Fragment) -> @location(0) vec4<f32> {
    let base_color = in.color * textureSample(base, base_sampler, in.uv);
    if base_color.a < in.cutoff {
        discard;
    }
    return vec4<f32>(lit(in, base_color).rgb, 1.0);
}

@fragment
fn blended(in: Fragment) -> @location(0) vec4<f32> {
    return lit(in, in.color * textureSample(base, base_sampler, in.uv));
}
