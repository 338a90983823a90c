// Layers laid over the ground: a virtual texture (rendering/gpu/stream/imagery.py), filtered over a pixel's footprint like
// geovis/mipmap.look_along: look-ups as wide as the footprint's minor axis, side by side along its major axis.
// Needs ``atlas``, ``atlas_sampler``, ``imagery``.

const GRAZING: f32 = 0.02;         // rendering/cpu/kernels.py
const LEAST: f32 = 0.7;
const TILE_SIDE: i32 = 258;
const IMAGE_LAYERS: u32 = 4u;      // words before the first head: layers, maximum look-ups in a footprint
const HEAD: u32 = 24u;

fn word_f(at: u32) -> f32 { return bitcast<f32>(imagery[at]); }
fn word_i(at: u32) -> i32 { return bitcast<i32>(imagery[at]); }
fn word2_f(at: u32) -> vec2<f32> { return vec2<f32>(word_f(at), word_f(at + 1u)); }
fn word2_i(at: u32) -> vec2<i32> { return vec2<i32>(word_i(at), word_i(at + 1u)); }

// Metres east and north (columns) by which the ground moves from a pixel to the next one right and below, and the least
// metres of the minor axis: picture/kernels.footprints.
struct Footprint { right: vec2<f32>, below: vec2<f32>, least: f32 };

fn footprint_of(pixel: vec2<f32>, position: vec3<f32>, depth: f32, slope: vec2<f32>) -> Footprint {
  let ray = ray_of(pixel);
  let normal = vec3<f32>(-slope * camera.forward.w, 1.0);
  let facing = min(dot(normal, ray.direction), -GRAZING * length(ray.direction) * length(normal));
  var out: Footprint;
  for (var k = 0; k < 2; k++) {
    let next = ray_of(pixel + select(vec2<f32>(0.0, 1.0), vec2<f32>(1.0, 0.0), k == 0));
    let step = next.origin - ray.origin + depth * (next.direction - ray.direction);
    let moved = step.xy - ray.direction.xy * (dot(normal, step) / facing);
    if (k == 0) { out.right = moved; } else { out.below = moved; }
  }
  out.least = LEAST * camera.pixel * select(depth * length(ray.direction), 1.0, camera.plan == 1u);
  return out;
}

// The mean (multiplied by opacity) of a level around a position: whole pixels and the remainder.
fn image_level(head: u32, whole: vec2<i32>, part: vec2<f32>, wanted: u32) -> vec4<f32> {
  let level = clamp(wanted, imagery[head + 12u], imagery[head + 13u]);
  let at = imagery[head + 14u] + (level - imagery[head + 12u]) * 8u;
  let down = vec2<i32>(floor(part));
  let texel = (whole + down) >> vec2<u32>(level);
  let first = vec2<i32>(word_i(at + 2u), word_i(at + 1u));
  let count = vec2<i32>(word_i(at + 4u), word_i(at + 3u));
  let tile = clamp((texel >> vec2<u32>(8u)) - first, vec2<i32>(0), count - 1);
  let page = imagery[imagery[head + 16u] + imagery[at] + u32(tile.y * count.x + tile.x)];
  let place = i32(page & 0xffffffu) - 1;
  if (place < 0) {
    return vec4<f32>(0.0);
  }
  // The tile that is present, of this level or a coarser one.
  let there = (page >> 24u) & 31u;
  let base = (whole + down) >> vec2<u32>(there);
  let rest = (vec2<f32>(whole + down - (base << vec2<u32>(there))) + (part - vec2<f32>(down))) / f32(1u << there);
  let tiles = (first + tile) >> vec2<u32>(there - level);
  let local = clamp(vec2<f32>(base - tiles * 256) + rest, vec2<f32>(-0.5), vec2<f32>(256.5)) + 1.0;
  let slot = place % (PER_SIDE * PER_SIDE);
  let origin = vec2<f32>(vec2<i32>(slot % PER_SIDE, slot / PER_SIDE) * TILE_SIDE);
  let side = f32(PER_SIDE * TILE_SIDE);
  return textureSampleLevel(atlas, atlas_sampler, (origin + local) / side, place / (PER_SIDE * PER_SIDE), 0.0);
}

