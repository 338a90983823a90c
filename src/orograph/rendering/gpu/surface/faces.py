"""Draws separate triangles, whose vertices each know all three (``shaders/faces.wgsl``), into depth and marks."""

from __future__ import annotations

from typing import Any

from orograph.gpu.device import Device
from orograph.gpu.program import Program
from orograph.gpu.recording import Attachments
from orograph.rendering.gpu.surface.left import Left
from orograph.rendering.gpu.targets import EMPTY, FIELD, GIVEN, MARKS, NEARER, Targets


class FacePass:
    """A pass with one shader; the slopes it leaves are those of the triangles.

    Args:
        shader: its name. buffers: of vertices. constants: the shader's, besides ``EDGES`` and ``MISSING``.
        camera: the uniform buffer (``camera.CAMERA``).
        field: a view of the atlas of heights, its pages and the table of levels (``shaders/field.wgsl``).
        missing: what is added to missing heights (``tiles.missing``), metres.
    """

    def __init__(
        self, device: Device, shader: str, camera: Any, field: tuple[Any, Any, Any], missing: int,
        buffers: list[dict[str, Any]] | None = None, **constants: int,
    ) -> None:  # fmt: skip
        self.device, self.shader, self.buffers = device, shader, buffers or []
        self.bound = {"camera": camera, **dict(zip(("heights", "height_pages", "levels"), field, strict=True))}
        self.constants = {"MISSING": missing, **constants}
        self._pipelines: dict[tuple[bool, bool, bool], Any] = {}

    def bind(self, **resources: Any) -> Any:
        """Create a bind group of the camera, the field, and these."""
        return self._program(False).bind({**self.bound, **resources})

    def begin(self, encoder: Any, targets: Targets, left: Left) -> Any:
        """Clear the targets; return the pass with its pipeline set."""
        given, field = bool(left.slopes) or left.field, left.field
        pass_ = targets.attached(f"faces {given} {field}", lambda: self._attachments(targets, given, field)).begin(
            encoder
        )
        pass_.set_pipeline(self._pipeline(left.edges, given, field))
        return pass_

    def _attachments(self, targets: Targets, given: bool, field: bool) -> Attachments:
        views = [targets.marks_view, *([targets.given_view(self.device)] if given else [])]
        views += [targets.field_view(self.device)] if field else []
        return Attachments([(view, EMPTY) for view in views], (targets.depth_view, 0.0))

    def _pipeline(self, edges: bool, given: bool, field: bool) -> Any:
        found = self._pipelines.get((edges, given, field))
        if found is None:
            entry = "with_field" if field else "with_slope" if given else "fragment"
            formats = [MARKS, *([GIVEN] if given else []), *([FIELD] if field else [])]
            found = self._pipelines[edges, given, field] = self._program(edges).draw(
                [{"format": format} for format in formats], fragment=entry, buffers=self.buffers, depth=NEARER
            )
        return found

    def _program(self, edges: bool) -> Program:
        return Program(self.device, self.shader, EDGES=int(edges), **self.constants)
