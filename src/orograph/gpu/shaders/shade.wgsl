// From a pixel's depth to its color: rendering/cpu/shading.py and rendering/cpu/kernels.py on the GPU, in the same order and
// with the same constants. Light is linear; slopes are means over the pixel, from the atlas of slope tiles.
// include: camera.wgsl
// include: place.wgsl

struct Shade {
  sun: vec4<f32>,           // towards the sun (east, north, up); w: the disc's radius, radians
  sunlight: vec4<f32>,      // w: strength, the factor on slopes
  skylight: vec4<f32>,      // w: bounce
  water: vec4<f32>,         // color; w: half the width of the shore's field
  paper: vec4<f32>,         // background; w: metres between samples
  extinction: vec4<f32>,    // per metre; w: depth where the air begins
  mist: vec4<f32>,          // w: how fast it fades
  disc: vec4<f32>,          // radiance of the sun's disc; w: 1 if there is a sky
  tint: vec4<f32>,          // low, high, floor (metres); w: ground below is water (metres; far below all ground: look it up)
  contour: vec4<f32>,       // interval (metres, 0: none), lines per index contour, width in pixels, opacity
  contour_colour: vec4<f32>,
  edge: vec4<f32>,          // of silhouettes: color, opacity
  edge_range: vec4<f32>,    // depths in view (metres), width of lines in pixels, pixels to search
  casing: vec4<f32>,        // of contour lines and of silhouettes: opacity; width in pixels
  side: vec2<f32>,          // horizontal direction towards the sun
  sky_at: u32, sky_rows: u32,
  sky_cols: u32, ring_at: u32,
  land_at: u32, land_count: u32,
  sea_at: u32, sea_count: u32,
  levels: u32, flags: u32,
  searched: vec4<i32>,      // the samples (from column, row, to column, row) that the map of water covers
  light: vec4<i32>,         // the map of light: offset, rows, cols, level
  light_first: vec2<i32>,   // its first block (row, col)
  windows: u32, hatch: u32,
  fields: u32, suns: u32,   // windows of shares of the sky or caps; discs of light
  lamps: u32, corner: u32,  // points of light; column and row (high half) of the target's first pixel in the whole picture
};

struct Window { offset: i32, rows: i32, cols: i32, level: i32, row0: i32, col0: i32, channels: i32, pad: i32 };

@group(1) @binding(0) var<uniform> shade: Shade;
@group(1) @binding(1) var depths: texture_depth_2d;
@group(1) @binding(2) var marks: texture_2d<u32>;
@group(1) @binding(3) var slopes: texture_2d_array<f32>;
@group(1) @binding(4) var<storage, read> pages: array<u32>;
@group(1) @binding(5) var<storage, read> tables: array<f32>;
@group(1) @binding(6) var<storage, read> maps: array<f32>;
@group(1) @binding(7) var<uniform> levels: array<Level, LEVELS>;
@group(1) @binding(8) var<uniform> windows: array<Window, 64>;   // of the sun, then of the field
@group(1) @binding(9) var atlas: texture_2d_array<f32>;
@group(1) @binding(10) var atlas_sampler: sampler;
@group(1) @binding(11) var<storage, read> imagery: array<u32>;
@group(1) @binding(12) var<storage, read> suns: array<Sun>;
@group(1) @binding(13) var<storage, read> lamps: array<Lamp>;
@group(1) @binding(14) var given: texture_2d<f32>;    // slopes of the drawn surface, metres per metre
@group(1) @binding(15) var lettering: texture_2d<f32>;  // of labels: ink and halo
@group(1) @binding(16) var breaks: texture_2d<f32>;   // between a pixel and the next one to the right, and below
@group(1) @binding(17) var breaks_near: texture_2d<f32>;   // the heaviest of 8 × 8 pixels
@group(1) @binding(18) var field: texture_2d<f32>;    // the terrain's own heights, metres
@group(1) @binding(19) var heights: texture_2d_array<f32>;   // tiles of them
@group(1) @binding(20) var<storage, read> height_pages: array<u32>;
// include: aperture.wgsl
// when: RAYS
// include: rays.wgsl
// end: RAYS
// include: sky.wgsl
// include: imagery.wgsl

// What is drawn, known when the shader is compiled, because software renderers execute branches whether they are taken or
// not. 1 shadows, 2 water, 4 layers, 8 wireframe, 16 colors of levels, 32 no light, 64 occlusion, 128 apertures, 256 sky,
// 512 contour lines, 1024 missing ground, 2048 slopes as given, 4096 labels, 8192 silhouettes, 16384 lines of ``field``,
// 32768 of the smooth surface where samples are large.
const FLAGS: u32 = {{FLAGS}}u;
// For lights: 131072 lamps; 262144 the sun's shadows by rays; three bits from 2²⁰ up: discs of light, 7: any number.
const SUNS: u32 = (FLAGS >> 20u) & 7u;
// include: lines.wgsl
// include: slopes.wgsl
// include: contours.wgsl

