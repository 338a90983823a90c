"""A layer as tiles of a quadtree over its file: what the GPU streams of imagery, as ``tiles`` are of heights.

Level k has texels of 2^k × 2^k pixels of the file, aligned with its upper left corner, as overviews are: texel
(i, j) is the mean of the pixels [i·2^k, (i+1)·2^k) × [j·2^k, (j+1)·2^k) that exist, of linear light weighted by
opacity (``geovis.texels``). A tile is 256 × 256 texels with a border of one all around, so that filtering never leaves
it. Levels so coarse that the whole area is at most ``BASE`` texels are held in memory, read once when the layer is
opened; finer tiles are read on demand. A large file without overviews is not read when it is opened:
a thread of its own makes its coarse levels as soon as one is wanted (``geovis.coarse``). Tiles show what
is ready, and are read again when there is more. Units: pixels of the file, metres on the ground.
"""

from __future__ import annotations

import contextlib
import math
import threading
import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orograph._numba import kernel
from orograph.errors import OrographError
from orograph.geovis import mipmap
from orograph.geovis.coarse import FINEST, CoarseLevels, Stopped
from orograph.geovis.imagery import ImageWindow
from orograph.geovis.layers import Layer
from orograph.geovis.laying import Laid
from orograph.geovis.placement import Placement
from orograph.geovis.texels import Texels, shape_at
from orograph.progress import Progress
from orograph.rendering.gpu.stream.wanted import Tree
from orograph.store.terrain import TILE, Terrain

Array = NDArray[np.float64]
Bytes = NDArray[np.uint8]
Places = NDArray[np.int64]

SIDE = TILE + 2
"""Texels along the side of a tile, its border included."""

BASE = 1 << 21
"""Texels of the finest level held in memory."""

MOST_TILES = 1 << 20
"""Maximum tiles of a layer: finer levels are left out."""

NEAR = 4
"""Missing coarse levels up to this one are made by the thread that wants a tile: it takes a block or two."""

NOTHING: Bytes = np.empty((0, 0, 4), np.uint8)
"""A tile that shows nothing."""


@dataclass(frozen=True, slots=True)
class Level:
    """The tiles of a level: the place of its first tile among all, and its rows and columns of tiles [from, to)."""

    first: int
    row0: int
    row1: int
    col0: int
    col1: int

    @property
    def shape(self) -> tuple[int, int]:
        return self.row1 - self.row0, self.col1 - self.col0


