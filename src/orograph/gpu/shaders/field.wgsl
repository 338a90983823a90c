// The terrain's own height at any place, whatever mesh is drawn there: nested samples, tiles of all levels in one atlas,
// looked up through pages. The surface between samples is Orograph's usual one: two triangles a cell, cut
// along the diagonal between its (even, even) and its (odd, odd) corner.
// Needs ``heights`` (texture_2d_array), ``height_pages`` (storage) and ``levels`` (uniform, array of 32).
// include: place.wgsl

struct FieldLevel { offset: u32, tile_rows: u32, tile_cols: u32, rows: u32, cols: u32, count: u32, pad0: u32, pad1: u32 };
const HEIGHT_SIDE: i32 = 257;
const HEIGHTS_PER_SIDE: i32 = 4;
const MISSING: f32 = {{MISSING}}.0;  // added to missing heights

// A sample of the tile in a slot, as it is stored.
fn stored_height(slot: i32, at: vec2<i32>) -> f32 {
  let place = slot % (HEIGHTS_PER_SIDE * HEIGHTS_PER_SIDE);
  let origin = vec2<i32>(place % HEIGHTS_PER_SIDE, place / HEIGHTS_PER_SIDE) * HEIGHT_SIDE;
  return textureLoad(heights, origin + at, slot / (HEIGHTS_PER_SIDE * HEIGHTS_PER_SIDE), 0).r;
}

fn load_height(slot: i32, at: vec2<i32>) -> f32 {
  let height = stored_height(slot, at);
  return select(height, height - MISSING, height >= 0.5 * MISSING);
}

// Height of the surface at a place within the raster, from the finest level present.
fn field_height(at: Place) -> f32 {
  for (var level = 0u; level < levels[0].count; level++) {
    let l = levels[level];
    let cell = at.whole >> vec2<u32>(level);
    let tile = min(cell >> vec2<u32>(8u), vec2<i32>(i32(l.tile_cols), i32(l.tile_rows)) - 1);
    let page = height_pages[l.offset + u32(tile.y) * l.tile_cols + u32(tile.x)];
    if (page == 0u) {
      continue;
    }
    let f = (vec2<f32>(at.whole - (cell << vec2<u32>(level))) + at.part) / f32(1u << level);
    let slot = i32(page) - 1;
    let here = min(cell - tile * 256, vec2<i32>(HEIGHT_SIDE - 1));
    let next = min(here + 1, vec2<i32>(HEIGHT_SIDE - 1));
    let a = load_height(slot, here);
    let b = load_height(slot, vec2<i32>(next.x, here.y));
    let c = load_height(slot, vec2<i32>(here.x, next.y));
    let d = load_height(slot, next);
    if (((cell.x + cell.y) & 1) == 0) {   // from a to d
      return a + select(f.x * (d - c) + f.y * (c - a), f.x * (b - a) + f.y * (d - b), f.x >= f.y);
    }
    let far = f.x + f.y > 1.0;   // from b to c
    return select(a + f.x * (b - a) + f.y * (c - a), d + (1.0 - f.x) * (c - d) + (1.0 - f.y) * (b - d), far);
  }
  return 0.0;
}