// include: ground_light.wgsl

fn shoulder(x: vec3<f32>) -> vec3<f32> {
  return select(0.82 + 0.18 * (1.0 - exp((0.82 - x) / 0.18)), x, x < vec3<f32>(0.82));
}

fn tint_of(height: f32) -> vec3<f32> {
  let below = shade.sea_count > 0u && height < 0.0;
  let count = select(shade.land_count, shade.sea_count, below);
  let start = select(shade.land_at, shade.sea_at, below);
  let t = select((height - shade.tint.x) / (shade.tint.y - shade.tint.x), (height - shade.tint.z) / -shade.tint.z, below);
  let z = clamp(t * f32(count - 1u), 0.0, f32(count - 1u) - 1e-3);
  let k = u32(z);
  return mix(rgb(start + k * 3u), rgb(start + k * 3u + 3u), z - f32(k));
}

struct Ground {
  color: vec3<f32>,
  slope: vec2<f32>,     // metres per metre east and north, of the true ground
  wet: f32,             // how much of it is water
  beside: f32,          // how close it is to water, 1: contours of height 0 are left out (rendering/lookup.py)
};

// Whether all ground up to a height is water, instead of level ground.
fn is_flooded() -> bool {
  return shade.tint.w > -1e30;
}

// Whether a place lies outside the map of water.
fn beyond(at: Place) -> bool {
  return any(at.whole < shade.searched.xy) || any(at.whole >= shade.searched.zw);
}

// Colour of ground at a place, seen over a footprint (samples).
fn ground(at: Place, height: f32, footprint: f32, position: vec3<f32>, depth: f32, pixel: vec2<i32>) -> Ground {
  var g: vec2<f32>;
  if ((FLAGS & 2048u) != 0u) {
    g = textureLoad(given, pixel, 0).rg;
  } else {
    let s = slope(at, footprint);
    g = vec2<f32>(s.x * camera.inverse.x + s.y * camera.inverse.z, s.x * camera.inverse.y + s.y * camera.inverse.w);
  }
  let stretched = g * (camera.forward.w * shade.sunlight.w);
  let up = inverseSqrt(1.0 + dot(stretched, stretched));
  let cosine = max((shade.sun.z - dot(stretched, shade.sun.xy)) * up, 0.0);
  let size = shade.light.zy;
  let first = shade.light_first.yx;
  let around = shade.skylight.w * (shade.sunlight.rgb + shade.skylight.rgb);
  var light = vec3<f32>(1.0);
  if ((FLAGS & 128u) != 0u) {
    let normal = vec3<f32>(-stretched * up, up);
    light = through_apertures(cap_of(field_value(at, footprint)), normal, position);
  } else if ((FLAGS & 32u) == 0u) {
    var lit = cosine;
    if ((FLAGS & 1u) != 0u && cosine > 0.0) {
      lit *= sunlit(at, footprint);
    }
    if ((FLAGS & 64u) != 0u) {
      let share = field_value(at, footprint).x;
      light = lit * shade.sunlight.rgb + share * shade.skylight.rgb + (1.0 - share) * around;
    } else {
      let open = map_value(shade.light.x, size, first, shade.light.w, at);
      light = lit * shade.sunlight.rgb + open * (0.5 + 0.5 * up) * shade.skylight.rgb + (1.0 - open) * around;
    }
  }
  // when: RAYS
  if ((FLAGS & 65536u) != 0u) {   // (with 32) all light is by rays
    let steep = g * camera.forward.w;
    let tilt = inverseSqrt(1.0 + dot(steep, steep));
    light = light_by_rays(at, footprint, vec3<f32>(-steep * tilt, tilt), vec3<f32>(-stretched * up, up), position,
      vec2<f32>(pixel) + 0.5);
  }
  // end: RAYS
  var albedo = tint_of(height);
  var water = 0.0;
  if (is_flooded() && beyond(at)) {
    water = shade.tint.w + 0.5 + shade.water.w - height;
  } else if ((FLAGS & 2u) != 0u) {
    water = map_value(shade.light.x + size.x * size.y, size, first, shade.light.w, at);
  }
  let wet = smoothstep(0.5 - shade.water.w, 0.5 + shade.water.w, water);
  albedo = mix(albedo, shade.water.rgb, wet);
  if ((FLAGS & 4u) != 0u) {
    albedo = under_layers(albedo, position.xy, footprint_of(vec2<f32>(pixel) + 0.5, position, depth, g));
  }
  return Ground(shoulder(albedo * light), g, wet, smoothstep(0.06, 0.2, water));
}

