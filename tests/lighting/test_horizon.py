"""Horizons against brute force on the same profiles, a dense search of the surface, closed forms, a published map."""

from __future__ import annotations

import math

import numpy as np
import pytest
import rasterio
from hypothesis import given, settings
from hypothesis import strategies as st

from orograph.errors import UsageError
from orograph.lighting.horizon import horizon, sky_view

SQUARE = np.array([[1.0, 0.0], [0.0, -1.0]])


def between(a: float, b: float, f: float) -> float:
    return b if math.isnan(a) else a if math.isnan(b) else a + (b - a) * f


def brute(heights: np.ndarray, linear: np.ndarray, azimuth: float, lowest: float = 0.0) -> np.ndarray:
    """What the module promises, told without hull or stack: every pair of points on every line, and own cells."""
    h = heights.astype(float)
    a = math.radians(azimuth)
    du, dv = np.linalg.solve(linear, [math.sin(a), math.cos(a)])
    if abs(du) < abs(dv):
        return brute(h.T, linear[:, ::-1], azimuth, lowest).T
    lanes, steps = h.shape
    tilt, metres, ahead = dv / du, 1 / abs(du), 1 if du > 0 else -1
    through = all(abs(tilt * i - round(tilt * i)) < 1e-6 for i in range(steps))

    def profile(x: float, i: int) -> float:
        j = round(x) if abs(x - round(x)) < 1e-6 else math.floor(x)
        f = 0.0 if j == round(x) and abs(x - j) < 1e-6 else x - j
        low = h[j, i] if 0 <= j < lanes else math.nan
        high = h[j + 1, i] if f and 0 <= j + 1 < lanes else math.nan
        return between(low, high, f)

    def best(x: float, i: int) -> tuple[float, int]:
        """The highest slope along a line, and how many steps away; of several the farthest."""
        own, found, k = profile(x, i), (-math.inf, 0), 1
        while 0 <= i + ahead * k < steps:
            z = profile(x + tilt * ahead * k, i + ahead * k)
            for there, point in ((k, z), (k - 0.5, middle(x, i, k))):
                if not math.isnan(point) and (point - own) / (there * metres) >= found[0]:
                    found = (point - own) / (there * metres), k
            k += 1
        return found

    def middle(x: float, i: int, k: int) -> float:
        """What a line along a diagonal meets before its step k: the middle of a cell that is cut the other way."""
        if not through or abs(tilt) < 0.5:
            return math.nan
        j, other, i = round(x + tilt * ahead * (k - 1)), round(x + tilt * ahead * k), i + ahead * (k - 1)
        if not (0 <= j < lanes and 0 <= other < lanes and (i + j) % 2):
            return math.nan
        return between(h[other, i], h[j, i + ahead], 0.5)

    def seen(x: float, i: int) -> float:
        slope, k = best(x, i)
        if k == 1 and not through:  # the far horizon is that of the next point
            k += best(x + tilt * ahead, i + ahead)[1]
            slope = (profile(x + tilt * ahead * k, i + ahead * k) - profile(x, i)) / (k * metres) if k > 1 else lowest
        return max(slope, lowest)

    def near(j: int, i: int) -> float:
        """What the sample sees of its own cell: cut through even corners, along the ray to where the cell ends."""
        side = int(np.sign(tilt * ahead))
        major = h[j, i + ahead] if 0 <= i + ahead < steps else math.nan
        minor, both = math.nan, math.nan
        if 0 <= j + side < lanes:
            minor, both = h[j + side, i], h[j + side, i + ahead] if 0 <= i + ahead < steps else math.nan
        slope = (between(between(major, both, 0.0), between(both, major, 0.0), abs(tilt)) - h[j, i]) / metres
        if (i + j) % 2 and not math.isnan(major + minor):  # the diagonal is where t (1 + |tilt|) = 1
            t = 1 / (1 + abs(tilt))
            slope = max(slope, ((1 - t * abs(tilt)) * major + t * abs(tilt) * minor - h[j, i]) / (t * metres))
        return -math.inf if math.isnan(slope) else slope

    out = np.full(h.shape, np.nan)
    for c in range(lanes):
        for i in range(steps):
            if not math.isnan(h[c, i]):
                f = tilt * i - round(tilt * i)
                f = 0.0 if abs(f) < 1e-6 else f % 1.0
                # Lines cross this step f beyond every sample: the sample lies f of the way back from the one beyond.
                own = -math.inf if through else near(c, i)
                out[c, i] = max(seen(c + f, i), own) * (1 - f) + (max(seen(c - 1 + f, i), own) * f if f else 0.0)
    return out


