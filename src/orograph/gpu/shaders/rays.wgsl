// Light by rays: the discs of suns and the sky by lattices of rays, lamps by one ray each; lighting/hit_rays.py and
// rendering/cpu/lighting.py (Raytraced) on the GPU, with the same directions. Of every lattice, `ray.rays` rays are traced from
// `ray.first` on; consecutive ones are spread over the lattice, so that a part of it already gives a fair mean.
// include: ray_field.wgsl

const GOLDEN: u32 = 2654435769u;   // 2³² / golden ratio
const TURN: f32 = 6.283185307179586;
const SMALL: f32 = 0.9990;         // cosine of a disc's radius above which five rays decide whether all of it is visible

// 64-bit numbers as (low, high), for the hash that shifts a pixel's lattices (SplitMix64, as on the CPU).
fn product32(a: u32, b: u32) -> vec2<u32> {
  let al = a & 0xffffu;
  let ah = a >> 16u;
  let bl = b & 0xffffu;
  let bh = b >> 16u;
  let low = al * bl;
  let one = al * bh;
  let two = ah * bl;
  let middle = (low >> 16u) + (one & 0xffffu) + (two & 0xffffu);
  return vec2<u32>((low & 0xffffu) | (middle << 16u), ah * bh + (one >> 16u) + (two >> 16u) + (middle >> 16u));
}

fn product64(a: vec2<u32>, b: vec2<u32>) -> vec2<u32> {
  let p = product32(a.x, b.x);
  return vec2<u32>(p.x, p.y + a.x * b.y + a.y * b.x);
}

fn sum64(a: vec2<u32>, b: vec2<u32>) -> vec2<u32> {
  let low = a.x + b.x;
  return vec2<u32>(low, a.y + b.y + u32(low < a.x));
}

fn folded(x: vec2<u32>, by: u32) -> vec2<u32> {   // x ^ (x >> by), 0 < by < 32
  return x ^ vec2<u32>((x.x >> by) | (x.y << (32u - by)), x.y >> by);
}

fn mixed(x: vec2<u32>) -> vec2<u32> {
  let a = product64(folded(x, 30u), vec2<u32>(0x1CE4E5B9u, 0xBF58476Du));
  return folded(product64(folded(a, 27u), vec2<u32>(0x133111EBu, 0x94D049BBu)), 31u);
}

// Two numbers in [0, 1) for a pixel.
fn shift_of(pixel: vec2<u32>, seed: u32) -> vec2<f32> {
  let odd = vec2<u32>(0x7F4A7C15u, 0x9E3779B9u);
  let key = sum64(vec2<u32>(pixel.y, pixel.x), product64(odd, vec2<u32>(seed + 1u, 0u)));
  let a = mixed(key);
  let b = mixed(sum64(a, odd));
  return vec2<f32>(f32(a.y >> 8u), f32(b.y >> 8u)) / 16777216.0;
}

// A unit vector with two others perpendicular to it and to each other (Duff et al. 2017).
fn frame_about(n: vec3<f32>) -> mat3x3<f32> {
  let sign = select(-1.0, 1.0, n.z >= 0.0);
  let a = -1.0 / (sign + n.z);
  let b = n.x * n.y * a;
  return mat3x3<f32>(
    vec3<f32>(1.0 + sign * n.x * n.x * a, sign * b, -sign * n.x), vec3<f32>(b, sign + n.y * n.y * a, -n.y), n);
}

// The number of the k-th ray to be traced, and the angle of a ray about its light's axis.
fn ray_number(k: u32) -> u32 {
  return ((ray.first + k) % ray.total) * ray.stride % ray.total;
}

fn ray_turn(m: u32, shift: f32) -> vec2<f32> {   // sine, cosine
  return sine_cosine(TURN * fract(f32(m * GOLDEN) / 4294967296.0 + shift));
}

struct From { place: Place, height: f32, skip: f32 };

fn sees(from_: From, way: vec3<f32>, far: f32) -> bool {
  return !blocked(from_.place, from_.height, way, from_.skip, far);
}

