"""Synthetic terrain: the same to the byte however it is made, drained like land, never half-written."""

from __future__ import annotations

import math
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import rasterio
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from orograph.dem.erosion import drainage, stream_power
from orograph.dem.mosaic import Mosaic
from orograph.dem.noise import feature_points, fractal, gradient_noise, gullies, hashed
from orograph.dem.synth import Synth, _doubled, parse_size
from orograph.errors import OutputError, UsageError

SHAPE = (620, 830)


@pytest.fixture(scope="module")
def terrain() -> tuple[Synth, NDArray[np.float32]]:
    synth = Synth(SHAPE, 5)
    return synth, synth.read(0, SHAPE[0], 0, SHAPE[1])


# -- noise ------------------------------------------------------------------------------------------------------------


def reference_noise(x: float, y: float, seed: int) -> float:
    """Perlin's improved noise, written out over the four corners."""
    i, j = math.floor(x), math.floor(y)
    total = 0.0
    for dj in (0, 1):
        for di in (0, 1):
            h = hashed(i + di, j + dj, seed)
            gx, gy = (h & 0xFFFF) / 32767.5 - 1, (h >> 16) / 32767.5 - 1
            s, t = x - i - di, y - j - dj
            fade = [1 - (6 * abs(d) ** 5 - 15 * abs(d) ** 4 + 10 * abs(d) ** 3) for d in (s, t)]
            total += (gx * s + gy * t) * fade[0] * fade[1]
    return 1.3 * total


@given(st.floats(-1e4, 1e4), st.floats(-1e4, 1e4), st.integers(0, 2**31 - 1))
@settings(max_examples=100, deadline=None)
def test_gradient_noise_is_perlins(x: float, y: float, seed: int) -> None:
    assert gradient_noise(x, y, seed) == pytest.approx(reference_noise(x, y, seed), abs=1e-9)


def test_hash_is_uniform_and_uncorrelated() -> None:
    values = np.array([[hashed(i, j, 3) for i in range(-60, 60)] for j in range(-60, 60)])
    for bits in (values & 0xFFFF, values >> 16):
        u = bits / 65535 - 0.5
        assert abs(u.mean()) < 0.01 and abs(u.std() - 12**-0.5) < 0.01
        for shift in ((0, 1), (1, 0), (1, 1)):
            assert abs(np.mean(u * np.roll(u, shift, (0, 1)))) < 0.003


def test_octaves_have_no_preferred_lattice() -> None:
    """At the lattice points of the first octave, where it is 0, the sum is not."""
    y, x = np.meshgrid(np.arange(40.0), np.arange(40.0), indexing="ij")
    out = np.empty_like(x)
    fractal(x, y, 1, 0.5, 1, out)
    assert np.abs(out).max() == 0
    fractal(x, y, 4, 0.5, 1, out)
    assert 0.05 < out.std() < 0.5 and abs(out.mean()) < 0.05


def test_gullies_follow_the_slope_and_leave_flats_alone() -> None:
    """On a plane that falls eastwards, furrows vary from north to south much more than along the fall."""
    n = 96
    plane = np.broadcast_to(-0.5 * np.arange(n + 2.0), (n + 2, n + 2)).copy()
    px, py = np.empty((20, 20)), np.empty((20, 20))
    feature_points(-2, -2, 9, px, py)
    out = np.empty((n, n))
    gullies(plane, 0, 0, 8.0, (1.0, 0.0), (px, py, -2, -2), 0.1, 0.1, 0.9, out)
    furrows = out - plane[1:-1, 1:-1]
    assert np.abs(np.diff(furrows, axis=0)).mean() > 2 * np.abs(np.diff(furrows, axis=1)).mean()
    deep = 0.1 * 8 * 0.5 * (0.5 / 0.6) / (1 + 0.5 / 0.9)
    assert 0.3 * deep < furrows.std() < deep and np.abs(furrows).max() <= deep + 1e-9
    flat = np.full((n + 2, n + 2), 3.0)
    gullies(flat, 0, 0, 8.0, (1.0, 0.0), (px, py, -2, -2), 0.1, 0.1, 0.9, out)
    assert (out == 3).all()


