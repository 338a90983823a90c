// One update of a concurrent binary tree (lod/cbt/pool.py): judge, mark, plan, apply; then the bits are summed (cbt_sums.wgsl).
// Thread i handles the i-th triangle. A dispatch reads the results of earlier ones, and writes to its own triangle, or marks.
// include: camera.wgsl
// include: cbt_node.wgsl

struct Tuning {
  planes: array<vec4<f32>, 6>,    // of the frustum: stretched metres from the eye, positive inside
  focal: f32,                     // pixels; 0 in a plan
  tolerance: f32,                 // pixels
  lean: f32,                      // largest length on the screen of a metre of height at unit depth
  stretch: f32,                   // factor on spheres
  isotropic: u32,
  cull: u32,
  n: u32,                         // the square has 2^n cells a side
  top: u32,                       // the coarsest level of its pages
  near: f32,
  slots: u32,
  texel: f32,                     // metres: the size of a pixel at unit depth, in a plan at any
  pad: u32,
  levels: array<vec4<u32>, 32>,   // of pages: offset in the table, rows, columns
};

@group(0) @binding(1) var<uniform> tuning: Tuning;
@group(0) @binding(2) var<storage, read_write> nodes: array<Node>;
@group(0) @binding(3) var<storage, read_write> after: array<Node>;
@group(0) @binding(4) var<storage, read_write> state: array<atomic<u32>>;   // by slot; then slots requested, and changes
@group(0) @binding(5) var<storage, read_write> list: array<u32>;            // the slot of each triangle
@group(0) @binding(6) var<storage, read_write> bits: array<atomic<u32>>;
@group(0) @binding(7) var<storage, read> sums: array<u32>;
@group(0) @binding(8) var<storage, read> pages: array<u32>;                 // slot + 1 in the atlas
@group(0) @binding(9) var<storage, read_write> asked: array<atomic<u32>>;   // bits of pages that were looked for in vain
@group(0) @binding(10) var diamonds: texture_2d_array<u32>;                 // stream/diamonds.py: packed

const PAGE: i32 = 256;
const PAGES_PER_SIDE: i32 = 4;
const DROP: u32 = 0u;
const LEAF: u32 = 1u;
const INACCURATE: u32 = 2u;
const ROUNDING: f32 = 2e-6;   // of values from positions, relative to the distance from the eye: always towards a split

// The position of the n-th set bit of a word.
fn nth(word: u32, n: u32) -> u32 {
  var left = n;
  var at = 0u;
  for (var width = 16u; width > 0u; width >>= 1u) {
    let count = countOneBits(extractBits(word, at, width));
    if (left >= count) {
      left -= count;
      at += width;
    }
  }
  return at;
}

// The slot of the i-th set bit, or of the i-th clear one: descends from the top of the sums.
fn decode(i: u32, clear: bool) -> u32 {
  let words = tuning.slots / 32u;
  var left = i;
  var node = 1u;
  var room = tuning.slots;
  while (node < words) {
    room >>= 1u;
    node <<= 1u;
    let count = select(sums[node], room - sums[node], clear);
    if (left >= count) {
      left -= count;
      node += 1u;
    }
  }
  let word = atomicLoad(&bits[node - words]);
  return (node - words) * 32u + nth(select(word, ~word, clear), left);
}

// Metres of a number of 15 bits, counted from a float32.
fn unpacked(code: u32, least: u32) -> f32 {
  return select(select(bitcast<f32>(least + (code << 13u)), 3e38, code == 0x7FFFu), 0.0, code == 0u);
}

struct Verdict { state: u32, height: f32 };

