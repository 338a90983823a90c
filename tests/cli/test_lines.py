"""Contour lines and silhouettes as the command line has them."""

from __future__ import annotations

import json

import numpy as np
import pytest
import rasterio
from affine import Affine
from PIL import Image


@pytest.fixture
def dem(tmp_path):
    y, x = np.mgrid[:120, :150] * 30.0
    heights = (500 + 200 * np.sin(x / 400) * np.cos(y / 350)).astype(np.float32)
    path = tmp_path / "dem.tif"
    with rasterio.open(path, "w", driver="GTiff", height=120, width=150, count=1, dtype="float32", crs="EPSG:32611",
                       transform=Affine(30, 0, 500_000, 0, -30, 4_000_000)) as file:  # fmt: skip
        file.write(heights, 1)
    return path


def rendered(run, dem, tmp_path, *options):
    code, out, err = run("render", dem, "-o", tmp_path / "p.png", "--size", "240x160", "--json", "--quiet", *options)
    assert code == 0, err
    return json.loads(out), np.asarray(Image.open(tmp_path / "p.png").convert("RGB")).astype(int)


@pytest.mark.stress
def test_contours_by_interval_and_by_themselves(run, dem, tmp_path):
    _, bare = rendered(run, dem, tmp_path)
    told, lines = rendered(run, dem, tmp_path, "--contours", "25", "--contour-index", "4", "--no-contour-labels")
    assert told["shader"]["contours"] == {"interval_m": 25.0, "index": 4, "labels": 0}
    assert 0.02 < (np.abs(lines - bare).max(-1) > 20).mean() < 0.6
    told, _ = rendered(run, dem, tmp_path, "--contours", "auto", "--projection", "plan")
    assert told["shader"]["contours"]["interval_m"] > 0
    _, faint = rendered(run, dem, tmp_path, "--contours", "25", "--contour-opacity", "0", "--no-contour-labels")
    assert np.abs(faint - bare).max() <= 60  # what is antialiased may differ


@pytest.mark.stress
def test_silhouettes(run, dem, tmp_path):
    low = ("--lonlat", "-116.999,36.12,800", "--look-at", "-116.985,36.135")
    _, bare = rendered(run, dem, tmp_path, *low)
    _, lines = rendered(run, dem, tmp_path, *low, "--silhouettes", "--silhouette-width", "3")
    assert 0.001 < (bare - lines > 20).any(-1).mean() < 0.2
    drawn = [
        rendered(run, dem, tmp_path, *low, "--silhouettes", "--silhouette-width", "3", "--creases", heavy)[1]
        for heavy in ("0.6", "0", "1")
    ]
    assert np.array_equal(drawn[0], lines)  # the default
    inked = [(bare - picture).clip(0).sum() for picture in drawn]
    assert inked[1] < inked[0] < inked[2]


@pytest.mark.parametrize(
    "options",
    [
        ("--contours", "0"),
        ("--contours", "some"),
        ("--contour-index", "-1"),
        ("--silhouette-width", "99"),
        ("--creases", "2"),
    ],
)
def test_what_makes_no_sense_is_refused(run, dem, tmp_path, options):
    code, _, err = run("render", dem, "-o", tmp_path / "p.png", *options)
    assert code == 2 and options[0] in err
