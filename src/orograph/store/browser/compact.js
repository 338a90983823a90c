// Decodes a chunk of the codec "orograph.compact" (docs/codec.md has the format) into an Int32Array of rows × cols
// samples, -2^31 where missing. Throws a RangeError at bytes that are no such chunk. It needs nothing else:
//
//   import { decode } from "./compact.js";
//   const numbers = decode(bytes, 256, 256);  // bytes: Uint8Array, without the crc32c behind it
//   const height = numbers[row * 256 + col] * scale_factor;

export const MISSING = -(2 ** 31), LANES = 16;

export class Bytes {
  constructor(data) {
    this.data = data;
    this.view = new DataView(data.buffer, data.byteOffset, data.byteLength);
    this.at = 0;
  }
  byte() {
    must(this.at < this.data.length, "it ends too early");
    return this.data[this.at++];
  }
  take(size, read) {
    const at = this.at;
    this.at += size;
    return read.call(this.view, at, true); // (beyond the end it throws a RangeError of its own)
  }
}

export function must(held, what) {
  if (!held) throw new RangeError(`A chunk cannot be decoded: ${what}`);
}

export const unzigzag = (v) => (v >>> 1) ^ -(v & 1);

export function table(bytes) {
  const depth = bytes.byte(), direct = bytes.byte(), count = direct + bytes.byte();
  must(depth <= 16 && direct <= 224 && count - direct <= 32 && count > 0, "a table is not possible");
  let left = 0, held = 0;
  const bit = () => {
    if (left === 0) [held, left] = [bytes.byte(), 8];
    left--;
    const low = held & 1;
    held >>= 1;
    return low;
  };
  const weights = [];
  for (let s = 0, code = 36; s < count; s++) {
    let ones = 0;
    while (bit()) ones++;
    code += unzigzag((ones << 1) | bit());
    must(code >= 0 && code <= 47, "a table is not possible");
    weights.push(code < 8 ? code : (4 + (code & 3)) << ((code >> 2) - 1));
  }
  const total = weights.reduce((a, b) => a + b), most = weights.indexOf(Math.max(...weights));
  must(total > 0, "a table is not possible");
  const frequencies = weights.map((w) => (w ? Math.max(Math.floor((4096 * w) / total), 1) : 0));
  frequencies[most] += 4096 - frequencies.reduce((a, b) => a + b);
  must(frequencies[most] > 0, "a table is not possible");
  const symbols = new Uint8Array(4096), begins = [];
  for (let s = 0, slot = 0; s < count; slot += frequencies[s++]) {
    begins.push(slot);
    symbols.fill(s, slot, slot + frequencies[s]);
  }
  return { depth, direct, frequencies, begins, symbols };
}

export function missing(bytes, mode, rows, cols) {
  const marks = new Uint8Array(rows * cols);
  for (let at = 0, bit = 0; at < marks.length; bit ^= 1) {
    let run = 0, shift = 0, byte;
    do {
      must(shift <= 35, "a run of missing samples is not possible");
      byte = bytes.byte();
      run += (byte & 127) * 2 ** shift;
      shift += 7;
    } while (byte > 127);
    must(run <= marks.length - at, "a run of missing samples is not possible");
    marks.fill(bit, at, (at += run));
  }
  if (mode === 2) for (let k = cols; k < marks.length; k++) marks[k] ^= marks[k - cols];
  return marks;
}

export class Stream {
  constructor(bytes, lanes) {
    this.states = Array.from({ length: lanes }, () => bytes.take(4, DataView.prototype.getUint32));
    this.bytes = bytes;
  }
  feed(lane, state) {
    this.states[lane] = state < 65536 ? state * 65536 + this.bytes.take(2, DataView.prototype.getUint16) : state;
  }
  symbol(lane, { frequencies, begins, symbols }) {
    const state = this.states[lane], slot = state & 4095, s = symbols[slot];
    this.feed(lane, frequencies[s] * (state >>> 12) + slot - begins[s]);
    return s;
  }
  bits(lane, count) {
    const state = this.states[lane];
    this.feed(lane, state >>> count);
    return state & ((1 << count) - 1);
  }
}

