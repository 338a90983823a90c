"""The options of ROAM: metric, strips, and what makes a triangle worth more or less (``terms``).

Places on the ground are in sample coordinates, (column, row); heights in metres.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from orograph.errors import UsageError
from orograph.lod.options import option
from orograph.lod.right_triangles import BOUNDS, EVERY, METRIC, MeshOptions
from orograph.viewpoint import Point


def _places(text: str) -> tuple[Point, ...]:
    """Places ``COL:ROW:NUMBER`` with + between them."""
    found = tuple(tuple(float(part) for part in place.split(":")) for place in text.split("+"))
    if not all(len(place) == 3 and all(map(math.isfinite, place)) for place in found):
        raise ValueError(f"Places are COL:ROW:NUMBER, with + between them, not {text!r}.")
    return found  # type: ignore[return-value]


def _lines(text: str) -> tuple[tuple[Point, Point], ...]:
    """Lines ``COL:ROW:METRES/COL:ROW:METRES`` with + between them."""
    found = tuple(tuple(_places(end)[0] for end in line.split("/")) for line in text.split("+"))
    if not all(len(line) == 2 for line in found):
        raise ValueError(f"Lines of sight are COL:ROW:METRES/COL:ROW:METRES, with + between them, not {text!r}.")
    return found  # type: ignore[return-value]


@dataclass(frozen=True, slots=True, kw_only=True)
class RoamOptions(MeshOptions):
    """Options of ``roam``. See ``MeshOptions``; besides:

    Raises:
        UsageError: objects or lines of sight with an error that is no bound.
    """

    metric: str | None = option(None, METRIC, choices=EVERY)
    deferral: bool = option(
        True, "Compute priorities again only where they can have crossed the threshold (sec. 5.3); the mesh is the "
        "same without.",
    )  # fmt: skip
    strips: str | None = option(
        "kept", "Triangle strips: kept from frame to frame (sec. 5.2), rebuilt in each, or none: a list of triangles.",
        choices=("kept", "rebuilt"),
    )  # fmt: skip
    back_facing: float = option(1.0, "Factor on priorities of ground that faces away from the eye.", least=0, most=1)
    silhouette: float = option(1.0, "Factor on priorities where a silhouette can run.", least=1)
    occluded: float = option(1.0, "Factor on priorities of ground hidden behind other ground.", least=0, most=1)
    outside: float | None = option(
        None, "Factor on priorities of ground out of view; what is in view counts for no less. None: 0, without "
        "culling 1.", least=0, most=1,
    )  # fmt: skip
    objects: tuple[Point, ...] = option(
        (), "What stands on the ground, which is there exact to object-tolerance: COL:ROW:RADIUS in cells, with + "
        "between them.", read=_places,
    )  # fmt: skip
    object_tolerance: float = option(0.0, "Exactness of the ground under objects.", unit="metres", least=0)
    line_of_sight: tuple[tuple[Point, Point], ...] = option(
        (), "Lines that are free on the mesh if and only if they are on the full-resolution surface; what of them is "
        "out of view is in the mesh with cull=no. COL:ROW:METRES/COL:ROW:METRES, with + between them.", read=_lines,
    )  # fmt: skip

    def __post_init__(self) -> None:
        super(RoamOptions, self).__post_init__()  # (super() alone fails in a dataclass with slots)
        if (len(self.objects) or len(self.line_of_sight)) and self.error not in BOUNDS:
            raise UsageError(f"Lines of sight and objects need an error that is a bound, not {self.error!r}.")

    @property
    def conservative(self) -> bool:
        """As ``MeshOptions.conservative``; what is turned away or hidden is not held to the tolerance if it counts
        less."""
        return super(RoamOptions, self).conservative and min(self.back_facing, self.occluded) == 1.0