class ImageTiles:
    """A layer over a terrain, as tiles.

    Attributes:
        laid: its placement. finest, coarsest: levels. levels: by level − finest.
        tree: finds the tiles that a view wants. warnings: for the user.
        kept: coarse levels that the file lacks, or None. failure: why they could not be made, or "".
        pinned: the number of tiles, from the first, that never leave.
    """

    def __init__(self, layer: Layer, terrain: Terrain) -> None:
        """Open a layer: find its place and read its coarse levels, which may take a while.

        Raises:
            ReadError, UsageError: as ``Laid.open``; the file shows nothing over the terrain.
        """
        self.laid = laid = Laid.open(layer, terrain.grid)
        self.warnings = list(laid.warnings)
        area = laid.area
        _, self.coarsest = laid.aligned()
        self.finest = 0
        while _tiles(area, self.finest) > MOST_TILES:
            self.finest += 1
        if self.finest:
            self.warnings.append(f"{layer.path} is drawn {1 << self.finest} times coarser than it could be: it is too "
                                 "large for its tiles to be counted.")  # fmt: skip
        self.levels: list[Level] = []
        first = 0
        for k in range(self.coarsest, self.finest - 1, -1):
            shift = k + TILE.bit_length() - 1
            level = Level(first, area.row0 >> shift, ((area.row1 - 1) >> shift) + 1,
                          area.col0 >> shift, ((area.col1 - 1) >> shift) + 1)  # fmt: skip
            first += level.shape[0] * level.shape[1]
            self.levels.insert(0, level)
        self.count = first
        self.pinned = self.levels[-1].shape[0] * self.levels[-1].shape[1]
        self._level_of = np.concatenate(
            [
                np.full(math.prod(self.levels[k - self.finest].shape), k)
                for k in range(self.coarsest, self.finest - 1, -1)
            ]
        )
        self.base = self.finest
        window, _ = laid.aligned()
        while math.prod(shape_at(window, self.base)) > BASE and self.base < self.coarsest:
            self.base += 1
        self.texels = texels = Texels(laid, self.base)
        self.kept = texels.kept
        self.failure = ""
        self._partial: dict[int, tuple[float, int]] = {}
        self._stop = threading.Event()
        self._maker: threading.Thread | None = None
        if self.kept is None or self.kept.complete:
            texels.hold()
        else:
            self.warnings.append(texels.hint)
        self.tree = self._tree(terrain)

    # ---- texels --------------------------------------------------------------------------------------------------

    def level_of(self, place: int) -> int:
        """The level of a tile."""
        return int(self._level_of[place])

    def tile(self, place: int) -> Bytes:
        """A tile (258, 258, 4): sRGB multiplied (in linear light) by opacity, and opacity; or ``NOTHING``.

        Raises:
            ReadError: the file cannot be read there.
        """
        k = self.level_of(place)
        level = self.levels[k - self.finest]
        row, col = divmod(place - level.first, level.shape[1])
        row, col = (row + level.row0) * TILE - 1, (col + level.col0) * TILE - 1
        image = self.laid.placement.image
        rows, cols = -(-image.rows >> k), -(-image.cols >> k)
        r0, r1 = max(row, 0), min(row + SIDE, rows)
        c0, c1 = (col, col + SIDE) if self.laid.cyclic else (max(col, 0), min(col + SIDE, cols))
        whole = True
        if self.kept is not None and k >= FINEST:
            block, whole = self._there(self.kept, place, k, (r0, r1, c0, c1))
        else:
            block = self.texels.read(k, r0, r1, c0, c1)
        if whole and not block[..., 3].any():
            return NOTHING
        around = ((r0 - row, row + SIDE - r0 - block.shape[0]), (c0 - col, col + SIDE - c0 - block.shape[1]), (0, 0))
        return np.ascontiguousarray(np.pad(multiplied(block), around, "edge"))

    def area(self, place: int) -> Array:
        """West, north, east, south (4,) of the ground under a tile, sample coordinates."""
        return self.tree.boxes[place, [0, 2, 1, 3]]

    @property
    def making(self) -> float | None:
        """The part of the coarse levels that is ready, 0 to 1; None if none are being made."""
        if self.kept is None or self._maker is None or not self._maker.is_alive():
            return None
        return self.kept.made / len(self.kept.blocks)

    def complete(self, progress: Progress, jobs: int | None = None) -> None:
        """Make all coarse levels that the file lacks.

        Raises:
            ReadError: the file cannot be read. StoreError: they cannot be stored.
        """
        if self.kept is not None:
            self.kept.make(self.kept.blocks, progress, jobs)
            self.texels.hold()

    def outdated(self, patience: float) -> list[int]:
        """Tiles that were read when incomplete and of which more is ready now; unless everything is ready, only if at
        least ``patience`` seconds have passed since."""
        kept, now = self.kept, time.monotonic()
        if kept is None or not self._partial:
            return []
        made, enough = kept.made, kept.complete
        every = list(self._partial.items())
        return [place for place, (when, had) in every if made > had and (enough or now - when > patience)]

    def close(self) -> None:
        """Stop making coarse levels; what is ready is kept."""
        self._stop.set()

    def _there(self, kept: CoarseLevels, place: int, k: int, area: tuple[int, int, int, int]) -> tuple[Bytes, bool]:
        """The part of a coarse level's tile that is ready, and whether that is all; quick parts are made now."""
        r0, r1, c0, c1 = area
        had = kept.made
        if k <= NEAR:
            middle = kept.under(k, r0 + 1, r1 - 1, c0 + 1, c1 - 1)
            with contextlib.suppress(Stopped):
                kept.make(middle, jobs=1, stop=self._stop)
        block, whole = kept.read(k, r0, r1, c0, c1)
        if whole:
            self._partial.pop(place, None)
        else:
            self._partial[place] = time.monotonic(), had
            self._begin(kept)
        return block, whole

    def _begin(self, kept: CoarseLevels) -> None:
        """Start making all blocks in the background."""

        def make() -> None:
            try:
                kept.make(kept.blocks, jobs=1, stop=self._stop)
                self.texels.hold()
                self.failure = ""
            except Stopped:
                pass
            except (OrographError, OSError) as error:
                self.failure = str(error)

        if not self._stop.is_set() and (self._maker is None or not self._maker.is_alive()):
            self._maker = threading.Thread(target=make, name="coarse", daemon=True)
            self._maker.start()

    def opacity_at(self, x: Array, y: Array) -> Array:
        """The image's own opacity (n,) at places in the terrain's CRS, from its coarse levels."""
        if not self.texels.held:  # coarse levels are being made
            return np.zeros(len(x))
        placement, scale = self.laid.placement, float(1 << self.base)
        u, v = placement.pixels(x, y)
        if not placement.stretched:
            inside = (v >= 0) & (v <= placement.image.rows)
            inside &= laid_cols(placement, u)
            u = np.where(inside, u, np.nan)
        out = np.empty((len(u), 4), np.float32)
        window, texels = self.texels.window, self.texels
        u, v = (u - window.col0) / scale, (v - window.row0) / scale
        mipmap.look_up(texels.pool, texels.table, mipmap.curves()[0], u, v, np.ones(len(u)), out)
        return np.asarray(out[:, 3], np.float64)

    # ---- places --------------------------------------------------------------------------------------------------

    def _tree(self, terrain: Terrain) -> Tree:
        """The tree of tiles: their areas on the ground, heights there, and the size of their texels."""
        boxes, sizes = _ground(self.laid, self.levels[0], self.finest, terrain)
        all_boxes, all_sizes, parents = [boxes], [sizes], []
        for k, level in enumerate(self.levels):
            rows, cols = level.shape
            if k + 1 == len(self.levels):
                parents.append(np.full(rows * cols, -1))
                break
            above = self.levels[k + 1]
            r = (np.arange(level.row0, level.row1) >> 1) - above.row0
            c = (np.arange(level.col0, level.col1) >> 1) - above.col0
            parent = (r[:, None] * above.shape[1] + c[None, :]).ravel()
            parents.append(above.first + parent)
            count = math.prod(above.shape)
            larger = np.full((count, 4), np.nan)
            for axis, union in enumerate((np.fmin, np.fmax, np.fmin, np.fmax)):
                union.at(larger[:, axis], parent, all_boxes[-1][:, axis])
            size = np.zeros(count)
            np.maximum.at(size, parent, all_sizes[-1])
            all_boxes.append(larger)
            all_sizes.append(2 * size)
        flat = np.concatenate(all_boxes[::-1])
        heights = _heights(terrain, flat)
        return Tree(
            terrain, np.ascontiguousarray(np.concatenate([flat, heights], 1)),
            np.concatenate(parents[::-1]).astype(np.int64), np.concatenate(all_sizes[::-1]),
        )  # fmt: skip


