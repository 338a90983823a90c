// Small separate meshes that stay on the GPU (surface/batches.py): an instance draws some consecutive triangles.
// include: camera.wgsl
// include: drawn.wgsl

struct Sample { row: i32, col: i32, between: u32, height: f32, coarse: f32 };   // between: as in mesh.wgsl

@group(0) @binding(1) var<storage, read> vertices: array<Sample>;
@group(0) @binding(2) var<storage, read> triangles: array<u32>;    // 3 each
@group(0) @binding(3) var heights: texture_2d_array<f32>;
@group(0) @binding(4) var<storage, read> height_pages: array<u32>;
@group(0) @binding(5) var<uniform> levels: array<FieldLevel, 32>;
// include: field.wgsl
// include: faces.wgsl

struct Run {
  @location(0) span: vec3<u32>,   // its first triangle, their number, the first vertex of the mesh
  @location(1) share: f32,        // how far heights have grown from the coarser ones
};

fn point(corner: u32, run: Run) -> Point {
  let s = vertices[run.span.z + corner];
  let between = vec2<f32>(vec2<u32>(s.between & 0xffffu, s.between >> 16u)) / 65536.0;
  let height = select(s.coarse + run.share * (s.height - s.coarse), s.height, run.share == 1.0);
  return Point(vec2<i32>(s.col, s.row), between, height);
}

// include: runs.wgsl
