"""The command line as tests call it, and a small DEM to call it on."""

from __future__ import annotations

import numpy as np
import pytest
import rasterio
from affine import Affine

from orograph.cli import main


@pytest.fixture
def run(monkeypatch, capsys):
    """The command line in this process: exit code, stdout, stderr."""

    def leave(code):
        raise SystemExit(code)

    monkeypatch.setattr("orograph.cli._leave", leave)
    monkeypatch.setattr("orograph.cli.spare_imports", lambda s3: None)

    def call(*args):
        with pytest.raises(SystemExit) as stop:
            main([str(a) for a in args])
        said = capsys.readouterr()
        return stop.value.code, said.out, said.err

    return call


@pytest.fixture(scope="session")
def hilly(tmp_path_factory):
    """A GeoTIFF of 90 × 70 samples, hills 30 m apart in UTM zone 11 N, two of them missing."""
    path = tmp_path_factory.mktemp("hilly") / "hilly.tif"
    y, x = np.mgrid[:90, :70]
    heights = (500 + 200 * np.sin(x / 9) * np.cos(y / 7) + 20 * np.sin(x * y / 50)).astype(np.float32)
    heights[40, 30:32] = -9999
    with rasterio.open(path, "w", driver="GTiff", height=90, width=70, count=1, dtype="float32", crs="EPSG:32611",
                       transform=Affine(30, 0, 500_000, 0, -30, 4_000_000), nodata=-9999) as file:  # fmt: skip
        file.write(heights, 1)
    return path
