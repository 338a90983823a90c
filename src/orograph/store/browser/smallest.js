// Decodes a chunk of the codec "orograph.smallest" (docs/codec.md has the format) into an Int32Array of rows × cols
// samples, -2^31 where missing. Throws a RangeError at bytes that are no such chunk. It needs compact.js beside it:
//
//   import { decode } from "./smallest.js";
//   const numbers = decode(bytes, 256, 256);  // bytes: Uint8Array, without the crc32c behind it

import { Bytes, LANES, MISSING, Stream, decodeStep, missing, must, table, unzigzag } from "./compact.js";

const BINS = 5, GROUPS = 64, LAG = 3, SMALL = 307;
const TOP = { weights: [6144, -2048, 0, 0, 0, 0, 0, 0, 0, 0, 0], shares: [...new Array(12).fill(0), 128, 0, 128, 0, 0] };
const size = (difference) => Math.min(Math.abs(difference | 0), 4095);

function bitsOf(bytes) {
  let left = 0, held = 0;
  return (count) => {
    let value = 0;
    for (let k = 0; k < count; k++, left--, held >>= 1) {
      if (left === 0) [held, left] = [bytes.byte(), 8];
      value |= (held & 1) << k;
    }
    return value;
  };
}

// The sets of weights and shares, and the limits of the tests that choose one of eight.
function setsOf(bytes, form) {
  const some = (count, read) => Array.from({ length: count }, read);
  if (form !== 8)
    return {
      limits: [],
      sets: some(form === 4 ? 3 : 1, () => ({
        weights: some(11, () => bytes.take(2, DataView.prototype.getInt16)),
        shares: some(17, () => bytes.byte()),
      })),
    };
  const limits = some(3, () => bytes.take(2, DataView.prototype.getUint16));
  const sets = some(8, () => {
    const bits = bitsOf(bytes);
    return { weights: some(11, () => ((bits(11) << 21) >> 21) * 16), shares: some(17, () => bits(6) * 4) };
  });
  return { limits, sets };
}

function tablesByCell(bytes, classes, tables) {
  const bits = bitsOf(bytes), cells = [];
  for (let k = 0, at = 0; k < classes; k++)
    for (let group = 0; group < GROUPS; group++)
      for (let bin = 0; bin < BINS; bin++, at++) {
        const before = group ? cells[at - BINS] : bin ? cells[at - 1] : 0;
        const cell = bits(1) ? before : bits(6);
        must(cell < tables, "its tables are not possible");
        cells.push(cell);
      }
  return cells;
}

// Weights and shares of a sample of a class. In the second row, the row above also counts as the one two above.
function factorsOf(samples, width, row, col, part, { limits, sets }) {
  if (row === 0) return TOP;
  if (row > 1) {
    const near = (row + 1) * width + col + 2, others = [near - 1, near + 1, near - width];
    const beyond = (limit, k) => size(samples[near] - samples[others[k]]) > limit;
    return sets[part + limits.reduce((sum, limit, k) => sum + (beyond(limit, k) << k), 0)];
  }
  const { weights, shares } = sets[part], [w, ww, nww, nw, ne, nee, nnww, nnw, , nne, nnee] = weights;
  const own = [w, ww, nww + nnww, nw + nnw, ne + nne, nee + nnee, 0, 0, 0, 0, 0];
  return { weights: own, shares: shares.map((share, k) => ([5, 8, 9, 10].includes(k) ? 0 : share)) };
}

// The activity from 0 to 63, four groups per octave.
function groupOf(activity) {
  const bits = 32 - Math.clz32(activity);
  return bits < 7 ? 0 : Math.min(4 * (bits - 7) + ((activity >> (bits - 3)) & 3), GROUPS - 1);
}

// [its bin, whether what is left is told with the other sign]
function binOf(activity, t) {
  const beyond = (t & 4095) - 2048, lean = (t - 2048) | 0, far = Math.floor(Math.abs(lean) / 16);
  if (activity < SMALL) return [Math.min(Math.abs(beyond) >> 9, 3), beyond < 0];
  return [(2 * far > activity) + (far > activity) + (far > 2 * activity) + (far > 4 * activity), lean < 0];
}

