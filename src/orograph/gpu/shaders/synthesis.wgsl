// Coordinates by example: a level's from the coarser one's, and one sub-pass of correction (Lefebvre & Hoppe 2005, §3.1 to §3.3).
// In integers, like synthesis/kernels.py: both choose the same places.
// include: synthesis_plane.wgsl

@group(0) @binding(0) var<uniform> run: Run;
@group(0) @binding(1) var<storage, read> before: array<vec2<i32>>;
@group(0) @binding(2) var<storage, read_write> chosen: array<vec2<i32>>;
@group(0) @binding(3) var<storage, read> features: array<i32>;
@group(0) @binding(4) var<storage, read> similar: array<vec2<i32>>;
// when: STEERED
// Features of the terrain at places, and of the exemplar: slopes along columns and rows, and a curvature.
@group(0) @binding(5) var<storage, read> guide: array<i32>;
@group(0) @binding(6) var<storage, read> guides: array<i32>;

// The difference between a place and a coordinate of the exemplar, whose mirror images have mirrored slopes.
fn unlike(here: i32, at: vec2<i32>) -> u32 {
  let there = 3 * placed(at);
  let x = guide[3 * here] - select(guides[there], -guides[there], at.x >= run.cols);
  let y = guide[3 * here + 1] - select(guides[there + 1], -guides[there + 1], at.y >= run.rows);
  let z = guide[3 * here + 2] - guides[there + 2];
  return u32(x * x + y * y + z * z);
}
// end: STEERED

fn shaken(bits: u32) -> i32 {
  return (run.step * run.reach * (i32(bits & 0x1FFFu) - 4096) + 0x80000) >> 20u;
}

@compute @workgroup_size(8, 8)
fn upsample(@builtin(global_invocation_id) id: vec3<u32>) {
  let j = i32(id.x);
  let i = i32(id.y);
  if (i >= run.height || j >= run.width) {
    return;
  }
  let r = run.top + i;
  let c = run.left + j;
  let parent = before[((r >> 1u) - run.row0) * run.from_width + (c >> 1u) - run.col0];
  let h = hashed(c, r, run.seed);
  let x = parent.x + run.step * (c & 1) + shaken(h);
  let y = parent.y + run.step * (r & 1) + shaken(h >> 16u);
  chosen[i * run.width + j] = vec2<i32>(wrapped(x, run.cols), wrapped(y, run.rows));
}

// when: STEERED
const TRIES = {{TRIES}};

// Of some random places of the exemplar's plane, the one most like the terrain.
@compute @workgroup_size(8, 8)
fn begin(@builtin(global_invocation_id) id: vec3<u32>) {
  let j = i32(id.x);
  let i = i32(id.y);
  if (i >= run.height || j >= run.width) {
    return;
  }
  let here = i * run.width + j;
  var least = 0xFFFFFFFFu;
  for (var n = 1; n <= TRIES; n++) {
    let h = hashed(run.left + j, run.top + i, run.seed + 104729 * n);
    let at = vec2<i32>(vec2<u32>(h & 0xFFFFu, h >> 16u) * vec2<u32>(vec2<i32>(2 * run.cols, 2 * run.rows)) >> vec2<u32>(16u));
    let d = unlike(here, at);
    if (d < least) {
      least = d;
      chosen[here] = at;
    }
  }
}
// end: STEERED

fn straddles(x: i32, size: i32, reach: i32) -> bool {
  let r = folded(x, size);
  return r < reach || r >= size - reach;
}

@compute @workgroup_size(8, 8)
fn correct(@builtin(global_invocation_id) id: vec3<u32>) {
  let j = i32(id.x);
  let i = i32(id.y);
  if (i >= run.height || j >= run.width) {
    return;
  }
  let here = i * run.width + j;
  chosen[here] = before[here];
  let border = i < run.inset || j < run.inset || i >= run.height - run.inset || j >= run.width - run.inset;
  if (border || (i & 1) != run.even_row || (j & 1) != run.even_col) {
    return;
  }
  var around: array<i32, 25>;
  for (var n = 0; n < 25; n++) {
    around[n] = features[placed(before[here + (n / 5 - 2) * run.width + n % 5 - 2])];
  }
  var best = 0xFFFFFFFFu;
  var tried: array<vec2<i32>, 18>;
  let reach = min(2 * run.step, min(run.rows, run.cols) / 4);
  for (var n = 0; n < 18; n++) {
    let m = (n % 9 + 4) % 9;   // the place itself first
    let dr = m / 3 - 1;
    let dc = m % 3 - 1;
    var at = before[here + dr * run.width + dc];
    if (n >= 9) {
      let like = similar[placed(at)];
      at = vec2<i32>(select(2 * run.cols - 1 - like.x, like.x, at.x < run.cols),
                     select(2 * run.rows - 1 - like.y, like.y, at.y < run.rows));
    }
    at = vec2<i32>(wrapped(at.x - run.step * dc, run.cols), wrapped(at.y - run.step * dr, run.rows));
    tried[n] = at;
    var known = false;
    for (var t = 0; t < n; t++) {
      known = known || all(tried[t] == at);
    }
    if (known) {
      continue;
    }
    var weight = select(4u, 4u + u32(run.kappa), n >= 9);
    if (straddles(at.x, run.cols, reach) || straddles(at.y, run.rows, reach)) {
      weight *= 4u;
    }
    var d = 0u;
    // when: STEERED
    d = 8u * unlike(here, at);
    // end: STEERED
    for (var k = 0; k < 25; k++) {
      let e = around[k] - features[placed(at + run.step * vec2<i32>(k % 5 - 2, k / 5 - 2))];
      d += u32(e * e);
    }
    if (d * weight < best) {
      best = d * weight;
      chosen[here] = at;
    }
  }
}
