// Rays at nested windows of heights: the first hit (Tevs, Ihrke & Seidel 2008, §3; Dick,
// Krüger & Westermann 2009), the twin of raycast/kernels.py and raycast/traverse.py. A ray is cut by the windows' borders
// into stretches, each on the finest window that contains it, and walks over pyramids of maxima and minima in integers, so
// no cell is left out; cells are their two triangles, exactly. It keeps track of its side of the surface: a
// change of side is a hit, so nothing leaks through an edge, or the step between two windows.
//
// All float32 values are relative to the eye: borders of cells are whole samples from the eye's cell, heights metres
// from the eye's. So a place is as exact as it is near, however large the raster; t is depth in metres.
// include: camera.wgsl

struct Window {
  first: vec2<i32>, last: vec2<i32>,   // (column, row) of the raster where it begins and ends
  cells: vec2<i32>,                    // across and down
  offset: i32, stride: i32,            // of its heights
  level: u32,                          // its samples are 2^level samples of the raster apart
  node: i32, top: i32,                 // offset of its levels of nodes, and the coarsest
  allowed: f32,                        // pixels by which a surface other than the exact one may be off
};

struct Stack {
  low: f32, high: f32,                 // metres between which all heights lie
  count: i32, whole: i32,              // whole: no sample is missing
  windows: array<Window, 16>,          // outermost first
  nodes: array<vec4<i32>, 256>,        // offset of maxima, nodes per row, offset of minima (-1: none)
};

@group(1) @binding(0) var<uniform> stack: Stack;
@group(1) @binding(1) var<storage, read> pool: array<f32>;
// when: COUNTED
var<private> steps: u32 = 0u;   // nodes and cells that a ray has examined
// end: COUNTED

const GONE: f32 = -1e29;     // below it: a missing sample
const STILL: f32 = 1e-15;    // samples per metre below which a ray does not move
const NEVER: f32 = 1e30;
const BEGIN: i32 = 4;        // level of nodes on which rays begin

// o + t·v: columns and rows from the eye's cell, metres above the eye. reach: the most pixels by which a metre of height
// moves a point at unit depth (v the vertical and P the point, |v × P| ≤ |P|).
struct Way { o: vec3<f32>, v: vec3<f32>, inverse: vec2<f32>, still: vec2<bool>, right: vec2<i32>, reach: f32 };

// t of a hit (NEVER: none), the window and the cell hit, and the side of the surface at the end: 1 above, -1 below, 0 unknown.
struct Found { t: f32, side: i32, window: i32, cell: vec2<i32> };

// Metres above the eye; a missing height stays far below.
fn above(height: f32) -> f32 {
  return (height - camera.eye_height.x) - camera.eye_height.y;
}

fn way_of(pixel: vec2<f32>) -> Way {
  let ray = ray_of(pixel);
  let stretch = camera.forward.w;
  let o = vec2<f32>(dot(camera.inverse.xy, ray.origin.xy), dot(camera.inverse.zw, ray.origin.xy)) + camera.eye_frac;
  let v = vec2<f32>(dot(camera.inverse.xy, ray.direction.xy), dot(camera.inverse.zw, ray.direction.xy));
  let still = abs(v) < vec2<f32>(STILL);
  let moving = select(v, vec2<f32>(1.0), still);
  let reach = length(ray.direction) * stretch / camera.pixel;
  return Way(vec3<f32>(o, ray.origin.z / stretch), vec3<f32>(select(v, vec2<f32>(0.0), still), ray.direction.z / stretch),
    1.0 / moving, still, vec2<i32>(moving > vec2<f32>(0.0)), reach);
}

// The part of [span.x, span.y] on which a ray is over a window; empty where x > y.
fn over(w: i32, way: Way, span: vec2<f32>) -> vec2<f32> {
  let begin = vec2<f32>(stack.windows[w].first - camera.eye_cell);
  let end = vec2<f32>(stack.windows[w].last - camera.eye_cell);
  let a = (begin - way.o.xy) * way.inverse;
  let b = (end - way.o.xy) * way.inverse;
  let holds = way.o.xy >= begin & way.o.xy <= end;
  let low = select(min(a, b), select(vec2<f32>(NEVER), vec2<f32>(-NEVER), holds), way.still);
  let high = select(max(a, b), vec2<f32>(NEVER), way.still);
  return vec2<f32>(max(span.x, max(low.x, low.y)), min(span.y, min(high.x, high.y)));
}

