"""Restricted quadtree: squares whose neighbours differ by at most one level, cut into triangle fans.

Von Herzen & Barr, *Accurate Triangulations of Deformed, Intersecting Surfaces* (SIGGRAPH 1987); Sivan & Samet,
*Algorithms for Constructing Quadtree Surface Maps* (1992); Pajarola, *Large Scale Terrain Visualization Using the
Restricted Quadtree Triangulation* (Vis 1998); Pajarola & Gobbetti, *Survey* (2007), sec. 2.

A diamond is *active* if the bound of its error exceeds the tolerance. Errors are saturated bottom up over the diamond
DAG and spheres nested, so an active diamond's parents are active. A square is split if, at one of its sides, a quarter
of it or of the square next door is active; hence a square that is split has neighbours of its own size on all four
sides, and nothing is ever repaired (docs/methods/restricted-quadtree.md has the proof). ``triangulation`` says how
squares become triangles:

- ``conforming``: four triangles around the centre, two instead of one at a side that borders smaller squares, or whose
  middle is active;
- ``restricted``: eight, one instead of two at a side that borders a larger square;
- ``unrestricted``: squares by their own error, which knows of no neighbour, each cut in two. It cracks.

The kernels are in ``restricted_quadtree_cells`` (the squares, level by level, threads share those of a level) and
``restricted_quadtree_strip`` (one generalised strip along a Hilbert curve). Metres, pixels.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.error.screen import Metric, metric_of
from orograph.errors import UsageError
from orograph.lod.budget import by_tolerance
from orograph.lod.criterion import NOTHING, Criterion, first_bits
from orograph.lod.method import Goal, MethodInfo
from orograph.lod.options import option
from orograph.lod.restricted_quadtree_cells import Cells, begin, split_cells, weigh_cells, weigh_cells_alone
from orograph.lod.restricted_quadtree_strip import CONFORMING, RESTRICTED, UNRESTRICTED, Path, write_strip
from orograph.lod.right_triangles import Mesh, MeshOptions, RightTriangleMeshes
from orograph.parallel import for_each
from orograph.viewpoint import Camera

TRIANGULATIONS = {"conforming": CONFORMING, "restricted": RESTRICTED, "unrestricted": UNRESTRICTED}

SHARE = 2048
"""Squares that a thread takes at a time."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RestrictedQuadtreeOptions(MeshOptions):
    """Options of ``restricted-quadtree``. See ``MeshOptions``; besides:

    Raises:
        UsageError: the metric ``localised`` for an unrestricted quadtree.
    """

    triangulation: str = option(
        "conforming", "How squares become triangles: conforming (four, more beside smaller ones), restricted (eight, "
                      "fewer beside larger ones), unrestricted (two, and squares ignore their neighbours: cracks, "
                      "and no promise).",
        choices=tuple(TRIANGULATIONS),
    )  # fmt: skip
    split_by: str = option(
        "quarters", "What splits a square: a quarter with too large an error (a side with one then gets "
                    "its middle), or a side, as published. Ignored for unrestricted squares.",
        choices=("quarters", "sides"),
    )  # fmt: skip

    def __post_init__(self) -> None:
        super(RestrictedQuadtreeOptions, self).__post_init__()  # (super() alone fails in a dataclass with slots)
        if self.triangulation == "unrestricted" and self.metric == "localised":
            raise UsageError(
                "Unrestricted squares are judged by their own error, and the metric 'localised' applies to diamonds "
                "only.",
                remedy="Use the metric anisotropic.",
            )

    @property
    def metric_used(self) -> Metric:
        """As ``MeshOptions.metric_used``; for unrestricted squares a metric of spheres."""
        if self.triangulation == "unrestricted" and self.metric is None:
            return metric_of("anisotropic")
        return super(RestrictedQuadtreeOptions, self).metric_used

    @property
    def conservative(self) -> bool:
        """As ``MeshOptions.conservative``; unrestricted squares promise nothing."""
        return self.triangulation != "unrestricted" and super(RestrictedQuadtreeOptions, self).conservative


