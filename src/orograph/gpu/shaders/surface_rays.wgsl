// The ground by rays: of every pixel, or of those of some blocks of the screen, the first hit with nested windows.
// include: window_rays.wgsl
// include: drawn.wgsl

@vertex
fn vertex(@builtin(vertex_index) k: u32) -> @builtin(position) vec4<f32> {
  return vec4<f32>(f32(k & 1u) * 4.0 - 1.0, f32(k >> 1u) * 4.0 - 1.0, 0.0, 1.0);
}

// A block of the screen, SIDE pixels a side, as two triangles nearer than all else.
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

fn hit_of(way: Way) -> Found {
  return first_hit(way, camera.near, select(NEVER, camera.far, camera.plan == 1u));
}

// As to_clip has it; 0 where there is no hit.
fn stored_depth(t: f32) -> f32 {
  if (t >= NEVER) {
    return 0.0;
  }
  if (camera.plan == 1u) {
    return (camera.far - t) / (camera.far - camera.near);
  }
  return camera.near / t;
}

// Bit 0 ground, bit 2 by a ray, bits 8–15 the level of the window; 0 where there is no hit.
fn marked(hit: Found) -> u32 {
  return select((stack.windows[hit.window].level << 8u) | 5u, 0u, hit.t >= NEVER);
}

@fragment
fn fragment(@builtin(position) at: vec4<f32>) -> Pixel {
  let hit = hit_of(way_of(at.xy));
  return Pixel(stored_depth(hit.t), marked(hit));
}

@fragment
fn with_slope(@builtin(position) at: vec4<f32>) -> Sloped {
  let way = way_of(at.xy);
  let hit = hit_of(way);
  if (hit.t >= NEVER) {
    return Sloped(0.0, 0u, vec2<f32>(0.0));
  }
  return Sloped(stored_depth(hit.t), marked(hit), slope_at(way, hit));
}

// Nothing but the depth of the block, which keeps out all that lies behind it.
@fragment
fn kept_free() -> @location(0) u32 {
  return 0u;
}

@fragment
fn kept_free_with_slope() -> WithSlope {
  return WithSlope(0u, vec2<f32>(0.0));
}
