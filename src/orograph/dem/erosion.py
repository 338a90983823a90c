"""Mountains carved by rivers: uplift against the stream-power law, on a coarse grid.

Rivers lower their beds at a rate K √A S (A the area that drains through a place, S its slope) while the land rises at a
rate U; where the two balance, valleys branch as real ones do (Whipple & Tucker, *J. Geophys. Res.* 104, 1999; for
terrain synthesis Cordonnier et al., *Computer Graphics Forum* 35, 2016). Each step finds where water flows by flooding
the surface from its border (Barnes et al., *Computers & Geosciences* 62, 2014), which also orders the cells downstream
first, and solves the law implicitly in that order, in linear time (Braun & Willett, *Geomorphology* 180, 2013). No
hillside is steeper than a limit, at which rock slides. Units: lengths and heights share one unit, times are those of U
and K.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from orograph._numba import inlined, kernel
from orograph.dem.noise import hashed

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@inlined
def _before(keys: Floats, a: int, b: int) -> bool:
    """Whether cell a is flooded before cell b: the lower one, and of equals the one of smaller index."""
    return keys[a] < keys[b] or (keys[a] == keys[b] and a < b)


@kernel
def _push(heap: Ints, n: int, keys: Floats, cell: int) -> None:
    while n > 0:
        parent = (n - 1) >> 1
        if _before(keys, heap[parent], cell):
            break
        heap[n] = heap[parent]
        n = parent
    heap[n] = cell


@kernel
def _pop(heap: Ints, n: int, keys: Floats) -> int:
    """Take the lowest of n cells off the heap."""
    lowest: int = heap[0]
    last: int = heap[n - 1]
    n -= 1
    at = 0
    while True:
        child = 2 * at + 1
        if child >= n:
            break
        if child + 1 < n and _before(keys, heap[child + 1], heap[child]):
            child += 1
        if _before(keys, last, heap[child]):
            break
        heap[at] = heap[child]
        at = child
    if n > 0:
        heap[at] = last
    return lowest


@kernel
def drainage(heights: Floats, outlet: NDArray[np.bool_], seed: int, order: Ints, receiver: Ints) -> None:
    """Where the water of each cell flows: to the steepest of the neighbours that were flooded before it.

    Args:
        heights: (rows, cols).
        seed: of the random length of diagonals, which keeps rivers on even slopes from running
            parallel in the grid's eight directions (Rho8: Fairfield & Leymarie, *Water Resour. Res.* 27, 1991).
        outlet: (rows, cols): cells at which water leaves; the whole border must be among them.
        order: (rows · cols) int64, overwritten: flat cell indices, every receiver before those that flow to it.
        receiver: (rows · cols) int64, overwritten: flat index of the neighbour (outlets: the cell itself).
    """
    rows, cols = heights.shape
    level = heights.copy().ravel()  # of the water surface once depressions are full
    rank = np.full(rows * cols, -1, np.int64)  # position in the order, -1 not yet flooded
    queued = np.zeros(rows * cols, np.bool_)
    heap = np.empty(rows * cols, np.int64)
    n = 0
    for cell in range(rows * cols):
        if outlet.flat[cell]:
            _push(heap, n, level, cell)
            n += 1
            queued[cell] = True
    done = 0
    while n > 0:
        cell = _pop(heap, n, level)
        n -= 1
        row, col = cell // cols, cell % cols
        best, steepest = cell, -1.0
        chance = hashed(col, row, seed)
        for dr in range(-1, 2):
            for dc in range(-1, 2):
                if (dr == 0 and dc == 0) or not (0 <= row + dr < rows and 0 <= col + dc < cols):
                    continue
                other = cell + dr * cols + dc
                if rank[other] >= 0:
                    drop = level[cell] - level[other]
                    if dr != 0 and dc != 0:
                        drop /= 1.0 + ((chance >> (4 * (dr + 1) + 2 * (dc + 1))) & 0xFF) / 256
                    if drop > steepest:
                        best, steepest = other, drop
                elif not queued[other]:
                    level[other] = max(level[other], level[cell])
                    _push(heap, n, level, other)
                    n += 1
                    queued[other] = True
        receiver[cell] = cell if outlet.flat[cell] else best
        rank[cell] = done
        order[done] = cell
        done += 1


@kernel
def stream_power(
    heights: Floats,
    uplift: Floats,
    erodibility: Floats,
    outlet: NDArray[np.bool_],
    order: Ints,
    receiver: Ints,
    spacing: float,
    step: float,
    steepest: float,
) -> None:
    """One implicit step of uplift and river erosion, in place.

    Args:
        heights: (rows, cols), changed.
        uplift, erodibility: (rows, cols): U and K.
        outlet, order, receiver: see ``drainage``.
        spacing: between cells.
        step: of time.
        steepest: slope at which hillsides slide.
    """
    cols = heights.shape[1]
    area = np.full(heights.size, spacing * spacing)
    for n in range(heights.size - 1, -1, -1):
        cell = order[n]
        if receiver[cell] != cell:
            area[receiver[cell]] += area[cell]
    for n in range(heights.size):
        cell = order[n]
        if outlet.flat[cell]:
            continue
        to = receiver[cell]
        straight = abs(to - cell) == 1 or abs(to - cell) == cols
        length = spacing * (1.0 if straight else math.sqrt(2.0))
        rate = step * erodibility.flat[cell] * math.sqrt(area[cell]) / length
        below = heights.flat[to]
        raised = heights.flat[cell] + step * uplift.flat[cell]
        solved = (raised + rate * below) / (1.0 + rate) if raised > below else raised
        heights.flat[cell] = min(solved, below + steepest * length)
