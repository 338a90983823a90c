"""Read back what the last frame left on the GPU: depths in metres, and which pixels show missing ground.

Depth is stored reversed (``camera.wgsl``): near / z in perspective, linear in a plan; 0 where nothing was drawn.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.gpu.device import Device
from orograph.rendering.gpu.targets import Targets

VOID_FILL = 2
"""The mark of a pixel that shows a patch over missing ground."""


def metres(stored: NDArray[np.float32], camera: NDArray[Any]) -> NDArray[np.float32]:
    """View-space depths of values of the depth buffer drawn with a camera (``CAMERA``); NaN where it is empty."""
    near, far = float(camera["near"]), float(camera["far"])
    with np.errstate(divide="ignore"):
        depth = far - stored * (far - near) if camera["plan"] else near / stored
    return np.where(stored > 0, depth, np.nan).astype(np.float32)


def depth_of(
    device: Device, targets: Targets, camera: NDArray[Any], window: tuple[int, int, int, int] | None = None
) -> NDArray[np.float32]:
    """Depths (height, width) of a window (left, top, width, height; None: all) of the targets, metres or NaN."""
    left, top, width, height = window or (0, 0, targets.width, targets.height)
    data = device.queue.read_texture(
        {"texture": targets.depth, "origin": (left, top, 0), "aspect": "depth-only"},
        {"offset": 0, "bytes_per_row": 4 * width, "rows_per_image": height},
        (width, height, 1),
    )
    return metres(np.frombuffer(data, np.float32).reshape(height, width), camera)


def void_filled_of(device: Device, targets: Targets) -> NDArray[np.bool_]:
    """Pixels (height, width) that show missing ground."""
    return np.asarray(device.read_texture(targets.marks, np.uint32, 1)[..., 0] & VOID_FILL > 0)
