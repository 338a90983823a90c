// The ground by rays, tile by tile, front to back (Dick, Krüger & Westermann 2009, §4): the back faces of a tile's box
// cover the pixels whose rays can meet it. A fragment casts its ray within the box only, and not at all if a nearer hit
// is known. Follows window_rays.wgsl in the same module.

struct Tile {
  first: vec2<i32>, last: vec2<i32>,   // (column, row) of the raster where it begins and ends
  low: f32, high: f32,                 // metres between which its heights lie
  window: i32, pad: i32,
};

@group(1) @binding(2) var<storage, read> tiles: array<Tile>;
@group(1) @binding(3) var<storage, read_write> nearest: array<atomic<u32>>;   // by pixel: the bits of the nearest hit's t

struct Corner { @builtin(position) place: vec4<f32>, @location(0) @interpolate(flat) tile: u32 };
struct Pixel { @builtin(frag_depth) depth: f32, @location(0) marks: u32 };

// Corners of a box's faces, two triangles each: bit 0 east, 1 south, 2 up. Back faces are counter-clockwise on the screen,
// if rows run south and columns east.
const FACES = array<u32, 36>(
  0, 2, 1, 1, 2, 3,  4, 5, 6, 5, 7, 6,  0, 1, 4, 1, 5, 4,  2, 6, 3, 3, 6, 7,  0, 4, 2, 2, 4, 6,  1, 3, 5, 3, 7, 5,
);

@vertex
fn vertex(@builtin(vertex_index) k: u32, @builtin(instance_index) i: u32) -> Corner {
  var faces = FACES;
  let bits = (vec3<u32>(faces[k]) >> vec3<u32>(0u, 1u, 2u)) & vec3<u32>(1u);
  let tile = tiles[i];
  let at = select(tile.first, tile.last, bits.xy == vec2<u32>(1u)) - camera.eye_cell;
  let height = select(tile.low - 0.01, tile.high + 0.01, bits.z == 1u);
  return Corner(to_clip(vec3<f32>(from_eye(vec2<f32>(at)), above_eye(height))), i);
}

// The part of [near, ∞) of a ray within a box, and the side of the surface on which it enters (0: through a wall).
struct Part { begin: f32, end: f32, side: i32 };

fn within_box(tile: Tile, way: Way) -> Part {
  let a = (vec2<f32>(tile.first - camera.eye_cell) - way.o.xy) * way.inverse;
  let b = (vec2<f32>(tile.last - camera.eye_cell) - way.o.xy) * way.inverse;
  let low = select(min(a, b), vec2<f32>(-NEVER), way.still);
  let high = select(max(a, b), vec2<f32>(NEVER), way.still);
  var part = Part(max(camera.near, max(low.x, low.y)), min(high.x, high.y), 0);
  if (way.v.z != 0.0) {
    let down = (above(tile.low) - 1e-3 - 1e-5 * abs(above(tile.low)) - way.o.z) / way.v.z;
    let up = (above(tile.high) + 1e-3 + 1e-5 * abs(above(tile.high)) - way.o.z) / way.v.z;
    if (min(down, up) > part.begin) {
      part.begin = min(down, up);
      part.side = select(-1, 1, way.v.z < 0.0);
    }
    part.end = min(part.end, max(down, up));
  }
  return part;
}

@fragment
fn fragment(@builtin(position) at: vec4<f32>, @location(0) @interpolate(flat) i: u32) -> Pixel {
  let way = way_of(at.xy);
  let tile = tiles[i];
  let part = within_box(tile, way);
  let pixel = u32(at.y) * u32(camera.size.x) + u32(at.x);
  let known = bitcast<f32>(atomicLoad(&nearest[pixel]));
  if (part.begin > part.end || part.begin >= known) {
    discard;
  }
  let hit = cast_at(tile.window, way, part.begin, part.end, part.side);
  if (hit.t >= known) {
    discard;
  }
  atomicMin(&nearest[pixel], bitcast<u32>(hit.t));
  return Pixel(camera.near / hit.t, (stack.windows[hit.window].level << 8u) | 5u);
}
