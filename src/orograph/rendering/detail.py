"""A scene with detail beyond the data: the same scene with another terrain, which only pictures use.

Both backends cast rays at it, or draw clipmaps (as Losasso and Hoppe did): invented detail has no known error that
could decide about triangles.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from orograph.errors import UsageError
from orograph.lod.registry import AUTO
from orograph.memo import Memo
from orograph.progress import Progress
from orograph.scene.scene import Scene
from orograph.synthesis.detailed import TILES, Detailed, doublings_for, room_for, steering_of

if TYPE_CHECKING:
    from orograph.gpu.device import Device

GPU_TILES = 1 << 18
"""Maximum tiles of the finest level for which the GPU's tables are made."""

FINEST = 0.05
"""Tolerance in pixels instead of 0, which would compute all of the invented ground."""


def detailed(
    scene: Scene, memo: Memo, progress: Progress, device: Device | None = None, *, fixed: bool = False
) -> tuple[Scene, dict[str, Any]]:
    """The scene with detail, and its entry in a picture's facts.

    Args:
        device: draws it; None: the CPU. It also makes the detail, unless it is a software device, which is slower than
            the CPU's own kernels; the detail is the same.
        fixed: use as many doublings as there is room for, wherever the eye is.

    Raises:
        UsageError: it has contour lines, which belong to the data alone; or the example is unsuitable.
        ReadError: the example cannot be read.
    """
    detail, terrain, exaggeration = scene.surface.detail, scene.terrain, scene.surface.exaggeration
    assert detail is not None
    if scene.annotations.contours is not None:
        raise UsageError(
            "Contour lines show the data, but `detail` is not part of the data.",
            remedy="Leave out the contours or the detail.",
        )
    maker = None if device is None or device.adapter.software else device
    steering, facts = None, {"words": detail.words, "seed": detail.seed, "spacing_m": max(terrain.grid.spacing)}
    if detail.exemplar is not None:
        # The example is identified by its id (a path by itself): frames and tiles share its preparation.
        key = detail.exemplar if isinstance(detail.exemplar, str) else id(detail.exemplar)
        steering, facts["exemplar"] = memo(
            "steering", (key, detail.seed),
            lambda: steering_of(terrain, detail.exemplar, detail.seed, progress, maker), terrain,
        )  # fmt: skip
    most = TILES if device is None else GPU_TILES
    doublings = room_for(terrain, most) if fixed else doublings_for(terrain, scene.view.whole, exaggeration, most)
    facts |= {"doublings": doublings, "finest_m": facts["spacing_m"] / 2**doublings}
    if not doublings:
        return scene, facts
    made = memo(
        "detailed", (doublings, detail.seed, None if steering is None else id(steering)),
        lambda: Detailed(terrain, doublings, detail.seed, steering, maker), terrain, 4 if device is None else 1,
    )  # fmt: skip
    tolerance = scene.surface.tolerance
    method = scene.surface.method
    if device is not None and method == "auto":
        method = AUTO["cpu"]  # by rays
    finest = None if tolerance is None else max(tolerance, FINEST)
    return scene.but(terrain=made, tolerance=finest, method=method), facts
