"""The codec *smallest*, decoded as docs/codec.md says, in plain Python: what the kernels are tested against."""

from __future__ import annotations

import struct

import numpy as np
from compact_reference import LANES, Stream, mask, table, values_of, wrapped

BINS, GROUPS, LAG, SMALL = 5, 64, 3, 307
TOP = (6144, -2048, *[0] * 9), [*[0] * 12, 128, 0, 128, 0, 0]


def size(difference):
    return min(abs(wrapped(difference)), 4095)


def cells_of(data, at, classes):
    """The table of each (class, group, bin), and where they end."""
    bits = [data[at + k // 8] >> k % 8 & 1 for k in range(8 * (len(data) - at))]
    read, cells = 0, {}
    for k in range(classes):
        for group in range(GROUPS):
            for bin_ in range(BINS):
                before = cells[k, group - 1, bin_] if group else cells[k, group, bin_ - 1] if bin_ else 0
                same, read = bits[read], read + 1
                if not same:
                    before = sum(bit << n for n, bit in enumerate(bits[read : read + 6]))
                    read += 6
                cells[k, group, bin_] = before
    return cells, at + -(-read // 8)


def bits_of(data, count):
    """Numbers of so many bits each, lowest first, that begin where the last one ends."""
    whole = int.from_bytes(data, "little")
    for bits in count:
        yield whole % (1 << bits)
        whole >>= bits


def sets_of(data, at, form):
    """The limits of tests, the (weights, shares) of all sets, and where they end."""
    if form != 8:
        ends = [at + 39 * k for k in range({1: 1, 4: 3}[form])]
        return None, [(struct.unpack_from("<11h", data, k), list(data[k + 22 : k + 39])) for k in ends], ends[-1] + 39
    limits, sets = struct.unpack_from("<3H", data, at), []
    for k in range(8):
        begin = at + 6 + 28 * k
        found = list(bits_of(data[begin : begin + 28], [11] * 11 + [6] * 17))
        sets.append(([16 * ((w + 1024) % 2048 - 1024) for w in found[:11]], [4 * s for s in found[11:]]))
    return limits, sets, at + 230


def factors_of(row, sets, part, tests):
    """The weights and shares of a sample: in the second row, the row above also counts as the one two above."""
    if row == 0:
        return TOP
    if row > 1:
        return sets[part + sum(1 << k for k, holds in enumerate(tests) if holds)]
    (w, ww, nww, nw, ne, nee, nnww, nnw, _, nne, nnee), shares = sets[part]
    shares = [0 if k in (5, 8, 9, 10) else share for k, share in enumerate(shares)]
    return (w, ww, nww + nnww, nw + nnw, ne + nne, nee + nnee, 0, 0, 0, 0, 0), shares


def tests_of(samples, row, col, limits):
    """Whether N differs from NW, NE and NN by more than the limits."""
    (far, near), north = samples[row : row + 2], samples[row + 1][col + 2]
    others = (near[col + 1], near[col + 3], far[col + 2])
    return [size(north - other) > limit for other, limit in zip(others, limits or (), strict=False)]


def group_of(activity):
    bits = activity.bit_length()
    return min(4 * (bits - 7) + (activity >> (bits - 3)) % 4, GROUPS - 1) if bits >= 7 else 0


def bin_of(activity, t):
    """(The bin, whether the difference is told with the other sign)."""
    beyond, lean = t % 4096 - 2048, wrapped(t - 2048)
    if activity < SMALL:
        return min(abs(beyond) // 512, 3), beyond < 0
    return sum(abs(lean) // 16 > limit for limit in (activity / 2, activity, 2 * activity, 4 * activity)), lean < 0


def foreseen(samples, sizes, row, col, weights, shares):
    """(The prediction, the group and bin, whether the sign is reversed) of a sample; rows and columns begin at -2."""
    (far, near, line), (further, above, left) = samples[row : row + 3], sizes[row : row + 3]
    nww, nw, north, ne, nee = near[col : col + 5]
    around = [line[col + 1], line[col], nww, nw, ne, nee, *far[col : col + 5]]
    west, farther = around[:2]
    t = wrapped(sum(w * (s - north) for w, s in zip(weights, around, strict=True)) + 2048)
    said, guess = t >> 12, wrapped(north + (t >> 12))
    signs = [above[col + k] for k in (2, 1, 3, 0, 4)] + [further[col + 2], size(north - nw), size(north - ne)]
    signs += [size(north - far[col + 2]), size(ne - far[col + 3]), size(nw - far[col + 1]), size(ne - nee)]
    signs += [left[col + 1], size(west - nw), size(west - farther), size(said), size(west - guess)]
    activity = sum(s * share for s, share in zip(signs, shares, strict=True))
    bin_, other = bin_of(activity, t)
    return guess, (group_of(activity), bin_), other


def decoded(data, shape):
    """The samples, int32."""
    rows, cols = shape
    version, mode, form, count, origin, factor = struct.unpack_from("<4BiI", data)
    assert version == 4 and form in (1, 4, 8)
    limits, sets, at = sets_of(data, 12, form)
    cells, at = cells_of(data, at, 3 if form == 4 else 1)
    tables = []
    for _ in range(count):
        one, at = table(data, at)
        tables.append(one)
    marks, at = mask(data, at, mode, shape) if mode else (np.zeros(shape, bool), at)
    stream, period = Stream(data[at:], min(rows, LANES)), max((cols + 5) // 2 * 2, LAG * LANES)
    samples, sizes = ([[0] * (cols + 4) for _ in range(rows + 2)] for _ in range(2))
    for step in range(-(-rows // LANES) * period + LAG * (LANES - 1)):
        places = [(lane, *divmod(step - LAG * lane, period)) for lane in range(LANES) if step >= LAG * lane]
        places = [(lane, band * LANES + lane, col) for lane, band, col in places if col < cols]
        coded = []
        for lane, row, col in places:
            if row >= rows:
                continue
            line, part = samples[row + 2], 2 * (row % 2) + col % 2 - 1 if form == 4 else 0
            if col == 0:
                line[:2] = [samples[row + 1][2]] * 2
            if part < 0 or marks[row, col]:
                line[col + 2] = line[col + 1]
            else:
                factors = factors_of(row, sets, part, tests_of(samples, row, col, limits))
                guess, cell, other = foreseen(samples, sizes, row, col, *factors)
                coded.append((lane, row, col, guess, other, tables[cells[part, *cell]]))
        values = values_of(stream, [(one[0], one[-1]) for one in coded])
        for (_, row, col, guess, other, _), value in zip(coded, values, strict=True):
            residual = value // 2 if value % 2 == 0 else -(value // 2) - 1
            samples[row + 2][col + 2] = wrapped(guess - residual if other else guess + residual)
            sizes[row + 2][col + 2] = min((value + 1) // 2, 4095)
        for _, row, col in places:
            if row < rows and col == cols - 1:
                samples[row + 2][cols + 2 :] = [samples[row + 2][cols + 1]] * 2
    assert not stream.words and all(state == 1 << 16 for state in stream.states)
    found = np.array([[wrapped(origin + factor * k) for k in line[2:-2]] for line in samples[2:]], np.int32)
    if form == 4:
        found[::2, ::2] = 0
    found[marks] = -(2**31)
    return found
