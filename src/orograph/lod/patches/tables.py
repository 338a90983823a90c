"""What decides about a patch diamond: the largest error of its patches' triangles, saturated; one number a diamond.

The triangles of a patch are those d = 2·log2(L) levels further down the hierarchy. P(D), the error of a patch diamond
D, is the largest of D's DAG descendants exactly d levels below it: its patches' triangles are among theirs, and P is
monotonic because a child's descendants are among its parent's. It is found by passing every diamond's error d levels
upwards, which costs about as much as making errors monotonic does.

*Saturated*, P′(D) = max(P(D), κ·P′(children)): with nested spheres a parent's bound in pixels is then κ times its
children's or more, so that its geomorph ends before theirs begins.

*Missing ground*: diamonds that ground and missing ground share (``mixed``) have infinite errors. Here they count with
what bounds the vertical distance wherever both surfaces are: the errors of the store's levels over the tile, or the
range of heights. A negative sign marks them. Metres, float32.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.error import ErrorKind
from orograph.error.octaves import close
from orograph.store.diamonds import blank_top, place
from orograph.store.terrain import Heights, Terrain, TileTable, diamond_shape

KAPPA = 1.25
"""κ: a patch is morphed while the bound of its parent's error grows from 1/κ of the tolerance to all of it."""

SATURATION = KAPPA * (1.0 + 2.0**-10)
"""κ in the tables: more than κ by what roundings could take away."""

NOTHING = np.float32(2.0**-100)
"""The P′ of a mixed diamond that is exact wherever there is ground."""


def patch_errors(terrain: Terrain, kind: ErrorKind, legs: int) -> list[Heights]:
    """P′ of all patch diamonds, in the layout of ``Terrain.diamonds``: an array for each level.

    Diamonds of octaves below log2(L) are none (their patches would be finer than the raster) and have 0.
    """
    q, n, top = legs.bit_length() - 1, terrain.n, terrain.levels - 1
    shapes = [diamond_shape(terrain.grid.shape, level) for level in range(top + 1)]
    result = [np.zeros((0, 0), np.float32) for _ in range(top)]
    result.append(blank_top(terrain.grid.shape, np.float32, 0))
    spread = terrain.height_range[1] - terrain.height_range[0]
    last: Heights | None = None
    for k in range(q, n):
        finite = _finite(_octave(terrain, kind, k - q), terrain, k - q, spread)
        here = _lifted(finite, k - q, q, [shapes[min(j, top)] for j in range(k - q, k + 1)], top)
        _saturate(here, last)
        last = here
        signed = np.where(np.isinf(_octave(terrain, kind, k)), -np.maximum(here, NOTHING), here)
        if k < top:
            result[k] = signed
        else:
            place(result[top], signed, k, 0, 0, top)
    return result


def _octave(terrain: Terrain, kind: ErrorKind, k: int) -> Heights:
    """The errors of an octave."""
    level = min(k, terrain.levels - 1)
    rows, cols = terrain.diamond_shape(level)
    errors, _ = terrain.diamonds(kind, level, 0, rows, 0, cols)
    return errors[:: 1 << (k - level), :: 1 << (k - level)]


def _finite(errors: Heights, terrain: Terrain, k: int, spread: float) -> Heights:
    """The errors, those of mixed diamonds replaced by what holds where both surfaces are."""
    mixed = np.isinf(errors)
    if not mixed.any():
        return errors
    i, j = np.nonzero(mixed)
    top = terrain.levels - 1
    # A square diamond's triangles are cells of level k + 1; an edge one's lie between the levels k and k + 1.
    bound = np.full(len(i), spread)
    if k + 1 <= top:
        coarse, fine = _tile_bound(terrain.tiles(k + 1), k + 1, k, i, j), _tile_bound(terrain.tiles(k), k, k, i, j)
        bound = np.minimum(bound, np.where((i & j & 1) == 1, coarse, coarse + fine))
    result = errors.copy()
    result[i, j] = np.nextafter(bound.astype(np.float32), np.float32(np.inf))
    return result


def _tile_bound(table: TileTable, level: int, k: int, i: NDArray[Any], j: NDArray[Any]) -> NDArray[np.float64]:
    """The largest error of a level's tiles that touch the vertices (i, j) of an octave."""
    found = np.zeros(len(i))
    rows, cols = table.error.shape
    shift = 8 + level - k if level >= k else 8
    for back_row in (0, 1):
        for back_col in (0, 1):
            r = np.clip((i - back_row) >> shift, 0, rows - 1)
            c = np.clip((j - back_col) >> shift, 0, cols - 1)
            found = np.maximum(found, table.error[r, c])
    return found


def _lifted(errors: Heights, k: int, q: int, shapes: list[tuple[int, int]], top: int) -> Heights:
    """The errors of an octave, passed 2q levels upwards: the octave k + q."""
    if q == 0:
        return errors.copy()
    edges = errors.copy()
    edges[1::2, 1::2] = 0.0
    close(np.zeros((0, 0), np.float32), 0, edges)
    squares = errors
    for step in range(1, q + 1):
        shape = shapes[step]
        if k + step > top:  # the arrays of the top level, which the larger octaves share
            shape = tuple(((side - 1) >> (k + step - top)) + 1 for side in shape)  # type: ignore[assignment]
        below, edges = edges, np.zeros(shape, np.float32)
        close(below, 1, edges)
        below, squares = squares, np.zeros(shape, np.float32)
        close(below, 1, squares)
    edges[1::2, 1::2] = squares[1::2, 1::2]
    return edges


def _saturate(here: Heights, below: Heights | None) -> None:
    """Make an octave's P into P′, given that of the octave below."""
    factor = np.float32(SATURATION)
    if below is not None:
        raised = np.zeros_like(here)
        close(below * factor, 1, raised)
        raised[1::2, 1::2] = 0.0
        np.maximum(here, raised, out=here)
    edges = here * factor
    edges[1::2, 1::2] = 0.0
    close(np.zeros((0, 0), np.float32), 0, edges)
    np.maximum(here[1::2, 1::2], edges[1::2, 1::2], out=here[1::2, 1::2])


class PatchTerrain:
    """A terrain whose diamonds are patch diamonds: what ``lod.field`` makes pages of.

    Args:
        terrain: the ground.
        kind: which error decides.
        legs: segments along a leg.
    """

    def __init__(self, terrain: Terrain, kind: ErrorKind, legs: int) -> None:
        self._terrain, self._kind = terrain, kind
        self._errors = patch_errors(terrain, kind, legs)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._terrain, name)

    def diamonds(
        self, kind: ErrorKind, level: int, row0: int, row1: int, col0: int, col1: int
    ) -> tuple[Heights, Heights]:
        """P′ (negative where mixed) and radii; see ``Terrain.diamonds``."""
        _, radii = self._terrain.diamonds(self._kind, level, row0, row1, col0, col1)
        return self._errors[level][row0:row1, col0:col1], radii


def cell_size(terrain: Terrain) -> float:
    """c, metres: no edge of the hierarchy's triangles of level λ is longer than c · √2^(2n − λ + 1)."""
    a, b, _, d, e, _ = terrain.grid.samples[:6]
    sides = math.hypot(a, d), math.hypot(b, e)
    diagonals = math.hypot(a + b, d + e), math.hypot(a - b, d - e)
    return max(*sides, max(diagonals) / math.sqrt(2))
