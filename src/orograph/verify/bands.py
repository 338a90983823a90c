"""The bands of rows in which a terrain is judged, and what of it has to be read for each.

A band lies within one row of tiles. Of its columns those are read that its triangles reach, and the tiles whose box
(lowest to highest sample, from the terrain's own tables) reaches into the view: nothing else is in view, and nothing
else is covered.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orograph.errors import UsageError
from orograph.store.terrain import TILE, Heights, Terrain
from orograph.tessellation import Tessellation, turn
from orograph.verify.edges import survey
from orograph.verify.frustum import Camera
from orograph.verify.spans import bucket
from orograph.verify.strips import LONGEST

Ints = NDArray[np.int64]
Flags = NDArray[np.uint8]

BAND_BYTES = 1 << 25
"""About how much of a very wide terrain is read at once."""


@dataclass(frozen=True, slots=True)
class Mesh:
    """A tessellation taken apart for the referee.

    Attributes:
        tessellation: as it came.
        columns, rows: (n,) int64 of the vertices.
        signs: (m,) int8: 1 for triangles that turn as they should, −1 for reversed ones, 0 without area.
        used: (n,) uint8, 1 for vertices of triangles with area.
        row_start, by_row: the used vertices by row: row r's are by_row[row_start[r]:row_start[r + 1]].
        size: rows in a band.
        start, members: the triangles that touch each band, or the row below it.
    """

    tessellation: Tessellation
    columns: Ints
    rows: Ints
    signs: NDArray[np.int8]
    used: Flags
    row_start: Ints
    by_row: Ints
    size: int
    start: Ints
    members: Ints


def take_apart(tessellation: Tessellation, terrain: Terrain) -> Mesh:
    """Prepare a tessellation of a terrain.

    Raises:
        UsageError: a vertex is no sample of the terrain, or the terrain is too large for exact arithmetic.
    """
    rows, cols = terrain.grid.shape
    if max(rows, cols) > LONGEST:
        raise UsageError(f"The referee judges terrains of up to {LONGEST:,} samples a side, not {rows:,} × {cols:,}.")
    position = tessellation.vertices[:, :2]
    whole = position.astype(np.int64) if np.isfinite(position).all() else np.full(position.shape, -1)
    column, row = np.ascontiguousarray(whole[:, 0]), np.ascontiguousarray(whole[:, 1])
    outside = (whole != position).any(-1) | (whole < 0).any(-1) | (column >= cols) | (row >= rows)
    if outside.any():
        first = int(np.argmax(outside))
        raise UsageError(
            f"Vertex {first} of the tessellation, at column {position[first, 0]:g} and row {position[first, 1]:g}, is "
            f"no sample of the {rows} × {cols} of {terrain.name!r}, so its mesh cannot be judged."
        )
    signs, used = survey(tessellation.triangles, column, row, turn(terrain.grid))
    size = TILE
    while size > 16 and 4 * size * cols > BAND_BYTES:
        size //= 2
    bands = -(-rows // size)
    start, members = bucket(tessellation.triangles, column, row, signs, size, bands)
    of_use = np.flatnonzero(used)
    by_row = of_use[np.argsort(row[of_use], kind="stable")]
    row_start = np.searchsorted(row[by_row], np.arange(rows + 1))
    return Mesh(tessellation, column, row, signs, used, row_start, by_row, size, start, members)


@dataclass(frozen=True, slots=True)
class Band:
    """Rows first to last, both included, the columns [west, east) to read for them, and the triangles there."""

    first: int
    last: int
    west: int
    east: int
    members: Ints

    def read(self, terrain: Terrain) -> tuple[Heights, int]:
        """The samples of the band and of the rows beside it, and the row they begin with."""
        top, bottom = max(self.first - 1, 0), min(self.last + 2, terrain.grid.rows)
        return np.ascontiguousarray(terrain.read(0, top, bottom, self.west, self.east)), top


def bands(mesh: Mesh, terrain: Terrain, camera: Camera | None) -> Iterator[Band]:
    """The bands with something to judge: triangles, or ground in view (without a camera: any ground)."""
    rows, cols = terrain.grid.shape
    reached = tiles_in_view(terrain, camera)
    triangles = mesh.tessellation.triangles
    for number, first in enumerate(range(0, rows, mesh.size)):
        members = mesh.members[mesh.start[number] : mesh.start[number + 1]]
        seen = np.flatnonzero(reached[min(first // TILE, len(reached) - 1)])
        west, east = cols, 0
        if len(members):
            at = mesh.columns[triangles[members]]
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
