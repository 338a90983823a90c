// Patches of regularly bisected right triangles: vertices are cells of the raster, heights are pulled from the atlas.
// One instance per patch; all patches share one index buffer.
// include: camera.wgsl
// include: drawn.wgsl

@group(1) @binding(0) var heights: texture_2d_array<f32>;
@group(1) @binding(1) var slopes: texture_2d_array<f32>;
@group(1) @binding(2) var<storage, read> pages: array<u32>;
@group(1) @binding(3) var<uniform> levels: array<Level, LEVELS>;
// include: slopes.wgsl

const EDGES: u32 = {{EDGES}}u;   // 1: mark how much of a pixel the edges of triangles cover
const STORED: u32 = {{STORED}}u; // 1: slopes come from the vertices, else from derivatives or, with SAMPLED, from heights
const SIDE: i32 = 257;      // samples along a tile's side
const MISSING: f32 = {{MISSING}}.0;  // added to missing heights

struct Instance {
  @location(1) apex: vec2<i32>,      // row, col on the padded grid
  @location(2) kind: u32,            // orientation, exponent of the lattice step, level of its tile, flags: a byte each
  @location(3) tile: u32,            // tile row and column, 16 bits each
  @location(4) morph: f32,
  @location(5) slot: i32,
};

struct Vertex {
  @builtin(position) position: vec4<f32>,
  @location(0) gone: f32,                         // 0 where all corners of the triangle have ground
  @location(1) lattice: vec2<f32>,                // (i, j) along the legs: edges of triangles lie on whole numbers
  @location(2) @interpolate(flat) what: u32,
  @location(3) place: vec3<f32>,                  // relative to the eye, metres, height not stretched
  @location(4) slope: vec2<f32>,                  // of the ground at the vertex, metres per metre
  // when: SAMPLED
  @location(5) texel: vec2<f32>,                  // column and row in its tile, of so coarse a level, in a slot
  @location(6) @interpolate(flat) tile: vec2<i32>,
  // end: SAMPLED
};

// By the direction of the apex (``lod/patches/shape.py``): e1 and e2 as (row, col).
const STEPS = array<vec4<i32>, 8>(
  vec4<i32>(1, 1, -1, 1), vec4<i32>(1, 0, 0, 1), vec4<i32>(1, -1, 1, 1), vec4<i32>(0, -1, 1, 0),
  vec4<i32>(-1, -1, 1, -1), vec4<i32>(-1, 0, 0, -1), vec4<i32>(-1, 1, -1, -1), vec4<i32>(0, 1, -1, 0),
);

struct Corner {
  position: vec3<f32>,   // relative to the eye, metres, height not yet stretched: as stored
  there: bool,
};

fn corner(at: vec2<i32>, level: u32, tile: vec2<i32>, slot: i32) -> Corner {
  let inside = min(at, camera.last.yx);                                  // squeezed onto the last row and column
  let local = (at >> vec2<u32>(level)) - tile * 256;
  let place = slot % (PER_SIDE * PER_SIDE);
  let origin = vec2<i32>(place % PER_SIDE, place / PER_SIDE) * SIDE;
  let height = textureLoad(heights, origin + clamp(local.yx, vec2<i32>(0), vec2<i32>(SIDE - 1)), slot / (PER_SIDE * PER_SIDE), 0).r;
  let cell = vec2<f32>(inside.yx - camera.eye_cell);
  let there = height < 0.5 * MISSING;
  return Corner(vec3<f32>(from_eye(cell), select(height - MISSING, height, there)), there);
}

@vertex
fn vertex(@location(0) lattice: vec2<u32>, instance: Instance) -> Vertex {
  let e = instance.kind & 7u;
  let s = (instance.kind >> 8u) & 255u;
  let level = (instance.kind >> 16u) & 255u;
  let tile = vec2<i32>(i32(instance.tile & 0xffffu), i32(instance.tile >> 16u));
  let e1 = STEPS[e].xy << vec2<u32>(s);
  let e2 = STEPS[e].zw << vec2<u32>(s);
  let ij = vec2<i32>(lattice);
  let at = instance.apex + ij.x * e1 + ij.y * e2;
  var here = corner(at, level, tile, instance.slot);
  if (((ij.x + ij.y) & 1) == 1 && instance.morph < 1.0) {
    let along = select(e2, e1, (ij.x & 1) == 1);
    let a = corner(at - along, level, tile, instance.slot);
    let b = corner(at + along, level, tile, instance.slot);
    let inside = all(max(at - along, at + along) <= camera.last.yx);
    if (a.there && b.there && inside) {
      here.position.z = mix(0.5 * (a.position.z + b.position.z), here.position.z, instance.morph);
    }
  }
  var out: Vertex;
  let above = above_eye(here.position.z);
  out.position = to_clip(vec3<f32>(here.position.xy, above));
  out.place = vec3<f32>(here.position.xy, above / camera.forward.w);
  if (STORED == 1u) {
    let stored = slope(Place(min(at, camera.last.yx).yx, vec2<f32>(0.0)), f32(1u << s));
    out.slope = vec2<f32>(dot(stored, camera.inverse.xz), dot(stored, camera.inverse.yw));
  }
  // when: SAMPLED
  out.texel = vec2<f32>((min(at, camera.last.yx) - tile * (256 << level)).yx) / f32(1u << level);
  out.tile = vec2<i32>(i32(level), instance.slot);
  // end: SAMPLED
  out.gone = select(1.0, 0.0, here.there);
  out.lattice = vec2<f32>(lattice);
  out.what = (s << 8u) | (e << 4u) | 1u;
  return out;
}

