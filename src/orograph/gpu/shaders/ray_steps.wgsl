// The cost of rays: for one pixel of every cell of SPACING pixels, the steps its ray takes, and whether it hits ground.
// include: window_rays.wgsl

const SPACING: u32 = {{SPACING}}u;
const BEAM: u32 = {{BEAM}}u;

@group(1) @binding(2) var<storage, read> starts: array<f32>;   // ray_beams.wgsl
@group(1) @binding(3) var<storage, read_write> found: array<u32>;   // by rows of cells: twice the steps, plus 1 at a hit

@compute @workgroup_size(8, 8)
fn main(@builtin(global_invocation_id) cell: vec3<u32>) {
  let cells = (vec2<u32>(camera.size) + SPACING - 1u) / SPACING;
  if (any(cell.xy >= cells)) {
    return;
  }
  let pixel = min(vec2<f32>(cell.xy * SPACING) + 0.5 * f32(SPACING), camera.size - 0.5);
  let beam = vec2<u32>(pixel) / BEAM;
  let start = starts[beam.y * ((u32(camera.size.x) + BEAM - 1u) / BEAM) + beam.x];
  let hit = first_hit(way_of(pixel), start, select(NEVER, camera.far, camera.plan == 1u), start > camera.near);
  found[cell.y * cells.x + cell.x] = 2u * steps + select(1u, 0u, hit.t >= NEVER);
}
