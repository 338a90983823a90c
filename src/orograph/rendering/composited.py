"""Sort-last: a picture's surface in parts of the terrain, drawn separately and composited by depth.

After Goswami, Makhinya, Bösch & Pajarola 2010, "Scalable parallel out-of-core terrain rendering", sec. 4 (sort-last
decomposition): the terrain is divided so that all nodes draw about the same amount (there triangles, here samples of
the windows that rays meet, or triangles of a mesh), and for each pixel the nearest of the parts' results is kept. The
composite is a G-buffer, so light, lines and layers work as usual.

Parts of heights are boxes in plan, cut along samples of the coarsest window. Each has a margin of ``MARGIN`` such cells
on every side: a ray that crosses the surface exactly at a border then hits the part on either side, and none leaks
through. Units: samples of full resolution, pixels, metres.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph.hierarchy.clip_stack import Rectangle
from orograph.rendering.gbuffer import NONE, Area, GBuffer, Surface
from orograph.rendering.projection import Projection

Array = NDArray[np.float64]

MARGIN = 2
"""Cells of the coarsest window around a part; even, so that windows begin at even samples."""

CELLS = 256
"""Maximum cells along a side of the terrain from which parts are made."""


class Box(NamedTuple):
    """A part of the terrain in plan: samples of full resolution, both ends included."""

    row0: int
    row1: int
    col0: int
    col1: int


def split(windows: Sequence[Rectangle], shape: tuple[int, int], count: int) -> list[Box]:
    """Cut a terrain into parts with about equally many of the windows' samples.

    Args:
        windows: nested, outermost first. shape: of the terrain, in samples. count: of the parts.

    Returns:
        as many boxes, or fewer if there are not enough cells.
    """
    unit = 2 << windows[0].level
    while max(shape) > CELLS * unit:
        unit *= 2
    size = [max(1, -(-(side - 1) // unit)) for side in shape]
    weight = np.full(size, 1e-9)
    for w in windows:
        along = [
            _overlaps(first << w.level, (end - 1) << w.level, unit, n)
            for first, end, n in ((w.row0, w.row1, size[0]), (w.col0, w.col1, size[1]))
        ]
        weight += np.outer(*along) / 4.0**w.level
    return [
        Box(r0 * unit, min(r1 * unit, shape[0] - 1), c0 * unit, min(c1 * unit, shape[1] - 1))
        for r0, r1, c0, c1 in _halved(weight, (0, size[0], 0, size[1]), count)
    ]


def _overlaps(first: int, last: int, unit: int, cells: int) -> Array:
    """How many samples of a span lie in each of ``count`` cells."""
    edges = np.arange(cells + 1) * float(unit)
    return np.asarray(np.clip(np.minimum(edges[1:], last) - np.maximum(edges[:-1], first), 0, None))


def _halved(weight: Array, box: tuple[int, int, int, int], count: int) -> list[tuple[int, int, int, int]]:
    """Cut cells recursively across the longer side, with weights in proportion to the numbers of parts."""
    r0, r1, c0, c1 = box
    if count == 1 or (r1 - r0) * (c1 - c0) == 1:
        return [box]
    axis = 0 if r1 - r0 >= c1 - c0 else 1
    sums = np.cumsum(weight[r0:r1, c0:c1].sum(1 - axis))
    left = count // 2
    at = int(np.argmin(np.abs(sums[:-1] - sums[-1] * left / count))) + 1
    one, other = ((r0, r0 + at, c0, c1), (r0 + at, r1, c0, c1)) if axis == 0 else (
        (r0, r1, c0, c0 + at), (r0, r1, c0 + at, c1)
    )  # fmt: skip
    return _halved(weight, one, left) + _halved(weight, other, count - left)


def windows_of(windows: Sequence[Rectangle], box: Box) -> list[Rectangle]:
    """The part of nested windows in a part, with its margin; outermost first."""
    around = MARGIN << windows[0].level
    found = []
    for w in windows:
        k = w.level
        row0, col0 = max(w.row0, (box.row0 - around) >> k), max(w.col0, (box.col0 - around) >> k)
        row1 = min(w.row1, ((box.row1 + around) >> k) + 1)
        col1 = min(w.col1, ((box.col1 + around) >> k) + 1)
        if row1 - row0 < 2 or col1 - col0 < 2:
            break
        found.append(Rectangle(k, row0, row1, col0, col1))
    return found


def split_triangles(vertices: Array, triangles: NDArray[np.int32], count: int) -> list[NDArray[np.int64]]:
    """The numbers of a mesh's triangles in parts of about equal size, near one another in plan."""
    middle = vertices[triangles, :2].mean(1)

    def halved(which: NDArray[np.int64], parts: int) -> list[NDArray[np.int64]]:
        if parts == 1 or len(which) < parts:
            return [which]
        axis = int(np.argmax(np.ptp(middle[which], axis=0)))
        order = which[np.argsort(middle[which, axis], kind="stable")]
        left = parts // 2
        at = len(order) * left // parts
        return halved(np.sort(order[:at]), left) + halved(np.sort(order[at:]), parts - left)

    return halved(np.arange(len(triangles)), count)


def frame_of(box: Box, heights: tuple[float, float], projection: Projection) -> Area | None:
    """The pixels that something within a box of heights may cover; None: none of the picture's."""
    whole = 0, projection.height, 0, projection.width
    corners = np.array([[c, r, z] for r in box[:2] for c in box[2:] for z in heights], np.float64)
    x, y, t = projection.matrix() @ (corners - projection.o).T
    if projection.perspective:
        if t.max() <= projection.near:
            return None
        if t.min() <= max(projection.near, 1e-6):
            return whole
        x, y = x / t, y / t
    row0, row1 = max(0, math.floor(y.min()) - 2), min(projection.height, math.ceil(y.max()) + 2)
    col0, col1 = max(0, math.floor(x.min()) - 2), min(projection.width, math.ceil(x.max()) + 2)
    return None if row0 >= row1 or col0 >= col1 else (row0, row1, col0, col1)


def put_nearer(out: GBuffer, where: tuple[slice, ...] | NDArray[np.intp], depth: Array, part: int) -> None:
    """Insert a part's samples where they are nearer. Objects are the numbers of parts."""
    there, objects = out.depth[where], out.objects[where]
    with np.errstate(invalid="ignore"):
        nearer = (depth < there) | (np.isnan(there) & ~np.isnan(depth))
    out.depth[where] = np.where(nearer, depth, there)
    out.objects[where] = np.where(nearer, np.int32(part), objects)


class Composited:
    """Several parts as one surface for the same camera; a ``Surface`` whose objects are the parts.

    Args:
        parts: in any order.
    """

    def __init__(self, parts: Sequence[Surface]) -> None:
        self.parts, self.side = parts, max((part.side for part in parts), default=64)

    def draw(self, area: Area) -> GBuffer:
        out = GBuffer.empty((area[1] - area[0], area[3] - area[2]))
        for number, part in enumerate(self.parts):
            put_nearer(out, np.s_[:, :], part.draw(area).depth, number)
        return out

    def at(self, px: Array, py: Array) -> GBuffer:
        out = GBuffer.empty(px.shape)
        for number, part in enumerate(self.parts):
            put_nearer(out, (slice(None),), part.at(px, py).depth, number)
        return out


__all__ = ["NONE", "Box", "Composited", "frame_of", "put_nearer", "split", "split_triangles", "windows_of"]
