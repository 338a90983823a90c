"""The arithmetic of levels and tiles, and the terrain in memory, against their definitions."""

from __future__ import annotations

import numpy as np
import pytest
from affine import Affine
from hypothesis import given, settings
from hypothesis import strategies as st
from pyproj import CRS
from surfaces import box_means, grid_of, largest_distances, nested, rough

from orograph import store
from orograph.dem.raster import Dem
from orograph.errors import UsageError
from orograph.geo.grid import Grid
from orograph.store.terrain import exponent, level_count, level_shape, mean_shape, tile_shape

sides = st.integers(1, 5000)


@given(sides, sides)
def test_the_square_is_the_smallest_that_holds_the_raster(rows, cols):
    n = exponent((rows, cols))
    assert 2**n + 1 >= max(rows, cols)
    assert n == 0 or 2 ** (n - 1) + 1 < max(rows, cols)


@given(sides, sides)
def test_the_coarsest_level_is_the_first_of_at_most_257_samples(rows, cols):
    shape, levels = (rows, cols), level_count((rows, cols))
    assert max(level_shape(shape, levels - 1)) <= 257
    assert levels == 1 or 2 ** (exponent(shape) - levels + 2) + 1 > 257


@given(sides, sides, st.integers(0, 12))
def test_shapes_of_levels(rows, cols, level):
    step = 2**level
    assert level_shape((rows, cols), level) == (-(-(rows - 1) // step) + 1, -(-(cols - 1) // step) + 1)
    assert mean_shape((rows, cols), level) == (-(-rows // step), -(-cols // step))
    tiles = tile_shape((rows, cols), level)
    cells = [side - 1 for side in level_shape((rows, cols), level)]
    for count, n in zip(tiles, cells):
        assert count >= 1 and count * 256 >= n and (count - 1) * 256 < max(n, 1)


@pytest.mark.stress
@settings(deadline=None, max_examples=12)
@given(st.integers(1, 40), st.integers(1, 900), st.integers(0, 1000), st.sampled_from([0.0, 0.1, 1.0]))
def test_a_terrain_in_memory_is_what_its_interface_says(rows, cols, seed, missing):
    heights = rough((rows, cols), seed, missing)
    terrain = store.MemoryTerrain(heights, grid_of(heights.shape), "rough")
    assert terrain.side == 2**terrain.n + 1
    for level in range(terrain.levels):
        h, w = terrain.shape(level)
        np.testing.assert_array_equal(terrain.read(level, 0, h, 0, w), nested(heights, level))
        h, w = terrain.mean_shape(level)
        np.testing.assert_allclose(terrain.read_mean(level, 0, h, 0, w), box_means(heights, level), rtol=1e-6)
        check_tables(heights, level, terrain.tiles(level))
    assert terrain.valid_fraction == pytest.approx(np.mean(~np.isnan(heights)))


def check_tables(heights, level, table):
    size = 256 << level
    exact = largest_distances(heights, level)
    assert table.error.shape == exact.shape
    assert (table.error >= exact - 1e-9).all()
    np.testing.assert_allclose(table.error, exact, rtol=1e-6, atol=1e-9)
    for ty in range(exact.shape[0]):
        for tx in range(exact.shape[1]):
            under = heights[ty * size : (ty + 1) * size + 1, tx * size : (tx + 1) * size + 1]
            seen = under[~np.isnan(under)]
            assert table.valid[ty, tx] == (0 if not seen.size else 2 if seen.size == under.size else 1)
            if seen.size:
                assert (table.minimum[ty, tx], table.maximum[ty, tx]) == (seen.min(), seen.max())
            else:
                assert np.isnan(table.minimum[ty, tx]) and np.isnan(table.maximum[ty, tx])


def test_height_range_of_nothing_is_nan():
    heights = np.full((5, 7), np.nan, np.float32)
    terrain = store.MemoryTerrain(heights, grid_of((5, 7)), "void")
    assert np.isnan(terrain.height_range).all() and terrain.valid_fraction == 0


def test_windows_and_levels_outside_are_refused():
    terrain = store.MemoryTerrain(rough((300, 400)), grid_of((300, 400)), "rough")
    for window in ((0, 301, 0, 10), (-1, 5, 0, 10), (5, 4, 0, 10), (0, 10, 0, 401)):
        with pytest.raises(UsageError, match="not inside"):
            terrain.read(0, *window)
    with pytest.raises(UsageError, match="levels 0 to 1"):
        terrain.tiles(2)


def test_what_is_read_cannot_be_changed_by_mistake():
    terrain = store.MemoryTerrain(rough((30, 40)), grid_of((30, 40)), "rough")
    with pytest.raises(ValueError, match="read-only"):
        terrain.read(0, 0, 5, 0, 5)[:] = 0


@pytest.mark.parametrize(("crs", "word"), [("EPSG:4326", "degrees"), ("EPSG:2229", "foot")])
def test_degrees_and_feet_are_refused_as_they_are(crs, word):
    with pytest.raises(UsageError, match=word):
        store.MemoryTerrain(rough((5, 5)), grid_of((5, 5), crs), "tile")


def test_a_dem_in_degrees_is_brought_to_metres():
    grid = Grid((60, 40), Affine(1 / 1200, 0, 7.0, 0, -1 / 1200, 46.0), CRS.from_epsg(4326))
    terrain = store.terrain(Dem(np.full((60, 40), 250, np.float32), grid, None, "tile"))
    assert terrain.grid.crs.to_epsg() == 32632
    heights = terrain.heights
    assert set(np.unique(heights[np.isfinite(heights)])) == {250}
    # 60 rows of 3 arc-seconds are 5.56 km; the cells are square, of the same area as the source's at 46° N.
    metres = 1 / 1200 * 111_147 * (np.cos(np.radians(46)) * 111_320 / 111_147) ** 0.5
    assert terrain.grid.spacing == pytest.approx((metres, metres), rel=0.01)


def test_a_dem_in_feet_keeps_its_samples():
    heights = rough((30, 20))
    terrain = store.terrain(Dem(heights, grid_of((30, 20), "EPSG:2229"), None, "tile"))
    np.testing.assert_array_equal(terrain.heights, heights)
    assert terrain.grid.spacing[0] == pytest.approx(grid_of((30, 20)).spacing[0] * 1200 / 3937)


def test_a_source_is_read_into_memory_as_a_whole():
    heights = rough((1500, 70))
    terrain = store.terrain(store.ArraySource(heights, grid_of(heights.shape), "tall"))
    np.testing.assert_array_equal(terrain.heights, heights)


def test_derived_data_come_after_what_they_are_made_of():
    """Makers and metadata go through the registry in its order."""
    from orograph.store.makers import MAKERS
    from orograph.store.registry import KINDS

    names = list(KINDS)
    for name, kind in KINDS.items():
        assert all(names.index(need) < names.index(name) for need in kind.needs)
    assert any(kind.needs for kind in KINDS.values())
    assert list(MAKERS) == [name for name in names if name in MAKERS] and set(MAKERS) <= {
        name for name, kind in KINDS.items() if not kind.later
    }
    assert len({kind.group for kind in KINDS.values()}) == len(KINDS)
