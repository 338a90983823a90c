// Arbitrary rays against the terrain (orograph.rendering.gpu.shade.ray_field.blocked): one invocation each.

// include: ray_field.wgsl

struct Query {
  whole: vec2<i32>,   // sample (column, row)
  part: vec2<f32>,    // remainder
  way: vec3<f32>,
  height: f32,        // metres
  skip: f32,          // metres
  far: f32,
  pad: vec2<f32>,
};

@group(1) @binding(0) var<storage, read> queries: array<Query>;
@group(1) @binding(1) var<storage, read_write> answers: array<u32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
  let k = id.y * groups.x * 64u + id.x;
  if (k >= arrayLength(&queries)) {
    return;
  }
  let q = queries[k];
  answers[k] = u32(blocked(Place(q.whole, q.part), q.height, q.way, q.skip, q.far));
}
