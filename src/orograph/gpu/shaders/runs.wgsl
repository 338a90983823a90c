// The vertices of runs of triangles: an instance draws those of its Run, whose corners point() reads.

@vertex
fn vertex(@builtin(vertex_index) k: u32, run: Run) -> Vertex {
  let which = k / 3u;
  if (which >= run.span.y) {
    var nothing: Vertex;   // all three in one place
    return nothing;
  }
  let at = 3u * (run.span.x + which);
  return face(k % 3u, point(triangles[at], run), point(triangles[at + 1u], run), point(triangles[at + 2u], run));
}