// The marks of a pixel of ground: bit 0 ground, bits 4–6 orientation, 8–15 exponent of the lattice step, 16–23 how much of
// the pixel an edge of a triangle covers.
fn marked(in: Vertex) -> u32 {
  // Seen edge on, a triangle's depth is extrapolated beyond its corners by some rasterisers: such slivers, at most a
  // quarter of a pixel wide, are left to their neighbours.
  let sliver = camera.plan == 0u && fwidth(in.position.z) > 4.0 * in.position.z;
  if (in.gone > 1e-4 || sliver) {   // (zeros stay zero, however roughly hardware interpolates in a sliver)
    discard;
  }
  if (EDGES == 0u) {
    return in.what;
  }
  return in.what | (edges(in.lattice) << 16u);
}

@fragment
fn fragment(in: Vertex) -> @location(0) u32 {
  return marked(in);
}

// when: SAMPLED
// A height between samples, interpolated as a texture unit does it: with weights of 8 bits.
fn blended_height(slot: i32, at: vec2<f32>) -> f32 {
  let p = round(at * 256.0) / 256.0;
  let base = clamp(vec2<i32>(floor(p)), vec2<i32>(0), vec2<i32>(SIDE - 2));
  let f = p - vec2<f32>(base);
  let place = slot % (PER_SIDE * PER_SIDE);
  let origin = vec2<i32>(place % PER_SIDE, place / PER_SIDE) * SIDE + base;
  let layer = slot / (PER_SIDE * PER_SIDE);
  let h = vec4<f32>(
    textureLoad(heights, origin, layer, 0).r, textureLoad(heights, origin + vec2<i32>(1, 0), layer, 0).r,
    textureLoad(heights, origin + vec2<i32>(0, 1), layer, 0).r, textureLoad(heights, origin + vec2<i32>(1, 1), layer, 0).r);
  let z = select(h, h - MISSING, h >= vec4<f32>(0.5 * MISSING));
  return mix(mix(z.x, z.y, f.x), mix(z.z, z.w, f.x), f.y);
}

// The slope, metres per metre, from heights half a pixel to every side: J g = Δh; the rows of J are a pixel's step
// right and down, in distance on the tile. (A step is cut where the tile ends, and J's row with it.)
fn sampled_slope(tile: vec2<i32>, at: vec2<f32>, right: vec2<f32>, down: vec2<f32>) -> vec2<f32> {
  let most = vec2<f32>(f32(SIDE - 1));
  let a = clamp(at - 0.5 * right, vec2<f32>(0.0), most);
  let b = clamp(at + 0.5 * right, vec2<f32>(0.0), most);
  let c = clamp(at - 0.5 * down, vec2<f32>(0.0), most);
  let d = clamp(at + 0.5 * down, vec2<f32>(0.0), most);
  let u = b - a;
  let v = d - c;
  let rise = vec2<f32>(blended_height(tile.y, b) - blended_height(tile.y, a), blended_height(tile.y, d) - blended_height(tile.y, c));
  let area = u.x * v.y - u.y * v.x;
  let per_sample = vec2<f32>(rise.x * v.y - rise.y * u.y, rise.y * u.x - rise.x * v.x) / select(area, 1e-20, abs(area) < 1e-20);
  let g = per_sample / f32(1u << u32(tile.x));
  return vec2<f32>(dot(g, camera.inverse.xz), dot(g, camera.inverse.yw));
}
// end: SAMPLED

// The same, and a slope: that of the vertices, interpolated, which ignores the ground between; or from
// the derivatives of the position on the screen, which is that of the flat triangle; or from heights half a pixel away.
@fragment
fn with_slope(in: Vertex) -> WithSlope {
  let normal = cross(dpdx(in.place), dpdy(in.place));
  // when: SAMPLED
  let right = dpdx(in.texel);
  let down = dpdy(in.texel);
  // end: SAMPLED
  let marks = marked(in);
  if (STORED == 1u) {
    return WithSlope(marks, in.slope);
  }
  // when: SAMPLED
  return WithSlope(marks, sampled_slope(in.tile, in.texel, right, down));
  // end: SAMPLED
  return WithSlope(marks, -normal.xy / select(normal.z, 1e-20, abs(normal.z) < 1e-20));
}

// Coverage (0–255) of the pixel by the triangles' edges, a pixel wide.
fn edges(at: vec2<f32>) -> u32 {
  let width = max(fwidth(at), vec2<f32>(1e-6));
  let straight = abs(fract(at - 0.5) - 0.5) / width;
  // Each cell is cut from its (even, even) or (odd, odd) corner: lines i ± j = even.
  let sum = (at.x + at.y) * 0.5;
  let difference = (at.x - at.y) * 0.5;
  let slant = abs(fract(vec2<f32>(sum, difference) - 0.5) - 0.5) / max(fwidth(vec2<f32>(sum, difference)), vec2<f32>(1e-6));
  let nearest = min(min(straight.x, straight.y), min(slant.x, slant.y));
  let room = 0.7 / max(width.x, width.y);   // pixels over a triangle's longest side
  return u32(255.0 * edge_strength(room) * clamp(1.0 - nearest, 0.0, 1.0));
}
