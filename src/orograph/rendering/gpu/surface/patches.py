"""Patches into depth and marks: one instanced draw of a shared index buffer, heights pulled from the atlas.

With ``slopes`` they also leave the slope of what is drawn: "stored" at the vertices and interpolated, "sampled" from
heights around the pixel, or that of the flat triangles by the derivatives of their position on the screen
(``frame.Overlay.normals``).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.gpu.device import Device
from orograph.gpu.program import Program
from orograph.gpu.recording import write
from orograph.lod.triangle_patches import Patches
from orograph.rendering.gpu.surface.left import Left, Slopes
from orograph.rendering.gpu.targets import GIVEN, MARKS, NEARER, Targets, cleared

LATTICE = {
    "array_stride": 8,
    "step_mode": "vertex",
    "attributes": [{"format": "uint32x2", "offset": 0, "shader_location": 0}],
}
INSTANCE = {
    "step_mode": "instance",
    "attributes": [
        {"format": "sint32x2", "offset": 0, "shader_location": 1},
        {"format": "uint32", "offset": 8, "shader_location": 2},
        {"format": "uint32", "offset": 12, "shader_location": 3},
        {"format": "float32", "offset": 16, "shader_location": 4},
        {"format": "sint32", "offset": 20, "shader_location": 5},
    ],
}
"""Buffers of vertices: places in the patches' lattice, and the patches (``Patches.instances``)."""


class PatchPass:
    """Draws instances of patches: one indexed draw of the shared index buffer.

    Args:
        camera: the uniform buffer (``camera.CAMERA``). heights: the atlas's texture.
        slopes: the view of the slopes' atlas, its pages and the table of levels (``shaders/slopes.wgsl``).
        vertices: (n, 2) uint lattice positions (i, j). indices: (m, 3) of them.
        missing: what is added to missing heights (``tiles.missing``), metres.
    """

    def __init__(
        self, device: Device, camera: Any, heights: Any, slopes: tuple[Any, Any, Any], vertices: NDArray[Any],
        indices: NDArray[Any], stride: int, missing: int,
    ) -> None:  # fmt: skip
        self.device = device
        self.count = int(indices.size)
        self.vertices = device.buffer(np.ascontiguousarray(vertices, np.uint32), "VERTEX", "lattice")
        self.indices = device.buffer(np.ascontiguousarray(indices, np.uint32), "INDEX", "triangles")
        self.stride, self.capacity, self.missing = stride, 0, missing
        self.instances: Any = None
        self._brought: NDArray[Any] | None = None
        self._pipelines: dict[tuple[bool, Slopes], Any] = {}
        program = self._program(False, "")
        atlases = {"heights": heights, "slopes": slopes[0], "pages": slopes[1], "levels": slopes[2]}
        self.groups = [program.bind({"camera": camera}), program.bind(atlases, 1)]

    def pipeline(self, edges: bool, slopes: Slopes) -> Any:
        """The pipeline, with or without marks of triangles' edges, and with these slopes."""
        if (edges, slopes) not in self._pipelines:
            self._pipelines[edges, slopes] = self._program(edges, slopes).draw(
                [{"format": format} for format in ((MARKS, GIVEN) if slopes else (MARKS,))],
                fragment="with_slope" if slopes else "fragment",
                buffers=[LATTICE, {**INSTANCE, "array_stride": self.stride}],
                depth=NEARER,
            )
        return self._pipelines[edges, slopes]

    def _program(self, edges: bool, slopes: Slopes) -> Program:
        stored, sampled = int(slopes == "stored"), int(slopes == "sampled")
        return Program(self.device, "patches", EDGES=int(edges), STORED=stored, SAMPLED=sampled, MISSING=self.missing)

    def draw(self, encoder: Any, targets: Targets, selection: Patches, left: Left) -> None:
        """Clear the targets and draw; lines follow the drawn ground, so no ``field`` is left."""
        self.bring(selection.instances)
        pass_ = cleared(targets, self.device, bool(left.slopes)).begin(encoder)
        self.record(pass_, len(selection.instances), left)
        pass_.end()

    def bring(self, instances: NDArray[Any]) -> None:
        """Bring instances to the GPU, unless the same array was brought last."""
        if instances is self._brought:
            return
        self._brought, n = instances, len(instances)
        if n > self.capacity:
            self.capacity = max(256, 1 << (n - 1).bit_length())
            self.instances = self.device.buffer(self.capacity * self.stride, "VERTEX", "instances")
        if n:
            write(self.device, self.instances, np.ascontiguousarray(instances))

    def record(self, pass_: Any, count: int, left: Left) -> None:
        """Draw ``count`` uploaded instances in a pass that has begun."""
        if count:
            pass_.set_pipeline(self.pipeline(left.edges, left.slopes))
            for k, group in enumerate(self.groups):
                pass_.set_bind_group(k, group)
            pass_.set_vertex_buffer(0, self.vertices)
            pass_.set_vertex_buffer(1, self.instances)
            pass_.set_index_buffer(self.indices, "uint32")
            pass_.draw_indexed(self.count, count)
