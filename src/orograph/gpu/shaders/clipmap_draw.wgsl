// The rings of a clipmap (surface/clipmap.py): an instance draws a block of a ring's cells, whose heights lie in toroidal
// textures, one layer per level (Asirvatham & Hoppe 2005). Triangles and transitions are those of lod/clipmap_mesh.py.
// include: camera.wgsl
// include: drawn.wgsl

struct Ring {            // in samples of its level: (row, row, column, column)
  window: vec4<i32>,     // first and last row and column
  hole: vec4<i32>,       // the same for the next finer window; last before first: none
  blend: vec4<f32>,      // where the transition to the coarser ring begins, from the window's first row and column
  width: f32,            // width of the transition, samples
  level: u32,
  open: u32,             // sides beyond which there is a coarser ring: 1 north, 2 south, 4 west, 8 east
  pad: u32,
};

@group(0) @binding(1) var ring_heights: texture_2d_array<f32>;
@group(0) @binding(2) var<uniform> rings: array<Ring, 32>;
@group(0) @binding(3) var heights: texture_2d_array<f32>;
@group(0) @binding(4) var<storage, read> height_pages: array<u32>;
@group(0) @binding(5) var<uniform> levels: array<FieldLevel, 32>;
// include: field.wgsl
// include: faces.wgsl

const BLOCK: i32 = {{BLOCK}};   // cells along a side

// A triangle's corners (row, column) from its cell's first one; ``there`` is false if it is part of a neighbour's.
struct Corners { there: bool, a: vec2<i32>, b: vec2<i32>, c: vec2<i32> };

fn stored(ring: Ring, at: vec2<i32>) -> f32 {
  let side = i32(textureDimensions(ring_heights).x);
  return textureLoad(ring_heights, at.yx % side, i32(ring.level), 0).r;
}

// Height of a sample, during its transition to the triangles of the coarser level.
fn ring_height(ring: Ring, at: vec2<i32>) -> f32 {
  let own = stored(ring, at);
  let odd = at & vec2<i32>(1);
  let from_first = vec2<f32>(at - ring.window.xz);
  let beyond = max(ring.blend.xz - from_first, from_first - ring.blend.yw);
  let share = clamp(max(beyond.x, beyond.y) / ring.width, 0.0, 1.0);
  let shared_with_finer = all(at >= ring.hole.xz) && all(at <= ring.hole.yw);
  let at_border = any(((at + 1) << vec2<u32>(ring.level)) > camera.last.yx);
  if (share == 0.0 || shared_with_finer || at_border || all(odd == vec2<i32>(0))) {
    return own;
  }
  var along = odd;   // towards the ends of the coarser triangles' side, or of their cell's diagonal
  if (all(odd == vec2<i32>(1)) && (((at.x >> 1u) + (at.y >> 1u)) & 1) == 1) {
    along = vec2<i32>(1, -1);
  }
  return mix(own, 0.5 * (stored(ring, at - along) + stored(ring, at + along)), share);
}

fn point(ring: Ring, at: vec2<i32>) -> Point {
  let whole = min(at << vec2<u32>(ring.level), camera.last.yx);   // squeezed onto the last row and column
  return Point(whole.yx, vec2<f32>(0.0), ring_height(ring, at));
}

// The first or second triangle of a cell. Beside a coarser ring, the two on either side of an odd sample merge into one.
fn corners_of(ring: Ring, cell: vec2<i32>, second: bool) -> Corners {
  let falls = ((cell.x + cell.y) & 1) == 0;   // its diagonal, from upper left to lower right
  let even = (cell.y & 1) == 0;
  let north = (ring.open & 1u) != 0u && cell.x == ring.window.x;
  let south = (ring.open & 2u) != 0u && cell.x == ring.window.y - 1;
  let west = (ring.open & 4u) != 0u && cell.y == ring.window.z;
  let east = (ring.open & 8u) != 0u && cell.y == ring.window.w - 1;
  if (second) {
    if (south) {
      return Corners(even, vec2<i32>(0, 1), vec2<i32>(1, 2), vec2<i32>(1, 0));
    }
    if (west && falls) {
      return Corners(true, vec2<i32>(1, 1), vec2<i32>(2, 0), vec2<i32>(0, 0));
    }
    if (east && !falls) {
      return Corners(true, vec2<i32>(1, 0), vec2<i32>(0, 1), vec2<i32>(2, 1));
    }
    if (falls) {
      return Corners(true, vec2<i32>(1, 0), vec2<i32>(0, 0), vec2<i32>(1, 1));
    }
    return Corners(true, vec2<i32>(1, 1), vec2<i32>(1, 0), vec2<i32>(0, 1));
  }
  if (north) {
    return Corners(even, vec2<i32>(1, 1), vec2<i32>(0, 0), vec2<i32>(0, 2));
  }
  if (falls) {
    return Corners(!east, vec2<i32>(0, 1), vec2<i32>(1, 1), vec2<i32>(0, 0));
  }
  return Corners(!west, vec2<i32>(0, 0), vec2<i32>(0, 1), vec2<i32>(1, 0));
}

fn drawn(ring: Ring, cell: vec2<i32>) -> bool {
  let inside = all(cell >= ring.window.xz) && all(cell < ring.window.yw);
  let finer = all(cell >= ring.hole.xz) && all(cell < ring.hole.yw);
  return inside && !finer && all((cell << vec2<u32>(ring.level)) < camera.last.yx);
}

@vertex
fn vertex(@builtin(vertex_index) k: u32, @location(0) block: vec3<i32>) -> Vertex {   // its row and column, its ring
  let ring = rings[block.z];
  let which = i32(k / 6u);
  let cell = block.xy * BLOCK + vec2<i32>(which / BLOCK, which % BLOCK);
  let corners = corners_of(ring, cell, k % 6u >= 3u);
  if (!corners.there || !drawn(ring, cell)) {
    var nothing: Vertex;   // a degenerate triangle
    return nothing;
  }
  return face(
    k % 3u, point(ring, cell + corners.a), point(ring, cell + corners.b), point(ring, cell + corners.c));
}