// The mean over a disc of its cosine to the normal where it is visible.
fn disc_by_rays(from_: From, normal: vec3<f32>, sun: Sun, shift: vec2<f32>) -> f32 {
  let facing = dot(normal, sun.direction);
  let small = sun.cosine >= SMALL;
  if (facing <= select(-sun.sine, 0.0, small)) {
    return 0.0;
  }
  let about = frame_about(sun.direction);
  if (small && ray.rays > 5u) {
    // Five rays, in its middle and at four points on the rim: only where they disagree are there more.
    var seen = 0u;
    for (var m = 0u; m < 5u; m++) {
      let turn = sine_cosine(0.25 * TURN * (f32(m) + shift.y));
      let across = select(sun.sine, 0.0, m == 0u);
      let way = about * vec3<f32>(across * turn.y, across * turn.x, select(sun.cosine, 1.0, m == 0u));
      seen += u32(sees(from_, way, 1e9));
      if (seen != 0u && seen != m + 1u) {
        break;
      }
    }
    if (seen == 0u || seen == 5u) {
      return select(0.0, facing, seen == 5u);
    }
  }
  let deep = sun.area / TURN;   // 1 − the cosine of its radius
  var total = 0.0;
  for (var k = 0u; k < ray.rays; k++) {
    let m = ray_number(k);
    let low = deep * (f32(m) + shift.x) / f32(ray.total);
    let turn = ray_turn(m, shift.y);
    let across = sqrt(max(low * (2.0 - low), 0.0));
    let way = about * vec3<f32>(across * turn.y, across * turn.x, 1.0 - low);
    let share = dot(way, normal);
    if (share > 0.0) {
      total += select(0.0, share, sees(from_, way, 1e9));
    }
  }
  return total / f32(ray.rays);
}

// The visible part of the sky, weighted by its cosine to the normal.
fn sky_by_rays(from_: From, normal: vec3<f32>, shift: vec2<f32>) -> f32 {
  let about = frame_about(normal);
  var free = 0u;
  for (var k = 0u; k < ray.rays; k++) {
    let m = ray_number(k);
    let u = (f32(m) + shift.x) / f32(ray.total);
    let turn = ray_turn(m, shift.y);
    let across = sqrt(u);
    free += u32(sees(from_, about * vec3<f32>(across * turn.y, across * turn.x, sqrt(1.0 - u)), 1e9));
  }
  return f32(free) / f32(ray.rays);
}

fn start_at(at: Place, footprint: f32) -> From {
  let foot = foot_of(at);
  return From(at, foot.height, max(foot.scale, min(footprint, 4.0)) * ray.spacing);
}

// The part of the sun's disc above the skyline towards it. If a ray over a height field is blocked, so are all lower ones
// from the same place, so bisection between the disc's limbs finds the skyline: to 1/32 of the disc's radius.
fn sun_above_skyline(at: Place, footprint: f32) -> f32 {
  let start = start_at(at, footprint);
  let level = length(shade.sun.xy);
  let from_ = From(start.place, start.height, start.skip / max(level, 0.01));   // as far over the ground
  let side = select(vec2<f32>(0.0, 1.0), shade.sun.xy / level, level > 1e-6);
  let upward = vec3<f32>(-side * shade.sun.z, level);
  var low = -1.0;
  var high = 1.0;
  var between = 0.0;
  for (var k = 0u; k < 8u; k++) {
    between = select(0.5 * (low + high), select(1.0, -1.0, k == 0u), k < 2u);
    let turn = sine_cosine(between * shade.sun.w);
    let free = sees(from_, turn.y * shade.sun.xyz + turn.x * upward, 1e9);
    if (k < 2u) {
      if (free == (k == 0u)) {   // the lower limb is visible, or the upper one is not
        return f32(free);
      }
    } else if (free) {
      high = between;
    } else {
      low = between;
    }
  }
  return disc_part(0.5 * (low + high));
}

// All light on a place: normals of the stretched ground and of what is shaded, the place relative to the eye, the
// pixel position where it appears.
fn light_by_rays(
  at: Place, footprint: f32, normal: vec3<f32>, shaded: vec3<f32>, position: vec3<f32>, pixel: vec2<f32>
) -> vec3<f32> {
  let from_ = start_at(at, footprint);
  let number = vec2<u32>(vec2<i32>(floor((pixel + ray.corner) * 64.0)));
  let around = shade.skylight.w * (shade.sunlight.rgb + shade.skylight.rgb);
  let share = sky_by_rays(from_, normal, shift_of(number, 2u));
  var light = share * shade.skylight.rgb + (1.0 - share) * around;
  for (var k = 0u; k < select(SUNS, shade.suns, SUNS == 7u); k++) {
    var seen = max(dot(shaded, suns[k].direction), 0.0);
    if ((FLAGS & 1u) != 0u) {
      seen = disc_by_rays(from_, shaded, suns[k], shift_of(number, 1u));
    }
    light += seen * suns[k].color;
  }
  for (var k = 0u; k < select(0u, shade.lamps, (FLAGS & 131072u) != 0u); k++) {
    let way = lamps[k].place - position;
    let away = length(way);
    let facing = dot(way, shaded) / max(away, 1e-9);
    if (facing > 0.0) {
      let near = From(at, from_.height, min(from_.skip, away));
      light += select(0.0, facing / (away * away), sees(near, way / away, away)) * lamps[k].color;
    }
  }
  return light;
}
