// Meshes of chunks from their words (store/chunk_code.py): a thread a run, for all chunks at once. No thread waits for
// another, and none takes more steps than its run has triangles, halves and vertices. All arithmetic is of 32-bit integers.

struct Chunk {
  words: u32,      // where they begin
  row: i32,        // of its first sample
  col: i32,
  kind: u32,       // bits 0–7: log2 of its side; from bit 8 on two for each corner: whether at the end of the side, row and column
};

struct Run {
  chunk: u32,
  words: u32,      // where they begin
  vertex: u32,     // numbers of its first vertex and triangle, and of its skirt's first
  triangle: u32,
  fringe: u32,
  base: u32,       // number of the chunk's first vertex
};

@group(0) @binding(0) var<storage, read> chunks: array<Chunk>;          // of the first, row and col are the raster's last
@group(0) @binding(1) var<storage, read> runs: array<Run>;
@group(0) @binding(2) var<storage, read> coded: array<u32>;
@group(0) @binding(3) var<storage, read_write> vertices: array<i32>;    // 5 each: row, column, height, target, low
@group(0) @binding(4) var<storage, read_write> triangles: array<u32>;   // 3 each

const HEADER: u32 = 8u;
const VOIDS: u32 = 0x10000u;
const MISSING: i32 = -2147483647 - 1;
const PARTS: i32 = {{PARTS}};
const ONES: u32 = {{ONES}}u;
const RAW: u32 = {{RAW}}u;
const HUNG: u32 = 0x80000000u;     // of a corner: the skirt's lower end

// ---- bits ----

var<private> cursor: u32;          // the next bit of the words
var<private> ahead: vec2<u32>;     // the word that it is in, and the next

fn seek(bit: u32) {
  cursor = bit;
  ahead = vec2<u32>(coded[bit >> 5u], coded[(bit >> 5u) + 1u]);
}

fn peek() -> u32 {
  let shift = cursor & 31u;
  return select((ahead.x >> shift) | (ahead.y << (32u - shift)), ahead.x, shift == 0u);
}

fn skip(width: u32) {
  let word = cursor >> 5u;
  cursor += width;
  if ((cursor >> 5u) != word) {
    ahead = vec2<u32>(ahead.y, coded[(cursor >> 5u) + 1u]);
  }
}

// At most 31 bits.
fn take(width: u32) -> u32 {
  let found = peek() & ((1u << width) - 1u);
  skip(width);
  return found;
}

fn rice(k: u32) -> u32 {
  let next = peek();
  let ones = min(countTrailingZeros(~next), ONES);
  let long = ones == ONES;
  let width = select(k, RAW, long);
  let before = select(ones + 1u, ONES, long);
  skip(before + width);
  return select(ones << k, 0u, long) | ((next >> before) & ((1u << width) - 1u));
}

fn signed(zigzag: u32) -> i32 {
  return i32(zigzag >> 1u) ^ -i32(zigzag & 1u);
}

// ---- the chunk and its run ----

var<private> first: vec2<i32>;     // the chunk's first and last sample
var<private> last: vec2<i32>;
var<private> edge: vec2<i32>;      // the raster's last
var<private> voids: bool;          // heights may be missing
var<private> ragged: bool;         // that, or the chunk ends beyond the raster
var<private> drop: u32;            // bits of the skirt's depths
var<private> vertex: u32;          // number of the run's first

// include: chunk_heights.wgsl

fn place(v: u32) -> vec2<i32> {
  let at = 5u * (vertex + v);
  return vec2<i32>(vertices[at], vertices[at + 1u]);
}

fn height(v: u32) -> i32 {
  return vertices[5u * (vertex + v) + 2u];
}

fn target_of(v: u32) -> i32 {
  return vertices[5u * (vertex + v) + 3u];
}

fn low(v: u32) -> i32 {
  return vertices[5u * (vertex + v) + 4u];
}

// On which of the chunk's sides a place lies: a bit each.
fn sides(at: vec2<i32>) -> u32 {
  return select(0u, 1u, at.x == first.x) | select(0u, 2u, at.y == first.y)
    | select(0u, 4u, at.x == last.x) | select(0u, 8u, at.y == last.y);
}

fn put(v: u32, at: vec2<i32>, own: i32, to: i32) {
  let here = 5u * (vertex + v);
  vertices[here] = at.x;
  vertices[here + 1u] = at.y;
  vertices[here + 2u] = own;
  vertices[here + 3u] = to;
  var below = MISSING;
  if (own != MISSING && sides(at) != 0u) {
    let down = take(drop);
    below = select(own - i32(down) + 1, MISSING, down == 0u);
  }
  vertices[here + 4u] = below;
}

