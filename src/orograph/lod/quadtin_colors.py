"""How much a QuadTIN's triangles change colours: for every vertex, what the triangles that it splits would be off.

As for the diamonds of the regular hierarchy (``geovis.color_errors``): with eL, ea, eb the largest differences of the
three channels of CIELAB between the samples in the two triangles and the colours interpolated between their corners, no
sample's colour is off by more than sqrt(eL² + ea² + eb²); then errors are made no less than those of the vertices that
depend on them. Corners that lie between samples have colours interpolated between these. Samples; ΔE*ab.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from orograph._numba import kernel
from orograph.lod.quadtin_tree import Hierarchy

ROWS = 256
"""Rows of samples whose colours are looked at at once."""

Window = Callable[[int, int, int, int], NDArray[np.float32]]
"""Colours (rows, cols, 3) of the samples from row to row and column to column, NaN where there is none."""


@kernel
def colors_at(vertices, lab, row0, rows, out):
    """Write the colours (v, 3) of the vertices over a band of samples, ``rows`` of them its own and one below."""
    high, wide, _ = lab.shape
    for v in range(len(vertices)):
        x, y = vertices[v, 0], vertices[v, 1] - row0
        if not 0.0 <= y < rows:
            continue
        i, j = min(np.int64(y), high - 1), min(np.int64(x), wide - 1)
        n, m = min(i + 1, high - 1), min(j + 1, wide - 1)
        u, w = x - j, y - i
        for k in range(3):
            whole, found = 0.0, 0.0
            for share, one in (
                ((1 - u) * (1 - w), lab[i, j, k]), (u * (1 - w), lab[i, m, k]),
                ((1 - u) * w, lab[n, j, k]), (u * w, lab[n, m, k]),
            ):  # fmt: skip
                if share > 0.0 and not np.isnan(one):
                    whole += share
                    found += share * one
            out[v, k] = found / whole if whole > 0.0 else np.nan


@kernel
def channels(p, owner, corners, colors, lab, row0, out):
    """Raise the largest differences (v, 3) of channels, of what owns triangles, by a band of samples."""
    rows, cols, _ = lab.shape
    for t in range(len(owner)):
        v = owner[t]
        if v < 0:
            continue
        a, b, c = corners[t, 0], corners[t, 1], corners[t, 2]
        north, south = min(p[a, 1], min(p[b, 1], p[c, 1])) - row0, max(p[a, 1], max(p[b, 1], p[c, 1])) - row0
        west, east = min(p[a, 0], min(p[b, 0], p[c, 0])), max(p[a, 0], max(p[b, 0], p[c, 0]))
        dx, dy, ex, ey = p[b, 0] - p[a, 0], p[b, 1] - p[a, 1], p[c, 0] - p[a, 0], p[c, 1] - p[a, 1]
        area = dx * ey - dy * ex
        first, last = np.int64(np.ceil(max(north, 0.0))), np.int64(np.floor(min(south, rows - 1.0)))
        left, right = np.int64(np.ceil(max(west, 0.0))), np.int64(np.floor(min(east, cols - 1.0)))
        for i in range(first, last + 1):
            y = i + row0 - p[a, 1]
            for j in range(left, right + 1):
                x = j - p[a, 0]
                s, r = (x * ey - y * ex) / area, (dx * y - dy * x) / area
                if s < -1e-9 or r < -1e-9 or s + r > 1.0 + 1e-9 or np.isnan(lab[i, j, 0]):
                    continue
                for k in range(3):
                    between = colors[a, k] + s * (colors[b, k] - colors[a, k]) + r * (colors[c, k] - colors[a, k])
                    off = abs(between - lab[i, j, k])
                    if off > out[v, k]:
                        out[v, k] = off


@kernel
def saturate(parents, errors):
    """Make errors no less than those of the vertices that depend on them."""
    changed = True
    while changed:
        changed = False
        for v in range(len(errors) - 1, -1, -1):
            for k in range(2):
                if errors[parents[v, k]] < errors[v]:
                    errors[parents[v, k]] = errors[v]
                    changed = True


def largest_changes(
    vertices: NDArray[np.float64], owner: NDArray[np.int32], corners: NDArray[np.int32], owners: int,
    shape: tuple[int, int], window: Window,
) -> NDArray[np.float32]:  # fmt: skip
    """How far off the colours of triangles are, for all that belong together: (owners,) ΔE.

    Args:
        vertices: (v, 3) column, row and height. owner: (t,), of each triangle; negative: it does not count.
        corners: (t, 3) of these. shape: of the samples. window: of their colours.
    """
    rows, cols = shape
    colors = np.full((len(vertices), 3), np.nan)
    for row in range(0, rows, ROWS):
        own = min(ROWS, rows - row)
        colors_at(vertices, window(row, min(row + own + 1, rows), 0, cols), row, own, colors)
    off = np.zeros((owners, 3))
    for row in range(0, rows, ROWS):
        channels(vertices, owner, corners, colors, window(row, min(row + ROWS, rows), 0, cols), row, off)
    found: NDArray[np.float32] = np.sqrt(np.square(off).sum(1)).astype(np.float32)
    return found


def color_errors(tree: Hierarchy, shape: tuple[int, int], window: Window) -> NDArray[np.float32]:
    """Color errors (v,) of a hierarchy's vertices, ΔE.

    Args:
        tree: all of it. shape: of the raster. window: of its samples' colours.
    """
    found = largest_changes(tree.vertices, tree.node, tree.corners, len(tree.vertices), shape, window)
    saturate(tree.parents, found)
    return found
