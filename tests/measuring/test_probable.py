"""Uncertain terrains: closed forms of planes and normal laws, plain floods, and the same however it is made."""

from __future__ import annotations

import math

import numpy as np
import pytest
import rasterio
from affine import Affine
from closed_forms import RECTANGULAR, ROTATED, SQUARE, of_function, rough, terrain_of
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from orograph.errors import ReadError, UsageError
from orograph.measuring import (
    HeightError,
    contours,
    flood,
    probable_viewshed,
    slope,
    viewshed,
)
from orograph.measuring.flood_kernels import REACHED, WET, fill
from orograph.measuring.height_error import Drawn, ErrorField
from orograph.progress import Progress


class Heard(Progress):
    """What a user is warned of."""

    def __init__(self) -> None:
        self.warnings: list[str] = []

    def warn(self, text: str) -> None:
        self.warnings.append(text)


def level_ground(shape, transform=SQUARE):
    return terrain_of(np.full(shape, 100.0), transform)


# ---- draws of the error --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("transform", [SQUARE, RECTANGULAR, ROTATED])
def test_errors_have_the_variance_and_correlation_that_are_stated(transform):
    terrain = level_ground((36, 30), transform)
    cell_x, cell_y = terrain.grid.spacing
    for reach in (45.0, 200.0, 900.0):
        field = ErrorField(terrain, HeightError(2.0, reach), seed=3)
        draws = np.stack([field.window(k, 0, 36, 0, 30) for k in range(900)]) / 2.0
        at = draws[:, 30, 20]
        assert abs(draws[:, ::7, ::9].var() - 1) < 0.07 and abs(draws[:, ::7, ::9].mean()) < 0.06
        for dr, dc in ((0, 1), (1, 0), (3, 2), (0, 5)):
            d = math.hypot(dc * cell_x, dr * cell_y)
            expected = math.exp(-3 * (d / reach) ** 2)
            found = float((at * draws[:, 30 + dr, 20 + dc]).mean())
            assert abs(found - expected) < 4 * math.sqrt((1 + expected**2) / 900) + 0.004, (reach, dr, dc)


def test_the_variance_is_one_at_every_sample():
    """Exactly, by the weights: unit impulses at all nodes, squared and added."""
    from orograph.measuring.error_kernels import spread

    total = np.zeros((9, 11))
    for i in range(20):
        for j in range(20):
            noise = np.zeros((20, 20))
            noise[i, j] = 1.0
            out = np.empty((9, 11))
            spread(noise, -4, -4, 0, 0, 0.9, 1.7, out)
            total += out**2
    np.testing.assert_allclose(total, 1.0, rtol=1e-12)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 300), st.integers(0, 300), st.integers(1, 90), st.integers(1, 90), st.sampled_from([0.0, 70.0]))
def test_a_window_is_part_of_the_whole(row, col, rows, cols, reach):
    terrain = level_ground((391, 391))
    field = ErrorField(terrain, HeightError(1.5, reach), seed=11)
    whole = WHOLE.setdefault(reach, field.window(5, 0, 391, 0, 391))
    np.testing.assert_array_equal(
        field.window(5, row, row + rows, col, col + cols), whole[row : row + rows, col : col + cols]
    )


WHOLE: dict[float, np.ndarray] = {}


def test_errors_of_draws_seeds_and_far_samples_are_independent():
    terrain = level_ground((80, 90))
    one, other = (ErrorField(terrain, HeightError(1.0, 60.0), seed=s) for s in (1, 2))
    fields = [one.window(0, 0, 80, 0, 90), one.window(1, 0, 80, 0, 90), other.window(0, 0, 80, 0, 90)]
    for a, b in ((0, 1), (0, 2), (1, 2)):
        assert abs(np.corrcoef(fields[a].ravel(), fields[b].ravel())[0, 1]) < 0.05
    assert ErrorField(terrain, HeightError(1.0, 20.0)).independent


