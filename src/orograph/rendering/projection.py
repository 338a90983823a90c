"""Pixels of a picture and places on the ground: a ``View`` in sample coordinates, in float64.

The ray through pixel position (x, y) begins at o + x·ou + y·ov and goes along d + x·du + y·dv; its parameter is the
depth. In perspective ou = ov = 0, and a place P lies at (x, y) and depth t where P − o = t·(d + x·du + y·dv), so that
(t·x, t·y, t) is a linear map of P − o. In a plan du = dv = 0, and (x, y, t) is one. All that a grid or exaggeration
does (rectangular, rotated and mirrored cells, stretched heights) is in that map.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orograph.viewpoint import Camera

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Projection:
    """The rays of a whole picture in sample coordinates (column, row, true height in metres).

    Attributes:
        o, ou, ov, d, du, dv: (3,) float64, see the module.
        perspective: whether rays share their origin, or else their direction.
        width, height: of the picture, in pixels.
        near, far: depths between which things are seen.
    """

    o: Array
    ou: Array
    ov: Array
    d: Array
    du: Array
    dv: Array
    perspective: bool
    width: int
    height: int
    near: float
    far: float

    @classmethod
    def of(cls, camera: Camera) -> Projection:
        """The projection of the whole picture that the camera's view is, or is a tile of."""
        whole, chart = camera.view.whole, camera.affine
        origin, *others = whole.ray_basis(camera.exaggeration)
        o = chart.from_world(origin)
        ou, ov, d, du, dv = (chart.vectors_from_world(v) for v in others)
        return cls(
            o, ou, ov, d, du, dv, whole.projection == "perspective", whole.width, whole.height, whole.near, whole.far
        )

    def rays(self, px: Array, py: Array) -> tuple[Array, Array]:
        """Origins and directions (n, 3) of the rays through pixel positions (n,)."""
        x, y = px[:, None], py[:, None]
        return self.o + x * self.ou + y * self.ov, self.d + x * self.du + y * self.dv

    def place(self, px: Array, py: Array, depth: Array) -> Array:
        """Sample coordinates (n, 3) of what is seen at pixel positions (n,) and depths (n,); NaN where depth is."""
        origins, directions = self.rays(px, py)
        return origins + depth[:, None] * directions

    def matrix(self) -> Array:
        """(3, 3), from places relative to ``o`` to (t·x, t·y, t), or in a plan to (x, y, t)."""
        across, down = (self.du, self.dv) if self.perspective else (self.ou, self.ov)
        # The middle of the picture as the third axis: however narrow the picture's angle, nothing cancels.
        w, h = float(self.width), float(self.height)
        if not self.perspective:
            return np.linalg.inv(np.stack([across, down, self.d], -1))
        middle = self.d + w / 2 * across + h / 2 * down
        inverse = np.linalg.inv(np.stack([across, down, middle], -1))
        return np.array([[1.0, 0.0, w / 2], [0.0, 1.0, h / 2], [0.0, 0.0, 1.0]]) @ inverse

    @property
    def clip(self) -> float:
        """Depth in front of which triangles are cut off: in perspective a little before ``near``, which pixels are held
        to one by one, and never 0, where nothing has a place in the picture; in a plan nowhere."""
        if not self.perspective:
            return -math.inf
        return self.near * (1 - 2.0**-20) if self.near > 0 else 1e-6
