"""The caster: rays in, first hits on the terrain's surface out; no colour, no light.

Positions are *sample coordinates*: x = column, y = row (fractional), z = height in metres. A ray is o + t·d; whoever
makes the rays decides what t measures (with directions of unit forward component it is the view-space depth).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from orograph.parallel import map_ordered, threads_for
from orograph.raycast.stack import HeightWindow, Stack
from orograph.raycast.tables import Picture, Pinhole

Array = NDArray[np.float64]


class Caster:
    """Casts rays at a stack of nested windows (one window at full resolution is the exact surface).

    Args:
        windows: outermost first (see ``Stack``).
        shape: (rows, cols) of the terrain at full resolution.
        jobs: threads; results do not depend on it.
    """

    def __init__(self, windows: list[HeightWindow], shape: tuple[int, int], jobs: int | None = None) -> None:
        self.jobs = threads_for(jobs)
        self.stack = Stack.build(windows, shape, self.jobs)

    @classmethod
    def of(cls, heights: NDArray[np.float32], jobs: int | None = None) -> Caster:
        """The exact surface of heights (rows, cols) float32, NaN where missing."""
        return cls([HeightWindow(0, 0, 0, heights)], heights.shape, jobs)

    def _blocks(self, work: Callable[[int, int], None], n: int, block: int) -> None:
        spans = [(a, min(a + block, n)) for a in range(0, n, block)]
        if len(spans) == 1:
            work(*spans[0])
            return
        for _ in map_ordered(lambda span: work(*span), spans, self.jobs):
            pass

    def surface(self, x: float, y: float) -> float:
        """Height of the surface at one point, metres; NaN outside it or in a hole."""
        ray = np.array([[x, y, self.stack.scene.high + 1.0]]), np.array([[0.0, 0.0, -1.0]])
        return self.stack.scene.high + 1.0 - float(self.cast(*ray)[0][0])

    def surfaces(self, x: Array, y: Array) -> Array:
        """Heights (n,) of the surface at points, metres, in the calling thread; NaN outside it, in a hole or at NaN."""
        from orograph.raycast.kernels import cast_rays

        scene, n = self.stack.scene, len(x)
        t, which = np.empty(n), np.empty(n, np.int8)
        origins = np.stack([x, y, np.full(n, scene.high + 1.0)], -1)
        down = np.broadcast_to([0.0, 0.0, -1.0], (n, 3)).copy()
        cast_rays(scene, origins, down, 0.0, np.inf, t, which, 0, n)
        return np.asarray(scene.high + 1.0 - t)

    def cast(
        self, origins: Array, directions: Array, near: float = 0.0, far: float = np.inf
    ) -> tuple[Array, NDArray[np.int8]]:
        """First hits of arbitrary rays.

        Args:
            origins, directions: (n, 3) float64.
            near, far: the range of t that counts.

        Returns:
            t (n,) float64, NaN where nothing is hit; the window hit (n,) int8, −1 where none.
        """
        from orograph.raycast.kernels import cast_rays

        t, which = np.empty(len(origins)), np.empty(len(origins), np.int8)
        scene = self.stack.scene
        self._blocks(
            lambda a, b: cast_rays(scene, origins, directions, near, far, t, which, a, b),
            len(origins),
            16384,
        )
        return t, which

    def cast_pinhole(
        self, eye: Array, d0: Array, du: Array, dv: Array, size: tuple[int, int], near: float = 0.0,
        far: float = np.inf, part: tuple[int, int, int, int] | None = None,
    ) -> tuple[Array, NDArray[np.int8]]:  # fmt: skip
        """First hits of a pinhole camera's rays: direction ``d0 + px·du + py·dv`` through pixel (px, py).

        Args:
            eye, d0, du, dv: (3,) float64, sample coordinates.
            size: (height, width) in pixels.
            part: (row0, row1, col0, col1), the pixels that are wanted; None: all. What results is the same to the bit
                as of the whole picture if it is made of whole blocks (``BLOCK_Y`` rows, ``BLOCK_X`` columns).

        Returns:
            t (height, width) float64, NaN where nothing is hit; the window hit, int8.
        """
        from orograph.raycast.kernels import cast_pinhole

        top, bottom, left, right = part or (0, size[0], 0, size[1])
        shape = bottom - top, right - left
        t, which = np.empty(shape), np.empty(shape, np.int8)
        scene = self.stack.scene
        end = min(far, self._reach(eye, d0, du, dv, size))
        o, *plane = (np.ascontiguousarray(v, np.float64) for v in (eye, d0, du, dv))
        camera = Pinhole(o, plane[0], plane[1], plane[2], near, end)
        picture = Picture((top, left), t, which)
        ground = self.surface(eye[0], eye[1])
        clear = not (eye[2] <= ground)  # also true outside, where ground is NaN
        self._blocks(
            lambda a, b: cast_pinhole(scene, camera, clear, left, right, top + a, top + b, picture),
            shape[0],
            16,
        )
        return t, which

    def skyline(self, points: Array, direction: tuple[float, float], skip: Array, lower: float, enough: float) -> Array:
        """The steepest slope from each point to any ground in one direction (see ``skyline.py``).

        Args:
            points: (n, 3) float64, sample coordinates; NaN rows give NaN.
            direction: (columns, rows) covered by one metre in the direction of the light.
            skip: (n,) horizontal metres left out next to the point.
            lower, enough: slopes between which the answer matters.

        Returns:
            (n,) float64, ``lower`` where nothing stands above that slope; where ``enough`` is reached, the first slope
            found at or above it.
        """
        from orograph.raycast.skyline import skylines

        out = np.empty(len(points))
        scene = self.stack.scene
        dx, dy = direction
        self._blocks(
            lambda a, b: skylines(scene, points, dx, dy, skip, lower, enough, out, a, b),
            len(points),
            16384,
        )
        return out

    def _reach(self, eye: Array, d0: Array, du: Array, dv: Array, size: tuple[int, int]) -> float:
        """A t beyond which no ray of the camera is over the terrain or within its slab of heights."""
        s, f = self.stack.scene, self.stack.scene.floats[0]
        corners = np.array([d0 + x * du + y * dv for x in (0, size[1] - 1) for y in (0, size[0] - 1)])
        far = np.linalg.norm([max(abs(eye[0] - f[3]), abs(eye[0] - f[5])), max(abs(eye[1] - f[4]), abs(eye[1] - f[6]))])
        tall = max(abs(eye[2] - s.low), abs(eye[2] - s.high))
        # The slowest direction in the plan lies on the quadrilateral of directions; where that is near zero (looking
        # down) the fall ends the ray instead. Of each, the smallest over the corners bounds from below what is needed.
        plan = _distance_to_origin(corners[[0, 1, 3, 2], :2])
        fall = float(corners[:, 2].max())
        reach = far / plan if plan > 0 else np.inf
        if fall < 0:
            reach = min(reach, tall / -fall) if plan > 0 else tall / -fall
        return float(min(reach, 1e12)) * (1 + 1e-9) + 1.0


def _distance_to_origin(polygon: Array) -> float:
    """Distance of the origin from a convex polygon (n, 2) in order; 0 inside."""
    a, b = polygon, np.roll(polygon, -1, axis=0)
    cross = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    if (cross > 0).all() or (cross < 0).all():
        return 0.0
    ab = b - a
    s = np.clip(-(a * ab).sum(1) / np.maximum((ab * ab).sum(1), 1e-300), 0, 1)
    return float(np.hypot(*(a + s[:, None] * ab).T).min())
