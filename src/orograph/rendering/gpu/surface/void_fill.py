"""Patches over missing ground, drawn with hatching: meshes of the membranes of ``geovis.missing``.

Of nested windows only the finest over a place is drawn. Vertices are whole samples of the raster, like those of the
terrain's patches. A coarse mesh enlarges a hole by the triangles around it. So the membrane extends some samples
under the ground (``MARGIN``), farther away by a thousandth of its distance, and no gap shows.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.geovis.missing import patches
from orograph.gpu.device import Device
from orograph.gpu.program import Program
from orograph.hierarchy.clip_stack import Rectangle
from orograph.raycast.select import load, rectangles
from orograph.raycast.stack import HeightWindow
from orograph.rendering.gpu.targets import MARKS, NEARER, Targets
from orograph.store.terrain import Terrain
from orograph.viewpoint import View

VERTEX = np.dtype([("row", "<i4"), ("col", "<i4"), ("height", "<f4"), ("pad", "<u4")])
"""A vertex: a sample of the raster and a height, metres."""

MARGIN = 6
"""Samples by which a membrane reaches under the ground around its hole."""

EXACT = 4_000_000
"""Samples up to which holes are searched for at full resolution."""


Fills = tuple[NDArray[Any], NDArray[np.uint32]]
"""Vertices (n,) of ``VERTEX``, and triangles (m, 3) of them."""


def void_fills(terrain: Terrain, view: View, exaggeration: float, tolerance: float) -> Fills:
    """The membranes over the holes in view; empty if there are none."""
    rows, cols = terrain.grid.shape
    if terrain.valid_fraction < 1 and rows * cols > EXACT:
        return _fills(terrain, rectangles(terrain, view, exaggeration, tolerance), MARGIN)
    return _fills(terrain, [Rectangle.whole(0, terrain.grid.shape)], MARGIN)


def coarse_void_fills(terrain: Terrain) -> Fills:
    """The membranes over the holes that the coarsest level shows, until finer ones are known."""
    top = terrain.levels - 1
    return _fills(terrain, [Rectangle.whole(top, terrain.shape(top))], 1)


def _fills(terrain: Terrain, chosen: Sequence[Rectangle], margin: int) -> Fills:
    none = np.zeros(0, VERTEX), np.zeros((0, 3), np.uint32)
    if terrain.valid_fraction >= 1:
        return none
    windows = load(terrain, chosen)
    found = patches(tuple(windows), terrain.grid.shape)
    if not found:
        return none
    found = [_reaching(patch, window, margin) for patch, window in zip(found, windows, strict=True)]
    vertices: list[NDArray[Any]] = []
    triangles: list[NDArray[np.uint32]] = []
    count = 0
    for window, finer in zip(found, [*found[1:], None]):
        points, indices = _mesh(window, finer, terrain)
        vertices.append(points)
        triangles.append(indices + np.uint32(count))
        count += len(points)
    return np.concatenate(vertices), np.concatenate(triangles)


def _reaching(patch: HeightWindow, window: HeightWindow, margin: int) -> HeightWindow:
    """Extend a patch by the samples of the ground around it, ``margin`` steps wide."""
    there = np.isfinite(patch.heights)
    if not there.any():
        return patch
    around = _grown(there, margin) & ~there
    return HeightWindow(patch.level, patch.col0, patch.row0, np.where(around, window.heights, patch.heights))


def _grown(there: NDArray[np.bool_], times: int) -> NDArray[np.bool_]:
    """Dilate ``there`` by so many steps along rows and columns."""
    for _ in range(times):
        grown = there.copy()
        grown[1:] |= there[:-1]
        grown[:-1] |= there[1:]
        grown[:, 1:] |= there[:, :-1]
        grown[:, :-1] |= there[:, 1:]
        there = grown
    return there


def _mesh(
    window: HeightWindow, finer: HeightWindow | None, terrain: Terrain
) -> tuple[NDArray[Any], NDArray[np.uint32]]:
    """The triangles of one window's cells whose corners all have a height, except those under ``finer``."""
    there = np.isfinite(window.heights)
    a, b, c, d = there[:-1, :-1], there[:-1, 1:], there[1:, :-1], there[1:, 1:]
    cells = (a.astype(np.uint8) + b + c + d) >= 3
    if finer is not None:
        hole = finer.where.inside(window.level)
        r0, r1, c0, c1 = (max(n, 0) for n in (
            hole.row0 - window.row0, hole.row1 - 1 - window.row0, hole.col0 - window.col0, hole.col1 - 1 - window.col0
        ))  # fmt: skip
        cells[r0:r1, c0:c1] = False
    r, c = np.nonzero(cells)
    corners = np.stack([np.stack([r + i, c + j], -1) for i in (0, 1) for j in (0, 1)], 1)  # (n, 4, 2)
    even = ((r + window.row0 + c + window.col0) % 2 == 0)[:, None, None]
    halves = np.where(even, np.array([[0, 2, 3], [0, 3, 1]]), np.array([[0, 2, 1], [1, 2, 3]]))
    picked = np.take_along_axis(corners[:, None], halves[..., None], 2)  # (n, 2, 3, 2)
    whole = there[picked[..., 0], picked[..., 1]].all(-1)
    picked = picked[whole]
    flat = picked.reshape(-1, 2)
    keys, inverse = np.unique(flat[:, 0] * window.heights.shape[1] + flat[:, 1], return_inverse=True)
    row, col = np.divmod(keys, window.heights.shape[1])
    points = np.zeros(len(keys), VERTEX)
    points["row"] = np.minimum((row + window.row0) << window.level, terrain.grid.rows - 1)
    points["col"] = np.minimum((col + window.col0) << window.level, terrain.grid.cols - 1)
    points["height"] = window.heights[row, col]
    return points, inverse.reshape(-1, 3).astype(np.uint32)


class VoidFillPass:
    """Draws the membranes into depth and marks, after the ground."""

    def __init__(self, device: Device, camera: Any) -> None:
        self.device = device
        program = Program(device, "void_fill")
        vertex = {
            "array_stride": VERTEX.itemsize,
            "step_mode": "vertex",
            "attributes": [
                {"format": "sint32x2", "offset": 0, "shader_location": 0},
                {"format": "float32", "offset": 8, "shader_location": 1},
            ],
        }
        self.pipeline = program.draw([{"format": MARKS}], buffers=[vertex], depth=NEARER)
        self.group = program.bind({"camera": camera})
        self.count = 0
        self._buffers: tuple[Any, Any] | None = None

    def load(self, vertices: NDArray[Any], triangles: NDArray[np.uint32]) -> None:
        """Replace the membranes."""
        self.count = int(triangles.size)
        if self.count:
            self._buffers = (
                self.device.buffer(vertices, "VERTEX", "void fill"),
                self.device.buffer(triangles, "INDEX", "void fill"),
            )

    def draw(self, encoder: Any, targets: Targets) -> None:
        if not self.count or self._buffers is None:
            return
        pass_ = encoder.begin_render_pass(
            color_attachments=[{"view": targets.marks_view, "load_op": "load", "store_op": "store"}],
            depth_stencil_attachment={
                "view": targets.depth_view, "depth_load_op": "load", "depth_store_op": "store",
            },
        )  # fmt: skip
        pass_.set_pipeline(self.pipeline)
        pass_.set_bind_group(0, self.group)
        pass_.set_vertex_buffer(0, self._buffers[0])
        pass_.set_index_buffer(self._buffers[1], "uint32")
        pass_.draw_indexed(self.count)
        pass_.end()
