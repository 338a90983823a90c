"""The targets of a frame on the GPU: the G-buffer's textures and their formats."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from orograph.gpu.device import Device
from orograph.gpu.recording import Attachments

DEPTH, MARKS, LIGHT, GIVEN, FIELD = "depth32float", "r32uint", "rgba16float", "rg32float", "r32float"
EMPTY = 0.0, 0.0, 0.0, 0.0
NEARER = {"format": DEPTH, "depth_write_enabled": True, "depth_compare": "greater"}
"""The depth texture's clear value and format."""


class Targets:
    """The textures that a frame is drawn into, of one size in pixels: depth, marks, linear light, and on request the
    slopes of what was drawn (metres per metre east and north) and the terrain's own heights there."""

    def __init__(self, device: Device, width: int, height: int) -> None:
        self.width, self.height = width, height
        attach = "RENDER_ATTACHMENT|TEXTURE_BINDING|COPY_SRC"
        size = (width, height)
        self.depth = device.texture(size, DEPTH, attach, label="depth")
        self.marks = device.texture(size, MARKS, attach, label="marks")
        self.light = device.texture(size, LIGHT, f"{attach}|STORAGE_BINDING", label="light")
        self.depth_view, self.marks_view = self.depth.create_view(), self.marks.create_view()
        self.light_view = self.light.create_view()
        self._newest: Any = None
        self._given: Any = None
        self._field: Any = None
        self._attached: dict[str, Attachments] = {}

    def attached(self, name: str, make: Callable[[], Attachments]) -> Attachments:
        """A pass's targets, described on first use of this name."""
        found = self._attached.get(name)
        if found is None:
            found = self._attached[name] = make()
        return found

    def newest_view(self, device: Device) -> Any:
        """The view of a frame's own computed light, before it is blended with that of earlier frames."""
        if self._newest is None:
            usage = "STORAGE_BINDING|TEXTURE_BINDING"
            self._newest = device.texture((self.width, self.height), LIGHT, usage, label="newest light").create_view()
        return self._newest

    @property
    def has_field(self) -> bool:
        """Whether heights were requested; see ``has_given``."""
        return self._field is not None

    def field_view(self, device: Device) -> Any:
        """The view of the heights, which are made on first use."""
        if self._field is None:
            attach = "RENDER_ATTACHMENT|TEXTURE_BINDING"
            self._field = device.texture((self.width, self.height), FIELD, attach, label="heights").create_view()
        return self._field

    @property
    def has_given(self) -> bool:
        """Whether slopes were requested: a shader that reads them may serve until another one is compiled."""
        return self._given is not None

    def given_view(self, device: Device) -> Any:
        """The view of the slopes, which are made on first use."""
        if self._given is None:
            attach = "RENDER_ATTACHMENT|TEXTURE_BINDING"
            self._given = device.texture((self.width, self.height), GIVEN, attach, label="slopes").create_view()
        return self._given


def cleared(targets: Targets, device: Device, slopes: bool) -> Attachments:
    """Empty marks and depth, and slopes if requested: the targets of ground."""

    def make() -> Attachments:
        views = [targets.marks_view, *([targets.given_view(device)] if slopes else [])]
        return Attachments([(view, EMPTY) for view in views], (targets.depth_view, 0.0))

    return targets.attached("ground with slopes" if slopes else "ground", make)
