"""What the shading pass looks up, uploaded once and kept: tables, maps, windows, lights, layers."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.gpu.device import Device
from orograph.gpu.recording import write
from orograph.lighting.aperture import Lights
from orograph.lighting.gpu.aperture import tables as light_tables
from orograph.memo import Memo
from orograph.rendering.gpu.shade.light_maps import LightMaps
from orograph.rendering.gpu.shade.look import SHADE, Look
from orograph.rendering.gpu.stream.imagery import Imagery
from orograph.rendering.gpu.stream.tiles import Atlas
from orograph.rendering.gpu.targets import Targets
from orograph.scene.scene import Scene
from orograph.store.terrain import Terrain

Array = NDArray[np.float64]


LEVELS, WINDOWS = 32, 64
"""Entries of the tables of levels and windows (``shaders/slopes.wgsl``, ``shade.wgsl``), more than are ever needed."""


class Resources:
    """Buffers and textures by content.

    Args:
        heights, slopes: the atlases of their tiles. imagery: the layers. kept: results of earlier pictures.
    """

    def __init__(
        self, device: Device, terrain: Terrain, heights: Atlas, slopes: Atlas, imagery: Imagery, memo: Memo
    ) -> None:
        self.device, self.terrain, self.slopes, self.imagery, self.memo = device, terrain, slopes, imagery, memo
        self.heights, self._heights = heights, heights.texture.create_view(dimension="2d-array")
        self.shade = device.buffer(SHADE.itemsize, "UNIFORM", "shade")
        self._shaded: Any = None
        self._buffers: dict[str, tuple[Any, Any]] = {}
        self._uploaded: dict[str, tuple[Any, Any]] = {}
        self._levels = self._level_table()
        self._blank = device.texture((1, 1), "rgba8unorm", "TEXTURE_BINDING", label="nothing").create_view()
        self._slopes = slopes.texture.create_view(dimension="2d-array")
        self._of: tuple[Any, NDArray[np.int32]] = (None, np.zeros((WINDOWS, 8), np.int32))
        self._dark = light_tables(Lights(), np.eye(2), np.zeros(3))

    def bound(
        self,
        look: Look,
        maps: LightMaps,
        scene: Scene,
        targets: Targets,
        *,
        given: bool = False,
        field: bool = False,
        marks: tuple[Any, Any, Any] = (None, None, None),
    ) -> dict[str, Any]:
        """Buffers and views by the names of ``shade.wgsl``, for ``passes.ShadePass.group``.

        Args:
            given, field: slopes, and heights of contour lines, come from the targets.
            marks: the views of the labels' sheet, if there are any, and of where ground breaks off, if silhouettes are
                drawn.
        """
        if maps is not self._of[0]:
            windows = np.zeros((WINDOWS, 8), np.int32)
            windows[: len(maps.windows) + len(maps.fields)] = np.concatenate([maps.windows, maps.fields])
            self._of = maps, windows
        lights = look.lights
        suns, lamps = self._dark
        if lights.suns or lights.lamps:
            suns, lamps = light_tables(lights, *self._from_eye(scene))
        atlas, imagery = self.imagery.bound()
        return {
            "shade": self.shade,
            "slopes": self._slopes,
            "pages": self.slopes.page_buffer,
            "tables": self.stored("tables", look.tables),
            "maps": self.stored("maps", maps.pool),
            "levels": self._levels,
            "windows": self.stored("windows", self._of[1], "UNIFORM"),
            "atlas": atlas,
            "imagery": imagery,
            "suns": self.stored("suns", suns),
            "lamps": self.stored("lamps", lamps),
            "given": targets.given_view(self.device) if given or targets.has_given else self._blank,
            "lettering": self._blank if marks[0] is None else marks[0],
            "breaks": self._blank if marks[1] is None else marks[1],
            "breaks_near": self._blank if marks[2] is None else marks[2],
            "field": targets.field_view(self.device) if field or targets.has_field else self._blank,
            "heights": self._heights,
            "height_pages": self.heights.page_buffer,
        }

    def shade_with(self, uniform: NDArray[Any]) -> None:
        """Write the numbers of a look (``look.SHADE``) if they have changed."""
        if uniform is not self._shaded:
            write(self.device, self.shade, uniform)
            self._shaded = uniform

    def upload(self, name: str, values: NDArray[Any]) -> None:
        """Prepare a buffer of these values for ``stored``, from any thread: large ones delay a frame."""
        self._uploaded[name] = self.device.buffer(values, "STORAGE", name), values

    @property
    def stored_slopes(self) -> tuple[Any, Any, Any]:
        """The view of the slopes' atlas, its pages, and the table of levels."""
        return self._slopes, self.slopes.page_buffer, self._levels

    @property
    def levels(self) -> Any:
        """The table of levels: the offset of each one's tiles, their number, and the number of blocks."""
        return self._levels

    def stored(self, name: str, values: NDArray[Any], usage: str = "STORAGE") -> Any:
        """A buffer with these values, written only if they have changed."""
        ready = self._uploaded.get(name)
        if ready is not None and ready[1] is values:
            self._buffers[name] = ready
            del self._uploaded[name]
        held = self._buffers.get(name)
        if held is not None and held[1] is values:
            return held[0]
        if held is not None and held[0].size == -(-values.nbytes // 4) * 4:
            if not np.array_equal(held[1], values):
                self.device.queue.write_buffer(held[0], 0, np.ascontiguousarray(values))
            self._buffers[name] = held[0], values
            return held[0]
        buffer = self.device.buffer(values, usage, name)
        self._buffers[name] = buffer, values
        return buffer

    def _from_eye(self, scene: Scene) -> tuple[Array, Array]:
        """Metres east and north per column and row, and the eye's position relative to sample (0, 0), stretched
        height."""
        chart = self.terrain.chart
        view = scene.view
        x, y = view.target[:2] if view.projection == "plan" else view.eye[:2]
        east, north = chart.grid.samples.c, chart.grid.samples.f
        origin = np.array([x - east, y - north, view.eye[2] * scene.surface.exaggeration])
        return chart.linear, origin

    def _level_table(self) -> Any:
        terrain, tables = self.terrain, self.slopes.tables
        table = np.zeros((LEVELS, 8), np.uint32)
        table[:, 5] = terrain.levels
        for k in range(terrain.levels):
            table[k, :5] = tables.offsets[k], *tables.shapes[k], *terrain.mean_shape(k)
        return self.device.buffer(table, "UNIFORM", "levels")
