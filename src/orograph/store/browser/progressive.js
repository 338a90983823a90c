// Decodes a chunk of a level of a progressive store (docs/codec.md, "The profile progressive"): an Int32Array of rows ×
// cols heights in small steps, -2^31 where missing. It needs smallest.js and compact.js beside it:
//
//   import { decode } from "./progressive.js";
//   const numbers = decode(bytes, 256, 256, coarse, { factor, exact });
//
// bytes: Uint8Array, without the crc32c behind it. coarse: the samples of the level above in even rows and columns,
// ceil(rows / 2) × ceil(cols / 2), as this function made them (of the top level: smallest.js's times factor). lastRow,
// lastCol: true where the chunk's last row or column is the array's and has an odd number: then the level above has it,
// too, and coarse has one more. factor, exact: from the array's attribute `prediction`.

import { MISSING } from "./compact.js";
import { decode as differences } from "./smallest.js";

// Missing samples count as the nearest before them, before the first as the first; null if there is none.
function filled(line) {
  let now = line.find((v) => v !== MISSING);
  return now === undefined ? null : Array.from(line, (v) => (v === MISSING ? now : (now = v)));
}

// 16 times what lies half-way behind each sample.
function between(line) {
  const n = line.length, first = n > 1 ? line[0] - line[1] : 0, last = n > 1 ? line[n - 1] - line[n - 2] : 0;
  const all = [line[0] + first, ...line, line[n - 1] + last, line[n - 1] + 2 * last];
  return line.map((_, k) => 9 * (all[k + 1] + all[k + 2]) - all[k] - all[k + 3]);
}

const rounded = (value, by) => Math.floor((value + by / 2) / by);

function predict(coarse, rows, cols, lastRow, lastCol) {
  const out = new Float64Array(rows * cols), n = (rows + 1) >> 1, m = (cols + 1) >> 1, width = m + lastCol;
  const at = (i, j) => coarse[i * width + j], row = (i) => Array.from({ length: m }, (_, j) => at(i, j));
  const put = (i, j, value) => (out[i * cols + j] = value);
  const along = (i, to) => {
    const line = filled(row(i)), found = line && between(line);
    for (let j = 0; j < m; j++) put(to, 2 * j, at(i, j));
    for (let j = 0; 2 * j + 1 < cols; j++) put(to, 2 * j + 1, found ? rounded(found[j], 16) : 0);
    return found;
  };
  const down = (j, to) => {
    const line = filled(Array.from({ length: n }, (_, i) => at(i, j))), found = line && between(line);
    for (let i = 0; 2 * i + 1 < rows; i++) put(2 * i + 1, to, found ? rounded(found[i], 16) : 0);
  };
  let across = Array.from({ length: n }, (_, i) => along(i, 2 * i)), before = null;
  const first = across.find((line) => line) ?? new Array(m).fill(0);
  across = across.map((line) => (before = line ?? before ?? first)); // a row without samples is the one before it
  for (let j = 0; j < m; j++) down(j, 2 * j);
  for (let j = 0; 2 * j + 1 < cols; j++) {
    const found = between(across.map((line) => line[j]));
    for (let i = 0; 2 * i + 1 < rows; i++) put(2 * i + 1, 2 * j + 1, rounded(found[i], 256));
  }
  if (lastRow) along(n, rows - 1);
  if (lastCol) down(m, cols - 1);
  for (let i = 0; lastCol && i < n; i++) put(2 * i, cols - 1, at(i, m));
  if (lastRow && lastCol) put(rows - 1, cols - 1, at(n, m));
  return out;
}

export function decode(data, rows, cols, coarse, { factor, exact, lastRow = false, lastCol = false }) {
  const size = (Math.ceil(rows / 2) + lastRow) * (Math.ceil(cols / 2) + lastCol);
  if (coarse.length !== size) throw new RangeError(`The level above has ${coarse.length} samples here, not ${size}`);
  const stored = differences(data, rows, cols), out = new Int32Array(rows * cols);
  const predicted = predict(coarse, rows, cols, Number(lastRow), Number(lastCol));
  for (let i = 0, k = 0; i < rows; i++) {
    const known = i % 2 === 0 || (lastRow && i === rows - 1);
    for (let j = 0; j < cols; j++, k++) {
      if (known && (j % 2 === 0 || (lastCol && j === cols - 1))) out[k] = predicted[k];
      else if (stored[k] === MISSING) out[k] = MISSING;
      else out[k] = (exact ? Math.floor((predicted[k] + (factor >> 1)) / factor) * factor : predicted[k]) + stored[k] * factor;
    }
  }
  return out;
}
