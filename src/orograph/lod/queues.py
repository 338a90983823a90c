"""Queues of triangles for refinements: a binary heap in which the order is total, and what names a diamond in it.

The heap (Williams 1964) is three parallel arrays: priority, code, slot. Larger priorities come first; among equals
smaller codes. A *code* is level · 2^54 + i · 2^27 + j, with (i, j) the diamond's vertex in units of its octave's
spacing: coarser diamonds come before finer ones, so parents before children, and the two top triangles of a diamond,
which share its code, come one after the other. The slot is the caller's number of the triangle.

A FIFO of the same triangles is a ring over two of the arrays (code and slot). Both begin at ``counts[HEAD]`` and end at
``counts[TAIL]`` of the caller's counts; of a heap the first is 0. Everything is inlined into the kernels that use it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph._numba import inlined
from orograph.errors import UsageError
from orograph.lod.method import Goal
from orograph.store.terrain import Terrain

HEAD, TAIL = 2, 3
"""Counts of a method with a queue: where the queue begins, and where it ends."""

LEVEL_SHIFT = 54
ROW_SHIFT = 27
LARGEST_N = 26
"""The largest n for which a diamond's place fits into a code."""


ORDERS = ("priority", "fifo")
"""Kinds of queues."""


class Queue(NamedTuple):
    """The arrays of a heap or a FIFO, all of one length.

    Attributes:
        priorities: float64, of a heap. codes: int64. slots: int64.
    """

    priorities: NDArray[np.float64]
    codes: NDArray[np.int64]
    slots: NDArray[np.int64]


QUEUE = "How triangles wait, where no tolerance is given: by priority, one pass; fifo, passes at better tolerances"
ANY = "priority for triangles, fifo for a time"
"""What the option is, and what it is if it is not given: in the same time a FIFO makes several times the triangles."""


def is_ordered(queue: str | None, goal: Goal) -> bool:
    """Whether triangles of such an option wait by priority. (A tolerance needs no order.)"""
    return goal.tolerance is None and (queue == "priority" or (queue is None and goal.seconds is None))


def check_size(method: str, terrain: Terrain) -> None:
    """Raise UsageError if a terrain is too large for codes."""
    if terrain.n > LARGEST_N:
        raise UsageError(f"{method} takes up to 2^{LARGEST_N} samples a side; {terrain.name} has more.")


@inlined
def code_of(key, level, n):
    """The code of the diamond with vertex ``key`` (row << 32 | col), split by triangles of ``level`` < 2n."""
    k = n - 1 - (level >> 1)
    return (np.int64(level) << LEVEL_SHIFT) | ((key >> 32 >> k) << ROW_SHIFT) | ((key & 0xFFFFFFFF) >> k)


@inlined
def heap_push(priorities, codes, slots, size, priority, code, slot):
    """Add an entry to a heap of ``size`` entries (the arrays have room for one more)."""
    at = size
    while at > 0:
        above = (at - 1) >> 1
        p = priorities[above]
        if p > priority or (p == priority and codes[above] <= code):
            break
        priorities[at], codes[at], slots[at] = p, codes[above], slots[above]
        at = above
    priorities[at], codes[at], slots[at] = priority, code, slot


@inlined
def heap_pop(priorities, codes, slots, size):
    """Take the first entry off a heap of ``size`` ≥ 1 entries; it is read from place 0 before."""
    last = size - 1
    priority, code, slot = priorities[last], codes[last], slots[last]
    at = 0
    while True:
        below = 2 * at + 1
        if below >= last:
            break
        if below + 1 < last:
            p, q = priorities[below], priorities[below + 1]
            if q > p or (q == p and codes[below + 1] < codes[below]):
                below += 1
        p = priorities[below]
        if priority > p or (priority == p and code <= codes[below]):
            break
        priorities[at], codes[at], slots[at] = p, codes[below], slots[below]
        at = below
    priorities[at], codes[at], slots[at] = priority, code, slot


@inlined
def first_place(queue, counts, ordered):
    """Where the first entry is."""
    return 0 if ordered else counts[HEAD] % len(queue.codes)


@inlined
def put_in(queue, counts, ordered, priority, code, slot):
    """Add an entry to a heap (``ordered``) or a FIFO; there must be room."""
    if ordered:
        heap_push(queue.priorities, queue.codes, queue.slots, counts[TAIL], priority, code, slot)
    else:
        at = counts[TAIL] % len(queue.codes)
        queue.codes[at], queue.slots[at] = code, slot
    counts[TAIL] += 1


@inlined
def take_out(queue, counts, ordered):
    """Remove the first entry."""
    if ordered:
        heap_pop(queue.priorities, queue.codes, queue.slots, counts[TAIL])
        counts[TAIL] -= 1
    else:
        counts[HEAD] += 1