// The ground in a pixel: its position relative to the eye, its place on the raster, and the pixel's footprint there.
struct Hit { depth: f32, position: vec3<f32>, place: Place, height: f32, footprint: f32 };

fn hit_at(stored: f32, ray: Ray) -> Hit {
  let depth = depth_of(stored);
  let position = ray.origin + ray.direction * depth;
  let cells = vec2<f32>(dot(camera.inverse.xy, position.xy), dot(camera.inverse.zw, position.xy)) + camera.eye_frac;
  let down = floor(cells);
  let place = Place(camera.eye_cell + vec2<i32>(down), cells - down);
  let height = camera.eye_height.x + camera.eye_height.y + position.z / camera.forward.w;
  let tilt = abs(ray.direction.z) * inverseSqrt(dot(ray.direction, ray.direction));
  let slant = inverseSqrt(clamp(tilt, 0.1, 1.0));
  let footprint = camera.pixel * select(depth, 1.0, camera.plan == 1u) * slant / shade.paper.w;
  return Hit(depth, position, place, height, footprint);
}

@vertex
fn vertex(@builtin(vertex_index) k: u32) -> @builtin(position) vec4<f32> {
  return vec4<f32>(f32(k & 1u) * 4.0 - 1.0, f32(k >> 1u) * 4.0 - 1.0, 0.0, 1.0);
}

// A pixel's position in the whole picture, of which the target may be a tile.
fn in_picture(at: vec2<f32>) -> vec2<u32> {
  return vec2<u32>(at) + vec2<u32>(shade.corner & 0xffffu, shade.corner >> 16u);
}

// The background, where the depth buffer is empty.
fn behind(at: vec2<f32>) -> vec4<f32> {
  let d = normalize(ray_of(at).direction);
  var color = shade.paper.rgb;
  if ((FLAGS & 256u) != 0u) {
    color = dithered(sky(d), in_picture(at));
  }
  if ((FLAGS & 8192u) != 0u) {
    color = outlined(color, vec2<i32>(at), d, 0.0);
  }
  return vec4<f32>(color, 1.0);
}

// The hatching for missing ground, at a depth.
fn hatched(at: vec2<f32>, d: vec3<f32>, depth: f32) -> vec4<f32> {
  let place = in_picture(at);
  let across = f32(place.x + place.y) + 1.0 + camera.shift.x + camera.shift.y;
  let line = across - 7.0 * floor(across / 7.0) < 2.0;
  var color = select(rgb(shade.hatch), rgb(shade.hatch + 3u), line);
  if ((FLAGS & 256u) != 0u) {
    color = haze(color, d, depth);
  }
  if ((FLAGS & 8192u) != 0u) {
    color = outlined(color, vec2<i32>(at), d, 1.0);
  }
  return vec4<f32>(color, 1.0);
}

// The color of the ground; 0 if a pixel stays unchanged.
fn shown(at: vec2<f32>, stored: f32) -> vec4<f32> {
  let pixel = vec2<i32>(at);
  let mark = textureLoad(marks, pixel, 0).r;
  if ((mark & 8u) != 0u) {   // surface_rays.wgsl
    return vec4<f32>(0.0);
  }
  let ray = ray_of(at);
  let d = normalize(ray.direction);
  let hit = hit_at(stored, ray);
  let depth = hit.depth;
  let position = hit.position;
  if ((FLAGS & 1024u) != 0u && (mark & 2u) != 0u) {   // a patch over missing data
    return hatched(at, d, depth);
  }
  let seen = ground(hit.place, hit.height, hit.footprint, position, depth, pixel);
  if (!is_flooded() && beyond(hit.place) && all(seen.slope == vec2<f32>(0.0))) {   // a lake, or level ground
    return hatched(at, d, depth);
  }
  var color = seen.color;
  if ((FLAGS & 16u) != 0u) {
    var level = level_colour((mark >> 8u) & 255u, (mark >> 4u) & 1u);
    if ((mark & 4u) != 0u) {   // by a ray: greys of its window
      level = vec3<f32>(select(0.75, 1.05, ((mark >> 8u) & 1u) == 1u));
    }
    color = mix(color, level * dot(color, vec3<f32>(0.4)), select(0.65, 0.95, (mark & 4u) != 0u));
  }
  if ((FLAGS & 512u) != 0u) {
    var height = hit.height;
    var own = seen.slope;
    var drawn = seen.slope;
    if ((FLAGS & 16384u) != 0u) {   // a mesh is drawn, but lines follow the terrain
      height = textureLoad(field, pixel, 0).r;
      drawn = textureLoad(given, pixel, 0).rg;
      if ((FLAGS & 2048u) != 0u) {
        let s = slope(hit.place, hit.footprint);
        own = vec2<f32>(s.x * camera.inverse.x + s.y * camera.inverse.z, s.x * camera.inverse.y + s.y * camera.inverse.w);
      }
    }
    if ((FLAGS & 32768u) != 0u) {
      height = smooth_height(hit.place, hit.footprint, ray.direction, height, (FLAGS & 16384u) == 0u);
    }
    let casing = max(shade.casing.x, lifting(color, 0.2));
    var cover = contours(height, hit.place, hit.footprint, depth, ray.direction, drawn, own, casing > 0.0);
    let hidden = select(seen.wet, seen.beside, abs(height) < 0.5 * shade.contour.x);
    cover *= (1.0 - hidden) * vec2<f32>(shade.contour.w, casing);
    if ((FLAGS & 4096u) != 0u) {   // labels: rendering/cpu/marks.py
      let letters = textureLoad(lettering, pixel, 0).rg;
      color = mix(color, shade.paper.rgb, max(shade.casing.x, lifting(color, 0.3)) * letters.g);
      cover = cover * (1.0 - letters.g) + vec2<f32>(letters.r * min(1.0, shade.contour.w + 0.3), 0.0);
    }
    color = mix(mix(color, shade.paper.rgb, cover.y), shade.contour_colour.rgb, cover.x);
  }
  if ((FLAGS & 256u) != 0u) {
    color = haze(color, d, depth);
  }
  if (hit.footprint < 0.5) {   // where samples are large, colors change by less than a byte's step over many pixels
    color = dithered(color, in_picture(at));
  }
  if ((FLAGS & 8192u) != 0u) {
    color = outlined(color, pixel, d, 1.0);
  }
  if ((FLAGS & 8u) != 0u) {
    var edge = 0.75 * f32((mark >> 16u) & 255u) / 255.0;
    if ((FLAGS & 4608u) == 4608u) {   // labels stay legible
      edge *= 1.0 - 0.85 * textureLoad(lettering, pixel, 0).g;
    }
    color = mix(color, vec3<f32>(0.02), edge);
  }
  return vec4<f32>(color, 1.0);
}

