"""Water is what is exactly level, large, compact and lies lower than its banks; areas by SciPy's labelling."""

from __future__ import annotations

import numpy as np
import pytest
import rasterio
from scipy import ndimage

from orograph.geovis.water import LEAST_SAMPLES, find_water, judge, shore, still, water_in


def level_areas(heights):
    """Connected areas of one height without missing neighbours, grown to their shores: label by label."""
    padded = np.pad(heights, 1, mode="edge")
    shifts = [padded[i : i + heights.shape[0], j : j + heights.shape[1]] for i in range(3) for j in range(3)]
    level = np.all([s == heights for s in shifts], axis=0)  # false for NaN
    for value in np.unique(heights[level]):
        labels, n = ndimage.label(level & (heights == value), np.ones((3, 3)))
        for k in range(1, n + 1):
            area = labels == k
            yield int(area.sum()), ndimage.binary_dilation(area, np.ones((3, 3))) & (heights == value)


def slope(rows=90, cols=120, rise=0.7):
    return np.add.outer(np.arange(float(rows)), rise * np.arange(float(cols)) + 0.3).astype(np.float32)


@pytest.mark.parametrize("seed", range(4))
def test_water_is_whole_level_areas(seed):
    rng = np.random.default_rng(seed)
    smooth = ndimage.gaussian_filter(rng.normal(size=(120, 150)), 6)
    heights = (np.round(smooth / smooth.std() * 1.5) * 7.3 + 1.9).astype(np.float32)  # terraces, none at the sea's 0
    heights[rng.random(heights.shape) < 0.002] = np.nan
    heights[80:, 100:] = -30.5
    found = find_water(heights.copy())
    whole = np.zeros_like(found)
    for size, area in level_areas(heights):
        part = found[area]
        if size < LEAST_SAMPLES:
            continue
        assert part.all() or not part.any() or part.mean() < 0.2  # shores touch a neighbour's at most
        if part.all():
            whole |= area
    np.testing.assert_array_equal(found, whole)
    assert found[81:, 101:].all() and not found.all()


def test_the_sea_and_its_shore():
    heights = slope() + 1
    heights[:, :40] = 0
    expected = np.zeros(heights.shape, bool)
    expected[:, :40] = True
    np.testing.assert_array_equal(find_water(heights), expected)


@pytest.mark.parametrize("level", [-40.0, -40.25])
def test_lakes_beneath_their_banks(level):
    heights = slope(rise=2) * 5
    heights[10:40, 10:40] = level
    heights[10:40, 50:80] = level + 1
    heights[60:66, 60:66] = level  # a pond: too small to be told from chance
    expected = np.zeros(heights.shape, bool)
    expected[10:40, 10:40] = expected[10:40, 50:80] = True
    np.testing.assert_array_equal(find_water(heights, 30.0), expected)


def test_plateaus_are_no_lakes():
    heights = slope()
    heights[20:60, 30:70] = heights.max() + 50.5
    assert not find_water(heights).any()


def test_plains_of_whole_metres_are_no_lakes():
    rng = np.random.default_rng(0)
    x = np.arange(300)
    rough = np.round(50 + x / 60 + rng.normal(0, 0.4, (300, 300))).astype(np.float32)
    assert not find_water(rough).any()
    steps = np.broadcast_to(np.floor(50 + x / 40), (300, 300)).astype(np.float32)  # seven large level steps
    assert not find_water(steps, 30.0).any()


@pytest.mark.parametrize(("banks", "is_lake"), [(1.0, True), (0.85, True), (0.72, False)])
def test_a_small_level_area_of_a_plain_needs_banks_on_most_sides(banks, is_lake):
    """A round area of a whole metre, 15 samples across, of whose surroundings a sector rises less than rounding."""
    y, x = np.mgrid[:120, :120] - 60.0
    distance, angle = np.hypot(x, y), np.arctan2(y, x) / (2 * np.pi) + 0.5
    rise = np.where(angle < banks, 0.7, 0.1)
    heights = (1084 + np.maximum(distance - 8, 0) * rise).astype(np.float32)
    assert find_water(heights, 80.0).any() == is_lake
    assert find_water(np.where(heights == 1084, np.float32(1083.75), heights), 80.0).any()  # no plain's height


