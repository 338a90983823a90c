// Heights of chunks' vertices, predicted from the ends of the edge that they split (chunk_code.wgsl).

fn guess(a: i32, b: i32) -> i32 {
  if (a == MISSING) {
    return select(b, 0, b == MISSING);
  }
  return select((a + b) >> 1u, a, b == MISSING);
}

// The height of the line between two ends, one of which is beyond the raster and so lies on its last sample.
fn along(a: i32, b: i32, left: i32, right: i32, own: i32, last: i32) -> i32 {
  let low = min(a, b);
  let under = select(right, left, a < b);
  let over = select(left, right, a < b);
  var whole = min(max(a, b), last) - min(low, last);
  var done = min((a + b) >> 1u, last) - min(low, last);
  if (whole == 0) {
    return own;
  }
  while (whole > 32768) {
    whole >>= 1u;
    done >>= 1u;
  }
  let size = abs(over - under);
  let part = size / whole * done + size % whole * done / whole;
  return under + select(part, -part, over < under);
}

fn halfway(a: vec2<i32>, b: vec2<i32>, left: i32, right: i32, own: i32) -> i32 {
  if (left == MISSING || right == MISSING) {
    return own;
  }
  if (all(max(a, b) <= edge)) {
    return (left + right) >> 1u;
  }
  if (a.x == b.x) {
    return along(a.y, b.y, left, right, own, edge.y);
  }
  if (a.y == b.y) {
    return along(a.x, b.x, left, right, own, edge.x);
  }
  return own;
}
