"""SOAR: one pass without state over nested spheres, one generalised triangle strip out.

Lindstrom & Pascucci, *Visualization of Large Terrains Made Easy* (Vis 2001) and *Terrain Simplification Simplified*
(TVCG 2002). A diamond is *active* if the bound of its error over its sphere exceeds the tolerance and the sphere is in
view. Errors are monotonic and spheres nested, so a diamond's parents are active when it is: both triangles that share a
diamond decide alike, wherever they are met, and the mesh conforms without neighbours, queues or state. The pass goes
through the leaves in the order of a Sierpinski curve, in which each shares an edge with the next: a strip.

What differs from the papers: both children are weighed when their parent is split, so that leaves, half of all
triangles, are never visited (and two look-ups are under way at once). Leaves can be missing: subtrees out of view and
holes are left out, and the strip is taken up again behind them. The metric holds away from the image centre. Geomorphs
(2002, sec. 5.3) are those of ``lod.geomorph``, which keep the tolerance. See docs/methods/soar.md.

The pass begins with a *frontier* of subtrees of one level in view (``soar_pass.frontier``), which threads share
(``lod.work_sharing``): one takes them from the front and writes the strip where it belongs, the others from the back,
until they meet; what these made is put behind. What comes out does not depend on the number of threads.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.error.screen import CameraParameters, Metric, metric_of
from orograph.errors import UsageError
from orograph.lod import work_sharing
from orograph.lod.budget import by_tolerance
from orograph.lod.criterion import Criterion
from orograph.lod.method import Goal, MethodInfo
from orograph.lod.options import option
from orograph.lod.right_triangles import Mesh, MeshOptions, RightTriangleMeshes
from orograph.lod.soar_join import lay_out, put
from orograph.lod.soar_pass import Stack, Subtrees, frontier, refine_subtrees
from orograph.parallel import Crew
from orograph.viewpoint import Camera

Strip = tuple[NDArray[np.int64], NDArray[np.float32]]
"""Keys and heights of a strip's vertices."""

CUT = 8
"""Level of the subtrees that threads share."""

FEW = 32
"""Fewer split subtrees than this are not worth sharing (nor a strip that begins anew for each)."""


def _buffer(*shape: int) -> Strip:
    return np.empty(shape, np.int64), np.empty(shape, np.float32)


@dataclass(frozen=True, slots=True, kw_only=True)
class SoarOptions(MeshOptions):
    """Options of ``soar``. See ``MeshOptions``; besides:

    Raises:
        UsageError: geomorphs with the metric ``localised``.
    """

    geomorph: bool = option(
        False, "Vertices grow out of their edges between half the tolerance and the full one, which the mesh always "
               "keeps; the metric is then anisotropic unless given.",
    )  # fmt: skip

    def __post_init__(self) -> None:
        super(SoarOptions, self).__post_init__()  # (super() alone fails in a dataclass with slots)
        if self.geomorph and self.metric == "localised":
            raise UsageError(
                "Geomorphs need the bounds themselves, but 'localised' only decides yes or no.",
                remedy="Use the metric anisotropic.",
            )

    @property
    def metric_used(self) -> Metric:
        """As ``MeshOptions.metric_used``; with geomorphs one of spheres."""
        if self.geomorph and self.metric is None:
            return metric_of("anisotropic")
        return super(SoarOptions, self).metric_used