def test_slopes_add_to_the_error():
    terrain = of_function((30, 33), lambda x, y: 0.5 * (x - 500_000) + 0.25 * (y - 4_000_000), ROTATED)
    field = ErrorField(terrain, HeightError(2.0, 0.0, horizontal=4.0))
    np.testing.assert_allclose(field.sigma, math.sqrt(4 + 16 * (0.25 + 0.0625)), rtol=2e-3)  # (float32 heights)


def test_a_raster_of_deviations(tmp_path):
    terrain = terrain_of(rough((40, 50), 1, True), SQUARE, "EPSG:32611")
    path = tmp_path / "sigma.tif"

    def written(values):
        with rasterio.open(path, "w", driver="GTiff", width=52, height=42, count=1, dtype="float32", nodata=-9,
                           crs="EPSG:32611", transform=SQUARE @ Affine.translation(-1, -1)) as file:  # fmt: skip
            file.write(values.astype(np.float32), 1)

    sigma = np.arange(42 * 52, dtype=np.float32).reshape(42, 52) / 100
    written(sigma)
    field = ErrorField(terrain, HeightError(path))
    hole = np.isnan(terrain.read(0, 0, 40, 0, 50))
    expected = np.where(hole, np.nan, sigma[1:-1, 1:-1])
    np.testing.assert_allclose(field.sigma, expected, atol=2e-3)
    written(np.where(np.arange(52) < 30, sigma, -9))
    with pytest.raises(ReadError, match="samples of the terrain that have a height"):
        ErrorField(terrain, HeightError(path))
    written(sigma - 1)
    with pytest.raises(ReadError, match="cannot be negative"):
        ErrorField(terrain, HeightError(path))


# ---- slopes --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("reach", [0.0, 150.0])
def test_slopes_of_a_plane_have_rices_distribution(reach):
    """Central differences over 2 d have the variance σ² (1 − ρ(2d)) / (2 d²) each, so tan slope is Rice distributed."""
    rise, d, sigma, limit, draws = 0.3, 30.0, 3.0, 18.0, 400
    terrain = of_function((43, 40), lambda x, y: rise * (x - 500_000))
    found = slope(terrain, HeightError(sigma, reach), [limit], draws=draws, seed=5).values()
    rho = math.exp(-3 * (2 * d / reach) ** 2) if reach else 0.0
    tau = sigma * math.sqrt((1 - rho) / (2 * d * d))
    law = stats.rice(rise / tau, scale=tau)
    inner = np.s_[1:-1, 1:-1]
    p = law.sf(math.tan(math.radians(limit)))
    apart = 1 + math.ceil((reach or 60) / d)
    sparse = found[2][inner][::apart, ::apart]
    assert 0.05 < p < 0.95
    bound = 5 * math.sqrt(p * (1 - p) / draws / sparse.size)
    assert abs(sparse.mean() - p) < bound + 0.002
    assert sparse.std() == pytest.approx(math.sqrt(p * (1 - p) / draws), rel=0.35)  # the sampling error as stated
    mean = law.expect(lambda t: np.degrees(np.arctan(t)))
    spread = math.sqrt(law.expect(lambda t: np.degrees(np.arctan(t)) ** 2) - mean**2)
    assert found[0][inner].mean() == pytest.approx(mean, abs=0.1)
    assert found[1][inner].mean() == pytest.approx(spread, rel=0.04)


# ---- contours ------------------------------------------------------------------------------------------------------


def test_contours_of_level_ground():
    """With independent errors a cell is passed unless all four corners are on one side."""
    sigma, level, draws = 2.0, 101.0, 600
    found = contours(level_ground((40, 50)), HeightError(sigma), [level], draws=draws).values()
    assert found.shape == (1, 39, 49)
    below = stats.norm.cdf((level - 100) / sigma)
    expected = 1 - below**4 - (1 - below) ** 4
    assert found[0, ::2, ::2].mean() == pytest.approx(expected, abs=5 * 0.5 / math.sqrt(draws * 500))


