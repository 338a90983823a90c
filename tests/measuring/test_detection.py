"""What of a difference is significant, and the error of its volumes, against NumPy and repeated draws of errors."""

from __future__ import annotations

import math

import numpy as np
import pytest
import rasterio
from affine import Affine
from click.testing import CliRunner

import orograph
from orograph.cli import cli
from orograph.errors import ReadError, UsageError
from orograph.measuring import HeightError, differing
from orograph.measuring.height_error import ErrorField

PLACE = Affine(30, 0, 500_000, 0, -40, 4_000_000)
CELL = 1200 / 0.9996**2  # UTM's scale on its central meridian
T = 1.959963984540054


def raster(heights, place=PLACE):
    heights = np.asarray(heights, np.float32)
    return orograph.Dem(heights, orograph.Grid(heights.shape, place, "EPSG:32611"))


@pytest.fixture(scope="module")
def pair():
    rng = np.random.default_rng(3)
    second = 500 + rng.normal(0, 3, (50, 60))
    first = second + rng.normal(0, 1, second.shape)
    first[4:9, 7:30] = np.nan
    return raster(first), raster(second)


@pytest.mark.parametrize("block", [17, 1024])
def test_volumes_are_of_what_is_significant(pair, monkeypatch, block):
    monkeypatch.setattr(differing, "BLOCK", block)
    sigma = np.linspace(0.2, 0.6, 60, dtype=np.float32) * np.ones((50, 1), np.float32)
    found = orograph.difference(*pair, sigma=(0.3, sigma))
    d = (pair[0].heights - pair[1].heights).astype(np.float64)
    both = np.hypot(0.3, sigma.astype(np.float64))
    sure = np.abs(d) > T * both
    told, known = found.statistics, found.statistics.detected
    assert known.count == sure.sum() and known.area == pytest.approx(sure.sum() * CELL, rel=1e-6)
    assert (known.lowest, known.highest) == pytest.approx((T * both.min(), T * both.max()), rel=1e-6)
    up, down = sure & (d > 0), sure & (d < 0)
    assert (told.gain, told.loss) == pytest.approx((d[up].sum() * CELL, -d[down].sum() * CELL), rel=1e-5)
    assert told.gain_area == pytest.approx(up.sum() * CELL, rel=1e-6)
    assert known.gain_error == pytest.approx(T * CELL * math.sqrt((both[up] ** 2).sum()), rel=1e-3)
    assert known.net_error == pytest.approx(math.hypot(known.gain_error, known.loss_error), rel=1e-6)
    plain = orograph.difference(*pair).statistics
    assert (known.whole_gain, known.whole_loss) == (plain.gain, plain.loss) and plain.detected is None
    assert (told.mean, told.nmad) == (plain.mean, plain.nmad)
    np.testing.assert_allclose(found.significance, d / both, rtol=1e-5)


@pytest.mark.parametrize("reach", [0.0, 200.0, 1e6])
def test_errors_of_volumes_are_those_of_drawn_terrains(reach):
    """The volume between two draws of one level ground, of which all is summed."""
    shape, sigma = (60, 80), 0.5
    ground = raster(np.zeros(shape))
    above = raster(np.full(shape, 50.0))
    known = orograph.difference(above, ground, sigma=(sigma, 0.0), range=reach).statistics.detected
    if reach == 1e6:  # (all errors are one: no more than that)
        assert known.gain_error == pytest.approx(T * sigma * 60 * 80 * CELL, rel=1e-5)
        return
    field = ErrorField(orograph.terrain(ground), HeightError(sigma, reach))
    volumes = [field.window(k, 0, 60, 0, 80).sum() * 1200 for k in range(300)]
    drawn = T * np.std(volumes)
    # 300 draws are within 13 % (3 standard errors); neighbours beyond the border make the bound larger.
    assert drawn * 0.87 < known.gain_error < drawn * (1.13 if reach == 0 else 1.35)


def test_files_and_pictures_tell_what_is_significant(pair, tmp_path):
    found = orograph.difference(*pair, tmp_path / "d.tif", sigma=0.4)
    with rasterio.open(tmp_path / "d.tif") as file:
        assert file.descriptions == ("difference", "significance") and "95 %" in str(file.tags(2))
        np.testing.assert_array_equal(file.read(2), found.significance)
    picture = found.render(size=(400, 300))
    assert "Significant change" in picture.describe()
    sure = np.abs(found.values[np.abs(found.significance) > T])
    assert found.limit >= np.nanquantile(sure, 0.95) > orograph.difference(*pair).limit / 2
    assert "significant at 95 %: beyond ± 1.11 m" in repr(found) and "±" in dict(found.rows())["net"]


def test_the_command_line_says_the_same(pair, tmp_path):
    a, b = (orograph.export(one, tmp_path / f"{name}.tif") for one, name in zip(pair, "ab"))
    run = ["difference", str(a), str(b), "--sigma", "0.4", "--sigma", "0.3", "--range", "100", "--confidence", "0.9"]
    done = CliRunner().invoke(cli, run)
    told = dict(orograph.difference(a, b, sigma=(0.4, 0.3), range=100.0, confidence=0.9).rows())
    assert done.exit_code == 0 and told["significant"] in done.output and told["gain"] in done.output


@pytest.mark.parametrize(("how", "words"), [
    ({"sigma": 0.0}, "at least one"), ({"sigma": -1.0}, "0 or more"), ({"sigma": (1, 2, 3)}, "two, not 3"),
    ({"sigma": 1.0, "confidence": 1.0}, "between 0 and 1"), ({"range": 5.0}, "whose size `sigma` gives"),
])  # fmt: skip
def test_mistakes(pair, how, words):
    with pytest.raises(UsageError, match=words):
        orograph.difference(*pair, **how)


def test_a_map_of_deviations_must_cover_what_is_compared(pair):
    sigma = np.ones((50, 60), np.float32)
    sigma[20:30, 40:50] = np.nan
    with pytest.raises(ReadError, match="no value at 100 samples"):
        orograph.difference(*pair, sigma=sigma)