class Soar(RightTriangleMeshes):
    """SOAR. See ``RightTriangles`` for the arguments."""

    info = MethodInfo(
        "soar", "nested errors and spheres, refined in one recursive pass, which leaves a triangle strip",
        "Lindstrom & Pascucci 2001 and 2002", "triangles", SoarOptions, lambda options: options.conservative,
    )  # fmt: skip

    def __init__(self, *args: Any, **given: Any) -> None:
        super().__init__(*args, **given)
        self.geomorph: bool = self.options.geomorph
        self._cut = max(0, min(CUT, 2 * self.field.n - 1))
        size = 2 << self._cut
        self._frontier = Subtrees(
            np.empty((size, 4), np.int64), np.empty((size, 4), np.float32), np.empty((size, 3), np.int64)
        )
        side = 1 << self.field.n
        nw, ne, sw, se = 0, side, side << 32, side << 32 | side
        z = self.field.corners
        self._corners = np.array([[nw, se, ne], [se, nw, sw]], np.int64)
        self._corner_zs = np.array([[z[0, 0], z[1, 1], z[0, 1]], [z[1, 1], z[0, 0], z[1, 0]]], np.float32)
        self._whole, self._parts = _buffer(1 << 16), _buffer(self.jobs - 1, 1 << 16)
        self._places = np.zeros((size, 4), np.int64)
        self._crew = Crew(self.jobs - 1)

    def _refine(self, camera: Camera, goal: Goal) -> Mesh:
        if goal.tolerance is None:
            return by_tolerance(lambda pixels: self._refine(camera, Goal(pixels)), goal, self._last)
        lens = self._lens(camera, goal.tolerance * (0.5 if self.geomorph else 1.0))
        pruned = self._pruned(lens)
        rounds = 0
        while True:
            self.field.begin()
            rounds += 1
            keys, zs, made, nodes = self._strip(lens, pruned)
            if not self.field.fetch():
                break
        if self.geomorph and lens.focal > 0.0:
            from orograph.lod.geomorph import morph

            zs = morph(self.field, lens, self.spheres, keys, zs)
        return Mesh(
            keys, zs, is_strip=True, clockwise=False, triangles=made,
            stats={"nodes": nodes, "rounds": rounds, "geomorph": self.geomorph},
        )  # fmt: skip

    def _strip(
        self, lens: CameraParameters, pruned: NDArray[np.int64]
    ) -> tuple[NDArray[np.int64], NDArray[np.float32], int, int]:
        """One pass: the strip (views of buffers that the next pass reuses), its triangles, diamonds visited."""
        common = self.field.pages, Criterion(lens, self.spheres, self.cull, pruned), 2 * self.field.n
        stack = self._stack()
        for cut in (self._cut, 0):
            count, split, nodes = frontier(*common, cut, self._corners, self._corner_zs, stack, self._frontier)
            if split >= FEW:
                break
        helpers = self.jobs - 1 if split >= FEW else 0
        while True:
            counts, joins = self._share(common, count, helpers)
            if counts[-1, 0] < 0:
                self._whole = _buffer(2 * len(self._whole[0]))
            elif (counts[:, 0] < 0).any():
                self._parts = _buffer(len(self._parts[0]), 2 * self._parts[0].shape[1])
            else:
                break
        whole, parts = self._whole, self._parts
        length, made, looked, first = (int(v) for v in counts[-1, :4])
        if first < count:
            made, looked = (int(v) for v in counts[:, 1:3].sum(axis=0))
            room = length + int(self._places[first:count, 2].sum()) + 3 * (count - first)
            if room > len(whole[0]):
                self._whole = _buffer(room + room // 4)
                for place in (0, 1):
                    self._whole[place][:length] = whole[place][:length]
                whole, joins = self._whole, work_sharing.begin()  # helpers do not know of it
            length = lay_out(*whole, length, *parts, self._places, first, count, joins)
            try:
                put(*whole, *parts, self._places, count, joins, False)
            finally:
                work_sharing.close(joins)
        return whole[0][:length], whole[1][:length], made, nodes + looked

    def _share(self, common: tuple[Any, ...], count: int, helpers: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Refine ``count`` subtrees with helpers.

        Returns: ``counts`` of each helper and, last, of this thread; the state in which helpers wait for ``lay_out``.
        """
        shares, joins = work_sharing.begin(), work_sharing.begin()
        counts = np.zeros((helpers + 1, 16), np.int64)  # 16: no two threads write to one cache line
        parts, whole, places = self._parts, self._whole, self._places

        def refine(helper: int, keys: NDArray[np.int64], zs: NDArray[np.float32]) -> None:
            refine_subtrees(
                *common, self._frontier, count, shares, helper, self._stack(), keys, zs, places, counts[helper]
            )

        def help_out(helper: int) -> None:
            refine(helper, parts[0][helper], parts[1][helper])
            put(*whole, *parts, places, count, joins, True)

        if helpers:
            self._crew.call(help_out)
        try:
            refine(-1, *whole)
        finally:
            work_sharing.close(shares)
        return counts, joins

    def _stack(self) -> Stack:
        size = 2 * self.field.n + 1
        return Stack(np.empty((size, 5), np.int64), np.empty((size, 3), np.float32))
