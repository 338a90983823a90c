// Slopes of the ground at any scale: gradients of box means, tiles of all levels in one atlas, looked up through pages.
// Needs ``slopes`` (texture_2d_array), ``pages`` (storage) and ``levels`` (uniform).
// include: place.wgsl

struct Level { offset: u32, tile_rows: u32, tile_cols: u32, rows: u32, cols: u32, count: u32, pad0: u32, pad1: u32 };
const LEVELS = 32u;   // of which levels[0].count exist
const SLOPE_SIDE: i32 = 258;
const PER_SIDE: i32 = 4;

// Position in blocks of 2^level samples: the block before it, and the fraction towards the next.
fn in_blocks(at: Place, level: u32) -> Place {
  let scale = f32(1u << level);
  let base = at.whole >> vec2<u32>(level);
  let rest = vec2<f32>(at.whole - (base << vec2<u32>(level)));
  let u = (rest + at.part + 0.5) / scale - 0.5;
  let down = floor(u);
  return Place(base + vec2<i32>(down), u - down);
}

fn load_slope(slot: i32, at: vec2<i32>) -> vec2<f32> {
  let place = slot % (PER_SIDE * PER_SIDE);
  let origin = vec2<i32>(place % PER_SIDE, place / PER_SIDE) * SLOPE_SIDE;
  return textureLoad(slopes, origin + at, slot / (PER_SIDE * PER_SIDE), 0).rg;
}

// Slope (per sample, along columns and rows) of a level's means; xy and 1, or 0 if the tile is absent.
fn slope_of(at: Place, level: u32) -> vec3<f32> {
  let l = levels[level];
  var p = in_blocks(at, level);
  let most = vec2<i32>(max(i32(l.cols) - 2, 0), max(i32(l.rows) - 2, 0));
  let clamped = clamp(p.whole, vec2<i32>(0), most);
  let f = clamp(p.part + vec2<f32>(p.whole - clamped), vec2<f32>(0.0), vec2<f32>(1.0));
  let tile = min(clamped >> vec2<u32>(8u), vec2<i32>(i32(l.tile_cols), i32(l.tile_rows)) - 1);
  let page = pages[l.offset + u32(tile.y) * l.tile_cols + u32(tile.x)];
  if (page == 0u) {
    return vec3<f32>(0.0);
  }
  let slot = i32(page) - 1;
  let local = clamped - tile * 256 + 1;
  let a = mix(load_slope(slot, local), load_slope(slot, local + vec2<i32>(1, 0)), f.x);
  let b = mix(load_slope(slot, local + vec2<i32>(0, 1)), load_slope(slot, local + vec2<i32>(1, 1)), f.x);
  return vec3<f32>(mix(a, b, f.y), 1.0);
}

// The slope of the finest level present, from ``wanted`` on.
fn resident_slope(at: Place, wanted: u32) -> vec2<f32> {
  for (var level = min(wanted, levels[0].count - 1u); level < levels[0].count; level++) {
    let found = slope_of(at, level);
    if (found.z > 0.0) {
      return found.xy;
    }
  }
  return vec2<f32>(0.0);
}

// Mean slope over a footprint of so many samples, trilinear.
fn slope(at: Place, footprint: f32) -> vec2<f32> {
  let level = log2(max(footprint, 1.0));
  let whole = floor(level);
  let part = level - whole;
  let fine = resident_slope(at, u32(whole));
  if (part < 1e-3) {
    return fine;
  }
  return mix(fine, resident_slope(at, u32(whole) + 1u), part);
}