// What is known of a sample before it is decoded. samples, sizes: rows of cols + 4, from two above the first row.
function foreseen(samples, sizes, width, row, col, { weights, shares }) {
  const here = (row + 2) * width + col + 2, near = here - width, far = near - width;
  const n = samples[near], [ww, w, nww, nw, ne, nee] = [here - 2, here - 1, near - 2, near - 1, near + 1, near + 2].map((k) => samples[k]);
  const around = [w, ww, nww, nw, ne, nee, ...samples.subarray(far - 2, far + 3)];
  const t = around.reduce((sum, s, k) => (sum + Math.imul(weights[k], s - n)) | 0, 2048), said = t >> 12, guess = (n + said) | 0;
  const signs = [near, near - 1, near + 1, near - 2, near + 2, far].map((k) => sizes[k]);
  signs.push(size(n - nw), size(n - ne), size(n - samples[far]), size(ne - samples[far + 1]), size(nw - samples[far - 1]));
  signs.push(size(ne - nee), sizes[here - 1], size(w - nw), size(w - ww), size(said), size(w - guess));
  const activity = signs.reduce((sum, sign, k) => sum + sign * shares[k], 0), [bin, other] = binOf(activity, t);
  return { here, guess, other, cell: groupOf(activity) * BINS + bin };
}

export function decode(data, rows, cols) {
  const bytes = new Bytes(data);
  must(bytes.byte() === 4, "it is of another version of the codec, or no chunk of it");
  const mode = bytes.byte(), form = bytes.byte(), count = bytes.byte(), nested = form === 4;
  must(mode <= 2 && [1, 4, 8].includes(form) && count >= 1 && count <= 48, "its head is not possible");
  const origin = bytes.take(4, DataView.prototype.getInt32), factor = bytes.take(4, DataView.prototype.getUint32);
  const rules = setsOf(bytes, form), cells = tablesByCell(bytes, nested ? 3 : 1, count);
  const tables = Array.from({ length: count }, () => table(bytes));
  const marks = mode ? missing(bytes, mode, rows, cols) : new Uint8Array(rows * cols);
  const lanes = Math.min(rows, LANES), stream = new Stream(bytes, lanes), width = cols + 4;
  const samples = new Int32Array((rows + 2) * width), sizes = new Int32Array((rows + 2) * width);
  const period = Math.max(2 * Math.floor((cols + 5) / 2), LAG * LANES), steps = Math.ceil(rows / LANES) * period + LAG * (LANES - 1);
  for (let step = 0; step < steps; step++) {
    const coded = [], others = [];
    for (let lane = 0; lane < lanes && LAG * lane <= step; lane++) {
      const since = step - LAG * lane, row = Math.floor(since / period) * LANES + lane, col = since % period;
      if (row >= rows || col >= cols) continue;
      const line = (row + 2) * width;
      if (col === 0) samples.fill(samples[line - width + 2], line, line + 2);
      const part = nested ? 2 * (row & 1) + (col & 1) - 1 : 0;
      if (part < 0 || marks[row * cols + col]) others.push(line + col + 2);
      else {
        const one = foreseen(samples, sizes, width, row, col, factorsOf(samples, width, row, col, part, rules));
        coded.push({ ...one, lane, table: tables[cells[part * GROUPS * BINS + one.cell]] });
      }
    }
    decodeStep(stream, coded);
    for (const { here, guess, other, value } of coded) {
      samples[here] = guess + (other ? -unzigzag(value) : unzigzag(value));
      sizes[here] = Math.min(Math.floor((value + 1) / 2), 4095);
    }
    for (const here of others) samples[here] = samples[here - 1];
    for (const here of [...coded.map((one) => one.here), ...others])
      if (here % width === cols + 1) samples.fill(samples[here], here + 1, here + 3);
  }
  must(bytes.at === data.length && stream.states.every((s) => s === 65536), "its stream does not end where it must");
  const out = new Int32Array(rows * cols);
  for (let row = 0, k = 0; row < rows; row++)
    for (let col = 0; col < cols; col++, k++) {
      const sample = origin + Math.imul(factor, samples[(row + 2) * width + col + 2]);
      out[k] = marks[k] ? MISSING : nested && !((row | col) & 1) ? 0 : sample;
    }
  return out;
}
