// How far the ground in every pixel faces the eye: n · v, with slopes averaged over some pixels; 9 where there is none.
// Like rendering/lines/silhouettes.py.
// include: camera.wgsl

@group(0) @binding(1) var depths: texture_depth_2d;
@group(0) @binding(2) var slopes: texture_2d_array<f32>;
@group(0) @binding(3) var<storage, read> pages: array<u32>;
@group(0) @binding(4) var<uniform> levels: array<Level, LEVELS>;
// include: slopes.wgsl

const SMOOTH: f32 = 2.5;   // pixels

@vertex
fn vertex(@builtin(vertex_index) k: u32) -> @builtin(position) vec4<f32> {
  return vec4<f32>(f32(k & 1u) * 4.0 - 1.0, f32(k >> 1u) * 4.0 - 1.0, 0.0, 1.0);
}

@fragment
fn fragment(@builtin(position) at: vec4<f32>) -> @location(0) f32 {
  let stored = textureLoad(depths, vec2<i32>(at.xy), 0);
  let ray = ray_of(at.xy);
  let depth = depth_of(max(stored, 1e-30));
  let d = normalize(ray.direction);
  let position = ray.origin + ray.direction * depth;
  let cells = vec2<f32>(dot(camera.inverse.xy, position.xy), dot(camera.inverse.zw, position.xy)) + camera.eye_frac;
  let down = floor(cells);
  let spacing = sqrt(abs(camera.linear.x * camera.linear.w - camera.linear.y * camera.linear.z));
  let footprint = camera.pixel * depth * inverseSqrt(clamp(abs(d.z), 0.1, 1.0)) / spacing;
  var facing = 9.0;
  for (var rounds = select(0, 1, stored > 0.0); rounds > 0; rounds--) {
    let s = slope(Place(camera.eye_cell + vec2<i32>(down), cells - down), SMOOTH * footprint);
    let g = vec2<f32>(s.x * camera.inverse.x + s.y * camera.inverse.z, s.x * camera.inverse.y + s.y * camera.inverse.w);
    let steep = g * camera.forward.w;
    facing = (dot(steep, d.xy) - d.z) * inverseSqrt(1.0 + dot(steep, steep));
  }
  return facing;
}
