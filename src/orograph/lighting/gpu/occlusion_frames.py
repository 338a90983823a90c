"""How the directions of a tile's shadow maps see the terrain (``occlusion_maps`` has idea, source and units)."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from orograph.hierarchy.clip_stack import Ring
from orograph.lighting.context import Values
from orograph.lighting.gpu.rings import BLOCK, Held

if TYPE_CHECKING:
    from orograph.lighting.gpu.occlusion_maps import Maps

Array = NDArray[np.float64]

NEAR = 1e-3
"""Cells within which a face is the sample's own."""
HOLE = 2.0
"""Cells beyond which a face seen from below is ground behind a hole."""
BATCH = 16  # maximum directions per submission: enough to keep a GPU busy; Ctrl-C works in between
MOST_CELLS = (
    1 << 22
)  # drawn at once: a fraction of a second on the slowest GPU; drivers' watchdogs wait for two seconds

DIRECTION = np.dtype(
    [("u", "f4", 4), ("v", "f4", 4), ("s", "f4", 4), ("omega", "f4", 4), ("run", "f4", 4), ("map", "u4", 4),
     ("tile", "i4", 4), ("bias", "f4", 4)]
)  # fmt: skip
"""``Direction`` of the shader."""

RING = np.dtype([("origin", "i4", 4), ("last", "i4", 4), ("hole", "i4", 4), ("drop", "f4", 4)])
"""``Ring`` of the shader."""

Drawn = tuple[int, int, int]
"""Blocks of a ring that a direction draws: the ring's number, first and end of ``Frames.blocks``."""


class Frames:
    """The mappings of the directions that matter to a tile: everything in float64, relative to the tile's first sample.

    Attributes:
        rings: ``RING`` of each ring. level: the reference of heights. size, texels: width and height that hold all
            maps, and the area of the largest. holes: for each direction, whether rays may meet missing samples.
        blocks: instances of ``vertex`` of the shader, (n, 4) int32. drawn: which of them, by direction.
    """

    def __init__(
        self, maps: Maps, window: tuple[int, int, int, int], origin: tuple[int, int], around: tuple[Ring, ...],
        held: list[Held], inner: Values, slopes: tuple[Array, Array], tall: float,
    ) -> None:  # fmt: skip
        gx, gy = slopes
        up = 1.0 / np.sqrt(1.0 + gx * gx + gy * gy)
        normals = np.stack([-gx * up, -gy * up, up], axis=-1)[np.isfinite(up)]
        parts = [part for part in np.array_split(maps.omegas, 8) if len(part)]
        facing = np.concatenate([(normals @ part.T).max(axis=0) for part in parts])
        self.omegas = maps.omegas[facing > 0]
        low, high = float(np.nanmin(inner)), float(np.nanmax(inner))
        self.level = round((low + high) / 2)
        # The lowest and the highest heights, as seen from the tile.
        deepest, tallest = min(h.low for h in held), max(h.high for h in held)
        a, b = window[0] - origin[0], window[1] - origin[0]
        c, d = window[2] - origin[1], window[3] - origin[1]
        self.rings = [self._ring(maps, ring, origin, tallest - deepest) for ring in around]
        ground = _Blocks(maps, around, held, origin, (a, b, c, d), (low, high))
        chosen: list[NDArray[np.intp]] = []
        self.holes = np.zeros(len(self.omegas), bool)
        out = np.zeros(len(self.omegas), DIRECTION)
        linear, cell = maps.context.linear, maps.cell
        texel = cell / maps.how.texels
        corners = np.array([[x, y, z - self.level] for x in (c, d - 1) for y in (a, b - 1) for z in (low, high)])
        # The tile's place in the terrain, so that texels do not depend on the tile.
        place = np.append(linear @ [origin[1], origin[0]], float(self.level))
        for k, omega in enumerate(self.omegas):
            level = math.hypot(omega[0], omega[1])
            az = omega[:2] / level if level > 1e-12 else np.array([0.0, 1.0])
            u = np.array([-az[1], az[0], 0.0])
            v = np.cross(omega, u)  # u × v = ω: looking against the light u is right and v is up
            for axis, (along, scale) in enumerate(((u, texel), (v, texel * tall))):
                row = np.append(along[:2] @ linear, [along[2], along @ place]) / scale
                row[3] -= math.floor(float((corners @ row[:3]).min()) + row[3]) - 1
                out["map"][k, axis] = math.floor(float((corners @ row[:3]).max()) + row[3]) + 2
                out["uv"[axis]][k] = row
            out["s"][k, :3] = *(-omega[:2] @ linear), -omega[2]
            out["omega"][k] = *omega, 1.0 / (1.0 + omega[2])
            run = maps.inverse @ omega[:2]
            out["run"][k] = *run, min(maps.ways.radius, 1e30), maps.ways.step
            met, self.holes[k] = ground.met(omega, az, level, min(maps.ways.radius * level, 1e9), texel * tall)
            chosen.append(met)
        ends = np.cumsum([0, *(len(some) for some in chosen)])
        none = np.zeros((1, 4), np.int32)  # a buffer must not be empty
        self.blocks = np.concatenate([none, *(ground.instances[some] for some in chosen)])
        self.drawn: list[list[Drawn]] = [
            [(number, 1 + int(start + i), 1 + int(start + j)) for number, (i, j) in enumerate(
                itertools.pairwise(cuts)) if i < j]
            for start, some in zip(ends, chosen) for cuts in [np.searchsorted(some, ground.firsts)]
        ]  # fmt: skip
        first = around[0].where
        out["map"][:, 3] = self.holes
        out["tile"] = window[2] - first.col0, window[0] - first.row0, d - c, b - a
        out["bias"] = NEAR * cell, HOLE * cell, texel * tall, 0.0
        self._records = out
        self.size = int(out["map"][:, 0].max(initial=1)), int(out["map"][:, 1].max(initial=1))
        self.texels = int((out["map"][:, 0].astype(np.int64) * out["map"][:, 1]).max(initial=1))

    def _ring(self, maps: Maps, ring: Ring, origin: tuple[int, int], relief: float) -> Any:
        """``RING`` of a ring."""
        r, (rows, cols) = ring.where, maps.context.shape
        out = np.zeros(1, RING)
        out["origin"] = (r.col0 << r.level) - origin[1], (r.row0 << r.level) - origin[0], r.level, 0
        out["last"] = cols - 1 - origin[1], rows - 1 - origin[0], r.col1 - r.col0, r.row1 - r.row0
        far = 1 << 30
        if ring.hole is not None:
            (a, b, c, d), sides = ring.hole, ring.open_sides()
            edge = [v if is_open else way * far for v, is_open, way in zip(
                (a - r.row0, b - r.row0, c - r.col0, d - r.col0), sides, (-1, 1, -1, 1))]  # fmt: skip
            out["hole"] = edge[2], edge[0], edge[3], edge[1]
        else:
            out["hole"] = far, far, -far, -far
        # Below the border of its hole, a ring has a ramp steeper than rays, so that none passes under its edge.
        out["drop"] = relief + 8.0 * maps.cell * (1 << r.level), self.level, 0, 0
        return out

    def batches(self) -> Iterator[range]:
        """The directions of each submission."""
        first, drawn = 0, 0
        for k, parts in enumerate(self.drawn):
            count = sum((end - start) * BLOCK * BLOCK for _, start, end in parts)
            if k > first and (k - first == BATCH or drawn + count > MOST_CELLS):
                yield range(first, k)
                first, drawn = k, 0
            drawn += count
        if self.drawn:
            yield range(first, len(self.drawn))

    def records(self, layers: int) -> NDArray[Any]:
        """The records (n,) of all directions."""
        self._records["map"][:, 2] = layers
        return self._records


