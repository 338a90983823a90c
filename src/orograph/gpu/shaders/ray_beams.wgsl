// Where rays may begin: how far a beam of SIDE × SIDE pixels runs above all ground.
//
// The depth advances in steps that double while the way is free and halve where it is not. Between two depths a beam is
// the hull of its corners there. For each window that rays are cast at there, the maxima of the 2 × 2 nodes that contain the
// hull's rectangle are above all heights under it. So if the hull's lowest corner is above those of all windows, none of
// its rays hits anything, and they continue above the ground's upper side. (The walk itself handles missing
// samples.) Only in perspective.
// include: window_rays.wgsl

const SIDE: u32 = {{SIDE}}u;
const STEPS: i32 = 24;       // maximum
const FINE: f32 = 0.03;      // fraction of its depth below which a step is not halved again
const ROOM: f32 = 1e-3;      // metres, and fraction of the height, by which it must be above

@group(1) @binding(2) var<storage, read_write> starts: array<f32>;   // by rows of beams: depth

// Whether a window contains a rectangle.
fn holds(w: i32, low: vec2<f32>, high: vec2<f32>) -> bool {
  let begin = vec2<f32>(stack.windows[w].first - camera.eye_cell);
  let end = vec2<f32>(stack.windows[w].last - camera.eye_cell);
  return all(low >= begin) && all(high <= end);
}

// Whether a beam (four directions) is above all ground between two depths.
fn free(corners_of: array<vec3<f32>, 4>, o: vec3<f32>, t0: f32, t1: f32) -> bool {
  var beam = corners_of;
  var low = vec3<f32>(NEVER);
  var high = vec2<f32>(-NEVER);
  for (var k = 0; k < 4; k++) {
    let a = o + t0 * beam[k];
    let b = o + t1 * beam[k];
    low = min(low, min(a, b));
    high = max(high, max(a.xy, b.xy));
  }
  let least = low.z - ROOM - 1e-5 * abs(low.z);
  if (least > above(stack.high)) {
    return true;
  }
  let wide = 1e-3 + 1e-6 * max(abs(low.xy), abs(high));
  for (var w = 0; w < stack.count; w++) {
    if (w + 1 < stack.count && holds(w + 1, low.xy - wide, high + wide)) {
      continue;   // rays are cast at the finer window
    }
    let window = stack.windows[w];
    let begin = vec2<f32>(window.first - camera.eye_cell);
    let end = vec2<f32>(window.last - camera.eye_cell);
    let step = exp2(-f32(window.level));
    let first = (max(low.xy - wide, begin) - begin) * step;
    let last = (min(high + wide, end) - begin) * step;
    if (any(first > last)) {
      continue;
    }
    let cells = max(last - first, vec2<f32>(1.0));
    let level = clamp(i32(ceil(log2(max(cells.x, cells.y)))), 1, window.top);
    let shift = vec2<u32>(u32(level));
    let a = clamp(vec2<i32>(floor(first)), vec2<i32>(0), window.cells - 1) >> shift;
    let b = clamp(vec2<i32>(floor(last)), vec2<i32>(0), window.cells - 1) >> shift;
    let there = stack.nodes[window.node + level];
    for (var y = a.y; y <= b.y; y++) {
      for (var x = a.x; x <= b.x; x++) {
        if (least <= above(pool[there.x + y * there.y + x])) {
          return false;
        }
      }
    }
  }
  return true;
}

@compute @workgroup_size(8, 8)
fn main(@builtin(global_invocation_id) at: vec3<u32>) {
  let beams = (vec2<u32>(camera.size) + SIDE - 1u) / SIDE;
  if (any(at.xy >= beams)) {
    return;
  }
  var t = camera.near;
  if (camera.plan == 0u) {
    var beam: array<vec3<f32>, 4>;
    let corner = vec2<f32>(at.xy * SIDE);
    for (var k = 0u; k < 4u; k++) {
      beam[k] = way_of(corner + f32(SIDE) * vec2<f32>(f32(k & 1u), f32(k >> 1u))).v;
    }
    let o = way_of(corner).o;
    var step = 32.0 * length(camera.linear.xy);
    for (var k = 0; k < STEPS; k++) {
      if (free(beam, o, t, t + step)) {
        t += step;
        step *= 2.0;
      } else {
        step *= 0.5;
        if (step < FINE * t) {
          break;
        }
      }
    }
  }
  starts[at.y * beams.x + at.x] = t;
}
