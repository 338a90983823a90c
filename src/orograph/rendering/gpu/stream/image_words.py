"""The data of layers for ``shaders/imagery.wgsl``, as words of one buffer.

Heads (one per layer, in drawing order), then for every layer its levels, its lattice of image positions
(whole pixels and remainders separately, so that single precision is enough) and its pages (``imagery``). Units:
pixels of the file, metres.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph._numba import kernel
from orograph.geovis.layers import MOST
from orograph.rendering.gpu.stream.image_tiles import ImageTiles
from orograph.viewpoint import View

Words = NDArray[np.uint32]

HEAD, HEADS = 24, 4
"""Words of a head, and the offset of the first one."""

STATIC = HEADS + MOST * HEAD
LEVEL = 8
"""Words of a level."""

HEAD_DTYPE = np.dtype(
    [
        ("across", "<f4", 2), ("down", "<f4", 2), ("cell", "<i4", 2), ("part", "<f4", 2), ("nodes", "<i4", 2),
        ("size", "<i4", 2), ("finest", "<u4"), ("coarsest", "<u4"), ("levels_at", "<u4"), ("lattice_at", "<u4"),
        ("pages_at", "<u4"), ("opacity", "<f4"), ("multiply", "<u4"), ("bounded", "<u4"), ("pad", "<u4", 4),
    ]
)  # fmt: skip
"""A head of ``shaders/imagery.wgsl``. across, down: the lattice's nodes per metre east and north; cell, part: the eye's
place in it; nodes: their number; size: the image's columns and rows; bounded: 1 if columns end, and 2 if rows do."""

THERE = np.uint32(1 << 31)
"""A page's bit that says: this is known (perhaps that nothing shows). Bits 24–28 are the level, those below 24
the slot + 1, 0 if nothing shows."""

SLOT = np.uint32((1 << 24) - 1)


def fixed(sheet: ImageTiles) -> int:
    """Words of a layer before its pages."""
    return LEVEL * len(sheet.levels) + 4 * sheet.laid.lattice.u.size


def level_words(sheet: ImageTiles) -> Words:
    """For every level: the place of its first tile, its first row and column of tiles, and their numbers."""
    out = np.zeros((len(sheet.levels), LEVEL), np.int32)
    for k, level in enumerate(sheet.levels):
        out[k, :5] = level.first, level.row0, level.col0, *level.shape
    return out.view(np.uint32).ravel()


def node_words(sheet: ImageTiles) -> Words:
    """Positions of the lattice's nodes: whole columns and rows of pixels, and the remainders; the least integer
    where there is none."""
    lattice = sheet.laid.lattice
    out = np.empty((lattice.u.size, 4), np.uint32)
    for k, values in enumerate((lattice.u.ravel(), lattice.v.ravel())):
        there = np.isfinite(values) & (np.abs(values) < 2**30)
        whole = np.floor(np.where(there, values, 0.0))
        out[:, k] = np.where(there, whole, -(2.0**31)).astype(np.int64).astype(np.int32).view(np.uint32)
        out[:, 2 + k] = np.where(there, values - whole, 0.0).astype(np.float32).view(np.uint32)
    return out.ravel()


def aim(head: Any, sheet: ImageTiles, at: int, view: View) -> None:
    """Write a head: the offset ``at`` of a layer's words, and the eye's place in its lattice, differenced in
    double precision."""
    laid = sheet.laid
    a, b, c, d, e, f = laid.lattice.index[:6]
    x, y = view.target[:2] if view.projection == "plan" else view.eye[:2]
    place = np.array([a * x + b * y + c, d * x + e * y + f])
    place = np.clip(place, -1e6, 1e6)
    cell = np.floor(place)
    head["across"], head["down"] = (a, b), (d, e)
    head["cell"], head["part"] = cell, place - cell
    rows, cols = laid.lattice.u.shape
    head["nodes"] = cols, rows
    head["size"] = laid.placement.image.cols, laid.placement.image.rows
    head["finest"], head["coarsest"] = sheet.finest, sheet.coarsest
    head["levels_at"] = at
    head["lattice_at"] = at + LEVEL * len(sheet.levels)
    head["pages_at"] = head["lattice_at"] + 4 * laid.lattice.u.size
    head["bounded"] = 0 if laid.placement.stretched else 2 if laid.cyclic else 3


@kernel
def inherit(own: Words, parents: NDArray[np.int64], out: Words) -> tuple[int, int]:
    """Derive the pages of all tiles from those present; return the span [from, to) of ``out`` that changed."""
    first, last = len(out), 0
    for i in range(len(own)):
        page = own[i]
        if page == 0 and parents[i] >= 0:
            page = out[parents[i]]
        if out[i] != page:
            out[i] = page
            first, last = min(first, i), i + 1
    return first, last
