// From linear light to the display: the mean over accumulated frames, then sRGB.

struct Resolve { pad: u32, frames: f32, encode: u32, occlusion: f32 };   // strength of what darkens corners

@group(0) @binding(0) var<uniform> resolve: Resolve;
@group(0) @binding(1) var light: texture_2d<f32>;
@group(0) @binding(2) var open: texture_2d<f32>;   // how open a pixel's surroundings are, 1: wholly

@vertex
fn vertex(@builtin(vertex_index) k: u32) -> @builtin(position) vec4<f32> {
  return vec4<f32>(f32(k & 1u) * 4.0 - 1.0, f32(k >> 1u) * 4.0 - 1.0, 0.0, 1.0);
}

fn srgb(x: vec3<f32>) -> vec3<f32> {
  let c = clamp(x, vec3<f32>(0.0), vec3<f32>(1.0));
  return select(1.055 * pow(c, vec3<f32>(1.0 / 2.4)) - 0.055, 12.92 * c, c <= vec3<f32>(0.0031308));
}

@fragment
fn fragment(@builtin(position) at: vec4<f32>) -> @location(0) vec4<f32> {
  let pixel = vec2<i32>(at.xy);
  var mean = textureLoad(light, pixel, 0).rgb / resolve.frames;
  if (resolve.occlusion > 0.0) {
    mean *= mix(1.0, textureLoad(open, pixel, 0).r, resolve.occlusion);
  }
  return vec4<f32>(select(mean, srgb(mean), resolve.encode == 1u), 1.0);
}