struct Cut { s: f32, side: i32 };   // the fraction of a passage at its hit, or -1; the side after it

// Height of a place over one of a cell's two triangles (upper: that of z.y); the diagonal runs from z.x to z.w.
fn over_plane(z: vec4<f32>, p: vec3<f32>, upper: bool) -> f32 {
  let w = p.x - p.y;
  return select(p.z - z.x - p.x * (z.w - z.x) + w * (z.z - z.x), p.z - z.x - p.y * (z.w - z.x) - w * (z.y - z.x), upper);
}

// A passage p → q (positions in the cell, metres above the eye) through the cell whose corners' heights are z.
fn cell_hit(z: vec4<f32>, p: vec3<f32>, q: vec3<f32>, before: i32) -> Cut {
  var side = before;
  let w0 = p.x - p.y;
  let w1 = q.x - q.y;
  let both = w0 * w1 < 0.0;   // it crosses the diagonal
  let cut = w0 / select(1.0, w0 - w1, both);
  let first = w0 > 0.0 || (w0 == 0.0 && w1 > 0.0);
  let last = w1 > 0.0 || (w1 == 0.0 && w0 > 0.0);
  let diagonal = min(z.x, z.w);
  for (var part = 0; part < 2; part++) {
    let upper = select(last, first, part == 0);
    if (part == 1 && !both) {
      break;
    }
    if (min(diagonal, select(z.z, z.y, upper)) < GONE) {
      side = 0;
      continue;
    }
    let a = over_plane(z, p, upper);
    let b = over_plane(z, q, upper);
    let middle = mix(a, b, cut);
    let f0 = select(a, middle, part == 1);
    let f1 = select(b, middle, part == 0 && both);
    if (side == 0) {
      side = select(-1, 1, f0 > 0.0 || (f0 == 0.0 && f1 > 0.0));
    }
    if (f1 * f32(side) <= 0.0) {
      let begin = select(0.0, cut, part == 1);
      let crosses = f0 * f32(side) > 0.0 && a != b;
      return Cut(select(begin, a / select(1.0, a - b, crosses), crosses), side);
    }
  }
  return Cut(-1.0, side);
}

// Whether heights that are off by e metres at depth t or beyond are off by no more than allowed pixels. Never in a plan:
// seen from straight above, heights do not matter, but their colours do.
fn within(e: f32, t: f32, way: Way, allowed: f32) -> bool {
  return camera.plan == 0u && way.reach * e <= allowed * (t - e * camera.forward.w);
}

// when: CONSTANT
// A passage through a cell or a node, from za down or up to zb above the eye, over level ground.
fn level_hit(ground: f32, za: f32, zb: f32, before: i32) -> Cut {
  let f0 = za - ground;
  let f1 = zb - ground;
  let side = select(before, select(-1, 1, f0 > 0.0 || (f0 == 0.0 && f1 > 0.0)), before == 0);
  if (min(f0 * f32(side), f1 * f32(side)) > 0.0) {
    return Cut(-1.0, side);
  }
  let crosses = f0 * f32(side) > 0.0;
  return Cut(select(0.0, f0 / select(1.0, f0 - f1, crosses), crosses), side);
}
// end: CONSTANT

// when: BILINEAR
// A passage p → q through a cell whose heights are bilinear: above them by f0 + k·s − bend·s².
fn bilinear_hit(z: vec4<f32>, p: vec3<f32>, q: vec3<f32>, before: i32) -> Cut {
  let twist = z.x - z.y - z.z + z.w;
  let f0 = p.z - (z.x + p.x * (z.y - z.x) + p.y * (z.z - z.x) + p.x * p.y * twist);
  let f1 = q.z - (z.x + q.x * (z.y - z.x) + q.y * (z.z - z.x) + q.x * q.y * twist);
  let bend = twist * (q.x - p.x) * (q.y - p.y);
  let side = select(before, select(-1, 1, f0 > 0.0 || (f0 == 0.0 && f1 > 0.0)), before == 0);
  let c = f0 * f32(side);
  if (c <= 0.0) {
    return Cut(0.0, side);
  }
  let a = -bend * f32(side);
  let b = (f1 - f0 + bend) * f32(side);
  let inner = b * b - 4.0 * a * c;
  if (inner >= 0.0) {
    let sum = -0.5 * (b + select(-1.0, 1.0, b >= 0.0) * sqrt(inner));
    let one = select(NEVER, c / sum, sum != 0.0);
    let other = select(NEVER, sum / a, abs(a) > 1e-12 * abs(sum));
    let first = min(select(NEVER, one, one >= 0.0), select(NEVER, other, other >= 0.0));
    if (first <= 1.0) {
      return Cut(first, side);
    }
  }
  if (f1 * f32(side) <= 0.0) {   // (rounding lost the root)
    return Cut(1.0, side);
  }
  return Cut(-1.0, side);
}
// end: BILINEAR

