"""A picture in words says what it shows."""

from __future__ import annotations

import numpy as np
from rasterio.transform import from_origin

import orograph


def test_a_picture_in_words():
    heights = np.add.outer(np.arange(40), np.arange(50)).astype(np.float32)
    terrain = orograph.terrain(heights, transform=from_origin(500_000, 5_600_000, 100, 100), crs="EPSG:32630")
    members = np.random.default_rng(0).normal(10, 1, (5, 40, 50)).astype(np.float32)
    data = orograph.Dataset(members, band="all", name="Rain", unit="mm", range=(0, 20), uncertainty="spread")
    view = orograph.camera.around(terrain, (160, 100), azimuth=225, pitch=30, distance=None)
    words = orograph.render(terrain, view, data=data, sun=(90, 20)).describe()
    for told in ("5 km by 4 km", "0 to 88 m", "from the south-west, 30° down", "comes from the east, 20° high",
                 "Rain, 0 to 20 mm.", "mean of 5", "±"):  # fmt: skip
        assert told in words, (told, words)
    table = {"x": [502_000.0, 503_000.0], "y": [5_598_000.0, 5_597_500.0], "depth": [1.0, 4.0]}
    words = orograph.render(terrain, "plan", size=(120, 100), data=orograph.Dataset(table)).describe()
    assert "straight above" in words and "2 places have values from 1 to 4" in words
