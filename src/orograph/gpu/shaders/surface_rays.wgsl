// The ground by rays: for every pixel, or those of some blocks of the screen, the first hit with nested windows.
// include: window_rays.wgsl
// include: drawn.wgsl

const BEAM: u32 = {{BEAM}}u;

@group(1) @binding(2) var<storage, read> starts: array<f32>;   // ray_beams.wgsl
@group(1) @binding(3) var<storage, read> breaks: array<u32>;   // ray_breaks.wgsl

const BREAKS: u32 = {{BREAKS}}u;   // 1: rays are cast at breaks only
const LEFT_OUT: u32 = 8u;            // a mark: no ray was cast here

@vertex
fn vertex(@builtin(vertex_index) k: u32) -> @builtin(position) vec4<f32> {
  return vec4<f32>(f32(k & 1u) * 4.0 - 1.0, f32(k >> 1u) * 4.0 - 1.0, 0.0, 1.0);
}

// A block of the screen, SIDE pixels a side, as two triangles nearer than everything else.
const SIDE: f32 = {{SIDE}}.0;

@vertex
fn block(@builtin(vertex_index) k: u32, @location(0) at: vec2<u32>) -> @builtin(position) vec4<f32> {
  let corner = vec2<u32>(select(0u, 1u, k == 1u || k == 2u || k == 4u), select(0u, 1u, k == 2u || k == 4u || k == 5u));
  let pixel = min(vec2<f32>(at + corner) * SIDE, camera.size);
  let clip = 2.0 * pixel / camera.size - 1.0;
  return vec4<f32>(clip.x, -clip.y, 1.0, 1.0);
}

struct Pixel { @builtin(frag_depth) depth: f32, @location(0) marks: u32 };
struct Sloped { @builtin(frag_depth) depth: f32, @location(0) marks: u32, @location(1) slope: vec2<f32> };

fn hit_of(pixel: vec2<f32>, way: Way) -> Found {
  let beam = vec2<u32>(pixel) / BEAM;
  let start = starts[beam.y * ((u32(camera.size.x) + BEAM - 1u) / BEAM) + beam.x];
  return first_hit(way, start, select(NEVER, camera.far, camera.plan == 1u), start > camera.near);
}

// The value of to_clip; 0 if there is no hit.
fn stored_depth(t: f32) -> f32 {
  if (t >= NEVER) {
    return 0.0;
  }
  if (camera.plan == 1u) {
    return (camera.far - t) / (camera.far - camera.near);
  }
  return camera.near / t;
}

// Bit 0 ground, bit 2 by a ray, bits 8–15 the level of the window; 0 if there is no hit.
fn marked(hit: Found) -> u32 {
  return select((stack.windows[hit.window].level << 8u) | 5u, 0u, hit.t >= NEVER);
}

fn left_out(pixel: vec2<f32>) -> bool {
  return BREAKS == 1u && breaks[u32(pixel.y) * u32(camera.size.x) + u32(pixel.x)] == 0u;
}

// unless: COMPUTED
@fragment
fn fragment(@builtin(position) at: vec4<f32>) -> Pixel {
  if (left_out(at.xy)) {
    return Pixel(1.0, LEFT_OUT);   // nothing is drawn in front of it
  }
  let hit = hit_of(at.xy, way_of(at.xy));
  return Pixel(stored_depth(hit.t), marked(hit));
}

@fragment
fn with_slope(@builtin(position) at: vec4<f32>) -> Sloped {
  if (left_out(at.xy)) {
    return Sloped(1.0, LEFT_OUT, vec2<f32>(0.0));
  }
  let way = way_of(at.xy);
  let hit = hit_of(at.xy, way);
  if (hit.t >= NEVER) {
    return Sloped(0.0, 0u, vec2<f32>(0.0));
  }
  return Sloped(stored_depth(hit.t), marked(hit), slope_at(way, hit));
}
// end: COMPUTED

// when: COMPUTED
// A compute shader casts the rays, and fragments copy its hits.
@group(1) @binding(4) var<storage, read_write> hits: array<vec4<u32>>;   // by rows of pixels: depth, marks, slope
@group(1) @binding(5) var<storage, read> blocks: array<vec2<u32>>;       // column and row of each

fn number_of(pixel: vec2<u32>) -> u32 {
  return pixel.y * u32(camera.size.x) + pixel.x;
}

fn cast_pixel(pixel: vec2<u32>) {
  if (any(pixel >= vec2<u32>(camera.size))) {
    return;
  }
  let at = vec2<f32>(pixel) + 0.5;
  if (left_out(at)) {
    hits[number_of(pixel)] = vec4<u32>(bitcast<u32>(1.0), LEFT_OUT, 0u, 0u);
    return;
  }
  let way = way_of(at);
  let hit = hit_of(at, way);
  var slope = vec2<f32>(0.0);
  // when: SLOPED
  if (hit.t < NEVER) {
    slope = slope_at(way, hit);
  }
  // end: SLOPED
  hits[number_of(pixel)] = vec4<u32>(bitcast<u32>(stored_depth(hit.t)), marked(hit), bitcast<vec2<u32>>(slope));
}

@compute @workgroup_size(8, 8)
fn cast_all(@builtin(global_invocation_id) k: vec3<u32>) {
  cast_pixel(k.xy);
}

@compute @workgroup_size(8, 8)
fn cast_blocks(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_id) k: vec3<u32>) {
  cast_pixel(blocks[group.x] * u32(SIDE) + group.yz * 8u + k.xy);
}

@fragment
fn fragment(@builtin(position) at: vec4<f32>) -> Pixel {
  let hit = hits[number_of(vec2<u32>(at.xy))];
  return Pixel(bitcast<f32>(hit.x), hit.y);
}

@fragment
fn with_slope(@builtin(position) at: vec4<f32>) -> Sloped {
  let hit = hits[number_of(vec2<u32>(at.xy))];
  return Sloped(bitcast<f32>(hit.x), hit.y, bitcast<vec2<f32>>(hit.zw));
}
// end: COMPUTED

// Only the depth of the block, which keeps out everything behind it.
@fragment
fn kept_free() -> @location(0) u32 {
  return 0u;
}

@fragment
fn kept_free_with_slope() -> WithSlope {
  return WithSlope(0u, vec2<f32>(0.0));
}
