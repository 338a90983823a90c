// A doubling of detail beyond the data: the 4-point rule, and what is added to the new samples (Losasso & Hoppe 2004, and by example).
// In integers, like synthesis/refining.py and synthesis/steered.py: all make the same heights.
// include: synthesis_plane.wgsl

@group(0) @binding(0) var<uniform> run: Run;
@group(0) @binding(1) var<storage, read> coarse: array<i32>;
@group(0) @binding(2) var<storage, read> scale: array<i32>;          // of the noise, or of the exemplar's residuals
@group(0) @binding(3) var<storage, read_write> heights: array<i32>;
// when: STEERED
@group(0) @binding(4) var<storage, read> chosen: array<vec2<i32>>;
@group(0) @binding(5) var<storage, read> fine: array<i32>;
// end: STEERED

const MISSING: i32 = -2147483647 - 1;

// The sample between b and c, with a and d beyond them; linear beside a missing one.
fn middle(a: i32, b: i32, c: i32, d: i32) -> i32 {
  if (b == MISSING || c == MISSING) {
    return MISSING;
  }
  let near = b + c;
  let far = select(a, 2 * b - c, a == MISSING) + select(d, 2 * c - b, d == MISSING);
  return (near >> 1u) + ((8 * (near & 1) + near - far + 8) >> 4u);
}

fn sample(r: i32, c: i32) -> i32 {
  return coarse[(r - run.row0) * run.from_width + c - run.col0];
}

fn along(r: i32, c: i32) -> i32 {
  let p = c >> 1u;
  if ((c & 1) == 0) {
    return sample(r, p);
  }
  return middle(sample(r, p - 1), sample(r, p), sample(r, p + 1), sample(r, p + 2));
}

fn doubled(r: i32, c: i32) -> i32 {
  let p = r >> 1u;
  if ((r & 1) == 0) {
    return along(p, c);
  }
  return middle(along(p - 1, c), along(p, c), along(p + 1, c), along(p + 2, c));
}

// A scale interpolated between those of the coarser lattice's samples, first along rows, then along columns.
fn spread(r: i32, c: i32) -> i32 {
  let n = u32(run.doublings);
  let whole = 1 << n;
  let half = whole >> 1u;
  let row = (r >> n) - run.own_row0;
  let col = (c >> n) - run.own_col0;
  let below = min(row + 1, run.own_rows - 1);
  let right = min(col + 1, run.own_cols - 1);
  let t = r & (whole - 1);
  let s = c & (whole - 1);
  let a = (scale[row * run.own_cols + col] * (whole - t) + scale[below * run.own_cols + col] * t + half) >> n;
  let b = (scale[row * run.own_cols + right] * (whole - t) + scale[below * run.own_cols + right] * t + half) >> n;
  return (a * (whole - s) + b * s + half) >> n;
}

// when: FRACTAL
// The sum of four bytes of a hash: nearly a normal distribution.
fn residual(here: i32, r: i32, c: i32) -> i32 {
  let h = hashed(c, r, run.seed);
  let noise = i32((h & 255u) + ((h >> 8u) & 255u) + ((h >> 16u) & 255u) + (h >> 24u)) - 510;
  return (noise * spread(r, c) + (1 << u32(run.shift - 1))) >> u32(run.shift);
}
// end: FRACTAL

// when: STEERED
fn tap(at: vec2<i32>, dx: i32, dy: i32) -> i32 {
  return fine[placed(at + run.step * vec2<i32>(dx, dy))];
}

// Sixteen times the exemplar's row dy steps away, by the 4-point rule if the place lies between samples.
fn between(at: vec2<i32>, odd: bool, dy: i32) -> i32 {
  if (!odd) {
    return 16 * tap(at, 0, dy);
  }
  return 9 * (tap(at, -1, dy) + tap(at, 1, dy)) - tap(at, -3, dy) - tap(at, 3, dy);
}

// The exemplar's heights minus its own doubling.
fn residual(here: i32, r: i32, c: i32) -> i32 {
  let at = chosen[here];
  let odd = (c & 1) == 1;
  var own = 16 * between(at, odd, 0);
  if ((r & 1) == 1) {
    own = 9 * (between(at, odd, -1) + between(at, odd, 1)) - between(at, odd, -3) - between(at, odd, 3);
  }
  let rest = fine[placed(at)] - ((own + 128) >> 8u);
  // rest · gain + half >> shift, in 32 bits.
  let gain = spread(r, c);
  let high = (rest >> 8u) * gain;
  let low = (rest & 255) * gain;
  if (run.shift > 8) {
    return (high + (low >> 8u) + ((1 << u32(run.shift - 1)) >> 8u)) >> u32(run.shift - 8);
  }
  return (high << u32(8 - run.shift)) + ((low + (1 << u32(run.shift - 1))) >> u32(run.shift));
}
// end: STEERED

@compute @workgroup_size(8, 8)
fn refine(@builtin(global_invocation_id) id: vec3<u32>) {
  let j = i32(id.x);
  let i = i32(id.y);
  if (i >= run.height || j >= run.width) {
    return;
  }
  let r = run.top + i;
  let c = run.left + j;
  let here = i * run.width + j;
  let height = doubled(r, c);
  if (height == MISSING || ((r | c) & 1) == 0) {
    heights[here] = height;
  } else {
    heights[here] = height + residual(here, r, c);
  }
}
