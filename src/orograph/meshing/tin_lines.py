"""Break lines and points that a TIN must have, as edges between samples that can be edges of it.

Ends are the nearest samples. A line is split at the borders of tiles, at the nearest sample of the border. In a tile,
an edge is split at a nearby sample while it passes over missing ground (its parts there are removed), exceeds the bound
on the surface, or crosses another edge. So a line is followed to within about a cell, and all the resulting edges lie
on ground, keep the bound, and meet only at samples (as in snap rounding: Hobby 1999, *Practical segment intersection
with finite precision output*).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from orograph._numba import kernel, leaf
from orograph.errors import UsageError
from orograph.triangulation.deviation import worst_between

Edge = tuple[int, int, int, int]
"""Column, row, column, row of its ends."""

Key = tuple[int, int]

ROUNDS = 200
"""How often edges of a tile may be split where they cross; each time they become shorter."""


def edges_by_tile(lines: Sequence[NDArray[np.float64]], shape: tuple[int, int], side: int) -> dict[Key, list[Edge]]:
    """The edges of lines by tile (row, column), in the tile's own columns and rows.

    Args:
        lines: (n, 2) columns and rows; a line of one place is a point. Parts beyond the raster are left out.
        shape: rows, columns of the raster. side: cells along the side of a tile.

    Raises:
        UsageError: a line has another shape.
    """
    found: dict[Key, list[Edge]] = {}
    rows, cols = shape
    most = max(-(-(rows - 1) // side), 1) - 1, max(-(-(cols - 1) // side), 1) - 1
    for line in lines:
        if line.ndim != 2 or line.shape[1] != 2 or not np.isfinite(line).all():
            raise UsageError(f"A line is (n, 2) numbers, not {line.shape}.")
        ends = line if len(line) > 1 else np.repeat(line, 2, 0)
        for a, b in pairwise(ends.tolist()):
            for x0, y0, x1, y1 in parted(a, b, shape, side):
                row, col = min((y0 + y1) // 2 // side, most[0]), min((x0 + x1) // 2 // side, most[1])
                left, top = col * side, row * side
                found.setdefault((row, col), []).append((x0 - left, y0 - top, x1 - left, y1 - top))
    return found


def parted(a: list[float], b: list[float], shape: tuple[int, int], side: int) -> Iterator[Edge]:
    """A segment on the raster, with its ends on samples, split at the borders of tiles."""
    low, high = 0.0, 1.0
    for start, way, last in zip(a, (b[0] - a[0], b[1] - a[1]), (shape[1] - 1, shape[0] - 1)):
        if way == 0:
            if not -0.5 <= start <= last + 0.5:
                return
            continue
        cuts = sorted(((-0.5 - start) / way, (last + 0.5 - start) / way))
        low, high = max(low, cuts[0]), min(high, cuts[1])
    if low > high:
        return
    ways = {low, high}
    for start, end in ((a[0], b[0]), (a[1], b[1])):
        for k in range(math.ceil(min(start, end) / side), math.floor(max(start, end) / side) + 1):
            if start != end:
                ways.add(min(max((k * side - start) / (end - start), low), high))
    samples = [
        (nearest(a[0] + t * (b[0] - a[0]), shape[1]), nearest(a[1] + t * (b[1] - a[1]), shape[0])) for t in sorted(ways)
    ]
    for p, q in pairwise(samples):
        if p != q or len(samples) == 2:
            yield p[0], p[1], q[0], q[1]
    if len(samples) == 1:
        yield (*samples[0], *samples[0])


def nearest(place: float, size: int) -> int:
    """The nearest of so many columns or rows."""
    return min(max(math.floor(place + 0.5), 0), size - 1)


def edges_of_tile(
    edges: Sequence[Sequence[int]], heights: NDArray[np.float32], units: NDArray[np.bool_], limit: float, surface: bool,
    elsewhere: bool = False,
) -> NDArray[np.int64]:  # fmt: skip
    """The required edges and vertices of a tile, as edges that its TIN can have.

    Args:
        heights: (rows, cols) float32 of the tile, whose first sample is an (even, even) one. units: (rows − 1,
            cols − 1, 2), which unit triangles exist.
        limit, surface: the bound, metres. elsewhere: whether edges that cross are split at samples that are ends of
            neither where they can be, instead of at the nearest ones.

    Returns:
        (n, 4) int64; edges without length are vertices.

    Raises:
        UsageError: there are so many crossings that edges cannot be told apart on samples.
    """
    now = np.array(sorted({ordered(e) for e in edges}), np.int64).reshape(-1, 4)
    for _ in range(ROUNDS):
        whole = [e for edge in now.tolist() for e in on_ground(edge, heights, units, limit, surface)]
        now = np.array(sorted({ordered(e) for e in whole}), np.int64).reshape(-1, 4)
        at = crossings(now, elsewhere)
        if (at < 0).all():
            return now
        parts = [now[at[:, 0] < 0]]
        cut, where = now[at[:, 0] >= 0], at[at[:, 0] >= 0]
        parts += [np.concatenate([cut[:, :2], where], -1), np.concatenate([where, cut[:, 2:]], -1)]
        now = np.concatenate(parts)
    raise UsageError("The break lines cross too often to be told apart on the terrain's samples.")


def ordered(e: Sequence[int]) -> Edge:
    """An edge from its lower end."""
    x0, y0, x1, y1 = e
    return (x0, y0, x1, y1) if (x0, y0) <= (x1, y1) else (x1, y1, x0, y0)


def on_ground(
    edge: Sequence[int], heights: NDArray[np.float32], units: NDArray[np.bool_], limit: float, surface: bool
) -> Iterator[Edge]:
    """The parts of an edge on ground, split where they would exceed the bound."""
    waiting = [ordered(edge)]
    while waiting:
        x0, y0, x1, y1 = e = waiting.pop()
        span = max(abs(x1 - x0), abs(y1 - y0))
        if span == 0:
            if touches(units, x0, y0):
                yield e
            continue
        if not passes(units, *e):
            if span > 1:
                x, y = (x0 + x1) // 2, (y0 + y1) // 2
                waiting += [(x0, y0, x, y), (x, y, x1, y1)]
            continue
        at = worst_on(heights, *e, surface)
        if at[0] > limit:
            x, y = int(at[1]), int(at[2])
            waiting += [ordered((x0, y0, x, y)), ordered((x, y, x1, y1))]
            continue
        yield e


@kernel
def worst_on(heights, x0, y0, x1, y1, surface):
    """The largest deviation of an edge, at samples on it or at its crossings; and the sample at which to split it."""
    z0, z1 = np.float64(heights[y0, x0]), np.float64(heights[y1, x1])
    worst, x, y = 0.0, x0, y0
    if surface:
        worst, x, y, p, q = worst_between(heights, x0, y0, x1 - x0, y1 - y0, z0, z1 - z0)
        if (x == x0 and y == y0) or (x == x1 and y == y1):
            x, y = p, q
    steps = np.gcd(x1 - x0, y1 - y0)
    for k in range(1, steps):
        i, j = x0 + k * (x1 - x0) // steps, y0 + k * (y1 - y0) // steps
        off = abs(z0 + (z1 - z0) * k / steps - heights[j, i])
        if off > worst:
            worst, x, y = off, i, j
    return worst, x, y


@leaf
def touches(units, x, y):
    """Whether a sample is a corner of a unit triangle that exists."""
    rows, cols = units.shape[0], units.shape[1]
    for j in range(max(y - 1, 0), min(y + 1, rows)):
        for i in range(max(x - 1, 0), min(x + 1, cols)):
            for k in range(2):
                main = ((i + j) & 1) == 0
                away = (x == i and y == j + 1) if main else (x == i + 1 and y == j + 1)
                if k == 1:
                    away = (x == i + 1 and y == j) if main else (x == i and y == j)
                if units[j, i, k] and not away:
                    return True
    return False


@leaf
def covered(units, x, y):
    """Whether a point that is not a sample lies on ground; for a point on an edge of the surface, one side suffices."""
    rows, cols = units.shape[0], units.shape[1]
    near = 1e-7
    for j in range(max(int(np.floor(y - near)), 0), min(int(np.floor(y + near)) + 1, rows)):
        for i in range(max(int(np.floor(x - near)), 0), min(int(np.floor(x + near)) + 1, cols)):
            u, v = x - i, y - j
            south = v - u if ((i + j) & 1) == 0 else u + v - 1
            if (south < near and units[j, i, 0]) or (south > -near and units[j, i, 1]):
                return True
    return False


@kernel
def passes(units, x0, y0, x1, y1):
    """Whether an edge lies on ground all the way, tested midway between its crossings with the surface's edges."""
    dx, dy = x1 - x0, y1 - y0
    cuts = np.empty(3 * (abs(dx) + abs(dy)) + 4)
    cuts[0], cuts[1] = 0.0, 1.0
    count = 2
    for way in range(4):
        s0 = x0 if way == 0 else y0 if way == 1 else x0 + y0 if way == 2 else x0 - y0
        ds = dx if way == 0 else dy if way == 1 else dx + dy if way == 2 else dx - dy
        for line in range(min(s0, s0 + ds) + 1, max(s0, s0 + ds)):
            if way < 2 or (line & 1) == 0:
                cuts[count] = (line - s0) / ds
                count += 1
    ways = np.sort(cuts[:count])
    for k in range(count - 1):
        if ways[k + 1] - ways[k] > 1e-9:
            t = (ways[k] + ways[k + 1]) / 2
            if not covered(units, x0 + t * dx, y0 + t * dy):
                return False
    return True


