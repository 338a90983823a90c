// Draw a texture over the whole viewport, filtered where the sizes differ.

@group(0) @binding(0) var picture: texture_2d<f32>;
@group(0) @binding(1) var filtering: sampler;

struct Corner {
    @builtin(position) position: vec4f,
    @location(0) uv: vec2f,
}

@vertex
fn corner(@builtin(vertex_index) index: u32) -> Corner {
    // One triangle that covers the viewport: (0, 0), (2, 0), (0, 2).
    let uv = vec2f(f32((index << 1u) & 2u), f32(index & 2u));
    return Corner(vec4f(uv * vec2f(2.0, -2.0) + vec2f(-1.0, 1.0), 0.0, 1.0), uv);
}

@fragment
fn shade(in: Corner) -> @location(0) vec4f {
    return vec4f(textureSample(picture, filtering, in.uv).rgb, 1.0);
}
