"""Blow's threshold spheres: what the eye's place decides is looked at again when the eye can have crossed a boundary.

Blow, *Terrain Rendering at High Levels of Detail* (GDC 2000). With an isotropic error the tolerance is a distance:
around each diamond lies a sphere, and the diamond is split while the eye is inside. The spheres nest, so the meshes are
conforming, and an eye that has come s metres since a sphere was looked at cannot have crossed a boundary farther away
than that. Each triangle on the front therefore waits for a length of way: its distance to the boundary. Turning the
head changes nothing.

*Radius.* A sample in view at distance d has depth w ≥ d·cos θ, θ being the angle between the axis of view and the
picture's corner. A vertical displacement of up to e moves it by at most f·e·d / (w·(w − e)) pixels (``error.screen``;
the numerator is the length of a cross product), so by at most τ if

    d ≥ λ·e,    λ = f / (τ·cos²θ) + 1 / cos θ,

and for all samples under diamond i, which its nested sphere of radius r_i holds, if the eye is R_i = λ·e_i + r_i from
its vertex. Errors are monotonic and spheres nested: R_i ≥ |p_i − p_j| + R_j for each child j, for every λ and without a
pass over the terrain; Blow closes λ·e_i bottom-up for one λ instead (docs/engines/blow.md compares). 10⁻⁹ of the
terrain's size per level makes the nesting strict, so that roundings cannot undo it. ``isotropic-published`` has λ = f /
τ. A diamond whose colours are off by more than γ is also split while its sphere can look larger than a texel.

*Waiting.* The front is kept as two binary trees of triangles. A leaf waits for the eye to enter its sphere, a node with
two leaves below it for the eye to leave; a radix heap of ways (``waiting``) says when. Mixed diamonds (e = ∞) are split
when they come into view. What is out of view stays refined and is skipped when triangles are put out.
"""

from __future__ import annotations

import math
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph._numba import leaf
from orograph.error.screen import STRETCH, TEXEL, outside
from orograph.lod.engine import Engine, Mesh, by_tolerance
from orograph.lod.field import Field, find
from orograph.lod.pages import BEYOND
from orograph.lod.waiting import AFTER, BEFORE, LISTS, WHERE, WORK, advance, link, list_of, unlink
from orograph.view import View

DONE, MISSED, GROW = 0, 1, 2
"""Why kernels return."""

PARENT, CHILD, LEVEL = 3, 4, 5
"""Links of a triangle, behind those of ``waiting``: above; the first of two below, −1: none; level."""

TOP, FREE, NOW, VISITS, SPLITS, MERGES = range(6)
"""Counts: height of the stack; free pairs; the way, in units; triangles looked at, splits, merges."""

X, Y, Z, RADIUS, REACH = range(5)
"""Of a triangle's diamond: its vertex (stretched metres), radius of its nested sphere and of its threshold sphere."""

EYE, LAMBDA, UNIT, WAY, GAMMA, COLORED, SLACK, EAST, NORTH, UP, AFFINE = 0, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12
"""What a frame is about: eye (3, stretched metres); λ for metres of height; metres per unit of way; the way so far,
metres; γ; reach of coloured diamonds in radii; slack per level, metres; the first sample's easting and northing; the
exaggeration; metres east per column and row, north per column and row."""