// Corners of the cell whose first sample is i, metres above the eye, mirrored if the diagonal does not begin there.
fn corners(i: i32, stride: i32, even: bool) -> vec4<f32> {
  let z = vec4<f32>(above(pool[i]), above(pool[i + 1]), above(pool[i + stride]), above(pool[i + stride + 1]));
  return select(z.yxwz, z, even);
}

// The hit of a passage: with the requested surface where it is within what is allowed, else with the exact one.
fn passed(z: vec4<f32>, p: vec3<f32>, q: vec3<f32>, side: i32, t: f32, way: Way, allowed: f32) -> Cut {
  // when: CONSTANT
  let low = min(min(z.x, z.y), min(z.z, z.w));
  let high = max(max(z.x, z.y), max(z.z, z.w));
  if (low > GONE && within(0.5 * (high - low), t, way, allowed)) {
    return level_hit(0.5 * (low + high), p.z, q.z, side);
  }
  // end: CONSTANT
  // when: BILINEAR
  if (min(min(z.x, z.y), min(z.z, z.w)) > GONE && within(0.25 * abs(z.x - z.y - z.z + z.w), t, way, allowed)) {
    return bilinear_hit(z, p, q, side);
  }
  // end: BILINEAR
  return cell_hit(z, p, q, side);
}

// The position in a cell of a window, mirrored like its corners.
fn in_cell(way: Way, t: f32, corner: vec2<f32>, step: f32, even: bool) -> vec3<f32> {
  let p = ((way.o.xy - corner) + t * way.v.xy) * step;
  return vec3<f32>(select(1.0 - p.x, p.x, even), p.y, way.o.z + t * way.v.z);
}

// The first hit with one window on [begin, t1], which lies over it.
fn cast_at(w: i32, way: Way, begin: f32, t1: f32, before: i32) -> Found {
  let window = stack.windows[w];
  let origin = window.first - camera.eye_cell;
  let step = exp2(-f32(window.level));
  var t = begin;
  var side = before;
  var level = min(BEGIN, window.top);
  let q = vec2<i32>(floor(way.o.xy + t * way.v.xy)) - origin;
  var cell = clamp(q >> vec2<u32>(window.level), vec2<i32>(0), window.cells - 1);
  loop {
    // when: COUNTED
    steps++;
    // end: COUNTED
    let shift = vec2<u32>(u32(level));
    let node = cell >> shift;
    let edge = vec2<f32>(origin + (((node + way.right) << shift) << vec2<u32>(window.level)));
    let border = select((edge - way.o.xy) * way.inverse, vec2<f32>(NEVER), way.still);
    let end = max(min(min(border.x, border.y), t1), t);
    let za = way.o.z + t * way.v.z;
    let zb = way.o.z + end * way.v.z;
    if (level > 0) {
      let there = stack.nodes[window.node + level];
      let k = node.y * there.y + node.x;
      let most = pool[there.x + k];
      let empty = most < GONE;
      // Free, unless that would be the other side: then the ray has come through the step between two windows.
      if (min(za, zb) > above(most) && (side >= 0 || empty)) {
        side = select(1, 0, empty);
      } else if (there.z >= 0 && side <= 0 && max(za, zb) < above(pool[max(there.z, 0) + k])) {
        side = -1;
      } else {
        var through = false;
        // when: CONSTANT
        // All heights of the node are near enough to the middle one.
        if (there.z >= 0 && stack.whole == 1) {
          let least = pool[there.z + k];
          if (within(0.5 * (most - least), t, way, window.allowed)) {
            let cut = level_hit(above(0.5 * (most + least)), za, zb, side);
            side = cut.side;
            if (cut.s >= 0.0) {
              let hit = t + cut.s * (end - t);
              let at = (vec2<i32>(floor(way.o.xy + hit * way.v.xy)) - origin) >> vec2<u32>(window.level);
              let first = node << shift;
              return Found(hit, side, w, clamp(at, first, min(first + (1 << u32(level)), window.cells) - 1));
            }
            through = true;
          }
        }
        // end: CONSTANT
        if (!through) {
          level--;
          continue;
        }
      }
    } else {
      let even = ((cell.x + cell.y) & 1) == 0;
      let corner = vec2<f32>(origin + (cell << vec2<u32>(window.level)));
      let z = corners(window.offset + cell.y * window.stride + cell.x, window.stride, even);
      let cut = passed(z, in_cell(way, t, corner, step, even), in_cell(way, end, corner, step, even), side, t, way,
        window.allowed);
      side = cut.side;
      if (cut.s >= 0.0) {
        return Found(t + cut.s * (end - t), side, w, cell);
      }
    }
    if (end >= t1) {
      break;
    }
    t = end;
    let low = node << shift;
    let high = min(low + (1 << u32(level)), window.cells) - 1;
    let here = vec2<i32>(floor(way.o.xy + t * way.v.xy)) - origin;
    let along = clamp(here >> vec2<u32>(window.level), low, high);
    let beyond = select(low - 1, low + (1 << u32(level)), way.right == vec2<i32>(1));
    let across = border.x <= border.y;
    cell = select(vec2<i32>(along.x, beyond.y), vec2<i32>(beyond.x, along.y), across);
    if (any(cell < vec2<i32>(0)) || any(cell >= window.cells)) {
      break;
    }
    let climbs = (node & vec2<i32>(1)) == way.right;
    if (select(climbs.y, climbs.x, across) && level < window.top) {
      level++;
    }
  }
  return Found(NEVER, side, w, cell);
}

