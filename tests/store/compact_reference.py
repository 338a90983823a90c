"""The codec *compact*, decoded as docs/codec.md says, in plain Python: what the kernels are tested against."""

from __future__ import annotations

import struct

import numpy as np

LANES = 16


def wrapped(value):
    """As int32."""
    return (value + 2**31) % 2**32 - 2**31


def frequencies(codes):
    weights = [c if c < 8 else (4 + c % 4) << (c // 4 - 1) for c in codes]
    total = sum(weights)
    found = [max(w * 4096 // total, 1) if w else 0 for w in weights]
    found[weights.index(max(weights))] += 4096 - sum(found)
    return found


def table(data, at):
    """(Bits below, values, frequencies) of a context, and where its table ends."""
    depth, direct, ranges = data[at : at + 3]
    bits = (data[at + 3 + k // 8] >> k % 8 & 1 for k in range(8 * len(data)))
    read, codes, code = 0, [], 36
    for _ in range(direct + ranges):
        ones = 0
        while next(bits):
            ones += 1
        value = 2 * ones + next(bits)
        read += ones + 2
        code += value // 2 if value % 2 == 0 else -(value // 2) - 1
        codes.append(code)
    return (depth, direct, frequencies(codes)), at + 3 + -(-read // 8)


def mask(data, at, mode, shape):
    """Which samples are missing, and where the runs end."""
    found, bit = [], False
    while len(found) < shape[0] * shape[1]:
        run = shift = 0
        while True:
            run |= (data[at] & 127) << shift
            shift, at = shift + 7, at + 1
            if data[at - 1] < 128:
                break
        found += [bit] * run
        bit = not bit
    marks = np.array(found).reshape(shape)
    return (np.logical_xor.accumulate(marks, axis=0) if mode == 2 else marks), at


class Stream:
    """States, and the words that feed them."""

    def __init__(self, data, lanes=LANES):
        self.states = list(struct.unpack_from(f"<{lanes}I", data))
        self.words = list(struct.unpack(f"<{(len(data) - 4 * lanes) // 2}H", data[4 * lanes :]))[::-1]

    def feed(self, lane):
        if self.states[lane] < 1 << 16:
            self.states[lane] = self.states[lane] << 16 | self.words.pop()

    def symbol(self, lane, freq):
        state = self.states[lane]
        slot, below = state % 4096, 0
        symbol = 0
        while slot >= below + freq[symbol]:
            below += freq[symbol]
            symbol += 1
        self.states[lane] = freq[symbol] * (state // 4096) + slot - below
        self.feed(lane)
        return symbol

    def bits(self, lane, count):
        value = self.states[lane] % (1 << count)
        self.states[lane] >>= count
        self.feed(lane)
        return value


def values_of(stream, step):
    """The values of samples that are coded side by side: (lane, table) of each."""
    found = [stream.symbol(lane, freq) for lane, (_, _, freq) in step]
    ranges = [(k, lane, found[k] - one[1]) for k, (lane, one) in enumerate(step) if found[k] >= one[1]]
    for k, lane, bits in ranges:
        found[k] = step[k][1][1] - 1 + 2**bits + stream.bits(lane, min(bits, 16))
    for k, lane, bits in ranges:
        found[k] += stream.bits(lane, bits - 16) << 16 if bits > 16 else 0
    for k, (lane, (depth, _, _)) in enumerate(step):
        found[k] = (found[k] << depth | (stream.bits(lane, depth) if depth else 0)) % 2**32
    return found


def decoded(data, shape):
    """The samples, int32."""
    rows, cols = shape
    version, mode, number, shift, origin, factor = struct.unpack_from("<4BiI", data)
    assert version == 3
    weights = struct.unpack_from("<11h", data, 12)
    bounds, at, tables = list(data[34 : 33 + number]), 33 + number, []
    for _ in range(number):
        one, at = table(data, at)
        tables.append(one)
    marks = np.zeros(shape, bool)
    if mode:
        marks, at = mask(data, at, mode, shape)
    stream = Stream(data[at:])
    levels = [0] * (-(-cols // LANES) * LANES)
    lines = []
    for _ in range(rows):
        own, values = [tables[sum(level >= b for b in bounds)] for level in levels], []
        for col in range(0, len(own), LANES):
            values += values_of(stream, list(enumerate(own[col : col + LANES])))
        m = [0, 0, *(min(v, 65535) for v in values), 0, 0]
        levels = [
            min((3 * m[j] + 2 * (m[j - 1] + m[j + 1]) + m[j - 2] + m[j + 2]) >> shift, 255)
            for j in range(2, len(m) - 2)
        ]
        lines.append(line_of(values[:cols], weights, lines[-2:]))
    assert not stream.words and stream.states == [1 << 16] * LANES
    out = np.array([[wrapped(origin + factor * k) for k in line] for line in lines], np.int32)
    out[marks] = -(2**31)
    return out


def line_of(values, weights, above):
    """The samples of a row, of those of the rows above."""
    differences = [v // 2 if v % 2 == 0 else -(v // 2) - 1 for v in values]
    if not above:
        return [wrapped(sum(differences[: k + 1])) for k in range(len(differences))]
    line = []
    far, near = ([row[0]] * 2 + row + [row[-1]] * 2 for row in (above[0], above[-1]))
    west = farther = above[-1][0]
    for col, d in enumerate(differences):
        around = [west, farther, *near[col : col + 2], *near[col + 3 : col + 5], *far[col : col + 5]]
        north = near[col + 2]
        total = wrapped(sum(w * (a - north) for w, a in zip(weights, around, strict=True)) + 2048)
        farther, west = west, wrapped(north + (total >> 12) + d)
        line.append(west)
    return line
