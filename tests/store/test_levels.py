"""The kernels of the pyramid against brute force, and the error bound against points of both surfaces."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from surfaces import box_means, grid_of, largest_distances, nested, rough, source, surface

from orograph import store
from orograph.store import levels


@settings(deadline=None, max_examples=60)
@given(st.integers(1, 40), st.integers(1, 40), st.integers(0, 5), st.integers(0, 99), st.sampled_from([0, 0.05, 0.5]))
def test_the_error_of_a_level_is_the_largest_distance_of_a_sample(rows, cols, level, seed, missing):
    heights = rough((rows, cols), seed, missing)
    np.testing.assert_allclose(levels.tile_errors(heights, level), largest_distances(heights, level), atol=1e-9)


@pytest.mark.parametrize("missing", [0, 0.03])
def test_no_point_of_the_surfaces_is_further_apart_than_the_error(missing):
    """The claim behind the kernel: the largest distance is at a sample. Tried at random points inside triangles."""
    heights = rough((41, 67), 3, missing)
    rng = np.random.default_rng(1)
    points = rng.random((4000, 2)) * (40, 66)
    fine = np.array([surface(heights, 0, y, x) for y, x in points])
    for level in (1, 2, 3, 4):
        coarse = np.array([surface(heights, level, y, x) for y, x in points])
        distance = np.abs(fine - coarse)
        assert np.isfinite(distance).sum() > 1000
        error = float(levels.round_up(levels.tile_errors(heights, level), 2000.0)[0, 0])
        assert np.nanmax(distance) <= error
        assert np.nanmax(distance) > 0.5 * error  # and it is no empty promise


@pytest.mark.parametrize("origin", [(0, 0), (8, 0), (0, 8), (8, 24)])
def test_blocks_cut_their_cells_as_the_whole_raster_does(origin):
    heights = rough((65, 65), 5)
    block = heights[origin[0] : origin[0] + 9, origin[1] : origin[1] + 9]
    at = levels.tile_errors(block, 3, origin)[0, 0]
    assert at == largest_distances(heights, 3, tile=1)[origin[0] // 8, origin[1] // 8]


@settings(deadline=None, max_examples=40)
@given(st.integers(1, 50), st.integers(1, 50), st.sampled_from([0, 0.3, 1]))
def test_subsamples_and_means(rows, cols, missing):
    heights = rough((rows, cols), rows * cols, missing)
    means = levels.BoxMeans(heights)
    for level in range(1, 6):
        np.testing.assert_array_equal(levels.subsample(heights, level), nested(heights, level))
        np.testing.assert_allclose(means.next(), box_means(heights, level), rtol=1e-6)


def test_errors_are_rounded_up():
    worst = np.array([[0.0, 1.0 / 3.0, 0.1, 1e-30, 123.456]])
    rounded = levels.round_up(worst, 1000.0)
    assert (rounded.astype(np.float64) >= worst).all()
    assert rounded[0, 0] == 0 and (rounded[0, 1:] <= worst[0, 1:] * (1 + 1e-6) + 1e-12).all()


@pytest.mark.stress
@pytest.mark.parametrize("hole", [False, True])
def test_levels_whose_cells_outgrow_a_shard_have_a_bound_too(tmp_path, hole):
    """Shards of 16 samples make levels up to 4 themselves; those above come from the nested sum or the height range."""
    heights = rough((20, 9000), 7)
    if hole:
        heights[5:9, 4000:4600] = np.nan
    terrain = store.build(source(heights), tmp_path / "s.oro", shard=16, chunk=8)
    whole = store.MemoryTerrain(heights, grid_of(heights.shape), "rough")
    assert terrain.levels == 7
    for level in range(terrain.levels):
        ours, exact = terrain.tiles(level), whole.tiles(level)
        np.testing.assert_array_equal(ours.minimum, exact.minimum)
        np.testing.assert_array_equal(ours.maximum, exact.maximum)
        np.testing.assert_array_equal(ours.valid, exact.valid)
        assert (ours.error >= exact.error).all()
        if level <= 4:
            np.testing.assert_array_equal(ours.error, exact.error)
        assert (ours.error <= np.maximum(exact.maximum - exact.minimum, 0) * 1.000001).all()
        h, w = terrain.shape(level)
        np.testing.assert_array_equal(terrain.read(level, 0, h, 0, w), nested(heights, level))
        h, w = terrain.mean_shape(level)
        np.testing.assert_array_equal(terrain.read_mean(level, 0, h, 0, w), whole.read_mean(level, 0, h, 0, w))


@pytest.mark.stress
def test_a_spike_in_a_hole_of_the_level_below_is_not_lost(tmp_path):
    """The nested sum is blind there: level 4 has no triangle under the spike, level 5 has one."""
    heights = np.zeros((40, 4200), np.float32)
    heights[16, 4016] = np.nan
    heights[24, 4026] = 1000
    terrain = store.build(source(heights), tmp_path / "s.oro", shard=16, chunk=8)
    assert terrain.levels == 6
    assert surface(heights, 5, 24.0, 4026.0) == 0 and np.isnan(surface(heights, 4, 24.0, 4026.0))
    assert terrain.tiles(4).error[0, 0] == 0
    assert terrain.tiles(5).error[0, 0] >= 1000