fn missed() -> bool {
  return voids && take(1u) == 1u;
}

// A corner of the node that the run lies in.
fn read_corner(v: u32, at: vec2<i32>, base: i32, bits: u32) {
  var own = MISSING;
  var to = MISSING;
  if (!missed()) {
    own = base + i32(take(bits & 255u));
    var moved = 1u;
    if (take(1u) == 0u) {
      moved = take(bits >> 8u);
    }
    if (moved != 0u) {
      to = PARTS * own + signed(moved - 1u);
    }
  }
  put(v, at, own, to);
}

// The vertex between two others, k the Rice parameter.
fn read_vertex(v: u32, e: u32, f: u32, a: vec2<i32>, b: vec2<i32>, k: u32) {
  var own = MISSING;
  var to = MISSING;
  if (!missed()) {
    let kept = take(1u) == 1u;
    own = guess(height(e), height(f)) + signed(rice(k));
    to = PARTS * own;
    if (!kept) {
      to = halfway(a, b, target_of(e), target_of(f), to);
    }
  }
  put(v, (a + b) >> vec2<u32>(1u), own, to);
}

// Whether a triangle is drawn: it has three heights, and an area where vertices beyond the raster lie on its border.
fn drawn(a: u32, e: u32, f: u32) -> bool {
  if (voids && (height(a) == MISSING || height(e) == MISSING || height(f) == MISSING)) {
    return false;
  }
  if (all(last <= edge)) {
    return true;
  }
  let o = min(place(a), edge);
  let u = vec2<f32>(min(place(e), edge) - o);
  let v = vec2<f32>(min(place(f), edge) - o);
  let flat = all(u == vec2<f32>(0.0)) || all(v == vec2<f32>(0.0)) || all(u == v);
  return !(flat || (u.x == 0.0 && v.x == 0.0) || (u.y == 0.0 && v.y == 0.0));
}

fn emit(at: u32, a: u32, b: u32, c: u32) {
  triangles[3u * at] = a;
  triangles[3u * at + 1u] = b;
  triangles[3u * at + 2u] = c;
}

// The skirt below an edge, if there is one; where the next goes. before: vertices of the chunk before the run's.
fn hang(at: u32, p: u32, q: u32, before: u32) -> u32 {
  if ((sides(place(p)) & sides(place(q))) == 0u || low(p) == MISSING || low(q) == MISSING) {
    return at;
  }
  let a = before + p;
  let b = before + q;
  emit(at, b, a, a | HUNG);
  emit(at + 1u, b, a | HUNG, b | HUNG);
  return at + 2u;
}

// ---- the walk: store/chunk_walk.py ----

var<private> apex: u32;            // the node: its corners, its depth
var<private> entry: u32;
var<private> exit: u32;
var<private> depth: u32;
var<private> fresh: vec3<u32>;     // whether its hypotenuse, the leg at the entry and that at the exit are met again
var<private> stack: array<u32, {{DEPTH}}>;
var<private> top: u32;
var<private> waiting: array<u32, {{MET}}>;   // of the nodes of even depth from the front, of odd depth from the back
var<private> counts: vec2<u32>;

fn slot_of(side: u32, k: u32) -> u32 {
  return select(k, {{MET}}u - 1u - k, side == 1u);
}

// The vertex at the middle of the hypotenuse, if the run has it, or {{MET}}.
fn met(middle: vec2<i32>) -> u32 {
  let side = depth & 1u;
  var k = select(counts.x, counts.y, side == 1u);
  if (fresh.x == 1u || k == 0u) {
    return {{MET}}u;
  }
  k -= 1u;
  var v = waiting[slot_of(side, k)];
  if (ragged) {
    while (any(place(v) != middle)) {
      if (k == 0u) {
        return {{MET}}u;
      }
      k -= 1u;
      v = waiting[slot_of(side, k)];
    }
  }
  counts = select(vec2<u32>(k, counts.y), vec2<u32>(counts.x, k), side == 1u);
  return v;
}

fn pending(b: u32, a: u32, f: u32, new_: u32, second: u32) -> u32 {
  return b | (a << 8u) | (f << 16u) | (new_ << 24u) | (second << 25u) | (depth << 26u);
}

fn halve(b: u32, over: bool) {
  let a = apex;
  apex = b;
  depth += 1u;
  if (over) {
    if (fresh.x == 1u) {
      stack[top] = pending(b, b, 0u, 0u, 0u);
      top += 1u;
    }
    entry = a;
    fresh = vec3<u32>(fresh.z, 0u, fresh.x);
    return;
  }
  stack[top] = pending(b, a, exit, fresh.z, fresh.x);
  top += 1u;
  exit = a;
  fresh = vec3<u32>(fresh.y, fresh.x, 1u);
}

