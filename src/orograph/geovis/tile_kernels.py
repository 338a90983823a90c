"""The inner loops of ``image_tiles``: which tiles footprints look up, and their means out of them.

A footprint is looked at as ``mipmap.look_along`` does. Levels finer than ``base`` lie in tiles of ``SIDE`` × ``SIDE``
texels with a border of one, so that a look-up stays in one; coarser ones are held whole. Tiles are found by a small
hash table (open addressing). Units: pixels.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph._numba import inlined, kernel
from orograph.geovis.mipmap import Bytes, Colors, Floats, Table, _add, _give, footprint

Places = NDArray[np.int64]

SHIFT = 7
SIDE = 1 << SHIFT
"""Texels along the side of a tile."""

EDGE = SIDE + 2
"""With its border."""

EMPTY = -1


@inlined
def _find(keys: Places, key: Any) -> Any:
    """Where a key is in the table, or belongs."""
    mask = np.int64(keys.shape[0] - 1)
    place = ((key * np.int64(40503)) ^ (key >> np.int64(17)) ^ (key >> np.int64(41))) & mask
    while keys[place] != EMPTY and keys[place] != key:
        place = (place + 1) & mask
    return place


@inlined
def _texel(levels: Table, k: int, u: float, v: float) -> tuple[float, float]:
    """Column and row, in texels of a level, of a position in pixels."""
    size = np.float64(np.int64(1) << k)
    x = min(max(u / size - 0.5, 0.0), levels[k, 2] - 1.0)
    y = min(max(v / size - 0.5, 0.0), levels[k, 1] - 1.0)
    return x, y


@inlined
def _key(k: int, x: float, y: float) -> Any:
    return (np.int64(k) << 56) | ((np.int64(y) >> SHIFT) << 28) | (np.int64(x) >> SHIFT)


@kernel
def collect(
    levels: Table, base: int, u: Floats, v: Floats, axes: Floats, floor: Floats, inside: Floats, first: int,
    keys: Places, found: Places,
) -> tuple[int, int, bool]:  # fmt: skip
    """The tiles that positions from ``first`` on look up.

    Args:
        levels: (levels, 3) as ``mipmap.layout`` has them, of all levels; base: the finest that is held whole.
        u, v, axes, floor, inside: as for ``mipmap.look_along``.
        keys: (2^m,) a table without any key, to be filled. found: (most,) gets the keys; at least two for every look-up
            of a footprint.

    Returns:
        how many tiles; the position after the last whose tiles they are; whether levels that are held are wanted.
    """
    top = np.float64(levels.shape[0] - 1)
    count, coarse = 0, False
    for n in range(first, u.shape[0]):
        if not (u[n] == u[n] and v[n] == v[n]):
            continue
        taps, level, du, dv = footprint(axes, floor, n, top)
        if count + 2 * np.int64(taps) > found.shape[0]:
            return count, n, coarse
        whole = np.int64(np.floor(level))
        for step in range(2):
            k = whole + step
            if step == 1 and level <= whole:
                continue
            if k >= base:
                coarse = True
                continue
            for tap in range(np.int64(taps)):
                s = tap + 0.5 - 0.5 * taps
                a, b = u[n] + s * du, v[n] + s * dv
                if b >= inside[0] - 1e-3 and b <= inside[1] + 1e-3 and a >= inside[2] - 1e-3 and a <= inside[3] + 1e-3:
                    x, y = _texel(levels, k, a, b)
                    key = _key(k, x, y)
                    place = _find(keys, key)
                    if keys[place] == EMPTY:
                        keys[place] = key
                        found[count] = key
                        count += 1
    return count, u.shape[0], coarse


@kernel
def assign(keys: Places, found: Places, given: Places, slots: Places) -> None:
    """Put slots ``given`` to keys ``found`` where these are in the table."""
    for n in range(found.shape[0]):
        slots[_find(keys, found[n])] = given[n]


@inlined
def _add_tile(tiles: Bytes, slot: int, decode: Colors, x: float, y: float, weight: float, sums: Floats) -> None:
    """Add what a tile has at a texel position to ``sums``, as ``mipmap._add`` does."""
    j, i = np.int64(x), np.int64(y)
    fx, fy = x - j, y - i
    corner_at = slot * (EDGE * EDGE) + ((i & (SIDE - 1)) + 1) * EDGE + (j & (SIDE - 1)) + 1
    for corner in range(4):
        texel = corner_at + (EDGE if corner >= 2 else 0) + (corner & 1)
        w = (fy if corner >= 2 else 1.0 - fy) * (fx if corner & 1 else 1.0 - fx) * weight * tiles[texel, 3]
        sums[0] += w * decode[tiles[texel, 0]]
        sums[1] += w * decode[tiles[texel, 1]]
        sums[2] += w * decode[tiles[texel, 2]]
        sums[3] += w


@kernel
def look(
    tiles: Bytes, keys: Places, slots: Places, pool: Bytes, table: Table, levels: Table, base: int, decode: Colors,
    u: Floats, v: Floats, axes: Floats, floor: Floats, inside: Floats, first: int, last: int, out: Colors,
) -> None:  # fmt: skip
    """Means over footprints [first, last), as ``mipmap.look_along``, out of tiles and of levels that are held.

    Args:
        tiles: (slots · EDGE², 4). keys, slots: where tiles are in it. pool, table: the levels that are held.
        levels, base: as for ``collect``.
    """
    top = np.float64(levels.shape[0] - 1)
    held = np.float64(np.int64(1) << base)
    sums = np.empty(4)
    for n in range(first, last):
        sums[:] = 0.0
        if u[n] == u[n] and v[n] == v[n]:
            taps, level, du, dv = footprint(axes, floor, n, top)
            whole = np.int64(np.floor(level))
            for step in range(2):
                k = whole + step
                share = (level - whole if step == 1 else 1.0 - (level - whole)) / taps
                if share <= 0.0:
                    continue
                for tap in range(np.int64(taps)):
                    s = tap + 0.5 - 0.5 * taps
                    a, b = u[n] + s * du, v[n] + s * dv
                    if (
                        b < inside[0] - 1e-3 or b > inside[1] + 1e-3 or a < inside[2] - 1e-3 or a > inside[3] + 1e-3
                    ):  # fmt: skip
                        continue
                    if k >= base:
                        _add(pool, table, decode, a / held, b / held, np.float64(k - base), share, sums)
                    else:
                        x, y = _texel(levels, k, a, b)
                        _add_tile(tiles, slots[_find(keys, _key(k, x, y))], decode, x, y, share, sums)
        _give(sums, out, n)