def city(base=150.0):
    """Rolling ground clipped at a height from below, metres apart, with houses on it; and where houses stand."""
    rng = np.random.default_rng(7)
    y, x = np.mgrid[:300, :340]
    heights = base + 4 * np.sin(x / 70) * np.cos(y / 60) - 2.5
    houses = np.zeros(heights.shape, bool)
    for r, c in rng.integers(5, 280, (70, 2)):
        houses[r : r + 14, c : c + 10] = True
        heights[r : r + 14, c : c + 10] = base + rng.uniform(4, 20)
    return np.maximum(heights, base).astype(np.float32), houses


def test_ground_of_a_city_clipped_at_a_round_height_is_no_lake():
    heights, _ = city()
    assert (heights == 150).mean() > 0.5
    assert not find_water(heights, 1.0).any()
    low = heights.copy()
    low[150:200, 100:160] = 141.37  # a basin in it is the lowest, and water
    found = find_water(low, 1.0)
    assert found[150:200, 100:160].all()


@pytest.mark.parametrize("level", [100, 110, 120, 130])
def test_ground_of_a_real_city_clipped_at_a_round_height_is_no_lake(shared_data, level):
    """A square kilometre of Essen, of which a hundredth (a cutting) to nearly all is clipped."""
    path = shared_data / "nrw-dom1-1m" / "dom1_32_356_5699_1_nw_2020.tif"
    if not path.exists():
        pytest.skip("the city is not here")
    with rasterio.open(path) as file:
        heights = file.read(1)
    assert not find_water(heights, 1.0).any()
    clipped = np.maximum(heights, np.float32(level))
    assert (clipped == level).mean() > 0.008
    assert not find_water(clipped, 1.0).any()


def test_a_lake_at_a_round_height_is_water():
    y, x = np.mgrid[:200, :200] - 100.0
    bowl = 150 + np.maximum(np.hypot(x, y) - 50, 0) * 0.3  # banks of 17°
    assert find_water(bowl.astype(np.float32), 1.0)[70:130, 70:130].all()
    assert find_water(bowl.astype(np.float32) + 0.37, 1.0)[70:130, 70:130].all()


def test_dry_owens_lake_is_dry_and_reservoirs_are_not(shared_data):
    from orograph.dem.mosaic import Mosaic

    paths = [shared_data / "california-3s-tiles" / f"{name}.tif" for name in ("N36W118", "N36W119")]
    if not all(p.exists() for p in paths):
        pytest.skip("the tiles are not here")
    mosaic = Mosaic.open(paths)
    heights = mosaic.read(0, mosaic.grid.rows, 0, mosaic.grid.cols)
    levels = np.unique(heights[find_water(heights, mosaic.grid.spacing[0])])
    assert set(levels) == {199.0, 212.0, 1142.0}  # Lake Success, Lake Kaweah, Haiwee Reservoir


def test_heights_are_left_alone_and_none_is_none():
    heights = np.zeros((40, 40), np.float32)
    before = heights.copy()
    assert find_water(heights).all()
    np.testing.assert_array_equal(heights, before)
    assert not find_water(np.full((40, 40), np.nan, np.float32)).any()
    assert not find_water(slope()).any()
    assert find_water(np.zeros((2, 2), np.float32)).shape == (2, 2)