def laid_cols(placement: Placement, u: Array) -> NDArray[np.bool_]:
    """Which columns (pixels) lie within an image; all if it goes around the body."""
    if placement.cyclic:
        return np.isfinite(u)
    return np.asarray((u >= 0) & (u <= placement.image.cols))


def multiplied(level: Bytes) -> Bytes:
    """sRGB colours multiplied (in linear light) by their opacity."""
    opacity = level[..., 3]
    if opacity.min() == 255:
        return level
    decode, encode = mipmap.curves()
    out = level.copy()
    partial = opacity < 255
    linear = decode[level[partial][:, :3]] * (opacity[partial].astype(np.float32) / 255)[:, None]
    out[partial, :3] = encode[np.round(linear * 65535).astype(np.intp)]
    return out


def _tiles(area: ImageWindow, k: int) -> int:
    side = TILE << k
    return -(-(area.row1 - area.row0) // side + 1) * -(-(area.col1 - area.col0) // side + 1)


def _ground(laid: Laid, level: Level, k: int, terrain: Terrain) -> tuple[Array, Array]:
    """For a level's tiles: boxes (n, 4) in sample coordinates, and the largest width of a texel (n,), metres."""
    area, side = laid.area, TILE << k
    u = np.clip(np.arange(level.col0, level.col1 + 1) * float(side), area.col0, area.col1)
    v = np.clip(np.arange(level.row0, level.row1 + 1) * float(side), area.row0, area.row1)
    x, y = laid.placement.places(*np.meshgrid(u, v))
    col, row = (np.asarray(a, np.float64) for a in terrain.grid.index(x, y))
    corners = [(slice(i, i + len(v) - 1), slice(j, j + len(u) - 1)) for i in (0, 1) for j in (0, 1)]
    box = np.stack(
        [
            union.reduce([a[c] for c in corners]).ravel()
            for a, union in ((col, np.fmin), (col, np.fmax), (row, np.fmin), (row, np.fmax))
        ],
        1,
    )
    bend = 0.0 if laid.placement.same else _bend(laid, u, v, col, row, terrain)
    box += np.array([-1.0, 1.0, -1.0, 1.0]) * (bend + 0.5)
    # The greatest stretch of a tile's map from pixels to metres, from its corners.
    wide, high = np.diff(u)[None, :], np.diff(v)[:, None]
    with np.errstate(invalid="ignore", divide="ignore"):
        steps = [np.diff(a, axis=1)[:-1] / wide for a in (x, y)] + [np.diff(a, axis=0)[:, :-1] / high for a in (x, y)]
    matrix = np.nan_to_num(np.stack([[steps[0], steps[2]], [steps[1], steps[3]]]), nan=0.0, posinf=0.0, neginf=0.0)
    stretch = np.linalg.svd(np.moveaxis(matrix, (0, 1), (-2, -1)), compute_uv=False)[..., 0]
    return box, stretch.ravel() * 2.0**k


def _bend(laid: Laid, u: Array, v: Array, col: Array, row: Array, terrain: Terrain) -> float:
    """The distance in samples of the middles of tiles and of their edges from the straight lines between corners: twice
    the largest that is found among some tiles."""
    j = np.unique(np.linspace(0, len(u) - 2, 17).astype(int))
    i = np.unique(np.linspace(0, len(v) - 2, 17).astype(int))
    worst = 0.0
    for a, b in ((0.5, 0.5), (0.5, 0.0), (0.0, 0.5)):
        uu, vv = u[j] * (1 - a) + u[j + 1] * a, v[i] * (1 - b) + v[i + 1] * b
        exact = terrain.grid.index(*laid.placement.places(*np.meshgrid(uu, vv)))
        for found, nodes in zip(exact, (col, row), strict=True):
            top = nodes[i][:, j] * (1 - a) + nodes[i][:, j + 1] * a
            low = nodes[i + 1][:, j] * (1 - a) + nodes[i + 1][:, j + 1] * a
            off = np.abs(found - (top * (1 - b) + low * b))
            worst = max(worst, float(np.nanmax(off)) if np.isfinite(off).any() else 0.0)
    return 2 * worst


def _heights(terrain: Terrain, boxes: Array) -> Array:
    """The lowest and highest ground (n, 2) in boxes (n, 4), NaN if there is none, from the tables of tiles."""
    shapes, low, high = [], [], []
    for k in range(terrain.levels):
        table = terrain.tiles(k)
        shapes.append(table.minimum.shape)
        low.append(table.minimum.ravel())
        high.append(table.maximum.ravel())
    offsets = np.cumsum([0, *(a.size for a in low[:-1])])
    out = np.empty((len(boxes), 2))
    _extremes(
        boxes, np.array(shapes, np.int64), offsets.astype(np.int64), np.concatenate(low), np.concatenate(high),
        np.array([terrain.grid.rows - 1.0, terrain.grid.cols - 1.0]), out,
    )  # fmt: skip
    return out


@kernel
def _extremes(
    boxes: Array, shapes: Places, offsets: Places, low: NDArray[np.float32], high: NDArray[np.float32], last: Array,
    out: Array,
) -> None:  # fmt: skip
    """See ``_heights``; ``last``: the raster's last row and column."""
    for n in range(boxes.shape[0]):
        out[n, 0] = out[n, 1] = np.nan
        west, east, north, south = boxes[n, 0], boxes[n, 1], boxes[n, 2], boxes[n, 3]
        if not (east >= 0.0 and west <= last[1] and south >= 0.0 and north <= last[0]):
            continue
        west, east, north, south = max(west, 0.0), min(east, last[1]), max(north, 0.0), min(south, last[0])
        k = 0
        while k + 1 < shapes.shape[0] and max(east - west, south - north) > 3.0 * (TILE << k):
            k += 1
        side = np.float64(TILE << k)
        for i in range(
            min(np.int64(north / side), shapes[k, 0] - 1), min(np.int64(south / side), shapes[k, 0] - 1) + 1
        ):
            for j in range(
                min(np.int64(west / side), shapes[k, 1] - 1), min(np.int64(east / side), shapes[k, 1] - 1) + 1
            ):
                place = offsets[k] + i * shapes[k, 1] + j
                if low[place] == low[place]:
                    out[n, 0] = (
                        np.float64(low[place]) if out[n, 0] != out[n, 0] else min(out[n, 0], np.float64(low[place]))
                    )
                    out[n, 1] = (
                        np.float64(high[place]) if out[n, 1] != out[n, 1] else max(out[n, 1], np.float64(high[place]))
                    )
