// Where the hits of rays break off beside a pixel, or turn sharply: such a pixel needs more than one ray. Reversed depth is
// linear across a plane in perspective, so its second difference is 0 there. The end of the ground is a break, too, and so
// are breaks in light or colour: shores, lines, layers.

@group(0) @binding(0) var depths: texture_depth_2d;
@group(0) @binding(1) var marks: texture_2d<u32>;
@group(0) @binding(2) var light: texture_2d<f32>;
@group(0) @binding(3) var<storage, read_write> breaks: array<u32>;   // per pixel: 1 at a break

const PART: f32 = {{PART}};   // fraction of the depth
const BRIGHT: f32 = {{BRIGHT}};   // fraction of the brightest channel
const PLAN: u32 = {{PLAN}}u;  // 1: rays are parallel, and only where ground ends counts

struct Seen { depth: f32, kind: u32, color: vec3<f32> };   // kind 0: nothing; 1: ground; 3: a patch over missing ground

fn at(pixel: vec2<i32>) -> Seen {
  let inside = clamp(pixel, vec2<i32>(0), vec2<i32>(textureDimensions(depths)) - 1);
  let depth = textureLoad(depths, inside, 0);
  let kind = select(0u, 1u | (textureLoad(marks, inside, 0).r & 2u), depth > 0.0);
  return Seen(depth, kind, textureLoad(light, inside, 0).rgb);
}

fn broken(own: Seen, pixel: vec2<i32>, step: vec2<i32>) -> bool {
  let a = at(pixel - step);
  let b = at(pixel + step);
  if (a.kind != own.kind || b.kind != own.kind) {
    return true;
  }
  let bend = abs(a.color + b.color - 2.0 * own.color);
  let most = max(own.color, max(a.color, b.color));
  if (max(bend.r, max(bend.g, bend.b)) > BRIGHT * max(most.r, max(most.g, most.b))) {
    return true;
  }
  return PLAN == 0u && abs(a.depth + b.depth - 2.0 * own.depth) > PART * max(own.depth, max(a.depth, b.depth));
}

@compute @workgroup_size(8, 8)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
  let size = textureDimensions(depths);
  if (any(id.xy >= size)) {
    return;
  }
  let pixel = vec2<i32>(id.xy);
  let own = at(pixel);
  let found = broken(own, pixel, vec2<i32>(1, 0)) || broken(own, pixel, vec2<i32>(0, 1))
    || broken(own, pixel, vec2<i32>(1, 1)) || broken(own, pixel, vec2<i32>(1, -1));
  breaks[id.y * size.x + id.x] = select(0u, 1u, found);
}
