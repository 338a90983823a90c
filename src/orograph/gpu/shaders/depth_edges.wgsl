// Where ground breaks off, or turns away and back, between a pixel and the next one to the right (r, b) and below (g, a): the weight of a line
// there, and the logarithm (base 2) of the nearer side's depth. Like rendering/lines/silhouette_kernels.py.
// include: camera.wgsl

@group(0) @binding(1) var depths: texture_depth_2d;
@group(0) @binding(2) var<uniform> range: vec4<f32>;   // the nearest and the farthest depth in view, metres; step; weight of creases
@group(0) @binding(3) var away: texture_2d<f32>;       // samples to the end of the terrain, every ``step`` samples
@group(0) @binding(4) var facing: texture_2d<f32>;     // n · v, 9 where there is no ground

@vertex
fn vertex(@builtin(vertex_index) k: u32) -> @builtin(position) vec4<f32> {
  return vec4<f32>(f32(k & 1u) * 4.0 - 1.0, f32(k >> 1u) * 4.0 - 1.0, 0.0, 1.0);
}

// The inverse of a pixel's depth, in units of the near plane's; 0: nothing there, or outside the picture.
fn inverse(at: vec2<i32>) -> f32 {
  if (any(at < vec2<i32>(0)) || any(at >= vec2<i32>(textureDimensions(depths)))) {
    return 0.0;
  }
  return textureLoad(depths, at, 0);
}

// Whether the terrain ends near a pixel's ground, which may extend as far as that of the previous pixel (inverse depth).
fn ends(at: vec2<i32>, w: f32, before: f32) -> bool {
  let ray = ray_of(vec2<f32>(at) + 0.5);
  let depth = depth_of(w);
  let position = ray.origin + ray.direction * depth;
  let cells = vec2<f32>(dot(camera.inverse.xy, position.xy), dot(camera.inverse.zw, position.xy)) + camera.eye_frac;
  let place = cells + vec2<f32>(camera.eye_cell);
  let spacing = sqrt(abs(camera.linear.x * camera.linear.w - camera.linear.y * camera.linear.z));
  let reach = select(0.0, 2.0 * abs(depth - depth_of(before)) / spacing, before > 0.0);
  let margin = 2.0 + 3.0 * camera.pixel * depth / spacing + reach;
  let near = clamp(vec2<i32>(place / range.z + 0.5), vec2<i32>(0), vec2<i32>(textureDimensions(away)) - 1);
  let inner = textureLoad(away, near, 0).r - 1.75 * (range.z - 1.0);
  let border = min(min(place.x, place.y), min(f32(camera.last.x) - place.x, f32(camera.last.y) - place.y));
  return min(border, inner) < margin;
}

// Weight of the break between two pixels by what it hides; 1 beside nothing.
fn hides(at: vec2<i32>, step: vec2<i32>) -> f32 {
  let w0 = inverse(at - step);
  let w1 = inverse(at);
  let w2 = inverse(at + step);
  let w3 = inverse(at + 2 * step);
  var a = select(-1.0, abs(w1 - w0), w0 > 0.0);
  var b = select(-1.0, abs(w3 - w2), w3 > 0.0);
  a = select(a, max(b, 0.0), a < 0.0);
  b = select(b, a, b < 0.0);
  let weight = smoothstep(0.012, 0.06, (abs(w2 - w1) - 2.0 * min(a, b) - 0.5 * max(a, b)) / max(w1, w2));
  return select(1.0, weight, min(w1, w2) > 0.0);
}

fn facing_at(at: vec2<i32>) -> f32 {
  if (any(at < vec2<i32>(0)) || any(at >= vec2<i32>(textureDimensions(facing)))) {
    return 9.0;
  }
  return textureLoad(facing, at, 0).r;
}

// How much n · v rises on both sides of a pixel before it falls below the pixel's; the smaller of the two.
fn prominence(at: vec2<i32>, step: vec2<i32>, low: f32) -> f32 {
  var least = 2.0;
  for (var side = -1; side <= 1; side += 2) {
    var top = low;
    for (var k = 1; k <= 6; k++) {
      let here = facing_at(at + side * k * step);
      if (here < low || here > 8.0) {
        break;
      }
      top = max(top, here);
    }
    least = min(least, top - low);
  }
  return least;
}

// Weight of a crease on the border between a pixel and the next, and its inverse depth: the crease is a valley of n · v;
// one of the pixels is its floor, the other the floor's lower neighbour.
fn creased(at: vec2<i32>, step: vec2<i32>) -> vec2<f32> {
  let g0 = facing_at(at - step);
  let g1 = facing_at(at);
  let g2 = facing_at(at + step);
  let g3 = facing_at(at + 2 * step);
  let one = g1 < 0.34 && g2 >= g1 && g0 >= g1 && g2 <= g0 && g0 < 8.0 && g2 < 8.0;
  let two = g2 < 0.34 && g1 >= g2 && g3 >= g2 && g3 > g1 && g1 < 8.0 && g3 < 8.0;
  var found = vec2<f32>(0.0);
  for (var rounds = select(0, 1, one || two); rounds > 0; rounds--) {
    let floor = select(at + step, at, one);
    let low = select(g2, g1, one);
    let deep = smoothstep(0.10, 0.24, prominence(floor, step, low));
    var beside = 0.0;
    for (var n = -3; n < 3; n++) {
      let there = floor + n * step;
      if (all(there >= vec2<i32>(0)) && all(there + step < vec2<i32>(textureDimensions(depths)))) {
        beside = max(beside, hides(there, step));
      }
    }
    found = vec2<f32>(range.w * deep * (1.0 - beside) * (1.0 - smoothstep(0.12, 0.34, low)), inverse(floor));
  }
  return found;
}

// Software renderers execute the bodies of conditions whether they are taken or not, but not loops that no
// pixel enters: so work for few pixels is in a loop of one iteration.
fn broken(at: vec2<i32>, step: vec2<i32>) -> vec2<f32> {
  let w1 = inverse(at);
  let w2 = inverse(at + step);
  if (max(w1, w2) <= 0.0 || any(at + step >= vec2<i32>(textureDimensions(depths)))) {
    return vec2<f32>(0.0);
  }
  var weight = 1.0;
  if (min(w1, w2) > 0.0) {
    weight = hides(at, step);
  }
  for (var rounds = select(0, 1, min(w1, w2) <= 0.0); rounds > 0; rounds--) {
    if (ends(select(at + step, at, w1 > 0.0), max(w1, w2), inverse(select(at + 2 * step, at - step, w1 > 0.0)))) {
      weight = 0.0;
    }
  }
  var w = max(w1, w2);
  let crease = creased(at, step);
  if (crease.x > weight) {
    weight = crease.x;
    w = crease.y;
  }
  let z = depth_of(w);
  let far = clamp(log(z / range.x) / log(range.y / range.x), 0.0, 1.0);
  return vec2<f32>(weight * (1.0 - 0.65 * far), log2(z));
}

@fragment
fn fragment(@builtin(position) at: vec4<f32>) -> @location(0) vec4<f32> {
  let pixel = vec2<i32>(at.xy);
  let right = broken(pixel, vec2<i32>(1, 0));
  let below = broken(pixel, vec2<i32>(0, 1));
  return vec4<f32>(right.x, below.x, right.y, below.y);
}
