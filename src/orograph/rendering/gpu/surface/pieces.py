"""Pieces of square patches, such as ``seamless-patches`` selects: shapes are uploaded once, and drawn as instances.

All pieces of a shape share its triangles. A piece is identified by its shape and its place; its heights are read once
and stay on the GPU (4 bytes a vertex) while there is room. Besides new pieces' heights, a frame uploads 24 bytes
for every ``RUN`` triangles: their shape, their place, and the offset of their heights.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.gpu.device import Device
from orograph.lod.selection import PieceSet, Topology
from orograph.rendering.gpu.surface.resident import ROOM, ResidentMeshes, RunPass, runs_of

INSTANCE = np.dtype(
    [("first", "<u4"), ("count", "<u4"), ("vertex", "<u4"), ("row", "<i4"), ("col", "<i4"), ("how", "<i4")]
)
"""A run of triangles: ``Run`` of ``shaders/piece_draw.wgsl``."""

RUNS = {
    "array_stride": INSTANCE.itemsize,
    "step_mode": "instance",
    "attributes": [
        {"format": "uint32x3", "offset": 0, "shader_location": 0},
        {"format": "sint32x3", "offset": 12, "shader_location": 1},
    ],
}

COARSER = 1.25
"""Factor by which a tolerance grows until its pieces fit."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DrawnPieces(ResidentMeshes):
    """Pieces whose heights are on the GPU."""


@dataclass(slots=True, eq=False)
class Shapes:
    """Topologies in the GPU's memory.

    Attributes:
        of: the topologies, and whether their triangles were turned over. corners: the buffer, 3 words a triangle.
        firsts, counts: of their triangles. points: the number of points of each.
    """

    of: tuple[Sequence[Topology], bool]
    corners: Any
    firsts: NDArray[np.int64]
    counts: NDArray[np.int64]
    points: NDArray[np.int64]


@dataclass(slots=True, eq=False)
class Pool:
    """Heights in the GPU's memory.

    Attributes:
        heights: the buffer. room, used: its capacity in heights, and the used part.
        places: by a piece's shape and instance, as bytes, the number of its first height.
    """

    heights: Any
    room: int
    used: int = 0
    places: dict[bytes, int] = field(default_factory=dict)


def packed(topologies: Sequence[Topology], turned_over: bool) -> NDArray[np.uint32]:
    """The corners (3 t,) of all triangles: a point's number (16 bits), its row and its column on the lattice (8, 8)."""
    parts = []
    for one in topologies:
        points = one.points.astype(np.uint32)
        words = np.arange(len(points), dtype=np.uint32) | points[:, 0] << 16 | points[:, 1] << 24
        parts.append(words[one.triangles[:, [0, 2, 1]] if turned_over else one.triangles].ravel())
    return np.concatenate(parts)


class Pieces:
    """Uploads pieces to the GPU.

    Args:
        missing: the height that stands for a missing one (``tiles.missing``), metres.
        most: bytes available for heights; up to twice as many while frames still draw the last ones.

    Attributes:
        sent: bytes that the last selection uploaded, besides its runs.
    """

    def __init__(self, device: Device, missing: int, most: int) -> None:
        self.device, self.missing = device, missing
        self.most = min(most, device.largest) // 4
        self.sent = 0
        self._shapes: Shapes | None = None
        self._pool: Pool | None = None

    def ready(self, selection: PieceSet, again: Callable[[float], PieceSet]) -> DrawnPieces:
        """Return a selection on the GPU; coarser if memory does not hold it.

        Args:
            again: selects with another tolerance, pixels.

        Raises:
            DeviceLimitError: the device's memory is full.
        """
        shapes = self._made(selection)
        tolerance = float(selection.stats.get("tolerance") or 0.25)
        while len(selection.instances) > 8 and int(shapes.points[selection.shapes].sum()) > self.most:
            tolerance *= COARSER
            selection = again(tolerance)
        pool, vertices = self._held(selection, shapes)
        order = np.argsort(selection.shapes, kind="stable")  # the order of ``PieceSet.tessellation``
        which = selection.shapes[order]
        counts = shapes.counts[which]
        runs, of = runs_of(INSTANCE, shapes.firsts[which], counts, vertices[order])
        pieces = selection.instances[order[of]]
        runs["row"], runs["col"] = pieces["row"], pieces["col"]
        runs["how"] = pieces["p"] | (selection.side.bit_length() - 1) << 8 | pieces["turns"] << 16
        return DrawnPieces(
            method=selection.method, bound=selection.bound, stats=selection.stats, vertices=pool.heights,
            corners=shapes.corners, runs=runs, triangles=int(counts.sum()), given=selection,
        )  # fmt: skip

    def _made(self, selection: PieceSet) -> Shapes:
        """Upload the shapes of a selection; the heights of other shapes are forgotten."""
        of, shapes = (selection.topologies, selection.clockwise), self._shapes
        self.sent = 0
        if shapes is None or shapes.of[0] is not of[0] or shapes.of[1] != of[1]:
            corners = packed(*of)
            counts = np.array([len(one.triangles) for one in of[0]], np.int64)
            points = np.array([len(one.points) for one in of[0]], np.int64)
            buffer = self.device.buffer(corners, "STORAGE|COPY_SRC", "triangles of pieces")
            shapes = self._shapes = Shapes(of, buffer, np.cumsum(counts) - counts, counts, points)
            self._pool, self.sent = None, corners.nbytes
        return shapes

    def _held(self, selection: PieceSet, shapes: Shapes) -> tuple[Pool, NDArray[np.int64]]:
        """Return the pool with these pieces' heights (missing ones are uploaded), and the index of each one's first."""
        names = [bytes((shape,)) + one.tobytes() for shape, one in zip(selection.shapes, selection.instances)]
        pool = self._pool
        lacking = np.array([pool is None or name not in pool.places for name in names], bool)
        sizes = shapes.points[selection.shapes]
        if pool is None or pool.used + int(sizes[lacking].sum()) > pool.room:
            lacking[:] = True
            room = min(max(2 * int(sizes.sum()), ROOM), max(self.most, int(sizes.sum())))
            buffer = self.device.buffer(4 * room, "STORAGE|COPY_SRC", "heights of pieces")
            pool = self._pool = Pool(buffer, room)
        if lacking.any():
            begin, parts = pool.used, []
            for shape in np.unique(selection.shapes[lacking]).tolist():
                here = np.flatnonzero(lacking & (selection.shapes == shape))
                found = selection.heights(selection.instances[here], shape)
                parts.append(np.where(np.isnan(found), np.float32(self.missing), found).ravel())
                for number in here.tolist():
                    pool.places[names[number]] = pool.used
                    pool.used += found.shape[1]
            heights = np.concatenate(parts).astype(np.float32)
            self.device.queue.write_buffer(pool.heights, 4 * begin, heights)
            self.sent += heights.nbytes
        return pool, np.array([pool.places[name] for name in names], np.int64)


class PiecePass(RunPass):
    """Draws pieces into depth and marks. Args: as for ``FacePass``."""

    def __init__(self, device: Device, camera: Any, field: tuple[Any, Any, Any], missing: int) -> None:
        super().__init__(device, "piece_draw", camera, field, missing, RUNS, HOLES=1)
