"""Geometries in well-known binary (OGC 06-103r4, part 8; and the flags of EWKB), as OGR and databases give them."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Part = tuple[str, list[Array]]

POINT, LINE, POLYGON, COLLECTIONS = 1, 2, 3, (4, 5, 6, 7)


def parse(data: bytes | None) -> list[Part]:
    """The simple geometries in one: ("points" | "lines" | "polygons", arrays (n, 3) of x, y, z: one for points and
    lines, the rings of a polygon, the outer one first); z is NaN where there is none. Empty ones are left out.

    Raises:
        ValueError: it is no such geometry, or of another kind.
    """
    if data is None:
        return []
    try:
        found, _ = _geometry(memoryview(data), 0)
    except (struct.error, IndexError) as error:
        raise ValueError("a geometry is truncated") from error
    return found


def _geometry(data: memoryview, at: int) -> tuple[list[Part], int]:
    order = "<" if data[at] == 1 else ">"
    code = struct.unpack_from(order + "I", data, at + 1)[0]
    at += 5 + (4 if code & 0x20000000 else 0)  # (EWKB: a reference system stands here)
    plain = code & 0x0FFFFFFF
    z = bool(code & 0x80000000) or plain // 1000 in (1, 3)
    m = bool(code & 0x40000000) or plain // 1000 in (2, 3)
    kind, wide = plain % 1000, 2 + z + m
    if kind == POINT:
        place, at = _places(data, at, order, 1, wide, z)
        return ([("points", [place])] if np.isfinite(place[:, :2]).all() else []), at
    count = struct.unpack_from(order + "I", data, at)[0]
    at += 4
    if kind == LINE:
        line, at = _places(data, at, order, count, wide, z)
        return ([("lines", [line])] if len(line) > 1 else []), at
    if kind == POLYGON:
        rings = []
        for _ in range(count):
            size = struct.unpack_from(order + "I", data, at)[0]
            ring, at = _places(data, at + 4, order, size, wide, z)
            rings.append(ring)
        return ([("polygons", rings)] if rings and len(rings[0]) > 2 else []), at
    if kind not in COLLECTIONS:
        raise ValueError(f"geometries of type {kind} are not points, lines or polygons")
    found: list[Part] = []
    for _ in range(count):
        inner, at = _geometry(data, at)
        found += inner
    return found, at


def _places(data: Any, at: int, order: str, count: int, wide: int, z: bool) -> tuple[Array, int]:
    end = at + 8 * wide * count
    if end > len(data):
        raise IndexError
    raw = np.frombuffer(data, order + "f8", wide * count, at).reshape(count, wide)
    out = np.full((count, 3), np.nan)
    out[:, : 2 + z] = raw[:, : 2 + z]
    return out, end