@settings(max_examples=60, deadline=None)
@given(
    st.integers(0, 2**31), st.integers(1, 20), st.integers(1, 20), st.integers(0, 3600), st.floats(0.4, 2.5),
    st.integers(0, 90), st.booleans(), st.floats(0, 0.3),
)  # fmt: skip
def test_exact_for_the_profiles_of_its_lines(seed, rows, cols, azimuth, ratio, turn, south_up, missing):
    rng = np.random.default_rng(seed)
    h = rng.normal(size=(rows, cols)).cumsum(1).astype(np.float32)
    h[rng.random(h.shape) < missing] = np.nan
    c, s = np.cos(np.radians(turn)), np.sin(np.radians(turn))
    linear = np.array([[c, -s], [s, c]]) @ np.diag([1.5, 1.5 * ratio * (1 if south_up else -1)])
    azimuth /= 10
    np.testing.assert_allclose(horizon(h, linear, azimuth), brute(h, linear, azimuth), atol=3e-6, rtol=3e-6)


@pytest.mark.cases(4)
@pytest.mark.parametrize("azimuth", [0, 45, 90, 135, 180, 225, 270, 315, 17, 200.5, 22.5])
def test_many_blocks_of_lines_agree_with_brute_force(azimuth):
    h = np.random.default_rng(3).normal(size=(41, 53)).cumsum(0).astype(np.float32)
    truth = brute(h, SQUARE, azimuth, -np.inf)
    for jobs in (1, 3):
        got = horizon(h, SQUARE, azimuth, lowest=-np.inf, jobs=jobs)
        np.testing.assert_allclose(got, truth, atol=3e-6, rtol=3e-6)


def test_azimuth_is_clockwise_from_north():
    h = np.zeros((9, 9), np.float32)
    h[4, 8] = 4.0  # a tower in the east
    assert horizon(h, SQUARE, 90.0)[4, 4] == pytest.approx(1.0)
    assert horizon(h, SQUARE, 270.0)[4, 4] == 0
    h[:], h[0, 4] = 0, 2.0  # a tower in the north: rows run south
    assert horizon(h, SQUARE, 0.0)[4, 4] == pytest.approx(0.5)


def test_distance_is_in_metres_along_the_azimuth():
    h = np.zeros((9, 9), np.float32)
    h[0, 8] = 3.0
    # Cells 2 m × 1 m: the tower stands 8 m east, 4 m north.
    assert horizon(h, [[2, 0], [0, -1]], math.degrees(math.atan2(8, 4)))[4, 4] == pytest.approx(
        3 / math.hypot(8, 4), rel=1e-5
    )


def test_missing_ground_is_transparent():
    h = np.zeros((1, 9), np.float32)
    h[0, 8], h[0, 5:8] = 4.0, np.nan
    got = horizon(h, SQUARE, 90.0)[0]
    assert got[4] == pytest.approx(1.0) and np.isnan(got[5:8]).all()


