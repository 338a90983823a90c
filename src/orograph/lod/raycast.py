"""Ray casting as a method: it selects the windows of levels at which rays are cast, and makes no triangles.

A tile in view is drawn at a level whose stored error, projected, keeps the tolerance, and windows nest
(``raycast.select``); rays are marched through maximum mipmaps (``raycast.traverse``; Tevs, Ihrke & Seidel 2008, §3).
From straight above no height moves anything, but it has a colour: a plan's samples are as large as the tolerance.
Between samples a cell is both its triangles, or on the GPU, where that keeps the tolerance, what is bilinear or
constant (Dick, Krüger & Westermann 2009). Pixels, samples.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

from orograph.lod.method import EVERYTHING, Goal, Method, MethodInfo, Ready
from orograph.lod.options import check, option
from orograph.lod.selection import LEVELS_SHARE, RaySurface, RayWindows
from orograph.raycast.select import rectangles
from orograph.viewpoint import Camera


@dataclass(frozen=True, slots=True, kw_only=True)
class RayCastOptions:
    """Options of ``raycast``."""

    surface: str = option(
        "exact", "The surface between samples that rays meet, where it keeps the tolerance; otherwise both "
                 "triangles. On the GPU.",
        choices=("exact", "bilinear", "constant"),
    )  # fmt: skip
    antialias: str = option(
        "all", "Which pixels of a GPU picture get several samples: all, or those at breaks of depth or colour.",
        choices=("all", "breaks"),
    )  # fmt: skip

    def __post_init__(self) -> None:
        check(self)


class RayCast(Method):
    """Windows for rays. See ``Method`` for the arguments."""

    info = MethodInfo(
        "raycast", "no mesh: rays against the samples of nested windows, each as coarse as the tolerance allows",
        "Tevs, Ihrke & Seidel 2008, sec. 3: maximum mipmaps", "rays", RayCastOptions, lambda _: True,
        goals=("tolerance",), invents=lambda _: True,
    )  # fmt: skip

    def select(self, camera: Camera, goal: Goal, ready: Ready = EVERYTHING) -> RayWindows:
        """The windows of a view."""
        self.info.check_goal(goal.name)
        tolerance = goal.tolerance
        assert tolerance is not None
        began = time.perf_counter()
        by = "spacing" if camera.view.projection == "plan" else "error"
        surface: RaySurface = self.options.surface
        pixels = tolerance if surface == "exact" or by == "spacing" else LEVELS_SHARE * tolerance
        windows = rectangles(self.terrain, camera.view, camera.exaggeration, pixels, by=by)
        took = time.perf_counter() - began
        stats: dict[str, Any] = {
            "method": self.info.name, "tolerance": float(tolerance), "conservative": True,
            "exaggeration": camera.exaggeration, "refine_ms": round(took * 1e3, 3), "windows": len(windows),
            "samples": windows.samples,
        }  # fmt: skip
        if surface != "exact":
            stats["surface"] = surface
        return RayWindows(
            method=self.info.name, bound=float(tolerance), stats=stats, windows=windows, surface=surface,
            at_breaks=self.options.antialias == "breaks",
        )  # fmt: skip
