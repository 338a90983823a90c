// Decodes a chunk of the codec "orograph.smallest" (docs/codec.md has the format) into an Int32Array of rows × cols
// samples, -2^31 where missing. Throws a RangeError at bytes that are no such chunk. It needs compact.js beside it:
//
//   import { decode } from "./smallest.js";
//   const numbers = decode(bytes, 256, 256);  // bytes: Uint8Array, without the crc32c behind it

import { Bytes, MISSING, Stream, missing, must, table, unzigzag } from "./compact.js";

const BINS = 5, SMALL = 307;
const FIRST = [...new Array(12).fill(0), 128, 0, 128, 0, 0]; // shares in a first row
const size = (difference) => Math.min(Math.abs(difference | 0), 4095);

function tablesByCell(bytes, classes, groups, tables) {
  let left = 0, held = 0;
  const bits = (count) => {
    let value = 0;
    for (let k = 0; k < count; k++, left--, held >>= 1) {
      if (left === 0) [held, left] = [bytes.byte(), 8];
      value |= (held & 1) << k;
    }
    return value;
  };
  const cells = [];
  for (let k = 0, at = 0; k < classes; k++)
    for (let group = 0; group < groups; group++)
      for (let bin = 0; bin < BINS; bin++, at++) {
        const before = group ? cells[at - BINS] : bin ? cells[at - 1] : 0;
        const cell = bits(1) ? before : bits(6);
        must(cell < tables, "its tables are not possible");
        cells.push(cell);
      }
  return cells;
}

// The samples around one, in the order of their weights: W, WW, NWW, NW, NE, NEE, NNWW, NNW, NN, NNE, NNEE.
const around = (near, far, j, west, farther) =>
  [west, farther, near[j], near[j + 1], near[j + 3], near[j + 4], far[j], far[j + 1], far[j + 2], far[j + 3], far[j + 4]];

function weighed(row, weights, near, far, j, west, farther) {
  const north = near[j + 2];
  if (row === 0) return (2048 + Math.imul(6144, west - north) - Math.imul(2048, farther - north)) | 0;
  return around(near, far, j, west, farther).reduce((sum, s, k) => (sum + Math.imul(weights[k], s - north)) | 0, 2048);
}

// What tells how good a prediction is: errors and differences above, then to the left.
function signs(near, far, above, further, j, west, farther, last, said, guess) {
  const [nw, n, ne, nee] = [near[j + 1], near[j + 2], near[j + 3], near[j + 4]];
  const left = [size(west - nw), size(west - farther), size(said), size(west - guess)];
  return [
    above[j + 2], above[j + 1], above[j + 3], above[j], above[j + 4], further[j + 2], size(n - nw), size(n - ne),
    size(n - far[j + 2]), size(ne - far[j + 3]), size(nw - far[j + 1]), size(ne - nee), last, ...left,
  ];
}

// [its bin, whether what is left is told with the other sign]
function binOf(activity, t) {
  const beyond = (t & 4095) - 2048, lean = t - 2048, far = Math.floor(Math.abs(lean) / 16);
  if (activity < SMALL) return [Math.min(Math.abs(beyond) >> 9, 3), beyond < 0];
  return [(2 * far > activity) + (far > activity) + (far > 2 * activity) + (far > 4 * activity), lean < 0];
}

function continued(line) {
  const last = line.length - 3, cols = line.length - 4;
  const left = cols > 1 ? line[2] - line[3] : 0, right = cols > 1 ? line[last] - line[last - 1] : 0;
  for (let k = 1; k < 3; k++) [line[2 - k], line[last + k]] = [line[2] + k * left, line[last] + k * right];
}