def test_contours_without_error_are_where_they_are():
    h = rough((30, 31), 4, True)
    terrain = terrain_of(h)
    one = contours(terrain, HeightError(0.0), interval=50.0, draws=1)
    corners = np.stack([h[:-1, :-1], h[:-1, 1:], h[1:, :-1], h[1:, 1:]])
    low, high = corners.min(0), corners.max(0)
    crossed = np.zeros(low.shape, bool)
    for line in np.arange(0, 1000, 50.0):
        crossed |= (low <= line) & (line < high)
    expected = np.where(np.isnan(low), np.nan, crossed)
    np.testing.assert_array_equal(one.values()[0], expected)
    listed = contours(terrain, HeightError(0.0), np.arange(0, 1000, 50.0).tolist(), draws=1)
    np.testing.assert_array_equal(listed.values()[0], expected)
    assert one.grid.xy(0, 0) == pytest.approx(terrain.grid.xy(0.5, 0.5))


# ---- floods --------------------------------------------------------------------------------------------------------


def by_edges(wet, seeds):
    """Reached samples, by a plain search along the edges of the triangulation."""
    reached = {s for s in seeds if wet[s]}
    waiting = list(reached)
    while waiting:
        i, j = waiting.pop()
        steps = [(0, 1), (0, -1), (1, 0), (-1, 0)]
        for r in (i - 1, i):
            for c in (j - 1, j):  # the cell (r, c): its diagonal joins its (even, even) and (odd, odd) corners
                ends = [(r, c), (r + 1, c + 1)] if (r + c) % 2 == 0 else [(r, c + 1), (r + 1, c)]
                if (i, j) in ends:
                    other = ends[1 - ends.index((i, j))]
                    steps.append((other[0] - i, other[1] - j))
        for di, dj in steps:
            at = (i + di, j + dj)
            if 0 <= at[0] < wet.shape[0] and 0 <= at[1] < wet.shape[1] and wet[at] and at not in reached:
                reached.add(at)
                waiting.append(at)
    out = np.zeros(wet.shape, bool)
    for at in reached:
        out[at] = True
    return out


@settings(max_examples=60, deadline=None)
@given(st.integers(1, 12), st.integers(1, 14), st.integers(0, 2**31), st.floats(0.4, 0.9))
def test_water_runs_along_edges(rows, cols, seed, part):
    rng = np.random.default_rng(seed)
    wet = rng.random((rows, cols)) < part
    spring = (int(rng.integers(rows)), int(rng.integers(cols)))
    state = wet.astype(np.uint8)
    if wet[spring]:
        state[spring] = WET | REACHED
    stack = np.empty(rows * cols, np.int64)
    fill(state, 0, rows, 0, cols, True, stack)
    np.testing.assert_array_equal(state == WET | REACHED, by_edges(wet, [spring]))


def test_a_flood_over_many_tiles_is_the_plain_one():
    rng = np.random.default_rng(2)
    h = rng.normal(0, 1, (530, 601)).astype(np.float32)
    h[200:210, 100:300] = np.nan
    h[299:302, 298:310] = h[19:22, 585:595] = -9
    terrain = terrain_of(h)
    level = 0.12  # near the threshold of percolation, where ways wind through many tiles
    at = [(300, 300), (20, 590)]
    found = flood(terrain, level, [terrain.grid.xy(c, r) for r, c in at])
    assert found.draws == 0
    expected = by_edges(h < level, at)
    assert expected.sum() > 5_000
    np.testing.assert_array_equal(found.values()[0], np.where(np.isnan(h), np.nan, expected))


def test_uncertain_floods_draw_by_draw():
    terrain = terrain_of(rough((47, 52), 3, True))
    error = HeightError(15.0, 100.0)
    spring = (20, 30)
    found = flood(terrain, 520.0, [terrain.grid.xy(30, 20)], error, draws=12, seed=4)
    errors = ErrorField(terrain, error, 4)
    count = np.zeros((47, 52))
    for draw in range(12):
        count += by_edges(Drawn(terrain, errors, draw).read(0, 0, 47, 0, 52) < 520.0, [spring])
    hole = np.isnan(terrain.read(0, 0, 47, 0, 52))
    np.testing.assert_array_equal(found.values()[0], np.where(hole, np.nan, count / 12).astype(np.float32))


