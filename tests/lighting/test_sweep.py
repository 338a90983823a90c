"""Sweeps out of core: bands, threads and memory change nothing; a radius and a round body against brute force."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyproj import CRS

from orograph.errors import UsageError
from orograph.lighting import sweep_lines
from orograph.lighting.horizon import horizon
from orograph.lighting.sweep import curvature_of, fold, horizons, passes_of, ways
from orograph.lighting.sweep import swept as done
from orograph.lighting.sweep_pass import Terms, reach_of

SQUARE = np.array([[1.0, 0.0], [0.0, -1.0]])


def rough(rows: int, cols: int, seed: int = 0, missing: float = 0.0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    h = rng.normal(size=(rows, cols)).cumsum(1).astype(np.float32)
    h[rng.random(h.shape) < missing] = np.nan
    return h


def swept(h: np.ndarray, linear: np.ndarray, azimuths: np.ndarray, **how) -> tuple[np.ndarray, np.ndarray]:
    """(k, rows, cols) slopes, and how often each sample came."""
    out = np.full((len(azimuths), *h.shape), np.inf, np.float32)
    came = np.zeros(out.shape, int)

    def read(row0: int, row1: int, col0: int, col1: int) -> np.ndarray:
        assert 0 <= row0 < row1 <= h.shape[0] and 0 <= col0 < col1 <= h.shape[1]
        return h[row0:row1, col0:col1]

    for block in done(horizons(read, h.shape, linear, np.asarray(azimuths, float), **how), how.get("jobs")):
        at = np.ix_(block.azimuths, range(block.row0, block.row1), range(block.col0, block.col1))
        out[at] = block.slopes
        came[at] += 1
    return out, came


@pytest.mark.parametrize("below", [False, True])
def test_how_heights_lie_in_memory_changes_no_bit(below):
    """Rows of 128 samples or a multiple are copied apart where azimuths share them; windows are read in place."""
    wide = rough(40, 400, 5, 0.05)
    azimuths = np.array([0.0, 20.0, 90.0, 110.0, 190.0, 280.0])
    plain, _ = swept(np.ascontiguousarray(wide[:, 7:263]), SQUARE, azimuths, below=below)
    for h in (wide[:, 7:263], np.asfortranarray(wide[:, 7:263]), np.repeat(wide[:, 7:263], 2, axis=0)[::2]):
        assert np.array_equal(swept(h, SQUARE, azimuths, below=below)[0], plain, equal_nan=True)
    for k, azimuth in enumerate(azimuths):
        alone, _ = swept(wide[:, 7:263], SQUARE, np.array([azimuth]), below=below)
        assert np.array_equal(alone[0], plain[k], equal_nan=True)


@settings(max_examples=25, deadline=None)
@given(
    st.integers(1, 60), st.integers(1, 60), st.integers(0, 99), st.integers(1, 40), st.integers(1, 3),
    st.floats(0.5, 2.0), st.sampled_from([None, 1.0, 7.5, 30.0]), st.sampled_from([0.0, 1e-4]),
)  # fmt: skip
def test_bands_and_threads_change_no_bit(rows, cols, seed, band, jobs, ratio, radius, bend):
    h = rough(rows, cols, seed, 0.1)
    linear = np.array([[1.0, 0.2], [0.1, -ratio]])
    azimuths = np.array([0, 13.5, 45, 90, 100, 180, 222.2, 270, 301, 333.3])
    how = {"radius": radius, "curvature": bend, "lowest": -np.inf}
    whole, once = swept(h, linear, azimuths, jobs=1, band=64, **how)
    parts, came = swept(h, linear, azimuths, jobs=jobs, band=band, **how)
    assert (once == 1).all() and (came == 1).all()
    assert np.array_equal(whole, parts, equal_nan=True)
    assert np.array_equal(np.isnan(parts), np.broadcast_to(np.isnan(h), parts.shape))


@pytest.mark.parametrize("radius", [None, 40.0])
def test_memory_changes_no_bit(radius, monkeypatch):
    h = rough(300, 500, 1)
    azimuths = np.arange(16) * 22.5
    plenty, _ = swept(h, SQUARE, azimuths, radius=radius)
    taken = []
    scratch = sweep_lines.scratch
    monkeypatch.setattr(sweep_lines, "scratch", lambda length: taken.append(length) or scratch(length))
    little, came = swept(h, SQUARE, azimuths, radius=radius, memory=600_000)
    assert (came == 1).all() and np.array_equal(plenty, little)
    assert bool(taken) == (radius is None)  # stacks went to a scratch file


def brute_row(z: np.ndarray, reach: int, bend: float = 0.0, lowest: float = -np.inf) -> np.ndarray:
    """One line, the light at its beginning: every pair."""
    out = np.full(len(z), np.nan)
    for i in np.flatnonzero(~np.isnan(z)):
        d = np.arange(1, min(reach, i) + 1, dtype=float)
        seen = (z[i - d.astype(int)].astype(float) - z[i]) / d - bend * d / 2
        out[i] = max([lowest, *seen[~np.isnan(seen)]])
    return out


@pytest.mark.stress
@settings(max_examples=60, deadline=None)
@given(
    st.integers(0, 2**31), st.integers(1, 80), st.integers(1, 90), st.floats(0, 0.6), st.sampled_from([0, 1e-3, 0.3])
)
def test_radius_and_curvature_against_every_pair(seed, length, reach, missing, bend):
    rng = np.random.default_rng(seed)
    z = (rng.normal(size=length).cumsum() * rng.choice([0.1, 1, 10])).astype(np.float32)
    z[rng.random(length) < missing] = np.nan
    if rng.random() < 0.3:
        z = np.round(z)  # ties
    for heights, azimuth in ((z[None], 270.0), (z[None, ::-1], 90.0), (z[:, None], 0.0), (z[::-1, None], 180.0)):
        got = horizon(heights, SQUARE, azimuth, lowest=-np.inf, radius=float(reach), curvature=bend).ravel()
        got = got[::-1] if azimuth in (90.0, 180.0) else got
        np.testing.assert_allclose(got, brute_row(z, reach, bend), rtol=2e-6, atol=1e-6)


def test_a_radius_beyond_the_raster_is_no_radius():
    h = rough(70, 90, 4, 0.05)
    for azimuth in (0.0, 33.0, 90.0, 200.0):
        limited = horizon(h, SQUARE, azimuth, radius=1000.0)
        np.testing.assert_allclose(limited, horizon(h, SQUARE, azimuth), rtol=1e-6, atol=1e-6)


def test_radius_is_in_metres_along_the_azimuth():
    h = np.zeros((41, 41), np.float32)
    h[0, 40] = 10.0
    # Cells 2 m × 1 m: the tower is 40 m east and 20 m north of the middle.
    linear, azimuth = np.array([[2.0, 0], [0, -1.0]]), math.degrees(math.atan2(40, 20))
    distance = math.hypot(40, 20)
    assert horizon(h, linear, azimuth, radius=distance - 2)[20, 20] == 0
    assert horizon(h, linear, azimuth, radius=distance + 1e-6)[20, 20] == pytest.approx(10 / distance, rel=1e-5)


def test_on_a_round_body_the_sea_falls_away():
    # From height a over a level sea the horizon dips by sqrt(2 a / r); a mountain of height b disappears below the
    # horizon beyond sqrt(2 r) (sqrt(a) + sqrt(b)).
    bend = curvature_of(None)
    r, cell, eye = 1 / bend, 200.0, 50.0
    h = np.zeros((1, 2000), np.float32)
    h[0, 0] = eye
    linear = np.array([[cell, 0], [0, -cell]])
    assert horizon(h, linear, 90.0, lowest=-np.inf, curvature=bend)[0, 0] == pytest.approx(
        -math.sqrt(2 * eye / r), rel=1e-3
    )
    top = 400.0
    limit = math.sqrt(2 * r) * (math.sqrt(eye) + math.sqrt(top))
    for factor, seen in ((0.98, True), (1.02, False)):
        mountain = h.copy()
        mountain[0, round(factor * limit / cell)] = top
        dip = horizon(mountain, linear, 90.0, lowest=-np.inf, curvature=bend)[0, 0]
        assert (dip > -math.sqrt(2 * eye / r) * 0.999) == seen


def test_curvature_and_refraction_are_those_of_the_body():
    assert curvature_of(None, 0.0) == pytest.approx(1 / 6_371_008.8)
    assert curvature_of(CRS.from_epsg(32611)) == pytest.approx(0.87 / 6_371_008.8, rel=1e-6)  # Gauss: k = 0.13
    moon = CRS.from_proj4("+proj=eqc +R=1737400 +units=m")
    assert curvature_of(moon, 0.0) == pytest.approx(1 / 1_737_400)


def test_a_sea_on_a_round_body_goes_to_scratch_and_stays_right(monkeypatch):
    taken = []
    scratch = sweep_lines.scratch
    monkeypatch.setattr(sweep_lines, "scratch", lambda length: taken.append(length) or scratch(length))
    h = np.zeros((64, 4000), np.float32)
    bend = curvature_of(None)
    got, _ = swept(h, SQUARE * 30, np.array([270.0]), lowest=-np.inf, curvature=bend, memory=2_000_000)
    assert taken  # every sample is on the hull
    np.testing.assert_allclose(got[0, :, 1:], -30 * bend / 2, rtol=1e-3)  # each sees its neighbour, half a step below


@pytest.mark.stress
def test_a_sweep_stays_within_its_memory():
    """Of a raster that is nowhere whole; threads and stacks included."""
    import tracemalloc

    rows, cols, memory = 2500, 3000, 40 << 20

    def read(row0: int, row1: int, col0: int, col1: int) -> np.ndarray:
        row, col = np.ogrid[row0:row1, col0:col1]
        return (50 * np.sin(row * 0.7) * np.cos(col * 0.4) + (row * col) % 7).astype(np.float32)

    azimuths = np.arange(16) * 22.5
    for _ in done(horizons(read, (40, 40), SQUARE, azimuths, jobs=2), 2):
        pass
    tracemalloc.start()
    try:
        for _ in done(horizons(read, (rows, cols), SQUARE, azimuths, memory=memory, jobs=2), 2):
            pass
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < memory


def test_upside_down():
    h = rough(30, 40, 8)
    up, _ = swept(-h, SQUARE, np.array([77.0]))
    down, _ = swept(h, SQUARE, np.array([77.0]), below=True)
    assert np.array_equal(up, down)


@pytest.mark.parametrize("azimuth", [45.0, 135.0, 225.0, 315.0, 80.0, 190.0])
@pytest.mark.parametrize("radius", [None, 7.0, 40.0])
def test_all_heights_that_a_band_is_made_of_are_read(azimuth, radius):
    """Lines along diagonals look at cells that begin one step nearer to the light than the steps in reach."""
    (way,) = ways(np.array([azimuth]), np.diag([1.0, -1.0]), (90, 120))
    (each,) = passes_of(way, (90, 120), Terms(radius=radius), 1, 1 << 26, band=16)
    (lines,) = way
    for s0, s1 in each.bands:
        strip = each.fetch(lambda r0, r1, c0, c1: np.zeros((r1 - r0, c1 - c0), np.float32), s0, s1, [])
        h0, h1 = (s0, s1) if radius is None else reach_of(lines, radius, s0, s1)[1:]
        wanted = (h0, min(h1 + 1, each.steps)) if each.backward else (max(h0 - 1, 0), h1)
        steps = strip.wide if each.by_columns else -(-len(strip.flat) // strip.wide)
        assert strip.first <= wanted[0] and strip.first + steps >= wanted[1]


def test_a_radius_too_large_for_the_memory_is_refused():
    with pytest.raises(UsageError, match="radius"):
        swept(rough(400, 4000), SQUARE, np.array([90.0]), radius=2000.0, memory=1 << 20)


@pytest.mark.parametrize("jobs", [1, 2, 5])
@pytest.mark.parametrize(("radius", "memory"), [(None, 1 << 30), (None, 100_000), (9.0, 1 << 30), (9.0, 120_000)])
def test_blocks_used_while_the_next_are_swept_are_those_that_were_made(jobs, radius, memory):
    """Bands of a few steps, so that threads meet at every block; the second memory is too little to read ahead."""
    h, azimuths = rough(90, 120, 11, 0.05), np.arange(7) * 52.0
    want, _ = swept(h, SQUARE, azimuths, radius=radius, jobs=1, band=90)
    got, came = np.full(want.shape, np.inf, np.float32), np.zeros(want.shape, int)
    order: list[tuple[int, int]] = []

    def add(block, first, last):
        at = np.ix_(block.azimuths, range(block.row0 + first, block.row0 + last), range(block.col0, block.col1))
        got[at] = block.slopes[:, first:last]
        came[at] += 1

    def after(block):
        at = np.ix_(block.azimuths, range(block.row0, block.row1), range(block.col0, block.col1))
        assert (came[at] == 1).all()  # all of it has been used
        order.append((block.row0, block.col0))

    for band in (7, None):
        got[:], came[:] = np.inf, 0
        order.clear()
        blocks = horizons(
            lambda r0, r1, c0, c1: h[r0:r1, c0:c1].copy(), h.shape, SQUARE, azimuths, radius=radius, jobs=jobs,
            memory=memory, band=band,
        )  # fmt: skip
        fold(blocks, add, jobs, after)
        assert (came == 1).all() and len(order) >= 4
        assert np.array_equal(got, want, equal_nan=True)