class RestrictedQuadtree(RightTriangleMeshes):
    """A restricted quadtree. See ``RightTriangles`` for the arguments.

    Attributes:
        cells: the squares of the last refinement; ``count`` of them.
    """

    info = MethodInfo(
        "restricted-quadtree", "squares whose neighbours differ by one level at most, cut into triangle fans",
        "Von Herzen & Barr 1987; Sivan & Samet 1992; Pajarola 1998", "triangles", RestrictedQuadtreeOptions,
        lambda options: options.conservative,
    )  # fmt: skip

    def __init__(self, *args: Any, **given: Any) -> None:
        super().__init__(*args, **given)
        self.triangulation = TRIANGULATIONS[self.options.triangulation]
        self.by_sides: bool = self.options.split_by == "sides"
        self.cells, self.count = Cells.room_for(1 << 10), 0
        self._path = Path.of(self.field.n)
        self._keys, self._zs = np.empty(1 << 12, np.int64), np.empty(1 << 12, np.float32)

    def _refine(self, camera: Camera, goal: Goal) -> Mesh:
        if goal.tolerance is None:
            return by_tolerance(lambda pixels: self._refine(camera, Goal(pixels)), goal, self._last)
        lens = self._lens(camera, goal.tolerance)
        alone = self.triangulation == UNRESTRICTED
        pruned = NOTHING if alone else self._pruned(lens)
        rounds = 0
        if self.field.n == 0:
            keys, zs, made, leaves = (*_one_cell(self.field.corners), 1)
        else:
            weigh = weigh_cells_alone if alone else weigh_cells
            rounds = self._grow(Criterion(lens, self.spheres, self.cull, pruned), weigh)
            keys, zs, made, leaves = self._strip()
        shape = {"triangulation": self.options.triangulation, "squares": self.count, "fans": leaves}
        return Mesh(
            keys, zs, is_strip=True, clockwise=False, triangles=made, stats={**shape, "rounds": rounds}
        )  # fmt: skip

    def _grow(self, criterion: Criterion, weigh: Any) -> int:
        """Make the squares level by level; return how often they were weighed: once, and again for each lack of a
        page."""
        self.field.begin()
        begin(self.cells, self.field.n, self.field.corners, int(first_bits(criterion)))
        start, end, octave, rounds = 0, 1, self.field.n - 1, 1
        while start < end:
            splits = self._weigh(weigh, criterion, start, end, octave)
            while self.field.fetch():
                rounds += 1
                splits = self._weigh(weigh, criterion, start, end, octave)
            more = end + 4 * splits
            if more > len(self.cells.numbers):
                self.cells = self.cells.grown(2 * more)
            split_cells(self.cells, start, end, octave)
            start, end, octave = end, more, octave - 1
        self.count = end
        return rounds

    def _weigh(self, weigh: Any, criterion: Criterion, start: int, end: int, octave: int) -> int:
        """Weigh the squares of a level; return how many are to be split."""
        pages, cells = self.field.pages, self.cells
        if self.jobs == 1 or end - start < 2 * SHARE:
            return int(weigh(pages, criterion, self.by_sides, cells, start, end, octave))
        shares = range(start, end, SHARE)
        splits = np.zeros(len(shares), np.int64)

        def work(share: int) -> None:
            at = shares[share]
            splits[share] = weigh(pages, criterion, self.by_sides, cells, at, min(at + SHARE, end), octave)

        for_each(work, range(len(shares)), self.jobs)
        return int(splits.sum())

    def _strip(self) -> tuple[NDArray[np.int64], NDArray[np.float32], int, int]:
        """The strip (views of buffers that the next one uses again), its triangles, and how many fans they are."""
        while True:
            length, made, leaves = write_strip(
                self.cells, self.field.n, self.triangulation, self.field.pages.edge, self._path, self._keys, self._zs
            )
            if length >= 0:
                return self._keys[:length], self._zs[:length], made, leaves
            self._keys, self._zs = (np.empty(2 * len(a), a.dtype) for a in (self._keys, self._zs))


def _one_cell(corners: NDArray[np.float32]) -> tuple[NDArray[np.int64], NDArray[np.float32], int]:
    """The strip of a raster of 2 × 2 samples, which is no square of the quadtree, and its triangles."""
    keys = np.array([1 << 32, 1 << 32 | 1, 0, 1])
    zs = np.array([corners[1, 0], corners[1, 1], corners[0, 0], corners[0, 1]])
    there = [not np.isnan(zs[:3]).any(), not np.isnan(zs[1:]).any()]
    if there == [False, True]:
        keys, zs = keys[[1, 1, 2, 3]], zs[[1, 1, 2, 3]]
    size = 4 if there[1] else 3 if there[0] else 0
    return keys[:size], zs[:size], sum(there)
