"""The bands of rows in which a terrain is judged, the data to read for each, and the blocks of a band.

A band lies within one row of tiles. Read are the columns that its triangles reach, and the tiles whose box (lowest to
highest sample, from the terrain's own tables) reaches into the view: everything else is neither in view nor covered. A
mesh of samples is swept band by band. Where vertices lie between samples, there are many more strips to a row, so a
band is cut into narrow blocks, in which few triangles meet each strip.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orograph._numba import read_only
from orograph.errors import UsageError
from orograph.store.terrain import TILE, Terrain
from orograph.tessellation import Tessellation, turn
from orograph.verify.edges import survey
from orograph.verify.frustum import Camera
from orograph.verify.ground import Ground
from orograph.verify.report import Place, place
from orograph.verify.spans import Corners, bucket
from orograph.verify.strips import LONGEST
from orograph.verify.sweep import Block

Ints = NDArray[np.int64]

BAND_BYTES = 1 << 25
"""Approximate bytes of a very wide terrain that are read at a time."""

BLOCK = 128
"""Columns of a block of a mesh with vertices between samples."""


@dataclass(frozen=True, slots=True)
class Mesh:
    """A tessellation prepared for the referee.

    Attributes:
        tessellation: the original.
        corners: its triangles, with vertices in ticks.
        signs: (m,) int8: 1 for triangles of correct orientation, −1 for reversed ones, 0 without area.
        vertices: (v,) int64, those of triangles with area, by row, then column.
        rows: (v,) int64, their rows in ticks.
        size: rows in a band.
        start, members: the triangles that touch each band, or the row below it.
    """

    tessellation: Tessellation
    corners: Corners
    signs: NDArray[np.int8]
    vertices: Ints
    rows: Ints
    size: int
    start: Ints
    members: Ints

    def place(self, x: float, y: float) -> Place:
        """(column, row) of a place in ticks."""
        return place(x / (1 << self.corners.shift), y / (1 << self.corners.shift))


def take_apart(tessellation: Tessellation, terrain: Terrain) -> Mesh:
    """Prepare a tessellation of a terrain.

    Raises:
        UsageError: a vertex lies beyond the terrain's samples or at too fine a fraction, or the terrain is too large
            for exact arithmetic.
    """
    rows, cols = terrain.grid.shape
    shift = ticks(tessellation, terrain)
    x, y = (np.ldexp(tessellation.vertices[:, i], shift).astype(np.int64) for i in (0, 1))
    corners = Corners(tessellation.triangles, tessellation.vertices, x, y, shift)
    signs, used = survey(corners, turn(terrain.grid))
    size = TILE
    while size > 16 and 4 * size * cols > BAND_BYTES:
        size //= 2
    start, members = bucket(corners, signs, size, -(-rows // size))
    vertices = np.flatnonzero(used)
    vertices = vertices[np.argsort(y[vertices] << 31 | x[vertices], kind="stable")]
    return Mesh(tessellation, corners, signs, vertices, y[vertices], size, start, members)


def ticks(tessellation: Tessellation, terrain: Terrain) -> int:
    """The smallest s for which all vertices lie at multiples of 2^-s of a cell.

    Raises:
        UsageError: as ``take_apart``.
    """
    rows, cols = terrain.grid.shape
    finest = (LONGEST // max(rows - 1, cols - 1, 1)).bit_length() - 1
    if finest < 0:
        raise UsageError(f"The referee judges terrains with up to {LONGEST:,} samples a side, not {rows:,} × {cols:,}.")
    position = tessellation.vertices[:, :2]
    outside = ~((position >= 0) & (position <= (cols - 1, rows - 1))).all(-1)
    if outside.any():
        first = int(np.argmax(outside))
        raise UsageError(
            f"Vertex {first} of the tessellation, at column {position[first, 0]:g} and row {position[first, 1]:g}, "
            f"lies beyond the {rows} × {cols} samples of {terrain.name!r}, so its mesh cannot be judged."
        )
    finer = np.arange(len(position))
    for shift in range(finest + 1):
        scaled = np.ldexp(position[finer], shift)
        finer = finer[(scaled != np.floor(scaled)).any(-1)]
        if len(finer) == 0:
            return shift
    column, row = position[finer[0]]
    raise UsageError(
        f"Vertex {finer[0]} of the tessellation, at column {column:.17g} and row {row:.17g}, lies at a finer fraction "
        "of a cell than the referee's exact arithmetic can represent.",
        remedy=f"Round columns and rows to multiples of 2^-{finest}.",
    )


@dataclass(frozen=True, slots=True)
class Band:
    """Rows first to last, both included, the columns [west, east) to read for them, and their triangles."""

    first: int
    last: int
    west: int
    east: int
    members: Ints

    def read(self, terrain: Terrain) -> Ground:
        """The samples of the band and of the rows beside it."""
        rows, cols = terrain.grid.shape
        top, bottom = max(self.first - 1, 0), min(self.last + 3, rows)
        heights = read_only(np.ascontiguousarray(terrain.read(0, top, bottom, self.west, self.east)))
        return Ground(heights, top, self.west, rows, cols)

    def blocks(self, mesh: Mesh, ground: Ground, interpolating: bool) -> Iterator[tuple[Ground, Block]]:
        """The blocks of the band, from west to east, and their windows."""
        corners, shift = mesh.corners, mesh.corners.shift
        bottom = min(self.last + 1, ground.rows - 1)
        samples = np.arange(self.first, bottom + 1) << shift
        part = slice(*np.searchsorted(mesh.rows, [self.first << shift, (self.last + 1) << shift]).tolist())
        vertices = mesh.vertices[part]
        if shift == 0:
            start = np.searchsorted(mesh.rows[part], np.append(samples, samples[-1] + 1))
            yield (
                ground,
                Block(
                    self.first, self.last, self.west, self.east, samples, vertices, start, self.members, interpolating
                ),
            )
            return
        at = corners.triangles[self.members]
        members = self.members[np.argsort(corners.y[at].min(1), kind="stable")]
        at = corners.triangles[members]
        x, y, column = corners.x[at], corners.y[at], corners.x[vertices] >> shift
        low, high = x.min(1) >> shift, x.max(1) >> shift
        for west in range(self.west, self.east, BLOCK):
            east = min(west + BLOCK, self.east)
            here = (low <= east) & (high >= west)
            touched = np.concatenate([samples, y[here].ravel()])
            rows = np.unique(touched[(touched >= samples[0]) & (touched <= samples[-1])])
            mine = vertices[(column >= west) & (column < east)]
            start = np.searchsorted(corners.y[mine], np.append(rows, rows[-1] + 1))
            left, right = max(west - 1, self.west), min(east + 2, self.east)
            window = np.ascontiguousarray(ground.heights[:, left - self.west : right - self.west])
            yield (
                ground._replace(heights=window, west=left),
                Block(self.first, self.last, west, east, rows, mine, start, members[here], interpolating),
            )


def bands(mesh: Mesh, terrain: Terrain, camera: Camera | None) -> Iterator[Band]:
    """The bands that need judging: with triangles, or ground in view (without a camera: any ground)."""
    rows, cols = terrain.grid.shape
    reached = tiles_in_view(terrain, camera)
    corners = mesh.corners
    for number, first in enumerate(range(0, rows, mesh.size)):
        members = mesh.members[mesh.start[number] : mesh.start[number + 1]]
        seen = np.flatnonzero(reached[min(first // TILE, len(reached) - 1)])
        west, east = cols, 0
        if len(members):
            at = corners.x[corners.triangles[members]] >> corners.shift
            west, east = int(at.min()) - 1, int(at.max()) + 2
        if len(seen):
            west, east = min(west, int(seen[0]) * TILE - 1), max(east, (int(seen[-1]) + 1) * TILE + 2)
        if west < east:
            yield Band(first, min(first + mesh.size, rows) - 1, max(west, 0), min(east, cols), members)


def tiles_in_view(terrain: Terrain, camera: Camera | None) -> NDArray[np.bool_]:
    """Which tiles of level 0 hold samples that may be in view (without a camera: any samples)."""
    table = terrain.tiles(0)
    if camera is None:
        return np.asarray(table.valid > 0)
    i, j = np.indices(table.valid.shape) * TILE
    low = np.stack([j, i, table.minimum], -1).astype(np.float64)
    high = np.stack([j + TILE, i + TILE, table.maximum], -1).astype(np.float64)
    return np.asarray((table.valid > 0) & ~camera.misses(low, high))
