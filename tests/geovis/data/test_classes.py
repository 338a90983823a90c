"""Rasters of classes against plain counting."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
import rasterio
from rasterio.transform import from_origin

import orograph
from orograph.errors import ReadError, UsageError
from orograph.geovis.data.classes import mode
from orograph.geovis.data.dataset import Dataset
from orograph.geovis.data.painting import painted, shown
from orograph.geovis.data.priority import Priority

UTM = "EPSG:32630"
PLACE = from_origin(500_000, 5_600_000, 100.0, 100.0)


@pytest.fixture(scope="module")
def ground() -> orograph.Terrain:
    return orograph.terrain(np.zeros((40, 50), np.float32), transform=PLACE, crs=UTM)


def cover(path, values, step):
    with rasterio.open(
        path, "w", driver="GTiff", count=1, height=values.shape[0], width=values.shape[1], dtype="uint8", crs=UTM,
        transform=from_origin(500_000, 5_600_000, step, step), nodata=255,
    ) as file:  # fmt: skip
        file.write(values.astype(np.uint8), 1)
        file.write_colormap(1, {11: (70, 107, 159), 41: (104, 171, 95), 82: (171, 108, 40)})
        file.update_tags(1, flag_values="11,41,82", flag_meanings="open_water forest crops")
    return str(path)


def test_coarse_classes_are_the_nearest_ones_with_crisp_borders(tmp_path, ground):
    values = np.random.default_rng(0).choice([11, 41, 82], (8, 10))
    found = shown(Dataset(cover(tmp_path / "c.tif", values, 500.0), style="classes"), ground.grid, 200, Priority())
    truth = np.kron(np.searchsorted([11, 41, 82], values), np.ones((20, 20)))
    np.testing.assert_array_equal(found.values, truth)
    assert found.classes == ("open water", "forest", "crops")
    by_itself = shown(Dataset(cover(tmp_path / "c.tif", values, 500.0)), ground.grid, 200, Priority())
    np.testing.assert_array_equal(by_itself.values, truth)
    layer = painted(found)
    assert [words for words, _ in layer.key.classes] == list(found.classes) and not layer.key.scales
    np.testing.assert_array_equal(layer.key.classes[0][1][0, 0], [70, 107, 159])


def test_fine_classes_are_the_most_frequent_ones(tmp_path, ground):
    values = np.random.default_rng(1).choice([11, 41, 82, 255], (160, 200), p=[0.5, 0.2, 0.2, 0.1])
    found = shown(Dataset(cover(tmp_path / "f.tif", values, 25.0), style="classes"), ground.grid, 50, Priority())
    blocks = values.reshape(40, 4, 50, 4).swapaxes(1, 2).reshape(40, 50, 16)
    codes = np.array([11, 41, 82])
    for i, j in np.ndindex(40, 50):
        most = Counter(int(v) for v in blocks[i, j]).most_common()
        best = {code for code, count in most if count == most[0][1]}
        value = found.values[i, j]
        assert (255 if np.isnan(value) else int(codes[int(value)])) in best


def test_exported_classes_are_those_of_the_file(tmp_path, ground):
    values = np.random.default_rng(2).choice([11, 41, 82], (8, 10))
    out = tmp_path / "out.tif"
    orograph.export(ground, out, data=Dataset(cover(tmp_path / "c.tif", values, 500.0)))
    with rasterio.open(out) as file:
        np.testing.assert_array_equal(file.read(1), np.kron(values, np.ones((5, 5))))


def test_modes_of_votes():
    votes = np.array([[[1.0, np.nan]], [[2.0, np.nan]], [[2.0, 3.0]]], np.float32)
    np.testing.assert_array_equal(mode(votes), [[2, np.nan]])


def test_what_has_no_classes_is_refused(ground):
    with pytest.raises(ReadError, match="whole numbers"):
        shown(Dataset(np.full((8, 10), 0.5, np.float32), style="classes"), ground.grid, 50, Priority())
    several = np.zeros((2, 8, 10), np.float32)
    with pytest.raises(UsageError, match="no mean"):
        shown(Dataset(several, band="all", style="classes"), ground.grid, 50, Priority())
