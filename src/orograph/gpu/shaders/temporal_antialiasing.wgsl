// A frame and earlier ones, each with samples elsewhere in its pixels: the place in the last frame of the ground in a pixel
// is known, so the mean gathered there continues (see rendering/gpu/temporal/antialiasing.py).
// include: camera.wgsl

struct Temporal {
  right: vec4<f32>,      // the last frame's axes and focal lengths, as the camera has them
  up: vec4<f32>,
  forward: vec4<f32>,    // w: 1 if there is a last frame, 2 if what it showed has changed since
  moved: vec4<f32>,      // the eye's movement since, stretched metres; w: the least weight of this frame in the mean
  centre: vec2<f32>,     // clip offset of the last frame's optical axis, with samples in the middle of pixels
  shift: vec2<f32>,      // the position in its pixel of this frame's sample, pixels from the middle
  fresh: vec4<u32>,      // x: the number of areas of the ground that look different from the last frame
  areas: array<vec4<f32>, 64>,   // columns and rows from the eye: west, north, east, south
};

@group(1) @binding(0) var<uniform> temporal: Temporal;
@group(1) @binding(1) var light: texture_2d<f32>;
@group(1) @binding(2) var depth: texture_depth_2d;
@group(1) @binding(3) var before: texture_2d<f32>;
@group(1) @binding(4) var smooth_: sampler;
@group(1) @binding(5) var far_before: texture_2d<f32>;   // metres of depth in the last frame

const SKY: f32 = 1e30;
const FULL: f32 = 65504.0;  // the largest number of a half float
const SAME: f32 = 0.02;   // relative difference below which two depths may be those of one surface
const SCALE: f32 = 2.0;   // how much of a mean is discarded for a change of scale, times that change

const ANEW: f32 = 3.0;    // most frames that a mean counts as where new tiles arrived, so that it forgets the old ones

const FAST: f32 = 0.0625; // a frame's least weight in the mean of what moves by a pixel or more: each look-up blurs it

// The mean, and the depth that the next frame searches for (that of its own sample).
struct Mean { @location(0) light: vec4<f32>, @location(1) far: f32 };

@vertex
fn vertex(@builtin(vertex_index) k: u32) -> @builtin(position) vec4<f32> {
  return vec4<f32>(f32(k & 1u) * 4.0 - 1.0, f32(k >> 1u) * 4.0 - 1.0, 0.0, 1.0);
}

// (Alpha counts the frames in a pixel's mean.)
// The mean so far at a position in pixels, by Catmull and Rom's cubic in five bilinear look-ups: repeated linear ones
// would blur what stands still.
fn gathered(at: vec2<f32>) -> vec3<f32> {
  let middle = floor(at - 0.5) + 0.5;
  let f = at - middle;
  let w0 = f * (-0.5 + f * (1.0 - 0.5 * f));
  let w1 = 1.0 + f * f * (-2.5 + 1.5 * f);
  let w2 = f * (0.5 + f * (2.0 - 1.5 * f));
  let w3 = f * f * (-0.5 + 0.5 * f);
  let w12 = w1 + w2;
  let size = camera.size;
  let p0 = (middle - 1.0) / size;
  let p3 = (middle + 2.0) / size;
  let p12 = (middle + w2 / w12) / size;
  let sum = textureSampleLevel(before, smooth_, vec2<f32>(p12.x, p0.y), 0.0).rgb * (w12.x * w0.y)
    + textureSampleLevel(before, smooth_, vec2<f32>(p0.x, p12.y), 0.0).rgb * (w0.x * w12.y)
    + textureSampleLevel(before, smooth_, p12, 0.0).rgb * (w12.x * w12.y)
    + textureSampleLevel(before, smooth_, vec2<f32>(p3.x, p12.y), 0.0).rgb * (w3.x * w12.y)
    + textureSampleLevel(before, smooth_, vec2<f32>(p12.x, p3.y), 0.0).rgb * (w12.x * w3.y);
  let weight = w12.x * w0.y + w0.x * w12.y + w12.x * w12.y + w3.x * w12.y + w12.x * w3.y;
  return sum / weight;
}

// Whether a surface at a depth was visible around a pixel of the last frame; if not, it was hidden there.
fn seen_before(nearest: vec2<i32>, last: vec2<i32>, z: f32) -> bool {
  var near = textureLoad(far_before, nearest, 0).r;
  var far = near;
  for (var k = 0; k < 9 && (z < near * (1.0 - SAME) || z > far * (1.0 + SAME)); k++) {
    let there = textureLoad(far_before, clamp(nearest + vec2<i32>(k % 3 - 1, k / 3 - 1), vec2<i32>(0), last), 0).r;
    near = min(near, there);
    far = max(far, there);
  }
  return z >= near * (1.0 - SAME) && z <= far * (1.0 + SAME);
}

