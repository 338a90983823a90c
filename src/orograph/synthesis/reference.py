"""Synthesis by example in plain NumPy: the kernels' and shaders' algorithm on a page (Lefebvre & Hoppe 2005, §3).

It uses the prepared exemplar (``exemplar.Exemplar``). Each level is made with a generous margin and cropped at the end,
so that only ``SURROUND``, which is ample, depends on how far places depend on others.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Integers = NDArray[Any]

SURROUND = 18
PARITIES = [(0, 0), (1, 1), (1, 0), (0, 1), (1, 1), (0, 0), (0, 1), (1, 0)]
"""(row, column) parities of the places that are corrected, one sub-pass after the other."""


def hashed(x: Integers, y: Integers, seed: int) -> Integers:
    """32 mixed bits of two integers and a seed."""
    with np.errstate(over="ignore"):
        h = x.astype(np.uint32) * np.uint32(0x9E3779B1) + y.astype(np.uint32) * np.uint32(0x85EBCA77)
        h = h + np.uint32(seed * 0xC2B2AE3D & 0xFFFFFFFF)
        h = (h ^ (h >> np.uint32(16))) * np.uint32(0x21F0AAAD)
        h = (h ^ (h >> np.uint32(15))) * np.uint32(0x735A2D97)
        return np.asarray(h ^ (h >> np.uint32(15))).astype(np.int64)


def folded(x: Integers, size: int) -> Integers:
    """The sample of the exemplar at a coordinate of its plane, where mirror images repeat."""
    x = x % (2 * size)
    return np.where(x < size, x, 2 * size - 1 - x)


def at(table: Integers, places: Integers) -> Integers:
    """A table (rows, cols, ...) of the exemplar at places (..., 2) of its plane."""
    return np.asarray(table[folded(places[..., 1], table.shape[0]), folded(places[..., 0], table.shape[1])])


def coordinates(
    exemplar: Any, seed: int, reach: list[int], kappa: int, passes: list[int], window: tuple[int, int, int, int],
    level: int,
) -> Integers:  # fmt: skip
    """(rows, cols, 2): x, y of a window (row0, row1, col0, col1) of a level; ``reach``: jitter in 1/256 of a step."""
    row0, row1, col0, col1 = window
    size = np.array(exemplar.shape[::-1])
    wide = (row0 - SURROUND, row1 + SURROUND, col0 - SURROUND, col1 + SURROUND) if level else window
    r, c = np.meshgrid(np.arange(*wide[:2]), np.arange(*wide[2:]), indexing="ij")
    step = exemplar.step(level) if level else 2 * int(size.max())
    here = step * np.stack([c & 1, r & 1], -1).astype(np.int64)
    if level:
        above = (wide[0] // 2, wide[1] // 2 + 1, wide[2] // 2, wide[3] // 2 + 1)
        here += coordinates(exemplar, seed, reach, kappa, passes, above, level - 1)[
            r // 2 - above[0], c // 2 - above[2]
        ]
    h = hashed(c, r, seed + 7919 * level)
    shake = np.stack([(h & 0x1FFF) - 4096, (h >> 16 & 0x1FFF) - 4096], -1)
    here = (here + (step * (reach[level] if level else 256) * shake + (1 << 19) >> 20)) % (2 * size)
    if level == 0:
        return np.asarray(here)
    for row, col in PARITIES[: 4 * passes[level]]:
        here = here.copy()
        turn = slice((row + wide[0]) % 2, None, 2), slice((col + wide[2]) % 2, None, 2)
        here[turn] = best(exemplar, level, kappa, here, turn)
    return np.asarray(here[SURROUND:-SURROUND, SURROUND:-SURROUND])


def moved(array: Integers, dr: int, dc: int) -> Integers:
    """The values (dr, dc) from each place; those that wrap around the border are wrong, and cropped at the end."""
    return np.asarray(np.roll(array, (-dr, -dc), (0, 1)))


def best(exemplar: Any, level: int, kappa: int, here: Integers, turn: tuple[slice, slice]) -> Integers:
    """For every place of this parity, the candidate whose neighbourhood of 5 × 5 is closest to that around it."""
    features, similar, step = exemplar.features[level].astype(np.int64), exemplar.similar[level], exemplar.step(level)
    size = np.array(exemplar.shape[::-1])
    reach = np.minimum(2 * step, size.min() // 4)
    around = at(features, here)
    chosen = here[turn]
    least = np.full(chosen.shape[:2], 1 << 40)
    for k in (0, 1):
        for dr, dc in [divmod((n + 4) % 9, 3) for n in range(9)]:
            dr, dc = dr - 1, dc - 1
            like = moved(here, dr, dc)[turn]
            if k:  # the similar place, in the same mirror image
                like = np.where(like % (2 * size) < size, at(similar, like), 2 * size - 1 - at(similar, like))
            like = (like - step * np.array([dc, dr])) % (2 * size)
            inner = np.stack([folded(like[..., n], size[n]) for n in (0, 1)], -1)
            across = ((inner < reach) | (inner >= size - reach)).any(-1)
            weight = (4 + k * kappa) * np.where(across, 4, 1)
            distance = np.zeros(least.shape, np.int64)
            for i in range(-2, 3):
                for j in range(-2, 3):
                    distance += (moved(around, i, j)[turn] - at(features, like + step * np.array([j, i]))) ** 2
            better = distance * weight < least
            least = np.where(better, distance * weight, least)
            chosen = np.where(better[..., None], like, chosen)
    return chosen


def heights(
    exemplar: Any, seed: int, reach: list[int], kappa: int, passes: list[int], window: tuple[int, int, int, int],
    level: int,
) -> Integers:  # fmt: skip
    """(rows, cols): heights of a window of a level, in the exemplar's quanta above its base."""
    chosen = coordinates(exemplar, seed, reach, kappa, passes, window, level).astype(np.int64)
    if level == 0:
        return at(exemplar.stack[0], chosen)
    row0, row1, col0, col1 = window
    above = (row0 // 2 - 2, row1 // 2 + 3, col0 // 2 - 2, col1 // 2 + 3)
    coarse = heights(exemplar, seed, reach, kappa, passes, above, level - 1)
    r, c = np.meshgrid(np.arange(row0, row1), np.arange(col0, col1), indexing="ij")
    step, smooth, own = exemplar.step(level), np.zeros_like(r), np.zeros_like(r)
    # The B-spline's 1 4 6 4 1: sample 2i of the doubled row is 1 6 1 of i − 1, i, i + 1; sample 2i + 1 is 4 4.
    for dr in range(-2, 3):
        for dc in range(-2, 3):
            weight = np.where((r + dr) % 2 == 0, (1, 4, 6, 4, 1)[dr + 2], 0)
            weight = weight * np.where((c + dc) % 2 == 0, (1, 4, 6, 4, 1)[dc + 2], 0)
            smooth = smooth + weight * coarse[(r + dr) // 2 - above[0], (c + dc) // 2 - above[2]].astype(np.int64)
            own = own + weight * at(exemplar.stack[level - 1], chosen + step * np.array([dc, dr])).astype(np.int64)
    return (smooth + 32 >> 6) + at(exemplar.stack[level], chosen) - (own + 32 >> 6)