export function decode(data, rows, cols) {
  const bytes = new Bytes(data);
  must(bytes.byte() === 2, "it is of another version of the codec, or no chunk of it");
  const mode = bytes.byte(), kinds = bytes.byte(), shift = bytes.byte();
  must(mode <= 2 && (kinds === 1 || kinds === 4) && shift <= 15, "its head is not possible");
  const first = bytes.take(4, DataView.prototype.getInt32), groups = bytes.byte(), count = bytes.byte(), parts = bytes.byte();
  const high = parts === 2 ? 2 * Math.ceil(rows / 4) : rows;
  must(groups >= 1 && groups <= 32 && count >= 1 && count <= 48, "its head is not possible");
  must(parts === 1 || (parts === 2 && high < rows), "its head is not possible");
  const nested = kinds === 4, classes = Array.from({ length: nested ? 3 : 1 }, () => ({
    weights: Array.from({ length: 11 }, () => bytes.take(2, DataView.prototype.getInt16)),
    shares: Array.from({ length: 17 }, () => bytes.byte()),
  }));
  const least = Array.from({ length: groups - 1 }, () => bytes.take(2, DataView.prototype.getUint16));
  const groupOf = Array.from({ length: 1024 }, (_, step) => least.filter((l) => step >= l).length);
  const cells = tablesByCell(bytes, classes.length, groups, count);
  const tables = Array.from({ length: count }, () => table(bytes));
  const marks = mode ? missing(bytes, mode, rows, cols) : new Uint8Array(rows * cols);
  const out = new Int32Array(rows * cols), one = { cols, nested, shift, classes, groups, groupOf, cells, tables };
  if (parts === 1) {
    decodePart(one, first, new Stream(bytes, 1), marks, out);
    must(bytes.at === data.length, "its stream does not end where it must");
  } else {
    const second = bytes.take(4, DataView.prototype.getInt32), words = bytes.take(4, DataView.prototype.getUint32);
    const at = bytes.at, from = at + 8, middle = from + 2 * words;
    must(middle <= data.length, "it is cut off");
    const stream = (k, begin, end) => new Bytes(new Uint8Array([...data.subarray(at + 4 * k, at + 4 * k + 4), ...data.subarray(begin, end)]));
    const upper = stream(0, from, middle), lower = stream(1, middle, data.length);
    decodePart(one, first, new Stream(upper, 1), marks.subarray(0, high * cols), out.subarray(0, high * cols));
    decodePart(one, second, new Stream(lower, 1), marks.subarray(high * cols), out.subarray(high * cols));
    must(upper.at === 4 + 2 * words && lower.at === 4 + data.length - middle, "its stream does not end where it must");
  }
  for (let k = 0; k < out.length; k++) if (marks[k]) out[k] = MISSING;
  return out;
}

// Decodes the rows of a part, missing samples filled, into ``out``.
function decodePart({ cols, nested, shift, classes, groups, groupOf, cells, tables }, first, stream, marks, out) {
  const rows = out.length / cols;
  let far = new Int32Array(cols + 4).fill(first), near = far, further = new Int32Array(cols + 4), above = further;
  for (let row = 0; row < rows; row++) {
    if (row === 1) far = near;
    const line = new Int32Array(cols + 4), sizes = new Int32Array(cols + 4);
    let west = (near[1] + near[2] - far[2]) | 0, farther = (near[0] + near[2] - far[2]) | 0;
    for (let j = 0; j < cols; j++) {
      const part = nested ? 2 * (row & 1) + (j & 1) - 1 : 0;
      let here = part < 0 ? 0 : near[j + 2];
      if (part >= 0 && !marks[row * cols + j]) {
        const { weights, shares: own } = classes[part], shares = row ? own : FIRST, t = weighed(row, weights, near, far, j, west, farther);
        const said = t >> 12, guess = (here + said) | 0;
        const seen = signs(near, far, above, further, j, west, farther, sizes[j + 1], said, guess);
        const activity = seen.reduce((sum, sign, k) => sum + sign * shares[k], 0), [bin, other] = binOf(activity, t);
        const group = groupOf[Math.min(activity >> shift, 1023)];
        const value = valueOf(stream, tables[cells[(part * groups + group) * BINS + bin]]), residual = unzigzag(value);
        here = (guess + (other ? -residual : residual)) | 0;
        sizes[j + 2] = Math.min(Math.floor((value + 1) / 2), 4095);
      }
      [line[j + 2], farther, west] = [here, west, here];
    }
    continued(line);
    out.set(line.subarray(2, cols + 2), row * cols);
    [far, near, further, above] = [near, line, above, sizes];
  }
  must(stream.states[0] === 65536, "its stream does not end where it must");
}

function valueOf(stream, { depth, direct, ...symbols }) {
  let value = stream.symbol(0, symbols);
  if (value >= direct) value = direct - 1 + stream.range(0, value - direct);
  return (depth ? value * 2 ** depth + stream.bits(0, depth) : value) % 2 ** 32;
}