class Pyramid:
    """Box means of heights, one level after the other."""

    def __init__(self, heights, levels):
        self.means = [heights]
        for _ in range(levels - 1):
            rows, cols = ((n + 1) // 2 for n in self.means[-1].shape)
            padded = np.full((2 * rows, 2 * cols), np.nan, np.float32)
            padded[: self.means[-1].shape[0], : self.means[-1].shape[1]] = self.means[-1]
            self.means.append(np.nanmean(padded.reshape(rows, 2, cols, 2), axis=(1, 3)).astype(np.float32))
        self.levels = levels
        self.height_range = float(np.nanmin(heights)), float(np.nanmax(heights))

    def mean_shape(self, level):
        return self.means[level].shape

    def read_mean(self, level, row0, row1, col0, col1):
        assert 0 <= row0 < row1 <= self.means[level].shape[0] and 0 <= col0 < col1 <= self.means[level].shape[1]
        return self.means[level][row0:row1, col0:col1].copy()


def lake_and_pan():
    """A lake in a valley, and a pan that is a plateau but for a wall at its western end; both 240 samples wide."""
    y, x = np.mgrid[:400, :640].astype(np.float32)
    heights = 300 - 0.31 * x - 0.17 * y
    heights[60:160, 200:440] = 20.5  # beneath everything around it
    heights[240:340, 200:440] = 330.5  # above everything but the wall
    heights[230:350, 160:200] += 300
    return heights.astype(np.float32)


@pytest.mark.parametrize("col0", [0, 150, 230, 300, 390])
def test_where_a_view_cuts_an_area_does_not_matter(col0):
    heights = lake_and_pan()
    terrain = Pyramid(heights, 3)
    expected = np.zeros(heights.shape, bool)
    expected[60:160, 200:440] = True
    np.testing.assert_array_equal(find_water(heights, 30.0), expected)
    window = (slice(0, 400), slice(col0, col0 + 120))
    found = water_in(terrain, 30.0, 0, 0, col0, heights[window].copy())
    np.testing.assert_array_equal(found, expected[window])
    inside = (slice(70, 330), slice(210, 420))  # neither has a bank in it that tells
    np.testing.assert_array_equal(water_in(terrain, 30.0, 0, 70, 210, heights[inside].copy()), expected[inside])


def test_what_only_looks_like_a_lake_in_part_is_none():
    heights = lake_and_pan()
    part = heights[:, 150:215].copy()  # the wall's end of the pan
    cut = (False, False, True, True)
    verdict, open_area, verdicts = judge(part, 30.0, cut, np.nan)
    assert (verdict == 0).all() and open_area.max() == 2
    assert (open_area[61:159, 51:] == 1).all() and (open_area[241:339, 51:] == 2).all()
    assert list(verdicts) == [0, 1, 1]  # by what is seen of it, a lake
    assert not water_in(Pyramid(heights, 3), 30.0, 0, 0, 150, part)[200:].any()


def test_a_river_too_narrow_for_coarser_levels_stays():
    heights = (np.abs(np.arange(900.0)[:, None] - 450) + np.zeros(700)).astype(np.float32) * 4 + 10.5
    heights[445:456] = 0.5
    window = (slice(380, 520), slice(300, 400))
    found = water_in(Pyramid(heights, 4), 30.0, 0, 380, 300, heights[window].copy())
    assert found[66:75].all() and not found[:64].any() and not found[77:].any()


def test_the_smoothed_shore_stays_within_a_sample_of_a_circle():
    y, x = np.mgrid[:81, :81] - 40.0
    for radius in (6.3, 20.0, 33.7):
        field = shore(np.hypot(x, y) < radius)
        angle = np.linspace(0, 2 * np.pi, 720)
        radii = np.linspace(0, 38, 3801)
        at = [40 + np.sin(angle)[:, None] * radii, 40 + np.cos(angle)[:, None] * radii]
        along = ndimage.map_coordinates(field, at, order=1)
        found = radii[(along < 0.5).argmax(1)]
        np.testing.assert_allclose(found, radius, atol=0.75)
        mask = ndimage.map_coordinates((np.hypot(x, y) < radius).astype(float), at, order=1)
        steps = radii[(mask < 0.5).argmax(1)]
        assert np.abs(np.diff(found)).max() < 0.5 * np.abs(np.diff(steps)).max()
    level = np.ones((5, 7), bool)
    np.testing.assert_array_equal(shore(level), 1.0)


def coast(seed=3, shape=(140, 160), level=0.0):
    """A made coast with firths one to three samples wide, bays that the raster cuts off, and a lagoon; and its sea."""
    rng = np.random.default_rng(seed)
    rough = ndimage.gaussian_filter(rng.normal(size=shape), 8)
    heights = 3 + 60 * np.abs(rough / rough.std())
    sea = np.zeros(shape, bool)
    sea[:, :50] = True
    sea[:14, 120:] = True  # a bay in the corner: 13 × 39 level samples of a sea that goes on
    sea[60:63, 50:64] = sea[61, 64:66] = True  # a firth that narrows
    sea[100:102, 40:60] = sea[101:103, 59:64] = True
    sea[np.arange(20, 30), np.arange(50, 60)] = True  # one sample wide, along the diagonal
    return (np.where(sea, 0.0, heights) + level).astype(np.float32), sea


@pytest.mark.parametrize("seed", range(3))
def test_the_sea_reaches_into_firths_and_beyond_the_raster(seed):
    heights, sea = coast(seed)
    np.testing.assert_array_equal(find_water(heights, 2000.0), sea)
    corner = np.add.outer(np.arange(60.0), np.arange(160.0, 0, -1)).astype(np.float32)
    corner[:9, 145:] = 0.0
    bay = (slice(0, 9), slice(145, 160))  # its 8 × 14 level samples alone would be too few, but two borders cut it off
    assert LEAST_SAMPLES > 8 * 14 and find_water(corner, 2000.0)[bay].all()
    inland = corner.copy()
    inland[:9, 145:], inland[20:29, 20:35] = 30.5, 0.0  # as large, and not at a border: it may be anything
    assert not find_water(inland, 2000.0).any()
    lifted, _ = coast(seed, level=3.25)  # an arm of a lake: only the sea reaches into what is one sample wide
    assert not find_water(lifted, 2000.0)[25, 55]


def test_inlets_end_on_steps_of_plains_and_after_some_samples():
    heights, _ = coast()
    heights[118, 50:110] = 0.0  # a canal: too long to be told from a level road
    heights[120:, 50:] = -1.5 - heights[120:, 50:] / 10  # land below the sea, with a step at its height
    heights[121, 50:54] = 0.0
    found = find_water(heights, 2000.0)
    assert found[118, 50:64].all() and not found[118, 68:].any()
    assert not found[120:, 51:].any()


def test_inlets_do_not_depend_on_the_window():
    heights, sea = coast()
    terrain = Pyramid(heights, 3)
    for rows, cols in (
        (slice(50, 80), slice(52, 90)),
        (slice(95, 110), slice(58, 80)),
        (slice(0, 30), slice(110, 160)),
    ):
        found = water_in(terrain, 2000.0, 0, rows.start, cols.start, heights[rows, cols].copy())
        np.testing.assert_array_equal(found, sea[rows, cols])


def test_no_line_of_height_0_is_wanted_around_still_ground():
    heights, sea = coast()
    heights[125:127, 100:103] = 0.0  # a pond of six samples, far from the sea
    heights[127, 101] = -0.2  # (with a dip that is none)
    heights[90:93, 100:103] = -2.0  # a hollow, whose line of 0 is a contour
    field, plain = shore(sea, still(heights)), shore(sea)
    assert (field[124:128, 99:104] > 0.2).all() and (field[124:128, 99:104] < 0.46).all()
    assert (field[88:95, 98:105] == plain[88:95, 98:105]).all()
    np.testing.assert_array_equal(field > 0.46, plain > 0.46)  # the shore stays
    beside = ndimage.binary_dilation(sea, np.ones((3, 3)))
    np.testing.assert_array_equal(field[beside], plain[beside])