// Whether the bound of an error over a sphere exceeds the tolerance (error/screen.py: sphere_bound).
fn exceeds(p: vec3<f32>, error: f32, radius: f32) -> bool {
  if (error <= 0.0 || tuning.focal == 0.0) {
    return false;
  }
  let x = dot(camera.right.xyz, p);
  let y = dot(camera.up.xyz, p);
  let w = dot(camera.forward.xyz, p);
  let away = length(p);
  let metre = camera.forward.w * vec3<f32>(camera.right.z, camera.up.z, camera.forward.z);   // (a, b, c)
  let depth = w - radius - ROUNDING * (away + radius);
  if (tuning.isotropic == 1u) {
    let e = error * camera.forward.w;
    let nearest = max(depth, tuning.near);
    return !(nearest > e) || tuning.focal * e * (away + radius) > 0.99999 * tuning.tolerance * nearest * (nearest - e);
  }
  let moved = max(depth, tuning.near) - error * abs(metre.z);
  if (!(moved > 0.0)) {
    return true;
  }
  var lean = tuning.lean;
  if (depth > 0.0) {
    let g = metre.xy * w - metre.z * vec2<f32>(x, y);
    lean = min(lean, (length(g) + radius * abs(metre.z) * away / depth + ROUNDING * camera.forward.w * away) / w);
  }
  return tuning.focal * error * lean > 0.99999 * tuning.tolerance * moved;
}

// Whether a sphere is so large on the screen that its colours are seen (error/screen.py: larger_than_pixel).
fn seen(p: vec3<f32>, radius: f32) -> bool {
  let depth = dot(camera.forward.xyz, p) - radius - ROUNDING * (length(p) + radius);
  return radius > tuning.texel * select(1.0 - ROUNDING, depth, tuning.focal > 0.0);
}

fn outside(p: vec3<f32>, radius: f32) -> bool {
  let reach = radius + ROUNDING * (length(p) + radius);
  for (var k = 0u; k < 6u; k++) {
    if (dot(tuning.planes[k].xyz, p) + tuning.planes[k].w < -reach) {
      return true;
    }
  }
  return false;
}

// The slot of a page, −1 if it is absent.
fn slot_of(level: u32, page: vec2<i32>) -> i32 {
  let table = tuning.levels[level];
  return i32(pages[table.x + u32(page.y) * table.z + u32(page.x)]) - 1;
}

// What happens to the triangles over a diamond (lod/criterion.py: judge); one whose page is absent counts as accurate.
fn judged(l: vec2<i32>, octave: u32) -> Verdict {
  let level = min(octave, tuning.top);
  let at = l >> vec2<u32>(level);
  let table = tuning.levels[level];
  let count = vec2<i32>(vec2<u32>(table.z, table.y));
  if (any(at > count * PAGE)) {
    return Verdict(DROP, MISSING_HEIGHT);   // beyond the raster
  }
  // Pages share their borders: any of those that meet there serves.
  let own = min(at / PAGE, count - 1);
  let other = max(select(own, own - 1, at == own * PAGE), vec2<i32>(0));
  var page = own;
  var slot = slot_of(level, page);
  for (var k = 1u; k < 4u && slot < 0; k++) {
    page = select(own, other, vec2<bool>((k & 1u) != 0u, (k & 2u) != 0u));
    slot = slot_of(level, page);
  }
  if (slot < 0) {
    let number = table.x + u32(own.y) * table.z + u32(own.x);
    atomicOr(&asked[number / 32u], 1u << (number % 32u));
    return Verdict(LEAF, MISSING_HEIGHT);
  }
  let place = slot % (PAGES_PER_SIDE * PAGES_PER_SIDE);
  let origin = vec2<i32>(place % PAGES_PER_SIDE, place / PAGES_PER_SIDE) * (PAGE + 1);
  let found = textureLoad(diamonds, origin + at - page * PAGE, slot / (PAGES_PER_SIDE * PAGES_PER_SIDE), 0);
  let ground = bitcast<f32>(found.x);
  let height = select(ground, MISSING_HEIGHT, (found.y >> 31u) != 0u);
  if ((found.y & 0x3FFFFFFFu) == 0x7FFFu) {
    return Verdict(DROP, height);   // empty
  }
  let error = unpacked(found.y & 0x7FFFu, 0x37800000u);
  let p = vec3<f32>(from_eye(vec2<f32>(min(l, camera.last) - camera.eye_cell)), above_eye(ground));
  let radius = unpacked((found.y >> 15u) & 0x7FFFu, 0x3B800000u) * tuning.stretch;
  if (tuning.cull == 1u && outside(p, radius)) {
    return Verdict(DROP, height);
  }
  let colored = ((found.y >> 30u) & 1u) != 0u && seen(p, radius);
  return Verdict(select(LEAF, INACCURATE, error > 1e37 || colored || exceeds(p, error, radius)), height);
}

