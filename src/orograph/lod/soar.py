"""SOAR: one pass without state over nested spheres, one generalised triangle strip out.

Lindstrom & Pascucci, *Visualization of Large Terrains Made Easy* (Vis 2001) and *Terrain Simplification Simplified*
(TVCG 2002). A diamond is *active* if the bound of its error over its sphere exceeds the tolerance and the sphere is in
view. Errors are monotonic and spheres nested, so a diamond's parents are active when it is: both triangles that share a
diamond decide alike, wherever they are met, and the mesh conforms without neighbours, queues or state. The pass goes
through the leaves in the order of a Sierpinski curve, in which each shares an edge with the next: a strip.

What differs from the papers: both children are weighed when their parent is split, so that leaves, half of all
triangles, are never visited (and two look-ups are under way at once). Leaves can be missing: subtrees out of view and
holes are left out, and the strip is taken up again behind them. The metric holds away from the image centre. Geomorphs
(2002, sec. 5.3) are those of ``lod.geomorph``, which keep the tolerance. See docs/engines/soar.md.

The pass begins with a *frontier* of subtrees of one level in view (``soar_pass.frontier``), so that several threads
can share them; their strips follow each other. What comes out does not depend on the number of threads.
"""

from __future__ import annotations

import threading
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.error.screen import FOCAL
from orograph.lod.engine import Engine, Mesh, by_tolerance
from orograph.lod.soar_pass import frontier, refine_subtrees
from orograph.parallel import map_ordered
from orograph.view import View

Strip = tuple[NDArray[np.int64], NDArray[np.float32]]
"""Keys and heights of a strip's vertices."""

CUT = 8
"""Level of the subtrees that threads share."""

FEW = 32
"""Fewer split subtrees than this are not worth sharing (nor a strip that begins anew for each)."""


def _buffer(size: int) -> Strip:
    return np.empty(size, np.int64), np.empty(size, np.float32)


class _Joint:
    """One strip put together from parts that threads make: each is copied as soon as all before it are known.

    Degenerate triangles lie between parts, and each part begins at an even place. Parts are written to few buffers that
    stay in the processor's cache.

    Args:
        whole: where the strip goes; what does not fit is only counted.
        free: buffers for parts, kept from pass to pass.
    """

    def __init__(self, whole: Strip, free: list[Strip]) -> None:
        self._whole, self._free = whole, free
        self._lock = threading.Lock()
        self._waiting: dict[int, tuple[Strip, int]] = {}
        self._next = 0
        self._last: tuple[np.int64, np.float32] | None = None
        self.length = 0

    def take(self) -> Strip:
        """A buffer for a part."""
        with self._lock:
            return self._free.pop() if self._free else _buffer(1 << 17)

    def add(self, index: int, part: Strip, length: int) -> None:
        """The part of an index is ready; its buffer is taken back."""
        placed = []
        with self._lock:
            self._waiting[index] = part, length
            while self._next in self._waiting:
                (keys, zs), size = ready = self._waiting.pop(self._next)
                self._next += 1
                gap = 2 + self.length % 2 if self.length and size else 0
                placed.append((ready, self.length, gap, self._last))
                self.length += gap + size
                if size:
                    self._last = keys[size - 1], zs[size - 1]
        for (ours, size), end, gap, last in placed:
            if size and end + gap + size <= len(self._whole[0]):
                for place in (0, 1):
                    whole = self._whole[place]
                    if last is not None and gap:
                        whole[end], whole[end + 1 : end + gap] = last[place], ours[place][0]
                    whole[end + gap : end + gap + size] = ours[place][:size]
            with self._lock:
                self._free.append(ours)