# -- erosion ----------------------------------------------------------------------------------------------------------


def rim(shape: tuple[int, int]) -> NDArray[np.bool_]:
    outlet = np.zeros(shape, bool)
    outlet[[0, -1]] = outlet[:, [0, -1]] = True
    return outlet


@pytest.mark.parametrize("seed", range(4))
def test_drainage_reaches_the_border_without_cycles(seed: int) -> None:
    heights = np.random.default_rng(seed).random((31, 43))
    outlet = rim(heights.shape)
    order, receiver = np.empty(heights.size, np.int64), np.empty(heights.size, np.int64)
    drainage(heights, outlet, seed, order, receiver)
    assert sorted(order) == list(range(heights.size))
    rank = np.empty(heights.size, np.int64)
    rank[order] = np.arange(heights.size)
    inner = np.flatnonzero(~outlet.ravel())
    assert (rank[receiver[inner]] < rank[inner]).all()
    rows, cols = inner // 43, inner % 43
    assert (np.maximum(np.abs(receiver[inner] // 43 - rows), np.abs(receiver[inner] % 43 - cols)) == 1).all()
    assert (receiver[outlet.ravel()] == np.flatnonzero(outlet.ravel())).all()


def test_drainage_of_a_slope_runs_down_it() -> None:
    heights = np.add.outer(np.zeros(9), np.arange(12.0))
    order, receiver = np.empty(heights.size, np.int64), np.empty(heights.size, np.int64)
    drainage(heights, rim(heights.shape), 1, order, receiver)
    inner = np.flatnonzero(~rim(heights.shape).ravel())
    assert (receiver[inner] % 12 == inner % 12 - 1).all()  # straight or diagonal: the chance decides, but always down


def test_stream_power_reaches_its_steady_state() -> None:
    """Where U and K √A S balance, S = U / (K √A) along every river (no place for slides)."""
    shape = (24, 30)
    heights = np.random.default_rng(0).random(shape) * 0.1
    outlet = rim(shape)
    heights[outlet] = 0
    order, receiver = np.empty(heights.size, np.int64), np.empty(heights.size, np.int64)
    ones = np.ones(shape)
    drainage(heights, outlet, 1, order, receiver)
    for _ in range(300):
        stream_power(heights, 2 * ones, 0.5 * ones, outlet, order, receiver, 3.0, 5.0, math.inf)
    area = np.full(heights.size, 9.0)
    for cell in order[::-1]:
        if receiver[cell] != cell:
            area[receiver[cell]] += area[cell]
    inner = np.flatnonzero(~outlet.ravel())
    to = receiver[inner]
    length = 3.0 * np.hypot(to // 30 - inner // 30, to % 30 - inner % 30)
    slope = (heights.flat[inner] - heights.flat[to]) / length
    assert np.allclose(slope, 2 / (0.5 * np.sqrt(area[inner])), rtol=1e-3)


def test_slides_limit_the_slope() -> None:
    heights = np.zeros((20, 20))
    order, receiver = np.empty(400, np.int64), np.empty(400, np.int64)
    outlet = rim(heights.shape)
    for _ in range(50):
        drainage(heights, outlet, 1, order, receiver)
        stream_power(heights, np.ones((20, 20)), np.full((20, 20), 1e-3), outlet, order, receiver, 1.0, 1.0, 0.7)
    to = receiver.reshape(20, 20)
    r, c = np.indices(heights.shape)
    length = np.hypot(to // 20 - r, to % 20 - c)
    assert ((heights - heights.flat[to]) <= 0.7 * length + 1e-9).all() and heights.max() > 3


# -- the terrain ------------------------------------------------------------------------------------------------------


def test_doubling_is_cubic_b_spline_subdivision() -> None:
    """It reproduces every cubic polynomial up to its constant second derivative: planes to the digit."""
    j, i = np.indices((12, 14)).astype(float)
    fine = _doubled(3 * i - 2 * j + 1, 4, 19, 3, 22)
    r, c = np.meshgrid(np.arange(4, 19), np.arange(3, 22), indexing="ij")
    assert np.allclose(fine, 1.5 * c - r + 1)
    square = _doubled(i * i, 4, 19, 4, 22)
    assert np.allclose(np.diff(square, 2, axis=1), 0.5)


@given(st.data())
@settings(max_examples=40, deadline=None)
def test_windows_are_the_same_to_the_bit(terrain: tuple[Synth, NDArray[np.float32]], data: st.DataObject) -> None:
    synth, whole = terrain
    row0, col0 = data.draw(st.integers(0, SHAPE[0] - 1)), data.draw(st.integers(0, SHAPE[1] - 1))
    row1 = data.draw(st.integers(row0 + 1, min(SHAPE[0], row0 + 70)))
    col1 = data.draw(st.integers(col0 + 1, min(SHAPE[1], col0 + 70)))
    assert np.array_equal(synth.read(row0, row1, col0, col1), whole[row0:row1, col0:col1])


def test_it_is_a_landscape(terrain: tuple[Synth, NDArray[np.float32]]) -> None:
    """Plains and mountains, slopes that stand, the relief that was asked for, valleys that drain."""
    synth, heights = terrain
    assert np.isfinite(heights).all() and heights.dtype == np.float32
    assert np.ptp(heights) == pytest.approx(synth.relief, rel=0.15)
    dy, dx = np.gradient(heights.astype(float), synth.spacing)
    slope = np.degrees(np.arctan(np.hypot(dx, dy)))
    assert np.percentile(slope, 10) < 5 and np.percentile(slope, 90) > 20 and slope.max() < 75
    # fine furrows make closed hollows, but shallow ones: water finds its way
    coarse = heights[::8, ::8].astype(float)
    order, receiver = np.empty(coarse.size, np.int64), np.empty(coarse.size, np.int64)
    drainage(coarse, rim(coarse.shape), 1, order, receiver)
    uphill = coarse.ravel()[receiver] > coarse.ravel() + 0.01 * synth.relief
    assert uphill.mean() < 0.02


@pytest.mark.stress
def test_seed_shape_and_roughness_matter(terrain: tuple[Synth, NDArray[np.float32]]) -> None:
    whole = terrain[1]
    assert np.abs(Synth(SHAPE, 6).read(0, 64, 0, 64) - whole[:64, :64]).max() > 1
    smooth = Synth(SHAPE, 5, roughness=0).read(0, *SHAPE[:1], 0, SHAPE[1])
    bend = lambda h: np.abs(np.diff(h, 2, axis=1)).mean()  # noqa: E731
    assert bend(smooth) < 0.9 * bend(whole)
    assert np.corrcoef(smooth.ravel(), whole.ravel())[0, 1] > 0.97


@pytest.mark.parametrize("shape", [(2, 2), (2, 900), (17, 3), (257, 65)])
def test_any_shape(shape: tuple[int, int]) -> None:
    synth = Synth(shape, 1)
    heights = synth.read(0, shape[0], 0, shape[1])
    assert heights.shape == shape and np.isfinite(heights).all()


def test_relief_spacing_and_scale() -> None:
    low = Synth((300, 300), 2, relief=50, spacing=2)
    heights = low.read(0, 300, 0, 300)
    assert np.ptp(heights) == pytest.approx(50, rel=0.25)
    assert low.quantum <= 2 / 4000
    with pytest.raises(ValueError, match="window"):
        low.read(0, 301, 0, 300)


@pytest.mark.parametrize(
    ("shape", "more"),
    [((1, 5), {}), ((5, 5), {"spacing": 0}), ((5, 5), {"relief": -1}), ((5, 5), {"spacing": float("nan")})],
)
def test_senseless_requests(shape: tuple[int, int], more: dict[str, float]) -> None:
    with pytest.raises(UsageError):
        Synth(shape, 1, **more)  # type: ignore[arg-type]


def test_sizes_on_the_command_line() -> None:
    assert parse_size("4097") == (4097, 4097) and parse_size("20x30") == (20, 30) == parse_size(" 20 × 30 ")
    for text in ("", "x", "1", "20x", "-5", "3.5", "1x9"):
        with pytest.raises(UsageError, match="2049x4097"):
            parse_size(text)


# -- the file ---------------------------------------------------------------------------------------------------------


@pytest.mark.stress
def test_the_file_is_the_terrain_whatever_the_jobs(terrain: tuple[Synth, NDArray[np.float32]], tmp_path: Path) -> None:
    synth, whole = terrain
    for jobs in (1, 3):
        Synth(SHAPE, 5).write(tmp_path / f"{jobs}.tif", jobs=jobs)
    assert (tmp_path / "1.tif").read_bytes() == (tmp_path / "3.tif").read_bytes()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["1.tif", "3.tif"]
    with rasterio.open(tmp_path / "1.tif") as file:
        assert np.array_equal(file.read(1), whole)
        assert file.block_shapes == [(512, 512)] and file.crs.to_epsg() == 32633
        assert tuple(file.transform[:6]) == tuple(synth.grid.transform[:6])
    m = Mosaic.open(tmp_path / "1.tif")
    assert m.lossless and m.grid.shape == SHAPE and not m.warnings


@pytest.mark.parametrize("compress", ["deflate", "none"])
def test_compression_loses_nothing(compress: str, tmp_path: Path) -> None:
    synth = Synth((70, 90), 3)
    synth.write(tmp_path / "a.tif", compress=compress)
    with rasterio.open(tmp_path / "a.tif") as file:
        assert np.array_equal(file.read(1), synth.read(0, 70, 0, 90))


def test_a_file_that_cannot_be_written(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="no folder"):
        Synth((20, 20), 1).write(tmp_path / "missing" / "a.tif")


def test_an_error_leaves_what_was_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.tif"
    path.write_bytes(b"before")
    synth = Synth(SHAPE, 1)
    read = Synth.read

    def failing(self: Synth, row0: int, *rest: int) -> NDArray[np.float32]:
        if row0 > 0:
            raise OSError("disk full")
        return read(self, row0, *rest)

    monkeypatch.setattr(Synth, "read", failing)
    with pytest.raises(OutputError, match="disk full"):
        synth.write(path)
    assert path.read_bytes() == b"before" and list(tmp_path.iterdir()) == [path]


@pytest.mark.stress
@pytest.mark.skipif(os.name == "nt", reason="POSIX signals")
def test_interrupt_leaves_no_file(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "orograph", "synth", "-o", str(tmp_path / "a.tif"), "--size", "9000"]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        deadline = time.time() + 60
        while not list(tmp_path.iterdir()) and process.poll() is None and time.time() < deadline:
            time.sleep(0.05)
        assert [p.name for p in tmp_path.iterdir()] != ["a.tif"], "it was not being written"
        time.sleep(0.3)
        process.send_signal(signal.SIGINT)
        assert process.wait(30) == 130
    finally:
        process.kill()
        process.wait()
    assert list(tmp_path.iterdir()) == []


def test_the_verb(tmp_path: Path) -> None:
    from orograph.cli import cli

    path = tmp_path / "hills.tif"
    result = CliRunner().invoke(cli, ["-q", "synth", "-o", str(path), "--size", "40x60", "--seed", "3"])
    assert result.exit_code == 0, result.output
    assert "40 × 60 samples" in result.output
    with rasterio.open(path) as file:
        assert file.shape == (40, 60)
    bad = CliRunner().invoke(cli, ["-q", "synth", "-o", str(tmp_path / "new.tif"), "--crs", "EPSG:4326"])
    assert isinstance(bad.exception, UsageError)
