"""Patches and rays in one picture: blocks of the screen are drawn by whichever is cheaper there.

After Dick, Krüger & Westermann, *GPU-Aware Hybrid Terrain Rendering* (2010): the cost of rasterised triangles grows
with their number, that of rays with their pixels and steps. Large triangles are cheaper; where many fall on a pixel, or
are hidden by near ground, rays are. The method selects both, patches (``lod.triangle_patches``) and windows
(``lod.raycast``), each within the tolerance; ``rendering.gpu.surface.mixer`` measures their cost. Pixels.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

from orograph.lod.method import EVERYTHING, Goal, Method, MethodInfo, Need, Ready
from orograph.lod.options import check, option
from orograph.lod.raycast import RayCast
from orograph.lod.selection import PatchesAndRays, PatchSet
from orograph.lod.triangle_patches import TrianglePatches, TrianglePatchesOptions
from orograph.viewpoint import Camera

_PATCHES = TrianglePatchesOptions(geomorph=True)
"""As the GPU draws them."""


@dataclass(frozen=True, slots=True, kw_only=True)
class HybridOptions:
    """Options of ``hybrid``."""

    block: int = option(64, "Side of a block of the screen.", unit="pixels", choices=(32, 64, 128))
    shares: str = option(
        "cost", "What draws a block: cost: the cheaper of the two; turns: alternating as on a chessboard, to inspect "
                "seams.",
        choices=("cost", "turns"),
    )  # fmt: skip
    hysteresis: float = option(
        0.05, "How much cheaper the other must be to replace what drew a block before.", least=0.0, most=1.0
    )

    def __post_init__(self) -> None:
        check(self)


class Hybrid(Method):
    """Patches and windows for rays. See ``Method`` for the arguments."""

    info = MethodInfo(
        "hybrid", "blocks of the screen, each by patches or by rays, whichever is cheaper there; on the GPU",
        "Dick, Krüger & Westermann 2010", "rays", HybridOptions, lambda _: True, goals=("tolerance",),
    )  # fmt: skip

    def __init__(self, *args: Any, **given: Any) -> None:
        super().__init__(*args, **given)
        self._rays = RayCast(self.terrain, resources=self.resources)
        self._patches: TrianglePatches | None = None

    @classmethod
    def needs(cls, options: Any) -> tuple[Need, ...]:
        return TrianglePatches.needs(_PATCHES)

    def select(self, camera: Camera, goal: Goal, ready: Ready = EVERYTHING) -> PatchesAndRays:
        """The windows of a view, and its patches on request: the GPU streams its own."""
        rays = self._rays.select(camera, goal, ready)
        return PatchesAndRays(
            method=self.info.name, bound=rays.bound, lacking=rays.lacking,
            stats={**rays.stats, "method": self.info.name}, windows=rays.windows, camera=camera,
            block=self.options.block, shares=self.options.shares, hysteresis=self.options.hysteresis,
            select_patches=partial(self._select_patches, camera, goal, ready),
        )  # fmt: skip

    def _select_patches(self, camera: Camera, goal: Goal, ready: Ready) -> PatchSet:
        if self._patches is None:
            self._patches = TrianglePatches(self.terrain, _PATCHES, self.resources)
        return self._patches.select(camera, goal, ready)