class Soar(Engine):
    """SOAR. See ``Engine`` for the arguments; besides:

    Args:
        geomorph: vertices morph between half the tolerance and the whole (errors stay within the tolerance).
    """

    name = "soar"
    metrics = ("anisotropic", "isotropic", "isotropic-published")

    def __init__(self, *args: Any, geomorph: bool = False, **options: Any) -> None:
        super().__init__(*args, **options)
        self.geomorph = geomorph
        self._cut = max(0, min(CUT, 2 * self.field.n - 1))
        size = 2 << self._cut
        self._frontier = np.empty((size, 4), np.int64), np.empty((size, 4), np.float32), np.empty((size, 3), np.int64)
        side = 1 << self.field.n
        nw, ne, sw, se = 0, side, side << 32, side << 32 | side
        z = self.field.corners
        self._corners = np.array([[nw, se, ne], [se, nw, sw]], np.int64)
        self._corner_zs = np.array([[z[0, 0], z[1, 1], z[0, 1]], [z[1, 1], z[0, 0], z[1, 0]]], np.float32)
        self._whole = _buffer(1 << 16)
        self._parts: list[Strip] = []
        self._spread = np.array([0.0, 1.0]), np.array([0.0, 1.0])

    def _refine(self, view: View, tolerance: float | None, triangles: int | None, seconds: float | None) -> Mesh:
        if tolerance is None:
            return by_tolerance(self, view, triangles, seconds)
        lens = self._lens(view, tolerance * (0.5 if self.geomorph else 1.0))
        rounds = 0
        while True:
            self.field.begin()
            rounds += 1
            keys, zs, made, nodes = self._strip(lens)
            if not self.field.fetch():
                break
        if self.geomorph and lens[FOCAL] > 0.0:
            from orograph.lod.geomorph import morph

            zs = morph(self.field, lens, self.metric.number, keys, zs)
        return Mesh(
            keys, zs, is_strip=True, clockwise=False, triangles=made,
            stats={"nodes": nodes, "rounds": rounds, "geomorph": self.geomorph},
        )  # fmt: skip

    def _strip(self, lens: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.float32], int, int]:
        """One pass: the strip (views of buffers that the next pass uses again), its triangles, diamonds looked at."""
        common = self.field.pages, lens, self.metric.number, self.cull, 2 * self.field.n
        stack, stack_zs = self._stack()
        for cut in (self._cut, 0):
            count, split, nodes = frontier(
                *common, cut, self._corners, self._corner_zs, stack, stack_zs, *self._frontier
            )
            if split >= FEW:
                break
        jobs = self.jobs if split >= FEW else 1
        if jobs == 1:
            while True:
                counts = np.zeros(3, np.int64)
                refine_subtrees(*common, *self._frontier, 0, count, stack, stack_zs, *self._whole, counts)
                if counts[0] >= 0:
                    return (
                        self._whole[0][: counts[0]],
                        self._whole[1][: counts[0]],
                        int(counts[1]),
                        nodes + int(counts[2]),
                    )
                self._whole = _buffer(2 * len(self._whole[0]))
        # Groups of about as many diamonds each as the last pass had at these places.
        groups = 4 * jobs
        spread = np.interp(np.linspace(0.0, 1.0, groups + 1), *self._spread)
        bounds = np.rint(spread * count).astype(np.int64)
        bounds[0], bounds[-1] = 0, count

        def refine(joint: _Joint, group: int) -> NDArray[np.int64]:
            part = joint.take()
            while True:
                counts = np.zeros(3, np.int64)
                refine_subtrees(
                    *common, *self._frontier, bounds[group], bounds[group + 1], *self._stack(), *part, counts
                )
                if counts[0] >= 0:
                    break
                part = _buffer(2 * len(part[0]))
            joint.add(group, part, int(counts[0]))
            return counts

        while True:
            joint = _Joint(self._whole, self._parts)
            # All groups are handed out at once: none waits for a larger one before it.
            work = map_ordered(partial(refine, joint), range(groups), jobs, ahead=4)
            each = np.array(list(work))
            sums = each.sum(axis=0)
            done = np.concatenate([[0.0], np.cumsum(each[:, 2])])
            if done[-1] > 0:
                self._spread = done / done[-1], bounds / count
            if joint.length <= len(self._whole[0]):
                keys, zs = self._whole
                return keys[: joint.length], zs[: joint.length], int(sums[1]), nodes + int(sums[2])
            self._whole = _buffer(joint.length + joint.length // 4)

    def _stack(self) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
        return np.empty((2 * self.field.n + 1, 5), np.int64), np.empty((2 * self.field.n + 1, 3), np.float32)
