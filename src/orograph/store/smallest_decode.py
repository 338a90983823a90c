"""The kernels that decode chunks of the codec *smallest* (``smallest``; docs/codec.md has the format).

A sample's table depends on the sample before it, so a row can only be decoded sample by sample. Instead, sixteen rows
are decoded side by side (``smallest_rows``), in the lanes of vectors: a step decodes a sample of each. Tables, runs
of missing samples and plain bits are those of *compact*. As there, nothing read from a chunk is used as an index
before it is checked, and the words are copied to a buffer that allows reading a block of steps beyond their end.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from orograph._lanes import LANES32, where
from orograph._lanes32 import (
    gather32,
    lane,
    least_unsigned,
    load32,
    marked,
    picked32,
    shifted_in,
    shifted_right,
    store32,
    transpose32,
)
from orograph._numba import inlined, kernel, linked
from orograph.store.codec_head import (
    BITS,
    CUT_OFF,
    LEAST,
    MASK,
    MISSING,
    STREAM,
    TABLES,
    TOTAL,
    UNKNOWN,
    WORDS,
    read_mask,
    read_tables,
    read_words,
    u32,
)
from orograph.store.codec_lanes import Flat, Tables, add_depths, next_values
from orograph.store.smallest_head import FACTORS, MARKS, mark_steps, put_factors, read_cells, read_sets
from orograph.store.smallest_rows import (
    BINS,
    CAP,
    CHOICES,
    CLASSES,
    ENTRIES,
    GROUPS,
    HEADER,
    LAG,
    SETS,
    SIGNS,
    TESTS,
    VERSION,
    WEIGHTS,
    cell_of,
    outcome,
    period_of,
    size_of,
    steps_of,
)

BLOCK = 64  # steps between two checks whether the words have run out
PAST = 5  # earlier steps that a step refers to


class Front(NamedTuple):
    """The state that a step leaves to later ones.

    Each of the first five holds ``BLOCK + PAST`` steps of sixteen lanes, flat: the sample two to the right in the row
    above; the same two rows above; the error of the former; its difference from the sample to its left, and above it.
    ``edges`` are the rows that the first lane continues from: (4, period), the samples of the last and the last but one
    lane, and their errors. ``last``, flat: W, WW, the error at W, and the states.
    """

    above: Flat
    beyond: Flat
    errors: Flat
    across: Flat
    down: Flat
    edges: Flat
    last: Flat


class Rules(NamedTuple):
    """What predicts samples.

    Attributes:
        choices: of weights and shares (``put_choices``).
        factors: flat, of even and odd steps, ``FACTORS`` of sixteen lanes each.
        tests: of each lane: the entry of its choices if no test holds, and the limits of its tests.
        tested: whether there are tests.
    """

    choices: Flat
    factors: Flat
    tests: Flat
    tested: bool


@inlined
def _put_chosen(rules, at, front, o):
    """Put the weights and shares that the tests of this step choose among its factors."""
    across, ahead = load32(front.across, _ago(o, 2)), load32(front.across, _ago(o, 1))
    tests = rules.tests
    limits = load32(tests, LANES32), load32(tests, 2 * LANES32), load32(tests, 3 * LANES32)
    order = load32(tests, 0) + outcome(across, ahead, load32(front.down, _ago(o, 2)), limits)
    for k in range(WEIGHTS + SIGNS):
        store32(rules.factors, at + np.uint64(k * LANES32), picked32(rules.choices, k * ENTRIES, order))


@inlined
def _times(factors, at, k, values):
    """Values times the factor k of each lane."""
    return load32(factors, at + np.uint64(k * LANES32)) * values


@inlined
def _ago(o, steps):
    """The offset of the lanes of an earlier step."""
    return o - np.uint64(steps * LANES32)


@inlined
def _predicted(factors, at, front, o, nee, nnee):
    """The share of the two rows above in the predictions, in 1/4096."""
    above, beyond = front.above, front.beyond
    o1, o2, o3, o4 = _ago(o, 1), _ago(o, 2), _ago(o, 3), _ago(o, 4)
    near = _times(factors, at, 2, load32(above, o4)) + _times(factors, at, 3, load32(above, o3))
    near += _times(factors, at, 4, load32(above, o1)) + _times(factors, at, 5, nee)
    near += _times(factors, at, 11, load32(above, o2))
    far = _times(factors, at, 6, load32(beyond, o4)) + _times(factors, at, 7, load32(beyond, o3))
    far += _times(factors, at, 8, load32(beyond, o2)) + _times(factors, at, 9, load32(beyond, o1))
    return near + far + _times(factors, at, 10, nnee) + 2048


@inlined
def _active(factors, at, front, o, e_nee, e_nn, across):
    """The share of the rows above in the activities, in 1/256."""
    errors, down = front.errors, front.down
    o1, o2, o3, o4 = _ago(o, 1), _ago(o, 2), _ago(o, 3), _ago(o, 4)
    of_errors = _times(factors, at, 12, load32(errors, o2)) + _times(factors, at, 13, load32(errors, o3))
    of_errors += _times(factors, at, 14, load32(errors, o1)) + _times(factors, at, 15, load32(errors, o4))
    of_errors += _times(factors, at, 16, e_nee) + _times(factors, at, 17, e_nn)
    slopes = _times(factors, at, 18, load32(front.across, o2)) + _times(factors, at, 19, load32(front.across, o1))
    slopes += _times(factors, at, 20, load32(down, o2)) + _times(factors, at, 21, load32(down, o1))
    return of_errors + slopes + _times(factors, at, 22, load32(down, o3)) + _times(factors, at, 23, across)


@linked
def _decode_block(count, step, period, p, words, tables, deep, places, rules, coded, starts, front, out):
    """Decode a block of steps; return the next word.

    Args:
        count: the number of steps, at most ``BLOCK``. step: the first. p: the next word of ``words``.
        deep: whether any table has bits below its symbols. places: of each cell's table (``add_depths``).
        coded, starts: (steps,) uint16, the lanes that have a sample in a step, and those that are two before a row.
        out: flat, becomes the samples of each step of the block.
    """
    last, edges, above, beyond, errors = front.last, front.edges, front.above, front.beyond, front.errors
    factors = rules.factors
    west, farther = load32(last, 0), load32(last, LANES32)
    error, states = load32(last, 2 * LANES32), load32(last, 3 * LANES32)
    here = step % period  # the column of the first lane
    behind = (step - LAG * (LANES32 - 1)) % period  # and that of the last one
    for k in range(count):
        o, at = np.uint64((k + PAST) * LANES32), np.uint64(((step + k) & 1) * (FACTORS * LANES32))
        if rules.tested:
            _put_chosen(rules, at, front, o)
        ahead = np.uint64(here + 2 if here + 2 < period else here + 2 - period)
        north, northwest = load32(above, _ago(o, 2)), load32(above, _ago(o, 3))
        nee, nnee = shifted_in(edges[0, ahead], west), shifted_in(edges[1, ahead], northwest)
        e_nee = shifted_in(edges[2, ahead], error)
        e_nn = shifted_in(edges[3, np.uint64(here)], load32(errors, _ago(o, 5)))
        across = size_of(nee - load32(above, _ago(o, 1)))
        store32(above, o, nee)
        store32(beyond, o, nnee)
        store32(errors, o, e_nee)
        store32(front.across, o, across)
        store32(front.down, o, size_of(nee - nnee))
        t = _predicted(factors, at, front, o, nee, nnee)
        active = _active(factors, at, front, o, e_nee, e_nn, across) + _times(factors, at, 24, error)
        active += _times(factors, at, 25, size_of(west - northwest)) + _times(factors, at, 26, size_of(west - farther))
        t = t + _times(factors, at, 1, farther) + _times(factors, at, 0, west)
        said = t >> BITS
        guess = north + said
        active += _times(factors, at, 27, size_of(said)) + _times(factors, at, 28, size_of(west - guess))
        cells, turned = cell_of(active, t)
        mine = marked(coded[np.uint64(step + k)])
        cells += load32(factors, at + np.uint64((FACTORS - 1) * LANES32))
        states, p, values = next_values(states, p, words, tables, deep, gather32(places, cells), mine)
        half, odd = shifted_right(values, 1), values & 1
        found = guess + (((half ^ (0 - odd)) ^ turned) - turned)
        farther, left = west, west
        west = where(mine, found, where(marked(starts[np.uint64(step + k)]), nee, left))
        error = where(mine, least_unsigned(half + odd, CAP), 0)
        store32(out, np.uint64(k * LANES32), west)
        later = np.uint64(behind + LAG if behind + LAG < period else behind + LAG - period)
        edges[0, np.uint64(behind)], edges[1, later] = lane(west, LANES32 - 1), lane(west, LANES32 - 2)
        edges[2, np.uint64(behind)], edges[3, later] = lane(error, LANES32 - 1), lane(error, LANES32 - 2)
        here = here + 1 if here + 1 < period else 0
        behind = behind + 1 if behind + 1 < period else 0
    store32(last, 0, west)
    store32(last, LANES32, farther)
    store32(last, 2 * LANES32, error)
    store32(last, 3 * LANES32, states)
    return p


@linked
def _begun(period):
    """The front before the first step; factors, tests; room for a block, twice."""
    size, line = (BLOCK + PAST) * LANES32, 64 // 4
    count = 5 * size + (4 + 2 * FACTORS + 1 + TESTS + 2 * BLOCK) * LANES32
    room = np.zeros(count + line, np.int32)
    at = -(room.ctypes.data // 4) % line  # vectors that straddle cache lines take twice as long to load
    above, beyond, errors = room[at : at + size], room[at + size : at + 2 * size], room[at + 2 * size : at + 3 * size]
    across, down = room[at + 3 * size : at + 4 * size], room[at + 4 * size : at + 5 * size]
    at += 5 * size
    last, factors = room[at : at + 4 * LANES32], room[at + 4 * LANES32 : at + (4 + 2 * FACTORS) * LANES32]
    at += (4 + 2 * FACTORS) * LANES32
    tests, edges = room[at : at + (1 + TESTS) * LANES32], np.zeros((4, period), np.int32)
    at += (1 + TESTS) * LANES32
    block, lines = room[at : at + BLOCK * LANES32], room[at + BLOCK * LANES32 : at + 2 * BLOCK * LANES32]
    return Front(above, beyond, errors, across, down, edges, last), factors, tests, block, lines


@linked
def _decode_steps(words, count, tables, deep, places, form, limits, choices, marks, states, scale, out):
    """Decode all steps; return whether the words end where they must.

    Args:
        words: uint16, ``count`` of them and zeros after them. places: of each cell's table.
        form, limits, choices: as in ``read_sets``. states: (lanes,), for the rows that exist.
        marks: (rows, cols) int32, where samples are missing, or without rows.
        scale: as in ``_put_samples``. out: becomes the chunk.
    """
    rows, cols = out.shape
    period, steps = period_of(cols), steps_of(rows, cols)
    coded, starts = np.zeros(steps, MARKS), np.zeros(steps, MARKS)
    mark_steps(marks, rows, cols, form, coded, starts)
    front, factors, tests, block, lines = _begun(period)
    rules = Rules(choices, factors, tests, form == CHOICES)
    front.last[3 * LANES32 :] = LEAST
    front.last[3 * LANES32 : 3 * LANES32 + states.size] = states
    p, step = np.int64(0), np.int64(0)
    while step < steps:
        if step == 0 or step == period:
            put_factors(step // period, form, limits, choices, factors, tests)
        size = min(BLOCK, (period if step < period else steps) - step)
        p = _decode_block(size, step, period, p, words, tables, deep, places, rules, coded, starts, front, block)
        if p > count:
            return False
        _put_samples(block, lines, size, step, scale, out)
        for part in (front.above, front.beyond, front.errors, front.across, front.down):
            for k in range(PAST * LANES32):
                part[k] = part[size * LANES32 + k]
        step += size
    return p == count and (front.last[3 * LANES32 :] == LEAST).all()


@linked
def _put_samples(block, lines, size, step, scale, out):
    """Put the samples of a block of steps in their rows.

    Args:
        scale: the sample that is coded as 0, and what a step of 1 stands for.
        block: flat. lines: (LANES32 × BLOCK,) int32, becomes the samples of each lane.
    """
    (rows, cols), (origin, factor) = out.shape, scale
    period = period_of(cols)
    for k in range(0, BLOCK, LANES32):
        transpose32(block, k * LANES32, LANES32, lines, k, BLOCK)
    for i in range(LANES32):
        since, k = step - LAG * i, max(LAG * i - step, 0)
        while k < size:  # (a block may contain the end of one row and the beginning of another)
            row, col = (since + k) // period * LANES32 + i, (since + k) % period
            here = np.uint64(i * BLOCK + k)
            if row < rows:
                line = out[row, col : min(col + size - k, cols)]
                for m in range(line.size):
                    line[np.uint64(m)] = lines[here + np.uint64(m)] * factor + origin
            k += min(size - k, period - col)


@linked
def _clear(marks, form, out):
    """Put ``MISSING`` where samples are missing, and 0 where they hold nothing."""
    for row in range(out.shape[0]):
        if form == CLASSES and row & 1 == 0:
            out[row, ::2] = 0
        if marks.size:
            for col in range(out.shape[1]):
                out[row, col] = MISSING if marks[row, col] else out[row, col]


@kernel
def decode(data, out):
    """Decode a chunk.

    Args:
        data: (n,) uint8, its bytes. out: (rows, cols) int32, C order, becomes the samples.

    Returns:
        0, or an error code (``codec_head``).
    """
    rows, cols = out.shape
    if data.size < HEADER:
        return CUT_OFF
    mode, form, number = np.int64(data[1]), np.int64(data[2]), np.int64(data[3])
    if data[0] != VERSION or mode > 2 or (form != 1 and form != CLASSES and form != CHOICES):
        return UNKNOWN
    if number < 1 or number > SETS:
        return TABLES
    scale = np.int32(u32(data, 4)), np.int32(u32(data, 8))
    limits, choices = np.zeros(TESTS, np.int32), np.zeros((FACTORS - 1) * ENTRIES, np.int32)
    at, skipped, classes = read_sets(data, HEADER, form, limits, choices), 0, 1
    if at < 0:
        return CUT_OFF
    if form == CLASSES:
        skipped, classes = 1, CLASSES
    cells = np.zeros(CLASSES * GROUPS * BINS, np.int32)
    at = read_cells(data, at, classes - skipped, number, cells[skipped * GROUPS * BINS :])
    if at < 0:
        return TABLES
    entries = np.empty(number * TOTAL, np.uint32)
    depths, direct = np.zeros(number, np.int64), np.zeros(number, np.int64)
    at = read_tables(data, at, number, entries, depths, direct)
    if at < 0:
        return TABLES
    add_depths(cells, depths)
    tables, deep = Tables(entries.view(np.int32), direct.astype(np.int32)), depths.any()
    marks = np.empty((rows if mode else 0, cols), np.int32)
    if mode:
        at = read_mask(data, at, mode, marks)
        if at < 0:
            return MASK
    states = np.empty(min(rows, LANES32), np.int32)
    if at + 4 * states.size > data.size:
        return CUT_OFF
    for k in range(states.size):
        states[k] = np.int32(u32(data, at))
        at += 4
    count = (data.size - at) // 2
    words = np.zeros(count + (WORDS * BLOCK + 1) * LANES32, np.uint16)
    at = read_words(data, at, words[:count])
    if at != data.size:
        return STREAM
    if not _decode_steps(words, count, tables, deep, cells, form, limits, choices, marks, states, scale, out):
        return STREAM
    _clear(marks, form, out)
    return 0
