"""A view in the numbers that the criteria need: camera coordinates, the vertical in them, the frustum's planes.

Camera coordinates of a point are x to the right, y up and the depth w, in (stretched) metres. It is drawn f·x/w and
f·y/w pixels from the middle of the picture, with f = h / (2 tan γ/2) for a picture of h pixels and a field of view γ.
The lecture calls this f *c*, and λ is f over the tolerance τ.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Self

from orograph.errors import UsageError
from orograph.lod.reference.terrain import Point
from orograph.viewpoint import View


def dot(p: Point, q: Point) -> float:
    """⟨p, q⟩."""
    return p[0] * q[0] + p[1] * q[1] + p[2] * q[2]


@dataclass(frozen=True)
class Camera:
    """A perspective view of stretched terrain.

    Attributes:
        eye: stretched metres.
        axes: unit vectors to the right, up and ahead.
        focal: f, pixels.
        near: least depth of what is in view, metres.
        slopes: largest |x/w| and |y/w| in the picture.
        planes: (a, b, c, d) in camera coordinates, a·x + b·y + c·w + d ≥ 0 in view, unit normals.
    """

    eye: Point
    axes: tuple[Point, Point, Point]
    focal: float
    near: float
    slopes: tuple[float, float]
    planes: tuple[tuple[float, float, float, float], ...]

    @classmethod
    def of(cls, view: View, exaggeration: float = 1.0) -> Self:
        """The camera of a view.

        Raises:
            UsageError: the view is a plan, in which heights displace nothing.
        """
        if view.projection != "perspective":
            raise UsageError("The references draw in perspective; in a plan heights displace nothing.")
        right, up, ahead = view.plain_axes(exaggeration)
        high = math.tan(math.radians(view.fov_y) / 2)
        wide = high * view.width / view.height
        planes: list[tuple[float, float, float, float]] = []
        for sign in (1, -1):
            planes.append((sign / math.hypot(1, wide), 0.0, wide / math.hypot(1, wide), 0.0))
            planes.append((0.0, sign / math.hypot(1, high), high / math.hypot(1, high), 0.0))
        planes.append((0.0, 0.0, 1.0, -view.near))
        if math.isfinite(view.far):
            planes.append((0.0, 0.0, -1.0, view.far))
        eye = view.eye[0], view.eye[1], view.eye[2] * exaggeration
        return cls(eye, (right, up, ahead), view.height / 2 / high, view.near, (wide, high), tuple(planes))

    def to_camera(self, point: Point) -> Point:
        """(x, y, w) of a point."""
        away = point[0] - self.eye[0], point[1] - self.eye[1], point[2] - self.eye[2]
        x, y, w = (dot(axis, away) for axis in self.axes)
        return x, y, w

    @property
    def vertical(self) -> Point:
        """ẑ in camera coordinates, the (a, b, c) of ROAM's pixel error per metre."""
        return self.axes[0][2], self.axes[1][2], self.axes[2][2]

    def depths(self, p: Point) -> list[float]:
        """How many metres camera point p is inside of each plane of the frustum; negative: outside."""
        return [dot((a, b, c), p) + d for a, b, c, d in self.planes]