class _Blocks:
    """The blocks of a tile's rings, and which of them a direction's rays can meet.

    Attributes:
        instances: (n, 4) int32, as the shader takes them. firsts: the first of each ring, and their number.
    """

    def __init__(
        self, maps: Maps, around: tuple[Ring, ...], held: list[Held], origin: tuple[int, int],
        tile: tuple[int, int, int, int], heights: tuple[float, float],
    ) -> None:  # fmt: skip
        self.linear, self.tile, self.heights = maps.context.linear, tile, heights
        self.aside = 2.0 * max(float(np.linalg.norm(v)) for v in self.linear.T)
        some = [_of(ring, ground, origin) for ring, ground in zip(around, held)]
        self.firsts = np.cumsum([0, *(len(instances) for instances, _ in some)])
        self.instances = np.concatenate([instances for instances, _ in some])
        # First and last row, first and last column in samples from the tile's first; lowest, highest; holes, ramps.
        self.boxes = np.concatenate([boxes for _, boxes in some], axis=1)

    def met(self, omega: Array, az: Array, level: float, reach: float, texel: float) -> tuple[NDArray[np.intp], bool]:
        """The blocks that rays along ``omega`` can meet, in order, and whether they contain holes.

        Args:
            az, level: its azimuth, of length 1, and its horizontal share. reach: how far horizontally, metres. texel:
                the largest sideways distance of a texel's content from its ray, metres.
        """
        top, bottom, left, right, lowest, highest, missing, ramp = self.boxes
        a, b, c, d = self.tile
        low, high = self.heights
        margin = self.aside + 2.0 * texel
        spans = []
        for way in (az, np.array([-az[1], az[0]])):
            x, y = way @ self.linear
            first = np.minimum(x * left, x * right) + np.minimum(y * top, y * bottom)
            last = np.maximum(x * left, x * right) + np.maximum(y * top, y * bottom)
            own = [x * i + y * j for i in (c, d - 1) for j in (a, b - 1)]
            spans.append((first - max(own) - margin, last - min(own) + margin))
        (near, far), (left_of, right_of) = spans
        near = np.maximum(near, 0.0)
        met = (far >= 0.0) & (left_of <= 0.0) & (right_of >= 0.0) & (near <= reach)
        if omega[2] > 0.0:  # rays pass above lower ground
            met &= (highest - low + 2.0 * texel) * level >= near * omega[2]
        holes = missing > 0.0
        if omega[2] < 0.0:  # without holes, rays meet the ground before they are below all of it
            above = (high - lowest + 2.0 * texel) * level >= near * -omega[2]
            holes &= above
            if not (met & holes).any():
                met &= above | (ramp > 0.0)
        return np.flatnonzero(met), bool((met & holes).any())


