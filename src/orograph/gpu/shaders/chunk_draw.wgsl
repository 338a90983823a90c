// Triangles of chunks that were decoded on the GPU (chunk_code.wgsl): an instance draws some consecutive ones.
// include: camera.wgsl
// include: drawn.wgsl

@group(0) @binding(1) var<storage, read> vertices: array<i32>;     // 5 each: row, column, height, target, low
@group(0) @binding(2) var<storage, read> triangles: array<u32>;    // 3 each
@group(0) @binding(3) var heights: texture_2d_array<f32>;
@group(0) @binding(4) var<storage, read> height_pages: array<u32>;
@group(0) @binding(5) var<uniform> levels: array<FieldLevel, 32>;
// include: field.wgsl
// include: faces.wgsl

const HUNG: u32 = 0x80000000u;     // marks a corner as the skirt's lower end
const PARTS: f32 = {{PARTS}}.0;

struct Run {
  @location(0) span: vec3<u32>,   // its first triangle, their number, the first vertex of the chunk
  @location(1) how: vec2<f32>,    // metres of a step, how far vertices have moved from the coarser mesh
};

fn point(corner: u32, run: Run) -> Point {
  let at = 5u * (run.span.z + (corner & ~HUNG));
  let cell = min(vec2<i32>(vertices[at + 1u], vertices[at]), camera.last);   // squeezed
  var height = f32(vertices[at + 2u]) * run.how.x;
  if ((corner & HUNG) != 0u) {
    height = f32(vertices[at + 4u]) * run.how.x;
  } else if (run.how.y < 1.0) {
    let to = f32(vertices[at + 3u]) * (run.how.x / PARTS);
    height = to + run.how.y * (height - to);
  }
  return Point(cell, vec2<f32>(0.0), height);
}

// include: runs.wgsl