// Whether a triangle has an area on the raster, and is not squeezed to a line at its end.
fn has_area(node: Node) -> bool {
  let a = min(corner_of(node, tuning.n, 2u), camera.last);
  let b = min(corner_of(node, tuning.n, 6u), camera.last);
  let c = min(corner_of(node, tuning.n, 4u), camera.last);
  return all((a != b) | (a != c));
}

fn octave_of(level: u32) -> u32 {
  return tuning.n - 1u - (level >> 1u);
}

@compute @workgroup_size(64)
fn judge(@builtin(global_invocation_id) id: vec3<u32>) {
  if (id.x >= sums[1]) {
    return;
  }
  let slot = decode(id.x, false);
  list[id.x] = slot;
  let node = nodes[slot];
  let level = node.shape >> 3u;
  var marks = 0u;
  var shown = max(max(node.heights.x, node.heights.y), node.heights.z) < 0.5 * MISSING_HEIGHT && has_area(node);
  if (level < 2u * tuning.n) {
    let own = judged(node.l, octave_of(level));
    nodes[slot].heights.w = own.height;
    marks |= select(0u, SPLITS, own.state == INACCURATE);
    shown &= own.state != DROP;
  }
  if (level > 0u && judged(corner_of(node, tuning.n, 4u), octave_of(level - 1u)).state != INACCURATE) {
    marks |= MERGES;
  }
  atomicStore(&state[slot], marks | select(0u, SHOWN, shown));
}

@compute @workgroup_size(64)
fn mark(@builtin(global_invocation_id) id: vec3<u32>) {
  if (id.x == 0u) {
    atomicStore(&state[tuning.slots], 0u);
  }
  if (id.x >= sums[1]) {
    return;
  }
  var t = list[id.x];
  if ((atomicLoad(&state[t]) & SPLITS) == 0u) {
    return;
  }
  for (var step = 0u; step < 64u; step++) {   // (each step is a level coarser)
    let across = nodes[t].links.z;
    if (across == NONE || nodes[across].links.z == t) {
      atomicOr(&state[t], MARKED | KEPT);
      if (across != NONE) {
        atomicOr(&state[across], MARKED | KEPT);
      }
      return;
    }
    atomicOr(&state[t], KEPT);
    t = across;
  }
}

// Whether a triangle's diamond can merge: its halves are leaves of one level, none is kept, and it is not to be split.
fn ready(slot: u32, level: u32) -> bool {
  return nodes[slot].shape >> 3u == level && (atomicLoad(&state[slot]) & (MERGES | KEPT)) == MERGES;
}

@compute @workgroup_size(64)
fn plan(@builtin(global_invocation_id) id: vec3<u32>) {
  if (id.x >= sums[1]) {
    return;
  }
  let slot = list[id.x];
  let marks = atomicLoad(&state[slot]);
  let links = nodes[slot].links;
  if ((marks & MARKED) != 0u) {
    let across = links.z;
    if (across != NONE && across < slot) {
      return;   // the other triangle of the pair handles both
    }
    let count = select(2u, 1u, across == NONE);
    let first = atomicAdd(&state[tuning.slots], count);
    if (first + count > tuning.slots - sums[1]) {
      return;   // no room
    }
    nodes[slot].spare = decode(first, true);
    atomicOr(&state[slot], SPLIT);
    if (across != NONE) {
      nodes[across].spare = decode(first + 1u, true);
      atomicOr(&state[across], SPLIT);
    }
    return;
  }
  let node = nodes[slot];
  let level = node.shape >> 3u;
  if (!ready(slot, level)) {
    return;
  }
  // Around the vertex: this one, its sibling, and the halves of the other top triangle, if there is one.
  let left = which_child(node, tuning.n) == 0u;
  let sibling = select(links.y, links.x, left);
  if (sibling == NONE || !ready(sibling, level)) {
    return;
  }
  let beside = select(links.x, links.y, left);
  let beyond = select(nodes[sibling].links.y, nodes[sibling].links.x, left);
  if ((beside == NONE || ready(beside, level)) && (beyond == NONE || ready(beyond, level))) {
    atomicOr(&state[slot], MERGED);
  }
}

