"""Detail beyond the data: samples stay, windows fit to the bit, rough stays rough, and only pictures have it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from affine import Affine
from hypothesis import given, settings
from hypothesis import strategies as st
from pyproj import CRS

import orograph
from orograph.errors import UsageError
from orograph.geo.grid import Grid
from orograph.scene.detail import Detail
from orograph.synthesis.detailed import Detailed, doublings_for, steering_of
from orograph.synthesis.refining import Data, Range, doubled, metres, parents_of, roughness
from orograph.viewpoint import View

UTM = CRS.from_epsg(32632)


def ground(rows: int, cols: int, exponent: float, seed: int = 3) -> np.ndarray:
    """Noise whose amplitude falls with the wave number as its power."""
    rng = np.random.default_rng(seed)
    wave = np.hypot(np.fft.fftfreq(rows)[:, None], np.fft.rfftfreq(cols)[None, :])
    noise = np.fft.rfft2(rng.standard_normal((rows, cols))) / np.maximum(wave, 0.01) ** exponent
    made = np.fft.irfft2(noise, (rows, cols))
    return made / made.std()


def terrain_of(heights: np.ndarray, spacing: tuple[float, float] = (30.0, 30.0)) -> orograph.Terrain:
    grid = Grid(heights.shape, Affine(spacing[0], 0, 500_000, 0, -spacing[1], 5_000_000), UTM)
    return orograph.terrain(orograph.Dem(heights.astype(np.float32), grid, None, "coarse"), progress=False)


@pytest.fixture(scope="module")
def coarse() -> orograph.Terrain:
    """Rough in the west, smooth in the east, with a void, a level lake; 37 × 90 samples 30 × 20 m apart."""
    heights = 300 + 40 * ground(37, 90, 2.2) + np.linspace(12, 0.2, 90) * ground(37, 90, 1.0, 4)
    heights[20:37, 60:80] = 250
    heights[5:9, 30:33] = np.nan
    return terrain_of(heights, (30, 20))


@pytest.fixture(scope="module")
def lidar() -> orograph.Dem:
    heights = (80 + 15 * ground(70, 64, 2.0, 8) + 0.2 * ground(70, 64, 1.0, 9)).astype(np.float32)
    return orograph.Dem(heights, Grid(heights.shape, Affine(8, 0, 0, 0, -8, 0), UTM), None, "lidar", ("© Us",))


@pytest.fixture(scope="module", params=["fractal", "steered"])
def anew(request: pytest.FixtureRequest, coarse: orograph.Terrain, lidar: orograph.Dem) -> Callable[[], Detailed]:
    """Makes the same terrain again, which has computed nothing yet."""
    if request.param == "fractal":
        return lambda: Detailed(coarse, 3, 5)
    steering, name = steering_of(coarse, lidar, 5)
    assert (steering.doublings, name) == (2, "lidar")
    return lambda: Detailed(coarse, 3, 5, steering)  # one doubling finer than the example


@pytest.fixture(scope="module")
def detailed(anew: Callable[[], Detailed]) -> Detailed:
    return anew()


@pytest.mark.cases(1)
@pytest.mark.parametrize("example", [False, True])
def test_a_gpu_makes_the_same(coarse: orograph.Terrain, lidar: orograph.Dem, device, example: bool) -> None:
    """To the bit: at borders, beside voids, at every level, wherever a window begins."""
    both = []
    for one in (None, device):
        steering = steering_of(coarse, lidar, -3, device=one)[0] if example else None
        both.append(Detailed(coarse, 4, -3, steering, one))
    cpu, gpu = both
    rows, cols = cpu.grid.shape
    for window in ((0, 70, cols - 90, cols), (rows - 40, rows, 0, 30), (5 * 16, 9 * 16, 400, 540)):
        np.testing.assert_array_equal(gpu.read(0, *window), cpu.read(0, *window))
    assert np.isnan(cpu.read(0, 5 * 16, 9 * 16, 400, 540)).any()
    np.testing.assert_array_equal(gpu.read(2, 20, 60, 30, 90), cpu.read(2, 20, 60, 30, 90))


@pytest.mark.cases(1)
def test_the_datas_own_samples_stay_and_levels_nest(coarse: orograph.Terrain, detailed: Detailed) -> None:
    whole = detailed.read(0, 0, detailed.grid.rows, 0, detailed.grid.cols)
    data = coarse.read(0, 0, 37, 0, 90)
    times = 1 << detailed.doublings
    np.testing.assert_array_equal(whole[::times, ::times], data)
    for level in range(detailed.levels):
        rows, cols = detailed.shape(level)
        row, col = (np.minimum(np.arange(n) << level, m - 1) for n, m in zip((rows, cols), whole.shape))
        np.testing.assert_array_equal(detailed.read(level, 0, rows, 0, cols), whole[np.ix_(row, col)])
    assert detailed.grid.xy(times * 7, times * 5) == pytest.approx(coarse.grid.xy(7, 5))
    assert detailed.grid.bounds() != coarse.grid.bounds() and detailed.height_range == coarse.height_range


@pytest.mark.cases(1)
def test_a_window_is_the_same_wherever_it_begins(anew: Callable[[], Detailed]) -> None:
    rng = np.random.default_rng(2)
    part = anew().read(0, 0, 80, 0, 120)
    for _ in range(6):
        r, c = int(rng.integers(80 - 30)), int(rng.integers(120 - 40))
        np.testing.assert_array_equal(anew().read(0, r, r + 30, c, c + 40), part[r : r + 30, c : c + 40])


def test_rough_stays_rough() -> None:
    heights = 300 + 40 * ground(64, 128, 2.5)
    heights[:, :64] += np.random.default_rng(1).normal(0, 5, (64, 64))
    made = Detailed(terrain_of(heights), 2, 5)
    west, east = (_rest(made.read(0, 40, 200, 4 * col, 4 * col + 120)) for col in (10, 84))
    assert west > 4 * east > 0


def test_level_ground_stays_level(detailed: Detailed) -> None:
    times = 1 << detailed.doublings
    lake = detailed.read(0, 29 * times, 36 * times, 71 * times, 74 * times)
    assert (lake == 250).all()


def _rest(heights: np.ndarray) -> float:
    return float(np.nanstd(heights[1:-1] - (heights[:-2] + heights[2:]) / 2))


def test_seeds_differ(coarse: orograph.Terrain) -> None:
    one, other = (Detailed(coarse, 2, seed).read(0, 40, 80, 40, 80) for seed in (1, 2))
    assert (one != other).mean() > 0.8


def test_the_4_point_rule_reproduces_cubics() -> None:
    y, x = np.mgrid[:20, :23].astype(float)

    r = Range(-3, 17, 4, 27)
    above = parents_of(r)
    row, col = np.mgrid[above.row0 : above.row1, above.col0 : above.col1]
    quanta = 1024 * (2 + 2 * col - 2 * row * col**2 + row**3 - 2 * col**3)  # of 1/2048
    found = metres(doubled(quanta.astype(np.int32), above, r), 1 / 2048)
    row, col = (y - 3) / 2, (x + 4) / 2
    # (No rounding: denominators are below 2048.)
    np.testing.assert_allclose(found, 1 + col - row * col**2 + 0.5 * row**3 - col**3, atol=1e-9)


@given(st.integers(-30, 60), st.integers(-30, 110), st.integers(1, 25), st.integers(1, 25))
@settings(max_examples=25, deadline=None)
def test_doubling_and_roughness_do_not_depend_on_the_window(row: int, col: int, rows: int, cols: int) -> None:
    data = Data(terrain_of(30 * ground(37, 90, 2.0)))
    part, whole = Range(row, row + rows, col, col + cols), Range(-32, 90, -33, 140)
    one, other = (doubled(data.read(parents_of(r)), parents_of(r), r) for r in (part, whole))
    np.testing.assert_array_equal(one, other[part.within(whole)])
    for one, other in zip(roughness(data, part), roughness(data, whole)):
        np.testing.assert_array_equal(one, other[part.within(whole)])


def test_fractal_residuals_are_as_large_as_the_datas_own() -> None:
    """Of a self-affine surface the residual of a doubling is 2^-H times that of the one above."""
    # Power falls with the wave number to the 3.2: H = 0.6. Every fourth sample, so that there is no end to it.
    heights = 50 * ground(1024, 1024, 1.6)[::4, ::4]
    data = Data(terrain_of(heights))
    sigma, hurst = roughness(data, Range(40, 210, 40, 210))
    assert np.median(hurst) == pytest.approx(0.6, abs=0.12)
    made = Detailed(data.terrain, 1, 1).read(0, 100, 400, 100, 400).astype(np.float64)
    rest = made[100:200, 101:200:2] - (9 * (made[100:200, 100:200:2] + made[100:200, 102:202:2])
                                       - made[100:200, 98:198:2] - made[100:200, 104:204:2]) / 16  # fmt: skip
    expected = float(np.sqrt((sigma**2).mean()) * 2 ** -np.median(hurst))
    assert rest[::2].std() == pytest.approx(expected, rel=0.3)


def test_means_lie_on_the_ground_they_are_of(coarse: orograph.Terrain) -> None:
    """On a plane a mean is the height at the middle of its block, at every level."""
    y, x = np.mgrid[:300, :280].astype(float)
    plane = Detailed(terrain_of(100 + 3 * x - 2 * y), 2, 1)
    for level in range(1, plane.levels):
        rows, cols = plane.mean_shape(level)
        found = plane.read_mean(level, 0, rows - 1, 0, cols - 1)
        middle = (np.arange(max(rows, cols)) * 2.0**level + (2.0**level - 1) / 2) / 4
        expected = 100 + 3 * middle[None, : cols - 1] - 2 * middle[: rows - 1, None]
        slack = 0 if level > plane.doublings else 2.0  # of finer ones it is that of the nearest four samples
        np.testing.assert_allclose(found, expected, atol=1e-3 + slack)
    assert plane.tiles(0).valid.shape == (5, 5)


def near(terrain: orograph.Terrain) -> View:
    x, y = terrain.grid.xy(20, 25)
    height = float(terrain.read(0, 25, 26, 20, 21)[0, 0])
    return View(
        (float(x), float(y), height + 120), (float(x) + 200, float(y) + 120, height - 20), fov_y=50, width=96, height=64
    )


@pytest.mark.stress
def test_pictures_have_it_and_say_so(coarse: orograph.Terrain, lidar: orograph.Dem) -> None:
    view = near(coarse)
    plain = orograph.render(coarse, view, progress=False)
    for given_, words in ((Detail(lidar, 2), "after lidar"), (True, "fractal")):
        picture = orograph.render(coarse, view, detail=given_, furniture=True, progress=False)
        assert words in picture.describe() and words in picture.facts["detail"]["words"]
        assert picture.facts["detail"]["doublings"] == doublings_for(coarse, view, 1.0) >= 3
        assert picture.facts["windows"][-1]["level"] < picture.facts["detail"]["doublings"]
        assert not np.array_equal(picture.depth, plain.depth)
    assert "detail" not in plain.facts and "invented" not in plain.describe()
    again = orograph.render(coarse, view, detail=True, furniture=True, progress=False, jobs=1)
    np.testing.assert_array_equal(again.pixels, picture.pixels)


@pytest.mark.stress
def test_clipmaps_have_it(coarse: orograph.Terrain) -> None:
    """As Losasso and Hoppe draw it: rings finer than the data, on the ground that rays meet."""
    view = near(coarse)
    rings, rays, plain = (
        orograph.render(coarse, view, tolerance=0.5, method=method, detail=detail, progress=False)
        for method, detail in (("clipmap,n=127", True), ("auto", True), ("clipmap,n=127", None))
    )
    assert rings.facts["mesh"]["method"] == "clipmap" and rings.facts["detail"] == rays.facts["detail"]
    both = np.isfinite(rings.depth) & np.isfinite(rays.depth) & np.isfinite(plain.depth)
    off, was = (np.median(np.abs(one.depth - rays.depth)[both]) for one in (rings, plain))
    assert both.mean() > 0.5 and off < 0.25 * was


def test_far_away_there_is_none(coarse: orograph.Terrain) -> None:
    view = orograph.camera.whole(coarse, (64, 48))
    picture = orograph.render(coarse, view, detail=True, progress=False)
    assert picture.facts["detail"]["doublings"] == 0
    np.testing.assert_array_equal(picture.pixels, orograph.render(coarse, view, progress=False).pixels)


def test_what_makes_no_sense_is_refused(coarse: orograph.Terrain, lidar: orograph.Dem, tmp_path: Path) -> None:
    view = near(coarse)
    for options, words in (
        ({"detail": "exemplar"}, "fractal, or exemplar=FILE"), ({"detail": 3}, "fractal, or exemplar"),
        ({"detail": True, "method": "soar"}, "clipmaps as printed"),
        ({"detail": True, "method": "clipmap,rings=promise"}, "as printed"),
        ({"detail": True, "contours": 10}, "Contour lines"),
        ({"detail": Detail(terrain_of(40 * ground(40, 40, 2)))}, "finer than the terrain"),
    ):  # fmt: skip
        with pytest.raises(UsageError, match=words):
            orograph.render(coarse, view, progress=False, **options)


@pytest.mark.stress
@pytest.mark.parametrize("example", [False, pytest.param(True, marks=pytest.mark.stress)])
def test_the_gpu_draws_it(coarse: orograph.Terrain, lidar: orograph.Dem, device, example: bool) -> None:
    """As the CPU does: the same ground in nearly all pixels, within a pixel, and alike in colour."""
    view, detail = near(coarse), Detail(lidar, 2) if example else True
    cpu, gpu = (orograph.render(coarse, view, detail=detail, backend=b, progress=False) for b in ("cpu", "gpu"))
    assert gpu.facts["detail"] == cpu.facts["detail"]
    assert gpu.describe() == cpu.describe()
    plain = orograph.render(coarse, view, backend="gpu", progress=False)
    both = np.isfinite(cpu.depth) & np.isfinite(gpu.depth)
    assert both.mean() > 0.98 * np.isfinite(cpu.depth).mean()
    off, was = (np.abs(one.depth - cpu.depth)[both] / cpu.depth[both] for one in (gpu, plain))
    assert np.median(off) < 1e-3 < np.nanmedian(was)
    assert np.abs(gpu.pixels.astype(int) - cpu.pixels)[both].mean() < 4


@pytest.mark.parametrize(
    ("text", "made"),
    [("fractal", Detail()), ("exemplar=a.tif", Detail("a.tif")), ("fractal,seed=4", Detail(None, 4)),
     ("exemplar=a=b.tif,seed=-2", Detail("a=b.tif", -2))],
)  # fmt: skip
def test_texts(text: str, made: Detail) -> None:
    assert Detail.parse(text) == made
