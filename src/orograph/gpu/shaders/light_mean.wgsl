// Blend computed light with that of earlier frames.

@group(0) @binding(0) var computed: texture_2d<f32>;   // alpha 0: the pixel stays unchanged

@vertex
fn vertex(@builtin(vertex_index) k: u32) -> @builtin(position) vec4<f32> {
  return vec4<f32>(f32(k & 1u) * 4.0 - 1.0, f32(k >> 1u) * 4.0 - 1.0, 0.0, 1.0);
}

@fragment
fn fragment(@builtin(position) at: vec4<f32>) -> @location(0) vec4<f32> {
  let light = textureLoad(computed, vec2<i32>(at.xy), 0);
  if (light.a == 0.0) {
    discard;
  }
  return light;
}
