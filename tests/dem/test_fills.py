"""Voids filled with a number, and codes taken for heights, are suspected; seas, lakes and clipped ground are not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine
from scipy.ndimage import gaussian_filter

from orograph.dem import Source
from orograph.dem.inspect import doubtful_heights, suspicions
from orograph.dem.statistics import statistics


def ground(shape: tuple[int, int], low: float, high: float, seed: int = 1) -> np.ndarray:
    rough = gaussian_filter(np.random.default_rng(seed).normal(size=shape), 12) * 1.0
    rough += gaussian_filter(np.random.default_rng(seed + 1).normal(size=shape), 2) * 0.02
    return low + (high - low) * (rough - rough.min()) / np.ptp(rough)


def patches(shape: tuple[int, int], share: float, seed: int = 5) -> np.ndarray:
    smooth = gaussian_filter(np.random.default_rng(seed).normal(size=shape), 6)
    return smooth < np.quantile(smooth, share)


def said(path: Path, heights: np.ndarray, dtype: str = "int16") -> list[str]:
    with rasterio.open(path, "w", driver="GTiff", height=heights.shape[0], width=heights.shape[1], count=1, dtype=dtype,
                       crs="EPSG:32611", transform=Affine(30, 0, 5e5, 0, -30, 4e6)) as file:  # fmt: skip
        file.write(heights.astype(dtype), 1)
    with Source.open(path) as source:
        found = statistics(source, 30)
        sentences = suspicions(source, found)
        assert [s for s in doubtful_heights(source, found.low, found.high) if "exactly" in s or "codes" in s] == [
            s for s in sentences if "exactly" in s or "codes" in s
        ]
    return sentences


@pytest.mark.cases(5)
@pytest.mark.parametrize("shape", [(300, 340), (1500, 1400)])
@pytest.mark.parametrize("value", [0, -1, -9999])
@pytest.mark.parametrize("share", [0.02, 0.186, 0.6])
def test_voids_filled_with_a_number(tmp_path: Path, shape: tuple[int, int], value: int, share: float) -> None:
    heights = ground(shape, 210, 1600)
    heights[patches(shape, share)] = value
    sentences = said(tmp_path / "a.tif", heights)
    assert any(f"`nodata={value}`" in s for s in sentences), sentences


def test_a_fill_between_lowest_and_highest(tmp_path: Path) -> None:
    heights = ground((300, 300), -900, -250)
    heights[150:] = ground((150, 300), 300, 900)
    heights[patches(heights.shape, 0.1)] = 0
    assert any("`nodata=0`" in s for s in said(tmp_path / "a.tif", heights, "float32"))


@pytest.mark.parametrize(
    ("name", "unit"), [("a_ft.tif", "ft"), ("ft.tif", "ft"), ("a_10ft.tif", None), ("uk_2km.tif", None)]
)
def test_units_in_names_are_not_those_of_a_spacing(tmp_path: Path, name: str, unit: str | None) -> None:
    told = [s for s in said(tmp_path / name, ground((300, 300), 100, 900)) if "Its name says" in s]
    assert [f"'{unit}'" in s for s in told] == ([True] if unit else [])


@pytest.mark.parametrize("dtype", ["int16", "float32"])
def test_seas_lakes_and_clipped_ground_are_left_alone(tmp_path: Path, dtype: str) -> None:
    shape = (400, 420)
    hills = ground(shape, -300, 900)
    rng = np.random.default_rng(3)
    city = np.full(shape, 150.0)
    for _ in range(300):
        r, c = rng.integers(0, 390, 2)
        city[r : r + rng.integers(6, 20), c : c + rng.integers(6, 20)] = 150 + rng.uniform(3, 40)
    cases = {
        "sea": np.maximum(hills, 0),
        "lake": np.maximum(hills, 120),
        "hills": hills,
        "city": city,
        "clipped": np.maximum(ground(shape, 100, 300), 150),
        "plain": ground(shape, 0, 12),
        "steps": np.round(ground(shape, 0, 12)),
        "flat": np.where(np.indices(shape).sum(0) > 400, 7.0, 8.0),
    }
    for name, heights in cases.items():
        sentences = [s for s in said(tmp_path / f"{name}.tif", heights, dtype) if "exactly" in s or "codes" in s]
        assert not sentences, (name, sentences)


def test_codes_of_land_cover(tmp_path: Path) -> None:
    smooth = gaussian_filter(np.random.default_rng(2).normal(size=(300, 300)), 4)
    other = gaussian_filter(np.random.default_rng(9).normal(size=(300, 300)), 5)
    classes = np.array([11, 21, 31, 41, 42, 52, 71, 81, 90])
    cover = classes[(np.digitize(smooth, [-0.02, 0.02]) * 3 + np.digitize(other, [-0.02, 0.02]))]
    assert any("codes of classes" in s for s in said(tmp_path / "a.tif", cover, "uint8"))


@pytest.mark.stress
def test_no_false_alarms_on_real_elevation(shared_data: Path) -> None:
    """All elevation of the open data; whose voids are filled with zeros, and what is no elevation, is suspected."""
    filled = {"srtm_41_19.tif", "srtm_41_19_4326.tif"}
    tried = 0
    for path in sorted(shared_data.rglob("*.*")):
        if path.suffix not in (".tif", ".tiff", ".png", ".hgt", ".dem", ".cub") or "nasty" in str(path):
            continue
        with Source.open(path) as source:
            if source.picture:
                continue
            tried += 1
            sentences = [s for s in doubtful_heights(source, 0, 1) if "exactly" in s or "codes" in s]
        assert bool(sentences) == (path.name in filled | {"landcover.tif"}), (path, sentences)
    assert tried > 80