// The mean of a layer (multiplied by opacity) over a footprint around a position.
fn layer_mean(head: u32, position: vec2<f32>, footprint: Footprint) -> vec4<f32> {
  let across = word2_f(head);
  let down = word2_f(head + 2u);
  let cell = word2_i(head + 4u);
  let nodes = word2_i(head + 8u);
  let near = word2_f(head + 6u) + vec2<f32>(dot(across, position), dot(down, position));
  let k = clamp(cell + vec2<i32>(floor(near)), vec2<i32>(0), nodes - 2);
  let f = near - vec2<f32>(k - cell);
  // The image positions of the cell's corners, relative to the first one's whole pixel.
  let corner = imagery[head + 15u] + u32(k.y * nodes.x + k.x) * 4u;
  let wide = u32(nodes.x) * 4u;
  let whole = word2_i(corner);
  let w10 = word2_i(corner + 4u);
  let w01 = word2_i(corner + wide);
  let w11 = word2_i(corner + wide + 4u);
  let least = min(min(whole, w10), min(w01, w11));
  if (min(least.x, least.y) == -2147483647 - 1) {
    return vec4<f32>(0.0);
  }
  let c00 = word2_f(corner + 2u);
  let c10 = vec2<f32>(w10 - whole) + word2_f(corner + 6u);
  let c01 = vec2<f32>(w01 - whole) + word2_f(corner + wide + 2u);
  let c11 = vec2<f32>(w11 - whole) + word2_f(corner + wide + 6u);
  let part = mix(mix(c00, c10, f.x), mix(c01, c11, f.x), f.y);
  let along = mix(c10 - c00, c11 - c01, f.y);
  let under = mix(c01 - c00, c11 - c10, f.x);
  // Pixels of the image per metre east and north.
  let east = along * across.x + under * down.x;
  let north = along * across.y + under * down.y;
  let a = east * footprint.right.x + north * footprint.right.y;
  let b = east * footprint.below.x + north * footprint.below.y;
  // The axes of the ellipse.
  let p = a.x * a.x + b.x * b.x;
  let r = a.y * a.y + b.y * b.y;
  let q = a.x * a.y + b.x * b.y;
  let major = sqrt(0.5 * (p + r + sqrt((p - r) * (p - r) + 4.0 * q * q)));
  let square = dot(east, east) + dot(north, north);
  let area = abs(east.x * north.y - north.x * east.y);
  let greater = sqrt(0.5 * (square + sqrt(max(square * square - 4.0 * area * area, 0.0))));
  let floor_width = footprint.least * area / max(greater, 1e-30);
  let minor = max(max(abs(a.x * b.y - b.x * a.y) / max(major, 1e-30), floor_width), 1.0);
  let taps = clamp(ceil(major / minor - 1e-3), 1.0, f32(imagery[1]));
  let level = min(log2(max(minor, major / taps)), f32(imagery[head + 13u]));
  let turn = 0.5 * atan2(2.0 * q, p - r);
  let step = vec2<f32>(cos(turn), sin(turn)) * (major / taps);
  let fine = floor(level);
  let share = level - fine;
  let size = word2_i(head + 10u);
  let bounded = imagery[head + 19u];
  var sum = vec4<f32>(0.0);
  for (var n = 0.0; n < taps; n += 1.0) {
    let spot = part + step * (n + 0.5 - 0.5 * taps);
    let down_to = floor(spot);
    let pixel = whole + vec2<i32>(down_to);
    let rest = spot - down_to;
    // Less than a thousandth of a pixel beyond the border is rounding.
    let out_of = vec2<bool>((pixel.x < 0 && (pixel.x < -1 || rest.x < 0.999)) || (pixel.x >= size.x && (pixel.x > size.x || rest.x > 1e-3)),
                            (pixel.y < 0 && (pixel.y < -1 || rest.y < 0.999)) || (pixel.y >= size.y && (pixel.y > size.y || rest.y > 1e-3)));
    if (((bounded & 1u) != 0u && out_of.x) || ((bounded & 2u) != 0u && out_of.y)) {
      continue;
    }
    var found = image_level(head, pixel, rest, u32(fine));
    if (share > 1e-3) {
      found = mix(found, image_level(head, pixel, rest, u32(fine) + 1u), share);
    }
    sum += found;
  }
  return sum / taps;
}

// A ground's color under all layers, bottom to top (geovis/layers.py).
fn under_layers(color: vec3<f32>, position: vec2<f32>, footprint: Footprint) -> vec3<f32> {
  var out = color;
  for (var k = 0u; k < imagery[0]; k++) {
    let head = IMAGE_LAYERS + k * HEAD;
    let image = layer_mean(head, position, footprint) * word_f(head + 17u);
    let through = image.rgb * select(vec3<f32>(1.0), out, imagery[head + 18u] == 1u);
    out = out * (1.0 - image.a) + through;
  }
  return out;
}
