// The farthest depths of ever larger squares of the image, and boxes against them (Greene, Kass & Miller 1993).

struct Level {
    // Where its values begin; those of level 0 are the image's.
    begin: u32,
    width: u32,
    height: u32,
    unused: u32,
}

@group(0) @binding(0) var depths: texture_depth_2d;
@group(0) @binding(1) var<storage, read> levels: array<Level>;
@group(0) @binding(2) var<storage, read_write> farthest: array<f32>;

fn value(level: u32, at: vec2u) -> f32 {
    if level == 0u {
        return textureLoad(depths, at, 0);
    }
    return farthest[levels[level].begin + at.y * levels[level].width + at.x];
}

@group(1) @binding(0) var<uniform> reduced: vec4u;

// One level from the one below.
@compute
@workgroup_size(8, 8)
fn reduce(@builtin(global_invocation_id) at: vec3u) {
    let here = levels[reduced.x];
    if at.x >= here.width || at.y >= here.height {
        return;
    }
    let below = levels[reduced.x - 1u];
    let first = at.xy * 2u;
    // At an odd edge the last column or row stands for itself twice.
    let last = min(first + vec2u(1u, 1u), vec2u(below.width - 1u, below.height - 1u));
    let level = reduced.x - 1u;
    let upper = min(value(level, first), value(level, vec2u(last.x, first.y)));
    let lower = min(value(level, vec2u(first.x, last.y)), value(level, last));
    farthest[here.begin + at.y * here.width + at.x] = min(upper, lower);
}

struct Box {
    // First and last column, first and last row.
    rect: vec4u,
    // Its greatest reversed depth, as bits.
    z: vec4u,
}

// The most columns and rows of values that a box is held against: the smaller, the less is looked at and the more is seen.
const SIDE_MAX: u32 = 8u;

@group(1) @binding(1) var<storage, read> boxes: array<Box>;
@group(1) @binding(2) var<storage, read_write> seen: array<u32>;

@compute
@workgroup_size(64)
fn test(@builtin(global_invocation_id) at: vec3u) {
    if at.x >= arrayLength(&boxes) || at.x >= reduced.y {
        return;
    }
    let asked = boxes[at.x];
    var rect = asked.rect;
    var level = 0u;
    while max(rect.y - rect.x, rect.w - rect.z) >= SIDE_MAX && level + 1u < arrayLength(&levels) {
        rect = rect / 2u;
        level += 1u;
    }
    let z = bitcast<f32>(asked.z.x);
    var passes = 0u;
    for (var y = rect.z; y <= rect.w; y += 1u) {
        for (var x = rect.x; x <= rect.y; x += 1u) {
            // A tie is seen.
            if value(level, vec2u(x, y)) <= z {
                passes = 1u;
            }
        }
    }
    seen[at.x] = passes;
}