def height_at(h: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Of the surface: cells cut between their corners of even row + column; NaN off the raster."""
    rows, cols = h.shape
    j, i = (np.clip(np.floor(v).astype(int), 0, n - 2) for v, n in ((x, cols), (y, rows)))
    u, v = x - j, y - i
    a, b, c, d = h[i, j], h[i, j + 1], h[i + 1, j], h[i + 1, j + 1]
    falling = np.where(u >= v, a + u * (b - a) + v * (d - b), a + v * (c - a) + u * (d - c))
    rising = np.where(u + v <= 1, a + u * (b - a) + v * (c - a), d + (1 - u) * (c - d) + (1 - v) * (b - d))
    off = (x < -1e-9) | (y < -1e-9) | (x > cols - 1 + 1e-9) | (y > rows - 1 + 1e-9)
    return np.where(off, np.nan, np.where((i + j) % 2 == 0, falling, rising))


def dense(
    h: np.ndarray, linear: np.ndarray, azimuth: float, row: np.ndarray, col: np.ndarray, radius: float = math.inf
) -> np.ndarray:
    """Slopes of horizons seen from samples, looking wherever the ray crosses a side of a triangle: exact."""
    a = math.radians(azimuth)
    dx, dy = np.linalg.solve(linear, [math.sin(a), math.cos(a)])
    best = np.zeros(len(row))
    for rate in (dx, dy, dx - dy, dx + dy):  # columns, rows, falling and rising diagonals per metre
        t = np.arange(1, 2 * max(h.shape)) / max(abs(rate), 1e-12)
        z = height_at(h, col[:, None] + dx * t, row[:, None] + dy * t)
        z[:, t > radius * (1 + 1e-9)] = np.nan
        best = np.fmax(best, np.nanmax(np.c_[(z - h[row, col][:, None]) / t, best], axis=1))
    return best


@pytest.mark.stress
@pytest.mark.parametrize("azimuth", [45, 135, *(pytest.param(one, marks=pytest.mark.stress) for one in (225, 315))])
@pytest.mark.parametrize("radius", [None, 14 * math.sqrt(2.0)])
def test_exact_along_diagonals(shared_data, azimuth, radius):
    """Roofs: walls stand between the samples of every other diagonal."""
    with rasterio.open(shared_data / "nrw-dom1-1m" / "dom1_32_356_5699_1_nw_2020.tif") as dem:
        h = dem.read(1)[300:430, 500:650]
    row, col = np.indices(h.shape).reshape(2, -1)
    truth = dense(h.astype(np.float64), SQUARE, azimuth, row, col, radius or math.inf)
    got = horizon(h, SQUARE, azimuth, radius=radius)
    np.testing.assert_allclose(got.ravel(), truth, atol=2e-6, rtol=2e-6)


@pytest.mark.cases(1)
@pytest.mark.parametrize(
    ("path", "off", "bias"),
    [
        ("bigtujunga-srtm30m-utm/srtm_bigtujunga30m_utm11.tif", 0.13, 0.03),
        ("lsd-topo/gabilan.tif", 0.03, 0.03),
        ("lsd-topo/Mandakini.tif", 0.3, 0.08),  # with voids
        ("fortbragg-1m-dem-ortho/elevation_2016.tif", 0.02, 0.03),
    ],
)
def test_near_a_dense_search_of_the_true_surface(shared_data, path, off, bias):
    """Without bias, and in the mean not more degrees off than this: what docs/light.md says."""
    with rasterio.open(shared_data / path) as dem:
        h = dem.read(1)[100:400, 100:400].astype(np.float64)
        h[h == dem.nodata] = np.nan
        linear = np.array([[dem.transform.a, 0], [0, dem.transform.e]])
    row, col = np.random.default_rng(1).integers(5, 295, (2, 700))
    row, col = row[there := np.isfinite(h[row, col])], col[there]
    errors = []
    for azimuth in np.arange(3.7, 360, 30):
        truth, ours = dense(h, linear, azimuth, row, col), horizon(h, linear, azimuth)[row, col]
        errors.append(np.degrees(np.arctan(ours)) - np.degrees(np.arctan(truth)))
    assert np.abs(errors).mean() < off
    assert abs(np.mean(errors)) < bias


# ---- closed forms of the sky view ----


def test_level_ground_sees_the_whole_sky():
    for measure in ("sky-view", "visible-sky", "sky-view-slope"):
        assert (sky_view(np.full((5, 7), 3, np.float32), SQUARE, 8, measure=measure) == 1).all()


def test_inclined_plane():
    # An endless plane of slope S: its own sky-view factor is (1 + cos S) / 2, whatever the aspect.
    row, col = np.indices((41, 41))
    for gx, gy in ((0.7, 0.0), (0.3, -0.6)):
        h = (gx * col - gy * row).astype(np.float32)
        got = sky_view(h, SQUARE, 32, measure="sky-view-slope")[20, 20]
        assert got == pytest.approx((1 + math.cos(math.atan(math.hypot(gx, gy)))) / 2, abs=2e-4)


def test_infinite_valley():
    # A V-shaped valley along north: from its floor the horizon rises as tan h = m·|sin az|.
    col = np.arange(-400, 401)
    h = np.repeat(np.abs(col)[None].astype(np.float32) * 0.8, 801, 0)
    t = 0.8 * np.abs(np.sin(np.radians(np.arange(64) * 360 / 64)))
    got = sky_view(h, SQUARE, 64)[400, 400]
    assert got == pytest.approx(1 - np.mean(t**2 / (1 + t**2)), abs=2e-3)
    assert sky_view(h, SQUARE, 64, measure="visible-sky")[400, 400] == pytest.approx(
        1 - np.mean(t / np.sqrt(1 + t**2)), abs=2e-3
    )


def test_round_pit_and_step():
    row, col = np.indices((401, 401)) - 200
    r = np.hypot(row, col)
    pit = np.minimum(r * r / 190, 190).astype(np.float32)
    # The rim stands at 45° all round: sin² h = 1/2, sin h = √½.
    assert sky_view(pit, SQUARE, 32)[200, 200] == pytest.approx(0.5, abs=3e-3)
    assert sky_view(pit, SQUARE, 32, measure="visible-sky")[200, 200] == pytest.approx(1 - math.sqrt(0.5), abs=3e-3)
    step = np.where(np.arange(1201) < 600, 0, 50).astype(np.float32)[None].repeat(1201, 0)
    # At distance x from an endless wall of height H the horizon is tan h = H·|sin az| / x over half the azimuths:
    # the cosine-weighted view of the sky is (1 + x / hypot(x, H)) / 2.
    got = sky_view(step, SQUARE, 64)[600, 599 - 49]
    assert got == pytest.approx((1 + 50 / math.hypot(50, 50)) / 2, abs=5e-3)


def test_hemispherical_pit():
    # Anywhere on the floor of a hemisphere sunk into level ground the rim hides half of the sky's solid angle or more;
    # a surface's own sky-view factor is one half exactly (a sphere's form factor is the same from everywhere inside).
    radius = 150
    row, col = np.indices((401, 401)) - 200
    r2 = (row**2 + col**2).astype(float)
    pit = np.where(r2 < radius**2, -np.sqrt(np.maximum(radius**2 - r2, 0)), 0).astype(np.float32)
    got = sky_view(pit, SQUARE, 64, measure="sky-view-slope")
    inner = r2 < (0.8 * radius) ** 2
    assert np.abs(got[inner] - 0.5).max() < 0.02
    assert np.abs(got[inner] - 0.5).mean() < 0.004


def test_threads_do_not_change_the_result():
    h = np.random.default_rng(5).normal(size=(150, 211)).astype(np.float32)
    h[20:30, 40:60] = np.nan
    for measure in ("sky-view", "sky-view-slope"):
        one, many = (sky_view(h, SQUARE, 16, measure=measure, jobs=j) for j in (1, 5))
        assert np.array_equal(one, many, equal_nan=True)


def test_published_sky_view(shared_data):
    """GRASS r.skyview: 1 − mean sin h over 16 directions."""
    with rasterio.open(shared_data / "fortbragg-1m-dem-ortho" / "elevation_2016.tif") as dem:
        h = dem.read(1)
    with rasterio.open(shared_data / "fortbragg-1m-dem-ortho" / "skyview_2016.tif") as published:
        truth = published.read(1)
    ours = sky_view(h, SQUARE, 16, measure="visible-sky")
    inner = np.s_[40:-40, 40:-40]
    assert np.nanmean(np.abs(ours - truth)[inner]) < 0.003


@pytest.mark.parametrize(
    "change", [{"heights": np.zeros(4)}, {"linear": np.zeros((2, 2))}, {"azimuths": 2}, {"measure": "openness"}]
)
def test_nonsense_is_refused(change):
    with pytest.raises(UsageError):
        sky_view(**({"heights": np.zeros((3, 3)), "linear": SQUARE} | change))
