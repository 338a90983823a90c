"""BDAM's geomorphs: the surface between the TIN of a patch and those of the two patches below it.

TINs of two levels share no edges but those of the hierarchy. So what is between them is a mesh with the edges of both
(``tin_overlay``), whose vertices have a height on either: as it is linear on both everywhere, each height between is a
mesh between. Where both keep a tolerance, so does that, on every vertical.

While the bound of a diamond's error grows from τ/κ to τ, its patches grow from their TINs to those of the patches
below, which replace them at τ. That all patches agree where they touch needs one thing more: no diamond grows before
those above it in the DAG have ended. So errors are made no less than κ times those below (``Separated``), as those of
``triangle-patches`` are. Then a patch's legs, which belong to the diamonds below it, do not move, and its hypotenuse
moves on both sides at once. Pixels, metres.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable

import numpy as np

from orograph.hierarchy import diamonds, triangles
from orograph.lod.selection import TinBatch
from orograph.lod.tin_overlay import Flat, overlaid
from orograph.parallel import map_ordered
from orograph.store.diamonds import place
from orograph.store.patches import KAPPA, octave_shape, saturate
from orograph.store.terrain import Heights, Shape, Terrain, exponent
from orograph.store.tins import Tins, octaves, stored_levels

PLACES = 30
"""Crossings lie at multiples of 2^(n − 30) samples: a column or row is of 30 bits, as the referee counts them."""

BYTES = 48
"""Of an overlay, for each of its triangles, about."""

LEAST = 1e-4
"""Patches that have grown by less count as not grown: the difference is rounding."""

Name = tuple[int, int, int]
"""A patch: the row and column of its diamond, and on which side of the hypotenuse it is."""

Halves = Callable[[list[Name]], list[TinBatch]]
"""Makes the meshes of patches."""


class Separated:
    """Errors of TINs, each at least κ times those below it. See ``MemoryTins``.

    They are made of all errors when the table is: four bytes for each diamond that may have a TIN.
    """

    def __init__(self, terrain: Terrain, tins: Tins) -> None:
        self.tins = tins
        top = terrain.levels - 1
        shape = terrain.grid.shape
        self._errors: dict[int, Heights] = {}
        for level in stored_levels(shape, tins.legs):
            rows, cols = terrain.diamond_shape(level)
            self._errors[level] = np.array(tins.read(level, 0, rows, 0, cols)[0])
        below: Heights | None = None
        for k in octaves(shape, tins.legs):
            level = min(k, top)
            step = 1 << (k - level)
            rows, cols = octave_shape(terrain, k)
            whole = self._errors[level]
            told = whole[: (rows - 1) * step + 1 : step, : (cols - 1) * step + 1 : step].copy()
            raised = np.maximum(told, np.float32(0))
            saturate(raised, below)
            below = raised
            place(whole, np.where(told < 0, told, raised), k, 0, 0, level)

    def read(self, level: int, row0: int, row1: int, col0: int, col1: int) -> tuple[Heights, Heights]:
        """Errors and radii of entries of a level."""
        errors, radii = self.tins.read(level, row0, row1, col0, col1)
        if level in self._errors:
            errors = self._errors[level][row0:row1, col0:col1]
        return errors, radii


def share_of(pixels: float, tolerance: float) -> float:
    """How far an unsplit patch has grown towards those below it, by the bound of its error."""
    least = tolerance / KAPPA
    share = (pixels - least) / (tolerance - least) if tolerance > least else 0.0
    return min(share, 1.0) if share > LEAST else 0.0


class Morphs:
    """Meshes between TINs; as many as memory allows are cached.

    Args:
        shape: of the raster. halves: makes the meshes of patches. flip: whether their triangles turn positively in
            (column, row). most: bytes. jobs: threads.
    """

    def __init__(self, shape: Shape, halves: Halves, *, flip: bool, most: int, jobs: int) -> None:
        self.shape, self._halves, self._flip, self._most, self.jobs = shape, halves, flip, most, jobs
        self._fraction = 2.0 ** (PLACES - exponent(shape))
        self._kept: OrderedDict[Name, TinBatch] = OrderedDict()
        self._bytes = 0

    def between(self, names: list[Name], meshes: list[TinBatch], shares: list[float]) -> list[TinBatch]:
        """What is between patches and those below them.

        Args:
            names, meshes: of the patches. shares: how far each has grown.
        """
        lacking = [k for k, name in enumerate(names) if name not in self._kept]
        halves = [self._below(names[k]) for k in lacking]
        below = iter(self._halves([half for two in halves for half in two]))
        parts = [(meshes[k], [next(below) for _ in two]) for k, two in zip(lacking, halves)]
        for k, made in zip(lacking, map_ordered(self._made, parts, self.jobs)):
            self._kept[names[k]] = made
            self._bytes += BYTES * len(made.triangles)
        found = []
        for name, share in zip(names, shares):
            self._kept.move_to_end(name)
            one = self._kept[name]
            found.append(TinBatch(one.vertices, one.triangles, one.coarse, share))
        while self._bytes > self._most and len(self._kept) > len(names):
            self._bytes -= BYTES * len(self._kept.popitem(last=False)[1].triangles)
        return found

    def _below(self, name: Name) -> list[Name]:
        """The patches below one that are not beyond the raster."""
        row, col, side = name
        last_row, last_col = self.shape[0] - 1, self.shape[1] - 1
        found = []
        for half in (0, 1):
            child = triangles.child(*diamonds.top(row, col, side), half)
            corners = (corner(*child) for corner in (triangles.apex, triangles.left_end, triangles.right_end))
            west, north = (min(at) for at in zip(*corners))
            if west < last_col and north < last_row:
                found.append((int(child[1]), int(child[0]), int(child[3]) >> 2))
        return found

    def _made(self, meshes: tuple[TinBatch, list[TinBatch]]) -> TinBatch:
        """What is between a patch and those below it."""
        coarse, fine = meshes
        vertices, corners = overlaid(self._flat(fine), self._flat([coarse]), self._fraction)
        if not self._flip:
            corners = corners[:, ::-1]
        return TinBatch(vertices[:, :3], corners, vertices[:, 3])

    def _flat(self, meshes: list[TinBatch]) -> Flat:
        """Meshes as one, whose triangles turn positively."""
        base, corners = 0, []
        for one in meshes:
            corners.append((one.triangles if self._flip else one.triangles[:, ::-1]) + np.int32(base))
            base += len(one.vertices)
        points = np.concatenate([one.vertices for one in meshes])
        # Both sides of the edge between two parts list its vertices; they are one.
        _, first, where = np.unique(points[:, :2], axis=0, return_index=True, return_inverse=True)
        x, y, z = points[first].T
        return Flat(
            x.astype(np.int64), y.astype(np.int64), np.ascontiguousarray(z),
            where.ravel()[np.concatenate(corners)].astype(np.int32),
        )  # fmt: skip
