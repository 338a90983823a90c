"""The referee of meshes: one tessellation, one terrain, one view → a ``Report``.

It shares no code with what it judges, and trusts only the terrain's samples, the view, and the boxes of the terrain's
tiles (tiles out of view are not read). docs/verify.md explains what it measures and how. The work is in the sweep
(``sweep.py``), between samples in ``pieces.py``, and on the open edges in ``beyond.py``.
"""

from __future__ import annotations

import math
from functools import partial
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from orograph.errors import UsageError
from orograph.parallel import aside, map_ordered
from orograph.store.terrain import Terrain
from orograph.tessellation import Tessellation
from orograph.verify import sweep as kernels
from orograph.verify.bands import Band, Mesh, bands, take_apart
from orograph.verify.beyond import OF_HIDDEN, OF_MISSING, OF_SEEN, OpenEdges, look_beyond
from orograph.verify.edges import classify_edges, lie_on_others
from orograph.verify.frustum import Camera
from orograph.verify.ground import Ground
from orograph.verify.pieces import Cells, Workspace, Worst, largest_on_pieces, survey_cells
from orograph.verify.report import Place, Report, place
from orograph.verify.spans import tabulate
from orograph.viewpoint import View

COUNTED = {
    "uncovered": kernels.UNCOVERED, "holes": kernels.HOLES, "bridged": kernels.BRIDGED,
    "duplicates": kernels.DUPLICATES, "wrong_heights": kernels.WRONG_HEIGHTS,
}  # fmt: skip


def judge_mesh(
    tessellation: Tessellation, terrain: Terrain, view: View, *, exaggeration: float = 1.0,
    heights: Literal["samples", "free"] | None = None, jobs: int | None = None,
) -> Report:  # fmt: skip
    """Measure a tessellation against the full-resolution surface in view, and look for every kind of defect.

    Args:
        tessellation: the mesh; its vertices may lie anywhere on the raster. If ``stats["truth"]`` is "points", it is
            measured against the Delaunay surface of the terrain's points instead (``verify.points``).
        terrain: of the mesh; read by bands of rows.
        view: the camera, in the terrain's CRS.
        exaggeration: heights are stretched by this on the way to the screen.
        heights: "samples": a vertex on a sample must have the sample's height; "free": it need not. By default "free"
            for geomorphs (``stats["geomorph"]``), "samples" otherwise.
        jobs: threads; the result does not depend on it.

    Raises:
        UsageError: a vertex lies beyond the raster, or at too fine a fraction of a cell (2^-18 is fine enough for
            rasters of up to 4097 samples a side, 2^-10 for 2^20); the raster is larger than 2^30 samples a side; the
            exaggeration is not positive.
        DamagedChunkError: as ``terrain.read``.
    """
    check_exaggeration(exaggeration)
    of_points = tessellation.stats.get("truth") == "points"
    if heights is None:
        heights = "free" if tessellation.stats.get("geomorph") or of_points else "samples"
    camera = Camera.of(view, terrain.grid, exaggeration)
    report = aside(partial(_judge, tessellation, terrain, camera, heights == "samples", jobs))
    if of_points:
        from orograph.verify.points import against_points

        return against_points(report, tessellation, terrain, view, exaggeration)
    return report


def check_exaggeration(exaggeration: float) -> None:
    """Raise UsageError unless it is a valid exaggeration."""
    if not (math.isfinite(exaggeration) and exaggeration > 0):
        raise UsageError(f"The exaggeration must be a positive number, not {exaggeration}.")


