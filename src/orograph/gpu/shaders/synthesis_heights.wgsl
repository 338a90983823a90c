// Heights by example: a level's from the coarser one's, doubled, plus the exemplar's minus its doubled coarser level.
// include: synthesis_plane.wgsl

@group(0) @binding(0) var<uniform> run: Run;
@group(0) @binding(1) var<storage, read> chosen: array<vec2<i32>>;
@group(0) @binding(2) var<storage, read> coarse: array<i32>;
@group(0) @binding(3) var<storage, read> finer: array<i32>;
@group(0) @binding(4) var<storage, read> coarser: array<i32>;
@group(0) @binding(5) var<storage, read_write> heights: array<i32>;

// The B-spline's weights 1 4 6 4 1.
fn tap(d: i32) -> i32 {
  return select(select(1, 4, abs(d) == 1), 6, d == 0);
}

@compute @workgroup_size(8, 8)
fn begin(@builtin(global_invocation_id) id: vec3<u32>) {
  let j = i32(id.x);
  let i = i32(id.y);
  if (i < run.height && j < run.width) {
    heights[i * run.width + j] = finer[placed(chosen[i * run.width + j])];
  }
}

@compute @workgroup_size(8, 8)
fn raise(@builtin(global_invocation_id) id: vec3<u32>) {
  let j = i32(id.x);
  let i = i32(id.y);
  if (i >= run.height || j >= run.width) {
    return;
  }
  let r = run.top + i;
  let c = run.left + j;
  let at = chosen[i * run.width + j];
  var doubled = 0;
  var own = 0;
  for (var dr = -2 + (r & 1); dr < 3; dr += 2) {
    for (var dc = -2 + (c & 1); dc < 3; dc += 2) {
      let weight = tap(dr) * tap(dc);
      doubled += weight * coarse[(((r + dr) >> 1u) - run.row0) * run.from_width + ((c + dc) >> 1u) - run.col0];
      own += weight * coarser[placed(at + run.step * vec2<i32>(dc, dr))];
    }
  }
  heights[i * run.width + j] = ((doubled + 32) >> 6u) + finer[placed(at)] - ((own + 32) >> 6u);
}
