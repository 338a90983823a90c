"""Meshes that only the GPU has, drawn by *runs*: an instance for every ``RUN`` triangles of one mesh, all in one draw.

Meshes stay in a pool until it is full; then those that are drawn begin a new pool. Frames that still
draw the last pool keep it alive.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from orograph.gpu.device import Device
from orograph.gpu.recording import write
from orograph.lod.selection import Selection
from orograph.rendering.gpu.surface.faces import FacePass
from orograph.rendering.gpu.surface.left import Left
from orograph.rendering.gpu.targets import Targets
from orograph.tessellation import Tessellation

RUN = 64
"""Triangles per instance."""

ROOM = 1 << 14
"""Capacity of the smallest pool, in vertices."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Resident(Selection):
    """What is drawn, if only the GPU has its triangles.

    Attributes:
        triangles: their number. given: the selection as it was made.
    """

    triangles: int
    given: Selection

    def tessellation(self) -> Tessellation:
        """The drawn triangles, made by the CPU."""
        return self.given.tessellation()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ResidentMeshes(Resident):
    """Meshes on the GPU.

    Attributes:
        vertices, corners: buffers. runs: (n,), of the shader's ``Run``.
    """

    vertices: Any
    corners: Any
    runs: NDArray[np.void]

    @property
    def buffers(self) -> dict[str, Any]:
        """By the names that shaders have for them."""
        return {"vertices": self.vertices, "triangles": self.corners}


class Runs(Protocol):
    """What is drawn by runs: ``ResidentMeshes``, or others with triangles."""

    @property
    def buffers(self) -> dict[str, Any]: ...

    @property
    def runs(self) -> NDArray[np.void]: ...


def runs_of(dtype: np.dtype[Any], firsts: Any, counts: Any) -> tuple[NDArray[Any], NDArray[np.int64]]:
    """The runs of meshes, and which mesh each is of.

    Args:
        dtype: with ``first``, ``count``. firsts, counts: of the meshes' triangles.
    """
    parts = -(-counts // RUN)
    of = np.repeat(np.arange(len(counts)), parts)
    number = np.arange(len(of)) - np.repeat(np.cumsum(parts) - parts, parts)
    runs = np.zeros(len(of), dtype)
    runs["first"] = firsts[of] + RUN * number
    runs["count"] = np.minimum(RUN, counts[of] - RUN * number)
    return runs, of


class RunPass(FacePass):
    """Draws resident meshes into depth and marks: one draw. Args: as for ``FacePass``; ``runs``: buffer layout."""

    def __init__(
        self, device: Device, shader: str, camera: Any, field: tuple[Any, Any, Any], missing: int,
        runs: dict[str, Any], **constants: int,
    ) -> None:  # fmt: skip
        super().__init__(device, shader, camera, field, missing, [runs], **constants)
        self._held: tuple[list[Any], Any] = ([], None)
        self._runs: tuple[Any, Any, int] = (None, None, 0)

    def draw(self, encoder: Any, targets: Targets, selection: Runs, left: Left) -> None:
        """Clear the targets and draw."""
        buffers, runs = selection.buffers, selection.runs
        if [id(one) for one in buffers.values()] != [id(one) for one in self._held[0]]:
            self._held = list(buffers.values()), self.bind(**buffers)
        if self._runs[0] is not runs and len(runs):
            buffer, room = self._runs[1:]
            if len(runs) > room:
                room = 1 << (len(runs) - 1).bit_length()
                buffer = self.device.buffer(room * runs.itemsize, "VERTEX", "runs of triangles")
            write(self.device, buffer, runs)
            self._runs = runs, buffer, room
        pass_ = self.begin(encoder, targets, left)
        if len(runs):
            pass_.set_bind_group(0, self._held[1])
            pass_.set_vertex_buffer(0, self._runs[1])
            pass_.draw(3 * RUN, len(runs))
        pass_.end()
