// Meshes of chunks from their words (store/chunk_code.py): a workgroup per chunk, one level of its triangles after another.
// Prefix sums tell a thread what it needs to know of those before it. All arithmetic is of 32-bit integers.
//
// A thread takes a run of RUN triangles at a time. On hardware that is one, so that neighbouring threads read neighbouring
// memory; on software, where barriers cost more than memory, it is an equal share of the level (0).

struct Job {
  words: u32,      // their offset
  scratch: u32,    // offset in the scratch: an offset for each block, then two levels of nodes
  vertex: u32,     // numbers of the chunk's first vertex and triangle
  triangle: u32,
  row: i32,        // of its first sample
  col: i32,
  kind: u32,       // bits 0–7: log2 of its side; from bit 8 on, two for each corner: whether at the end of the side, row and column
  spare: u32,
};

@group(0) @binding(0) var<storage, read> jobs: array<Job>;              // in the first, row and col are the raster's last
@group(0) @binding(1) var<storage, read> coded: array<u32>;
@group(0) @binding(2) var<storage, read_write> scratch: array<i32>;
@group(0) @binding(3) var<storage, read_write> vertices: array<i32>;    // 5 each: row, column, height, target, low
@group(0) @binding(4) var<storage, read_write> triangles: array<u32>;   // 3 each

const THREADS: u32 = {{THREADS}}u;
const RUN: u32 = {{RUN}}u;
const HEADER: u32 = 15u;
const BLOCK: u32 = {{BLOCK}}u;
const VOIDS: u32 = 0x10000u;
const MISSING: i32 = -2147483647 - 1;
const PARTS: i32 = {{PARTS}};
const HUNG: u32 = 0x80000000u;     // marks a corner as the skirt's lower end

var<workgroup> sums: array<vec4<u32>, {{THREADS}}>;
var<workgroup> more: array<u32, {{THREADS}}>;
var<workgroup> total: array<u32, 5>;

struct Before { counts: vec4<u32>, more: u32 };   // sums over earlier threads

fn before(k: u32, counts: vec4<u32>, others: u32) -> Before {
  sums[k] = counts;
  more[k] = others;
  workgroupBarrier();
  for (var step = 1u; step < THREADS; step <<= 1u) {
    var left = vec4<u32>(0u);
    var also = 0u;
    if (k >= step) {
      left = sums[k - step];
      also = more[k - step];
    }
    workgroupBarrier();
    sums[k] += left;
    more[k] += also;
    workgroupBarrier();
  }
  if (k == THREADS - 1u) {
    total = array<u32, 5>(sums[k].x, sums[k].y, sums[k].z, sums[k].w, more[k]);
  }
  return Before(sums[k] - counts, more[k] - others);
}

// Up to 32 bits of the words, from a position on.
fn number(at: u32, bit: u32, width: u32) -> u32 {
  if (width == 0u) {
    return 0u;
  }
  let word = at + (bit >> 5u);
  let shift = bit & 31u;
  var found = coded[word] >> shift;
  if (shift + width > 32u) {
    found |= coded[word + 1u] << (32u - shift);
  }
  return found & (0xffffffffu >> (32u - width));
}

fn words_of(bits: u32) -> u32 {
  return (bits + 31u) / 32u;
}

// include: chunk_heights.wgsl

struct Chunk {
  vertex: u32,
  first: vec2<i32>,
  last: vec2<i32>,
  drop: u32,
  kept: u32,       // offsets of the parts of the words
  missing: u32,    // 0: no vertex is
  widths: u32,
  drops: u32,
  rests: u32,
  dropped: u32,    // 0: no node is
  offsets: u32,    // in the scratch
};

fn place(c: Chunk, v: i32) -> vec2<i32> {
  let at = 5u * (c.vertex + u32(v));
  return vec2<i32>(vertices[at], vertices[at + 1u]);
}

fn height(c: Chunk, v: i32) -> i32 {
  return vertices[5u * (c.vertex + u32(v)) + 2u];
}

// The sides of the chunk that a vertex lies on: a bit each.
fn sides(c: Chunk, at: vec2<i32>) -> u32 {
  return select(0u, 1u, at.x == c.first.x) | select(0u, 2u, at.y == c.first.y)
    | select(0u, 4u, at.x == c.last.x) | select(0u, 8u, at.y == c.last.y);
}

