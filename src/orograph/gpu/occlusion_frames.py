"""How the directions of a tile's shadow maps look at the terrain: ``occlusion_maps`` has idea, source and units."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from orograph.gpu.rings import Held, Ring
from orograph.light.products import Values

if TYPE_CHECKING:
    from orograph.gpu.occlusion_maps import Maps

Array = NDArray[np.float64]

NEAR = 1e-3
"""Cells within which a face is the sample's own."""
HOLE = 2.0
"""Cells beyond which a face seen from below is ground behind a hole."""
BATCH = 16  # directions per submission at most: enough to keep a GPU busy, and Ctrl-C is heard in between
MOST_CELLS = 1 << 22  # drawn in one: a fraction of a second on the slowest GPU; drivers' watchdogs wait for two

DIRECTION = np.dtype(
    [("u", "f4", 4), ("v", "f4", 4), ("s", "f4", 4), ("omega", "f4", 4), ("run", "f4", 4), ("map", "u4", 4),
     ("tile", "i4", 4), ("bias", "f4", 4)]
)  # fmt: skip
"""``Direction`` of the shader."""

RING = np.dtype([("origin", "i4", 4), ("last", "i4", 4), ("hole", "i4", 4), ("drop", "f4", 4)])
"""``Ring`` of the shader."""

Cells = tuple[int, int, int, int, int]
"""A rectangle of a ring's cells: the ring's number, first row, end, first column, end."""


class Frames:
    """How the directions that matter to a tile map it: everything in float64, relative to the tile's first sample.

    Attributes:
        rings: ``RING`` of each ring. level: the height that heights are relative to. size, texels: width and height
            that hold all maps, and the area of the largest. holes: whether samples are missing.
        cells: what is drawn, by direction.
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
        self.holes = any(h.holes for h in held)
        # The lowest and the highest there is, as seen from the tile.
        deepest, tallest = min(h.low for h in held), max(h.high for h in held)
        a, b = window[0] - origin[0], window[1] - origin[0]
        c, d = window[2] - origin[1], window[3] - origin[1]
        self.rings = [self._ring(maps, ring, origin, tallest - deepest) for ring in around]
        self.cells: list[list[Cells]] = []
        out = np.zeros(len(self.omegas), DIRECTION)
        linear, cell = maps.context.linear, maps.cell
        texel = cell / maps.how.texels
        corners = np.array([[x, y, z - self.level] for x in (c, d - 1) for y in (a, b - 1) for z in (low, high)])
        # Where the tile lies in the terrain, so that texels do not depend on the tile.
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
            # How far occluders can be: within R, no higher than the terrain is, and no deeper.
            reach = min(maps.ways.radius * level, 1e9)
            if abs(omega[2]) > 1e-9:
                reach = min(reach, (tallest - low if omega[2] > 0 else high - deepest) * level / abs(omega[2]))
            over, down = maps.inverse @ (az * reach)
            box = min(a, a + down) - 2, max(b, b + down) + 2, min(c, c + over) - 2, max(d, d + over) + 2
            self.cells.append([
                (number, *part) for number, ring in enumerate(around) for part in _cells(ring, origin, box)
            ])  # fmt: skip
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
        # Below the border of its hole a ring goes down a ramp steeper than rays: none slips in under its edge.
        out["drop"] = relief + 8.0 * maps.cell * (1 << r.level), self.level, 0, 0
        return out

    def batches(self) -> Iterator[range]:
        """The directions of each submission."""
        first, drawn = 0, 0
        for k, parts in enumerate(self.cells):
            count = sum((b - a) * (d - c) for _, a, b, c, d in parts)
            if k > first and (k - first == BATCH or drawn + count > MOST_CELLS):
                yield range(first, k)
                first, drawn = k, 0
            drawn += count
        if self.cells:
            yield range(first, len(self.cells))

    def records(self, layers: int) -> NDArray[Any]:
        """The records (n,) of all directions."""
        self._records["map"][:, 2] = layers
        return self._records


def _cells(ring: Ring, origin: tuple[int, int], box: tuple[float, ...]) -> list[tuple[int, int, int, int]]:
    """The cells of a ring within a box (first row, end, first column, end, in samples from the tile's first), but for
    those well inside its hole: rectangles (first row, end, first column, end)."""
    r = ring.where
    at = ((r.row0 << r.level) - origin[0], (r.col0 << r.level) - origin[1])
    a, b, c, d = (math.floor((v - at[k // 2]) / (1 << r.level)) + k % 2 for k, v in enumerate(box))
    a, b = max(a, 0), min(b, r.row1 - r.row0 - 1)
    c, d = max(c, 0), min(d, r.col1 - r.col0 - 1)
    if a >= b or c >= d:
        return []
    if ring.hole is None:
        return [(a, b, c, d)]
    sides = ring.open_sides()  # there the outermost cells of the hole are a ramp
    e, f, g, h = (v + s * way for v, s, way in zip(
        (ring.hole[0] - r.row0, ring.hole[1] - r.row0, ring.hole[2] - r.col0, ring.hole[3] - r.col0),
        sides, (1, -1, 1, -1)))  # fmt: skip
    e, f, g, h = max(e, a), min(f, b), max(g, c), min(h, d)
    if e >= f or g >= h:
        return [(a, b, c, d)]
    found = [(a, e, c, d), (f, b, c, d), (e, f, c, g), (e, f, h, d)]
    return [(r0, r1, c0, c1) for r0, r1, c0, c1 in found if r0 < r1 and c0 < c1]
