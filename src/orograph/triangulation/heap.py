"""Triangles by error: a binary heap that knows the position of each triangle."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph._numba import leaf

NOWHERE = -1
"""The place of a triangle that is not in the heap."""


class Queue(NamedTuple):
    """Triangles by error: a binary heap, the largest first.

    Attributes:
        error: (t,) float64, metres. x, y: (t,) int32, the sample with that error.
        heap: (t,) int32, triangles. place: (t,) int32, the position of a triangle in it.
        size: (1,) int64, of the heap.
    """

    error: NDArray[np.float64]
    x: NDArray[np.int32]
    y: NDArray[np.int32]
    heap: NDArray[np.int32]
    place: NDArray[np.int32]
    size: NDArray[np.int64]


def new_queue(rows: int, cols: int) -> Queue:
    """Room for all triangles of a window."""
    room = 2 * rows * cols
    return Queue(
        np.empty(room), np.empty(room, np.int32), np.empty(room, np.int32), np.empty(room, np.int32),
        np.full(room, NOWHERE, np.int32), np.zeros(1, np.int64),
    )  # fmt: skip


@leaf
def comes_first(q, t, u):
    """The order of the heap: larger errors, then lower numbers."""
    return q.error[t] > q.error[u] or (q.error[t] == q.error[u] and t < u)


@leaf
def sift(q, i):
    """Move the triangle at position i of the heap to its right position."""
    t = q.heap[i]
    while i > 0:
        up = (i - 1) >> 1
        if not comes_first(q, t, q.heap[up]):
            break
        q.heap[i] = q.heap[up]
        q.place[q.heap[i]] = i
        i = up
    while True:
        down = 2 * i + 1
        if down >= q.size[0]:
            break
        if down + 1 < q.size[0] and comes_first(q, q.heap[down + 1], q.heap[down]):
            down += 1
        if not comes_first(q, q.heap[down], t):
            break
        q.heap[i] = q.heap[down]
        q.place[q.heap[i]] = i
        i = down
    q.heap[i] = t
    q.place[t] = i


@leaf
def put_in(q, t, error, x, y):
    """Put a triangle into the heap, or move it there, by its error; record the sample with that error."""
    q.error[t], q.x[t], q.y[t] = error, x, y
    if q.place[t] == NOWHERE:
        q.heap[q.size[0]] = t
        q.place[t] = q.size[0]
        q.size[0] += 1
    sift(q, q.place[t])


@leaf
def take_out(q, t):
    """Take a triangle out of the heap, if it is in it."""
    i = q.place[t]
    if i == NOWHERE:
        return
    q.place[t] = NOWHERE
    q.size[0] -= 1
    last = q.heap[q.size[0]]
    if last != t:
        q.heap[i] = last
        q.place[last] = i
        sift(q, i)