// The first hit of a ray on [near, far]; free: it has reached near above all ground.
fn first_hit(way: Way, near: f32, far: f32, free: bool) -> Found {
  var found = Found(NEVER, 0, 0, vec2<i32>(0));
  // The slab of all heights, widened by the rounding of float32.
  let low = above(stack.low);
  let high = above(stack.high);
  var slab = vec2<f32>(near, far);
  if (way.v.z != 0.0) {
    let a = (low - 1e-3 - 1e-5 * abs(low) - way.o.z) / way.v.z;
    let b = (high + 1e-3 + 1e-5 * abs(high) - way.o.z) / way.v.z;
    slab = vec2<f32>(max(near, min(a, b)), min(far, max(a, b)));
  } else if (way.o.z < low || way.o.z > high) {
    return found;
  }
  if (slab.x > near) {   // enters from above all heights, or from below them
    found.side = select(-1, 1, way.v.z < 0.0);
  } else if (free) {
    found.side = 1;
  }
  var inside = slab;
  var inner = 0;
  for (var w = 0; w < stack.count; w++) {
    inside = over(w, way, inside);
    if (inside.x > inside.y) {
      break;
    }
    inner = w + 1;
  }
  var t = slab.x;
  if (inner > 0) {
    t = over(0, way, slab).x;
    if (t > slab.x) {   // enters through a side wall
      found.side = 0;
    }
  }
  for (var stretch = 0; stretch < 2 * inner - 1; stretch++) {
    let w = select(2 * inner - 2 - stretch, stretch, stretch < inner);
    let inwards = stretch + 1 < inner;
    let limit = over(select(w, w + 1, inwards), way, slab);
    let end = select(limit.y, limit.x, inwards);
    if (end <= t && stack.count > 1) {
      continue;
    }
    found = cast_at(w, way, t, end, found.side);
    if (found.t < NEVER) {
      break;
    }
    t = max(t, end);
  }
  return found;
}

// The slope of the triangle that a ray hits, metres per metre east and north.
fn slope_at(way: Way, hit: Found) -> vec2<f32> {
  let window = stack.windows[hit.window];
  let even = ((hit.cell.x + hit.cell.y) & 1) == 0;
  let step = exp2(-f32(window.level));
  let corner = vec2<f32>(window.first - camera.eye_cell + (hit.cell << vec2<u32>(window.level)));
  let p = in_cell(way, hit.t, corner, step, even);
  let z = corners(window.offset + hit.cell.y * window.stride + hit.cell.x, window.stride, even);
  let g = select(vec2<f32>(z.w - z.z, z.z - z.x), vec2<f32>(z.y - z.x, z.w - z.y), p.x >= p.y) * step;
  let across = vec2<f32>(select(-g.x, g.x, even), g.y);
  return vec2<f32>(dot(across, camera.inverse.xz), dot(across, camera.inverse.yw));
}
