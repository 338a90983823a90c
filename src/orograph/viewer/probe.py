"""The ground under the cursor and under the eye: answered at once from what is known, and exactly soon after.

A window must not wait for a disk or a web server. ``Probe`` holds one nested level of at most ``COARSE`` samples in
memory; anything beyond that (the true surface, ``measuring``) is read by a thread, which notifies the window. It
answers three questions:

- ``pick``: the ground at a pixel, for navigation: the full-resolution surface if it can be had within ``patience``,
  else the coarse one (a pan that holds a point some metres beside the drawn ground is still a pan);
- ``ground``: the height under the eye, many times a frame: tiles at full resolution near the eye, else coarse;
- ``hover``: everything about the place under the cursor; only the newest question is answered.

Units: metres; pixels of the view.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from concurrent.futures import TimeoutError as NotYet

import numpy as np
from numpy.typing import NDArray

from orograph.errors import OrographError
from orograph.measuring import Hit
from orograph.raycast.caster import Caster
from orograph.store.cache import ChunkCache
from orograph.store.terrain import TILE, Terrain
from orograph.viewpoint import Point, View

COARSE = 1 << 20
"""Samples of the level that is held in memory."""
NEAR_BYTES = 12 << 20
"""Bytes of full-resolution tiles held for ``ground``: about 48 tiles."""
PATIENCE = 0.04
"""How long a button press waits for the true surface, seconds."""

Array = NDArray[np.float64]


class Probe:
    """The ground of a terrain, for a window.

    Args:
        terrain: the terrain.
        changed: called from a thread when an answer is ready.

    Attributes:
        hit: the last result of ``hover``; None in the sky.
        trouble: the last failure of reading, or "".
    """

    def __init__(self, terrain: Terrain, changed: Callable[[], None] = lambda: None) -> None:
        self.terrain, self.changed = terrain, changed
        self.hit: Hit | None = None
        self.trouble = ""
        level = 0
        while level < terrain.levels - 1 and math.prod(terrain.shape(level)) > COARSE:
            level += 1
        self.level = level
        rows, cols = terrain.shape(level)
        self.coarse = np.ascontiguousarray(terrain.read(level, 0, rows, 0, cols))
        self._tiles = ChunkCache(NEAR_BYTES)
        self._asked: set[tuple[int, int]] = set()
        self._lock = threading.Lock()
        self._threads = ThreadPoolExecutor(2, thread_name_prefix="orograph-probe")
        self._newest: tuple[View, float, float, float] | None = None
        self._hovering = False
        self._caster: Caster | None = None
        self._closed = False

    # ---- the ground under the eye --------------------------------------------------------------------------------

    def ground(self, x: float, y: float) -> float:
        """Height of the ground at (easting, northing); NaN where there is none. Never waits."""
        rows, cols = self.terrain.grid.shape
        col, row, _ = self.terrain.chart.from_world((x, y, 0.0)).tolist()
        if not (0 <= col <= cols - 1 and 0 <= row <= rows - 1):
            return math.nan
        if self.level == 0:
            return _surface(self.coarse, col, row)
        key = min(int(row), rows - 2) // TILE, min(int(col), cols - 2) // TILE
        with self._lock:
            tile = self._tiles.get(key)
            if tile is None and key not in self._asked and not self._closed:
                self._asked.add(key)
                self._threads.submit(self._read_tile, key)
        if tile is not None:
            return _surface(tile, col - key[1] * TILE, row - key[0] * TILE)
        scale = 2.0**self.level
        return _surface(self.coarse, col / scale, row / scale)

    def _read_tile(self, key: tuple[int, int]) -> None:
        rows, cols = self.terrain.grid.shape
        r, c = key[0] * TILE, key[1] * TILE
        try:
            tile = self.terrain.read(0, r, min(r + TILE + 1, rows), c, min(c + TILE + 1, cols))
        except (OrographError, OSError) as error:
            self.trouble = str(error)
            return  # the request stands: the coarse level answers for now
        with self._lock:
            self._tiles.put(key, tile)
            self._asked.discard(key)
        self.changed()

    # ---- the ground under the cursor -----------------------------------------------------------------------------

    def pick(
        self, view: View, x: float, y: float, exaggeration: float = 1.0, patience: float = PATIENCE
    ) -> Point | None:
        """The ground at a pixel, or None."""
        origin, direction = _ray(view, x, y, exaggeration)
        if not self._closed:
            answer = self._threads.submit(self._cast, view, origin, direction)
            try:
                return answer.result(patience)
            except NotYet:
                answer.cancel()
            except (OrographError, OSError) as error:
                self.trouble = str(error)
        return self.pick_coarse(view, x, y, exaggeration)

    def _cast(self, view: View, origin: Array, direction: Array) -> Point | None:
        from orograph.measuring.pick import cast

        t = cast(self.terrain, origin, direction, view.near, view.far)
        return None if t is None else _point(origin + t * direction)

    def pick_coarse(self, view: View, x: float, y: float, exaggeration: float = 1.0) -> Point | None:
        """The coarse level's ground at a pixel, or None."""
        if min(self.coarse.shape) < 2:
            return None
        if self._caster is None:
            self._caster = Caster.of(self.coarse, 1)
        origin, direction = _ray(view, x, y, exaggeration)
        scale = np.array([2.0**self.level, 2.0**self.level, 1.0])
        o = self.terrain.chart.from_world(origin) / scale
        v = self.terrain.chart.vectors_from_world(direction) / scale
        t = float(self._caster.cast(o[None], v[None], view.near, min(view.far, 1e12))[0][0])
        return None if math.isnan(t) else _point(origin + t * direction)

    def pick_about(self, view: View, x: float, y: float, exaggeration: float = 1.0) -> Point | None:
        """As ``pick_coarse``; an eye below the coarse level's ground uses the level shifted to below the eye's true
        ground."""
        found = self.pick_coarse(view, x, y, exaggeration)
        if found is not None:
            return found
        origin, direction = _ray(view, x, y, exaggeration)
        fall = self.ground(float(origin[0]), float(origin[1])) - float(origin[2])
        if not (fall < 0 and direction[2] < 0):
            return None
        return _point(origin + fall / direction[2] * direction)

    # ---- all about the place under the cursor --------------------------------------------------------------------

    def hover(self, view: View, x: float, y: float, exaggeration: float = 1.0) -> None:
        """Ask for the ground at a pixel; ``hit`` holds the answer when ``changed`` is called."""
        with self._lock:
            self._newest = view, x, y, exaggeration
            if self._hovering or self._closed:
                return
            self._hovering = True
        self._threads.submit(self._hover)

    def leave(self) -> None:
        """The cursor left the terrain."""
        with self._lock:
            self._newest = None
        self.hit = None

    def _hover(self) -> None:
        from orograph.measuring import pick

        while True:
            with self._lock:
                asked, self._newest = self._newest, None
                if asked is None or self._closed:
                    self._hovering = False
                    return
            view, x, y, exaggeration = asked
            try:
                self.hit = pick(self.terrain, view, (x, y), exaggeration)
            except (OrographError, OSError) as error:
                self.hit, self.trouble = None, str(error)
            self.changed()

    def submit(self, work: Callable[[], None]) -> Future[None]:
        """Run a function (a measurement) in a thread."""
        return self._threads.submit(work)

    def close(self) -> None:
        """Shut down the threads without waiting for running work."""
        with self._lock:
            self._closed = True
        self._threads.shutdown(wait=False, cancel_futures=True)


