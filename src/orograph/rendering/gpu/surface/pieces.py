"""Pieces of square patches, such as ``seamless-patches`` selects: shapes are uploaded once, and drawn as instances.

All pieces of a shape share its triangles, and all take their heights from the atlas, as the terrain's own patches do:
a patch lies within one tile of each level that its vertices may be of. So a frame brings nothing but 20 bytes for every
``RUN`` triangles: of which shape they are, where they lie, and of which level. A selection is drawn when all its tiles
are there (``stream.residency.Residency.hold``); they stay while it is drawn.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.gpu.device import Device
from orograph.lod.selection import PieceSet, Topology
from orograph.rendering.gpu.stream.residency import Residency
from orograph.rendering.gpu.surface.resident import Resident, RunPass, runs_of
from orograph.store.terrain import TILE

INSTANCE = np.dtype([("first", "<u4"), ("count", "<u4"), ("row", "<i4"), ("col", "<i4"), ("how", "<i4")])
"""A run of triangles: ``Run`` of ``shaders/piece_draw.wgsl``."""

RUNS = {
    "array_stride": INSTANCE.itemsize,
    "step_mode": "instance",
    "attributes": [
        {"format": "uint32x2", "offset": 0, "shader_location": 0},
        {"format": "sint32x3", "offset": 8, "shader_location": 1},
    ],
}

COARSER = 1.25
"""By how much a tolerance grows until the atlas has room for its tiles."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DrawnPieces(Resident):
    """Pieces whose shapes are on the GPU.

    Attributes:
        corners: the buffer of the shapes' triangles. runs: (n,) of ``INSTANCE``.
        tiles: (k,) int64, the tiles of heights that it needs, by their places in the page table.
    """

    corners: Any
    runs: NDArray[np.void]
    tiles: NDArray[np.int64]

    @property
    def buffers(self) -> dict[str, Any]:
        """By the names that the shader has for them."""
        return {"triangles": self.corners}


@dataclass(slots=True, eq=False)
class Shapes:
    """Topologies in the GPU's memory.

    Attributes:
        of: which, and whether their triangles were turned over. corners: the buffer, 3 words a triangle.
        firsts, counts: of their triangles.
    """

    of: tuple[Sequence[Topology], bool]
    corners: Any
    firsts: NDArray[np.int64]
    counts: NDArray[np.int64]


def packed(topologies: Sequence[Topology], turned_over: bool) -> NDArray[np.uint32]:
    """The corners (3 t,) of all triangles: rows and columns on the lattice, a byte each."""
    parts = []
    for one in topologies:
        words = one.points[:, 0].astype(np.uint32) | one.points[:, 1].astype(np.uint32) << 8
        parts.append(words[one.triangles[:, [0, 2, 1]] if turned_over else one.triangles].ravel())
    return np.concatenate(parts)


class Pieces:
    """Makes selections of pieces ready to be drawn.

    Args:
        tiles: whose atlas has the heights.

    Attributes:
        sent: bytes that the last selection brought, besides its runs and tiles.
    """

    def __init__(self, device: Device, tiles: Residency) -> None:
        self.device, self.tiles = device, tiles
        self.sent = 0
        self._shapes: Shapes | None = None

    def ready(self, selection: PieceSet, again: Callable[[float], PieceSet]) -> DrawnPieces:
        """A selection with its shapes on the GPU; coarser where the atlas has no room for its tiles.

        Args:
            again: selects with another tolerance, pixels.

        Raises:
            DeviceLimitError: the device's memory is full.
        """
        shapes = self._made(selection)
        tolerance = float(selection.stats.get("tolerance") or 0.25)
        tiles = self._tiles(selection)
        while len(tiles) > self.tiles.most_held and len(selection.instances) > 8:
            tolerance *= COARSER
            selection = again(tolerance)
            tiles = self._tiles(selection)
        order = np.argsort(selection.shapes, kind="stable")  # as ``PieceSet.tessellation`` has them
        which = selection.shapes[order]
        counts = shapes.counts[which]
        runs, of = runs_of(INSTANCE, shapes.firsts[which], counts)
        pieces = selection.instances[order[of]]
        runs["row"], runs["col"] = pieces["row"], pieces["col"]
        runs["how"] = pieces["p"] | (selection.side.bit_length() - 1) << 8 | pieces["turns"] << 16
        runs["how"] |= self._level(pieces) << 24
        return DrawnPieces(
            method=selection.method, bound=selection.bound, stats=selection.stats, corners=shapes.corners, runs=runs,
            triangles=int(counts.sum()), given=selection, tiles=tiles,
        )  # fmt: skip

    def _made(self, selection: PieceSet) -> Shapes:
        """The shapes of a selection, brought there."""
        of, shapes = (selection.topologies, selection.clockwise), self._shapes
        self.sent = 0
        if shapes is None or shapes.of[0] is not of[0] or shapes.of[1] != of[1]:
            corners = packed(*of)
            counts = np.array([len(one.triangles) for one in of[0]], np.int64)
            buffer = self.device.buffer(corners, "STORAGE|COPY_SRC", "triangles of pieces")
            shapes = self._shapes = Shapes(of, buffer, np.cumsum(counts) - counts, counts)
            self.sent = corners.nbytes
        return shapes

    def _level(self, pieces: NDArray[Any]) -> NDArray[np.int32]:
        """The levels of their tiles: the coarsest tile holds the samples of all coarser levels, too."""
        levels: NDArray[np.int32] = pieces["level"]
        return np.minimum(levels, len(self.tiles.heights.tables.shapes) - 1)

    def _tiles(self, selection: PieceSet) -> NDArray[np.int64]:
        """The tiles of heights of a selection, by their places in the page table."""
        pieces, tables = selection.instances, self.tiles.heights.tables
        level = self._level(pieces)
        shift = level + TILE.bit_length() - 1
        across = np.array([cols for _, cols in tables.shapes], np.int64)
        places = np.array(tables.offsets, np.int64)[level] + (pieces["row"] >> shift) * across[level]
        return np.unique(places + (pieces["col"] >> shift))


class PiecePass(RunPass):
    """Draws pieces into depth and marks. Args: as for ``FacePass``."""

    def __init__(self, device: Device, camera: Any, field: tuple[Any, Any, Any], missing: int) -> None:
        super().__init__(device, "piece_draw", camera, field, missing, RUNS, HOLES=1)