def test_a_source_above_the_level_is_told():
    terrain = terrain_of(np.full((9, 9), 100.0))
    for error, says in ((HeightError(), "floods nothing"), (HeightError(3.0), "only in draws")):
        heard = Heard()
        found = flood(terrain, 90.0, [terrain.grid.xy(4, 4)], error, draws=3).values(heard)
        assert not found.any() and len(heard.warnings) == 1 and says in heard.warnings[0]


def test_below_a_level_is_the_normal_law():
    terrain = terrain_of(rough((47, 52), 3))
    h = terrain.read(0, 0, 47, 0, 52).astype(float)
    found = flood(terrain, 520.0, error=HeightError(15.0, 100.0)).values()[0]
    np.testing.assert_allclose(found, stats.norm.cdf((520 - h) / 15), atol=1e-6)
    drawn = np.mean([ErrorField(terrain, HeightError(15.0, 100.0), 9).window(k, 0, 47, 0, 52) + h < 520
                     for k in range(300)], axis=0)  # fmt: skip
    assert np.abs(drawn - found).max() < 5 * 0.5 / math.sqrt(300)


# ---- viewsheds -----------------------------------------------------------------------------------------------------


def test_a_probable_viewshed_is_the_mean_of_viewsheds():
    h = rough((40, 43), 2, True)
    terrain = terrain_of(h)
    point, error = terrain.grid.xy(17.3, 21.8), HeightError(4.0, 90.0)
    found = probable_viewshed(terrain, point, error, 12.0, 3.0, draws=9, seed=7, radius=500.0)
    errors = ErrorField(terrain, error, 7)
    whole = [terrain_of(Drawn(terrain, errors, k).read(0, 0, 40, 0, 43)) for k in range(9)]
    expected = np.mean([viewshed(one, point, 12.0, 3.0, radius=500.0).values() for one in whole], axis=0)
    np.testing.assert_array_equal(found.values()[0], expected.astype(np.float32))
    assert np.isnan(expected).any() and 0 < np.nanmean(expected) < 1


@pytest.mark.stress
def test_a_wall_hides_with_the_probability_of_its_height():
    """An eye far above level ground, a wall half way to the target: seen if the wall's top is under the line."""
    h = np.full((3, 21), 100.0, np.float32)
    h[:, 10] = 398.0
    terrain = terrain_of(h)
    draws, sigma = 600, 4.0
    found = probable_viewshed(terrain, terrain.grid.xy(0, 1), HeightError(sigma), 600.0, draws=draws, flat=True,
                              refraction=0.0).values()[0]  # fmt: skip
    # Errors of eye e0, wall e1, target e2: 298 + e1 < (600 + e0 + e2) / 2, if no other ground stands in the way.
    expected = stats.norm.cdf(2.0 / (sigma * math.sqrt(1.5)))
    assert found[1, 20] == pytest.approx(expected, abs=4 * math.sqrt(expected * (1 - expected) / draws) + 0.01)


# ---- the same however it is made, and what is wrong ----------------------------------------------------------------


