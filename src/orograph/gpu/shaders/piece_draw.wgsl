// Pieces of square patches (surface/pieces.py): all of one shape share its triangles, and each has heights of its own.
// include: camera.wgsl
// include: drawn.wgsl

@group(0) @binding(1) var<storage, read> vertices: array<f32>;     // heights; missing ones are MISSING
@group(0) @binding(2) var<storage, read> triangles: array<u32>;    // 3 each: number (low 16 bits), row, column on the lattice
@group(0) @binding(3) var heights: texture_2d_array<f32>;
@group(0) @binding(4) var<storage, read> height_pages: array<u32>;
@group(0) @binding(5) var<uniform> levels: array<FieldLevel, 32>;
// include: field.wgsl
// include: faces.wgsl

struct Run {
  @location(0) span: vec3<u32>,    // its first triangle, their number, the piece's first height
  @location(1) place: vec3<i32>,   // the patch's upper left sample (row, column); exponents of its side in samples and in
};                                 // points of the lattice, and quarter turns clockwise, a byte each

fn point(corner: u32, run: Run) -> Point {
  let how = vec3<u32>(u32(run.place.z)) >> vec3<u32>(0u, 8u, 16u) & vec3<u32>(255u);
  let side = i32(1u << how.y);
  let at = vec2<i32>(vec2<u32>(corner >> 16u, corner >> 24u) & vec2<u32>(255u));   // (row, column)
  var turned = at;
  if (how.z == 1u) {
    turned = vec2<i32>(at.y, side - at.x);
  } else if (how.z == 2u) {
    turned = side - at;
  } else if (how.z == 3u) {
    turned = vec2<i32>(side - at.y, at.x);
  }
  let cell = run.place.xy + ((turned << vec2<u32>(how.x)) >> vec2<u32>(how.y));
  return Point(min(cell.yx, camera.last), vec2<f32>(0.0), vertices[run.span.z + (corner & 0xffffu)]);   // squeezed
}

// include: runs.wgsl
