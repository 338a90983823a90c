// Pieces of square patches (surface/pieces.py): all of one shape share its triangles; heights are the atlas's.
// include: camera.wgsl
// include: drawn.wgsl

@group(0) @binding(1) var<storage, read> triangles: array<u32>;    // 3 each: row and column on the lattice, a byte each
@group(0) @binding(2) var heights: texture_2d_array<f32>;
@group(0) @binding(3) var<storage, read> height_pages: array<u32>;
@group(0) @binding(4) var<uniform> levels: array<FieldLevel, 32>;
// include: field.wgsl
// include: faces.wgsl

struct Run {
  @location(0) span: vec2<u32>,    // its first triangle, and how many there are
  @location(1) place: vec3<i32>,   // the patch's upper left sample (row, column); exponents of its side in samples and in
};                                 // points of the lattice, quarters turned clockwise, the level of its tile: a byte each

fn point(corner: u32, run: Run) -> Point {
  let how = vec4<u32>(u32(run.place.z)) >> vec4<u32>(0u, 8u, 16u, 24u) & vec4<u32>(255u);
  let side = i32(1u << how.y);
  let at = vec2<i32>(vec2<u32>(corner, corner >> 8u) & vec2<u32>(255u));   // (row, column)
  var turned = at;
  if (how.z == 1u) {
    turned = vec2<i32>(at.y, side - at.x);
  } else if (how.z == 2u) {
    turned = side - at;
  } else if (how.z == 3u) {
    turned = vec2<i32>(side - at.y, at.x);
  }
  let cell = run.place.xy + ((turned << vec2<u32>(how.x)) >> vec2<u32>(how.y));
  let tile = run.place.xy >> vec2<u32>(how.w + 8u);
  let level = levels[how.w];
  let page = height_pages[level.offset + u32(tile.x) * level.tile_cols + u32(tile.y)];
  var height = MISSING;   // (the frame waits for its tiles: they are there)
  if (page > 0u) {
    height = stored_height(i32(page) - 1, ((cell >> vec2<u32>(how.w)) - tile * 256).yx);
  }
  return Point(min(cell.yx, camera.last), vec2<f32>(0.0), height);   // squeezed
}

// include: runs.wgsl
