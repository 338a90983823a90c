"""The referee: one tessellation, one terrain, one view → a ``Report``.

It shares no code with what it judges, and takes nothing on trust but the terrain's samples, the view, and the boxes of
the terrain's tiles (of tiles out of view nothing is read). What it measures and how is told in docs/verify.md; the work
is done by the sweep in ``sweep.py``, band by band, and on the open edges (``edges.py``).
"""

from __future__ import annotations

import math
from functools import partial

import numpy as np
from numpy.typing import NDArray

from orograph.errors import UsageError
from orograph.parallel import aside, map_ordered
from orograph.store.terrain import Terrain
from orograph.tessellation import Tessellation
from orograph.verify import sweep as kernels
from orograph.verify.bands import Band, Mesh, bands, take_apart
from orograph.verify.beyond import OF_HIDDEN, OF_MISSING, OF_SEEN, look_beyond
from orograph.verify.edges import classify_edges, lie_on_others
from orograph.verify.frustum import Camera
from orograph.verify.report import Report, Sample
from orograph.viewpoint import View

Found = tuple[NDArray[np.int64], NDArray[np.int64], float, int, int, float]

COUNTED = {
    "uncovered": kernels.UNCOVERED, "holes": kernels.HOLES, "bridged": kernels.BRIDGED,
    "duplicates": kernels.DUPLICATES, "wrong_heights": kernels.WRONG_HEIGHTS,
}  # fmt: skip


def judge(
    tessellation: Tessellation, terrain: Terrain, view: View, *, exaggeration: float = 1.0, jobs: int | None = None
) -> Report:
    """Measure a tessellation against every full-resolution sample in view, and look for every kind of defect.

    Args:
        tessellation: the mesh.
        terrain: what it is a mesh of; read by bands of rows.
        view: the camera, in the terrain's CRS.
        exaggeration: heights are stretched by this on the way to the screen.
        jobs: threads; the result does not depend on it.

    Raises:
        UsageError: a vertex is no sample of the terrain, the exaggeration is not positive, or the terrain has more than
            2^20 samples along a side.
        DamagedChunkError: as ``terrain.read``.
    """
    if not (math.isfinite(exaggeration) and exaggeration > 0):
        raise UsageError(f"An exaggeration is a positive number, not {exaggeration}.")
    return aside(partial(_judge, tessellation, terrain, view, exaggeration, jobs))


def _judge(tessellation: Tessellation, terrain: Terrain, view: View, exaggeration: float, jobs: int | None) -> Report:
    mesh = take_apart(tessellation, terrain)
    camera = Camera.of(view, terrain.grid, exaggeration)
    crowded, alone = classify_edges(tessellation.triangles, len(tessellation.vertices))
    alone = alone[mesh.signs[alone // 3] != 0]
    edges = open_edges(mesh, alone)
    low, high = np.minimum(edges[:, 1], edges[:, 3]), np.maximum(edges[:, 1], edges[:, 3])
    findings = np.zeros((len(edges), 3), np.uint8)
    junctions = np.zeros(len(tessellation.vertices), np.uint8)
    overlapping = np.zeros(len(tessellation.triangles), np.uint8)
    rows, cols = terrain.grid.shape

    def judge_band(band: Band) -> Found:
        heights, top = band.read(terrain)
        span = np.array([band.first, band.last])
        beside = np.flatnonzero((low <= band.last + 1) & (high >= band.first))
        look_beyond(heights, top, band.west, rows, cols, span, edges, beside, camera.matrix, camera.lens, findings)
        found: Found = kernels.sweep(
            heights, top, band.west, rows, span, tessellation.triangles, band.members, tessellation.vertices,
            mesh.columns, mesh.rows, mesh.row_start, mesh.by_row, camera.matrix, camera.lens, junctions, overlapping,
        )  # fmt: skip
        return found

    counts = np.zeros(kernels.COUNTS, np.int64)
    places: dict[str, Sample] = {}
    largest, worst, total = -1.0, None, 0.0
    for here, where, error, column, row, squares in map_ordered(judge_band, bands(mesh, terrain, camera), jobs):
        for name, k in COUNTED.items():
            if here[k] and name not in places:
                places[name] = int(where[k, 0]), int(where[k, 1])
        counts += here
        total += squares
        if error > largest:
            largest, worst = error, (int(column), int(row))
    inner = lie_on_others(edges[:, :4]) | (findings[:, OF_SEEN] > 0)
    hidden = ~inner & (findings[:, OF_HIDDEN] > 0)
    missing = ~inner & ~hidden & (findings[:, OF_MISSING] > 0)

    def first(name: str, flags: NDArray[np.bool_], vertex: NDArray[np.integer]) -> int:
        """Note where the first of some flags is, and count them."""
        if flags.any():
            v = int(vertex[np.argmax(flags)])
            places[name] = int(mesh.columns[v]), int(mesh.rows[v])
        return int(np.count_nonzero(flags))

    corner, begins = tessellation.triangles[:, 0], tessellation.triangles.reshape(-1)
    covered = int(counts[kernels.SAMPLES] - counts[kernels.UNCOVERED])
    return Report(
        triangles=len(tessellation.triangles),
        vertices=len(tessellation.vertices),
        samples=int(counts[kernels.SAMPLES]),
        largest=math.sqrt(largest) if covered else 0.0,
        rms=math.sqrt(total / covered) if covered else 0.0,
        worst=worst if covered else None,
        **{name: int(counts[k]) for name, k in COUNTED.items()},
        t_junctions=first("t_junctions", junctions > 0, np.arange(len(junctions))),
        overlaps=first("overlaps", overlapping > 0, corner),
        crowded=first("crowded", np.ones(len(crowded), bool), begins[crowded]),
        reversed=first("reversed", mesh.signs < 0, corner),
        flat=first("flat", mesh.signs == 0, corner),
        inner=first("inner", inner, begins[alone]),
        border=int(np.count_nonzero(~(inner | hidden | missing))),
        rim_of_missing=int(np.count_nonzero(missing)),
        rim_of_culled=int(np.count_nonzero(hidden)),
        places=places,
    )


def open_edges(mesh: Mesh, alone: NDArray[np.int64]) -> NDArray[np.int64]:
    """Edges, 3·triangle + corner → (n, 5): columns and rows of both ends, and which side is beyond the triangle.

    The last number is the sign of (end − begin) × (p − begin) for points p on the other side than the triangle.
    """
    triangles = mesh.tessellation.triangles
    t, k = alone // 3, alone % 3
    a, b, c = (triangles[t, (k + i) % 3] for i in range(3))
    x, y = mesh.columns, mesh.rows
    side = (x[b] - x[a]) * (y[c] - y[a]) - (y[b] - y[a]) * (x[c] - x[a])
    return np.ascontiguousarray(np.stack([x[a], y[a], x[b], y[b], -np.sign(side)], -1))
