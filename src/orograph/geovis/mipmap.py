"""A picture at all resolutions, each the exact area mean of the next finer one: prefiltered look-up (Williams 1983).

Pixels are RGBA, four bytes, sRGB, colour not multiplied by opacity; means are taken of linear light weighted by
opacity, and only the stored result is rounded. Texel (i, j) of level k covers the pixels [i·2ᵏ, (i+1)·2ᵏ) ×
[j·2ᵏ, (j+1)·2ᵏ) that exist, so levels of any shape stay in register. All levels lie behind one another in one array.
Units: pixels.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from orograph._numba import inlined, kernel
from orograph.parallel import map_ordered

Bytes = NDArray[np.uint8]
Floats = NDArray[np.float64]
Colors = NDArray[np.float32]
Table = NDArray[np.int64]

STRIP = 1 << 18
"""Texels averaged by one task."""

TAPS = 16
"""Look-ups side by side in one footprint, at most: where it is longer they are wider."""


@lru_cache(maxsize=1)
def curves() -> tuple[Colors, Bytes]:
    """sRGB bytes → linear light (256 values), and linear light in 65535ths → the nearest sRGB byte."""
    from orograph.geovis.color import linear_to_srgb, srgb_to_linear

    decode = np.ascontiguousarray(srgb_to_linear(np.arange(256, dtype=np.float32) / 255), np.float32)
    encode = np.round(linear_to_srgb(np.arange(65536, dtype=np.float32) / 65535) * 255).astype(np.uint8)
    return decode, encode


def layout(rows: int, cols: int) -> Table:
    """(levels, 3): where each level begins in the pool (in texels), its rows, its cols; the last is one texel."""
    levels = [(0, rows, cols)]
    while rows > 1 or cols > 1:
        base = levels[-1][0] + rows * cols
        rows, cols = -(-rows // 2), -(-cols // 2)
        levels.append((base, rows, cols))
    return np.array(levels, np.int64)


def pool_for(rows: int, cols: int) -> tuple[Bytes, Table]:
    """An unfilled pool (texels, 4) for a picture of this shape, and its layout."""
    levels = layout(rows, cols)
    return np.empty((int(levels[-1, 0]) + 1, 4), np.uint8), levels


def fill(pool: Bytes, levels: Table, jobs: int | None = None) -> None:
    """Make all levels from the finest, which is there."""
    decode, encode = curves()
    for k in range(1, len(levels)):
        rows, cols = int(levels[k, 1]), int(levels[k, 2])
        strip = max(1, STRIP // cols)

        def work(first: int, k: int = k, strip: int = strip, rows: int = rows) -> None:
            halve(pool, levels, k, first, min(first + strip, rows), decode, encode)

        for _ in map_ordered(work, range(0, rows, strip), jobs if rows > strip else 1):
            pass


@kernel
def halve(pool: Bytes, levels: Table, k: int, first: int, last: int, decode: Colors, encode: Bytes) -> None:
    """Rows [first, last) of level k from level k − 1."""
    base, cols = levels[k, 0], levels[k, 2]
    below, rows_b, cols_b = levels[k - 1, 0], levels[k - 1, 1], levels[k - 1, 2]
    full = 1 << (k - 1)  # pixels a texel of the finer level covers along an axis, but for the last
    tail_r = levels[0, 1] - (rows_b - 1) * full
    tail_c = levels[0, 2] - (cols_b - 1) * full
    for i in range(first, last):
        for j in range(cols):
            red = green = blue = opacity = area = 0.0
            for a in range(2 * i, min(2 * i + 2, rows_b)):
                high = tail_r if a == rows_b - 1 else full
                for b in range(2 * j, min(2 * j + 2, cols_b)):
                    wide = tail_c if b == cols_b - 1 else full
                    texel = below + a * cols_b + b
                    w = np.float64(high) * wide
                    area += w
                    w *= pool[texel, 3]
                    opacity += w
                    red += w * decode[pool[texel, 0]]
                    green += w * decode[pool[texel, 1]]
                    blue += w * decode[pool[texel, 2]]
            here = base + i * cols + j
            pool[here, 3] = np.uint8(opacity / area + 0.5)
            scale = 65535.0 / opacity if opacity > 0 else 0.0
            pool[here, 0] = encode[np.int64(red * scale + 0.5)]
            pool[here, 1] = encode[np.int64(green * scale + 0.5)]
            pool[here, 2] = encode[np.int64(blue * scale + 0.5)]


@inlined
def _add(
    pool: Bytes, levels: Table, decode: Colors, u: float, v: float, level: float, weight: float, sums: Floats
) -> None:
    """Add the mean at a level, which may lie between two, to ``sums`` (red, green, blue, opacity), all of them
    multiplied by opacity (0 to 255) and ``weight``."""
    whole = np.int64(np.floor(level))
    part = level - whole
    for step in range(2):
        share = weight * (part if step == 1 else 1.0 - part)
        if share <= 0.0:
            continue
        k = whole + step
        base, rows, cols = levels[k, 0], levels[k, 1], levels[k, 2]
        size = np.float64(np.int64(1) << k)
        x = min(max(u / size - 0.5, 0.0), cols - 1.0)
        y = min(max(v / size - 0.5, 0.0), rows - 1.0)
        j, i = np.int64(x), np.int64(y)
        fx, fy = x - j, y - i
        j1, i1 = min(j + 1, cols - 1), min(i + 1, rows - 1)
        for corner in range(4):
            texel = base + (i1 if corner >= 2 else i) * cols + (j1 if corner & 1 else j)
            w = (fy if corner >= 2 else 1.0 - fy) * (fx if corner & 1 else 1.0 - fx) * share * pool[texel, 3]
            sums[0] += w * decode[pool[texel, 0]]
            sums[1] += w * decode[pool[texel, 1]]
            sums[2] += w * decode[pool[texel, 2]]
            sums[3] += w


@inlined
def footprint(axes: Floats, floor: Floats, n: int, top: float) -> tuple[float, float, float, float]:
    """How to look at a footprint (see ``look_along``): how often, at which level, and the step u, v between looks."""
    p = axes[n, 0] * axes[n, 0] + axes[n, 2] * axes[n, 2]
    r = axes[n, 1] * axes[n, 1] + axes[n, 3] * axes[n, 3]
    q = axes[n, 0] * axes[n, 1] + axes[n, 2] * axes[n, 3]
    area = abs(axes[n, 0] * axes[n, 3] - axes[n, 1] * axes[n, 2])
    major = np.sqrt(0.5 * (p + r + np.sqrt((p - r) * (p - r) + 4.0 * q * q)))
    minor = max(max(area / max(major, 1e-30), floor[n]), 1.0)
    taps = min(max(np.ceil(major / minor - 1e-3), 1.0), np.float64(TAPS))
    level = min(np.log2(max(minor, major / taps)), top)
    turn = 0.5 * np.arctan2(2.0 * q, p - r)
    return taps, level, major * np.cos(turn) / taps, major * np.sin(turn) / taps


@inlined
def _give(sums: Floats, out: Colors, n: int) -> None:
    """A mean of ``_add``: linear RGB, not multiplied by opacity, and opacity."""
    if sums[3] > 0.0:
        out[n, 0], out[n, 1], out[n, 2] = sums[0] / sums[3], sums[1] / sums[3], sums[2] / sums[3]
        out[n, 3] = min(sums[3] / 255.0, 1.0)
    else:
        out[n, 0] = out[n, 1] = out[n, 2] = out[n, 3] = 0.0


@kernel
def look_up(pool: Bytes, levels: Table, decode: Colors, u: Floats, v: Floats, width: Floats, out: Colors) -> None:
    """Means over ``width`` (n,) pixels around positions u, v (n,): texel (0, 0) has its centre at (0.5, 0.5).

    Bilinear within two levels and linear between them; out (n, 4): linear RGB and opacity. Beyond the picture its
    border goes on; NaN positions become transparent.
    """
    top = np.float64(levels.shape[0] - 1)
    sums = np.empty(4)
    for n in range(u.shape[0]):
        sums[:] = 0.0
        if u[n] == u[n] and v[n] == v[n]:
            _add(pool, levels, decode, u[n], v[n], min(np.log2(max(width[n], 1.0)), top), 1.0, sums)
        _give(sums, out, n)


@kernel
def look_along(
    pool: Bytes,
    levels: Table,
    decode: Colors,
    u: Floats,
    v: Floats,
    axes: Floats,
    floor: Floats,
    inside: Floats,
    out: Colors,
) -> None:
    """Means over parallelograms around positions u, v (n,), as ``look_up`` has them over squares.

    The ellipse within the parallelogram says what is averaged: look-ups as wide as its minor axis, up to ``TAPS`` of
    them side by side along its major axis.

    Args:
        axes: (n, 4) texels, u and v of both sides of the parallelogram. floor: (n,) texels that the minor axis has at
            least.
        inside: (4,) first and last v, first and last u of the picture: look-ups beyond are transparent.
    """
    top = np.float64(levels.shape[0] - 1)
    sums = np.empty(4)
    for n in range(u.shape[0]):
        sums[:] = 0.0
        if u[n] == u[n] and v[n] == v[n]:
            taps, level, du, dv = footprint(axes, floor, n, top)
            for k in range(np.int64(taps)):
                s = k + 0.5 - 0.5 * taps
                a, b = u[n] + s * du, v[n] + s * dv
                if b >= inside[0] - 1e-3 and b <= inside[1] + 1e-3 and a >= inside[2] - 1e-3 and a <= inside[3] + 1e-3:
                    _add(pool, levels, decode, a, b, level, 1.0 / taps, sums)
        _give(sums, out, n)
