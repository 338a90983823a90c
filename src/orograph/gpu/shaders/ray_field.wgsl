// Whether anything blocks a ray: a walk over nested windows of heights with pyramids of their maxima (Tevs,
// Ihrke & Seidel 2008, §3), the twin of raycast/traverse.py for rays that only need a yes or no. Where a ray stays above
// a node's maximum it is free; at the cells its passage is compared with both triangles, exactly. The walk is in
// integers, so no cell is left out; places are counted from a window's first sample, so that float32 keeps its precision.
//
// orograph.rendering.gpu.shade.ray_field makes the tables; including shaders have them in group {{RAY_GROUP}}. Directions are unit vectors
// (east, north, up) of stretched space, lengths stretched metres, heights true ones.
// include: place.wgsl

struct RayFrame {
  inverse: vec4<f32>,        // columns per metre east, north; rows per metre east, north
  last: vec2<i32>,           // the raster's last column and row
  exaggeration: f32,
  top: f32,                  // metres: no sample is higher
  count: u32,                // windows; 0: nothing stands anywhere
  first: u32, rays: u32,     // of a lattice of `total` rays to a light, those traced now; and the factor by which each
  total: u32,                //   ray's number is multiplied, so that a part of a lattice is spread over it
  corner: vec2<f32>,         // position in the whole picture of the target's upper left corner, and of its sample
  stride: u32,
  spacing: f32,              // metres between samples
  windows: array<vec4<i32>, 48>,  // three each: first column and row, cells across and down; offset, samples per row,
                                  // level, first of its nodes; coarsest level of nodes, last column and row (as floats)
  nodes: array<vec4<i32>, 256>,   // offset, nodes per row
};

@group({{RAY_GROUP}}) @binding(0) var<uniform> ray: RayFrame;
@group({{RAY_GROUP}}) @binding(1) var<storage, read> ray_pool: array<f32>;

const GONE: f32 = -1e29;   // below it: a missing sample
const STILL: f32 = 1e-15;  // samples per metre below which a ray does not move

fn in_window(w: u32, at: Place) -> vec2<f32> {
  return (vec2<f32>(at.whole - ray.windows[3u * w].xy) + at.part) * exp2(-f32(ray.windows[3u * w + 1u].z));
}

fn window_end(w: u32) -> vec2<f32> {
  return bitcast<vec2<f32>>(ray.windows[3u * w + 2u].yz);
}

// The part of [t0, t1] on which o + t·v lies over a window; empty where x > y.
fn window_span(w: u32, at: Place, v: vec2<f32>, t0: f32, t1: f32) -> vec2<f32> {
  let o = in_window(w, at);
  let last = window_end(w);
  let inverse = 1.0 / v;
  let a = -o * inverse;
  let b = (last - o) * inverse;
  let still = abs(v) < vec2<f32>(STILL);
  let holds = o >= vec2<f32>(0.0) & o <= last;
  let low = select(min(a, b), select(vec2<f32>(1e30), vec2<f32>(-1e30), holds), still);
  let high = select(max(a, b), vec2<f32>(1e30), still);
  return vec2<f32>(max(t0, max(low.x, low.y)), min(t1, min(high.x, high.y)));
}

// Height of one of a cell's two triangles at a place in it, whose diagonal runs from z.x at (0, 0) to z.w at (1, 1).
fn on_cell(z: vec4<f32>, p: vec2<f32>) -> f32 {
  return z.x + min(p.x, p.y) * (z.w - z.x) + max(p.x - p.y, 0.0) * (z.y - z.x) + max(p.y - p.x, 0.0) * (z.z - z.x);
}

fn above_cell(z: vec4<f32>, p: vec3<f32>) -> f32 {
  let known = min(min(z.x, z.w), select(z.z, z.y, p.x >= p.y)) > GONE;
  return select(1.0, p.z - on_cell(z, p.xy), known);
}

// The corners a, b, c, d of the cell whose first sample is i, mirrored if its diagonal does not run from the first to
// the last of them (odd cells): then the place in it is mirrored, too.
fn corners(i: i32, stride: i32, even: bool) -> vec4<f32> {
  let z = vec4<f32>(ray_pool[i], ray_pool[i + 1], ray_pool[i + stride], ray_pool[i + stride + 1]);
  return select(z.yxwz, z, even);
}

fn mirrored(x: f32, even: bool) -> f32 {
  return select(1.0 - x, x, even);
}

// Whether a passage p → q through a cell goes below one of its triangles; i: its first sample.
fn cell_blocks(i: i32, stride: i32, even: bool, p0: vec3<f32>, q0: vec3<f32>) -> bool {
  let z = corners(i, stride, even);
  if (min(p0.z, q0.z) > max(max(z.x, z.y), max(z.z, z.w))) {
    return false;
  }
  let p = vec3<f32>(mirrored(p0.x, even), p0.yz);
  let q = vec3<f32>(mirrored(q0.x, even), q0.yz);
  let begin = p.x - p.y;
  let end = q.x - q.y;
  var least = min(above_cell(z, p), above_cell(z, q));
  if (begin * end < 0.0 && min(z.x, z.w) > GONE) {
    let m = mix(p, q, begin / (begin - end));
    least = min(least, m.z - mix(z.x, z.w, m.x));
  }
  return least < 0.0;
}