// Gives each of the samples that are coded side by side, {lane, table}, its value.
export function decodeStep(stream, coded) {
  for (const one of coded) one.value = stream.symbol(one.lane, one.table);
  const ranges = coded.filter(({ value, table }) => value >= table.direct);
  for (const one of ranges) {
    one.bits = one.value - one.table.direct;
    one.low = stream.bits(one.lane, Math.min(one.bits, 16));
  }
  for (const one of ranges) {
    const high = one.bits > 16 ? stream.bits(one.lane, one.bits - 16) : 0;
    one.value = one.table.direct - 1 + 2 ** one.bits + one.low + high * 65536;
  }
  for (const one of coded) {
    const { depth } = one.table;
    one.value = (depth ? one.value * 2 ** depth + stream.bits(one.lane, depth) : one.value) % 2 ** 32;
  }
}

export function decode(data, rows, cols) {
  const bytes = new Bytes(data);
  must(bytes.byte() === 3, "it is of another version of the codec, or no chunk of it");
  const mode = bytes.byte(), contexts = bytes.byte(), shift = bytes.byte();
  must(mode <= 2 && contexts >= 1 && contexts <= 8 && shift <= 15, "its head is not possible");
  const origin = bytes.take(4, DataView.prototype.getInt32), factor = bytes.take(4, DataView.prototype.getUint32);
  const weights = Array.from({ length: 11 }, () => bytes.take(2, DataView.prototype.getInt16));
  const least = Array.from({ length: contexts - 1 }, () => bytes.byte());
  const all = Array.from({ length: contexts }, () => table(bytes));
  const byLevel = Array.from({ length: 256 }, (_, level) => all[least.filter((l) => level >= l).length]);
  const marks = mode ? missing(bytes, mode, rows, cols) : null;
  const stream = new Stream(bytes, LANES);
  const width = LANES * Math.ceil(cols / LANES), values = new Uint32Array(width), magnitude = new Int32Array(width + 4);
  const tables = new Array(width).fill(byLevel[0]);
  const out = new Int32Array(rows * cols);
  for (let row = 0; row < rows; row++) {
    for (let col = 0; col < width; col += LANES) {
      const coded = Array.from({ length: LANES }, (_, lane) => ({ lane, table: tables[col + lane] }));
      decodeStep(stream, coded);
      for (const { lane, value } of coded) values[col + lane] = value;
    }
    rebuild(out, row, cols, values, weights);
    for (let j = 0; j < width; j++) magnitude[j + 2] = Math.min(values[j], 65535);
    for (let j = 0; j < width; j++) {
      const m = magnitude.subarray(j, j + 5);
      tables[j] = byLevel[Math.min((3 * m[2] + 2 * (m[1] + m[3]) + m[0] + m[4]) >> shift, 255)];
    }
  }
  must(bytes.at === data.length && stream.states.every((s) => s === 65536), "its stream does not end where it must");
  for (let k = 0; k < out.length; k++) out[k] = marks?.[k] ? MISSING : origin + Math.imul(factor, out[k]);
  return out;
}

function rebuild(out, row, cols, values, w) {
  const here = row * cols;
  if (row === 0) {
    for (let col = 0, west = 0; col < cols; col++) out[col] = west = (west + unzigzag(values[col])) | 0;
    return;
  }
  const near = here - cols, far = row === 1 ? near : near - cols, last = cols - 1;
  let west = out[near], farther = west;
  for (let col = 0; col < cols; col++) {
    const a = Math.max(col - 2, 0), b = Math.max(col - 1, 0), c = Math.min(col + 1, last), d = Math.min(col + 2, last);
    const north = out[near + col], part = (k, sample) => Math.imul(w[k], sample - north);
    let sum = part(0, west) + part(1, farther) + part(2, out[near + a]) + part(3, out[near + b]);
    sum += part(4, out[near + c]) + part(5, out[near + d]) + part(6, out[far + a]) + part(7, out[far + b]);
    sum += part(8, out[far + col]) + part(9, out[far + c]) + part(10, out[far + d]);
    farther = west;
    out[here + col] = west = (north + (((sum + 2048) | 0) >> 12) + unzigzag(values[col])) | 0;
  }
}