// Whether ground, metres east and north of the eye, looks different from the last frame.
fn changed(p: vec2<f32>) -> bool {
  let at = vec2<f32>(dot(camera.inverse.xy, p), dot(camera.inverse.zw, p));
  for (var k = 0u; k < temporal.fresh.x; k++) {
    let area = temporal.areas[k];
    if (all(at >= area.xy) && all(at <= area.zw)) {
      return true;
    }
  }
  return false;
}

fn mean_of(position: vec2<f32>) -> Mean {
  let pixel = vec2<i32>(position);
  let now = textureLoad(light, pixel, 0).rgb;
  let stored = textureLoad(depth, pixel, 0);
  let ground = stored > 0.0;
  let depth_now = select(SKY, depth_of(stored), ground);
  let alone = Mean(vec4<f32>(now, 1.0), depth_now);
  if (temporal.forward.w == 0.0 || temporal.moved.w >= 1.0) {
    return alone;
  }
  // The place of this pixel's ground in the last frame.
  let ray = ray_of(position - temporal.shift);
  var p = ray.direction;
  var scaled = 0.0;
  if (ground) {
    let here = ray.origin + ray.direction * depth_now;
    p = here + temporal.moved.xyz;
    scaled = abs(1.0 - length(here) / max(length(p), 1e-6));
  } else if (camera.plan == 1u) {
    return alone;
  }
  let z = dot(temporal.forward.xyz, p);
  var clip = vec2<f32>(dot(temporal.right.xyz, p) * temporal.right.w, dot(temporal.up.xyz, p) * temporal.up.w);
  if (camera.plan == 0u) {
    if (z <= 0.0) {
      return alone;
    }
    clip /= z;
  }
  clip += temporal.centre;
  let at = vec2<f32>(0.5 + 0.5 * clip.x, 0.5 - 0.5 * clip.y) * camera.size;
  if (any(at < vec2<f32>(-1.0)) || any(at > camera.size + 1.0)) {
    return alone;   // it has just come into the picture
  }
  let last = vec2<i32>(camera.size) - 1;
  let nearest = clamp(vec2<i32>(floor(at)), vec2<i32>(0), last);
  var mean = gathered(at);
  // (For what is sky now, the ground that was there.)
  let then = select(textureLoad(far_before, nearest, 0).r, depth_now, ground);
  let anew = then < SKY && temporal.fresh.x > 0u && changed((ray.origin + ray.direction * then).xy);
  // It was hidden, or is drawn or lit differently now: clamp the mean to what lies around the pixel. (Software
  // renderers execute a condition's body whether it is taken or not, but not a loop that no pixel enters.)
  let strange = anew || temporal.forward.w > 1.0 || !seen_before(nearest, last, select(SKY, z, ground));
  var low = select(vec3<f32>(0.0), now, strange);
  var high = select(vec3<f32>(FULL), now, strange);
  for (var k = select(9, 0, strange); k < 9; k++) {
    let beside = textureLoad(light, clamp(pixel + vec2<i32>(k % 3 - 1, k / 3 - 1), vec2<i32>(0), last), 0).rgb;
    low = min(low, beside);
    high = max(high, beside);
  }
  mean = clamp(mean, low, high);
  let count = min(textureLoad(before, nearest, 0).a, select(1023.0, ANEW, anew)) + 1.0;
  let fast = min(length(at - position), 1.0) * FAST;
  let share = max(max(temporal.moved.w, 1.0 / count), max(min(SCALE * scaled, 1.0), fast));
  return Mean(vec4<f32>(mix(max(mean, vec3<f32>(0.0)), now, share), count), depth_now);
}

// unless: COMPUTED
@fragment
fn fragment(@builtin(position) position: vec4<f32>) -> Mean {
  return mean_of(position.xy);
}
// end: COMPUTED

// when: COMPUTED
@group(1) @binding(6) var onto: texture_storage_2d<rgba16float, write>;
@group(1) @binding(7) var far_onto: texture_storage_2d<r32float, write>;

// Rounded to what 16 bits hold: where stores cut off what they do not, a mean of many frames would darken.
fn rounded(light: vec4<f32>) -> vec4<f32> {
  return bitcast<vec4<f32>>((bitcast<vec4<u32>>(light) + 0x1000u) & vec4<u32>(0xffffe000u));
}

@compute @workgroup_size(8, 8)
fn compute(@builtin(global_invocation_id) k: vec3<u32>) {
  if (any(k.xy >= vec2<u32>(camera.size))) {
    return;
  }
  let mean = mean_of(vec2<f32>(k.xy) + 0.5);
  textureStore(onto, k.xy, rounded(mean.light));
  textureStore(far_onto, k.xy, vec4<f32>(mean.far));
}
// end: COMPUTED
