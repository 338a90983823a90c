// Patches over missing ground: marked, so that the shading hatches them.
// include: camera.wgsl

@vertex
fn vertex(@location(0) at: vec2<i32>, @location(1) height: f32) -> @builtin(position) vec4<f32> {
  var out = to_clip(vec3<f32>(from_eye(vec2<f32>(at.yx - camera.eye_cell)), above_eye(height)));
  out.z *= select(0.999, 0.001, camera.plan == 1u);   // reversed depth: a little farther away; in a plan under all ground
  return out;
}

// Bit 0: something is there; bit 1: it is not ground.
@fragment
fn fragment() -> @location(0) u32 {
  return 3u;
}
