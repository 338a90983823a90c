// The heaviest break in each square of 8 × 8 pixels: pixels without one nearby need not search.

@group(0) @binding(0) var breaks: texture_2d<f32>;

@vertex
fn vertex(@builtin(vertex_index) k: u32) -> @builtin(position) vec4<f32> {
  return vec4<f32>(f32(k & 1u) * 4.0 - 1.0, f32(k >> 1u) * 4.0 - 1.0, 0.0, 1.0);
}

@fragment
fn fragment(@builtin(position) at: vec4<f32>) -> @location(0) vec4<f32> {
  let size = vec2<i32>(textureDimensions(breaks));
  let first = vec2<i32>(at.xy) * 8;
  var most = 0.0;
  for (var r = 0; r < 8; r++) {
    for (var c = 0; c < 8; c++) {
      let here = textureLoad(breaks, min(first + vec2<i32>(c, r), size - 1), 0);
      most = max(most, max(here.r, here.g));
    }
  }
  return vec4<f32>(most, 0.0, 0.0, 0.0);
}
