"""The codec *smallest*, decoded as docs/codec.md says, in plain Python: what the kernels are tested against."""

from __future__ import annotations

import struct

import numpy as np
from compact_reference import Stream, mask, table, wrapped

BINS, SMALL = 5, 307


def size(difference):
    return min(abs(wrapped(difference)), 4095)


def cells_of(data, at, classes, groups):
    """The table of each (class, group, bin), and where they end."""
    bits = [data[at + k // 8] >> k % 8 & 1 for k in range(8 * (len(data) - at))]
    read, cells = 0, {}
    for k in range(classes):
        for group in range(groups):
            for bin_ in range(BINS):
                before = cells[k, group - 1, bin_] if group else cells[k, group, bin_ - 1] if bin_ else 0
                same, read = bits[read], read + 1
                if not same:
                    before = sum(bit << n for n, bit in enumerate(bits[read : read + 6]))
                    read += 6
                cells[k, group, bin_] = before
    return cells, at + -(-read // 8)


def continued(line):
    left, right = (line[0] - line[1], line[-1] - line[-2]) if len(line) > 1 else (0, 0)
    before = [wrapped(line[0] + k * left) for k in (2, 1)]
    return before + line + [wrapped(line[-1] + k * right) for k in (1, 2)]


def bin_of(activity, t):
    """(The bin, whether the difference is told with the other sign)."""
    beyond, lean = t % 4096 - 2048, t - 2048
    if activity < SMALL:
        return min(abs(beyond) // 512, 3), beyond < 0
    return sum(abs(lean) // 16 > limit for limit in (activity / 2, activity, 2 * activity, 4 * activity)), lean < 0


def value_of(stream, one):
    depth, direct, freq = one
    value = stream.symbol(0, freq)
    if value >= direct:
        value = stream.range(0, value - direct) + direct - 1
    return (value << depth | (stream.bits(0, depth) if depth else 0)) % 2**32


def decoded(data, shape):
    """The samples, int32."""
    rows = shape[0]
    version, mode, kinds, shift, first, groups, count, parts = struct.unpack_from("<4Bi3B", data)
    assert version == 2 and kinds in (1, 4) and parts in (1, 2)
    at, classes = 11, []
    for _ in range(1 if kinds == 1 else 3):
        classes.append((struct.unpack_from("<11h", data, at), list(data[at + 22 : at + 39])))
        at += 39
    least = struct.unpack_from(f"<{groups - 1}H", data, at)
    cells, at = cells_of(data, at + 2 * (groups - 1), len(classes), groups)
    tables = []
    for _ in range(count):
        one, at = table(data, at)
        tables.append(one)
    marks, at = mask(data, at, mode, shape) if mode else (np.zeros(shape, bool), at)
    if parts == 1:
        streams = [(first, data[at:], 0, rows)]
    else:
        second, words, one, other = struct.unpack_from("<i3I", data, at)
        high, begin = -(-rows // 4) * 2, at + 16
        assert high < rows
        streams = [
            (first, struct.pack("<I", one) + data[begin : begin + 2 * words], 0, high),
            (second, struct.pack("<I", other) + data[begin + 2 * words :], high, rows),
        ]
    out = [
        part_of(above, Stream(words, 1), marks[begin:end], kinds, shift, classes, least, cells, tables)
        for above, words, begin, end in streams
    ]
    found = np.concatenate(out)
    found[marks] = -(2**31)
    return found


def part_of(first, stream, marks, kinds, shift, classes, least, cells, tables):
    """The samples of a part, the missing ones filled."""
    rows, cols = marks.shape
    samples, sizes = [[first] * (cols + 4)] * 2, [[0] * (cols + 4)] * 2
    for row in range(rows):
        (far, near), (further, above) = samples[-2:], sizes[-2:]
        far = near if row == 1 else far
        west, farther = (wrapped(near[k] + near[2] - far[2]) for k in (1, 0))
        line, left = [], [0, 0]
        for j in range(cols):
            part = 2 * (row % 2) + j % 2 - 1 if kinds == 4 else 0
            here, last = 0 if part < 0 else near[j + 2], 0
            if part >= 0 and not marks[row, j]:
                weights, shares = classes[part]
                north, (nw, n, ne, nee) = near[j + 2], near[j + 1 : j + 5]
                around = [west, farther, *near[j : j + 2], *near[j + 3 : j + 5], *far[j : j + 5]]
                if row == 0:
                    weights, shares = (6144, -2048, *[0] * 9), [*[0] * 12, 128, 0, 128, 0, 0]
                t = wrapped(sum(w * (s - north) for w, s in zip(weights, around, strict=True)) + 2048)
                said, guess = t >> 12, wrapped(north + (t >> 12))
                signs = [above[j + k] for k in (2, 1, 3, 0, 4)] + [further[j + 2], size(n - nw), size(n - ne)]
                signs += [size(n - far[j + 2]), size(ne - far[j + 3]), size(nw - far[j + 1]), size(ne - nee), left[-1]]
                signs += [size(west - nw), size(west - farther), size(said), size(west - guess)]
                activity = sum(s * share for s, share in zip(signs, shares, strict=True))
                bin_, other = bin_of(activity, t)
                group = sum(min(activity >> shift, 1023) >= limit for limit in least)
                value = value_of(stream, tables[cells[part, group, bin_]])
                residual = value // 2 if value % 2 == 0 else -(value // 2) - 1
                here = wrapped(guess - residual if other else guess + residual)
                last = min((value + 1) // 2, 4095)
            line.append(here)
            left.append(last)
            farther, west = west, here
        samples.append(continued(line))
        sizes.append([*left, 0, 0])
    assert not stream.words and stream.states == [1 << 16]
    return np.array([line[2:-2] for line in samples[2:]], np.int32)