def _judge(
    tessellation: Tessellation, terrain: Terrain, camera: Camera, interpolating: bool, jobs: int | None
) -> Report:
    mesh = take_apart(tessellation, terrain)
    crowded, alone = classify_edges(tessellation.triangles, len(tessellation.vertices))
    alone = alone[mesh.signs[alone // 3] != 0]
    edges = open_edges(mesh, alone)
    ends, shift = edges
    low, high = np.minimum(ends[:, 1], ends[:, 3]) >> shift, np.maximum(ends[:, 1], ends[:, 3]) >> shift
    findings = np.zeros((len(ends), 3), np.uint8)
    junctions = np.zeros(len(tessellation.vertices), np.uint8)
    overlapping = np.zeros(len(tessellation.triangles), np.uint8)

    def judge_band(band: Band) -> list[_Part]:
        ground = band.read(terrain)
        beside = np.flatnonzero((low <= band.last + 1) & (high >= band.first))
        look_beyond(ground, band.first, band.last, edges, beside, camera.lens, *np.empty((2, 16, 3)), findings)
        screens = spare.pop() if spare else Screens()
        parts = [
            judge_block(window, mesh, block, camera, screens, junctions, overlapping)
            for window, block in band.blocks(mesh, ground, interpolating)
        ]
        spare.append(screens)
        return parts

    spare: list[Screens] = []
    total = _Total(mesh)
    for parts in map_ordered(judge_band, bands(mesh, terrain, camera), jobs):
        for part in parts:
            total.add(part)
    inner = lie_on_others(ends[:, :4]) | (findings[:, OF_SEEN] > 0)
    hidden = ~inner & (findings[:, OF_HIDDEN] > 0)
    missing = ~inner & ~hidden & (findings[:, OF_MISSING] > 0)
    places = total.places

    def first(name: str, flags: NDArray[np.bool_], vertex: NDArray[np.integer]) -> int:
        """Record where the first of some flags is, and count them."""
        if flags.any():
            v = int(vertex[np.argmax(flags)])
            places[name] = mesh.place(int(mesh.corners.x[v]), int(mesh.corners.y[v]))
        return int(np.count_nonzero(flags))

    corner, begins = tessellation.triangles[:, 0], tessellation.triangles.reshape(-1)
    return Report(
        triangles=len(tessellation.triangles),
        vertices=len(tessellation.vertices),
        **total.figures(),
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


_Part = tuple[kernels.Found, Worst]


class Screens:
    """Memory for one ``Screen`` after the other: allocating each would take a fifth of the time."""

    def __init__(self) -> None:
        self._floats = np.empty(0)
        self._codes = np.empty(0, np.uint8)

    def take(self, rows: int, columns: int) -> kernels.Screen:
        """An empty screen. Invalidates the one before."""
        size = rows * columns
        if len(self._codes) < size:
            self._floats, self._codes = np.empty(3 * size), np.empty(size, np.uint8)
        codes = self._codes[:size].reshape(rows, columns)
        codes[:] = kernels.MISSING
        return kernels.Screen(codes, *self._floats[: 3 * size].reshape(3, rows, columns))


def judge_block(
    window: Ground, mesh: Mesh, block: kernels.Block, camera: Camera, screens: Screens,
    junctions: NDArray[np.uint8], overlapping: NDArray[np.uint8],
) -> _Part:  # fmt: skip
    """Judge a block: the findings of the sweep, and the largest error on its pieces (if it exceeds the samples')."""
    screen = screens.take(block.last - block.first + 2, window.heights.shape[1])
    count, found = len(block.members), kernels.Found.nothing()
    memory = kernels.Memory.of(count, window.heights.shape[1])
    table, planes = np.empty((count, 7), np.int64), np.empty((count, 5))
    tabulate(mesh.corners, block.members, table, planes)
    kernels.sweep(
        window, mesh.corners, block, table, planes, camera.lens, screen, memory, found, junctions, overlapping
    )
    worst = Worst(np.maximum(found.pixels[:1], 0.0), found.sample.astype(np.float64))
    if camera.lens.p1 > 0:  # in a plan there is no error
        cells = Cells.of(screen)
        if survey_cells(window, block, camera.lens, screen, cells, worst.pixels[0]):
            work = Workspace.empty()
            largest_on_pieces(window, block, mesh.corners.shift, table, planes, camera.lens, cells, work, worst)
    return found, worst


class _Total:
    """The findings of the blocks, summed in order."""

    def __init__(self, mesh: Mesh) -> None:
        self.mesh = mesh
        self.counts = np.zeros(kernels.COUNTS, np.int64)
        self.places: dict[str, Place] = {}
        self.squares = 0.0
        self.at_samples: tuple[float, Place | None] = -1.0, None
        self.largest: tuple[float, Place | None] = 0.0, None

    def add(self, part: _Part) -> None:
        found, worst = part
        for name, k in COUNTED.items():
            if found.counts[k] and name not in self.places:
                self.places[name] = self.mesh.place(*found.places[k])
        self.counts += found.counts
        self.squares += float(found.pixels[1])
        if found.pixels[0] > self.at_samples[0]:
            self.at_samples = float(found.pixels[0]), place(*found.sample)
        if worst.pixels[0] > self.largest[0]:
            self.largest = float(worst.pixels[0]), place(*worst.place)

    def figures(self) -> dict[str, Any]:
        """The numbers of a report that are sums."""
        samples, counts = int(self.counts[kernels.SAMPLES]), {name: int(self.counts[k]) for name, k in COUNTED.items()}
        covered = samples - counts["uncovered"]
        at_samples, worst_sample = self.at_samples if covered else (0.0, None)
        largest, worst = self.largest if self.largest[0] > at_samples else (at_samples, worst_sample)
        return {
            "samples": samples, "largest": largest, "worst": worst, "largest_at_samples": at_samples,
            "worst_sample": worst_sample, "rms": math.sqrt(self.squares / covered) if covered else 0.0, **counts,
        }  # fmt: skip


def open_edges(mesh: Mesh, alone: NDArray[np.int64]) -> OpenEdges:
    """Open edges, given as 3·triangle + corner."""
    triangles, x, y = mesh.corners.triangles, mesh.corners.x, mesh.corners.y
    t, k = alone // 3, alone % 3
    a, b, c = (triangles[t, (k + i) % 3] for i in range(3))
    side = (x[b] - x[a]) * (y[c] - y[a]) - (y[b] - y[a]) * (x[c] - x[a])
    ends = np.stack([x[a], y[a], x[b], y[b], -np.sign(side)], -1)
    return OpenEdges(np.ascontiguousarray(ends), mesh.corners.shift)