@leaf
def update(
    pages, lens, cull, way, corners, heights, numbers, due, shown, links, free, heads, stack, counts, leaf_level
):
    """Look at what is to be looked at, and at mixed diamonds in view; returns why it stops. It can be called again.

    Args:
        pages: ``field.Pages``. lens: the camera. cull: whether mixed diamonds out of view stay whole.
        way: float64 (16,), see ``EYE`` and following.
        corners: int64 (places, 3): left end, right end, apex; heights: float32 (places, 4), theirs and the middle's.
        numbers: float64 (places, 5): the diamond (X …); REACH is NaN before it is known.
        due: int64 (places,), the way at which to look again. shown: uint8 (places,). links: int32 (places, 6).
        free: int32 (places / 2,), first places of pairs not in use. heads: int32 (67,). stack: int32 (4n + 8,).
        counts: int64 (6,). leaf_level: 2n.
    """
    n = leaf_level >> 1
    while heads[65] >= 0:
        v = np.int64(heads[65])
        unlink(links, heads, v)
        link(links, heads, v, 66)
    last_row, last_col = pages.edge[0], pages.edge[1]
    while True:
        v = np.int64(heads[66])
        split = False
        if v >= 0:
            if counts[1] < 1:
                return 2
            unlink(links, heads, v)
            level = np.int64(links[v, 5])
            if numbers[v, 4] != numbers[v, 4]:
                # New: what its diamond says.
                er, ec = corners[v, 0] >> 32, corners[v, 0] & 0xFFFFFFFF
                xr, xc = corners[v, 1] >> 32, corners[v, 1] & 0xFFFFFFFF
                if level == leaf_level:
                    numbers[v, 3], numbers[v, 4] = 0.0, -1.0
                    shown[v] = 1
                else:
                    slot, i, j = find(pages, (er + xr) >> 1, (ec + xc) >> 1, n - 1 - (level >> 1))
                    if slot == BEYOND:
                        numbers[v, 3], numbers[v, 4], shown[v] = 0.0, -1.0, 0
                        continue
                    if slot < 0:
                        link(links, heads, v, 65)
                        continue
                    row, col = min((er + xr) >> 1, last_row), min((ec + xc) >> 1, last_col)
                    z = pages.data[slot, i, j, 0]
                    e = np.float64(pages.data[slot, i, j, 1])
                    r = np.float64(pages.data[slot, i, j, 2])
                    c = np.float64(pages.data[slot, i, j, 3])
                    heights[v, 3] = z if c >= 0.0 else np.float32(np.nan)
                    c = c if c >= 0.0 else -1.0 - c
                    shown[v] = r >= 0.0
                    r = abs(r) * lens[15]
                    reach = -1.0
                    if e == np.inf:
                        reach = np.inf  # (in a plan λ is 0, and 0 · ∞ no number)
                    elif e > 0.0 and way[3] > 0.0:
                        reach = way[3] * e + r + way[8] * (leaf_level - level)
                    if c > way[6]:
                        reach = max(reach, way[7] * r + way[8] * (leaf_level - level))
                    numbers[v, 0] = way[12] * col + way[13] * row + way[9]
                    numbers[v, 1] = way[14] * col + way[15] * row + way[10]
                    numbers[v, 2] = way[11] * np.float64(z)
                    numbers[v, 3], numbers[v, 4] = r, reach
            reach = numbers[v, 4]
            if not 0.0 < reach < np.inf:
                continue  # never split; or mixed: see below
            counts[3] += 1
            x, y, h = numbers[v, 0] - way[0], numbers[v, 1] - way[1], numbers[v, 2] - way[2]
            gap = np.sqrt(x * x + y * y + h * h) - reach
            child = np.int64(links[v, 4])
            if child >= 0:
                if links[child, 4] >= 0 or links[child + 1, 4] >= 0:
                    continue  # its turn comes when those below are gone
                if gap >= 0.0:
                    for k in range(2):
                        unlink(links, heads, child + k)
                    free[counts[1]] = child
                    counts[1] += 1
                    counts[5] += 1
                    links[v, 4] = -1
                    parent = np.int64(links[v, 3])
                    if parent >= 0:
                        unlink(links, heads, parent)
                        link(links, heads, parent, 66)
            elif gap < 0.0:
                split = True
            # Look again when the eye has come as far as the boundary is now, less what roundings may do.
            at = max(np.int64((way[5] + abs(gap)) / way[4] - 2.0), counts[2])
            due[v] = at
            link(links, heads, v, list_of(at, counts[2]))
        elif counts[0] > 0:
            # Through mixed diamonds in view.
            if counts[1] < 1:
                return 2
            v = np.int64(stack[counts[0] - 1])
            counts[0] -= 1
            if numbers[v, 4] != np.inf:
                continue
            if cull:
                key = (corners[v, 0] + corners[v, 1]) >> 1
                row, col = min(key >> 32, last_row), min(key & 0xFFFFFFFF, last_col)
                out, _ = outside(lens, col, row, numbers[v, 2] / way[11], numbers[v, 3], 0)
                if out:
                    continue
            child = np.int64(links[v, 4])
            if child >= 0:
                stack[counts[0]], stack[counts[0] + 1] = child, child + 1
                counts[0] += 2
            else:
                split = True
                stack[counts[0]] = v
                counts[0] += 1
        else:
            return 0 if heads[65] < 0 else 1
        if split:
            counts[1] -= 1
            counts[4] += 1
            child = np.int64(free[counts[1]])
            links[v, 4] = child
            parent = np.int64(links[v, 3])
            if parent >= 0:
                unlink(links, heads, parent)
            m = (corners[v, 0] + corners[v, 1]) >> 1
            for half in range(2):
                t = child + half
                corners[t, 0] = corners[v, 2] if half == 0 else corners[v, 1]
                corners[t, 1] = corners[v, 0] if half == 0 else corners[v, 2]
                corners[t, 2] = m
                heights[t, 0] = heights[v, 2] if half == 0 else heights[v, 1]
                heights[t, 1] = heights[v, 0] if half == 0 else heights[v, 2]
                heights[t, 2] = heights[v, 3]
                links[t, 3], links[t, 4], links[t, 5], links[t, 2] = v, -1, links[v, 5] + 1, -1
                numbers[t, 4] = np.nan
                link(links, heads, t, 66)


