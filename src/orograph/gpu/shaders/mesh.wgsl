// A mesh that a method made. Most vertices are samples of the raster, like those of the patches, and so equal to the bit
// where meshes and patches share them; others lie between, in 65536ths. Corners are pulled by number, so that each triangle knows all three.
// include: camera.wgsl
// include: drawn.wgsl

struct Sample { row: i32, col: i32, height: f32, between: u32 };   // between: of the column (low 16 bits), of the row

@group(0) @binding(1) var<storage, read> samples: array<Sample>;
@group(0) @binding(2) var<storage, read> corners: array<u32>;
@group(0) @binding(3) var heights: texture_2d_array<f32>;
@group(0) @binding(4) var<storage, read> height_pages: array<u32>;
@group(0) @binding(5) var<uniform> levels: array<FieldLevel, 32>;
// include: field.wgsl
// include: faces.wgsl

fn point(s: Sample) -> Point {
  let between = vec2<f32>(vec2<u32>(s.between & 0xffffu, s.between >> 16u)) / 65536.0;
  return Point(vec2<i32>(s.col, s.row), between, s.height);
}

@vertex
fn vertex(@builtin(vertex_index) k: u32) -> Vertex {
  let first = k - k % 3u;
  return face(
    k % 3u, point(samples[corners[first]]), point(samples[corners[first + 1u]]), point(samples[corners[first + 2u]]));
}
