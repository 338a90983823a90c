"""The canvas's GPU side: the terrain's own picture, kept between frames, and its copy to the screen.

The terrain is drawn into its own texture, only when something changed; panels are drawn over it every frame. While the
camera moves on a slow device, the texture is smaller than the screen (a draft) and is stretched.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.gpu.device import Device
from orograph.gpu.program import Program

DRAFTS = (1.0, 0.7, 0.5, 0.35, 0.25)
"""Scales of the picture while the camera moves."""
TOO_SLOW, FAST_ENOUGH = 0.080, 0.030
"""Seconds between frames above which a draft becomes coarser, and below which finer."""


class Screen:
    """The texture of the terrain's picture and the pipeline that copies it.

    Args:
        device: draws it; ``format``: of the canvas's textures, and of the picture's.
    """

    def __init__(self, device: Device, format: str) -> None:
        self.device, self.format = device, format
        self.texture: Any = None
        self.view: Any = None
        self._program = Program(device, "blit")
        self._pipeline = self._program.draw([{"format": format}], vertex="corner", fragment="shade")
        self._sampler = device.handle.create_sampler(mag_filter="linear", min_filter="linear")
        self._binding: Any = None
        self._before: tuple[Any, Any, Any] | None = None

    def prepare(self, width: int, height: int) -> bool:
        """Provide a texture of this size; returns whether it is new (and black: ``revert`` brings the last one
        back)."""
        if self.texture is not None and tuple(self.texture.size[:2]) == (width, height):
            self._before = None
            return False
        self._before = None if self.texture is None else (self.texture, self.view, self._binding)
        self.texture = self.device.texture(
            (width, height), self.format, "RENDER_ATTACHMENT|TEXTURE_BINDING|COPY_SRC|COPY_DST", label="terrain"
        )
        self.view = self.texture.create_view()
        self._binding = self._program.bind({"picture": self.view, "filtering": self._sampler})
        return True

    def revert(self) -> None:
        """Show again what was shown before ``prepare`` made a texture that could not be drawn into."""
        if self._before is not None:
            self.texture, self.view, self._binding = self._before
            self._before = None

    def present(self, encoder: Any, target: Any, area: tuple[float, float, float, float], size: tuple[int, int]) -> Any:
        """Begin a pass on ``target`` (of ``size`` pixels) that draws the picture into ``area``; the pass goes on."""
        done = encoder.begin_render_pass(
            color_attachments=[
                {"view": target, "clear_value": (0.012, 0.014, 0.017, 1), "load_op": "clear", "store_op": "store"}
            ]
        )
        x, y, w, h = area
        w, h = min(w, size[0] - x), min(h, size[1] - y)
        if self._binding is not None and w >= 1 and h >= 1:
            done.set_viewport(x, y, w, h, 0, 1)
            done.set_pipeline(self._pipeline)
            done.set_bind_group(0, self._binding)
            done.draw(3)
        return done

    def pixels(self) -> NDArray[np.uint8]:
        """The last picture drawn: (height, width, 3), sRGB."""
        return self.read(self.texture)

    def write(self, pixels: NDArray[np.uint8]) -> None:
        """Replace the last picture by (height, width, 3), sRGB."""
        height, width = pixels.shape[:2]
        data = np.full((height, width, 4), 255, np.uint8)
        data[..., :3] = pixels[..., ::-1] if self.format.startswith("bgra") else pixels
        self.device.queue.write_texture(
            {"texture": self.texture}, data, {"bytes_per_row": 4 * width, "rows_per_image": height}, (width, height, 1)
        )

    def read(self, texture: Any) -> NDArray[np.uint8]:
        """The content of a texture of the canvas's format: (height, width, 3), sRGB."""
        found = self.device.read_texture(texture, np.uint8, 4)[..., :3]
        return np.ascontiguousarray(found[..., ::-1] if self.format.startswith("bgra") else found)


class Draft:
    """The size of the picture while the camera moves: as large as the device can keep up with.

    Args:
        slow: whether the device is known to be slow (software): then begin small.
    """

    def __init__(self, slow: bool = False) -> None:
        self.step = DRAFTS.index(0.5) if slow else 0
        self._mean = 0.0
        self._frames = 0

    @property
    def scale(self) -> float:
        """The scale of the screen's width and height."""
        return DRAFTS[self.step]

    def tell(self, seconds: float) -> None:
        """Record the time between two frames in motion."""
        if seconds > 3 * TOO_SLOW:  # an average over slow frames would come too late
            self.step, self._frames = min(self.step + 2, len(DRAFTS) - 1), 0
            return
        self._mean = seconds if self._frames == 0 else 0.7 * self._mean + 0.3 * seconds
        self._frames += 1
        if self._frames < 4:
            return
        if self._mean > TOO_SLOW and self.step < len(DRAFTS) - 1:
            self.step, self._frames = self.step + 1, 0
        elif self._mean < FAST_ENOUGH and self.step > 0:
            self.step, self._frames = self.step - 1, 0