@leaf
def put_out(lens, cull, edge, scale, corners, heights, numbers, shown, links, stack, keys, zs):
    """Write the leaves that are in view and return how many; −1 if there is no room for them.

    Args:
        edge: as in ``field.Pages``. scale: the exaggeration.
        stack: int64 (2n + 4, 2), scratch. keys: int64 (capacity, 3), zs: float32 (capacity, 3).
    """
    count = np.int64(0)
    stack[0, 0], stack[0, 1], stack[1, 0], stack[1, 1] = 0, 0, 1, 0
    top = 2
    while top > 0:
        top -= 1
        v, inside = stack[top, 0], stack[top, 1]
        if cull and numbers[v, 3] > 0.0:
            key = (corners[v, 0] + corners[v, 1]) >> 1
            row, col = min(key >> 32, edge[0]), min(key & 0xFFFFFFFF, edge[1])
            out, inside = outside(lens, col, row, numbers[v, 2] / scale, numbers[v, 3], inside)
            if out:
                continue
        child = np.int64(links[v, 4])
        if child >= 0:
            stack[top, 0], stack[top, 1], stack[top + 1, 0], stack[top + 1, 1] = child, inside, child + 1, inside
            top += 2
            continue
        total = heights[v, 0] + heights[v, 1] + heights[v, 2]
        if shown[v] and total == total:
            if count == len(keys):
                return -1
            for k in range(3):
                keys[count, k], zs[count, k] = corners[v, k], heights[v, k]
            count += 1
    return count


class _State:
    """The trees, and what waits, for one λ."""

    def __init__(self, field: Field, capacity: int = 1 << 12) -> None:
        n = field.n
        self.corners, self.heights = np.zeros((capacity, 3), np.int64), np.zeros((capacity, 4), np.float32)
        self.numbers, self.due = np.full((capacity, 5), np.nan), np.zeros(capacity, np.int64)
        self.shown, self.links = np.zeros(capacity, np.uint8), np.full((capacity, 6), -1, np.int32)
        self.free = np.arange(capacity - 2, -1, -2, dtype=np.int32)
        self.heads = np.full(LISTS, -1, np.int32)
        self.stack, self.counts = np.zeros(4 * n + 8, np.int32), np.zeros(6, np.int64)
        self.counts[FREE] = len(self.free) - 1  # the pair (0, 1) is the roots
        size = 1 << n
        nw, ne, sw, se = 0, size, size << 32, size << 32 | size
        z = field.corners
        self.corners[:2] = (nw, se, ne), (se, nw, sw)
        self.heights[:2, :3] = (z[0, 0], z[1, 1], z[0, 1]), (z[1, 1], z[0, 0], z[1, 0])
        self.links[:2, LEVEL] = 0
        self.links[0, AFTER], self.links[1, BEFORE], self.links[:2, WHERE] = 1, 0, WORK
        self.heads[WORK] = 0
        self.way = 0.0
        self.eye: NDArray[np.float64] | None = None

    @property
    def arrays(self) -> tuple[NDArray[Any], ...]:
        return self.corners, self.heights, self.numbers, self.due, self.shown, self.links

    def grow(self) -> None:
        """Twice the room."""
        more = len(self.due)
        self.corners, self.heights, self.numbers, self.due, self.shown, self.links = (
            np.concatenate([a, np.full_like(a, -1) if a is self.links else np.zeros_like(a)]) for a in self.arrays
        )
        count = int(self.counts[FREE])
        self.free = np.concatenate([self.free[:count], np.arange(2 * more - 2, more - 2, -2, dtype=np.int32)])
        self.free = np.concatenate([self.free, np.zeros(more - len(self.free), np.int32)])
        self.counts[FREE] += more // 2


