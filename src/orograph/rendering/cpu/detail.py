"""A scene whose ground has detail beyond the data: the same scene with another terrain, which only pictures see."""

from __future__ import annotations

from typing import Any

from orograph.errors import UsageError
from orograph.memo import Memo
from orograph.progress import Progress
from orograph.scene.scene import Scene
from orograph.synthesis.detailed import Detailed, doublings_for, steering_of

FINEST = 0.05
"""Pixels of tolerance instead of 0, which would have all of the invented ground made."""


def detailed(scene: Scene, memo: Memo, progress: Progress) -> tuple[Scene, dict[str, Any]]:
    """The scene with detail, and what a picture's facts say of it.

    Raises:
        UsageError: it has contour lines, which are of the data alone; or the example is no good.
        ReadError: the example cannot be read.
    """
    detail, terrain, exaggeration = scene.surface.detail, scene.terrain, scene.surface.exaggeration
    assert detail is not None
    if scene.annotations.contours is not None:
        raise UsageError(
            "Contour lines are of the data, and `detail` is not.", remedy="Leave out the contours, or the detail."
        )
    steering, facts = None, {"words": detail.words, "seed": detail.seed, "spacing_m": max(terrain.grid.spacing)}
    if detail.exemplar is not None:
        # The example is held by its id (a path is itself): frames and tiles share what was prepared.
        key = detail.exemplar if isinstance(detail.exemplar, str) else id(detail.exemplar)
        steering, facts["exemplar"] = memo(
            "steering", (key, detail.seed), lambda: steering_of(terrain, detail.exemplar, detail.seed, progress),
            terrain,
        )  # fmt: skip
    doublings = doublings_for(terrain, scene.view.whole, exaggeration)
    facts |= {"doublings": doublings, "finest_m": facts["spacing_m"] / 2**doublings}
    if not doublings:
        return scene, facts
    made = memo(
        "detailed", (doublings, detail.seed, None if steering is None else id(steering)),
        lambda: Detailed(terrain, doublings, detail.seed, steering), terrain, 4,
    )  # fmt: skip
    tolerance = scene.surface.tolerance
    return scene.but(terrain=made, tolerance=None if tolerance is None else max(tolerance, FINEST)), facts
