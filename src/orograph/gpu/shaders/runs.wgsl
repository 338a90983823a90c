// The vertices of runs of triangles: an instance draws those of its Run, whose corners point() reads.

@vertex
fn vertex(@builtin(vertex_index) k: u32, run: Run) -> Vertex {
  let which = k / 3u;
  if (which >= run.span.y) {
    var nothing: Vertex;   // a degenerate triangle
    return nothing;
  }
  let at = 3u * (run.span.x + which);
  let a = point(triangles[at], run);
  let b = point(triangles[at + 1u], run);
  let c = point(triangles[at + 2u], run);
  // when: HOLES
  let upright = (a.whole == b.whole) & (a.whole == c.whole);   // in one row or column: squeezed onto the raster's last
  if (max(max(a.height, b.height), c.height) >= 0.5 * MISSING || any(upright)) {
    var nothing: Vertex;   // (a corner that is too high has no ground)
    return nothing;
  }
  // end: HOLES
  return face(k % 3u, a, b, c);
}
