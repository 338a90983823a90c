"""The mesh that a refinement would make if it knew every sample: what the bounds of a method cost in triangles.

Methods judge a diamond by an upper bound of what its two coarse triangles displace on the screen. The *oracle* looks:
it projects every full-resolution sample under the two triangles and takes the largest displacement of one in view. A
diamond is inaccurate if that exceeds the tolerance, or if it is mixed (part surface, part hole) and in view; it is
split if it or any descendant is inaccurate: the same closure over the diamond DAG, with the error itself in place of a
bound. A method's triangles over the oracle's are the price of its bounds (bench/promise.py; DESIGN's figure is 1.2).

Only diamonds that the conservative sphere metric splits are tested: the others hold no displacement beyond the
tolerance, nor do their descendants. Each of those is brute force, row by row, until the first sample that is too far
off; the diamond's own vertex comes first. The heights of the whole raster are held in memory. Metres, pixels.

>>> from orograph.lod.oracle import oracle
>>> fewest = len(oracle(terrain, view, 1.0).triangles)        # doctest: +SKIP
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph._numba import leaf
from orograph.error.screen import ANISOTROPIC, CameraParameters, camera_parameters, outside
from orograph.errors import UsageError
from orograph.hierarchy.kernels import diamonds
from orograph.lod.criterion import NOTHING, SPLIT, Criterion, first_bits, weigh
from orograph.lod.field import Field, Pages, find
from orograph.lod.localise import prism_outside, sample_exceeds
from orograph.parallel import map_ordered, threads_for
from orograph.store.terrain import Heights, Terrain
from orograph.tessellation import Tessellation
from orograph.viewpoint import Camera, View

CANDIDATE, ACTIVE = 1, 2
"""Marks of vertices: its diamond may be inaccurate; it is split."""


@leaf
def collect(pages, criterion, marks, found, begin, end, n):
    """Keep those of the diamonds ``found[begin:end]`` that may be inaccurate, and add their children behind ``end``.

    Args:
        pages: ``field.Pages``. criterion: ``Criterion``, that does not look ahead.
        marks: uint8 (2^n + 1, 2^n + 1).
        found: int64 (capacity, 2), rows and columns; the capacity must allow for four children each.

    Returns: the ends of what is kept, from ``begin`` on, and of the children, each of which is there once.
    """
    kept = begin
    last = end
    for at in range(begin, end):
        row, col = found[at, 0], found[at, 1]
        state, _, _ = weigh(pages, criterion, row << 32 | col, diamonds.octave(row, col), first_bits(criterion))
        if state != SPLIT:
            continue
        found[kept, 0], found[kept, 1] = row, col
        kept += 1
        for k in range(4):
            a, b = diamonds.child(row, col, k, n)
            if a >= 0 and marks[a, b] == 0:
                marks[a, b] = CANDIDATE
                found[last, 0], found[last, 1] = a, b
                last += 1
    return kept, last


@leaf
def triangle_too_far(camera, z, ar, ac, br, bc, cr, cc):
    """Whether a sample in view of a triangle with corners at samples (row, column) is displaced by more than the
    tolerance."""
    p1r, p1c, p2r, p2c = br - ar, bc - ac, cr - ar, cc - ac
    area = p1r * p2c - p1c * p2r
    if area == 0:
        return False
    az = np.float64(z[ar, ac])
    z1, z2 = np.float64(z[br, bc]) - az, np.float64(z[cr, cc]) - az
    down = (z1 * p2c - z2 * p1c) / area
    across = (z2 * p1r - z1 * p2r) / area
    for row in range(min(ar, min(br, cr)), max(ar, max(br, cr)) + 1):
        low = np.int64(1) << 60
        high = np.int64(-1)
        for edge in range(3):
            if edge == 0:
                r0, c0, r1, c1 = ar, ac, br, bc
            elif edge == 1:
                r0, c0, r1, c1 = br, bc, cr, cc
            else:
                r0, c0, r1, c1 = cr, cc, ar, ac
            if r0 > r1:
                r0, c0, r1, c1 = r1, c1, r0, c0
            if r0 < r1 and r0 <= row <= r1:
                step = (row - r0) * (c1 - c0)
                low = min(low, c0 - (-step) // (r1 - r0))
                high = max(high, c0 + step // (r1 - r0))
        base = az + down * (row - ar) - across * ac
        for col in range(low, high + 1):
            if sample_exceeds(
                camera, np.float64(col), np.float64(row), np.float64(z[row, col]), base + across * col, True
            ):
                return True
    return False


@leaf
def look(pages, camera, z, found, begin, end, n, inaccurate, accurate):
    """Look at the samples of the diamonds ``found[begin:end]``; 1 in ``inaccurate`` (the same places) where too far.

    Args:
        accurate: uint8 (2^n + 1, 2^n + 1), 1 where a diamond is known to be accurate; what is found is added.
    """
    last_row, last_col = pages.edge[0], pages.edge[1]
    for at in range(begin, end):
        row, col = found[at, 0], found[at, 1]
        if accurate[row, col]:
            continue
        slot, i, j = find(pages, row, col, diamonds.octave(row, col))
        if pages.data[slot, i, j, 1] == np.inf:
            inaccurate[at] = 1
            continue
        r0, c0 = diamonds.end(row, col, 0)
        r1, c1 = diamonds.end(row, col, 1)
        r0, c0, r1, c1 = min(r0, last_row), min(c0, last_col), min(r1, last_row), min(c1, last_col)
        inside = row < last_row and col < last_col
        inside = inside and r0 + r1 == 2 * row and c0 + c1 == 2 * col
        middle = 0.5 * (np.float64(z[r0, c0]) + np.float64(z[r1, c1]))
        if inside and sample_exceeds(
            camera,
            np.float64(col),
            np.float64(row),
            np.float64(z[row, col]),
            middle,
            True,
        ):
            inaccurate[at] = 1
            continue
        for k in range(2):
            a, b = diamonds.apex(row, col, k)
            if a < 0 or b < 0 or a > 1 << n or b > 1 << n:
                continue
            if triangle_too_far(camera, z, r0, c0, r1, c1, min(a, last_row), min(b, last_col)):
                inaccurate[at] = 1
                break
        accurate[row, col] = 1 - inaccurate[at]


@leaf
def close(marks, found, inaccurate, count, n):
    """Mark the inaccurate diamonds and all their ancestors, which stand before them in ``found``; returns how many."""
    active = 0
    for at in range(count - 1, -1, -1):
        row, col = found[at, 0], found[at, 1]
        if inaccurate[at]:
            marks[row, col] = ACTIVE
        if marks[row, col] == ACTIVE:
            active += 1
            for k in range(2):
                a, b = diamonds.parent(row, col, k, n)
                if a >= 0:
                    marks[a, b] = ACTIVE
    return active


@leaf
def put_out(pages, camera, z, marks, prisms, leaf_level, stack, keys, zs):
    """Write the triangles of the closed marks that are in view, and return how many there are.

    Args:
        prisms: by corners and errors of triangles, else by nested spheres (a finest one goes with its diamond).
        stack: int64 (2n + 2, 4). keys: int64 (capacity, 3), zs: float32 (capacity, 3).
    """
    n = leaf_level >> 1
    size = np.int64(1) << n
    last_row, last_col = pages.edge[0], pages.edge[1]
    count = np.int64(0)
    se, ne, sw = size << 32 | size, size, size << 32
    stack[0, 0], stack[0, 1], stack[0, 2], stack[0, 3] = 0, se, ne, 0
    stack[1, 0], stack[1, 1], stack[1, 2], stack[1, 3] = se, 0, sw, 0
    top = 2
    while top > 0:
        top -= 1
        e, x, a, level = stack[top, 0], stack[top, 1], stack[top, 2], stack[top, 3]
        m = (e + x) >> 1
        if level < leaf_level and marks[m >> 32, m & 0xFFFFFFFF] == ACTIVE:
            stack[top, 0], stack[top, 1], stack[top, 2], stack[top, 3] = a, e, m, level + 1
            stack[top + 1, 0], stack[top + 1, 1], stack[top + 1, 2], stack[top + 1, 3] = x, a, m, level + 1
            top += 2
            continue
        er, ec = min(e >> 32, last_row), min(e & 0xFFFFFFFF, last_col)
        xr, xc = min(x >> 32, last_row), min(x & 0xFFFFFFFF, last_col)
        ar, ac = min(a >> 32, last_row), min(a & 0xFFFFFFFF, last_col)
        ez, xz, az = z[er, ec], z[xr, xc], z[ar, ac]
        if not (ez == ez and xz == xz and az == az):
            continue
        error = 0.0
        if level < leaf_level:
            slot, i, j = find(pages, m >> 32, m & 0xFFFFFFFF, n - 1 - (level >> 1))
            if slot < 0:
                continue
            error = np.float64(pages.data[slot, i, j, 1])
            r = np.float64(pages.data[slot, i, j, 2])
            if r < 0.0:
                continue
            row, col = min(m >> 32, last_row), min(m & 0xFFFFFFFF, last_col)
            out, _ = outside(camera, col, row, np.float64(pages.data[slot, i, j, 0]), r * camera.stretch, 0)
            if out:
                continue
        whole = max(e >> 32, max(x >> 32, a >> 32)) <= last_row
        whole = whole and max(e & 0xFFFFFFFF, max(x & 0xFFFFFFFF, a & 0xFFFFFFFF)) <= last_col
        if prisms and whole and prism_outside(camera, (er, ec, ez), (xr, xc, xz), (ar, ac, az), error):
            continue
        if count < len(keys):
            keys[count, 0], keys[count, 1], keys[count, 2] = e, x, a
            zs[count, 0], zs[count, 1], zs[count, 2] = ez, xz, az
        count += 1
    return count


def oracle(
    terrain: Terrain,
    view: View,
    tolerance: float,
    exaggeration: float = 1.0,
    *,
    prisms: bool = False,
    field: Field | None = None,
    jobs: int | None = None,
) -> Tessellation:
    """The coarsest closed mesh none of whose triangles has a sample in view that is off by more than the tolerance.

    Args:
        terrain: with ``exact`` errors; read whole.
        view: the camera, perspective.
        tolerance: pixels, more than 0.
        exaggeration: factor on heights on the way to the screen.
        prisms: leave out triangles that are out of view by their own corners (as top-down refinement does), instead of
            by their diamonds' nested spheres (as the other methods do).
        field: of the terrain, with ``exact`` errors and room for all it reads, to be used again.
        jobs: threads.

    Returns:
        the mesh; stats: tolerance, candidates (diamonds looked at), active (split), look_ms.

    Raises:
        UsageError: the tolerance or the view makes no sense here, or the field's memory does not suffice.
    """
    return next(oracles(terrain, view, (tolerance,), exaggeration, prisms=(prisms,), field=field, jobs=jobs))[0]


def oracles(
    terrain: Terrain,
    view: View,
    tolerances: Sequence[float],
    exaggeration: float = 1.0,
    *,
    prisms: Sequence[bool] = (False, True),
    field: Field | None = None,
    jobs: int | None = None,
) -> Iterator[list[Tessellation]]:
    """For each of several tolerances the meshes of ``oracle``, one for each of ``prisms``; cheaper than one by one.

    A diamond that is accurate for one tolerance is so for the next, so all its samples are tested only once.

    Args:
        tolerances: pixels, ascending. Others as for ``oracle``.
    """
    if not min(tolerances) > 0 or view.projection != "perspective":
        raise UsageError("The oracle needs a tolerance greater than 0 and a perspective view.")
    if list(tolerances) != sorted(tolerances):
        raise UsageError("The oracle takes tolerances in ascending order.")
    field = field or Field(terrain, max_memory=1 << 40)
    pages, n, (rows, cols) = field.pages, field.n, terrain.grid.shape
    z = terrain.read(0, 0, rows, 0, cols)
    accurate = np.zeros(((1 << n) + 1,) * 2, np.uint8)
    jobs = threads_for(jobs)
    for tolerance in tolerances:
        began = time.perf_counter()
        camera = camera_parameters(Camera.over(terrain.grid, view, exaggeration), tolerance=tolerance)
        while True:
            field.begin()
            marks, found, count = _candidates(field, camera)
            if not field.fetch():
                break
        inaccurate = np.zeros(count, np.uint8)
        step = max(1024, -(-count // (8 * jobs)))
        each = partial(_look_at, pages, camera, z, found, n, inaccurate, accurate, step)
        for _ in map_ordered(each, range(0, count, step), jobs):
            pass
        active = int(close(marks, found, inaccurate, count, n))
        stats = {
            "method": "oracle", "tolerance": tolerance, "exaggeration": exaggeration, "candidates": count,
            "active": active, "look_ms": round((time.perf_counter() - began) * 1e3, 3),
        }  # fmt: skip
        yield [_drawn(terrain, field, camera, z, marks, p, active, stats) for p in prisms]


def _look_at(
    pages: Pages,
    camera: CameraParameters,
    z: Heights,
    found: NDArray[np.int64],
    n: int,
    inaccurate: NDArray[np.uint8],
    accurate: NDArray[np.uint8],
    step: int,
    begin: int,
) -> None:
    look(pages, camera, z, found, begin, min(begin + step, len(inaccurate)), n, inaccurate, accurate)


def _drawn(
    terrain: Terrain,
    field: Field,
    camera: CameraParameters,
    z: Heights,
    marks: NDArray[np.uint8],
    prisms: bool,
    active: int,
    stats: dict[str, Any],
) -> Tessellation:
    """The mesh of closed marks."""
    n = field.n
    while True:
        field.begin()
        keys, zs = np.empty((2 * active + 2, 3), np.int64), np.empty((2 * active + 2, 3), np.float32)
        made = put_out(field.pages, camera, z, marks, prisms, 2 * n, np.empty((2 * n + 2, 4), np.int64), keys, zs)
        if not field.fetch():
            break
    result = Tessellation.from_triangles(terrain.grid, keys[:made], zs[:made], clockwise=False, stats=dict(stats))
    result.stats["triangles"] = len(result.triangles)
    return result


def _candidates(field: Field, camera: CameraParameters) -> tuple[NDArray[np.uint8], NDArray[np.int64], int]:
    """(marks, diamonds by level as rows and columns, how many): those the sphere metric splits."""
    n = field.n
    marks = np.zeros(((1 << n) + 1,) * 2, np.uint8)
    half = (1 << n) >> 1
    found = np.full((16, 2), half, np.int64)
    begin, end = 0, 1 if n else 0
    marks[half, half] = CANDIDATE if n else 0
    while begin < end:
        if len(found) < end + 4 * (end - begin):
            found = np.concatenate([found, np.empty((len(found) + 4 * (end - begin), 2), np.int64)])
        kept, last = collect(field.pages, Criterion(camera, ANISOTROPIC, True, NOTHING), marks, found, begin, end, n)
        # Children follow those that were kept.
        found[kept : kept + last - end] = found[end:last].copy()
        begin, end = kept, kept + last - end
    return marks, found, begin
