// Light on points of the ground through a field of caps, interpolated between its samples (orograph.lighting.gpu.aperture).

// include: aperture.wgsl

struct Frame {
    counts: vec4u,   // points, suns, lamps; 1 for the exact overlap
    size: vec4u,     // columns and rows of the field
    ambient: vec4f,
};

struct Point {
    place: vec3f,    // metres from the origin
    col: f32,        // in the field
    gradient: vec2f, // rise per metre east and north
    row: f32,
    pad: f32,
};

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<storage, read> points: array<Point>;
@group(0) @binding(2) var<storage, read> field: array<vec4f>;
@group(0) @binding(3) var<storage, read> suns: array<Sun>;
@group(0) @binding(4) var<storage, read> lamps: array<Lamp>;
@group(0) @binding(5) var<storage, read_write> lit: array<vec4f>;

fn illuminate(cap: Cap, normal: vec3f, place: vec3f) -> vec3f {
    var light = vec3f(0.0);
    var sky = sky_through(cap, normal);
    for (var k = 0u; k < frame.counts.y; k++) {
        let seen = sun_through(cap, normal, suns[k], frame.counts.w == 1u);
        light += seen * suns[k].color;
        sky -= covered(seen, suns[k]);
    }
    for (var k = 0u; k < frame.counts.z; k++) {
        light += lamp_through(cap, normal, place, lamps[k]) * lamps[k].color;
    }
    return light + max(sky, 0.0) * frame.ambient.rgb;
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3u, @builtin(num_workgroups) groups: vec3u) {
    let index = id.y * groups.x * 64u + id.x;
    if (index >= frame.counts.x) {
        return;
    }
    let p = points[index];
    let last = vec2i(frame.size.xy) - 1;
    let at = clamp(vec2i(floor(vec2f(p.col, p.row))), vec2i(0), max(last - 1, vec2i(0)));
    let f = clamp(vec2f(p.col, p.row) - vec2f(at), vec2f(0.0), vec2f(1.0));
    let next = min(at + 1, last);
    let row0 = u32(at.y) * frame.size.x;
    let row1 = u32(next.y) * frame.size.x;
    let above = mix(field[row0 + u32(at.x)], field[row0 + u32(next.x)], f.x);
    let below = mix(field[row1 + u32(at.x)], field[row1 + u32(next.x)], f.x);
    let cap = cap_of(mix(above, below, f.y));
    let normal = normalize(vec3f(-p.gradient, 1.0));
    lit[index] = vec4f(illuminate(cap, normal, p.place), 0.0);
}