// On to the node after a leaf; whether there is one.
fn onward() -> bool {
  while (top > 0u) {
    let next = stack[top - 1u];
    let b = next & 255u;
    let a = (next >> 8u) & 255u;
    let second = (next >> 25u) & 1u;
    depth = next >> 26u;
    if (a != b) {
      if (second == 1u) {
        stack[top - 1u] = pending(b, b, 0u, 0u, 0u);
      } else {
        top -= 1u;
      }
      apex = b;
      entry = a;
      exit = (next >> 16u) & 255u;
      fresh = vec3<u32>((next >> 24u) & 1u, 0u, second);
      return true;
    }
    let side = (depth & 1u) ^ 1u;
    waiting[slot_of(side, select(counts.x, counts.y, side == 1u))] = b;
    counts += select(vec2<u32>(1u, 0u), vec2<u32>(0u, 1u), side == 1u);
    top -= 1u;
  }
  return false;
}

// The places of the corners of the node that the run lies in; its depth.
fn read_root(c: Chunk) -> array<vec2<i32>, 3> {
  let side = i32(1u << (c.kind & 255u));
  let root = take(1u);
  let which = select(vec3<u32>(0u, 1u, 3u), vec3<u32>(2u, 3u, 1u), root == 1u);
  var at: array<vec2<i32>, 3>;
  for (var k = 0u; k < 3u; k++) {
    let end = vec2<u32>(c.kind >> (8u + 2u * which[k]), c.kind >> (9u + 2u * which[k])) & vec2<u32>(1u);
    at[k] = first + side * vec2<i32>(end);
  }
  depth = take(6u);
  for (var k = 0u; k < depth; k++) {
    let middle = (at[1] + at[2]) >> vec2<u32>(1u);
    if (take(1u) == 1u) {
      at[1] = at[0];
    } else {
      at[2] = at[0];
    }
    at[0] = middle;
  }
  return at;
}

@compute @workgroup_size({{THREADS}})
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
  if (id.x >= arrayLength(&runs)) {
    return;
  }
  let run = runs[id.x];
  let c = chunks[run.chunk];
  let flags = coded[c.words + 5u];
  let levels = 2u * (c.kind & 255u);
  first = vec2<i32>(c.row, c.col);
  last = first + i32(1u << (c.kind & 255u));
  edge = vec2<i32>(chunks[0].row, chunks[0].col);
  voids = (flags & VOIDS) != 0u;
  ragged = voids || !all(last <= edge);
  drop = (flags >> 8u) & 255u;
  vertex = run.vertex;

  seek(32u * run.words);
  let shift = i32(take(3u)) - 4;
  let at = read_root(c);
  var path = take(6u);
  let halves = vec2<u32>(cursor, path);
  seek(cursor + path);
  for (var k = 0u; k < 3u; k++) {
    read_corner(k, at[k], i32(coded[c.words + 6u]), coded[c.words + 7u]);
  }
  apex = 0u;
  entry = 1u;
  exit = 2u;

  let before = run.vertex - run.base;
  var made = 3u;
  var out = run.triangle;
  var fringe = run.fringe;
  var left = coded[c.words + 4u];
  loop {
    var split = path > 0u;
    var over = false;
    if (split) {
      let bit = halves.x + halves.y - path;
      over = ((coded[bit >> 5u] >> (bit & 31u)) & 1u) == 1u;
      path -= 1u;
    } else if (depth < levels) {
      split = take(1u) == 1u;
    }
    if (split) {
      let a = place(entry);
      let b = place(exit);
      var middle = met((a + b) >> vec2<u32>(1u));
      if (middle == {{MET}}u) {
        let rices = coded[c.words + HEADER + (depth >> 2u)];
        let k = max(i32((rices >> (8u * (depth & 3u))) & 255u) + shift, 0);
        middle = made;
        read_vertex(middle, entry, exit, a, b, u32(k));
        made += 1u;
      }
      halve(middle, over);
      continue;
    }
    let gone = voids && take(1u) == 1u;
    if (!gone && drawn(apex, entry, exit)) {
      let odd = (depth & 1u) == 1u;
      let e = select(entry, exit, odd);
      let f = select(exit, entry, odd);
      emit(out, before + apex, before + e, before + f);
      out += 1u;
      if (drop > 0u) {
        fringe = hang(fringe, apex, e, before);
        fringe = hang(fringe, e, f, before);
        fringe = hang(fringe, f, apex, before);
      }
    }
    left -= 1u;
    if (left == 0u || !onward()) {
      break;
    }
  }
}