@leaf
def side(edges, i, x, y):
    """Twice the signed area of an edge and a sample."""
    ax, ay = edges[i, 0], edges[i, 1]
    return (edges[i, 2] - ax) * (y - ay) - (edges[i, 3] - ay) * (x - ax)


@leaf
def is_end(edges, i, x, y):
    """Whether a sample is an end of an edge."""
    return (x == edges[i, 0] and y == edges[i, 1]) or (x == edges[i, 2] and y == edges[i, 3])


@leaf
def inside(edges, i, x, y):
    """Whether a sample lies on an edge, but is not one of its ends."""
    return (
        side(edges, i, x, y) == 0
        and min(edges[i, 0], edges[i, 2]) <= x <= max(edges[i, 0], edges[i, 2])
        and min(edges[i, 1], edges[i, 3]) <= y <= max(edges[i, 1], edges[i, 3])
        and not is_end(edges, i, x, y)
    )


@kernel
def crossings(edges, elsewhere):
    """For each edge, a sample at which to split it: an end of another on it, or the nearest to a crossing; −1: none.

    With ``elsewhere``, if the nearest is an end of either, another corner of the crossing's cell.
    """
    n = len(edges)
    at = np.full((n, 2), -1, np.int64)
    for i in range(n):
        for j in range(i):
            if (
                max(edges[j, 0], edges[j, 2]) < min(edges[i, 0], edges[i, 2])
                or max(edges[i, 0], edges[i, 2]) < min(edges[j, 0], edges[j, 2])
                or max(edges[j, 1], edges[j, 3]) < min(edges[i, 1], edges[i, 3])
                or max(edges[i, 1], edges[i, 3]) < min(edges[j, 1], edges[j, 3])
            ):
                continue
            met = False
            for k in range(0, 4, 2):
                if inside(edges, i, edges[j, k], edges[j, k + 1]):
                    at[i, 0], at[i, 1], met = edges[j, k], edges[j, k + 1], True
                if inside(edges, j, edges[i, k], edges[i, k + 1]):
                    at[j, 0], at[j, 1], met = edges[i, k], edges[i, k + 1], True
            if met:
                continue
            p, q = side(edges, i, edges[j, 0], edges[j, 1]), side(edges, i, edges[j, 2], edges[j, 3])
            r, s = side(edges, j, edges[i, 0], edges[i, 1]), side(edges, j, edges[i, 2], edges[i, 3])
            if ((p < 0 < q) or (q < 0 < p)) and ((r < 0 < s) or (s < 0 < r)):
                t = r / (r - s)
                u, v = edges[i, 0] + t * (edges[i, 2] - edges[i, 0]), edges[i, 1] + t * (edges[i, 3] - edges[i, 1])
                x, y = np.int64(np.floor(u + 0.5)), np.int64(np.floor(v + 0.5))
                if elsewhere and (is_end(edges, i, x, y) or is_end(edges, j, x, y)):
                    for k in range(4):
                        column, row = np.int64(np.floor(u)) + k % 2, np.int64(np.floor(v)) + k // 2
                        if not is_end(edges, i, column, row) and not is_end(edges, j, column, row):
                            x, y = column, row
                for e in (i, j):
                    if not is_end(edges, e, x, y):
                        at[e, 0], at[e, 1] = x, y
    return at