fn hangs(c: Chunk, a: i32, b: i32) -> bool {
  return vertices[5u * (c.vertex + u32(a)) + 4u] != MISSING && vertices[5u * (c.vertex + u32(b)) + 4u] != MISSING
    && (sides(c, place(c, a)) & sides(c, place(c, b))) != 0u;
}

fn put(c: Chunk, v: u32, at: vec2<i32>, height: i32, target_: i32, rank: u32) {
  let to = 5u * (c.vertex + v);
  vertices[to] = at.x;
  vertices[to + 1u] = at.y;
  vertices[to + 2u] = height;
  vertices[to + 3u] = target_;
  var low = MISSING;
  if (sides(c, at) != 0u) {
    let down = number(c.drops, rank * c.drop, c.drop);
    low = select(height - i32(down) + 1, MISSING, down == 0u);
  }
  vertices[to + 4u] = low;
}

// Make vertex v, which splits the hypotenuse between e and f, the rank-th on a side.
fn make(c: Chunk, v: u32, e: i32, f: i32, rank: u32) {
  let a = place(c, e);
  let b = place(c, f);
  let k = v - 4u;
  let block = k / BLOCK;
  let width = (coded[c.widths + (block >> 2u)] >> (8u * (block & 3u))) & 255u;
  let zigzag = number(c.rests, u32(scratch[c.offsets + block]) + (k % BLOCK) * width, width);
  var own = guess(height(c, e), height(c, f)) + (i32(zigzag >> 1u) ^ -i32(zigzag & 1u));
  var to = PARTS * own;
  if (c.missing != 0u && number(c.missing, v, 1u) == 1u) {
    own = MISSING;
    to = MISSING;
  } else if (number(c.kept, k, 1u) == 0u) {
    to = halfway(a, b, vertices[5u * (c.vertex + u32(e)) + 3u], vertices[5u * (c.vertex + u32(f)) + 3u], to);
  }
  put(c, v, (a + b) >> vec2<u32>(1u), own, to, rank);
}

// Whether a triangle is drawn: it has three heights, and an area after squeezing onto the raster's border.
fn drawn(c: Chunk, a: i32, e: i32, f: i32) -> bool {
  if (c.missing != 0u && (height(c, a) == MISSING || height(c, e) == MISSING || height(c, f) == MISSING)) {
    return false;
  }
  let last = vec2<i32>(jobs[0].row, jobs[0].col);
  if (all(c.last <= last)) {
    return true;
  }
  let o = min(place(c, a), last);
  let u = vec2<f32>(min(place(c, e), last) - o);
  let v = vec2<f32>(min(place(c, f), last) - o);
  let flat = all(u == vec2<f32>(0.0)) || all(v == vec2<f32>(0.0)) || all(u == v);
  return !(flat || (u.x == 0.0 && v.x == 0.0) || (u.y == 0.0 && v.y == 0.0));
}

fn emit(at: u32, a: u32, b: u32, c: u32) {
  triangles[3u * at] = a;
  triangles[3u * at + 1u] = b;
  triangles[3u * at + 2u] = c;
}

// Make the skirt below an edge, if there is one; return where the next one goes.
fn hang(first: u32, at: u32, there: bool, p: u32, q: u32) -> u32 {
  if (!there) {
    return at;
  }
  emit(first + at, q, p, p | HUNG);
  emit(first + at + 1u, q, p | HUNG, q | HUNG);
  return at + 2u;
}

// The child of a neighbour.
fn half_of(nodes: u32, n: i32, which: i32) -> i32 {
  if (n < 0) {
    return -1;
  }
  let rank = scratch[nodes + 8u * u32(n) + 6u];
  return select(2 * (rank - 1) + which, -1, rank == 0);
}

fn owner(nodes: u32, i: u32) -> bool {
  let across = scratch[nodes + 8u * i + 5u];
  return across < 0 || i < u32(across);
}

fn split(nodes: u32, i: u32) -> bool {
  let own = owner(nodes, i);
  return scratch[nodes + 8u * select(u32(scratch[nodes + 8u * i + 5u]), i, own) + 6u] != 0;
}