class Blow(Engine):
    """Threshold spheres, looked at again when the eye can have crossed them. See ``Engine`` for the arguments.

    The engine remembers its trees from view to view; a view costs what changes by it, and putting out what is in view.
    Another tolerance, field of view or size of the picture changes all spheres and starts anew. Budgets do that often.
    """

    name = "blow"
    metrics = ("isotropic", "isotropic-published")

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self._state: _State | None = None
        self._spheres: tuple[float, ...] = ()
        self._capacity = 1 << 12

    def reset(self) -> None:
        """Forget the last view."""
        self._state = None

    def _lambda(self, view: View, tolerance: float) -> float:
        """Radius of threshold spheres per metre of (unstretched) error; 0 in a plan, where nothing is displaced."""
        if view.projection == "plan":
            return 0.0
        focal = 1.0 / view.pixel_slope
        ratio = focal / tolerance if tolerance > 0 else math.inf
        if not self.metric.conservative:
            return self.exaggeration * ratio
        cosine = 1.0 / math.hypot(1.0, view.pixel_slope * view.width / 2, view.pixel_slope * view.height / 2)
        return self.exaggeration * (ratio / cosine**2 + 1.0 / cosine)

    def _refine(self, view: View, tolerance: float | None, triangles: int | None, seconds: float | None) -> Mesh:
        if tolerance is None:
            return by_tolerance(self, view, triangles, seconds)
        began = time.perf_counter()
        grid, lens = self.terrain.grid, self._lens(view, tolerance)
        a, b, c, d, e, f = grid.samples[:6]
        size = math.hypot((abs(a) + abs(b)) * grid.cols, (abs(d) + abs(e)) * grid.rows) * lens[STRETCH]
        cosine = 1.0 / math.hypot(1.0, view.pixel_slope * view.width / 2, view.pixel_slope * view.height / 2)
        colored = math.inf if view.projection == "plan" else (1.0 + 1.0 / lens[TEXEL]) / cosine
        spheres = self._lambda(view, tolerance), colored
        if self._state is None or spheres != self._spheres:
            self._state, self._spheres = _State(self.field), spheres
        state = self._state
        eye = np.array(view.eye) * [1.0, 1.0, self.exaggeration]
        unit = size * 2.0**-32
        if state.eye is not None:
            moved = float(np.linalg.norm(eye - state.eye))
            state.way += moved * (1 + 1e-9) + (unit if moved else 0.0)
        state.eye = eye
        way = np.array(
            [*eye, spheres[0], unit, state.way, self.color_tolerance, colored, 1e-9 * size, c, f, self.exaggeration,
             a, b, d, e]
        )  # fmt: skip
        state.counts[VISITS : MERGES + 1] = 0
        now = int(state.way / unit)
        advance(state.links, state.due, state.heads, int(state.counts[NOW]), now)
        state.counts[NOW] = now
        while True:
            state.stack[:2], state.counts[TOP] = (0, 1), 2
            self.field.begin()
            why = update(
                self.field.pages, lens, self.cull, way, *state.arrays, state.free, state.heads, state.stack,
                state.counts, 2 * self.field.n,
            )  # fmt: skip
            if why == GROW:
                state.grow()
            elif why == MISSED:
                self.field.fetch(resumes=True)
            else:
                break
        updated = time.perf_counter()
        keys, zs = self._triangles(state, lens)
        visits, splits, merges = (int(v) for v in state.counts[VISITS : MERGES + 1])
        nodes = len(state.due) - 2 * int(state.counts[FREE])
        return Mesh(
            keys, zs, is_strip=False, clockwise=False, triangles=len(keys),
            stats={
                "visits": visits, "splits": splits, "merges": merges, "front": nodes // 2 + 1,
                "update_ms": round((updated - began) * 1e3, 3),
                "output_ms": round((time.perf_counter() - updated) * 1e3, 3),
            },
        )  # fmt: skip

    def _triangles(self, state: _State, lens: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
        stack = np.empty((2 * self.field.n + 4, 2), np.int64)
        while True:
            keys, zs = np.empty((self._capacity, 3), np.int64), np.empty((self._capacity, 3), np.float32)
            count = put_out(
                lens, self.cull, self.field.pages.edge, self.exaggeration, state.corners, state.heights, state.numbers,
                state.shown, state.links, stack, keys, zs,
            )  # fmt: skip
            if count >= 0:
                return keys[:count], zs[:count]
            self._capacity *= 2
