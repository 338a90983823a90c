"""Points with values: those that lie nowhere."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
from rasterio.transform import from_origin

import orograph
from orograph.geovis.data.dataset import Dataset
from orograph.geovis.data.points import read_points


def test_a_point_beyond_the_poles_is_left_out_without_a_warning(tmp_path: Path) -> None:
    place = from_origin(500_000, 5_600_000, 100, 100)
    terrain = orograph.terrain(np.zeros((40, 50), np.float32), transform=place, crs="EPSG:32630")
    file = tmp_path / "p.csv"
    file.write_text("lon,lat,value\n-2.98,50.54,1\n-2.98,-118.2,2\n-2.97,50.53,3\n")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = read_points(Dataset(str(file)), terrain.grid)
    assert found.values.tolist() == [1, 3]
