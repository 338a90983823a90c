"""Choosing the patches of a frame, and the tiles they are drawn from: combines method, atlases and streamer.

A frame selects the patches of its view among those whose tiles are resident, unless it is the last frame's view and no
tile has come or gone; missing tiles are requested, largest error
in pixels first, and arrive asynchronously. While the camera moves, so is what it will lack in a moment
(``prediction``): a tile's error then counts ``AHEAD`` times, added to what it is now. The coarsest tiles are loaded at
the beginning and stay. If an atlas holds less than a view wants, the tiles of the largest errors share it.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.errors import StoreError
from orograph.gpu.device import Device
from orograph.lod.method import Ready, Resources
from orograph.lod.triangle_patches import Patches, TrianglePatches
from orograph.rendering.gpu.stream.landing import Landing, Tile
from orograph.rendering.gpu.stream.prediction import Prediction
from orograph.rendering.gpu.stream.streamer import Streamer
from orograph.rendering.gpu.stream.tiles import SIDES, Atlas, Key, Kind, height_tile, make_tile, slope_tile
from orograph.rendering.gpu.stream.wanted import SlopeTiles
from orograph.store.terrain import TILE, Terrain
from orograph.viewpoint import Camera, View

Array = NDArray[np.float64]

UPLOAD = 32
"""The most tiles uploaded to the GPU in a frame, …"""

UPLOADING = 0.002
"""… and seconds after which no further upload starts, so that frames do not stutter."""

AHEAD = 0.5
"""The weight of a pixel of error that will be missing shortly; one that is missing now counts 1."""

RIM, WAITED_RIM = 0.5, 4.0
"""The error that counts where ground ends, as a fraction of a triangle's longest edge: corners with half of their
surroundings present are filled (``surface.void_fill``). In a picture that is waited for, triangles there are at most a
quarter of a pixel large, so that voids end where those of the raster do."""

HELD = 4.0
"""Pixels of error that a tile counts without which what another method selected cannot be drawn."""

ASK = 64
"""The most tiles of a kind that a frame requests: later frames request the rest."""

Asked = dict[tuple[Kind, Key], float]
"""Tiles to read, with their errors in pixels."""

READERS, REMOTE_READERS = 2, 8
"""Threads that read tiles from a disk, which are busy, and over a network, which mostly wait."""


@dataclass(frozen=True, slots=True)
class Chosen:
    """The patches of a frame.

    Attributes:
        patches: with the slots of their tiles. seconds: that it took to select them.
        missing: tiles and pages of errors that would improve it.
    """

    patches: Patches
    seconds: float
    missing: int


class Residency:
    """The tiles of a terrain on a device.

    Args:
        gpu_memory: bytes of the atlases. memory: bytes of the method's tables. jobs: threads that read.

    Attributes:
        heights, slopes: the atlases. method: selects patches.
        look_ahead: whether tiles are prefetched for the predicted camera.
        came: levels, rows and columns of the tiles that came for the last frame. bytes: theirs.
    """

    def __init__(self, device: Device, terrain: Terrain, gpu_memory: int, memory: int, jobs: int | None) -> None:
        self.terrain = terrain
        self.method = TrianglePatches(terrain, resources=Resources(memory, jobs))
        landing = Landing(device, SIDES["slopes"], 4)
        self.heights = Atlas(device, terrain, "heights", gpu_memory // 2, landing=landing)
        self.slopes = Atlas(device, terrain, "slopes", gpu_memory // 2, landing=landing)
        self._atlases: dict[Kind, Atlas] = {"heights": self.heights, "slopes": self.slopes}
        self._slope_tiles = SlopeTiles(terrain)
        self.streamer: Streamer[Kind, Key, Tile] = Streamer(
            lambda kind, key: landing.land(make_tile(terrain, kind, key)),
            jobs or (REMOTE_READERS if terrain.remote else READERS),
        )
        self.look_ahead = True
        self._prediction = Prediction()
        self._ahead: dict[int, Asked] = {}
        self._asked: Asked = {}
        self._frame = 0
        self._full = False
        self._drawn = True
        self._known: tuple[Any, Patches | None] = None, None
        self._held = 0
        self.came: list[Key] = []
        self.bytes = 0
        top = terrain.levels - 1
        for make, atlas in ((height_tile, self.heights), (slope_tile, self.slopes)):
            rows, cols = atlas.tables.shapes[top]
            for row in range(rows):
                for col in range(cols):
                    atlas.insert((top, row, col), make(terrain, (top, row, col)), 0, pin=True)
            atlas.flush()

    def choose(
        self, view: View, tolerance: float, exaggeration: float, *, wait: bool, later: bool = False, drawn: bool = True
    ) -> Chosen:  # fmt: skip
        """The patches of a view.

        Args:
            wait: until all tiles that the view wants are resident, or the atlases are full.
            later: missing tiles are not requested before ``prepare``.
            drawn: whether anything is drawn out of the heights' tiles; otherwise none are requested.

        Raises:
            StoreError: with ``wait``, a tile cannot be read.
        """
        # (A picture that is waited for may evict the tiles of the one before; consecutive frames share the atlas.)
        self._frame += 2 if wait else 1
        self._full, self._drawn = False, drawn
        self.came.clear()
        self.bytes = 0
        self._upload(wait)
        if wait:
            self._ahead.clear()
        patches, missing, seconds = self._select(view, tolerance, exaggeration, wait)
        if wait or not later:
            self._ask()
        while wait and (missing or self.streamer.waiting) and not self._full:
            self.streamer.wait(1.0)
            self._upload(wait)
            patches, missing, took = self._select(view, tolerance, exaggeration, wait)
            self._ask()
            seconds += took
            self._must_be_read(self._asked)
        self._held = 0
        return Chosen(patches, seconds, missing + int(patches.stats["absent"]))

    @property
    def most_held(self) -> int:
        """How many tiles of heights may be held: all, if the atlas has room for them, or half of what is not pinned."""
        all_fit = self.heights.tables.total <= self.heights.capacity
        return self.heights.capacity if all_fit else max(self.heights.room // 2, 1)

    def hold(self, tiles: NDArray[np.int64], *, wait: bool) -> bool:
        """Have tiles of heights for what another method selected, after ``choose``; whether all of them are there.

        They stay while every frame holds them. Missing ones are requested with those of the patches.

        Args:
            tiles: (n,) places in the page table, ``most_held`` at most. wait: until all are there.

        Raises:
            StoreError: a tile cannot be read.
        """
        self._held += len(tiles)
        if wait:
            self._frame += 2  # the patches' tiles may make room
        while True:
            lack = tiles[self.heights.lacking(tiles, self._frame)]
            asked: Asked = dict.fromkeys(self.heights.named(lack), HELD)
            self._must_be_read(asked)
            self._asked |= asked
            if not (wait and asked):
                return not asked
            self._asked = {name: p for name, p in self._asked.items() if self._absent(name)}
            self._ask()
            self.streamer.wait(1.0)
            self._upload(wait)

    def _must_be_read(self, asked: Asked) -> None:
        for kind, key in self.streamer.failed.keys() & asked.keys():
            why = self.streamer.failed[kind, key][1]
            raise StoreError(f"The {kind} of tile {key} cannot be read: {why}", path=self.terrain.name)

    @property
    def areas(self) -> Array:
        """West, north, east, south (n, 4) of the ground that is drawn from the new tiles, sample coordinates."""
        keys = np.array(sorted(set(self.came)), np.int64).reshape(-1, 3)
        scale = 2.0 ** keys[:, :1]
        corner = keys[:, [2, 1]] * TILE
        return np.concatenate([(corner - 1) * scale, (corner + TILE + 1) * scale], 1)

    @property
    def waiting(self) -> int:
        """The number of tiles being loaded, or due for another attempt."""
        again = time.monotonic() - self.streamer.RETRY
        failed = [self.streamer.failed[key][0] for key in self._asked.keys() & self.streamer.failed.keys()]
        return self.streamer.waiting + sum(when < again for when in failed)

    @property
    def count(self) -> int:
        """The number of resident tiles."""
        return self.heights.count + self.slopes.count

    @property
    def failure(self) -> str:
        """What this view lacks because it could not be read, and why; "" if nothing."""
        for kind, key in self._asked.keys() & self.streamer.failed.keys():
            return f"{kind} of tile {key}: {self.streamer.failed[kind, key][1]}"
        error = self.method.field.failure
        return "" if error is None else str(error)

    def close(self) -> None:
        """Stop reading."""
        self.streamer.close()

    def _select(self, view: View, tolerance: float, exaggeration: float, wait: bool) -> tuple[Patches, int, float]:
        """The patches to draw, the number of missing tiles that can be read, and the seconds it took."""
        begun = time.perf_counter()
        known, patches = self._known
        key = view, tolerance, exaggeration, wait, self.heights.changes
        if patches is None or known != key or patches.stats["absent"]:
            judged, frustum = _judged(view, exaggeration)
            patches = self._patches(
                judged, tolerance, exaggeration, frustum, Ready(self.heights.resident, self.heights.pages, wait)
            )
            self._known = key, patches
        seconds = time.perf_counter() - begun
        self._asked, missing = self._lacking(view, patches if self._drawn else None, exaggeration, self._frame)
        return patches, missing - len(self._asked.keys() & self.streamer.failed.keys()), seconds

    def _patches(
        self, view: View, tolerance: float, exaggeration: float, frustum: Array | None, ready: Ready
    ) -> Patches:  # fmt: skip
        camera = Camera.over(self.terrain.grid, view, exaggeration)
        return self.method.patches(camera, tolerance, ready, frustum=frustum, rim=WAITED_RIM if ready.wait else RIM)

    def _ask(self) -> None:
        """Request what is missing now and what will be missing shortly."""
        every = self._asked.copy()
        for some in self._ahead.values():
            for name, p in some.items():
                if self._absent(name):  # others came since
                    every[name] = every.get(name, 0.0) + AHEAD * p / len(self._ahead)
        self.streamer.want([(p, *name) for name, p in every.items()])

    def _absent(self, name: tuple[Kind, Key]) -> bool:
        return self._atlases[name[0]].slot(name[1]) < 0

    def prepare(self, view: View, tolerance: float, exaggeration: float, *, ahead: bool = True) -> None:
        """Request missing tiles after a frame is submitted: then its own Python code no longer needs the interpreter.

        Args:
            ahead: also predict what will be missing shortly.
        """
        if ahead:
            self._foresee(view, tolerance, exaggeration)
        self._ask()

    def _foresee(self, view: View, tolerance: float, exaggeration: float) -> None:
        """Find the tiles that will be missing shortly."""
        now = time.monotonic()
        self._prediction.see(view, now)
        if not self.look_ahead or not self._prediction.moving:
            self._ahead.clear()
            return
        ahead = self._prediction.ahead(now)
        if ahead is None:
            return
        patches = None
        if self._drawn:
            judged, frustum = _judged(ahead, exaggeration)
            self._known = None, None  # (a selection replaces the one before)
            patches = self._patches(judged, tolerance, exaggeration, frustum, Ready(self.heights.resident, wait=False))
        # What is there already stays, if this frame and the last leave it room.
        self._ahead[self._prediction.turn], _ = self._lacking(ahead, patches, exaggeration, self._frame - 2)

    def _lacking(self, view: View, patches: Patches | None, exaggeration: float, frame: int) -> tuple[Asked, int]:
        """The missing tiles of a view (heights only for its patches), those of the largest errors, and their number.

        Resident ones are marked as wanted in a frame.

        No more are wanted than there is room for: then the tiles of the largest errors settle in the atlas, instead of
        all taking each other's place.
        """
        found: Asked = {}
        missing = 0
        if patches is not None:
            room = self.heights.room - self._held
            missing += self._lacking_in(self.heights, patches.tiles, patches.pixels, room, frame, found)
        which, priority = self._slope_tiles.of(view, exaggeration)
        tiles = self._slope_tiles.index[which]
        return found, missing + self._lacking_in(self.slopes, tiles, priority, self.slopes.room, frame, found)

    def _lacking_in(
        self, atlas: Atlas, tiles: NDArray[np.int64], errors: NDArray[Any], room: int, frame: int, found: Asked
    ) -> int:  # fmt: skip
        """Add the missing ones of an atlas's tiles to ``found``, if there is room; return their number."""
        tiles, errors = _largest(tiles, errors, room)
        lack = atlas.lacking(tiles, frame)
        missing = int(np.count_nonzero(lack))
        if missing:
            # (What cannot be read is in nobody's way.)
            tiles, errors = _largest(tiles[lack], errors[lack], ASK + len(self.streamer.failed))
            found.update(zip(atlas.named(tiles), errors.tolist(), strict=True))
        return missing

    def _upload(self, wait: bool) -> None:
        """Upload tiles that have been read to the GPU."""
        count = 0
        end = math.inf if wait else time.perf_counter() + UPLOADING
        while (wait or count < UPLOAD) and (not count or time.perf_counter() < end):
            taken = self.streamer.take(1)
            if not taken:
                break
            kind, key, data = taken[0]
            # Tiles that this frame or the last one wants must not be evicted.
            self._full |= not self._atlases[kind].insert(key, data, self._frame - 1)
            self.came.append(key)
            count, self.bytes = count + 1, self.bytes + data.nbytes
        for atlas in self._atlases.values():
            atlas.flush()


def _largest(which: NDArray[Any], errors: NDArray[Any], most: int) -> tuple[NDArray[Any], NDArray[Any]]:
    """At most ``most`` of them, those of the largest errors."""
    if len(which) <= most:
        return which, errors
    order = np.argsort(-errors, kind="stable")[:most]
    return which[order], errors[order]


def _judged(view: View, exaggeration: float) -> tuple[View, Array | None]:
    """The camera that errors are judged by, and the planes to cull with if they are not its own.

    From straight above, an error in height moves nothing on the screen, but it affects colours: so the tolerance of a
    plan applies as if it was seen at 45°, from afar.
    """
    if view.projection != "plan":
        return view, None
    away = 1e4 * view.pixel_metres * max(view.frame[2:])
    target = np.asarray(view.target)
    eye = target + away * np.array([0.0, -math.sqrt(0.5), math.sqrt(0.5) / exaggeration])
    fov = 2 * math.degrees(math.atan(view.pixel_metres * view.frame[3] / 2 / away))
    slanted = replace(view, eye=tuple(eye), up=(0.0, 0.0, 1.0), fov_y=fov, projection="perspective", near=0.0)
    return slanted, view.frustum(exaggeration)