@pytest.mark.parametrize("reach", [0.0, 120.0])
def test_threads_memory_and_stores_change_nothing(tmp_path, reach):
    import orograph

    h = rough((300, 530), 6, True)
    terrain = terrain_of(h, SQUARE, "EPSG:32611")
    path = tmp_path / "h.tif"
    with rasterio.open(path, "w", driver="GTiff", width=530, height=300, count=1, dtype="float32", nodata=np.nan,
                       crs="EPSG:32611", transform=SQUARE) as file:  # fmt: skip
        file.write(h, 1)
    store = orograph.build(path, tmp_path / "h.oro", vertical_unit="metre", progress=False)
    error = HeightError(5.0, reach, horizontal=3.0)
    point = terrain.grid.xy(260, 140)
    measures = [
        lambda t, **how: slope(t, error, [10], draws=3, **how),
        lambda t, **how: contours(t, error, interval=20.0, draws=3, **how),
        lambda t, **how: flood(t, 520.0, [point], error, draws=3, **how),
        lambda t, **how: probable_viewshed(t, point, error, draws=3, radius=2000.0, **how),
    ]
    for measure in measures:
        first = measure(terrain, jobs=1).values()
        np.testing.assert_array_equal(first, measure(store, jobs=3, max_memory=1 << 16).values())


@pytest.mark.stress
def test_a_file_and_data_say_what_they_are(tmp_path):
    import orograph

    terrain = terrain_of(rough((40, 50), 1, True), SQUARE, "EPSG:32611")
    found = slope(terrain, HeightError(2.0, 60.0), [10, 20], draws=4, seed=9)
    told = found.save(tmp_path / "slope.tif")
    with rasterio.open(tmp_path / "slope.tif") as file:
        np.testing.assert_array_equal(file.read(), found.values())
        assert file.descriptions == ("mean slope", "standard deviation of the slope", "probability of slope > 10°",
                                     "probability of slope > 20°")  # fmt: skip
        assert file.units[:2] == ("°", "°")
        tags = file.tags()
    assert tags["sigma"] == "2 m" and tags["range"] == "60 m" and tags["draws"] == "4" and tags["seed"] == "9"
    assert told["standard_error"] == 0.25 and told["means"]["mean slope"] == pytest.approx(
        np.nanmean(found.values()[0])
    )
    picture = orograph.render(terrain, data=found.data(3), size=(160, 120), furniture=True, progress=False)
    assert "P(slope > 10°)" in picture.describe()


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda t: HeightError(-1.0), "standard deviation"),
        (lambda t: HeightError(1.0, math.nan), "range of errors"),
        (lambda t: slope(t, HeightError(1.0), draws=1), "from 2 to 65,535, not 1"),
        (lambda t: slope(t, HeightError(1.0), [95.0]), "0 to 90"),
        (lambda t: contours(t, HeightError(1.0)), "give one of the two"),
        (lambda t: contours(t, HeightError(1.0), interval=0.0), "above 0"),
        (lambda t: flood(t, math.inf), "water level"),
        (lambda t: flood(t, 1.0, [t.grid.xy(13, 13)]), "in a hole"),
        (lambda t: flood(t, 1.0, [(0.0, 0.0)]), "south"),
        (lambda t: ErrorField(t, HeightError(1.0), -1), "seed"),
        (lambda t: slope(t, 3.0), "must be a HeightError"),
    ],
)
def test_what_is_wrong_is_said(call, says):
    h = rough((40, 50), 1)
    h[13, 13] = np.nan
    with pytest.raises(UsageError, match=says):
        call(terrain_of(h))


def test_sheared_cells_need_independent_errors():
    sheared = Affine(30, 10, 500_000, 0, -30, 4_000_000)
    ErrorField(level_ground((9, 9), sheared), HeightError(1.0))
    with pytest.raises(UsageError, match="sheared"):
        ErrorField(level_ground((9, 9), sheared), HeightError(1.0, 100.0))


def test_one_row():
    terrain = terrain_of(np.linspace(0, 90, 40)[None])
    found = slope(terrain, HeightError(1.0, 50.0), [3.0], draws=8).values()
    assert found.shape == (3, 1, 40) and np.isfinite(found).all()
    np.testing.assert_array_equal(flood(terrain, 45.0).values()[0, 0], np.linspace(0, 90, 40) < 45)
    with pytest.raises(UsageError, match="no surface to measure"):
        flood(terrain, 45.0, [terrain.grid.xy(0, 0)])
    with pytest.raises(UsageError, match="one row"):
        contours(terrain, HeightError(1.0), interval=10.0)
