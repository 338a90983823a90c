// Ground-truth ambient occlusion in screen space (Jimenez, Wu, Pesce & Jarabo 2016, "Practical Realtime Strategies for
// Accurate Indirect Occlusion"), for any renderer: depth and normals in, ambient occlusion out (orograph.rendering.gpu.shade.ssao).
//
// In slices through the view vector the horizon is searched for on both sides along a line of pixels; the integral of
// the visible arc, weighted by the cosine to the normal projected into the slice, is in closed form. View space here: x
// right, y up, z the depth along the view axis (metres, positive into the picture). A depth ≤ 0 is sky.

struct Frame {
    size: vec2f,      // pixels
    slope: vec2f,     // of a pixel: metres right and up at depth 1, per pixel (perspective); or metres (orthographic)
    radius: f32,      // R, metres
    falloff: f32,     // fraction of R over which occluders fade out
    slices: u32,
    steps: u32,       // per side of a slice
    perspective: f32, // 1, or 0 for an orthographic view
    most: f32,        // pixels that R is clamped to
    power: f32,       // of the blur's weights: 1 / (depth difference in pixels' own slope that halves them)
    seed: f32,
};

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var depth: texture_2d<f32>;    // metres along the view axis; ≤ 0: sky
@group(0) @binding(2) var normals: texture_2d<f32>;  // unit, in view space (right, up, into the picture)
@group(0) @binding(3) var occlusion: texture_2d<f32>;
@group(0) @binding(4) var out: texture_storage_2d<r32float, write>;

// include: angles.wgsl

fn depth_at(pixel: vec2i) -> f32 {
    return textureLoad(depth, clamp(pixel, vec2i(0), vec2i(frame.size) - 1), 0).x;
}

// A pixel's point in view space.
fn point_of(pixel: vec2f, z: f32) -> vec3f {
    let centre = (pixel + 0.5 - 0.5 * frame.size) * frame.slope * vec2f(1.0, -1.0);
    return vec3f(centre * select(1.0, z, frame.perspective > 0.0), z);
}

// Depth between pixels: interpolation keeps planes planar (1 / z is linear on the screen, in perspective). 0: sky.
fn depth_between(at: vec2f) -> f32 {
    let first = vec2i(floor(at));
    let f = at - vec2f(first);
    let z = vec4f(depth_at(first), depth_at(first + vec2i(1, 0)), depth_at(first + vec2i(0, 1)), depth_at(first + 1));
    if (min(min(z.x, z.y), min(z.z, z.w)) <= 0.0) {
        return 0.0;
    }
    let v = select(z, 1.0 / z, frame.perspective > 0.0);
    let between = mix(mix(v.x, v.y, f.x), mix(v.z, v.w, f.x), f.y);
    return select(between, 1.0 / between, frame.perspective > 0.0);
}

// Interleaved gradient noise (Jimenez 2014): slices and steps differ between neighbours, and the blur evens this out.
fn noise(pixel: vec2f) -> f32 {
    return fract(52.9829189 * fract(dot(pixel + 5.588238 * frame.seed, vec2f(0.06711056, 0.00583715))));
}

// ∫ of the visible arc from the view vector to the horizon h, of the cosine to a normal at γ (Jimenez et al., eq. 7).
fn arc(h: f32, gamma: f32) -> f32 {
    let t = sine_cosine(gamma);
    return 0.25 * (-sine_cosine(2.0 * h - gamma).y + t.y + 2.0 * h * t.x);
}

