"""Batches of small meshes, such as ``bdam``'s patches, that stay on the GPU: a frame uploads only new ones.

A batch is identified by its array of vertices, which a method keeps as long as it may draw it again. Besides new
batches, a frame uploads 16 bytes for every ``RUN`` triangles: which they are, and how far their heights have grown from
the coarser ones. A vertex takes 20 bytes (row, column, the remainders of both in 65536ths, height, coarser height), a
triangle 12.
"""

from __future__ import annotations

import weakref
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.gpu.device import Device
from orograph.lod.selection import TinBatch, TinBatches
from orograph.rendering.gpu.surface.resident import ROOM, ResidentMeshes, RunPass, runs_of

SAMPLE = np.dtype([("row", "<i4"), ("col", "<i4"), ("between", "<u4"), ("height", "<f4"), ("coarse", "<f4")])
"""A vertex: ``Sample`` of ``shaders/batch_draw.wgsl``."""

INSTANCE = np.dtype([("first", "<u4"), ("count", "<u4"), ("vertex", "<u4"), ("share", "<f4")])
"""A run of triangles: ``Run`` of ``shaders/batch_draw.wgsl``."""

RUNS = {
    "array_stride": INSTANCE.itemsize,
    "step_mode": "instance",
    "attributes": [
        {"format": "uint32x3", "offset": 0, "shader_location": 0},
        {"format": "float32", "offset": 12, "shader_location": 1},
    ],
}

TRIANGLE = 12
"""Bytes."""

COARSER = 1.25
"""Factor by which a tolerance grows until its batches fit."""


@dataclass(slots=True, eq=False)
class Pool:
    """Batches in the GPU's memory.

    Attributes:
        vertices, corners: the buffers. room, used: their capacities in vertices and triangles, and the used part.
        places: by the id of a batch's array of vertices, a reference to it, and its first vertex and triangle.
    """

    vertices: Any
    corners: Any
    room: tuple[int, int]
    used: tuple[int, int] = (0, 0)
    places: dict[int, tuple[weakref.ref[NDArray[np.float64]], int, int]] = field(default_factory=dict)

    def has(self, batch: TinBatch) -> bool:
        """Whether a batch is there."""
        found = self.places.get(id(batch.vertices))
        return found is not None and found[0]() is batch.vertices


def packed(batches: Sequence[TinBatch]) -> NDArray[np.void]:
    """The vertices (n,) of batches, as ``SAMPLE``."""
    vertices = np.concatenate([one.vertices for one in batches])
    points = np.zeros(len(vertices), SAMPLE)
    places = np.rint(vertices[:, :2] * 65536).astype(np.int64)
    (points["col"], points["row"]), points["height"] = (places >> 16).T, vertices[:, 2]
    points["between"] = places[:, 0] & 0xFFFF | (places[:, 1] & 0xFFFF) << 16
    points["coarse"] = np.concatenate([one.vertices[:, 2] if one.coarse is None else one.coarse for one in batches])
    return points


class Batches:
    """Uploads batches to the GPU.

    Args:
        most: bytes available for them; up to twice as many while frames still draw the last ones.

    Attributes:
        sent: bytes that the last selection uploaded, besides its runs.
    """

    def __init__(self, device: Device, most: int) -> None:
        self.device = device
        share = min(most, 2 * device.largest)
        self.most = int(share * 0.5) // SAMPLE.itemsize, int(share * 0.5) // TRIANGLE
        self.sent = 0
        self._pool: Pool | None = None

    def ready(self, selection: TinBatches, again: Callable[[float], TinBatches]) -> ResidentMeshes:
        """Return a selection on the GPU; coarser if memory does not hold it.

        Args:
            again: selects with another tolerance, pixels.

        Raises:
            DeviceLimitError: the device's memory is full.
        """
        tolerance = float(selection.stats.get("tolerance") or 0.25)
        while len(selection.batches) > 4 and _over((0, 0), _size(selection.batches), self.most):
            tolerance *= COARSER
            selection = again(tolerance)
        pool = self._made(selection.batches)
        at = np.array([pool.places[id(one.vertices)][1:] for one in selection.batches], np.int64).reshape(-1, 2)
        counts = np.array([len(one.triangles) for one in selection.batches], np.int64)
        runs, of = runs_of(INSTANCE, at[:, 1], counts)
        runs["vertex"] = at[of, 0]
        runs["share"] = np.array([one.share for one in selection.batches], np.float32)[of]
        return ResidentMeshes(
            method=selection.method, bound=selection.bound, stats=selection.stats, vertices=pool.vertices,
            corners=pool.corners, runs=runs, triangles=int(counts.sum()), given=selection,
        )  # fmt: skip

    def _made(self, batches: Sequence[TinBatch]) -> Pool:
        """Return the pool with these batches; missing ones are uploaded."""
        pool = self._pool
        lacking = [one for one in batches if pool is None or not pool.has(one)]
        if pool is None or _over(pool.used, _size(lacking), pool.room):
            lacking = list(batches)
            room = [min(max(2 * size, ROOM), most) for size, most in zip(_size(batches), self.most, strict=True)]
            pool = self._pool = Pool(
                self.device.buffer(room[0] * SAMPLE.itemsize, "STORAGE|COPY_SRC", "vertices of batches"),
                self.device.buffer(room[1] * TRIANGLE, "STORAGE|COPY_SRC", "triangles of batches"), (room[0], room[1]),
            )  # fmt: skip
        self.sent = 0
        if lacking:
            points = packed(lacking)
            corners = np.concatenate([one.triangles for one in lacking]).astype(np.uint32)
            self.device.queue.write_buffer(pool.vertices, pool.used[0] * SAMPLE.itemsize, points)
            self.device.queue.write_buffer(pool.corners, pool.used[1] * TRIANGLE, corners)
            self.sent = points.nbytes + corners.nbytes
            vertex, triangle = pool.used
            for one in lacking:
                pool.places[id(one.vertices)] = weakref.ref(one.vertices), vertex, triangle
                vertex, triangle = vertex + len(one.vertices), triangle + len(one.triangles)
            pool.used = vertex, triangle
        return pool


def _size(batches: Sequence[TinBatch]) -> tuple[int, int]:
    """Vertices and triangles of batches."""
    return sum(len(one.vertices) for one in batches), sum(len(one.triangles) for one in batches)


def _over(used: tuple[int, int], more: tuple[int, int], room: tuple[int, int]) -> bool:
    return used[0] + more[0] > room[0] or used[1] + more[1] > room[1]


class BatchPass(RunPass):
    """Draws batches into depth and marks. Args: as for ``FacePass``."""

    def __init__(self, device: Device, camera: Any, field: tuple[Any, Any, Any], missing: int) -> None:
        super().__init__(device, "batch_draw", camera, field, missing, RUNS)
