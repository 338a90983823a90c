"""Missing data that the ground encloses: a smooth patch over each hole, so that a picture can show it as missing.

The surface itself has holes there and everything measured sees through them. A picture that did so too would show sky
inside a mountain; so a patch is drawn in a colour that no ground has. Regions that reach the raster's border are no
holes: there the terrain just ends. The patch is the membrane that hangs on the hole's rim (Laplace's equation), begun
from a push-pull pyramid (Gortler et al. 1996, *The lumigraph*, §3.4) and relaxed. Heights are metres.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph._numba import kernel
from orograph.raycast.stack import HeightWindow

Heights = NDArray[np.float32]
Flags = NDArray[np.bool_]

RELAXATIONS = 40


@kernel
def _spread(missing, outside):
    """Extend ``outside`` over all samples of ``missing`` connected (by sides or corners) to it."""
    rows, cols = missing.shape
    stack = np.empty(rows * cols, np.int64)
    size = 0
    for r in range(rows):
        for c in range(cols):
            if outside[r, c]:
                stack[size] = r * cols + c
                size += 1
    while size > 0:
        size -= 1
        r, c = stack[size] // cols, stack[size] % cols
        for i in range(max(r - 1, 0), min(r + 2, rows)):
            for j in range(max(c - 1, 0), min(c + 2, cols)):
                if missing[i, j] and not outside[i, j]:
                    outside[i, j] = True
                    stack[size] = i * cols + j
                    size += 1


@kernel
def _relax(heights, holes, count):
    """Gauss-Seidel steps of Laplace's equation on ``holes``; neighbours without height are left out."""
    rows, cols = heights.shape
    for _ in range(count):
        for r in range(rows):
            for c in range(cols):
                if holes[r, c]:
                    total, n = 0.0, 0
                    for i, j in ((r - 1, c), (r + 1, c), (r, c - 1), (r, c + 1)):
                        if 0 <= i < rows and 0 <= j < cols and heights[i, j] == heights[i, j]:
                            total += heights[i, j]
                            n += 1
                    if n > 0:
                        heights[r, c] = total / n


def enclosed(heights: Heights, outside: Flags) -> Flags:
    """Missing samples that are not connected to ``outside``, missing samples known to lie beyond the terrain."""
    missing = np.isnan(heights)
    beyond = outside & missing
    _spread(missing, beyond)
    return missing & ~beyond


def fill(heights: Heights, holes: Flags) -> Heights:
    """Heights with ``holes`` filled by a membrane; what else is missing stays so."""
    known = np.isfinite(heights)
    values, weights = [np.where(known, heights, 0).astype(np.float32)], [known.astype(np.float32)]
    while max(values[-1].shape) > 1:  # pull: averages of what is known, to ever larger blocks
        v, w = (_halved(a) for a in (values[-1] * weights[-1], weights[-1]))
        values.append(np.where(w > 0, v / np.maximum(w, 1e-30), 0).astype(np.float32))
        weights.append(np.minimum(w, 1))
    for k in range(len(values) - 2, -1, -1):  # push: gaps take the coarser value
        rows, cols = values[k].shape
        coarse = values[k + 1].repeat(2, 0).repeat(2, 1)[:rows, :cols]
        values[k] = np.where(weights[k] > 0, values[k], coarse)
    out = np.where(holes, values[0], heights).astype(np.float32)
    _relax(out, holes, RELAXATIONS)
    return out


def _halved(a: NDArray[np.float32]) -> NDArray[np.float32]:
    rows, cols = a.shape
    a = np.pad(a, ((0, rows % 2), (0, cols % 2)))
    return np.asarray(a[::2, ::2] + a[1::2, ::2] + a[::2, 1::2] + a[1::2, 1::2])


@dataclass(frozen=True, slots=True)
class _Known:
    """What the window around says about the next finer one's edges."""

    window: HeightWindow
    outside: Flags


def patches(windows: tuple[HeightWindow, ...], shape: tuple[int, int]) -> list[HeightWindow] | None:
    """Windows like ``windows`` (outermost first) that hold only patches over holes and the samples of their rims.

    Args:
        shape: (rows, cols) of the terrain at full resolution, whose border decides what is enclosed.

    Returns:
        None if nothing is enclosed.
    """
    found: list[HeightWindow] = []
    around: _Known | None = None
    some = False
    for w in windows:
        missing = np.isnan(w.heights)
        outside = np.zeros(missing.shape, bool)
        if missing.any():
            rows, cols = missing.shape
            scale = 2**w.level
            edges = (
                (np.s_[0, :], w.row0 == 0),
                (np.s_[-1, :], (w.row0 + rows - 1) * scale >= shape[0] - 1),
                (np.s_[:, 0], w.col0 == 0),
                (np.s_[:, -1], (w.col0 + cols - 1) * scale >= shape[1] - 1),
            )
            for edge, is_border in edges:
                outside[edge] = True if is_border or around is None else _from_around(around, w, edge)
        holes = enclosed(w.heights, outside)
        some = some or bool(holes.any())
        around = _Known(w, missing & ~holes)
        rim = holes.copy()
        for axis in (0, 1):
            grown = rim.copy()
            a, b = [slice(None)] * 2, [slice(None)] * 2
            a[axis], b[axis] = slice(1, None), slice(None, -1)
            grown[tuple(a)] |= rim[tuple(b)]
            grown[tuple(b)] |= rim[tuple(a)]
            rim = grown
        patch = np.full(w.heights.shape, np.nan, np.float32)
        if holes.any():
            patch = np.where(rim, fill(w.heights, holes), patch)
        found.append(HeightWindow(w.level, w.col0, w.row0, patch))
    return found if some else None


def _from_around(around: _Known, w: HeightWindow, edge: Any) -> Flags:
    """Whether the samples on an edge of ``w`` lie outside, looked up in the window around it."""
    shape, coarse = w.heights.shape, around.outside.shape
    rows = np.broadcast_to(np.arange(shape[0])[:, None], shape)[edge] + w.row0
    cols = np.broadcast_to(np.arange(shape[1])[None, :], shape)[edge] + w.col0
    k = 2 ** (around.window.level - w.level)
    i = np.clip(rows // k - around.window.row0, 0, coarse[0] - 1)
    j = np.clip(cols // k - around.window.col0, 0, coarse[1] - 1)
    return np.asarray(around.outside[i, j])
