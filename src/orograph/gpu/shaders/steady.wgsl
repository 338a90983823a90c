// A frame and the ones before it, each drawn with samples elsewhere in its pixels: where the ground in a pixel was in the
// last frame is known, so what was gathered there goes on (see gpu/steady.py).
// include: camera.wgsl

struct Steady {
  right: vec4<f32>,      // the last frame's axes and focal lengths, as the camera has them
  up: vec4<f32>,
  forward: vec4<f32>,    // w: 1 if there is a last frame
  moved: vec4<f32>,      // how far the eye has moved since, stretched metres; w: the least part of this frame in the mean
  centre: vec2<f32>,     // clip offset of the last frame's optical axis, samples in the middle of pixels
  shift: vec2<f32>,      // where in its pixel this frame's sample lies, pixels from the middle
};

@group(1) @binding(0) var<uniform> steady: Steady;
@group(1) @binding(1) var light: texture_2d<f32>;
@group(1) @binding(2) var depth: texture_depth_2d;
@group(1) @binding(3) var before: texture_2d<f32>;
@group(1) @binding(4) var smooth_: sampler;

@vertex
fn vertex(@builtin(vertex_index) k: u32) -> @builtin(position) vec4<f32> {
  return vec4<f32>(f32(k & 1u) * 4.0 - 1.0, f32(k >> 1u) * 4.0 - 1.0, 0.0, 1.0);
}

// (Alpha counts the frames that are in a pixel's mean.)
// The mean so far at a position in pixels, by Catmull and Rom's cubic in five bilinear looks: a linear one again and again
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

@fragment
fn fragment(@builtin(position) position: vec4<f32>) -> @location(0) vec4<f32> {
  let pixel = vec2<i32>(position.xy);
  let now = textureLoad(light, pixel, 0).rgb;
  if (steady.forward.w == 0.0 || steady.moved.w >= 1.0) {
    return vec4<f32>(now, 1.0);
  }
  // Where this pixel's ground was.
  let stored = textureLoad(depth, pixel, 0);
  let ray = ray_of(position.xy - steady.shift);
  var p = ray.direction;
  if (stored > 0.0) {
    p = ray.origin + ray.direction * depth_of(stored) + steady.moved.xyz;
  } else if (camera.plan == 1u) {
    return vec4<f32>(now, 1.0);
  }
  let z = dot(steady.forward.xyz, p);
  var clip = vec2<f32>(dot(steady.right.xyz, p) * steady.right.w, dot(steady.up.xyz, p) * steady.up.w);
  if (camera.plan == 0u) {
    if (z <= 0.0) {
      return vec4<f32>(now, 1.0);
    }
    clip /= z;
  }
  clip += steady.centre;
  let at = vec2<f32>(0.5 + 0.5 * clip.x, 0.5 - 0.5 * clip.y) * camera.size;
  if (any(at < vec2<f32>(-1.0)) || any(at > camera.size + 1.0)) {
    return vec4<f32>(now, 1.0);   // it came into the picture
  }
  // What was seen there and is hidden now, or lit otherwise, is nothing like what lies around the pixel.
  let last = vec2<i32>(camera.size) - 1;
  var low = now;
  var high = now;
  for (var k = 0; k < 9; k++) {
    let beside = textureLoad(light, clamp(pixel + vec2<i32>(k % 3 - 1, k / 3 - 1), vec2<i32>(0), last), 0).rgb;
    low = min(low, beside);
    high = max(high, beside);
  }
  let nearest = clamp(vec2<i32>(floor(at)), vec2<i32>(0), last);
  let count = min(textureLoad(before, nearest, 0).a + 1.0, 1024.0);
  return vec4<f32>(mix(clamp(gathered(at), low, high), now, max(steady.moved.w, 1.0 / count)), count);
}