struct Foot { height: f32, scale: f32 };

// The surface at a place in the finest window that contains it: metres, and the spacing of its samples on the raster.
fn foot_of(at: Place) -> Foot {
  var w = 0u;
  for (var k = 1u; k < ray.count; k++) {
    let o = in_window(k, at);
    if (all(o >= vec2<f32>(0.0)) && all(o <= window_end(k))) {
      w = k;
    }
  }
  let cells = ray.windows[3u * w].zw;
  let data = ray.windows[3u * w + 1u];
  let o = clamp(in_window(w, at), vec2<f32>(0.0), window_end(w));
  let cell = min(vec2<i32>(o), cells - 1);
  let even = ((cell.x + cell.y) & 1) == 0;
  let p = o - vec2<f32>(cell);
  let z = corners(data.x + cell.y * data.y + cell.x, data.y, even);
  return Foot(on_cell(z, vec2<f32>(mirrored(p.x, even), p.y)), exp2(f32(data.z)));
}

// Whether anything blocks the way from a place on the raster at a height, between `skip` and `far`.
fn blocked(at: Place, height: f32, way: vec3<f32>, skip: f32, far: f32) -> bool {
  if (ray.count == 0u) {
    return false;
  }
  let rise = way.z / ray.exaggeration;
  var run = vec2<f32>(dot(ray.inverse.xy, way.xy), dot(ray.inverse.zw, way.xy));
  run = select(run, vec2<f32>(1e-20), abs(run) < vec2<f32>(STILL));
  var t = skip;
  var w = -1;
  for (var k = 0u; k < ray.count; k++) {
    let p = in_window(k, at) + t * run * exp2(-f32(ray.windows[3u * k + 1u].z));
    if (all(p >= vec2<f32>(0.0)) && all(p <= window_end(k))) {
      w = i32(k);
    }
  }
  let right = vec2<i32>(run > vec2<f32>(0.0));
  let turn = 2 * right - 1;
  let still = abs(run) < vec2<f32>(STILL);
  while (w >= 0) {
    let cells = ray.windows[3 * w].zw;
    let data = ray.windows[3 * w + 1];
    let top = ray.windows[3 * w + 2].x;
    let o = in_window(u32(w), at);
    let v = run * exp2(-f32(data.z));
    let inverse = 1.0 / v;
    // To the window's end, or to the finer one inside it.
    var t1 = window_span(u32(w), at, v, t, far).y;
    var next = w - 1;
    if (u32(w) + 1u < ray.count) {
      let inner = window_span(u32(w) + 1u, at, run * exp2(-f32(ray.windows[3 * w + 4].z)), t, t1);
      if (inner.x < inner.y && inner.x > t) {
        t1 = inner.x;
        next = w + 1;
      }
    }
    var cell = clamp(vec2<i32>(floor(o + t * v)), vec2<i32>(0), cells - 1);
    var level = min(2, top);
    loop {
      let node = cell >> vec2<u32>(u32(level));
      let edge = vec2<f32>((node + right) << vec2<u32>(u32(level)));
      let border = select((edge - o) * inverse, vec2<f32>(1e30), still);
      let end = max(min(min(border.x, border.y), t1), t);
      let za = height + t * rise;
      let zb = height + end * rise;
      if (level > 0) {
        let nodes = ray.nodes[data.w + level];
        if (min(za, zb) <= ray_pool[nodes.x + node.y * nodes.y + node.x]) {
          level--;
          continue;
        }
      } else {
        let from_cell = o - vec2<f32>(cell);
        let p = vec3<f32>(from_cell + t * v, za);
        let q = vec3<f32>(from_cell + end * v, zb);
        if (cell_blocks(data.x + cell.y * data.y + cell.x, data.y, ((cell.x + cell.y) & 1) == 0, p, q)) {
          return true;
        }
      }
      if (end >= t1) {
        break;
      }
      if (rise >= 0.0 && zb > ray.top) {
        return false;
      }
      t = end;
      let low = node << vec2<u32>(u32(level));
      let high = min(low + (1 << u32(level)), cells) - 1;
      let along = clamp(vec2<i32>(floor(o + t * v)), low, high);
      let beyond = select(low - 1, low + (1 << u32(level)), turn > vec2<i32>(0));
      let across = border.x <= border.y;
      cell = select(vec2<i32>(along.x, beyond.y), vec2<i32>(beyond.x, along.y), across);
      if (any(cell < vec2<i32>(0)) || any(cell >= cells)) {
        break;
      }
      let climbs = (node & vec2<i32>(1)) == right;
      if (select(climbs.y, climbs.x, across) && level < top) {
        level++;
      }
    }
    if (t1 >= far) {
      return false;
    }
    t = max(t, t1);
    w = next;
  }
  return false;
}
