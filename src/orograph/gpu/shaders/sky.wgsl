// The clear sky and the air in front of the ground: rendering/sky.py's tables, looked up per pixel.
// Needs ``tables`` (storage, array<f32>) and ``shade`` (uniform).

fn mie_phase(cosine: f32) -> f32 {
  let g = 0.72;
  let x = max(1.0 + g * g - 2.0 * g * cosine, 1e-4);
  let norm = 3.0 * (1.0 - g * g) / (8.0 * 3.14159265358979 * (2.0 + g * g));
  return norm * (1.0 + cosine * cosine) / (x * sqrt(x));
}

fn rgb(at: u32) -> vec3<f32> {
  return vec3<f32>(tables[at], tables[at + 1u], tables[at + 2u]);
}

fn tone(radiance: vec3<f32>) -> vec3<f32> {
  return vec3<f32>(1.0) - exp(-radiance);
}

// sin(φ / 2) of the azimuth between a direction and the sun.
fn around(d: vec3<f32>) -> f32 {
  let level = max(length(d.xy), 1e-12);
  return sqrt(clamp(0.5 - 0.5 * dot(d.xy, shade.side) / level, 0.0, 1.0));
}

// Radiance of the sky in a direction at or above the horizon, before the tone curve.
fn above(d: vec3<f32>) -> vec3<f32> {
  let u = sqrt(clamp(d.z, 0.0, 1.0)) * f32(shade.sky_rows - 1u);
  let v = around(d) * f32(shade.sky_cols - 1u);
  let i = min(u32(u), shade.sky_rows - 2u);
  let j = min(u32(v), shade.sky_cols - 2u);
  let fu = u - f32(i);
  let fv = v - f32(j);
  let a = shade.sky_at + (i * shade.sky_cols + j) * 6u;
  let b = a + shade.sky_cols * 6u;
  let air = mix(mix(rgb(a), rgb(a + 6u), fv), mix(rgb(b), rgb(b + 6u), fv), fu);
  let haze = mix(mix(rgb(a + 3u), rgb(a + 9u), fv), mix(rgb(b + 3u), rgb(b + 9u), fv), fu);
  let cosine = dot(d, shade.sun.xyz);
  var out = air + haze * mie_phase(cosine);
  let radius = shade.sun.w;
  if (radius > 0.0 && d.z >= 0.0 && cosine > 0.5) {
    let angle = 2.0 * asin(min(0.5 * length(d - shade.sun.xyz), 1.0));
    out += clamp((radius - angle) / (0.1 * radius) + 0.5, 0.0, 1.0) * shade.disc.xyz;
  }
  return out;
}

fn sky(d: vec3<f32>) -> vec3<f32> {
  let out = tone(above(d));
  let down = min(d.z, 0.0);
  return mix(out, shade.mist.xyz, 1.0 - exp(down * shade.mist.w));
}

// Move a color by up to half a step of a byte of sRGB, against banding of skies (ordered dither, like rendering/sky.py).
fn dithered(color: vec3<f32>, pixel: vec2<u32>) -> vec3<f32> {
  var rank = 0u;
  for (var k = 0u; k < 3u; k++) {
    let bit = (pixel >> vec2<u32>(k)) & vec2<u32>(1u);
    rank |= ((bit.x ^ bit.y) << (5u - 2u * k)) | (bit.y << (4u - 2u * k));
  }
  let step = 2.4 / 1.055 / 255.0 * pow(max(color, vec3<f32>(1e-3)), vec3<f32>(1.4 / 2.4));
  return color + ((f32(rank) + 0.5) / 64.0 - 0.5) * step;
}

fn horizon(d: vec3<f32>) -> vec3<f32> {
  let t = around(d) * 256.0;
  let k = min(u32(t), 255u);
  let at = shade.ring_at + k * 3u;
  return mix(rgb(at), rgb(at + 3u), t - f32(k));
}

// The color of ground at a depth, dimmed by the air, plus the air's own light.
fn haze(color: vec3<f32>, d: vec3<f32>, depth: f32) -> vec3<f32> {
  let left = exp(-max(depth - shade.extinction.w, 0.0) * shade.extinction.xyz);
  let air = horizon(d);
  return air + (color - air) * left;
}
