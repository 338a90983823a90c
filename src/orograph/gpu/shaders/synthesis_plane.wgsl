// An exemplar's plane: the exemplar beside its mirror images, (2 rows, 2 cols), repeated. See synthesis/kernels.py.
// Needs ``run``: the constants of a step.

struct Run {
  top: i32, left: i32, height: i32, width: i32,        // the window to make
  row0: i32, col0: i32, from_width: i32, rows: i32,    // the coarser window it is made from; the exemplar
  cols: i32, step: i32, reach: i32, seed: i32,
  kappa: i32, even_row: i32, even_col: i32, inset: i32,
  doublings: i32, shift: i32, own_row0: i32, own_col0: i32,   // what is spread between samples of a coarser lattice
  own_rows: i32, own_cols: i32,
}

fn wrapped(x: i32, size: i32) -> i32 {
  let r = x % (2 * size);
  return select(r, r + 2 * size, r < 0);
}

fn folded(x: i32, size: i32) -> i32 {
  let r = wrapped(x, size);
  return select(2 * size - 1 - r, r, r < size);
}

// The index of a coordinate in a table of the exemplar.
fn placed(at: vec2<i32>) -> i32 {
  return folded(at.y, run.rows) * run.cols + folded(at.x, run.cols);
}

// The bits of synthesis/reference.py.
fn hashed(x: i32, y: i32, seed: i32) -> u32 {
  var h = bitcast<u32>(x) * 0x9E3779B1u + bitcast<u32>(y) * 0x85EBCA77u + bitcast<u32>(seed) * 0xC2B2AE3Du;
  h = (h ^ (h >> 16u)) * 0x21F0AAADu;
  h = (h ^ (h >> 15u)) * 0x735A2D97u;
  return h ^ (h >> 15u);
}
