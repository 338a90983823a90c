// The sum reduction of a concurrent binary tree: a full binary tree of counts over the words of bits, by heap number; and,
// from the total count, the arguments of the next dispatches and draw.

@group(0) @binding(0) var<storage, read> bits: array<u32>;
@group(0) @binding(1) var<storage, read_write> sums: array<u32>;
@group(0) @binding(2) var<storage, read_write> arguments: array<u32>;   // of dispatches: 3, of the draw: 4

const WORDS: u32 = {{WORDS}}u;
const BLOCK: u32 = 512u;   // words summed by a workgroup

var<workgroup> part: array<u32, 256>;

@compute @workgroup_size(256)
fn blocks(@builtin(local_invocation_index) k: u32, @builtin(workgroup_id) group: vec3<u32>) {
  let word = group.x * BLOCK + 2u * k;
  let a = countOneBits(bits[word]);
  let b = countOneBits(bits[word + 1u]);
  var node = WORDS + word;
  sums[node] = a;
  sums[node + 1u] = b;
  var sum = a + b;
  node = (WORDS + group.x * BLOCK) / 2u;
  sums[node + k] = sum;
  part[k] = sum;
  for (var width = 128u; width > 0u; width >>= 1u) {
    workgroupBarrier();
    if (k < width) {
      sum = part[2u * k] + part[2u * k + 1u];
    }
    workgroupBarrier();
    node >>= 1u;
    if (k < width) {
      part[k] = sum;
      sums[node + k] = sum;
    }
  }
}

@compute @workgroup_size(256)
fn top(@builtin(local_invocation_index) k: u32) {
  for (var width = WORDS / BLOCK / 2u; width > 0u; width >>= 1u) {
    for (var node = width + k; node < 2u * width; node += 256u) {
      sums[node] = sums[2u * node] + sums[2u * node + 1u];
    }
    storageBarrier();
  }
  if (k == 0u) {
    let count = sums[1];
    arguments[0] = (count + 63u) / 64u;
    arguments[1] = 1u;
    arguments[2] = 1u;
    arguments[3] = 3u * count;
    arguments[4] = 1u;
    arguments[5] = 0u;
    arguments[6] = 0u;
  }
}