@fragment
fn background(@builtin(position) at: vec4<f32>) -> @location(0) vec4<f32> {   // (the depth test says so)
  return behind(at.xy);
}

@fragment
fn fragment(@builtin(position) at: vec4<f32>) -> @location(0) vec4<f32> {
  let light = shown(at.xy, textureLoad(depths, vec2<i32>(at.xy), 0));
  if (light.a == 0.0) {
    discard;
  }
  return light;
}

// when: COMPUTED
@group({{OUT_GROUP}}) @binding(0) var<uniform> part: vec4<u32>;   // x, y, width and height, pixels
@group({{OUT_GROUP}}) @binding(1) var computed: texture_storage_2d<rgba16float, write>;

@compute @workgroup_size(8, 8)
fn compute(@builtin(global_invocation_id) k: vec3<u32>) {
  if (any(k.xy >= part.zw)) {
    return;
  }
  let pixel = part.xy + k.xy;
  let at = vec2<f32>(pixel) + 0.5;
  let stored = textureLoad(depths, vec2<i32>(pixel), 0);
  var light: vec4<f32>;
  if (stored > 0.0) {
    light = shown(at, stored);
  } else {
    light = behind(at);
  }
  textureStore(computed, pixel, light);
}
// end: COMPUTED

// A color for the spacing of a patch's lattice, and for diagonal legs.
fn level_colour(step: u32, diagonal: u32) -> vec3<f32> {
  let hue = f32(step) * 0.381966 + f32(diagonal) * 0.08;
  let h = abs(fract(vec3<f32>(hue, hue + 0.3333, hue + 0.6667)) * 6.0 - 3.0) - 1.0;
  return mix(vec3<f32>(1.0), clamp(h, vec3<f32>(0.0), vec3<f32>(1.0)), 0.8) * 2.0;
}

struct Surface { @location(0) depth: f32, @location(1) normal: vec4<f32> };

// Depth along the axis (0: no ground) and the true ground's normal in view space, for screen-space effects.
@fragment
fn surface(@builtin(position) at: vec4<f32>) -> Surface {
  let pixel = vec2<i32>(at.xy);
  if ((textureLoad(marks, pixel, 0).r & 1u) == 0u) {
    return Surface(0.0, vec4<f32>(0.0));
  }
  let hit = hit_at(textureLoad(depths, pixel, 0), ray_of(at.xy));
  let s = slope(hit.place, hit.footprint);
  let g = vec2<f32>(s.x * camera.inverse.x + s.y * camera.inverse.z, s.x * camera.inverse.y + s.y * camera.inverse.w);
  let n = normalize(vec3<f32>(-g * camera.forward.w, 1.0));
  return Surface(hit.depth, vec4<f32>(dot(camera.right.xyz, n), dot(camera.up.xyz, n), dot(camera.forward.xyz, n), 1.0));
}
