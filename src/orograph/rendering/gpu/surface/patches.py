"""Patches into depth and marks: one instanced draw of a shared index buffer, heights pulled from the atlas.

With ``slopes`` they leave the slope of what is drawn, too: "stored" at the vertices and blended between, or that of the
flat triangles by the derivatives of their position on the screen (``frame.Overlay.normals``).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.gpu.device import Device
from orograph.gpu.layouts import stage, texture, uniform
from orograph.gpu.recording import Attachments, write
from orograph.lod.triangle_patches import Patches
from orograph.rendering.gpu.surface.left import Left, Slopes
from orograph.rendering.gpu.targets import DEPTH, EMPTY, GIVEN, MARKS, Targets


class PatchPass:
    """Draws instances of patches: one indexed draw of the shared index buffer.

    Args:
        camera: the uniform buffer (``camera.CAMERA``). heights: the atlas's texture.
        slopes: the view of the slopes' atlas, its pages and the table of levels (``shaders/slopes.wgsl``).
        vertices: (n, 2) uint lattice positions (i, j). indices: (m, 3) of them.
        missing: what is added to heights that are missing (``tiles.missing``), metres.
    """

    def __init__(
        self, device: Device, camera: Any, heights: Any, slopes: tuple[Any, Any, Any], vertices: NDArray[Any],
        indices: NDArray[Any], stride: int, missing: int,
    ) -> None:  # fmt: skip
        self.device = device
        handle = device.handle
        self.count = int(indices.size)
        self.vertices = device.buffer(np.ascontiguousarray(vertices, np.uint32), "VERTEX", "lattice")
        self.indices = device.buffer(np.ascontiguousarray(indices, np.uint32), "INDEX", "triangles")
        self.stride, self.capacity, self.missing = stride, 0, missing
        self.instances: Any = None
        layouts = [
            handle.create_bind_group_layout(entries=[uniform(device, 0, "VERTEX|FRAGMENT")]),
            handle.create_bind_group_layout(
                entries=[
                    *({**texture(k, "unfilterable-float", "2d-array"), "visibility": stage("VERTEX")} for k in (0, 1)),
                    {"binding": 2, "visibility": stage("VERTEX"), "buffer": {"type": "read-only-storage"}},
                    uniform(device, 3, "VERTEX"),
                ]
            ),
        ]
        self.pipeline_layout = handle.create_pipeline_layout(bind_group_layouts=layouts)
        self._pipelines: dict[tuple[bool, Slopes], Any] = {}
        self.groups = [
            handle.create_bind_group(layout=layouts[0], entries=[{"binding": 0, "resource": {"buffer": camera}}]),
            handle.create_bind_group(
                layout=layouts[1],
                entries=[
                    {"binding": 0, "resource": heights.create_view(dimension="2d-array")},
                    {"binding": 1, "resource": slopes[0]},
                    *({"binding": k, "resource": {"buffer": slopes[k - 1]}} for k in (2, 3)),
                ],
            ),
        ]

    def pipeline(self, edges: bool, slopes: Slopes) -> Any:
        """The pipeline, with or without the edges of triangles among the marks, and their slopes."""
        if (edges, slopes) not in self._pipelines:
            constants: dict[str, int | float] = {
                "EDGES": int(edges),
                "STORED": int(slopes == "stored"),
                "MISSING": self.missing,
            }
            module = self.device.shader("patches", constants)
            stride = self.stride
            self._pipelines[edges, slopes] = self.device.handle.create_render_pipeline(
                label="patches",
                layout=self.pipeline_layout,
                vertex={
                    "module": module,
                    "entry_point": "vertex",
                    "buffers": [
                        {
                            "array_stride": 8,
                            "step_mode": "vertex",
                            "attributes": [{"format": "uint32x2", "offset": 0, "shader_location": 0}],
                        },
                        {
                            "array_stride": stride,
                            "step_mode": "instance",
                            "attributes": [
                                {"format": "sint32x2", "offset": 0, "shader_location": 1},
                                {"format": "uint32", "offset": 8, "shader_location": 2},
                                {"format": "uint32", "offset": 12, "shader_location": 3},
                                {"format": "float32", "offset": 16, "shader_location": 4},
                                {"format": "sint32", "offset": 20, "shader_location": 5},
                            ],
                        },
                    ],
                },
                primitive={"topology": "triangle-list", "cull_mode": "none"},
                depth_stencil={"format": DEPTH, "depth_write_enabled": True, "depth_compare": "greater"},
                fragment={
                    "module": module, "entry_point": "with_slope" if slopes else "fragment",
                    "targets": [{"format": MARKS}, {"format": GIVEN}] if slopes else [{"format": MARKS}],
                },
            )  # fmt: skip
        return self._pipelines[edges, slopes]

    def draw(self, encoder: Any, targets: Targets, selection: Patches, left: Left) -> None:
        """Clear the targets and draw; what lines are of the terrain is what is drawn: no ``field`` is left."""
        instances, slopes = selection.instances, left.slopes
        n = len(instances)
        if n > self.capacity:
            self.capacity = max(256, 1 << (n - 1).bit_length())
            self.instances = self.device.buffer(self.capacity * self.stride, "VERTEX", "instances")
        if n:
            write(self.device, self.instances, np.ascontiguousarray(instances))
        pass_ = targets.attached(
            "patches with slopes" if slopes else "patches", lambda: self._attachments(targets, bool(slopes))
        ).begin(encoder)
        if n:
            pass_.set_pipeline(self.pipeline(left.edges, slopes))
            for k, group in enumerate(self.groups):
                pass_.set_bind_group(k, group)
            pass_.set_vertex_buffer(0, self.vertices)
            pass_.set_vertex_buffer(1, self.instances)
            pass_.set_index_buffer(self.indices, "uint32")
            pass_.draw_indexed(self.count, n)
        pass_.end()

    def _attachments(self, targets: Targets, slopes: bool) -> Attachments:
        """Empty marks and depth, and slopes if they are to be left."""
        views = [targets.marks_view, *([targets.given_view(self.device)] if slopes else [])]
        return Attachments([(view, EMPTY) for view in views], (targets.depth_view, 0.0))