// Find where the steps of each block begin, and the end of the steps in the words.
fn offsets_of(k: u32, c: Chunk, count: u32) -> u32 {
  let blocks = (count - 4u + BLOCK - 1u) / BLOCK;
  let share = (blocks + THREADS - 1u) / THREADS;
  let end = min((k + 1u) * share, blocks);
  var size = 0u;
  for (var b = k * share; b < end; b++) {
    size += BLOCK * ((coded[c.widths + (b >> 2u)] >> (8u * (b & 3u))) & 255u);
  }
  var at = before(k, vec4<u32>(size, 0u, 0u, 0u), 0u).counts.x;
  for (var b = k * share; b < end; b++) {
    scratch[c.offsets + b] = i32(at);
    at += BLOCK * ((coded[c.widths + (b >> 2u)] >> (8u * (b & 3u))) & 255u);
  }
  let all_ = workgroupUniformLoad(&total)[0];
  let lacking = blocks * BLOCK - (count - 4u);   // in the last block
  let last = blocks - select(1u, 0u, blocks == 0u);
  return all_ - lacking * ((coded[c.widths + (last >> 2u)] >> (8u * (last & 3u))) & 255u);
}

@compute @workgroup_size({{THREADS}})
fn main(@builtin(local_invocation_index) k: u32, @builtin(workgroup_id) group: vec3<u32>) {
  let job = jobs[group.x + 1u];
  let h = job.words;
  let count = coded[h];
  let widest = coded[h + 3u];
  let flags = coded[h + 6u];
  let side = i32(1u << (job.kind & 255u));
  let levels = 2u * (job.kind & 255u);
  let bits = h + HEADER;
  let blocks = (count - 4u + BLOCK - 1u) / BLOCK;
  var c = Chunk(
    job.vertex, vec2<i32>(job.row, job.col), vec2<i32>(job.row, job.col) + side, (flags >> 8u) & 255u,
    bits + words_of(coded[h + 4u]), 0u, 0u, 0u, 0u, 0u, job.scratch);
  c.widths = c.kept + words_of(count - 4u);
  if ((flags & VOIDS) != 0u) {
    c.missing = c.widths;
    c.widths += words_of(count);
  }
  c.drops = c.widths + (blocks + 3u) / 4u;
  c.rests = c.drops + words_of(coded[h + 5u] * c.drop);
  let size = offsets_of(k, c, count);
  if ((flags & VOIDS) != 0u) {
    c.dropped = c.rests + words_of(size);
  }
  var nodes = job.scratch + blocks;
  var beyond = nodes + 8u * widest;
  if (k < 4u) {
    let end = vec2<u32>(job.kind >> (8u + 2u * k), job.kind >> (9u + 2u * k)) & vec2<u32>(1u);
    put(c, k, c.first + side * vec2<i32>(end), i32(coded[h + 7u + k]), i32(coded[h + 11u + k]), k);
  }
  if (k < 2u) {
    let root = array<vec3<i32>, 2>(vec3<i32>(0, 1, 3), vec3<i32>(2, 3, 1))[k];
    let to = nodes + 8u * k;
    scratch[to] = root.x;
    scratch[to + 1u] = root.y;
    scratch[to + 2u] = root.z;
    scratch[to + 3u] = -1;
    scratch[to + 4u] = -1;
    scratch[to + 5u] = 1 - i32(k);
  }
  storageBarrier();
  var width = 2u;         // nodes of the level
  var told = 0u;          // totals of the levels before: bits, vertices, those on sides, triangles, edges with a skirt, nodes
  var made = 4u;
  var beside = 4u;
  var out = 0u;
  var hung = 0u;
  var seen = 0u;
  for (var level = 0u; level <= levels && width > 0u; level++) {
    let run = select(RUN, (width + THREADS - 1u) / THREADS, RUN == 0u);
    for (var tile = 0u; tile < width; tile += run * THREADS) {
      let begin = min(tile + k * run, width);
      let end = min(begin + run, width);
      var owners = 0u;
      for (var i = begin; i < end; i++) {
        owners += select(0u, 1u, owner(nodes, i));
      }
      var rank = told + before(k, vec4<u32>(owners, 0u, 0u, 0u), 0u).counts.x;
      for (var i = begin; i < end; i++) {
        if (owner(nodes, i)) {
          var bit = 0u;
          if (level < levels) {
            bit = number(bits, rank, 1u);
          }
          scratch[nodes + 8u * i + 6u] = i32(bit);
          rank += 1u;
        }
      }
      told += workgroupUniformLoad(&total)[0];
    }
    storageBarrier();

    var splits = 0u;
    for (var tile = 0u; tile < width; tile += run * THREADS) {
      let begin = min(tile + k * run, width);
      let end = min(begin + run, width);
      var counts = vec4<u32>(0u);   // splits, vertices, those on sides, triangles
      var edges = 0u;
      for (var i = begin; i < end; i++) {
        let at = nodes + 8u * i;
        let a = scratch[at];
        let e = scratch[at + 1u];
        let f = scratch[at + 2u];
        if (split(nodes, i)) {
          counts.x += 1u;
          if (owner(nodes, i)) {
            counts.y += 1u;
            counts.z += select(0u, 1u, sides(c, (place(c, e) + place(c, f)) >> vec2<u32>(1u)) != 0u);
          }
        } else if (!(c.dropped != 0u && number(c.dropped, seen + i, 1u) == 1u) && drawn(c, a, e, f)) {
          let hung = select(0u, 1u, hangs(c, a, e)) | select(0u, 2u, hangs(c, e, f)) | select(0u, 4u, hangs(c, f, a));
          counts.w += 1u;
          edges += countOneBits(hung);
          scratch[at + 7u] = i32(8u | hung);
        } else {
          scratch[at + 7u] = 0;
        }
      }
      let first = before(k, counts, edges);
      let all_ = workgroupUniformLoad(&total);
      var now = first.counts;
      var fringe = coded[h + 1u] + 2u * (hung + first.more);
      for (var i = begin; i < end; i++) {
        let at = nodes + 8u * i;
        let a = scratch[at];
        let e = scratch[at + 1u];
        let f = scratch[at + 2u];
        if (split(nodes, i)) {
          now.x += 1u;
          if (owner(nodes, i)) {
            let v = made + now.y;
            make(c, v, e, f, beside + now.z);
            scratch[at + 7u] = i32(v);
            now.y += 1u;
            now.z += select(0u, 1u, sides(c, place(c, i32(v))) != 0u);
          }
          scratch[at + 6u] = i32(splits + now.x);
        } else {
          if (!owner(nodes, i)) {
            scratch[at + 6u] = 0;
          }
          let there = u32(scratch[at + 7u]);   // of a leaf: 8, and its edges with a skirt
          if (there != 0u) {
            emit(job.triangle + out + now.w, u32(a), u32(e), u32(f));
            now.w += 1u;
            fringe = hang(job.triangle, fringe, (there & 1u) != 0u, u32(a), u32(e));
            fringe = hang(job.triangle, fringe, (there & 2u) != 0u, u32(e), u32(f));
            fringe = hang(job.triangle, fringe, (there & 4u) != 0u, u32(f), u32(a));
          }
        }
      }
      splits += all_[0];
      made += all_[1];
      beside += all_[2];
      out += all_[3];
      hung += all_[4];
    }
    storageBarrier();

    for (var i = k; i < width; i += THREADS) {
      let at = nodes + 8u * i;
      let own = scratch[at + 6u];
      if (own == 0) {
        continue;
      }
      let mid = scratch[nodes + 8u * select(u32(scratch[at + 5u]), i, owner(nodes, i)) + 7u];
      let to = beyond + 16u * u32(own - 1);
      scratch[to] = mid;
      scratch[to + 1u] = scratch[at];
      scratch[to + 2u] = scratch[at + 1u];
      scratch[to + 3u] = 2 * own - 1;
      scratch[to + 4u] = half_of(nodes, scratch[at + 5u], 1);
      scratch[to + 5u] = half_of(nodes, scratch[at + 3u], 1);
      scratch[to + 8u] = mid;
      scratch[to + 9u] = scratch[at + 2u];
      scratch[to + 10u] = scratch[at];
      scratch[to + 11u] = half_of(nodes, scratch[at + 5u], 0);
      scratch[to + 12u] = 2 * own - 2;
      scratch[to + 13u] = half_of(nodes, scratch[at + 4u], 0);
    }
    storageBarrier();
    seen += width;
    width = 2u * splits;
    let other = nodes;
    nodes = beyond;
    beyond = other;
  }
}
