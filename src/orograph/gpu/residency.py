"""Which patches a frame draws, and the tiles they are drawn from: the engine, the atlases and the streamer together.

A frame asks for the patches of its view among those whose tiles are there; what it lacks is asked for, largest error in
pixels first, and comes when it comes. The coarsest tiles are loaded at the beginning and stay.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from orograph.errors import OrographError
from orograph.gpu.device import Device
from orograph.gpu.streamer import Streamer
from orograph.gpu.tiles import Atlas, Key, Kind, height_tile, make_tile, slope_tile
from orograph.gpu.wanted import SlopeTiles
from orograph.lod.batched import Batched, Patches
from orograph.store.terrain import Terrain
from orograph.view import View

Array = NDArray[np.float64]

UPLOAD = 16
"""Tiles brought to the GPU in a frame, at most: what does not make it stutter."""


@dataclass(frozen=True, slots=True)
class Chosen:
    """The patches of a frame.

    Attributes:
        patches: with the slots of their tiles. seconds: that it took to select them.
        missing: tiles and pages of errors that would make it better. loaded: tiles that came for it.
    """

    patches: Patches
    seconds: float
    missing: int
    loaded: int


class Residency:
    """The tiles of a terrain on a device.

    Args:
        gpu_memory: bytes of the atlases. memory: bytes of the engine's tables. jobs: threads that read.

    Attributes:
        heights, slopes: the atlases. engine: selects patches.
    """

    def __init__(self, device: Device, terrain: Terrain, gpu_memory: int, memory: int, jobs: int | None) -> None:
        self.terrain = terrain
        self.engine = Batched(terrain, max_memory=memory, jobs=jobs, rim=0.5)
        self.heights = Atlas(device, terrain, "heights", gpu_memory // 2)
        self.slopes = Atlas(device, terrain, "slopes", gpu_memory // 2)
        self._atlases: dict[Kind, Atlas] = {"heights": self.heights, "slopes": self.slopes}
        self._slope_tiles = SlopeTiles(terrain)
        self.streamer: Streamer[Kind, Key] = Streamer(lambda kind, key: make_tile(terrain, kind, key), jobs or 2)
        self._frame = 0
        self._full = False
        top = terrain.levels - 1
        for make, atlas in ((height_tile, self.heights), (slope_tile, self.slopes)):
            rows, cols = atlas.tables.shapes[top]
            for row in range(rows):
                for col in range(cols):
                    atlas.insert((top, row, col), make(terrain, (top, row, col)), 0, pin=True)
            atlas.flush()

    def choose(self, view: View, tolerance: float, exaggeration: float, *, wait: bool) -> Chosen:
        """The patches of a view.

        Args:
            wait: until all tiles that the view wants are there, or the atlases hold no more.

        Raises:
            OrographError: with ``wait``, a tile cannot be read.
        """
        self._frame += 1
        self._full = False
        loaded = self._upload(1 << 16 if wait else UPLOAD)
        patches, wanted, seconds = self._select(view, tolerance, exaggeration, wait)
        while wait and (wanted or self.streamer.waiting) and not self._full:
            self.streamer.wait(1.0)
            loaded += self._upload(1 << 16)
            patches, wanted, more = self._select(view, tolerance, exaggeration, wait)
            seconds += more
            for kind, key in set(self.streamer.failed) & set(self._asked):
                why = self.streamer.failed[kind, key][1]
                raise OrographError(f"The {kind} of tile {key} cannot be read: {why}", path=self.terrain.name)
        return Chosen(patches, seconds, len(wanted) + int(patches.stats["absent"]), loaded)

    @property
    def waiting(self) -> int:
        """How many tiles are on their way."""
        return self.streamer.waiting

    @property
    def count(self) -> int:
        """How many tiles are there."""
        return self.heights.count + self.slopes.count

    @property
    def failure(self) -> str:
        """A tile that could not be read, and why; "" if there is none."""
        for (kind, key), (_, why) in list(self.streamer.failed.items()):
            return f"{kind} of tile {key}: {why}"
        return ""

    def close(self) -> None:
        """Stop reading."""
        self.streamer.close()

    def _select(
        self, view: View, tolerance: float, exaggeration: float, wait: bool
    ) -> tuple[Patches, list[tuple[float, Kind, Key]], float]:
        """The patches to draw, the tiles that are missing, and the seconds that took."""
        begun = time.perf_counter()
        judged, frustum = _judged(view, exaggeration)
        patches = self.engine.select(
            judged, tolerance, resident=self.heights.resident, exaggeration=exaggeration, frustum=frustum, wait=wait
        )
        seconds = time.perf_counter() - begun
        used, w = patches.instances, patches.wanted
        places = self.heights.places(used["level"], used["tile_row"].astype(np.int64), used["tile_col"])
        slots = self.heights.slots(places)
        self.heights.touch(slots, self._frame)
        used["slot"] = slots
        places = self.heights.places(w["level"], w["row"].astype(np.int64), w["col"])
        slots = self.heights.slots(places)
        self.heights.touch(slots, self._frame)
        lacking = w[slots < 0].tolist()
        wanted: list[tuple[float, Kind, Key]] = [(p, "heights", (k, i, j)) for k, i, j, p in lacking]
        which, priority = self._slope_tiles.of(view, exaggeration)
        slots = self.slopes.slots(self._slope_tiles.index[which])
        self.slopes.touch(slots, self._frame)
        lack = slots < 0
        for p, key in zip(priority[lack].tolist(), self._slope_tiles.keys[which[lack]].tolist(), strict=True):
            wanted.append((p, "slopes", (key[0], key[1], key[2])))
        self.streamer.want(wanted)
        self._asked = [(w[1], w[2]) for w in wanted]
        return patches, [w for w in wanted if (w[1], w[2]) not in self.streamer.failed], seconds

    def _upload(self, most: int) -> int:
        taken = self.streamer.take(most)
        for kind, key, data in taken:
            self._full |= not self._atlases[kind].insert(key, data, self._frame)
        for atlas in self._atlases.values():
            atlas.flush()
        return len(taken)


def _judged(view: View, exaggeration: float) -> tuple[View, Array | None]:
    """The camera that errors are judged by, and the planes to cull with if they are not its own.

    From straight above no error of a height moves anything on the screen, but it has a colour: a plan is held to its
    tolerance as if it was seen at 45°, from afar.
    """
    if view.projection != "plan":
        return view, None
    away = 1e4 * view.pixel_metres * max(view.width, view.height)
    target = np.asarray(view.target)
    eye = target + away * np.array([0.0, -math.sqrt(0.5), math.sqrt(0.5) / exaggeration])
    fov = 2 * math.degrees(math.atan(view.pixel_metres * view.frame[3] / 2 / away))
    slanted = replace(view, eye=tuple(eye), up=(0.0, 0.0, 1.0), fov_y=fov, projection="perspective", near=0.0)
    return slanted, view.frustum(exaggeration)
