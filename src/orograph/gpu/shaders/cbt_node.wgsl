// A triangle of the pool (lod/cbt/pool.py) and the arithmetic of the hierarchy (hierarchy/triangles.py).

const NONE: u32 = 0xffffffffu;
const MISSING_HEIGHT: f32 = 1e30;   // of a vertex without a height: shaders may not rely on NaN

struct Node {
  l: vec2<i32>,          // (col, row) of the diamond point
  shape: u32,            // level, and ω in the low three bits
  spare: u32,            // the slot for the right half
  heights: vec4<f32>,    // left end, right end, apex, middle of the hypotenuse
  links: vec4<u32>,      // slots of the neighbours at the left leg, the right leg and the hypotenuse
};

// The state of a slot's triangle during an update.
const SPLITS: u32 = 1u;      // its diamond is to be split
const MERGES: u32 = 2u;      // its parent's diamond is not to be split
const MARKED: u32 = 4u;      // it can be split, for itself or for others
const KEPT: u32 = 8u;        // it is not merged
const SHOWN: u32 = 16u;      // it is drawn
const SPLIT: u32 = 32u;      // it is split in this update
const MERGED: u32 = 64u;     // … or merged

fn wave(k: u32) -> i32 {
  return abs(i32(k & 7u) - 4) - 2;
}

fn side(level: u32, n: u32) -> i32 {
  return 1 << (n - (level + 1u) / 2u);
}

// A corner: 4 the apex, 2 the left end, 6 the right end (added to ω).
fn corner_of(node: Node, n: u32, direction: u32) -> vec2<i32> {
  let L = side(node.shape >> 3u, n);
  let way = (node.shape & 7u) + direction;
  return node.l + ((vec2<i32>(1) + vec2<i32>(wave(way), wave(way + 6u)) * L) >> vec2<u32>(1u));
}

fn which_child(node: Node, n: u32) -> u32 {
  let omega = node.shape & 7u;
  let a = corner_of(node, n, 4u);
  let even = 1u - (omega & 1u);
  let L = side(node.shape >> 3u, n) << even;
  let other = select(0u, 2u, ((a.x ^ (~a.y * i32(even))) & L) != 0);
  return ((omega + 8u - 3u - (even + other)) & 3u) >> 1u;
}
