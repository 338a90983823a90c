"""Marks on the ground: contour lines and their labels (``scene.annotations.contours``).

Lines and labels lie on the ground: haze covers them, and nearer ground hides them. On a mesh they are the terrain's
own, laid over the mesh, because those of its heights would be as coarse as the mesh.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.lighting.relief import Relief
from orograph.memo import Memo
from orograph.rendering.cpu.ground import Ground
from orograph.rendering.cpu.mapgrid import MapGrid
from orograph.rendering.lines import contour_kernels
from orograph.rendering.lines.contour_kernels import AROUND, WIDE, Seen, line_cover, thin_out
from orograph.rendering.lines.label_type import Lettering
from orograph.rendering.lines.labels import Placer
from orograph.rendering.lines.smooth import smoothed
from orograph.rendering.palette import LETTERED, LIFTED, PAPER, ink, lifting
from orograph.rendering.rays import Hits
from orograph.scene.contours import CASING
from orograph.scene.scene import Scene

Array = NDArray[np.float64]
Colors = NDArray[np.float32]


RIM = 8
"""Margin in pixels of a tile's sheet of labels, which antialiasing reads."""

STRONGER = 0.3
"""How much more opaque a label is than lines."""


class Lines:
    """The contour lines of one picture.

    Attributes:
        contours: with an interval. facts: about them, for the picture.
    """

    def __init__(self, scene: Scene, ground: Ground, maps: MapGrid, memo: Memo) -> None:
        assert scene.annotations.contours is not None
        self.ground, self.maps = ground, maps
        self.under = ground.under
        if self.under is not None:
            scene = self.under.scene
        assert scene.annotations.contours is not None
        self.contours = scene.annotations.contours.fitted(scene.terrain, scene.view, memo)
        self.ink = ink(self.contours)
        self.facts: dict[str, Any] = {"interval_m": self.contours.interval, "index": self.contours.index}
        self.letters = Lettering(np.zeros((0, 3)), np.zeros(0), 1.0, ())
        self._area, self._sheet = (0, 0, 0, 0), np.zeros((0, 0, 2), np.uint8)
        if self.contours.labels and self.contours.step > 0:
            placer = memo("labels", (), lambda: Placer(scene.terrain), scene.terrain)
            view, exaggeration = scene.view.whole, scene.surface.exaggeration
            drawn = None if self.under is None else ground.caster.surfaces
            labels = memo(
                "labels of a view", (view, exaggeration, self.contours, scene.data.water is None),
                lambda: placer.place(scene, self.contours, drawn), placer if drawn is None else ground.caster,
            )  # fmt: skip
            self.letters = Lettering.of(labels, view, exaggeration, self.contours.type_size)
            left, top, _, _ = scene.view.frame
            self._area = top - RIM, top + scene.view.height + RIM, left - RIM, left + scene.view.width + RIM
            self._sheet = self.letters.sheet(self._area)
        self.facts["labels"] = len(self.letters.words)
        self._basis = ground.rays.pixels.basis
        contours = self.contours
        self._lines = contour_kernels.Lines(float(contours.interval or 1.0), contours.index, contours.width)

    def draw(self, hits: Hits, px: Array, py: Array, out: Colors) -> None:
        """Draw over the colours (n, 3) of hits at pixel positions (n,) of the whole picture."""
        c, maps = self.contours, self.maps
        cover = np.empty(len(hits.t), np.float32)
        drawn = gradient = self.ground.drawn.gradient(hits.points, hits.width)
        own = self.ground.drawn
        if self.under is None:
            heights = smoothed(own, hits.points, hits.width, hits.points[:, 2], self._rays(hits))
        else:
            own = self.under.relief
            heights = self.under.caster.surfaces(hits.points[:, 0], hits.points[:, 1])
            gradient = own.gradient(hits.points, hits.width)
            heights = smoothed(own, hits.points, hits.width, heights)
        seen = Seen(hits.points, heights, gradient, drawn, self.ground.to_world)
        about = px, py, hits.t, seen, self._basis, self._lines
        line_cover(*about, maps.water, maps.place, 0.0, cover)
        light = np.zeros_like(cover)
        casing = np.maximum(lifting(out, LIFTED), np.float32(c.casing or 0))
        if (casing > 0).any():
            line_cover(*about, maps.water, maps.place, CASING, light)
            light *= casing
        lines = np.flatnonzero(np.maximum(light, cover) > 0)
        if len(lines):
            thinned = self._thinned(hits, px, py, heights, own, lines)
            cover[lines] *= thinned
            light[lines] *= thinned
        cover *= np.float32(c.opacity)
        if self.letters.words:
            top, _, left, _ = self._area
            rows, cols = self._sheet.shape[:2]
            i, j = np.floor(py).astype(np.intp) - top, np.floor(px).astype(np.intp) - left
            found = self._sheet[i.clip(0, rows - 1), j.clip(0, cols - 1)]  # (silhouettes look farther than labels)
            letters = np.where(np.isnan(hits.t)[:, None], np.float32(0), found * np.float32(1 / 255))
            gaps = np.flatnonzero(letters[:, 1] > 0)
            halo = np.maximum(lifting(out[gaps], LETTERED), np.float32(c.casing or 0))
            out[gaps] += (halo * letters[gaps, 1])[:, None] * (PAPER - out[gaps])
            light *= 1 - letters[:, 1]
            cover *= 1 - letters[:, 1]
            cover += letters[:, 0] * np.float32(min(1.0, c.opacity + STRONGER))
        out += light[:, None] * (PAPER - out)
        some = np.flatnonzero(cover > 0)
        out[some] += cover[some, None] * (self.ink - out[some])

    def _rays(self, hits: Hits) -> Array:
        """Directions (n, 3) of the rays: columns, rows and true metres."""
        x, y, z = hits.rays.T
        (a, b), (c, d) = self.ground.to_samples
        return np.stack([a * x + b * y, c * x + d * y, z / self.ground.scene.surface.exaggeration], -1)

    def _thinned(
        self, hits: Hits, px: Array, py: Array, heights: Array, own: Relief, lines: NDArray[np.intp]
    ) -> Colors:
        """The remaining part (m,), 0 to 1, of the lines at the hits ``lines``: less where lines around run together."""
        cover = np.ones(len(lines), np.float32)
        points, width = hits.points[lines], hits.width[lines]
        away = np.zeros((4, *points.shape))
        away[0, :, 0], away[1, :, 1] = AROUND * width, AROUND * width
        away[2:] = -away[:2]
        around = np.stack([own.gradient(points + step, WIDE * width) for step in away])
        thin_out(
            px[lines], py[lines], hits.t[lines], heights[lines], around, self.ground.to_world, self._basis,
            self._lines, cover,
        )  # fmt: skip
        return cover

    def gaps(self) -> Colors | None:
        """How much of each pixel (height, width) of the view labels keep free, 0 to 1; None: there are none."""
        if not self.letters.words:
            return None
        return self._sheet[RIM:-RIM, RIM:-RIM, 1] * np.float32(1 / 255)
