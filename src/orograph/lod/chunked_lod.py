"""Chunked LOD: a quadtree of prebuilt meshes, each as fine as its level requires, chosen by distance; with skirts.

Ulrich, *Rendering Massive Terrains using Chunked Level of Detail Control* (SIGGRAPH 2002 course *Super-size it!*). Each
chunk of the quadtree has its own mesh, simplified in advance to the error of its level, which halves from level to
level (``store.chunked``). With D the distance from the eye to a chunk's box, its error covers ρ = error · K / D pixels;
if ρ exceeds the tolerance τ, its four children are drawn instead. A chunk's vertices all move together between their
places in its parent's mesh and in its own: morph = clamp(2ρ/τ − 1, 0, 1). When a parent is split its children look as
it did. Skirts hide gaps between chunks. Errors of vertices are not a bound: no promise.

Adjacent chunks are kept within two levels, since a skirt covers no more: where distance alone asks for more, the
coarser one is split. Metres, pixels.
"""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from orograph.lod.budget import Pass, by_tolerance
from orograph.lod.method import EVERYTHING, Goal, Method, MethodInfo, Need, Ready
from orograph.lod.options import check, option
from orograph.lod.selection import CodedChunks, TinBatch, TinBatches
from orograph.lod.squares import BlockHeights, Index, Squares
from orograph.parallel import map_ordered
from orograph.raycast.select import distances, in_frustum
from orograph.store.chunk_code import HEADER, chunk_of, off_by
from orograph.store.chunked import ALL_CELLS, APART, CELLS, Chunk, Kind, Words
from orograph.tessellation import Tessellation, turn
from orograph.viewpoint import Camera

Array = NDArray[np.float64]
Name = tuple[int, int, int]
"""Of a chunk: level, row, column."""


def _kind(options: ChunkedLodOptions) -> Kind:
    return Kind(options.cells, options.finest, options.compressed)


@dataclass(frozen=True, slots=True, kw_only=True)
class ChunkedLodOptions:
    """Options of ``chunked-lod``."""

    cells: int = option(CELLS, "Cells along a side of the finest chunks.", choices=ALL_CELLS)
    finest: float = option(
        0.0, "Error of the finest chunks; 0: derived from the terrain.", unit="metres", least=0.0, most=1e6
    )
    morph: bool = option(True, "Whether vertices move between levels, so that nothing pops.")
    skirts: bool = option(True, "Whether skirts hang from the sides of chunks.")
    compressed: bool = option(
        False, "Whether meshes are compressed, with quantised heights, and decoded by the GPU for drawing."
    )

    def __post_init__(self) -> None:
        check(self)


@dataclass(slots=True)
class Chosen:
    """The selection for a tolerance.

    Attributes:
        names: of the chunks, and how far each has left its parent's mesh: 0 … 1.
        triangles: of all, skirts included. skirts: of those. within, tolerance: as of ``budget.Coarsened``.
    """

    names: dict[Name, float]
    forced: int
    triangles: int = 0
    skirts: int = 0
    within: bool = True
    tolerance: float | None = None

    def kept(self) -> Self:
        """Itself: no part of it is reused."""
        return self