@compute @workgroup_size(8, 8)
fn main(@builtin(global_invocation_id) id: vec3u) {
    let pixel = vec2i(id.xy);
    if (any(pixel >= vec2i(frame.size))) {
        return;
    }
    let z = depth_at(pixel);
    if (z <= 0.0) {
        textureStore(out, pixel, vec4f(1.0));
        return;
    }
    let p = point_of(vec2f(pixel), z);
    let normal = textureLoad(normals, pixel, 0).xyz;
    let view = select(vec3f(0.0, 0.0, -1.0), -normalize(p), frame.perspective > 0.0);
    // R in pixels, at this depth.
    let reach = min(frame.radius / (abs(frame.slope.x) * select(1.0, z, frame.perspective > 0.0)), frame.most);
    if (reach < 1.0) {
        textureStore(out, pixel, vec4f(1.0));
        return;
    }
    let shift = noise(vec2f(pixel));
    let stagger = fract(shift * 7.0 + 0.5);
    var seen = 0.0;
    var full = 0.0;
    for (var slice = 0u; slice < frame.slices; slice++) {
        let turn = sine_cosine((f32(slice) + shift) * PI / f32(frame.slices));
        let along = vec2f(turn.y, -turn.x);  // in pixels, rows downward
        let way = vec3f(turn.y, turn.x, 0.0);
        // The slice's plane holds the view vector; the normal is projected into it.
        let side = normalize(cross(way, view));
        let tangent = cross(view, side);
        let flat = normal - side * dot(normal, side);
        let size = length(flat);
        if (size < 1e-4) {
            continue;
        }
        let gamma = angle_of(dot(flat, tangent), dot(flat, view));
        let cut = frame.radius * (1.0 - frame.falloff);
        var horizons = vec2f(-1.0);  // cosines
        for (var k = 0; k < 2; k++) {
            let sign = select(-1.0, 1.0, k == 1);
            // The lowest possible horizon is the pixel's own plane.
            let low = sine_cosine(gamma + sign * 0.5 * PI).y;
            var horizon = low;
            for (var j = 0u; j < frame.steps; j++) {
                // Steps grow outward, because near occluders matter most.
                let share = (f32(j) + stagger) / f32(frame.steps);
                let offset = max(share * share * reach, f32(j) + 1.0);
                if (offset > reach + 1.0) {
                    break;
                }
                let at = vec2f(pixel) + sign * offset * along;
                if (any(at < vec2f(0.0)) || any(at > frame.size - 1.0)) {
                    break;
                }
                let deep = depth_between(at);
                if (deep <= 0.0) {
                    continue;
                }
                let way_there = point_of(at, deep) - p;
                let away = length(way_there);
                let weight = clamp((frame.radius - away) / max(frame.radius - cut, 1e-6), 0.0, 1.0);
                horizon = max(horizon, mix(low, dot(way_there, view) / max(away, 1e-9), weight));
            }
            horizons[k] = horizon;
        }
        // Angles from the view vector, negative on the first side, no lower than the normal's own plane.
        let first = max(-angle_of_cosine(clamp(horizons.x, -1.0, 1.0)), gamma - 0.5 * PI);
        let second = min(angle_of_cosine(clamp(horizons.y, -1.0, 1.0)), gamma + 0.5 * PI);
        seen += size * (arc(first, gamma) + arc(second, gamma));
        // The sum of the same slices over open ground: without it, a small number of slices makes slopes uneven.
        full += size * (arc(gamma - 0.5 * PI, gamma) + arc(gamma + 0.5 * PI, gamma));
    }
    textureStore(out, pixel, vec4f(select(1.0, clamp(seen / full, 0.0, 1.0), full > 0.0)));
}

// A 5 × 5 blur within one surface: weights fall with the distance from the pixel's own plane.
@compute @workgroup_size(8, 8)
fn blur(@builtin(global_invocation_id) id: vec3u) {
    let pixel = vec2i(id.xy);
    if (any(pixel >= vec2i(frame.size))) {
        return;
    }
    let z = depth_at(pixel);
    if (z <= 0.0) {
        textureStore(out, pixel, vec4f(1.0));
        return;
    }
    let p = point_of(vec2f(pixel), z);
    let normal = textureLoad(normals, pixel, 0).xyz;
    let width = abs(frame.slope.x) * select(1.0, z, frame.perspective > 0.0);
    var sum = 0.0;
    var weights = 0.0;
    for (var j = -2; j <= 2; j++) {
        for (var i = -2; i <= 2; i++) {
            let at = pixel + vec2i(i, j);
            if (any(at < vec2i(0)) || any(at >= vec2i(frame.size))) {
                continue;
            }
            let deep = depth_at(at);
            if (deep <= 0.0) {
                continue;
            }
            let off = dot(point_of(vec2f(at), deep) - p, normal) / width * frame.power;
            let alike = max(dot(normal, textureLoad(normals, at, 0).xyz), 0.0);
            let weight = exp2(-off * off) * alike * alike;
            sum += weight * textureLoad(occlusion, at, 0).x;
            weights += weight;
        }
    }
    textureStore(out, pixel, vec4f(select(textureLoad(occlusion, pixel, 0).x, sum / weights, weights > 0.0)));
}