def _ray(view: View, x: float, y: float, exaggeration: float) -> tuple[Array, Array]:
    o0, ou, ov, d0, du, dv = view.ray_basis(exaggeration)
    return o0 + x * ou + y * ov, d0 + x * du + y * dv


def _point(p: Array) -> Point:
    return float(p[0]), float(p[1]), float(p[2])


def _surface(z: NDArray[np.float32], x: float, y: float) -> float:
    """The surface of heights (rows, cols) whose first sample is even, at (x, y) inside it; NaN in a hole.

    Each cell is cut along the diagonal that joins its (even, even) and (odd, odd) corners.
    """
    rows, cols = z.shape
    c, r = max(min(int(x), cols - 2), 0), max(min(int(y), rows - 2), 0)
    if rows < 2 or cols < 2:
        return float(z[min(r, rows - 1), min(c, cols - 1)])
    u, v = float(x - c), float(y - r)
    nw, ne, sw, se = float(z[r, c]), float(z[r, c + 1]), float(z[r + 1, c]), float(z[r + 1, c + 1])
    if (c + r) % 2 == 0:
        return nw + (ne - nw) * u + (se - ne) * v if u >= v else nw + (se - sw) * u + (sw - nw) * v
    if u + v <= 1:
        return nw + (ne - nw) * u + (sw - nw) * v
    return se + (sw - se) * (1 - u) + (ne - se) * (1 - v)
