"""A tour above a terrain: kept off the ground, and graded so that frames do not flicker.

**Clearance.** With ``above_ground``, the eye is lifted wherever the path comes closer to the ground than that. The
required lift, sampled along the path, is dilated over ``SOFT`` seconds to both sides and then averaged over the same
time: each value in the mean is at least the lift required in its middle. So the lifted path keeps its distance at every
sample, and its velocity is continuous (the mean is weighted by a smooth bump). The target stays where it is.

**Grading.** The settings that a single picture derives from the ground in view (how much relief is strengthened,
between which depths haze grows) would jump from frame to frame. They are derived from small pictures along the tour,
``GRADED`` seconds apart, and interpolated. They depend only on the tour: a frame is the same in whichever part of it is
drawn. Units: seconds, metres.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.errors import NothingInViewError
from orograph.memo import Memo
from orograph.progress import SILENT, Progress
from orograph.rendering.cpu.ground import Ground
from orograph.rendering.cpu.mapgrid import strength_of, working_window
from orograph.rendering.survey import Survey
from orograph.scene.scene import Scene
from orograph.splines import Monotone
from orograph.store.terrain import Terrain
from orograph.touring.tour import Tour
from orograph.viewpoint import View

Array = NDArray[np.float64]

SOFT = 1.0
STEP = 1 / 30
"""Maximum seconds between two samples of the ground."""

GRADED = 1.0
PREVIEW = (320, 180)
BLOCK = 256
"""Samples a side of the parts of the raster that are read to find the ground."""


class Course:
    """A tour above a terrain.

    Args:
        tour, terrain: see their classes.
        progress: reports to it.

    Attributes:
        lifted: the largest lift of the eye, metres.
    """

    def __init__(self, tour: Tour, terrain: Terrain, progress: Progress = SILENT) -> None:
        self.tour, self.terrain = tour, terrain
        self.lift: Monotone | None = None
        self.lifted = 0.0
        if tour.above_ground is not None:
            with progress.task("Keeping above the ground"):
                self._clear(tour.above_ground)

    def at(self, time: float) -> View:
        """The camera at a time, above the ground."""
        view = self.tour.at(time)
        if self.lift is None:
            return view
        up = self.lift(self.tour.moment(time))
        return view if up <= 0 else replace(view, eye=(view.eye[0], view.eye[1], view.eye[2] + up))

    def _clear(self, least: float) -> None:
        tour = self.tour
        steps = max(2, math.ceil(tour.duration / min(STEP, 1 / tour.fps)))
        times = tour.times[0] * tour.loop + np.linspace(0.0, tour.duration, steps + 1)
        eyes = np.array([tour.at(t).eye for t in times])
        # Use more samples where the eye passes several samples of the ground in a step.
        move = np.linalg.norm(np.diff(eyes[:, :2], axis=0), axis=1).max(initial=0.0)
        finer = min(64, max(1, math.ceil(move / max(self.terrain.grid.spacing))))
        between = np.linspace(0.0, 1.0, finer, endpoint=False)
        fine = (eyes[:-1, None] + between[None, :, None] * np.diff(eyes, axis=0)[:, None]).reshape(-1, 3)
        fine = np.concatenate([fine, eyes[-1:]])
        need = highest(self.terrain, fine[:, :2]) + least - fine[:, 2]
        need = np.where(np.isfinite(need), np.maximum(need, 0.0), 0.0)
        # Each step needs the lift of its middle, and of the way to both neighbours.
        padded = np.concatenate([need, np.zeros(finer)])
        each = np.array([padded[max(k * finer - finer, 0) : k * finer + finer + 1].max() for k in range(steps + 1)])
        self.lifted = float(each.max())
        if self.lifted <= 0:
            return
        self.lift = Monotone(times, eased(each, max(1, round(SOFT / (times[1] - times[0]))), tour.loop))


def eased(need: Array, reach: int, loop: bool = False) -> Array:
    """A smooth sequence (n,) that is nowhere below ``need`` (n,).

    It is dilated over ``reach`` to both sides, then averaged over the same reach with the weights of a raised cosine.
    With ``loop``, the first follows the last.
    """
    from scipy.ndimage import maximum_filter1d

    values = need[:-1] if loop else need
    mode = "wrap" if loop else "nearest"
    wide = maximum_filter1d(values, 2 * reach + 1, mode=mode)
    weights = 1 + np.cos(np.linspace(-math.pi, math.pi, 2 * reach + 3)[1:-1])
    padded = np.pad(wide, reach, mode="wrap" if loop else "edge")
    soft = np.convolve(padded, weights / weights.sum(), "valid")
    soft = np.maximum(soft, values)  # rounding
    return np.append(soft, soft[0]) if loop else soft


def highest(terrain: Terrain, places: Array) -> Array:
    """The highest of the four samples around each place (n, 2) in the terrain's CRS, metres: no lower than the surface.

    NaN outside the terrain and where all four are missing.
    """
    rows, cols = terrain.grid.shape
    col, row = (np.asarray(v, np.float64) for v in terrain.grid.index(places[:, 0], places[:, 1]))
    out = np.full(len(places), np.nan)
    inside = np.flatnonzero((col >= 0) & (row >= 0) & (col <= cols - 1) & (row <= rows - 1))
    c = np.minimum(col[inside].astype(np.int64), max(cols - 2, 0))
    r = np.minimum(row[inside].astype(np.int64), max(rows - 2, 0))
    tiles = (r // BLOCK) * (cols // BLOCK + 1) + c // BLOCK
    for tile in np.unique(tiles):
        here = np.flatnonzero(tiles == tile)
        r0, c0 = r[here].min(), c[here].min()
        r1, c1 = min(r[here].max() + 2, rows), min(c[here].max() + 2, cols)
        heights = terrain.read(0, int(r0), int(r1), int(c0), int(c1))
        i, j = r[here] - r0, c[here] - c0
        i1, j1 = np.minimum(i + 1, heights.shape[0] - 1), np.minimum(j + 1, heights.shape[1] - 1)
        corners = np.stack([heights[i, j], heights[i1, j], heights[i, j1], heights[i1, j1]])
        known = np.isfinite(corners)
        out[inside[here]] = np.where(known.any(0), np.where(known, corners, -np.inf).max(0), np.nan)
    return out


class Grading:
    """Settings that frames derive from the ground in view, smooth over the tour (see the module).

    Args:
        course: the tour.
        scene: the scene of a moment: time → ``Scene``.
    """

    def __init__(self, course: Course, scene: Callable[[float], Scene], progress: Progress = SILENT) -> None:
        tour = course.tour
        count = max(1, math.ceil(tour.duration / GRADED))
        times = np.unique([*np.linspace(0.0, tour.duration, count + 1), *tour.times])
        found: list[tuple[float, float, float, float]] = []
        memo = Memo()
        with progress.task("Measuring along the path", total=len(times)) as task:
            for time in times:
                small = _preview(scene(float(time)))
                ground = Ground.load(small, None, memo)
                survey = Survey.of(ground.rays)
                if survey is not None:
                    window = working_window(small.terrain, survey.hits.points)
                    strength = memo(
                        "strength",
                        (window, small.surface.exaggeration),
                        partial(strength_of, small, window),
                        small.terrain,
                    )
                    found.append((float(time), strength, *survey.range))
                task.advance()
        if not found:
            raise NothingInViewError(
                "The terrain is nowhere in view on this tour.", path=course.terrain.name,
                remedy='If its numbers are longitude and latitude, add "crs": "EPSG:4326".',
            )  # fmt: skip
        self.channels = [Monotone([f[0] for f in found], np.log([max(f[k], 1e-3) for f in found])) for k in (1, 2, 3)]

    def settings(self, time: float) -> dict[str, Any]:
        """The settings for a frame's scene: ``relief`` and ``depths``."""
        relief, near, far = (math.exp(c(time)) for c in self.channels)
        return {"relief": relief, "depths": (near, max(far, near))}


def _preview(scene: Scene) -> Scene:
    view = scene.view
    scale = min(1.0, math.sqrt(PREVIEW[0] * PREVIEW[1] / (view.width * view.height)))
    small = view.resized(max(1, round(view.width * scale)), max(1, round(view.height * scale)))
    return scene.but(view=small, method="auto", wireframe=False, mesh_view=None, water=None, furniture=False)
