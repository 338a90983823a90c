// The triangles of a concurrent binary tree: thread 3 i + k of the draw handles corner k of the i-th one, read from the pool.
// include: camera.wgsl
// include: drawn.wgsl
// include: cbt_node.wgsl

@group(0) @binding(1) var<storage, read> nodes: array<Node>;
@group(0) @binding(2) var<storage, read> list: array<u32>;
@group(0) @binding(3) var<storage, read> state: array<u32>;
@group(0) @binding(4) var heights: texture_2d_array<f32>;
@group(0) @binding(5) var<storage, read> height_pages: array<u32>;
@group(0) @binding(6) var<uniform> levels: array<FieldLevel, 32>;
// include: field.wgsl
// include: faces.wgsl

const N: u32 = {{N}}u;   // the square has 2^N cells a side

fn point(node: Node, direction: u32, height: f32) -> Point {
  return Point(min(corner_of(node, N, direction), camera.last), vec2<f32>(0.0), height);   // squeezed
}

@vertex
fn vertex(@builtin(vertex_index) k: u32) -> Vertex {
  let slot = list[k / 3u];
  if ((state[slot] & SHOWN) == 0u) {
    var nothing: Vertex;   // a degenerate triangle
    return nothing;
  }
  let node = nodes[slot];
  return face(
    k % 3u, point(node, 2u, node.heights.x), point(node, 6u, node.heights.y), point(node, 4u, node.heights.z));
}
