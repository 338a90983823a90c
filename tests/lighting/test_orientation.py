"""However a raster lies in memory (south-up, from the east, turned by 90°), the same ground has the same light.

A map that is right for rows running south only, or for columns running east, is the commonest fault of such tools.
"""

from __future__ import annotations

import numpy as np
import pytest
from affine import Affine
from hypothesis import given, settings
from hypothesis import strategies as st
from pyproj import CRS

from orograph.geo.grid import Grid
from orograph.lighting.context import Context, Options
from orograph.lighting.products import compute, names
from orograph.store.memory import MemoryTerrain

X, Y = 5e5, 4e6
MORE = {name: {"date": "2026-03-21", "step": 60.0} for name in ("insolation", "sunshine")}
GROUND = ("normal", "slope", "aspect", "hillshade")
ENDS = {"insolation": 1.0}
"""How far single values may lie apart, where not 0.001."""


def light(name, heights, linear, corner, **options):
    """A product of heights (odd sides) whose first sample's corner lies at ``corner``."""
    (a, b), (d, e) = linear
    grid = Grid(heights.shape, Affine(a, b, corner[0], d, e, corner[1]), CRS.from_epsg(32611))
    options = Options(azimuths=8, sun=(90.0, 12.0), more=MORE.get(name, {}), **options)
    return compute(Context(MemoryTerrain(np.ascontiguousarray(heights), grid, "h"), options), name)


@pytest.mark.parametrize("name", [n for n in names() if n != "ambient-occlusion"])  # swept between those azimuths
@settings(max_examples=5)
@given(
    seed=st.integers(0, 99), rows=st.integers(1, 12), cols=st.integers(1, 12), ratio=st.sampled_from([1.0, 0.4, 2.5]),
    holes=st.booleans(),
)  # fmt: skip
def test_memory_order_is_not_direction(name, seed, rows, cols, ratio, holes):
    rng = np.random.default_rng(seed)
    shape = 2 * rows + 1, 2 * cols + 1
    h = (rng.normal(size=shape).cumsum(0) * 8).astype(np.float32)
    if holes:
        h[rng.random(shape) < 0.2] = np.nan
    # Lines of a sweep run through samples in the eight main azimuths of square cells; elsewhere they are interpolated
    # between, and begin where the raster does.
    dx, dy = 30.0, 30.0 * (ratio if name in GROUND else 1.0)
    expected = light(name, h, ((dx, 0), (0, -dy)), (X, Y))
    south, east = Y - dy * shape[0], X + dx * shape[1]
    ways = {
        "south-up": (light(name, h[::-1], ((dx, 0), (0, dy)), (X, south)), lambda v: v[:, ::-1]),
        "from the east": (light(name, h[:, ::-1], ((-dx, 0), (0, -dy)), (east, Y)), lambda v: v[:, :, ::-1]),
        "turned": (light(name, h.T, ((0, dx), (-dy, 0)), (X, Y)), lambda v: v.transpose(0, 2, 1)),
    }
    for way, (got, back) in ways.items():
        found = back(got)
        assert np.array_equal(np.isnan(found), np.isnan(expected)), way
        apart = np.abs(found - expected)
        if name == "aspect":
            apart = np.minimum(apart, 360 - apart)
        if name == "shadow":
            apart = apart[0]
        assert np.nan_to_num(apart).max() <= ENDS.get(name, 1e-3), way
