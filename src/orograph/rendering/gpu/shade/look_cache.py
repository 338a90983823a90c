"""A scene's numbers for the shading shader, recomputed only after changes, and its flags."""

from __future__ import annotations

import math

from orograph.memo import Memo
from orograph.rendering.gpu.frame import Normals, Overlay
from orograph.rendering.gpu.shade.following import Following
from orograph.rendering.gpu.shade.look import GIVEN, VOIDS, Look
from orograph.rendering.gpu.surface.left import Slopes
from orograph.rendering.gpu.surface.void_fill import VoidFillPass
from orograph.rendering.lines.smooth import SMALL
from orograph.scene.contours import Contours
from orograph.scene.scene import Scene
from orograph.store.terrain import Terrain

SLOPES: dict[Normals, Slopes] = {
    "computed": "", "stored": "stored", "sampled": "sampled", "derivatives": "flat", "faces": "flat",
}  # fmt: skip
"""Which slopes the geometry pass writes for a choice of normals."""


class Looks:
    """The looks of scenes on a terrain.

    Args:
        memo: results of earlier pictures. light: the current maps of light. void_fill: the membranes over holes.
    """

    def __init__(self, terrain: Terrain, memo: Memo, light: Following, void_fill: VoidFillPass) -> None:
        self.terrain, self.memo, self.light, self.void_fill = terrain, memo, light, void_fill

    def of(self, scene: Scene, overlay: Overlay, *, exact: bool) -> Look:
        """The scene's colours and light, recomputed only if something changed.

        Unless ``exact``, the depth range of haze is rounded, so that it does not change constantly.
        """
        maps = self.light.maps
        assert maps is not None
        contours = self.contours(scene)
        outlined = scene.annotations.silhouettes is not None and scene.view.projection != "plan"
        silhouettes = (
            scene.annotations.silhouettes.fitted(scene.view) if scene.annotations.silhouettes and outlined else None
        )
        near, far = scene.lighting.depths or self.light.range
        if not exact:
            near, far = (math.exp(round(10 * math.log(max(v, 1e-3))) / 10) for v in (near, far))
        light = scene.lighting
        key = (
            light.sun, light.light, light.lamps, light.discs, light.shadows, light.sky, light.relief,
            scene.data.colormap, scene.data.range, scene.data.water, scene.surface.exaggeration, near, far,
            overlay.wireframe,
            scene.surface.wireframe, overlay.levels, contours, silhouettes,
        )  # fmt: skip

        def make() -> Look:
            return Look(
                scene, maps, (near, far), self.memo, wireframe=overlay.wireframe or scene.surface.wireframe,
                levels=overlay.levels, contours=contours, silhouettes=silhouettes,
            )  # fmt: skip

        return self.memo("look", key, make, maps)

    def features(self, look: Look, given: bool) -> int:
        """The flags of the shading shader; ``given``: slopes come from the targets."""
        return int(look.uniform["flags"]) | (VOIDS if self.void_fill.count else 0) | (GIVEN if given else 0)

    def contours(self, scene: Scene) -> Contours | None:
        return scene.annotations.contours and scene.annotations.contours.fitted(self.terrain, scene.view, self.memo)

    def beyond_samples(self, scene: Scene) -> bool:
        """Whether there are contour lines, and some pixels so small that these follow the smooth surface."""
        view = scene.view
        pixel = view.pixel_metres if view.projection == "plan" else view.pixel_slope * self.light.range[0]
        return scene.annotations.contours is not None and pixel < SMALL[1] * min(self.terrain.grid.spacing)
