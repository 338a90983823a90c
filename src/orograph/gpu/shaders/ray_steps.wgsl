// What rays cost: of one pixel of every cell of SPACING pixels, how many steps its ray takes, and whether it meets ground.
// include: window_rays.wgsl

const SPACING: u32 = {{SPACING}}u;

@group(1) @binding(2) var<storage, read_write> found: array<u32>;   // by rows of cells: twice the steps, plus 1 at a hit

@compute @workgroup_size(8, 8)
fn main(@builtin(global_invocation_id) cell: vec3<u32>) {
  let cells = (vec2<u32>(camera.size) + SPACING - 1u) / SPACING;
  if (any(cell.xy >= cells)) {
    return;
  }
  let pixel = min(vec2<f32>(cell.xy * SPACING) + 0.5 * f32(SPACING), camera.size - 0.5);
  let hit = first_hit(way_of(pixel), camera.near, select(NEVER, camera.far, camera.plan == 1u));
  found[cell.y * cells.x + cell.x] = 2u * steps + select(1u, 0u, hit.t >= NEVER);
}