class ChunkedLod(Method):
    """Chunked LOD. See ``Method`` for the arguments.

    Attributes:
        chunks: the terrain's.

    Raises:
        UsageError: the terrain has no surface.
    """

    info = MethodInfo(
        "chunked-lod", "a quadtree of ready meshes with skirts, as fine as the distance asks; vertices morph",
        "Ulrich 2002", "batches", ChunkedLodOptions, lambda options: False, conforming=False,
    )  # fmt: skip

    def __init__(self, *args: Any, **given: Any) -> None:
        super().__init__(*args, **given)
        self.chunks = self.terrain.derived("chunked", **_kind(self.options)._asdict())
        self.layout = self.chunks.layout
        self._heights = BlockHeights(self.terrain)
        self._kept: OrderedDict[Name, Chunk | Words] = OrderedDict()
        self._bytes = 0
        self._flip = turn(self.terrain.grid) > 0
        self._last = Pass()

    @classmethod
    def needs(cls, options: Any) -> tuple[Need, ...]:
        """The meshes of chunks."""
        return (Need("chunked", _kind(options)._asdict()),)

    def select(self, camera: Camera, goal: Goal, ready: Ready = EVERYTHING) -> TinBatches | CodedChunks:
        """The chunks of a view."""
        self.info.check_goal(goal.name)
        began = time.perf_counter()

        def at(tolerance: float) -> Chosen:
            found = self.chosen(camera, tolerance)
            self._fetch(list(found.names))
            counts = np.array([self._count(name) for name in found.names], np.int64).reshape(-1, 2).sum(0)
            found.skirts = int(counts[1]) if self.options.skirts else 0
            found.triangles = int(counts[0]) + found.skirts
            return found

        found = at(goal.tolerance) if goal.tolerance is not None else by_tolerance(at, goal, self._last)
        tolerance = goal.tolerance if goal.tolerance is not None else found.tolerance
        selected = time.perf_counter()
        self._fetch(list(found.names))
        made: TinBatches | CodedChunks = self._coded(found) if self.options.compressed else self._batches(found)
        stats: dict[str, Any] = {
            "method": self.info.name, "tolerance": tolerance, "conservative": False, "geomorph": True,
            "exaggeration": camera.exaggeration, "refine_ms": round((time.perf_counter() - began) * 1e3, 3),
            "select_ms": round((selected - began) * 1e3, 3), "chunks": len(found.names), "forced": found.forced,
            "triangles": found.triangles, "skirt_triangles": found.skirts, **made.stats,
        }  # fmt: skip
        if goal.triangles is not None:
            stats["within_budget"] = found.within
        self._let_go()
        self._last.selected(began)
        return replace(made, stats=stats)

    # ---- selecting ----

    def chosen(self, camera: Camera, tolerance: float) -> Chosen:
        """The chunks that a camera sees within a tolerance in pixels."""
        split, forced = self.split(camera, tolerance)
        names: dict[Name, float] = {}
        level = self.layout.top
        squares = self._squares(level, np.zeros(1, np.int64), np.zeros(1, np.int64))
        while len(squares):
            squares = squares.where(in_frustum(self.terrain, camera.view, camera.exaggeration, self._boxes(squares)))
            further = np.isin(squares.codes, split[level]) if level else np.zeros(len(squares), bool)
            drawn = squares.where(~further)
            left = self._left(camera, drawn, level, tolerance)
            names |= {(level, i, j): m for i, j, m in zip(drawn.row.tolist(), drawn.col.tolist(), left.tolist())}
            squares = self._heights.on_ground(squares.where(further).children())
            level -= 1
        return Chosen(names, forced)

    def split(self, camera: Camera, tolerance: float) -> tuple[dict[int, Index], int]:
        """The codes of the chunks that are split, by level, and how many of them only because of neighbours.

        This includes chunks out of view, since one in view may be next to them.
        """
        wanted: dict[int, set[tuple[int, int]]] = {level: set() for level in range(1, self.layout.top + 1)}
        squares = self._squares(self.layout.top, np.zeros(1, np.int64), np.zeros(1, np.int64))
        for level in range(self.layout.top, 0, -1):
            squares = squares.where(self._pixels(camera, squares, level) > tolerance)
            if not len(squares):
                break
            wanted[level] = set(zip(squares.row.tolist(), squares.col.tolist()))
            squares = self._heights.on_ground(squares.children())
        asked = sum(map(len, wanted.values()))
        for level in range(1, self.layout.top):
            rows, cols = self.layout.chunks(level)
            for i, j in wanted[level]:
                wanted[level + 1].add((i >> 1, j >> 1))
                if level + APART > self.layout.top:
                    continue
                for r, c in ((i - 1, j), (i, j - 1), (i + 1, j), (i, j + 1)):
                    if 0 <= r < rows and 0 <= c < cols:
                        wanted[level + APART].add((r >> APART, c >> APART))
        codes = {k: np.array(sorted(i << 32 | j for i, j in of), np.int64) for k, of in wanted.items()}
        return codes, sum(map(len, wanted.values())) - asked

    def _squares(self, level: int, row: Index, col: Index) -> Squares:
        return Squares(self.layout.p + level, row, col)

    def _boxes(self, squares: Squares) -> Any:
        return self._heights.of(squares)

    def _pixels(self, camera: Camera, squares: Squares, level: int) -> Array:
        """The error of a level at each square, pixels."""
        view = camera.view
        if view.projection == "plan":
            return np.zeros(len(squares))
        error = camera.exaggeration * self.chunks.error * 2.0**level
        away = distances(self.terrain, view, camera.exaggeration, self._boxes(squares))
        with np.errstate(divide="ignore"):
            return np.asarray(error / (away * view.pixel_slope))

    def _left(self, camera: Camera, squares: Squares, level: int, tolerance: float) -> Array:
        """How far chunks have morphed away from their parents' meshes."""
        if not self.options.morph or level == self.layout.top or tolerance == 0:
            return np.ones(len(squares))
        return np.clip(2 * self._pixels(camera, squares, level) / tolerance - 1, 0.0, 1.0)

    # ---- meshes ----

    def _fetch(self, names: list[Name]) -> None:
        """Load chunks' meshes into memory, in several threads."""
        lacking = []
        for name in names:
            if name in self._kept:
                self._kept.move_to_end(name)
            else:
                lacking.append(name)
        get: Callable[..., Chunk | Words] = self.chunks.words if self.options.compressed else self.chunks.chunk
        for name, chunk in zip(lacking, map_ordered(lambda n: get(*n), lacking, self.resources.jobs)):
            self._kept[name] = chunk
            self._bytes += chunk.nbytes

    def _let_go(self) -> None:
        """Drop the least recently used chunks beyond the memory limit."""
        while self._bytes > self.resources.max_memory // 2 and len(self._kept) > 1:
            self._bytes -= self._kept.popitem(last=False)[1].nbytes

    def _count(self, name: Name) -> tuple[int, int]:
        """A chunk's triangles, and its skirt's."""
        chunk = self._kept[name]
        if isinstance(chunk, Chunk):
            return len(chunk.triangles) - chunk.skirt, chunk.skirt
        return int(chunk[HEADER.index("triangles")]), 2 * int(chunk[HEADER.index("hung")])

    def _batches(self, found: Chosen) -> TinBatches:
        """Chunks as meshes."""
        there = ((self._kept[name], left) for name, left in found.names.items())
        batches = [self._batch(chunk, left) for chunk, left in there if isinstance(chunk, Chunk)]
        return TinBatches(method=self.info.name, bound=None, batches=[one for one in batches if len(one.triangles)])

    def _coded(self, found: Chosen) -> CodedChunks:
        """Chunks in their stored form, and the maximum error of their heights."""
        names, words = list(found.names), [self._kept[name] for name in found.names]
        off = max((off_by(one) for one in words if not isinstance(one, Chunk)), default=0.0)
        return CodedChunks(
            method=self.info.name, bound=None, stats={"height_error": off}, layout=self.layout, source=self.chunks,
            names=names, words=[one for one in words if not isinstance(one, Chunk)],
            left=np.array(list(found.names.values()), np.float32), skirts=self.options.skirts, expand=self._expand,
        )  # fmt: skip

    def _expand(self, selection: CodedChunks) -> Tessellation:
        """The triangles of coded chunks."""

        def decode(k: int) -> TinBatch:
            return self._batch(chunk_of(selection.words[k], self.layout, *selection.names[k]), float(selection.left[k]))

        batches = [one for one in map_ordered(decode, range(len(selection.names)), self.resources.jobs)
                   if len(one.triangles)]  # fmt: skip
        of = {name: getattr(selection, name) for name in ("method", "bound", "stats")}
        return TinBatches(batches=batches, **of).tessellation()

    def _batch(self, chunk: Chunk, left: float) -> TinBatch:
        """A chunk's mesh with its vertices moved."""
        vertices, triangles, targets = chunk.vertices, chunk.triangles, chunk.targets
        if not self.options.skirts:
            triangles = triangles[: len(triangles) - chunk.skirt]
        used = ~np.isnan(vertices[:, 2])
        if not used.all():
            places = np.cumsum(used) - 1
            vertices, targets, triangles = vertices[used], targets[used], places[triangles].astype(np.int32)
        return TinBatch(vertices, triangles[:, ::-1] if self._flip else triangles, targets, min(left, 1.0))