// The slot that lies across an edge of triangle t afterwards, where ``there`` was before.
fn across_edge(t: u32, there: u32) -> u32 {
  if (there == NONE) {
    return NONE;
  }
  let marks = atomicLoad(&state[there]);
  if ((marks & SPLIT) != 0u && nodes[there].links.y == t) {
    return nodes[there].spare;
  }
  if ((marks & MERGED) != 0u && which_child(nodes[there], tuning.n) == 1u) {
    return nodes[there].links.y;   // its sibling's slot is the parent's
  }
  return there;
}

// A half: its apex is the parent's split point.
fn half_of(node: Node, k: u32) -> Node {
  let omega = node.shape & 7u;
  let level = (node.shape >> 3u) + 1u;
  let L = side(level, tuning.n);
  let turned = (omega + 3u + 2u * k) & 7u;
  var out: Node;
  out.l = node.l + ((vec2<i32>(wave(turned), wave(turned + 6u)) * L) >> vec2<u32>(1u));
  out.shape = level << 3u | turned;
  let z = node.heights;
  out.heights = vec4<f32>(select(z.yz, z.zx, k == 0u), z.w, MISSING_HEIGHT);
  return out;
}

@compute @workgroup_size(64)
fn apply(@builtin(global_invocation_id) id: vec3<u32>) {
  if (id.x >= sums[1]) {
    return;
  }
  let slot = list[id.x];
  let marks = atomicLoad(&state[slot]);
  let node = nodes[slot];
  let links = node.links;
  if ((marks & SPLIT) != 0u) {
    let fresh = node.spare;
    var twin_fresh = NONE;
    if (links.z != NONE) {
      twin_fresh = nodes[links.z].spare;
    }
    var left = half_of(node, 0u);
    var right = half_of(node, 1u);
    left.links = vec4<u32>(fresh, twin_fresh, across_edge(slot, links.x), NONE);
    right.links = vec4<u32>(links.z, slot, across_edge(slot, links.y), NONE);
    after[slot] = left;
    after[fresh] = right;
    atomicOr(&bits[fresh / 32u], 1u << (fresh % 32u));
    atomicAdd(&state[tuning.slots + 1u], 1u);
    return;
  }
  if ((marks & MERGED) != 0u) {
    atomicAdd(&state[tuning.slots + 1u], 1u);
    if (which_child(node, tuning.n) == 1u) {
      atomicAnd(&bits[slot / 32u], ~(1u << (slot % 32u)));
      return;
    }
    let sibling = nodes[links.x];
    let turned = ((node.shape & 7u) + 8u - 3u) & 7u;
    var out: Node;
    out.l = corner_of(node, tuning.n, 4u);
    out.shape = ((node.shape >> 3u) - 1u) << 3u | turned;
    out.heights = vec4<f32>(node.heights.y, sibling.heights.x, node.heights.x, node.heights.z);
    var other = NONE;
    if (links.y != NONE) {
      other = nodes[links.y].links.y;
    }
    out.links = vec4<u32>(across_edge(slot, links.z), across_edge(links.x, sibling.links.z), other, NONE);
    after[slot] = out;
    return;
  }
  var out = node;
  out.links = vec4<u32>(
    across_edge(slot, links.x), across_edge(slot, links.y), across_edge(slot, links.z), NONE);
  after[slot] = out;
}
