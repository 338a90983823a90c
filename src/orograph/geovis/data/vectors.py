"""Fields of two components, such as winds, and their directions on the ground.

Components are those to the east and to the north. Where the data's grid is in degrees, a degree of longitude is shorter
by the cosine of the latitude; whatever projection lies between the data and the terrain, a direction goes over by the
derivative of that map, so that arrows are turned by its convergence.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from orograph.errors import UsageError
from orograph.geo.grid import Grid
from orograph.geovis.data.dataset import Dataset
from orograph.geovis.data.field import Field, Values
from orograph.geovis.data.patterns import covered, lattice
from orograph.geovis.data.reading import read
from orograph.geovis.data.sampling import Positions

Array = NDArray[np.float64]

SHAFT, HEAD = 0.055, 0.17
"""Half widths of an arrow's shaft and head, of the pitch."""


def read_vectors(dataset: Dataset, grid: Grid) -> tuple[Field, Values, Values]:
    """The speed of a field over a terrain, and its components to the east and to the north (rows, cols), means of the
    members.

    Raises:
        UsageError: it does not say which two components are meant. Others: as ``reading.read``.
    """
    key = "variable" if dataset.variable is not None else "band"
    names = str(getattr(dataset, key) or "").split("+")
    if len(names) != 2:
        raise UsageError(
            "A flow needs components to the east and to the north.", path=dataset.called,
            remedy="Name both: variable=u10+v10, or band=1+2.",
        )  # fmt: skip
    one, other = (read(dataset.but(**{key: name.strip(), "uncertainty": None}), grid) for name in names)
    if one.values.shape != other.values.shape:
        raise UsageError(
            f"The two components have different shapes: {one.values.shape} and {other.values.shape}.",
            path=dataset.called, remedy="Choose as many members or times of both.",
        )  # fmt: skip
    speed = np.hypot(one.values, other.values)
    return replace(one, values=speed, name=f"{one.name}, {other.name}"), one.mean, other.mean


def directions(field: Field, positions: Positions, east: Values, north: Values) -> tuple[Array, Array]:
    """Unit vectors (rows, cols) along an image's columns and rows, of components at its texels' positions."""
    a, b, _, d, e, f = field.grid.transform[:6]
    u, v = (positions.values(part).astype(np.float64) for part in (east, north))
    if field.grid.crs is not None and field.grid.crs.is_geographic:
        latitude = f + d * (positions.c + 0.5) + e * (positions.r + 0.5)
        u = u / np.maximum(np.cos(np.radians(latitude)), 1e-6)
    det = a * e - b * d
    along, down = (e * u - b * v) / det, (a * v - d * u) / det  # in samples of the data
    (cy, cx), (ry, rx) = np.gradient(positions.c), np.gradient(positions.r)
    with np.errstate(invalid="ignore", divide="ignore"):
        x, y = ry * along - cy * down, cx * down - rx * along
        turned = np.sign(cx * ry - cy * rx)
        size = np.hypot(x, y)
        return np.nan_to_num(turned * x / size), np.nan_to_num(turned * y / size)


def arrows(x: Array, y: Array, pitch: float, across: Array, down: Array, part: Array) -> Array:
    """Coverage by arrows on the lattice, 0.3 to 0.95 pitches long by ``part`` (0 to 1); none where the direction is 0.

    Args:
        across, down: (rows, cols) unit vectors. part: at each texel.
    """
    cx, cy = lattice(x, y, pitch)
    i = np.clip(np.rint(cy - y[0, 0]), 0, x.shape[0] - 1).astype(int)
    j = np.clip(np.rint(cx - x[0, 0]), 0, x.shape[1] - 1).astype(int)
    tx, ty, length = across[i, j], down[i, j], pitch * (0.3 + 0.65 * np.nan_to_num(part[i, j]))
    p = (x - cx) * tx + (y - cy) * ty
    q = np.abs((y - cy) * tx - (x - cx) * ty)
    head, wide = np.minimum(0.45 * length, 0.36 * pitch), HEAD * pitch
    tip = length / 2
    shaft = np.maximum.reduce([q - SHAFT * pitch, -p - tip, p - (tip - head)])
    point = np.maximum(tip - head - p, (q * head + wide * (p - tip)) / np.hypot(head, wide))
    there = (tx != 0) | (ty != 0)
    return np.asarray(covered(np.minimum(shaft, point)) * there)