def _of(ring: Ring, ground: Held, origin: tuple[int, int]) -> tuple[NDArray[np.int32], Array]:
    """A ring's blocks, except those well inside its hole: instances (n, 4) and boxes (8, n)."""
    r, wide = ring.where, 1 << ring.where.level
    instances, boxes = [], []
    for r0, r1, c0, c1 in _parts(ring):
        row, col = np.mgrid[r0 // BLOCK : -(-r1 // BLOCK), c0 // BLOCK : -(-c1 // BLOCK)].reshape(2, -1)
        y0, y1 = (np.clip(BLOCK * (row + k), r0, r1) for k in (0, 1))
        x0, x1 = (np.clip(BLOCK * (col + k), c0, c1) for k in (0, 1))
        y, x = BLOCK * row, BLOCK * col
        clip = (x0 - x) | (x1 - x) << 8 | (y0 - y) << 16 | (y1 - y) << 24
        instances.append(np.stack([x, y, clip, 0 * clip], axis=-1).astype(np.int32))
        low, high, missing = ground.blocks[:, row, col].astype(np.float64)
        ramp = np.zeros(len(row))
        if ring.hole is not None:
            e, f, g, h = (v - k for v, k in zip(ring.hole, (r.row0, r.row0, r.col0, r.col0)))
            ramp[(y1 > e) & (y0 < f) & (x1 > g) & (x0 < h)] = 1.0
        at = (r.row0 << r.level) - origin[0], (r.col0 << r.level) - origin[1]
        sides = *(at[0] + wide * v for v in (y0, y1)), *(at[1] + wide * v for v in (x0, x1))
        boxes.append(np.stack([*sides, low, high, missing, ramp]))
    if not boxes:
        return np.zeros((0, 4), np.int32), np.zeros((8, 0))
    return np.concatenate(instances), np.concatenate(boxes, axis=1)


def _parts(ring: Ring) -> list[tuple[int, int, int, int]]:
    """Rectangles of a ring's cells (first row, end, first column, end): all but those well inside its hole."""
    r = ring.where
    b, d = r.row1 - r.row0 - 1, r.col1 - r.col0 - 1
    found = [(0, b, 0, d)]
    if ring.hole is not None:
        sides = ring.open_sides()  # the outermost cells of the hole are a ramp there
        e, f, g, h = (v + s * way for v, s, way in zip(
            (ring.hole[0] - r.row0, ring.hole[1] - r.row0, ring.hole[2] - r.col0, ring.hole[3] - r.col0),
            sides, (1, -1, 1, -1)))  # fmt: skip
        f, h = min(f, b), min(h, d)
        if e < f and g < h:
            found = [(0, e, 0, d), (f, b, 0, d), (e, f, 0, g), (e, f, h, d)]
    return [(r0, r1, c0, c1) for r0, r1, c0, c1 in found if r0 < r1 and c0 < c1]


def corners() -> NDArray[np.uint16]:
    """Indices of a block's triangles, counter-clockwise from above where columns run east and rows south.

    Cells are cut along the diagonal of even (row + column).
    """
    row, col = np.mgrid[:BLOCK, :BLOCK].reshape(2, -1, 1)
    even = (row + col) % 2 == 0
    right = np.where(even, [0, 1, 1, 0, 0, 1], [0, 0, 1, 1, 0, 1])
    down = np.where(even, [0, 1, 0, 0, 1, 1], [0, 1, 0, 0, 1, 1])
    return ((row + down) * (BLOCK + 1) + col + right).astype(np.uint16).ravel()
