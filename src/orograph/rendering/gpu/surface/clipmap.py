"""The rings of a clipmap, drawn on the GPU from toroidal textures (Asirvatham & Hoppe 2005): one instanced draw.

Heights lie in a texture with a layer for every level, sample (i, j) at (i mod side, j mod side). A frame uploads the
heights of its windows that the last ones lacked (L-shaped regions), 64 bytes per ring, and 12 bytes for every block of
cells in view. Cells, triangles and transitions are made in the vertex shader, as ``lod.clipmap_mesh`` makes them. The
paper's blocks of (n + 1)/4 samples, twelve per ring, with fix-ups and trims between them, are one kind of block here:
``BLOCK`` × ``BLOCK`` cells on the level's own lattice, cut in the shader to the part within the window and outside the
hole.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.gpu.device import Device
from orograph.gpu.recording import write
from orograph.hierarchy.clip_stack import Rectangle
from orograph.lod.clipmap import BLOCK
from orograph.lod.clipmap_toroid import lacking
from orograph.lod.clipmap_windows import borders
from orograph.lod.selection import ClipRings, TriangleMesh
from orograph.rendering.gpu.surface.faces import FacePass
from orograph.rendering.gpu.surface.left import Left
from orograph.rendering.gpu.surface.resident import Resident
from orograph.rendering.gpu.targets import Targets
from orograph.store.terrain import Heights

RING = np.dtype(
    [("window", "<i4", 4), ("hole", "<i4", 4), ("blend", "<f4", 4), ("width", "<f4"), ("level", "<u4"),
     ("open", "<u4"), ("pad", "<u4")]
)  # fmt: skip
"""``Ring`` of ``shaders/clipmap_draw.wgsl``."""

MOST_RINGS = 32

NEVER = 1e9
"""Samples: a transition that begins there never begins."""

BLOCKS = {
    "array_stride": 12,
    "step_mode": "instance",
    "attributes": [{"format": "sint32x3", "offset": 0, "shader_location": 0}],
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HeldRings(Resident):
    """Rings to be drawn.

    Attributes:
        windows: for each level, the samples it holds and their heights, metres.
        rings: (r,) of ``RING``. blocks: (b, 3) int32, row and column of each block in view, and its ring.
    """

    windows: Mapping[Rectangle, Heights]
    rings: NDArray[np.void]
    blocks: NDArray[np.int32]


def ready_of(shape: tuple[int, int], most: int) -> Callable[[ClipRings, Any], HeldRings | TriangleMesh]:
    """Return a function that makes rings ready to be drawn, and may be called from any thread.

    If they contain missing ground, triangles are split (``lod.clipmap_holes``) and drawn as triangles; so are
    rings whose heights do not fit.

    Args:
        shape: the raster's. most: bytes available for heights.
    """

    def ready(selection: ClipRings, _: Any) -> HeldRings | TriangleMesh:
        stack = selection.stack
        fits = len(stack) <= MOST_RINGS and 4 * side_for(stack) ** 2 * (stack[0].level + 1) <= most
        if selection.read is None or not fits:
            mesh = selection.tessellation()
            return TriangleMesh(method=selection.method, bound=selection.bound, stats=mesh.stats, mesh=mesh)
        return HeldRings(
            method=selection.method, bound=selection.bound, lacking=selection.lacking, stats=selection.stats,
            triangles=int(selection.stats["triangles"]), given=selection,
            windows={window: selection.read(window) for window in stack},
            rings=ring_records(selection, shape), blocks=blocks_of(selection),
        )  # fmt: skip

    return ready


def side_for(stack: tuple[Rectangle, ...]) -> int:
    """The side, in samples, of the textures that hold such windows: a power of two."""
    return 1 << (max(max(window.shape) for window in stack) - 1).bit_length()


def ring_records(selection: ClipRings, shape: tuple[int, int]) -> NDArray[np.void]:
    """The rings (r,) of ``RING``."""
    made = np.zeros(len(selection.stack), RING)
    holes = [*selection.stack[1:], None]
    for record, w, hole, blend in zip(made, selection.stack, holes, selection.blends, strict=True):
        record["window"] = w.row0, w.row1 - 1, w.col0, w.col1 - 1
        inner = None if hole is None else hole.around(w.level)
        record["hole"] = (0, -1, 0, -1) if inner is None else (inner.row0, inner.row1 - 1, inner.col0, inner.col1 - 1)
        begins = blend.north - w.row0, blend.south - w.row0, blend.west - w.col0, blend.east - w.col0
        record["blend"], record["width"] = np.clip(begins, -NEVER, NEVER), blend.width
        record["level"] = w.level
        record["open"] = sum(1 << k for k, border in enumerate(borders(w, shape)) if not border)
    return made


def blocks_of(selection: ClipRings) -> NDArray[np.int32]:
    """The blocks (b, 3) in view that the next finer ring does not wholly hide: rows, columns, rings."""
    side, found = selection.block, [np.zeros((0, 3), np.int32)]
    holes = [*selection.stack[1:], None]
    for k, (w, hole, seen) in enumerate(zip(selection.stack, holes, selection.seen, strict=True)):
        row, col = (v + first // side for v, first in zip(np.nonzero(seen), (w.row0, w.col0)))
        if hole is not None:
            inner = hole.around(w.level)
            hidden = _within(row, side, (w.row0, w.row1), (inner.row0, inner.row1))
            hidden &= _within(col, side, (w.col0, w.col1), (inner.col0, inner.col1))
            row, col = row[~hidden], col[~hidden]
        found.append(np.stack([row, col, np.full_like(row, k)], 1).astype(np.int32))
    return np.concatenate(found)


def _within(block: NDArray[np.int64], side: int, window: tuple[int, int], hole: tuple[int, int]) -> NDArray[np.bool_]:
    """Whether the part of each block within the window lies in the hole, along one axis."""
    begins, ends = np.maximum(block * side, window[0]), np.minimum((block + 1) * side, window[1] - 1)
    return np.asarray((begins >= hole[0]) & (ends <= hole[1] - 1))


class ClipPass(FacePass):
    """Draws rings into depth and marks. Args: as for ``FacePass``.

    Attributes:
        sent: bytes that the last selection uploaded.
    """

    def __init__(self, device: Device, camera: Any, field: tuple[Any, Any, Any], missing: int) -> None:
        super().__init__(device, "clipmap_draw", camera, field, missing, [BLOCKS], BLOCK=BLOCK)
        self.sent = 0
        self._shown: HeldRings | None = None
        self._texture: Any = None
        self._holds: dict[int, Rectangle] = {}
        self._rings = device.buffer(MOST_RINGS * RING.itemsize, "UNIFORM", "rings")
        self._blocks, self._room = None, 0
        self._group: Any = None

    def draw(self, encoder: Any, targets: Targets, selection: HeldRings, left: Left) -> None:
        """Clear the targets and draw."""
        if self._shown is not selection:
            self._bring(selection)
        pass_ = self.begin(encoder, targets, left)
        if len(selection.blocks):
            pass_.set_bind_group(0, self._group)
            pass_.set_vertex_buffer(0, self._blocks)
            pass_.draw(6 * BLOCK**2, len(selection.blocks))
        pass_.end()

    def _bring(self, selection: HeldRings) -> None:
        """Upload what the GPU lacks of a selection."""
        rings, blocks = selection.rings, selection.blocks
        side, layers = side_for(tuple(selection.windows)), int(rings["level"].max()) + 1
        if self._texture is None or self._texture.size[0] != side or self._texture.size[2] < layers:
            self._texture = self.device.texture(
                (side, side, layers), "r32float", "TEXTURE_BINDING|COPY_DST", label="heights of rings"
            )
            self._holds.clear()
            view = self._texture.create_view(dimension="2d-array")
            self._group = self.bind(ring_heights=view, rings=self._rings)
        self.sent = rings.nbytes + blocks.nbytes
        for window, heights in selection.windows.items():
            for part in lacking(self._holds.get(window.level), window):
                self._fill(part, heights[part.row0 - window.row0 :, part.col0 - window.col0 :], side)
            self._holds[window.level] = window
        write(self.device, self._rings, np.ascontiguousarray(rings))
        if len(blocks) > self._room:
            self._room = 1 << (len(blocks) - 1).bit_length()
            self._blocks = self.device.buffer(12 * self._room, "VERTEX", "blocks of rings")
        if len(blocks):
            write(self.device, self._blocks, blocks)
        self._shown = selection

    def _fill(self, part: Rectangle, heights: Heights, side: int) -> None:
        """Write the heights of a part to their places in the texture."""
        for (i, rows), (j, cols) in product(_runs(part.row0, part.row1, side), _runs(part.col0, part.col1, side)):
            some = np.ascontiguousarray(heights[i : i + rows, j : j + cols], np.float32)
            self.device.queue.write_texture(
                {"texture": self._texture, "origin": ((part.col0 + j) % side, (part.row0 + i) % side, part.level)},
                some, {"bytes_per_row": 4 * cols, "rows_per_image": rows}, (cols, rows, 1),
            )  # fmt: skip
            self.sent += some.nbytes


def _runs(first: int, end: int, side: int) -> Iterator[tuple[int, int]]:
    """Split a span into runs that are contiguous in the texture: each one's start (from the first sample), length."""
    at = first
    while at < end:
        count = min(end - at, side - at % side)
        yield at - first, count
        at += count
